"""The forward model: predictions of measurements from the unknowns, and their covariance.

Errors of predictions are not independent, because one sweep makes all of them. Their covariance is
the sum of that of the interpolation, from leave-one-out errors of all quantities at once; of the
mesh, from the changes by a finer one, half of the variance common to all quantities; and of the
priors (:mod:`fenics_crack.monitoring.identification.nuisance`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from fenics_crack.basics.errors import FEW_MODES, MOST_HARMONICS
from fenics_crack.monitoring.identification.interpolation import (
    RESONANCE_STATES,
    Feature,
    Interpolation,
    SolvedCases,
    compute_ratios_and_poles,
    compute_smoothing_factors,
)
from fenics_crack.monitoring.identification.measurements import Measurement
from fenics_crack.monitoring.identification.nuisance import (
    CRACK_SIZE_KEYS,
    BaselineChanges,
    UncrackedPlate,
    compute_crack_deviations,
)
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import scales_with_load
from fenics_crack.sweep.file import NUMBERED

# --- displacements at probes ----------------------------------------------------------------------


class ProbeDisplacements:
    """Displacements of one point under one load of unknown size and phase.

    Under a steady load the blade tip is, at a phase theta of the load's period,

        u = A Re sum_k U_k exp(i k (theta - psi)) + c,

    with the harmonics U_k of the model and three unknowns of a blade in operation: the size A and
    the phase psi of the load, and a constant c, of the probes' angles and of the steady forces. For
    each value of the unknowns the three are fitted to the displacements; the predictions are the
    fit, and the likelihood gets their derivatives by the three as common errors of all
    displacements. All harmonics of the model enter the fit.

    Parameters
    ----------
    rows : sequence of int
        Their places among all measurements, those made first.
    made : sequence of Measurement
        All measurements made.
    more : sequence of Measurement
        Possible further ones.
    """

    def __init__(
        self, rows: Sequence[int], made: Sequence[Measurement], more: Sequence[Measurement]
    ) -> None:
        self.row_indices, every = list(rows), (*made, *more)
        own = [every[place] for place in self.row_indices if place < len(made)]
        self._phases = np.array([every[place].phase for place in self.row_indices])
        self._count, self._values = len(own), np.array([row.value for row in own])
        self._weights = 1.0 / np.array([row.deviation for row in own])

    @classmethod
    def group_measurements(
        cls, made: Sequence[Measurement], more: Sequence[Measurement]
    ) -> list[ProbeDisplacements]:
        """Group measurements by load and point."""
        groups: dict[tuple[float, str], list[int]] = {}
        for place, row in enumerate((*made, *more)):
            if row.quantity == "displacement":
                groups.setdefault((row.frequency, row.point), []).append(place)
        return [cls(places, made, more) for places in groups.values()]

    def compute_harmonic_covariances(self, orders: np.ndarray) -> np.ndarray:
        """Covariance of the displacements by a harmonic of mean square 1 and any phase, of each of
        some orders (k,): (k, n, n)."""
        apart = self._phases[:, None] - self._phases
        return np.asarray(0.5 * np.cos(np.multiply.outer(orders, apart)))

    def fit_harmonics(
        self, waves: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The displacements of harmonics U_k (m, K) [m], fitted to measured ones.

        All of them, also those that were not measured: (m, n) [m]; their slopes t (m, n, K) by the
        harmonics, of which they are Re sum_k t_k U_k + c; their changes by a standard deviation of
        A, psi and c: (m, n, 3) [m]; and A: (m,).
        """
        orders = np.arange(1, waves.shape[1] + 1)
        turns = np.exp(1j * np.multiply.outer(self._phases, orders))
        size, shift, constant = np.ones(len(waves)), np.zeros(len(waves)), np.zeros(len(waves))
        if self._count:
            size, shift, constant = self._fitted(waves, turns[: self._count], orders)
        turned = turns * (size[:, None] * np.exp(-1j * np.outer(shift, orders)))[:, None, :]
        parts = turned * waves[:, None, :]
        motion = parts.sum(axis=2).real
        # Priors that are wide: all of the size, a phase anywhere in the period, a constant of ten
        # times the largest displacement.
        phase = np.pi / np.sqrt(3.0) * (orders * parts).sum(axis=2).imag
        largest = 10.0 * np.max(np.abs(self._values), initial=0.0)
        free = np.stack([motion, phase, np.full_like(motion, largest)], axis=2)
        return motion + constant[:, None], turned, free, size

    def _fitted(
        self, waves: np.ndarray, turns: np.ndarray, orders: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Least squares of A > 0, psi and c, (m,) each, of all m at once: the best of 64 phases,
        then four damped steps of Gauss and Newton."""
        tried = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        shifted = waves[:, None, :] * np.exp(-1j * np.multiply.outer(tried, orders))
        motion = (shifted @ turns.T).real  # (m, tried, n)
        share = self._weights**2 / np.sum(self._weights**2)
        values = self._values - share @ self._values
        about = motion - (motion @ share)[..., None]
        product = about @ (share * values)
        square = np.maximum((about**2) @ share, np.finfo(float).tiny)
        gained = np.where(product > 0.0, product**2 / square, 0.0)
        best = gained.argmax(axis=1)
        each = np.arange(len(waves))
        size, shift = product[each, best] / square[each, best], tried[best]
        constant = share @ self._values - size * (motion[each, best] @ share)
        for _ in range(4):
            parts = waves[:, None, :] * turns * np.exp(-1j * np.outer(shift, orders))[:, None, :]
            motion = parts.sum(axis=2).real
            slope = size[:, None] * (orders * parts).sum(axis=2).imag
            left = self._weights * (self._values - size[:, None] * motion - constant[:, None])
            scale = np.array([1.0, 1.0, np.max(np.abs(self._values)) + np.finfo(float).tiny])
            columns = np.stack([motion * size[:, None], slope, np.ones_like(motion)], axis=2)
            columns = columns * scale * self._weights[:, None]
            square = columns.transpose(0, 2, 1) @ columns + 1e-3 * np.eye(3)
            step = np.linalg.solve(square, columns.transpose(0, 2, 1) @ left[..., None])[..., 0]
            size = size * np.exp(np.clip(step[:, 0], -1.0, 1.0))
            shift = shift + np.clip(step[:, 1], -0.1, 0.1)
            constant = constant + scale[2] * step[:, 2]
        return size, shift, constant


# --- the model ------------------------------------------------------------------------------------


class FaceState(NamedTuple):
    """State of the crack faces at resonances: they breathe, stay open or stay closed.

    Attributes
    ----------
    state : str
        One of RESONANCE_STATES.
    common, apart : float
        Standard deviation of resonances from the frequency of that state, over the difference
        between the frequencies with the crack bonded and open, common to all and independent; for
        breathing faces in addition to those of each mode.
    weight : float
        Prior probability, up to a common factor.
    """

    state: str
    common: float = 0.0
    apart: float = 0.0
    weight: float = 1.0


BREATHING_FACES = FaceState("bilinear")
"""Open half of the period."""


class ForwardModel:
    """Predictions of measurements, with their covariance.

    Parameters
    ----------
    scene : Scene
        For its damping, and its table ``[identify]``.
    whole : UncrackedPlate
        The plate without its crack.
    parts : (coarse, finer, between)
        The sweep; that of the finer mesh, or None; and that halfway between the nodes, or None.
    fixed : mapping of str to object
        The unknowns that are words, and their values here.
    """

    def __init__(
        self,
        scene: Scene,
        whole: UncrackedPlate,
        parts: Sequence[SolvedCases | None],
        *,
        fixed: Mapping[str, Any],
    ) -> None:
        self.scene, self.identify_table, self.uncracked_plate = (
            scene,
            scene.given("identify"),
            whole,
        )
        coarse, self.finer_cases, self.halfway_cases = parts
        assert coarse is not None
        self.coarse_cases = coarse
        self.word_by_key, self.unknown_keys, self.unknown_grid = (
            dict(fixed),
            coarse.unknown_keys,
            coarse.unknown_grid,
        )

    def make_predictor(
        self, rows: Sequence[Measurement], more: Sequence[Measurement] = ()
    ) -> Predictor:
        """Predictor of some measurements, and of possible further ones."""
        return Predictor(self, rows, more)

    def get_damping_ratios(self, x: np.ndarray) -> np.ndarray:
        """A ratio of damping at values (m, d) of the unknowns: (m, 1)."""
        if "damping.ratio" in self.unknown_keys:
            return x[:, [self.unknown_keys.index("damping.ratio")]]
        ratio, damping = None, self.scene.damping
        if damping is not None:
            ratio = damping.ratios if damping.ratio is None else damping.ratio
        return np.full((len(x), 1), 0.01 if ratio is None else np.mean(ratio))  # of a matrix

    def compute_crack_sizes(self, x: np.ndarray) -> np.ndarray:
        """Length of the crack over the longest, times the same of its depth, at values (m, d) of
        the unknowns: (m,); 1 if it is no unknown."""
        places = [place for place, key in enumerate(self.unknown_keys) if key in CRACK_SIZE_KEYS]
        return np.asarray(np.prod(x[:, places] / self.unknown_grid.upper_bounds[places], axis=1))

    def compute_crack_deviations(self, x: np.ndarray) -> np.ndarray:
        """Standard deviations (m, d) of a crack from the equivalent one, at values (m, d) of the
        unknowns."""
        return compute_crack_deviations(x, self.unknown_keys, self.scene)

    def list_candidates(self) -> tuple[Measurement, ...]:
        """List possible measurements: natural frequencies, ratios of harmonics at the points and
        load frequencies of the sweep."""
        kinds = ["frequency_open", "frequency_tied", "frequency_resonance"]
        if self.coarse_cases.uncracked_cases is not None:
            kinds.append("frequency_uncracked")
        rows = [Measurement(k, 1.0, 1.0, mode + 1) for k in kinds for mode in range(FEW_MODES)]
        loads, ratios = self.coarse_cases.swept_loads.frequencies, ("ratio_2_1", "ratio_3_1")
        seen = ["", *self.coarse_cases.sweep_result.scene.point_names]
        for load, point, ratio in itertools.product(loads, seen, ratios):
            rows.append(Measurement(ratio, 1.0, 1.0, frequency=load, point=point))
        return tuple(rows)


@dataclass(frozen=True)
class Prediction:
    """Prediction of q measurements, at m values of the unknowns.

    Attributes
    ----------
    values : (m, q)
    covariance : (m, q, q)
        Of their errors.
    free : (m, q, s)
        Their changes by a standard deviation of each unknown of the load and the probes.
    known : (q,) bool
        True where a measurement can be predicted.
    """

    values: np.ndarray
    covariance: np.ndarray
    load_changes: np.ndarray
    is_predictable: np.ndarray


class FeaturePrediction(NamedTuple):
    """Features at m values of the unknowns.

    Attributes
    ----------
    damping : (m, 1)
        Ratios.
    basis : (m, f, 1 + 2 modes)
        :attr:`SolvedCases.scale_and_frequencies` there at the load of each feature.
    scale : (m, f)
        Factors that make features smooth.
    waves : (m, f)
        The features.
    unsure : (m, f)
        Mean squares of their errors by the interpolation.
    covariance : (m, 2f, 2f)
        Of their smooth forms, real and imaginary parts in turn.
    """

    damping: np.ndarray
    scale_and_frequencies: np.ndarray
    scale: np.ndarray
    waves: np.ndarray
    unsure: np.ndarray
    covariance: np.ndarray


class Predictor:
    """Predictions of some measurements, and of possible ``more``, by a model.

    Attributes
    ----------
    known : (q,) bool
        True where a measurement can be predicted.
    changed : BaselineChanges
        Possible changes since there was no crack.
    """

    def __init__(
        self, model: ForwardModel, rows: Sequence[Measurement], more: Sequence[Measurement] = ()
    ) -> None:
        self.model, self.rows = model, (*rows, *more)
        features = [Feature.list_for_measurement(row, model.scene) for row in self.rows]
        every = [one for found in features for one in found]
        every += [one.uncracked_feature for one in every if one.is_cracked_frequency]
        self._features = tuple(dict.fromkeys(every))
        at = {feature: place for place, feature in enumerate(self._features)}
        self._places = [[at[feature] for feature in found] for found in features]
        plain = [(at[one], at[one.uncracked_feature]) for one in at if one.is_cracked_frequency]
        self._own, self._plain = map(list, zip(*plain, strict=True)) if plain else ([], [])
        self._passages = ProbeDisplacements.group_measurements(rows, more)
        self._groups = _groups(self._features)
        self._is_plain = np.array([one.crack_state == "uncracked" for one in self._features])
        basis = model.coarse_cases.scale_and_frequencies
        self._basis = Interpolation(model.unknown_grid, basis.reshape(len(basis), -1))
        self._highest = float(np.nanmax(basis[..., NUMBERED], initial=0.0))
        self._loads = [
            model.coarse_cases.find_load_index(feature.frequency) for feature in self._features
        ]
        faster = model.coarse_cases.swept_loads.speed_ratios
        self._changes = np.stack(
            [model.uncracked_plate.compute_prior_sensitivities(one) for one in faster]
        )[self._loads]
        of_rows = [faster[self._loads[places[0]]] for places in self._places]
        self.baseline_changes = BaselineChanges(self.rows, of_rows, model.uncracked_plate)
        self._higher, still = _stillness(model.coarse_cases, self._features, self._loads)
        self._still = (
            RegularGridInterpolator(model.unknown_grid.axes, still) if len(still) else None
        )
        self._faces = (
            _faces(model) if any(row.resonance for row in self.rows) else (BREATHING_FACES,)
        )
        self._is_free_at_rest = scales_with_load(model.scene.at_rest())
        self._coarse = Interpolation(model.unknown_grid, self._smooth_features(model.coarse_cases))
        self._understated = self._missed()
        harmonic = np.repeat([not one.is_natural_frequency for one in self._features], 2)
        known = self._coarse.has_enough_nodes & (self._coarse.is_between_known | ~harmonic)
        # An error of the first order leaves d / (f - 1) where a mesh finer by f changes d, one of
        # high order nothing: half of the former is added, and may be wrong.
        self._correction: Interpolation | None = None
        finer = model.identify_table.finer
        self._left = 0.5 / max(finer - 1.0, 1.0 / finer - 1.0, 0.1)
        if model.finer_cases is not None:
            fine = model.finer_cases
            difference = self._smooth_features(fine) - self._coarse.interpolate(
                fine.unknown_grid.nodes
            )
            self._correction = Interpolation(fine.unknown_grid, difference)
            known &= self._correction.has_enough_nodes & (
                self._correction.is_between_known | ~harmonic
            )
        of_features = known.reshape(-1, 2).all(axis=1)
        of_features[self._own] &= of_features[self._plain]
        self.is_predictable = np.array([bool(of_features[places].all()) for places in self._places])

    def with_change_factors(self, *, clamp_factor: float, temperature_factor: float) -> Predictor:
        """The same with the priors of how much the clamp and an unknown temperature have changed
        since there was no crack multiplied by factors."""
        found = copy(self)
        found.baseline_changes = self.baseline_changes.with_change_factors(
            clamp_factor, temperature_factor
        )
        return found

    def iterate_states(self, x: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, Prediction]]:
        """Possible states of the crack faces under the loads at values (m, d) of the unknowns:
        places among them, (n,), where each is possible, its probability there, (n,), and the
        predictions.

        Under a steady load, a preload or a clearance a crack may stay open or closed, and the
        motion has no harmonics at all; between nodes where it does and where it does not, both are
        possible. At a resonance it may stay open or closed, too, or breathe, half of the period or
        for a part of it that is the same at all resonances or another at each: the four have the
        same probability.
        """
        rests = np.zeros((len(x), 0))
        if self._still is not None:
            rests = self._still(
                np.clip(
                    x, self.model.unknown_grid.lower_bounds, self.model.unknown_grid.upper_bounds
                )
            )
        for chosen in itertools.product((False, True), repeat=rests.shape[1]):
            share = np.prod(np.where(chosen, rests, 1.0 - rests), axis=1)
            at = np.flatnonzero(share > 0.0)
            higher = list(itertools.compress(self._higher, chosen))
            still = np.any(higher, axis=0) if higher else None
            if len(at):
                place = self._place(x[at])
                for faces in self._faces:
                    yield at, faces.weight * share[at], self._predicted(place, still, faces)

    def _smooth_features(self, part: SolvedCases) -> np.ndarray:
        """Smooth forms of all features at the nodes of a sweep: (n, 2f), real and imaginary parts
        in turn."""
        values = np.stack([feature.get_node_values(part) for feature in self._features], axis=1)
        values[:, self._own] -= values[:, self._plain]
        return _pairs(
            values * self._scales(part.unknown_grid.nodes, self._basis_at(part.unknown_grid.nodes))
        )

    def _missed(self) -> np.ndarray:
        """Interpolation errors halfway between nodes over the estimated ones, at least 1: (2f,).
        Features with more waves than nodes, as of higher modes along the height, look smooth."""
        part = self.model.halfway_cases
        if part is None:
            return np.ones(2 * len(self._features))
        x = part.unknown_grid.nodes
        missed = (self._smooth_features(part) - self._coarse.interpolate(x)) ** 2
        stated = np.sum(self._coarse.compute_weighted_errors(x) ** 2, axis=1)
        both = [np.nansum(one, axis=0).reshape(-1, 2).sum(axis=1) for one in (missed, stated)]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(both[1] > 0.0, both[0] / both[1], 1.0)
        return np.repeat(np.sqrt(np.maximum(ratio, 1.0)), 2)

    def _scales(self, x: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Factors that make features smooth: (m, f), for both sweeps from the coarse one."""
        return compute_smoothing_factors(
            self._features,
            self.model.get_damping_ratios(x),
            basis,
            self.model.compute_crack_sizes(x),
        )

    def _basis_at(self, x: np.ndarray) -> np.ndarray:
        """:attr:`SolvedCases.scale_and_frequencies` at the load of each feature, at values (m, d) of the unknowns:
        (m, f, 1 + 2 modes)."""
        found = np.where(self._basis.has_enough_nodes, self._basis.interpolate(x), np.nan)
        return found.reshape(len(x), *self.model.coarse_cases.scale_and_frequencies.shape[1:])[
            :, self._loads
        ]

    def __call__(self, x: np.ndarray) -> Prediction:
        """Predictions at some values (m, d) of the unknowns, in the least certain state of the
        crack faces at resonances."""
        return self._predicted(self._place(x), None, self._faces[0])

    def compute_interpolation_variances(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Variances of predictions at values (m, d) of the unknowns by interpolation along each
        unknown, (m, d, q), and in total, (m, q)."""
        place, none = self._place(x), np.zeros((len(x), 2 * len(self._features)))

        def variances(covariance: np.ndarray) -> np.ndarray:
            own = place._replace(covariance=covariance)
            predicted = self._predicted(own, None, self._faces[0])
            return np.diagonal(predicted.covariance, axis1=1, axis2=2)

        rest, found = variances(np.zeros_like(place.covariance)), []
        for scatter in self._coarse.compute_weighted_errors_by_axis(x)[: x.shape[1]]:
            errors = self._errors(none, none, [self._understated * scatter])
            found.append(variances(errors @ errors.transpose(0, 2, 1)) - rest)
        return np.stack(found, axis=1), variances(place.covariance)

    def _place(self, x: np.ndarray) -> FeaturePrediction:
        """Features at some values (m, d) of the unknowns."""
        smooth, scatter = (
            self._coarse.interpolate(x),
            [self._understated * self._coarse.compute_weighted_errors(x)],
        )
        left = np.zeros_like(smooth)
        if self._correction is not None:
            difference = self._correction.interpolate(x)
            left = self._left * difference
            smooth = smooth + difference + left
            scatter.append(self._correction.compute_weighted_errors(x))
        damping, basis = self.model.get_damping_ratios(x), self._basis_at(x)
        scale = self._scales(x, basis)
        waves = (smooth[:, ::2] + 1j * smooth[:, 1::2]) / scale
        whole = self.model.uncracked_plate
        changes = whole.compute_feature_sensitivities(self._features, damping, basis, self._changes)
        changes = changes * np.where(self._is_plain, 1.0, waves * scale)[..., None]
        waves[:, self._own] += waves[:, self._plain]
        unsure = sum(np.sum(errors**2, axis=1) for errors in scatter)
        unsure = (unsure[:, ::2] + unsure[:, 1::2]) / np.abs(scale) ** 2
        unknown = _pairs(changes.transpose(0, 2, 1)).transpose(0, 2, 1)
        errors = np.concatenate([self._errors(smooth, left, scatter), unknown], axis=2)
        return FeaturePrediction(
            damping, basis, scale, waves, unsure, errors @ errors.transpose(0, 2, 1)
        )

    def _predicted(
        self, place: FeaturePrediction, still: np.ndarray | None, faces: FaceState
    ) -> Prediction:
        """Predictions by features, some of which vanish, (f,), and the state of the crack faces at
        resonances."""
        damping, scale, waves, unsure = place.damping, place.scale, place.waves, place.unsure
        if still is not None:
            waves, unsure = (np.where(still, 0.0, one) for one in (waves, unsure))
        values, turns, common, rest = self._of_numbers(damping, waves, scale, faces)
        values *= self.baseline_changes.temperature_factors
        free = [np.zeros((*values.shape, 0))]
        left_out = np.zeros((len(waves), len(self.rows), len(self.rows)))
        for passages in self._passages:
            at = self._places[passages.row_indices[0]]
            values[:, passages.row_indices], slopes, changes, sizes = passages.fit_harmonics(
                waves[:, at]
            )
            squares = np.abs(waves[:, at]) ** 2 + unsure[:, at]
            above, square = self._left_out(
                self._features[at[0]], squares, damping, place.scale_and_frequencies[:, at[:1]]
            )
            both = np.ix_(range(len(waves)), passages.row_indices, passages.row_indices)
            size = sizes[:, None, None] ** 2
            left_out[both] = size * np.tensordot(
                square, passages.compute_harmonic_covariances(above), axes=1
            )
            turns[:, np.array(passages.row_indices)[:, None], at] = slopes / scale[:, None, at]
            moved = np.zeros((*values.shape, changes.shape[2]))
            moved[:, passages.row_indices] = changes
            free.append(moved)
        turns[:, ~self.is_predictable] = 0.0
        if still is not None:
            turns[..., still] = 0.0
        slopes = _pairs(turns.conj())
        total = slopes @ place.covariance @ slopes.transpose(0, 2, 1) + left_out
        errors = np.concatenate(
            [values[..., None] * self.baseline_changes.all_changes, common], axis=2
        )
        total += errors @ errors.transpose(0, 2, 1) + rest[:, :, None] * np.eye(len(self.rows))
        values = np.where(self.is_predictable, values, np.nan)
        return Prediction(values, total, np.concatenate(free, axis=2), self.is_predictable)

    def _left_out(
        self, first: Feature, squares: np.ndarray, damping: np.ndarray, basis: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Orders (k,) above those that all cases have, as far as modes resonate there, and mean
        squares (m, k) [m^2] of their harmonics, by those (m, K) of the first ones at a point; basis
        (m, 1, 1 + 2 modes).

        Harmonics of the contact force fall like 1 / k and act on modes of static compliances
        1 / w_j^2: |U_k|^2 = c^2 sum_j |w_j^2 - (k W)^2 + 2 i z w_j k W|^-2 / k^2, with c^2 the mean
        of the upper half of those that are known. Of 150 cracks under loads of 120 to 1500 Hz what
        twelve and six of 30 harmonics leave is 1.0 and 1.3 times this, in root mean square.
        """
        kept, highest = self.model.coarse_cases.count_harmonics(first.frequency), self._highest
        kept = min(kept, squares.shape[1])
        last = min(max(2 * kept, math.ceil(highest / first.frequency)), MOST_HARMONICS)
        every = [replace(first, order=order) for order in range(1, last + 1)]
        soft = np.nan_to_num(basis[..., NUMBERED], nan=np.inf) ** -4.0
        moved = np.sum(
            soft / np.abs(compute_ratios_and_poles(every, damping, basis)[1]) ** 2, axis=2
        )
        moved /= np.arange(1.0, last + 1.0) ** 2
        upper = slice(kept // 2, kept)
        with np.errstate(divide="ignore", invalid="ignore"):
            strength = np.nan_to_num(np.mean(squares[:, upper] / moved[:, upper], axis=1))
        return np.arange(kept + 1, last + 1), strength[:, None] * moved[:, kept:]

    def _of_numbers(
        self, damping: np.ndarray, waves: np.ndarray, scale: np.ndarray, faces: FaceState
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Values (m, q) of all measurements but displacements, their slopes t (m, q, f) by the
        smooth forms S, ds = Re sum t dS, and errors of the state of the crack faces.

        These errors are common to all and to each mode, (m, q, 1 + modes), and independent
        variances (m, q).
        """
        natural = np.array([feature.is_natural_frequency for feature in self._features])
        with np.errstate(divide="ignore", invalid="ignore"):
            sizes = np.where(natural, np.exp(np.where(natural, waves.real, 0.0)), np.abs(waves))
            turned = np.where(np.abs(waves) > 0.0, np.conj(waves) / np.abs(waves), 1.0) / scale
        turned = np.where(natural, sizes / scale, turned)
        values, rest = np.zeros((2, len(waves), len(self.rows)))
        common = np.zeros((*values.shape, 1 + FEW_MODES))
        turns = np.zeros((*values.shape, len(self._features)), dtype=complex)
        table, off = self.model.identify_table, self.model.identify_table.resonance_deviation
        for place, (row, at) in enumerate(zip(self.rows, self._places, strict=True)):
            if row.quantity == "displacement" or not self.is_predictable[place]:
                continue
            own = BREATHING_FACES if row.rpm == 0.0 and self._is_free_at_rest else faces
            state = RESONANCE_STATES.index(own.state) if row.resonance else 0
            values[:, place], weights = _together(row, sizes[:, at], state)
            turns[:, place, at] = weights * turned[:, at]
            if row.resonance:
                _, opened, tied = sizes[:, at].T
                split, shift = tied - opened, values[:, place] * damping[:, 0] ** 2
                common[:, place, 0] = own.common * split
                of_mode = table.first_resonance_deviation if row.mode == 1 else off
                common[:, place, row.mode] = (state == 0) * of_mode * split
                rest[:, place] = (own.apart * split) ** 2 + shift**2
        for own, plain in zip(self._own, self._plain, strict=True):
            turns[:, :, plain] += turns[:, :, own] * scale[:, None, own]
        return values, turns, common, rest

    def _errors(
        self, smooth: np.ndarray, left: np.ndarray, scatter: list[np.ndarray]
    ) -> np.ndarray:
        """Independent errors of the smooth forms, half of each variance common to several of them:
        (m, 2f, r).

        From the smooth forms as pairs of columns, the remaining errors of the mesh, (m, 2f) each,
        and errors at the nodes around, (m, k, 2f) of each sweep.
        """
        half = np.sqrt(0.5)
        every, eye = np.concatenate(scatter, axis=1), np.eye(smooth.shape[1])
        found = [
            half * every.transpose(0, 2, 1),
            half * np.sqrt(np.sum(every**2, axis=1))[:, None, :] * eye,
            half * left[..., None],
            half * left[..., None] * self._groups,
        ]
        uneven = self.model.identify_table.harmonic_deviation
        if uneven:
            upper = np.repeat([max(feature.order - 1, 0) for feature in self._features], 2)
            turned = np.stack([-smooth[:, 1::2], smooth[:, ::2]], axis=2).reshape(smooth.shape)
            each = np.kron(np.eye(len(self._features)), np.ones((2, 1)))
            for part in (smooth, turned):
                of_contact = uneven * (part * upper)[..., None]
                found += [half * of_contact * self._groups, half * of_contact * each]
        return np.concatenate(found, axis=2)


def _stillness(
    part: SolvedCases, features: Sequence[Feature], loads: Sequence[int]
) -> tuple[list[np.ndarray], np.ndarray]:
    """Loads at which the crack faces of some nodes touch or part, and those of others do not: the
    features that are higher harmonics there, (f,) bool each; and the nodes without such harmonics,
    on the cube, (..., n)."""
    groups, still = [], []
    above = np.array([feature.order > 1 for feature in features], dtype=bool)
    for load in np.unique(np.array(loads)[above]):
        own = above & (np.array(loads) == load)
        values = [features[place].get_node_values(part) for place in np.flatnonzero(own)]
        moved = np.fmax.reduce(np.abs(values))
        rests = moved <= 1e-9 * np.fmax.reduce(moved)  # rounding
        if rests.any() and not rests.all():
            groups.append(own)
            still.append(rests.reshape(part.unknown_grid.shape))
    return groups, np.moveaxis(np.array(still, dtype=float), 0, -1) if groups else np.zeros(0)


def _groups(features: Sequence[Feature]) -> np.ndarray:
    """Groups of columns with a common error by the mesh, or by contact on it: (2f, groups), 0 or
    1."""
    groups = list(dict.fromkeys(feature.error_group for feature in features))
    own = [[float(feature.error_group == group) for group in groups] for feature in features]
    return np.repeat(own, 2, axis=0)


def _pairs(values: np.ndarray) -> np.ndarray:
    """Complex columns (..., f) as real and imaginary ones in turn: (..., 2f)."""
    return np.stack([values.real, values.imag], axis=-1).reshape(*values.shape[:-1], -1)


def _faces(model: ForwardModel) -> tuple[FaceState, ...]:
    """Possible states at resonances: breathing, and if that depends on the size of the motion, for
    any part of the period, open or closed, unless no solved case is."""
    if has_load_independent_shape(model.scene):
        return (BREATHING_FACES,)
    off = model.identify_table.resonance_deviation
    closed = model.coarse_cases.sweep_result["closed_share"][model.coarse_cases.word_index]
    least, most = (one.reduce(closed, axis=None) for one in (np.fmin, np.fmax))
    held = itertools.compress((FaceState("open"), FaceState("tied")), (least < 1.0, most > 0.0))
    # Breathing for another part of the period at each resonance, or for the same at all.
    partly = (
        FaceState("bilinear", apart=off, weight=0.5),
        FaceState("bilinear", common=off, weight=0.5),
    )
    every = (*partly, BREATHING_FACES, *held)
    total = sum(one.weight for one in every)
    return tuple(one._replace(weight=one.weight / total) for one in every)


def has_load_independent_shape(scene: Scene) -> bool:
    """Return True if the shape of a motion does not depend on the size of the load."""
    return scales_with_load(scene) and not any(scene.excitation.force_mean)


def _together(row: Measurement, parts: np.ndarray, state: int) -> tuple[np.ndarray, np.ndarray]:
    """A quantity (m,) from its parts (m, k), and its slopes by them (m, k); a resonance is near the
    frequency of the state of the crack faces."""
    if row.natural or parts.shape[1] == 1:
        return parts[:, state], np.eye(1, parts.shape[1], state).repeat(len(parts), axis=0)
    one, two = parts.T
    return one / two, np.column_stack([1.0 / two, -one / two**2])
