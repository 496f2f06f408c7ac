"""Mesh, modes, harmonics and samples of a scene made finer, one at a time. What harmonics leave
out is known, without finer runs, where an exact orbit is the solution's own (:func:`by_orbit`).

Each number of the answer is extrapolated with the order that it shows (:mod:`verification`).
The uncertainty is that of the scene's own choice, the coarsest of the three: coarser meshes mostly
are not in the asymptotic range. Contributions are put together as the root of the sum of their
squares, if they are independent, and as their sum, if they are not.

Orders of theory: at the tip of a crack displacements are like r^(1/2), so frequencies and work
converge like h with elements of both orders, on equal cells and on cells graded by a fixed ratio
(Strang and Fix, An Analysis of the Finite Element Method, 1973, chapter 8); at the ends of a clamp
like h^(3/2) (Williams' equation for a right angle with one side held, nu = 0.3, plane stress:
1.52). Modes in a plane have w_j^2 proportional to j, and each that is left out contributes w^2 /
w_j^4, which sums up to N^-1. Where crack faces hit each other velocities jump: |U_k| falls like
k^-2 and what is left out like H^-1, often faster (H^-3 where only forces have kinks), which is not
relied on. Samples of a force with kinks err like N^-2.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from mpi4py import MPI

from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import MAX_SAMPLES, ConvergenceError
from fenics_crack.basics.progress import within
from fenics_crack.model.contact import is_unilateral
from fenics_crack.model.modes import solve_modes
from fenics_crack.scene.scene import Scene
from fenics_crack.study.coarser_mesh import CLAMP, TIP, finer_mesh, n_elements, parts_of
from fenics_crack.study.prepare import REFUSALS, Study, prepare, reduced, reduction_of
from fenics_crack.study.run import Run, solve_prepared
from fenics_crack.study.stated_errors import (
    Numbers,
    as_changed,
    by_orbit,
    numbers_of,
    of_own_orbit,
    resonance_of,
    shifted,
    with_friction,
)
from fenics_crack.study.verification import GridConvergence, Varied, Verification

COUNTS = (1, 2, 4)
"""Refinement factors of counts."""
OWN = "the scene's own choice"


def verify(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Verification:
    """Compute the convergence of a scene's steady vibration and natural frequencies (collective).

    Mesh, modes, harmonics and samples are made finer, one at a time and twice: a graded mesh by 1.5
    and 2, a grid by 2 and 3, numbers by 2 and 4. Of the three values of each quantity the observed
    order p, the extrapolated value f and the uncertainty F abs(f_i - f) follow, with a factor of
    safety F of 1.25 or 3 (:func:`fenics_crack.grid_convergence`; Roache 1994, Celik and others
    2008, ASME V&V 20-2009). Harmonics are not varied where an exact orbit is the solution's
    own: their part is the distance from its numbers.

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
        if scene.reduction is not None and scene.reduction.modes is not None:
            kept = _kept_modes(study)
            if not isinstance(kept, str):  # all at once: each run takes the first of them
                with contextlib.suppress(*REFUSALS):
                    solve_modes(study.structure, min(COUNTS[-1] * kept[0], kept[1]))
        own = solve_prepared(study)
        if scene.harmonic_balance.tolerance is not None and own.result.converged:
            own = solve_prepared(_varied(own, _settled(own)), own.result)
    if not own.result.converged:
        raise ConvergenceError(f"{OWN}: {own.result.status}")
    study = replace(study, scene=_settled(own))
    numbers = numbers_of(own, own.result)
    runs = _Runs(study, own, numbers)
    found = Verification(study.scene, numbers.values, numbers.units, verdicts=_doubtful(OWN, own))
    for cause, part_of in VARIED_CAUSES.items():
        try:
            found.take(cause, part_of(runs))
        except ConvergenceError:
            found.unknown[cause] = "no finer run has converged"
        if cause == "mesh" and cause in found.parts:
            many, parts = found.counts[cause], found.parts[cause]
            found.take("shift", (many[:: len(many) - 1], _carried(own, numbers, parts)))
    found.take("friction", with_friction(own, own.result, found.values, numbers.mode))
    found.verdicts.update(runs.verdicts)
    return replace(found, failures=tuple(runs.failures))


def _varied(study: Study, scene: Scene) -> Study:
    """Another scene of the same mesh, and with the same reduction where the study is reduced."""
    return Study(scene, study.structure, study.contact, study.watched)


def _settled(run: Run[PeriodicSolution]) -> Scene:
    """The scene of a run with what was chosen for it; with all modes kept it is not reduced, so
    that none is left out on a finer mesh."""
    scene, whole = run.scene, run.structure.whole
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is not None:
        changes["harmonic_balance.tolerance"] = None
        changes["harmonic_balance.harmonics"] = run.result.harmonics
    if scene.disk is not None:
        return scene.replace(changes)
    kept = reduction_of(scene, whole)
    if kept is None or kept.modes >= whole.n_dofs:
        return scene.replace(changes | {"reduction.method": "off", "reduction.modes": None})
    return scene.replace(changes | {"reduction.method": kept.method, "reduction.modes": kept.modes})


# --- runs -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Runs:
    """The scene's own run, settled, and the results of finer ones.

    Attributes
    ----------
    study : Study
        Of the settled scene, with the whole structure.
    own : Run of PeriodicSolution
        Its solution.
    numbers : Numbers
        Of that.
    failures, verdicts
        As :class:`Verification` has them, of finer runs.
    """

    study: Study
    own: Run[PeriodicSolution]
    numbers: Numbers
    failures: list[str] = field(default_factory=list)
    verdicts: dict[str, str] = field(default_factory=dict)

    @cached_property
    def exact(self) -> dict[str, float] | None:
        """Numbers of the exact orbit accepted for the scene's solution, if one is (collective)."""
        return of_own_orbit(self.own, self.own.result, self.numbers.mode)

    def part(
        self,
        cause: str,
        finer: Mapping[str, Scene],
        counts: Sequence[int | None],
        formal: float,
        *,
        shared: Study | None = None,
        highest: float = math.inf,
    ) -> Varied:
        """The part of a cause, by finer scenes and what each is called (collective).

        ``counts`` are the numbers of what is varied, the scene's own first; None of a mesh, whose
        elements are counted when it is made. ``formal`` and ``highest`` are orders of theory, and
        ``shared`` is the study of all runs but those of a mesh.
        """
        numbers, scene = self.numbers, self.study.scene
        levels = [(counts[0] or n_elements(self.own.structure), numbers.values)]
        finest_first = list(zip(finer.items(), counts[1:], strict=True))[::-1]
        for (name, changed), count in finest_first:  # few modes are among many
            run = self._run(name, changed, shared)
            if run is not None:
                values = self._values(run, cause)
                levels.insert(1, (count or n_elements(run.structure), values))
                self.verdicts.update(_doubtful(name, run))
        many = tuple(count for count, _ in levels)
        if len(many) == 1:
            raise ConvergenceError(cause)
        if len(set(many)) < len(many):
            return "finer ones have as many elements, as mesh.size is that of the plate"
        found = [values for _, values in levels]
        return many, parts_of(cause, many, found, scene, formal=formal, highest=highest)

    def _values(self, run: Run[PeriodicSolution], cause: str) -> dict[str, float]:
        """The numbers of a finer run; of more modes as the exact orbits change, where both have
        their own: to few harmonics the modes above all of them seem static (collective)."""
        mode = self.numbers.mode
        if cause == "modes" and self.exact is not None:
            exact = of_own_orbit(run, run.result, mode)
            if exact is not None:
                return as_changed(self.numbers.values, self.exact, exact)
        return numbers_of(run, run.result, mode).values

    def more(
        self, shared: Study, scene: Scene, key: str, own: int, most: int, formal: float
    ) -> Varied:
        """The same of twice and four times as many of something, at most so many (collective)."""
        counts = sorted({min(factor * own, most) for factor in COUNTS})
        cause = name = key.rpartition(".")[2]
        finer = {f"{count} {name}": scene.replace({key: count}) for count in counts[1:]}
        return self.part(cause, finer, counts, formal, shared=shared)

    def _run(self, name: str, scene: Scene, shared: Study | None) -> Run[PeriodicSolution] | None:
        """The run of a finer scene, from the solution that it shares a structure with; on another
        mesh as far from the resonance of a mode; None, and its failure, where it does not converge
        (collective)."""
        own, mode = self.own, self.numbers.mode
        initial, omega = shared.result if isinstance(shared, Run) else None, own.result.omega
        with within(name):
            try:
                if shared is not None:
                    varied = reduced(_varied(shared, scene), judged=False)
                else:
                    varied = prepare(scene, own.structure.comm, judged=False)
                    moved = resonance_of(varied.structure, mode) / resonance_of(own.structure, mode)
                    omega *= moved
                run = solve_prepared(varied, initial, omega)
                if run.result.converged:
                    return run
                self.failures.append(f"{name}: {run.result.status}")
            except REFUSALS as error:
                self.failures.append(f"{name}: {error}")
        return None


# --- what is made finer ---------------------------------------------------------------------------


def _meshes(runs: _Runs) -> Varied:
    scene = runs.study.scene
    if scene.structure is not None:
        return "[structure] has matrices, and not the mesh that they are of"
    finer = {
        f"a mesh {factor:g} times finer": finer_mesh(scene, factor)
        for factor in ((1.5, 2.0) if _even(scene) else (2.0, 3.0))
    }
    scenes = {name: found for name, found in finer.items() if found is not None}
    if not scenes:
        return (
            "mesh.file is one mesh; solve states its part by mesh.coarser, and "
            "fc.grid_convergence compares several"
        )
    formal = TIP if runs.study.structure.n_pairs else CLAMP
    counts = (None,) * (1 + len(scenes))
    return runs.part("mesh", scenes, counts, formal, highest=2.0 * scene.mesh.order)


def _even(scene: Scene) -> bool:
    """Return True if a mesh 1.5 times finer is of the same kind: not where elements along a crack
    face, rounded up, are many more than that."""
    if scene.mesh.layout != "graded":
        return False
    finer, lips = finer_mesh(scene, 1.5), scene.mesh.lip_elements
    return finer is None or lips is None or finer.mesh.given("lip_elements") <= 1.56 * lips


def _modes(runs: _Runs) -> Varied:
    study, kept = runs.study, _kept_modes(runs.study)
    if isinstance(kept, str):
        return kept
    return runs.more(study, study.scene, study.scene.modes_key, *kept, 1.0)


def _kept_modes(study: Study) -> tuple[int, int] | str:
    """Return how many modes are kept, of how many; or the reason why they cannot be varied."""
    kept = reduction_of(study.scene, study.structure)
    if study.scene.disk is not None:
        return study.scene.disk.families, study.structure.n_dofs // study.scene.disk.sectors
    if kept is None:
        return "the structure is not reduced"
    most = study.structure.n_dofs - study.structure.n_pairs
    return "all are kept" if kept.modes >= most else (kept.modes, most)


def _harmonics(runs: _Runs) -> Varied:
    scene, own = runs.study.scene, runs.own
    table = scene.harmonic_balance
    if own.contact is None:
        return "without contact there is one"
    if table.samples is not None:  # enough for all of them
        least = 4 * COUNTS[-1] * table.harmonics + 1
        scene = scene.replace({"harmonic_balance.samples": max(table.samples, least)})
    elif runs.exact is not None:
        return by_orbit(own, own.result, runs.numbers.mode, runs.exact)
    key = "harmonic_balance.harmonics"
    return runs.more(own, scene, key, table.harmonics, MAX_SAMPLES, 1.0)


def _samples(runs: _Runs) -> Varied:
    scene, law = runs.study.scene, runs.study.contact
    table = scene.harmonic_balance
    if law is None:
        return "without contact there are none"
    if table.samples is None and is_unilateral(law):
        return "contact is integrated exactly"
    count = table.samples or default_samples(table.harmonics)
    return runs.more(runs.own, scene, "harmonic_balance.samples", count, MAX_SAMPLES, 2.0)


VARIED_CAUSES: dict[str, Callable[[_Runs], Varied]]
VARIED_CAUSES = {"mesh": _meshes, "modes": _modes, "harmonics": _harmonics, "samples": _samples}
"""Functions that vary each cause."""


# --- what follows from runs -----------------------------------------------------------------------


def _carried(
    own: Run[PeriodicSolution], numbers: Numbers, by_mesh: Mapping[str, GridConvergence]
) -> dict[str, GridConvergence]:
    """Return the change of each number due to the shift of the resonance: the largest at any within
    its uncertainty, as peaks may lie there, and where it is extrapolated to (collective)."""
    at, resonance = numbers.values[numbers.resonance], by_mesh[numbers.resonance]
    known, error = math.isfinite(resonance.extrapolated), resonance.uncertainty(-1) / at
    softer = -1.0 if known and resonance.extrapolated > at else 1.0
    shifts = [(1.0 + error * part) ** softer for part in (0.5, 1.0)]  # one sought from the other
    if known:
        shifts.append(at / resonance.extrapolated)
    moved = shifted(own, own.result, numbers.mode, shifts)
    parts = {}
    for name, value in numbers.values.items():
        there = [values.get(name, 0.0) for values in moved]
        parts[name] = GridConvergence(
            (resonance.sizes[0], resonance.sizes[-1]),
            (max(there, key=lambda one: abs(one - value)), value),
            behaviour="carried",
            order=resonance.order,
            exponent=resonance.exponent,
            factor=1.0,
            extrapolated=there[-1] if known else math.nan,
        )
    return parts


def _doubtful(name: str, run: Run[PeriodicSolution]) -> dict[str, str]:
    """The verdict by the name of a run, where it is not known to be stable."""
    stability = run.result.stability
    known = stability is None or stability.verdict == "stable"
    return {} if known or stability is None else {name: stability.verdict}
