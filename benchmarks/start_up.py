"""What commands and calls cost, each against its budget: processor time of processes of their own.

Each process runs once to fill the caches (compiled forms, byte code), and then as often as asked
for, the versions by turns; medians of its user and system time, children included. What is measured
within a process, a second solution or a curve, prints its own processor time, imports left out. A
budget is in seconds, or relative to another figure of the same version, ``import dolfinx`` for
whole commands, or relative to the last of several versions. The program ends with 1 if one is
missed.

The plate is that of ``fenics-crack new``, of this version, for all. Versions are folders with a
``.venv`` of their own (``install.sh``); what a later one does not have is left out.

    OMP_NUM_THREADS=1 python benchmarks/start_up.py [--quick] [--only PART] [--sources FOLDER ...]
"""

from __future__ import annotations

import atexit
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import common
import numpy as np
from sweep_scaling import ENVIRONMENT

HERE = str(Path(__file__).parents[1])
BYTE_CODE = tempfile.mkdtemp(prefix="byte_code-")
atexit.register(shutil.rmtree, BYTE_CODE, ignore_errors=True)
IMPORT = "import dolfinx"
LAST = "the last version"
OVER = """sweep.over={ "excitation.frequency" = { start = 780.0, stop = 880.0, count = 31 }, \
"crack.length" = [0.01, 0.015, 0.02, 0.025, 0.03, 0.035] }"""
OLD_PLATE = str(Path(__file__).with_name("plate.toml"))
OF_PLATE = [f"output/plate/{name}.h5" for name in ("solution", "curve", "sweep")]
SWEEP, SWEEP_ON_2 = "sweep, 31 x 6 cases", "sweep, 2 ranks"


class Figure(NamedTuple):
    """A figure that is measured.

    Attributes
    ----------
    job : list of str, or str
        Arguments of the program, or of Python; or a script whose last printed word is a time [s].
    budget : float or None
        The most that it may be.
    of : str
        What it is relative to: another figure, :data:`LAST`, or nothing: [s].
    """

    job: list[str] | str
    budget: float | None = None
    of: str = LAST


IN_PROCESS = """
import time
import numpy as np
import fenics_crack as fc
scene = fc.Scene.load("plate.toml")
def timed(call):
    call()
    began = time.process_time()
    call()
    print(time.process_time() - began)
"""
SECOND = """
run = fc.solve(scene)
run.errors
began = time.process_time()
fc.solve(scene.replace({"excitation.frequency": 800.0})).errors
print(time.process_time() - began)
"""
CURVE = """
timed(lambda: fc.continue_frequency(*given, harmonics=10, stability=True, throw=False))
"""
OSCILLATOR = """
one = fc.Structure.from_matrices(
    [[1.0]], [[1.0]], gap=[1.0], force_cos=[0.1], damping=[[0.02]]
)
"""
TWO_MASSES = """
stiffness = np.array([[2.0, -1.0], [-1.0, 1.0]])
two = fc.Structure.from_matrices(
    np.eye(2), stiffness, gap=[0.0, 1.0], force_cos=[0.1, 0.0], damping=0.02 * stiffness
)
given = two, 2.2, 0.4, fc.UnilateralPenalty(2.0)
"""
PLATE = """
changes = {"reduction.modes": 20, "reduction.method": "massless"}
study = fc.prepare(scene.replace(changes))
given = study.structure, 4900.0, 5500.0, study.contact
"""
CASES = """
changes = {"mesh.lip_elements": %d, "reduction.modes": 10, "reduction.method": "massless"}
study, count = fc.prepare(scene.replace(changes)), 10_000
middle, draw = 5227.0, np.random.default_rng(1).uniform  # the resonance [rad/s]
cases = {
    "omega": draw(0.9 * middle, 1.1 * middle, count), "load": draw(0.5, 2.0, count),
    "damping": draw(0.5, 2.0, count),
}
began = time.process_time()
found = fc.solve_many(study.structure, contact=study.contact, **cases)
spent = time.process_time() - began
assert np.mean(found.verdict != "") >= 0.98 and np.isfinite(found.truncation).mean() >= 0.98
print(spent)
"""
COMMANDS = {
    IMPORT: Figure(["-c", IMPORT], None, ""),
    "--help": Figure(["--help"]),
    "a refused key": Figure(["solve", "plate.toml", "--set", "mesh.sice=0.01"]),
    "solve": Figure(["solve", "plate.toml", "--set", "contact.friction_error=false"], 2.9, IMPORT),
    "solve, with the effect of friction": Figure(["solve", "plate.toml"], 3.4, IMPORT),
    "check": Figure(["check", "plate.toml"], 2.8, IMPORT),
    "curve": Figure(["curve", "plate.toml"], 6.5, IMPORT),
    "reduce": Figure(["reduce", "plate.toml", "--output", "plate.h5"], None, IMPORT),
    "solve of a file": Figure(["solve", "plate.h5", "--output", "filed"], 1.5, IMPORT),
    "the same, another frequency": Figure(
        ["solve", "plate.h5", "--output", "filed", "--set", "excitation.frequency=800.0"],
        1.5, IMPORT,
    ),
}  # fmt: skip
CALLS = {
    "a second solution in a process": Figure(IN_PROCESS + SECOND, 0.1, ""),
    **{
        f"curve with verdicts, k_c = {k}": Figure(
            IN_PROCESS + OSCILLATOR + f"given = one, 2.0, 0.3, fc.UnilateralPenalty({k})" + CURVE,
            0.4,
        )
        for k in (1, 10)
    },
    "curve with verdicts, two masses": Figure(IN_PROCESS + TWO_MASSES + CURVE, 0.4),
    "curve with verdicts, plate": Figure(IN_PROCESS + PLATE + CURVE, 0.4),
    "10,000 cases, 8 pairs": Figure(IN_PROCESS + CASES % 4, 45.0, ""),
    "10,000 cases, 20 pairs": Figure(IN_PROCESS + CASES % 10, 90.0, ""),
}
JOBS = {
    "check, plate.toml": Figure(["check", OLD_PLATE], 1.1),
    "solve, plate.toml": Figure(["solve", OLD_PLATE], 1.1),
    "curve, plate.toml": Figure(["curve", OLD_PLATE], 1.1),
    SWEEP: Figure(["sweep", OLD_PLATE, "--set", OVER], 0.6),
    SWEEP_ON_2: Figure(["sweep", OLD_PLATE, "--set", OVER, "--output", "two"], 1.7, SWEEP),
    "verify": Figure(["verify", OLD_PLATE], 1.1),
    "identify": Figure(["identify", "found.toml", "found_measured.csv"], 1.1),
    "plot of a solution": Figure(["plot", OF_PLATE[0]], 1.1),
    "report": Figure(["report", *OF_PLATE], 1.1),
}
"""On the frozen plate, 20 modes."""


def main() -> None:
    """Measure the figures of the parts asked for, and end with 1 if a budget is missed."""
    missed: list[str] = []

    def part(figures: dict[str, Figure]) -> common.Part:
        return lambda arguments: missed.extend(measured(arguments, figures))

    common.run(
        __doc__,
        {"commands": part(COMMANDS), "calls": part(CALLS), "jobs": part(JOBS)},
        sources={"nargs": "+", "default": [HERE], "help": "versions, this one first"},
    )
    if missed:
        raise SystemExit(f"missed: {', '.join(missed)}")


def measured(arguments: common.Arguments, figures: dict[str, Figure]) -> list[str]:
    """Measure figures, the versions by turns, print their table, and return the names of those of
    the first version that are above their budgets."""
    sources, figures = arguments.sources, {IMPORT: COMMANDS[IMPORT], **figures}
    times: dict[tuple[str, str], list[float]] = {}
    for repeat in range(2 if arguments.quick else 4):
        for source in sources:
            with tempfile.TemporaryDirectory() as folder:
                write_scenes(Path(folder))
                for name, figure in figures.items():
                    spent, clock = run(figure.job, folder, source, 1 + (name == SWEEP_ON_2))
                    if repeat:
                        times.setdefault((source, name), []).append(spent)
                        times.setdefault((source, f"{name}, clock"), []).append(clock)
    if SWEEP in figures:
        figures[f"{SWEEP_ON_2}, clock"] = Figure([], 0.65, f"{SWEEP}, clock")
    middle = {key: float(np.median(values)) for key, values in times.items()}
    rows, missed = [], []
    for name, figure in figures.items():
        for source in sources:
            seconds = middle[source, name]
            key = (sources[-1], name) if figure.of == LAST else (source, figure.of)
            value = seconds / middle.get(key, 1.0)
            lacking = seconds != seconds
            above = source == sources[0] and figure.budget is not None
            above &= lacking or value > (figure.budget or 0.0)
            if figure.of == LAST and source == sources[-1]:  # compared with itself
                value, above = np.nan, above and lacking
            missed += [name] if above else []
            mark = "not there" if lacking else "missed" if above else ""
            rows.append((name, source, seconds, value, figure.of, figure.budget or "", mark))
    columns = ("figure", "version", "time [s]", "relative", "to", "budget", "")
    common.save_table(arguments.folder / "start_up.csv", "Processor time", columns, rows)
    return missed


def write_scenes(folder: Path) -> None:
    """The plate of ``new``, and one to be identified, in a folder."""
    for words in (["plate.toml"], ["found.toml", "--identify"]):
        command = [sys.executable, "-m", "fenics_crack", "new", *words]
        subprocess.run(command, cwd=folder, env=environment(HERE), check=True, capture_output=True)


def environment(source: str) -> dict[str, str]:
    """The variables of a version's processes, which keep their byte code in a folder of its own."""
    kept = {name: x for name, x in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | ENVIRONMENT | {"PYTHONPATH": source, "PYTHONPYCACHEPREFIX": BYTE_CODE}


def run(job: list[str] | str, folder: str, source: str, ranks: int) -> tuple[float, float]:
    """User and system time, or the time that a script prints, and time on the clock [s], of a job
    of a version in a folder; nan where that version does not have it."""
    words = ["-c", job] if isinstance(job, str) else job
    command = [str(Path(source, ".venv", "bin", "python")), *words]
    if words[0] != "-c":
        command[1:1] = ["-m", "fenics_crack"]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        command, cwd=folder, env=environment(source), capture_output=True, text=True
    )
    after, clock = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - began
    refused = "mesh.sice=0.01" in words
    if done.returncode not in ((2,) if refused else (0, 4)):
        return np.nan, np.nan
    if isinstance(job, str):
        return float(done.stdout.split()[-1]), clock
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, clock


if __name__ == "__main__":
    main()
