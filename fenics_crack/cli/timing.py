"""The command ``timing``: arrival times and vibration of blade tips."""

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
from fenics_crack.basics.progress import prefix_stages
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import format_count, format_speed
from fenics_crack.cli.account import yield_instability_warning, yield_large_error_warning
from fenics_crack.cli.commands import write_and_print_report
from fenics_crack.cli.given import (
    CommandInputs,
    Console,
    keep_previous_files_and_return_note,
    make_writable_folder,
    parse_changes,
    select_blades,
)
from fenics_crack.cli.kinds import build_report
from fenics_crack.draw.plot_rotor import draw_arrivals
from fenics_crack.monitoring import scene_timing
from fenics_crack.monitoring.timing import Timing
from fenics_crack.runs.run import Run
from fenics_crack.scene.result_tables import TipTiming
from fenics_crack.scene.scene import Scene

TIMING_KEYS_FOR_RECORD_WITHOUT_SCENE = (
    "tip_radius", "probes", "orders", "stiffening", "frequencies", "fitted_harmonics",
    "subharmonic", "angle_deviation",
)  # fmt: skip
"""Keys of [tip_timing] allowed in ``--set`` for a record without a scene."""
PROBE_ANGLES_NEEDED_TEXT = (
    "given for a record at constant speed, as --set tip_timing.probes=[0,17,40] in degrees: "
    "probe angles estimated from the arrivals hide an engine order of constant amplitude"
)


def fit_and_report_timing(
    arguments: Namespace, inputs: CommandInputs | None, console: Console
) -> Exit:
    """Run the command ``timing``: fit the blade vibration to arrival times.

    ``inputs`` None: the first argument is a record (.csv), not a scene. Returns the exit code, as
    from :func:`print_report_sentences`.
    """
    if inputs is None:
        return _fit_and_report_record(arguments, console)
    scene, result_folder, arrival_source = (
        inputs.scene,
        inputs.results_folder,
        inputs.arrival_source,
    )
    timing_table, arrivals_output_path = scene.given("tip_timing"), result_folder / "arrivals.csv"
    with console.report_stage("arrival times"):
        arrivals_by_blade, run = scene_timing.arrivals_of_blades(
            scene, arrival_source, console.comm
        )
    first_blade_arrivals = next(iter(arrivals_by_blade.values()))
    if scene.disk is None:
        _write_and_draw_arrivals(first_blade_arrivals, arrivals_output_path, scene, run, console)
    elif run is not None:
        on_root(
            console.comm,
            lambda: write_record(
                arrivals_by_blade, arrivals_output_path, np.radians(timing_table.probes)
            ),
        )
        console.print_notes(
            f"arrivals of {format_count(len(arrivals_by_blade), 'blade')}: {arrivals_output_path}"
        )
    fits_by_blade = _fit_vibration_by_blade(timing_table, arrivals_by_blade, console, scene, run)
    if scene.disk is not None and not all(
        isinstance(blade_fit, TipFit) for blade_fit in fits_by_blade.values()
    ):
        raise InputError(
            "arrivals",
            str(arrival_source or "a curve"),
            "arrivals at one speed; for a bladed disk no run-up can be fitted",
        )
    doubt_texts = tuple(_yield_timing_warnings(first_blade_arrivals, scene, run))
    return _write_timing_report(
        Timing(scene, arrivals_by_blade, fits_by_blade, doubt_texts), result_folder, console
    )


def _write_and_draw_arrivals(
    arrivals: ArrivalTimes,
    arrivals_output_path: Path,
    scene: Scene,
    run: Run[Any] | None,
    console: Console,
) -> None:
    """Write a blade's arrivals as CSV, draw them, and print the range of speeds.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals at a single blade.
    arrivals_output_path : Path
        File for the CSV; the picture's name differs in the ending only.
    scene : Scene
        Scene with the unit of speeds.
    run : Run or None
        Run used to compute the arrivals; None for measured arrivals.
    console : Console
        Output of the command.
    """

    def write_files() -> None:
        arrivals.to_csv(arrivals_output_path)
        picture_path = arrivals_output_path.with_suffix(f".{console.picture_format}")
        draw_arrivals(arrivals, path=picture_path, in_rpm=scene.is_speed_in_rpm)

    table_text = arrivals.table().format_as("csv")
    console.print_notes(
        keep_previous_files_and_return_note(arrivals_output_path, table_text, console.comm)
    )
    on_root(console.comm, write_files)
    first_speed_text, last_speed_text = (
        format_speed(arrivals.speed[row_index], scene.is_speed_in_rpm) for row_index in (0, -1)
    )
    speed_range_text = (
        f"{first_speed_text} to {last_speed_text}"
        if scene_timing.is_run_up(arrivals, run)
        else first_speed_text
    )
    console.print_notes(
        f"arrivals of {_describe_arrival_counts(arrivals)}, {speed_range_text}: "
        f"{arrivals_output_path}, "
        f".{console.picture_format}"
    )
    if run is not None:
        console.print_notes(
            scene_timing.describe_probed_tip_displacement(scene.given("tip_timing"), run)
        )


def _fit_vibration_by_blade(
    timing_table: TipTiming,
    arrivals_by_blade: Mapping[int, ArrivalTimes],
    console: Console,
    *scene_and_run: Any,
) -> dict[int, Any]:
    """Fit the vibration to the arrivals of each blade.

    Parameters
    ----------
    timing_table : TipTiming
        Table ``[tip_timing]`` with settings of the fit.
    arrivals_by_blade : mapping of int to ArrivalTimes
        Arrivals by blade number.
    console : Console
        Output of the command.
    scene_and_run : Scene, Run
        Scene, then the run used to compute the arrivals, or None. Both are left out for a record
        without a scene.

    Returns
    -------
    dict
        Result by blade number. At constant speed: a fit. Over a run-up: a track of the vibration,
        or a tuple of the resonances passed.
    """
    fits_by_blade = {}
    with console.report_stage("vibration"):
        for blade_number, arrivals in arrivals_by_blade.items():
            with prefix_stages(f"blade {blade_number}"):
                fits_by_blade[blade_number] = scene_timing.fit_vibration_or_passages(
                    timing_table, arrivals, *scene_and_run
                )
    return fits_by_blade


def _write_timing_report(tip_timing: Timing, folder: Path, console: Console) -> Exit:
    """Save a tip timing result, write and print the report; return the exit code."""
    return write_and_print_report(
        build_report(tip_timing), folder / "timing", console, tip_timing, console.picture_format
    )


def _describe_arrival_counts(arrivals: ArrivalTimes) -> str:
    """Return the numbers of revolutions and probes in words: "100 revolutions, 4 probes"."""
    revolutions_text = format_count(len(arrivals), "revolution")
    return f"{revolutions_text}, {format_count(len(arrivals.probes), 'probe')}"


def _yield_timing_warnings(
    arrivals: ArrivalTimes, scene: Scene, run: Run[Any] | None
) -> Iterator[str]:
    """Yield warnings about measured arrivals, or about the run of computed arrivals.

    Measured arrivals are in doubt if the measured rotor speed is below half or above twice the
    scene's speed. A run is in doubt with another scene, an early end, a large error or an unstable
    orbit. ``run`` is the run used to compute the arrivals; None for measured arrivals.
    """
    if run is None:
        yield from scene_timing.list_arrival_unit_remarks(arrivals)
        record_and_scene_speeds = arrivals.mean_speed, scene.speed
        if (
            scene.speed > 0.0
            and not 0.5 <= record_and_scene_speeds[0] / record_and_scene_speeds[1] <= 2.0
        ):
            record_speed_text, scene_speed_text = (
                format_speed(rotor_speed, scene.is_speed_in_rpm)
                for rotor_speed in record_and_scene_speeds
            )
            yield (
                f"the arrivals are of {record_speed_text}, but [rotation] has {scene_speed_text}; "
                "check that the arrival times are in seconds"
            )
        return
    doubt_texts = (
        scene_timing.describe_scene_difference_or_empty(scene, run),
        scene_timing.describe_run_up_end_or_empty(scene, run),
    )
    yield from filter(None, doubt_texts)
    if scene_timing.get_response_curve_or_none(run) is None:
        motion = run.result
        yield from yield_large_error_warning(run.scene, motion.report, motion.harmonics)
        yield from yield_instability_warning(run.scene, run, motion.stability)


def _fit_and_report_record(arguments: Namespace, console: Console) -> Exit:
    """Fit and report the vibration in a record of arrivals (.csv) without a scene.

    ``--set`` accepts :data:`TIMING_KEYS_FOR_RECORD_WITHOUT_SCENE`. A record at constant speed needs
    the probes' angles, in the file or as ``tip_timing.probes``, unless a frequency range is given.
    Returns the exit code.
    """
    timing_settings_from_options = {}
    for full_key, value_of_scene_key in parse_changes(arguments.set).items():
        table_name, _, key_name = full_key.partition(".")
        if table_name != "tip_timing" or key_name not in TIMING_KEYS_FOR_RECORD_WITHOUT_SCENE:
            allowed_keys_text = ", ".join(
                f"tip_timing.{allowed_timing_key}"
                for allowed_timing_key in TIMING_KEYS_FOR_RECORD_WITHOUT_SCENE
            )
            raise InputError(
                full_key,
                value_of_scene_key,
                f"left out with a record in place of a scene; {allowed_keys_text} can be set",
            )
        timing_settings_from_options[key_name] = TipTiming.convert_value(
            key_name, value_of_scene_key
        )
    with console.report_stage("arrival times"):
        probe_angles = (
            np.radians(timing_settings_from_options["probes"])
            if "probes" in timing_settings_from_options
            else None
        )
        arrivals_by_blade = read_record(
            arguments.scene,
            tip_radius=timing_settings_from_options.get("tip_radius"),
            probes=probe_angles,
        )
        arrivals_by_blade = select_blades(arrivals_by_blade, arguments.blade, arguments.scene)
    result_folder = arguments.output or Path("output") / arguments.scene.stem
    make_writable_folder(result_folder, console.comm)
    first_blade_arrivals = next(iter(arrivals_by_blade.values()))
    console.print_notes(
        f"{format_count(len(arrivals_by_blade), 'blade')}, "
        f"{_describe_arrival_counts(first_blade_arrivals)}"
    )
    needs_probes = (
        first_blade_arrivals.steady
        and not {"probes", "frequencies"} & timing_settings_from_options.keys()
    )
    if needs_probes and not has_probe_angles(arguments.scene):
        raise InputError("tip_timing.probes", None, PROBE_ANGLES_NEEDED_TEXT)
    timing_settings_from_record = {
        "probes": np.degrees(first_blade_arrivals.probes).tolist(),
        "tip_radius": first_blade_arrivals.tip_radius,
    }
    fits_by_blade = _fit_vibration_by_blade(
        TipTiming(**timing_settings_from_record | timing_settings_from_options),
        arrivals_by_blade,
        console,
    )
    doubt_texts = tuple(scene_timing.list_arrival_unit_remarks(first_blade_arrivals))
    return _write_timing_report(
        Timing(None, arrivals_by_blade, fits_by_blade, doubt_texts), result_folder, console
    )
