"""Pictures of a bladed disk: blades, nodal diameters, amplification by mistuning."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.tables import RPM, TURN, quantity, readable
from fenics_crack.curves.curve import ResponseCurve, parameter_axis
from fenics_crack.disk.bladed_disk import Amplification, NodalDiameters, wheel_of
from fenics_crack.disk.cyclic import excited_diameter
from fenics_crack.disk.wheel import Wheel
from fenics_crack.draw.figure import (
    COLOURS,
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

FRAMES = 48
"""Instants of the period at which the largest displacement of each node is looked for."""


def draw_wheel(solution: PeriodicSolution, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw a bladed disk coloured by the amplitude of its vibration (collective).

    The shape is that of the instant at which the wheel moves most, magnified; the colour is the
    largest displacement over the period, without its mean. Blades of a plane disk have numbers;
    those of cracked blades are orange.

    Parameters
    ----------
    solution : PeriodicSolution
        Of a scene with [disk].
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        It is no solution of a bladed disk.

    Examples
    --------
    >>> figure = fc.draw_wheel(fc.solve(disk).result, path="disk.png")
    """
    wheel = wheel_of(solution.structure)
    mesh = NodalMesh(solution.structure)
    displacements = mesh.nodal_vectors(
        solution.displacement_field(solution.period / FRAMES * np.arange(FRAMES))
    )
    displacements = displacements - displacements.mean(axis=0)
    sizes = np.linalg.norm(displacements, axis=2)
    amplitude = sizes.max(axis=0)
    largest_displacement = displacements[int(np.argmax(sizes.max(axis=1)))]
    [panel] = picture = Picture(size=(6.4, 6.0), comm=wheel.comm, **picture_options)
    factor, unit = readable(float(amplitude.max()), "m")
    shape_displacement = (
        0.5 * magnification_to_tenth(largest_displacement, mesh.size) * largest_displacement
    )
    coloured_mesh = draw_displaced_mesh(
        panel, mesh, shape_displacement, factor * amplitude, is_wheel=True
    )
    panel.figure.colorbar(coloured_mesh, ax=panel, label=f"amplitude [{unit}]", shrink=0.7)
    if mesh.dimension == 2:
        _number_blades(panel, wheel)
    return picture.save_with_title()


def _number_blades(panel: Axes, wheel: Wheel) -> None:
    """Write the number of each blade outside the node farthest from the axis."""
    sector, nodes = wheel.sector, wheel.sector.structure.nodes
    assert nodes is not None
    sector_middle = nodes.points.mean(axis=0) - sector.center
    reach = 1.08 * float(np.linalg.norm(nodes.points - sector.center, axis=1).max())
    for place in range(sector.n_sectors):
        position = sector.center + reach * sector.rotation_matrix(place) @ (
            sector_middle / np.linalg.norm(sector_middle)
        )
        colour, weight = ("orange", "bold") if place in wheel.cracked else ("grey", "normal")
        look = {"color": COLOURS[colour], "weight": weight, "ha": "center", "va": "center"}
        panel.text(*position, str(place + 1), **look)
        panel.update_datalim([position])


def draw_blades(
    curve: ResponseCurve,
    dof: int | None = None,
    *,
    in_hertz: bool = True,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw the response of every blade of a bladed disk along a curve.

    Cracked blades are orange, the whole blade with the largest response blue.

    Parameters
    ----------
    curve : ResponseCurve
        Of a scene with [disk].
    dof : int, optional
        Of one blade, whose place is taken on each; default: the watched one.
    in_hertz : bool
        Frequencies in Hz, else in rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        It is no curve of a bladed disk.

    Examples
    --------
    >>> figure = fc.draw_blades(fc.curve(disk).result, path="blades.png")
    """
    wheel = wheel_of(curve.problem_of(0).structure)
    dofs = wheel.dofs_of_blades(wheel.watched_dof if dof is None else dof)
    lines = np.array([curve.amplitude(blade_dof) for blade_dof in dofs])
    factor, *name = parameter_axis(curve.parameter, in_hertz)
    [panel] = picture = Picture(comm=wheel.comm, **picture_options)
    whole_blades = [place for place in range(len(dofs)) if place not in wheel.cracked]
    peaks = lines.max(axis=1)
    for place in whole_blades:
        panel.plot(factor * curve.values, lines[place], color="#b4b4b4", lw=0.8)
    highlighted_blades = (
        [(max(whole_blades, key=lambda place: peaks[place]), "blue", "")] if whole_blades else []
    )
    highlighted_blades += [(place, "orange", ", cracked") for place in wheel.cracked]
    for place, colour, words in highlighted_blades:
        label = f"blade {place + 1}{words}, up to {quantity(float(peaks[place]), 'm')}"
        panel.plot(factor * curve.values, lines[place], color=COLOURS[colour], lw=1.5, label=label)
    n_grey = len(whole_blades) - 1
    if n_grey > 0:
        panel.plot([], [], color="#b4b4b4", lw=0.8, label=f"the {n_grey} others")
    panel.set_yscale("log")
    panel.set_xlabel(f"{name[0]} [{name[1]}]")
    label_axis(panel.yaxis, "amplitude", "m")
    return picture.finish()


def draw_nodal_diameters(
    found: NodalDiameters, *, families: int | None = None, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw natural frequencies over the nodal diameter (SAFE diagram).

    Families are dots (Singh and others 1988). The order of the load has a ring on each family. A
    rotor has the frequency of each engine order at the nodal diameter that the order excites, which
    goes up and down between 0 and N/2.

    Parameters
    ----------
    found : NodalDiameters
        Result to draw.
    families : int, optional
        How many; default: all.
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
    from matplotlib.ticker import MaxNLocator  # not before draw/, where it reads no settings

    [panel] = picture = Picture(**picture_options)
    frequencies = found.omega[:, :families] / TURN
    diameters = np.arange(len(frequencies))
    for (family, row), colour in zip(
        enumerate(frequencies.T, 1), [*COLOURS.values()] * 99, strict=False
    ):
        panel.plot(diameters, row, ".-", color=colour, ms=7, lw=0.8, label=f"family {family}")
    look = {"color": "black", "mfc": "none", "label": f"excited by order {found.order}"}
    excited_frequencies = frequencies[found.excited]
    panel.plot(
        np.full(len(excited_frequencies), found.excited), excited_frequencies, "o", ms=10, **look
    )
    top = 1.08 * float(frequencies.max())
    if (speed := found.scene.speed) > 0.0:
        hertz = speed / TURN
        orders = np.arange(0, int(np.ceil(top / hertz)) + 1)
        places = [excited_diameter(order, found.sectors) for order in orders]
        label = f"engine orders at {speed / RPM:.4g} rpm"
        panel.plot(places, hertz * orders, "x--", color="#8f8f8f", ms=4, lw=0.6, label=label)
    panel.set(xlabel="nodal diameter", ylabel="natural frequency [Hz]", ylim=(0.0, top))
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    return picture.finish()


def draw_amplification(found: Amplification, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw the distribution of the amplification factors of mistuning patterns.

    It has a histogram, the share of patterns below a factor, and Whitehead's bound.

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
    count = len(found.factor)
    look = {"weights": np.full(count, 100.0 / count), "color": COLOURS["blue"], "alpha": 0.6}
    panel.hist(found.factor, max(8, int(np.sqrt(count))), **look)
    panel.set(xlabel="amplification factor", ylabel=f"share of {count} patterns [%]")
    panel.axvline(found.bound, color=COLOURS["pink"], ls="--", label="Whitehead's bound")
    percentile = found.percentile(95.0)
    label = f"95 % of patterns below {percentile:.3g}"
    panel.axvline(percentile, color=COLOURS["grey"], ls=":", label=label)
    sorted_factors = np.sort(found.factor)
    share_axes = panel.twinx()
    share_axes.plot(
        sorted_factors, 100.0 * np.arange(1, count + 1) / count, color=COLOURS["orange"], lw=1.4
    )
    share_axes.set(ylabel="share below [%]", ylim=(0.0, 102.0))
    share_axes.yaxis.label.set_color(COLOURS["orange"])
    return picture.finish()
