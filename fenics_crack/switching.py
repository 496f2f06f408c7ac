"""Switching instants: every sign change of real trigonometric polynomials, certified.

    g(theta) = Re sum_{k=0}^{H} G_k exp(i k theta),      theta = omega t in [0, 2 pi)

A grid alone misses pairs of roots between its points, where a pair of lips only grazes. Here a cell
[a, a + w] is settled by a bound or not at all. With |g''| <= M = sum_k k^2 |G_k|,

- equal signs and min(|g(a)|, |g(a + w)|) > M w^2 / 8: no root, g lies that close to its chord;
- opposite signs and |g(a + w) - g(a)| > M w^2 / 2: one root, g' keeps its sign;
- else the cell is divided, until all that could be missed is an excursion below RESOLUTION times
  the largest |g|.

Roots are polished by Newton's method kept inside its bracket. All polynomials are treated together.
"""

from __future__ import annotations

from dataclasses import dataclass

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
        Phase in [0, 2 pi], in no particular order.
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
    count, table = len(harmonics) - 1, harmonics.T
    order = np.arange(count + 1.0)
    curvature = np.abs(table) @ order**2
    if not np.all(np.isfinite(curvature)):  # an iterate gone astray: no roots, but an end
        table = np.where(np.isfinite(curvature)[:, None], table, 0.0)
        curvature = np.where(np.isfinite(curvature), curvature, 0.0)
    samples = 1 << (16 * (count + 1) - 1).bit_length()
    spectrum = 0.5 * samples * table
    spectrum[:, 0] = samples * table[:, 0].real
    values = np.fft.irfft(spectrum, n=samples, axis=1)
    resolution = RESOLUTION * np.abs(values).max(axis=1)

    width = 2.0 * np.pi / samples
    following = np.empty_like(values)
    following[:, :-1], following[:, -1] = values[:, 1:], values[:, 0]
    changes, settled = _classify(values, following, (curvature * width**2)[:, None])
    pair, cell = np.nonzero(changes & settled)
    found = [_Brackets(pair, cell * width, width, values[pair, cell], following[pair, cell])]
    pair, cell = np.nonzero(~settled)
    open_cells = _Brackets(pair, cell * width, width, values[pair, cell], following[pair, cell])
    while len(open_cells.pair):
        roots, open_cells = _divide(open_cells, table, curvature, resolution)
        found.append(roots)
    brackets = found[0] if len(found) == 1 else _joined(found)
    theta = _polished(brackets, table[brackets.pair])
    closing = np.where(brackets.high > brackets.low, 1.0, -1.0)
    return Switching(brackets.pair, theta, closing, values[:, 0] > 0.0)


@dataclass
class _Brackets:
    """Cells [left, left + width] of pairs, with the values at both ends."""

    pair: np.ndarray
    left: np.ndarray
    width: float | np.ndarray
    low: np.ndarray
    high: np.ndarray


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
    settled |= (bound <= 8.0 * resolution[cells.pair])[:, None]  # equal where g is zero

    def pick(chosen: np.ndarray) -> _Brackets:
        row, part = np.nonzero(chosen)
        return _Brackets(
            cells.pair[row], points[row, part], width, values[row, part], values[row, part + 1]
        )

    return pick(changes & settled), pick(~settled)


def _joined(found: list[_Brackets]) -> _Brackets:
    widths = [np.full(len(cells.pair), cells.width) for cells in found]
    return _Brackets(
        np.concatenate([cells.pair for cells in found]),
        np.concatenate([cells.left for cells in found]),
        np.concatenate(widths),
        np.concatenate([cells.low for cells in found]),
        np.concatenate([cells.high for cells in found]),
    )


def _polished(brackets: _Brackets, table: np.ndarray) -> np.ndarray:
    """Newton's method from the chord's root; a step out of the bracket is replaced by its middle.

    It stops when the last step was so small that the next one would be rounding.
    """
    left, low = brackets.left, brackets.low
    right = left + brackets.width
    theta = left - brackets.width * low / (brackets.high - low)
    order = np.arange(table.shape[1])
    starts_positive = low > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(60 if len(left) else 0):
            wave = table * np.exp(1j * np.multiply.outer(theta, order))
            value, slope = wave.real.sum(axis=1), -(wave.imag @ order)
            before = (value > 0.0) == starts_positive
            left, right = np.where(before, theta, left), np.where(before, right, theta)
            updated = theta - value / slope
            inside = (updated >= left) & (updated <= right)
            if not inside.all():
                updated = np.where(inside, updated, 0.5 * (left + right))
            step = np.abs(updated - theta).max()
            theta = updated
            if step < 1e-9:
                break
    return theta
