"""What is printed of a result: few lines, one of each kind, and no advice that is followed; keys
and values in words, and pictures of sweeps."""

import json
import re
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import DEMOS, wrap
from ranks import LIMIT
from surroundings import RunCommand, main

import fenics_crack as fc
from fenics_crack import ErrorReport, SweepResult
from fenics_crack.basics.progress import StageLineHandler
from fenics_crack.basics.tables import Table
from fenics_crack.cli import pictures
from fenics_crack.cli.account import (
    PROPOSED_TOLERANCE_OPTION,
    yield_instability_warning,
    yield_large_error_warning,
)
from fenics_crack.cli.curves import _find_undecided_index_ranges, shorten_special_points
from fenics_crack.cli.studies import (
    list_skipped_peak_remarks,
    shorten_sweep_table,
    yield_sweep_warnings,
)
from fenics_crack.draw import plot
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.words import describe_differences, key_in_words, value_in_words
from fenics_crack.sweep import result
from fenics_crack.sweep.file import UNIT_AND_NUMPY_TYPE_BY_COLUMN, CaseState

pytestmark = pytest.mark.usefixtures("not_drawn")

PAPER = DEMOS / "paper_plate.toml"
ZERO = {"residual": 0.0, "truncation": 0.0, "sampling": 0.0, "reduction": 0.0, "penetration": 0.0}
FIXED = {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 15}
COARSE = {"mesh.size": 0.03, "mesh.lip_elements": 6, "contact.friction_error": False}
STIFF = {"contact.law": "penalty", "contact.stiffness": 1e14}
RANGE = ["contact.stiffness=1e9", "damping.ratio=0.02", "curve.start=2200", "curve.stop=2300"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> fc.Scene:
    """A new one: steel, with a tolerance."""
    path = tmp_path_factory.mktemp("new") / "plate.toml"
    assert main(["new", str(path), "--quiet"]) == 0
    return fc.Scene.load(path).replace(COARSE)


@pytest.mark.parametrize(
    ("part", "changes", "harmonics", "advice"),
    [
        ("truncation", FIXED, 15, "more harmonics: --set harmonic_balance.tolerance=1e-2 chooses"),
        ("truncation", {}, 15, "a smaller harmonic_balance.tolerance"),
        ("truncation", {}, 100, "H is at its limit"),
        ("reduction", {}, 15, "more modes (reduction.modes)"),
        ("sampling", FIXED, 15, "more samples"),
        ("residual", FIXED, 15, "a load that opens the crack further"),
        ("residual", FIXED | STIFF, 15, "contact.law = 'unilateral'"),
    ],
)
def test_advice_is_by_the_largest_part(
    scene: fc.Scene, part: str, changes: dict[str, Any], harmonics: int, advice: str
) -> None:
    """And is not what the scene does already."""
    report = ErrorReport(**(ZERO | {part: 0.2}))
    [text] = yield_large_error_warning(scene.replace(changes), report, harmonics, " at 800 Hz")
    assert "gap is 20 % at 800 Hz, mostly due to" in text and advice in text
    unknown = ErrorReport(**(ZERO | {part: 1.5}))
    [text] = yield_large_error_warning(scene.replace(changes), unknown, harmonics, " at 800 Hz")
    assert "unknown at 800 Hz: the estimate for" in text and advice in text
    small_report = ErrorReport(**(ZERO | {part: 0.02}))
    assert not [*yield_large_error_warning(scene, small_report, harmonics)]


def test_undecided_stretches_of_a_curve() -> None:
    """The longest first, also at the ends; none of what is not judged."""
    undecided_mask = np.array([True, False, True, True, True, False, True])
    curve: Any = SimpleNamespace(is_undecided=undecided_mask)
    ranges = _find_undecided_index_ranges(curve)
    assert ranges == [(2, 4), (0, 0), (6, 6)]
    curve.is_undecided = None
    assert _find_undecided_index_ranges(curve) == []


def test_undecided_orbit(scene: fc.Scene) -> None:
    """No advice to choose a tolerance where there is one, nor to damp what is damped."""
    undecided_verdict, run = (
        fc.Stability(np.array([1.0 + 0j]), "undecided", np.nan),
        SimpleNamespace(),
    )
    run.structure = None
    for multiplier, way in (
        (1.5, "with another amplitude"), (-1.5, "two periods of the load"),
        (1.0 + 1j, "does not repeat each period"),
    ):  # fmt: skip
        unstable = fc.Stability(np.array([multiplier + 0j]), "unstable", 0.0)
        [told] = yield_instability_warning(scene, run, unstable)
        assert way in told
    told = replace(undecided_verdict, reason="no exact orbit was found next to it")
    words = "the stability of the orbit is undecided"
    because = f"{words} (no exact orbit was found next to it)"
    advice = f"{because}; --set harmonic_balance.tolerance=1e-2 may decide it"
    for given, one, said in (
        (scene, undecided_verdict, words), (scene, told, because),
        (scene.replace(FIXED), told, advice),
    ):  # fmt: skip
        assert [*yield_instability_warning(given, run, one)] == [said]


def test_five_bifurcations_at_most() -> None:
    """Those with the larger response, in order along the curve."""
    rows = [(name, 0.0, 1.0) for name in ("start", "end", "largest")]
    rows += [(f"fold {number}", 0.0, float(number)) for number in range(14)]
    rows += [("stability lost after", 0.0, 99.0)] * 4
    curve = SimpleNamespace(bifurcations=14 * [SimpleNamespace(kind="fold")], multipliers=1)
    curve.verdicts = np.array(["stable", "unstable"])
    run: Any = SimpleNamespace(result=curve)
    shown_points, hidden = shorten_special_points(
        run, Table(("point", "omega", "amplitude [m]"), rows)
    )
    assert [row[0] for row in shown_points.rows[3:]] == [f"fold {n}" for n in (9, 10, 11, 12, 13)]
    assert hidden == 13
    few_points = Table(("point", "omega", "amplitude [m]"), rows[:4])
    assert shorten_special_points(run, few_points) == (few_points, 0)


def swept(scene: fc.Scene, path: Path) -> SweepResult:
    """186 cases of which some have failed, in two ways that differ in numbers alone."""
    axes = {
        "excitation.frequency": {"start": 480.0, "stop": 960.0, "count": 31},
        "crack.length": [0.01, 0.02, 0.03, 0.04, 0.05, 0.06],
    }
    scene = scene.replace({"sweep.over": axes})
    generator = np.random.default_rng(0)
    columns: dict[str, np.ndarray] = {
        name: generator.random((31, 6)) for name in UNIT_AND_NUMPY_TYPE_BY_COLUMN
    }
    columns["state"] = np.full((31, 6), CaseState.CONVERGED)
    columns["verdict"] = generator.choice(["stable", "unstable", "undecided"], (31, 6))
    columns["status"] = np.full((31, 6), "full Newton steps", dtype=object)
    for place in ((0, 1), (3, 3), (8, 2)):
        columns["state"][place] = CaseState.FAILED
        columns["response"][place] = np.nan
        columns["status"][place] = f"no convergence, |F| = {generator.random()}"
    columns["state"][5, 5], columns["status"][5, 5] = CaseState.FAILED, "singular"
    columns["response"][5, 5] = np.nan
    return SweepResult(path, scene, columns)


def test_sweep_fits_on_one_screen(
    scene: fc.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: RunCommand
) -> None:
    """31 x 6 cases in at most 40 lines of 120 columns, with the largest response of each length."""
    sweep = swept(scene, tmp_path / "sweep.h5")
    monkeypatch.setattr(result, "run_sweep", lambda *given, **options: sweep)
    out, err = run_command("sweep", sweep.scene, "--output", tmp_path, code=3)
    lines = (out + err).splitlines()
    assert sum(1 + (len(line) - 1) // 120 for line in lines) <= 40
    assert all(len(line) <= 120 for line in out.splitlines())
    peaks = np.nanargmax(sweep["response"], axis=0)
    table = [line.split() for line in out.splitlines()[2:]]
    assert len(table) == 6
    frequencies = sweep.axes[0].values
    for row in table:
        length = sweep.axes[1].values.index(float(row[1]))
        assert float(row[0]) == frequencies[peaks[length]]
        assert row[2] == "converged"
    assert "cases: 182 converged, 4 failed; the table has the largest responses over" in err
    assert "3 cases failed, the first at frequency = 480.0, length = 0.02: no convergence" in err
    assert err.count("failed, the first at") == 2 and "unstable and" in err
    assert "a smaller harmonic_balance.tolerance" in err  # not: more harmonics


@pytest.mark.nightly
def test_sweep_of_few_modes(
    scene: fc.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: RunCommand
) -> None:
    """Loads at natural frequencies that two modes do not have, and at one where twenty are few: the
    cases are told as solve tells the largest of them, and marked in pictures; none is whose error
    was not asked for."""
    few_modes = {"reduction.modes": 2, "reduction.method": "massless"}
    axes = {"reduction.modes": [2, 20], "excitation.frequency": [800.0, 3205.0, 4232.0]}
    swept_scene, lines = scene.replace(FIXED | few_modes | {"sweep.over": axes}), []
    for command, sets, code in (("solve", ["excitation.frequency=4232.0"], 4), ("sweep", [], 0)):
        err = run_command(command, swept_scene, "--output", tmp_path, sets=sets, code=code).err
        lines += [
            line.partition("warning: ")[2] for line in err.split("\n") if "more modes" in line
        ]
    place_text = "3 cases with an error above 5 %, the largest at modes = 2, frequency = 4232.0"
    assert "for truncated modes" in lines[0] and lines[1:] == [f"{place_text}: {lines[0]}"]
    sweep = SweepResult.load(tmp_path / "sweep.h5")
    assert sweep.inexact.tolist() == [[False, True, True], [False, False, True]]
    tolerance_scene = swept_scene.replace({"harmonic_balance.tolerance": 0.01})
    sentence, depends = yield_sweep_warnings(replace(sweep, scene=tolerance_scene))
    assert "a verdict on stability that depends on truncated modes" in depends
    assert sentence.startswith("6 cases with an error above 1 %, the largest at modes = 2, ")
    drawing_mock = Mock(wraps=plot.draw_response)
    monkeypatch.setattr(plot, "draw_response", drawing_mock)
    run_command("plot", tmp_path / "sweep.h5", "--output", tmp_path, "--quiet")
    marked_cases = [
        call.kwargs["doubtful"]["modes kept 2"].tolist() for call in drawing_mock.call_args_list
    ]
    assert marked_cases and all(rings == [False, True, True] for rings in marked_cases)
    unjudged_sweep = fc.run_sweep(swept_scene, judged=False)
    assert not unjudged_sweep.inexact.any() and not [*yield_sweep_warnings(unjudged_sweep)]


def test_verdicts_that_say_nothing_are_said_once(scene: fc.Scene, tmp_path: Path) -> None:
    """All cases undecided: a line instead of a column."""
    sweep = swept(scene, tmp_path / "sweep.h5")
    sweep.columns["verdict"][:] = "undecided"
    assert "verdict" not in shorten_sweep_table(sweep)[0].columns
    sweep.columns["status"][:] = "full Newton steps; undecided: no exact orbit was found"
    warnings = [*yield_sweep_warnings(sweep)]
    assert "the stability is undecided in all cases" in warnings
    assert [text for text in warnings if text.startswith("182 cases")] == [
        "182 cases undecided, the first at frequency = 480.0, length = 0.01: no exact orbit was "
        "found"
    ]


def test_a_peak_between_two_frequencies(scene: fc.Scene, tmp_path: Path) -> None:
    """An oscillator at steps of 16 Hz: told where its peak is narrower, not of one that is wider,
    nor of an antiresonance, where the phase comes back."""
    sweep = swept(scene, tmp_path / "sweep.h5")
    frequency = np.linspace(480.0, 960.0, 31)[:, None]
    sweep.columns["omega"][:] = 2.0 * np.pi * frequency
    for damping, power, told in ((0.001, -1, 1), (0.03, -1, 0), (0.001, 1, 0)):
        wave = (1.0 - (frequency / 729.0) ** 2 + 2j * damping * frequency / 729.0) ** power
        sweep.columns["sine_1"][:], sweep.columns["cosine_1"][:] = wave.real, wave.imag
        texts = list_skipped_peak_remarks(sweep)
        assert len(texts) == told
        for text in texts:
            assert "between 720 and 736 Hz, length = 0.01, and at 5 other places, the" in text


def test_a_peak_between_two_speeds(tmp_path: Path) -> None:
    """Of a load at one frequency, whose resonance passes it, in whatever order speeds are swept."""
    blade = fc.Scene.from_text(
        """
        geometry = { width = 0.1, height = 0.3, thickness = 0.002 }
        crack = { edge = "left", height = 0.15, length = 0.025 }
        contact = { law = "unilateral" }
        material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
        damping = { ratio = 0.002 }
        rotation = { rpm = 3000.0, hub_radius = 0.2 }
        excitation = { frequency = 870.0, point = [0.1, 0.3], force_sin = [10.0, 0.0] }
        mesh = { layout = "grid", columns = 4, rows = 12, order = 2 }
        harmonic_balance = { harmonics = 3 }
        reduction = { modes = 8 }
        """
    )
    speeds = {"sweep.over": {"rotation.rpm": [12000.0, 3000.0, 9000.0]}}
    [text] = list_skipped_peak_remarks(fc.run_sweep(blade.replace(speeds), tmp_path / "sweep.h5"))
    assert text.startswith("between 9000 and 12000 rpm, the sweep steps over a peak")


def test_large_is_what_rotates(scene: fc.Scene, tmp_path: Path, run_command: RunCommand) -> None:
    """A slender blade that moves by 2 % of its length, half its thickness, is linear to 0.04 %; by
    20 % it is not. So says ``check`` before."""
    sides = {"geometry.width": 0.004, "geometry.height": 0.1, "crack.height": 0.02}
    size = {"crack.length": 0.001, "mesh.size": 0.004, "mesh.lip_elements": 2, "mesh.error": False}
    load = {"excitation.point": [0.004, 0.1], "excitation.frequency": 340.0, "sweep": None}
    few_settings = FIXED | {"harmonic_balance.harmonics": 3, "reduction.modes": 5, "curve": None}
    blade = scene.replace(sides | size | load | few_settings)
    unit = 10.0 / fc.solve(blade).amplitude()
    for share, warns in ((0.02, False), (0.2, True)):
        force = [f"excitation.force_sin=[{unit * share * 0.1}, 0.0]"]
        for command in (["check", blade], ["solve", blade, "--output", tmp_path / "out"]):
            messages = run_command(*command, sets=force).err
            assert ("beyond small displacements" in messages) == warns, command


def test_errors_without_the_mesh_are_told_of_every_number(
    tmp_path: Path, run_command: RunCommand
) -> None:
    """Also where the amplitude is not among those that are asked for."""
    options = ["damping.ratio=0.05", "contact.stiffness=1e9", "harmonic_balance.harmonics=5"]
    options += ["output.quantities=['ratio_2_1']", "mesh.error=false"]
    process = run_command("solve", PAPER, "--output", tmp_path, sets=options)
    assert "harmonic ratio 2/1" in process.out and "half peak-to-peak" not in process.out
    assert "error due to the mesh not included: mesh.error = false" in process.err


@pytest.mark.nightly
def test_a_steady_load_moves_nothing(
    scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """Whether it opens the crack or closes it: amplitude and harmonics are 0, not rounding, and the
    file is read again, though all gaps of closed lips are rounding."""
    folder, mean_settings = (
        tmp_path / "out",
        {"excitation.force_sin": [0.0, 0.0], "mesh.error": False},
    )
    for force, closed in ((1400.0, 0.0), (-1400.0, 1.0)):
        held_scene = scene.replace(mean_settings | {"excitation.force_mean": [force, 0.0]})
        messages = run_command("solve", held_scene, "--output", folder).err
        assert "nothing vibrates" in messages and "estimated error" not in messages
        run = fc.load_run(folder / "solution.h5")
        indicators = run.result.indicators(run.watched_dof)
        assert indicators.amplitude == indicators.harmonic_1 == indicators.harmonic_2 == 0.0
        assert indicators.closed_share == closed and abs(indicators.mean) > 1e-6
        assert ("opening" in fc.solve(run.scene).errors.values) == (closed == 0.0)
        assert "changes in time" in run_command("curve", held_scene, "--output", folder, code=2).err


@pytest.mark.nightly
def test_a_motion_of_closed_lips_settles(
    scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """Their gaps are rounding, of which nothing repeats: the displacement of the load does."""
    pressed_settings = {"excitation.force_mean": [-1400.0, 0.0], "damping.ratio": 0.02}
    pressed_settings |= {"output.quantities": ["amplitude"]}
    process = run_command("integrate", scene.replace(pressed_settings), "--output", tmp_path)
    assert "not settled" not in process.err and "distance from the settled motion" in process.out
    run = fc.load_run(tmp_path / "integration.h5")
    longer_settings = {"integration.settle": 1e-10, "integration.periods": 2000}
    exact = fc.integrate(run.scene.replace(longer_settings))
    last_period, limit = (
        history.by_period(history.displacement()[:, 0])[-1] for history in (run, exact)
    )
    vibration_size = np.linalg.norm(limit - limit.mean())
    assert abs(limit.mean()) * len(limit) ** 0.5 > vibration_size  # and counts as much
    distance = np.linalg.norm(last_period - limit) / (2.0**0.5 * vibration_size)
    assert run.distance_to_steady_motion == pytest.approx(distance, rel=0.02)


# --- pictures of sweeps ---------------------------------------------------------------------------


def test_lines_and_maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two axes: few values of the second make lines, many a map, some both; words on the axes."""
    plot_mock = Mock()
    monkeypatch.setattr(plot, "draw_map", plot_mock.draw_map)
    monkeypatch.setattr(plot, "draw_response", plot_mock.draw_response)
    for count, expected_calls in (
        (3, ["draw_response"]),
        (5, ["draw_response", "draw_map"]),
        (8, ["draw_map"]),
    ):
        plot_mock.reset_mock()
        lengths = tuple(0.02 + 0.002 * n for n in range(count))
        axes = Axis("excitation.frequency", (1.0, 2.0, 3.0, 4.0)), Axis("crack.length", lengths)
        values, doubtful = np.ones((4, count)), np.zeros((4, count), bool)
        words = "largest opening", "m"
        pictures.draw_swept_quantity(axes, values, doubtful, words, tmp_path.joinpath, "a")
        assert [call[0] for call in plot_mock.mock_calls] == expected_calls
    assert plot_mock.draw_map.call_args.kwargs["x_label"] == "load frequency [Hz]"
    assert plot_mock.draw_map.call_args.kwargs["y_label"] == "crack length [mm]"


# --- keys and values in words ---------------------------------------------------------------------


def test_what_differs(paper_scene: fc.Scene) -> None:
    """Each scene with its own values, also where one is the default; units read well."""
    base = {"excitation.force_cos": (0.0, 0.0)}
    scenes = [
        paper_scene.replace(base | {"excitation.force_sin": (size, 0.0)}) for size in (5.0, 20.0)
    ]
    assert describe_differences(scenes) == [
        "excitation.force_sin = 5 N",
        "excitation.force_sin = 20 N",
    ]
    closed_scene = paper_scene.replace({"crack.clearance": -2e-7})
    assert describe_differences([paper_scene.replace({"crack.clearance": 0.0}), closed_scene]) == [
        "crack.clearance = 0 m",
        "crack.clearance = -200 nm",
    ]
    assert describe_differences([paper_scene, paper_scene]) == ["", ""]


def test_hertz_and_ranges(paper_scene: fc.Scene) -> None:
    """A frequency in Hz stands for both twins; ranges count where nothing else differs."""
    first_scene, two = (
        paper_scene.replace({"excitation.frequency": f, "curve.start": f, "curve.stop": 9.0})
        for f in (300.0, 310.0)
    )
    assert describe_differences([first_scene, two]) == [
        "excitation.frequency = 300 Hz",
        "excitation.frequency = 310 Hz",
    ]
    ranges = [
        paper_scene.replace({"curve.start": frequency, "curve.stop": 9.0})
        for frequency in (1.0, 2.0)
    ]
    assert describe_differences(ranges) == ["curve.start = 1", "curve.start = 2"]


def test_words() -> None:
    """As axes and lines are named."""
    assert key_in_words("crack.length") == "crack length"
    assert key_in_words("excitation.omega") == "load frequency"
    for key, value, words in (
        ("crack.length", 0.035, "35 mm"),
        ("excitation.omega", 4420.0, "4420 rad/s"),
        ("material.young", 2.1e11, "210 GPa"),
        ("excitation.force_sin", (0.0, 3.0), "3 N"),
        ("excitation.point", (0.1, 0.2), "[0.1, 0.2] m"),
        ("harmonic_balance.harmonics", 7, "7"),
        ("contact.law", "unilateral", "unilateral"),
        ("crack.length", None, "none"),
    ):
        assert value_in_words(key, value) == words


def test_a_larger_harmonic_that_is_left_out(
    scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """At a seventh of the resonance six harmonics call the second one the largest: the seventh of
    the exact orbit is told, and the error stated is that; with nine there is no more to tell."""
    slow = {"excitation.frequency": 119.0, "mesh.error": False, "curve": None}
    told, orders, amplitude_rows = [], [], []
    for harmonics in (6, 9):
        changed_scene = scene.replace(FIXED | slow | {"harmonic_balance.harmonics": harmonics})
        process = run_command("solve", changed_scene, "--output", tmp_path, "--format", "json")
        told.append("the largest harmonic above harmonic 1 is harmonic 7, with" in process.err)
        rows = {row["name"]: row for row in json.loads(process.out)}
        orders.append(rows["largest_order"]["value"])
        amplitude_rows.append(rows["ratio_largest"])
    assert told == [True, False] and orders == [2.0, 7.0]
    difference_percent = 100.0 * (amplitude_rows[1]["value"] / amplitude_rows[0]["value"] - 1.0)
    assert difference_percent > 50.0 and amplitude_rows[0]["error [%]"] == pytest.approx(
        difference_percent, rel=0.05
    )


@pytest.mark.nightly
def test_rounding_is_no_high_harmonic(
    scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """Of lips that a mean load holds open or shut all higher harmonics are rounding, and none of
    them is the largest."""
    means = [[0.0, 0.0], *([mean, 0.0] for mean in (100.0, -100.0, 200.0, -200.0))]
    slow = {"excitation.frequency": 138.8, "harmonic_balance.harmonics": 8, "curve": None}
    changed_scene = scene.replace(FIXED | slow | {"sweep.over": {"excitation.force_mean": means}})
    messages = run_command("sweep", changed_scene, "--output", tmp_path).err
    sweep = fc.SweepResult.load(tmp_path / "sweep.h5")
    assert sweep["largest_order"][0] > 3.0 and np.isnan(sweep["largest_order"][1:]).all()
    assert np.all(sweep["ratio_largest"][1:] < 1e-9)
    assert "in 1 case the largest harmonic above harmonic 1 is above harmonic 3" in messages


# --- what ends a command, and what it says meanwhile ----------------------------------------------


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        pytest.param("", False, marks=pytest.mark.nightly),
        ("damping.modes=3", True),
        pytest.param(
            "damping.modes=3 reduction.modes=10 reduction.method=free_interface", True,
            marks=pytest.mark.nightly,
        ),
        ("damping.modes=3 reduction.modes=10", False),  # without mass all that are kept are damped
    ],
)  # fmt: skip
def test_hint_to_damp_more_modes(
    changes: str,
    expected: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    run_command: RunCommand,
) -> None:
    """Of an undecided orbit, where there are modes without damping."""
    undecided_verdict = fc.Stability(np.array([1.0 + 0j]), "undecided", np.nan)
    monkeypatch.setattr(
        "fenics_crack.study.solve.floquet", lambda structure, solution: undecided_verdict
    )
    sets = ["contact.stiffness=1e9", "mesh.error=false", *changes.split()]
    answer = run_command("solve", PAPER, "--output", tmp_path, sets=sets).err
    assert (
        "the stability of the orbit is undecided" in answer
        and f"; {PROPOSED_TOLERANCE_OPTION} " in answer
    )
    assert ("or damping of all modes" in answer) == expected


def test_an_interrupted_curve_is_beside_a_complete_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: RunCommand
) -> None:
    """It takes its place nowhere, and the point where Ctrl-C came is no largest response."""
    (tmp_path / "curve.h5").write_bytes(b"complete")
    progress = Mock(side_effect=[0.5, 0.5, 0.5, KeyboardInterrupt])
    monkeypatch.setattr(fc.Continuation, "progress_fraction", progress)
    process = run_command("curve", PAPER, "--verbose", "--output", tmp_path, sets=RANGE, code=3)
    assert (tmp_path / "curve.h5").read_bytes() == b"complete"
    assert not fc.load_run(tmp_path / "curve_interrupted.h5").result.complete
    assert "largest so far" in process.out and "still rises where the curve ended" in process.err
    assert "the largest response" not in process.err
    assert "was interrupted; its errors and stability were not computed" in process.err


def test_an_interrupted_curve_of_orbits_keeps_its_verdicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: RunCommand
) -> None:
    """Its multipliers come with its points: no sentence says that they were not examined, and the
    report reports no errors."""
    calls = iter(range(2))

    def record(record: Callable[..., object], *given: object) -> object:
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return record(*given)

    wrap(monkeypatch, "fenics_crack.curves.continuation.Continuation._append_segment", record)
    changes = [*RANGE, "harmonic_balance.tolerance=0.05"]
    messages = run_command("curve", PAPER, "--output", tmp_path, sets=changes, code=3).err
    assert "was interrupted; its errors were not computed" in messages
    assert re.search(r"(\d) stable of \1 points", messages)
    assert (
        "; curve interrupted; " in f"; {messages.splitlines()[-1]}"
        and "estimated error" not in messages
    )


def test_ctrl_c_during_the_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The solution is saved beside an older one, whatever comes meanwhile."""
    (tmp_path / "solution.h5").write_bytes(b"older")

    def again(save: Callable[..., None], *given: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        save(*given)

    with monkeypatch.context() as patch:
        patch.setattr(
            "fenics_crack.runs.run.estimate_result_errors", Mock(side_effect=KeyboardInterrupt)
        )
        wrap(patch, "fenics_crack.runs.run.on_root", again)
        words = ["--output", str(tmp_path), "--set", "contact.stiffness=1e9"]
        assert main(["solve", str(PAPER), *words, "--set", "damping.ratio=0.02"]) == 3
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler
    assert (tmp_path / "solution.h5").read_bytes() == b"older"
    run = fc.load_run(tmp_path / "solution_interrupted.h5")
    assert run.result.converged and run.stated is None


@pytest.mark.drawn(1)
@pytest.mark.parametrize(
    ("command", "changes", "said"),
    [
        (
            "curve",
            "curve.start=1e3 curve.stop=3e3 curve.stability=false harmonic_balance.harmonics=40",
            r"\d+% .* \d+ points?",
        ),
        ("sweep", "sweep.over={'excitation.omega'=[1e3,1.1e3,1.2e3]}", "[0-3] of 3 cases"),
        ("integrate", "integration.periods=200", r"\d+ of 200 periods"),
    ],
)
def test_signs_of_life_say_how_far(
    command: str,
    changes: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    """On what is no terminal, a line each: work that takes less waits for it."""
    shown_event = threading.Event()

    class Held(list[Callable[[], str]]):
        """What is reached is asked for once before its work ends."""

        def pop(self, *_: Any) -> Callable[[], str]:
            assert shown_event.wait(LIMIT)
            return super().pop()

    def write(wrapped: Callable[..., None], lines: StageLineHandler, text: str) -> None:
        wrapped(lines, text)
        if re.search(said, text):
            shown_event.set()

    monkeypatch.setattr("fenics_crack.basics.progress.PROGRESS_MESSAGE_INTERVAL", 0.01)
    monkeypatch.setattr("fenics_crack.basics.progress._progress_functions", Held())
    wrap(monkeypatch, "fenics_crack.basics.progress.StageLineHandler._write", write)
    settings = ["damping.ratio=0.02", "contact.stiffness=1e9", *changes.split()]
    words = [command, str(PAPER), "--output", str(tmp_path), *(f"--set={x}" for x in settings)]
    assert main(words) in (0, 3)
    assert re.search(rf"^  .* \d+ s, {said}", capsys.readouterr().err, re.MULTILINE)


def test_a_result_is_kept_where_another_one_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While it is written; the earlier one is whole in its folder."""
    words = ["modes", str(PAPER), "--output", str(tmp_path), "--quiet"]
    assert main(words) == 0
    first_content = (tmp_path / "modes.h5").read_bytes()
    monkeypatch.setattr("fenics_crack.runs.run.Run.save", Mock(side_effect=KeyboardInterrupt))
    assert main([*words, "--set", "material.young=2e11"]) == 130
    assert (tmp_path / "before" / "modes.h5").read_bytes() == first_content
