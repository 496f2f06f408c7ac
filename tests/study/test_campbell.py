"""Campbell diagrams: frequencies over the speed and the orders that they meet."""

from __future__ import annotations

import csv
import json
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import catch_error, dense
from rotating import CRACKED, UNIT, cracked, strip
from scipy.optimize import nnls
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import eigsh, splu
from surroundings import DEMOS, RunCommand

import fenics_crack as fc
from fenics_crack import Scene


def test_frequencies_are_those_of_each_speed() -> None:
    """One mesh and one basis for all speeds give what a scene of each speed does, lips open and
    tied, also between the speeds whose modes are in the basis: to rounding of its projection."""
    scene = cracked(100.0)
    campbell = fc.campbell(scene, [0.0, 130.0, 400.0], 2)
    for row, speed in enumerate(campbell.speed):
        plate = fc.build_structure(scene.replace({"rotation.speed": float(speed)}))
        assert campbell.omega_open[row] == pytest.approx(fc.solve_modes(plate, 2).omega, rel=1e-8)
        bonded_omega = fc.solve_modes(plate, 2, lips="tied").omega
        assert campbell.omega_tied[row] == pytest.approx(bonded_omega, rel=1e-8)
    bilinear = 2.0 / (1.0 / campbell.omega_open + 1.0 / campbell.omega_tied)
    assert campbell.omega_bilinear == pytest.approx(bilinear)
    assert np.all(np.diff(campbell.omega_open, axis=0) > 0.0)


def test_between_speeds() -> None:
    """Squares w^2 = a + b W^2 are met everywhere; d ln w / d ln W is b W^2 / w^2."""
    speeds = np.array([0.0, 60.0, 100.0, 180.0])
    is_open, bonded_omega = (np.sqrt(4e4 * a + 2.0 * speeds[:, None] ** 2) for a in (1.0, 2.0))
    kinds = np.full(is_open.shape, "open")
    diagram = fc.Campbell(
        cracked(100.0), speeds, is_open, bonded_omega, is_open, True, kinds, (), np.zeros(1)
    )
    for speed in (30.0, 90.0, 175.0):
        squares = np.array([4e4, 8e4]) + 2.0 * speed**2
        assert np.ravel(diagram.interpolate_open_and_tied(speed)) ** 2 == pytest.approx(
            squares, rel=1e-12
        )
        stiffening = diagram.stiffening(speed, float(np.sqrt(squares[0])))
        assert stiffening == pytest.approx(2.0 * speed**2 / squares[0], rel=1e-12)


def test_orders_meet_the_modes_where_a_scene_resonates() -> None:
    """At a crossing the natural frequency of a structure built there is order times the speed; a
    beam whose w^2 is linear in W^2 meets order n at w_0 / sqrt(n^2 - S)."""
    campbell = fc.campbell(strip(1, 1.0), np.linspace(0.0, 4.0 * UNIT, 5), 2)
    assert not campbell.cracked and "omega_tied" not in campbell.to_dict()
    [[mode, speed]] = campbell.crossings(3)
    assert mode == 1
    [omega] = fc.solve_modes(fc.build_structure(strip(1, speed / UNIT)), 1).omega
    assert omega == pytest.approx(3.0 * speed, rel=1e-3)
    assert speed == pytest.approx(3.516 * UNIT / np.sqrt(9.0 - 2.764), rel=0.01)
    assert not len(campbell.crossings(1))  # the first mode stays above W: S > 1


@pytest.mark.drawn(2)
@pytest.mark.parametrize(
    ("speed", "mean", "force", "does"),
    [
        (0.0, 0.0, 20.0, "bilinear"), (0.0, 300.0, 0.01, "open"), (0.0, -300.0, 0.01, "tied"),
        (600.0, 0.0, 0.01, "open"), (600.0, 0.0, 500.0, "bilinear"),
    ],
)  # fmt: skip
def test_a_crack_that_is_held_is_not_bilinear(
    speed: float, mean: float, force: float, does: str
) -> None:
    """Rotation and a mean load hold it open or shut under a small load, not under a large one; as
    the solution at that resonance says."""
    scene = cracked(max(speed, 1.0), mean).replace({"excitation.force_sin": [force, 0.0]})
    speeds = [max(speed, 1.0), speed + 10.0]
    campbell = fc.campbell(scene, speeds, 1)
    assert campbell.kind[0, 0] == does
    omega = float(campbell.omega_in_actual_state[0, 0])
    assert omega == getattr(campbell, f"omega_{does}")[0, 0]
    blade = fc.prepare(scene.replace({"excitation.omega": omega}))
    solution = fc.solve_harmonic_balance(blade.structure, omega, blade.contact, harmonics=8)
    share = solution.indicators(0).closed_share
    assert {"open": share == 0.0, "tied": share == 1.0}.get(does, 0.0 < share < 1.0)


@pytest.mark.nightly
def test_a_crack_that_is_held_partly_open() -> None:
    """A steady load that presses one crack together and opens another, under a small load: neither
    breathes, and the frequency is that with stiff springs across the gaps of the pressed pairs."""
    other_crack = {"cracks.1.edge": "right", "cracks.1.height": 0.07, "cracks.1.length": 0.006}
    other_crack["excitation.force_sin"] = [1e-3, 0.0]
    scene = cracked(200.0, -600.0).replace(other_crack)
    campbell = fc.campbell(scene, [200.0, 210.0], 1)
    plate = fc.build_structure(scene)
    stiffness, mass = (csc_matrix(dense(matrix)) for matrix in (plate.stiffness, plate.mass))
    gap, flexible = plate.gap.toarray(), splu(stiffness)
    # Forces that pull nowhere, of least energy: those of lips that do not overlap.
    root = np.linalg.cholesky(gap.T @ flexible.solve(gap))
    pressing_forces, _ = nnls(root.T, np.linalg.solve(root, gap.T @ flexible.solve(plate.force[0])))
    assert {*plate.pairs.cracks[pressing_forces > 0.0]} == {0} and np.all(
        pressing_forces[plate.pairs.cracks == 0]
    )
    ties = plate.gap[:, pressing_forces > 0.0]
    tied_stiffness = stiffness + 1e6 * stiffness.max() * (ties @ ties.T)
    [square], _ = eigsh(tied_stiffness.tocsc(), 1, mass, sigma=0.0)
    assert campbell.kind.tolist() == [["partly"], ["partly"]]
    assert campbell.omega_in_actual_state[0, 0] == pytest.approx(np.sqrt(square), rel=1e-6)
    rows = campbell.to_dict()
    assert rows["crack"] == 2 * ["held partly open"] and len(rows["frequency_partly"]) == 2
    louder = fc.campbell(scene.replace({"excitation.force_sin": [100.0, 0.0]}), [200.0, 210.0], 1)
    assert louder.kind.tolist() == [["bilinear"], ["bilinear"]]
    assert "frequency_partly" not in louder.to_dict()


@pytest.mark.nightly
@pytest.mark.parametrize("top", [430.0, 700.0])
def test_states_follow_each_other(top: float) -> None:
    """A crack that rotation opens pair by pair is held shut, partly open and open, and changes from
    one to another only with a range of breathing, or none that matters, between."""
    scene = cracked(300.0, -300.0).replace({"excitation.force_sin": [1e-4, 0.0]})
    campbell = fc.campbell(scene, [300.0, top], 1)
    speeds = [300.0, *(speed for _, speed, _ in campbell.changes), top]
    kinds = [campbell.kind[0, 0], *(kind for *_, kind in campbell.changes)]
    assert kinds[-1] == campbell.kind[1, 0] and np.all(np.diff(speeds) > 0.0)
    for lower_speed, upper_speed, kind in zip(speeds, speeds[1:], kinds, strict=False):
        if upper_speed - lower_speed > 1.0:
            middle = 0.5 * (lower_speed + upper_speed)
            assert fc.campbell(scene, [middle, top], 1).kind[0, 0] == kind


@pytest.mark.drawn(1)
@pytest.mark.parametrize(
    ("mean", "does"), [(0.0, "open"), (-300.0, "changes"), (-600.0, "bilinear"), (-900.0, "tied")]
)
def test_a_crossing_has_the_state_of_the_crack_at_it(mean: float, does: str) -> None:
    """Whatever the speeds between which it lies: on the line of that state, or at the speed at
    which the crack changes, which a diagram of two speeds next to it has, too; the drawn line goes
    through it, and rises but where the crack changes."""
    scene = cracked(1.0, mean).replace({"excitation.force_sin": [0.5, 0.0]})
    wide_campbell = fc.campbell(scene, [0.0, 1200.0], 1)
    [[_, speed]], [text] = (
        wide_campbell.crossings(12, "real"),
        wide_campbell.yield_crossing_texts(12),
    )
    near_campbell = fc.campbell(scene, [0.99 * speed, 1.01 * speed], 1)
    assert near_campbell.crossings(12, "real")[:, 1] == pytest.approx([speed], rel=1e-4)
    if does == "changes":
        assert near_campbell.kind[:, 0].tolist() == ["bilinear", "open"]
        assert "with the crack breathing before and held open after" in text
    else:
        assert near_campbell.kind[:, 0].tolist() == [does, does]
        assert wide_campbell.crossings(12, does)[0, 1] == speed
        words = {"open": "held open", "tied": "held shut"}
        state = words.get(does, "breathing (bilinear estimate)")
        assert f"with the crack {state}; the speed would be" in text
    speeds, omega, kinds = map(np.array, zip(*wide_campbell.list_actual_state_line(1), strict=True))
    steps = np.diff(speeds) == 0.0
    assert steps.sum() == len(wide_campbell.changes) > 0
    assert np.all(np.diff(omega)[~steps] > 0.0) and np.all(np.diff(omega)[steps] < 0.0)
    assert np.all(kinds[1:][~steps] == kinds[:-1][~steps])
    [panel] = fc.draw_campbell(wide_campbell, [12], in_hertz=False, in_rpm=False).axes
    [ring] = [line for line in panel.lines if line.get_marker() == "o"]
    assert ring.get_xydata() == pytest.approx(np.array([[speed, 12.0 * speed]]))
    assert panel.lines[0].get_xydata() == pytest.approx(np.column_stack([speeds, omega]))


BAR = """
[geometry]
kind = "solid"
width = 0.01
height = 0.1
thickness = 0.0098
[material]
young = 2.1e11
poisson = 0.3
density = 7850.0
[damping]
ratio = 0.005
[crack]
edge = "left"
height = 0.02
length = 0.004
[contact]
law = "unilateral"
[rotation]
speed = 300.0
hub_radius = 0.2
[excitation]
order = 8
[[loads]]
edge = "left"
pressure_cos = 1e4
[mesh]
layout = "graded"
order = 2
size = 0.01
lip_elements = 2
error = false
"""


@pytest.mark.nightly
def test_a_tie_that_takes_a_mode_past_another() -> None:
    """Bending across the crack is the lower mode of a nearly square bar with lips open, and the
    higher one with lips tied: both frequencies of each direction in which the tip moves are told
    together, also of the first mode alone."""
    scene = Scene.from_text(BAR)
    bar = fc.build_structure(scene)
    tip = bar.nodes.dofs[np.argmax(bar.nodes.points[:, 1])][[0, 2]]
    along = {}
    for lips in ("open", "tied"):
        modes = fc.solve_modes(bar, 2, lips=lips)
        along[lips] = dict(zip(np.abs(modes.shapes[tip]).argmax(axis=0), modes.omega, strict=True))
    assert [*along["open"]] == [0, 1] and [*along["tied"]] == [1, 0]
    for count in (1, 2):
        campbell = fc.campbell(scene, [300.0, 310.0], count)
        for told, lips in ((campbell.omega_open, "open"), (campbell.omega_tied, "tied")):
            expected = [along[lips][direction] for direction in range(count)]
            assert told[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.nightly
def test_crossings_between_speeds_far_apart() -> None:
    """Where two modes of a bar turn away from each other, their squares are far from linear in W^2:
    what two speeds tell is where a structure that is built there resonates, and what nine tell."""
    changes = {"crack": None, "contact": None, "geometry.thickness": 0.0104}
    scene = Scene.from_text(BAR).replace(changes | {"mesh.lip_elements": None})
    two, nine = (fc.campbell(scene, np.linspace(0.0, 2500.0, n), 2) for n in (2, 9))
    for order in (5, 6):
        crossings = two.crossings(order, "open")
        assert len(crossings) == 2 and crossings == pytest.approx(
            nine.crossings(order, "open"), rel=1e-4
        )
        for mode, speed in crossings:
            bar = fc.build_structure(scene.replace({"rotation.speed": float(speed)}))
            omega = fc.solve_modes(bar, 2).omega[int(mode) - 1]
            assert omega == pytest.approx(order * speed, rel=1e-4)


def test_bad_input() -> None:
    """Each error names what is wrong."""
    scene = strip(0, 1.0)
    diagram = fc.campbell(scene, [0.0, UNIT], 1)
    catch_error(lambda: fc.campbell(Scene.from_mapping(CRACKED), [0.0, 1.0]), "rotation", None)
    catch_error(lambda: fc.campbell(scene, [1.0, 0.0]), "speeds", [1.0, 0.0])
    catch_error(lambda: fc.campbell(scene, [0.0, 1.0], 0), "count", 0)
    catch_error(lambda: fc.campbell(scene, [0.0, 1.0], 10**6), "count", 10**6)
    catch_error(lambda: diagram.crossings(0), "order", 0)
    catch_error(lambda: diagram.crossings(1, "closed"), "kind", "closed")
    catch_error(lambda: fc.draw_campbell(diagram, [0]), "orders", 0)


def test_speeds_that_are_too_fast() -> None:
    """However fast, the plate is said to be unstable, and NumPy has nothing to warn of."""
    scene = Scene.load(DEMOS / "rotating_blade.toml")
    for fastest in (1e5, 1e8):
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            call = partial(fc.campbell, scene, [0.0, 0.5 * fastest, fastest], 2)
            assert catch_error(call, "rotation.speed").value > 0.0


def test_picture_reaches_as_far_as_the_orders() -> None:
    """Orders up to 8 meet the first mode of a beam at 4 UNIT, up to 20 both; 1 meets none."""
    campbell = fc.campbell(strip(0, 1.0), np.linspace(0.0, 4.0 * UNIT, 3), 2)
    for orders, modes in ((range(1, 3), 1), (range(1, 9), 2), ([1], 1), ([], 1)):
        [panel] = fc.draw_campbell(campbell, orders).axes
        labels = panel.get_legend_handles_labels()[1]
        assert labels == ["mode 1", "mode 2"][:modes]
        highest_frequency = campbell.omega_open[:, :modes].max() / (2.0 * np.pi)
        assert panel.get_ylim()[1] == pytest.approx(1.08 * highest_frequency)


def test_how_a_frequency_follows_the_speed() -> None:
    """Between speeds and beyond them, by its values at those beside it, of what the crack does."""
    speeds = 600.0 * np.exp([-0.01, 0.0, 0.01])
    scene = cracked(1.0).replace({"excitation.order": 12})
    campbell, wide_campbell = (
        fc.campbell(scene, speed_list, 2) for speed_list in (speeds, [300.0, 590.0])
    )
    assert campbell.kind[1].tolist() == ["bilinear", "open"]
    for line in campbell.omega_in_actual_state.T:
        slope = float(np.log(line[2] / line[0]) / 0.02)
        for diagram in (campbell, wide_campbell):
            assert diagram.stiffening(600.0, 1.01 * line[1]) == pytest.approx(slope, rel=5e-3)


def test_command(run_command: RunCommand, tmp_path: Path) -> None:
    """Table, files and picture; speeds in the scene's unit; each crossing of the scene's order."""
    scene = cracked(1.0).replace({"rotation.rpm": 6e3, "excitation.order": 12})
    words = ["campbell", scene, "--output", tmp_path, "--count", 1, "--speeds"]
    process = run_command(*words, 4000, 8000, 3)
    assert "rpm" in process.out and "engine order 12 meets mode 1" in process.err
    assert "with the crack breathing (bilinear estimate); the speed would be" in process.err
    assert "rpm with the crack held open" in process.err
    assert "; at this speed 1 % more speed changes the frequency by 0.0" in process.err
    rows = list(csv.DictReader((tmp_path / "campbell.csv").open()))
    assert [float(row["rpm"]) for row in rows] == pytest.approx([4e3, 6e3, 8e3])
    assert json.loads((tmp_path / "campbell.json").read_text())[0]["mode"] == 1
    assert (tmp_path / "campbell.png").stat().st_size > 10_000
    expected_end = (
        "1 mode found between 4000 and 4100 rpm; engine order 12 meets none of these modes"
    )
    assert expected_end in run_command(*words, 4000, 4100, 2).err
    for wrong_speeds in ([8000, 4000, 3], [0, 1, 1.5]):
        run_command(*words, *wrong_speeds, code=2)


def test_a_blade_of_few_modes_has_all_of_them() -> None:
    """Where how many is not asked for: a command's six, and ten of a record's passages, were
    refused by a number that nobody gave."""
    mesh = {"layout": "grid", "cells": "quadrilateral", "columns": 1, "rows": 2, "order": 1}
    scene = strip(0.0, 1.0, mesh=mesh)
    assert fc.campbell(scene, [200.0, 300.0], few=10).omega_open.shape == (2, 8)
    assert fc.campbell(scene, [200.0, 300.0]).omega_open.shape == (2, 4)
    catch_error(lambda: fc.campbell(scene, [200.0, 300.0], 10), "count", 10, names="1 to 8")
