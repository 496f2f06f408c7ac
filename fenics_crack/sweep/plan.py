"""The cases of a sweep: its geometries, and chunks of neighbouring cases of each."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import MOST_HARMONICS, InputError
from fenics_crack.fem.blocks import plate_pair_upper_bound
from fenics_crack.fem.matrix_files import table_pair_upper_bound
from fenics_crack.fem.plate import build_mesh
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import FORCES, Contact

FREQUENCIES = ("excitation.omega", "excitation.frequency")
OF_FORCES = {f"excitation.{name}" for name in FORCES}
SAME_GEOMETRY = {
    *FREQUENCIES, *OF_FORCES, *map(Contact.name_of, Contact.keys().keys() - {"pairs"}),
    "harmonic_balance.harmonics", "harmonic_balance.samples", "harmonic_balance.tolerance",
}  # fmt: skip
"""Keys that change neither mesh, matrices and modes nor the place of the load; clearances, too."""


class Chunk(NamedTuple):
    """Neighbouring cases along one axis."""

    numbers: np.ndarray  # of the cases
    cases: tuple[Scene | str, ...]  # what to solve, or why it cannot be


class Plan:
    """Geometries and chunks of a scene."""

    def __init__(self, scene: Scene) -> None:
        table, self._swept = scene.given("sweep"), scene.swept
        self._base = scene.replace({"sweep": None})
        self._rows = 2 if scene.has_friction else 1  # of each pair
        self.shape: tuple[int, ...] = table.shape  # of the table of cases
        self.reduction_swept = "reduction.method" in self._swept
        free = _free_keys(scene, self._swept)
        # Where the force is swept, geometries are built with unit loads.
        self.unit_loads = not free.isdisjoint(OF_FORCES & self._swept.keys())
        self.geometries = self._chunks(free)
        """Chunks of each geometry, as numbers of their cases."""
        base = scene.harmonic_balance  # upper bounds for all cases:
        self.harmonics = max(self._swept.get("harmonic_balance.harmonics", (base.harmonics,)))
        if base.tolerance is not None or "harmonic_balance.tolerance" in self._swept:
            self.harmonics = max(self.harmonics, MOST_HARMONICS)
        if not any(isinstance(self._case(n), Scene) for n in range(math.prod(self.shape))):
            reason = self._case(0)
            raise InputError("sweep.over", reason, "values of which a combination can be used")

    def _chunks(self, free: set[str]) -> list[list[np.ndarray]]:
        """The cases by their geometries, cut along the frequency, or else along the last axis that
        leaves a geometry alone."""
        keys = list(self._swept)
        same = [place for place, key in enumerate(keys) if key in free]
        along = ([place for place in same if keys[place] in FREQUENCIES] or same)[-1:]
        inner = [place for place in same if place not in along]
        fixed = [place for place in range(len(keys)) if place not in same]
        length = self.shape[along[0]] if along else 1
        numbers = np.arange(math.prod(self.shape)).reshape(self.shape)
        numbers = numbers.transpose([*fixed, *inner, *along])
        rows = numbers.reshape(math.prod(self.shape[place] for place in fixed), -1, length)
        pieces = -(-length // 16)  # cases of a chunk at most
        return [[c for row in of_one for c in np.array_split(row, pieces)] for of_one in rows]

    @property
    def rows(self) -> int:
        """Bound of the gaps of all geometries: of pairs, and with friction tangential ones."""
        return self._rows * max(pairs for pairs, _ in self.sizes)

    @cached_property
    def sizes(self) -> list[tuple[int, float]]:
        """Expected cost of each geometry: bound of the pairs, for which solids are meshed, and the
        first crack's length [m]."""
        bounds: dict[Any, int] = {}
        found: list[tuple[int, float]] = []
        for chunks in self.geometries:
            cases = map(self._case, itertools.chain(*chunks))
            case = next((case for case in cases if not isinstance(case, str)), None)
            if case is None:
                found.append((0, 0.0))
                continue
            pairs = case.contact and case.contact.pairs
            cracks = tuple(replace(crack, clearance=0.0) for crack in case.all_cracks.values())
            key = case.structure, case.mesh, pairs, cracks, case.geometry
            if key not in bounds:
                bounds[key] = _most_pairs(case)
            found.append((bounds[key], cracks[0].length or 0.0 if cracks else 0.0))
        return found

    def case(self, index: Sequence[int]) -> Scene | str:
        """The scene of a case, or why there is none."""
        places = zip(self._swept.items(), index, strict=True)
        changes = {key: values[at] for (key, values), at in places}
        try:
            return self._base.replace(changes)
        except InputError as error:
            return str(error)

    def _case(self, number: int) -> Scene | str:
        return self.case(np.unravel_index(number, self.shape))

    def chunk(self, numbers: np.ndarray) -> Chunk:
        """The cases of some numbers."""
        return Chunk(numbers, tuple(map(self._case, numbers)))


def _most_pairs(scene: Scene) -> int:
    """Upper bound of the contact pairs of a scene; the mesh is made of a solid alone, or read."""
    if scene.structure is not None:
        return table_pair_upper_bound(scene.structure)
    mesh, mouth = scene.mesh, scene.contact is not None and scene.contact.pairs == "mouth"
    each = 1 if mouth else mesh.patches or math.inf
    if mesh.layout == "file" or scene.dimension == 3:
        try:
            plate = build_mesh(scene, MPI.COMM_SELF)
        except InputError:
            return 0  # its cases will fail
        if not plate.has_cracks:
            return 0
        cracks = len(plate.crack_paths_or_surfaces)
        nodes = len(plate.facets("lower_lip")) * mesh.order + cracks
    else:
        cracks = len(scene.all_cracks)
        nodes = plate_pair_upper_bound(scene) if cracks else 0
    return int(min(each * cracks, nodes)) if cracks else 0


def _free_keys(scene: Scene, swept: Collection[str]) -> set[str]:
    """Keys whose values share a geometry; loads beside the force at ``excitation.point`` are part
    of it, and so are clearances of matrices."""
    free = SAME_GEOMETRY | {key for key in swept if re.fullmatch(r"crack.*\.clearance", key)}
    more = bool(scene.excitation.harmonics) or scene.excitation.wave is not None
    others = scene.has_other_loads or scene.rotation is not None or more
    if others or any(key.startswith(("base.", "loads.", "rotation.")) for key in swept):
        free -= OF_FORCES
    return free
