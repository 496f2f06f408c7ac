"""Folders from strangers: of what lies there, only what a command names is read."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import pytest
from ranks import LIMIT, launcher
from surroundings import DEMOS, MPI_ENVIRONMENT

SCENE = DEMOS / "paper_plate.toml"
PROGRAM = str(Path(sys.executable).with_name("fenics-crack"))
CHECK = ["check", str(SCENE), "--format", "json"]
RUNS = 'open("RAN", "w")\n'
"""What leaves a file in the folder where it is run."""
JIT = {"cache_dir": "RAN", "cffi_extra_compile_args": ["-wrapper", "./RAN.sh"]}
LIBRARIES = ["argparse", "ast", "dolfinx", "gmsh", "h5py", "mpi4py", "numpy", "scipy", "tomllib"]
FFCX = {"table_rtol": 0.4, "table_atol": 0.4, "epsilon": 0.1}
SETTINGS = {
    "PETSc": dict.fromkeys((".petscrc", "petscrc"), "-log_view :RAN"),
    "petsc4py": {
        **dict.fromkeys(("petsc.cfg", "slepc.cfg"), "PETSC_ARCH = /proc/self/cwd"),
        **dict.fromkeys(("PETSc.py", "SLEPc.py"), RUNS),
    },
    "DOLFINx": dict.fromkeys(
        ("dolfinx_jit_parameters.json", "dolfinx_jit_options.json"), json.dumps(JIT)
    ),
    "FFCx": dict.fromkeys(("ffcx_parameters.json", "ffcx_options.json"), json.dumps(FFCX)),
    "UCX": {"ucx.conf": "UCX_LOG_FILE=RAN\nUCX_LOG_LEVEL=info\n"},
    "Matplotlib": {"matplotlibrc": "savefig.dpi: 9"},
    "Python": {f"{name}.py": RUNS for name in LIBRARIES},
}
"""Files that libraries look for in the working folder, and what they do there."""


def run(folder: Path, words: list[str], **surroundings: str) -> str:
    """What a program prints that ends well, and leaves no file in its folder but its results."""
    earlier_files = {*folder.iterdir()}
    process = subprocess.run(
        words, cwd=folder, env=os.environ | surroundings, capture_output=True, text=True,
        timeout=LIMIT,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    assert {*folder.iterdir()} - {folder / "output"} == earlier_files
    return process.stdout


def fill(folder: Path, kinds: Iterable[str]) -> None:
    """Write files of some kinds, and what they start."""
    for name, text in chain.from_iterable(SETTINGS[kind].items() for kind in kinds):
        (folder / name).write_text(text)
    (folder / "RAN.sh").write_text('#!/bin/sh\ntouch "$OLDPWD/RAN"\nexec "$@"\n')
    (folder / "RAN.sh").chmod(0o755)


def checked(folder: Path, program: list[str], **surroundings: str) -> dict[str, object]:
    """What the command ``check`` finds; without the memory, which is the process's at that time."""
    rows = json.loads(run(folder, [*program, *CHECK], **surroundings))
    return {row["what"]: row["value"] for row in rows if "GiB" not in row["what"]}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """What is found in an empty folder."""
    return checked(tmp_path_factory.mktemp("empty"), [PROGRAM])


@pytest.mark.drawn(1)
@pytest.mark.parametrize("kind", [kind for kind in SETTINGS if kind != "Matplotlib"])
def test_nothing_acts(tmp_path: Path, found: dict[str, object], kind: str) -> None:
    """No program is run, no file written, no number changed; without ``-P`` either."""
    fill(tmp_path, [kind])
    program = [sys.executable, "-m", "fenics_crack"] if kind == "Python" else [PROGRAM]
    assert checked(tmp_path, program) == found


@pytest.mark.mpi
def test_nothing_acts_on_ranks(tmp_path: Path, found: dict[str, object]) -> None:
    """All of it at once; PETSc starts with the package there. Of one rank, for the same numbers."""
    fill(tmp_path, SETTINGS)
    program = [*launcher(1), sys.executable, "-m", "fenics_crack"]
    assert checked(tmp_path, program, **MPI_ENVIRONMENT) == found


@pytest.mark.nightly
def test_pictures_keep_their_style(tmp_path: Path) -> None:
    """Of a mesh, as of everything else."""
    drawn = []
    for kinds in ([], SETTINGS):
        folder = tmp_path / str(len(drawn))
        folder.mkdir()
        fill(folder, kinds)
        run(folder, [PROGRAM, "plot", str(SCENE), "--output", str(tmp_path / "output")])
        [picture] = tmp_path.glob("output/*.png")
        drawn.append(picture.read_bytes())
    assert drawn[0] == drawn[1]


def test_own_settings_act(tmp_path: Path) -> None:
    """Those in the user's home, which may be the working folder, then PETSC_OPTIONS, then a
    program's own words; and those of DOLFINx and FFCx in ~/.config."""
    (tmp_path / ".petscrc").write_text("-crack_a 1\n-crack_b 1\n-crack_c 1\n")
    (tmp_path / "petscrc").write_text("-crack_a 9\n-crack_d 9\n")
    for kind, text in {"DOLFINx": {"cffi_verbose": True}, "FFCx": {"epsilon": 1e-13}}.items():
        folder = tmp_path / ".config" / kind.lower()
        folder.mkdir(parents=True)
        for name in SETTINGS[kind]:
            (folder / name).write_text(json.dumps(text))
    program = """
import os
import fenics_crack as fc
fc.build_structure  # loads DOLFINx
import dolfinx.jit, ffcx
from petsc4py import PETSc
options = PETSc.Options("crack_")
print([options.getInt(name, 0) for name in "abcd"], os.environ["PETSC_OPTIONS"])
for tool in (dolfinx.jit, ffcx):
    get = getattr(tool, "get_options", None) or tool.get_parameters
    print(get().get("cffi_verbose"), get().get("epsilon"))
"""
    environment = {"HOME": str(tmp_path), "PETSC_OPTIONS": "-crack_b 2 -crack_c 2"}
    environment |= {"XDG_CONFIG_HOME": str(tmp_path / ".config")}
    words = [sys.executable, "-c", program, "folder", "-crack_c", "3"]
    assert run(tmp_path, words, **environment).splitlines() == [
        "[1, 2, 3, 0] -crack_b 2 -crack_c 2", "True None", "None 1e-13"
    ]  # fmt: skip
