"""Dynamic compliance: all that contact pairs see of a structure.

A force lambda_k exp(i k w t) on the pairs moves their gaps by -R_k lambda_k, and the load alone
opens them by the linear gap,

    R_k = B^T Z_k^-1 B,        g_lin = B^T Z^-1 f - g0,        Z_k = K - (k w)^2 M + i k w C,

so that the gap's harmonics solve g + R lambda(g) = g_lin exactly, whatever lies behind R. Small
structures, reduced ones among them, answer in closed form from all of their modes; large ones by
one sparse factorisation for each harmonic.

With modal damping C is dense and never formed. One real symmetric sparse factorisation, of D = K -
omega^2 M, serves: with mass-normalised modes phi_j of natural frequency omega_j,

    Z^-1 = D^-1 + Phi diag(1/(d_j + 2 i xi_j omega_j omega) - 1/d_j) Phi^T

exactly, with d_j = omega_j^2 - omega^2. Close to a natural frequency the two terms with d_j cancel
and D is all but singular. There the mode is deflated: the bordered matrix

    [ D           M phi_j ]
    [ phi_j^T M   0       ]

is regular, inverts D on the M-orthogonal complement of phi_j, and the mode itself contributes
phi_j phi_j^T / (d_j + 2 i xi_j omega_j omega) with nothing cancelled.

With a given damping matrix, or that of Rayleigh damping, the real form of twice the size,
[[D, omega C], [-omega C, D]], is factored.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from petsc4py import PETSc

from fenics_crack.basics.errors import ConvergenceError, InputError, check_number
from fenics_crack.basics.ranks import collect_garbage
from fenics_crack.kernel import shaped
from fenics_crack.model.factor import Factor, weighted_sum
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import damped_modes, projected_damping, solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import from_complex, resize_harmonics, stretch_period, to_complex

DEFLATION_BAND = 1e-2
"""A mode is dealt with by itself where |1 - (omega/omega_j)^2| is below this."""


class DynamicStiffness:
    """Z(omega) of a structure, factored.

    Free it with :meth:`destroy`, or use it as a context manager (collective).

    Parameters
    ----------
    structure : Structure
        Its M, C and K are taken.
    omega : float
        Angular frequency [rad/s]; 0 for statics.

    Raises
    ------
    InputError
        omega is negative or not finite, or is the natural frequency of an undamped mode.
    ConvergenceError
        Z is singular: for omega = 0, the structure can move as a rigid body.
    """

    def __init__(self, structure: Structure, omega: float) -> None:
        check_number("omega", omega, 0.0)
        self.structure = structure
        self._matrix, self._damping, self._modes = structure.stiffness, None, None
        if omega > 0.0:
            self._matrix = weighted_sum(structure.stiffness, -(omega**2), structure.mass)
            self._damping, self._modes = structure.damping_matrix, damped_modes(structure)
        form, border = self._matrix, None
        if self._damping is not None:
            coupling, negative = self._damping.copy(), self._damping.copy()
            coupling.scale(omega)
            negative.scale(-omega)
            form = PETSc.Mat().createNest([[form, coupling], [negative, form]], comm=form.comm)
            form = form.convert("aij", PETSc.Mat())
        elif self._modes is not None:
            squares = self._modes.omega**2
            stiffness = squares - omega**2
            near = np.abs(stiffness) < DEFLATION_BAND * squares
            if np.any(self._modes.omega[near & (self._modes.rate == 0.0)] == omega):
                raise InputError("omega", omega, "away from the frequency of an undamped mode")
            factored = np.divide(1.0, stiffness, out=np.zeros_like(stiffness), where=~near)
            self._correction = 1.0 / (stiffness + 1j * omega * self._modes.rate) - factored
            if near.any():
                border = sparse.csr_matrix(self._modes.mass_shapes[:, near])
        self._factor = Factor(form, symmetric=self._damping is None, border=border)
        if self._factor.null_pivots:
            self.destroy()
            cause = "it can move as a rigid body" if omega == 0.0 else "an undamped resonance"
            raise ConvergenceError(
                f"dynamic stiffness at {omega:g} rad/s: the structure is singular ({cause})"
            )

    def solve(self, force: np.ndarray) -> np.ndarray:
        """Return Z^-1 f for real or complex forces (m, n_local) (collective)."""
        n_local = self.structure.n_local
        if self._damping is not None:
            stacked = np.concatenate([np.real(force), -np.imag(force)], axis=1)
            found = self._factor.solve(stacked)
            return found[:, :n_local] - 1j * found[:, n_local:]
        rows = np.concatenate([force.real, force.imag]) if np.iscomplexobj(force) else force
        found = self._factor.solve(rows)
        if np.iscomplexobj(force):
            found = found[: len(force)] + 1j * found[len(force) :]
        if self._modes is None:
            return found
        modal = self.structure.sum_over_ranks(force @ self._modes.shapes)
        return found + (modal * self._correction) @ self._modes.shapes.T

    def compliance(self) -> np.ndarray:
        """Return R = B^T Z^-1 B as seen by the contact pairs: (n_pairs, n_pairs) [m/N]."""
        return self.structure.apply_bt(self.solve(self.structure.gap.T.toarray())).T

    def destroy(self) -> None:
        """Free the matrices and factors (collective)."""
        self._factor.destroy()
        if self._matrix is not self.structure.stiffness:
            self._matrix.destroy()

    def __enter__(self) -> DynamicStiffness:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()


def dynamic_compliance(
    structure: Structure, base_omega: float, harmonics: int, subharmonic: int = 1
) -> Compliance:
    """Compliance at the multiples of ``base_omega`` (collective).

    The load sits on harmonic ``subharmonic``.

    Raises
    ------
    ConvergenceError
        The structure is in an undamped resonance, or can move as a rigid body.
    """
    load = load_coefficients(structure, harmonics, subharmonic)
    if is_small(structure) and not all_modes(structure).ill_conditioned:
        return ModalCompliance(structure, base_omega, load)
    return FactoredCompliance(structure, base_omega, load)


def load_coefficients(structure: Structure, harmonics: int, subharmonic: int) -> np.ndarray:
    """c: coefficients of the load, (2H+1, n_local) [N]."""
    return resize_harmonics(stretch_period(structure.force, subharmonic), harmonics)


class ModalCompliance:
    """Closed form from all modes of a small structure, exact with any damping.

    With modal coordinates q, u = Phi q, the impedance is omega_j^2 - w^2 + i w c_j, or with damping
    that couples modes a full matrix of the same size.

    Attributes
    ----------
    shape : tuple of int
        (2H+1, n_pairs)
    matrices : (H+1, n_pairs, n_pairs) complex [m/N]
        R_k, symmetric.
    linear_gap : (2H+1, n_pairs) [m]
        Gap without contact, less the clearance.
    basis : (n_pairs, n) or None
        Orthonormal basis of the gaps that the modes can make; None where these are all gaps.
    still_gap : (2H+1, n_pairs) [m]
        The part of the linear gap that no mode makes.
    """

    def __init__(self, structure: Structure, base_omega: float, load: np.ndarray) -> None:
        if not is_small(structure):
            raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
        self._clearance = structure.clearance
        self._modes = all_modes(structure)
        self.basis = structure.once(_basis) if len(self._modes.pairs) < structure.n_pairs else None
        self._order = np.arange(len(load) // 2 + 1.0)
        self._unit_load = to_complex(load @ self._modes.shapes)
        self.shape: tuple[int, ...] = len(load), structure.n_pairs
        self._unit_static, self._static_gap = None, np.zeros(self.shape)
        if self._modes.static_loads is not None:
            self._unit_static = load @ self._modes.static_loads
            self._static_gap = structure.apply_bt(self._unit_static)
        self._set(base_omega, 1.0, 1.0, 0.0)

    def _set(self, base_omega: float, load: float, damping: float, clearance: float) -> None:
        self._base, self._damping = base_omega, damping
        loaded = self._unit_load != 0.0
        self._receptance = self._modes.receptance(base_omega * self._order, damping, loaded)
        self._modal_load = load * self._unit_load
        self._load = load
        self.still_gap = load * self._static_gap
        self.still_gap[0] -= self._clearance + clearance

    @cached_property
    def matrices(self) -> np.ndarray:
        return self._seen(self._receptance)

    @cached_property
    def linear_gap(self) -> np.ndarray:
        return self._gap(self._modal_load) + self.still_gap

    def at(
        self, base_omega: float, *, load: float = 1.0, damping: float = 1.0, clearance: float = 0.0
    ) -> ModalCompliance:
        """The same at another frequency, and of a varied structure (:meth:`Structure.varied`)."""
        other = object.__new__(type(self))  # faster than copy
        vars(other).update(vars(self))
        for found in ("matrices", "linear_gap"):
            vars(other).pop(found, None)
        other._set(base_omega, load, damping, clearance)
        return other

    def beyond(self, highest: int) -> np.ndarray:
        """R_k for k = H+1 to a higher harmonic."""
        order = np.arange(len(self.matrices), highest + 1)
        nowhere: np.ndarray = np.zeros((len(order), len(self._modes.squares)), dtype=bool)
        found = self._modes.receptance(self._base * order, self._damping, nowhere)
        return self._seen(found)

    def _seen(self, receptance: np.ndarray) -> np.ndarray:
        """R_k of receptances."""
        found = self._modes.seen_by_pairs(receptance)
        return found if self._modes.residual is None else found + self._modes.residual

    def displacement(self, force: np.ndarray) -> np.ndarray:
        """u = A^-1 (c - B lambda) of contact forces (2H+1, n_pairs): (2H+1, n_local)."""
        found = from_complex(-self._moved(force) @ self._modes.shapes.T)
        return found if self._unit_static is None else found + self._at_once(force)

    def displacements(self, base_omega: np.ndarray, force: np.ndarray) -> np.ndarray:
        """The same at many base frequencies (n,), of forces (2H+1, n, n_pairs): (2H+1, n,
        n_local)."""
        modes, omega = self._modes, np.multiply.outer(self._order, base_omega)
        loaded = np.repeat(self._unit_load != 0.0, len(base_omega), axis=0)
        receptance = modes.receptance(omega.ravel(), self._damping, loaded)
        drive = self._modal_load[:, None] - to_complex(force) @ modes.pairs.T
        moved = modes.respond(receptance.reshape(*omega.shape, *receptance.shape[1:]), drive)
        found = from_complex(moved @ modes.shapes.T)
        if self._unit_static is None:
            return found
        assert modes.static_pairs is not None
        return found + self._load * self._unit_static[:, None] - force @ modes.static_pairs.T

    def seen_through(self, rows: np.ndarray, force: np.ndarray) -> np.ndarray:
        """T u for rows T (m, n_local) that give the displacement of some dofs: (2H+1, m)."""
        found = from_complex(-self._moved(force) @ (rows @ self._modes.shapes).T)
        return found if self._unit_static is None else found + self._at_once(force) @ rows.T

    def _at_once(self, force: np.ndarray) -> np.ndarray:
        """Displacement of what has no mass: (2H+1, n_local)."""
        assert self._modes.static_pairs is not None and self._unit_static is not None
        return self._load * self._unit_static - force @ self._modes.static_pairs.T

    def modal_part(
        self,
        omega: tuple[float, float],
        damping: tuple[float, float],
        residual: np.ndarray | None = None,
    ) -> dict[str, Any] | None:
        """Return R_k less a static compliance as the kernel takes it (``seen_structure``), for
        paths in the base frequency w and the factor d of the damping, from their values at p = 0
        and their rates; None where damping couples modes.

        R_k = P^T h_k P + at_once, to which the load adds P^T h_k l_k in g_lin, with h_kj =
        1 / (s_j - (k w)^2 + i k w d c_j); s (n_modes,) [rad^2/s^2] are ``squares``, c (n_modes,)
        [1/s] ``rates``, P (n_modes, n_pairs) ``shapes`` and l (H+1, n_modes) ``load``.
        """
        modes = self._modes
        if modes.damping.ndim == 2:
            return None
        (count, pairs), at_once = modes.pairs.shape, modes.residual
        if residual is not None:
            at_once = -residual if at_once is None else at_once - residual
        return {
            "modes": count,
            "omega": omega[0],
            "omega_rate": omega[1],
            "damping": damping[0],
            "damping_rate": damping[1],
            "squares": shaped(modes.squares, count),
            "rates": shaped(modes.damping, count),
            "shapes": shaped(modes.pairs, count, self.shape[1]),
            "load": shaped(self._load * self._unit_load, len(self._order), count, kind=complex),
            "at_once": None if at_once is None else shaped(at_once, pairs, pairs),
        }

    def derivative(self, name: str, force: np.ndarray) -> np.ndarray:
        """Return the derivative of R lambda - g_lin for fixed forces, (2H+1, n_pairs), by one of
        the parameters of :meth:`at`.

        With H = Z^-1, dH = -H dZ H, dZ_k = (-2 k^2 w + i k d c) dw + i k w c dd.
        """
        order = self._order[:, None]
        if name == "clearance":
            found = np.zeros_like(force)
            found[0] = 1.0
            return found
        if name == "load":
            return -self._gap(self._unit_load) - self._static_gap
        if name == "damping":
            damped = 1j * self._modes.damped(self._moved(force))
            return -self._gap(self._base * order * damped)
        return from_complex(self._moved_by_omega(force) @ self._modes.pairs)

    def seen_by_omega(self, rows: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the derivative of :meth:`seen_through` by the base frequency for fixed forces:
        (2H+1, m)."""
        return from_complex(-self._moved_by_omega(force) @ (rows @ self._modes.shapes).T)

    def _moved_by_omega(self, force: np.ndarray) -> np.ndarray:
        """Derivative of the modal response to the contact forces less the load."""
        order, moved = self._order[:, None], self._moved(force)
        damped = 1j * self._damping * self._modes.damped(moved)
        drive = order * (damped - 2.0 * self._base * order * moved)
        return -self._modes.respond(self._receptance, drive)

    def _gap(self, drive: np.ndarray) -> np.ndarray:
        """Gap coefficients (2H+1, n_pairs) under modal forces (H+1, n_modes)."""
        return from_complex(self._modes.respond(self._receptance, drive) @ self._modes.pairs)

    def _moved(self, force: np.ndarray) -> np.ndarray:
        """Modal response to the contact forces less the load."""
        drive = to_complex(force) @ self._modes.pairs.T - self._modal_load
        return self._modes.respond(self._receptance, drive)

    def destroy(self) -> None:
        """Nothing is held."""


class FactoredCompliance:
    """Exact, from one sparse factorisation per harmonic; the factors are kept.

    Attributes are those of :class:`ModalCompliance`, and

    Attributes
    ----------
    structure : Structure
        Whose compliance it is.
    load : (2H+1, n_local) [N]
        c, coefficients of the load.
    """

    basis: np.ndarray | None = None

    def __init__(self, structure: Structure, base_omega: float, load: np.ndarray) -> None:
        self.structure, self.load = structure, load
        self._base, orders = base_omega, range(len(load) // 2 + 1)
        self._blocks = [DynamicStiffness(structure, k * base_omega) for k in orders]
        matrices = np.array([block.compliance() for block in self._blocks], dtype=complex)
        linear_gap = structure.gap_of(self.solve_blocks(load))
        # Every rank goes on by itself with these: they must not differ even by rounding.
        self.matrices, self.linear_gap = structure.comm.bcast((matrices, linear_gap))
        self.shape = self.linear_gap.shape
        if not (np.all(np.isfinite(self.matrices)) and np.all(np.isfinite(self.linear_gap))):
            self.destroy()
            raise ConvergenceError("dynamic compliance: the structure is singular")

    def beyond(self, highest: int) -> np.ndarray:
        """R_k for k = H+1 to ``highest``, from some modes and the rest of the static R_0."""
        omega, rate, pairs = self.structure.once(_lowest_modes)
        rate = self.structure.damping_factor * rate
        static = self.matrices[0].real - (pairs.T / omega**2) @ pairs
        frequency = self._base * np.arange(len(self.matrices), highest + 1)[:, None]
        receptance = 1.0 / (omega**2 - frequency**2 + 1j * frequency * rate)
        return static + np.matmul(pairs.T * receptance[:, None, :], pairs)

    def displacement(self, force: np.ndarray) -> np.ndarray:
        """u = A^-1 (c - B lambda)."""
        return self.solve_blocks(self.load - self.structure.apply_b(force))

    def solve_blocks(self, force: np.ndarray) -> np.ndarray:
        """A^-1 f of coefficients (2H+1, n_local)."""
        rows = [
            block.solve(row.real[None] if k == 0 else row[None])[0]
            for k, (block, row) in enumerate(zip(self._blocks, to_complex(force), strict=True))
        ]
        return from_complex(np.array(rows, dtype=complex))

    def destroy(self) -> None:
        """Free the factors (collective)."""
        for block in self._blocks:
            block.destroy()
        collect_garbage(self.structure.comm)


Compliance = ModalCompliance | FactoredCompliance
"""Compliance at the multiples 0 to H of a base frequency."""


def resized_compliance(compliance: Compliance, harmonics: int) -> Compliance:
    """The same with fewer harmonics, or with more, the new ones to the accuracy of an error
    estimate; displacements stay those of the harmonics that it had."""
    other = copy(compliance)
    matrices = compliance.matrices[: harmonics + 1]
    if len(matrices) <= harmonics:
        matrices = np.concatenate([matrices, compliance.beyond(harmonics)])
    other.matrices, other.linear_gap = matrices, resize_harmonics(compliance.linear_gap, harmonics)
    other.shape = other.linear_gap.shape
    return other


def _basis(structure: Structure) -> np.ndarray:
    """Orthonormal basis of B^T Phi: (n_pairs, n)."""
    return scipy.linalg.orth(all_modes(structure).pairs.T)


def _lowest_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """omega, damping rate and B^T phi of the damped modes, of 20 at least."""
    known, count = damped_modes(structure), min(20, structure.n_dofs)
    modes = known if known and len(known.omega) >= count else solve_modes(structure, count)
    rate = np.diag(projected_damping(structure, modes.shapes))
    found = modes.omega > 0.0  # the lowest may be lost in rounding
    return modes.omega[found], rate[found], structure.apply_bt(modes.shapes.T)[found]
