"""Observables: the numbers that describe a motion, one row each in one table, :data:`QUANTITIES`.

A row states a number in words with its unit, how it is read at its place, and where it is shown
unless a scene chooses. Tables, files, pictures, the columns of sweeps, ``[output] quantities``,
stated errors and the list in the reference follow from it.

What is at a place, which ``read`` takes, is a ``PointDisplacement`` or ``CrackFaces`` of
:mod:`fenics_crack.motion.motions`, an ``AtTip`` or ``Held`` of :mod:`fenics_crack.study.observer`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum, Flag, auto
from functools import cache, partial
from typing import Any

import numpy as np


class Place(Enum):
    """Source that an observable is read from."""

    POINT = "each watched point and direction"
    FACES = "all crack faces"
    MODES = "the mode whose bilinear frequency is nearest to the load's"
    TIPS = "the crack tip, or place of a crack front, whose effective range is the largest"
    ELLIPSE = "the deepest place and the ends of a half-ellipse"
    CLAMP = "the clamp"

    @property
    def on_request(self) -> bool:
        """True if it takes rows of its own, which are made where a scene requests its numbers."""
        return self not in (Place.POINT, Place.FACES, Place.MODES)


class Where(Flag):
    """Tables that show an observable unless a scene chooses, and its requirements."""

    FILES = 0
    PRINTED = auto()
    """Among the numbers of a motion."""
    SPECIAL = auto()
    """At special points of a curve and in cases of a sweep; no wider than a terminal."""
    DRAWN = auto()
    """Over the axes of a sweep."""
    STATED = auto()
    """With its error."""
    FRICTION = auto()
    """Requires friction."""
    GROWING = auto()
    """Requires a law of growth."""
    SOLID = auto()
    """Requires a solid."""


PRINTED, SPECIAL, DRAWN, STATED, FRICTION, GROWING, SOLID = Where
FILES, SHOWN = Where.FILES, PRINTED | STATED
EVERYWHERE = SHOWN | SPECIAL | DRAWN


@dataclass(frozen=True, repr=False)
class Observable:
    """A number that describes a motion.

    Attributes
    ----------
    of : Place
        Where it is read.
    words, unit : str
        Description and unit.
    read : callable, optional
        Its value from what is at the place. Default: an entry of
        :meth:`fenics_crack.BilinearFrequencies.nearest`.
    where : Where
        Where it is shown, and what it requires.
    """

    of: Place
    words: str
    unit: str
    read: Callable[[Any], Any] = float
    where: Where = FILES

    def __repr__(self) -> str:
        return f"{self.words} [{self.unit}]"


def _largest(vectors: np.ndarray) -> Any:
    """Largest size of vectors (n, d)."""
    return np.linalg.norm(vectors, axis=1).max()


_point, _face = partial(Observable, Place.POINT), partial(Observable, Place.FACES)
_mode, _tip = partial(Observable, Place.MODES), partial(Observable, Place.TIPS)
_ellipse = partial(Observable, Place.ELLIPSE, unit="Pa m^0.5", where=Where.GROWING)
_clamp = partial(Observable, Place.CLAMP)


# fmt: off
# ruff: noqa: RUF009  # observables are frozen
@dataclass(frozen=True, repr=False)
class Observables:
    """Values at a point and at the crack faces; the default of each is its row of the table."""

    omega: Any
    amplitude: Any = _point("half peak-to-peak", "m", lambda at: at.amplitude, EVERYWHERE)
    mean: Any = _point("mean displacement", "m", lambda at: at.mean)
    harmonic_1: Any = _point("amplitude at the load frequency", "m", lambda at: at.harmonic(1))
    harmonic_2: Any = _point("amplitude at twice the load frequency", "m",
        lambda at: at.harmonic(2))
    harmonic_3: Any = _point("amplitude at three times the load frequency", "m",
        lambda at: at.harmonic(3))
    ratio_2_1: Any = _point("harmonic ratio 2/1", "1", lambda at: at.ratio(2), EVERYWHERE)
    ratio_3_1: Any = _point("harmonic ratio 3/1", "1", lambda at: at.ratio(3), SHOWN | DRAWN)
    ratio_half_1: Any = _point("harmonic ratio 1/2 over 1", "1", lambda at: at.ratio(0.5), PRINTED)
    ratio_largest: Any = _point("largest harmonic above the load's, over harmonic 1", "1",
        lambda at: at.ratio_largest, SHOWN)
    largest_order: Any = _point("order of the largest harmonic above the load's", "1",
        lambda at: at.largest_order, PRINTED)
    mean_shift: Any = _point("mean displacement over harmonic 1", "1",
        lambda at: at.mean / at.fundamental, SHOWN | DRAWN)
    opening: Any = _face("largest opening", "m",
        lambda at: max(at.gap_and_force_maxima[0], 0.0), EVERYWHERE)
    penetration: Any = _face("largest penetration", "m",
        lambda at: max(at.gap_and_force_maxima[1], 0.0), PRINTED)
    contact_force: Any = _face("largest contact force of a pair", "N",
        lambda at: at.gap_and_force_maxima[2], PRINTED)
    crack_force: Any = _face("largest contact force of a crack, all pairs", "N",
        lambda at: at.gap_and_force_maxima[3], SHOWN)
    closed_share: Any = _face("contact duty cycle, mean over pairs", "1",
        lambda at: (at.force > 0.0).mean(), EVERYWHERE)
    friction_loss: Any = _face("friction loss of a period", "J", lambda at: at.losses.sum(),
        SHOWN | FRICTION)
    stick_share: Any = _face("share of the period in which pairs stick, mean over pairs", "1",
        lambda at: at.is_sticking_at_instants.mean(), PRINTED | FRICTION)
    slip_share: Any = _face("share of the period in which pairs slip, mean over pairs", "1",
        lambda at: at.is_slipping_at_instants.mean(), SHOWN | FRICTION)


QUANTITIES: dict[str, Observable] = {
    one.name: one.default for one in fields(Observables) if isinstance(one.default, Observable)
} | {
    "omega_open": _mode("natural frequency, crack open", "rad/s"),
    "omega_tied": _mode("natural frequency, crack bonded", "rad/s"),
    "omega_bilinear": _mode("bilinear frequency", "rad/s"),
    "over_open": _mode("load frequency / natural frequency, crack open", "1", where=PRINTED),
    "over_tied": _mode("load frequency / natural frequency, crack bonded", "1"),
    "over_bilinear": _mode("load frequency / bilinear frequency", "1", where=PRINTED | SPECIAL),
    "K_max": _tip("largest stress intensity K_I", "Pa m^0.5", lambda at: at.one.max()),
    "K_min": _tip("smallest K_I", "Pa m^0.5", lambda at: at.one.min()),
    "delta_K": _tip("range of K_I", "Pa m^0.5", lambda at: np.ptp(at.one)),
    "delta_K_effective": _tip("range of K_I while the crack tip is open", "Pa m^0.5",
        lambda at: np.ptp(at.one.clip(0.0))),
    "K_II_max": _tip("largest stress intensity K_II, of either sign", "Pa m^0.5",
        lambda at: np.abs(at.two).max()),
    "K_III_max": _tip("largest stress intensity K_III, of either sign", "Pa m^0.5",
        lambda at: np.abs(at.three).max(), SOLID),
    "delta_K_equivalent": _tip("range of K_I, R = 0, that makes the crack grow as much", "Pa m^0.5",
        lambda at: at.equivalent, GROWING),
    "delta_K_effective_deepest": _ellipse("range of K_I while open, at the deepest place",
        read=lambda at: np.ptp(at.deepest.one.clip(0.0))),
    "delta_K_effective_surface": _ellipse("range of K_I while open, mean of the ends",
        read=lambda at: np.mean([np.ptp(end.one.clip(0.0)) for end in at.ends])),
    "delta_K_equivalent_deepest": _ellipse("range that makes it grow as much in depth",
        read=lambda at: at.deepest.equivalent),
    "delta_K_equivalent_surface": _ellipse("range that makes it grow as much along the face",
        read=lambda at: np.mean([end.equivalent for end in at.ends])),
    "reaction_force": _clamp("largest force of the clamp", "N", lambda at: _largest(at.force)),
    "reaction_moment": _clamp("largest moment of the clamp, about its centre", "N m",
        lambda at: _largest(at.moment)),
}
"""All observables by their names."""
# fmt: on


@cache
def names_of(*places: Place, where: Where = FILES, without: Where = FILES) -> tuple[str, ...]:
    """Return the names of the observables of some places, or of all, that are shown somewhere and
    do not require what is missing."""
    return tuple(
        name
        for name, row in QUANTITIES.items()
        if (not places or row.of in places) and where in row.where and not row.where & without
    )


def read_at(place: Place, there: Any, without: Where = FILES) -> dict[str, float]:
    """Return the numbers of what is at a place by their names, but for those that require what is
    missing."""
    return {name: float(QUANTITIES[name].read(there)) for name in names_of(place, without=without)}
