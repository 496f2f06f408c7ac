"""What is printed and written of watched points: the table [output] of a scene."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catch_error, scene_of_matrices
from mpi4py import MPI
from surroundings import DEMOS, RunCommand

import fenics_crack as fc
from fenics_crack import prepare

pytestmark = pytest.mark.usefixtures("not_drawn")

POINTS = {"tip": [0.1, 0.1], "side": [0.098, 0.0625]}


@pytest.fixture
def scene(paper_scene: fc.Scene) -> fc.Scene:
    """The paper's plate with two points that are watched."""
    return paper_scene.replace(
        {
            "contact.stiffness": 1e9,
            "damping.ratio": 0.02,
            "output.points": POINTS,
            "output.quantities": ["ratio_2_1", "omega_open"],
        }
    )


def test_points_are_watched_at_their_nearest_nodes(scene: fc.Scene) -> None:
    """In x, then in y; without points the load's dof is watched."""
    study = prepare(scene, MPI.COMM_SELF)
    assert [w.name for w in study.watched] == ["tip.ux", "tip.uy", "side.ux", "side.uy"]
    dofs = [study.structure.find_dof((0.1, y), axis) for y in (0.1, 0.0625) for axis in "xy"]
    assert [w.dof for w in study.watched] == dofs
    assert [w.distance_to_node for w in study.watched] == [0.0, 0.0, 0.002, 0.002]
    (default_point,) = prepare(scene.replace({"output": None}), MPI.COMM_SELF).watched
    assert (default_point.name, default_point.dof) == ("", dofs[0])
    assert default_point.words == "x displacement at (0.1, 0.1) m"


@pytest.mark.parametrize(
    ("point", "nearest_node_text"),
    [((0.0, 0.05), "0, 0.05"), ((0.05, 0.001), "0.05, 0"), ((0.2, 0.1), "0.1, 0.1")],
)
def test_points_that_cannot_be_watched(scene: fc.Scene, point: Any, nearest_node_text: str) -> None:
    """Refused before anything is solved, by name, with the nearest node."""
    catch_error(
        lambda: prepare(scene.replace({"output.points": {"bad": point}}), MPI.COMM_SELF),
        "output.points.bad",
        point,
        names=rf"\({nearest_node_text}\)",
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("output.quantities", ["amplitud"]), ("output.quantities", []),
        ("output.quantities", "amplitude"), ("output.quantities", ["mean", "mean"]),
        ("output.points", {"a.b": [0.0, 0.0]}), ("output.points", [0.0, 0.0]),
        ("output.points", {"tip": [0.0]}), ("output.points", {"": [0.0, 0.0]}),
    ],
)  # fmt: skip
def test_output_refuses(paper_scene: fc.Scene, key: str, value: Any) -> None:
    """Unknown quantities, names with dots, and what is no point; it says what is known."""
    names = "amplitude, mean, " if key == "output.quantities" else None
    catch_error(lambda: paper_scene.replace({key: value}), key, value, names=names)


def test_scene_with_output_is_read_back(scene: fc.Scene) -> None:
    """As TOML."""
    assert fc.Scene.from_text(scene.as_toml()) == scene


def test_solution(scene: fc.Scene, tmp_path: Path, run_command: RunCommand) -> None:
    """What is chosen is printed, the file has it all, and the remark tells of the distance."""
    shown, notes = run_command("solve", scene, "--output", tmp_path)
    assert shown.count("harmonic ratio 2/1") == 4
    assert "natural frequency, crack open, mode 1" in shown
    assert "half peak-to-peak" not in shown and "Hz" not in shown
    expected_remark = (
        "at its nearest node, at a distance of: side 2 mm; the stated errors do not include"
    )
    assert expected_remark in notes
    rows = {row["name"]: row for row in json.loads((tmp_path / "solution.json").read_text())}
    solution = fc.load_run(tmp_path / "solution.h5", MPI.COMM_SELF).result
    plate = solution.structure
    indicators = solution.indicators(plate.find_dof((0.1, 0.0625), "y"))
    for name in ("amplitude", "ratio_2_1", "ratio_3_1", "mean_shift"):
        assert rows[f"side.uy.{name}"]["value"] == pytest.approx(
            getattr(indicators, name), rel=1e-9
        )
    assert rows["amplitude" if "amplitude" in rows else "tip.ux.amplitude"]["unit"] == "m"
    is_open = fc.solve_modes(plate, 1).omega[0]
    assert rows["omega_open"]["value"] == pytest.approx(is_open)
    assert rows["frequency_open"]["value"] == pytest.approx(is_open / (2.0 * np.pi))
    assert rows["over_open"]["value"] == pytest.approx(2000.0 / is_open)
    with open(tmp_path / "solution.csv", newline="") as file:
        heading, *waves = csv.reader(file)
    assert heading == [
        "time [s]", *(f"{a} displacement of {n} [m]" for n in ("tip", "side") for a in "xy"),
        "closing at the mouth [m]", "contact force, all pairs [N]",
    ]  # fmt: skip
    wave = np.array(waves, dtype=float)
    dofs = [plate.find_dof((0.1, 0.1), axis) for axis in "xy"]
    np.testing.assert_allclose(wave[:, 1:3], solution.displacement(wave[:, 0], dofs), atol=1e-15)


def test_curve(scene: fc.Scene, tmp_path: Path, run_command: RunCommand) -> None:
    """A column for each point and direction; the special points have what is chosen, in Hz."""
    scene = scene.replace({"excitation.frequency": 300.0, "curve.start": 1500.0,
                           "curve.stop": 1550.0})  # fmt: skip
    printed_text = run_command(
        "curve", scene, "--output", tmp_path, sets=["curve.stability=false"]
    ).out
    header_words = [
        word.strip() for word in printed_text.splitlines()[0].split("  ") if word.strip()
    ]
    ratios = [f"{n}.u{a}.ratio_2_1" for n in ("tip", "side") for a in "xy"]
    assert header_words == ["point", "frequency [Hz]", *ratios, "frequency_open [Hz]"]
    with open(tmp_path / "curve.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    curve = fc.load_run(tmp_path / "curve.h5", MPI.COMM_SELF).result
    sizes = curve.amplitude(curve.structure.find_dof((0.1, 0.1), "y"))
    np.testing.assert_allclose([float(r["tip.uy.amplitude [m]"]) for r in rows], sizes, rtol=1e-9)


def test_motion_in_time_has_the_same_indicators(
    scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """Exact from event to event, its last period: ratios and mean as with 30 harmonics."""
    changes = {"integration.method": "events", "integration.settle": 1e-6}
    scene = scene.replace(changes | {"harmonic_balance.harmonics": 30, "output.quantities": None})
    solution_values, exact = (
        {row["name"]: row["value"] for row in json.loads(run_command(*words).out)}
        for words in (
            [command, scene, "--output", tmp_path, "--format", "json"]
            for command in ("solve", "integrate")
        )
    )
    for quantity in ("amplitude", "harmonic_1", "ratio_2_1", "mean_shift"):
        for name in (f"tip.ux.{quantity}", f"side.uy.{quantity}"):
            assert solution_values[name] == pytest.approx(exact[name], rel=2e-3)


def test_a_verdict_that_is_left_out_is_told(
    scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """Of lips that have mass and may not overlap."""
    rigid = {"contact.law": "unilateral", "contact.stiffness": None, "reduction.method": "off"}
    small_settings = {"mesh.columns": 2, "mesh.rows": 2, "output": None}
    words = ["solve", scene.replace(rigid | small_settings), "--output", tmp_path]
    printed_text = run_command(*words)
    assert "the stability is not assessed" in printed_text.err and "verdict" not in printed_text.out
    printed_text = run_command(*words, sets=["reduction.method=massless", "reduction.modes=6"])
    assert "not assessed" not in printed_text.err and "verdict" in printed_text.out


def test_a_crack_of_a_mesh_file_that_stays_open(tmp_path: Path, run_command: RunCommand) -> None:
    """Without contact there is nothing to judge; what needs it asks for contact, not a crack."""
    scene = fc.Scene.load(DEMOS / "inclined_crack.toml", {"contact": None})
    process = run_command("solve", scene, "--output", tmp_path)
    assert "not assessed" not in process.err and "verdict" not in process.out
    expected_message = "contact is missing: give a table [contact], which this command needs"
    assert expected_message in run_command("integrate", scene, "--output", tmp_path, code=2).err


@pytest.mark.parametrize(("mean", "shown"), [(1e-17, "0"), (-2e-9, "-2e-09")])
def test_rounding_is_printed_as_zero(
    tmp_path: Path, run_command: RunCommand, mean: float, shown: str
) -> None:
    """Of a length, in both forms of a table; larger ones and numbers without a unit stay, and files
    have all."""
    parts = {"mass": 1.0, "stiffness": 1.0, "gap": 1.0, "force_sin": 0.64, "force_mean": mean}
    tables = {
        "structure": {"clearance": 10.0},
        "damping": {"ratio": 0.0},
        "contact": {"stiffness": 1.0},
        "excitation": {"omega": 0.6},
        "harmonic_balance": {"harmonics": 5},
        "curve": {"start": 0.6, "stop": 0.65, "stability": False},
        "output": {"quantities": ["amplitude", "mean", "mean_shift"]},
    }
    words = [scene_of_matrices(tmp_path, parts, tables), "--output", tmp_path]
    lines = [" ".join(line.split()) for line in run_command("solve", *words).out.splitlines()]
    for first in (f"mean displacement {shown} m", f"mean displacement over harmonic 1 {mean:g} -"):
        assert any(line.startswith(first) for line in lines)
    rows = json.loads((tmp_path / "solution.json").read_text())
    [mean_value] = [row["value"] for row in rows if row["name"] == "mean"]
    assert mean_value == pytest.approx(mean, rel=1e-12)
    start = run_command("curve", *words).out.splitlines()[2].split()
    assert start == ["start", "0.6", "1", shown, f"{mean:g}"]


@pytest.fixture
def leaning(tmp_path: Path) -> fc.Scene:
    """Two masses, one of which meets a stop: a resonance that leans over."""
    stiffness = np.array([[1.0, -1.0], [-1.0, 2.0]])
    parts = {
        "mass": np.eye(2), "stiffness": stiffness, "damping": 0.03 * stiffness,
        "gap": [[1.0], [0.0]], "force_cos": [[0.0], [0.1]],
    }  # fmt: skip
    tables = {
        "structure": {"clearance": 1.0},
        "contact": {"stiffness": 100.0},
        "excitation": {"omega": 0.614},
        "harmonic_balance": {"harmonics": 60},
        "curve": {"start": 0.62, "stop": 0.75},
    }
    return scene_of_matrices(tmp_path, parts, tables)


def test_what_is_seen_in_place_of_an_unstable_orbit(
    tmp_path: Path, run_command: RunCommand, leaning: fc.Scene
) -> None:
    """Told with the warning and on the page: two sizes between which a motion that leaves the orbit
    still varies, those of ``fc.attractors``. And of the largest response of a curve."""
    messages = run_command("solve", leaning, "--output", tmp_path).err
    run = fc.load_run(tmp_path / "solution.h5")
    [attractor] = fc.attractors(run.structure, run.result)
    sizes = [
        f"{1e3 * size:.4g} mm"
        for size in np.sort(attractor.amplitude_in_each_period(run.watched_dof))[[0, -1]]
    ]
    settling_text = "; a disturbed motion still varies after 1000 periods, between"
    expected_text = f"{settling_text} {' and '.join(sizes)} half peak-to-peak"
    assert expected_text in messages
    run_command("report", tmp_path / "solution.h5", "--quiet")
    assert expected_text in (tmp_path / "report.html").read_text()
    # To where two periods of the load are one.
    messages = run_command("curve", leaning, "--output", tmp_path).err
    curve = fc.load_run(tmp_path / "curve.h5")
    last_solution = curve.result.solution(len(curve.result) - 1)
    [doubled_motion] = fc.attractors(curve.structure, last_solution)
    sizes = [
        f"{size:.4g} m"
        for size in np.sort(doubled_motion.amplitude_in_each_period(curve.watched_dof))
    ]
    settling_text = "; a disturbed motion settles to between"
    expected_text = (
        f"response is unstable: a test shows another motion{settling_text} {sizes[0]} and "
    )
    assert f"{expected_text}{sizes[1]} half" in messages
