"""Growth of a crack that is half of an ellipse, or a quarter of one, in depth and along the face.

With the ranges of K_I at the deepest place and at the ends, on the face of the solid,

    da/dN = C delta K_a^m,      dc/dN = C delta K_c^m,

a being the depth and c the half axis along the face; the front stays an ellipse (Newman, Raju,
NASA TM-83200, 1981). Ranges are known at a grid of shapes, and between them K / a^(1/2) is a
spline over ln a and ln c: no logarithm of K, which in bending comes to zero at the deepest place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from fenics_crack.scene.tables import Growth as Law

End = Literal["reached", "arrested", "broken", "side"]
ROWS = 200
"""Of the path of the shape."""
SOFT = 0.01
"""Part of the threshold over which a rate begins, below the errors of K: with a jump a shape that
goes along the threshold, as deep cracks in bending do, would need steps without end."""
DEEPEST, SURFACE = "delta_K_{}_deepest", "delta_K_{}_surface"
DRIVING = tuple(name.format("equivalent") for name in (DEEPEST, SURFACE))
RANGES = tuple(name.format("effective") for name in (DEEPEST, SURFACE))


@dataclass(frozen=True)
class EllipseTable:
    """Numbers at a grid of shapes, and splines through them.

    Attributes
    ----------
    depths : (k,) [m]
        a, ascending.
    lengths : (l,) [m]
        Of the crack along the face, ascending: c, or 2 c.
    columns : dict of str to (k, l)
        Those of stress intensities begin with "K" or "delta_K".
    """

    depths: np.ndarray
    lengths: np.ndarray
    columns: Mapping[str, np.ndarray]

    @cached_property
    def _splines(self) -> dict[str, Any]:
        from scipy.interpolate import RectBivariateSpline  # takes a while, and is needed here alone

        axes = np.log(self.depths), np.log(self.lengths)
        kx, ky = (min(3, len(axis) - 1) for axis in axes)
        scales = np.sqrt(self.depths)[:, None], 1.0
        return {
            name: RectBivariateSpline(*axes, values / scales[not _rooted(name)], kx=kx, ky=ky)
            for name, values in self.columns.items()
        }

    def at(self, name: str, depth: np.ndarray, length: np.ndarray) -> np.ndarray:
        """A column at any shapes within; ranges are at least zero."""
        found = self._splines[name].ev(np.log(depth), np.log(length))
        found = found.clip(0.0) if name.startswith("delta_K") else found
        return np.asarray(found * np.sqrt(depth) if _rooted(name) else found)

    def coarser(self) -> EllipseTable:
        """Of every other depth and length."""
        some = {name: values[::2, ::2] for name, values in self.columns.items()}
        return EllipseTable(self.depths[::2], self.lengths[::2], some)


def _rooted(name: str) -> bool:
    """True of a stress intensity, which goes with the root of the depth."""
    return name.startswith(("K", "delta_K"))


class EllipsePath(NamedTuple):
    """Depths and lengths (n,) [m] over the cycles (n,), what they grow by in a cycle (n, 2) [m],
    and how it ends."""

    depth: np.ndarray
    length: np.ndarray
    cycles: np.ndarray
    rates: np.ndarray
    end: End


def growth_in_a_cycle(
    table: EllipseTable, law: Law, ends: int, depth: np.ndarray, length: np.ndarray
) -> np.ndarray:
    """Of depths and lengths (n,), of cracks of one or two ends on the face: (n, 2) [m]."""
    found = []
    for drive, reach in zip(DRIVING, RANGES, strict=True):
        rate = law.rate * (table.at(drive, depth, length) / 1e6) ** law.exponent
        if law.threshold > 0.0:
            above = table.at(reach, depth, length) / law.threshold - 1.0
            rate = rate * np.clip(above / SOFT, 0.0, 1.0)
        found.append(rate)
    return np.stack([found[0], ends * found[1]], axis=-1)


def grown(table: EllipseTable, law: Law, ends: int) -> EllipsePath:
    """The path from the first depth and length of a table to where it ends.

    With the sum s of what depth and length have grown by as the variable, da/ds and dl/ds are
    bounded, and dN/ds = 1 / (da/dN + dl/dN): a depth that stops, and nearly a crack, is no trouble.
    """
    from scipy.integrate import solve_ivp

    tough = law.toughness or np.inf

    def rates(at: np.ndarray) -> np.ndarray:
        return growth_in_a_cycle(table, law, ends, *at[:2, None])[0]

    def slope(_s: float, at: np.ndarray) -> np.ndarray:
        both = rates(at)
        whole = both.sum()
        return np.append(both, 1.0) / whole if whole > 0.0 else np.zeros(3)

    events = {
        "reached": lambda _s, at: at[0] - table.depths[-1],
        "side": lambda _s, at: at[1] - table.lengths[-1],
        "broken": lambda _s, at: float(table.at("K_max", *at[:2, None])[0]) / tough - 1.0,
        "arrested": lambda _s, at: -1.0 if rates(at).any() else 0.0,
    }
    for event in events.values():
        event.terminal = True  # type: ignore[attr-defined]
    start = np.array([table.depths[0], table.lengths[0], 0.0])
    most = np.ptp(table.depths) + np.ptp(table.lengths)
    found = solve_ivp(
        slope, (0.0, most), start, "LSODA", rtol=1e-8, atol=1e-12, max_step=most / ROWS,
        events=list(events.values()), dense_output=True,
    )  # fmt: skip
    ends_of = [name for name, places in zip(events, found.t_events, strict=True) if len(places)]
    end: End = ends_of[0] if ends_of else "arrested"  # type: ignore[assignment]
    if float(table.at("K_max", *start[:2, None])[0]) >= tough:
        end, last = "broken", 0.0
    else:
        last = found.t[-1] if rates(start).any() else 0.0
    depth, length, cycles = found.sol(np.linspace(0.0, last, ROWS if last else 1))
    both = growth_in_a_cycle(table, law, ends, depth, length)
    return EllipsePath(depth, length, cycles, both, end)
