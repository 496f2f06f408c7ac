"""What is interpolated: natural frequencies and harmonics of a sweep, made smooth.

Smooth in the unknowns are the logarithms of natural frequencies without the crack, what it adds to
them, over its size where that is unknown, and harmonics as complex numbers,
a - i b of a cos + b sin. The amplitudes alone have kinks where they vanish, and both have poles,
which move with the crack, where k times the load's frequency W meets a natural frequency w_j of the
breathing crack with a damping ratio z. So of the k-th harmonic it is

    U_k prod_j (1 - r^2 + 2 i z r) / s^n,      r = k W / w_j,

with the bilinear frequencies w_j of the same nodes and the sum s over the modes of the relative
differences between frequencies with lips tied and open. It is small for a short crack, whose lips
close in half of each period: that makes even harmonics, n = 1, and odd ones of second order, n = 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.errors import FEW_MODES, InputError
from fenics_crack.identification.interpolation import Cube
from fenics_crack.identification.measurements import Measurement
from fenics_crack.scene.fields import Axis
from fenics_crack.sweep.file import CONVERGED, KEPT_ORDERS
from fenics_crack.sweep.result import SweepResult

__all__ = ["MESH", "Feature", "Part", "poles", "scales"]

MESH = "mesh.file"
"""The axis of meshes with numbers."""


@dataclass(frozen=True)
class Part:
    """Knowledge of a sweep, with its words chosen; and of that without the crack, if there is."""

    sweep: SweepResult
    keys: tuple[str, ...]
    cube: Cube
    index: tuple[Any, ...]
    bare: Part | None = None

    @classmethod
    def of(
        cls,
        sweep: SweepResult,
        meshes: Sequence[Axis],
        chosen: Sequence[int | None],
        bare: Part | None = None,
    ) -> Part:
        """Take a sweep, the numbers of its meshes if it has some, and the number of the word chosen
        on each axis, None on one of numbers, or of such meshes."""
        numbers: list[Axis] = []
        for axis, at in zip(sweep.axes, chosen, strict=False):
            if at is None:
                numbers += meshes if axis.key == MESH else [axis]
        index = tuple(slice(None) if at is None else at for at in chosen)
        cube = Cube(tuple(np.array(axis.values, dtype=float) for axis in numbers))
        return cls(sweep, tuple(axis.key for axis in numbers), cube, index, bare)

    def column(self, name: str) -> np.ndarray:
        """A column at all nodes and load frequencies: (n, n_loads)."""
        values = self.sweep[name][self.index]
        return np.asarray(values.reshape(-1, values.shape[-1]), dtype=float)

    def natural(self, lips: str, mode: int) -> np.ndarray:
        """A natural frequency at all nodes [Hz]: (n,); without the crack ("uncracked") the same
        for all cracks, and that with lips tied where it cannot be taken out."""
        if lips == "uncracked":
            if self.bare is None:
                return self.natural("tied", mode)
            values = self.bare.natural("tied", mode)
            pairs = zip(self.keys, self.cube.shape, strict=True)
            shape = [count if key in self.bare.keys else 1 for key, count in pairs]
            return np.broadcast_to(values.reshape(shape), self.cube.shape).ravel()
        column = self.column(f"omega_{lips}_{mode}") / (2.0 * np.pi)
        known = np.isfinite(column)
        best = np.max(np.where(known, column, -np.inf), axis=1)
        return np.where(known.any(axis=1), best, np.nan)

    def harmonic(self, point: str, frequency: float, order: int) -> np.ndarray:
        """Complex amplitude of a harmonic at all nodes: (n,) [m]; 0 where a case has fewer."""
        parts = []
        for part in ("cosine", "sine"):
            name = f"{point}.{part}_{order}" if point else f"{part}_{order}"
            parts.append(self.column(name))
        loads = self.sweep.axes[-1].values
        if frequency not in loads:
            solved = ", ".join(f"{load:.9g}" for load in loads)
            allowed = f"one of those that are solved, {solved} Hz; identify.frequencies adds others"
            raise InputError("measurements.frequency", frequency, allowed)
        load = loads.index(frequency)
        fewer = self.column("harmonics")[:, load] < order
        value = np.where(fewer, 0.0, (parts[0] - 1j * parts[1])[:, load])
        return np.where(self.column("state")[:, load] == CONVERGED, value, np.nan)

    @cached_property
    def basis(self) -> np.ndarray:
        """Root of s, the bilinear frequencies [Hz], which :func:`scales` needs, and those
        without the crack, at all nodes: (n, 1 + 2 modes); 1 for s without a crack, nan where there
        is no frequency."""
        modes = range(1, FEW_MODES + 1)
        tied, opened, bare = (
            np.stack([self.natural(lips, mode) for mode in modes], axis=1)
            for lips in ("tied", "open", "uncracked")
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            split = np.nan_to_num((tied - opened) / tied, posinf=0.0, neginf=0.0).sum(axis=1)
            found = 2.0 * tied * opened / (tied + opened)
        return np.column_stack([np.where(split > 1e-9, np.sqrt(np.abs(split)), 1.0), found, bare])


@dataclass(frozen=True)
class Feature:
    """Something that is interpolated: a natural frequency, or a harmonic of a point at a load."""

    lips: str = ""
    mode: int = 0
    point: str = ""
    frequency: float = 0.0
    order: int = 0

    @classmethod
    def of(cls, row: Measurement) -> tuple[Feature, ...]:
        """Features of a measurement; of a ratio both harmonics, the one above first."""
        if row.natural:
            lips = row.quantity.removeprefix("frequency_")
            of_both = lips in ("bilinear", "resonance")
            return tuple(
                cls(state, row.mode) for state in (("open", "tied") if of_both else (lips,))
            )
        orders = row.orders or KEPT_ORDERS
        return tuple(cls("", 0, row.point, float(row.frequency), order) for order in orders)

    @property
    def together(self) -> tuple[float, float, float]:
        """Features for which this is the same err alike: a mode's, and those of one contact."""
        return (self.mode, self.frequency, self.order)

    def values(self, part: Part) -> np.ndarray:
        """Values at all nodes of a sweep: (n,), logarithms or complex numbers."""
        if self.lips:
            return np.log(part.natural(self.lips, self.mode)).astype(complex)
        return part.harmonic(self.point, self.frequency, self.order)

    @property
    def power(self) -> int:
        """n of s^n, to which a harmonic is proportional."""
        return 1 + self.order % 2 if self.order > 1 else 0

    @property
    def natural(self) -> bool:
        """Tell whether it is a natural frequency."""
        return bool(self.lips)

    @property
    def of_crack(self) -> bool:
        """Tell whether it is a natural frequency that the crack changes."""
        return self.lips in ("open", "tied")


def poles(
    features: Sequence[Feature], damping: np.ndarray, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """r of each mode, and 1 - r^2 + 2 i z r, at m places: (m, f, modes); of ratios of damping
    (m, 1), and what :attr:`Part.basis` has there (m, 1 + 2 modes); 0 and 1 of natural frequencies
    and where there is no mode."""
    own = basis[:, 1 : 1 + FEW_MODES]
    loads = np.array([feature.order * feature.frequency for feature in features])
    r = loads[:, None] / np.where(np.isfinite(own), own, np.inf)[:, None, :]
    return r, 1.0 - r**2 + 2j * damping[..., None] * r


def scales(
    features: Sequence[Feature], damping: np.ndarray, basis: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Factors that make the values smooth: (m, f), of the same and of sizes of the crack (m,)."""
    powers = np.array([feature.power for feature in features])
    changed = np.array([feature.of_crack for feature in features])
    found = poles(features, damping, basis)[1].prod(axis=2) / basis[:, :1] ** (2 * powers)
    return np.where(changed, 1.0 / size[:, None], found)
