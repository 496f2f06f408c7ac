"""Make or read meshes of cracked plates and solids, and distribute them.

gmsh makes or reads a mesh on rank 0, and DOLFINx distributes it. A crack is a slit: its faces are
two curves, or surfaces, at the same position, and share only the tips or fronts. So every node on a
crack face exists twice, except those of tips and fronts. Clamped nodes have no dofs in the
structure (:class:`Dofs`).
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

from fenics_crack.basics.atomic_files import partial_file
from fenics_crack.basics.gmsh_process import gmsh, keep_interrupt_handler
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.untrusted_files import read_regular_file
from fenics_crack.fem import compat
from fenics_crack.fem.blocks import mesh_plate
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.cracks import Cracks, NamedParts
from fenics_crack.fem.solid import mesh_solid
from fenics_crack.model.nodes import Nodes
from fenics_crack.scene.scene import Scene


@dataclass(frozen=True)
class MeshWithNamedParts:
    """Distributed mesh of a plate or solid, with named curves, surfaces and points.

    Attributes
    ----------
    mesh, facet_tags : dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags
        Mesh, and facet tags; None without tags.
    tags_by_group : dict of str to tuple of int
        Facet tags of each named curve or surface: ``clamp``, and with a crack ``lower_lip`` and
        ``upper_lip``, the crack faces. A meshed plate also has ``left``, ``right``, ``top`` and
        ``bottom``; a mesh file may have any names. Each combination of names has a tag.
    position_by_point_name : dict of str to tuple of float
        Positions of the named points in a mesh file [m].
    crack_paths_or_surfaces : tuple of CrackPath or of CrackSurface
        Cracks in the scene's order; for a mesh file, from bottom to top.
    """

    mesh: Any
    facet_tags: Any
    tags_by_group: dict[str, tuple[int, ...]]
    position_by_point_name: dict[str, tuple[float, ...]]
    crack_paths_or_surfaces: Cracks

    @property
    def has_cracks(self) -> bool:
        """Return True if the mesh has crack faces."""
        return "lower_lip" in self.tags_by_group

    def facets(self, group_name: str) -> np.ndarray:
        """Return the local numbers of this rank's facets on a named curve or surface: (n,) int."""
        return np.sort(
            np.concatenate([self.facet_tags.find(tag) for tag in self.tags_by_group[group_name]])
        )

    def measure_on(self, *group_names: str) -> Any:
        """Return the UFL measure ds for integrals over named curves or surfaces together.

        ``group_names`` are keys of ``tags_by_group``, as "clamp".
        """
        facet_tags = tuple(
            tag for group_name in group_names for tag in self.tags_by_group[group_name]
        )
        return ufl.ds(domain=self.mesh, subdomain_data=self.facet_tags)(facet_tags)


def build_plate_or_solid_mesh(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> MeshWithNamedParts:
    """Mesh the scene's plate or solid, or read its mesh file (collective).

    Raises
    ------
    InputError
        The mesh file cannot be read, has several kinds of cells, or lacks a group. Or gmsh cannot
        mesh the scene.
    """
    with _gmsh_on_root_context(comm):
        (facet_tags_by_group, position_by_point_name), crack_paths_or_surfaces = on_root(
            comm, lambda: _mesh_or_read_scene_into_gmsh(scene)
        )
        mesh, _, facet_tags = compat.model_to_mesh(gmsh.model, comm, scene.dimension)
    return MeshWithNamedParts(
        mesh, facet_tags, facet_tags_by_group, position_by_point_name, crack_paths_or_surfaces
    )


def write_msh(scene: Scene, path: str | Path) -> None:
    """Mesh a scene and write the mesh with named groups to a gmsh file.

    Parameters
    ----------
    scene : Scene
        Scene with a plate or solid.
    path : path
        File to write, in gmsh's format 4.1; an earlier file is replaced.

    Raises
    ------
    InputError
        The file cannot be written.

    Examples
    --------
    >>> fc.write_msh(scene, "plate.msh")
    """
    with _gmsh_on_root_context(MPI.COMM_SELF):
        _mesh_or_read_scene_into_gmsh(scene)
        with partial_file(path) as partial_path:
            gmsh.write(str(partial_path))
            if not read_regular_file(partial_path, None).endswith(
                b"$EndElements\n"
            ):  # gmsh ignores a full disk
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def _gmsh_on_root_context(comm: MPI.Comm) -> Iterator[None]:
    """Run gmsh with an empty model on rank 0, and remove the model at the end.

    gmsh is also stopped at the end, unless gmsh was running before. Other ranks of ``comm`` do
    nothing.
    """
    if comm.rank != 0:
        yield
        return
    with keep_interrupt_handler():
        must_start_gmsh = not compat.gmsh_is_running()
        if must_start_gmsh:
            gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask, nobody may be there
        gmsh.model.add("fenics_crack")
        try:
            yield
        finally:
            gmsh.model.remove()
            if must_start_gmsh:
                gmsh.finalize()


def _mesh_or_read_scene_into_gmsh(scene: Scene) -> tuple[NamedParts, Cracks]:
    """Mesh a scene, or read the scene's mesh file, into gmsh's current model.

    Returns
    -------
    NamedParts
        gmsh's group tags for named curves or surfaces, and positions of named points.
    Cracks
        Cracks in the scene's order; for a mesh file, from bottom to top.
    """
    if scene.mesh.layout == "file":
        from fenics_crack.fem.msh_file import read_mesh_into_gmsh  # only mesh files need its checks

        named_groups_and_cracks = read_mesh_into_gmsh(Path(str(scene.mesh.file)), scene.dimension)
    else:
        named_groups_and_cracks = mesh_plate(scene) if scene.dimension == 2 else mesh_solid(scene)
    gmsh.model.mesh.renumberNodes()
    return named_groups_and_cracks


# --- dofs -----------------------------------------------------------------------------------------


class Dofs:
    """Free dofs of a mesh, with the numbers in the structure.

    In a disk sector (:meth:`set_sector_sides`), the right side is the next sector's left side. So
    dofs on the right side are components along the next sector's axes. If all sectors move equally,
    both sides have equal dofs.
    """

    sector_side_node_pairs: np.ndarray | None = None
    """Nodes on a disk sector's left side, and the matching nodes on the right side: (2, m) int.
    None without a sector."""
    frame_to_space_rotation_by_node: np.ndarray | None = None
    """Rotation from each node's frame into space: (n_nodes, d, d). None without a sector."""
    _frame_to_space_rotation_of_dofs: sparse.csr_matrix | None = None
    """Rotation of the free dofs from the nodes' frames into space: (n_local, n_local), or None."""

    def __init__(
        self,
        part_mesh: MeshWithNamedParts,
        space: Any,
        comm: MPI.Comm,
        is_constrained: np.ndarray | None = None,
    ) -> None:
        """Number the free dofs of all ranks (collective).

        ``is_constrained`` (n_dofs,) is True for this rank's dofs held at zero. Default: all dofs at
        nodes on the clamp.
        """
        self.comm, self.part_mesh, self.space = comm, part_mesh, space
        self.dimension = space.mesh.geometry.dim
        self.n_nodes_owned_by_rank = space.dofmap.index_map.size_local
        self.first_node = space.dofmap.index_map.local_range[0]
        if is_constrained is None:
            is_constrained = np.zeros((self.n_nodes_owned_by_rank, self.dimension), dtype=bool)
            is_constrained[self.nodes_on("clamp")] = True
        self.free_dofs = np.flatnonzero(~is_constrained.ravel())
        """Owned free dofs, as local numbers of the function space."""
        first_free_dof_number = self.comm.exscan(len(self.free_dofs)) or 0
        self.structure_dof_numbers = np.full(is_constrained.size, -1)
        """Global number in the structure of each owned dof; -1 if clamped: (n_dofs,) int."""
        self.structure_dof_numbers[self.free_dofs] = first_free_dof_number + np.arange(
            len(self.free_dofs)
        )

    @property
    def points(self) -> np.ndarray:
        """Return the positions of the nodes owned by this rank: (n_nodes, d) [m]."""
        return np.asarray(
            self.space.tabulate_dof_coordinates()[: self.n_nodes_owned_by_rank, : self.dimension]
        )

    def nodes_on(self, group_name: str, space: Any = None) -> np.ndarray:
        """Return this rank's nodes on a named curve or surface, in ascending order: (n,) int.

        The local numbers belong to ``space``; default: the space of displacements.
        """
        group_facets, topology = self.part_mesh.facets(group_name), self.part_mesh.mesh.topology
        facet_dimension = topology.dim - 1
        topology.create_connectivity(facet_dimension, facet_dimension + 1)
        space = self.space if space is None else space
        nodes = np.sort(dolfinx.fem.locate_dofs_topological(space, facet_dimension, group_facets))
        return nodes[nodes < space.dofmap.index_map.size_local]

    def set_sector_sides(self, sector_side_node_pairs: np.ndarray, rotation: np.ndarray) -> None:
        """Set the left and right side of a disk's sector, and rotate the dofs on the right side.

        The right side is the next sector's left side. Dofs there become components along the next
        sector's axes. Matrices, forces and functions made afterwards use the rotated dofs. A single
        rank must have the whole sector.

        Parameters
        ----------
        sector_side_node_pairs : (2, m) int
            Nodes on the left side, and the matching nodes on the right side.
        rotation : (d, d)
            Rotation matrix from the left side to the right side.
        """
        self.sector_side_node_pairs, self.frame_to_space_rotation_by_node = (
            sector_side_node_pairs,
            np.tile(np.eye(self.dimension), (self.n_nodes_owned_by_rank, 1, 1)),
        )
        self.frame_to_space_rotation_by_node[sector_side_node_pairs[1]] = rotation
        block_row_pointers = np.arange(self.n_nodes_owned_by_rank + 1)
        block_diagonal_rotation = sparse.bsr_matrix(
            (self.frame_to_space_rotation_by_node, block_row_pointers[:-1], block_row_pointers)
        ).tocsr()
        self._frame_to_space_rotation_of_dofs = block_diagonal_rotation[self.free_dofs][
            :, self.free_dofs
        ]
        self._frame_to_space_rotation_of_dofs.eliminate_zeros()

    def restrict_to_free(self, forces: np.ndarray) -> np.ndarray:
        """Select the forces on free dofs from forces on all dofs of this rank.

        ``forces`` is (..., n_dofs), the result (..., n_local). In a disk's sector, forces on the
        right side become components along the next sector's axes.
        """
        free_forces = forces[..., self.free_dofs]
        return (
            free_forces
            if self._frame_to_space_rotation_of_dofs is None
            else np.asarray(free_forces @ self._frame_to_space_rotation_of_dofs)
        )

    def restrict_matrix(self, full_matrix: Any) -> Any:
        """Return a PETSc matrix with only the free rows and columns; ``full_matrix`` is destroyed.

        Stored zeros are removed, such as mass entries between x and y. Products with the mass
        matrix then take a half or a third of the time. The result has the communicator ``comm`` of
        this object, since PETSc could not free matrices after the mesh's communicator is gone
        (collective).
        """
        global_free_dofs = (self.dimension * self.first_node + self.free_dofs).astype(PETSc.IntType)
        index_set = PETSc.IS().createGeneral(global_free_dofs, comm=full_matrix.comm)
        free_block = full_matrix.createSubMatrix(index_set, index_set)
        local_rows_matrix = sparse.csr_matrix(free_block.getValuesCSR()[::-1], free_block.sizes[0])
        if self._frame_to_space_rotation_of_dofs is not None:
            local_rows_matrix = sparse.csr_matrix(
                self._frame_to_space_rotation_of_dofs.T
                @ local_rows_matrix
                @ self._frame_to_space_rotation_of_dofs
            )
        local_rows_matrix.eliminate_zeros()
        csr_arrays = local_rows_matrix.indptr, local_rows_matrix.indices, local_rows_matrix.data
        free_matrix = PETSc.Mat().createAIJ(free_block.sizes, csr=csr_arrays, comm=self.comm)
        for petsc_object in (index_set, free_block, full_matrix):
            petsc_object.destroy()
        return free_matrix

    def function(self, displacement: np.ndarray) -> Any:
        """Convert a displacement (n_local,) to a DOLFINx Function (collective).

        The function is 0 at clamped dofs. In a disk's sector, the dofs on the right side are
        components along the next sector's axes. The function's values are components along x, y
        (and z) at all nodes.
        """
        function = dolfinx.fem.Function(self.space)
        rotated_displacement = (
            displacement
            if self._frame_to_space_rotation_of_dofs is None
            else self._frame_to_space_rotation_of_dofs @ displacement
        )
        function.x.array[self.free_dofs] = rotated_displacement
        function.x.scatter_forward()
        return function

    def make_node_data(self) -> Nodes:
        """Return this rank's node positions, dofs and cells, for searches and pictures.

        Nodes of cells are global numbers (collective).
        """
        cells, vtk_cell_type = compat.vtk_cells_and_type(self.space)
        global_node_numbers = self.space.dofmap.index_map.local_to_global(
            cells.ravel().astype(np.int32)
        )
        return Nodes(
            points=self.points.copy(),
            dofs=self.structure_dof_numbers.reshape(-1, self.dimension),
            cells=np.asarray(global_node_numbers).reshape(cells.shape),
            vtk_type=max(self.comm.allgather(vtk_cell_type)),
            dolfinx_mesh_and_dofs=self,
            frames=self.frame_to_space_rotation_by_node,
        )
