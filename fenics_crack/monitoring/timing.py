"""Result of the command ``timing``, and its report."""

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
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    UNIT_BY_NAME,
    Conclusion,
    Table,
    format_count,
    format_quantity,
)
from fenics_crack.files.saved import SavedResult
from fenics_crack.scene.scene import Scene

NO_RESONANCE: dict[str, list[Any]] = {"blade": [], "rpm": [], "order": [], "frequency": []}
"""Columns of a table without any resonance."""
MISSING_HARMONICS = (
    "harmonics are missing (tip_timing.fitted_harmonics), and folded onto the fitted ones"
)
NO_SPARE_PROBE = "as many unknowns as probes: neither the order nor the fitted harmonics are tested"
FOLDED_HARMONICS = (
    "harmonics that are not fitted may be folded onto the fitted ones (fit more, or more probes)"
)
NO_REPETITION = (
    "no probe sees the vibration twice: fit and standard errors are untested (more revolutions)"
)
UNCLEAR_HARMONIC = (
    "at no speed larger than its errors, at most {} (more revolutions determine it better)"
)
CORRELATED_RESIDUALS = (
    "residuals are correlated, by a vibration nearby or drift: order and errors may be wrong"
)
UNTESTED_ORDER = "cannot test an order: {:g} fits, and others may as well (tip_timing.orders)"
BLIND_PROBE = (
    "does not measure the vibration that the others do: excluded; are its pulses the blade's?"
)
CONSTANT_FREQUENCY = (
    "frequencies are taken not to change with the speed; else damping is wrong, and a fast run-up "
    "overestimates and a run-down underestimates the frequency (tip_timing.stiffening)"
)


@dataclass(frozen=True, repr=False)
class Timing(SavedResult):
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
        """Return True if the fits are of resonances that were passed."""
        return any(isinstance(fit, tuple) for fit in self.fits.values())

    def to_dict(self) -> dict[str, Any]:
        """Return a row for each resonance, blade, harmonic or speed."""
        if self.of_resonances:
            rows = [
                {"blade": blade} | passage.to_dict()
                for blade, fit in self.fits.items()
                if isinstance(fit, tuple)
                for passage in fit
            ]
        elif len(self.fits) == 1:
            return self._first_fit.to_dict()
        else:
            fits = {blade: fit for blade, fit in self.fits.items() if isinstance(fit, TipFit)}
            has_ratios = all(map(_has_second_harmonic, fits.values()))
            rows = [{"blade": blade} | _row_of(fit, has_ratios) for blade, fit in fits.items()]
        names = [name for name in rows[0] if name != "speed"] if rows else []
        return {name: [row[name] for row in rows] for name in names} or NO_RESONANCE

    @property
    def _first_fit(self) -> Any:
        return next(iter(self.fits.values()))

    def _units(self) -> Mapping[str, str]:
        is_single_fit = len(self.fits) == 1 and not self.of_resonances
        units: Mapping[str, str] = self._first_fit._units() if is_single_fit else UNIT_BY_NAME
        return units

    def _title(self) -> str:
        revolutions = format_count(len(next(iter(self.arrivals.values()))), "revolution")
        return f"{format_count(len(self.arrivals), 'blade')}, {revolutions}"


def _has_second_harmonic(fit: TipFit) -> bool:
    """Return True if the second harmonic is among the fitted harmonics."""
    return bool(np.any(np.isclose(fit.multiples, 2.0)))


def _row_of(fit: TipFit, has_ratio: bool) -> dict[str, float]:
    """Return the row of a fit, with the harmonic ratio if ``has_ratio``."""
    sizes, errors = fit.amplitudes, fit.amplitude_errors
    row = {"amplitude": float(sizes[0]), "amplitude_error": float(errors[0]), "order": fit.order}
    names = "ratio_2_1", "ratio_2_1_error"
    return row | (dict(zip(names, fit.ratio(), strict=True)) if has_ratio else {})


# --- report ---------------------------------------------------------------------------------------


def report_of_timing(timing: Timing) -> Report:
    """Report the vibration of each blade, and doubts about it."""
    from fenics_crack.study.plausibility import remarks_on_scene  # with DOLFINx

    passages = {blade: fit for blade, fit in timing.fits.items() if isinstance(fit, tuple)}
    tracks = [fit for fit in timing.fits.values() if isinstance(fit, TipTrack)]
    table = timing.table()
    if passages:
        conclusion, notes, warnings = _report_passages(passages)
    elif tracks:
        conclusion, table, notes, warnings = _report_track(tracks[0])
    else:
        conclusion, notes, warnings = _report_fits(timing)
    return Report(
        timing.table(),
        conclusion,
        timing.scene,
        printed_table=table,
        notes=notes,
        warnings=[*timing.doubts, *warnings],
        remarks=() if timing.scene is None else remarks_on_scene(timing.scene),
    )


def largest_blade(timing: Timing) -> int | None:
    """Return the blade with the largest amplitude, or None in a run-up."""
    fits = {blade: fit for blade, fit in timing.fits.items() if isinstance(fit, TipFit)}
    return max(fits, key=lambda blade: float(fits[blade].amplitudes[0])) if fits else None


def _report_passages(
    passages: Mapping[int, tuple[PassageFit, ...]],
) -> tuple[Conclusion, list[str], list[str]]:
    """Return conclusion, notes and doubts on the resonances of all blades."""
    resonances = [(blade, fit) for blade, fits in passages.items() for fit in fits]
    warnings = ["no resonance stands out"] * (not resonances)
    clearest_fits = [(blade, fits[0]) for blade, fits in passages.items() if fits]
    blind_probes = [
        (blade, np.degrees(angle)) for blade, fit in clearest_fits for angle in fit.blind
    ]
    warnings += [
        f"blade {blade}, probe at {angle:.5g} degrees: {BLIND_PROBE}"
        for blade, angle in blind_probes
    ]
    for blade, fit in resonances:
        name = f"blade {blade}, {fit.speed / RAD_PER_S_PER_RPM:.5g} rpm"
        if fit.untested:
            probe_count = format_count(fit.probes, "probe")
            warnings.append(f"{name}: {probe_count} {UNTESTED_ORDER.format(fit.order)}")
        elif fit.ambiguous:
            warnings.append(
                f"{name}: {_name_orders('explain the arrivals as well', fit.ambiguous)}"
            )
        if fit.disagree:
            warnings.append(f"{name}: {fit.disagreement}")
        if fit.in_doubt:
            warnings.append(f"{name}: {CORRELATED_RESIDUALS}")
    notes = [CONSTANT_FREQUENCY] * any(fit.stiffening == 0.0 for _, fit in resonances[:1])
    lines = [(blade, line) for blade, fit in clearest_fits for line in fit.asynchronous]
    notes += [f"blade {blade}: {_describe_line(line)}" for blade, line in lines]
    conclusion = Conclusion("no resonance found")
    if resonances:
        blade, clearest = resonances[0]
        answer = f"the clearest of blade {blade} at {clearest.in_words}"
        conclusion = Conclusion(f"{format_count(len(resonances), 'resonance')} found", answer)
    return conclusion, notes, warnings


def _name_orders(words: str, orders: Iterable[float]) -> str:
    """Return "orders that WORDS: 5, 7"."""
    return f"orders that {words}: {in_words([*orders])}"


def _describe_line(line: TipFit) -> str:
    """Describe a vibration of constant frequency."""
    size, error = line.amplitudes[0], line.amplitude_errors[0]
    numbers = f"{line.omega / RAD_PER_TURN:.6g} Hz, {_with_error(size, error)}"
    return f"a vibration that follows no order: {numbers}"


def _with_error(size: float, error: float) -> str:
    return f"{format_quantity(size, 'm')} ± {format_quantity(error, 'm')}"


def _report_track(track: TipTrack) -> tuple[Conclusion, Table, list[str], list[str]]:
    """Return conclusion, table of peaks, notes and doubts of a run-up."""
    table = track.table()
    kept_columns = [n for n, name in enumerate(table.columns) if not name.startswith("amplitude")]
    conclusion = Conclusion("run-up tracked", "no vibration is larger than its errors")
    rows, notes = [], []
    # Without any vibration, the largest of so many amplitudes is several errors large.
    limit = float(np.sqrt(2.0 * np.log(len(track.speed) / LEVELS.misfit)))
    for column, multiple in enumerate(track.multiples):
        sizes, errors = track.amplitudes[:, column], track.amplitude_errors[:, column]
        clear_sizes = np.where(sizes <= limit * errors, np.nan, sizes)
        if not np.all(np.isnan(clear_sizes)):
            row = int(np.nanargmax(clear_sizes))
            peak = (float(sizes[row]), float(errors[row]))
            rows.append([float(multiple), *(table.rows[row][n] for n in kept_columns), *peak])
            if len(rows) == 1:
                peak_place = (
                    f"{track.omega[row] / RAD_PER_TURN:.6g} Hz, engine order {track.order:g}"
                )
                answer = f"harmonic {multiple:g} is largest at {peak_place}: {_with_error(*peak)}"
                conclusion = Conclusion("run-up tracked", answer)
        elif not np.all(np.isnan(sizes)):
            upper_bound = format_quantity(float(np.nanmax(sizes + LEVELS.deviations * errors)), "m")
            notes.append(f"harmonic {multiple:g}: {UNCLEAR_HARMONIC.format(upper_bound)}")
    columns = ["multiple, where it is largest", *(table.columns[n] for n in kept_columns)]
    peak_table = Table([*columns, "amplitude [m]", "amplitude_error [m]"], rows)
    doubts = [NO_SPARE_PROBE] if np.isnan(track.misfit) else []
    if track.does_not_fit:
        doubts.append(
            f"the residual repeats in all revolutions: {MISSING_HARMONICS}, the vibration "
            "changes within the revolutions that are fitted together "
            f"(tip_timing.fitted_revolutions), or it is not of order {track.order:g}"
        )
    elif track.in_doubt and not doubts:
        doubts.append(FOLDED_HARMONICS)
    return conclusion, peak_table, notes, doubts


def _report_fits(timing: Timing) -> tuple[Conclusion, list[str], list[str]]:
    """Return conclusion, notes and doubts on vibrations at one speed."""
    has_several_blades, notes, warnings = len(timing.fits) > 1, [], []
    for blade, fit in timing.fits.items():
        assert isinstance(fit, TipFit)
        prefix = f"blade {blade}: " if has_several_blades else ""
        fit_notes, doubts = _judge_fit(fit)
        notes += [] if has_several_blades else fit_notes
        warnings += [f"{prefix}{text}" for text in doubts]
    largest_fit: Any = timing.fits[blade := largest_blade(timing) or 1]
    size = _with_error(largest_fit.amplitudes[0], largest_fit.amplitude_errors[0])
    frequency_words = (
        f"engine order {largest_fit.order:g}, {largest_fit.omega / RAD_PER_TURN:.6g} Hz"
    )
    if has_several_blades:
        notes.append(f"the picture shows blade {blade}, whose amplitude is the largest")
        answer = f"the largest vibration is that of blade {blade}, {size}, {frequency_words}"
        return (
            Conclusion(f"{format_count(len(timing.fits), 'blade')} fitted", answer),
            notes,
            warnings,
        )
    return Conclusion("vibration found", f"amplitude {size}, {frequency_words}"), notes, warnings


def _judge_fit(fit: TipFit) -> tuple[list[str], list[str]]:
    """Return notes and doubts about a fit.

    The ratio of the second harmonic to the first, in a note, indicates a crack.
    """
    notes = [f"in addition, {_describe_line(line)}" for line in fit.asynchronous]
    warnings = []
    if _has_second_harmonic(fit):
        ratio, error = fit.ratio()
        notes.append(f"second harmonic over first: {ratio:.4g} ± {error:.2g}")
    if fit.does_not_fit:
        warnings.append(
            f"residuals differ between the probes by more than their scatter: {MISSING_HARMONICS}, "
            "probes are misplaced (tip_timing.angle_deviation), or the order is none of "
            "tip_timing.orders"
        )
    elif fit.may_be_folded and fit.spare > 0:
        warnings.append(FOLDED_HARMONICS)
    if fit.spare < 1:
        warnings.append(NO_SPARE_PROBE)
    elif fit.seen_once:
        warnings.append(NO_REPETITION)
    if fit.ambiguous:
        warnings.append(_name_orders("explain the arrivals as well", fit.ambiguous))
    if fit.hidden:
        warnings.append(_name_orders("these probes cannot measure", fit.hidden))
    return notes, warnings
