"""Solution of a study by harmonic balance, with the verdict on its stability."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from mpi4py import MPI

from fenics_crack.balance.block_system import BALANCE_SOLVER_CLASS_BY_FORM
from fenics_crack.balance.error_report import UNESTIMATED_REPORT
from fenics_crack.balance.harmonic_balance import (
    FIRST_MODE_COUNT,
    mode_counts_to_try,
    slide_along_lines,
    solve_linear,
    solve_to_tolerance,
)
from fenics_crack.balance.problem import Problem, check_memory
from fenics_crack.balance.solution import HarmonicBalanceSolver, PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.receptance import make_receptance_cache, receptance
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import MAX_MODES_FOR_MONODROMY
from fenics_crack.scene.keys import missing_table_error
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import make_requested_rows_and_readers
from fenics_crack.study.prepare import (
    MAX_DOFS_UNREDUCED_BY_DEFAULT,
    Study,
    modal_reduction_or_none,
    prepare,
    reduce_study,
)


@dataclass(frozen=True, repr=False)
class SolvedStudy(Study):
    """A study with its periodic solution ``result``, which may not have converged."""

    result: PeriodicSolution


def _make_solved_study(study: Study, solution: PeriodicSolution) -> SolvedStudy:
    """Return the solved study, with all data of ``study`` and its periodic solution."""
    return SolvedStudy(study.scene, study.structure, study.contact, study.watched, solution)


def solve_study(
    study: Study, initial_solution: PeriodicSolution | None = None, omega: float | None = None
) -> SolvedStudy:
    """Solve a study for its steady vibration, reduced as its scene says (collective).

    If the scene gives a tolerance but no number of modes, the number is chosen. If the solution
    converges and the structure is small, its stability is computed, too. It is left out if it would
    take long, as with a smooth contact law, or if the scene requests no error.

    Parameters
    ----------
    study : Study
        Unreduced or reduced study.
    initial_solution : PeriodicSolution, optional
        Initial guess on the same structure; ignored with a tolerance or without contact.
    omega : float, optional [rad/s]
        Load frequency in place of the scene's. With a tolerance, it only sets the directions of
        friction.

    Returns
    -------
    SolvedStudy
        The study, reduced, with the solution.
    """
    make_requested_rows_and_readers(study)  # before anything is solved: this may raise InputError
    scene, law = study.scene, study.contact
    omega, balance_table = omega or scene.excitation.omega, scene.harmonic_balance
    if law is None:
        reduced_study = reduce_study(study)
        solution = solve_linear(reduced_study.structure, omega, harmonics=balance_table.harmonics)
        return _make_solved_study(reduced_study, solution)
    if balance_table.tolerance is None:
        reduced_study = with_fixed_slip_directions(reduce_study(study), omega)
        law = reduced_study.contact
        assert law is not None
        check_memory(reduced_study.structure, balance_table.harmonics)
        n_harmonics, n_samples = balance_table.harmonics, balance_table.samples
        problem = Problem(reduced_study.structure, omega, law, n_harmonics, n_samples)
        solver = BALANCE_SOLVER_CLASS_BY_FORM[balance_table.form](problem, throw=False)
        solution = solver.solve(initial_solution)
        solution = solution if balance_table.error else solution.reported(UNESTIMATED_REPORT)
    else:
        smallest_structure = next(iterate_studies_with_more_modes(study)).structure  # reused below
        study = replace(study, contact=slide_along_lines(smallest_structure, omega, law))
        reduced_study, solution = _solve_to_tolerance(study)
    structure = reduced_study.structure
    # The verdict of other structures takes minutes.
    is_stability_quick = (
        is_piecewise_linear(law) or structure.n_dofs <= MAX_DOFS_UNREDUCED_BY_DEFAULT
    )
    if is_rigid(law):
        is_stability_quick = structure.has_massless_crack_faces
    if solution.converged and is_stability_quick and is_small(structure) and balance_table.error:
        begin_stage("stability")
        solution = replace(solution, stability=floquet(structure, solution))
    return _make_solved_study(reduced_study, solution)


def prepare_unreduced_if_scene(scene_or_study: Scene | Study, comm: MPI.Comm) -> Study:
    """Prepare a scene without reduction; return a study as it is (collective)."""
    return (
        scene_or_study
        if isinstance(scene_or_study, Study)
        else prepare(scene_or_study, comm, whole=True)
    )


def required_contact_law(study: Study) -> ContactLaw:
    """Return a study's contact law; InputError without a crack."""
    if study.contact is None:
        if study.scene.structure is not None:
            requirement_text = "given: the path of a Matrix Market file, which this command needs"
            raise InputError("structure.gap", None, requirement_text)
        # The crack of a file is no table.
        table_name = "contact" if study.scene.mesh.layout == "file" else "crack"
        raise missing_table_error(table_name, ", which this command needs")
    return study.contact


def with_fixed_slip_directions(study: Study, omega: float) -> Study:
    """Return a study with friction along a fixed line at each pair (collective).

    Exact orbits need friction along a line, not in a plane. Only a solid with friction changes. A
    pair's line is the direction in which the pair slides if there is no friction, at the load
    frequency ``omega`` [rad/s].
    """
    if study.contact is None:
        return study
    return replace(study, contact=slide_along_lines(study.structure, omega, study.contact))


def _solve_to_tolerance(unreduced_study: Study) -> tuple[Study, PeriodicSolution]:
    """Solve an unreduced study to its scene's tolerance (collective).

    Return the study reduced to the number of modes used, and the solution.
    """
    scene, law = unreduced_study.scene, unreduced_study.contact
    assert law is not None
    reduced_studies = list[Study]()

    def iterate_structures() -> Iterator[Structure]:
        """Yield structures with more and more modes; keep the studies in ``reduced_studies``."""
        for study in iterate_studies_with_more_modes(unreduced_study):
            reduced_studies.append(study)
            yield study.structure

    problem = Problem(
        unreduced_study.structure, scene.excitation.omega, law, scene.harmonic_balance.harmonics
    )
    solution = solve_to_tolerance(
        HarmonicBalanceSolver(problem, throw=False),
        scene.harmonic_balance.given("tolerance"),
        structures=iterate_structures(),
        modes_key=scene.modes_key,
    )
    return next(
        study for study in reduced_studies if study.structure is solution.structure
    ), solution


# --- how many modes -------------------------------------------------------------------------------


MAX_MODES_FOR_MANY_SOLUTIONS = 40
"""Maximum number of modes that a tolerance chooses for a curve or a sweep. With twice as many, a
curve takes four times as long."""


def candidate_mode_counts(study: Study, max_modes: int = MAX_MODES_FOR_MONODROMY) -> list[int]:
    """Return the numbers of modes to try for a tolerance, ascending (collective).

    Each number doubles the last, up to ``max_modes``. The list is empty

    - if the scene gives the number of modes, or has no tolerance or no crack;
    - if the structure is reduced already, or shall not be reduced.
    """
    scene, structure = study.scene, study.structure
    if structure.whole is not structure:
        return []
    reduction, reduction_table = modal_reduction_or_none(scene, structure), scene.reduction
    has_given_modes = scene.disk is not None or (
        reduction_table is not None and reduction_table.modes is not None
    )
    if (
        reduction is None
        or has_given_modes
        or scene.harmonic_balance.tolerance is None
        or study.contact is None
    ):
        return []
    is_from_file = not structure.has_matrices
    is_large = reduction.method == "massless" and (is_from_file or not is_small(structure))
    if is_from_file:  # the file has twice as many modes: those of the reference
        max_modes = min(
            max_modes, len(structure.compute_once(make_receptance_cache)[0].squares) // 2
        )
    return mode_counts_to_try(
        structure, FIRST_MODE_COUNT if is_large else reduction.n_modes, max_modes
    )


def reduce_to_modes(study: Study, n_modes: int) -> Study:
    """Reduce a study to ``n_modes`` modes, with the method of its scene (collective)."""
    reduction = modal_reduction_or_none(study.scene, study.structure)
    changes = {"reduction.method": reduction and reduction.method, "reduction.modes": n_modes}
    return reduce_study(replace(study, scene=study.scene.replace(changes)))


def iterate_studies_with_more_modes(
    study: Study, max_modes: int = MAX_MODES_FOR_MONODROMY
) -> Iterator[Study]:
    """Yield a study reduced to more and more modes, on demand (collective).

    The numbers of modes are those of :func:`candidate_mode_counts`, up to ``max_modes``. If that
    list is empty, the study is reduced once, as the scene says.

    The modes for the first two numbers, with their reference structures, are computed together.
    Computed separately, they take two more factorizations, and for a plate 173 instead of 106 steps
    of the eigensolver. At a tolerance of 1 %, six of ten plates needed the second number or more.
    """
    candidate_counts, structure = candidate_mode_counts(study, max_modes), study.structure
    if candidate_counts[:1] == [FIRST_MODE_COUNT] and structure.has_matrices:
        receptance(structure, min(4 * FIRST_MODE_COUNT, structure.n_dofs - structure.n_pairs))
    yield from (reduce_to_modes(study, n_modes) for n_modes in candidate_counts)
    if not candidate_counts:
        yield reduce_study(study)
