"""The cases of a sweep: which geometries there are, and chunks of neighbouring cases of each."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.fem.plate import build_mesh
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.file import PENDING, shape_of

__all__ = ["FORCES", "Chunk", "Index", "Plan", "everywhere"]

CHUNK = 12
"""Cases of a chunk at most."""
SAME_GEOMETRY = (
    "excitation.omega", "excitation.force_sin", "excitation.force_cos", "excitation.force_mean",
    "contact.stiffness", "contact.stiffness_per_area", "contact.law", "contact.sharpness",
    "crack.clearance", "harmonic_balance.harmonics", "harmonic_balance.samples",
)  # fmt: skip
"""Keys that leave mesh, matrices, modes and the place of the load alone."""
FORCES = ("force_mean", "force_cos", "force_sin")
"""Parts of the load."""

Index = tuple[Any, ...]
"""A whole number on each axis, and a slice on one."""


@dataclass(frozen=True)
class Chunk:
    """Neighbouring cases along one axis.

    Attributes
    ----------
    index : Index
        Where they are in the table.
    cases : tuple of Scene or str
        What to solve, or why it cannot be.
    """

    index: Index
    cases: tuple[Scene | str, ...]


class Plan:
    """Geometries and chunks of a scene.

    Attributes
    ----------
    shape : tuple of int
        Of the table of cases.
    geometries : list of tuple
        Where the geometries are: an index on each axis that changes them, None on the others.
    harmonics, pairs : int
        Most of any case; an upper bound.
    unit_loads : bool
        Whether the force is swept, so that geometries are to be built with unit loads.
    """

    def __init__(self, scene: Scene) -> None:
        assert scene.sweep is not None
        self._base = scene.replace({"sweep": None})
        self._axes = scene.sweep.over
        keys = [axis.key for axis in self._axes]
        if scene.sweep.ranks > 1 and scene.reduction is None:  # on one rank too
            self._base = self._base.replace({"reduction.method": "free_interface"})
        self.shape = shape_of(scene)
        self.unit_loads = any(f"excitation.{name}" in keys for name in FORCES)
        self.reduction_swept = "reduction.method" in keys
        same = [number for number, key in enumerate(keys) if key in SAME_GEOMETRY]
        self._along = same[-1] if same else None
        if "excitation.omega" in keys:
            self._along = keys.index("excitation.omega")
        self._inner = [number for number in same if number != self._along]
        self.geometries = list(
            itertools.product(
                *((None,) if n in same else range(size) for n, size in enumerate(self.shape))
            )
        )
        counts = [scene.harmonic_balance.harmonics]
        for axis in self._axes:
            if axis.key == "harmonic_balance.harmonics":
                counts = list(axis.values)
        self.harmonics = max(counts)
        self._measure()

    def _measure(self) -> None:
        """Find the bound of the pairs; raise InputError if no combination is a scene."""
        bounds: dict[Any, int] = {}
        found, reason = False, ""
        for geometry in self.geometries:
            ranges = [range(size) if at is None else (at,)
                      for at, size in zip(geometry, self.shape, strict=True)]  # fmt: skip
            for index in itertools.product(*ranges):
                case = self.case(index)
                if not isinstance(case, str):
                    found = True
                    pairs = case.contact and case.contact.pairs
                    length = case.crack and case.crack.length
                    key = case.mesh, pairs, length, case.geometry.width
                    if key not in bounds:
                        bounds[key] = _most_pairs(case)
                    break
                reason = reason or case
        if not found:
            raise InputError("sweep.over", reason, "values of which a combination can be used")
        self.pairs = max(bounds.values())

    def case(self, index: tuple[int, ...]) -> Scene | str:
        """The scene of a case, or why there is none."""
        changes = {axis.key: axis.values[at] for axis, at in zip(self._axes, index, strict=True)}
        try:
            return self._base.replace(changes)
        except InputError as error:
            return str(error)

    def pending(self, geometry: tuple[int | None, ...], state: np.ndarray) -> list[Index]:
        """Where the chunks of a geometry are that are not complete."""
        found = []
        along = len(self.shape) - 1 if self._along is None else self._along
        for inner in itertools.product(*(range(self.shape[number]) for number in self._inner)):
            place: list[Any] = list(geometry)
            for number, at in zip(self._inner, inner, strict=True):
                place[number] = at
            first, length = 0, self.shape[along]
            if self._along is None:  # a chunk is one case
                first, length = place[along], 1
            pieces = -(-length // CHUNK)
            for piece in range(pieces):
                low, high = (first + (length * n) // pieces for n in (piece, piece + 1))
                index = (*place[:along], slice(low, high), *place[along + 1 :])
                if np.any(state[index] == PENDING):
                    found.append(index)
        return found

    def chunk(self, index: Index) -> Chunk:
        """The chunk at a place."""
        ranges = (range(at.start, at.stop) if isinstance(at, slice) else (at,) for at in index)
        return Chunk(index, tuple(map(self.case, itertools.product(*ranges))))


def _most_pairs(scene: Scene) -> int:
    """Upper bound of the contact pairs of a scene; meshed only where there is a mesh file."""
    mesh, crack = scene.mesh, scene.crack
    if scene.contact is not None and scene.contact.pairs == "mouth":
        return 1
    if mesh.layout == "file":
        try:
            plate = build_mesh(scene, MPI.COMM_SELF)
        except InputError:
            return 0  # its cases will fail
        if not plate.cracked:
            return 0
        return len(plate.facet_tags.find(plate.groups["lower_lip"])) * mesh.order + 1
    if crack is None:
        return 0
    if mesh.layout == "graded":
        assert mesh.lip_elements is not None
        return mesh.lip_elements * mesh.order
    assert mesh.columns is not None and crack.length is not None and scene.geometry.width
    return round(crack.length / scene.geometry.width * mesh.columns) * mesh.order


def everywhere(geometry: tuple[int | None, ...]) -> tuple[Any, ...]:
    """Index of all cases of a geometry."""
    return tuple(slice(None) if at is None else at for at in geometry)
