"""Smooth interpolation of many quantities over a few unknowns, with its own error.

A quantity known on a grid of the unknowns is interpolated by the tensor product of cubic splines
without knots next to the ends (C. de Boor, A Practical Guide to Splines, 1978, chapters 4 and 17).
What each node between the ends of an axis differs by from the spline through all others on its line
tells the error, along each axis: it is that of twice the spacing, 16 times too large where a
quantity is smooth, and 4/3 times where meshes make it uneven; 0.3 of it is taken. The errors at the
nodes around a place, of all quantities together, are the covariance that predictions have there.

Where a case has failed, a thin plate through the others takes its place, if half of the nodes are
known, and one more than a quadratic polynomial needs: of four none may fail. What the nearest known
node differs by from such a plate without it is the error there, in full. That holds between known
nodes; beyond them a pole of a harmonic is missed.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, RBFInterpolator, make_interp_spline
from scipy.spatial.distance import cdist

__all__ = ["Cube", "Interpolation", "left_out_errors"]

DEGREE = 3
STATED = 0.3
"""Of what is left with twice the spacing: between 1/16 and 3/4."""
AVERAGED_OVER = 1.25
"""Spacings of the nodes over which errors are averaged."""
AROUND = 16
"""Nodes over which errors are averaged, at most."""


@dataclass(frozen=True)
class Cube:
    """The unknowns between their bounds.

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

    @cached_property
    def nodes(self) -> np.ndarray:
        """All combinations, the last unknown fastest: (n, d)."""
        combinations = list(itertools.product(*self.axes))
        return np.array(combinations, dtype=float).reshape(len(combinations), len(self.axes))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each axis."""
        return tuple(len(axis) for axis in self.axes)

    def places(self, values: np.ndarray) -> np.ndarray:
        """Places of values (m, d) among the nodes: whole numbers at these: (m, d)."""
        columns = [
            np.interp(column, axis, np.arange(len(axis)))
            for column, axis in zip(values.T, self.axes, strict=True)
        ]
        return np.stack(columns, axis=1)


def left_out_errors(line: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Difference of each value on a line (n,), but for the ends, from the spline through all
    others: (n, ...) for values (n, ...). The ends, which are never left out, have the errors of
    their neighbours."""
    found = np.zeros_like(values)
    for place in range(1, len(line) - 1):
        others = np.arange(len(line)) != place
        degree = min(DEGREE, len(line) - 2)
        spline = make_interp_spline(line[others], values[others], k=degree)
        found[place] = values[place] - spline(line[place])
    found[0], found[-1] = found[1], found[-2]
    return found


@dataclass(frozen=True)
class Splines:
    """Tensor products of splines: knots and degree along each axis, and coefficients (n, q)."""

    knots: tuple[np.ndarray, ...]
    degrees: tuple[int, ...]
    coefficients: np.ndarray

    @classmethod
    def through(cls, lines: tuple[np.ndarray, ...], values: np.ndarray) -> Splines:
        """Through values (n_1, ..., n_d, q) on a grid."""
        knots, degrees = [], []
        for k, line in enumerate(lines):
            spline = make_interp_spline(line, np.moveaxis(values, k, 0), k=_degree(len(line)))
            values = np.moveaxis(spline.c, 0, k)
            knots.append(spline.t)
            degrees.append(spline.k)
        return cls(tuple(knots), tuple(degrees), values.reshape(-1, values.shape[-1]))

    def __call__(self, at: np.ndarray) -> np.ndarray:
        """Values at some places (m, d), those outside taken to the border: (m, q)."""
        basis = np.ones((len(at), 1))
        for column, knots, degree in zip(at.T, self.knots, self.degrees, strict=True):
            within = np.clip(column, knots[0], knots[-1])
            own = BSpline.design_matrix(within, knots, degree).toarray()
            basis = (basis[:, :, None] * own[:, None, :]).reshape(len(at), -1)
        return np.asarray(basis @ self.coefficients)


def _degree(count: int) -> int:
    """The degree of a spline through so many values."""
    return DEGREE if count > DEGREE else count - 1


class Interpolation:
    """Interpolates some quantities over the unknowns.

    Parameters
    ----------
    cube : Cube
        The unknowns.
    values : (n, q)
        Of the quantities at the nodes of the cube; nan where one is not known.

    Attributes
    ----------
    known : (q,) bool
        Whether a quantity is known at enough of the nodes.
    between : (q,) bool
        Whether every node at which it is not known is between two others on a line.
    """

    def __init__(self, cube: Cube, values: np.ndarray) -> None:
        self.cube = cube
        self.between = _between(cube, np.isfinite(values))
        values, self.known, of_filled = _filled(cube, values)
        self._constant = values
        if cube.axes:
            grid = values.reshape(*cube.shape, values.shape[1])
            self._splines = Splines.through(cube.axes, grid)
            left = (
                np.moveaxis(left_out_errors(line, np.moveaxis(grid, k, 0)), 0, k)
                for k, line in enumerate(cube.axes)
            )
            self._errors = [STATED * one.reshape(values.shape) for one in left]
            if of_filled.any():
                self._errors.append(of_filled)

    def at(self, x: np.ndarray) -> np.ndarray:
        """The quantities at values x (m, d) of the unknowns: (m, q), 0 where one is not known."""
        if not self.cube.axes:
            return np.repeat(self._constant, len(x), axis=0)
        return self._splines(x)

    def scatter(self, x: np.ndarray) -> np.ndarray:
        """Errors of all quantities together at the nodes around values x (m, d), along each axis,
        and where cases failed, weighted so that their covariance is the sum of the squares:
        (m, k, q)."""
        if not self.cube.axes:
            return np.zeros((len(x), 0, len(self.known)))
        nodes = self.cube.places(self.cube.nodes)
        exponent = -0.5 / AVERAGED_OVER**2 * cdist(self.cube.places(x), nodes, "sqeuclidean")
        count = min(AROUND, len(nodes))
        near = np.argpartition(-exponent, count - 1, axis=1)[:, :count]
        exponent = np.take_along_axis(exponent, near, axis=1)
        weights = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        weights /= weights.sum(axis=1, keepdims=True)
        errors = [np.sqrt(weights)[..., None] * own[near] for own in self._errors]
        return np.concatenate(errors, axis=1)


def _between(cube: Cube, known: np.ndarray) -> np.ndarray:
    """Whether all nodes (n, q) that are not known have known ones on both sides, on a line along
    some axis: (q,)."""
    grid = known.reshape(*cube.shape, known.shape[1])
    found = grid.copy()
    for k in range(len(cube.axes)):
        line = np.moveaxis(grid, k, 0)
        below, above = (np.logical_or.accumulate(one) for one in (line, line[::-1]))
        found |= np.moveaxis(below & above[::-1], 0, k)
    return np.asarray(found.reshape(known.shape).all(axis=0))


def _filled(cube: Cube, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (n, q) with those that are not known taken from a thin plate through the others,
    whether enough of a quantity are known, (q,), 0 where not, and the errors of what was taken."""
    known, d = np.isfinite(values), len(cube.axes)
    least = max((d + 1) * (d + 2) // 2 + 1, len(values) / 2)
    enough = known.all(axis=0) | ((known.sum(axis=0) >= least) & (d > 0))
    found = np.where(known & enough, values, 0.0)
    errors = np.zeros_like(found)
    for place in np.flatnonzero(enough & ~known.all(axis=0)):
        own, column = known[:, place], values[:, place]
        nodes = (cube.nodes - cube.low) / (cube.high - cube.low)
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
