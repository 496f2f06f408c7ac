"""The forward model: what would be measured with given unknowns, interpolated from sweeps.

Four sweeps over the unknowns, each in a file from which a killed run goes on, are all that is
solved: of the scene; of a finer mesh with more harmonics at a few of the same values, which
corrects the first one; and both of the plate without its crack.

What is interpolated is smooth in the unknowns: the logarithms of natural frequencies, and the
harmonics as complex numbers, a - i b of a cos + b sin. Their amplitudes alone have kinks where they
vanish, and both have poles, which move with the crack, where k times the load's frequency W meets a
natural frequency w_j of the breathing crack with a damping ratio z. So of the k-th harmonic it is

    U_k prod_j (1 - r^2 + 2 i z r) / s^(k - 1),      r = k W / w_j,

with the bilinear frequencies w_j of the same nodes and the sum s over the modes of the relative
differences between frequencies with lips tied and open, to whose power U_k of a short crack grows.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.files.store import scene_text
from fenics_crack.identification.interpolation import Cube, Interpolation
from fenics_crack.identification.measurements import Measurement
from fenics_crack.model.bilinear import FEW, BilinearFrequencies
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Sweep
from fenics_crack.study.finer import finer_mesh
from fenics_crack.sweep.file import CONVERGED
from fenics_crack.sweep.result import SweepResult, run_sweep

__all__ = ["Forward", "Model", "solve_forward"]

FEW_NODES = {1: 5, 2: 4}
"""Values of each unknown that the finer sweep takes, by the number of unknowns; of more, 3."""
DEFAULT_RATIO = 0.01
"""Of damping, where a scene's is a matrix."""
FREQUENCY = "excitation.frequency"
RATIOS = ("ratio_2_1", "ratio_3_1")


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


# --- a model --------------------------------------------------------------------------------------


def _models(scene: Scene, coarse: SweepResult, finer: SweepResult | None) -> dict[str, Model]:
    """Models by the words that tell them from each other."""
    axes = coarse.axes[:-1]
    words = [range(len(a.values)) if isinstance(a.values[0], str) else (None,) for a in axes]
    found = {}
    for chosen in itertools.product(*words):
        picked = [(axis, at) for axis, at in zip(axes, chosen, strict=True) if at is not None]
        name = ", ".join(str(axis.values[at]) for axis, at in picked)
        parts = [None if one is None else _Part.of(one, chosen) for one in (coarse, finer)]
        assert parts[0] is not None
        fixed = {axis.key: axis.values[at] for axis, at in picked}
        found[name] = Model(scene, parts[0], parts[1], fixed)
    return found


@dataclass(frozen=True)
class _Part:
    """What a sweep knows, with its words chosen."""

    sweep: SweepResult
    keys: tuple[str, ...]
    cube: Cube
    index: tuple[Any, ...]

    @classmethod
    def of(cls, sweep: SweepResult, chosen: Sequence[int | None]) -> _Part:
        numbers = [a for a, at in zip(sweep.axes, chosen, strict=False) if at is None]
        index = tuple(slice(None) if at is None else at for at in chosen)
        cube = Cube(tuple(np.array(axis.values, dtype=float) for axis in numbers))
        return cls(sweep, tuple(axis.key for axis in numbers), cube, index)

    def column(self, name: str) -> np.ndarray:
        """A column at all nodes and load frequencies: (n, n_loads)."""
        values = self.sweep[name][self.index]
        return np.asarray(values.reshape(-1, values.shape[-1]), dtype=float)

    def natural(self, lips: str, mode: int) -> np.ndarray:
        """A natural frequency at all nodes [Hz]: (n,); of an uncracked plate the same for all."""
        if lips == "bilinear":
            opened, tied = (self.natural(state, mode) for state in ("open", "tied"))
            return BilinearFrequencies(opened, tied).omega_bilinear
        column = self.column(f"omega_{lips}_{mode}") / (2.0 * np.pi)
        known = np.isfinite(column)
        best = np.max(np.where(known, column, -np.inf), axis=1)
        return np.where(known.any(axis=1), best, np.nan)

    def harmonic(self, point: str, frequency: float, order: int) -> np.ndarray:
        """Complex amplitude of a harmonic at all nodes: (n,) [m]."""
        parts = []
        for part in ("cosine", "sine"):
            name = f"{point}.{part}_{order}" if point else f"{part}_{order}"
            if name not in self.sweep.columns:
                points = self.sweep.scene.output.points if self.sweep.scene.output else ()
                known = [f"{one.key}.u{axis}" for one in points for axis in "xy"]
                allowed = f"empty, or one of [output.points]: {', '.join(known) or 'none there'}"
                raise InputError("measurements.point", point, allowed)
            parts.append(self.column(name))
        load = self.sweep.axes[-1].values.index(float(frequency))
        solved = self.column("state")[:, load] == CONVERGED
        return np.where(solved, (parts[0] - 1j * parts[1])[:, load], np.nan)

    @cached_property
    def resonances(self) -> np.ndarray:
        """Bilinear frequencies at all nodes [Hz]: (n, modes); nan where there is none."""
        found = np.stack([self.natural("bilinear", mode + 1) for mode in range(FEW)], axis=1)
        return np.where(np.isfinite(found), found, np.nan)

    @cached_property
    def strength(self) -> np.ndarray:
        """How much the crack softens the plate, s, at all nodes: (n,); 1 without a crack."""
        total = np.zeros(len(self.cube.nodes))
        for mode in range(1, FEW + 1):
            tied, is_open = self.natural("tied", mode), self.natural("open", mode)
            with np.errstate(invalid="ignore"):
                total += np.nan_to_num((tied - is_open) / tied, posinf=0.0, neginf=0.0)
        return np.where(total > 1e-9, total, 1.0)


class Model:
    """Predicts what would be measured, with the standard deviation of the prediction.

    Parameters
    ----------
    scene : Scene
        For its damping.
    coarse, finer : _Part
        The sweep, and that of the finer mesh, or None.
    fixed : mapping of str to object
        The unknowns that are words, and their values here.
    """

    def __init__(
        self, scene: Scene, coarse: _Part, finer: _Part | None, fixed: Mapping[str, Any]
    ) -> None:
        self._scene, self._coarse, self._finer = scene, coarse, finer
        self.fixed, self.keys, self.cube = dict(fixed), coarse.keys, coarse.cube

    def quantities(self, rows: Sequence[Measurement]) -> Quantities:
        """Some measurements, ready to be predicted."""
        return Quantities(self, rows)

    def damping(self, x: np.ndarray) -> np.ndarray:
        """A ratio of damping at values (m, d) of the unknowns: (m, 1)."""
        if "damping.ratio" in self.keys:
            return x[:, [self.keys.index("damping.ratio")]]
        table = self._scene.damping
        ratio = None if table is None else table.ratio
        if table is not None and ratio is None:
            ratio = table.ratios
        return np.full((len(x), 1), DEFAULT_RATIO if ratio is None else np.mean(ratio))

    def scale(self, x: np.ndarray, key: Feature, own: np.ndarray) -> np.ndarray:
        """What multiplies a complex harmonic to make it smooth, at values x (m, d): (m,); ``own``
        (m, 1 + modes) are the strength and the bilinear frequencies there."""
        if key.lips:
            return np.ones(len(x))
        r = key.order * key.frequency / own[:, 1:]
        factors = 1.0 - r**2 + 2j * self.damping(x) * r
        return np.nanprod(factors, axis=1) / own[:, 0] ** (key.order - 1)

    @property
    def finer_by(self) -> float:
        """How much finer the mesh of the correction is."""
        assert self._scene.identify is not None
        return self._scene.identify.finer

    @property
    def uneven(self) -> float:
        """Least relative standard deviation of the higher harmonics."""
        assert self._scene.identify is not None
        return self._scene.identify.harmonic_deviation

    def candidates(self) -> tuple[Measurement, ...]:
        """What might be measured: natural frequencies, and ratios of harmonics at the points and
        load frequencies of the sweep."""
        kinds = [f"frequency_{lips}" for lips in ("open", "tied", "bilinear")]
        rows = [Measurement(k, 1.0, 1.0, mode=mode + 1) for k in kinds for mode in range(FEW)]
        sweep = self._coarse.sweep
        points = sweep.scene.output.points if sweep.scene.output else ()
        seen = ["", *(f"{point.key}.u{axis}" for point in points for axis in "xy")]
        for load, point, ratio in itertools.product(sweep.axes[-1].values, seen, RATIOS):
            rows.append(Measurement(ratio, 1.0, 1.0, frequency=load, point=point))
        return tuple(rows)

    @property
    def coarse(self) -> _Part:
        """The sweep of the scene itself."""
        return self._coarse

    @property
    def finer(self) -> _Part | None:
        """The sweep of the finer mesh."""
        return self._finer


@dataclass(frozen=True)
class Feature:
    """Something that is interpolated: a natural frequency, or a harmonic of a point at a load."""

    lips: str = ""
    mode: int = 0
    point: str = ""
    frequency: float = 0.0
    order: int = 0

    @classmethod
    def of(cls, row: Measurement) -> tuple[Feature, ...]:
        """Of a measurement; of a ratio both harmonics, the one above first."""
        if row.natural:
            lips = row.quantity.removeprefix("frequency_")
            return (cls("open" if lips == "uncracked" else lips, row.mode),)
        orders = [int(part) for part in row.quantity.split("_")[1:]]
        return tuple(cls("", 0, row.point, float(row.frequency), order) for order in orders)

    def values(self, part: _Part) -> np.ndarray:
        """At all nodes of a sweep: (n,), logarithms or complex numbers."""
        if self.lips:
            return np.log(part.natural(self.lips, self.mode)).astype(complex)
        return part.harmonic(self.point, self.frequency, self.order)


class Quantities:
    """Predictions of some measurements by a model."""

    def __init__(self, model: Model, rows: Sequence[Measurement]) -> None:
        self.model, self.rows = model, tuple(rows)
        self._of_rows = [Feature.of(row) for row in rows]
        self._features = tuple(dict.fromkeys(one for found in self._of_rows for one in found))
        part, fine = model.coarse, model.finer
        self._basis = Interpolation(part.cube, np.log(_basis(part)))
        self._coarse = Interpolation(part.cube, _pairs(self._smooth(part)))
        # An error of the first order leaves d / (f - 1) where a mesh finer by f changes d, one of
        # high order nothing: half of the former is added, and may be wrong.
        self._correction: Interpolation | None = None
        self._left = 0.5 / max(model.finer_by - 1.0, 0.1)
        if fine is not None:
            own = self._coarse(fine.cube.nodes)[0]
            self._correction = Interpolation(fine.cube, _pairs(self._smooth(fine)) - own)

    def _smooth(self, part: _Part) -> np.ndarray:
        """The smooth forms of all features at the nodes of a sweep: (n, q), complex."""
        nodes = part.cube.nodes
        own = self._own(nodes)  # of the coarse sweep, for the finer one too
        columns = [f.values(part) * self.model.scale(nodes, f, own) for f in self._features]
        return np.stack(columns, axis=1)

    def _own(self, x: np.ndarray) -> np.ndarray:
        """Strength and bilinear frequencies at values (m, d) of the unknowns: (m, 1 + modes)."""
        basis, known = self._basis(x)
        return np.where(np.isfinite(known), np.exp(basis), np.nan)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values at some values (m, d) of the unknowns, and their standard deviations: (m, q) each,
        the latter infinite where the model knows nothing."""
        smooth, variance = self._coarse(x)
        variance = variance**2
        if self._correction is not None:
            difference, scatter = self._correction(x)
            left = self._left * difference
            smooth = smooth + difference + left
            variance = variance + scatter**2 + left**2
        own = self._own(x)
        found: dict[Feature, tuple[np.ndarray, np.ndarray]] = {}
        for place, feature in enumerate(self._features):
            at = slice(2 * place, 2 * place + 2)
            value, spread = smooth[:, at] @ [1.0, 1j], np.sqrt(variance[:, at])
            if feature.lips:
                size = np.exp(value.real)
                found[feature] = size, size * spread[:, 0]
            else:
                scale = np.abs(self.model.scale(x, feature, own))
                size, error = np.abs(value), np.sqrt(np.mean(spread**2, axis=1))
                if feature.order > 1:
                    error = np.hypot(error, self.model.uneven * size)
                found[feature] = size / scale, error / scale
        values, deviations = np.zeros((2, len(x), len(self.rows)))
        for place, features in enumerate(self._of_rows):
            values[:, place], deviations[:, place] = _quantity([found[one] for one in features])
        return values, deviations


def _basis(part: _Part) -> np.ndarray:
    """Strength and bilinear frequencies at the nodes of a sweep: (n, 1 + modes)."""
    return np.column_stack([part.strength, part.resonances])


def _pairs(values: np.ndarray) -> np.ndarray:
    """Complex columns (n, q) as real and imaginary ones, one beside the other: (n, 2q)."""
    return np.stack([values.real, values.imag], axis=2).reshape(len(values), -1)


def _quantity(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """A quantity and its standard deviation: the only one of its parts, or their ratio."""
    if len(parts) == 1:
        return parts[0]
    (above, of_above), (below, of_below) = parts
    ratio = above / below
    return ratio, np.hypot(of_above, ratio * of_below) / below
