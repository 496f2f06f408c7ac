"""What several test files need: the paper's plate, and a way to run a program on several ranks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings
from mpi4py import MPI

import fenics_crack
from fenics_crack import Scene, Structure, build_structure

# The same examples in every run; the first call of a form may compile for seconds.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")

MPI_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",  # Open MPI 4
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # Open MPI 5
}


@pytest.fixture(scope="session")
def paper_scene() -> Scene:
    """The paper's plate: 2 x 8 bilinear quadrilaterals, a crack one element long."""
    return Scene.from_mapping(
        {
            "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
            "crack": {"edge": "left", "height": 0.05, "length": 0.05},
            "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
            "damping": {"ratio": 0.001, "modes": "all"},
            "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [100.0, 0.0]},
            "contact": {"stiffness": 1e11},
            "mesh": {"layout": "grid", "cells": "quadrilateral", "columns": 2, "rows": 8},
        }
    )


@pytest.fixture(scope="session")
def paper_structure(paper_scene: Scene) -> Structure:
    """The structure of the paper's plate on one rank; not to be changed."""
    return build_structure(paper_scene, MPI.COMM_SELF)


@pytest.fixture
def mpirun(tmp_path: Path) -> Callable[..., str]:
    """Run a Python program, source or file, on some ranks; return what it printed.

    The program can import the test files. Where it fails, so does the test, and shows its output.
    """
    launcher = shutil.which("mpirun")
    if launcher is None:
        pytest.skip("mpirun is not installed")

    def run(program: str | Path, ranks: int = 2, timeout: float = 180.0) -> str:
        if isinstance(program, str):
            file = tmp_path / "program.py"
            file.write_text(program)
        else:
            file = program
        tests, package = Path(__file__).parent, Path(fenics_crack.__file__).parents[1]
        search = [str(tests), str(package), os.environ.get("PYTHONPATH", "")]
        process = subprocess.Popen(
            [launcher, "-n", str(ranks), sys.executable, str(file)],
            env=os.environ
            | MPI_ENVIRONMENT
            | {"PYTHONPATH": os.pathsep.join(filter(None, search))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            output, errors = process.communicate(timeout=timeout)
            ended = f"exit code {process.returncode}"
        except subprocess.TimeoutExpired:
            process.terminate()  # mpirun ends its ranks
            output, errors = process.communicate()
            ended = f"not finished after {timeout:g} s"
        assert ended == "exit code 0", f"{ended}\n--- stdout\n{output}\n--- stderr\n{errors}"
        return output

    return run
