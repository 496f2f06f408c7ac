"""Measurements of a cracked plate: frequencies and harmonics with standard deviations."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.basics.errors import (
    N_NATURAL_MODES_PER_CRACK_STATE,
    InputError,
    check_choice,
    check_count,
    check_number,
    report_read_errors,
)
from fenics_crack.basics.suggestions import (
    check_argument_class_or_unwrap_run,
    check_calls,
    keep_old_attribute_names,
)
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN, Tabular, format_count
from fenics_crack.basics.untrusted_files import convert_heading_to_si, read_numbered_csv_rows
from fenics_crack.monitoring.identification.options import IDENTIFICATION_VALUES
from fenics_crack.scene.fields import (
    MAX_ALLOWED_MAGNITUDE,
    MIN_ALLOWED_MAGNITUDE,
    ZERO_OR_MAGNITUDE_TEXT,
)
from fenics_crack.scene.scene import Scene

if TYPE_CHECKING:
    from fenics_crack.arrivals.resonance import PassageFit  # SciPy

NATURAL_FREQUENCY_STATE_NAMES = ("open", "tied", "bilinear", "resonance", "uncracked")
"""States of the crack in the names of natural frequencies, "frequency_open" and so on.

The crack is always open, bonded ("tied"), breathing by the bilinear formula, or breathing at a
measured resonance. "uncracked" is the plate before it had a crack.
"""
HARMONIC_LOAD_QUANTITY_NAMES = (
    "harmonic_1",
    "harmonic_2",
    "harmonic_3",
    "ratio_2_1",
    "ratio_3_1",
    "displacement",
)
"""Measured quantities of a point under a harmonic load."""
REQUIRED_MEASUREMENT_COLUMN_NAMES = ("quantity", "value", "deviation")
"""Required columns in a table of measurements."""
OPTIONAL_MEASUREMENT_COLUMN_NAMES = ("mode", "frequency", "point", "phase", "rpm", "temperature")
"""Optional columns in a table of measurements."""
ALLOWED_MEASUREMENT_UNITS = "Hz", "m", "-"
"""Units of measured values: frequencies, harmonics, and ratios."""
ALLOWED_UNITS_BY_COLUMN = {
    "frequency": ALLOWED_MEASUREMENT_UNITS[:1],
    "phase": ("rad",),
    "value": ALLOWED_MEASUREMENT_UNITS,
    "deviation": ALLOWED_MEASUREMENT_UNITS,
    "temperature": ("K", "°C", "C"),
    "rpm": ("rpm",),
}
"""Units in the brackets of a table's headings, after conversion, by column."""
UNIVERSAL_FILE_SUFFIXES = (".uff", ".unv")
"""Suffixes of universal files, with frequency responses."""


@keep_old_attribute_names(
    natural="is_natural_frequency", resonance="is_resonant", shape="is_independent_of_load_size",
    orders="harmonic_orders", load="get_load_frequency",
)  # fmt: skip
@keep_old_attribute_names(
    depends_on_shape_alone="is_independent_of_load_size",
    harmonic_orders="harmonic_orders_of_quantity",
)
@dataclass(frozen=True)
class Measurement:
    """One measured number.

    Attributes
    ----------
    quantity : str
        Name of the quantity. Natural frequencies of mode ``mode`` [Hz] are: "frequency_open" with
        the crack always open, "frequency_tied" with the crack always closed, "frequency_bilinear"
        by the bilinear formula from both, "frequency_resonance" at a measured resonance of a
        breathing crack, and "frequency_uncracked" before the plate had a crack. The last calibrates
        the plate.

        Quantities of a point under the scene's load at ``frequency`` are, as in
        :class:`Indicators`, "harmonic_1" to "harmonic_3" [m], "ratio_2_1" and "ratio_3_1". A
        "displacement" [m] is the point's displacement at ``phase``, as probes measure. The load's
        size and phase and a constant are fitted to all displacements of a point at a frequency.
    value, deviation : float
        Measured value, and its standard deviation > 0, in the same unit.
    mode : int
        Mode number from 1; 0 without a mode.
    frequency : float [Hz]
        Load frequency; nan without a load.
    point : str
        Point and direction of ``[output.points]``, as "tip.ux"; "": the load's point in the load's
        direction.
    phase : float [rad]
        Phase of the load's period, 0 at its beginning, 2 pi at its end; nan without a phase.
    rpm : float [1/min]
        Rotor speed at which a natural frequency was measured, 0 at rest; nan: the scene's own.
    temperature : float [K or °C]
        Temperature of the structure when a natural frequency was measured; nan if unknown. All
        measurements use the same unit, since only temperature differences matter.

    Raises
    ------
    InputError
        A value cannot be used.
    """

    quantity: str
    value: float
    deviation: float
    mode: int = 0
    frequency: float = math.nan
    point: str = ""
    phase: float = math.nan
    rpm: float = math.nan
    temperature: float = math.nan

    def __post_init__(self) -> None:
        allowed_quantity_names = (
            *(f"frequency_{state_name}" for state_name in NATURAL_FREQUENCY_STATE_NAMES),
            *HARMONIC_LOAD_QUANTITY_NAMES,
        )
        check_choice("measurements.quantity", self.quantity, allowed_quantity_names)
        is_displacement = self.quantity == "displacement"
        check_number("measurements.value", self.value, -math.inf if is_displacement else 0.0)
        check_number("measurements.deviation", self.deviation, 0.0, excludes_bound=True)
        if self.is_natural_frequency:
            if not (
                isinstance(self.mode, Integral)
                and 1 <= self.mode <= N_NATURAL_MODES_PER_CRACK_STATE
            ):
                allowed_text = (
                    f"a whole number from 1 to {N_NATURAL_MODES_PER_CRACK_STATE} with "
                    f"{self.quantity}"
                )
                raise InputError("measurements.mode", self.mode, allowed_text)
        else:
            check_number("measurements.frequency", self.frequency, 0.0, excludes_bound=True)
        if is_displacement:
            check_number("measurements.phase", self.phase)
            if abs(self.phase) > 2.0 * RAD_PER_TURN:  # allow another zero
                allowed_text = (
                    f"in rad, 0 to 2 pi; if it is in degrees, give {math.radians(self.phase):.5g}"
                )
                raise InputError("measurements.phase", self.phase, allowed_text)
        if not math.isnan(self.rpm):
            check_number("measurements.rpm", self.rpm, 0.0)
        if not math.isnan(self.temperature):
            check_number("measurements.temperature", self.temperature)
        allowed_keys = (
            ("mode", "rpm", "temperature")
            if self.is_natural_frequency
            else ("frequency", "point", *["phase"] * is_displacement)
        )
        for key in OPTIONAL_MEASUREMENT_COLUMN_NAMES:
            key_value = getattr(self, key)
            if (
                key not in allowed_keys
                and key_value
                and not (isinstance(key_value, float) and math.isnan(key_value))
            ):
                raise InputError(f"measurements.{key}", key_value, f"left out with {self.quantity}")
        for key in ("value", "deviation", "frequency", "phase", "rpm", "temperature"):
            key_value = getattr(self, key)
            if not (
                math.isnan(key_value)
                or key_value == 0.0
                or MIN_ALLOWED_MAGNITUDE <= abs(key_value) <= MAX_ALLOWED_MAGNITUDE
            ):
                raise InputError(
                    f"measurements.{key}", key_value, f"a number {ZERO_OR_MAGNITUDE_TEXT}"
                )

    @property
    def is_natural_frequency(self) -> bool:
        """Return True for a natural frequency, False for a quantity under a load."""
        return self.quantity.startswith("frequency_")

    @property
    def is_resonant(self) -> bool:
        """Return True for "frequency_resonance", a resonance with a breathing crack."""
        return self.quantity == "frequency_resonance"

    @property
    def is_independent_of_load_size(self) -> bool:
        """Return True if the measurement does not depend on the load's size.

        Ratios do not depend on the size. For displacements the size is fitted, so the result is
        True, too.
        """
        return not self.is_natural_frequency and not self.quantity.startswith("harmonic")

    @property
    def harmonic_orders_of_quantity(self) -> tuple[int, ...]:
        """Return the orders of the harmonics from which the quantity is computed.

        For a ratio, the numerator's order comes first. The tuple is empty for natural frequencies,
        and for displacements, which have all harmonics.
        """
        return () if self.is_natural_frequency else tuple(map(int, self.quantity.split("_")[1:]))

    @property
    def name(self) -> str:
        """Return the name in words: "frequency_open of mode 2", "ratio_2_1 at 250 Hz of tip.ux"."""
        if self.is_natural_frequency:
            speed_text = "" if math.isnan(self.rpm) else f" at {self.rpm:g} rpm"
            return f"{self.quantity} of mode {self.mode}{speed_text}"
        point_text = f" of {self.point}" if self.point else ""
        phase_in_radians_text = "" if math.isnan(self.phase) else f" and {self.phase:.3g} rad"
        return f"{self.quantity} at {self.frequency:g} Hz{phase_in_radians_text}{point_text}"

    def get_load_frequency(self, scene: Scene) -> float:
        """Return the load frequency [Hz] of the case that predicts this measurement.

        A quantity under a load has its own load frequency. A natural frequency needs a case at its
        rotor speed:

        - At another speed than the scene's, the load frequency is engine order times this speed.
        - At the scene's speed, or without a stated speed, 0 is returned. It stands for the scene's
          own case.
        - At rest, a thousandth of the scene's load frequency is returned, since a case cannot have
          the load frequency 0.
        """
        if not self.is_natural_frequency:
            return float(self.frequency)
        if math.isnan(self.rpm):
            return 0.0
        scene_frequency = scene.excitation.omega / RAD_PER_TURN
        # At rest, take a thousandth of the speed: stiffening is then a millionth, and the load
        # frequency is not 0.
        load_frequency = max(
            scene.excitation.given("order") * self.rpm / 60.0, 1e-3 * scene_frequency
        )
        return (
            0.0
            if f"{load_frequency:.9g}" == f"{scene_frequency:.9g}"
            else float(f"{load_frequency:.9g}")
        )

    def check(self, scene: Scene) -> None:
        """Raise InputError if the measurement does not fit the scene.

        Reasons are a rotor speed without an engine order, an unknown point, a crack that cannot be
        removed, and too few harmonics.
        """
        point_names = scene.label_by_displacement_name
        highest_order_of_measurement = max(self.harmonic_orders_of_quantity, default=0)
        n_harmonics = scene.harmonic_balance.harmonics
        for is_unfit, key, key_value, allowed_text in (
            (
                not math.isnan(self.rpm) and (scene.excitation.order is None or scene.speed == 0.0),
                "measurements.rpm",
                self.rpm,
                "left out unless the scene has [rotation] and excitation.order",
            ),
            (
                self.point and self.point not in point_names,
                "measurements.point",
                self.point,
                f"empty, or one of [output.points]: {', '.join(point_names) or 'there are none'}",
            ),
            (
                self.quantity == "frequency_uncracked"
                and get_crack_removal_changes_or_none(scene) is None,
                "measurements.quantity",
                self.quantity,
                "left out, since the crack cannot be removed from this scene; with mesh files, "
                "give that of the part without a crack as identify.uncracked",
            ),
            (
                n_harmonics < highest_order_of_measurement,
                "harmonic_balance.harmonics",
                n_harmonics,
                f"at least {highest_order_of_measurement} for {self.quantity}",
            ),
        ):
            if is_unfit:
                raise InputError(key, key_value, allowed_text)


@dataclass(frozen=True, repr=False)
class Measurements(Tabular):
    """Measured numbers for the identification of one crack.

    Attributes
    ----------
    rows : tuple of Measurement
        1 to 1000 measurements, with different names except for displacements.
    """

    rows: tuple[Measurement, ...]

    def __post_init__(self) -> None:
        check_argument_class_or_unwrap_run("measurements", self.rows, "Iterable", ())
        object.__setattr__(self, "rows", tuple(self.rows))
        if not self.rows or not all(
            isinstance(measurement, Measurement) for measurement in self.rows
        ):
            raise InputError(
                "measurements", list(self.rows), "a list of at least one fc.Measurement"
            )
        if len(self.rows) > IDENTIFICATION_VALUES.max_measurements:
            row_limit_text = f"at most {IDENTIFICATION_VALUES.max_measurements} rows"
            allowed_text = f"{row_limit_text}; replace repeated measurements by their mean"
            raise InputError("measurements", f"{len(self.rows)} rows", allowed_text)
        values_by_name: dict[str, list[float]] = {}
        for measurement in self.rows:
            if measurement.quantity != "displacement":
                values_by_name.setdefault(measurement.name, []).append(measurement.value)
        for measurement_name, values_of_same_name in values_by_name.items():
            if len(values_of_same_name) > 1:
                allowed_text = "one value: give the mean, and the standard deviation of the mean"
                raise InputError(
                    f"measurements, {measurement_name}", values_of_same_name, allowed_text
                )

    @classmethod
    def from_arrays(
        cls,
        quantity: str,
        values: Sequence[float],
        deviations: Any,
        **optional_columns: Sequence[Any],
    ) -> Measurements:
        """Make measurements of one quantity from arrays.

        Parameters
        ----------
        quantity : str
            Name of the quantity, an attribute of :class:`Measurement`.
        values : (n,)
            Measured values.
        deviations : (n,) or float
            Standard deviations, or one for all values.
        **optional_columns : (n,) each
            Other attributes of :class:`Measurement`: ``mode`` and ``rpm``, or ``frequency`` and
            ``point``.

        Raises
        ------
        InputError
            A value cannot be used, or the lengths differ.
        """
        check_argument_class_or_unwrap_run("values", values, "Iterable", ())
        n_values = len(values)
        deviation_column = (
            deviations if isinstance(deviations, Iterable) else [deviations] * n_values
        )
        column_by_name: dict[str, Any] = {
            "value": values,
            "deviation": deviation_column,
            **optional_columns,
        }
        for column_name, column in column_by_name.items():
            if (
                column_name
                not in {measurement_field.name for measurement_field in fields(Measurement)}
                or len(column) != n_values
            ):
                raise InputError(
                    column_name,
                    column,
                    f"{n_values} entries, one for each value; the columns are "
                    f"{', '.join(OPTIONAL_MEASUREMENT_COLUMN_NAMES)}",
                )
        return cls(
            tuple(
                Measurement(quantity, **dict(zip(column_by_name, row_values, strict=True)))
                for row_values in zip(*column_by_name.values(), strict=True)
            )
        )

    @classmethod
    def from_arrivals(
        cls,
        arrivals: ArrivalTimes,
        order: int,
        point: str = "",
        *,
        against: bool = False,
        noise: float | None = None,
        angle_deviation: float = 0.0,
    ) -> Measurements:
        """Take the mean displacement of a blade tip at each probe, for an engine order.

        With p load periods in a revolution, the load is at the phase p alpha if the rotor is at the
        angle alpha. The arrivals at this angle give the displacement (:class:`ArrivalTimes`). No
        harmonic is fitted here; the forward model predicts the displacements. Single wrong arrivals
        have no weight in the means, and vibrations of constant frequency are subtracted, as in
        :func:`fit_order`.

        Parameters
        ----------
        arrivals : ArrivalTimes
            Arrivals of steady vibration at constant speed.
        order : int
            Periods p of the load in a revolution (found by :func:`fit_order`).
        point : str
            Blade tip and direction, as ``point`` of :class:`Measurement`.
        against : bool
            True if the direction of the point is against the rotation.
        noise : float [s]
            Standard deviation of an arrival time. Default: estimated from the scatter between
            revolutions, including correlation. An estimate from few revolutions is enlarged.
        angle_deviation : float [rad]
            Standard deviation of the probes' angles, the same in every revolution.

        Raises
        ------
        InputError
            A value cannot be used, the speed is not constant, arrivals are not at the probes, or
            fewer than four probes have arrivals. Or ``noise`` is missing, and arrivals have no
            scatter or are too few for an estimate, as in one revolution alone.
        """
        from fenics_crack.arrivals.fit_order import ProbeMeans  # SciPy
        from fenics_crack.arrivals.robust import student_variance_ratio

        check_count("order", order, 1)
        if noise is not None:
            check_number("noise", noise, 0.0, excludes_bound=True)
        if not arrivals.steady:
            requirement = (
                "recorded at constant speed; for a run-up use find_passages and from_passages"
            )
            raise InputError("arrivals", repr(arrivals), requirement)
        arrivals.check_places(angle_deviation)
        n_arrivals_of_probes = np.isfinite(arrivals.time).sum(axis=0)
        n_arrivals_of_probes = n_arrivals_of_probes[n_arrivals_of_probes > 0]
        rotor_speed = arrivals.mean_speed
        if len(n_arrivals_of_probes) < 4:  # one more than the load's size and phase, and a constant
            raise InputError("arrivals", repr(arrivals), "recorded with at least 4 probes")
        probe_statistics = ProbeMeans(arrivals, 1, float(order), angle_deviation)
        probe_place_deviation = arrivals.tip_radius * angle_deviation
        if noise is not None:
            deviations_of_mean_arrival_angle = rotor_speed * noise / np.sqrt(n_arrivals_of_probes)
            displacement_deviations = arrivals.tip_radius * np.hypot(
                deviations_of_mean_arrival_angle, angle_deviation
            )
        elif probe_statistics.scatter <= arrivals.displacement_rounding:
            raise InputError("noise", None, "given in s, since these arrivals have no scatter")
        elif np.isnan(
            variance_factor := student_variance_ratio(
                probe_statistics.covariance_degrees_of_freedom
            )
        ):
            arrival_count_text = format_count(int(n_arrivals_of_probes.sum()), "arrival")
            probe_count_text = format_count(len(n_arrivals_of_probes), "probe")
            allowed_text = (
                f"given in s, since {arrival_count_text} at {probe_count_text} are too few to "
                f"estimate it"
            )
            raise InputError("noise", None, allowed_text)
        else:
            variances_of_mean_displacements = (
                np.diag(probe_statistics.covariance) - probe_place_deviation**2
            )
            displacement_deviations = np.sqrt(
                variance_factor * variances_of_mean_displacements + probe_place_deviation**2
            )
        # Rounded, so that arrivals at nearly the same speed share a sweep.
        load_frequency = float(f"{order * rotor_speed / RAD_PER_TURN:.9g}")
        displacements = (
            -probe_statistics.displacements if against else probe_statistics.displacements
        )
        return cls.from_arrays(
            "displacement",
            displacements.tolist(),
            displacement_deviations.tolist(),
            phase=(order * probe_statistics.arrival_rotor_angles % RAD_PER_TURN).tolist(),
            frequency=[load_frequency] * len(n_arrivals_of_probes),
            point=[point] * len(n_arrivals_of_probes),
        )

    @classmethod
    def from_passages(
        cls,
        passages: Sequence[PassageFit],
        modes: Sequence[int],
        *,
        quantity: str = "frequency_resonance",
    ) -> Measurements:
        """Take natural frequencies from the resonances in a run-up.

        Each frequency is at the rotor speed of the resonance, with the standard deviation
        :attr:`PassageFit.deviation`.

        Parameters
        ----------
        passages : sequence of PassageFit
            Resonances from :func:`find_passages`.
        modes : sequence of int
            Mode number of each resonance, from 1; 0 leaves the resonance out.
        quantity : str
            "frequency_resonance" of a blade as it is, or "frequency_uncracked" before it had a
            crack.

        Raises
        ------
        InputError
            The lengths differ, no resonance has a mode, or a value cannot be used.
        """
        if len(modes) != len(passages):
            raise InputError(
                "modes",
                list(modes),
                f"one mode for each of {len(passages)} passages, 0 to leave one out",
            )
        return cls(
            tuple(
                Measurement(
                    quantity,
                    passage_fit.frequency,
                    passage_fit.deviation / RAD_PER_TURN,
                    mode,
                    rpm=float(f"{passage_fit.speed / RAD_PER_S_PER_RPM:.7g}"),
                )
                for passage_fit, mode in zip(passages, modes, strict=True)
                if mode
            )
        )

    @classmethod
    def from_csv(cls, path: str | Path) -> Measurements:
        """Read a table of measurements from a CSV file.

        Columns are quantity, value, deviation (standard deviation), mode, frequency [Hz], point,
        phase [rad], rpm and temperature [°C], in any order; the first three are required. Cells
        that do not apply are empty; lines that begin with # are left out. Frequencies may be in kHz
        and phases in degrees [deg] as well. Commas, semicolons or tabs separate cells.

        Raises
        ------
        InputError
            The file cannot be read, or a line cannot be used.
        """
        return cls(tuple(_read_csv_measurements(path)))

    @classmethod
    def from_responses(
        cls, path: str | Path, modes: Sequence[int] = (), *, quantity: str = "frequency_resonance"
    ) -> Measurements:
        """Fit natural frequencies to the frequency responses of a universal file.

        All responses of one structure (datasets 58 and 58b) must have the same frequencies. They
        are fitted together around their peaks. The standard deviation of a natural frequency has
        two parts: the scatter about the fit, and the change if only the upper half of a peak is
        fitted.

        Parameters
        ----------
        path : str or Path
            Universal file (.uff, .unv).
        modes : sequence of int
            Mode numbers of the peaks, from the lowest frequency up. Default: 1, 2, ....
        quantity : str
            "frequency_resonance" of a plate as it is, or "frequency_uncracked" before it had a
            crack.

        Raises
        ------
        InputError
            The file cannot be read, has no peak, or has more or fewer peaks than ``modes``.
        """
        from fenics_crack.monitoring.identification.responses import fit_resonances, read_responses

        with report_read_errors("measurements", path, "a universal file with frequency responses"):
            responses = read_responses(Path(path))
        mode_rows = fit_resonances(responses)[
            : N_NATURAL_MODES_PER_CRACK_STATE if not modes else None
        ]
        mode_numbers = list(modes) or list(range(1, len(mode_rows) + 1))
        if len(mode_numbers) != len(mode_rows):
            frequencies_text = ", ".join(
                f"{mode_frequency:.6g}" for mode_frequency in mode_rows[:, 0]
            )
            allowed_text = (
                f"{format_count(len(mode_rows), 'number')}, for the modes found at "
                f"{frequencies_text} Hz"
            )
            raise InputError("modes", list(modes), allowed_text)
        frequencies, deviations, _ = mode_rows.T.tolist()
        return cls.from_arrays(quantity, frequencies, deviations, mode=mode_numbers)

    @classmethod
    @check_calls
    def read(cls, path: str | Path, modes: Sequence[int] = ()) -> Measurements:
        """Read measurements from a universal file or a table.

        Files that end in .uff or .unv are universal files (:meth:`from_responses`, with ``modes``);
        others are tables (:meth:`from_csv`).
        """
        is_universal_file = Path(path).suffix.lower() in UNIVERSAL_FILE_SUFFIXES
        return cls.from_responses(path, modes) if is_universal_file else cls.from_csv(path)

    def check(self, scene: Scene) -> None:
        """Raise InputError if a measurement does not fit a scene.

        The error is also raised if all measurements are natural frequencies without the crack.
        """
        if all(measurement.quantity == "frequency_uncracked" for measurement in self.rows):
            raise InputError(
                "measurements",
                "frequency_uncracked",
                "more than frequencies without the crack: add measurements of the plate as it is "
                "now",
            )
        for measurement in self.rows:
            measurement.check(scene)

    def __add__(self, other: Measurements) -> Measurements:
        return Measurements(self.rows + other.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the columns of a table by name, in the form that :meth:`from_csv` reads.

        A value that does not apply is an empty cell, "".
        """
        values_by_column = {
            measurement_field.name: [
                getattr(measurement, measurement_field.name) for measurement in self.rows
            ]
            for measurement_field in fields(Measurement)
        }
        values_by_column["mode"] = [mode or "" for mode in values_by_column["mode"]]
        for column_name in ("frequency", "phase", "rpm", "temperature"):
            values_by_column[column_name] = [
                "" if math.isnan(cell) else cell for cell in values_by_column[column_name]
            ]
        return values_by_column

    def _repr_text(self) -> str:
        n_natural = sum(measurement.is_natural_frequency for measurement in self.rows)
        return f"{n_natural} natural frequencies, {len(self) - n_natural} at loads"


def get_crack_removal_changes_or_none(scene: Scene) -> dict[str, Any] | None:
    """Return new values of scene keys that remove the crack, by key.

    Return None if the crack cannot be removed. This holds for a structure from matrices, for
    several cracks, and for mesh files without ``identify.uncracked``.
    """
    value_by_key: dict[str, Any] = dict.fromkeys(
        ("crack", "cracks", "contact", "output.quantities")
    )
    if scene.identify is not None and scene.identify.uncracked is not None:
        return value_by_key | {"mesh.file": scene.identify.uncracked}
    is_crack_removable = (
        scene.structure is None and scene.mesh.layout != "file" and len(scene.crack_by_name) == 1
    )
    return value_by_key if is_crack_removable else None


def _read_csv_measurements(path: str | Path) -> list[Measurement]:
    """Read the measurements in a CSV file.

    Raises
    ------
    InputError
        The file cannot be read, or a column, unit or line cannot be used.
    """
    with report_read_errors("measurements", path, "a CSV file"):
        (_, heading_cells), *numbered_table_rows = read_numbered_csv_rows(path) or [(0, [])]
    numbered_table_rows = numbered_table_rows[
        : IDENTIFICATION_VALUES.max_measurements + 1
    ]  # one row too many suffices for the error
    # Units of values and deviations depend on the quantity of the row.
    si_headings_and_factors = [
        (cell, 1.0)
        if cell.startswith(REQUIRED_MEASUREMENT_COLUMN_NAMES)
        else convert_heading_to_si(cell)
        for cell in heading_cells
    ]
    column_names = [cell.partition("[")[0].strip() for cell, _ in si_headings_and_factors]
    allowed_column_names = (*REQUIRED_MEASUREMENT_COLUMN_NAMES, *OPTIONAL_MEASUREMENT_COLUMN_NAMES)
    if not set(REQUIRED_MEASUREMENT_COLUMN_NAMES) <= set(column_names) <= set(
        allowed_column_names
    ) or len(set(column_names)) != len(column_names):
        allowed_text = (
            f"a CSV file with the columns {', '.join(allowed_column_names)}, "
            "of which the first three are required"
        )
        found_columns_text = (
            f"the columns {', '.join(heading_cells)}" if column_names else "no columns"
        )
        raise InputError("measurements", f"{path}: {found_columns_text}", allowed_text)
    for cell, column_name, (si_heading, _) in zip(
        heading_cells, column_names, si_headings_and_factors, strict=True
    ):
        heading_unit_text = si_heading.partition("[")[2].partition("]")[0].strip()
        if heading_unit_text and heading_unit_text not in (
            allowed_units := ALLOWED_UNITS_BY_COLUMN.get(column_name, ())
        ):
            allowed_text = f"in {' or '.join(allowed_units)}" if allowed_units else "without a unit"
            raise InputError("measurements", f"{path}: the column {cell}", allowed_text)
    factor_by_column = dict(
        zip(column_names, (factor for _, factor in si_headings_and_factors), strict=True)
    )
    measurements = []
    for line_number, cells in numbered_table_rows:
        try:
            measurements.append(
                _parse_measurement(dict(zip(column_names, cells, strict=True)), factor_by_column)
            )
        except InputError as error:
            allowed_text = f"{error.allowed} (line {line_number})"
            raise InputError(error.key, error.value, allowed_text) from None
        except ValueError:
            allowed_text = f"{len(column_names)} cells: {', '.join(column_names)}"
            raise InputError(
                f"measurements, line {line_number}", ",".join(cells), allowed_text
            ) from None
    return measurements


def _parse_measurement(
    cell_text_by_column: Mapping[str, str], factor_by_column: Mapping[str, float]
) -> Measurement:
    """Parse the measurement in a table's line.

    Parameters
    ----------
    cell_text_by_column : dict of str to str
        Cells of the line; empty cells are left out.
    factor_by_column : dict of str to float
        Factor to SI units for the numbers in each column.

    Raises
    ------
    InputError
        A cell cannot be used, or a required cell is missing.
    """
    value_by_column: dict[str, Any] = {
        column_name: cell for column_name, cell in cell_text_by_column.items() if cell
    }
    for column_name in [
        column_name for column_name in value_by_column if column_name not in ("quantity", "point")
    ]:
        with contextlib.suppress(ValueError):
            value_by_column[column_name] = factor_by_column[column_name] * float(
                value_by_column[column_name]
            )
        check_number(f"measurements.{column_name}", value_by_column[column_name])
    if value_by_column.get("mode", math.nan).is_integer():
        value_by_column["mode"] = int(value_by_column["mode"])
    for column_name in REQUIRED_MEASUREMENT_COLUMN_NAMES:
        if column_name not in value_by_column:
            raise InputError(f"measurements.{column_name}", "", "given in every line")
    return Measurement(**value_by_column)
