"""Solution of a study: harmonic balance as its scene says, with the verdict on its stability."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from mpi4py import MPI

from fenics_crack.balance.block_system import SOLVER_BY_FORM
from fenics_crack.balance.error_report import UNESTIMATED_REPORT
from fenics_crack.balance.harmonic_balance import (
    FIRST_MODE_COUNT,
    mode_counts,
    slide_along_lines,
    solve_linear,
    solve_to_tolerance,
)
from fenics_crack.balance.problem import Problem, check_memory
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.receptance import make_empty_receptance_list, receptance
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import MAX_MODES_FOR_MONODROMY
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import rows_requested
from fenics_crack.study.prepare import FEW_DOFS, Study, prepare, reduced, reduction_of


@dataclass(frozen=True, repr=False)
class Solved(Study):
    """A study with its solution, which may not have converged."""

    result: PeriodicSolution


def _solved(study: Study, found: PeriodicSolution) -> Solved:
    return Solved(study.scene, study.structure, study.contact, study.watched, found)


def solve_prepared(
    whole: Study, initial: PeriodicSolution | None = None, omega: float | None = None
) -> Solved:
    """Solve a study for its steady vibration; it is reduced first, if its modes are chosen
    (collective).

    Without a tolerance it is sought from a solution of the same structure, if there is one, and
    at another frequency than the scene's, if that is given.
    """
    rows_requested(whole)  # before anything is solved: it may be refused
    scene, law = whole.scene, whole.contact
    omega, table = omega or scene.excitation.omega, scene.harmonic_balance
    if law is None:
        study = reduced(whole)
        linear = solve_linear(study.structure, omega, harmonics=table.harmonics)
        return _solved(study, linear)
    if table.tolerance is None:
        study = with_lines(reduced(whole), omega)
        law = study.contact
        assert law is not None
        check_memory(study.structure, table.harmonics)
        problem = Problem(study.structure, omega, law, table.harmonics, table.samples)
        solver = SOLVER_BY_FORM[table.form](problem, throw=False)
        solution = solver.solve(initial)
        solution = solution if table.error else solution.reported(UNESTIMATED_REPORT)
    else:
        smallest_structure = next(with_more_modes(whole)).structure  # kept
        whole = replace(whole, contact=slide_along_lines(smallest_structure, omega, law))
        study, solution = _solve_to_tolerance(whole)
    structure = study.structure
    quick = is_piecewise_linear(law) or structure.n_dofs <= FEW_DOFS  # else it takes minutes
    if is_rigid(law):
        quick = structure.light_lips
    if solution.converged and quick and is_small(structure) and table.error:
        begin("stability")
        solution = replace(solution, stability=floquet(structure, solution))
    return _solved(study, solution)


def whole_study(source: Scene | Study, comm: MPI.Comm) -> Study:
    """Return a scene prepared but not reduced; a study as it is (collective)."""
    return source if isinstance(source, Study) else prepare(source, comm, whole=True)


def required_law(study: Study) -> ContactLaw:
    """Return the contact law of a study; InputError if it has none."""
    if study.contact is None:
        if study.scene.structure is not None:
            requirement = "given for this command: the path of a Matrix Market file"
            raise InputError("structure.gap", None, requirement)
        # The crack of a file is no table.
        table_name = "contact" if study.scene.mesh.layout == "file" else "crack"
        raise InputError(table_name, None, "given for this command: a table")
    return study.contact


def with_lines(study: Study, omega: float) -> Study:
    """Return a study with friction of a solid along lines (collective).

    Along them pairs slide without friction at a frequency [rad/s].
    """
    if study.contact is None:
        return study
    return replace(study, contact=slide_along_lines(study.structure, omega, study.contact))


def _solve_to_tolerance(whole: Study) -> tuple[Study, PeriodicSolution]:
    """The solution to the tolerance, and its study with the modes that it takes."""
    scene, table, studies = whole.scene, whole.scene.harmonic_balance, list[Study]()
    law = whole.contact
    assert law is not None

    def structures() -> Iterator[Structure]:
        for study in with_more_modes(whole):
            studies.append(study)
            yield study.structure

    problem = Problem(whole.structure, scene.excitation.omega, law, table.harmonics)
    solution = solve_to_tolerance(
        Solver(problem, throw=False),
        table.given("tolerance"),
        structures=structures(),
        modes_key=scene.modes_key,
    )
    return next(study for study in studies if study.structure is solution.structure), solution


# --- how many modes -------------------------------------------------------------------------------


MOST_OF_MANY = 40
"""Most modes that a tolerance chooses for a curve or a sweep: with twice as many a curve takes four
times as long."""


def modes_chosen(study: Study, most: int = MAX_MODES_FOR_MONODROMY) -> list[int]:
    """Numbers of modes among which a study's tolerance chooses, from few on; none where the scene
    says how many, has no tolerance, or is not reduced (collective)."""
    scene, whole = study.scene, study.structure
    if whole.whole is not whole:
        return []
    kept, table = reduction_of(scene, whole), scene.reduction
    given = scene.disk is not None or (table is not None and table.modes is not None)
    if kept is None or given or scene.harmonic_balance.tolerance is None or study.contact is None:
        return []
    of_file = not whole.has_matrices
    large = kept.method == "massless" and (of_file or not is_small(whole))
    if of_file:  # which holds so many and their reference
        most = min(most, len(whole.compute_once(make_empty_receptance_list)[0].squares) // 2)
    return mode_counts(whole, FIRST_MODE_COUNT if large else kept.modes, most)


def reduced_to(whole: Study, modes: int) -> Study:
    """A study with so many modes (collective)."""
    kept = reduction_of(whole.scene, whole.structure)
    keys = {"reduction.method": kept and kept.method, "reduction.modes": modes}
    return reduced(replace(whole, scene=whole.scene.replace(keys)))


def with_more_modes(whole: Study, most: int = MAX_MODES_FOR_MONODROMY) -> Iterator[Study]:
    """A study with the numbers of modes among which its tolerance chooses, each reduced when it is
    needed; else once, as its scene says (collective).

    Few modes, and twice as many, are found together with those of their references: one after the
    other they take two more factors, and of a plate 67 steps beside 106. At a tolerance of 1 % six
    of ten plates took the second number or more.
    """
    chosen, structure = modes_chosen(whole, most), whole.structure
    if chosen[:1] == [FIRST_MODE_COUNT] and structure.has_matrices:
        receptance(structure, min(4 * FIRST_MODE_COUNT, structure.n_dofs - structure.n_pairs))
    yield from (reduced_to(whole, modes) for modes in chosen)
    if not chosen:
        yield reduced(whole)
