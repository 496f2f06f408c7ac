"""Cyclic symmetry: a wheel of equal sectors from one sector, by nodal diameters.

Frames turn with the sectors, so that all sectors have the same K and M. Let u_j be the displacement
of sector j, and m_j the part that belongs to this sector alone:

    u_j = T_0 m_j + T_1 m_(j+1)

The right side belongs to the next sector: T_1 gives its nodes the motion of the next left side. T_0
bonds the faces of the crack. Each row of T_0 + T_1 has a single 1. For nodal diameter n, m_(j+1) =
e^(i 2 pi n / N) m_j, so

    T_n = T_0 + e^(i 2 pi n / N) T_1,      K_n = T_n^H K T_n,      M_n = T_n^H M T_n,
    K_n v = w^2 M_n v,                     n = 0 .. N/2

PETSc has real numbers here. The real form [[Re, -Im], [Im, Re]] replaces each matrix, and has every
frequency twice. A load f on sector 0 alone is a sum of all nodal diameters,

    u_j = 1/N sum_n e^(i 2 pi n j / N) T_n K_n^-1 T_n^H f,      n = 0 .. N - 1

The second half of the sum is the conjugate of the first.

References
----------
Thomas, International Journal for Numerical Methods in Engineering 14, 1979, 81.
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
    """Return the nodal diameter that an engine order E excites.

    It is min(E mod N, N - E mod N).
    """
    remainder = order % sectors
    return min(remainder, sectors - remainder)


class SectorNumbering:
    """Numbers of a sector's members: dofs or nodes.

    Attributes
    ----------
    own_members : (n_own,) int
        Members of the sector alone: without right side and upper face.
    member_positions : (n,) int
        Position in ``own_members`` of the member with the same motion, here or in the next sector.
    is_next_sector : (n,) bool
        True on the right side, which belongs to the next sector.
    upper_members : (n_upper,) int
        Members on the upper crack face.
    """

    def __init__(self, node_members: np.ndarray, sides: np.ndarray, lips: np.ndarray) -> None:
        """Number the members of a sector.

        Parameters
        ----------
        node_members : (n_nodes, k) int
            Members of each node, -1 for none.
        sides : (2, m) int
            Nodes of the left and of the right side.
        lips : (2, p) int
            Nodes of the lower and of the upper crack face.
        """
        representatives = np.arange(node_members.max() + 1)
        for kept_nodes, merged_nodes in (sides, lips):
            kept_members, merged_members = node_members[kept_nodes], node_members[merged_nodes]
            has_member = merged_members >= 0
            representatives[merged_members[has_member]] = kept_members[has_member]
        self.own_members, self.member_positions = np.unique(representatives, return_inverse=True)
        right_members, upper_members = node_members[sides[1]], node_members[lips[1]].ravel()
        self.is_next_sector = np.isin(np.arange(len(representatives)), right_members)
        self.upper_members = upper_members[upper_members >= 0]

    def in_wheel(
        self, n_sectors: int, cracked_places: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Number the members of a wheel with some open cracks.

        Returns
        -------
        (N, n) int
            Number in the wheel of each sector's members.
        (n_wheel,) int
            Position of each number's owner among all N n members.
        """
        all_members = np.arange(n_sectors * len(self.member_positions)).reshape(n_sectors, -1)
        owners = (np.arange(n_sectors)[:, None] + self.is_next_sector) % n_sectors
        numbers = self.member_positions + owners * len(self.own_members)
        open_index = np.ix_(cracked_places, self.upper_members)
        owned_members = all_members[:, self.own_members].ravel()
        open_members = all_members[open_index]
        numbers[open_index] = len(owned_members) + np.arange(open_members.size).reshape(
            open_members.shape
        )
        return numbers, np.concatenate([owned_members, open_members.ravel()])


@dataclass(frozen=True, eq=False)
class Sector:
    """One sector of a wheel in its own frame, sides free and crack open.

    Attributes
    ----------
    structure : Structure
        Matrices, gaps and load of the sector, on this rank alone. Displacements of the right side
        are in the frame of the next sector.
    count : int
        N, the number of sectors.
    center : (d,) [m]
        A point of the axis.
    turn : (d, d)
        Q, which turns the left side to the right one, and so each sector to the next one.
    sides : (2, m) int
        Nodes of the left side, and of the right one in the same order.
    lips : (2, p) int
        Nodes of the lower crack face, and of the upper one, without the tip.
    stiffness_at_rest : PETSc.Mat
        The stiffness that mistuning multiplies.
    bases : dict
        Bases of wheels, which all patterns of mistuning share (``Wheel.basis``).
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
        """Numbers of the sector's dofs."""
        nodes = self.structure.nodes
        assert nodes is not None
        return SectorNumbering(nodes.dofs, self.sides, self.lips)

    @property
    def diameters(self) -> range:
        """The nodal diameters 0 .. N/2."""
        return range(self.count // 2 + 1)

    @property
    def shares(self) -> np.ndarray:
        """Shares of nodal diameters, with conjugates, in sector 0: (N/2 + 1,)."""
        multiplicities = [1.0 if self.is_single(n) else 2.0 for n in self.diameters]
        return np.array(multiplicities) / self.count

    def is_single(self, diameter: int) -> bool:
        """Return True for a nodal diameter without a second, opposite wave."""
        return 2 * diameter % self.count == 0

    def rotation_matrix(self, n_turns: int) -> np.ndarray:
        """Return Q^n_turns: (d, d)."""
        return np.asarray(np.linalg.matrix_power(self.turn, n_turns % self.count))

    def place_points(self, points: np.ndarray, n_turns: int) -> np.ndarray:
        """Move points (n, d) [m] of the first sector to another sector."""
        return np.asarray((points - self.center) @ self.rotation_matrix(n_turns).T + self.center)

    @cached_property
    def stiffness(self) -> sparse.csr_matrix:
        """K."""
        return local_rows(self.structure.stiffness)

    @cached_property
    def mass(self) -> sparse.csr_matrix:
        """M."""
        return local_rows(self.structure.mass)

    def ritz(self, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find modes in the space of some shapes.

        Parameters
        ----------
        shapes : (n_dofs, m)
            Shapes of one nodal diameter, which may depend on each other.

        Returns
        -------
        (k,) [rad/s]
            Frequencies, ascending.
        (n_dofs, k)
            Shapes with v^H M v = 1 and v^H K v diagonal.
        """
        weights, eigenvectors = np.linalg.eigh(shapes.conj().T @ (self.mass @ shapes))
        is_kept = weights > NEGLIGIBLE * weights[-1]
        shapes = shapes @ (eigenvectors[:, is_kept] / np.sqrt(weights[is_kept]))
        squares, eigenvectors = scipy.linalg.eigh(
            shapes.conj().T @ (self.stiffness @ shapes), shapes.conj().T @ (self.mass @ shapes)
        )
        return np.sqrt(np.maximum(squares, 0.0)), shapes @ eigenvectors

    @contextmanager
    def factor_stiffness(self) -> Iterator[NodalDiameter]:
        """Factor the stiffness once, for nodal diameter 0 and thus for all."""
        dofs, n_own = self.dofs, len(self.dofs.own_members)
        dof_selection = selection_matrix(
            dofs.member_positions + n_own * dofs.is_next_sector, 2 * n_own
        )
        stiffness = sparse.csr_matrix(dof_selection.T @ self.stiffness @ dof_selection)
        side_rows = np.unique(dofs.member_positions[dofs.is_next_sector])
        inside_rows, right_rows = np.setdiff1d(np.arange(n_own), side_rows), n_own + side_rows
        left_coupling, right_coupling = (
            stiffness[inside_rows][:, columns] for columns in (side_rows, right_rows)
        )
        inside_stiffness = distribute_rows(stiffness[inside_rows][:, inside_rows], MPI.COMM_SELF)
        with Factor(inside_stiffness, definite=True) as factor:
            left_response, right_response = (
                factor.solve(coupling.T).T for coupling in (left_coupling, right_coupling)
            )
            side_stiffness = (
                stiffness[side_rows][:, side_rows] + stiffness[right_rows][:, right_rows]
                - left_coupling.T @ left_response - right_coupling.T @ right_response
            )  # fmt: skip
            cross_stiffness = stiffness[side_rows][:, right_rows] - left_coupling.T @ right_response
            yield NodalDiameter(
                self, factor, dof_selection, inside_rows, side_rows,
                (left_coupling, right_coupling), side_stiffness, cross_stiffness, 1.0,
            )  # fmt: skip
        inside_stiffness.destroy()


def selection_matrix(columns: np.ndarray, n_columns: int) -> sparse.csr_matrix:
    """Return the matrix (n, n_columns) with a single 1 in each row."""
    row_starts = np.arange(len(columns) + 1)
    return sparse.csr_matrix(
        (np.ones(len(columns)), columns, row_starts), (len(columns), n_columns)
    )


@dataclass(frozen=True, eq=False)
class NodalDiameter:
    """A nodal diameter of a wheel with bonded cracks.

    The inside of the sector is eliminated once for all nodal diameters. A dense matrix of one side
    is left:

        S_n = P + e^(it) R + e^(-it) R^T,        t = 2 pi n / N

    Attributes
    ----------
    sector : Sector
        The sector.
    factor : Factor
        Factor of the inside's stiffness K_ii.
    dof_selection : (n_dofs, 2 n_own)
        [T_0, T_1].
    inside_rows, side_rows : (n_inside,), (n_side,) int
        Positions of dofs inside and on the left side among the sector's own.
    coupling : pair of (n_inside, n_side)
        K_il of the left and of the right side.
    side_stiffness, cross_stiffness : (n_side, n_side)
        P and R.
    phase_factor : complex
        e^(it).
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

    n_null_pivots = 0

    def at_diameter(self, diameter: int) -> NodalDiameter:
        """Return another nodal diameter."""
        phase_factor = np.exp(2j * np.pi * diameter / self.sector.count)
        is_single = self.sector.is_single(diameter)
        return replace(
            self,
            phase_factor=float(round(phase_factor.real)) if is_single else complex(phase_factor),
        )

    @cached_property
    def ties(self) -> sparse.csr_matrix:
        """T_n: (n_dofs, n_own)."""
        n_own = self.dof_selection.shape[1] // 2
        return sparse.csr_matrix(
            self.dof_selection[:, :n_own] + self.phase_factor * self.dof_selection[:, n_own:]
        )

    @cached_property
    def inverse(self) -> np.ndarray:
        """S_n^-1: (n_side, n_side)."""
        cross_term = np.asarray(self.phase_factor * self.cross_stiffness)
        return np.linalg.inv(np.asarray(self.side_stiffness) + cross_term + cross_term.conj().T)

    @cached_property
    def phased_coupling(self) -> sparse.csr_matrix:
        """K_il of this nodal diameter: (n_inside, n_side)."""
        return sparse.csr_matrix(self.coupling[0] + self.phase_factor * self.coupling[1])

    def solve_inside(self, forces: np.ndarray) -> np.ndarray:
        """Return K_ii^-1 f_i of real or complex forces (n_inside, m): the same shape."""
        if not forces.any():
            return forces
        if not np.iscomplexobj(forces):
            return self.factor.solve(np.ascontiguousarray(forces).T).T
        real_and_imaginary = self.factor.solve(np.hstack([forces.real, forces.imag]).T).T
        real_part, imaginary_part = np.split(real_and_imaginary, 2, axis=1)
        return real_part + 1j * imaginary_part

    def sector_displacement(
        self, left_side: np.ndarray, right_side: np.ndarray, inside_motion: Any = 0.0
    ) -> np.ndarray:
        """Return the displacement of a sector from its sides.

        Parameters
        ----------
        left_side, right_side : (n_side, m) [m]
            Displacements of the sides.
        inside_motion : (n_inside, m) [m]
            Motion of the inside with fixed sides.

        Returns
        -------
        (n_dofs, m) [m]
        """
        displacement = np.zeros((self.dof_selection.shape[1], left_side.shape[1]))
        displacement[self.side_rows] = left_side
        displacement[len(displacement) // 2 + self.side_rows] = right_side
        left_coupling, right_coupling = self.coupling
        displacement[self.inside_rows] = inside_motion - self.solve_inside(
            left_coupling @ left_side + right_coupling @ right_side
        )
        return np.asarray(self.dof_selection @ displacement)

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Return K_n^-1 f of forces on the sector's own dofs (n_own, m): the same shape."""
        inside_motion, coupling = self.solve_inside(forces[self.inside_rows]), self.phased_coupling
        side_force = forces[self.side_rows] - coupling.conj().T @ inside_motion
        displacement = np.empty(forces.shape, dtype=np.result_type(forces, self.inverse))
        displacement[self.side_rows] = side_motion = self.inverse @ side_force
        displacement[self.inside_rows] = inside_motion - self.solve_inside(coupling @ side_motion)
        return displacement

    def apply(self, rhs: Any, solution: Any) -> None:
        """Apply K_n^-1 to a PETSc vector in real form, as :meth:`Factor.apply`."""
        rows = rhs.array_r.reshape(2 if self.phase_factor.imag else 1, -1)
        force = rows[0] + 1j * rows[1] if self.phase_factor.imag else rows[0]
        displacement = self.solve(force[:, None])[:, 0]
        solution.array_w[:] = np.concatenate([displacement.real, displacement.imag][: len(rows)])

    def modes(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Find the lowest modes of this nodal diameter.

        Returns
        -------
        (count,) [rad/s]
            Frequencies.
        (n_dofs, count)
            Shapes of a sector with v^H M v = 1.
        """
        sector, ties = self.sector, self.ties

        def in_real_form(matrix: sparse.csr_matrix) -> Any:
            a = ties.conj().T @ matrix @ ties
            real_form = (
                sparse.bmat([[a.real, -a.imag], [a.imag, a.real]]) if self.phase_factor.imag else a
            )
            return distribute_rows(real_form, MPI.COMM_SELF)

        mass, stiffness = map(in_real_form, (sector.mass, sector.stiffness))
        size = mass.size[0]
        gap = sparse.csr_matrix((size, 0))
        structure = Structure(Body(mass, stiffness, gap, np.zeros((1, size)), np.zeros(0)))
        real_modes = solve_modes_with_factor(
            self, structure, 2 * count if self.phase_factor.imag else count
        )
        for petsc_matrix in (mass, stiffness):  # PETSc would keep all nodal diameters' matrices
            petsc_matrix.destroy()
        shapes = real_modes.shapes
        if self.phase_factor.imag:  # each pair of real modes is one complex one, twice over
            shapes = shapes[: size // 2] + 1j * shapes[size // 2 :]
        omega, shapes = sector.ritz(ties @ shapes)
        return omega[:count], shapes[:, :count]

    def static_response(self, forces: np.ndarray) -> np.ndarray:
        """Return T_n K_n^-1 T_n^H f of forces (n_dofs, m) on a sector: the same shape."""
        return np.asarray(self.ties @ self.solve(np.asarray(self.ties.conj().T @ forces)))


@dataclass(frozen=True, eq=False)
class CyclicModes:
    """Natural modes of a wheel of equal sectors with bonded cracks.

    In a mode of nodal diameter n, sector j, from 0, moves as the real and the imaginary part of
    v e^(i 2 pi n j / N). These are two modes with one frequency; n = 0 and N/2 have one mode.

    Attributes
    ----------
    omega : tuple of (families,) [rad/s]
        Natural frequencies of n = 0 .. N/2.
    shapes : tuple of (n_dofs, families)
        v of each nodal diameter over the dofs of a sector, real or complex, with v^H M v = 1.
    sector : Sector
        The sector.
    """

    omega: tuple[np.ndarray, ...]
    shapes: tuple[np.ndarray, ...]
    sector: Sector


@dataclass(frozen=True, eq=False)
class CyclicBasis:
    """Basis of motions for a wheel with cracks and mistuning.

    The cracks are bonded in the modes; further motions open them.

    Attributes
    ----------
    modes : CyclicModes
        Lowest modes of each nodal diameter, together with static responses to the load and to
        forces on sides.
    opening_responses : (N, n_dofs, m)
        Responses of all sectors to the ``openings`` in sector 0, without the openings themselves.
    openings : (n_dofs, m)
        Displacements of the upper crack face relative to the lower one.
    cracked_places : tuple of int
        Places of the sectors with a crack.
    """

    modes: CyclicModes
    opening_responses: np.ndarray
    openings: np.ndarray
    cracked_places: tuple[int, ...]

    @property
    def squares(self) -> np.ndarray:
        """omega^2 of the wheel's modes, the first motions in :meth:`columns`."""
        is_single = self.modes.sector.is_single
        repeated_omegas = [
            np.tile(w, 1 if is_single(n) else 2) for n, w in enumerate(self.modes.omega)
        ]
        return np.concatenate(repeated_omegas) ** 2

    def columns(self, sector_index: Any, rows: Any = slice(None)) -> np.ndarray:
        """Return the displacement of one sector in all motions.

        The modes come first, then the openings of each crack.

        Parameters
        ----------
        sector_index : int or (k,) int
            Place of the sector from 0, or one place for each row.
        rows : slice or (k,) int
            Rows of the sector's dofs.

        Returns
        -------
        (n_dofs, n) or (k, n)
        """
        sector, parts = self.modes.sector, []
        for diameter, shapes in enumerate(self.modes.shapes):
            angle = np.asarray(2.0 * np.pi * diameter / sector.count * sector_index)[..., None]
            wave = np.exp(1j * angle) * np.sqrt(sector.shares[diameter]) * shapes[rows]
            parts += [wave.real] if sector.is_single(diameter) else [wave.real, wave.imag]
        for cracked_index in self.cracked_places:
            own_opening = np.asarray(sector_index == cracked_index)[..., None] * self.openings[rows]
            distance = (sector_index - cracked_index) % sector.count
            parts.append(self.opening_responses[distance, rows] + own_opening)
        return np.hstack(parts)

    def _products(self, matrix: sparse.csr_matrix, columns: slice) -> Iterator[np.ndarray]:
        """Yield U_j^T A U_j, or some columns of it, for each sector j."""
        modes = replace(self.modes, shapes=tuple(matrix @ v for v in self.modes.shapes))
        opening_responses = np.array([matrix @ response for response in self.opening_responses])
        openings = matrix @ self.openings
        mapped_basis = CyclicBasis(modes, opening_responses, openings, self.cracked_places)
        for sector_index in range(self.modes.sector.count):
            yield self.columns(sector_index).T @ mapped_basis.columns(sector_index)[:, columns]

    @cached_property
    def tuned_matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """U^T M U and U^T K U without mistuning: (n, n) each.

        Both are diagonal for the modes. The stiffness of the openings is that of the bonds on the
        upper faces.
        """
        sector, cracks = self.modes.sector, slice(len(self.squares), None)
        mass_columns = sum(self._products(sector.mass, cracks))
        mass, stiffness = np.eye(len(mass_columns)), np.zeros((len(mass_columns),) * 2)
        mass[:, cracks], mass[cracks] = mass_columns, mass_columns.T
        stiffness[: cracks.start, : cracks.start] = np.diag(self.squares)
        bond_forces = (sector.stiffness @ self.openings).T
        if self.cracked_places:
            opening_stiffness = [
                bond_forces @ self.columns(sector_index)[:, cracks]
                for sector_index in self.cracked_places
            ]
            stiffness[cracks, cracks] = np.vstack(opening_stiffness)
        return 0.5 * (mass + mass.T), 0.5 * (stiffness + stiffness.T)

    @cached_property
    def sector_stiffnesses(self) -> np.ndarray:
        """U_j^T K U_j of each sector with its stiffness at rest: (N, n, n)."""
        matrix = local_rows(self.modes.sector.stiffness_at_rest)
        return np.array([0.5 * (part + part.T) for part in self._products(matrix, slice(None))])


def solve_cyclic_modes(sector: Sector, families: int, comm: MPI.Comm) -> CyclicModes:
    """Find the lowest modes of each nodal diameter (collective).

    The ranks share the nodal diameters.
    """
    families, modes_by_diameter = min(families, len(sector.dofs.own_members)), {}
    with sector.factor_stiffness() as tuned_sector:
        for diameter in sector.diameters[comm.rank :: comm.size]:
            modes_by_diameter[diameter] = tuned_sector.at_diameter(diameter).modes(families)
    omegas, shapes = zip(*_gather_diameters(modes_by_diameter, comm).values(), strict=True)
    return CyclicModes(omegas, shapes, sector)


def cyclic_basis(
    sector: Sector, families: int, order: int, cracked_places: tuple[int, ...], comm: MPI.Comm
) -> CyclicBasis:
    """Make a basis for the loads of an engine order (collective).

    The ranks share the nodal diameters. Each has modes, and as further modes static responses to
    the loads and to the forces (K - w^2 M) v that mistuning and cracks leave on the right side. A
    few patterns hold these forces for all modes.

    A crack opens by forces of its pairs, and by forces that its bonds bear. An opening's stiffness
    belongs to all displacements of the face, and includes the response of the sides. The openings
    are real, sector by sector, and the inside follows from the sides.

    Parameters
    ----------
    families : int
        Number of modes of each nodal diameter.
    order : int
        Engine order.
    cracked_places : tuple of int
        Places of the sectors with a crack.
    """
    families = min(families, len(sector.dofs.own_members))
    loads, n_dofs = _diameter_loads(sector, order), sector.structure.n_dofs
    # The modes of a few nodal diameters have the patterns of all.
    first_diameters = list(dict.fromkeys((0, sector.count // 4, sector.count // 2)))
    next_diameters = [n for n in sector.diameters if n not in first_diameters]
    own_diameters = [*first_diameters, *next_diameters][comm.rank :: comm.size]
    bases: dict[int, tuple[Any, ...]] = {}
    with sector.factor_stiffness() as tuned_sector:
        own_first_diameters = [n for n in own_diameters if n in first_diameters]
        first_modes = {n: tuned_sector.at_diameter(n).modes(families) for n in own_first_diameters}
        all_first_modes = _gather_diameters(first_modes, comm)
        side_forces = _side_forces(sector, [all_first_modes[n] for n in first_diameters])
        bond_columns = -sector.stiffness[:, sector.dofs.upper_members]
        sector_forces = sparse.csr_matrix(tuned_sector.dof_selection.T @ bond_columns)
        left_rows = tuned_sector.side_rows
        right_rows = len(sector.dofs.own_members) + left_rows
        inside_forces = sector_forces[tuned_sector.inside_rows].toarray()
        side_parts = sector_forces[left_rows].toarray(), sector_forces[right_rows].toarray()
        inside_motion = tuned_sector.solve_inside(inside_forces)
        work = inside_forces.T @ inside_motion
        del inside_forces, sector_forces
        left_force, right_force = (
            side_force - coupling.T @ inside_motion
            for side_force, coupling in zip(side_parts, tuned_sector.coupling, strict=True)
        )
        for diameter in own_diameters:
            nodal_diameter = tuned_sector.at_diameter(diameter)
            _, shapes = first_modes.get(diameter) or nodal_diameter.modes(families)
            basis = _diameter_basis(nodal_diameter, shapes, loads[diameter], side_forces)
            side_force = left_force + np.conj(nodal_diameter.phase_factor) * right_force
            bases[diameter] = *basis, nodal_diameter.inverse @ side_force
        diameter_bases = _gather_diameters(bases, comm).values()
        omegas, all_shapes, bond_forces, wave_motions = zip(*diameter_bases, strict=True)
        side_motions = scipy.fft.irfft(wave_motions, sector.count, axis=0)
        work += left_force.T @ side_motions[0] + right_force.T @ side_motions[1]
        face_shapes = work[:, :0]
        if cracked_places:
            face_shapes = _opening_shapes(sector, np.hstack(bond_forces), work)
        side_motions, inside_motion = side_motions @ face_shapes, inside_motion @ face_shapes
        opening_responses = np.zeros((sector.count, n_dofs, face_shapes.shape[1]))
        for place in range(comm.rank, sector.count, comm.size):
            sides = side_motions[place], side_motions[(place + 1) % sector.count]
            opening_responses[place] = tuned_sector.sector_displacement(
                *sides, inside_motion if place == 0 else 0.0
            )
        comm.Allreduce(MPI.IN_PLACE, opening_responses)
    modes = CyclicModes(omegas, all_shapes, sector)
    openings = selection_matrix(sector.dofs.upper_members, n_dofs).T @ face_shapes
    return CyclicBasis(modes, opening_responses, openings, cracked_places)


def _diameter_basis(
    nodal_diameter: NodalDiameter, shapes: np.ndarray, load: np.ndarray, side_forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add static responses to the modes of a nodal diameter.

    Parameters
    ----------
    shapes : (n_dofs, families)
        Shapes of the modes.
    load, side_forces : (n_dofs, m) [N]
        Forces on a sector.

    Returns
    -------
    omega : (n,) [rad/s]
        Frequencies of modes and static responses together.
    shapes : (n_dofs, n)
    bond_forces : (n_upper, k) [N]
        Real forces that bonds bear.
    """
    sector = nodal_diameter.sector
    load_response = nodal_diameter.static_response(load)
    responses = np.hstack([nodal_diameter.static_response(side_forces), load_response])
    new_part = responses - shapes @ (shapes.conj().T @ (sector.mass @ responses))
    new_size, size = (np.sqrt(np.sum(np.abs(x) ** 2, axis=0)) for x in (new_part, responses))
    is_kept = new_size > MULTIPLE_FREQUENCY_TOLERANCE * size
    new_part = new_part[:, is_kept] / new_size[is_kept]
    omega, shapes = sector.ritz(np.hstack([shapes, sector.ritz(new_part)[1]]))
    return omega, shapes, _bond_forces(sector, omega, shapes, load, load_response)


def _diameter_loads(sector: Sector, order: int) -> list[np.ndarray]:
    """Return the complex load on sector 0 for each nodal diameter: (n_dofs, m) each.

    The responses turn with the sectors as modes do. The load's harmonics are f - i g.
    """
    loads: list[list[np.ndarray]] = [[] for _ in sector.diameters]
    for harmonic, force in enumerate(to_complex(sector.structure.force)):
        diameter = excited_diameter(harmonic * order, sector.count)
        force = force if diameter == harmonic * order % sector.count else force.conj()
        force_vector_by_part = [force.real, force.imag] if sector.is_single(diameter) else [force]
        loads[diameter] += [part for part in force_vector_by_part if np.any(part)]
    return [np.array(forces).reshape(-1, sector.structure.n_dofs).T for forces in loads]


def _bond_forces(
    sector: Sector,
    omega: np.ndarray,
    shapes: np.ndarray,
    load: np.ndarray,
    load_response: np.ndarray,
) -> np.ndarray:
    """Return the real forces that bonds bear on the upper face: (n_upper, m).

    They are (K - w^2 M) v / w for modes, and K x - f for loads of unit work. Squared in the
    compliance of an opening, they are its relative changes of w^2 or of the work.
    """
    forces = [(sector.stiffness @ shapes - (sector.mass @ shapes) * omega**2) / omega]
    work = np.sum(load.conj() * load_response, axis=0).real
    forces.append((sector.stiffness @ load_response - load) / np.sqrt(work))
    bond_forces = np.hstack(forces)[sector.dofs.upper_members]
    return np.hstack([bond_forces.real, bond_forces.imag])


MIN_OPENING_PATTERN = 1e-5
"""Minimum size of a kept pattern of bond forces.

The square of the size is the relative change, by this opening, of w^2 or of the work. Smaller
patterns change less than the mass that moves with the faces, which static patterns neglect: up to
6e-9 of frequencies.
"""


def _opening_shapes(sector: Sector, bond_forces: np.ndarray, work: np.ndarray) -> np.ndarray:
    """Return displacements of the upper face that open the crack: (n_upper, m).

    They follow from pair forces and bond forces, have unit energy, and are not coupled.

    Parameters
    ----------
    bond_forces : (n_upper, k) [N]
    work : (n_upper, n_upper) [N/m]
        Part of the face's stiffness that the rest of the wheel relieves.
    """
    structure, upper_members = sector.structure, sector.dofs.upper_members
    gap_matrices = [structure.gap] + (
        [] if structure.tangential is None else [structure.tangential]
    )
    opening_stiffness = sector.stiffness[upper_members][:, upper_members].toarray() - work
    lower_factor = scipy.linalg.cholesky(
        0.5 * (opening_stiffness + opening_stiffness.T), lower=True
    )
    contact_patterns, bond_forces = (
        scipy.linalg.solve_triangular(lower_factor, forces, lower=True)
        for forces in (sparse.hstack(gap_matrices).tocsr()[upper_members].toarray(), bond_forces)
    )
    basis = scipy.linalg.orth(contact_patterns)
    patterns, sizes, _ = np.linalg.svd(
        bond_forces - basis @ (basis.T @ bond_forces), full_matrices=False
    )
    kept_patterns = np.hstack([basis, patterns[:, sizes > MIN_OPENING_PATTERN]])
    return scipy.linalg.solve_triangular(lower_factor.T, kept_patterns)


def _gather_diameters(own_parts: dict[int, Any], comm: MPI.Comm) -> dict[int, Any]:
    """Return the results of all ranks by nodal diameter, ascending (collective)."""
    results_by_rank = comm.allgather(own_parts) if comm.size > 1 else [own_parts]
    return dict(
        sorted(
            diameter_and_result
            for rank_results in results_by_rank
            for diameter_and_result in rank_results.items()
        )
    )


MIN_SIDE_PATTERN = 0.5
"""Minimum size of a kept pattern of side forces, relative to the largest."""


def _side_forces(sector: Sector, modes: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return orthonormal patterns of modal forces on the right side: (n_dofs, p).

    Parameters
    ----------
    modes : sequence of (omega, shapes)
        Frequencies and shapes of some nodal diameters.
    """
    force_vector_by_part, is_right = [], sector.dofs.is_next_sector
    for omega, shapes in modes:
        force = (sector.stiffness @ shapes - sector.mass @ shapes * omega**2)[is_right]
        scaled_force = force / np.maximum(omega, 1e-300) ** 2
        force_vector_by_part += [scaled_force.real, scaled_force.imag]
    patterns, sizes, _ = np.linalg.svd(np.hstack(force_vector_by_part), full_matrices=False)
    kept_patterns = patterns[:, sizes > MIN_SIDE_PATTERN * sizes[0]]
    side_forces = np.zeros((sector.structure.n_dofs, kept_patterns.shape[1]))
    side_forces[is_right] = kept_patterns
    return side_forces
