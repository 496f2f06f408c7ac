"""Matrix Market files: what SciPy writes is read; what a file does not keep is refused."""

from __future__ import annotations

import bz2
import gzip
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sparse
from helpers import catch_error, scene_of_matrices

import fenics_crack as fc

RANDOM = sparse.random(30, 30, 0.3, random_state=1).tocsr()
N = RANDOM.shape[0]
KINDS = {"general": RANDOM, "symmetric": RANDOM + RANDOM.T, "skew-symmetric": RANDOM - RANDOM.T}


def read(path: Path) -> np.ndarray:
    """The matrix of a file, of gaps, which may be of any symmetry."""
    return fc.Structure.from_matrices(np.eye(N), np.eye(N), gap=path).gap.toarray()


def check_refused(path: Path, reason: str | None) -> None:
    """Check that a matrix is refused as it is read, whatever its size."""
    catch_error(
        partial(fc.Structure.from_matrices, path, np.eye(2), gap=None),
        "mass",
        str(path),
        names=reason,
    )


@pytest.mark.parametrize("symmetry", KINDS)
@pytest.mark.parametrize("dense", [False, True])
def test_as_written_by_scipy(tmp_path: Path, symmetry: str, dense: bool) -> None:
    """Dense and sparse, of every symmetry, compressed or not."""
    matrix = KINDS[symmetry].toarray()
    path = tmp_path / "matrix.mtx"
    written_matrix = matrix if dense else sparse.csr_matrix(matrix)
    scipy.io.mmwrite(path, written_matrix, symmetry=symmetry, precision=17)
    packed_path = tmp_path / "matrix.mtx.gz"
    packed_path.write_bytes(gzip.compress(path.read_bytes()))
    for file in (path, packed_path):
        np.testing.assert_allclose(read(file), matrix, rtol=1e-15)


def test_integers(tmp_path: Path) -> None:
    """Whole numbers."""
    path = tmp_path / "matrix.mtx"
    scipy.io.mmwrite(path, (RANDOM != 0.0).astype(int), field="integer")
    np.testing.assert_array_equal(read(path), RANDOM.toarray() != 0.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "does not begin"),
        ("matrix array complex general\n1 1\n1 0\n", "'complex' instead of"),
        ("matrix coordinate pattern general\n1 1 1\n1 1\n", "'pattern' instead of"),
        ("matrix array real general\n", "line with the numbers"),
        ("matrix array real general\n2 1\n1\n2\n3\n", "more entries instead of 2"),
        ("matrix array real symmetric\n2 1\n1\n2\n", "symmetric, but has shape"),
        ("matrix coordinate real general\n2 2 1\n1 1 1\n2 2 1\n", "more entries instead of 1"),
        ("matrix coordinate real general\n2 2 2\n1 1 1\n3 2 1\n", "outside of the matrix"),
        ("matrix coordinate real general\n3 1 3\n1 1 1\n1 2 1\n1 3 1\n", "outside of the matrix"),
        ("matrix coordinate real general\n2 2 2\n1 1 1\n1.5 2 1\n", "outside of the matrix"),
        ("matrix coordinate real symmetric\n2 2 2\n1 1 1\n1 2 1\n", "above the diagonal"),
        ("matrix coordinate real general\n9 9 1\n1 1 1\n", "but only 1 entries"),
        ("matrix coordinate real general\n2 2 2\n1 1\n2 2\n", "2 numbers instead of 3"),
        ("matrix coordinate real general\n9 9 1000000000000\n1 1 1\n", "too many for its size"),
        ("matrix array real general\n1000000 1000000\n1\n", "too many for its size"),
        ("matrix coordinate real general\n9 9 99999999999999999999999\n1 1 1\n", "too many"),
        ("matrix coordinate real general\n1000000 1000000 1\n1 1 1\n", "has shape"),
        ("matrix array real symmetric\n1000000 1000000\n1\n", "too many for its size"),
    ],
)
def test_what_a_file_does_not_keep(tmp_path: Path, text: str, reason: str) -> None:
    """Each fault is named."""
    path = tmp_path / "matrix.mtx"
    path.write_text(text and f"%%MatrixMarket {text}")
    check_refused(path, reason)


@pytest.mark.drawn(3)
@pytest.mark.parametrize(
    ("packed", "kind"),
    [(gzip.compress, kind) for kind in ("lines", "one line", "comments", "announced")]
    + [(bz2.compress, "one line"), (bz2.compress, "announced")],
)
def test_bombs(tmp_path: Path, packed: Callable[[bytes], bytes], kind: str) -> None:
    """What is unpacked is limited by the size of the file."""
    path = tmp_path / ("matrix.mtx" + (".gz" if packed is gzip.compress else ".bz2"))
    size, max_entries = b"100000000 1" if kind == "announced" else b"2 1", 2**24 + 1
    body = {
        "lines": b"0\n" * (max_entries // 2 + 1),
        "comments": (b"%" * 999 + b"\n") * (max_entries // 999),
    }
    body |= {"one line": b"0" * max_entries, "announced": b""}
    path.write_bytes(
        packed(b"%%MatrixMarket matrix array real general\n" + size + b"\n" + body[kind])
    )
    assert path.stat().st_size < 200_000
    reason = {"lines": "more entries", "announced": "too many for its size"}
    check_refused(path, reason.get(kind, "too large for a packed file"))


def test_columns_without_an_entry(tmp_path: Path) -> None:
    """They are not counted: a sweep makes no room for the million pairs of a file of a line."""
    parts = {"mass": sparse.eye(3), "stiffness": sparse.eye(3), "force_sin": np.ones((3, 1))}
    lines = "%%MatrixMarket matrix coordinate real general\n3 1000000 1\n1 1 1.0\n"
    (tmp_path / "gap.mtx").write_text(lines)
    tables = {
        "structure": {"gap": "gap.mtx"},
        "contact": {"law": "penalty", "stiffness": 1.0},
        "damping": {"ratio": 0.1},
        "excitation": {"omega": 0.5},
        "sweep": {"over": {"excitation.omega": [0.5, 0.6]}},
    }
    scene = scene_of_matrices(tmp_path, parts, tables)
    sweep = fc.run_sweep(scene, tmp_path / "sweep.h5")
    assert not sweep.converged.any() and sweep.path.stat().st_size < 10**6


def test_neither_devices_nor_pipes(tmp_path: Path) -> None:
    """They need not end."""
    os.mkfifo(tmp_path / "pipe.mtx")
    for path in (Path("/dev/zero"), tmp_path / "pipe.mtx", tmp_path):
        check_refused(path, None)
