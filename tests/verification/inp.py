"""Plates and solids as input files of CalculiX, run, and its tables read."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import fenics_crack as fc
from fenics_crack.disk.cyclic import Sector

CORNERS = {"CPE6": 6, "CPE8": 8, "CPS8": 8, "C3D8": 4, "C3D10": 10}
"""Nodes of a cell that an element of CalculiX takes, in VTK's order, which is its own."""


def calculix() -> str | None:
    """Name and version; None where it is not installed."""
    program = shutil.which("ccx")
    if not program:
        return None
    output = subprocess.run([program, "-v"], capture_output=True, text=True, check=False).stdout
    return f"CalculiX {output.split()[-1]}"


def mesh_lines(
    structure: fc.Structure, scene: fc.Scene, element: str, followers: Sequence[int] = ()
) -> list[str]:
    """Nodes, elements, material and clamp of a plate, or of a solid of C3D10.

    Nodes that are to follow others must not be clamped, too, and are left out there. The nodes of
    the crack faces are double, as ours are. Nodes and dofs count from 1. Numbers may have 20
    characters. Of plates all but CPS8 are in plane strain: they get E (1 + 2 nu) / (1 + nu)^2 and
    nu / (1 + nu), with which plane strain is plane stress with E and nu. C3D8 is a layer of bricks
    of the plate's thickness between two planes; the nodes of the second have the numbers of the
    first, increased by the number of nodes.
    """
    points, dofs = structure.nodes.points, structure.nodes.dofs
    solid, layer = points.shape[1] == 3, element == "C3D8"
    thickness = scene.geometry.thickness
    cells = structure.nodes.cells[:, : CORNERS[element]]
    cells = cells if solid else _counterclockwise(points, cells)
    used_nodes = np.unique(cells)
    clamped_dofs, leaders = np.argwhere(dofs < 0), np.setdiff1d(used_nodes, followers)
    lines = ["*NODE, NSET=FRONT", *_nodes(points, used_nodes, 0, 0.0)]
    if layer:
        cells = np.hstack([cells, cells + len(points)])
        lines += ["*NODE, NSET=BACK", *_nodes(points, used_nodes, len(points), thickness)]
    lines += [f"*ELEMENT, TYPE={element}, ELSET=PLATE"]
    lines += [
        f"{i + 1}, " + ", ".join(str(node + 1) for node in cell) for i, cell in enumerate(cells)
    ]
    young, poisson = scene.material.young, scene.material.poisson
    if not solid and element != "CPS8":
        young, poisson = young * (1 + 2 * poisson) / (1 + poisson) ** 2, poisson / (1 + poisson)
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", f"{young:.13e}, {poisson:.13e}"]
    lines += ["*DENSITY", f"{scene.material.density:.13e}"]
    if scene.damping.stiffness:
        lines += [f"*DAMPING, ALPHA=0.0, BETA={scene.damping.stiffness:.13e}"]
    lines += ["*SOLID SECTION, ELSET=PLATE, MATERIAL=M"]
    lines += [] if solid or layer else [f"{thickness:.13e}"]
    lines += ["*BOUNDARY"]
    for shift in (0, len(points)) if layer else (0,):
        lines += [
            f"{node + 1 + shift}, {axis + 1}" for node, axis in clamped_dofs if node in leaders
        ]
    return lines + (["FRONT, 3", "BACK, 3"] if layer else [])


def _counterclockwise(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    a, b, c = (points[cells[:, corner]] for corner in range(3))
    first_edge, second_edge = b - a, c - a
    is_clockwise = first_edge[:, 0] * second_edge[:, 1] < first_edge[:, 1] * second_edge[:, 0]
    if cells.shape[1] != 6:
        assert not is_clockwise.any()
        return cells
    return np.where(is_clockwise[:, None], cells[:, [0, 2, 1, 5, 4, 3]], cells)


def _nodes(points: np.ndarray, used: np.ndarray, shift: int, z: float) -> list[str]:
    places = np.column_stack([points, np.full(len(points), z)])[used, :3].tolist()
    return [
        f"{i + 1 + shift}, " + ", ".join(f"{x:.13e}" for x in place)
        for i, place in zip(used, places, strict=True)
    ]


def sector_lines(sector: Sector, scene: fc.Scene) -> list[str]:
    """Those of a sector of a bladed disk of C3D10, and the symmetry by which its sides match."""
    left, right = sector.side_nodes
    lines = mesh_lines(sector.structure, scene, "C3D10", right)
    for name, nodes in (("LEFT", left), ("RIGHT", right)):
        lines += [f"*SURFACE, NAME={name}, TYPE=NODE", *(str(node + 1) for node in nodes)]
    lines += ["*TIE, NAME=SIDES, CYCLIC SYMMETRY", "RIGHT, LEFT"]  # the right one follows
    center, axis = scene.axis_point_and_direction
    ends = ", ".join(f"{x:.13e}" for x in (*center, *(center + axis)))
    return [*lines, f"*CYCLIC SYMMETRY MODEL, N={sector.n_sectors}, TIE=SIDES", ends]


def ties(structure: fc.Structure) -> list[str]:
    """B^T u = 0 as equations."""
    places = {int(dof): place for place, dof in np.ndenumerate(structure.nodes.dofs)}
    lines = []
    for column in structure.apply_bt(np.eye(structure.n_dofs)).T:
        tied_dofs = np.flatnonzero(column)
        terms = [
            f"{places[int(dof)][0] + 1}, {places[int(dof)][1] + 1}, {column[dof]:.13e}"
            for dof in tied_dofs
        ]
        lines += ["*EQUATION", str(len(tied_dofs)), ", ".join(terms)]
    return lines


def contact_lines(structure: fc.Structure, scene: fc.Scene) -> list[str]:
    """Contact of the faces of a grid's bricks along a crack, by a pressure of so much a depth."""
    points, cells = structure.nodes.points, structure.nodes.cells
    x, y = points.T
    on_line = np.isclose(y, scene.crack.height) & (x < scene.crack.length * (1.0 + 1e-9))
    faces: dict[bool, list[str]] = {True: [], False: []}
    for number, cell in enumerate(cells):
        for side in range(4):
            if on_line[cell[[side, (side + 1) % 4]]].all():
                is_above = y[cell].mean() > scene.crack.height
                faces[bool(is_above)] += [f"{number + 1}, S{side + 3}"]
    return [
        "*SURFACE, NAME=LOWER", *faces[False], "*SURFACE, NAME=UPPER", *faces[True],
        "*SURFACE INTERACTION, NAME=LIPS", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
        f"{scene.contact.stiffness_per_area:.13e}",
        "*CONTACT PAIR, INTERACTION=LIPS, TYPE=SURFACE TO SURFACE", "UPPER, LOWER",
    ]  # fmt: skip


def run(lines: list[str]) -> str:
    """What CalculiX writes into its .dat file."""
    with TemporaryDirectory() as folder:
        return _run_in(Path(folder), lines)


def _run_in(folder: Path, lines: list[str]) -> str:
    (folder / "plate.inp").write_text("\n".join(lines) + "\n")
    command = [str(shutil.which("ccx")), "-i", "plate"]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout[-2000:]
    return (folder / "plate.dat").read_text()


@contextmanager
def stored_matrices(lines: list[str], scene: fc.Scene) -> Iterator[fc.Scene]:
    """The scene of a model by the matrices that CalculiX writes, with load, damping and contact of
    another; the files are there as long as it is used."""
    with TemporaryDirectory() as name:
        step = ["*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "1", "*END STEP"]
        _run_in(Path(name), [*lines, *step])
        ends = {"mass": "mas", "stiffness": "sti", "model": "inp"}
        tables = {"structure": {key: f"{name}/plate.{end}" for key, end in ends.items()}}
        for key, table in tomllib.loads(scene.as_toml()).items():
            if key in ("contact", "damping", "excitation"):
                tables[key] = table
        yield fc.Scene.from_mapping(tables)


def natural(lines: list[str], count: int, loads: list[str] | None = None) -> np.ndarray:
    """Natural angular frequencies [rad/s] of a model, about the state that loads make of it."""
    table = _modes(lines, [str(count)], loads)
    return np.array([float(row[2]) for row in _numbers(table) if len(row) == 5][:count])


def nodal_diameters(
    lines: list[str], sectors: int, families: int, loads: list[str] | None = None
) -> np.ndarray:
    """The same of all nodal diameters of a wheel: (N/2 + 1, families).

    CalculiX takes real and imaginary parts of a sector for two, and finds each frequency twice.
    """
    max_diameter = sectors // 2
    select = f"*SELECT CYCLIC SYMMETRY MODES, NMIN=0, NMAX={max_diameter}"
    table = _modes(lines, [str(2 * families), select], loads)
    rows = re.findall(r"^ +\d+ +\d+ +\S+E\S+ +(\S+E\S+) +\S+E\S+ +\S+E\S+$", table, re.M)
    hertz = np.array(rows, dtype=float).reshape(max_diameter + 1, families, 2)
    assert np.allclose(hertz[..., 0], hertz[..., 1], rtol=1e-6)
    return hertz[..., 0]


def _modes(lines: list[str], wanted: list[str], loads: list[str] | None) -> str:
    """Tables of natural frequencies, of which so many are wanted."""
    if loads:
        lines = [*lines, "*STEP, NLGEOM", "*STATIC", *loads, "*END STEP"]
    step = "*STEP, PERTURBATION" if loads else "*STEP"
    return run([*lines, step, "*FREQUENCY", *wanted, "*END STEP"])


def static(lines: list[str], structure: fc.Structure, force: np.ndarray) -> np.ndarray:
    """Displacement of all dofs under a force on them."""
    step = ["*STEP", "*STATIC", "*CLOAD", *_values(structure, force, (0,))]
    table = run([*lines, *step, "*NODE PRINT, NSET=FRONT", "U", "*END STEP"])
    return _displacements(table, structure)[0]


def transient(
    scene: fc.Scene,
    structure: fc.Structure,
    steps: int,
    periods: int,
    initial: tuple[np.ndarray, np.ndarray],
    deck: Path | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Instants [s] and displacement (instant, dof) under force_sin sin(omega t), with contact.

    Steps are no longer than so many a period; CalculiX makes them shorter where contact begins. A
    clamped layer of bricks, from a state of displacement and velocity. A copy of the input file is
    kept if a place is given.
    """
    period = 2.0 * np.pi / scene.excitation.omega
    step, node_shift = period / steps, len(structure.nodes.points)
    lines = mesh_lines(structure, scene, "C3D8") + contact_lines(structure, scene)
    for kind, values in zip(("DISPLACEMENT", "VELOCITY"), initial, strict=True):
        if values.any():
            lines += [
                f"*INITIAL CONDITIONS, TYPE={kind}",
                *_values(structure, values, (0, node_shift)),
            ]
    limits = f", {1e-6 * step:.13e}, {step:.13e}"
    load = _values(structure, 0.5 * structure.force[2], (0, node_shift))
    return _marched(
        lines, scene, structure, ["*DYNAMIC, ALPHA=0.0", limits], load, steps, periods, initial[0],
        deck,
    )  # fmt: skip


def linear_transient(
    scene: fc.Scene, structure: fc.Structure, element: str, steps: int, periods: int
) -> tuple[np.ndarray, np.ndarray]:
    """The same from rest in equal steps, of a plate of plane elements without contact;
    of nodes that such an element lacks the displacement is zero."""
    lines, load = (
        mesh_lines(structure, scene, element),
        _values(structure, structure.force[2], (0,)),
    )
    dynamic_step, rest = ["*DYNAMIC, DIRECT, ALPHA=0.0", ""], np.zeros(structure.n_dofs)
    return _marched(lines, scene, structure, dynamic_step, load, steps, periods, rest)


def _marched(
    lines: list[str], scene: fc.Scene, structure: fc.Structure, how: list[str], load: list[str],
    steps: int, periods: int, first: np.ndarray, deck: Path | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Instants and displacements, of which the first is known, under a load times sin(omega t)."""
    omega = scene.excitation.omega
    step = 2.0 * np.pi / omega / steps
    instants = np.arange(periods * steps + 2) * step
    lines = [*lines, "*AMPLITUDE, NAME=LOAD"]
    lines += [f"{t:.13e}, {np.sin(omega * t):.13e}" for t in instants]
    lines += ["*STEP, INC=100000", how[0], f"{step:.13e}, {periods * steps * step:.13e}{how[1]}"]
    lines += ["*CLOAD, AMPLITUDE=LOAD", *load]
    lines += ["*NODE PRINT, NSET=FRONT", "U", "*END STEP"]
    if deck:
        deck.write_text("\n".join(lines) + "\n")
    table = run(lines)
    time = [float(line.split()[-1]) for line in table.splitlines() if "displacements" in line]
    return np.array([0.0, *time]), np.vstack([first, _displacements(table, structure)])


def _values(structure: fc.Structure, values: np.ndarray, shifts: tuple[int, ...]) -> list[str]:
    """Lines of node, axis and value of the dofs that are not zero."""
    dofs = structure.nodes.dofs
    return [
        f"{node + 1 + shift}, {axis + 1}, {values[dofs[node, axis]]:.13e}"
        for node, axis in np.argwhere(dofs >= 0)
        for shift in shifts
        if values[dofs[node, axis]]
    ]


def _displacements(table: str, structure: fc.Structure) -> np.ndarray:
    """Of all dofs, from tables of the front's nodes, one an instant."""
    dofs = structure.nodes.dofs
    displacements = []
    for part in table.split("displacements")[1:]:
        values = np.zeros(structure.n_dofs)
        for row in _numbers(part):
            for axis, dof in enumerate(dofs[int(row[0]) - 1]):
                if dof >= 0:
                    values[dof] = float(row[1 + axis])
        displacements += [values]
    return np.array(displacements)


def _numbers(table: str) -> list[list[str]]:
    """Lines of the table that are numbers alone, the first of them whole."""
    rows = [line.split() for line in table.splitlines()]
    number = re.compile(r"[-+]?\d*\.\d+(?:E[-+]?\d+)?")
    return [
        row for row in rows
        if row and row[0].isdigit() and all(number.fullmatch(word) for word in row[1:])
    ]  # fmt: skip
