"""PETSc's SNES, the kernel's loops on the same equations; systems whose matrix is not formed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import chain, relative
from laboratory import BlockSystem

import fenics_crack as fc
from fenics_crack.balance.compliance import FactoredCompliance
from fenics_crack.numerics.bordered import point_on_path, solve_at
from fenics_crack.numerics.newton import Newton, gmres
from fenics_crack.numerics.path import Path, PathOptions, Target

PENALTY = fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))


def equations(kind: str) -> Any:
    """A system whose path begins next to the linear solution."""
    structure = chain("modal", pairs=3)
    if kind == "coupled":
        structure = fc.reduce_structure(structure, modes=6, method="massless")
        rigid = fc.Problem(structure, 0.6, fc.UnilateralConstraint(), 8)
        system: Any = rigid.system(rigid.compliance())
        return system.softened()
    law = fc.SmoothedPenalty(5.0, 20.0) if kind == "smooth" else PENALTY
    problem = fc.Problem(structure, 0.6, law, 6, samples=128 if kind == "sampled" else None)
    if kind == "block":
        compliance = FactoredCompliance(structure, problem.base_omega, problem.load)
        return BlockSystem(compliance, problem.integrals()).softened()
    return problem.system(problem.compliance()).softened()


@pytest.mark.parametrize("kind", ["exact", "sampled", "smooth", "coupled", "block"])
def test_snes_finds_the_end_of_a_path(kind: str) -> None:
    """Full steps of SNES from near the path's end, and that end, in the kernel and called back."""
    system = equations(kind)
    begun = solve_at(system, system.linear, 0.0, tolerance=1e-12)
    assert begun is not None
    start = point_on_path(system, begun.unknown, 0.0)
    found = Path(system, start, PathOptions(0.1, max_step=0.5), [Target(1.0)]).run()
    assert found is not None and found.parameter == 1.0
    near = found.unknown * (1.0 + 1e-3 * np.random.default_rng(0).normal(size=found.unknown.shape))
    with Newton(system) as newton:
        at, converged, count = newton.solve(near, 1.0, 1e-12, 20)
    assert converged and 0 < count < 10
    assert relative(at.unknown, found.unknown) < 1e-10


# --- linear systems whose matrix is not formed ----------------------------------------------------


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
