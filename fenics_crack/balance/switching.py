"""Switching instants: every sign change of real trigonometric polynomials, certified.

    g(theta) = Re sum_{k=0}^{H} G_k exp(i k theta),      theta = omega t in [0, 2 pi)

A grid alone misses pairs of roots between its points, where a pair of lips only grazes. Here a cell
[a, a + w] is settled by a bound or not at all. With |g''| <= M = sum_k k^2 |G_k|,

- equal signs and min(|g(a)|, |g(a + w)|) > M w^2 / 8: no root, g lies that close to its chord;
- opposite signs and |g(a + w) - g(a)| > M w^2 / 2: one root, g' keeps its sign;
- else the cell is divided, until all that could be missed is an excursion below RESOLUTION times
  the largest |g|.

Roots are polished by Halley's method. All polynomials are treated together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

__all__ = ["Switching", "switching_instants"]

RESOLUTION = 1e-14
PARTS = 4
"""Cells that are not settled are divided into so many."""


@dataclass(frozen=True)
class Switching:
    """Sign changes of the gaps of all pairs.

    Attributes
    ----------
    pair : (m,) int
        To which pair each belongs.
    theta : (m,) [rad]
        Phase in [0, 2 pi], unsorted.
    closing : (m,)
        +1 where the gap becomes positive (the pair closes), -1 where it opens.
    closed_at_start : (n_pairs,) bool
        Whether the gap is positive at theta = 0.
    """

    pair: np.ndarray
    theta: np.ndarray
    closing: np.ndarray
    closed_at_start: np.ndarray


def switching_instants(harmonics: np.ndarray) -> Switching:
    """Find all sign changes of the polynomials with complex harmonics (H+1, n_pairs)."""
    table = harmonics.T
    order, samples = _grid(len(harmonics) - 1)
    curvature = np.abs(table) @ order**2
    if not np.isfinite(curvature.sum()):  # a diverged iterate: no roots, but the search ends
        table = np.where(np.isfinite(curvature)[:, None], table, 0.0)
        curvature = np.where(np.isfinite(curvature), curvature, 0.0)
    spectrum = 0.5 * samples * table
    spectrum[:, 0] = samples * table[:, 0].real
    values = np.fft.irfft(spectrum, n=samples, axis=1)
    values = np.concatenate((values, values[:, :1]), axis=1)
    width = 2.0 * np.pi / samples
    bound = curvature * width**2
    # Only cells that change their sign, or come close to zero at one end, need a closer look.
    size, positive = np.abs(values), values > 0.0
    near = size <= 0.125 * bound[:, None]
    looked_at = positive[:, 1:] != positive[:, :-1]
    looked_at |= near[:, 1:]
    looked_at |= near[:, :-1]
    pair, cell = looked_at.nonzero()
    cells = _Brackets(pair, cell * width, width, values[pair, cell], values[pair, cell + 1])
    changes, settled = _classify(cells.low, cells.high, bound[pair])
    if settled.all():
        brackets = cells if changes.all() else _some(cells, changes)
    else:
        found, open_cells = [_some(cells, changes & settled)], _some(cells, ~settled)
        resolution = RESOLUTION * size.max(axis=1)
        while len(open_cells.pair):
            roots, open_cells = _divide(open_cells, table, curvature, resolution)
            found.append(roots)
        brackets = _joined(found)
    theta = _polished(brackets, table[brackets.pair], curvature[brackets.pair])
    closing = np.where(brackets.high > brackets.low, 1.0, -1.0)
    return Switching(brackets.pair, theta, closing, positive[:, 0])


@lru_cache(maxsize=64)
def _grid(highest: int) -> tuple[np.ndarray, int]:
    """Orders 0 to H, and the number of cells of the first grid."""
    return np.arange(highest + 1.0), 1 << (16 * (highest + 1) - 1).bit_length()


@dataclass
class _Brackets:
    """Cells [left, left + width] of pairs, with the values at both ends."""

    pair: np.ndarray
    left: np.ndarray
    width: float | np.ndarray
    low: np.ndarray
    high: np.ndarray


def _some(cells: _Brackets, chosen: np.ndarray) -> _Brackets:
    """Some of the cells of the first grid."""
    return _Brackets(
        cells.pair[chosen], cells.left[chosen], cells.width, cells.low[chosen], cells.high[chosen]
    )


def _classify(
    low: np.ndarray, high: np.ndarray, bound: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whether a cell changes its sign, and whether the bound M w^2 settles that that is all."""
    changes = (low > 0.0) != (high > 0.0)
    one = np.abs(high - low) > 0.5 * bound
    none = np.minimum(np.abs(low), np.abs(high)) > 0.125 * bound
    return changes, np.where(changes, one, none)


def _divide(
    cells: _Brackets, table: np.ndarray, curvature: np.ndarray, resolution: np.ndarray
) -> tuple[_Brackets, _Brackets]:
    """Divide cells: those with one root, and those that are still open."""
    width = cells.width / PARTS
    points = cells.left[:, None] + width * np.arange(PARTS + 1)
    values = np.empty_like(points)
    values[:, 0], values[:, -1] = cells.low, cells.high
    wave = np.exp(1j * np.multiply.outer(points[:, 1:-1], np.arange(table.shape[1])))
    values[:, 1:-1] = np.einsum("ch,cph->cp", table[cells.pair], wave).real
    bound = curvature[cells.pair] * width**2
    changes, settled = _classify(values[:, :-1], values[:, 1:], bound[:, None])
    settled |= (bound <= 8.0 * resolution[cells.pair])[:, None]  # both are 0 where g is

    def pick(chosen: np.ndarray) -> _Brackets:
        row, part = np.nonzero(chosen)
        return _Brackets(
            cells.pair[row], points[row, part], width, values[row, part], values[row, part + 1]
        )

    return pick(changes & settled), pick(~settled)


def _joined(found: list[_Brackets]) -> _Brackets:
    parts = [
        (cells.pair, cells.left, np.full(len(cells.pair), cells.width), cells.low, cells.high)
        for cells in found
    ]
    return _Brackets(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _polished(brackets: _Brackets, table: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """Halley's method from the chord's root; where it strays, Newton's with bisection.

    A step d leaves an error of about d (M d / g')^2; after the last one only rounding is left.
    """
    left, right = brackets.left, brackets.left + brackets.width
    theta = left - brackets.width * brackets.low / (brackets.high - brackets.low)
    if not len(left):
        return theta
    rate = 1j * _grid(table.shape[1] - 1)[0]
    derivatives = np.empty((3, *table.shape), dtype=complex)
    derivatives[0] = table
    np.multiply(table, rate, out=derivatives[1])
    np.multiply(derivatives[1], rate, out=derivatives[2])
    with np.errstate(all="ignore"):
        for _ in range(6):
            wave = np.exp(np.multiply.outer(theta, rate))
            value, slope, bend = (derivatives * wave).sum(axis=2).real
            step = value * slope / (slope * slope - 0.5 * value * bend)
            theta = theta - step
            sharp = np.abs(step) * curvature <= 1e-5 * np.abs(slope)
            if sharp.all():
                break
    good = sharp & (theta >= left) & (theta <= right)
    if not good.all():
        for place in np.flatnonzero(~good):
            theta[place] = _bracketed(
                derivatives[:2, place], rate, left[place], right[place], brackets.low[place]
            )
    return theta


def _bracketed(
    derivatives: np.ndarray, rate: np.ndarray, left: float, right: float, low: float
) -> float:
    """Newton's method kept inside a bracket, from its middle."""
    theta = 0.5 * (left + right)
    for _ in range(100):
        value, slope = (derivatives @ np.exp(theta * rate)).real
        if (value > 0.0) == (low > 0.0):
            left = theta
        else:
            right = theta
        newton = theta - value / slope if slope else np.nan
        updated = newton if left <= newton <= right else 0.5 * (left + right)
        if abs(updated - theta) <= 1e-15 * np.pi:
            break
        theta = updated
    return theta
