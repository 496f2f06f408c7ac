"""What the numbers of an answer owe to its modes, harmonics and mesh, by one other run for each.

Twice the modes and twice the harmonics are solved from the answer itself, and

    e = |f - f_2| / (1 - 2^-1),

as both converge like N^-1 (:mod:`refinement`). The mesh is made coarser (:mod:`coarser_mesh`).

A mesh moves the resonances before all else. Next to one a small shift changes an answer by much, on
one side up and on the other down, so that differences may vanish by chance. The coarse mesh is
therefore solved at w w_r / w_b, as far from its resonance w_r as the answer is from its own, w_b;
and what the shift changes is the most by which the answer does up to the frequency w w_b / w_e, w_e
being the extrapolated resonance. The mesh's part is the sum of both. All are errors that are
expected, not bounds: ten scenes beside a mesh four times finer are in docs/error_report.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.balance.harmonic_balance import solve_linear
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.model.bilinear import KINDS, bilinear_frequencies
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import Modes
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.structure import Structure
from fenics_crack.scene.quantities import OF_LIPS, OF_POINTS, QUANTITIES
from fenics_crack.study.coarser_mesh import coarser, errors_of_natural, expected, natural_name
from fenics_crack.study.grid_convergence import GridConvergence
from fenics_crack.study.prepare import REFUSALS, Study, modes_of
from fenics_crack.study.verification import Verification
from fenics_crack.table import frequency_axis

__all__ = ["Numbers", "carried", "errors_of", "numbers_of", "resonance_of", "stated_errors"]

ANSWER = ("amplitude", "ratio_2_1", "ratio_3_1", "mean_shift", "opening", "closed_share")
"""Quantities that are looked at where the scene does not choose."""
LOWEST = (1, 2, 3)
"""Modes whose natural frequencies with lips open are looked at."""
TINY = 1e-9
"""A ratio that is none."""
STEPS = 2
"""In which a shift is made."""


# --- the numbers of an answer ---------------------------------------------------------------------


@dataclass(frozen=True)
class Numbers:
    """The numbers of an answer.

    Attributes
    ----------
    values, units : dict of str to float, and to str
        As :class:`Verification` has them.
    resonance : str
        Which of them is the natural frequency nearest to the load's.
    mode : int
        Its mode.
    """

    values: dict[str, float]
    units: dict[str, str]
    resonance: str
    mode: int


def numbers_of(study: Study, found: PeriodicSolution, mode: int | None = None) -> Numbers:
    """What is asked for of the watched points and the lips, and natural frequencies: the lowest
    ones, and those of a mode, by default of the one with the nearest resonance (collective)."""
    scene, structure = study.scene, study.structure
    chosen = (scene.output.quantities if scene.output is not None else None) or ANSWER
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    for watched in study.watched:
        seen = found.indicators(watched.dof)
        for name in chosen:
            if name in OF_POINTS or name in OF_LIPS:
                column = watched.column(name) if name in OF_POINTS else name
                value, unit = float(getattr(seen, name)), QUANTITIES[name][1]
                if abs(value) > (TINY if unit == "1" else 0.0):
                    values[column], units[column] = value, unit.replace("1", "")
    natural = bilinear_frequencies(structure)
    mode = mode or int(natural.nearest(found.omega)["mode"])
    factor, _, unit = frequency_axis(scene.in_hertz)
    wanted = {("open", number) for number in (*LOWEST, mode)}
    if structure.n_pairs:
        wanted |= {("tied", mode), ("bilinear", mode)}
    for kind, number in sorted(wanted, key=lambda one: (KINDS.index(one[0]), one[1])):
        if number <= len(natural.omega_open):
            name, omega = natural_name(scene, kind, number), getattr(natural, f"omega_{kind}")
            values[name], units[name] = factor * float(omega[number - 1]), unit
    resonance = natural_name(scene, "bilinear" if structure.n_pairs else "open", mode)
    return Numbers(values, units, resonance, mode)


# --- one other run for each cause -----------------------------------------------------------------


def stated_errors(study: Study, found: PeriodicSolution, *, of_peak: bool = False) -> Verification:
    """The errors of a solution's numbers that are expected by modes, harmonics and mesh
    (collective).

    Parameters
    ----------
    study : Study
        Of the solution, reduced as it was.
    found : PeriodicSolution
        The answer.
    of_peak : bool
        Whether it is the largest of a curve over the frequency, which moves with the resonance.

    Returns
    -------
    Verification
        With ``absent`` or ``unknown``, and why, where a cause was not varied.
    """
    numbers = numbers_of(study, found)
    stated = Verification(study.scene, numbers.values, numbers.units, {}, {}, {}, {}, (), {})
    if not is_small(study.structure):  # three more solutions take three times as long
        stated.unknown.update(dict.fromkeys(VARIED, "the structure is not reduced"))
        return stated
    near = _solved(study, found.omega, found.harmonics, found)
    own = numbers_of(study, near, numbers.mode)
    for cause, other in VARIED.items():
        try:
            varied = other(study, near, own)
            if isinstance(varied, str):
                (stated.unknown if cause == "mesh" else stated.absent)[cause] = varied
                continue
            counts, values = varied
            stated.counts[cause], stated.parts[cause] = (
                counts,
                expected(cause, counts, own.values, values),
            )
            if cause == "mesh" and not of_peak:
                stated.counts["shift"] = counts
                stated.parts["shift"] = carried(study, near, own, stated.parts["mesh"])
        except REFUSALS as error:
            stated.unknown[cause] = str(error)
    return stated


def errors_of(study: Study, result: object) -> Verification | None:
    """The same of any result (collective): of a curve over the frequency that of its largest
    response; None of one that is not a vibration, or has not converged."""
    if isinstance(result, Modes):
        return errors_of_natural(study, {"open": result.omega})
    if isinstance(result, ResponseCurve) and result.parameter == "omega":
        largest = int(np.argmax(result.amplitude(study.watched[0].dof)))
        return stated_errors(study, result.solution(largest), of_peak=True)
    if isinstance(result, PeriodicSolution) and result.converged:
        return stated_errors(study, result)
    return None


Varied = tuple[tuple[int, int], Mapping[str, float]] | str
"""Counts, the answer's own first, and the other run's numbers; or why there are none."""


def _more_modes(study: Study, near: PeriodicSolution, own: Numbers) -> Varied:
    structure, table = study.structure, study.scene.reduction
    reference = structure.reference if isinstance(structure, ReducedStructure) else None
    if reference is None or table is None:
        return "all are kept"
    more = replace(study, structure=reference)
    start = near if structure.light_lips else None  # else these have other coordinates
    found = _solved(more, near.omega, near.harmonics, start)
    kept = modes_of(study.scene, table)
    return (kept, 2 * kept), numbers_of(more, found, own.mode).values


def _more_harmonics(study: Study, near: PeriodicSolution, own: Numbers) -> Varied:
    if study.contact is None:
        return "without contact there is one"
    count = near.harmonics
    found = _solved(study, near.omega, 2 * count, near)
    return (count, 2 * count), numbers_of(study, found, own.mode).values


def _coarser_mesh(study: Study, near: PeriodicSolution, own: Numbers) -> Varied:
    coarse = coarser(study)
    if isinstance(coarse, str):
        return coarse
    twin, counts = coarse
    shift = resonance_of(twin.structure, own.mode) / resonance_of(study.structure, own.mode)
    found = _solved(twin, near.omega * shift, near.harmonics)
    return counts, numbers_of(twin, found, own.mode).values


VARIED = {"modes": _more_modes, "harmonics": _more_harmonics, "mesh": _coarser_mesh}
"""What is varied, and by whom."""


def carried(
    study: Study, near: PeriodicSolution, own: Numbers, mesh: Mapping[str, GridConvergence]
) -> dict[str, GridConvergence]:
    """What the shift of the resonance changes of each number of a solution: the most at any within
    its uncertainty, as peaks may lie there, and where it is extrapolated to (collective)."""
    part, at = mesh[own.resonance], own.values[own.resonance]
    last = part.values[-1] == at
    known, error = math.isfinite(part.extrapolated), part.uncertainty(-1 if last else 0) / at
    softer = -1.0 if known and part.extrapolated > at else 1.0
    shifts = [(1.0 + step * error) ** softer for step in np.linspace(0.0, 1.0, STEPS + 1)[1:]]
    if known:
        shifts.append(at / part.extrapolated)
    moved, found = [], near
    for shift in shifts:
        found = _solved(study, near.omega * shift, near.harmonics, found)
        moved.append(numbers_of(study, found, own.mode).values)
    parts = {}
    for name, value in own.values.items():
        there = [values.get(name, 0.0) for values in moved]
        farthest = there[int(np.argmax(np.abs(np.subtract(there, value))))]
        parts[name] = GridConvergence(
            (part.sizes[0], part.sizes[-1]),
            (farthest, value) if last else (value, farthest),
            behaviour="carried",
            order=part.order,
            exponent=part.exponent,
            factor=1.0,
            extrapolated=there[-1] if known else math.nan,
        )
    return parts


def _solved(
    study: Study, omega: float, harmonics: int, initial: PeriodicSolution | None = None
) -> PeriodicSolution:
    """A solution of which neither errors nor stability are asked; ConvergenceError without."""
    if study.contact is None:
        return solve_linear(study.structure, omega, harmonics=harmonics)
    problem = Problem(study.structure, omega, study.contact, harmonics)
    return Solver(problem).solve(initial, reported=False)


def resonance_of(structure: Structure, mode: int) -> float:
    """Bilinear frequency of a mode [rad/s] (collective)."""
    return float(bilinear_frequencies(structure).omega_bilinear[mode - 1])
