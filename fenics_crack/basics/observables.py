"""List the numbers that describe a motion in one table, :data:`OBSERVABLES_BY_NAME`.

A row is an :class:`Observable`. It holds a description and a unit, the place, the function to read
the number there, and the tables with this number unless a scene chooses. Tables, files, pictures,
the columns of sweeps, ``[output] quantities``, stated errors and the list in the reference follow
from this table.

A function to read a number takes the object at the place. :mod:`fenics_crack.motion.motions` has
the classes ``PointDisplacement`` and ``CrackFaceGapsAndForces``, :mod:`fenics_crack.study.observer`
has ``CrackTipHistory`` and ``ClampReactions``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum, Flag, auto
from functools import cache, partial
from typing import Any

import numpy as np


class Place(Enum):
    """Place at which an observable is read; the value describes the place in the reference."""

    WATCHED_POINT = "each watched point and direction"
    CRACK_FACES = "all crack faces"
    MODE_NEAREST_TO_LOAD_FREQUENCY = (
        "the mode whose bilinear frequency is nearest to the load frequency"
    )
    MOST_LOADED_TIP = "the crack tip, or front station, with the largest effective range of K_I"
    DEEPEST_PLACE_AND_ELLIPSE_ENDS = "the deepest place and the ends of a half-ellipse"
    CLAMP = "the clamp"

    @property
    def is_made_on_request(self) -> bool:
        """True if numbers at this place are computed only for a scene that requests them."""
        return self not in (
            Place.WATCHED_POINT,
            Place.CRACK_FACES,
            Place.MODE_NEAREST_TO_LOAD_FREQUENCY,
        )


class ObservableTableFlag(Flag):
    """Flags of an observable: tables that show it, and conditions for computing it.

    A flag without value, ``IN_FILES_ONLY``, means no table and no condition.
    """

    IN_FILES_ONLY = 0
    IN_PRINTED_TABLE = auto()
    """Shown in the printed table of a motion."""
    IN_SPECIAL_POINTS_TABLE = auto()
    """Shown at special points of a curve and in cases of a sweep.

    These tables are no wider than a terminal.
    """
    IN_SWEEP_PICTURES = auto()
    """Drawn over the axes of a sweep."""
    STATED_WITH_ERROR = auto()
    """Printed with an estimated error."""
    REQUIRES_FRICTION = auto()
    """Computed only with friction."""
    REQUIRES_GROWTH_LAW = auto()
    """Computed only with a law of crack growth."""
    REQUIRES_SOLID = auto()
    """Computed only for a solid, not for a plate."""


(
    IN_PRINTED_TABLE, IN_SPECIAL_POINTS_TABLE, IN_SWEEP_PICTURES, STATED_WITH_ERROR,
    REQUIRES_FRICTION, REQUIRES_GROWTH_LAW, REQUIRES_SOLID,
) = ObservableTableFlag  # fmt: skip
IN_FILES_ONLY = ObservableTableFlag.IN_FILES_ONLY
PRINTED_WITH_ERROR = IN_PRINTED_TABLE | STATED_WITH_ERROR
IN_ALL_TABLES = PRINTED_WITH_ERROR | IN_SPECIAL_POINTS_TABLE | IN_SWEEP_PICTURES


@dataclass(frozen=True, repr=False)
class Observable:
    """Description of a number that a motion has, such as an amplitude.

    Attributes
    ----------
    place : Place
        Place at which the number is read.
    words, unit : str
        Label in tables and pictures, and SI unit.
    read_number_at_place : callable, optional
        Function that returns the number, given an object with the results at the place. Default:
        the object itself is the number.
    flags : ObservableTableFlag
        Tables that show the number by default, and conditions for computing it, such as friction.
    """

    place: Place
    words: str
    unit: str
    read_number_at_place: Callable[[Any], Any] = float
    flags: ObservableTableFlag = IN_FILES_ONLY

    @property
    def needs_crack(self) -> bool:
        """True if the number has no meaning without a crack, as a stress intensity."""
        is_at_tip = self.place in (Place.MOST_LOADED_TIP, Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS)
        return is_at_tip or REQUIRES_FRICTION in self.flags

    def __repr__(self) -> str:
        return f"{self.words} [{self.unit}]"


def _max_vector_norm(vectors: np.ndarray) -> Any:
    """Return the largest Euclidean norm of vectors (n, d)."""
    return np.linalg.norm(vectors, axis=1).max()


_make_point_row, _make_face_row = (
    partial(Observable, Place.WATCHED_POINT),
    partial(Observable, Place.CRACK_FACES),
)
_make_mode_row, _make_tip_row = (
    partial(Observable, Place.MODE_NEAREST_TO_LOAD_FREQUENCY),
    partial(Observable, Place.MOST_LOADED_TIP),
)
_make_ellipse_row = partial(
    Observable, Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS, unit="Pa m^0.5", flags=REQUIRES_GROWTH_LAW
)
_make_clamp_row = partial(Observable, Place.CLAMP)


# fmt: off
# ruff: noqa: RUF009  # observables are frozen
@dataclass(frozen=True, repr=False)
class Observables:
    """Hold the numbers of a motion at a watched point and at the crack faces.

    Each field's default is an :class:`Observable`, which describes the number.
    """

    omega: Any
    amplitude: Any = _make_point_row("half peak-to-peak", "m",
        lambda point: point.amplitude, IN_ALL_TABLES)
    mean: Any = _make_point_row("mean displacement", "m", lambda point: point.mean)
    harmonic_1: Any = _make_point_row("amplitude at the load frequency", "m",
        lambda point: point.amplitude_at_load_multiple(1))
    harmonic_2: Any = _make_point_row("amplitude at twice the load frequency", "m",
        lambda point: point.amplitude_at_load_multiple(2))
    harmonic_3: Any = _make_point_row("amplitude at three times the load frequency", "m",
        lambda point: point.amplitude_at_load_multiple(3))
    ratio_2_1: Any = _make_point_row("harmonic ratio 2/1", "1", lambda point: point.ratio(2),
        IN_ALL_TABLES)
    ratio_3_1: Any = _make_point_row("harmonic ratio 3/1", "1", lambda point: point.ratio(3),
        PRINTED_WITH_ERROR | IN_SWEEP_PICTURES)
    ratio_half_1: Any = _make_point_row("harmonic ratio 1/2 over 1", "1",
        lambda point: point.ratio(0.5), IN_PRINTED_TABLE)
    ratio_largest: Any = _make_point_row("largest harmonic above harmonic 1, over harmonic 1", "1",
        lambda point: point.ratio_largest, PRINTED_WITH_ERROR)
    largest_order: Any = _make_point_row("order of the largest harmonic above harmonic 1", "1",
        lambda point: point.largest_order, IN_PRINTED_TABLE)
    mean_shift: Any = _make_point_row("mean displacement over harmonic 1", "1",
        lambda point: point.mean / point.amplitude_at_load_frequency,
        PRINTED_WITH_ERROR | IN_SWEEP_PICTURES)
    opening: Any = _make_face_row("largest opening", "m",
        lambda faces: max(faces.overall_gap_and_force_maxima[0], 0.0), IN_ALL_TABLES)
    penetration: Any = _make_face_row("largest penetration", "m",
        lambda faces: max(faces.overall_gap_and_force_maxima[1], 0.0), IN_PRINTED_TABLE)
    contact_force: Any = _make_face_row("largest contact force of a pair", "N",
        lambda faces: faces.overall_gap_and_force_maxima[2], IN_PRINTED_TABLE)
    crack_force: Any = _make_face_row("largest contact force of a crack, all pairs", "N",
        lambda faces: faces.overall_gap_and_force_maxima[3], PRINTED_WITH_ERROR)
    closed_share: Any = _make_face_row("contact duty cycle, mean over pairs", "1",
        lambda faces: (faces.force > 0.0).mean(), IN_ALL_TABLES)
    friction_loss: Any = _make_face_row("friction loss of a period", "J",
        lambda faces: faces.losses.sum(), PRINTED_WITH_ERROR | REQUIRES_FRICTION)
    stick_share: Any = _make_face_row(
        "share of the period in which pairs stick, mean over pairs", "1",
        lambda faces: faces.is_sticking_at_instants.mean(), IN_PRINTED_TABLE | REQUIRES_FRICTION)
    slip_share: Any = _make_face_row(
        "share of the period in which pairs slip, mean over pairs", "1",
        lambda faces: faces.is_slipping_at_instants.mean(), PRINTED_WITH_ERROR | REQUIRES_FRICTION)
    near_share: Any = _make_face_row("share of the load's work lost in modes near the load", "1",
        lambda _: np.nan)
    far_share: Any = _make_face_row(
        "share of the load's work lost in modes above 5 times its frequency", "1",
        lambda _: np.nan, IN_PRINTED_TABLE)
    rub_share: Any = _make_face_row("share of the load's work lost by friction", "1",
        lambda _: np.nan, IN_PRINTED_TABLE | REQUIRES_FRICTION)


OBSERVABLES_BY_NAME: dict[str, Observable] = {
    field.name: field.default
    for field in fields(Observables) if isinstance(field.default, Observable)
} | {
    "omega_open": _make_mode_row("natural frequency, crack open", "rad/s"),
    "omega_tied": _make_mode_row("natural frequency, crack bonded", "rad/s"),
    "omega_bilinear": _make_mode_row("bilinear frequency", "rad/s"),
    "over_open": _make_mode_row("load frequency / natural frequency, crack open", "1",
        flags=IN_PRINTED_TABLE),
    "over_tied": _make_mode_row("load frequency / natural frequency, crack bonded", "1"),
    "over_bilinear": _make_mode_row("load frequency / bilinear frequency", "1",
        flags=IN_PRINTED_TABLE | IN_SPECIAL_POINTS_TABLE),
    "K_max": _make_tip_row("largest stress intensity K_I", "Pa m^0.5", lambda tip: tip.K_I.max()),
    "K_min": _make_tip_row("smallest K_I", "Pa m^0.5", lambda tip: tip.K_I.min()),
    "delta_K": _make_tip_row("range of K_I", "Pa m^0.5", lambda tip: np.ptp(tip.K_I)),
    "delta_K_effective": _make_tip_row("range of K_I while the crack tip is open", "Pa m^0.5",
        lambda tip: np.ptp(tip.K_I.clip(0.0))),
    "K_II_max": _make_tip_row("largest K_II of all tips or stations, of either sign", "Pa m^0.5",
        lambda tip: np.abs(tip.K_II).max()),
    "K_III_max": _make_tip_row("largest K_III of all stations, of either sign", "Pa m^0.5",
        lambda tip: np.abs(tip.K_III).max(), REQUIRES_SOLID),
    "K_II_leading": _make_tip_row("largest K_II where the range of K_I is largest", "Pa m^0.5",
        lambda tip: np.abs(tip.K_II).max()),
    "K_III_leading": _make_tip_row("largest K_III where the range of K_I is largest", "Pa m^0.5",
        lambda tip: np.abs(tip.K_III).max(), REQUIRES_SOLID),
    "K_II_ratio": _make_tip_row("largest ratio of K_II to K_I of a tip or station", "1",
        lambda tip: np.abs(tip.K_II).max() / max(tip.K_I.max(), np.finfo(float).tiny)),
    "delta_K_equivalent": _make_tip_row("range of K_I at R = 0 with the same crack growth",
        "Pa m^0.5", lambda tip: tip.equivalent_range, REQUIRES_GROWTH_LAW),
    "delta_K_effective_deepest": _make_ellipse_row("range of K_I while open, at the deepest place",
        read_number_at_place=lambda ellipse: np.ptp(
            ellipse.deepest_intensity_history.K_I.clip(0.0))),
    "delta_K_effective_surface": _make_ellipse_row("range of K_I while open, mean of the ends",
        read_number_at_place=lambda ellipse: np.mean(
            [np.ptp(end.K_I.clip(0.0)) for end in ellipse.end_intensity_histories])),
    "delta_K_equivalent_deepest": _make_ellipse_row(
        "range of K_I at R = 0 with the same growth in depth",
        read_number_at_place=lambda ellipse: ellipse.deepest_intensity_history.equivalent_range),
    "delta_K_equivalent_surface": _make_ellipse_row(
        "range of K_I at R = 0 with the same growth along the face",
        read_number_at_place=lambda ellipse: np.mean(
            [end.equivalent_range for end in ellipse.end_intensity_histories])),
    "reaction_force": _make_clamp_row("largest force of the clamp", "N",
        lambda reaction: _max_vector_norm(reaction.force)),
    "reaction_moment": _make_clamp_row("largest moment of the clamp, about its centre", "N m",
        lambda reaction: _max_vector_norm(reaction.moment)),
}
"""All observables by name; the names are columns of tables and files."""
# fmt: on


@cache
def observable_names(
    *places: Place,
    required_flags: ObservableTableFlag = IN_FILES_ONLY,
    excluded_flags: ObservableTableFlag = IN_FILES_ONLY,
) -> tuple[str, ...]:
    """Return the names of observables at given places, with given flags.

    Parameters
    ----------
    places : Place
        Places; none given means all places.
    required_flags : ObservableTableFlag
        Flags that an observable must have, all together. Default: no flag is required.
    excluded_flags : ObservableTableFlag
        Flags that an observable must not have. Default: no flag is excluded.
    """
    return tuple(
        name
        for name, observable in OBSERVABLES_BY_NAME.items()
        if (not places or observable.place in places)
        and required_flags in observable.flags
        and not observable.flags & excluded_flags
    )


def read_observables(
    place: Place, place_object: Any, excluded_flags: ObservableTableFlag = IN_FILES_ONLY
) -> dict[str, float]:
    """Return the numbers of all observables at a place, by observable name.

    Parameters
    ----------
    place : Place
        The place, such as ``Place.MOST_LOADED_TIP`` (crack tips) or ``Place.CLAMP``.
    place_object
        Object with the results at the place, from which :attr:`Observable.read_number_at_place`
        takes each number.
    excluded_flags : ObservableTableFlag
        Observables with any of these flags are left out. Default: none is left out.
    """
    names_at_place = observable_names(place, excluded_flags=excluded_flags)
    return {
        name: float(OBSERVABLES_BY_NAME[name].read_number_at_place(place_object))
        for name in names_at_place
    }
