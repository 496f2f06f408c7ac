"""Forces and moments of the clamp beside the loads, and beside Newton's law by another sum."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, ROOT, catch_error, columns_of_curve
from mpi4py import MPI
from surroundings import main

import fenics_crack as fc

WIDTH, HEIGHT, THICK, DENSITY = 0.1, 0.2, 0.01, 7800.0
PLATE: dict[str, Any] = {
    "geometry": {"width": WIDTH, "height": HEIGHT, "thickness": THICK},
    "crack": {"edge": "left", "height": 0.1, "length": 0.05},
    "material": {"young": 2e11, "poisson": 0.3, "density": DENSITY},
    "damping": {"ratio": 0.01, "modes": 8},
    "excitation": {"omega": 3000.0, "point": [0.1, 0.15], "force_sin": [700.0, 300.0]},
    "contact": {"law": "unilateral"},
    "mesh": {"layout": "grid", "columns": 8, "rows": 16, "error": False},
}
BOTH = ("reaction_force", "reaction_moment")


def plate(**changes: Any) -> fc.Scene:
    """The plate with some keys changed, whose dots are written as two underscores."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return fc.Scene.from_mapping(PLATE).replace(keys)


def solved(scene: fc.Scene) -> Any:
    """Its vibration."""
    return fc.solve(scene, MPI.COMM_SELF)


# --- at rest --------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["massless", "off"])
def test_static_load_is_held(method: str) -> None:
    """A mean load alone, at a point, on an edge and in the clamp itself: forces and moment to
    1e-9."""
    loads = [{"edge": "left", "traction_mean": [2e4, -1e4]}, {"edge": "top", "pressure_mean": 3e4}]
    keys = {"excitation.force_mean": (700.0, 300.0), "excitation.force_sin": (0.0, 0.0)}
    scene = fc.Scene.from_mapping(PLATE | {"loads": loads}).replace(
        keys | {"reduction.method": method, "excitation.omega": 1.0}
    )
    reaction = fc.reaction(solved(scene))
    np.testing.assert_allclose(reaction.center, [0.05, 0.0], atol=1e-12)
    left_force, top = (
        HEIGHT * THICK * np.array([2e4, -1e4]),
        WIDTH * THICK * np.array([0.0, -3e4]),
    )
    force = np.array([700.0, 300.0]) + left_force + top
    moment = 0.05 * 300.0 - 0.15 * 700.0 - 0.05 * left_force[1] - 0.1 * left_force[0]
    np.testing.assert_allclose(reaction.force, np.tile(-force, (len(reaction.time), 1)), rtol=1e-9)
    np.testing.assert_allclose(reaction.moment, -moment, rtol=1e-9)


def solid(**changes: Any) -> fc.Scene:
    """The box that ``new`` writes, coarser, with some keys of its excitation and base."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    coarse_settings = {"mesh.size": 0.015, "mesh.lip_elements": 2, "reduction.modes": 6}
    scene = fc.Scene.load(ROOT / "fenics_crack" / "cli" / "new_solid.toml")
    few_harmonics = {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 3}
    return scene.replace(coarse_settings | few_harmonics | keys)


def test_static_load_of_a_solid() -> None:
    """The same of a solid, about all three axes."""
    force, point = np.array([3.0, -2.0, 5.0]), np.array([0.0, 0.09, 0.003])
    rest = {"excitation__force_sin": (0.0,) * 3, "excitation__force_mean": tuple(force)}
    reaction = fc.reaction(solved(solid(**rest)))
    np.testing.assert_allclose(reaction.center, [0.015, 0.0, 0.003], atol=1e-12)
    np.testing.assert_allclose(reaction.force[0], -force, rtol=1e-9)
    moment = np.cross(point - reaction.center, force)
    np.testing.assert_allclose(reaction.moment[0], -moment, rtol=1e-9, atol=1e-12)


def test_shaken_solid() -> None:
    """Far below its resonances the clamp carries the whole mass along, clamped nodes too."""
    shaken = (2.0, -1.0, 4.0)
    rest = {"excitation__force_sin": (0.0,) * 3, "excitation__frequency": 5.0}
    reaction = fc.reaction(solved(solid(base__acceleration_sin=shaken, **rest)))
    mass, top = 7850.0 * 0.03 * 0.09 * 0.006, len(reaction.time) // 4
    np.testing.assert_allclose(reaction.force[top], mass * np.array(shaken), rtol=1e-3)
    moment = np.cross([0.0, 0.045, 0.0], mass * np.array(shaken))
    np.testing.assert_allclose(reaction.moment[top], moment, rtol=1e-3, atol=1e-9)


# --- Newton's law ---------------------------------------------------------------------------------


def momentum(structure: fc.Structure, moved: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Momentum and angular momentum of velocities (n, n_dofs), or their rates of accelerations, by
    Gauss points in bilinear rectangles: (n, 3)."""
    points, cells, dofs = (getattr(structure.nodes, name) for name in ("points", "cells", "dofs"))
    field = np.where(dofs >= 0, moved[:, dofs], 0.0)  # (n, node, 2)
    momenta = np.zeros((len(moved), 3))
    for cell in cells:
        corners = points[cell]
        lower_corner, upper_corner = corners.min(axis=0), corners.max(axis=0)
        for xi in 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0):
            for eta in 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0):
                place = lower_corner + (upper_corner - lower_corner) * [xi, eta]
                weights = np.prod(
                    1.0 - np.abs(corners - place) / (upper_corner - lower_corner), axis=1
                )
                v = weights @ field[:, cell]
                x, y = place - about
                mass = 0.25 * DENSITY * THICK * np.prod(upper_corner - lower_corner)
                momenta += mass * np.column_stack([v, x * v[:, 1] - y * v[:, 0]])
    return momenta


@pytest.mark.drawn(2)
@pytest.mark.parametrize(
    "changes",
    [
        {"reduction__method": "off", "mesh__columns": 4, "mesh__rows": 8},
        {"reduction__method": "free_interface", "reduction__modes": 12},
        {"damping__ratio": None, "damping__modes": "all", "damping__mass": 40.0,
         "damping__stiffness": 2e-6, "reduction__modes": 12, "reduction__method": "free_interface"},
        {"excitation__force_sin": (0.0, 0.0), "base__acceleration_sin": (90.0, 20.0),
         "reduction__method": "free_interface", "reduction__modes": 12},
    ],
    ids=["whole", "reduced", "rayleigh", "base"],
)  # fmt: skip
@pytest.mark.usefixtures("predicted_errors")
def test_newtons_law_of_the_whole_body(changes: dict[str, Any]) -> None:
    """Forces of the clamp, the load and the drag make the momentum and the angular momentum change:
    summed by another quadrature, from velocities at two instants."""
    contact = {"contact": None, "contact__stiffness": 1e9, "harmonic_balance__harmonics": 9}
    scene = plate(**contact, **changes)
    run = solved(scene)
    reaction, solution = fc.reaction(run), run.result
    structure, step = run.structure.whole, 1e-4 * solution.period
    time = reaction.time[::64]

    def velocity(instants: np.ndarray) -> np.ndarray:
        ends = (solution.displacement_field(instants + sign * step) for sign in (1.0, -1.0))
        return np.asarray(np.subtract(*ends) / (2.0 * step))

    ends = (
        momentum(structure, velocity(time + sign * step), reaction.center) for sign in (1.0, -1.0)
    )
    rate = np.subtract(*ends) / (2.0 * step)
    sine = np.sin(solution.omega * time)[:, None]
    x, y = np.array(scene.excitation.point) - reaction.center
    fx, fy = scene.excitation.force_sin
    outer_load = sine * np.array([fx, fy, x * fy - y * fx])
    if scene.base is not None:  # the mass of the plate is carried along
        ax, ay = np.array(scene.base.acceleration_sin) * DENSITY * THICK * WIDTH * HEIGHT
        outer_load -= sine * np.array([ax, ay, -0.5 * HEIGHT * ax])
    if scene.damping.mass:
        outer_load -= 40.0 * momentum(structure, velocity(time), reaction.center)
    reaction_rows = np.hstack([reaction.force, reaction.moment])[::64]
    for ours, theirs in zip(reaction_rows.T, (rate - outer_load).T, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-5 * np.abs(theirs).max())
    assert np.abs(rate).max() > 0.1 * np.abs(reaction_rows).max()


def test_lips_without_mass_and_few_modes() -> None:
    """What the modes leave out has its share of the load: few of them beside many, below the first
    resonance; with the same harmonics, of which forces need more than gaps."""
    few_reaction, many_reaction = (
        fc.reaction(solved(plate(reduction__modes=count, harmonic_balance__harmonics=5)))
        for count in (4, 40)
    )
    for vector_with_few_modes, vector_with_many_modes in (
        (few_reaction.force, many_reaction.force),
        (few_reaction.moment, many_reaction.moment),
    ):
        np.testing.assert_allclose(
            vector_with_few_modes,
            vector_with_many_modes,
            atol=0.01 * np.abs(vector_with_many_modes).max(),
        )


@pytest.mark.nightly
@pytest.mark.usefixtures("predicted_errors")
def test_far_below_the_resonance_it_is_the_load() -> None:
    """A slow load passes through to the clamp, while the crack opens and closes."""
    reaction = fc.reaction(solved(plate(excitation__omega=3.0)))
    size = np.sin(3.0 * reaction.time)
    np.testing.assert_allclose(reaction.force, np.outer(size, [-700.0, -300.0]), atol=1e-2)
    assert reaction.numbers["reaction_force"] == pytest.approx(np.hypot(700.0, 300.0), rel=1e-4)


def test_march_and_solution_agree() -> None:
    """The record of a settled motion."""
    scene = plate(damping__ratio=0.05, integration__periods=80, harmonic_balance__harmonics=30)
    march = fc.reaction(fc.integrate(scene, MPI.COMM_SELF))
    steady = fc.reaction(solved(scene))
    for name in BOTH:
        assert march.numbers[name] == pytest.approx(steady.numbers[name], rel=5e-3)


# --- where it is asked for ------------------------------------------------------------------------


def test_quantities_of_a_scene(tmp_path: Path) -> None:
    """Rows of a solution, columns of a curve and of a sweep over loads, with their errors."""
    scene = plate(output__quantities=("amplitude", *BOTH), curve__start=2900.0, curve__stop=3000.0,
                  curve__stability=False)  # fmt: skip
    run = solved(scene)
    ends = columns_of_curve(scene, tmp_path)
    assert main(["solve", f"{tmp_path}/scene.toml", "--output", str(tmp_path), "--quiet"]) == 0
    stored_numbers = json.loads((tmp_path / "solution.json").read_text())
    rows = {row["name"]: row["value"] for row in stored_numbers if row["name"] in BOTH}
    assert rows == pytest.approx(fc.reaction(run).numbers)
    swept_scene = scene.replace(
        {"sweep.over": {"excitation.force_sin": [[700.0, 300.0], [1400.0, 600.0]]}}
    )
    table = fc.run_sweep(swept_scene, comm=MPI.COMM_SELF)
    for name in BOTH:
        # each chooses its modes by the tolerance, 1e-2
        assert ends[name][-1] == pytest.approx(rows[name], rel=3e-3)
        assert table[name] == pytest.approx([rows[name], 2.0 * rows[name]], rel=3e-3)
        assert run.errors is not None and run.errors.stated(name)[0] > 0.0


def test_by_load_a_curve_follows_it(tmp_path: Path) -> None:
    """Without a preload the reaction grows with the load."""
    keys = {"parameter": "load", "start": 1.0, "stop": 2.0, "stability": False}
    scene = plate(output__quantities=BOTH, harmonic_balance__harmonics=5).replace(
        {f"curve.{key}": value for key, value in keys.items()}
    )
    columns = columns_of_curve(scene, tmp_path)
    assert len(columns["load"]) > 1
    for name in BOTH:
        np.testing.assert_allclose(columns[name] / columns[name][0], columns["load"], rtol=1e-6)


def test_table_and_words() -> None:
    """Columns with their units, and a line."""
    reaction = fc.reaction(solved(plate()))
    assert list(reaction.table().columns) == [
        "time [s]",
        "force_x [N]",
        "force_y [N]",
        "moment_z [N m]",
    ]
    assert "about (0.05, 0) m" in repr(reaction)


def test_refused_by_name() -> None:
    """Matrices, rotors, and what is no vibration."""
    matrices = fc.Scene.load(DEMOS / "chain.toml")
    catch_error(
        lambda: fc.Scene.load(DEMOS / "rotating_blade.toml").replace({"output.quantities": BOTH}),
        "output.quantities",
        "reaction_force",
        names=r"\[rotation\]",
    )
    catch_error(lambda: fc.reaction(3.0), "run", 3.0, names=r"fc\.solve")  # type: ignore[arg-type]
    catch_error(
        lambda: matrices.replace({"output.quantities": BOTH}),
        "output.quantities",
        "reaction_force",
        names=r"\[structure\]",
    )
