"""Growth of a crack under vibration, and the change in the vibration.

At each length a the vibration is periodic and settled, since a crack grows very little in a cycle.
With the effective ranges delta K_i of K_I and their ratios R_i, closing faces included,

    da/dN = C sum_i (delta K_i / (1 - R_i)^(1 - gamma))^m,      N = int da / (da/dN).

The sum is over the cycles of K_I in a cycle of the load; several occur if the crack opens several
times. C is in m per cycle at 1 MPa m^1/2 (Paris, Erdogan, Journal of Basic Engineering 85, 1963,
528; closure: Elber, ASTM STP 486, 1971, 230; R: Walker, ASTM STP 462, 1970, 1).

Few lengths of a straight crack are solved (:mod:`fenics_crack.fatigue.lengths`). For a half-ellipse
in a solid, depths and lengths are solved (:mod:`fenics_crack.fatigue.ellipse`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.causes import ERROR_CAUSES_IF_REDUCED
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import ObservableTableFlag, Place, observable_names
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import (
    N_PRINTED_ROWS_OF_LONG_RESULT,
    RAD_PER_TURN,
    Conclusion,
    Report,
    Table,
    add_frequency_entries,
    format_count,
    format_quantity,
    hertz_property,
)
from fenics_crack.errors.stated import estimate_solution_errors
from fenics_crack.fatigue.ellipse import (
    EQUIVALENT_RANGE_COLUMN_NAMES,
    N_ELLIPSE_SIZES_PER_AXIS,
    EllipseSizePath,
    EllipseTable,
    estimate_ellipse_life_error,
    integrate_ellipse_growth,
    list_failed_ellipse_remarks,
    tabulate_ellipses,
)
from fenics_crack.fatigue.lengths import (
    LOG_INTERPOLATED_COLUMN_NAMES,
    VALUE_INTERPOLATED_COLUMN_NAMES,
    GrowthEnd,
    LengthPath,
    list_failed_lengths_and_reasons,
    solve_lengths_to_tolerance,
    sweep_crack_sizes,
)
from fenics_crack.fem.build import with_crack_length
from fenics_crack.fem.solid import find_reaches_from_crack_middle, find_section_ahead
from fenics_crack.files.store import SavableResult
from fenics_crack.numerics.equations import SMALLEST_NORMAL
from fenics_crack.runs.solve import solve
from fenics_crack.scene.result_tables import Growth as Law
from fenics_crack.scene.scene import Scene, reason_without_stress_intensity, refuse_for_reason
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.sweep.result import (
    SCENES_WITHOUT_PEAK_DESCRIPTION,
    SweepResult,
    can_seek_resonance,
)

# --- the result, and its file ---------------------------------------------------------------------

TEXT_BY_GROWTH_END: dict[GrowthEnd, str] = {
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
class Growth(SavableResult):
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
        either sign. In a solid all belong to the front station with the largest range of K_I. For a
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
        "interpolation" between solved lengths, and "vibration". "vibration" is the exponent m times
        the relative error of the range of K_I after half of the cycles; causes of this error are
        mesh, modes and harmonics. For a spectrum, this error may also move loads below the
        threshold; the change of ln(cycles) is then added.
    remarks : tuple of str
        Doubts about the growth, as sentences.
    depth : (n,) [m] or None
        Depth of a half- or quarter-ellipse in a solid; None for other cracks.
    left_out : tuple of str
        Causes of error that are not among ``errors``, such as "mesh" and "friction".
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
    left_out: tuple[str, ...] = ()

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
        """Return columns by name, with an entry for each crack length.

        The result's table and files show the same columns.
        """
        repeat_counts = self.repeats
        values_by_column = {
            **({} if repeat_counts is None else {"repeats": repeat_counts}),
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
        return add_frequency_entries(
            {column_name: column.tolist() for column_name, column in values_by_column.items()}
        )

    def build_conclusion(self) -> Conclusion:
        """Return the parts of the sentence that closes the output of ``grow``."""
        start_size, end_size = (self._size_in_words(row_index) for row_index in (0, -1))
        if len(self.length) == 1:
            return Conclusion(f"the crack stays at {start_size}: {TEXT_BY_GROWTH_END[self.end]}")
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
        if cause_texts:
            certainty_text += f" (standard deviations of its logarithm: {', '.join(cause_texts)})"
        if self.left_out:
            certainty_text += f", which leaves out the errors due to {' and '.join(self.left_out)}"
        return Conclusion(
            f"the crack grows {growth_text}: {TEXT_BY_GROWTH_END[self.end]}",
            certainty_text,
            further_clauses=[
                f"the breathing crack's natural frequency falls by {self.frequency_drop[-1]:.2%}"
            ],
        )

    def _size_in_words(self, row_index: int) -> str:
        """Return a row's crack size as text: "12 mm" or "12 mm x 3 mm deep"."""
        length_text = format_quantity(float(self.length[row_index]), "m")
        if self.depth is None:
            return length_text
        return f"{length_text} x {format_quantity(float(self.depth[row_index]), 'm')} deep"

    def _repr_text(self) -> str:
        sizes_text = f"{self._size_in_words(0)} to {self._size_in_words(-1)}"
        frequency_drop_text = f"frequency falls by {self.frequency_drop[-1]:.2%}"
        life_text = f"{self.life:.4g} cycles within a factor of {self.factor:.3g}"
        solved_text = f"{format_count(len(self.solved), 'size')} solved"
        return f"{sizes_text}, {life_text}, {self.end}, {frequency_drop_text}, {solved_text}"


def report_of_growth(growth: Growth) -> Report:
    """Return the report of ``fenics-crack grow``: table, life and its uncertainty.

    The printed table has at most :data:`N_PRINTED_ROWS_OF_LONG_RESULT` rows, equally spaced; files
    have all rows.
    """
    growth_result_table, n_rows = growth.table(), len(growth.length)
    shown_row_indices = sorted(
        {*np.linspace(0, n_rows - 1, N_PRINTED_ROWS_OF_LONG_RESULT).round().astype(int).tolist()}
    )
    return Report(
        growth_result_table,
        growth.build_conclusion(),
        growth.scene,
        printed_table=Table(
            growth_result_table.columns,
            [growth_result_table.rows[row_index] for row_index in shown_row_indices],
        ),
        warnings=growth.remarks,
        remarks=remarks_on_scene(growth.scene),
    )


# --- the growth -----------------------------------------------------------------------------------

NOT_STABLE_REMARK_END = (
    "the vibration is unstable or irregular, or its stability is undecided: the growth there is "
    "doubtful; fenics-crack curve shows other vibrations"
)
"""End of a remark on lengths or shapes without a vibration known to be stable."""
UNKNOWN_K_ERROR_REMARK = (
    "the error of the vibration is unknown, and so is the uncertainty of the life"
)
"""Remark on a range of K_I without an error estimate."""
N_ELLIPSE_MODES = 20
"""Number of modes for a half-ellipse, if the scene has no ``[reduction]``.

The neglected modes change every K by 1e-4, relative.
"""
MAX_ELLIPSE_LENGTH_OVER_AVAILABLE = 0.9
"""Maximum length of a half-ellipse over the length between the solid's sides."""
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
    )  # raises errors for the largest crack before anything is solved
    length_path, interpolation_error, intensity_jump_lengths = solve_lengths_to_tolerance(
        scene_without_sweep, folder_path, comm, progress=progress
    )
    lengths, cycles, end_reason = length_path.integrate_cycles_to_end()
    half_life_length = float(np.interp(0.5 * cycles[-1], cycles, lengths))
    load_omega = length_path.find_load_omega(half_life_length)
    stress_intensity_range_error, missing_error_remarks, left_out = on_root(
        comm,
        lambda: _estimate_range_error_and_remarks(
            scene_without_sweep, "delta_K_equivalent", load_omega, half_life_length
        ),
    )
    growth_rates = length_path.compute_growth_rates(lengths)
    error_by_cause = _collect_life_error_by_cause(
        law, growth_rates, cycles, stress_intensity_range_error, interpolation_error
    )
    error_by_cause["vibration"] += length_path.estimate_life_error_by_threshold(
        lengths, cycles, stress_intensity_range_error
    )
    values_by_column = {
        column_name: length_path.interpolate_column(column_name, lengths)
        for column_name in (*LOG_INTERPOLATED_COLUMN_NAMES, *VALUE_INTERPOLATED_COLUMN_NAMES)
    }
    for column_name in LOG_INTERPOLATED_COLUMN_NAMES:
        values_by_column[column_name][values_by_column[column_name] <= SMALLEST_NORMAL] = 0.0
    growth_rates[-1] *= end_reason != "arrested"
    growth_remarks = _collect_growth_remarks(
        length_path,
        intensity_jump_lengths,
        values_by_column,
        lengths,
        stress_intensity_range_error,
        end_reason,
    )
    return Growth(
        scene,
        lengths,
        rate=growth_rates,
        end=end_reason,
        solved=length_path.lengths,
        errors=error_by_cause,
        remarks=(*growth_remarks, *missing_error_remarks),
        left_out=left_out,
        **_get_values_by_growth_field(values_by_column, cycles),
    )


def _get_values_by_growth_field(
    values_by_column: Mapping[str, np.ndarray], cycles: np.ndarray
) -> dict[str, Any]:
    """Return fields of :class:`Growth` by name: cycles, time, frequencies and stress intensities.

    Parameters
    ----------
    values_by_column : dict of str to (n,)
        Values at n crack lengths, by name of the sweep's column.
    cycles : (n,)
        Load cycles until each crack length.
    """
    from scipy.integrate import cumulative_trapezoid  # takes a while, and is needed here alone

    values_by_field = {
        field_name: values_by_column[column_name]
        for field_name, column_name in COLUMN_NAME_BY_GROWTH_FIELD.items()
    }
    elapsed_times = cumulative_trapezoid(RAD_PER_TURN / values_by_field["omega"], cycles, initial=0)
    return values_by_field | {"cycles": cycles, "time": elapsed_times}


def _collect_life_error_by_cause(
    law: Law,
    growth_rates: np.ndarray,
    cycles: np.ndarray,
    stress_intensity_range_error: float,
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
        Growth in a load cycle at each crack length, and load cycles until this length.
    stress_intensity_range_error : float
        Relative error of the range of K_I.
    interpolation_error : float
        Relative error of the cycles.
    """
    from scipy.integrate import trapezoid  # takes a while, and is needed here alone

    log_driving_ranges = np.log(np.maximum(growth_rates, SMALLEST_NORMAL) / law.rate) / law.exponent
    mean_log_range = trapezoid(log_driving_ranges, cycles) / max(cycles[-1], SMALLEST_NORMAL)
    return {
        "rate": law.rate_deviation,
        "exponent": law.exponent_deviation * abs(float(mean_log_range)),
        "vibration": law.exponent * stress_intensity_range_error,
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
    scene.mesh.require(
        scene.mesh.layout == "graded",
        "layout",
        "'graded' with [growth], since each crack length needs a new mesh",
    )
    crack.require(
        crack.front != "straight",
        "front",
        "'elliptical' with [growth], since a rectangle changes its shape as it grows; or "
        "leave out crack.depth for a crack through the solid",
    )
    if scene.cracks:
        raise InputError(
            "cracks",
            format_count(len(scene.cracks), "table"),
            "left out with [growth]: only one crack can grow, the one of [crack]",
        )
    crack.require(
        crack.edge is not None or crack.point is not None or crack.is_elliptical,
        "center",
        "left out with [growth]: give crack.edge, since only one tip can grow",
    )
    law.require(
        law.drive != "spectrum" or scene.excitation.order is None,
        "drive",
        "'frequency' with excitation.order, since the rotor speed sets the load frequency",
    )
    law.require(
        law.drive != "spectrum" or not crack.is_elliptical,
        "drive",
        "'frequency' or 'resonance' with crack.front = 'elliptical': each shape is solved "
        "at one load frequency",
    )
    law.require(
        law.drive != "resonance" or can_seek_resonance(scene),
        "drive",
        f"'frequency' {SCENES_WITHOUT_PEAK_DESCRIPTION}, where no resonance is sought",
    )
    size_key, limit_key = ("depth", "thickness") if crack.is_elliptical else ("length", "width")
    start_size = crack.given(
        size_key, "given with [growth]: the size of the crack [m] at which growth begins"
    )
    size_limit = getattr(scene.geometry, limit_key) or math.inf
    law.require(
        start_size < law.until < size_limit,
        "until",
        f"between crack.{size_key} = {start_size:g} m and geometry.{limit_key} = {size_limit:g} m",
    )
    return scene


def _grow_ellipse(
    scene: Scene, folder: Path | None, comm: MPI.Comm, *, progress: bool = False
) -> Growth:
    """Return the growth of a half- or quarter-ellipse (collective).

    ``scene`` has no tables ``[curve]`` and ``[sweep]``. The solved shapes are stored in
    ``folder``/growth_1.h5; nothing is stored if ``folder`` is None.
    """
    law, crack = scene.given("growth"), scene.given("crack")
    if scene.reduction is None:
        scene = scene.replace({"reduction.method": "massless", "reduction.modes": N_ELLIPSE_MODES})
    n_surface_ends = 1 if crack.edge else 2
    if scene.geometry.file is not None:
        section = on_root(comm, lambda: find_section_ahead(scene))
        law.require(
            law.until < section,
            "until",
            f"below {section:.4g} m, the section straight ahead of the crack: growth ends there",
        )
    allowed_length = on_root(comm, lambda: _find_allowed_ellipse_length(scene))
    crack.require(
        allowed_length > 0.0,
        "point",
        "inside a face with [growth]: at an edge, one end of the crack is outside",
    )
    crack.require(
        crack.given("length") < allowed_length,
        "length",
        f"below {allowed_length:g} m with [growth], to stay away from the sides",
    )
    sizes_by_key = {
        "crack.depth": np.geomspace(crack.given("depth"), law.until, N_ELLIPSE_SIZES_PER_AXIS),
        "crack.length": np.geomspace(
            crack.given("length"), allowed_length, N_ELLIPSE_SIZES_PER_AXIS
        ),
    }
    sweep_result = sweep_crack_sizes(scene, sizes_by_key, folder, comm, progress=progress)
    ellipse_table = tabulate_ellipses(sweep_result)
    ellipse_path = integrate_ellipse_growth(ellipse_table, law, n_surface_ends)
    cycles = ellipse_path.cycles
    values_by_column = {
        column_name: ellipse_table.interpolate_column(
            column_name, ellipse_path.depth, ellipse_path.length_along_face
        )
        for column_name in ellipse_table.column_by_name
    }
    half_life_index = int(np.searchsorted(cycles, 0.5 * cycles[-1]))
    fastest_direction = int(ellipse_path.growth_per_cycle[half_life_index].argmax())
    stress_intensity_range_error, missing_error_remarks, left_out = on_root(
        comm,
        lambda: _estimate_range_error_and_remarks(
            scene,
            EQUIVALENT_RANGE_COLUMN_NAMES[fastest_direction],
            float(values_by_column["omega"][half_life_index]),
            float(ellipse_path.length_along_face[half_life_index]),
            float(ellipse_path.depth[half_life_index]),
        ),
    )
    interpolation_error = estimate_ellipse_life_error(
        ellipse_table, ellipse_path, law, n_surface_ends
    )
    error_by_cause = _collect_life_error_by_cause(
        law,
        ellipse_path.growth_per_cycle.sum(axis=1),
        cycles,
        stress_intensity_range_error,
        interpolation_error,
    )
    remark_texts = _collect_ellipse_remarks(
        sweep_result, ellipse_table, ellipse_path, values_by_column, law
    )
    remark_texts += [] if math.isfinite(stress_intensity_range_error) else [UNKNOWN_K_ERROR_REMARK]
    depth_length_grid = np.stack(
        np.meshgrid(ellipse_table.depths, ellipse_table.lengths, indexing="ij"), axis=-1
    )
    return Growth(
        scene,
        ellipse_path.length_along_face,
        rate=ellipse_path.growth_per_cycle[:, 1],
        end=ellipse_path.end_reason,
        solved=depth_length_grid[sweep_result.converged],
        errors=error_by_cause,
        remarks=(*remark_texts, *missing_error_remarks),
        left_out=left_out,
        depth=ellipse_path.depth,
        **_get_values_by_growth_field(values_by_column, cycles),
    )


def _collect_ellipse_remarks(
    sweep_result: SweepResult,
    ellipse_table: EllipseTable,
    ellipse_path: EllipseSizePath,
    values_by_column: Mapping[str, np.ndarray],
    law: Law,
) -> list[str]:
    """Return the doubts about the growth of a half-ellipse, as sentences.

    Subjects are failed shapes, vibrations not known to be stable, a turning crack, and a natural
    frequency crossing the load frequency.

    Parameters
    ----------
    sweep_result : SweepResult
        Cases over depth and length, failed ones included.
    ellipse_table, ellipse_path : EllipseTable, EllipseSizePath
        Shapes of the sweep, and n shapes along the growth.
    values_by_column : dict of str to (n,)
        Values at the n shapes along the growth, by name of the sweep's column.
    law : Growth
        Table ``[growth]``.

    Raises
    ------
    ConvergenceError
        Growth comes near to a failed shape.
    """
    n_not_stable_shapes = int((sweep_result.not_stable & sweep_result.converged).sum())
    remark_texts = list_failed_ellipse_remarks(sweep_result, ellipse_table, ellipse_path)
    remark_texts += (
        [f"at {format_count(n_not_stable_shapes, 'shape')} {NOT_STABLE_REMARK_END}"]
        if n_not_stable_shapes
        else []
    )
    remark_texts += _list_crack_turning_remarks(
        values_by_column["K_II_ratio"], ellipse_path.length_along_face
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

    The length is 0.9 times the available length between the sides. For a crack at ``crack.point``,
    the length is also at most the first length times (``growth.until`` / first depth)^3.
    """
    crack, law = scene.given("crack"), scene.given("growth")
    distances_to_section_ends = find_reaches_from_crack_middle(scene)
    available_length = (
        max(distances_to_section_ends) if crack.edge else 2.0 * min(distances_to_section_ends)
    )
    allowed_length = MAX_ELLIPSE_LENGTH_OVER_AVAILABLE * available_length
    if crack.point is None:
        return allowed_length
    return min(allowed_length, crack.given("length") * (law.until / crack.given("depth")) ** 3)


def _make_scene_with_crack_size(
    scene: Scene, omega: float, length: float, depth: float | None = None
) -> Scene:
    """Return the scene with another crack size, at a fixed load frequency.

    The scene's output quantities become equivalent ranges of K_I ("delta_K_equivalent"). Such a
    range begins at 0, and causes the same growth as all cycles of K_I in a load period.

    Parameters
    ----------
    scene : Scene
        Scene without curve and sweep.
    omega : float [rad/s]
        Load frequency, in place of an engine order.
    length, depth : float [m]
        Crack size; None as depth for a crack through the thickness.
    """
    quantity_names = observable_names(
        Place.MOST_LOADED_TIP if depth is None else Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS,
        required_flags=ObservableTableFlag.REQUIRES_GROWTH_LAW,
    )
    return scene.replace(
        {
            "crack.length": length,
            "excitation.omega": omega,
            **({} if depth is None else {"crack.depth": depth}),
            "output.quantities": quantity_names,
        }
    )


def _estimate_range_error_and_remarks(
    scene: Scene, quantity_name: str, omega: float, length: float, depth: float | None = None
) -> tuple[float, list[str], tuple[str, ...]]:
    """Solve a crack size, and estimate the relative error of a range of K_I.

    Errors by friction and by further parameters are not estimated.

    Parameters
    ----------
    scene : Scene
        Scene without curve and sweep.
    quantity_name : str
        Name of an equivalent range of K_I. It begins at 0, and causes the same growth as all cycles
        of K_I in a load period.
    omega : float [rad/s]
        Load frequency.
    length, depth : float [m]
        Crack size; None as depth for a crack through the thickness.

    Returns
    -------
    float
        Relative error (:meth:`Verification.stated`); nan if unknown.
    list of str
        A remark on causes without an estimate; empty if all have one.
    tuple of str
        The causes without an estimate, and friction if the scene has none.
    """
    solved_run = solve(_make_scene_with_crack_size(scene, omega, length, depth), MPI.COMM_SELF)
    is_at_peak = scene.given("growth").drive == "resonance"
    error_statement = estimate_solution_errors(
        solved_run, solved_run.result, is_peak=is_at_peak, causes=ERROR_CAUSES_IF_REDUCED
    )
    missing_error_remarks = (
        [f"error of the vibration: {error_statement.omitted_causes_and_reasons_text}"]
        if error_statement.omitted_causes_and_reasons_text
        else []
    )
    left_out = tuple(f"the {cause}" for cause in error_statement.unknown)
    left_out += () if scene.has_friction else ("friction",)
    return error_statement.stated(quantity_name)[0], missing_error_remarks, left_out


def _collect_growth_remarks(
    length_path: LengthPath,
    intensity_jump_lengths: list[float],
    values_by_column: Mapping[str, np.ndarray],
    lengths: np.ndarray,
    stress_intensity_range_error: float,
    end_reason: str,
) -> list[str]:
    """Return the doubts about a straight crack's growth, as sentences.

    Parameters
    ----------
    length_path : LengthPath
        Solved lengths.
    intensity_jump_lengths : list of float [m]
        Lengths near a jump of K_I, so a spline through the solved lengths is not accurate
        (:func:`solve_lengths_to_tolerance`).
    values_by_column, lengths : dict of str to (n,), (n,) [m]
        Values at n lengths along the growth, by name of the sweep's column; and the n lengths.
    stress_intensity_range_error : float
        Relative error of the range of K_I; nan if unknown.
    end_reason : str
        Why growth ends: "reached", "arrested" or "broken".
    """
    remark_texts = _list_crack_turning_remarks(values_by_column["K_II_ratio"], lengths)
    law = length_path.law
    not_stable_lengths, intensity_jump_lengths = (
        [doubtful_length for doubtful_length in doubtful_lengths if doubtful_length <= lengths[-1]]
        for doubtful_lengths in (length_path.not_stable_lengths, intensity_jump_lengths)
    )
    if not_stable_lengths:
        count_text = format_count(len(not_stable_lengths), "length")
        remark_texts.append(f"at {count_text} {NOT_STABLE_REMARK_END}")
    if intensity_jump_lengths:
        remark_texts.append(
            f"near a length of {intensity_jump_lengths[0]:.4g} m the stress intensity jumps: "
            "several "
            "vibrations may be possible there, and growth uses the first one found; fenics-crack "
            "curve shows them"
        )
    remark_texts += [
        f"a crack of {doubtful_length:.4g} m was not solved, and the growth there is interpolated "
        f"between other lengths: {failure_text}"
        for doubtful_length, failure_text in list_failed_lengths_and_reasons(
            length_path.sweep_results
        )
    ]
    # A crack arrested after some growth is at the threshold anyhow: no remark.
    is_near_threshold = (
        np.abs(values_by_column["delta_K_effective"] - law.threshold)
        < stress_intensity_range_error * law.threshold
    )
    if np.any(is_near_threshold) and (end_reason != "arrested" or len(lengths) == 1):
        remark_texts.append(
            f"at a length of {lengths[np.argmax(is_near_threshold)]:.4g} m the range differs from "
            f"growth.threshold by less than its error of {stress_intensity_range_error:.1%}: "
            "the crack may grow there, or stop"
        )
    if not math.isfinite(stress_intensity_range_error):
        remark_texts.append(UNKNOWN_K_ERROR_REMARK)
    return remark_texts


def _list_crack_turning_remarks(ratios: np.ndarray, lengths: np.ndarray) -> list[str]:
    """Return a remark if a crack would turn by more than 10 degrees, else an empty list.

    With the largest ratio r = K_II / K_I at the crack's ``lengths`` (n,) [m], the kink angle is
    2 arctan(2 r / (1 + sqrt(1 + 8 r^2))).
    """
    kink_angles = 2.0 * np.arctan(2.0 * ratios / (1.0 + np.sqrt(1.0 + 8.0 * ratios**2)))
    if not np.any(is_turning := kink_angles > math.radians(10.0)):
        return []
    return [
        f"from a length of {lengths[np.argmax(is_turning)]:.4g} m on the growth is doubtful: the "
        f"straight crack would turn by up to {math.degrees(kink_angles.max()):.0f} degrees, since "
        f"K_II is up to {np.max(ratios):.0%} of K_I"
    ]
