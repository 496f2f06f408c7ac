"""Posterior of the unknowns: maxima of the likelihood by least squares, and values on a grid.

Measured numbers m with standard deviations e are compared with predictions s(x), whose own errors
have a covariance T(x):

    log L(x) = - (m - s)^T V^-1 (m - s) / 2 - log(det V) / 2,    V(x) = diag(e^2) + T(x)

As det V is no less than that of diag(e^2), both terms are squares, and least squares find its
maxima. Where a crack may breathe or not, L is the sum over both, each with its probability
(:meth:`fenics_crack.monitoring.identification.model.Predictor.states`).

The prior is uniform between the bounds. A crack differs from the equivalent straight and sharp one:
L is convolved on the grid with the distribution of that difference
(:func:`fenics_crack.monitoring.identification.nuisance.crack_deviations`). Regions hold a share of
the posterior's mass, the densest parts first; the integral of L over the prior is a hypothesis'
evidence (D. J. C. MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter
28).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import product
from typing import Any

import numpy as np
from scipy.integrate import trapezoid
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import label, maximum_filter
from scipy.optimize import least_squares
from scipy.special import chdtrc, logsumexp

from fenics_crack.monitoring.identification.interpolation import UnknownGrid
from fenics_crack.monitoring.identification.model import Prediction, Predictor
from fenics_crack.monitoring.identification.options import OPTIONS

LOOK = {1: 200, 2: 45, 3: 17}
"""Values of each unknown of the first grid, by the number of unknowns; of more, 9."""
CLOSER = {1: 101, 2: 31, 3: 13}
"""Further ones around each optimum; of more, 7."""


def add_uniform_prior(information: np.ndarray) -> np.ndarray:
    """Fisher information (d, d) of unknowns over their ranges, with that of a uniform prior."""
    return np.asarray(information + 12.0 * np.eye(len(information)))  # 1 / variance of a uniform


@dataclass(frozen=True)
class Likelihood:
    """Measured values with standard deviations, (q,) each, and their predictions."""

    values: np.ndarray
    deviations: np.ndarray
    predictor: Predictor

    def compute_residuals(self, x: np.ndarray) -> np.ndarray:
        """Residuals at values (m, d) of the unknowns: (m, q + 1).

        They are L^-1 (m - s) / e, whose squares sum to chi^2, V = diag(e) L L^T diag(e); and the
        root of log(det L L^T / p^2), in the most probable state of the crack faces, with its
        probability p.
        """
        found = np.full((len(x), len(self.values) + 1), np.inf)
        for at, rows, _ in self._iterate_state_residuals(x):
            nearer = np.sum(rows**2, axis=1) < np.sum(found[at] ** 2, axis=1)
            found[at[nearer]] = rows[nearer]
        return found

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """log L at values (m, d) of the unknowns: (m,), up to a constant."""
        found = np.full(len(x), -np.inf)
        for at, rows, _ in self._iterate_state_residuals(x):
            found[at] = np.logaddexp(found[at], -0.5 * np.sum(rows**2, axis=1))
        return found

    def predict_most_probable(self, x: np.ndarray) -> Prediction:
        """Predictions at values (d,) of the unknowns, in the most probable state of the crack
        faces."""
        states = self._iterate_state_residuals(x[None])
        return min(states, key=lambda state: np.sum(state[1] ** 2))[2]

    def _iterate_state_residuals(
        self, x: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, Prediction]]:
        """Residuals of each possible state of the crack faces: places among x, rows, and the
        predictions there."""
        for at, share, predicted in self.predictor.iterate_states(x):
            factor = np.linalg.cholesky(
                compute_scaled_covariance(predicted, self.values, self.deviations)
            )
            differences = (self.values - predicted.values) / self.deviations
            logs = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1) - np.log(share)
            root = np.sqrt(2.0 * np.maximum(logs, 0.0))  # below 0 by rounding alone
            rows = np.linalg.solve(factor, differences[..., None])[..., 0]
            yield at, np.column_stack([rows, root]), predicted

    def compute_temperature_change(self, x: np.ndarray) -> float:
        """Posterior mean of the unknown change of temperature since there was no crack, at values
        (d,) of the unknowns, in standard deviations of its prior."""
        predicted = self.predict_most_probable(x)
        column = (
            predicted.values[0]
            * self.predictor.baseline_changes.unknown_temperature_changes[:, 0]
            / self.deviations
        )
        left = (self.values - predicted.values[0]) / self.deviations
        covariance = compute_scaled_covariance(predicted, self.values, self.deviations)[0]
        return float(column @ np.linalg.solve(covariance, left))

    def explains_measurements(self, x: np.ndarray) -> np.ndarray:
        """True where values (m, d) of the unknowns, chosen before measuring, would explain the
        measurements: (m,) bool."""
        return np.asarray(
            self._compute_chi_square(x, 0)[1]
            >= 1.0 - self.predictor.model.identify_table.confidence
        )

    def compute_misfit(self, x: np.ndarray) -> tuple[float, float]:
        """chi^2 at the best values (d,) of the unknowns, and its p-value with as many degrees of
        freedom as there are measurements more than fitted numbers."""
        total, chance = self._compute_chi_square(x[None], len(x))
        return float(total[0]), float(chance[0])

    def _compute_chi_square(self, x: np.ndarray, fitted: int) -> tuple[np.ndarray, np.ndarray]:
        """chi^2 at values (m, d) of the unknowns, some of which are fitted, and its p-value:
        (m,) each."""
        total = np.sum(self.compute_residuals(x)[:, :-1] ** 2, axis=1)
        spare = len(self.values) - fitted - self.predictor(x[:1]).load_changes.shape[2]
        return total, np.asarray(chdtrc(max(spare, 1), total))

    def without_measurement(self, place: int) -> Likelihood:
        """Likelihood of all measurements but one."""
        left = np.arange(len(self.values)) != place
        rows = [row for row, kept in zip(self.predictor.rows, left, strict=True) if kept]
        quantities = self.predictor.model.make_predictor(rows)
        return Likelihood(self.values[left], self.deviations[left], quantities)


def compute_scaled_covariance(
    predicted: Prediction, values: np.ndarray, deviations: np.ndarray
) -> np.ndarray:
    """Return V of measured values (q,) over their standard deviations (q,): (m, q, q). Predictor
    without a prediction get a standard deviation of ten times the value."""
    both = np.outer(predicted.is_predictable, predicted.is_predictable)
    own = predicted.covariance + predicted.load_changes @ predicted.load_changes.transpose(0, 2, 1)
    vague = np.where(predicted.is_predictable, 0.0, 10.0 * (np.abs(values) + deviations))
    own = np.where(both, own, 0.0) + np.diag(vague**2)
    return np.asarray(np.eye(len(values)) + own / np.outer(deviations, deviations))


@dataclass(frozen=True)
class Optimum:
    """End of least squares: the unknowns (d,), log L, and the covariance (d, d)."""

    x: np.ndarray
    log_likelihood: float
    covariance: np.ndarray


class Branch:
    """The posterior of one choice of the unknowns that are words, on a grid that is denser around
    the optima of its likelihood.

    Attributes
    ----------
    likelihood : Likelihood
    optima : list of Optimum
        Best first.
    axes : tuple of arrays
        The grid, denser around the optima.
    height : array
        log L on the grid, spread.
    weight : array
        Prior mass of each grid point; their sum is 1.
    """

    def __init__(self, likelihood: Likelihood) -> None:
        self.likelihood, cube = likelihood, likelihood.predictor.model.unknown_grid
        d = len(cube.axes)
        self.axes: tuple[np.ndarray, ...] = ()
        if d == 0:
            self.log_likelihood = likelihood(np.zeros((1, 0))).reshape(())
            self.prior_mass = np.ones(())
            self.optima = [Optimum(np.zeros(0), float(self.log_likelihood), np.zeros((0, 0)))]
            return
        first = _even(cube)
        height = _heights(likelihood, _points(first)).reshape([len(axis) for axis in first])
        self.optima = _optima(likelihood, first, height)
        compute_crack_deviations = likelihood.predictor.model.compute_crack_deviations
        few = self.optima[:3]
        reaches = [OPTIONS.refined_half_width * np.sqrt(np.diag(one.covariance)) for one in few]
        wider = [
            OPTIONS.refined_half_width * compute_crack_deviations(one.x[None])[0] for one in few
        ]
        axes = []
        for place, (axis, low, high) in enumerate(
            zip(first, cube.lower_bounds, cube.upper_bounds, strict=True)
        ):
            pieces = [axis]
            for optimum, near, far in zip(few, reaches, wider, strict=True):
                for reach in (near[place], math.hypot(near[place], far[place])):
                    piece = optimum.x[place] + reach * np.linspace(-1.0, 1.0, CLOSER.get(d, 7))
                    pieces.append(piece[(piece > low) & (piece < high)])
            axes.append(np.unique(np.concatenate(pieces)))
        weights = [trapezoid(np.eye(len(axis)), axis) / np.ptp(axis) for axis in axes]
        self.axes, self.prior_mass = tuple(axes), reduce(np.multiply.outer, weights)
        points = _points(axes)
        # Interpolate on the first grid where all of it around a point is far below the maximum.
        around = maximum_filter(height, size=3, mode="nearest")
        least = self.optima[0].log_likelihood - OPTIONS.allowed_grid_drop
        near = RegularGridInterpolator(first, around)(points) > least
        for optimum, reach in zip(few, reaches, strict=True):
            near |= np.all(np.abs(points - optimum.x) < reach, axis=1)
        closer = RegularGridInterpolator(first, height)(points)
        closer[near] = _heights(likelihood, points[near])
        widths = compute_crack_deviations(points)
        self.log_likelihood = _spread(closer.reshape(self.prior_mass.shape), axes, weights, widths)

    @property
    def log_evidence(self) -> float:
        """log of the integral of L over the prior."""
        return float(logsumexp(self.log_likelihood, b=self.prior_mass))

    def get_value_by_key(self, x: np.ndarray) -> dict[str, Any]:
        """All unknowns by their keys, words and numbers (d,)."""
        model = self.likelihood.predictor.model
        return model.word_by_key | dict(zip(model.unknown_keys, x.tolist(), strict=True))

    def interpolate_log_likelihood(self, x: np.ndarray) -> float:
        """log L, spread, at some values (d,) of the unknowns, between those on the grid."""
        if not self.axes:
            return float(self.log_likelihood)
        within = np.clip(x, [axis[0] for axis in self.axes], [axis[-1] for axis in self.axes])
        return float(RegularGridInterpolator(self.axes, self.log_likelihood)(within)[0])

    def compute_interpolation_shares(self) -> tuple[np.ndarray, np.ndarray]:
        """Values (m, d) of the unknowns, of the first grid and the optima, that would explain the
        measurements, and the share of interpolation along each unknown in the variance of each
        measurement there: (m, d, q)."""
        likelihood, every = self.likelihood, [np.zeros((0, len(self.axes)))]
        shares = [np.zeros((0, len(self.axes), len(likelihood.values)))]
        points = np.vstack(
            [
                list_first_grid_points(likelihood.predictor.model.unknown_grid),
                *(o.x for o in self.optima),
            ]
        )
        for piece in _pieces(points):
            if len(x := piece[likelihood.explains_measurements(piece)]):
                parts, total = likelihood.predictor.compute_interpolation_variances(x)
                every.append(x)
                shares.append(parts / (total + likelihood.deviations**2)[:, None])
        return np.vstack(every), np.vstack(shares)


def _spread(
    height: np.ndarray, axes: list[np.ndarray], weights: list[np.ndarray], widths: np.ndarray
) -> np.ndarray:
    """Return log L on a grid, convolved along the axes with normal distributions of standard
    deviations (n, d)."""
    most = height.max()
    found = np.exp(height - most)
    for place, (axis, weight) in enumerate(zip(axes, weights, strict=True)):
        width = np.moveaxis(widths[:, place].reshape(height.shape), place, -1)
        if not width.any():
            continue
        width = np.maximum(width, 0.1 * np.gradient(axis))[..., None]  # no effect below
        shares = weight * np.exp(-0.5 * ((axis - axis[:, None]) / width) ** 2)
        shares /= shares.sum(axis=-1, keepdims=True)
        masses = np.moveaxis(found, place, -1) * weight
        found = np.moveaxis(np.einsum("...j,...ji->...i", masses, shares) / weight, -1, place)
    return np.asarray(np.log(np.maximum(found, np.finfo(float).tiny)) + most)


def _even(cube: UnknownGrid) -> list[np.ndarray]:
    """Values of each unknown of the first grid."""
    count = LOOK.get(len(cube.axes), 9)
    return [np.linspace(axis[0], axis[-1], count) for axis in cube.axes]


def list_first_grid_points(cube: UnknownGrid) -> np.ndarray:
    """Return the points of the first grid: (n, d)."""
    return _points(_even(cube))


def _points(axes: list[np.ndarray]) -> np.ndarray:
    """Points of a grid, the last unknown fastest: (n, d)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _heights(likelihood: Likelihood, points: np.ndarray) -> np.ndarray:
    """log L at many places (n, d): (n,)."""
    return np.concatenate([likelihood(piece) for piece in _pieces(points)])


def _pieces(points: np.ndarray) -> list[np.ndarray]:
    """Points (n, d) in batches."""
    return np.array_split(points, -(-len(points) // OPTIONS.batch_size))


def _optima(likelihood: Likelihood, axes: list[np.ndarray], height: np.ndarray) -> list[Optimum]:
    """Least squares from the highest points of a grid, without duplicates and much worse ones."""
    summits = np.argwhere(height == maximum_filter(height, size=3, mode="nearest"))
    best = sorted(summits, key=lambda at: -height[tuple(at)])[: OPTIONS.max_least_squares_starts]
    found: list[Optimum] = []
    cube = likelihood.predictor.model.unknown_grid
    low, span = cube.lower_bounds, cube.upper_bounds - cube.lower_bounds
    for at in best:
        start = np.array([axis[place] for axis, place in zip(axes, at, strict=True)])

        def residuals(unit: np.ndarray) -> np.ndarray:
            return likelihood.compute_residuals((low + span * unit)[None])[0]

        def slopes(unit: np.ndarray) -> np.ndarray:
            steps = np.diag(np.where(unit < 0.5, 1e-6, -1e-6))  # of the ranges, inwards
            rows = likelihood.compute_residuals(low + span * np.vstack([unit, unit + steps]))
            return np.asarray((rows[1:] - rows[0]).T / np.diag(steps))

        unit = np.clip((start - low) / span, 1e-6, 1.0 - 1e-6)
        fit = least_squares(residuals, unit, slopes, bounds=(0.0, 1.0), x_scale=0.1, ftol=1e-5)
        covariance = np.linalg.inv(add_uniform_prior(fit.jac.T @ fit.jac)) * np.outer(span, span)
        found.append(Optimum(low + span * fit.x, -float(fit.cost), covariance))
    found.sort(key=lambda optimum: -optimum.log_likelihood)
    kept: list[Optimum] = []
    for one in found:
        near = (np.all((one.x - two.x) ** 2 < np.diag(two.covariance)) for two in kept)
        if one.log_likelihood > found[0].log_likelihood - OPTIONS.allowed_optimum_drop and not any(
            near
        ):
            kept.append(one)
    return kept


class Posterior:
    """The posterior of all branches together, each of the same prior probability.

    Parameters
    ----------
    branches : mapping of str to Branch
        By their values of the unknowns that are words.
    """

    def __init__(self, branches: Mapping[str, Branch]) -> None:
        self.branch_by_words = dict(branches)
        logs = [branch.log_evidence for branch in self.branch_by_words.values()]
        self.log_evidence = float(logsumexp(logs) - np.log(len(logs)))
        total = logsumexp(logs)
        self.mass_by_words = {
            name: np.exp(branch.log_likelihood - total) * branch.prior_mass
            for name, branch in self.branch_by_words.items()
        }
        """Probability of each point of the grids; their sum is 1."""
        self._log_likelihoods = np.concatenate(
            [b.log_likelihood.ravel() for b in self.branch_by_words.values()]
        )
        self._point_masses = np.concatenate([mass.ravel() for mass in self.mass_by_words.values()])

    @property
    def best_words_and_unknowns(self) -> tuple[str, np.ndarray]:
        """The words and the unknowns (d,) at which L is largest."""
        name = max(
            self.branch_by_words,
            key=lambda name: self.branch_by_words[name].optima[0].log_likelihood,
        )
        return name, self.branch_by_words[name].optima[0].x

    @property
    def _best_likelihood_and_unknowns(self) -> tuple[Likelihood, np.ndarray]:
        """The likelihood and the unknowns (d,) where L is largest."""
        name, x = self.best_words_and_unknowns
        return self.branch_by_words[name].likelihood, x

    @cached_property
    def misfit(self) -> tuple[float, float]:
        """chi^2 where L is largest, and its p-value."""
        likelihood, x = self._best_likelihood_and_unknowns
        return likelihood.compute_misfit(x)

    @cached_property
    def misfits_without_measurement(self) -> list[tuple[float, float]]:
        """The same, at the same place, without each of the measurements."""
        likelihood, x = self._best_likelihood_and_unknowns
        return [
            likelihood.without_measurement(at).compute_misfit(x)
            for at in range(len(likelihood.values))
        ]

    def compute_misfit_with_changes(
        self, *, clamp: float = 1.0, temperature: float = 1.0
    ) -> tuple[float, float]:
        """The same, at the same place, with the priors of how much the clamp and an unknown
        temperature have changed since there was no crack multiplied by factors."""
        likelihood, x = self._best_likelihood_and_unknowns
        quantities = likelihood.predictor.with_change_factors(
            clamp_factor=clamp, temperature_factor=temperature
        )
        return replace(likelihood, predictor=quantities).compute_misfit(x)

    @cached_property
    def mean_temperature_change(self) -> float:
        """Posterior mean of the change of temperature since there was no crack, where L is largest,
        in standard deviations of the prior."""
        likelihood, x = self._best_likelihood_and_unknowns
        return likelihood.compute_temperature_change(x)

    @cached_property
    def unresolved_probability(self) -> float:
        """Probability that the grid does not resolve: points whose neighbours along an unknown are
        all more than two standard deviations away, log L having fallen by 2, as on a thin ridge."""
        lost = 0.0
        for name, branch in self.branch_by_words.items():
            falls = np.zeros(branch.log_likelihood.shape, dtype=bool)
            for axis in np.eye(falls.ndim, dtype=int):
                sides = np.reshape([1, 0, 1], 1 + 2 * axis)
                around = maximum_filter(
                    branch.log_likelihood, None, sides, None, "constant", -np.inf
                )
                falls |= branch.log_likelihood - around > 2.0
            lost += float(np.sum(self.mass_by_words[name][falls]))
        return lost

    def find_region_level(self, share: float) -> float:
        """log L at the border of the region that holds a share of the mass."""
        order = np.argsort(-self._log_likelihoods)
        held = np.cumsum(self._point_masses[order])
        at = min(int(np.searchsorted(held, share)), len(order) - 1)
        return float(self._log_likelihoods[order[at]])

    def iterate_reached_bounds(self, share: float) -> Iterator[tuple[int, str, float]]:
        """Bounds that the region with a share of the mass reaches: the place of the unknown,
        "below" or "above", and the bound."""
        level, branches = self.find_region_level(share), [*self.branch_by_words.values()]
        for place, end in product(range(len(branches[0].axes)), (0, -1)):
            if any(np.any(one.log_likelihood.take(end, axis=place) >= level) for one in branches):
                yield place, "above" if end else "below", float(branches[0].axes[place][end])

    def compute_marginal(self, place: int) -> tuple[np.ndarray, np.ndarray]:
        """Values of an unknown, and their probabilities: (n,) each."""
        values, masses = [], []
        for name, branch in self.branch_by_words.items():
            others = tuple(k for k in range(len(branch.axes)) if k != place)
            values.append(branch.axes[place])
            masses.append(self.mass_by_words[name].sum(axis=others))
        order = np.argsort(np.concatenate(values), kind="stable")
        return np.concatenate(values)[order], np.concatenate(masses)[order]

    def compute_interval(self, place: int, share: float) -> tuple[float, float]:
        """Equal-tailed interval of an unknown with a probability."""
        values, masses = self.compute_marginal(place)
        middle = np.cumsum(masses) - 0.5 * masses
        tail = 0.5 * (1.0 - share)
        low, high = np.interp([tail, 1.0 - tail], middle, values)
        return float(low), float(high)

    def find_region_parts(self, share: float, least: float) -> list[tuple[str, np.ndarray, float]]:
        """The separate parts of the region that holds a share of the mass: words, the middle (d,),
        and mass, largest first; those with less than ``least`` are left out.

        The middle is the mean or, of a bent part that does not hold it, the nearest point that
        is.
        """
        level = self.find_region_level(share)
        found = []
        for name, branch in self.branch_by_words.items():
            within = branch.log_likelihood >= level
            numbers, count = label(within, structure=np.ones((3,) * within.ndim))
            for number in range(1, count + 1):
                own = numbers == number
                masses = self.mass_by_words[name][own]
                if masses.sum() >= least:
                    places = np.argwhere(own)
                    columns = [axis[at] for axis, at in zip(branch.axes, places.T, strict=True)]
                    points = np.stack(columns, axis=1) if columns else np.zeros((1, 0))
                    x = masses @ points / masses.sum()
                    if branch.interpolate_log_likelihood(x) < level:
                        width = np.ptp(points, axis=0) + np.finfo(float).tiny
                        x = points[np.argmin(np.sum(((points - x) / width) ** 2, axis=1))]
                    found.append((name, x, float(masses.sum())))
        return sorted(found, key=lambda part: -part[2])

    def compute_deviation(self, place: int) -> float:
        """Standard deviation of an unknown."""
        values, masses = self.compute_marginal(place)
        return float(np.sqrt(np.cov(values, aweights=masses, ddof=0)))

    def compute_pair_marginal(
        self, name: str, first: int, second: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mass of a branch by two of its unknowns, and its density: (n_first, n_second) each."""
        parts = self.mass_by_words[name], self.branch_by_words[name].prior_mass
        others = tuple(k for k in range(parts[0].ndim) if k not in (first, second))
        mass, weight = (part.sum(axis=others) for part in parts)
        if first > second:
            mass, weight = mass.T, weight.T
        return mass, mass / weight
