"""Functions of the package run one at a time, with one thread of OpenBLAS and of OpenMP."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from helpers import ROOT

import fenics_crack as fc
from fenics_crack import InputError
from fenics_crack.basics import threads

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
    found = Pool(8)
    monkeypatch.setattr(threads, "_pools", lambda modules: [(found, 8)])
    for name in threads.SETTINGS:
        monkeypatch.delenv(name, raising=False)
    return found


def test_one_thread_of_openblas(pool: Pool) -> None:
    """In functions of the package and in `from_matrices`; restored afterwards, errors or not."""
    make, solve = fc.Structure.from_matrices, fc.solve_modes
    pool.told.clear()  # by imports
    structure = make(np.eye(1), np.eye(1), None)
    assert pool.told == [1, 8]
    with pytest.raises(InputError):
        solve(structure, 2)
    assert pool.told == [1, 8] * 2
    with threads.alone(), threads.alone():
        assert pool.threads == 1
    assert pool.told == [1, 8] * 3


@pytest.mark.parametrize("name", threads.SETTINGS)
def test_the_user_decides(pool: Pool, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a variable, or by a number other than that with which OpenBLAS begins."""
    pool.threads = 3
    with threads.alone():
        assert pool.threads == 3
    pool.threads = 8
    monkeypatch.setenv(name, "8")
    with threads.alone():
        assert pool.threads == 8
    assert pool.told == []


def test_loaded_libraries_are_found() -> None:
    """Debian's, which NumPy, SciPy and PETSc share, in a program without settings."""
    program = """
import sys
from unittest.mock import patch
import fenics_crack as fc
from fenics_crack.basics import threads
from surroundings import main
fc.prepare, fc.Scene

def counted():
    pools = threads._pools(len(sys.modules))
    return len(pools), {pool("get_num_threads") == begin for pool, begin in pools}, {
        pool("get_num_threads") for pool, _ in pools}

print(counted()[:2])
with patch("fenics_crack.cli.command_line._command", lambda *_: print(counted()[::2])):
    main(["check", "demos/paper_plate.toml"])
print(counted()[:2])
"""
    assert run(program).splitlines() == ["(1, {True})", "(1, {1})", "(1, {True})"]


@pytest.mark.parametrize("chosen", [{}, {"OMP_NUM_THREADS": "1"}])
def test_no_thread_of_openmp(chosen: dict[str, str]) -> None:
    """CHOLMOD begins none, which asks for four whatever is set; the limit is restored."""
    program = """
import os, sys
import fenics_crack as fc
from fenics_crack.basics import threads
study = fc.prepare(fc.Scene.load("demos/breathing_plate.toml"), whole=True)
library, = threads._openmp(len(sys.modules))
print(library.omp_get_max_active_levels() > 0)
before = len(os.listdir("/proc/self/task"))
fc.solve_modes(study.structure, 2)
print(len(os.listdir("/proc/self/task")) - before, library.omp_get_max_active_levels() > 0)
"""
    assert run(program, chosen).splitlines() == ["True", "0 True"]


def test_three_threads_at_once() -> None:
    """Each waits for the others: gmsh would end the process."""
    assert run(THREADS) == "[(50, True), (54, True), (84, True)]"


def test_functions_can_be_pickled() -> None:
    """For processes of multiprocessing."""
    assert pickle.loads(pickle.dumps(fc.prepare)) is fc.prepare


def run(program: str, chosen: dict[str, str] | None = None) -> str:
    """What a program prints in a process of its own, with these settings of threads alone."""
    settings = dict.fromkeys(threads.SETTINGS)
    environment = {name: value for name, value in os.environ.items() if name not in settings}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, cwd=ROOT,
        env=environment | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"} | (chosen or {}),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()
