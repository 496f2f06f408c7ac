"""The structure of a scene whose matrices are in Matrix Market files."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from fenics_crack.errors import InputError, reading
from fenics_crack.model.damping import DampingRule
from fenics_crack.model.matrices import whole_rows
from fenics_crack.model.matrix_market import matrix_market_shape
from fenics_crack.model.structure import Structure
from fenics_crack.scene.tables import Structure as Table

__all__ = ["count_pairs", "read_structure"]

FILES = ("gap", "force_sin", "force_cos", "force_mean")


def read_structure(table: Table, rule: DampingRule | None, comm: MPI.Comm) -> Structure:
    """Make the structure of a scene's table ``[structure]`` (collective).

    Every rank reads the files and keeps its rows. ``rule``: the damping, unless it is a file.

    Raises
    ------
    InputError
        A file cannot be read, a shape does not fit, an entry is not finite, a matrix is not
        symmetric, or the mass is not positive definite.
    """
    files = {name: Path(path) for name in FILES if (path := getattr(table, name)) is not None}
    try:
        clearance, pairs = table.clearance, count_pairs(table)
        if isinstance(clearance, str) and table.gap is not None and not pairs:
            clearance = 0.0  # the matrix of the gaps is refused
        if isinstance(clearance, str):
            clearance = whole_rows("clearance", Path(clearance), pairs).toarray().ravel()
        return Structure.from_matrices(
            Path(table.mass),
            Path(table.stiffness),
            files.pop("gap", None),
            clearance=clearance,
            damping=rule if table.damping is None else Path(table.damping),
            comm=comm,
            **files,
        )
    except InputError as error:
        if error.key not in table.keys():
            raise
        path, found = getattr(table, error.key), error.value
        value = path if found == path else f"{path} ({found})"
        raise InputError(table.name_of(error.key), value, error.allowed) from None


def count_pairs(table: Table) -> int:
    """Number of contact pairs of a scene's table ``[structure]``; 0 if the file is unusable."""
    if table.gap is None:
        return 0
    try:
        with reading("structure.gap", table.gap, "a Matrix Market file"):
            return matrix_market_shape(Path(table.gap))[1]
    except InputError:  # who reads it will say why
        return 0
