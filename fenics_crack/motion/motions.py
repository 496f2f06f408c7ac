"""Motions as they are observed: a kind of motion writes its :class:`Record`; its numbers follow.

Each kind, a solution of harmonic balance, an exact orbit, a time history or a curve of solutions,
has one function, ``records``: the products of some rows with the displacement, and what happens at
the crack faces, over a period. A curve has a record at each of its points.

Among the numbers are indicators of a breathing crack, which change with it. Of a watched
displacement u(t) = a0 + sum_k a_k cos(k w t / m) + b_k sin(k w t / m), with the load at w and m
times its period, the amplitude at j times the load's frequency is

    U_j = sqrt(a_k^2 + b_k^2),      k = j m,

and a linear structure has U_1 alone. Crack faces that open and close once in a period act as a
stiffness that depends on the sign of the gap: they make even harmonics and a mean, U_2 / U_1 and a0
/ U_1, and at a period doubling U_1/2; all of these are independent of the size of the load as long
as there is no clearance (Dimarogonas, Engineering Fracture Mechanics 55, 1996, 831, reviews them).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import RECORDED_PERIODS
from fenics_crack.basics.observables import FILES, FRICTION, Observables, Place, names_of, read_at
from fenics_crack.basics.tables import Tabular, hertz_of
from fenics_crack.model.modes import NEGLIGIBLE
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.extremes import RecordFunction, find_maxima

SLIP_FORCE_RATIO = 1.0 - 1e-6
"""Friction force over its limit from which on a pair slips: orbits are known to 1e-6."""


@dataclass(frozen=True, repr=False)
class Indicators(Observables, Tabular):
    """Indicators of a breathing crack at a point and at the crack faces.

    Made by ``indicators`` of a solution, an orbit or a time history, where each attribute is a
    number, or of a curve, where each is an array with a value for every point (n,).

    Attributes
    ----------
    omega : [rad/s]
        Frequency of the load.
    amplitude : [m]
        Half the peak-to-peak displacement, of all harmonics together.
    mean : [m]
        a0, with the displacement by a mean load.
    harmonic_1, harmonic_2, harmonic_3 : [m]
        U_1, U_2, U_3: amplitudes at once, twice and three times the load's frequency.
    ratio_2_1, ratio_3_1 : [-]
        U_2 / U_1 and U_3 / U_1; nan where the solution has not so many harmonics, or no U_1.
    ratio_half_1 : [-]
        U_1/2 / U_1, at half the load's frequency; nan unless the solution has an even multiple of
        the load's period.
    ratio_largest, largest_order : [-]
        U_k / U_1 of the largest harmonic above the load's, and its order k; nan without one, the
        order also where all are rounding of the whole motion.
    mean_shift : [-]
        a0 / U_1, positive in the direction of the dof.
    opening, penetration : [m]
        The largest of any pair at any time; nan without pairs, as are the next three.
    contact_force : [N]
        The largest of any pair at any time: the finer the mesh, the smaller.
    crack_force : [N]
        The largest of a crack at any time, the sum over its pairs, which a finer mesh does not
        change; of matrices that of all pairs.
    closed_share : [-]
        Part of the period in which a pair carries a contact force, mean over the pairs.
    friction_loss : [J]
        Work of friction in a period of the response, of all pairs; nan without friction, as are
        the next two.
    stick_share, slip_share : [-]
        Part of the period in which a closed pair sticks and slips, mean over the pairs.
    """

    frequency = hertz_of()

    def to_dict(self) -> dict[str, Any]:
        """Numbers by name, or along a curve columns; those of friction where there is some."""
        columns = {one.name: np.asarray(getattr(self, one.name)) for one in fields(self)}
        return {
            name: column.tolist()
            for name, column in columns.items()
            if name not in names_of(where=FRICTION) or not np.all(np.isnan(column))
        }

    def _title(self) -> str:
        if np.ndim(self.omega):
            return f"{len(self.omega)} points"
        return f"amplitude = {self.amplitude:.4g} m, ratio_2_1 = {self.ratio_2_1:.3g}"


# --- what is observed -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Record:
    """A motion over its period, or over some periods of the load: of some rows that its
    displacement is multiplied by, and of the crack faces.

    Attributes
    ----------
    omega : float
        Frequency of the load [rad/s].
    subharmonic : int
        Its periods in one of the motion.
    time : (n,) [s]
        Equally spaced.
    waves : (2H+1, m)
        Fourier coefficients of the products over the period, or the last one.
    motion : (n, m)
        The products.
    gap, force : (n, n_rows) [m], [N]
        Of all pairs, with friction tangential ones behind the normal ones.
    structure : Structure
        As a curve's parameter varies it.
    friction : float or (n_pairs,), optional
        Its coefficient.
    at : callable, optional
        Products, gaps and forces at any parts of the period: extremes are then exact to rounding.
    steps : int
        Instants in a period of the load, of a record of several; 0: the motion repeats itself.
    exact : dict of str to float
        Numbers that are known better than by the instants.
    """

    omega: float
    subharmonic: int
    time: np.ndarray
    coefficients: np.ndarray
    motion: np.ndarray
    gap: np.ndarray
    force: np.ndarray
    structure: Structure
    friction: float | np.ndarray | None = None
    evaluate: RecordFunction | None = None
    steps: int = 0
    exact: Mapping[str, float] = field(default_factory=dict)

    @property
    def periods(self) -> float:
        """Periods of the load that it lasts."""
        return (len(self.time) - 1) / self.steps if self.steps else self.subharmonic

    @property
    def n_pairs(self) -> int:
        """Pairs of the crack faces; 0 where what they do is known."""
        return self.gap.shape[1] // (1 if self.friction is None else 2)

    def last_periods(self, periods: int) -> Record:
        """The same over the last periods of the load, if it has several."""
        if not self.steps:
            return self
        kept = slice(-periods * self.steps, None)
        names = "time", "motion", "gap", "force"
        return replace(self, **{name: getattr(self, name)[kept] for name in names})

    def select_rows(self, rows: slice) -> Record:
        """The same of some of the rows."""
        whole = self.evaluate
        at = whole and (lambda parts: ((all_of := whole(parts))[0][:, rows], *all_of[1:]))
        return replace(
            self, coefficients=self.coefficients[:, rows], motion=self.motion[:, rows], evaluate=at
        )

    @cached_property
    def pairs_of_cracks(self) -> np.ndarray:
        """True for the pairs of each crack: (n_pairs, n_cracks)."""
        cracks = self.structure.pairs.cracks
        crack_numbers = np.zeros(self.n_pairs, dtype=int) if cracks is None else cracks
        return crack_numbers[:, None] == np.unique(crack_numbers)

    @cached_property
    def maxima(self) -> np.ndarray:
        """Largest values of all products and of their negatives (2 m,), and behind them at the
        crack faces of opening, penetration, contact force of a pair and of a crack (4,)."""
        count, at, members = self.n_pairs, self.evaluate, self.pairs_of_cracks

        def columns(motion: np.ndarray, gap: np.ndarray, force: np.ndarray) -> np.ndarray:
            parts = [motion, -motion]
            if count:
                gap, force = gap[:, :count], force[:, :count]
                parts += [-gap.min(1), gap.max(1), force.max(1), (force @ members).max(1)]
            return np.column_stack(parts)

        samples = columns(self.motion, self.gap, self.force)
        return find_maxima(samples, at and (lambda parts: columns(*at(parts))))


class Harmonics:
    """Harmonics of a displacement.

    Attributes
    ----------
    waves : (2H+1,) [m]
        Its Fourier coefficients.
    mean, first : float [m]
        a0, and U_1, nan where that is 0.
    largest_order, ratio_largest : float
        Order k of the largest harmonic above the load's, and U_k / U_1.
    """

    def __init__(self, waves: np.ndarray, subharmonic: int) -> None:
        self.coefficients, self._periods = waves, subharmonic
        self._levels = np.hypot(waves[1::2], waves[2::2])
        first = self.harmonic(1)
        self.mean, self.fundamental = float(waves[0]), first if first > 0.0 else math.nan
        self.largest_order = self.ratio_largest = math.nan
        above = self._levels[2 * subharmonic - 1 :: subharmonic]
        if len(above):
            place = int(above.argmax())
            self.ratio_largest = float(above[place]) / self.fundamental
            if above[place] > NEGLIGIBLE * np.abs(waves).max():
                self.largest_order = 2.0 + place

    def harmonic(self, multiple: float) -> float:
        """U_j [m]; nan where it is not among the harmonics."""
        order = multiple * self._periods
        known = order == int(order) and order <= len(self._levels)
        return float(self._levels[int(order) - 1]) if known else math.nan

    def ratio(self, multiple: float) -> float:
        """U_j / U_1."""
        return self.harmonic(multiple) / self.fundamental


class Point(Harmonics):
    """A displacement that is watched, a row of a record.

    Attributes
    ----------
    motion : (n,) [m]
        Its values.
    amplitude : float [m]
        Half peak-to-peak.
    """

    def __init__(self, record: Record, row: int) -> None:
        super().__init__(record.coefficients[:, row], record.subharmonic)
        self.motion, many = record.motion[:, row], record.motion.shape[1]
        self.amplitude = 0.5 * float(record.maxima[row] + record.maxima[many + row])


class Faces:
    """The crack faces in a record.

    Attributes
    ----------
    gap, force : (n, n_pairs) [m], [N]
    tops : (4,)
        Largest opening and penetration [m], contact force of a pair and of a crack [N].
    slips, sticks : (n, n_pairs) bool
        With friction where pairs slip and stick, in the last period of the load.
    losses : (n_pairs,) [J]
        Lost by it then.
    """

    def __init__(self, record: Record) -> None:
        count, last = record.n_pairs, record.last_periods(1)
        self.gap, self.force = record.gap[:, :count], record.force[:, :count]
        self.maxima = record.maxima[-4:]
        if record.friction is not None:
            force, drag = np.hsplit(last.force, 2)
            self.slips = is_slipping(record.friction, force, drag)
            self.sticks = (force > 0.0) & ~self.slips
            self.losses = friction_losses(last.gap[:, count:], drag)


def is_slipping(coefficient: Any, force: np.ndarray, drag: np.ndarray) -> np.ndarray:
    """Where pairs slip, by their contact and friction forces (n, n_pairs): (n, n_pairs) bool."""
    return np.asarray((force > 0.0) & (np.abs(drag) >= SLIP_FORCE_RATIO * coefficient * force))


def friction_losses(slide: np.ndarray, drag: np.ndarray) -> np.ndarray:
    """Losses of pairs in a period, (n_pairs,) [J], int lambda_t g_t' dt by the trapezoidal rule:
    of tangential gaps and friction forces at parts of it (n, n_pairs)."""
    moved = np.roll(slide, -1, axis=0) - slide
    return np.asarray(0.5 * np.sum((np.roll(drag, -1, axis=0) + drag) * moved, axis=0))


def rows_of(structure: Structure, dofs: Sequence[int | None]) -> np.ndarray:
    """Return the rows that give the displacements of dofs of the whole structure from its
    coordinates: (m, n_local), to be summed over ranks (collective)."""
    if not dofs:
        return np.zeros((0, structure.n_local))
    if structure.whole is not structure:
        return structure.values_at(np.eye(structure.n_dofs), dofs).T
    wanted = structure.check_dofs(dofs) - structure.first_dof
    return np.asarray(wanted[:, None] == np.arange(structure.n_local), dtype=float)


# --- what observes --------------------------------------------------------------------------------


class ExtraRows(NamedTuple):
    """A place of rows of its own.

    Attributes
    ----------
    rows : (m, n_local)
        What the displacement is multiplied by there.
    numbers : callable
        Returns its numbers by their names from a record of these rows.
    """

    rows: np.ndarray
    read_numbers: Callable[[Record], dict[str, float]]


class Displacement(NamedTuple):
    """A displacement as it is observed: its indicators, and its Fourier coefficients, (2H+1,) [m]
    or along a curve (n, 2H+1)."""

    indicators: Indicators
    coefficients: np.ndarray


class ObservedMotion:
    """A motion, or along a curve many: what follows from its records."""

    structure: Structure

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        """The motion, or that of each point of a curve, seen through rows (m, n_local): of the
        products with its displacement (collective)."""
        raise NotImplementedError

    def indicators(self, dof: int | None = None) -> Indicators:
        """Return the crack indicators at a dof, or the watched one, and at the crack faces
        (collective)."""
        return self.measure([dof])[0]

    def amplitude(self, dof: int | None = None) -> Any:
        """Half the peak-to-peak displacement of a dof, or of the watched one [m] (collective)."""
        return self.indicators(dof).amplitude

    def measure(self, dofs: Sequence[int | None]) -> list[Indicators]:
        """:meth:`indicators` of some dofs; the motion is formed once for all that are new
        (collective)."""
        return [displacement.indicators for displacement in self.observe(dofs)[0]]

    @property
    def faces(self) -> dict[str, Any]:
        """Numbers of the crack faces, where there are some (collective)."""
        if not self._at_faces:
            self.observe_rows(np.zeros((0, self.structure.n_local)))
        numbers = self._gather_numbers(self._at_faces)
        return {name: value for name, value in numbers.items() if not np.all(np.isnan(value))}

    def observe(
        self, dofs: Sequence[int | None], places: Sequence[ExtraRows] = ()
    ) -> tuple[list[Displacement], dict[str, Any]]:
        """Return the displacements of some dofs, and the numbers at places of rows of their own;
        the motion is formed once for all that is new (collective)."""
        structure = self.structure
        wanted = [structure.watched_dof if dof is None else dof for dof in dofs]
        new = [dof for dof in dict.fromkeys(wanted) if dof not in self._displacements]
        numbers: dict[str, Any] = {}
        if new or places:
            displacements, numbers = self.observe_rows(rows_of(structure, new), places)
            self._displacements.update(zip(new, displacements, strict=True))
        return [self._displacements[dof] for dof in wanted], numbers

    def observe_rows(
        self, rows: np.ndarray, places: Sequence[ExtraRows] = ()
    ) -> tuple[list[Displacement], dict[str, Any]]:
        """Return the displacements that rows (m, n_local) give, and the numbers at places of rows
        of their own, from all records in one pass (collective)."""
        ends = np.cumsum([len(rows), *(len(place.rows) for place in places)]).tolist()
        points, waves, numbers = [], [], list[dict[str, float]]()
        for index, whole in enumerate(self.records(np.vstack([rows, *(p.rows for p in places)]))):
            record = whole.last_periods(RECORDED_PERIODS)
            record = record.select_rows(slice(len(rows))) if places else record
            if index < len(self._at_faces):
                record = replace(record, gap=record.gap[:, :0])
            else:
                self._at_faces.append(_read_faces(record))
            shared = {"omega": record.omega} | self._at_faces[index]
            at_rows = (read_at(Place.POINT, Point(record, row)) for row in range(len(rows)))
            points.append([shared | values for values in at_rows])
            waves.append(record.coefficients.T)
            numbers.append({})
            for place, ends_of in zip(places, pairwise(ends), strict=True):
                numbers[-1] |= place.read_numbers(whole.select_rows(slice(*ends_of)))
        columns = (
            Indicators(**self._gather_numbers(values)) for values in zip(*points, strict=True)
        )
        along = (self._gather(list(rows)) for rows in zip(*waves, strict=True))
        return list(map(Displacement, columns, along)), self._gather_numbers(numbers)

    def _gather_numbers(self, values: Sequence[Mapping[str, float]]) -> dict[str, Any]:
        """The same by names."""
        return {name: self._gather([value[name] for value in values]) for name in values[0]}

    def _gather(self, values: list[Any]) -> Any:
        """The value of a motion; of a curve those of its points, as an array."""
        [value] = values
        return value

    @cached_property
    def _displacements(self) -> dict[int, Displacement]:
        """Displacements of dofs that have been observed."""
        return {}

    @cached_property
    def _at_faces(self) -> list[dict[str, float]]:
        """Numbers of the crack faces, once they are observed: at each point of a curve."""
        return []


def _read_faces(record: Record) -> dict[str, float]:
    """Numbers of the crack faces; nan without pairs, or without friction."""
    numbers = dict.fromkeys(names_of(Place.FACES), math.nan)
    if record.n_pairs:
        missing = FRICTION if record.friction is None else FILES
        numbers |= read_at(Place.FACES, Faces(record), missing)
    return numbers | dict(record.exact)
