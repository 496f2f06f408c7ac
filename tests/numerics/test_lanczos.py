"""Block Lanczos beside LAPACK, and modes of structures by it beside SLEPc's."""

import numpy as np
import pytest
import scipy.linalg

import fenics_crack as fc
from fenics_crack.numerics.lanczos import Pencil, nearest_to


def pencil(values: np.ndarray, shift: float) -> tuple[Pencil, np.ndarray, np.ndarray]:
    """Matrices with such eigenvalues: what Lanczos takes, K and M."""
    random, count = np.random.default_rng(4), len(values)
    shapes = random.standard_normal((count, count))
    mass = np.linalg.inv(shapes @ shapes.T)
    stiffness = mass @ shapes @ np.diag(values) @ shapes.T @ mass
    factor = scipy.linalg.lu_factor(stiffness - shift * mass)
    solve = lambda rows: scipy.linalg.lu_solve(factor, rows.T).T  # noqa: E731
    return Pencil(solve, lambda rows: rows @ mass, lambda part: part, count, 0), stiffness, mass


@pytest.mark.parametrize("shift", [0.0, 40.0, -1.0])
def test_lowest_and_inner_eigenvalues_and_multiple_ones(shift: float) -> None:
    """Seven equal ones, more than a block has vectors; far less room than dimensions."""
    values = np.concatenate([[3.0] * 7, np.arange(5.0, 98.0) ** 1.1])
    given, stiffness, mass = pencil(values, shift)
    found, shapes = nearest_to(shift, given, 12, 30, 1e-12)
    expected = np.sort(values[np.argsort(abs(values - shift), kind="stable")[:12]])
    assert np.allclose(found, expected, rtol=1e-9)
    assert np.allclose(shapes @ mass @ shapes.T, np.eye(12), atol=1e-10)
    left = shapes @ stiffness - found[:, None] * (shapes @ mass)
    assert np.abs(left).max() < 1e-8 * np.abs(shapes @ stiffness).max()


def test_all_eigenvalues_of_a_small_pencil() -> None:
    """The space is exhausted; more than it has are refused."""
    values = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 4.0])
    given = pencil(values, 0.0)[0]
    assert np.allclose(nearest_to(0.0, given, 7, 15, 1e-12)[0], values, rtol=1e-10)
    with pytest.raises(fc.ConvergenceError, match="8 did not converge"):
        nearest_to(0.0, given, 8, 16, 1e-12)


@pytest.mark.parametrize("lips", ["open", "tied"])
def test_modes_of_a_plate_by_blocks(monkeypatch: pytest.MonkeyPatch, lips: str) -> None:
    """The same as SLEPc's, by the same factor."""
    scene = fc.Scene.load("demos/breathing_plate.toml")
    known = fc.solve_modes(fc.build_structure(scene), 30, lips=lips)
    monkeypatch.setattr("fenics_crack.model.modes.QUICK", 0)
    found = fc.solve_modes(fc.build_structure(scene), 30, lips=lips)
    assert np.allclose(found.omega, known.omega, rtol=1e-9)
    assert np.allclose(found.shapes, known.shapes, atol=1e-6 * np.abs(known.shapes).max())
