"""Solve a wheel with equal sectors from a single sector (cyclic symmetry).

Frames turn with the sectors, so all sectors have the same K and M. Let u_j be the displacement of
sector j = 0 .. N - 1, and m_j the part that belongs to this sector alone:

    u_j = T_0 m_j + T_1 m_(j+1)

The right side belongs to the next sector: T_1 gives its nodes the motion of the next left side. T_0
bonds the crack faces. Each row of T_0 + T_1 has a single 1. For nodal diameter n, m_(j+1) =
e^(i 2 pi n / N) m_j, so

    T_n = T_0 + e^(i 2 pi n / N) T_1,      K_n = T_n^H K T_n,      M_n = T_n^H M T_n,
    K_n v = w^2 M_n v,                     n = 0 .. N/2

PETSc has real numbers here. The real form [[Re, -Im], [Im, Re]] replaces each matrix, and has every
frequency twice. For a load f on sector 0 alone, the response is a sum over all nodal diameters,

    u_j = 1/N sum_n e^(i 2 pi n j / N) T_n K_n^-1 T_n^H f,      n = 0 .. N - 1

The second half is the conjugate of the first half.

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
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.model.body import Body
from fenics_crack.model.factor import Factor, local_rows, make_matrix_from_local_rows
from fenics_crack.model.modes import (
    MULTIPLE_FREQUENCY_TOLERANCE,
    STIFFNESS_SOLUTION_ROUNDING,
    solve_modes_with_factor,
)
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import to_complex


def excited_diameter(engine_order: int, n_sectors: int) -> int:
    """Return the nodal diameter excited by an engine order.

    The diameter is min(E mod N, N - E mod N) for the order E and N sectors.
    """
    remainder = engine_order % n_sectors
    return min(remainder, n_sectors - remainder)


class SectorNumbering:
    """Number a sector's dofs or nodes; dofs or nodes with equal motions share a number.

    Either dofs or nodes are numbered; each is called a member here. The sector has n members.
    Members on the right side move as members on the left side of the next sector. The crack is
    bonded: members on the upper crack face move as members on the lower face. Used to keep each
    motion once in the wheel's equations.

    Attributes
    ----------
    own_members : (n_own,) int
        Members outside the right side and the upper crack face.
    member_positions : (n,) int
        For each member, the position in ``own_members`` of the member with the same motion. For
        members on the right side, the member with the same motion is in the next sector.
    belongs_to_next_sector : (n,) bool
        True for members on the right side.
    upper_crack_face_members : (n_upper,) int
        Members on the upper crack face.
    """

    def __init__(
        self, node_members: np.ndarray, side_nodes: np.ndarray, crack_face_nodes: np.ndarray
    ) -> None:
        """Number a sector's dofs or nodes, called members here.

        Members on the right side share the number of the matching member on the left side. Members
        on the upper crack face share the number of the matching member on the lower face.

        Parameters
        ----------
        node_members : (n_nodes, k) int
            For dofs: the k dofs of each node, -1 for a clamped dof. For nodes: the node's own
            index, with k = 1.
        side_nodes : (2, m) int
            Nodes on the left side, and matching nodes on the right side.
        crack_face_nodes : (2, p) int
            Nodes on the lower crack face, and matching nodes on the upper face.
        """
        representative_members = np.arange(node_members.max() + 1)
        for kept_nodes, merged_nodes in (side_nodes, crack_face_nodes):
            kept_members, merged_members = node_members[kept_nodes], node_members[merged_nodes]
            has_member = merged_members >= 0
            representative_members[merged_members[has_member]] = kept_members[has_member]
        self.own_members, self.member_positions = np.unique(
            representative_members, return_inverse=True
        )
        right_members = node_members[side_nodes[1]]
        upper_crack_face_members = node_members[crack_face_nodes[1]].ravel()
        self.belongs_to_next_sector = np.isin(np.arange(len(representative_members)), right_members)
        self.upper_crack_face_members = upper_crack_face_members[upper_crack_face_members >= 0]

    def number_wheel_members(
        self, n_sectors: int, cracked_sectors: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Number the dofs or nodes of a wheel with N sectors and open cracks.

        A sector has n members: all dofs or all nodes. Members with equal motions share a number in
        the wheel. On an open crack, each member on the upper face has a separate number.

        Parameters
        ----------
        n_sectors : int
            N, the number of sectors.
        cracked_sectors : sequence of int
            Sectors with an open crack, from 0; in all further sectors the crack is bonded.

        Returns
        -------
        (N, n) int
            For each sector and each member in the sector, the number in the wheel.
        (n_wheel,) int
            For each number in the wheel, a single member with this number: sector times n, plus the
            member's position in the sector.
        """
        all_members = np.arange(n_sectors * len(self.member_positions)).reshape(n_sectors, -1)
        owner_sectors = (np.arange(n_sectors)[:, None] + self.belongs_to_next_sector) % n_sectors
        wheel_numbers = self.member_positions + owner_sectors * len(self.own_members)
        open_crack_member_index = np.ix_(cracked_sectors, self.upper_crack_face_members)
        bonded_wheel_members = all_members[:, self.own_members].ravel()
        open_crack_members = all_members[open_crack_member_index]
        wheel_numbers[open_crack_member_index] = len(bonded_wheel_members) + np.arange(
            open_crack_members.size
        ).reshape(open_crack_members.shape)
        return wheel_numbers, np.concatenate([bonded_wheel_members, open_crack_members.ravel()])


@dataclass(frozen=True, eq=False)
class Sector:
    """A bladed disk's sector with free sides and an open crack.

    Points and vectors are in the sector's own frame, with d = 2 or 3 components.

    Attributes
    ----------
    structure : Structure
        Matrices, gaps and load of the sector, on this rank alone. Displacements on the right side
        are in the next sector's frame.
    n_sectors : int
        N, the number of sectors.
    center : (d,) [m]
        A point on the axis.
    one_sector_rotation : (d, d)
        Q, which turns the left side to the right side, and each sector to the next.
    side_nodes : (2, m) int
        Nodes on the left side, and matching nodes on the right side.
    crack_face_nodes : (2, p) int
        Nodes on the lower crack face, and matching nodes on the upper face, without the tip.
    stiffness_at_rest : PETSc.Mat
        Stiffness without rotation [N/m]; mistuning delta_j multiplies this matrix by 1 + delta_j.
    bases_by_key : dict
        Bases computed so far, shared by wheels with other mistuning (:meth:`Wheel.basis`).
    """

    structure: Structure
    n_sectors: int
    center: np.ndarray
    one_sector_rotation: np.ndarray
    side_nodes: np.ndarray
    crack_face_nodes: np.ndarray
    stiffness_at_rest: Any
    bases_by_key: dict[tuple[Any, ...], CyclicBasis] = field(default_factory=dict, init=False)

    @cached_property
    def dof_numbering(self) -> SectorNumbering:
        """Numbering for the sector's dofs."""
        nodes = self.structure.nodes
        assert nodes is not None
        return SectorNumbering(nodes.dofs, self.side_nodes, self.crack_face_nodes)

    @property
    def nodal_diameter_range(self) -> range:
        """The nodal diameters 0 .. N/2."""
        return range(self.n_sectors // 2 + 1)

    @property
    def shares_of_single_sector_load(self) -> np.ndarray:
        """Fraction of a load on sector 0 for each nodal diameter: (N/2 + 1,).

        A load on sector 0 alone is the sum over N equal waves around the wheel, each with the
        fraction 1/N. A nodal diameter n has two waves, n and -n, and so the fraction 2/N. The nodal
        diameters 0 and N/2 have a single wave, and the fraction 1/N.
        """
        multiplicities = [
            1.0 if self.has_single_wave(n) else 2.0 for n in self.nodal_diameter_range
        ]
        return np.array(multiplicities) / self.n_sectors

    def has_single_wave(self, diameter: int) -> bool:
        """Return True for a nodal diameter without an opposite wave, 0 and N/2."""
        return 2 * diameter % self.n_sectors == 0

    def rotation_matrix(self, n_sector_steps: int) -> np.ndarray:
        """Return the rotation by a number of sectors: Q^n_sector_steps, (d, d)."""
        return np.asarray(
            np.linalg.matrix_power(self.one_sector_rotation, n_sector_steps % self.n_sectors)
        )

    def turn_points(self, points: np.ndarray, n_sector_steps: int) -> np.ndarray:
        """Turn points (n, d) [m] on the first sector by ``n_sector_steps`` sectors."""
        return np.asarray(
            (points - self.center) @ self.rotation_matrix(n_sector_steps).T + self.center
        )

    @cached_property
    def stiffness(self) -> sparse.csr_matrix:
        """Stiffness matrix K of the sector with free sides: (n_dofs, n_dofs) [N/m]."""
        return local_rows(self.structure.stiffness)

    @cached_property
    def mass(self) -> sparse.csr_matrix:
        """Mass matrix M of the sector with free sides: (n_dofs, n_dofs) [kg]."""
        return local_rows(self.structure.mass)

    def solve_ritz_modes(self, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve for modes within the space spanned by given shapes (Rayleigh-Ritz).

        Parameters
        ----------
        shapes : (n_dofs, m)
            Shapes for a single nodal diameter, possibly linearly dependent.

        Returns
        -------
        (k,) [rad/s]
            Frequencies, ascending.
        (n_dofs, k)
            Mode shapes v with v^H M v = 1, for the sector's mass M. For different shapes v and u,
            v^H M u and v^H K u are 0, with the stiffness K.
        """
        squared_norms, eigenvectors = np.linalg.eigh(shapes.conj().T @ (self.mass @ shapes))
        is_kept = squared_norms > STIFFNESS_SOLUTION_ROUNDING * squared_norms[-1]
        shapes = shapes @ (eigenvectors[:, is_kept] / np.sqrt(squared_norms[is_kept]))
        squared_omegas, eigenvectors = scipy.linalg.eigh(
            shapes.conj().T @ (self.stiffness @ shapes), shapes.conj().T @ (self.mass @ shapes)
        )
        return np.sqrt(np.maximum(squared_omegas, 0.0)), shapes @ eigenvectors

    @contextmanager
    def yield_zero_diameter_solver(self) -> Iterator[NodalDiameterSolver]:
        """Factorise the stiffness inside the sector, and yield a solver (context manager).

        The solver is for nodal diameter 0; :meth:`NodalDiameterSolver.solver_at_diameter` makes
        further solvers with the same factors. The factors are freed when the context ends.
        """
        dof_numbering, n_independent_dofs = self.dof_numbering, len(self.dof_numbering.own_members)
        own_and_next_tie_matrices = make_selection_matrix(
            dof_numbering.member_positions
            + n_independent_dofs * dof_numbering.belongs_to_next_sector,
            2 * n_independent_dofs,
        )
        tied_stiffness = sparse.csr_matrix(
            own_and_next_tie_matrices.T @ self.stiffness @ own_and_next_tie_matrices
        )
        left_side_rows = np.unique(
            dof_numbering.member_positions[dof_numbering.belongs_to_next_sector]
        )
        inside_rows = np.setdiff1d(np.arange(n_independent_dofs), left_side_rows)
        right_rows = n_independent_dofs + left_side_rows
        inside_left_stiffness, inside_right_stiffness = (
            tied_stiffness[inside_rows][:, side_columns]
            for side_columns in (left_side_rows, right_rows)
        )
        inside_stiffness = make_matrix_from_local_rows(
            tied_stiffness[inside_rows][:, inside_rows], MPI.COMM_SELF
        )
        with Factor(inside_stiffness, definite=True) as factorised_inside_stiffness:
            inside_response_to_left_side, inside_response_to_right_side = (
                factorised_inside_stiffness.solve(inside_side_coupling.T).T
                for inside_side_coupling in (inside_left_stiffness, inside_right_stiffness)
            )
            condensed_side_stiffness = (
                tied_stiffness[left_side_rows][:, left_side_rows]
                + tied_stiffness[right_rows][:, right_rows]
                - inside_left_stiffness.T @ inside_response_to_left_side
                - inside_right_stiffness.T @ inside_response_to_right_side
            )  # fmt: skip
            left_right_stiffness = (
                tied_stiffness[left_side_rows][:, right_rows]
                - inside_left_stiffness.T @ inside_response_to_right_side
            )
            yield NodalDiameterSolver(
                self, factorised_inside_stiffness, own_and_next_tie_matrices, inside_rows,
                left_side_rows,
                (inside_left_stiffness, inside_right_stiffness), condensed_side_stiffness,
                left_right_stiffness, 1.0,
            )  # fmt: skip
        inside_stiffness.destroy()


def make_selection_matrix(columns: np.ndarray, n_columns: int) -> sparse.csr_matrix:
    """Return a sparse matrix with a single 1 in each row.

    Row i has the 1 in column ``columns[i]``; shape (n, n_columns) for n ``columns``.
    """
    row_starts = np.arange(len(columns) + 1)
    return sparse.csr_matrix(
        (np.ones(len(columns)), columns, row_starts), (len(columns), n_columns)
    )


@dataclass(frozen=True, eq=False)
class NodalDiameterSolver:
    """Solver of K_n x = f for a single nodal diameter n.

    x are a sector's displacements, f the forces, and K_n is the stiffness with tied sides. A tied
    right side moves as the left side times e^(it), with t = 2 pi n / N. The wheel has N sectors, is
    tuned, and has bonded cracks. The dofs inside the sector (index i) are eliminated once for all
    nodal diameters. A dense stiffness S_n for the left side (index l) remains:

        S_n = P + e^(it) R + e^(-it) R^T

    P is the condensed stiffness within the left and within the right side. R is the condensed
    stiffness between left and right side.

    Attributes
    ----------
    sector : Sector
        The wheel's sector.
    factorised_inside_stiffness : Factor
        Factor of the inside's stiffness K_ii.
    own_and_next_tie_matrices : (n_dofs, 2 n_own)
        [T_0, T_1], side by side. The displacement of sector j is T_0 m_j + T_1 m_(j+1), with the
        own dofs m_j of this sector and m_(j+1) of the next sector.
    inside_rows, left_side_rows : (n_inside,), (n_side,) int
        Positions among the sector's own dofs: inside, and on the left side.
    inside_left_and_right_stiffness : pair of (n_inside, n_side)
        Stiffness [N/m] between inside and left side, then between inside and right side.
    condensed_side_stiffness, left_right_stiffness : (n_side, n_side) [N/m]
        P and R.
    phase_factor : complex
        e^(it).
    """

    sector: Sector
    factorised_inside_stiffness: Factor
    own_and_next_tie_matrices: sparse.csr_matrix
    inside_rows: np.ndarray
    left_side_rows: np.ndarray
    inside_left_and_right_stiffness: tuple[sparse.csr_matrix, sparse.csr_matrix]
    condensed_side_stiffness: np.ndarray
    left_right_stiffness: np.ndarray
    phase_factor: complex

    n_null_pivots = 0

    def solver_at_diameter(self, diameter: int) -> NodalDiameterSolver:
        """Return the solver for another nodal diameter, with the same factors."""
        phase_factor = np.exp(2j * np.pi * diameter / self.sector.n_sectors)
        is_single_wave = self.sector.has_single_wave(diameter)
        return replace(
            self,
            phase_factor=float(round(phase_factor.real))
            if is_single_wave
            else complex(phase_factor),
        )

    @cached_property
    def tie_matrix(self) -> sparse.csr_matrix:
        """Tie matrix T_n = T_0 + e^(i 2 pi n / N) T_1: (n_dofs, n_own).

        T_n gives all dofs of a sector from the own dofs, in a wave with nodal diameter n. Own dofs
        are all except on the right side and the upper crack face.
        """
        n_independent_dofs = self.own_and_next_tie_matrices.shape[1] // 2
        return sparse.csr_matrix(
            self.own_and_next_tie_matrices[:, :n_independent_dofs]
            + self.phase_factor * self.own_and_next_tie_matrices[:, n_independent_dofs:]
        )

    @cached_property
    def side_stiffness_inverse(self) -> np.ndarray:
        """Inverse S_n^-1 of the left side's stiffness: (n_side, n_side) [m/N]."""
        cross_term = np.asarray(self.phase_factor * self.left_right_stiffness)
        return np.linalg.inv(
            np.asarray(self.condensed_side_stiffness) + cross_term + cross_term.conj().T
        )

    @cached_property
    def inside_side_stiffness(self) -> sparse.csr_matrix:
        """Stiffness K_il [N/m] between inside and left side: (n_inside, n_side).

        The right side moves as the left side times the phase factor. So K_il has two parts: the
        stiffness to the left side, and the phase factor times the stiffness to the right side.
        """
        return sparse.csr_matrix(
            self.inside_left_and_right_stiffness[0]
            + self.phase_factor * self.inside_left_and_right_stiffness[1]
        )

    def solve_inside(self, forces: np.ndarray) -> np.ndarray:
        """Return the displacement K_ii^-1 f_i [m] inside the sector with fixed sides.

        K_ii is the stiffness of the dofs inside the sector. ``forces`` f_i (n_inside, m) [N] are m
        loads on the inside dofs, real or complex. The result has the same shape.
        """
        if not forces.any():
            return forces
        if not np.iscomplexobj(forces):
            return self.factorised_inside_stiffness.solve(np.ascontiguousarray(forces).T).T
        real_and_imaginary_columns = self.factorised_inside_stiffness.solve(
            np.hstack([forces.real, forces.imag]).T
        ).T
        real_part, imaginary_part = np.split(real_and_imaginary_columns, 2, axis=1)
        return real_part + 1j * imaginary_part

    def sector_displacement(
        self,
        left_displacement: np.ndarray,
        right_displacement: np.ndarray,
        inside_motion: Any = 0.0,
    ) -> np.ndarray:
        """Return a sector's static displacement for given displacements of both sides.

        Parameters
        ----------
        left_displacement, right_displacement : (n_side, m) [m]
            Side displacements.
        inside_motion : (n_inside, m) [m]
            Displacement inside with fixed sides, by forces inside; default: 0.

        Returns
        -------
        (n_dofs, m) [m]
            Displacement of all the sector's dofs.
        """
        displacement = np.zeros(
            (self.own_and_next_tie_matrices.shape[1], left_displacement.shape[1])
        )
        displacement[self.left_side_rows] = left_displacement
        displacement[len(displacement) // 2 + self.left_side_rows] = right_displacement
        inside_left_stiffness, inside_right_stiffness = self.inside_left_and_right_stiffness
        displacement[self.inside_rows] = inside_motion - self.solve_inside(
            inside_left_stiffness @ left_displacement + inside_right_stiffness @ right_displacement
        )
        return np.asarray(self.own_and_next_tie_matrices @ displacement)

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Return the response K_n^-1 f [m] to forces f on the sector's own dofs.

        Own dofs are all except on the right side and the upper crack face. K_n is the sector's
        stiffness with tied sides for the nodal diameter n. ``forces`` (n_own, m) [N] are real or
        complex; the response has the same shape.
        """
        inside_motion = self.solve_inside(forces[self.inside_rows])
        inside_side_stiffness = self.inside_side_stiffness
        side_force = forces[self.left_side_rows] - inside_side_stiffness.conj().T @ inside_motion
        displacement = np.empty(
            forces.shape, dtype=np.result_type(forces, self.side_stiffness_inverse)
        )
        displacement[self.left_side_rows] = side_motion = self.side_stiffness_inverse @ side_force
        displacement[self.inside_rows] = inside_motion - self.solve_inside(
            inside_side_stiffness @ side_motion
        )
        return displacement

    def apply(self, rhs: Any, solution: Any) -> None:
        """Write K_n^-1 ``rhs`` to ``solution``, both PETSc vectors.

        K_n is the sector's stiffness for the nodal diameter n. A complex vector is stored as real
        part, then imaginary part. This replaces :meth:`Factor.apply` in eigenvalue
        solvers.
        """
        force_parts = rhs.array_r.reshape(2 if self.phase_factor.imag else 1, -1)
        complex_force = (
            force_parts[0] + 1j * force_parts[1] if self.phase_factor.imag else force_parts[0]
        )
        displacement = self.solve(complex_force[:, None])[:, 0]
        solution.array_w[:] = np.concatenate(
            [displacement.real, displacement.imag][: len(force_parts)]
        )

    def solve_modes(self, n_modes: int) -> tuple[np.ndarray, np.ndarray]:
        """Solve for the lowest modes of this nodal diameter.

        Returns
        -------
        (n_modes,) [rad/s]
            Natural frequencies, ascending.
        (n_dofs, n_modes)
            Mode shapes v over a sector's dofs, with v^H M v = 1 for the sector's mass M.
        """
        sector, tie_matrix = self.sector, self.tie_matrix

        def make_real_form(matrix: sparse.csr_matrix) -> Any:
            tied_matrix = tie_matrix.conj().T @ matrix @ tie_matrix
            real_form = (
                sparse.bmat(
                    [[tied_matrix.real, -tied_matrix.imag], [tied_matrix.imag, tied_matrix.real]]
                )
                if self.phase_factor.imag
                else tied_matrix
            )
            return make_matrix_from_local_rows(real_form, MPI.COMM_SELF)

        mass, stiffness = map(make_real_form, (sector.mass, sector.stiffness))
        n_rows = mass.size[0]
        empty_gap = sparse.csr_matrix((n_rows, 0))
        tied_real_structure = Structure(
            Body(mass, stiffness, empty_gap, np.zeros((1, n_rows)), np.zeros(0))
        )
        real_modes = solve_modes_with_factor(
            self, tied_real_structure, 2 * n_modes if self.phase_factor.imag else n_modes
        )
        for petsc_matrix in (mass, stiffness):  # PETSc would keep all nodal diameters' matrices
            petsc_matrix.destroy()
        shapes = real_modes.shapes
        if self.phase_factor.imag:  # each pair of real modes is one complex mode, twice
            shapes = shapes[: n_rows // 2] + 1j * shapes[n_rows // 2 :]
        omega, shapes = sector.solve_ritz_modes(tie_matrix @ shapes)
        return omega[:n_modes], shapes[:, :n_modes]

    def static_response(self, forces: np.ndarray) -> np.ndarray:
        """Return a sector's static displacement under a wave of forces around the wheel.

        The wave has this nodal diameter n. ``forces`` f (n_dofs, m) [N] act on all dofs of sector
        0, for m loads. The result [m], T_n K_n^-1 T_n^H f, has the same shape, with the stiffness
        K_n with tied sides and :attr:`tie_matrix` T_n.
        """
        return np.asarray(
            self.tie_matrix @ self.solve(np.asarray(self.tie_matrix.conj().T @ forces))
        )


@dataclass(frozen=True, eq=False)
class CyclicModes:
    """Natural modes of a wheel with equal sectors and bonded cracks, by nodal diameter.

    In a mode with nodal diameter n, sector j, from 0, moves as the real and imaginary parts of
    v e^(i 2 pi n j / N). Both modes have the same frequency; n = 0 and N/2 have a single mode.

    Attributes
    ----------
    omega : tuple of (families,) [rad/s]
        Natural frequencies for n = 0 .. N/2.
    shapes : tuple of (n_dofs, families)
        v for each nodal diameter over a sector's dofs, real or complex, with v^H M v = 1.
    sector : Sector
        The wheel's sector.
    """

    omega: tuple[np.ndarray, ...]
    shapes: tuple[np.ndarray, ...]
    sector: Sector


@dataclass(frozen=True, eq=False)
class CyclicBasis:
    """Basis U of motions for reducing a wheel with cracks and mistuning.

    A column of U is a motion of the whole wheel. The first columns are modes with bonded cracks.
    The last columns, the openings, open the cracks.

    Attributes
    ----------
    cyclic_modes : CyclicModes
        Lowest modes of each nodal diameter, together with static responses to the load and to
        forces on sides.
    wheel_displacements_by_openings : (N, n_dofs, m)
        Static displacements of all sectors while the crack in sector 0 is open, for m opening
        shapes. In sector 0, ``crack_opening_shapes`` are not included.
    crack_opening_shapes : (n_dofs, m)
        Displacements of the upper crack face relative to the lower face; 0 outside the upper face.
    cracked_sectors : tuple of int
        Sectors with a crack, from 0.
    """

    cyclic_modes: CyclicModes
    wheel_displacements_by_openings: np.ndarray
    crack_opening_shapes: np.ndarray
    cracked_sectors: tuple[int, ...]

    @property
    def squared_omegas(self) -> np.ndarray:
        """Squared natural frequencies [rad^2/s^2] of the modes, the first motions of the basis.

        Both modes of a pair have an entry.
        """
        has_single_wave = self.cyclic_modes.sector.has_single_wave
        omegas_of_diameters = [
            np.tile(omegas, 1 if has_single_wave(n) else 2)
            for n, omegas in enumerate(self.cyclic_modes.omega)
        ]
        return np.concatenate(omegas_of_diameters) ** 2

    def sector_motions(self, sector_index: Any, rows: Any = slice(None)) -> np.ndarray:
        """Return a sector's displacement in each motion of the basis.

        The columns are the motions: modes first, then each crack's openings.

        Parameters
        ----------
        sector_index : int or (k,) int
            Sector, from 0; or a sector for each row in ``rows``.
        rows : slice or (k,) int
            Rows among the sector's dofs; default: all.

        Returns
        -------
        (n_dofs, n) or (k, n)
            Displacements of all dofs, or of ``rows``, in n motions.
        """
        sector, motion_blocks = self.cyclic_modes.sector, []
        for diameter, shapes in enumerate(self.cyclic_modes.shapes):
            wave_angle = np.asarray(2.0 * np.pi * diameter / sector.n_sectors * sector_index)[
                ..., None
            ]
            complex_motion = (
                np.exp(1j * wave_angle)
                * np.sqrt(sector.shares_of_single_sector_load[diameter])
                * shapes[rows]
            )
            motion_blocks += (
                [complex_motion.real]
                if sector.has_single_wave(diameter)
                else [complex_motion.real, complex_motion.imag]
            )
        for cracked_sector_index in self.cracked_sectors:
            own_opening = (
                np.asarray(sector_index == cracked_sector_index)[..., None]
                * self.crack_opening_shapes[rows]
            )
            n_sectors_ahead = (sector_index - cracked_sector_index) % sector.n_sectors
            motion_blocks.append(
                self.wheel_displacements_by_openings[n_sectors_ahead, rows] + own_opening
            )
        return np.hstack(motion_blocks)

    def _yield_projection_of_each_sector(
        self, matrix: sparse.csr_matrix, column_range: slice
    ) -> Iterator[np.ndarray]:
        """Yield the projection U_j^T A U_j for each sector j.

        U_j (n_dofs, n) has the sector's displacement in each of n motions of the basis. ``matrix``
        is A (n_dofs, n_dofs), the stiffness or mass over a sector's dofs. ``column_range`` selects
        the k columns to compute. Yields N matrices (n, k).
        """
        matrix_times_modes = replace(
            self.cyclic_modes, shapes=tuple(matrix @ shapes for shapes in self.cyclic_modes.shapes)
        )
        matrix_times_responses = np.array(
            [
                matrix @ displacements_of_sector
                for displacements_of_sector in self.wheel_displacements_by_openings
            ]
        )
        matrix_times_openings = matrix @ self.crack_opening_shapes
        matrix_times_basis = CyclicBasis(
            matrix_times_modes, matrix_times_responses, matrix_times_openings, self.cracked_sectors
        )
        for sector_index in range(self.cyclic_modes.sector.n_sectors):
            yield (
                self.sector_motions(sector_index).T
                @ matrix_times_basis.sector_motions(sector_index)[:, column_range]
            )

    @cached_property
    def tuned_mass_and_stiffness(self) -> tuple[np.ndarray, np.ndarray]:
        """Mass U^T M U, then stiffness U^T K U, of the wheel without mistuning: (n, n) each.

        U are the basis' n motions. Both matrices are diagonal for the modes. The stiffness
        for the openings follows from the bond forces on the upper crack faces.
        """
        sector, opening_columns = self.cyclic_modes.sector, slice(len(self.squared_omegas), None)
        mass_columns = sum(self._yield_projection_of_each_sector(sector.mass, opening_columns))
        mass, stiffness = np.eye(len(mass_columns)), np.zeros((len(mass_columns),) * 2)
        mass[:, opening_columns], mass[opening_columns] = mass_columns, mass_columns.T
        stiffness[: opening_columns.start, : opening_columns.start] = np.diag(self.squared_omegas)
        bond_forces = (sector.stiffness @ self.crack_opening_shapes).T
        if self.cracked_sectors:
            opening_stiffness = [
                bond_forces @ self.sector_motions(sector_index)[:, opening_columns]
                for sector_index in self.cracked_sectors
            ]
            stiffness[opening_columns, opening_columns] = np.vstack(opening_stiffness)
        return 0.5 * (mass + mass.T), 0.5 * (stiffness + stiffness.T)

    @cached_property
    def sector_stiffnesses(self) -> np.ndarray:
        """Each sector's stiffness without rotation, for the basis' n motions: (N, n, n).

        The matrix for sector j is U_j^T K U_j, with the sector's displacements U_j in the motions.
        The stiffness of a mistuned wheel is the tuned stiffness, plus each matrix times the
        sector's relative stiffness deviation.
        """
        stiffness_at_rest = local_rows(self.cyclic_modes.sector.stiffness_at_rest)
        return np.array(
            [
                0.5 * (sector_stiffness + sector_stiffness.T)
                for sector_stiffness in self._yield_projection_of_each_sector(
                    stiffness_at_rest, slice(None)
                )
            ]
        )


def solve_cyclic_modes(sector: Sector, families: int, comm: MPI.Comm) -> CyclicModes:
    """Find the ``families`` lowest modes for each nodal diameter (collective).

    The wheel is tuned, with bonded cracks. The ranks share the nodal diameters.
    """
    families, modes_by_diameter = min(families, len(sector.dof_numbering.own_members)), {}
    with sector.yield_zero_diameter_solver() as zero_diameter_solver:
        for diameter in sector.nodal_diameter_range[comm.rank :: comm.size]:
            modes_by_diameter[diameter] = zero_diameter_solver.solver_at_diameter(
                diameter
            ).solve_modes(families)
    omegas_of_diameters, shapes_of_diameters = zip(
        *_gather_results_by_diameter(modes_by_diameter, comm).values(), strict=True
    )
    return CyclicModes(omegas_of_diameters, shapes_of_diameters, sector)


def make_cyclic_basis(
    sector: Sector,
    families: int,
    engine_order: int,
    cracked_sectors: tuple[int, ...],
    comm: MPI.Comm,
) -> CyclicBasis:
    """Make a basis for a wheel with cracks under an engine order's load (collective).

    Used to reduce the mistuned wheel. The ranks share the nodal diameters. For each nodal diameter
    the basis has modes v with frequency w, and static responses to the load and to forces on the
    right side. The forces on the right side represent forces between sectors. In a mode, a free
    sector with stiffness K and mass M transmits the force (K - w^2 M) v to the next sector.
    Mistuning and cracks change this force. A few force patterns, from the modes of up to three
    nodal diameters, approximate all changes.

    For each crack the basis has openings: static motions of the wheel with separating crack faces.
    Openings are responses to contact forces and to bond forces. Bond forces hold a closed crack
    together, in the modes and under the load.

    Parameters
    ----------
    sector : Sector
        The wheel's sector.
    families : int
        Number of modes for each nodal diameter.
    engine_order : int
        The load's engine order.
    cracked_sectors : tuple of int
        Sectors with a crack, from 0.
    comm : MPI.Comm
        Communicator, whose ranks share the work.
    """
    families = min(families, len(sector.dof_numbering.own_members))
    loads_of_diameters, n_dofs = _make_diameter_loads(sector, engine_order), sector.structure.n_dofs
    # The modes of these nodal diameters give the side-force patterns for all nodal diameters.
    side_pattern_diameters = list(dict.fromkeys((0, sector.n_sectors // 4, sector.n_sectors // 2)))
    remaining_diameters = [
        n for n in sector.nodal_diameter_range if n not in side_pattern_diameters
    ]
    own_diameters = [*side_pattern_diameters, *remaining_diameters][comm.rank :: comm.size]
    results_by_diameter: dict[int, tuple[Any, ...]] = {}
    with sector.yield_zero_diameter_solver() as zero_diameter_solver:
        own_side_pattern_diameters = [n for n in own_diameters if n in side_pattern_diameters]
        own_modes_by_diameter = {
            n: zero_diameter_solver.solver_at_diameter(n).solve_modes(families)
            for n in own_side_pattern_diameters
        }
        modes_by_diameter = _gather_results_by_diameter(own_modes_by_diameter, comm)
        side_force_patterns = _find_side_force_patterns(
            sector, [modes_by_diameter[n] for n in side_pattern_diameters]
        )
        bond_force_columns = -sector.stiffness[:, sector.dof_numbering.upper_crack_face_members]
        bond_forces_on_own_dofs = sparse.csr_matrix(
            zero_diameter_solver.own_and_next_tie_matrices.T @ bond_force_columns
        )
        left_rows = zero_diameter_solver.left_side_rows
        right_rows = len(sector.dof_numbering.own_members) + left_rows
        inside_bond_forces = bond_forces_on_own_dofs[zero_diameter_solver.inside_rows].toarray()
        side_bond_forces = (
            bond_forces_on_own_dofs[left_rows].toarray(),
            bond_forces_on_own_dofs[right_rows].toarray(),
        )
        inside_motions_by_bond_forces = zero_diameter_solver.solve_inside(inside_bond_forces)
        face_stiffness_decrease = inside_bond_forces.T @ inside_motions_by_bond_forces
        del inside_bond_forces, bond_forces_on_own_dofs
        left_forces, right_forces = (
            condensed_side_forces - inside_side_coupling.T @ inside_motions_by_bond_forces
            for condensed_side_forces, inside_side_coupling in zip(
                side_bond_forces, zero_diameter_solver.inside_left_and_right_stiffness, strict=True
            )
        )
        for diameter in own_diameters:
            diameter_solver = zero_diameter_solver.solver_at_diameter(diameter)
            _, shapes = own_modes_by_diameter.get(diameter) or diameter_solver.solve_modes(families)
            omega_shapes_and_bond_forces = _make_diameter_basis(
                diameter_solver, shapes, loads_of_diameters[diameter], side_force_patterns
            )
            condensed_side_forces = (
                left_forces + np.conj(diameter_solver.phase_factor) * right_forces
            )
            side_motion_wave = diameter_solver.side_stiffness_inverse @ condensed_side_forces
            results_by_diameter[diameter] = *omega_shapes_and_bond_forces, side_motion_wave
        results_of_diameters = _gather_results_by_diameter(results_by_diameter, comm).values()
        omega_arrays, shape_matrices, bond_forces, side_motion_waves = zip(
            *results_of_diameters, strict=True
        )
        side_motions_by_sector = np.fft.irfft(side_motion_waves, sector.n_sectors, axis=0)
        face_stiffness_decrease += (
            left_forces.T @ side_motions_by_sector[0] + right_forces.T @ side_motions_by_sector[1]
        )
        upper_face_opening_shapes = face_stiffness_decrease[:, :0]
        if cracked_sectors:
            upper_face_opening_shapes = _find_opening_shapes(
                sector, np.hstack(bond_forces), face_stiffness_decrease
            )
        side_motions_by_sector, inside_motions_by_bond_forces = (
            side_motions_by_sector @ upper_face_opening_shapes,
            inside_motions_by_bond_forces @ upper_face_opening_shapes,
        )
        opening_responses = np.zeros((sector.n_sectors, n_dofs, upper_face_opening_shapes.shape[1]))
        for sector_index in range(comm.rank, sector.n_sectors, comm.size):
            right_motions = side_motions_by_sector[(sector_index + 1) % sector.n_sectors]
            inside_motion = inside_motions_by_bond_forces if sector_index == 0 else 0.0
            opening_responses[sector_index] = zero_diameter_solver.sector_displacement(
                side_motions_by_sector[sector_index], right_motions, inside_motion
            )
        comm.Allreduce(MPI.IN_PLACE, opening_responses)
    cyclic_modes = CyclicModes(omega_arrays, shape_matrices, sector)
    opening_shapes = (
        make_selection_matrix(sector.dof_numbering.upper_crack_face_members, n_dofs).T
        @ upper_face_opening_shapes
    )
    return CyclicBasis(cyclic_modes, opening_responses, opening_shapes, cracked_sectors)


def _make_diameter_basis(
    diameter_solver: NodalDiameterSolver,
    shapes: np.ndarray,
    load: np.ndarray,
    side_force_patterns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add static responses to the modes of a nodal diameter, as further Ritz modes.

    If a response is a combination of the modes, except for rounding, the response is left out. All
    kept shapes are then combined to new modes (Rayleigh-Ritz).

    Parameters
    ----------
    diameter_solver : NodalDiameterSolver
        Solver for the nodal diameter.
    shapes : (n_dofs, families)
        Shapes of the modes.
    load, side_force_patterns : (n_dofs, m), (n_dofs, p) [N]
        Loads on a sector, and force patterns on the right side, as columns.

    Returns
    -------
    omega : (n,) [rad/s]
        Frequencies of the new modes, ascending.
    shapes : (n_dofs, n)
        Shapes of the new modes.
    bond_forces : (n_upper, k) [(N/m)^(1/2)]
        Bond forces on the upper crack face, holding the closed crack together. Real, and scaled as
        in :func:`_compute_crack_bond_forces`.
    """
    sector = diameter_solver.sector
    load_response = diameter_solver.static_response(load)
    static_responses = np.hstack(
        [diameter_solver.static_response(side_force_patterns), load_response]
    )
    new_motions = static_responses - shapes @ (shapes.conj().T @ (sector.mass @ static_responses))
    new_norms, static_response_norms = (
        np.sqrt(np.sum(np.abs(motions) ** 2, axis=0)) for motions in (new_motions, static_responses)
    )
    is_kept = new_norms > MULTIPLE_FREQUENCY_TOLERANCE * static_response_norms
    new_motions = new_motions[:, is_kept] / new_norms[is_kept]
    omega, shapes = sector.solve_ritz_modes(
        np.hstack([shapes, sector.solve_ritz_modes(new_motions)[1]])
    )
    return omega, shapes, _compute_crack_bond_forces(sector, omega, shapes, load, load_response)


def _make_diameter_loads(sector: Sector, engine_order: int) -> list[np.ndarray]:
    """Split the load on sector 0 into complex loads for each nodal diameter.

    With an engine order E, harmonic k of the load has the order k E, and excites a single nodal
    diameter. If the wave runs backwards, the load is conjugated. For the nodal diameters 0 and N/2,
    real and imaginary part are separate loads.

    Returns
    -------
    list of (n_dofs, m) [N]
        For each nodal diameter from 0 to N/2, m loads as columns; m = 0 without a load.
    """
    load_parts_of_diameters: list[list[np.ndarray]] = [[] for _ in sector.nodal_diameter_range]
    for harmonic, complex_force in enumerate(to_complex(sector.structure.force)):
        diameter = excited_diameter(harmonic * engine_order, sector.n_sectors)
        complex_force = (
            complex_force
            if diameter == harmonic * engine_order % sector.n_sectors
            else complex_force.conj()
        )
        force_parts = (
            [complex_force.real, complex_force.imag]
            if sector.has_single_wave(diameter)
            else [complex_force]
        )
        load_parts_of_diameters[diameter] += [
            force_part for force_part in force_parts if np.any(force_part)
        ]
    return [
        np.array(load_parts).reshape(-1, sector.structure.n_dofs).T
        for load_parts in load_parts_of_diameters
    ]


def _compute_crack_bond_forces(
    sector: Sector,
    omega: np.ndarray,
    shapes: np.ndarray,
    load: np.ndarray,
    load_response: np.ndarray,
) -> np.ndarray:
    """Return scaled bond forces on the upper face of a closed crack.

    Bond forces hold a bonded crack together. K and M are the free sector's stiffness and mass. In a
    mode v with frequency w the forces are (K - w^2 M) v, divided here by w. Under a load f with
    static response x the forces are K x - f, divided here by sqrt(f^H x). f^H x is the load's work.

    The scale shows the effect of an opening crack. Let b be a scaled bond force, and C the
    compliance of the crack's opening. If the bond force is released, w^2 falls by the fraction b^H
    C b, to first order. For a load, the work grows by this fraction.

    Parameters
    ----------
    sector : Sector
        The wheel's sector.
    omega, shapes : (m,) [rad/s], (n_dofs, m)
        Frequencies and shapes of m modes.
    load, load_response : (n_dofs, p) [N], [m]
        p loads, and the static responses.

    Returns
    -------
    (n_upper, 2 (m + p)) [(N/m)^(1/2)]
        Real parts for all modes, then for all loads; then imaginary parts in the same order.
    """
    mode_forces = (sector.stiffness @ shapes - (sector.mass @ shapes) * omega**2) / omega
    load_works = np.sum(load.conj() * load_response, axis=0).real
    load_forces = (sector.stiffness @ load_response - load) / np.sqrt(load_works)
    bond_forces = np.hstack([mode_forces, load_forces])[
        sector.dof_numbering.upper_crack_face_members
    ]
    return np.hstack([bond_forces.real, bond_forces.imag])


MIN_BOND_FORCE_PATTERN_SIZE = 1e-5
"""Minimum size [-] of a kept bond-force pattern.

The squared size is the pattern's relative change of w^2 or the load's work, if the crack opens.
Smaller patterns matter less than the neglected mass at the faces, up to 6e-9 in frequencies.
"""


def _find_opening_shapes(
    sector: Sector, bond_forces: np.ndarray, face_stiffness_decrease: np.ndarray
) -> np.ndarray:
    """Find m displacements of the upper crack face for opening the crack.

    The displacements are responses to contact forces and to bond forces. Bond forces hold a closed
    crack together. All bond forces are split into orthogonal patterns. Patterns smaller than
    ``MIN_BOND_FORCE_PATTERN_SIZE`` are left out.

    Parameters
    ----------
    sector : Sector
        The wheel's sector.
    bond_forces : (n_upper, k) [(N/m)^(1/2)]
        Forces scaled as in :func:`_compute_crack_bond_forces`.
    face_stiffness_decrease : (n_upper, n_upper) [N/m]
        Decrease of the upper face's stiffness because the rest of the wheel gives way.

    Returns
    -------
    (n_upper, m)
        Displacements D as columns, with D^T K D = 1. K is the upper face's stiffness in the wheel.
    """
    structure, upper_crack_face_members = (
        sector.structure,
        sector.dof_numbering.upper_crack_face_members,
    )
    normal_and_tangential_gap_matrices = [structure.gap] + (
        [] if structure.tangential is None else [structure.tangential]
    )
    opening_stiffness = (
        sector.stiffness[upper_crack_face_members][:, upper_crack_face_members].toarray()
        - face_stiffness_decrease
    )
    stiffness_cholesky_factor = scipy.linalg.cholesky(
        0.5 * (opening_stiffness + opening_stiffness.T), lower=True
    )
    scaled_contact_forces, bond_forces = (
        scipy.linalg.solve_triangular(stiffness_cholesky_factor, face_forces, lower=True)
        for face_forces in (
            sparse.hstack(normal_and_tangential_gap_matrices)
            .tocsr()[upper_crack_face_members]
            .toarray(),
            bond_forces,
        )
    )
    contact_force_basis = scipy.linalg.orth(scaled_contact_forces)
    bond_force_patterns, pattern_sizes, _ = np.linalg.svd(
        bond_forces - contact_force_basis @ (contact_force_basis.T @ bond_forces),
        full_matrices=False,
    )
    kept_force_patterns = np.hstack(
        [contact_force_basis, bond_force_patterns[:, pattern_sizes > MIN_BOND_FORCE_PATTERN_SIZE]]
    )
    return scipy.linalg.solve_triangular(stiffness_cholesky_factor.T, kept_force_patterns)


def _gather_results_by_diameter(
    results_by_diameter: dict[int, Any], comm: MPI.Comm
) -> dict[int, Any]:
    """Gather all ranks' results by nodal diameter, ascending, on every rank (collective)."""
    results_by_rank = (
        comm.allgather(results_by_diameter) if comm.size > 1 else [results_by_diameter]
    )
    return dict(
        sorted(
            diameter_and_result
            for results_of_rank in results_by_rank
            for diameter_and_result in results_of_rank.items()
        )
    )


MIN_RELATIVE_SIDE_FORCE_PATTERN_SIZE = 0.5
"""Minimum singular value of a kept side-force pattern, relative to the largest value."""


def _find_side_force_patterns(
    sector: Sector, omega_shapes_pairs: Sequence[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Find the main patterns of the forces on a sector's right side in modes.

    Used to approximate all forces between sectors. In a mode v with frequency w, the force on the
    right side is (K - w^2 M) v, divided here by w^2. K and M are the sector's stiffness and mass.
    Patterns with less than half the largest singular value are left out.

    Parameters
    ----------
    sector : Sector
        The wheel's sector, with free sides.
    omega_shapes_pairs : sequence of (omega, shapes)
        Frequencies (m,) [rad/s] and shapes v (n_dofs, m), for a few nodal diameters.

    Returns
    -------
    (n_dofs, p)
        p orthonormal patterns as columns; zero outside the right side.
    """
    scaled_force_parts, is_on_right_side = [], sector.dof_numbering.belongs_to_next_sector
    for omega, shapes in omega_shapes_pairs:
        right_side_forces = (sector.stiffness @ shapes - sector.mass @ shapes * omega**2)[
            is_on_right_side
        ]
        scaled_force = right_side_forces / np.maximum(omega, 1e-300) ** 2
        scaled_force_parts += [scaled_force.real, scaled_force.imag]
    force_patterns, pattern_sizes, _ = np.linalg.svd(
        np.hstack(scaled_force_parts), full_matrices=False
    )
    kept_patterns = force_patterns[
        :, pattern_sizes > MIN_RELATIVE_SIDE_FORCE_PATTERN_SIZE * pattern_sizes[0]
    ]
    side_force_patterns = np.zeros((sector.structure.n_dofs, kept_patterns.shape[1]))
    side_force_patterns[is_on_right_side] = kept_patterns
    return side_force_patterns
