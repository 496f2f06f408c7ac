"""Receptance of a structure: what forces on contact pairs and load do to it, as seen at both.

With X = [B, B_t, f] and unit amplitudes c the response to forces X c of angular frequency w is

    X^T u = sum_j X^T phi_j phi_j^T X c / (w_j^2 - w^2) + S c

in N lowest modes and the static compliance S = X^T G X of all others (MacNeal, Computers &
Structures 1, 1971, 581). Fewer modes leave out what more do and the statics of those between, so
that one receptance holds all of fewer modes: sums of small arrays. More modes extend it.

A structure and all that share its matrices share one; made from arrays alone it needs no matrices,
and has no displacements but those of the dofs whose rows it holds.
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
from fenics_crack.model.factor import AT_A_TIME, Factor
from fenics_crack.model.matrices import Absent
from fenics_crack.model.modes import modes_by, solve_modes, times
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import MACHINE_EPSILON, ROUNDING


@dataclass(frozen=True, eq=False)
class Receptance:
    """The lowest modes and all that they leave out, seen at pairs and load; the same on all ranks.

    Attributes
    ----------
    squares : (n_modes,) [rad^2/s^2]
        w_j^2, ascending.
    modal : (n_sources, n_modes)
        X^T Phi, of mass-normalised modes.
    compliance : (n_sources, n_sources)
        S = X^T G X beyond the modes.
    rows : dict of int to ((n_modes,), (n_sources,))
        Of dofs of the structure: their displacements by the modes, and by G X. More are added.
    force : (2K+1, n_local) [N]
        The structure's load f, of which X has the rows that are not zero.
    inertia : (n_pairs,) [m s^2/N]
        Diagonal of B^T G M G B beyond the modes: by w^2 times this forces of angular frequency w do
        more than S says.
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
        """seen^T G X, G being that beyond so many modes, from what it is beyond all: (m, n_sources)
        of displacements by the modes, (m, n_modes), and by G X."""
        between = slice(count, None)
        weighted = modal[:, between] / self.squares[between]
        return np.asarray(seen + weighted @ self.modal[:, between].T)

    def compliance_beyond(self, count: int) -> np.ndarray:
        """S beyond so many modes: (n_sources, n_sources)."""
        return self.beyond(count, self.compliance, self.modal)

    def inertia_beyond(self, count: int) -> np.ndarray:
        """Diagonal of B^T G M G B beyond so many modes: (n_pairs,)."""
        weighted_modes = self.modal[: len(self.inertia), count:] / self.squares[count:]
        return np.asarray(self.inertia + np.sum(weighted_modes**2, axis=1))


def receptance(structure: Structure, count: int) -> Receptance:
    """The receptance of a structure, not varied, with so many modes or more (collective).

    Raises
    ------
    InputError
        It is made from arrays alone, which have fewer modes, or another load.
    """
    structure = structure.original
    held, last = structure.once(held_receptance), structure.once(last_receptance, of_matrices=True)
    if not held and last:
        held += filter(None, [_of_load(structure, last[0])])
    if not held or held[0].n_modes < count:
        check_matrices(structure, f"{count} modes")
        held[:] = last[:] = [_extended(structure, held[0] if held else None, count)]
    return held[0]


def held_receptance(structure: Structure) -> list[Receptance]:
    """The receptance with the most modes requested so far; it does not hold the structure itself,
    which would keep it alive."""
    return []


def last_receptance(structure: Structure) -> list[Receptance]:
    """That of the last of all structures that share the matrices, whatever their loads."""
    return []


def _of_load(structure: Structure, known: Receptance) -> Receptance | None:
    """The receptance of a structure by that of another load, where its own is a sum of the other's
    parts; else None (collective)."""
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
    """Raise InputError for what a structure of arrays alone has not."""
    if not structure.has_matrices:
        raise Absent.refused(wanted)


def sources_of(structure: Structure) -> sparse.csr_matrix:
    """X: (n_local, n_sources) (collective)."""
    force = structure.force[loaded_parts(structure)]
    contact = [structure.gap] + ([] if structure.tangential is None else [structure.tangential])
    return sparse.hstack([*contact, force.T]).tocsr()


def loaded_parts(structure: Structure, force: np.ndarray | None = None) -> np.ndarray:
    """True for parts of the load, or of another, that are not zero: (2K+1,) (collective)."""
    force = structure.force if force is None else force
    return np.asarray(structure.sum_over_ranks((force**2).sum(axis=1)) > 0.0)


def _extended(structure: Structure, known: Receptance | None, count: int) -> Receptance:
    """With so many modes, more than are known."""
    begin("factor of the stiffness")
    with Factor(structure.stiffness, definite=True) as factor:
        found = modes_by(factor, structure, count)
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
    """Displacements of dofs by so many modes (m, count), and by G X beyond them (m, n_sources);
    kept (collective)."""
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
    """G X c of amplitudes (m, n_sources) beyond some modes: (m, n_local) (collective)."""
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
    """Dofs under the load, at which its effect is watched; of a load on more than one block of
    static solutions holds the watched one (collective)."""
    own = np.flatnonzero(np.any(structure.force != 0.0, axis=0)) + structure.first_dof
    found = gather_rows(structure.comm, own)
    return found if len(found) <= AT_A_TIME else np.array([structure.watched_dof])


class ResidualFlexibility:
    """G = K^-1 - Phi Lambda^-1 Phi^T of a structure, as a map of forces to displacements.

    A force is first freed of its part on the modes, r = f - M Phi Phi^T f, and the displacement
    x = K^-1 r of its own, x - Phi Phi^T M x: nothing cancels, and a structure that can move as a
    rigid body is held by its modes.

    Attributes
    ----------
    structure : Structure
        The whole one.
    shapes : (n_local, n_modes)
        Phi, mass-normalised.
    squares : (n_modes,) [rad^2/s^2]
        The squares of their frequencies.
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
        # Of a hinge that hardly resists, rounding of the modal part would be all that is left.
        self._held = bool(np.all(squares > np.sqrt(MACHINE_EPSILON) * squares[-1:]))

    def solve(self, factor: Factor, forces: np.ndarray) -> np.ndarray:
        """G f of forces (m, n_local), with the factor of K: the same shape (collective)."""
        structure, shapes = self.structure, self.shapes
        modal = structure.sum_over_ranks(forces @ shapes)
        found = factor.solve(forces - times(structure.mass, shapes @ modal.T).T)
        moved = times(structure.mass, found.T).T
        return found - structure.sum_over_ranks(moved @ shapes) @ shapes.T

    def seen(self, factor: Factor, columns: sparse.spmatrix) -> tuple[np.ndarray, np.ndarray]:
        """Y^T G X, (m, n_sources), and the diagonal of Y^T G M G Y, (m,), of sparse forces Y
        (n_local, m) (collective)."""
        rows, inertia = [np.zeros((0, self.sources.shape[1]))], [np.zeros(0)]
        for start in range(0, columns.shape[1], AT_A_TIME):
            block = columns[:, start : start + AT_A_TIME].T.toarray()
            # Where K^-1 is small enough its modal part is subtracted once, below.
            moved = factor.solve(block) if self._held else self.solve(factor, block)
            rows.append((self.sources.T @ moved.T).T)
            inertia.append(np.sum(moved.T * times(self.structure.mass, moved.T), axis=0))
        found: np.ndarray = self.structure.sum_over_ranks(np.concatenate(rows))
        inertias: np.ndarray = self.structure.sum_over_ranks(np.concatenate(inertia))
        if self._held:
            weighted = self.structure.sum_over_ranks(columns.T @ self.shapes) / self.squares
            found -= weighted @ self.modal.T
            inertias -= np.sum(weighted**2, axis=1)
        return found, inertias

    def compliance(self, factor: Factor) -> tuple[np.ndarray, np.ndarray]:
        """S = X^T G X, (n_sources, n_sources), and the diagonal of X^T G M G X (collective)."""
        found, inertia = self.seen(factor, self.sources)
        return 0.5 * (found + found.T), inertia
