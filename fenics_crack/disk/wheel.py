"""A bladed disk of equal sectors: mistuned, some blades cracked, under an engine order.

The whole wheel has each sector's own dofs, in the sector's frame, and the dofs on the upper face of
each crack. Its matrices are copies of the sector's, and are made on request. The wheel is solved in
few coordinates:

    u = U (q, d),      M = U^T M U,      K = sum_j (1 + delta_j) U_j^T K U_j

The coordinates q belong to modes with bonded cracks and to static responses. The coordinates d
displace the upper crack faces relative to the lower ones, with the static response of the rest.
Mistuning multiplies the stiffness at rest of sector j by 1 + delta_j.

A load that stands still in space passes the blades one after the other. Sector j, from 0, is ahead
by j / N of a revolution. With an engine order E, and the k-th harmonic of order k E, the load in
the frame of the sector is

    f_j(t) = sum_k f_k cos(k w t + 2 pi k E j / N) + g_k sin(k w t + 2 pi k E j / N)

Seen from the wheel, the wave runs against the rotation.

References
----------
Craig and Bampton, AIAA Journal 6, 1968, 1313.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.progress import begin
from fenics_crack.basics.suggestions import fitting_argument
from fenics_crack.disk.cyclic import (
    CyclicBasis,
    CyclicModes,
    Sector,
    SectorNumbering,
    cyclic_basis,
    selection_matrix,
    solve_cyclic_modes,
)
from fenics_crack.model.body import DEFAULT_SETTING, Body
from fenics_crack.model.factor import distribute_rows, local_rows
from fenics_crack.model.matrices import AbsentMatrix, numbers
from fenics_crack.model.modes import solve_modes
from fenics_crack.model.nodes import Nodes, Pairs, body_property
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure, shared_property
from fenics_crack.numerics.fourier import from_complex, to_complex


@dataclass(frozen=True, eq=False, kw_only=True)
class WheelBody(Body):
    """Body of a wheel, whose matrices are made later; :class:`Wheel` explains all fields."""

    sector: Sector
    cracked_places: tuple[int, ...]
    mistuning: np.ndarray
    order: int
    families: int
    numbers: np.ndarray
    places: np.ndarray


class Wheel(Structure):
    """The whole wheel; rank 0 owns all of its rows.

    Displacements are in the frame of each blade: "x" is the first blade's x, turned with the blade.
    Nodes on a side between two sectors belong to the later sector.

    Attributes
    ----------
    sector : Sector
        One of its sectors, in the frame of the first blade.
    cracked : tuple of int
        Places of the sectors with a crack, from 0.
    mistuning : (N,)
        Relative deviation of each sector's stiffness at rest.
    order : int
        Engine order of the load.
    families : int
        Number of kept modes for each nodal diameter, and for each blade.
    numbers : (N, n_sector) int
        The wheel's dof for each dof of each sector.
    places : (n,) int
        Position of each dof's owner among all ``numbers``.
    """

    body: WheelBody
    families: int = body_property("families")
    sector: Sector = body_property("sector")
    cracked: tuple[int, ...] = body_property("cracked_places")
    mistuning: np.ndarray = body_property("mistuning")
    order: int = body_property("order")
    numbers: np.ndarray = body_property("numbers")
    places: np.ndarray = body_property("places")

    def __init__(
        self,
        sector: Sector,
        *,
        cracked: Sequence[int] = (0,),
        mistuning: Any = 0.0,
        order: int = 1,
        families: int = 3,
        rotation: Any = None,
        comm: MPI.Comm = MPI.COMM_SELF,
    ) -> None:
        fitting_argument("sector", sector, "Sector", ("Sector",))
        check_count("families", families, 1)
        structure, n_sectors = sector.structure, sector.count
        tangential = structure.tangential
        cracked = tuple(cracked) if structure.n_pairs else ()
        dofs, places = sector.dofs.in_wheel(n_sectors, cracked)
        absent_matrix = AbsentMatrix(len(places), comm.rank)
        own_rows = slice(None if comm.rank == 0 else 0)
        copies = selection_matrix(dofs.ravel(), len(places))
        crack_selection = np.eye(n_sectors)[:, list(cracked)]

        def assemble_forces(forces: np.ndarray) -> np.ndarray:
            """Assemble forces (m, N, n_sector) on all sectors to the wheel: (m, n_local)."""
            return np.asarray(forces.reshape(len(forces), -1) @ copies)[:, own_rows]

        def assemble_gap(gap: sparse.spmatrix) -> sparse.csr_matrix:
            """Assemble B of all cracks from B of one: (n_local, n_pairs)."""
            return sparse.csr_matrix(copies.T @ sparse.kron(crack_selection, gap))[own_rows]

        watched_factors = structure.watched
        if watched_factors is None:
            watched_factors = np.eye(1, structure.n_dofs, structure.find_most_loaded_dof())[0]
        watched_sector = np.eye(1, n_sectors, cracked[0] if cracked else 0)
        watched_motion = assemble_forces(watched_sector[..., None] * watched_factors)[0]
        force = assemble_forces(_sector_loads(sector, order))
        body = WheelBody(
            absent_matrix, absent_matrix, assemble_gap(structure.gap), force,
            np.tile(structure.clearance, len(cracked)), damping=structure.damping,
            tangential=None if tangential is None else assemble_gap(tangential),
            nodes=_wheel_nodes(sector, cracked, dofs, own_rows),
            pairs=_wheel_pairs(sector, cracked), watched=watched_motion, rotation=rotation,
            comm=comm,
            sector=sector, cracked_places=cracked, mistuning=_read_deviations(mistuning, n_sectors),
            order=order, families=families, numbers=dofs, places=places,
        )  # fmt: skip
        super().__init__(body)

    # --- its dofs ---------------------------------------------------------------------------------

    @property
    def n_sectors(self) -> int:
        """N."""
        return self.sector.count

    @property
    def sector_structure(self) -> Structure:
        """Structure of the sector."""
        return self.sector.structure

    @property
    def watched_sector(self) -> int:
        """Place of the first cracked sector, whose blade is watched.

        Without a crack, it is the first sector, 0.
        """
        return self.cracked[0] if self.cracked else 0

    def dof_of(self, blade: int, dof: int) -> int:
        """Return the wheel's dof for a dof of one sector.

        Parameters
        ----------
        blade : int
            Number of the sector, from 1.
        dof : int
            Dof of a sector.

        Raises
        ------
        InputError
            There is no such sector, or no such dof in a sector.
        """
        n_sectors, n_sector_dofs = self.sector.count, self.sector.structure.n_dofs
        if not 1 <= blade <= n_sectors:
            raise InputError("blade", blade, f"a whole number from 1 to {n_sectors}")
        if not 0 <= dof < n_sector_dofs:
            raise InputError("dof", dof, f"a whole number from 0 to {n_sector_dofs - 1}")
        return int(self.numbers[blade - 1, dof])

    def blade_of(self, dof: int) -> tuple[int, int]:
        """Return the sector's number, from 1, and the sector's dof for a dof of the wheel."""
        sector_index, sector_dof = divmod(int(self.places[dof]), self.sector.structure.n_dofs)
        return sector_index + 1, sector_dof

    def dofs_of_blades(self, dof: int) -> list[int]:
        """Return the dofs of all blades at the place of one dof."""
        return list(map(int, self.numbers[:, self.blade_of(dof)[1]]))

    def dof_name(self, dof: int) -> str:
        """Name a dof: "x displacement at (0.1, 0.1) m of blade 3"."""
        blade, sector_dof = self.blade_of(dof)
        return f"{self.sector.structure.dof_name(sector_dof)} of blade {blade}"

    def with_harmonics(self, harmonics: Mapping[int, tuple[Any, Any]]) -> Structure:
        """Raise InputError: the sectors have the load's harmonics, one after the other."""
        requirement = (
            "of a scene whose [[excitation.harmonics]] has them, which turn with its order"
        )
        raise InputError("structure", repr(self), requirement)

    def structure_in_few_coordinates(self) -> WheelStructure:
        """Return the wheel in the coordinates in which it is solved (collective)."""
        return WheelStructure(self, count_basis_families(self.families))

    def watched_sector_load(self, structure: Structure, rows: slice) -> np.ndarray:
        """Return load rows on the watched blade, as :meth:`Structure.watched_sector_load`."""
        own_members = ~self.sector.dofs.is_next_sector
        blade_dofs = np.unique(self.numbers[self.watched_sector, own_members])
        dofs = blade_dofs[np.any(self.force[rows, blade_dofs], axis=0)]
        blade = structure.values_at(np.eye(structure.n_dofs), dofs.tolist())
        return np.asarray(self.force[rows, dofs] @ blade.T)

    # --- its matrices -----------------------------------------------------------------------------

    @shared_property
    def mass(self) -> Any:
        """M: (n, n) [kg]; made at the first request (collective)."""
        return self._assemble_wheel(sparse.kron(np.eye(self.sector.count), self.sector.mass))

    @shared_property
    def stiffness(self) -> Any:
        """K: (n, n) [N/m]; made at the first request (collective)."""
        tuned_stiffness = sparse.kron(np.eye(self.sector.count), self.sector.stiffness)
        stiffness_at_rest = local_rows(self.sector.stiffness_at_rest)
        return self._assemble_wheel(
            tuned_stiffness + sparse.kron(np.diag(self.mistuning), stiffness_at_rest)
        )

    def _assemble_wheel(self, matrix: sparse.spmatrix) -> Any:
        """Assemble the wheel's matrix from the uncoupled sectors' (collective)."""
        copies = selection_matrix(self.numbers.ravel(), self.n_dofs)
        wheel_matrix = sparse.csr_matrix(copies.T @ matrix @ copies)
        return distribute_rows(wheel_matrix[: self.n_local], self.comm)

    @property
    def _size_description(self) -> str:
        return f"{self.sector.count} sectors, {self.n_dofs} dofs"

    def known_omega_and_shapes(self, *, is_bonded: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the modes of the few coordinates, ``families`` for each sector."""
        wheel_structure = self.structure_in_few_coordinates()
        count = min(
            self.families * self.sector.count, wheel_structure.n_dofs - wheel_structure.n_pairs
        )
        modes = solve_modes(
            wheel_structure, count, lips="tied" if is_bonded and wheel_structure.n_pairs else "open"
        )
        return modes.omega, wheel_structure.expand(modes.shapes.T).T

    def mistuned(self, deviations: Any) -> Wheel:
        """Return this wheel with other deviations of the sectors' stiffness.

        Parameters
        ----------
        deviations : float or (N,)
            One for all sectors, or one for each.

        Raises
        ------
        InputError
            There are more or fewer, or one leaves no stiffness.
        """
        return self._in_setting(
            self.setting, mistuning=_read_deviations(deviations, self.sector.count)
        )

    def basis(self, families: int) -> CyclicBasis:
        """Return the motions in which the wheel is solved (collective).

        They are found once for all patterns of mistuning.

        Parameters
        ----------
        families : int
            Number of modes of each nodal diameter.
        """
        bases, key = self.sector.bases, (families, self.order, self.cracked)
        if key not in bases:
            bases[key] = cyclic_basis(self.sector, *key, self.comm)
        return bases[key]

    def cyclic_modes(self, families: int | None = None) -> CyclicModes:
        """Find the lowest modes of each nodal diameter (collective).

        The cracks are bonded, and there is no mistuning.
        """
        n_families = self.families if families is None else families
        check_count("families", n_families, 1)
        return solve_cyclic_modes(self.sector, n_families, self.comm)


def _read_deviations(data: Any, n_sectors: int) -> np.ndarray:
    """Return one deviation per sector (N,); InputError if a value cannot be used."""
    deviations = numbers(data)
    if (
        deviations.shape not in ((), (n_sectors,))
        or not np.all(deviations > -1.0)
        or not np.all(deviations < 1e3)
    ):
        requirement = f"one number above -1, or one for each of the {n_sectors} sectors"
        raise InputError("mistuning", data, requirement)
    return np.broadcast_to(deviations, (n_sectors,)).copy()


def _sector_loads(sector: Sector, order: int) -> np.ndarray:
    """Return the load on the dofs of each sector: (2K+1, N, n_sector) [N]."""
    waves = to_complex(sector.structure.force)
    angles = np.multiply.outer(np.arange(len(waves)), np.arange(sector.count)) * order
    turns = np.exp(2j * np.pi * angles / sector.count)
    return from_complex(turns[..., None] * waves[:, None])


def _wheel_nodes(
    sector: Sector, cracked_places: tuple[int, ...], dofs: np.ndarray, own_rows: slice
) -> Nodes:
    """Return the wheel's nodes on one rank.

    Parameters
    ----------
    dofs : (N, n_sector) int
        The wheel's dof for each dof of each sector.
    """
    nodes = sector.structure.nodes
    assert nodes is not None
    count = len(nodes.points)
    node_numbers = SectorNumbering(np.arange(count)[:, None], sector.sides, sector.lips)
    numbers, places = node_numbers.in_wheel(sector.count, cracked_places)
    sector_index, node = divmod(places[own_rows], count)
    rotations = np.array([sector.rotation_matrix(n_turns) for n_turns in range(sector.count)])
    frames = rotations[sector_index]
    points = np.einsum("nij,nj->ni", frames, nodes.points[node] - sector.center) + sector.center
    node_dofs = nodes.dofs[node]
    node_dofs = np.where(node_dofs >= 0, dofs[sector_index[:, None], node_dofs], -1)
    cells = numbers[:, nodes.cells].reshape(-1, nodes.cells.shape[1])[own_rows]
    return Nodes(points, node_dofs, cells, nodes.vtk_type, frames=frames)


def _wheel_pairs(sector: Sector, cracked_places: tuple[int, ...]) -> Pairs:
    """Return the wheel's contact pairs."""
    pairs, n_cracked = sector.structure.pairs, len(cracked_places)
    if not cracked_places or pairs.points is None or pairs.cracks is None:
        return Pairs()
    assert pairs.areas is not None and pairs.positions is not None
    n_cracks, numbers = int(pairs.cracks.max(initial=-1)) + 1, np.arange(n_cracked)[:, None]
    places = {
        name + f" of blade {sector_index + 1}" * (n_cracked > 1): pair + number * len(pairs.points)
        for number, sector_index in enumerate(cracked_places)
        for name, pair in pairs.places.items()
    }
    points = np.concatenate(
        [sector.place_points(pairs.points, sector_index) for sector_index in cracked_places]
    )
    cracks = (pairs.cracks + n_cracks * numbers).ravel()
    areas, positions = (
        np.tile(per_sector, n_cracked) for per_sector in (pairs.areas, pairs.positions)
    )
    return Pairs(points, areas, cracks, positions, places)


# --- in few coordinates ---------------------------------------------------------------------------


N_REFERENCE_MODES = 16
"""Number of modes that the reference of a wheel has beyond the kept ones.

On ten wheels these have 0.53 to 0.99 of the remaining change. With eight modes they have 0.35 to
0.96; then errors of an opening, 0.7 and 0.9 %, and of the load's displacement, 1.5 %, were 1.8
times the stated ones.
"""


@dataclass(frozen=True, eq=False, kw_only=True)
class WheelCoordinates(Body):
    """Body of a wheel in few coordinates; ``ranked_modes`` are its modes in another order."""

    wheel: Wheel
    basis: CyclicBasis
    ranked_modes: tuple[np.ndarray, np.ndarray] | None = None


class WheelStructure(Structure):
    """A wheel in the coordinates (q, d) of a basis; the same on every rank.

    ``find_dof`` and ``values_at`` refer to the dofs of the whole wheel.

    Attributes
    ----------
    basis : CyclicBasis
        Motions of the whole wheel.
    """

    body: WheelCoordinates
    basis: CyclicBasis = body_property("basis")

    def __init__(self, wheel: Wheel, families: int) -> None:
        """Reduce a wheel to the motions of its basis (collective).

        Parameters
        ----------
        families : int
            Number of modes of each nodal diameter.
        """
        begin(f"modes of {len(wheel.sector.diameters)} nodal diameters")
        basis, sector, comm = wheel.basis(families), wheel.sector.structure, MPI.COMM_SELF
        begin("matrices of the wheel")
        mass, stiffness = basis.tuned_matrices
        if np.any(wheel.mistuning):
            stiffness = stiffness + np.tensordot(wheel.mistuning, basis.sector_stiffnesses, 1)
        loads = _sector_loads(wheel.sector, wheel.order)
        force = sum(
            loads[:, sector_index] @ basis.columns(sector_index)
            for sector_index in range(wheel.sector.count)
        )

        def assemble_gap(gap: sparse.spmatrix) -> sparse.csr_matrix:
            """Assemble U^T B of all cracks from B of one: (n, p)."""
            parts = [basis.columns(sector_index).T @ gap for sector_index in wheel.cracked]
            return sparse.csr_matrix(np.hstack([np.zeros((len(mass), 0)), *parts]))

        tangents = sector.tangential if wheel.cracked else None
        body = WheelCoordinates(
            distribute_rows(mass, comm), distribute_rows(stiffness, comm),
            assemble_gap(sector.gap), force, wheel.clearance, damping=wheel.damping,
            tangential=None if tangents is None else assemble_gap(tangents),
            nodes=wheel.nodes, pairs=wheel.pairs, comm=comm, wheel=wheel, basis=basis,
        )  # fmt: skip
        super().__init__(body)

    @cached_property
    def whole(self) -> Wheel:
        """The whole wheel, in the same setting."""
        return self._apply_setting(self.body.wheel)

    def known_omega_and_shapes(self, *, is_bonded: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Return all modes, from small dense matrices.

        Modes of equal sectors come in pairs, which Krylov's method would mix with its own error.
        The modes ascend, or have the order of :meth:`rank_modes`. The bonded modes are found among
        the open ones, for which the mass matrix is exactly 1.
        """
        if is_bonded:
            return self.compute_once(_solve_bonded_modes)
        return (
            self.compute_once(_solve_all_modes)
            if self.body.ranked_modes is None
            else self.body.ranked_modes
        )

    def rank_modes(self, count: int, n_more: int) -> tuple[WheelStructure, float]:
        """Return this wheel with its modes ordered for a reduction, and a share.

        The first ``count`` modes come first, then the ``n_more`` modes that move the cracks most,
        ascending. The next N_REFERENCE_MODES modes in this rank follow. Mode j has (psi_ij / w_j)^2
        of the static compliance of pair i, psi = B^T phi. The mode's inertia changes that by (w /
        w_j)^2.

        Returns
        -------
        WheelStructure
        float
            Share of the last group in the changes by all modes after the first two groups.
        """
        omega, shapes = self.compute_once(_solve_all_modes)
        compliance_shares = ((self.gap.T @ shapes) / omega) ** 2
        compliance_shares /= compliance_shares.sum(axis=1, keepdims=True)
        inertia_changes = compliance_shares.sum(axis=0) / omega**2
        order = count + np.argsort(-inertia_changes[count:], kind="stable")
        reference_indices = np.sort(order[n_more : n_more + N_REFERENCE_MODES])
        first_indices, next_indices = np.arange(count), np.sort(order[:n_more])
        mode_indices = np.concatenate([first_indices, next_indices, reference_indices])
        share = inertia_changes[reference_indices].sum() / inertia_changes[order[n_more:]].sum()
        ranked_modes = omega[mode_indices], shapes[:, mode_indices]
        changes = {"result_cache": self.body.result_cache, "ranked_modes": ranked_modes}
        return self._in_setting(self.setting, **changes), float(share)

    @property
    def n_sectors(self) -> int:
        """N of the wheel."""
        return self.body.wheel.n_sectors

    @property
    def _size_description(self) -> str:
        return f"{self.n_dofs} coordinates of {self.whole._size_description}"

    def iterate_sector_displacements(self, displacement: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the displacement (m, n_sector) of each sector, from coordinates (m, n_dofs)."""
        sector_indices = range(self.whole.sector.count)
        return (
            displacement @ self.basis.columns(sector_index).T for sector_index in sector_indices
        )

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Expand coordinates (m, n_dofs) to the wheel: (m, wheel.n_local)."""
        wheel = self.whole
        wheel_displacement = np.zeros((len(displacement), wheel.n_dofs))
        if wheel.comm.rank == 0:
            for numbers, sector_displacement in zip(
                wheel.numbers, self.iterate_sector_displacements(displacement), strict=True
            ):
                wheel_displacement[:, numbers] = sector_displacement
        return wheel_displacement[:, : wheel.n_local]

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Return displacements at dofs of the wheel, from coordinates (m, n_dofs) (collective)."""
        wheel = self.whole
        places = wheel.places[wheel.check_dofs(dofs)]
        rows = self.basis.columns(*divmod(places, wheel.sector.structure.n_dofs))
        return np.asarray(displacement @ rows.T)


def _solve_all_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Solve for all modes with an open crack."""
    matrices = (local_rows(matrix).toarray() for matrix in (structure.stiffness, structure.mass))
    squares, shapes = scipy.linalg.eigh(*matrices)
    return np.sqrt(np.maximum(squares, 0.0)), shapes


def _solve_bonded_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Solve for all modes with a bonded crack."""
    omega, shapes = structure.compute_once(_solve_all_modes)
    bonded_space = scipy.linalg.null_space(structure.gap.T @ shapes)
    squares, eigenvectors = scipy.linalg.eigh((bonded_space.T * omega**2) @ bonded_space)
    return np.sqrt(np.maximum(squares, 0.0)), shapes @ (bonded_space @ eigenvectors)


def count_basis_families(families: int, n_more: int = 0) -> int:
    """Return the number of modes of each nodal diameter in the basis.

    There are four more than kept, or eleven if further modes are chosen among them. With two more,
    the stated error of a gap is three quarters of the true one, with four 1.4 times: the next
    families need not open the crack. The highest modes of a small basis are no modes of the wheel,
    but move the crack much. Chosen among four families, they left 6 of 347 points of a curve
    undecided, among eight or more none.
    """
    return families + (11 if n_more else 4)


def reduce_wheel(
    wheel: Wheel, families: int | None = None, *, more: int = 0, reference: bool = True
) -> ReducedStructure:
    """Reduce a wheel to few modes, with massless crack faces (collective).

    The wheel is sought in motions of three kinds:

    - ``families`` modes of each nodal diameter with bonded cracks, and some further ones,
    - static responses to the load, and to forces of mistuning and cracks on the sides,
    - the opening of each crack, with the static response of the wheel.

    The mistuned wheel with open cracks has modes in these motions. The lowest are kept,
    ``families`` for each sector, and ``more`` others that move the cracks most. The next modes in
    this rank make the reference, which estimates the reduction error
    (``WheelStructure.rank_modes``).

    Parameters
    ----------
    wheel : Wheel
        The whole one.
    families : int, optional
        Number of modes for each nodal diameter, and for each blade; default: the wheel's.
    more : int
        Number of other modes; without a crack the next ones.
    reference : bool
        Keep the reference, too.

    Returns
    -------
    ReducedStructure
        On every rank; a :class:`MasslessStructure` if there is a crack.

    Raises
    ------
    InputError
        The wheel is none, ``families`` is no whole number from 1 to half of a sector's dofs, or
        ``more`` none from 0 to four for each sector.

    Examples
    --------
    >>> reduced = fc.reduce_wheel(wheel, families=1, more=12)
    """
    families = wheel.families if families is None else families
    check_count("families", families, 1)
    check_count("more", more, 0)
    # With more families, static responses are made of modes but for rounding.
    maximum = len(wheel.sector.dofs.own_members) // 2
    if families > maximum:
        raise InputError("families", families, f"at most {maximum}, half of a sector's dofs")
    maximum = (count_basis_families(families) - families) * wheel.sector.count
    if more > maximum:
        raise InputError("more", more, f"at most {maximum}, those of four families")
    structure = WheelStructure(
        wheel._in_setting(DEFAULT_SETTING), count_basis_families(families, more)
    )
    begin("reduction")
    count = min(families * wheel.sector.count, structure.n_dofs - structure.n_pairs)
    if not structure.n_pairs:
        reduced_structure = reduce_structure(structure, modes=count + more, reference=reference)
        return reduced_structure._in_setting(wheel.setting)
    structure, share = structure.rank_modes(count, more)
    count += more
    n_reference = reference and min(count + N_REFERENCE_MODES, structure.n_dofs)
    reduced_structure = reduce_structure(
        structure, modes=count, method="massless", reference=n_reference
    )
    return reduced_structure._in_setting(wheel.setting, error_share_removed_by_reference=share)
