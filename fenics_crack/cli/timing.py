"""The command ``timing``: arrival times of a blade tip, and the vibration found in them."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.errors import Exit, InputError
from fenics_crack.basics.progress import within
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import counted, speed_in_words
from fenics_crack.cli.account import of_error, of_stability
from fenics_crack.cli.commands import tell
from fenics_crack.cli.given import Console, Inputs, changes, keep_before, make_writable, one_of
from fenics_crack.cli.kinds import report_of
from fenics_crack.draw.plot_study import draw_arrivals
from fenics_crack.monitoring.tip_timing import scene_timing
from fenics_crack.monitoring.tip_timing.arrival_times import (
    ArrivalTimes,
    has_probe_angles,
    read_record,
    write_record,
)
from fenics_crack.monitoring.tip_timing.harmonics import TipFit
from fenics_crack.monitoring.tip_timing.timing import Timing
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
    scene, folder = inputs.scene, inputs.folder
    if scene.disk is not None:
        return _of_blades(inputs, console)
    assert not isinstance(inputs.arrivals, dict)
    with console.stage("arrival times"):
        arrivals, run = scene_timing.arrivals_of(scene, inputs.arrivals, console.comm)

    def write() -> None:
        arrivals.to_csv(folder / "arrivals.csv")
        draw_arrivals(arrivals, path=folder / f"arrivals.{console.pictures}", in_rpm=scene.in_rpm)

    rows = arrivals.table().formatted("csv")
    console.note(keep_before(folder / "arrivals.csv", rows, console.comm))
    on_root(console.comm, write)
    first, last = (speed_in_words(arrivals.speed[end], scene.in_rpm) for end in (0, -1))
    ends = f"{first} to {last}" if scene_timing.is_run_up(arrivals, run) else first
    files = f"{folder / 'arrivals.csv'}, .{console.pictures}"
    console.note(f"arrivals of {_size(arrivals)}, {ends}: {files}")
    if run is not None:
        console.note(scene_timing.tip_in_words(scene.given("tip_timing"), run))
    with console.stage("vibration"):
        fit = scene_timing.vibration_in(scene.given("tip_timing"), arrivals, scene, run)
    doubts = tuple(_warnings_of(arrivals, scene, run))
    return _told(Timing(scene, {1: arrivals}, {1: fit}, doubts), folder, console)


def _told(found: Timing, folder: Path, console: Console) -> Exit:
    return tell(report_of(found), folder / "timing", console, found, console.pictures)


def _of_blades(inputs: Inputs, console: Console) -> Exit:
    """The same of every blade of a bladed disk: one record of all, and a fit of each."""
    scene, folder, source = inputs.scene, inputs.folder, inputs.arrivals
    table = scene.given("tip_timing")
    assert not isinstance(source, ArrivalTimes)
    with console.stage("arrival times"):
        blades, run = scene_timing.arrivals_of_blades(scene, source, console.comm)
    record = folder / "arrivals.csv"
    if run is not None:
        on_root(console.comm, lambda: write_record(blades, record, np.radians(table.probes)))
        console.note(f"arrivals of {counted(len(blades), 'blade')}: {record}")
    with console.stage("vibration"):
        fits: dict[int, TipFit] = {}
        for blade, arrivals in blades.items():
            with within(f"blade {blade}"):
                fit = scene_timing.vibration_in(table, arrivals, scene, run)
            if not isinstance(fit, TipFit):
                allowed = "arrivals at one speed of a bladed disk"
                raise InputError("arrivals", str(source or "a curve"), allowed)
            fits[blade] = fit
    first = next(iter(blades.values()))
    doubts = () if run is None else tuple(_warnings_of(first, scene, run))
    return _told(Timing(scene, blades, fits, doubts), folder, console)


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
    doubts = scene_timing.of_another_scene(scene, run), scene_timing.run_up_ends(scene, run)
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
    first = next(iter(blades.values()))
    console.note(f"{counted(len(blades), 'blade')}, {_size(first)}")
    needs_probes = first.steady and not {"probes", "frequencies"} & words.keys()
    if needs_probes and not has_probe_angles(given.scene):
        raise InputError("tip_timing.probes", None, MEDIANS)
    of_record = {"probes": np.degrees(first.probes).tolist(), "tip_radius": first.tip_radius}
    request, fits = TipTiming(**of_record | words), {}
    with console.stage("vibration"):
        for blade, arrivals in blades.items():
            with within(f"blade {blade}"):
                fits[blade] = scene_timing.vibration_in(request, arrivals)
    doubts = tuple(scene_timing.remarks_on_arrivals(first))
    return _told(Timing(None, blades, fits, doubts), folder, console)
