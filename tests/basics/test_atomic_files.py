"""Files are written whole or not at all: full disks, closed outputs, too little memory."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers import DEMOS, ROOT
from surroundings import main

import fenics_crack as fc
from fenics_crack.basics.atomic_files import write_together, write_whole
from fenics_crack.basics.errors import WriteError
from fenics_crack.fem import compat

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
    """No file of this process can grow beyond a size, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solution of the chain of demos/."""
    folder = tmp_path_factory.mktemp("chain")
    assert main(["solve", str(DEMOS / "chain.toml"), *SMALL, "--output", str(folder)]) == 0
    return folder / "solution.h5"


@pytest.mark.parametrize("command", COMMANDS)
def test_full_disk(
    command: str, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line with a file's name, exit code 1; what was there stays, and the next run is whole."""
    words = [command, str(DEMOS / "chain.toml"), *SMALL, "--output", str(tmp_path)]
    if command in ("plot", "report"):
        page = "report.html" if command == "report" else ""
        words = [command, str(results), "--quiet", "--output", str(tmp_path / page)]
    for name in COMMANDS[command]:
        (tmp_path / name).write_text("before")
    capsys.readouterr()
    with room_for(100):
        assert main(words) == 1
    told = capsys.readouterr()
    (line,) = told.err.splitlines()
    assert re.search(r"= '/.*\.(h5|json|png)': must be a file that can be written \(.", line), line
    assert {file.name for file in tmp_path.iterdir()} - {"before"} == {*COMMANDS[command]}
    assert all((tmp_path / name).read_text() == "before" for name in COMMANDS[command])
    assert main(words) == 0
    assert all((tmp_path / name).stat().st_size > 100 for name in COMMANDS[command])


@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("unshare"), reason="cannot mount")
def test_full_tmpfs(results: Path, tmp_path: Path) -> None:
    """A disk that is full, not a limit: the same line, and nothing of libhdf5."""
    shell = f'mount -t tmpfs -o size=20k tmpfs {tmp_path} || exit 99; exec "$@"'
    words = ["sweep", str(DEMOS / "chain.toml"), *SMALL, "--output", str(tmp_path / "new")]
    program = [sys.executable, "-m", "fenics_crack", *words]
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", shell, "sh", *program],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode == 99 or done.stderr.startswith("unshare: "):  # as in a chroot
        pytest.skip("cannot mount")
    line, *more = done.stderr.splitlines()
    assert not more, done.stderr
    assert done.returncode == 1 and "sweep.h5" in line and "No space left" in line


@pytest.mark.parametrize("command", COMMANDS)
def test_links_in_the_folder_lead_nowhere(command: str, results: Path, tmp_path: Path) -> None:
    """A file takes the place of a link, and what the link leads to stays as it was."""
    own, victim = tmp_path / "own", tmp_path / "victim"
    own.mkdir()
    victim.write_text("before")
    for name in COMMANDS[command]:
        (own / name).symlink_to(victim)
    words = [command, str(DEMOS / "chain.toml"), *SMALL, "--output", str(own)]
    if command in ("plot", "report"):
        page = "report.html" if command == "report" else ""
        words = [command, str(results), "--quiet", "--output", str(own / page)]
    assert main(words) == 0
    assert victim.read_text() == "before"
    assert not any((own / name).is_symlink() for name in COMMANDS[command])


@pytest.mark.parametrize("there", [True, False])
def test_a_sweep_through_a_link_is_refused(
    there: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line, whether the link leads to another sweep of the same scene or to nothing yet."""
    words = ["sweep", str(DEMOS / "chain.toml"), *SMALL, "--output"]
    victim, own = tmp_path / "victim", tmp_path / "own"
    if there:
        assert main([*words, str(victim)]) == 0
    own.mkdir()
    (own / "sweep.h5").symlink_to(victim / "sweep.h5")
    capsys.readouterr()
    assert main([*words, str(own)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "regular file" in line and (victim / "sweep.h5").exists() == there


def test_links_devices_and_folders(tmp_path: Path) -> None:
    """A link is replaced, a device is written to as it is, a folder is refused."""
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("before")
    link.symlink_to(file)
    write_whole(link, "after")
    assert not link.is_symlink() and file.read_text() == "before" and link.read_text() == "after"
    write_whole("/dev/null", "anything")
    assert Path("/dev/null").is_char_device()
    with pytest.raises(WriteError, match="/dev/full"):
        write_whole("/dev/full", "anything")
    with pytest.raises(fc.InputError, match="can be written") as refused:
        write_whole(tmp_path, "anything")
    assert not isinstance(refused.value, WriteError)
    assert sorted(tmp_path.iterdir()) == [file, link]


def test_all_or_none(tmp_path: Path) -> None:
    """Files that belong together, of which one is too long."""
    names = [tmp_path / name for name in ("new/a", "new/b", "new/c")]
    write_together((name, "before") for name in names)
    with room_for(100), pytest.raises(WriteError, match="new/b"):
        write_together(zip(names, ("after", "after" * 100, "after"), strict=True))
    assert [name.read_text() for name in names] == ["before"] * 3
    assert len(list((tmp_path / "new").iterdir())) == 3


def test_mesh_file_is_whole(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """gmsh itself does not notice that a file is cut."""
    path = tmp_path / "plate.msh"
    with room_for(500), pytest.raises(WriteError, match=r"plate\.msh"):
        fc.write_msh(paper_scene, path)
    assert not list(tmp_path.iterdir())


def test_full_output(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """The table cannot be printed, or there is nowhere to print it."""
    with open("/dev/full", "w") as full:
        for output in (full, None):
            monkeypatch.setattr(sys, "stdout", output)
            assert main(["check", str(DEMOS / "chain.toml"), "--quiet"]) == 1
        monkeypatch.undo()
    assert capfd.readouterr().err.splitlines() == [
        "fenics-crack: standard output cannot be written (No space left on device)",
        "fenics-crack: standard output is closed",
    ]


def test_too_little_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """One line; without the question SCOTCH prints words of its own, or DOLFINx never ends."""
    plate = tmp_path / "plate.toml"
    assert main(["new", str(plate), "--quiet"]) == 0
    monkeypatch.setattr(compat, "addresses_left", lambda: 1e8)
    capfd.readouterr()
    assert main(["check", str(plate)]) == 1
    assert capfd.readouterr().err == "fenics-crack: memory was not enough\n"
