"""Tip timing of a scene: the arrivals at its probes, and the vibration found in arrivals."""

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

DECIDED = (*LOOKED_AT, "reduction")
"""Tables of a scene that may differ from those of a result: those that choose results, and those
that a run decides itself."""
SLOWEST = 1.0
"""Minimum plausible speed of a blade tip past probes [m/s]; times in ms for s make 200 to 0.2."""
TOO_SLOW = "the blade tip moves at {:.3g} m/s, where rotors with probes have 1 to 700"
FARTHEST = 0.1
"""Maximum distance of a resonance from a mode, relative to its frequency."""


def arrivals_of_blades(
    scene: Scene,
    source: Mapping[int, ArrivalTimes] | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> tuple[dict[int, ArrivalTimes], Run[Result] | None]:
    """Return arrival times of every blade by the table ``[tip_timing]`` of a scene, and the run
    that they are computed from; None for measured ones (collective).

    Blade j + 1 of a bladed disk is a sector ahead of blade j in the direction of rotation. Other
    scenes have one blade.

    Parameters
    ----------
    scene : Scene
        With [tip_timing].
    source : mapping of int to ArrivalTimes, or path, optional
        Measured ones by the numbers of the blades; or a result of ``solve`` or ``curve``, whose own
        scene has the rotation. A run-up ends where the curve becomes unstable. Default: the steady
        vibration of the scene, which is solved.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    dict of int to ArrivalTimes, Run or None
        The blades by their numbers, and the run.

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
    run, blades = _run_of(scene, source, comm), {}
    count = run.structure.whole.n_sectors
    for blade, probes in probes_of_blades(np.radians(table.probes), count).items():
        begin(f"arrivals of blade {blade}")
        blades[blade] = _compute_arrivals(table, run, source, np.sort(probes), blade)
    return blades, run


def _run_of(scene: Scene, source: Path | None, comm: MPI.Comm) -> Run[Result]:
    """The result from which arrivals are computed."""
    run: Run[Result] = solve(scene, comm) if source is None else load_run(source, comm)
    result = run.result
    if not isinstance(result, (PeriodicSolution, ResponseCurve)):
        raise InputError("source", str(source), "a solution, a curve, or a CSV file of arrivals")
    if isinstance(result, PeriodicSolution) and not result.converged:
        raise InputError("source", str(source or "the scene"), f"converged: {result.status}")
    return run


def curve_of(run: Run[Any] | None) -> ResponseCurve | None:
    """Return the curve from which arrivals are computed; None for others."""
    result = None if run is None else run.result
    return result if isinstance(result, ResponseCurve) else None


def _compute_arrivals(
    table: TipTiming, run: Run[Any], source: Path | None, probes: np.ndarray, blade: int
) -> ArrivalTimes:
    """Arrivals of a blade at probes (n,) [rad] from a result."""
    result: Any = run.result
    if (curve := curve_of(run)) is not None:
        points, lost = run_up_points(curve)
        # The part before it becomes unstable; all where that is at once.
        result = curve if lost is None or len(points) < 2 else curve.part(points)
    given = {key: getattr(table, key) for key in ("tip_radius", "revolutions", "noise", "clock")}
    given |= {"probes": probes, "seed": table.seed + blade - 1}
    return tip_timing(
        result, tip_direction(table, run, blade), **given, **_turning(table, run, source)
    )


def run_up_ends(scene: Scene, run: Run[Any]) -> str:
    """Describe where along a run-up the curve becomes unstable; "" if it does not, and of other
    results."""
    if (curve := curve_of(run)) is None:
        return ""
    points, lost = run_up_points(curve)
    if lost is None:
        return ""
    speeds = curve.omega[[points[-1], lost]] / engine_order(scene.given("tip_timing"), run.scene)
    last, at = (speed_in_words(speed, scene.in_rpm) for speed in speeds)
    return f"the vibration is unstable at {at}: the run-up ends before, at {last}"


def of_another_scene(scene: Scene, run: Run[Any]) -> str:
    """Return the difference of a result's scene from this one, in words; "" if there is none
    (collective)."""
    both = with_crack_length(scene, run.structure.comm), run.scene
    compared = [with_full_paths(one).replace(dict.fromkeys(DECIDED)) for one in both]
    here, there = differences(compared)
    words = f"the arrivals are those of a result with {there}; the vibration is sought by this "
    return words + f"scene, which has {here}" if here else ""


def remarks_on_arrivals(arrivals: ArrivalTimes) -> list[str]:
    """Return remarks on measured arrivals with unusual values: numbers in another unit."""
    found, speed = [], arrivals.mean_speed * arrivals.tip_radius
    if not SLOWEST < speed < FASTEST:
        text = TOO_FAST if speed > SLOWEST else TOO_SLOW
        units = "are speed, or times, and tip_radius in the units of their headings?"
        found.append(f"{text.format(speed)}: {units}")
    if len(arrivals.probes) > 1 and np.degrees(arrivals.probes[-1]) < TURN:
        within = float(np.degrees(np.ptp(arrivals.probes)))
        found.append(f"all probes are within {within:.3g} degrees: are angles in rad?")
    return found


def is_run_up(arrivals: ArrivalTimes, run: Run[Any] | None) -> bool:
    """Return True if the speed changes from arrival to arrival: always if they are computed from a
    curve, else by more than a constant speed varies."""
    return curve_of(run) is not None or not arrivals.steady


def vibration_in(
    table: TipTiming,
    arrivals: ArrivalTimes,
    scene: Scene | None = None,
    run: Run[Any] | None = None,
) -> TipFit | TipTrack | tuple[PassageFit, ...]:
    """Find the vibration that ``[tip_timing]`` requests in arrival times, measured or computed.

    At constant speed the load's engine order, or one of those that are given, or a frequency; in a
    run-up the load's order, or where that is not known, or orders are given, the resonances that
    are passed.

    Raises
    ------
    InputError
        As :func:`fit_order`, :func:`fit_frequency`, :func:`track_order` and :func:`find_passages`;
        or a frequency is requested in a run-up, orders in one that is computed, or more than first
        harmonics, or revolutions together, where its resonances are sought.
    """
    order = table.order or (None if scene is None else scene.excitation.order)
    how: dict[str, Any] = {"harmonics": table.fitted_harmonics}
    how["angle_deviation"] = np.radians(table.angle_deviation)
    of_passages = ("stiffening",), "all but a measured run-up in which resonances are sought"
    if is_run_up(arrivals, run):
        why = "a run-up, in which an order is tracked, or the resonances are found that are passed"
        table.leave_out(("frequencies",), why)
        if order is None or (run is None and table.orders):
            of_fits = "fitted_harmonics", "subharmonic", "fitted_revolutions"
            table.leave_out(of_fits, "a run-up in which resonances are sought")
            diagram = _diagram(scene, arrivals) if scene and scene.rotation else None
            return _passages(table, arrivals, diagram)
        table.leave_out(*of_passages)
        table.leave_out(("orders",), f"a computed run-up: order {order} is tracked")
        how |= {"subharmonic": table.subharmonic, "revolutions": table.fitted_revolutions}
        return track_order(arrivals, order, **how)
    table.leave_out(*of_passages)
    if table.frequencies is not None:
        low, high = (2.0 * np.pi * end for end in table.frequencies)
        return fit_frequency(arrivals, low, high, **how)
    orders = table.orders or ([order] if order else ORDERS)
    return fit_order(arrivals, orders, **how, subharmonic=table.subharmonic)


def modes_passed(scene: Scene, arrivals: ArrivalTimes) -> list[tuple[PassageFit, int, str]]:
    """Return the resonances that a record of a blade on a rotor passes, each with its mode of the
    scene (from 1), or 0 and the reason in words (collective).

    Raises
    ------
    InputError
        As :func:`find_passages`; or the load is no engine order of a table ``[rotation]``.
    """
    if scene.rotation is None or scene.excitation.order is None:
        allowed = "those of a constant speed, unless the load is an excitation.order of [rotation]"
        raise InputError("arrivals", repr(arrivals), allowed)
    diagram = _diagram(scene, arrivals)
    fits = _passages(scene.given("tip_timing"), arrivals, diagram)
    return [(fit, *mode_of(fit, diagram)) for fit in fits]


def passed_in_words(fit: PassageFit, mode: int, why: str) -> str:
    """Describe the resonance of a mode and doubts about it, or why it is not used."""
    doubts = ["another vibration is near it"] * fit.in_doubt
    doubts += [f"its {fit.disagreement}"] * fit.disagree
    doubt = "; ".join([why] * bool(why) + doubts)
    name = f"mode {mode}" if mode else "not used"
    return f"{name}: {fit.in_words}" + f" ({doubt})" * bool(doubt)


def mode_of(fit: PassageFit, diagram: Campbell) -> tuple[int, str]:
    """Return the mode of a resonance (from 1), or 0 and the reason in words."""
    opened, tied = diagram.between(fit.speed)

    def apart(omega: float) -> np.ndarray:
        return np.maximum(np.maximum(opened - omega, omega - tied), 0.0) / omega

    own = apart(fit.omega)
    nearest = np.argsort(own)
    ranges = [
        f"mode {mode + 1} has {opened[mode] / TURN:.6g} to {tied[mode] / TURN:.6g} Hz there"
        for mode in nearest[:2]
    ]
    if own[nearest[0]] > FARTHEST:
        return 0, f"that of none of the blade's modes to {FARTHEST:.0%}; {ranges[0]}"
    if len(own) > 1 and own[nearest[1]] < 0.5 * FARTHEST:
        return 0, "; ".join(ranges)
    also = [f"{order:g}" for order in fit.ambiguous if min(apart(order * fit.speed)) <= FARTHEST]
    if also:
        why = "may be right, too: two probes test none" if fit.untested else "explains it as well"
        return 0, f"order {', '.join(also)} {why}, and meets a mode there, too"
    return int(nearest[0]) + 1, ""


def _passages(
    table: TipTiming, arrivals: ArrivalTimes, diagram: Campbell | None
) -> tuple[PassageFit, ...]:
    """Return resonances that are passed, with frequencies that follow the speed as given, or by a
    diagram, or not."""
    follows: float | Follows = table.stiffening or 0.0
    if table.stiffening is None and diagram is not None:
        follows = diagram.stiffening
    return find_passages(arrivals, table.orders or ORDERS, stiffening=follows)


def _diagram(scene: Scene, arrivals: ArrivalTimes) -> Campbell:
    """Return the Campbell diagram of a scene over the speeds of a record (collective)."""
    begin("Campbell diagram")
    speeds = np.linspace(arrivals.speed.min(), arrivals.speed.max(), 5)
    return campbell(scene, speeds, few=10)


def tip_direction(table: TipTiming, run: Run, blade: int = 0) -> dict[int, float]:
    """Return the displacement of the blade tip in the direction of rotation, as factors of dofs; of
    a wheel that of one blade, of the first cracked one if it is 0 (collective).

    Raises
    ------
    InputError
        The blade tip of a solid lies on the axis.
    """
    whole, rotation, given = run.structure.whole, _carrier(table, run.scene), table.tangential
    part, on_disk = whole.sector_structure, whole.n_sectors > 1
    _, tip = whole.blade_of(run.watched_dof)
    shares = {tip: 1.0 if given is None else given}
    if given is None and (on_disk or rotation):
        dofs, points = (gather_rows(part.comm, x) for x in (part.nodes.dofs, part.nodes.points))
        node = int(np.argwhere(dofs == tip)[0, 0])
        if on_disk or rotation is None:  # Q - Q^T: 2 sin(2 pi / N) times the product with the axis
            turn, center = whole.sector.turn, whole.sector.center
            along = (turn - turn.T) @ (points[node] - center)
            along /= np.linalg.norm(along)
        else:
            along = _circumferential(run.scene, points[node])
        of_dofs = zip(dofs[node].tolist(), along.tolist(), strict=True)
        shares = {dof: share for dof, share in of_dofs if dof >= 0 and share != 0.0}
    return {
        whole.dof_of(blade or whole.watched_sector + 1, dof): share for dof, share in shares.items()
    }


def tip_in_words(table: TipTiming, run: Run) -> str:
    """Describe the displacement that the probes measure as a sum of others (collective)."""
    whole = run.structure.whole
    shares = tip_direction(table, run).items()
    parts = [f"{share:.4g} times the {whole.dof_name(dof)}" for dof, share in shares]
    return f"the probes measure {' and '.join(parts)}"


def probed_displacement(scene: Scene) -> tuple[str, bool]:
    """Return the displacement of a scene that measured arrivals show, without its mesh: its name
    ("tip.ux"; "" for the watched one), and True if it is against the rotation.

    Raises
    ------
    InputError
        The blade tip of a solid is not given, lies on the axis, or moves along no coordinate.
    """
    table = scene.given("tip_timing")
    rotation = _carrier(table, scene)
    if rotation is None:
        return [*scene.point_names, ""][0], (table.tangential or 1.0) < 0.0
    if not scene.points:
        allowed = "given with arrivals of a solid blade: its tip first"
        raise InputError("output.points", None, allowed)
    tip = scene.points[0]
    along = _circumferential(scene, np.array(tip.values))
    largest = int(np.abs(along).argmax())
    if abs(along[largest]) < 0.999:  # 2.6 degrees, an error of a thousandth
        shares = ", ".join(f"{share:.3g}" for share in along)
        allowed = f"given: the blade tip moves along ({shares}), which is none of x, y and z"
        raise InputError("tip_timing.tangential", None, allowed)
    return f"{tip.key}.u{'xyz'[largest]}", bool(along[largest] < 0.0)


def _carrier(table: TipTiming, scene: Scene) -> Rotation | None:
    """Return the rotation that carries the blade tip of a solid past the probes; None where
    ``tip_timing.tangential`` of the watched displacement, given or 1, has the direction."""
    return scene.rotation if table.tangential is None and scene.dimension == 3 else None


def _circumferential(scene: Scene, point: np.ndarray) -> np.ndarray:
    """Return the direction in which a rotor carries a point: a x (x - x_0), of length 1: (3,).

    Raises
    ------
    InputError
        The point lies on the axis.
    """
    place, axis = scene.axis
    along = np.cross(axis, point - place)
    size = float(np.linalg.norm(along))
    if size <= POSITION_TOLERANCE * float(np.abs([point, place]).max()):
        where = [float(x) for x in point]
        raise InputError("output.points", where, "a blade tip first, off the axis of the rotation")
    return np.where(np.abs(along) > ROUNDING * size, along / size, 0.0)


def _turning(table: TipTiming, run: Run, source: Path | None) -> dict[str, Any]:
    """Return the speed of rotation, or the engine order from which it follows.

    Raises
    ------
    InputError
        As :func:`engine_order`; or a curve is of one speed of a rotor, whose stiffness and mean
        load are not those of a run-up.
    """
    of_result = "" if source is None else f" of {str(source)!r}"
    curve = curve_of(run)
    if curve is not None and run.scene.speed > 0.0 and curve.parameter != "speed":
        speed = speed_in_words(run.scene.speed, run.scene.in_rpm)
        allowed = f"'rpm' or 'speed' for arrivals of a rotor, which is at {speed} all along it"
        raise InputError("curve.parameter", run.scene.given("curve").parameter, allowed)
    steady = run.scene.excitation.order is None and curve is None
    if steady and run.scene.speed > 0.0:
        table.leave_out(("order",), f"a rotor's speed, in [rotation]{of_result}")
        return {"speed": run.scene.speed}
    if source is not None and run.scene.excitation.order is None and table.order is None:
        allowed = (
            "a result whose own scene has [rotation] and excitation.order, which this one lacks; "
            "or given with tip_timing.order, periods of the load in a revolution"
        )
        raise InputError("source", str(source), allowed)
    return {"order": engine_order(table, run.scene, of_result)}


def engine_order(table: TipTiming, scene: Scene, owner: str = "") -> int:
    """Return periods of the load in a revolution, by ``[excitation]`` of a scene, and its owner in
    words, or ``[tip_timing]``.

    Raises
    ------
    InputError
        Neither or both of them have it.
    """
    if scene.excitation.order is not None:
        table.leave_out(("order",), f"excitation.order{owner}")
        return scene.excitation.order
    found: int = table.given("order", "given without excitation.order: a whole number >= 1")
    return found
