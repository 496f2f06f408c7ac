"""Draw response curves: amplitudes with stability, harmonics and Floquet multipliers."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.tables import (
    choose_frequency_factor_name_unit,
    format_percent,
    format_quantity,
    heading_with_unit,
)
from fenics_crack.curves.curve import ResponseCurve, axis_factor_name_and_unit, kind_in_words
from fenics_crack.curves.peak import damping_by_half_power_width
from fenics_crack.draw.figure import (
    CURVE_COLOUR_CODE_BY_NAME,
    FIRST_IN_LEGEND_GID,
    Picture,
    PictureOptions,
    distinct_colours,
    label_axis,
)
from fenics_crack.numerics.fourier import to_complex

COMPARISON_CURVE_COLOURS = ("#8f8f8f", "#cc8fb1", "#6fb59a")
"""Colours of curves drawn behind for comparison (``behind`` of :func:`draw_curve`)."""
MARKERS_BY_BIFURCATION_KIND = {
    "fold": "v",
    "branch_point": "s",
    "period_doubling": "D",
    "neimark_sacker": "^",
}
"""Markers of matplotlib by kind of bifurcation."""
LINE_STYLES_BY_VERDICT = {"stable": "-", "unstable": "--", "irregular": "-.", "undecided": ":"}
"""Line styles of matplotlib by verdict on stability."""
STABILITY_NOT_EXAMINED_LABEL = "stability not examined"
"""Legend entry of a curve without Floquet multipliers."""
LARGE_ERROR_LABEL = f"faint: estimated error above {100 * LARGE_ERROR:g} %"
"""Legend entry of faint parts of a curve, with an estimated error above 5 %."""


def draw_curve(
    curve: ResponseCurve,
    dof: int | None = None,
    *,
    colour: str = "blue",
    label: str = "",
    behind: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    points: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    in_hertz: bool = False,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw half the peak-to-peak displacement of a dof along a response curve.

    Stable parts are solid, unstable parts dashed, irregular parts dash-dotted and undecided parts
    dotted. Without Floquet multipliers the curve is solid, and the legend says that stability was
    not examined. Parts with an estimated displacement error above 5 % are faint.

    Marks show special points:

    - A ring marks the largest response, unless this is an end of the curve. The legend states
      parameter and amplitude at the ring. Over the load frequency, the legend also states the
      damping found from the half-power width.
    - Further marks show bifurcations, and the legend states their number. If many lie close
      together, only a few are marked.
    - Text at each superharmonic peak, such as "3ω", states the order of the largest harmonic.

    Parameters
    ----------
    curve : ResponseCurve
        Result to draw.
    dof : int, optional
        Dof whose displacement is drawn; default: the watched dof.
    colour : str
        "blue", "orange", "green", "pink", "grey" or any colour known to matplotlib.
    label : str
        Legend entry, for several curves on the same axes. If given, bifurcations have the curve's
        colour.
    behind, points : mapping, optional
        Curves and single points for comparison. For each legend entry: (parameter values,
        amplitudes [m]), with frequencies and speeds in rad/s.
    in_hertz : bool
        Show load frequencies in Hz and speeds in rpm, also in ``behind`` and ``points``.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> figure = fc.draw_curve(curve, tip, in_hertz=True, path="curve.png")
    """
    [panel] = picture = Picture(**picture_options)
    if curve.parameter == "omega":
        panel.set_yscale("log")
    amplitudes = curve.amplitude(dof)
    unit_factor = axis_factor_name_and_unit(curve.parameter, in_hertz)[0]
    for (
        comparison_label,
        (comparison_parameter_values, comparison_amplitudes),
    ), comparison_colour in zip(
        (behind or {}).items(), cycle(COMPARISON_CURVE_COLOURS), strict=False
    ):
        panel.plot(
            unit_factor * comparison_parameter_values,
            comparison_amplitudes,
            color=comparison_colour,
            lw=0.9,
            label=comparison_label,
        )
    line_colour = CURVE_COLOUR_CODE_BY_NAME.get(colour, colour)
    _draw_curve_parts(panel, curve, unit_factor * curve.values, amplitudes, line_colour, label)
    _mark_peak(panel, curve, dof, in_hertz, line_colour if label else "")
    _mark_bifurcations(panel, curve, dof, unit_factor, line_colour if label else "")
    for (
        comparison_label,
        (comparison_parameter_values, comparison_amplitudes),
    ), comparison_marker in zip((points or {}).items(), cycle("^v"), strict=False):
        panel.plot(
            unit_factor * comparison_parameter_values,
            comparison_amplitudes,
            comparison_marker,
            color=CURVE_COLOUR_CODE_BY_NAME["green"],
            ms=4.5,
            mfc="none",
            label=comparison_label,
        )
    if curve.parameter == "omega":
        _mark_superharmonics(panel, curve, dof, amplitudes, unit_factor)
    _label_parameter_axis(panel, curve, in_hertz)
    panel.margins(y=0.1)
    label_axis(panel.yaxis, "half peak-to-peak displacement", "m")
    return picture.draw_legends_and_save()


def _draw_curve_parts(
    axes: Axes, curve: ResponseCurve, x: np.ndarray, y: np.ndarray, line_colour: str, label: str
) -> None:
    """Draw a curve in parts: line styles show stability, and inexact parts are faint.

    A point is inexact if the estimated displacement error is above 5 %.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    curve : ResponseCurve
        Curve with stability and errors.
    x, y : (n,)
        Parameter in the shown unit, and amplitude [m], at the curve's points.
    line_colour : str
        Colour of the curve.
    label : str
        Legend entry if there are several curves, otherwise empty.
    """
    is_stability_examined = curve.multipliers is not None
    verdicts = curve.verdicts if is_stability_examined else np.full(len(x), "stable")
    is_inexact_point, inexact_part_options = curve.displacement_errors > LARGE_ERROR, {"alpha": 0.3}
    if label:
        legend_label = (
            label if is_stability_examined else f"{label} ({STABILITY_NOT_EXAMINED_LABEL})"
        )
        axes.plot([], [], color=line_colour, lw=1.8, label=legend_label, gid=FIRST_IN_LEGEND_GID)
    for verdict, style in LINE_STYLES_BY_VERDICT.items():
        if not np.any(verdicts == verdict):
            continue
        for draws_inexact_points, alpha_options in ((False, {}), (True, inexact_part_options)):
            is_in_part = (verdicts == verdict) & (is_inexact_point == draws_inexact_points)
            # A segment between two points has the verdict and error of the first.
            part_values = np.where(is_in_part | np.append(False, is_in_part[:-1]), y, np.nan)
            axes.plot(x, part_values, style, color=line_colour, lw=1.4, **alpha_options)
        legend_line_colour = CURVE_COLOUR_CODE_BY_NAME["grey"] if label else line_colour
        if is_stability_examined or not label:
            legend_label = (
                verdict
                if is_stability_examined
                else f"with contact, {STABILITY_NOT_EXAMINED_LABEL}"
            )
            axes.plot([], [], style, color=legend_line_colour, lw=1.4, label=legend_label)
    if is_inexact_point.any():
        axes.plot(
            [], [], color=line_colour, lw=1.4, label=LARGE_ERROR_LABEL, **inexact_part_options
        )


def _mark_peak(
    axes: Axes, curve: ResponseCurve, dof: int | None, in_hertz: bool, curve_colour: str
) -> None:
    """Mark the largest response with a ring, unless this is an end of the curve.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    curve : ResponseCurve
        Curve with the response.
    dof : int or None
        Dof of the displacement; None: the watched dof.
    in_hertz : bool
        Show load frequencies in Hz and speeds in rpm, otherwise in rad/s.
    curve_colour : str
        Colour of the curve, for the ring, if there are several curves. Empty for a single curve:
        the ring is then blue and has a legend entry.
    """
    peak = curve.top(dof)
    (unit_factor, _, unit) = axis_factor_name_and_unit(curve.parameter, in_hertz)
    if peak.at_end:
        return
    peak_parameter, amplitude = unit_factor * peak.value, peak.amplitude
    label = (
        f"largest: {format_quantity(amplitude, 'm')} at {peak_parameter:.5g} {unit}".removesuffix(
            " -"
        )
    )
    if curve.parameter == "omega":
        damping = damping_by_half_power_width(
            curve.values, curve.coefficients_at(dof), curve.subharmonic, peak.index
        )
        label += f",\nhalf-power damping {format_percent(damping)}" if np.isfinite(damping) else ""
    axes.plot(
        peak_parameter,
        amplitude,
        "o",
        label="" if curve_colour else label,
        color=curve_colour or CURVE_COLOUR_CODE_BY_NAME["blue"],
        mfc="none",
        ms=7.0,
        mew=1.1,
    )


def _mark_bifurcations(
    axes: Axes, curve: ResponseCurve, dof: int | None, unit_factor: float, curve_colour: str
) -> None:
    """Mark a curve's bifurcations by their kinds, for example folds.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    curve : ResponseCurve
        Curve with the bifurcations.
    dof : int or None
        Dof of the displacement; None: the watched dof.
    unit_factor : float
        Factor from the parameter's SI unit to the shown unit.
    curve_colour : str
        Colour of the curve, for the marks, if there are several curves. Empty for a single curve:
        the legend then states how many bifurcations were found and marked.
    """
    if not curve.bifurcations:
        return
    x = np.array([unit_factor * bifurcation.value for bifurcation in curve.bifurcations])
    y = curve.at_bifurcations.amplitude(dof)[1:-1]
    kind_of_each_bifurcation = np.array([bifurcation.kind for bifurcation in curve.bifurcations])
    is_chosen_for_mark = _choose_spread_bifurcation_marks(axes, x, y, kind_of_each_bifurcation)
    for kind, marker in MARKERS_BY_BIFURCATION_KIND.items():
        is_of_kind, legend_label = kind_of_each_bifurcation == kind, kind_in_words(kind)
        if not is_of_kind.any():
            continue
        marker_options: dict[str, Any] = {
            "ls": "none",
            "marker": marker,
            "ms": 3.8,
            "mew": 0.8,
            "zorder": 3,
        }
        axes.plot(
            x[is_chosen_for_mark & is_of_kind],
            y[is_chosen_for_mark & is_of_kind],
            color=curve_colour or CURVE_COLOUR_CODE_BY_NAME["orange"],
            **marker_options,
        )
        if not curve_colour:
            n_found, n_marked = int(is_of_kind.sum()), int((is_chosen_for_mark & is_of_kind).sum())
            legend_label += (
                f" ({n_found})" if n_marked == n_found else f" ({n_found}, {n_marked} marked)"
            )
        axes.plot(
            [],
            [],
            color=CURVE_COLOUR_CODE_BY_NAME["grey"]
            if curve_colour
            else CURVE_COLOUR_CODE_BY_NAME["orange"],
            label=legend_label,
            **marker_options,
        )


def _choose_spread_bifurcation_marks(
    axes: Axes, x: np.ndarray, y: np.ndarray, kinds: np.ndarray
) -> np.ndarray:
    """Choose bifurcations to mark, so that marks do not pile up: (n,) bool.

    The panel is divided into cells, 3 % of its width by 3 % of its height. In each cell a single
    bifurcation of each kind is marked.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    x, y : (n,)
        Positions in data coordinates.
    kinds : (n,)
        Kind of each bifurcation.
    """
    axes.autoscale_view()  # to the lines drawn so far
    panel_positions = (axes.transData - axes.transAxes).transform(np.column_stack([x, y]))
    cells_and_kinds = np.column_stack(
        [np.floor(panel_positions / 0.03), np.unique(kinds, return_inverse=True)[1]]
    )
    _, first_index_in_cell = np.unique(cells_and_kinds, axis=0, return_index=True)
    return np.isin(np.arange(len(x)), first_index_in_cell)


def _mark_superharmonics(
    axes: Axes, curve: ResponseCurve, dof: int | None, amplitudes: np.ndarray, unit_factor: float
) -> None:
    """Write the order of the largest harmonic, such as "3ω", at each superharmonic peak.

    A peak is superharmonic if the displacement's largest harmonic has an order above 1, in
    multiples of the load frequency.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    curve : ResponseCurve
        Curve with the harmonics.
    dof : int or None
        Dof of the displacement; None: the watched dof.
    amplitudes : (n,) [m]
        Amplitudes at the curve's points.
    unit_factor : float
        Factor from the parameter's SI unit to the shown unit.
    """
    dominant_harmonic = np.argmax(_harmonic_amplitudes(curve, dof), axis=1) + 1
    dominant_order_in_load_frequency, dominant_harmonic_remainder = np.divmod(
        dominant_harmonic, curve.subharmonic
    )
    is_superharmonic = (dominant_order_in_load_frequency > 1) & (dominant_harmonic_remainder == 0)
    if not is_superharmonic.any():
        return
    from scipy.signal import find_peaks  # takes as long to load as matplotlib

    curve_peak_indices, _ = find_peaks(np.log10(np.maximum(amplitudes, 1e-300)), prominence=0.05)
    for peak_index in curve_peak_indices[is_superharmonic[curve_peak_indices]]:
        axes.annotate(
            f"{dominant_order_in_load_frequency[peak_index]}ω",
            (unit_factor * curve.omega[peak_index], amplitudes[peak_index]),
            (0, 5),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=CURVE_COLOUR_CODE_BY_NAME["grey"],
        )


def _label_parameter_axis(axes: Axes, curve: ResponseCurve, in_hertz: bool) -> None:
    """Label the horizontal axis with a curve's parameter, after all lines are drawn.

    If the parameter is the rotor speed, an axis on top shows the load frequency, the engine order
    times the speed. If curves on the same axes have different engine orders, there is no top axis.
    """
    unit_factor, parameter_name, unit = axis_factor_name_and_unit(curve.parameter, in_hertz)
    if curve.parameter == "speed":
        engine_order = float(curve.omega[0] / curve.values[0])
        frequency_factor, frequency_name, frequency_unit = choose_frequency_factor_name_unit(
            in_hertz
        )
        frequency_label = heading_with_unit(
            f"{frequency_name}, engine order {engine_order:g}", frequency_unit
        )
        for top_axis in axes.child_axes:  # top axes of earlier curves
            top_axis.set_visible(
                top_axis.get_visible() and top_axis.get_xlabel() == frequency_label
            )
        if not axes.child_axes:
            frequency_per_speed = engine_order * frequency_factor / unit_factor
            top_axis = axes.secondary_xaxis(
                "top",
                functions=(
                    lambda speed: frequency_per_speed * speed,
                    lambda frequency: frequency / frequency_per_speed,
                ),
            )
            top_axis.set_xlabel(frequency_label)
    if unit == "m":
        label_axis(axes.xaxis, parameter_name, unit)
    else:
        axes.set_xlabel(heading_with_unit(parameter_name, unit))


def _harmonic_amplitudes(curve: ResponseCurve, dof: int | None) -> np.ndarray:
    """Return the amplitudes of harmonics 1 to H at a curve's points: (n, H) [m].

    ``dof`` is the displacement's dof; None: the watched dof.
    """
    return np.abs(to_complex(curve.coefficients_at(dof).T)[1:].T)


def draw_content(
    curve: ResponseCurve,
    dof: int | None = None,
    *,
    highest: int = 5,
    in_hertz: bool = False,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw the amplitudes of a displacement's lowest harmonics along a response curve.

    Parameters
    ----------
    curve : ResponseCurve
        Result to draw.
    dof : int, optional
        Dof of the displacement; default: the watched dof.
    highest : int
        Highest drawn harmonic, in multiples of the load frequency.
    in_hertz : bool
        Show load frequencies in Hz and speeds in rpm, otherwise in rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The highest harmonic is not a whole number >= 1.

    Examples
    --------
    >>> figure = fc.draw_content(curve, tip, highest=3, path="content.png")
    """
    check_count("highest", highest, 1)
    [panel] = picture = Picture(**picture_options)
    panel.set_yscale("log")
    response_at_load_multiples = _harmonic_amplitudes(curve, dof)[
        :, curve.subharmonic - 1 :: curve.subharmonic
    ]
    drawn_harmonic_amplitudes = response_at_load_multiples[:, :highest].T
    parameter_values = axis_factor_name_and_unit(curve.parameter, in_hertz)[0] * curve.values
    colours = distinct_colours(len(drawn_harmonic_amplitudes))
    for order, (order_amplitudes, colour) in enumerate(
        zip(drawn_harmonic_amplitudes, colours, strict=True), 1
    ):
        panel.plot(
            parameter_values, order_amplitudes, color=colour, lw=1.2, label=f"harmonic {order}"
        )
    panel.set_ylim(1e-5 * drawn_harmonic_amplitudes.max(), 2.0 * drawn_harmonic_amplitudes.max())
    _label_parameter_axis(panel, curve, in_hertz)
    label_axis(panel.yaxis, "amplitude of the harmonic", "m")
    return picture.draw_legends_and_save()


def draw_multipliers(
    curve: ResponseCurve, *, in_hertz: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw the modulus of the largest Floquet multiplier along a curve.

    An orbit is stable if the modulus is below 1. Colours show the kind of multiplier. A real
    multiplier leaves the unit circle at +1 (folds, branch points) or -1 (period doublings). A
    complex pair leaves the circle anywhere else (Neimark-Sacker). For irregular motions, the growth
    of a small disturbance is drawn instead. Crosses are points with undecided stability. A cross
    with an unknown multiplier is drawn at 1.

    Parameters
    ----------
    curve : ResponseCurve
        Curve followed with ``stability=True``.
    in_hertz : bool
        Show load frequencies in Hz and speeds in rpm, otherwise in rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The curve was followed without ``stability=True``.

    Examples
    --------
    >>> figure = fc.draw_multipliers(curve, path="multipliers.png")
    """
    if curve.multipliers is None:
        raise InputError("stability", False, "True; follow the curve again with stability=True")
    [panel] = picture = Picture(**picture_options)
    parameter_values = axis_factor_name_and_unit(curve.parameter, in_hertz)[0] * curve.values
    multipliers, moduli = curve.multipliers, np.abs(curve.multipliers)
    is_undecided = curve.verdicts == "undecided"
    is_complex_pair = np.abs(multipliers.imag) > 1e-9 * moduli
    is_irregular = curve.verdicts == "irregular"
    panel.axhline(1.0, color=CURVE_COLOUR_CODE_BY_NAME["grey"], lw=0.9, label="limit of stability")
    panel.plot(parameter_values, moduli, color=CURVE_COLOUR_CODE_BY_NAME["grey"], lw=0.4, alpha=0.6)
    is_real, has_positive_real_part = ~is_complex_pair & ~is_irregular, multipliers.real > 0.0
    for is_of_kind, label, colour in (
        (is_real & has_positive_real_part, "real, positive", "blue"),
        (is_real & ~has_positive_real_part, "real, negative", "orange"),
        (is_complex_pair & ~is_irregular, "a complex pair", "green"),
        (is_irregular, "growth of an irregular motion", "pink"),
    ):
        is_decided_and_of_kind = is_of_kind & ~is_undecided
        if is_decided_and_of_kind.any():
            panel.plot(
                parameter_values[is_decided_and_of_kind],
                moduli[is_decided_and_of_kind],
                ".",
                ms=4.0,
                color=CURVE_COLOUR_CODE_BY_NAME[colour],
                label=label,
            )
    if is_undecided.any():
        is_known = np.isfinite(moduli[is_undecided])
        label = "undecided" if is_known.all() else "undecided; drawn at 1 if unknown"
        undecided_moduli = np.where(is_known, moduli[is_undecided], 1.0)
        panel.plot(
            parameter_values[is_undecided],
            undecided_moduli,
            "x",
            ms=4.0,
            color=CURVE_COLOUR_CODE_BY_NAME["pink"],
            label=label,
        )
    if n_above := int(np.sum(moduli > 2.0)):  # a larger scale would flatten all other points
        panel.set_ylim(top=2.0)
        panel.plot([], [], " ", label=f"{n_above} of {len(moduli)} points lie above")
    _label_parameter_axis(panel, curve, in_hertz)
    panel.set_ylabel("modulus of the largest multiplier [-]")
    return picture.draw_legends_and_save()
