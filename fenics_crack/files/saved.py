"""Save and load results whose files need no structure."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

from mpi4py import MPI

from fenics_crack.basics.suggestions import check_calls
from fenics_crack.basics.tables import Tabular
from fenics_crack.files.codec import Datasets, pack_dataclass, unpack_dataclass
from fenics_crack.files.store import StoredFile, read_result_file, write_result_file
from fenics_crack.scene.scene import Scene


class SavedResult(Tabular):
    """Base class for a result with a scene that can be saved without a structure.

    Subclasses are frozen dataclasses with a class variable ``KIND``, the kind of contents in a
    file.
    """

    KIND: ClassVar[str]
    scene: Scene | None

    @check_calls
    def save(self, path: str | Path, comm: MPI.Comm = MPI.COMM_SELF) -> None:
        """Write a file that ``load``, ``fenics-crack plot`` and ``report`` read (collective).

        Raises
        ------
        InputError
            The file cannot be written.
        """
        write_result_file(self._pack_fields(), path, self.KIND, self.scene, comm)

    @classmethod
    @check_calls
    def load(cls, path: str | Path) -> Self:
        """Read a file of ``save``; nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or holds something else.
        """
        return cls.from_stored_file(read_result_file(path))

    @classmethod
    def from_stored_file(cls, stored_file: StoredFile) -> Self:
        """Return the result in a result file that was read.

        Raises as :meth:`load`.
        """
        stored_file.check_kind(cls.KIND)
        with stored_file.yield_checked_datasets() as datasets:
            result = cls._unpack_fields(datasets, stored_file.scene())
            repr(result), result.table()  # whose columns are of one length
            return result

    def _pack_fields(self) -> Datasets:
        """Return the fields as datasets by name."""
        return pack_dataclass(self)

    @classmethod
    def _unpack_fields(cls, datasets: Datasets, scene: Scene | None) -> Self:
        """Return the result from datasets by name, and the file's scene or None."""
        return unpack_dataclass(cls, datasets, scene)
