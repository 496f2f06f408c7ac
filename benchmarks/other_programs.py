"""Matrices of CalculiX: what it costs to read them, and what comes out.

A cantilever of 300 x 20 x 20 mm with a crack of 6 mm through it is meshed, finer and finer, and
written as an input file of CalculiX (`apt-get install calculix-ccx`), which finds its natural
frequencies, and writes its matrices. These are read with the input file, and the pairs are found.

Columns: dofs; pairs; processor times [s] of reading with all checks, of six frequencies, and of a
solution with 20 modes at 0.9 of the bilinear frequency, with its verdict; `furthest`: largest
relative difference of the frequencies from CalculiX's own, which have seven digits; the verdict.

    OMP_NUM_THREADS=1 python benchmarks/other_programs.py [--quick] [folder]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import numpy as np

import fenics_crack as fc

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
from inp import mesh_lines, natural, stored_matrices

SCENE = """
geometry = { kind = "solid", width = 0.02, height = 0.3, thickness = 0.02 }
material = { young = 2.06e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = [0.0, 0.3, 0.01], force_cos = [1.0, 0.0, 0.0], frequency = 160.0 }
contact = { law = "unilateral" }
crack = { edge = "left", height = 0.08, length = 0.006 }
mesh = { layout = "graded", order = 2, size = 0.007, lip_elements = 3, error = false }
"""
MESHES = [(0.007, 3), (0.005, 4), (0.0035, 6)]
COLUMNS = ["dofs", "pairs", "read", "frequencies", "solve", "furthest", "verdict"]


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """What a function returns, and its processor time [s]."""
    start = time.process_time()
    return function(), time.process_time() - start


def row(size: float, lips: int) -> list[object]:
    """One mesh."""
    scene = fc.Scene.from_text(SCENE).replace({"mesh.size": size, "mesh.lip_elements": lips})
    lines = mesh_lines(fc.build_structure(scene), scene, "C3D10")
    theirs = natural(lines, 6)
    with stored_matrices(lines, scene) as read:
        structure, reading = timed(lambda: fc.build_structure(read))
        modes, finding = timed(lambda: fc.solve_modes(structure, 6))
        near = 0.9 * fc.bilinear_frequencies(structure).omega_bilinear[0]
        changes = {"excitation.omega": near, "reduction.modes": 20}
        run, solving = timed(lambda: fc.solve(read.replace(changes)))
    found = run.result.stability
    return [
        structure.n_dofs, structure.n_pairs, reading, finding, solving,
        float(np.abs(modes.omega / theirs - 1.0).max()), found.verdict if found else "not judged",
    ]  # fmt: skip


def measure(arguments: common.Arguments) -> None:
    """All meshes, or the first."""
    rows = [row(*mesh) for mesh in (MESHES[:1] if arguments.quick else MESHES)]
    common.save_table(arguments.folder / "other_programs.csv", "CalculiX", COLUMNS, rows)


if __name__ == "__main__":
    common.run(__doc__, {"calculix": measure})
