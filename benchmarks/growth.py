"""How set-up time, memory and the cost of one more frequency grow with the mesh.

The plate of ``demos/breathing_plate.toml`` (quadratic quadrilaterals, graded towards the tip of a
crack of 42.84 mm, the lowest 30 modes damped) on three meshes: about 4, 46 and 212 thousand dofs;
once with lips as fine as the mesh, once with nine elements along each lip, so that there are
equally many pairs. Each is run in a process of its own: meshing and assembly, modes,
``reduce_structure(modes=30)``, one harmonic-balance solution on the reduced structure (H = 5,
2000 rad/s, 4.2e11 N/m of contact stiffness per m^2 of lip, which is 1e9 N/m a pair on the coarse
mesh), and one more frequency from it (2010 rad/s, mean of five). Peak memory is the process's
(``ru_maxrss``) after each stage. Clock and processor times are both given. The factorisations wait
for nothing, so their difference is due to other work on the machine.

    OMP_NUM_THREADS=1 python benchmarks/growth.py [--quick] [folder]
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.draw.figure import COLOURS
from fenics_crack.model.modes import damped_modes

MODES = 30
PER_AREA = 4.2e11  # N/m^3
MESHES = {
    "lips as fine as the mesh": [(0.0076, 9, 4.0), (0.00225, 31, 4.0), (0.00104, 65, 4.0)],
    "nine elements along a lip": [(0.0076, 9, 4.0), (0.0013, 9, 12.5), (0.00057, 9, 35.0)],
}
"""Element size away from the crack [m], elements along a lip, grading."""
STAGES = ("mesh and matrices", "modes", "reduction", "first solution", "one more frequency")


def main() -> None:
    """Run every mesh, or one."""
    option = {"help": "run one mesh (JSON) and print its figures as JSON"}
    common.run(__doc__, {"meshes": run_meshes}, mesh=option)


def run_meshes(arguments: common.Arguments) -> None:
    """Run every mesh in its own process and collect."""
    if arguments.mesh:
        json.dump(measure(*json.loads(arguments.mesh)), sys.stdout)
        return
    columns = (
        "meshes", "dofs", "pairs", "coordinates", *(f"{stage} [s]" for stage in STAGES),
        "set-up [s]", "set-up on the clock [s]", "peak memory [MB]", "after set-up [MB]",
        "iterations", "reduction error", "truncation error", "converged",
    )  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for name, meshes in MESHES.items():
        for mesh in meshes[: 1 + (meshes[1][1] == 9)] if arguments.quick else meshes:
            command = [sys.executable, __file__, "--mesh", json.dumps(mesh), str(arguments.folder)]
            finished = subprocess.run(command, capture_output=True, text=True, check=True)
            found = json.loads(finished.stdout.splitlines()[-1])
            stages = [found["processor"][stage] for stage in STAGES]
            rows.append(
                (
                    name,
                    found["dofs"],
                    found["pairs"],
                    found["coordinates"],
                    *stages,
                    sum(stages[:3]),
                    sum(found["clock"][stage] for stage in STAGES[:3]),
                    found["memory"][STAGES[-1]],
                    found["memory"]["reduction"],
                    found["iterations"],
                    found["reduction"],
                    found["truncation"],
                    found["converged"],
                )
            )
            print(f"{found['dofs']} dofs, {found['pairs']} pairs done", flush=True)
    common.print_table(
        "Growth with the mesh: processor times, one thread", [c.split(" [")[0] for c in columns],
        rows,
    )  # fmt: skip
    common.write_csv(arguments.folder / "growth.csv", columns, rows)
    draw(rows, arguments.folder / "growth.png")


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

    def stage(name: str, function: Any, repeats: int = 1) -> Any:
        before = time.perf_counter(), time.process_time()
        for _ in range(repeats):
            result = function()
        clock[name] = (time.perf_counter() - before[0]) / repeats
        processor[name] = (time.process_time() - before[1]) / repeats
        memory[name] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        return result

    tiny = {"mesh.size": 0.03, "mesh.lip_elements": 2, "damping.modes": 3}
    fc.build_structure(scene.replace(tiny))  # compiles the forms, once for all meshes
    plate = stage(STAGES[0], lambda: fc.build_structure(scene))
    stage(STAGES[1], lambda: damped_modes(plate))
    reduced = stage(STAGES[2], lambda: fc.reduce_structure(plate, modes=MODES))
    assert plate.pair_areas is not None
    law = fc.UnilateralPenalty(PER_AREA * plate.pair_areas)

    def solve(omega: float, initial: fc.PeriodicSolution | None) -> fc.PeriodicSolution:
        return fc.solve_harmonic_balance(
            reduced, omega, law, harmonics=5, initial=initial, throw=False
        )

    first = stage(STAGES[3], lambda: solve(2000.0, None))
    start = first if first.converged else None
    more = stage(STAGES[4], lambda: solve(2010.0, start), repeats=5)
    return {
        "dofs": plate.n_dofs,
        "pairs": plate.n_pairs,
        "coordinates": reduced.n_dofs,
        "clock": clock,
        "processor": processor,
        "memory": memory,
        "iterations": first.iterations,
        "reduction": first.report.reduction,
        "truncation": first.report.truncation,
        "converged": bool(first.converged and more.converged),
    }


def draw(rows: list[tuple[Any, ...]], path: Path) -> None:
    """Times over dofs, one panel for each set of meshes; memory in a third."""
    names = list(MESHES)
    figure, panels = common.figure(3)
    for axes, name in zip(panels, names, strict=False):
        chosen = [row for row in rows if row[0] == name]
        dofs = [row[1] for row in chosen]
        looks = zip(STAGES, COLOURS.values(), ("o-", "s--", "^:", "D-.", "v-"), strict=True)
        for index, (stage, colour, look) in enumerate(looks):
            axes.loglog(
                dofs, [row[4 + index] for row in chosen], look, color=colour, ms=5, label=stage
            )
        axes.set_xlabel("degrees of freedom [-]")
        axes.set_ylabel("processor time [s]")
        pairs = ", ".join(str(row[2]) for row in chosen)
        axes.set_title(f"{name}: {pairs} pairs", fontsize=10)
        axes.legend(fontsize=7)
    axes = panels[2]
    for name, colour, look in zip(names, ("blue", "orange"), ("o-", "s--"), strict=True):
        chosen = [row for row in rows if row[0] == name]
        axes.semilogx(
            [row[1] for row in chosen], [row[11] / 1024.0 for row in chosen], look,
            color=COLOURS[colour], label=name,
        )  # fmt: skip
    limit = np.array(axes.get_xlim())
    axes.semilogx(limit, [4.0, 4.0], ":", color=COLOURS["grey"], label="goal: 4 GB")
    axes.set_xlim(limit)
    axes.set_ylim(0.0, 4.5)
    axes.set_xlabel("degrees of freedom [-]")
    axes.set_ylabel("peak memory of the process [GB]")
    axes.set_title("Memory", fontsize=10)
    axes.legend(fontsize=8)
    figure.savefig(path)


if __name__ == "__main__":
    main()
