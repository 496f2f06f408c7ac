"""What a scene needs is stated before it is spent."""

from __future__ import annotations

import functools
import gc
import resource
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sparse
from mpi4py import MPI
from petsc4py import PETSc

import fenics_crack as fc
from fenics_crack import Scene
from fenics_crack.fem import plate
from fenics_crack.model import memory
from fenics_crack.model.factor import Factor, distributed
from fenics_crack.model.memory import reduction_memory, whole_memory
from fenics_crack.study import prepare


def test_what_does_not_fit_is_refused(
    paper_scene: fc.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before it is reduced, with what it needs; and before it is meshed."""
    scene = paper_scene.replace({"mesh.columns": 8, "mesh.rows": 8})
    monkeypatch.setattr(prepare, "machine_memory", lambda: 1e7)
    with pytest.raises(fc.InputError, match=r"^mesh.columns = 8: .* coarser .* GiB"):
        prepare.prepare(scene, MPI.COMM_SELF)
    assert prepare.prepare(scene, MPI.COMM_SELF, whole=True).structure.n_dofs == 152
    monkeypatch.setattr(plate, "machine_memory", lambda: 1e5)
    with pytest.raises(fc.InputError, match=r"^mesh.columns = 8: .* fewer cells: .* GiB"):
        fc.build_structure(scene, MPI.COMM_SELF)


def test_more_modes_and_harmonics_need_more(wide_plate: fc.Structure) -> None:
    """Krylov vectors and shapes; a factor for each harmonic."""
    few = reduction_memory(wide_plate, 10, "massless")
    assert few < reduction_memory(wide_plate, 100, "massless")
    assert whole_memory(wide_plate, 5) < whole_memory(wide_plate, 50)


def test_parts_of_what_a_solid_needs() -> None:
    """A factor of a cube's stiffness and one of a plate's are within a factor of two of what is
    said, a matrix is what it holds, and memory that is freed does not count."""
    for thickness in (0.03, 0.004):
        sides = {"width": 0.03, "height": 0.03, "thickness": thickness}
        solid = Scene.from_mapping(
            {
                "geometry": {"kind": "solid"} | sides,
                "material": {"young": 2.1e11, "poisson": 0.3, "density": 7850.0},
                "damping": {"ratio": 0.01},
                "excitation": {"omega": 100.0},
                "loads": [{"edge": "front", "pressure_cos": 100.0}],
                "mesh": {"layout": "graded", "order": 2, "size": 0.005, "error": False},
            }
        )
        structure = fc.build_structure(solid, MPI.COMM_SELF)
        with Factor(structure.stiffness) as factor:
            entries = int(factor._factor.getMumpsInfog(9))
        assert 0.5 < memory._factor(structure) / (8.0 * entries) < 2.0
        _, columns, values = structure.stiffness.getValuesCSR()
        assert memory._matrix(structure) == columns.nbytes + values.nbytes
    before = memory._held(structure)
    pieces = [np.ones(10_000) for _ in range(1000)]
    assert memory._held(structure) > before + 7e7
    del pieces
    assert memory._held(structure) < before + 1e7


def ordered_by(sides: int, dimension: int, dofs: int) -> int:
    """How MUMPS has ordered the rows of so many nodes a side, each with ``dofs`` unknowns and
    coupled to all that are next to it."""
    line = sparse.diags([-1.0, 2.5, -1.0], [-1, 0, 1], (sides, sides))
    nodes = functools.reduce(sparse.kron, [line] * dimension)
    matrix = distributed(sparse.kron(nodes, np.eye(dofs) + 0.1), MPI.COMM_SELF)
    with Factor(matrix) as factor:
        return int(factor._factor.getMumpsInfog(7))


def test_rows_are_ordered_for_their_dimension() -> None:
    """A plane's for least fill, a solid's as MUMPS chooses for so many, both as a user says."""
    least_fill, degree = 2, 0
    assert ordered_by(75, 2, 2) == least_fill != ordered_by(18, 3, 2)
    options = PETSc.Options("crack_factor_")
    options["mat_mumps_icntl_7"] = degree
    try:
        assert ordered_by(75, 2, 2) == ordered_by(18, 3, 2) == degree
    finally:
        options.delValue("mat_mumps_icntl_7")
    assert ordered_by(75, 2, 2) == least_fill


def test_what_was_prepared_is_given_back(paper_scene: fc.Scene) -> None:
    """Matrices, factors and communicators of a scene are freed by the next ones: below 0.2 MiB."""
    scene = paper_scene.replace({"mesh.columns": 30, "mesh.rows": 30, "damping.modes": 6})
    sizes = []
    for _ in range(25):
        fc.prepare(scene, MPI.COMM_SELF)
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        sizes.append(pages * resource.getpagesize() / 2**20)
    assert (sizes[-1] - sizes[9]) / 15 < 0.2
