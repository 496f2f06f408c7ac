"""Errors of a result's numbers due to its modes, harmonics and mesh, by one other run for each.

The reference of a reduced structure, which has more modes, is solved from the answer itself, and

    e = |f - f_ref| / share,

with the share that it has of what is left out: 1/2 of twice the modes, as it converges like N^-1
(:mod:`refinement`). To few harmonics the modes above all of them seem static, whether they are kept
or not: where an exact orbit is the answer's own, f and f_ref are those of orbits. The truncated
harmonics follow, too: e = |f - f_orbit|. Elsewhere twice as many are solved, too; where the report
says that harmonics are too few the difference may vanish by chance, and four times as many say it,
too. The mesh is made coarser (:mod:`coarser_mesh`).

A mesh moves the resonances before all else. Next to one a small shift changes an answer by much, on
one side up and on the other down, so that differences may vanish by chance, and at half a resonance
across a peak that is no wider than the shift: no number is extrapolated through it. The coarse mesh
is solved at w w_r / w_b, as far from its resonance w_r as the answer is from its own, w_b, and what
the shift changes is solved for on the answer's mesh, at w w_b / w_e, w_e being the extrapolated
resonance: wherever it may be, and each time from rest, as a finer mesh would be, where there may be
several motions. It is that of the mode whose shift changes the watched points the most
(:func:`_moving`): at half a resonance the second harmonic meets it, and another mode may be nearer
to the load. Both have a sign and are added. Their order p is that of tips, 1, or any up to the best
of the elements:

    e = max over p of |(f - f_r) / (r^p - 1) + f(w w_b / w_e(p)) - f|,

and a tenth of what could cancel is not known.

With a preload or a mean load a crack closes pair by pair, and where it is closed ends somewhere
between two pairs. Half a step of the gap from one to the next, times the part of the period for
which some touch and others do not, is not known of the clearance, whatever a coarse mesh of few
pairs says by chance; what it changes is solved for, too. The mesh changes low and high
harmonics equally: half of them show it.

The contact duty cycle is counted at instants, the same in all these runs. Its error is the distance
from that by the switching instants of the exact orbit; elsewhere one instant's part is added to
what harmonics leave out.

Without friction crack faces slide freely. What a coefficient of friction would change of a plate is
one of the causes: each number changes as between two exact orbits, without friction and with it, of
a structure of few modes whose crack faces have no mass, whatever the modes of the answer.

The root of the sum of the squares of all causes is stated. These are errors that are expected, not
bounds: scenes beside a mesh four times finer are in docs/notebook/stated_errors.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import methodcaller
from typing import Any

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR, ErrorReport
from fenics_crack.balance.harmonic_balance import solve_linear, wave_of
from fenics_crack.balance.more_modes import reference_of
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import MOST_HARMONICS
from fenics_crack.basics.observables import QUANTITIES, STATED, Place, names_of
from fenics_crack.basics.tables import frequency_axis
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.model.contact import coefficient_of
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import KINDS, NEGLIGIBLE, Modes, bilinear_frequencies
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import Harmonics
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.study.coarser_mesh import (
    TIP,
    coarser,
    errors_of_natural,
    expected,
    natural_name,
    why_failed,
)
from fenics_crack.study.observer import observe
from fenics_crack.study.prepare import REFUSALS, Study, law_of
from fenics_crack.study.verification import UNCHANGED, GridConvergence, Varied, Verification

PLACES = 8
"""Extrapolated resonances, of the orders of a mesh, at which a response is looked at."""


# --- the numbers of an answer ---------------------------------------------------------------------


@dataclass(frozen=True)
class Numbers:
    """The numbers of an answer.

    Attributes
    ----------
    values, units : dict of str to float, and to str
        As :class:`Verification` has them.
    resonance : str
        Name of the natural frequency nearest to the load's.
    mode : int
        Its mode.
    """

    values: dict[str, float]
    units: dict[str, str]
    resonance: str
    mode: int


def numbers_of(study: Study, found: PeriodicSolution, mode: int | None = None) -> Numbers:
    """Return the requested numbers of the watched points and the crack faces, and natural
    frequencies: the lowest ones, and those of a mode, by default of the one with the nearest
    resonance (collective)."""
    scene, structure = study.scene, study.structure
    chosen = scene.quantities or names_of(where=STATED)
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    seen = found.measure([watched.dof for watched in study.watched])
    rounding = NEGLIGIBLE * min(one.amplitude + abs(one.mean) for one in seen)  # of closed pairs
    numbers = (one for one in observe(study, found) if one.name in chosen)
    for one in sorted(numbers, key=lambda one: chosen.index(one.name)):
        of, value = QUANTITIES[one.name].of, float(one.value)
        least = {"1": UNCHANGED, "m": rounding * (of is Place.FACES)}.get(one.unit, 0.0)
        if abs(value) > least or (of.on_request and value == 0.0):
            values[one.column], units[one.column] = value, one.unit.replace("1", "")
    natural = bilinear_frequencies(structure)
    mode = mode or int(natural.nearest(found.omega)["mode"])
    factor, _, unit = frequency_axis(scene.in_hertz)
    wanted = {("open", number) for number in (1, 2, 3, mode)}
    if structure.n_pairs:
        wanted |= {("tied", mode), ("bilinear", mode)}
    for kind, number in sorted(wanted, key=lambda one: (KINDS.index(one[0]), one[1])):
        if number <= len(natural.omega_open):
            name, omega = natural_name(scene, kind, number), getattr(natural, f"omega_{kind}")
            values[name], units[name] = factor * float(omega[number - 1]), unit
    resonance = natural_name(scene, "bilinear" if structure.n_pairs else "open", mode)
    return Numbers(values, units, resonance, mode)


FRICTION_MODES = 20
"""Modes of the structure that shows the effect of friction. With 10 that on openings is often off
by more than a factor of 2, with 40 an orbit takes three times as long."""
SOUGHT = 10
"""Harmonics of the solutions next to which its two orbits are sought."""

# --- one other run for each cause -----------------------------------------------------------------


def stated_errors(
    study: Study, found: PeriodicSolution, *, of_peak: bool = False, friction: bool = True
) -> Verification:
    """The errors of a solution's numbers that are expected by modes, harmonics, mesh and friction
    that is left out (collective).

    Parameters
    ----------
    study : Study
        Of the solution, reduced as it was.
    found : PeriodicSolution
        The answer.
    of_peak : bool
        True if it is the largest of a curve over the frequency, which moves with the resonance.
    friction : bool
        Whether friction is one of the causes.

    Returns
    -------
    Verification
        With ``absent`` or ``unknown``, and why, where a cause was not varied.
    """
    numbers = numbers_of(study, found)
    stated = Verification(study.scene, numbers.values, numbers.units)
    if not is_small(study.structure):  # three more solutions take three times as long
        causes = "modes", "harmonics", "mesh"
        stated.unknown.update(dict.fromkeys(causes, "the structure is not reduced"))
        return stated
    if found.report.unknown:  # other runs may agree by chance
        stated.unknown["harmonics"] = not_estimated(found.report)
        return stated
    try:
        near = _solved(study, found.omega, found.harmonics, found)
    except REFUSALS as error:
        stated.unknown["harmonics"] = why_failed("harmonic balance from it", error)
        return stated
    own = numbers_of(study, near, numbers.mode)
    exact = of_own_orbit(study, found, numbers.mode)
    varied: dict[str, Callable[[], Varied]] = {
        "modes": lambda: _more_modes(study, near, own, found, exact),
        "harmonics": lambda: _more_harmonics(study, near, own, found, exact),
        "mesh": lambda: _coarser_mesh(study, near, own, of_peak),
    }
    for cause, other in varied.items():
        try:
            stated.take(cause, other())
        except REFUSALS as error:
            run = "a coarser mesh" if cause == "mesh" else f"a run with more {cause}"
            stated.unknown[cause] = why_failed(run, error)
    if friction:
        stated.take("friction", with_friction(study, found, stated.values, numbers.mode))
    for name in [*stated.values]:  # of some of the other runs it may be none
        if not all(name in parts for parts in stated.parts.values()):
            del stated.values[name]
    return stated


def with_friction(
    study: Study, found: PeriodicSolution, own: Mapping[str, float], mode: int
) -> Varied:
    """Each number of a solution, changed as much as friction changes it between two exact orbits of
    few modes; nothing where the solution has friction, or no contact (collective)."""
    law, structure, scene, periods = study.contact, study.structure, study.scene, found.subharmonic
    if law is None or coefficient_of(law) is not None:
        return ""
    if not (coefficient := scene.given("contact").friction_error):
        return "contact.friction_error = false"
    if scene.disk is not None or structure.whole.tangential is None:
        return "not estimated, only of single plates"
    keys: dict[str, Any] = {"contact.friction": coefficient}
    if not structure.light_lips:  # faces with mass, in contact as stiff along them as across
        keys["contact.tangential_stiffness_per_area"] = scene.given("contact").stiffness_per_area
    both = []
    try:
        few = reduce_structure(
            structure.whole, modes=FRICTION_MODES, method="massless", reference=False
        )
        for one in (law, law_of(scene.replace(keys), few)):
            assert one is not None
            given = few, found.omega, one
            near = Problem(*given, SOUGHT * periods, subharmonic=periods)
            orbit = Solver(near).solve(found).assessment.orbit
            if orbit is None:
                return f"not estimated, no exact orbit next to {SOUGHT} harmonics"
            twin = replace(study, structure=few, contact=one)
            both.append(_of_orbit(twin, found, orbit, mode, found.harmonics))
    except REFUSALS as error:
        return f"not estimated, {why_failed('a run with friction', error)}"
    parts, sizes, nan = {}, (0.0, float(coefficient)), math.nan
    for name, value in own.items():
        without, rubbed = (numbers.get(name, 0.0) for numbers in both)
        values = value, value * (rubbed / without) if without else value
        parts[name] = GridConvergence(sizes, values, "two coefficients", nan, nan, 1.0, nan)
    return (FRICTION_MODES, FRICTION_MODES), parts


def not_estimated(report: ErrorReport) -> str:
    """Return which part of an unknown error could not be estimated."""
    part = report.largest_part
    words = {"truncation": "truncated harmonics", "reduction": "truncated modes"}
    return f"the error due to the {words.get(part, part)} could not be estimated"


def errors_of(study: Study, result: object) -> Verification | None:
    """The same of any result (collective): of a curve over the frequency that of its largest
    response, which moves with the resonance unless it is an end of the curve.

    None of one that is not a vibration, or has not converged.
    """
    if isinstance(result, Modes):
        return errors_of_natural(study, {"open": result.omega})
    if isinstance(result, ResponseCurve) and result.parameter == "omega":
        top = result.top(study.watched[0].dof)
        return stated_errors(study, result.solution(top.index), of_peak=not top.at_end)
    if isinstance(result, PeriodicSolution) and result.converged and result.report.estimated:
        return stated_errors(study, result)
    return None


def _more_modes(
    study: Study,
    near: PeriodicSolution,
    own: Numbers,
    found: PeriodicSolution,
    exact: Mapping[str, float] | None,
) -> Varied:
    """By the exact orbits with these modes and with those of the reference; where these are not at
    hand by solutions with as many harmonics, to which modes above all of them seem static."""
    structure, reference = study.structure, reference_of(near)
    if reference is None:
        return "all are kept"
    assert isinstance(structure, ReducedStructure)
    more = replace(study, structure=reference)
    counts = len(structure.omega), len(reference.omega)
    larger = found.assessment.more_modes if exact else None
    if exact and larger and larger.orbit:
        other = as_changed(own.values, exact, _of_orbit(more, found, larger.orbit, own.mode))
    else:
        start = near if structure.light_lips else None  # else these have other coordinates
        other = numbers_of(more, _solved(more, near.omega, near.harmonics, start), own.mode).values
    ratio = max(1.0 - structure.share, UNCHANGED)
    return counts, expected("modes", counts, own.values, other, study.scene, ratio=ratio)


def _more_harmonics(
    study: Study,
    near: PeriodicSolution,
    own: Numbers,
    found: PeriodicSolution,
    exact: Mapping[str, float] | None,
) -> Varied:
    if study.contact is None:
        return "without contact there is one"
    if exact is not None:
        return by_orbit(study, found, own.mode, exact)
    scene, counts = study.scene, (near.harmonics, 2 * near.harmonics)
    more = _solved(study, near.omega, counts[1], near)
    parts = expected(
        "harmonics", counts, own.values, numbers_of(study, more, own.mode).values, scene
    )
    if found.report.truncation > LARGE_ERROR:
        far = near.harmonics, 4 * near.harmonics
        other = numbers_of(study, _solved(study, near.omega, far[1], more), own.mode).values
        both = parts, expected("harmonics", far, own.values, other, scene)
        parts = {
            name: max((p[name] for p in both), key=methodcaller("uncertainty")) for name in parts
        }
    if "closed_share" in parts:
        part = parts["closed_share"]  # counted at instants, it is not known to one
        error = math.hypot(part.uncertainty(-1), 1.0 / len(near.instants()))
        parts["closed_share"] = replace(part, extrapolated=part.values[-1] + error)
    return counts, parts


def by_orbit(
    study: Study, found: PeriodicSolution, mode: int, exact: Mapping[str, float]
) -> tuple[tuple[int, int], dict[str, GridConvergence]]:
    """Return the contributions of harmonics to a solution's numbers, by those of its exact orbit
    (collective)."""
    counts = found.harmonics, _many(found)
    sizes = 1.0 / counts[1], 1.0 / counts[0]
    parts = {}
    for name, value in numbers_of(study, found, mode).values.items():
        other = exact.get(name, 0.0)
        parts[name] = GridConvergence(
            sizes, (other, value), "exact orbit", math.nan, math.nan, factor=1.0, extrapolated=other
        )
    return counts, parts


def of_own_orbit(study: Study, found: PeriodicSolution, mode: int) -> dict[str, float] | None:
    """The numbers of the exact orbit next to a study's solution; None where none is that solution's
    own, or it would be sought for long (collective)."""
    orbit = _own_orbit(found)
    return None if orbit is None else _of_orbit(study, found, orbit, mode)


def _own_orbit(found: PeriodicSolution) -> PeriodicOrbit | None:
    """The exact orbit that is a solution's own, unless it would be sought for long (collective)."""
    known = found.assessment
    judged = found.contact is not None and found.report.estimated
    return known.orbit if judged and known.affordable and known.accepted else None


def largest_left_out(found: PeriodicSolution, dof: int) -> tuple[int, float] | None:
    """The order k and U_k / U_1 of the largest harmonic of a dof above the load's, where that is
    one which a solution leaves out of its own exact orbit; None elsewhere (collective)."""
    orbit = _own_orbit(found)
    if orbit is None:
        return None
    rows = found.structure.values_at(orbit.coefficients(_many(found)).displacement, [dof])[:, 0]
    seen = Harmonics(rows, found.subharmonic)
    if not seen.largest_order * found.subharmonic > found.harmonics:
        return None
    return int(seen.largest_order), float(seen.ratio_largest)


def as_changed(
    values: Mapping[str, float], one: Mapping[str, float], other: Mapping[str, float]
) -> dict[str, float]:
    """Numbers, changed as they differ between two orbits; 0 where one is none there."""
    return {name: v + other.get(name, 0.0) - one.get(name, 0.0) for name, v in values.items()}


def _many(found: PeriodicSolution) -> int:
    """Harmonics with which an orbit's motion of points is written: 100, or four times a
    solution's."""
    return max(4 * found.harmonics, MOST_HARMONICS)


def _of_orbit(
    study: Study, found: PeriodicSolution, orbit: PeriodicOrbit, mode: int, harmonics: int = 0
) -> dict[str, float]:
    """The numbers of an orbit next to a solution, of a study's structure: of crack faces by its
    motion at the solution's instants, but for the duty cycle, which follows from its switching
    instants.

    Those of points have so many harmonics, by default many (collective).
    """
    law, harmonics = study.contact, harmonics or _many(found)
    assert law is not None
    problem = Problem(study.structure, found.omega, law, harmonics, subharmonic=found.subharmonic)
    wave = wave_of(problem, orbit, orbit.coefficients(harmonics))
    return numbers_of(study, wave, mode).values | orbit.faces


def _coarser_mesh(study: Study, near: PeriodicSolution, own: Numbers, of_peak: bool) -> Varied:
    """The most by any order of the mesh, but of a peak with what the shift of the resonance
    changes, and what the place where crack faces part does; by differences with half the
    harmonics."""
    coarse = coarser(study)
    if isinstance(coarse, str):
        return coarse
    twin, counts, ratio = coarse
    few = max(near.harmonics // 2, min(near.harmonics, _highest(study, near)))
    few = max(few, least_harmonics(near.structure, near.subharmonic))
    half = _solved(study, near.omega, few, near)
    with_few = numbers_of(study, half, own.mode)
    mode = _moving(study, half)
    moved = resonance_of(twin.structure, mode) / resonance_of(study.structure, mode)
    other = _solved(twin, near.omega * moved, few)
    there = numbers_of(twin, other, own.mode)
    parts = expected("mesh", counts, with_few.values, there.values, study.scene, ratio=ratio)
    sizes = parts[own.resonance].sizes
    orders = 2.0 * study.scene.mesh.order, TIP
    left = np.linspace(*(1.0 / ((sizes[1] / sizes[0]) ** order - 1.0) for order in orders), PLACES)
    moved_to = PLACES * [with_few.values]
    if not of_peak:  # each from rest, as on a finer mesh, which may reach another motion
        shifts = near.omega / (1.0 + left * (1.0 - moved))
        solutions = (_solved(study, float(omega), few) for omega in shifts)
        moved_to = [numbers_of(study, one, own.mode).values for one in solutions]
    between = _with_shifted_clearance(study, half, own.mode)
    found = {}
    for name, part in parts.items():
        value, coarse_value = part.values
        terms = [
            (share * (value - coarse_value), values.get(name, 0.0) - value)
            for share, values in zip(left.tolist(), moved_to, strict=True)
        ]
        error = math.hypot(
            max(abs(shape + shift) for shape, shift in terms),
            # So that something is left where two parts of one order cancel.
            0.1 * max(min(abs(shape), abs(shift)) for shape, shift in terms),
            between.get(name, value) - value,
        )
        at = own.values.get(name, 0.0)
        change = coarse_value - value
        found[name] = replace(part, values=(at, at + change), extrapolated=at + error)
    return counts, found


def _moving(study: Study, near: PeriodicSolution) -> int:
    """The mode whose resonance moves the watched points the most where it is shifted: harmonic k of
    the amplitude U_k changes by about 2 U_k / |1 - (k w / w_j)^2| times the relative shift
    (collective)."""
    rows = near.coefficients_at([watched.dof for watched in study.watched])
    sizes = np.hypot(rows[1::2], rows[2::2]).max(axis=1)
    harmonics = np.arange(1, near.harmonics + 1)
    omega = bilinear_frequencies(study.structure).omega_bilinear
    away = np.abs(1.0 - (harmonics * near.omega / omega[:, None]) ** 2)
    return int(np.argmax((sizes / np.maximum(away, UNCHANGED)).max(axis=1))) + 1


def _highest(study: Study, near: PeriodicSolution) -> int:
    """The highest harmonic that numbers are of: the third, or the largest of a solution."""
    orders = [near.indicators(watched.dof).largest_order for watched in study.watched]
    return int(np.nanmax([3.0, *orders]))


def _with_shifted_clearance(study: Study, near: PeriodicSolution, mode: int) -> dict[str, float]:
    """The numbers with the clearance moved by half a step of the gap from pair to pair, times the
    part of the period for which some pairs of a crack touch and others do not (collective)."""
    cracks, instants = study.structure.pairs.cracks, near.instants()
    if cracks is None or not len(cracks):
        return {}
    gap, touching = near.gap(instants), near.contact_force(instants) > 0.0
    steps = np.zeros(len(cracks))
    for crack in np.unique(cracks):
        its = cracks == crack
        shares = touching[:, its].mean(axis=0)
        apart = gap[:, its].min(axis=0) if shares.all() else gap[:, its].max(axis=0)
        along = its.sum() ** (1.0 / (study.scene.dimension - 1))
        steps[its] = 0.5 * np.ptp(apart) / along * np.ptp(shares)
    moved = replace(study, structure=study.structure.varied(clearance=steps))
    return numbers_of(moved, _solved(moved, near.omega, near.harmonics, near), mode).values


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
