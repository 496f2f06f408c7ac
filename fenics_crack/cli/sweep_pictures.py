"""Pictures of a sweep: lines over one axis, maps over two."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.draw.plot import draw_map, draw_response
from fenics_crack.errors import InputError
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.words import WHOLE, key_in_words, unit_of, value_in_words
from fenics_crack.sweep.result import SweepResult
from fenics_crack.table import readable, with_unit

__all__ = ["draw_sweep", "shown_axes"]

FREQUENCIES = ("excitation.omega", "excitation.frequency")
FEW_LINES, LEAST_OF_A_MAP, MAX_PICTURES = 6, 4, 12
"""Lines in a picture, at most; values of each axis from which there is a map; pictures of a
quantity, at most."""


def shown_axes(found: SweepResult) -> list[int]:
    """Places of the one or two axes that are drawn: the frequency, then the longest.

    Raises InputError if no axis has two or more numbers, or no case has converged.
    """
    axes = found.axes
    numbers = [
        place
        for place, axis in enumerate(axes)
        if len(axis.values) > 1 and all(isinstance(value, float | int) for value in axis.values)
    ]
    if not numbers:
        raise InputError("sweep.over", [a.key for a in axes], "over numbers, to be drawn")
    if not np.any(found.converged):
        raise InputError("path", str(found.path), "a sweep with a case that converged")
    numbers.sort(key=lambda place: (axes[place].key not in FREQUENCIES, -len(axes[place].values)))
    return numbers[:2]


def draw_sweep(found: SweepResult, folder: Path) -> list[Path]:
    """Draw the quantities of a sweep over the swept numbers; return the files.

    To the right goes the frequency, else the longest axis. The next in length gets a line for each
    value if these are few, and makes a map if they are not too few. Each combination of the other
    axes has its own pictures, up to a limit. Raises InputError as :func:`shown_axes`.
    """
    axes, shown = found.axes, shown_axes(found)
    others = [place for place in range(len(axes)) if place not in shown]

    def pages(values: np.ndarray) -> np.ndarray:
        """Values by picture, then to the right, then up if there are two axes: (n, x, y)."""
        sizes = [*(len(axes[place].values) for place in shown), 1][:2]
        return values.transpose(*others, *shown).reshape(-1, *sizes)

    doubtful = pages(found.converged & (found.not_stable | found.inexact))
    files: list[Path] = []
    fixed = itertools.product(*(axes[place].values for place in others))
    for number, at in enumerate(itertools.islice(fixed, MAX_PICTURES)):
        keys = [axes[place].key for place in others]
        words = [f"{key_in_words(k)} {value_in_words(k, v)}" for k, v in zip(keys, at, strict=True)]
        for name, (quantity, unit) in found.quantities.items():
            values = pages(np.where(found.converged, found[name], np.nan))[number]
            if np.any(np.isfinite(values)):
                page = _Page([axes[place] for place in shown], values, doubtful[number])
                base = folder / f"sweep_{name}{f'_{number + 1}' if others else ''}.png"
                files += page.draw(quantity, unit, base, ", ".join(words))
    return files


class _Page:
    """Values (x, y) over one axis or two, and where they are doubtful."""

    def __init__(self, axes: list[Axis], values: np.ndarray, doubtful: np.ndarray) -> None:
        self.axes = axes
        places = [np.array(axis.values, dtype=float) for axis in axes]
        order = [np.argsort(place) for place in places]
        self.places = [place[by] for place, by in zip(places, order, strict=True)]
        across = np.ix_(*[*order, np.zeros(1, dtype=int)][:2])
        self.values, self.doubtful = values[across], doubtful[across]

    def draw(self, quantity: str, unit: str, path: Path, where: str) -> list[Path]:
        """Draw lines, a map, or both; return the files."""
        names = [key_in_words(axis.key) for axis in self.axes]
        title = f"{quantity[0].upper()}{quantity[1:]}{', ' if where else ''}{where}"
        counts = [*map(len, self.places), 1][:2]
        is_map = len(self.axes) > 1 and min(counts) >= LEAST_OF_A_MAP
        files = []
        if counts[1] <= FEW_LINES:
            files.append(path)
            self._lines(quantity, unit, names, path=path, title=title)
        if is_map or counts[1] > FEW_LINES:
            beside = path.with_name(f"{path.stem}_map.png")
            files.append(beside)
            self._map(quantity, unit, path=beside, title=title)
        return files

    def _lines(self, quantity: str, unit: str, names: list[str], **file: Any) -> None:
        factor, over = _axis_words(self.axes[0], self.places[0])
        labels = [quantity]
        if len(self.axes) > 1:
            key = self.axes[1].key
            labels = [f"{names[1]} {value_in_words(key, float(at))}" for at in self.places[1]]
        lines, rings = (
            dict(zip(labels, values.T, strict=True)) for values in (self.values, self.doubtful)
        )
        how: dict[str, Any] = {"over": over, "doubtful": rings, "unit": unit}
        draw_response(factor * self.places[0], lines, quantity=quantity, **how, **file)

    def _map(self, quantity: str, unit: str, **file: Any) -> None:
        ends = (_axis_words(a, place) for a, place in zip(self.axes, self.places, strict=True))
        (right, x_label), (up, y_label) = ends
        scale, prefixed = 1.0, unit
        if unit in ("m", "N"):
            scale, prefixed = readable(float(np.nanmax(np.abs(self.values))), unit)
        draw_map(
            right * self.places[0],
            up * self.places[1],
            scale * self.values.T,
            x_label=x_label,
            y_label=y_label,
            value_label=with_unit(quantity, prefixed),
            doubtful=self.doubtful.T,
            **file,
        )


def _axis_words(axis: Axis, values: np.ndarray) -> tuple[float, str]:
    """What multiplies the values of an axis in a picture, and its label."""
    unit, factor = unit_of(axis.key), 1.0
    if unit and unit not in WHOLE:
        factor, unit = readable(float(np.abs(values).max()), unit)
    return factor, with_unit(key_in_words(axis.key), unit)
