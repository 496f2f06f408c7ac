"""From measurements to the crack: one call."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.identification.features import check_point
from fenics_crack.identification.measurements import Measurements
from fenics_crack.identification.model import Model
from fenics_crack.identification.posterior import Likelihood, Posterior, explore
from fenics_crack.identification.result import Identification
from fenics_crack.identification.sweeps import Forward, solve_forward
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Identify
from fenics_crack.stages import begin
from fenics_crack.study.remarks import is_proportional

__all__ = ["identify", "remarks_on"]


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
    at a few places; files in ``folder`` keep both, and a killed run goes on from them. Smooth
    interpolation between has an error of its own, by cross-validation, which is added to that of
    the measurements. So is what may be left of the mesh's error: where a mesh finer by f changes a
    quantity by d, d / (2 f - 2), which is added to the correction d, too (of an error of first
    order d / (f - 1) is left, of one of high order nothing). Least squares from several starts find
    the estimate, a posterior on a grid its regions, and its integral over the prior says whether
    there is a crack at all.

    Parameters
    ----------
    scene : Scene
        The structure and its load; the values of the unknowns in it do not matter.
    measurements : Measurements or path
        What was measured, or a CSV file with it (:meth:`Measurements.from_csv`).
    unknown : mapping, optional
        As the table ``[identify.unknown]``, which it replaces: keys of the scene with the values at
        which it is solved. Their ends are the bounds, between which the prior is uniform.
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

    Examples
    --------
    >>> found = fc.identify(scene, "measured.csv", {"crack.length": [0.02, 0.04]})  # doctest: +SKIP
    """
    if unknown is not None:
        table = scene.identify or Identify.from_mapping({"unknown": unknown})
        changed = replace(table, unknown=Identify.checked("unknown", unknown))
        scene = replace(scene, identify=changed)
    if scene.identify is None:
        raise InputError("identify", None, "given: a table with what is unknown")
    if all(isinstance(axis.values[0], str) for axis in scene.identify.unknown):
        raise InputError("identify.unknown", "words alone", "also a key that holds a number")
    if not isinstance(measurements, Measurements):
        path = measurements
        measurements = on_root(comm, lambda: Measurements.from_csv(path))
    rows = measurements.rows
    for row in rows:
        check_point(scene, row.point)
    loads = [row.frequency for row in rows if not row.natural]
    forward = solve_forward(scene, loads, Path(folder), comm, progress=progress)
    begin("inference")
    return infer(forward, measurements)


def infer(forward: Forward, measurements: Measurements) -> Identification:
    """What measurements tell, by a forward model that is solved for their load frequencies.

    Raises
    ------
    InputError
        A measurement is not one of the model.
    """
    cracked, bare = forward.cracked_models, forward.uncracked_models
    branches = {
        name: explore(_likelihood(model, bare, measurements)) for name, model in cracked.items()
    }
    uncracked = np.nan
    if bare:
        plain = (_likelihood(model, bare, measurements) for model in bare.values())
        uncracked = Posterior({str(k): explore(one) for k, one in enumerate(plain)}).log_evidence
    remarks = remarks_on(forward.scene, measurements)
    return Identification(forward.scene, measurements, Posterior(branches), uncracked, remarks)


def _likelihood(model: Model, bare: Mapping[str, Model], measurements: Measurements) -> Likelihood:
    """Of measurements, with frequencies relative to those of the uncracked plate where known."""
    calibration = _calibration(bare, measurements)
    rows = [row for row in measurements.rows if row.quantity != "frequency_uncracked"]
    values = np.array([row.value for row in rows])
    deviations = np.array([row.deviation for row in rows])
    for place, row in enumerate(rows):
        if row.natural and row.mode in calibration:
            factor, relative = calibration[row.mode]
            deviations[place] = factor * np.hypot(row.deviation, row.value * relative)
            values[place] = factor * row.value
    return Likelihood(values, deviations, model.quantities(rows))


def _calibration(
    bare: Mapping[str, Model], measurements: Measurements
) -> dict[int, tuple[float, float]]:
    """By modes: the model's frequency of the uncracked plate over the measured one, and the
    relative standard deviation of that."""
    rows = [row for row in measurements.rows if row.quantity == "frequency_uncracked"]
    if not rows:
        return {}
    if not bare:
        allowed = "left out where the crack cannot be taken out of the scene"
        raise InputError("measurements.quantity", "frequency_uncracked", allowed)
    model = next(iter(bare.values()))
    middle = 0.5 * (model.cube.low + model.cube.high)
    predicted = model.quantities(rows)(middle[None]).values[0]
    pairs = zip(rows, predicted, strict=True)
    return {row.mode: (value / row.value, row.deviation / row.value) for row, value in pairs}


def remarks_on(scene: Scene, measurements: Measurements) -> tuple[str, ...]:
    """What cannot be told whatever the numbers are."""
    assert scene.identify is not None
    sides = any(axis.key == "crack.edge" for axis in scene.identify.unknown)
    crack, rows = scene.crack, measurements.rows
    found = []
    if crack is not None and crack.edge is not None and all(row.natural for row in rows):
        other = {"left": "right", "right": "left"}[crack.edge]
        if not sides:
            found.append(
                f"a crack from the {other} edge has the same natural frequencies: they do not tell "
                "the edges apart"
            )
    fixed = any(scene.excitation.force_mean) or not is_proportional(scene)
    if any(row.shape for row in rows) and fixed:
        found.append(
            "a clearance or a steady load lets the shape of the motion depend on the load's size: "
            "that of the scene must be right"
        )
    return tuple(found)
