"""The sweeps of the forward model, from which predictions are interpolated.

Four sweeps over the unknowns, each in a file from which a killed run goes on, are all that is
solved: of the scene; of a finer mesh with more harmonics at a few of the same values, which
corrects the first one; and both of the plate without its crack.

A :class:`Model` interpolates between what they have solved.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.files.store import scene_text
from fenics_crack.identification.features import Part
from fenics_crack.identification.model import Model
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Sweep
from fenics_crack.study.verification import finer_mesh
from fenics_crack.sweep.result import SweepResult, run_sweep

__all__ = ["Forward", "solve_forward"]

FEW_NODES = {1: 5, 2: 4}
"""Values of each unknown that the finer sweep takes, by the number of unknowns; of more, 3."""
FREQUENCY = "excitation.frequency"


@dataclass(frozen=True)
class Forward:
    """The sweeps of a forward model.

    Attributes
    ----------
    scene : Scene
        With its table ``[identify]``.
    coarse : SweepResult
        Over the unknowns and the load frequencies.
    finer : SweepResult or None
        Over some of the same values; None where the scene wants no correction.
    uncracked, uncracked_finer : SweepResult or None
        Over the unknowns that are not the crack's; None where the crack cannot be taken away.
    """

    scene: Scene
    coarse: SweepResult
    finer: SweepResult | None
    uncracked: SweepResult | None
    uncracked_finer: SweepResult | None

    @property
    def cracked_models(self) -> dict[str, Model]:
        """A model for each combination of the unknowns that are words: "" or "right"."""
        return _models(self.scene, self.coarse, self.finer)

    @property
    def uncracked_models(self) -> dict[str, Model]:
        """The same without the crack."""
        if self.uncracked is None:
            return {}
        return _models(self.scene, self.uncracked, self.uncracked_finer)


def solve_forward(
    scene: Scene,
    frequencies: Sequence[float],
    folder: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
) -> Forward:
    """Solve, or read, what the forward model is interpolated from (collective).

    Parameters
    ----------
    scene : Scene
        With its table ``[identify]``.
    frequencies : sequence of float
        Of the load [Hz]; the scene's further ones are added.
    folder : path
        Where the files of the sweeps are; their names depend on the scene and the frequencies.
    comm : MPI.Comm
        The ranks over which the cases are spread.
    progress : bool
        Show bars.

    Raises
    ------
    InputError
        As :func:`run_sweep`.
    """
    table = scene.identify
    assert table is not None
    loads = tuple(sorted({float(one) for one in (*frequencies, *table.frequencies)}))
    asked = ("sweep", "curve", "integration", "identify", "tip_timing")
    plain = scene.replace(dict.fromkeys(asked))
    whole = _finer(plain, table.finer)

    def run(name: str, of: Scene, axes: Sequence[Axis]) -> SweepResult:
        over = (*axes, Axis(FREQUENCY, loads or (of.excitation.omega / (2.0 * math.pi),)))
        swept = replace(of, sweep=Sweep(over=over))
        digest = hashlib.sha256(scene_text(swept).encode()).hexdigest()[:8]
        path = folder / f"{name}_{digest}.h5"
        return run_sweep(swept, path, comm, progress=progress, verdicts=False)

    coarse = run("forward", plain, table.unknown)
    finer = None if whole is None else run("forward_finer", whole, _thinned(table.unknown))
    without = _uncracked(plain, table.unknown)
    if without is None:
        return Forward(scene, coarse, finer, None, None)
    bare, others = without
    uncracked = run("uncracked", bare, others)
    fine_bare = None if whole is None else _uncracked(whole, _thinned(others))
    uncracked_finer = None if fine_bare is None else run("uncracked_finer", *fine_bare)
    return Forward(scene, coarse, finer, uncracked, uncracked_finer)


def _finer(scene: Scene, factor: float) -> Scene | None:
    """A scene with a finer mesh and more harmonics; None where nothing is to be finer."""
    if factor == 1.0:
        return None
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is None:
        harmonics = min(100, math.ceil(factor * scene.harmonic_balance.harmonics))
        changes = {"harmonic_balance.harmonics": harmonics, "harmonic_balance.samples": None}
    finer = finer_mesh(scene, factor)
    if finer is None and not changes:
        return None
    return (finer or scene).replace(changes)


def _thinned(axes: Sequence[Axis]) -> tuple[Axis, ...]:
    """Some of the values of each unknown, its ends among them; all words."""
    numbers = [axis for axis in axes if not isinstance(axis.values[0], str)]
    count = FEW_NODES.get(len(numbers), 3)
    found = []
    for axis in axes:
        places = np.unique(np.linspace(0, len(axis.values) - 1, count).round().astype(int))
        few = tuple(axis.values[at] for at in places) if axis in numbers else axis.values
        found.append(Axis(axis.key, few))
    return tuple(found)


def _uncracked(scene: Scene, axes: Sequence[Axis]) -> tuple[Scene, tuple[Axis, ...]] | None:
    """A scene without its crack, and the unknowns that are left; None where there is no such."""
    if scene.structure is not None or scene.mesh.layout == "file" or len(scene.all_cracks) != 1:
        return None
    others = tuple(axis for axis in axes if not axis.key.startswith(("crack.", "contact.")))
    return scene.replace({"crack": None, "cracks": None, "contact": None}), others


def _models(scene: Scene, coarse: SweepResult, finer: SweepResult | None) -> dict[str, Model]:
    """Models by the words that tell them from each other."""
    axes = coarse.axes[:-1]
    words = [range(len(a.values)) if isinstance(a.values[0], str) else (None,) for a in axes]
    found = {}
    for chosen in itertools.product(*words):
        picked = [(axis, at) for axis, at in zip(axes, chosen, strict=True) if at is not None]
        name = ", ".join(str(axis.values[at]) for axis, at in picked)
        parts = [None if one is None else Part.of(one, chosen) for one in (coarse, finer)]
        assert parts[0] is not None
        fixed = {axis.key: axis.values[at] for axis, at in picked}
        found[name] = Model(scene, parts[0], parts[1], fixed)
    return found
