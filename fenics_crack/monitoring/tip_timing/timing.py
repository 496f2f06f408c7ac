"""Result of the command ``timing``: arrival times of blades, and the vibration found in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fenics_crack.basics.tables import UNITS, counted
from fenics_crack.files.saved import Saved
from fenics_crack.monitoring.tip_timing.arrival_times import ArrivalTimes
from fenics_crack.monitoring.tip_timing.fit_order import TipTrack
from fenics_crack.monitoring.tip_timing.harmonics import TipFit
from fenics_crack.monitoring.tip_timing.passages import PassageFit
from fenics_crack.scene.scene import Scene

NO_RESONANCE: dict[str, list[Any]] = {"blade": [], "rpm": [], "order": [], "frequency": []}
"""Columns without a resonance."""


@dataclass(frozen=True, repr=False)
class Timing(Saved):
    """Vibration of blade tips, from their arrival times.

    Attributes
    ----------
    scene : Scene or None
        With [tip_timing]; None of a measured record by itself.
    arrivals : dict of int to ArrivalTimes
        Of each blade, by its number from 1.
    fits : dict of int to TipFit, TipTrack or tuple of PassageFit
        Vibration of each blade at one speed, of known order in a run-up, or the resonances passed.
    doubts : tuple of str
        Sentences that cast doubt on the arrivals.
    """

    scene: Scene | None
    arrivals: Mapping[int, ArrivalTimes]
    fits: Mapping[int, TipFit | TipTrack | tuple[PassageFit, ...]]
    doubts: tuple[str, ...] = ()

    KIND: ClassVar[str] = "tip timing"

    @property
    def of_resonances(self) -> bool:
        """True if the fits are of resonances that were passed."""
        return any(isinstance(fit, tuple) for fit in self.fits.values())

    def to_dict(self) -> dict[str, Any]:
        """A row for each harmonic or speed of one blade, for each of several blades, or for each
        resonance."""
        if self.of_resonances:
            rows = [
                {"blade": blade} | passage.to_dict()
                for blade, fit in self.fits.items()
                if isinstance(fit, tuple)
                for passage in fit
            ]
            names = [name for name in rows[0] if name != "speed"] if rows else []
            return {name: [row[name] for row in rows] for name in names} or NO_RESONANCE
        if len(self.fits) == 1:
            return self._first.to_dict()
        fits = {blade: fit for blade, fit in self.fits.items() if isinstance(fit, TipFit)}
        return {"blade": list(fits), **_columns_of_fits(fits)}

    @property
    def _first(self) -> Any:
        return next(iter(self.fits.values()))

    def _units(self) -> Mapping[str, str]:
        alone = len(self.fits) == 1 and not self.of_resonances
        units: Mapping[str, str] = self._first._units() if alone else UNITS
        return units

    def _title(self) -> str:
        revolutions = counted(len(next(iter(self.arrivals.values()))), "revolution")
        return f"{counted(len(self.arrivals), 'blade')}, {revolutions}"


def _columns_of_fits(fits: Mapping[int, TipFit]) -> dict[str, list[float]]:
    """Amplitude, its error and the phase of the first harmonic, and the ratio of the second to it,
    of several fits."""
    found: dict[str, list[float]] = {
        "amplitude": [float(fit.amplitudes[0]) for fit in fits.values()],
        "amplitude_error": [float(fit.amplitude_errors[0]) for fit in fits.values()],
        "order": [float(fit.order) for fit in fits.values()],
    }
    if all(np.any(np.isclose(fit.multiples, 2.0)) for fit in fits.values()):
        ratios = [fit.ratio() for fit in fits.values()]
        found["ratio_2_1"] = [float(ratio) for ratio, _ in ratios]
        found["ratio_2_1_error"] = [float(error) for _, error in ratios]
    return found
