"""Receptance of a structure: its response to pair forces and load, at pairs and load.

With X = [B, B_t, f] and unit amplitudes c, the response to forces X c of angular frequency w is

    X^T u = sum_j X^T phi_j phi_j^T X c / (w_j^2 - w^2) + S c

The sum has the N lowest modes; S = X^T G X is the static compliance of all other modes. Fewer modes
truncate more, by the statics of the modes between. So one receptance holds all those of fewer
modes, as sums of small arrays. More modes extend it.

All structures with the same matrices share one receptance. Made from arrays alone it needs no
matrices. Then only the dofs with known rows have displacements.

References
----------
MacNeal, Computers & Structures 1, 1971, 581.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse

from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.model.factor import MAX_BLOCK_COLUMNS, Factor
from fenics_crack.model.matrices import AbsentMatrix
from fenics_crack.model.modes import multiply, solve_modes, solve_modes_with_factor
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import MACHINE_EPSILON, ROUNDING


@dataclass(frozen=True, eq=False)
class Receptance:
    """The lowest modes and their truncated part at pairs and load, on every rank.

    Attributes
    ----------
    squares : (n_modes,) [rad^2/s^2]
        w_j^2, ascending.
    modal : (n_sources, n_modes)
        X^T Phi, of mass-normalised modes.
    compliance : (n_sources, n_sources)
        S = X^T G X beyond the modes.
    rows : dict of int to ((n_modes,), (n_sources,))
        Displacements of a dof by the modes, and by G X. Further dofs are added on request.
    force : (2K+1, n_local) [N]
        The structure's load f; X has its nonzero rows.
    inertia : (n_pairs,) [m s^2/N]
        Diagonal of B^T G M G B beyond the modes. Forces of angular frequency w do more than S says,
        by w^2 times this.
    """

    squares: np.ndarray
    modal: np.ndarray
    compliance: np.ndarray
    rows: dict[int, tuple[np.ndarray, np.ndarray]]
    force: np.ndarray
    inertia: np.ndarray

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.squares)

    def beyond(self, count: int, seen: np.ndarray, modal: np.ndarray) -> np.ndarray:
        """Return seen^T G X beyond the first ``count`` modes.

        Parameters
        ----------
        seen : (m, n_sources)
            seen^T G X beyond all modes.
        modal : (m, n_modes)
            Displacements by the modes.

        Returns
        -------
        (m, n_sources)
        """
        between = slice(count, None)
        weighted = modal[:, between] / self.squares[between]
        return np.asarray(seen + weighted @ self.modal[:, between].T)

    def compliance_beyond(self, count: int) -> np.ndarray:
        """Return S beyond the first ``count`` modes: (n_sources, n_sources)."""
        return self.beyond(count, self.compliance, self.modal)

    def inertia_beyond(self, count: int) -> np.ndarray:
        """Return the diagonal of B^T G M G B beyond the first ``count`` modes: (n_pairs,)."""
        weighted_modes = self.modal[: len(self.inertia), count:] / self.squares[count:]
        return np.asarray(self.inertia + np.sum(weighted_modes**2, axis=1))


def receptance(structure: Structure, count: int) -> Receptance:
    """Return the receptance of the original structure (collective).

    It has ``count`` modes or more.

    Raises
    ------
    InputError
        The structure is made from arrays alone, which have fewer modes, or another load.
    """
    structure = structure.original
    held = structure.cached_result(held_receptance)
    last = structure.cached_result(last_receptance, from_matrices=True)
    if not held and last:
        held += filter(None, [_of_load(structure, last[0])])
    if not held or held[0].n_modes < count:
        check_matrices(structure, f"{count} modes")
        held[:] = last[:] = [_extended(structure, held[0] if held else None, count)]
    return held[0]


def held_receptance(structure: Structure) -> list[Receptance]:
    """Return an empty cache for the receptance with the most modes so far.

    The cache does not hold the structure, which would keep it alive.
    """
    return []


def last_receptance(structure: Structure) -> list[Receptance]:
    """Return an empty cache for structures with the same matrices and any load.

    It keeps the last receptance of any such structure.
    """
    return []


def _of_load(structure: Structure, known: Receptance) -> Receptance | None:
    """Return a receptance with the structure's load, from one with another load (collective).

    None: the structure's load is no sum of the other load's parts.
    """
    own, other = structure.force[loaded_parts(structure)], known.force
    both = np.vstack([other[loaded_parts(structure, other)], own])
    given = len(both) - len(own)
    if len(known.modal) - given != sources_of(structure).shape[1] - len(own):
        return None  # with tangents, or without
    gram = structure.sum_over_ranks(both @ both.T)
    weights = np.linalg.pinv(gram[:given, :given], hermitian=True) @ gram[:given, given:]
    left = structure.sum_over_ranks(((own - weights.T @ both[:given]) ** 2).sum(axis=1))
    if np.any(left > (ROUNDING * ROUNDING) * np.diag(gram)[given:]):
        return None
    change = scipy.linalg.block_diag(np.eye(len(known.modal) - given), weights)
    rows = {dof: (shape, static @ change) for dof, (shape, static) in known.rows.items()}
    compliance = change.T @ known.compliance @ change
    return Receptance(
        known.squares, change.T @ known.modal, compliance, rows, structure.force, known.inertia
    )


def check_matrices(structure: Structure, wanted: str) -> None:
    """Raise InputError if a structure of arrays alone lacks its matrices."""
    if not structure.has_matrices:
        raise AbsentMatrix.input_error(wanted)


def sources_of(structure: Structure) -> sparse.csr_matrix:
    """Return X: (n_local, n_sources) (collective)."""
    force = structure.force[loaded_parts(structure)]
    contact = [structure.gap] + ([] if structure.tangential is None else [structure.tangential])
    return sparse.hstack([*contact, force.T]).tocsr()


def loaded_parts(structure: Structure, force: np.ndarray | None = None) -> np.ndarray:
    """Return True for nonzero parts of a load, by default the structure's (collective).

    Returns
    -------
    (2K+1,) bool
    """
    force = structure.force if force is None else force
    return np.asarray(structure.sum_over_ranks((force**2).sum(axis=1)) > 0.0)


def _extended(structure: Structure, known: Receptance | None, count: int) -> Receptance:
    """Return a receptance with ``count`` modes, more than are known (collective)."""
    begin("factor of the stiffness")
    with Factor(structure.stiffness, definite=True) as factor:
        found = solve_modes_with_factor(factor, structure, count)
        squares, every = found.omega**2, count == structure.n_dofs
        left = ResidualFlexibility(structure, found.shapes, squares, sources_of(structure))
        begin("static responses")
        if known is None or known.squares[-1] == 0.0:  # there may be more motions as a rigid body
            size = left.modal.shape[:1]
            nothing = np.zeros(size * 2), np.zeros(size)
            compliance, inertia = nothing if every else left.compliance(factor)
            made = Receptance(
                squares, left.modal, compliance, {}, structure.force, inertia[: structure.n_pairs]
            )
            _add_rows(made, structure, _loaded_dofs(structure), left, factor)
            return made
    between = slice(known.n_modes, None)
    weighted = left.modal[:, between] / squares[between]
    compliance = known.compliance - weighted @ left.modal[:, between].T
    inertia = known.inertia - np.sum(weighted[: structure.n_pairs] ** 2, axis=1)
    dofs = [*known.rows]
    shapes = structure.values_at(found.shapes.T, dofs).T
    static = np.array([row for _, row in known.rows.values()]) - shapes[:, between] @ weighted.T
    keep = 0.0 if every else 1.0
    rows = dict(zip(dofs, zip(shapes, keep * static, strict=True), strict=True))
    return Receptance(squares, left.modal, keep * compliance, rows, structure.force, keep * inertia)


def rows_at(structure: Structure, count: int, dofs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements of dofs by modes and by G X; they are kept (collective).

    Returns
    -------
    (m, count)
        Displacements by the modes.
    (m, n_sources)
        Displacements by G X beyond the modes.
    """
    known, structure = receptance(structure, count), structure.original
    wanted = [int(dof) for dof in dofs]
    missing = [dof for dof in dict.fromkeys(wanted) if dof not in known.rows]
    if missing:
        shapes = solve_modes(structure, known.n_modes).shapes
        left = ResidualFlexibility(structure, shapes, known.squares, sources_of(structure))
        _add_rows(known, structure, np.array(missing), left)
    shapes, static = (
        np.array(rows) for rows in zip(*(known.rows[dof] for dof in wanted), strict=True)
    )
    return shapes[:, :count], known.beyond(count, static, shapes)


def expanded(
    structure: Structure, shapes: np.ndarray, squares: np.ndarray, amplitude: np.ndarray
) -> np.ndarray:
    """Return G X c beyond some modes, from amplitudes (collective).

    Parameters
    ----------
    amplitude : (m, n_sources)
        c.

    Returns
    -------
    (m, n_local)
    """
    used = np.any(amplitude != 0.0, axis=1)
    found = np.zeros((len(amplitude), structure.n_local))
    if np.any(used):
        sources = sources_of(structure.original)
        left = ResidualFlexibility(structure, shapes, squares, sources)
        with Factor(structure.stiffness, definite=True) as factor:
            found[used] = left.solve(factor, (sources @ amplitude[used].T).T)
    return found


def _add_rows(
    known: Receptance,
    structure: Structure,
    dofs: np.ndarray,
    left: ResidualFlexibility,
    factor: Factor | None = None,
) -> None:
    """Add the rows of some dofs to a receptance (collective)."""
    own = dofs - structure.first_dof
    mine = np.flatnonzero((own >= 0) & (own < structure.n_local))
    shape = structure.n_local, len(dofs)
    units = sparse.csr_matrix((np.ones(len(mine)), (own[mine], mine)), shape)
    static = np.zeros((len(dofs), len(known.modal)))
    if known.n_modes < structure.n_dofs:
        made = factor or Factor(structure.stiffness, definite=True)
        with nullcontext(made) if factor else made as used:
            static = left.seen(used, units)[0]
    shapes = structure.values_at(left.shapes.T, dofs).T
    known.rows.update(zip(map(int, dofs), zip(shapes, static, strict=True), strict=True))


def _loaded_dofs(structure: Structure) -> np.ndarray:
    """Return the dofs under the load, to watch the effect of the load (collective).

    With more loaded dofs than one block of static solutions holds, it is the watched dof.
    """
    own = np.flatnonzero(np.any(structure.force != 0.0, axis=0)) + structure.first_dof
    found = gather_rows(structure.comm, own)
    return found if len(found) <= MAX_BLOCK_COLUMNS else np.array([structure.watched_dof])


class ResidualFlexibility:
    """G = K^-1 - Phi Lambda^-1 Phi^T of a structure, a map of forces to displacements.

    A force f first loses its part on the modes, r = f - M Phi Phi^T f. The displacement x = K^-1 r
    then loses its own, x - Phi Phi^T M x. Nothing cancels, and modes hold a structure that can move
    as a rigid body.

    Attributes
    ----------
    structure : Structure
        The whole one.
    shapes : (n_local, n_modes)
        Phi, mass-normalised.
    squares : (n_modes,) [rad^2/s^2]
        Squares of the modes' frequencies.
    sources : (n_local, n_sources)
        X: the forces of unit amplitude, a sparse matrix.
    modal : (n_sources, n_modes)
        X^T Phi.
    """

    def __init__(
        self, structure: Structure, shapes: np.ndarray, squares: np.ndarray, sources: Any
    ) -> None:
        self.structure, self.shapes, self.squares = structure, shapes, squares
        self.sources = sparse.csr_matrix(sources)
        self.modal = structure.sum_over_ranks(self.sources.T @ shapes)
        # With a hinge that hardly resists, only rounding of the modal part would remain.
        self._held = bool(np.all(squares > np.sqrt(MACHINE_EPSILON) * squares[-1:]))

    def solve(self, factor: Factor, forces: np.ndarray) -> np.ndarray:
        """Return G f of forces (m, n_local), with the factor of K: the same shape (collective)."""
        structure, shapes = self.structure, self.shapes
        modal = structure.sum_over_ranks(forces @ shapes)
        found = factor.solve(forces - multiply(structure.mass, shapes @ modal.T).T)
        moved = multiply(structure.mass, found.T).T
        return found - structure.sum_over_ranks(moved @ shapes) @ shapes.T

    def seen(self, factor: Factor, columns: sparse.spmatrix) -> tuple[np.ndarray, np.ndarray]:
        """Return Y^T G X, and the diagonal of Y^T G M G Y (collective).

        Parameters
        ----------
        columns : (n_local, m)
            Y, sparse forces.

        Returns
        -------
        (m, n_sources)
            Y^T G X.
        (m,)
            Diagonal of Y^T G M G Y.
        """
        rows, inertia = [np.zeros((0, self.sources.shape[1]))], [np.zeros(0)]
        for start in range(0, columns.shape[1], MAX_BLOCK_COLUMNS):
            block = columns[:, start : start + MAX_BLOCK_COLUMNS].T.toarray()
            # If K^-1 is small enough, its modal part is subtracted once, below.
            moved = factor.solve(block) if self._held else self.solve(factor, block)
            rows.append((self.sources.T @ moved.T).T)
            inertia.append(np.sum(moved.T * multiply(self.structure.mass, moved.T), axis=0))
        found: np.ndarray = self.structure.sum_over_ranks(np.concatenate(rows))
        inertias: np.ndarray = self.structure.sum_over_ranks(np.concatenate(inertia))
        if self._held:
            weighted = self.structure.sum_over_ranks(columns.T @ self.shapes) / self.squares
            found -= weighted @ self.modal.T
            inertias -= np.sum(weighted**2, axis=1)
        return found, inertias

    def compliance(self, factor: Factor) -> tuple[np.ndarray, np.ndarray]:
        """Return S = X^T G X, and the diagonal of X^T G M G X (collective).

        Returns
        -------
        (n_sources, n_sources)
            S, symmetric.
        (n_sources,)
            Diagonal of X^T G M G X.
        """
        found, inertia = self.seen(factor, self.sources)
        return 0.5 * (found + found.T), inertia
