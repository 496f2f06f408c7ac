"""The displacements that a scene watches: those of its named points, or one under the load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import gather_rows
from fenics_crack.scene.scene import Scene

__all__ = ["Watched", "watched_dofs"]


@dataclass(frozen=True)
class Watched:
    """A displacement that is watched.

    Attributes
    ----------
    name : str
        "tip.ux", with which the names of its quantities begin; empty for the load's.
    words : str
        "x displacement of tip".
    dof : int
        Of the whole structure.
    distance : float [m]
        From the point in the scene to the node that is watched.
    """

    name: str
    words: str
    dof: int
    distance: float = 0.0

    def column(self, quantity: str) -> str:
        """The name of one of its quantities: "tip.ux.ratio_2_1", or "ratio_2_1"."""
        return f"{self.name}.{quantity}" if self.name else quantity


def watched_dofs(scene: Scene, structure: Structure) -> tuple[Watched, ...]:
    """What a scene watches of its structure, not reduced (collective).

    The points of ``[output.points]``, x before y, where they are free to move; without them what
    the structure watches, or the dof that carries most of the load.

    Raises
    ------
    InputError
        A point is not near a node of its own, or the structure has no nodes.
    """
    points = () if scene.output is None else scene.output.points
    if not points:
        given = structure.watched
        if given is None:
            dof = structure.most_loaded()
        else:
            dof = int(np.argmax(gather_rows(structure.comm, np.abs(given))))
        return (Watched("", structure.dof_name(dof), dof),)
    found = []
    for point in points:
        key = f"output.points.{point.key}"
        if structure.nodes is None:
            raise InputError(key, point.values, "left out: the structure has no positions")
        place, dofs = structure.nodes.nearest(structure.comm, key, point.values)
        distance = float(np.linalg.norm(place - point.values).round(12))
        for axis, dof in zip("xy", dofs, strict=True):
            if dof >= 0:
                words = f"{axis} displacement of {point.key}"
                found.append(Watched(f"{point.key}.u{axis}", words, int(dof), distance))
    return tuple(found)
