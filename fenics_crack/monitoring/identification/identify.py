"""From measurements to the crack: one call.

The forward model is solved by sweeps over the unknowns, each in a file from which a killed run goes
on: of the scene, or of a coarser mesh; of a finer one at a few of the same values, which corrects
the first; of the first again at a few values halfway between, where the interpolation is tested;
and these of the plate without its crack. A :class:`Model` interpolates between their cases.
Nuisance parameters have priors, and change the predictions to first order
(:mod:`fenics_crack.monitoring.identification.nuisance`).
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError, InputError, StoppedError
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import MPI, StopRequest, on_root
from fenics_crack.basics.tables import TURN
from fenics_crack.files.store import scene_text
from fenics_crack.monitoring.identification.interpolation import (
    MESH_AXIS_KEY,
    SolvedCases,
    SweptLoads,
)
from fenics_crack.monitoring.identification.measurements import (
    Measurement,
    Measurements,
    list_crack_removal_changes,
)
from fenics_crack.monitoring.identification.model import ForwardModel, has_load_independent_shape
from fenics_crack.monitoring.identification.nuisance import UncrackedPlate
from fenics_crack.monitoring.identification.options import OPTIONS
from fenics_crack.monitoring.identification.posterior import (
    Branch,
    Likelihood,
    Posterior,
    list_first_grid_points,
)
from fenics_crack.monitoring.identification.result import Identification
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import MIN_VALUES, Identify, Sweep
from fenics_crack.study.meshes import finer_mesh
from fenics_crack.sweep.result import SweepResult, by_reason, run_sweep

IRRELEVANT = ("sweep", "curve", "integration", "identify", "tip_timing")
"""Tables that do not matter to a sweep of the forward model."""
Sweeps = tuple[SweepResult, SweepResult | None, SweepResult | None]
"""Sweeps of all cases, of a finer mesh, and halfway between the cases."""


def identify(
    scene: Scene,
    measurements: Measurements | str | Path,
    unknown: Mapping[str, Any] | None = None,
    *,
    folder: str | Path = "output/identify",
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: bool = False,
) -> Identification:
    """Find a crack, or other keys of a scene, from measurements (collective).

    The scene is solved on a grid of the unknowns once, spread over the ranks, and on a finer mesh
    at a few places; files in ``folder`` keep both, and a killed run goes on from them. Natural
    frequencies of a rotor may be of several speeds, at each of which it is solved. Under a
    steady load or a clearance the grid gets denser where cracks between meet a resonance, and
    around cracks that explain the measurements where interpolation is a large part of an error.
    The interpolation has an error of its own, by cross-validation and a few cases halfway between
    the others, which is added to that of the measurements. So is the remaining error of the mesh:
    where a mesh finer by f changes a quantity by d, d / (2 f - 2), which is added to the correction
    d, too (of an error of first order d / (f - 1) is left, of one of high order nothing). Least
    squares from several starts find the estimate, a posterior on a grid its regions, and its
    integral over the prior decides whether there is a crack.

    Parameters
    ----------
    scene : Scene
        The structure and its load; the values of the unknowns in it do not matter.
    measurements : Measurements or path
        Measurements, or a file of them (:meth:`Measurements.read`).
    unknown : mapping, optional
        Replaces the table ``[identify.unknown]``: keys of the scene with the values at which it is
        solved. Their ends are the bounds, between which the prior is uniform.
    folder : path
        For the files of the sweeps.
    comm : MPI.Comm
        Ranks over which they are spread.
    progress : bool
        Show bars.

    Returns
    -------
    Identification
        On every rank.

    Raises
    ------
    InputError
        There are no unknowns, a measurement cannot be used or is not one of this scene, or as
        :func:`run_sweep`.
    ConvergenceError
        Ctrl-C has stopped a sweep, or too few cases were solved for any measurement of the plate
        as it is.

    Examples
    --------
    >>> found = fc.identify(scene, "measured.csv", {"crack.length": [0.02, 0.04]})  # doctest: +SKIP
    """
    if unknown is not None:
        table = scene.identify or Identify.from_mapping({"unknown": unknown})
        changed = replace(table, unknown=Identify.checked("unknown", unknown))
        scene = replace(scene, identify=changed)
    if scene.identify is None:
        raise InputError("identify", None, "given: a table with the unknowns")
    words = all(isinstance(axis.values[0], str) for axis in scene.identify.unknown)
    if words and not scene.identify.meshes:
        raise InputError("identify.unknown", "words alone", "also a key that holds a number")
    if not isinstance(measurements, Measurements):
        path = measurements
        measurements = on_root(comm, lambda: Measurements.read(path))
    measurements.check(scene)
    rows = measurements.rows
    shaken = [row.frequency for row in rows if not row.natural]
    further = [load for row in rows if row.natural and (load := row.load(scene))]
    whole = _whole(scene, comm)
    others = any(not axis.key.startswith(("crack.", "contact.")) for axis in scene.identify.unknown)
    known = (scene.excitation.omega / TURN, *scene.identify.frequencies)
    whole.check_units_and_modes(
        measurements, [load for load in known if load > 0.0], may_be_other_plate=others
    )
    closer: list[Axis] = []
    while True:
        more: dict[str, Any] = {"further": further, "whole": whole, "closer": closer}
        forward = solve_forward(scene, shaken, Path(folder), comm, progress=progress, **more)
        begin("inference")
        identification = infer_unknowns(forward, measurements)
        if (worst := _interpolated(identification)) is None:
            return identification
        name, share, cracks = worst
        if (axis := _closer(forward, identification, share, cracks)) is None:
            break
        closer.append(axis)
    remark = (
        f"interpolation between the solved cases has {share.sum():.0%} of the variance of "
        f"{name}: more values in identify.unknown make regions narrower"
    )
    return replace(identification, remarks=(*identification.remarks, remark))


def infer_unknowns(forward: SolvedForwardModels, measurements: Measurements) -> Identification:
    """Infer the unknowns by a forward model that is solved for the loads of measurements.

    Raises
    ------
    InputError
        A measurement is not one of the model.
    ConvergenceError
        Too few cases of the model were solved for any measurement of the plate as it is.
    """
    measurements.check(forward.scene)
    measurements, doubts = _predicted(forward, measurements)
    rows = measurements.rows
    values, deviations = np.array([(row.value, row.deviation) for row in rows]).T
    branches, plain = (
        {
            name: Branch(Likelihood(values, deviations, model.make_predictor(rows)))
            for name, model in models.items()
        }
        for models in (forward.cracked_model_by_words, forward.uncracked_model_by_words)
    )
    remarks = (
        *list_measurement_remarks(forward.scene, measurements),
        *_unresolved(forward, measurements),
    )
    both = Posterior(branches), Posterior(plain) if plain else None
    return Identification(forward.scene, measurements, *both, remarks, doubts)


def _predicted(
    forward: SolvedForwardModels, measurements: Measurements
) -> tuple[Measurements, tuple[str, ...]]:
    """Measurements that every model predicts, with a crack and without; and in words the failed
    cases that were needed, and the measurements that are not used for that.

    A measurement that one hypothesis cannot predict would count against the other alone.
    """
    models = [*forward.cracked_model_by_words.values(), *forward.uncracked_model_by_words.values()]
    rows = measurements.rows
    known = np.all([model.make_predictor(rows).is_predictable for model in models], axis=0)
    parts = (part for model in models for part in (model.coarse_cases, model.finer_cases) if part)
    sweeps = {part.sweep_result.path: part for part in parts}
    loads = {row.frequency for row in rows}
    doubts = []
    for path, part in sweeps.items():
        sweep, solved = part.sweep_result, part.swept_loads.frequencies
        failed = [
            (at, why)
            for at, why in sweep.failed
            if solved[at[-1]] in loads or np.isnan(sweep["omega_open_1"][at])
        ]
        doubts += [f"{path.name}: {text}" for text in by_reason(sweep, failed, "failed")]
    used = list(itertools.compress(rows, known))
    if all(row.quantity == "frequency_uncracked" for row in used):
        why = "; ".join(doubts) or "no case has the measured quantities"
        raise ConvergenceError(f"identification, no measurement can be predicted: {why}")
    why = "too few cases have it, or only those on one side of what failed"
    doubts += [f"{row.name} is not used: {why}" for row in itertools.compress(rows, ~known)]
    return Measurements(tuple(used)), tuple(doubts)


def list_measurement_remarks(scene: Scene, measurements: Measurements) -> tuple[str, ...]:
    """Return limits of measurements that do not depend on their values."""
    table = scene.given("identify")
    crack, rows, found = scene.crack, measurements.rows, []
    given = not any(axis.key == "crack.edge" for axis in table.unknown)
    if given and crack is not None and crack.edge and all(row.natural for row in rows):
        other = {"left": "right", "right": "left"}[crack.edge]
        found.append(
            f"a crack from the {other} edge has the same natural frequencies: they do not "
            "distinguish the edges"
        )
    if table.meshes:
        found.append(
            "a file has one mesh: its error is in no interval; compare with meshes twice as fine"
        )
    if any(row.shape for row in rows) and not has_load_independent_shape(scene):
        found.append(
            "a clearance or a steady load lets the shape of the motion depend on the load's size: "
            "that of the scene must be right"
        )
    return tuple(found)


def _unresolved(forward: SolvedForwardModels, measurements: Measurements) -> Iterator[str]:
    """SweptLoads, under which a crack between the solved cases vibrates much more than in any of them,
    where steady loads let it breathe there as in none of them; in words."""
    if has_load_independent_shape(forward.scene):
        return
    places = dict.fromkeys((row.frequency, row.point) for row in measurements.rows if row.shape)
    for model, (load, point) in itertools.product(forward.cracked_model_by_words.values(), places):
        larger, where = _larger_between(model, load, point)
        if larger > OPTIONS.allowed_vibration_ratio:
            near = ", ".join(
                f"{key} = {one:.4g}" for key, one in zip(model.unknown_keys, where, strict=True)
            )
            yield (
                f"between the solved cases, near {near}, the vibration at {load:.6g} Hz is up to "
                f"{larger:.2g} times that at any of them, and steady loads let the crack breathe "
                "there as in none of these: add values there, or measure farther from resonance"
            )


def _larger_between(model: ForwardModel, load: float, point: str) -> tuple[float, np.ndarray]:
    """Maximum vibration of a point at a load [Hz] between the cases of a model over that at any of
    them, 0 where none is known; and its values (d,) of the unknowns."""
    first = Measurement("harmonic_1", 1.0, 1.0, frequency=load, point=point)
    places = list_first_grid_points(model.unknown_grid)
    between = np.nan_to_num(model.make_predictor([first])(places).values[:, 0])
    solved = np.fmax.reduce(np.abs(model.coarse_cases.get_harmonic(point, load, 1)))
    most = int(np.argmax(between))
    return float(between[most] / solved) if solved > 0.0 else 0.0, places[most]


# --- the sweeps of the forward model --------------------------------------------------------------


@dataclass(frozen=True)
class SolvedForwardModels:
    """A forward model, solved.

    Attributes
    ----------
    scene : Scene
        With its table ``[identify]``.
    axes : sequence of Axis
        The unknowns, with the solved values.
    cracked : dict of str to Model
        A model for each combination of the unknowns that are words: "" or "right".
    uncracked : dict of str to Model
        The same without the crack; empty where that cannot be taken away.
    """

    scene: Scene
    axes: Sequence[Axis]
    cracked_model_by_words: dict[str, ForwardModel]
    uncracked_model_by_words: dict[str, ForwardModel]


def _whole(scene: Scene, comm: MPI.Comm) -> UncrackedPlate:
    """The plate of a scene without its crack, on every rank (collective)."""
    table = scene.given("identify")
    plain = scene.replace(dict.fromkeys(IRRELEVANT) | (list_crack_removal_changes(scene) or {}))
    begin("plate without its crack")
    return on_root(comm, lambda: UncrackedPlate(plain, table))


def solve_forward(
    scene: Scene,
    frequencies: Sequence[float],
    folder: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    further: Sequence[float] = (),
    whole: UncrackedPlate | None = None,
    closer: Sequence[Axis] = (),
    progress: bool = False,
) -> SolvedForwardModels:
    """Solve, or read, the cases of the forward model (collective).

    Parameters
    ----------
    scene : Scene
        With its table ``[identify]``.
    frequencies : sequence of float
        Of the load [Hz]; the scene's further ones are added.
    folder : path
        Folder of the files of the sweeps; their names depend on the scene and the frequencies.
    comm : MPI.Comm
        The ranks over which the cases are spread.
    further : sequence of float
        SweptLoads, [Hz] at whose speeds of the rotor only natural frequencies are needed.
    whole : UncrackedPlate, optional
        The plate without its crack, if it is known already.
    closer : sequence of Axis
        Unknowns with further values, one after another.
    progress : bool
        Show bars.

    Raises
    ------
    InputError
        As :func:`run_sweep`.
    ConvergenceError
        Ctrl-C has stopped a sweep.
    """
    whole = whole or _whole(scene, comm)
    table = scene.given("identify")
    wanted = (*frequencies, *further, *table.frequencies)
    loads = SweptLoads(scene, [float(one) for one in wanted])
    shaken = (*frequencies, *table.frequencies, loads.frequencies[0])
    alone = [place for place, one in enumerate(loads.frequencies) if one not in shaken]
    plain = scene.replace(dict.fromkeys(IRRELEVANT))
    coarse, fine = _meshes(plain, table.finer)

    def run(name: str, of: Scene, axes: Sequence[Axis]) -> SweepResult:
        swept = replace(of, sweep=Sweep(over=(*axes, loads.sweep_axis)))
        digest = hashlib.sha256(f"{scene_text(swept)}{alone or ''}".encode()).hexdigest()[:8]
        path = folder / f"{name}_{digest}.h5"
        with StopRequest() as stop:
            sweep = run_sweep(
                swept, path, comm, progress=progress, verdicts=False, judged=False, natural=alone
            )
        if stop.asked(comm):
            raise StoppedError("identification was stopped; the same command goes on with it")
        return sweep

    numbers = sum(not isinstance(axis.values[0], str) for axis in table.unknown)
    count = MIN_VALUES - (numbers > 2)  # values of the finer sweep and of that between
    meshes = [Axis(MESH_AXIS_KEY, table.mesh_files)] if table.meshes else []

    def others(
        name: str, changes: dict[str, Any], axes: Sequence[Axis], every: SweepResult
    ) -> Sweeps:
        own, keys = coarse.replace(changes), [axis.key for axis in axes]
        first = [axis for axis in (*meshes, *table.unknown) if axis.key in keys]
        few = _thinned(first, count)
        finer = None if fine is None else run(f"{name}_finer", fine.replace(changes), few)
        halfway = [Axis(axis.key, _halfway(axis) or axis.values) for axis in axes]
        between = None if table.meshes else run(name, own, _thinned(halfway, count))
        return every, finer, between

    axes, left = list(table.unknown), [*closer]
    every = run("forward", coarse, [*meshes, *axes])
    while True:
        models = _models(scene, whole, loads, (every, None, None))
        axis = _denser(scene, models.values(), frequencies, axes)
        if axis is None and not left:
            break
        axis = axis or left.pop(0)
        place = [one.key for one in axes].index(axis.key)
        added = tuple(value for value in axis.values if value not in axes[place].values)
        new = [*meshes, *axes[:place], Axis(axis.key, added), *axes[place + 1 :]]
        every = _joined(every, run("forward", coarse, new), len(meshes) + place)
        axes[place] = axis
    cracked = others("forward", {}, [*meshes, *axes], every)
    changes = list_crack_removal_changes(scene)
    if changes is None:
        return SolvedForwardModels(scene, axes, _models(scene, whole, loads, cracked), {})
    kept = [axis for axis in axes if not axis.key.startswith(("crack.", "contact."))]
    plain = coarse.replace(changes)
    bare = others("uncracked", changes, kept, run("uncracked", plain, kept))
    found = _models(scene, whole, loads, cracked, bare), _models(scene, whole, loads, bare)
    return SolvedForwardModels(scene, axes, *found)


def _joined(one: SweepResult, other: SweepResult, place: int) -> SweepResult:
    """The cases of two sweeps whose values on the axis at a place differ."""
    values = [*one.axes[place].values, *other.axes[place].values]
    order = np.argsort(values)
    columns = {
        name: np.concatenate([values, other[name]], axis=place).take(order, axis=place)
        for name, values in one.columns.items()
    }
    axes = list(one.axes)
    axes[place] = Axis(axes[place].key, tuple(values[at] for at in order))
    return replace(one, scene=replace(one.scene, sweep=Sweep(over=tuple(axes))), columns=columns)


def _most(scene: Scene) -> int:
    """Maximum number of solved cases."""
    unknown = scene.given("identify").unknown
    return OPTIONS.max_case_ratio * math.prod(len(axis.values) for axis in unknown)


def _denser(
    scene: Scene, models: Iterable[ForwardModel], loads: Sequence[float], axes: Sequence[Axis]
) -> Axis | None:
    """The unknown along which the vibration changes most, with further values between; None where
    no crack between vibrates much more than the solved ones, where that does not matter, and where
    it would be too many cases."""
    seen = itertools.product(models, loads, scene.point_names or ("",))
    places = (
        []
        if has_load_independent_shape(scene)
        else [(_larger_between(*one)[0], *one) for one in seen]
    )
    if not places or max(place[0] for place in places) <= OPTIONS.allowed_vibration_ratio:
        return None
    larger, model, load, point = max(places, key=lambda place: place[0])
    sizes = np.log(np.abs(model.coarse_cases.get_harmonic(point, load, 1))).reshape(
        model.unknown_grid.shape
    )
    steps = {
        key: np.fmax.reduce(np.abs(np.diff(sizes, axis=place)), axis=None)
        for place, key in enumerate(model.unknown_keys)
    }
    cases = math.prod(len(axis.values) for axis in axes)
    numbers = [axis for axis in axes if axis.key in steps and _is_divisible(axis)]
    for axis in sorted(numbers, key=lambda axis: -steps[axis.key]):
        count = len(axis.values)
        most = (_most(scene) * count // cases - 1) // (count - 1)
        parts = min(math.ceil(larger / OPTIONS.allowed_vibration_ratio), most)
        if parts > 1:
            at = np.arange((count - 1) * parts + 1) / parts
            between = np.interp(at, np.arange(count), axis.values).tolist()
            return Axis(axis.key, tuple(between))
    return None


def _interpolated(found: Identification) -> tuple[str, np.ndarray, np.ndarray] | None:
    """The measurement in whose variance interpolation between cases has the largest share, on
    average over the cracks that explain the measurements: the posterior falls as such an error
    grows, and excludes some of them.

    Its name, its shares by the interpolation along each unknown, (d,), and those cracks, (m, d);
    None if the share is small.
    """
    seen = [
        branch.compute_interpolation_shares() for branch in found.posterior.branch_by_words.values()
    ]
    x, shares = (np.vstack(one) for one in zip(*seen, strict=True))
    if not shares.size:
        return None
    mean = shares.mean(axis=0)
    at = int(mean.sum(axis=0).argmax())
    share = mean[:, at]
    few = share.sum() <= OPTIONS.allowed_interpolation_share
    return None if few else (found.measurements.rows[at].name, share, x)


def _closer(
    forward: SolvedForwardModels, found: Identification, share: np.ndarray, x: np.ndarray
) -> Axis | None:
    """The unknown along which interpolation adds most to the error of a measurement, with further
    values halfway between those around the cracks that explain the measurements; None where it
    would be too many cases, or has none between."""
    axes = {axis.key: axis for axis in forward.axes}
    for place in np.argsort(-share):
        axis = axes.get(found.unknown[place])
        if axis is not None and _is_divisible(axis):
            between = _halfway(axis, x[:, place].min(), x[:, place].max())
            halved = Axis(axis.key, tuple(sorted({*axis.values, *between})))
            cases = math.prod(len(one.values) for one in (axes | {axis.key: halved}).values())
            return halved if cases <= _most(forward.scene) else None
    return None


def _meshes(scene: Scene, factor: float) -> tuple[Scene, Scene | None]:
    """The scene of all cases, and that of a few on a finer mesh; None where there is no such."""
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is None and factor > 1.0:
        harmonics = min(100, math.ceil(factor * scene.harmonic_balance.harmonics))
        changes = {"harmonic_balance.harmonics": harmonics, "harmonic_balance.samples": None}
    other = None if factor == 1.0 else finer_mesh(scene, factor)
    if other is None and not changes:
        return scene, None
    return (scene, (other or scene).replace(changes)) if factor > 1.0 else (other or scene, scene)


def _thinned(axes: Sequence[Axis], count: int) -> tuple[Axis, ...]:
    """Some of the values of each unknown, its ends among them; all words."""
    found = []
    for axis in axes:
        places = np.unique(np.linspace(0, len(axis.values) - 1, count).round().astype(int))
        few = tuple(axis.values[at] for at in places)
        found.append(axis if isinstance(axis.values[0], str) else Axis(axis.key, few))
    return tuple(found)


def _is_divisible(axis: Axis) -> bool:
    """True if there are values between those of an unknown; not of words and whole numbers."""
    return any(isinstance(value, float) for value in axis.values)


def _halfway(axis: Axis, low: float = -np.inf, high: float = np.inf) -> tuple[float, ...]:
    """Values halfway between those of an unknown around some numbers; none between words and whole
    numbers."""
    pairs = itertools.pairwise(axis.values) if _is_divisible(axis) else ()
    return tuple(0.5 * (a + b) for a, b in pairs if a < high and b > low)


def _models(
    scene: Scene,
    whole: UncrackedPlate,
    loads: SweptLoads,
    sweeps: Sweeps,
    bare: Sweeps | None = None,
) -> dict[str, ForwardModel]:
    """Models of a sweep, with those of a finer mesh and between if there are, and of the plate
    without its crack, by their values of the unknowns that are words."""
    meshes = scene.given("identify").mesh_axes
    axes = [axis for axis in sweeps[0].axes[:-1] if not (meshes and axis.key == MESH_AXIS_KEY)]
    words = {axis.key: axis.values for axis in axes if isinstance(axis.values[0], str)}
    models = {}
    for chosen in itertools.product(*words.values()):
        fixed = dict(zip(words, chosen, strict=True))
        parts: list[SolvedCases | None] = []
        for sweep, plain in zip(sweeps, bare or (None,) * 3, strict=True):
            under = None if plain is None else SolvedCases(plain, loads, (), fixed)
            parts.append(None if sweep is None else SolvedCases(sweep, loads, meshes, fixed, under))
        models[", ".join(chosen)] = ForwardModel(scene, whole, parts, word_by_key=fixed)
    return models
