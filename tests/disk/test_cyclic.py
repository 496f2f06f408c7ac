"""Cyclic symmetry against whole wheels, which DOLFINx assembles, or copies of the sector make."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import csr
from wheels import RING, SOLID, ring, wheel_of, whole_scene, write_whole

import fenics_crack as fc
from fenics_crack.disk.cyclic import CyclicModes
from fenics_crack.disk.wheel import WheelInFewCoordinates
from fenics_crack.scene.scene import Scene


def grid(columns: int, rows: int) -> dict[str, Any]:
    """Changes for equal quadrilaterals."""
    sizes = {"columns": columns, "rows": rows, "size": None, "lip_elements": None}
    return {f"mesh.{key}": value for key, value in ({"layout": "grid"} | sizes).items()}


def of_wheel(found: CyclicModes) -> np.ndarray:
    """The frequencies of the modes of the wheel, ascending."""
    single = [found.sector.has_single_wave(n) for n in found.sector.nodal_diameter_range]
    parts = zip(found.omega, single, strict=True)
    return np.sort(np.concatenate([np.repeat(own, 1 if one else 2) for own, one in parts]))


@pytest.mark.parametrize(
    ("sectors", "cells"),
    [
        (5, "triangle"), (6, "quadrilateral"),
        pytest.param(5, "quadrilateral", marks=pytest.mark.nightly),
        pytest.param(6, "triangle", marks=pytest.mark.nightly),
    ],
)  # fmt: skip
def test_modes_are_those_of_the_whole_wheel(sectors: int, cells: str, tmp_path: Path) -> None:
    """30 of them, of a mesh file of the whole wheel that knows nothing of sectors."""
    scene = ring(disk__sectors=sectors, crack=None, contact=None)
    if cells == "quadrilateral":
        scene = scene.replace(grid(2, 12))
    wheel = wheel_of(scene)
    write_whole(wheel, tmp_path / "whole.msh")
    whole_structure = fc.build_structure(whole_scene(scene, tmp_path / "whole.msh"))
    assert whole_structure.n_dofs == wheel.n_dofs
    sector_omega = of_wheel(wheel.cyclic_modes(10))[:30]
    assert sector_omega == pytest.approx(fc.solve_modes(whole_structure, 30).omega, rel=1e-10)


@pytest.mark.nightly
def test_rotating_modes_are_those_of_the_whole_wheel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 3,000 rpm about the disk's own axis, with the stress of the whole wheel."""
    scene = ring(crack=None, contact=None, rotation__rpm=3000.0, excitation__frequency=None)
    wheel = wheel_of(scene)
    write_whole(wheel, tmp_path / "whole.msh")
    plane = whole_scene(scene, tmp_path / "whole.msh")
    rotor_scene = plane.replace({"rotation.hub_radius": 0.0, "rotation.rpm": 3000.0})
    center = np.append(wheel.sector.center, 0.0)
    axis_point_and_direction = property(lambda self: (center, np.array([0.0, 0.0, 1.0])))
    monkeypatch.setattr(Scene, "axis_point_and_direction", axis_point_and_direction)
    whole_structure = fc.build_structure(rotor_scene)
    sector_omega_at_rest = of_wheel(wheel_of(ring(crack=None, contact=None)).cyclic_modes(6))[:12]
    sector_omega = of_wheel(wheel.cyclic_modes(6))[:12]
    assert sector_omega == pytest.approx(fc.solve_modes(whole_structure, 12).omega, rel=1e-8)
    assert np.all(sector_omega[:6] > 1.0005 * sector_omega_at_rest[:6])


@pytest.mark.parametrize("given", [RING, pytest.param(SOLID, marks=pytest.mark.nightly)])
def test_coordinates_are_those_of_the_whole_matrices(given: dict[str, object]) -> None:
    """U^T M U and U^T K U of copies of the sector, with an open crack and mistuning; the modes are
    orthogonal, and stiffness does not couple them with the crack."""
    scene = fc.Scene.from_mapping(given)
    if scene.dimension == 2:
        scene = ring(disk__sectors=4)
    wheel = wheel_of(scene).mistuned(np.linspace(-0.02, 0.03, scene.given("disk").sectors))
    two_family_wheel = WheelInFewCoordinates(wheel, 2)
    basis = two_family_wheel.expand(np.eye(two_family_wheel.n_dofs)).T
    for name, limit in (("mass", 1e-9), ("stiffness", 1e-9)):
        reduced_matrix, whole_matrix = (
            csr(getattr(two_family_wheel, name)).toarray(),
            csr(getattr(wheel, name)),
        )
        projected_matrix = basis.T @ (whole_matrix @ basis)
        size = np.sqrt(np.outer(np.diag(projected_matrix), np.diag(projected_matrix)))
        assert np.abs((reduced_matrix - projected_matrix) / size).max() < limit
    assert two_family_wheel.gap.toarray() == pytest.approx((wheel.gap.T @ basis).T, abs=1e-9)
    size = np.abs(two_family_wheel.force).max()
    assert two_family_wheel.force == pytest.approx(wheel.force @ basis, abs=1e-9 * size)


def test_equal_mistuning_scales_all_frequencies() -> None:
    """By sqrt(1 + delta), with the crack open, too."""
    wheel = wheel_of(ring(disk__families=2))
    tuned_wheel = fc.reduce_wheel(wheel)
    mistuned_wheel = fc.reduce_wheel(wheel.mistuned(0.03))
    assert mistuned_wheel.omega == pytest.approx(np.sqrt(1.03) * tuned_wheel.omega, rel=1e-8)


def test_ring_of_twelve_blades() -> None:
    """Frequencies and peak of a tuned wheel that an independent prototype computed, on blocks that
    are as coarse at the corners between blade and rim."""
    wheel = wheel_of(fc.Scene.from_mapping(RING).replace({"disk.cracked": []} | grid(3, 20)))
    lowest_frequencies = of_wheel(wheel.cyclic_modes(1))[:4] / (2.0 * np.pi)
    assert lowest_frequencies == pytest.approx([1365.457, 1375.865, 1375.865, 1380.345], rel=1e-3)
    reduced_wheel = fc.reduce_wheel(wheel)
    tips = wheel.dofs_of_blades(wheel.watched_dof)
    omega = 2.0 * np.pi * np.linspace(1380.0, 1384.0, 81)
    sizes = np.array([np.abs(_response(reduced_wheel, frequency, tips)) for frequency in omega])
    top = int(np.argmax(sizes.max(axis=1)))
    assert omega[top] / (2.0 * np.pi) == pytest.approx(1381.8, rel=1e-3)
    assert sizes[top].max() == pytest.approx(82.24e-6, rel=1e-2)
    assert np.ptp(sizes[top]) < 1e-8 * sizes[top].max()
    angles = np.angle(_response(reduced_wheel, omega[top], tips))
    steps = np.angle(np.exp(1j * (np.diff(angles) - 2.0 * np.pi * 2 / 12)))
    assert np.abs(steps).max() < 1e-8


def _response(reduced: fc.ReducedStructure, omega: float, dofs: list[int]) -> np.ndarray:
    """Complex amplitudes a - i b of some dofs at one harmonic without contact."""
    rows = fc.solve_linear(reduced, omega, harmonics=1).displacement_coefficients
    response_values = reduced.values_at(rows, dofs)
    return np.asarray(response_values[1] - 1j * response_values[2])


@pytest.mark.nightly
@pytest.mark.parametrize("without", [{"disk__cracked": []}, {"crack": None, "contact": None}])
def test_bonded_wheel_is_one_sector(without: dict[str, Any]) -> None:
    """The response of every tip of a tuned wheel is that of one sector with its complex ties."""
    wheel = wheel_of(ring(**without, disk__families=6))
    sector, order, omega = wheel.sector, wheel.order, 2.0 * np.pi * 990.0
    with sector.yield_zero_diameter_solver() as zero_diameter_solver:
        ties = zero_diameter_solver.solver_at_diameter(order).tie_matrix.toarray()
    dynamic = (sector.stiffness - omega**2 * sector.mass) @ ties
    force = sector.structure.force
    pull = ties.conj().T @ (force[1] - 1j * force[2])
    exact = ties @ scipy.linalg.solve(ties.conj().T @ dynamic, pull)
    undamped_wheel = fc.reduce_wheel(wheel.damped(None))
    _, sector_dof = wheel.blade_and_sector_dof_of(wheel.watched_dof)
    response = _response(undamped_wheel, omega, wheel.dofs_of_blades(wheel.watched_dof))
    phase_factors = np.exp(2j * np.pi * order * np.arange(sector.n_sectors) / sector.n_sectors)
    assert response == pytest.approx(exact[sector_dof] * phase_factors, rel=1e-5)
