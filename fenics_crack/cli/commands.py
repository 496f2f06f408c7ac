"""Commands that compute a result, write files and print a report."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fenics_crack.basics.atomic_files import complete_files_together, remove_file
from fenics_crack.basics.errors import (
    INTERRUPTED_CURVE_STATUS,
    N_NATURAL_MODES_PER_CRACK_STATE,
    Exit,
    InputError,
    StoppedError,
)
from fenics_crack.basics.ranks import ignore_stop_signals, on_root
from fenics_crack.basics.tables import Report, format_speed
from fenics_crack.cli.account import make_printed_table
from fenics_crack.cli.given import (
    KEPT_STRUCTURE_FILE_NAME,
    CommandInputs,
    Console,
    PictureFiles,
    format_command,
    keep_previous_files_and_return_note,
)
from fenics_crack.cli.kinds import RESULT_KIND_BY_NAME, build_report, draw_result
from fenics_crack.runs.run import Run
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.study.sharing import CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST

if TYPE_CHECKING:
    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.monitoring.identification.measurements import Measurements
    from fenics_crack.scene.scene import Scene


def run_and_report_function(
    package_function: Callable[..., Any],
    arguments: Namespace,
    inputs: CommandInputs,
    console: Console,
) -> Exit:
    """Run a package function as a command, write the result, print the report.

    Parameters
    ----------
    package_function : callable
        Function to run. The parameter ``scene`` receives the scene, or the study in a file of the
        command ``reduce``. Further parameters receive command-line options, results folder, MPI
        ranks and progress, by name.
    arguments, inputs, console : Namespace, CommandInputs, Console
        Arguments, inputs and output of the command.

    Returns
    -------
    Exit
        Exit code of the report.

    Raises
    ------
    StoppedError
        Ctrl-C ended the estimate of errors; the result is saved without a report.

    Notes
    -----
    Ctrl-C is ignored while files are written. If Ctrl-C ended the computation, an earlier result in
    the folder is kept. The new files are then named "..._interrupted".
    """
    folder = inputs.results_folder
    if arguments.command == "curve" and inputs.scene.curve is None:
        from fenics_crack.cli.scenes import make_missing_curve_error

        raise make_missing_curve_error(inputs.scene, console)
    known_values_by_parameter = {
        "comm": console.comm,
        "progress": console.shows_progress,
        "few": N_NATURAL_MODES_PER_CRACK_STATE,
        **vars(arguments),
        **vars(inputs),
        "scene": inputs.prepared_study or inputs.scene,
    }
    keyword_arguments = {
        parameter_name: known_values_by_parameter[parameter_name]
        for parameter_name in signature(package_function).parameters
        if parameter_name in known_values_by_parameter
    }
    with console.report_stage(arguments.command, has_bars="folder" in keyword_arguments):
        result = package_function(**keyword_arguments)
    file_stem, report = RESULT_KIND_BY_NAME[result.KIND].file_stem, None
    run = result if isinstance(result, Run) else None
    is_interrupted = run is not None and vars(run.result).get("status") == INTERRUPTED_CURVE_STATUS
    try:
        with console.report_stage("estimate of errors"):
            if run is not None and not is_interrupted:
                result = replace(run, stated=run.errors)
            report = build_report(result)
    except KeyboardInterrupt:
        is_interrupted = True
    with ignore_stop_signals():
        if is_interrupted and on_root(console.comm, (folder / f"{file_stem}.h5").exists):
            console.print_notes(
                f"{folder / file_stem}.* is unchanged; the interrupted result is in "
                f"{folder / file_stem}_interrupted.*"
            )
            file_stem = f"{file_stem}_interrupted"
        if report is None:
            _save_result_of_all_ranks(result, folder / f"{file_stem}.h5", console)
            raise StoppedError(f"stopped; {folder / file_stem}.h5 has the result so far")
        return write_and_print_report(
            report, folder / file_stem, console, result, vars(arguments).get("pictures")
        )


def _save_result_of_all_ranks(result: Any, path: Path, console: Console) -> None:
    """Save a result to a .h5 file (collective).

    A run is saved by the run's MPI ranks, any further kind of result by the console's.
    """
    result.save(path, **({} if isinstance(result, Run) else {"comm": console.comm}))


def write_and_print_report(
    report: Report,
    stem_path: Path,
    console: Console,
    result: Any = None,
    picture_format: str | None = None,
) -> Exit:
    """Write a result with tables and pictures, and print the report.

    Parameters
    ----------
    report : Report
        Tables and sentences about the result.
    stem_path : Path
        Common path of all files to write, without the ending (.h5, .csv, .json, or a picture's).
    console : Console
        Output of the command.
    result
        Result to save as .h5; None if the .h5 file exists already.
    picture_format : str or None
        Ending of pictures. None: no picture is drawn, and a command for pictures is printed.

    Returns
    -------
    Exit
        0 without doubts; 3 if not converged; 4 if the error is unknown or above the tolerance.
    """
    replacement_note = ""
    if result is not None:
        replacement_note = keep_previous_files_and_return_note(
            Path(f"{stem_path}.json"), report.table.format_as("json"), console.comm
        )
    with complete_files_together() as file_stack:
        if result is not None:
            _save_result_of_all_ranks(result, Path(f"{stem_path}.h5"), console)

        def write_tables() -> None:
            report.table.save(f"{stem_path}.json")
            (report.csv_table or report.table).save(f"{stem_path}.csv")
            file_stack.close()

        on_root(console.comm, write_tables)
    if picture_format:
        on_root(
            console.comm,
            lambda: draw_result(result, PictureFiles(stem_path.parent, picture_format)),
        )
    for structure_file in CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST:  # results need the disk first
        structure_file.write_noted_structure(console.comm)
    console.print_table(
        make_printed_table(report) if console.table_format == "text" else report.table
    )
    for heading, further_table in report.further_tables.items():
        console.print_notes(f"{heading}:\n{further_table.format_as('text')}".rstrip())
    picture_text = (
        f".{picture_format}"
        if picture_format
        else f"pictures: {format_command('plot', f'{stem_path}.h5')}"
    )
    console.print_notes(
        f"{stem_path}.h5, .csv, .json{', ' if picture_format else '; '}{picture_text}",
        replacement_note,
    )
    return print_report_sentences(report, console)


def print_report_sentences(report: Report, console: Console) -> Exit:
    """Print a report's notes, remarks, warnings and closing sentence.

    Returns
    -------
    Exit
        0 without doubts; 3 if not converged; 4 if the error is unknown or above the tolerance.
    """
    console.print_notes(*report.notes)
    console.print_remarks(*report.remarks)
    console.print_warnings(*report.warnings)
    console.print_notes(report.closing_sentence)
    return report.exit_code


def run_and_report_sweep(_: Namespace, inputs: CommandInputs, console: Console) -> Exit:
    """Run the command ``sweep``: solve the cases not solved yet, and report all cases."""
    from fenics_crack.sweep.result import run_sweep

    scene, stem_path = inputs.scene, inputs.results_folder / "sweep"
    with console.report_stage("sweep", has_bars=True):
        sweep_result = run_sweep(
            scene, f"{stem_path}.h5", console.comm, progress=console.shows_progress
        )
    return write_and_print_report(build_report(sweep_result), stem_path, console)


def remove_kept_structure(_: Namespace, inputs: CommandInputs, console: Console) -> None:
    """Run the command ``clean``: remove the stored structure from the results folder.

    The structure was meshed, reduced and stored by an earlier command. The file is
    :data:`KEPT_STRUCTURE_FILE_NAME`.
    """
    on_root(
        console.comm,
        lambda: remove_file(inputs.results_folder / KEPT_STRUCTURE_FILE_NAME, "--output"),
    )


def write_prepared_study(arguments: Namespace, inputs: CommandInputs, console: Console) -> None:
    """Run the command ``reduce``: mesh and reduce a scene, and write the study to a file.

    ``solve`` and ``curve`` take the file in place of the scene, and need no mesh.
    """
    from fenics_crack.study.artefact import save_prepared
    from fenics_crack.study.prepare import prepare

    prepared_path = arguments.output or inputs.results_folder / f"{arguments.scene.stem}.h5"
    with console.report_stage("mesh, modes and static solutions"):
        save_prepared(prepare(inputs.scene, console.comm, whole=True), prepared_path)
    console.print_notes(
        f"{prepared_path}: the structure of {inputs.scene!r}; next: "
        f"{format_command('solve', prepared_path)}"
    )


def compute_and_report_bladed_disk(
    arguments: Namespace, inputs: CommandInputs, console: Console
) -> Exit:
    """Run the command ``disk``: natural frequencies over the nodal diameter, and mistuning.

    With ``--patterns`` N, also compute the amplification factors for N random mistuning patterns.
    Returns the last report's exit code.
    """
    from fenics_crack.disk.bladed_disk import amplification, nodal_diameters

    scene, comm, folder = inputs.scene, console.comm, inputs.results_folder
    with console.report_stage("nodal diameters"):
        nodal_result = nodal_diameters(scene, comm)
    exit_code = write_and_print_report(
        build_report(nodal_result), folder / "disk", console, nodal_result, arguments.pictures
    )
    if not arguments.patterns:
        return exit_code
    with console.report_stage("patterns of mistuning"):
        amplification_result = amplification(
            scene, arguments.patterns, arguments.deviation, comm=comm
        )
    return write_and_print_report(
        build_report(amplification_result),
        folder / "amplification",
        console,
        amplification_result,
        arguments.pictures,
    )


def _convert_arrivals_to_measurements(
    arrival_source: dict[int, ArrivalTimes] | Path,
    scene: Scene,
    console: Console,
    *,
    is_uncracked: bool = False,
) -> Measurements:
    """Convert blade tip arrivals to measurements for an identification (collective).

    Arrivals at constant speed become displacements. A run-up gives the natural frequencies of the
    resonances passed.

    Parameters
    ----------
    arrival_source : dict of ArrivalTimes, or Path
        Measured arrivals by blade number, or the path to a result (.h5) to compute arrivals from.
    scene, console : Scene, Console
        Scene, and output of the command.
    is_uncracked : bool
        True for arrivals measured before the crack; the arrivals must be a run-up.

    Raises
    ------
    InputError
        The arrivals pass no resonance of the blade, or do not fit the scene: the speed differs by
        more than 1 %, for example.
    """
    from fenics_crack.arrivals.arrival_times import MAX_RELATIVE_RANGE_OF_CONSTANT_SPEED
    from fenics_crack.monitoring import scene_timing
    from fenics_crack.monitoring.identification.measurements import (
        Measurements,
        get_crack_removal_changes_or_none,
    )

    arrivals_by_blade, run = scene_timing.arrivals_of_blades(scene, arrival_source, console.comm)
    [arrivals] = arrivals_by_blade.values()
    console.print_remarks(*([] if run else scene_timing.list_arrival_unit_remarks(arrivals)))
    option_name = "--before" if is_uncracked else "arrivals"
    if scene_timing.is_run_up(arrivals, run):
        with console.report_stage("resonances"):
            given_or_uncracked_scene = (
                scene.replace(get_crack_removal_changes_or_none(scene) or {})
                if is_uncracked
                else scene
            )
            passages = scene_timing.find_passages_and_modes(given_or_uncracked_scene, arrivals)
        console.print_notes(*(scene_timing.describe_passage(*passage) for passage in passages))
        passage_fits, mode_numbers, _ = zip(*passages, strict=True) if passages else ((), (), ())
        if not any(mode_numbers):
            raise InputError(
                option_name,
                repr(arrivals),
                "arrivals at constant speed, or a run-up through a resonance of the blade; these "
                "pass none: record a wider range of speeds",
            )
        measured_quantity_name = "frequency_uncracked" if is_uncracked else "frequency_resonance"
        return Measurements.from_passages(
            passage_fits, mode_numbers, quantity=measured_quantity_name
        )
    if is_uncracked:
        raise InputError(
            option_name, repr(arrivals), "arrivals of a run-up, or frequency responses (.uff, .unv)"
        )
    scene_fixes_rotor_speed = scene.speed > 0.0 and scene.excitation.order is None
    if (
        scene_fixes_rotor_speed
        and abs(arrivals.mean_speed / scene.speed - 1.0) > MAX_RELATIVE_RANGE_OF_CONSTANT_SPEED
    ):
        measured_rotor_speed_text, scene_speed_text = (
            format_speed(speed, scene.is_speed_in_rpm)
            for speed in (arrivals.mean_speed, scene.speed)
        )
        raise InputError(
            option_name,
            measured_rotor_speed_text,
            f"arrivals at {scene_speed_text}, the speed of [rotation]; set [rotation] to the "
            "measured speed, or give the load by excitation.order",
        )
    engine_order = scene_timing.get_engine_order(scene.given("tip_timing"), scene)
    probed_displacement_name, is_displacement_against_rotation = (
        scene_timing.find_probed_displacement_and_reversal(scene)
    )
    return Measurements.from_arrivals(
        arrivals, engine_order, probed_displacement_name, against=is_displacement_against_rotation
    )


def identify_and_report_crack(_: Namespace, inputs: CommandInputs, console: Console) -> Exit:
    """Run the command ``identify``: find a crack from measurements.

    Writes four kinds of results: the posterior (probability distribution of the unknowns), a
    picture, the fit, and proposed places to measure next. Returns the exit code. If the
    identification has doubts, this is the code for missing convergence.
    """
    from fenics_crack.draw.plot_study import draw_posterior  # Matplotlib
    from fenics_crack.monitoring.identification import identify as search_module  # SciPy
    from fenics_crack.monitoring.identification.report import IdentificationOutput

    scene, folder = inputs.scene, inputs.results_folder
    measurement_sets = [] if inputs.measurements is None else [inputs.measurements]
    if inputs.arrival_source is not None:
        measurement_sets.append(
            _convert_arrivals_to_measurements(inputs.arrival_source, scene, console)
        )
    if inputs.uncracked_arrival_source is not None:
        measurement_sets.append(
            _convert_arrivals_to_measurements(
                inputs.uncracked_arrival_source, scene, console, is_uncracked=True
            )
        )
    with console.report_stage("identification", has_bars=True):
        identification = search_module.identify(
            scene,
            sum(measurement_sets[1:], measurement_sets[0]),
            folder=folder,
            comm=console.comm,
            progress=console.shows_progress,
        )
    measurement_plan = identification.where_to_measure()

    def write_results() -> None:
        with complete_files_together():
            identification.save(folder)
            measurement_plan.to_csv(folder / "where_to_measure.csv")
            identification.fit_table().save(folder / "fit.csv")
            for picture_format in {"png", console.picture_format}:  # the report page shows the png
                draw_posterior(identification, path=folder / f"posterior.{picture_format}")

    fit_table_text = identification.fit_table().format_as("csv")
    other_result_file_stems = ("identify", "posterior", "where_to_measure")
    replacement_note = keep_previous_files_and_return_note(
        folder / "fit.csv", fit_table_text, console.comm, *other_result_file_stems
    )
    on_root(console.comm, write_results)
    console.print_table(identification.table())
    file_names = f"posterior.{console.picture_format}, fit.csv, where_to_measure.csv"
    console.print_notes(f"{folder / 'identify.h5'}, .json; {file_names}", replacement_note)
    report = build_report(
        IdentificationOutput(scene, identification.summary(), folder / "posterior.png")
    )
    remark_texts = [*report.remarks, *remarks_on_scene(scene)]
    return print_report_sentences(
        replace(report, remarks=remark_texts, has_converged=not identification.doubts), console
    )
