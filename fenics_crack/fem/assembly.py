"""Finite elements by DOLFINx: plane-stress matrices, point load and contact pairs of a scene.

    sigma = E / (1 - nu^2) ((1 - nu) eps + nu tr(eps) I),    eps = sym(grad u)
    u^T K v = t int sigma(u) : eps(v) dx,                     u^T M v = t rho int u . v dx

with thickness t. Clamped dofs are left out, so that no spurious mode stands for them.
"""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
import scipy.sparse as sparse
import ufl
from mpi4py import MPI
from petsc4py import PETSc
from scipy.spatial import cKDTree

from fenics_crack.errors import InputError
from fenics_crack.fem import compat
from fenics_crack.fem.plate import PlateMesh, build_mesh
from fenics_crack.model.damping import DampingRule, ModalDamping, RayleighDamping
from fenics_crack.model.nodes import Nodes
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import collect_garbage, gather_rows
from fenics_crack.scene.scene import Damping, Scene

__all__ = ["assemble"]


def assemble(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Structure:
    """Mesh a scene whose crack length is known, and assemble its structure (collective).

    Parameters and errors are those of :func:`fenics_crack.build_structure`.
    """
    plate = build_mesh(scene, comm)
    if not plate.cracked and scene.mesh.layout == "file" and (scene.contact or scene.crack):
        allowed = "a mesh with curves named 'lower_lip' and 'upper_lip', as the scene has contact"
        raise InputError("mesh.file", scene.mesh.file, allowed)
    space = compat.function_space(plate.mesh, scene.mesh.order)
    dofs = _Dofs(plate, space)
    stiffness, mass = _matrices(scene, space)
    if not all(np.isfinite(matrix.norm()) for matrix in (stiffness, mass)):
        raise InputError("mesh", "cells of no area", "one whose cells all have an area")
    gap, points, areas = _pair_lips(scene, plate, space, dofs)
    structure = Structure(
        dofs.free_block(mass),
        dofs.free_block(stiffness),
        gap,
        force=_load(scene, plate, space, dofs),
        clearance=np.full(gap.shape[1], scene.crack.clearance if scene.crack else 0.0),
        damping=_damping(scene.damping),
        nodes=dofs.nodes(),
        pair_points=points,
        pair_areas=areas,
    )
    collect_garbage(comm)
    return structure


# --- numbering ------------------------------------------------------------------------------------


class _Dofs:
    """Which dofs of the function space are free, and their numbers in the structure."""

    def __init__(self, plate: PlateMesh, space: Any) -> None:
        self.comm: MPI.Comm = plate.mesh.comm
        self.space = space
        self.n_nodes = space.dofmap.index_map.size_local
        self.first_node = space.dofmap.index_map.local_range[0]
        clamped = nodes_on(plate, space, "clamp")
        free = np.ones((self.n_nodes, 2), dtype=bool)
        free[clamped[clamped < self.n_nodes]] = False
        self.free = np.flatnonzero(free.ravel())
        """Owned free dofs, local numbers of the function space."""
        first = self.comm.exscan(len(self.free)) or 0
        self.numbers = np.full(2 * self.n_nodes, -1)
        """Number in the structure of each owned dof of the space, -1 where clamped."""
        self.numbers[self.free] = first + np.arange(len(self.free))

    def free_block(self, matrix: Any) -> Any:
        """Leave the clamped rows and columns out of a matrix, which is destroyed."""
        free = (2 * self.first_node + self.free).astype(PETSc.IntType)
        rows = PETSc.IS().createGeneral(free, comm=self.comm)
        block = matrix.createSubMatrix(rows, rows)
        rows.destroy()
        matrix.destroy()
        return block

    def nodes(self) -> Nodes:
        """Positions, numbers and cells for look-ups and pictures."""
        cells, vtk_type = compat.vtk_cells(self.space)
        numbers = self.space.dofmap.index_map.local_to_global(cells.ravel().astype(np.int32))
        return Nodes(
            points=self.space.tabulate_dof_coordinates()[: self.n_nodes, :2].copy(),
            dofs=self.numbers.reshape(-1, 2),
            cells=np.asarray(numbers).reshape(cells.shape),
            vtk_type=max(self.comm.allgather(vtk_type)),
        )


def nodes_on(plate: PlateMesh, space: Any, group: str) -> np.ndarray:
    """Local numbers, ghosts included, of the nodes in a facet group."""
    facets = plate.facet_tags.find(plate.groups[group])
    dimension = plate.mesh.topology.dim - 1
    plate.mesh.topology.create_connectivity(dimension, dimension + 1)
    return np.sort(dolfinx.fem.locate_dofs_topological(space, dimension, facets))


# --- matrices and load ----------------------------------------------------------------------------


def _matrices(scene: Scene, space: Any) -> tuple[Any, Any]:
    """Stiffness and mass matrix of all dofs, clamped ones included."""
    material, thickness = scene.material, scene.geometry.thickness
    young, poisson, density, thickness = (
        dolfinx.fem.Constant(space.mesh, PETSc.ScalarType(value))
        for value in (material.young, material.poisson, material.density, thickness)
    )
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    strain = ufl.sym(ufl.grad(u))
    stress = (1.0 - poisson) * strain + poisson * ufl.tr(strain) * ufl.Identity(2)
    stress = young / (1.0 - poisson**2) * stress
    stiffness = thickness * ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx
    mass = thickness * density * ufl.inner(u, v) * ufl.dx
    return compat.assembled_matrix(stiffness), compat.assembled_matrix(mass)


def _load(scene: Scene, plate: PlateMesh, space: Any, dofs: _Dofs) -> np.ndarray:
    """Point force as consistent nodal forces: (3, n_local), mean, cosine and sine part.

    A force F at x does the work F . sum_i N_i(x) u_i, so node i gets N_i(x) F.
    """
    excitation = scene.excitation
    point = excitation.point if excitation.point is not None else plate.load_point
    if point is None:
        allowed = "given, or a physical point 'load' in the mesh file"
        raise InputError("excitation.point", None, allowed)
    nodes, values = compat.basis_at(space, scene.mesh.order, np.array(point))
    values = np.where(np.abs(values) < 1e-12, 0.0, values)  # rounding
    hits = dofs.comm.allgather(len(nodes) > 0)
    if not any(hits):
        raise InputError("excitation.point", tuple(point), "on the mesh")
    if dofs.comm.rank != hits.index(True):
        nodes, values = nodes[:0], values[:0]

    # The cell may touch nodes of other ranks: hand every node's share to its owner.
    numbers = dofs.space.dofmap.index_map.local_to_global(nodes.astype(np.int32))
    numbers = gather_rows(dofs.comm, np.asarray(numbers, dtype=np.int64))
    shares = gather_rows(dofs.comm, values)
    mine = (numbers >= dofs.first_node) & (numbers < dofs.first_node + dofs.n_nodes)
    share = np.zeros(dofs.n_nodes)
    np.add.at(share, numbers[mine] - dofs.first_node, shares[mine])
    parts = (excitation.force_mean, excitation.force_cos, excitation.force_sin)
    force = np.array([np.outer(share, part).ravel()[dofs.free] for part in parts])
    if any(map(any, parts)) and not np.any(gather_rows(dofs.comm, force.ravel())):
        raise InputError("excitation.point", tuple(point), "where the plate is free to move")
    return force


def _damping(table: Damping) -> DampingRule:
    """The damping that a scene's table describes."""
    if table.ratio is not None:
        return ModalDamping(table.ratio, None if table.modes == "all" else int(table.modes))
    if table.ratios is not None and table.omegas is not None:
        return RayleighDamping.from_ratios(table.ratios, table.omegas)
    return RayleighDamping(table.mass or 0.0, table.stiffness or 0.0)


# --- the crack ------------------------------------------------------------------------------------


def _pair_lips(
    scene: Scene, plate: PlateMesh, space: Any, dofs: _Dofs
) -> tuple[sparse.csr_matrix, np.ndarray, np.ndarray]:
    """Pair the nodes of the lips in the same place, from the mouth to the tip: B, points, areas.

    The normal at a node is the lower lip's outward normal, averaged with the node's basis function
    over the lip: the load vector of a unit pressure points along it. The area of a pair is the
    thickness times the integral of that function.
    """
    if not plate.cracked:
        return sparse.csr_matrix((len(dofs.free), 0)), np.zeros((0, 2)), np.zeros(0)
    comm = dofs.comm
    normal = ufl.FacetNormal(plate.mesh)
    lip = ufl.ds(domain=plate.mesh, subdomain_data=plate.facet_tags)(plate.groups["lower_lip"])
    pressure = compat.assembled_vector(ufl.inner(normal, ufl.TestFunction(space)) * lip)
    pressure = pressure.reshape(-1, 2)

    coordinates = space.tabulate_dof_coordinates()[:, :2]
    sides = []
    for group in ("lower_lip", "upper_lip"):
        local = nodes_on(plate, space, group)
        local = local[local < dofs.n_nodes]
        rows = np.column_stack([local + dofs.first_node, coordinates[local], pressure[local]])
        sides.append(gather_rows(comm, rows))
    lower, upper = sides
    shared = np.intersect1d(lower[:, 0], upper[:, 0])
    tip = lower[np.isin(lower[:, 0], shared), 1:3]
    lower, upper = (side[~np.isin(side[:, 0], shared)] for side in (lower, upper))
    matched = len(lower) == len(upper) > 0
    if matched:
        size = np.ptp(np.concatenate([lower[:, 1:3], tip]), axis=0).max()
        distance, partner = cKDTree(upper[:, 1:3]).query(lower[:, 1:3])
        matched = distance.max() <= 1e-6 * size and len(set(partner)) == len(partner)
    if not matched:
        allowed = "meshed identically, so that the nodes of the two lips pair one to one"
        raise InputError("lips", f"{len(lower)} lower and {len(upper)} upper nodes", allowed)
    upper = upper[partner]
    order = np.lexsort(lower[:, 1:3].T)
    if len(tip):
        order = np.argsort(-np.linalg.norm(lower[:, 1:3] - tip[0], axis=1), kind="stable")
    if scene.contact is not None and scene.contact.pairs == "mouth":
        order = order[:1]
    lower, upper = lower[order], upper[order]
    lengths = np.linalg.norm(lower[:, 3:5], axis=1)
    normals = lower[:, 3:5] / lengths[:, None]

    n_pairs = len(lower)
    entries = []
    for side, sign in ((lower, 1.0), (upper, -1.0)):
        node = side[:, 0].astype(int) - dofs.first_node
        mine = np.flatnonzero((node >= 0) & (node < dofs.n_nodes))
        for component in (0, 1):
            rows = 2 * node[mine] + component
            entries.append(np.array([sign * normals[mine, component], rows, mine]))
    values, rows, columns = np.hstack(entries)
    shape = 2 * dofs.n_nodes, n_pairs
    gap = sparse.csr_matrix((values, (rows.astype(int), columns.astype(int))), shape)
    gap.eliminate_zeros()
    areas = scene.geometry.thickness * lengths
    return gap[dofs.free], lower[:, 1:3], areas
