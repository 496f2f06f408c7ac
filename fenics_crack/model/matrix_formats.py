"""Read matrices from files of other programs.

Most programs write a node and a direction for each row:

==================  ==============================================================================
.sti, .mas          CalculiX, ``*FREQUENCY, SOLVER=MATRIXSTORAGE``: row, column, value of one
                    triangle; node and direction of each row in the .dof beside it
.mtx                Abaqus, ``*MATRIX OUTPUT, FORMAT=MATRIX INPUT``: node, direction, node,
                    direction, value of one triangle; or Matrix Market, as any other ending
.pch                Nastran, ``PARAM,EXTOUT,DMIGPCH``: matrices KAAX, MAAX, BAAX of one triangle
.op4                Nastran, ``OUTPUT4`` as text (``FORM=FORMATTED``): by columns, dense or sparse
==================  ==============================================================================

An .op4 or a Matrix Market file needs a second file with the nodes: CalculiX's .dof, or what Ansys'
``HBMAT`` writes beside the matrix that ``*EXPORT`` writes.

Matrix Market files are read strictly. SciPy's reader trusts the announced sizes: with a damaged
file, some versions loop, request all memory, or crash. Here a file has at most as many entries as
its bytes can hold. A packed file is unpacked up to a limit that follows from its own size.

References
----------
Boisvert, Pozo and Remington, The Matrix Market exchange formats, NISTIR 5935, 1996.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sparse

from fenics_crack.basics.untrusted_files import open_lines_and_byte_limit, parse_number_rows

DIRECTION_NUMBER_BY_DOF_LABEL = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6}
DIRECTION_NUMBER_BY_DOF_LABEL |= {str(number): number for number in range(1, 10)}
"""Number of a direction by its label in files: Ansys's words UX to ROTZ, or a digit 1 to 9."""
MIN_ENTRY_BYTES_BY_LAYOUT = {"coordinate": 4, "array": 2}
"""Minimum bytes of an entry in a Matrix Market file with the end of its line, by layout."""
MATRIX_LAYOUTS, ENTRY_TYPES = ("coordinate", "array"), ("real", "integer")
"""Words that the first line of a Matrix Market file may have: sparse or dense, and the entries."""
TRANSPOSE_SIGN_BY_SYMMETRY = {"symmetric": 1, "skew-symmetric": -1}
"""Factor from an entry below the diagonal to the mirrored entry above."""
SYMMETRIES = ("general", *TRANSPOSE_SIGN_BY_SYMMETRY)
"""Words for the symmetry in the first line of a Matrix Market file."""
_LABEL_PATTERN = re.compile(r"\s*(?:(\d+)\s+)?(\d+)[\s.,]+(\d|[A-Z]+)")
"""Node and direction of a row: "12.3", or with the number of the row first "7 12 UZ"."""


@dataclass(frozen=True)
class LabelledMatrix:
    """A square matrix with a node and a direction for each row.

    Attributes
    ----------
    matrix : (n, n)
        The matrix, with entries on both sides of the diagonal.
    labels : (n, 2) int or None
        Node and direction of each row, 1 to 3 along x, y, z. None: unknown.
    held_labels : (k, 2) int or None
        Node and direction of each dof that the other program has clamped; the matrix has no rows
        for them.
    """

    matrix: sparse.csr_matrix
    labels: np.ndarray | None
    held_labels: np.ndarray | None = None

    def with_rows_of(self, stiffness: LabelledMatrix) -> sparse.csr_matrix:
        """Return this matrix with rows and columns in the order of the stiffness: (n, n).

        A row missing in this matrix becomes zero. A row is left out if the dof is clamped in the
        stiffness. If either matrix has no labels, this matrix is returned unchanged.

        Raises
        ------
        ValueError
            The stiffness lacks a row of this matrix.
        """
        stiffness_labels = stiffness.labels
        if (
            self.labels is None
            or stiffness_labels is None
            or np.array_equal(self.labels, stiffness_labels)
        ):
            return self.matrix
        row_by_label = {tuple(label): row for row, label in enumerate(stiffness_labels.tolist())}
        clamped_dof_labels = [] if stiffness.held_labels is None else stiffness.held_labels.tolist()
        row_by_label |= dict.fromkeys(map(tuple, clamped_dof_labels), -1)
        rows = [row_by_label.get(tuple(label)) for label in self.labels.tolist()]
        if None in rows:
            node, direction = self.labels[rows.index(None)]
            raise ValueError(f"node {node}, direction {direction} is missing in the stiffness")
        coo_matrix, new_rows = self.matrix.tocoo(), np.array(rows, dtype=int)
        is_entry_kept = (new_rows[coo_matrix.row] >= 0) & (new_rows[coo_matrix.col] >= 0)
        rows_and_columns = (
            new_rows[coo_matrix.row[is_entry_kept]],
            new_rows[coo_matrix.col[is_entry_kept]],
        )
        return sparse.csr_matrix(
            (coo_matrix.data[is_entry_kept], rows_and_columns),
            (len(stiffness_labels), len(stiffness_labels)),
        )


def read_matrix(
    path: Path, matrix_letter: str, labels_path: Path | None = None, n_rows: int | None = None
) -> LabelledMatrix:
    """Read a matrix from another program's file, or from a Matrix Market file.

    The ending selects the format: .sti and .mas CalculiX, .pch and .op4 Nastran. A .mtx file with
    commas is from Abaqus. Any other file is a Matrix Market file.

    Parameters
    ----------
    path : Path
        The file.
    matrix_letter : str
        Selects the matrix in a file with several: "K" is the stiffness, "M" the mass, "B" the
        damping.
    labels_path : Path, optional
        File with node and direction of each row (:func:`read_labels`). Default: for CalculiX the
        .dof file beside the matrix. Files of Abaqus and .pch files contain the labels.
    n_rows : int, optional
        Expected number of rows in a Matrix Market file without ``labels_path``.

    Raises
    ------
    OSError, ValueError
        A file cannot be read, or contradicts itself; the message names the line.
    """
    suffix = path.suffix.lower()
    if (suffix, matrix_letter) in ((".sti", "M"), (".mas", "K")):
        raise ValueError(
            f"a {suffix} file of CalculiX holds "
            f"the {'stiffness' if matrix_letter == 'M' else 'mass'}"
        )
    if suffix in (".sti", ".mas"):
        return _read_calculix(path, labels_path or path.with_suffix(".dof"))
    if suffix == ".pch":
        return _read_nastran(path, matrix_letter)
    if suffix == ".mtx" and _is_abaqus_file(path):
        return _read_abaqus(path)
    labels = None if labels_path is None else read_labels(labels_path)
    if suffix == ".op4":
        return LabelledMatrix(_read_op4(path, matrix_letter), labels)
    matrix = read_matrix_market(path, n_rows if labels is None else len(labels))
    if labels is not None and matrix.shape[1] != len(labels):
        raise ValueError(f"it has shape {matrix.shape}, but {labels_path} names {len(labels)} rows")
    return LabelledMatrix(matrix, labels)


def read_labels(path: Path) -> np.ndarray:
    """Read node and direction of each matrix row from a file of CalculiX or Ansys.

    Lines before the first label are a heading. A line may begin with the row's number. The result
    is then sorted by row numbers.

    Returns
    -------
    (n, 2) int
        Node and direction of each row: 1 to 3 along x, y, z, then rotations.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, or contradicts itself; the message names the line.
    """
    labels: list[tuple[int, int]] = []
    row_numbers: list[int] = []
    for line_number, line in yield_numbered_lines(path, "#"):
        match = _LABEL_PATTERN.fullmatch(line.rstrip())
        if match is not None and match[3] in DIRECTION_NUMBER_BY_DOF_LABEL:
            labels.append((int(match[2]), DIRECTION_NUMBER_BY_DOF_LABEL[match[3]]))
            row_numbers.append(int(match[1] or len(labels)))
        elif labels:
            raise ValueError(
                f"{path.name}, line {line_number}: {line[:80]!r} is not a node and a direction"
            )
    if not labels or len(set(labels)) < len(labels):
        raise ValueError(f"{path.name}: {'it names a row twice' if labels else 'it names no row'}")
    label_order = np.argsort(row_numbers)
    if np.any(np.diff(np.array(row_numbers)[label_order]) != 1) or min(row_numbers) > 1:
        raise ValueError(
            f"{path.name}: its rows are not numbered from 1 to {len(row_numbers)}, each once"
        )
    return np.array(labels, dtype=np.int64)[label_order]


def _make_matrix_from_triangle(
    entries: np.ndarray,
    row_indices: np.ndarray,
    column_indices: np.ndarray,
    n: int,
    transpose_sign: int = 1,
) -> sparse.csr_matrix:
    """Make a symmetric or skew-symmetric matrix from one triangle.

    Entries that already fill both triangles are kept as they are.

    Parameters
    ----------
    entries, row_indices, column_indices : (m,)
        Nonzero entries and their positions.
    n : int
        Number of rows of the matrix.
    transpose_sign : int
        1 for a symmetric matrix, -1 for a skew-symmetric one.

    Raises
    ------
    ValueError
        Some entries have a mirrored entry and others have none.
    """
    is_off_diagonal, is_above = row_indices != column_indices, row_indices < column_indices
    if np.any(is_above) and np.any(is_off_diagonal & ~is_above):
        has_twin = np.isin(
            n * column_indices[is_off_diagonal] + row_indices[is_off_diagonal],
            n * row_indices[is_off_diagonal] + column_indices[is_off_diagonal],
        )
        if has_twin.all():
            return sparse.csr_matrix((entries, (row_indices, column_indices)), (n, n))
        if has_twin.any():
            row_number = row_indices[is_off_diagonal][has_twin][0] + 1
            column_number = column_indices[is_off_diagonal][has_twin][0] + 1
            raise ValueError(
                f"row {row_number}, column {column_number} is on both sides of the diagonal, "
                "other entries on one side only"
            )
    rows_and_columns = (
        np.append(row_indices, column_indices[is_off_diagonal]),
        np.append(column_indices, row_indices[is_off_diagonal]),
    )
    return sparse.csr_matrix(
        (np.append(entries, transpose_sign * entries[is_off_diagonal]), rows_and_columns), (n, n)
    )


def _build_labelled_matrix(
    entry_labels: np.ndarray, entries: np.ndarray, *, has_both_triangles: bool
) -> LabelledMatrix:
    """Make a labelled matrix from entries at nodes and directions.

    Parameters
    ----------
    entry_labels : (m, 2, 2) int
        Row and column of each entry, each a node and a direction.
    entries : (m,)
        Values.
    has_both_triangles : bool
        True if the entries fill both triangles of the matrix.
    """
    (
        (distinct_nodes, indices_in_distinct_nodes),
        (distinct_directions, indices_in_distinct_directions),
    ) = (
        np.unique(entry_labels[..., label_part_index].ravel(), return_inverse=True)
        for label_part_index in range(2)
    )
    # One key for each label: unique rows take longer.
    label_keys = (
        indices_in_distinct_nodes * len(distinct_directions) + indices_in_distinct_directions
    )
    distinct_label_keys, label_indices = np.unique(label_keys, return_inverse=True)
    labels = np.column_stack(
        [
            distinct_nodes[distinct_label_keys // len(distinct_directions)],
            distinct_directions[distinct_label_keys % len(distinct_directions)],
        ]
    )
    row_indices, column_indices = label_indices.reshape(-1, 2).T
    n = len(labels)
    if has_both_triangles:
        return LabelledMatrix(
            sparse.csr_matrix((entries, (row_indices, column_indices)), (n, n)), labels
        )
    return LabelledMatrix(
        _make_matrix_from_triangle(entries, row_indices, column_indices, n), labels
    )


def _read_calculix(path: Path, labels_path: Path) -> LabelledMatrix:
    """Read a CalculiX matrix with the labels of its rows.

    Parameters
    ----------
    path : Path
        File .sti or .mas: row, column and value of each entry.
    labels_path : Path
        File with node and direction of each row (:func:`read_labels`).

    Raises
    ------
    ValueError
        An entry lies outside the labelled rows, or a row has no diagonal entry.
    """
    labels = read_labels(labels_path)
    entry_table, n = read_number_rows(path, 3, "#"), len(labels)
    indices = entry_table[:, :2]
    is_invalid = np.any((indices < 1) | (indices > n) | (indices % 1 != 0), axis=1)
    if np.any(is_invalid):
        line_number = int(np.argmax(is_invalid)) + 1
        raise ValueError(
            f"line {line_number}: entry {indices[line_number - 1].tolist()} is outside of {n} rows"
        )
    row_indices, column_indices = (indices - 1).astype(int).T
    rows_without_diagonal_entry = np.setdiff1d(
        np.arange(n), row_indices[row_indices == column_indices]
    )
    if len(rows_without_diagonal_entry):
        raise ValueError(
            f"it is incomplete: row {rows_without_diagonal_entry[0] + 1} of {n} has no diagonal "
            "entry"
        )
    return LabelledMatrix(
        _make_matrix_from_triangle(entry_table[:, 2], row_indices, column_indices, n), labels
    )


def _is_abaqus_file(path: Path) -> bool:
    """Return True for a matrix of Abaqus: the first data line has four commas."""
    return next((line for _, line in yield_numbered_lines(path, "*")), "").count(",") == 4


def _read_abaqus(path: Path) -> LabelledMatrix:
    """Read an Abaqus matrix with the labels of its rows.

    Clamped dofs have 1e36 on the diagonal. The rows and columns of these dofs are left out, and
    ``held_labels`` of the result lists the dofs.
    """
    entry_table = read_number_rows(path, 5, "*", ",")
    labelled_matrix = _build_labelled_matrix(
        entry_table[:, :4].astype(np.int64).reshape(-1, 2, 2),
        entry_table[:, 4],
        has_both_triangles=False,
    )
    assert labelled_matrix.labels is not None
    # 1e36 on the diagonal marks a dof that Abaqus holds.
    free_row_indices = np.flatnonzero(is_free := labelled_matrix.matrix.diagonal() < 1e36)
    held_labels = labelled_matrix.labels[~is_free]
    return LabelledMatrix(
        labelled_matrix.matrix[free_row_indices][:, free_row_indices],
        labelled_matrix.labels[free_row_indices],
        held_labels,
    )


def _read_nastran(path: Path, matrix_letter: str) -> LabelledMatrix:
    """Read a matrix DMIG from a Nastran .pch file, with the labels of its rows.

    The matrix's name begins with ``matrix_letter`` and a further letter, such as "KAAX" for "K".
    ValueError: no matrix or more than one matrix has such a name.
    """
    entry_labels: list[list[int]] = []
    entries: list[float] = []
    is_wanted_matrix, form, column_label = False, 6, ["", ""]
    for line_number, line in yield_numbered_lines(path, "$"):
        try:
            if line.startswith("DMIG "):
                is_wanted_matrix = re.match(f"{matrix_letter}[A-Z]", line[8:16].upper()) is not None
                if is_wanted_matrix and line[16:24].strip() == "0":
                    if entry_labels:
                        raise LookupError
                    form, type_code = int(line[24:32]), int(line[32:40])
                    if form not in (1, 6) or type_code not in (1, 2):
                        raise ValueError
            elif line.startswith("DMIG*"):
                matrix_name, *column_label = cut_fields(line, 16, 8, 56)
                is_wanted_matrix = (
                    re.match(f"{matrix_letter}[A-Z]", matrix_name.upper()) is not None
                )
            elif line.startswith("*"):
                if is_wanted_matrix:
                    *row_label, value_text = cut_fields(line, 16, 8, 56)
                    entry_labels.append([int(field) for field in (*row_label, *column_label)])
                    entries.append(parse_real(value_text))
            elif is_wanted_matrix:
                raise ValueError
        except LookupError:
            problem = (
                f"{line[8:16].strip()} is a second matrix whose name begins with {matrix_letter}"
            )
            raise ValueError(f"line {line_number}: {problem}") from None
        except ValueError:
            expected_format = "a real square matrix DMIG in fields of 16 characters"
            raise ValueError(
                f"line {line_number}: {line[:80]!r} is no line of {expected_format}"
            ) from None
    if not entry_labels:
        raise ValueError(f"it has no matrix DMIG whose name begins with {matrix_letter}")
    row_and_column_labels = np.array(entry_labels, dtype=np.int64).reshape(-1, 2, 2)
    return _build_labelled_matrix(
        row_and_column_labels, np.array(entries), has_both_triangles=form == 1
    )


def _read_op4(path: Path, matrix_letter: str) -> sparse.csr_matrix:
    """Read a matrix from a Nastran .op4 file.

    The matrix is the first one with a name that begins with ``matrix_letter``.

    The file has a line for the matrix, then a line for each column with the column's first row. If
    this row is 0, the column is sparse. A sparse column consists of strings: blocks of nonzero
    entries in successive rows. A line before each string gives the string's first row. The result
    is (n, n_columns).

    References
    ----------
    Nastran, DMAP Programmer's Guide, OUTPUT4.
    """
    lines = yield_numbered_lines(path, "$")
    line_number, line = 0, ""

    def read_line() -> str:
        """Read the next line, and remember it for errors."""
        nonlocal line_number, line
        line_number, line = next(lines)
        return line

    def read_integers(count: int) -> list[int]:
        """Read the next line's first ``count`` integers, of 8 characters each."""
        return [int(field) for field in cut_fields(read_line(), 8, 0, 8 * count)]

    def read_reals(count: int, width: int) -> list[float]:
        """Read ``count`` real numbers of ``width`` characters from further lines."""
        string_values: list[float] = []
        while len(string_values) < count:
            string_values += map(parse_real, cut_fields(read_line(), width))
        if len(string_values) > count:
            raise ValueError
        return string_values

    try:
        while True:
            n_columns, n_rows, _, type_code = read_integers(4)
            number_format = line[40:].upper().replace("D", "E")
            number_width = int(number_format.partition("E")[2].partition(".")[0])
            is_wanted_matrix = line[32:40].strip().upper().startswith(matrix_letter)
            if type_code not in (1, 2, 3, 4) or (is_wanted_matrix and type_code > 2):  # complex
                raise ValueError
            words_per_number = 2 if type_code in (2, 4) else 1
            entries: list[float] = []
            entry_row_column_pairs: list[tuple[int, int]] = []
            while True:
                column, first_row, n_words_left = read_integers(3)
                while n_words_left > 0:
                    n_words, string_first_row, n_header_words = n_words_left, first_row, 0
                    if first_row == 0 and n_rows < 0:
                        (n_words, string_first_row), n_header_words = read_integers(2), 2
                        n_words -= 1
                    elif first_row == 0:
                        n_words, string_first_row = divmod(int(read_line()), 65536)
                        n_words, n_header_words = n_words - 1, 1
                    # Strings count their words, dense columns their numbers.
                    string_values = read_reals(
                        n_words // words_per_number if n_header_words else n_words, number_width
                    )
                    n_words_left -= n_words + n_header_words
                    if is_wanted_matrix and column <= n_columns:
                        entries += string_values
                        entry_row_column_pairs += [
                            (string_first_row - 1 + row_offset, column - 1)
                            for row_offset in range(len(string_values))
                        ]
                if column > n_columns:
                    break
            if is_wanted_matrix:
                row_and_column_indices = (
                    np.array(entry_row_column_pairs, dtype=np.int64).reshape(-1, 2).T
                )
                matrix = sparse.csr_matrix(
                    (entries, tuple(row_and_column_indices)), (abs(n_rows), n_columns)
                )
                matrix.eliminate_zeros()  # between the numbers of a column
                return matrix
    except StopIteration:
        raise ValueError(f"it has no whole matrix whose name begins with {matrix_letter}") from None
    except ValueError:
        expected_format = "a real matrix that OUTPUT4 writes as text"
        raise ValueError(
            f"line {line_number}: {line[:80]!r} is no line of {expected_format}"
        ) from None


# --- Matrix Market --------------------------------------------------------------------------------


def read_matrix_market(path: Path, n_rows: int | None = None) -> sparse.csr_matrix:
    """Read a real matrix, dense or sparse, from a Matrix Market file.

    The file may be compressed (.gz, .bz2).

    Parameters
    ----------
    n_rows : int, optional
        Required number of rows. Default: any.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, or contradicts itself.
    """
    with open_lines_and_byte_limit(path) as (text_file, allowed_bytes):
        text_lines = iter(text_file)
        (layout, symmetry), sizes, n_entries = _read_header_and_sizes(text_lines, allowed_bytes)
        shape = sizes[0], sizes[1]
        if n_rows is not None and shape[0] != n_rows:
            raise ValueError(f"it has {shape[0]} rows instead of {n_rows}")
        if symmetry != "general" and shape[0] != shape[1]:
            raise ValueError(f"it is declared {symmetry}, but has shape {shape}")
        table = parse_number_rows(text_lines, "%", max_rows=n_entries + 1)
    n_found = table.size if layout == "array" else len(table)
    if n_found != n_entries:
        # Reading stops after one too many.
        entry_count_text = "more" if n_found > n_entries else n_found
        raise ValueError(f"it has {entry_count_text} entries instead of {n_entries}")
    if layout == "array":
        entries, rows_and_columns = table.ravel(), _dense_row_and_column_indices(shape, symmetry)
    elif max(shape) > max(len(table), n_rows or 1):
        raise ValueError(f"it has shape {shape}, but only {len(table)} entries")
    else:
        entries, rows_and_columns = _split_entries_and_positions(table, shape, symmetry)
    if symmetry == "general":
        matrix = sparse.csr_matrix((entries, rows_and_columns), shape)
    else:
        matrix = _make_matrix_from_triangle(
            entries, *rows_and_columns, shape[0], TRANSPOSE_SIGN_BY_SYMMETRY[symmetry]
        )
    if layout == "array":
        matrix.eliminate_zeros()
    return matrix


def format_matrix_market(matrix: sparse.spmatrix) -> str:
    """Return the text of a Matrix Market file.

    Every number is read back exactly. A symmetric matrix is written as one triangle.
    """
    coo_matrix, symmetry = sparse.coo_matrix(matrix), "general"
    if coo_matrix.shape[0] == coo_matrix.shape[1] and (coo_matrix != coo_matrix.T).nnz == 0:
        coo_matrix, symmetry = sparse.tril(coo_matrix, format="coo"), "symmetric"
    table_columns = coo_matrix.row + 1, coo_matrix.col + 1, coo_matrix.data
    entry_tuples = zip(*(column.tolist() for column in table_columns), strict=True)
    lines = [f"{row} {column} {value!r}\n" for row, column, value in entry_tuples]
    sizes_line = f"{coo_matrix.shape[0]} {coo_matrix.shape[1]} {coo_matrix.nnz}"
    return "".join([f"%%MatrixMarket matrix coordinate real {symmetry}\n{sizes_line}\n", *lines])


def read_matrix_market_shape(path: Path) -> tuple[int, int]:
    """Read the numbers of rows and columns that a Matrix Market file announces.

    A sparse file with more columns than entries is refused.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, contradicts itself, or is refused.
    """
    with open_lines_and_byte_limit(path) as (text_file, allowed_bytes):
        _, sizes, _ = _read_header_and_sizes(iter(text_file), allowed_bytes)
    if len(sizes) == 3 and sizes[1] > sizes[2]:
        raise ValueError(f"it has {sizes[1]} columns, but only {sizes[2]} entries")
    return sizes[0], sizes[1]


def _read_header_and_sizes(
    lines: Iterator[str], allowed_bytes: int
) -> tuple[tuple[str, str], list[int], int]:
    """Read the header and the line with the sizes from a Matrix Market file.

    Parameters
    ----------
    lines : iterator of str
        Lines of the file. Afterwards the iterator stands at the first entry.
    allowed_bytes : int
        Maximum size [byte] of the file's text. Used to refuse a file with too many announced
        entries.

    Returns
    -------
    header : (str, str)
        Layout and symmetry, such as ("coordinate", "symmetric").
    sizes : list of int
        Numbers of rows and columns. A sparse file also has the number of entries.
    n_entries : int
        Number of entries that the file must hold.

    Raises
    ------
    ValueError
        A line is wrong, or more entries are announced than fit in ``allowed_bytes``.
    """
    layout_and_symmetry = _parse_header(next(lines, ""))
    line = next((line for line in lines if line.strip() and not line.startswith("%")), "")
    sizes = [int(size_word) for size_word in line.split()]
    if len(sizes) != (3 if layout_and_symmetry[0] == "coordinate" else 2) or min(sizes) < 0:
        raise ValueError("the line with the numbers of rows and columns is missing or wrong")
    n_rows, n_columns = sizes[:2]
    if len(sizes) == 3:
        n_entries = sizes[2]
    elif transpose_sign := TRANSPOSE_SIGN_BY_SYMMETRY.get(
        layout_and_symmetry[1]
    ):  # from the diagonal down
        n_entries = n_rows * (n_rows + transpose_sign) // 2
    else:
        n_entries = n_rows * n_columns
    if n_entries * MIN_ENTRY_BYTES_BY_LAYOUT[layout_and_symmetry[0]] > allowed_bytes:
        raise ValueError(f"it announces {n_entries} entries, too many for its size")
    return layout_and_symmetry, sizes, n_entries


def _parse_header(line: str) -> tuple[str, str]:
    """Return layout and symmetry from the first line of a Matrix Market file.

    ValueError: the line is wrong, or the entries are not real.
    """
    words = line.lower().split()
    if len(words) != 5 or words[:2] != ["%%matrixmarket", "matrix"]:
        raise ValueError("it does not begin with %%MatrixMarket matrix")
    layout, field, symmetry = words[2:]
    for word, allowed_words in (
        (layout, MATRIX_LAYOUTS),
        (field, ENTRY_TYPES),
        (symmetry, SYMMETRIES),
    ):
        if word not in allowed_words:
            raise ValueError(
                f"its first line has {word!r} instead of one of {', '.join(allowed_words)}"
            )
    return layout, symmetry


def _dense_row_and_column_indices(
    shape: tuple[int, int], symmetry: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column indices of the entries in a dense Matrix Market file.

    Both arrays are (m,) int, from 0. The file has column after column. A symmetric matrix has only
    the entries on the diagonal and below, a skew-symmetric one only those below.
    """
    if symmetry == "general":
        columns, rows = np.indices(shape[::-1]).reshape(2, -1)
    else:
        columns, rows = np.triu_indices(shape[0], symmetry == "skew-symmetric")
    return rows, columns


def _split_entries_and_positions(
    table: np.ndarray, shape: tuple[int, int], symmetry: str
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Split the table of a sparse Matrix Market file into values and positions.

    ``table`` (m, 3) has row and column, from 1, and value of each entry. ``shape`` is that of the
    matrix. ``symmetry`` is the word in the file's header, such as "general". ValueError: the table
    contradicts them.

    Returns
    -------
    (m,)
        Values of the entries.
    ((m,), (m,)) int
        Rows and columns of these entries, from 0.
    """
    if len(table) and table.shape[1] != 3:
        raise ValueError(
            f"its entries have {table.shape[1]} numbers instead of 3: row, column, value"
        )
    table = table.reshape(-1, 3)
    if not np.all((table[:, :2] >= 1) & (table[:, :2] <= shape) & (table[:, :2] % 1 == 0)):
        raise ValueError("an entry lies outside of the matrix")
    rows, columns = table[:, :2].astype(np.int64).T - 1
    if symmetry != "general" and np.any(rows < columns):
        raise ValueError(f"it is declared {symmetry}, but has entries above the diagonal")
    return table[:, 2], (rows, columns)


# --- lines ----------------------------------------------------------------------------------------


def yield_numbered_lines(path: Path, comment: str) -> Iterator[tuple[int, str]]:
    """Yield the number, from 1, and the text of each line in a file.

    Text from the character ``comment`` on is cut off, and empty lines are left out.
    """
    with open_lines_and_byte_limit(path, "replace") as (text_file, _):
        for line_number, line in enumerate(text_file, 1):
            if text := line.partition(comment)[0].rstrip():
                yield line_number, text


def cut_fields(line: str, width: int, start: int = 0, stop: int | None = None) -> list[str]:
    """Cut a line into fields with ``width`` characters each.

    The fields are those from character ``start`` to ``stop``, or to the end of the line. Fields
    after the end of the line are empty.
    """
    columns = range(start, len(line) if stop is None else stop, width)
    return [line[column : column + width].strip() for column in columns]


def parse_real(field: str) -> float:
    """Parse a real number of Fortran, as "1.5D-3", or of Nastran, as "1.5-3"."""
    return float(re.sub(r"(?<=[\d.])([+-]\d+)$", r"E\1", field.upper().replace("D", "E")))


def read_number_rows(
    path: Path, n_columns: int, comment: str, delimiter: str | None = None
) -> np.ndarray:
    """Read a table of numbers (n, n_columns) from a text file.

    Parameters
    ----------
    path : Path
        The file.
    n_columns : int
        Required number of columns.
    comment : str
        Character at which a comment begins; the rest of the line is ignored.
    delimiter : str or None
        Text between two numbers. None: white space.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, or a line has other than ``n_columns`` finite numbers.
    """
    try:
        with open_lines_and_byte_limit(path) as (text_file, _):
            rows_of_numbers = parse_number_rows(text_file, comment, delimiter)
        if (
            rows_of_numbers.shape[1] == n_columns
            and len(rows_of_numbers)
            and np.all(np.isfinite(rows_of_numbers))
        ):
            return rows_of_numbers
    except ValueError:  # NumPy's message counts lines in another way than an editor
        pass
    for line_number, line in yield_numbered_lines(path, comment):
        try:
            row = [float(word) for word in line.split(delimiter)]
        except ValueError:
            row = []
        if len(row) != n_columns or not np.all(np.isfinite(row)):
            raise ValueError(f"line {line_number}: {line[:80]!r} instead of {n_columns} numbers")
    raise ValueError("it holds no numbers")
