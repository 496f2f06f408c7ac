"""The structure of a scene, whose crack may be given by its length or by a natural frequency.

DOLFINx assembles the matrices, with sigma and t of :mod:`fenics_crack.fem.elasticity`,

    u^T K v = t int sigma(u) : eps(v) dx,                     u^T M v = t rho int u . v dx.

Clamped dofs are left out, so that no spurious mode stands for them.

**Contact pairs** of the crack faces have gaps g = B^T u. A pair is two basis functions psi of a
pressure, in the same place of both faces, and with either face's outward normal n

    g = b_lower . u + b_upper . u,        w = t int psi ds its area.

Of a plate psi_i is the basis function N_i of a node, and b_i that node's displacement along
int N_i n ds. Of a solid the integral of a quadratic N_i over a triangle vanishes at corners; so
pressures are linear there, and b the mean over the patch of one,

    b_i . u = 1 / w_i int psi_i n . u ds.

Nodes of tips and fronts have no pair. On a solid the basis function of a front's node goes to its
neighbours on the face, as much to each as they overlap: psi_j = sum_i S_ij psi_i with sum_j S_ij =
1. So the areas add up to the crack's, a uniform pressure is exact, and no strip along the front,
where closed faces would interpenetrate, is without pressure.

With ``mesh.patches`` there are fewer pressures, likewise of the linear ones of a solid or of a
plate. Those of tips and fronts go with the nearest. On a plate psi_j is linear from one to the next
of some nodes, on a solid it has all that are nearest to one of some.

Tangential gaps of a solid are those along two directions t at right angles to a pair's mean normal
m = int psi n ds / |int psi n ds|,

    b_i . u = 1 / w_i int psi_i (m . n) t . u ds.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import collect_garbage, gather_rows, on_each, on_root
from fenics_crack.fem import compat
from fenics_crack.fem.compat import ufl
from fenics_crack.fem.cracks import LIP_TAGS, SAME, Lips, along, shares_of_neighbours
from fenics_crack.fem.elasticity import constants, rotation_of, stress, thickness
from fenics_crack.fem.loads import assemble_loads, clamp_of
from fenics_crack.fem.plate import Dofs, build_mesh
from fenics_crack.fem.setting import clearance_of, damping_of
from fenics_crack.model.body import Body
from fenics_crack.model.factor import local_rows
from fenics_crack.model.modes import solve_modes
from fenics_crack.model.nodes import Pairs
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene


def pair_lips(
    dofs: Dofs, t: Any, *, mouth: bool = False, patches: int | None = None
) -> tuple[sparse.csr_matrix, sparse.csr_matrix | None, Pairs]:
    """Pair what is in the same place of both faces, crack by crack: the rows of B and of B_t of
    this rank's free dofs, and where the pairs are; with ``mouth`` those alone that are watched,
    with ``patches`` at most so many of each crack (collective).

    B_t is B with each node's normal turned by a right angle; of a solid None, whose pairs have two
    directions.

    The pairs of a crack are ordered from its mouth to its tip, or from the left to the right tip;
    of a solid from the front to the mouth.

    Raises
    ------
    InputError
        The two faces have different nodes.
    """
    dimension, plate = dofs.dimension, dofs.plate
    if not plate.cracked:
        none = np.zeros((0, dimension)), np.zeros(0), np.zeros(0, dtype=int), np.zeros(0)
        return sparse.csr_matrix((len(dofs.free), 0)), None, Pairs(*none)
    make = _of_nodes if dimension == 2 and patches is None else _of_patches
    lips = plate.along(*LIP_TAGS)
    space, weights, columns = make(dofs, t, lips)
    first = space.dofmap.index_map.local_range[0]
    points = space.tabulate_dof_coordinates()[:, :dimension]
    sides = []
    for name in LIP_TAGS:
        local = dofs.nodes_on(name, space)
        rows = np.column_stack([local + first, weights[local], points[local]])
        sides.append(gather_rows(dofs.comm, rows))
    lower, upper, cracks, positions, count = _matched(plate.lips, *sides)
    numbers = lower[:, 0].astype(int)
    below = columns[:, numbers]
    gap = below + columns[:, upper[:, 0].astype(int)]
    points, areas, chosen = lower[:, 2:], lower[:, 1], np.arange(count)
    solid: dict[str, Any] = {}
    if patches is not None or dimension == 3:
        if patches is None:
            shares = _shares_at_fronts(dofs, space, lips, numbers, count)
        else:
            chosen, shares = _shares(points, cracks, positions, count, patches)
        forces = sparse.csc_matrix(shares.multiply(areas[:, None]))
        areas[chosen] = shares.T @ areas
        forces.data /= np.repeat(areas[chosen], np.diff(forces.indptr))
        gap, below = gap @ forces, below @ forces
        solid = {"nodes": points, "shares": shares} if dimension == 3 else {}
    if patches is None:
        kept = np.arange(count)
        if mouth:
            kept = np.array([*_watched(plate.lips, cracks[:count], positions[:count]).values()])
            solid = {"nodes": points, "shares": shares[:, kept]} if solid else {}
        chosen, gap, below = kept, gap[:, kept], below[:, kept]
    points, areas, cracks, positions = (x[chosen] for x in (points, areas, cracks, positions))
    if dimension == 3:
        solid["tangents"] = _free_rows(_along_faces(gap, below, dofs.comm), dofs)
    pairs = Pairs(
        points, areas, cracks, positions, _watched(plate.lips, cracks, positions), **solid
    )
    tangential = _free_rows(_turned(gap), dofs) if dimension == 2 else None
    return _free_rows(gap, dofs), tangential, pairs


def _shares_at_fronts(
    dofs: Dofs, space: Any, lips: Any, numbers: np.ndarray, inside: int
) -> sparse.csr_matrix:
    """S of pressures of a space, by the numbers of their nodes, of which those behind the first
    ones, inside, are of fronts: (n, inside)."""
    overlap = ufl.inner(ufl.TrialFunction(space), ufl.TestFunction(space)) * lips
    matrix = compat.assembled_matrix(overlap)
    own = local_rows(matrix).tocoo()
    matrix.destroy()
    first = space.dofmap.index_map.local_range[0]
    rows = gather_rows(dofs.comm, np.column_stack([own.row + first, own.col, own.data]))
    size = space.dofmap.index_map.size_global
    every = sparse.csr_matrix((rows[:, 2], rows[:, :2].astype(int).T), (size, size))
    return shares_of_neighbours(every[numbers[inside:]][:, numbers[:inside]])


def _along_faces(gap: Any, below: Any, comm: MPI.Comm) -> sparse.csr_matrix:
    """Tangential gaps of a solid's pairs, (n_nodes * 3, 2 m), from the normal ones, (n_nodes * 3,
    m), and their parts of the lower face (collective)."""
    normal = comm.allreduce(np.array([below[k::3].sum(axis=0) for k in range(3)])[:, 0].T)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    one = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    one /= np.linalg.norm(one, axis=1)[:, None]
    along = sum(gap[k::3] @ sparse.diags(normal[:, k]) for k in range(3))
    return sparse.hstack([
        sum(
            sparse.kron(along @ sparse.diags(part), unit[:, None])
            for part, unit in zip(tangent.T, np.eye(3), strict=True)
        )
        for tangent in np.round([one, np.cross(normal, one)], 12)
    ]).tocsr()  # fmt: skip


def _shares(
    points: np.ndarray, cracks: np.ndarray, positions: np.ndarray, inside: int, most: int
) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Nodes that are the middles of patches, at most so many of each crack, and S, the values of
    the patches' functions at all nodes, (n, m); the first ones, inside, are in order along cracks.
    """
    middles, values = np.zeros(0, dtype=int), np.zeros((len(points), 0))
    for crack in np.unique(cracks):
        its = np.flatnonzero(cracks[:inside] == crack)
        few = min(most, len(its))
        if points.shape[1] == 2:
            its = its[np.arange(few) * (len(its) - 1) // max(few - 1, 1)]
            functions = [np.interp(positions, positions[its], unit) for unit in np.eye(few)]
        else:
            its = its[_spread(points[its], few)]
            away = np.linalg.norm(points[:, None] - points[its], axis=2)
            functions = [away.argmin(axis=1) == number for number in range(few)]
        middles = np.append(middles, its)
        values = np.column_stack([values, *(row * (cracks == crack) for row in functions)])
    return middles, sparse.csr_matrix(values)


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """Which of some points are far from each other: the last one, and always the one farthest from
    those before; in their order."""
    chosen, away = [len(points) - 1], np.full(len(points), np.inf)
    while len(chosen) < count:
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(away.argmax()))
    return np.sort(chosen)


def _turned(columns: Any) -> sparse.csr_matrix:
    """Columns of nodes' vectors in a plane, (n_nodes * 2, m), turned by a right angle."""
    turn = sparse.kron(sparse.eye(columns.shape[0] // 2), [[0.0, -1.0], [1.0, 0.0]])
    return turn.tocsr() @ columns


def _free_rows(columns: Any, dofs: Dofs) -> sparse.csr_matrix:
    found = sparse.csr_matrix(columns.tocsr()[dofs.free])
    found.eliminate_zeros()
    return found


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
    work = ufl.inner(t * pressure * normal, ufl.TestFunction(dofs.space)) * lips
    matrix = compat.assembled_matrix(work)
    moved = local_rows(matrix).tocsc()
    matrix.destroy()
    weights = compat.assembled_vector(t * ufl.TestFunction(space) * lips)
    every = gather_rows(dofs.comm, weights)
    inverse = np.divide(1.0, every, out=np.zeros_like(every), where=every > 0.0)
    return space, weights, sparse.csc_matrix(moved @ sparse.diags(inverse))


def _matched(
    lips: Lips, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """Rows (number, weight, x, y, ...) of both faces, partner by partner in order along the cracks,
    at last those of the fronts, with half their weights, which are of both faces; the crack of
    each pair, and its position; and how many are not of the fronts."""
    size, shared = np.ptp(lower[:, 2:], axis=0).max(), np.isin(lower[:, 0], upper[:, 0])
    lower[shared, 1] *= 0.5
    cracks, positions = along(lips, lower[:, 2:])
    # Equal positions, along a front, in the order of their places.
    places = np.round(lower[:, 2:] / size, 7).T
    order = np.lexsort((*places, np.round(positions / size, 7), cracks, shared))
    lower, cracks, positions = lower[order], cracks[order], positions[order]
    fronts = int(shared.sum())
    count = len(lower) - fronts
    matching = len(lower) == len(upper) and count > 0
    reason = "one has more nodes than the other"
    if matching:
        apart = [np.linalg.norm(upper[:, 2:] - place, axis=1) for place in lower[:, 2:]]
        distance, partner = np.min(apart, axis=1), np.argmin(apart, axis=1)
        matching = distance.max() <= SAME * size and len(np.unique(partner)) == len(partner)
        place = ", ".join(f"{x:g}" for x in lower[int(np.argmax(distance)), 2:])
        reason = f"the upper node nearest to the lower one at ({place})"
        reason += f" is {distance.max():.2g} m away"
    if not matching:
        found = f"{count} lower and {len(upper) - fronts} upper nodes"
        how = "in a mesh file one curve or surface named 'crack' is split into two that do"
        allowed = "meshed identically, so that nodes of the two faces pair one to one"
        raise InputError("lips", found, f"{allowed}, but {reason}; {how}")
    return lower, upper[partner], cracks, positions, count


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


def assemble(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Structure:
    """Mesh a scene whose crack length is known, and assemble its structure, or read its matrices
    (collective).

    Parameters and errors are those of :func:`fenics_crack.build_structure`.
    """
    collect_garbage(comm)  # of structures made before
    if scene.structure is not None:
        from fenics_crack.fem.matrix_files import read_structure

        rule = None if scene.damping is None else damping_of(scene.damping)
        return read_structure(scene, rule, comm)
    coarser = scene.mesh.coarser
    if coarser is not None:  # which is read after all else
        from fenics_crack.fem.msh_file import check_there

        on_root(comm, lambda: check_there("mesh.coarser", coarser))
    if scene.disk is not None:  # every rank has the sector
        from fenics_crack.fem.sector import assemble_wheel

        structure, dofs = on_each(comm, lambda: _assembled(scene, MPI.COMM_SELF))
        return assemble_wheel(scene, dofs, structure, comm)
    structure, dofs = _assembled(scene, comm)
    if scene.speed > 0.0:
        begin("rotation")
        structure = rotation_of(scene, dofs, structure).at(scene.speed)
    return structure


def loads_on(scene: Scene, structure: Structure) -> dict[str, Any]:
    """The attributes of a body at rest that the loads of another scene of its mesh change
    (collective)."""
    dofs: Dofs = structure.nodes.numbered  # type: ignore[union-attr]
    _, mass = _forms(scene, dofs.space)
    matrix = compat.assembled_matrix(mass)
    force, watched = assemble_loads(scene, dofs, matrix)
    clamp = clamp_of(dofs, matrix, force)
    matrix.destroy()
    return {"force": dofs.free_part(force), "watched": watched, "clamp": clamp}


def _assembled(scene: Scene, comm: MPI.Comm) -> tuple[Structure, Dofs]:
    """The structure of a mesh at rest, of a sector with free sides, and its dofs (collective)."""
    begin("mesh")
    plate = build_mesh(scene, comm)
    begin("matrices")
    if not plate.cracked and scene.mesh.layout == "file" and (scene.contact or scene.all_cracks):
        named = "curves" if scene.dimension == 2 else "surfaces"
        allowed = f"a mesh with {named} named 'crack', or 'lower_lip' and 'upper_lip'"
        allowed += ", as the scene has contact"
        raise InputError("mesh.file", scene.mesh.file, allowed)
    space = compat.function_space(plate.mesh, scene.mesh.order)
    dofs = Dofs(plate, space, comm)
    if scene.disk is not None:
        from fenics_crack.fem.sector import turn_sides

        turn_sides(scene, dofs)
    stiffness, mass = map(compat.assembled_matrix, _forms(scene, space))
    mouth = scene.contact is not None and scene.contact.pairs == "mouth"
    t, patches = thickness(scene, space), scene.mesh.patches
    gap, tangential, pairs = pair_lips(dofs, t, mouth=mouth, patches=patches)
    force, watched = assemble_loads(scene, dofs, mass)
    clamp = clamp_of(dofs, mass, force)
    body = Body(
        dofs.free_block(mass), dofs.free_block(stiffness), gap, dofs.free_part(force),
        clearance_of(scene, pairs), damping=damping_of(scene.damping), tangential=tangential,
        nodes=dofs.nodes(), pairs=pairs, watched=watched, clamp=clamp,
    )  # fmt: skip
    return Structure(body), dofs


# --- matrices -------------------------------------------------------------------------------------


def _forms(scene: Scene, space: Any) -> tuple[Any, Any]:
    """Forms of stiffness and mass."""
    (density,), t = constants(space, scene.material.density), thickness(scene, space)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    strain = ufl.sym(ufl.grad(u))
    stiffness = t * ufl.inner(stress(scene, space, strain), ufl.sym(ufl.grad(v))) * ufl.dx
    return stiffness, t * density * ufl.inner(u, v) * ufl.dx


# --- cracks ---------------------------------------------------------------------------------------


def build_structure(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Structure:
    """Mesh a scene and assemble its structure, or read its matrices (collective).

    A crack that is given by ``first_omega`` gets the length found by :func:`find_crack_length`.

    Parameters
    ----------
    scene : Scene
        Scene to build.
    comm : MPI.Comm
        Ranks that share the mesh.

    Returns
    -------
    Structure
        Whole; its rows are shared by the ranks.

    Raises
    ------
    InputError
        The mesh file or a matrix is unusable, the load is off the mesh or clamped, or the crack
        faces do not match.

    Examples
    --------
    >>> whole = fc.build_structure(scene)
    """
    return assemble(with_crack_length(scene, comm), comm)


def with_crack_length(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
    """Return the scene with the length found from ``crack.first_omega``, if that is given."""
    if scene.crack is None or scene.crack.first_omega is None:
        return scene
    return _with_length(scene, find_crack_length(scene, comm))


_LENGTH: list[tuple[str, float]] = []
"""The length found last in this process, after all tables of a scene on which it depends."""


def find_crack_length(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> float:
    """Find the crack length [m] at which the first natural frequency is ``crack.first_omega``.

    The frequency of the open crack, without rotation, falls with its length; Brent's method over
    re-meshed plates, to 1e-5 of the width; not again of the same plate.

    Parameters
    ----------
    scene : Scene
        With ``crack.first_omega`` or ``crack.first_frequency``.
    comm : MPI.Comm
        Ranks that share the mesh.

    Returns
    -------
    float
        [m].

    Raises
    ------
    InputError
        No length between 1 % and 95 % of the width gives that frequency; for a crack inside, of the
        room around its center.

    Examples
    --------
    >>> given = {"crack.length": None, "crack.first_omega": 4700.0}
    >>> length = fc.find_crack_length(blade.replace(given))
    """
    crack, width = scene.crack, None if scene.structure else scene.geometry.width
    if crack is None or crack.first_omega is None or width is None:
        raise InputError("crack.first_omega", None, "given: a finite number > 0")
    tables = repr((scene.geometry, crack, scene.material, scene.mesh))
    if (known := comm.bcast(dict(_LENGTH).get(tables))) is not None:
        return float(known)
    target, at_rest = crack.first_omega, scene.at_rest()

    @cache
    def excess(length: float) -> float:
        plate = assemble(_with_length(at_rest, length), comm)
        return float(solve_modes(plate, 1).omega[0]) - target

    room, words = width, "width"
    if crack.center is not None:
        room, words = 2.0 * min(crack.center, width - crack.center), "room around its center"
    shortest, longest = 0.01 * room, 0.95 * room
    highest, lowest = target + excess(shortest), target + excess(longest)
    if not lowest <= target <= highest:
        span = f"between {lowest:.1f} and {highest:.1f} rad/s"
        allowed = f"{span}: cracks of 95 % and 1 % of the {words}"
        raise InputError("crack.first_omega", target, allowed)
    import scipy.optimize  # takes a while, and most scenes give a length

    found = float(scipy.optimize.brentq(excess, shortest, longest, xtol=1e-5 * width))
    _LENGTH[:] = [(tables, found)]
    return found


def _with_length(scene: Scene, length: float) -> Scene:
    return scene.replace({"crack.length": length, "crack.first_omega": None})
