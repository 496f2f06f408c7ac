"""Verify a scene's numbers by two finer runs for each cause.

Each number is extrapolated with the observed order (:mod:`convergence`). The uncertainty belongs to
the scene's value, the coarsest of three: coarser meshes mostly are outside the asymptotic range.

Theory gives an order for each cause:

- *mesh* with a crack: 1. At distance r from a tip, displacements vary as r^(1/2). So frequencies
  and work converge as the element size h. This holds for elements with both orders, on equal cells
  and on cells graded by a fixed ratio (Strang and Fix, An Analysis of the Finite Element Method,
  1973, chapter 8).
- *mesh* without a crack: 3/2, at a clamp's ends. Williams' equation gives 1.52 for a right angle
  with a held side, nu = 0.3, plane stress.
- *modes*: 1. In a plane w_j^2 is proportional to j. A truncated mode j contributes w^2 / w_j^4 at
  the load frequency w; beyond N modes the sum decays as N^-1.
- *harmonics*: 1. When crack faces hit, velocities jump: the amplitude U_k of harmonic k decays as
  k^-2, and the remainder beyond H harmonics as H^-1. If only forces have kinks, the decay is H^-3,
  but the verification does not rely on this.
- *samples*: 2. N samples of a force with kinks have errors proportional to N^-2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from mpi4py import MPI

from fenics_crack.balance.contact_integrals import default_n_samples
from fenics_crack.basics.errors import MAX_SAMPLES_PER_PERIOD, ConvergenceError
from fenics_crack.basics.progress import prefix_stages
from fenics_crack.errors.case import CAUSE_WITHOUT_CONTACT, Case, solve_again, vary
from fenics_crack.errors.convergence import CLAMP_ORDER, TIP_ORDER, Level, Varied, part_of
from fenics_crack.errors.numbers import accepted_orbit, add_changes, bilinear_of, numbers_of
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import is_unilateral
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import count_elements, has_similar_finer_mesh, refine_scene_or_none
from fenics_crack.study.prepare import (
    REFUSAL_EXCEPTIONS,
    Study,
    modal_reduction_or_none,
    prepare,
    reduce_study,
)
from fenics_crack.study.solve import SolvedStudy, solve_study

REFINEMENT_FACTORS = (1, 2, 4)
"""Factors on the count in the answer and both finer runs."""
SAMPLES_ORDER = 2.0
"""Order of convergence with samples of a force."""
SCENE_CHOICE = "the scene's own choice"


def verify(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Verification:
    """Verify the numbers of a scene's steady vibration and frequencies (collective).

    Mesh, modes, harmonics and samples are refined twice, each cause alone: a graded mesh by 1.5
    and 2 if the result is similar, any further mesh by 2 and 3, counts by 2 and 4. The three values
    f_i of each quantity give the observed order p, the extrapolated value f and the uncertainty
    F abs(f_i - f). The factor of safety F is 1.25 or 3 (:func:`fenics_crack.grid_convergence`;
    Roache 1994, Celik et al. 2008, ASME V&V 20-2009). If the solution has an accepted exact orbit
    and the scene gives no number of samples, the part of harmonics is the distance to the orbit's
    numbers. Friction is judged by exact orbits with and without friction.

    A tolerance in the scene chooses harmonics and modes first. A mesh from a file or matrices is
    not refined, and the result gives the reason. The result lists failed runs, and orbits not known
    to be stable.

    Parameters
    ----------
    scene : Scene
        Scene to solve and verify.
    comm : MPI.Comm
        Ranks that share each mesh.

    Returns
    -------
    Verification
        Part of each cause in each quantity's error, and the total errors.

    Raises
    ------
    InputError
        See :func:`fenics_crack.prepare`.
    ConvergenceError
        The scene itself does not converge.

    Examples
    --------
    >>> verification = fc.verify(scene)
    >>> error = verification.total("amplitude")
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
    """Return a solution's scene with the chosen harmonics and modes.

    If all modes are kept, reduction is off, so a finer mesh keeps all modes, too.
    """
    scene, whole_structure = run.scene, run.structure.whole
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is not None:
        changes["harmonic_balance.tolerance"] = None
        changes["harmonic_balance.harmonics"] = run.result.harmonics
    if scene.disk is not None:
        return scene.replace(changes)
    reduction = modal_reduction_or_none(scene, whole_structure)
    if reduction is None or reduction.n_modes >= whole_structure.n_dofs:
        changes |= {"reduction.method": "off", "reduction.modes": None}
    else:
        changes |= {"reduction.method": reduction.method, "reduction.modes": reduction.n_modes}
    return scene.replace(changes)


def _kept_modes(study: Study) -> tuple[int, int] | str:
    """Return kept and possible mode numbers, or the reason for no variation.

    The numbers for a disk count modes per nodal diameter.
    """
    disk, reduction = study.scene.disk, modal_reduction_or_none(study.scene, study.structure)
    if disk is not None:
        return disk.families, study.structure.n_dofs // disk.sectors
    if reduction is None:
        return "the structure is not reduced"
    max_modes = study.structure.n_dofs - study.structure.n_pairs
    return "all are kept" if reduction.n_modes >= max_modes else (reduction.n_modes, max_modes)


@dataclass(frozen=True)
class _VerifiedCase(Case):
    """Judge each cause of an answer's error by finer runs.

    Attributes
    ----------
    whole_study : Study
        Study of the settled scene (:func:`_settled_scene`), with the whole structure.
    failures : list of str
        Failed finer runs, with reasons.
    verdicts : dict of str to str
        Verdict on stability by run, if the run is not known to be stable.
    """

    whole_study: Study
    failures: list[str] = field(default_factory=list)
    verdicts: dict[str, str] = field(default_factory=dict)

    def note_verdict(self, name: str, run: SolvedStudy) -> None:
        """Add a run's verdict unless the run is known to be stable."""
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
        """Return a cause's part from finer runs (collective).

        Parameters
        ----------
        cause : str
            Cause to judge.
        finer_scenes : sequence of (name, count, scene)
            Finer runs. The count is None for a mesh, to count the elements after meshing.
        count : int
            Count in the answer.
        formal, scheme_order : float
            Orders expected by theory, and of the undisturbed scheme.
        shared_study : Study, optional
            Study with the structure of all runs; None for meshes, to make a structure per run.

        Raises
        ------
        ConvergenceError
            All finer runs fail.
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

        With the answer's structure the search starts from the answer. On a new mesh the load
        frequency keeps the ratio to the resonance. ConvergenceError without a solution.
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
        """Return a finer run's numbers (collective).

        With more modes, the numbers change as between exact orbits if both runs have an accepted
        orbit: with few harmonics, modes above all harmonics seem static.
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
        """Judge a cause by two and four times a key's count (collective).

        No count is above ``max_count``.
        """
        counts = sorted({min(factor * count, max_count) for factor in REFINEMENT_FACTORS})
        name = key.rpartition(".")[2]
        finer_scenes = [
            (f"{finer_count} {name}", finer_count, scene.replace({key: finer_count}))
            for finer_count in counts[1:]
        ]
        return self._judge_by(cause, finer_scenes, count, formal, shared_study=shared_study)

    def mesh(self) -> Varied:
        """Judge the mesh by finer meshes (collective)."""
        scene = self.whole_study.scene
        if scene.structure is not None:
            return "[structure] has matrices, and not the mesh that they are of"
        factors = (1.5, 2.0) if has_similar_finer_mesh(scene) else (2.0, 3.0)
        finer_scenes = [
            (f"a mesh {factor:g} times finer", None, finer_scene)
            for factor in factors
            if (finer_scene := refine_scene_or_none(scene, factor)) is not None
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
        """Judge the mesh's shift of the resonance (collective).

        The part is a number's largest change at up to three shifts: half the resonance's
        uncertainty, all the uncertainty, and the shift to an extrapolated value. Peaks may lie
        between.
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
        """Judge modes by more modes (collective)."""
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
        """Judge harmonics by the exact orbit, or by more harmonics (collective).

        With a given number of samples, more harmonics are always used.
        """
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
        """Judge samples by more samples of the contact force (collective)."""
        scene, law = self.whole_study.scene, self.study.contact
        table, key = scene.harmonic_balance, "harmonic_balance.samples"
        if law is None:
            return "without contact there are none"
        if table.samples is None and is_unilateral(law):
            return "contact is integrated exactly"
        count = table.samples or default_n_samples(table.harmonics)
        return self._judge_by_more(
            "samples", self.study, scene, key, count, MAX_SAMPLES_PER_PERIOD, SAMPLES_ORDER
        )
