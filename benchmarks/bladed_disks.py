"""Bladed disks: what they cost, how near the whole wheel they are, and patterns of mistuning.

The ring has blades of 80 x 12 mm in plane stress on a rim of radii 50 and 100 mm, with a crack of
4 mm at 12 mm above the rim; xi = 0.2 %. The solid sector is a blade of 20 x 120 x 8 mm on a rim of
150 and 180 mm, with a crack of 6 mm through its thickness.

sizes       times with N = 12, 24 and 40 sectors, 3 families: the reduction, a second pattern, a
            solution with its errors and verdict, curves with harmonics and of exact orbits
families    1 to 4 families against the whole wheel with as many modes, and with 12 of each sector
patterns    1,000 patterns of 1 % without a crack
breathing   200 patterns with the crack at the resonance of its blade; 10 of them against the whole
            wheel with 12 modes of each sector
solid       a solid sector of 9,000 dofs, N = 24
large       one of 31,400 dofs and 25 pairs

    OMP_NUM_THREADS=1 python benchmarks/bladed_disks.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from typing import Any

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.model.reduction import reduce_structure

RING = fc.Scene.from_text("""
geometry = { width = 0.012, height = 0.08, thickness = 0.02 }
material = { young = 2.1e11, poisson = 0.3, density = 7800.0 }
damping = { ratio = 0.002 }
crack = { edge = "left", height = 0.012, length = 0.004 }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.006, lip_elements = 4, error = false }
excitation = { order = 2, frequency = 1275.0, point = [0.0, 0.08], force_cos = [1.0, 0.0] }
disk.sectors = 12
disk.inner_radius = 0.05
disk.outer_radius = 0.1
disk.deviation = 0.01
disk.seed = 3
""")
SOLID = fc.Scene.from_text("""
geometry = { kind = "solid", width = 0.02, height = 0.12, thickness = 0.008 }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
crack = { edge = "left", height = 0.006, length = 0.006 }
contact = { law = "unilateral" }
mesh = { layout = "graded", size = 0.0064, lip_elements = 2, error = false }
excitation = { order = 3, frequency = 430.0, point = [0.01, 0.12, 0.004], force_cos = [0, 0, 1.0] }
disk.sectors = 24
disk.inner_radius = 0.15
disk.outer_radius = 0.18
disk.deviation = 0.01
disk.seed = 3
""")
LAW = fc.UnilateralConstraint()
HARMONICS = 20
MANY = 12
"""Modes of each sector of the whole wheels that others are held against."""


def main() -> None:
    """Run it."""
    parts = {
        "sizes": sizes, "families": families, "patterns": patterns, "breathing": breathing,
        "solid": solid, "large": large,
    }  # fmt: skip
    common.run(__doc__, parts)


def _save(
    arguments: common.Arguments, name: str, columns: Sequence[str], rows: Sequence[common.Row]
) -> None:
    common.save_table(arguments.folder / f"{name}.csv", name, columns, rows)


def wheel_of(scene: fc.Scene) -> fc.Wheel:
    """The whole wheel."""
    structure = fc.build_structure(scene)
    assert isinstance(structure, fc.Wheel)
    return structure


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """What a function returns, and its processor time [s]."""
    start = time.process_time()
    return function(), time.process_time() - start


def with_errors(reduced: fc.Structure, hertz: float) -> fc.PeriodicSolution:
    """A solution with its errors and its verdict."""
    solution = fc.solve_harmonic_balance(reduced, 2.0 * np.pi * hertz, LAW, harmonics=HARMONICS)
    fc.floquet(reduced, solution)
    assert solution.report.total < 1.0
    return solution


def costs(scene: fc.Scene, hertz: tuple[float, float]) -> list[object]:
    """Sizes and times of a wheel, and of a curve through its first family."""
    wheel, assembly_time = timed(lambda: wheel_of(scene))
    reduced_wheel, reduction_time = timed(lambda: fc.reduce_wheel(wheel))
    other_wheel = wheel.mistuned(np.random.default_rng(1).normal(0.0, 0.01, wheel.sector.n_sectors))
    _, repeat_time = timed(lambda: fc.reduce_wheel(other_wheel))
    with_errors(reduced_wheel, hertz[0])
    _, solution = timed(lambda: with_errors(reduced_wheel, 1.01 * hertz[0]))
    ends = (2.0 * np.pi * hertz[0], 2.0 * np.pi * hertz[1])
    curve, curve_time = timed(
        lambda: fc.continue_frequency(reduced_wheel, *ends, LAW, harmonics=10)
    )
    _, verdict_time = timed(lambda: fc.judge_curve(curve))
    orbits, exact = timed(lambda: fc.continue_frequency(reduced_wheel, *ends, LAW, tolerance=0.01))
    return [
        wheel.sector.n_sectors, wheel.sector.structure.n_dofs, reduced_wheel.n_modes,
        assembly_time, reduction_time,
        repeat_time, solution, len(curve.omega), curve_time, verdict_time, len(orbits.omega), exact,
    ]  # fmt: skip


COSTS = (
    "sectors", "dofs of one", "modes", "mesh s", "reduction s", "another pattern s", "solution s",
    "points", "curve s", "verdicts s", "points of orbits", "curve of orbits s",
)  # fmt: skip


def sizes(arguments: common.Arguments) -> None:
    """Plane wheels."""
    counts = (12,) if arguments.quick else (12, 24, 40)
    rows = []
    for count in counts:
        outer_radius = max(0.1, 0.0035 * count)  # room for all blades
        changes = {"disk.sectors": count, "disk.outer_radius": outer_radius, "excitation.order": 3}
        rows.append(costs(RING.replace(changes), (1240.0, 1420.0)))
    _save(arguments, "bladed_disk_sizes", COSTS, rows)


def difference(
    reduced: fc.Structure, whole: fc.Structure, hertz: float, tips: list[int]
) -> tuple[float, float, float, float]:
    """Relative differences of the gap, of the worst whole blade and of the cracked one, and the
    stated error of the gap by the reduction."""
    own_solution, exact = (with_errors(one, hertz) for one in (reduced, whole))
    motion, exact_motion = (
        one.structure.values_at(one.displacement_coefficients, tips)[1:]
        for one in (own_solution, exact)
    )
    off = np.linalg.norm(motion - exact_motion, axis=0) / np.linalg.norm(exact_motion, axis=0)
    gap = np.linalg.norm(own_solution.gap_coefficients - exact.gap_coefficients)
    size = np.linalg.norm(exact.gap_coefficients)
    return float(gap / size), float(off[1:].max()), float(off[0]), own_solution.report.reduction


def families(arguments: common.Arguments) -> None:
    """Families against the whole wheel."""
    wheel = wheel_of(RING.replace({"excitation.order": 3, "mesh.size": 0.012}))
    tips, count = wheel.dofs_of_blades(wheel.watched_dof), wheel.sector.n_sectors
    rows: list[list[object]] = []
    reference_structure = reduce_structure(
        wheel, modes=MANY * count, method="massless", reference=False
    )
    for n_families in (3,) if arguments.quick else (1, 2, 3, 4):
        reduced_wheel = fc.reduce_wheel(wheel, n_families)
        same_size_structure = reduce_structure(
            wheel, modes=n_families * count, method="massless", reference=False
        )
        for hertz in (1260.0, 1290.0, 1340.0, 1376.0):
            alike, exact = (
                difference(reduced_wheel, structure, hertz, tips)
                for structure in (same_size_structure, reference_structure)
            )
            rows.append([n_families, hertz, *alike[:3], *exact])
    names = (
        "families", "Hz", "gap", "whole blades", "cracked blade", "gap, 12 modes", "whole, 12",
        "cracked, 12", "stated of the gap",
    )  # fmt: skip
    _save(arguments, "bladed_disk_families", names, rows)


def patterns(arguments: common.Arguments) -> None:
    """Mistuning without a crack."""
    count = 100 if arguments.quick else 1000
    scene = RING.replace({"excitation.frequency": 1386.0})
    amplification, spent = timed(lambda: fc.amplification(scene, count, 0.01))
    shares = (5.0, 50.0, 95.0, 99.0, 100.0)
    row = [
        count,
        spent,
        amplification.bound,
        *(amplification.percentile(share) for share in shares),
    ]
    names = ("patterns", "s", "bound", "5 %", "50 %", "95 %", "99 %", "largest")
    _save(arguments, "bladed_disk_patterns", names, [row])
    fc.draw_amplification(amplification, path=arguments.folder / "bladed_disk_amplification.png")


def breathing(arguments: common.Arguments) -> None:
    """Mistuning with a crack, at the resonance of its blade."""
    count, held = (10, 2) if arguments.quick else (200, 10)
    seeds = list(range(1, count + 1))
    over = {"sweep.over": {"disk.seed": seeds}, "sweep.at_resonance": True}
    balance = {"harmonic_balance.tolerance": 0.01}
    scene = RING.replace(over | balance)
    sweep, spent = timed(lambda: fc.run_sweep(scene, arguments.folder / "bladed_disk_sweep.h5"))
    response, stated_errors = sweep["response"], sweep.error_parts
    row = [
        count, spent, response.min(), np.median(response), response.max(), np.nanmax(stated_errors),
        int(np.sum(sweep.converged)), int(np.sum(sweep["verdict"] == "stable")),
    ]  # fmt: skip
    names = ("patterns", "s", "least m", "median m", "largest m", "largest error", "converged",
             "stable")  # fmt: skip
    _save(arguments, "bladed_disk_breathing", names, [row])
    wheel, rows = wheel_of(RING), []
    for place in np.linspace(0, count - 1, held).astype(int):
        own = RING.replace({"disk.seed": seeds[place]})
        pattern = wheel.mistuned(own.given("disk").deviations)
        many_structure = reduce_structure(
            pattern, modes=MANY * pattern.sector.n_sectors, method="massless", reference=False
        )
        solution = sweep.solution(int(place))
        exact = fc.solve_harmonic_balance(many_structure, solution.omega, LAW, harmonics=60)
        time_of = solution.period / 1000.0 * np.arange(1000)
        gap, exact_gap = (motion.gap(time_of) for motion in (solution, exact))
        error = np.linalg.norm(gap - exact_gap) / np.linalg.norm(exact_gap)
        size = solution.amplitude(wheel.watched_dof) / exact.amplitude(wheel.watched_dof)
        stated_total = solution.report.total
        rows.append(
            [
                seeds[place],
                solution.omega / (2.0 * np.pi),
                error,
                stated_total,
                error / stated_total,
                size - 1.0,
            ]
        )
    names = ("seed", "Hz", "gap", "stated", "over stated", "amplitude")
    _save(arguments, "bladed_disk_whole", names, rows)


def solid(arguments: common.Arguments) -> None:
    """A solid sector of 9,000 dofs."""
    _save(arguments, "bladed_disk_solid", COSTS, [costs(SOLID, (420.0, 450.0))])
    _say_memory()


def large(arguments: common.Arguments) -> None:
    """A solid sector of 31,400 dofs; not with --quick."""
    if arguments.quick:
        return
    scene = SOLID.replace({"mesh.size": 0.0035, "mesh.lip_elements": 3})
    _save(arguments, "bladed_disk_large", COSTS, [costs(scene, (420.0, 450.0))])
    _say_memory()


def _say_memory() -> None:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # of KiB
    print(f"largest memory of the process: {peak:.2f} GiB")


if __name__ == "__main__":
    main()
