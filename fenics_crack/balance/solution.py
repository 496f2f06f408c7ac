"""A periodic solution: Fourier coefficients, what can be asked of them, and how it is found."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property, partial
from typing import Any, ClassVar

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.compliance import Compliance
from fenics_crack.balance.contact_system import ContactPoint, Wave
from fenics_crack.balance.error_report import ErrorReport, estimate_errors
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.basics.errors import ConvergenceError, check_number
from fenics_crack.basics.tables import TURN, Described, counted, quantity, with_frequency
from fenics_crack.model.contact import check_slope, coefficient_of, is_unilateral
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import NEGLIGIBLE
from fenics_crack.motion.motions import ObservedMotion, Record
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.motion.search import SearchOptions
from fenics_crack.numerics.fourier import evaluate, resize_harmonics, sample_period


@dataclass(frozen=True, repr=False)
class Stability(Described):
    """Floquet multipliers and what follows from them.

    Attributes
    ----------
    multipliers : (2n,) complex
        Largest modulus first; of an irregular motion the growth of a small disturbance in a period,
        and nan.
    verdict : "stable", "unstable", "irregular" or "undecided"
        Verdict on the nearest exact orbit; of a smooth law, of the linear flow along it. Irregular:
        no orbit was found, and a small disturbance of the exact motion that begins with the
        solution grows.
    uncertainty : float
        Of the largest modulus; nan where the multipliers are those of the solution: they decide
        nothing.
    refined : bool
        True if these are the multipliers of an exact orbit.
    distance : float
        From the solution to this orbit, in the gaps over the period, relative to what moves of
        B^T u as the estimated errors are: what the error was found to be. nan: no orbit.
    reason : str
        Why no orbit decides; "" where one does.
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
        largest = f"largest multiplier {abs(self.multipliers[0]):.6g} of {len(self.multipliers)}"
        return f"{self.verdict}{because}, {largest}, uncertainty {self.uncertainty:.2g}"


@dataclass(frozen=True, repr=False)
class PeriodicSolution(Wave, ObservedMotion, Described):
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
    stability : Stability or None
        Set by :func:`fenics_crack.floquet`.
    others : tuple of PeriodicOrbit
        Exact orbits at the same frequency that were met when this one was sought.
    assessment : Assessment
        Assessment by the exact flow: the predicted error, and the nearest orbit.
    estimate : callable
        Gives the :attr:`report`.
    """

    converged: bool = True
    status: str = "linear"
    iterations: int = 0
    stability: Stability | None = None
    others: tuple[PeriodicOrbit, ...] = field(default=(), compare=False)
    assessment: Assessment = field(default=None, compare=False)  # type: ignore[assignment]
    estimate: Callable[[], ErrorReport] = field(default=ErrorReport, compare=False)

    KIND: ClassVar[str] = "periodic solution"

    def __post_init__(self) -> None:
        if self.assessment is None or not self.assessment.is_of(self):
            wave = Wave(**{one.name: getattr(self, one.name) for one in fields(Wave)})
            object.__setattr__(self, "assessment", Assessment(wave))

    @property
    def report(self) -> ErrorReport:
        """Estimated errors, relative to the gap's amplitude; computed when first requested, of a
        structure of many dofs with the solution."""
        return self.estimate()

    def reported(self, report: ErrorReport) -> PeriodicSolution:
        """The same with a report."""
        return replace(self, estimate=lambda: report)

    @property
    def orbit(self) -> PeriodicOrbit | None:
        """The exact orbit whose Fourier coefficients these are; None where they are balanced."""
        return self.assessment.exact_orbit

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

    def records(self, rows: np.ndarray, instants: int | None = None) -> Iterator[Record]:
        """The motion, at as many instants as :meth:`instants` has; at as many as are given all
        numbers are from these."""
        friction, moved = coefficient_of(self.contact), None
        if self.static_above is not None and not self.still:
            moved = rows @ all_modes(self.row_structure).moved_at_once(self.static_above)
        waves = self.structure.sum_over_ranks(self._moving @ rows.T)

        def at(parts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return seen(*self.at_phase(TURN * parts))

        def seen(
            values: np.ndarray, gap: np.ndarray, force: np.ndarray
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            motion = values @ waves
            if moved is not None:
                motion -= (force - values @ self.force_rows) @ moved.T
            return motion, gap, force

        count = instants or len(self.instants())
        parts = np.arange(count) / count
        motion, gap, force = seen(*self.over_period(count))
        yield Record(
            self.omega, self.subharmonic, self.period * parts, waves, motion, gap, force,
            structure=self.structure,
            friction=friction,
            # Forces of friction follow from those before.
            evaluate=at if friction is None else None,
            exact_numbers={} if instants or self.orbit is None else self.orbit.sliding,
        )  # fmt: skip

    @property
    def _moving(self) -> np.ndarray:
        """Coefficients of the displacement without the rounding of what is still."""
        rows = self.displacement_coefficients
        return resize_harmonics(rows[:1], self.harmonics) if self.still else rows

    def coefficients_at(self, dofs: Sequence[int | None] = (None,)) -> np.ndarray:
        """Coefficients of the displacement of dofs: (2H+1, len(dofs)) [m] (collective)."""
        return self.structure.values_at(self._moving, dofs)

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
        found |= self.faces
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
    known: Assessment | None = None,
) -> PeriodicSolution:
    """The solution that belongs to a point of the condensed equations, by default with the motion
    that follows from it (collective), else with the one that is ``known``.

    With ``search`` its error is by its exact orbit; else it is what is predicted without.
    """
    known = known or Assessment(problem.wave(at))
    how = {"search": search, "converged": converged}
    estimate = partial(estimate_errors, at, known, problem, **how)
    found = PeriodicSolution(
        **vars(known.wave),
        status=status,
        converged=converged,
        assessment=known,
        estimate=cache(estimate),
    )
    if not is_small(problem.structure):  # its factors do not stay
        found.estimate()
    return found


@dataclass(frozen=True)
class Solver:
    """Solver of a problem, with its options."""

    problem: Problem
    residual_tolerance: float = 1e-10
    """Maximum |F| / |x| for acceptance."""
    throw: bool = True
    """Raise ConvergenceError if nothing converged; else return the last iterate."""

    def solve(self, initial: PeriodicSolution | None = None) -> PeriodicSolution:
        """Solve from a solution nearby, or from the linear one (collective); InputError where
        nothing converged and the law's tangent is not the slope of its force."""
        search, solution = self.attempt(initial)
        if not search.converged:
            self._check_slope(solution.gap_coefficients)
        if self.throw and not search.converged:
            case = f"at {self.problem.omega:g} rad/s, H = {self.problem.harmonics}"
            raise ConvergenceError(f"harmonic balance {case}: {search.status}", search.history)
        return solution

    def _check_slope(self, last: np.ndarray) -> None:
        """Raise InputError unless a law of one's own has the right tangent along the last gaps, by
        their coefficients (2H+1, n_pairs), and along those against them."""
        if is_unilateral(self.problem.contact):
            return
        gap = sample_period(last, 4 * len(last))
        with np.errstate(all="ignore"):  # they may be far beyond what the law is meant for
            check_slope(self.problem.contact, np.concatenate([gap, -gap]))

    def attempt(
        self, initial: PeriodicSolution | None, *, wholly: bool = True
    ) -> tuple[Search, PeriodicSolution]:
        """The same, whether or not it converged, and the record of the search."""
        compliance = self.problem.compliance()
        share = 1.0 if wholly else 1.0 / len(SearchOptions.harmonics)
        try:
            problem = self.problem.with_weight(compliance)
            search, at, wave = replace(self, problem=problem).find(compliance, initial, share)
            found = solution_of(
                problem, at, status=search.status, converged=search.converged,
                known=Assessment(wave, source=search.orbit),
            )  # fmt: skip
        finally:
            compliance.destroy()
        return search, replace(found, iterations=search.iterations)

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
