"""Write the files of CalculiX that the tests read: a plate of four bricks with a crack.

    .venv/bin/python tests/exchange/calculix_plate.py

needs CalculiX (``apt-get install calculix-ccx``) and writes tests/exchange/plate/: the input file,
both matrices with their dofs, and the natural frequencies that CalculiX itself finds. The plate of
20 x 20 x 5 mm is clamped at y = 0; its lower half and its left upper brick are apart from x = 0 to
x = 10 mm at y = 10 mm, where two nodes exist twice.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

FOLDER = Path(__file__).with_name("plate")
SIDE, THICKNESS = 0.01, 0.005
MATERIAL = ["*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1e11, 0.3", "*DENSITY", "7850."]


def lines() -> list[str]:
    """Nodes 1 to 18, row by row; 19 and 20 are the upper lip's copies of 4 and 13."""
    points = [
        (SIDE * i, SIDE * j, THICKNESS * k) for k in range(2) for j in range(3) for i in range(3)
    ]
    points += [points[3], points[12]]
    numbers = {4: 19, 13: 20}
    bricks = []
    for j in range(2):
        for i in range(2):
            lower_nodes = [1 + i + 3 * j + step for step in (0, 1, 4, 3)]
            nodes = lower_nodes + [node + 9 for node in lower_nodes]
            bricks.append([numbers.get(node, node) if j else node for node in nodes])
    return [
        "*NODE",
        *(f"{n}, {x:g}, {y:g}, {z:g}" for n, (x, y, z) in enumerate(points, 1)),
        "*ELEMENT, TYPE=C3D8, ELSET=PLATE",
        *(", ".join(map(str, [n, *nodes])) for n, nodes in enumerate(bricks, 1)),
        *MATERIAL, "*SOLID SECTION, ELSET=PLATE, MATERIAL=STEEL",
        "*BOUNDARY", *(f"{n}, 1, 3" for n in (1, 2, 3, 10, 11, 12)),
    ]  # fmt: skip


def write() -> None:
    """Run CalculiX twice: for its frequencies, and for its matrices."""
    FOLDER.mkdir(exist_ok=True)
    for name, options in (("plate", ""), ("matrices", ", SOLVER=MATRIXSTORAGE")):
        step = ["*STEP", f"*FREQUENCY{options}", "6", "*END STEP"]
        (FOLDER / f"{name}.inp").write_text("\n".join([*lines(), *step]) + "\n")
        subprocess.run([str(shutil.which("ccx")), "-i", name], cwd=FOLDER, check=True)
    for suffix in ("sti", "mas", "dof"):
        (FOLDER / f"matrices.{suffix}").rename(FOLDER / f"plate.{suffix}")
    for path in FOLDER.iterdir():
        if path.suffix not in (".sti", ".mas", ".dof", ".inp", ".dat") or path.stem != "plate":
            path.unlink()


if __name__ == "__main__":
    write()
