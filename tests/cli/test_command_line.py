"""The program: a newcomer's path, its files, its exit codes."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import MPI_ENVIRONMENT, ROOT, catch_error
from mpi4py import MPI
from ranks import HELD, LIMIT, launcher, run_program
from surroundings import RunCommand, main

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_drawn")

ENVIRONMENT = os.environ | MPI_ENVIRONMENT | {"PYTHONPATH": str(ROOT)}
PAPER = ROOT / "demos" / "paper_plate.toml"
COARSE = ["mesh.size=0.03", "mesh.lip_elements=6"]
"""The scene of ``new`` with few elements."""
PROGRAM = [sys.executable, "-m", "fenics_crack"]


def run(folder: Path, *words: str, ranks: int = 1) -> subprocess.CompletedProcess[str]:
    """The program in a folder, on one rank or more."""
    start = [] if ranks == 1 else launcher(ranks)
    return subprocess.run(
        [*start, *PROGRAM, *words], cwd=folder, env=ENVIRONMENT, capture_output=True, text=True,
        timeout=LIMIT,
    )  # fmt: skip


def table(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    "law",
    [
        ["contact.law=unilateral", "contact.stiffness=none"],
        ["contact.law=smoothed", "contact.sharpness=1e8", "contact.stiffness=1e9"],
    ],
    ids=["unilateral", "smoothed"],
)
def test_other_laws_read_back(tmp_path: Path, law: list[str], run_command: RunCommand) -> None:
    """Also no penetration, and the smoothed law."""
    changes = [*law, "harmonic_balance.error=false"]
    run_command("solve", PAPER, "--quiet", "--output", tmp_path, sets=changes)
    run = fc.load_run(tmp_path / "solution.h5")
    assert isinstance(run.result, fc.PeriodicSolution) and run.result.converged
    time = np.linspace(0.0, run.result.period, 200)
    assert run.result.contact_force(time).max() > 1.0


FREE = "reduction.method=free_interface"
SHORT = "curve damping.modes=3 harmonic_balance.harmonics=1 curve.stability=false"
REMARKS = [
    # (command and settings, what is said of harmonics that nothing damps)
    ("solve", ""),
    ("solve damping.modes=3", "beyond the 3 damped modes (8579.27 rad/s); higher modes are not"),
    ("solve damping.modes=1", "H w = 10000 rad/s, beyond the damped mode (2302.87"),
    ("solve damping.modes=3 harmonic_balance.harmonics=4", ""),
    (f"solve damping.modes=3 {FREE} reduction.modes=10", "the 3 damped modes (8579.27 rad/s)"),
    (f"solve damping.modes=3 {FREE} reduction.modes=2", "the 3 damped modes (8579.27 rad/s)"),
    (f"solve {FREE} reduction.modes=2", ""),
    ("solve damping.modes=3 reduction.modes=10", ""),  # without mass all that are kept are damped
    ("check damping.modes=3 reduction.modes=10", ""),
    ("check damping.modes=3 damping.ratio=[0.1,0.1,0.0] reduction.modes=10", "the 2 damped modes"),
    ("check damping.ratio=0 reduction.modes=10", "reach H w = 10000 rad/s, but no mode is damped"),
    (f"check damping.modes=3 {FREE} reduction.modes=10", "the 3 damped modes"),
    ("solve damping.ratio=0", "reach H w = 10000 rad/s, but no mode is damped"),
    ("solve damping.ratio=none damping.mass=20", ""),
    ("solve damping.modes=3 crack=none contact=none", ""),
    (f"{SHORT} curve.start=8599 curve.stop=8600", "reach H w = 8600 rad/s, beyond"),
    (f"{SHORT} curve.start=8500 curve.stop=8501", ""),
    ("check damping.modes=3", "H w = 10000 rad/s, beyond the 3 damped modes"),
    ("check damping.modes=3 excitation.omega=1700", ""),
    ("check damping.modes=3 excitation.omega=1700 curve.start=1 curve.stop=2e3", "H w = 10000 "),
]
QUIET = {line.split()[0]: line for line, expected in reversed(REMARKS) if expected}.values()
"""The first line of each command that has a remark."""


@pytest.mark.drawn(4)
@pytest.mark.parametrize(("line", "expected"), REMARKS, ids=[line for line, _ in REMARKS])
def test_harmonics_that_nothing_damps(
    line: str, expected: str, tmp_path: Path, run_command: RunCommand
) -> None:
    """One line where they are reached, and none where all is damped; none by --quiet."""
    command, *changes = line.split()
    words = [command, PAPER, *(() if command == "check" else ("--output", tmp_path))]
    sets = ["contact.stiffness=1e9", "damping.ratio=0.01", *changes]
    sets += ["contact.friction_error=false"] * ("contact=none" not in changes)
    warning_rows = [
        row for row in run_command(*words, sets=sets).err.splitlines() if "H w =" in row
    ]
    assert len(warning_rows) == bool(expected) and expected in "".join(warning_rows)
    if line in QUIET:
        assert "H w =" not in run_command(*words, "--quiet", sets=sets).err


def checked(run_command: RunCommand, path: Path, *changes: str) -> tuple[dict[str, Any], str]:
    """Return what ``check`` finds of a scene, by its names, and its remarks."""
    process = run_command("check", path, "--format", "json", sets=changes)
    return {row["what"]: row["value"] for row in json.loads(process.out)}, process.err


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ("", "none"),
        ("reduction.modes=1", "massless, 1 mode, crack faces without mass"),
        ("reduction.method=free_interface", "free_interface, 50 modes"),
    ],
)
def test_check_says_how_it_is_solved(changes: str, expected: str, run_command: RunCommand) -> None:
    """As it is, or in what is left after its reduction."""
    assert checked(run_command, PAPER, *changes.split())[0]["reduction"] == expected


@pytest.fixture
def plate(tmp_path: Path, run_command: RunCommand) -> Path:
    """A new scene."""
    run_command("new", tmp_path / "plate.toml", "--quiet")
    return tmp_path / "plate.toml"


@pytest.mark.nightly
def test_new_scene(plate: Path, run_command: RunCommand) -> None:
    """Without penetration, of lips without mass; marched by exponential steps."""
    scene = fc.Scene.load(plate)
    assert scene.contact is not None and scene.contact.law == "unilateral"
    assert scene.contact.stiffness is scene.contact.stiffness_per_area is None
    run = fc.integrate(scene.replace({"mesh.size": 0.03, "mesh.lip_elements": 6}))
    assert isinstance(run.structure, fc.MasslessStructure) and run.structure.n_modes == 50
    assert run.result.settled <= 1e-3 and run.result.gap.max() < 1e-18
    assert "crack faces without mass" in run_command("check", plate, sets=COARSE).out


@pytest.mark.parametrize(
    ("kind", "unit", "low", "middle"),
    [
        ([], "Hz", 780, "resonance at the load [Hz]"),
        pytest.param(
            ["--blade"], "rpm", 2900,
            "rotor speed at which order 16 meets the resonance at the load [rpm]",
            marks=pytest.mark.nightly,
        ),
    ],
    ids=["plate", "blade"],
)  # fmt: skip
def test_check_proposes_a_curve_through_the_resonance(
    kind: list[str], unit: str, low: int, middle: str, tmp_path: Path, run_command: RunCommand
) -> None:
    """Of a shorter plate, whose resonance the template's range does not hold, and without a curve;
    in the scene's unit, around the resonance. Once it is copied nothing is proposed."""
    path = tmp_path / "plate.toml"
    run_command("new", path, "--quiet", *kind)
    height_options = [*COARSE, "geometry.height=0.28", "excitation.point=[0.1, 0.28]"]
    names = [f"proposed curve.{end} [{unit}]" for end in ("start", "stop")]
    rows, messages = checked(run_command, path, *height_options, f"curve.start={low}")
    ends = [rows[name] for name in names]
    assert ends[0] < rows[middle] < ends[1] < 1.25 * ends[0]
    assert "remark: curve.start" in messages and f"{ends[0]:g}" in messages
    parameter = rows["proposed curve.parameter"]
    rows, messages = checked(run_command, path, *height_options, "curve=none")
    assert ends == [rows[name] for name in names] and "curve.start" not in messages
    assert parameter == rows["proposed curve.parameter"]
    copied_options = [f"curve.start={ends[0]}", f"curve.stop={ends[1]}"]
    rows, messages = checked(run_command, path, *height_options, *copied_options)
    assert (
        not [name for name in rows if name.startswith("proposed")] and "curve.start" not in messages
    )


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [([], "excitation.frequency", 830.0), (["--blade"], "rotation.rpm", 3100.0)],
    ids=["plate", "blade"],
)
def test_the_sweep_of_a_new_scene_meets_its_tolerance(
    kind: list[str], key: str, value: float, tmp_path: Path, run_command: RunCommand
) -> None:
    """The cases of the template whose errors by harmonics, and by modes, are the largest."""
    run_command("new", tmp_path / "plate.toml", "--quiet", *kind)
    axis_option = f"sweep.over={{'{key}' = [{value}], 'crack.length' = [0.02, 0.03]}}"
    run_command("sweep", tmp_path / "plate.toml", "--output", tmp_path, sets=[axis_option])
    sweep = fc.SweepResult.load(tmp_path / "sweep.h5")
    assert sweep.error_parts.sum(axis=0).max() < sweep.scene.given("harmonic_balance").tolerance


def test_new_scene_of_a_name_too_long(run_command: RunCommand) -> None:
    """One line, of bad input."""
    assert "File name too long" in run_command("new", 300 * "a", code=2).err


def test_nothing_else_is_printed(plate: Path) -> None:
    """Neither gmsh nor PETSc nor FFCx says a word; a file as standard error gets no progress."""
    process = run(plate.parent, "solve", plate.name, *(f"--set={change}" for change in COARSE))
    message_lines = [
        line for line in process.stderr.splitlines() if not line.startswith("  ")
    ]  # signs of life
    assert message_lines[0].startswith("output/plate/solution.h5")
    assert (
        len(message_lines) == 2
        and message_lines[1].startswith("solved; at ")
        and "estimated error" in message_lines[1]
    )
    assert process.stdout.count("\n---") == 1 and "\r" not in process.stderr


SPY = """
import os, runpy, sys
class Spy:
    def find_spec(self, name, *_):
        if name == "mpi4py.MPI":
            print("pml =", os.environ.get("OMPI_MCA_pml"))
sys.meta_path.insert(0, Spy())
sys.argv = ["fenics-crack", "new", "plate.toml", "--quiet"]
try:
    runpy.run_module("fenics_crack", run_name="__main__")
except SystemExit:
    pass
print("then", os.environ.get("OMPI_MCA_pml"))
"""


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({}, ["ob1", "None"]),
        pytest.param({"OMPI_MCA_pml": "^cm"}, ["^cm", "^cm"], marks=pytest.mark.nightly),
    ],
    ids=["unset", "set"],
)
def test_one_process_looks_for_no_network(
    tmp_path: Path, given: dict[str, str], told: list[str]
) -> None:
    """MPI starts in a fifth of the time; what the user has set stays, and nothing is left behind
    for programs that are started from here."""
    surroundings = {k: v for k, v in ENVIRONMENT.items() if not k.startswith("OMPI_MCA_")} | given
    process = subprocess.run(
        [sys.executable, "-c", SPY], cwd=tmp_path, env=surroundings, capture_output=True, text=True
    )
    assert process.stdout.split("\n")[:2] == [f"pml = {told[0]}", f"then {told[1]}"]


def test_new_scene_resonates_as_it_breathes(plate: Path, run_command: RunCommand) -> None:
    """Half of each period open, half closed: at 2 f_open f_tied / (f_open + f_tied)."""
    rows, _ = checked(run_command, plate, *COARSE)
    row_name = "first natural frequency, crack faces {} [Hz]"
    open_frequency, bonded_frequency = (
        rows[row_name.format(state)] for state in ("open", "bonded")
    )
    bilinear_frequency = (
        2.0 * open_frequency * bonded_frequency / (open_frequency + bonded_frequency)
    )
    assert rows["resonance at the load [Hz]"] == pytest.approx(bilinear_frequency, rel=1e-3)
    vibration = rows["vibration at this resonance"]
    left_out = "error due to the modes and the friction not included; proportional to the load"
    assert re.search(rf"error due to the harmonics .* %, the mesh .* %; {left_out}$", vibration)
    [stated_percent] = re.findall(
        "[0-9.]+", rows["error of the resonance at the load due to the mesh"]
    )
    true_error = abs(
        831.8 / rows["resonance at the load [Hz]"] - 1.0
    )  # of the mesh that new writes
    assert 0.2 < 100.0 * true_error / float(stated_percent) < 1.6


def test_not_converged_says_so(tmp_path: Path, run_command: RunCommand) -> None:
    """Exit code 3 where a motion has not settled; the files are there."""
    words = ["integrate", PAPER, "--output", tmp_path]
    for periods, said in (
        (2, "not settled"),
        (1, "1 of 1 periods: two are needed to see a change"),
    ):
        changes = [f"integration.periods={periods}", "integration.method=events"]
        assert said in run_command(*words, sets=changes, code=3).err
    assert (tmp_path / "integration.h5").exists()


def test_help_and_version(capsys: pytest.CaptureFixture) -> None:
    """Every command is listed and explained."""
    texts = {}
    commands = ("new", "check", "modes", "solve", "curve", "integrate", "sweep", "plot")
    for words in (["--help"], ["--version"], *([command, "--help"] for command in commands)):
        assert catch_error(partial(main, words), kind=SystemExit).code == 0
        texts[words[0]] = capsys.readouterr().out
    assert texts["--version"].strip() == f"fenics-crack {fc.__version__}"
    for command in commands:
        assert f"\n    {command}" in texts["--help"] and "usage: fenics-crack" in texts[command]


@pytest.mark.mpi
@pytest.mark.parametrize(
    "words", [["solve", "--help"], pytest.param(["nothing"], marks=pytest.mark.nightly)]
)
def test_one_rank_prints_before_a_command_runs(tmp_path: Path, words: list[str]) -> None:
    """Help, version and the error of an unknown word are printed once."""
    process = run(tmp_path, *words, ranks=2)
    printed_text = process.stdout + process.stderr
    assert (
        printed_text.count("usage: fenics-crack")
        + printed_text.count(f"fenics-crack {fc.__version__}")
        == 1
    )
    assert (process.returncode == 0) == (words != ["nothing"])


@pytest.mark.mpi
def test_bad_input_on_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """One line for each key, from one rank, and both ranks end."""
    wrong_options = ["--set", "crack.length=-1.0", "--set", "material.young=none"]
    codes, lines = on_ranks(run_program, ["solve", str(PAPER), *wrong_options])
    assert codes == [2, 2] and len(lines) == 2
    assert sum("crack.length = -1.0: must be a finite number > 0" in one for one in lines) == 1
    assert sum("material.young is missing: must be a finite" in one for one in lines) == 1


@pytest.mark.nightly
@pytest.mark.mpi
@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGINT])
def test_a_signal_to_mpirun_alone(tmp_path: Path, number: int) -> None:
    """SIGUSR1 goes to the ranks, which end by themselves, with the tables of what was found. At
    SIGINT mpirun soon kills them, and its code is its own; the cases stay."""
    axis_option = "sweep.over={'excitation.frequency' = {start = 7.0, stop = 12.0, count = 600}}"
    words = [
        "sweep",
        str(ROOT / "demos" / "chain.toml"),
        "--set",
        axis_option,
        "--output",
        str(tmp_path),
    ]
    waiting_program = HELD.format(cases=1, go=str(tmp_path / "go"))
    main_program = "import sys\nfrom fenics_crack.cli.command_line import main\nsys.exit(main())"
    source = waiting_program + main_program
    program = subprocess.Popen(
        [*launcher(2), sys.executable, "-c", source, *words], env=ENVIRONMENT,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    path, n_done = tmp_path / "sweep.h5", 0
    while program.poll() is None and not n_done:
        time.sleep(0.1)
        n_done = path.exists() and np.count_nonzero(fc.SweepResult.load(path)["state"])
    program.send_signal(number)
    (tmp_path / "go").touch()
    code = program.wait(LIMIT)
    assert 0 < np.count_nonzero(fc.SweepResult.load(path)["state"]) < 600
    if number == signal.SIGUSR1:
        assert code == 3 and (tmp_path / "sweep.csv").exists()
    assert code != 0


def test_a_failed_run_leaves_older_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is replaced only when the new one is complete."""
    words = ["modes", str(PAPER), "--output", str(tmp_path), "--quiet"]
    assert main(words) == 0
    earlier_content = (tmp_path / "modes.h5").read_bytes()

    def replace(old: str, new: str) -> None:
        raise OSError(errno.ENOSPC, "the disk is full")

    monkeypatch.setattr(os, "replace", replace)
    assert main([*words, "--count", "3"]) == 1
    assert (tmp_path / "modes.h5").read_bytes() == earlier_content
    names = {path.name for path in tmp_path.iterdir()}
    assert names - {"before"} == {"modes.csv", "modes.h5", "modes.json"}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solution and a curve of the paper's plate."""
    folder = tmp_path_factory.mktemp("results")
    for command in ("solve", "curve", "integrate"):
        words = [command, str(PAPER), "--quiet", "--output", str(folder)]
        changes = ["contact.stiffness=1e9", "damping.ratio=0.02", "curve.start=1500.0",
                   "curve.stop=1600.0", "integration.method=events"]  # fmt: skip
        assert main([*words, *(f"--set={change}" for change in changes)]) == 0
    return folder


@pytest.mark.parametrize(("stop", "at_end"), [(12.0, False), (8.5, True)])
def test_a_largest_response_is_one_peak_or_still_rising(
    stop: float, at_end: bool, tmp_path: Path, run_command: RunCommand
) -> None:
    """The table, the sentence, the page and Python have the same place and size of a peak; what is
    largest at the end of the range, which a resonance lies beyond, is none."""
    chain = ["curve", str(ROOT / "demos" / "chain.toml"), "--set", f"curve.stop={stop}"]
    messages, run = (
        run_command(*chain, "--output", tmp_path).err,
        fc.load_run(tmp_path / "curve.h5"),
    )
    peak = run.peak()
    assert peak.at_end == at_end
    points = {row["point"]: row for row in json.loads((tmp_path / "curve.json").read_text())}
    [(name, largest_rows)] = [(n, row) for n, row in points.items() if n.startswith("largest")]
    assert ("still rising" in name) == ("still rising" in messages) == at_end
    assert largest_rows["frequency [Hz]"] == pytest.approx(peak.frequency, rel=1e-9)
    assert largest_rows["amplitude [m]"] == pytest.approx(peak.amplitude, rel=1e-9)
    assert largest_rows["over_open"] * largest_rows["frequency_open [Hz]"] == pytest.approx(
        peak.frequency
    )
    if at_end:
        assert largest_rows["frequency [Hz]"] == pytest.approx(stop)
    else:
        assert np.abs(run.result.omega / peak.omega - 1.0).min() > 1e-8  # between two points
    assert f"{peak.frequency:.6g} Hz" in messages
    assert main(["report", str(tmp_path / "curve.h5"), "--quiet"]) == 0
    assert f"{peak.frequency:.6g} Hz" in (tmp_path / "report.html").read_text()


def test_points_of_a_curve(results: Path) -> None:
    """The columns that the curve itself writes, and the indicators of the load's dof."""
    run = fc.load_run(results / "curve.h5")
    rows = table(results / "curve.csv")
    columns = run.result.table().columns
    assert len(rows) == len(run.result) and list(rows[0])[: len(columns)] == columns
    indicators = [
        "amplitude [m]", "mean [m]", "harmonic_1 [m]", "harmonic_2 [m]", "harmonic_3 [m]",
        "ratio_2_1", "ratio_3_1", "ratio_half_1", "ratio_largest", "largest_order", "mean_shift",
        "opening [m]", "penetration [m]", "contact_force [N]", "crack_force [N]",
        "closed_share", "near_share", "far_share",
        "omega_open [rad/s]", "frequency_open [Hz]", "omega_tied [rad/s]", "frequency_tied [Hz]",
        "omega_bilinear [rad/s]", "frequency_bilinear [Hz]",
        "over_open", "over_tied", "over_bilinear",
    ]  # fmt: skip
    assert list(rows[0])[-len(indicators) :] == indicators
    curve_indicators = run.result.indicators(run.watched_dof)
    frequency_ratio = run.result.omega / fc.solve_modes(run.structure, 1).omega[0]
    exact = {
        "amplitude [m]": curve_indicators.amplitude,
        "closed_share": curve_indicators.closed_share,
    }
    for name, values in (exact | {"over_open": frequency_ratio}).items():
        np.testing.assert_allclose([float(row[name]) for row in rows], values, rtol=1e-9)


@pytest.mark.parametrize("name", ["solution", "curve"])
def test_file_with_another_law_or_structure(results: Path, name: str) -> None:
    """With another structure or law than its own a result would be wrong: it is refused."""
    run = fc.load_run(results / f"{name}.h5")
    for law in (fc.UnilateralPenalty(1e8), fc.SmoothedPenalty(1e9, 1e8)):
        catch_error(partial(fc.load, results / f"{name}.h5", run.structure, law), "contact")
    heavier = fc.prepare(run.scene.replace({"material.density": 8000.0})).structure
    catch_error(
        lambda: fc.load(results / f"{name}.h5", heavier, run.contact),
        "structure",
        "another load, mesh or material",
    )


def test_file_of_a_mesh_that_has_changed(tmp_path: Path) -> None:
    """A result whose mesh file has changed is refused."""
    mesh, paths = tmp_path / "plate.msh", [tmp_path / "solution.h5", tmp_path / "sweep.h5"]
    drawn_scene = fc.Scene.load(PAPER).replace({"contact.stiffness": 1e9, "damping.ratio": 0.02})
    fc.write_msh(drawn_scene, mesh)
    of_mesh = dict.fromkeys(("geometry.width", "geometry.height", "mesh.columns", "mesh.rows"))
    of_mesh |= {"crack.edge": None, "crack.height": None, "crack.length": None}
    of_mesh |= {"mesh.layout": "file", "mesh.file": str(mesh), "curve": None}
    scene = drawn_scene.replace(of_mesh)
    fc.solve(scene, MPI.COMM_SELF).save(paths[0])
    assert isinstance(fc.load_run(paths[0]).result, fc.PeriodicSolution)
    scene = scene.replace({"sweep.over": {"excitation.omega": [1900.0, 2000.0]}})
    sweep = fc.run_sweep(scene, paths[1])
    assert sweep.solution(0).converged
    for reader in (fc.load_run, lambda path: fc.load(path, sweep.solution(0).structure)):
        catch_error(partial(reader, paths[1]), "path", names=r"SweepResult\.load")
    fc.write_msh(drawn_scene.replace({"crack.height": 0.0625}), mesh)
    catch_error(lambda: fc.load_run(paths[0]), "mesh.file", str(mesh))
    catch_error(lambda: sweep.solution(0), "mesh.file", str(mesh))
    catch_error(
        lambda: fc.run_sweep(scene, paths[1]), "mesh.file", str(mesh)
    )  # neither does the sweep go on


def codes(words: list[str], comm: Any) -> list[int]:
    """With what the program ends on each rank (collective)."""
    return comm.allgather(int(main(words)))


@pytest.mark.mpi
@pytest.mark.parametrize("name", [pytest.param("curve", marks=pytest.mark.nightly), "integration"])
def test_plot_on_two_ranks(
    results: Path, tmp_path: Path, name: str, on_ranks: Callable[..., Any]
) -> None:
    """Drawn by one of them, while the other waits."""
    words = ["plot", str(results / f"{name}.h5"), "--output", str(tmp_path)]
    assert on_ranks(codes, words) == [0, 0]
    assert list(tmp_path.glob("*.png"))


def test_reader_that_closes_its_pipe(tmp_path: Path) -> None:
    """Neither a message from PETSc nor a traceback."""
    command = " ".join([*PROGRAM, "modes", str(PAPER), "--output", str(tmp_path)])
    process = subprocess.run(
        f"{command} --verbose | true", shell=True, env=ENVIRONMENT, capture_output=True, text=True
    )
    assert "PETSC" not in process.stderr and "Traceback" not in process.stderr
    assert (tmp_path / "modes.h5").exists()
