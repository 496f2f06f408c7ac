"""Errors of an answer's numbers: its causes are varied one at a time, and each number's part is
what it changes by.

**Stated errors** (:func:`errors_of`) take one other run for each cause. These are errors that are
expected, not bounds: scenes beside a mesh four times finer are in docs/notebook/stated_errors.md.

- *modes*: the reference of a reduced structure, which has more of them, is solved from the answer
  itself, and e = |f - f_ref| / share, with the share that it has of what is left out. To few
  harmonics the modes above all of them seem static, whether they are kept or not: where an exact
  orbit is the answer's own, f and f_ref are those of orbits. A number may change by little by
  chance, where what the reference leaves out, too, has another phase. So e is at least the size of
  the change of the motion, as the number would show it at another phase (:mod:`changes`), over the
  share.
- *harmonics*: e = |f - f_orbit|. Without an orbit twice as many are solved; where the report says
  that harmonics are too few the difference may vanish by chance, and four times as many say it,
  too.
- *mesh*: it is made coarser, and e = |f - f_r| / (r^p - 1), r being the ratio of lengths. A mesh
  moves the resonances before all else. Next to one a small shift changes an answer by much, on one
  side up and on the other down, so that differences may vanish by chance, and at half a resonance
  across a peak that is no wider than the shift: no number is extrapolated through it. The coarse
  mesh is solved at w w_r / w_b, as far from its resonance w_r as the answer is from its own, w_b,
  and what the shift changes is solved for on the answer's mesh, at w w_b / w_e, w_e being the
  extrapolated resonance: wherever it may be, and each time from rest, as a finer mesh would be,
  where there may be several motions. It is that of the mode whose shift changes the watched points
  the most: at half a resonance the second harmonic meets it, and another mode may be nearer to the
  load. Both have a sign and are added. Their order p is that of tips, 1, or any up to the best of
  the elements:

      e = max over p of |(f - f_r) / (r^p - 1) + f(w w_b / w_e(p)) - f|,

  and a tenth of what could cancel is not known. With a preload or a mean load a crack closes pair
  by pair, and where it is closed ends somewhere between two pairs: half a step of the gap from one
  to the next, times the part of the period for which some touch and others do not, is not known of
  the clearance. Where a point is watched under a force, what elements half as long would add has no
  limit, and is part of its numbers. All harmonics of the answer are kept: with half of them it may
  move near half a resonance by as much as the mesh moves it. What is computed for K_I of a solid's
  front while it is closed is another part of those of K, whose difference between the meshes is
  taken where it is the largest on the front.
- *friction*, where none was given and crack faces touch: each number changes as between two exact
  orbits, without friction and with it, of a structure of few modes whose crack faces have no mass.
  Extremes may agree by chance: as by modes, the part is at least the root mean square of the
  change of the motion. What the change differs from that with half the modes is added.
  With friction on a solid, along one line for each pair, it is twice the share that sliding across
  these lines has, without friction, of what friction changes.

The contact duty cycle is counted at instants, the same in all these runs. Its error is the distance
from that by the switching instants of the exact orbit; elsewhere one instant's part is added.

**Verification** (:func:`verify`) takes two finer runs for each cause. Each number is extrapolated
with the order that it shows (:mod:`verification`). The uncertainty is that of the scene's own
choice, the coarsest of the three: coarser meshes mostly are not in the asymptotic range.

Orders of theory: at the tip of a crack displacements are like r^(1/2), so frequencies and work
converge like h with elements of both orders, on equal cells and on cells graded by a fixed ratio
(Strang and Fix, An Analysis of the Finite Element Method, 1973, chapter 8); at the ends of a clamp
like h^(3/2) (Williams' equation for a right angle with one side held, nu = 0.3, plane stress:
1.52). Modes in a plane have w_j^2 proportional to j, and each that is left out contributes w^2 /
w_j^4, which sums up to N^-1. Where crack faces hit each other velocities jump: |U_k| falls like
k^-2 and what is left out like H^-1, often faster (H^-3 where only forces have kinks), which is not
relied on. Samples of a force with kinks err like N^-2.

The root of the sum of the squares of all causes is the total, if they are independent, and their
sum, if they are not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from operator import methodcaller
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.balance.error_report import ENOUGH_HARMONICS, LARGE_ERROR, ErrorReport
from fenics_crack.balance.harmonic_balance import (
    along_lines,
    find_sliding_lines,
    motion_without_friction,
    slide_along_lines,
    solve_linear,
)
from fenics_crack.balance.more_modes import reference_of
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import MAX_SAMPLES, ConvergenceError, InputError
from fenics_crack.basics.observables import Place, names_of
from fenics_crack.basics.progress import within
from fenics_crack.basics.tables import frequency_axis
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.model.contact import CoulombFriction, friction_of, is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import (
    BilinearFrequencies,
    Modes,
    bilinear_frequencies,
    solve_bonded_modes,
    solve_modes,
)
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.scene.scene import Scene
from fenics_crack.study.changes import sizes_of_change
from fenics_crack.study.meshes import coarser, finer_mesh, is_even, n_elements
from fenics_crack.study.numbers import (
    Numbers,
    accepted_orbit,
    as_changed,
    bilinear_of,
    many_harmonics,
    natural_name,
    numbers_of,
    of_orbit,
)
from fenics_crack.study.observer import errors_along_fronts, rows_requested
from fenics_crack.study.prepare import REFUSALS, Study, law_of, prepare, reduced, reduction_of
from fenics_crack.study.resonance import NOT_SOUGHT, AtLoad, resonance_of
from fenics_crack.study.solve import Solved, solve_prepared
from fenics_crack.study.verification import (
    UNCHANGED,
    GridConvergence,
    Part,
    Varied,
    Verification,
    dent_by_force,
    grid_convergence,
)

TIP, CLAMP = 1.0, 1.5
"""Orders of convergence at a crack tip and at a clamp's ends."""
COUNTS = (1, 2, 4)
"""Refinement factors of counts."""
PLACES = 8
"""Extrapolated resonances, of the orders of a mesh, at which a response is looked at."""
FRICTION_MODES = 20, 10
"""Modes of the structures that show the effect of friction, and how far it depends on them. With 40
an orbit takes three times as long, where it is hard to find ten times."""
TURNED = 2.0
"""Stated error by sliding across the lines of friction, over its share of what friction changes:
true ones, beside time steps with Coulomb's cone, were 0.03 to 1.2 of that in seven cases."""
SLIDING_QUANTITIES = ("K_II_max", "K_III_max")
"""Stress intensities that friction at the tip itself changes."""
SOUGHT = 10
"""Harmonics of the solutions next to which its two orbits are sought."""
OWN = "the scene's own choice"
RUNS = {
    "mesh": "another mesh", "shift": "a shifted resonance", "friction": "a run with friction",
}  # fmt: skip
"""Words for the other run of a cause, but "a run with more modes"."""


# --- levels of a cause ----------------------------------------------------------------------------


Level = tuple[int, Mapping[str, float]]
"""How many elements, modes, harmonics or samples a run has, and its numbers."""


def part_of(
    cause: str,
    levels: Sequence[Level],
    scene: Scene,
    *,
    ratio: float | None = None,
    formal: float = TIP,
    highest: float = math.inf,
) -> Part:
    """The part of a cause in each number of the first level, the answer's; 0 where one has none.

    It follows from two or three levels with the orders of :func:`grid_convergence`; or from two by
    a ratio of sizes, an error that is expected, without a factor of safety.
    """
    counts, runs = zip(*levels, strict=True)
    sizes = [_size_of(cause, count, scene) for count in counts]
    if ratio is not None:
        sizes[1] = ratio * sizes[0]
    parts = {}
    for name in runs[0]:
        values = [run.get(name, 0.0) for run in runs]
        found = grid_convergence(sizes, values, formal=formal, highest=highest)
        parts[name] = found if ratio is None else replace(found, factor=1.0)
    return counts, parts


def _size_of(cause: str, count: int, scene: Scene) -> float:
    """The side of a square or cube of the mean size of so many elements, in [m] where the plate is
    the scene's (Celik and others, equation 1); or one over the number of something else."""
    if cause != "mesh":
        return 1.0 / count
    return float((math.prod(scene.geometry.sides) / count) ** (1.0 / scene.dimension))


def vary(found: Verification, causes: Mapping[str, Callable[[], Varied]]) -> Verification:
    """Note the part of each cause, or why it is not known (collective)."""
    for cause, part in causes.items():
        try:
            found.take(cause, part())
        except REFUSALS as error:
            found.unknown[cause] = _why_failed(RUNS.get(cause, f"a run with more {cause}"), error)
            if cause == "mesh":
                found = replace(found, failed=(cause,))
    return found


def _why_failed(run: str, error: Exception) -> str:
    """Return why another run gives no error: the key that it cannot have, or no solution."""
    if isinstance(error, InputError):
        return f"{run} cannot be used, for its {error.key}"
    return f"{run} has no solution"


def _relative_change(
    name: str, numbers: Mapping[str, float], other_numbers: Mapping[str, float]
) -> float:
    """Return the relative change of a number from one motion to another; 0 where it is none."""
    value = numbers.get(name, 0.0)
    return other_numbers.get(name, 0.0) / value - 1.0 if value else 0.0


@dataclass(frozen=True)
class _Case:
    """An answer whose causes of error are varied.

    Attributes
    ----------
    study : Study
        Of the answer, reduced as it was.
    found : PeriodicSolution
        The answer.
    near : PeriodicSolution
        By harmonic balance with as many harmonics, to which other solutions are compared; the
        answer where that has none and the answer is an exact orbit.
    own : Numbers
        Of that.
    made : Verification
        With the answer's numbers, and the parts that are known so far.
    """

    study: Study
    found: PeriodicSolution
    near: PeriodicSolution
    own: Numbers
    made: Verification

    @cached_property
    def exact(self) -> dict[str, float] | None:
        """Numbers of the exact orbit accepted for the answer, if one is (collective)."""
        return self.of_own_orbit(self.study, self.found)

    def of_own_orbit(self, study: Study, found: PeriodicSolution) -> dict[str, float] | None:
        """Those of the exact orbit accepted for a solution."""
        orbit = accepted_orbit(found)
        return None if orbit is None else of_orbit(study, found, orbit, self.own.mode)

    def values_of(self, found: PeriodicSolution, study: Study | None = None) -> dict[str, float]:
        """Numbers of a solution, by default of the answer's study (collective)."""
        return numbers_of(study or self.study, found, self.own.mode).values

    def by_orbit(self, exact: Mapping[str, float]) -> Varied:
        """The part of harmonics by the numbers of the exact orbit."""
        counts = self.found.harmonics, many_harmonics(self.found)
        sizes = 1.0 / counts[1], 1.0 / counts[0]
        parts = {}
        for name, value in self.values_of(self.found).items():
            limit = exact.get(name, 0.0)
            parts[name] = GridConvergence(
                sizes, (limit, value), "exact orbit", factor=1.0, extrapolated=limit
            )
        return counts, parts

    def friction(self) -> Varied:
        """Each number, changed as much as friction changes it between two exact orbits of few
        modes; nothing where the answer has friction, its scene says that there is none, or crack
        faces do not touch (collective)."""
        study, scene, found = self.study, self.study.scene, self.found
        law, structure = study.contact, study.structure
        if law is None or not np.any(found.contact_force(found.instants()) > 0.0):
            return ""
        if (own_friction := friction_of(law)) is not None:
            return "" if own_friction.direction is None else self._turning(own_friction)
        table = scene.given("contact")
        if table.friction is not None:
            return ""
        if not (coefficient := table.friction_error):
            return "contact.friction_error = false"
        rubs = structure.whole.with_tangents()
        if scene.disk is not None or rubs.tangential is None:
            return "not estimated, only of single plates and solids"
        keys: dict[str, Any] = {"contact.friction": coefficient, "output.quantities": None}
        keys["harmonic_balance.form"] = "condensed"
        if not structure.light_lips:  # faces with mass, in contact as stiff along them as across
            keys["contact.tangential_stiffness_per_area"] = table.stiffness_per_area
        (orbits, numbers), (coarse_orbits, coarse_numbers) = (
            self._with_and_without(count, rubs, keys) for count in FRICTION_MODES
        )
        if len(orbits) < 2:
            return f"not estimated, no exact orbit next to {SOUGHT} harmonics"
        if len(coarse_orbits) < 2:
            coarse_numbers = numbers
        sizes = sizes_of_change(study, *orbits)
        coefficients, parts = (0.0, float(coefficient)), {}
        for name, value in self.made.values.items():
            if name in SLIDING_QUANTITIES:
                continue
            change = _relative_change(name, *numbers)
            error = abs(change) + abs(change - _relative_change(name, *coarse_numbers))
            if size := abs(numbers[0].get(name, 0.0)):
                error = max(error, sizes.get(name, 0.0) / size)
            values = value, value * (1.0 + change)
            factor = error / abs(change) if change else 1.0
            parts[name] = GridConvergence(coefficients, values, "two coefficients", factor=factor)
        return FRICTION_MODES[:1] * 2, parts

    def _with_and_without(
        self, count: int, whole: Structure, keys: Mapping[str, Any]
    ) -> tuple[list[PeriodicOrbit], list[dict[str, float]]]:
        """Return exact orbits of so many modes and their numbers, without friction and with it,
        which keys of the scene describe; up to the first that is not found (collective)."""
        study, found, periods = self.study, self.found, self.found.subharmonic
        count = min(count, whole.n_dofs // 2)
        reduced_structure = reduce_structure(whole, modes=count, method="massless", reference=False)
        orbits, numbers = list[PeriodicOrbit](), list[dict[str, float]]()
        for law in (study.contact, law_of(study.scene.replace(keys), reduced_structure)):
            assert law is not None
            contact_law = along_lines(reduced_structure, law, lambda _: orbits[0])
            problem = Problem(
                reduced_structure, found.omega, contact_law, SOUGHT * periods, subharmonic=periods
            )
            orbit = Solver(problem).solve(found).assessment.orbit
            if orbit is None:
                break
            twin = replace(study, structure=reduced_structure, contact=contact_law)
            orbits.append(orbit)
            numbers.append(of_orbit(twin, found, orbit, self.own.mode))
        return orbits, numbers

    def _turning(self, friction: CoulombFriction) -> Varied:
        """Each number of a solid, changed by the share of what friction changes that sliding across
        the lines has (collective)."""
        study, found, mode = self.study, self.found, self.own.mode
        structure, periods = study.structure, found.subharmonic
        free = motion_without_friction(structure, found.omega, friction.law, periods)
        twin = replace(study, contact=friction.law)
        if isinstance(free, PeriodicOrbit):
            without = of_orbit(twin, found, free, mode)
        else:
            without = numbers_of(twin, free, mode).values
        turning, parts = find_sliding_lines(free, friction.direction)[1], {}
        for name, value in self.made.values.items():
            turned = value + turning * (without.get(name, 0.0) - value)
            parts[name] = GridConvergence(
                (0.0, 1.0), (value, turned), "two coefficients", factor=TURNED
            )
        return (structure.n_modes, structure.n_modes), parts


# --- stated errors: one other run for each cause --------------------------------------------------


def errors_of(study: Study, result: object) -> Verification | None:
    """The errors that are stated of any result (collective): of a curve those of its largest
    response, which moves with the resonance unless it is an end of the curve.

    None of one that is not a vibration, or has not converged.
    """
    if isinstance(result, Modes):
        return errors_of_natural(study, {"open": result.omega})
    if isinstance(result, ResponseCurve) and result.parameter in ("omega", "speed"):
        top = result.top(study.watched[0].dof)
        found = result.solution(top.index)
        if not isinstance(found.structure, RunUpStructure):
            return stated_errors(study, found, of_peak=not top.at_end)
        return _errors_at_speed(study, found, found.structure, of_peak=not top.at_end)
    if isinstance(result, PeriodicSolution) and result.converged and result.report.estimated:
        return stated_errors(study, result)
    return None


def _errors_at_speed(
    study: Study, found: PeriodicSolution, structure: RunUpStructure, *, of_peak: bool
) -> Verification:
    """The errors of a solution of a run-up: of the scene at its speed, with as many modes
    (collective).

    Where a resonance is off by e, the speed at which the load meets it is off by e / (1 - s), s
    being d ln w / d ln W.
    """
    speed, rate = structure.speed, 1.0 - structure.stiffening(found.omega)
    changes = {"rotation.speed": speed, "excitation.omega": found.omega, "curve": None}
    fixed = prepare(study.scene.replace(changes), structure.whole.comm, like=study)
    answer = _solved(fixed, found.omega, found.harmonics, found)
    stated = stated_errors(fixed, answer, of_peak=of_peak)
    if (resonance := stated.resonance) not in stated.values:
        return stated
    own = stated.values[resonance]

    def met(frequency: float) -> float:
        return speed * (1.0 + (frequency / own - 1.0) / rate)

    stated.values["speed"], stated.units["speed"] = speed, "rad/s"
    for parts in stated.parts.values():
        part = parts[resonance]
        values, limit = tuple(map(met, part.values)), met(part.extrapolated)
        parts["speed"] = replace(part, values=values, extrapolated=limit)
    return stated


def errors_of_natural(
    study: Study,
    natural: Mapping[str, np.ndarray],
    at_load: AtLoad = NOT_SOUGHT,
    slopes: np.ndarray | None = None,
) -> Verification:
    """Return mesh errors of natural frequencies and of the resonance at the load (collective).

    Parameters
    ----------
    study : Study
        Of the whole structure.
    natural : dict of str to (m,) [rad/s]
        With crack faces "open" and "tied".
    at_load : AtLoad
        Of the same structure; its ``numbers`` are among those of the result.
    slopes : (m, 2), optional
        S and C of each mode (:func:`resonance_of`).
    """
    scene = study.scene
    factor, _, unit = frequency_axis(scene.in_hertz)

    def named(kinds: Mapping[str, np.ndarray]) -> dict[str, float]:
        return {
            natural_name(scene, kind, number): factor * float(omega)
            for kind, values in kinds.items()
            for number, omega in enumerate(values, 1)
            if 0.0 < omega < np.inf
        }

    def by_mesh() -> Varied:
        coarse = coarser(study)
        if isinstance(coarse, str):
            return coarse
        twin, counts, ratio = coarse
        count = max(map(len, natural.values()))
        both = {"open": solve_modes(twin.structure, count).omega}
        if "tied" in natural:
            both["tied"] = solve_bonded_modes(twin.structure, count).omega
        coarse_values = named(both)
        if at_load.numbers and slopes is not None:
            estimates = BilinearFrequencies(both["open"], both["tied"]).omega_bilinear
            coarse_values |= resonance_of(twin, estimates, slopes).numbers
        levels = zip(counts, (values, coarse_values), strict=True)
        return part_of("mesh", [*levels], scene, ratio=ratio)

    values = named(natural) | at_load.numbers
    return vary(Verification(scene, values, dict.fromkeys(values, unit)), {"mesh": by_mesh})


EVERY = ("modes", "harmonics", "mesh", "friction")
"""Causes of stated errors."""


def stated_errors(
    study: Study, found: PeriodicSolution, *, of_peak: bool = False, causes: Sequence[str] = EVERY
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
    causes : sequence of str
        Those that are varied.

    Returns
    -------
    Verification
        With ``absent`` or ``unknown``, and why, where a cause was not varied.
    """
    numbers = numbers_of(study, found)
    stated = Verification(study.scene, numbers.values, numbers.units)
    if not is_small(study.structure):  # three more solutions take three times as long
        stated.unknown.update(dict.fromkeys(EVERY[:3], "the structure is not reduced"))
        return stated
    if found.report.unknown:  # other runs may agree by chance
        stated.unknown["harmonics"] = not_estimated(found.report)
        return stated
    try:
        near = _solved(study, found.omega, found.harmonics, found)
    except REFUSALS as error:
        if found.orbit is None:
            stated.unknown["harmonics"] = _why_failed("harmonic balance from it", error)
            return stated
        near = found  # has the coefficients of an exact orbit
    own = numbers_of(study, near, numbers.mode)
    case = _Stated(study, found, near, own, stated, of_peak)
    return vary(stated, {cause: getattr(case, cause) for cause in causes})


def error_by_modes(study: Study, found: PeriodicSolution) -> float:
    """Relative error of what is watched, and of the opening of cracks, that modes left out are
    expected to make; inf where it is not known (collective)."""
    stated = stated_errors(study, found, causes=["modes"])
    names = [*(one.column("amplitude") for one in study.watched), "opening"]
    if stated.unknown:
        return math.inf
    seen = [one for one in names if stated.parts and stated.values.get(one)]
    return max((stated.stated(one)[0] for one in seen), default=0.0)


def not_estimated(report: ErrorReport) -> str:
    """Return which part of an unknown error could not be estimated."""
    part = report.largest_part
    words = {"truncation": "truncated harmonics", "reduction": "truncated modes"}
    return f"the error due to the {words.get(part, part)} could not be estimated"


@dataclass(frozen=True)
class _Stated(_Case):
    """The same by one other run for each cause; of a peak, which moves with the resonance."""

    of_peak: bool

    def modes(self) -> Varied:
        """By the nearest exact orbits with these modes and with those of the reference; of few
        harmonics without the latter by its predicted motion.

        Where these are not at hand by solutions, with :data:`ENOUGH_HARMONICS` harmonics where
        orbits are affordable, but at least the part of harmonics, as modes above all of them are
        static in both."""
        structure, near, reference = self.study.structure, self.near, reference_of(self.near)
        if reference is None:
            return "all are kept"
        assert isinstance(structure, ReducedStructure)
        more, known = replace(self.study, structure=reference), self.found.assessment
        larger = known.more_modes if known.affordable else None
        is_short = self.found.orbit is None and near.harmonics < ENOUGH_HARMONICS * near.subharmonic
        if larger and (motion := larger.motion if is_short else larger.orbit):
            few = self.exact or of_orbit(
                self.study, self.found, larger.nearest_orbit, self.own.mode
            )
            many = of_orbit(more, self.found, motion, self.own.mode)
            other = as_changed(self.own.values, few, many)
            least = sizes_of_change(self.study, larger.nearest_orbit, motion)
        else:
            exactly = known.affordable and structure.light_lips
            if exactly and near.harmonics < (count := ENOUGH_HARMONICS * near.subharmonic):
                near = _solved(self.study, near.omega, count, near)
            start = near if structure.light_lips else None  # else these have other coordinates
            solution = _solved(more, near.omega, near.harmonics, start)
            both = self.values_of(near), self.values_of(solution, more)
            other = as_changed(self.own.values, *both)
            least = sizes_of_change(self.study, near, solution)
            truncated = self.truncated if exactly else ""
            for name, part in {} if isinstance(truncated, str) else truncated[1].items():
                least[name] = max(least.get(name, 0.0), structure.share * part.uncertainty(-1))
        counts, ratio = (len(structure.omega), len(reference.omega)), 1.0 - structure.share
        levels = zip(counts, (self.own.values, other), strict=True)
        _, parts = part_of("modes", [*levels], self.study.scene, ratio=max(ratio, UNCHANGED))
        for name, size in least.items():
            error = parts[name].uncertainty(-1) if name in parts else 0.0
            if 0.0 < error < size / structure.share:
                parts[name] = replace(parts[name], factor=size / structure.share / error)
        return counts, parts

    def harmonics(self) -> Varied:
        return self.truncated

    @cached_property
    def truncated(self) -> Varied:
        """The part of harmonics."""
        if self.study.contact is None:
            return "without contact there is one"
        if self.exact is not None:
            return self.by_orbit(self.exact)
        scene, count, start = self.study.scene, self.near.harmonics, self.near
        made = []
        for factor in COUNTS[1:] if self.found.report.truncation > LARGE_ERROR else COUNTS[1:2]:
            start = _solved(self.study, self.near.omega, factor * count, start)
            levels = (count, self.own.values), (factor * count, self.values_of(start))
            made.append(part_of("harmonics", levels, scene, ratio=1.0 / factor))
        worst = partial(max, key=methodcaller("uncertainty"))
        parts = {name: worst(part[name] for _, part in made) for name in self.own.values}
        if "closed_share" in parts:
            part = parts["closed_share"]  # counted at instants, it is not known to one
            error = math.hypot(part.uncertainty(-1), 1.0 / len(self.near.instants()))
            parts["closed_share"] = replace(part, extrapolated=part.values[-1] + error)
        return (count, 2 * count), parts

    def mesh(self) -> Varied:
        """Return the largest part by any order of the mesh, but of a peak with the shift of the
        resonance, with the place where crack faces part, and with the dent under a force."""
        study, near = self.study, self.near
        coarse = coarser(study)
        if isinstance(coarse, str):
            return coarse
        twin, counts, ratio = coarse
        try:
            rows_requested(twin)
        except InputError:  # its elements are too long for stress intensities
            tips = names_of(Place.TIPS, Place.ELLIPSE)
            others = [name for name in twin.scene.quantities or () if name not in tips]
            twin = replace(twin, scene=twin.scene.replace({"output.quantities": others or None}))
        values, mode = self.own.values, self._moving(near)
        moved = bilinear_of(twin.structure, mode) / bilinear_of(study.structure, mode)
        other = _solved_in_steps(twin, near.omega * moved, near.harmonics)
        levels = zip(counts, (values, self.values_of(other, twin)), strict=True)
        _, parts = part_of("mesh", [*levels], study.scene, ratio=ratio)
        orders = 2.0 * study.scene.mesh.order, TIP
        left = np.linspace(*(1.0 / (ratio**order - 1.0) for order in orders), PLACES)
        moved_to = PLACES * [values]
        if not self.of_peak:  # each from rest, as on a finer mesh, which may reach another motion
            shifts = near.omega / (1.0 + left * (1.0 - moved))
            solutions = (_solved_in_steps(study, float(w), near.harmonics) for w in shifts)
            moved_to = [self.values_of(one) for one in solutions]
        between, found = self._with_shifted_clearance(near), {}
        dents = dict.fromkeys(names_of(Place.POINT), self._relative_dent)
        closed, apart = errors_along_fronts(study, near, twin, other)
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
                closed.get(name, 0.0),
                dents.get(name, 0.0) * value,
            )
            error = max(error, apart.get(name, 0.0) * left.max())
            found[name] = replace(part, extrapolated=value + error)
        return counts, found

    def _moving(self, near: PeriodicSolution) -> int:
        """The mode whose resonance moves the watched points the most where it is shifted: harmonic
        k of the amplitude U_k changes by about 2 U_k / |1 - (k w / w_j)^2| times the relative shift
        (collective)."""
        rows = near.coefficients_at([watched.dof for watched in self.study.watched])
        sizes = np.hypot(rows[1::2], rows[2::2]).max(axis=1)
        harmonics = np.arange(1, near.harmonics + 1)
        omega = bilinear_frequencies(self.study.structure).omega_bilinear
        away = np.abs(1.0 - (harmonics * near.omega / omega[:, None]) ** 2)
        return int(np.argmax((sizes / np.maximum(away, UNCHANGED)).max(axis=1))) + 1

    @property
    def _relative_dent(self) -> float:
        """Relative amplitude that half as long elements add where a force at a point is watched."""
        if self.study.scene.points:
            return 0.0
        amplitude = self.near.amplitude(self.study.watched[0].dof)
        return dent_by_force(self.study.scene) / amplitude

    def _with_shifted_clearance(self, near: PeriodicSolution) -> dict[str, float]:
        """The numbers with the clearance moved by half a step of the gap from pair to pair, times
        the part of the period for which some pairs of a crack touch and others do not
        (collective)."""
        study, instants = self.study, near.instants()
        cracks = study.structure.pairs.cracks
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
        return self.values_of(_solved_in_steps(moved, near.omega, near.harmonics, near), moved)


def _solved(
    study: Study, omega: float, harmonics: int, initial: PeriodicSolution | None = None
) -> PeriodicSolution:
    """A solution without its stability; ConvergenceError without one."""
    if study.contact is None:
        return solve_linear(study.structure, omega, harmonics=harmonics)
    law = slide_along_lines(study.structure, omega, study.contact)
    return Solver(Problem(study.structure, omega, law, harmonics)).solve(initial)


def _solved_in_steps(
    study: Study, omega: float, harmonics: int, initial: PeriodicSolution | None = None
) -> PeriodicSolution:
    """Solve with half of the harmonics, and from there with all of them.

    Half of them find a motion from rest in less time. Where all have none next to it, the first
    solution is returned.
    """
    n_first = max(harmonics // 2, least_harmonics(study.structure, 1))
    solution = _solved(study, omega, n_first, initial)
    if study.contact is None:
        return solution
    law = slide_along_lines(study.structure, omega, study.contact)
    solver = Solver(Problem(study.structure, omega, law, harmonics))
    search, finer_solution = solver.attempt(solution, wholly=False)
    return finer_solution if search.has_converged else solution


# --- verification: two finer runs for each cause --------------------------------------------------


def verify(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Verification:
    """Compute the convergence of a scene's steady vibration and natural frequencies (collective).

    Mesh, modes, harmonics and samples are made finer, one at a time and twice: a graded mesh by 1.5
    and 2, a grid by 2 and 3, numbers by 2 and 4. Of the three values of each quantity the observed
    order p, the extrapolated value f and the uncertainty F abs(f_i - f) follow, with a factor of
    safety F of 1.25 or 3 (:func:`fenics_crack.grid_convergence`; Roache 1994, Celik and others
    2008, ASME V&V 20-2009). Harmonics are not varied where an exact orbit is the solution's
    own: their part is the distance from its numbers.

    A tolerance of the scene chooses harmonics and modes first. Of a mesh file and of matrices the
    mesh is left alone, and that is said. Runs that fail, and orbits that are not stable, are named.

    Parameters
    ----------
    scene : Scene
        As it is solved.
    comm : MPI.Comm
        Ranks that share each mesh.

    Returns
    -------
    Verification
        Each cause's part of the error of each quantity, and their total.

    Raises
    ------
    InputError
        As :func:`fenics_crack.prepare`.
    ConvergenceError
        The scene itself does not converge.

    Examples
    --------
    >>> found = fc.verify(scene)
    >>> percent = found.total("amplitude")
    """
    with within(OWN):
        whole = prepare(scene, comm, whole=True)
        own = solve_prepared(whole)
        if scene.harmonic_balance.tolerance is not None and own.result.converged:
            own = solve_prepared(replace(own, scene=_settled(own)), own.result)
    if not own.result.converged:
        raise ConvergenceError(f"{OWN}: {own.result.status}")
    whole = replace(whole, scene=_settled(own))
    numbers = numbers_of(own, own.result)
    made = Verification(whole.scene, numbers.values, numbers.units, verdicts=_doubtful(OWN, own))
    case = _Verified(own, own.result, own.result, numbers, made, whole)
    causes = {"mesh": case.mesh, "shift": case.shift, "modes": case.modes}
    others = {"harmonics": case.harmonics, "samples": case.samples, "friction": case.friction}
    made = vary(made, causes | others)
    return replace(made, failures=tuple(case.failures))


def _settled(solved: Solved) -> Scene:
    """The scene of a solution with what was chosen for it; with all modes kept it is not reduced,
    so that none is left out on a finer mesh."""
    scene, whole = solved.scene, solved.structure.whole
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is not None:
        changes["harmonic_balance.tolerance"] = None
        changes["harmonic_balance.harmonics"] = solved.result.harmonics
    if scene.disk is not None:
        return scene.replace(changes)
    kept = reduction_of(scene, whole)
    if kept is None or kept.modes >= whole.n_dofs:
        return scene.replace(changes | {"reduction.method": "off", "reduction.modes": None})
    return scene.replace(changes | {"reduction.method": kept.method, "reduction.modes": kept.modes})


def _kept_modes(study: Study) -> tuple[int, int] | str:
    """Return how many modes are kept, of how many; or the reason why they cannot be varied."""
    kept = reduction_of(study.scene, study.structure)
    if study.scene.disk is not None:
        return study.scene.disk.families, study.structure.n_dofs // study.scene.disk.sectors
    if kept is None:
        return "the structure is not reduced"
    most = study.structure.n_dofs - study.structure.n_pairs
    return "all are kept" if kept.modes >= most else (kept.modes, most)


def _doubtful(name: str, run: Solved) -> dict[str, str]:
    """The verdict by the name of a run, where it is not known to be stable."""
    stability = run.result.stability
    known = stability is None or stability.verdict == "stable"
    return {} if known or stability is None else {name: stability.verdict}


@dataclass(frozen=True)
class _Verified(_Case):
    """The same by finer runs, with the settled scene and its whole structure; and those that
    failed."""

    whole: Study
    failures: list[str] = field(default_factory=list)

    def _part(
        self,
        cause: str,
        finer: Sequence[tuple[str, int | None, Scene]],
        count: int,
        formal: float,
        *,
        shared: Study | None = None,
        highest: float = math.inf,
    ) -> Varied:
        """The part of a cause, by what finer runs are called, their counts, None of a mesh, whose
        elements are counted when it is made, and scenes; ``shared`` is the study of all runs but
        those of a mesh (collective)."""
        levels: list[Level] = [(count, self.own.values)]
        for name, many, scene in reversed(finer):  # few modes are among many
            with within(name):
                try:
                    run = self._run(scene, shared)
                except REFUSALS as error:
                    self.failures.append(f"{name}: {error}")
                    continue
            levels.insert(1, (many or n_elements(run.structure), self._values(run, cause)))
            self.made.verdicts.update(_doubtful(name, run))
        if len(levels) == 1:
            raise ConvergenceError(cause)
        if len({many for many, _ in levels}) < len(levels):
            return "finer ones have as many elements, as mesh.size is that of the plate"
        return part_of(cause, levels, self.whole.scene, formal=formal, highest=highest)

    def _run(self, scene: Scene, shared: Study | None) -> Solved:
        """The run of a finer scene, from the solution that it shares a structure with; on another
        mesh as far from the resonance of a mode (collective)."""
        study, mode = self.study, self.own.mode
        initial, omega = self.found if shared is study else None, self.found.omega
        if shared is not None:
            varied = reduced(replace(shared, scene=scene), judged=False)
        else:
            varied = prepare(scene, study.structure.comm, judged=False)
            omega *= bilinear_of(varied.structure, mode) / bilinear_of(study.structure, mode)
        run = solve_prepared(varied, initial, omega)
        if not run.result.converged:
            raise ConvergenceError(run.result.status)
        return run

    def _values(self, run: Solved, cause: str) -> dict[str, float]:
        """The numbers of a finer run; of more modes as the exact orbits change, where both have
        their own: to few harmonics the modes above all of them seem static (collective)."""
        if cause == "modes" and self.exact is not None:
            exact = self.of_own_orbit(run, run.result)
            if exact is not None:
                return as_changed(self.own.values, self.exact, exact)
        return self.values_of(run.result, run)

    def _more(
        self, cause: str, shared: Study, scene: Scene, key: str, own: int, most: int, formal: float
    ) -> Varied:
        """The part of twice and four times as many of something, at most so many (collective)."""
        counts = sorted({min(factor * own, most) for factor in COUNTS})
        name = key.rpartition(".")[2]
        finer = [(f"{count} {name}", count, scene.replace({key: count})) for count in counts[1:]]
        return self._part(cause, finer, own, formal, shared=shared)

    def mesh(self) -> Varied:
        scene = self.whole.scene
        if scene.structure is not None:
            return "[structure] has matrices, and not the mesh that they are of"
        factors = (1.5, 2.0) if is_even(scene) else (2.0, 3.0)
        made = [(f"a mesh {factor:g} times finer", finer_mesh(scene, factor)) for factor in factors]
        finer = [(name, None, other) for name, other in made if other is not None]
        if not finer:
            return (
                "mesh.file is one mesh; solve states its part by mesh.coarser, and "
                "fc.grid_convergence compares several"
            )
        formal = TIP if self.whole.structure.n_pairs else CLAMP
        count, highest = n_elements(self.study.structure), 2.0 * scene.mesh.order
        return self._part("mesh", finer, count, formal, highest=highest)

    def shift(self) -> Varied:
        """The change of each number due to the shift of the resonance by the mesh: the largest at
        any within its uncertainty, as peaks may lie there, and where it is extrapolated to
        (collective)."""
        if "mesh" not in self.made.parts:
            return ""
        counts, resonance = self.made.counts["mesh"], self.made.parts["mesh"][self.own.resonance]
        at = self.own.values[self.own.resonance]
        known, error = math.isfinite(resonance.extrapolated), resonance.uncertainty(-1) / at
        softer = -1.0 if known and resonance.extrapolated > at else 1.0
        shifts = [(1.0 + error * part) ** softer for part in (0.5, 1.0)]
        if known:
            shifts.append(at / resonance.extrapolated)
        found, moved = self.found, []
        for factor in shifts:  # each is sought from the one before
            found = _solved(self.study, self.found.omega * factor, self.found.harmonics, found)
            moved.append(self.values_of(found))
        parts = {}
        for name, value in self.own.values.items():
            there = [values.get(name, 0.0) for values in moved]
            farthest = max(there, key=lambda one: abs(one - value))
            limit = there[-1] if known else math.nan
            parts[name] = replace(
                resonance, sizes=(resonance.sizes[0], resonance.sizes[-1]), factor=1.0,
                values=(farthest, value), behaviour="carried", extrapolated=limit,
            )  # fmt: skip
        return counts[:: len(counts) - 1], parts

    def modes(self) -> Varied:
        whole, kept = self.whole, _kept_modes(self.whole)
        if isinstance(kept, str):
            return kept
        return self._more("modes", whole, whole.scene, whole.scene.modes_key, *kept, TIP)

    def harmonics(self) -> Varied:
        scene = self.whole.scene
        table = scene.harmonic_balance
        if self.study.contact is None:
            return "without contact there is one"
        if table.samples is not None:  # enough for all of them
            least = 4 * COUNTS[-1] * table.harmonics + 1
            scene = scene.replace({"harmonic_balance.samples": max(table.samples, least)})
        elif self.exact is not None:
            return self.by_orbit(self.exact)
        key = "harmonic_balance.harmonics"
        return self._more("harmonics", self.study, scene, key, table.harmonics, MAX_SAMPLES, TIP)

    def samples(self) -> Varied:
        table, law = self.whole.scene.harmonic_balance, self.study.contact
        if law is None:
            return "without contact there are none"
        if table.samples is None and is_unilateral(law):
            return "contact is integrated exactly"
        count = table.samples or default_samples(table.harmonics)
        key = "harmonic_balance.samples"
        return self._more("samples", self.study, self.whole.scene, key, count, MAX_SAMPLES, 2.0)
