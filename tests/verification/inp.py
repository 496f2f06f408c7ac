"""Plates as input files of CalculiX, run, and its tables read."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import fenics_crack as fc


def calculix() -> str | None:
    """Name and version; None where it is not installed."""
    program = shutil.which("ccx")
    if not program:
        return None
    said = subprocess.run([program, "-v"], capture_output=True, text=True, check=False).stdout
    return f"CalculiX {said.split()[-1]}"


def mesh_lines(structure: fc.Structure, scene: fc.Scene) -> list[str]:
    """Nodes, six-node triangles in plane stress, material and clamp of a plate of order 2.

    The nodes of the lips are double, as ours are. Nodes and dofs count from 1. Numbers
    may have 20 characters.
    """
    assert structure.nodes is not None
    points, dofs, cells = structure.nodes.points, structure.nodes.dofs, structure.nodes.cells
    assert cells.shape[1] == 6
    a, b, c = (points[cells[:, corner]] for corner in range(3))
    one, two = b - a, c - a
    turned = one[:, 0] * two[:, 1] < one[:, 1] * two[:, 0]
    cells = np.where(turned[:, None], cells[:, [0, 2, 1, 5, 4, 3]], cells)
    material = scene.material
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i + 1}, {x:.13e}, {y:.13e}, 0.0" for i, (x, y) in enumerate(points)]
    lines += ["*ELEMENT, TYPE=CPS6, ELSET=PLATE"]
    lines += [
        f"{i + 1}, " + ", ".join(str(node + 1) for node in cell) for i, cell in enumerate(cells)
    ]
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", f"{material.young:.13e}, {material.poisson:.13e}"]
    lines += ["*DENSITY", f"{material.density:.13e}"]
    lines += ["*SOLID SECTION, ELSET=PLATE, MATERIAL=M", f"{scene.geometry.thickness:.13e}"]
    lines += ["*BOUNDARY"]
    lines += [f"{node + 1}, {axis + 1}" for node, axis in np.argwhere(dofs < 0)]
    return lines


def ties(structure: fc.Structure) -> list[str]:
    """B^T u = 0 as equations."""
    assert structure.nodes is not None
    places = {int(dof): place for place, dof in np.ndenumerate(structure.nodes.dofs)}
    lines = []
    for column in structure.apply_bt(np.eye(structure.n_dofs)).T:
        used = np.flatnonzero(column)
        terms = [
            f"{places[int(dof)][0] + 1}, {places[int(dof)][1] + 1}, {column[dof]:.13e}"
            for dof in used
        ]
        lines += ["*EQUATION", str(len(used)), ", ".join(terms)]
    return lines


def run(lines: list[str]) -> str:
    """What CalculiX writes into its .dat file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "plate.inp"
        path.write_text("\n".join(lines) + "\n")
        command = [str(shutil.which("ccx")), "-i", "plate"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-2000:]
        return path.with_suffix(".dat").read_text()


def natural(lines: list[str], count: int) -> np.ndarray:
    """Natural angular frequencies [rad/s] of a model."""
    table = run([*lines, "*STEP", "*FREQUENCY", str(count), "*END STEP"])
    return np.array([float(row[2]) for row in _numbers(table) if len(row) == 5][:count])


def static(lines: list[str], structure: fc.Structure, force: np.ndarray) -> np.ndarray:
    """Displacement of all nodes (m, 2) under a force on the dofs."""
    assert structure.nodes is not None
    dofs = structure.nodes.dofs
    loads = [
        f"{node + 1}, {axis + 1}, {force[dofs[node, axis]]:.13e}"
        for node, axis in np.argwhere(dofs >= 0)
        if force[dofs[node, axis]]
    ]
    table = run(
        [*lines, "*STEP", "*STATIC", "*CLOAD", *loads, "*NODE PRINT, NSET=ALL", "U", "*END STEP"]
    )
    found = np.zeros(dofs.shape)
    for row in _numbers(table):
        if len(row) == 4 and int(row[0]) <= len(found):
            found[int(row[0]) - 1] = float(row[1]), float(row[2])
    return found


def _numbers(table: str) -> list[list[str]]:
    """Lines of the table that are numbers alone, the first of them whole."""
    rows = [line.split() for line in table.splitlines()]
    number = re.compile(r"[-+]?\d*\.\d+(?:E[-+]?\d+)?")
    return [
        row for row in rows
        if row and row[0].isdigit() and all(number.fullmatch(word) for word in row[1:])
    ]  # fmt: skip
