"""Structures in the coordinates of a basis, u = T q: the same interface, few unknowns.

:class:`ReducedStructure` has mass in all of its coordinates. In :class:`MasslessStructure` only the
lowest modes Phi have mass; what they leave out is quasi-static (MacNeal, Computers & Structures 1,
1971, 581),

    u = Phi q + G (f - B lambda),        G = K^-1 - Phi Lambda^-1 Phi^T,

so its coordinates are those of the modes, and the forces c on which G acts: c = -lambda on the
pairs and the amplitudes of the load's parts. With X = [B, f] these have no mass and the stiffness
S = X^T G X. No column of G X is held: displacements are expanded by static solutions when they are
requested.
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
from fenics_crack.basics.tables import hertz_of
from fenics_crack.model.body import Body
from fenics_crack.model.factor import distributed
from fenics_crack.model.modes import NEGLIGIBLE, solve_modes
from fenics_crack.model.nodes import of_body
from fenics_crack.model.receptance import expanded, rows_at
from fenics_crack.model.structure import DampingRule, Structure

INSTEAD = "reduce with method = 'free_interface', or march by integrate_exponential"
"""Remedy where a scheme needs mass at the crack faces."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedBody(Body):
    """That of a reduced structure, of whose attributes these are."""

    whole: Structure
    basis: np.ndarray | None = None
    omega: np.ndarray
    reference: ReducedStructure | None = None
    share: float = 0.75  # static shapes of the next order leave a quarter or less


def _coordinates(
    whole: Structure, squares: np.ndarray, damping: DampingRule | np.ndarray | None,
    pairs: np.ndarray, tangents: np.ndarray | None, force: np.ndarray, compliance: np.ndarray,
) -> dict[str, Any]:  # fmt: skip
    """The body in coordinates of mass 1, and others without mass whose stiffness is given."""
    n_modes, extra = len(squares), len(compliance)
    if isinstance(damping, np.ndarray):
        damping = distributed(scipy.linalg.block_diag(damping, 0.0 * compliance), MPI.COMM_SELF)
    stiffness = sparse.block_diag([sparse.diags(squares), compliance])
    return {
        "mass": distributed(sparse.diags(np.repeat([1.0, 0.0], [n_modes, extra])), MPI.COMM_SELF),
        "stiffness": distributed(stiffness, MPI.COMM_SELF), "gap": pairs, "tangential": tangents,
        "force": force, "clearance": whole.clearance, "damping": damping, "nodes": whole.nodes,
        "pairs": whole.pairs, "omega": np.sqrt(np.maximum(squares, 0.0)), "whole": whole,
    }  # fmt: skip


class ReducedStructure(Structure):
    """A structure in the coordinates q of a basis, u = T q; the same on every rank.

    ``find_dof`` and ``values_at`` refer to the dofs of the whole structure, and so does everything
    drawn or written of its solutions.

    Attributes
    ----------
    whole : Structure
        Structure that was reduced.
    basis : (whole.n_local, n_dofs)
        T, M-orthonormal; its columns are modes of the reduced structure.
    omega : (n_dofs,) [rad/s]
        Their frequencies.
    reference : ReducedStructure or None
        The same with a larger basis, against which the reduction error is estimated.
    share : float
        Part that the reference has of what the reduction leaves out: with static shapes of the next
        order three quarters or more, with twice the modes about a half.
    """

    body: ReducedBody
    basis: np.ndarray = of_body("basis")
    omega: np.ndarray = of_body("omega")
    share: float = of_body("share")
    frequency = hertz_of()

    def __init__(
        self,
        whole: Structure,
        basis: np.ndarray,
        squares: np.ndarray,
        damping: DampingRule | np.ndarray | None,
        reference: ReducedStructure | None = None,
    ) -> None:
        pairs, force = whole.apply_bt(basis.T), whole.sum_over_ranks(whole.force @ basis)
        tangents = whole.apply_tangential(basis.T)
        parts = _coordinates(whole, squares, damping, pairs, tangents, force, np.zeros((0, 0)))
        super().__init__(ReducedBody(**parts, basis=basis, reference=reference))

    @property
    def _size_words(self) -> str:
        return f"{self.n_dofs} coordinates of {self.whole.n_dofs} dofs"

    @cached_property
    def _whole(self) -> Structure:
        """The structure that was reduced, in the same setting."""
        return self._shared(self.body.whole)

    @property
    def whole(self) -> Structure:
        """The structure that was reduced first."""
        return self._whole.whole

    @cached_property
    def reference(self) -> ReducedStructure | None:
        """The same with a larger basis, in the same setting."""
        return self.body.reference and self._shared(self.body.reference)

    def damped(self, damping: DampingRule | None) -> Self:
        """Return this structure with another damping, of the reference too."""
        given = self.body.reference
        damped = super().damped(damping)
        return damped._in(damped.setting, reference=given and given.damped(damping))

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """u = T q of coordinates (m, n_dofs): (m, whole.n_local)."""
        return self._whole.expand(displacement @ self.basis.T)

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Displacement of dofs of the whole structure from coordinates (m, n_dofs) (collective)."""
        return displacement @ self._whole.values_at(self.basis.T, dofs)

    def _changed(self, **changes: Any) -> Structure:
        """A plain structure of the coordinates, which have no positions."""
        return super()._changed(**({"nodes": None} | changes))


class MasslessInterface(ReducedStructure):
    """Modes with mass, and what they leave out quasi-static: :class:`MasslessStructure`, and
    :class:`fenics_crack.model.rotation.RunUpStructure`.

    Attributes
    ----------
    shapes : (n_dofs, n_modes)
        Phi, mass-normalised.
    static_root : (n_dofs, r) [(m/N)^(1/2)]
        Root of the flexibility beyond the modes: forces f move the coordinates by L L^T f at once.
    """

    light_lips = True
    shapes: np.ndarray
    static_root: np.ndarray

    @property
    def left(self) -> np.ndarray:
        """Displacement by forces beyond the modes, without inertia: (n_dofs, n_dofs) [m/N]."""
        return self.static_root @ self.static_root.T

    @property
    def n_modes(self) -> int:
        """Number of modes with mass."""
        return len(self.omega)

    @property
    def rate(self) -> np.ndarray:
        """Phi^T C Phi, its diagonal where it is diagonal: (n_modes,) or (n_modes, n_modes) [1/s];
        without the factor of a varied copy."""
        given = self.body.damping
        if isinstance(given, DampingRule):
            return given.of_kept(self.n_modes).rate(self.omega**2)
        if given is None:
            return np.zeros(self.n_modes)
        place = range(self.n_modes)
        return np.asarray(given.getValues(place, place))

    def known_modes(self, *, tied: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Modes with mass, for an open crack."""
        return None if tied else (self.omega, self.shapes)


@dataclass(frozen=True, eq=False, kw_only=True)
class MasslessBody(ReducedBody):
    """That of a structure with crack faces without mass."""

    root: np.ndarray


class MasslessStructure(MasslessInterface):
    """Modes with free crack faces, and what they leave out without mass; the same on every rank.

        u = Phi q + G (f - B lambda),        G = K^-1 - Phi Lambda^-1 Phi^T,

    Lambda the squares of the modes' frequencies. The coordinates are those of the modes and,
    without mass, the forces c on which G acts: u = Phi q + G X c, X = [B, B_t, f].

    Attributes
    ----------
    root : (n_dofs - n_modes, r)
        Root W of the flexibility, with W^T S W = I.
    """

    body: MasslessBody
    root: np.ndarray = of_body("root")

    def __init__(
        self,
        whole: Structure,
        squares: np.ndarray,
        damping: DampingRule | np.ndarray | None,
        pairs: np.ndarray,
        force: np.ndarray,
        compliance: np.ndarray,
        *,
        reference: MasslessStructure | None,
        share: float = 0.5,
    ) -> None:
        """Take Phi^T [B, B_t] (n_modes, n_pairs or 2 n_pairs), the load on all coordinates
        (2K+1, n_dofs), and S."""
        if isinstance(damping, DampingRule):
            damping = damping.of_kept(len(squares))
        seen = np.vstack([pairs, compliance[:, : pairs.shape[1]]])
        normal, tangents = np.split(seen, [whole.n_pairs], axis=1)
        known = None if whole.tangential is None else tangents
        parts = _coordinates(whole, squares, damping, normal, known, force, compliance)
        parts |= {"root": _inverse_root(compliance), "share": share}
        Structure.__init__(self, MasslessBody(**parts, reference=reference))

    @property
    def basis(self) -> np.ndarray:  # type: ignore[override]
        """Phi: (whole.n_local, n_modes)."""
        return solve_modes(self._whole, self.n_modes).shapes

    @property
    def shapes(self) -> np.ndarray:  # type: ignore[override]
        """Unit vectors: the first coordinates are those of the modes."""
        return np.eye(self.n_dofs, self.n_modes)

    @property
    def flexibility(self) -> np.ndarray:
        """Inverse of S, the stiffness of the coordinates without mass: (n_dofs - n_modes,) * 2; its
        pseudoinverse where forces depend on each other."""
        return self.root @ self.root.T

    @property
    def static_root(self) -> np.ndarray:  # type: ignore[override]
        """W on the other coordinates."""
        return np.vstack([np.zeros((self.n_modes, self.root.shape[1])), self.root])

    def known_modes(self, *, tied: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """omega, and the unit vectors of the modes' coordinates; with a bonded crack those of

            (Lambda + b R_inf^-1 b^T) q = w^2 q,      b = Phi^T B,      lambda = R_inf^-1 b^T q:

        ties are springs of the compliance that the modes leave out, and hold b^T q where it has
        none. Pairs that depend on each other, by their static compliance, are one tie."""
        if not tied:
            return super().known_modes(tied=False)
        pairs, residual = self.gap[: self.n_modes].toarray(), self.residual
        static = pairs / np.where(self.omega > 0.0, self.omega, self.omega.max() or 1.0)[:, None]
        ties = _inverse_root(static.T @ static + residual)
        shares, turned = np.linalg.eigh(ties.T @ residual @ ties)
        ties, soft = ties @ turned, shares > NEGLIGIBLE
        held = pairs @ ties[:, ~soft]
        free = scipy.linalg.null_space(held.T) if held.size else np.eye(self.n_modes)
        forces = (ties[:, soft] / shares[soft]) @ (pairs @ ties[:, soft]).T
        squares, shapes = np.linalg.eigh(free.T @ (np.diag(self.omega**2) + pairs @ forces) @ free)
        modal = free @ shapes
        static = np.zeros((self.n_dofs - self.n_modes, modal.shape[1]))
        static[: self.n_pairs] = -forces @ modal
        return np.sqrt(np.maximum(squares, 0.0)), np.vstack([modal, static])

    @property
    def compliance(self) -> np.ndarray:
        """S: (n_dofs - n_modes,) * 2."""
        place = range(self.n_modes, self.n_dofs)
        return np.asarray(self.stiffness.getValues(place, place))

    @property
    def residual(self) -> np.ndarray:
        """R_inf = B^T G B: (n_pairs, n_pairs) [m/N]."""
        pairs = self.gap[self.n_modes :].T @ self.root
        return np.asarray(pairs @ pairs.T)

    @property
    def _size_words(self) -> str:
        return f"{self.n_modes} modes of {self.whole.n_dofs} dofs, crack faces without mass"

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """u = Phi q + G X c of coordinates (m, n_dofs): (m, whole.n_local) (collective)."""
        return self._whole.expand(self._one_step(displacement))

    def _one_step(self, displacement: np.ndarray) -> np.ndarray:
        """The same in the coordinates of the structure that was reduced."""
        modal, static = np.split(displacement, [self.n_modes], axis=1)
        return modal @ self.basis.T + expanded(self._whole, self.basis, self.omega**2, static)

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Displacement of dofs of the whole structure from coordinates (m, n_dofs) (collective)."""
        if self._whole.whole is not self._whole:  # itself in few coordinates
            return self._whole.values_at(self._one_step(displacement), dofs)
        wanted = self._whole.check_dofs(dofs)
        return displacement @ np.hstack(rows_at(self._whole, self.n_modes, wanted)).T


def check_mass(structure: Structure, instead: str) -> None:
    """Raise InputError, which says what to do instead, if the crack faces have no mass."""
    if structure.light_lips:
        raise InputError("structure", repr(structure), f"one with mass at its faces; {instead}")


def massless(structure: Structure | None) -> MasslessStructure | None:
    """The structure itself if its crack faces have no mass, else None."""
    return structure if isinstance(structure, MasslessStructure) else None


def _inverse_root(compliance: np.ndarray) -> np.ndarray:
    """Return a root W of the pseudoinverse W W^T of a compliance C, with W^T C W = I.

    Units differ from load to pair, so C is scaled to a unit diagonal first.
    """
    size = np.sqrt(np.maximum(np.diag(compliance), 0.0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    values, vectors = np.linalg.eigh(scale[:, None] * compliance * scale)
    is_kept = values > NEGLIGIBLE * values.max(initial=0.0)
    return np.asarray(scale[:, None] * vectors[:, is_kept] / np.sqrt(values[is_kept]))
