"""Dynamic compliance: the response of a structure's gaps to forces on its contact pairs.

A force lambda_k exp(i k w t) on the pairs moves their gaps by -R_k lambda_k. The load alone opens
them by the linear gap:

    R_k = B^T Z_k^-1 B,        g_lin = B^T Z^-1 f - g0,        Z_k = K - (k w)^2 M + i k w C,

with the gaps B^T u - g0 of displacements u and the load f. The gap's harmonics solve
g + R lambda(g) = g_lin exactly, for any structure. Small and reduced structures have closed forms
from all of their modes. Large structures need a sparse factorisation for each harmonic.

With modal damping C is dense and never formed. D = K - omega^2 M, real, symmetric and sparse, is
factored. With mass-normalised modes phi_j of natural frequency omega_j and d_j = omega_j^2 -
omega^2,

    Z^-1 = D^-1 + Phi diag(1/(d_j + 2 i xi_j omega_j omega) - 1/d_j) Phi^T

exactly. Close to a natural frequency the two terms with d_j cancel, and D is all but singular. The
mode is then deflated: the bordered matrix

    [ D           M phi_j ]
    [ phi_j^T M   0       ]

is regular and inverts D on the M-orthogonal complement of phi_j. The mode itself contributes phi_j
phi_j^T / (d_j + 2 i xi_j omega_j omega), without cancellation.

With a damping matrix, given or by Rayleigh, the real form of twice the size, [[D, omega C], [-omega
C, D]], is factored.
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
from fenics_crack.kernel import require_shape
from fenics_crack.model.factor import Factor, weighted_sum
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import damped_modes, projected_damping, solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import from_complex, resize_harmonics, stretch_period, to_complex

DEFLATION_BAND = 1e-2
"""Value of |1 - (omega/omega_j)^2| below which a mode is deflated."""


class DynamicStiffness:
    """Factorised dynamic stiffness Z = K - omega^2 M + i omega C.

    Free it with :meth:`destroy`, or use it as a context manager (collective).

    Parameters
    ----------
    structure : Structure
        Structure with M, C and K.
    omega : float
        Angular frequency [rad/s]; 0 for statics.

    Raises
    ------
    InputError
        omega is negative or not finite, or is the natural frequency of an undamped mode.
    ConvergenceError
        Z is singular. For omega = 0, the structure can move as a rigid body.
    """

    def __init__(self, structure: Structure, omega: float) -> None:
        check_number("omega", omega, 0.0)
        self.structure = structure
        self._matrix, self._damping, self._modes = structure.stiffness, None, None
        if omega > 0.0:
            self._matrix = weighted_sum(structure.stiffness, -(omega**2), structure.mass)
            self._damping, self._modes = structure.damping_matrix, damped_modes(structure)
        system_matrix, border = self._matrix, None
        if self._damping is not None:
            coupling, negative_coupling = self._damping.copy(), self._damping.copy()
            coupling.scale(omega)
            negative_coupling.scale(-omega)
            system_matrix = PETSc.Mat().createNest(
                [[system_matrix, coupling], [negative_coupling, system_matrix]],
                comm=system_matrix.comm,
            )
            system_matrix = system_matrix.convert("aij", PETSc.Mat())
        elif self._modes is not None:
            squares = self._modes.omega**2
            stiffness = squares - omega**2
            is_near = np.abs(stiffness) < DEFLATION_BAND * squares
            if np.any(self._modes.omega[is_near & (self._modes.modal_damping == 0.0)] == omega):
                raise InputError("omega", omega, "away from the frequency of an undamped mode")
            factored_part = np.divide(1.0, stiffness, out=np.zeros_like(stiffness), where=~is_near)
            self._correction = (
                1.0 / (stiffness + 1j * omega * self._modes.modal_damping) - factored_part
            )
            if is_near.any():
                border = sparse.csr_matrix(self._modes.mass_shapes[:, is_near])
        self._factor = Factor(system_matrix, symmetric=self._damping is None, border=border)
        if self._factor.null_pivots:
            self.destroy()
            cause = "it can move as a rigid body" if omega == 0.0 else "an undamped resonance"
            raise ConvergenceError(
                f"dynamic stiffness at {omega:g} rad/s: the structure is singular ({cause})"
            )

    def solve(self, force: np.ndarray) -> np.ndarray:
        """Return Z^-1 f, displacements by real or complex forces f (m, n_local) (collective)."""
        n_local = self.structure.n_local
        if self._damping is not None:
            real_rows = np.concatenate([np.real(force), -np.imag(force)], axis=1)
            solution = self._factor.solve(real_rows)
            return solution[:, :n_local] - 1j * solution[:, n_local:]
        rows = np.concatenate([force.real, force.imag]) if np.iscomplexobj(force) else force
        solution = self._factor.solve(rows)
        if np.iscomplexobj(force):
            solution = solution[: len(force)] + 1j * solution[len(force) :]
        if self._modes is None:
            return solution
        modal_force = self.structure.sum_over_ranks(force @ self._modes.shapes)
        return solution + (modal_force * self._correction) @ self._modes.shapes.T

    def compliance(self) -> np.ndarray:
        """Return the gaps' compliance R = B^T Z^-1 B: (n_pairs, n_pairs) [m/N].

        B takes contact forces to the dofs, B^T displacements to the gaps.
        """
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
    """Return the gaps' compliance at multiples of ``base_omega`` (collective).

    The load's frequency is ``subharmonic`` times ``base_omega``.

    Raises
    ------
    ConvergenceError
        The structure is in an undamped resonance, or can move as a rigid body.
    """
    load = load_coefficients(structure, harmonics, subharmonic)
    if is_small(structure) and not all_modes(structure).is_ill_conditioned:
        return ModalCompliance(structure, base_omega, load)
    return FactoredCompliance(structure, base_omega, load)


def load_coefficients(structure: Structure, harmonics: int, subharmonic: int) -> np.ndarray:
    """Return the load's Fourier coefficients in the response's period: (2H+1, n_local) [N]."""
    return resize_harmonics(stretch_period(structure.force, subharmonic), harmonics)


class ModalCompliance:
    """Compliance in closed form from all modes of a small structure.

    It is exact with any damping. With modal coordinates q, u = Phi q, the impedance is omega_j^2 -
    w^2 + i w c_j. Damping that couples modes makes it a full matrix of the same size.

    Attributes
    ----------
    shape : tuple of int
        (2H+1, n_pairs)
    matrices : (H+1, n_pairs, n_pairs) complex [m/N]
        R_k for each harmonic k, symmetric.
    linear_gap : (2H+1, n_pairs) [m]
        Gap without contact forces, less the clearance.
    gap_basis : (n_pairs, n) or None
        Orthonormal basis of the gaps that modes can make; None if these are all gaps.
    gap_without_modes : (2H+1, n_pairs) [m]
        Part of the linear gap by coordinates without mass, less the clearance.
    """

    def __init__(self, structure: Structure, base_omega: float, load: np.ndarray) -> None:
        if not is_small(structure):
            raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
        self._clearance = structure.clearance
        self._modes = all_modes(structure)
        self.gap_basis = (
            structure.compute_once(_gap_basis)
            if len(self._modes.pairs) < structure.n_pairs
            else None
        )
        self._order = np.arange(len(load) // 2 + 1.0)
        self._unit_load = to_complex(load @ self._modes.shapes)
        self.shape: tuple[int, ...] = len(load), structure.n_pairs
        self._unit_static, self._static_gap = None, np.zeros(self.shape)
        if self._modes.static_loads is not None:
            self._unit_static = load @ self._modes.static_loads
            self._static_gap = structure.apply_bt(self._unit_static)
        self._set_parameters(base_omega, 1.0, 1.0, 0.0)

    def _set_parameters(
        self, base_omega: float, load: float, damping: float, clearance: float
    ) -> None:
        self._base_omega, self._damping = base_omega, damping
        has_load = self._unit_load != 0.0
        self._receptance = self._modes.modal_receptances(
            base_omega * self._order, damping, has_load
        )
        self._modal_load = load * self._unit_load
        self._load = load
        self.gap_without_modes = load * self._static_gap
        self.gap_without_modes[0] -= self._clearance + clearance

    @cached_property
    def matrices(self) -> np.ndarray:
        return self._pair_compliance(self._receptance)

    @cached_property
    def linear_gap(self) -> np.ndarray:
        return self._gap_response(self._modal_load) + self.gap_without_modes

    def with_parameters(
        self, base_omega: float, *, load: float = 1.0, damping: float = 1.0, clearance: float = 0.0
    ) -> ModalCompliance:
        """Return the compliance at another frequency, and for a varied structure.

        ``load`` and ``damping`` are factors, ``clearance`` [m] is added, as in
        :meth:`Structure.varied`.
        """
        compliance = object.__new__(type(self))  # faster than copy
        vars(compliance).update(vars(self))
        for name in ("matrices", "linear_gap"):
            vars(compliance).pop(name, None)
        compliance._set_parameters(base_omega, load, damping, clearance)
        return compliance

    def compliance_above(self, max_harmonic: int) -> np.ndarray:
        """Return R_k for k = H+1 to ``max_harmonic``: (n, n_pairs, n_pairs) complex [m/N]."""
        order = np.arange(len(self.matrices), max_harmonic + 1)
        has_load: np.ndarray = np.zeros((len(order), len(self._modes.squares)), dtype=bool)
        receptance = self._modes.modal_receptances(
            self._base_omega * order, self._damping, has_load
        )
        return self._pair_compliance(receptance)

    def _pair_compliance(self, receptance: np.ndarray) -> np.ndarray:
        """Return the pairs' compliances (n, n_pairs, n_pairs) [m/N] from modal receptances."""
        compliance = self._modes.seen_by_pairs(receptance)
        return compliance if self._modes.residual is None else compliance + self._modes.residual

    def displacement(self, force: np.ndarray) -> np.ndarray:
        """Return the displacement under load and contact forces: (2H+1, n_local) [m]."""
        displacement = from_complex(-self._modal_response(force) @ self._modes.shapes.T)
        return (
            displacement
            if self._unit_static is None
            else displacement + self._static_displacement(force)
        )

    def displacements(self, base_omega: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the displacement under contact forces and load at many base frequencies.

        Parameters
        ----------
        base_omega : (n,) [rad/s]
        force : (2H+1, n, n_pairs) [N]
            Contact forces at each frequency.

        Returns
        -------
        (2H+1, n, n_local) [m]
        """
        modes, omega = self._modes, np.multiply.outer(self._order, base_omega)
        has_load = np.repeat(self._unit_load != 0.0, len(base_omega), axis=0)
        receptance = modes.modal_receptances(omega.ravel(), self._damping, has_load)
        drive = self._modal_load[:, None] - to_complex(force) @ modes.pairs.T
        response = modes.respond(receptance.reshape(*omega.shape, *receptance.shape[1:]), drive)
        displacement = from_complex(response @ modes.shapes.T)
        if self._unit_static is None:
            return displacement
        assert modes.static_pairs is not None
        return displacement + self._load * self._unit_static[:, None] - force @ modes.static_pairs.T

    def selected_displacement(self, rows: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return rows (m, n_local) times the displacement under contact forces: (2H+1, m)."""
        displacement = from_complex(-self._modal_response(force) @ (rows @ self._modes.shapes).T)
        return (
            displacement
            if self._unit_static is None
            else displacement + self._static_displacement(force) @ rows.T
        )

    def _static_displacement(self, force: np.ndarray) -> np.ndarray:
        """Return the displacement of coordinates without mass: (2H+1, n_local) [m]."""
        assert self._modes.static_pairs is not None and self._unit_static is not None
        return self._load * self._unit_static - force @ self._modes.static_pairs.T

    def modal_part(
        self,
        omega: tuple[float, float],
        damping: tuple[float, float],
        residual_compliance: np.ndarray | None = None,
    ) -> dict[str, Any] | None:
        """Return fields of the C struct ``structure_at_pairs``: the modes in R_k - R_inf.

        The base frequency w and the damping factor d change along a path. Each is given by its
        value at p = 0 and its rate. ``residual_compliance`` is R_inf. With h_kj = 1 / (s_j - (k
        w)^2 + i k w d c_j),

            R_k - R_inf = P^T h_k P + static_compliance,    g_lin gains P^T h_k l_k from the load.

        Returns
        -------
        dict or None
            None if damping couples modes. Otherwise ``squares``, s (n_modes,) [rad^2/s^2];
            ``modal_damping``, c (n_modes,) [1/s]; ``shapes``, P (n_modes, n_pairs); ``load``, l
            (H+1, n_modes) complex; ``static_compliance`` (n_pairs, n_pairs) or None; ``modes``,
            their number; ``omega``, ``damping``, w and d at p = 0, and ``..._rate``, their rates.
        """
        modes = self._modes
        if modes.damping.ndim == 2:
            return None
        (n_modes, n_pairs), static_compliance = modes.pairs.shape, modes.residual
        if residual_compliance is not None:
            static_compliance = (
                -residual_compliance
                if static_compliance is None
                else static_compliance - residual_compliance
            )
        return {
            "modes": n_modes,
            "omega": omega[0],
            "omega_rate": omega[1],
            "damping": damping[0],
            "damping_rate": damping[1],
            "squares": require_shape(modes.squares, n_modes),
            "modal_damping": require_shape(modes.damping, n_modes),
            "shapes": require_shape(modes.pairs, n_modes, self.shape[1]),
            "load": require_shape(
                self._load * self._unit_load, len(self._order), n_modes, kind=complex
            ),
            "static_compliance": None
            if static_compliance is None
            else require_shape(static_compliance, n_pairs, n_pairs),
        }

    def derivative(self, name: str, force: np.ndarray) -> np.ndarray:
        """Return the derivative of R lambda - g_lin by a parameter: (2H+1, n_pairs).

        The contact forces lambda are fixed. ``name`` is a parameter of :meth:`with_parameters`;
        "omega" is the base frequency w. With the modal impedance Z_k = omega_j^2 - (k w)^2 + i k w
        d c, the damping factor d and H = Z^-1,

            dH = -H dZ H,        dZ_k = (-2 k^2 w + i k d c) dw + i k w c dd.
        """
        order = self._order[:, None]
        if name == "clearance":
            derivative = np.zeros_like(force)
            derivative[0] = 1.0
            return derivative
        if name == "load":
            return -self._gap_response(self._unit_load) - self._static_gap
        if name == "damping":
            damping_force = 1j * self._modes.damping_force(self._modal_response(force))
            return -self._gap_response(self._base_omega * order * damping_force)
        return from_complex(self._modal_response_by_omega(force) @ self._modes.pairs)

    def selected_displacement_by_omega(self, rows: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the derivative of :meth:`selected_displacement` by the base frequency.

        The contact forces are fixed: (2H+1, m).
        """
        return from_complex(-self._modal_response_by_omega(force) @ (rows @ self._modes.shapes).T)

    def _modal_response_by_omega(self, force: np.ndarray) -> np.ndarray:
        """Return the derivative of modal displacements by the base frequency: (H+1, n_modes)."""
        order, response = self._order[:, None], self._modal_response(force)
        damping_force = 1j * self._damping * self._modes.damping_force(response)
        drive = order * (damping_force - 2.0 * self._base_omega * order * response)
        return -self._modes.respond(self._receptance, drive)

    def _gap_response(self, drive: np.ndarray) -> np.ndarray:
        """Return gaps (2H+1, n_pairs) [m] under complex modal forces (H+1, n_modes)."""
        return from_complex(self._modes.respond(self._receptance, drive) @ self._modes.pairs)

    def _modal_response(self, force: np.ndarray) -> np.ndarray:
        """Return modal displacements under contact forces less load: (H+1, n_modes) complex."""
        drive = to_complex(force) @ self._modes.pairs.T - self._modal_load
        return self._modes.respond(self._receptance, drive)

    def destroy(self) -> None:
        """Do nothing: no factors are held."""


class FactoredCompliance:
    """Exact compliance, by a sparse factorisation per harmonic.

    The factors are kept. Further attributes are those of :class:`ModalCompliance`.

    Attributes
    ----------
    structure : Structure
    load : (2H+1, n_local) [N]
        Fourier coefficients of the load.
    """

    gap_basis: np.ndarray | None = None

    def __init__(self, structure: Structure, base_omega: float, load: np.ndarray) -> None:
        self.structure, self.load = structure, load
        self._base_omega, orders = base_omega, range(len(load) // 2 + 1)
        self._blocks = [DynamicStiffness(structure, k * base_omega) for k in orders]
        matrices = np.array([block.compliance() for block in self._blocks], dtype=complex)
        linear_gap = structure.gap_of(self.solve_blocks(load))
        # Every rank continues independently: its numbers must not differ even by rounding.
        self.matrices, self.linear_gap = structure.comm.bcast((matrices, linear_gap))
        self.shape = self.linear_gap.shape
        if not (np.all(np.isfinite(self.matrices)) and np.all(np.isfinite(self.linear_gap))):
            self.destroy()
            raise ConvergenceError("dynamic compliance: the structure is singular")

    def compliance_above(self, max_harmonic: int) -> np.ndarray:
        """Return R_k for k = H+1 to ``max_harmonic``: (n, n_pairs, n_pairs) complex [m/N].

        The lowest modes respond dynamically, the rest of the static compliance R_0 statically.
        """
        omega, modal_damping, pair_shapes = self.structure.compute_once(_lowest_modes)
        modal_damping = self.structure.damping_factor * modal_damping
        static_rest = self.matrices[0].real - (pair_shapes.T / omega**2) @ pair_shapes
        frequency = self._base_omega * np.arange(len(self.matrices), max_harmonic + 1)[:, None]
        receptance = 1.0 / (omega**2 - frequency**2 + 1j * frequency * modal_damping)
        return static_rest + np.matmul(pair_shapes.T * receptance[:, None, :], pair_shapes)

    def displacement(self, force: np.ndarray) -> np.ndarray:
        """Return the displacement under load and contact forces: (2H+1, n_local) [m]."""
        return self.solve_blocks(self.load - self.structure.apply_b(force))

    def solve_blocks(self, force: np.ndarray) -> np.ndarray:
        """Return the displacement under forces f, both coefficients (2H+1, n_local)."""
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
    """Return a compliance with another number of harmonics.

    New harmonics have the accuracy of an error estimate. :meth:`ModalCompliance.displacement` keeps
    the number of harmonics.
    """
    new_compliance = copy(compliance)
    matrices = compliance.matrices[: harmonics + 1]
    if len(matrices) <= harmonics:
        matrices = np.concatenate([matrices, compliance.compliance_above(harmonics)])
    new_compliance.matrices = matrices
    new_compliance.linear_gap = resize_harmonics(compliance.linear_gap, harmonics)
    new_compliance.shape = new_compliance.linear_gap.shape
    return new_compliance


def _gap_basis(structure: Structure) -> np.ndarray:
    """Return an orthonormal basis of the gaps B^T Phi that modes make: (n_pairs, n)."""
    return scipy.linalg.orth(all_modes(structure).pairs.T)


def _lowest_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return at least 20 modes with damping, without modes lost in rounding.

    Returns
    -------
    omega : (n,) [rad/s]
    rate : (n,) [1/s]
        Modal damping.
    shapes : (n, n_pairs)
        Gaps B^T phi of the mass-normalised modes.
    """
    stored_modes, n_modes = damped_modes(structure), min(20, structure.n_dofs)
    modes = (
        stored_modes
        if stored_modes and len(stored_modes.omega) >= n_modes
        else solve_modes(structure, n_modes)
    )
    modal_damping = np.diag(projected_damping(structure, modes.shapes))
    is_elastic = modes.omega > 0.0  # the lowest may be lost in rounding
    return (
        modes.omega[is_elastic],
        modal_damping[is_elastic],
        structure.apply_bt(modes.shapes.T)[is_elastic],
    )
