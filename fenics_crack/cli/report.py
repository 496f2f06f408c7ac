"""A report: results with their pictures, their errors and verdicts in words, in one HTML page.

Nothing is solved again: what stands in the page follows from the files of the results, their scenes
and their meshes.
"""

from __future__ import annotations

import platform
import shlex
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli import tables
from fenics_crack.cli.judgements import of_cases, of_curve, of_error, of_stability, of_tolerance
from fenics_crack.cli.pictures import draw_run, draw_scene
from fenics_crack.cli.scenes import harmonics_in_words
from fenics_crack.cli.sweep_pictures import draw_sweep
from fenics_crack.curves.curve import ResponseCurve, parameter_axis
from fenics_crack.draw import html
from fenics_crack.errors import InputError
from fenics_crack.files.store import header, kind_of, read_scene, versions
from fenics_crack.model.modes import Modes
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Crack, Geometry, Integration, Material
from fenics_crack.scene.words import differences, key_in_words
from fenics_crack.study.run import Run, load_run
from fenics_crack.sweep.file import KIND as SWEEP
from fenics_crack.sweep.result import SweepResult
from fenics_crack.table import Table, frequency_axis, quantity
from fenics_crack.time.march import TimeHistory
from fenics_crack.version import VERSION
from fenics_crack.whole import write_whole

__all__ = ["write_report"]

KINDS = {
    Modes.KIND: "Natural frequencies and modes",
    PeriodicSolution.KIND: "Steady vibration",
    ResponseCurve.KIND: "Response curve",
    SWEEP: "Sweep",
    TimeHistory.KIND: "Motion in time",
}
"""Headings by kind, in the order of the page."""
CAPTIONS = {
    "modes": "Mode shapes with the crack open. No contact acts in them, so the lips may overlap.",
    "solution_waves": "The displacement that is watched, and the closing of the lips.",
    "solution_spectrum": "Amplitudes of the harmonics. There are enough of them where they have "
    "fallen far.",
    "solution_orbits": "The motion in the phase plane; thick where the lips touch.",
    "solution_contact_map": "Where along the crack and when in the period the lips touch.",
    "solution_breathing_crack": "One period, slowed down and magnified as stated above the plate.",
    "curve": "Response. Dashed: unstable; dotted: undecided; faint: large estimated error.",
    "curve_content": "Amplitudes of the lowest harmonics.",
    "curve_multipliers": "The orbit is stable where the largest multiplier is below 1.",
    "integration_waves": "The last periods of the motion in time.",
}
"""Below the pictures, by the names of their files; others speak for themselves."""
ROUNDING = 1e-15
"""Lengths [m] and forces [N] up to this are written as 0."""


def write_report(paths: Sequence[Path], target: Path, command: Sequence[str]) -> None:
    """Write the page of some results.

    Parameters
    ----------
    paths : sequence of Path
        Files of results with their scenes; the page puts them in the order of :data:`KINDS`.
    target : Path
        The .html file.
    command : sequence of str
        The words of the command that asked for it.

    Raises
    ------
    InputError
        A file is no result with a scene, or the page cannot be written.
    """
    if target.suffix.lower() not in (".html", ".htm"):
        raise InputError("--output", str(target), "a .html file")
    order = list(KINDS)
    kinds = {Path(path): kind_of(path) for path in paths}
    for path, kind in kinds.items():
        if kind not in order:
            raise InputError("result", str(path), f"one of these kinds: {', '.join(order)}")
    files = sorted(kinds, key=lambda path: order.index(kinds[path]))
    scenes = [_scene_of(path) for path in files]
    titles, parts, facts, doubts = {"short": "In short", "scene": "Scene"}, [], [], []
    with tempfile.TemporaryDirectory() as folder:
        scene_part = _scene_part(scenes[0], Path(folder))
        own = differences([scene.replace({"reduction": None}) for scene in scenes])
        for number, (path, differs) in enumerate(zip(files, own, strict=True), 1):
            place, heading = Path(folder) / str(number), KINDS[kinds[path]]
            place.mkdir()
            if sum(kinds[other] == kinds[path] for other in files) > 1:
                heading += f": {differs or path}"
            found = _read(path, kinds[path], place)
            blocks = [html.paragraph(f"In this result {differs}.", "small")] if differs else []
            doubtful = [f"{text[0].upper()}{text[1:]}" for text in found.doubts]
            blocks += [html.points(found.facts), html.points(doubtful, "doubtful")]
            blocks += [*found.blocks, html.paragraph(f"From {path}, {_made(path)}.", "small")]
            titles[f"result-{number}"] = heading
            parts.append(html.section(f"result-{number}", heading, blocks))
            facts += found.facts[:1]
            doubts += [f"{heading}: {text}" for text in found.doubts]
    titles["versions"] = "Versions"
    short = [html.points(facts), html.points(doubts, "doubtful")]
    if not doubts:
        short.append(html.paragraph("The program warned of nothing.", "good"))
    blocks = [html.section("short", "In short", short), scene_part, *parts]
    blocks.append(_versions_part(files, command))
    stem = files[0].resolve().parent.name
    under = f"{datetime.now(UTC).astimezone():%d %B %Y, %H:%M %Z}, fenics_crack {VERSION}"
    text = html.page(f"Breathing crack: {stem}", under, [html.contents(titles), *blocks])
    write_whole(target, text, "--output")


def _scene_of(path: Path) -> Scene:
    scene = read_scene(path)
    if scene is None:
        raise InputError("result", str(path), "a result saved with its scene")
    return scene


# --- parts ----------------------------------------------------------------------------------------


def _scene_part(scene: Scene, folder: Path) -> str:
    """The scene in short, its mesh if it has one, and its text."""
    rows: list[tuple[str, object]] = []
    blocks = []
    if scene.geometry is not None and scene.material is not None:
        [mesh] = draw_scene(scene, folder)
        blocks.append(html.picture(mesh, "The mesh with its named parts."))
        rows = _plate_in_short(scene.geometry, scene.material, [*scene.all_cracks.values()])
    if scene.contact is not None:
        rows.append(("contact", scene.contact.law))
    factor, name, unit = frequency_axis(scene.in_hertz)
    rows.append((name, f"{factor * scene.excitation.omega:.6g} {unit}"))
    rows.append(("harmonics", harmonics_in_words(scene)))
    blocks.append(html.table(Table(("quantity", "value"), rows), "The first result's scene"))
    text = html.folded("The whole scene (TOML)", scene.as_toml())
    return html.section("scene", "Scene", [html.beside(blocks), text])


def _plate_in_short(
    geometry: Geometry, material: Material, cracks: Sequence[Crack]
) -> list[tuple[str, object]]:
    """Sizes, material and cracks of a plate."""
    sizes = [
        quantity(size, "m")
        for size in (geometry.width, geometry.height, geometry.thickness)
        if size is not None
    ]
    rows: list[tuple[str, object]] = [
        ("plate" if len(sizes) == 3 else "thickness", " × ".join(sizes)),
        ("Young's modulus", quantity(material.young, "Pa")),
        ("Poisson's ratio", material.poisson),
        ("density", f"{material.density:g} kg/m³"),
    ]
    for number, crack in enumerate(cracks, 1):
        name = f"crack {number}" if len(cracks) > 1 else "crack"
        if crack.length is not None and geometry.width is not None:
            share = f"{crack.length / geometry.width:.0%} of the width"
            rows.append((name, f"{quantity(crack.length, 'm')}, {share}"))
    return rows


@dataclass(frozen=True)
class _Found:
    """What there is to say of a result: sentences, the first of them in short; and blocks."""

    facts: list[str]
    doubts: list[str]
    blocks: list[str]


def _read(path: Path, kind: str, folder: Path) -> _Found:
    """Read a result and draw its pictures into a folder."""
    if kind == SWEEP:
        return _of_sweep(SweepResult.load(path), folder)
    run = load_run(path, MPI.COMM_SELF)
    pictures = [
        html.picture(file, CAPTIONS.get(file.stem, ""))
        for file in draw_run(run, folder, paraview=False)
    ]
    say: dict[type, Any] = {
        Modes: _of_modes,
        PeriodicSolution: _of_solution,
        ResponseCurve: _of_curve,
        TimeHistory: _of_history,
    }
    found: _Found = say[type(run.result)](run, pictures)
    return found


def _of_modes(run: Run[Modes], pictures: list[str]) -> _Found:
    first = float(run.result.omega[0])
    hertz = first / (2.0 * np.pi)
    fact = f"The first natural frequency with the crack open is {hertz:.5g} Hz ({first:.5g} rad/s)."
    table = html.table(run.result.table(), "Natural frequencies with the crack open")
    return _Found([fact], [], [*pictures, table])


def _of_solution(run: Run[PeriodicSolution], pictures: list[str]) -> _Found:
    found = run.result
    size = quantity(found.amplitude(run.watched_dof), "m")
    fact = f"At {_frequency(run, found.omega)} the {run.watched_name} is {size} half peak-to-peak"
    if found.gap_coefficients.size:
        values = found.to_dict()
        fact += f"; the crack opens by {quantity(values['opening'], 'm')} and is closed for "
        fact += f"{values['closed_share']:.0%} of the period"
    scene, errors = run.scene, _errors_in_words(found)
    doubts = of_tolerance(scene, found) if found.converged else [f"not converged: {found.status}"]
    if found.gap_coefficients.size and not doubts:
        doubts += of_error(scene, found.report, found.harmonics)
    doubts += of_stability(scene, run, found.stability)
    verdict = html.paragraph(*_verdict(found))
    rows = Table(("quantity", "value"), [_readable(*row) for row in _rows_of(run)])
    return _Found(
        [f"{fact}.", *errors], doubts, [verdict, *pictures, html.table(rows, "In numbers")]
    )


def _rows_of(run: Run[Any]) -> list[Any]:
    """Name, value and unit of the numbers of a solution or a motion in time."""
    of_history = isinstance(run.result, TimeHistory)
    table = tables.history_quantities(run) if of_history else tables.solution_quantities(run)
    return [row[-3:] for row in table.rows if row[-2] == row[-2]]  # without nan


def _readable(name: str, value: Any, unit: str) -> tuple[str, Any]:
    """A quantity and its value as one reads it: "7.916 µm", "5.7 % of the lips' motion"."""
    known = isinstance(value, float) and np.isfinite(value)
    if known and unit in ("m", "N"):
        return name, quantity(value, unit) if abs(value) > ROUNDING else f"0 {unit}"
    if known and unit.startswith("of "):
        return name, f"{100.0 * value:.2g} % {unit}"
    words = f"{value:.6g}" if known else {True: "yes", False: "no"}.get(value, value)
    return name, words if unit in ("-", "1", "") else f"{words} {unit}"


def _frequency(run: Run[Any], omega: float) -> str:
    """A load frequency in the scene's unit."""
    factor, _, unit = frequency_axis(run.scene.in_hertz)
    return f"{factor * omega:.6g} {unit}"


def _verdict(found: PeriodicSolution) -> tuple[str, str]:
    """Whether the vibration lasts, and the kind of this verdict."""
    if not found.converged:
        return "Not converged: there is no orbit to be judged.", "bad"
    if found.stability is None:
        return "The stability was not examined.", "doubtful"
    size, reason = float(np.abs(found.stability.multipliers).max()), found.stability.reason
    text, kind = {
        "stable": ("Stable: a small disturbance dies out", "good"),
        "unstable": ("Unstable: a small disturbance grows, and a motion in time leaves it", "bad"),
    }.get(
        found.stability.verdict, (f"Undecided: {reason or 'more harmonics may decide'}", "doubtful")
    )
    return f"{text} (largest multiplier {size:.6g}).", kind


def _errors_in_words(found: PeriodicSolution) -> list[str]:
    """The error report, sentence by sentence."""
    report = found.report
    if not found.gap_coefficients.size:
        return ["There is no contact: the solution is exact for its mesh and modes."]
    causes = {
        "the harmonics left out": report.truncation,
        "the modes left out": report.reduction,
        "contact forces taken from samples": report.sampling,
        "equations not solved exactly": report.residual,
    }
    name = max(causes, key=causes.__getitem__)
    texts = [
        f"The motion of the lips is known to about {report.total:.2%}; most of that is due to "
        f"{name} ({causes[name]:.2%}).",
        f"The displacement at the load is known to about {report.displacement:.2%}.",
    ]
    if report.penetration > 0.0:
        texts.append(
            f"The contact law lets the lips penetrate by {report.penetration:.2%} of their motion; "
            "this belongs to the law, and is no error of its solution."
        )
    return texts


def _of_curve(run: Run[ResponseCurve], pictures: list[str]) -> _Found:
    found = run.result
    factor, _, unit = parameter_axis(found.parameter, run.scene.in_hertz)
    unit = f" {unit}".removesuffix(" -")
    amplitude = found.amplitude(run.watched_dof)
    peak = int(np.argmax(amplitude))
    facts = [
        f"The largest response of the curve, {quantity(float(amplitude[peak]), 'm')} half "
        f"peak-to-peak ({run.watched_name}), is at {factor * found.values[peak]:.6g}{unit}."
    ]
    if found.multipliers is not None:
        states = ("stable", "unstable", "undecided")
        shares = [f"{np.mean(found.verdicts == state):.0%} {state}" for state in states]
        facts.append(f"Of {len(found)} points {', '.join(shares)}.")
    inexact = found.displacement_errors > LARGE_ERROR
    if inexact.any():
        ends = factor * found.values[inexact]
        facts.append(
            f"At {np.mean(inexact):.0%} of the points, between {ends.min():.6g} and "
            f"{ends.max():.6g}{unit}, the estimated error of the displacement is above "
            f"{LARGE_ERROR:.0%}; these are faint in the picture."
        )
    special = tables.in_short(tables.special_points(run), run.scene, tables.SHORT_CURVE)
    points = html.table(special, "Special points")
    return _Found(facts, [*of_curve(run)], [*pictures, points])


def _of_history(run: Run[TimeHistory], pictures: list[str]) -> _Found:
    found = run.result
    asked = (run.scene.integration or Integration()).settle
    change = f"the last period changed the gaps by {found.settled:.2g}"
    facts, doubts = [f"The motion in time has settled after {found.periods} periods: {change}."], []
    if not found.settled <= asked:
        facts = [f"The motion in time was followed over {found.periods} periods."]
        doubts = [f"it has not settled: {change}, more than {asked:g}."]
    rows = Table(("quantity", "value"), [_readable(*row) for row in _rows_of(run)])
    return _Found(facts, doubts, [*pictures, html.table(rows, "In numbers")])


def _of_sweep(found: SweepResult, folder: Path) -> _Found:
    counts = [f"{len(axis.values)} values of {key_in_words(axis.key)}" for axis in found.axes]
    swept = ", ".join(counts)
    facts = [
        f"Of the sweep ({swept}) {int(found.converged.sum())} of {found['state'].size} cases "
        f"converged, {len(found.failed)} failed."
    ]
    rows, more = tables.few_cases(found)
    blocks = [html.table(rows, f"Cases{more}")]
    blocks += [html.picture(path, "") for path in draw_sweep(found, folder)]
    if found.failed:
        failed = [(str(index), reason) for index, reason in found.failed]
        blocks.append(html.table(Table(("case", "reason"), failed), "Failed cases"))
    return _Found(facts, [*of_cases(found)], blocks)


def _versions_part(files: Sequence[Path], command: Sequence[str]) -> str:
    """What made the results, and what made the page."""
    rows = []
    for path in files:
        attributes = header(path).attributes
        made = f"fenics_crack {attributes['version']}, {attributes['versions']}"
        rows.append((str(path), made))
    drawn = f"Python {platform.python_version()}, {versions()}, h5py {h5py.__version__}"
    rows.append(("this page", f"fenics_crack {VERSION}, {drawn}"))
    blocks = [
        html.table(Table(("file", "made with"), rows), "What computed the results"),
        html.paragraph(f"Command: {shlex.join(command)}"),
    ]
    return html.section("versions", "Versions", blocks)


def _made(path: Path) -> str:
    """When a file was written."""
    when = datetime.fromtimestamp(path.stat().st_mtime, UTC).astimezone()
    return f"written on {when:%d %B %Y, %H:%M %Z}"
