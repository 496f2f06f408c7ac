"""Smooth interpolation of many quantities over a few unknowns, with its error.

A quantity known on a grid of the unknowns is interpolated by the tensor product of cubic splines
without knots next to the ends (C. de Boor, A Practical Guide to Splines, 1978, chapters 4 and 17).
The error along each axis is estimated from leave-one-out errors: the difference of each node
between the ends from the spline through all others on its line, which is the error of twice the
spacing, 16 times too large where a quantity is smooth, and 4/3 times where meshes make it uneven;
0.3 of it is taken. The errors at the nodes around a point, of all quantities together, are the
covariance of predictions there.

Where a case has failed, a thin plate through the others takes its place, if half of the nodes are
known, and one more than a quadratic polynomial needs: of four none may fail. The difference of the
nearest known node from such a plate without it is the error there, in full. That holds between
known nodes; beyond them a pole of a harmonic is missed.

Smooth forms are interpolated: the logarithms of natural frequencies without the crack, its
additions to them, over its size where that is unknown, and harmonics as complex numbers, a - i b of
a cos + b sin. The amplitudes alone have kinks where they vanish, and both have poles, which move
with the crack, where k times the load's frequency W meets a natural frequency w_j of the breathing
crack with a damping ratio z. The first harmonic moves the crack faces that make the others: these
have its poles, too, of the size p once and of the phase k times, as where all of a motion is as
much larger and later. So of the k-th harmonic it is

    U_k p_k |p_1| exp(i k arg p_1) / s^n,      p_k = prod_j (1 - r^2 + 2 i z r),      r = k W / w_j,

without p_1 of the first, with the bilinear frequencies w_j of the same nodes and the sum s over the
modes of the relative differences between frequencies with the crack bonded and open, each times its
static compliance over that of the first, 1 / w_j^2: as much as the load bends the plate at the
crack, and the crack the plate. It is small for a short crack, which closes in half of each period:
that makes even harmonics, n = 1, and odd ones of second order, n = 2.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator, make_interp_spline
from scipy.spatial.distance import cdist

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import TURN
from fenics_crack.monitoring.identification.measurements import Measurement
from fenics_crack.monitoring.identification.options import OPTIONS
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.file import KEPT_ORDERS, NUMBERED, State
from fenics_crack.sweep.result import SweepResult


@dataclass(frozen=True)
class UnknownGrid:
    """The unknowns between their bounds.

    Attributes
    ----------
    axes : tuple of arrays
        Values of each unknown in ascending order; none at all where there are no unknowns.
    """

    axes: tuple[np.ndarray, ...]

    @property
    def lower_bounds(self) -> np.ndarray:
        """Lower bounds: (d,)."""
        return np.array([axis[0] for axis in self.axes])

    @property
    def upper_bounds(self) -> np.ndarray:
        """Upper bounds: (d,)."""
        return np.array([axis[-1] for axis in self.axes])

    @cached_property
    def nodes(self) -> np.ndarray:
        """All combinations, the last unknown fastest: (n, d)."""
        combinations = list(itertools.product(*self.axes))
        return np.array(combinations, dtype=float).reshape(len(combinations), len(self.axes))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each axis."""
        return tuple(len(axis) for axis in self.axes)

    def find_node_coordinates(self, values: np.ndarray) -> np.ndarray:
        """Places of values (m, d) among the nodes: whole numbers at these: (m, d)."""
        columns = [
            np.interp(column, axis, np.arange(len(axis)))
            for column, axis in zip(values.T, self.axes, strict=True)
        ]
        return np.stack(columns, axis=1)


def _spline(line: np.ndarray, values: np.ndarray) -> Any:
    """Cubic spline through values (n, ...) on a line (n,), of lower degree through fewer than
    four."""
    return make_interp_spline(line, values, k=min(3, len(line) - 1))


def compute_leave_one_out_errors(line: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the difference of each value on a line (n,), but for the ends, from the spline through
    all others: (n, ...) for values (n, ...). The ends, which are never left out, have the errors of
    their neighbours."""
    errors = np.zeros_like(values)
    for place in range(1, len(line) - 1):
        others = np.arange(len(line)) != place
        errors[place] = values[place] - _spline(line[others], values[others])(line[place])
    errors[0], errors[-1] = errors[1], errors[-2]
    return errors


class Interpolation:
    """Interpolates some quantities over the unknowns.

    Parameters
    ----------
    cube : UnknownGrid
        The unknowns.
    values : (n, q)
        Of the quantities at the nodes of the cube; nan where one is not known.

    Attributes
    ----------
    known : (q,) bool
        True where a quantity is known at enough of the nodes.
    between : (q,) bool
        True where every node at which it is not known is between two others on a line.
    """

    def __init__(self, cube: UnknownGrid, values: np.ndarray) -> None:
        self.unknown_grid = cube
        self.is_between_known = _between(cube, np.isfinite(values))
        values, self.has_enough_nodes, of_filled = _filled(cube, values)
        self._values = values
        # Along each axis those that are 1 at one of its values and 0 at the others.
        self._splines = [_spline(line, np.eye(len(line))) for line in cube.axes]
        if cube.axes:
            grid = values.reshape(*cube.shape, values.shape[1])
            left = (
                np.moveaxis(compute_leave_one_out_errors(line, np.moveaxis(grid, k, 0)), 0, k)
                for k, line in enumerate(cube.axes)
            )
            self._errors = [
                OPTIONS.leave_one_out_fraction * one.reshape(values.shape) for one in left
            ]
            if of_filled.any():
                self._errors.append(of_filled)

    def interpolate(self, x: np.ndarray) -> np.ndarray:
        """The quantities at values x (m, d) of the unknowns, those outside taken to the border:
        (m, q), 0 where one is not known."""
        weights = np.ones((len(x), 1))
        for column, line, spline in zip(x.T, self.unknown_grid.axes, self._splines, strict=True):
            own = spline(np.clip(column, line[0], line[-1]))
            weights = (weights[:, :, None] * own[:, None, :]).reshape(len(x), -1)
        return np.asarray(weights @ self._values)

    def compute_weighted_errors(self, x: np.ndarray) -> np.ndarray:
        """Errors of all quantities together at the nodes around values x (m, d), along each axis,
        and where cases failed, weighted so that their covariance is the sum of the squares:
        (m, k, q)."""
        found = self.compute_weighted_errors_by_axis(x)
        return (
            np.concatenate(found, axis=1)
            if found
            else np.zeros((len(x), 0, len(self.has_enough_nodes)))
        )

    def compute_weighted_errors_by_axis(self, x: np.ndarray) -> list[np.ndarray]:
        """The same of each axis, and of failed cases where there are some, apart."""
        if not self.unknown_grid.axes:
            return []
        nodes = self.unknown_grid.find_node_coordinates(self.unknown_grid.nodes)
        exponent = (
            -0.5
            / OPTIONS.error_average_width**2
            * cdist(self.unknown_grid.find_node_coordinates(x), nodes, "sqeuclidean")
        )
        count = min(OPTIONS.max_averaged_nodes, len(nodes))
        near = np.argpartition(-exponent, count - 1, axis=1)[:, :count]
        exponent = np.take_along_axis(exponent, near, axis=1)
        weights = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        weights /= weights.sum(axis=1, keepdims=True)
        return [np.sqrt(weights)[..., None] * own[near] for own in self._errors]


def _between(cube: UnknownGrid, known: np.ndarray) -> np.ndarray:
    """True where all nodes (n, q) that are not known have known ones on both sides, on a line along
    some axis: (q,)."""
    grid = known.reshape(*cube.shape, known.shape[1])
    found = grid.copy()
    for k in range(len(cube.axes)):
        line = np.moveaxis(grid, k, 0)
        below, above = (np.logical_or.accumulate(one) for one in (line, line[::-1]))
        found |= np.moveaxis(below & above[::-1], 0, k)
    return np.asarray(found.reshape(known.shape).all(axis=0))


def _filled(cube: UnknownGrid, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (n, q) with unknown ones taken from a thin plate through the others, 0 where too few
    are known; True where enough are, (q,); and the errors of the values taken."""
    known, d = np.isfinite(values), len(cube.axes)
    least = max((d + 1) * (d + 2) // 2 + 1, len(values) / 2)
    enough = known.all(axis=0) | ((known.sum(axis=0) >= least) & (d > 0))
    found = np.where(known & enough, values, 0.0)
    errors = np.zeros_like(found)
    for place in np.flatnonzero(enough & ~known.all(axis=0)):
        own, column = known[:, place], values[:, place]
        nodes = (cube.nodes - cube.lower_bounds) / (cube.upper_bounds - cube.lower_bounds)
        found[~own, place] = _plate(nodes[own], column[own], nodes[~own])
        for lost in np.flatnonzero(~own):
            distance = np.linalg.norm(nodes - nodes[lost], axis=1)
            near = np.argmin(np.where(own, distance, np.inf))
            left = own & (np.arange(len(own)) != near)
            around = _plate(nodes[left], column[left], nodes[near, None])
            errors[lost, place] = column[near] - around[0]
    return found, enough, errors


def _plate(nodes: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A thin plate through values (n,) at nodes (n, d), at other places (m, d): (m,)."""
    return np.asarray(RBFInterpolator(nodes, values, kernel="thin_plate_spline")(at))


# --- interpolated quantities ----------------------------------------------------------------------

MESH_AXIS_KEY = "mesh.file"
"""The axis of meshes with numbers."""


class SweptLoads:
    """Loads of a forward model, the last axis of its sweeps.

    Where the load is an engine order, each has its speed of the rotor, and the first has that of
    the scene, which is the default of natural frequencies.

    Attributes
    ----------
    frequencies : tuple of float
        In Hz.
    axis : Axis
        Their own, or the rotor's speeds.
    """

    def __init__(self, scene: Scene, frequencies: Sequence[float]) -> None:
        """Take frequencies [Hz]; the scene's own where it follows the rotor, or there is no
        other."""
        order, others = scene.excitation.order, sorted(set(frequencies))
        own = float(f"{scene.excitation.omega / TURN:.9g}")  # as that of arrivals
        if order is None:
            self.frequencies = tuple(others) or (own,)
            self.sweep_axis = Axis("excitation.frequency", self.frequencies)
        else:
            self.frequencies = (own, *(one for one in others if one != own))
            rpm = tuple(60.0 * one / order for one in self.frequencies)
            self.sweep_axis = Axis("rotation.rpm", rpm)

    @property
    def has_rotor_speeds(self) -> bool:
        """True if each has its own speed."""
        return self.sweep_axis.key == "rotation.rpm"

    @property
    def speed_ratios(self) -> np.ndarray:
        """Speeds of the rotor over the scene's own, (n,); 1 where there is no other."""
        found = np.array(self.frequencies)
        return found / found[0] if self.has_rotor_speeds else np.ones(len(found))


class SolvedCases:
    """Solved cases of a sweep for one choice of the words, and those without the crack, if any. Its
    last axis is that of the loads."""

    def __init__(
        self,
        sweep: SweepResult,
        loads: SweptLoads,
        meshes: Sequence[Axis],
        fixed: Mapping[str, Any],
        bare: SolvedCases | None = None,
    ) -> None:
        """Take a sweep, the numbers of its meshes if it has some, and the chosen words."""
        self.sweep_result, self.swept_loads, self.uncracked_cases = sweep, loads, bare
        numbers: list[Axis] = []
        index: list[Any] = []
        for axis in sweep.axes[:-1]:
            word = axis.key in fixed
            index.append(axis.values.index(fixed[axis.key]) if word else slice(None))
            numbers += [] if word else meshes if axis.key == MESH_AXIS_KEY else [axis]
        self.unknown_grid = UnknownGrid(
            tuple(np.array(axis.values, dtype=float) for axis in numbers)
        )
        self.unknown_keys, self.word_index = tuple(axis.key for axis in numbers), tuple(index)

    def get_column(self, name: str) -> np.ndarray:
        """A column at all nodes and load frequencies: (n, n_loads)."""
        values = self.sweep_result[name][self.word_index]
        return np.asarray(values.reshape(-1, values.shape[-1]), dtype=float)

    def get_natural_frequency(self, lips: str, mode: int) -> np.ndarray:
        """A natural frequency at all nodes and loads [Hz]: (n, n_loads); without the crack
        ("uncracked") the same for all cracks, and with a bonded crack where it cannot be
        removed."""
        if lips == "uncracked":
            if self.uncracked_cases is None:
                return self.get_natural_frequency("tied", mode)
            values = self.uncracked_cases.get_natural_frequency("tied", mode)
            pairs = zip(self.unknown_keys, self.unknown_grid.shape, strict=True)
            shape = [
                count if key in self.uncracked_cases.unknown_keys else 1 for key, count in pairs
            ]
            loads = values.shape[1]
            values = np.broadcast_to(
                values.reshape(*shape, loads), (*self.unknown_grid.shape, loads)
            )
            return values.reshape(-1, loads)
        column = self.get_column(f"omega_{lips}_{mode}") / (2.0 * np.pi)
        if self.swept_loads.has_rotor_speeds:
            return column
        known = np.isfinite(column)
        best = np.max(np.where(known, column, -np.inf), axis=1, keepdims=True)
        best = np.where(known.any(axis=1, keepdims=True), best, np.nan)
        return np.broadcast_to(best, column.shape)

    def get_harmonic(self, point: str, frequency: float, order: int) -> np.ndarray:
        """Complex amplitude of a harmonic at all nodes: (n,) [m]; 0 where a case has fewer."""
        of = f"{point}." if point else ""
        cosine, sine = (self.get_column(f"{of}{part}_{order}") for part in ("cosine", "sine"))
        load = self.find_load_index(frequency)
        fewer = self.get_column("harmonics")[:, load] < order
        value = np.where(fewer, 0.0, (cosine - 1j * sine)[:, load])
        return np.where(self.get_column("state")[:, load] == State.CONVERGED, value, np.nan)

    def count_harmonics(self, frequency: float) -> int:
        """Minimum number of harmonics of the solved cases at a load; 1 if none was solved."""
        load = self.find_load_index(frequency)
        solved = self.get_column("state")[:, load] == State.CONVERGED
        return int(self.get_column("harmonics")[solved, load].min()) if solved.any() else 1

    def find_load_index(self, frequency: float) -> int:
        """Index of a load frequency [Hz] among those of the sweep, 0 for 0 Hz; InputError if there
        is none."""
        loads = self.swept_loads.frequencies
        if frequency == 0.0:
            return 0
        if frequency not in loads:
            solved = ", ".join(f"{load:.9g}" for load in loads)
            allowed = f"one of those that are solved, {solved} Hz; identify.frequencies adds others"
            raise InputError("measurements.frequency", frequency, allowed)
        return loads.index(frequency)

    @cached_property
    def scale_and_frequencies(self) -> np.ndarray:
        """Root of s, the bilinear frequencies [Hz], and those without the crack, at all nodes and
        loads: (n, n_loads, 1 + 2 modes); 1 for s without a crack, nan where there is no
        frequency."""
        tied, opened, breathing, bare = (
            np.stack([self.get_natural_frequency(lips, mode) for mode in NUMBERED], axis=2)
            for lips in ("tied", "open", "bilinear", "uncracked")
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            parts = (tied - opened) / tied * (tied[..., :1] / tied) ** 2
            split = np.nan_to_num(parts, posinf=0.0, neginf=0.0).sum(axis=2)
        scale = np.where(split > 1e-9, np.sqrt(np.abs(split)), 1.0)
        return np.concatenate([scale[..., None], breathing, bare], axis=2)


RESONANCE_STATES = ("bilinear", "open", "tied")
"""States of the crack faces at a resonance: breathing, open, closed."""


@dataclass(frozen=True)
class Feature:
    """An interpolated quantity: a natural frequency at the speed of a load, 0 for the scene's own,
    or a harmonic of a point at a load."""

    crack_state: str = ""
    mode: int = 0
    point: str = ""
    frequency: float = 0.0
    order: int = 0

    @classmethod
    def of(cls, row: Measurement, scene: Scene) -> tuple[Feature, ...]:
        """Features of a measurement of a scene; of a ratio both harmonics, the one above first."""
        if row.natural:
            lips = row.quantity.removeprefix("frequency_")
            states = RESONANCE_STATES if lips == "resonance" else (lips,)
            return tuple(cls(state, row.mode, frequency=row.load(scene)) for state in states)
        orders = row.orders or KEPT_ORDERS
        return tuple(cls("", 0, row.point, row.load(scene), order) for order in orders)

    @property
    def error_group(self) -> tuple[float, float, float]:
        """Key of features with a common error: those of a mode, or of one contact."""
        return (self.mode, 0.0 if self.is_natural_frequency else self.frequency, self.order)

    @property
    def uncracked_feature(self) -> Feature:
        """The same natural frequency without the crack."""
        return replace(self, crack_state="uncracked")

    def get_node_values(self, part: SolvedCases) -> np.ndarray:
        """Values at all nodes of a sweep: (n,), logarithms or complex numbers."""
        if self.is_natural_frequency:
            own = part.get_natural_frequency(self.crack_state, self.mode)[
                :, part.find_load_index(self.frequency)
            ]
            return np.log(own).astype(complex)
        return part.get_harmonic(self.point, self.frequency, self.order)

    @property
    def scale_power(self) -> int:
        """n of s^n, to which a harmonic is proportional."""
        return 1 + self.order % 2 if self.order > 1 else 0

    @property
    def is_natural_frequency(self) -> bool:
        """True if it is a natural frequency."""
        return bool(self.crack_state)

    @property
    def is_cracked_frequency(self) -> bool:
        """True if it is a natural frequency that the crack changes."""
        return self.crack_state in ("open", "tied", "bilinear")


def poles(
    features: Sequence[Feature], damping: np.ndarray, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return r of each mode, and 1 - r^2 + 2 i z r, at m places: (m, f, modes).

    They follow from ratios of damping (m, 1), and :attr:`SolvedCases.scale_and_frequencies` at the load of each feature
    (m, f, 1 + 2 modes); 0 and 1 of natural frequencies and where there is no mode.
    """
    own = basis[..., NUMBERED]
    loads = np.array([feature.order * feature.frequency for feature in features])
    r = loads[:, None] / np.where(np.isfinite(own), own, np.inf)
    return r, 1.0 - r**2 + 2j * damping[..., None] * r


def turned(values: np.ndarray, features: Sequence[Feature]) -> np.ndarray:
    """Return parts of harmonics (m, f, ...) in the logarithms of the first one that drives them: of
    its size once, of its phase as often as their order; 0 of others."""
    orders = np.array([feature.order if feature.order > 1 else 0 for feature in features])
    orders = orders.reshape(-1, *np.ones(values.ndim - 2, dtype=int))
    return np.where(orders > 0, values.real, 0.0) + 1j * orders * values.imag


def driving(features: Sequence[Feature]) -> list[Feature]:
    """Return the first harmonics that drive some features."""
    return [replace(feature, order=int(feature.order > 1)) for feature in features]


def scales(
    features: Sequence[Feature], damping: np.ndarray, basis: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Return factors that make the values smooth: (m, f), from :func:`poles` and sizes of the crack
    (m,)."""
    powers = np.array([feature.scale_power for feature in features])
    changed = np.array([feature.is_cracked_frequency for feature in features])
    found = poles(features, damping, basis)[1].prod(axis=2) / basis[..., 0] ** (2 * powers)
    first = poles(driving(features), damping, basis)[1].prod(axis=2)
    found = found * np.exp(turned(np.log(first), features))
    return np.where(changed, 1.0 / size[:, None], found)
