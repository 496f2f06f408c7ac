"""Error against processor time for every way of solving the same case.

Cases of the benchmark of exact orbits (``orbits/cases``), from a published mass with a stop to a
cracked plate with 100 pairs, and the paper's plate: ``demos/paper_plate.toml`` with 1e9 N/m and
damping 0.01 at 2000 rad/s, 50 dofs and a pair.

Methods, always from a cold start: harmonic balance by exact integrals and by samples (AFT), the
block system by PETSc's SNES, an exact orbit to a tolerance; from rest, until the motion has
settled: the exact flow and central differences, or exponential steps where faces have no mass. With
--others pyHarm and mousai by their adapters, in environments of their own.

The error is that of ``orbits/score.py``: of the gaps from the nearest known orbit, root mean square
over that of the motion; the orbit of the paper's plate is that of ``reference_flow.py``. Structures
are as they are stored; making them is left out. Runs below half a second are the fastest of three.
Table and picture name the commit and the day.

    OMP_NUM_THREADS=1 python benchmarks/work_precision.py [--quick] [--only CASE] [--others]
        [folder]

Of five demos, error, time and memory of the command ``solve``: ``speed_against_error.py``.
"""

from __future__ import annotations

import datetime
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import numpy as np
from reference_flow import ReferenceFlow

import fenics_crack as fc
from fenics_crack.draw.figure import CURVE_COLOUR_CODE_BY_NAME

sys.path.insert(0, str(Path(__file__).with_name("orbits")))
sys.path.append(str(Path(__file__).parent / "orbits" / "adapters"))
import check
import orbit
import score
import write
from problem import INSTANTS, Problem, problem_of

ORBITS, ROOT = Path(__file__).with_name("orbits"), Path(__file__).parents[1]
CASES = "nlvib-07-stop", "five-stops", "plate-8-soft", "plate-50", "rub-lift"
COUNTS = 3, 5, 10, 20, 40
"""Harmonics."""
COLUMNS = ("case", "method", "setting", "error", "CPU ms", "MiB", "note")
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
PATIENCE = 90
"""Seconds on the clock for another program."""


@dataclass(frozen=True)
class Case:
    """What is solved."""

    stored: dict[str, Any]
    """As in its file."""
    problem: Problem
    structure: fc.Structure
    law: Any

    def error(self, gap: Any, slide: Any = None) -> float:
        """Of gaps (256, n_pairs) and tangential ones; nan if there are none."""
        answer = {"gap": gap, "tangential": slide, "periods": 1, "converged": True}
        error = float(score.scored(self.stored, answer)["error"])
        return error if np.isfinite(error) else np.nan


def main() -> None:
    """Run the cases asked for."""
    parts = {name: race(name) for name in ("paper-plate", *CASES)}
    common.run(__doc__, parts, others={"action": "store_true", "help": "pyHarm and mousai, too"})


def case_of(name: str) -> Case:
    """A case of the benchmark, or the paper's plate."""
    is_own = name == "paper-plate"
    stored_case = paper_plate(name) if is_own else check.read(ORBITS / "cases" / f"{name}.json")
    problem = problem_of(stored_case)
    return Case(stored_case, problem, *orbit.modelled(problem))


def paper_plate(name: str) -> dict[str, Any]:
    """The paper's plate as a case, in all of its modes; its orbit by another flow."""
    plate = common.plate("paper_plate", {"damping.ratio": 0.01})
    law, omega = fc.UnilateralPenalty(1e9), 2000.0
    solution, flow = fc.solve_harmonic_balance(plate, omega, law), ReferenceFlow(plate, law)
    gap = flow.orbit(flow.states_of(solution, np.zeros(1))[0], omega, solution.period).gap
    stored_case = write.reduced(name, "", plate, law, omega)
    parts = stored_case["structure"]
    stiffness, damping = (np.diag(parts[key]).tolist() for key in ("squares", "damping"))
    mass = np.eye(len(stiffness)).tolist()
    stored_case["structure"] = {"form": "matrices", "mass": mass, "damping": damping,
                           "stiffness": stiffness, "pairs": parts["pairs"]}  # fmt: skip
    known_orbit = {
        "subharmonic": 1,
        "gap": gap[:: len(gap) // INSTANTS].tolist(),
        "verdict": "stable",
    }
    return stored_case | {"orbits": [known_orbit]}


# --- the methods ----------------------------------------------------------------------------------


def race(name: str) -> common.Part:
    """A part of the benchmark: every method on a case."""

    def run(arguments: common.Arguments) -> None:
        rows = []
        for row in every_method(case_of(name), arguments):
            rows.append((name, *row))
            print(*map(common.show, row), flush=True)
        finish(arguments.folder, name, rows)

    return run


def every_method(case: Case, arguments: common.Arguments) -> Iterator[tuple[Any, ...]]:
    """Rows of method, setting, error, time, memory, note."""
    rubs, massless = case.problem.kind == "friction", case.problem.flexibility is not None
    counts = COUNTS[: 3 if arguments.quick else None]
    if not rubs:  # friction is sampled anyhow
        yield from balance(case, "harmonic balance, exact integrals", counts)
    samples = None if rubs or case.problem.kind == "rigid" else SAMPLES
    if case.problem.kind != "rigid":
        yield from balance(case, "harmonic balance, samples", counts, samples=samples)
    if not rubs:
        yield from balance(case, "block system", counts[:4], samples=samples, form="block")
    for tolerance in (1e-1, 1e-3) if arguments.quick else (1e-1, 1e-2, 1e-3, 1e-4):
        yield from balance(case, "orbit to a tolerance", (None,), tolerance=tolerance)
    yield in_time(case, "exact flow", fc.integrate_events, INSTANTS, 1e-9)
    if massless:  # has no stable step
        march, name, fewest_steps = fc.integrate_exponential, "exponential steps", 2.0 * INSTANTS
    else:
        march, name = fc.integrate_central_difference, "central differences"
        stable = fc.stable_steps_per_period(case.structure, case.problem.omega, case.law)
        fewest_steps = max(1.3 * stable, INSTANTS)
    for share in (1, 4) if arguments.quick else (1, 2, 4, 8, 16):
        count = INSTANTS * int(np.ceil(share * fewest_steps / INSTANTS))
        yield in_time(case, name, march, count, 1e-5)
    for program in OTHERS if arguments.others and case.problem.kind == "penalty" else ():
        yield from by_others(case, program, counts[::2])


def measured(work: Callable[[], Any]) -> tuple[Any, float, float]:
    """What is returned, the least processor time [ms] of up to three runs, the memory [MiB]."""
    times: list[float] = []
    memory = common.PeakMemory()
    while len(times) < 3 and sum(times) < 0.5:
        start_time = time.process_time()
        answer = work()
        times.append(time.process_time() - start_time)
    return answer, 1e3 * min(times), memory.mib()


def balance(
    case: Case, method: str, counts: Sequence[int | None], **options: Any
) -> Iterator[tuple[Any, ...]]:
    """Harmonic balance with its error report, from a cold start."""
    for harmonics in counts:
        solver_options = options if harmonics is None else options | {"harmonics": harmonics}

        def solve(given: dict[str, Any] = solver_options) -> fc.PeriodicSolution:
            omega = case.problem.omega
            return fc.solve_harmonic_balance(case.structure, omega, case.law, throw=False, **given)

        solution, cpu, peak = measured(solve)
        setting = f"H = {harmonics}" if harmonics else f"{options['tolerance']:g}"
        error = case.error(*orbit.motions(case.problem, solution))
        note = f"stated {solution.report.total:.1e}" if solution.converged else "not converged"
        yield method, setting, error if solution.converged else np.nan, cpu, peak, note


def in_time(
    case: Case, method: str, integrate: Callable[..., fc.TimeHistory], steps: int, settle: float
) -> tuple[Any, ...]:
    """A scheme from rest until it has settled, at most 2000 periods."""

    def march() -> fc.TimeHistory:
        return integrate(
            case.structure, case.problem.omega, case.law, periods=2000, steps_per_period=steps,
            settle=settle, record_periods=1, dofs=(),
        )  # fmt: skip

    setting = "" if method == "exact flow" else f"{steps} steps"
    try:
        history, cpu, peak = measured(march)
    except (fc.ConvergenceError, fc.InputError) as failed:
        return method, setting, np.nan, np.nan, np.nan, str(failed)[:60]
    gap, slide = (
        None if part is None else part[-steps :: steps // INSTANTS]
        for part in (history.gap, history.tangential_gap)
    )
    note = f"{history.periods} periods" + ", not settled" * (history.settled > 1e-4)
    return method, setting, case.error(gap, slide), cpu, peak, note


def by_others(case: Case, program: str, counts: Sequence[int]) -> Iterator[tuple[Any, ...]]:
    """Another program by its adapter, with more harmonics until there is no answer in time."""
    adapter = ORBITS / "adapters" / f"{program.lower()}.py"
    for harmonics in counts:
        answer = score.asked(adapter, case.stored, PATIENCE, harmonics)
        note = answer.get("unsupported") or answer["message"]
        is_solved = answer.get("converged", False)
        error = case.error(answer["gap"]) if is_solved else np.nan
        cpu = 1e3 * answer.get("seconds", np.nan) if is_solved else np.nan
        yield program, f"H = {harmonics}", error, cpu, np.nan, note[:60]
        if "seconds" not in answer:
            return


# --- results --------------------------------------------------------------------------------------


def finish(folder: Path, name: str, rows: list[tuple[Any, ...]]) -> None:
    """Table, picture, and how much faster ours is than the best public one at the same error."""
    origin = f"commit {common.commit()}, {datetime.date.today()}"
    stem = folder / f"work_precision_{name}"
    common.save_table(stem.with_suffix(".csv"), f"Case {name}, {origin}", COLUMNS, rows)
    figure, (axes,) = common.figure(1)
    for method, (_, colour, look) in METHODS.items():
        points = [row for row in rows if row[1] == method and np.isfinite(row[3])]
        axes.loglog(
            [row[4] for row in points], [row[3] for row in points], look, ms=5, lw=1.0,
            color=CURVE_COLOUR_CODE_BY_NAME[colour], label=method if points else None,
        )  # fmt: skip
    axes.set_xlabel("processor time [ms]")
    axes.set_ylabel("error of the gaps over their motion [-]")
    axes.set_title(f"Case {name}: error against time ({origin})", fontsize=9)
    axes.legend(fontsize=7, bbox_to_anchor=(1.01, 1.0), loc="upper left")  # beside, not over points
    figure.savefig(stem.with_suffix(".png"))
    record = {"commit": common.commit(), "date": str(datetime.date.today()),
              "methods": sorted({row[1] for row in rows})}  # fmt: skip
    stem.with_suffix(".json").write_text(json.dumps(record, indent=1) + "\n")
    for goal in (1e-1, 1e-2, 1e-4):
        good_rows = [row for row in rows if row[3] <= goal]
        ours = [row for row in good_rows if row[1] not in OTHERS]
        public = [row for row in good_rows if row[1] in OTHERS]
        if not ours:
            print(f"{name}, error {goal:g}: none")
            continue
        best_row = min(ours, key=lambda row: row[4])
        headline = f"{name}, error {goal:g}: {best_row[1]} {best_row[4]:.3g} ms"
        if public:
            best_other_row = min(public, key=lambda row: row[4])
            headline += (
                f"; {best_other_row[1]} takes {best_other_row[4] / best_row[4]:.3g} times as long"
            )
        print(headline if public else f"{headline}; no public program reaches it")


if __name__ == "__main__":
    main()
