"""Result of the command ``timing``, and its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import TipFit, format_first_orders
from fenics_crack.arrivals.resonance import PassageFit
from fenics_crack.arrivals.robust import SIGNIFICANCE_LIMITS
from fenics_crack.arrivals.track_order import TipTrack
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    UNIT_BY_DICT_ENTRY_NAME,
    Conclusion,
    Report,
    Table,
    format_count,
    format_quantity,
)
from fenics_crack.files.store import SavableResult
from fenics_crack.scene.scene import Scene

EMPTY_RESONANCE_COLUMN_BY_NAME: dict[str, list[Any]] = {
    "blade": [],
    "rpm": [],
    "order": [],
    "frequency": [],
}
"""Columns of the table of ``timing`` if a run-up has no resonance."""
UNFITTED_HARMONICS_DOUBT = (
    "the vibration has more harmonics than are fitted (raise tip_timing.fitted_harmonics)"
)
NO_SPARE_PROBE_DOUBT = (
    "there are as many unknowns as probes, which cannot test the order and the harmonics: use "
    "more probes, or fit fewer harmonics (tip_timing.fitted_harmonics)"
)
ALIASED_HARMONICS_DOUBT = (
    "harmonics that are not fitted may be aliased onto the fitted ones: raise "
    "tip_timing.fitted_harmonics, or use more probes"
)
INSIGNIFICANT_AMPLITUDE_NOTE_FORMAT = (
    "its amplitude exceeds its error at no speed, and is at most {}; more fitted revolutions give "
    "a smaller error (tip_timing.fitted_revolutions)"
)
UNTESTED_ENGINE_ORDER_DOUBT_FORMAT = (
    "cannot test an order: order {:g} fits, but others may fit as well; give the possible ones "
    "as tip_timing.orders"
)
EXCLUDED_PROBE_REASON = (
    "excluded, since it does not measure the vibration that the other probes measure: check that "
    "its pulses are of this blade"
)
UNMEASURABLE_ORDERS_REMARK_END = (
    "probes at these angles cannot measure (if these are possible, use other angles)"
)
EQUALLY_GOOD_ORDERS_REMARK_END = "explain the arrivals equally well (more probes distinguish them)"
CONSTANT_NATURAL_FREQUENCY_REMARK = (
    "natural frequencies are assumed constant; if they change with the speed, damping is wrong, "
    "and frequencies are too high in a fast run-up, too low in a run-down: give "
    "tip_timing.stiffening"
)


@keep_old_attribute_names(of_resonances="has_resonance_fits")
@dataclass(frozen=True, repr=False)
class Timing(SavableResult):
    """Result of ``fenics-crack timing``: vibrations fitted to arrival times of blade tips.

    Attributes
    ----------
    scene : Scene or None
        Scene with [tip_timing]; None for a measured record by itself.
    arrivals : dict of int to ArrivalTimes
        Arrival times at the probes, by blade number from 1.
    fits : dict of int to TipFit, TipTrack or tuple of PassageFit
        Fit of each blade: a vibration at constant speed (TipFit), an engine order along a run-up
        (TipTrack), or resonances in a run-up (PassageFit, none for an empty tuple).
    doubts : tuple of str
        Sentences that cast doubt on the arrivals.
    """

    scene: Scene | None
    arrivals: Mapping[int, ArrivalTimes]
    fits: Mapping[int, TipFit | TipTrack | tuple[PassageFit, ...]]
    doubts: tuple[str, ...] = ()

    KIND: ClassVar[str] = "tip timing"

    @property
    def has_resonance_fits(self) -> bool:
        """Return True if the fits are resonances in a run-up."""
        return any(isinstance(fit, tuple) for fit in self.fits.values())

    def to_dict(self) -> dict[str, Any]:
        """Return the table's columns by name.

        - Resonances in a run-up: each row is a resonance. Without any resonance the columns are
          empty.
        - A single blade, fitted at constant speed or with a tracked engine order: the rows are the
          harmonics or the speeds of the fit.
        - Several blades at constant speed: each row is a blade.
        """
        if self.has_resonance_fits:
            table_rows = [
                {"blade": blade} | passage_fit.to_dict()
                for blade, fit in self.fits.items()
                if isinstance(fit, tuple)
                for passage_fit in fit
            ]
        elif len(self.fits) == 1:
            return self._fit_of_first_blade.to_dict()
        else:
            fit_by_blade = {
                blade: fit for blade, fit in self.fits.items() if isinstance(fit, TipFit)
            }
            have_harmonic_ratios = all(map(_is_second_harmonic_fitted, fit_by_blade.values()))
            table_rows = [
                {"blade": blade} | _make_fit_row_by_column(fit, have_harmonic_ratios)
                for blade, fit in fit_by_blade.items()
            ]
        return {
            column_name: [table_row[column_name] for table_row in table_rows]
            for column_name in (table_rows or [EMPTY_RESONANCE_COLUMN_BY_NAME])[0]
            if column_name != "speed"
        }

    @property
    def _fit_of_first_blade(self) -> Any:
        """Return the fit of the blade with the first key."""
        return next(iter(self.fits.values()))

    def _unit_by_name(self) -> Mapping[str, str]:
        is_single_fit = len(self.fits) == 1 and not self.has_resonance_fits
        unit_by_column: Mapping[str, str] = (
            self._fit_of_first_blade._unit_by_name() if is_single_fit else UNIT_BY_DICT_ENTRY_NAME
        )
        return unit_by_column

    def _repr_text(self) -> str:
        revolutions_text = format_count(len(next(iter(self.arrivals.values()))), "revolution")
        return f"{format_count(len(self.arrivals), 'blade')}, {revolutions_text}"


def _is_second_harmonic_fitted(fit: TipFit) -> bool:
    """Return True if twice the load's frequency is among the fitted harmonics."""
    return bool(np.any(np.isclose(fit.multiples, 2.0)))


def _make_fit_row_by_column(fit: TipFit, has_harmonic_ratio: bool) -> dict[str, float]:
    """Return a blade's table row by column: amplitude, order and ratio of harmonics.

    The amplitude [m] and its standard error belong to the first fitted harmonic. If
    ``has_harmonic_ratio``, the row also has the ratio of the second harmonic to the first, with its
    standard error.
    """
    amplitudes, harmonic_amplitude_errors = fit.amplitudes, fit.amplitude_errors
    value_by_column = {
        "amplitude": float(amplitudes[0]),
        "amplitude_error": float(harmonic_amplitude_errors[0]),
        "order": fit.order,
    }
    ratio_column_names = "ratio_2_1", "ratio_2_1_error"
    return value_by_column | (
        dict(zip(ratio_column_names, fit.ratio_and_error(), strict=True))
        if has_harmonic_ratio
        else {}
    )


# --- report ---------------------------------------------------------------------------------------


def report_of_timing(timing: Timing) -> Report:
    """Return the report of ``fenics-crack timing``: each blade's vibration, and doubts."""
    from fenics_crack.study.plausibility import remarks_on_scene  # with DOLFINx

    passages_by_blade = {
        blade_number: fit for blade_number, fit in timing.fits.items() if isinstance(fit, tuple)
    }
    engine_order_tracks = [fit for fit in timing.fits.values() if isinstance(fit, TipTrack)]
    shown_table = timing.table()
    if passages_by_blade:
        conclusion, note_texts, warning_texts = _describe_run_up_resonances(passages_by_blade)
    elif engine_order_tracks:
        conclusion, shown_table, note_texts, warning_texts = _find_significant_harmonics_of_track(
            engine_order_tracks[0]
        )
    else:
        conclusion, note_texts, warning_texts = _conclude_on_steady_vibrations(timing)
    return Report(
        timing.table(),
        conclusion,
        timing.scene,
        printed_table=shown_table,
        notes=note_texts,
        warnings=[*timing.doubts, *warning_texts],
        remarks=() if timing.scene is None else remarks_on_scene(timing.scene),
    )


def find_blade_of_largest_amplitude_or_none(timing: Timing) -> int | None:
    """Find the blade with the largest first harmonic at constant speed.

    None for a run-up.
    """
    fit_by_blade = {blade: fit for blade, fit in timing.fits.items() if isinstance(fit, TipFit)}
    return (
        max(fit_by_blade, key=lambda blade: float(fit_by_blade[blade].amplitudes[0]))
        if fit_by_blade
        else None
    )


def _describe_run_up_resonances(
    passages_by_blade: Mapping[int, tuple[PassageFit, ...]],
) -> tuple[Conclusion, list[str], list[str]]:
    """Conclude from the resonances of all blades in a run-up.

    ``passages_by_blade`` has the resonances by blade number, the clearest resonance first.

    Returns
    -------
    Conclusion
        Number of resonances, and a description of the first blade's clearest resonance.
    list of str
        Notes for the reader.
    list of str
        Warnings: excluded probes, ambiguous orders, correlated residuals.
    """
    blades_and_resonances = [
        (blade, fit) for blade, fits_of_blade in passages_by_blade.items() for fit in fits_of_blade
    ]
    warning_texts = [
        "no resonance exceeds the scatter of the arrivals: check the orders (tip_timing.orders), "
        "and that the run-up passes a resonance"
    ] * (not blades_and_resonances)
    blades_and_clearest_fits = [
        (blade, fits_of_blade[0])
        for blade, fits_of_blade in passages_by_blade.items()
        if fits_of_blade
    ]
    warning_texts += [
        f"blade {blade}, probe at {np.degrees(excluded_probe_angle):.5g} degrees: "
        f"{EXCLUDED_PROBE_REASON}"
        for blade, fit in blades_and_clearest_fits
        for excluded_probe_angle in fit.blind
    ]
    for blade, fit in blades_and_resonances:
        untested_order_text = (
            f"{format_count(fit.probes, 'probe')} "
            f"{UNTESTED_ENGINE_ORDER_DOUBT_FORMAT.format(fit.order)}"
        )
        doubts_and_texts = (
            (fit.is_order_untested, untested_order_text),
            (
                fit.ambiguous_orders and not fit.is_order_untested,
                _describe_orders(EQUALLY_GOOD_ORDERS_REMARK_END, fit.ambiguous_orders),
            ),
            (fit.passages_disagree, fit.disagreement_in_words),
            (
                fit.in_doubt,
                "the residuals are correlated, due to drift or another vibration nearby: the order "
                "and the standard errors may be wrong; compare with another run-up",
            ),
        )
        warning_texts += [
            f"blade {blade}, {fit.speed / RAD_PER_S_PER_RPM:.5g} rpm: {doubt_text}"
            for is_doubtful, doubt_text in doubts_and_texts
            if is_doubtful
        ]
    note_texts = [CONSTANT_NATURAL_FREQUENCY_REMARK] * any(
        fit.stiffening == 0.0 for _, fit in blades_and_resonances[:1]
    )
    note_texts += [
        f"blade {blade}: {_describe_asynchronous_fit(asynchronous_fit)}"
        for blade, fit in blades_and_clearest_fits
        for asynchronous_fit in fit.asynchronous
    ]
    conclusion = Conclusion("no resonance found")
    if blades_and_resonances:
        blade, clearest_fit = blades_and_resonances[0]
        clearest_resonance_text = f"the clearest is of blade {blade}, at {clearest_fit.in_words}"
        conclusion = Conclusion(
            f"{format_count(len(blades_and_resonances), 'resonance')} found",
            clearest_resonance_text,
        )
    return conclusion, note_texts, warning_texts


def _describe_orders(statement_text: str, orders: Iterable[float]) -> str:
    """Return a list of engine orders as text: "orders that <statement_text>: 5, 7".

    For example, ``statement_text`` is "fit, too". ``orders`` are the engine orders.
    """
    return f"orders that {statement_text}: {format_first_orders([*orders])}"


def _describe_asynchronous_fit(asynchronous_fit: TipFit) -> str:
    """Describe a vibration of constant frequency, independent of the speed.

    The text has the frequency [Hz], and the amplitude of the first harmonic with its error.
    """
    amplitude, amplitude_error = (
        asynchronous_fit.amplitudes[0],
        asynchronous_fit.amplitude_errors[0],
    )
    line_text = (
        f"{asynchronous_fit.omega / RAD_PER_TURN:.6g} Hz, "
        f"{_format_amplitude_with_error(amplitude, amplitude_error)}"
    )
    return f"a vibration of no engine order: {line_text}"


def _format_amplitude_with_error(amplitude: float, amplitude_error: float) -> str:
    """Return an amplitude with its standard error, both in m, as "3 µm ± 1 µm"."""
    return f"{format_quantity(amplitude, 'm')} ± {format_quantity(amplitude_error, 'm')}"


def _find_significant_harmonics_of_track(
    track: TipTrack,
) -> tuple[Conclusion, Table, list[str], list[str]]:
    """Conclude from an engine order that is tracked along a run-up.

    A harmonic here is a multiple of the engine order. It is significant if its amplitude at any of
    n speeds exceeds sqrt(2 ln(n / 0.001)) standard errors.

    Returns
    -------
    conclusion : Conclusion
        Frequency and amplitude at the peak of the first significant harmonic; or the statement that
        no harmonic is significant.
    peak_table : Table
        A row for each significant harmonic: values at the speed of its peak.
    note_texts : list of str
        Notes with an upper bound for each harmonic that is not significant.
    doubt_texts : list of str
        Doubts about the fit.
    """
    track_table = track.table()
    kept_column_indices = [
        column_index
        for column_index, column_name in enumerate(track_table.columns)
        if not column_name.startswith("amplitude")
    ]
    conclusion = Conclusion(
        "run-up tracked", f"no vibration of engine order {track.order:g} is larger than its errors"
    )
    harmonic_peak_rows, note_texts = [], []
    # Without any vibration, the largest amplitude at n speeds is several errors large.
    min_amplitude_to_error_ratio = float(
        np.sqrt(2.0 * np.log(len(track.speed) / SIGNIFICANCE_LIMITS.misfit_significance_level))
    )
    for harmonic_index, harmonic_multiple in enumerate(track.multiples):
        amplitudes = track.amplitudes[:, harmonic_index]
        amplitude_errors = track.amplitude_errors[:, harmonic_index]
        clear_amplitudes = np.where(
            amplitudes <= min_amplitude_to_error_ratio * amplitude_errors, np.nan, amplitudes
        )
        if not np.all(np.isnan(clear_amplitudes)):
            peak_row_index = int(np.nanargmax(clear_amplitudes))
            peak_and_error = (
                float(amplitudes[peak_row_index]),
                float(amplitude_errors[peak_row_index]),
            )
            harmonic_peak_rows.append(
                [
                    float(harmonic_multiple),
                    *(
                        track_table.rows[peak_row_index][column_index]
                        for column_index in kept_column_indices
                    ),
                    *peak_and_error,
                ]
            )
            if len(harmonic_peak_rows) == 1:
                peak_frequency = track.omega[peak_row_index] / RAD_PER_TURN
                peak_text = (
                    f"{peak_frequency:.6g} Hz, engine order {track.order:g}, "
                    f"with {_format_amplitude_with_error(*peak_and_error)}"
                )
                answer_text = f"harmonic {harmonic_multiple:g} is largest at {peak_text}"
                conclusion = Conclusion("run-up tracked", answer_text)
        elif not np.all(np.isnan(amplitudes)):
            amplitude_upper_bounds = (
                amplitudes + SIGNIFICANCE_LIMITS.n_standard_errors_of_equal_fits * amplitude_errors
            )
            insignificant_amplitude_text = INSIGNIFICANT_AMPLITUDE_NOTE_FORMAT.format(
                format_quantity(float(np.nanmax(amplitude_upper_bounds)), "m")
            )
            note_texts.append(f"harmonic {harmonic_multiple:g}: {insignificant_amplitude_text}")
    peak_column_names = [
        "multiple, where it is largest",
        *(track_table.columns[column_index] for column_index in kept_column_indices),
    ]
    harmonic_peak_table = Table(
        [*peak_column_names, "amplitude [m]", "amplitude_error [m]"], harmonic_peak_rows
    )
    doubt_texts = [NO_SPARE_PROBE_DOUBT] if np.isnan(track.misfit) else []
    if track.does_not_fit:
        doubt_texts.append(
            f"the residuals repeat in all revolutions: {UNFITTED_HARMONICS_DOUBT}, it "
            "changes within "
            "the revolutions that are fitted together (lower tip_timing.fitted_revolutions), or it "
            f"is not of order {track.order:g}"
        )
    elif track.in_doubt and not doubt_texts:
        doubt_texts.append(ALIASED_HARMONICS_DOUBT)
    return conclusion, harmonic_peak_table, note_texts, doubt_texts


def _conclude_on_steady_vibrations(timing: Timing) -> tuple[Conclusion, list[str], list[str]]:
    """Conclude from vibrations at constant speed, one fit for each blade.

    Returns
    -------
    Conclusion
        Amplitude and frequency of the blade with the largest amplitude.
    list of str
        Notes for the reader.
    list of str
        Doubts about the fits.
    """
    has_several_blades, note_texts, warning_texts = len(timing.fits) > 1, [], []
    for blade, fit in timing.fits.items():
        assert isinstance(fit, TipFit)
        blade_prefix = f"blade {blade}: " if has_several_blades else ""
        fit_note_texts, doubt_texts = _list_fit_notes_and_doubts(fit)
        note_texts += [] if has_several_blades else fit_note_texts
        warning_texts += [f"{blade_prefix}{doubt_text}" for doubt_text in doubt_texts]
    largest_fit: Any = timing.fits[blade := find_blade_of_largest_amplitude_or_none(timing) or 1]
    amplitude_text = _format_amplitude_with_error(
        largest_fit.amplitudes[0], largest_fit.amplitude_errors[0]
    )
    frequency_text = (
        f"engine order {largest_fit.order:g}, {largest_fit.omega / RAD_PER_TURN:.6g} Hz"
    )
    if has_several_blades:
        note_texts.append(f"the picture shows blade {blade}, whose amplitude is the largest")
        answer_text = (
            f"the largest vibration is that of blade {blade}, {amplitude_text}, {frequency_text}"
        )
        return (
            Conclusion(f"{format_count(len(timing.fits), 'blade')} fitted", answer_text),
            note_texts,
            warning_texts,
        )
    return (
        Conclusion("vibration found", f"amplitude {amplitude_text}, {frequency_text}"),
        note_texts,
        warning_texts,
    )


def _list_fit_notes_and_doubts(fit: TipFit) -> tuple[list[str], list[str]]:
    """List notes and doubts about the fit of one blade, as sentences.

    A note gives the ratio of the second harmonic to the first, which indicates a breathing crack.

    Returns
    -------
    list of str
        Notes.
    list of str
        Doubts.
    """
    note_texts = [
        f"in addition, {_describe_asynchronous_fit(asynchronous_fit)}"
        for asynchronous_fit in fit.asynchronous
    ]
    if _is_second_harmonic_fitted(fit):
        harmonic_ratio, harmonic_ratio_error = fit.ratio_and_error()
        note_texts.append(
            f"ratio of second to first harmonic: {harmonic_ratio:.4g} ± {harmonic_ratio_error:.2g}"
        )
    misfit_text = (
        "residuals differ between the probes by more than their scatter: "
        f"{UNFITTED_HARMONICS_DOUBT}, probes are misplaced (tip_timing.angle_deviation), or its "
        "order is not among tip_timing.orders"
    )
    has_spare_probes = fit.spare > 0
    doubts_and_texts = (
        (fit.does_not_fit, misfit_text),
        (
            fit.may_contain_aliased_harmonics and has_spare_probes and not fit.does_not_fit,
            ALIASED_HARMONICS_DOUBT,
        ),
        (not has_spare_probes, NO_SPARE_PROBE_DOUBT),
        (
            fit.seen_once and has_spare_probes,
            "each probe measures the vibration only once, which cannot test the fit and its "
            "standard errors: record more revolutions",
        ),
        (
            fit.ambiguous_orders,
            _describe_orders(EQUALLY_GOOD_ORDERS_REMARK_END, fit.ambiguous_orders),
        ),
        (fit.hidden, _describe_orders(UNMEASURABLE_ORDERS_REMARK_END, fit.hidden)),
    )
    return note_texts, [doubt_text for is_doubtful, doubt_text in doubts_and_texts if is_doubtful]
