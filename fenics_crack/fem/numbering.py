"""Which dofs of a function space are free, and their numbers in the structure."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.fem import compat
from fenics_crack.fem.compat import dolfinx
from fenics_crack.fem.plate import PlateMesh
from fenics_crack.model.nodes import Nodes

__all__ = ["Dofs"]


class Dofs:
    """Free dofs of a mesh's function space, and their numbers in the structure."""

    def __init__(self, plate: PlateMesh, space: Any, comm: MPI.Comm) -> None:
        self.comm = comm
        self.plate = plate
        self.space = space
        self.dimension = space.mesh.geometry.dim
        self.n_nodes = space.dofmap.index_map.size_local
        self.first_node = space.dofmap.index_map.local_range[0]
        clamped = self.nodes_on("clamp")
        free = np.ones((self.n_nodes, self.dimension), dtype=bool)
        free[clamped[clamped < self.n_nodes]] = False
        self.free = np.flatnonzero(free.ravel())
        """Owned free dofs, local numbers of the function space."""
        first = self.comm.exscan(len(self.free)) or 0
        self.numbers = np.full(free.size, -1)
        """Number in the structure of each owned dof of the space, -1 where clamped."""
        self.numbers[self.free] = first + np.arange(len(self.free))

    @property
    def points(self) -> np.ndarray:
        """Positions of this rank's nodes: (n_nodes, d) [m]."""
        points = self.space.tabulate_dof_coordinates()[: self.n_nodes, : self.dimension]
        return np.asarray(points)

    def nodes_on(self, group: str, space: Any = None) -> np.ndarray:
        """Local numbers, ghosts included, of the nodes in a facet group; of another space's, if
        one is given."""
        facets, topology = self.plate.facets(group), self.plate.mesh.topology
        dimension = topology.dim - 1
        topology.create_connectivity(dimension, dimension + 1)
        space = self.space if space is None else space
        return np.sort(dolfinx.fem.locate_dofs_topological(space, dimension, facets))

    def free_block(self, matrix: Any) -> Any:
        """Leave the clamped rows and columns out of a matrix, which is destroyed.

        What is left belongs to the caller's communicator: PETSc keeps what Python has let go for
        each communicator, and nobody could free it on that of a mesh which is gone.
        """
        free = (self.dimension * self.first_node + self.free).astype(PETSc.IntType)
        rows = PETSc.IS().createGeneral(free, comm=matrix.comm)
        block = matrix.createSubMatrix(rows, rows)
        found = PETSc.Mat().createAIJ(block.sizes, csr=block.getValuesCSR(), comm=self.comm)
        for used in (rows, block, matrix):
            used.destroy()
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
        )
