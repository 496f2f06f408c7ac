"""Pictures for all kinds of results, and files for ParaView.

This module loads Matplotlib; functions for meshes load VTK.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.arrivals.harmonics import TipFit
from fenics_crack.arrivals.track_order import TipTrack
from fenics_crack.balance.harmonic_balance import linear_response
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.errors import N_NATURAL_MODES_PER_CRACK_STATE, InputError
from fenics_crack.basics.tables import (
    choose_factor_and_prefixed_unit,
    format_percent,
    heading_with_unit,
)
from fenics_crack.basics.untrusted_files import read_regular_file
from fenics_crack.cli.given import PERIOD_FRAMES_FOLDER_NAME, PictureFiles
from fenics_crack.cli.results import Waveforms, sample_waveforms
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw import plot, plot_curve, plot_mesh, plot_rotor, plot_study
from fenics_crack.fatigue.growth import Growth
from fenics_crack.model.contact import friction_of
from fenics_crack.model.modes import (
    LIP_STATES,
    STIFFNESS_SOLUTION_ROUNDING,
    Modes,
    count_bonded_modes,
    solve_modes,
)
from fenics_crack.model.structure import Structure
from fenics_crack.monitoring.identification.report import IdentificationOutput
from fenics_crack.monitoring.timing import Timing, find_blade_of_largest_amplitude_or_none
from fenics_crack.runs.conclusion import describe_stated_error, frequency_in_words
from fenics_crack.runs.run import Run
from fenics_crack.runs.stress_intensity import stress_intensity
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.keys import unit_of_key
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.words import SCENE_UNITS_WITHOUT_PREFIX, key_in_words, value_in_words
from fenics_crack.study.campbell import MAX_REPORTED_ENGINE_ORDER, Campbell
from fenics_crack.study.prepare import prepare
from fenics_crack.sweep.plan import LOAD_FREQUENCY_KEYS
from fenics_crack.sweep.result import SweepResult
from fenics_crack.time.march import TimeHistory

CRACK_WAVEFORM_COLOURS_AND_STYLES = (("orange", "--"), ("green", "-."), ("pink", ":"))
"""Colour and line style of a crack's closing over time; a fourth crack repeats the first."""

NO_MESH_NOTE = "the structure has no mesh: pictures of a mesh are left out"


def draw_scene_mesh(
    scene: Scene, folder: Path, structure: Structure | None = None, file_format: str = "png"
) -> Path:
    """Draw the mesh of a scene, and return the picture's path.

    Parameters
    ----------
    scene : Scene
        Scene with the mesh.
    folder : Path
        Folder for the picture, named mesh.png.
    structure : Structure, optional
        The scene's structure with a mesh. None: the scene is meshed here.
    file_format : str
        Ending of the picture: "png", "pdf" or "svg".
    """
    picture_path = folder / f"mesh.{file_format}"
    structure = structure or prepare(scene, MPI.COMM_SELF, whole=True).structure
    plot_mesh.draw_mesh(
        structure, path=picture_path, title=f"{structure.n_dofs} degrees of freedom"
    )
    return picture_path


def draw_mode_shapes(run: Run[Modes], picture_files: PictureFiles) -> None:
    """Draw the mode shapes of a result of ``modes``; without a mesh, only record a note."""
    if run.structure.whole.local_nodes_with_cells_or_none is None:
        picture_files.notes.append(NO_MESH_NOTE)
        return
    caption = "Mode shapes with the crack open. Without contact, so the crack faces may overlap."
    plot_mesh.draw_modes(run.result, path=picture_files("modes", caption))
    if picture_files.has_vtk_files:
        from fenics_crack.draw.vtk import write_modes  # VTK

        write_modes(run.result, picture_files("modes", "", "vtu"))


def draw_solution(run: Run[PeriodicSolution], picture_files: PictureFiles) -> None:
    """Draw a steady vibration: waveforms, harmonics, phase plane and moving mesh.

    Depending on the scene, also friction loops, a bladed disk and stress intensities.
    """
    solution, watched_dof = run.result, run.watched_dof
    title = f"{frequency_in_words(run.scene, solution.omega)}, H = {solution.harmonics}"
    if error_text := describe_stated_error(run):
        title += f", error {error_text.partition(',')[0]}"
    elif solution.gap_coefficients.size and solution.report.estimated:
        error_text = format_percent(solution.report.total)
        title += f", error {'unknown' if solution.report.unknown else error_text}"
    if solution.stability is not None:
        title += f", {solution.stability.verdict}"
    if not solution.converged:
        title += ", NOT CONVERGED"
    caption = "Displacement at the output point, and closing of the crack faces."
    _draw_waveforms(
        run,
        sample_waveforms(run),
        solution.omega,
        path=picture_files("solution_waves", caption),
        title=title,
    )
    caption = "Amplitudes of the harmonics; their number is sufficient if the last ones are small."
    plot.draw_spectrum(
        solution, watched_dof, path=picture_files("solution_spectrum", caption), title=title
    )
    caption = "The motion in the phase plane; thick lines: the crack faces touch."
    plot.draw_orbits(
        solution, watched_dof, path=picture_files("solution_orbits", caption), title=title
    )
    if friction_of(solution.contact) is not None:
        caption = "Friction force over the sliding of the crack faces; the area is the energy lost."
        plot.draw_friction_loops(
            solution,
            path=picture_files("solution_friction_loops", caption),
            title=f"Friction, {frequency_in_words(run.scene, solution.omega)}",
        )
    if run.scene.disk is not None:
        from fenics_crack.disk.plot_disk import draw_wheel

        caption = (
            "The bladed disk at its largest motion, magnified; orange numbers: cracked blades."
        )
        draw_wheel(solution, path=picture_files("solution_wheel", caption), title=title)
    if solution.structure.whole.local_nodes_with_cells_or_none is None:
        picture_files.notes.append(NO_MESH_NOTE)
    else:
        _draw_contact_map_and_animation(run, picture_files)
    _draw_stress_intensity(run, picture_files, "solution_tips")


def _draw_contact_map_and_animation(
    run: Run[PeriodicSolution], picture_files: PictureFiles
) -> None:
    """Draw contact along the crack over a period, and an animation of the vibrating mesh.

    If files for ParaView are requested, the moving mesh is also written to files, over a period. A
    single contact pair has no picture of contact along the crack.
    """
    from fenics_crack.draw.animation import animate_period  # VTK

    solution, material = run.result, run.scene.material
    if solution.gap_coefficients.shape[1] > 1:
        caption = "Contact of the crack faces along the crack and over the period."
        plot.draw_contact_map(
            solution,
            path=picture_files("solution_contact_map", caption),
            title="Where and when the crack is closed",
        )
    caption = "One period, slowed down and magnified as stated above the plate."
    animate_period(
        solution, picture_files("solution_breathing_crack", caption, "gif"), material=material
    )
    if picture_files.has_vtk_files:
        from fenics_crack.draw.vtk import write_period

        write_period(
            solution, picture_files(PERIOD_FRAMES_FOLDER_NAME, "", "pvd"), material=material
        )


def draw_history(run: Run[TimeHistory], picture_files: PictureFiles) -> None:
    """Draw a motion in time: waveforms, and stress intensities at crack tips.

    Stress intensities are left out in the cases named in :func:`_draw_stress_intensity`.
    """
    integration_table = run.scene.integration
    load_omega = run.scene.excitation.omega
    period_omega = None
    title = "Free decay"
    if integration_table is None or not integration_table.free:
        frequency_text = frequency_in_words(run.scene, load_omega)
        title = f"The last of {run.result.periods} periods, {frequency_text}"
        period_omega = load_omega
    caption = "The motion in time: its last periods, or a free decay."
    _draw_waveforms(
        run,
        sample_waveforms(run),
        period_omega,
        path=picture_files("integration_waves", caption),
        title=title,
    )
    _draw_stress_intensity(run, picture_files, "integration_tips")


def _draw_stress_intensity(run: Run[Any], picture_files: PictureFiles, file_stem: str) -> None:
    """Draw stress intensities at crack tips over the period.

    Nothing is drawn if :func:`stress_intensity` refuses the run: matrices, a disk, friction, or too
    long elements at a tip.
    """
    with suppress(InputError):  # a tip next to an edge, or no plate
        stress_intensities = stress_intensity(run)
        unit_factor, unit = choose_factor_and_prefixed_unit(
            float(stress_intensities.effective.max()), "Pa m^0.5"
        )
        title = (
            "Stress intensity, range while the crack is open: "
            f"{unit_factor * stress_intensities.effective.max():.4g} "
            f"{unit}"
        )
        caption = "Stress intensity at the crack tips over the period."
        plot.draw_stress_intensity(
            stress_intensities, path=picture_files(file_stem, caption), title=title
        )
        if stress_intensities.K_III is not None and picture_files.has_vtk_files:
            from fenics_crack.draw.vtk import write_fronts

            write_fronts(stress_intensities, picture_files(f"{file_stem}_along_fronts", "", "vtu"))


def _draw_waveforms(
    run: Run, waveforms: Waveforms, omega: float | None, **picture_options: Any
) -> None:
    """Draw the first watched displacement and the closings of cracks over time.

    A closing is a crack's gap, positive while the crack faces are in contact.

    Parameters
    ----------
    run, waveforms : Run, Waveforms
        Run, and displacements and gaps over time.
    omega : float or None
        Frequency [rad/s], with the period as unit of time; None: seconds.
    picture_options
        ``path`` and ``title`` of the picture.
    """
    time = waveforms.time - waveforms.time[0]
    zero_label = "crack faces touch" if waveforms.gap_waveforms_by_place else None
    drawn_waves = [plot.Wave(run.watched_description, time, waveforms.displacement[:, 0])]
    drawn_waves += [
        plot.Wave(f"closing {crack_place}", time, crack_closing, *colour_and_style)
        for (crack_place, crack_closing), colour_and_style in zip(
            waveforms.gap_waveforms_by_place.items(),
            itertools.cycle(CRACK_WAVEFORM_COLOURS_AND_STYLES),
            strict=False,
        )
    ]
    period = None if omega is None else 2.0 * np.pi / omega
    plot.draw_waves(
        drawn_waves, quantity="displacement", period=period, zero=zero_label, **picture_options
    )


def draw_curve_pictures(run: Run[ResponseCurve], picture_files: PictureFiles) -> None:
    """Draw a response curve: response, harmonics and Floquet multipliers.

    A bladed disk also has a picture of all blades.
    """
    curve, watched_dof, in_hertz = run.result, run.watched_dof, run.scene.is_frequency_in_hertz
    title = f"{run.watched_description}, {curve.method}"
    linear_responses_by_label = _compute_linear_responses(run)
    caption = (
        "Response; stability was not examined. Faint: large estimated error."
        if curve.multipliers is None
        else "Response. Dashed: unstable; dash-dotted: irregular; dotted: undecided; "
        "faint: large estimated error."
    )
    plot_curve.draw_curve(
        curve,
        watched_dof,
        path=picture_files("curve", caption),
        title=title,
        in_hertz=in_hertz,
        behind=linear_responses_by_label,
    )
    plot_curve.draw_content(
        curve,
        watched_dof,
        path=picture_files("curve_content", "Amplitudes of the lowest harmonics."),
        title=title,
        in_hertz=in_hertz,
    )
    if run.scene.disk is not None:
        from fenics_crack.disk.plot_disk import draw_blades

        draw_blades(
            curve,
            path=picture_files(
                "curve_blades", "Response of every blade; cracked blades are orange."
            ),
            title=f"Every blade, {curve.method}",
            in_hertz=in_hertz,
        )
    if curve.multipliers is not None:
        caption = "The orbit is stable where the largest multiplier is below 1."
        plot_curve.draw_multipliers(
            curve,
            path=picture_files("curve_multipliers", caption),
            title="Largest Floquet multiplier along the curve",
            in_hertz=in_hertz,
        )


def _compute_linear_responses(run: Run[ResponseCurve]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Compute responses without contact: crack open, crack bonded, and no crack.

    "No crack" is included for plates meshed by the program. Responses without vibration are left
    out. The dict is empty for a curve over any parameter but the load frequency.

    Returns
    -------
    dict of str to (omega, amplitudes)
        Frequencies [rad/s] and amplitudes [m] by label.
    """
    curve, scene, structure = run.result, run.scene, run.structure
    if curve.parameter != "omega":
        return {}
    crack_word_by_lips = {"open": "open", "tied": "bonded"}
    arguments_by_label = {
        f"crack always {crack_word_by_lips[lips]}": (structure, run.watched_dof, lips)
        for lips in LIP_STATES
    }
    if scene.geometry is not None and scene.geometry.width is not None:
        none_by_removed_key = dict.fromkeys(
            ("crack", "cracks", "contact", "sweep", "identify", "growth", "output.quantities")
        )
        uncracked_study = prepare(scene.replace(none_by_removed_key), MPI.COMM_SELF)
        arguments_by_label["no crack"] = (
            uncracked_study.structure,
            uncracked_study.watched[0].dof,
            "open",
        )
    responses_by_label = {
        case_label: _compute_linear_response(curve.omega, *response_arguments)
        for case_label, response_arguments in arguments_by_label.items()
    }
    negligible_amplitude = STIFFNESS_SOLUTION_ROUNDING * np.max(
        curve.amplitude(run.watched_dof)
    )  # rounding below
    return {
        case_label: (omega_values, amplitudes)
        for case_label, (omega_values, amplitudes) in responses_by_label.items()
        if np.max(amplitudes) > negligible_amplitude
    }


def _compute_linear_response(
    curve_omega: np.ndarray, structure: Structure, dof: int, lips: str
) -> tuple[np.ndarray, np.ndarray]:
    """Compute a dof's response without contact over a curve's frequencies.

    ``lips`` is the state of the crack: "open", or "tied" (bonded).

    Returns
    -------
    omega : (n,) [rad/s]
        Frequencies, denser next to natural frequencies.
    amplitudes : (n,) [m]
    """
    max_modes = count_bonded_modes(structure) if lips == "tied" else structure.n_modes
    natural_omega = solve_modes(
        structure, min(N_NATURAL_MODES_PER_CRACK_STATE, max_modes), lips=lips
    ).omega
    relative_offsets = np.geomspace(1e-6, 0.1, 30)
    omega_near_resonances = np.outer(
        natural_omega, np.concatenate([1.0 - relative_offsets, 1.0 + relative_offsets])
    ).ravel()
    lowest_omega, highest_omega = curve_omega.min(), curve_omega.max()
    omega_within_curve = omega_near_resonances[
        (omega_near_resonances > lowest_omega) & (omega_near_resonances < highest_omega)
    ]
    sampled_omega = np.unique(
        np.concatenate([np.linspace(lowest_omega, highest_omega, 200), omega_within_curve])
    )
    return sampled_omega, linear_response(structure, dof, sampled_omega, lips=lips)


# --- a sweep --------------------------------------------------------------------------------------


def draw_sweep(sweep_result: SweepResult, picture_files: PictureFiles) -> None:
    """Draw a sweep's quantities over one or two axes.

    The horizontal axis is the load frequency. If this is not swept, the axis with most values is
    horizontal. The second axis is the next with most values. All further axes are fixed in a
    picture. Each combination of fixed values has a separate picture, for the first 12 combinations.
    For lines and maps see :func:`draw_swept_quantity`. Raises InputError if no axis has two
    numbers, or no case has converged.
    """
    drawn_axis_indices = _select_drawn_axis_indices(sweep_result)
    drawn_axes = [sweep_result.axes[axis_index] for axis_index in drawn_axis_indices]
    fixed_axis_indices = [
        axis_index
        for axis_index in range(len(sweep_result.axes))
        if axis_index not in drawn_axis_indices
    ]

    def split_pictures(picture_values: np.ndarray) -> np.ndarray:
        """Reshape values over all axes to (n_pictures, n_x, n_y); n_y is 1 with one axis."""
        axis_lengths = [*(len(axis.values) for axis in drawn_axes), 1][:2]
        return picture_values.transpose(*fixed_axis_indices, *drawn_axis_indices).reshape(
            -1, *axis_lengths
        )

    is_doubtful = split_pictures(
        sweep_result.converged & (sweep_result.not_stable | sweep_result.inexact)
    )
    fixed_axes = [sweep_result.axes[axis_index] for axis_index in fixed_axis_indices]
    fixed_combinations = itertools.product(*(axis.values for axis in fixed_axes))
    for picture_index, fixed_combination in enumerate(
        itertools.islice(fixed_combinations, 12)
    ):  # of each quantity
        fixed_value_texts = [
            f"{key_in_words(axis.key)} {value_in_words(axis.key, axis_value)}"
            for axis, axis_value in zip(fixed_axes, fixed_combination, strict=True)
        ]
        for quantity_name, quantity_name_and_unit in sweep_result.quantities.items():
            picture_values = split_pictures(
                np.where(sweep_result.converged, sweep_result[quantity_name], np.nan)
            )[picture_index]
            if np.any(np.isfinite(picture_values)):
                file_stem = (
                    f"sweep_{quantity_name}{f'_{picture_index + 1}' if fixed_axis_indices else ''}"
                )
                draw_swept_quantity(
                    drawn_axes,
                    picture_values,
                    is_doubtful[picture_index],
                    quantity_name_and_unit,
                    picture_files,
                    file_stem,
                    fixed_value_texts,
                )


def _select_drawn_axis_indices(sweep_result: SweepResult) -> list[int]:
    """Return the indices of the one or two sweep axes to draw.

    A load frequency comes first, then the longest axis. Only axes with at least two numbers are
    drawn. Raises InputError without any, or if no case has converged.
    """
    axes = sweep_result.axes
    axis_indices = [
        axis_index
        for axis_index, axis in enumerate(axes)
        if len(axis.values) > 1
        and all(isinstance(axis_value, float | int) for axis_value in axis.values)
    ]
    if not axis_indices:
        raise InputError(
            "sweep.over",
            [axis.key for axis in axes],
            "over a key with two or more numbers, to be drawn",
        )
    if not np.any(sweep_result.converged):
        raise InputError(
            "path", str(sweep_result.path), "a sweep with at least one converged case, to be drawn"
        )
    axis_indices.sort(
        key=lambda axis_index: (
            axes[axis_index].key not in LOAD_FREQUENCY_KEYS,
            -len(axes[axis_index].values),
        )
    )
    return axis_indices[:2]


def draw_swept_quantity(
    axes: Sequence[Axis],
    values: np.ndarray,
    is_doubtful: np.ndarray,
    quantity_name_and_unit: tuple[str, str],
    picture_files: PictureFiles,
    file_stem: str,
    fixed_texts: Sequence[str] = (),
) -> None:
    """Draw a sweep's quantity over one or two axes: lines, a map, or both.

    Up to 6 values on the second axis give a line each. More than 6 values give a map instead. With
    at least 4 values on both axes, a map is always drawn.

    Parameters
    ----------
    axes : sequence of Axis
        Horizontal axis, and second axis if there are two.
    values, is_doubtful : (n_x, n_y)
        Values, and True for a case with a large error or without a stable verdict. n_x and n_y are
        the numbers of values on the axes; n_y is 1 for a single axis.
    quantity_name_and_unit : (str, str)
        Name and unit of the quantity.
    picture_files : PictureFiles
        Record of the pictures.
    file_stem : str
        Name of the pictures without ending.
    fixed_texts : sequence of str
        Names and values on all fixed axes, for the title.
    """
    axis_arrays = [np.array(axis.values, dtype=float) for axis in axes]
    sorting_indices = [np.argsort(axis_array) for axis_array in axis_arrays]
    sorted_index_grid = np.ix_(*[*sorting_indices, np.zeros(1, dtype=int)][:2])
    values, is_doubtful = values[sorted_index_grid], is_doubtful[sorted_index_grid]
    scaled_values_and_labels = [
        _convert_axis_to_prefixed_unit(axis, axis_array[sorting_index])
        for axis, axis_array, sorting_index in zip(axes, axis_arrays, sorting_indices, strict=True)
    ]
    quantity_name, unit = quantity_name_and_unit
    title = ", ".join([f"{quantity_name[0].upper()}{quantity_name[1:]}", *fixed_texts])
    n_lines, axes_text = values.shape[1], " and ".join(key_in_words(axis.key) for axis in axes)
    caption = f"{title}, over the {axes_text}; rings: large error, or not stable."
    if has_few_lines := n_lines <= 6:
        line_labels = [quantity_name]
        if len(axes) > 1:
            key, axis_array = axes[1].key, axis_arrays[1][sorting_indices[1]]
            line_labels = [
                f"{key_in_words(key)} {value_in_words(key, float(line_value))}"
                for line_value in axis_array
            ]
        curves_by_label, doubts_by_label = (
            dict(zip(line_labels, value_or_doubt_grid.T, strict=True))
            for value_or_doubt_grid in (values, is_doubtful)
        )
        plot.draw_response(
            scaled_values_and_labels[0][0],
            curves_by_label,
            quantity=quantity_name,
            path=picture_files(file_stem, caption),
            title=title,
            over=scaled_values_and_labels[0][1],
            doubtful=doubts_by_label,
            unit=unit,
        )
    if not has_few_lines or (len(axes) > 1 and min(values.shape) >= 4):
        (x_values, x_label), (y_values, y_label) = scaled_values_and_labels
        unit_factor, prefixed_unit = 1.0, unit
        if unit in ("m", "N"):
            unit_factor, prefixed_unit = choose_factor_and_prefixed_unit(
                float(np.nanmax(np.abs(values))), unit
            )
        plot.draw_map(
            x_values,
            y_values,
            unit_factor * values.T,
            doubtful=is_doubtful.T,
            path=picture_files(f"{file_stem}_map", caption),
            title=title,
            x_label=x_label,
            y_label=y_label,
            value_label=heading_with_unit(quantity_name, prefixed_unit),
        )


def _convert_axis_to_prefixed_unit(axis: Axis, axis_values: np.ndarray) -> tuple[np.ndarray, str]:
    """Scale an axis's values to a readable unit, mm for m; return values and label."""
    unit, unit_factor = unit_of_key(axis.key), 1.0
    if unit and unit not in SCENE_UNITS_WITHOUT_PREFIX:
        unit_factor, unit = choose_factor_and_prefixed_unit(float(np.abs(axis_values).max()), unit)
    return unit_factor * axis_values, heading_with_unit(key_in_words(axis.key), unit)


def draw_crack_growth(growth: Growth, picture_files: PictureFiles) -> None:
    """Draw crack length over load cycles, with frequencies in the scene's unit."""
    caption = "Crack length over the load cycles; dots: lengths at which the vibration was solved."
    plot_study.draw_growth(
        growth, path=picture_files("growth", caption), in_hertz=growth.scene.is_frequency_in_hertz
    )


def draw_campbell_diagram(campbell: Campbell, picture_files: PictureFiles) -> None:
    """Draw a Campbell diagram in the scene's units, with engine orders.

    Orders run from 1 to :data:`MAX_REPORTED_ENGINE_ORDER`, with the load's order in addition.
    """
    scene = campbell.scene
    engine_orders = sorted({*range(1, MAX_REPORTED_ENGINE_ORDER + 1), scene.excitation.order or 1})
    caption = "Natural frequencies over the speed; grey: engine orders; circles: where both meet."
    plot_rotor.draw_campbell(
        campbell,
        engine_orders,
        path=picture_files("campbell", caption),
        in_hertz=scene.is_frequency_in_hertz or scene.is_speed_in_rpm,
        in_rpm=scene.is_speed_in_rpm,
    )


def draw_tip_timing(tip_timing: Timing, picture_files: PictureFiles) -> None:
    """Draw the fits of tip timing.

    In a run-up, each blade has a picture: the resonances passed, or the amplitude over the
    frequency. At constant speed, only the blade with the largest amplitude has a picture.
    """
    caption = "Displacements at the probes over the speed; resonances with their engine orders."
    for blade_index, (blade_number, arrivals) in enumerate(tip_timing.arrivals.items()):
        blade_fit = tip_timing.fits[blade_number]
        file_stem = f"timing_blade_{blade_number}" if blade_index else "timing"
        if isinstance(blade_fit, tuple):
            plot_rotor.draw_passages(blade_fit, arrivals, path=picture_files(file_stem, caption))
        elif isinstance(blade_fit, TipTrack):
            caption = "Amplitudes over the load's frequency, with their standard errors."
            in_hertz = tip_timing.scene is not None and tip_timing.scene.is_frequency_in_hertz
            plot_rotor.draw_tip_track(
                blade_fit, path=picture_files(file_stem, caption), in_hertz=in_hertz
            )
    if blade_number_of_largest_amplitude := find_blade_of_largest_amplitude_or_none(tip_timing):
        caption = (
            f"Blade {blade_number_of_largest_amplitude}: arrivals over the period, the fit, and "
            "the engine "
            "orders that were tried."
        )
        blade_fit = tip_timing.fits[blade_number_of_largest_amplitude]
        assert isinstance(blade_fit, TipFit)
        plot_rotor.draw_tip_fit(
            blade_fit,
            tip_timing.arrivals[blade_number_of_largest_amplitude],
            path=picture_files("timing", caption),
        )


def copy_posterior_picture(
    identification: IdentificationOutput, picture_files: PictureFiles
) -> None:
    """Copy the picture of the posterior drawn by the command ``identify``.

    Raises
    ------
    InputError
        ``identify`` has drawn no picture in this format.
    """
    picture_path = picture_files("posterior", "Probability of cracks by the measurements.")
    source_path = identification.picture_path.with_suffix(picture_path.suffix)
    try:
        write_file_whole(picture_path, read_regular_file(source_path, follows_links=False))
    except OSError:
        raise InputError(
            "--pictures",
            picture_path.suffix[1:],
            f"png, or the format given to identify --pictures: there is no file {source_path}",
        ) from None
