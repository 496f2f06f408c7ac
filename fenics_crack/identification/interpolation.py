"""Smooth interpolation of many quantities over a few unknowns, with its own error.

A quantity known at n nodes x_i of the unit cube is interpolated by polyharmonic splines,

    s(x) = sum_i c_i phi(|x - x_i|) + a polynomial,      phi = r^2 log r, r^3 or r^5

(SciPy's ``RBFInterpolator``). What each node says about all the others is known without solving
again: with the matrix A of the conditions, the error at a node left out is

    e_i = c_i / (A^-1)_ii

(S. Rippa, Advances in Computational Mathematics 11, 1999, 193). It chooses the kernel, the
smoothing, and whether unknowns are taken by their logarithms, for each quantity; and its mean
square around a place is the variance that a prediction there has.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial.distance import cdist

__all__ = ["Cube", "Interpolation", "left_out_errors"]

KERNELS = {"thin_plate_spline": 1, "cubic": 1, "quintic": 2}
"""The kernels, and the degrees of their polynomials."""
SMOOTHINGS = (0.0, 1e-4)
"""On the diagonal; the second one for meshes that make small jumps."""
WIDE = 5.0
"""Ratio of the ends of an unknown from which its logarithm is tried."""
NEAR = 1.25
"""Spacings of the nodes over which errors are averaged."""
TINY = 1e-12


@dataclass(frozen=True)
class Cube:
    """The unknowns between their bounds, scaled to the unit cube.

    Attributes
    ----------
    axes : tuple of arrays
        Values of each unknown in ascending order; none at all where there are no unknowns.
    """

    axes: tuple[np.ndarray, ...]

    @property
    def low(self) -> np.ndarray:
        """Lower bounds: (d,)."""
        return np.array([axis[0] for axis in self.axes])

    @property
    def high(self) -> np.ndarray:
        """Upper bounds: (d,)."""
        return np.array([axis[-1] for axis in self.axes])

    @property
    def nodes(self) -> np.ndarray:
        """All combinations, the last unknown fastest: (n, d)."""
        combinations = list(itertools.product(*self.axes))
        return np.array(combinations, dtype=float).reshape(len(combinations), len(self.axes))

    @property
    def wide(self) -> bool:
        """Whether a logarithm may be the better coordinate of any unknown."""
        return bool(np.any(self._logs(True)))

    def _logs(self, logs: bool) -> np.ndarray:
        return (self.low > 0.0) & (self.high > WIDE * np.maximum(self.low, 0.0)) & logs

    def scaled(self, values: np.ndarray, logs: bool) -> np.ndarray:
        """Values (m, d) in the unit cube; with ``logs`` wide unknowns by their logarithms."""
        chosen = self._logs(logs)

        def of(x: np.ndarray) -> np.ndarray:
            return np.where(chosen, np.log(np.maximum(x, TINY * self.high) if len(x) else x), x)

        with np.errstate(invalid="ignore", divide="ignore"):
            low, high = of(self.low), of(self.high)
            return np.asarray((of(values) - low) / (high - low))


@dataclass(frozen=True)
class Way:
    """How a quantity is interpolated."""

    kernel: str
    smoothing: float
    logs: bool


def left_out_errors(nodes: np.ndarray, values: np.ndarray, way: Way) -> np.ndarray:
    """What each node differs by from the interpolation of all others: (n, q) for values (n, q)."""
    n = len(nodes)
    distance = cdist(nodes, nodes)
    with np.errstate(divide="ignore", invalid="ignore"):
        kernel = {
            "thin_plate_spline": lambda r: np.where(r > 0.0, r**2 * np.log(r), 0.0),
            "cubic": lambda r: r**3,
            "quintic": lambda r: -(r**5),
        }[way.kernel](distance)
    degree = KERNELS[way.kernel]
    powers = [
        p for p in itertools.product(range(degree + 1), repeat=nodes.shape[1]) if sum(p) <= degree
    ]
    columns = np.stack([np.prod(nodes ** np.array(p), axis=1) for p in powers], axis=1)
    size = columns.shape[1]
    matrix = np.block(
        [[kernel + way.smoothing * np.eye(n), columns], [columns.T, np.zeros((size, size))]]
    )
    inverse = np.linalg.inv(matrix)
    return np.asarray((inverse[:n, :n] @ values) / np.diag(inverse)[:n, None])


class Interpolation:
    """Interpolates some quantities over the unknowns; each in the way that suits it best.

    Parameters
    ----------
    cube : Cube
        The unknowns.
    values : (n, q)
        Of the quantities at the nodes of the cube; nan where one is not known.
    """

    def __init__(self, cube: Cube, values: np.ndarray) -> None:
        self.cube = cube
        self.count = values.shape[1]
        self.error = np.zeros(self.count)
        """Root of the mean square of the errors at nodes left out: (q,); inf where too few nodes
        are known."""
        self._groups: list[tuple[Way, np.ndarray, list[int], RBFInterpolator]] = []
        self._constant = values[0] if not cube.axes else None
        if self._constant is not None:
            return
        self._values, self._left = values, np.full_like(values, np.nan)
        known = np.isfinite(values)
        for pattern in np.unique(known, axis=1).T:
            places = [q for q in range(self.count) if np.array_equal(known[:, q], pattern)]
            self._choose(pattern, places)

    def _choose(self, known: np.ndarray, places: list[int]) -> None:
        """The best way for quantities that are known at the same nodes."""
        d = len(self.cube.axes)
        if known.sum() <= (d + 1) * (d + 2) // 2:
            self.error[places] = np.inf
            return
        nodes, values = self.cube.nodes[known], self._values[known][:, places]
        best: list[Way | None] = [None] * len(places)
        sizes = np.full(len(places), np.inf)
        for way in _ways(self.cube):
            try:
                errors = left_out_errors(self.cube.scaled(nodes, way.logs), values, way)
            except np.linalg.LinAlgError:
                continue
            found = np.sqrt(np.mean(errors**2, axis=0))
            for at in np.flatnonzero(found < sizes):
                sizes[at], best[at] = found[at], way
                self._left[known, places[at]] = errors[:, at]
        self.error[places] = sizes
        for chosen in dict.fromkeys(best):
            if chosen is not None:
                way, group = chosen, [at for at, own in enumerate(best) if own == chosen]
                spline = RBFInterpolator(
                    self.cube.scaled(nodes, way.logs), values[:, group], kernel=way.kernel,
                    degree=KERNELS[way.kernel], smoothing=way.smoothing,
                )  # fmt: skip
                self._groups.append((way, known, [places[at] for at in group], spline))

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The quantities at values x (m, d) of the unknowns, and their standard deviations:
        (m, q) each, infinite where a quantity is not known."""
        found, deviation = np.zeros((len(x), self.count)), np.full((len(x), self.count), np.inf)
        if self._constant is not None:
            known = np.isfinite(self._constant)
            found[:, known], deviation[:, known] = self._constant[known], 0.0
            return found, deviation
        for way, known, group, spline in self._groups:
            at = self.cube.scaled(x, way.logs)
            found[:, group] = spline(at)
            squares = self._left[known][:, group] ** 2
            nodes = self.cube.scaled(self.cube.nodes[known], way.logs)
            deviation[:, group] = np.sqrt(self._nearby(at, nodes) @ squares)
        return found, deviation

    def _nearby(self, x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Weights of the nodes around places: (m, n), rows of sum 1."""
        spacing = NEAR / np.array([len(axis) - 1 for axis in self.cube.axes])
        exponent = -0.5 * cdist(x / spacing, nodes / spacing, "sqeuclidean")
        weights = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _ways(cube: Cube) -> list[Way]:
    """What is tried."""
    logs = (False, True) if cube.wide else (False,)
    return [Way(*how) for how in itertools.product(KERNELS, SMOOTHINGS, logs)]
