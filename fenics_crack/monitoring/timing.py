"""Result of the command ``timing``, and its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_order import TipTrack
from fenics_crack.arrivals.harmonics import TipFit, format_first_orders
from fenics_crack.arrivals.passages import PassageFit
from fenics_crack.arrivals.robust import CONFIDENCE_LEVELS
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

EMPTY_COLUMN_BY_NAME: dict[str, list[Any]] = {"blade": [], "rpm": [], "order": [], "frequency": []}
"""Columns of a table without any resonance."""
MISSING_HARMONICS_TEXT = (
    "harmonics are missing (tip_timing.fitted_harmonics), and folded onto the fitted ones"
)
NO_SPARE_PROBE_TEXT = (
    "as many unknowns as probes: neither the order nor the fitted harmonics are tested"
)
FOLDED_HARMONICS_TEXT = (
    "harmonics that are not fitted may be folded onto the fitted ones (fit more, or more probes)"
)
NO_REPETITION_TEXT = (
    "no probe sees the vibration twice: fit and standard errors are untested (more revolutions)"
)
UNCLEAR_HARMONIC_FORMAT = (
    "at no speed larger than its errors, at most {} (more revolutions determine it better)"
)
CORRELATED_RESIDUALS_TEXT = (
    "residuals are correlated, by a vibration nearby or drift: order and errors may be wrong"
)
UNTESTED_ORDER_FORMAT = (
    "cannot test an order: {:g} fits, and others may as well (tip_timing.orders)"
)
BLIND_PROBE_TEXT = (
    "does not measure the vibration that the others do: excluded; are its pulses the blade's?"
)
CONSTANT_FREQUENCY_TEXT = (
    "frequencies are taken not to change with the speed; else damping is wrong, and a fast run-up "
    "overestimates and a run-down underestimates the frequency (tip_timing.stiffening)"
)


@dataclass(frozen=True, repr=False)
class Timing(SavedResult):
    """Vibration of blade tips, from their arrival times.

    Attributes
    ----------
    scene : Scene or None
        Scene with [tip_timing]; None for a measured record by itself.
    arrivals : dict of int to ArrivalTimes
        Arrival times by blade number from 1.
    fits : dict of int to TipFit, TipTrack or tuple of PassageFit
        Vibration of each blade at one speed, of known order in a run-up, or the passed resonances.
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
        """Return True if the fits are of passed resonances."""
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
            fit_by_blade = {
                blade: fit for blade, fit in self.fits.items() if isinstance(fit, TipFit)
            }
            have_ratios = all(map(_has_second_harmonic, fit_by_blade.values()))
            rows = [
                {"blade": blade} | _tabulate_fit(fit, have_ratios)
                for blade, fit in fit_by_blade.items()
            ]
        column_names = (
            [column_name for column_name in rows[0] if column_name != "speed"] if rows else []
        )
        return {
            column_name: [row[column_name] for row in rows] for column_name in column_names
        } or EMPTY_COLUMN_BY_NAME

    @property
    def _first_fit(self) -> Any:
        return next(iter(self.fits.values()))

    def _unit_by_name(self) -> Mapping[str, str]:
        is_single_fit = len(self.fits) == 1 and not self.of_resonances
        unit_by_column: Mapping[str, str] = (
            self._first_fit._unit_by_name() if is_single_fit else UNIT_BY_NAME
        )
        return unit_by_column

    def _repr_text(self) -> str:
        revolutions_text = format_count(len(next(iter(self.arrivals.values()))), "revolution")
        return f"{format_count(len(self.arrivals), 'blade')}, {revolutions_text}"


def _has_second_harmonic(fit: TipFit) -> bool:
    """Return True if the second harmonic is among the fitted harmonics."""
    return bool(np.any(np.isclose(fit.multiples, 2.0)))


def _tabulate_fit(fit: TipFit, has_ratio: bool) -> dict[str, float]:
    """Return the row of a fit by column, with the harmonic ratio if ``has_ratio``."""
    amplitudes, amplitude_errors = fit.amplitudes, fit.amplitude_errors
    value_by_column = {
        "amplitude": float(amplitudes[0]),
        "amplitude_error": float(amplitude_errors[0]),
        "order": fit.order,
    }
    ratio_columns = "ratio_2_1", "ratio_2_1_error"
    return value_by_column | (
        dict(zip(ratio_columns, fit.ratio(), strict=True)) if has_ratio else {}
    )


# --- report ---------------------------------------------------------------------------------------


def report_of_timing(timing: Timing) -> Report:
    """Report the vibration of each blade, and doubts about it."""
    from fenics_crack.study.plausibility import remarks_on_scene  # with DOLFINx

    passages_by_blade = {blade: fit for blade, fit in timing.fits.items() if isinstance(fit, tuple)}
    tracks = [fit for fit in timing.fits.values() if isinstance(fit, TipTrack)]
    shown_table = timing.table()
    if passages_by_blade:
        conclusion, notes, warnings = _describe_passages(passages_by_blade)
    elif tracks:
        conclusion, shown_table, notes, warnings = _describe_track(tracks[0])
    else:
        conclusion, notes, warnings = _describe_fits(timing)
    return Report(
        timing.table(),
        conclusion,
        timing.scene,
        printed_table=shown_table,
        notes=notes,
        warnings=[*timing.doubts, *warnings],
        remarks=() if timing.scene is None else remarks_on_scene(timing.scene),
    )


def find_largest_blade(timing: Timing) -> int | None:
    """Find the blade with the largest amplitude; None in a run-up."""
    fit_by_blade = {blade: fit for blade, fit in timing.fits.items() if isinstance(fit, TipFit)}
    return (
        max(fit_by_blade, key=lambda blade: float(fit_by_blade[blade].amplitudes[0]))
        if fit_by_blade
        else None
    )


def _describe_passages(
    passages_by_blade: Mapping[int, tuple[PassageFit, ...]],
) -> tuple[Conclusion, list[str], list[str]]:
    """Describe all blades' resonances: conclusion, notes and doubts."""
    blades_and_resonances = [
        (blade, fit) for blade, fits in passages_by_blade.items() for fit in fits
    ]
    warning_texts = ["no resonance stands out"] * (not blades_and_resonances)
    blades_and_clearest_fits = [
        (blade, fits[0]) for blade, fits in passages_by_blade.items() if fits
    ]
    blades_and_probe_angles = [
        (blade, np.degrees(probe_angle))
        for blade, fit in blades_and_clearest_fits
        for probe_angle in fit.blind
    ]
    warning_texts += [
        f"blade {blade}, probe at {probe_angle:.5g} degrees: {BLIND_PROBE_TEXT}"
        for blade, probe_angle in blades_and_probe_angles
    ]
    for blade, fit in blades_and_resonances:
        resonance_text = f"blade {blade}, {fit.speed / RAD_PER_S_PER_RPM:.5g} rpm"
        if fit.untested:
            probes_text = format_count(fit.probes, "probe")
            warning_texts.append(
                f"{resonance_text}: {probes_text} {UNTESTED_ORDER_FORMAT.format(fit.order)}"
            )
        elif fit.ambiguous:
            orders_text = _orders_in_words("explain the arrivals as well", fit.ambiguous)
            warning_texts.append(f"{resonance_text}: {orders_text}")
        if fit.disagree:
            warning_texts.append(f"{resonance_text}: {fit.disagreement}")
        if fit.in_doubt:
            warning_texts.append(f"{resonance_text}: {CORRELATED_RESIDUALS_TEXT}")
    note_texts = [CONSTANT_FREQUENCY_TEXT] * any(
        fit.stiffening == 0.0 for _, fit in blades_and_resonances[:1]
    )
    blades_and_lines = [
        (blade, line_fit)
        for blade, fit in blades_and_clearest_fits
        for line_fit in fit.asynchronous
    ]
    note_texts += [
        f"blade {blade}: {_describe_line(line_fit)}" for blade, line_fit in blades_and_lines
    ]
    conclusion = Conclusion("no resonance found")
    if blades_and_resonances:
        blade, clearest_fit = blades_and_resonances[0]
        answer_text = f"the clearest of blade {blade} at {clearest_fit.in_words}"
        conclusion = Conclusion(
            f"{format_count(len(blades_and_resonances), 'resonance')} found", answer_text
        )
    return conclusion, note_texts, warning_texts


def _orders_in_words(orders_text: str, orders: Iterable[float]) -> str:
    """Return "orders that TEXT: 5, 7"."""
    return f"orders that {orders_text}: {format_first_orders([*orders])}"


def _describe_line(line_fit: TipFit) -> str:
    """Describe a vibration of constant frequency."""
    amplitude, amplitude_error = line_fit.amplitudes[0], line_fit.amplitude_errors[0]
    line_text = (
        f"{line_fit.omega / RAD_PER_TURN:.6g} Hz, {_amplitude_in_words(amplitude, amplitude_error)}"
    )
    return f"a vibration that follows no order: {line_text}"


def _amplitude_in_words(amplitude: float, amplitude_error: float) -> str:
    """Return "3 µm ± 1 µm"."""
    return f"{format_quantity(amplitude, 'm')} ± {format_quantity(amplitude_error, 'm')}"


def _describe_track(track: TipTrack) -> tuple[Conclusion, Table, list[str], list[str]]:
    """Describe a run-up: conclusion, table of peaks, notes and doubts."""
    track_table = track.table()
    kept_column_indices = [
        column_index
        for column_index, column_name in enumerate(track_table.columns)
        if not column_name.startswith("amplitude")
    ]
    conclusion = Conclusion("run-up tracked", "no vibration is larger than its errors")
    peak_rows, notes = [], []
    # Without any vibration, the largest of so many amplitudes is several errors large.
    max_noise_ratio = float(
        np.sqrt(2.0 * np.log(len(track.speed) / CONFIDENCE_LEVELS.misfit_significance_level))
    )
    for harmonic_index, harmonic_multiple in enumerate(track.multiples):
        amplitudes = track.amplitudes[:, harmonic_index]
        amplitude_errors = track.amplitude_errors[:, harmonic_index]
        clear_amplitudes = np.where(
            amplitudes <= max_noise_ratio * amplitude_errors, np.nan, amplitudes
        )
        if not np.all(np.isnan(clear_amplitudes)):
            peak_row_index = int(np.nanargmax(clear_amplitudes))
            peak_and_error = (
                float(amplitudes[peak_row_index]),
                float(amplitude_errors[peak_row_index]),
            )
            peak_rows.append(
                [
                    float(harmonic_multiple),
                    *(
                        track_table.rows[peak_row_index][column_index]
                        for column_index in kept_column_indices
                    ),
                    *peak_and_error,
                ]
            )
            if len(peak_rows) == 1:
                peak_frequency = track.omega[peak_row_index] / RAD_PER_TURN
                peak_frequency_text = f"{peak_frequency:.6g} Hz, engine order {track.order:g}"
                peak_text = f"{peak_frequency_text}: {_amplitude_in_words(*peak_and_error)}"
                answer_text = f"harmonic {harmonic_multiple:g} is largest at {peak_text}"
                conclusion = Conclusion("run-up tracked", answer_text)
        elif not np.all(np.isnan(amplitudes)):
            upper_bound_text = format_quantity(
                float(
                    np.nanmax(
                        amplitudes + CONFIDENCE_LEVELS.allowed_standard_errors * amplitude_errors
                    )
                ),
                "m",
            )
            unclear_text = UNCLEAR_HARMONIC_FORMAT.format(upper_bound_text)
            notes.append(f"harmonic {harmonic_multiple:g}: {unclear_text}")
    peak_columns = [
        "multiple, where it is largest",
        *(track_table.columns[column_index] for column_index in kept_column_indices),
    ]
    peak_table = Table([*peak_columns, "amplitude [m]", "amplitude_error [m]"], peak_rows)
    doubts = [NO_SPARE_PROBE_TEXT] if np.isnan(track.misfit) else []
    if track.does_not_fit:
        doubts.append(
            f"the residual repeats in all revolutions: {MISSING_HARMONICS_TEXT}, the vibration "
            "changes within the revolutions that are fitted together "
            f"(tip_timing.fitted_revolutions), or it is not of order {track.order:g}"
        )
    elif track.in_doubt and not doubts:
        doubts.append(FOLDED_HARMONICS_TEXT)
    return conclusion, peak_table, notes, doubts


def _describe_fits(timing: Timing) -> tuple[Conclusion, list[str], list[str]]:
    """Describe vibrations at one speed: conclusion, notes and doubts."""
    has_several_blades, notes, warnings = len(timing.fits) > 1, [], []
    for blade, fit in timing.fits.items():
        assert isinstance(fit, TipFit)
        blade_prefix = f"blade {blade}: " if has_several_blades else ""
        fit_notes, doubts = _describe_fit(fit)
        notes += [] if has_several_blades else fit_notes
        warnings += [f"{blade_prefix}{doubt}" for doubt in doubts]
    largest_fit: Any = timing.fits[blade := find_largest_blade(timing) or 1]
    amplitude_text = _amplitude_in_words(largest_fit.amplitudes[0], largest_fit.amplitude_errors[0])
    frequency_text = (
        f"engine order {largest_fit.order:g}, {largest_fit.omega / RAD_PER_TURN:.6g} Hz"
    )
    if has_several_blades:
        notes.append(f"the picture shows blade {blade}, whose amplitude is the largest")
        answer_text = (
            f"the largest vibration is that of blade {blade}, {amplitude_text}, {frequency_text}"
        )
        return (
            Conclusion(f"{format_count(len(timing.fits), 'blade')} fitted", answer_text),
            notes,
            warnings,
        )
    return (
        Conclusion("vibration found", f"amplitude {amplitude_text}, {frequency_text}"),
        notes,
        warnings,
    )


def _describe_fit(fit: TipFit) -> tuple[list[str], list[str]]:
    """Describe a fit: notes and doubts.

    A note has the ratio of the second harmonic to the first, which indicates a crack.
    """
    notes = [f"in addition, {_describe_line(line_fit)}" for line_fit in fit.asynchronous]
    warnings = []
    if _has_second_harmonic(fit):
        harmonic_ratio, ratio_error = fit.ratio()
        notes.append(f"second harmonic over first: {harmonic_ratio:.4g} ± {ratio_error:.2g}")
    if fit.does_not_fit:
        warnings.append(
            "residuals differ between the probes by more than their scatter: "
            f"{MISSING_HARMONICS_TEXT}, probes are misplaced (tip_timing.angle_deviation), or the "
            "order is none of tip_timing.orders"
        )
    elif fit.may_be_folded and fit.spare > 0:
        warnings.append(FOLDED_HARMONICS_TEXT)
    if fit.spare < 1:
        warnings.append(NO_SPARE_PROBE_TEXT)
    elif fit.seen_once:
        warnings.append(NO_REPETITION_TEXT)
    if fit.ambiguous:
        warnings.append(_orders_in_words("explain the arrivals as well", fit.ambiguous))
    if fit.hidden:
        warnings.append(_orders_in_words("these probes cannot measure", fit.hidden))
    return notes, warnings
