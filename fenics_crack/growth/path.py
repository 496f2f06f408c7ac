"""Numbers of a plate over the length of its crack: solved at few lengths, and between them splines.

Lengths are halved where a spline misses what is then found. Each round is a sweep: its cases are
shared among ranks, and it goes on where it was killed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from fenics_crack.errors import ConvergenceError
from fenics_crack.scene.quantities import OF_TIPS
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.result import SweepResult, run_sweep

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
LOGARITHMIC = ("K_max", "delta_K_effective", "response")
"""Columns whose logarithm is smooth: resonances pass through them."""
LINEAR = ("omega", "omega_open", "omega_bilinear", "K_min", "K_II_max")
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
    """

    lengths: np.ndarray
    columns: dict[str, np.ndarray]
    failed: tuple[tuple[float, str], ...] = ()
    not_stable: tuple[float, ...] = ()
    jumps: tuple[float, ...] = ()

    def at(self, name: str, lengths: np.ndarray) -> np.ndarray:
        """A column at any lengths within."""
        values = self.columns[name]
        if name not in LOGARITHMIC:
            return np.asarray(CubicSpline(self.lengths, values)(lengths))
        floor = LEAST * max(float(values.max()), 1e-300)
        spline = CubicSpline(self.lengths, np.log(np.maximum(values, floor)))
        return np.asarray(np.exp(spline(lengths)))

    def joined(self, table: SweepResult) -> LengthPath:
        """With the cases of one more sweep."""
        swept, solved = np.array(table.axes[0].values), table.converged
        lengths = np.append(self.lengths, swept[solved])
        order = np.argsort(lengths)
        columns = {
            name: np.append(values, table[name][solved])[order]
            for name, values in self.columns.items()
        }
        failed = tuple((float(swept[at]), reason) for at, reason in table.failed)
        doubtful = tuple(swept[table.not_stable & solved].tolist())
        return LengthPath(lengths[order], columns, self.failed + failed, self.not_stable + doubtful)


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
    wanted, missed, own = np.linspace(start, stop, FIRST), np.inf, np.zeros(0)
    path = LengthPath(np.zeros(0), dict.fromkeys((*LOGARITHMIC, *LINEAR), np.zeros(0)))
    for number in range(1, ROUNDS + 1):
        file = None if folder is None else folder / f"growth_{number}.h5"
        table = run_sweep(_swept(scene, wanted), file, comm, progress=progress, judged=False)
        if not table.complete:
            raise ConvergenceError("growth was stopped; the same command goes on with it")
        before, path = path, path.joined(table)
        if number == 1:
            if path.failed:
                at, why = path.failed[0]
                raise ConvergenceError(f"growth, a crack of {at:.4g} m: {why}")
            few = {name: values[::2] for name, values in path.columns.items()}
            before, own = LengthPath(path.lengths[::2], few), np.zeros(FIRST // 2)
        own = _missed(before, path, own)
        shares = share_of_error(path, own)
        missed = float(shares.sum())
        left = (shares > scene.growth.life_tolerance / len(shares)) & (
            missed > scene.growth.life_tolerance
        )
        wanted = (0.5 * (path.lengths[1:] + path.lengths[:-1]))[left | (own > ROUGH)]
        wanted = wanted[~np.isin(wanted, [at for at, _ in path.failed])]
        if not len(wanted):
            break
    return replace(path, jumps=tuple(path.lengths[:-1][own > ROUGH].tolist())), missed


def _swept(scene: Scene, lengths: np.ndarray) -> Scene:
    """The scene with a sweep over some lengths."""
    assert scene.growth is not None
    return scene.replace(
        {
            "sweep": None,
            "sweep.over": {"crack.length": [float(at) for at in lengths]},
            "sweep.at_resonance": scene.growth.drive == "resonance",
            "output.quantities": tuple(OF_TIPS),
        }
    )


def _missed(before: LengthPath, path: LengthPath, missed: np.ndarray) -> np.ndarray:
    """Error of the spline's ln delta K on each interval between lengths: of those that are new, by
    what the spline before missed at their ends; of the others what it was, or how far both splines
    are apart in their middle, if that is more: a resonance that passes within shows around it, too.
    (k - 1,)"""

    def apart(lengths: np.ndarray) -> np.ndarray:
        here, there = (one.at("delta_K_effective", lengths) for one in (path, before))
        return np.abs(np.log(here / there))

    at_ends, new = apart(path.lengths) / REDUCED, ~np.isin(path.lengths, before.lengths)
    middle = 0.5 * (path.lengths[1:] + path.lengths[:-1])
    known = missed[np.searchsorted(before.lengths, middle) - 1]
    old = np.maximum(known, apart(middle))
    return np.where(new[1:] | new[:-1], np.maximum(at_ends[1:], at_ends[:-1]), old)
