"""Results that their files hold by themselves, without a structure."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

from mpi4py import MPI

from fenics_crack.basics.suggestions import check_calls
from fenics_crack.basics.tables import Tabular
from fenics_crack.files.codec import Parts, packed, unpacked
from fenics_crack.files.store import Stored, read, write
from fenics_crack.scene.scene import Scene


class Saved(Tabular):
    """A frozen dataclass with a scene whose fields a file has (:mod:`fenics_crack.files.codec`)."""

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
        write(self._packed(), path, self.KIND, self.scene, comm)

    @classmethod
    @check_calls
    def load(cls, path: str | Path) -> Self:
        """Read a file of ``save``; nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or is of something else.
        """
        return cls.of(read(path))

    @classmethod
    def of(cls, stored: Stored) -> Self:
        """The same of a file that has been read."""
        stored.fitting_argument(cls.KIND)
        with stored.taken() as parts:
            found = cls._unpacked(parts, stored.scene())
            repr(found), found.table()  # whose columns are of one length
            return found

    def _packed(self) -> Parts:
        return packed(self)

    @classmethod
    def _unpacked(cls, parts: Parts, scene: Scene | None) -> Self:
        return unpacked(cls, parts, scene)
