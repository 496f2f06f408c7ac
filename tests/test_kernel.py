"""The compiled kernel against the same equations in NumPy, also with checks of its addresses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from fenics_crack.model.complementarity import solve_complementarity

CHECKED = "CHECKED_KERNEL"
"""Environment variable, set in a run with a kernel that checks its addresses."""

OTHERS = [
    ROOT / "tests" / name
    for name in (
        "balance/test_active_sets.py", "balance/test_compiled_paths.py",
        "motion/test_flow.py", "motion/test_path.py", "time/test_compiled_marches.py",
    )
]  # fmt: skip
"""Other files whose tests are run with it."""

WITH_CHECKS = """
import importlib.util, sys, pytest
name = "fenics_crack.kernel._kernel"
spec = importlib.util.spec_from_file_location(name, sys.argv[1])
sys.modules[name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules[name])
sys.exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *sys.argv[2:]]))
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


def test_with_checks_of_addresses(tmp_path: Path) -> None:
    """The tests above with a kernel that ends the process where it reads outside its arrays."""
    if CHECKED in os.environ:
        pytest.skip("this is that run")
    build = ROOT / "fenics_crack" / "kernel" / "build.py"
    subprocess.run([sys.executable, build, "--sanitize", tmp_path], check=True)
    library = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True
    ).stdout.strip()
    known = {"LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0", CHECKED: "1"}
    done = subprocess.run(
        [sys.executable, "-c", WITH_CHECKS, tmp_path / "_kernel.abi3.so", __file__, *OTHERS],
        cwd=ROOT, env=os.environ | known, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
