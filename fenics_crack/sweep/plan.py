"""The cases of a sweep: its geometries, and chunks of neighbouring cases of each."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import MOST_HARMONICS, InputError
from fenics_crack.fem.blocks import lip_pairs
from fenics_crack.fem.matrix_files import count_pairs
from fenics_crack.fem.plate import build_mesh
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.file import PENDING, shape_of

__all__ = ["FORCES", "Chunk", "Index", "Plan", "everywhere"]

CHUNK = 12
"""Most cases of a chunk."""
SAME_GEOMETRY = (
    "excitation.omega", "excitation.frequency", "excitation.force_sin", "excitation.force_cos",
    "excitation.force_mean",
    "contact.stiffness", "contact.stiffness_per_area", "contact.law", "contact.sharpness",
    "harmonic_balance.harmonics", "harmonic_balance.samples",
    "harmonic_balance.tolerance",
)  # fmt: skip
"""Keys that change neither mesh, matrices and modes nor the place of the load; clearances, too."""
FORCES = ("force_mean", "force_cos", "force_sin")
"""Parts of the load."""

Index = tuple[Any, ...]
"""A whole number on each axis, and a slice on one."""


@dataclass(frozen=True)
class Chunk:
    """Neighbouring cases along one axis."""

    index: Index  # their place in the table
    cases: tuple[Scene | str, ...]  # what to solve, or why it cannot be


class Plan:
    """Geometries and chunks of a scene."""

    def __init__(self, scene: Scene) -> None:
        assert scene.sweep is not None
        self._base = scene.replace({"sweep": None})
        self._axes = scene.sweep.over
        swept = {axis.key: axis.values for axis in self._axes}
        keys = list(swept)
        if scene.sweep.ranks > 1 and scene.reduction is None:  # on one rank too
            self._base = self._base.replace({"reduction.method": None})
        self.shape = shape_of(scene)  # of the table of cases
        # Where the force is swept, geometries are built with unit loads.
        forces = {f"excitation.{name}" for name in FORCES}
        self.unit_loads = not forces.isdisjoint(keys) and not _has_other_loads(scene, keys)
        self.reduction_swept = "reduction.method" in keys
        free = self._free_keys(scene, keys)
        same = [number for number, key in enumerate(keys) if key in free]
        self._along = same[-1] if same else None
        for key in ("excitation.omega", "excitation.frequency"):
            if key in keys:
                self._along = keys.index(key)
        self._inner = [number for number in same if number != self._along]
        # Places of the geometries: an index on each axis that changes them, None on the others.
        ranges = ((None,) if n in same else range(size) for n, size in enumerate(self.shape))
        self.geometries = list(itertools.product(*ranges))
        base = scene.harmonic_balance  # upper bounds for all cases:
        self.harmonics = max(swept.get("harmonic_balance.harmonics", (base.harmonics,)))
        if base.tolerance is not None or "harmonic_balance.tolerance" in swept:
            self.harmonics = max(self.harmonics, MOST_HARMONICS)
        self.sizes = self._sizes()
        """What each geometry may cost: bound of the pairs, and the first crack's length [m]."""
        self.pairs = max(pairs for pairs, _ in self.sizes)

    @staticmethod
    def _free_keys(scene: Scene, keys: list[str]) -> set[str]:
        """Keys whose values share a geometry; loads beside the force are part of it, and so is the
        frequency where the clamp's displacement is given."""
        free = {*SAME_GEOMETRY, *filter(_is_clearance_of_crack, keys)}
        if _has_other_loads(scene, keys):
            free -= {f"excitation.{name}" for name in FORCES}
        given = scene.base is not None and scene.base.moves_by_displacement
        if given or any(key.startswith("base.displacement") for key in keys):
            free -= {"excitation.omega", "excitation.frequency"}
        return free

    def _sizes(self) -> list[tuple[int, float]]:
        """The sizes of all geometries; raise InputError if no combination is a scene."""
        bounds: dict[Any, int] = {}
        found: list[tuple[int, float]] = []
        for geometry in self.geometries:
            index = (
                range(n) if at is None else (at,)
                for at, n in zip(geometry, self.shape, strict=True)
            )
            cases = map(self.case, itertools.product(*index))
            case = next((case for case in cases if not isinstance(case, str)), None)
            if case is None:
                found.append((0, 0.0))
                continue
            if case.structure is not None:
                found.append((count_pairs(case.structure), 0.0))
                bounds[case.structure.gap] = found[-1][0]
                continue
            pairs = case.contact and case.contact.pairs
            cracks = tuple((c.edge, c.center, c.height, c.length) for c in case.all_cracks.values())
            key = case.mesh, pairs, cracks, case.geometry.width, case.geometry.height
            if key not in bounds:
                bounds[key] = _most_pairs(case)
            found.append((bounds[key], cracks[0][-1] or 0.0 if cracks else 0.0))
        if not bounds:
            reason = self.case((0,) * len(self.shape))
            raise InputError("sweep.over", reason, "values of which a combination can be used")
        return found

    def case(self, index: tuple[int, ...]) -> Scene | str:
        """The scene of a case, or why there is none."""
        changes = {axis.key: axis.values[at] for axis, at in zip(self._axes, index, strict=True)}
        try:
            return self._base.replace(changes)
        except InputError as error:
            return str(error)

    def pending(self, geometry: tuple[int | None, ...], state: np.ndarray) -> list[Index]:
        """Places of the chunks of a geometry that are not complete."""
        found = []
        along = len(self.shape) - 1 if self._along is None else self._along
        axes = [
            range(size) if number in self._inner else (at,)
            for number, (at, size) in enumerate(zip(geometry, self.shape, strict=True))
        ]
        for place in itertools.product(*axes):
            at = place[along]
            first, length = (0, self.shape[along]) if at is None else (at, 1)
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
    """Upper bound of the contact pairs of a scene; only a mesh file is read."""
    mesh, mouth = scene.mesh, scene.contact is not None and scene.contact.pairs == "mouth"
    if mesh.layout == "file":
        try:
            plate = build_mesh(scene, MPI.COMM_SELF)
        except InputError:
            return 0  # its cases will fail
        if not plate.cracked:
            return 0
        facets = len(plate.facets("lower_lip"))
        return len(plate.lips) if mouth else facets * mesh.order + len(plate.lips)
    if not scene.all_cracks:
        return 0
    return len(scene.all_cracks) if mouth else lip_pairs(scene)


def _is_clearance_of_crack(key: str) -> bool:
    """Those of matrices are part of these."""
    return key.startswith("crack") and key.endswith(".clearance")


def _has_other_loads(scene: Scene, keys: list[str]) -> bool:
    """Whether a case may have a load beside the force at ``excitation.point``."""
    given = scene.has_other_loads or scene.rotation is not None
    return given or any(key.startswith(("base.", "loads.", "rotation.")) for key in keys)


def everywhere(geometry: tuple[int | None, ...]) -> tuple[Any, ...]:
    """Index of all cases of a geometry."""
    return tuple(slice(None) if at is None else at for at in geometry)
