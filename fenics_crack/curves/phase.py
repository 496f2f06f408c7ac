"""Equations for a phase resonance: the displacement at the load has no part in phase with the load.

The condensed equations F(s, v, w) = 0 (:mod:`contact_system`) have the load's frequency w, and a
factor v for the vibrating part of the load. One equation is added:

    Re P / Im P = 0,        P = f_k^H u_k,

with the complex work P. f_k and u_k are complex coefficients for the exciting harmonic k: f_k of
the load, on a bladed disk only on the watched blade, and u_k of the displacement. Re P / Im P is
linear in w next to the resonance of a single mode. The Jacobian is bordered by a row and a column.

Contact is linear for each set of closed pairs, and a scaled motion has the same sets. So the motion
is v times the motion under the load itself, with mean load and clearance divided by v. Both are in
the mean of the linear gap alone. F / v, a function of s / v, thus depends on v in the mean only,
and P / v does not.

Further modes and harmonics shift the phase. With U(w) the displacement along the load, on the
response curve through the point,

    d ln U / dw = -2 i / D       for a single mode with the half-power width D.

At a small distance d from the top of the curve, the real part of this derivative is 2 d / D times
the imaginary part. Further modes cause a distance at the phase resonance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactPoint
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.curves.balance_equations import BalanceAlongFrequency
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import Linearisation


@dataclass(frozen=True)
class ExcitingHarmonic:
    """Harmonic of a load that excites a phase resonance.

    Attributes
    ----------
    harmonic : int
        Multiple k of the load frequency.
    cosine_and_sine_load : (2, n_dofs) [N]
        Cosine and sine parts of the load; on a bladed disk, only on the watched blade.
    """

    harmonic: int
    cosine_and_sine_load: np.ndarray

    @classmethod
    def of_structure(cls, structure: Structure, harmonic: int) -> ExcitingHarmonic:
        """Return the harmonic with a given order in a structure's load."""
        row_slice = slice(2 * harmonic - 1, 2 * harmonic + 1)
        return cls(harmonic, structure.whole.watched_sector_load_rows(structure, row_slice))

    def complex_work(self, point: ContactPoint, force: np.ndarray | None = None) -> complex:
        """Return the load's complex work P = f_k^H u_k at a point [N m].

        f_k and u_k are the complex coefficients of load and displacement at the exciting harmonic
        k; H means the conjugate transpose. Re P = 0 at a phase resonance. ``point`` has the
        linearised equations of harmonic balance. ``force`` (2H+1, n_pairs) [N] replaces the point's
        contact forces (default).
        """
        load_displacement_products = modal_compliance_of(point).selected_displacement(
            self.cosine_and_sine_load, point.force if force is None else force
        )
        return self._complex_work_of_products(load_displacement_products)

    def complex_work_omega_derivative(self, point: ContactPoint) -> complex:
        """Return the derivative of the load's complex work by the load frequency [N m s].

        ``point`` has the linearised equations of harmonic balance. Contact forces are held
        constant.
        """
        return self._complex_work_of_products(
            modal_compliance_of(point).selected_displacement_omega_derivative(
                self.cosine_and_sine_load, point.force
            )
        )

    def _complex_work_of_products(self, load_displacement_products: np.ndarray) -> complex:
        """Return the load's complex work at the exciting harmonic [N m].

        ``load_displacement_products`` (2H+1, 2) [N m] are the Fourier coefficients of two scalars:
        the load's cosine part times the displacement, and the load's sine part times the
        displacement.
        """
        displacement_cosine_works, displacement_sine_works = (
            load_displacement_products[2 * self.harmonic - 1],
            load_displacement_products[2 * self.harmonic],
        )
        return complex(
            displacement_cosine_works[0] + displacement_sine_works[1],
            displacement_cosine_works[1] - displacement_sine_works[0],
        )


def modal_compliance_of(point: ContactPoint) -> ModalCompliance:
    """Return the compliance by all modes in the equations linearised at a point.

    The compliance takes contact forces to displacements and gaps. ``point`` has the linearised
    equations of harmonic balance.
    """
    assert isinstance(point.system.compliance_model, ModalCompliance)
    return point.system.compliance_model


class PhasePoint(Linearisation):
    """Equations of a phase resonance at a point, with derivatives.

    Harmonic balance F(s, v, w) = 0, and Re P / Im P = 0 for the load's complex work P. s is the
    slow gap (gap plus residual flexibility times contact force), v the factor for the vibrating
    load, w the load frequency. Harmonic balance is divided by v. The unknowns are s / (v s_0), and
    w divided by the problem's frequency. The constant s_0 [m] is ``vibrating_slow_gap_norm`` of
    :class:`ResonanceSystem`: the norm of the vibrating coefficients of s / v at a nearby point.

    Attributes
    ----------
    problem : Problem
        Problem at v = 1, with a frequency near w.
    linearised_balance : ContactPoint
        Harmonic balance with the slow gap s / v, under the load with the factor 1.
    omega : float [rad/s]
        Load frequency w.
    complex_work : complex [N m]
        P / v: complex work f_k^H u_k / v, with the load f_k at the factor 1.
    slow_gap_derivative_by_frequency : (2H+1, n_pairs)
        Derivative of s / v by w, along the response curve with this v through the point.
    complex_work_derivative_by_frequency : complex
        Derivative of P / v by w, along the same curve.
    """

    def __init__(self, system: ResonanceSystem, unknown: np.ndarray, parameter: float) -> None:
        self.unknown = unknown
        self.problem = system.problem
        self.exciting_harmonic = system.exciting_harmonic
        self._vibrating_slow_gap_norm, self.omega = (
            system.vibrating_slow_gap_norm,
            system.omega(1.0, unknown),
        )
        self.linearised_balance = system.balance_along_frequency.system(self.omega).linearise(
            system.unscaled_solution(unknown, 1.0)
        )
        self.complex_work = system.exciting_harmonic.complex_work(self.linearised_balance)
        load_factor = system.value(parameter)
        self._inverse_load_factor = 1.0 / load_factor
        self._derivative_of_inverse_load_factor = -system.value_rate(load_factor) / load_factor**2

    @cached_property
    def residual(self) -> np.ndarray:  # type: ignore[override]
        contact_residual = self.linearised_balance.residual.copy()
        contact_residual[0] += (
            1.0 - self._inverse_load_factor
        ) * self.linearised_balance.system.linear_gap[0]
        return np.append(
            contact_residual / self._vibrating_slow_gap_norm,
            self.complex_work.real / self.complex_work.imag,
        )

    @cached_property
    def by_parameter(self) -> np.ndarray:  # type: ignore[override]
        residual_derivative = np.zeros_like(self.unknown)
        residual_derivative[: len(self.linearised_balance.gap[0])] = (
            -self._derivative_of_inverse_load_factor
            * self.linearised_balance.system.linear_gap[0]
            / self._vibrating_slow_gap_norm
        )
        return residual_derivative

    def _phase_condition_change(self, work_change: complex) -> float:
        """Return the change in Re P / Im P, the cotangent of the phase.

        P is the load's complex work [N m], and ``work_change`` a small change in it.
        """
        complex_work = self.complex_work
        return (
            work_change.real - complex_work.real / complex_work.imag * work_change.imag
        ) / complex_work.imag

    def _complex_work_change_by_slow_gap(self, slow_gap_change: np.ndarray) -> complex:
        """Return the change in the load's complex work by a slow gap's change [N m].

        ``slow_gap_change`` is (2H+1, n_pairs) [m]; slow gap: gap plus residual flexibility times
        contact force. The contact forces change with the gap; the frequency is fixed.
        """
        return (
            self.exciting_harmonic.complex_work(
                self.linearised_balance,
                self.linearised_balance.force
                + self.linearised_balance.forces_with_derivatives.force_change(slow_gap_change),
            )
            - self.complex_work
        )

    @cached_property
    def slow_gap_derivative_by_frequency(self) -> np.ndarray:
        return -self.linearised_balance.solve(
            modal_compliance_of(self.linearised_balance).residual_derivative(
                "omega", self.linearised_balance.force
            )
        )

    @cached_property
    def complex_work_derivative_by_frequency(self) -> complex:
        return self.exciting_harmonic.complex_work_omega_derivative(
            self.linearised_balance
        ) + self._complex_work_change_by_slow_gap(self.slow_gap_derivative_by_frequency)

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        gap_change = self._vibrating_slow_gap_norm * self.linearised_balance.solve(
            right_side[:-1].reshape(self.linearised_balance.unknown.shape)
        )
        phase_condition_remainder = right_side[-1] - self._phase_condition_change(
            self._complex_work_change_by_slow_gap(gap_change)
        )
        frequency_change = phase_condition_remainder / self._phase_condition_change(
            self.complex_work_derivative_by_frequency
        )
        scaled_gap_change = (
            gap_change + frequency_change * self.slow_gap_derivative_by_frequency
        ) / self._vibrating_slow_gap_norm
        return np.append(scaled_gap_change, frequency_change / self.problem.omega)

    @property
    def sign(self) -> float:
        return self.linearised_balance.sign * float(
            np.sign(self._phase_condition_change(self.complex_work_derivative_by_frequency))
        )

    @property
    def half_power_width(self) -> float:
        """Return the half-power width D of a single mode with this response [rad/s].

        D = -2 / Im(d ln P / dw), with the load's complex work P and the load frequency w. The
        half-power width is measured at 1/sqrt(2) of a peak's amplitude.
        """
        return -2.0 / (self.complex_work_derivative_by_frequency / self.complex_work).imag

    @property
    def distance_to_peak_in_widths(self) -> float:
        """Return the distance to the largest response, divided by the half-power width D.

        The distance is D/4 Re(d ln P / dw), with the load's complex work P and the frequency w.
        """
        return (
            0.25
            * self.half_power_width
            * (self.complex_work_derivative_by_frequency / self.complex_work).real
        )

    @cached_property
    def solution(self) -> PeriodicSolution:
        """Return the motion at this point, without a search for an exact orbit."""
        problem = replace(self.problem, omega=self.omega)
        return solution_of(problem, self.linearised_balance, status="phase resonance", search=False)


class ResonanceSystem(CurveSystem):
    """Equations of a phase resonance along a factor v for the vibrating load.

    The unknowns are the slow gap's coefficients divided by v s_0, and the load frequency divided by
    the problem's frequency. s_0 is the attribute ``vibrating_slow_gap_norm``. Slow gap: gap plus
    residual flexibility times contact force.

    Attributes
    ----------
    start_unknown : (n_unknowns,)
        Guess for the resonance at ``start``, from a nearby point.
    vibrating_slow_gap_norm : float [m]
        Norm of the slow gap's vibrating coefficients at the nearby point, divided by v.
    """

    parameter_name, is_logarithmic = "resonance", True

    def __init__(
        self,
        problem: Problem,
        exciting_harmonic: ExcitingHarmonic,
        nearby_point: ContactPoint,
        factor_range: tuple[float, float] = (1, 2),
    ) -> None:
        self.start, self.end = factor_range
        self.balance_along_frequency = balance_along_frequency = BalanceAlongFrequency(
            problem, problem.omega, 0.5 * problem.omega
        )
        gap_series_without_static_part = balance_along_frequency.system(
            problem.omega
        ).gap_without_static_part(nearby_point.gap, nearby_point.force)
        gap_series_without_static_part = gap_series_without_static_part / self.start
        self.vibrating_slow_gap_norm = float(np.linalg.norm(gap_series_without_static_part[1:]))
        self.start_unknown = np.append(
            gap_series_without_static_part / self.vibrating_slow_gap_norm, 1.0
        )
        self.problem, self.exciting_harmonic = balance_along_frequency.problem, exciting_harmonic
        self.n_time_means, self.shape = (
            balance_along_frequency.n_time_means,
            self.start_unknown.shape,
        )

    def rounding(self, parameter: float) -> float:
        return self.balance_along_frequency.rounding(0.0)

    def omega(self, value: float, unknown: np.ndarray) -> float:
        return float(unknown[-1]) * self.problem.omega

    def unscaled_solution(self, unknown: np.ndarray, value: float) -> np.ndarray:
        return self.vibrating_slow_gap_norm * value * unknown[:-1].reshape(-1, self.n_time_means)

    def linearise(self, unknown: np.ndarray, parameter: float) -> PhasePoint:
        return PhasePoint(self, unknown, parameter)
