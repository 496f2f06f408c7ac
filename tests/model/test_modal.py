"""Modes are computed once for a structure and everything that is varied of it."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import DAMPINGS, chain, dense_matrices

import fenics_crack as fc
from fenics_crack.balance import compliance
from fenics_crack.balance.compliance import FactoredCompliance, load_coefficients
from fenics_crack.model import modes as model_modes
from fenics_crack.model import reduction
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import damped_modes


@pytest.fixture
def eigensolutions(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the eigenproblems that are solved from now on."""
    asked: list[int] = []

    def counted(solve: Callable[..., Any]) -> Callable[..., Any]:
        def call(first: Any, *others: Any) -> Any:
            asked.append(others[0] if isinstance(first, fc.Structure) else len(first))
            return solve(first, *others)

        return call

    monkeypatch.setattr(scipy.linalg, "eigh", counted(scipy.linalg.eigh))
    for module in (model_modes, reduction, compliance):
        monkeypatch.setattr(module, "solve_modes", counted(fc.solve_modes))
    return asked


@pytest.mark.parametrize("damping", DAMPINGS)
def test_modes_of_varied_copies(damping: str, eigensolutions: list[int]) -> None:
    """Nothing is computed again, whichever asks first; the damping is the varied one."""
    structure = chain(damping)
    half = structure.varied(damping=0.5, load=3.0)
    none, other = half.varied(damping=0.0), structure.varied(clearance=0.1)
    matrix = dense_matrices(structure)[1]
    first = all_modes(half)
    assert eigensolutions
    del eigensolutions[:]
    for varied, factor in ((structure, 1.0), (half, 0.5), (none, 0.0), (other, 1.0)):
        found = all_modes(varied)
        assert found.shapes is first.shapes and found.pairs is first.pairs
        expected = factor * found.shapes.T @ matrix @ found.shapes
        inside = np.diag(found.damping) if found.damping.ndim == 1 else found.damping
        np.testing.assert_allclose(inside, expected, atol=1e-10)
        known = damped_modes(varied)
        assert (known is None) == (damping in ("rayleigh", "matrix", "none"))
        if known is not None:
            ratio = np.asarray(varied.damping.ratio)
            np.testing.assert_allclose(known.rate, 2.0 * ratio * known.omega, rtol=1e-14)
    assert eigensolutions == []


@pytest.mark.parametrize("damping", DAMPINGS)
def test_high_harmonics_of_varied_copies(damping: str, eigensolutions: list[int]) -> None:
    """Beyond the factored harmonics the modes serve; they are those of the first structure."""
    structure = chain(damping, 30)
    varied = structure.varied(damping=0.5)
    found = []
    for one in (structure, varied, fc.Structure.from_matrices(
        structure.mass, structure.stiffness, structure.gap, damping=varied.damping
    )):  # fmt: skip
        del eigensolutions[:]
        factored = FactoredCompliance(one, 0.2, load_coefficients(one, 3, 1))
        found.append(factored.beyond(6))
        factored.destroy()
        assert (eigensolutions == []) == (one is varied)
    np.testing.assert_allclose(found[1], found[2], rtol=1e-7, atol=1e-12)
    if damping != "none":
        assert np.abs(found[1] - found[0]).max() > 1e-9


@pytest.mark.parametrize("kind", ["modal", "matrix"])
@pytest.mark.parametrize("parameter", ["damping", "load", "clearance"])
def test_curves_solve_no_further_eigenproblem(
    parameter: str, kind: str, eigensolutions: list[int]
) -> None:
    """Nor do the solutions on them, with their error reports, and their stability."""
    reduced = fc.reduce_structure(chain(kind, 30), modes=8)
    law = fc.UnilateralPenalty(4.0)
    first = fc.solve_harmonic_balance(reduced, 0.3, law)
    fc.floquet(reduced, first)
    start, end = (0.0, 0.1) if parameter == "clearance" else (1.0, 1.5)
    del eigensolutions[:]
    curve = fc.continue_parameter(reduced, 0.3, law, parameter, start, end, stability=True)
    assert len(curve) > 3 and curve.complete
    for index in (0, len(curve) // 2, len(curve) - 1):
        solution = curve.solution(index)
        assert solution.report.reduction > 0.0
        fc.floquet(solution.structure, solution)
    assert eigensolutions == []


def test_nothing_is_kept_alive(wide_plate: fc.Structure) -> None:
    """Structures are freed as soon as nobody refers to them: they are in no cycles."""
    gc.collect()
    gc.disable()
    try:
        plate = fc.Structure.from_matrices(
            wide_plate.mass, wide_plate.stiffness, wide_plate.gap, damping=fc.ModalDamping(0.01)
        )
        reduced = fc.reduce_structure(plate, modes=8)
        varied = reduced.varied(damping=2.0)
        for one in (plate, reduced, varied):
            all_modes(one)
        alive = [weakref.ref(one) for one in (plate, reduced, varied)]
        del plate, reduced, one
        assert all(one() is not None for one in alive)  # the copy needs them
        del varied
        assert all(one() is None for one in alive)
    finally:
        gc.enable()
