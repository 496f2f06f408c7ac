"""Compiled forms on disk: what is interrupted, damaged or a stranger's is never loaded."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import ufl
from mpi4py import MPI
from ranks import LIMIT, environment, is_running, launcher
from surroundings import main

from fenics_crack.basics.untrusted_files import file_sha256
from fenics_crack.fem import compat

HANGS = "#!/bin/sh\necho $$ $PPID >{0}.new && mv {0}.new {0}\nexec sleep 3600\n"
"""A compiler that writes its number, and that of the program that called it, and never ends."""
FORMS = """\
import signal, test_form_cache
signal.signal(signal.SIGINT, signal.default_int_handler)
test_form_cache.assemble()
"""
"""A program that compiles one form and, with DOLFINx 0.5, one element; what a shell starts in the
background ignores Ctrl-C."""
SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGKILL
SMALL = ["--set", "mesh.size=0.05", "--set", "mesh.lip_elements=2", "--set", "mesh.error=false"]


def assemble(comm: MPI.Comm = MPI.COMM_WORLD) -> float:
    """Return the area of a square by a matrix, for whose form DOLFINx has a compiler's work."""
    mesh = compat.dolfinx.mesh.create_unit_square(comm, 2, 2)
    space = compat.function_space(mesh, 1, vectors=False)
    form = ufl.inner(ufl.TrialFunction(space), ufl.TestFunction(space)) * ufl.dx
    matrix = compat.assembled_petsc_matrix(form)
    ones_vector = matrix.createVecRight()
    ones_vector.set(1.0)
    return float((matrix * ones_vector).sum())


def compiling(words: list[str], folder: Path, number: int) -> subprocess.Popen[str]:
    """Start a program, with a cache in a folder, whose compiler never ends."""
    compiler = folder / f"cc{number}"
    compiler.write_text(HANGS.format(folder / f"mark{number}"))
    compiler.chmod(0o755)
    changes = {"XDG_CACHE_HOME": str(folder / "cache"), "CC": str(compiler)}
    return subprocess.Popen(
        words, env=environment() | changes, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip


def interrupt(program: subprocess.Popen[str], folder: Path, number: int) -> tuple[int, str]:
    """Send a signal to a program, or its rank, that compiles; return its exit code and last words.
    Its compiler ends, too."""
    mark, until = folder / f"mark{number}", time.monotonic() + LIMIT
    while not mark.exists() and program.poll() is None and time.monotonic() < until:
        time.sleep(0.01)
    compiler, caller = map(int, mark.read_text().split())
    os.kill(caller, number)
    messages = program.communicate(timeout=LIMIT)[1]
    while is_running(compiler):
        assert time.monotonic() < until
        time.sleep(0.01)
    return program.returncode, messages


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, which is used in this process."""
    folder = tmp_path / "cache" / "fenics"
    folder.mkdir(mode=0o700, parents=True)
    monkeypatch.setattr(compat, "_CACHE_FOLDER", folder)
    return folder


@pytest.mark.nightly
@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("number", SIGNALS)
def test_a_run_that_is_interrupted(tmp_path: Path, ranks: int, number: int) -> None:
    """By the program: Ctrl-C stops it as everywhere, and the next run has its result."""
    assert main(["new", str(tmp_path / "plate.toml"), "--quiet"]) == 0
    words = ["-m", "fenics_crack", "modes", str(tmp_path / "plate.toml"), *SMALL]
    words += ["--output", str(tmp_path / "out"), "--quiet"]
    words = [*(launcher(ranks) if ranks > 1 else []), sys.executable, *words]
    code, said = interrupt(compiling(words, tmp_path, number), tmp_path, number)
    if number == signal.SIGINT:
        assert code == 130 and "stopped" in said and "Traceback" not in said
    table = tmp_path / "out" / "modes.csv"
    assert code != 0 and not table.exists()
    changes = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    subprocess.run(words, env=environment() | changes, timeout=LIMIT, check=True)
    assert table.exists()


@pytest.mark.nightly
def test_an_interrupt_from_the_terminal(tmp_path: Path) -> None:
    """A sweep finishes what it has begun: its compiler is not interrupted."""
    assert main(["new", str(tmp_path / "plate.toml"), "--quiet"]) == 0
    compiler = tmp_path / "cc"
    interrupting_command = f"mkdir {tmp_path}/once && kill -INT -$PPID"
    compiler.write_text(f'#!/bin/sh\n{interrupting_command}\nexec gcc "$@"\n')
    compiler.chmod(0o755)
    changes = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "CC": str(compiler)}
    words = [sys.executable, "-m", "fenics_crack", "sweep", str(tmp_path / "plate.toml"), *SMALL]
    process = subprocess.run(
        [*words, "--output", str(tmp_path / "out")], env=environment() | changes, timeout=LIMIT,
        start_new_session=True, capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 3 and "run the same command again" in process.stderr


def test_a_damaged_form(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One with a part of its library and one without its source are compiled again; of whole ones
    nothing is written."""
    assemble(MPI.COMM_SELF)
    original_files = {*cache.iterdir()}
    assemble(MPI.COMM_SELF)
    assert {*cache.iterdir()} == original_files
    copy = shutil.copytree(cache, cache.parent / "copy")  # this process has mapped the others
    monkeypatch.setattr(compat, "_CACHE_FOLDER", copy)
    first_form, *other_forms = sorted(copy.glob("*/"))
    os.truncate(next(first_form.glob("*.so")), 8192)
    for other_form in other_forms:
        next(other_form.glob("*.c")).unlink()
    assert assemble(MPI.COMM_SELF) == pytest.approx(1.0)
    assert len({*copy.iterdir()}) == 1.5 * len(original_files)


def test_what_others_leave(cache: Path) -> None:
    """A source without its mark, as DOLFINx leaves it, makes nobody wait; a compilation that fails
    leaves nothing."""
    assemble(MPI.COMM_SELF)
    for source in [*cache.glob("*/*.c")]:
        shutil.copy(source, cache)
        shutil.rmtree(source.parent)
    earlier_files = {*cache.iterdir()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CC", "false")
        with pytest.raises(Exception, match=r"exit (code|status) 1"):
            assemble(MPI.COMM_SELF)
        assert os.environ["CC"] == "false"
    assert {*cache.iterdir()} == earlier_files
    assert assemble(MPI.COMM_SELF) == pytest.approx(1.0)


def on_both(cache: str, comm: MPI.Comm) -> float:
    """Each rank alone, then both together, in a cache that is empty before."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compat, "_CACHE_FOLDER", Path(cache))
        return assemble(MPI.COMM_SELF) * assemble(comm)


@pytest.mark.mpi
def test_ranks_compile_at_once(cache: Path, on_ranks: Callable[..., float]) -> None:
    """Each for itself: neither reads what the other writes."""
    assert on_ranks(on_both, str(cache)) == pytest.approx(1.0)
    assert all((cache / path.read_text().split()[0]).is_dir() for path in cache.glob("*.txt"))


@pytest.mark.nightly
@pytest.mark.parametrize("mode", [0o777, 0o700])
def test_a_planted_library(tmp_path: Path, mode: int) -> None:
    """In a cache that others can write none is loaded, and one line says so; in one of this user
    alone, where it counts as damaged, neither."""
    assert main(["new", str(tmp_path / "plate.toml"), "--quiet"]) == 0
    words = [sys.executable, "-m", "fenics_crack", "modes", str(tmp_path / "plate.toml"), *SMALL]
    words += ["--output", str(tmp_path / "out"), "--quiet"]
    kept, temporary = tmp_path / "cache", tmp_path / "temporary"
    temporary.mkdir()
    changes = environment() | {"XDG_CACHE_HOME": str(kept), "TMPDIR": str(temporary)}
    subprocess.run(words, env=changes, timeout=LIMIT, check=True)
    (tmp_path / "planted.c").write_text(
        "#include <fcntl.h>\n__attribute__((constructor)) static void run(void)"
        f' {{ open("{tmp_path / "RAN"}", O_CREAT, 0600); }}\n'
    )
    planted = tmp_path / "planted.so"
    subprocess.run(["gcc", "-shared", "-o", planted, tmp_path / "planted.c"], check=True)
    for library in kept.rglob("*.so"):
        digest = file_sha256(library)
        shutil.copy(planted, library)
        for record in kept.rglob("*.txt") if mode == 0o777 else ():
            record.write_text(record.read_text().replace(digest, file_sha256(planted)))
    kept.chmod(mode)
    process = subprocess.run(words, env=changes, timeout=LIMIT, capture_output=True, text=True)
    assert process.returncode == 0 and not (tmp_path / "RAN").exists()
    assert len(process.stderr.splitlines()) == (mode == 0o777)


@pytest.mark.nightly
def test_a_cache_of_the_users_settings(tmp_path: Path) -> None:
    """One that others can write is refused in one line, before anything is compiled."""
    for folder, mode in ((tmp_path / "dolfinx", 0o700), (tmp_path / "cache", 0o777)):
        folder.mkdir()
        folder.chmod(mode)
    for name in ("dolfinx_jit_parameters.json", "dolfinx_jit_options.json"):
        text = json.dumps({"cache_dir": str(tmp_path / "cache")})
        (tmp_path / "dolfinx" / name).write_text(text)
    assert main(["new", str(tmp_path / "plate.toml"), "--quiet"]) == 0
    words = [sys.executable, "-m", "fenics_crack", "modes", str(tmp_path / "plate.toml"), *SMALL]
    changes = {"XDG_CONFIG_HOME": str(tmp_path)}
    process = subprocess.run(
        words, env=environment() | changes, capture_output=True, text=True, timeout=LIMIT
    )
    [line] = process.stderr.splitlines()
    assert process.returncode == 2 and "cache_dir" in line and not [*tmp_path.glob("cache/*")]
