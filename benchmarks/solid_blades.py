"""Twisted blades in three dimensions: what they cost from the mesh's file to the report.

sizes: the blade of demos/solid_blade.toml at 6000 rpm under engine order 4, on meshes of so many
thousand degrees of freedom: its run-up through the resonance with verdicts (``fenics-crack
curve``), the solution at 6000 rpm (``solve``) and the ``report`` of both, each in a process of its
own. Reported: processor time and most memory of each, what ``check`` says before of the curve's,
the share of the curve whose stability is known, the tip's largest amplitude and what is stated as
the error of the one at 6000 rpm. Sizes whose row is in the folder's solid_blades.csv are not run
again.

ranks: the solution at 6000 rpm by 1, 2 and 4 processes that share the coarse mesh: how far the
figures of the others are from those of the first.

    OMP_NUM_THREADS=1 python benchmarks/solid_blades.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import common
import numpy as np

import fenics_crack as fc

sys.path.insert(0, str(common.DEMOS))
from solid_blade import SCENE, mesh_blade

SIZES = ((0.003, 0.0008), (0.0021, 0.0007), (0.0014, 0.00055))
"""Lengths of cells away from the crack and along it [m]."""
COLUMNS = (
    "cells mm", "dofs", "pairs", "curve s", "solve s", "report s", "all s", "curve GiB",
    "solve GiB", "report GiB", "GiB said of the curve", "points", "decided", "largest m",
    "at 6000 rpm m", "error %",
)  # fmt: skip


def main() -> None:
    """Run it."""
    common.run(__doc__, {"sizes": sizes, "ranks": ranks})


def run(command: str, *words: object, processes: int = 1) -> tuple[str, float, float]:
    """What a command of the program prints, its processor time [s] and its most memory [GiB]."""
    program = [sys.executable, "-m", "fenics_crack", command, *map(str, words)]
    if processes > 1:
        program = ["mpirun", "--oversubscribe", "-n", str(processes), *program]
    own = dict(os.environ)  # without what MPI has added for this process
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True, env=own) as child:
        assert child.stdout is not None
        printed = child.stdout.read()
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{' '.join(program)} ended with {child.returncode}")
    return printed, used.ru_utime + used.ru_stime, used.ru_maxrss / 2.0**20


def values(printed: str) -> dict[str, Any]:
    """Rows of a command's table by their quantities."""
    return {row.get("quantity") or row["what"]: row for row in json.loads(printed)}


def sizes(arguments: common.Arguments) -> None:
    """Time, memory and figures of each mesh; those of the table that is there are not run again."""
    table = arguments.folder / "solid_blades.csv"
    with open(table, newline="") if table.exists() else nullcontext([]) as file:
        rows = [tuple(map(float, row)) for row in list(csv.reader(file))[1:]]
    known = {row[0] for row in rows}
    for size, along_crack in SIZES[: 1 if arguments.quick else None]:
        if 1e3 * size not in known:
            rows.append(of_size(arguments.folder, size, along_crack))
            common.write_csv(table, COLUMNS, rows)
    common.print_table("A blade from its file to the report", COLUMNS, rows)


def of_size(folder: Path, size: float, along_crack: float) -> tuple[float, ...]:
    """A row of the table."""
    mesh = folder / f"blade_{1e3 * size:g}_mm.msh"
    mesh_blade(mesh, size, along_crack)
    scene, results = mesh.with_suffix(".toml"), mesh.with_suffix("")
    scene.write_text(fc.Scene.load(SCENE).replace({"mesh.file": str(mesh)}).as_toml())
    said = values(run("check", scene, "--format", "json")[0])
    _, curve_time, curve_most = run("curve", scene, "--output", results)
    printed, time, most = run("solve", scene, "--output", results, "--format", "json")
    files = [results / f"{name}.h5" for name in ("curve", "solution")]
    _, report_time, report_most = run("report", *files, "--output", results / "report.html")
    with open(results / "curve.csv", newline="") as file:
        points = list(csv.DictReader(file))
    tip = values(printed)["half peak-to-peak, x displacement of tip"]
    return (
        1e3 * size, said["degrees of freedom"]["value"], said["contact pairs"]["value"],
        curve_time, time, report_time, curve_time + time + report_time,
        curve_most, most, report_most, said["memory, estimated [GiB]"]["value"], len(points),
        float(np.mean([point["verdict"] != "undecided" for point in points])),
        max(float(point["tip.ux.amplitude [m]"]) for point in points),
        tip["value"], tip["error [%]"],
    )  # fmt: skip


def ranks(arguments: common.Arguments) -> None:
    """Differences of the figures that several processes print."""
    tables = {}
    for count in (1, 2, 4):
        words = (SCENE, "--output", arguments.folder / f"on_{count}", "--format", "json")
        tables[count] = values(run("solve", *words, processes=count)[0])
    rows = []
    for count in (2, 4):
        apart = [
            max(
                abs(tables[count][name]["value"] / one["value"] - 1.0)
                for name, one in tables[1].items()
                if name.startswith(kind)
            )
            for kind in ("natural frequency", "half peak-to-peak")
        ]
        rows.append((count, *apart))
    title = "The solution at 6000 rpm: largest relative difference to one rank"
    common.save_table(
        arguments.folder / "solid_blades_ranks.csv", title,
        ("ranks", "frequencies", "amplitudes"), rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
