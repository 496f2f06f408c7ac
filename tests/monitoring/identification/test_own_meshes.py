"""Cracks looked for among meshes of one's own, of which each has its numbers."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gmsh
import h5py
import numpy as np
import pytest
from helpers import catch_error, gmsh_model
from mpi4py import MPI
from surroundings import RunCommand

import fenics_crack as fc

LENGTHS, HEIGHTS = (0.01, 0.018, 0.026, 0.034), (0.04, 0.07, 0.1, 0.13)
PLATE = """
geometry = { width = 0.1, height = 0.2, thickness = 0.01 }
crack = { edge = "left", height = 0.1, length = 0.02 }
material = { young = 2.1e11, poisson = 0.3, density = 7800.0 }
damping = { ratio = 0.01, modes = 6 }
excitation = { point = [0.1, 0.2], force_sin = [100.0, 30.0], frequency = 700.0 }
contact = { stiffness_per_area = 1e14 }
harmonic_balance = { harmonics = 5 }
mesh = { layout = "graded", order = 2, size = 0.04, lip_elements = 2 }
"""
OF_FILES = {
    "geometry.width": None, "geometry.height": None, "crack.edge": None, "crack.height": None,
    "crack.length": None, "mesh.layout": "file", "mesh.size": None, "mesh.lip_elements": None,
}  # fmt: skip


def written(folder: Path, scene: fc.Scene) -> str:
    """The tables of a scene of meshes, written by the program in a folder, for all lengths and
    heights, and of one without a crack."""
    lines = ["[identify]", 'uncracked = "whole.msh"', "[identify.meshes]"]
    for length in LENGTHS:
        for height in HEIGHTS:
            changes = {"crack.length": length, "crack.height": height}
            name = f"{1e3 * length:.0f}_{1e3 * height:.0f}.msh"
            fc.write_msh(scene.replace(changes), folder / name)
            numbers = f'"crack.height" = {height}, "crack.length" = {length}'
            lines.append(f'"{name}" = {{ {numbers} }}')
    fc.write_msh(scene.replace({"crack": None, "contact": None}), folder / "whole.msh")
    changed_scene = scene.replace(OF_FILES | {"mesh.file": "10_40.msh"})
    # The files in any order, and the numbers, too.
    return changed_scene.as_toml() + "\n".join([*lines[:3], *lines[:2:-1]]) + "\n"


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of meshes with their numbers, in a folder with these."""
    folder = tmp_path_factory.mktemp("meshes")
    (folder / "own.toml").write_text(written(folder, fc.Scene.from_text(PLATE)))
    return folder / "own.toml"


@pytest.fixture(scope="module")
def rows() -> fc.Measurements:
    """Frequencies of a crack of 22 mm at 80 mm, and before, on a finer mesh."""
    changes = {"mesh.size": 0.02, "mesh.lip_elements": 4, "crack.length": 0.022,
               "crack.height": 0.08}  # fmt: skip
    plate = fc.prepare(fc.Scene.from_text(PLATE).replace(changes), MPI.COMM_SELF)
    hertz = fc.bilinear_frequencies(plate.structure).omega_bilinear[:5] / (2.0 * np.pi)
    modes = [1, 2, 3, 4, 5]
    return fc.Measurements.from_arrays("frequency_bilinear", hertz, 1e-3 * hertz, mode=modes)


@pytest.mark.nightly
def test_as_the_program_s_own_meshes(own: Path, rows: fc.Measurements, tmp_path: Path) -> None:
    """From the same meshes in files the same crack is found as from those that the program makes;
    paths are those of the scene's folder. Between meshes of one's
    own nothing can be solved, so that the errors of the interpolation are a little smaller."""
    unknown = {"crack.height": list(HEIGHTS), "crack.length": list(LENGTHS)}
    made_scene = fc.Scene.from_text(PLATE).replace(
        {"identify.unknown": unknown, "identify.finer": 1.0}
    )
    expected_identification = fc.identify(made_scene, rows, folder=tmp_path / "made")
    scene = fc.Scene.load(own)
    identification = fc.identify(scene, rows, folder=own.parent / "sweeps")
    assert (
        identification.unknown
        == expected_identification.unknown
        == ("crack.height", "crack.length")
    )
    for key, value in expected_identification.estimate.items():
        assert identification.estimate[key] == pytest.approx(value, rel=1e-3)
    assert identification.log_bayes_factor == pytest.approx(
        expected_identification.log_bayes_factor, rel=0.02
    )
    [more_remark] = set(identification.remarks) - set(expected_identification.remarks)
    assert "do not include the error of the mesh files" in more_remark
    assert identification.verdict == "crack"
    assert identification.contains({"crack.length": 0.022, "crack.height": 0.08})
    assert fc.Scene.from_text(scene.as_toml()) == scene
    # Results of the scene itself do not depend on the others.
    modes = fc.solve_modes(fc.prepare(scene, MPI.COMM_SELF).structure, 1)
    fc.save(modes, tmp_path / "modes.h5", scene)
    with h5py.File(tmp_path / "modes.h5") as file:
        assert len(file.attrs["meshes"].split()) == 1


def test_command_without_a_mesh_of_no_crack(
    own: Path, rows: fc.Measurements, tmp_path: Path, run_command: RunCommand
) -> None:
    """There is nothing to compare with; of one height."""
    rows.to_csv(tmp_path / "m.csv")
    alone_path = own.with_name("alone.toml")
    text = own.read_text().replace('uncracked = "whole.msh"', "")
    text = text.replace('"crack.height" = 0.07, ', "")
    lines = [line for line in text.splitlines() if '"crack.height"' not in line]
    alone_path.write_text("\n".join(lines))
    words = ["identify", str(alone_path), str(tmp_path / "m.csv")]
    words += ["--output", str(own.parent / "sweeps")]
    messages = run_command(*words).err
    assert "undecided; there is no plate without a crack" in messages
    assert (
        "priors: " in messages
        and "young_deviation = 0.03" in messages
        and "confidence = 0.95" in messages
    )
    uncracked_row = replace(rows.rows[0], quantity="frequency_uncracked")
    (rows + fc.Measurements((uncracked_row,))).to_csv(tmp_path / "m.csv")
    assert "not allowed, since the crack cannot be removed" in run_command(*words, code=2).err


@pytest.mark.parametrize(
    ("old", "new", "key", "value", "names"),
    [
        ('"26_70.msh" = ', '# "26_70.msh" = ', "identify.meshes",
         "no files of crack.height = 0.07, crack.length = 0.026", None),
        ('0.13, "crack.length" = 0.034', '0.13, "crack.length" = 0.035', "identify.meshes",
         "no files of crack.height = 0.04, crack.length = 0.035", None),
        ('{ "crack.height" = 0.04, "crack.length" = 0.01 }', '{ "crack.height" = 0.04 }',
         'identify.meshes."10_40.msh"', ["crack.height"], None),
        ('"crack.length" =', '"crack.lenght" =', 'identify.meshes."34_130.msh"', "crack.lenght",
         r"crack\.length"),
        ('"10_40.msh" = { "crack.height" = 0.04, "crack.length" = 0.01 }', '"10_40.msh" = 0.04',
         "identify.meshes", ..., r"\.msh"),
        ("[identify.meshes]", '[identify.unknown]\n"crack.length" = [1.0, 2.0, 3.0, 4.0]\n'
         "[identify.meshes]", 'identify.meshes."34_130.msh"', "crack.length", r"crack\.center"),
        ('layout = "file"', 'layout = "graded"\nsize = 0.04', "mesh.file", "10_40.msh", "'graded'"),
    ],
)  # fmt: skip
def test_meshes_that_cannot_be_used(
    own: Path, old: str, new: str, key: str, value: Any, names: str | None
) -> None:
    """Are refused by name, before anything is solved."""
    text = own.read_text()
    assert old in text
    changed_text = text.replace(old, new)
    catch_error(
        partial(fc.Scene.from_text, changed_text, folder=own.parent), key, value, names=names
    )


def write_box(path: Path, length: float) -> None:
    """A blade of 30 x 90 x 6 mm with a crack through it, if it has one, 30 mm from its clamp."""
    with gmsh_model() as model:
        occ = model.occ
        box = [(3, occ.addBox(0.0, 0.0, 0.0, 0.03, 0.09, 0.006))]
        if length:
            face = occ.addRectangle(0.0, 0.0, 0.0, length, 0.006)
            occ.rotate([(2, face)], 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * np.pi)
            occ.translate([(2, face)], 0.0, 0.03, 0.0)
            occ.fragment(box, [(2, face)])
        occ.synchronize()
        for _, tag in model.getEntities(2):
            x, y, z = occ.getCenterOfMass(2, tag)
            is_inside = abs(y - 0.03) < 1e-9 and 0.0 < x < length and 0.0 < z < 0.006
            if abs(y) < 1e-9 or is_inside:
                name = "crack" if is_inside else "clamp"
                model.setPhysicalName(2, model.addPhysicalGroup(2, [tag]), name)
        model.addPhysicalGroup(3, [1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.012)
        model.mesh.generate(3)
        gmsh.write(str(path))


@pytest.mark.nightly
def test_numbers_of_one_s_own_in_space(tmp_path: Path) -> None:
    """Solids, and a number that is no key of a crack; what is unknown beside it, too."""
    solid = """
geometry = { kind = "solid" }
material = { young = 2.1e11, poisson = 0.3, density = 7800.0 }
damping = { ratio = 0.01, modes = 6 }
excitation = { point = [0.03, 0.09, 0.006], force_sin = [0.0, 0.0, 1.0], frequency = 400.0 }
contact = { law = "unilateral" }
mesh = { layout = "file", order = 2, file = "4.msh" }
harmonic_balance = { harmonics = 1 }
[identify]
uncracked = "0.msh"
[identify.unknown]
"material.young" = [1.9e11, 2.0e11, 2.1e11, 2.2e11]
[identify.meshes]
"4.msh" = { notch = 4.0 }
"8.msh" = { notch = 8.0 }
"12.msh" = { notch = 12.0 }
"16.msh" = { notch = 16.0 }
"""
    for notch in (0, 4, 8, 10, 12, 16):
        write_box(tmp_path / f"{notch}.msh", 1e-3 * notch)
    scene = fc.Scene.from_text(solid, folder=tmp_path)
    rows = ()
    for name, quantity in (("10.msh", "frequency_open"), ("0.msh", "frequency_uncracked")):
        changes = {"mesh.file": str(tmp_path / name), "contact": None, "identify": None}
        modes = fc.solve_modes(fc.build_structure(scene.replace(changes)), 4)
        hertz = modes.omega / (2.0 * np.pi)
        rows += fc.Measurements.from_arrays(quantity, hertz, 1e-3 * hertz, mode=[1, 2, 3, 4]).rows
    rows = fc.Measurements(rows)
    identification = fc.identify(scene, rows, folder=tmp_path / "sweeps")
    assert identification.unknown == ("notch", "material.young")
    low, high = identification.intervals["notch"]
    assert low < 10.0 < high < 16.0 and identification.verdict == "crack"
    assert "notch = " in str(identification)


def test_thousands_of_meshes_are_checked_at_once() -> None:
    """The time grows like their number: with its square it was 2.6 s, and is .02 s."""
    meshes = {f"{number}.msh": {"place": float(number)} for number in range(4000)}
    start = time.process_time()
    changes = {"mesh.file": "0.msh", "identify.meshes": meshes}
    table = fc.Scene.from_text(PLATE).replace(OF_FILES | changes)
    assert time.process_time() - start < 1.5
    assert table.identify is not None and len(table.identify.meshes) == 4000
