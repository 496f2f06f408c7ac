"""All modes of a small structure, computed once."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import kernel
from fenics_crack.model.factor import local_rows
from fenics_crack.model.modes import AS_ZERO, NEGLIGIBLE, damped_modes, damping_in, solve_modes
from fenics_crack.model.reduced import MasslessInterface
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import EPSILON

SMALL = 600
"""Maximum dofs of a structure that is decomposed into all of its modes, and maximum unknowns with
which better equations are tried: dense matrices of this size take a part of a second."""
CACHE_SIZE = 2**16
"""Modal coordinates that are computed at a time, as a cache holds them."""


def is_small(structure: Structure) -> bool:
    """Return True if a structure can be decomposed into all of its modes: few dofs on one rank, or
    known by its modes."""
    few = structure.comm.size == 1 and structure.n_dofs <= SMALL
    return few or structure.light_lips


@dataclass(frozen=True)
class AllModes:
    """All modes of a small structure, its pairs and its damping in modal coordinates.

    Attributes
    ----------
    squares : (n,) [rad^2/s^2]
        omega_j^2, ascending.
    shapes : (n, n)
        Phi, mass-normalised.
    damping : (n,) or (n, n) [1/s]
        Phi^T C Phi: its diagonal where it is diagonal.
    pairs : (n, n_pairs)
        Phi^T B.
    unconstrained : bool
        True if the structure can move as a rigid body.
    residual : (n_pairs, n_pairs) [m/N] or None
        R_inf, the compliance of what has no mass; None where all has.
    """

    squares: np.ndarray
    shapes: np.ndarray
    damping: np.ndarray
    pairs: np.ndarray
    unconstrained: bool
    residual: np.ndarray | None = None
    static_pairs: np.ndarray | None = None
    """(n_dofs, n_pairs): displacement of the coordinates without mass by unit forces on pairs."""
    static_loads: np.ndarray | None = None
    """(n_dofs, n_dofs): displacement of the coordinates without mass by forces on them."""
    rows: np.ndarray | None = None
    """Phi^T M where it is at hand."""

    @property
    def ill_conditioned(self) -> bool:
        """Return True if rounding relative to the highest modes may spoil the lowest ones."""
        return not self.unconstrained and bool(self.squares[0] < NEGLIGIBLE * self.squares[-1])

    def receptance(
        self, omega: np.ndarray, factor: float = 1.0, loaded: np.ndarray | None = None
    ) -> np.ndarray:
        """Inverse impedance at frequencies (m,): (m, n), or where damping couples modes (m, n, n).

        ``factor`` multiplies the damping. Where ``loaded`` (m, n) states that the load does not
        drive a mode, an undamped resonance of it is moved away a little: contact keeps
        its motion finite.

        Raises
        ------
        ConvergenceError
            The structure is singular at a frequency.
        """
        square = (omega * omega)[:, None]
        stiffness = self.squares - square
        singular = self.unconstrained & (omega == 0.0)
        if self.damping.ndim == 1:
            impedance = stiffness + (1j * factor * omega)[:, None] * self.damping
            size = np.abs(self.squares) + square
            if loaded is not None:
                nudge = math.sqrt(EPSILON) * size
                moved = (np.abs(impedance) <= nudge) & ~loaded & (square > 0.0)
                impedance = np.where(moved, nudge, impedance)
            singular |= (np.abs(impedance) <= kernel.SINGULAR * size).any(axis=1)
        else:
            impedance = 1j * factor * omega[:, None, None] * self.damping
            place = np.arange(len(self.squares))
            impedance[:, place, place] += stiffness
            # Only an undamped mode can make this singular.
            free = np.abs(self.damping).sum(axis=1) == 0.0
            singular |= np.any(stiffness[:, free] == 0.0, axis=1)
            if not singular.any():
                try:
                    return np.linalg.inv(impedance)
                except np.linalg.LinAlgError:  # to rounding
                    singular[np.argmax(np.linalg.cond(impedance))] = True
        if singular.any():
            at = omega[np.argmax(singular)]
            cause = "it can move as a rigid body" if at == 0.0 else "an undamped resonance"
            raise ConvergenceError(
                f"dynamic compliance at {at:g} rad/s: the structure is singular ({cause})"
            )
        return 1.0 / impedance

    def static_part(self, above: float = np.inf) -> np.ndarray:
        """Residual flexibility of the pairs, with that of the modes beyond a frequency [rad/s],
        which are then quasi-static: (n_pairs, n_pairs) [m/N]."""
        fast = self._fast(above)
        found = (self.pairs[fast].T / self.squares[fast]) @ self.pairs[fast]
        return found if self.residual is None else found + self.residual

    def _fast(self, above: float) -> np.ndarray:
        """Modes beyond a frequency, but not the lowest one: (n_modes,) bool."""
        return np.asarray(self.squares > max(above**2, float(self.squares[0])))

    def moved_at_once(self, above: float) -> np.ndarray:
        """Displacement of it by unit forces on the pairs: (n_dofs, n_pairs) [m/N]."""
        fast = self._fast(above)
        found: np.ndarray = (self.shapes[:, fast] / self.squares[fast]) @ self.pairs[fast]
        return found if self.static_pairs is None else found + self.static_pairs

    def below(self, above: float | None) -> AllModes:
        """The same with the modes beyond a frequency [rad/s], if it is given, among what has no
        mass."""
        if above is None:
            return self
        slow = ~self._fast(above)
        if np.all(slow):
            return self
        squares, shapes = self.squares[~slow], self.shapes[:, ~slow]
        loads = (shapes / squares) @ shapes.T
        if self.static_loads is not None:
            loads = loads + self.static_loads
        rate = self.damping[slow] if self.damping.ndim == 1 else self.damping[np.ix_(slow, slow)]
        return AllModes(
            self.squares[slow],
            self.shapes[:, slow],
            rate,
            self.pairs[slow],
            self.unconstrained,
            self.static_part(above),
            self.moved_at_once(above),
            loads,
            self.inverse[slow],
        )

    @cached_property
    def inverse(self) -> np.ndarray:
        """Modal coordinates of displacements: (n_modes, n_dofs)."""
        if self.rows is not None:
            return self.rows
        return np.linalg.inv(self.shapes)

    def damped(self, modal: np.ndarray) -> np.ndarray:
        """Phi^T C Phi q of modal coordinates (..., n)."""
        return modal * self.damping if self.damping.ndim == 1 else modal @ self.damping.T

    def respond(self, receptance: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """Modal response to modal forces (..., n)."""
        if self.damping.ndim == 1:
            return receptance * drive
        return np.matmul(receptance, drive[..., None])[..., 0]

    def seen_by_pairs(self, receptance: np.ndarray) -> np.ndarray:
        """B^T Phi H Phi^T B: (..., n_pairs, n_pairs)."""
        if self.damping.ndim == 1:
            return np.matmul(self.pairs.T * receptance[..., None, :], self.pairs)
        return self.pairs.T @ receptance @ self.pairs

    def transition(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """E = exp(A h) of a step h [s], z' = A z being the free motion of z = (q, q'), and the
        response to unit forces on the pairs that are held over the step, (2n, n_pairs).

        Where damping leaves the modes uncoupled E is given by the diagonals of its blocks, (4, n),
        else whole, (2n, 2n).
        """
        count, pairs = self.pairs.shape
        if self.damping.ndim == 1:
            # Mode by mode: exp of h [A, b; 0, 0], scaled to balance q and q'.
            scale = np.maximum(np.sqrt(np.abs(self.squares)), 1.0 / h)
            system = np.zeros((count, 3, 3))
            system[:, 0, 1] = scale
            system[:, 1, 0], system[:, 1, 1] = -self.squares / scale, -self.damping
            system[:, 1, 2] = 1.0
            found = scipy.linalg.expm(h * system)
            blocks = found[:, 0, 0], found[:, 0, 1] / scale, found[:, 1, 0] * scale, found[:, 1, 1]
            shape = (found[:, 0, 2] / scale)[:, None] * self.pairs
            return np.array(blocks), np.vstack([shape, found[:, 1, 2][:, None] * self.pairs])
        whole = np.zeros((2 * count + pairs,) * 2)
        whole[:count, count : 2 * count] = np.eye(count)
        whole[count : 2 * count, :count] = -np.diag(self.squares)
        whole[count : 2 * count, count : 2 * count] = -self.damping
        whole[count : 2 * count, 2 * count :] = self.pairs
        found = scipy.linalg.expm(h * whole)[: 2 * count]
        return np.ascontiguousarray(found[:, : 2 * count]), found[:, 2 * count :]

    def steady_response(self, omega: float, force: np.ndarray) -> np.ndarray:
        """Complex amplitudes of the modes under a load (n,); modes without load are at rest.

        Raises
        ------
        ConvergenceError
            The load is on an undamped resonance, or moves the structure as a rigid body.
        """
        if self.damping.ndim == 2:
            impedance = np.diag(self.squares - omega**2) + 1j * omega * self.damping
            found = np.linalg.lstsq(impedance, force, rcond=None)[0]
            singular = np.abs(impedance @ found - force).max() > 1e-9 * np.abs(force).max()
        else:
            impedance = self.squares - omega**2 + 1j * omega * self.damping
            size = np.abs(self.squares)
            free = np.abs(impedance) <= 1e-15 * (size + omega**2)
            if omega == 0.0 and self.unconstrained:
                free |= size <= 1e-12 * size[-1]
            singular = bool(np.any(force[free]))
            found = np.divide(force, impedance, out=np.zeros_like(force), where=~free)
        if singular:
            raise ConvergenceError(
                f"exponential: at {omega:g} rad/s the load is on an undamped resonance, or moves "
                "the structure as a rigid body"
            )
        return found


def all_modes(structure: Structure) -> AllModes:
    """All modes of a small structure, computed once for it and its varied copies."""
    modes, factor = structure.once(_all_modes), structure.damping_factor
    return modes if factor == 1.0 else replace(modes, damping=factor * modes.damping)


def _all_modes(structure: Structure) -> AllModes:
    if isinstance(structure, MasslessInterface):
        return _of_interface(structure)
    known = damped_modes(structure)
    if known is not None and len(known.omega) == structure.n_dofs:
        squares, shapes, damping = known.omega**2, known.shapes, known.rate
    else:
        matrices = (local_rows(one).toarray() for one in (structure.stiffness, structure.mass))
        squares, shapes = scipy.linalg.eigh(*matrices)
        damping = damping_in(structure, shapes, squares)
    # Beside the largest it may be rounding of LAPACK's; one mode of K itself decides.
    doubtful = squares[0] <= AS_ZERO * squares[-1]
    unconstrained = bool(doubtful and solve_modes(structure, 1).omega[0] == 0.0)
    return AllModes(squares, shapes, damping, (structure.gap.T @ shapes).T, unconstrained)


def _of_interface(structure: MasslessInterface) -> AllModes:
    gap, shapes, squares = structure.gap.toarray(), structure.shapes, structure.omega**2
    root = structure.static_root
    pairs = gap.T @ root  # what follows is exact even where root root^T is mostly rounding
    return AllModes(
        squares,
        shapes,
        structure.rate,
        shapes.T @ gap,
        bool(np.any(squares == 0.0)),
        pairs @ pairs.T,
        root @ pairs.T,
        structure.left,
        (structure.mass.getDiagonal().array_r[:, None] * shapes).T,
    )
