"""Whatever is given, there is a clear error or a result: random and mutated input of every kind.

The mutations follow from the seeds that hypothesis draws, the same in every run. Damaged files of
every kind go through the program, in a process that may crash, in test_fuzzing.py.
"""

from __future__ import annotations

import contextlib
import random
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.sparse as sparse
from fuzzing import call, changed_text
from helpers import DEMOS, ROOT, catch_error
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

import fenics_crack as fc
from fenics_crack import ConvergenceError, InputError, Run, Scene

SEEDS = st.integers(0, 10**6)
LONGEST = 20
"""Seconds of processor time for one input; none takes more than a few."""

TINY = {
    "geometry": {"width": 0.1, "height": 0.1, "thickness": 0.01},
    "crack": {"edge": "left", "height": 0.05, "length": 0.05},
    "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.02},
    "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [1.0, 0.0]},
    "contact": {"stiffness": 1e7},
    "mesh": {"layout": "grid", "columns": 2, "rows": 2},
    "harmonic_balance": {"harmonics": 3},
}


def examples(most: int) -> Callable[[Any], Any]:
    """Settings for a number of examples."""
    return settings(
        max_examples=most, deadline=None, derandomize=True, database=None,
        phases=(Phase.explicit, Phase.generate), suppress_health_check=list(HealthCheck),
    )  # fmt: skip


@contextlib.contextmanager
def time_limit() -> Iterator[None]:
    """Fail where something hangs, as far as Python can notice; else the process is ended."""

    def too_long(number: int, frame: object) -> None:
        raise AssertionError(f"not done after {LONGEST} s")

    earlier_handler = signal.signal(signal.SIGPROF, too_long)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, earlier_handler)


def check_error(error: InputError) -> None:
    """An error is one line that says what may stand where."""
    text = str(error)
    assert error.key and error.allowed and "\n" not in text and len(text) < 3000


# --- the text of scenes ---------------------------------------------------------------------------

TEXTS = [
    path.read_text(encoding="utf-8")
    for path in [*sorted(DEMOS.glob("*.toml")), ROOT / "fenics_crack" / "cli" / "new_scene.toml"]
]


def loads_or_refuses(text: str) -> None:
    """A text is a scene that is written as it is, or an InputError."""
    try:
        scene = Scene.from_text(text)
    except InputError as error:
        check_error(error)
        return
    assert Scene.from_text(scene.as_toml()) == scene


@examples(500)
@given(SEEDS)
def test_changed_scene_text(seed: int) -> None:
    """Mutated scene files load, and survive being written, or are refused."""
    rng = random.Random(seed)
    loads_or_refuses(changed_text(rng.choice(TEXTS), rng))


PLATE = "[geometry]\nwidth = 0.1\nheight = 0.1\nthickness = "
FROM_FILE = (DEMOS / "inclined_crack.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(PLATE + "9" * 5000, id="a number of 5000 digits"),
        pytest.param(PLATE + "0x" + "f" * 5000, id="one in base 16, too long to be shown"),
        pytest.param(PLATE + "[" * 3000 + "]" * 3000, id="lists in lists"),
        pytest.param(PLATE + '1\n"a\\nb" = 1', id="a key of two lines"),
        pytest.param(FROM_FILE.replace(".msh", "\\U0001F600.msh"), id="a character of 32 bits"),
        pytest.param(FROM_FILE.replace(".msh", "\\u007f.msh"), id="DEL in a file name"),
    ],
)
def test_scene_text_that_failed(text: str) -> None:
    """Found by mutations."""
    loads_or_refuses(text)


@examples(300)
@given(SEEDS)
def test_changed_scene_bytes(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """Bytes that are no text are no scene."""
    rng = random.Random(seed)
    content = bytearray(rng.choice(TEXTS), "utf-8")
    for _ in range(rng.randint(1, 3)):
        content[rng.randrange(len(content))] = rng.randrange(256)
    path = tmp_path_factory.getbasetemp() / "changed.toml"
    path.write_bytes(content)
    try:
        assert isinstance(Scene.load(path), Scene)
    except InputError as error:
        check_error(error)


@pytest.mark.drawn(1)
@pytest.mark.parametrize("where", ["", "structure.", "sweep.over."])
def test_a_key_of_many_parts(where: str, tmp_path: Path) -> None:
    """A nest that can be neither shown nor sent to other ranks is refused in one line."""
    (tmp_path / "deep.toml").write_text(f"{where}{'.'.join('a' * 5000)} = 1\n")
    assert check_call(["check", str(tmp_path / "deep.toml")]) == 2
    nest = f"{{{'.'.join('a' * 5000)} = 1}}"
    assert check_call(["check", str(DEMOS / "chain.toml"), "--set", f"curve.start={nest}"]) == 2


def test_what_nobody_foresaw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of a library that reads a file is one line, and its traceback if it is asked for."""

    def fail(*_: Any) -> None:
        raise IndexError("of a library\nin two lines")

    monkeypatch.setattr("tomllib.loads", fail)
    path = str(DEMOS / "chain.toml")
    code, errors = call(["check", path])
    assert (code, errors.count("\n")) == (2, 1)
    assert errors == f"fenics-crack: scene = {path!r}: must be a TOML file (of a library)\n"
    code, printed_text = call(["check", path, "--verbose"])
    assert code == 2 and printed_text.startswith("Traceback") and printed_text.endswith(errors)


def test_a_path_that_cannot_be() -> None:
    """A name that no file can have is refused like a missing file."""
    catch_error(lambda: Scene.load("a\0b"), "scene", "a\x00b")


# --- scenes of any numbers ------------------------------------------------------------------------


def wild_scene(rng: random.Random) -> dict[str, Any]:
    """Tables with few cells and few harmonics; all other numbers may be anything."""

    def size(usual: float) -> float:
        exponent = rng.choice([0.0] * 8 + [rng.uniform(-3.0, 3.0), rng.uniform(-12.0, 12.0)])
        return rng.choice([usual * 10.0**exponent] * 12 + [1e-30, 1e30])

    def signed(usual: float) -> float:
        return rng.choice([-1.0, 0.0, 1.0, 1.0]) * size(usual)

    width = rng.choice([0.1, 0.1, 10.0 ** rng.uniform(-6.0, 6.0)])
    height = width * rng.choice([1.0, 1.0, 0.1, 10.0, 1e-4, 1e4])
    tables: dict[str, Any] = {
        "geometry": {"width": width, "height": height, "thickness": size(0.01)},
        "material": {
            "young": size(2e9),
            "poisson": rng.choice([0.3, 0.3, 0.0, 0.49, 0.499999999, -0.99999999]),
            "density": size(7800.0),
        },
        "damping": {
            "ratio": rng.choice([0.01, 0.01, 0.0, 1.0, 1e3, 1e-12, 1e30, [0.1, 0.2, 0.3]]),
            "modes": rng.choice(["all", "all", 1, 3, 100_000]),
        },
        "excitation": {
            "omega": size(2000.0),
            "point": [
                width * rng.choice([0.0, 1.0, 1.0, rng.random()]),
                height * rng.choice([0.0, 1.0, 1.0, 1.0, rng.random()]),
            ],
            "force_sin": rng.choice([[signed(1.0), signed(1.0)], [0, 0]]),
            "force_mean": rng.choice([[signed(1.0), signed(1.0)], [0, 0]]),
        },
        "harmonic_balance": {"harmonics": rng.randint(1, 7)},
    }
    if rng.random() < 0.2:
        tables["harmonic_balance"]["samples"] = rng.choice([29, 64, 100])
    columns, rows = rng.randint(2, 4), rng.randint(2, 4)
    if rng.random() < 0.5:
        layout = {"layout": "grid", "columns": columns, "rows": rows}
        length, level = rng.randint(1, columns - 1) / columns, rng.randint(1, rows - 1) / rows
    else:
        cell = max(width, height) * rng.choice([0.3, 0.5, 1.0, 10.0])
        layout = {"layout": "graded", "size": cell, "lip_elements": rng.randint(1, 3)}
        layout["grading"] = rng.choice([1.0, 3.0, 3.0, 1e6])
        tables["damping"]["modes"] = rng.choice([1, 3, 100_000])  # there may be many cells
        length = rng.choice([0.4, rng.random(), 1e-9, 1e-4, 1.0 - 1e-4, 0.999])
        level = rng.choice([0.5, rng.random(), 1e-9, 1e-4, 1.0 - 1e-4])
    cells = rng.choice(["triangle", "quadrilateral"])
    tables["mesh"] = layout | {"cells": cells, "order": rng.choice([1, 1, 2])}
    if rng.random() < 0.4:
        methods = [None, "massless", "free_interface", "off"]
        tables["reduction"] = {"method": rng.choice(methods)}
        if rng.random() < 0.7:
            tables["reduction"]["modes"] = rng.choice([1, 2, 5, 1000])
    if rng.random() < 0.1:
        return tables
    tables["crack"] = {
        "edge": rng.choice(["left", "right"]),
        "height": height * level,
        "length": width * length,
        "clearance": rng.choice([0.0, 0.0, signed(1e-6)]),
    }
    law = rng.choice(["penalty", "penalty", "smoothed", "unilateral"])
    tables["contact"] = {"law": law, "pairs": rng.choice(["all", "mouth"])}
    if law != "unilateral":
        tables["contact"][rng.choice(["stiffness", "stiffness_per_area"])] = size(1e9)
    if law == "smoothed":
        tables["contact"]["sharpness"] = size(1e6)
    if rng.random() < 0.2:
        ratios = {"ratios": [0.01, rng.choice([0.01, 0.02, 1.0])], "omegas": [size(1e3), 5e3]}
        mass, stiffness = size(10.0), size(1e-6)
        ways = [{"mass": mass}, {"stiffness": stiffness}, {"mass": mass, "stiffness": stiffness}]
        tables["damping"] = rng.choice([*ways, ratios])
    return tables


def check_run(run: Run) -> None:
    """What has converged is made of finite numbers."""
    found = run.result
    if isinstance(found, fc.Modes):
        assert np.all(np.isfinite(found.omega)) and np.all(np.isfinite(found.shapes))
    elif found.converged:
        for part in (found.displacement_coefficients, found.gap_coefficients):
            assert np.all(np.isfinite(part))
        assert np.all(np.isfinite(found.force_coefficients))
        assert np.isfinite(found.report.total)


@examples(40)
@given(SEEDS)
def test_wild_scenes(seed: int) -> None:
    """A scene of any numbers is refused, solved, or not solved and said so."""
    rng = random.Random(seed)
    tables = wild_scene(rng)
    with time_limit(), np.errstate(all="ignore"):
        try:
            scene = Scene.from_mapping(tables)
            check_run(
                fc.modes(scene, rng.choice([1, 3, 1000])) if seed % 7 == 0 else fc.solve(scene)
            )
        except InputError as error:
            check_error(error)
        except ConvergenceError as error:
            assert str(error)


FAILED = {
    "a plate that gmsh would ask about": {"geometry.width": 1e30, "geometry.height": 1e29},
    "too many cells": {"mesh.columns": 200_000, "mesh.rows": 200_000},
    "numbers whose products overflow": {"material.young": 1e300, "geometry.thickness": 1e300},
    "a load far too slow for the highest mode": {"excitation.omega": 1e-30},
    "the same with the smoothed law": {
        "excitation.omega": 1e-30, "contact.law": "smoothed", "contact.sharpness": 1e6,
    },
    "overdamped": {"damping.ratio": 1e3, "crack.clearance": 1e-9},
    "critically damped": {"damping.ratio": 1.0, "contact.pairs": "mouth"},
}  # fmt: skip


@pytest.mark.parametrize("changes", FAILED.values(), ids=FAILED.keys())
def test_scenes_that_failed(changes: dict[str, Any]) -> None:
    """Found by wild scenes."""
    with time_limit(), np.errstate(all="ignore"):
        try:
            check_run(fc.solve(Scene.from_mapping(TINY).replace(changes)))
        except InputError as error:
            check_error(error)


def test_a_crack_tip_too_fine() -> None:
    """The element at the tip has a size that gmsh can mesh and the matrices can hold."""
    mesh_table = {"layout": "graded", "cells": "triangle", "size": 0.1, "lip_elements": 3}
    scene = Scene.from_mapping(TINY | {"mesh": mesh_table | {"grading": 1e6}})
    catch_error(lambda: fc.solve(scene.replace({"crack.length": 1e-4})), "mesh.grading", 1000000.0)


# --- mesh files -----------------------------------------------------------------------------------


def scene_of_file(path: Path) -> Scene:
    """The tiny plate with its mesh from a file."""
    tables: dict[str, Any] = {name: dict(table) for name, table in TINY.items()}
    tables |= {"geometry": {"thickness": 0.01}, "crack": {}}
    return Scene.from_mapping(tables | {"mesh": {"layout": "file", "file": str(path)}})


def test_a_surface_in_two_groups(tmp_path: Path) -> None:
    """Its cells count once: twice the same cells crash DOLFINx."""
    path, double = tmp_path / "good.msh", tmp_path / "double.msh"
    fc.write_msh(Scene.from_mapping(TINY), path)
    text = path.read_text()
    double.write_text(
        text.replace("$PhysicalNames\n5\n", '$PhysicalNames\n6\n2 7 "left"\n').replace(
            "1 0 0 0 0.05 0.05 0 1 1 4", "1 0 0 0 0.05 0.05 0 2 1 7 4"
        )
    )
    assert double.read_text().count(" 2 1 7 ") == 1
    single_solution, twice = (fc.solve(scene_of_file(p)).result for p in (path, double))
    np.testing.assert_allclose(single_solution.gap_coefficients, twice.gap_coefficients, rtol=1e-9)


# --- matrices -------------------------------------------------------------------------------------


def balance_or_refuse(arguments: dict[str, Any], options: dict[str, Any]) -> None:
    """A structure of any matrices, solved with any options."""
    options = {"omega": 1.1, "contact": fc.UnilateralPenalty(1.0), "harmonics": 3} | options
    if "tolerance" in options:
        del options["harmonics"]
    with time_limit(), np.errstate(all="ignore"):
        try:
            structure = fc.Structure.from_matrices(**arguments)
            solution = fc.solve_harmonic_balance(structure, **options)
        except InputError as error:
            check_error(error)
        except ConvergenceError:
            pass
        else:
            assert np.all(np.isfinite(solution.displacement_coefficients))
            assert np.all(np.isfinite(solution.gap_coefficients))


ODD = [
    None, "", "x", b"x", [], [[]], {}, {"a": 1}, object(), len, int, range(3), True, 0.0, -1.0, 1,
    1j, 7, 1000, 2**31, 2**63, 10**400, 1e-30, 1e30, float("nan"), "1e5", Path("missing"), "/",
    [1, 2, 3], [1, None, 3], ["1", "2", "3"], [[1], [2], [3]], np.array([object()]),
    np.array(["a", "b"]), np.array("x"), np.datetime64("2020"), np.ones(3), np.ones((3, 2)),
    np.eye(2), np.eye(3) * 1j, np.eye(3, dtype=int), np.eye(3, dtype=bool),
    np.eye(3, dtype=np.float16), np.eye(3) * 1e300, np.eye(3) * 1e-300, -np.eye(3),
    np.zeros((3, 3)), np.zeros((3, 3, 3)), np.zeros((0, 0)), np.full((3, 3), np.nan),
    np.full((3, 3), np.inf), np.array([[1, 2], [3]], dtype=object), sparse.eye(3),
    sparse.eye(3, format="lil"), sparse.eye(3) * 1j, sparse.csr_matrix((3, 3)),
    sparse.csr_matrix((0, 0)), fc.ModalDamping(0.1), fc.UnilateralConstraint(),
    fc.SmoothedPenalty(1.0, 1e3),
]  # fmt: skip
PARTS = (
    "mass", "stiffness", "gap", "damping", "force_sin", "force_cos", "force_mean", "clearance",
)  # fmt: skip
OPTIONS = (
    "omega", "contact", "harmonics", "samples", "subharmonic", "tolerance", "initial",
    "residual_tolerance",
)  # fmt: skip


@examples(200)
@given(SEEDS)
@example(1642)
def test_odd_arguments(seed: int) -> None:
    """Arguments of wrong kinds, shapes and sizes."""
    rng = random.Random(seed)
    arguments: dict[str, Any] = {
        "mass": np.diag([1.0, 2.0, 1.0]),
        "stiffness": np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]]),
        "gap": np.array([1.0, 0.0, -1.0]),
        "damping": 0.1 * np.eye(3),
        "force_sin": [1.0, 0.0, 0.0],
    }
    options: dict[str, Any] = {}
    for name in rng.sample((*PARTS, *OPTIONS), rng.choice([1, 1, 2])):
        (arguments if name in PARTS else options)[name] = rng.choice(ODD)
    balance_or_refuse(arguments, options)


# --- the program ----------------------------------------------------------------------------------


def check_call(arguments: list[str]) -> int:
    """Call the program; it ends with 0, 2, 3 or 4, and with a line about each error,
    and lines to paste where a table is missing."""
    with time_limit(), np.errstate(all="ignore"):
        code, errors = call(arguments)
    assert code in (0, 2, 3, 4), f"{code}: {errors}"
    if code == 2 and "--verbose" in arguments:
        return code  # with the cause
    assert "Traceback" not in errors
    if code == 2 and "usage: " not in errors:
        lines = errors.partition("for example:\n\n")[0].splitlines()  # before those to paste
        assert lines and all(line.startswith("fenics-crack: ") for line in lines)
        keys = [line.split()[1] for line in lines]
        assert len(lines) == 1 or sorted({*keys}) == sorted(keys)  # of a scene one for each key
    return code


@pytest.mark.parametrize(
    "name", ["missing.h5", "folder", "text.h5", "empty.h5", "other.h5", "cut.h5", "head.h5"]
)
def test_plot_of_no_result(name: str, tmp_path: Path) -> None:
    """What is no whole result file of this program is refused."""
    fc.save(fc.solve(Scene.from_mapping(TINY)).result, tmp_path / "solution.h5")
    content = (tmp_path / "solution.h5").read_bytes()
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["numbers"] = [1, 2, 3]
    (tmp_path / "folder").mkdir()
    parts = {"text": b"no HDF5", "empty": b"", "cut": content[: len(content) // 2]}
    for part_name, part in (parts | {"head": content[:100]}).items():
        (tmp_path / f"{part_name}.h5").write_bytes(part)
    assert check_call(["plot", str(tmp_path / name), "--output", str(tmp_path / "pictures")]) == 2


# --- more of each ---------------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("test", "count"),
    [(test_changed_scene_text, 2000), (test_wild_scenes, 100), (test_odd_arguments, 600)],
)
def test_many_seeds(test: Any, count: int) -> None:
    """Of what is tried above with some."""
    for seed in range(count):
        test.hypothesis.inner_test(seed)
