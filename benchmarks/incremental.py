"""Incremental harmonic balance: linearise in time first, then balance.

With theta = w t and a motion u(theta) nearby, the increment du of a step obeys the linear equation
with periodic coefficients

    w^2 M du'' + w C du' + (K + B kappa(g) B^T) du = r(theta),
    r = f - w^2 M u'' - w C u' - K u - B lambda(g),      kappa = d lambda/dg,    g = B^T u - g0.

Galerkin's method with the functions 1, cos(k theta), sin(k theta), over the period (1/pi int, and
1/(2 pi) int for the mean), makes of it a linear system for the coefficients,

    K_C(u) du = R(u).

The projection is linear and does not see whether an equation is linearised before or after it:
K_C is the Jacobian A + B T B^T of the classical equations A u + B b(g) - c = 0, and R their
residual reversed, where T, b and these integrals are by the same quadrature. So the increments are
Newton's steps, and there is no solver of its own here: this module assembles K_C and R as the
method says, by quadrature of the equation in time, to be compared.

Sources: Lau, Cheung, Journal of Applied Mechanics 48, 1981, 959-964; their equality: Ferri, Journal
of Applied Mechanics 53, 1986, 455-457.
"""

from __future__ import annotations

import numpy as np
from switching import switching_instants

import fenics_crack as fc
from fenics_crack.balance.compliance import load_coefficients
from fenics_crack.balance.contact_integrals import default_instants_per_period
from fenics_crack.basics.errors import check_count, check_omega
from fenics_crack.model.contact import check_law
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.numerics.fourier import evaluate_series, to_complex

__all__ = ["incremental_system"]


def incremental_system(
    structure: fc.Structure,
    omega: float,
    contact: fc.ContactLaw,
    displacement: np.ndarray,
    *,
    samples: int | None = None,
    subharmonic: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right-hand side of one step of the incremental harmonic balance, K_C du = R.

    Parameters
    ----------
    structure : Structure
        Small, on one rank: its matrices are made dense.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law of all pairs.
    displacement : (2H+1, n_dofs) [m]
        Coefficients of the motion about which the equation is linearised.
    samples : int, optional
        N >= 2H+1 equally spaced instants. Default: for the penalty law Gauss-Legendre quadrature
        between the switching instants, exact to rounding; for other laws the default of
        :func:`solve_harmonic_balance`.
    subharmonic : int
        m: the motion has m times the load's period.

    Returns
    -------
    matrix : ((2H+1) n_dofs, (2H+1) n_dofs) [N/m]
        K_C for increments ordered (row, dof).
    residual : (2H+1, n_dofs) [N]
        R.

    Raises
    ------
    InputError
        An argument cannot be used.
    """
    check_omega(omega)
    check_count("subharmonic", subharmonic, 1)
    if not is_small(structure):
        raise fc.InputError(
            "structure", f"{structure.n_dofs} dofs", "small or reduced, on one rank"
        )
    check_law(structure, contact)
    displacement = np.asarray(displacement, dtype=float)
    rows = len(displacement) if displacement.ndim == 2 else 0
    if rows % 2 == 0 or rows < 2 * subharmonic + 1 or displacement.shape[1] != structure.n_dofs:
        allowed_shape = f"(2H+1, {structure.n_dofs}) with H >= {subharmonic}"
        raise fc.InputError("displacement", displacement.shape, allowed_shape)
    harmonics = rows // 2
    if samples is not None:
        check_count("samples", samples, rows)
    gap = structure.apply_bt(displacement)
    gap[0] -= structure.clearance
    if samples is None and isinstance(contact, fc.UnilateralPenalty):
        theta, weight = _between_switching(gap)
    else:
        count = samples or subharmonic * default_instants_per_period(harmonics)
        theta, weight = 2.0 * np.pi / count * np.arange(count), np.full(count, 2.0 * np.pi / count)

    # The functions at the instants, (N, 2H+1), and their first and second derivative by theta.
    value = evaluate_series(np.eye(rows), 1.0, theta)
    derivative = _derivative(harmonics)
    rate, bend = value @ derivative, value @ derivative @ derivative
    test = weight[:, None] * value / np.pi
    test[:, 0] /= 2.0

    base = omega / subharmonic
    mass, dashpots, stiffness = _dense_matrices(structure)
    pairs = structure.gap.toarray()
    wave = value @ gap
    slope = np.broadcast_to(contact.tangent(wave), wave.shape)

    matrix = np.kron(test.T @ bend, base**2 * mass)
    matrix += np.kron(test.T @ rate, base * dashpots)
    matrix += np.kron(test.T @ value, stiffness)
    for pair, kappa in zip(pairs.T, slope.T, strict=True):
        matrix += np.kron(test.T @ (kappa[:, None] * value), np.outer(pair, pair))

    load = value @ load_coefficients(structure, harmonics, subharmonic)
    inertia = base**2 * (bend @ displacement) @ mass
    damping = base * (rate @ displacement) @ dashpots.T
    elastic_force = value @ displacement @ stiffness
    return matrix, test.T @ (
        load - inertia - damping - elastic_force - contact.force(wave) @ pairs.T
    )


def _derivative(harmonics: int) -> np.ndarray:
    """d/dtheta: coefficients of the derivative from those of a wave, (2H+1, 2H+1)."""
    matrix = np.zeros((2 * harmonics + 1, 2 * harmonics + 1))
    cosine = np.arange(1, 2 * harmonics, 2)
    order = (cosine + 1) // 2
    matrix[cosine, cosine + 1], matrix[cosine + 1, cosine] = order, -order
    return matrix


def _between_switching(gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Instants and weights of Gauss-Legendre quadrature between all switching instants."""
    instants = np.sort(switching_instants(to_complex(gap)).theta)
    ends = np.concatenate(([0.0], instants, [2.0 * np.pi]))
    node, weight = np.polynomial.legendre.leggauss(2 * len(gap) + 16)
    half = 0.5 * np.diff(ends)[:, None]
    theta = ends[:-1, None] + half * (1.0 + node)
    return theta.ravel(), (half * weight).ravel()


def _dense_matrices(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, C and K, the damping by all modes: C = M Phi c Phi^T M."""
    everywhere = range(structure.n_dofs)
    mass, stiffness = (
        matrix.getValues(everywhere, everywhere) for matrix in (structure.mass, structure.stiffness)
    )
    modes = all_modes(structure)
    shapes = mass @ modes.shapes
    rate = modes.damping
    damped_shapes = shapes * rate if rate.ndim == 1 else shapes @ rate
    return mass, damped_shapes @ shapes.T, stiffness
