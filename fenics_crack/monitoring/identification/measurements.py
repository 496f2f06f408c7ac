"""Measurements of a cracked plate: frequencies and harmonics with standard deviations."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.basics.errors import (
    N_LOWEST_MODES,
    InputError,
    check_choice,
    check_count,
    check_number,
    report_read_errors,
)
from fenics_crack.basics.suggestions import check_calls, fit_argument
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN, Tabular, format_count
from fenics_crack.basics.untrusted_files import convert_heading_to_si, read_csv_rows
from fenics_crack.monitoring.identification.options import OPTIONS
from fenics_crack.scene.fields import (
    MAX_ALLOWED_MAGNITUDE,
    MIN_ALLOWED_MAGNITUDE,
    ZERO_OR_MAGNITUDE_TEXT,
)
from fenics_crack.scene.scene import Scene

if TYPE_CHECKING:
    from fenics_crack.arrivals.passages import PassageFit  # SciPy

FREQUENCY_STATES = ("open", "tied", "bilinear", "resonance", "uncracked")
"""States of a plate with natural frequencies: its crack held open, held closed, breathing by the
bilinear formula, breathing at a measured resonance; and before it had a crack."""
AT_LOADS = ("harmonic_1", "harmonic_2", "harmonic_3", "ratio_2_1", "ratio_3_1", "displacement")
"""Quantities of a point under a harmonic load."""
NEEDED = ("quantity", "value", "deviation")
OPTIONAL = ("mode", "frequency", "point", "phase", "rpm", "temperature")
SI = "Hz", "m", "-"
HEADING_UNITS = {
    "frequency": SI[:1],
    "phase": ("rad",),
    "value": SI,
    "deviation": SI,
    "temperature": ("K", "°C", "C"),
    "rpm": ("rpm",),
}
"""Units that headings may name, in brackets, or others that are converted to these."""
UNIVERSAL = (".uff", ".unv")
"""Endings of universal files."""


@dataclass(frozen=True)
class Measurement:
    """One measured number.

    Attributes
    ----------
    quantity : str
        A natural frequency of mode ``mode`` [Hz]: "frequency_open", "frequency_tied",
        "frequency_bilinear" by its formula, "frequency_resonance", at which the breathing crack
        resonates, which is near that formula, or
        "frequency_uncracked" of the same plate before it had a crack, which calibrates the others
        of its mode. Or, as in :class:`Indicators`, "harmonic_1" to "harmonic_3" [m],
        "ratio_2_1" or "ratio_3_1", of a point under the scene's load at ``frequency``. Or a
        "displacement" [m] of the point at ``phase``, as probes see it: all those of a point at a
        frequency are compared up to the load's size, its phase, and a constant.
    value, deviation : float
        The number, and its standard deviation > 0, in the same unit.
    mode : int
        From 1; 0 where there is none.
    frequency : float [Hz]
        Of the load; nan where there is none.
    point : str
        A point and direction of ``[output.points]``, "tip.ux"; empty: the load's point in the
        load's direction.
    phase : float [rad]
        Of the load's period, 0 where it begins, 2 pi where it ends; nan where there is none.
    rpm : float [1/min]
        Of the rotor, where a natural frequency was measured, 0 at rest; nan: the scene's own.
    temperature : float [K or °C]
        Of the structure when a natural frequency was measured, in one unit in all of them: their
        differences enter; nan where it is not known.

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
        kinds = (*(f"frequency_{state}" for state in FREQUENCY_STATES), *AT_LOADS)
        check_choice("measurements.quantity", self.quantity, kinds)
        at_probe = self.quantity == "displacement"
        check_number("measurements.value", self.value, -math.inf if at_probe else 0.0)
        check_number("measurements.deviation", self.deviation, 0.0, excludes_bound=True)
        if self.natural:
            if not (isinstance(self.mode, Integral) and 1 <= self.mode <= N_LOWEST_MODES):
                allowed = f"a whole number from 1 to {N_LOWEST_MODES} with {self.quantity}"
                raise InputError("measurements.mode", self.mode, allowed)
        else:
            check_number("measurements.frequency", self.frequency, 0.0, excludes_bound=True)
        if at_probe:
            check_number("measurements.phase", self.phase)
            if abs(self.phase) > 2.0 * RAD_PER_TURN:  # a period that may begin elsewhere
                allowed = f"of a period, 0 to 2 pi; in degrees? then {math.radians(self.phase):.5g}"
                raise InputError("measurements.phase", self.phase, allowed)
        if not math.isnan(self.rpm):
            check_number("measurements.rpm", self.rpm, 0.0)
        if not math.isnan(self.temperature):
            check_number("measurements.temperature", self.temperature)
        of_mode = ("mode", "rpm", "temperature")
        needed = of_mode if self.natural else ("frequency", "point", *["phase"] * at_probe)
        for key in OPTIONAL:
            given = getattr(self, key)
            if key not in needed and given and not (isinstance(given, float) and math.isnan(given)):
                raise InputError(f"measurements.{key}", given, f"left out with {self.quantity}")
        for key in ("value", "deviation", "frequency", "phase", "rpm", "temperature"):
            number = getattr(self, key)
            if not (
                math.isnan(number)
                or number == 0.0
                or MIN_ALLOWED_MAGNITUDE <= abs(number) <= MAX_ALLOWED_MAGNITUDE
            ):
                raise InputError(
                    f"measurements.{key}", number, f"a number {ZERO_OR_MAGNITUDE_TEXT}"
                )

    @property
    def natural(self) -> bool:
        """True if it is a natural frequency."""
        return self.quantity.startswith("frequency_")

    @property
    def resonance(self) -> bool:
        """True if it is a natural frequency with the crack in its state at resonance."""
        return self.quantity == "frequency_resonance"

    @property
    def shape(self) -> bool:
        """True if it depends on the shape of a motion, not on its size."""
        return not self.natural and not self.quantity.startswith("harmonic")

    @property
    def orders(self) -> tuple[int, ...]:
        """Orders of its harmonics, of a ratio the numerator first; none of a natural frequency, and
        of a displacement, which has all."""
        return () if self.natural else tuple(map(int, self.quantity.split("_")[1:]))

    @property
    def name(self) -> str:
        """Name in words: "frequency_open of mode 2", "ratio_2_1 at 250 Hz of tip.ux"."""
        if self.natural:
            speed = "" if math.isnan(self.rpm) else f" at {self.rpm:g} rpm"
            return f"{self.quantity} of mode {self.mode}{speed}"
        where = f" of {self.point}" if self.point else ""
        when = "" if math.isnan(self.phase) else f" and {self.phase:.3g} rad"
        return f"{self.quantity} at {self.frequency:g} Hz{when}{where}"

    def load(self, scene: Scene) -> float:
        """The load of a scene under which it was measured [Hz]: its own, or that at the rotor's
        speed; 0 of a natural frequency at the scene's own speed."""
        if not self.natural:
            return float(self.frequency)
        if math.isnan(self.rpm):
            return 0.0
        own = scene.excitation.omega / RAD_PER_TURN
        # At rest the load of a thousandth of the speed, which adds a millionth of its stiffening.
        found = max(scene.excitation.given("order") * self.rpm / 60.0, 1e-3 * own)
        return 0.0 if f"{found:.9g}" == f"{own:.9g}" else float(f"{found:.9g}")

    def check(self, scene: Scene) -> None:
        """Raise InputError unless it is one of a scene."""
        if not math.isnan(self.rpm) and (scene.excitation.order is None or scene.speed == 0.0):
            allowed = "left out unless the load is an engine order (excitation.order) of [rotation]"
            raise InputError("measurements.rpm", self.rpm, allowed)
        known = scene.point_names
        if self.point and self.point not in known:
            allowed = f"empty, or one of [output.points]: {', '.join(known) or 'there are none'}"
            raise InputError("measurements.point", self.point, allowed)
        if self.quantity == "frequency_uncracked" and without_crack(scene) is None:
            allowed = "left out where the crack cannot be taken out of the scene"
            raise InputError("measurements.quantity", self.quantity, allowed)
        least, harmonics = max(self.orders, default=0), scene.harmonic_balance.harmonics
        if harmonics < least:
            allowed = f"at least {least} for {self.quantity}"
            raise InputError("harmonic_balance.harmonics", harmonics, allowed)


@dataclass(frozen=True, repr=False)
class Measurements(Tabular):
    """Measured numbers of one crack.

    Attributes
    ----------
    rows : tuple of Measurement
        At least one, and 1000 at most.
    """

    rows: tuple[Measurement, ...]

    def __post_init__(self) -> None:
        fit_argument("measurements", self.rows, "Iterable", ())
        object.__setattr__(self, "rows", tuple(self.rows))
        if not self.rows or not all(isinstance(row, Measurement) for row in self.rows):
            raise InputError("measurements", list(self.rows), "one Measurement or more")
        if len(self.rows) > OPTIONS.most_measurements:
            most = f"{OPTIONS.most_measurements} at most"
            allowed = f"{most}; several of one quantity are one, their mean"
            raise InputError("measurements", f"{len(self.rows)} rows", allowed)
        names = Counter(row.name for row in self.rows if row.quantity != "displacement")
        if twice := [name for name, count in names.items() if count > 1]:
            found = [row.value for row in self.rows if row.name == twice[0]]
            allowed = "one value, the mean, with the standard deviation of that"
            raise InputError(f"measurements, {twice[0]}", found, allowed)

    @classmethod
    def from_arrays(
        cls, quantity: str, values: Sequence[float], deviations: Any, **where: Sequence[Any]
    ) -> Measurements:
        """Numbers of one quantity: values (n,), their standard deviations (n,) or one for all, and
        ``mode`` and ``rpm``, or ``frequency`` and ``point``, (n,) each.

        Raises
        ------
        InputError
            A value cannot be used, or the lengths differ.
        """
        fit_argument("values", values, "Iterable", ())
        count = len(values)
        columns = {"value": values, **where}
        several = isinstance(deviations, Iterable)
        columns["deviation"] = deviations if several else [deviations] * count
        for name, column in columns.items():
            if name not in {item.name for item in fields(Measurement)} or len(column) != count:
                raise InputError(name, column, f"{count} values of {', '.join(OPTIONAL)}")
        rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
        return cls(tuple(Measurement(quantity, **row) for row in rows))

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
        """Mean displacements at the probes, of a vibration of an engine order.

        At the rotor's angle alpha of an arrival, where the blade tip is displaced by u
        (:class:`ArrivalTimes`), the load is at the phase p alpha of its period. No harmonic is
        fitted: they are left to the model. The means are those of :func:`fit_order`, in which
        single wrong arrivals have no weight, without vibrations that follow no order.

        Parameters
        ----------
        arrivals : ArrivalTimes
            Of steady vibration.
        order : int
            p, periods of the load in a revolution (:func:`fit_order` finds it).
        point : str
            The blade tip: as ``point`` of :class:`Measurement`.
        against : bool
            True if the direction of the point is against the rotation.
        noise : float [s]
            Standard deviation of an arrival; default: from the scatter between revolutions and its
            correlation, with a larger error from few revolutions.
        angle_deviation : float [rad]
            Standard deviation of the probes' angles, the same in every revolution.

        Raises
        ------
        InputError
            A value cannot be used, the speed is not constant, arrivals are not where the probes
            are, there are fewer than four, or ``noise`` is left out where passages have no scatter,
            or too few for an estimate, as in one revolution alone.
        """
        from fenics_crack.arrivals.fit_order import Means  # SciPy
        from fenics_crack.arrivals.robust import student

        check_count("order", order, 1)
        if noise is not None:
            check_number("noise", noise, 0.0, excludes_bound=True)
        if not arrivals.steady:
            raise InputError("arrivals", repr(arrivals), "those of a constant speed")
        arrivals.check_places(angle_deviation)
        count = np.isfinite(arrivals.time).sum(axis=0)
        count, speed = count[count > 0], arrivals.mean_speed
        if len(count) < 4:  # one more than the load's size and phase, and a constant
            raise InputError("arrivals", repr(arrivals), "those of 4 probes or more")
        means = Means(arrivals, 1, float(order), angle_deviation)
        places = arrivals.tip_radius * angle_deviation
        if noise is not None:
            own = speed * noise / np.sqrt(count)
            deviations = arrivals.tip_radius * np.hypot(own, angle_deviation)
        elif means.scatter <= arrivals.rounding:
            raise InputError("noise", None, "given where passages have no scatter")
        elif np.isnan(larger := student(means.within)):
            found = format_count(int(count.sum()), "arrival")
            allowed = (
                f"given for {found} at {format_count(len(count), 'probe')}, too few to estimate it"
            )
            raise InputError("noise", None, allowed)
        else:
            own = np.diag(means.covariance) - places**2
            deviations = np.sqrt(larger * own + places**2)
        # Rounded, for one sweep to serve all arrivals at a speed.
        frequency = float(f"{order * speed / RAD_PER_TURN:.9g}")
        values = -means.values if against else means.values
        where: dict[str, Any] = {"phase": (order * means.angle % RAD_PER_TURN).tolist()}
        where |= {"frequency": [frequency] * len(count), "point": [point] * len(count)}
        return cls.from_arrays("displacement", values.tolist(), deviations.tolist(), **where)

    @classmethod
    def from_passages(
        cls,
        passages: Sequence[PassageFit],
        modes: Sequence[int],
        *,
        quantity: str = "frequency_resonance",
    ) -> Measurements:
        """Natural frequencies of resonances that a rotor passes, at the speed of each, with their
        :attr:`PassageFit.deviation`.

        Parameters
        ----------
        passages : sequence of PassageFit
            As :func:`find_passages` finds them.
        modes : sequence of int
            Mode of each, from 1; 0 leaves it out.
        quantity : str
            "frequency_resonance" of a blade as it is, or "frequency_uncracked" before it had a
            crack.

        Raises
        ------
        InputError
            The lengths differ, none is left, or a value cannot be used.
        """
        if len(modes) != len(passages):
            raise InputError("modes", list(modes), f"one of each of {len(passages)} passages")
        used = [one for one in zip(passages, modes, strict=True) if one[1]]
        values = [fit.frequency for fit, _ in used]
        deviations = [fit.deviation / RAD_PER_TURN for fit, _ in used]
        rpm = [float(f"{fit.speed / RAD_PER_S_PER_RPM:.7g}") for fit, _ in used]
        where: dict[str, Any] = {"mode": [mode for _, mode in used], "rpm": rpm}
        return cls.from_arrays(quantity, values, deviations, **where)

    @classmethod
    def from_csv(cls, path: str | Path) -> Measurements:
        """Read a table with the columns quantity, value, deviation, mode, frequency [Hz], point,
        phase [rad], rpm and temperature [°C], in any order; cells that do not apply are empty, and
        lines that begin with # are left out. Frequencies may be in kHz and phases in degrees [deg]
        as well; cells are separated by commas, semicolons or tabs.

        Raises
        ------
        InputError
            The file cannot be read, or a line cannot be used.
        """
        return cls(tuple(_table(path)))

    @classmethod
    def from_responses(
        cls, path: str | Path, modes: Sequence[int] = (), *, quantity: str = "frequency_resonance"
    ) -> Measurements:
        """Natural frequencies from the frequency responses of a universal file.

        Datasets 58 and 58b of one structure at the same frequencies (.uff, .unv), over the force or
        another excitation; fitted around their peaks, all together. The standard deviation includes
        the scatter, and the change of the fit where less of a peak is fitted.

        Parameters
        ----------
        path : str or Path
            The file.
        modes : sequence of int
            Numbers of its modes, from the lowest frequency up. Default: 1, 2, ....
        quantity : str
            "frequency_resonance" of a plate as it is, or "frequency_uncracked" before it had a
            crack.

        Raises
        ------
        InputError
            The file cannot be read or has no modes, or another number of them.
        """
        from fenics_crack.monitoring.identification.responses import read_responses, resonances

        with report_read_errors("measurements", path, "a universal file with frequency responses"):
            responses = read_responses(Path(path))
        found = resonances(responses)[: N_LOWEST_MODES if not modes else None]
        numbers = list(modes) or list(range(1, len(found) + 1))
        if len(numbers) != len(found):
            shown = ", ".join(f"{one:.6g}" for one in found[:, 0])
            allowed = f"{format_count(len(found), 'number')}, of the modes at {shown} Hz"
            raise InputError("modes", list(modes), allowed)
        values, deviations = found[:, 0].tolist(), found[:, 1].tolist()
        return cls.from_arrays(quantity, values, deviations, mode=numbers)

    @classmethod
    @check_calls
    def read(cls, path: str | Path, modes: Sequence[int] = ()) -> Measurements:
        """Read a universal file (.uff, .unv; :meth:`from_responses`) or a table
        (:meth:`from_csv`)."""
        universal = Path(path).suffix.lower() in UNIVERSAL
        return cls.from_responses(path, modes) if universal else cls.from_csv(path)

    def check(self, scene: Scene) -> None:
        """Raise InputError for measurements that are none of a scene, or all from before its
        crack."""
        if all(row.quantity == "frequency_uncracked" for row in self.rows):
            raise InputError("measurements", "frequency_uncracked", "also some of the plate as is")
        for row in self.rows:
            row.check(scene)

    def __add__(self, other: Measurements) -> Measurements:
        return Measurements(self.rows + other.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Columns, as :meth:`from_csv` reads them."""
        names = [item.name for item in fields(Measurement)]
        found = {name: [getattr(row, name) for row in self.rows] for name in names}
        found["mode"] = [mode or "" for mode in found["mode"]]
        for name in ("frequency", "phase", "rpm", "temperature"):
            found[name] = ["" if math.isnan(one) else one for one in found[name]]
        return found

    def _title(self) -> str:
        natural = sum(row.natural for row in self.rows)
        return f"{natural} natural frequencies, {len(self) - natural} at loads"


def without_crack(scene: Scene) -> dict[str, Any] | None:
    """Return changes of a scene that remove its crack; None where that is impossible."""
    changes: dict[str, Any] = dict.fromkeys(("crack", "cracks", "contact", "output.quantities"))
    if scene.identify is not None and scene.identify.uncracked is not None:
        return changes | {"mesh.file": scene.identify.uncracked}
    own = scene.structure is None and scene.mesh.layout != "file" and len(scene.all_cracks) == 1
    return changes if own else None


def _table(path: str | Path) -> list[Measurement]:
    """Measurements of a CSV file; raises InputError."""
    with report_read_errors("measurements", path, "a CSV file"):
        (_, headings), *table = read_csv_rows(path) or [(0, [])]
    table = table[: OPTIONS.most_measurements + 1]  # enough to be too many
    # Those of a value depend on the quantity.
    scaled = [
        (cell, 1.0) if cell.startswith(NEEDED) else convert_heading_to_si(cell) for cell in headings
    ]
    names = [cell.partition("[")[0].strip() for cell, _ in scaled]
    known = (*NEEDED, *OPTIONAL)
    if not set(NEEDED) <= set(names) <= set(known) or len(set(names)) != len(names):
        allowed = f"a CSV file with the columns {', '.join(known)}, the first three of them needed"
        has = f"the columns {', '.join(headings)}" if names else "nothing"
        raise InputError("measurements", f"{path}: {has}", allowed)
    for cell, name, (in_si, _) in zip(headings, names, scaled, strict=True):
        unit = in_si.partition("[")[2].partition("]")[0].strip()
        if unit and unit not in (units := HEADING_UNITS.get(name, ())):
            allowed = f"in {' or '.join(units)}" if units else "without a unit"
            raise InputError("measurements", f"{path}: the column {cell}", allowed)
    factors, found = {n: factor for n, (_, factor) in zip(names, scaled, strict=True)}, []
    for number, cells in table:
        try:
            found.append(_row(dict(zip(names, cells, strict=True)), factors))
        except InputError as error:
            allowed = f"{error.allowed} (line {number})"
            raise InputError(error.key, error.value, allowed) from None
        except ValueError:
            allowed = f"{len(names)} cells: {', '.join(names)}"
            raise InputError(f"measurements, line {number}", ",".join(cells), allowed) from None
    return found


def _row(cells: Mapping[str, str], factors: Mapping[str, float]) -> Measurement:
    """Measurement of a line of the table, whose columns have factors; raises InputError."""
    given: dict[str, Any] = {name: text for name, text in cells.items() if text}
    for name in [name for name in given if name not in ("quantity", "point")]:
        with contextlib.suppress(ValueError):
            given[name] = factors[name] * float(given[name])
        check_number(f"measurements.{name}", given[name])
    if given.get("mode", math.nan).is_integer():
        given["mode"] = int(given["mode"])
    for name in NEEDED:
        if name not in given:
            raise InputError(f"measurements.{name}", "", "given in every line")
    return Measurement(**given)
