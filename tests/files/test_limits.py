"""What a file may ask for: what is too large, or never ends, is refused at once."""

from __future__ import annotations

import gzip
import lzma
import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import DEMOS, ROOT, catch_error
from ranks import LIMIT
from surroundings import RunCommand, main, no_rank

from fenics_crack.basics import untrusted_files
from fenics_crack.fem.model_files import read_nodes_and_cells

SECONDS, MEMORY = 20.0, 2 * 2**30
"""Of processor time in which a command answers, and memory with which [byte]."""
TIMERS = (signal.ITIMER_PROF, SECONDS), (signal.ITIMER_REAL, LIMIT)
COARSE = ("--set", "mesh.size=0.05", "--set", "mesh.lip_elements=2", "--set", "mesh.error=false")


def run(*words: object, **surroundings: str) -> tuple[int, list[str]]:
    """Exit code and last lines of the program, within :data:`SECONDS` and :data:`MEMORY`."""
    process = subprocess.Popen(
        [sys.executable, "-m", "fenics_crack", *map(str, words)],
        env=os.environ | surroundings, cwd=ROOT, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        preexec_fn=lambda: [signal.setitimer(*timer) for timer in TIMERS],
    )  # fmt: skip
    with process.stderr:
        messages = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert usage.ru_utime + usage.ru_stime < SECONDS and 1024 * usage.ru_maxrss < MEMORY
    return process.returncode, messages.splitlines()


def scene_of(folder: Path, *options: str) -> Path:
    """A scene as ``new`` writes it."""
    assert main(["new", str(folder / "scene.toml"), *options, "--quiet"]) == 0
    return folder / "scene.toml"


@pytest.mark.drawn(1)
@pytest.mark.parametrize("change", ["crack.depth=1e-6", "mesh.lip_elements=2000"])
def test_too_many_cells(change: str, tmp_path: Path) -> None:
    """Of a solid, before it is meshed."""
    code, messages = run("check", scene_of(tmp_path, "--solid"), "--set", change)
    assert code == 2 and "mesh.lip_elements" in messages[-1]


@pytest.mark.nightly
def test_too_many_points(tmp_path: Path) -> None:
    """A hundred thousand of them; a hundred are watched."""
    path = scene_of(tmp_path)
    for count, code in ((100_000, 2), (100, 0)):
        heights = np.linspace(0.16, 0.3, count)
        rows = "".join(f"p{n} = [0.05, {height:.7f}]\n" for n, height in enumerate(heights))
        plate = tmp_path / f"{count}.toml"
        plate.write_text(f"{path.read_text().partition('[output]')[0]}[output.points]\n{rows}")
        assert run("check", plate)[0] == code


@pytest.mark.nightly
def test_too_many_measurements(tmp_path: Path) -> None:
    """A million rows."""
    path = scene_of(tmp_path, "--identify")
    rows = "".join(f"harmonic_1,1e-6,1e-8,{100_000 + number}\n" for number in range(1_000_000))
    (tmp_path / "m.csv").write_text(f"quantity,value,deviation,frequency\n{rows}")
    code, messages = run("identify", path, tmp_path / "m.csv")
    assert code == 2 and len(messages) == 1 and "measurements" in messages[0]


@pytest.mark.parametrize("kind", ["device", "pipe"])
def test_what_never_ends_is_no_text(kind: str, tmp_path: Path, run_command: RunCommand) -> None:
    """A scene, measurements, responses and arrivals; a table that a result replaces."""
    scene = scene_of(tmp_path, "--identify")
    for name in ("never.toml", "never.csv", "never.uff"):
        if kind == "pipe":
            os.mkfifo(tmp_path / name)
        else:
            (tmp_path / name).symlink_to("/dev/zero")
    text, table, universal = (tmp_path / f"never.{suffix}" for suffix in ("toml", "csv", "uff"))
    for words in (
        ["check", text], ["identify", scene, table], ["identify", scene, universal],
        ["timing", table],
    ):  # fmt: skip
        [line] = run_command(*map(str, words), "--quiet", code=2).err.splitlines()
        assert "regular file" in line
    place = tmp_path / "out" / "solution.json"
    place.parent.mkdir()
    (tmp_path / "never.csv").rename(place)
    assert main(["solve", str(DEMOS / "chain.toml"), "--output", str(place.parent)]) == 0
    assert place.is_file() and not place.is_symlink()


@pytest.mark.drawn(1)
@pytest.mark.parametrize("kind", ["device", "pipe"])
def test_a_load_that_never_ends(kind: str, tmp_path: Path) -> None:
    """The table of a load, which is refused unread."""
    os.mkfifo(tmp_path / "pipe")
    path = "/dev/zero" if kind == "device" else str(tmp_path / "pipe")
    code, messages = run("check", scene_of(tmp_path), *COARSE, "--set", f"excitation.wave={path}")
    assert code == 2 and "excitation.wave" in messages[-1] and "regular file" in messages[-1]


def test_a_packed_load(tmp_path: Path, run_command: RunCommand) -> None:
    """No text: a table of 91 kB was unpacked to 1 GB."""
    path, scene = tmp_path / "load.csv.xz", str(scene_of(tmp_path))
    path.write_bytes(lzma.compress(b"t,fx,fy\n0,5,0\n1,-5,0\n"))
    [line] = run_command(
        "check", scene, *COARSE, "--quiet", "--set", f"excitation.wave={path}", code=2
    ).err.splitlines()
    assert "excitation.wave" in line and "a CSV file" in line


def test_a_packed_table_of_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy would unpack it without a limit."""
    for suffix, pack in (("xz", lzma.compress), ("gz", gzip.compress)):
        (tmp_path / f"nodes.{suffix}").write_bytes(pack(b"1,0,0,0\n2,1,0,0\n"))
    assert read_nodes_and_cells(tmp_path / "nodes.gz").labels.tolist() == [1, 2]
    monkeypatch.setattr(untrusted_files, "max_allowed_unpacked_bytes", lambda _: 12)
    for suffix, reason in (("xz", "instead of 4 numbers"), ("gz", "too large for a packed file")):
        catch_error(
            partial(read_nodes_and_cells, tmp_path / f"nodes.{suffix}"),
            names=reason,
            kind=ValueError,
        )


def test_matrices_without_values(tmp_path: Path, run_command: RunCommand) -> None:
    """Of a pattern nobody knows the numbers."""
    shutil.copytree(ROOT / "meshes" / "chain", tmp_path / "chain")
    text = (DEMOS / "chain.toml").read_text().replace("../meshes/chain", "chain")
    (tmp_path / "scene.toml").write_text(text)
    head = "%%MatrixMarket matrix coordinate pattern symmetric\n12 12 12\n"
    rows = "".join(f"{n} {n}\n" for n in range(1, 13))
    (tmp_path / "chain" / "mass.mtx").write_text(head + rows)
    [line] = run_command("check", tmp_path / "scene.toml", code=2).err.splitlines()
    assert "structure.mass" in line and "pattern" in line


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("crack.clearance", ["crack.clearance=1.0"]),
        ("contact.stiffness_per_area", ["contact.law=penalty", "contact.stiffness_per_area=1.0"]),
    ],
)
def test_contact_that_nothing_makes(
    key: str, changes: list[str], tmp_path: Path, run_command: RunCommand
) -> None:
    """It is remarked once, by check and beside results."""
    path = scene_of(tmp_path)
    few_options = ["mesh.size=0.05", "mesh.lip_elements=2", "mesh.error=false", *changes]
    for command in (["check"], ["modes", "--output", tmp_path]):
        assert run_command(*command, path, sets=few_options).err.count(f"remark: {key} = ") == 1


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["-t 60", "-f 200"])
def test_limits_of_the_shell(kind: str, tmp_path: Path) -> None:
    """Of processor time and of the size of files [512 B]: a mesh file is read, a result written."""
    shell = f'ulimit {kind}; exec "$@"'
    words = ["modes", str(DEMOS / "inclined_crack.toml"), "--output", str(tmp_path), "--quiet"]
    program = ["sh", "-c", shell, "sh", sys.executable, "-m", "fenics_crack", *words]
    environment = no_rank() | {"PYTHONDONTWRITEBYTECODE": "1"}  # nor are modules written in part
    process = subprocess.run(
        program, capture_output=True, text=True, check=False, cwd=ROOT, env=environment
    )
    if kind == "-t 60":
        assert process.returncode == 0 and (tmp_path / "modes.h5").exists(), process.stderr
    else:  # the file that is too large, not the cache
        [line] = process.stderr.splitlines()
        assert process.returncode == 1 and "modes.h5" in line and "File too large" in line


@pytest.mark.parametrize(
    ("option", "code", "said"),
    [
        pytest.param("-crack_modes_eps_type=nosuch", 2, "nosuch", marks=pytest.mark.nightly),
        (
            "-crack_hb_snes_moniter",
            0,
            "-crack_hb_snes_moniter had no effect: no solver has read it",
        ),
    ],
)
def test_options_of_petsc(option: str, code: int, said: str, tmp_path: Path) -> None:
    """A value that PETSc does not know, and a name that no solver reads."""
    words = [scene_of(tmp_path), *COARSE, "--output", tmp_path, "--quiet", *option.split("=")]
    exit_code, lines = run("modes", *words)
    assert exit_code == code and said in lines[-1], lines


# --- caches ---------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_a_cache_that_cannot_be_written(tmp_path: Path) -> None:
    """One line more, and the answer."""
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fenics"
    own_cache = tmp_path / f"fenics-crack-{os.geteuid()}"
    own_cache.mkdir(mode=0o700)
    if user_cache.is_dir():  # forms that are compiled take no time
        shutil.copytree(user_cache, own_cache / "fenics")
    (tmp_path / "file").touch()
    few_options = ["--set", "mesh.size=0.05", "--set", "mesh.lip_elements=2"]
    words = ["modes", scene_of(tmp_path), *few_options, "--output", tmp_path / "out", "--quiet"]
    code, messages = run(*words, XDG_CACHE_HOME=str(tmp_path / "file"), TMPDIR=str(tmp_path))
    assert code == 0 and len(messages) == 1
