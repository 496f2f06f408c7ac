"""The structure that a command keeps for the next: the same answers, never those of another."""

from __future__ import annotations

import copy
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import SOLID_TEXT, TITANIUM, changed
from mpi4py import MPI
from ranks import LIMIT
from surroundings import DEMOS, RunCommand, main, no_rank
from test_artefact import FORGERIES, PLATE, put_number, replaced, shortened

import fenics_crack as fc
from fenics_crack.files.store import read_result_file
from fenics_crack.scene.keys import known_keys
from fenics_crack.study.sharing import (
    CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST,
    LAST_STRUCTURE_OR_EMPTY_LIST,
    dependencies_of_structure,
)
from fenics_crack.study.shelf import StructureFile, digest_of_dependencies

pytestmark = pytest.mark.usefixtures("not_drawn")

SMALL = PLATE.replace("harmonics = 7", "harmonics = 3").replace("size = 0.03", "size = 0.06")
SMALL = SMALL.replace("lip_elements = 4", "lip_elements = 2").replace("modes = 10", "modes = 5")
SMALL = SMALL.replace('"unilateral"', '"unilateral"\nfriction_error = false')
"""A plate that takes little time."""
PROGRAM = """
import sys
from fenics_crack.cli.command_line import main
main(sys.argv[1:])
print([name for name in ("dolfinx", "ufl", "gmsh") if name in sys.modules])
"""
FREE = re.compile(
    r"excitation\.(omega|frequency|force_\w+|harmonics)|damping\.|mesh\.error$"
    r"|contact\.(?!pairs)|cracks?(\.1)?\.clearance$|harmonic_balance|reduction|curve|integration|sweep|growth"
    r"|identify|tip_timing|output"
)
"""Keys that change nothing of a structure but load, damping and clearance."""


@pytest.fixture
def plate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The scene of a plate in a folder of its own, in which the program runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plate.toml").write_text(SMALL)
    return tmp_path / "plate.toml"


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a solution of the plate leaves."""
    folder = tmp_path_factory.mktemp("solved")
    (folder / "plate.toml").write_text(SMALL)
    assert run("solve", folder / "plate.toml", "--output", str(folder / "plate")) in (0, 4)
    return folder / "plate"


@pytest.fixture
def path(plate: Path, solved: Path) -> Path:
    """The structure in the plate's folder for results."""
    shutil.copytree(solved, plate.parent / "output" / "plate")
    return plate.parent / "output" / "plate" / "prepared.h5"


def run(command: str, scene: Path, *words: str) -> int:
    """Run a command as in a new process, which remembers no structure."""
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    return int(main([command, str(scene), "--quiet", *words]))


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of what a JSON file holds."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, leaf in items:
            yield from leaves(leaf, f"{name}.{key}")
    else:
        yield name, value


def lines_of(said: str) -> list[str]:
    """Lines about the file among those on standard error."""
    return [line for line in said.splitlines() if "prepared.h5" in line]


def same_answers(command: str, scene: Path, *words: str) -> None:
    """Assert that a command and the same with --fresh write the same numbers and words."""
    kept_folder, fresh = (scene.parent / name for name in ("kept", "fresh"))
    ends = [
        run(command, scene, *words, "--output", str(kept_folder)),
        run(command, scene, *words, "--output", str(fresh), "--fresh"),
    ]
    assert ends[0] == ends[1]
    if ends[0] in (2, 3):
        return
    name = {"solve": "solution"}.get(command, command)
    files = [json.loads((folder / f"{name}.json").read_text()) for folder in (kept_folder, fresh)]
    file_leaves, expected_leaves = (dict(leaves(content)) for content in files)
    assert file_leaves.keys() == expected_leaves.keys()
    for key, value in expected_leaves.items():
        if isinstance(value, float) and math.isfinite(value):
            # residuals and penetrations are rounding themselves
            assert file_leaves[key] == pytest.approx(value, rel=1e-10, abs=1e-11), key
        else:
            assert file_leaves[key] == value or value != value, key


@pytest.mark.usefixtures("path")
def test_second_commands_mesh_nothing(plate: Path, meshes: list[fc.Scene]) -> None:
    """check, solve and curve after solve, with other values of what needs no mesh."""
    keys = ("excitation.frequency=790", "damping.ratio=0.01", "crack.clearance=1e-8")
    words = [word for key in keys for word in ("--set", key)]
    band = [
        "--set",
        "curve.start=780.0",
        "--set",
        "curve.stop=790.0",
        "--set",
        "curve.stability=false",
    ]
    assert run("check", plate) == 0
    assert run("curve", plate, *band) in (0, 4)
    assert run("solve", plate, *words) in (0, 4) and not meshes
    assert run("check", plate, "--set", "crack.length=0.02") == 0 and len(meshes) == 2
    assert run("check", plate, "--set", "crack.length=0.02") == 0 and len(meshes) == 2
    assert run("check", plate, "--set", "crack.length=0.02", "--fresh") == 0 and len(meshes) == 4


def test_second_answers_are_those_of_a_fresh_structure(plate: Path) -> None:
    """With every stated error, under another load, after a command that needed fewer modes."""
    plate.write_text(PLATE)
    assert run("solve", plate, "--output", "kept", "--set", "reduction.modes=4") in (0, 4)
    same_answers("solve", plate, "--set", "excitation.force_sin=[13.0, 0.0]")


@pytest.mark.parametrize(
    "keys",
    [
        ("crack.length=0.02", "harmonic_balance.tolerance=0.01"),
        ("harmonic_balance.tolerance=0.003",),
    ],
)
def test_second_answers_are_equal_to_the_bit(keys: tuple[str, ...], plate: Path) -> None:
    """A, B and B again, which leave A in before/; nor does --fresh count as another result.

    B is of another mesh than A, or of the same and needs more modes.
    """
    text = PLATE.replace("harmonics = 7", "tolerance = 0.05").replace("modes = 10", "")
    text = text.replace("lip_elements = 4", "lip_elements = 3\norder = 2\nerror = false")
    plate.write_text(text.replace('"unilateral"', '"unilateral"\nfriction_error = false'))
    results = plate.parent / "output" / "plate"
    assert run("solve", plate) in (0, 4)
    earlier_text, texts = (results / "solution.json").read_text(), list[str]()
    words = [word for one in keys for word in ("--set", one)]
    for option in ((), (), ("--fresh",)):
        assert run("solve", plate, *words, *option) in (0, 4)
        texts.append((results / "solution.json").read_text())
        assert (results / "before" / "solution.json").read_text() == earlier_text
    assert texts[0] == texts[1]
    assert run("solve", plate, *words, "--set", "excitation.frequency=780.00001") in (0, 4)
    assert (results / "before" / "solution.json").read_text() == texts[2]


def test_second_solve_imports_no_mesher(plate: Path, path: Path) -> None:
    """Neither DOLFINx nor gmsh."""
    words = ["solve", str(plate), "--set", "excitation.frequency=790"]
    command = [sys.executable, "-c", PROGRAM, *words]
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=no_rank())
    assert f"{path.name}: the structure is read from this file" in process.stderr, process.stderr
    assert process.stdout.splitlines()[-1] == "[]"


def base_scenes() -> list[fc.Scene]:
    """Scenes that have all tables, together."""
    more_text = (
        '[[loads]]\nedge = "top"\npressure_sin = 1.0\n[base]\nacceleration_sin = [1.0, 0.0]\n'
    )
    more_text += '[[cracks]]\nedge = "right"\nheight = 0.05\nlength = 0.02\n'
    scenes = [fc.Scene.from_text(PLATE + more_text), TITANIUM]
    return scenes + [fc.Scene.load(DEMOS / f"{name}.toml") for name in ("chain", "bladed_disk")]


def test_digest_has_what_a_structure_follows_from() -> None:
    """Each key of the program's own list in turn, with a value that no scene has."""
    scenes, missed_keys = base_scenes(), []
    for key in known_keys():
        table, *number, name = key.split(".")
        for scene in scenes:
            table_value = getattr(scene, table)
            if not table_value:
                continue
            other_scene = copy.copy(scene)
            word = () if key == "sweep.over" else "another"  # axes may name files
            value: Any = (table_value[0] if number else table_value).with_unchecked_values(
                **{name: word}
            )
            vars(other_scene)[table] = (value,) if number else value
            earlier_key, later_key = (
                digest_of_dependencies(dependencies_of_structure(keyed_scene, MPI.COMM_SELF))
                for keyed_scene in (scene, other_scene)
            )
            assert (earlier_key == later_key) == bool(FREE.match(key)), key
            break
        else:
            missed_keys.append(key)
    assert all(FREE.match(key) for key in missed_keys), missed_keys


CHANGES: dict[str, object] = {
    "geometry.width": 0.11, "geometry.height": 0.31, "geometry.thickness": 0.003,
    "material.young": 2e11, "material.poisson": 0.25, "material.density": 7000.0,
    "damping.ratio": 0.01, "damping.modes": 5, "excitation.frequency": 700.0,
    "excitation.omega": 4500.0, "excitation.point": [0.0, 0.3], "excitation.force_sin": [3.0, 1.0],
    "excitation.force_cos": [1.0, 0.0], "excitation.force_mean": [2.0, 0.0],
    "excitation.harmonics": [{"order": 2, "sin": [1.0, 0.0]}], "mesh.cells": "triangle",
    "mesh.order": 1, "mesh.size": 0.025, "mesh.lip_elements": 5, "mesh.grading": 4.0,
    "mesh.patches": 3, "mesh.error": False, "contact.law": "penalty", "contact.friction": 0.2,
    "contact.friction_error": False, "contact.pairs": "mouth", "crack.edge": "right",
    "crack.height": 0.14, "crack.length": 0.02, "crack.clearance": 1e-7,
    "crack.first_frequency": 800.0, "harmonic_balance.harmonics": 9,
    "harmonic_balance.tolerance": 0.05, "harmonic_balance.samples": 256,
    "harmonic_balance.form": "block", "harmonic_balance.error": False,
    "reduction.method": "free_interface", "reduction.modes": 12,
    "output.points": {"tip": [0.05, 0.3]}, "output.quantities": ["K_I_max"],
    "rotation.rpm": 1000.0, "base.acceleration_sin": [1.0, 0.0],
}  # fmt: skip
"""Values of keys that the plate may have, too."""


@pytest.mark.nightly
@pytest.mark.parametrize("key", CHANGES)
def test_each_key_has_the_answer_of_a_fresh_structure(key: str, plate: Path) -> None:
    """Changed alone, after a command on the plate as it was."""
    assert run("solve", plate, "--output", "kept") in (0, 4)
    others = {
        "crack.first_frequency": ["crack.length=none"],
        "contact.law": ["contact.stiffness_per_area=1e13"],
        "excitation.omega": ["excitation.frequency=none"],
        "harmonic_balance.tolerance": ["harmonic_balance.harmonics=none"],
    }
    value = json.dumps(CHANGES[key]).replace('": ', '" = ')  # as TOML has it
    words = [f"{key}={value}", *others.get(key, [])]
    same_answers("solve", plate, *(word for one in words for word in ("--set", one)))


FORGED: dict[str, Callable[[Any], None]] = FORGERIES | {
    "another stiffness": lambda file: put_number(file, "structure.stiffness.indices", 0, 10**6),
    "steps beyond its modes": lambda file: replaced(
        file,
        "structure",
        file["structure"].asstr()[()].replace('"mode_counts": [', '"mode_counts": [999999, '),
    ),
    "fewer entries": lambda file: shortened(file, "structure.mass.data", slice(-1)),
    "a load that is no number": lambda file: put_number(file, "structure.excitation", 0, np.nan),
    "a load of another size": lambda file: shortened(file, "structure.excitation", slice(1)),
    "a forged coarser mesh": lambda file: put_number(
        file, "coarser_structure.mass.data", 0, np.nan
    ),
}


def test_forged_files_are_not_used(
    plate: Path, path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """In one line, and the answer is that of the scene; a damaged one, too."""
    content, solution = path.read_bytes(), path.with_name("solution.json")
    expected_text = solution.read_text()
    scene = fc.Scene.load(plate)
    for name, forge in FORGED.items():
        if name in ("no scene", "dofs without nodes"):  # which is not read; of a plate
            continue
        path.write_bytes(content)
        with changed(path) as file:
            forge(file)
        message_lines: list[str] = []
        assert (
            StructureFile(path, message_lines.append, is_read=True).read_shared_structure_or_none(
                scene, MPI.COMM_SELF
            )
            is None
        ), name
        assert (
            len(message_lines) == 1
            and "not used" in message_lines[0]
            and "\n" not in message_lines[0]
        ), name
    path.write_bytes(content[:-1000])
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    capfd.readouterr()
    assert main(["solve", str(plate)]) in (0, 4)
    message_lines = lines_of(capfd.readouterr().err)
    assert len(message_lines) == 1 and "not used" in message_lines[0]
    assert solution.read_text() == expected_text


def test_what_cannot_be_kept_is_said(
    plate: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one line, of a large one and where no file can be written; the command goes on."""
    folder = plate.parent / "output" / "plate"
    (folder / "prepared.h5").mkdir(parents=True)
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    assert main(["check", str(plate)]) == 0
    [line] = lines_of(capfd.readouterr().err)
    assert "not kept" in line
    (folder / "prepared.h5").rmdir()
    monkeypatch.setattr("fenics_crack.study.shelf.MAX_STRUCTURE_FILE_BYTES", 1000)
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    assert main(["check", str(plate)]) == 0
    [line] = lines_of(capfd.readouterr().err)
    assert "not kept" in line and not (folder / "prepared.h5").exists()


def test_results_come_before_the_structure(
    plate: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a disk with room for five of its files it is not kept, in one line."""
    folder = plate.parent / "output" / "plate"
    assert run("solve", plate) in (0, 4)
    n_bytes = (folder / "prepared.h5").stat().st_size
    for path in folder.iterdir():
        path.unlink()
    usage = shutil.disk_usage(folder)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=5 * n_bytes))
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    capfd.readouterr()
    assert main(["solve", str(plate)]) in (0, 4)
    [line] = lines_of(capfd.readouterr().err)
    assert "not kept" in line and "are free" in line
    assert sorted(path.name for path in folder.iterdir()) == [
        f"solution.{ending}" for ending in ("csv", "h5", "json")
    ]


@pytest.mark.parametrize("command", ["check", "clean"])
def test_hidden_files_of_killed_commands_are_removed(command: str, plate: Path, path: Path) -> None:
    """By the next one, and by clean; others are left."""
    hidden, other = (path.with_name(f".0123abcd.{name}") for name in (path.name, "solution.h5"))
    hidden.touch()
    other.touch()
    assert run(command, plate) == 0
    assert not hidden.exists() and other.exists()


@pytest.mark.usefixtures("path")
def test_options_for_modes_compute_the_structure(plate: Path) -> None:
    """No kept one is taken, and the options are not said to have had no effect."""
    words = ["solve", str(plate), "-crack_modes_eps_tol", "1e-9"]
    process = subprocess.run(
        [str(Path(sys.executable).with_name("fenics-crack")), *words], env=no_rank(),
        capture_output=True, text=True, timeout=LIMIT, check=False,
    )  # fmt: skip
    assert process.returncode in (0, 4), process.stderr
    assert "no effect" not in process.stderr and "read from this file" not in process.stderr


def test_clean_removes_the_file(plate: Path, path: Path, run_command: RunCommand) -> None:
    """In the folder that is named; reports and pictures of a folder leave it out."""
    run_command("report", str(path.parent))
    run_command("report", str(path), code=2)
    run_command("clean", str(plate), "--output", "elsewhere")
    assert path.exists() and not (plate.parent / "elsewhere").exists()
    run_command("clean", str(plate))
    run_command("clean", str(plate))
    assert not path.exists() and path.with_name("solution.h5").exists()


@pytest.mark.usefixtures("path")
def test_structure_of_a_file_serves_its_command_alone(plate: Path) -> None:
    """A script in the same process has a mesh to integrate over."""
    assert run("check", plate) == 0
    scene = fc.Scene.load(plate)
    assert fc.prepare(scene, whole=True).structure.nodes.dolfinx_mesh_and_dofs is not None


def amplitude_of(folder: str, comm: MPI.Comm = MPI.COMM_WORLD) -> float:
    """That of a structure which two ranks have taken, and kept, together (collective)."""
    scene, path, message_lines = (
        fc.Scene.from_text(SMALL),
        Path(folder) / "prepared.h5",
        list[str](),
    )
    for is_read in (False, True):
        LAST_STRUCTURE_OR_EMPTY_LIST.clear()
        CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST[:] = [
            StructureFile(path, message_lines.append, is_read=is_read)
        ]
        run = fc.solve(scene, comm)
        assert run.errors is not None
        CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST[0].write_noted_structure(comm)
        CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST.clear()
    assert comm.rank or len(message_lines) == 1, message_lines
    return float(run.amplitude(None))


@pytest.mark.mpi
def test_two_ranks_take_one_structure(tmp_path: Path, on_ranks: Callable[..., Any]) -> None:
    """With the answer of one."""
    single_amplitude = fc.solve(fc.Scene.from_text(SMALL), MPI.COMM_SELF).amplitude(None)
    assert on_ranks(amplitude_of, str(tmp_path)) == pytest.approx(single_amplitude, rel=1e-8)


@pytest.mark.nightly
@pytest.mark.parametrize("command", ["solve", "check"])
def test_solids_take_their_structure(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, meshes: list[fc.Scene]
) -> None:
    """With friction as a cause of errors, whose tangents they have only then."""
    monkeypatch.chdir(tmp_path)
    scene = tmp_path / "solid.toml"
    text = SOLID_TEXT.replace('law = "penalty", stiffness = 1e8', 'law = "unilateral"')
    scene.write_text(text.replace(", error = false", "") + "reduction = { modes = 10 }\n")
    assert run("solve", scene, "--output", "kept") in (0, 4)
    n_meshes = len(meshes)
    if command == "check":
        assert run("check", scene) == 0
        return
    assert run("solve", scene, "--output", "kept") in (0, 4) and len(meshes) == n_meshes
    same_answers("solve", scene)


def test_coarser_mesh_of_another_load_is_not_kept(plate: Path, tmp_path: Path) -> None:
    """One that an earlier scene of the process has left is no part of the file."""
    scene, message_lines = fc.Scene.load(plate), list[str]()
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    assert fc.solve(scene, MPI.COMM_SELF).errors is not None
    twice = scene.replace({"excitation.force_sin": [20.0, 0.0], "mesh.error": False})
    CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST[:] = [
        StructureFile(tmp_path / "prepared.h5", message_lines.append, is_read=False)
    ]
    fc.prepare(twice, MPI.COMM_SELF, whole=True)
    CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST[0].write_noted_structure(MPI.COMM_SELF)
    CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST.clear()
    assert "coarser_structure" not in read_result_file(tmp_path / "prepared.h5").datasets
