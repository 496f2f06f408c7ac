"""The structure of a command in a file beside its results, for later commands.

The file has the matrices and modes of a mesh at rest, and of its coarser mesh. A scene with the
same :func:`digest_of_dependencies` can use the file. Frequency, load amplitude, damping, clearance,
law and tolerance may differ; the mesh may not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.atomic_files import check_disk_space
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.fem.setting import list_mean_cos_and_sin_force_vectors
from fenics_crack.files.codec import DATASET_ERROR_CLASSES, pack_dataclass, unpack_dataclass
from fenics_crack.files.store import program_fingerprint_text, read_result_file, write_result_file
from fenics_crack.model.factor import local_rows
from fenics_crack.scene.scene import Scene
from fenics_crack.study.artefact import (
    GatheredCsrMatrix,
    PreparedFileContent,
    PreparedStructure,
    dependencies_without_amplitudes,
    weight_matrix_of_load_rows,
)
from fenics_crack.study.sharing import (
    SharedStructure,
    dependencies_of_structure,
    make_empty_coarser_structure_list,
)

STRUCTURE_FILE_KIND = "structure of a command"
MAX_STRUCTURE_FILE_BYTES = 500 * 10**6
"""Maximum size of all arrays in a structure file [byte]; a larger structure is not kept."""
MIN_FREE_FILE_SIZES = 10
"""A structure is kept if the disk has room for so many of its files: results come first."""


def digest_of_dependencies(dependencies: tuple[Any, Any, Any]) -> str:
    """Return a SHA-256 digest, equal for scenes with the same structure.

    ``dependencies`` come from :func:`dependencies_of_structure`. Load amplitudes, clearances and
    damping do not change the digest. Changed files of this program or its libraries do.
    """
    digest_inputs = dependencies_without_amplitudes(dependencies), program_fingerprint_text()
    return hashlib.sha256(repr(digest_inputs).encode()).hexdigest()


class StructureFile:
    """File in which a command keeps its structure for later commands.

    Parameters
    ----------
    path : Path
        The file.
    print_line : callable
        Prints a line.
    is_read : bool
        Use the structure in the file; if False, the file is only written (option ``--fresh``).
    """

    def __init__(self, path: Path, print_line: Callable[[str], None], *, is_read: bool) -> None:
        self._path, self._print_line, self._n_stored_bytes = path, print_line, 0
        self._cached_prepared_files: list[PreparedFileContent | None] = [] if is_read else [None]
        self._noted_structures_and_scenes: list[tuple[SharedStructure, Scene]] = []

    def read_shared_structure_or_none(self, scene: Scene, comm: MPI.Comm) -> SharedStructure | None:
        """Return a scene's structure from the file, or None (collective).

        None if the file is missing or unusable; then a line is printed. Also None if the file has
        another mesh, or was written by another program version.
        """
        try:
            if not self._cached_prepared_files:
                stored_file = read_result_file(self._path, comm)
                stored_file.check_kind(STRUCTURE_FILE_KIND)
                with stored_file.yield_datasets_with_valid_numbers() as datasets:
                    self._cached_prepared_files.append(
                        unpack_dataclass(PreparedFileContent, datasets)
                    )
            prepared_file = self._cached_prepared_files[0]
            if prepared_file is None or prepared_file.structure.key != digest_of_dependencies(
                dependencies_of_structure(scene, comm)
            ):
                return None
            shared_structure = prepared_file.make_shared_structure(
                scene, weight_matrix_of_load_rows(prepared_file.structure.excitation, scene), comm
            )
        except (InputError, *DATASET_ERROR_CLASSES) as error:
            self._cached_prepared_files[:] = [None]
            self._print_line(
                f"{self._path} is not used, and the structure is computed anew: {error}"
            )
            return None
        self._noted_structures_and_scenes[:] = [(shared_structure, scene)]
        self._n_stored_bytes = _count_dataset_bytes(pack_dataclass(prepared_file))
        read_from_file_text = (
            f"the structure is read from this file ({self._n_stored_bytes / 1e6:.3g} MB)"
        )
        self._print_line(f"{self._path}: {read_from_file_text}; --fresh computes it again")
        return shared_structure

    def note_structure_for_writing(self, shared_structure: SharedStructure, scene: Scene) -> None:
        """Note a structure, for :meth:`write_noted_structure` to write.

        At most one structure is noted. A later structure with the same mesh replaces it; a
        structure with another mesh is ignored. ``scene`` is the scene of the structure.
        """
        if (
            not self._noted_structures_and_scenes
            or self._noted_structures_and_scenes[0][0].dependencies[0]
            == shared_structure.dependencies[0]
        ):
            self._noted_structures_and_scenes[:] = [(shared_structure, scene)]

    def write_noted_structure(self, comm: MPI.Comm) -> None:
        """Write the noted structure with its coarser structure (collective).

        Nothing is written if the arrays that were read from the file are at least as large. If
        writing fails, the arrays exceed 500 MB or a tenth of the disk's free space, a line is
        printed.
        """
        for shared_structure, scene in self._noted_structures_and_scenes:
            if shared_structure.comm.size < comm.size and comm.rank:
                return  # each rank has a structure for itself
            coarser_shared_structures = shared_structure.structure.compute_once(
                make_empty_coarser_structure_list, from_matrices=True
            )
            coarser_shared_structures = [
                coarser_shared_structure
                for coarser_shared_structure in coarser_shared_structures
                if coarser_shared_structure.dependencies[1] == shared_structure.dependencies[1]
            ]  # of this load
            dataset_by_name = pack_dataclass(
                PreparedFileContent(
                    *(
                        _gather_prepared_structure(stored_structure, scene)
                        for stored_structure in (shared_structure, *coarser_shared_structures)
                    )
                )
            )
            if not self._n_stored_bytes < (
                n_dataset_bytes := _count_dataset_bytes(dataset_by_name)
            ):
                return
            try:
                if n_dataset_bytes > MAX_STRUCTURE_FILE_BYTES:
                    raise InputError(
                        "path",
                        str(self._path),
                        f"a file of at most {MAX_STRUCTURE_FILE_BYTES / 1e6:g} MB",
                    )
                on_root(
                    shared_structure.comm,
                    partial(check_disk_space, self._path, MIN_FREE_FILE_SIZES * n_dataset_bytes),
                )
                write_result_file(
                    dataset_by_name,
                    self._path,
                    STRUCTURE_FILE_KIND,
                    scene,
                    shared_structure.comm,
                    is_compressed=False,
                )
            except InputError as error:
                self._print_line(
                    "the structure is not kept, and the next command computes it anew; "
                    f"results are not affected: {error}"
                )


def _gather_prepared_structure(
    shared_structure: SharedStructure, scene: Scene
) -> PreparedStructure:
    """Gather a structure's data and matrices from all ranks, for a file (collective)."""
    return PreparedStructure.gather(
        shared_structure.structure,
        shared_structure.structure.nodes.vtk_type,  # type: ignore[union-attr]
        mass=GatheredCsrMatrix.gather(
            local_rows(shared_structure.structure.mass), shared_structure.comm
        ),
        key=digest_of_dependencies(shared_structure.dependencies),
        stiffness=GatheredCsrMatrix.gather(
            local_rows(shared_structure.structure.stiffness), shared_structure.comm
        ),
        excitation=np.array(list_mean_cos_and_sin_force_vectors(scene), dtype=float),
    )  # fmt: skip


def _count_dataset_bytes(dataset_by_name: Mapping[str, Any]) -> int:
    """Return the total size of the arrays in ``dataset_by_name`` [byte]."""
    return sum(
        dataset.nbytes for dataset in dataset_by_name.values() if isinstance(dataset, np.ndarray)
    )
