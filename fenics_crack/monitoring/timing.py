"""Result of the command ``timing``: arrival times of blades, the vibration found in them, and its
report with the doubts about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_order import TipTrack
from fenics_crack.arrivals.harmonics import TipFit, in_words
from fenics_crack.arrivals.passages import PassageFit
from fenics_crack.arrivals.robust import LEVELS
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import RPM, TURN, UNITS, Said, Table, counted, quantity
from fenics_crack.files.saved import Saved
from fenics_crack.scene.scene import Scene

NO_RESONANCE: dict[str, list[Any]] = {"blade": [], "rpm": [], "order": [], "frequency": []}
"""Columns without a resonance."""
UNFITTED = "harmonics are missing (tip_timing.fitted_harmonics), and folded onto the fitted ones"
UNTESTED = "as many unknowns as probes: neither the order nor the fitted harmonics are tested"
FOLDED = (
    "harmonics that are not fitted may be folded onto the fitted ones (fit more, or more probes)"
)
ONCE = "no probe sees the vibration twice: fit and standard errors are untested (more revolutions)"
UNCLEAR = "at no speed larger than its errors, at most {} (more revolutions determine it better)"
NEARBY = "residuals are correlated, by a vibration nearby or drift: order and errors may be wrong"
UNTESTED_ORDER = "cannot test an order: {:g} fits, and others may as well (tip_timing.orders)"
BLIND = "does not measure the vibration that the others do: excluded; are its pulses the blade's?"
CONSTANT = (
    "frequencies are taken not to change with the speed; else damping is wrong, and a fast run-up "
    "overestimates and a run-down underestimates the frequency (tip_timing.stiffening)"
)


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
        elif len(self.fits) == 1:
            return self._first.to_dict()
        else:
            fits = {blade: fit for blade, fit in self.fits.items() if isinstance(fit, TipFit)}
            ratios = all(map(_has_second, fits.values()))
            rows = [{"blade": blade} | _row_of(fit, ratios) for blade, fit in fits.items()]
        names = [name for name in rows[0] if name != "speed"] if rows else []
        return {name: [row[name] for row in rows] for name in names} or NO_RESONANCE

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


def _has_second(fit: TipFit) -> bool:
    """True if a fit has a second harmonic, whose ratio to the first indicates a crack."""
    return bool(np.any(np.isclose(fit.multiples, 2.0)))


def _row_of(fit: TipFit, ratio: bool) -> dict[str, float]:
    """Amplitude of the first harmonic, its error and the order of a fit, and the ratio of the
    second harmonic to it."""
    sizes, errors = fit.amplitudes, fit.amplitude_errors
    row = {"amplitude": float(sizes[0]), "amplitude_error": float(errors[0]), "order": fit.order}
    names = "ratio_2_1", "ratio_2_1_error"
    return row | (dict(zip(names, fit.ratio(), strict=True)) if ratio else {})


# --- report ---------------------------------------------------------------------------------------


def report_of_timing(found: Timing) -> Report:
    """What was found in the arrivals of each blade, and doubts about it."""
    from fenics_crack.study.plausibility import remarks_on_scene  # with DOLFINx

    passed = {blade: fit for blade, fit in found.fits.items() if isinstance(fit, tuple)}
    tracks = [fit for fit in found.fits.values() if isinstance(fit, TipTrack)]
    shown = found.table()
    if passed:
        said, notes, warnings = _of_passages(passed)
    elif tracks:
        said, shown, notes, warnings = _of_track(tracks[0])
    else:
        said, notes, warnings = _of_fits(found)
    return Report(
        found.table(),
        said,
        found.scene,
        shown=shown,
        notes=notes,
        warnings=[*found.doubts, *warnings],
        remarks=() if found.scene is None else remarks_on_scene(found.scene),
    )


def largest_blade(found: Timing) -> int | None:
    """The blade whose amplitude at one speed is the largest; None in a run-up."""
    fits = {blade: fit for blade, fit in found.fits.items() if isinstance(fit, TipFit)}
    return max(fits, key=lambda blade: float(fits[blade].amplitudes[0])) if fits else None


def _of_passages(found: Mapping[int, tuple[PassageFit, ...]]) -> tuple[Said, list[str], list[str]]:
    """The clearest resonance, notes and doubts about all."""
    every = [(blade, fit) for blade, fits in found.items() for fit in fits]
    warnings = ["no resonance stands out"] * (not every)
    first = [(blade, fits[0]) for blade, fits in found.items() if fits]
    blind = [(blade, np.degrees(angle)) for blade, fit in first for angle in fit.blind]
    warnings += [f"blade {blade}, probe at {angle:.5g} degrees: {BLIND}" for blade, angle in blind]
    for blade, fit in every:
        name = f"blade {blade}, {fit.speed / RPM:.5g} rpm"
        if fit.untested:
            seen = counted(fit.probes, "probe")
            warnings.append(f"{name}: {seen} {UNTESTED_ORDER.format(fit.order)}")
        elif fit.ambiguous:
            warnings.append(f"{name}: {_orders('explain the arrivals as well', fit.ambiguous)}")
        if fit.disagree:
            warnings.append(f"{name}: {fit.disagreement}")
        if fit.in_doubt:
            warnings.append(f"{name}: {NEARBY}")
    notes = [CONSTANT] * any(fit.stiffening == 0.0 for _, fit in every[:1])
    lines = [(blade, line) for blade, fit in first for line in fit.asynchronous]
    notes += [f"blade {blade}: {_of_line(line)}" for blade, line in lines]
    said = Said("no resonance found")
    if every:
        blade, clearest = every[0]
        known = f"the clearest of blade {blade} at {clearest.in_words}"
        said = Said(f"{counted(len(every), 'resonance')} found", known)
    return said, notes, warnings


def _orders(words: str, orders: Iterable[float]) -> str:
    """Return orders that do something, in words."""
    return f"orders that {words}: {in_words([*orders])}"


def _of_line(line: TipFit) -> str:
    """Return a vibration of constant frequency in words."""
    size, error = line.amplitudes[0], line.amplitude_errors[0]
    of = f"{line.omega / TURN:.6g} Hz, {_with_error(size, error)}"
    return f"a vibration that follows no order: {of}"


def _with_error(size: float, error: float) -> str:
    return f"{quantity(size, 'm')} ± {quantity(error, 'm')}"


def _of_track(track: TipTrack) -> tuple[Said, Table, list[str], list[str]]:
    """The largest vibration of a run-up, each harmonic where it is largest, notes and doubts."""
    table = track.table()
    kept = [n for n, name in enumerate(table.columns) if not name.startswith("amplitude")]
    said = Said("run-up tracked", "no vibration is larger than its errors")
    rows, notes = [], []
    # The largest of so many amplitudes is several errors large where there is no vibration.
    limit = float(np.sqrt(2.0 * np.log(len(track.speed) / LEVELS.misfit)))
    for place, multiple in enumerate(track.multiples):
        sizes, errors = track.amplitudes[:, place], track.amplitude_errors[:, place]
        clear = np.where(sizes <= limit * errors, np.nan, sizes)
        if not np.all(np.isnan(clear)):
            at = int(np.nanargmax(clear))
            about = (float(sizes[at]), float(errors[at]))
            rows.append([float(multiple), *(table.rows[at][n] for n in kept), *about])
            if len(rows) == 1:
                where = f"{track.omega[at] / TURN:.6g} Hz, engine order {track.order:g}"
                known = f"harmonic {multiple:g} is largest at {where}: {_with_error(*about)}"
                said = Said("run-up tracked", known)
        elif not np.all(np.isnan(sizes)):
            most = quantity(float(np.nanmax(sizes + LEVELS.deviations * errors)), "m")
            notes.append(f"harmonic {multiple:g}: {UNCLEAR.format(most)}")
    columns = ["multiple, where it is largest", *(table.columns[n] for n in kept)]
    shown = Table([*columns, "amplitude [m]", "amplitude_error [m]"], rows)
    doubts = [UNTESTED] if np.isnan(track.misfit) else []
    if track.does_not_fit:
        doubts.append(
            f"the residual repeats in all revolutions: {UNFITTED}, the vibration "
            "changes within the revolutions that are fitted together "
            f"(tip_timing.fitted_revolutions), or it is not of order {track.order:g}"
        )
    elif track.in_doubt and not doubts:
        doubts.append(FOLDED)
    return said, shown, notes, doubts


def _of_fits(found: Timing) -> tuple[Said, list[str], list[str]]:
    """The largest vibration at one speed, notes, and doubts about the fit of each blade."""
    many, notes, warnings = len(found.fits) > 1, [], []
    for blade, fit in found.fits.items():
        assert isinstance(fit, TipFit)
        before = f"blade {blade}: " if many else ""
        more, doubts = _of_fit(fit)
        notes += [] if many else more
        warnings += [f"{before}{text}" for text in doubts]
    largest: Any = found.fits[blade := largest_blade(found) or 1]
    size = _with_error(largest.amplitudes[0], largest.amplitude_errors[0])
    where = f"engine order {largest.order:g}, {largest.omega / TURN:.6g} Hz"
    if many:
        notes.append(f"the picture shows blade {blade}, whose amplitude is the largest")
        known = f"the largest vibration is that of blade {blade}, {size}, {where}"
        return Said(f"{counted(len(found.fits), 'blade')} fitted", known), notes, warnings
    return Said("vibration found", f"amplitude {size}, {where}"), notes, warnings


def _of_fit(fit: TipFit) -> tuple[list[str], list[str]]:
    """Notes on a fit, with the ratio that indicates a crack, and doubts about it."""
    notes = [f"in addition, {_of_line(line)}" for line in fit.asynchronous]
    warnings = []
    if _has_second(fit):
        ratio, error = fit.ratio()
        notes.append(f"second harmonic over first: {ratio:.4g} ± {error:.2g}")
    if fit.does_not_fit:
        warnings.append(
            f"residuals differ between the probes by more than their scatter: {UNFITTED}, probes "
            "are misplaced (tip_timing.angle_deviation), or the order is none of tip_timing.orders"
        )
    elif fit.may_be_folded and fit.spare > 0:
        warnings.append(FOLDED)
    if fit.spare < 1:
        warnings.append(UNTESTED)
    elif fit.seen_once:
        warnings.append(ONCE)
    if fit.ambiguous:
        warnings.append(_orders("explain the arrivals as well", fit.ambiguous))
    if fit.hidden:
        warnings.append(_orders("these probes cannot measure", fit.hidden))
    return notes, warnings
