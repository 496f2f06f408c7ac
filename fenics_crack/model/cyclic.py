"""Cyclic symmetry: a wheel of equal sectors by one of them, a nodal diameter at a time.

Frames turn with the sectors, so that all have the same K and M. With u_j the displacement of sector
j, and m_j the part that belongs to it alone,

    u_j = T_0 m_j + T_1 m_(j+1):

T_1 gives the nodes of the right side, which are in the next sector's frame, what its left ones
have, and T_0 bonds the faces of the crack: each row of T_0 + T_1 has a single 1. Of nodal diameter
n, m_(j+1) = e^(i 2 pi n / N) m_j, so

    T_n = T_0 + e^(i 2 pi n / N) T_1,      K_n = T_n^H K T_n,      M_n = T_n^H M T_n,
    K_n v = w^2 M_n v,                     n = 0 .. N/2.

In real numbers, which PETSc has here, [[Re, -Im], [Im, Re]] takes the place of each, with every
frequency twice. A load f on sector 0 alone is a sum of all nodal diameters,

    u_j = 1/N sum_n e^(i 2 pi n j / N) T_n K_n^-1 T_n^H f,      n = 0 .. N - 1,

whose second half is the conjugate of the first (Thomas, International Journal for Numerical Methods
in Engineering 14, 1979, 81).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.model.body import Body
from fenics_crack.model.factor import Factor, distributed, local_rows
from fenics_crack.model.modes import MULTIPLE, NEGLIGIBLE, modes_by
from fenics_crack.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Sector:
    """One sector of a wheel, with free sides and an open crack, in its own frame.

    Attributes
    ----------
    structure : Structure
        Its matrices, gaps and load, on this rank alone; displacements of the right side in the
        frame of the next sector.
    count : int
        N, the number of sectors.
    center : (d,) [m]
        A point of the axis.
    turn : (d, d)
        Q, which turns the left side to the right one, and so each sector to the next one.
    sides : (2, m) int
        Nodes of the left side, and those of the right one in the same order.
    lips : (2, p) int
        Nodes of the lower face of the crack, and those of the upper one, without the tip.
    elastic : PETSc.Mat
        The stiffness at rest, which mistuning multiplies.
    """

    structure: Structure
    count: int
    center: np.ndarray
    turn: np.ndarray
    sides: np.ndarray
    lips: np.ndarray
    elastic: Any

    @property
    def dofs(self) -> np.ndarray:
        """Of its nodes, (n_nodes, d); -1 where they are clamped."""
        nodes = self.structure.nodes
        assert nodes is not None
        return nodes.dofs

    @property
    def diameters(self) -> range:
        """The nodal diameters 0 .. N/2."""
        return range(self.count // 2 + 1)

    @property
    def shares(self) -> np.ndarray:
        """Of each nodal diameter, and its conjugate, in the motion of sector 0: (N/2 + 1,)."""
        twice = [1.0 if self.is_single(n) else 2.0 for n in self.diameters]
        return np.array(twice) / self.count

    def is_single(self, diameter: int) -> bool:
        """True of the nodal diameters without a second one that turns the other way."""
        return 2 * diameter % self.count == 0

    def circumferential(self, dof: int) -> dict[int, float]:
        """The displacement of a dof's node in the direction in which sectors follow one another, as
        factors of the node's dofs."""
        nodes = self.structure.nodes
        assert nodes is not None
        node = int(np.argwhere(nodes.dofs == dof)[0, 0])
        # Q - Q^T = 2 sin(2 pi / N) times the cross product with the axis.
        along = (self.turn - self.turn.T) @ (nodes.points[node] - self.center)
        shares = zip(
            nodes.dofs[node].tolist(), (along / np.linalg.norm(along)).tolist(), strict=True
        )
        return {one: share for one, share in shares if one >= 0 and share != 0.0}

    def turned(self, times: int) -> np.ndarray:
        """Q^times: (d, d)."""
        return np.asarray(np.linalg.matrix_power(self.turn, times % self.count))

    def placed(self, points: np.ndarray, times: int) -> np.ndarray:
        """Points (n, d) of the first sector where they are in another one [m]."""
        return np.asarray((points - self.center) @ self.turned(times).T + self.center)

    @cached_property
    def upper(self) -> np.ndarray:
        """Dofs of the upper face."""
        found = self.dofs[self.lips[1]].ravel()
        return found[found >= 0]

    @cached_property
    def after(self) -> np.ndarray:
        """True for the dofs of the right side, which are the next sector's: (n_dofs,)."""
        return np.isin(np.arange(self.structure.n_dofs), self.dofs[self.sides[1]])

    @cached_property
    def _bonded(self) -> tuple[np.ndarray, np.ndarray]:
        same = np.arange(self.structure.n_dofs)
        for first, other in (self.sides, self.lips):
            free = self.dofs[other] >= 0
            same[self.dofs[other][free]] = self.dofs[first][free]
        return np.unique(same, return_inverse=True)

    @property
    def own(self) -> np.ndarray:
        """Dofs that belong to a sector with a bonded crack: all but those of the right side and of
        the upper face."""
        return self._bonded[0]

    @property
    def place(self) -> np.ndarray:
        """Of each dof the place of that which moves as it does, in this sector or the next one,
        among a sector's own: (n_dofs,)."""
        return self._bonded[1]

    def ties(self, turn: complex) -> sparse.csr_matrix:
        """T_n of e^(i 2 pi n / N): (n_dofs, n_own)."""
        return chosen(self.place, len(self.own), np.where(self.after, turn, 1.0))

    def of_diameter(self, matrix: sparse.csr_matrix, turn: complex) -> sparse.csr_matrix:
        """T_n^H A T_n of a matrix of the sector: (n_own, n_own)."""
        ties = self.ties(turn)
        return sparse.csr_matrix(ties.conj().T @ matrix @ ties)

    @cached_property
    def opening(self) -> sparse.csc_matrix:
        """E, which moves the upper face by displacements of the crack: (n_dofs, n_upper)."""
        count = len(self.upper)
        shape = self.structure.n_dofs, count
        return sparse.csc_matrix((np.ones(count), (self.upper, np.arange(count))), shape)

    @cached_property
    def stiffness(self) -> sparse.csr_matrix:
        """K."""
        return local_rows(self.structure.stiffness)

    @cached_property
    def mass(self) -> sparse.csr_matrix:
        """M."""
        return local_rows(self.structure.mass)

    @cached_property
    def _known(self) -> dict[tuple[Any, ...], Any]:
        return {}

    def once(self, key: tuple[Any, ...], compute: Callable[[], Any]) -> Any:
        """What was computed of it once under a name and what it depends on."""
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]

    def ritz(self, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies, ascending, and shapes with v^H M v = 1 and v^H K v diagonal, in the space of
        others (n_dofs, m) of one nodal diameter, which may depend on each other."""
        weights, mixed = np.linalg.eigh(shapes.conj().T @ (self.mass @ shapes))
        kept = weights > NEGLIGIBLE * weights[-1]
        shapes = shapes @ (mixed[:, kept] / np.sqrt(weights[kept]))
        squares, mixed = scipy.linalg.eigh(
            shapes.conj().T @ (self.stiffness @ shapes), shapes.conj().T @ (self.mass @ shapes)
        )
        return np.sqrt(np.maximum(squares, 0.0)), shapes @ mixed

    def at_speed(self, stiffness: Any, force: np.ndarray) -> Sector:
        """The same with the stiffness and the load of a speed of the rotor."""
        found = self.structure._changed(stiffness=stiffness, force=force)
        return replace(self, structure=found)

    @contextmanager
    def factored(self, stiffness: Any = None) -> Iterator[Inside]:
        """The stiffness of all nodal diameters, factored; another one than its own, if given."""
        matrix, count = (
            self.stiffness if stiffness is None else local_rows(stiffness),
            len(self.own),
        )
        both = chosen(self.place + count * self.after, 2 * count)
        whole = sparse.csr_matrix(both.T @ matrix @ both)
        side = np.unique(self.place[self.after])
        inside, right = np.setdiff1d(np.arange(count), side), count + side
        to_left, to_right = (whole[inside][:, one] for one in (side, right))
        held = distributed(whole[inside][:, inside], MPI.COMM_SELF)
        with Factor(held, definite=True) as factor:
            by_left, by_right = (factor.solve(to.T).T for to in (to_left, to_right))
            own = whole[side][:, side] + whole[right][:, right]
            yield Inside(
                self, matrix, factor, inside, side, (to_left, to_right),
                own - to_left.T @ by_left - to_right.T @ by_right,
                whole[side][:, right] - to_left.T @ by_right,
            )  # fmt: skip
        held.destroy()


def chosen(columns: np.ndarray, count: int, values: np.ndarray | None = None) -> sparse.csr_matrix:
    """The matrix (n, count) whose rows have one entry each, 1 or another value."""
    every = np.arange(len(columns) + 1)
    values = np.ones(len(columns)) if values is None else values
    return sparse.csr_matrix((values, columns, every), (len(columns), count))


def in_real_form(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
    """[[Re, -Im], [Im, Re]] of a complex matrix; a real one as it is."""
    if not np.iscomplexobj(matrix):
        return matrix
    return sparse.bmat([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]], format="csr")


@dataclass(frozen=True, eq=False)
class Inside:
    """The stiffness of a sector whose inside is eliminated, once for all nodal diameters: what is
    left of each is a dense matrix of one side,

        S_n = P + e^(it) R + e^(-it) R^T.

    Attributes
    ----------
    sector, stiffness
        The sector, and the stiffness that is factored.
    factor : Factor
        Of the stiffness of the inside K_ii.
    inside, side : (n_inside,), (n_side,) int
        Places of the dofs inside and on the left side in those of the sector's own.
    coupling : pair of (n_inside, n_side)
        K_il of the left and of the right side.
    own, across : (n_side, n_side)
        P and R.
    """

    sector: Sector
    stiffness: sparse.csr_matrix
    factor: Factor
    inside: np.ndarray
    side: np.ndarray
    coupling: tuple[sparse.csr_matrix, sparse.csr_matrix]
    own: np.ndarray
    across: np.ndarray

    def within(self, forces: Any) -> np.ndarray:
        """K_ii^-1 f_i of real forces (n_dofs, m) on a sector, the same for all nodal diameters:
        (n_inside, m)."""
        seen = (self.sector.ties(1.0).T @ forces)[self.inside]
        seen = seen.toarray() if sparse.issparse(seen) else np.asarray(seen)
        return self.factor.solve(seen.T).T if seen.any() else seen

    def at(self, diameter: int) -> NodalDiameter:
        """One nodal diameter."""
        angle = 2.0 * np.pi * diameter / self.sector.count
        single = self.sector.is_single(diameter)
        turn = float(round(np.cos(angle))) if single else complex(np.exp(1j * angle))
        return NodalDiameter(self, turn)


@dataclass(frozen=True, eq=False)
class NodalDiameter:
    """A nodal diameter of a wheel with bonded cracks.

    Attributes
    ----------
    inside : Inside
        The sector's stiffness.
    turn : complex
        e^(i 2 pi n / N).
    """

    inside: Inside
    turn: complex

    null_pivots = 0

    @cached_property
    def ties(self) -> sparse.csr_matrix:
        """T_n: (n_dofs, n_own)."""
        return self.inside.sector.ties(self.turn)

    @cached_property
    def _left(self) -> tuple[np.ndarray, sparse.csr_matrix, sparse.csr_matrix]:
        """S_n^-1, and K_il of this nodal diameter and its adjoint."""
        inside, turn = self.inside, self.turn
        across = np.asarray(turn * inside.across)
        inverse = np.linalg.inv(np.asarray(inside.own) + across + across.conj().T)
        coupling = sparse.csr_matrix(inside.coupling[0] + turn * inside.coupling[1])
        return inverse, coupling, sparse.csr_matrix(coupling.conj().T)

    def work(self, forces: Any, within: np.ndarray) -> np.ndarray:
        """Real part of f^H T_n K_n^-1 T_n^H f of real forces (n_dofs, m), with
        :meth:`Inside.within` of them: (m, m), from the side alone."""
        inverse, _, adjoint = self._left
        seen = sparse.csr_matrix(self.ties.conj().T @ forces)
        left = seen[self.inside.side].toarray() - adjoint @ within
        found = seen[self.inside.inside].real.T @ within + (left.conj().T @ (inverse @ left)).real
        return np.asarray(found)

    def solve(self, forces: np.ndarray, within: np.ndarray | None = None) -> np.ndarray:
        """K_n^-1 f of forces on the sector's own dofs (n_own, m), with K_ii^-1 f_i where that is
        known: the same shape."""
        inside, side = self.inside.inside, self.inside.side
        inverse, coupling, adjoint = self._left
        if within is None:
            within = _solved(self.inside.factor, forces[inside])
        found = np.empty(forces.shape, dtype=np.result_type(forces, inverse))
        found[side] = inverse @ (forces[side] - adjoint @ within)
        found[inside] = within - _solved(self.inside.factor, coupling @ found[side])
        return found

    def apply(self, right: Any, solution: Any) -> None:
        """K_n^-1 of a vector of PETSc's in real form, as :meth:`Factor.apply`."""
        given = right.array_r
        if not self.turn.imag:
            solution.array_w[:] = self.solve(given[:, None])[:, 0]
            return
        real, imaginary = np.split(given, 2)
        found = self.solve((real + 1j * imaginary)[:, None])[:, 0]
        solution.array_w[:] = np.concatenate([found.real, found.imag])

    def modes(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (count,) [rad/s], and shapes of a sector (n_dofs, count) with v^H M v = 1."""
        sector = self.inside.sector
        mass, stiffness = (
            distributed(in_real_form(sector.of_diameter(one, self.turn)), MPI.COMM_SELF)
            for one in (sector.mass, self.inside.stiffness)
        )
        size = mass.size[0]
        gap = sparse.csr_matrix((size, 0))
        structure = Structure(Body(mass, stiffness, gap, np.zeros((1, size)), np.zeros(0)))
        found = modes_by(self, structure, 2 * count if self.turn.imag else count)
        for used in (mass, stiffness):  # PETSc would keep those of all nodal diameters
            used.destroy()
        if not self.turn.imag:
            return found.omega, self.ties @ found.shapes
        real, imaginary = np.split(found.shapes, 2)
        # Each pair of real modes is one complex one, twice over.
        omega, shapes = sector.ritz(self.ties @ (real + 1j * imaginary))
        return omega[:count], shapes[:, :count]

    def answers(self, forces: Any, within: np.ndarray | None = None) -> np.ndarray:
        """T_n K_n^-1 T_n^H f of forces (n_dofs, m) on a sector, with :meth:`Inside.within` of them
        where that is known: the same shape."""
        seen = self.ties.conj().T @ forces
        seen = seen.toarray() if sparse.issparse(seen) else np.asarray(seen)
        return np.asarray(self.ties @ self.solve(seen, within))


def _solved(factor: Factor, forces: np.ndarray) -> np.ndarray:
    """The solutions of real or complex columns."""
    if not np.iscomplexobj(forces) or not forces.imag.any():
        return factor.solve(np.ascontiguousarray(forces.real).T).T
    real, imaginary = np.split(factor.solve(np.hstack([forces.real, forces.imag]).T).T, 2, axis=1)
    return real + 1j * imaginary


@dataclass(frozen=True, eq=False)
class CyclicModes:
    """Natural modes of a wheel of equal sectors with bonded cracks.

    Sector j, from 0, moves in mode m of nodal diameter n as the real and the imaginary part of
    v e^(i 2 pi n j / N): two modes of one frequency, of n = 0 and N/2 one.

    Attributes
    ----------
    omega : tuple of (families,) [rad/s]
        Natural frequencies of n = 0 .. N/2.
    shapes : tuple of (n_dofs, families)
        v of each nodal diameter, over the dofs of a sector, real or complex, with v^H M v = 1.
    sector : Sector
        The sector.
    """

    omega: tuple[np.ndarray, ...]
    shapes: tuple[np.ndarray, ...]
    sector: Sector


@dataclass(frozen=True, eq=False)
class CyclicBasis:
    """Motions of a wheel with bonded cracks in which a cracked, mistuned one is sought.

    Attributes
    ----------
    modes : CyclicModes
        The lowest of each nodal diameter, and with them static answers to the load and at sides.
    opened : (N, n_dofs, m)
        Answers of all sectors to displacements of the upper face of the crack in sector 0 beside
        the lower one's, without these themselves.
    opening : (n_dofs, m)
        These displacements.
    """

    modes: CyclicModes
    opened: np.ndarray
    opening: sparse.csc_matrix

    def times(self, matrix: sparse.csr_matrix) -> CyclicBasis:
        """The products of all fields with a matrix of the sector."""
        shapes = tuple(matrix @ shapes for shapes in self.modes.shapes)
        return CyclicBasis(
            replace(self.modes, shapes=shapes),
            np.array([matrix @ one for one in self.opened]),
            sparse.csc_matrix(matrix @ self.opening),
        )

    @property
    def squares(self) -> np.ndarray:
        """omega^2 of the modes of the wheel, as they come first in :meth:`columns`."""
        single = self.modes.sector.is_single
        both = [np.tile(w, 1 if single(n) else 2) for n, w in enumerate(self.modes.omega)]
        return np.concatenate(both) ** 2

    def columns(
        self, place: int, cracked: tuple[int, ...], rows: slice | list[int] = slice(None)
    ) -> np.ndarray:
        """Displacements of a sector, by its place from 0, in all motions: those of the modes, the
        opening of the crack of each cracked sector; (n_dofs, n), or some rows of it."""
        sector = self.modes.sector
        parts = []
        for diameter, shapes in enumerate(self.modes.shapes):
            angle = 2.0 * np.pi * diameter * place / sector.count
            if sector.is_single(diameter):
                parts.append(round(np.cos(angle)) * shapes[rows] / np.sqrt(sector.count))
            else:
                turned = np.exp(1j * angle) * np.sqrt(2.0 / sector.count) * shapes[rows]
                parts += [turned.real, turned.imag]
        for one in cracked:
            own = self.opened[(place - one) % sector.count, rows]
            parts.append(own + self.opening[rows] if place == one else own)
        return np.hstack([np.asarray(part) for part in parts])


def solve_cyclic_modes(
    sector: Sector, families: int, comm: MPI.Comm = MPI.COMM_SELF
) -> CyclicModes:
    """The lowest modes of each nodal diameter, which ranks share (collective)."""
    families, found = min(families, len(sector.own)), {}
    with sector.factored() as inside:
        for diameter in sector.diameters[comm.rank :: comm.size]:
            found[diameter] = inside.at(diameter).modes(families)
    found = _of_all_ranks(found, comm)
    omegas, shapes = zip(*(found[diameter] for diameter in sector.diameters), strict=True)
    return CyclicModes(omegas, shapes, sector)


def cyclic_basis(
    sector: Sector, families: int, loads: tuple[tuple[int, np.ndarray], ...], comm: MPI.Comm
) -> CyclicBasis:
    """The basis of so many families for loads: nodal diameters, and complex forces (n_dofs,) of
    sector 0, which turn with the sectors by e^(i 2 pi n j / N); ranks share nodal diameters
    (collective).

    It has the static answers, too, to the loads, and to what mistuning and cracks leave at the
    sides: forces (K - w^2 M) v of a sector on its right side, of which a few patterns hold those of
    all modes. They are added to each nodal diameter, as if they were modes.

    A crack opens as forces of its pairs, and those that its bonds bear, open it: with the stiffness
    of all displacements of its face, which what is on the sides gives.
    """
    families = min(families, len(sector.own))
    pulled = -sector.stiffness @ sector.opening
    # The modes of a few nodal diameters have the patterns of all.
    first = list(dict.fromkeys((0, sector.count // 4, sector.count // 2)))
    mine = [*first, *(n for n in sector.diameters if n not in first)][comm.rank :: comm.size]
    found: dict[int, tuple[Any, ...]] = {}
    with sector.factored() as inside:
        ahead = {n: inside.at(n).modes(families) for n in mine if n in first}
        seen = _of_all_ranks(ahead, comm)
        forces = _side_forces(sector, [seen[n] for n in first])
        at_sides, at_lips = inside.within(forces), inside.within(pulled)
        for diameter in mine:
            one = inside.at(diameter)
            _, shapes = ahead.get(diameter) or one.modes(families)
            beside = one.answers(forces, at_sides)
            force = _loads_of(sector, diameter, loads)
            answers = one.answers(force)
            both = np.hstack([beside, answers])
            left = both - shapes @ (shapes.conj().T @ (sector.mass @ both))
            sizes, whole = (np.sqrt(np.sum(np.abs(x) ** 2, axis=0)) for x in (left, both))
            left = left[:, kept := sizes > MULTIPLE * whole] / sizes[kept]
            omega, shapes = sector.ritz(np.hstack([shapes, sector.ritz(left)[1]]))
            pulls = _pulls(sector, omega, shapes, force, answers)
            found[diameter] = omega, shapes, pulls, one.work(pulled, at_lips)
        found = _of_all_ranks(found, comm)
        ordered = (found[diameter] for diameter in sector.diameters)
        omegas, every, pulls, works = zip(*ordered, strict=True)
        opening = _openings(sector, np.hstack(pulls), np.tensordot(sector.shares, works, 1))
        opened = _of_sectors(
            ((n, inside.at(n).answers(pulled @ opening, at_lips @ opening)) for n in mine),
            opening.shape[1], sector, comm,
        )  # fmt: skip
    moved = sparse.csc_matrix(sector.opening @ opening)
    return CyclicBasis(CyclicModes(omegas, every, sector), opened, moved)


def _loads_of(
    sector: Sector, diameter: int, loads: tuple[tuple[int, np.ndarray], ...]
) -> np.ndarray:
    """Forces (n_dofs, m) of a nodal diameter, whose answers turn with the sectors as modes do."""
    mine = [force for number, force in loads if number == diameter]
    if sector.is_single(diameter):
        mine = [part for force in mine for part in (force.real, force.imag) if np.any(part)]
    return np.array(mine).reshape(-1, sector.structure.n_dofs).T


def _pulls(
    sector: Sector, omega: np.ndarray, shapes: np.ndarray, force: np.ndarray, answers: np.ndarray
) -> np.ndarray:
    """Real forces (n_upper, m) on the upper face that bonds bear: of modes (K - w^2 M) v / w, of
    loads K x - f of unit work. In the compliance S^-1 of an opening their squares are what opening
    the crack changes of w^2, or of a load's work, relative to it."""
    parts = [(sector.stiffness @ shapes - (sector.mass @ shapes) * omega**2) / omega]
    work = np.sum(force.conj() * answers, axis=0).real
    parts.append((sector.stiffness @ answers - force) / np.sqrt(work))
    found = np.hstack(parts)[sector.upper]
    return np.hstack([found.real, found.imag])


OPENED = 1e-5
"""Least size of a pattern of forces of bonds that is kept: its square is what opening the crack by
it changes of w^2, or of the work of a load, relative to these. Smaller ones change less than the
mass of what moves with the faces, which static patterns leave out: up to 6e-9 of frequencies."""


def _openings(sector: Sector, pulls: np.ndarray, work: np.ndarray) -> np.ndarray:
    """Displacements of the upper face (n_upper, m) of unit energy, without coupling: what forces of
    contact pairs, and those that bonds bear, open the crack by."""
    structure = sector.structure
    pairs = [structure.gap] + ([] if structure.tangential is None else [structure.tangential])
    held = (sector.opening.T @ sector.stiffness @ sector.opening).toarray() - work
    lower = scipy.linalg.cholesky(0.5 * (held + held.T), lower=True)
    contact, pulls = (
        scipy.linalg.solve_triangular(lower, forces, lower=True)
        for forces in (sparse.hstack(pairs).tocsr()[sector.upper].toarray(), pulls)
    )
    basis = scipy.linalg.orth(contact)
    patterns, sizes, _ = np.linalg.svd(pulls - basis @ (basis.T @ pulls), full_matrices=False)
    kept = np.hstack([basis, patterns[:, sizes > OPENED]])
    return scipy.linalg.solve_triangular(lower.T, kept)


def _of_sectors(
    fields: Iterable[tuple[int, np.ndarray]], columns: int, sector: Sector, comm: MPI.Comm
) -> np.ndarray:
    """Return the real fields (N, n_dofs, columns) of all sectors of those of the nodal diameters
    0 .. N/2, of which each rank has some (collective).

    It is an inverse Fourier transform, by a product of matrices: a sum over all nodal diameters,
    whose second half is the conjugate of the first. The largest of a basis.
    """
    angles = np.outer(np.arange(sector.count), sector.diameters) * (2.0 * np.pi / sector.count)
    waves = sector.shares * np.array([np.cos(angles), -np.sin(angles)])  # (2, N, N/2 + 1)
    parts = np.zeros((2, len(sector.shares), sector.structure.n_dofs, columns))
    for diameter, field in fields:
        parts[:, diameter] = field.real, field.imag
    comm.Allreduce(MPI.IN_PLACE, parts)
    return np.tensordot(waves, parts, ((0, 2), (0, 1)))


def _of_all_ranks(found: dict[int, Any], comm: MPI.Comm) -> dict[int, Any]:
    """What all ranks have found of their nodal diameters (collective)."""
    if comm.size == 1:
        return found
    return {n: values for part in comm.allgather(found) for n, values in part.items()}


PATTERN = 0.5
"""Least size of a pattern of forces on a side, relative to the largest one."""


def _side_forces(sector: Sector, modes: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Patterns of forces of modes, their frequencies and shapes, on the right side of a sector,
    orthonormal: (n_dofs, p)."""
    right = sector.dofs[sector.sides[1]].ravel()
    right = right[right >= 0]
    parts = []
    for omega, shapes in modes:
        force = (sector.stiffness @ shapes - sector.mass @ shapes * omega**2)[right]
        scaled = force / np.maximum(omega, 1e-300) ** 2
        parts += [scaled.real, scaled.imag]
    patterns, sizes, _ = np.linalg.svd(np.hstack(parts), full_matrices=False)
    kept = patterns[:, sizes > PATTERN * sizes[0]]
    found = np.zeros((sector.structure.n_dofs, kept.shape[1]))
    found[right] = kept
    return found
