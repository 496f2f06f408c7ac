"""The forward model: what would be measured with given unknowns, and how far that may be wrong.

What is interpolated between the cases of a sweep is smooth in the unknowns: the logarithms of
natural frequencies, and the harmonics as complex numbers, a - i b of a cos + b sin. Their
amplitudes alone have kinks where they vanish, and both have poles, which move with the crack, where
k times the load's frequency W meets a natural frequency w_j of the breathing crack with a damping
ratio z. So of the k-th harmonic it is

    U_k prod_j (1 - r^2 + 2 i z r) / s^n,      r = k W / w_j,

with the bilinear frequencies w_j of the same nodes and the sum s over the modes of the relative
differences between frequencies with lips tied and open. It is small for a short crack, whose lips
close in half of each period: that makes even harmonics, n = 1, and odd ones of second order, n = 2.

Errors of predictions are not independent. One sweep makes all of them, so they are taken as a
covariance: of the interpolation from what each node differs by from the others, all quantities at
once; of the mesh from what a finer one changes, half of it alike in all quantities.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.identification.alignment import Passages
from fenics_crack.identification.interpolation import Cube, Interpolation
from fenics_crack.identification.measurements import Measurement
from fenics_crack.model.bilinear import FEW
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.file import CONVERGED, ORDERS
from fenics_crack.sweep.result import SweepResult

__all__ = ["Model", "Part", "Prediction", "Quantities"]

DEFAULT_RATIO = 0.01
"""Of damping, where a scene's is a matrix."""
RATIOS = ("ratio_2_1", "ratio_3_1")
LIPS = {"uncracked": ("open",), "bilinear": ("open", "tied"), "resonance": ("open", "tied")}
"""Of what natural frequencies are made."""
OFF = {1: 0.04}
OFTEN_OFF = 0.3
"""Root of the mean square of what a resonance differs by from the bilinear frequency, over what
lies between the frequencies with lips tied and open: of the first mode, and of others, near which
the gap follows their neighbours, too."""
ALIKE = 0.5
"""Part of the variance left by the mesh, and of that of contact, which quantities have together."""


@dataclass(frozen=True)
class Part:
    """What a sweep knows, with its words chosen."""

    sweep: SweepResult
    keys: tuple[str, ...]
    cube: Cube
    index: tuple[Any, ...]

    @classmethod
    def of(cls, sweep: SweepResult, chosen: Sequence[int | None]) -> Part:
        """Of a sweep, and the number of the word chosen on each axis, None on one of numbers."""
        numbers = [a for a, at in zip(sweep.axes, chosen, strict=False) if at is None]
        index = tuple(slice(None) if at is None else at for at in chosen)
        cube = Cube(tuple(np.array(axis.values, dtype=float) for axis in numbers))
        return cls(sweep, tuple(axis.key for axis in numbers), cube, index)

    def column(self, name: str) -> np.ndarray:
        """A column at all nodes and load frequencies: (n, n_loads)."""
        values = self.sweep[name][self.index]
        return np.asarray(values.reshape(-1, values.shape[-1]), dtype=float)

    def natural(self, lips: str, mode: int) -> np.ndarray:
        """A natural frequency at all nodes [Hz]: (n,); of an uncracked plate the same for all."""
        column = self.column(f"omega_{lips}_{mode}") / (2.0 * np.pi)
        known = np.isfinite(column)
        best = np.max(np.where(known, column, -np.inf), axis=1)
        return np.where(known.any(axis=1), best, np.nan)

    def harmonic(self, point: str, frequency: float, order: int) -> np.ndarray:
        """Complex amplitude of a harmonic at all nodes: (n,) [m]; 0 where a case has fewer."""
        parts = []
        for part in ("cosine", "sine"):
            name = f"{point}.{part}_{order}" if point else f"{part}_{order}"
            if name not in self.sweep.columns:
                points = self.sweep.scene.output.points if self.sweep.scene.output else ()
                known = [f"{one.key}.u{axis}" for one in points for axis in "xy"]
                allowed = f"empty, or one of [output.points]: {', '.join(known) or 'none there'}"
                raise InputError("measurements.point", point, allowed)
            parts.append(self.column(name))
        loads = self.sweep.axes[-1].values
        if frequency not in loads:
            solved = ", ".join(f"{load:.9g}" for load in loads)
            allowed = f"one of those that are solved, {solved} Hz; identify.frequencies adds others"
            raise InputError("measurements.frequency", frequency, allowed)
        load = loads.index(frequency)
        fewer = self.column("harmonics")[:, load] < order
        value = np.where(fewer, 0.0, (parts[0] - 1j * parts[1])[:, load])
        return np.where(self.column("state")[:, load] == CONVERGED, value, np.nan)

    @cached_property
    def resonances(self) -> np.ndarray:
        """Bilinear frequencies at all nodes [Hz]: (n, modes); nan where there is none."""
        lips = [
            np.stack([self.natural(state, mode + 1) for mode in range(FEW)], axis=1)
            for state in ("open", "tied")
        ]
        with np.errstate(divide="ignore", invalid="ignore"):
            found = 2.0 / (1.0 / lips[0] + 1.0 / lips[1])
        return np.where(np.isfinite(found), found, np.nan)

    @cached_property
    def strength(self) -> np.ndarray:
        """How much the crack softens the plate, s, at all nodes: (n,); 1 without a crack."""
        total = np.zeros(len(self.cube.nodes))
        for mode in range(1, FEW + 1):
            tied, is_open = self.natural("tied", mode), self.natural("open", mode)
            with np.errstate(invalid="ignore"):
                total += np.nan_to_num((tied - is_open) / tied, posinf=0.0, neginf=0.0)
        return np.where(total > 1e-9, total, 1.0)


class Model:
    """Predicts what would be measured, with the covariance of the predictions.

    Parameters
    ----------
    scene : Scene
        For its damping.
    coarse, finer : Part
        The sweep, and that of the finer mesh, or None.
    fixed : mapping of str to object
        The unknowns that are words, and their values here.
    """

    def __init__(
        self, scene: Scene, coarse: Part, finer: Part | None, fixed: Mapping[str, Any]
    ) -> None:
        self._scene, self.coarse, self.finer = scene, coarse, finer
        self.fixed, self.keys, self.cube = dict(fixed), coarse.keys, coarse.cube

    def quantities(
        self, rows: Sequence[Measurement], more: Sequence[Measurement] = ()
    ) -> Quantities:
        """Some measurements, ready to be predicted; and more that were not made, but might be."""
        return Quantities(self, rows, more)

    def damping(self, x: np.ndarray) -> np.ndarray:
        """A ratio of damping at values (m, d) of the unknowns: (m, 1)."""
        if "damping.ratio" in self.keys:
            return x[:, [self.keys.index("damping.ratio")]]
        table = self._scene.damping
        ratio = None if table is None else table.ratio
        if table is not None and ratio is None:
            ratio = table.ratios
        return np.full((len(x), 1), DEFAULT_RATIO if ratio is None else np.mean(ratio))

    def scale(self, x: np.ndarray, key: Feature, own: np.ndarray) -> np.ndarray:
        """What multiplies a complex harmonic to make it smooth, at values x (m, d): (m,); ``own``
        (m, 1 + modes) are the strength and the bilinear frequencies there."""
        if key.lips:
            return np.ones(len(x))
        r = key.order * key.frequency / own[:, 1:]
        factors = 1.0 - r**2 + 2j * self.damping(x) * r
        power = 0 if key.order == 1 else 1 + key.order % 2
        return np.nanprod(factors, axis=1) / own[:, 0] ** power

    @property
    def finer_by(self) -> float:
        """How much finer the mesh of the correction is."""
        assert self._scene.identify is not None
        return self._scene.identify.finer

    @property
    def uneven(self) -> float:
        """Least relative standard deviation of the higher harmonics."""
        assert self._scene.identify is not None
        return self._scene.identify.harmonic_deviation

    def candidates(self) -> tuple[Measurement, ...]:
        """What might be measured: natural frequencies, and ratios of harmonics at the points and
        load frequencies of the sweep."""
        kinds = [f"frequency_{lips}" for lips in ("open", "tied", "resonance")]
        rows = [Measurement(k, 1.0, 1.0, mode=mode + 1) for k in kinds for mode in range(FEW)]
        sweep = self.coarse.sweep
        points = sweep.scene.output.points if sweep.scene.output else ()
        seen = ["", *(f"{point.key}.u{axis}" for point in points for axis in "xy")]
        for load, point, ratio in itertools.product(sweep.axes[-1].values, seen, RATIOS):
            rows.append(Measurement(ratio, 1.0, 1.0, frequency=load, point=point))
        return tuple(rows)


@dataclass(frozen=True)
class Feature:
    """Something that is interpolated: a natural frequency, or a harmonic of a point at a load."""

    lips: str = ""
    mode: int = 0
    point: str = ""
    frequency: float = 0.0
    order: int = 0

    @classmethod
    def of(cls, row: Measurement) -> tuple[Feature, ...]:
        """Of a measurement; of a ratio both harmonics, the one above first."""
        if row.natural:
            lips = row.quantity.removeprefix("frequency_")
            states = LIPS.get(lips, (lips,))
            return tuple(cls(state, row.mode) for state in states)
        orders: Sequence[int] = ORDERS
        if row.quantity != "displacement":
            orders = [int(part) for part in row.quantity.split("_")[1:]]
        return tuple(cls("", 0, row.point, float(row.frequency), order) for order in orders)

    @property
    def together(self) -> tuple[float, float, float]:
        """Features for which this is the same err alike: a mode's, and those of one contact."""
        return (self.mode, self.frequency, self.order)

    def values(self, part: Part) -> np.ndarray:
        """At all nodes of a sweep: (n,), logarithms or complex numbers."""
        if self.lips:
            return np.log(part.natural(self.lips, self.mode)).astype(complex)
        return part.harmonic(self.point, self.frequency, self.order)


@dataclass(frozen=True)
class Prediction:
    """What q measurements would be, at m values of the unknowns.

    Attributes
    ----------
    values : (m, q)
    covariance : (m, q, q)
        Of their errors.
    free : (m, q, s)
        How much they change with what is not known of the load and the probes, by a standard
        deviation of each.
    known : (q,) bool
        Whether the model tells anything of a measurement.
    """

    values: np.ndarray
    covariance: np.ndarray
    free: np.ndarray
    known: np.ndarray

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of the model: (m, q); inf where it knows nothing."""
        squares = np.diagonal(self.covariance, axis1=1, axis2=2)
        return np.where(self.known, np.sqrt(squares), np.inf)


class Quantities:
    """Predictions of some measurements, and of some ``more`` that were not made, by a model."""

    def __init__(
        self, model: Model, rows: Sequence[Measurement], more: Sequence[Measurement] = ()
    ) -> None:
        self.model, self.rows = model, (*rows, *more)
        self._of_rows = [Feature.of(row) for row in self.rows]
        self._features = tuple(dict.fromkeys(one for found in self._of_rows for one in found))
        self._at = {feature: place for place, feature in enumerate(self._features)}
        self._passages = Passages.among(rows, more)
        self._alike = _alike(self._features)
        part, fine = model.coarse, model.finer
        self._basis = Interpolation(part.cube, np.log(_basis(part)))
        self._coarse = Interpolation(part.cube, _pairs(self._smooth(part)))
        known = np.isfinite(self._coarse.error)
        # An error of the first order leaves d / (f - 1) where a mesh finer by f changes d, one of
        # high order nothing: half of the former is added, and may be wrong.
        self._correction: Interpolation | None = None
        self._left = 0.5 / max(model.finer_by - 1.0, 0.1)
        if fine is not None:
            own = self._coarse.at(fine.cube.nodes)
            self._correction = Interpolation(fine.cube, _pairs(self._smooth(fine)) - own)
            known &= np.isfinite(self._correction.error)
        of_features = known.reshape(-1, 2).all(axis=1)
        self._known = np.array([all(of_features[self._at[f]] for f in r) for r in self._of_rows])

    def _smooth(self, part: Part) -> np.ndarray:
        """The smooth forms of all features at the nodes of a sweep: (n, q), complex."""
        nodes = part.cube.nodes
        own = self._own(nodes)  # of the coarse sweep, for the finer one too
        columns = [f.values(part) * self.model.scale(nodes, f, own) for f in self._features]
        return np.stack(columns, axis=1)

    def _own(self, x: np.ndarray) -> np.ndarray:
        """Strength and bilinear frequencies at values (m, d) of the unknowns: (m, 1 + modes)."""
        return np.where(np.isfinite(self._basis.error), np.exp(self._basis.at(x)), np.nan)

    def __call__(self, x: np.ndarray) -> Prediction:
        """Predictions at some values (m, d) of the unknowns."""
        smooth, left, scatter = self._of_features(x)
        own = self._own(x)
        scales = [self.model.scale(x, feature, own) for feature in self._features]
        values = np.zeros((len(x), len(self.rows)))
        slopes = np.zeros((len(x), len(self.rows), smooth.shape[1]))
        rest = np.zeros_like(values)
        waves = (smooth[:, ::2] + 1j * smooth[:, 1::2]) / np.stack(scales, axis=1)
        for place, (row, features) in enumerate(zip(self.rows, self._of_rows, strict=True)):
            if row.quantity == "displacement":
                continue
            at = [self._at[feature] for feature in features]
            parts = [
                _natural(smooth[:, 2 * k]) if features[0].lips else _size(waves[:, k], scales[k])
                for k in at
            ]
            values[:, place], weights = _together(row, [value for value, _ in parts])
            for k, weight, (_, slope) in zip(at, weights, parts, strict=True):
                slopes[:, place, 2 * k : 2 * k + 2] = weight[:, None] * slope
            if row.quantity == "frequency_resonance":
                split = parts[1][0] - parts[0][0]
                shift = values[:, place] * self.model.damping(x)[:, 0] ** 2
                rest[:, place] = (OFF.get(row.mode, OFTEN_OFF) * split) ** 2 + shift**2
        free = []
        for passages in self._passages:
            at = [self._at[feature] for feature in self._of_rows[passages.rows[0]]]
            found = passages.aligned(waves[:, at])
            values[:, passages.rows], rest[:, passages.rows] = found.values, found.rest**2
            for order, k in enumerate(at):
                turned = found.turns[:, :, order] / scales[k][:, None]
                slopes[:, passages.rows, 2 * k] = turned.real
                slopes[:, passages.rows, 2 * k + 1] = -turned.imag
            directions = np.zeros((*values.shape, found.free.shape[2]))
            directions[:, passages.rows] = found.free
            free.append(directions)
        slopes[:, ~self._known] = 0.0
        errors = self._errors(smooth, left, scatter, slopes)
        total = errors @ errors.transpose(0, 2, 1) + rest[:, :, None] * np.eye(len(self.rows))
        moved = np.concatenate([np.zeros((*values.shape, 0)), *free], axis=2)
        return Prediction(np.where(self._known, values, np.nan), total, moved, self._known)

    def _of_features(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Smooth forms as pairs of columns, what the mesh may have left of an error, (m, 2f) each,
        and errors at the nodes around, (m, k, 2f) of each sweep."""
        smooth, scatter = self._coarse.at(x), [self._coarse.scatter(x)]
        left = np.zeros_like(smooth)
        if self._correction is not None:
            difference = self._correction.at(x)
            left = self._left * difference
            smooth = smooth + difference + left
            scatter.append(self._correction.scatter(x))
        return smooth, left, scatter

    def _errors(
        self, smooth: np.ndarray, left: np.ndarray, scatter: list[np.ndarray], slopes: np.ndarray
    ) -> np.ndarray:
        """Errors of the rows, each independent of the others: (m, q, r)."""
        together, apart = np.sqrt(ALIKE), np.sqrt(1.0 - ALIKE)
        found = []
        for errors in scatter:
            found.append(together * slopes @ errors.transpose(0, 2, 1))
            found.append(apart * slopes * np.sqrt(np.sum(errors**2, axis=1))[:, None, :])
        of_mesh = slopes * left[:, None, :]
        found.append(together * of_mesh.sum(axis=2, keepdims=True))
        found.append(apart * of_mesh @ self._alike)
        if self.model.uneven:
            upper = np.repeat([feature.order > 1 for feature in self._features], 2)
            turned = np.stack([-smooth[:, 1::2], smooth[:, ::2]], axis=2).reshape(smooth.shape)
            each = np.kron(np.eye(len(self._features)), np.ones((2, 1)))
            for part in (smooth, turned):
                of_contact = self.model.uneven * slopes * (part * upper)[:, None, :]
                found += [together * of_contact @ self._alike, apart * of_contact @ each]
        return np.concatenate(found, axis=2)


def _alike(features: Sequence[Feature]) -> np.ndarray:
    """Which pairs of columns err alike by the mesh, or by contact on it: (2f, groups), 0 or 1."""
    groups = list(dict.fromkeys(feature.together for feature in features))
    own = [[float(feature.together == group) for group in groups] for feature in features]
    return np.repeat(own, 2, axis=0)


def _basis(part: Part) -> np.ndarray:
    """Strength and bilinear frequencies at the nodes of a sweep: (n, 1 + modes)."""
    return np.column_stack([part.strength, part.resonances])


def _pairs(values: np.ndarray) -> np.ndarray:
    """Complex columns (n, q) as real and imaginary ones, one beside the other: (n, 2q)."""
    return np.stack([values.real, values.imag], axis=2).reshape(len(values), -1)


def _natural(logarithm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A natural frequency (m,) from its logarithm, and its slopes by the pair of columns (m, 2)."""
    value = np.exp(logarithm)
    return value, np.column_stack([value, np.zeros_like(value)])


def _size(wave: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An amplitude (m,) from the complex harmonic, and its slopes by the smooth pair (m, 2); of an
    amplitude 0 those of its real part."""
    size = np.abs(wave)
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = np.where(size > 0.0, np.conj(wave) / size, 1.0) / scale
    return size, np.column_stack([turned.real, -turned.imag])


def _together(
    row: Measurement, parts: Sequence[np.ndarray]
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """A quantity (m,) from its parts, and its slopes by them."""
    if len(parts) == 1:
        return parts[0], (np.ones_like(parts[0]),)
    one, two = parts
    if row.natural:  # the bilinear frequency
        value = 2.0 * one * two / (one + two)
        return value, (value**2 / (2.0 * one**2), value**2 / (2.0 * two**2))
    return one / two, (1.0 / two, -one / two**2)
