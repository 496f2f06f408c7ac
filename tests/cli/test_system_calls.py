"""Files that commands open: those of the scene, results and caches, and of Python and Debian."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from surroundings import ROOT, no_rank
from system_calls import NEEDS_STRACE, opened_files, trace

pytestmark = [pytest.mark.nightly, NEEDS_STRACE]

PROGRAM = str(Path(sys.executable).with_name("fenics-crack"))
COARSE = ["--set", "mesh.size=0.03", "--set", "mesh.lip_elements=3"]
SHORT_CURVE = [*COARSE, "--set", "curve.stop=785", "--set", "curve.stability=false"]
COMMANDS = {
    "new": ["new", "other.toml"],
    "check": ["check", "plate.toml", *COARSE],
    "modes": ["modes", "plate.toml", *COARSE],
    "solve": ["solve", "plate.toml", *COARSE, "--fresh"],
    "solve from prepared.h5": ["solve", "plate.toml", *COARSE],
    "solve with matrices": ["solve", "chain.toml"],
    "verify": ["verify", "plate.toml", *COARSE],
    "curve": ["curve", "plate.toml", *SHORT_CURVE],
    "integrate": ["integrate", "plate.toml", *COARSE, "--set", "damping.ratio=0.05"],
    "sweep": ["sweep", "plate.toml", *COARSE, "--set", "sweep.over={'crack.length'=[0.02,0.03]}"],
    "grow": [
        "grow", "plate.toml", *COARSE, "--set", "growth.until=0.033", "--set",
        "growth.rate=6.9e-12", "--set", "growth.exponent=3.0",
    ],
    "campbell": ["campbell", "blade.toml", *COARSE],
    "disk": ["disk", "disk.toml", *COARSE],
    "timing": ["timing", "timing.toml", *COARSE],
    "reduce": ["reduce", "plate.toml", *COARSE],
    "identify": ["identify", "identify.toml", "identify_measured.csv", *COARSE],
    "plot": ["plot", "output/plate"],
    "report": ["report", "output/plate"],
    "clean": ["clean", "plate.toml"],
    "doctor": ["doctor"],
}  # fmt: skip
"""Words of a command by name."""
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
SYSTEM = ["/usr", "/lib", "/lib64", "/bin", "/etc", "/proc", "/sys", "/dev", "/run", "/var/cache"]
READABLE = [*SYSTEM, sys.prefix, sys.base_prefix, str(ROOT / "fenics_crack")]
WRITABLE = "/dev", "/proc/self"
"""Folders of Python and Debian; in those of devices nothing stays."""


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with scenes, and results of one."""
    folder = tmp_path_factory.mktemp("solved")
    for words in (
        ["new", "plate.toml"], ["new", "blade.toml", "--blade"], ["new", "disk.toml", "--disk"],
        ["new", "timing.toml", "--timing"], ["new", "identify.toml", "--identify"],
        ["solve", "plate.toml", *COARSE],
    ):  # fmt: skip
        subprocess.run([PROGRAM, *words], cwd=folder, check=False, env=no_rank())
    shutil.copytree(ROOT / "meshes" / "chain", folder / "chain")
    text = (ROOT / "demos" / "chain.toml").read_text()
    (folder / "chain.toml").write_text(text.replace("../meshes/", ""))
    return folder


@pytest.fixture
def folder(solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder, and a folder for temporary files beside it."""
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return Path(shutil.copytree(solved, tmp_path / "here"))


@pytest.mark.parametrize("name", COMMANDS)
def test_files_of_a_command(name: str, folder: Path) -> None:
    """No command reads or writes elsewhere."""
    own = folder, folder.with_name("temporary"), CACHE
    for path, writes in opened_files([PROGRAM, *COMMANDS[name]], folder):
        allowed = [*own, *(WRITABLE if writes else READABLE)]
        is_allowed = path == Path("/") or any(path.is_relative_to(one) for one in allowed)
        is_memory = path.is_relative_to("/memfd:numbers")
        assert is_allowed or is_memory or re.match(r"/proc/\d+", str(path)), (path, writes)


def test_results_are_written_before_the_structure(folder: Path) -> None:
    """Of which a full disk is then the only victim."""
    files = opened_files([PROGRAM, *COMMANDS["solve"]], folder)
    written = [path.name[10:] for path, writes in files if writes and path.name.startswith(".")]
    assert sorted(written[:3]) == ["solution.csv", "solution.h5", "solution.json"]
    assert written[3:] == ["prepared.h5"]


def test_same_command_leaves_the_earlier_result(folder: Path) -> None:
    """A, then B, then B: the second B opens nothing of A."""
    before, words = folder / "output" / "plate" / "before", ["--set", "crack.length=0.02"]
    command = [PROGRAM, *COMMANDS["solve from prepared.h5"], *words]
    subprocess.run(command, cwd=folder, check=False, env=no_rank())
    earlier = {path.name: path.read_bytes() for path in before.iterdir()}
    assert not [path for path, _ in opened_files(command, folder) if before in path.parents]
    assert {path.name: path.read_bytes() for path in before.iterdir()} == earlier


@pytest.mark.parametrize("next_command", ["check", "clean"])
def test_killed_at_the_rename(next_command: str, folder: Path) -> None:
    """The hidden file that this leaves goes with the next command."""
    results = folder / "output" / "plate"
    (results / "prepared.h5").unlink()
    kill = "--inject=rename,renameat,renameat2:error=EIO:signal=KILL"
    trace([PROGRAM, *COMMANDS["check"]], folder, kill)
    assert [path for path in results.glob(".*") if path.name.endswith(".prepared.h5")]
    trace([PROGRAM, *COMMANDS[next_command]], folder)
    assert not [*results.glob(".*")]
