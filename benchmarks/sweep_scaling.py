"""Sweeps over 1, 2 and 4 ranks: time on the clock, speed-up and efficiency.

Two sweeps: one geometry at many frequencies, and many crack lengths, each a geometry of its own. A
run is a program of its own; its time starts when every rank has imported everything and ends when
the file is complete. The numbers of ranks take turns; ratios are medians over the turns.

Two ranks cannot be faster than two programs side by side are on this machine: with them, as a
control, runs the same sweep on one rank, twice at the same time ("apart"). Four ranks share two
cores.

    OMP_NUM_THREADS=1 python benchmarks/sweep_scaling.py [--quick] [folder]

Other parts: ``--only chunks`` measures what a neighbour's solution is worth as a start, ``--only
cases`` what frequencies cost that share their equations and their flow.
"""

import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import DEMOS, Arguments, run, save_table
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.scene.tables import Sweep
from fenics_crack.study.prepare import law_of
from fenics_crack.sweep import case as sweep_case
from fenics_crack.sweep.plan import Chunk, Plan

RANKS = (1, 2, 4)
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",  # Open MPI 4
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # Open MPI 5
}
CHANGES = {
    "damping.ratio": 0.01,
    "damping.modes": 30,
    "crack.first_omega": None,
    "crack.length": 0.0431,
    "harmonic_balance.harmonics": 10,
}


def scene_of(kind: str, quick: bool) -> fc.Scene:
    """The breathing plate with 10 pairs, swept over frequencies, or crack lengths."""
    part = 4 if quick else 1
    if kind == "frequencies":
        over = {"excitation.omega": {"start": 1000.0, "stop": 4000.0, "count": 300 // part}}
    else:
        over = {
            "crack.length": {"start": 0.02, "stop": 0.06, "count": 48 // part},
            "excitation.omega": [1900.0, 2000.0, 2100.0],
        }
    changes = CHANGES | {"mesh.lip_elements": 5}
    scene = fc.Scene.load(DEMOS / "breathing_plate.toml").replace(changes)
    return dataclasses.replace(scene, sweep=Sweep.from_mapping({"over": over}))


def launched(ranks: int, kind: str, quick: bool, folder: str) -> subprocess.Popen[str]:
    """This program, on some ranks, running one sweep and printing its time."""
    file = Path(folder) / f"{kind}_{ranks}_{time.monotonic_ns()}.h5"
    size = "quick" if quick else "whole"
    command = ["mpirun", "-n", str(ranks), sys.executable, __file__, "worker", kind, size, file]
    return subprocess.Popen(
        list(map(str, command)), env=os.environ | ENVIRONMENT, stdout=subprocess.PIPE, text=True
    )


def clocked(processes: list[subprocess.Popen[str]]) -> float:
    """Longest time on the clock that programs print [s]."""
    times = []
    for process in processes:
        output = process.communicate()[0]
        if process.returncode:
            raise RuntimeError(f"a run ended with {process.returncode}")
        times.append(float(output.split()[-1]))
    return max(times)


def worker(kind: str, size: str, path: str) -> None:
    """Run one sweep; rank 0 prints the time."""
    comm = MPI.COMM_WORLD
    scene = scene_of(kind, size == "quick")
    fc.prepare(scene.replace({"sweep": None}), MPI.COMM_SELF)  # forms are compiled
    comm.Barrier()
    started = time.perf_counter()
    result = fc.run_sweep(scene, path)
    elapsed = time.perf_counter() - started
    assert result.complete
    if comm.rank == 0:
        print(elapsed)


def scaling(arguments: Arguments) -> None:
    """Times with 1, 2 and 4 ranks, in turns."""
    rows = []
    repeats = 1 if arguments.quick else arguments.repeats
    for kind in ("frequencies", "crack lengths"):
        times: dict[object, list[float]] = {ranks: [] for ranks in (*RANKS, "apart")}
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(repeats):
                for ranks in RANKS:
                    times[ranks].append(clocked([launched(ranks, kind, arguments.quick, folder)]))
                pair = [launched(1, kind, arguments.quick, folder) for _ in range(2)]
                times["apart"].append(clocked(pair))
        turns = {ranks: np.array(values) for ranks, values in times.items()}
        for ranks in RANKS:
            gain = turns[1] / turns[ranks]
            of_machine = np.median(turns["apart"] / turns[ranks] / 2.0) if ranks == 2 else np.nan
            rows.append(
                [
                    kind, ranks, np.median(turns[ranks]), np.median(gain), gain.max(),
                    np.median(gain) / min(ranks, 2), of_machine,
                    " ".join(f"{value:.1f}" for value in turns[ranks]),
                ]
            )  # fmt: skip
        rows.append(
            [kind, "1 + 1 apart", np.median(turns["apart"]), *([np.nan] * 4),
             " ".join(f"{value:.1f}" for value in turns["apart"])]
        )  # fmt: skip
    save_table(
        arguments.folder / "sweep_scaling.csv",
        "Sweep of the breathing plate, H = 10, two cores; efficiency by the cores",
        ["sweep", "ranks", "seconds", "speed-up", "best", "efficiency", "of the machine", "turns"],
        rows,
    )


def chunks(arguments: Arguments) -> None:
    """Cost of a case from the linear solution and from its neighbour, and of chunks of cases."""
    rows = []
    for name, stiffness, ratio in (
        ("paper_plate", 1e9, 0.01),
        ("paper_plate", 1e11, 0.01),
        ("breathing_plate", 1e9, 0.01),
        ("breathing_plate", 1e9, 0.001),
    ):
        changes = CHANGES | {"contact.stiffness": stiffness, "damping.ratio": ratio}
        if name == "paper_plate":
            changes |= {"damping.modes": "all", "crack.length": 0.05}
        scene = fc.Scene.load(DEMOS / f"{name}.toml").replace(changes)
        plate = fc.prepare(scene).structure
        assert scene.contact is not None
        law, last, others = fc.contact_law(scene.contact, plate), None, 0
        times: dict[str, list[float]] = {"cold": [], "near": []}
        for omega in np.linspace(1000.0, 4000.0, 16 if arguments.quick else 61):
            found = []
            for start, initial in (("cold", None), ("near", last)):
                started = time.process_time()
                found.append(
                    fc.solve_harmonic_balance(
                        plate, float(omega), law, harmonics=10, initial=initial
                    )
                )
                times[start].append(time.process_time() - started)
            cold, last = found
            difference = np.abs(cold.gap_coefficients - last.gap_coefficients).max()
            others += bool(difference > 1e-6 * np.abs(cold.gap_coefficients).max())
        cold_time, near_time = (1e3 * np.mean(values) for values in times.values())
        lengths = [(cold_time + (n - 1) * near_time) / n / near_time for n in (4, 8, 12, 16)]
        rows.append(
            [name, stiffness, ratio, cold_time, near_time, cold_time / near_time, others, *lengths]
        )
    save_table(
        arguments.folder / "sweep_chunks.csv",
        "Mean processor time of a case [ms], 1000 to 4000 rad/s in steps of 50, H = 10; "
        "chunks of n: relative to one long chunk",
        ["plate", "k [N/m]", "damping", "cold", "neighbour", "ratio", "other solution",
         "n = 4", "8", "12", "16"],
        rows,
    )  # fmt: skip


def cases(arguments: Arguments) -> None:
    """Cost of a case of a frequency sweep as the sweep solves it, and each by itself from its
    neighbour, in turns of up to 16."""
    rows = []
    for name in ("paper_plate", "breathing_plate"):
        scene = scene_of("frequencies", arguments.quick)
        if name == "paper_plate":
            changes = CHANGES | {"contact.stiffness": 1e9, "damping.modes": "all"}
            paper = fc.Scene.load(DEMOS / f"{name}.toml").replace(changes | {"crack.length": 0.05})
            scene = dataclasses.replace(paper, sweep=scene.sweep)
        plan, times, others = Plan(scene), np.zeros(2), 0
        asked = sweep_case.Asked(unit_loads=False)
        geometry = sweep_case.build(plan.case((0,)), MPI.COMM_SELF, asked)
        for chunk in map(plan.chunk, plan.geometries[0]):
            found = []
            for number, solve in enumerate((by_itself, sweep_case.solve_chunk)):
                started = time.process_time()
                found.append(solve(geometry, chunk, asked))
                times[number] += time.process_time() - started
            for one, other in zip(*found, strict=True):
                difference = np.abs(one["gap"] - other["gap"]).max()
                others += bool(difference > 1e-6 * np.abs(one["gap"]).max())
        each = 1e3 * times / plan.shape[0]
        rows.append([name, plan.shape[0], *each, each[0] / each[1], others])
    save_table(
        arguments.folder / "sweep_cases.csv",
        "Mean processor time of a case with errors and verdict [ms], 1000 to 4000 rad/s, H = 10",
        ["plate", "frequencies", "by itself", "in a sweep", "ratio", "other solution"],
        rows,
    )


def by_itself(
    geometry: sweep_case.Geometry, chunk: Chunk, asked: sweep_case.Asked
) -> list[sweep_case.Found]:
    """The cases of a chunk by single solutions, each from its neighbour or, if that fails, from the
    linear solution."""
    found: list[sweep_case.Found] = []
    last: fc.PeriodicSolution | None = None
    for case in chunk.cases:
        structure = geometry.of_case(case)
        law, omega = law_of(case, structure), case.excitation.omega
        try:
            last = fc.solve_harmonic_balance(structure, omega, law, harmonics=10, initial=last)
        except fc.ConvergenceError:
            last = fc.solve_harmonic_balance(structure, omega, law, harmonics=10)
        if asked.verdicts:
            fc.floquet(structure, last)
        found.append(last.to_dict() | {"gap": last.gap_coefficients})
    return found


if __name__ == "__main__":
    if sys.argv[1:2] == ["worker"]:
        worker(*sys.argv[2:5])
    else:
        run(
            __doc__,
            {"chunks": chunks, "scaling": scaling, "cases": cases},
            repeats={"type": int, "default": 5, "help": "turns"},
        )
