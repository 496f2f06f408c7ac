"""Contact pairs of the lips: their gaps g = B^T u, their areas, and where they are.

A pair is two basis functions psi of a pressure, in the same place of both lips, and with either
lip's outward normal n

    g = b_lower . u + b_upper . u,        w = t int psi ds its area.

Of a plate psi_i is the basis function N_i of a node, and b_i that node's displacement along
int N_i n ds. Of a solid the integral of a quadratic N_i over a triangle vanishes at corners; so
pressures are linear there, and b the mean over the patch of one,

    b_i . u = 1 / w_i int psi_i n . u ds.

Nodes of tips and fronts have no pair.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sparse

from fenics_crack.errors import InputError
from fenics_crack.fem import compat
from fenics_crack.fem.compat import ufl
from fenics_crack.fem.elasticity import thickness
from fenics_crack.fem.lips import along
from fenics_crack.fem.plate import Dofs, Lips
from fenics_crack.model.nodes import Pairs
from fenics_crack.parallel import gather_rows
from fenics_crack.scene.scene import Scene

__all__ = ["pair_lips"]

LIPS = ("lower_lip", "upper_lip")


def pair_lips(scene: Scene, dofs: Dofs) -> tuple[sparse.csr_matrix, Pairs]:
    """Pair what is in the same place of both lips, crack by crack: the rows of B of this rank's
    free dofs, and where the pairs are (collective).

    The pairs of a crack are ordered from its mouth to its tip, or from the left to the right tip;
    of a solid from the front to the mouth.

    Raises
    ------
    InputError
        The two lips have different nodes.
    """
    dimension, plate = scene.dimension, dofs.plate
    if not plate.cracked:
        return sparse.csr_matrix((len(dofs.free), 0)), Pairs.none(dimension)
    make = _of_nodes if dimension == 2 else _of_patches
    space, weights, columns = make(dofs, thickness(scene, dofs.space), plate.along(*LIPS))
    owned, first = space.dofmap.index_map.size_local, space.dofmap.index_map.local_range[0]
    points = space.tabulate_dof_coordinates()[:, :dimension]
    sides = []
    for name in LIPS:
        local = dofs.nodes_on(name, space)
        local = local[local < owned]
        rows = np.column_stack([local + first, weights[local], points[local]])
        sides.append(gather_rows(dofs.comm, rows))
    lower, upper, cracks, positions = _matched(plate.lips, *sides)
    places = _watched(plate.lips, cracks, positions)
    if scene.contact is not None and scene.contact.pairs == "mouth":
        chosen = list(places.values())
        lower, upper, cracks, positions = (x[chosen] for x in (lower, upper, cracks, positions))
        places = {name: number for number, name in enumerate(places)}
    gap = columns[:, lower[:, 0].astype(int)] + columns[:, upper[:, 0].astype(int)]
    gap = sparse.csr_matrix(gap[dofs.free])
    gap.eliminate_zeros()
    return gap, Pairs(lower[:, 2:], lower[:, 1], cracks, positions, places)


def _of_nodes(dofs: Dofs, t: Any, lips: Any) -> tuple[Any, np.ndarray, sparse.csc_matrix]:
    """The space of the pressures, t int psi ds of those that this rank owns, and b of all of them,
    the rows of this rank's dofs."""
    space, size = dofs.space, dofs.dimension
    normal = ufl.FacetNormal(space.mesh)
    along_normal = compat.assembled_vector(t * ufl.inner(normal, ufl.TestFunction(space)) * lips)
    along_normal = along_normal.reshape(-1, size)
    weights = np.linalg.norm(along_normal, axis=1)
    on_lips = np.flatnonzero(weights)
    normals = along_normal[on_lips] / weights[on_lips, None]
    rows = size * on_lips[:, None] + np.arange(size)
    columns = np.repeat(dofs.first_node + on_lips, size)
    shape = len(dofs.numbers), space.dofmap.index_map.size_global
    return space, weights, sparse.csc_matrix((normals.ravel(), (rows.ravel(), columns)), shape)


def _of_patches(dofs: Dofs, t: Any, lips: Any) -> tuple[Any, np.ndarray, sparse.csc_matrix]:
    """Likewise."""
    space = compat.function_space(dofs.space.mesh, 1, vectors=False)
    normal, pressure = ufl.FacetNormal(space.mesh), ufl.TrialFunction(space)
    work = ufl.inner(pressure * normal, ufl.TestFunction(dofs.space)) * lips
    matrix = compat.assembled_matrix(work)
    starts, columns, values = matrix.getValuesCSR()
    shape = len(dofs.numbers), space.dofmap.index_map.size_global
    moved = sparse.csr_matrix((values, columns, starts), shape).tocsc()
    matrix.destroy()
    weights = compat.assembled_vector(t * ufl.TestFunction(space) * lips)
    every = gather_rows(dofs.comm, weights)
    inverse = np.divide(1.0, every, out=np.zeros_like(every), where=every > 0.0)
    return space, weights, sparse.csc_matrix(moved @ sparse.diags(inverse))


def _matched(
    lips: Lips, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows (number, weight, x, y, ...) of both lips without the tips, partner by partner in order
    along the cracks; the crack of each pair, and its position."""
    shared = np.intersect1d(lower[:, 0], upper[:, 0])
    size = np.ptp(lower[:, 2:], axis=0).max()
    sides = []
    for side in (lower, upper):
        own = side[~np.isin(side[:, 0], shared)]
        cracks, positions = along(lips, own[:, 2:])
        # Equal positions, along a front, in an order that is the same for both lips.
        places = np.round(own[:, 2:] / size, 7).T
        order = np.lexsort((*places, np.round(positions / size, 7), cracks))
        sides.append((own[order], cracks[order], positions[order]))
    (lower, cracks, positions), (upper, _, _) = sides
    alike = len(lower) == len(upper) > 0
    reason = "one has more nodes than the other"
    if alike:
        distance = np.linalg.norm(lower[:, 2:] - upper[:, 2:], axis=1)
        alike = distance.max() <= 1e-6 * size
        place = ", ".join(f"{x:g}" for x in lower[int(np.argmax(distance)), 2:])
        reason = f"the lower node at ({place}) has its partner {distance.max():.2g} m away"
    if not alike:
        found = f"{len(lower)} lower and {len(upper)} upper nodes"
        allowed = (
            f"meshed identically, so that the nodes of the two lips pair one to one, but {reason}; "
            "gmsh's Transfinite Curve divides both alike, or its Plugin(Crack) makes both of one "
            "curve"
        )
        raise InputError("lips", found, allowed)
    return lower, upper, cracks, positions


def _watched(lips: Lips, cracks: np.ndarray, positions: np.ndarray) -> dict[str, int]:
    """The pair to watch of each crack by its name."""
    found: dict[str, int] = {}
    lip: Any
    for number, lip in enumerate(lips):
        own = np.flatnonzero(cracks == number)
        name, place = lip.watched
        if len(lips) > 1:
            name += f" of crack {number + 1}"
        if len(own):
            place = min(place, float(positions[own].max()))
            found[name] = int(own[np.argmin(np.abs(positions[own] - place))])
    return found
