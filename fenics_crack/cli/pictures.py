"""Pictures of one result of each kind, and its files for ParaView.

Matplotlib is loaded here, and VTK where a mesh is drawn.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.arrivals.fit_order import TipTrack
from fenics_crack.arrivals.harmonics import TipFit
from fenics_crack.balance.harmonic_balance import linear_response
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import write_whole
from fenics_crack.basics.errors import FEW_MODES, InputError
from fenics_crack.basics.tables import percent, readable, with_unit
from fenics_crack.basics.untrusted_files import content_of
from fenics_crack.cli.drawn import Drawn
from fenics_crack.cli.given import PERIOD
from fenics_crack.cli.results import Waves, waves_of
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw import plot, plot_curve, plot_mesh, plot_study
from fenics_crack.fatigue.growth import Growth
from fenics_crack.model.contact import friction_of
from fenics_crack.model.modes import LIP_STATES, NEGLIGIBLE, Modes, count_bonded_modes, solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.monitoring.identification.report import IdentificationOutput
from fenics_crack.monitoring.timing import Timing, find_largest_blade
from fenics_crack.runs.conclusion import describe_error, frequency_in_words
from fenics_crack.runs.run import Run
from fenics_crack.runs.stress_intensity import stress_intensity
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene, unit_of
from fenics_crack.scene.words import WHOLE, key_in_words, value_in_words
from fenics_crack.study.campbell import ORDERS, Campbell
from fenics_crack.study.prepare import prepare
from fenics_crack.sweep.plan import FREQUENCIES
from fenics_crack.sweep.result import SweepResult
from fenics_crack.time.march import TimeHistory

STYLES = (("orange", "--"), ("green", "-."), ("pink", ":"))
"""Colour and line of the closing of one crack after the other."""

NO_MESH = "no mesh: what would be drawn on one is left out"


def draw_scene(
    scene: Scene, folder: Path, structure: Structure | None = None, kind: str = "png"
) -> Path:
    """Draw the mesh of a scene, which is made unless its structure is there; return the file."""
    file = folder / f"mesh.{kind}"
    structure = structure or prepare(scene, MPI.COMM_SELF, whole=True).structure
    plot_mesh.draw_mesh(structure, path=file, title=f"{structure.n_dofs} degrees of freedom")
    return file


def draw_modes_of(run: Run[Modes], file: Drawn) -> None:
    """Draw the shapes of modes that have a mesh."""
    if run.structure.whole.drawable_nodes is None:
        file.notes.append(NO_MESH)
        return
    words = "Mode shapes with the crack open. Without contact, so the crack faces may overlap."
    plot_mesh.draw_modes(run.result, path=file("modes", words))
    if file.meshes:
        from fenics_crack.draw.vtk import write_modes  # VTK

        write_modes(run.result, file("modes", "", "vtu"))


def draw_solution(run: Run[PeriodicSolution], file: Drawn) -> None:
    """Draw a period of a solution, its harmonics, and where it moves."""
    found, dof = run.result, run.watched_dof
    title = f"{frequency_in_words(run.scene, found.omega)}, H = {found.harmonics}"
    if known := describe_error(run):
        title += f", error {known.partition(',')[0]}"
    elif found.gap_coefficients.size and found.report.estimated:
        title += f", error {'unknown' if found.report.unknown else percent(found.report.total)}"
    if found.stability is not None:
        title += f", {found.stability.verdict}"
    if not found.converged:
        title += ", NOT CONVERGED"
    words = "Displacement at the output point, and closing of the crack faces."
    _waves(run, waves_of(run), found.omega, path=file("solution_waves", words), title=title)
    words = "Amplitudes of the harmonics; enough are kept if the last are small."
    plot.draw_spectrum(found, dof, path=file("solution_spectrum", words), title=title)
    words = "The motion in the phase plane; thick where the crack faces touch."
    plot.draw_orbits(found, dof, path=file("solution_orbits", words), title=title)
    if friction_of(found.contact) is not None:
        heading = f"Friction, {frequency_in_words(run.scene, found.omega)}"
        words = "Friction force over the sliding of the crack faces; the area is the energy lost."
        plot.draw_friction_loops(found, path=file("solution_friction_loops", words), title=heading)
    if run.scene.disk is not None:
        from fenics_crack.disk.plot_disk import draw_wheel

        words = "The wheel where it moves most, magnified; cracked blades have orange numbers."
        draw_wheel(found, path=file("solution_wheel", words), title=title)
    if found.structure.whole.drawable_nodes is None:
        file.notes.append(NO_MESH)
    else:
        _on_mesh(run, file)
    _tips(run, file, "solution_tips")


def _on_mesh(run: Run[PeriodicSolution], file: Drawn) -> None:
    """Draw what needs a mesh: contact along the crack, and the motion."""
    from fenics_crack.draw.animation import animate_period  # VTK

    found, material = run.result, run.scene.material
    if found.gap_coefficients.shape[1] > 1:
        heading = "Where and when the crack is closed"
        words = "Contact of the crack faces along the crack and over the period."
        plot.draw_contact_map(found, path=file("solution_contact_map", words), title=heading)
    words = "One period, slowed down and magnified as stated above the plate."
    animate_period(found, file("solution_breathing_crack", words, "gif"), material=material)
    if file.meshes:
        from fenics_crack.draw.vtk import write_period

        write_period(found, file(PERIOD, "", "pvd"), material=material)


def draw_history(run: Run[TimeHistory], file: Drawn) -> None:
    """Draw a motion in time."""
    table, load, omega = run.scene.integration, run.scene.excitation.omega, None
    title = "Free decay"
    if table is None or not table.free:
        title = f"The last periods of {run.result.periods}, {frequency_in_words(run.scene, load)}"
        omega = load
    words = "The motion in time, its last periods or a free decay."
    _waves(run, waves_of(run), omega, path=file("integration_waves", words), title=title)
    _tips(run, file, "integration_tips")


def _tips(run: Run[Any], file: Drawn, name: str) -> None:
    """Draw the stress intensity at the tips of a plate's cracks, where it is known."""
    with suppress(InputError):  # a tip next to an edge, or no plate
        found = stress_intensity(run)
        factor, unit = readable(float(found.effective.max()), "Pa m^0.5")
        title = f"Stress intensity, range while open {factor * found.effective.max():.4g} {unit}"
        words = "Stress intensity at the crack tips over the period."
        plot.draw_stress_intensity(found, path=file(name, words), title=title)
        if found.three is not None and file.meshes:
            from fenics_crack.draw.vtk import write_fronts

            write_fronts(found, file(f"{name}_along_fronts", "", "vtu"))


def _waves(run: Run, found: Waves, omega: float | None, **where: Any) -> None:
    """Draw the displacement of the load's dof and the gap at the mouths over time, in periods of a
    frequency [rad/s], else in seconds."""
    styles = itertools.cycle(STYLES)
    time, touch = found.time - found.time[0], "crack faces touch" if found.closings else None
    waves = [plot.Wave(run.watched_name, time, found.motion[:, 0])]
    for place, wave in found.closings.items():
        waves.append(plot.Wave(f"closing {place}", time, wave, *next(styles)))
    period = None if omega is None else 2.0 * np.pi / omega
    plot.draw_waves(waves, quantity="displacement", period=period, zero=touch, **where)


def draw_curve_of(run: Run[ResponseCurve], file: Drawn) -> None:
    """Draw a curve, its harmonics and its multipliers."""
    found, dof, in_hertz = run.result, run.watched_dof, run.scene.in_hertz
    title, without = f"{run.watched_name}, {found.method}", _without_contact(run)
    words = "Response. Dashed: unstable; dash-dotted: irregular; dotted: undecided; "
    words += "faint: large estimated error."
    if found.multipliers is None:
        words = "Response; its stability was not examined. Faint: large estimated error."
    path = file("curve", words)
    plot_curve.draw_curve(found, dof, path=path, title=title, in_hertz=in_hertz, behind=without)
    path = file("curve_content", "Amplitudes of the lowest harmonics.")
    plot_curve.draw_content(found, dof, path=path, title=title, in_hertz=in_hertz)
    if run.scene.disk is not None:
        from fenics_crack.disk.plot_disk import draw_blades

        heading = f"Every blade, {found.method}"
        path = file("curve_blades", "Response of every blade; cracked blades are orange.")
        draw_blades(found, path=path, title=heading, in_hertz=in_hertz)
    if found.multipliers is not None:
        words = "The orbit is stable where the largest multiplier is below 1."
        title, path = "Largest Floquet multiplier along the curve", file("curve_multipliers", words)
        plot_curve.draw_multipliers(found, path=path, title=title, in_hertz=in_hertz)


def _without_contact(run: Run[ResponseCurve]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the curves over the frequency without contact: crack always open, always bonded, and
    the plate without the crack if the program meshes it: frequencies [rad/s], amplitudes [m]."""
    found, scene, structure = run.result, run.scene, run.structure
    if found.parameter != "omega":
        return {}
    words = {"open": "open", "tied": "bonded"}
    lines = {f"crack always {words[n]}": (structure, run.watched_dof, n) for n in LIP_STATES}
    if scene.geometry is not None and scene.geometry.width is not None:
        no_crack = dict.fromkeys(
            ("crack", "cracks", "contact", "sweep", "identify", "growth", "output.quantities")
        )
        whole = prepare(scene.replace(no_crack), MPI.COMM_SELF)
        lines["no crack"] = whole.structure, whole.watched[0].dof, "open"
    drawn = {label: _linear_line(found.omega, *line) for label, line in lines.items()}
    least = NEGLIGIBLE * np.max(found.amplitude(run.watched_dof))  # what is less is still
    return {label: line for label, line in drawn.items() if np.max(line[1]) > least}


def _linear_line(
    span: np.ndarray, structure: Structure, dof: int, lips: str
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, closer together next to natural ones, and amplitudes of a dof."""
    most = count_bonded_modes(structure) if lips == "tied" else structure.n_modes
    modes = solve_modes(structure, min(FEW_MODES, most), lips=lips).omega
    near = np.geomspace(1e-6, 0.1, 30)
    close = np.outer(modes, np.concatenate([1.0 - near, 1.0 + near])).ravel()
    low, high = span.min(), span.max()
    inside = close[(close > low) & (close < high)]
    omega = np.unique(np.concatenate([np.linspace(low, high, 200), inside]))
    return omega, linear_response(structure, dof, omega, lips=lips)


# --- a sweep --------------------------------------------------------------------------------------


def draw_sweep(found: SweepResult, file: Drawn) -> None:
    """Draw the quantities of a sweep over the swept numbers.

    To the right goes the frequency, else the longest axis. The next in length gets a line for each
    value if these are few, and makes a map if they are not too few. Each combination of the other
    axes has its own pictures, up to a limit. Raises InputError as :func:`_shown_axes`.
    """
    shown = _shown_axes(found)
    axes = [found.axes[place] for place in shown]
    others = [place for place in range(len(found.axes)) if place not in shown]

    def pages(values: np.ndarray) -> np.ndarray:
        """Values by picture, then to the right, then up if there are two axes: (n, x, y)."""
        sizes = [*(len(axis.values) for axis in axes), 1][:2]
        return values.transpose(*others, *shown).reshape(-1, *sizes)

    doubtful = pages(found.converged & (found.not_stable | found.inexact))
    fixed = itertools.product(*(found.axes[place].values for place in others))
    for number, at in enumerate(itertools.islice(fixed, 12)):  # of each quantity
        keys = [found.axes[place].key for place in others]
        words = [f"{key_in_words(k)} {value_in_words(k, v)}" for k, v in zip(keys, at, strict=True)]
        for name, quantity in found.quantities.items():
            values = pages(np.where(found.converged, found[name], np.nan))[number]
            if np.any(np.isfinite(values)):
                base = f"sweep_{name}{f'_{number + 1}' if others else ''}"
                draw_swept(axes, values, doubtful[number], quantity, file, base, words)


def _shown_axes(found: SweepResult) -> list[int]:
    """Places of the one or two axes that are drawn: the frequency, then the longest.

    Raises InputError if no axis has two or more numbers, or no case has converged.
    """
    axes = found.axes
    numbers = [
        place
        for place, axis in enumerate(axes)
        if len(axis.values) > 1 and all(isinstance(value, float | int) for value in axis.values)
    ]
    if not numbers:
        raise InputError("sweep.over", [a.key for a in axes], "over numbers, to be drawn")
    if not np.any(found.converged):
        raise InputError("path", str(found.path), "a sweep with a case that converged")
    numbers.sort(key=lambda place: (axes[place].key not in FREQUENCIES, -len(axes[place].values)))
    return numbers[:2]


def draw_swept(
    axes: Sequence[Axis],
    values: np.ndarray,
    doubtful: np.ndarray,
    quantity: tuple[str, str],
    file: Drawn,
    base: str,
    where: Sequence[str] = (),
) -> None:
    """Draw lines, a map, or both of values (x, y) over one axis or two, and where they are
    doubtful; ``quantity`` is their name and unit, ``where`` says what else is fixed."""
    places = [np.array(axis.values, dtype=float) for axis in axes]
    order = [np.argsort(place) for place in places]
    across = np.ix_(*[*order, np.zeros(1, dtype=int)][:2])
    values, doubtful = values[across], doubtful[across]
    scaled = [_axis_words(axis, at[by]) for axis, at, by in zip(axes, places, order, strict=True)]
    name, unit = quantity
    title = ", ".join([f"{name[0].upper()}{name[1:]}", *where])
    lines, over = values.shape[1], " and ".join(key_in_words(axis.key) for axis in axes)
    sentence = f"{title}, over the {over}; rings: large error, or not stable."
    if few := lines <= 6:
        labels = [name]
        if len(axes) > 1:
            key, at = axes[1].key, places[1][order[1]]
            labels = [f"{key_in_words(key)} {value_in_words(key, float(value))}" for value in at]
        curves, rings = (dict(zip(labels, part.T, strict=True)) for part in (values, doubtful))
        how: dict[str, Any] = {"over": scaled[0][1], "doubtful": rings, "unit": unit}
        path = file(base, sentence)
        plot.draw_response(scaled[0][0], curves, quantity=name, path=path, title=title, **how)
    if not few or (len(axes) > 1 and min(values.shape) >= 4):
        (x, x_label), (y, y_label) = scaled
        factor, prefixed = 1.0, unit
        if unit in ("m", "N"):
            factor, prefixed = readable(float(np.nanmax(np.abs(values))), unit)
        words: dict[str, Any] = {"x_label": x_label, "y_label": y_label}
        words["value_label"] = with_unit(name, prefixed)
        path = file(f"{base}_map", sentence)
        plot.draw_map(x, y, factor * values.T, doubtful=doubtful.T, path=path, title=title, **words)


def _axis_words(axis: Axis, values: np.ndarray) -> tuple[np.ndarray, str]:
    """The values of an axis as they are drawn, and its label."""
    unit, factor = unit_of(axis.key), 1.0
    if unit and unit not in WHOLE:
        factor, unit = readable(float(np.abs(values).max()), unit)
    return factor * values, with_unit(key_in_words(axis.key), unit)


def draw_growth_of(found: Growth, file: Drawn) -> None:
    """Draw the growth of a crack in the units of its scene."""
    words = "The crack over the cycles; dots are the lengths that were solved."
    plot_study.draw_growth(found, path=file("growth", words), in_hertz=found.scene.in_hertz)


def draw_campbell_of(found: Campbell, file: Drawn) -> None:
    """Draw a Campbell diagram in the units of its scene."""
    scene = found.scene
    orders = sorted({*range(1, ORDERS + 1), scene.excitation.order or 1})
    words = "Natural frequencies over the speed; circles where engine orders, grey, meet them."
    how: dict[str, Any] = {"in_hertz": scene.in_hertz or scene.in_rpm, "in_rpm": scene.in_rpm}
    plot_study.draw_campbell(found, orders, path=file("campbell", words), **how)


def draw_timing(found: Timing, file: Drawn) -> None:
    """Draw the resonances that each blade passes, a run-up, or the blade that vibrates most."""
    words = "Displacements at the probes over the speed; resonances with their engine orders."
    for number, (blade, arrivals) in enumerate(found.arrivals.items()):
        fit, name = found.fits[blade], f"timing_blade_{blade}" if number else "timing"
        if isinstance(fit, tuple):
            plot_study.draw_passages(fit, arrivals, path=file(name, words))
        elif isinstance(fit, TipTrack):
            words = "Amplitudes over the load's frequency, with their standard errors."
            in_hertz = found.scene is not None and found.scene.in_hertz
            plot_study.draw_tip_track(fit, path=file(name, words), in_hertz=in_hertz)
    if largest := find_largest_blade(found):
        words = f"Blade {largest}: arrivals over the period, the fit, the orders that were tried."
        fit = found.fits[largest]
        assert isinstance(fit, TipFit)
        plot_study.draw_tip_fit(fit, found.arrivals[largest], path=file("timing", words))


def draw_identified(found: IdentificationOutput, file: Drawn) -> None:
    """Take the picture that ``identify`` has drawn, which may be written to its own place."""
    path = file("posterior", "Probability of cracks, given the measurements.")
    source = found.picture.with_suffix(path.suffix)
    try:
        write_whole(path, content_of(source, links=False))
    except OSError:
        allowed = f"png, or the --pictures of identify: there is no {source}"
        raise InputError("--pictures", path.suffix[1:], allowed) from None


# --- several curves -------------------------------------------------------------------------------
