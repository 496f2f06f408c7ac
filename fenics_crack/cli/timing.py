"""The command ``timing``: arrival times of a blade tip, and the vibration found in them."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.arrivals.arrival_times import (
    ArrivalTimes,
    has_probe_angles,
    read_record,
    write_record,
)
from fenics_crack.arrivals.harmonics import TipFit
from fenics_crack.basics.errors import Exit, InputError
from fenics_crack.basics.progress import within
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import counted, speed_in_words
from fenics_crack.cli.account import of_error, of_stability
from fenics_crack.cli.commands import tell
from fenics_crack.cli.given import Console, Inputs, changes, keep_before, make_writable, one_of
from fenics_crack.cli.kinds import report_of
from fenics_crack.draw.plot_study import draw_arrivals
from fenics_crack.monitoring import scene_timing
from fenics_crack.monitoring.timing import Timing
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import TipTiming

RECORD_KEYS = (
    "tip_radius", "probes", "orders", "stiffening", "frequencies", "fitted_harmonics",
    "subharmonic", "angle_deviation",
)  # fmt: skip
"""Keys of [tip_timing] for a record in place of a scene."""
MEDIANS = (
    "given for a record at constant speed: without them a probe stands at its median arrival, "
    "where an engine order of constant amplitude is not seen"
)


def timing(given: Namespace, inputs: Inputs | None, console: Console) -> Exit:
    """Compute arrival times unless they are measured, and fit a vibration to them."""
    if inputs is None:
        return _record(given, console)
    scene, folder, source = inputs.scene, inputs.folder, inputs.arrivals
    table, path = scene.given("tip_timing"), folder / "arrivals.csv"
    with console.stage("arrival times"):
        blades, run = scene_timing.arrivals_of_blades(scene, source, console.comm)
    first_blade = next(iter(blades.values()))
    if scene.disk is None:
        _write_arrivals(first_blade, path, scene, run, console)
    elif run is not None:
        on_root(console.comm, lambda: write_record(blades, path, np.radians(table.probes)))
        console.note(f"arrivals of {counted(len(blades), 'blade')}: {path}")
    fits = _fit_blades(table, blades, console, scene, run)
    if scene.disk is not None and not all(isinstance(fit, TipFit) for fit in fits.values()):
        allowed = "arrivals at one speed of a bladed disk"
        raise InputError("arrivals", str(source or "a curve"), allowed)
    doubts = tuple(_warnings_of(first_blade, scene, run))
    return _report(Timing(scene, blades, fits, doubts), folder, console)


def _write_arrivals(
    arrivals: ArrivalTimes, path: Path, scene: Scene, run: Run[Any] | None, console: Console
) -> None:
    """Write and draw the arrivals of one blade, and say what they are."""

    def write() -> None:
        arrivals.to_csv(path)
        picture = path.with_suffix(f".{console.pictures}")
        draw_arrivals(arrivals, path=picture, in_rpm=scene.in_rpm)

    rows = arrivals.table().formatted("csv")
    console.note(keep_before(path, rows, console.comm))
    on_root(console.comm, write)
    first, last = (speed_in_words(arrivals.speed[end], scene.in_rpm) for end in (0, -1))
    ends = f"{first} to {last}" if scene_timing.is_run_up(arrivals, run) else first
    console.note(f"arrivals of {_size(arrivals)}, {ends}: {path}, .{console.pictures}")
    if run is not None:
        console.note(scene_timing.tip_in_words(scene.given("tip_timing"), run))


def _fit_blades(
    table: TipTiming, blades: Mapping[int, ArrivalTimes], console: Console, *of_scene: Any
) -> dict[int, Any]:
    """Return the vibration of each blade; ``of_scene`` are the scene and the run, if there are."""
    fits = {}
    with console.stage("vibration"):
        for blade, arrivals in blades.items():
            with within(f"blade {blade}"):
                fits[blade] = scene_timing.fit_vibration(table, arrivals, *of_scene)
    return fits


def _report(found: Timing, folder: Path, console: Console) -> Exit:
    return tell(report_of(found), folder / "timing", console, found, console.pictures)


def _size(arrivals: ArrivalTimes) -> str:
    return f"{counted(len(arrivals), 'revolution')}, {counted(len(arrivals.probes), 'probe')}"


def _warnings_of(arrivals: ArrivalTimes, scene: Scene, run: Run[Any] | None) -> Iterator[str]:
    """Yield warnings about measured arrivals, or about the run that they are computed from."""
    if run is None:
        yield from scene_timing.remarks_on_arrivals(arrivals)
        speeds = arrivals.mean_speed, scene.speed
        if scene.speed > 0.0 and not 0.5 <= speeds[0] / speeds[1] <= 2.0:
            seen, own = (speed_in_words(speed, scene.in_rpm) for speed in speeds)
            yield f"the arrivals are of {seen}, [rotation] has {own}: are they in seconds?"
        return
    doubts = (
        scene_timing.describe_scene_difference(scene, run),
        scene_timing.describe_run_up_end(scene, run),
    )
    yield from filter(None, doubts)
    if scene_timing.curve_of(run) is None:
        found = run.result
        yield from of_error(run.scene, found.report, found.harmonics)
        yield from of_stability(run.scene, run, found.stability)


def _record(given: Namespace, console: Console) -> Exit:
    """Find the vibration of the blades of a measured record, without a scene."""
    words = {}
    for key, value in changes(given.set).items():
        table, _, name = key.partition(".")
        if table != "tip_timing" or name not in RECORD_KEYS:
            known = ", ".join(f"tip_timing.{known}" for known in RECORD_KEYS)
            allowed = f"left out with a record in place of a scene, or {known}"
            raise InputError(key, value, allowed)
        words[name] = TipTiming.checked(name, value)
    with console.stage("arrival times"):
        probes = np.radians(words["probes"]) if "probes" in words else None
        blades = read_record(given.scene, tip_radius=words.get("tip_radius"), probes=probes)
        blades = one_of(blades, given.blade, given.scene)
    folder = given.output or Path("output") / given.scene.stem
    make_writable(folder, console.comm)
    first_blade = next(iter(blades.values()))
    console.note(f"{counted(len(blades), 'blade')}, {_size(first_blade)}")
    needs_probes = first_blade.steady and not {"probes", "frequencies"} & words.keys()
    if needs_probes and not has_probe_angles(given.scene):
        raise InputError("tip_timing.probes", None, MEDIANS)
    of_record = {
        "probes": np.degrees(first_blade.probes).tolist(),
        "tip_radius": first_blade.tip_radius,
    }
    fits = _fit_blades(TipTiming(**of_record | words), blades, console)
    doubts = tuple(scene_timing.remarks_on_arrivals(first_blade))
    return _report(Timing(None, blades, fits, doubts), folder, console)
