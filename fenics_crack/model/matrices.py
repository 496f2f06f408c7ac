"""Matrices and vectors from elsewhere, read and checked: NumPy, SciPy, PETSc, Matrix Market.

Other programs write most of theirs with a node and a direction of each row.

==================  ==============================================================================
.sti, .mas          CalculiX, ``*FREQUENCY, SOLVER=MATRIXSTORAGE``: row, column, value of one
                    triangle; node and direction of each row in the .dof beside it
.mtx                Abaqus, ``*MATRIX OUTPUT, FORMAT=MATRIX INPUT``: node, direction, node,
                    direction, value of one triangle; or Matrix Market, as any other ending
.pch                Nastran, ``PARAM,EXTOUT,DMIGPCH``: matrices KAAX, MAAX, BAAX of one triangle
.op4                Nastran, ``OUTPUT4`` as text (``FORM=FORMATTED``): by columns, dense or sparse
==================  ==============================================================================

Rows of an .op4 or a Matrix Market file get their nodes from a file of their own: that of CalculiX,
or what Ansys' ``HBMAT`` writes beside the matrix that ``*EXPORT`` writes.

Matrix Market files (Boisvert, Pozo and Remington, The Matrix Market exchange formats, NISTIR 5935,
1996) are read strictly. SciPy's reader relies on what a file announces: depending on its version it
does not end, requests all memory, or crashes where the file is damaged. Here no file has more
entries than it has bytes for, and a packed one is unpacked up to a limit that follows from its own
size.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.errors import MOST_HARMONICS, InputError, check_count, reading
from fenics_crack.basics.ranks import gather_rows, on_each
from fenics_crack.basics.tables import counted
from fenics_crack.basics.untrusted_files import opened_text, rows_in
from fenics_crack.model.factor import (
    TOLERATED,
    Factor,
    distributed,
    factored_sum,
    local_rows,
    weighted_sum,
)
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.scene.fields import LARGEST

DIRECTIONS = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6}
DIRECTIONS |= {str(number): number for number in range(1, 10)}
"""Numbers of directions, by Ansys' words and by themselves."""
MIN_ENTRY_BYTES = {"coordinate": 4, "array": 2}
"""Bytes of an entry and the end of its line."""
MATRIX_LAYOUTS, FIELDS = ("coordinate", "array"), ("real", "integer")
MIRROR = {"symmetric": 1, "skew-symmetric": -1}
"""Factor of an entry below the diagonal to give the one above it."""
SYMMETRIES = ("general", *MIRROR)
_LABEL = re.compile(r"\s*(?:(\d+)\s+)?(\d+)[\s.,]+(\d|[A-Z]+)")
"""Node and direction of a row: "12.3", or with its number "7 12 UZ"."""


@dataclass(frozen=True)
class LabelledMatrix:
    """A square matrix, and what its rows are.

    Attributes
    ----------
    matrix : (n, n)
        Both triangles.
    labels : (n, 2) int or None
        Node and direction of each row, 1 to 3 along x, y, z; None: they are not known.
    held : (k, 2) int or None
        Those that the program holds, likewise, which are no rows here.
    """

    matrix: sparse.csr_matrix
    labels: np.ndarray | None
    held: np.ndarray | None = None

    def at(self, stiffness: LabelledMatrix) -> sparse.csr_matrix:
        """The matrix with the rows of the stiffness, zero where it has none; without those that are
        held there.

        Raises
        ------
        ValueError
            It has another row.
        """
        labels = stiffness.labels
        if self.labels is None or labels is None or np.array_equal(self.labels, labels):
            return self.matrix
        places = {tuple(label): row for row, label in enumerate(labels.tolist())}
        held = [] if stiffness.held is None else stiffness.held.tolist()
        places |= dict.fromkeys(map(tuple, held), -1)
        rows = [places.get(tuple(label)) for label in self.labels.tolist()]
        if None in rows:
            node, direction = self.labels[rows.index(None)]
            raise ValueError(f"node {node}, direction {direction} is no row of the stiffness")
        entries, at = self.matrix.tocoo(), np.array(rows, dtype=int)
        kept = (at[entries.row] >= 0) & (at[entries.col] >= 0)
        places_of = at[entries.row[kept]], at[entries.col[kept]]
        return sparse.csr_matrix((entries.data[kept], places_of), (len(labels), len(labels)))


def read_matrix(
    path: Path, kind: str, labels: Path | None = None, rows: int | None = None
) -> LabelledMatrix:
    """Read a matrix of any of the formats above.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        "K", "M" or "B": what to take of a file that holds stiffness, mass and damping.
    labels : Path, optional
        The file with node and direction of each row.
    rows : int, optional
        Number of entries, where that is known and the file does not name them.

    Raises
    ------
    OSError, ValueError
        A file cannot be read, or contradicts itself: with its line.
    """
    ending = path.suffix.lower()
    if (ending, kind) in ((".sti", "M"), (".mas", "K")):
        raise ValueError(f"CalculiX writes the {'stiffness' if kind == 'M' else 'mass'} there")
    if ending in (".sti", ".mas"):
        return _of_calculix(path, labels or path.with_suffix(".dof"))
    if ending == ".pch":
        return _of_nastran(path, kind)
    if ending == ".mtx" and _begins_as_abaqus(path):
        return _of_abaqus(path)
    named = None if labels is None else read_labels(labels)
    if ending == ".op4":
        return LabelledMatrix(_of_op4(path, kind), named)
    matrix = read_matrix_market(path, rows if named is None else len(named))
    if named is not None and matrix.shape[1] != len(named):
        raise ValueError(f"of shape {matrix.shape}, for {len(named)} rows that are named")
    return LabelledMatrix(matrix, named)


def read_labels(path: Path) -> np.ndarray:
    """Node and direction of each row: (n, 2), in the order of their numbers where they have some;
    lines before the first of them are a heading.

    Raises
    ------
    OSError, ValueError
        As :func:`read_matrix`.
    """
    found: list[tuple[int, int]] = []
    rows: list[int] = []
    for number, line in numbered_lines(path, "#"):
        match = _LABEL.fullmatch(line.rstrip())
        if match is not None and match[3] in DIRECTIONS:
            found.append((int(match[2]), DIRECTIONS[match[3]]))
            rows.append(int(match[1] or len(found)))
        elif found:
            raise ValueError(f"{path.name}, line {number}: {line[:80]!r} names no dof of a node")
    if not found or len(set(found)) < len(found):
        raise ValueError(f"{path.name}: {'a row twice' if found else 'no dof of a node'}")
    order = np.argsort(rows)
    if np.any(np.diff(np.array(rows)[order]) != 1) or min(rows) > 1:
        raise ValueError(f"{path.name}: its rows are not numbered from 1 to {len(rows)}, each once")
    return np.array(found, dtype=np.int64)[order]


def _mirrored(
    values: np.ndarray, rows: np.ndarray, columns: np.ndarray, n: int, sign: int = 1
) -> sparse.csr_matrix:
    """A symmetric or skew-symmetric matrix of one triangle, n x n; of both, as it is.

    Raises ValueError where some entries stand on both sides of the diagonal, and some on one.
    """
    off, above = rows != columns, rows < columns
    if np.any(above) and np.any(off & ~above):
        twins = np.isin(n * columns[off] + rows[off], n * rows[off] + columns[off])
        if twins.all():
            return sparse.csr_matrix((values, (rows, columns)), (n, n))
        if twins.any():
            row, column = rows[off][twins][0] + 1, columns[off][twins][0] + 1
            raise ValueError(
                f"row {row}, column {column} is there on both sides of the diagonal, others on one"
            )
    at = np.append(rows, columns[off]), np.append(columns, rows[off])
    return sparse.csr_matrix((np.append(values, sign * values[off]), at), (n, n))


def _between_labels(ends: np.ndarray, values: np.ndarray, *, whole: bool) -> LabelledMatrix:
    """A matrix of entries between two labels (m, 2, 2), of both triangles or of one."""
    (nodes, node), (ways, way) = (
        np.unique(ends[..., part].ravel(), return_inverse=True) for part in range(2)
    )
    keys, places = np.unique(node * len(ways) + way, return_inverse=True)  # quicker than of rows
    labels = np.column_stack([nodes[keys // len(ways)], ways[keys % len(ways)]])
    rows, columns = places.reshape(-1, 2).T
    n = len(labels)
    both = sparse.csr_matrix((values, (rows, columns)), (n, n)) if whole else None
    return LabelledMatrix(_mirrored(values, rows, columns, n) if both is None else both, labels)


def _of_calculix(path: Path, labels: Path) -> LabelledMatrix:
    rows = read_labels(labels)
    entries, n = rows_of(path, 3, "#"), len(rows)
    at = entries[:, :2]
    wrong = np.any((at < 1) | (at > n) | (at % 1 != 0), axis=1)
    if np.any(wrong):
        line = int(np.argmax(wrong)) + 1
        raise ValueError(f"line {line}: {at[line - 1].tolist()} is outside of {n} rows")
    one, other = (at - 1).astype(int).T
    missing = np.setdiff1d(np.arange(n), one[one == other])
    if len(missing):
        raise ValueError(f"it ends early: row {missing[0] + 1} of {n} has no diagonal")
    return LabelledMatrix(_mirrored(entries[:, 2], one, other, n), rows)


def _begins_as_abaqus(path: Path) -> bool:
    """Return True if the first line that is no comment has five numbers between commas."""
    return next((line for _, line in numbered_lines(path, "*")), "").count(",") == 4


def _of_abaqus(path: Path) -> LabelledMatrix:
    entries = rows_of(path, 5, "*", ",")
    found = _between_labels(
        entries[:, :4].astype(np.int64).reshape(-1, 2, 2), entries[:, 4], whole=False
    )
    assert found.labels is not None
    # Abaqus marks a dof that is held by 1e36 on the diagonal.
    free = np.flatnonzero(is_free := found.matrix.diagonal() < 1e36)
    held = found.labels[~is_free]
    return LabelledMatrix(found.matrix[free][:, free], found.labels[free], held)


def _of_nastran(path: Path, kind: str) -> LabelledMatrix:
    ends: list[tuple[int, int, int, int]] = []
    values: list[float] = []
    own, column, form = False, (0, 0), 6
    for number, line in numbered_lines(path, "$"):
        try:
            if line.startswith("DMIG "):
                own = re.match(f"{kind}[A-Z]", line[8:16].upper()) is not None
                if own and line[16:24].strip() == "0":
                    if ends:
                        raise LookupError
                    form, stored = int(line[24:32]), int(line[32:40])
                    if form not in (1, 6) or stored not in (1, 2):
                        raise ValueError
            elif line.startswith("DMIG*"):
                own = re.match(f"{kind}[A-Z]", line[8:24].upper()) is not None
                column = int(line[24:40]), int(line[40:56])
            elif line.startswith("*"):
                if own:
                    ends.append((int(line[8:24]), int(line[24:40]), *column))
                    values.append(float(line[40:56].upper().replace("D", "E")))
            elif own:
                raise ValueError
        except LookupError:
            second = f"{line[8:16].strip()}, a second matrix whose name begins with {kind}"
            raise ValueError(f"line {number}: {second}") from None
        except ValueError:
            wanted = "a real square matrix DMIG in fields of 16 characters"
            raise ValueError(f"line {number}: {line[:80]!r} is not of {wanted}") from None
    if not ends:
        raise ValueError(f"it has no matrix DMIG whose name begins with {kind}")
    at = np.array(ends, dtype=np.int64).reshape(-1, 2, 2)
    return _between_labels(at, np.array(values), whole=form == 1)


def _of_op4(path: Path, kind: str) -> sparse.csr_matrix:
    """The matrix whose name begins with its kind, by the form that OUTPUT4 has in the DMAP
    Programmer's Guide.

    It has a line for the matrix, and one for each column with its first row, or 0 and then one for
    each string of numbers without gaps.
    """
    lines = numbered_lines(path, "$")
    number, line, width = 0, "", 16

    def whole(count: int) -> list[int]:
        nonlocal number, line
        number, line = next(lines)
        return [int(line[at : at + 8]) for at in range(0, 8 * count, 8)]

    def numbers(count: int) -> list[float]:
        nonlocal number, line
        found: list[float] = []
        while len(found) < count:
            number, line = next(lines)
            text = line.upper().replace("D", "E")
            found += [float(text[at : at + width]) for at in range(0, len(text), width)]
        if len(found) > count:
            raise ValueError
        return found

    try:
        while True:
            columns, rows, _, stored = whole(4)
            width = int(line[40:].upper().replace("D", "E").partition("E")[2].partition(".")[0])
            own = line[32:40].strip().upper().startswith(kind)
            if stored not in (1, 2, 3, 4) or (own and stored > 2):  # complex
                raise ValueError
            words = 2 if stored in (2, 4) else 1
            values: list[float] = []
            at: list[tuple[int, int]] = []
            while True:
                column, first, left = whole(3)
                while left > 0:
                    length, row, spent = left, first, 0
                    if first == 0 and rows < 0:
                        (length, row), spent = whole(2), 2
                        length -= 1
                    elif first == 0:
                        number, line = next(lines)
                        length, row, spent = int(line) // 65536 - 1, int(line) % 65536, 1
                    # Of strings the words are counted, of a dense column the numbers.
                    found = numbers(length // words if spent else length)
                    left -= length + spent
                    if own and column <= columns:
                        values += found
                        at += [(row - 1 + place, column - 1) for place in range(len(found))]
                if column > columns:
                    break
            if own:
                places = np.array(at, dtype=np.int64).reshape(-1, 2).T
                made = sparse.csr_matrix((values, tuple(places)), (abs(rows), columns))
                made.eliminate_zeros()  # between the numbers of a column
                return made
    except StopIteration:
        raise ValueError(f"it has no whole matrix whose name begins with {kind}") from None
    except ValueError:
        wanted = "a real matrix that OUTPUT4 writes as text"
        raise ValueError(f"line {number}: {line[:80]!r} is not of {wanted}") from None


# --- Matrix Market --------------------------------------------------------------------------------


def read_matrix_market(path: Path, rows: int | None = None) -> sparse.csr_matrix:
    """Read a real matrix, dense or sparse, of ``rows`` rows; .gz and .bz2 too.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, or contradicts itself.
    """
    with opened_text(path) as (text, most):
        lines = iter(text)
        (layout, symmetry), sizes, entries = _announced(lines, most)
        shape = sizes[0], sizes[1]
        if rows is not None and shape[0] != rows:
            raise ValueError(f"it has {shape[0]} rows instead of {rows}")
        if symmetry != "general" and shape[0] != shape[1]:
            raise ValueError(f"{symmetry}, but of shape {shape}")
        body = rows_in(lines, "%", most=entries + 1)
    found = body.size if layout == "array" else len(body)
    if found != entries:
        count = "more" if found > entries else found  # no more are read than one too many
        raise ValueError(f"it has {count} entries instead of {entries}")
    if layout == "array":
        values, at = body.ravel(), _places_in_array(shape, symmetry)
    elif max(shape) > max(len(body), rows or 1):
        raise ValueError(f"of shape {shape}, it has only {len(body)} entries")
    else:
        values, at = _coordinates(body, shape, symmetry)
    if symmetry == "general":
        matrix = sparse.csr_matrix((values, at), shape)
    else:
        matrix = _mirrored(values, *at, shape[0], MIRROR[symmetry])
    if layout == "array":
        matrix.eliminate_zeros()
    return matrix


def matrix_market(matrix: sparse.spmatrix) -> str:
    """The text of a Matrix Market file from which every number is read back exactly; one triangle
    of a symmetric matrix."""
    entries, kind = sparse.coo_matrix(matrix), "general"
    if entries.shape[0] == entries.shape[1] and (entries != entries.T).nnz == 0:
        entries, kind = sparse.tril(entries, format="coo"), "symmetric"
    columns = entries.row + 1, entries.col + 1, entries.data
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = [f"{row} {column} {value!r}\n" for row, column, value in rows]
    sizes = f"{entries.shape[0]} {entries.shape[1]} {entries.nnz}"
    return "".join([f"%%MatrixMarket matrix coordinate real {kind}\n{sizes}\n", *lines])


def matrix_market_shape(path: Path) -> tuple[int, int]:
    """Rows and columns that a file announces; sparse columns have an entry each.

    Raises
    ------
    OSError, ValueError
        As :func:`read_matrix_market`.
    """
    with opened_text(path) as (lines, most):
        _, sizes, _ = _announced(iter(lines), most)
    if len(sizes) == 3 and sizes[1] > sizes[2]:
        raise ValueError(f"{sizes[1]} columns, but only {sizes[2]} entries")
    return sizes[0], sizes[1]


def _announced(lines: Iterator[str], most: int) -> tuple[tuple[str, str], list[int], int]:
    """Layout and symmetry, the numbers of the line with the size, and those of entries."""
    header = _header(next(lines, ""))
    line = next((line for line in lines if line.strip() and not line.startswith("%")), "")
    sizes = [int(word) for word in line.split()]
    if len(sizes) != (3 if header[0] == "coordinate" else 2) or min(sizes) < 0:
        raise ValueError("the line with its size is missing or wrong")
    rows, columns = sizes[:2]
    if len(sizes) == 3:
        entries = sizes[2]
    elif sign := MIRROR.get(header[1]):  # from the diagonal down
        entries = rows * (rows + sign) // 2
    else:
        entries = rows * columns
    if entries * MIN_ENTRY_BYTES[header[0]] > most:
        raise ValueError(f"it announces {entries} entries, more than it can hold")
    return header, sizes, entries


def _header(line: str) -> tuple[str, str]:
    words = line.lower().split()
    if len(words) != 5 or words[:2] != ["%%matrixmarket", "matrix"]:
        raise ValueError("it does not begin with %%MatrixMarket matrix")
    layout, field, symmetry = words[2:]
    for word, known in ((layout, MATRIX_LAYOUTS), (field, FIELDS), (symmetry, SYMMETRIES)):
        if word not in known:
            raise ValueError(f"{word!r} instead of one of {', '.join(known)}")
    return layout, symmetry


def _places_in_array(shape: tuple[int, int], symmetry: str) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a dense file's entries: columns one after the other, of a symmetric
    matrix their part from the diagonal down."""
    if symmetry == "general":
        columns, rows = np.indices(shape[::-1]).reshape(2, -1)
    else:
        columns, rows = np.triu_indices(shape[0], symmetry == "skew-symmetric")
    return rows, columns


def _coordinates(
    body: np.ndarray, shape: tuple[int, int], symmetry: str
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Values, rows and columns of a sparse file's entries."""
    if len(body) and body.shape[1] != 3:
        raise ValueError(f"its entries have {body.shape[1]} numbers instead of 3")
    body = body.reshape(-1, 3)
    if not np.all((body[:, :2] >= 1) & (body[:, :2] <= shape) & (body[:, :2] % 1 == 0)):
        raise ValueError("an entry lies outside of the matrix")
    rows, columns = body[:, :2].astype(np.int64).T - 1
    if symmetry != "general" and np.any(rows < columns):
        raise ValueError(f"{symmetry}, but with entries above the diagonal")
    return body[:, 2], (rows, columns)


# --- lines ----------------------------------------------------------------------------------------


def numbered_lines(path: Path, comment: str) -> Iterator[tuple[int, str]]:
    """Lines that hold more than a comment, without it, and their numbers from 1."""
    with opened_text(path, "replace") as (lines, _):
        for number, line in enumerate(lines, 1):
            if text := line.partition(comment)[0].rstrip():
                yield number, text


def rows_of(path: Path, columns: int, comment: str, delimiter: str | None = None) -> np.ndarray:
    """Rows of so many numbers: (n, columns).

    Raises
    ------
    OSError, ValueError
        The file cannot be read; or the line that is no such row.
    """
    try:
        with opened_text(path) as (lines, _):
            rows = rows_in(lines, comment, delimiter)
        if rows.shape[1] == columns and len(rows) and np.all(np.isfinite(rows)):
            return rows
    except ValueError:  # its words count other lines than an editor does
        pass
    for number, line in numbered_lines(path, comment):
        try:
            values = [float(word) for word in line.split(delimiter)]
        except ValueError:
            values = []
        if len(values) != columns or not np.all(np.isfinite(values)):
            raise ValueError(f"line {number}: {line[:80]!r} instead of {columns} numbers")
    raise ValueError("it holds no numbers")


def numbers(given: Any) -> np.ndarray:
    """Convert to an array of floats; nan if that is impossible."""
    try:
        return np.asarray(np.nan if np.iscomplexobj(given) else given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.asarray(np.nan)


def read_only(array: np.ndarray) -> np.ndarray:
    """The array itself if it cannot be written to, else a copy that cannot."""
    if array.flags.writeable:
        array = array.copy(order="K")
        array.flags.writeable = False
    return array


class ReadOnly:
    """Makes the arrays among the fields of a frozen dataclass read-only."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, read_only(value))


class Absent:
    """A matrix of a file of a prepared structure: its sizes, and a refusal of all else."""

    def __init__(self, count: int, rank: int) -> None:
        self.size, own = (count, count), count if rank == 0 else 0  # rank 0 has all rows
        self.local_size, self.owner_range = (own, own), ((0, count) if own else (count, count))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise self.refused("this")

    @staticmethod
    def refused(wanted: str) -> InputError:
        """The error of what takes matrices or a mesh."""
        allowed = f"one with its matrices, for {wanted}: solve the scene itself"
        return InputError("structure", "a file of a prepared structure", allowed)


def per_pair(name: str, given: Any, pairs: int) -> np.ndarray:
    """One finite number per pair, from one for all or one for each: (pairs,)."""
    values = numbers(given)
    if values.shape not in ((), (pairs,)) or not np.all(np.isfinite(values)):
        raise InputError(name, given, f"one finite number, or {pairs}")
    return np.broadcast_to(values, (pairs,)).copy()


def petsc_matrix(name: str, given: Any, comm: MPI.Comm, n: int | None = None) -> Any:
    """Make a square PETSc matrix of what was given; check shape and entries."""
    made = isinstance(given, PETSc.Mat)
    whole = given if made else sparse.csr_matrix(_read_matrix(name, given, n))
    rows, columns = whole.size if made else whole.shape
    if rows != columns or rows == 0 or n not in (None, rows):
        allowed = "of shape (n, n)" if n is None else f"of shape ({n}, {n})"
        raise InputError(name, (rows, columns), allowed)
    if not made:
        _check_sizes(name, whole.data)
        start, stop = (rows * comm.rank) // comm.size, (rows * (comm.rank + 1)) // comm.size
        return distributed(whole[start:stop], comm)
    comm = given.comm.tompi4py()
    own = local_rows(given.convert("aij", PETSc.Mat()))
    on_each(comm, lambda: _check_sizes(name, own.data))
    return distributed(own, comm)


def _read_matrix(name: str, given: Any, rows: int | None) -> Any:
    """Read a Matrix Market file, or pass on what is a matrix already."""
    if isinstance(given, str | Path):
        with reading(name, given, "a Matrix Market file"):
            given = read_matrix_market(Path(given), rows)
    try:
        matrix = given if sparse.issparse(given) else np.asarray(given)
        if np.iscomplexobj(matrix):
            raise TypeError
        matrix = matrix.astype(float)
    except (ValueError, TypeError, OverflowError):
        raise InputError(name, type(given).__name__, "a real matrix") from None
    if matrix.ndim > 2:
        raise InputError(name, matrix.shape, "a matrix, two-dimensional")
    return matrix


def whole_rows(name: str, given: Any, n: int) -> sparse.csr_matrix:
    """A vector or a matrix with n rows, given whole or distributed: (n, m) on every rank."""
    if isinstance(given, PETSc.Vec):
        given = gather_rows(given.comm.tompi4py(), given.array_r)
    elif isinstance(given, PETSc.Mat):
        first, last = given.owner_range
        local = given.getValues(range(first, last), range(given.size[1]))
        given = gather_rows(given.comm.tompi4py(), np.atleast_2d(local))
    matrix = _read_matrix(name, given, n)
    if matrix.ndim == 0 or matrix.shape[0] != n:
        raise InputError(name, matrix.shape, f"with {n} rows")
    matrix = sparse.csr_matrix(matrix.reshape(n, -1))
    _check_sizes(name, matrix.data)
    return matrix


def _check_sizes(name: str, values: np.ndarray) -> None:
    """Entries are finite, and the largest is 0 or of a size whose powers are numbers too."""
    sizes = np.abs(values)
    if not np.all(np.isfinite(sizes)):
        bad = values[~np.isfinite(sizes)]
        raise InputError(name, float(bad.ravel()[0]), "finite in every entry")
    largest, most = float(sizes.max(initial=0.0)), LARGEST**2  # a product of two of a scene
    if largest and not 1.0 / most <= largest <= most:
        allowed = f"0 or from {1.0 / most:g} to {most:g} in size"
        raise InputError(name, f"{largest:g}, the largest entry", allowed)


def checked(
    mass: Any, stiffness: Any, gaps: tuple[Any, Any], forces: Mapping[str, Any], clearance: Any,
    comm: MPI.Comm,
) -> dict[str, Any]:  # fmt: skip
    """Check and distribute what :meth:`Structure.from_matrices` is given but for the damping
    (collective)."""
    mass = petsc_matrix("mass", mass, comm)
    comm, n, own = mass.comm.tompi4py(), mass.size[0], slice(*mass.owner_range)
    stiffness = petsc_matrix("stiffness", stiffness, comm, n)
    _check_symmetric("mass", mass)
    _check_symmetric("stiffness", stiffness)
    with Factor(mass) as factor:
        negative, null = factor.negative_pivots, factor.null_pivots
    if negative or null:
        found = f"{negative} negative and {null} zero eigenvalues"
        raise InputError("mass", found, "positive definite")
    _check_semidefinite("stiffness", stiffness, mass)

    normal, tangential = gaps
    gap = sparse.csr_matrix((n, 0)) if normal is None else whole_rows("gap", normal, n)
    if len(empty := np.flatnonzero(abs(gap).sum(axis=0) == 0.0)):
        value = f"zero in column {empty[0] + 1} of {gap.shape[1]}"
        allowed = "a pair in each: a gap that depends on no displacement never opens or closes"
        raise InputError("gap", value, allowed)
    parts = {
        "mass": mass,
        "stiffness": stiffness,
        "gap": gap[own],
        "force": _load(forces, n)[:, own],
        "clearance": per_pair("clearance", clearance, gap.shape[1]),
    }
    if tangential is not None:
        tangential = whole_rows("tangential", tangential, n)
        if tangential.shape[1] not in (gap.shape[1], 2 * gap.shape[1]):
            allowed = f"of shape {gap.shape}, as gap is, or with twice the columns"
            raise InputError("tangential", tangential.shape, allowed)
        parts["tangential"] = tangential[own]
    return parts


def _load(forces: Mapping[str, Any], n: int) -> np.ndarray:
    """A load (2K+1, n) of its mean, and of cosine and sine parts with a column for each order."""
    most = {"force_mean": 1}
    parts = [_of_dofs(key, part, n, most.get(key, MOST_HARMONICS)) for key, part in forces.items()]
    force = np.zeros((2 * max(map(len, parts)) + 1, n))
    for first, part in enumerate(parts):
        force[first::2][: len(part)] = part
    return force


def _of_dofs(name: str, given: Any, n: int, most: int = 1) -> np.ndarray:
    """Up to so many columns (n, m) as rows (m, n), zero where it is None; InputError for another
    shape."""
    columns = sparse.csr_matrix((n, 1)) if given is None else whole_rows(name, given, n)
    if not 1 <= columns.shape[1] <= most:
        allowed = f"of shape ({n},)" + f", or of up to {most} columns" * (most > 1)
        raise InputError(name, columns.shape, allowed)
    return np.asarray(columns.toarray().T, dtype=float)


def with_harmonics(
    force: np.ndarray, given: Mapping[int, tuple[Any, Any]], mass: Any
) -> np.ndarray:
    """This rank's rows of a load (2K+1, n_local) with further harmonics,
    cosine and sine part by their orders: (2K+1, n_local)."""
    n, own = mass.size[0], slice(*mass.owner_range)
    if not isinstance(given, Mapping):
        raise InputError("harmonics", given, "cosine and sine part by the order")
    for order in given:
        check_count("order in harmonics", order, 1, MOST_HARMONICS)
    found = resize_harmonics(force, max([len(force) // 2, *given]))
    for order, both in given.items():
        name = f"harmonics[{order}]"
        if not isinstance(both, tuple | list) or len(both) != 2:
            raise InputError(name, both, "(cosine, sine), each (n,) or None")
        found[2 * order - 1 : 2 * order + 1] += [_of_dofs(name, part, n)[0, own] for part in both]
    return found


def lumped_mass(mass: Any) -> Any:
    """The diagonal matrix of the row sums; InputError where one is not positive (collective)."""
    ones, sums = mass.createVecs()
    ones.set(1.0)
    mass.mult(ones, sums)
    smallest = sums.min()[1]
    if smallest <= TOLERATED * sums.max()[1]:  # zero at a triangle's corners
        allowed = "lumped only where every row sum is positive"
        raise InputError("mass", f"row sum {smallest:.3g}", allowed)
    shape = mass.local_size[0], mass.size[1]
    return distributed(sparse.diags(sums.array_r, mass.owner_range[0], shape), mass.comm.tompi4py())


def with_springs(stiffness: Any, gap: sparse.csr_matrix, springs: np.ndarray) -> Any:
    """K + B diag(k) B^T of springs k (n_pairs,) (collective)."""
    comm = stiffness.comm.tompi4py()
    whole = sparse.vstack(comm.allgather(gap), format="csr")
    added = distributed(gap @ sparse.diags(springs) @ whole.T, comm)
    matrix = weighted_sum(stiffness, 1.0, added)
    added.destroy()
    return matrix


def _check_symmetric(name: str, matrix: Any) -> None:
    size = matrix.norm(PETSc.NormType.INFINITY)
    difference = matrix.transpose(PETSc.Mat())
    difference.axpy(-1.0, matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    asymmetry = difference.norm(PETSc.NormType.INFINITY)
    difference.destroy()
    if asymmetry > TOLERATED * size:
        raise InputError(name, f"asymmetric by {asymmetry / size:.1e}", "symmetric")


def _check_semidefinite(name: str, matrix: Any, mass: Any) -> None:
    """Raise InputError if a symmetric matrix has an eigenvalue that is negative beyond rounding;
    it has none for motions as a rigid body (collective)."""
    quotients = matrix.getDiagonal()
    quotients.pointwiseDivide(quotients, mass.getDiagonal())
    sizes = quotients.copy()
    sizes.abs()
    with factored_sum(matrix, TOLERATED * sizes.max()[1], mass) as factor:
        negative = factor.negative_pivots
    if negative:
        raise InputError(name, counted(negative, "negative eigenvalue"), "positive semidefinite")


def read_only_rows(matrix: Any) -> sparse.csr_matrix:
    """A copy of a sparse matrix by rows that cannot be written to; itself where it is one."""
    if sparse.isspmatrix_csr(matrix) and matrix.has_canonical_format:
        if not any(part.flags.writeable for part in (matrix.data, matrix.indices, matrix.indptr)):
            return matrix
    rows = sparse.csr_matrix(matrix, copy=True)
    rows.sum_duplicates()
    for part in (rows.data, rows.indices, rows.indptr):
        part.flags.writeable = False
    return rows
