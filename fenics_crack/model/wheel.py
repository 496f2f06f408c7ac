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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import repeat
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.progress import begin
from fenics_crack.model.body import Body
from fenics_crack.model.cyclic import (
    CyclicBasis,
    CyclicModes,
    Sector,
    chosen,
    cyclic_basis,
    solve_cyclic_modes,
)
from fenics_crack.model.factor import distributed, local_rows
from fenics_crack.model.matrices import numbers, read_only_rows
from fenics_crack.model.modes import solve_modes
from fenics_crack.model.nodes import Nodes, Pairs, of_body
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure, of_original


@dataclass(frozen=True, eq=False, kw_only=True)
class WheelBody(Body):
    """That of a wheel, of whose attributes these are; its matrices are made later."""

    sector: Sector
    cracked: tuple[int, ...]
    mistuning: np.ndarray
    order: int
    families: int


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
    """

    body: WheelBody
    families: int = of_body("families")
    sector: Sector = of_body("sector")
    cracked: tuple[int, ...] = of_body("cracked")
    mistuning: np.ndarray = of_body("mistuning")
    order: int = of_body("order")

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
        structure, places = sector.structure, tuple(cracked)
        check_count("families", families, 1)
        body = WheelBody(
            None, None, None, np.zeros((1, 0)), np.zeros(0), damping=structure.damping,
            rotation=rotation, comm=comm, sector=sector, order=order, families=families,
            cracked=places if structure.n_pairs else (),
            mistuning=_deviations(mistuning, sector.count),
        )  # fmt: skip
        super().__init__(body)  # its dofs, by which the rest is put together
        watched, tangential = structure.watched, structure.tangential
        if watched is None:
            watched = np.eye(1, structure.n_dofs, structure.most_loaded())[0]
        of_blade = np.zeros((sector.count, structure.n_dofs))
        of_blade[self.first] = watched
        whole = replace(
            body, gap=self._all_gaps(structure.gap), force=self._gathered(self.loads),
            tangential=None if tangential is None else self._all_gaps(tangential),
            clearance=np.tile(structure.clearance, len(self.cracked)), nodes=self._all_nodes(),
            pairs=self._all_pairs(), watched=self._gathered(of_blade[:, None])[0],
        )  # fmt: skip
        super().__init__(whole)

    # --- its dofs ---------------------------------------------------------------------------------

    @property
    def first(self) -> int:
        """Place of the first cracked sector, whose blade is watched; else of the first one."""
        return self.cracked[0] if self.cracked else 0

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, without clamped ones."""
        sector = self.sector
        return sector.count * len(sector.own) + len(self.cracked) * len(sector.upper)

    @property
    def n_local(self) -> int:
        """All on the first rank."""
        return self.n_dofs if self.comm.rank == 0 else 0

    @property
    def first_dof(self) -> int:
        """Number of the first degree of freedom that this rank owns."""
        return 0 if self.comm.rank == 0 else self.n_dofs

    def of_sector(self, place: int) -> sparse.csr_matrix:
        """The dofs of a sector, by its place from 0, from those of the wheel: (n_sector, n)."""
        return chosen(self.numbers(place), self.n_dofs)

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
        return int(self.numbers(blade - 1)[dof])

    def blade_of(self, dof: int) -> tuple[int, int]:
        """The number of the sector, from 1, to which a dof belongs, and the dof of the sector."""
        sector = self.sector
        own, count = len(sector.own), len(sector.upper)
        if dof < sector.count * own:
            return dof // own + 1, int(sector.own[dof % own])
        place, rest = divmod(dof - sector.count * own, count)
        return self.cracked[place] + 1, int(sector.upper[rest])

    def dofs_of_blades(self, dof: int) -> list[int]:
        """The dofs of all blades that are where one of the wheel is on its own."""
        _, own = self.blade_of(dof)
        return [self.dof_of(blade, own) for blade in range(1, self.sector.count + 1)]

    def dof_name(self, dof: int) -> str:
        """A dof in words: "x displacement at (0.1, 0.1) m of blade 3"."""
        blade, own = self.blade_of(dof)
        return f"{self.sector.structure.dof_name(own)} of blade {blade}"

    def numbers(self, place: int) -> np.ndarray:
        """Numbers in the wheel of a sector's dofs: (n_sector,)."""
        sector, own = self.sector, len(self.sector.own)
        found = sector.place + (place + sector.after) % sector.count * own
        if place in self.cracked:
            count = len(sector.upper)
            start = sector.count * own + self.cracked.index(place) * count
            found[sector.upper] = start + np.arange(count)
        return found

    def _all_nodes(self) -> Nodes:
        sector, nodes = self.sector, self.sector.structure.nodes
        assert nodes is not None
        (left, right), (lower, upper) = sector.sides, sector.lips
        here = np.ones((sector.count, len(nodes.points)), dtype=bool)
        here[:, right] = False
        here[np.ix_(np.setdiff1d(range(sector.count), self.cracked), upper)] = False
        numbers = np.full(here.shape, -1)
        numbers[here] = np.arange(np.count_nonzero(here))
        points, dofs, cells, frames = [], [], [], []
        for place, kept in enumerate(here):
            turned, own = sector.turned(place), nodes.dofs[kept]
            points.append(sector.placed(nodes.points[kept], place))
            dofs.append(np.where(own >= 0, self.numbers(place)[own], -1))
            frames.append(np.broadcast_to(turned, (len(own), *turned.shape)))
            number = numbers[place].copy()
            if place not in self.cracked:
                number[upper] = number[lower]
            number[right] = numbers[(place + 1) % sector.count, left]
            cells.append(number[nodes.cells])
        mine = slice(None if self.comm.rank == 0 else 0)
        place_of, dof_of, cell, frame = (
            np.concatenate(part)[mine] for part in (points, dofs, cells, frames)
        )
        return Nodes(place_of, dof_of, cell, nodes.vtk_type, frames=frame)

    def _all_pairs(self) -> Pairs:
        sector, pairs = self.sector, self.sector.structure.pairs
        if not self.cracked or pairs.points is None or pairs.cracks is None:
            return Pairs()
        assert pairs.areas is not None and pairs.positions is not None
        points = [sector.placed(pairs.points, place) for place in self.cracked]
        several, count = len(self.cracked), int(pairs.cracks.max(initial=-1)) + 1
        places = {
            name + f" of blade {place + 1}" * (several > 1): pair + number * len(pairs.points)
            for number, place in enumerate(self.cracked)
            for name, pair in pairs.places.items()
        }
        cracks = [pairs.cracks + number * count for number in range(several)]
        return Pairs(
            np.concatenate(points),
            np.tile(pairs.areas, several),
            np.concatenate(cracks),
            np.tile(pairs.positions, several),
            places,
        )

    def _all_gaps(self, gap: sparse.spmatrix) -> sparse.csr_matrix:
        """B of all cracks, from that of one."""
        parts = [self.of_sector(place).T @ gap for place in self.cracked]
        whole = sparse.hstack(parts) if parts else sparse.csr_matrix((self.n_dofs, 0))
        return read_only_rows(sparse.csr_matrix(whole)[: self.n_local])

    @property
    def loads(self) -> np.ndarray:
        """Rows of the load on the dofs of each sector: (N, 2K+1, n_sector) [N]."""
        sector, force = self.sector, self.sector.structure.force
        found = np.tile(force, (sector.count, 1, 1))
        angles = 2.0 * np.pi * self.order * np.arange(sector.count) / sector.count
        for row in range(1, len(force), 2):
            phase = (0.5 * (row + 1) * angles)[:, None]
            cosine, sine = np.cos(phase), np.sin(phase)
            found[:, row] = cosine * force[row] + sine * force[row + 1]
            found[:, row + 1] = cosine * force[row + 1] - sine * force[row]
        return found

    def _gathered(self, rows: np.ndarray) -> np.ndarray:
        """Forces on sectors (N, m, n_sector) as those on the wheel: (m, n_local)."""
        found = np.zeros((rows.shape[1], self.n_dofs))
        for place, own in enumerate(rows):
            found += (self.of_sector(place).T @ own.T).T
        return found[:, : self.n_local]

    # --- its matrices -----------------------------------------------------------------------------

    @of_original
    def mass(self) -> Any:
        """M: (n, n) [kg]; made when it is first requested (collective)."""
        return self._sum_of_sectors(repeat(self.sector.mass, self.sector.count))

    @of_original
    def stiffness(self) -> Any:
        """K: (n, n) [N/m], likewise."""
        tuned, elastic = self.sector.stiffness, local_rows(self.sector.elastic)
        return self._sum_of_sectors(tuned + d * elastic if d else tuned for d in self.mistuning)

    def _sum_of_sectors(self, matrices: Iterable[sparse.spmatrix]) -> Any:
        """sum_j A_j^T K_j A_j of a matrix of each sector (collective)."""
        total = sparse.csr_matrix((self.n_dofs, self.n_dofs))
        for place, own in enumerate(matrices):
            to = self.of_sector(place)
            total = total + to.T @ own @ to
        return distributed(total[: self.n_local], self.comm)

    @property
    def _size_words(self) -> str:
        return f"{self.sector.count} sectors, {self.n_dofs} dofs"

    def known_modes(self, *, tied: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Those of its few coordinates, as many as ``families`` are of all sectors."""
        few = in_few_coordinates(self)
        count = min(self.families * self.sector.count, few.n_dofs - few.n_pairs)
        found = solve_modes(few, count, lips="tied" if tied and few.n_pairs else "open")
        return found.omega, few.expand(found.shapes.T).T

    def mistuned(self, deviations: Any) -> Wheel:
        """The same wheel with other deviations of the sectors' stiffness, one for each or for all.

        Raises
        ------
        InputError
            There are more or fewer, or one leaves no stiffness.
        """
        return self._in(self.setting, mistuning=_deviations(deviations, self.sector.count))

    def basis(self, families: int) -> CyclicBasis:
        """The motions in which it is sought, with so many modes of each nodal diameter; found once
        for all patterns of mistuning (collective)."""
        sector, loads = self.sector, tuple(_complex_loads(self))
        key = "basis", families, self.order, *(force.tobytes() for _, force in loads)
        return sector.once(key, lambda: cyclic_basis(sector, families, loads, self.comm))

    def cyclic_modes(self, families: int | None = None) -> CyclicModes:
        """The lowest modes of each nodal diameter, with bonded cracks and without mistuning
        (collective)."""
        count = self.families if families is None else families
        check_count("families", count, 1)
        return solve_cyclic_modes(self.sector, count, self.comm)


def _deviations(given: Any, count: int) -> np.ndarray:
    values = numbers(given)
    if values.shape not in ((), (count,)) or not np.all(values > -1.0) or not np.all(values < 1e3):
        allowed = f"one number above -1, or one for each of the {count} sectors"
        raise InputError("mistuning", given, allowed)
    return np.broadcast_to(values, (count,)).copy()


def excited_diameter(order: int, sectors: int) -> int:
    """The nodal diameter that an engine order excites: min(E mod N, N - E mod N)."""
    rest = order % sectors
    return min(rest, sectors - rest)


def _complex_loads(wheel: Wheel) -> list[tuple[int, np.ndarray]]:
    """The loads of each harmonic, f - i g on sector 0, by the nodal diameter in which they lie."""
    force, count = wheel.sector.structure.force, wheel.sector.count
    found = [(0, force[0])] if np.any(force[0]) else []
    for row in range(1, len(force), 2):
        part = force[row] - 1j * force[row + 1]
        order = (row + 1) // 2 * wheel.order
        if np.any(part):
            diameter = excited_diameter(order, count)
            found.append((diameter, part if diameter == order % count else part.conj()))
    return found


# --- in few coordinates ---------------------------------------------------------------------------


def _ritz(basis: CyclicBasis, cracked: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """U^T M U and U^T K U without mistuning. The modes are those of both; K of openings of cracks
    is what holds the upper faces."""
    sector, modes = basis.modes.sector, len(basis.squares)
    moved, mass = basis.times(sector.mass), np.zeros(())
    for place in range(sector.count):
        columns, products = (one.columns(place, cracked) for one in (basis, moved))
        mass = mass + columns.T @ products[:, modes:]
    whole = [np.eye(len(mass)), np.zeros((len(mass), len(mass)))]
    whole[0][:, modes:] = mass
    whole[0][modes:] = mass.T
    pulled = basis.opening.T @ sector.stiffness
    held = [
        np.hstack([
            pulled @ (basis.opened[(one - other) % sector.count] + (one == other) * basis.opening)
            for other in cracked
        ])
        for one in cracked
    ]  # fmt: skip
    whole[1][:modes, :modes] = np.diag(basis.squares)
    if held:
        whole[1][modes:, modes:] = np.vstack(held)
    return tuple(0.5 * (matrix + matrix.T) for matrix in whole)  # type: ignore[return-value]


def _elastic(basis: CyclicBasis, cracked: tuple[int, ...]) -> np.ndarray:
    """U_j^T K U_j of each sector, K its stiffness at rest: (N, n, n)."""
    sector = basis.modes.sector
    moved, found = basis.times(local_rows(sector.elastic)), []
    for place in range(sector.count):
        part = basis.columns(place, cracked).T @ moved.columns(place, cracked)
        found.append(0.5 * (part + part.T))
    return np.array(found)


NEXT = 8
"""Modes that the reference of a wheel has beyond those that are kept: of ten wheels they have 0.6
to 0.8 of what is left to change."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WheelCoordinates(Body):
    """The body of a wheel in few coordinates; ``ranked`` are its modes in another order."""

    wheel: Wheel
    basis: CyclicBasis
    ranked: tuple[np.ndarray, np.ndarray] | None = None


class WheelStructure(Structure):
    """A wheel in the coordinates (q, d) of a basis; the same on every rank.

    ``find_dof`` and ``values_at`` refer to the dofs of the whole wheel.

    Attributes
    ----------
    wheel : Wheel
        The whole one.
    basis : CyclicBasis
        Its motions.
    """

    body: WheelCoordinates
    basis: CyclicBasis = of_body("basis")

    def __init__(self, wheel: Wheel, families: int) -> None:
        """Take so many modes of each nodal diameter (collective)."""
        begin(f"modes of {len(wheel.sector.diameters)} nodal diameters")
        basis, sector = wheel.basis(families), wheel.sector.structure
        none, comm = (None, None, None, np.zeros((1, 0)), wheel.clearance), MPI.COMM_SELF
        body = WheelCoordinates(*none, comm=comm, wheel=wheel, basis=basis)
        super().__init__(body)  # what it is sought in
        begin("matrices of the wheel")
        mass, stiffness = self.tuned
        if np.any(wheel.mistuning):
            stiffness = stiffness + np.tensordot(wheel.mistuning, self.elastic, 1)
        force = np.zeros((len(sector.force), len(stiffness)))
        for place, own in enumerate(wheel.loads):
            force += own @ basis.columns(place, wheel.cracked)
        tangents = sector.tangential if wheel.cracked else None
        whole = replace(
            body, mass=distributed(mass, comm), stiffness=distributed(stiffness, comm),
            gap=self._of_cracks(sector.gap), force=force, damping=wheel.damping,
            tangential=None if tangents is None else self._of_cracks(tangents),
            nodes=wheel.nodes, pairs=wheel.pairs,
        )  # fmt: skip
        super().__init__(whole)

    @cached_property
    def wheel(self) -> Wheel:
        """The whole one, in the same setting."""
        return self._shared(self.body.wheel)

    def _of_cracks(self, gap: sparse.spmatrix) -> sparse.csr_matrix:
        """U^T B of all cracks, from B of one: (n, p)."""
        basis, cracked = self.basis, self.wheel.cracked
        parts = [basis.columns(place, cracked).T @ gap for place in cracked]
        return sparse.csr_matrix(np.hstack([np.zeros((len(self.tuned[0]), 0)), *parts]))

    @property
    def tuned(self) -> tuple[np.ndarray, np.ndarray]:
        """U^T M U and U^T K U without mistuning: (n, n) each."""
        basis, cracked = self.basis, self.wheel.cracked
        return self.wheel.sector.once(("tuned", basis, cracked), lambda: _ritz(basis, cracked))

    @property
    def elastic(self) -> np.ndarray:
        """What the deviation of each sector's stiffness multiplies: (N, n, n)."""
        basis, cracked = self.basis, self.wheel.cracked
        return self.wheel.sector.once(("elastic", basis, cracked), lambda: _elastic(basis, cracked))

    def known_modes(self, *, tied: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """All, of small dense matrices: those of equal sectors come in pairs, which Krylov's method
        mixes with its own error.

        In ascending order, or as :meth:`ranked` has the open ones; the bonded ones are among the
        open ones, of which M is 1 whatever it is in coordinates.
        """
        if tied:
            return self.once(_tied_modes)
        return self.once(_all_modes) if self.body.ranked is None else self.body.ranked

    def ranked(self, count: int, more: int) -> tuple[WheelStructure, float]:
        """The same with the lowest modes, so many of them, and as many ``more`` as move the cracks
        most, ascending; behind them the :data:`NEXT` that follow in this order; and the share that
        these have of what all but the first change.

        Mode j has (psi_ij / w_j)^2 of the static compliance of pair i, psi = B^T phi, and its
        inertia changes that by (w / w_j)^2."""
        omega, shapes = self.once(_all_modes)
        parts = ((self.gap.T @ shapes) / omega) ** 2
        changes = (parts / parts.sum(axis=1, keepdims=True)).sum(axis=0) / omega**2
        order = count + np.argsort(-changes[count:], kind="stable")
        following = np.sort(order[more : more + NEXT])
        kept = np.concatenate([np.arange(count), np.sort(order[:more]), following])
        share = changes[following].sum() / changes[order[more:]].sum()
        known, ranked = self.body.known, (omega[kept], shapes[:, kept])
        return self._in(self.setting, known=known, ranked=ranked), float(share)

    @property
    def whole(self) -> Wheel:
        """The whole wheel."""
        return self.wheel

    @property
    def _size_words(self) -> str:
        return f"{self.n_dofs} coordinates of {self.wheel._size_words}"

    def of_sectors(self, displacement: np.ndarray) -> np.ndarray:
        """Displacements of all sectors from coordinates (n_dofs,): (n_sector, N)."""
        every = range(self.wheel.sector.count)
        parts = [self.basis.columns(j, self.wheel.cracked) @ displacement for j in every]
        return np.column_stack(parts)

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Displacements of the wheel from coordinates (m, n_dofs): (m, wheel.n_local)."""
        wheel = self.wheel
        found = np.zeros((len(displacement), wheel.n_dofs))
        if wheel.comm.rank == 0:
            for place in range(wheel.sector.count):
                moved = displacement @ self.basis.columns(place, wheel.cracked).T
                found[:, wheel.numbers(place)] = moved
        return found[:, : wheel.n_local]

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Displacement of dofs of the wheel from coordinates (m, n_dofs) (collective)."""
        wanted = [self.wheel.blade_of(int(dof)) for dof in self.wheel.check_dofs(dofs)]
        rows = np.zeros((len(wanted), self.n_dofs))
        for blade in {blade for blade, _ in wanted}:
            here = [row for row, (one, _) in enumerate(wanted) if one == blade]
            own = [wanted[row][1] for row in here]
            rows[here] = self.basis.columns(blade - 1, self.wheel.cracked, own)
        return displacement @ rows.T


def _all_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    matrices = (local_rows(part).toarray() for part in (structure.stiffness, structure.mass))
    squares, shapes = scipy.linalg.eigh(*matrices)
    return np.sqrt(np.maximum(squares, 0.0)), shapes


def _tied_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    omega, shapes = structure.once(_all_modes)
    free = scipy.linalg.null_space(structure.gap.T @ shapes)
    squares, turned = scipy.linalg.eigh((free.T * omega**2) @ free)
    return np.sqrt(np.maximum(squares, 0.0)), shapes @ (free @ turned)


def in_few_coordinates(structure: Structure) -> Structure:
    """The same structure; of a wheel in the coordinates in which it is solved (collective)."""
    if not isinstance(structure, Wheel):
        return structure
    return WheelStructure(structure, families_of_basis(structure.families))


def families_of_basis(families: int, more: int = 0) -> int:
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
    the error of the reduction is estimated, has the few that follow (``WheelStructure.ranked``).

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
        none from 0 to those that the basis has left.

    Examples
    --------
    >>> reduced = fc.reduce_wheel(wheel, families=1, more=12)
    """
    families = wheel.families if families is None else families
    check_count("families", families, 1)
    check_count("more", more, 0)
    most = len(wheel.sector.own) // 2  # beyond it static answers are made of modes but for rounding
    if families > most:
        raise InputError("families", families, f"at most {most}, half of a sector's dofs")
    most = (families_of_basis(families) - families) * wheel.sector.count
    if more > most:
        raise InputError("more", more, f"at most {most}, those of four families")
    one = WheelStructure(wheel, families_of_basis(families, more))
    begin("reduction")
    count = min(families * wheel.sector.count, one.n_dofs - one.n_pairs)
    if not one.n_pairs:
        return reduce_structure(
            one, modes=count + more, method="free_interface", reference=reference
        )
    one, share = one.ranked(count, more)
    count += more
    finer = reference and min(count + NEXT, one.n_dofs)
    reduced = reduce_structure(one, modes=count, method="massless", reference=finer)
    return reduced._in(reduced.setting, share=share)
