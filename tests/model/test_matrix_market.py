"""Matrix Market files: what SciPy writes is read; what a file does not keep is refused."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sparse

from fenics_crack.model.matrix_market import read_matrix_market

RANDOM = sparse.random(30, 30, 0.1, random_state=1).tocsr()
KINDS = {"general": RANDOM, "symmetric": RANDOM + RANDOM.T, "skew-symmetric": RANDOM - RANDOM.T}


@pytest.mark.parametrize("symmetry", KINDS)
@pytest.mark.parametrize("dense", [False, True])
def test_as_written_by_scipy(tmp_path: Path, symmetry: str, dense: bool) -> None:
    """Dense and sparse, of every symmetry, compressed or not."""
    matrix = KINDS[symmetry].toarray()
    path = tmp_path / "matrix.mtx"
    written = matrix if dense else sparse.csr_matrix(matrix)
    scipy.io.mmwrite(path, written, symmetry=symmetry, precision=17)
    packed = tmp_path / "matrix.mtx.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    for file in (path, packed):
        found = read_matrix_market(file)
        assert sparse.issparse(found) is not dense
        np.testing.assert_allclose(found if dense else found.toarray(), matrix, rtol=1e-15)


def test_integers_and_patterns(tmp_path: Path) -> None:
    """Whole numbers; and places alone, which stand for ones."""
    path = tmp_path / "matrix.mtx"
    for field in ("integer", "pattern"):
        scipy.io.mmwrite(path, (RANDOM != 0.0).astype(int), field=field)
        np.testing.assert_array_equal(read_matrix_market(path).toarray(), RANDOM.toarray() != 0.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "does not begin"),
        ("matrix array complex general\n1 1\n1 0\n", "'complex' instead of"),
        ("matrix array pattern general\n1 1\n", "without values"),
        ("matrix array real general\n", "size is missing"),
        ("matrix array real general\n2 1\n1\n2\n3\n", "3 entries instead of 2"),
        ("matrix array real symmetric\n2 1\n1\n2\n", "symmetric, but of shape"),
        ("matrix coordinate real general\n2 2 1\n1 1 1\n2 2 1\n", "2 entries instead of 1"),
        ("matrix coordinate real general\n2 2 2\n1 1 1\n3 2 1\n", "outside of the matrix"),
        ("matrix coordinate real general\n2 2 2\n1 1 1\n1.5 2 1\n", "outside of the matrix"),
        ("matrix coordinate real symmetric\n2 2 2\n1 1 1\n1 2 1\n", "above the diagonal"),
        ("matrix coordinate real general\n9 9 1\n1 1 1\n", "has only 1 entries"),
        ("matrix coordinate real general\n2 2 2\n1 1\n2 2\n", "2 numbers instead of 3"),
    ],
)
def test_what_a_file_does_not_keep(tmp_path: Path, text: str, reason: str) -> None:
    """Each fault is named."""
    path = tmp_path / "matrix.mtx"
    path.write_text(text and f"%%MatrixMarket {text}")
    with pytest.raises(ValueError, match=reason):
        read_matrix_market(path)
