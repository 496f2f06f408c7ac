"""A bladed disk of equal sectors: mistuned, some of its blades cracked, under an engine order.

The whole wheel has the dofs of each sector that belong to it alone, in the frame of that sector,
and those of the upper face of each crack. Its matrices are those of the sector, copied; they are
made where someone asks for them. It is solved in few coordinates of motions of the whole wheel:

    u = U (q, d),      M = U^T M U,      K = sum_j (1 + delta_j) U_j^T K U_j,

q those of the modes with bonded cracks and of static answers, and d those of displacements of the
upper faces of cracks beside the lower ones, with the static answer of the rest (Craig and Bampton,
AIAA Journal 6, 1968, 1313). delta_j is the mistuning of sector j: its stiffness at rest is
multiplied by 1 + delta_j.

A load that stands still in space passes the blades one after the other. Sector j, from 0, is ahead
by j / N of a revolution: with an engine order E, and its k-th harmonic of order k E,

    f_j(t) = sum_k f_k cos(k w t + 2 pi k E j / N) + g_k sin(k w t + 2 pi k E j / N),

in the frame of the sector: a wave that runs against the rotation, seen from the wheel.
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
from fenics_crack.model.body import DEFAULT_SETTING, Body
from fenics_crack.model.cyclic import (
    CyclicBasis,
    CyclicModes,
    Sector,
    SectorNumbering,
    cyclic_basis,
    selection_matrix,
    solve_cyclic_modes,
)
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
    """That of a wheel, of whose attributes these are; its matrices are made later."""

    sector: Sector
    cracked: tuple[int, ...]
    mistuning: np.ndarray
    order: int
    families: int
    numbers: np.ndarray
    places: np.ndarray


class Wheel(Structure):
    """The whole wheel; rank 0 owns all of its rows.

    Displacements are those in the frame of each blade: "x" is the first blade's x, turned with the
    blade. Nodes on a side between two sectors belong to the later one.

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
        Modes of each nodal diameter, and of each blade, that are kept.
    numbers : (N, n_sector) int
        The wheel's dof that each dof of each sector is.
    places : (n,) int
        Of each dof the place, among all of ``numbers``, in the sector to which it belongs.
    """

    body: WheelBody
    families: int = body_property("families")
    sector: Sector = body_property("sector")
    cracked: tuple[int, ...] = body_property("cracked")
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
        structure, count, tangential = sector.structure, sector.count, sector.structure.tangential
        cracked = tuple(cracked) if structure.n_pairs else ()
        dofs, places = sector.dofs.in_wheel(count, cracked)
        absent, mine = AbsentMatrix(len(places), comm.rank), slice(None if comm.rank == 0 else 0)
        copies, of_cracks = (
            selection_matrix(dofs.ravel(), len(places)),
            np.eye(count)[:, list(cracked)],
        )

        def on_wheel(rows: np.ndarray) -> np.ndarray:
            """Forces on all sectors (m, N, n_sector) as those on the wheel: (m, n_local)."""
            return np.asarray(rows.reshape(len(rows), -1) @ copies)[:, mine]

        def of_all(gap: sparse.spmatrix) -> sparse.csr_matrix:
            """B of all cracks, from that of one: (n_local, n_pairs)."""
            return sparse.csr_matrix(copies.T @ sparse.kron(of_cracks, gap))[mine]

        watched = structure.watched
        if watched is None:
            watched = np.eye(1, structure.n_dofs, structure.find_most_loaded_dof())[0]
        first = np.eye(1, count, cracked[0] if cracked else 0)
        body = WheelBody(
            absent, absent, of_all(structure.gap), on_wheel(_sector_loads(sector, order)),
            np.tile(structure.clearance, len(cracked)), damping=structure.damping,
            tangential=None if tangential is None else of_all(tangential),
            nodes=_wheel_nodes(sector, cracked, dofs, mine), pairs=_wheel_pairs(sector, cracked),
            watched=on_wheel(first[..., None] * watched)[0], rotation=rotation, comm=comm,
            sector=sector, cracked=cracked, mistuning=_read_deviations(mistuning, count), order=order,
            families=families, numbers=dofs, places=places,
        )  # fmt: skip
        super().__init__(body)

    # --- its dofs ---------------------------------------------------------------------------------

    @property
    def first(self) -> int:
        """Place of the first cracked sector, whose blade is watched; else of the first one."""
        return self.cracked[0] if self.cracked else 0

    def dof_of(self, blade: int, dof: int) -> int:
        """The dof of the wheel that a dof of a sector is in one of them, by its number from 1.

        Raises
        ------
        InputError
            There is no such sector, or no such dof in it.
        """
        count, size = self.sector.count, self.sector.structure.n_dofs
        if not 1 <= blade <= count:
            raise InputError("blade", blade, f"a whole number from 1 to {count}")
        if not 0 <= dof < size:
            raise InputError("dof", dof, f"a whole number from 0 to {size - 1}")
        return int(self.numbers[blade - 1, dof])

    def blade_of(self, dof: int) -> tuple[int, int]:
        """The number of the sector, from 1, to which a dof belongs, and the dof of the sector."""
        place, own = divmod(int(self.places[dof]), self.sector.structure.n_dofs)
        return place + 1, own

    def dofs_of_blades(self, dof: int) -> list[int]:
        """The dofs of all blades that are where one of the wheel is on its own."""
        return list(map(int, self.numbers[:, self.blade_of(dof)[1]]))

    def dof_name(self, dof: int) -> str:
        """A dof in words: "x displacement at (0.1, 0.1) m of blade 3"."""
        blade, own = self.blade_of(dof)
        return f"{self.sector.structure.dof_name(own)} of blade {blade}"

    def with_harmonics(self, harmonics: Mapping[int, tuple[Any, Any]]) -> Structure:
        """InputError: sectors have the load's harmonics, one after the other."""
        allowed = "of a scene whose [[excitation.harmonics]] has them, which turn with its order"
        raise InputError("structure", repr(self), allowed)

    # --- its matrices -----------------------------------------------------------------------------

    @shared_property
    def mass(self) -> Any:
        """M: (n, n) [kg]; made when it is first requested (collective)."""
        return self._assemble_wheel(sparse.kron(np.eye(self.sector.count), self.sector.mass))

    @shared_property
    def stiffness(self) -> Any:
        """K: (n, n) [N/m], likewise."""
        tuned = sparse.kron(np.eye(self.sector.count), self.sector.stiffness)
        elastic = local_rows(self.sector.stiffness_at_rest)
        return self._assemble_wheel(tuned + sparse.kron(np.diag(self.mistuning), elastic))

    def _assemble_wheel(self, matrix: sparse.spmatrix) -> Any:
        """That of the wheel from one of all sectors, apart (collective)."""
        copies = selection_matrix(self.numbers.ravel(), self.n_dofs)
        whole = sparse.csr_matrix(copies.T @ matrix @ copies)
        return distribute_rows(whole[: self.n_local], self.comm)

    @property
    def _size_words(self) -> str:
        return f"{self.sector.count} sectors, {self.n_dofs} dofs"

    def known_modes(self, *, is_bonded: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Those of its few coordinates, as many as ``families`` are of all sectors."""
        few = in_few_coordinates(self)
        count = min(self.families * self.sector.count, few.n_dofs - few.n_pairs)
        found = solve_modes(few, count, lips="tied" if is_bonded and few.n_pairs else "open")
        return found.omega, few.expand(found.shapes.T).T

    def mistuned(self, deviations: Any) -> Wheel:
        """The same wheel with other deviations of the sectors' stiffness, one for each or for all.

        Raises
        ------
        InputError
            There are more or fewer, or one leaves no stiffness.
        """
        return self._in_setting(
            self.setting, mistuning=_read_deviations(deviations, self.sector.count)
        )

    def basis(self, families: int) -> CyclicBasis:
        """The motions in which it is sought, with so many modes of each nodal diameter; found once
        for all patterns of mistuning (collective)."""
        bases, key = self.sector.bases, (families, self.order, self.cracked)
        if key not in bases:
            bases[key] = cyclic_basis(self.sector, *key, self.comm)
        return bases[key]

    def cyclic_modes(self, families: int | None = None) -> CyclicModes:
        """The lowest modes of each nodal diameter, with bonded cracks and without mistuning
        (collective)."""
        count = self.families if families is None else families
        check_count("families", count, 1)
        return solve_cyclic_modes(self.sector, count, self.comm)


def _read_deviations(given: Any, count: int) -> np.ndarray:
    values = numbers(given)
    if values.shape not in ((), (count,)) or not np.all(values > -1.0) or not np.all(values < 1e3):
        allowed = f"one number above -1, or one for each of the {count} sectors"
        raise InputError("mistuning", given, allowed)
    return np.broadcast_to(values, (count,)).copy()


def _sector_loads(sector: Sector, order: int) -> np.ndarray:
    """Rows of the load on the dofs of each sector: (2K+1, N, n_sector) [N]."""
    waves = to_complex(sector.structure.force)
    angles = np.multiply.outer(np.arange(len(waves)), np.arange(sector.count)) * order
    turns = np.exp(2j * np.pi * angles / sector.count)
    return from_complex(turns[..., None] * waves[:, None])


def _wheel_nodes(sector: Sector, cracked: tuple[int, ...], dofs: np.ndarray, mine: slice) -> Nodes:
    """Of the wheel, those of one rank, from its numbers of the dofs of all sectors."""
    nodes = sector.structure.nodes
    assert nodes is not None
    count = len(nodes.points)
    numbering = SectorNumbering(np.arange(count)[:, None], sector.sides, sector.lips)
    numbers, places = numbering.in_wheel(sector.count, cracked)
    place, node = divmod(places[mine], count)
    frames = np.array([sector.rotation_matrix(one) for one in range(sector.count)])[place]
    points = np.einsum("nij,nj->ni", frames, nodes.points[node] - sector.center) + sector.center
    own = nodes.dofs[node]
    own = np.where(own >= 0, dofs[place[:, None], own], -1)
    cells = numbers[:, nodes.cells].reshape(-1, nodes.cells.shape[1])[mine]
    return Nodes(points, own, cells, nodes.vtk_type, frames=frames)


def _wheel_pairs(sector: Sector, cracked: tuple[int, ...]) -> Pairs:
    """Of the wheel."""
    pairs, several = sector.structure.pairs, len(cracked)
    if not cracked or pairs.points is None or pairs.cracks is None:
        return Pairs()
    assert pairs.areas is not None and pairs.positions is not None
    count, numbers = int(pairs.cracks.max(initial=-1)) + 1, np.arange(several)[:, None]
    places = {
        name + f" of blade {place + 1}" * (several > 1): pair + number * len(pairs.points)
        for number, place in enumerate(cracked)
        for name, pair in pairs.places.items()
    }
    points = np.concatenate([sector.place_points(pairs.points, place) for place in cracked])
    cracks = (pairs.cracks + count * numbers).ravel()
    areas, positions = (np.tile(values, several) for values in (pairs.areas, pairs.positions))
    return Pairs(points, areas, cracks, positions, places)


# --- in few coordinates ---------------------------------------------------------------------------


N_REFERENCE_MODES = 16
"""Modes that the reference of a wheel has beyond those that are kept: of ten wheels they have 0.53
to 0.99 of what is left to change. With eight, 0.35 to 0.96, errors of an opening of 0.7 and 0.9 %
and of the load's displacement of 1.5 % were 1.8 times what was stated."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WheelCoordinates(Body):
    """The body of a wheel in few coordinates; ``ranked_modes`` are its modes in another order."""

    wheel: Wheel
    basis: CyclicBasis
    ranked_modes: tuple[np.ndarray, np.ndarray] | None = None


class WheelStructure(Structure):
    """A wheel in the coordinates (q, d) of a basis; the same on every rank.

    ``find_dof`` and ``values_at`` refer to the dofs of the whole wheel.

    Attributes
    ----------
    basis : CyclicBasis
        Motions of the whole one.
    """

    body: WheelCoordinates
    basis: CyclicBasis = body_property("basis")

    def __init__(self, wheel: Wheel, families: int) -> None:
        """Take so many modes of each nodal diameter (collective)."""
        begin(f"modes of {len(wheel.sector.diameters)} nodal diameters")
        basis, sector, comm = wheel.basis(families), wheel.sector.structure, MPI.COMM_SELF
        begin("matrices of the wheel")
        mass, stiffness = basis.tuned_matrices
        if np.any(wheel.mistuning):
            stiffness = stiffness + np.tensordot(wheel.mistuning, basis.sector_stiffnesses, 1)
        loads = _sector_loads(wheel.sector, wheel.order)
        force = sum(loads[:, place] @ basis.columns(place) for place in range(wheel.sector.count))

        def of_cracks(gap: sparse.spmatrix) -> sparse.csr_matrix:
            """U^T B of all cracks, from B of one: (n, p)."""
            parts = [basis.columns(place).T @ gap for place in wheel.cracked]
            return sparse.csr_matrix(np.hstack([np.zeros((len(mass), 0)), *parts]))

        tangents = sector.tangential if wheel.cracked else None
        body = WheelCoordinates(
            distribute_rows(mass, comm), distribute_rows(stiffness, comm),
            of_cracks(sector.gap), force, wheel.clearance, damping=wheel.damping,
            tangential=None if tangents is None else of_cracks(tangents),
            nodes=wheel.nodes, pairs=wheel.pairs, comm=comm, wheel=wheel, basis=basis,
        )  # fmt: skip
        super().__init__(body)

    @cached_property
    def whole(self) -> Wheel:
        """The whole wheel, in the same setting."""
        return self._apply_setting(self.body.wheel)

    def known_modes(self, *, is_bonded: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """All, of small dense matrices: those of equal sectors come in pairs, which Krylov's method
        mixes with its own error.

        In ascending order, or as :meth:`rank_modes` has the open ones; the bonded ones are among the
        open ones, of which M is 1 whatever it is in coordinates.
        """
        if is_bonded:
            return self.cached_result(_solve_bonded_modes)
        return (
            self.cached_result(_solve_all_modes)
            if self.body.ranked_modes is None
            else self.body.ranked_modes
        )

    def rank_modes(self, count: int, more: int) -> tuple[WheelStructure, float]:
        """The same with the lowest modes, so many of them, and as many ``more`` as move the cracks
        most, ascending; behind them the :data:`NEXT` that follow in this order; and the share that
        these have of what all but the first change.

        Mode j has (psi_ij / w_j)^2 of the static compliance of pair i, psi = B^T phi, and its
        inertia changes that by (w / w_j)^2."""
        omega, shapes = self.cached_result(_solve_all_modes)
        parts = ((self.gap.T @ shapes) / omega) ** 2
        changes = (parts / parts.sum(axis=1, keepdims=True)).sum(axis=0) / omega**2
        order = count + np.argsort(-changes[count:], kind="stable")
        following = np.sort(order[more : more + N_REFERENCE_MODES])
        kept = np.concatenate([np.arange(count), np.sort(order[:more]), following])
        share = changes[following].sum() / changes[order[more:]].sum()
        cached_results, ranked_modes = self.body.cached_results, (omega[kept], shapes[:, kept])
        return self._in_setting(
            self.setting, cached_results=cached_results, ranked_modes=ranked_modes
        ), float(share)

    @property
    def _size_words(self) -> str:
        return f"{self.n_dofs} coordinates of {self.whole._size_words}"

    def sector_displacements(self, displacement: np.ndarray) -> Iterator[np.ndarray]:
        """Displacements (m, n_sector) of all sectors, one by one, from coordinates (m, n_dofs)."""
        every = range(self.whole.sector.count)
        return (displacement @ self.basis.columns(place).T for place in every)

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Displacements of the wheel from coordinates (m, n_dofs): (m, wheel.n_local)."""
        wheel = self.whole
        found = np.zeros((len(displacement), wheel.n_dofs))
        if wheel.comm.rank == 0:
            for numbers, moved in zip(
                wheel.numbers, self.sector_displacements(displacement), strict=True
            ):
                found[:, numbers] = moved
        return found[:, : wheel.n_local]

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Displacement of dofs of the wheel from coordinates (m, n_dofs) (collective)."""
        wheel = self.whole
        places = wheel.places[wheel.check_dofs(dofs)]
        rows = self.basis.columns(*divmod(places, wheel.sector.structure.n_dofs))
        return np.asarray(displacement @ rows.T)


def _solve_all_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    matrices = (local_rows(part).toarray() for part in (structure.stiffness, structure.mass))
    squares, shapes = scipy.linalg.eigh(*matrices)
    return np.sqrt(np.maximum(squares, 0.0)), shapes


def _solve_bonded_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    omega, shapes = structure.cached_result(_solve_all_modes)
    free = scipy.linalg.null_space(structure.gap.T @ shapes)
    squares, turned = scipy.linalg.eigh((free.T * omega**2) @ free)
    return np.sqrt(np.maximum(squares, 0.0)), shapes @ (free @ turned)


def in_few_coordinates(structure: Structure) -> Structure:
    """The same structure; of a wheel in the coordinates in which it is solved (collective)."""
    if not isinstance(structure, Wheel):
        return structure
    return WheelStructure(structure, count_basis_families(structure.families))


def count_basis_families(families: int, more: int = 0) -> int:
    """Modes of each nodal diameter in the basis, for so many that are kept: four more, or eleven
    where more modes are chosen among them.

    With two the stated error of a gap is three quarters of the true one, with four 1.4 times it:
    the next families need not open the crack. The highest modes of a small basis are none of the
    wheel, but move the crack much: chosen among those of four families they made 6 of 347 points of
    a curve undecided, among eight or more none.
    """
    return families + (11 if more else 4)


def reduce_wheel(
    wheel: Wheel, families: int | None = None, *, more: int = 0, reference: bool = True
) -> ReducedStructure:
    """Reduce a wheel to its lowest modes and those that move its cracks most, with crack faces
    without mass (collective).

    The motions that are sought are those of ``families`` modes of each nodal diameter with bonded
    cracks, and of further families, the static answers to the load and to what mistuning and cracks
    leave on the sides, and the opening of each crack with the static answer of the wheel. Of the
    modes that the mistuned wheel with open cracks has in them ``families`` times as many as there
    are sectors are kept, and the ``more`` others that move the cracks most. The reference, by which
    the error of the reduction is estimated, has the few that follow (``WheelStructure.rank_modes``).

    Parameters
    ----------
    wheel : Wheel
        The whole one.
    families : int, optional
        Modes of each nodal diameter, and of each blade; default: the wheel's.
    more : int
        How many other modes; without a crack the next ones.
    reference : bool
        Keep what estimates the error of the reduction.

    Returns
    -------
    ReducedStructure
        A :class:`MasslessStructure` where there is a crack; on every rank.

    Raises
    ------
    InputError
        The wheel is none, families is no whole number from 1 to half of a sector's dofs, or more
        none from 0 to four for each sector.

    Examples
    --------
    >>> reduced = fc.reduce_wheel(wheel, families=1, more=12)
    """
    families = wheel.families if families is None else families
    check_count("families", families, 1)
    check_count("more", more, 0)
    # Beyond it static answers are made of modes but for rounding.
    most = len(wheel.sector.dofs.own_members) // 2
    if families > most:
        raise InputError("families", families, f"at most {most}, half of a sector's dofs")
    most = (count_basis_families(families) - families) * wheel.sector.count
    if more > most:
        raise InputError("more", more, f"at most {most}, those of four families")
    one = WheelStructure(wheel._in_setting(DEFAULT_SETTING), count_basis_families(families, more))
    begin("reduction")
    count = min(families * wheel.sector.count, one.n_dofs - one.n_pairs)
    if not one.n_pairs:
        reduced = reduce_structure(one, modes=count + more, reference=reference)
        return reduced._in_setting(wheel.setting)
    one, share = one.rank_modes(count, more)
    count += more
    finer = reference and min(count + N_REFERENCE_MODES, one.n_dofs)
    reduced = reduce_structure(one, modes=count, method="massless", reference=finer)
    return reduced._in_setting(wheel.setting, share=share)
