"""Loads of a scene as nodal forces: at points, on edges, and the inertia of what is shaken; and
what the clamp holds against them.

A force F at x does the work F . sum_i N_i(x) u_i, so node i gets N_i(x) F. On an edge E of a plate
of thickness t, or a face of a solid with t = 1, with outward normal n, a traction T or a pressure
p, T = -p n, give it

    f_i = t int_E N_i T ds.

A clamp that moves by U(t), the same everywhere, carries the plate along: with displacements u
relative to it

    M u'' + C u' + K u + B lambda(g) = f - M R U'',

where R is the translation of all nodes, clamped ones among them, and M the mass matrix with their
rows; it stretches nothing, K R = 0, and closes no gap, B^T R = 0. Damping acts on u.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_choice
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem import compat
from fenics_crack.fem.compat import ufl
from fenics_crack.fem.elasticity import thickness
from fenics_crack.fem.plate import Dofs
from fenics_crack.fem.setting import force_parts
from fenics_crack.model.nodes import FARTHEST, Clamp, nearest_node, nodes_at
from fenics_crack.scene.fields import Vector
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Load


def assemble_loads(scene: Scene, dofs: Dofs, mass: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean, and cosine and sine part of each order, of the load on all dofs that this rank owns,
    clamped ones too, (2K+1, n_dofs) [N], and what is watched of the free ones (n_local,).

    The watched displacement is the product of u with that vector [m]; None: the dof that
    carries most of the load. ``mass`` is the mass matrix with the clamped rows (collective).

    Raises
    ------
    InputError
        A load is off the mesh, where the plate is clamped, or on a crack, where there are two
        faces.
    """
    force, watched = np.zeros((2 * scene.highest_order + 1, len(dofs.numbers))), None
    excitation = scene.excitation
    point = excitation.point if excitation.point is not None else dofs.plate.points.get("load")
    if point is not None:
        parts = force_parts(scene)
        own, along = _at_point(scene, dofs, "excitation", point, parts)
        force += own
        watched = along if scene.has_other_loads or scene.speed > 0.0 else None
    elif (name := excitation.force_given) or not scene.has_other_loads:
        by = f" with excitation.{name}" if name else ""
        allowed = f"given{by}, or a physical point 'load' in the mesh file"
        raise InputError("excitation.point", None, allowed)
    for number, load in enumerate(scene.loads, 1):
        key = f"loads.{number}"
        if load.point is not None:
            own, along = _at_point(scene, dofs, key, load.point, load.parts("force"))
            watched = along if watched is None else watched
        else:
            own = _edge_force(scene, dofs, key, load)
            if watched is None and np.any(gather_rows(dofs.comm, own.ravel())):
                watched = _middle_of(dofs, str(load.edge), own)
        force[: len(own)] += own
    if scene.base is not None:
        if watched is None:
            middle = gather_rows(dofs.comm, dofs.points[dofs.nodes_on("clamp")]).mean(axis=0)
            every = np.arange(dofs.n_nodes)  # the farthest from the clamp
            watched = _one_of(dofs, every, middle, -1, scene.base.direction)
        for row, acceleration in enumerate(scene.base.accelerations, 1):
            force[row] -= _inertia(mass, np.tile(acceleration, dofs.n_nodes))
    if watched is None and point is not None and not any(map(any, parts)):
        along_x = [np.eye(dofs.dimension)[0].tolist()] * 2
        _, watched = _at_point(scene, dofs, "excitation", point, along_x)
    return force, watched


def _unit(parts: Sequence[Vector]) -> Vector:
    """The direction of a load: of the larger of its cosine and sine part, of its mean if there is
    neither."""
    mean, *moving = parts
    largest = max(moving, key=lambda part: math.hypot(*part))
    if not any(largest):
        largest = mean
    size = math.hypot(*largest)
    return tuple(x / size for x in largest)


def nodal_force_fractions(scene: Scene, dofs: Dofs, key: str, point: Vector) -> np.ndarray:
    """Return the fraction of a force at a point that each of this rank's nodes carries: (n_nodes,).

    A node takes all of what acts at it, also where rounding, or a curved boundary between flat
    sides, puts it out of every cell; so does the node of a part nearest to a point that is out of
    every cell, but near (collective).

    Raises
    ------
    InputError
        The point is off the mesh, or on a crack, where there are two faces.
    """
    if sides := [
        found for lip in dofs.plate.cracks if (found := lip.points_beside(point)) is not None
    ]:
        (low, high), *_ = sides
        allowed = "on one of the two crack faces there: {} on the lower one, {} on the upper one"
        raise InputError(key, tuple(point), allowed.format(low, high))
    places, own = gather_rows(dofs.comm, dofs.points), dofs.first_node + np.arange(dofs.n_nodes)
    if len(found := nodes_at(places, point)):
        return np.where(own == found[0], 1.0, 0.0)
    nodes, values = compat.evaluate_basis(dofs.space, scene.mesh.order, np.array(point))
    values = np.where(np.abs(values) < 1e-12, 0.0, values)  # rounding
    hits = dofs.comm.allgather(len(nodes) > 0)
    if not any(hits):
        away, extent = np.linalg.norm(places - point, axis=1), np.ptp(places, axis=0).max()
        if scene.geometry.file is None or away.min() > FARTHEST * extent:
            raise InputError(key, tuple(point), f"on the mesh ({nearest_node(places, point)})")
        return np.where(own == int(away.argmin()), 1.0, 0.0)
    if dofs.comm.rank != hits.index(True):
        nodes, values = nodes[:0], values[:0]

    # The cell may touch nodes of other ranks: hand every node's share to its owner.
    numbers = dofs.space.dofmap.index_map.local_to_global(nodes.astype(np.int32))
    numbers = gather_rows(dofs.comm, np.asarray(numbers, dtype=np.int64))
    shares = gather_rows(dofs.comm, values)
    mine = (numbers >= dofs.first_node) & (numbers < dofs.first_node + dofs.n_nodes)
    share = np.zeros(dofs.n_nodes)
    np.add.at(share, numbers[mine] - dofs.first_node, shares[mine])
    return share


def _at_point(
    scene: Scene, dofs: Dofs, key: str, point: Vector, parts: Sequence[Vector]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Forces at the point of a load as consistent nodal forces, (len(parts), n_dofs), and their
    direction there, of the free dofs (n_local,); None: no force."""
    share = nodal_force_fractions(scene, dofs, f"{key}.point", point)
    force = np.array([_at_nodes(dofs, share, part) for part in parts])
    along = dofs.free_part(_at_nodes(dofs, share, _unit(parts))) if any(map(any, parts)) else None
    return _moving(dofs, f"{key}.point", tuple(point), force), along


def _moving(dofs: Dofs, key: str, place: object, force: np.ndarray) -> np.ndarray:
    """Forces (2K+1, n_dofs) of a load; InputError where all of them act on what is clamped."""
    parts = force, force[:, dofs.free_dofs]
    loaded, moving = (np.any(gather_rows(dofs.comm, part.ravel())) for part in parts)
    if loaded and not moving:
        raise InputError(key, place, "where the plate is free to move")
    return force


def _at_nodes(dofs: Dofs, share: np.ndarray, vector: Vector) -> np.ndarray:
    """Shares (n_nodes,) of a vector: (n_dofs,)."""
    return np.asarray(np.outer(share, vector or np.zeros(dofs.dimension)).ravel())


# --- loads on edges -------------------------------------------------------------------------------


def _edge_force(scene: Scene, dofs: Dofs, key: str, load: Load) -> np.ndarray:
    """Tractions and pressures on an edge as consistent nodal forces: (2K+1, n_dofs)."""
    name = load.given("edge")
    check_choice(f"{key}.edge", name, sorted(set(dofs.plate.groups) - {"clamp"}))
    edge = dofs.plate.measure_on(name)
    test, t = ufl.TestFunction(dofs.space), thickness(scene, dofs.space)
    x = ufl.as_vector(np.eye(dofs.dimension)[0].tolist())
    along_x = compat.assembled_vector(t * ufl.inner(x, test) * edge)
    length = gather_rows(dofs.comm, along_x).sum()
    if not length > 0.0:
        raise InputError(f"{key}.edge", load.edge, "an edge of the plate: it lies inside")
    weights = along_x.reshape(-1, dofs.dimension)[:, 0]
    force = np.array([_at_nodes(dofs, weights, part) for part in load.parts("traction")])
    normal = ufl.FacetNormal(dofs.space.mesh)
    pressed = -compat.assembled_vector(t * ufl.inner(normal, test) * edge)
    force += np.array([sum(part) * pressed for part in load.parts("pressure")])
    return _moving(dofs, f"{key}.edge", load.edge, force)


def _middle_of(dofs: Dofs, edge: str, force: np.ndarray) -> np.ndarray:
    """1 at the dof, in the direction of most of the load, of the node of an edge that is nearest
    to its middle: (n_local,)."""
    by_node = np.where(dofs.numbers < 0, 0.0, force).reshape(len(force), -1, dofs.dimension)
    sums = np.abs(dofs.comm.allgather(by_node.sum(axis=1))).sum(axis=(0, 1))
    direction = tuple(np.eye(dofs.dimension)[int(np.argmax(sums))].tolist())
    nodes = dofs.nodes_on(edge)
    every = gather_rows(dofs.comm, dofs.points[nodes])
    return _one_of(dofs, nodes, (every.min(axis=0) + every.max(axis=0)) / 2.0, 0, direction)


# --- the clamp ------------------------------------------------------------------------------------


def clamp_of(dofs: Dofs, mass: Any, force: np.ndarray) -> Clamp:
    """The clamp of a mesh, from the mass matrix and the load (2K+1, n_dofs) with the clamped rows
    (collective)."""
    held = gather_rows(dofs.comm, dofs.points[dofs.nodes_on("clamp")])
    center = np.round(0.5 * (held.min(axis=0) + held.max(axis=0)), 12) + 0.0
    rigid = rigid_motions(dofs.points - center)
    rows = dofs.free_part(np.array([_inertia(mass, motion) for motion in rigid]))
    return Clamp(center, rows, dofs.comm.allreduce(force @ rigid.T))


def rigid_motions(points: np.ndarray) -> np.ndarray:
    """Translations, and rotations about the origin by e x r, of points (n, d): (n_rigid, n d)."""
    dimension = points.shape[1]
    placed = np.pad(points, ((0, 0), (0, 3 - dimension)))
    axes = np.eye(3)[2:] if dimension == 2 else np.eye(3)
    moved = [np.tile(axis, (len(points), 1)) for axis in np.eye(dimension)]
    moved += [np.cross(axis, placed)[:, :dimension] for axis in axes]
    return np.array([motion.ravel() for motion in moved])


def _inertia(mass: Any, acceleration: np.ndarray) -> np.ndarray:
    """M a of all dofs that this rank owns: (n_dofs,) [N]."""
    moved, made = mass.createVecs()
    moved.array[:] = acceleration
    mass.mult(moved, made)
    found = np.array(made.array_r)
    moved.destroy()
    made.destroy()
    return found


def _one_of(
    dofs: Dofs, nodes: np.ndarray, place: np.ndarray, end: int, direction: Vector
) -> np.ndarray:
    """1 at the dof, in a direction, of the first (0) or the last (-1) of some nodes of all ranks by
    their distance from a place; equal ones, to rounding, by position: (n_local,)."""
    every = gather_rows(dofs.comm, dofs.points[nodes])
    distance = np.linalg.norm(every - place, axis=1)
    order = np.lexsort([*every.T, np.round(distance / max(distance.max(), 1e-300), 9)])
    here = nodes[np.all(dofs.points[nodes] == every[order[end]], axis=1)]
    found = np.zeros((dofs.n_nodes, dofs.dimension))
    found[here[:1]] = direction
    return dofs.free_part(found.ravel())
