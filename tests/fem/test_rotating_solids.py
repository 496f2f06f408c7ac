"""Solids that rotate about any axis, and what drives them: closed forms, and CalculiX."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catch_error
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack import Scene
from fenics_crack.study.plausibility import remarks_on_scene

SIDE, LENGTH, YOUNG, DENSITY = 0.01, 0.2, 2.1e11, 7850.0
BAR: dict[str, Any] = {
    "geometry": {"kind": "solid", "width": SIDE, "height": LENGTH, "thickness": SIDE},
    "material": {"young": YOUNG, "poisson": 0.0, "density": DENSITY},
    "damping": {"ratio": 0.01, "modes": 4},
    "excitation": {"omega": 100.0},
    "mesh": {"layout": "graded", "order": 2, "size": SIDE, "error": False},
}
"""A slender one of steel."""
PUSHED = {"loads": [{"edge": "front", "pressure_cos": 100.0}]}
BLADE = Path(__file__).parents[2] / "demos" / "solid_blade.toml"


def bar(**tables: Any) -> fc.Structure:
    """The slender one under some load."""
    return fc.build_structure(Scene.from_mapping(BAR | PUSHED | tables))


AXES = {
    "x": {"hub_radius": 0.1},
    "z": {"center": [0.005, -0.1, 0.005], "axis": [0.0, 0.0, -3.0]},
    "slanting": {"hub_radius": 0.1, "axis": [1.0, 0.0, 1.0]},
}
"""All below the middle of the clamp."""
ALONG = {"x": (1.0, 0.0, 0.0), "z": (0.0, 0.0, 1.0), "slanting": (0.5**0.5, 0.0, 0.5**0.5)}


@pytest.mark.drawn(2)
@pytest.mark.parametrize("name", AXES)
def test_southwell_coefficients_and_stretch(name: str) -> None:
    """w^2 = w_0^2 + (1.193 + 1.571 R / L) W^2 of the vibration along the axis, one W^2 less of the
    one across it, which softens; and the stretch of a bar, rho W^2 (R L^2 / 2 + L^3 / 3) / E."""
    structure = bar(rotation={"speed": 100.0} | AXES[name])
    rotation, hub = structure.rotation, 0.1
    squares_at_rest = fc.solve_modes(rotation.structure_at_rest, 2).omega ** 2
    modes = fc.solve_modes(structure, 2)
    coefficients = (modes.omega**2 - squares_at_rest) / 100.0**2
    southwell = 1.193 + 1.571 * hub / LENGTH
    tip = modes.shapes[structure.nodes.dofs[np.argmax(structure.nodes.points[:, 1])]].T
    share = np.abs(tip @ ALONG[name]) / np.linalg.norm(tip, axis=1)
    assert share == pytest.approx([0.0, 1.0], abs=0.02)
    assert coefficients == pytest.approx([southwell - 1.0, southwell], rel=0.01)
    displacement = fc.solve_linear(structure, 1.0, harmonics=1).displacement_coefficients[0]
    top = displacement[structure.find_dof((SIDE / 2.0, LENGTH, SIDE / 2.0), "y")]
    stretch = DENSITY * 100.0**2 * (hub * LENGTH**2 / 2.0 + LENGTH**3 / 3.0) / YOUNG
    assert top == pytest.approx(stretch, rel=2e-3)


@pytest.mark.drawn(1)
@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
def test_an_axis_below_the_middle_bends_no_blade(axis: list[float]) -> None:
    """At a distance e beside it the uniform load rho A W^2 e bends the bar by q L^4 / (8 E I), and
    its stress in the clamp is q L^2 / 2 / (b^3 / 6)."""
    offset_axis = {"center": [0.0, -0.1, 0.0], "axis": axis, "speed": 100.0}
    stress = DENSITY * 100.0**2 * 0.5 * SIDE * LENGTH**2 * 3.0 / SIDE
    deflection = DENSITY * 100.0**2 * 0.5 * SIDE * LENGTH**4 * 1.5 / (YOUNG * SIDE**2)
    tip_motions = []
    for rotation in ({"hub_radius": 0.1, "axis": axis, "speed": 100.0}, offset_axis):
        scene = Scene.from_mapping(BAR | PUSHED | {"rotation": rotation})
        structure = fc.build_structure(scene)
        mean = fc.solve_linear(structure, 1.0, harmonics=1).displacement_coefficients[0]
        top = (0.5 * SIDE, LENGTH, 0.5 * SIDE)
        tip_motions.append([mean[structure.find_dof(top, letter)] for letter in "xz"])
        remarks = [r for r in remarks_on_scene(scene, structure) if r.key.startswith("rotation")]
        assert len(remarks) == len(tip_motions) - 1
    side = int(axis[0] == 1.0)  # the direction in which it is bent
    assert np.abs(tip_motions[0]).max() < 2e-3 * deflection
    assert np.abs(tip_motions[1][side]) == pytest.approx(deflection, rel=0.02)
    assert f"about {1e-6 * stress:.3g} MPa" in str(remarks[0])


CALCULIX = {
    3000.0: (358.8100, 1361.887, 1748.819, 2803.877, 3577.960, 4081.192),
    6000.0: (398.2636, 1400.349, 1760.752, 2815.094, 3610.842, 4107.792),
    9000.0: (455.9445, 1459.573, 1782.044, 2833.041, 3663.340, 4153.588),
}
"""Natural frequencies [Hz] of the blade of meshes/solid_blade.msh at speeds [rpm], on that mesh of
C3D10, by CalculiX 2.20: *CENTRIF, NLGEOM and a perturbation step. The book makes them again: -k
'book[calculix_rotating_blade]'."""


@pytest.mark.nightly
def test_a_twisted_blade_beside_calculix() -> None:
    """All six within 0.1 %; without the stiffness of the displaced shape the second one would be
    0.2 % off at 6000 rpm."""
    rotation = fc.build_structure(Scene.load(BLADE)).rotation
    for rpm, calculix_hertz in CALCULIX.items():
        hertz = fc.solve_modes(
            rotation.structure_rotating_at_speed(rpm * math.pi / 30.0), 6
        ).omega / (2.0 * math.pi)
        assert hertz == pytest.approx(calculix_hertz, rel=1e-3)


def vibrating(scene: Scene, comm: MPI.Comm) -> list[float]:
    """Frequencies and, of the solution, mean and first two harmonics of the watched motion and the
    share of the period for which lips are closed, on all ranks."""
    run = fc.solve(scene, comm)
    omega = fc.solve_modes(run.structure.whole, 4).omega
    rows = run.result.coefficients_at([run.watched_dof])[:, 0]
    sizes = [abs(rows[0]), *np.hypot(rows[1:5:2], rows[2:5:2])]
    return [*omega, *sizes, run.result.indicators().closed_share]


@pytest.mark.nightly
@pytest.mark.mpi
def test_ranks_share_the_blade(on_ranks: Callable[..., Any]) -> None:
    """Two ranks find the frequencies of one and, next to the resonance, which magnifies rounding,
    its motion, with the same share of the period closed."""
    scene = Scene.load(BLADE)
    serial, parallel = vibrating(scene, MPI.COMM_SELF), on_ranks(vibrating, scene)
    assert parallel[:4] == pytest.approx(serial[:4], rel=1e-9)
    assert parallel[4:] == pytest.approx(serial[4:], rel=2e-8)
    assert 0.05 < serial[-1] < 0.3


def test_a_phase_delays_cosine_and_sine() -> None:
    """q(t - phase / w): a quarter of a period makes the sine of the cosine."""
    force = bar(loads=[{"edge": "front", "pressure_mean": 7.0, "pressure_cos": 100.0}]).force
    assert force[1].sum() == pytest.approx(-100.0 * SIDE * LENGTH, rel=0.1)  # less the clamp's
    for phase in (90.0, 30.0):
        loads = [{"edge": "front", "pressure_mean": 7.0, "pressure_cos": 100.0, "phase": phase}]
        mean, cosine, sine = bar(loads=loads).force
        turn, size = math.radians(phase), np.abs(force).max()
        assert mean == pytest.approx(force[0])
        assert cosine == pytest.approx(math.cos(turn) * force[1], abs=1e-12 * size)
        assert sine == pytest.approx(math.sin(turn) * force[1], abs=1e-12 * size)


@pytest.mark.parametrize(
    ("axis", "shares"), [(0, (0.6131, 0.1883)), (1, (8.0 / math.pi**2,)), (2, (0.6131, 0.1883))]
)
def test_effective_masses_of_a_shaken_bar(axis: int, shares: tuple[float, ...]) -> None:
    """(phi^T M R)^2 over the mass, with R the clamp's direction: those of the modes of Euler and
    Bernoulli's cantilever, and of a bar that is stretched."""
    thicker = {"geometry": BAR["geometry"] | {"thickness": 1.2 * SIDE}}  # no equal frequencies
    shaken = bar(loads=[], base={"acceleration_cos": np.eye(3)[axis].tolist()}, **thicker)
    modes = fc.solve_modes(shaken, 12)
    effective = (shaken.force[1] @ modes.shapes) ** 2 / (1.2 * DENSITY * SIDE**2 * LENGTH)
    assert effective[effective > 0.1] == pytest.approx(shares, rel=0.01)
    assert np.all(shaken.force[[0, 2]] == 0.0)


@pytest.mark.parametrize(
    ("key", "rotation", "kind"),
    [
        ("rotation.hub_radius", {}, "solid"),
        ("rotation.hub_radius", {"hub_radius": 0.1, "center": [0.0, 0.0, 1.0]}, "solid"),
        ("rotation.axis", {"hub_radius": 0.1, "axis": [0.0, 0.0, 0.0]}, "solid"),
        ("rotation.axis", {"hub_radius": 0.1, "axis": [0.0, 1.0]}, "solid"),
        ("rotation.axis", {"hub_radius": 0.1, "axis": [0.0, 1.0]}, "plate"),
        ("rotation.center", {"center": [0.0, 1.0, 0.0]}, "plate"),
    ],
)
def test_axes_that_cannot_be(key: str, rotation: dict[str, Any], kind: str) -> None:
    tables = BAR | {"rotation": {"speed": 1.0} | rotation} | PUSHED
    tables["geometry"] = BAR["geometry"] | {"kind": kind}
    catch_error(lambda: Scene.from_mapping(tables), key)


@pytest.mark.parametrize("key", ["axis", "center"])
@pytest.mark.parametrize("value", ["y", [0.0, math.nan, 0.0]])
def test_vectors_of_solids_have_three_numbers(key: str, value: object) -> None:
    """As what is no vector at all is told."""
    catch_error(
        lambda: Scene.from_mapping(
            BAR | PUSHED | {"rotation": {"speed": 1.0, "hub_radius": 0.1, key: value}}
        ),
        f"rotation.{key}",
        value,
    )
