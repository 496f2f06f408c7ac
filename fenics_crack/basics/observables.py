"""Observables: the numbers that describe a motion, one row each in one table, :data:`QUANTITIES`.

A row states a number in words with its unit, how it is read at its place, and where it is shown
unless a scene chooses. Tables, files, pictures, the columns of sweeps, ``[output] quantities``,
stated errors and the list in the reference follow from it.

What is at a place, which ``read`` takes, is a ``Point`` or ``Faces`` of
:mod:`fenics_crack.motion.motions`, a ``Tip`` or ``Held`` of :mod:`fenics_crack.study.observer`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum, Flag, auto
from functools import partial
from typing import Any

import numpy as np


class Place(Enum):
    """Where an observable is read."""

    POINT = "each watched point and direction"
    FACES = "all crack faces"
    MODES = "the mode whose bilinear frequency is nearest to the load's"
    TIPS = "the crack tip whose effective range is the largest"
    CLAMP = "the clamp"

    @property
    def on_request(self) -> bool:
        """True if it takes rows of its own, which are made where a scene requests its numbers."""
        return self in (Place.TIPS, Place.CLAMP)


class Where(Flag):
    """Where an observable is shown unless a scene chooses, and what it requires."""

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
    GROWTH = auto()
    """Requires a law of growth."""


PRINTED, SPECIAL, DRAWN, STATED = Where.PRINTED, Where.SPECIAL, Where.DRAWN, Where.STATED
SHOWN = PRINTED | STATED


@dataclass(frozen=True)
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
    where: Where = Where.FILES


def _largest(vectors: np.ndarray) -> Any:
    """Largest size of vectors (n, d)."""
    return np.linalg.norm(vectors, axis=1).max()


_of_point, _of_faces = partial(Observable, Place.POINT), partial(Observable, Place.FACES)
_of_mode, _of_tip = partial(Observable, Place.MODES), partial(Observable, Place.TIPS)
_of_clamp = partial(Observable, Place.CLAMP)


# fmt: off
# ruff: noqa: RUF009  # observables are frozen
@dataclass(frozen=True, repr=False)
class Observables:
    """Values at a point and at the crack faces; the default of each is its row of the table."""

    omega: Any
    amplitude: Any = _of_point("half peak-to-peak", "m", lambda at: at.amplitude,
        SHOWN | SPECIAL | DRAWN)
    mean: Any = _of_point("mean displacement", "m", lambda at: at.mean)
    harmonic_1: Any = _of_point("amplitude at the load frequency", "m", lambda at: at.harmonic(1))
    harmonic_2: Any = _of_point("amplitude at twice the load frequency", "m",
        lambda at: at.harmonic(2))
    harmonic_3: Any = _of_point("amplitude at three times the load frequency", "m",
        lambda at: at.harmonic(3))
    ratio_2_1: Any = _of_point("harmonic ratio 2/1", "1", lambda at: at.ratio(2),
        SHOWN | SPECIAL | DRAWN)
    ratio_3_1: Any = _of_point("harmonic ratio 3/1", "1", lambda at: at.ratio(3), SHOWN | DRAWN)
    ratio_half_1: Any = _of_point("harmonic ratio 1/2 over 1", "1", lambda at: at.ratio(0.5),
        PRINTED)
    ratio_largest: Any = _of_point("largest harmonic above the load's, over harmonic 1", "1",
        lambda at: at.ratio_largest, SHOWN)
    largest_order: Any = _of_point("order of the largest harmonic above the load's", "1",
        lambda at: at.largest_order)
    mean_shift: Any = _of_point("mean displacement over harmonic 1", "1",
        lambda at: at.mean / at.first, SHOWN | DRAWN)
    opening: Any = _of_faces("largest opening", "m", lambda faces: max(faces.tops[0], 0.0),
        SHOWN | SPECIAL | DRAWN)
    penetration: Any = _of_faces("largest penetration", "m", lambda faces: max(faces.tops[1], 0.0),
        PRINTED)
    contact_force: Any = _of_faces("largest contact force of a pair", "N",
        lambda faces: faces.tops[2], PRINTED)
    crack_force: Any = _of_faces("largest contact force of a crack, all pairs", "N",
        lambda faces: faces.tops[3], SHOWN)
    closed_share: Any = _of_faces("contact duty cycle, mean over pairs", "1",
        lambda faces: (faces.force > 0.0).mean(), SHOWN | SPECIAL | DRAWN)
    friction_loss: Any = _of_faces("friction loss of a period", "J",
        lambda faces: faces.losses.sum(), SHOWN | Where.FRICTION)
    stick_share: Any = _of_faces("share of the period in which pairs stick, mean over pairs", "1",
        lambda faces: faces.sticks.mean(), PRINTED | Where.FRICTION)
    slip_share: Any = _of_faces("share of the period in which pairs slip, mean over pairs", "1",
        lambda faces: faces.slips.mean(), SHOWN | Where.FRICTION)


QUANTITIES: dict[str, Observable] = {
    one.name: one.default for one in fields(Observables) if isinstance(one.default, Observable)
} | {
    "omega_open": _of_mode("natural frequency, crack open", "rad/s"),
    "omega_tied": _of_mode("natural frequency, crack bonded", "rad/s"),
    "omega_bilinear": _of_mode("bilinear frequency", "rad/s"),
    "over_open": _of_mode("load frequency / natural frequency, crack open", "1", where=PRINTED),
    "over_tied": _of_mode("load frequency / natural frequency, crack bonded", "1"),
    "over_bilinear": _of_mode("load frequency / bilinear frequency", "1", where=PRINTED | SPECIAL),
    "K_max": _of_tip("largest stress intensity K_I", "Pa m^0.5", lambda tip: tip.one.max()),
    "K_min": _of_tip("smallest K_I", "Pa m^0.5", lambda tip: tip.one.min()),
    "delta_K": _of_tip("range of K_I", "Pa m^0.5", lambda tip: np.ptp(tip.one)),
    "delta_K_effective": _of_tip("range of K_I while the crack tip is open", "Pa m^0.5",
        lambda tip: np.ptp(tip.while_open)),
    "K_II_max": _of_tip("largest stress intensity K_II, of either sign", "Pa m^0.5",
        lambda tip: np.abs(tip.two).max()),
    "delta_K_equivalent": _of_tip("range of K_I, R = 0, that makes the crack grow as much",
        "Pa m^0.5", lambda tip: tip.equivalent, Where.GROWTH),
    "reaction_force": _of_clamp("largest force of the clamp", "N",
        lambda held: _largest(held.force)),
    "reaction_moment": _of_clamp("largest moment of the clamp, about its centre", "N m",
        lambda held: _largest(held.moment)),
}
"""All observables by their names."""
# fmt: on


def names_of(*places: Place, where: Where = Where.FILES) -> tuple[str, ...]:
    """Return the names of the observables of some places, or of all, that are shown somewhere."""
    return tuple(
        name
        for name, row in QUANTITIES.items()
        if (not places or row.of in places) and where in row.where
    )
