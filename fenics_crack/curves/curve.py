"""Response curves: solutions along a parameter, and their bifurcations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np

from fenics_crack.balance.assessment import MAX_HARMONIC_DOUBLINGS_FOR_ORBIT, Assessment
from fenics_crack.balance.contact_system import ContactPoint
from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.harmonic_balance import (
    orbit_solution_to_tolerance,
    truncated_orbit_solution,
)
from fenics_crack.balance.more_modes import ERROR_IF_UNKNOWN
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    Described,
    Tabular,
    add_frequency_entries,
    choose_frequency_factor_name_unit,
    choose_speed_factor_name_unit,
    format_count,
    hertz_property,
)
from fenics_crack.curves.balance_equations import (
    EQUATIONS_CLASS_BY_PARAMETER,
    BalanceAlongVibratingLoadFactor,
    BalanceEquations,
)
from fenics_crack.curves.orbits import OrbitEquations, system_along
from fenics_crack.curves.peak import (
    LargestResponse,
    Peak,
    damping_by_half_power_width,
    interpolate_peak_and_damping,
)
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, is_unilateral
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import ContactFlow, exact_flow_or_none
from fenics_crack.motion.motions import MotionRecord, ObservedMotion
from fenics_crack.motion.orbit import (
    MULTIPLIER_TOLERANCE,
    NEUTRAL_MULTIPLIER_TEXT,
    OBSERVED_HARMONICS,
    PeriodicOrbit,
    orbit_from_converged_state,
)
from fenics_crack.motion.search import SearchOptions

DESCRIPTION_BY_PARAMETER = {
    "omega": "load frequency [rad/s]",
    "load": "load, as a multiple of the scene's [-]",
    "stiffness": "contact stiffness, as a multiple of the scene's [-]",
    "damping": "damping, as a multiple of the scene's [-]",
    "clearance": "clearance added to the scene's [m]",
    "friction": "coefficient of friction, as a multiple of the scene's [-]",
    "speed": "rotor speed [rad/s]",
    "resonance": "load at resonance, as a multiple of the scene's [-]",
}
"""Description with unit of each parameter in :attr:`ResponseCurve.parameter`, for axes and tables.
"""

MIN_ORBIT_HARMONICS = SearchOptions.guess_harmonic_counts[0]
"""Minimum harmonics of the load frequency in a solution from an exact orbit: 5."""
OBSERVED_INSTANTS_PER_PERIOD = 256
"""Instants per period at which the motion at a curve's point is observed."""
MAX_MISSED_INSTABILITY_TO_STEP = 0.1
"""Width of an unstable window that a curve may miss, relative to the longest step.

Step control interpolates multipliers between the ends of a step. The interpolation is wrong if
orbits graze, or if several multipliers collide in one step.
"""


def axis_factor_name_and_unit(parameter: str, in_hertz: bool) -> tuple[float, str, str]:
    """Return factor, name and unit for printing values of a curve's parameter.

    A printed value is the factor times the value. If ``in_hertz`` is True, frequencies are in Hz
    and speeds in rpm, else both in rad/s. For other parameters the factor is 1.
    """
    if parameter in ("omega", "speed"):
        return (
            choose_frequency_factor_name_unit
            if parameter == "omega"
            else choose_speed_factor_name_unit
        )(in_hertz)
    name, _, unit = DESCRIPTION_BY_PARAMETER[parameter].removesuffix("]").rpartition(" [")
    return 1.0, name, unit


def leading_multiplier_in_upper_half(multipliers: np.ndarray) -> complex:
    """Return the Floquet multiplier with the largest modulus, as a single number.

    ``multipliers`` (n,) are in descending order of modulus. If the largest has a negative imaginary
    part, the complex conjugate of the same pair is returned.
    """
    largest_multiplier = complex(multipliers[0])
    return complex(largest_multiplier.real, abs(largest_multiplier.imag))


def kind_in_words(kind: str) -> str:
    """Return the printed name for a :attr:`Bifurcation.kind`, such as "period doubling"."""
    return "Neimark-Sacker" if kind == "neimark_sacker" else kind.replace("_", " ")


@keep_old_attribute_names(point="single_point_curve")
@dataclass(frozen=True, repr=False)
class Bifurcation(Described):
    """Special point of a curve.

    Attributes
    ----------
    kind : str
        "fold": the curve turns back. "branch_point": another branch crosses. "period_doubling": a
        multiplier leaves the unit circle through -1. "neimark_sacker": a complex pair leaves the
        circle. A curve of harmonic balance has the last two only with ``stability=True``, under
        laws without exact orbits.
    single_point_curve : ResponseCurve
        Curve with this point alone.
    multipliers : (m,) complex or None
        Leading Floquet multipliers if the point is an exact orbit, largest modulus first.
    """

    kind: str
    single_point_curve: ResponseCurve
    multipliers: np.ndarray | None

    @property
    def value(self) -> float:
        """Parameter value of the curve at the bifurcation."""
        return float(self.single_point_curve.values[0])

    @property
    def omega(self) -> float:
        """Load frequency [rad/s]."""
        return float(self.single_point_curve.omega[0])

    frequency = hertz_property()

    @cached_property
    def problem(self) -> Problem:
        """Problem solved at the bifurcation, with the varied structure and load frequency."""
        return self.single_point_curve.problem_of(0)

    @cached_property
    def solution(self) -> PeriodicSolution:
        """Solution at the bifurcation, with displacement and error report.

        On a harmonic-balance curve the error is predicted, without a search for an exact orbit.
        """
        return self.single_point_curve.solution(0, search=False)

    @cached_property
    def orbit(self) -> PeriodicOrbit:
        """Exact orbit at the bifurcation; InputError on a curve of harmonic balance."""
        return self.single_point_curve.orbit(0)

    def to_dict(self) -> dict[str, Any]:
        """Return kind, value of the curve's parameter, and load frequency."""
        return add_frequency_entries({"kind": self.kind, "value": self.value, "omega": self.omega})

    def _repr_text(self) -> str:
        return f"{kind_in_words(self.kind)} at {self.value:.6g}, {self.single_point_curve.method}"


@dataclass(frozen=True)
class CurvePoint:
    """Point that iteration over a growing curve yields.

    Attributes
    ----------
    value : float
        Value of the curve's parameter.
    omega : float
        Load frequency [rad/s].
    unknown : (2H+1, n_pairs) [m]
        Fourier coefficients of the gaps g; with a residual flexibility R_inf, of the slow gaps g +
        R_inf lambda with the contact forces lambda. For exact orbits (2 n_modes,), the state at
        phase zero: modal displacements, then velocities over frequencies, both less the rest state.
    iterations : int
        Newton iterations.
    multipliers : (8,) complex or None
        Leading Floquet multipliers if the point is an exact orbit, largest modulus first.
    bifurcations : sequence of (str, float)
        Kind and parameter value of each special point since the point before.
    """

    value: float
    omega: float
    unknown: np.ndarray
    iterations: int
    multipliers: np.ndarray | None = None
    bifurcations: Sequence[tuple[str, float]] = field(default_factory=tuple)


@keep_old_attribute_names(resolution="max_missed_window_width", undecided="is_undecided")
@dataclass(frozen=True, repr=False, kw_only=True)
class ResponseCurve(ObservedMotion, Tabular):
    """Solutions along a curve, in order: of harmonic balance, or exact periodic orbits.

    Attributes
    ----------
    structure, contact : Structure, ContactLaw
        Small or reduced structure, and the law of all pairs, as given: the parameter does not vary
        these fields.
    parameter : str
        "omega", "load", "stiffness", "damping", "clearance", "friction", "speed", or "resonance".
    values : (n,)
        Parameter values. "omega": load frequencies [rad/s]. "load", "stiffness", "damping" and
        "friction": factors. "clearance": added clearances [m]. "speed": rotor speeds [rad/s].
        "resonance": factors for the vibrating load at phase resonance.
    omega : (n,) [rad/s]
        Load frequencies.
    iterations : (n,) int
        Newton iterations at each point.
    bifurcations : tuple of Bifurcation
        Special points, in order along the curve.
    complete : bool
        True if the curve reached the requested end, or closed.
    status : str
        Reason for the end.
    subharmonic : int
        The response has this many times the load's period.
    points : (n, 2H+1, n_pairs) [m], or (n, 2 n_modes)
        Harmonic balance: gap coefficients; for a structure with a residual flexibility R_inf, those
        of the slow gap s = g + R_inf lambda, with gap g and contact force lambda. With friction (n,
        2H+1, 2 n_pairs), normal gaps first. Exact orbits: modal displacements and velocities at
        phase zero, in the modes at the point's parameter value; with friction also slider
        positions.
    tolerance : float or None
        Error to which :meth:`solution` keeps an exact orbit's Fourier coefficients; None for points
        that solve the truncated harmonic-balance equations.
    samples : int or None
        Number of instants per period for the contact force; None: the default of
        :class:`fenics_crack.Problem`.
    static_above : float or None
        Harmonic balance with R_inf: frequency [rad/s] above which modes are quasi-static, the same
        for all points (:class:`fenics_crack.Problem`).
    multipliers : (n,) complex or None
        Floquet multiplier with the largest modulus at each point; its imaginary part is not
        negative. For irregular motion, the growth factor by which a small disturbance is
        multiplied. nan if the multiplier does not decide the stability (:func:`judge_curve`). None:
        not assessed.
    irregular : (n,) bool or None
        True if no orbit was found and the exact motion is irregular. None if the stability was not
        assessed, the points are exact orbits, or the contact law is smooth.
    branch : bool
        True if the curve leaves another curve at a bifurcation (:func:`follow_branch`).
    """

    structure: Structure
    contact: ContactLaw
    parameter: str
    values: np.ndarray
    omega: np.ndarray
    iterations: np.ndarray
    bifurcations: tuple[Bifurcation, ...]
    complete: bool
    status: str
    subharmonic: int
    points: np.ndarray
    tolerance: float | None = None
    samples: int | None = None
    static_above: float | None = None
    multipliers: np.ndarray | None = None
    irregular: np.ndarray | None = None
    branch: bool = False

    KIND: ClassVar[str] = "response curve"
    frequency = hertz_property()

    def __len__(self) -> int:
        return len(self.omega)

    @property
    def exact(self) -> bool:
        """True if the points are exact orbits, False if they are harmonic-balance solutions."""
        return self.tolerance is not None

    @property
    def harmonics(self) -> int:
        """Highest harmonic H of the response's frequency.

        For exact orbits it is the minimum for :meth:`solution`: 5 harmonics of the load frequency,
        or as many as the load has.
        """
        if not self.exact:
            return self.points.shape[1] // 2
        min_harmonics = least_harmonics(self.structure, self.subharmonic)
        return max(MIN_ORBIT_HARMONICS * self.subharmonic, min_harmonics)

    @property
    def method(self) -> str:
        """Method in words: "H = 5" for harmonic balance, or "exact orbits"."""
        return "exact orbits" if self.exact else f"H = {self.harmonics}"

    @cached_property
    def problem(self) -> Problem:
        """Problem solved at the first point, with the structure as given.

        Over the speed, the structure is at the first point's speed.
        """
        structure = self.structure
        if self.parameter == "speed" and isinstance(structure, RunUpStructure):
            structure = structure.at_speed(float(self.values[0]))
        return Problem(
            structure, float(self.omega[0]), self.contact, self.harmonics,
            self.samples, self.subharmonic, self.static_above,
        )  # fmt: skip

    @cached_property
    def system(self) -> BalanceEquations | OrbitEquations:
        """Equations of the curve, from the first to the farthest parameter value.

        The farthest value has the largest distance from the first, on either side.
        """
        farthest_index = int(np.argmax(np.abs(self.values - self.values[0])))
        first_and_farthest_values = float(self.values[0]), float(self.values[farthest_index])
        return system_along(self.exact, self.problem, self.parameter, *first_and_farthest_values)

    def with_status(self, status: str) -> ResponseCurve:
        """Return this curve with another status.

        The new curve keeps all results computed from this curve so far.
        """
        curve = replace(self, status=status)
        vars(curve).update(
            {name: value for name, value in vars(self).items() if name not in vars(curve)}
        )
        return curve

    # --- its points -------------------------------------------------------------------------------

    def problem_at(self, value: float) -> Problem:
        """Return the problem at a parameter value, with the varied structure or law."""
        return EQUATIONS_CLASS_BY_PARAMETER[self.parameter].vary_problem(self.problem, value)

    def problem_of(self, index: int) -> Problem:
        """Return the problem solved at a point, with the varied structure and load frequency."""
        problem, omega = self.problem_at(float(self.values[index])), float(self.omega[index])
        return problem if problem.omega == omega else replace(problem, omega=omega)

    def solution(self, index: int, *, search: bool = True) -> PeriodicSolution:
        """Return the solution at a point, with displacement and error report.

        Harmonic balance: with ``search``, the error is the distance to the exact orbit, otherwise a
        Newton step's prediction. Exact orbits: the solution is the orbit's Fourier series to the
        curve's ``tolerance``. With ``search``, the orbit with more modes is searched by harmonic
        balance if Newton's method fails; otherwise the error due to the modes may be unknown.
        """
        if self.tolerance is not None:
            solution_by_index = self._solution_by_index_and_search[search]
            if index not in solution_by_index:
                problem, orbit = self.problem_of(index), self.orbit(index)
                solution_by_index[index] = orbit_solution_to_tolerance(
                    problem, orbit, self.tolerance, balances_more_modes=search
                )
            return solution_by_index[index]
        problem, contact_point = self._problem_and_contact_point(index)
        assessment = Assessment(problem.wave(contact_point), flow=self._common_flow)
        return solution_of(
            problem, contact_point, status="point of a curve", search=search, assessment=assessment
        )

    @cached_property
    def _solution_by_index_and_search(self) -> tuple[dict[int, PeriodicSolution], ...]:
        """Caches for the solutions of exact orbits, each by the point's index.

        The first dictionary is for solutions without a search by harmonic balance, the second for
        solutions with a search. A dictionary is empty at first.
        """
        return {}, {}

    def _problem_and_contact_point(self, index: int) -> tuple[Problem, ContactPoint]:
        """Return a point's problem, and the harmonic-balance equations linearised there."""
        problem, equations = self.problem_of(index), self.system
        if isinstance(equations, BalanceAlongVibratingLoadFactor) or not isinstance(
            equations, BalanceEquations
        ):
            contact_system = problem.system(problem.compliance_model())
        else:
            contact_system = equations.system(float(self.values[index]))
        return problem, contact_system.linearise(self.points[index])

    @cached_property
    def _common_flow(self) -> ContactFlow | None:
        """Exact flow shared by all points of a curve over the frequency.

        None for other parameters, or if structure and law have no exact flow.
        """
        is_over_frequency = self.parameter == "omega"
        return exact_flow_or_none(self.structure, self.contact) if is_over_frequency else None

    def orbit(self, index: int) -> PeriodicOrbit:
        """Return the exact orbit at a point of the curve.

        Raises InputError for a harmonic-balance curve.
        """
        if not isinstance(self.system, OrbitEquations):
            raise InputError(
                "curve",
                self.method,
                "a curve of exact orbits, followed with a tolerance and without harmonics",
            )
        flow, omega = self.system.flow(float(self.values[index])), float(self.omega[index])
        iterations = int(self.iterations[index])
        return orbit_from_converged_state(
            flow, omega, self.points[index], self.subharmonic, iterations
        )

    def assessment(self, index: int) -> Assessment:
        """Return the assessment of a harmonic-balance point by exact motions.

        The assessment has a predicted error and the nearest exact orbit, both computed on request.
        ``index`` is the point's index.
        """
        return next(self.assessments([index]))

    def assessments(self, places: Sequence[int]) -> Iterator[Assessment]:
        """Yield an assessment by exact motions for each of several harmonic-balance points.

        ``places`` are the indices of the points on the curve. Over the frequency, the displacements
        of many points are computed together. Of crack faces with mass, orbits are sought from the
        points alone: with more harmonics a search takes seconds.
        """
        n_doublings = 0
        if self.structure.has_massless_crack_faces:
            n_doublings = MAX_HARMONIC_DOUBLINGS_FOR_ORBIT
        if self._common_flow is None or not isinstance(self.system, BalanceEquations):
            for point_problem, contact_point in map(self._problem_and_contact_point, places):
                yield Assessment(
                    point_problem.wave(contact_point), n_harmonic_doublings=n_doublings
                )
            return
        equations = self.system
        contact_system = equations.system(equations.start)
        compliance_model = equations.compliance_model_at(equations.start)
        points_per_chunk = max(1, equations.max_path_points_per_call)
        for chunk_indices in (
            places[chunk_start_position : chunk_start_position + points_per_chunk]
            for chunk_start_position in range(0, len(places), points_per_chunk)
        ):
            unknowns, omega = self.points[chunk_indices], self.omega[chunk_indices]
            force_coefficients = np.stack(
                [contact_system.integrals.force(unknown) for unknown in unknowns], axis=1
            )
            displacement_coefficients = compliance_model.displacements_at_base_omegas(
                omega / self.subharmonic, force_coefficients
            )
            for index, unknown in enumerate(unknowns):
                curve_point_force_coefficients = np.ascontiguousarray(force_coefficients[:, index])
                curve_point_gap_coefficients = contact_system.gap(
                    unknown, curve_point_force_coefficients
                )
                curve_point_displacement_coefficients = displacement_coefficients[:, index]
                harmonic_motion = replace(
                    equations.problem.wave_of(
                        curve_point_displacement_coefficients,
                        curve_point_gap_coefficients,
                        curve_point_force_coefficients,
                    ),
                    omega=float(omega[index]),
                )
                yield Assessment(
                    harmonic_motion, flow=self._common_flow, n_harmonic_doublings=n_doublings
                )

    @cached_property
    def gap_coefficients(self) -> np.ndarray:
        """Fourier coefficients of the normal gaps at every point: (n, 2H+1, n_pairs) [m].

        For exact orbits, H is 40, and the coefficients come from quadrature of the exact motion.
        For harmonic-balance points H is the curve's.
        """
        n_pairs, indices = self.structure.n_pairs, range(len(self))
        if self.exact:
            coefficients = [
                self.orbit(index).coefficients(OBSERVED_HARMONICS).gap for index in indices
            ]
            return np.array(coefficients)[..., :n_pairs]
        if self.static_above is None:
            return self.points[..., :n_pairs]
        return np.array(
            [assessment.wave.gap_coefficients for assessment in self.assessments(indices)]
        )

    def yield_motion_records(self, rows: np.ndarray) -> Iterator[MotionRecord]:
        point_indices = range(len(self))
        orbits_or_solutions: Iterator[PeriodicOrbit | PeriodicSolution]
        if self.exact:
            orbits_or_solutions = map(self.orbit, point_indices)
        else:
            point_assessments = self.assessments(point_indices)
            orbits_or_solutions = (
                PeriodicSolution(**vars(assessment.wave), assessment=assessment)
                for assessment in point_assessments
            )
        for orbit_or_solution in orbits_or_solutions:
            yield from orbit_or_solution.yield_motion_records(rows, OBSERVED_INSTANTS_PER_PERIOD)

    # --- stability --------------------------------------------------------------------------------

    @property
    def stable(self) -> np.ndarray:
        """True if the largest multiplier's modulus is below 1 - 1e-6: (n,) bool.

        Raises
        ------
        AttributeError
            The curve was followed without ``stability=True``.
        """
        if self.multipliers is None:
            raise AttributeError(
                "the stability is not known, as the curve was followed with stability = False; "
                "fc.judge_curve(curve) returns the curve with its stability"
            )
        return np.asarray(np.abs(self.multipliers) < 1.0 - MULTIPLIER_TOLERANCE)

    @property
    def is_undecided(self) -> np.ndarray | None:
        """True at points with undecided stability: (n,) bool, or None if not assessed.

        At these points the largest multiplier's modulus is nan, or differs from 1 by at most 1e-6.
        :meth:`reason` explains.
        """
        if self.multipliers is None:
            return None
        return np.asarray(~(np.abs(np.abs(self.multipliers) - 1.0) > MULTIPLIER_TOLERANCE))

    @property
    def verdicts(self) -> np.ndarray:
        """Stability of each point: "stable", "unstable", "irregular" or "undecided", (n,) str.

        Raises AttributeError if the curve was not assessed.
        """
        verdicts = np.where(self.stable, "stable", "unstable")
        if self.irregular is not None:
            verdicts = np.where(self.irregular, "irregular", verdicts)
        return np.where(self.is_undecided, "undecided", verdicts)

    def reason(self, index: int) -> str:
        """Return why the stability at a point is undecided.

        The text is empty if the stability is decided, or was not assessed.
        """
        if self.is_undecided is None or not self.is_undecided[index]:
            return ""
        if self.exact:
            return NEUTRAL_MULTIPLIER_TEXT
        if not is_unilateral(self.contact):
            solution = self.solution(index, search=False)
            return floquet(solution.structure, solution).reason
        if self.is_undecided.all():
            return (
                "no exact orbit was found that is close enough to any point of the curve; use more "
                "harmonics, or a tolerance"
            )
        return self.assessment(index).rejection_reason or NEUTRAL_MULTIPLIER_TEXT

    @property
    def max_missed_window_width(self) -> float:
        """Widest unstable parameter interval that goes unnoticed on a curve of exact orbits.

        Between two neighbouring points, orbits may become unstable or double their period, and
        return. Both may happen inside a narrow interval. The width is a tenth of the longest step
        in ``values``, in the same unit.
        """
        return MAX_MISSED_INSTABILITY_TO_STEP * float(np.abs(np.diff(self.values)).max(initial=0.0))

    # --- parts of it ------------------------------------------------------------------------------

    def part(self, places: Sequence[int] | slice) -> Self:
        """Return a curve with the points at given indices alone, without bifurcations."""
        selected_array_by_name = {
            name: point_array[places] for name, point_array in _array_by_field_name(self).items()
        }
        return replace(self, **selected_array_by_name, bifurcations=())

    def bifurcation(
        self, kind: str, value: float, omega: float, point: np.ndarray,
        multipliers: np.ndarray | None = None,
    ) -> Bifurcation:  # fmt: skip
        """Make a special point of this curve.

        Parameters
        ----------
        kind : str
            "fold", "branch_point", "period_doubling" or "neimark_sacker".
        value : float
            Value of the curve's parameter.
        omega : float
            Load frequency [rad/s].
        point : array
            Unknowns of the special point, in the shape of a row of ``points``.
        multipliers : (m,) complex, optional
            Leading Floquet multipliers of an exact orbit.
        """
        point_entry_by_curve_field = {
            "values": value,
            "omega": omega,
            "iterations": 0,
            "points": point,
        }
        array_by_name = {
            name: np.array([point_entry])
            for name, point_entry in point_entry_by_curve_field.items()
        }
        leading_multipliers = (
            None
            if multipliers is None
            else np.array([leading_multiplier_in_upper_half(multipliers)])
        )
        point_curve = replace(
            self, **array_by_name, multipliers=leading_multipliers, irregular=None, bifurcations=()
        )
        return Bifurcation(kind, point_curve, multipliers)

    @cached_property
    def at_bifurcations(self) -> Self:
        """Curve with the first point, the bifurcations and the last point only.

        Used to evaluate amplitudes and other numbers at bifurcations. Only exact orbits keep their
        multipliers.
        """
        curve_with_exact_multipliers_only = (
            self if self.exact else replace(self, multipliers=None, irregular=None)
        )
        one_point_bifurcation_curves = [
            bifurcation.single_point_curve for bifurcation in self.bifurcations
        ]
        one_point_curves: list[ResponseCurve] = [
            curve_with_exact_multipliers_only.part([0]),
            *one_point_bifurcation_curves,
            curve_with_exact_multipliers_only.part([-1]),
        ]
        array_dicts = [
            _array_by_field_name(one_point_curve) for one_point_curve in one_point_curves
        ]
        joined_columns_by_name = {
            name: np.concatenate([array_by_name[name] for array_by_name in array_dicts])
            for name in array_dicts[0]
        }
        return replace(curve_with_exact_multipliers_only, **joined_columns_by_name, bifurcations=())

    def nearest(self, bifurcation: Bifurcation) -> int:
        """Return the index of the point nearest to a bifurcation.

        The distance is the root sum square of two numbers:

        - The parameter's difference, divided by the curve's parameter range.
        - The norm of the solutions' difference, divided by the norm of the bifurcation's solution.
        """
        bifurcation_solution = bifurcation.single_point_curve.points
        distances_to_bifurcation_solution = np.linalg.norm(
            (self.points - bifurcation_solution).reshape(len(self), -1), axis=1
        )
        distances_to_bifurcation_solution /= float(np.linalg.norm(bifurcation_solution)) or 1.0
        value_range = float(np.ptp(self.values)) or 1.0
        return int(
            np.argmin(
                np.hypot(
                    distances_to_bifurcation_solution,
                    (self.values - bifurcation.value) / value_range,
                )
            )
        )

    def coefficients_at(self, dof: int | None = None) -> np.ndarray:
        """Return a dof's displacement coefficients at every point: (n, 2H+1) [m].

        ``dof`` None stands for the watched dof.
        """
        return self.observe_dofs([dof])[0][0].real_fourier_coefficients

    def _join_curve_point_values(self, values: list[Any]) -> np.ndarray:
        return np.array(values)

    def top(self, dof: int | None = None) -> LargestResponse:
        """Return the largest response at a dof, without its error and stability.

        ``dof`` None stands for the watched dof. :meth:`peak` adds error, stability and damping.
        """
        amplitudes = self.amplitude(dof)
        index = int(np.argmax(amplitudes))
        peak_parameter, peak_amplitude, _ = interpolate_peak_and_damping(
            self.values, amplitudes, index
        )
        return LargestResponse(index, peak_parameter, peak_amplitude, index in (0, len(self) - 1))

    def peak(self, dof: int | None = None) -> Peak:
        """Return the largest response at a dof, with error, stability and damping.

        ``dof`` None stands for the watched dof.
        """
        top = self.top(dof)
        omega, solution, damping = float(self.omega[top.index]), self.solution(top.index), math.nan
        if self.parameter in ("omega", "speed"):
            coefficients, structure = self.coefficients_at(dof), self.structure
            damping = damping_by_half_power_width(
                self.values, coefficients, self.subharmonic, top.index
            )
            if isinstance(structure, RunUpStructure):
                # Natural frequencies follow the speed, so the peak is wider over the speed.
                peak_structure = structure.at_speed(float(self.values[top.index]))
                damping *= 1.0 - peak_structure.stiffening_exponent(omega)
            omega *= top.value / float(self.values[top.index])
        if self.multipliers is None:
            verdict = floquet(solution.structure, solution).verdict
        else:
            verdict = str(self.verdicts[top.index])
        displacement_error = solution.report.displacement
        return Peak(
            **vars(top), omega=omega, error=displacement_error, verdict=verdict, damping=damping
        )

    @cached_property
    def displacement_errors(self) -> np.ndarray:
        """Estimated error of the displacement at the load at every point: (n,).

        The error is divided by the displacement's root mean square, like ``displacement`` of
        :class:`fenics_crack.ErrorReport`. Two sets of points are estimated: 40 points, spread
        evenly along the curve, and the points next to a crossing of 0.05, the limit for a warning.
        At other points the error is interpolated.

        If there is an exact flow, one Newton step predicts the effect of the truncated harmonics
        and modes. For exact orbits it predicts the effect of the modes alone.
        """
        error_by_index: dict[int, float] = {}
        # As many points as a picture shows.
        open_indices = set(np.linspace(0, len(self) - 1, 40).astype(int).tolist())
        while open_indices:
            for index in open_indices:
                error_by_index[index] = self._estimate_displacement_error(index)
            open_indices = {
                (lower_index + upper_index) // 2
                for lower_index, upper_index in pairwise(sorted(error_by_index))
                if upper_index - lower_index > 1
                and (error_by_index[lower_index] > LARGE_ERROR)
                != (error_by_index[upper_index] > LARGE_ERROR)
            }
        estimated_indices = sorted(error_by_index)
        return np.interp(
            np.arange(len(self)),
            estimated_indices,
            [error_by_index[index] for index in estimated_indices],
        )

    def _estimate_displacement_error(self, index: int) -> float:
        """Return the estimated relative error of the displacement at the load at a point.

        1 stands for an unknown error.
        """
        if self.exact:
            orbit, problem = self.orbit(index), self.problem_of(index)
            orbit_solution = truncated_orbit_solution(
                problem, orbit, orbit.coefficients(problem.harmonics)
            )
            more_modes_motion = orbit_solution.assessment.more_modes
            if more_modes_motion is not None:
                return (
                    ERROR_IF_UNKNOWN
                    if more_modes_motion.gap_and_displacement_errors is None
                    else more_modes_motion.gap_and_displacement_errors[1]
                )
        return self.solution(index, search=False).report.displacement

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return columns by name, with a row for each point (collective).

        Columns: parameter, frequencies, Newton iterations, indicators of the watched dof;
        multiplier and verdict if the curve was assessed.
        """
        columns_by_name = {self.parameter: self.values.tolist(), "omega": self.omega.tolist()}
        columns_by_name["iterations"] = self.iterations.tolist()
        if self.multipliers is not None:
            columns_by_name["multiplier"] = np.abs(self.multipliers).tolist()
            columns_by_name["verdict"] = self.verdicts.tolist()
        return add_frequency_entries(columns_by_name | self.indicators().to_dict())

    def _repr_text(self) -> str:
        title_parts = [
            f"{self.parameter} {self.values[0]:.6g} to {self.values[-1]:.6g}",
            format_count(len(self), "point"),
            self.method,
            format_count(len(self.bifurcations), "bifurcation"),
        ]
        if self.multipliers is not None:
            title_parts.append(f"{np.mean(self.stable):.0%} stable")
        return ", ".join([*title_parts, "complete" if self.complete else "NOT COMPLETE"])


def _array_by_field_name(curve: ResponseCurve) -> dict[str, np.ndarray]:
    """Return the fields of a curve that are arrays, by name."""
    value_by_field = {
        curve_field.name: getattr(curve, curve_field.name) for curve_field in fields(curve)
    }
    return {
        name: column for name, column in value_by_field.items() if isinstance(column, np.ndarray)
    }
