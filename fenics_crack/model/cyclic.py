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

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.model.body import Body
from fenics_crack.model.factor import Factor, distribute_rows, local_rows
from fenics_crack.model.modes import (
    MULTIPLE_FREQUENCY_TOLERANCE,
    NEGLIGIBLE,
    solve_modes_with_factor,
)
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import to_complex


def excited_diameter(order: int, sectors: int) -> int:
    """The nodal diameter that an engine order excites: min(E mod N, N - E mod N)."""
    rest = order % sectors
    return min(rest, sectors - rest)


class SectorNumbering:
    """What belongs to a sector with a bonded crack, and to the whole wheel, of its dofs or nodes.

    Attributes
    ----------
    own : (n_own,) int
        Those that belong to a sector: all but those of the right side and of the upper face.
    place : (n,) int
        Of each the place, among its own ones, of that which moves as it does, in this sector or the
        next one.
    after : (n,) bool
        True on the right side, which is the next sector's.
    upper : (n_upper,) int
        Those of the upper face.
    """

    def __init__(self, of_nodes: np.ndarray, sides: np.ndarray, lips: np.ndarray) -> None:
        """Of what each node has, (n_nodes, k), -1 for nothing."""
        same = np.arange(of_nodes.max() + 1)
        for first, other in (sides, lips):
            free = of_nodes[other] >= 0
            same[of_nodes[other][free]] = of_nodes[first][free]
        self.own_items, self.item_positions = np.unique(same, return_inverse=True)
        right, upper = of_nodes[sides[1]], of_nodes[lips[1]].ravel()
        self.is_next_sector, self.upper_items = (
            np.isin(np.arange(len(same)), right),
            upper[upper >= 0],
        )

    def in_wheel(self, count: int, cracked: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Numbers in a wheel of so many sectors, at some places with an open crack: (N, n); and of
        each number the place, among all N n, of what belongs to its sector: (n_wheel,)."""
        every = np.arange(count * len(self.item_positions)).reshape(count, -1)
        numbers = self.item_positions + (
            np.arange(count)[:, None] + self.is_next_sector
        ) % count * len(self.own_items)
        opened = np.ix_(cracked, self.upper_items)
        own, others = every[:, self.own_items].ravel(), every[opened]
        numbers[opened] = len(own) + np.arange(others.size).reshape(others.shape)
        return numbers, np.concatenate([own, others.ravel()])


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
    bases : dict
        Of wheels of it, which all patterns of mistuning share (``Wheel.basis``).
    """

    structure: Structure
    count: int
    center: np.ndarray
    turn: np.ndarray
    sides: np.ndarray
    lips: np.ndarray
    stiffness_at_rest: Any
    bases: dict[tuple[Any, ...], CyclicBasis] = field(default_factory=dict, init=False)

    @cached_property
    def dofs(self) -> SectorNumbering:
        """Its dofs."""
        nodes = self.structure.nodes
        assert nodes is not None
        return SectorNumbering(nodes.dofs, self.sides, self.lips)

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

    def rotation_matrix(self, times: int) -> np.ndarray:
        """Q^times: (d, d)."""
        return np.asarray(np.linalg.matrix_power(self.turn, times % self.count))

    def place_points(self, points: np.ndarray, times: int) -> np.ndarray:
        """Points (n, d) of the first sector where they are in another one [m]."""
        return np.asarray((points - self.center) @ self.rotation_matrix(times).T + self.center)

    @cached_property
    def stiffness(self) -> sparse.csr_matrix:
        """K."""
        return local_rows(self.structure.stiffness)

    @cached_property
    def mass(self) -> sparse.csr_matrix:
        """M."""
        return local_rows(self.structure.mass)

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

    @contextmanager
    def factor_stiffness(self) -> Iterator[NodalDiameter]:
        """Nodal diameter 0, and by it all others, of the stiffness, factored once."""
        dofs, count = self.dofs, len(self.dofs.own_items)
        both = selection_matrix(dofs.item_positions + count * dofs.is_next_sector, 2 * count)
        whole = sparse.csr_matrix(both.T @ self.stiffness @ both)
        side = np.unique(dofs.item_positions[dofs.is_next_sector])
        inside, right = np.setdiff1d(np.arange(count), side), count + side
        to_left, to_right = (whole[inside][:, one] for one in (side, right))
        held = distribute_rows(whole[inside][:, inside], MPI.COMM_SELF)
        with Factor(held, definite=True) as factor:
            by_left, by_right = (factor.solve(to.T).T for to in (to_left, to_right))
            own = whole[side][:, side] + whole[right][:, right]
            yield NodalDiameter(
                self, factor, both, inside, side, (to_left, to_right),
                own - to_left.T @ by_left - to_right.T @ by_right,
                whole[side][:, right] - to_left.T @ by_right, 1.0,
            )  # fmt: skip
        held.destroy()


def selection_matrix(columns: np.ndarray, count: int) -> sparse.csr_matrix:
    """The matrix (n, count) whose rows have one entry each, 1."""
    every = np.arange(len(columns) + 1)
    return sparse.csr_matrix((np.ones(len(columns)), columns, every), (len(columns), count))


@dataclass(frozen=True, eq=False)
class NodalDiameter:
    """A nodal diameter of a wheel with bonded cracks.

    The inside of the sector is eliminated, once for all of them: what is left is a dense matrix of
    one side,

        S_n = P + e^(it) R + e^(-it) R^T.

    Attributes
    ----------
    sector : Sector
        The sector.
    factor : Factor
        Of the stiffness of the inside K_ii.
    both : (n_dofs, 2 n_own)
        The dofs from a sector's own and the next one's.
    inside, side : (n_inside,), (n_side,) int
        Places of the dofs inside and on the left side in those of the sector's own.
    coupling : pair of (n_inside, n_side)
        K_il of the left and of the right side.
    own, across : (n_side, n_side)
        P and R.
    turn : complex
        e^(it) = e^(i 2 pi n / N).
    """

    sector: Sector
    factor: Factor
    dof_selection: sparse.csr_matrix
    inside_rows: np.ndarray
    side_rows: np.ndarray
    coupling: tuple[sparse.csr_matrix, sparse.csr_matrix]
    side_stiffness: np.ndarray
    cross_stiffness: np.ndarray
    phase_factor: complex

    null_pivots = 0

    def at_diameter(self, diameter: int) -> NodalDiameter:
        """Another nodal diameter."""
        turn = np.exp(2j * np.pi * diameter / self.sector.count)
        single = self.sector.is_single(diameter)
        return replace(self, phase_factor=float(round(turn.real)) if single else complex(turn))

    @cached_property
    def ties(self) -> sparse.csr_matrix:
        """T_n: (n_dofs, n_own)."""
        count = self.dof_selection.shape[1] // 2
        return sparse.csr_matrix(
            self.dof_selection[:, :count] + self.phase_factor * self.dof_selection[:, count:]
        )

    @cached_property
    def inverse(self) -> np.ndarray:
        """S_n^-1: (n_side, n_side)."""
        across = np.asarray(self.phase_factor * self.cross_stiffness)
        return np.linalg.inv(np.asarray(self.side_stiffness) + across + across.conj().T)

    @cached_property
    def phased_coupling(self) -> sparse.csr_matrix:
        """K_il of this nodal diameter: (n_inside, n_side)."""
        return sparse.csr_matrix(self.coupling[0] + self.phase_factor * self.coupling[1])

    def solve_inside(self, forces: np.ndarray) -> np.ndarray:
        """K_ii^-1 f_i of real or complex columns (n_inside, m): the same shape."""
        if not forces.any():
            return forces
        if not np.iscomplexobj(forces):
            return self.factor.solve(np.ascontiguousarray(forces).T).T
        parts = self.factor.solve(np.hstack([forces.real, forces.imag]).T).T
        real, imaginary = np.split(parts, 2, axis=1)
        return real + 1j * imaginary

    def sector_displacement(
        self, left: np.ndarray, right: np.ndarray, within: Any = 0.0
    ) -> np.ndarray:
        """Displacements (n_dofs, m) of a sector whose sides move, and whose inside would move
        by itself."""
        found = np.zeros((self.dof_selection.shape[1], left.shape[1]))
        found[self.side_rows], found[len(found) // 2 + self.side_rows] = left, right
        to_left, to_right = self.coupling
        found[self.inside_rows] = within - self.solve_inside(to_left @ left + to_right @ right)
        return np.asarray(self.dof_selection @ found)

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """K_n^-1 f of forces on the sector's own dofs (n_own, m): the same shape."""
        within, coupling = self.solve_inside(forces[self.inside_rows]), self.phased_coupling
        on_side = forces[self.side_rows] - coupling.conj().T @ within
        found = np.empty(forces.shape, dtype=np.result_type(forces, self.inverse))
        found[self.side_rows] = moved = self.inverse @ on_side
        found[self.inside_rows] = within - self.solve_inside(coupling @ moved)
        return found

    def apply(self, right: Any, solution: Any) -> None:
        """K_n^-1 of a vector of PETSc's in real form, as :meth:`Factor.apply`."""
        rows = right.array_r.reshape(2 if self.phase_factor.imag else 1, -1)
        force = rows[0] + 1j * rows[1] if self.phase_factor.imag else rows[0]
        found = self.solve(force[:, None])[:, 0]
        solution.array_w[:] = np.concatenate([found.real, found.imag][: len(rows)])

    def modes(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (count,) [rad/s], and shapes of a sector (n_dofs, count) with v^H M v = 1."""
        sector, ties = self.sector, self.ties

        def in_real_form(matrix: sparse.csr_matrix) -> Any:
            a = ties.conj().T @ matrix @ ties
            real = (
                sparse.bmat([[a.real, -a.imag], [a.imag, a.real]]) if self.phase_factor.imag else a
            )
            return distribute_rows(real, MPI.COMM_SELF)

        mass, stiffness = map(in_real_form, (sector.mass, sector.stiffness))
        size = mass.size[0]
        gap = sparse.csr_matrix((size, 0))
        structure = Structure(Body(mass, stiffness, gap, np.zeros((1, size)), np.zeros(0)))
        found = solve_modes_with_factor(
            self, structure, 2 * count if self.phase_factor.imag else count
        )
        for used in (mass, stiffness):  # PETSc would keep those of all nodal diameters
            used.destroy()
        shapes = found.shapes
        if self.phase_factor.imag:  # each pair of real modes is one complex one, twice over
            shapes = shapes[: size // 2] + 1j * shapes[size // 2 :]
        omega, shapes = sector.ritz(ties @ shapes)
        return omega[:count], shapes[:, :count]

    def static_response(self, forces: np.ndarray) -> np.ndarray:
        """T_n K_n^-1 T_n^H f of forces (n_dofs, m) on a sector: the same shape."""
        return np.asarray(self.ties @ self.solve(np.asarray(self.ties.conj().T @ forces)))


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
    cracked : tuple of int
        Places of the sectors with a crack.
    """

    modes: CyclicModes
    opening_responses: np.ndarray
    openings: np.ndarray
    cracked_places: tuple[int, ...]

    @property
    def squares(self) -> np.ndarray:
        """omega^2 of the modes of the wheel, as they come first in :meth:`columns`."""
        single = self.modes.sector.is_single
        both = [np.tile(w, 1 if single(n) else 2) for n, w in enumerate(self.modes.omega)]
        return np.concatenate(both) ** 2

    def columns(self, place: Any, rows: Any = slice(None)) -> np.ndarray:
        """Displacements of a sector, by its place from 0, in all motions: those of the modes, the
        opening of the crack of each cracked sector; (n_dofs, n), or of a row of each of several."""
        sector, parts = self.modes.sector, []
        for diameter, shapes in enumerate(self.modes.shapes):
            angle = np.asarray(2.0 * np.pi * diameter / sector.count * place)[..., None]
            turned = np.exp(1j * angle) * np.sqrt(sector.shares[diameter]) * shapes[rows]
            parts += [turned.real] if sector.is_single(diameter) else [turned.real, turned.imag]
        for one in self.cracked_places:
            here = np.asarray(place == one)[..., None] * self.openings[rows]
            parts.append(self.opening_responses[(place - one) % sector.count, rows] + here)
        return np.hstack(parts)

    def _products(self, matrix: sparse.csr_matrix, columns: slice) -> Iterator[np.ndarray]:
        """U_j^T A U_j of each sector, or some columns of it."""
        modes = replace(self.modes, shapes=tuple(matrix @ v for v in self.modes.shapes))
        opened, opening = (
            np.array([matrix @ one for one in self.opening_responses]),
            matrix @ self.openings,
        )
        moved = CyclicBasis(modes, opened, opening, self.cracked_places)
        for place in range(self.modes.sector.count):
            yield self.columns(place).T @ moved.columns(place)[:, columns]

    @cached_property
    def tuned_matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """U^T M U and U^T K U without mistuning: (n, n) each. The modes are those of both; K of
        openings of cracks is what holds the upper faces."""
        sector, cracks = self.modes.sector, slice(len(self.squares), None)
        coupled = sum(self._products(sector.mass, cracks))
        mass, stiffness = np.eye(len(coupled)), np.zeros((len(coupled),) * 2)
        mass[:, cracks], mass[cracks] = coupled, coupled.T
        stiffness[: cracks.start, : cracks.start] = np.diag(self.squares)
        pulled = (sector.stiffness @ self.openings).T
        if self.cracked_places:
            held = [pulled @ self.columns(place)[:, cracks] for place in self.cracked_places]
            stiffness[cracks, cracks] = np.vstack(held)
        return 0.5 * (mass + mass.T), 0.5 * (stiffness + stiffness.T)

    @cached_property
    def sector_stiffnesses(self) -> np.ndarray:
        """U_j^T K U_j of each sector, K its stiffness at rest: (N, n, n)."""
        matrix = local_rows(self.modes.sector.stiffness_at_rest)
        return np.array([0.5 * (part + part.T) for part in self._products(matrix, slice(None))])


def solve_cyclic_modes(sector: Sector, families: int, comm: MPI.Comm) -> CyclicModes:
    """The lowest modes of each nodal diameter, which ranks share (collective)."""
    families, found = min(families, len(sector.dofs.own_items)), {}
    with sector.factor_stiffness() as inside:
        for diameter in sector.diameters[comm.rank :: comm.size]:
            found[diameter] = inside.at_diameter(diameter).modes(families)
    omegas, shapes = zip(*_gather_diameters(found, comm).values(), strict=True)
    return CyclicModes(omegas, shapes, sector)


def cyclic_basis(
    sector: Sector, families: int, order: int, cracked: tuple[int, ...], comm: MPI.Comm
) -> CyclicBasis:
    """The basis of so many families for the loads of an engine order; ranks share nodal diameters
    (collective).

    It has the static answers, too, to the loads, and to what mistuning and cracks leave at the
    sides: forces (K - w^2 M) v of a sector on its right side, of which a few patterns hold those of
    all modes. They are added to each nodal diameter, as if they were modes.

    A crack opens as forces of its pairs, and those that its bonds bear, open it: with the stiffness
    of all displacements of its face, which what is on the sides gives. These are real, sector by
    sector, and what is inside follows from them.
    """
    families = min(families, len(sector.dofs.own_items))
    loads, pulled = _diameter_loads(sector, order), -sector.stiffness[:, sector.dofs.upper_items]
    # The modes of a few nodal diameters have the patterns of all.
    first = list(dict.fromkeys((0, sector.count // 4, sector.count // 2)))
    mine = [*first, *(n for n in sector.diameters if n not in first)][comm.rank :: comm.size]
    found: dict[int, tuple[Any, ...]] = {}
    with sector.factor_stiffness() as still:
        ahead = {n: still.at_diameter(n).modes(families) for n in mine if n in first}
        known = _gather_diameters(ahead, comm)
        forces = _side_forces(sector, [known[n] for n in first])
        whole = sparse.csr_matrix(still.dof_selection.T @ pulled)
        places = still.inside_rows, still.side_rows, len(sector.dofs.own_items) + still.side_rows
        inner, *outer = (whole[there].toarray() for there in places)
        within = still.solve_inside(inner)
        work = inner.T @ within
        del inner, whole
        left, right = (f - to.T @ within for f, to in zip(outer, still.coupling, strict=True))
        for diameter in mine:
            one, force = still.at_diameter(diameter), loads[diameter]
            _, shapes = ahead.get(diameter) or one.modes(families)
            answers = one.static_response(force)
            both = np.hstack([one.static_response(forces), answers])
            rest = both - shapes @ (shapes.conj().T @ (sector.mass @ both))
            sizes, whole = (np.sqrt(np.sum(np.abs(x) ** 2, axis=0)) for x in (rest, both))
            rest = rest[:, kept := sizes > MULTIPLE_FREQUENCY_TOLERANCE * whole] / sizes[kept]
            omega, shapes = sector.ritz(np.hstack([shapes, sector.ritz(rest)[1]]))
            pulls = _bond_forces(sector, omega, shapes, force, answers)
            moved = one.inverse @ (left + np.conj(one.phase_factor) * right)
            found[diameter] = omega, shapes, pulls, moved
        omegas, every, pulls, moved = zip(*_gather_diameters(found, comm).values(), strict=True)
        sides = scipy.fft.irfft(moved, sector.count, axis=0)
        work += left.T @ sides[0] + right.T @ sides[1]
        opening = _opening_shapes(sector, np.hstack(pulls), work) if cracked else work[:, :0]
        sides, within = sides @ opening, within @ opening
        opened = np.zeros((sector.count, sector.structure.n_dofs, opening.shape[1]))
        for place in range(comm.rank, sector.count, comm.size):
            ends = sides[place], sides[(place + 1) % sector.count]
            opened[place] = still.sector_displacement(*ends, within if place == 0 else 0.0)
        comm.Allreduce(MPI.IN_PLACE, opened)
    modes = CyclicModes(omegas, every, sector)
    moved = selection_matrix(sector.dofs.upper_items, sector.structure.n_dofs).T @ opening
    return CyclicBasis(modes, opened, moved, cracked)


def _diameter_loads(sector: Sector, order: int) -> list[np.ndarray]:
    """Complex forces (n_dofs, m) of each nodal diameter on sector 0, whose answers turn with the
    sectors as modes do: those of the load's harmonics, f - i g."""
    found: list[list[np.ndarray]] = [[] for _ in sector.diameters]
    for harmonic, force in enumerate(to_complex(sector.structure.force)):
        diameter = excited_diameter(harmonic * order, sector.count)
        force = force if diameter == harmonic * order % sector.count else force.conj()
        parts = [force.real, force.imag] if sector.is_single(diameter) else [force]
        found[diameter] += [part for part in parts if np.any(part)]
    return [np.array(forces).reshape(-1, sector.structure.n_dofs).T for forces in found]


def _bond_forces(
    sector: Sector, omega: np.ndarray, shapes: np.ndarray, force: np.ndarray, answers: np.ndarray
) -> np.ndarray:
    """Real forces (n_upper, m) on the upper face that bonds bear: of modes (K - w^2 M) v / w, of
    loads K x - f of unit work. In the compliance S^-1 of an opening their squares are what opening
    the crack changes of w^2, or of a load's work, relative to it."""
    parts = [(sector.stiffness @ shapes - (sector.mass @ shapes) * omega**2) / omega]
    work = np.sum(force.conj() * answers, axis=0).real
    parts.append((sector.stiffness @ answers - force) / np.sqrt(work))
    found = np.hstack(parts)[sector.dofs.upper_items]
    return np.hstack([found.real, found.imag])


MIN_OPENING_PATTERN = 1e-5
"""Least size of a pattern of forces of bonds that is kept: its square is what opening the crack by
it changes of w^2, or of the work of a load, relative to these. Smaller ones change less than the
mass of what moves with the faces, which static patterns leave out: up to 6e-9 of frequencies."""


def _opening_shapes(sector: Sector, pulls: np.ndarray, work: np.ndarray) -> np.ndarray:
    """Displacements of the upper face (n_upper, m) of unit energy, without coupling: what forces of
    contact pairs, and those that bonds bear, open the crack by."""
    structure, upper = sector.structure, sector.dofs.upper_items
    pairs = [structure.gap] + ([] if structure.tangential is None else [structure.tangential])
    held = sector.stiffness[upper][:, upper].toarray() - work
    lower = scipy.linalg.cholesky(0.5 * (held + held.T), lower=True)
    contact, pulls = (
        scipy.linalg.solve_triangular(lower, forces, lower=True)
        for forces in (sparse.hstack(pairs).tocsr()[upper].toarray(), pulls)
    )
    basis = scipy.linalg.orth(contact)
    patterns, sizes, _ = np.linalg.svd(pulls - basis @ (basis.T @ pulls), full_matrices=False)
    kept = np.hstack([basis, patterns[:, sizes > MIN_OPENING_PATTERN]])
    return scipy.linalg.solve_triangular(lower.T, kept)


def _gather_diameters(found: dict[int, Any], comm: MPI.Comm) -> dict[int, Any]:
    """What all ranks have found of their nodal diameters, in their order (collective)."""
    parts = comm.allgather(found) if comm.size > 1 else [found]
    return dict(sorted(item for part in parts for item in part.items()))


MIN_SIDE_PATTERN = 0.5
"""Least size of a pattern of forces on a side, relative to the largest one."""


def _side_forces(sector: Sector, modes: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Patterns of forces of modes, their frequencies and shapes, on the right side of a sector,
    orthonormal: (n_dofs, p)."""
    parts, right = [], sector.dofs.is_next_sector
    for omega, shapes in modes:
        force = (sector.stiffness @ shapes - sector.mass @ shapes * omega**2)[right]
        scaled = force / np.maximum(omega, 1e-300) ** 2
        parts += [scaled.real, scaled.imag]
    patterns, sizes, _ = np.linalg.svd(np.hstack(parts), full_matrices=False)
    kept = patterns[:, sizes > MIN_SIDE_PATTERN * sizes[0]]
    found = np.zeros((sector.structure.n_dofs, kept.shape[1]))
    found[right] = kept
    return found
