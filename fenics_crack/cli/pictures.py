"""The commands ``plot`` and ``report``: pictures of a result, of several curves in one, files for
ParaView, and an HTML page with pictures, errors and verdicts in words.

Nothing is solved again: all of it follows from the files of the results, their scenes and their
meshes. In the page stand the pictures themselves, and all words are escaped. Matplotlib is loaded
here, and VTK where a mesh is drawn: only these two commands come here.
"""

from __future__ import annotations

import base64
import itertools
import platform
import shlex
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import linear_response
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import passing_folder, write_whole
from fenics_crack.basics.errors import FEW_MODES, InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import Table, percent, readable, with_unit
from fenics_crack.basics.untrusted_files import content_of
from fenics_crack.cli.account import frequency_in_words
from fenics_crack.cli.given import PERIOD, Console, make_writable
from fenics_crack.cli.results import RESULTS, Computed, Identified, account_of, over_time, result_of
from fenics_crack.cli.scenes import harmonics_in_words
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw.figure import Picture, distinct_colours
from fenics_crack.draw.plot import (
    Wave,
    draw_contact_map,
    draw_friction_loops,
    draw_map,
    draw_orbits,
    draw_response,
    draw_spectrum,
    draw_stress_intensity,
    draw_waves,
)
from fenics_crack.draw.plot_curve import draw_content, draw_curve, draw_multipliers
from fenics_crack.draw.plot_mesh import draw_mesh, draw_modes
from fenics_crack.draw.plot_study import draw_growth, draw_verification
from fenics_crack.fatigue.growth import Growth
from fenics_crack.files.store import Stored, read, versions
from fenics_crack.model.contact import friction_of
from fenics_crack.model.modes import LIP_STATES, Modes, n_tied_modes, solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene, unit_of
from fenics_crack.scene.words import WHOLE, differences, given_values, key_in_words, value_in_words
from fenics_crack.study.conclusion import known_to
from fenics_crack.study.prepare import prepare
from fenics_crack.study.run import Run, stress_intensity
from fenics_crack.study.verification import Verification
from fenics_crack.sweep.plan import FREQUENCIES
from fenics_crack.sweep.result import SweepResult
from fenics_crack.time.march import TimeHistory
from fenics_crack.version import VERSION, packaged

STYLES = (("orange", "--"), ("green", "-."), ("pink", ":"))
"""Colour and line of the closing of one crack after the other."""

File = Callable[..., Path]
"""Takes the name of a picture, and its kind if it has only one; remembers and returns its path."""
CAPTIONS = {
    "mesh": "The mesh with its named parts.",
    "modes": "Mode shapes with the crack open. Without contact, so the crack faces may overlap.",
    "solution_waves": "Displacement at the output point, and closing of the crack faces.",
    "solution_spectrum": "Amplitudes of the harmonics; enough are kept if the last are small.",
    "solution_orbits": "The motion in the phase plane; thick where the crack faces touch.",
    "solution_contact_map": "Contact of the crack faces along the crack and over the period.",
    "solution_breathing_crack": "One period, slowed down and magnified as stated above the plate.",
    "solution_tips": "Stress intensity at the crack tips over the period.",
    "curve": "Response. Dashed: unstable; dotted: undecided; faint: large estimated error.",
    "curve_content": "Amplitudes of the lowest harmonics.",
    "curve_multipliers": "The orbit is stable where the largest multiplier is below 1.",
    "growth": "The crack over the cycles; dots are the lengths that were solved.",
    "integration_waves": "The motion in time, its last periods or a free decay.",
    "posterior": "Probability of cracks, given the measurements.",
}
"""Captions of pictures by the names of their files; others have none."""
IN_SHORT = (
    "geometry", "structure", "material", "damping", "crack", "cracks", "contact", "rotation",
    "excitation", "loads", "base", "growth",
)  # fmt: skip
"""Tables of a scene whose keys are listed above its text."""
WHEN = "%d %B %Y, %H:%M %Z"


def plot(given: Namespace, _: None, console: Console) -> None:
    """Pictures of a result, of several curves in one, or of a scene's mesh; by rank 0."""
    results, labels = given.results, given.label
    first, several = results[0], len(results) > 1
    is_scene = first.suffix.lower() == ".toml"
    folder = given.output or (Path("output") / first.stem if is_scene else first.parent)
    make_writable(folder, console.comm)

    def draw() -> list[Path]:
        stored = None if several or is_scene else read(first)
        if several or labels:
            return [_draw_curves(results, labels, folder, console.pictures)]
        if stored is None:
            return [_draw_scene(Scene.load(first), folder, kind=console.pictures)]
        result: Any = result_of(stored)
        return _draw_result(result, folder, console.pictures) + _for_paraview(
            result, folder, console
        )

    with console.stage("pictures"):
        files = on_root(console.comm, draw)
    console.note(*map(str, files))


def report(given: Namespace, _: None, console: Console) -> None:
    """The page of some results, by rank 0."""
    target = given.output or given.results[0].parent / "report.html"
    words = ["fenics-crack", *given.words]
    with console.stage("report"):
        on_root(console.comm, lambda: _write_report(given.results, target, words))
    console.note(str(target))


# --- of one result --------------------------------------------------------------------------------


def _draw_result(result: Computed, folder: Path, kind: str = "png") -> list[Path]:
    """Draw the pictures of a result into a folder; return the files."""
    files: list[Path] = []
    DRAW[result.KIND](result, _file_in(folder, files, kind))
    return files


def _draw_scene(
    scene: Scene, folder: Path, structure: Structure | None = None, kind: str = "png"
) -> Path:
    """Draw the mesh of a scene, which is made unless its structure is there; return the file."""
    file = folder / f"mesh.{kind}"
    structure = structure or prepare(scene, MPI.COMM_SELF, whole=True).structure
    draw_mesh(structure, path=file, title=f"{structure.n_dofs} degrees of freedom")
    return file


def _for_paraview(run: Computed, folder: Path, console: Console) -> list[Path]:
    """Files of modes and of a period; none without a mesh."""
    found = run.result if isinstance(run, Run) else None
    if not isinstance(found, Modes | PeriodicSolution):
        return []
    if found.structure.whole.meshed is None:
        console.note("no mesh: what would be drawn on one is left out")
        return []
    from fenics_crack.draw.vtk import write_modes, write_period  # VTK

    if isinstance(found, Modes):
        file = folder / "modes.vtu"
        write_modes(found, file)
    else:
        file = folder / f"{PERIOD}.pvd"
        write_period(found, file, material=run.scene.material)
    return [file]


def _can_be_drawn(result: Computed) -> bool:
    """Return True if a result can be drawn: a sweep over two or more numbers, if a case of it has
    converged."""
    if not isinstance(result, SweepResult):
        return True
    return bool(_over_numbers(result) and result.converged.any())


def _file_in(folder: Path, files: list[Path], pictures: str) -> File:
    def file(name: str, kind: str = pictures) -> Path:
        files.append(folder / f"{name}.{kind}")
        return files[-1]

    return file


def _modes(run: Run[Modes], file: File) -> None:
    if run.structure.whole.meshed is not None:
        draw_modes(run.result, path=file("modes"))


def _solution(run: Run[PeriodicSolution], file: File) -> None:
    found, dof = run.result, run.watched_dof
    title = f"{frequency_in_words(run.scene, found.omega)}, H = {found.harmonics}"
    if known := known_to(run):
        title += f", error {known.partition(',')[0]}"
    elif found.gap_coefficients.size and found.report.estimated:
        error = "unknown" if found.report.unknown else percent(found.report.total)
        title += f", error {error}"
    if found.stability is not None:
        title += f", {found.stability.verdict}"
    if not found.converged:
        title += ", NOT CONVERGED"
    _waves(run, found.omega, path=file("solution_waves"), title=title)
    draw_spectrum(found, dof, path=file("solution_spectrum"), title=title)
    draw_orbits(found, dof, path=file("solution_orbits"), title=title)
    if friction_of(found.contact) is not None:
        heading = f"Friction, {frequency_in_words(run.scene, found.omega)}"
        draw_friction_loops(found, path=file("solution_friction_loops"), title=heading)
    if run.scene.disk is not None:
        from fenics_crack.draw.plot_disk import draw_wheel

        draw_wheel(found, path=file("solution_wheel"), title=title)
    if found.structure.whole.meshed is not None:
        from fenics_crack.draw.animation import animate_period  # VTK

        if found.gap_coefficients.shape[1] > 1:
            heading = "Where and when the crack is closed"
            draw_contact_map(found, path=file("solution_contact_map"), title=heading)
        animate_period(found, file("solution_breathing_crack", "gif"), material=run.scene.material)
    _tips(run, file)


def _history(run: Run[TimeHistory], file: File) -> None:
    table, load, omega = run.scene.integration, run.scene.excitation.omega, None
    title = "Free decay"
    if table is None or not table.free:
        title = f"The last periods of {run.result.periods}, {frequency_in_words(run.scene, load)}"
        omega = load
    _waves(run, omega, path=file("integration_waves"), title=title)
    _tips(run, file)


def _tips(run: Run[Any], file: File) -> None:
    """Draw the stress intensity at the tips of a plate's cracks, where it is known."""
    with suppress(InputError):  # a tip next to an edge, or no plate
        found = stress_intensity(run)
        of_time = isinstance(run.result, TimeHistory)
        name = f"{'integration' if of_time else 'solution'}_tips"
        factor, unit = readable(float(found.effective.max()), "Pa m^0.5")
        title = f"Stress intensity, range while open {factor * found.effective.max():.4g} {unit}"
        draw_stress_intensity(found, path=file(name), title=title)


def _waves(run: Run, omega: float | None, **where: Any) -> None:
    """Draw the displacement of the load's dof and the gap at the mouths over time, in periods of a
    frequency [rad/s], else in seconds."""
    found, styles = over_time(run), itertools.cycle(STYLES)
    time, touch = found.time - found.time[0], "crack faces touch" if found.closings else None
    waves = [Wave(run.watched_name, time, found.motion[:, 0])]
    for place, wave in found.closings.items():
        waves.append(Wave(f"closing {place}", time, wave, *next(styles)))
    period = None if omega is None else 2.0 * np.pi / omega
    draw_waves(waves, quantity="displacement", period=period, zero=touch, **where)


def _curve(run: Run[ResponseCurve], file: File) -> None:
    found, dof, in_hertz = run.result, run.watched_dof, run.scene.in_hertz
    title = f"{run.watched_name}, {found.method}"
    without = _without_contact(run)
    draw_curve(found, dof, path=file("curve"), title=title, in_hertz=in_hertz, behind=without)
    draw_content(found, dof, path=file("curve_content"), title=title, in_hertz=in_hertz)
    if run.scene.disk is not None:
        from fenics_crack.draw.plot_disk import draw_blades

        heading = f"Every blade, {found.method}"
        draw_blades(found, path=file("curve_blades"), title=heading, in_hertz=in_hertz)
    if found.multipliers is not None:
        title, path = "Largest Floquet multiplier along the curve", file("curve_multipliers")
        draw_multipliers(found, path=path, title=title, in_hertz=in_hertz)


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
    return {label: _linear_line(found.omega, *line) for label, line in lines.items()}


def _linear_line(
    span: np.ndarray, structure: Structure, dof: int, lips: str
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, closer together next to natural ones, and amplitudes of a dof."""
    most = n_tied_modes(structure) if lips == "tied" else structure.n_modes
    modes = solve_modes(structure, min(FEW_MODES, most), lips=lips).omega
    near = np.geomspace(1e-6, 0.1, 30)
    close = np.outer(modes, np.concatenate([1.0 - near, 1.0 + near])).ravel()
    low, high = span.min(), span.max()
    inside = close[(close > low) & (close < high)]
    omega = np.unique(np.concatenate([np.linspace(low, high, 200), inside]))
    return omega, linear_response(structure, dof, omega, lips=lips)


# --- a sweep --------------------------------------------------------------------------------------


def _sweep(found: SweepResult, file: File) -> None:
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


def _over_numbers(found: SweepResult) -> list[int]:
    """Places of the axes of two or more numbers."""
    return [
        place
        for place, axis in enumerate(found.axes)
        if len(axis.values) > 1 and all(isinstance(value, float | int) for value in axis.values)
    ]


def _shown_axes(found: SweepResult) -> list[int]:
    """Places of the one or two axes that are drawn: the frequency, then the longest.

    Raises InputError if no axis has two or more numbers, or no case has converged.
    """
    axes, numbers = found.axes, _over_numbers(found)
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
    file: File,
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
    lines = values.shape[1]
    if few := lines <= 6:
        labels = [name]
        if len(axes) > 1:
            key, at = axes[1].key, places[1][order[1]]
            labels = [f"{key_in_words(key)} {value_in_words(key, float(value))}" for value in at]
        curves, rings = (dict(zip(labels, part.T, strict=True)) for part in (values, doubtful))
        how: dict[str, Any] = {"over": scaled[0][1], "doubtful": rings, "unit": unit}
        path = file(base)
        draw_response(scaled[0][0], curves, quantity=name, path=path, title=title, **how)
    if not few or (len(axes) > 1 and min(values.shape) >= 4):
        (x, x_label), (y, y_label) = scaled
        factor, prefixed = 1.0, unit
        if unit in ("m", "N"):
            factor, prefixed = readable(float(np.nanmax(np.abs(values))), unit)
        words: dict[str, Any] = {"x_label": x_label, "y_label": y_label}
        words["value_label"] = with_unit(name, prefixed)
        path = file(f"{base}_map")
        draw_map(x, y, factor * values.T, doubtful=doubtful.T, path=path, title=title, **words)


def _axis_words(axis: Axis, values: np.ndarray) -> tuple[np.ndarray, str]:
    """The values of an axis as they are drawn, and its label."""
    unit, factor = unit_of(axis.key), 1.0
    if unit and unit not in WHOLE:
        factor, unit = readable(float(np.abs(values).max()), unit)
    return factor * values, with_unit(key_in_words(axis.key), unit)


def _posterior(found: Identified, file: File) -> None:
    """Take the picture that ``identify`` has drawn, which may be written to its own place."""
    path = file("posterior")
    source = found.picture.with_suffix(path.suffix)
    try:
        write_whole(path, content_of(source, links=False))
    except OSError:
        allowed = f"png, or the --pictures of identify: there is no {source}"
        raise InputError("--pictures", path.suffix[1:], allowed) from None


DRAW: dict[str, Callable[[Any, File], object]] = {
    Modes.KIND: _modes,
    PeriodicSolution.KIND: _solution,
    ResponseCurve.KIND: _curve,
    SweepResult.KIND: _sweep,
    TimeHistory.KIND: _history,
    Growth.KIND: lambda found, file: draw_growth(
        found, path=file("growth"), in_hertz=found.scene.in_hertz
    ),
    Identified.KIND: _posterior,
    Verification.KIND: lambda found, file: draw_verification(found, path=file("verify")),
}


# --- several curves -------------------------------------------------------------------------------


def _draw_curves(paths: Sequence[Path], labels: Sequence[str], folder: Path, kind: str) -> Path:
    """Draw the responses of several curves on the same axes; return the file.

    ``labels`` name the results; without any they are called by what differs between their scenes,
    and by their files where nothing does.

    Raises
    ------
    InputError
        The files are no curves in the same parameter, or the labels are not as many.
    """
    if labels and len(labels) != len(paths):
        raise InputError("--label", list(labels), f"given {len(paths)} times, once for each result")
    stored = [read(path) for path in paths]
    if {file.kind for file in stored} != {ResponseCurve.KIND}:
        kinds = [file.kind for file in stored]
        raise InputError("result", kinds, "curves, where several are drawn in one picture")
    found: list[Any] = [*map(result_of, stored)]
    names = list(labels) or differences([one.scene for one in found])
    if len(set(names)) < len(names):
        places = [str(Path(path).with_suffix("")) for path in paths]
        names = [", ".join(filter(None, both)) for both in zip(names, places, strict=True)]
    if len(set(names)) < len(names):
        raise InputError("result", [str(path) for path in paths], "different files")
    if len(parameters := {run.result.parameter for run in found}) > 1:
        raise InputError("result", sorted(parameters), "curves in one parameter")
    watched = {run.watched_name for run in found}
    title = watched.pop() if len(watched) == 1 else None
    [panel] = picture = Picture(size=(7.0, 4.6), path=folder / f"overlay_curve.{kind}", title=title)
    for label, run, colour in zip(names, found, distinct_colours(len(found)), strict=True):
        dof, in_hertz = run.watched_dof, run.scene.in_hertz
        draw_curve(run.result, dof, axes=panel, label=label, colour=colour, in_hertz=in_hertz)
    picture.saved()
    return folder / f"overlay_curve.{kind}"


# --- the page -------------------------------------------------------------------------------------


def _write_report(paths: Sequence[Path], target: Path, command: Sequence[str]) -> None:
    """Write the page of some results.

    Parameters
    ----------
    paths : sequence of Path
        Files of results with their scenes; the page puts them in the order of :data:`RESULTS`.
    target : Path
        The .html file.
    command : sequence of str
        The words of the command that requested it.

    Raises
    ------
    InputError
        A file is no result with a scene, or the page cannot be written.
    """
    if target.suffix.lower() not in (".html", ".htm"):
        raise InputError("--output", str(target), "a .html file")
    from jinja2 import Environment  # which plots do without

    stored = [read(path) for path in dict.fromkeys(paths)]
    both = [(file, result_of(file)) for file in stored]
    both.sort(key=lambda one: list(RESULTS).index(one[0].kind))
    kinds = [file.kind for file, _ in both]
    own = differences([result.scene.replace({"reduction": None}) for _, result in both])
    folder = passing_folder()
    page = _scene(both[0][1], folder)
    parts = [_part(*one, folder / str(number)) for number, one in enumerate(both)]
    for part, kind, differs in zip(parts, kinds, own, strict=True):
        part["differs"] = differs
        if kinds.count(kind) > 1:
            part["heading"] += f": {differs or part['path']}"
    page |= {
        "title": f"Vibration of {both[0][0].path.resolve().parent.name}",
        "under": f"{datetime.now(UTC).astimezone():{WHEN}}, fenics_crack {VERSION}",
        "parts": parts,
        "facts": [text for part in parts for text in (*part["facts"][:1], part["closing"]) if text],
        "doubts": [f"{part['heading']}: {text}" for part in parts for text in part["said"]],
        "versions": _versions([file for file, _ in both]),
        "command": shlex.join(command),
    }
    form = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    write_whole(target, form.from_string(packaged("cli/report.html")).render(page), "--output")


def _part(file: Stored, result: Computed, folder: Path) -> dict[str, Any]:
    """A result as the page shows it."""
    found = account_of(result)
    drawn = _draw_result(result, folder) if _can_be_drawn(result) else []
    written = datetime.fromtimestamp(file.path.stat().st_mtime, UTC).astimezone()
    return {
        "heading": RESULTS[file.kind][0],
        "facts": [*found.facts],
        "said": [*found.warnings, *map(str, found.remarks)],
        "doubts": [*map(_sentence, found.warnings), *found.remarks],  # which begin with a key
        "verdict": found.verdict,
        "pictures": [*map(_picture, drawn)],
        "tables": found.tables,
        "closing": f"{_sentence(found.closing)}." if found.closing else "",
        "path": file.path,
        "written": f"{written:{WHEN}}",
    }


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _scene(result: Computed, folder: Path) -> dict[str, Any]:
    """The scene of a result in short, its mesh if it has one, its text."""
    scene, mesh = result.scene, None
    if scene.geometry is not None:
        own = result.structure.whole if isinstance(result, Run) else None
        mesh = _picture(_draw_scene(scene, folder, own))
    rows: list[tuple[str, object]] = [
        (key_in_words(key), _value(key, value))
        for table in IN_SHORT
        for key, value in given_values(scene).items()
        if key.startswith(f"{table}.")
    ]
    if scene.excitation.order is not None:
        rows.append(("load frequency", frequency_in_words(scene, scene.excitation.omega)))
    rows.append(("harmonics", harmonics_in_words(scene)))
    return {"mesh": mesh, "scene": Table(("quantity", "value"), rows), "toml": scene.as_toml()}


def _value(key: str, value: object) -> str:
    """A value in words; of a vector both parts."""
    if isinstance(value, list):
        return f"{value} {unit_of(key)}".rstrip()
    return value_in_words(key, value)


def _versions(files: Sequence[Stored]) -> Table:
    """List the versions that made the results, and those that made the page."""
    rows = []
    for file in files:
        made = f"fenics_crack {file.attributes['version']}, {file.attributes['versions']}"
        rows.append((str(file.path), made))
    drawn = f"Python {platform.python_version()}, {versions()}, h5py {h5py.__version__}"
    rows.append(("this page", f"fenics_crack {VERSION}, {drawn}"))
    return Table(("file", "made with"), rows)


def _picture(path: Path) -> dict[str, str]:
    """A picture file with its caption, as it is."""
    data = base64.b64encode(content_of(path, None)).decode("ascii")
    return {
        "words": CAPTIONS.get(path.stem, ""),
        "data": f"data:image/{path.suffix[1:]};base64,{data}",
    }
