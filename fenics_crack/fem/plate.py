"""Meshes of cracked plates and solids, made or read by gmsh and distributed by DOLFINx.

A crack is a slit: its two faces are different curves, or surfaces, in the same place that share
only the tips, so that every node on a crack face but a tip exists twice. gmsh runs on rank 0 only.
Nodes that are clamped have no dofs in the structure (:class:`Dofs`).
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.atomic_files import whole_file
from fenics_crack.basics.gmsh_process import gmsh, kept_interrupts
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.untrusted_files import content_of
from fenics_crack.fem import compat
from fenics_crack.fem.blocks import draw_plate
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.cracks import Cracks, NamedParts
from fenics_crack.fem.solid import draw_solid
from fenics_crack.model.nodes import Nodes
from fenics_crack.scene.scene import Scene


@dataclass(frozen=True)
class PlateMesh:
    """A distributed mesh and where its named parts are.

    Attributes
    ----------
    mesh, facet_tags : dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags
        The plate, and the tags of its facets.
    groups : dict of str to tuple of int
        Facet tags of the named curves: ``clamp``, with a crack ``lower_lip`` and ``upper_lip``; of
        a plate made here ``left``, ``right``, ``top`` and ``bottom``, of a mesh file all that it
        names. A facet in several curves has a tag of its own.
    points : dict of str to tuple of float
        Positions of the named points of a mesh file [m].
    cracks : tuple of CrackPath or of CrackSurface
        One for each crack, in the order of the scene or, in a mesh file, from bottom to top.
    """

    mesh: Any
    facet_tags: Any
    groups: dict[str, tuple[int, ...]]
    points: dict[str, tuple[float, ...]]
    cracks: Cracks

    @property
    def has_cracks(self) -> bool:
        """True if there are crack faces."""
        return "lower_lip" in self.groups

    def facets(self, group: str) -> np.ndarray:
        """This rank's facets of a named curve."""
        return np.sort(np.concatenate([self.facet_tags.find(tag) for tag in self.groups[group]]))

    def measure_on(self, *groups: str) -> Any:
        """The measure ds of integrals over named curves."""
        tags = tuple(tag for group in groups for tag in self.groups[group])
        return ufl.ds(domain=self.mesh, subdomain_data=self.facet_tags)(tags)


def build_mesh(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> PlateMesh:
    """Mesh the scene's plate or solid, or read its mesh file (collective).

    Raises
    ------
    InputError
        The mesh file cannot be read, is not a plane mesh of one kind of cells, or lacks a group.
    """
    with _gmsh_on_root(comm):
        (groups, points), lips = on_root(comm, lambda: _model(scene))
        mesh, _, facet_tags = compat.model_to_mesh(gmsh.model, comm, scene.dimension)
    return PlateMesh(mesh, facet_tags, groups, points, lips)


def write_msh(scene: Scene, path: str | Path) -> None:
    """Write the mesh of a scene, with its named groups, to a gmsh file (format 4.1).

    Parameters
    ----------
    scene : Scene
        With a plate.
    path : path
        The file.

    Raises
    ------
    InputError
        The file cannot be written.

    Examples
    --------
    >>> fc.write_msh(scene, "plate.msh")
    """
    with _gmsh_on_root(MPI.COMM_SELF):
        _model(scene)
        with whole_file(path) as partial:
            gmsh.write(str(partial))
            if not content_of(partial, None).endswith(b"$EndElements\n"):  # gmsh does not ask
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def _gmsh_on_root(comm: MPI.Comm) -> Iterator[None]:
    if comm.rank != 0:
        yield
        return
    with kept_interrupts():
        started = not compat.gmsh_is_running()
        if started:
            gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask, nobody may be there
        gmsh.model.add("fenics_crack")
        try:
            yield
        finally:
            gmsh.model.remove()
            if started:
                gmsh.finalize()


def _model(scene: Scene) -> tuple[NamedParts, Cracks]:
    """Fill the current gmsh model with a mesh; return what is in it by its name, and the crack
    faces."""
    if scene.mesh.layout == "file":
        from fenics_crack.fem.msh_file import read_mesh_file  # with what checks meshes of others

        found = read_mesh_file(Path(str(scene.mesh.file)), scene.dimension)
    else:
        found = draw_plate(scene) if scene.dimension == 2 else draw_solid(scene)
    gmsh.model.mesh.renumberNodes()
    return found


# --- its dofs -------------------------------------------------------------------------------------


class Dofs:
    """Free dofs of a mesh's function space, and their numbers in the structure.

    Of a sector the nodes of the right side have their displacements in the frame of the next one,
    whose left side has the same.
    """

    sides: np.ndarray | None = None
    """Nodes of the left side of a sector, and those of the right one in the same order: (2, m)."""
    frames: np.ndarray | None = None
    """Of each node the matrix that turns its displacements into those in space: (n_nodes, d, d)."""
    _rotation: sparse.csr_matrix | None = None

    def __init__(
        self, plate: PlateMesh, space: Any, comm: MPI.Comm, held: np.ndarray | None = None
    ) -> None:
        """Take which of this rank's dofs are held, (n_dofs,) bool; None: those at the clamp."""
        self.comm, self.plate, self.space = comm, plate, space
        self.dimension = space.mesh.geometry.dim
        self.n_nodes = space.dofmap.index_map.size_local
        self.first_node = space.dofmap.index_map.local_range[0]
        if held is None:
            held = np.zeros((self.n_nodes, self.dimension), dtype=bool)
            held[self.nodes_on("clamp")] = True
        self.free_dofs = np.flatnonzero(~held.ravel())
        """Owned free dofs, local numbers of the function space."""
        first = self.comm.exscan(len(self.free_dofs)) or 0
        self.numbers = np.full(held.size, -1)
        """Number in the structure of each owned dof of the space, -1 where clamped."""
        self.numbers[self.free_dofs] = first + np.arange(len(self.free_dofs))

    @property
    def points(self) -> np.ndarray:
        """Positions of this rank's nodes: (n_nodes, d) [m]."""
        return np.asarray(self.space.tabulate_dof_coordinates()[: self.n_nodes, : self.dimension])

    def nodes_on(self, group: str, space: Any = None) -> np.ndarray:
        """Local numbers of the nodes of this rank in a facet group; of another space's, if one is
        given."""
        facets, topology = self.plate.facets(group), self.plate.mesh.topology
        dimension = topology.dim - 1
        topology.create_connectivity(dimension, dimension + 1)
        space = self.space if space is None else space
        nodes = np.sort(dolfinx.fem.locate_dofs_topological(space, dimension, facets))
        return nodes[nodes < space.dofmap.index_map.size_local]

    def set_sector_sides(self, sides: np.ndarray, turn: np.ndarray) -> None:
        """Turn what is assembled afterwards at the right side of a sector, on one rank."""
        self.sides, self.frames = sides, np.tile(np.eye(self.dimension), (self.n_nodes, 1, 1))
        self.frames[sides[1]] = turn
        each = np.arange(self.n_nodes + 1)
        whole = sparse.bsr_matrix((self.frames, each[:-1], each)).tocsr()
        self._rotation = whole[self.free_dofs][:, self.free_dofs]
        self._rotation.eliminate_zeros()

    def free_part(self, rows: np.ndarray) -> np.ndarray:
        """Forces (..., n_dofs) on the free dofs: (..., n_local)."""
        free = rows[..., self.free_dofs]
        return free if self._rotation is None else np.asarray(free @ self._rotation)

    def free_block(self, matrix: Any) -> Any:
        """Leave the clamped rows and columns out of a matrix, which is destroyed, and what is zero,
        as masses between directions are: products with M then take half the time, or a third.

        What is left belongs to the caller's communicator: PETSc keeps what Python has let go for
        each communicator, and nobody could free it on that of a mesh which is gone.
        """
        free = (self.dimension * self.first_node + self.free_dofs).astype(PETSc.IntType)
        rows = PETSc.IS().createGeneral(free, comm=matrix.comm)
        block = matrix.createSubMatrix(rows, rows)
        rows_here = sparse.csr_matrix(block.getValuesCSR()[::-1], block.sizes[0])
        if self._rotation is not None:
            rows_here = sparse.csr_matrix(self._rotation.T @ rows_here @ self._rotation)
        rows_here.eliminate_zeros()
        csr = rows_here.indptr, rows_here.indices, rows_here.data
        found = PETSc.Mat().createAIJ(block.sizes, csr=csr, comm=self.comm)
        for used in (rows, block, matrix):
            used.destroy()
        return found

    def function(self, displacement: np.ndarray) -> Any:
        """DOLFINx's Function of a displacement of the free dofs (n_local,), zero where clamped
        (collective)."""
        found = dolfinx.fem.Function(self.space)
        turned = displacement if self._rotation is None else self._rotation @ displacement
        found.x.array[self.free_dofs] = turned
        found.x.scatter_forward()
        return found

    def nodes(self) -> Nodes:
        """Positions, numbers and cells for look-ups and pictures."""
        cells, vtk_type = compat.vtk_cells(self.space)
        numbers = self.space.dofmap.index_map.local_to_global(cells.ravel().astype(np.int32))
        return Nodes(
            points=self.points.copy(),
            dofs=self.numbers.reshape(-1, self.dimension),
            cells=np.asarray(numbers).reshape(cells.shape),
            vtk_type=max(self.comm.allgather(vtk_type)),
            numbered=self,
            frames=self.frames,
        )
