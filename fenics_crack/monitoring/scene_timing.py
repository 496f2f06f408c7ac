"""Tip timing of a scene: arrivals at probes, and their vibration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes, find_probe_angles_by_blade
from fenics_crack.arrivals.fit_frequency import fit_frequency
from fenics_crack.arrivals.fit_order import fit_order
from fenics_crack.arrivals.harmonics import DEFAULT_TRIAL_ORDERS, TipFit
from fenics_crack.arrivals.passages import find_passages
from fenics_crack.arrivals.resonance import PassageFit
from fenics_crack.arrivals.track_order import TipTrack, track_order
from fenics_crack.arrivals.transient import StiffeningFunction
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import MPI, gather_rows
from fenics_crack.basics.tables import RAD_PER_TURN, format_speed
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.fem.build import with_crack_length
from fenics_crack.fem.cracks import RELATIVE_POSITION_TOLERANCE
from fenics_crack.files.results import Result
from fenics_crack.files.store import scene_with_full_paths
from fenics_crack.monitoring.simulate import find_run_up_point_indices, tip_timing
from fenics_crack.numerics.equations import ROUNDING
from fenics_crack.runs.load import load_run
from fenics_crack.runs.run import Run
from fenics_crack.runs.solve import solve
from fenics_crack.scene.keys import RESULT_SETTINGS_TABLE_NAMES
from fenics_crack.scene.result_tables import TipTiming
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Rotation
from fenics_crack.scene.words import describe_differences
from fenics_crack.study.campbell import Campbell, campbell
from fenics_crack.study.plausibility import FAST_TIP_REMARK_TEMPLATE, MAX_PLAUSIBLE_TIP_SPEED

TABLES_ALLOWED_TO_DIFFER_FROM_RESULT = (*RESULT_SETTINGS_TABLE_NAMES, "reduction")
"""Tables of a scene that may differ from the scene of a result.

``[reduction]`` is one of them, because a run chooses its missing keys. The other tables choose
results only.
"""
MIN_PLAUSIBLE_TIP_SPEED = 1.0
"""Minimum plausible speed of a blade tip [m/s].

A lower speed indicates a wrong unit: times in ms that are read as s turn 200 m/s into 0.2 m/s.
"""
IMPLAUSIBLY_SLOW_TIP_REMARK_FORMAT = (
    "the blade tip moves at {:.3g} m/s, but tips of rotors with probes move at 1 to 700 m/s"
)
"""Beginning of a remark on blade tips below :data:`MIN_PLAUSIBLE_TIP_SPEED`."""
MAX_RELATIVE_DISTANCE_OF_RESONANCE_TO_MODE = 0.1
"""Maximum distance from a measured resonance to a mode that explains it.

The distance is relative to the resonance frequency.
"""


def arrivals_of_blades(
    scene: Scene,
    source: Mapping[int, ArrivalTimes] | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> tuple[dict[int, ArrivalTimes], Run[Result] | None]:
    """Return the arrival times of every blade at the probes (collective).

    The table ``[tip_timing]`` of the scene has the probes. In a bladed disk, blade j + 1 is one
    sector ahead of blade j in the direction of rotation. Other scenes have one blade.

    Parameters
    ----------
    scene : Scene
        With [tip_timing].
    source : mapping of int to ArrivalTimes, or path, optional
        Mapping: measured arrivals by blade number, returned unchanged. Path: file of a result of
        ``solve`` or ``curve``, from which arrivals are computed. Default: the scene is solved for
        its steady vibration, and arrivals are computed from the solution. A run-up along a curve
        ends before the curve becomes unstable.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    arrivals : dict of int to ArrivalTimes
        Arrivals by blade number from 1.
    run : Run or None
        Solution or curve from which the arrivals were computed; None for measured arrivals.

    Raises
    ------
    InputError
        The scene has no ``[tip_timing]``, the file has another kind of result, or arrivals cannot
        be computed (:func:`tip_timing`).

    Examples
    --------
    >>> arrivals, run = fc.arrivals_of_blades(disk)
    """
    if isinstance(source, Mapping):
        return dict(source), None
    timing_table = scene.given("tip_timing")
    run, arrivals_by_blade = _load_or_solve_run(scene, source, comm), {}
    for blade_number, probe_angles in find_probe_angles_by_blade(
        np.radians(timing_table.probes), run.structure.whole.n_sectors
    ).items():
        begin_stage(f"arrivals of blade {blade_number}")
        arrivals_by_blade[blade_number] = _compute_arrivals(
            timing_table, run, source, np.sort(probe_angles), blade_number
        )
    return arrivals_by_blade, run


def _load_or_solve_run(scene: Scene, source_path: Path | None, comm: MPI.Comm) -> Run[Result]:
    """Load a result, or solve the scene if there is no path (collective).

    Raises
    ------
    InputError
        The result is neither a converged solution nor a curve.
    """
    run: Run[Result] = solve(scene, comm) if source_path is None else load_run(source_path, comm)
    result = run.result
    if not isinstance(result, (PeriodicSolution, ResponseCurve)):
        raise InputError(
            "source", str(source_path), "a result of solve or curve, or a CSV file of arrivals"
        )
    if isinstance(result, PeriodicSolution) and not result.converged:
        raise InputError(
            "source",
            str(source_path or "the scene"),
            f"a converged solution, but this one ended with: {result.status}",
        )
    return run


def get_response_curve_or_none(run: Run[Any] | None) -> ResponseCurve | None:
    """Return the response curve of a run; None if its result is no curve.

    ``run`` is None for measured arrivals; None is then returned.
    """
    result = None if run is None else run.result
    return result if isinstance(result, ResponseCurve) else None


def _compute_arrivals(
    timing_table: TipTiming,
    run: Run[Any],
    source_path: Path | None,
    probe_angles: np.ndarray,
    blade_number: int,
) -> ArrivalTimes:
    """Compute the arrival times of one blade at the probes (collective).

    A run-up ends before the curve becomes unstable.

    Parameters
    ----------
    timing_table : TipTiming
        Table ``[tip_timing]``.
    run : Run
        Solution or curve of the vibration.
    source_path : path or None
        File of the run, for errors; None if solved now.
    probe_angles : (n,) [rad]
        Increasing angles from this blade's tip.
    blade_number : int
        Number of the blade, from 1.
    """
    result: Any = run.result
    if (curve := get_response_curve_or_none(run)) is not None:
        passed_curve_point_indices, unstable_index = find_run_up_point_indices(curve)
        # Take the part before the curve becomes unstable. If this part has fewer than two points,
        # take the whole curve; tip_timing then raises the error.
        result = (
            curve
            if unstable_index is None or len(passed_curve_point_indices) < 2
            else curve.part(passed_curve_point_indices)
        )
    return tip_timing(
        result,
        find_tip_factor_by_dof(timing_table, run, blade_number),
        probes=probe_angles,
        tip_radius=timing_table.tip_radius,
        revolutions=timing_table.revolutions,
        noise=timing_table.noise,
        clock=timing_table.clock,
        seed=timing_table.seed + blade_number - 1,
        **_choose_speed_or_order_argument(timing_table, run, source_path),
    )


def describe_run_up_end_or_empty(scene: Scene, run: Run[Any]) -> str:
    """Describe the speed at which a computed run-up becomes unstable.

    Return "" if the result is no curve, or if the whole curve is stable.
    """
    if (curve := get_response_curve_or_none(run)) is None:
        return ""
    passed_curve_point_indices, unstable_index = find_run_up_point_indices(curve)
    if unstable_index is None:
        return ""
    last_and_unstable_speeds = curve.omega[
        [passed_curve_point_indices[-1], unstable_index]
    ] / get_engine_order(scene.given("tip_timing"), run.scene)
    last_speed_text, unstable_speed_text = (
        format_speed(last_or_unstable_speed, scene.is_speed_in_rpm)
        for last_or_unstable_speed in last_and_unstable_speeds
    )
    run_up_end_text = f"the computed run-up ends at {last_speed_text}"
    return f"the vibration is unstable at {unstable_speed_text}: {run_up_end_text}"


def describe_scene_difference_or_empty(scene: Scene, run: Run[Any]) -> str:
    """Describe how the scene of a run differs from a given scene (collective).

    The tables in :data:`TABLES_ALLOWED_TO_DIFFER_FROM_RESULT` are not compared. Return "" if
    nothing differs.
    """
    compared_scenes = [
        scene_with_full_paths(scene).replace(dict.fromkeys(TABLES_ALLOWED_TO_DIFFER_FROM_RESULT))
        for scene in (with_crack_length(scene, run.structure.comm), run.scene)
    ]
    scene_text, result_text = describe_differences(compared_scenes)
    sentence_start_text = (
        f"the arrivals were computed with {result_text}, but their vibration is fitted with this "
    )
    return (
        sentence_start_text + f"scene, which has {scene_text}: use the same scene for both"
        if scene_text
        else ""
    )


def list_arrival_unit_remarks(arrivals: ArrivalTimes) -> list[str]:
    """Return remarks on measured arrivals that seem to have wrong units.

    A remark follows if the tip speed is outside 1 to 1000 m/s. Another follows if there are several
    probes, all below 6.28 degrees: angles in rad may have been read as degrees. Otherwise the list
    is empty.
    """
    remark_texts, tip_speed = [], arrivals.mean_speed * arrivals.tip_radius
    if not MIN_PLAUSIBLE_TIP_SPEED < tip_speed < MAX_PLAUSIBLE_TIP_SPEED:
        speed_remark_format = (
            FAST_TIP_REMARK_TEMPLATE
            if tip_speed > MIN_PLAUSIBLE_TIP_SPEED
            else IMPLAUSIBLY_SLOW_TIP_REMARK_FORMAT
        )
        question_text = "are the speed or times, and tip_radius, in the units of their headings?"
        remark_texts.append(f"{speed_remark_format.format(tip_speed)}: {question_text}")
    if len(arrivals.probes) > 1 and np.degrees(arrivals.probes[-1]) < RAD_PER_TURN:
        probe_range_degrees = float(np.degrees(np.ptp(arrivals.probes)))
        remark_texts.append(
            f"all probes are within {probe_range_degrees:.3g} degrees: are their angles in rad "
            "instead of degrees?"
        )
    return remark_texts


def is_run_up(arrivals: ArrivalTimes, run: Run[Any] | None) -> bool:
    """Return True if arrivals belong to a run-up or run-down.

    The arrivals come from a response curve, or the speed varies by more than 1 %.
    """
    return get_response_curve_or_none(run) is not None or not arrivals.steady


def fit_vibration_or_passages(
    timing_table: TipTiming,
    arrivals: ArrivalTimes,
    scene: Scene | None = None,
    run: Run[Any] | None = None,
) -> TipFit | TipTrack | tuple[PassageFit, ...]:
    """Fit the vibration in one blade's arrivals, as ``[tip_timing]`` requests.

    At constant speed, the first given key decides. With ``frequencies``, fit a frequency between
    these two. With ``orders``, fit the best engine order among these. Without both keys, fit the
    load's order. If the load's order is unknown, fit the best order from 1 to 24.

    In a measured run-up with ``orders``, find the resonances. In any other run-up, track the load's
    order. If the load's order is unknown, find the resonances.

    Parameters
    ----------
    timing_table : TipTiming
        Table ``[tip_timing]``; its ``order`` precedes the scene's ``excitation.order``.
    arrivals : ArrivalTimes
        Arrivals of the blade.
    scene : Scene, optional
        Scene with the load's order and the rotation.
    run : Run, optional
        Solution or curve from which the arrivals were computed; None for measured arrivals.

    Returns
    -------
    TipFit, TipTrack or tuple of PassageFit
        Vibration at constant speed, tracked order, or resonances in a run-up.

    Raises
    ------
    InputError
        The arrivals do not suffice for :func:`fit_order`, :func:`fit_frequency`,
        :func:`track_order` or :func:`find_passages`; or a key of the table does not belong to this
        fit.
    """
    load_order = timing_table.order or (None if scene is None else scene.excitation.order)
    fit_argument_by_name: dict[str, Any] = {
        "harmonics": timing_table.fitted_harmonics,
        "angle_deviation": np.radians(timing_table.angle_deviation),
    }
    passage_keys_and_owner_text = (
        ("stiffening",),
        "arrivals at constant speed, or of one tracked order: only a search for the resonances of "
        "a measured run-up uses this key",
    )
    if is_run_up(arrivals, run):
        run_up_text = (
            "a run-up: an order is tracked there, or the resonances that it passes are found"
        )
        timing_table.forbid_keys(("frequencies",), run_up_text)
        if load_order is None or (run is None and timing_table.orders):
            single_order_keys = "fitted_harmonics", "subharmonic", "fitted_revolutions"
            timing_table.forbid_keys(
                single_order_keys,
                "a search for the resonances of a run-up; to track one order, give "
                "tip_timing.order and leave out tip_timing.orders",
            )
            diagram_or_none = (
                _compute_campbell_diagram(scene, arrivals) if scene and scene.rotation else None
            )
            return _fit_passages(timing_table, arrivals, diagram_or_none)
        timing_table.forbid_keys(*passage_keys_and_owner_text)
        timing_table.forbid_keys(
            ("orders",), f"a computed run-up: the order of its load, {load_order}, is tracked"
        )
        return track_order(
            arrivals,
            load_order,
            subharmonic=timing_table.subharmonic,
            revolutions=timing_table.fitted_revolutions,
            **fit_argument_by_name,
        )
    timing_table.forbid_keys(*passage_keys_and_owner_text)
    if timing_table.frequencies is not None:
        lower_omega, upper_omega = (
            2.0 * np.pi * frequency for frequency in timing_table.frequencies
        )
        return fit_frequency(arrivals, lower_omega, upper_omega, **fit_argument_by_name)
    trial_orders = timing_table.orders or ([load_order] if load_order else DEFAULT_TRIAL_ORDERS)
    return fit_order(
        arrivals, trial_orders, **fit_argument_by_name, subharmonic=timing_table.subharmonic
    )


def find_passages_and_modes(
    scene: Scene, arrivals: ArrivalTimes
) -> list[tuple[PassageFit, int, str]]:
    """Find the resonances in a measured run-up, and their modes (collective).

    Returns
    -------
    list of (PassageFit, int, str)
        For each resonance: the fit, the number of the scene's mode from 1, and a reason. If no mode
        matches, the number is 0, and the reason says why; otherwise the reason is "".

    Raises
    ------
    InputError
        The resonances cannot be found (:func:`find_passages`); or the scene has no ``[rotation]``
        or no ``excitation.order``.
    """
    if scene.rotation is None or scene.excitation.order is None:
        requirement_text = (
            "recorded at constant speed; a run-up needs [rotation] and excitation.order in "
            "the scene"
        )
        raise InputError("arrivals", repr(arrivals), requirement_text)
    diagram = _compute_campbell_diagram(scene, arrivals)
    return [
        (passage_fit, *match_mode_or_give_reason(passage_fit, diagram))
        for passage_fit in _fit_passages(scene.given("tip_timing"), arrivals, diagram)
    ]


def describe_passage(passage_fit: PassageFit, mode: int, reason_text: str) -> str:
    """Describe a resonance in a run-up, with its mode.

    Reasons for doubt follow in brackets, for example another vibration near the resonance. ``mode``
    is the mode's number from 1, or 0 if the resonance is not used. ``reason_text`` says why the
    resonance is not used; "" if a mode is given.
    """
    doubt_texts = [
        "another vibration is near this resonance, and frequency and damping may be wrong"
    ] * passage_fit.in_doubt
    doubt_texts += [f"its {passage_fit.disagreement_in_words}"] * passage_fit.passages_disagree
    remark_text = "; ".join([reason_text] * bool(reason_text) + doubt_texts)
    mode_text = f"mode {mode}" if mode else "not used"
    return f"{mode_text}: {passage_fit.in_words}" + f" ({remark_text})" * bool(remark_text)


def match_mode_or_give_reason(passage_fit: PassageFit, diagram: Campbell) -> tuple[int, str]:
    """Match a measured resonance with a mode of the Campbell diagram.

    A mode covers the range from its frequency with open crack to its frequency with bonded crack.
    Three conditions must hold. The range of the nearest mode is within 10 % of the resonance
    frequency. The range of the second nearest mode is not within 5 %. If further orders explain the
    arrivals equally well, none of them gives a frequency within 10 % of a mode.

    Returns
    -------
    int
        Number of the mode, from 1; 0 without a match.
    str
        Reason without a match; "" with a match.
    """
    omega_open, omega_tied = diagram.interpolate_open_and_tied(passage_fit.speed)

    def compute_relative_mode_distances(omega: float) -> np.ndarray:
        return np.maximum(np.maximum(omega_open - omega, omega - omega_tied), 0.0) / omega

    mode_distances = compute_relative_mode_distances(passage_fit.omega)
    mode_indices_nearest_first = np.argsort(mode_distances)
    mode_frequency_range_texts = [
        f"mode {mode_index + 1} has {omega_open[mode_index] / RAD_PER_TURN:.6g} to "
        f"{omega_tied[mode_index] / RAD_PER_TURN:.6g} Hz at this speed"
        for mode_index in mode_indices_nearest_first[:2]
    ]
    if mode_distances[mode_indices_nearest_first[0]] > MAX_RELATIVE_DISTANCE_OF_RESONANCE_TO_MODE:
        return (
            0,
            "no mode of the blade is within "
            f"{MAX_RELATIVE_DISTANCE_OF_RESONANCE_TO_MODE:.0%} of this "
            f"frequency; {mode_frequency_range_texts[0]}",
        )
    if (
        len(mode_distances) > 1
        and mode_distances[mode_indices_nearest_first[1]]
        < 0.5 * MAX_RELATIVE_DISTANCE_OF_RESONANCE_TO_MODE
    ):
        return 0, f"two modes are near this frequency: {'; '.join(mode_frequency_range_texts)}"
    other_order_texts = [
        f"{ambiguous_order:g}"
        for ambiguous_order in passage_fit.ambiguous_orders
        if min(compute_relative_mode_distances(ambiguous_order * passage_fit.speed))
        <= MAX_RELATIVE_DISTANCE_OF_RESONANCE_TO_MODE
    ]
    if other_order_texts:
        reason_text = (
            "two probes cannot exclude it"
            if passage_fit.is_order_untested
            else "explains the arrivals equally well"
        )
        return 0, (
            f"order {' or '.join(other_order_texts)} meets a mode of the blade, too, and "
            f"{reason_text}: give the possible orders in tip_timing.orders"
        )
    return int(mode_indices_nearest_first[0]) + 1, ""


def _fit_passages(
    timing_table: TipTiming, arrivals: ArrivalTimes, diagram_or_none: Campbell | None
) -> tuple[PassageFit, ...]:
    """Find the resonances in a run-up of one blade.

    The fit needs the stiffening, d ln w / d ln W for a natural frequency w over the rotor speed W.
    If ``tip_timing.stiffening`` is given, this number is used. Otherwise the stiffening comes from
    the Campbell diagram. Without a diagram, it is 0.

    Parameters
    ----------
    timing_table : TipTiming
        Table ``[tip_timing]``.
    arrivals : ArrivalTimes
        Arrivals of the blade.
    diagram_or_none : Campbell or None
        Campbell diagram of the blade.

    Returns
    -------
    tuple of PassageFit
        Fit of each resonance (:func:`find_passages`).
    """
    stiffening_or_function: float | StiffeningFunction = timing_table.stiffening or 0.0
    if timing_table.stiffening is None and diagram_or_none is not None:
        stiffening_or_function = diagram_or_none.stiffening
    return find_passages(
        arrivals, timing_table.orders or DEFAULT_TRIAL_ORDERS, stiffening=stiffening_or_function
    )


def _compute_campbell_diagram(scene: Scene, arrivals: ArrivalTimes) -> Campbell:
    """Return a Campbell diagram over the speeds of arrivals (collective).

    The diagram has ten modes at five equally spaced speeds.
    """
    begin_stage("Campbell diagram")
    rotor_speeds = np.linspace(arrivals.speed.min(), arrivals.speed.max(), 5)
    return campbell(scene, rotor_speeds, few=10)


def find_tip_factor_by_dof(
    timing_table: TipTiming, run: Run, blade_number: int = 0
) -> dict[int, float]:
    """Return dofs and factors of the tip displacement that the probes measure (collective).

    The displacement in the direction of rotation is the sum of all factors times their dofs.

    Parameters
    ----------
    timing_table : TipTiming
        Table ``[tip_timing]``.
    run : Run
        Run with the structure.
    blade_number : int
        Blade of a bladed disk, from 1; 0 for the blade with the watched dof.

    Raises
    ------
    InputError
        The blade tip of a solid lies on the rotor axis.
    """
    structure = run.structure.whole
    rotation_table_if_solid = _get_rotation_table_of_solid_or_none(timing_table, run.scene)
    tangential_factor = timing_table.tangential
    sector_structure, is_disk = structure.sector_structure, structure.n_sectors > 1
    _, tip_dof = structure.blade_and_sector_dof_of(run.watched_dof)
    factor_by_dof = {tip_dof: 1.0 if tangential_factor is None else tangential_factor}
    if tangential_factor is None and (is_disk or rotation_table_if_solid):
        dofs_by_node, points_of_all_nodes = (
            gather_rows(sector_structure.comm, node_rows_of_rank)
            for node_rows_of_rank in (sector_structure.nodes.dofs, sector_structure.nodes.points)
        )
        node_index = int(np.argwhere(dofs_by_node == tip_dof)[0, 0])
        if (
            is_disk or rotation_table_if_solid is None
        ):  # (Q - Q^T) x is the cross product of axis and x, times 2 sin(2 pi / N)
            sector_turn_matrix = structure.sector.one_sector_rotation
            rotation_center = structure.sector.center
            tip_direction = (sector_turn_matrix - sector_turn_matrix.T) @ (
                points_of_all_nodes[node_index] - rotation_center
            )
            tip_direction /= np.linalg.norm(tip_direction)
        else:
            tip_direction = _find_circumferential_direction(
                run.scene, points_of_all_nodes[node_index]
            )
        factor_by_dof = {
            dof: factor
            for dof, factor in zip(
                dofs_by_node[node_index].tolist(), tip_direction.tolist(), strict=True
            )
            if dof >= 0 and factor != 0.0
        }
    return {
        structure.dof_of(blade_number or structure.watched_sector_index + 1, dof): factor
        for dof, factor in factor_by_dof.items()
    }


def describe_probed_tip_displacement(timing_table: TipTiming, run: Run) -> str:
    """Describe the displacement that the probes measure (collective).

    An example is "the probes measure 1 times the y displacement at (0.1, 0.1) m".
    """
    structure = run.structure.whole
    term_texts = [
        f"{factor:.4g} times the {structure.dof_name(dof)}"
        for dof, factor in find_tip_factor_by_dof(timing_table, run).items()
    ]
    return f"the probes measure {' and '.join(term_texts)}"


def find_probed_displacement_and_reversal(scene: Scene) -> tuple[str, bool]:
    """Find the displacement that measured arrivals show, from the scene alone.

    Returns
    -------
    str
        Point and direction, as "tip.ux"; "" for the load's displacement.
    bool
        True if this displacement points against the rotation.

    Raises
    ------
    InputError
        The blade tip of a solid is not given, lies on the rotor axis, or does not move along x, y
        or z (within 2.6 degrees).
    """
    timing_table = scene.given("tip_timing")
    rotation_table_if_solid = _get_rotation_table_of_solid_or_none(timing_table, scene)
    if rotation_table_if_solid is None:
        return [*scene.label_by_displacement_name, ""][0], (timing_table.tangential or 1.0) < 0.0
    if not scene.output_points:
        requirement_text = "given with arrivals of a solid blade; the first point is the blade tip"
        raise InputError("output.points", None, requirement_text)
    tip_point = scene.output_points[0]
    direction = _find_circumferential_direction(scene, np.array(tip_point.values))
    axis_index = int(np.abs(direction).argmax())
    if abs(direction[axis_index]) < 0.999:  # 2.6 degrees, an error of a thousandth
        direction_components_text = ", ".join(
            f"{direction_component:.3g}" for direction_component in direction
        )
        requirement_text = (
            f"given, since the tip moves along ({direction_components_text}), not along x, y or "
            "z: its "
            "displacement in this direction over the first displacement of [output.points]"
        )
        raise InputError("tip_timing.tangential", None, requirement_text)
    return f"{tip_point.key}.u{'xyz'[axis_index]}", bool(direction[axis_index] < 0.0)


def _get_rotation_table_of_solid_or_none(timing_table: TipTiming, scene: Scene) -> Rotation | None:
    """Return the table ``[rotation]`` if it gives the direction of a solid's tip displacement.

    Return None for plates, without rotation, or if ``tip_timing.tangential`` is given. The tip
    displacement is then the watched displacement times ``tip_timing.tangential`` (default 1).
    """
    return scene.rotation if timing_table.tangential is None and scene.dimension == 3 else None


def _find_circumferential_direction(scene: Scene, point: np.ndarray) -> np.ndarray:
    """Return the unit vector (3,) in which a rotor carries a point.

    The direction is a x (x - x_0) for the point x [m], with the rotor axis a through x_0.

    Raises
    ------
    InputError
        The point lies on the rotor axis.
    """
    axis_point, axis = scene.axis_point_and_direction
    direction = np.cross(axis, point - axis_point)
    distance_from_axis = float(np.linalg.norm(direction))
    if distance_from_axis <= RELATIVE_POSITION_TOLERANCE * float(np.abs([point, axis_point]).max()):
        point_coordinates = [float(point_coordinate) for point_coordinate in point]
        raise InputError(
            "output.points",
            point_coordinates,
            "away from the axis of [rotation]: the first point is the blade tip",
        )
    return np.where(
        np.abs(direction) > ROUNDING * distance_from_axis, direction / distance_from_axis, 0.0
    )


def _choose_speed_or_order_argument(
    timing_table: TipTiming, run: Run, source_path: Path | None
) -> dict[str, Any]:
    """Choose the argument ``speed`` or ``order`` of :func:`tip_timing`.

    The result is a dict with one entry: ``speed``, the rotor speed [rad/s], or ``order``, the load
    periods in a revolution. ``source_path`` is the file of the run; None if the run was solved now.

    Raises
    ------
    InputError
        Rotor speed and order are both missing, or both given; or the rotor has one speed along the
        whole curve.
    """
    owner_text = "" if source_path is None else f" of {str(source_path)!r}"
    response_curve_or_none = get_response_curve_or_none(run)
    if (
        response_curve_or_none is not None
        and run.scene.speed > 0.0
        and response_curve_or_none.parameter != "speed"
    ):
        speed_text = format_speed(run.scene.speed, run.scene.is_speed_in_rpm)
        requirement_text = (
            f"'rpm' or 'speed' for a run-up: along this curve the rotor stays at {speed_text}"
        )
        raise InputError("curve.parameter", run.scene.given("curve").parameter, requirement_text)
    is_steady = run.scene.excitation.order is None and response_curve_or_none is None
    if is_steady and run.scene.speed > 0.0:
        timing_table.forbid_keys(("order",), f"the rotor speed of [rotation]{owner_text}")
        return {"speed": run.scene.speed}
    if (
        source_path is not None
        and run.scene.excitation.order is None
        and timing_table.order is None
    ):
        requirement_text = (
            "a result of a scene with [rotation] and excitation.order; for this one, give "
            "tip_timing.order, the periods of the load in a revolution"
        )
        raise InputError("source", str(source_path), requirement_text)
    return {"order": get_engine_order(timing_table, run.scene, owner_text)}


def get_engine_order(timing_table: TipTiming, scene: Scene, owner_text: str = "") -> int:
    """Return the load periods in a revolution, from the scene or ``[tip_timing]``.

    ``owner_text`` names the scene's file in errors, as " of 'curve.h5'".

    Raises
    ------
    InputError
        Neither or both of ``excitation.order`` and ``tip_timing.order`` are given.
    """
    if scene.excitation.order is not None:
        timing_table.forbid_keys(("order",), f"excitation.order{owner_text}")
        return scene.excitation.order
    engine_order: int = timing_table.given(
        "order",
        "given without excitation.order: the periods of the load in a revolution, a whole number "
        ">= 1",
    )
    return engine_order
