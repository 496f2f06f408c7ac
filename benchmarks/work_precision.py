"""Error against processor time for every way of solving the same scene.

Scenes
    oscillator the bilinear oscillator (c = 0.1, kc = 1) at half its natural frequency, W = w0 / 2
    paper      ``demos/paper_plate.toml`` with 1e9 N/m and damping 0.01, 2000 rad/s
    breathing  ``demos/breathing_plate.toml`` with 1e9 N/m and damping 0.01, 2000 rad/s, 18 pairs;
               150 damped modes, for what is not damped does not settle
    data       the paper's own data (1e11 N/m, damping 0.001): the motion does not settle; harmonic
               balance beside central differences, averaged by phase over 200 periods
    kernel     one step of every scheme on the paper's plate; one of central differences on the
               breathing plate against one product with K

Methods
    harmonic balance, always from a cold start and with its error report: exact integrals, 128 or
    1024 samples a period, collocation at 2H+1 instants, the full form (all dofs), the reduced
    structure;
    in time, from rest: central differences (full and reduced), exponential steps, the exact flow
    from one switching instant to the next, and SciPy's `solve_ivp` (DOP853) on one mass.

The error is the relative L2 difference of the gaps over one period from a reference: the exact
orbit by shooting (oscillator, paper), or harmonic balance with 40 harmonics, whose own estimate is
printed (breathing). A motion in time has settled when the gaps of two successive periods differ by
less than a tenth of the scheme's error; it may take at most 400 periods, and its time includes
them. The set-up of the structure is left out for all methods; that of a reduction is printed
separately. Runs below half a second are the fastest of three. "MiB" is the peak memory above what
the process used when the method began. Schemes in time keep the gaps of the last period and no
displacements; a reduced structure keeps its coordinates.

    OMP_NUM_THREADS=1 python benchmarks/work_precision.py [--quick] [--only SCENE] [folder]
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import numpy as np
from laboratory import solve_form
from scipy.integrate import solve_ivp

import fenics_crack as fc
from fenics_crack.draw.figure import COLOURS
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import damped_modes

COLUMNS = ("scene", "method", "setting", "error", "CPU ms", "MiB", "periods", "note")
LOOKS = {
    "harmonic balance, exact": ("blue", "o-"),
    "harmonic balance, 128 samples": ("blue", "s--"),
    "harmonic balance, 1024 samples": ("green", "s--"),
    "harmonic balance, collocation": ("pink", "x--"),
    "harmonic balance, full form": ("grey", "d:"),
    "harmonic balance, reduced": ("green", "o-"),
    "central differences": ("orange", "^-"),
    "central differences, reduced": ("orange", "v--"),
    "exponential steps": ("blue", "v:"),
    "exponential steps, reduced": ("blue", "1:"),
    "exact flow": ("green", "*"),
    "solve_ivp": ("grey", "h-"),
}


@dataclass(frozen=True)
class Scene:
    """What is solved, and the wave that is right."""

    name: str
    structure: fc.Structure
    omega: float
    law: fc.UnilateralPenalty
    reference: Callable[[np.ndarray], np.ndarray]
    """Gaps (n, n_pairs) at phases (n,) of the period, 0 to 1."""
    reduced: fc.Structure | None = None

    def error(self, gap: np.ndarray) -> float:
        """Of gaps (n, n_pairs) at n instants equally spaced from phase zero."""
        exact = self.reference(np.arange(len(gap)) / len(gap))
        return float(np.linalg.norm(gap - exact) / np.linalg.norm(exact))


def main() -> None:
    """Run the scenes asked for."""
    parts = {
        "oscillator": oscillator, "paper": paper, "breathing": breathing, "data": own_data,
        "kernel": kernel,
    }  # fmt: skip
    common.run(__doc__, parts)


# --- the scenes -----------------------------------------------------------------------------------


def oscillator(arguments: common.Arguments) -> None:
    """One mass."""
    structure = common.oscillator(1.0, 0.1)
    omega = np.sqrt(2.0) / (1.0 + np.sqrt(2.0))
    law = fc.UnilateralPenalty(1.0)
    scene = Scene("oscillator", structure, omega, law, exact_orbit(structure, omega, law))
    rows = balance(scene, "exact", (3, 5, 10, 20, 40, 80))
    rows += balance(scene, "128 samples", (3, 5, 10, 20), samples=128)
    rows += balance(scene, "1024 samples", (10, 20, 40, 80), samples=1024)
    rows += balance(scene, "collocation", (5, 10, 20, 40, 80), balance="collocation")
    steps = (100, 400, 1600) if arguments.quick else (50, 100, 200, 400, 800, 1600, 3200)
    rows += in_time(scene, "central differences", structure, steps)
    rows += in_time(scene, "exponential steps", structure, steps)
    rows.append(by_events(scene, structure))
    rows += by_solve_ivp(
        scene, (1e-3, 1e-5, 1e-7) if arguments.quick else 10.0 ** -np.arange(3, 10)
    )
    finish(arguments.folder, scene, rows)


def paper(arguments: common.Arguments) -> None:
    """50 dofs, one pair."""
    plate = common.plate("paper_plate", {"damping.ratio": 0.01})
    law = fc.UnilateralPenalty(1e9)
    reduced = fc.reduce_structure(plate, modes=25)
    scene = Scene("paper", plate, 2000.0, law, exact_orbit(plate, 2000.0, law), reduced)
    rows = balance(scene, "exact", (3, 5, 10, 20, 40, 80))
    rows += balance(scene, "128 samples", (3, 5, 10, 20), samples=128)
    rows += balance(scene, "1024 samples", (10, 20, 40, 80), samples=1024)
    rows += balance(scene, "collocation", (5, 10, 20, 40), balance="collocation")
    rows += balance(scene, "full form", (3, 5, 10, 20), form="block")
    rows += balance(scene, "reduced", (5, 10, 20, 40), structure=reduced)
    shares = (1.05, 2.0, 4.0) if arguments.quick else (1.05, 1.5, 2.0, 4.0, 8.0, 16.0)
    least = fc.stable_steps_per_period(plate, 2000.0, law)
    steps = [int(np.ceil(share * least)) for share in shares]
    rows += in_time(scene, "central differences", plate, steps)
    rows += in_time(scene, "central differences, reduced", reduced, steps)
    rows += in_time(scene, "exponential steps", plate, (128, 256, 512) if arguments.quick else
                    (64, 128, 256, 512, 1024, 2048, 4096))  # fmt: skip
    rows.append(by_events(scene, plate))
    finish(arguments.folder, scene, rows)


def breathing(arguments: common.Arguments) -> None:
    """4000 dofs, 18 pairs."""
    plate = common.plate("breathing_plate", {"damping.ratio": 0.01, "damping.modes": 150})
    law = fc.UnilateralPenalty(1e9)
    started = time.process_time()
    reduced = fc.reduce_structure(plate)
    setup = time.process_time() - started
    best = fc.solve_harmonic_balance(reduced, 2000.0, law, harmonics=20 if arguments.quick else 40)
    print(f"reference: {best.report}; reduction took {1e3 * setup:.0f} ms")
    scene = Scene(
        "breathing", plate, 2000.0, law, lambda phase: best.gap(phase * best.period), reduced
    )
    rows = balance(scene, "reduced", (3, 5, 10) if arguments.quick else (3, 5, 10, 15, 20, 30),
                   structure=reduced)  # fmt: skip
    rows += balance(scene, "full form", (3, 5) if arguments.quick else (3, 5, 10, 20), form="block")
    rows += in_time(scene, "exponential steps, reduced", reduced, (128, 256, 512), most=100)
    least = fc.stable_steps_per_period(reduced, 2000.0, law)
    steps = [int(np.ceil(share * least)) for share in (1.3, 2.6)]
    rows += in_time(scene, "central differences, reduced", reduced, steps, most=100)
    if not arguments.quick:
        least = fc.stable_steps_per_period(plate, 2000.0, law)
        steps = [int(share * least) for share in (1.3, 2.6)]
        rows += in_time(scene, "central differences", plate, steps, most=100)
    finish(arguments.folder, scene, rows)


def own_data(arguments: common.Arguments) -> None:
    """The paper's own data: an unstable orbit."""
    plate = common.plate("paper_plate")
    law = fc.UnilateralPenalty(1e11)
    least = fc.stable_steps_per_period(plate, 2000.0, law)
    periods = 60 if arguments.quick else 400
    kept = periods // 2
    history = fc.integrate_central_difference(
        plate, 2000.0, law, periods=periods, steps_per_period=2 * least, record_periods=kept
    )
    by_period = history.by_period(history.gap)[:, :, 0]
    waves = np.fft.rfft(by_period, axis=1) / by_period.shape[1]
    rows = []
    for harmonics in (5, 20, 80):
        solution = fc.solve_harmonic_balance(plate, 2000.0, law, harmonics=harmonics)
        gap = solution.gap_coefficients[:, 0]
        verdict = fc.floquet(plate, solution).verdict
        rows.append((f"harmonic balance, H = {harmonics}", gap[0], 0.0,
                     float(np.hypot(*gap[1:3])), 0.0, verdict))  # fmt: skip
    mean, first = waves[:, 0].real, 2.0 * np.abs(waves[:, 1])
    spread = 1.0 / np.sqrt(kept)
    rows.append(
        (f"central differences, {kept} periods", mean.mean(), mean.std(), first.mean(),
         first.std(), f"not settled: {history.settled:.2g} from period to period")
    )  # fmt: skip
    average = 2.0 * abs(waves[:, 1].mean())
    rows.append(("the same, averaged by phase", mean.mean(), mean.std() * spread, average,
                 np.abs(waves[:, 1]).std() * 2.0 * spread, "standard errors"))  # fmt: skip
    columns = ("what", "mean gap [m]", "+-", "harmonic 1 [m]", "+-", "verdict")
    common.save_table(
        arguments.folder / "work_precision_data.csv", "The paper's own data", columns, rows
    )


def kernel(arguments: common.Arguments) -> None:
    """What a step costs, and how much of it is the product with K where that is large."""
    plate = common.plate("paper_plate")
    bare = plate.damped(None)
    rows = []
    for name, structure in (("50 damped modes", plate), ("no damping", bare),
                            ("no damping, lumped mass", bare.lumped())):  # fmt: skip
        rows += [(name, scheme, *some) for scheme, some in steps_of(structure).items()]
    path = arguments.folder / "work_precision_steps.csv"
    columns = ("paper's plate, 50 dofs", "scheme", "steps a period", "step [us]", "period [us]")
    common.save_table(path, "A step of each scheme", columns, rows)
    plate = common.plate("breathing_plate")
    bare = plate.damped(None)
    rows = [
        (damping, *step_and_product(structure))
        for damping, structure in (
            ("lumped mass, no damping", bare.lumped()),
            ("no damping", bare),
            (f"{len(damped_modes(plate).omega)} damped modes", plate),
        )
    ]
    columns = (f"breathing plate, {plate.n_dofs} dofs", "step [us]", "product with K [us]", "ratio")
    path = arguments.folder / "work_precision_kernel.csv"
    common.save_table(path, "A step of central differences", columns, rows)


def steps_of(structure: fc.Structure) -> dict[str, tuple[int, float, float]]:
    """Steps in a period, microseconds of a step and of a period, all that a march does included.
    A step of the exact flow is one of its search for events, a twelfth of the fastest period."""
    law, omega = fc.UnilateralPenalty(1e9), 2000.0
    count = int(1.3 * fc.stable_steps_per_period(structure, omega, law))
    fastest = float(np.sqrt(all_modes(structure).squares[-1]))
    schemes: dict[str, tuple[Any, int, int]] = {
        "central differences": (fc.integrate_central_difference, count, count),
        "exponential steps": (fc.integrate_exponential, count, count),
        "exact flow": (fc.integrate_events, 256, int(12.0 * fastest / omega)),
    }
    found = {}
    for name, (integrate, instants, steps) in schemes.items():

        def run(periods: int, integrate: Any = integrate, instants: int = instants) -> None:
            integrate(
                structure, omega, law, periods=periods, steps_per_period=instants, dofs=(),
                record_periods=1,
            )  # fmt: skip

        times = common.alternate({"few": lambda: run(20), "many": lambda: run(420)}, 5)
        period = 1e6 * float(np.median(times["many"] - times["few"])) / 400
        found[name] = (steps, period / steps, period)
    return found


def step_and_product(structure: fc.Structure) -> tuple[float, float, float]:
    """Microseconds of a step and of one product with K, and their ratio, by turns."""
    law = fc.UnilateralPenalty(1e9)
    steps = int(1.3 * fc.stable_steps_per_period(structure, 2000.0, law))
    source, target = structure.stiffness.createVecs()
    source.set(1.0)

    def march(periods: int) -> None:
        fc.integrate_central_difference(
            structure, 2000.0, law, periods=periods, steps_per_period=steps, dofs=()
        )

    def multiply() -> None:
        for _ in range(1000):
            structure.stiffness.mult(source, target)

    times = common.alternate(
        {"one": lambda: march(1), "four": lambda: march(4), "product": multiply}, 5
    )
    step, product = (times["four"] - times["one"]) / (3 * steps), times["product"] / 1000
    return 1e6 * np.median(step), 1e6 * np.median(product), float(np.median(step / product))


# --- the methods ----------------------------------------------------------------------------------


def exact_orbit(
    structure: fc.Structure, omega: float, law: fc.UnilateralPenalty
) -> Callable[[np.ndarray], np.ndarray]:
    """The exact orbit, by shooting from harmonic balance."""
    near = fc.solve_harmonic_balance(structure, omega, law, harmonics=40)
    orbit = fc.shoot(structure, near)
    return lambda phase: orbit.gap_at(phase * orbit.period)


def balance(
    scene: Scene,
    kind: str,
    counts: Sequence[int],
    *,
    structure: fc.Structure | None = None,
    samples: int | None = None,
    **form: str,
) -> list[tuple[Any, ...]]:
    """Harmonic balance from a cold start."""
    solved = structure or scene.structure
    rows = []
    for harmonics in counts:
        runs = []
        memory = common.PeakMemory()
        for _ in range(3 if solved.n_dofs < 100 else 1):
            started = time.process_time()
            problem = fc.Problem(solved, scene.omega, scene.law, harmonics, samples)
            solution = solve_form(problem, throw=False, **form)  # type: ignore[arg-type]
            runs.append(time.process_time() - started)
        peak = memory.mib()
        gap = solution.gap(np.arange(512) * solution.period / 512)
        note = "" if solution.converged else "not converged"
        rows.append((scene.name, f"harmonic balance, {kind}", f"H = {harmonics}",
                     scene.error(gap), 1e3 * min(runs), peak, 0, note))  # fmt: skip
    return rows


SCHEMES: dict[str, Callable[..., fc.TimeHistory]] = {
    "central differences": fc.integrate_central_difference,
    "exponential steps": fc.integrate_exponential,
}


def in_time(
    scene: Scene, method: str, structure: fc.Structure, steps: Sequence[int], most: int = 400
) -> list[tuple[Any, ...]]:
    """A scheme with more and more steps, from rest until it has settled."""
    rows = []
    integrate = SCHEMES[method.split(",")[0]]
    goal = 1e-2
    for count in steps:

        def run(settle: float, count: int = count) -> tuple[fc.TimeHistory, float, float, float]:
            """The march, its error, its time and its memory."""
            times: list[float] = []
            memory = common.PeakMemory()
            while len(times) < 3 and sum(times) < 0.5:
                started = time.process_time()
                history = integrate(
                    structure, scene.omega, scene.law, periods=most, steps_per_period=count,
                    settle=settle, record_periods=1, dofs=(),
                )  # fmt: skip
                times.append(time.process_time() - started)
            return history, scene.error(history.gap), min(times), memory.mib()

        try:
            history, error, cpu, peak = run(goal)
        except fc.ConvergenceError as failed:
            rows.append((scene.name, method, f"{count} steps", float("nan"), float("nan"),
                         float("nan"), 0, str(failed)[:50]))  # fmt: skip
            continue
        if history.settled > 0.1 * error and history.periods < most:  # it stopped too early
            history, error, cpu, peak = run(0.01 * error)
        goal = min(goal, 0.1 * error)
        rows.append((scene.name, method, f"{count} steps", error, 1e3 * cpu, peak,
                     history.periods, ""))  # fmt: skip
    return rows


def by_events(scene: Scene, structure: fc.Structure) -> tuple[Any, ...]:
    """The exact flow from rest."""
    memory, times = common.PeakMemory(), []
    for _ in range(3):
        started = time.process_time()
        history = fc.integrate_events(
            structure, scene.omega, scene.law, periods=400, settle=1e-9, record_periods=1
        )
        times.append(time.process_time() - started)
    return (scene.name, "exact flow", "", scene.error(history.gap), 1e3 * min(times), memory.mib(),
            history.periods, "")  # fmt: skip


def by_solve_ivp(scene: Scene, tolerances: Sequence[float]) -> list[tuple[Any, ...]]:
    """SciPy's Runge-Kutta method of order 8 on the oscillator, 130 periods from rest."""
    periods, omega = 130, scene.omega
    span = 2.0 * np.pi / omega * periods
    instants = span * (1.0 - 1.0 / periods) + np.arange(512) * (span / periods / 512)

    def rate(time_: float, state: np.ndarray) -> tuple[float, float]:
        force = np.cos(omega * time_) - 0.1 * state[1] - state[0] - max(state[0], 0.0)
        return state[1], force

    rows = []
    for tolerance in tolerances:
        memory = common.PeakMemory()
        started = time.process_time()
        found = solve_ivp(
            rate, (0.0, span), (0.0, 0.0), method="DOP853", rtol=tolerance, atol=tolerance,
            t_eval=instants,
        )  # fmt: skip
        cpu, peak = time.process_time() - started, memory.mib()
        gap = found.y[0][:, None]
        rows.append((scene.name, "solve_ivp", f"rtol {tolerance:.0e}", scene.error(gap), 1e3 * cpu,
                     peak, periods, ""))  # fmt: skip
    return rows


# --- results --------------------------------------------------------------------------------------


def finish(folder: Path, scene: Scene, rows: list[tuple[Any, ...]]) -> None:
    """Table, picture, and how much faster harmonic balance is at the same error."""
    stem = folder / f"work_precision_{scene.name}"
    common.save_table(stem.with_suffix(".csv"), f"Scene {scene.name}", COLUMNS, rows)
    figure, (axes,) = common.figure(1)
    for method, (colour, look) in LOOKS.items():
        mine = [row for row in rows if row[1] == method and np.isfinite(row[3])]
        if mine:
            axes.loglog(
                [row[4] for row in mine], [row[3] for row in mine], look, ms=5, lw=1.0,
                color=COLOURS[colour], label=method,
            )  # fmt: skip
    axes.set_xlabel("processor time [ms]")
    axes.set_ylabel("relative L2 error of the gap over the period [-]")
    axes.set_title(f"Scene {scene.name}: error against time")
    axes.legend(fontsize=7, bbox_to_anchor=(1.01, 1.0), loc="upper left")  # beside, not over points
    figure.savefig(stem.with_suffix(".png"))
    for goal in (1e-2, 1e-3, 1e-4):
        good = [row for row in rows if row[3] <= goal]
        balanced = [row[4] for row in good if row[1].startswith("harmonic balance")]
        if balanced:
            print(f"{scene.name}, error {goal:g}: harmonic balance {min(balanced):.3g} ms")
            for method in LOOKS:
                times = [row[4] for row in good if row[1] == method]
                if times and not method.startswith("harmonic balance"):
                    print(f"    {method}: {min(times) / min(balanced):.3g} times as long")


if __name__ == "__main__":
    main()
