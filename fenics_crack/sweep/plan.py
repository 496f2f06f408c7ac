"""Plan a sweep: geometries, and chunks with neighbouring cases."""

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

from fenics_crack.basics.errors import MAX_HARMONIC_ORDER, InputError
from fenics_crack.fem.grading import plate_pair_upper_bound
from fenics_crack.fem.matrix_files import table_pair_upper_bound
from fenics_crack.fem.plate import build_plate_or_solid_mesh
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import FORCE_KEYS, Contact

LOAD_FREQUENCY_KEYS = ("excitation.omega", "excitation.frequency")
"""Scene keys that set the load frequency directly."""
EXCITATION_FORCE_KEYS = {f"excitation.{name}" for name in FORCE_KEYS}
"""Scene keys for the excitation's force, such as "excitation.force_sin"."""
GEOMETRY_INDEPENDENT_KEYS = {
    *LOAD_FREQUENCY_KEYS, *EXCITATION_FORCE_KEYS,
    *map(Contact.full_key, Contact.field_by_key().keys() - {"pairs"}),
    "harmonic_balance.harmonics", "harmonic_balance.samples", "harmonic_balance.tolerance",
}  # fmt: skip
"""Scene keys that change neither mesh, matrices, modes nor the load's position.

Cases that differ only in these keys share a structure.
"""


class Chunk(NamedTuple):
    """Up to 16 neighbouring sweep cases, solved one after the other.

    Each solution is the initial guess for the next case.

    Attributes
    ----------
    case_numbers : (n,) int
        Case numbers; the position on the last sweep axis changes fastest.
    scenes_or_reasons : tuple of Scene or str
        Each case's scene, or the reason why its values make no valid scene.
    """

    case_numbers: np.ndarray
    scenes_or_reasons: tuple[Scene | str, ...]


class Plan:
    """Division of a sweep into shared structures ("geometries") and chunks of cases.

    A geometry is a combination of mesh, matrices and modes. A chunk has up to 16 neighbouring cases
    with the same geometry.

    Attributes
    ----------
    shape : tuple of int
        Number of values on each sweep axis.
    is_reduction_method_swept : bool
        True if the sweep changes ``reduction.method``.
    has_unit_loads : bool
        True if the sweep changes the force, and structures are built with unit forces.
    chunk_case_numbers_by_geometry : list of list of (n,) int
        Case numbers in each chunk of each geometry.
    n_harmonics_upper_bound : int
        Upper bound for the harmonics in any case. At least 100 if a case has a tolerance, which may
        increase the number.

    Raises
    ------
    InputError
        No combination of the swept values is a valid scene.
    """

    def __init__(self, scene: Scene) -> None:
        sweep_table, self._swept_values_by_key = scene.given("sweep"), scene.swept_values_by_key
        self._scene_without_sweep = scene.replace({"sweep": None})
        self._n_gap_rows_per_pair = 2 if scene.has_friction else 1
        self.shape: tuple[int, ...] = sweep_table.shape
        self.is_reduction_method_swept = "reduction.method" in self._swept_values_by_key
        geometry_independent_keys = _find_keys_sharing_geometry(scene, self._swept_values_by_key)
        # Where the force is swept, geometries are built with unit loads.
        self.has_unit_loads = not geometry_independent_keys.isdisjoint(
            EXCITATION_FORCE_KEYS & self._swept_values_by_key.keys()
        )
        self.chunk_case_numbers_by_geometry = self._split_case_numbers_into_chunks(
            geometry_independent_keys
        )
        """Case numbers (n,) of each chunk, by geometry (shared structure)."""
        balance_table = scene.harmonic_balance
        self.n_harmonics_upper_bound = max(
            self._swept_values_by_key.get("harmonic_balance.harmonics", (balance_table.harmonics,))
        )
        """Upper bound for the harmonics in all cases."""
        if (
            balance_table.tolerance is not None
            or "harmonic_balance.tolerance" in self._swept_values_by_key
        ):
            self.n_harmonics_upper_bound = max(self.n_harmonics_upper_bound, MAX_HARMONIC_ORDER)
        if not any(
            isinstance(self._scene_or_reason_by_number(case_number), Scene)
            for case_number in range(math.prod(self.shape))
        ):
            reason = self._scene_or_reason_by_number(0)
            raise InputError(
                "sweep.over",
                self._swept_values_by_key,
                f"values that can be used in at least one case; the first is refused: {reason}",
            )

    def _split_case_numbers_into_chunks(
        self, geometry_independent_keys: set[str]
    ) -> list[list[np.ndarray]]:
        """Split case numbers by geometry, then into chunks of at most 16.

        A geometry is a structure shared by several cases. All cases in a chunk have the same values
        on every sweep axis except one. This axis is the frequency if it is swept. Otherwise it is
        the last axis that does not change the geometry. If every axis changes the geometry, a chunk
        is a single case.

        Parameters
        ----------
        geometry_independent_keys : set of str
            Scene keys that do not change the geometry.

        Returns
        -------
        list of list of (n,) int
            For each geometry, the case numbers in each chunk.
        """
        swept_keys = list(self._swept_values_by_key)
        independent_axis_indices = [
            axis_index
            for axis_index, swept_key in enumerate(swept_keys)
            if swept_key in geometry_independent_keys
        ]
        frequency_axis_indices = [
            axis_index
            for axis_index in independent_axis_indices
            if swept_keys[axis_index] in LOAD_FREQUENCY_KEYS
        ]
        chunk_axis_indices = (frequency_axis_indices or independent_axis_indices)[-1:]
        other_independent_axis_indices = [
            axis_index
            for axis_index in independent_axis_indices
            if axis_index not in chunk_axis_indices
        ]
        geometry_axis_indices = [
            axis_index
            for axis_index in range(len(swept_keys))
            if axis_index not in independent_axis_indices
        ]
        n_values_on_chunk_axis = self.shape[chunk_axis_indices[0]] if chunk_axis_indices else 1
        case_numbers = np.arange(math.prod(self.shape)).reshape(self.shape)
        case_numbers = case_numbers.transpose(
            [*geometry_axis_indices, *other_independent_axis_indices, *chunk_axis_indices]
        )
        case_numbers_by_geometry = case_numbers.reshape(
            math.prod(self.shape[axis_index] for axis_index in geometry_axis_indices),
            -1,
            n_values_on_chunk_axis,
        )
        n_chunks_along_chunk_axis = -(-n_values_on_chunk_axis // 16)  # cases of a chunk at most
        return [
            [
                chunk_case_numbers
                for case_numbers_along_chunk_axis in geometry_case_numbers
                for chunk_case_numbers in np.array_split(
                    case_numbers_along_chunk_axis, n_chunks_along_chunk_axis
                )
            ]
            for geometry_case_numbers in case_numbers_by_geometry
        ]

    @property
    def n_gap_rows_upper_bound(self) -> int:
        """Upper bound for the gap rows in any case.

        A contact pair has one row, for the normal gap. With friction it has two, for the normal and
        the tangential gap.
        """
        return self._n_gap_rows_per_pair * max(
            n_pairs for n_pairs, _ in self.max_pair_counts_and_first_crack_lengths
        )

    @cached_property
    def max_pair_counts_and_first_crack_lengths(self) -> list[tuple[int, float]]:
        """Upper bound for contact pairs, and first crack's length [m], for each geometry.

        Used to solve the largest structures first. A geometry is a structure shared by several
        cases. Both numbers are 0 if no case of the geometry is a valid scene. The length is also 0
        without a crack, and if the scene gives a natural frequency instead of the length. To find
        the bound, solids are meshed and mesh files read.
        """
        pair_bound_by_mesh: dict[Any, int] = {}
        pair_count_bounds_and_lengths: list[tuple[int, float]] = []
        for case_numbers_of_chunks in self.chunk_case_numbers_by_geometry:
            scenes_and_reasons = map(
                self._scene_or_reason_by_number, itertools.chain(*case_numbers_of_chunks)
            )
            scene = next(
                (scene for scene in scenes_and_reasons if not isinstance(scene, str)), None
            )
            if scene is None:
                pair_count_bounds_and_lengths.append((0, 0.0))
                continue
            contact_pair_kind = scene.contact and scene.contact.pairs
            cracks = tuple(replace(crack, clearance=0.0) for crack in scene.crack_by_name.values())
            mesh_dependencies = (
                scene.structure,
                scene.mesh,
                contact_pair_kind,
                cracks,
                scene.geometry,
            )
            if mesh_dependencies not in pair_bound_by_mesh:
                pair_bound_by_mesh[mesh_dependencies] = _find_pair_upper_bound(scene)
            pair_count_bounds_and_lengths.append(
                (pair_bound_by_mesh[mesh_dependencies], cracks[0].length or 0.0 if cracks else 0.0)
            )
        return pair_count_bounds_and_lengths

    def scene_or_reason_at(self, index: Sequence[int]) -> Scene | str:
        """Return a case's scene, or why its values make no valid scene.

        ``index`` is the case's position on each sweep axis.
        """
        axes_and_value_indices = zip(self._swept_values_by_key.items(), index, strict=True)
        changes = {
            swept_key: axis_values[value_index]
            for (swept_key, axis_values), value_index in axes_and_value_indices
        }
        try:
            return self._scene_without_sweep.replace(changes)
        except InputError as error:
            return str(error)

    def _scene_or_reason_by_number(self, case_number: int) -> Scene | str:
        """Return a case's scene, or why its values make no valid scene.

        ``case_number`` counts the cases from 0; the position on the last sweep axis changes
        fastest.
        """
        return self.scene_or_reason_at(np.unravel_index(case_number, self.shape))

    def make_chunk(self, case_numbers: np.ndarray) -> Chunk:
        """Return the chunk with the given case numbers (n,).

        A chunk has the scene of each case, or the reason why its values make no valid scene.
        """
        return Chunk(case_numbers, tuple(map(self._scene_or_reason_by_number, case_numbers)))


def _find_pair_upper_bound(scene: Scene) -> int:
    """Return an upper bound for a scene's number of contact pairs.

    For a solid the mesh is made, and a mesh file is read. If this fails, the bound is 0, since the
    cases will fail, too. For any other plate, and for given matrices, the bound needs no mesh.
    """
    if scene.structure is not None:
        return table_pair_upper_bound(scene.structure)
    mesh_table = scene.mesh
    has_mouth_contact_only = scene.contact is not None and scene.contact.pairs == "mouth"
    max_pairs_per_crack = 1 if has_mouth_contact_only else mesh_table.patches or math.inf
    if mesh_table.layout == "file" or scene.dimension == 3:
        try:
            mesh = build_plate_or_solid_mesh(scene, MPI.COMM_SELF)
        except InputError:
            return 0  # its cases will fail
        if not mesh.has_cracks:
            return 0
        n_cracks = len(mesh.crack_paths_or_surfaces)
        n_face_nodes = len(mesh.facets("lower_lip")) * mesh_table.order + n_cracks
    else:
        n_cracks = len(scene.crack_by_name)
        n_face_nodes = plate_pair_upper_bound(scene) if n_cracks else 0
    return int(min(max_pairs_per_crack * n_cracks, n_face_nodes)) if n_cracks else 0


def _find_keys_sharing_geometry(scene: Scene, swept_keys: Collection[str]) -> set[str]:
    """Return the scene keys that cases with the same structure may change.

    These are :data:`GEOMETRY_INDEPENDENT_KEYS` and swept crack clearances. The force keys are left
    out unless each case's load is a sum of scaled unit forces. It is not if the scene has other
    loads than the force, force harmonics, a force wave, or rotation. It is not either if a key of
    [base], [loads] or [rotation] is swept.

    ``swept_keys`` are the scene keys that the sweep changes.
    """
    geometry_independent_keys = GEOMETRY_INDEPENDENT_KEYS | {
        swept_key for swept_key in swept_keys if re.fullmatch(r"crack.*\.clearance", swept_key)
    }
    has_load_harmonics_or_wave = (
        bool(scene.excitation.harmonics) or scene.excitation.wave is not None
    )
    has_unscaled_load = (
        scene.has_other_loads or scene.rotation is not None or has_load_harmonics_or_wave
    )
    if has_unscaled_load or any(
        swept_key.startswith(("base.", "loads.", "rotation.")) for swept_key in swept_keys
    ):
        geometry_independent_keys -= EXCITATION_FORCE_KEYS
    return geometry_independent_keys
