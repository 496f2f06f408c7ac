"""Speed of the condensed solver, always with the error beside it.

newton : one Newton iteration (contact integrals, residual, Jacobian, factorisation, solution) as a
    multiple of one LAPACK factorisation and solution (``scipy.linalg.lu_factor``, ``lu_solve``) of
    a dense matrix of that size; and where the time goes.
integrals : exact contact integrals against sampled ones, error against time, on the bilinear
    oscillator (c = 0.1, kc = 1, f = 1) at w0/2 and 1, on the paper's plate (k = 1e9 N/m, damping
    0.01, 2000 rad/s) and on the reduced breathing plate (18 pairs, 1e9 N/m a pair); the error is
    measured against exact integrals with H = 400, 320 and 40.
full : the breathing plate, all pairs, 1e9 N/m a pair, 2000 rad/s: the condensed solution (on the
    reduced structure, prepared beforehand; and with the exact compliance, its factorisations
    included) against the full form.
pyharm : pyHarm's arc-length sweep of the bilinear oscillator (c = 0.02, kc = 1, f = 0.1) and of
    50 masses in a chain with one stop, and of 60 with 20 stops, against this package on the
    frequencies that pyHarm visited, each solution starting from its neighbour, its error report
    included; and against ``continue_frequency`` with steps of its own, without error reports.
    Same H, 128 samples, then exact integrals; error at w = 1.2 against exact integrals with H =
    200. On one mass pyHarm has 1024 samples too, with which it comes close to that error.
    pyHarm's Python is found by --pyharm or the variable PYHARM_PYTHON (pip install pyHarm-os in
    an environment of its own).
others : 60 masses with 20 stops by SKHiPPR and tmdsimpy, at 1.2 rad/s from the linear solution and
    along a curve from 1.3 rad/s, a solution being given. With their samples the error is that of
    exact integrals to 2 %, with H = 20 to 16 %. Their Python is found by --others or the variable
    OTHERS_PYTHON: an environment with NumPy, SciPy, Matplotlib, JAX and typing-extensions that
    finds the repositories inm-unistuttgart/SKHiPPR and tmd-lab/tmdsimpy by a .pth file.

Times are the process's own, taken in turns within one run; ratios are medians over the turns.

    OMP_NUM_THREADS=1 python benchmarks/condensed_speed.py [--quick] [--only PART]
        [--pyharm PYTHON] [--others PYTHON] [folder]
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import common
import numpy as np
import scipy.linalg
from laboratory import solve_form

import fenics_crack as fc
from fenics_crack.balance.compliance import dynamic_compliance
from fenics_crack.balance.contact_integrals import contact_integrals
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem
from fenics_crack.draw.figure import COLOURS

CONTINUED = "this, continued, exact"
PYHARM, FINER = "pyHarm", "pyHarm, 1024 samples"
WORKER = Path(__file__).absolute().with_name("pyharm_worker.py")
OTHERS_WORKER = WORKER.with_name("others_worker.py")
STEPS = {"tmdsimpy": 0.05, "SKHiPPR": 0.004}
"""Arc lengths, each in its program's norm, with about the frequency steps of this package."""


def main() -> None:
    """Run the parts asked for."""
    common.run(
        __doc__,
        {
            "newton": run_newton,
            "integrals": run_integrals,
            "full": run_full,
            "pyharm": run_pyharm,
            "others": run_others,
        },
        pyharm={"default": os.environ.get("PYHARM_PYTHON"), "help": "a Python that has pyHarm"},
        others={
            "default": os.environ.get("OTHERS_PYTHON"),
            "help": "a Python that has SKHiPPR and tmdsimpy",
        },
    )


# --- one Newton iteration -------------------------------------------------------------------------


def run_newton(arguments: common.Arguments) -> None:
    """Cost of the parts of an iteration, as multiples of LAPACK's."""
    folder, quick = arguments.folder, arguments.quick
    plate = fc.reduce_structure(common.plate("breathing_plate"))
    cases = [("18 pairs", plate, h) for h in ((12,) if quick else (12, 20, 30, 40))]
    cases += [("10 pairs", stops(10), h) for h in ((20,) if quick else (20, 40))]
    columns = (
        "case", "H", "unknowns", "iteration / LAPACK", "integrals and residual", "Jacobian",
        "factorisation", "solution", "LAPACK ms",
    )  # fmt: skip
    rows = []
    for name, structure, harmonics in cases:
        times = iteration_times(structure, harmonics, 5 if quick else 31)
        parts = ["residual", "jacobian", "factor", "solve"]
        whole = sum(times[part] for part in parts)
        lapack = times["lapack"]
        shares = [float(np.median(times[part] / lapack)) for part in parts]
        unknowns = (2 * harmonics + 1) * structure.n_pairs
        rows.append(
            (name, harmonics, unknowns, float(np.median(whole / lapack)), *shares,
             1e3 * float(np.median(lapack)))
        )  # fmt: skip
    title = (
        "One Newton iteration and its parts, as multiples of LAPACK's factorisation and solution"
    )
    common.save_table(folder / "condensed_speed_newton.csv", title, columns, rows)
    figure, (axes,) = common.figure(1)
    labels = [f"{row[0]}\nH = {row[1]}\n{row[2]} unknowns" for row in rows]
    bottom = np.zeros(len(rows))
    colours = ("blue", "orange", "green", "pink")
    for part, colour in enumerate(colours):
        heights = np.array([row[4 + part] for row in rows])
        label = columns[4 + part]
        axes.bar(labels, heights, bottom=bottom, color=COLOURS[colour], label=label, width=0.6)
        bottom += heights
    axes.axhline(1.0, color=COLOURS["grey"], ls="--", lw=1, label="LAPACK alone")
    axes.axhline(1.5, color=COLOURS["grey"], ls=":", lw=1.2, label="goal: 1.5")
    axes.set_ylabel("time / LAPACK's factorisation and solution [-]")
    axes.set_title("One Newton iteration with exact contact integrals")
    axes.tick_params(axis="x", labelsize=7)
    axes.set_ylim(top=1.35 * bottom.max())
    axes.legend(fontsize=8, ncols=2)
    figure.savefig(folder / "condensed_speed_newton.png")


def iteration_times(structure: fc.Structure, harmonics: int, repeats: int) -> dict[str, np.ndarray]:
    """Times [s] of the parts of one iteration, and of LAPACK on the same matrix."""
    omega = 2000.0 if structure.n_dofs > 20 else 1.2
    compliance = dynamic_compliance(structure, omega, harmonics)
    law = fc.UnilateralPenalty(1e9 if structure.n_dofs > 20 else 1.0)
    system = ContactSystem(compliance, contact_integrals(law, harmonics))
    generator = np.random.default_rng(1)
    decay = 1.0 / (1.0 + np.arange(2 * harmonics + 1)) ** 2
    size = np.abs(system.linear).max()
    points: list[ContactPoint] = []

    def new_gap() -> np.ndarray:
        noise = generator.standard_normal(system.shape) * decay[:, None]
        return system.linear + size * noise

    times: dict[str, list[float]] = {}

    def timed(name: str, function: Callable[[], Any]) -> None:
        times.setdefault(name, []).append(common.seconds(function))

    for _ in range(repeats + 1):
        gap = new_gap()
        timed("residual", lambda gap=gap: points.append(system.linearise(gap)))
        at = points[-1]
        timed("jacobian", lambda at=at: at.jacobian)
        timed("first", lambda at=at: at.solve(at.residual))  # factors and solves
        timed("solve", lambda at=at: at.solve(at.residual))

        def lapack(at: ContactPoint = at) -> None:
            factors = scipy.linalg.lu_factor(at.jacobian, check_finite=False)
            scipy.linalg.lu_solve(factors, at.residual.ravel(), check_finite=False)

        timed("lapack", lapack)
    arrays = {name: np.array(values)[1:] for name, values in times.items()}
    arrays["factor"] = arrays["first"] - arrays["solve"]
    return arrays


def stops(count: int) -> fc.Structure:
    """Masses on springs, coupled to their neighbours, each with a stop."""
    load = np.linspace(0.5, 1.0, count)
    return fc.Structure.from_matrices(
        np.eye(count), np.eye(count) + 0.3 * common.chain(count), gap=np.eye(count), force_cos=load,
        damping=0.05 * np.eye(count),
    )  # fmt: skip


# --- exact against sampled ------------------------------------------------------------------------


def run_integrals(arguments: common.Arguments) -> None:
    """Error against time."""
    folder, quick = arguments.folder, arguments.quick
    oscillator = common.oscillator(1.0, 0.1)
    fundamental = 2.0 / (1.0 + np.sqrt(0.5))  # 2 w1 w2 / (w1 + w2) with w2 = sqrt(2) w1
    plate = common.plate("paper_plate", {"damping.ratio": 0.01})
    breathing = fc.reduce_structure(common.plate("breathing_plate"))
    cases: list[tuple[str, fc.Structure, float, float, int]] = [
        ("oscillator w0/2", oscillator, fundamental / 2.0, 1.0, 400),
        ("oscillator w = 1", oscillator, 1.0, 1.0, 400),
        ("paper's plate", plate, 2000.0, 1e9, 320),
    ]
    if not quick:
        cases.append(("breathing plate", breathing, 2000.0, 1e9, 40))
    columns = ("case", "H", "samples", "relative L2 error", "iterations", "ms", "time / exact")
    columns += ("integrals / exact",)
    rows: list[tuple[Any, ...]] = []
    for name, structure, omega, stiffness, finest in cases:
        law = fc.UnilateralPenalty(stiffness)
        reference = fc.solve_harmonic_balance(structure, omega, law, harmonics=finest)
        for harmonics in (5, 20) if quick else (5, 10, 20, 40):
            if structure is breathing and harmonics > 10:
                continue  # seconds a solution
            rows += compare_integrals(name, structure, omega, law, harmonics, reference, quick)
    title = "Exact and sampled contact integrals"
    common.save_table(folder / "condensed_speed_integrals.csv", title, columns, rows)
    cheapest_equal(rows, folder)
    names = [case[0] for case in cases]
    figure, panels = common.figure(2, 2)
    colours = dict(zip(sorted({row[1] for row in rows}), COLOURS.values(), strict=False))
    for axes, name in zip(panels, names, strict=False):
        for harmonics, colour in colours.items():
            chosen = [row for row in rows if row[:2] == (name, harmonics)]
            if not chosen:
                continue
            exact = next(row for row in chosen if row[2] == "exact")
            sampled = [row for row in chosen if row[2] != "exact"]
            axes.semilogy(
                [r[6] for r in sampled], [r[3] for r in sampled], ".-", color=colour, lw=1.2,
                label=f"sampled, H = {harmonics}",
            )  # fmt: skip
            axes.semilogy(exact[6], exact[3], "*", color=colour, ms=12, mec="black", mew=0.6)
        axes.plot([], [], "*", color="white", ms=12, mec="black", label="exact, same colour")
        axes.set_xlabel("time of a solution / that with exact integrals, same H [-]")
        axes.set_ylabel("relative L2 error of the gap [-]")
        axes.set_title(f"{name}; samples double from point to point", fontsize=10)
        axes.legend(fontsize=7)
    figure.savefig(folder / "condensed_speed_integrals.png")


def compare_integrals(
    name: str,
    structure: fc.Structure,
    omega: float,
    law: fc.UnilateralPenalty,
    harmonics: int,
    reference: fc.PeriodicSolution,
    quick: bool,
) -> list[tuple[Any, ...]]:
    """Solve with exact integrals and with ever more samples, taking turns."""
    counts: list[int | None] = [None]
    least = 1 << (4 * harmonics + 1 - 1).bit_length()
    counts += [least << i for i in range(0, 9, 2 if quick else 1) if least << i <= 16384]
    solutions, runs, alone = {}, {}, {}
    for count in counts:
        key = "exact" if count is None else str(count)

        def run(count: int | None = count) -> fc.PeriodicSolution:
            return fc.solve_harmonic_balance(
                structure, omega, law, harmonics=harmonics, samples=count, throw=False
            )

        integrals = contact_integrals(law, harmonics, count)
        solutions[key] = run()
        gap = solutions[key].gap_coefficients
        runs[key] = run
        alone[key] = lambda integrals=integrals, gap=gap: integrals.linearise(gap)
    times = common.alternate(runs, 5 if quick or structure.n_pairs > 1 else 15)
    single = common.alternate(alone, 5 if quick else 25)
    rows = []
    for key, solution in solutions.items():
        error = common.relative_difference(solution.gap_coefficients, reference.gap_coefficients)
        rows.append(
            (
                name,
                harmonics,
                key,
                error if solution.converged else float("nan"),
                solution.iterations,
                1e3 * float(np.median(times[key])),
                common.ratio(times, key, "exact"),
                common.ratio(single, key, "exact"),
            )
        )
    return rows


def cheapest_equal(rows: Sequence[tuple[Any, ...]], folder: Path) -> None:
    """For each exact solution: the fewest samples with an error at most a tenth larger."""
    columns = ("case", "H", "exact: error", "samples for 1.1 times that", "time / exact")
    columns += ("integrals / exact",)
    table = []
    for row in rows:
        if row[2] != "exact":
            continue
        same = [r for r in rows if r[:2] == row[:2] and r[2] != "exact" and r[3] <= 1.1 * row[3]]
        if same:
            best = min(same, key=lambda r: int(r[2]))
            table.append((*row[:2], row[3], best[2], best[6], best[7]))
        else:
            table.append((*row[:2], row[3], "none tried", float("nan"), float("nan")))
    title = "Samples needed for the error of exact integrals"
    common.save_table(folder / "condensed_speed_equal_error.csv", title, columns, table)


# --- condensed against full -----------------------------------------------------------------------


def run_full(arguments: common.Arguments) -> None:
    """The breathing plate three ways."""
    folder, quick = arguments.folder, arguments.quick
    whole = common.plate("breathing_plate")
    reduced = fc.reduce_structure(whole)
    columns = (
        "H", "full / reduced", "full / exact compliance", "full ms", "difference of gap: reduced",
        "exact", "reduction error estimated", "iterations",
    )  # fmt: skip
    rows = []
    for harmonics in (5,) if quick else (5, 10, 20):
        found: dict[str, fc.PeriodicSolution] = {}

        def solver(
            key: str,
            structure: fc.Structure,
            form: str,
            harmonics: int = harmonics,
            found: dict[str, fc.PeriodicSolution] = found,
        ) -> Callable[[], None]:
            def run() -> None:
                problem = fc.Problem(structure, 2000.0, fc.UnilateralPenalty(1e9), harmonics)
                found[key] = solve_form(problem, form=form)

            return run

        times = common.alternate(
            {
                "full": solver("full", whole, "block"),
                "reduced": solver("reduced", reduced, "condensed"),
                "exact": solver("exact", whole, "condensed"),
            },
            1 if quick else 3,
        )
        gaps = {key: solution.gap_coefficients for key, solution in found.items()}
        rows.append(
            (
                harmonics,
                common.ratio(times, "full", "reduced"),
                common.ratio(times, "full", "exact"),
                1e3 * float(np.median(times["full"])),
                common.relative_difference(gaps["reduced"], gaps["full"]),
                common.relative_difference(gaps["exact"], gaps["full"]),
                found["reduced"].report.reduction,
                found["full"].iterations,
            )
        )
    title = f"Breathing plate, {whole.n_dofs} dofs, {whole.n_pairs} pairs: times of form='full'"
    title += " over the condensed ones"
    common.save_table(folder / "condensed_speed_full.csv", title, columns, rows)
    figure, (axes,) = common.figure(1)
    place = np.arange(len(rows))
    for shift, column, colour in ((-0.2, 1, "blue"), (0.2, 2, "orange")):
        bars = axes.bar(
            place + shift, [row[column] for row in rows], 0.36, color=COLOURS[colour],
            label=("reduced structure" if column == 1 else "exact compliance, factors included"),
        )  # fmt: skip
        difference = [row[3 + column] for row in rows]
        axes.bar_label(bars, [f"{d:.0e}" for d in difference], fontsize=7, padding=2)
    axes.axhline(20.0, color=COLOURS["grey"], ls=":", label="goal for the reduced one: 20")
    axes.set_xticks(place, [f"H = {row[0]}" for row in rows])
    axes.set_ylabel("time of the full form / condensed [-]")
    axes.set_ylim(top=1.35 * max(max(row[1] for row in rows), 20.0))
    axes.set_title("Full against condensed (numbers: relative difference of the gap)", fontsize=10)
    axes.legend(fontsize=8)
    figure.savefig(folder / "condensed_speed_full.png")


# --- pyHarm ---------------------------------------------------------------------------------------


def run_pyharm(arguments: common.Arguments) -> None:
    """The same sweeps by pyHarm and by this package."""
    folder, quick, python = arguments.folder, arguments.quick, arguments.pyharm
    if not python or not Path(python).exists() or not can_import(python, "pyHarm"):
        print(
            "\nNo pyHarm: this part is left out. Make a virtual environment, pip install "
            "pyHarm-os in it, and name its Python with --pyharm or PYHARM_PYTHON."
        )
        return
    one = np.eye(1)
    single = dict(
        name="oscillator", mass=one, stiffness=one, damping=0.02 * one, stop=1.0, finer=1024,
        solver="scipyroot", start=2.0, end=0.5, timeout="00:00:01:00",
    )  # fmt: skip
    K = common.chain(50)
    K[-1, -1] = 1.0
    K /= np.linalg.eigvalsh(K)[0]  # the first natural frequency is 1
    # The harmonics of the load meet the chain's other modes: its fine sweep is a short one.
    chain = dict(
        name="50 masses", mass=np.eye(50), stiffness=K, damping=0.02 * K, stop=25.0, finer=None,
        solver="NewtonRaphson", start=1.3, end=1.15, timeout="00:00:00:40",
    )  # fmt: skip
    K60 = sixty()
    stops = dict(
        name="60 masses, 20 stops", mass=np.eye(60), stiffness=K60, damping=0.02 * K60, stop=25.0,
        finer=None, solver="NewtonRaphson", start=1.3, end=1.15, timeout="00:00:00:40", stops=20,
    )  # fmt: skip
    columns = (
        "case", "H", "who", "points", "of", "ms a point", "pyHarm / this", "finer pyHarm / this",
        "error at w = 1.2",
    )  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for case, counts, turns in (
        (single, (5,) if quick else (5, 10, 20), 1 if quick else 5),
        (chain, () if quick else (5, 10), 2),
        (stops, () if quick else (5, 10), 2),
    ):
        for harmonics in counts:
            rows += race(python, case, harmonics, turns)
    title = "pyHarm's sweep, and ours on the frequencies it visited; error: relative L2 of the "
    title += "stopped mass"
    common.save_table(folder / "condensed_speed_pyharm.csv", title, columns, rows)
    figure, (axes,) = common.figure(1)
    looks = dict(
        zip(dict.fromkeys(row[2] for row in rows), ("o", "v", "^", "*", "D", "s"), strict=False)
    )
    colours = dict(zip((who for who in looks if who != FINER), COLOURS.values(), strict=False))
    colours[FINER] = colours[PYHARM]
    marks = {"oscillator": "full", "50 masses": "none", "60 masses, 20 stops": "left"}
    for case in marks:
        for who in looks:
            chosen = [row for row in rows if row[0] == case and row[2] == who]
            axes.loglog(
                [row[5] for row in chosen],
                [row[8] for row in chosen],
                looks[who] + ":",
                color=colours[who],
                ms=9,
                lw=0.8,
                fillstyle=marks[case],
            )
            for row in chosen if who in (PYHARM, CONTINUED) else []:
                left = who == CONTINUED
                axes.annotate(
                    f"H = {row[1]}",
                    (row[5], row[8]),
                    (-9 if left else 9, 0),
                    textcoords="offset points",
                    ha="right" if left else "left",
                    va="center",
                    size=8,
                )
    for who, look in looks.items():
        axes.plot([], [], look, color=colours[who], label=who)
    axes.plot([], [], "o", color=COLOURS["grey"], label="filled: one mass")
    axes.plot([], [], "o", color=COLOURS["grey"], fillstyle="none", label="open: 50 masses")
    axes.plot([], [], "o", color=COLOURS["grey"], fillstyle="left", label="half: 60, 20 stops")
    axes.set_xlabel("time of a converged point [ms]")
    axes.set_ylabel("relative L2 error at w = 1.2 rad/s [-]")
    axes.set_title("Sweep of a structure with one stop: error against time")
    axes.margins(0.2)
    axes.legend(fontsize=8, loc="lower right")
    figure.savefig(folder / "condensed_speed_pyharm.png")


def can_import(python: str, package: str) -> bool:
    """Whether that Python has it."""
    return run_python(python, ["-c", f"import {package}"]).returncode == 0


def run_python(
    python: str, arguments: Sequence[str], text: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run another Python; in a folder that is thrown away, since pyHarm leaves files there."""
    with tempfile.TemporaryDirectory() as folder:
        return subprocess.run(
            [str(Path(python).absolute()), *arguments],
            input=text,
            capture_output=True,
            text=True,
            check=False,
            cwd=folder,
            env=plain(),
        )


def plain() -> dict[str, str]:
    """The environment without this Python's paths."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if name not in hidden}


def race(python: str, case: dict[str, Any], harmonics: int, turns: int) -> list[tuple[Any, ...]]:
    """Both on the same points, taking turns."""
    size, finer, stops = len(case["mass"]), case["finer"], case.get("stops", 1)
    stopped = list(range(size - stops, size))
    job = {name: value for name, value in case.items() if name not in ("name", "finer", "stops")}
    job |= {name: case[name].tolist() for name in ("mass", "stiffness", "damping")}
    job |= dict(
        loaded=size - 1, stopped=stopped, force=0.1, harmonics=harmonics, at=1.2, step=0.05,
        reductor="noreductor", solver_options={},
    )  # fmt: skip
    load = np.zeros(size)
    load[-1] = 0.1
    gap = np.eye(size)[:, stopped]
    structure = fc.Structure.from_matrices(
        case["mass"], case["stiffness"], gap=gap, force_cos=load, damping=case["damping"]
    )
    law = fc.UnilateralPenalty(case["stop"])
    reference = fc.solve_harmonic_balance(structure, 1.2, law, harmonics=200).gap_coefficients
    ways = {"this, 128 samples": 128, "this, exact": None}
    times: dict[str, list[float]] = {}
    converged = dict.fromkeys(ways, 0)
    theirs: dict[str, dict[str, Any]] = {}
    follow = fc.continue_frequency  # imported here, not while timed
    for _ in range(turns):
        for who, samples in {PYHARM: 128, FINER: finer}.items():
            if samples is not None:
                theirs[who] = answer(python, WORKER, job | {"samples": samples})
                seconds = theirs[who]["seconds"] / len(theirs[who]["omega"])
                times.setdefault(who, []).append(seconds)
        for who, samples in ways.items():
            seconds, converged[who] = sweep(
                structure, law, harmonics, samples, theirs[PYHARM]["omega"]
            )
            times.setdefault(who, []).append(seconds / max(converged[who], 1))
        started = time.process_time()
        curve = follow(structure, case["start"], case["end"], law, harmonics=harmonics)
        seconds = time.process_time() - started
        converged[CONTINUED] = len(curve)
        times.setdefault(CONTINUED, []).append(seconds / len(curve))
    arrays = {who: np.array(values) for who, values in times.items()}
    if finer is None:
        arrays[FINER] = np.full(turns, np.nan)
    points = len(theirs[PYHARM]["omega"])

    def row(who: str, found: int, of: int, coefficients: np.ndarray) -> tuple[Any, ...]:
        return (
            case["name"], harmonics, who, found, of, 1e3 * float(np.median(arrays[who])),
            common.ratio(arrays, PYHARM, who), common.ratio(arrays, FINER, who),
            common.relative_difference(coefficients, reference),
        )  # fmt: skip

    rows = [
        row(who, len(run["omega"]), run["tried"], np.array(run["coefficients"])[:, -stops:])
        for who, run in theirs.items()
    ]
    for who, samples in (ways | {CONTINUED: None}).items():
        solution = fc.solve_harmonic_balance(
            structure, 1.2, law, harmonics=harmonics, samples=samples
        )
        rows.append(row(who, converged[who], points, solution.gap_coefficients))
    return rows


def answer(python: str, worker: Path, job: dict[str, Any]) -> dict[str, Any]:
    """What a worker answers."""
    finished = run_python(python, [str(worker)], json.dumps(job))
    if finished.returncode != 0:
        raise RuntimeError(f"{worker.name} failed: {finished.stderr[-500:]}")
    found: dict[str, Any] = json.loads(finished.stdout)
    return found


def sweep(
    structure: fc.Structure,
    law: fc.UnilateralPenalty,
    harmonics: int,
    samples: int | None,
    frequencies: Sequence[float],
) -> tuple[float, int]:
    """Processor time [s] of solutions that start from their neighbours, and how many converged."""
    neighbour: fc.PeriodicSolution | None = None
    converged = 0
    started = time.process_time()
    for omega in frequencies:
        solution = fc.solve_harmonic_balance(
            structure, omega, law, harmonics=harmonics, samples=samples, initial=neighbour,
            throw=False,
        )  # fmt: skip
        neighbour = solution if solution.converged else None
        converged += solution.converged
    return time.process_time() - started, converged


# --- SKHiPPR and tmdsimpy -------------------------------------------------------------------------


def run_others(arguments: common.Arguments) -> None:
    """60 masses with 20 stops, cold and along a curve."""
    python = arguments.others
    there = python and Path(python).exists()
    programs = [who for who in STEPS if there and can_import(python, who.lower())]
    if not programs:
        print("\nNeither SKHiPPR nor tmdsimpy: this part is left out; see --others.")
        return
    K, stopped = sixty(), list(range(40, 60))
    load = np.zeros(60)
    load[-1] = 0.1
    structure = fc.Structure.from_matrices(
        np.eye(60), K, gap=np.eye(60)[:, stopped], force_cos=load, damping=0.02 * K
    )
    law = fc.UnilateralPenalty(25.0)
    reference = fc.solve_harmonic_balance(structure, 1.2, law, harmonics=200).gap_coefficients
    job = dict(
        mass=np.eye(60).tolist(), stiffness=K.tolist(), damping=(0.02 * K).tolist(),
        load=load.tolist(), stopped=stopped, stop=25.0, at=1.2, start=1.3, end=1.15, xtol=1e-8,
    )  # fmt: skip
    columns = (
        "H", "who", "samples", "cold: iterations", "converged", "s", "s / this", "ms an iteration",
        "curve: points", "ms a point", "ms / this", "error at w = 1.2",
    )  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for harmonics, samples, cold in ((5, 64, 200), (10, 128, 100), (20, 128, 60)):
        if arguments.quick and harmonics > 5:
            break
        rows += beside(python, programs, structure, reference, job | dict(
            harmonics=harmonics, samples=samples, iterations=cold, points=40 // harmonics,
        ))  # fmt: skip
        title = "60 masses with 20 stops; the cold time of what did not converge is a lower bound"
        common.save_table(arguments.folder / "condensed_speed_others.csv", title, columns, rows)


def beside(
    python: str,
    programs: Sequence[str],
    structure: fc.Structure,
    reference: np.ndarray,
    job: dict[str, Any],
) -> list[tuple[Any, ...]]:
    """The programs' answers, each between two measurements of this package."""
    law, harmonics = fc.UnilateralPenalty(job["stop"]), job["harmonics"]
    follow = fc.continue_frequency  # imported here, not while timed

    def solve(omega: float) -> fc.PeriodicSolution:
        return fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics)

    near, initial = solve(job["at"]), solve(job["start"])
    job |= dict(
        near=near.displacement_coefficients.tolist(),
        initial=initial.displacement_coefficients.tolist(),
    )
    ours: dict[str, list[float]] = {"cold": [], "point": []}

    def measure() -> int:
        ours["cold"].append(common.seconds(lambda: solve(job["at"])))
        started = time.process_time()
        curve = follow(
            structure, job["start"], job["end"], law, harmonics=harmonics, longest_step=0.05,
            initial=initial,
        )  # fmt: skip
        ours["point"].append((time.process_time() - started) / len(curve))
        return len(curve)

    count = measure()
    theirs = {}
    for who in programs:
        theirs[who] = answer(python, OTHERS_WORKER, job | {"program": who, "step": STEPS[who]})
        measure()
    cold, point = (float(np.median(ours[name])) for name in ("cold", "point"))
    rows: list[tuple[Any, ...]] = [
        (
            harmonics, "this", "exact", near.iterations, True, cold, 1.0,
            1e3 * cold / near.iterations, count, 1e3 * point, 1.0,
            common.relative_difference(near.gap_coefficients, reference),
        )
    ]  # fmt: skip
    for who, run in theirs.items():
        each = float(np.median(run["points"]))
        gap = np.array(run["coefficients"])[:, job["stopped"]]
        rows.append(
            (
                harmonics, who, job["samples"], run["iterations"], run["converged"], run["cold"],
                run["cold"] / cold, 1e3 * run["cold"] / run["iterations"], len(run["points"]),
                1e3 * each, each / point, common.relative_difference(gap, reference),
            )
        )  # fmt: skip
    return rows


def sixty() -> np.ndarray:
    """Stiffness of 60 masses in a chain, the first natural frequency being 1."""
    K = common.chain(60)
    stiffness: np.ndarray = K / np.linalg.eigvalsh(K)[0]
    return stiffness


if __name__ == "__main__":
    main()
