"""Matrices and models of other programs: what each writes, read; and the pairs that are found.

tests/exchange/plate/ was made by CalculiX 2.20 (calculix_plate.py beside it). The other formats are
written here, as their manuals say: *MATRIX OUTPUT of Abaqus (FORMAT=MATRIX INPUT), DMIG and bulk
data of the MSC Nastran Quick Reference Guide, HBMAT and CDWRITE of Ansys.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sparse
from helpers import DEMOS, catch_error, csr
from mpi4py import MPI
from surroundings import RunCommand, main

import fenics_crack as fc
from fenics_crack import Scene
from fenics_crack.fem.model_files import ModelFileMesh, read_nodes_and_cells
from fenics_crack.fem.model_pairs import find_gap_matrix_and_pairs
from fenics_crack.model.matrix_formats import read_matrix

FOLDER = Path(__file__).with_name("plate")
TEXT = """
[structure]
mass = "plate.mas"
stiffness = "plate.sti"
model = "plate.inp"
[damping]
ratio = 0.05
[excitation]
frequency = 9000.0
point = [0.0, 0.02, 0.0]
force_sin = [0.0, 100.0, 0.0]
[contact]
law = "unilateral"
[harmonic_balance]
harmonics = 10
[reduction]
modes = 10
"""


def calculix_frequencies() -> np.ndarray:
    """As they stand in the file [Hz]."""
    rows = re.findall(r"^ +\d+ +\S+ +\S+ +(\S+) +\S+$", (FOLDER / "plate.dat").read_text(), re.M)
    return np.array(rows[:6], dtype=float)


def frequencies(structure: fc.Structure) -> np.ndarray:
    """With open lips [Hz]."""
    hertz: np.ndarray = fc.solve_modes(structure, 6).omega / (2.0 * np.pi)
    return hertz


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of the files of CalculiX, to be changed."""
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    (tmp_path / "scene.toml").write_text(TEXT)
    return tmp_path


@pytest.fixture
def scene(folder: Path) -> Scene:
    """Of CalculiX's plate."""
    return Scene.load(folder / "scene.toml")


def test_calculix_finds_the_same_frequencies(scene: Scene) -> None:
    """To the digits that it prints."""
    structure = fc.build_structure(scene)
    assert frequencies(structure) == pytest.approx(calculix_frequencies(), rel=1e-6)


def test_pairs_are_found_without_a_word(scene: Scene) -> None:
    """The two corners of the mouth, each with half of the crack's area, the front's share too; the
    gap grows where the upper lip's nodes, 19 and 20, move down."""
    structure = fc.build_structure(scene)
    assert structure.pair_points == pytest.approx(np.array([[0.0, 0.01, 0.0], [0.0, 0.01, 0.005]]))
    assert structure.pair_areas == pytest.approx([0.5 * 0.01 * 0.005] * 2)
    assert list(structure.watched_pairs) == ["the mouth"]
    displacements = np.zeros((2, structure.n_dofs))
    displacements[0, structure.nodes.dofs[[18, 19], 1]] = -1e-6
    displacements[1, structure.nodes.dofs[[3, 12], 1]] = 1e-6
    # The motion falls by a line from 1 at the mouth to 0 at the front, where psi is 1, too.
    assert structure.apply_bt(displacements) == pytest.approx(np.full((2, 2), 0.5e-6))
    (dof,) = np.flatnonzero(structure.force[2])
    assert structure.dof_name(int(dof)) == "y displacement at (0, 0.02, 0) m"


def test_from_matrices_to_a_verdict(scene: Scene) -> None:
    """The crack breathes: the solution is an orbit that is stable."""
    run = fc.solve(scene)
    assert run.result.converged and run.result.indicators().ratio_2_1 > 0.01
    assert run.result.stability is not None and run.result.stability.verdict == "stable"


@pytest.mark.nightly
def test_from_the_shell(folder: Path, run_command: RunCommand) -> None:
    """Modes are drawn on the model's bricks; a load beside its nodes gets a remark."""
    words = [str(folder / "scene.toml"), "--set", "excitation.point=[0.001,0.02,0.0]"]
    assert (
        "no node is at this point: the force acts on the nearest node"
        in run_command("check", *words).err
    )
    assert main(["modes", *words, "--output", str(folder)]) == 0
    assert main(["plot", str(folder / "modes.h5")]) == 0
    assert (folder / "modes.png").exists()


# --- the same plate in other formats --------------------------------------------------------------


def plate_matrices() -> dict[str, Any]:
    """Stiffness and mass, and node and direction of their rows."""
    matrices = {kind: read_matrix(FOLDER / f"plate.{end}", kind) for kind, end in ENDINGS.items()}
    return {kind: matrix.matrix for kind, matrix in matrices.items()} | {
        "labels": matrices["K"].labels
    }


ENDINGS = {"K": "sti", "M": "mas"}


def triangle(matrix: Any) -> list[tuple[int, int, float]]:
    """Entries on the diagonal and below."""
    lower_triangle = sparse.tril(matrix).tocoo()
    return list(
        zip(
            lower_triangle.row.tolist(),
            lower_triangle.col.tolist(),
            lower_triangle.data.tolist(),
            strict=True,
        )
    )


def write_abaqus(folder: Path) -> dict[str, str]:
    """One triangle of the stiffness and both of the mass, either of which is allowed; what is held
    has 1e36 on the diagonal of the stiffness, and its mass."""
    matrices = plate_matrices()
    labels = matrices["labels"].tolist()
    for kind, name, diagonal_value in (
        ("K", "plate_STIF1.mtx", 1e36),
        ("M", "plate_MASS1.mtx", 1e-3),
    ):
        entries = triangle(matrices[kind])
        entries += [(j, i, value) for i, j, value in entries if i != j and kind == "M"]
        lines = ["** ASSEMBLED MATRIX"] + [
            ",".join(map(str, [*labels[i], *labels[j], value])) for i, j, value in entries
        ]
        lines += [
            f"{n},{d}, {n},{d}, {diagonal_value}" for n in (1, 2, 3, 10, 11, 12) for d in (1, 2, 3)
        ]
        (folder / name).write_text("\n".join(lines) + "\n")
    return {"stiffness": "plate_STIF1.mtx", "mass": "plate_MASS1.mtx", "model": "plate.inp"}


def write_nastran(folder: Path) -> dict[str, str]:
    """One punch file with both matrices, and the bulk data in all three kinds of fields."""
    matrices = plate_matrices()
    labels = matrices["labels"].tolist()
    lines = []
    for name, kind in (("KAAX", "K"), ("MAAX", "M")):
        lines.append(f"DMIG    {name:8}{0:8}{6:8}{2:8}{0:8}{'':8}{len(labels):8}")
        columns: dict[int, list[str]] = {}
        for i, j, value in triangle(matrices[kind]):
            number = f"{value:16.9E}".replace("E", "D")
            columns.setdefault(i, []).append(
                f"*       {labels[j][0]:16}{labels[j][1]:16}{number:>16}"
            )
        for i, rows in columns.items():
            lines += [f"DMIG*   {name:16}{labels[i][0]:16}{labels[i][1]:16}", *rows]
    lines += [f"DMIG    VAX     {0:8}{9:8}{2:8}{0:8}{'':8}{1:8}", f"DMIG*   {'VAX':16}{1:16}{0:16}"]
    (folder / "plate.pch").write_text("\n".join(lines) + "\n")
    model = read_nodes_and_cells(FOLDER / "plate.inp")
    bulk = ["BEGIN BULK", "$ a comment"]
    for number, (label, (x, y, z)) in enumerate(zip(model.labels, model.points, strict=True)):
        if number % 3 == 0:
            bulk.append(f"GRID,{label},,{x:.3f},{y:.3f},{z:.3f}")
        elif number % 3 == 1:
            bulk.append(f"GRID    {label:8}{'':8}{x:8.3f}{y:8.3f}{1e3 * z:6.3f}-3")
        else:
            bulk += [f"GRID*   {label:16}{'':16}{x:16.9f}{y:16.9f}", f"*       {z:16.9f}"]
    for number, cell in enumerate(model.labels[model.cells_by_vtk_type[12]], 1):
        first_fields, last_fields = (
            "".join(f"{n:8}" for n in part) for part in (cell[:6], cell[6:])
        )
        bulk += [f"CHEXA   {number:8}{1:8}{first_fields}+", f"+       {last_fields}"]
    (folder / "plate.bdf").write_text("\n".join([*bulk, "ENDDATA"]) + "\n")
    return {"stiffness": "plate.pch", "mass": "plate.pch", "model": "plate.bdf"}


def write_ansys(folder: Path) -> dict[str, str]:
    """Matrix Market files, what HBMAT says of their rows, and the blocks of CDWRITE."""
    files = write_market(folder)
    model = read_nodes_and_cells(FOLDER / "plate.inp")
    lines = ["/PREP7", f"NBLOCK,6,SOLID,{20:9},{20:9}", "(3i9,6e21.13e3)"]
    for label, point in zip(model.labels.tolist(), model.points.tolist(), strict=True):
        coordinates = point[
            : 1 + max(np.flatnonzero(point), default=-1)
        ]  # zeros at the end are left out
        lines.append(f"{label:9}{0:9}{0:9}" + "".join(f"{x:21.13E}" for x in coordinates))
    lines += ["N,R5.3,LOC,       -1,", f"EBLOCK,19,SOLID,{4:9},{4:9}", "(19i9)"]
    for number, cell in enumerate(model.labels[model.cells_by_vtk_type[12]].tolist(), 1):
        row = [1, 1, 1, 1, 0, 0, 0, 0, 8, 0, number, *cell]
        lines.append("".join(f"{x:9}" for x in row))
    (folder / "plate.cdb").write_text("\n".join([*lines, f"{-1:9}", "FINISH"]) + "\n")
    return files | {"model": "plate.cdb"}


def write_market(folder: Path) -> dict[str, str]:
    """Matrix Market files, what HBMAT says of their rows, and a table of the nodes alone."""
    matrices = plate_matrices()
    for kind in "KM":
        scipy.io.mmwrite(folder / f"{kind}.mtx", matrices[kind], symmetry="symmetric", precision=17)
    rows = [f"{i:8} {n:8} U{'XYZ'[d - 1]}" for i, (n, d) in enumerate(matrices["labels"], 1)]
    rows.reverse()  # their numbers tell which they are
    (folder / "plate.mapping").write_text("\n".join(["  Matrix Eqn    Node   DOF", *rows]) + "\n")
    model = read_nodes_and_cells(FOLDER / "plate.inp")
    table = np.column_stack([model.labels, model.points])
    np.savetxt(folder / "nodes.csv", table, fmt="%.6g", delimiter=",")
    return {
        "stiffness": "K.mtx", "mass": "M.mtx", "dofs": "plate.mapping", "model": "nodes.csv",
    }  # fmt: skip


def op4_lines(matrix: np.ndarray, name: str, layout: str, digits: int = 16) -> list[str]:
    """As OUTPUT4 writes a matrix: "dense", "sparse" or "big" (strings of numbers of any length)."""
    n, numbers_per_line = len(matrix), 80 // (digits + 7)
    rows = -n if layout == "big" else n
    lines = [f"{n:8}{rows:8}{6:8}{2:8}{name:8}1P,{numbers_per_line}E{digits + 7}.{digits}"]

    def numbers(values: np.ndarray) -> list[str]:
        words = [f"{value:{digits + 7}.{digits}E}" for value in values]
        return [
            "".join(words[start : start + numbers_per_line])
            for start in range(0, len(words), numbers_per_line)
        ]

    for column, values in enumerate(matrix.T, 1):
        nonzero_rows = np.flatnonzero(values)
        if layout == "dense":
            nonzero_run = values[nonzero_rows[0] : nonzero_rows[-1] + 1]
            lines += [
                f"{column:8}{nonzero_rows[0] + 1:8}{len(nonzero_run):8}",
                *numbers(nonzero_run),
            ]
            continue
        strings = np.split(nonzero_rows, np.flatnonzero(np.diff(nonzero_rows) > 1) + 1)
        spent = 2 if layout == "big" else 1
        words = sum(2 * len(string) + spent for string in strings)
        lines.append(f"{column:8}{0:8}{words:8}")
        for string in strings:
            row, length = string[0] + 1, 2 * len(string) + 1
            lines.append(f"{length:8}{row:8}" if layout == "big" else f"{row + 65536 * length:10}")
            lines += numbers(values[string])
    return [*lines, f"{n + 1:8}{1:8}{1:8}", *numbers(np.ones(1))]


def write_op4(folder: Path) -> dict[str, str]:
    """Both matrices in one file of OUTPUT4, whose rows are named beside it."""
    matrices, files = plate_matrices(), write_market(folder)
    dense, strings = (matrices[kind].toarray() for kind in "KM")
    lines = op4_lines(dense, "KAA", "dense") + op4_lines(strings, "MAA", "sparse")
    (folder / "plate.op4").write_text("\n".join(lines) + "\n")
    files |= {"stiffness": "plate.op4", "mass": "plate.op4"}
    return files | {"model": write_nastran(folder)["model"]}


@pytest.mark.parametrize("layout", ["dense", "sparse", "big"])
def test_matrices_of_output4(layout: str, tmp_path: Path) -> None:
    """Numbers of nine digits, some of them in a line of their own; and files that are damaged."""
    rng = np.random.default_rng(3)
    matrix = rng.normal(size=(13, 13)) * (rng.random((13, 13)) < 0.6) + np.eye(13)
    path = tmp_path / "both.op4"
    lines = op4_lines(np.eye(13), "MAA", "sparse", 9) + op4_lines(matrix, "KAA", layout, 9)
    path.write_text("\n".join(lines) + "\n")
    read_array = read_matrix(path, "K").matrix.toarray()
    assert read_array == pytest.approx(matrix, rel=1e-9) and np.all(
        (read_array == 0.0) == (matrix == 0.0)
    )
    assert np.array_equal(read_matrix(path, "M").matrix.toarray(), np.eye(13))
    fortran = re.sub(r"(\d)E([+-]\d\d)", r"\1D\2", "\n".join(lines)).replace("8E16.9", "8D16.9")
    path.write_text(fortran.replace("E16.9", "D16.9") + "\n")
    assert np.array_equal(read_matrix(path, "K").matrix.toarray(), read_array)
    path.write_text("\n".join(lines) + "\n")
    catch_error(lambda: read_matrix(path, "B"), names="begins with B", kind=ValueError)
    replacements = (("2KAA", "4KAA", "KAA.*is no line of"), ("E-01", "X-01", "is no line of"))
    for old_text, new_text, words in replacements:
        path.write_text("\n".join(lines).replace(old_text, new_text))
        catch_error(lambda: read_matrix(path, "K"), names=words, kind=ValueError)
    path.write_text("\n".join(lines[:-8]))
    catch_error(
        lambda: read_matrix(path, "K"), names=r"no whole matrix|is no line of", kind=ValueError
    )


WRITERS = {
    "Abaqus": write_abaqus, "Nastran": write_nastran, "OUTPUT4": write_op4, "Ansys": write_ansys,
    "a table": write_market,
}  # fmt: skip


def with_files(scene: Scene, folder: Path, files: dict[str, str]) -> Scene:
    """Return a scene with its matrices and its model in files of a folder."""
    return scene.replace({f"structure.{key}": str(folder / name) for key, name in files.items()})


@pytest.mark.parametrize("program", WRITERS)
def test_every_format_is_the_same_plate(program: str, folder: Path, scene: Scene) -> None:
    """Frequencies and pairs; of nodes without cells as many, each by itself."""
    changed_scene = with_files(scene, folder, WRITERS[program](folder))
    structure, plate_structure = fc.build_structure(changed_scene), fc.build_structure(scene)
    assert frequencies(structure) == pytest.approx(frequencies(plate_structure), rel=1e-8)
    assert structure.pair_points == pytest.approx(plate_structure.pair_points)
    displacements = np.zeros((1, structure.n_dofs))
    displacements[0, structure.nodes.dofs[[-2, -1], 1]] = -1e-6
    expected_gap = 1e-6 if program == "a table" else 0.5e-6
    assert structure.apply_bt(displacements) == pytest.approx(np.full((1, 2), expected_gap))
    assert (structure.pair_areas is None) == (program == "a table")


def test_modes_of_a_model_without_cells_are_kept(folder: Path, scene: Scene) -> None:
    """By their dofs: there is nothing to draw them on."""
    changed_scene = with_files(scene, folder, write_market(folder))
    run = fc.modes(changed_scene, 3, MPI.COMM_SELF)
    fc.save(run.result, folder / "modes.h5", run.scene)
    stored_modes = fc.load_run(folder / "modes.h5", MPI.COMM_SELF).result
    np.testing.assert_array_equal(stored_modes.shapes, run.result.shapes)


def test_matrices_that_do_not_fit_their_rows(folder: Path, scene: Scene) -> None:
    """Not square, and with other rows than the file of their nodes names."""
    changed_scene = with_files(scene, folder, write_market(folder))
    for rows, columns in ((42, 41), (41, 41)):
        scipy.io.mmwrite(folder / "M.mtx", sparse.eye(rows, columns))
        catch_error(lambda: fc.build_structure(changed_scene), "structure.mass")


def test_rows_of_other_files_follow_the_nodes(folder: Path, scene: Scene) -> None:
    """Rows whose nodes are mixed are put in order, and with them those of a load's file."""
    matrices = plate_matrices()
    node_order = np.random.default_rng(1).permutation(len(matrices["labels"]))
    for kind in "KM":
        scipy.io.mmwrite(
            folder / f"{kind}.mtx", matrices[kind][node_order][:, node_order], precision=17
        )
    rows = [f"{node}.{direction}" for node, direction in matrices["labels"][node_order]]
    (folder / "rows.dof").write_text("\n".join(rows))
    load = np.array([[row == "7.2"] for row in rows], dtype=float)  # node 7: (0, 0.02, 0)
    scipy.io.mmwrite(folder / "force.mtx", sparse.csr_matrix(100.0 * load))
    files = {"stiffness": "K.mtx", "mass": "M.mtx", "dofs": "rows.dof", "force_sin": "force.mtx"}
    changed_scene = with_files(scene, folder, files).replace(
        {"excitation.point": None, "excitation.force_sin": [0.0, 0.0, 0.0]}
    )
    structure, plate_structure = fc.build_structure(changed_scene), fc.build_structure(scene)
    assert frequencies(structure) == pytest.approx(frequencies(plate_structure), rel=1e-9)
    assert structure.dof_name(structure.find_most_loaded_dof()) == plate_structure.dof_name(
        plate_structure.find_most_loaded_dof()
    )


def test_rows_of_calculix_in_another_place(folder: Path, scene: Scene) -> None:
    """They are read from there without a model, too, where a file of dofs is refused with others:
    it would do nothing."""
    plate_structure = fc.build_structure(scene)
    (folder / "plate.dof").rename(folder / "rows.txt")
    scipy.io.mmwrite(folder / "force.mtx", sparse.csr_matrix(plate_structure.force[2][:, None]))
    files = {"dofs": str(folder / "rows.txt"), "force_sin": str(folder / "force.mtx")}
    matrix_settings = {f"structure.{key}": path for key, path in files.items()} | {
        "structure.model": None
    }
    matrix_settings |= {
        "contact": None,
        "excitation.point": None,
        "excitation.force_sin": [0.0, 0.0, 0.0],
    }
    other_structure = fc.build_structure(scene.replace(matrix_settings))
    assert frequencies(other_structure) == pytest.approx(frequencies(plate_structure), rel=1e-9)


def on_ranks_of(text: str, folder: str, comm: MPI.Comm) -> tuple[list[float], float, str]:
    """Frequencies, the sum of B's squares, and what is loaded."""
    structure = fc.build_structure(Scene.from_text(text, folder=Path(folder)), comm)
    omega = fc.solve_modes(structure, 3).omega
    square = comm.allreduce(float(structure.gap.multiply(structure.gap).sum()))
    return omega.tolist(), square, structure.dof_name(structure.watched_dof)


def test_two_ranks_share_the_matrices(on_ranks: Callable[..., Any]) -> None:
    """Whole nodes on each."""
    omega, square, name = on_ranks(on_ranks_of, TEXT, str(FOLDER))
    expected_numbers = on_ranks_of(TEXT, str(FOLDER), MPI.COMM_SELF)
    assert omega == pytest.approx(expected_numbers[0], rel=1e-9)
    assert (square, name) == (pytest.approx(expected_numbers[1]), expected_numbers[2])


SOLID = """
geometry = { kind = "solid", width = 0.03, height = 0.09, thickness = 0.006 }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = [0.0, 0.09, 0.003], force_cos = [0.0, 0.0, 1.0], frequency = 560.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.012, lip_elements = 2, error = false }
"""
CRACKS = {
    "through": {"edge": "left", "length": 0.01},
    "ellipse": {"center": 0.015, "length": 0.016, "depth": 0.003, "front": "elliptical"},
    "corner": {"edge": "left", "length": 0.01, "depth": 0.004, "front": "elliptical"},
    "two": {"edge": "left", "length": 0.01},
}
SECOND = {"edge": "right", "height": 0.06, "length": 0.01}
"""Crack of two."""


@pytest.mark.drawn(2)
@pytest.mark.parametrize("crack", CRACKS)
def test_pairs_of_a_solid_are_its_own(crack: str) -> None:
    """Built by this program and found from its nodes, cells and stiffness: the same patches; pairs
    of nodes hold the lips together as these do."""
    keys = {f"crack.{key}": x for key, x in ({"height": 0.03} | CRACKS[crack]).items()}
    keys |= {f"cracks.1.{key}": x for key, x in SECOND.items() if crack == "two"}
    structure = fc.build_structure(Scene.from_text(SOLID).replace(keys), MPI.COMM_SELF)
    points, dofs = structure.nodes.points, structure.nodes.dofs
    stiffness = csr(structure.stiffness)
    model = ModelFileMesh(np.arange(len(points)), points, {24: structure.nodes.cells})
    gap, pairs = find_gap_matrix_and_pairs(model, dofs, stiffness, has_rotations=False)
    here, there = (np.lexsort(found.round(9).T) for found in (pairs.points, structure.pair_points))
    assert abs(gap[:, here] - structure.gap[:, there]).max() < 1e-12
    assert pairs.areas[here] == pytest.approx(structure.pair_areas[there], rel=1e-12)
    np.testing.assert_array_equal(pairs.cracks[here], structure.pairs.cracks[there])
    assert (
        pairs.positions is not None
        and pairs.places.keys() - structure.watched_pairs.keys() == set()
    )
    for place in pairs.places.values():
        here = pairs.cracks == pairs.cracks[place]
        assert pairs.positions[place] == pytest.approx(pairs.positions[here].max())
    node_order = np.random.default_rng(5).permutation(len(points))  # lower nodes and upper ones
    cells = np.argsort(node_order)[structure.nodes.cells]
    other_pairs = find_gap_matrix_and_pairs(
        ModelFileMesh(model.labels, points[node_order], {24: cells}),
        dofs[node_order],
        stiffness,
        has_rotations=False,
    )[1]
    places = [np.lexsort(found.round(9).T) for found in (pairs.points, other_pairs.points)]
    np.testing.assert_array_equal(pairs.cracks[places[0]], other_pairs.cracks[places[1]])
    nodes, _ = find_gap_matrix_and_pairs(
        ModelFileMesh(model.labels, points, {}), dofs, stiffness, has_rotations=False
    )
    assert nodes.shape[1] > 2 * gap.shape[1]
    tied = [
        fc.solve_modes(
            fc.Structure.from_matrices(structure.mass, structure.stiffness, gap=b), 3, lips="tied"
        ).omega
        for b in (gap, nodes)
    ]
    assert tied[1] == pytest.approx(tied[0], rel=1e-3)
    assert np.all(tied[1] >= tied[0])


# --- cells of every kind --------------------------------------------------------------------------

TURN = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.4], [0.2, -0.5, 1.0]]))[0]
HEXAHEDRON = [
    (0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7),
]  # fmt: skip
TETRAHEDRON = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
WEDGE = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]
SQUARE, TRIANGLE = [(0, 0), (2, 0), (2, 1), (0, 1)], [(0, 0), (2, 0), (0, 1)]
"""Edges of cells as the manuals of Abaqus and VTK number the nodes in their middles, and bases."""


@pytest.mark.parametrize("kind", [12, 25, 13, 26])
def test_lips_of_bricks_and_wedges(kind: int) -> None:
    """One above the other, apart, and turned: the areas are the lips', and no motion as a rigid
    body closes the gap but that of one of them, which does as a whole."""
    base, edges = (SQUARE, HEXAHEDRON) if kind in (12, 25) else (TRIANGLE, WEDGE)
    corners = [(x, y, z) for z in (0.0, 1.0) for x, y in base]
    lower_nodes = np.array(corners)
    if kind in (25, 26):
        lower_nodes = np.concatenate(
            [lower_nodes, [(lower_nodes[i] + lower_nodes[j]) / 2.0 for i, j in edges]]
        )
    n = len(lower_nodes)
    points = np.concatenate([lower_nodes, lower_nodes + (0.0, 0.0, 1.0)]) @ TURN.T
    cells = np.arange(2 * n).reshape(2, n)
    dofs = np.arange(6 * n).reshape(-1, 3)
    joined_matrix = sparse.csr_matrix(np.kron(np.eye(2), np.ones((3 * n, 3 * n))))
    model = ModelFileMesh(np.arange(2 * n), points, {kind: cells})
    gap, pairs = find_gap_matrix_and_pairs(model, dofs, joined_matrix, has_rotations=False)
    area = 2.0 if kind in (12, 25) else 1.0
    assert pairs.areas is not None and len(pairs.areas) == len(base)
    assert pairs.areas.sum() == pytest.approx(area, rel=1e-13)
    along_direction, across_direction = TURN[:, 0], TURN[:, 2]
    both = [np.tile(direction, 2 * n) for direction in (along_direction, across_direction)]
    down = np.where(np.arange(2 * n)[:, None] >= n, -across_direction, 0.0).ravel()
    leaning = down * np.repeat(points @ along_direction, 3)  # further down the farther along
    motions = np.array([*both, down, leaning])
    ends = np.array([point[0] for point in base], dtype=float)
    means = {(0.0, 2.0, 2.0, 0.0): [2 / 3, 4 / 3, 4 / 3, 2 / 3], (0.0, 2.0, 0.0): [0.5, 1.0, 0.5]}
    expected = np.outer([0.0, 0.0, 1.0, 0.0], np.ones(len(base)))
    corners_at = points[len(base) : 2 * len(base)] @ along_direction
    order = np.argmin(np.abs(corners_at - (pairs.points @ along_direction)[:, None]), axis=1)
    expected[3] = np.array(means[tuple(ends)])[order]
    assert (gap.T @ motions.T).T == pytest.approx(expected, abs=1e-13)
    nodes, _ = find_gap_matrix_and_pairs(
        ModelFileMesh(np.arange(2 * n), points, {}), dofs, joined_matrix, has_rotations=False
    )
    assert (nodes.T @ down) == pytest.approx(1.0, abs=1e-13)


CARDS = {  # gmsh's corners; edges in the order of Nastran's nodes in their middles; VTK's edges
    "CTETRA": ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], TETRAHEDRON, TETRAHEDRON),
    "CPENTA": (
        [(x, y, z) for z in (0, 1) for x, y in TRIANGLE],
        [*WEDGE[:3], *WEDGE[6:], *WEDGE[3:6]], WEDGE,
    ),
    "CHEXA": (
        [(x, y, z) for z in (0, 1) for x, y in SQUARE],
        [*HEXAHEDRON[:4], *HEXAHEDRON[8:], *HEXAHEDRON[4:8]], HEXAHEDRON,
    ),
}  # fmt: skip


@pytest.mark.parametrize("card", CARDS)
def test_nodes_of_nastran_in_the_order_of_vtk(card: str, tmp_path: Path) -> None:
    """Edges around the bottom, upright, around the top there; and the upright ones last."""
    corners, theirs, wanted = CARDS[card]
    points = np.array(corners, dtype=float)
    points = np.concatenate([points, [(points[i] + points[j]) / 2.0 for i, j in theirs]])
    lines = [f"GRID,{n},,{x},{y},{z}" for n, (x, y, z) in enumerate(points, 1)]
    fields = [card, "1", "1", *map(str, range(1, len(points) + 1))]
    rows = [fields[:9], *([""] + fields[k : k + 8] for k in range(9, len(fields), 8))]
    (tmp_path / "one.bdf").write_text("\n".join([*lines, *map(",".join, rows)]) + "\n")
    model = read_nodes_and_cells(tmp_path / "one.bdf")
    ((cell,),) = model.cells_by_vtk_type.values()
    model_points = model.points[cell]
    n = len(corners)
    np.testing.assert_allclose(model_points[:n], corners)
    np.testing.assert_allclose(
        model_points[n:], [(model_points[i] + model_points[j]) / 2.0 for i, j in wanted]
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("\n        2        0", "\n        x        0", "line 5: this is not a node"),
        (
            "        8        0        1",
            "        9        0        1",
            "line 28: this is not a node",
        ),
        (
            "1.0000000000000E-02\n",
            f"1.0000000000000E-02{0:21}{0:21}{30:21}\n",
            "line 5: this is not",
        ),
        (
            "        5        4       10",
            "        5        5       10",
            "line 27: this is not a node",
        ),
    ],
    ids=range(4),
)
def test_bad_blocks_of_ansys(tmp_path: Path, old: str, new: str, words: str) -> None:
    """A number that is none; more nodes than a cell has; a node that is turned; a prism that is
    written as a brick."""
    write_ansys(tmp_path)
    path = tmp_path / "plate.cdb"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    catch_error(lambda: read_nodes_and_cells(path), names=words, kind=ValueError)


def test_abaqus_goes_on_in_the_next_line_and_file(tmp_path: Path) -> None:
    """Twenty nodes on two lines, in a file that another one includes; a node of a plane model; and
    what is no solid is left out."""
    points = np.array([(x, y, z) for z in (0, 1) for x, y in SQUARE], dtype=float)
    points = np.concatenate([points, [(points[i] + points[j]) / 2.0 for i, j in HEXAHEDRON]])
    nodes = [f"{n}, {x}, {y}, {z}" for n, (x, y, z) in enumerate(points, 1)]
    cell = ", ".join(map(str, range(16))) + ",\n16, 17, 18, 19, 20"
    (tmp_path / "cells.inc").write_text(
        f"*Element, type=C3D20R\n{cell}\n*Element, type=S4\n1,1,2,3,4\n"
    )
    text = [
        "*Heading",
        " text, of any kind",
        "** a comment",
        "*Node, nset=ALL",
        *nodes,
        "30, 1., 2.",
    ]
    (tmp_path / "all.inp").write_text("\n".join([*text, "*Include, input=cells.inc"]) + "\n")
    model = read_nodes_and_cells(tmp_path / "all.inp")
    assert list(model.cells_by_vtk_type) == [25]
    np.testing.assert_array_equal(model.cells_by_vtk_type[25], [range(20)])
    np.testing.assert_array_equal(model.points[-1], [1.0, 2.0, 0.0])


ASKED = "is not read; write out all nodes and elements"
NOT_READ: list[tuple[str, str, str]] = [
    ("all.inp", "*Node, system=C\n1, 1, 90, 0\n", rf"\*NODE {ASKED}"),
    ("all.inp", "*Instance, name=A, part=B\n0., 0.1, 0.\n", rf"\*INSTANCE {ASKED}"),
    ("all.inp", "*Node\n1,0,0,0\n*Include, input=all.inp\n", "its files include each other"),
    ("all.bdf", "GRID,1,,0.,0.,0.\nINCLUDE 'more.bdf'\n", "line 2: INCLUDE: nodes and elements"),
    ("all.bdf", "GRDSET,,5\nGRID,1,,0.,0.,0.\n", "GRDSET: nodes and elements must be in this file"),
    ("all.csv", "1,0,0,0\n2.5,0,0,0\n", "row 2: 2.5 is not a node number"),
]


@pytest.mark.parametrize(("name", "text", "words"), NOT_READ, ids=range(len(NOT_READ)))
def test_what_would_be_misread_is_refused(name: str, text: str, words: str, tmp_path: Path) -> None:
    """Cylindrical coordinates, an instance that is moved, files that include themselves or are
    included by Nastran, coordinate systems by default, a node of half a number."""
    (tmp_path / name).write_text(text)
    catch_error(lambda: read_nodes_and_cells(tmp_path / name), names=words, kind=ValueError)


def test_blanks_and_instances_of_abaqus(tmp_path: Path) -> None:
    """Around the sign of equality; an instance that is where its part is."""
    text = (FOLDER / "plate.inp").read_text()
    kind = re.search(r"(?i)type=C3D8\w*", text)
    words = f"type = {kind[0][5:]}"
    (tmp_path / "all.inp").write_text(
        f"*Instance, name=A, part=B\n0., 0., 0.\n{text.replace(kind[0], words)}"
    )
    model, expected_model = (
        read_nodes_and_cells(tmp_path / "all.inp"),
        read_nodes_and_cells(FOLDER / "plate.inp"),
    )
    np.testing.assert_array_equal(model.cells_by_vtk_type[12], expected_model.cells_by_vtk_type[12])


def test_surfaces_of_ansys_are_no_solids(tmp_path: Path) -> None:
    """SURF154 of four nodes in the block of the solids, each with the number of its type."""
    write_ansys(tmp_path)
    path = tmp_path / "plate.cdb"
    expected_model = read_nodes_and_cells(path)
    label = expected_model.labels[expected_model.cells_by_vtk_type[12][0, :4]].tolist()
    surface = "".join(f"{x:9}" for x in [1, 2, 1, 1, 0, 0, 0, 0, 4, 0, 99, *label])
    text = path.read_text().replace("/PREP7", "/PREP7\nET,1,185\nET, 2, SURF154")
    path.write_text(text.replace(f"{-1:9}\nFINISH", f"{surface}\n{-1:9}\nFINISH"))
    model = read_nodes_and_cells(path)
    assert list(model.cells_by_vtk_type) == [12]
    np.testing.assert_array_equal(model.cells_by_vtk_type[12], expected_model.cells_by_vtk_type[12])
    path.write_text(path.read_text().replace("ET,1,185", "ET,1,SHELL181"))
    catch_error(lambda: read_nodes_and_cells(path), names=r"types 154, 181\)", kind=ValueError)


def test_results_belong_to_all_their_files(folder: Path, scene: Scene) -> None:
    """Also to the rows beside the stiffness, and to what the model includes."""
    shutil.move(folder / "plate.inp", folder / "nodes.inc")
    (folder / "plate.inp").write_text("*INCLUDE, INPUT=nodes.inc\n")
    run = fc.modes(scene, 3, MPI.COMM_SELF)
    fc.save(run.result, folder / "modes.h5", run.scene)
    fc.load_run(folder / "modes.h5", MPI.COMM_SELF)
    for name, key in (("plate.dof", "structure.mass"), ("nodes.inc", "structure.model")):
        text = (folder / name).read_text()
        (folder / name).write_text(text + "\n")
        catch_error(
            partial(fc.load_run, folder / "modes.h5", MPI.COMM_SELF), key, str(folder / name)
        )
        (folder / name).write_text(text)


@pytest.mark.parametrize(
    "name", [pytest.param("breathing_plate", marks=pytest.mark.nightly), "inclined_crack"]
)
def test_pairs_of_a_plane_model_are_the_plates(name: str) -> None:
    """Of nodes: the plate's own B, whatever the direction of its crack."""
    structure = fc.build_structure(Scene.load(DEMOS / f"{name}.toml"), MPI.COMM_SELF)
    points, dofs = (np.pad(x, ((0, 0), (0, 1)), constant_values=fill) for x, fill in (
        (structure.nodes.points, 0.0), (structure.nodes.dofs, -1)))  # fmt: skip
    model = ModelFileMesh(np.arange(len(points)), points, {})
    gap, pairs = find_gap_matrix_and_pairs(
        model, dofs, csr(structure.stiffness), has_rotations=False
    )
    assert pairs.points is not None and pairs.areas is None
    pair_order, structure_order = (
        np.lexsort(found[:, :2].round(9).T) for found in (pairs.points, structure.pair_points)
    )
    assert abs(gap[:, pair_order] - structure.gap[:, structure_order]).max() < 1e-9


def test_cracks_that_cross_are_refused() -> None:
    """Three nodes in one place."""
    points = np.array([[0.0, 0.0, 0.0]] * 3 + [[1.0, 0.0, 0.0]])
    catch_error(
        lambda: find_gap_matrix_and_pairs(
            ModelFileMesh(np.arange(4), points, {}),
            np.arange(12).reshape(-1, 3),
            sparse.identity(12, format="csr"),
            has_rotations=False,
        ),
        "model",
        names="more than two nodes at",
    )


# --- what is refused ------------------------------------------------------------------------------

BAD: list[tuple[str, str, str, str | None]] = [
    ("plate.sti", "\n3 3 ", "\n3 x ", r"line \d+: '3 x"),
    ("plate.sti", "\n1 2 ", "\n1 99 ", "line 2: .* 42 rows"),
    ("plate.mas", "\n42 42 ", "\n41 42 ", "row 42 of 42 "),
    ("plate.dof", "4.2", "4.2.7", r"plate\.dof, line \d+: '4\.2\.7'"),
    ("plate.inp", "\n3, 0.02", "\n3, zero", r"plate\.inp, line 4: '3, zero"),
    ("plate.inp", "\n3, 0.02", "\n2, 0.02", "line 4: .* node 2"),
    ("plate.inp", "\n3, 0.02", "\n3, nan", "line 4: .* node 3"),
    ("plate.dof", "4.2", "99999999999999999999.2", None),
    ("plate.inp", "*ELEMENT", "*NGEN\n1,2\n*ELEMENT", r"line 22: \*NGEN"),
    ("plate.inp", "1, 1, 2,", "1, 77, 2,", "node 77,"),
    ("plate.inp", "19, 0, 0.01, 0\n", "19, 0, 0.011, 0\n", ""),
    ("plate.inp", "\n*NODE", "\n*NOTE", None),
    ("plate.sti", "\n1 2 ", "\n2 1 0.0\n1 2 ", "row 2, column 1 "),
]
KEYS_BY_FILE = {
    "plate.sti": "stiffness", "plate.mas": "mass", "plate.dof": "mass", "plate.inp": "model",
}  # fmt: skip


@pytest.mark.parametrize(("file", "old", "new", "names"), BAD, ids=range(len(BAD)))
def test_bad_files_are_named(
    folder: Path, scene: Scene, file: str, old: str, new: str, names: str | None
) -> None:
    """By the key, the file and, where there is one, the line."""
    text = "\n" + (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1).removeprefix("\n"))
    if names == "":  # one node fewer in two places
        assert fc.build_structure(scene).n_pairs == 1
        return
    path = str(folder / file.replace(".dof", ".mas"))
    catch_error(
        lambda: fc.build_structure(scene), f"structure.{KEYS_BY_FILE[file]}", path, names=names
    )


KEYS: list[tuple[dict[str, Any], str]] = [
    ({"excitation.point": None}, "excitation.point"),
    ({"excitation.point": [0.0, 0.02]}, "excitation.point"),
    ({"excitation.point": [0.0, 0.0, 0.0]}, "excitation.point"),
    ({"excitation.point": [0.0, 0.01, 0.0]}, "excitation.point"),
    ({"excitation.point": [0.0, 0.3, 0.0]}, "excitation.point"),
    ({"structure.model": None}, "structure.force_sin"),
    ({"structure.model": "plate.dat"}, "structure.model"),
    ({"structure.dofs": "plate.inp"}, "structure.mass"),
]


@pytest.mark.parametrize(("changes", "key"), KEYS, ids=range(len(KEYS)))
def test_bad_keys_are_named(folder: Path, scene: Scene, changes: dict[str, Any], key: str) -> None:
    settings = {k: str(folder / v) if isinstance(v, str) else v for k, v in changes.items()}
    catch_error(lambda: fc.build_structure(scene.replace(settings)), key, settings.get(key, ...))


@pytest.mark.parametrize(
    ("key", "old", "new", "names"),
    [
        ("mass", "       6       2", "       6       4", "line 623: .* DMIG"),
        ("mass", "DMIG*   MAAX", "DMIG*   NAAX", "DMIG .* M[)]"),
        ("mass", "D+", "X+", r"line 62\d: "),
        ("stiffness", "DMIG    MAAX", "DMIG    KBBX", "line 623: KBBX is .* K[)]"),
    ],
    ids=range(4),
)
def test_bad_punch_files_are_named(
    folder: Path, scene: Scene, key: str, old: str, new: str, names: str
) -> None:
    changed_scene = with_files(scene, folder, write_nastran(folder))
    path = folder / "plate.pch"
    path.write_text(path.read_text().replace(old, new))
    catch_error(
        lambda: fc.build_structure(changed_scene), f"structure.{key}", str(path), names=names
    )


def test_stiffness_and_mass_that_are_swapped(scene: Scene) -> None:
    """As the endings of CalculiX tell."""
    paths = {"structure.mass": str(FOLDER / "plate.sti")}
    catch_error(
        lambda: fc.build_structure(scene.replace(paths)),
        "structure.mass",
        paths["structure.mass"],
        names="CalculiX",
    )


def test_a_model_in_small_units_is_remarked(folder: Path, run_command: RunCommand) -> None:
    """As a mesh file is."""
    path = folder / "plate.inp"
    heading, *nodes = path.read_text().partition("*ELEMENT")[0].splitlines()
    rows = [[float(word) for word in line.split(",")] for line in nodes]
    lines = [f"{int(n)}, {1e4 * x}, {1e4 * y}, {1e4 * z}" for n, x, y, z in rows]
    rest = path.read_text().partition("*ELEMENT")[2]
    path.write_text("\n".join([heading, *lines, f"*ELEMENT{rest}"]))
    words = ["--set", "excitation.point=[0.0,200.0,0.0]"]
    assert "is the mesh in mm?" in run_command("check", folder / "scene.toml", *words).err


def test_rows_without_mass_are_named(folder: Path, scene: Scene) -> None:
    """As of lumped rotations."""
    path = folder / "plate.mas"
    path.write_text(re.sub(r"(?m)^5 5 .*$", "5 5 0.0", path.read_text()))
    row = (folder / "plate.dof").read_text().split()[4].replace(".", ", direction ")
    catch_error(
        lambda: fc.build_structure(scene), "structure.mass", names=rf"no mass at node {row}\)"
    )


def test_a_model_of_another_mesh(folder: Path, scene: Scene) -> None:
    """It lacks a node that has rows."""
    changed_scene = with_files(scene, folder, write_market(folder))
    nodes = (folder / "nodes.csv").read_text().splitlines()
    (folder / "nodes.csv").write_text("\n".join(row for row in nodes if not row.startswith("7,")))
    catch_error(
        lambda: fc.build_structure(changed_scene), "structure.model", names="node 7 is missing"
    )


def test_a_model_without_a_crack_is_told(folder: Path, scene: Scene) -> None:
    """Where there is contact; without it, it is what it is."""
    path = folder / "plate.inp"
    path.write_text(path.read_text().replace("19, 0, 0.01", "19, 0, 0.012").replace(
        "20, 0, 0.01", "20, 0, 0.012"))  # fmt: skip
    catch_error(lambda: fc.build_structure(scene), "structure.model", names="0 pairs of nodes")
    assert fc.build_structure(scene.replace({"contact": None})).n_pairs == 0
