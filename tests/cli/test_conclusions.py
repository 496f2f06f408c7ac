"""What a result ends with: an unknown error, a verdict, another motion and remarks reach the exit
code, the files and the page of every command."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error, scene_of_matrices
from mpi4py import MPI
from ranks import run_program
from surroundings import RunCommand, main

import fenics_crack as fc
from fenics_crack.basics.tables import format_error

pytestmark = pytest.mark.usefixtures("not_drawn")

STIFFNESS, DAMPING = np.array([[1.0, -1.0], [-1.0, 2.0]]), 0.03
FEW = {"contact.stiffness": 1e3, "harmonic_balance.harmonics": 3, "excitation.omega": 0.8}
"""Too few harmonics for so stiff a stop."""
BESIDE = 1.4
"""Load frequency [rad/s] at which the stop is 2 % beyond where the steady motion reaches, and from
rest it is met."""


def amplitude_without_stop(omega: float) -> float:
    """Of the second mass under 0.1 cos(w t), M = I, C = 0.03 K [m]."""
    dynamic = STIFFNESS * (1.0 + 1j * DAMPING * omega) - omega**2 * np.eye(2)
    return float(np.abs(np.linalg.solve(dynamic, [0.0, 0.1]))[1])


@pytest.fixture(scope="module")
def two_masses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene: two masses, and a stop for the second one."""
    folder = tmp_path_factory.mktemp("two")
    matrices = {
        "mass": np.eye(2), "stiffness": STIFFNESS, "damping": DAMPING * STIFFNESS,
        "gap": [[0.0], [1.0]], "force_cos": [[0.0], [0.1]],
    }  # fmt: skip
    tables = {
        "structure": {"clearance": 0.01}, "excitation": {"omega": BESIDE},
        "contact": {"stiffness": 10.0}, "sweep": {"over": {"excitation.omega": [0.8, 2.0]}},
        "curve": {"parameter": "omega", "start": 0.75, "stop": 0.85},
    }  # fmt: skip
    (folder / "two.toml").write_text(scene_of_matrices(folder, matrices, tables).as_toml())
    return folder / "two.toml"


def words_of(command: str, scene: Path, folder: Path, changes: dict[str, Any]) -> list[str]:
    """Words of a command with some changes of a scene."""
    words = [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
    return [command, str(scene), *words, "--output", str(folder), "--quiet"]


def run(command: str, scene: Path, folder: Path, changes: dict[str, Any]) -> int:
    """Exit code of a command with some changes of a scene."""
    return main(words_of(command, scene, folder, changes))


def rows_of(path: Path) -> dict[str, dict[str, Any]]:
    """The quantities of a solution, by their names."""
    return {row["name"]: row for row in json.loads(path.read_text())}


@pytest.mark.parametrize("command", ["solve", "curve"])
def test_an_unknown_error_is_not_what_was_asked_for(
    two_masses: Path, tmp_path: Path, command: str
) -> None:
    """Nothing is said to be known then; with 60 harmonics, which suffice, it is."""
    assert run(command, two_masses, tmp_path, FEW) == 4
    if command != "solve":
        return
    rows = rows_of(tmp_path / "solution.json")
    assert rows["unknown_error"]["value"] and rows["verdict"]["value"] == "undecided"
    assert not any(row.get("error [%]") for row in rows.values())
    scene = fc.Scene.load(two_masses, FEW)
    assert "unknown" in str(fc.solve(scene)) and "estimated error" not in str(fc.solve(scene))
    many_harmonics = FEW | {"harmonic_balance.harmonics": 60}
    assert run(command, two_masses, tmp_path, many_harmonics) == 0
    rows = rows_of(tmp_path / "solution.json")
    assert "unknown_error" not in rows and rows["amplitude"]["error [%]"] < 1.0


@pytest.mark.mpi
def test_a_sweep_with_remarks_ends_well(
    two_masses: Path, tmp_path: Path, on_ranks: Callable[..., Any]
) -> None:
    """On two ranks, where another code is an aborted job: all cases are computed, and the last
    lines say what is remarked of them."""
    codes, lines = on_ranks(run_program, words_of("sweep", two_masses, tmp_path, FEW))
    assert codes == [0, 0], lines
    assert any("2 cases with an error above 5 %" in line for line in lines), lines
    assert all(line.startswith("fenics-crack: warning: ") for line in lines), lines
    assert fc.SweepResult.load(tmp_path / "sweep.h5").converged.all()


def test_another_motion_attracts_from_rest(two_masses: Path, tmp_path: Path) -> None:
    """The steady motion that never meets the stop is stable; from rest it is met, and the motion
    settles to one of twice the period, as a march in time finds it."""
    distant_settings = {"structure.clearance": 1.02 * amplitude_without_stop(BESIDE)}
    assert run("solve", two_masses, tmp_path, distant_settings) == 0
    rows = rows_of(tmp_path / "solution.json")
    assert rows["verdict"]["value"] == "stable" and rows["closed_share"]["value"] == 0.0
    amplitude, rest_amplitude = (rows[name]["value"] for name in ("amplitude", "rest_amplitude"))
    assert amplitude == pytest.approx(amplitude_without_stop(BESIDE), rel=1e-5)
    assert 2.0 * amplitude < rest_amplitude < 3.0 * amplitude
    scene = fc.Scene.load(two_masses, distant_settings | {"integration.periods": 400})
    marched_history = fc.integrate(scene).result
    sizes = np.ptp(marched_history.by_period(marched_history.displacement([1])[:, 0]), axis=1) / 2.0
    assert sizes[0] == pytest.approx(sizes[2], rel=1e-2) != pytest.approx(sizes[1], rel=1e-2)
    assert rest_amplitude == pytest.approx(marched_history.indicators(1).amplitude, rel=1e-2)
    # Twice as far away nothing is met from rest either, and nothing is said.
    assert run("solve", two_masses, tmp_path, {"structure.clearance": 1.0}) == 0
    assert "rest_amplitude" not in rows_of(tmp_path / "solution.json")
    # What is saved is what is reported.
    assert run("solve", two_masses, tmp_path, distant_settings) == 0
    stored_run = fc.load_run(tmp_path / "solution.h5")
    assert stored_run.result.stability.rest_amplitude == rest_amplitude


@pytest.mark.nightly
def test_a_crack_that_a_mean_load_holds_open(tmp_path: Path) -> None:
    """Is no breathing one, in the file, in Python and on the page; the remark of ``check`` comes
    with it."""
    scene = DEMOS.parent / "benchmarks" / "plate.toml"
    mean_load_settings = {
        "excitation.force_mean": "[1400.0, 0.0]", "excitation.frequency": 500.0,
        "mesh.size": 0.05, "reduction.modes": 8,
    }  # fmt: skip
    assert run("solve", scene, tmp_path, mean_load_settings) == 0
    rows = rows_of(tmp_path / "solution.json")
    assert rows["closed_share"]["value"] == 0.0
    assert "excitation.force_mean" in rows["remarks"]["value"]
    stored_run = fc.load_run(tmp_path / "solution.h5")
    assert not stored_run.result.breathes
    assert [remark.key for remark in stored_run.remarks] == ["excitation.force_mean"]
    assert main(["report", str(tmp_path / "solution.h5"), "--quiet"]) == 0
    page = (tmp_path / "report.html").read_text()
    assert "Breathing crack" not in page and "No warnings" not in page
    assert "excitation.force_mean = [1400.0, 0.0]" in page


def test_no_error_is_asked_for(
    paper_scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """error = false: plain harmonic balance, neither error nor stability, in Python and in the
    program; with a tolerance it is refused."""
    scene = paper_scene.replace({"contact.stiffness": 1e9})
    plain_scene = scene.replace({"harmonic_balance.error": False})
    out, err = run_command("solve", plain_scene, "--output", tmp_path / "out")
    assert "error [%]" not in out and "verdict" not in out
    last_line = err.strip().splitlines()[-1]
    assert "its error is not estimated (harmonic_balance.error = false)" in last_line
    run = fc.solve(plain_scene, MPI.COMM_SELF)
    assert run.errors is None and run.result.stability is None
    assert not run.result.report.estimated and run.result.converged
    tolerance_settings = {"harmonic_balance.harmonics": None, "harmonic_balance.tolerance": 1e-2}
    catch_error(
        lambda: scene.replace(tolerance_settings | {"harmonic_balance.error": False}),
        "harmonic_balance.error",
        False,
    )


def test_one_sentence_holds_the_answer(
    paper_scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """The terminal, the JSON, Python and the page end with it: amplitude, error, crack, verdict."""
    scene = paper_scene.replace({"contact.stiffness": 1e9})
    last_line = run_command("solve", scene, "--output", tmp_path).err.splitlines()[-1]
    rows = rows_of(tmp_path / "solution.json")
    assert rows["conclusion"]["value"] == last_line
    run = fc.load_run(tmp_path / "solution.h5")
    size, opening = (fc_quantity(rows[name]["value"]) for name in ("amplitude", "opening"))
    assert f"at 2000 rad/s the {run.watched_description} is {size} half peak-to-peak" in last_line
    error = format_error(run.stated.stated("opening")[0])
    expected_end = f"; the crack opens by {opening}, estimated error {error}, and is closed for "
    assert expected_end in last_line
    assert f"; {rows['verdict']['value']}; " in f"{last_line}; "
    assert last_line.startswith(str(run).partition(": ")[2])
    assert main(["report", str(tmp_path), "--quiet"]) == 0
    assert last_line.removeprefix("solved") in (tmp_path / "report.html").read_text()


def fc_quantity(metres: float) -> str:
    """A length in micrometres."""
    return f"{1e6 * metres:.4g} µm"
