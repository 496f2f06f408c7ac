"""Mesh, modes, harmonics and samples of a scene made finer, one at a time.

Each number of the answer is extrapolated with the order that it shows (:mod:`grid_convergence`).
The uncertainty is that of the scene's own choice, the coarsest of the three: coarser meshes mostly
are not in the asymptotic range. Contributions are put together as the root of the sum of their
squares, if they are independent, and as their sum, if they are not.

Orders of theory: at the tip of a crack displacements are like r^(1/2), so frequencies and work
converge like h with elements of both orders, on equal cells and on cells graded by a fixed ratio
alike (Strang and Fix, An Analysis of the Finite Element Method, 1973, chapter 8); at the ends of a
clamp like h^(3/2) (Williams' equation for a right angle with one side held, nu = 0.3, plane stress:
1.52). Modes in a plane have w_j^2 proportional to j, and each that is left out contributes
w^2 / w_j^4, which sums up to N^-1. Where lips hit each other velocities jump: |U_k| falls like k^-2
and what is left out like H^-1, often faster (H^-3 where only forces have kinks), which is not
relied on. Samples of a force with kinks err like N^-2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from mpi4py import MPI

from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.balance.indicators import Indicators
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import MAX_SAMPLES, ConvergenceError
from fenics_crack.model.contact import is_piecewise_linear, is_rigid
from fenics_crack.model.modes import solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.scene.quantities import OF_LIPS, OF_POINTS, QUANTITIES
from fenics_crack.scene.scene import Scene
from fenics_crack.stages import within
from fenics_crack.study.finer import finer_mesh
from fenics_crack.study.grid_convergence import GridConvergence, grid_convergence
from fenics_crack.study.prepare import Study, modes_of, prepare, reduction_of
from fenics_crack.study.run import REFUSALS, Run, solve_prepared
from fenics_crack.study.verification import CAUSES, Verification
from fenics_crack.table import frequency_axis

__all__ = ["verify"]

ANSWER = ("amplitude", "ratio_2_1", "ratio_3_1", "mean_shift", "opening", "closed_share")
"""Quantities that are looked at where the scene does not choose."""
FREQUENCIES = 3
"""Natural ones, lips open."""
GRADED, GRID, COUNTS = (1.5, 2.0), (2.0, 3.0), (1, 2, 4)
"""How much finer graded meshes and grids are taken, and numbers of something."""
EVEN = 1.56
"""Elements along a lip after a refinement by 1.5, at most, relative to those before: with more, by
rounding up, the mesh would be of another kind."""
TIP, CLAMP = 1.0, 1.5
"""Orders with a crack and without one."""
TINY = 1e-9
"""A ratio that is none."""
OWN = "the scene's own choice"


def verify(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Verification:
    """How far a scene's steady vibration and natural frequencies are from converged (collective).

    Mesh, modes, harmonics and samples are made finer, one at a time and twice: a graded mesh by 1.5
    and 2, a grid by 2 and 3, numbers by 2 and 4. Of the three values of each quantity the observed
    order p, the extrapolated value f and the uncertainty F abs(f_i - f) follow, with a factor of
    safety F of 1.25 or 3 (:func:`fenics_crack.grid_convergence`; Roache 1994, Celik and others
    2008, ASME V&V 20-2009).

    A tolerance of the scene chooses harmonics and modes first. Of a mesh file and of matrices the
    mesh is left alone, and that is said. Runs that fail, and orbits that are not stable, are named.

    Parameters
    ----------
    scene : Scene
        As it is solved.
    comm : MPI.Comm
        Ranks that share each mesh.

    Returns
    -------
    Verification
        Each cause's part of the error of each quantity, and their total.

    Raises
    ------
    InputError
        As :func:`fenics_crack.prepare`.
    ConvergenceError
        The scene itself does not converge.

    Examples
    --------
    >>> found = fc.verify(scene)
    >>> percent = found.total("amplitude")
    """
    with within(OWN):
        study = prepare(scene, comm, whole=True)
        own = solve_prepared(study)
        if scene.harmonic_balance.tolerance is not None and own.result.converged:
            study = replace(study, scene=_settled(own))
            own = solve_prepared(study)
    if not own.result.converged:
        raise ConvergenceError(f"{OWN}: {own.result.status}")
    study = replace(study, scene=_settled(own))
    log = _Log()
    first = log.level(OWN, own)
    parts, counts = {}, {}
    absent: dict[str, str] = {}
    unknown: dict[str, str] = {}
    for cause, ways in zip(CAUSES, (_meshes, _modes, _harmonics, _samples), strict=True):
        found = ways(study)
        if isinstance(found, str):
            (unknown if cause == "mesh" else absent)[cause] = found
            continue
        levels = [first.counted(found.own), *log.levels(study, found)]
        if len(levels) == 1:
            unknown[cause] = "no finer run has converged"
            continue
        if len({level.size for level in levels}) < len(levels):
            unknown[cause] = "finer ones have as many elements, as mesh.size is that of the plate"
            continue
        counts[cause] = tuple(level.count for level in levels)
        parts[cause] = _convergence(levels, found)
    failures, verdicts = tuple(log.failures), log.verdicts
    return Verification(
        study.scene, first.values, first.units, parts, counts, absent, unknown, failures, verdicts
    )


def _settled(run: Run[PeriodicSolution]) -> Scene:
    """The scene of a run with what was chosen for it; with all modes kept it is not reduced, so
    that none is left out on a finer mesh."""
    scene, whole = run.scene, run.structure.whole
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is not None:
        changes["harmonic_balance.tolerance"] = None
        changes["harmonic_balance.harmonics"] = run.result.harmonics
    table = reduction_of(scene, whole)
    if table is None or modes_of(scene, table) >= whole.n_dofs:
        return scene.replace(changes | {"reduction.method": "off", "reduction.modes": None})
    kept = {"reduction.method": table.method, "reduction.modes": modes_of(scene, table)}
    return scene.replace(changes | kept)


# --- what is made finer ---------------------------------------------------------------------------


@dataclass(frozen=True)
class _Ways:
    """Finer scenes by what each is called, and the orders of theory.

    ``counts`` are the numbers of what is varied, the scene's own first; of a mesh, whose elements
    are counted when it is made, None.
    """

    finer: dict[str, Scene]
    counts: tuple[int, ...] | None
    formal: float
    highest: float = math.inf

    @property
    def own(self) -> int | None:
        return None if self.counts is None else self.counts[0]


def _meshes(study: Study) -> _Ways | str:
    scene = study.scene
    if scene.structure is not None:
        return "[structure] has matrices, and not the mesh that they are of"
    lips = scene.mesh.lip_elements or 0
    even = scene.mesh.layout == "graded" and math.ceil(1.5 * lips) <= EVEN * lips
    finer = {
        f"a mesh {factor:g} times finer": finer_mesh(scene, factor)
        for factor in (GRADED if even else GRID)
    }
    scenes = {name: found for name, found in finer.items() if found is not None}
    if not scenes:
        return "mesh.file is one mesh; make finer ones and compare them by fc.grid_convergence"
    formal = TIP if study.structure.n_pairs else CLAMP
    return _Ways(scenes, None, formal, 2.0 * scene.mesh.order)


def _modes(study: Study) -> _Ways | str:
    scene, whole = study.scene, study.structure
    table = reduction_of(scene, whole)
    if table is None:
        return "the structure is not reduced"
    kept, most = modes_of(scene, table), whole.n_dofs - whole.n_pairs
    if kept >= most:
        return "all are kept"
    return _more(scene, "reduction.modes", kept, most, 1.0)


def _harmonics(study: Study) -> _Ways | str:
    scene, table = study.scene, study.scene.harmonic_balance
    if study.contact is None:
        return "without contact there is one"
    if table.samples is not None:  # enough for all of them
        least = 4 * COUNTS[-1] * table.harmonics + 1
        scene = scene.replace({"harmonic_balance.samples": max(table.samples, least)})
    return _more(scene, "harmonic_balance.harmonics", table.harmonics, MAX_SAMPLES, 1.0)


def _samples(study: Study) -> _Ways | str:
    law, table = study.contact, study.scene.harmonic_balance
    if law is None:
        return "without contact there are none"
    if table.samples is None and (is_piecewise_linear(law) or is_rigid(law)):
        return "contact is integrated exactly"
    own = table.samples or default_samples(table.harmonics)
    return _more(study.scene, "harmonic_balance.samples", own, MAX_SAMPLES, 2.0)


def _more(scene: Scene, key: str, own: int, most: int, formal: float) -> _Ways:
    """Twice and four times as many of something, at most so many."""
    counts = tuple(sorted({min(factor * own, most) for factor in COUNTS}))
    name = key.rpartition(".")[2]
    finer = {f"{count} {name}": scene.replace({key: count}) for count in counts[1:]}
    return _Ways(finer, counts, formal)


# --- runs -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Level:
    """The numbers of a run: quantities and their units, elements, and their mean size [m]."""

    values: dict[str, float]
    units: dict[str, str]
    count: int
    size: float

    def counted(self, count: int | None) -> _Level:
        """Where something else than elements is varied: by its number."""
        return self if count is None else replace(self, count=count, size=1.0 / count)


@dataclass
class _Log:
    """Runs, and what is to be told of them."""

    failures: list[str] = field(default_factory=list)
    verdicts: dict[str, str] = field(default_factory=dict)

    def levels(self, study: Study, ways: _Ways) -> Iterator[_Level]:
        """The finer runs that converge (collective)."""
        counts = (None,) * len(ways.finer) if ways.counts is None else ways.counts[1:]
        for (name, scene), count in zip(ways.finer.items(), counts, strict=True):
            with within(name):
                try:
                    varied = replace(study, scene=scene)
                    if count is None:
                        varied = prepare(scene, study.structure.comm, whole=True)
                    run = solve_prepared(varied)
                    if run.result.converged:
                        yield self.level(name, run).counted(count)
                    else:
                        self.failures.append(f"{name}: {run.result.status}")
                except REFUSALS as error:
                    self.failures.append(f"{name}: {error}")

    def level(self, name: str, run: Run[PeriodicSolution]) -> _Level:
        """What a run found; its verdict is kept where it is doubtful (collective)."""
        stability, whole = run.result.stability, run.structure.whole
        if stability is not None and stability.verdict != "stable":
            self.verdicts[name] = stability.verdict
        values, units = _answer(run)
        omega = solve_modes(whole, min(FREQUENCIES, whole.n_modes)).omega
        factor, _, unit = frequency_axis(run.scene.in_hertz)
        kind = "frequency" if run.scene.in_hertz else "omega"
        for mode, value in enumerate(omega, 1):
            values[f"{kind}_open_{mode}"] = factor * float(value)
            units[f"{kind}_open_{mode}"] = unit
        return _Level(values, units, *_elements(run.scene, whole))


def _answer(run: Run[PeriodicSolution]) -> tuple[dict[str, float], dict[str, str]]:
    """What is asked for of the watched points and the lips, and the units (collective)."""
    output = run.scene.output
    chosen = (output.quantities if output is not None else None) or ANSWER
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    seen: Indicators | None = None
    for watched in run.watched:
        seen = run.result.indicators(watched.dof)
        for name in chosen:
            if name in OF_POINTS:
                values[watched.column(name)] = float(getattr(seen, name))
                units[watched.column(name)] = QUANTITIES[name][1]
    for name in chosen:
        if name in OF_LIPS:
            values[name], units[name] = float(getattr(seen, name)), QUANTITIES[name][1]
    known = {n: v for n, v in values.items() if abs(v) > (TINY if units[n] == "1" else 0.0)}
    return known, {n: "" if units[n] == "1" else units[n] for n in known}


def _elements(scene: Scene, whole: Structure) -> tuple[int, float]:
    """How many there are, and the side of a square of their mean area [m] (Celik and others,
    equation 1); of matrices one (collective)."""
    count = 0 if whole.nodes is None else whole.comm.allreduce(len(whole.nodes.cells))
    width, height = (
        (1.0, 1.0) if scene.structure is not None else (scene.geometry.width, scene.geometry.height)
    )
    return max(count, 1), math.sqrt((width or 1.0) * (height or 1.0) / max(count, 1))


def _convergence(levels: list[_Level], ways: _Ways) -> dict[str, GridConvergence]:
    """Of each quantity of the first level; what another level does not have is none there."""
    sizes = [level.size for level in levels]
    found = {}
    for name in levels[0].values:
        values = [level.values.get(name, 0.0) for level in levels]
        found[name] = grid_convergence(sizes, values, formal=ways.formal, highest=ways.highest)
    return found
