"""Tip timing of a scene: arrivals at probes, and their vibration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes, probes_of_blades
from fenics_crack.arrivals.fit_frequency import fit_frequency
from fenics_crack.arrivals.fit_order import TipTrack, fit_order, track_order
from fenics_crack.arrivals.harmonics import ORDERS, TipFit
from fenics_crack.arrivals.passages import Follows, PassageFit, find_passages
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import MPI, gather_rows
from fenics_crack.basics.tables import TURN, speed_in_words
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.fem.build import with_crack_length
from fenics_crack.fem.cracks import POSITION_TOLERANCE
from fenics_crack.files.results import Result
from fenics_crack.files.store import with_full_paths
from fenics_crack.monitoring.simulate import run_up_points, tip_timing
from fenics_crack.numerics.equations import ROUNDING
from fenics_crack.runs.load import load_run
from fenics_crack.runs.run import Run
from fenics_crack.runs.solve import solve
from fenics_crack.scene.scene import LOOKED_AT, Scene
from fenics_crack.scene.tables import Rotation, TipTiming
from fenics_crack.scene.words import differences
from fenics_crack.study.campbell import Campbell, campbell
from fenics_crack.study.plausibility import FASTEST, TOO_FAST

TABLES_NOT_COMPARED = (*LOOKED_AT, "reduction")
"""Tables that may differ between a scene and a result: they choose results, or a run decides
them."""
MIN_TIP_SPEED = 1.0
"""Minimum plausible speed of a blade tip [m/s]; times in ms in place of s turn 200 into 0.2."""
TOO_SLOW = "the blade tip moves at {:.3g} m/s, where rotors with probes have 1 to 700"
MAX_MODE_DISTANCE = 0.1
"""Maximum distance between a resonance and a mode, relative to the resonance frequency."""


def arrivals_of_blades(
    scene: Scene,
    source: Mapping[int, ArrivalTimes] | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> tuple[dict[int, ArrivalTimes], Run[Result] | None]:
    """Return arrival times of every blade by ``[tip_timing]`` of a scene (collective).

    Blade j + 1 of a bladed disk is a sector ahead of blade j in the direction of rotation. Other
    scenes have one blade.

    Parameters
    ----------
    scene : Scene
        With [tip_timing].
    source : mapping of int to ArrivalTimes, or path, optional
        Measured arrivals by the numbers of the blades; or a result of ``solve`` or ``curve``, whose
        scene has the rotation. A run-up ends where the curve becomes unstable. Default: the steady
        vibration of the scene, which is solved.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    dict of int to ArrivalTimes, Run or None
        Arrivals by the numbers of the blades, and the run that they are computed from; None for
        measured arrivals.

    Raises
    ------
    InputError
        The scene has no such table, the source is something else, or as :func:`tip_timing`.

    Examples
    --------
    >>> arrivals, run = fc.arrivals_of_blades(disk)
    """
    if isinstance(source, Mapping):
        return dict(source), None
    table = scene.given("tip_timing")
    run, blades = _load_or_solve(scene, source, comm), {}
    n_blades = run.structure.whole.n_sectors
    for blade, probes in probes_of_blades(np.radians(table.probes), n_blades).items():
        begin(f"arrivals of blade {blade}")
        blades[blade] = _compute_arrivals(table, run, source, np.sort(probes), blade)
    return blades, run


def _load_or_solve(scene: Scene, source: Path | None, comm: MPI.Comm) -> Run[Result]:
    """Return the run of a source, or solve the scene (collective)."""
    run: Run[Result] = solve(scene, comm) if source is None else load_run(source, comm)
    result = run.result
    if not isinstance(result, (PeriodicSolution, ResponseCurve)):
        raise InputError("source", str(source), "a solution, a curve, or a CSV file of arrivals")
    if isinstance(result, PeriodicSolution) and not result.converged:
        raise InputError("source", str(source or "the scene"), f"converged: {result.status}")
    return run


def curve_of(run: Run[Any] | None) -> ResponseCurve | None:
    """Return the curve of computed arrivals, or None of another source."""
    result = None if run is None else run.result
    return result if isinstance(result, ResponseCurve) else None


def _compute_arrivals(
    table: TipTiming, run: Run[Any], source: Path | None, probes: np.ndarray, blade: int
) -> ArrivalTimes:
    """Compute arrivals of a blade at probes (n,) [rad] (collective)."""
    result: Any = run.result
    if (curve := curve_of(run)) is not None:
        indices, unstable_index = run_up_points(curve)
        # The part before the curve becomes unstable; all of a curve that is so at once.
        result = curve if unstable_index is None or len(indices) < 2 else curve.part(indices)
    options = {key: getattr(table, key) for key in ("tip_radius", "revolutions", "noise", "clock")}
    options |= {"probes": probes, "seed": table.seed + blade - 1}
    return tip_timing(
        result,
        tip_direction(table, run, blade),
        **options,
        **_choose_speed_or_order(table, run, source),
    )


def describe_run_up_end(scene: Scene, run: Run[Any]) -> str:
    """Describe where a run-up becomes unstable, or return ""."""
    if (curve := curve_of(run)) is None:
        return ""
    indices, unstable_index = run_up_points(curve)
    if unstable_index is None:
        return ""
    speeds = curve.omega[[indices[-1], unstable_index]] / engine_order(
        scene.given("tip_timing"), run.scene
    )
    last_speed, unstable_speed = (speed_in_words(speed, scene.in_rpm) for speed in speeds)
    return f"the vibration is unstable at {unstable_speed}: the run-up ends before, at {last_speed}"


def describe_scene_difference(scene: Scene, run: Run[Any]) -> str:
    """Describe how the scene of a result differs, or return "" (collective)."""
    scenes = with_crack_length(scene, run.structure.comm), run.scene
    compared_scenes = [
        with_full_paths(scene).replace(dict.fromkeys(TABLES_NOT_COMPARED)) for scene in scenes
    ]
    scene_words, result_words = differences(compared_scenes)
    sentence_start = (
        f"the arrivals are those of a result with {result_words}; the vibration is sought by this "
    )
    return sentence_start + f"scene, which has {scene_words}" if scene_words else ""


def remarks_on_arrivals(arrivals: ArrivalTimes) -> list[str]:
    """Return remarks on measured arrivals that seem to be in another unit."""
    remarks, tip_speed = [], arrivals.mean_speed * arrivals.tip_radius
    if not MIN_TIP_SPEED < tip_speed < FASTEST:
        template = TOO_FAST if tip_speed > MIN_TIP_SPEED else TOO_SLOW
        question = "are speed, or times, and tip_radius in the units of their headings?"
        remarks.append(f"{template.format(tip_speed)}: {question}")
    if len(arrivals.probes) > 1 and np.degrees(arrivals.probes[-1]) < TURN:
        probe_range = float(np.degrees(np.ptp(arrivals.probes)))
        remarks.append(f"all probes are within {probe_range:.3g} degrees: are angles in rad?")
    return remarks


def is_run_up(arrivals: ArrivalTimes, run: Run[Any] | None) -> bool:
    """Return True if arrivals have a curve or a varying speed."""
    return curve_of(run) is not None or not arrivals.steady


def fit_vibration(
    table: TipTiming,
    arrivals: ArrivalTimes,
    scene: Scene | None = None,
    run: Run[Any] | None = None,
) -> TipFit | TipTrack | tuple[PassageFit, ...]:
    """Fit the vibration that ``[tip_timing]`` requests to arrival times.

    At constant speed, fit frequencies if a range is given; otherwise the orders of the table, the
    order of the load, or the default orders. In a run-up, track the order of the load; without it,
    or if orders are given with a measured run-up, find the resonances passed.

    Raises
    ------
    InputError
        As :func:`fit_order`, :func:`fit_frequency`, :func:`track_order` and :func:`find_passages`;
        or a frequency is requested in a run-up, orders in one that is computed, or more than first
        harmonics, or revolutions together, where its resonances are sought.
    """
    order = table.order or (None if scene is None else scene.excitation.order)
    options: dict[str, Any] = {"harmonics": table.fitted_harmonics}
    options["angle_deviation"] = np.radians(table.angle_deviation)
    passage_arguments = ("stiffening",), "all but a measured run-up in which resonances are sought"
    if is_run_up(arrivals, run):
        reason = (
            "a run-up, in which an order is tracked, or the resonances are found that are passed"
        )
        table.leave_out(("frequencies",), reason)
        if order is None or (run is None and table.orders):
            order_keys = "fitted_harmonics", "subharmonic", "fitted_revolutions"
            table.leave_out(order_keys, "a run-up in which resonances are sought")
            diagram = _campbell_diagram(scene, arrivals) if scene and scene.rotation else None
            return _fit_passages(table, arrivals, diagram)
        table.leave_out(*passage_arguments)
        table.leave_out(("orders",), f"a computed run-up: order {order} is tracked")
        options |= {"subharmonic": table.subharmonic, "revolutions": table.fitted_revolutions}
        return track_order(arrivals, order, **options)
    table.leave_out(*passage_arguments)
    if table.frequencies is not None:
        min_omega, max_omega = (2.0 * np.pi * frequency for frequency in table.frequencies)
        return fit_frequency(arrivals, min_omega, max_omega, **options)
    orders = table.orders or ([order] if order else ORDERS)
    return fit_order(arrivals, orders, **options, subharmonic=table.subharmonic)


def modes_passed(scene: Scene, arrivals: ArrivalTimes) -> list[tuple[PassageFit, int, str]]:
    """Find the resonances that a record passes, and their modes (collective).

    Returns a list of (resonance, mode of the scene from 1, ""), or (resonance, 0, reason).

    Raises
    ------
    InputError
        As :func:`find_passages`; or the load is no engine order of a table ``[rotation]``.
    """
    if scene.rotation is None or scene.excitation.order is None:
        requirement = (
            "those of a constant speed, unless the load is an excitation.order of [rotation]"
        )
        raise InputError("arrivals", repr(arrivals), requirement)
    diagram = _campbell_diagram(scene, arrivals)
    fits = _fit_passages(scene.given("tip_timing"), arrivals, diagram)
    return [(fit, *mode_of(fit, diagram)) for fit in fits]


def passed_in_words(fit: PassageFit, mode: int, reason: str) -> str:
    """Describe a resonance and its mode, with doubts or reasons."""
    doubts = ["another vibration is near it"] * fit.in_doubt
    doubts += [f"its {fit.disagreement}"] * fit.disagree
    remark = "; ".join([reason] * bool(reason) + doubts)
    name = f"mode {mode}" if mode else "not used"
    return f"{name}: {fit.in_words}" + f" ({remark})" * bool(remark)


def mode_of(fit: PassageFit, diagram: Campbell) -> tuple[int, str]:
    """Return a resonance's mode (from 1) and "", or 0 and why."""
    omega_open, omega_tied = diagram.between(fit.speed)

    def distances_from(omega: float) -> np.ndarray:
        return np.maximum(np.maximum(omega_open - omega, omega - omega_tied), 0.0) / omega

    distances = distances_from(fit.omega)
    nearest_modes = np.argsort(distances)
    ranges = [
        f"mode {mode + 1} has {omega_open[mode] / TURN:.6g} to "
        f"{omega_tied[mode] / TURN:.6g} Hz there"
        for mode in nearest_modes[:2]
    ]
    if distances[nearest_modes[0]] > MAX_MODE_DISTANCE:
        return 0, f"that of none of the blade's modes to {MAX_MODE_DISTANCE:.0%}; {ranges[0]}"
    if len(distances) > 1 and distances[nearest_modes[1]] < 0.5 * MAX_MODE_DISTANCE:
        return 0, "; ".join(ranges)
    other_orders = [
        f"{order:g}"
        for order in fit.ambiguous
        if min(distances_from(order * fit.speed)) <= MAX_MODE_DISTANCE
    ]
    if other_orders:
        reason = (
            "may be right, too: two probes test none" if fit.untested else "explains it as well"
        )
        return 0, f"order {', '.join(other_orders)} {reason}, and meets a mode there, too"
    return int(nearest_modes[0]) + 1, ""


def _fit_passages(
    table: TipTiming, arrivals: ArrivalTimes, diagram: Campbell | None
) -> tuple[PassageFit, ...]:
    """Find resonances, with the stiffening of the table, diagram, or none."""
    stiffening: float | Follows = table.stiffening or 0.0
    if table.stiffening is None and diagram is not None:
        stiffening = diagram.stiffening
    return find_passages(arrivals, table.orders or ORDERS, stiffening=stiffening)


def _campbell_diagram(scene: Scene, arrivals: ArrivalTimes) -> Campbell:
    """Return a scene's Campbell diagram over a record's speeds (collective)."""
    begin("Campbell diagram")
    speeds = np.linspace(arrivals.speed.min(), arrivals.speed.max(), 5)
    return campbell(scene, speeds, few=10)


def tip_direction(table: TipTiming, run: Run, blade: int = 0) -> dict[int, float]:
    """Return dofs and factors of the tangential tip displacement (collective).

    Of a wheel, the displacement of one blade: the watched blade if ``blade`` is 0.

    Raises
    ------
    InputError
        The blade tip of a solid lies on the axis.
    """
    structure, rotation, tip_factor = (
        run.structure.whole,
        _tip_rotation(table, run.scene),
        table.tangential,
    )
    sector, is_disk = structure.sector_structure, structure.n_sectors > 1
    _, tip_dof = structure.blade_of(run.watched_dof)
    factors = {tip_dof: 1.0 if tip_factor is None else tip_factor}
    if tip_factor is None and (is_disk or rotation):
        dofs, points = (
            gather_rows(sector.comm, local_rows)
            for local_rows in (sector.nodes.dofs, sector.nodes.points)
        )
        node_index = int(np.argwhere(dofs == tip_dof)[0, 0])
        if is_disk or rotation is None:  # Q - Q^T: 2 sin(2 pi / N) times the product with the axis
            Q, center = structure.sector.rotation, structure.sector.center
            direction = (Q - Q.T) @ (points[node_index] - center)
            direction /= np.linalg.norm(direction)
        else:
            direction = _circumferential_direction(run.scene, points[node_index])
        dof_factors = zip(dofs[node_index].tolist(), direction.tolist(), strict=True)
        factors = {dof: factor for dof, factor in dof_factors if dof >= 0 and factor != 0.0}
    return {
        structure.dof_of(blade or structure.watched_sector + 1, dof): factor
        for dof, factor in factors.items()
    }


def tip_in_words(table: TipTiming, run: Run) -> str:
    """Describe which displacements the probes measure, and their factors (collective)."""
    structure = run.structure.whole
    dof_factors = tip_direction(table, run).items()
    terms = [f"{factor:.4g} times the {structure.dof_name(dof)}" for dof, factor in dof_factors]
    return f"the probes measure {' and '.join(terms)}"


def probed_displacement(scene: Scene) -> tuple[str, bool]:
    """Find the displacement that measured arrivals show, without a mesh.

    Returns the name ("tip.ux"; "" for the watched displacement), and True if it is against the
    rotation.

    Raises
    ------
    InputError
        The blade tip of a solid is not given, lies on the axis, or moves along no coordinate.
    """
    table = scene.given("tip_timing")
    rotation = _tip_rotation(table, scene)
    if rotation is None:
        return [*scene.point_names, ""][0], (table.tangential or 1.0) < 0.0
    if not scene.points:
        requirement = "given with arrivals of a solid blade: its tip first"
        raise InputError("output.points", None, requirement)
    tip = scene.points[0]
    direction = _circumferential_direction(scene, np.array(tip.values))
    axis_index = int(np.abs(direction).argmax())
    if abs(direction[axis_index]) < 0.999:  # 2.6 degrees, an error of a thousandth
        components = ", ".join(f"{component:.3g}" for component in direction)
        requirement = (
            f"given: the blade tip moves along ({components}), which is none of x, y and z"
        )
        raise InputError("tip_timing.tangential", None, requirement)
    return f"{tip.key}.u{'xyz'[axis_index]}", bool(direction[axis_index] < 0.0)


def _tip_rotation(table: TipTiming, scene: Scene) -> Rotation | None:
    """Return the rotation that carries the tip of a solid, or None.

    Without it, the watched displacement times ``tip_timing.tangential`` (or 1) is tangential.
    """
    return scene.rotation if table.tangential is None and scene.dimension == 3 else None


def _circumferential_direction(scene: Scene, point: np.ndarray) -> np.ndarray:
    """Return the direction in which a rotor carries a point: (3,).

    The unit vector along a x (x - x_0), with the axis a through x_0.

    Raises
    ------
    InputError
        The point lies on the axis.
    """
    axis_point, axis = scene.axis
    direction = np.cross(axis, point - axis_point)
    length = float(np.linalg.norm(direction))
    if length <= POSITION_TOLERANCE * float(np.abs([point, axis_point]).max()):
        coordinates = [float(x) for x in point]
        raise InputError(
            "output.points", coordinates, "a blade tip first, off the axis of the rotation"
        )
    return np.where(np.abs(direction) > ROUNDING * length, direction / length, 0.0)


def _choose_speed_or_order(table: TipTiming, run: Run, source: Path | None) -> dict[str, Any]:
    """Choose the argument of ``tip_timing``: speed of rotation, or engine order.

    Raises
    ------
    InputError
        As :func:`engine_order`; or the curve of a rotor is of one speed, while stiffness and mean
        load change in a run-up.
    """
    owner = "" if source is None else f" of {str(source)!r}"
    curve = curve_of(run)
    if curve is not None and run.scene.speed > 0.0 and curve.parameter != "speed":
        speed_text = speed_in_words(run.scene.speed, run.scene.in_rpm)
        requirement = (
            f"'rpm' or 'speed' for arrivals of a rotor, which is at {speed_text} all along it"
        )
        raise InputError("curve.parameter", run.scene.given("curve").parameter, requirement)
    is_steady = run.scene.excitation.order is None and curve is None
    if is_steady and run.scene.speed > 0.0:
        table.leave_out(("order",), f"a rotor's speed, in [rotation]{owner}")
        return {"speed": run.scene.speed}
    if source is not None and run.scene.excitation.order is None and table.order is None:
        requirement = (
            "a result whose own scene has [rotation] and excitation.order, which this one lacks; "
            "or given with tip_timing.order, periods of the load in a revolution"
        )
        raise InputError("source", str(source), requirement)
    return {"order": engine_order(table, run.scene, owner)}


def engine_order(table: TipTiming, scene: Scene, owner: str = "") -> int:
    """Return the engine order of the load, by ``[excitation]`` or ``[tip_timing]``.

    ``owner``: words for the owner of the scene, as " of 'curve.h5'".

    Raises
    ------
    InputError
        Neither or both of them have it.
    """
    if scene.excitation.order is not None:
        table.leave_out(("order",), f"excitation.order{owner}")
        return scene.excitation.order
    order: int = table.given("order", "given without excitation.order: a whole number >= 1")
    return order
