"""Loads beside the force of the excitation: forces, pressures and tractions, a clamp that moves."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, ROOT, catch_error
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack import Scene, run_sweep

pytestmark = pytest.mark.usefixtures("predicted_errors")

WIDTH, HEIGHT, THICKNESS, DENSITY = 0.01, 0.4, 0.005, 7800.0
STRIP: dict[str, Any] = {
    "geometry": {"width": WIDTH, "height": HEIGHT, "thickness": THICKNESS},
    "material": {"young": 2.1e11, "poisson": 0.3, "density": DENSITY},
    "damping": {"ratio": 0.01},
    "excitation": {"omega": 100.0},
    "mesh": {"layout": "grid", "columns": 1, "rows": 20, "order": 2},
}


def strip(**tables: Any) -> Scene:
    """A slender strip without a crack, clamped at its end."""
    return Scene.from_mapping(STRIP | tables)


# --- a clamp that moves ---------------------------------------------------------------------------


def test_resonance_of_a_shaken_cantilever() -> None:
    """At resonance the tip moves by 1.566 a / (2 xi w_1^2) against the clamp: the first mode of a
    slender beam has phi(L) = 2 and the participation factor 0.783 (Blevins, table 8-1)."""
    scene = strip(base={"acceleration_cos": [3.0, 0.0]})
    omega = float(fc.solve_modes(fc.build_structure(scene), 1).omega[0])
    assert omega == pytest.approx(
        1.8751**2 / HEIGHT**2 * math.sqrt(2.1e11 / DENSITY) * WIDTH / math.sqrt(12.0), rel=5e-3
    )
    run = fc.solve(scene.replace({"excitation.omega": omega, "reduction": "off"}), MPI.COMM_SELF)
    assert (
        run.watched_description.startswith("x displacement at ")
        and ", 0.4)" in run.watched_description
    )
    exact_amplitude = 2.0 * 0.782992 * 3.0 / (2.0 * 0.01 * omega**2)
    assert run.result.amplitude(run.watched_dof) == pytest.approx(exact_amplitude, rel=5e-3)


@pytest.mark.parametrize("way", ["sin", "cos"])
def test_far_above_all_resonances_the_plate_stands_still(way: str) -> None:
    """Nothing but inertia is left: the displacement against the clamp is -U but for the clamped
    row of elements, whose mass the full matrix couples to the clamp."""
    motion = [2e-3, -1e-3]
    shaken = [-1e18 * part for part in motion]
    scene = strip(base={f"acceleration_{way}": shaken}, excitation={"omega": 1e9})
    structure = fc.build_structure(scene)
    displacement = fc.solve_linear(structure, 1e9).displacement_coefficients[
        2 if way == "sin" else 1
    ]
    points, dofs = structure.nodes.points, structure.nodes.dofs  # type: ignore[union-attr]
    is_far = points[:, 1] > 0.5 * HEIGHT
    top_motion = displacement[dofs[is_far]]
    np.testing.assert_allclose(top_motion, np.tile(motion, (len(top_motion), 1)) * -1.0, rtol=1e-6)


def test_slowly_shaken_it_bends_under_its_weight() -> None:
    """Far below resonance a constant acceleration is a weight: w = rho A a L^4 / (8 E I)."""
    scene = strip(base={"acceleration_sin": [5.0, 0.0]}, excitation={"omega": 1e-3})
    run = fc.solve(scene.replace({"reduction": "off"}), MPI.COMM_SELF)
    deflection = DENSITY * 5.0 * HEIGHT**4 * 12.0 / (8.0 * 2.1e11 * WIDTH**2)
    assert run.result.amplitude(run.watched_dof) == pytest.approx(deflection, rel=5e-3)


def test_the_whole_plate_is_accelerated() -> None:
    """The load is -M R a: the mass of all elements but what the clamped nodes carry, half a row of
    elements of order 1."""
    mesh = {"layout": "grid", "columns": 2, "rows": 5, "order": 1}
    structure = fc.build_structure(strip(mesh=mesh, base={"acceleration_cos": [2.0, 3.0]}))
    mass = DENSITY * WIDTH * HEIGHT * THICKNESS * (1.0 - 0.5 / 5)
    dofs = structure.nodes.dofs  # type: ignore[union-attr]
    free_dofs = dofs[dofs[:, 0] >= 0]
    assert structure.force[1][free_dofs].sum(axis=0) == pytest.approx([-2.0 * mass, -3.0 * mass])
    assert not structure.force[[0, 2]].any()


CRACKED = {
    "crack": {"edge": "left", "height": 0.2, "length": 0.005},
    "contact": {"stiffness": 1e7},
    "mesh": {"layout": "grid", "columns": 2, "rows": 10, "order": 2},
    "harmonic_balance": {"harmonics": 5},
}


@pytest.mark.parametrize(
    ("tables", "key"),
    [
        ({"base": {}}, "base.acceleration_sin"),
        ({"base": {"acceleration_sin": [0.0, 0.0]}}, "base.acceleration_sin"),
        ({"base": {"acceleration_sin": 1.0}}, "base.acceleration_sin"),
        (
            {"base": {"acceleration_sin": [1, 0]}, "excitation": {"omega": 1, "force_sin": [1, 0]}},
            "excitation.force_sin",
        ),
        ({}, "excitation.point"),
    ],
)
def test_bad_motions_are_named(tables: dict[str, Any], key: str) -> None:
    """Both kinds, none, and a force nowhere."""
    catch_error(lambda: strip(**tables), key)


# --- forces, pressures and tractions --------------------------------------------------------------

PLAIN = {"layout": "grid", "columns": 4, "rows": 40, "order": 2}


def total(structure: fc.Structure, part: int) -> np.ndarray:
    """Sum of the nodal forces of a part of the load, in x and y."""
    dofs = structure.nodes.dofs  # type: ignore[union-attr]
    return np.asarray(structure.force[part][dofs[dofs[:, 0] >= 0]].sum(axis=0))


def test_pressures_and_tractions_add_up() -> None:
    """Their sums are those over the edges: p A towards the plate, T A along; area A = length times
    thickness. Of an edge of second-order elements the corner at the clamp carries 1/6 of its
    element."""
    loads = [
        {"edge": "top", "pressure_cos": 2e5, "traction_sin": [1e4, 3e4]},
        {"edge": "left", "pressure_mean": 5e4},
        {"point": [0.0, HEIGHT], "force_cos": [7.0, 1.0]},
    ]
    structure = fc.build_structure(strip(loads=loads, mesh=PLAIN))
    top, left_area = WIDTH * THICKNESS, (HEIGHT - HEIGHT / 40 / 6) * THICKNESS
    assert total(structure, 0) == pytest.approx([5e4 * left_area, 0.0], abs=1e-9)
    assert total(structure, 1) == pytest.approx([7.0, 1.0 - 2e5 * top], abs=1e-9)
    assert total(structure, 2) == pytest.approx([1e4 * top, 3e4 * top], abs=1e-9)


def test_a_bar_in_tension_and_a_beam_under_pressure() -> None:
    """u = T L / E at the end of a bar, w = q L^4 / (8 E I) of a beam, q = p t; far below any
    resonance, in one scene with two loads whose responses add up."""
    young, stress, pressure = 2.1e11, 3e6, 2e3
    loads = [
        {"edge": "top", "traction_cos": [0.0, stress]},
        {"edge": "right", "pressure_sin": pressure},
    ]
    scene = strip(loads=loads, mesh=PLAIN, excitation={"omega": 1e-3})
    scene = scene.replace({"damping.modes": 6, "reduction": "off"})
    run = fc.solve(scene, MPI.COMM_SELF)
    dof = run.structure.find_dof((0.5 * WIDTH, HEIGHT), "y")
    exact_elongation = stress * HEIGHT / young
    elongation = run.result.displacement_coefficients[1, dof]
    assert elongation == pytest.approx(exact_elongation, rel=2e-3)
    assert run.watched_dof == dof  # the middle of the first load's edge
    transverse_dof = run.structure.find_dof((0.5 * WIDTH, HEIGHT), "x")
    deflection = pressure * THICKNESS * HEIGHT**4 * 12.0 / (8.0 * young * WIDTH**3 * THICKNESS)
    assert run.result.displacement_coefficients[2, transverse_dof] == pytest.approx(
        -deflection, rel=1e-2
    )


def test_two_point_loads_are_one() -> None:
    """Two halves of a force at the same point are the force, also in a sweep's response, whose
    unit loads they take the place of."""
    single_scene = strip(**CRACKED | {"excitation": {
        "omega": 200.0, "point": [0.0, HEIGHT], "force_sin": [2.0, 0.0], "force_mean": [0.1, 0.0],
    }})  # fmt: skip
    half = {"point": [0.0, HEIGHT], "force_sin": [1.0, 0.0], "force_mean": [0.05, 0.0]}
    halves = strip(loads=[half, half], **CRACKED | {"excitation": {"omega": 200.0}})
    mixed_scene = single_scene.replace({
        "excitation.force_sin": [1.0, 0.0], "excitation.force_mean": [0.05, 0],
        "loads.1.point": [0.0, HEIGHT], "loads.1.force_sin": [1.0, 0.0],
        "loads.1.force_mean": [0.05, 0.0],
    })  # fmt: skip
    runs = [fc.solve(scene, MPI.COMM_SELF) for scene in (single_scene, halves, mixed_scene)]
    for run in runs[1:]:
        assert run.watched_dof == runs[0].watched_dof
        np.testing.assert_allclose(
            run.result.gap_coefficients, runs[0].result.gap_coefficients, rtol=1e-9, atol=1e-20
        )


def test_without_a_load_its_point_is_watched() -> None:
    """A force of 0 has no direction: it is x that is watched."""
    run = fc.prepare(strip(excitation={"omega": 200.0, "point": [0.0, HEIGHT]}))
    assert run.watched[0].dof == run.structure.find_dof((0.0, HEIGHT), "x")


def test_sweeps_over_loads(tmp_path: Path) -> None:
    """Keys are counted from 1; the response is the displacement of the excitation's point if it
    has a force, in its direction, else of the first load's."""
    first_load = {"omega": 200.0, "point": [0.0, HEIGHT], "force_sin": [1.0, 0.0]}
    second = {"point": [WIDTH, 0.3], "force_sin": [0.5, 0.0], "force_cos": [0.0, 0.2]}
    scene = strip(loads=[second], **CRACKED | {"excitation": first_load})
    values = [[0.5, 0.0], [2.0, 0.0]]
    sweep_axes = {"loads.1.force_sin": values, "excitation.force_sin": [[1.0, 0.0], [0.0, 0.0]]}
    sweep = run_sweep(
        scene.replace({"sweep.over": sweep_axes}),
        tmp_path / "s.h5",
        MPI.COMM_SELF,
        verdicts=False,
        judged=False,
    )
    assert sweep.converged.all()
    for i, value in enumerate(values):
        for j, (force, point) in enumerate(
            [([1.0, 0.0], (0.0, HEIGHT)), ([0.0, 0.0], (WIDTH, 0.3))]
        ):
            changes = {"loads.1.force_sin": value, "excitation.force_sin": force}
            run = fc.solve(scene.replace(changes), MPI.COMM_SELF)
            dof = run.structure.whole.find_dof(point, "x")
            amplitude = run.result.amplitude(dof)
            assert run.watched_dof == dof
            assert sweep["response"][i, j] == pytest.approx(amplitude, rel=1e-5)


def test_a_named_curve_of_a_mesh_file(tmp_path: Path) -> None:
    """The same loads on the same mesh, read from a file."""
    loads = [{"edge": "top", "pressure_cos": 2e5}, {"edge": "right", "traction_mean": [1.0, 2.0]}]
    plate = strip(loads=loads, mesh=PLAIN)
    fc.write_msh(plate, tmp_path / "strip.msh")
    tables = STRIP | {"loads": loads, "geometry": {"thickness": THICKNESS}}
    tables["mesh"] = {"layout": "file", "file": str(tmp_path / "strip.msh"), "order": 2}
    file_plate_structure, built_plate = (
        fc.build_structure(source) for source in (Scene.from_mapping(tables), plate)
    )
    for part in range(3):
        assert total(file_plate_structure, part) == pytest.approx(
            total(built_plate, part), abs=1e-9
        )


def test_every_part_of_the_load_is_drawn() -> None:
    """Each in a colour and under a name of its own."""
    loads = [{"edge": "top", "pressure_cos": 2e5}, {"edge": "right", "traction_mean": [1.0, 2.0]}]
    panel = fc.draw_mesh(fc.build_structure(strip(loads=loads, mesh=PLAIN))).axes[0]
    labels = panel.get_legend_handles_labels()[1]
    assert labels == ["clamped", "load, mean", "load, cosine part"]
    loads[1]["harmonics"] = [{"order": 2, "cos": [1.0, 0.0]}, {"order": 5, "sin": [9.0, 0.0]}]
    panel = fc.draw_mesh(fc.build_structure(strip(loads=loads, mesh=PLAIN))).axes[0]
    labels = panel.get_legend_handles_labels()[1]
    assert labels[-1] == "load, largest further harmonic" and len(labels) == 4


def test_loads_are_written_and_read() -> None:
    """As a list of tables; the round trip is exact."""
    loads = [{"edge": "top", "pressure_sin": 1e3}, {"point": [0.0, 0.1], "force_mean": [1.0, 2.0]}]
    scene = strip(loads=loads)
    text = scene.as_toml()
    assert text.count("[[loads]]") == 2 and Scene.from_text(text) == scene
    assert scene.replace({"loads": None, "base.acceleration_cos": [1.0, 0.0]}).loads == ()


@pytest.mark.parametrize(
    ("load", "key"),
    [
        ({}, "loads.1.edge"),
        ({"edge": "top"}, "loads.1.traction_sin"),
        ({"point": [0.0, 0.1]}, "loads.1.force_sin"),
        ({"point": [0.0, 0.1], "edge": "top", "force_sin": [1, 0]}, "loads.1.edge"),
        ({"point": [0.0, 0.1], "pressure_sin": 1.0}, "loads.1.pressure_sin"),
        ({"edge": "top", "force_sin": [1.0, 0.0]}, "loads.1.force_sin"),
        ({"point": [0.0, 9.0], "force_sin": [1.0, 0.0]}, "loads.1.point"),
        ({"point": [0.0, 0.0], "force_sin": [1.0, 0.0]}, "loads.1.point"),
        ({"edge": "up", "pressure_sin": 1.0}, "loads.1.edge"),
        ({"edge": "bottom", "pressure_sin": 1.0}, "loads.1.edge"),
        ({"edge": "top", "presure_sin": 1.0}, "loads.1.presure_sin"),
        ({"edge": "top", "traction_sin": 1.0}, "loads.1.traction_sin"),
        ({"edge": "top", "harmonics": [{"order": 2, "cos": [1.0, 0.0, 0.0]}]}, "loads.1.harmonics"),
    ],
    ids=str,
)
def test_bad_loads_are_named(load: dict[str, Any], key: str) -> None:
    """By their number in the scene."""
    catch_error(lambda: fc.build_structure(strip(loads=[load])), key)


def test_a_bad_harmonic_of_the_base_is_named() -> None:
    """Three components in a plane, on a table that is no list."""
    harmonics = [{"order": 2, "cos": [1.0, 0.0, 0.0]}]
    base = {"acceleration_sin": [0.0, 1.0], "harmonics": harmonics}
    catch_error(lambda: strip(base=base), "base.harmonics")


def loads_on(text: str, comm: MPI.Comm) -> tuple[list[float], str]:
    """Norms and sums of the parts of a scene's load, and what is watched."""
    run = fc.modes(Scene.from_text(text), 1, comm)
    force = run.structure.force
    sums = [comm.allreduce((force**2).sum(axis=1)), comm.allreduce(force.sum(axis=1))]
    return np.concatenate(sums).tolist(), run.watched_description


@pytest.mark.mpi
def test_on_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """The same forces and the same watched dof, however the mesh is shared."""
    loads = [{"edge": "left", "pressure_cos": 2e5}, {"point": [WIDTH, 0.3], "force_sin": [7, 1]}]
    text = strip(loads=loads, mesh=PLAIN, base={"acceleration_sin": [1.0, 2.0]}).as_toml()
    (parallel_totals, name), (serial_totals, serial_name) = (
        on_ranks(loads_on, text),
        loads_on(text, MPI.COMM_SELF),
    )
    assert name == serial_name
    assert parallel_totals == pytest.approx(serial_totals, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("place", ["excitation", "loads.1"])
def test_on_a_crack_there_are_two_lips(place: str) -> None:
    """A load there is refused, with a place on either; these are taken, and the tip, which is one
    node."""
    scene = Scene.load(ROOT / "benchmarks" / "plate.toml").replace({"mesh.size": 0.05})
    changes = {f"{place}.point": [0.01, 0.15], f"{place}.force_sin": [0.0, 1.0]}
    error = catch_error(lambda: fc.build_structure(scene.replace(changes)), f"{place}.point")
    lower_point, upper_point = ([0.01, y] for y in (0.14997, 0.15003))
    assert f"{lower_point} on the lower face, or {upper_point} on the upper face" in error.allowed
    openings = []
    for point in (lower_point, upper_point, [0.03, 0.15]):
        structure = fc.build_structure(scene.replace(changes | {f"{place}.point": point}))
        openings.append(structure.apply_bt(structure.force[2:])[0].sum())
    assert openings[0] > 0.0 > openings[1]  # B^T f: a push up at the lower lip closes


def test_on_a_crack_that_slopes_or_lies_inside() -> None:
    """By the lips of the mesh; both ends of a crack inside are tips."""
    inner_crack_scene = Scene.load(ROOT / "benchmarks" / "plate.toml").replace(
        {"crack.edge": None, "crack.center": 0.05, "mesh.size": 0.05}
    )
    for x, is_accepted in ((0.035, True), (0.0351, False), (0.05, False), (0.065, True)):
        scene = inner_crack_scene.replace({"excitation.point": [x, 0.15]})
        if is_accepted:
            fc.build_structure(scene)
        else:
            catch_error(partial(fc.build_structure, scene), "excitation.point")
    sloping_scene = Scene.load(DEMOS / "inclined_crack.toml")
    points = fc.build_structure(sloping_scene).pair_points
    middle = 0.5 * (points[0] + points[1])
    error = catch_error(
        lambda: fc.build_structure(sloping_scene.replace({"excitation.point": middle.tolist()})),
        "excitation.point",
    )
    places = re.findall(r"\[([-\d.e]+), ([-\d.e]+)\] on the", error.allowed)
    lower_point, upper_point = np.array(places, dtype=float)
    crack_normal = np.array([points[0][1] - points[1][1], points[1][0] - points[0][0]])
    assert (lower_point - middle) @ crack_normal < 0.0 < (upper_point - middle) @ crack_normal
