"""Harmonic balance condensed onto the contact pairs: the gap's harmonics are the only unknowns.

    F(s) = s - g_lin + (R_k - R_inf) b_k(lambda(s)) = 0,       J = I + (R - R_inf) T,

with the compliance R of :mod:`compliance`, block diagonal in the harmonics, the static compliance
R_inf through which contact is seen, and the coefficients b of the contact forces lambda(s), T their
derivative. The gap is g = s - R_inf lambda(s). How the forces follow from s is a strategy:

pair by pair   R_inf = 0, s = g: the penalty law of pairs by themselves (:mod:`contact_integrals`);
coupled        R_inf couples the pairs. R_k - R_inf falls like k^-2: s is smooth, and only s is
               truncated; g keeps its kinks. The penalty law and the constraint are one law, with a
               stiffness or without;
projected      without penetration at all, of pairs with mass: R_inf = I / eps in frequency, s = g +
               lambda / eps, lambda = eps max(s, 0) pair by pair, the dynamic Lagrangian. Truncated
               solutions depend a little on eps, less the more harmonics there are;
sampled        any other law, by alternating between frequency and time (AFT).

Where modes are fewer than coupled pairs, R_k - R_inf = U R'_k U^T with an orthonormal basis U of
the gaps that modes can make, and steps are found in its coordinates:

    J^-1 r = r - U (I + R' U^T T U)^-1 R' U^T T r,       det J = det(I + R' U^T T U).

With many coupled unknowns J is not formed: GMRES takes products J v. With exact integrals paths are
followed by the kernel (``kernel/contact.h``, ``compliance.h``, ``krylov.h``): along p the contact
stiffness grows like e^(growth p), g_lin linearly, the softness falls, or the base frequency and the
damping of modes change, R and g_lin following from them.

Sources: Nacivet, Pierre, Thouverez, Jezequel, Journal of Sound and Vibration 265 (2003) 201-219
(projected); Monjaraz-Tec, Gross and Krack, arXiv 2111.07693 and 2207.00795 (coupled, in time),
2603.26446 (in frequency).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import Compliance, resized_compliance
from fenics_crack.balance.contact_integrals import ContactIntegrals, respond
from fenics_crack.balance.friction_integrals import (
    FrictionForces,
    FrictionIntegrals,
    coupled_integrals,
)
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.tables import hertz_of
from fenics_crack.kernel import Struct, kernel, owned, pointer, shaped
from fenics_crack.model.contact import ContactLaw, friction_of, is_rigid, seen_by, springs_of
from fenics_crack.model.modal import all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import (
    DenseLinearisation,
    Equations,
    Linearisation,
    solve_factored,
)
from fenics_crack.numerics.fourier import (
    evaluate,
    fourier_basis_for,
    fourier_basis_over_period,
    resize_harmonics,
    stretch_period,
)
from fenics_crack.numerics.newton import gmres

MATRIX_FREE = 350
"""Unknowns of a step from which the Jacobian of coupled pairs is not formed. Both ways take equally
long with about 300 to 350 unknowns of 18 pairs (measured with H = 8 to 40)."""

SOFT = 0.05
"""Compliance of moving parts over that of pairs, below which the solution is unique and close to
the linear one."""

ByParameter = Callable[["ContactPoint"], np.ndarray]


def default_weight(compliance: Compliance) -> float:
    """Inverse of the static compliance: the stiffness that the pairs see [N/m]."""
    largest = float(np.abs(compliance.matrices[0]).sum(axis=1).max())
    if not largest > 0.0:
        raise InputError("structure", "static compliance 0", "one whose pairs can move")
    return 1.0 / largest


class ContactSystem:
    """F(s) = s - g_lin + (R_k - R_inf) b(lambda(s)); small, and the same on every rank.

    Its parameter p leads from soft contact to the law itself, at p = 1: the compliance in series
    with every pair is ``softness`` |1 - p|^3, in parts of ``integrals.unit``.
    """

    def __init__(
        self, compliance: Compliance, integrals: ContactIntegrals, softness: float = 0.0
    ) -> None:
        self.compliance, self.integrals, self._softness = compliance, integrals, softness
        self.shape = compliance.shape
        self.size = int(np.prod(self.shape))
        self.residual = integrals.residual
        """R_inf [m/N]; None: zero."""
        rows, pairs = self.shape
        self.basis = compliance.basis if integrals.coupled else None
        """U, None where it is not needed."""
        size = rows * (pairs if self.basis is None else self.basis.shape[1])
        self.matrix_free = integrals.coupled and size > MATRIX_FREE
        self.work = min(size, MATRIX_FREE)
        """Unknowns by which the time of a step grows."""

    @cached_property
    def linear(self) -> np.ndarray:
        """g_lin: (2H+1, n_pairs) [m]."""
        return self.compliance.linear_gap

    @cached_property
    def moving(self) -> np.ndarray:
        """R_k - R_inf: (H+1, n_pairs, n_pairs) complex [m/N]."""
        matrices = self.compliance.matrices
        return matrices if self.residual is None else matrices - self.residual

    @cached_property
    def compiled(self) -> CompiledEquations | None:
        """The same along its parameter in the kernel, where it has them."""
        if not self.integrals.exact:
            return None
        softness = self._softness * self.integrals.unit
        return self.compile(self.linear, self.moving, softness=softness)

    def compile(
        self, linear: np.ndarray, compliance: np.ndarray | Mapping[str, Any], **along: Any
    ) -> CompiledEquations:
        """The kernel's equations of these pairs."""
        return CompiledEquations(
            self.residual, self._springs(self.integrals.law), linear, compliance,
            coupled=self.integrals.coupled, basis=self.basis, formed=not self.matrix_free, **along,
        )  # fmt: skip

    def _springs(self, law: ContactLaw) -> np.ndarray:
        """1/k of each row [m/N]."""
        return springs_of(law, self.shape[1] // (1 if friction_of(law) is None else 2))

    @cached_property
    def moving_seen(self) -> np.ndarray:
        """R'_k = U^T (R_k - R_inf) U."""
        assert self.basis is not None
        return self.basis.T @ self.moving @ self.basis

    def slow(self, gap: np.ndarray, force: np.ndarray, factor: int = 1) -> np.ndarray:
        """s of the coefficients of a gap and of its force, with any harmonics, of whose periods one
        of these has so many: (2H+1, n_pairs)."""
        gap, force = (
            resize_harmonics(stretch_period(rows, factor), self.integrals.harmonics)
            for rows in (gap, force)
        )
        return gap if self.residual is None else gap + force @ self.residual

    def gap(self, unknown: np.ndarray, force: np.ndarray) -> np.ndarray:
        """g = s - R_inf lambda, of waves or of values in time."""
        return unknown if self.residual is None else unknown - force @ self.residual

    def linearise(self, unknown: np.ndarray, parameter: float = 1.0) -> ContactPoint:
        """The equations at s, of the law itself or at a parameter."""
        left = 1.0 - parameter
        rate = -3.0 * self._softness * left * abs(left)
        return ContactPoint(
            self, unknown, self.integrals.with_softness(self._softness * abs(left) ** 3),
            lambda at: respond(self.moving, rate * at.forces.by_softness()),
        )  # fmt: skip

    def along(self, unknown: np.ndarray, by_parameter: ByParameter) -> ContactPoint:
        """The equations at s, with the derivative by another parameter."""
        return ContactPoint(self, unknown, self.integrals, by_parameter)

    def steepest_force(self, law: ContactLaw) -> float:
        """Largest slope of lambda(s) for a law, the inverse of the smallest eigenvalue of R_inf +
        I/k [N/m]."""
        springs = self._springs(law)
        least = float(springs.min())
        if self.residual is not None:
            least = max(least, float(np.linalg.eigvalsh(self.residual + np.diag(springs))[0]))
        return 1.0 / max(least, 1e-300)

    def along_friction(self) -> FrictionPath:
        """The same equations, whose parameter is the share of the coefficient of friction."""
        return FrictionPath(self.compliance, self.integrals)

    def softened(self) -> ContactSystem:
        """The same equations, whose parameter starts where pairs hardly touch each other."""
        largest = float(np.abs(self.moving).sum(axis=2).max())
        softness = largest / (SOFT * self.integrals.unit)
        return ContactSystem(self.compliance, self.integrals, softness)

    def widened(self, harmonics: int) -> ContactSystem:
        """The same equations with more harmonics, to the accuracy of an error estimate."""
        compliance = resized_compliance(self.compliance, harmonics)
        return ContactSystem(compliance, self.integrals.widened(harmonics))


class FrictionPath(ContactSystem):
    """:class:`ContactSystem` from contact without friction, at p = 0, to that with all of it."""

    def linearise(self, unknown: np.ndarray, parameter: float = 1.0) -> ContactPoint:
        """The equations at s with a share of the coefficient of friction."""
        assert isinstance(self.integrals, FrictionIntegrals)
        part = replace(self.integrals, share=max(parameter, 0.0))
        return ContactPoint(self, unknown, part, by_friction)


class ContactPoint(DenseLinearisation):
    """:class:`ContactSystem` at s, and what changes of it do to the gap."""

    def __init__(
        self,
        system: ContactSystem,
        unknown: np.ndarray,
        integrals: ContactIntegrals,
        by_parameter: ByParameter,
    ) -> None:
        self.system, self.unknown, self._derivative = system, unknown, by_parameter
        self.forces = integrals.linearise(unknown)
        self.force = self.forces.force
        """Coefficients of the contact force, (2H+1, n_pairs) [N]."""
        self.gap = system.gap(unknown, self.force)
        """Coefficients (2H+1, n_pairs) [m]."""

    @cached_property
    def residual(self) -> np.ndarray:  # type: ignore[override]
        """F(s)."""
        system = self.system
        return self.unknown - system.linear + respond(system.moving, self.force)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """I + (R - R_inf) T."""
        return self.forces.identity_plus(self.system.moving)

    def condense(self) -> np.ndarray:
        system = self.system
        if system.basis is not None:
            return self.forces.identity_plus(system.moving_seen, system.basis)
        return self.jacobian

    def apply(self, change: np.ndarray) -> np.ndarray:
        return change + respond(self.system.moving, self.forces.apply(change))

    def solve(self, right: np.ndarray) -> np.ndarray:
        system = self.system
        if system.matrix_free:
            return gmres(self.apply, right, kernel.SHARP)
        factors = self._factors
        if system.basis is not None:
            drive = respond(system.moving, self.forces.apply(right)) @ system.basis
            return right - solve_factored(factors, drive) @ system.basis.T
        return solve_factored(factors, right)

    @property
    def sign(self) -> float:
        """Sign of det J; nan where J is not formed."""
        return np.nan if self.system.matrix_free else super().sign

    @cached_property
    def by_parameter(self) -> np.ndarray:
        return self._derivative(self)

    def gap_of(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap that belongs to a change of s."""
        return self.system.gap(change, self.forces.apply(change))

    def gap_by_force(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap if the contact force were changed."""
        moved = self.solve(-respond(self.system.moving, change))
        return self.system.gap(self.gap_of(moved), change)


# --- what solves it -------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Wave:
    """u(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t), w = omega / subharmonic.

    Its attributes are those of :class:`fenics_crack.PeriodicSolution`.
    """

    frequency = hertz_of()
    structure: Structure
    omega: float
    contact: ContactLaw | None
    displacement_coefficients: np.ndarray
    gap_coefficients: np.ndarray
    force_coefficients: np.ndarray
    subharmonic: int
    static_above: float | None = None
    tangential_gap_coefficients: np.ndarray | None = None
    tangential_force_coefficients: np.ndarray | None = None

    @property
    def harmonics(self) -> int:
        """H, the highest harmonic kept."""
        return (len(self.gap_coefficients) - 1) // 2

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def period(self) -> float:
        """Period of the response [s]."""
        return float(2.0 * np.pi / self.base_omega)

    @cached_property
    def residual(self) -> np.ndarray | None:
        """R_inf, the residual flexibility, which responds quasi-statically to contact forces:
        (n_rows, n_rows) [m/N]; None without. Rows are those of the pairs, with friction of their
        normals and behind them of their tangents."""
        if self.static_above is None:
            return None
        return all_modes(self.row_structure).static_part(self.static_above)

    @cached_property
    def row_structure(self) -> Structure:
        """The structure with its rows as pairs."""
        return seen_by(self.contact, self.structure)

    @property
    def gap_rows(self) -> np.ndarray:
        """Coefficients of the gaps of all rows: (2H+1, n_rows) [m]."""
        return _beside(self.gap_coefficients, self.tangential_gap_coefficients)

    @property
    def force_rows(self) -> np.ndarray:
        """Coefficients of the forces on all rows: (2H+1, n_rows) [N]."""
        return _beside(self.force_coefficients, self.tangential_force_coefficients)

    @cached_property
    def _integrals(self) -> ContactIntegrals:
        """lambda(s) with a residual flexibility, or with friction."""
        assert self.contact is not None
        found, rows = self.residual, self.row_structure.n_pairs
        residual = np.zeros((rows, rows)) if found is None else found
        return coupled_integrals(self.contact, self.harmonics, residual)

    @cached_property
    def slow_gap_coefficients(self) -> np.ndarray:
        """Coefficients of s = g + R_inf lambda, the gaps of all rows less their quasi-static part:
        (2H+1, n_rows)."""
        if self.residual is None:
            return self.gap_rows
        return self.gap_rows + self.force_rows @ self.residual

    def at_phase(self, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """1, cos, sin, ... at phases (n,) of the response, (n, 2H+1), by which coefficients are
        multiplied; gaps [m] and contact forces [N] of all rows there: (n, n_rows) each."""
        return self._with(fourier_basis_for(self.gap_coefficients, phase), phase)

    def over_period(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same at the instants i T / count."""
        phase = 2.0 * np.pi / count * np.arange(count)
        return self._with(fourier_basis_over_period(self.harmonics, count), phase)

    def _with(
        self, values: np.ndarray, phase: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        contact = self.contact
        slow = values @ self.slow_gap_coefficients
        if contact is None:
            return values, slow, np.zeros_like(slow)
        if friction_of(contact) is not None:
            assert isinstance(self._integrals, FrictionIntegrals)
            force = self._integrals.at(self.slow_gap_coefficients, phase)[0]
        elif self.residual is not None:
            force = self._integrals.forces(slow)
        elif not is_rigid(contact):
            force = contact.force(slow)
        else:
            assert contact.weight is not None
            force = np.maximum(0.0, contact.weight * slow + values @ self.force_coefficients)
        return values, slow if self.residual is None else slow - force @ self.residual, force

    def gaps_and_forces(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gaps [m] and contact forces [N] of all rows at times [s]: (len(time), n_rows) each."""
        _, gap, force = self.at_phase(self.base_omega * np.atleast_1d(time))
        return gap, force

    def gap(self, time: np.ndarray) -> np.ndarray:
        """g at times [s]: (len(time), n_pairs) [m]. Where some of it answers contact forces at
        once, s(t) - R_inf lambda(s(t)), with its kinks."""
        if self.residual is None:
            return evaluate(self.gap_coefficients, self.base_omega, time)
        return self.gaps_and_forces(time)[0][:, : self.structure.n_pairs]

    def contact_force(self, time: np.ndarray) -> np.ndarray:
        """Contact force at times [s]: (len(time), n_pairs) [N], lambda(g(t)) or lambda(s(t)); of a
        constraint of uncoupled pairs, eps max(0, g + lambda / eps) of the waves."""
        return self.gaps_and_forces(time)[1][:, : self.structure.n_pairs]

    def tangential_gap(self, time: np.ndarray) -> np.ndarray:
        """g_t of contact with friction at times [s]: (len(time), n_pairs) [m]."""
        self._check_friction()
        return self.gaps_and_forces(time)[0][:, self.structure.n_pairs :]

    def tangential_force(self, time: np.ndarray) -> np.ndarray:
        """lambda_t of contact with friction at times [s]: (len(time), n_pairs) [N]."""
        self._check_friction()
        return self.gaps_and_forces(time)[1][:, self.structure.n_pairs :]

    def sticking_places(self, time: np.ndarray) -> np.ndarray:
        """h of contact with friction, the place in the tangential gap where a pair sticks or would,
        at times [s]: (len(time), n_pairs) [m]."""
        self._check_friction()
        assert isinstance(self._integrals, FrictionIntegrals)
        return self._integrals.at(self.slow_gap_coefficients, self.base_omega * time)[1]

    def _check_friction(self) -> None:
        if friction_of(self.contact) is None:
            raise InputError("contact", self.contact, "CoulombFriction")

    def coordinates(self, time: np.ndarray) -> np.ndarray:
        """Displacement of the structure's own dofs on this rank: (len(time), n_local) [m]."""
        values, _, force = self.at_phase(self.base_omega * np.atleast_1d(time))
        found = values @ self.displacement_coefficients
        if self.static_above is not None:
            # The quasi-static part follows the forces as they are, with their kinks.
            moved = all_modes(self.row_structure).moved_at_once(self.static_above)
            found -= (force - values @ self.force_rows) @ moved.T
        return found


def _beside(normal: np.ndarray, tangential: np.ndarray | None) -> np.ndarray:
    return normal if tangential is None else np.hstack([normal, tangential])


# --- in the kernel --------------------------------------------------------------------------------


class CompiledEquations(Equations):
    """F(s, p) = 0 of contact pairs, from R_inf, 1/k (n_pairs,), g_lin (2H+1, n_pairs) without the
    part of modes and R_k - R_inf, or what it follows from, at p = 0.

    Along p grow g_lin by ``linear_rate`` and ln k by ``growth``; ``softness`` |1 - p|^3 [m/N] is in
    series with each pair. ``coupled``: R_inf has more than a diagonal; ``basis``: U where modes are
    fewer than coupled pairs; ``formed``: J is formed, else solutions take products with it, and its
    sign is nan.
    """

    def __init__(
        self,
        residual: np.ndarray | None,
        springs: np.ndarray,
        linear: np.ndarray,
        compliance: np.ndarray | Mapping[str, Any],
        *,
        coupled: bool = False,
        basis: np.ndarray | None = None,
        formed: bool = True,
        linear_rate: np.ndarray | None = None,
        growth: float = 0.0,
        softness: float = 0.0,
    ) -> None:
        self.shape = linear.shape
        harmonics, pairs = self.shape[0] // 2, self.shape[1]
        if isinstance(compliance, np.ndarray):
            matrices = shaped(compliance, harmonics + 1, pairs, pairs, kind=complex)
            compliance = {"compliance": matrices}
        gaps = pairs if basis is None else basis.shape[1]
        at_once = np.zeros((pairs, pairs)) if residual is None else residual
        rate = np.zeros_like(linear) if linear_rate is None else linear_rate
        seen = Struct(
            "seen_structure", harmonics=harmonics, pairs=pairs, linear=shaped(linear, *self.shape),
            linear_rate=shaped(rate, *self.shape), **compliance,
        )  # fmt: skip
        self._given = Struct(
            "contact_pairs", seen=seen, growth=growth, softness=softness, coupled=coupled,
            residual=shaped(at_once, pairs, pairs), springs=shaped(springs, pairs), seen_gaps=gaps,
            formed=formed, basis=None if basis is None else shaped(basis, pairs, gaps),
        )  # fmt: skip
        self._point = owned(kernel.new_contact_point(self._given.at), kernel.free_contact_point)
        self.function_table = kernel.equations_of_contact(self._point)

    def linearise(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        """The equations at a point."""
        return CompiledPoint(self, shaped(unknown, *self.shape), parameter)

    def evaluated(self, at: CompiledPoint) -> Any:
        """The kernel's equations, evaluated at a point.

        Raises ConvergenceError where an instant has no forces.
        """
        if self._last_linearisation is not at:
            if not self.check_outcome(
                self.run(self.function_table.evaluate, pointer(at.unknown), at.parameter)
            ):
                raise ConvergenceError("contact: no forces were found at an instant of the period")
            self._last_linearisation = at
        return self.function_table

    def linearise_evaluated(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        self._last_linearisation = found = CompiledPoint(self, unknown, parameter)
        return found

    def largest_compliance(self, parameter: float) -> float:
        """Largest sum of abs(R_k - R_inf) over a row of it at a parameter [m/N]."""
        self._last_linearisation = None
        compliance = float(kernel.largest_moving(self._point, parameter))
        if not math.isfinite(compliance):
            self.check_outcome(kernel.SINGULAR_STRUCTURE)
        return compliance


class CompiledPoint(Linearisation):
    """:class:`CompiledEquations` at a point; evaluated again where the kernel has left it."""

    def __init__(self, system: CompiledEquations, unknown: np.ndarray, parameter: float) -> None:
        self.system, self.unknown, self.parameter = system, unknown, parameter

    @property
    def residual(self) -> np.ndarray:
        found = np.empty_like(self.unknown)
        at = self.system.evaluated(self)
        at.residual(at, pointer(found))
        return found

    def solve(self, right: np.ndarray) -> np.ndarray:
        found = np.array(right, dtype=float, order="C")
        if found.size != self.unknown.size:
            raise ValueError(f"{found.size} numbers instead of {self.unknown.size}")
        at = self.system.evaluated(self)
        at.sharp = kernel.SHARP
        at.solve(at, pointer(found))
        return found

    @property
    def by_parameter(self) -> np.ndarray:
        found = np.empty_like(self.unknown)
        at = self.system.evaluated(self)
        at.by_parameter(at, pointer(found))
        return found

    @property
    def sign(self) -> float:
        at = self.system.evaluated(self)
        return float(at.sign(at))


def by_friction(at: ContactPoint) -> np.ndarray:
    """Derivative of F by the share of the coefficient of friction."""
    assert isinstance(at.forces, FrictionForces)
    return respond(at.system.moving, at.forces.by_share())
