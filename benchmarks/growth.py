"""How set-up time, memory and the cost of one more frequency grow with the mesh.

The plate of ``demos/breathing_plate.toml`` (quadratic quadrilaterals, graded towards the tip of a
crack of 42.84 mm, the lowest 30 modes damped) on four meshes, from 4 thousand to a million dofs;
once with lips as fine as the mesh, once with nine elements along each lip, so that there are
equally many pairs. Each is run in a process of its own: meshing and assembly,
``reduce_structure(modes=30, method="massless")`` with its modes, one harmonic-balance solution on
the reduced structure (H = 5, 2000 rad/s, 4.2e11 N/m of contact stiffness per m^2 of lip, which is
1e9 N/m a pair on the coarse mesh), and one more frequency from it (2010 rad/s). Peak memory is the
process's (``ru_maxrss``). Clock and processor times are both given. The factorisations wait for
nothing, so their difference is due to other work on the machine.

The goal is the mesh of a million dofs with 280 pairs: set-up below 5 minutes and 12 GiB, first
solution below 10 s, one more frequency below 1 s. ``--only`` runs one of the sets of meshes.

    OMP_NUM_THREADS=1 python benchmarks/growth.py [--quick] [--only SET] [folder]
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import common

import fenics_crack as fc
from fenics_crack.draw.figure import COLOURS

MODES = 30
PER_AREA = 4.2e11  # N/m^3
FINE, FEW, MILLION = "lips as fine as the mesh", "nine elements along a lip", "million"
MESHES = {
    FINE: [(0.0076, 9, 4.0), (0.00225, 31, 4.0), (0.00104, 65, 4.0)],
    FEW: [(0.0076, 9, 4.0), (0.0013, 9, 12.5), (0.00057, 9, 35.0)],
    MILLION: [(0.00048, 140, 4.0)],
}
"""Element size away from the crack [m], elements along a lip, grading."""
STAGES = ("mesh and matrices", "reduction", "first solution", "one more frequency")


def main() -> None:
    """Run every mesh, or one."""
    option = {"help": "run one mesh (JSON) and print its figures as JSON"}
    parts = {"fine": partial(run_meshes, FINE), "few": partial(run_meshes, FEW)}
    common.run(__doc__, parts | {"million": partial(run_meshes, MILLION)}, mesh=option)


def run_meshes(name: str, arguments: common.Arguments) -> None:
    """Run every mesh of a set in its own process and collect."""
    if arguments.mesh:
        json.dump(measure(*json.loads(arguments.mesh)), sys.stdout)
        sys.exit()
    if arguments.quick and name == MILLION:
        return
    columns = (
        "dofs", "pairs", *(f"{stage} [s]" for stage in STAGES), "set-up [s]",
        "set-up on the clock [s]", "peak memory [MiB]", "after set-up [MiB]",
        "iterations", "reduction error", "truncation error", "converged",
    )  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for mesh in MESHES[name][: 1 + (name == FEW)] if arguments.quick else MESHES[name]:
        command = [sys.executable, __file__, "--mesh", json.dumps(mesh), str(arguments.folder)]
        finished = subprocess.run(command, capture_output=True, text=True, check=True)
        found = json.loads(finished.stdout.splitlines()[-1])
        stages = [found["processor"][stage] for stage in STAGES]
        rows.append(
            (
                found["dofs"],
                found["pairs"],
                *stages,
                sum(stages[:2]),
                sum(found["clock"][stage] for stage in STAGES[:2]),
                found["memory"][STAGES[-1]],
                found["memory"]["reduction"],
                found["iterations"],
                found["reduction"],
                found["truncation"],
                found["converged"],
            )
        )
        print(f"{found['dofs']} dofs, {found['pairs']} pairs done", flush=True)
    title = f"Growth with the mesh, {name}: processor times, one thread"
    common.print_table(title, [c.split(" [")[0] for c in columns], rows)
    file = f"growth_{name.split()[0]}"
    common.write_csv(arguments.folder / f"{file}.csv", columns, rows)
    if name != MILLION:
        draw(name, rows, arguments.folder / f"{file}.png")


def measure(size: float, lip_elements: int, grading: float) -> dict[str, Any]:
    """All stages on one mesh."""
    scene = fc.Scene.load(common.DEMOS / "breathing_plate.toml").replace(
        {
            "crack.length": 0.04284,
            "crack.first_omega": None,
            "damping.modes": MODES,
            "mesh.size": size,
            "mesh.lip_elements": lip_elements,
            "mesh.grading": grading,
        }
    )
    clock: dict[str, float] = {}
    processor: dict[str, float] = {}
    memory: dict[str, float] = {}

    def stage(name: str, function: Any) -> Any:
        before = time.perf_counter(), time.process_time()
        result = function()
        clock[name] = time.perf_counter() - before[0]
        processor[name] = time.process_time() - before[1]
        memory[name] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        return result

    tiny = {"mesh.size": 0.03, "mesh.lip_elements": 2, "damping.modes": 3}
    fc.build_structure(scene.replace(tiny))  # compiles the forms, once for all meshes
    plate = stage(STAGES[0], lambda: fc.build_structure(scene))
    reduced = stage(STAGES[1], lambda: fc.reduce_structure(plate, modes=MODES, method="massless"))
    assert plate.pair_areas is not None
    law = fc.UnilateralPenalty(PER_AREA * plate.pair_areas)

    def solve(omega: float, initial: fc.PeriodicSolution | None) -> fc.PeriodicSolution:
        return fc.solve_harmonic_balance(
            reduced, omega, law, harmonics=5, initial=initial, throw=False
        )

    first = stage(STAGES[2], lambda: solve(2000.0, None))
    start = first if first.converged else None
    more = stage(STAGES[3], lambda: solve(2010.0, start))
    return {
        "dofs": plate.n_dofs,
        "pairs": plate.n_pairs,
        "clock": clock,
        "processor": processor,
        "memory": memory,
        "iterations": first.iterations,
        "reduction": first.report.reduction,
        "truncation": first.report.truncation,
        "converged": bool(first.converged and more.converged),
    }


def draw(name: str, rows: list[tuple[Any, ...]], path: Path) -> None:
    """Times over dofs, and memory in a second panel."""
    figure, panels = common.figure(2)
    axes, dofs = panels[0], [row[0] for row in rows]
    looks = zip(STAGES, COLOURS.values(), ("o-", "s--", "^:", "D-."), strict=False)
    for index, (stage, colour, look) in enumerate(looks):
        times = [row[2 + index] for row in rows]
        axes.loglog(dofs, times, look, color=colour, ms=5, label=stage)
    axes.set_xlabel("degrees of freedom [-]")
    axes.set_ylabel("processor time [s]")
    pairs = ", ".join(str(row[1]) for row in rows)
    axes.set_title(f"{name}: {pairs} pairs", fontsize=10)
    axes.legend(fontsize=7)
    axes = panels[1]
    memory = [row[8] / 1024.0 for row in rows]
    axes.loglog(dofs, memory, "o-", color=COLOURS["blue"])
    axes.set_xlabel("degrees of freedom [-]")
    axes.set_ylabel("peak memory of the process [GiB]")
    axes.set_title("Memory", fontsize=10)
    figure.savefig(path)


if __name__ == "__main__":
    main()
