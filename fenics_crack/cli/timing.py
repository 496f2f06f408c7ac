"""The command ``timing``: arrival times of blade tips, and their vibration."""

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
PROBES_REQUIREMENT = (
    "given for a record at constant speed: without them a probe stands at its median arrival, "
    "where an engine order of constant amplitude is not seen"
)


def timing(given: Namespace, inputs: Inputs | None, console: Console) -> Exit:
    """Fit a vibration to arrival times, computed unless they are measured."""
    if inputs is None:
        return _find_vibration_of_record(given, console)
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
        requirement = "arrivals at one speed of a bladed disk"
        raise InputError("arrivals", str(source or "a curve"), requirement)
    doubts = tuple(_warnings_of(first_blade, scene, run))
    return _report(Timing(scene, blades, fits, doubts), folder, console)


def _write_arrivals(
    arrivals: ArrivalTimes, path: Path, scene: Scene, run: Run[Any] | None, console: Console
) -> None:
    """Write, draw and describe the arrivals of one blade."""

    def write() -> None:
        arrivals.to_csv(path)
        picture = path.with_suffix(f".{console.pictures}")
        draw_arrivals(arrivals, path=picture, in_rpm=scene.in_rpm)

    rows = arrivals.table().formatted("csv")
    console.note(keep_before(path, rows, console.comm))
    on_root(console.comm, write)
    first_speed, last_speed = (
        speed_in_words(arrivals.speed[row_index], scene.in_rpm) for row_index in (0, -1)
    )
    speed_range = (
        f"{first_speed} to {last_speed}" if scene_timing.is_run_up(arrivals, run) else first_speed
    )
    console.note(
        f"arrivals of {_size_in_words(arrivals)}, {speed_range}: {path}, .{console.pictures}"
    )
    if run is not None:
        console.note(scene_timing.describe_tip(scene.given("tip_timing"), run))


def _fit_blades(
    table: TipTiming, blades: Mapping[int, ArrivalTimes], console: Console, *scene_and_run: Any
) -> dict[int, Any]:
    """Fit the vibration of each blade, with or without scene and run."""
    fits = {}
    with console.stage("vibration"):
        for blade, arrivals in blades.items():
            with within(f"blade {blade}"):
                fits[blade] = scene_timing.fit_vibration(table, arrivals, *scene_and_run)
    return fits


def _report(tip_timing: Timing, folder: Path, console: Console) -> Exit:
    return tell(report_of(tip_timing), folder / "timing", console, tip_timing, console.pictures)


def _size_in_words(arrivals: ArrivalTimes) -> str:
    return f"{counted(len(arrivals), 'revolution')}, {counted(len(arrivals.probes), 'probe')}"


def _warnings_of(arrivals: ArrivalTimes, scene: Scene, run: Run[Any] | None) -> Iterator[str]:
    """Yield warnings about measured arrivals, or the run of computed arrivals."""
    if run is None:
        yield from scene_timing.list_arrival_remarks(arrivals)
        speeds = arrivals.mean_speed, scene.speed
        if scene.speed > 0.0 and not 0.5 <= speeds[0] / speeds[1] <= 2.0:
            record_speed, scene_speed = (speed_in_words(speed, scene.in_rpm) for speed in speeds)
            yield (
                f"the arrivals are of {record_speed}, [rotation] has {scene_speed}: "
                "are they in seconds?"
            )
        return
    doubts = (
        scene_timing.describe_scene_difference(scene, run),
        scene_timing.describe_run_up_end(scene, run),
    )
    yield from filter(None, doubts)
    if scene_timing.get_response_curve(run) is None:
        result = run.result
        yield from of_error(run.scene, result.report, result.harmonics)
        yield from of_stability(run.scene, run, result.stability)


def _find_vibration_of_record(arguments: Namespace, console: Console) -> Exit:
    """Find the vibration of a measured record's blades without a scene."""
    table_values = {}
    for key, value in changes(arguments.set).items():
        table, _, name = key.partition(".")
        if table != "tip_timing" or name not in RECORD_KEYS:
            key_names = ", ".join(f"tip_timing.{record_key}" for record_key in RECORD_KEYS)
            requirement = f"left out with a record in place of a scene, or {key_names}"
            raise InputError(key, value, requirement)
        table_values[name] = TipTiming.checked(name, value)
    with console.stage("arrival times"):
        probes = np.radians(table_values["probes"]) if "probes" in table_values else None
        blades = read_record(
            arguments.scene, tip_radius=table_values.get("tip_radius"), probes=probes
        )
        blades = one_of(blades, arguments.blade, arguments.scene)
    folder = arguments.output or Path("output") / arguments.scene.stem
    make_writable(folder, console.comm)
    first_blade = next(iter(blades.values()))
    console.note(f"{counted(len(blades), 'blade')}, {_size_in_words(first_blade)}")
    needs_probes = first_blade.steady and not {"probes", "frequencies"} & table_values.keys()
    if needs_probes and not has_probe_angles(arguments.scene):
        raise InputError("tip_timing.probes", None, PROBES_REQUIREMENT)
    record_values = {
        "probes": np.degrees(first_blade.probes).tolist(),
        "tip_radius": first_blade.tip_radius,
    }
    fits = _fit_blades(TipTiming(**record_values | table_values), blades, console)
    doubts = tuple(scene_timing.list_arrival_remarks(first_blade))
    return _report(Timing(None, blades, fits, doubts), folder, console)
