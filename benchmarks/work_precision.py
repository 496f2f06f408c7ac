"""Error against processor time for every way of solving the same scene.

Scenes
    paper      ``demos/paper_plate.toml`` with 1e9 N/m and damping 0.01, 2000 rad/s: 50 dofs, a pair
    breathing  ``demos/breathing_plate.toml`` with 1e9 N/m and damping 0.01 of 150 modes, 2000
               rad/s: 4000 dofs, 18 pairs; reduced to 50 modes, crack faces without mass
    solid      a short beam with a crack through it, 1e8 N/m
    friction   ``demos/friction.toml``: an inclined crack that slides

Methods, always from a cold start: harmonic balance by exact integrals and by samples (AFT), the
block system by PETSc's SNES, an exact orbit to a tolerance; from rest, until the motion has
settled: the exact flow and central differences, or exponential steps where faces have no mass. With
--others pyHarm and mousai by their adapters of the benchmark of exact orbits, in environments of
their own: pyHarm by its sweep from 0.9 of the frequency, mousai from the linear solution.

All but the block system solve the reduced structure of the scene (the paper's plate: all dofs); its
set-up is left out, and the error of the block system holds what the reduction leaves out. The error
is the relative L2 difference of the gaps over a period from the exact orbit of that structure by
another flow (``reference_flow.py``); with friction, from where the exact flow settles. Runs below
half a second are the fastest of three. Table and picture name the commit and the day.

    OMP_NUM_THREADS=1 python benchmarks/work_precision.py [--quick] [--only SCENE] [--others]
        [folder]

``--only demos`` prints README's table instead: error, time and memory of five demos, each by the
command ``solve`` in a process of its own.
"""

from __future__ import annotations

import datetime
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import numpy as np
from reference_flow import INSTANTS, ReferenceFlow

import fenics_crack as fc
from fenics_crack.draw.figure import COLOURS

sys.path.insert(0, str(Path(__file__).with_name("orbits")))
import score
import write

ORBITS, ROOT = Path(__file__).with_name("orbits"), Path(__file__).parents[1]
COLUMNS = ("scene", "method", "setting", "error", "CPU ms", "MiB", "note")
METHODS = {
    "harmonic balance, exact integrals": ("fenics_crack.solve_harmonic_balance", "blue", "o-"),
    "harmonic balance, samples": ("fenics_crack.solve_harmonic_balance", "blue", "s--"),
    "block system": ("fenics_crack.balance.block_system.BlockSystem", "grey", "d:"),
    "orbit to a tolerance": ("fenics_crack.solve_harmonic_balance", "green", "*-"),
    "exact flow": ("fenics_crack.integrate_events", "orange", "P:"),
    "central differences": ("fenics_crack.integrate_central_difference", "orange", "^-"),
    "exponential steps": ("fenics_crack.integrate_exponential", "orange", "v-"),
    "pyHarm": ("benchmarks/orbits/adapters/pyharm.py", "pink", "x--"),
    "mousai": ("benchmarks/orbits/adapters/mousai.py", "pink", "1:"),
}
"""By name: where it is, its colour and its line. A test finds each of them."""
OTHERS = ("pyHarm", "mousai")
SAMPLES = 1024
"""Of a period, where the contact force is sampled."""
PATIENCE = 60
"""Seconds on the clock for another program."""


@dataclass(frozen=True)
class Scene:
    """What is solved, and the gaps that are right."""

    name: str
    whole: fc.Structure
    structure: fc.Structure
    omega: float
    law: Any
    harmonics: tuple[int, ...]
    reference: np.ndarray
    """Gaps (INSTANTS, n_pairs) of the exact orbit."""

    def error(self, gap: np.ndarray) -> float:
        """Of gaps (INSTANTS, n_pairs)."""
        return float(np.linalg.norm(gap - self.reference) / np.linalg.norm(self.reference))


def main() -> None:
    """Run the scenes asked for."""
    scenes = {"paper": paper, "breathing": breathing, "solid": solid, "friction": friction}
    parts = {name: race(name, scene) for name, scene in scenes.items()}
    common.run(
        __doc__,
        parts | {"demos": demos},
        others={"action": "store_true", "help": "pyHarm and mousai, too"},
    )


# --- the scenes -----------------------------------------------------------------------------------


def made(
    name: str, whole: fc.Structure, structure: fc.Structure, omega: float, law: Any,
    harmonics: tuple[int, ...],
) -> Scene:  # fmt: skip
    """A scene with its reference: the orbit of the campaign's judge, which shares no code with the
    package; with friction, which that one does not know, where the exact flow settles."""
    if name == "friction":
        history = fc.integrate_events(
            structure, omega, law, periods=2000, steps_per_period=INSTANTS, settle=1e-12,
            record_periods=1, dofs=(),
        )  # fmt: skip
        gap = history.gap[-INSTANTS:]
    else:
        near = fc.solve_harmonic_balance(structure, omega, law, tolerance=1e-3, throw=False)
        flow = ReferenceFlow(structure, law)
        gap = flow.orbit(flow.states_of(near, np.zeros(1))[0], omega, near.period).gap
    return Scene(name, whole, structure, omega, law, harmonics, gap)


def phases() -> np.ndarray:
    """Instants as parts of the period."""
    return np.arange(INSTANTS) / INSTANTS


def paper() -> Scene:
    """50 dofs, one pair."""
    plate = common.plate("paper_plate", {"damping.ratio": 0.01})
    law = fc.UnilateralPenalty(1e9)
    return made("paper", plate, plate, 2000.0, law, (3, 5, 10, 20, 40, 80))


def breathing() -> Scene:
    """4000 dofs, 18 pairs."""
    plate = common.plate("breathing_plate", {"damping.ratio": 0.01, "damping.modes": 150})
    law = fc.UnilateralPenalty(1e9)
    reduced = fc.reduce_structure(plate, modes=50, method="massless")
    return made("breathing", plate, reduced, 2000.0, law, (3, 5, 10, 20, 40))


SOLID = """
geometry = { kind = "solid", width = 0.02, height = 0.1, thickness = 0.01 }
material = { young = 2.06e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.005, modes = 20 }
excitation = { point = [0.0, 0.1, 0.0], force_cos = [1.0, 0.0, 0.0], frequency = 1300.0 }
contact = { law = "penalty", stiffness = 1e8 }
crack = { edge = "left", height = 0.03, length = 0.008 }
mesh = { layout = "graded", order = 2, size = 0.01, lip_elements = 2, error = false }
"""


def solid() -> Scene:
    """A short beam with a crack through it."""
    scene = fc.Scene.from_text(SOLID)
    whole = fc.build_structure(scene)
    near = 0.98 * fc.bilinear_frequencies(whole).omega_bilinear[0]
    law = fc.UnilateralPenalty(1e8)
    return made("solid", whole, fc.reduce_structure(whole, modes=10), near, law, (3, 5, 10, 20, 40))


def friction() -> Scene:
    """An inclined crack that slides."""
    study = fc.prepare(fc.Scene.load(common.DEMOS / "friction.toml"))
    scene = study.scene
    return made("friction", study.structure, study.structure, scene.excitation.omega, study.contact,
                (5, 10, 20, 40))  # fmt: skip


# --- the methods ----------------------------------------------------------------------------------


def race(name: str, scene_of: Callable[[], Scene]) -> common.Part:
    """A part of the benchmark: every method on a scene."""

    def run(arguments: common.Arguments) -> None:
        scene = scene_of()
        rows = []
        for row in every_method(scene, arguments):
            rows.append((name, *row))
            print(*map(common.show, row), flush=True)
        finish(arguments.folder, scene, rows)

    return run


def every_method(scene: Scene, arguments: common.Arguments) -> Iterator[tuple[Any, ...]]:
    """Rows of method, setting, error, time, memory, note."""
    rubs = scene.name == "friction"
    counts = scene.harmonics[: 3 if arguments.quick else None]
    if not rubs:  # friction is sampled anyhow
        yield from balance(scene, "harmonic balance, exact integrals", counts)
    samples = None if rubs else SAMPLES
    yield from balance(scene, "harmonic balance, samples", counts, samples=samples)
    if not rubs:
        few = counts[: 4 if scene.whole.n_dofs < 2000 else 3]
        yield from balance(scene, "block system", few, samples=SAMPLES, form="block")
    for tolerance in (1e-1, 1e-3) if arguments.quick else (1e-1, 1e-2, 1e-3, 1e-4):
        yield from balance(scene, "orbit to a tolerance", (None,), tolerance=tolerance)
    yield in_time(scene, "exact flow", fc.integrate_events, INSTANTS, 1e-9)
    if isinstance(scene.structure, fc.MasslessStructure):  # faces without mass have no stable step
        march, name, least = fc.integrate_exponential, "exponential steps", INSTANTS
    else:
        march, name = fc.integrate_central_difference, "central differences"
        least = 1.3 * fc.stable_steps_per_period(scene.structure, scene.omega, scene.law)
    for share in (1, 4) if arguments.quick else (1, 2, 4, 8, 16):
        count = INSTANTS * int(np.ceil(share * least / INSTANTS))
        yield in_time(scene, name, march, count, 1e-5)
    for program in OTHERS if arguments.others and not rubs else ():
        yield from by_others(scene, program, counts)


def measured(work: Callable[[], Any]) -> tuple[Any, float, float]:
    """What is returned, the least processor time [ms] of up to three runs, the memory [MiB]."""
    times: list[float] = []
    memory = common.PeakMemory()
    while len(times) < 3 and sum(times) < 0.5:
        started = time.process_time()
        found = work()
        times.append(time.process_time() - started)
    return found, 1e3 * min(times), memory.mib()


def balance(
    scene: Scene, method: str, counts: Sequence[int | None], **options: Any
) -> Iterator[tuple[Any, ...]]:
    """Harmonic balance with its error report, from a cold start."""
    structure = scene.whole if "form" in options else scene.structure
    for harmonics in counts:
        given = options if harmonics is None else options | {"harmonics": harmonics}

        def solve(given: dict[str, Any] = given) -> fc.PeriodicSolution:
            return fc.solve_harmonic_balance(
                structure, scene.omega, scene.law, throw=False, **given
            )

        solution, cpu, peak = measured(solve)
        setting = f"H = {harmonics}" if harmonics else f"{options['tolerance']:g}"
        gap = solution.gap(phases() * solution.period)
        if harmonics is None and solution.orbit is not None:  # what the solution stands for
            gap = solution.orbit.gap_at(phases() * solution.period)
        note = f"stated {solution.report.total:.1e}" if solution.converged else "not converged"
        yield method, setting, scene.error(gap), cpu, peak, note


def in_time(
    scene: Scene, method: str, integrate: Callable[..., fc.TimeHistory], steps: int, settle: float
) -> tuple[Any, ...]:
    """A scheme from rest until it has settled, at most 400 periods."""

    def march() -> fc.TimeHistory:
        return integrate(
            scene.structure, scene.omega, scene.law, periods=400, steps_per_period=steps,
            settle=settle, record_periods=1, dofs=(),
        )  # fmt: skip

    setting = "" if method == "exact flow" else f"{steps} steps"
    try:
        history, cpu, peak = measured(march)
    except (fc.ConvergenceError, fc.InputError) as failed:
        return method, setting, np.nan, np.nan, np.nan, str(failed)[:60]
    gap = history.gap[-steps :: steps // INSTANTS]
    note = f"{history.periods} periods" + ", not settled" * (history.settled > 1e-4)
    return method, setting, scene.error(gap), cpu, peak, note


# --- other programs -------------------------------------------------------------------------------


def by_others(scene: Scene, program: str, counts: Sequence[int]) -> Iterator[tuple[Any, ...]]:
    """Another program on the same structure, by its adapter of the benchmark of exact orbits."""
    adapter, case = ORBITS / "adapters" / f"{program.lower()}.py", case_of(scene)
    for harmonics in counts:
        answer = score.asked(adapter, case, PATIENCE, harmonics)
        note = answer.get("unsupported") or answer["message"]
        if answer.get("gap") is None or not answer["converged"]:
            yield program, f"H = {harmonics}", np.nan, np.nan, np.nan, note[:60]
            continue
        gap = np.array(answer["gap"])
        error = float(np.linalg.norm(gap - scene.reference[::2]))
        error /= float(np.linalg.norm(scene.reference[::2]))
        yield program, f"H = {harmonics}", error, 1e3 * answer["seconds"], np.nan, note


def case_of(scene: Scene) -> dict[str, Any]:
    """The structure in its modes, as the benchmark of exact orbits stores one."""
    case = write.reduced(scene.name, "", scene.structure, scene.law, scene.omega)
    if not isinstance(scene.structure, fc.MasslessStructure):
        parts = case["structure"]
        stiffness, damping = (np.diag(parts[name]).tolist() for name in ("squares", "damping"))
        mass = np.eye(len(stiffness)).tolist()
        case["structure"] = {"form": "matrices", "mass": mass, "damping": damping,
                             "stiffness": stiffness, "pairs": parts["pairs"]}  # fmt: skip
    return case


# --- results --------------------------------------------------------------------------------------


def finish(folder: Path, scene: Scene, rows: list[tuple[Any, ...]]) -> None:
    """Table, picture, and how much faster ours is than the best public one at the same error."""
    made = f"commit {commit()}, {datetime.date.today()}"
    stem = folder / f"work_precision_{scene.name}"
    common.save_table(stem.with_suffix(".csv"), f"Scene {scene.name}, {made}", COLUMNS, rows)
    figure, (axes,) = common.figure(1)
    for method, (_, colour, look) in METHODS.items():
        points = [row for row in rows if row[1] == method and np.isfinite(row[3])]
        axes.loglog(
            [row[4] for row in points], [row[3] for row in points], look, ms=5, lw=1.0,
            color=COLOURS[colour], label=method if points else None,
        )  # fmt: skip
    axes.set_xlabel("processor time [ms]")
    axes.set_ylabel("relative L2 error of the gap over the period [-]")
    axes.set_title(f"Scene {scene.name}: error against time ({made})", fontsize=9)
    axes.legend(fontsize=7, bbox_to_anchor=(1.01, 1.0), loc="upper left")  # beside, not over points
    figure.savefig(stem.with_suffix(".png"))
    record = {"commit": commit(), "date": str(datetime.date.today()),
              "methods": sorted({row[1] for row in rows})}  # fmt: skip
    stem.with_suffix(".json").write_text(json.dumps(record, indent=1) + "\n")
    for goal in (1e-1, 1e-2, 1e-4):
        good = [row for row in rows if row[3] <= goal]
        ours = [row for row in good if row[1] not in OTHERS]
        public = [row for row in good if row[1] in OTHERS]
        if not ours:
            print(f"{scene.name}, error {goal:g}: none")
            continue
        best = min(ours, key=lambda row: row[4])
        said = f"{scene.name}, error {goal:g}: {best[1]} {best[4]:.3g} ms"
        if public:
            other = min(public, key=lambda row: row[4])
            said += f"; {other[1]} takes {other[4] / best[4]:.3g} times as long"
        print(said if public else f"{said}; no public program reaches it")


def commit() -> str:
    """The checkout's."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


DEMOS = ("paper_plate", "breathing_plate", "blade", "friction", "solid_blade")
MARKS = "<!-- speed against error -->\n", "<!-- end -->\n"
"""In README, around the table."""


def row_of(name: str, found: list[dict[str, Any]], used: resource.struct_rusage) -> str:
    """A line of README's table."""
    amplitude = next(row for row in found if row["name"].endswith("amplitude"))
    error = amplitude["error [%]"]
    stated = f"{error:.2g} %, mostly {amplitude['most by']}" if error is not None else "not known"
    seconds, memory = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0
    size = f"{1e6 * amplitude['value']:.4g} um"
    return f"| `{name}.toml` | {size} | {stated} | {seconds:.1f} s | {memory:.0f} MiB |"


def demos(arguments: common.Arguments) -> None:
    """README's table: the command, in a process of its own."""
    lines = [
        f"| `solve demos/...` (commit {commit()}, {datetime.date.today()}) | amplitude "
        "| stated error | processor time | memory |",
        "|---|---|---|---|---|",
    ]
    for name in DEMOS:
        with tempfile.TemporaryDirectory() as output:
            folder = Path(output) / name
            command = [sys.executable, "-m", "fenics_crack", "solve", f"demos/{name}.toml",
                       "--output", str(folder)]  # fmt: skip
            child = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)
            _, _, used = os.wait4(child.pid, 0)
            found = json.loads(next(folder.rglob("solution.json")).read_text())
        lines += [row_of(name, found, used)]
    text = "\n".join(lines) + "\n"
    print(text)
    readme = (ROOT / "README.md").read_text()
    head, _, tail = readme.partition(MARKS[0])
    (ROOT / "README.md").write_text(head + MARKS[0] + "\n" + text + "\n" + MARKS[1]
                                    + tail.partition(MARKS[1])[2])  # fmt: skip


if __name__ == "__main__":
    main()
