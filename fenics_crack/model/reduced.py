"""Structures in few coordinates q of a basis T of displacements, u = T q.

:class:`ReducedStructure` has mass in all of its coordinates. In :class:`MasslessStructure` only the
lowest modes Phi have mass. The truncated part is quasi-static:

    u = Phi q + G (f - B lambda),        G = K^-1 - Phi Lambda^-1 Phi^T

Lambda holds the squares of the modes' frequencies. The coordinates are those of the modes, and
massless amplitudes c of the forces on which G acts. On the pairs c = -lambda; for the load's parts
they are its amplitudes. With X = [B, f],

    u = Phi q + G X c,        S = X^T G X

S is the stiffness of the massless coordinates. No column of G X is held: static solutions expand
displacements on request.

References
----------
MacNeal, Computers & Structures 1, 1971, 581.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import hertz_property
from fenics_crack.model.body import Body
from fenics_crack.model.factor import make_matrix_from_local_rows
from fenics_crack.model.modes import STIFFNESS_SOLUTION_ROUNDING, solve_modes
from fenics_crack.model.nodes import body_property
from fenics_crack.model.receptance import (
    expand_residual_response,
    modal_and_static_displacement_rows,
)
from fenics_crack.model.structure import DampingRule, Structure

REMEDY_FOR_MASSLESS_CRACK_FACES = (
    "reduce it with method = 'free_interface', or use integrate_exponential"
)
"""Remedy for a scheme that needs mass at the crack faces."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedBody(Body):
    """Constant data of a reduced structure (:class:`Body`).

    ``source`` is the structure that was reduced. ``basis``, ``omega`` and ``reference`` are
    explained in :class:`ReducedStructure`. There, ``error_share_removed_by_larger_reduction`` is
    called ``error_share_removed_by_reference``.
    """

    source: Structure
    basis: np.ndarray | None = None
    omega: np.ndarray
    reference: ReducedStructure | None = None
    # The reference with the next static shapes lacks a quarter or less.
    error_share_removed_by_larger_reduction: float = 0.75


def _make_body_fields(
    source: Structure, squared_frequencies: np.ndarray, damping: DampingRule | np.ndarray | None,
    gap: np.ndarray, tangential_gap: np.ndarray | None, force: np.ndarray,
    massless_stiffness: np.ndarray,
) -> dict[str, Any]:  # fmt: skip
    """Return the fields of a :class:`ReducedBody` by name, without basis and reference.

    The coordinates are the amplitudes of modes with mass 1, then n_massless coordinates without
    mass.

    Parameters
    ----------
    source : Structure
        Structure that is reduced; clearance, nodes and pairs are its own.
    squared_frequencies : (n_modes,) [rad^2/s^2]
        Squares of the modes' frequencies, which are their stiffnesses.
    damping : DampingRule, (n_modes, n_modes) or None
        Damping of the modes; the massless coordinates are undamped.
    gap, tangential_gap : (n_modes + n_massless, n_gaps)
        Normal and tangential gaps of the pairs by unit coordinates; no tangential gaps: None.
    force : (2K+1, n_modes + n_massless)
        Load on the coordinates.
    massless_stiffness : (n_massless, n_massless)
        Stiffness of the coordinates without mass.
    """
    n_modes, n_massless = len(squared_frequencies), len(massless_stiffness)
    if isinstance(damping, np.ndarray):
        damping = make_matrix_from_local_rows(
            scipy.linalg.block_diag(damping, 0.0 * massless_stiffness), MPI.COMM_SELF
        )
    mass_diagonal_with_massless_zeros = sparse.diags(np.repeat([1.0, 0.0], [n_modes, n_massless]))
    stiffness_blocks = sparse.block_diag([sparse.diags(squared_frequencies), massless_stiffness])
    return {
        "mass": make_matrix_from_local_rows(mass_diagonal_with_massless_zeros, MPI.COMM_SELF),
        "stiffness": make_matrix_from_local_rows(stiffness_blocks, MPI.COMM_SELF),
        "gap": gap, "tangential": tangential_gap, "force": force, "clearance": source.clearance,
        "damping": damping, "nodes": source.nodes, "pairs": source.pairs,
        "omega": np.sqrt(np.maximum(squared_frequencies, 0.0)), "source": source,
    }  # fmt: skip


@keep_old_attribute_names(share="error_share_removed_by_reference")
class ReducedStructure(Structure):
    """A structure in few coordinates q: displacements are u = T q with a basis T.

    Every rank has all coordinates. ``find_dof`` and ``values_at`` refer to the dofs of the whole
    structure, and so do drawings and files of its solutions.

    Attributes
    ----------
    whole : Structure
        Structure that was reduced.
    basis : (whole.n_local, n_dofs)
        T, with T^T M T = I and the mass M. The columns are modes of the reduced structure.
    omega : (n_dofs,) [rad/s]
        Frequencies of these modes.
    reference : ReducedStructure or None
        Reduction to a larger basis, to estimate the reduction error.
    error_share_removed_by_reference : float
        Fraction of the truncation error that the reference is assumed to remove. The difference
        between both reductions is divided by this fraction to estimate the error. The fraction is
        0.75 if the reference has further static shapes, and at most 0.5 if it has more modes. If
        the reference has all modes, the fraction is at most 1.
    """

    body: ReducedBody
    basis: np.ndarray = body_property("basis")
    omega: np.ndarray = body_property("omega")
    error_share_removed_by_reference: float = body_property(
        "error_share_removed_by_larger_reduction"
    )
    frequency = hertz_property()

    def __init__(
        self,
        source: Structure,
        basis: np.ndarray,
        squares: np.ndarray,
        damping: DampingRule | np.ndarray | None,
        reference: ReducedStructure | None = None,
    ) -> None:
        gap, force = source.apply_bt(basis.T), source.sum_over_ranks(source.force @ basis)
        tangential_gap = source.apply_tangential(basis.T)
        field_by_name = _make_body_fields(
            source, squares, damping, gap, tangential_gap, force, np.zeros((0, 0))
        )
        super().__init__(ReducedBody(**field_by_name, basis=basis, reference=reference))

    @property
    def _size_description(self) -> str:
        return f"{self.n_dofs} coordinates of {self.whole.n_dofs} dofs"

    @cached_property
    def _source_structure(self) -> Structure:
        """Structure that was reduced, under the same load, clearance and damping factor."""
        return self._apply_setting(self.body.source)

    @property
    def whole(self) -> Structure:
        """Structure with all dofs, even if it was reduced repeatedly."""
        return self._source_structure.whole

    @cached_property
    def reference(self) -> ReducedStructure | None:
        """Reduction to a larger basis, under the same load, clearance and damping factor.

        None if the structure was reduced without a reference.
        """
        return self.body.reference and self._apply_setting(self.body.reference)

    def damped(self, damping: DampingRule | None) -> Self:
        """Return this structure with another damping, also in the reference."""
        larger_reduction = self.body.reference
        damped_structure = super().damped(damping)
        return damped_structure._in_setting(
            damped_structure.load_damping_clearance_changes,
            reference=larger_reduction and larger_reduction.damped(damping),
        )

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Return displacements (m, whole.n_local) of the whole structure.

        The displacements are u = T q, with the basis T and the coordinates q, ``displacement`` (m,
        n_dofs).
        """
        return self._source_structure.expand(displacement @ self.basis.T)

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Return displacements at dofs of the whole structure: (m, len(dofs)) (collective).

        Parameters
        ----------
        displacement : (m, n_dofs)
            Coordinates q of the basis.
        dofs : sequence of int or None
            Numbers of dofs; None stands for the watched dof.
        """
        return displacement @ self._source_structure.values_at(self.basis.T, dofs)

    def _plain_structure_with_changes(self, **changes: Any) -> Structure:
        """Return a plain :class:`Structure` whose dofs are the coordinates q.

        ``changes`` are new values for fields of the body, by name. Node positions are dropped: no
        node belongs to a coordinate.
        """
        return super()._plain_structure_with_changes(**({"nodes": None} | changes))


@keep_old_attribute_names(light_lips="has_massless_crack_faces")
class QuasiStaticReduction(ReducedStructure):
    """Reduced structure whose modes alone have mass; the truncated part is quasi-static.

    Base of :class:`MasslessStructure` and :class:`fenics_crack.model.rotation.RunUpStructure`.

    Attributes
    ----------
    shapes : (n_dofs, n_modes)
        Mode shapes Phi in the coordinates, mass-normalised.
    truncated_flexibility_root : (n_dofs, r) [(m/N)^(1/2)]
        Root L of the truncated part's flexibility: forces f move the coordinates by L L^T f without
        inertia.
    """

    has_massless_crack_faces = True
    shapes: np.ndarray
    truncated_flexibility_root: np.ndarray

    @property
    def residual_flexibility(self) -> np.ndarray:
        """Static flexibility of the truncated part: (n_dofs, n_dofs) [m/N].

        An entry is the displacement of a coordinate by a unit force on another one, less the part
        of the modes.
        """
        return self.truncated_flexibility_root @ self.truncated_flexibility_root.T

    @property
    def n_modes(self) -> int:
        """Number of modes with mass."""
        return len(self.omega)

    @property
    def modal_damping(self) -> np.ndarray:
        """Modal damping matrix Phi^T C Phi [1/s], before the damping factor.

        Modal and Rayleigh damping, or none, give the diagonal (n_modes,); a damping matrix C gives
        (n_modes, n_modes).
        """
        damping = self.body.damping
        if isinstance(damping, DampingRule):
            return damping.rule_for_n_modes(self.n_modes).rate(self.omega**2)
        if damping is None:
            return np.zeros(self.n_modes)
        mode_range = range(self.n_modes)
        return np.asarray(damping.getValues(mode_range, mode_range))

    def known_omega_and_shapes(self, *, is_bonded: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the modes with an open crack; None for a bonded crack.

        A bonded crack would need a solver.

        Parameters
        ----------
        is_bonded : bool
            True for a bonded crack, False for an open crack.

        Returns
        -------
        omega : (n_modes,) [rad/s]
            Frequencies.
        shapes : (n_dofs, n_modes)
            Shapes in the coordinates.
        """
        return None if is_bonded else (self.omega, self.shapes)


@dataclass(frozen=True, eq=False, kw_only=True)
class MasslessBody(ReducedBody):
    """Constant data of a :class:`MasslessStructure`.

    ``inverse_compliance_root`` is the attribute ``root`` of that class.
    """

    inverse_compliance_root: np.ndarray


@keep_old_attribute_names(
    compliance="truncated_static_compliance", rate="modal_damping", residual="residual_compliance"
)
class MasslessStructure(QuasiStaticReduction):
    """Structure reduced to modes with mass and crack faces without mass.

        u = Phi q + G (f - B lambda),        G = K^-1 - Phi Lambda^-1 Phi^T

    Phi are the lowest modes with an open crack, and Lambda holds the squares of their frequencies.
    G is the static flexibility of all other modes, under the load f and the contact forces lambda.
    K is the stiffness. The coordinates are the amplitudes q of the modes and, without mass, the
    amplitudes c of unit forces X = [B, B_t, f] on normal pairs, tangential pairs and load: u = Phi
    q + G X c.

    Attributes
    ----------
    root : (n_dofs - n_modes, r)
        Root W of the pseudoinverse W W^T of the compliance S = X^T G X, with W^T S W = I.
    """

    body: MasslessBody
    root: np.ndarray = body_property("inverse_compliance_root")

    def __init__(
        self,
        source: Structure,
        squares: np.ndarray,
        damping: DampingRule | np.ndarray | None,
        modal_pairs: np.ndarray,
        force: np.ndarray,
        compliance: np.ndarray,
        *,
        reference: MasslessStructure | None,
        error_share_removed_by_reference: float = 0.5,
    ) -> None:
        """Make the structure from modes Phi and the static compliance of all other modes.

        X are unit forces on the pairs, then on the load's nonzero parts. G is the static
        flexibility of all other modes. B and B_t are the matrices of normal and tangential gaps.

        Parameters
        ----------
        source : Structure
            Structure to reduce.
        squares : (n_modes,) [rad^2/s^2]
            Lambda, the squares of the modes' frequencies.
        damping : DampingRule, (n_modes, n_modes) [1/s] or None
            Modal or Rayleigh damping, or the damping matrix of the modes.
        modal_pairs : (n_modes, n_pairs or more)
            Phi^T [B, B_t], the modes' normal and tangential gaps.
        force : (2K+1, n_dofs)
            Load on all coordinates: amplitudes of the modes, then of the unit forces X.
        compliance : (n_sources, n_sources)
            S = X^T G X, the static compliance of pairs and load without the modes.
        reference : MasslessStructure or None
            Reduction to more modes, to estimate the truncation error.
        error_share_removed_by_reference : float
            Fraction of the truncation error removed by the reference (:class:`ReducedStructure`).
        """
        if isinstance(damping, DampingRule):
            damping = damping.rule_for_n_modes(len(squares))
        pair_columns = np.vstack([modal_pairs, compliance[:, : modal_pairs.shape[1]]])
        gap, tangential_columns = np.split(pair_columns, [source.n_pairs], axis=1)
        tangential_gap = None if source.tangential is None else tangential_columns
        field_by_name = _make_body_fields(
            source, squares, damping, gap, tangential_gap, force, compliance
        )
        field_by_name["inverse_compliance_root"] = _root_of_pseudoinverse(compliance)
        field_by_name["error_share_removed_by_larger_reduction"] = error_share_removed_by_reference
        Structure.__init__(self, MasslessBody(**field_by_name, reference=reference))

    @property
    def basis(self) -> np.ndarray:  # type: ignore[override]
        """Mode shapes Phi on the dofs: (whole.n_local, n_modes)."""
        return solve_modes(self._source_structure, self.n_modes).shapes

    @property
    def shapes(self) -> np.ndarray:  # type: ignore[override]
        """Mode shapes in the coordinates: unit vectors, since the modes come first."""
        return np.eye(self.n_dofs, self.n_modes)

    @property
    def flexibility(self) -> np.ndarray:
        """Inverse of the static compliance S of pairs and load without the modes.

        The matrix has n_dofs - n_modes rows and columns. The massless coordinates are amplitudes of
        unit forces. Their stiffness is S, so the result is their flexibility. If S is singular, the
        result is the pseudoinverse.
        """
        return self.root @ self.root.T

    @property
    def truncated_flexibility_root(self) -> np.ndarray:  # type: ignore[override]
        """Root L of the truncated modes' flexibility L L^T in the coordinates: (n_dofs, r).

        L is zero for the modes, and ``root`` for the massless coordinates.
        """
        return np.vstack([np.zeros((self.n_modes, self.root.shape[1])), self.root])

    def known_omega_and_shapes(self, *, is_bonded: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Return frequencies and shapes of all modes, with an open or a bonded crack.

        With an open crack the shapes are unit vectors. The bonded modes have amplitudes q of the
        open modes Phi, bond forces lambda and frequencies w:

            (Lambda + b R_inf^-1 b^T) q = w^2 q,      b = Phi^T B,      lambda = R_inf^-1 b^T q

        B is the gap matrix, so b has the gaps of the open modes. Lambda holds the squares of the
        open modes' frequencies. A bonded pair acts as a spring with the residual flexibility R_inf.
        A pair without flexibility holds b^T q = 0. Linearly dependent pairs count as a single bond.

        Parameters
        ----------
        is_bonded : bool
            True for a bonded crack, False for an open crack.

        Returns
        -------
        omega : (m,) [rad/s]
            Frequencies.
        shapes : (n_dofs, m)
            Shapes in the coordinates: modal, then massless amplitudes.
        """
        if not is_bonded:
            return super().known_omega_and_shapes(is_bonded=False)
        gaps_by_mode = self.gap[: self.n_modes].toarray()
        residual_compliance = self.residual_compliance
        scaled_gaps_by_mode = (
            gaps_by_mode / np.where(self.omega > 0.0, self.omega, self.omega.max() or 1.0)[:, None]
        )
        ties = _root_of_pseudoinverse(
            scaled_gaps_by_mode.T @ scaled_gaps_by_mode + residual_compliance
        )
        tie_flexibilities, tie_eigenvectors = np.linalg.eigh(ties.T @ residual_compliance @ ties)
        ties, is_soft_tie = ties @ tie_eigenvectors, tie_flexibilities > STIFFNESS_SOLUTION_ROUNDING
        rigid_tie_gaps_by_mode = gaps_by_mode @ ties[:, ~is_soft_tie]
        null_space_of_rigid_ties = (
            scipy.linalg.null_space(rigid_tie_gaps_by_mode.T)
            if rigid_tie_gaps_by_mode.size
            else np.eye(self.n_modes)
        )
        bond_forces_by_open_mode = (ties[:, is_soft_tie] / tie_flexibilities[is_soft_tie]) @ (
            gaps_by_mode @ ties[:, is_soft_tie]
        ).T
        squares, eigenvectors = np.linalg.eigh(
            null_space_of_rigid_ties.T
            @ (np.diag(self.omega**2) + gaps_by_mode @ bond_forces_by_open_mode)
            @ null_space_of_rigid_ties
        )
        bonded_shapes_in_open_modes = null_space_of_rigid_ties @ eigenvectors
        massless_amplitudes = np.zeros(
            (self.n_dofs - self.n_modes, bonded_shapes_in_open_modes.shape[1])
        )
        massless_amplitudes[: self.n_pairs] = (
            -bond_forces_by_open_mode @ bonded_shapes_in_open_modes
        )
        return np.sqrt(np.maximum(squares, 0.0)), np.vstack(
            [bonded_shapes_in_open_modes, massless_amplitudes]
        )

    @property
    def truncated_static_compliance(self) -> np.ndarray:
        """Static compliance S = X^T G X of pairs and load, without the modes.

        X are unit forces on pairs and load, and G is the static flexibility of the truncated modes.
        S has n_dofs - n_modes rows and columns.
        """
        massless_range = range(self.n_modes, self.n_dofs)
        return np.asarray(self.stiffness.getValues(massless_range, massless_range))

    @property
    def residual_compliance(self) -> np.ndarray:
        """Residual flexibility R_inf = B^T G B of the pairs: (n_pairs, n_pairs) [m/N].

        B is the gap matrix, and G is the static flexibility of the truncated modes.
        """
        pair_factor = self.gap[self.n_modes :].T @ self.root
        return np.asarray(pair_factor @ pair_factor.T)

    @property
    def _size_description(self) -> str:
        return f"{self.n_modes} modes of {self.whole.n_dofs} dofs, crack faces without mass"

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Return displacements u = Phi q + G X c from the coordinates (collective).

        Parameters
        ----------
        displacement : (m, n_dofs)
            Amplitudes q of the modes Phi, then amplitudes c of the unit forces X on pairs and load.
            G is the static flexibility of the truncated modes.

        Returns
        -------
        (m, whole.n_local) [m]
        """
        return self._source_structure.expand(self._expand_to_source(displacement))

    def _expand_to_source(self, displacement: np.ndarray) -> np.ndarray:
        """Return displacements of the structure that was reduced (collective).

        ``displacement`` (m, n_dofs) has modal, then massless amplitudes in each row. The result is
        (m, source.n_local) [m], with the structure's dofs on this rank.
        """
        modal_amplitudes, massless_amplitudes = np.split(displacement, [self.n_modes], axis=1)
        return modal_amplitudes @ self.basis.T + expand_residual_response(
            self._source_structure, self.basis, self.omega**2, massless_amplitudes
        )

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Return displacements at dofs of the whole structure (collective).

        Parameters
        ----------
        displacement : (m, n_dofs)
            Amplitudes of the modes, then amplitudes of the unit forces on pairs and load.
        dofs : sequence of int or None
            Numbers of n dofs; None stands for the watched dof.

        Returns
        -------
        (m, n) [m]
            Displacements, a row for each row of ``displacement``.
        """
        if self._source_structure.whole is not self._source_structure:  # it is reduced itself
            return self._source_structure.values_at(self._expand_to_source(displacement), dofs)
        checked_dofs = self._source_structure.as_dof_numbers(dofs)
        return (
            displacement
            @ np.hstack(
                modal_and_static_displacement_rows(
                    self._source_structure, self.n_modes, checked_dofs
                )
            ).T
        )


def check_faces_have_mass(structure: Structure, remedy: str) -> None:
    """Raise InputError if the structure's crack faces have no mass.

    Used by methods in which crack faces need mass. ``remedy`` is the advice in the message.
    """
    if structure.has_massless_crack_faces:
        raise InputError(
            "structure", repr(structure), f"a structure whose crack faces have mass; {remedy}"
        )


def as_massless_structure_or_none(structure: Structure | None) -> MasslessStructure | None:
    """Return the structure itself if it is a :class:`MasslessStructure`, else None."""
    return structure if isinstance(structure, MasslessStructure) else None


def _root_of_pseudoinverse(compliance: np.ndarray) -> np.ndarray:
    """Return a root W of the pseudoinverse W W^T of a compliance C.

    The root has W^T C W = I. Loads and pairs have different units, so C is scaled to a unit
    diagonal first. Eigenvalues up to 1e-12 of the largest count as zero.
    """
    roots_of_compliance_diagonal = np.sqrt(np.maximum(np.diag(compliance), 0.0))
    unit_diagonal_scale = np.divide(
        1.0,
        roots_of_compliance_diagonal,
        out=np.zeros_like(roots_of_compliance_diagonal),
        where=roots_of_compliance_diagonal > 0.0,
    )
    eigenvalues, eigenvectors = np.linalg.eigh(
        unit_diagonal_scale[:, None] * compliance * unit_diagonal_scale
    )
    is_kept = eigenvalues > STIFFNESS_SOLUTION_ROUNDING * eigenvalues.max(initial=0.0)
    return np.asarray(
        unit_diagonal_scale[:, None] * eigenvectors[:, is_kept] / np.sqrt(eigenvalues[is_kept])
    )
