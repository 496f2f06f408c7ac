"""Growth of a crack under vibration, and the change in the vibration.

At each length a the vibration is periodic and settled, since a crack grows very little in a cycle.
With the effective ranges delta K_i of K_I and their ratios R_i, closing faces included,

    da/dN = C sum_i (delta K_i / (1 - R_i)^(1 - gamma))^m,      N = int da / (da/dN).

The sum is over the cycles of K_I in a cycle of the load; several occur if the crack opens several
times. C is in m per cycle at 1 MPa m^1/2 (Paris, Erdogan, Journal of Basic Engineering 85, 1963,
528; closure: Elber, ASTM STP 486, 1971, 230; R: Walker, ASTM STP 462, 1970, 1).

Few lengths are solved, with splines between them. Intervals are halved if a spline misses the
solutions that follow. Each round is a sweep: ranks share its cases, and a killed run continues.
For a half-ellipse in a solid, depths and lengths are solved (:mod:`fenics_crack.fatigue.ellipse`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import ConvergenceError, InputError, StoppedError
from fenics_crack.basics.observables import ObservableFlag, Place, observable_names
from fenics_crack.basics.ranks import StopRequest, on_root
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import (
    N_SELECTED_ROWS,
    RAD_PER_TURN,
    Conclusion,
    Table,
    add_frequency_entries,
    format_count,
    format_quantity,
    hertz_property,
)
from fenics_crack.errors.stated import STATED_CAUSES, estimate_solution_errors
from fenics_crack.fatigue.ellipse import (
    EQUIVALENT_RANGE_COLUMN_NAMES,
    EllipseSizePath,
    EllipseTable,
    GrowthEnd,
    integrate_ellipse_growth,
)
from fenics_crack.fem.build import with_crack_length
from fenics_crack.fem.solid import find_reaches_from_crack_middle
from fenics_crack.files.saved import SavedResult
from fenics_crack.numerics.equations import SMALLEST_NORMAL
from fenics_crack.runs.solve import solve
from fenics_crack.scene.result_tables import Growth as Law
from fenics_crack.scene.scene import Scene, reason_without_stress_intensity, refuse_for_reason
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.sweep.file import KEPT_MODE_NUMBERS
from fenics_crack.sweep.result import (
    SCENES_WITHOUT_PEAK_TEXT,
    SweepResult,
    can_seek_resonance,
    run_sweep,
)

# --- the result, and its file ---------------------------------------------------------------------

END_TEXT_BY_REASON: dict[GrowthEnd, str] = {
    "reached": "growth.until is reached",
    "arrested": "growth stops, since the effective range is below growth.threshold, or the "
    "crack does not open",
    "broken": "the structure breaks, since K_max reaches growth.toughness",
    "side": "growth is followed no further, since an end of the crack comes near to a side",
}
"""Descriptions of the end of growth, by the value of :attr:`Growth.end`.

The effective range is that of K_I while the crack tip is open.
"""


@dataclass(frozen=True, repr=False)
class Growth(SavedResult):
    """Result of :func:`grow`: crack length and vibration over load cycles.

    Attributes
    ----------
    scene : Scene
        Scene with the length of the crack at the beginning.
    length, cycles, time : (n,) [m], [-], [s]
        Crack length, the load cycles until then, and their duration; one row if the crack does not
        grow.
    omega, omega_open, omega_bilinear : (n,) [rad/s]
        Load frequency (cycles over duration for a spectrum), natural frequency with the crack open,
        and bilinear frequency. Both belong to the mode with the bilinear frequency nearest to the
        load at the first length; in a spectrum, to the load with most growth.
    response : (n,) [m]
        Half the peak-to-peak displacement of the load's point, in the load's direction.
    largest, smallest, effective, sliding : (n,) [Pa m^0.5]
        Largest K_I, smallest K_I, range of K_I while the crack tip is open, and largest K_II of
        either sign. In a solid they belong to the front station with the largest such range. For a
        spectrum, ``largest`` and ``effective`` are maxima over the loads; ``smallest`` and
        ``sliding`` belong to the load with most growth.
    rate : (n,) [m]
        Growth of the length in a load cycle, on average for a spectrum; 0 in the last row of an
        arrested crack.
    end : "reached", "arrested", "broken" or "side"
        Why growth ends, in this order: ``growth.until`` is reached; the effective range falls below
        the threshold, or the crack does not open; K_max reaches the toughness; the ends of a
        half-ellipse come near to the solid's sides.
    solved : (k,) [m]
        Solved lengths, or (k, 2) depths and lengths for a half-ellipse. Splines connect them.
    errors : dict of str to float
        Standard deviations of ln(cycles) by cause: "rate" and "exponent" of the growth law,
        "interpolation" between solved lengths, and "vibration". The last is m times the relative
        error of the range after half of the cycles, by mesh, modes and harmonics. For a spectrum
        the loads that this error puts below the threshold are added.
    remarks : tuple of str
        Doubts about the growth, as sentences.
    depth : (n,) [m] or None
        Depth of a half- or quarter-ellipse in a solid; None for other cracks.
    """

    scene: Scene
    length: np.ndarray
    cycles: np.ndarray
    time: np.ndarray
    omega: np.ndarray
    omega_open: np.ndarray
    omega_bilinear: np.ndarray
    response: np.ndarray
    largest: np.ndarray
    smallest: np.ndarray
    effective: np.ndarray
    sliding: np.ndarray
    rate: np.ndarray
    end: GrowthEnd
    solved: np.ndarray
    errors: dict[str, float]
    remarks: tuple[str, ...]
    depth: np.ndarray | None = None

    KIND: ClassVar[str] = "crack growth"
    frequency, frequency_open = hertz_property(), hertz_property("omega_open")
    frequency_bilinear = hertz_property("omega_bilinear")

    @property
    def life(self) -> float:
        """Return the load cycles from the first length to the last."""
        return float(self.cycles[-1])

    @property
    def factor(self) -> float:
        """Return the factor (> 1) within which the life is known, with 68 % probability.

        The factor is exp(sqrt(sum e_i^2)), with the standard deviations e_i of ln(cycles) in
        ``errors``. A normal distribution of ln(life) is assumed.
        """
        return math.exp(math.hypot(*self.errors.values()))

    @property
    def repeats(self) -> np.ndarray | None:
        """Return the number of passes through the spectrum until each row: (n,).

        Numbers may be fractions. None without ``growth.drive = "spectrum"``.
        """
        repeat_cycles_and_duration = self.scene.given("growth").repeat_cycles_and_duration
        return (
            None
            if repeat_cycles_and_duration is None
            else self.cycles / repeat_cycles_and_duration[0]
        )

    @property
    def frequency_drop(self) -> np.ndarray:
        """Return the relative decrease of the bilinear frequency since row 0: (n,)."""
        return np.asarray(1.0 - self.omega_bilinear / self.omega_bilinear[0])

    def at(self, cycles: float) -> float:
        """Return the crack length [m] after a number of load cycles.

        Rows are interpolated linearly. The length is nan for more cycles than :attr:`life`.
        """
        return float(np.interp(cycles, self.cycles, self.length, right=math.nan))

    def to_dict(self) -> dict[str, Any]:
        """Return the table's columns by name, with an entry for each length."""
        values_by_column = {
            "cycles": self.cycles,
            "time": self.time,
            "crack_length": self.length,
            **({} if self.depth is None else {"crack_depth": self.depth}),
            "rate": self.rate,
            "omega": self.omega,
            "omega_open": self.omega_open,
            "omega_bilinear": self.omega_bilinear,
            "frequency_drop": self.frequency_drop,
            "response": self.response,
            "K_max": self.largest,
            "K_min": self.smallest,
            "delta_K_effective": self.effective,
            "K_II_max": self.sliding,
        }
        if self.repeats is not None:
            values_by_column = {"repeats": self.repeats} | values_by_column
        return add_frequency_entries(
            {column_name: column.tolist() for column_name, column in values_by_column.items()}
        )

    def build_conclusion(self) -> Conclusion:
        """Return the parts of the sentence that closes the output of ``grow``."""
        start_size, end_size = (self._size_in_words(row_index) for row_index in (0, -1))
        if len(self.length) == 1:
            return Conclusion(f"the crack stays at {start_size}: {END_TEXT_BY_REASON[self.end]}")
        life_text = f"{self.life:.4g} cycles ({self.time[-1] / 3600.0:.4g} h)"
        growth_text = f"from {start_size} to {end_size} in {life_text}"
        if self.repeats is not None:
            growth_text += f", {self.repeats[-1]:.4g} repeats of the spectrum"
        cause_texts = [
            f"{cause_name} {relative_error:.2g}"
            for cause_name, relative_error in self.errors.items()
            if relative_error > 0.0
        ]
        certainty_text = (
            f"the life is known within a factor of {self.factor:.3g} with 68 % probability"
        )
        certainty_text += (
            f" (standard deviations of its logarithm: {', '.join(cause_texts)})"
            if cause_texts
            else ""
        )
        frequency_text = (
            f"the breathing crack's natural frequency falls by {self.frequency_drop[-1]:.2%}"
        )
        return Conclusion(
            f"the crack grows {growth_text}: {END_TEXT_BY_REASON[self.end]}",
            certainty_text,
            further_clauses=[frequency_text],
        )

    def _size_in_words(self, row_index: int) -> str:
        """Return a row's crack size as text: "12 mm" or "12 mm x 3 mm deep"."""
        length_text = format_quantity(float(self.length[row_index]), "m")
        if self.depth is None:
            return length_text
        return f"{length_text} x {format_quantity(float(self.depth[row_index]), 'm')} deep"

    def _repr_text(self) -> str:
        sizes_text = f"{self._size_in_words(0)} to {self._size_in_words(-1)}"
        frequency_text = f"frequency falls by {self.frequency_drop[-1]:.2%}"
        life_text = f"{self.life:.4g} cycles within a factor of {self.factor:.3g}"
        solved_text = f"{format_count(len(self.solved), 'size')} solved"
        return f"{sizes_text}, {life_text}, {self.end}, {frequency_text}, {solved_text}"


def report_of_growth(growth: Growth) -> Report:
    """Return the report of ``fenics-crack grow``: table, life and its uncertainty.

    The printed table has at most :data:`N_SELECTED_ROWS` rows, equally spaced; files have all rows.
    """
    growth_table, n_rows = growth.table(), len(growth.length)
    shown_row_indices = sorted(
        {*np.linspace(0, n_rows - 1, N_SELECTED_ROWS).round().astype(int).tolist()}
    )
    return Report(
        growth_table,
        growth.build_conclusion(),
        growth.scene,
        printed_table=Table(
            growth_table.columns, [growth_table.rows[row_index] for row_index in shown_row_indices]
        ),
        warnings=growth.remarks,
        remarks=remarks_on_scene(growth.scene),
    )


# --- the growth -----------------------------------------------------------------------------------

NOT_STABLE_TEXT = (
    "the vibration is unstable or irregular, or its stability is undecided: the growth there is "
    "doubtful; fenics-crack curve shows other vibrations"
)
"""End of a remark on lengths or shapes without a vibration known to be stable."""
UNKNOWN_VIBRATION_TEXT = (
    "the error of the vibration is unknown, and so is the uncertainty of the life"
)
"""Remark on a range of K_I without an error estimate."""
N_ELLIPSE_SIZES_PER_AXIS = 5
"""Number of solved depths, and of lengths, for a half-ellipse.

Neighbours have equal ratios. With five, the cycles are right to 0.8 % for the K of Newman and Raju;
in equal steps, to 6 % (tests/fatigue/test_ellipse.py).
"""
N_ELLIPSE_MODES = 20
"""Number of modes for a half-ellipse, if the scene has no ``[reduction]``.

The neglected modes change every K by 1e-4, relative.
"""
MAX_ELLIPSE_LENGTH_FRACTION = 0.9
"""Maximum length of a half-ellipse over the length between the solid's sides."""
GAUSS_LEGENDRE_NODES, GAUSS_LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Quadrature for dN/da in each step between lengths: three points in (-1, 1), and weights."""
MAX_ALLOWED_LOG_RANGE_ERROR = 0.05
"""Maximum error of ln delta K in an interval between solved lengths.

delta K is the range of K_I for the growth law. Intervals with larger errors are halved, even if few
cycles pass there, to find resonances inside.
"""
LOGARITHMIC_COLUMN_NAMES = ("driving", "K_max", "delta_K_effective", "response")
"""Columns with a spline of the logarithm, which is smooth through resonances.

"driving" is the constant range of K_I with the same growth as all loads.
"""
LINEAR_COLUMN_NAMES = ("omega", "omega_open", "omega_bilinear", "K_min", "K_II_max")
"""Columns with a spline of the values themselves."""
EMPTY_COLUMN_BY_NAME = dict.fromkeys((*LOGARITHMIC_COLUMN_NAMES, *LINEAR_COLUMN_NAMES), np.zeros(0))
"""Columns of a :class:`LengthPath` without lengths, by name: (0,) each."""
SWEEP_COLUMN_NAMES = (
    "K_max",
    "delta_K_effective",
    "delta_K_equivalent",
    "response",
    *LINEAR_COLUMN_NAMES,
)
"""Columns of a sweep over crack sizes from which growth is computed."""
COLUMN_NAME_BY_GROWTH_FIELD = {
    "omega": "omega", "omega_open": "omega_open", "omega_bilinear": "omega_bilinear",
    "response": "response", "largest": "K_max", "smallest": "K_min",
    "effective": "delta_K_effective", "sliding": "K_II_max",
}  # fmt: skip
"""Column of the solved lengths or shapes, by field of :class:`Growth`."""


def grow(
    scene: Scene,
    folder: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
) -> Growth:
    r"""Let the crack of a plate or solid grow under vibration (collective).

    The length grows from ``crack.length`` to ``growth.until``, by the table ``[growth]``, in N load
    cycles:

    .. math:: N = \int \frac{da}{C \sum_i (\Delta K_i / (1 - R_i)^{1 - \gamma})^m}.

    The sum is over the rainflow cycles of K_I in one period of the load. :math:`\Delta K_i` are
    the ranges while the crack tip is open, and :math:`R_i` the ratios of minimum to maximum.

    Few lengths are solved; between them ln delta K is a spline, refined until the cycles are known
    to ``growth.life_tolerance``. Ranks share the lengths. For a crack through a solid,
    :math:`\Delta K_i` is the largest along the front, and the front stays straight. A half-ellipse
    grows from ``crack.depth`` to ``growth.until`` by the range at its deepest point, and along the
    face by the mean range at its ends. Here 5 x 5 shapes are solved.

    Parameters
    ----------
    scene : Scene
        Scene with a table ``[growth]``: a plate with one crack from an edge, or a solid with one
        crack that goes through or is half or a quarter of an ellipse.
    folder : path, optional
        Folder for the solved sweeps, growth_1.h5 and so on. Existing files for the same scene are
        used, so that a killed run continues. Default: nothing is kept.
    comm : MPI.Comm
        Ranks that share the cases.
    progress : bool
        Show progress bars.

    Returns
    -------
    Growth
        Length, frequencies and stress intensities over the cycles, and the uncertainty of the life.

    Raises
    ------
    InputError
        The scene has no such crack or table, or ``growth.until`` is not above its crack's size.
    ConvergenceError
        One of the five first lengths, or a shape next to the growth, cannot be solved.
    StoppedError
        Ctrl-C was pressed.

    Examples
    --------
    >>> keys = {"until": 0.055, "rate": 1e-11, "exponent": 3.0}
    >>> growing = scene.replace({f"growth.{key}": value for key, value in keys.items()})
    >>> fc.grow(growing).life  # doctest: +SKIP
    """
    scene = _validate_growth_scene(with_crack_length(scene, comm))
    law, scene_without_sweep = scene.given("growth"), scene.replace({"curve": None, "sweep": None})
    folder_path = None if folder is None else Path(folder)
    if scene_without_sweep.given("crack").is_elliptical:
        return _grow_ellipse(scene_without_sweep, folder_path, comm, progress=progress)
    _make_scene_with_crack_size(
        scene_without_sweep, scene_without_sweep.excitation.omega, law.until
    )  # is refused before anything is solved
    length_path, interpolation_error, jump_lengths = _solve_lengths_to_tolerance(
        scene_without_sweep, folder_path, comm, progress=progress
    )
    lengths, cycles, end_reason = _integrate_cycles_to_end(length_path, law)
    half_life_length = float(np.interp(0.5 * cycles[-1], cycles, lengths))
    vibration_error, omission_remarks = on_root(
        comm,
        lambda: _estimate_range_error_and_remarks(
            scene_without_sweep, length_path, half_life_length
        ),
    )
    growth_rates = _compute_growth_rates(length_path, law, lengths)
    error_by_cause = _collect_life_error_by_cause(
        law, growth_rates, cycles, vibration_error, interpolation_error
    )
    error_by_cause["vibration"] += _estimate_life_error_by_threshold(
        length_path, law, lengths, cycles, vibration_error
    )
    values_by_column = {
        column_name: length_path.interpolate_column(column_name, lengths)
        for column_name in length_path.column_by_name
    }
    for column_name in LOGARITHMIC_COLUMN_NAMES:
        values_by_column[column_name][values_by_column[column_name] <= SMALLEST_NORMAL] = 0.0
    growth_rates[-1] *= end_reason != "arrested"
    elapsed_times = _accumulate_integral_over_cycles(
        RAD_PER_TURN / values_by_column["omega"], cycles
    )
    return Growth(
        scene,
        lengths,
        cycles,
        elapsed_times,
        rate=growth_rates,
        end=end_reason,
        solved=length_path.lengths,
        errors=error_by_cause,
        remarks=(
            *_collect_growth_remarks(
                scene,
                length_path,
                jump_lengths,
                values_by_column,
                lengths,
                vibration_error,
                end_reason,
            ),
            *omission_remarks,
        ),
        **_get_values_by_growth_field(values_by_column),
    )


def _get_values_by_growth_field(
    values_by_column: Mapping[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Rename columns to the field names of :class:`Growth`."""
    return {
        field_name: values_by_column[column_name]
        for field_name, column_name in COLUMN_NAME_BY_GROWTH_FIELD.items()
    }


def _accumulate_integral_over_cycles(values: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Integrate values over load cycles, by the trapezoidal rule.

    ``values`` and ``cycles`` have shape (n,). The integrals (n,) run from the first cycle to each;
    the first is 0.
    """
    return np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(cycles)))


def _collect_life_error_by_cause(
    law: Law,
    growth_rates: np.ndarray,
    cycles: np.ndarray,
    vibration_error: float,
    interpolation_error: float,
) -> dict[str, float]:
    """Return standard deviations of ln(life) by cause.

    Keys are "rate", "exponent", "vibration" and "interpolation", as in :attr:`Growth.errors`. Life
    is the number of load cycles until growth ends.

    Parameters
    ----------
    law : Growth
        Table ``[growth]`` with C, m and their standard deviations.
    growth_rates, cycles : (n,) [m], [-]
        Growth in a load cycle, and the cycles until then.
    vibration_error : float
        Relative error of the range of K_I.
    interpolation_error : float
        Relative error of the cycles.
    """
    log_driving_ranges = np.log(np.maximum(growth_rates, SMALLEST_NORMAL) / law.rate) / law.exponent
    mean_log_range = float(_accumulate_integral_over_cycles(log_driving_ranges, cycles)[-1]) / max(
        float(cycles[-1]), SMALLEST_NORMAL
    )
    return {
        "rate": law.rate_deviation,
        "exponent": law.exponent_deviation * abs(mean_log_range),
        "vibration": law.exponent * vibration_error,
        "interpolation": interpolation_error,
    }


def _validate_growth_scene(scene: Scene) -> Scene:
    """Return the scene itself if its crack can grow.

    Raises
    ------
    InputError
        A key does not allow growth, such as ``mesh.layout`` or ``growth.until``.
    """
    refuse_for_reason(reason_without_stress_intensity(scene), "command", "grow")
    law, crack = scene.given("growth"), scene.given("crack")
    if scene.mesh.layout != "graded":
        allowed_text = "'graded' with [growth], since each crack length needs a new mesh"
        raise InputError("mesh.layout", scene.mesh.layout, allowed_text)
    if crack.front == "straight":
        allowed_text = (
            "'elliptical' with [growth], since a rectangle changes its shape as it grows; or "
            "leave out crack.depth for a crack through the solid"
        )
        raise InputError("crack.front", crack.front, allowed_text)
    is_elliptical = crack.is_elliptical
    if scene.cracks:
        allowed_text = "left out with [growth]: only one crack can grow, the one of [crack]"
        raise InputError("cracks", format_count(len(scene.cracks), "table"), allowed_text)
    if crack.edge is None and crack.point is None and not is_elliptical:
        allowed_text = "left out with [growth]: give crack.edge, since only one tip can grow"
        raise InputError("crack.center", crack.center, allowed_text)
    if law.drive == "spectrum" and scene.excitation.order is not None:
        allowed_text = (
            "'frequency' with excitation.order, since the rotor speed sets the load frequency"
        )
        raise InputError("growth.drive", law.drive, allowed_text)
    if law.drive == "spectrum" and is_elliptical:
        allowed_text = (
            "'frequency' or 'resonance' with crack.front = 'elliptical': each shape is solved "
            "at one load frequency"
        )
        raise InputError("growth.drive", law.drive, allowed_text)
    if law.drive == "resonance" and not can_seek_resonance(scene):
        raise InputError(
            "growth.drive",
            law.drive,
            f"'frequency' {SCENES_WITHOUT_PEAK_TEXT}, where no resonance is sought",
        )
    size_key, limit_key = ("depth", "thickness") if is_elliptical else ("length", "width")
    allowed_text = "given with [growth]: the size of the crack [m] at which growth begins"
    start_size = crack.given(size_key, allowed_text)
    size_limit = getattr(scene.geometry, limit_key) or math.inf
    if not start_size < law.until < size_limit:
        allowed_text = (
            f"between crack.{size_key} = {start_size:g} m and geometry.{limit_key} = "
            f"{size_limit:g} m"
        )
        raise InputError("growth.until", law.until, allowed_text)
    return scene


def _grow_ellipse(
    scene: Scene, folder: Path | None, comm: MPI.Comm, *, progress: bool = False
) -> Growth:
    """Return the growth of a half- or quarter-ellipse (collective).

    ``scene`` has no curve and no sweep. ``folder`` keeps the sweep in growth_1.h5; None keeps
    nothing.
    """
    law, crack = scene.given("growth"), scene.given("crack")
    if scene.reduction is None:
        scene = scene.replace({"reduction.method": "massless", "reduction.modes": N_ELLIPSE_MODES})
    n_surface_ends = 1 if crack.edge else 2
    allowed_length = on_root(comm, lambda: _find_allowed_ellipse_length(scene))
    if allowed_length <= 0.0:
        allowed_text = "inside a face with [growth]: at an edge, one end of the crack is outside"
        raise InputError("crack.point", crack.point, allowed_text)
    if crack.given("length") >= allowed_length:
        allowed_text = f"below {allowed_length:g} m with [growth], to stay away from the sides"
        raise InputError("crack.length", crack.length, allowed_text)
    sizes_by_key = {
        "crack.depth": np.geomspace(crack.given("depth"), law.until, N_ELLIPSE_SIZES_PER_AXIS),
        "crack.length": np.geomspace(
            crack.given("length"), allowed_length, N_ELLIPSE_SIZES_PER_AXIS
        ),
    }
    sweep_path = None if folder is None else folder / "growth_1.h5"
    sweep_result = _sweep_crack_sizes(scene, sizes_by_key, sweep_path, comm, progress=progress)
    ellipse_table = _tabulate_ellipses(sweep_result)
    ellipse_path = integrate_ellipse_growth(ellipse_table, law, n_surface_ends)
    half_life_row_index = int(np.searchsorted(ellipse_path.cycles, 0.5 * ellipse_path.cycles[-1]))
    vibration_error, omission_remarks = on_root(
        comm,
        lambda: _estimate_ellipse_range_error_and_remarks(
            scene, ellipse_table, ellipse_path, half_life_row_index
        ),
    )
    interpolation_error = estimate_ellipse_life_error(
        ellipse_table, ellipse_path, law, n_surface_ends
    )
    error_by_cause = _collect_life_error_by_cause(
        law,
        ellipse_path.growth_per_cycle.sum(axis=1),
        ellipse_path.cycles,
        vibration_error,
        interpolation_error,
    )
    values_by_column = {
        column_name: ellipse_table.interpolate_column(
            column_name, ellipse_path.depth, ellipse_path.length_along_face
        )
        for column_name in ellipse_table.column_by_name
    }
    elapsed_times = _accumulate_integral_over_cycles(
        RAD_PER_TURN / values_by_column["omega"], ellipse_path.cycles
    )
    remark_texts = _collect_ellipse_remarks(
        sweep_result, ellipse_table, ellipse_path, values_by_column, law
    )
    remark_texts += [] if math.isfinite(vibration_error) else [UNKNOWN_VIBRATION_TEXT]
    depth_length_grid = np.stack(
        np.meshgrid(ellipse_table.depths, ellipse_table.lengths, indexing="ij"), axis=-1
    )
    return Growth(
        scene,
        ellipse_path.length_along_face,
        ellipse_path.cycles,
        elapsed_times,
        rate=ellipse_path.growth_per_cycle[:, 1],
        end=ellipse_path.end_reason,
        solved=depth_length_grid[sweep_result.converged],
        errors=error_by_cause,
        remarks=(*remark_texts, *omission_remarks),
        depth=ellipse_path.depth,
        **_get_values_by_growth_field(values_by_column),
    )


def _collect_ellipse_remarks(
    sweep_result: SweepResult,
    ellipse_table: EllipseTable,
    ellipse_path: EllipseSizePath,
    values_by_column: Mapping[str, np.ndarray],
    law: Law,
) -> list[str]:
    """Return the doubts about the growth of a half-ellipse, as sentences.

    They are about failed shapes, uncertain stability, a turning crack, and a passed resonance.

    Parameters
    ----------
    sweep_result : SweepResult
        Cases over depth and length, failed ones included.
    ellipse_table, ellipse_path : EllipseTable, EllipseSizePath
        Shapes in the sweep, and along the growth.
    values_by_column : dict of str to (n,)
        Columns along the growth.
    law : Growth
        Table ``[growth]``.

    Raises
    ------
    ConvergenceError
        A failed shape is next to the growth.
    """
    n_not_stable_shapes = int((sweep_result.not_stable & sweep_result.converged).sum())
    remark_texts = _list_failed_ellipse_remarks(sweep_result, ellipse_table, ellipse_path)
    remark_texts += (
        [f"at {format_count(n_not_stable_shapes, 'shape')} {NOT_STABLE_TEXT}"]
        if n_not_stable_shapes
        else []
    )
    remark_texts += _list_crack_turning_remarks(
        values_by_column["K_max"], values_by_column["K_II_max"], ellipse_path.length_along_face
    )
    is_above_resonance = values_by_column["omega"] > values_by_column["omega_bilinear"]
    has_passed_resonance = is_above_resonance != is_above_resonance[0]
    if law.drive == "frequency" and np.any(has_passed_resonance):
        remark_texts.append(
            "at a length of "
            f"{ellipse_path.length_along_face[np.argmax(has_passed_resonance)]:.4g} m the "
            "natural frequency passes the load frequency; the shapes are too few for this "
            "resonance, and the life is not known: use growth.drive = 'resonance'"
        )
    return remark_texts


def _find_allowed_ellipse_length(scene: Scene) -> float:
    """Find the largest length [m] to solve for a half- or quarter-ellipse.

    The length is 0.9 times the available length between the sides. Around ``crack.point`` the
    length is at most the first length times (until / first depth)^3.
    """
    crack = scene.given("crack")
    law = scene.given("growth")
    section_reaches = find_reaches_from_crack_middle(scene)
    available_length = max(section_reaches) if crack.edge else 2.0 * min(section_reaches)
    allowed_length = MAX_ELLIPSE_LENGTH_FRACTION * available_length
    if crack.point is None:
        return allowed_length
    return min(allowed_length, crack.given("length") * (law.until / crack.given("depth")) ** 3)


def estimate_ellipse_life_error(
    ellipse_table: EllipseTable, ellipse_path: EllipseSizePath, law: Law, n_surface_ends: int
) -> float:
    """Estimate the relative error of the cycles by interpolation between shapes.

    The error is a quarter of abs(ln(N_coarse / N)), with every second depth and length in N_coarse.
    The result is 0 if either number of cycles is 0.
    """
    coarse_life = integrate_ellipse_growth(
        ellipse_table.with_every_second_size(), law, n_surface_ends
    ).cycles[-1]
    return (
        abs(math.log(coarse_life / ellipse_path.cycles[-1])) / 4.0
        if coarse_life * ellipse_path.cycles[-1] > 0.0
        else 0.0
    )


def _tabulate_ellipses(sweep_result: SweepResult) -> EllipseTable:
    """Make the table of shapes from a sweep over depth and length.

    Values of failed shapes are interpolated by thin-plate splines, and at least 0.

    Raises
    ------
    ConvergenceError
        The first shape has failed, or fewer than :data:`N_ELLIPSE_SIZES_PER_AXIS` are solved.
    """
    from scipy.interpolate import RBFInterpolator  # takes a while, and is needed here alone

    depths, lengths = (np.array(axis.values) for axis in sweep_result.axes)
    is_solved = sweep_result.converged
    if not is_solved[0, 0] or is_solved.sum() < N_ELLIPSE_SIZES_PER_AXIS:
        case_index, failure_text = sweep_result.failed_indices_and_reasons[0]
        raise ConvergenceError(
            f"{_ellipse_in_words(sweep_result, case_index)} was not solved: {failure_text}"
        )
    bilinear_omega_of_modes = [
        sweep_result[f"omega_bilinear_{mode}"][0, 0] for mode in KEPT_MODE_NUMBERS
    ]
    nearest_mode_number = KEPT_MODE_NUMBERS[
        int(np.nanargmin(np.abs(bilinear_omega_of_modes - sweep_result["omega"][0, 0])))
    ]
    sweep_name_by_column = {
        f"omega_{crack_state}": f"omega_{crack_state}_{nearest_mode_number}"
        for crack_state in ("open", "bilinear")
    }
    column_names = (*SWEEP_COLUMN_NAMES, *observable_names(Place.ELLIPSE))
    column_by_name = {
        column_name: sweep_result[sweep_name_by_column.get(column_name, column_name)].copy()
        for column_name in column_names
    }
    column_by_name["response"] = np.nan_to_num(
        column_by_name["response"]
    )  # nan where nothing moves
    log_size_grid = np.stack(np.meshgrid(np.log(depths), np.log(lengths), indexing="ij"), axis=-1)
    for column in column_by_name.values() if sweep_result.failed_indices_and_reasons else ():
        failed_case_values = RBFInterpolator(log_size_grid[is_solved], column[is_solved])(
            log_size_grid[~is_solved]
        )
        column[~is_solved] = np.maximum(failed_case_values, 0.0)
    return EllipseTable(depths, lengths, column_by_name)


def _ellipse_in_words(sweep_result: SweepResult, case_index: tuple[int, ...]) -> str:
    """Describe a case of the sweep by its depth and length.

    ``case_index`` has the positions on both axes.
    """
    depth, length = (
        axis.values[size_index]
        for axis, size_index in zip(sweep_result.axes, case_index, strict=True)
    )
    return f"a crack of {depth:.4g} m depth and {length:.4g} m length"


def _list_failed_ellipse_remarks(
    sweep_result: SweepResult, ellipse_table: EllipseTable, ellipse_path: EllipseSizePath
) -> list[str]:
    """Return a remark on failed shapes, if all are far from the growth.

    The list is empty if no shape has failed.

    Raises
    ------
    ConvergenceError
        Growth passes between the next smaller and next larger sizes of a failed shape.
    """
    table_and_path_sizes = (
        (ellipse_table.depths, ellipse_path.depth),
        (ellipse_table.lengths, ellipse_path.length_along_face),
    )
    for case_index, failure_text in sweep_result.failed_indices_and_reasons:
        is_near_failed_case = np.full(len(ellipse_path.depth), fill_value=True)
        for size_index, (table_sizes, path_sizes) in zip(
            case_index, table_and_path_sizes, strict=True
        ):
            smaller_size = table_sizes[max(size_index - 1, 0)]
            larger_size = table_sizes[min(size_index + 1, N_ELLIPSE_SIZES_PER_AXIS - 1)]
            is_near_failed_case &= (smaller_size <= path_sizes) & (path_sizes <= larger_size)
        if np.any(is_near_failed_case):
            raise ConvergenceError(
                f"{_ellipse_in_words(sweep_result, case_index)} was not solved: {failure_text}"
            )
    if not sweep_result.failed_indices_and_reasons:
        return []
    case_index, failure_text = sweep_result.failed_indices_and_reasons[0]
    count_text = format_count(len(sweep_result.failed_indices_and_reasons), "shape")
    ellipse_text = _ellipse_in_words(sweep_result, case_index)
    return [
        f"{count_text} not solved, but away from the growth, such as {ellipse_text}: {failure_text}"
    ]


def _estimate_ellipse_range_error_and_remarks(
    scene: Scene, ellipse_table: EllipseTable, ellipse_path: EllipseSizePath, path_row_index: int
) -> tuple[float, list[str]]:
    """Estimate the error of the range of K_I for a growing half-ellipse.

    ``path_row_index`` is the size in ``ellipse_path``. The equivalent range at the deepest point or
    at the ends counts, whichever grow faster.

    Returns
    -------
    float
        Relative error by mesh, modes and harmonics; nan if unknown.
    list of str
        A remark on causes without an estimate; empty if all have one.
    """
    depth_and_length = (
        ellipse_path.depth[path_row_index : path_row_index + 1],
        ellipse_path.length_along_face[path_row_index : path_row_index + 1],
    )
    omega = float(ellipse_table.interpolate_column("omega", *depth_and_length)[0])
    resized_scene = _make_scene_with_crack_size(
        scene, omega, float(depth_and_length[1][0]), float(depth_and_length[0][0])
    )
    return _estimate_quantity_error_and_remarks(
        resized_scene,
        EQUIVALENT_RANGE_COLUMN_NAMES[int(ellipse_path.growth_per_cycle[path_row_index].argmax())],
    )


def _compute_growth_rates(length_path: LengthPath, law: Law, lengths: np.ndarray) -> np.ndarray:
    """Return da/dN [m] at lengths (n,) [m] of a straight crack.

    The rate is C delta K^m. delta K [MPa m^0.5] is the column "driving" of the solved lengths: the
    range of K_I with the growth of all loads (:func:`_reduce_load_levels_to_columns`).
    """
    driving_ranges_mpa = (
        length_path.interpolate_column("driving", lengths) / 1e6
    )  # MPa m^0.5, of which the rate is
    return np.asarray(law.rate * driving_ranges_mpa**law.exponent)


def _integrate_cycles_to_end(
    length_path: LengthPath, law: Law
) -> tuple[np.ndarray, np.ndarray, GrowthEnd]:
    """Integrate dN = da / (da/dN) over the solved lengths, until growth ends.

    Growth is arrested if the effective range (of K_I while the crack tip is open) is below the
    threshold, or the rate is 0. The structure is broken if K_max reaches the toughness.

    Returns
    -------
    lengths : (n,) [m]
        Up to 200 equally spaced lengths.
    cycles : (n,)
        Load cycles until each length.
    end_reason : str
        "reached", "arrested" or "broken".
    """
    lengths = np.linspace(length_path.lengths[0], length_path.lengths[-1], 200)
    is_arrested = length_path.interpolate_column("delta_K_effective", lengths) < law.threshold
    is_arrested |= _compute_growth_rates(length_path, law, lengths) == 0.0  # nothing opens it
    is_broken = length_path.interpolate_column("K_max", lengths) >= (law.toughness or math.inf)
    end_indices = np.flatnonzero(is_arrested | is_broken)
    end_reason: GrowthEnd = "reached"
    if len(end_indices):
        end_reason = "arrested" if is_arrested[end_indices[0]] else "broken"
        lengths = lengths[: int(end_indices[0]) + 1]
    half_steps = 0.5 * np.diff(lengths)[:, None]
    quadrature_lengths = lengths[:-1, None] + half_steps * (1.0 + GAUSS_LEGENDRE_NODES)
    cycles_per_step = np.sum(
        half_steps
        * GAUSS_LEGENDRE_WEIGHTS
        / _compute_growth_rates(length_path, law, quadrature_lengths.ravel()).reshape(
            quadrature_lengths.shape
        ),
        axis=1,
    )
    return lengths, np.append(0.0, np.cumsum(cycles_per_step)), end_reason


def _make_scene_with_crack_size(
    scene: Scene, omega: float, length: float, depth: float | None = None
) -> Scene:
    """Return the scene with another crack size, at a fixed load frequency.

    The requested quantities become the ranges of K_I from 0 with the same crack growth
    ("delta_K_equivalent").

    Parameters
    ----------
    scene : Scene
        Scene without curve and sweep.
    omega : float [rad/s]
        Load frequency, in place of an engine order.
    length, depth : float [m]
        Crack size; None as depth for a crack through the thickness.
    """
    value_by_key = {"crack.length": length, "excitation.omega": omega}
    quantity_names = observable_names(
        Place.TIPS if depth is None else Place.ELLIPSE,
        required_flags=ObservableFlag.REQUIRES_GROWTH_LAW,
    )
    depth_by_key = {} if depth is None else {"crack.depth": depth}
    return scene.replace(value_by_key | depth_by_key | {"output.quantities": quantity_names})


def _estimate_range_error_and_remarks(
    scene: Scene, length_path: LengthPath, length: float
) -> tuple[float, list[str]]:
    """Estimate the error of the equivalent range of K_I at a length.

    The equivalent range, from 0 once in a load period, gives the same crack growth. The length is
    in m. For a spectrum, the load with most growth at the nearest solved length counts.

    Returns
    -------
    float
        Relative error by mesh, modes and harmonics; nan if unknown.
    list of str
        A remark on causes without an estimate; empty if all have one.
    """
    omega = float(length_path.interpolate_column("omega", np.array([length]))[0])
    if scene.given("growth").drive == "spectrum":
        omega = float(length_path.leading_omega[np.abs(length_path.lengths - length).argmin()])
    return _estimate_quantity_error_and_remarks(
        _make_scene_with_crack_size(scene, omega, length), "delta_K_equivalent"
    )


def _estimate_quantity_error_and_remarks(
    scene: Scene, quantity_name: str
) -> tuple[float, list[str]]:
    """Solve a scene, and estimate the relative error of a quantity.

    The cause "friction" is left out.

    Returns
    -------
    float
        Relative error (:meth:`Verification.stated`); nan if unknown.
    list of str
        A remark on causes without an estimate; empty if all have one.
    """
    solved_run = solve(scene, MPI.COMM_SELF)
    cause_names = [cause_name for cause_name in STATED_CAUSES if cause_name != "friction"]
    is_at_peak = scene.given("growth").drive == "resonance"
    error_statement = estimate_solution_errors(
        solved_run, solved_run.result, is_peak=is_at_peak, causes=cause_names
    )
    omission_remarks = (
        [f"error of the vibration: {error_statement.omitted_causes_and_reasons_text}"]
        if error_statement.omitted_causes_and_reasons_text
        else []
    )
    return error_statement.stated(quantity_name)[0], omission_remarks


def _estimate_life_error_by_threshold(
    length_path: LengthPath, law: Law, lengths: np.ndarray, cycles: np.ndarray, range_error: float
) -> float:
    """Return the error of ln(life) by loads that fall below the threshold.

    If all ranges fall by the relative ``range_error`` e, the threshold acts like threshold / (1 -
    e). More loads of a spectrum are then left out, and the life rises. The rise of ln(life) is
    returned; 0 without a spectrum, without a threshold, or unless 0 < e < 1.
    """
    is_threshold_relevant = law.drive == "spectrum" and law.threshold and cycles[-1] > 0.0
    if not (is_threshold_relevant and 0.0 < range_error < 1.0):
        return 0.0
    law_with_raised_threshold = replace(law, threshold=law.threshold / (1.0 - range_error))
    path_with_raised_threshold = LengthPath(np.zeros(0), EMPTY_COLUMN_BY_NAME, ())
    for sweep_result in length_path.sweep_results:
        path_with_raised_threshold = path_with_raised_threshold.with_sweep(
            sweep_result, law_with_raised_threshold, _get_level_omega_and_cycles(law)[1]
        )
    middle_lengths = 0.5 * (lengths[1:] + lengths[:-1])
    driving_range_ratios = length_path.interpolate_column(
        "driving", middle_lengths
    ) / path_with_raised_threshold.interpolate_column("driving", middle_lengths)
    return math.log(float(np.average(driving_range_ratios**law.exponent, weights=np.diff(cycles))))


def _collect_growth_remarks(
    scene: Scene,
    length_path: LengthPath,
    jump_lengths: list[float],
    values_by_column: Mapping[str, np.ndarray],
    lengths: np.ndarray,
    vibration_error: float,
    end_reason: str,
) -> list[str]:
    """Return the doubts about a straight crack's growth, as sentences.

    Parameters
    ----------
    scene : Scene
        Scene with ``[growth]``.
    length_path : LengthPath
        Solved lengths.
    jump_lengths : list of float [m]
        Lengths at which splines of the range miss solutions (:func:`_solve_lengths_to_tolerance`).
    values_by_column, lengths : dict of str to (n,), (n,) [m]
        Columns and lengths along the growth.
    vibration_error : float
        Relative error of the range of K_I; nan if unknown.
    end_reason : str
        As in :attr:`Growth.end`.
    """
    remark_texts = _list_crack_turning_remarks(
        values_by_column["K_max"], values_by_column["K_II_max"], lengths
    )
    law = scene.given("growth")
    doubtful_length_lists = (length_path.not_stable_lengths, jump_lengths)
    not_stable_lengths, jump_lengths = (
        [
            doubtful_length
            for doubtful_length in doubtful_length_list
            if doubtful_length <= lengths[-1]
        ]
        for doubtful_length_list in doubtful_length_lists
    )
    if not_stable_lengths:
        count_text = format_count(len(not_stable_lengths), "length")
        remark_texts.append(f"at {count_text} {NOT_STABLE_TEXT}")
    if jump_lengths:
        remark_texts.append(
            f"near a length of {jump_lengths[0]:.4g} m the stress intensity jumps: several "
            "vibrations may be possible there, and growth uses the first one found; fenics-crack "
            "curve shows them"
        )
    remark_texts += [
        f"a crack of {doubtful_length:.4g} m was not solved: {failure_text}"
        for doubtful_length, failure_text in length_path.failed_lengths_and_reasons
    ]
    # A crack that is arrested on its way has been at its threshold, however well that is known.
    is_near_threshold = (
        np.abs(values_by_column["delta_K_effective"] - law.threshold)
        < vibration_error * law.threshold
    )
    if np.any(is_near_threshold) and (end_reason != "arrested" or len(lengths) == 1):
        remark_texts.append(
            f"at a length of {lengths[np.argmax(is_near_threshold)]:.4g} m the range differs from "
            f"growth.threshold by less than its error of {vibration_error:.1%}: "
            "the crack may grow there, or stop"
        )
    if not math.isfinite(vibration_error):
        remark_texts.append(UNKNOWN_VIBRATION_TEXT)
    return remark_texts


def _list_crack_turning_remarks(
    K_max: np.ndarray, K_II: np.ndarray, lengths: np.ndarray
) -> list[str]:
    """Return a remark if a crack would turn by more than 10 degrees.

    The kink angle is 2 arctan(2 K_II / (K_I + sqrt(K_I^2 + 8 K_II^2))). ``K_max`` and ``K_II`` (n,)
    are the largest K_I and K_II at the crack's ``lengths`` (n,) [m]. The list is empty for smaller
    angles.
    """
    K_I = np.maximum(K_max, SMALLEST_NORMAL)
    kink_angles = 2.0 * np.arctan(2.0 * K_II / (K_I + np.sqrt(K_I**2 + 8.0 * K_II**2)))
    if not np.any(is_turning := kink_angles > math.radians(10.0)):
        return []
    return [
        f"from a length of {lengths[np.argmax(is_turning)]:.4g} m on the growth is doubtful: the "
        f"straight crack would turn by up to {math.degrees(kink_angles.max()):.0f} degrees, since "
        f"K_II_max is up to {np.max(K_II / K_I):.0%} of K_max"
    ]


# --- numbers over the length ----------------------------------------------------------------------


@dataclass(frozen=True)
class LengthPath:
    """Solutions at crack lengths, with splines between them.

    Attributes
    ----------
    lengths : (k,) [m]
        Solved lengths in ascending order.
    column_by_name : dict of str to (k,)
        Columns :data:`LOGARITHMIC_COLUMN_NAMES` and :data:`LINEAR_COLUMN_NAMES`.
    sweep_results : tuple of SweepResult
        Sweeps with the solutions.
    leading_omega : (k,) [rad/s]
        Load frequency with most of the growth at each length.
    mode_number : int or None
        Number, from 1, of the mode with the natural frequencies in the columns. Its bilinear
        frequency is nearest to the leading load at the first length. None without lengths.
    """

    lengths: np.ndarray
    column_by_name: dict[str, np.ndarray]
    sweep_results: tuple[SweepResult, ...]
    leading_omega: np.ndarray = field(default_factory=lambda: np.zeros(0))
    mode_number: int | None = None

    @property
    def failed_lengths_and_reasons(self) -> list[tuple[float, str]]:
        """Return each length [m] that could not be solved, with the reason."""
        failure_text_by_length = {
            sweep_result.axes[0].values[case_index[0]]: failure_text
            for sweep_result in self.sweep_results
            for case_index, failure_text in sweep_result.failed_indices_and_reasons
        }
        return list(failure_text_by_length.items())

    @property
    def not_stable_lengths(self) -> list[float]:
        """Return lengths [m] with a vibration that is unstable, irregular or undecided."""
        not_stable_sweep_cases = (
            (sweep_result, case_index)
            for sweep_result in self.sweep_results
            for case_index in np.argwhere(sweep_result.not_stable & sweep_result.converged)
        )
        return list(
            dict.fromkeys(
                sweep_result.axes[0].values[case_index[0]]
                for sweep_result, case_index in not_stable_sweep_cases
            )
        )

    def interpolate_column(self, column_name: str, lengths: np.ndarray) -> np.ndarray:
        """Interpolate a column by a cubic spline at lengths (n,) [m].

        Lengths must lie between the first and last solved ones. For
        :data:`LOGARITHMIC_COLUMN_NAMES`, the spline goes through logarithms, with values of at
        least 1e-4 times the largest.
        """
        from scipy.interpolate import CubicSpline  # takes a while, and is needed here alone

        column = self.column_by_name[column_name]
        if column_name not in LOGARITHMIC_COLUMN_NAMES:
            return np.asarray(CubicSpline(self.lengths, column)(lengths))
        column_floor = 1e-4 * max(float(column.max()), SMALLEST_NORMAL)  # closed cracks
        column_spline = CubicSpline(self.lengths, np.log(np.maximum(column, column_floor)))
        return np.asarray(np.exp(column_spline(lengths)))

    def with_sweep(
        self, sweep_result: SweepResult, law: Law, level_cycles: np.ndarray
    ) -> LengthPath:
        """Return the path with the solved lengths of another sweep.

        A length counts if all loads of the spectrum are solved there.

        Parameters
        ----------
        sweep_result : SweepResult
            Sweep over the crack length, and the load frequency for a spectrum.
        law : Growth
            Table ``[growth]``.
        level_cycles : (levels,)
            Load cycles at each frequency of the spectrum; (1,) without a spectrum.
        """
        sweep_lengths = np.array(sweep_result.axes[0].values)
        is_solved = sweep_result.converged.reshape(len(sweep_lengths), -1).all(axis=1)

        def get_solved_level_values(column_name: str) -> np.ndarray:
            return sweep_result[column_name].reshape(len(sweep_lengths), -1)[is_solved]

        path_lengths = np.append(self.lengths, sweep_lengths[is_solved])
        sorted_length_indices = np.argsort(path_lengths)
        level_values_by_column = {
            column_name: get_solved_level_values(column_name) for column_name in SWEEP_COLUMN_NAMES
        }
        level_values_by_column["response"] = np.nan_to_num(
            level_values_by_column["response"]
        )  # nan where nothing moves
        new_column_by_name, new_leading_omega = _reduce_load_levels_to_columns(
            level_values_by_column, law, level_cycles
        )
        mode_number = self.mode_number  # that of the first length, whichever is nearest later on
        if mode_number is None and is_solved.any():
            bilinear_omega_of_modes = [
                get_solved_level_values(f"omega_bilinear_{candidate_mode_number}")[0, 0]
                for candidate_mode_number in KEPT_MODE_NUMBERS
            ]
            mode_number = KEPT_MODE_NUMBERS[
                int(np.nanargmin(np.abs(bilinear_omega_of_modes - new_leading_omega[0])))
            ]
        if mode_number is not None:
            for column_name in ("omega_open", "omega_bilinear"):
                new_column_by_name[column_name] = get_solved_level_values(
                    f"{column_name}_{mode_number}"
                )[:, 0]
        column_by_name = {
            column_name: np.append(column, new_column_by_name[column_name])[sorted_length_indices]
            for column_name, column in self.column_by_name.items()
        }
        return replace(
            self,
            lengths=path_lengths[sorted_length_indices],
            column_by_name=column_by_name,
            leading_omega=np.append(self.leading_omega, new_leading_omega)[sorted_length_indices],
            sweep_results=(*self.sweep_results, sweep_result),
            mode_number=mode_number,
        )


def _reduce_load_levels_to_columns(
    level_values_by_column: dict[str, np.ndarray], law: Law, level_cycles: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Reduce values at the loads of a spectrum to a column over lengths.

    The column "driving" is the range of constant amplitude with the same growth,

        (sum n_i delta K_i^m / sum n_i)^(1 / m),

    with n_i cycles at load i. delta K_i is the range of K_I from 0 with equal growth in a period.
    Loads with a range below the threshold while the crack tip is open are left out, if any load is
    above the threshold.

    Parameters
    ----------
    level_values_by_column : dict of str to (k, levels)
        Values at k lengths and each load, by column name.
    law : Growth
        Table ``[growth]`` with m and the threshold.
    level_cycles : (levels,)
        Cycles n_i.

    Returns
    -------
    dict of str to (k,)
        "K_max" and "delta_K_effective" are maxima; "omega" is the mean frequency. Other columns
        are from the load with most growth.
    (k,) [rad/s]
        Frequency of the load with most growth.
    """
    effective_ranges = level_values_by_column["delta_K_effective"]
    equivalent_ranges = level_values_by_column["delta_K_equivalent"]
    column_by_name = {
        column_name: level_values_by_column[column_name].max(axis=1)
        for column_name in ("K_max", "delta_K_effective")
    }
    min_growing_range = np.minimum(law.threshold, column_by_name["delta_K_effective"])[:, None]
    largest_equivalent_range = np.maximum(
        equivalent_ranges.max(axis=1, keepdims=True), SMALLEST_NORMAL
    )
    relative_growth = (effective_ranges >= min_growing_range) * (
        equivalent_ranges / largest_equivalent_range
    ) ** law.exponent
    growth_shares = level_cycles / level_cycles.sum() * relative_growth
    leading_level_index = growth_shares.argmax(axis=1)[:, None]
    leading_value_by_column = {
        column_name: np.take_along_axis(
            level_values_by_column[column_name], leading_level_index, axis=1
        )[:, 0]
        for column_name in level_values_by_column
    }
    leading_omega = leading_value_by_column["omega"]
    column_by_name["driving"] = largest_equivalent_range[:, 0] * growth_shares.sum(axis=1) ** (
        1.0 / law.exponent
    )
    column_by_name["omega"] = level_cycles.sum() / (
        level_cycles / level_values_by_column["omega"]
    ).sum(axis=1)
    return leading_value_by_column | column_by_name, leading_omega


def _solve_lengths_to_tolerance(
    scene: Scene, folder: Path | None, comm: MPI.Comm, *, progress: bool = False
) -> tuple[LengthPath, float, list[float]]:
    """Solve crack lengths until interpolation gives the cycles precisely (collective).

    The first round has five lengths from ``crack.length`` to ``growth.until``. Up to five further
    rounds halve intervals. They end when the error of the cycles is below ``growth.life_tolerance``
    and the error of ln delta K is at most :data:`MAX_ALLOWED_LOG_RANGE_ERROR` (0.05) everywhere.
    ``folder`` keeps the sweep of round n in growth_n.h5; None keeps nothing.

    Returns
    -------
    LengthPath
        Solved lengths.
    float
        Relative error of the cycles by interpolation.
    list of float
        Beginnings [m] of the intervals in which ln delta K still has a larger error, the steepest
        first.

    Raises
    ------
    ConvergenceError
        A length of the first round cannot be solved.
    StoppedError
        Ctrl-C was pressed.
    """
    law = scene.given("growth")
    first_length, last_length = scene.given("crack").length, law.until
    level_omega, level_cycles = _get_level_omega_and_cycles(law)
    # Five are the fewest of which a spline through every other one can be made.
    next_lengths = np.linspace(first_length, last_length, 5)
    life_error = np.inf
    interval_errors = np.zeros(0)
    length_path = LengthPath(np.zeros(0), EMPTY_COLUMN_BY_NAME, ())
    for round_number in range(1, 7):  # 129 lengths are as close as meshes are similar
        sweep_path = None if folder is None else folder / f"growth_{round_number}.h5"
        sizes_by_key = {"crack.length": next_lengths} | (
            {"excitation.omega": level_omega} if len(level_omega) else {}
        )
        sweep_result = _sweep_crack_sizes(scene, sizes_by_key, sweep_path, comm, progress=progress)
        previous_path = length_path
        length_path = length_path.with_sweep(sweep_result, law, level_cycles)
        if round_number == 1:
            if length_path.failed_lengths_and_reasons:
                failed_length, failure_text = length_path.failed_lengths_and_reasons[0]
                raise ConvergenceError(
                    f"a crack of {failed_length:.4g} m was not solved: {failure_text}"
                )
            coarse_column_by_name = {
                column_name: column[::2]
                for column_name, column in length_path.column_by_name.items()
            }
            previous_path = LengthPath(length_path.lengths[::2], coarse_column_by_name, ())
            interval_errors = np.zeros(len(length_path.lengths) // 2)
        interval_errors = _estimate_interval_log_range_errors(
            previous_path, length_path, interval_errors
        )
        integration_lengths, integration_cycles, _ = _integrate_cycles_to_end(length_path, law)
        interval_cycles = np.diff(
            np.interp(length_path.lengths, integration_lengths, integration_cycles)
        )
        interval_life_errors = (
            law.exponent
            * interval_errors
            * interval_cycles
            / max(float(interval_cycles.sum()), SMALLEST_NORMAL)
        )
        life_error = float(interval_life_errors.sum())
        has_large_life_error = (
            interval_life_errors > law.life_tolerance / len(interval_life_errors)
        ) & (life_error > law.life_tolerance)
        next_lengths = (0.5 * (length_path.lengths[1:] + length_path.lengths[:-1]))[
            has_large_life_error | (interval_errors > MAX_ALLOWED_LOG_RANGE_ERROR)
        ]
        next_lengths = next_lengths[
            ~np.isin(
                next_lengths,
                [failed_length for failed_length, _ in length_path.failed_lengths_and_reasons],
            )
        ]
        if not len(next_lengths):
            break
    indices_steepest_first = np.argsort(-interval_errors / np.diff(length_path.lengths))
    jump_lengths = length_path.lengths[:-1][
        indices_steepest_first[
            interval_errors[indices_steepest_first] > MAX_ALLOWED_LOG_RANGE_ERROR
        ]
    ]
    return length_path, life_error, jump_lengths.tolist()


def _get_level_omega_and_cycles(law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Return load frequencies (levels,) [rad/s] and cycles of a spectrum.

    A level is one load frequency of ``[growth]``. Without a spectrum: no frequencies (0,), and
    cycles (1,) of 1.
    """
    if law.frequencies is None:
        return np.zeros(0), np.ones(1)
    return RAD_PER_TURN * np.array(law.frequencies), np.array(law.cycles)


def _sweep_crack_sizes(
    scene: Scene,
    values_by_key: dict[str, np.ndarray],
    sweep_path: Path | None,
    comm: MPI.Comm,
    *,
    progress: bool = False,
) -> SweepResult:
    """Solve a scene at crack sizes and at the loads of a spectrum (collective).

    Parameters
    ----------
    values_by_key : dict of str to array
        Values for the axes of the sweep: "crack.length", "crack.depth", "excitation.omega".
    sweep_path : path or None
        File of the sweep, which is continued if it exists; None keeps nothing.

    Raises
    ------
    StoppedError
        Ctrl-C was pressed.
    """
    is_at_resonance = scene.given("growth").drive == "resonance"
    value_list_by_key = {
        sweep_key: swept_sizes.tolist() for sweep_key, swept_sizes in values_by_key.items()
    }
    sweep_value_by_key = {"sweep.over": value_list_by_key, "sweep.at_resonance": is_at_resonance}
    observable_places = (
        (Place.TIPS, Place.ELLIPSE) if "crack.depth" in values_by_key else (Place.TIPS,)
    )
    quantity_names = observable_names(
        *observable_places, excluded_flags=ObservableFlag.REQUIRES_SOLID
    )
    with StopRequest() as stop_request:
        sweep_result = run_sweep(
            scene.replace({**sweep_value_by_key, "output.quantities": quantity_names}),
            sweep_path, comm, progress=progress, judged=False,
        )  # fmt: skip
    if stop_request.is_requested(comm):
        raise StoppedError("growth was stopped; run the same command again to continue it")
    return sweep_result


def _estimate_interval_log_range_errors(
    previous_path: LengthPath, length_path: LengthPath, previous_errors: np.ndarray
) -> np.ndarray:
    """Return errors of the spline of ln delta K between lengths: (k - 1,).

    In new intervals the error is a quarter of the larger difference between both splines at the
    ends. In other intervals it is the previous error or, if larger, the difference between both
    splines in the middle. A resonance inside an interval shows around the interval, too.

    Parameters
    ----------
    previous_path, length_path : LengthPath
        Solved lengths before and after the last sweep.
    previous_errors : (j - 1,)
        Errors between the j lengths of the previous path.
    """

    def compute_log_range_difference(lengths: np.ndarray) -> np.ndarray:
        driving_range, previous_driving_range = (
            compared_path.interpolate_column("driving", lengths)
            for compared_path in (length_path, previous_path)
        )
        return np.abs(np.log(driving_range / previous_driving_range))

    # Halved, a spline's error falls by 16, and here by 4 at least.
    end_errors = compute_log_range_difference(length_path.lengths) / 4.0
    is_new_length = ~np.isin(length_path.lengths, previous_path.lengths)
    middle_lengths = 0.5 * (length_path.lengths[1:] + length_path.lengths[:-1])
    inherited_errors = previous_errors[np.searchsorted(previous_path.lengths, middle_lengths) - 1]
    kept_interval_errors = np.maximum(
        inherited_errors, compute_log_range_difference(middle_lengths)
    )
    return np.where(
        is_new_length[1:] | is_new_length[:-1],
        np.maximum(end_errors[1:], end_errors[:-1]),
        kept_interval_errors,
    )
