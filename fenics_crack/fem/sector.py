"""The sector of a bladed disk: its sides, whose nodes match, and the faces of its crack.

The left side turned about the axis by 2 pi / N, one way or the other, is the right side, node by
node; there displacements are those in the frame of the next sector. What is bonded in sectors
without a crack are the nodes of both faces in the same place.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.fem.blocks import RIM_SIDES
from fenics_crack.fem.cracks import LIP_TAGS, POSITION_TOLERANCE
from fenics_crack.fem.elasticity import rotation_of
from fenics_crack.fem.plate import Dofs
from fenics_crack.model.cyclic import Sector
from fenics_crack.model.modes import times
from fenics_crack.model.nodes import place_in_words
from fenics_crack.model.structure import Structure
from fenics_crack.model.wheel import Wheel
from fenics_crack.scene.scene import Scene


def assemble_wheel(scene: Scene, dofs: Dofs, structure: Structure, comm: MPI.Comm) -> Wheel:
    """The bladed disk of a scene from its sector, which every rank has (collective).

    Raises
    ------
    InputError
        The crack reaches a side, or the rotor is so fast that the wheel is unstable.
    """
    disk = scene.given("disk")
    sector, rotation = _sector(scene, dofs, structure), None
    if scene.speed > 0.0:
        with sector.factored() as same:  # a load that is the same on all sectors
            rotation = rotation_of(scene, dofs, structure, same.answers)
        still, stiffness = rotation.stiffnesses(scene.speed)
        # K(W) u_s, with the stress and the displaced shape of bonded cracks, which the load opens.
        force, load = structure.force.copy(), scene.speed**2 * rotation.force
        stiffened = replace(sector, structure=structure._changed(stiffness=still))
        with stiffened.factored() as same:
            moved = same.answers(load[:, None])
        force[0] += load + (times(stiffness, moved) - times(still, moved))[:, 0]
        turning = structure._changed(stiffness=stiffness, force=force)
        sector = replace(sector, structure=turning)
    return Wheel(
        sector, cracked=[number - 1 for number in disk.has_cracks], mistuning=disk.deviations,
        order=scene.excitation.order or 0, families=disk.families, rotation=rotation, comm=comm,
    )  # fmt: skip


def turn_sides(scene: Scene, dofs: Dofs) -> None:
    """Find the sides of a sector, and turn the right one into the frame of the next sector.

    Raises
    ------
    InputError
        The mesh has no sides, or their nodes do not match.
    """
    from scipy.spatial.transform import Rotation  # with what only meshes of sectors need

    disk, (center, axis) = scene.given("disk"), scene.axis
    points, size = dofs.points, float(np.ptp(dofs.points, axis=0).max())
    names = RIM_SIDES if RIM_SIDES[0] in dofs.plate.groups else ("left", "right")
    for name in names:
        if name not in dofs.plate.groups:
            allowed = "a mesh of one sector whose sides are named 'left' and 'right'"
            raise InputError("mesh.file", f"without a side named {name!r}", allowed)
    left, right = (dofs.nodes_on(name) for name in names)
    space = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    angles = (2.0 * math.pi / disk.sectors, -2.0 * math.pi / disk.sectors)
    turns = [Rotation.from_rotvec(angle * axis).as_matrix() for angle in angles]
    matched = [_matched((space[left] - center) @ turn.T + center, space[right]) for turn in turns]
    nearer = min((0, 1), key=lambda way: matched[way][0])
    (distance, place, partner), turn = matched[nearer], turns[nearer]
    if distance > POSITION_TOLERANCE * size:
        where = place_in_words(points[left[place]])
        found = f"{len(left)} nodes of the left side and {len(right)} of the right one"
        allowed = f"sides that match: the left one, turned about the axis by 360/{disk.sectors}"
        allowed += " degrees, is the right one node by node;"
        allowed += f" that at {where} is {distance:.2g} m from the nearest"
        raise InputError("mesh.file" if names[0] == "left" else "disk", found, allowed)
    if len(shared := np.intersect1d(left, right)):
        where = place_in_words(points[shared[0]])
        allowed = f"a disk with a hole: both sides have the node at {where}"
        raise InputError("mesh.file", "a sector that reaches the axis", allowed)
    d = points.shape[1]
    dofs.set_sector_sides(np.array([left, right[partner]]), turn[:d, :d])


def _sector(scene: Scene, dofs: Dofs, structure: Structure) -> Sector:
    points, sides, frames = dofs.points, dofs.sides, dofs.frames
    assert sides is not None and frames is not None
    lips = np.zeros((2, 0), dtype=int)
    if dofs.plate.has_cracks:  # faces without tips, which are bonded
        lower, upper = (dofs.nodes_on(name) for name in LIP_TAGS)
        lower, upper = np.setdiff1d(lower, upper), np.setdiff1d(upper, lower)
        distance, place, partner = _matched(points[lower], points[upper])
        if distance > POSITION_TOLERANCE * float(np.ptp(points, axis=0).max()):
            where = place_in_words(points[lower[place]])
            allowed = f"meshed identically, so that they can be bonded, but not at {where}"
            raise InputError("lips", f"{len(lower)} lower and {len(upper)} upper nodes", allowed)
        lips = np.array([lower, upper[partner]])
    if len(shared := np.intersect1d(lips, sides)):
        allowed = f"away from the sides of its sector, not at {place_in_words(points[shared[0]])}"
        raise InputError("lips", "a crack", allowed)
    center, turn = scene.axis[0][: points.shape[1]], frames[sides[1, 0]]
    count = scene.given("disk").sectors
    return Sector(structure, count, center, turn, sides, lips, structure.stiffness)


def _matched(moved: np.ndarray, places: np.ndarray) -> tuple[float, int, np.ndarray]:
    """Largest distance of places from the nearest of others, of which one, and these; infinite
    where they are not as many, or one is the nearest of two."""
    from scipy.spatial import cKDTree

    distance, partner = cKDTree(places).query(moved)
    worst = int(np.argmax(distance))
    twice = len(places) != len(moved) or len(np.unique(partner)) != len(partner)
    return (math.inf if twice else float(distance[worst])), worst, partner
