"""The command doctor names what is broken; other commands refuse it in one line."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ranks import LIMIT
from surroundings import DEMOS, ROOT, main, no_rank

from fenics_crack.basics.caches import replace_unusable_caches
from fenics_crack.cli import doctor


def test_all_is_well(capsys: pytest.CaptureFixture[str]) -> None:
    """A row for each check, also of numbers that are known."""
    assert main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines[2:]] == [*doctor.CHECK_FUNCTION_BY_NAME]
    assert all(line[12:19].strip() == "ok" for line in lines[2:])


def no_compiler(patch: pytest.MonkeyPatch, folder: Path) -> None:
    patch.delenv("CC", raising=False)
    patch.setenv("PATH", str(folder))


def another_mpirun(patch: pytest.MonkeyPatch, folder: Path) -> None:
    from mpi4py import MPI

    words = "HYDRA" if MPI.get_vendor()[0] == "Open MPI" else "mpirun (Open MPI) 4.1.4"
    program = folder / "mpirun"
    program.write_text(f"#!/bin/sh\necho '{words}'\n")
    program.chmod(0o755)
    patch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


def open_cache(patch: pytest.MonkeyPatch, folder: Path) -> None:
    (folder / "fenics").mkdir()
    (folder / "fenics").chmod(0o777)
    patch.setenv("MPLCONFIGDIR", str(folder))
    patch.setenv("XDG_CACHE_HOME", str(folder))
    replace_unusable_caches.cache_clear()


def without(name: str) -> Callable[[pytest.MonkeyPatch, Path], None]:
    return lambda patch, _: patch.setitem(sys.modules, name, None)


def replaced(name: str, value: object) -> Callable[[pytest.MonkeyPatch, Path], None]:
    return lambda patch, _: patch.setattr(name, value)


BROKEN = {
    "no compiler": ("compiler", no_compiler, "install gcc or clang"),
    "no headers": ("compiler", replaced("sysconfig.get_path", lambda _: "/no"), "python3-dev"),
    "another MPI's mpirun": ("MPI", another_mpirun, "must be the mpirun of"),
    "two MPI libraries": (
        "MPI",
        replaced("fenics_crack.cli.doctor.list_loaded_libraries", lambda _: ["/a", "/b"]),
        "a single library",
    ),
    "complex PETSc": ("PETSc", replaced("petsc4py.PETSc.ScalarType", np.complex128), "float64"),
    "old NumPy": ("NumPy", replaced("numpy.__version__", "1.20.3"), "1.24 or newer"),
    "no gmsh": ("gmsh", without("gmsh"), "pip install 'fenics-crack[dolfinx]'"),
    "no DOLFINx": ("DOLFINx", without("dolfinx"), "environment.yml, or sh install.sh"),
    "no pyvista": ("pictures", without("pyvista"), "pyvista is missing"),
    "a cache that others write": ("caches", open_cache, "others can write"),
    "wrong numbers": (
        "two masses",
        replaced("fenics_crack.cli.doctor.OSCILLATOR_REFERENCE_MAX_AND_MIN", (2.3, -2.9)),
        "at most 0.001",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_fault_is_named(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one line, with what to do."""
    check, break_it, remedy = BROKEN[name]
    break_it(monkeypatch, tmp_path)
    [(_, fault_text, is_fault)] = doctor.run_and_yield_checks(
        {check: doctor.CHECK_FUNCTION_BY_NAME[check]}
    )
    assert is_fault and remedy in fault_text and "\n" not in fault_text


def said(program: str, **variables: str) -> str:
    """What a program says on standard error, which no mpirun has started."""
    environment = no_rank() | {"PYTHONPATH": f"{ROOT}", "OMP_NUM_THREADS": "1"} | variables
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=LIMIT,
        env=environment,
    )  # fmt: skip
    return process.stderr.strip()


def test_the_mpirun_of_another_mpi_is_refused() -> None:
    """Its ranks would be so many single runs."""
    *_, line = said("import fenics_crack.basics.ranks", OMPI_COMM_WORLD_SIZE="2").splitlines()
    assert "mpirun = '2 programs of one rank each': must be the mpirun of" in line


def test_a_library_that_is_missing_is_named_with_the_ways_to_get_it() -> None:
    """By commands; the program goes on when it is there again."""
    program = f"""
import sys
from fenics_crack.cli.command_line import main
for name in ("gmsh", "petsc4py", "dolfinx"):
    sys.modules[name] = None
    assert main(["check", {str(DEMOS / "paper_plate.toml")!r}, "--fresh"]) == 2
    del sys.modules[name]
"""
    lines = said(program).splitlines()
    assert len(lines) == 3
    for name, line in zip(("gmsh", "petsc4py", "dolfinx"), lines, strict=True):
        assert line.startswith(f"fenics-crack: {name} is missing: must be installed: pip install")
