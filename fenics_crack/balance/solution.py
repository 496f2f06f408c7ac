"""A periodic solution: Fourier coefficients, what can be asked of them, and how it is found.

Among it are indicators of a breathing crack, numbers that change with the crack. Of a watched
displacement u(t) = a0 + sum_k a_k cos(k w t / m) + b_k sin(k w t / m), with the load at w and m
times its period, the amplitude at j times the load's frequency is

    U_j = sqrt(a_k^2 + b_k^2),      k = j m,

and a linear structure has U_1 alone. Crack faces that open and close once in a period act as a
stiffness that depends on the sign of the gap: they make even harmonics and a mean, U_2 / U_1 and a0
/ U_1, and at a period doubling U_1/2; all of these are independent of the size of the load as long
as there is no clearance (Dimarogonas, Engineering Fracture Mechanics 55, 1996, 831, reviews them).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.compliance import Compliance
from fenics_crack.balance.contact_system import ContactPoint, Wave
from fenics_crack.balance.error_report import (
    NOT_ESTIMATED,
    ErrorReport,
    estimate_errors,
    of_no_solution,
)
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.basics.errors import ConvergenceError, check_number
from fenics_crack.basics.tables import (
    OF_FRICTION,
    OF_LIPS,
    Described,
    Tabular,
    counted,
    in_hertz,
    quantity,
    with_frequency,
)
from fenics_crack.model.contact import check_slope, coefficient_of, is_unilateral
from fenics_crack.model.modes import NEGLIGIBLE
from fenics_crack.motion.orbit import KNOWN, PeriodicOrbit
from fenics_crack.motion.search import SearchOptions
from fenics_crack.numerics.extremes import InPeriod, half_range, largest
from fenics_crack.numerics.fourier import evaluate, resized, sampled


@dataclass(frozen=True, repr=False)
class Indicators(Tabular):
    """Indicators of a breathing crack at a point and at the crack faces.

    Made by ``indicators`` of a solution, where each attribute is a number, or of a curve, where
    each is an array with a value for every point (n,).

    Attributes
    ----------
    omega : [rad/s]
        Frequency of the load.
    amplitude : [m]
        Half the peak-to-peak displacement, of all harmonics together.
    mean : [m]
        a0, with the displacement by a mean load.
    harmonic_1, harmonic_2, harmonic_3 : [m]
        U_1, U_2, U_3: amplitudes at once, twice and three times the load's frequency.
    ratio_2_1, ratio_3_1 : [-]
        U_2 / U_1 and U_3 / U_1; nan where the solution has not so many harmonics, or no U_1.
    ratio_half_1 : [-]
        U_1/2 / U_1, at half the load's frequency; nan unless the solution has an even multiple of
        the load's period.
    ratio_largest, largest_order : [-]
        U_k / U_1 of the largest harmonic above the load's, and its order k; nan without one, the
        order also where all are rounding of the whole motion.
    mean_shift : [-]
        a0 / U_1, positive in the direction of the dof.
    opening, penetration : [m]
        The largest of any pair at any time; nan without pairs, as are the next three.
    contact_force : [N]
        The largest of any pair at any time: the finer the mesh, the smaller.
    crack_force : [N]
        The largest of a crack at any time, the sum over its pairs, which a finer mesh does not
        change; of matrices that of all pairs.
    closed_share : [-]
        Part of the period in which a pair carries a contact force, mean over the pairs.
    friction_loss : [J]
        Work of friction in a period of the response, of all pairs; nan without friction, as are
        the next two.
    stick_share, slip_share : [-]
        Part of the period in which a closed pair sticks and slips, mean over the pairs.
    """

    omega: Any
    amplitude: Any
    mean: Any
    harmonic_1: Any
    harmonic_2: Any
    harmonic_3: Any
    ratio_2_1: Any
    ratio_3_1: Any
    ratio_half_1: Any
    ratio_largest: Any
    largest_order: Any
    mean_shift: Any
    opening: Any
    penetration: Any
    contact_force: Any
    crack_force: Any
    closed_share: Any
    friction_loss: Any
    stick_share: Any
    slip_share: Any
    frequency = in_hertz()

    def to_dict(self) -> dict[str, Any]:
        """Numbers by name, or along a curve columns; those of friction where there is some."""
        columns = {item.name: np.asarray(getattr(self, item.name)) for item in fields(self)}
        return {
            name: column.tolist()
            for name, column in columns.items()
            if name not in OF_FRICTION or not np.all(np.isnan(column))
        }

    def _title(self) -> str:
        if np.ndim(self.omega):
            return f"{len(self.omega)} points"
        return f"amplitude = {self.amplitude:.4g} m, ratio_2_1 = {self.ratio_2_1:.3g}"


def indicators_of(
    omega: Any,
    coefficients: np.ndarray,
    amplitude: Any,
    contact: Mapping[str, Any],
    subharmonic: int = 1,
) -> Indicators:
    """Indicators from load frequencies (...), coefficients of a displacement (..., 2H+1), half its
    peak-to-peak values (...) and what :func:`extremes` has found of the crack faces
    (...)."""
    harmonics = (coefficients.shape[-1] - 1) // 2

    def at(multiple: float) -> Any:
        """U_j, nan where it is not among the harmonics."""
        order = multiple * subharmonic
        if order != int(order) or order > harmonics:
            return np.full(coefficients.shape[:-1], np.nan)[()]
        row = 2 * int(order)
        return np.hypot(coefficients[..., row - 1], coefficients[..., row])

    first, second, third, mean = at(1), at(2), at(3), coefficients[..., 0]
    unknown = np.full(coefficients.shape[:-1], np.nan)[()]
    largest = order = unknown
    if harmonics >= 2 * subharmonic:
        above = np.stack([at(k) for k in range(2, harmonics // subharmonic + 1)], axis=-1)
        largest, whole = above.max(axis=-1), np.abs(coefficients).max(axis=-1)
        order = np.where(largest > NEGLIGIBLE * whole, 2.0 + above.argmax(axis=-1), np.nan)[()]
    with np.errstate(invalid="ignore", divide="ignore"):
        known = np.where(first > 0.0, first, np.nan)
        ratios = [part / known for part in (second, third, at(0.5), largest)]
        shift = mean / known
    lips = {name: contact.get(name, unknown) for name in CONTACT}
    seen = mean, first, second, third, *ratios, order, shift
    return Indicators(omega, amplitude, *seen, **lips)


CONTACT = (*OF_LIPS, *OF_FRICTION)


def extremes(
    samples: tuple[np.ndarray, np.ndarray, np.ndarray],
    cracks: np.ndarray | None = None,
    coefficient: float | np.ndarray | None = None,
    at: InPeriod | None = None,
) -> tuple[np.ndarray, dict[str, float]]:
    """Half peak-to-peak values (m,) of motions; and opening [m], penetration [m] and force [N], the
    largest of any pair, the largest force of a crack, and the share of the time closed, mean over
    the pairs, with the crack of each pair, by default one of all; nothing without pairs. With a
    coefficient of friction what it does, too.

    Samples are motions (n, m), gaps and forces of all rows (n, n_rows) at equal parts of a period;
    extremes are to rounding where all are given at any parts of it."""
    (_, gap, force), many = samples, samples[0].shape[1]
    count = gap.shape[1] // (1 if coefficient is None else 2)
    every = np.zeros(count, dtype=int) if cracks is None else cracks
    members = every[:, None] == np.unique(every)

    def columns(motion: np.ndarray, gap: np.ndarray, force: np.ndarray) -> np.ndarray:
        lips = []
        if count:
            gap, force = gap[:, :count], force[:, :count]
            lips = [-gap.min(1), gap.max(1), force.max(1), (force @ members).max(1)]
        return np.column_stack([motion, -motion, *lips])

    tops = largest(columns(*samples), at and (lambda parts: columns(*at(parts))))
    ranges, sizes = 0.5 * (tops[:many] + tops[many : 2 * many]), tops[2 * many :]
    if not count:
        return ranges, {}
    sizes[:2] = np.maximum(sizes[:2], 0.0)
    found = dict(zip(OF_LIPS, sizes.tolist(), strict=False))
    found["closed_share"] = float(np.mean(force[:, :count] > 0.0))
    if coefficient is not None:
        found |= friction_numbers(coefficient, gap[:, count:], force[:, :count], force[:, count:])
    return ranges, found


def slipping(coefficient: float | np.ndarray, force: np.ndarray, drag: np.ndarray) -> np.ndarray:
    """Where pairs slip, by their contact and friction forces (n, n_pairs): (n, n_pairs) bool."""
    limit = (1.0 - KNOWN) * coefficient * force
    return np.asarray((force > 0.0) & (np.abs(drag) >= limit))


def friction_losses(slide: np.ndarray, drag: np.ndarray) -> np.ndarray:
    """Losses of pairs in a period, (n_pairs,) [J], int lambda_t g_t' dt by the trapezoidal rule:
    of tangential gaps and friction forces at parts of it (n, n_pairs)."""
    moved = np.roll(slide, -1, axis=0) - slide
    return np.asarray(0.5 * np.sum((np.roll(drag, -1, axis=0) + drag) * moved, axis=0))


def friction_numbers(
    coefficient: float | np.ndarray, slide: np.ndarray, force: np.ndarray, drag: np.ndarray
) -> dict[str, float]:
    """The loss by friction in a period [J], and the shares of it in which pairs stick and slip,
    means over the pairs: of tangential gaps, contact forces and friction forces at equal parts of
    it (n, n_pairs)."""
    slips = slipping(coefficient, force, drag)
    return {
        "friction_loss": float(np.sum(friction_losses(slide, drag))),
        "stick_share": float(np.mean((force > 0.0) & ~slips)),
        "slip_share": float(np.mean(slips)),
    }


@dataclass(frozen=True, repr=False)
class Stability(Described):
    """Floquet multipliers and what follows from them.

    Attributes
    ----------
    multipliers : (2n,) complex
        Largest modulus first.
    verdict : "stable", "unstable" or "undecided"
        Verdict on the nearest exact orbit; of a smooth law, of the linear flow along it.
    uncertainty : float
        Of the largest modulus; nan where the multipliers are those of the solution: they decide
        nothing.
    refined : bool
        True if these are the multipliers of an exact orbit.
    distance : float
        From the solution to this orbit, in the gaps over the period, relative to what moves of
        B^T u as the estimated errors are: what the error was found to be. nan: no orbit.
    reason : str
        Why nothing is decided; "" where it is.
    from_rest : str
        Outcome of the motion from rest, where that was integrated and it does not settle to the
        solution; else "".
    rest_amplitude : float [m]
        Half the peak-to-peak displacement of the watched dof to which it settles, over all periods
        of the load after which it repeats itself; nan: it does not.
    """

    multipliers: np.ndarray
    verdict: str
    uncertainty: float
    refined: bool = False
    distance: float = math.nan
    reason: str = ""
    from_rest: str = ""
    rest_amplitude: float = math.nan

    def to_dict(self) -> dict[str, Any]:
        """The verdict, and the multiplier of largest modulus."""
        largest = complex(self.multipliers[0])
        found = {"verdict": self.verdict, "modulus": abs(largest)}
        found |= {"real": largest.real, "imaginary": largest.imag}
        return found | {one.name: getattr(self, one.name) for one in fields(self)[2:]}

    def _title(self) -> str:
        because = f" ({self.reason})" if self.reason else ""
        return (
            f"{self.verdict}{because}, largest multiplier {abs(self.multipliers[0]):.6g} "
            f"of {len(self.multipliers)}, uncertainty {self.uncertainty:.2g}"
        )


@dataclass(frozen=True, repr=False)
class PeriodicSolution(Wave, Described):
    """Steady vibration u(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t), w = omega / subharmonic.

    Attributes
    ----------
    structure : Structure
        Structure that vibrates.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw or None
        Law between the crack faces; None for the linear solution with crack faces that pass through
        each other.
    displacement_coefficients : (2H+1, n_local) [m]
        Rows a0, a1, b1, ..., aH, bH; the columns of the dofs that this rank owns.
    gap_coefficients : (2H+1, n_pairs) [m]
        g = B^T u - g0, in the same order, on every rank; g > 0: penetration.
    force_coefficients : (2H+1, n_pairs) [N]
        Contact force, likewise.
    subharmonic : int
        The response has this many times the load's period.
    static_above : float or None
        Modes of higher frequencies [rad/s] respond quasi-statically to contact forces, as all that
        a massless reduction truncates does (:class:`fenics_crack.Problem`); None: none does.
    tangential_gap_coefficients : (2H+1, n_pairs) [m] or None
        g_t = B_t^T u of contact with friction, likewise.
    tangential_force_coefficients : (2H+1, n_pairs) [N] or None
        Friction force, likewise.
    converged : bool
        True if the residual met the tolerance.
    status : str
        Attempts and their outcomes, in words.
    iterations : int
        Newton iterations, all attempts together.
    report : ErrorReport
        Estimated errors, relative to the gap's amplitude.
    stability : Stability or None
        Set by :func:`fenics_crack.floquet`.
    others : tuple of PeriodicOrbit
        Exact orbits at the same frequency that were met when this one was sought.
    assessment : Assessment
        Assessment by the exact flow: the predicted error, and the nearest orbit.
    """

    converged: bool = True
    status: str = "linear"
    iterations: int = 0
    report: ErrorReport = ErrorReport()
    stability: Stability | None = None
    others: tuple[PeriodicOrbit, ...] = field(default=(), compare=False)
    assessment: Assessment = field(default=None, compare=False)  # type: ignore[assignment]

    KIND: ClassVar[str] = "periodic solution"

    def __post_init__(self) -> None:
        if self.assessment is None or not self.assessment.is_of(self):
            wave = Wave(**{one.name: getattr(self, one.name) for one in fields(Wave)})
            object.__setattr__(self, "assessment", Assessment(wave))

    @property
    def orbit(self) -> PeriodicOrbit | None:
        """The exact orbit whose Fourier coefficients these are; None where they are balanced."""
        return self.assessment.own

    def displacement(self, time: np.ndarray, dofs: Sequence[int | None] = (None,)) -> np.ndarray:
        """Displacement of dofs, or of the watched one, at times [s]: (len(time), len(dofs)) [m]
        (collective)."""
        if self.residual is None:
            return evaluate(self.coefficients_at(dofs), self.base_omega, time)
        return self.structure.values_at(self.coordinates(time), dofs)

    def function(self, time: float) -> Any:
        """Displacement at a time [s] as DOLFINx's Function, on the space of the mesh: for
        ParaView, and for further forms (collective)."""
        check_number("time", time)
        return self.structure.function(self.coordinates(np.array([time]))[0])

    def amplitude(self, dof: int | None = None) -> float:
        """Half the peak-to-peak displacement of a dof, or of the watched one [m] (collective)."""
        if self.still:
            return 0.0
        return float(half_range(*self.sampled(lambda time: self.displacement(time, [dof])))[0])

    def sampled(self, motion: Callable[[np.ndarray], Any]) -> tuple[Any, Any]:
        """A function of times [s] at :meth:`instants`, and the same function of parts of the
        period, None with friction, whose forces follow from those before: as for
        ``half_range`` of numerics.extremes."""
        exact = coefficient_of(self.contact) is None
        at = (lambda parts: motion(self.period * parts)) if exact else None
        return motion(self.instants()), at

    def indicators(self, dof: int | None = None) -> Indicators:
        """Return the indicators at a dof, or the watched one, and at the crack faces
        (collective)."""
        return indicators_of(
            self.omega,
            self.coefficients_at([dof])[:, 0],
            self.amplitude(dof),
            self._extremes,
            self.subharmonic,
        )

    @cached_property
    def _extremes(self) -> dict[str, float]:
        """Extremes of gap and contact force in the period."""
        samples, at = self.sampled(
            lambda time: (np.zeros((len(time), 0)), *self.gaps_and_forces(time))
        )
        cracks, friction = self.structure.pairs.cracks, coefficient_of(self.contact)
        found = extremes(samples, cracks, friction, at)[1]
        return found if self.orbit is None else found | self.orbit.sliding

    def coefficients_at(self, dofs: Sequence[int | None] = (None,)) -> np.ndarray:
        """Coefficients of the displacement of dofs: (2H+1, len(dofs)) [m] (collective)."""
        rows = self.displacement_coefficients
        rows = resized(rows[:1], self.harmonics) if self.still else rows
        return self.structure.values_at(rows, dofs)

    @cached_property
    def breathes(self) -> bool:
        """True if a pair of the crack faces closes and opens again within the period."""
        time = self.instants()
        # The force of a smoothed law is never 0.
        seen = self.contact_force if is_unilateral(self.contact) else self.gap
        closed = seen(time) > 0.0
        return bool(np.any(closed.any(axis=0) & ~closed.all(axis=0)))

    @cached_property
    def still(self) -> bool:
        """True if nothing vibrates: the load is steady, and what moves is rounding (collective)."""
        rows = self.displacement_coefficients
        parts = self.structure.force[1:], rows[1:], rows[:1]
        sizes = self.structure.sum_over_ranks(np.array([np.sum(part**2) for part in parts]))
        return bool(sizes[0] == 0.0 and sizes[1] <= NEGLIGIBLE**2 * sizes[2])

    def displacement_field(self, time: np.ndarray) -> np.ndarray:
        """Displacement of the whole structure's dofs on this rank: (len(time), n_local) [m]
        (collective)."""
        return self.structure.expand(self.coordinates(time))

    def instants(self) -> np.ndarray:
        """Equally spaced times [s] over the period, at which extremes are looked for: 1024, or 8 H
        where that is more."""
        count = max(1024, 8 * self.harmonics)
        return np.linspace(0.0, self.period, count, endpoint=False)

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Frequency, extremes of the contact, errors, and how the solution was found."""
        found: dict[str, Any] = {
            "omega": float(self.omega),
            "harmonics": self.harmonics,
            "subharmonic": self.subharmonic,
            "pairs": self.gap_coefficients.shape[1],
        }
        found |= self._extremes
        found |= {f"{name}_error": value for name, value in self.report.to_dict().items()}
        found["penetration_share"] = found.pop("penetration_error")
        if self.stability is not None:
            found["verdict"] = self.stability.verdict
            found["multiplier"] = float(abs(self.stability.multipliers[0]))
        found |= {"converged": self.converged, "iterations": int(self.iterations)}
        return with_frequency(found) | {"status": str(self.status)}

    def _title(self) -> str:
        found = self.to_dict()
        parts = [f"{self.omega:.6g} rad/s", f"H = {self.harmonics}"]
        if self.subharmonic > 1:
            parts.append(f"period of {self.subharmonic} loads")
        parts.append(counted(found["pairs"], "pair"))
        if found["pairs"]:
            parts.append(f"opening {quantity(found['opening'], 'm')}")
        if self.contact is None:
            parts.append("linear")
        elif self.report.estimated:
            error = "unknown" if self.report.unknown else f"{self.report.total:.2g}"
            parts.append(f"error {error}")
        if self.stability is not None:
            parts.append(self.stability.verdict)
        return ", ".join([*parts, "converged" if self.converged else "NOT CONVERGED"])


def solution_of(
    problem: Problem,
    at: ContactPoint,
    *,
    status: str,
    converged: bool = True,
    search: bool = True,
    reported: bool = True,
    wave: Wave | None = None,
    source: PeriodicOrbit | None = None,
) -> PeriodicSolution:
    """The solution that belongs to a point of the condensed equations, by default with the motion
    that follows from it (collective), found from the coefficients of the orbit ``source``.

    With ``search`` its exact orbit is looked for; else its error is what is predicted without; and
    nothing is estimated where it is not ``reported``, or of equations that are not solved.
    """
    wave = wave or problem.wave(at)
    known = Assessment(wave, source=source)
    found = PeriodicSolution(**vars(wave), status=status, converged=converged, assessment=known)
    if not reported:
        return replace(found, report=NOT_ESTIMATED)
    if not converged:
        return replace(found, report=of_no_solution(at, problem))
    return replace(found, report=estimate_errors(at, known, problem, search=search))


@dataclass(frozen=True)
class Solver:
    """Solver of a problem, with its options."""

    problem: Problem
    residual_tolerance: float = 1e-10
    """Maximum |F| / |x| for acceptance."""
    throw: bool = True
    """Raise ConvergenceError if nothing converged; else return the last iterate."""

    def solve(
        self, initial: PeriodicSolution | None = None, *, reported: bool = True
    ) -> PeriodicSolution:
        """Solve from a solution nearby, or from the linear one (collective); InputError where
        nothing converged and the law's tangent is not the slope of its force."""
        search, solution = self.attempt(initial, reported=reported)
        if not search.converged:
            self._check_slope(solution.gap_coefficients)
        if self.throw and not search.converged:
            raise ConvergenceError(
                f"harmonic balance at {self.problem.omega:g} rad/s, "
                f"H = {self.problem.harmonics}: {search.status}",
                search.history,
            )
        return solution

    def _check_slope(self, last: np.ndarray) -> None:
        """Raise InputError unless a law of one's own has the right tangent along the last gaps, by
        their coefficients (2H+1, n_pairs), and along those against them."""
        if is_unilateral(self.problem.contact):
            return
        gap = sampled(last, 4 * len(last))
        with np.errstate(all="ignore"):  # they may be far beyond what the law is meant for
            check_slope(self.problem.contact, np.concatenate([gap, -gap]))

    def attempt(
        self, initial: PeriodicSolution | None, *, wholly: bool = True, reported: bool = True
    ) -> tuple[Search, PeriodicSolution]:
        """The same, whether or not it converged, and the record of the search; its errors are
        estimated unless they are not requested."""
        compliance, share = self.compliance(), 1.0 if wholly else 1.0 / len(SearchOptions.harmonics)
        try:
            problem = self.problem.weighted(compliance)
            search, at, wave = replace(self, problem=problem).find(compliance, initial, share)
            found = solution_of(
                problem, at, status=search.status, converged=search.converged, reported=reported,
                wave=wave, source=search.orbit,
            )  # fmt: skip
        finally:
            compliance.destroy()
        return search, replace(found, iterations=search.iterations)

    def compliance(self) -> Compliance:
        """Compliance of the structure, to be destroyed (collective)."""
        return self.problem.compliance()

    def find(
        self, compliance: Compliance, initial: PeriodicSolution | None, share: float = 1.0
    ) -> tuple[Search, ContactPoint, Wave]:
        """A search, the equations where it arrives, and the motion there."""
        problem = self.problem
        system, starts = problem.system(compliance), []
        if initial is not None:
            times = problem.subharmonic // initial.subharmonic
            rows = initial.gap_rows, initial.force_rows
            if rows[0].shape[1] == system.shape[1]:  # else the other one is without friction
                starts.append(system.slow(*rows, times))
        search = Search(system, problem, self.residual_tolerance, share)
        at = search.solve(*starts)
        # The kernel's points do not know the forces.
        at = at if isinstance(at, ContactPoint) else system.linearise(at.unknown)
        return search, at, problem.wave(at)
