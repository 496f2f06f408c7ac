"""What the program costs before and beside the solution: processor time of whole commands.

Every command runs in a process of its own, once to fill the caches (compiled forms, byte code, the
length of a crack found from a frequency) and then as often as asked for; the median of the
processor times, user and system, of the process and its children is printed. The goals: ``solve``
1.5 s, ``check`` 1 s, ``--help`` and ``--version`` 0.3 s.

jobs: what the plate that ``new`` writes is asked for, one command after the other in a new folder,
a refused key among them; its sweep has 31 frequencies and 6 lengths. With --sources other versions
are measured by turns, for ratios on a busy machine.

    OMP_NUM_THREADS=1 python benchmarks/start_up.py [--quick] [--only PART] [--sources FOLDER ...]
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import common
import numpy as np

GOALS = {"solve": 1.5, "check": 1.0, "--help": 0.3, "--version": 0.3}
"""[s]"""
SCENES = ("paper_plate", "breathing_plate", "inclined_crack", "sweep")


PLATE = str(Path(__file__).with_name("plate.toml"))
OVER = """sweep.over={ "excitation.frequency" = { start = 780.0, stop = 880.0, count = 31 }, \
"crack.length" = [0.01, 0.015, 0.02, 0.025, 0.03, 0.035] }"""
OF_PLATE = [f"output/plate/{name}.h5" for name in ("solution", "curve", "sweep")]
JOBS = {
    "new": (None, ["new", "found.toml", "--identify"]),
    "check": (0.6, ["check", PLATE]),
    "solve": (0.6, ["solve", PLATE]),
    "curve": (2.5, ["curve", PLATE]),
    "sweep of 31 x 6 cases": (6.0, ["sweep", PLATE, "--set", OVER]),
    "verify": (3.0, ["verify", PLATE]),
    "identify": (6.0, ["identify", "found.toml", "found_measured.csv"]),
    "plot of a solution": (2.5, ["plot", OF_PLATE[0]]),
    "report": (5.0, ["report", *OF_PLATE]),
    "a refused key": (0.25, ["solve", PLATE, "--set", "mesh.sice=0.01"]),
}
"""Goals [s] and arguments."""


def main() -> None:
    """Run every command on every scene, and the jobs on one plate."""
    common.run(
        __doc__,
        {"commands": run_commands, "jobs": run_jobs},
        sources={"nargs": "+", "default": [str(Path(__file__).parents[1])], "help": "versions"},
    )


def run_jobs(arguments: common.Arguments) -> None:
    """Processor times of the jobs, by turns where there are several versions."""
    sources = arguments.sources
    repeats = 1 if arguments.quick else 3
    times: dict[tuple[str, str], list[float]] = {}
    for repeat in range(1 + repeats):
        for source in sources:
            with tempfile.TemporaryDirectory() as folder:
                for name, (_, words) in JOBS.items():
                    spent = processor_time(words, folder, source, (0, 2, 4))
                    if repeat:
                        times.setdefault((name, source), []).append(spent)
    rows = [
        (name, source, float(np.median(found)), min(found), JOBS[name][0] or "")
        for (name, source), found in times.items()
    ]
    columns = ("job", "version", "processor time [s]", "least [s]", "goal [s]")
    common.print_table("Processor time of jobs on the plate of new", columns, rows)
    common.write_csv(arguments.folder / "start_up_jobs.csv", columns, rows)


def run_commands(arguments: common.Arguments) -> None:
    """Processor times, one row for each command."""
    repeats = 2 if arguments.quick else 5
    commands = [[name] for name in GOALS if name.startswith("-")]
    for name in ("check", "solve"):
        commands += [[name, str(common.DEMOS / f"{scene}.toml"), "--quiet"] for scene in SCENES]
    rows: list[tuple[Any, ...]] = []
    for command in commands:
        times = [processor_time(command) for _ in range(1 + repeats)][1:]
        scene = os.path.basename(command[1]) if len(command) > 1 else ""
        rows.append((command[0], scene, float(np.median(times)), min(times), GOALS[command[0]]))
    columns = ("command", "scene", "processor time [s]", "least [s]", "goal [s]")
    common.print_table("Processor time of whole commands", columns, rows)
    common.write_csv(arguments.folder / "start_up.csv", columns, rows)


def processor_time(
    arguments: list[str], folder: str = "", source: str = "", ends: tuple[int, ...] = (0,)
) -> float:
    """User and system time of the program with some arguments [s], in a folder or a new one, of the
    version here or of another, which may end with one of some codes."""
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    if source:
        kept["PYTHONPATH"] = source
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as new:
        command = [sys.executable, "-m", "fenics_crack", *arguments]
        place = folder or new
        done = subprocess.run(command, cwd=place, env=kept, capture_output=True, text=True)
    if done.returncode not in ends:
        raise SystemExit(f"{' '.join(command)}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
