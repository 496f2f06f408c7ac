"""Draw bladed disks: vibration, blade responses, nodal diameters, amplification."""

from __future__ import annotations

from itertools import count, cycle
from typing import TYPE_CHECKING, Unpack

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    choose_factor_and_prefixed_unit,
    format_quantity,
)
from fenics_crack.curves.curve import ResponseCurve, axis_factor_name_and_unit
from fenics_crack.disk.bladed_disk import Amplification, NodalDiameters, wheel_of
from fenics_crack.disk.cyclic import excited_diameter
from fenics_crack.disk.wheel import Wheel
from fenics_crack.draw.figure import (
    CURVE_COLOUR_CODE_BY_NAME,
    Picture,
    PictureOptions,
    label_axis,
    magnification_to_tenth,
)
from fenics_crack.draw.plot_mesh import draw_displaced_mesh
from fenics_crack.fem.nodal_mesh import NodalMesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AMPLITUDE_INSTANTS_PER_PERIOD = 48
"""Instants per period for finding each node's largest displacement."""


def draw_wheel(solution: PeriodicSolution, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw a bladed disk coloured by the vibration amplitude (collective).

    The magnified shape belongs to the instant with the largest displacement. Colours show the
    largest displacement in the period. The mean displacement is left out. Blades of a plane disk
    have numbers, orange on cracked blades.

    Parameters
    ----------
    solution : PeriodicSolution
        Solution of a scene with [disk].
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The solution does not belong to a bladed disk.

    Examples
    --------
    >>> figure = fc.draw_wheel(fc.solve(disk).result, path="disk.png")
    """
    wheel = wheel_of(solution.structure)
    nodal_mesh = NodalMesh(solution.structure)
    displacements_over_period = nodal_mesh.nodal_vectors(
        solution.displacement_field(
            solution.period
            / AMPLITUDE_INSTANTS_PER_PERIOD
            * np.arange(AMPLITUDE_INSTANTS_PER_PERIOD)
        )
    )
    displacements_over_period = displacements_over_period - displacements_over_period.mean(axis=0)
    displacement_sizes = np.linalg.norm(displacements_over_period, axis=2)
    node_amplitudes = displacement_sizes.max(axis=0)
    displacement_at_peak_instant = displacements_over_period[
        int(np.argmax(displacement_sizes.max(axis=1)))
    ]
    [panel] = picture = Picture(size=(6.4, 6.0), comm=wheel.comm, **picture_options)
    amplitude_unit_factor, amplitude_unit = choose_factor_and_prefixed_unit(
        float(node_amplitudes.max()), "m"
    )
    shape_displacement = (
        0.5
        * magnification_to_tenth(displacement_at_peak_instant, nodal_mesh.size)
        * displacement_at_peak_instant
    )
    coloured_mesh = draw_displaced_mesh(
        panel,
        nodal_mesh,
        shape_displacement,
        amplitude_unit_factor * node_amplitudes,
        is_wheel=True,
    )
    panel.figure.colorbar(
        coloured_mesh, ax=panel, label=f"amplitude [{amplitude_unit}]", shrink=0.7
    )
    if nodal_mesh.dimension == 2:
        _write_blade_numbers(panel, wheel)
    return picture.save_with_title()


def _write_blade_numbers(panel: Axes, wheel: Wheel) -> None:
    """Write each blade's number outside the disk, at mid-sector; cracked blades are orange."""
    sector, sector_nodes = wheel.sector, wheel.sector.structure.nodes
    assert sector_nodes is not None
    vector_to_sector_middle = sector_nodes.points.mean(axis=0) - sector.center
    text_radius = 1.08 * float(np.linalg.norm(sector_nodes.points - sector.center, axis=1).max())
    for sector_index in range(sector.n_sectors):
        text_position = sector.center + text_radius * sector.rotation_matrix(sector_index) @ (
            vector_to_sector_middle / np.linalg.norm(vector_to_sector_middle)
        )
        colour, weight = ("orange", "bold") if sector_index in wheel.cracked else ("grey", "normal")
        panel.text(
            *text_position,
            str(sector_index + 1),
            color=CURVE_COLOUR_CODE_BY_NAME[colour],
            weight=weight,
            ha="center",
            va="center",
        )
        panel.update_datalim([text_position])


def draw_blades(
    curve: ResponseCurve,
    dof: int | None = None,
    *,
    in_hertz: bool = True,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw the response of every blade along a curve.

    Cracked blades are orange. Among uncracked blades, the blade with the largest response is blue,
    and all remaining blades are grey.

    Parameters
    ----------
    curve : ResponseCurve
        Curve of a scene with [disk].
    dof : int, optional
        Dof on any blade, to take at the same place on each blade; default: the watched dof.
    in_hertz : bool
        Show frequencies in Hz, otherwise in rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The curve does not belong to a bladed disk.

    Examples
    --------
    >>> figure = fc.draw_blades(fc.curve(disk).result, path="blades.png")
    """
    wheel = wheel_of(curve.problem_of(0).structure)
    blade_dofs = wheel.dofs_of_blades(wheel.watched_dof if dof is None else dof)
    blade_amplitudes_along_curve = np.array(
        [curve.amplitude(blade_dof) for blade_dof in blade_dofs]
    )
    unit_factor, *parameter_name_and_unit = axis_factor_name_and_unit(curve.parameter, in_hertz)
    [panel] = picture = Picture(comm=wheel.comm, **picture_options)
    uncracked_blades = [
        blade_index for blade_index in range(len(blade_dofs)) if blade_index not in wheel.cracked
    ]
    peak_amplitudes = blade_amplitudes_along_curve.max(axis=1)
    for blade_index in uncracked_blades:
        panel.plot(
            unit_factor * curve.values,
            blade_amplitudes_along_curve[blade_index],
            color="#b4b4b4",
            lw=0.8,
        )
    highlighted_blades_and_styles = (
        [(max(uncracked_blades, key=lambda blade_index: peak_amplitudes[blade_index]), "blue", "")]
        if uncracked_blades
        else []
    )
    highlighted_blades_and_styles += [
        (blade_index, "orange", ", cracked") for blade_index in wheel.cracked
    ]
    for blade_index, colour, label_suffix in highlighted_blades_and_styles:
        peak_text = format_quantity(float(peak_amplitudes[blade_index]), "m")
        panel.plot(
            unit_factor * curve.values,
            blade_amplitudes_along_curve[blade_index],
            color=CURVE_COLOUR_CODE_BY_NAME[colour],
            lw=1.5,
            label=f"blade {blade_index + 1}{label_suffix}, up to {peak_text}",
        )
    n_grey_blades = len(uncracked_blades) - 1
    if n_grey_blades > 0:
        panel.plot([], [], color="#b4b4b4", lw=0.8, label=f"other blades: {n_grey_blades}")
    panel.set_yscale("log")
    panel.set_xlabel(f"{parameter_name_and_unit[0]} [{parameter_name_and_unit[1]}]")
    label_axis(panel.yaxis, "amplitude", "m")
    return picture.draw_legends_and_save()


def draw_nodal_diameters(
    found: NodalDiameters, *, families: int | None = None, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw natural frequencies over the nodal diameter (SAFE diagram).

    Each family of modes is a line with dots (Singh et al. 1988). Rings mark the nodal diameter
    excited by the load. For a rotor, a zigzag line with crosses shows the engine orders. Each cross
    stands at the order times the speed, over the nodal diameter excited by this order.

    Parameters
    ----------
    found : NodalDiameters
        Result to draw.
    families : int, optional
        Number of drawn families; default: all.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> figure = fc.draw_nodal_diameters(fc.nodal_diameters(disk), path="diameters.png")
    """
    from matplotlib.ticker import MaxNLocator  # after draw/, which ignores matplotlibrc

    [panel] = picture = Picture(**picture_options)
    frequencies = found.omega[:, :families] / RAD_PER_TURN
    diameters = np.arange(len(frequencies))
    for family_number, family_frequencies, colour in zip(
        count(1), frequencies.T, cycle(CURVE_COLOUR_CODE_BY_NAME.values()), strict=False
    ):
        panel.plot(
            diameters,
            family_frequencies,
            ".-",
            color=colour,
            ms=7,
            lw=0.8,
            label=f"family {family_number}",
        )
    frequencies_at_excited_diameter = frequencies[found.excited]
    panel.plot(
        np.full(len(frequencies_at_excited_diameter), found.excited),
        frequencies_at_excited_diameter,
        "o",
        ms=10,
        color="black",
        mfc="none",
        label=f"excited by order {found.order}",
    )
    upper_limit = 1.08 * float(frequencies.max())
    if (speed := found.scene.speed) > 0.0:
        rotation_frequency = speed / RAD_PER_TURN
        engine_orders = np.arange(0, int(np.ceil(upper_limit / rotation_frequency)) + 1)
        excited_diameters = [
            excited_diameter(engine_order, found.sectors) for engine_order in engine_orders
        ]
        panel.plot(
            excited_diameters,
            rotation_frequency * engine_orders,
            "x--",
            color="#8f8f8f",
            ms=4,
            lw=0.6,
            label=f"engine orders at {speed / RAD_PER_S_PER_RPM:.4g} rpm",
        )
    panel.set(xlabel="nodal diameter", ylabel="natural frequency [Hz]", ylim=(0.0, upper_limit))
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    return picture.draw_legends_and_save()


def draw_amplification(found: Amplification, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw the distribution of amplification factors from mistuning patterns.

    The picture has a histogram, the share of patterns below each factor, the 95th percentile, and
    Whitehead's bound.

    Parameters
    ----------
    found : Amplification
        Result to draw.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> figure = fc.draw_amplification(fc.amplification(disk, 200), path="amplification.png")
    """
    [panel] = picture = Picture(**picture_options)
    n_patterns = len(found.factor)
    panel.hist(
        found.factor,
        max(8, int(np.sqrt(n_patterns))),
        weights=np.full(n_patterns, 100.0 / n_patterns),
        color=CURVE_COLOUR_CODE_BY_NAME["blue"],
        alpha=0.6,
    )
    panel.set(xlabel="amplification factor", ylabel=f"share of {n_patterns} patterns [%]")
    panel.axvline(
        found.bound, color=CURVE_COLOUR_CODE_BY_NAME["pink"], ls="--", label="Whitehead's bound"
    )
    percentile_95 = found.percentile(95.0)
    panel.axvline(
        percentile_95,
        color=CURVE_COLOUR_CODE_BY_NAME["grey"],
        ls=":",
        label=f"95 % of patterns below {percentile_95:.3g}",
    )
    sorted_factors = np.sort(found.factor)
    cumulative_share_axes = panel.twinx()
    cumulative_share_axes.plot(
        sorted_factors,
        100.0 * np.arange(1, n_patterns + 1) / n_patterns,
        color=CURVE_COLOUR_CODE_BY_NAME["orange"],
        lw=1.4,
    )
    cumulative_share_axes.set(ylabel="share below [%]", ylim=(0.0, 102.0))
    cumulative_share_axes.yaxis.label.set_color(CURVE_COLOUR_CODE_BY_NAME["orange"])
    return picture.draw_legends_and_save()
