"""Numbers of a plate over the length of its crack: solved at few lengths, and between them splines.

Lengths are halved where a spline misses what is then found. Each round is a sweep: its cases are
shared among ranks, and it goes on where it was killed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from fenics_crack.errors import FEW_MODES, ConvergenceError, InputError
from fenics_crack.model.modes import solve_modes
from fenics_crack.scene.quantities import OF_TIPS
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Growth
from fenics_crack.study.key_figures import damping_ratios
from fenics_crack.study.prepare import prepare
from fenics_crack.sweep.result import SweepResult, run_sweep
from fenics_crack.table import TURN

__all__ = ["LengthPath", "solve_lengths"]

FIRST = 5
"""Lengths of the first round, the fewest that a spline and every other one of them need."""
ROUNDS = 6
"""In which an interval may be halved: after these 129 lengths are as close as meshes are alike."""
REDUCED = 4.0
"""By which an interval's error falls when it is halved, at the least; a spline's falls by 16."""
ROUGH = 0.05
"""Error of ln delta K above which an interval is halved even where few cycles pass in it: the peak
of a resonance that passes is seen."""
LOGARITHMIC = ("driving", "K_max", "delta_K_effective", "response")
"""Columns whose logarithm is smooth: resonances pass through them."""
LINEAR = ("omega", "omega_open", "omega_bilinear", "K_min", "K_II_max")
READ = ("K_max", "delta_K_effective", "response", *LINEAR)
"""Columns of the sweep: those of a spectrum are of the load that drives the crack most."""
LEAST = 1e-4
"""Part of its largest value below which a logarithmic column counts as that: closed cracks."""


@dataclass(frozen=True)
class LengthPath:
    """Columns of a sweep over the crack's length, and splines through them.

    Attributes
    ----------
    lengths : (k,) [m]
        Ascending.
    columns : dict of str to (k,)
        The :data:`LOGARITHMIC` and the linear ones.
    failed : tuple of (float, str)
        Lengths [m] that were not solved, and why.
    not_stable : (j,) [m]
        Lengths at which the vibration is unstable or its stability undecided.
    jumps : (j,) [m]
        Where the spline of ln delta K misses by more than :data:`ROUGH`, however close the lengths.
    leading : (k,) [rad/s]
        Load frequencies at which most of the growth happens.
    damping : float
        Least ratio of critical damping of the lowest modes, with a run-up; else nan.
    """

    lengths: np.ndarray
    columns: dict[str, np.ndarray]
    failed: tuple[tuple[float, str], ...] = ()
    not_stable: tuple[float, ...] = ()
    jumps: tuple[float, ...] = ()
    leading: np.ndarray = field(default_factory=lambda: np.zeros(0))
    damping: float = math.nan

    def at(self, name: str, lengths: np.ndarray) -> np.ndarray:
        """A column at any lengths within."""
        values = self.columns[name]
        if name not in LOGARITHMIC:
            return np.asarray(CubicSpline(self.lengths, values)(lengths))
        floor = LEAST * max(float(values.max()), 1e-300)
        spline = CubicSpline(self.lengths, np.log(np.maximum(values, floor)))
        return np.asarray(np.exp(spline(lengths)))

    def joined(self, table: SweepResult, law: Growth, cycles: np.ndarray) -> LengthPath:
        """With the cases of one more sweep, over lengths and the levels of a spectrum, each of
        which has so many cycles."""
        swept = np.array(table.axes[0].values)
        solved = table.converged.reshape(len(swept), -1).all(axis=1)
        lengths = np.append(self.lengths, swept[solved])
        order = np.argsort(lengths)
        rows = {name: table[name].reshape(len(swept), -1)[solved] for name in READ}
        new, leading = _driving(rows, law, cycles)
        columns = {
            name: np.append(values, new[name])[order] for name, values in self.columns.items()
        }
        failed = {float(swept[at[0]]): reason for at, reason in table.failed}
        unsure = table.not_stable.reshape(len(swept), -1).any(axis=1)
        return replace(
            self,
            lengths=lengths[order],
            columns=columns,
            failed=self.failed + tuple(failed.items()),
            not_stable=self.not_stable + tuple(swept[unsure & solved].tolist()),
            leading=np.append(self.leading, leading)[order],
        )


def _driving(
    rows: dict[str, np.ndarray], law: Growth, cycles: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns of lengths, and their leading frequencies, from those of their levels (k, levels).

    What drives the crack is the range of constant amplitude that makes it grow as much,

        (sum n_i (delta K_i / (1 - R_i)^(1 - gamma))^m / sum n_i)^(1 / m),

    levels below the threshold left out where another is above it."""
    effective = rows["delta_K_effective"]
    ratio = np.clip(rows["K_min"] / np.maximum(rows["K_max"], 1e-300), 0.0, 1.0 - 1e-9)
    drive = effective / (1.0 - ratio) ** (1.0 - law.ratio_exponent)
    grows = effective >= np.minimum(law.threshold, effective.max(axis=1, keepdims=True))
    largest = np.maximum(drive.max(axis=1, keepdims=True), 1e-300)
    shares = cycles / cycles.sum() * np.where(grows, drive / largest, 0.0) ** law.exponent
    place = shares.argmax(axis=1)[:, None]
    found = {name: np.take_along_axis(rows[name], place, axis=1)[:, 0] for name in rows}
    leading = found["omega"]
    found["driving"] = largest[:, 0] * shares.sum(axis=1) ** (1.0 / law.exponent)
    found["omega"] = cycles.sum() / (cycles / rows["omega"]).sum(axis=1)
    found |= {name: rows[name].max(axis=1) for name in ("K_max", "delta_K_effective")}
    return found, leading


def solve_lengths(
    scene: Scene,
    share_of_error: Callable[[LengthPath, np.ndarray], np.ndarray],
    folder: Path | None,
    comm: MPI.Comm,
    *,
    progress: bool = False,
) -> tuple[LengthPath, float]:
    """Solve a scene at lengths from its crack's to its growth's, until the cycles are known to
    ``growth.life_tolerance`` (collective).

    Parameters
    ----------
    scene : Scene
        With its crack length known, and a table of growth.
    share_of_error : callable
        Takes a path, and for each of its intervals the error of the spline's ln delta K there;
        returns what each adds to the error of the cycles, relative to them.
    folder : Path or None
        For the files of the sweeps, one for each round.

    Returns
    -------
    path : LengthPath
    error : float
        Of the cycles by interpolation, relative to them.

    Raises
    ------
    ConvergenceError
        Ctrl-C has stopped it, or too few lengths were solved.
    """
    assert scene.crack is not None and scene.crack.length is not None and scene.growth is not None
    start, stop = scene.crack.length, scene.growth.until
    law = scene.growth
    damping = math.nan if law.run_up is None else _least_damping(scene)
    levels, cycles = _levels(law, damping)
    wanted, missed, own = np.linspace(start, stop, FIRST), np.inf, np.zeros(0)
    columns = dict.fromkeys((*LOGARITHMIC, *LINEAR), np.zeros(0))
    path = LengthPath(np.zeros(0), columns, damping=damping)
    for number in range(1, ROUNDS + 1):
        file = None if folder is None else folder / f"growth_{number}.h5"
        swept = _swept(scene, wanted, levels)
        table = run_sweep(swept, file, comm, progress=progress, judged=False)
        if not table.complete:
            raise ConvergenceError("growth was stopped; the same command goes on with it")
        before, path = path, path.joined(table, law, cycles)
        if number == 1:
            if path.failed:
                at, why = path.failed[0]
                raise ConvergenceError(f"growth, a crack of {at:.4g} m: {why}")
            few = {name: values[::2] for name, values in path.columns.items()}
            before, own = LengthPath(path.lengths[::2], few), np.zeros(FIRST // 2)
        own = _missed(before, path, own)
        shares = share_of_error(path, own)
        missed = float(shares.sum())
        left = (shares > law.life_tolerance / len(shares)) & (missed > law.life_tolerance)
        wanted = (0.5 * (path.lengths[1:] + path.lengths[:-1]))[left | (own > ROUGH)]
        wanted = wanted[~np.isin(wanted, [at for at, _ in path.failed])]
        if not len(wanted):
            break
    return replace(path, jumps=tuple(path.lengths[:-1][own > ROUGH].tolist())), missed


def _levels(law: Growth, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Load frequencies [rad/s] of a spectrum, none without one, and the cycles of each.

    Those of a run-up are so close that a resonance is summed to 0.2 %: the error of a sum over
    1 / (1 + x^2) by steps of 1 is 2 exp(-2 pi)."""
    if law.frequencies is not None:
        return TURN * np.array(law.frequencies), np.array(law.cycles)
    if law.run_up is None:
        return np.zeros(0), np.ones(1)
    start, stop, rate = law.run_up
    count = math.ceil(math.log(stop / start) / math.log1p(damping)) + 1
    found = np.geomspace(start, stop, count)
    steps = np.diff(found)
    lasting = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)) / rate
    return TURN * found, found * lasting


def _least_damping(scene: Scene) -> float:
    """Least ratio of critical damping of the lowest modes."""
    study = prepare(scene, MPI.COMM_SELF, whole=True)
    modes = solve_modes(study.structure, min(FEW_MODES, study.structure.n_modes)).omega
    found = float(damping_ratios(study.structure, modes).min())
    if not found > 0.0:
        raise InputError("damping", None, "a ratio of each mode, with growth.run_up")
    return found


def _swept(scene: Scene, lengths: np.ndarray, levels: np.ndarray) -> Scene:
    """The scene with a sweep over some lengths, and over the levels of a spectrum."""
    over = {"crack.length": [float(at) for at in lengths]}
    if len(levels):
        over["excitation.omega"] = [float(omega) for omega in levels]
    return scene.replace(
        {
            "sweep": None,
            "sweep.over": over,
            "sweep.at_resonance": scene.given("growth").drive == "resonance",
            "output.quantities": tuple(OF_TIPS),
        }
    )


def _missed(before: LengthPath, path: LengthPath, missed: np.ndarray) -> np.ndarray:
    """Error of the spline's ln delta K on each interval between lengths: of those that are new, by
    what the spline before missed at their ends; of the others what it was, or how far both splines
    are apart in their middle, if that is more: a resonance that passes within shows around it, too.
    (k - 1,)"""

    def apart(lengths: np.ndarray) -> np.ndarray:
        here, there = (one.at("driving", lengths) for one in (path, before))
        return np.abs(np.log(here / there))

    at_ends, new = apart(path.lengths) / REDUCED, ~np.isin(path.lengths, before.lengths)
    middle = 0.5 * (path.lengths[1:] + path.lengths[:-1])
    known = missed[np.searchsorted(before.lengths, middle) - 1]
    old = np.maximum(known, apart(middle))
    return np.where(new[1:] | new[:-1], np.maximum(at_ends[1:], at_ends[:-1]), old)
