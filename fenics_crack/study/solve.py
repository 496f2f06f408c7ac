"""Solution of a study: harmonic balance as its scene says, with the verdict on its stability."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fenics_crack.balance.block_system import FORMS
from fenics_crack.balance.error_report import NOT_ESTIMATED
from fenics_crack.balance.harmonic_balance import FIRST_MODES, solve_linear, solve_to_tolerance
from fenics_crack.balance.problem import Problem, check_memory
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.progress import begin
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.receptance import receptance
from fenics_crack.model.structure import Structure
from fenics_crack.study.observer import rows_requested
from fenics_crack.study.prepare import FEW_DOFS, Study, reduced, reduction_of

MODES_AT_ONCE = 4 * FIRST_MODES
"""Modes of a large structure that are found together, those of the first two attempts with their
references. One after the other they take two more factors, and 67 steps beside 106 of a plate;
of ten plates with a tolerance of 1 % six took the second attempt, or more."""


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
        study = reduced(whole)
        check_memory(study.structure, table.harmonics)
        problem = Problem(study.structure, omega, law, table.harmonics, table.samples)
        solver = FORMS[table.form](problem, throw=False)
        solution = solver.solve(initial)
        solution = solution if table.error else solution.reported(NOT_ESTIMATED)
    else:
        study, solution = _solve_to_tolerance(whole, law)
    structure = study.structure
    quick = is_piecewise_linear(law) or structure.n_dofs <= FEW_DOFS  # else it takes minutes
    if is_rigid(law):
        quick = structure.light_lips
    if solution.converged and quick and is_small(structure) and table.error:
        begin("stability")
        solution = replace(solution, stability=floquet(structure, solution))
    return _solved(study, solution)


def _solve_to_tolerance(whole: Study, law: ContactLaw) -> tuple[Study, PeriodicSolution]:
    """The solution to the tolerance, and its study with the modes that it takes."""
    scene, structure, table = whole.scene, whole.structure, whole.scene.harmonic_balance
    first, tolerance = reduction_of(scene, structure), table.given("tolerance")
    problem = Problem(structure, scene.excitation.omega, law, table.harmonics)
    chosen = scene.reduction is not None and scene.reduction.modes is not None
    if first is None or chosen or scene.disk is not None:
        study = reduced(whole)
        problem = replace(problem, structure=study.structure)
        solver = Solver(problem, throw=False)
        return study, solve_to_tolerance(solver, tolerance, modes_key=scene.modes_key)
    studies: list[Study] = []

    def reduced_to(modes: int) -> Structure:
        kept = {"reduction.method": first.method, "reduction.modes": modes}
        studies.append(reduced(replace(whole, scene=scene.replace(kept))))
        return studies[-1].structure

    large = first.method == "massless" and not is_small(structure)
    modes = FIRST_MODES if large else first.modes
    if large and structure.stiffness is not None:
        receptance(structure, min(MODES_AT_ONCE, structure.n_dofs - structure.n_pairs))
    solver = Solver(problem, throw=False)
    found = solve_to_tolerance(
        solver, tolerance, reduced_to=reduced_to, modes=modes, modes_key=scene.modes_key
    )
    return next(study for study in studies if study.structure is found.structure), found
