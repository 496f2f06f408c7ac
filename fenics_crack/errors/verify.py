"""Verification of a scene's numbers: two finer runs for each cause.

Each number is extrapolated with the order that it shows (:mod:`convergence`). The uncertainty is
that of the scene's own choice, the coarsest of the three: coarser meshes mostly are not in the
asymptotic range.

Orders of theory: at the tip of a crack displacements are like r^(1/2), so frequencies and work
converge like h with elements of both orders, on equal cells and on cells graded by a fixed ratio
(Strang and Fix, An Analysis of the Finite Element Method, 1973, chapter 8). At the ends of a clamp
they converge like h^(3/2) (Williams' equation for a right angle with one side held, nu = 0.3, plane
stress: 1.52). Modes in a plane have w_j^2 proportional to j, and each that is left out contributes
w^2 / w_j^4, which sums up to N^-1. Where crack faces hit each other velocities jump: |U_k| falls
like k^-2 and the remainder like H^-1. It often falls faster (H^-3 where only forces have kinks),
which is not relied on. Samples of a force with kinks err like N^-2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from mpi4py import MPI

from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.basics.errors import MAX_SAMPLES_PER_PERIOD, ConvergenceError
from fenics_crack.basics.progress import prefix_stages
from fenics_crack.errors.case import CAUSE_WITHOUT_CONTACT, Case, solve_again, vary
from fenics_crack.errors.convergence import CLAMP_ORDER, TIP_ORDER, Level, Varied, part_of
from fenics_crack.errors.numbers import accepted_orbit, add_changes, bilinear_of, numbers_of
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import is_unilateral
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import can_refine_evenly, count_elements, refine_scene
from fenics_crack.study.prepare import (
    REFUSAL_EXCEPTIONS,
    Study,
    prepare,
    reduce_study,
    reduction_of,
)
from fenics_crack.study.solve import SolvedStudy, solve_study

REFINEMENT_FACTORS = (1, 2, 4)
"""Factors of counts in the answer and in both finer runs."""
SAMPLES_ORDER = 2.0
"""Order of convergence with samples of a force."""
SCENE_CHOICE = "the scene's own choice"


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
    with prefix_stages(SCENE_CHOICE):
        whole_study = prepare(scene, comm, whole=True)
        run = solve_study(whole_study)
        if scene.harmonic_balance.tolerance is not None and run.result.converged:
            run = solve_study(replace(run, scene=_settled_scene(run)), run.result)
    answer = run.result
    if not answer.converged:
        raise ConvergenceError(f"{SCENE_CHOICE}: {answer.status}")
    whole_study = replace(whole_study, scene=_settled_scene(run))
    numbers = numbers_of(run, answer)
    case = _VerifiedCase(run, answer, numbers.values, answer, numbers, whole_study)
    case.note_verdict(SCENE_CHOICE, run)
    errors = Verification(whole_study.scene, numbers.values, numbers.units)
    errors = vary(errors, {"mesh": case.mesh})
    causes: dict[str, Callable[[], Varied]] = {
        "shift": partial(case.shift, errors),
        "modes": case.modes,
        "harmonics": case.harmonics,
        "samples": case.samples,
        "friction": case.friction,
    }
    errors = vary(errors, causes)
    return replace(errors, failures=tuple(case.failures), verdicts=case.verdicts)


def _settled_scene(run: SolvedStudy) -> Scene:
    """Return the scene of a solution with what was chosen for it.

    If all modes are kept, it is not reduced, so that none is left out on a finer mesh.
    """
    scene, whole_structure = run.scene, run.structure.whole
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is not None:
        changes["harmonic_balance.tolerance"] = None
        changes["harmonic_balance.harmonics"] = run.result.harmonics
    if scene.disk is not None:
        return scene.replace(changes)
    reduction = reduction_of(scene, whole_structure)
    if reduction is None or reduction.n_modes >= whole_structure.n_dofs:
        changes |= {"reduction.method": "off", "reduction.modes": None}
    else:
        changes |= {"reduction.method": reduction.method, "reduction.modes": reduction.n_modes}
    return scene.replace(changes)


def _kept_modes(study: Study) -> tuple[int, int] | str:
    """Return kept and possible numbers of modes, or why they are not varied."""
    disk, reduction = study.scene.disk, reduction_of(study.scene, study.structure)
    if disk is not None:
        return disk.families, study.structure.n_dofs // disk.sectors
    if reduction is None:
        return "the structure is not reduced"
    max_modes = study.structure.n_dofs - study.structure.n_pairs
    return "all are kept" if reduction.n_modes >= max_modes else (reduction.n_modes, max_modes)


@dataclass(frozen=True)
class _VerifiedCase(Case):
    """Answer whose causes are each judged by finer runs.

    Attributes
    ----------
    whole_study : Study
        Settled scene with its whole structure.
    failures : list of str
        Finer runs that failed.
    verdicts : dict of str to str
        Verdicts of runs that are not known to be stable.
    """

    whole_study: Study
    failures: list[str] = field(default_factory=list)
    verdicts: dict[str, str] = field(default_factory=dict)

    def note_verdict(self, name: str, run: SolvedStudy) -> None:
        """Add the verdict of a run if it is not known to be stable."""
        stability = run.result.stability
        if stability is not None and stability.verdict != "stable":
            self.verdicts[name] = stability.verdict

    def _judge_by(
        self,
        cause: str,
        finer_scenes: Sequence[tuple[str, int | None, Scene]],
        count: int,
        formal: float,
        *,
        shared_study: Study | None = None,
        scheme_order: float = math.inf,
    ) -> Varied:
        """Return the part of a cause by finer runs (collective).

        Parameters
        ----------
        cause : str
        finer_scenes : sequence of (name, count, scene)
            The count is None of a mesh, whose elements are counted when it is made.
        count : int
            That of the answer.
        formal, scheme_order : float
            Orders of theory, and of the scheme.
        shared_study : Study, optional
            Study of all runs but those of a mesh.
        """
        levels: list[Level] = [(count, self.numbers.values)]
        for name, finer_count, scene in reversed(finer_scenes):  # few modes are among many
            with prefix_stages(name):
                try:
                    run = self._run(scene, shared_study)
                except REFUSAL_EXCEPTIONS as error:
                    self.failures.append(f"{name}: {error}")
                    continue
            level = finer_count or count_elements(run.structure), self._run_values(run, cause)
            levels.insert(1, level)
            self.note_verdict(name, run)
        if len(levels) == 1:
            raise ConvergenceError(cause)
        if len({level_count for level_count, _ in levels}) < len(levels):
            return "finer ones have as many elements, as mesh.size is that of the plate"
        return part_of(
            cause, levels, self.whole_study.scene, formal=formal, scheme_order=scheme_order
        )

    def _run(self, scene: Scene, shared_study: Study | None) -> SolvedStudy:
        """Solve a finer scene (collective).

        It begins at the answer if it shares its structure. On another mesh the load is as far from
        the resonance of a mode.
        """
        study, mode = self.study, self.numbers.mode
        initial, omega = self.answer if shared_study is study else None, self.answer.omega
        if shared_study is not None:
            finer_study = reduce_study(replace(shared_study, scene=scene), with_reference=False)
        else:
            finer_study = prepare(scene, study.structure.comm, judged=False)
            omega *= bilinear_of(finer_study.structure, mode) / bilinear_of(study.structure, mode)
        run = solve_study(finer_study, initial, omega)
        if not run.result.converged:
            raise ConvergenceError(run.result.status)
        return run

    def _run_values(self, run: SolvedStudy, cause: str) -> dict[str, float]:
        """Return the numbers of a finer run (collective).

        With more modes they change as exact orbits do, if both runs have their own: to few
        harmonics the modes above all of them seem static.
        """
        if cause == "modes" and self.orbit_values is not None:
            orbit = accepted_orbit(run.result)
            if orbit is not None:
                orbit_values = self.compute_values(orbit, run)
                return add_changes(self.numbers.values, self.orbit_values, orbit_values)
        return self.compute_values(run.result, run)

    def _judge_by_more(
        self,
        cause: str,
        shared_study: Study,
        scene: Scene,
        key: str,
        count: int,
        max_count: int,
        formal: float,
    ) -> Varied:
        """Judge by twice and four times the count of a key (collective)."""
        counts = sorted({min(factor * count, max_count) for factor in REFINEMENT_FACTORS})
        name = key.rpartition(".")[2]
        finer_scenes = [
            (f"{finer_count} {name}", finer_count, scene.replace({key: finer_count}))
            for finer_count in counts[1:]
        ]
        return self._judge_by(cause, finer_scenes, count, formal, shared_study=shared_study)

    def mesh(self) -> Varied:
        """Judge by finer meshes (collective)."""
        scene = self.whole_study.scene
        if scene.structure is not None:
            return "[structure] has matrices, and not the mesh that they are of"
        factors = (1.5, 2.0) if can_refine_evenly(scene) else (2.0, 3.0)
        finer_scenes = [
            (f"a mesh {factor:g} times finer", None, finer_scene)
            for factor in factors
            if (finer_scene := refine_scene(scene, factor)) is not None
        ]
        if not finer_scenes:
            return (
                "mesh.file is one mesh; solve states its part by mesh.coarser, and "
                "fc.grid_convergence compares several"
            )
        formal = TIP_ORDER if self.whole_study.structure.n_pairs else CLAMP_ORDER
        count, scheme_order = count_elements(self.study.structure), 2.0 * scene.mesh.order
        return self._judge_by("mesh", finer_scenes, count, formal, scheme_order=scheme_order)

    def shift(self, errors: Verification) -> Varied:
        """Judge by the mesh's shift of the resonance (collective).

        The part is the largest change of a number at three shifts: half of the resonance's
        uncertainty, all of it, and the shift to the extrapolated value. Peaks may lie between.
        """
        if "mesh" not in errors.parts:
            return ""
        counts, resonance = errors.counts["mesh"], errors.parts["mesh"][self.numbers.resonance]
        frequency = self.numbers.values[self.numbers.resonance]
        relative_error = resonance.uncertainty(-1) / frequency
        is_extrapolated = math.isfinite(resonance.extrapolated)
        rises = is_extrapolated and resonance.extrapolated > frequency
        exponent = -1.0 if rises else 1.0
        factors = [(1.0 + relative_error * fraction) ** exponent for fraction in (0.5, 1.0)]
        if is_extrapolated:
            factors.append(frequency / resonance.extrapolated)
        solution, numbers_by_shift = self.answer, []
        for factor in factors:  # each is sought from the one before
            omega = self.answer.omega * factor
            solution = solve_again(self.study, omega, self.answer.harmonics, solution)
            numbers_by_shift.append(self.compute_values(solution))
        parts = {}
        for name, value in self.numbers.values.items():
            values = [numbers.get(name, 0.0) for numbers in numbers_by_shift]
            extreme_number = max(values, key=lambda candidate: abs(candidate - value))
            parts[name] = replace(
                resonance,
                sizes=(resonance.sizes[0], resonance.sizes[-1]),
                factor=1.0,
                values=(extreme_number, value),
                behaviour="carried",
                extrapolated=values[-1] if is_extrapolated else math.nan,
            )
        return counts[:: len(counts) - 1], parts

    def modes(self) -> Varied:
        """Judge by more modes (collective)."""
        whole_study, kept_modes = self.whole_study, _kept_modes(self.whole_study)
        if isinstance(kept_modes, str):
            return kept_modes
        return self._judge_by_more(
            "modes",
            whole_study,
            whole_study.scene,
            whole_study.scene.modes_key,
            *kept_modes,
            TIP_ORDER,
        )

    def harmonics(self) -> Varied:
        """Judge by the exact orbit, or by more harmonics (collective)."""
        scene = self.whole_study.scene
        table = scene.harmonic_balance
        if self.study.contact is None:
            return CAUSE_WITHOUT_CONTACT
        if table.samples is not None:  # enough for all of them
            min_samples = 4 * REFINEMENT_FACTORS[-1] * table.harmonics + 1
            samples = max(table.samples, min_samples)
            scene = scene.replace({"harmonic_balance.samples": samples})
        elif self.orbit_values is not None:
            return self.distance_to_orbit(self.orbit_values)
        key = "harmonic_balance.harmonics"
        return self._judge_by_more(
            "harmonics", self.study, scene, key, table.harmonics, MAX_SAMPLES_PER_PERIOD, TIP_ORDER
        )

    def samples(self) -> Varied:
        """Judge by more samples of the contact force (collective)."""
        scene, law = self.whole_study.scene, self.study.contact
        table, key = scene.harmonic_balance, "harmonic_balance.samples"
        if law is None:
            return "without contact there are none"
        if table.samples is None and is_unilateral(law):
            return "contact is integrated exactly"
        count = table.samples or default_samples(table.harmonics)
        return self._judge_by_more(
            "samples", self.study, scene, key, count, MAX_SAMPLES_PER_PERIOD, SAMPLES_ORDER
        )
