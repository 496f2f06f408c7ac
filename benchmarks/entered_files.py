"""Files of the package that a command enters: how many one reads to follow it.

A file counts if one of its functions is called, from the command line to the written results.

    OMP_NUM_THREADS=1 python benchmarks/entered_files.py [folder]
"""

from __future__ import annotations

import io
import multiprocessing
import sys
import tempfile
import threading
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from types import FrameType

import common

import fenics_crack as fc
from fenics_crack.cli.command_line import main as run_command

PACKAGE = Path(fc.__file__).parent
PLATE = {
    "geometry": {"width": 0.1, "height": 0.1, "thickness": 0.01},
    "crack": {"edge": "left", "height": 0.05, "length": 0.03},
    "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.02},
    "excitation": {"omega": 1000.0, "point": [0.1, 0.1], "force_sin": [1.0, 0.0]},
    "contact": {"law": "unilateral"},
    "mesh": {"layout": "graded", "size": 0.03, "lip_elements": 3},
    "curve": {"start": 900.0, "stop": 950.0},
    "growth": {"until": 0.04, "rate": 1e-9, "exponent": 3.0, "life_tolerance": 0.5},
    "identify": {"unknown": {"crack.length": [0.02, 0.03, 0.04, 0.05]}},
}
MEASUREMENTS = "quantity,value,deviation,mode\nfrequency_open,455,5,1\n"
COMMANDS = {"solve": [], "curve": [], "grow": [], "identify": ["measured.csv"]}
"""Commands, and the files that they take beside the scene."""


def main() -> None:
    """Run it."""
    common.run(__doc__, {"entered": print_entered_files})


def print_entered_files(arguments: common.Arguments) -> None:
    """Print the files of each command, by folder; each runs in a process of its own."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        for command, paths in zip(COMMANDS, pool.map(entered_files, COMMANDS), strict=True):
            folders = Counter(path.parts[0] for path in paths if len(path.parts) > 1)
            counts = ", ".join(f"{key} {count}" for key, count in folders.most_common())
            print(f"{command}: {len(paths)} files ({counts})")


def entered_files(command: str) -> set[Path]:
    """Return the files of the package with a function that a command calls."""
    names = set()

    def watch(frame: FrameType, event: str, argument: object) -> None:
        if event == "call" and frame.f_code.co_name != "<module>":
            names.add(frame.f_code.co_filename)

    threading.setprofile(watch)
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        Path("scene.toml").write_text(fc.Scene.from_mapping(PLATE).as_toml())
        Path("measured.csv").write_text(MEASUREMENTS)
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            sys.setprofile(watch)
            try:
                code = run_command([command, "scene.toml", *COMMANDS[command]])
            finally:
                sys.setprofile(None)
    if code not in (0, 4):  # 4: an error is unknown
        raise SystemExit(f"{command} ended with {code}")
    paths = {Path(name) for name in names}
    return {path.relative_to(PACKAGE) for path in paths if path.is_relative_to(PACKAGE)}


if __name__ == "__main__":
    main()
