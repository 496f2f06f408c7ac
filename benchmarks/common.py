"""What the benchmarks share: arguments, timing in alternation, tables, CSV files, pictures.

All of them run with one thread, ``OMP_NUM_THREADS=1``, and take the folder for the results:

    OMP_NUM_THREADS=1 python benchmarks/NAME.py [--quick] [folder]

A time alone says more about the machine and its other work than about the program. So two methods
are compared by turns in one run (:func:`alternate`), and their ratio is reported. All times are
processor times (one thread, ``time.process_time``), which other work on the machine disturbs less
than the clock; where waiting counts, both are given.
"""

from __future__ import annotations

import argparse
import csv
import ctypes
import gc
import os
import platform
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import fenics_crack as fc
from fenics_crack.balance.error_report import mean_square
from fenics_crack.balance.harmonic_balance import truncated_orbit_solution
from fenics_crack.balance.more_modes import MoreModesComparison
from fenics_crack.motion.flow import exact_flow_or_none
from fenics_crack.motion.search import search_orbit
from fenics_crack.numerics.fourier import resize_harmonics

DEMOS = Path(__file__).parents[1] / "demos"
FOLDER = Path("output/benchmarks")
Row = Sequence[Any]
Arguments = argparse.Namespace
Part = Callable[[Arguments], None]


# --- the command line -----------------------------------------------------------------------------


def run(description: str | None, parts: Mapping[str, Part], **options: Mapping[str, Any]) -> None:
    """Read the command line and run the parts: all of them, or the one of ``--only``.

    Options are further arguments ``--name``, with what ``add_argument`` is given for each.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER, help="for the results")
    parser.add_argument("--quick", action="store_true", help="a small part of it, in a minute")
    parser.set_defaults(only=None)
    if len(parts) > 1:
        parser.add_argument("--only", choices=parts, help="one part of the benchmark")
    for name, option in options.items():
        parser.add_argument(f"--{name}", **option)
    arguments = parser.parse_args()
    start(arguments)
    for name, part in parts.items():
        if arguments.only in (None, name):
            part(arguments)


def start(arguments: Arguments) -> None:
    """Make the folder and say on what the numbers were measured."""
    arguments.folder.mkdir(parents=True, exist_ok=True)
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    print(
        f"Python {platform.python_version()}, NumPy {np.__version__}, {os.cpu_count()} cores, "
        f"OMP_NUM_THREADS {threads}"
    )
    if threads != "1":
        print("Set OMP_NUM_THREADS=1: small matrices are slower on several threads.")


# --- timing ---------------------------------------------------------------------------------------


def seconds(function: Callable[[], Any]) -> float:
    """Processor time of one call [s]."""
    start_time = time.process_time()
    function()
    return time.process_time() - start_time


def alternate(
    functions: Mapping[str, Callable[[], Any]], repeats: int, warm: bool = True
) -> dict[str, np.ndarray]:
    """Times [s] of functions that take turns: name -> (repeats,)."""
    if warm:
        for function in functions.values():
            function()
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            times[name].append(seconds(function))
    return {name: np.array(values) for name, values in times.items()}


def ratio(times: Mapping[str, np.ndarray], above: str, below: str) -> float:
    """Median over the turns of the quotient of two times."""
    return float(np.median(times[above] / times[below]))


# --- memory ---------------------------------------------------------------------------------------


class PeakMemory:
    """Most memory the process has used since this was made, above what it used then (Linux).

    Memory that is free but kept is given back first, so that its use counts again; then the kernel
    is told to forget the peak so far. Where it refuses, the figure is nan.
    """

    def __init__(self) -> None:
        gc.collect()
        try:
            ctypes.CDLL(None).malloc_trim(0)
            Path("/proc/self/clear_refs").write_text("5")
            self._start = _status("VmRSS")
        except (OSError, AttributeError):
            self._start = float("nan")

    def mib(self) -> float:
        """The figure [MiB]."""
        return self._start if np.isnan(self._start) else _status("VmHWM") - self._start


def _status(key: str) -> float:
    """An entry of /proc/self/status [MiB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return float(next(line for line in lines if line.startswith(key)).split()[1]) / 1024.0


# --- results --------------------------------------------------------------------------------------


def commit() -> str:
    """Return the checkout's commit, eight digits."""
    command = ["git", "-C", str(DEMOS), "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def show(value: object) -> str:
    """A number for a table."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return str(value)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Row]) -> None:
    """A plain table with its heading."""
    cells = [list(columns), *([show(value) for value in row] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    print(f"\n{title}")
    for number, row in enumerate(cells):
        print("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))
        if number == 0:
            print("  ".join("-" * width for width in widths), flush=True)
    print(end="", flush=True)


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[Row]) -> None:
    """The same numbers in full."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)


def save_table(path: Path, title: str, columns: Sequence[str], rows: Sequence[Row]) -> None:
    """Print a table and write it as CSV."""
    print_table(title, columns, rows)
    write_csv(path, columns, rows)


def figure(columns: int = 1, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure with axes side by side, row after row."""
    size = (1.0 + 5.6 * columns, 4.2 * rows)
    new_figure = Figure(figsize=size, dpi=150, layout="constrained")
    FigureCanvasAgg(new_figure)
    axes = new_figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.grid(alpha=0.3)
    return new_figure, list(axes)


# --- what is solved -------------------------------------------------------------------------------


def oscillator(force: float = 0.1, damping: float = 0.02) -> fc.Structure:
    """m = 1 kg, k = 1 N/m, and a load force cos(w t)."""
    return fc.Structure.from_matrices(
        [[1.0]], [[1.0]], gap=[1.0], force_cos=[force], damping=[[damping]]
    )


def two_masses() -> fc.Structure:
    """Two masses of 1 kg, a load on one, and for the other a stop at a distance of 1 m."""
    stiffness = np.array([[1.0, -1.0], [-1.0, 2.0]])
    return fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=[1.0, 0.0], force_cos=[0.0, 0.1], damping=0.03 * stiffness,
        clearance=1.0,
    )  # fmt: skip


def chain(count: int) -> np.ndarray:
    """Stiffness of masses in a chain between two walls, on springs of 1 N/m."""
    return 2.0 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)


def plate(name: str, changes: Mapping[str, Any] | None = None) -> fc.Structure:
    """The structure of a scene in demos/, its crack length found where the scene asks for it."""
    scene = fc.Scene.load(DEMOS / f"{name}.toml").replace(dict(changes or {}))
    assert scene.crack is not None
    if scene.crack.first_omega is not None:
        length = fc.find_crack_length(scene)
        scene = scene.replace({"crack.length": length, "crack.first_omega": None})
    return fc.build_structure(scene)


def relative_difference(values: np.ndarray, reference: np.ndarray) -> float:
    """Relative L2 difference over the period of coefficients (rows a0, a1, b1, ...), any H."""
    harmonics = max(len(values), len(reference)) // 2
    rows, reference_rows = (
        resize_harmonics(values, harmonics),
        resize_harmonics(reference, harmonics),
    )
    return float(np.sqrt(mean_square(rows - reference_rows) / mean_square(reference_rows)))


def with_more_modes(orbit: fc.PeriodicOrbit, study: fc.Study) -> fc.PeriodicOrbit:
    """Return the orbit of a study with more modes that is next to another orbit."""
    problem = fc.Problem(orbit.structure, orbit.omega, study.contact, 5)
    wave = truncated_orbit_solution(problem, orbit, orbit.coefficients(5))
    more_modes = MoreModesComparison(
        exact_flow_or_none(study.structure, study.contact), wave, orbit
    )
    start_states = more_modes.nearest_orbit_states_with_static_new_modes
    orbit_with_more_modes = (
        more_modes.orbit or search_orbit(more_modes.flow, orbit.omega, [start_states]).orbit
    )
    assert orbit_with_more_modes is not None
    return orbit_with_more_modes
