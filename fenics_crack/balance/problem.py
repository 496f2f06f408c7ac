"""A problem of harmonic balance, all that a solution depends on; and the search for a solution.

A search takes one start after the other, until Newton's method arrives or the work is done. A
start gives guesses, and from each of them full Newton steps are taken, and then from where
shortened steps lead from there:

near       a given solution
fewer      the linear solution; with many unknowns or pairs that are seen through a static
           compliance (:mod:`contact_system`) the solution with half the harmonics, which comes
           from that with half of those, and so on, the first that is not found so by the path;
           many from the exact orbit next to a solution with fewer, which is near whatever their
           number
without    with friction: the solution without
orbit      the exact orbit next to the solution with fewer harmonics, or without friction; behind
           the path where it has so many modes that a path takes less
path       where the continuation in the compliance in series with every pair has its end,
           followed by arc-length through its folds, from where the solution is unique and close to
           the linear one; with friction that on which its coefficient grows

The path cannot return to soft contact, but several stiff pairs with little damping have thousands
of folds on their way: all starts together take a certain number of iterations and no more. A gap
rounded to eps |g| makes a contact force rounded to eps k |g|, which moves the gap by eps k R |g|:
no residual can be smaller than that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fenics_crack.balance.compliance import (
    Compliance,
    dynamic_compliance,
    load_coefficients,
    resized_compliance,
)
from fenics_crack.balance.contact_integrals import (
    ContactIntegrals,
    ExactIntegrals,
    contact_integrals,
    respond,
)
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem, Wave, default_weight
from fenics_crack.balance.friction_integrals import FrictionIntegrals, coupled_integrals
from fenics_crack.basics.errors import (
    MAX_SAMPLES,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.basics.progress import begin
from fenics_crack.basics.threads import machine_memory
from fenics_crack.kernel import kernel
from fenics_crack.model.contact import (
    ContactLaw,
    check_law,
    friction_of,
    is_regular,
    is_rigid,
    normal_law,
    seen_by,
    springs_of,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import flow_of
from fenics_crack.motion.orbit import MAX_MODES_FOR_MONODROMY, PeriodicOrbit, is_affordable
from fenics_crack.motion.search import SearchOptions, search_orbit, wave_states
from fenics_crack.numerics.equations import (
    COARSE_TOLERANCE,
    MACHINE_EPSILON,
    ROUNDING,
    Linearisation,
    residual_rounding,
)
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.numerics.newton import (
    MAX_FULL_STEPS,
    MAX_STALLED_STEPS,
    Newton,
    can_solve_in_kernel,
    point_on_path,
    solve_at,
    solve_robustly,
)
from fenics_crack.numerics.path import HOMOTOPY_OPTIONS, EndReason, Path, PathOptions, Target

BEYOND = 2.0
"""Ratio to the highest harmonic above which modes are quasi-static."""
ON_PATH = 15_000
"""Unknowns of all points together that one call of the kernel computes of a curve: Ctrl-C waits for
it, a second or two."""
SINGULAR = (
    "'penalty', with a stiffness, as some pairs hardly give beside others: they lie on a strip too "
    "thin for no penetration at all, or no modes are left out; or cracks farther apart"
)
"""Allowed values where R_inf, the quasi-static compliance of a rigid contact, is singular to
rounding."""
WITHOUT_GIVE = (
    "a penalty with a tangential stiffness, or crack faces without mass, "
    "reduce_structure(structure, method='massless'): pairs that stick must give a little"
)
"""Allowed values where pairs with friction have nothing in series."""
MATRICES_AT_A_TIME = 4
"""Dense matrices of the size of the Jacobian that are held at a time, or stiffnesses of coupled
pairs at all instants."""
COMPILED = 7500
"""Search budget: iterations of all initial guesses together, those of steps along a path that were
too long, too; with 300 unknowns in the kernel: 5 to 8 s."""
MIN_COSTLY_UNKNOWNS = 200
"""Unknowns below which an iteration takes no less time: integrals of the contact force are most of
it."""
RUBBING = 8e6
"""The same with friction, times the instants and the unknowns of a step, at most those of which J
is formed: 1 to 3 s."""


@dataclass(frozen=True)
class Problem:
    """A structure under its load, the law of its pairs, and how its motion is balanced.

    Attributes
    ----------
    structure : Structure
        Structure that vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law of all pairs; :class:`UnilateralConstraint` too.
    harmonics : int
        H, the highest multiple of ``omega / subharmonic`` kept.
    samples : int, optional
        Instants per period of the response at which the contact force is evaluated. Default: none,
        but exact integrals, where the law is piecewise linear; else 1024 for each period of the
        load, or 32 H where that is more.
    subharmonic : int
        The response has this many times the load's period.
    static_above : float, optional
        Modes of higher frequencies [rad/s] respond quasi-statically to the harmonics of the contact
        force above H, as all that a massless reduction truncates does. Default: 2 H times the base
        frequency, where all pairs have a residual flexibility then; else none.

    Raises
    ------
    InputError
        A value cannot be used.
    """

    structure: Structure
    omega: float
    contact: ContactLaw
    harmonics: int = SearchOptions.harmonics[0]
    samples: int | None = None
    subharmonic: int = 1
    static_above: float | None = None

    def __post_init__(self) -> None:
        check_omega(self.omega)
        check_count("subharmonic", self.subharmonic, 1)
        check_count("harmonics", self.harmonics, self.least_harmonics)
        check_law(self.structure, self.contact, rigid=True)
        if self.structure.n_pairs == 0:
            allowed = "one with contact pairs; else use solve_linear"
            raise InputError("structure", "0 pairs", allowed)
        if self.samples is not None:
            if is_rigid(self.contact):
                raise InputError("samples", self.samples, "left out with UnilateralConstraint")
            check_count("samples", self.samples, 2 * self.harmonics + 1)
            if self.samples > MAX_SAMPLES:
                raise InputError("samples", self.samples, f"at most {MAX_SAMPLES}")
        if self.static_above is not None:
            check_number("static_above", min(self.static_above, 1e300), 0.0)  # inf: none

    @property
    def least_harmonics(self) -> int:
        """The highest harmonic of the load, in the response's order."""
        return least_harmonics(self.structure, self.subharmonic)

    def few_harmonics(self, count: int) -> int:
        """Harmonics of the response of a number of the load's frequency, or as many as the load
        has."""
        return max(count * self.subharmonic, self.least_harmonics)

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def load(self) -> np.ndarray:
        """c: coefficients of the load, (2H+1, n_local) [N]."""
        return load_coefficients(self.structure, self.harmonics, self.subharmonic)

    @property
    def cutoff(self) -> float:
        """Frequency above which modes are quasi-static, where there is a :attr:`residual`
        [rad/s]."""
        default = BEYOND * self.harmonics * self.base_omega
        return default if self.static_above is None else self.static_above

    @property
    def static_cutoff(self) -> float | None:
        """The same, None without a residual flexibility: the value that solutions keep."""
        return None if self.residual is None else self.cutoff

    @cached_property
    def seen(self) -> Structure:
        """The structure with all gaps on which contact acts as its pairs: with friction normal and
        tangential ones."""
        return seen_by(self.contact, self.structure)

    @property
    def friction(self) -> bool:
        """True if the tangential forces of pairs are balanced, too."""
        return friction_of(self.contact) is not None

    @cached_property
    def residual(self) -> np.ndarray | None:
        """R_inf, the residual flexibility in series with contact; None where there is none.

        Crack faces with mass have one if the law is rigid, or so stiff against it that
        they bounce at frequencies which H harmonics do not resolve."""
        structure, contact = self.structure, self.contact
        if self.friction:
            return self._residual_with_friction
        light, rigid = structure.light_lips, is_rigid(contact)
        projected = is_rigid(contact) and contact.weight is not None and not light
        if projected or not is_small(structure):
            return None
        found = all_modes(self.seen).static_part(self.cutoff)
        if not light and not rigid:
            asked = self.static_above is not None and np.any(found)
            # A penalty k is stiff from k R_inf = 100 on.
            if not asked and not float(np.max(contact.stiffness * np.diag(found))) > 100.0:
                return None
        if rigid and not is_regular(found):
            if light:
                raise InputError("contact law", "unilateral", SINGULAR)
            return None
        return found

    @property
    def _residual_with_friction(self) -> np.ndarray | None:
        """That of normals and tangents, which all see what they have in series."""
        small, springs = is_small(self.structure), springs_of(self.contact, self.structure.n_pairs)
        found = all_modes(self.seen).static_part(self.cutoff) if small else None
        at_once = np.diag(springs) if found is None else found + np.diag(springs)
        if not np.all(springs) and not is_regular(at_once):
            raise InputError("contact", self.contact, WITHOUT_GIVE)
        return found

    def seen_alike(self, cutoff: float) -> Problem:
        """The same for a family of problems: whether pairs have a residual flexibility, and that of
        which modes, is settled for all of them by a frequency [rad/s]."""
        highest = cutoff / (BEYOND * self.harmonics)
        known = replace(self, static_above=None, omega=highest * self.subharmonic).residual
        return replace(self, static_above=np.inf if known is None else cutoff)

    @property
    def projected(self) -> bool:
        """True if the constraint is balanced in frequency: that of pairs without coupling."""
        return is_rigid(self.contact) and self.residual is None and not self.friction

    def weighted(self, compliance: Compliance) -> Problem:
        """The same with the weight of a projection."""
        contact = self.contact
        if not (is_rigid(contact) and self.projected and contact.weight is None):
            return self
        return replace(self, contact=replace(contact, weight=default_weight(compliance)))

    def system(self, compliance: Compliance) -> ContactSystem:
        """The equations."""
        return ContactSystem(compliance, self.weighted(compliance).integrals())

    def wave(self, at: ContactPoint) -> Wave:
        """The motion that belongs to a point of the equations (collective)."""
        displacement = at.system.compliance.displacement(at.force)
        return self.wave_of(displacement, at.gap, at.force)

    def wave_of(self, displacement: np.ndarray, gap: np.ndarray, force: np.ndarray) -> Wave:
        """The motion of coefficients of the displacement, and of the gaps and forces of all
        rows."""
        count = self.structure.n_pairs
        tangential = (gap[:, count:], force[:, count:]) if self.friction else (None, None)
        return Wave(
            self.structure, self.omega, self.contact, displacement, gap[:, :count],
            force[:, :count], self.subharmonic, self.static_cutoff, *tangential,
        )  # fmt: skip

    def integrals(self) -> ContactIntegrals:
        """Return the integrals of the contact force; those of a projection by its weight."""
        contact, harmonics = self.contact, self.harmonics
        if self.residual is not None:
            return coupled_integrals(contact, harmonics, self.residual, self.samples)
        if self.friction:
            nothing = np.zeros((self.seen.n_pairs,) * 2)
            return coupled_integrals(contact, harmonics, nothing, self.samples)
        if is_rigid(contact):
            assert contact.weight is not None
            each = np.eye(self.structure.n_pairs) / contact.weight
            return ExactIntegrals(contact, harmonics, residual=each)
        return contact_integrals(contact, harmonics, self.samples, self.subharmonic)

    def compliance(self) -> Compliance:
        """Compliance at the multiples of the base frequency, to be destroyed (collective)."""
        return dynamic_compliance(self.seen, self.base_omega, self.harmonics, self.subharmonic)

    def with_harmonics(self, harmonics: int) -> Problem:
        """The same with other harmonics."""
        return self if harmonics == self.harmonics else replace(self, harmonics=harmonics)


def least_harmonics(structure: Structure, subharmonic: int) -> int:
    """The highest harmonic of a structure's load, in the order of a response."""
    return subharmonic * (len(structure.force) // 2)


def check_memory(structure: Structure, harmonics: int) -> None:
    """Raise InputError where the dense Jacobian of the equations would not fit, or of coupled pairs
    what they are at all instants, and the vectors of solutions."""
    pairs = structure.n_pairs
    unknowns, order = (2 * harmonics + 1) * pairs, 2
    numbers = MATRICES_AT_A_TIME * unknowns**2
    if structure.light_lips:  # of an estimate too, with twice the harmonics
        vectors = 2 * kernel.KRYLOV_MOST + 2  # those kept, and those of a solution
        numbers, order = 2 * (2 * MATRICES_AT_A_TIME * pairs + vectors) * unknowns, 1
    memory = machine_memory()
    if 8 * numbers > 0.8 * memory:
        fits = int(harmonics * (0.1 * memory / numbers) ** (1.0 / order))
        needed, machine = (f"{size / 2**30:.0f}" for size in (8 * numbers, memory))
        sizes = f"{unknowns} unknowns need {needed} GiB of this machine's {machine}"
        raise InputError("harmonics", harmonics, f"at most {fits} with {pairs} pairs: {sizes}")


# --- the search -----------------------------------------------------------------------------------


Start = tuple[str, Iterator[np.ndarray]]
"""Name of a starting strategy, and its initial guesses."""


@dataclass
class Search:
    """The search for a solution of a system, and the record of the attempts."""

    system: ContactSystem
    problem: Problem
    """Problem that the system balances."""
    tolerance: float
    """Maximum |F| / |x| for acceptance; raised to the rounding error."""
    share: float
    """Fraction of the search budget that may be used."""
    remedy: str = (
        "other harmonics, a softer contact, more damping, or a neighbouring solution as initial"
    )
    """Changes that may lead to a solution where no attempt does."""
    converged: bool = False
    """True if the last attempt met the tolerance."""
    iterations: int = 0
    """Newton iterations, all attempts together."""
    orbit: PeriodicOrbit | None = None
    """Exact orbit from whose coefficients the last attempt began."""
    history: list[float] = field(default_factory=list)
    """``|F|`` of every iteration by SNES: where the kernel has the equations, of a last attempt
    when all have failed."""
    attempts: list[str] = field(default_factory=list)
    """Attempts and their outcomes, in words."""
    _rounding: float = ROUNDING
    _most: float = 0.0
    _fewer: ContactPoint | None = None

    @property
    def status(self) -> str:
        """All attempts, and a remedy where none led to a solution."""
        attempts = "; then ".join(self.attempts)
        if self.converged:
            return attempts
        return f"{attempts}; no solution in {self.iterations} iterations: try {self.remedy}"

    def solve(self, *starts: np.ndarray) -> Linearisation:
        """The equations where Newton's method arrives, or where it was last, from solutions nearby
        or from nothing.

        Raises InputError where the contact is so stiff that rounding leaves nothing of its force.
        """
        system = self.system
        if system.residual is None:
            self._rounding = rounding_left(system.compliance, system.integrals.law)
            if self._rounding > ROUNDING:
                self.tolerance = max(self.tolerance, self._rounding)
        self._most = self.share * _iterations(system)
        at: Linearisation | None = None
        with ExitStack() as held:
            snes = None
            if not can_solve_in_kernel(system):
                snes = held.enter_context(Newton(system, self.history))
            for name, guesses in self._starts(starts):
                begin(name)
                before = self.iterations
                for guess in guesses:
                    at = self._newton(snes, guess)
                    if self.converged or self._spent:
                        break
                self.tell(name, before)
                if self.converged:
                    break
        at = at or system.linearise(np.zeros(system.shape), 1.0)
        if not self.converged and snes is None and self.share == 1.0:  # for the record
            before = self.iterations
            with Newton(system, self.history) as snes:
                at = self._newton(snes, at.unknown)
            if self.converged:
                self.tell("full steps of SNES", before)
            else:
                self.iterations = before
        return at

    def tell(self, name: str, before: int) -> None:
        """Record the outcome of an initial guess."""
        outcome = "converged" if self.converged else "failed"
        self.attempts.append(f"{name}: {outcome} ({self.iterations - before} iterations)")

    def _newton(self, snes: Newton | None, guess: np.ndarray) -> Linearisation:
        """Return the point reached by full steps of SNES, or else of the kernel."""
        if snes is not None:
            at, self.converged, count = snes.solve(guess, 1.0, self.tolerance, self._at_once)
            self.iterations += count
            return at
        found = self._steps(self.system, guess)
        self.converged = found is not None
        return self.system.linearise(guess, 1.0) if found is None else found

    def _steps(
        self, system: ContactSystem, guess: np.ndarray, tolerance: float = 0.0, at: float = 1.0
    ) -> Linearisation | None:
        """Return the point reached by full steps, to a tolerance that is larger than the search's,
        or at a point of the path; None where they do not converge."""
        most, sharp = self._at_once, max(self.tolerance, tolerance)
        found = solve_at(system, guess, at, tolerance=sharp, iterations=most)
        self.iterations += most if found is None else found.iterations
        return None if found is None else found.linearisation

    @property
    def _at_once(self) -> int:
        """Iterations that a guess may take, which with many harmonics and friction are few."""
        return min(MAX_FULL_STEPS, math.ceil(self.share * _iterations(self.system)))

    @property
    def _spent(self) -> bool:
        return self.iterations >= self._most

    # --- the starts -------------------------------------------------------------------------------

    def _starts(self, starts: Sequence[np.ndarray]) -> Iterator[Start]:
        """Yield the initial guesses in the order in which they are tried."""
        system, problem = self.system, self.problem
        for start in starts:
            yield "full Newton steps", self._near(system, start)
        if problem.friction:
            yield "from contact without friction", self._add_friction(problem)
        else:
            many = system.residual is not None or system.size > kernel.MANY
            enough = problem.least_harmonics if many else problem.harmonics
            counts = halved(problem.harmonics, enough)
            name = "from fewer harmonics" if many else "full Newton steps"
            yield name, self._climb(problem, counts)
        quantity = "coefficient of friction" if problem.friction else "contact compliance"
        rest = [(f"continuation in the {quantity}", self._path(system))] * (not self._spent)
        if self.share == 1.0 and system.integrals.coupled and problem.harmonics <= self._many:
            flow = flow_of(problem.structure, problem.contact)
            late = flow is not None and flow.n_modes > MAX_MODES_FOR_MONODROMY
            rest.insert(len(rest) * late, ("from an exact orbit", self._next_to_orbit(problem)))
        yield from rest

    @property
    def _many(self) -> int:
        """Harmonics from which on an exact orbit is sought first."""
        return self.problem.few_harmonics(SearchOptions.harmonics[-1])

    def _near(self, system: ContactSystem, guess: np.ndarray) -> Iterator[np.ndarray]:
        """A guess, and where steps from there lead that are shortened where the residual would
        grow."""
        yield guess
        if self._spent:
            return
        point = solve_robustly(system, guess, 1.0, tolerance=self.tolerance, try_full_steps=False)
        self.iterations += MAX_STALLED_STEPS if point is None else point.iterations
        if point is not None:
            yield point.unknown

    def _climb(self, problem: Problem, counts: list[int]) -> Iterator[np.ndarray]:
        """Guesses for the last of some numbers of harmonics: the solution with the number before,
        for the first the linear one; where one is not found it is left out."""
        for count in counts:
            if self._many < count <= 2 * self._many:
                yield from self._next_to_orbit(problem)
            system, before, at = self.system, self.iterations, self._fewer
            if count != counts[-1]:
                few = resized_compliance(system.compliance, count)
                system = problem.with_harmonics(count).system(few)
            start = system.linear if at is None else system.slow(at.gap, at.force)
            if system is self.system:
                yield from self._near(system, start)
                continue
            found = self._nearly(system, self._near(system, start))
            self._most += self.iterations - before  # these cost little
            if found is None and not system.matrix_free:
                found = self._nearly(system, self._path(system, 0.5))
            self._fewer = found or at

    def _nearly(self, system: ContactSystem, guesses: Iterator[np.ndarray]) -> ContactPoint | None:
        """The first of some guesses from which full steps arrive, to the accuracy of a guess."""
        found = (self._steps(system, guess, COARSE_TOLERANCE) for guess in guesses)
        return next((system.linearise(one.unknown) for one in found if one is not None), None)

    def _add_friction(self, problem: Problem) -> Iterator[np.ndarray]:
        """The solution without friction, with the forces that belong to it."""
        free, system = replace(problem, contact=normal_law(problem.contact)), self.system
        compliance = free.compliance()
        try:
            search = Search(free.system(compliance), free, self.tolerance, 0.5 * self.share)
            at = search.solve()
        finally:
            compliance.destroy()
        self.iterations += search.iterations
        self._most += search.iterations  # these cost little
        if not search.converged:
            return
        force = np.zeros(system.shape)
        force[:, : at.unknown.shape[1]] = search.system.integrals.force(at.unknown)
        self._fewer = system.linearise(system.linear - respond(system.moving, force))
        if problem.harmonics > self._many:
            yield from self._next_to_orbit(problem)
        yield self._fewer.unknown

    def _next_to_orbit(self, problem: Problem) -> Iterator[np.ndarray]:
        """The slow gap of the exact orbit next to the solution with fewer harmonics, or from rest;
        where it does not take long to find."""
        flow, at = flow_of(problem.structure, problem.contact), self._fewer
        omega, periods, guesses = problem.omega, problem.subharmonic, list[np.ndarray]()
        if flow is None or not is_affordable(flow, omega, periods):
            return
        if at is not None:
            moved = self.system.compliance.displacement(
                resize_harmonics(at.force, problem.harmonics)
            )
            guesses.append(wave_states(flow, moved, problem.base_omega))
        self.orbit = search_orbit(flow, omega, guesses, periods, prefer_stable=False).orbit
        if self.orbit is not None:
            known = self.orbit.coefficients(problem.harmonics)
            self._most += self._at_once
            self.remedy = "a tolerance, which takes the exact orbit that was found"
            yield from self._near(self.system, self.system.slow(known.gap, known.force))
        self.orbit = None

    def _path(self, system: ContactSystem, share: float = 1.0) -> Iterator[np.ndarray]:
        """The end of the continuation in the contact compliance, or with friction in its
        coefficient, by a share of the iterations left; one that goes as far beyond is left."""
        begun: Linearisation | None = self._fewer
        if self.problem.friction:
            system = system.along_friction()
        else:
            system = system.softened()
            begun = self._steps(system, system.linear, at=0.0)
        if begun is None:
            return
        left = 1 + max(0, int(share * (self._most - self.iterations)))
        most = self.iterations + left
        at_once = min(PathOptions.points_per_call, 1 + left // MAX_STALLED_STEPS)
        options = replace(
            HOMOTOPY_OPTIONS, rounding=self._rounding, max_steps=left, points_per_call=at_once
        )
        path = Path(system, point_on_path(system, begun.unknown, 0.0), options, [Target(1.0)])
        for point in path.points():
            self.iterations += point.iterations
            if self.iterations >= most:
                return
        if path.end_reason is EndReason.REACHED:
            yield path.last_point.unknown


def halved(harmonics: int, enough: int) -> list[int]:
    """Numbers of harmonics, each about half of the next, down to one that is enough."""
    counts = [harmonics]
    while counts[0] > enough:
        counts.insert(0, max((counts[0] + 1) // 2, enough))
    return counts


def rounding_left(compliance: Compliance, law: ContactLaw) -> float:
    """Return the rounding error of |F| / |x| of uncoupled pairs, by the largest k R.

    Raises InputError where that is nothing of the contact force.
    """
    stiffest, seen = float(np.max(law.stiffness)), np.abs(compliance.matrices).sum(axis=2)
    most = COARSE_TOLERANCE / (MACHINE_EPSILON * float(seen[0].max(initial=1e-300)))
    if not stiffest < most:
        allowed = f"at most {most:.2g} N/m on this structure, beyond which rounding leaves nothing"
        allowed += "; UnilateralConstraint is the limit"
        raise InputError("contact stiffness", stiffest, allowed)
    return residual_rounding(stiffest * float(seen.max(initial=0.0)))


def _iterations(system: ContactSystem) -> float:
    """Return the iterations that a search may take: they cost like the square of many unknowns
    where the kernel has them."""
    integrals = system.integrals
    if isinstance(integrals, FrictionIntegrals):
        return RUBBING / (integrals.instants * system.work)
    dense = COMPILED * (300.0 / max(MIN_COSTLY_UNKNOWNS, system.size)) ** 2
    if getattr(system, "compiled", None) is not None:
        return dense
    interpreted = COMPILED / 5  # in Python, in the same time
    return interpreted if system.matrix_free else min(interpreted, dense)
