"""What the program costs before and beside the solution: processor time of whole commands.

Every command runs in a process of its own, once to fill the caches (compiled forms, byte code, the
length of a crack found from a frequency) and then as often as asked for; the median of the
processor times, user and system, of the process and its children is printed. The goals: ``solve``
1.5 s, ``check`` 1 s, ``--help`` and ``--version`` 0.3 s.

    OMP_NUM_THREADS=1 python benchmarks/start_up.py [--quick] [folder]
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from typing import Any

import common
import numpy as np

GOALS = {"solve": 1.5, "check": 1.0, "--help": 0.3, "--version": 0.3}
"""[s]"""
SCENES = ("paper_plate", "breathing_plate", "inclined_crack", "sweep")


def main() -> None:
    """Run every command on every scene."""
    common.run(__doc__, {"commands": run_commands})


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


def processor_time(arguments: list[str]) -> float:
    """User and system time of the program with some arguments [s]."""
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "fenics_crack", *arguments]
        done = subprocess.run(command, cwd=folder, env=kept, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
