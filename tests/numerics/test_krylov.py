"""Linear systems whose matrix is not formed."""

import numpy as np
import pytest
from helpers import relative

from fenics_crack.numerics.newton import gmres


def system(size: int = 40, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A matrix that is not symmetric, and a right-hand side of two columns' shape."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(size) + rng.normal(size=(size, size)) / np.sqrt(size)
    return matrix, rng.normal(size=(size // 2, 2))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-7, 1e-12])
def test_solution_to_a_tolerance(tolerance: float) -> None:
    """That of LAPACK, and a residual below what is allowed."""
    matrix, right = system()
    found = gmres(lambda v: (matrix @ v.ravel()).reshape(v.shape), right, tolerance)
    assert found.shape == right.shape
    left = matrix @ found.ravel() - right.ravel()
    assert np.linalg.norm(left) <= 1.001 * tolerance * np.linalg.norm(right)
    exact = np.linalg.solve(matrix, right.ravel())
    assert relative(found.ravel(), exact) < np.linalg.cond(matrix) * tolerance


def test_too_few_iterations_give_the_best() -> None:
    """The least residual in the Krylov space: that of a least-squares problem, and no applications
    beyond."""
    matrix, right = system()
    asked = []

    def apply(vector: np.ndarray) -> np.ndarray:
        asked.append(vector)
        return (matrix @ vector.ravel()).reshape(vector.shape)

    lefts = []
    for most in (1, 5, 15):
        del asked[:]
        found = gmres(apply, right, 1e-14, most)
        assert len(asked) <= most + 1
        space = [right.ravel()]
        while len(space) < most:
            space.append(matrix @ space[-1])
        basis = np.linalg.qr(np.array(space).T)[0]
        best = basis @ np.linalg.lstsq(matrix @ basis, right.ravel(), rcond=None)[0]
        assert relative(found.ravel(), best) < 1e-6
        lefts.append(np.linalg.norm(matrix @ found.ravel() - right.ravel()))
    assert lefts[0] > lefts[1] > lefts[2] > 1e-6


def test_nothing_is_solved_by_nothing() -> None:
    """A right-hand side of zeros."""
    matrix, right = system()
    found = gmres(lambda v: (matrix @ v.ravel()).reshape(v.shape), 0.0 * right, 1e-9)
    assert np.array_equal(found, np.zeros_like(right))
