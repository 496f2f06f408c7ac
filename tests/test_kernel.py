"""The compiled kernel against the same equations in NumPy, also with checks of its addresses."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from intervals import contact_intervals

from fenics_crack import UnilateralPenalty
from fenics_crack.balance.contact_integrals import (
    CoupledIntegrals,
    ExactIntegrals,
    respond,
    respond_to_columns,
)
from fenics_crack.balance.contact_system import CompiledEquations
from fenics_crack.kernel import doubles, ints, shaped, signs
from fenics_crack.model.coupled import ActiveSets, solve_complementarity

OTHERS = [
    ROOT / "tests" / name
    for name in (
        "balance/test_active_sets.py", "balance/test_compiled_paths.py",
        "motion/test_contact_flow.py", "numerics/test_paths.py", "time/test_compiled_marches.py",
    )
]  # fmt: skip
"""Other files whose tests are run with it."""

WITH_CHECKS = """
import importlib.util, sys, pytest
name = "fenics_crack.kernel._kernel"
spec = importlib.util.spec_from_file_location(name, sys.argv[1])
sys.modules[name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules[name])
sys.exit(pytest.main(["-q", "-x", "-n", "0", "-p", "no:cacheprovider", *sys.argv[2:]]))
"""


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 25), st.integers(0, 2**32 - 1), st.booleans())
def test_complementarity(pairs: int, seed: int, guessed: bool) -> None:
    """0 <= f, D f - g >= 0, f (D f - g) = 0 hold to rounding: there is one such f."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(pairs, pairs + 2))
    matrix, gap = root @ root.T + 1e-3 * np.eye(pairs), random.normal(size=pairs)
    closed = random.random(pairs) < 0.5 if guessed else None
    force = solve_complementarity(matrix, gap, closed)
    opening = matrix @ force - gap
    assert force.min() >= 0.0
    assert opening.min() >= -1e-9 * np.abs(gap).max()
    assert np.abs(force * opening).max() <= 1e-9 * np.abs(gap).max() * max(1.0, force.max())


TWO = ActiveSets(np.eye(2))
BEHIND = CoupledIntegrals(UnilateralPenalty(1.0), 1, residual=np.eye(2))
SYSTEM = CompiledEquations(None, np.ones(2), np.zeros((3, 2)), np.zeros((2, 2, 2), complex))
WRONG = {
    "complementarity, a matrix too small": lambda: solve_complementarity(np.eye(2), np.ones(3)),
    "complementarity, a guess too short": lambda: solve_complementarity(
        np.eye(3), np.ones(3), np.ones(2, bool)
    ),
    "complementarity, gaps in rows": lambda: solve_complementarity(np.eye(3), np.ones((3, 2))),
    "contact integrals, too few rows": lambda: ExactIntegrals(UnilateralPenalty(1.0), 3).force(
        np.ones((5, 2))
    ),
    "intervals, an even number of rows": lambda: contact_intervals(np.ones((4, 2)), TWO),
    "intervals, other pairs": lambda: contact_intervals(np.ones((3, 5)), TWO),
    "coupled forces, other harmonics": lambda: BEHIND.linearise(np.ones((5, 2))),
    "coupled forces, another change": lambda: BEHIND.linearise(np.ones((3, 2))).apply(np.ones(6)),
    "sets, a compliance not square": lambda: ActiveSets(np.ones((3, 2))),
    "sets, other pairs": lambda: TWO.solve(np.ones((4, 3))),
    "sets, a guess too short": lambda: TWO.solve(np.ones((4, 2)), np.ones((3, 2), bool)),
    "inverses, other pairs": lambda: TWO.stack(np.ones((4, 3), bool)),
    "responses, other pairs": lambda: respond(np.ones((2, 3, 3)), np.ones((3, 2))),
    "responses, an even number of rows": lambda: respond(np.ones((3, 2, 2)), np.ones((4, 2))),
    "columns, an even number of rows": lambda: respond_to_columns(
        np.ones((3, 2, 2)), np.ones((2, 4, 5))
    ),
    "system, fewer stiffnesses": lambda: CompiledEquations(
        None, np.ones(1), np.zeros((3, 2)), np.zeros((2, 2, 2), complex)
    ),
    "system, another point": lambda: SYSTEM.linearise(np.ones((5, 2)), 1.0),
    "system, another right side": lambda: SYSTEM.linearise(np.ones((3, 2)), 1.0).solve(np.ones(4)),
    "doubles of whole numbers": lambda: doubles(np.ones(3, int)),
    "doubles with gaps": lambda: doubles(np.ones((4, 4))[:, 1]),
    "doubles of the other order of bytes": lambda: doubles(np.ones(3, ">f8")),
    "ints of long ones": lambda: ints(np.ones(3, np.int64)),
    "signs of doubles": lambda: signs(np.ones(3)),
    "another shape": lambda: shaped(np.ones((3, 2)), 3, 3),
}  # fmt: skip


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG.keys())
def test_wrong_shapes_are_refused(call: Callable[[], object]) -> None:
    """Nothing is read beyond an array; also where Python leaves out what is asserted (-O)."""
    with pytest.raises(ValueError, match=r"instead of|contiguous"):
        call()


def test_shapes_that_fit_are_not_copied() -> None:
    """But where the kind or the order is another."""
    array = np.ones((3, 2))
    assert shaped(array, 3, 2) is array
    assert shaped(array.T, 2, 3).flags.c_contiguous
    assert shaped(array, 3, 2, kind=complex).dtype == complex


@pytest.mark.slow
def test_with_checks_of_addresses(tmp_path: Path) -> None:
    """The tests above with a kernel that ends the process where it reads outside its arrays."""
    build = ROOT / "fenics_crack" / "kernel" / "build.py"
    subprocess.run([sys.executable, build, "--sanitize", tmp_path], check=True)
    library = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True
    ).stdout.strip()
    known = {"LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0"}
    done = subprocess.run(
        [sys.executable, "-c", WITH_CHECKS, tmp_path / "_kernel.abi3.so", __file__, *OTHERS],
        cwd=ROOT, env=os.environ | known, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
