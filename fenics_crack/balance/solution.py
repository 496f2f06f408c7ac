"""Periodic solution of harmonic balance, its stability, and its solver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property, partial
from typing import Any, ClassVar

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.compliance import ComplianceModel
from fenics_crack.balance.contact_system import ContactPoint, PeriodicMotion
from fenics_crack.balance.error_report import ErrorReport, estimate_errors
from fenics_crack.balance.more_modes import MoreModesComparison
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.basics.errors import ConvergenceError, check_number
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    RAD_PER_TURN,
    Described,
    add_frequency_entries,
    format_count,
    format_quantity,
)
from fenics_crack.model.contact import (
    check_slope,
    friction_coefficient_of,
    is_unilateral,
    split_pairs_into_layers,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import STIFFNESS_SOLUTION_ROUNDING
from fenics_crack.motion.energy import EnergyBudget, far_frequency, load_works, series_work
from fenics_crack.motion.motions import MotionRecord, ObservedMotion
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.motion.search import SearchOptions
from fenics_crack.numerics.fourier import (
    differentiate,
    evaluate_series,
    resize_harmonics,
    sample_period,
)


@dataclass(frozen=True, repr=False)
class Stability(Described):
    """Floquet multipliers and the stability of a periodic solution.

    Attributes
    ----------
    multipliers : (n,) complex
        Factors by which small disturbances grow in a period; largest modulus first. For an
        irregular motion: the growth of a small disturbance in a period, then nan.
    verdict : "stable", "unstable", "irregular" or "undecided"
        Stability of the nearest exact orbit; for a smooth law, of the linear flow along the
        solution. Irregular: no orbit was found, and a small disturbance of the exact motion that
        begins with the solution grows.
    uncertainty : float
        Uncertainty of the largest modulus. nan: the multipliers decide nothing, as no orbit was
        found.
    refined : bool
        True if the multipliers belong to an exact orbit.
    distance : float
        Relative distance between the gaps of solution and exact orbit: the actual error; nan
        without an orbit. The root mean square of the gap difference is divided by that of the
        orbit's gaps plus clearance. In the divisor a mean larger than the vibration counts only as
        much as the vibration.
    reason : str
        Why the verdict is "undecided" or "irregular"; else "".
    from_rest : str
        Outcome of the motion from rest, if it was integrated and does not settle to the solution;
        else "".
    rest_amplitude : float [m]
        Amplitude of the watched dof after the motion from rest has settled: half the
        peak-to-peak displacement over the whole period. nan: the motion does not settle.
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
        """Return the entries of a table row by name.

        "verdict"; "modulus", "real" and "imaginary" of the multiplier with the largest modulus;
        then "uncertainty", "refined", "distance", "reason", "from_rest" and "rest_amplitude". The
        last two belong to a motion from rest: a text if it does not settle to the solution, and the
        amplitude [m] after settling.
        """
        leading_multiplier = complex(self.multipliers[0])
        columns_by_name = {"verdict": self.verdict, "modulus": abs(leading_multiplier)}
        columns_by_name |= {"real": leading_multiplier.real, "imaginary": leading_multiplier.imag}
        return columns_by_name | {
            stability_field.name: getattr(self, stability_field.name)
            for stability_field in fields(self)[2:]
        }

    def _repr_text(self) -> str:
        reason_text = f" ({self.reason})" if self.reason else ""
        multiplier_text = (
            f"largest multiplier {abs(self.multipliers[0]):.6g} of {len(self.multipliers)}"
        )
        return f"{self.verdict}{reason_text}, {multiplier_text}, uncertainty {self.uncertainty:.2g}"


@keep_old_attribute_names(still="is_still")
@dataclass(frozen=True, repr=False)
class PeriodicSolution(PeriodicMotion, ObservedMotion, Described):
    """Steady vibration with contact, as a Fourier series.

        u(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t),    w = omega / subharmonic,    k = 1 .. H

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
        Rows a0, a1, b1, ..., aH, bH; columns are the dofs that this rank owns.
    gap_coefficients : (2H+1, n_pairs) [m]
        Normal gaps g = B^T u - g0 with clearances g0, rows in the same order, on every rank; g > 0:
        penetration.
    force_coefficients : (2H+1, n_pairs) [N]
        Normal contact forces, with rows and columns as for the gaps.
    subharmonic : int
        The response has this many times the load's period.
    static_above : float or None
        Modes of higher frequencies [rad/s] respond quasi-statically to contact forces, as do all
        modes that a massless reduction truncates (:class:`fenics_crack.Problem`). None: no mode
        does.
    tangential_gap_coefficients : (2H+1, n_pairs) [m] or None
        Tangential gaps, with rows and columns as for the normal gaps; None without friction.
    tangential_force_coefficients : (2H+1, n_pairs) [N] or None
        Friction forces, with the same rows and columns; None without friction.
    converged : bool
        True if the residual met the tolerance.
    status : str
        Attempts and their outcomes, in words.
    iterations : int
        Newton iterations of all attempts.
    stability : Stability or None
        Result of :func:`fenics_crack.floquet`, if a caller has set it.
    others : tuple of PeriodicOrbit
        Other exact orbits at this frequency that the search met.
    assessment : Assessment
        Assessment by the exact flow: the predicted error, and the nearest orbit.
    estimate : callable
        Function without arguments to compute the :attr:`report`.
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
        if self.assessment is None or not self.assessment.holds_for(self):
            wave = PeriodicMotion(
                **{
                    wave_field.name: getattr(self, wave_field.name)
                    for wave_field in fields(PeriodicMotion)
                }
            )
            object.__setattr__(self, "assessment", Assessment(wave))

    @property
    def report(self) -> ErrorReport:
        """Estimated errors, relative to the root mean square of the gap plus clearance.

        The errors are computed on first request; for a structure with many dofs, together with the
        solution.
        """
        return self.estimate()

    def reported(self, report: ErrorReport) -> PeriodicSolution:
        """Return this solution with another report of its errors."""
        return replace(self, estimate=lambda: report)

    @property
    def orbit(self) -> PeriodicOrbit | None:
        """Exact orbit whose Fourier coefficients the solution has.

        None: the coefficients solve the equations of harmonic balance.
        """
        return self.assessment.exact_orbit

    def displacement(self, time: np.ndarray, dofs: Sequence[int | None] = (None,)) -> np.ndarray:
        """Return displacements at times [s]: (len(time), len(dofs)) [m] (collective).

        ``dofs`` are dof numbers; None stands for the watched dof.
        """
        if self.residual_compliance is None:
            return evaluate_series(self.coefficients_at(dofs), self.base_omega, time)
        return self.structure.values_at(self.displacement_of_local_dofs(time), dofs)

    def function(self, time: float) -> Any:
        """Return the displacement at a time [s] as a Function of DOLFINx (collective).

        The Function lives on the structure's mesh, for ParaView and for variational forms.
        """
        check_number("time", time)
        return self.structure.function(self.displacement_of_local_dofs(np.array([time]))[0])

    def yield_motion_records(
        self, rows: np.ndarray, instants: int | None = None
    ) -> Iterator[MotionRecord]:
        """Yield the motion's :class:`MotionRecord`, at equally spaced instants of the period.

        Parameters
        ----------
        rows : (m, n_local)
            Factors: the product of each row with the displacement is recorded.
        instants : int, optional
            Number of instants; all results then follow from these samples. Default: as many as
            :meth:`instants` has.
        """
        friction_coefficient, static_motion_per_force = friction_coefficient_of(self.contact), None
        if self.static_above is not None and not self.is_still:
            static_motion_per_force = rows @ self._static_displacement_per_force
        motion_coefficients = self.structure.sum_over_ranks(
            self._denoised_displacement_coefficients @ rows.T
        )

        def evaluate_at(period_fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            """Return row products, gaps [m] and contact forces [N] at n positions in the period.

            ``period_fractions`` (n,) are the positions, from 0 to 1. The row products (n, m) are
            each of the m ``rows`` times the displacement. Gaps and forces are (n, n_columns).
            """
            return motion_gap_and_force(
                *self.basis_gaps_and_forces_at_phases(RAD_PER_TURN * period_fractions)
            )

        def motion_gap_and_force(
            basis: np.ndarray, gap: np.ndarray, force: np.ndarray
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            """Return row products (n, m) at n instants, then the given gaps and forces.

            The row products are each of the m ``rows`` times the displacement. ``basis`` (n, 2H+1)
            has the Fourier basis functions at the instants. ``gap`` [m] and ``force`` [N] are (n,
            n_columns).
            """
            row_products = basis @ motion_coefficients
            if static_motion_per_force is not None:
                row_products -= (
                    force - basis @ self.row_force_coefficients
                ) @ static_motion_per_force.T
            return row_products, gap, force

        exact_numbers = self.energy_budget.shares if self.energy_budget else {}
        if instants is None and self.orbit is not None:
            exact_numbers |= self.orbit.friction_number_by_name
        n_instants = instants or len(self.instants())
        period_fractions = np.arange(n_instants) / n_instants
        row_products, gap, force = motion_gap_and_force(
            *self.basis_gaps_and_forces_over_period(n_instants)
        )
        yield MotionRecord(
            self.omega, self.subharmonic, self.period * period_fractions, motion_coefficients,
            row_products, gap, force, structure=self.structure,
            friction_coefficient=friction_coefficient,
            # Friction forces follow from earlier ones.
            evaluate_at_period_fractions=evaluate_at if friction_coefficient is None else None,
            exact_number_by_name=exact_numbers,
        )  # fmt: skip

    @cached_property
    def energy_budget(self) -> EnergyBudget | None:
        """Work of the load and its losses in a period, of the exact orbit if the solution is one.

        None without contact pairs, and for a large structure that is not reduced.
        """
        if self.orbit is not None:
            return self.orbit.energy_budget
        if not self.gap_coefficients.size or not is_small(self.structure):
            return None
        modes = all_modes(self.structure).with_fast_modes_quasi_static(self.static_above)
        u, structure = self._denoised_displacement_coefficients, self.structure
        products = structure.sum_over_ranks(u @ structure.force.T)
        q = u @ modes.shapes_inverse.T
        damping_forces = modes.damping_force(differentiate(q, self.base_omega))
        friction = np.zeros(0)
        if self.tangential_force_coefficients is not None:
            assert self.tangential_gap_coefficients is not None
            friction = series_work(
                self.tangential_force_coefficients, self.tangential_gap_coefficients
            )
        return EnergyBudget(
            *load_works(products, self.subharmonic),
            series_work(damping_forces, q),
            friction,
            np.sqrt(modes.squares.clip(0.0)),
            far_frequency(structure, self.omega),
        )

    @property
    def _denoised_displacement_coefficients(self) -> np.ndarray:
        """Displacement coefficients, without rounding if nothing vibrates: (2H+1, n_local) [m].

        If the solution is :attr:`is_still`, all coefficients except the mean are zero.
        """
        coefficient_rows = self.displacement_coefficients
        return (
            resize_harmonics(coefficient_rows[:1], self.harmonics)
            if self.is_still
            else coefficient_rows
        )

    def coefficients_at(self, dofs: Sequence[int | None] = (None,)) -> np.ndarray:
        """Return displacement coefficients at dofs: (2H+1, len(dofs)) [m] (collective).

        ``dofs`` are dof numbers; None stands for the watched dof.
        """
        return self.structure.values_at(self._denoised_displacement_coefficients, dofs)

    @cached_property
    def breathes(self) -> bool:
        """True if at least one contact pair is both open and closed within the period."""
        time = self.instants()
        # The force of a smoothed law is never 0.
        signal_function = self.contact_force if is_unilateral(self.contact) else self.gap
        is_closed = signal_function(time) > 0.0
        return bool(np.any(is_closed.any(axis=0) & ~is_closed.all(axis=0)))

    @cached_property
    def is_still(self) -> bool:
        """True if the load is constant and the motion is rounding error (collective)."""
        coefficient_rows = self.displacement_coefficients
        load_motion_and_mean_coefficients = (
            self.structure.force[1:],
            coefficient_rows[1:],
            coefficient_rows[:1],
        )
        square_sums = self.structure.sum_over_ranks(
            np.array(
                [
                    np.sum(coefficient_part**2)
                    for coefficient_part in load_motion_and_mean_coefficients
                ]
            )
        )
        return bool(
            square_sums[0] == 0.0
            and square_sums[1] <= STIFFNESS_SOLUTION_ROUNDING**2 * square_sums[2]
        )

    def displacement_field(self, time: np.ndarray) -> np.ndarray:
        """Return the displacement of the whole structure at times [s] (collective).

        A reduced structure is expanded. The shape is (len(time), n_local) [m], for this rank's
        dofs.
        """
        return self.structure.expand(self.displacement_of_local_dofs(time))

    def instants(self) -> np.ndarray:
        """Return equally spaced times over the period, at which extremes are searched [s].

        There are 1024 times, or 8 H if that is more.
        """
        n_instants = max(1024, 8 * self.harmonics)
        return np.linspace(0.0, self.period, n_instants, endpoint=False)

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return the entries of a table row by name.

        The entries are frequency, contact extremes, errors, stability and status.
        """
        columns_by_name: dict[str, Any] = {
            "omega": float(self.omega),
            "harmonics": self.harmonics,
            "subharmonic": self.subharmonic,
            "pairs": self.gap_coefficients.shape[1],
        }
        columns_by_name |= self.face_indicators
        columns_by_name |= {
            f"{error_part_name}_error": part_error
            for error_part_name, part_error in self.report.to_dict().items()
        }
        columns_by_name["penetration_share"] = columns_by_name.pop("penetration_error")
        if self.stability is not None:
            columns_by_name["verdict"] = self.stability.verdict
            columns_by_name["multiplier"] = float(abs(self.stability.multipliers[0]))
        columns_by_name |= {"converged": self.converged, "iterations": int(self.iterations)}
        return add_frequency_entries(columns_by_name) | {"status": str(self.status)}

    def _repr_text(self) -> str:
        columns_by_name = self.to_dict()
        title_parts = [f"{self.omega:.6g} rad/s", f"H = {self.harmonics}"]
        if self.subharmonic > 1:
            title_parts.append(f"period of {self.subharmonic} loads")
        title_parts.append(format_count(columns_by_name["pairs"], "pair"))
        if columns_by_name["pairs"]:
            title_parts.append(f"opening {format_quantity(columns_by_name['opening'], 'm')}")
        if self.contact is None:
            title_parts.append("linear")
        elif self.report.estimated:
            error_text = "unknown" if self.report.unknown else f"{self.report.total:.2g}"
            title_parts.append(f"error {error_text}")
        if self.stability is not None:
            title_parts.append(self.stability.verdict)
        return ", ".join([*title_parts, "converged" if self.converged else "NOT CONVERGED"])


def solution_of(
    problem: Problem,
    point: ContactPoint,
    *,
    status: str,
    has_converged: bool = True,
    search: bool = True,
    assessment: Assessment | None = None,
) -> PeriodicSolution:
    """Return the periodic solution at a point of the harmonic-balance equations (collective).

    Errors are estimated on first request; for a large structure immediately, as factored matrices
    are not kept.

    Parameters
    ----------
    problem : Problem
        Problem that was solved.
    point : ContactPoint
        Equations linearised at the solution, with coefficients of gaps and contact forces.
    status : str
        Attempts and their outcomes, in words.
    has_converged : bool
        True if the equations are solved.
    search : bool
        True: the error is the distance to the exact orbit. False: it is predicted.
    assessment : Assessment, optional
        Comparison of the solution's motion with exact motions. Default: a new one.
    """
    assessment = assessment or Assessment(problem.wave(point))
    estimate_options = {"search": search, "has_converged": has_converged}
    estimate_function = partial(estimate_errors, point, assessment, problem, **estimate_options)
    solution = PeriodicSolution(
        **vars(assessment.wave),
        status=status,
        converged=has_converged,
        assessment=assessment,
        estimate=cache(estimate_function),
    )
    if not is_small(problem.structure):  # factors are not kept
        solution.estimate()
    return solution


@dataclass(frozen=True)
class HarmonicBalanceSolver:
    """Solver for a harmonic-balance problem, with the coefficients of gaps as unknowns.

    Two options can be set: the maximum residual, and whether a failure raises an error.
    """

    problem: Problem
    residual_tolerance: float = 1e-10
    """Maximum relative residual |F(x)| / |x| of a solution x."""
    throw: bool = True
    """True: raise ConvergenceError without convergence. False: return the last iterate."""

    def solve(self, initial: PeriodicSolution | None = None) -> PeriodicSolution:
        """Solve from a neighbouring solution ``initial``, or from the linear one (collective).

        Raises
        ------
        InputError
            Nothing converged, and the law's tangent is not the slope of its force.
        ConvergenceError
            Nothing converged, and ``throw`` is True.
        """
        search, solution = self.search_and_solution(initial)
        if not search.has_converged:
            self._check_law_slope(solution.gap_coefficients)
        if self.throw and not search.has_converged:
            case_text = f"at {self.problem.omega:g} rad/s, H = {self.problem.harmonics}"
            raise ConvergenceError(
                f"harmonic balance {case_text}: {search.status}", search.snes_residual_norms
            )
        return solution

    def _check_law_slope(self, gap_coefficients: np.ndarray) -> None:
        """Raise InputError unless the tangent of a user's law is the slope of its force.

        Both are compared at gaps with the given coefficients (2H+1, n_pairs) [m] over a period, and
        at their negatives.
        """
        if is_unilateral(self.problem.contact):
            return
        gap_samples = sample_period(gap_coefficients, 4 * len(gap_coefficients))
        with np.errstate(all="ignore"):  # gaps may be far outside the law's range
            check_slope(self.problem.contact, np.concatenate([gap_samples, -gap_samples]))

    def search_and_solution(
        self,
        initial: PeriodicSolution | None,
        *,
        with_whole_budget: bool = True,
        more_modes: MoreModesComparison | None = None,
    ) -> tuple[Search, PeriodicSolution]:
        """Search for a solution of the problem.

        Parameters
        ----------
        initial : PeriodicSolution or None
            Neighbouring solution at which the search starts; None: the linear solution.
        with_whole_budget : bool
            False: the search may use a quarter of its iterations.
        more_modes : MoreModesComparison, optional
            Nearest orbit and its motion with more modes, if known.

        Returns
        -------
        search : Search
            Record of all attempts.
        solution : PeriodicSolution
            Solution, or last iterate if ``solution.converged`` is False.
        """
        compliance_model = self.problem.compliance_model()
        budget_fraction = (
            1.0 if with_whole_budget else 1.0 / len(SearchOptions.guess_harmonic_counts)
        )
        try:
            problem = self.problem.with_projection_weight(compliance_model)
            search, end_point, wave = replace(self, problem=problem).search_point_and_wave(
                compliance_model, initial, budget_fraction
            )
            solution = solution_of(
                problem, end_point, status=search.status, has_converged=search.has_converged,
                assessment=Assessment(
                    wave,
                    source_orbit=more_modes.orbit_with_fewer_modes if more_modes else search.orbit,
                    more_modes=more_modes,
                ),
            )  # fmt: skip
        finally:
            compliance_model.destroy()
        return search, replace(solution, iterations=search.iterations)

    def search_point_and_wave(
        self,
        compliance_model: ComplianceModel,
        initial: PeriodicSolution | None,
        budget_fraction: float = 1.0,
    ) -> tuple[Search, ContactPoint, PeriodicMotion]:
        """Search for a solution of the harmonic-balance equations.

        Parameters
        ----------
        compliance_model : ComplianceModel
            Dynamic compliance of the problem.
        initial : PeriodicSolution or None
            Neighbouring solution at which the search starts; None: the linear solution.
        budget_fraction : float
            Fraction of the search's iterations to use, 0 to 1.

        Returns
        -------
        search : Search
            Record of all attempts.
        point : ContactPoint
            Last point, converged or not.
        wave : PeriodicMotion
            Motion at the point.
        """
        problem = self.problem
        system, start_slow_gaps = problem.system(compliance_model), []
        if initial is not None:
            n_periods = problem.subharmonic // initial.subharmonic
            initial_gap_and_force_coefficients = split_pairs_into_layers(
                problem.contact,
                problem.structure.n_pairs,
                initial.row_gap_coefficients,
                initial.row_force_coefficients,
            )
            if (
                initial_gap_and_force_coefficients[0].shape[1] == system.shape[1]
            ):  # False: the initial solution has no friction
                start_slow_gaps.append(
                    system.gap_without_static_part(*initial_gap_and_force_coefficients, n_periods)
                )
        search = Search(system, problem, self.residual_tolerance, budget_fraction)
        point = search.solve(*start_slow_gaps)
        # The kernel's points do not know the forces.
        point = point if isinstance(point, ContactPoint) else system.linearise(point.unknown)
        return search, point, problem.wave(point)
