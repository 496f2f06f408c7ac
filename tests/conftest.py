"""Fixtures of several test files: plates, and ways to run programs on several ranks.

The process that shares the tests out to others (pytest-xdist) reads this file, too. It must not
start MPI, as the others would then be taken for its ranks: what starts it is imported in functions.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy: results to the bit need one number

from pathlib import Path

# A virtual environment of wheels has an mpirun of its own, and need not be active.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

import gc
import importlib
import subprocess
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import chdir
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

import pytest
from ranks import LIMIT, Ranks, command, environment
from surroundings import DEMOS, RunCommand, main

import fenics_crack as fc

if TYPE_CHECKING:
    from fenics_crack import Scene, Structure

# 700 by default: with what all tests have imported, to look through it takes 6 % of the time.
gc.set_threshold(10_000)
gc.disable()  # until all is collected
# Compiled files are kept, as by default: else each run rewrites the asserts of all test files anew,
# two thirds of the collection, and each program that a test starts compiles the package.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


PARTS = 8
"""Of the nightly tests, each at most 8 minutes on two idle processors."""
QUICK = {
    "balance/test_inside_balance.py", "balance/test_kernel.py", "curves/test_windows.py",
    "model/test_contact.py", "model/test_damping.py", "model/test_inside_model.py",
    "motion/test_inside_any_load.py",
    "motion/test_inside_friction.py", "numerics/test_paths.py", "scene/test_conversions.py",
    "scene/test_rotation_tables.py", "scene/test_scene.py", "scene/test_schema.py",
    "test_house.py",
}  # fmt: skip
"""Files whose tests are marked quick, but for nightly ones and those on several ranks."""


NOT_BY_WHEELS = {
    "files/test_links.py::test_no_old_file_is_opened": "FLTK of gmsh's wheel writes settings"
}
"""Tests that do not hold in an environment of wheels, by file and function, and why."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let the verification book be written anew, and a part of the tests be run."""
    parser.addoption(
        "--write-book", action="store_true", help="write the pages of docs/verification"
    )
    parser.addoption(
        "--part", type=int, choices=range(PARTS), help=f"one of {PARTS} parts of what is selected"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Where tests are run, MPI starts before PETSc would start it, and random examples are the same
    in every run."""
    if config.getoption("dist", "no") != "no":
        return
    importlib.import_module("mpi4py.MPI")
    from hypothesis import HealthCheck, settings
    from hypothesis.internal.conjecture import providers

    # The first call of a form may compile for seconds.
    settings.register_profile(
        "repeatable", derandomize=True, deadline=None, database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )  # fmt: skip
    settings.load_profile("repeatable")
    # Else it reads the source of every library that is loaded, 7 s, for constants to try: other
    # ones where other tests have been collected.
    providers._get_local_constants = lambda: providers._local_constants


def is_quick(path: Path) -> bool:
    """Return True if the tests of a file are quick ones."""
    return path.relative_to(Path(__file__).parent).as_posix() in QUICK


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave other files unread where the quick tests alone are run: it would take a third."""
    is_quick_run = config.getoption("markexpr") == "quick" and collection_path.suffix == ".py"
    return True if is_quick_run and not is_quick(collection_path) else None


@pytest.hookimpl(tryfirst=True)  # before the selection by marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the cases that are not drawn and the quick tests, deselect other parts, and put files
    whose tests share two ranks first, so that one of two processes starts these: the first half of
    all tests is one's."""
    mark_cases_not_drawn(items)
    reason_by_test = NOT_BY_WHEELS if find_spec("dolfinx_solver") else {}
    for item in items:
        if reason := reason_by_test.get(function_of(item)[len("tests/") :]):
            item.add_marker(pytest.mark.skip(reason=reason))
        if is_quick(item.path) and not {"nightly", "mpi"} & {m.name for m in item.iter_markers()}:
            item.add_marker("quick")
    if (part := config.getoption("part")) is not None:
        items_of_other_parts = [item for item in items if part_of(item) != part]
        config.hook.pytest_deselected(items=items_of_other_parts)
        items[:] = [item for item in items if part_of(item) == part]
    rank_paths = {item.path for item in items if "on_ranks" in getattr(item, "fixturenames", ())}
    items.sort(key=lambda item: item.path not in rank_paths)


def mark_cases_not_drawn(items: list[pytest.Item]) -> None:
    """Mark as nightly all but a few cases of each test with ``drawn(count)``: the same ones in each
    run, as its name is the seed."""
    grids = defaultdict[str, list[pytest.Item]](list)
    for item in items:
        if item.get_closest_marker("drawn") is not None:
            grids[function_of(item)].append(item)
    for name, cases in grids.items():
        (count,) = cases[0].get_closest_marker("drawn").args  # type: ignore[union-attr]
        drawn_cases = Random(name).sample(cases, min(count, len(cases)))
        for case in cases:
            if case not in drawn_cases:
                case.add_marker("nightly")


def function_of(item: pytest.Item) -> str:
    """Return a test's file and function, without the parameters."""
    return item.nodeid.partition("[")[0]


def part_of(item: pytest.Item) -> int:
    """Return the part that a test belongs to, with all cases of its function."""
    return zlib.crc32(function_of(item).encode()) % PARTS


def pytest_collection_finish() -> None:
    """What is imported and collected stays to the end: no garbage is looked for in it any more."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="module", autouse=True)
def working_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Commands keep structures in output/: neither in this tree, nor for tests of other files."""
    with chdir(tmp_path_factory.mktemp("working")):
        yield


@pytest.fixture(scope="session", autouse=True)
def prepared() -> Iterator[None]:
    """What a program says every few seconds depends on the machine's load, which no test is of.
    Its arguments are described once, which takes 5 ms."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fenics_crack.basics.progress.PROGRESS_MESSAGE_INTERVAL", 3600.0)
        parser_maker = importlib.import_module("fenics_crack.cli.command_line").build_parser
        patch.setattr("fenics_crack.cli.command_line.build_parser", cache(parser_maker))
        yield


@pytest.fixture
def predicted_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of solutions are predicted without a search for exact orbits, for tests of other
    things: of some it is nine tenths of the time."""
    from helpers import wrap

    def predicted(estimate: Callable[..., Any], *given: Any, **how: Any) -> Any:
        return estimate(*given, **how | {"search": False})

    wrap(monkeypatch, "fenics_crack.balance.solution.estimate_errors", predicted)


@pytest.fixture(scope="module")
def not_laid_out() -> Iterator[None]:
    """Panels stay where matplotlib puts them, with half of the dots per inch, in tests that do not
    look at pictures: room for labels is found in half of a picture's time, dots are written in a
    fifth."""
    with pytest.MonkeyPatch.context() as patch:
        style = importlib.import_module("fenics_crack.draw.figure").FIGURE_STYLE
        patch.setitem(style, "figure.dpi", 75)
        patch.setattr("matplotlib.layout_engine.ConstrainedLayoutEngine.execute", lambda *_: None)
        yield


@pytest.fixture
def not_drawn(not_laid_out: None) -> Iterator[None]:
    """PNG files are blank and periods have few frames, in tests that look at words and other files:
    of what a command takes with a small scene, drawing is a half. The same pictures are drawn in
    tests/draw, test_pictures.py, test_report.py, test_docs.py and test_demos.py."""
    from helpers import few_frames

    def blank(canvas: Any) -> None:
        canvas.renderer = canvas.get_renderer()
        canvas.renderer.clear()

    with few_frames() as patch:
        patch.setattr("matplotlib.backends.backend_agg.FigureCanvasAgg.draw", blank)
        yield


@pytest.fixture(scope="session")
def paper_scene() -> Scene:
    """The paper's plate: 2 x 8 bilinear quadrilaterals, a crack one element long."""
    return fc.Scene.from_mapping(
        {
            "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
            "crack": {"edge": "left", "height": 0.05, "length": 0.05},
            "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
            "damping": {"ratio": 0.001, "modes": "all"},
            "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [100.0, 0.0]},
            "contact": {"stiffness": 1e11},
            "harmonic_balance": {"harmonics": 5},
            "mesh": {"layout": "grid", "cells": "quadrilateral", "columns": 2, "rows": 8},
        }
    )


@pytest.fixture(scope="session")
def paper_structure(paper_scene: Scene) -> Structure:
    """The structure of the paper's plate on one rank; not to be changed."""
    from mpi4py import MPI

    return fc.build_structure(paper_scene, MPI.COMM_SELF)


@pytest.fixture(scope="session")
def soft_plate(paper_scene: Scene) -> Structure:
    """The paper's plate with 1 % of critical damping, whose orbit on k = 1e9 is stable."""
    return fc.build_structure(paper_scene.replace({"damping.ratio": 0.01}))


@pytest.fixture(scope="session")
def wide_plate(paper_scene: Scene) -> Structure:
    """The same with 8 x 8 elements and 4 pairs."""
    return fc.build_structure(
        paper_scene.replace({"mesh.columns": 8, "mesh.rows": 8, "damping.ratio": 0.01})
    )


@pytest.fixture(scope="session")
def has_massless_crack_faces(paper_scene: Scene) -> Structure:
    """The paper's plate with 1 % of damping and eight pairs without mass, 15 modes."""
    changes = {"mesh.order": 2, "mesh.columns": 8, "mesh.rows": 8, "damping.ratio": 0.01}
    whole_structure = fc.build_structure(paper_scene.replace(changes))
    return fc.reduce_structure(whole_structure, modes=15, method="massless")


@pytest.fixture(scope="session")
def breathing_plate() -> Structure:
    """The plate of demos/breathing_plate.toml: about 4000 dofs, 18 pairs."""
    return fc.build_structure(fc.Scene.load(DEMOS / "breathing_plate.toml"))


@pytest.fixture
def run_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> RunCommand:
    """Run a command in this process; return its ``out`` and ``err``.

    A scene among its words is written to a file. Its keys are changed by ``sets``, and it ends with
    ``code``.
    """

    def word_of(word: object) -> str:
        if not isinstance(word, fc.Scene):
            return str(word)
        (tmp_path / "scene.toml").write_text(word.as_toml(), encoding="utf-8")
        return str(tmp_path / "scene.toml")

    def run(*words: object, sets: Iterable[str] = (), code: int = 0) -> Any:
        capsys.readouterr()
        changes = (word for change in sets for word in ("--set", change))
        assert main([*map(word_of, words), *changes]) == code
        return capsys.readouterr()

    return run


@pytest.fixture
def timing(run_command: RunCommand, tmp_path: Path) -> RunCommand:
    """The command ``timing``, with its files in the test's folder."""
    return partial(run_command, "timing", "--output", tmp_path)


@pytest.fixture
def mpirun() -> Callable[..., str]:
    """Run a Python program, source or file, on some ranks of its own; return what it printed.

    The program can import the test files. Where it fails, so does the test, and shows its output.
    """

    def run(program: str | Path, ranks: int) -> str:
        process = subprocess.Popen(
            command(program, ranks), env=environment(), stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            output, errors = process.communicate(timeout=LIMIT)
            outcome = f"exit code {process.returncode}"
        except subprocess.TimeoutExpired:
            process.terminate()  # mpirun ends its ranks
            output, errors = process.communicate()
            outcome = f"not finished after {LIMIT:g} s"
        assert outcome == "exit code 0", f"{outcome}\n--- stdout\n{output}\n--- stderr\n{errors}"
        return output

    return run


@pytest.fixture(scope="session")
def on_ranks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Any]]:
    """Call a function of a test file on the two ranks that these tests share (`Ranks.call`)."""
    ranks = Ranks(tmp_path_factory.mktemp("ranks"))
    yield ranks.call
    ranks.end()
