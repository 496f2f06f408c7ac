"""What the numbers of an answer owe to its modes, harmonics and mesh, by one other run for each.

Twice the modes and twice the harmonics are solved from the answer itself, and

    e = |f - f_2| / (1 - 2^-1),

as both converge like N^-1 (:mod:`refinement`). The mesh is made coarser (:mod:`coarser_mesh`).

A mesh moves the resonances before all else. Next to one a small shift changes an answer by much, on
one side up and on the other down, so that differences may vanish by chance. The coarse mesh is
therefore solved at w w_r / w_b, as far from its resonance w_r as the answer is from its own, w_b,
and what the shift changes is solved for on the answer's mesh, at w w_b / w_e, w_e being the
extrapolated resonance. Both have a sign and are added; but neither is known better than its order
p, which lies between that of a tip and that of a clamp, 1 and 1.5:

    e = max over p, q of |(f - f_r) / (r^p - 1) + f(w w_b / w_e(q)) - f|,

so that what cancels leaves its uncertainty. The root of the sum of the squares of all causes is
stated. These are errors that are expected, not bounds: scenes beside a mesh four times finer are in
docs/error_report.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from fenics_crack.scene.quantities import OF_LIPS, OF_POINTS, OF_TIPS, QUANTITIES
from fenics_crack.study.coarser_mesh import (
    CLAMP,
    TIP,
    coarser,
    errors_of_natural,
    expected,
    natural_name,
)
from fenics_crack.study.grid_convergence import GridConvergence
from fenics_crack.study.prepare import REFUSALS, Study, modes_of
from fenics_crack.study.tips import numbers_of_motion
from fenics_crack.study.verification import Verification
from fenics_crack.table import frequency_axis

__all__ = ["Numbers", "errors_of", "numbers_of", "resonance_of", "shifted", "stated_errors"]

ANSWER = ("amplitude", "ratio_2_1", "ratio_3_1", "mean_shift", "opening", "closed_share")
"""Quantities that are looked at where the scene does not choose."""
LOWEST = (1, 2, 3)
"""Modes whose natural frequencies with lips open are looked at."""
TINY = 1e-9
"""A ratio that is none."""
ORDERS = CLAMP, TIP
"""Between which that of a mesh is, the one that corrects less first."""


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
    if scene.tip_quantities:
        at_tips = numbers_of_motion(study, found)
        values |= {name: at_tips[name] for name in scene.tip_quantities}
        units |= {name: OF_TIPS[name][1] for name in scene.tip_quantities}
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
            parts = expected(cause, counts, own.values, values, study.scene.dimension)
            if cause == "mesh" and not of_peak:
                parts = _with_shift(study, near, own, parts)
            stated.counts[cause], stated.parts[cause] = counts, parts
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


def _with_shift(
    study: Study, near: PeriodicSolution, own: Numbers, parts: Mapping[str, GridConvergence]
) -> dict[str, GridConvergence]:
    """The mesh's parts of the numbers of a solution with what the shift of the resonance changes:
    the most by any order of either."""
    fine, coarse = parts[own.resonance].sizes
    left = [1.0 / ((coarse / fine) ** order - 1.0) for order in ORDERS]
    at, there = parts[own.resonance].values
    moved = shifted(study, near, own.mode, [at / (at + share * (at - there)) for share in left])
    found = {}
    for name, part in parts.items():
        value, other = part.values
        errors = [
            share * (value - other) + values.get(name, 0.0) - value
            for share in left
            for values in moved
        ]
        found[name] = replace(part, extrapolated=value + max(errors, key=abs))
    return found


def shifted(
    study: Study, near: PeriodicSolution, mode: int, factors: Sequence[float]
) -> list[dict[str, float]]:
    """The numbers at other frequencies, each by a factor of a solution's, and sought from the one
    before (collective)."""
    found, moved = near, []
    for factor in factors:
        found = _solved(study, near.omega * factor, near.harmonics, found)
        moved.append(numbers_of(study, found, mode).values)
    return moved


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
