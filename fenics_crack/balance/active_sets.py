"""When which pairs are closed, for contact that couples the pairs: found cell by cell, in order.

Between two events the set A of closed pairs stays, and with it lambda_A = (D_AA)^-1 s_A and the
openings of the others, D lambda - s (:mod:`fenics_crack.model.coupled`). An event is the first root
of one of these: a force that vanishes opens its pair, an opening that vanishes closes it.

On the cells of a grid, 16 and more to the shortest wave, the sets at both ends are found first. A
cell is searched where they differ, or where a force or an opening that is positive at both ends
would vanish on the two tangents there. In a cell the waves are replaced by their Taylor polynomials
about its middle, to rounding. The first root is bracketed on a few points, and on the minima
between them, and polished; behind it the set differs by one pair; and so on to the end of the cell.
All cells go through this together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_crack.balance.fourier import from_complex, sampled
from fenics_crack.model.coupled import ActiveSets, unique_sets

__all__ = ["Intervals", "contact_intervals"]

CELLS, CELLS_OF_PAIR = 16, 32
"""At least so many to the shortest wave, and in the period to every pair: few events in a cell."""
DEGREE = 8
"""Of the Taylor polynomials: 0.2^9 / 9! is 1e-12."""
POINTS = 6
"""Of a bracket's search in what is left of a cell."""


@dataclass(frozen=True)
class Intervals:
    """Sets of closed pairs over a period.

    Attributes
    ----------
    theta : (m,) [rad]
        Where each interval begins, the first at 0; ascending.
    which : (m,)
        The row of ``sets`` in each interval.
    sets : (n_sets, n_pairs) bool
        Different sets of closed pairs.
    """

    theta: np.ndarray
    which: np.ndarray
    sets: np.ndarray

    def means(self, highest: int) -> np.ndarray:
        """Means over the period of exp(i m theta) while each set is closed: (n_sets, highest+1)."""
        order = np.arange(highest + 1)
        ends = np.append(self.theta, 2.0 * np.pi)
        waves = np.exp(1j * np.multiply.outer(ends, order))
        waves[:, 0] = ends
        waves[:, 1:] /= 1j * order[1:]
        total = np.zeros((len(self.sets), highest + 1), dtype=complex)
        np.add.at(total, self.which, np.diff(waves, axis=0))
        return total / (2.0 * np.pi)


def contact_intervals(harmonics: np.ndarray, contact: ActiveSets) -> Intervals:
    """The intervals of waves s with complex harmonics (H+1, n_pairs)."""
    most = max(CELLS * len(harmonics), CELLS_OF_PAIR * harmonics.shape[1])
    count = 1 << (most - 1).bit_length()
    order = np.arange(len(harmonics))[:, None]
    values, rates = (
        sampled(from_complex(wave), count) for wave in (harmonics, 1j * order * harmonics)
    )
    _, closed = contact.solve(values)
    width = 2.0 * np.pi / count
    searched = _searched(contact, values, width * rates, closed)
    cells = _Cells(harmonics, contact, (searched + 0.5) * width, width, closed[searched])
    number, theta, sets = cells.events()
    wrong = np.flatnonzero(np.any(cells.closed != closed[(searched + 1) % count], axis=1))
    theta = np.concatenate([[0.0], theta, (searched[wrong] + 1) * width])
    sets = np.concatenate([closed[:1], sets, closed[(searched[wrong] + 1) % count]])
    order = np.argsort(np.concatenate([[-1], number, wrong]), kind="stable")
    different, which = unique_sets(sets[order])
    return Intervals(np.maximum.accumulate(theta[order]), which, different)


def _margins(contact: ActiveSets, values: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """Forces of closed pairs, scaled to gaps, and openings of open ones: (n, n_pairs) [m]."""
    force = contact.forces(values, closed)
    return np.where(closed, force * contact.scale, force @ contact.compliance - values)


def _searched(
    contact: ActiveSets, values: np.ndarray, rates: np.ndarray, closed: np.ndarray
) -> np.ndarray:
    """Numbers of the cells in which there may be events; ``rates`` per cell."""
    margin, rate = (_margins(contact, part, closed) for part in (values, rates))
    after, slope = np.roll(margin, -1, axis=0), -np.roll(rate, -1, axis=0)
    changes = np.any(closed != np.roll(closed, -1, axis=0), axis=1)
    # Tangents m + r x and m' + r' (1 - x), both falling into the cell, meet below zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        lowest = (margin * slope + after * rate + rate * slope) / (rate + slope)
    grazes = np.any((rate < 0.0) & (slope < 0.0) & (lowest < 0.0), axis=1)
    return np.flatnonzero(changes | grazes)


class _Cells:
    """Cells that are searched, each from its beginning on with the set that is closed there."""

    def __init__(
        self,
        harmonics: np.ndarray,
        contact: ActiveSets,
        middle: np.ndarray,
        width: float,
        closed: np.ndarray,
    ) -> None:
        self._contact, self._middle, self._width = contact, middle, width
        self.closed = closed.copy()
        # Taylor coefficients in x = (theta - middle) / (width / 2): (n, DEGREE + 1, n_pairs).
        order = np.arange(len(harmonics))
        waves = np.exp(1j * np.multiply.outer(middle, order))
        degree = np.arange(DEGREE + 1)
        factorials = np.cumprod(np.maximum(degree, 1))
        rates = (0.5j * width * order) ** degree[:, None] / factorials[:, None]
        self._taylor = ((waves[:, None, :] * rates) @ harmonics).real

    def events(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cells and phases of all events, in the order of each cell, and the sets closed behind
        them; :attr:`closed` at the ends."""
        begun = np.full(len(self._middle), -1.0)
        going: np.ndarray = np.arange(len(begun))
        last = np.full(len(begun), -1)
        number, theta, sets = [going[:0]], [np.zeros(0)], [self.closed[:0]]
        for _ in range(4 * self.closed.shape[1] + 8):
            if not len(going):
                break
            pair, place = self._first(going, begun[going], last[going])
            found = pair >= 0
            going, pair, place = going[found], pair[found], place[found]
            self.closed[going, pair] ^= True
            begun[going], last[going] = place, pair
            number.append(going)
            theta.append(self._middle[going] + 0.5 * self._width * place)
            sets.append(self.closed[going])
        return np.concatenate(number), np.concatenate(theta), np.concatenate(sets)

    def _first(
        self, cells: np.ndarray, begun: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The pair of the next event in cells, -1 where there is none, and where it happens."""
        taylor, closed = self._taylor[cells], self.closed[cells]
        polynomials = _margins(
            self._contact,
            taylor.reshape(-1, closed.shape[1]),
            np.repeat(closed, DEGREE + 1, axis=0),
        ).reshape(taylor.shape)
        known = np.flatnonzero(last >= 0)
        polynomials[known, :, last[known]] = _without_root(
            polynomials[known, :, last[known]], begun[known]
        )
        places = begun[:, None] + (1.0 - begun[:, None]) * np.linspace(0.0, 1.0, POINTS + 1)
        high = _negative(polynomials, places)
        negative = ~np.isnan(high)
        first = np.argmax(negative.any(axis=2), axis=1)
        which, pair = np.nonzero(negative[np.arange(len(cells)), first])
        roots = _roots(
            polynomials[which, :, pair],
            places[which, first[which]],
            high[which, first[which], pair],
        )
        order = np.lexsort((roots, which))
        found, place = np.unique(which[order], return_index=True)
        chosen, at = np.full(len(cells), -1), np.zeros(len(cells))
        chosen[found], at[found] = pair[order[place]], roots[order[place]]
        return chosen, at


def _without_root(polynomials: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Polynomials (n, DEGREE + 1) divided by x - root: behind it their signs stay. Where a margin
    does not grow behind its own event, what comes next is left to the set at the cell's end: 1."""
    found = np.zeros_like(polynomials)
    for column in range(DEGREE, 0, -1):
        found[:, column - 1] = polynomials[:, column] + root * (
            found[:, column] if column < DEGREE else 0.0
        )
    falls = np.sum(found * root[:, None] ** np.arange(DEGREE + 1), axis=1) <= 0.0
    found[falls] = np.eye(DEGREE + 1)[0]
    return found


def _negative(polynomials: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Where polynomials (n, DEGREE + 1, n_pairs) are negative between places (n, POINTS + 1), at
    the end of an interval or at a minimum inside: (n, POINTS, n_pairs), nan where they are not."""
    degree = np.arange(DEGREE + 1)
    powers = places[:, :, None] ** degree
    values, slopes = (
        powers @ polynomials,
        powers[:, :, :-1] @ (polynomials * degree[:, None])[:, 1:],
    )
    width = np.diff(places, axis=1)[:, :, None]
    high = np.where(values[:, 1:] < 0.0, places[:, 1:, None], np.nan)
    fall, rise = width * slopes[:, :-1], width * slopes[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        # Tangents at both ends meet below zero.
        lowest = (values[:, :-1] * rise - fall * values[:, 1:] + fall * rise) / (rise - fall)
    dips = (fall < 0.0) & (rise > 0.0) & (lowest < 0.0) & np.isnan(high)
    which, interval, pair = np.nonzero(dips)
    rows = polynomials[which, :, pair]
    rates = rows[:, 1:] * degree[1:]
    low, end = places[which, interval], places[which, interval + 1]
    bottom = _roots(-rates, low, end)
    below = np.sum(rows * bottom[:, None] ** degree, axis=1) < 0.0
    high[which[below], interval[below], pair[below]] = bottom[below]
    return high


def _roots(polynomials: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """A root of each polynomial (n, any) in [low, high], at whose end it is negative; ``low`` where
    it is negative there already. Newton's method, kept in a bracket by bisection."""
    degree = np.arange(1, polynomials.shape[1])
    slopes = polynomials[:, 1:] * degree

    def value(rows: np.ndarray, at: np.ndarray) -> np.ndarray:
        found: np.ndarray = rows[:, -1].copy()
        for column in range(rows.shape[1] - 2, -1, -1):
            found = found * at + rows[:, column]
        return found

    low, high = low.copy(), high.copy()
    first, last = value(polynomials, low), value(polynomials, high)
    behind = first <= 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.where(behind, low, low + (high - low) * first / (first - last))
        for _ in range(60):
            now = value(polynomials, root)
            positive = now > 0.0
            low, high = np.where(positive, root, low), np.where(positive, high, root)
            step = now / value(slopes, root)
            newton = root - step
            inside = (newton >= low) & (newton <= high)
            moved = np.where(inside, newton, 0.5 * (low + high))
            done = np.abs(moved - root) <= 1e-13
            root = np.where(behind, root, moved)
            if np.all(done | behind):
                break
    return root
