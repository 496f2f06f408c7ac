"""The parts that all folders use: progress, tables, files that are written whole, threads."""

from __future__ import annotations

import csv
import io
import json
import logging
import os
import pickle
import re
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, ROOT, catch_error, two_masses
from ranks import LIMIT, run_program
from surroundings import main

import fenics_crack as fc
from fenics_crack.basics import machine, progress
from fenics_crack.basics.atomic_files import back_up_files, write_file_whole, write_files_together
from fenics_crack.basics.errors import WriteError
from fenics_crack.basics.observables import (
    OBSERVABLES_BY_NAME,
    ObservableTableFlag,
    Place,
    observable_names,
)
from fenics_crack.basics.tables import (
    UNIT_BY_DICT_ENTRY_NAME,
    Described,
    Table,
    Tabular,
    choose_factor_and_prefixed_unit,
    format_percent,
    format_quantity,
    format_range,
)
from fenics_crack.fem import compat
from fenics_crack.scene.result_tables import Sweep
from fenics_crack.scene.words import describe_differences, value_in_words
from fenics_crack.sweep.file import UNIT_AND_NUMPY_TYPE_BY_COLUMN

# --- stages and messages --------------------------------------------------------------------------


class Terminal(io.StringIO):
    """A stream that says it is one."""

    def isatty(self) -> bool:
        """It is."""
        return True


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()], ids=["terminal", "file"])
def test_long_stages_leave_a_line(stream: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal shows each as it begins; only what took more than a second stays."""
    clock = iter([0.0, 0.5, 3.0, 3.1])
    monkeypatch.setattr(progress.time, "perf_counter", lambda: next(clock))
    with progress.StageLineHandler(stream):
        progress.begin_stage("mesh")
        progress.begin_stage("natural modes")
        progress.begin_stage("solution")
    clear = "\r\033[K"
    live = (
        f"  mesh ...{clear}  natural modes ...{clear}  natural modes: 2.5 s\n  solution ...{clear}"
    )
    assert stream.getvalue() == (live if stream.isatty() else "  natural modes: 2.5 s\n")
    progress.begin_stage("nobody listens")


def test_stages_are_logged(paper_scene: fc.Scene, caplog: pytest.LogCaptureFixture) -> None:
    """Mesh, matrices, modes and attempts, in the order in which they happen."""
    caplog.set_level(logging.DEBUG, "fenics_crack")
    changes = {"mesh.columns": 8, "mesh.rows": 14, "contact.stiffness": 1e9}  # of no other test
    study = fc.prepare(paper_scene.replace(changes))
    fc.solve_harmonic_balance(study.structure, 2000.0, study.contact, harmonics=5)
    assert caplog.messages[:2] == ["mesh", "matrices"]
    assert any(stage.endswith("natural modes") for stage in caplog.messages)
    assert "from fewer harmonics" in caplog.messages


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()], ids=["terminal", "file"])
@pytest.mark.parametrize("kept", [True, False], ids=["kept", "brief"])
def test_signs_of_life(stream: io.StringIO, kept: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes long says so now and then, while it computes, and not after its end."""
    passed_event, threads = threading.Event(), list[threading.Thread]()

    class Beats(threading.Event):
        """Three beats pass, and then none until the end."""

        left = 4

        def wait(self, timeout: float | None = None) -> bool:
            """True at the end."""
            self.left -= 1
            if self.left:
                return False
            passed_event.set()
            return super().wait(LIMIT)

    def thread(**given: Any) -> threading.Thread:
        threads.append(threading.Thread(**given))
        return threads[-1]

    monkeypatch.setattr(progress, "threading", SimpleNamespace(Event=Beats, Thread=thread))
    monkeypatch.setattr(progress.time, "perf_counter", lambda: 7.0)
    stream.seek(0)
    stream.truncate()
    with progress.StageLineHandler(stream, keeps_lines=kept):
        progress.begin_stage("path")
        assert passed_event.wait(LIMIT)
    shown_text = stream.getvalue()
    assert (
        shown_text.count("\r\033[K  path ... 0 s" if stream.isatty() else "  path ... 0 s\n") == 3
    )
    threads[0].join(LIMIT)
    assert len(threads) == 1 and not threads[0].is_alive() and stream.getvalue() == shown_text


# --- tables ---------------------------------------------------------------------------------------

TABLES = ("modes", "curve", "sweep")
RESULTS = ("solution", "judged", "linear", "report", "stability", "bifurcation", "orbit", *TABLES)


@pytest.fixture(scope="module")
def results(paper_scene: fc.Scene) -> dict[str, Any]:
    """One result of each kind, of two masses with a stop."""
    masses, law = two_masses(), fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(masses, 1.0, law)
    stability = fc.floquet(masses, solution)
    curve = fc.continue_frequency(masses, 0.5, 1.2, law, harmonics=3, stability=True)
    return {
        "solution": solution,
        "judged": replace(solution, stability=stability),
        "linear": fc.solve_linear(masses, 1.0),
        "report": solution.report,
        "stability": stability,
        "bifurcation": curve.bifurcations[0],
        "orbit": fc.shoot(masses, solution),
        "modes": fc.solve_modes(masses, 2),
        "curve": curve,
        "sweep": made_sweep(paper_scene),
    }


def made_sweep(scene: fc.Scene) -> fc.SweepResult:
    """Two lengths by three frequencies, one case failed, one pending."""
    over = {"crack.length": [0.03, 0.05], "excitation.omega": [1900.0, 2000.0, 2100.0]}
    numbers = np.arange(6.0).reshape(2, 3)
    columns: dict[str, np.ndarray] = {
        name: numbers.astype(str if kind.startswith("S") else kind)
        for name, (_, kind) in UNIT_AND_NUMPY_TYPE_BY_COLUMN.items()
    }
    columns["state"] = np.array([[1, 1, 2], [1, 1, 0]])
    swept_scene = replace(scene, sweep=Sweep.from_mapping({"over": over}))
    return fc.SweepResult(Path("sweep.h5"), swept_scene, columns)


def plain(value: object) -> bool:
    """Whether a value is one of Python's own kinds."""
    return type(value) in (int, float, str, bool)


@pytest.mark.parametrize("name", RESULTS)
def test_results_describe_themselves(name: str, results: dict[str, Any]) -> None:
    """One short line, a table in a notebook, and a dict as pandas takes it."""
    result = results[name]
    assert isinstance(result, Described)
    line = repr(result)
    assert line.startswith(f"{type(result).__name__}(") and line.endswith(")")
    assert "\n" not in line and len(line) < 140 and "array" not in line
    page = result._repr_html_()
    assert page.startswith("<table>") and page.count("<table>") == page.count("</table>") == 1
    entries = result.to_dict()
    assert all(type(key) is str for key in entries)
    if name in TABLES:
        assert isinstance(result, Tabular)
        assert len({len(column) for column in entries.values()}) == 1
        assert all(plain(value) for column in entries.values() for value in column)
    else:
        assert all(map(plain, entries.values()))


@pytest.mark.parametrize("name", TABLES)
def test_tables_read_back(name: str, results: dict[str, Any], tmp_path: Path) -> None:
    """The file has the columns of the dict, to the last digit, with their units."""
    path = tmp_path / "new" / f"{name}.csv"
    results[name].to_csv(path)
    with open(path, newline="") as file:
        header, *rows = csv.reader(file)
    entries = results[name].to_dict()
    assert [column.split(" [")[0] for column in header] == list(entries)
    assert any("[rad/s]" in column for column in header)
    for column, values in zip(zip(*rows, strict=True), entries.values(), strict=True):
        for text, value in zip(column, values, strict=True):
            assert text == str(value)
    catch_error(lambda: results[name].to_csv(path / "no folder.csv"), "path")


def test_what_the_lines_say(results: dict[str, Any]) -> None:
    """Frequency, harmonics, pairs, opening and error; counts; how it ended."""
    solution = results["solution"]
    opening = -solution.gap(np.linspace(0.0, solution.period, 1024, endpoint=False)).min()
    assert repr(solution) == (
        f"PeriodicSolution(1 rad/s, H = 5, 1 pair, opening {opening:.4g} m, "
        f"error {solution.report.total:.2g}, converged)"
    )
    assert results["stability"].verdict in repr(results["judged"])
    assert "linear, converged" in repr(results["linear"])
    assert "NOT CONVERGED" in repr(replace(solution, converged=False))
    assert "period of 2 loads" in repr(replace(solution, subharmonic=2))
    assert f"{len(results['curve'])} points" in repr(results["curve"])
    assert "fold at " in repr(results["bifurcation"]) or "doubling" in repr(results["bifurcation"])
    assert repr(results["sweep"]) == (
        "SweepResult(2 crack.length x 3 excitation.omega, 1 pending, 4 converged, 1 failed)"
    )
    assert repr(results["modes"]).startswith("Modes(2 modes, ")


def test_dicts_say_what_the_results_are(results: dict[str, Any]) -> None:
    """Values are those of the attributes."""
    curve, sweep = results["curve"].to_dict(), results["sweep"].to_dict()
    indicators = results["curve"].indicators(results["curve"].structure.watched_dof)
    assert list(curve)[:5] == ["omega", "frequency", "iterations", "multiplier", "verdict"]
    assert curve["amplitude"] == indicators.amplitude.tolist()
    assert curve["ratio_2_1"] == indicators.ratio_2_1.tolist()
    assert curve["omega"] == results["curve"].omega.tolist()
    assert sweep["excitation.omega"] == 2 * [1900.0, 2000.0, 2100.0]
    assert sweep["crack.length"] == 3 * [0.03] + 3 * [0.05]
    assert sweep["state"][2] == "failed" and sweep["response"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    solution = results["judged"].to_dict()
    assert solution["multiplier"] == results["stability"].to_dict()["modulus"]
    assert solution["total_error"] == results["report"].to_dict()["total"]


def test_entries_of_contact(results: dict[str, Any]) -> None:
    """Extremes over the period, hardly above those of samples; without pairs there is no entry of
    contact."""
    solution = results["bifurcation"].solution
    time = np.linspace(0.0, solution.period, 1024, endpoint=False)
    gap, force = solution.gap(time), solution.contact_force(time)
    entries = solution.to_dict()
    sampled_maxima = gap.max(), force.max(), np.ptp(solution.displacement(time, [1])) / 2.0
    for exact, entry in zip(
        (entries["penetration"], entries["contact_force"], solution.amplitude(1)),
        sampled_maxima,
        strict=True,
    ):
        assert 0.0 < entry <= exact < entry * (1.0 + 1e-5)
    assert entries["closed_share"] == np.mean(force > 0.0)
    free_linear_solution = fc.solve_linear(
        fc.Structure.from_matrices(np.eye(1), np.eye(1), gap=None), 0.5
    )
    of_faces = observable_names(
        Place.CRACK_FACES, excluded_flags=ObservableTableFlag.REQUIRES_FRICTION
    )
    assert (
        entries.keys() - free_linear_solution.to_dict().keys()
        == {*of_faces}
        >= {"opening", "closed_share"}
    )
    table = solution.table("contact_force", "omega")
    force_row = "contact_force [N]", entries["contact_force"]
    assert table.rows == [force_row, ("omega [rad/s]", solution.omega)]


def test_sweep_over_its_keys(results: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """An xarray.Dataset of dimensions, numbers and units; without xarray one clear error."""
    dataset = SimpleNamespace(Dataset=lambda columns, swept: (columns, swept))
    monkeypatch.setitem(sys.modules, "xarray", dataset)
    columns, swept_columns = results["sweep"].to_xarray()
    keys, response, attributes = columns["response"]
    assert keys == [*swept_columns] == ["crack.length", "excitation.omega"]
    assert response.shape == (2, 3) and attributes == {"units": "m"}
    assert swept_columns["crack.length"] == [0.03, 0.05] and columns["state"][1].shape == (2, 3)
    monkeypatch.setitem(sys.modules, "xarray", None)
    catch_error(
        results["sweep"].to_xarray, names=r"to_xarray needs xarray \(pip install", kind=ImportError
    )


def test_long_tables_are_cut_for_eyes_only() -> None:
    """In text and in a notebook; CSV and JSON have all rows."""
    table = Table(("n [<m>]", "word"), [[n, "<b>"] for n in range(50)])
    assert table.format_as("text").endswith("... and 10 more\n")
    page = table.html("a & b")
    assert page.count("<tr>") == 41 and "a &amp; b; the first 40 of 50 rows" in page
    assert "&lt;b&gt;" in page and "<b>" not in page and "n [&lt;m&gt;]" in page
    assert len(table.format_as("csv").splitlines()) == 51
    assert len(json.loads(table.format_as("json"))) == 50


def test_quantities() -> None:
    """A number with a prefix that suits it."""
    text_by_value = {
        1.4514e-6: "1.451 µm",
        0.0: "0 m",
        -2e-9: "-2 nm",
        999.97e-6: "1000 µm",
        12.0: "12 m",
    }
    assert {value: format_quantity(value, "m") for value in text_by_value} == text_by_value
    text_by_unit = {"": "0.02", "1": "0.02", "deg": "0.02 deg", "Hz": "0.02 Hz"}
    assert {unit: format_quantity(0.02, unit) for unit in text_by_unit} == text_by_unit


def test_a_name_has_one_unit() -> None:
    """An observable named like an entry of another table would silently take its unit."""
    observables = {name: row.unit for name, row in OBSERVABLES_BY_NAME.items()}
    assert {name: UNIT_BY_DICT_ENTRY_NAME[name] for name in observables} == observables


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0, "0 %"), (0.0238, "2.4 %"), (0.994, "99 %"), (0.997, "100 %"), (1.4, "140 %")],
)
def test_shares_in_per_cent(share: float, words: str) -> None:
    """Without an exponent, also of an error as large as its number."""
    assert format_percent(share) == words


def test_ranges_in_words() -> None:
    """Ends that read alike are said once."""
    assert format_range(np.array([9, 9])) == "9" and format_range(np.array([40, 5, 7])) == "5 to 40"
    assert format_range(np.array([0.12, 0.1204]), ".2g") == "0.12"


def test_units_that_read_well() -> None:
    """Three digits before the point at most."""
    for magnitude, unit, factor, expected_unit in (
        (2e-7, "m", 1e9, "nm"), (1.7e-6, "m", 1e6, "µm"), (0.0, "m", 1.0, "m"),
        (3.3e4, "Pa", 1e-3, "kPa"), (5e-14, "m", 1e15, "10^-15 m"),
    ):  # fmt: skip
        assert choose_factor_and_prefixed_unit(magnitude, unit) == (
            pytest.approx(factor),
            expected_unit,
        )


def test_values_of_keys_in_words() -> None:
    """With the prefix that is usual; none of degrees, which were 500 mdegrees."""
    assert value_in_words("crack.length", 0.035) == "35 mm"
    assert value_in_words("excitation.omega", 2000.0) == "2000 rad/s"
    assert value_in_words("loads.1.phase", 0.5) == "0.5 degrees"


def test_a_default_of_a_listed_table_is_told(paper_scene: fc.Scene) -> None:
    """As that of any other: it was "none"."""
    one = paper_scene.replace({"loads.1.edge": "top", "loads.1.traction_sin": [1.0, 0.0]})
    lagging = one.replace({"loads.1.phase": 30.0})
    notes = ["loads.1.phase = 0 degrees", "loads.1.phase = 30 degrees"]
    assert describe_differences([one, lagging]) == notes
    assert describe_differences([paper_scene, one])[0].startswith("loads.1.edge = none")


# --- files, whole or not at all -------------------------------------------------------------------

SMALL = [
    "--set", "harmonic_balance.harmonics=3", "--set", "curve.stop=7.5", "--set",
    'sweep.over={"excitation.frequency"=[8.0,9.0]}', "--quiet",
]  # fmt: skip
COMMANDS = {
    "solve": ["solution.h5", "solution.csv", "solution.json"],
    "curve": ["curve.h5", "curve.csv", "curve.json"],
    "sweep": ["sweep.csv", "sweep.json"],
    "plot": ["solution_waves.png", "solution_spectrum.png", "solution_orbits.png"],
    "report": ["report.html"],
}
"""What each writes, but for the file of the sweep, which is continued."""


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """No file of this process can grow beyond a size, as on a full disk; modules are not written,
    as Python does not see that it wrote them in part."""
    earlier_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    writes_no_modules, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, earlier_limit[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, earlier_limit)
        sys.dont_write_bytecode = writes_no_modules


@pytest.fixture(scope="module")
def chain_result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solution of the chain of demos/."""
    folder = tmp_path_factory.mktemp("chain")
    assert main(["solve", str(DEMOS / "chain.toml"), *SMALL, "--output", str(folder)]) == 0
    return folder / "solution.h5"


@pytest.mark.drawn(3)
@pytest.mark.usefixtures("not_drawn")
@pytest.mark.parametrize("command", COMMANDS)
def test_full_disk(
    command: str, chain_result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line with a file's name, exit code 1; what was there stays, and the next run is whole."""
    words = [command, str(DEMOS / "chain.toml"), *SMALL, "--output", str(tmp_path)]
    if command in ("plot", "report"):
        page = "report.html" if command == "report" else ""
        words = [command, str(chain_result), "--quiet", "--output", str(tmp_path / page)]
    for name in COMMANDS[command]:
        (tmp_path / name).write_text("before")
    capsys.readouterr()
    with room_for(100):
        assert main(words) == 1
    output = capsys.readouterr()
    (line,) = output.err.splitlines()
    assert re.search(r"= '/.*\.(h5|json|png)': must be a file that can be written \(.", line), line
    assert {file.name for file in tmp_path.iterdir()} - {"before"} == {*COMMANDS[command]}
    assert all((tmp_path / name).read_text() == "before" for name in COMMANDS[command])
    assert main(words) == 0
    assert all((tmp_path / name).stat().st_size > 100 for name in COMMANDS[command])


def run_without_room(words: list[str], comm: Any) -> tuple[list[int], list[str]]:
    """Exit codes and lines of the program where files have room for 100 bytes (collective)."""
    with room_for(100):
        return run_program(words, comm)


@pytest.mark.mpi
@pytest.mark.parametrize("command", ["solve", "sweep"])
def test_full_disk_on_two_ranks(command: str, tmp_path: Path, on_ranks: Callable[..., Any]) -> None:
    """One line of both; no file of a result without the others."""
    words = [command, str(DEMOS / "chain.toml"), *SMALL, "--output", str(tmp_path)]
    for name in COMMANDS[command]:
        (tmp_path / name).write_text("before")
    codes, lines = on_ranks(run_without_room, words)
    assert codes == [1, 1] and len(lines) == 1, lines
    assert re.search(r"= '/.*\.(h5|json)': must be a file that can be written \(.", lines[0])
    files_left = {file.name for file in tmp_path.iterdir()} - {"before"}
    assert files_left == {*COMMANDS[command]}
    assert all((tmp_path / name).read_text() == "before" for name in COMMANDS[command])
    codes, lines = on_ranks(run_program, words)
    assert codes == [0, 0], lines
    assert all((tmp_path / name).stat().st_size > 100 for name in COMMANDS[command])


@pytest.mark.nightly
@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("unshare"), reason="cannot mount")
def test_full_tmpfs(chain_result: Path, tmp_path: Path) -> None:
    """A disk that is full, not a limit: the same line, and nothing of libhdf5."""
    shell = f'mount -t tmpfs -o size=20k tmpfs {tmp_path} || exit 99; exec "$@"'
    words = ["sweep", str(DEMOS / "chain.toml"), *SMALL, "--output", str(tmp_path / "new")]
    program = [sys.executable, "-m", "fenics_crack", *words]
    process = subprocess.run(
        ["unshare", "-m", "sh", "-c", shell, "sh", *program],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if process.returncode == 99 or process.stderr.startswith("unshare: "):  # as in a chroot
        pytest.skip("cannot mount")
    line, *more_lines = process.stderr.splitlines()
    assert not more_lines, process.stderr
    assert process.returncode == 1 and "sweep.h5" in line and "No space left" in line


@pytest.mark.drawn(3)
@pytest.mark.usefixtures("not_drawn")
@pytest.mark.parametrize("command", COMMANDS)
def test_links_in_the_folder_lead_nowhere(command: str, chain_result: Path, tmp_path: Path) -> None:
    """A file takes the place of a link, and what the link leads to stays as it was."""
    own_folder, victim = tmp_path / "own", tmp_path / "victim"
    own_folder.mkdir()
    victim.write_text("before")
    for name in COMMANDS[command]:
        (own_folder / name).symlink_to(victim)
    words = [command, str(DEMOS / "chain.toml"), *SMALL, "--output", str(own_folder)]
    if command in ("plot", "report"):
        page = "report.html" if command == "report" else ""
        words = [command, str(chain_result), "--quiet", "--output", str(own_folder / page)]
    assert main(words) == 0
    assert victim.read_text() == "before"
    assert not any((own_folder / name).is_symlink() for name in COMMANDS[command])


@pytest.mark.parametrize("there", [True, False])
def test_a_sweep_through_a_link_is_refused(
    there: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line, whether the link leads to another sweep of the same scene or to nothing yet."""
    words = ["sweep", str(DEMOS / "chain.toml"), *SMALL, "--output"]
    victim, own_folder = tmp_path / "victim", tmp_path / "own"
    if there:
        assert main([*words, str(victim)]) == 0
    own_folder.mkdir()
    (own_folder / "sweep.h5").symlink_to(victim / "sweep.h5")
    capsys.readouterr()
    assert main([*words, str(own_folder)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "regular file" in line and (victim / "sweep.h5").exists() == there


def test_links_devices_and_folders(tmp_path: Path) -> None:
    """A link is replaced, a device is written to as it is, a folder is refused."""
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("before")
    link.symlink_to(file)
    write_file_whole(link, "after")
    assert not link.is_symlink() and file.read_text() == "before" and link.read_text() == "after"
    write_file_whole("/dev/null", "anything")
    assert Path("/dev/null").is_char_device()
    catch_error(
        lambda: write_file_whole("/dev/full", "anything"), "path", "/dev/full", kind=WriteError
    )
    catch_error(lambda: write_file_whole(tmp_path, "anything"), "path", str(tmp_path))
    assert sorted(tmp_path.iterdir()) == [file, link]


@pytest.mark.parametrize("linking", [True, False])
def test_a_file_that_is_kept(
    linking: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder below, where no link is followed, also on a file system without hard links."""
    own_folder, kept_path, victim = (tmp_path / name for name in ("own", "own/kept", "victim"))
    kept_path.mkdir(parents=True)
    victim.write_text("victim")
    (own_folder / "a").write_text("before")
    for link in (own_folder / "b", kept_path / "a", kept_path / "b", kept_path / "c"):
        link.symlink_to(victim)
    if not linking:
        monkeypatch.setattr(os, "link", lambda *_: os.lstat("/nothing"))  # an OSError
    assert back_up_files(("a", "b", "d"), own_folder, kept_path) and not back_up_files(
        ("c", "d"), own_folder, kept_path
    )
    write_file_whole(own_folder / "a", "after")
    assert victim.read_text() == "victim" and (kept_path / "a").read_text() == "before"
    assert sorted(path.name for path in kept_path.iterdir()) == ["a", "c"]
    (own_folder / "link").symlink_to(kept_path)
    catch_error(
        lambda: back_up_files(("a",), own_folder, own_folder / "link"), kind=NotADirectoryError
    )


def test_all_or_none(tmp_path: Path) -> None:
    """Files that belong together, of which one is too long."""
    names = [tmp_path / name for name in ("new/a", "new/b", "new/c")]
    write_files_together((name, "before") for name in names)
    contents = zip(names, ("after", "after" * 100, "after"), strict=True)
    with room_for(100):
        catch_error(lambda: write_files_together(contents), "path", str(names[1]), kind=WriteError)
    assert [name.read_text() for name in names] == ["before"] * 3
    assert len(list((tmp_path / "new").iterdir())) == 3


@pytest.mark.parametrize("name", ["solution.csv", "solution.json"])
def test_a_result_is_whole(
    name: str, chain_result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command whose table cannot be written leaves the earlier result, all of it."""
    shutil.copytree(chain_result.parent, tmp_path, dirs_exist_ok=True)
    (tmp_path / name).unlink()
    (tmp_path / name).mkdir()
    content_by_path = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    words = ["solve", str(DEMOS / "chain.toml"), *SMALL, "--set", "excitation.frequency=7.9"]
    assert main([*words, "--output", str(tmp_path)]) == 2
    assert name in capsys.readouterr().err
    assert content_by_path == {
        path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()
    }


def test_mesh_file_is_whole(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """gmsh itself does not notice that a file is cut."""
    path = tmp_path / "plate.msh"
    with room_for(500):
        catch_error(lambda: fc.write_msh(paper_scene, path), "path", str(path), kind=WriteError)
    assert not list(tmp_path.iterdir())


def test_full_output(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """The table cannot be printed, or there is nowhere to print it."""
    with open("/dev/full", "w") as full_device:
        for output in (full_device, None):
            monkeypatch.setattr(sys, "stdout", output)
            assert main(["check", str(DEMOS / "chain.toml"), "--quiet"]) == 1
        monkeypatch.undo()
    assert capfd.readouterr().err.splitlines() == [
        "fenics-crack: standard output cannot be written (No space left on device); free disk "
        "space",
        "fenics-crack: standard output is closed; open it, or redirect it to a file: > table.txt",
    ]


def test_too_little_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """One line; without the question SCOTCH prints words of its own, or DOLFINx never ends."""
    plate = tmp_path / "plate.toml"
    assert main(["new", str(plate), "--quiet"]) == 0
    monkeypatch.setattr(compat, "remaining_address_space", lambda: 1e8)
    capfd.readouterr()
    assert main(["check", str(plate)]) == 1
    assert capfd.readouterr().err == (
        "fenics-crack: not enough memory; use a coarser mesh, fewer modes or a machine with more "
        "memory\n"
    )


# --- threads --------------------------------------------------------------------------------------

THREADS = """
import logging, threading
import fenics_crack as fc
logging.disable(logging.INFO)
scene, found = fc.Scene.load("demos/paper_plate.toml"), []

def work(columns):
    study = fc.prepare(scene.replace({"mesh.columns": columns}))
    solution = fc.solve_linear(study.structure, 2000.0)
    found.append((study.structure.n_dofs, solution.converged))

threads = [threading.Thread(target=work, args=(columns,)) for columns in (2, 4, 6)]
for step in ("start", "join"):
    for thread in threads:
        getattr(thread, step)()
print(sorted(found))
"""


class Pool:
    """Takes the place of a loaded OpenBLAS, and keeps what it is told."""

    def __init__(self, threads: int) -> None:
        self.threads, self.told = threads, list[int]()

    def __call__(self, name: str, *values: int) -> int:
        if name == "set_num_threads":
            self.told += values
            self.threads = values[0]
        return self.threads


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> Pool:
    """The only OpenBLAS, of a user who has said nothing, on 8 processors."""
    loaded_pool = Pool(8)
    monkeypatch.setattr(
        machine, "_load_openblas_with_thread_counts", lambda modules: [(loaded_pool, 8)]
    )
    for name in machine.THREAD_COUNT_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    return loaded_pool


def test_one_thread_of_openblas(pool: Pool) -> None:
    """In functions of the package and in `from_matrices`; restored afterwards, errors or not."""
    make, solve = fc.Structure.from_matrices, fc.solve_modes
    pool.told.clear()  # by imports
    structure = make(np.eye(1), np.eye(1), gap=None)
    assert pool.told == [1, 8]
    catch_error(lambda: solve(structure, 2), "count", 2)
    assert pool.told == [1, 8] * 2
    with machine.run_single_threaded(), machine.run_single_threaded():
        assert pool.threads == 1
    assert pool.told == [1, 8] * 3


@pytest.mark.parametrize("name", machine.THREAD_COUNT_VARIABLES)
def test_the_user_decides(pool: Pool, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a variable, or by a number other than that with which OpenBLAS begins."""
    pool.threads = 3
    with machine.run_single_threaded():
        assert pool.threads == 3
    pool.threads = 8
    monkeypatch.setenv(name, "8")
    with machine.run_single_threaded():
        assert pool.threads == 8
    assert pool.told == []


@pytest.mark.parametrize(
    ("vendor", "flags", "core_type"),
    [
        ("GenuineIntel", "fma avx avx2 avx512f avx512dq avx512cd avx512bw avx512vl", "SkylakeX"),
        ("GenuineIntel", "fma avx avx2 avx512f", "Haswell"),
        ("GenuineIntel", "sse2 avx", None),
        ("AuthenticAMD", "fma avx avx2", None),
    ],
)
def test_intel_processors_are_named_for_openblas(
    vendor: str, flags: str, core_type: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what the processor can do, while NumPy is loaded; the user's choice stays."""
    file = tmp_path / "cpuinfo"
    file.write_text(f"processor\t: 0\nvendor_id\t: {vendor}\nflags\t\t: fpu {flags}\nbugs\t:\n")
    seen: list[str | None] = []
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    monkeypatch.delitem(sys.modules, "numpy")
    finder = SimpleNamespace(
        find_spec=lambda name, *_: seen.append(os.environ.get("OPENBLAS_CORETYPE"))
    )
    monkeypatch.setattr(sys, "meta_path", [finder])
    for choice in (None, "Zen"):
        if choice:
            monkeypatch.setenv("OPENBLAS_CORETYPE", choice)
        for cpu_info in (tmp_path / "missing", file):
            with suppress(ImportError):
                machine.load_openblas(cpu_info)
            assert os.environ.get("OPENBLAS_CORETYPE") == choice
    assert seen == ([core_type] if core_type else [])


def test_no_other_process_gets_the_name_of_this_processor() -> None:
    """A child process may run on another machine."""
    program = "import os, fenics_crack; print(os.environ.get('OPENBLAS_CORETYPE'))"
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_CORETYPE"}
    answer = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "None"


def test_program_starts_one_thread_of_openblas(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless the user has chosen a number, or OpenBLAS is loaded already."""
    for name in machine.THREAD_COUNT_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    machine.choose_single_openblas_thread()
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delitem(sys.modules, "numpy")
    machine.choose_single_openblas_thread()
    assert "OPENBLAS_NUM_THREADS" not in os.environ
    monkeypatch.delenv("OMP_NUM_THREADS")
    machine.choose_single_openblas_thread()
    assert os.environ.pop("OPENBLAS_NUM_THREADS") == "1"


def test_loaded_libraries_are_found() -> None:
    """Debian's, which NumPy, SciPy and PETSc share, or each of three wheels' own, in a program
    without settings."""
    program = """
import sys
from unittest.mock import patch
import fenics_crack as fc
from fenics_crack.basics import machine
from surroundings import main
fc.prepare, fc.Scene

def counted():
    pools = machine._load_openblas_with_thread_counts(len(sys.modules))
    return len(pools), {pool("get_num_threads") == begin for pool, begin in pools}, {
        pool("get_num_threads") for pool, _ in pools}

print(counted()[:2])
with patch("fenics_crack.cli.command_line._call_command", lambda *_: print(counted()[::2])):
    main(["check", "demos/paper_plate.toml"])
print(counted()[:2])
"""
    count = 3 if find_spec("dolfinx_solver") else 1
    assert run(program).splitlines() == [f"({count}, {{{seen}}})" for seen in (True, 1, True)]


def test_a_command_has_one_thread_of_each_openblas() -> None:
    """Also of SciPy's own, which a command loads after all others; two of them would take eight
    times as long."""
    program = """
from unittest.mock import patch
from fenics_crack.basics import machine
from surroundings import main

def counted(*_):
    import scipy.linalg
    print({pool("get_num_threads") for pool, _ in machine._load_openblas_with_thread_counts(-1)})

with patch("fenics_crack.cli.command_line._call_command", counted):
    main(["check", "demos/paper_plate.toml"])
"""
    assert run(program).splitlines() == ["{1}"]


@pytest.mark.nightly
@pytest.mark.parametrize("chosen", [{}, {"OMP_NUM_THREADS": "1"}])
def test_no_thread_of_openmp(chosen: dict[str, str]) -> None:
    """CHOLMOD begins none, which asks for four whatever is set; the limit is restored."""
    program = """
import os, sys
import fenics_crack as fc
from fenics_crack.basics import machine
study = fc.prepare(fc.Scene.load("demos/breathing_plate.toml"), whole=True)
library, = machine._load_openmp_libraries(len(sys.modules))
print(library.omp_get_max_active_levels() > 0)
before = len(os.listdir("/proc/self/task"))
fc.solve_modes(study.structure, 2)
print(len(os.listdir("/proc/self/task")) - before, library.omp_get_max_active_levels() > 0)
"""
    assert run(program, chosen).splitlines() == ["True", "0 True"]


def test_three_threads_at_once() -> None:
    """Each waits for the others: gmsh would end the process."""
    assert run(THREADS) == "[(50, True), (57, True), (84, True)]"


def test_functions_can_be_pickled() -> None:
    """For processes of multiprocessing."""
    assert pickle.loads(pickle.dumps(fc.prepare)) is fc.prepare


def run(program: str, chosen: dict[str, str] | None = None) -> str:
    """What a program prints in a process of its own, with these settings of threads alone."""
    settings = dict.fromkeys(machine.THREAD_COUNT_VARIABLES)
    environment = {name: value for name, value in os.environ.items() if name not in settings}
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=LIMIT, cwd=ROOT,
        env=environment | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"} | (chosen or {}),
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return process.stdout.strip()
