"""Pictures of motions and of what they depend on: waves, contact laws, where crack faces touch,
responses, maps, spectra, orbits in the phase plane, loops of friction, what opens crack tips."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice, product
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import quantity, readable
from fenics_crack.draw.figure import (
    COLOURS,
    STYLE,
    Picture,
    Where,
    distinct_colours,
    given_axes,
    label_axis,
    upright,
)
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.contact import ContactLaw, coefficient_of, is_rigid
from fenics_crack.model.nodes import AXES, Pairs
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import friction_losses, is_slipping
from fenics_crack.numerics.equations import CENTRAL_DIFFERENCE_STEP
from fenics_crack.numerics.fourier import to_complex

if TYPE_CHECKING:  # which loads DOLFINx
    from fenics_crack.runs.stress_intensity import StressIntensity

DOUBTFUL = f"not stable, or estimated error above {100 * LARGE_ERROR:g} %"
HATCHED = "#ffffff"
MISSING_COLOUR, OPEN_COLOUR = "#b5b5b5", "#e8e8e8"
"""Cells without a value; an open crack."""


@dataclass(frozen=True)
class Wave:
    """A displacement over time.

    Attributes
    ----------
    label, colour, style : str
        Legend entry; "blue", "orange", "green", "pink", "grey" or a colour of matplotlib; its line
        style.
    time, values : (n,)
        [s], [m].
    spread : (n,) [m] or None
        Half-width of a band around the curve, for example the standard deviation of a mean wave.
    width : float [points]
        Line width; wide lines show below thin ones.
    """

    label: str
    time: np.ndarray
    values: np.ndarray
    colour: str = "blue"
    style: str = "-"
    spread: np.ndarray | None = None
    width: float = 1.6


def draw_waves(
    waves: Sequence[Wave],
    *,
    quantity: str,
    period: float | None = None,
    zero: str | None = None,
    **where: Unpack[Where],
) -> Figure:
    """Draw displacements over time.

    Parameters
    ----------
    waves : sequence of Wave
        The curves.
    quantity : str
        Label of the vertical axis without its unit.
    period : float [s], optional
        Unit of the time axis; default: seconds.
    zero : str, optional
        Legend entry of a line at zero, for example "crack faces touch".
    **where
        ``axes``, or ``ax``: where to draw, by default in a new figure; ``path``: where to save the
        new figure; ``title`` of the picture; ``legend=False``: without a legend.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Examples
    --------
    >>> time = np.linspace(0.0, solution.period, 200)
    >>> wave = fc.Wave("tip", time, solution.displacement(time, [tip])[:, 0])
    >>> figure = fc.draw_waves([wave], quantity="displacement", path="waves.png")
    """
    if not isinstance(quantity, str):
        raise InputError("quantity", quantity, "a text")
    [panel] = picture = Picture(**where)
    for wave in waves:
        time = wave.time / period if period else wave.time
        colour = COLOURS.get(wave.colour, wave.colour)
        panel.plot(time, wave.values, wave.style, color=colour, label=wave.label, lw=wave.width)
        if wave.spread is not None:
            low, high = wave.values - wave.spread, wave.values + wave.spread
            panel.fill_between(time, low, high, color=colour, alpha=0.2, lw=0)
    if zero is not None:
        panel.axhline(0.0, color=COLOURS["grey"], lw=0.8, label=zero)
    if period:
        panel.set_xlabel("time / load period")
    else:
        label_axis(panel.xaxis, "time", "s")
    label_axis(panel.yaxis, quantity, "m")
    return picture.finished()


def draw_laws(
    laws: Mapping[str, ContactLaw], closing: np.ndarray, **where: Unpack[Where]
) -> Figure:
    """Draw the contact forces [N] of laws, by their labels, over the closing of a pair [m].

    Parameters
    ----------
    laws : mapping of str to ContactLaw
        By the labels of their lines.
    closing : (n,) [m]
        Positive where the pair penetrates.
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Examples
    --------
    >>> closing = np.linspace(-1e-6, 1e-6, 101)
    >>> figure = fc.draw_laws({"penalty": contact}, closing, path="laws.png")
    """
    [panel] = picture = Picture(**where)
    looks = zip(distinct_colours(len(laws)), cycle(("-", "--", ":", "-.", "-")), strict=False)
    for (label, law), (colour, style) in zip(laws.items(), looks, strict=True):
        force = law.force(closing[:, None])[:, 0]
        panel.plot(closing, force, style, color=colour, label=label, lw=1.8)
    label_axis(panel.xaxis, "closing g (penetration where g > 0)", "m")
    label_axis(panel.yaxis, "contact force", "N")
    return picture.finished()


def draw_contact_map(
    solution: PeriodicSolution, *, instants: int = 400, **where: Unpack[Where]
) -> Figure:
    """Draw where along the crack and when in the period the crack faces touch, and how hard; of a
    solid where on each crack, how hard at most, and for how much of the period.

    Colours show the contact pressure if contact is rigid or its stiffness given per area, else the
    force of each pair; grey is open. Several cracks are one above the other, with a line between
    them.

    Parameters
    ----------
    solution : PeriodicSolution
        With the contact force of two or more pairs.
    instants : int
        In the period.
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        The structure has fewer than two pairs, or does not know where they are.

    Examples
    --------
    >>> figure = fc.draw_contact_map(solution, path="contact.png")
    """
    structure, law = solution.structure, solution.contact
    points = structure.pair_points
    if points is None or len(points) < 2:
        found = None if points is None else len(points)
        raise InputError("pairs", found, "two or more, with a mesh")
    time = np.linspace(0.0, solution.period, instants + 1)
    values, label, unit = solution.contact_force(time), "contact force of a pair", "N"
    smooth = law is not None and (is_rigid(law) or np.ndim(law.stiffness) > 0)
    if structure.pair_areas is not None and smooth:
        values, label, unit = values / structure.pair_areas, "contact pressure", "Pa"
    scale, unit = readable(float(values.max()), unit)
    if points.shape[1] == 3:
        shown = {f"largest {label} [{unit}]": scale * values.max(axis=0)}
        shown["share of the period closed"] = (values[:-1] > 0.0).mean(axis=0)
        return _over_cracks(structure, shown, where)
    depth, ends = _along_cracks(structure.pairs)
    loads = time * solution.omega / (2.0 * np.pi)
    [panel] = picture = Picture(**where)
    shown = np.ma.masked_less_equal(scale * values.T, 0.0)
    _colour(panel, loads, depth, shown, f"{label} [{unit}] (grey: open)", OPEN_COLOUR)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("time / load period")
    for end in ends:
        panel.axhline(end, color="black", lw=1.5)
    start = next(iter(structure.watched_pairs))
    of_crack = "from the crack's mouth" if start == "the mouth" else "from the crack's left tip"
    if ends:
        of_crack = f"along cracks 1 to {len(ends) + 1}, one above the other"
    label_axis(panel.yaxis, f"distance {of_crack}", "m")
    return picture.saved()


def _over_cracks(structure: Structure, shown: Mapping[str, np.ndarray], where: Where) -> Figure:
    """Values of the pairs of a solid, by their labels, over each of its cracks."""
    from scipy.spatial import cKDTree

    mesh, pairs = NodalMesh(structure.whole), structure.pairs
    facets = mesh.crack_face_sides
    triangles = facets if facets.shape[1] == 3 else facets[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    tree = cKDTree(pairs.points)
    of_pair = np.zeros(len(tree.data), dtype=int) if pairs.cracks is None else pairs.cracks
    of_crack = of_pair[tree.query(mesh.points[triangles].mean(axis=1))[1]]
    cracks = np.unique(of_pair)
    picture = Picture(2 * len(cracks), columns=2, size=(9.0, 3.4 * len(cracks)), **where)
    for panel, (crack, label) in zip(picture, product(cracks, shown), strict=True):
        nodes, corners = np.unique(triangles[of_crack == crack], return_inverse=True)
        values = mesh.pair_centre_and_pressure_functions[1][nodes] @ shown[label]
        _over_crack(panel, mesh.points[nodes], corners.reshape(-1, 3), values, label)
        if len(cracks) > 1:
            panel.set_title(f"crack {crack + 1}", fontsize="medium")
    return picture.saved()


def _over_crack(
    axes: Axes, points: np.ndarray, triangles: np.ndarray, values: np.ndarray, label: str
) -> None:
    """Values at points of a crack, zero at its front, over the plane in which it lies most."""
    across = int(np.argmin(np.ptp(points, axis=0)))
    one, other = (axis for axis in range(3) if axis != across)
    scale, unit = readable(float(np.abs(points[:, [one, other]]).max()), "m")
    at, ends = scale * points[:, [one, other]].T, {"vmin": 0.0, "vmax": values.max() or 1.0}
    drawn = axes.tripcolor(*at, triangles, values, shading="gouraud", cmap="viridis", **ends)
    axes.triplot(*at, triangles, color="black", lw=0.2)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{AXES[one]} [{unit}]")
    axes.set_ylabel(f"{AXES[other]} [{unit}]")
    axes.figure.colorbar(drawn, ax=axes, orientation="horizontal", pad=0.25).set_label(label)


def _along_cracks(pairs: Pairs) -> tuple[np.ndarray, list[float]]:
    """Distance of the pairs along the cracks [m], one crack after the other; where others begin."""
    assert pairs.cracks is not None and pairs.positions is not None
    depth = pairs.positions.copy()
    space, ends = 0.05 * float(depth.max()) or 1.0, []
    for first in np.flatnonzero(np.diff(pairs.cracks)) + 1:
        depth[first:] += depth[first - 1] + space
        ends.append(0.5 * (depth[first - 1] + depth[first]))
    return depth, ends


def draw_response(
    values: np.ndarray,
    curves: Mapping[str, np.ndarray],
    *,
    quantity: str,
    over: str = "load frequency [rad/s]",
    doubtful: Mapping[str, np.ndarray] | None = None,
    unit: str = "m",
    **where: Unpack[Where],
) -> Figure:
    """Draw amplitudes [m] or other quantities over the load frequency [rad/s] or other values.

    The scale is logarithmic if the values are positive and span a decade or more, or are lengths. A
    curve has a dot at each of few values, a gap where it is nan, and rings where it is doubtful.
    Lines that are on the axes already keep their colours to themselves.

    Parameters
    ----------
    values : (n,)
        Load frequencies [rad/s], or what ``over`` says.
    curves : mapping of str to (n,) arrays
        By the labels of their lines.
    quantity
        As of :func:`draw_waves`.
    over : str
        Label of the horizontal axis, with its unit.
    doubtful : mapping of str to (n,) bool, optional
        Where a curve has rings.
    unit : str
        Of the curves; lengths [m] are drawn in a readable multiple.
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There is no curve.

    Examples
    --------
    >>> curves = {"tip": curve.amplitude(tip)}
    >>> figure = fc.draw_response(curve.omega, curves, quantity="displacement", path="response.png")
    """
    if not curves:
        raise InputError("curves", curves, "one or more")
    [panel] = picture = Picture(**where)
    values, curves = np.asarray(values), {name: np.asarray(y, float) for name, y in curves.items()}
    every = np.concatenate([found[np.isfinite(found)] for found in curves.values()])
    low, high = every.min(initial=np.inf), every.max(initial=-np.inf)
    if 0.0 < low < np.inf and (unit == "m" or 10.0 * low <= high):
        panel.set_yscale("log")
    there = sum(line.get_linestyle() != "None" for line in panel.lines)
    styles = islice(cycle(product((".-", ".--", ".:"), COLOURS.values())), there, None)
    size = 4.0 if len(values) <= 60 else 0.0  # more dots would touch
    for (label, found), (style, colour) in zip(curves.items(), styles, strict=False):
        panel.plot(values, found, style, color=colour, label=label, lw=1.4, ms=size)
    marked = {label: np.asarray(mask, bool) for label, mask in (doubtful or {}).items()}
    ringed = [(values[mask], curves[label][mask]) for label, mask in marked.items()]
    if any(len(x) for x, _ in ringed):
        x, y = np.concatenate(ringed, axis=1)
        panel.plot(x, y, "o", color=COLOURS["grey"], mfc="none", ms=size + 4.0, label=DOUBTFUL)
    panel.set_xlabel(over)
    label_axis(panel.yaxis, quantity, unit)
    return picture.finished()


def draw_map(
    x: np.ndarray,
    y: np.ndarray,
    values: np.ndarray,
    *,
    x_label: str,
    y_label: str,
    value_label: str,
    doubtful: np.ndarray | None = None,
    **where: Unpack[Where],
) -> Figure:
    """Draw values over two swept quantities, such as load frequency and crack length, as colours.

    The scale is logarithmic if the values are positive and the largest is 30 times the smallest.

    Parameters
    ----------
    x, y : (n,), (m,)
        The swept quantities, rising; two or more of each.
    values : (m, n)
        Grey and crossed where nan: not converged.
    x_label, y_label, value_label : str
        With units.
    doubtful : (m, n) bool, optional
        Hatched cells: not stable, or with a large estimated error.
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        The shapes do not fit, a quantity does not rise, or there is no finite value.

    Examples
    --------
    >>> x, y = np.linspace(0.0, 1.0, 3), np.linspace(0.0, 1.0, 2)
    >>> figure = fc.draw_map(
    ...     x, y, np.outer(1.0 + y, x), x_label="x [m]", y_label="y [m]", value_label="z [m]")
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    for name, swept in (("x", x), ("y", y)):
        if swept.ndim != 1 or len(swept) < 2 or not np.all(np.diff(swept) > 0.0):
            raise InputError(name, swept, "two or more rising numbers")
    shown = np.ma.masked_invalid(np.asarray(values, dtype=float))
    if shown.shape != (len(y), len(x)):
        raise InputError("values", shown.shape, f"of shape (len(y), len(x)) = {len(y), len(x)}")
    if not shown.count():
        raise InputError("values", "nan", "finite somewhere")
    low, high = float(shown.min()), float(shown.max())
    scale = LogNorm if 0.0 < 30.0 * low <= high else Normalize
    marked = np.zeros(shown.shape, bool) if doubtful is None else np.asarray(doubtful, bool)
    if marked.shape != shown.shape:
        raise InputError("doubtful", marked.shape, f"of the shape of values, {shown.shape}")
    [panel] = picture = Picture(**where)
    _colour(panel, x, y, shown, value_label, MISSING_COLOUR, norm=scale(low, high))
    lost = np.ma.getmaskarray(shown)
    panel.plot(*(at.ravel()[lost.ravel()] for at in np.meshgrid(x, y)), "x", color="white", ms=5)
    keys = [Patch(facecolor=MISSING_COLOUR, label="not converged")] if lost.any() else []
    if np.any(marked & ~lost):
        look = {"edgecolor": HATCHED, "hatch": "/////", "linewidth": 0.0}
        hatched = np.ma.masked_where(~marked, shown)
        panel.pcolor(x, y, hatched, shading="nearest").set(facecolor="none", **look)
        keys.append(Patch(label=DOUBTFUL, facecolor="#3b528b", **look))
    panel.set(xlabel=x_label, ylabel=y_label)
    if keys and picture.legend:
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "borderaxespad": 4.2}
        with rc_context(STYLE):
            panel.legend(handles=keys, ncol=2, handlelength=3.0, frameon=False, **below)
    return picture.saved()


def _colour(
    axes: Axes, x: np.ndarray, y: np.ndarray, values: Any, label: str, grey: str, **options: Any
) -> None:
    """Draw values (len(y), len(x)) as coloured cells; masked ones are grey."""
    axes.set_facecolor(grey)
    image = axes.pcolormesh(x, y, values, cmap="viridis", shading="nearest", **options)
    axes.figure.colorbar(image, ax=axes, label=upright(label)).minorticks_off()


# --- harmonics, orbits, tips ----------------------------------------------------------------------


def draw_spectrum(
    solution: PeriodicSolution, dof: int | None = None, **where: Unpack[Where]
) -> Figure:
    """Draw the amplitudes of the harmonics, logarithmically, over their orders (collective).

    The upper panel shows the gap of the pair that moves most and the displacement of a dof, the
    lower one the contact force, summed over the pairs. Order 1 is the load's, 0 the mean; the
    orders of a subharmonic response are fractions. There are enough harmonics where the amplitudes
    have fallen far.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to draw.
    dof : int, optional
        Whose displacement.
    **where
        ``axes`` (one, or two with the force), ``path``, ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There is neither a pair nor a dof, or the number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_spectrum(solution, tip, path="spectrum.png")
    """
    lengths = {}
    if solution.structure.n_pairs:
        time = np.linspace(0.0, solution.period, 257)
        pair = int(np.argmax(np.ptp(solution.gap(time), axis=0)))
        lengths[f"gap {solution.structure.describe_pair(pair)}"] = solution.gap_coefficients[
            :, pair
        ]
    if dof is not None:
        lengths[solution.structure.dof_name(dof)] = solution.coefficients_at([dof])[:, 0]
    if not lengths:
        raise InputError("dof", None, "given where there is no contact pair")
    force = solution.force_coefficients.sum(axis=1)
    axes = given_axes(where)
    count = 1 + bool(np.any(force)) if axes is None else min(2, np.size(axes))
    size, comm = (7.0, 2.4 + 2.2 * count), solution.structure.comm
    picture = Picture(count, size=size, sharex=True, comm=comm, **where)
    forces = {"contact force, all pairs": force}, "contact force", "N"
    for panel, part in zip(picture, ((lengths, "displacement", "m"), forces), strict=False):
        _stems(panel, solution.subharmonic, *part)
    picture.panels[-1].set_xlabel("order of the harmonic, in load frequencies (0: mean)")
    return picture.finished()


def _stems(
    axes: Axes, loads: int, series: Mapping[str, np.ndarray], quantity: str, unit: str
) -> None:
    """Draw the amplitudes of series of coefficients over a period of so many loads, side by side as
    stems, or as points where they are many."""
    every = {label: np.abs(to_complex(column)) for label, column in series.items()}
    seen = np.array([*every.values()])
    top, most = float(seen.max()) or 1.0, seen.shape[1] - 1
    lowest = np.min(seen, where=seen > 1e-9 * top, initial=0.1 * top)  # what is smaller is rounding
    bottom = 10.0 ** np.floor(np.log10(0.5 * lowest))
    size = 4.5 if most < 25 else 3.0 if most <= 150 else 1.5  # beyond, points without stems
    styles = zip(every.items(), distinct_colours(len(every)), "os", strict=False)
    for number, ((label, values), colour, marker) in enumerate(styles):
        kept = np.flatnonzero(values >= bottom)
        order = (kept + 0.25 * (number - 0.5 * (len(every) - 1))) / loads
        if size > 1.5:
            axes.vlines(order, bottom, values[kept], color=colour, lw=1.2)
        axes.plot(order, values[kept], marker, color=colour, ms=size, label=label)
    axes.set_xlim(-0.5, most / loads + 0.5)
    axes.set_yscale("log")
    axes.set_ylim(bottom, top * (top / bottom) ** 0.08)
    axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, f"amplitude of the\n{quantity}", unit)


def draw_orbits(
    solution: PeriodicSolution,
    dof: int | None = None,
    *,
    instants: int = 2000,
    **where: Unpack[Where],
) -> Figure:
    """Draw the motion in the phase plane, velocity over displacement (collective).

    One panel shows the gap at the mouth (of the first crack; in the middle of a crack inside), one
    the displacement of a dof. The orbit is thick where the crack faces touch there, or in the panel
    of the dof anywhere. A dot marks the beginning of each load period; the motion runs clockwise.

    Parameters
    ----------
    solution, dof
        As of :func:`draw_spectrum`.
    instants : int
        Points of the orbit.
    **where
        ``axes``, one or two, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        As of :func:`draw_spectrum`.

    Examples
    --------
    >>> figure = fc.draw_orbits(solution, tip, path="orbits.png")
    """
    time = np.linspace(0.0, solution.period, instants + 1)
    closed = solution.contact_force(time) > 0.0
    orbits: list[tuple[Motion, np.ndarray, str, str]] = []
    if solution.structure.n_pairs:
        pair = solution.structure.first_watched_pair
        gap, name = lambda time: solution.gap(time)[:, pair], solution.structure.describe_pair(pair)
        orbits.append((gap, closed[:, pair], f"closing {name}", "crack faces touch there"))
    if dof is not None:
        moved, name = partial(solution.displacement, dofs=[dof]), solution.structure.dof_name(dof)
        orbits.append((moved, np.any(closed, axis=1), name, "crack faces touch somewhere"))
    if not orbits:
        raise InputError("dof", None, "given where there is no contact pair")
    count = len(orbits)
    size, comm = (1.0 + 4.2 * count, 4.4), solution.structure.comm
    picture = Picture(count, columns=count, size=size, comm=comm, **where)
    for panel, content in zip(picture, orbits, strict=True):
        _orbit(panel, solution, *content)
    return picture.finished()


Motion = Callable[[np.ndarray], np.ndarray]
"""A displacement at times [s], with the kinks of crack faces, which harmonics round off."""


def _orbit(
    axes: Axes,
    solution: PeriodicSolution,
    motion: Motion,
    closed: np.ndarray,
    quantity: str,
    touching: str,
) -> None:
    """Draw the orbit of one displacement, thick where the crack is closed."""
    step = CENTRAL_DIFFERENCE_STEP * solution.period

    def orbit_at(time: np.ndarray) -> np.ndarray:
        before, now, after = (np.ravel(motion(time + by)) for by in (-step, 0.0, step))
        return np.array([now, (after - before) / (2.0 * step)])

    orbit = orbit_at(np.linspace(0.0, solution.period, len(closed)))
    axes.plot(*orbit, color=COLOURS["blue"], lw=1.4, label="orbit")
    if closed.any():
        axes.plot(*np.where(closed, orbit, np.nan), color=COLOURS["orange"], lw=3.2, label=touching)
    beginnings = orbit_at(2.0 * np.pi / solution.omega * np.arange(solution.subharmonic))
    axes.plot(*beginnings, "o", color="black", ms=5.5, label="a load period begins")
    label_axis(axes.xaxis, quantity, "m")
    label_axis(axes.yaxis, "velocity", "m/s")
    axes.margins(0.08)


LOOPS = 4
"""Pairs whose loops are drawn: those of the largest friction losses."""


def draw_friction_loops(solution: PeriodicSolution, **where: Unpack[Where]) -> Figure:
    """Draw the friction force over the tangential gap of the pairs that lose most by friction, at
    most four, thick where they slip (collective).

    The area of a loop is the loss in a period.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to draw, with friction.
    **where
        ``axes`` (one), ``path``, ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There is no friction, or there are several axes.

    Examples
    --------
    >>> law = fc.CoulombFriction(fc.UnilateralPenalty(1e9), 0.3)
    >>> rubbing = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=20)
    >>> figure = fc.draw_friction_loops(rubbing, path="loops.png")
    """
    coefficient = coefficient_of(solution.contact)
    if coefficient is None:
        raise InputError("solution", "no friction", "one with CoulombFriction")
    time = np.append(solution.instants(), solution.period)
    (_, slide), (normal, drag) = (np.hsplit(one, 2) for one in solution.gaps_and_forces(time))
    slips = is_slipping(coefficient, normal, drag)
    loss = friction_losses(slide, drag)
    [panel] = picture = Picture(size=(6.4, 4.6), comm=solution.structure.comm, **where)
    chosen = np.argsort(-loss, kind="stable")[: min(LOOPS, len(loss))]
    for pair, colour in zip(chosen.tolist(), distinct_colours(len(chosen)), strict=True):
        name = solution.structure.describe_pair(pair).removeprefix("of ")
        label = f"{name}: {quantity(float(loss[pair]), 'J')}"
        panel.plot(slide[:, pair], drag[:, pair], color=colour, lw=1.1, label=label)
        sliding = np.where(slips[:, pair], slide[:, pair], np.nan)
        panel.plot(sliding, drag[:, pair], color=colour, lw=3.2)
    panel.axhline(0.0, color="black", lw=0.6)
    label_axis(panel.xaxis, "tangential gap", "m")
    label_axis(panel.yaxis, "friction force", "N")
    return picture.finished()


def draw_stress_intensity(found: StressIntensity, **where: Unpack[Where]) -> Figure:
    """Draw K_I at each tip over time, grey and thick where the tip is closed, and K_II dashed.

    Of a solid draw two panels: the largest K_I, K_II and K_III, of either sign, along its fronts,
    and all three over time where the effective range is the largest.

    Parameters
    ----------
    found : StressIntensity
        Of :func:`stress_intensity`.
    **where
        ``axes``, ``path``, ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There are several axes.

    Examples
    --------
    >>> figure = fc.draw_stress_intensity(fc.stress_intensity(fc.solve(scene)), path="tips.png")
    """
    count = 1 if found.three is None else 2
    picture = Picture(count, size=(7.0, 1.0 + 3.3 * count), **where)
    if found.three is not None:
        _along_fronts(found, picture.panels[0])
    _over_time(found, picture.panels[-1])
    label_axis(picture.panels[-1].xaxis, "time", "s")
    for panel in picture:
        panel.axhline(0.0, color="black", lw=0.6)
        label_axis(panel.yaxis, "stress intensity", "Pa m^0.5")
    return picture.finished()


def _over_time(found: StressIntensity, panel: Axes) -> None:
    """Draw K of each tip, or of the leading place on the fronts, over the time."""
    time = found.time - found.time[0]
    if found.three is not None:
        kinds = zip(("K_I", "K_II", "K_III"), (found.one, found.two, found.three), strict=True)
        for (kind, values), colour in zip(kinds, distinct_colours(3), strict=True):
            panel.plot(time, values[:, found.leading], color=colour, lw=1.8, label=f"_{kind}")
        panel.set_title(f"at {found.tips[found.leading]}", fontsize="medium")
        return
    shut = "crack tip closed"
    styles = zip(found.tips, distinct_colours(len(found.tips)), strict=True)
    for number, (tip, colour) in enumerate(styles):
        one, two = found.one[:, number], found.two[:, number]
        panel.plot(time, one, color=colour, lw=1.8, label=f"K_I, {tip}")
        panel.plot(time, two, color=colour, lw=1.0, ls="--", label=f"K_II, {tip}")
        closed = np.where(one <= 0.01 * max(one.max(), 0.0), one, np.nan)  # to drawing accuracy
        if not np.all(np.isnan(closed)):
            panel.plot(time, closed, color=COLOURS["grey"], lw=4.0, label=shut)
            shut = "_" + shut.lstrip("_")  # once in the legend


def _along_fronts(found: StressIntensity, panel: Axes) -> None:
    """Draw largest sizes of K over the distance along each front."""
    assert found.three is not None
    kinds = zip(("K_I", "K_II", "K_III"), (found.one, found.two, found.three), strict=True)
    for (kind, values), colour in zip(kinds, distinct_colours(3), strict=True):
        sizes = np.abs(values).max(axis=0)
        for its in found.fronts.values():
            look = {"color": colour, "lw": 1.8, "marker": "o", "label": kind}
            panel.plot(found.positions[its], sizes[its], **look)
            kind = "_" + kind.lstrip("_")  # once in the legend
    label_axis(panel.xaxis, "distance along the front", "m")
