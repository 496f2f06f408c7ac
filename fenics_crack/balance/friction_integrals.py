"""Fourier coefficients of contact forces with friction, by alternating between frequency and time.

The slow gaps s, n_pairs normal and then n_pairs tangential ones, are given at N instants of the
period. The forces lambda are computed instant by instant, period after period. At each instant they
depend on s and on the slider positions h, the tangential gaps at which tangential springs are
relaxed:

    lambda = L (s - [0; h]),        h = g_t - lambda_t / k_t for pairs that do not stick

L is the stiffness matrix for the present states of the pairs: open, sticking or slipping. g_t,
lambda_t and k_t are tangential gap, friction force and tangential stiffness
(:mod:`fenics_crack.model.contact`, ``kernel/friction_waves.c``). A pair that sticks keeps h. The
march ends when h repeats after a period: the first value of h then has no more effect. Pairs that
stick all the time are the exception: h is their first tangential gap, or stays from their last
slip. The derivative of the forces follows the last two periods, with the changes of h.

Source: Cameron and Griffin, Journal of Applied Mechanics 56 (1989) 149-154.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from fenics_crack.balance.contact_integrals import ContactIntegrals, CoupledForces, CoupledIntegrals
from fenics_crack.kernel import kernel, pointer
from fenics_crack.model.contact import (
    ContactLaw,
    FrictionContactSolver,
    friction_of,
    spring_compliances,
)
from fenics_crack.numerics.fourier import (
    evaluate_series,
    fourier_basis,
    fourier_coefficients,
    sample_period,
)


def integrals_with_coupled_pairs(
    law: ContactLaw, harmonics: int, residual_compliance: np.ndarray, samples: int | None = None
) -> ContactIntegrals:
    """Return the integrals of contact forces for pairs coupled by a residual flexibility.

    Parameters
    ----------
    law : ContactLaw
        With or without friction.
    harmonics : int
        Number of harmonics H of the forces.
    residual_compliance : (n_rows, n_rows) [m/N]
        Residual flexibility R_inf in series with contact. n_rows is the number of pairs; with
        friction twice as many, normal gaps before tangential ones.
    samples : int, optional
        Instants per period. Default: exact integrals for a piecewise linear law without friction;
        with friction 32 H, at least 128; otherwise :func:`default_instants_per_period`.
    """
    integrals_class = CoupledIntegrals if friction_of(law) is None else FrictionIntegrals
    return integrals_class(law, harmonics, residual_compliance=residual_compliance, samples=samples)


SAMPLES_PER_HARMONIC, MIN_SAMPLES = 32, 128
"""Instants per harmonic, and minimum instants per period, to compute friction forces."""
MAX_MARCH_PERIODS = 20
"""Maximum number of periods over which friction forces are followed until they repeat.

Measured for an edge crack in flap, with some pair sticking at every instant: an initial error of
the slider positions falls to a ninth per period. After twelve periods only rounding is left.
"""


@dataclass(frozen=True)
class FrictionIntegrals(ContactIntegrals):
    """Integrals of contact and friction forces over a period, for coupled pairs.

    The residual flexibility, in series with contact, is (2 n_pairs, 2 n_pairs). Its first n_pairs
    rows and columns are normal, the others tangential.

    Attributes
    ----------
    samples : int or None
        Instants per period; None: 32 for each of the H harmonics, at least 128.
    friction_coefficient_factor : float
        Factor for the law's friction coefficient.
    """

    samples: int | None = field(default=None, kw_only=True)
    friction_coefficient_factor: float = field(default=1.0, kw_only=True)
    has_coupled_pairs: ClassVar[bool] = True

    @cached_property
    def friction_contact_solver(self) -> FrictionContactSolver:
        """Solver for contact and friction forces at one instant, from the slow gaps.

        The solver finds which pairs are closed and which slide. Its friction coefficient is the
        law's times ``friction_coefficient_factor``.
        """
        friction_law = friction_of(self.law)
        assert friction_law is not None
        scaled_coefficient = np.multiply(self.friction_coefficient_factor, friction_law.coefficient)
        return FrictionContactSolver(self.series_compliance_matrix, scaled_coefficient)

    @cached_property
    def series_compliance_matrix(self) -> np.ndarray:
        """Sum of all compliances in series with contact: (2 n_pairs, 2 n_pairs) [m/N].

        The terms are the residual flexibility, the contact springs' compliance 1/k, and
        ``relative_series_softness`` times the mean pair compliance. k is the contact stiffness.
        """
        assert self.residual_compliance is not None
        series_compliances = (
            self.spring_compliance + self.relative_series_softness * self.mean_pair_compliance
        )
        return np.ascontiguousarray(self.residual_compliance + np.diag(series_compliances))

    @cached_property
    def spring_compliance(self) -> np.ndarray:
        """Compliances 1/k of the contact springs, normal then tangential: (2 n_pairs,) [m/N]."""
        assert self.residual_compliance is not None
        return spring_compliances(self.law, len(self.residual_compliance) // 2)

    @property
    def n_instants(self) -> int:
        """Number of instants per period."""
        return self.samples or max(MIN_SAMPLES, SAMPLES_PER_HARMONIC * self.harmonics)

    def follow_forces_until_they_repeat(self, gap_samples: np.ndarray) -> tuple[np.ndarray, ...]:
        """Follow contact and friction forces, period after period, until they repeat.

        ``gap_samples`` (n, 2 n_pairs) [m] are the slow gaps at n instants of the period: gap plus
        residual flexibility times contact force. ConvergenceError: an instant has no contact
        forces, or more than one solution.

        Returns
        -------
        forces : (n, 2 n_pairs) [N]
            Normal forces, then friction forces.
        states : (n, n_pairs) int8
            0: open, 1: sticks, 2 and 3: slips with growing and with falling tangential gap.
        places : (n, n_pairs) [m]
            Friction sliders' positions: tangential gap less the tangential spring's deformation.
        origins : (n_pairs,) int
            Index of the last instant at which each pair did not stick; 0 if the pair always stuck.
        """
        return self.friction_contact_solver.solve(
            gap_samples, gap_samples[0, gap_samples.shape[1] // 2 :], max_periods=MAX_MARCH_PERIODS
        )

    def forces_at_gap_samples(self, gap_samples: np.ndarray) -> np.ndarray:
        return self.follow_forces_until_they_repeat(gap_samples)[0]

    def forces_and_places_at(
        self, gap_coefficients: np.ndarray, requested_phases: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return contact forces and friction sliders' positions at requested phases.

        Parameters
        ----------
        gap_coefficients : (2H+1, 2 n_pairs) [m]
            Coefficients of the slow gaps: gap plus residual flexibility times contact force.
        requested_phases : (n,) [rad]
            Phases of the response.

        Returns
        -------
        forces : (n, 2 n_pairs) [N]
            Normal forces, then friction forces.
        places : (n, n_pairs) [m]
            Sliders' positions: tangential gap less the tangential spring's deformation. A pair that
            sticks keeps its position.
        """
        n_instants, two_pi = self.n_instants, 2.0 * np.pi
        grid_and_requested_phases = np.concatenate(
            [two_pi / n_instants * np.arange(n_instants), np.mod(requested_phases, two_pi)]
        )
        gap_samples = np.concatenate(
            [
                sample_period(gap_coefficients, n_instants),
                evaluate_series(gap_coefficients, 1.0, requested_phases),
            ]
        )
        _, unique_phase_indices, unique_index_of_phase = np.unique(
            grid_and_requested_phases, return_index=True, return_inverse=True
        )
        normal_and_friction_forces, _, sticking_places, _ = self.follow_forces_until_they_repeat(
            gap_samples[unique_phase_indices]
        )
        requested_indices = unique_index_of_phase[n_instants:]
        return normal_and_friction_forces[requested_indices], sticking_places[requested_indices]

    def linearise(self, gap_coefficients: np.ndarray) -> ContactAndFrictionForces:
        return ContactAndFrictionForces(self, gap_coefficients)

    def exact_or_finer_integrals(self) -> Self:
        return replace(self, samples=4 * self.n_instants)

    def with_harmonics(self, harmonics: int) -> Self:
        return replace(self, harmonics=harmonics, samples=None)


class ContactAndFrictionForces(CoupledForces):
    """Fourier coefficients of contact and friction forces, with derivatives.

    ``gap_coefficients`` (2H+1, 2 n_pairs) [m] belong to the slow gaps: gap plus residual
    flexibility times contact force. Normal gaps come first, then tangential ones.
    """

    def __init__(self, integrals: FrictionIntegrals, gap_coefficients: np.ndarray) -> None:
        self._integrals, self._shape = integrals, gap_coefficients.shape
        gap_samples = sample_period(gap_coefficients, integrals.n_instants)
        (
            self._force_samples,
            self.contact_states,
            self.sticking_places,
            self._last_unstuck_instants,
        ) = integrals.follow_forces_until_they_repeat(gap_samples)
        self.force = fourier_coefficients(self._force_samples, integrals.harmonics)

    def force_change(self, gap_change: np.ndarray) -> np.ndarray:
        return self._force_coefficient_change(sample_period(gap_change, self._integrals.n_instants))

    def _force_coefficient_change(self, gap_change_samples: np.ndarray) -> np.ndarray:
        """Return the linearised force change for changes of the slow gaps.

        Parameters
        ----------
        gap_change_samples : (n_instants, 2 n_pairs) [m]
            Changes of the slow gaps at the instants of the period.

        Returns
        -------
        (2H+1, 2 n_pairs) [N]
            Change of the coefficients if every pair keeps its state: open, sticking or slipping.
        """
        gap_change_samples = np.ascontiguousarray(gap_change_samples)
        force_change_samples = np.empty_like(self._force_samples)
        array_pointers = map(
            pointer,
            (
                self.contact_states,
                self._last_unstuck_instants,
                gap_change_samples,
                force_change_samples,
            ),
        )
        if kernel.friction_changes(
            self._integrals.friction_contact_solver.handle, len(gap_change_samples), *array_pointers
        ):
            raise MemoryError("friction")
        return fourier_coefficients(force_change_samples, self._integrals.harmonics)

    def tangent(self, gap_basis: np.ndarray | None = None) -> np.ndarray:
        n_rows, n_gaps = self._shape
        gap_basis_or_identity = (
            np.eye(n_gaps) if gap_basis is None else np.ascontiguousarray(gap_basis)
        )
        n_instants, n_columns = self._integrals.n_instants, gap_basis_or_identity.shape[1]
        instant_phases = 2.0 * np.pi / n_instants * np.arange(n_instants)
        fourier_basis_samples = fourier_basis(instant_phases, np.arange(1, n_rows // 2 + 1))
        fourier_integration_weights = 2.0 / n_instants * fourier_basis_samples
        fourier_integration_weights[:, 0] *= 0.5
        coefficient_tangent_matrix = np.empty((n_rows, n_columns, n_rows * n_columns))
        if kernel.friction_tangent(
            self._integrals.friction_contact_solver.handle, n_instants,
            pointer(self.contact_states), pointer(self._last_unstuck_instants), n_rows,
            pointer(fourier_basis_samples),
            pointer(fourier_integration_weights), n_columns,
            pointer(gap_basis_or_identity), pointer(coefficient_tangent_matrix),
        ):  # fmt: skip
            raise MemoryError("friction")
        return coefficient_tangent_matrix

    def series_softness_derivative(self) -> np.ndarray:
        return self._force_coefficient_change(
            -self._integrals.mean_pair_compliance * self._force_samples
        )

    def log_stiffness_derivative(self) -> np.ndarray:
        return self._force_coefficient_change(
            self._force_samples * self._integrals.spring_compliance
        )

    def friction_scale_derivative(self) -> np.ndarray:
        """Return the forces' derivative by a factor for the friction coefficient.

        The result has Fourier coefficients (2H+1, 2 n_pairs) [N]. Let f be the derivative of the
        slipping pairs' friction forces at fixed normal forces. Through the series compliance D, f
        changes the slow gaps by -D f. The result is f plus the force change by this gap change.
        """
        integrals, n_pairs = self._integrals, self._shape[1] // 2
        friction_law = friction_of(integrals.law)
        assert friction_law is not None
        slip_signs = 1.0 * (self.contact_states == kernel.SLIP_UP) - (
            self.contact_states == kernel.SLIP_DOWN
        )
        slip_force_derivative_by_scale = np.zeros_like(self._force_samples)
        slip_force_derivative_by_scale[:, n_pairs:] = (
            slip_signs * friction_law.coefficient * self._force_samples[:, :n_pairs]
        )
        series_compliance_matrix = integrals.series_compliance_matrix
        return fourier_coefficients(
            slip_force_derivative_by_scale, integrals.harmonics
        ) + self._force_coefficient_change(
            -slip_force_derivative_by_scale @ series_compliance_matrix
        )
