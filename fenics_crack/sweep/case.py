"""The cases of one geometry of a sweep: the structure that they share, and the solutions."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import (
    lacks_modes,
    slide_along_lines,
    solve_beside,
    solve_linear,
)
from fenics_crack.balance.problem import Problem, check_memory
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import with_frequency
from fenics_crack.curves.follow import continue_frequency
from fenics_crack.curves.resonance import resonance_at
from fenics_crack.curves.stability import floquet
from fenics_crack.fem.setting import clearance_of, force_vector_by_part
from fenics_crack.model.contact import is_rigid, is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import FREQUENCY_KIND_NAMES, BilinearFrequencies, bilinear_frequencies
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import rows_of
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import FORCES
from fenics_crack.study.observer import rows_requested
from fenics_crack.study.plausibility import damping_ratios
from fenics_crack.study.prepare import REFUSALS, Study, law_of, prepare, reduced
from fenics_crack.study.solve import MOST_OF_MANY, modes_chosen, reduced_to
from fenics_crack.sweep.file import AT_POINTS, PHASES, UNSURE, YET, of_load
from fenics_crack.sweep.plan import Chunk


@dataclass(frozen=True)
class Asked:
    """Request for the cases of a sweep.

    Attributes
    ----------
    unit_loads : bool
        True if geometries are built with unit loads.
    hopeless : bool
        True if a structure that stays large ends the sweep.
    at_resonance : bool
        True if each case is solved at its resonance.
    verdicts : bool
        True if the stability of each case is assessed.
    judged : bool
        True if the error of the reduction is.
    natural : tuple of bool
        For each place on the last axis, True if natural frequencies alone are found there.
    """

    unit_loads: bool
    hopeless: bool = False
    at_resonance: bool = False
    verdicts: bool = True
    judged: bool = True
    natural: tuple[bool, ...] = (False,)


@dataclass(frozen=True)
class Geometry:
    """Common part of cases that differ in load, clearance, law and harmonics only.

    Attributes
    ----------
    study : Study
        With a small structure without clearance.
    unit_loads : bool
        True if its load has a sine part of 1 N in x, a cosine part of 1 N in y and, of a solid, a
        mean of 1 N in z.
    crack_length : float [m]
        Of the first crack; nan where it is unknown.
    natural : BilinearFrequencies
        With the crack open and bonded.
    watched : dict of str to (n_dofs,)
        Factors of the coordinates in the motion of the named points [m], by "tip.ux",
        and at the load, by ""; of one load alone its own vector does that.
    whole : Study
        Not reduced.
    modes : tuple of int
        Number of modes, and those that the tolerance may choose instead; empty where it does not
        choose them.
    """

    study: Study
    unit_loads: bool
    crack_length: float
    natural: BilinearFrequencies
    watched: dict[str, np.ndarray]
    whole: Study
    modes: tuple[int, ...] = ()

    @cached_property
    def finer(self) -> Geometry | None:
        """The same with the next number of modes; None where these are the most."""
        if len(self.modes) < 2:
            return None
        study = reduced_to(self.whole, self.modes[1])
        return replace(self, study=study, watched=_watched(study), modes=self.modes[1:])

    @property
    def structure(self) -> Structure:
        """Without clearance."""
        return self.study.structure

    def of_case(self, scene: Scene) -> Structure:
        """The structure with the load and the clearance of a case."""
        load: float | np.ndarray = 1.0
        if self.unit_loads:
            load = np.zeros((len(FORCES), len(FORCES)))
            wanted = np.array([getattr(scene.excitation, name) for name in FORCES])
            load[:, -scene.dimension :] = wanted[:, ::-1]
        of_cracks = clearance_of(scene, self.structure.pairs) if scene.all_cracks else 0.0
        return self.structure.varied(load=load, clearance=of_cracks)


def build(scene: Scene, comm: MPI.Comm, asked: Asked, last: Geometry | None = None) -> Geometry:
    """The geometry of a case, with the reference of its reduction if requested; the mesh of the
    last one serves another speed of the rotor (collective)."""
    scene = scene.replace({f"{name}.clearance": 0.0 for name in scene.all_cracks})
    if asked.unit_loads:
        size = scene.dimension
        units = zip(FORCES, np.eye(len(FORCES), size, size - len(FORCES))[:, ::-1], strict=True)
        scene = scene.replace({f"excitation.{name}": tuple(unit) for name, unit in units})
    whole = prepare(scene, comm, whole=True, like=None if last is None else last.study)
    modes = modes_chosen(whole, MOST_OF_MANY) if asked.judged else []
    # Natural frequencies have no error of their own: they are of many modes.
    every = reduced(whole, judged=asked.judged and not modes)
    structure = every.structure
    if not is_small(structure):
        method = "off" if scene.reduction is None else scene.reduction.method
        allowed = f"one that leaves fewer than {structure.n_dofs} coordinates"
        raise InputError("reduction.method", method, allowed)
    rows_requested(every)
    lengths = [crack.length for crack in every.scene.all_cracks.values()]
    known = lengths[0] if lengths and lengths[0] is not None else np.nan
    natural = bilinear_frequencies(structure)
    study = reduced_to(whole, modes[0]) if modes else every
    rows = _watched(study)
    return Geometry(study, asked.unit_loads, known, natural, rows, whole, tuple(modes))


def with_any_modes(scene: Scene, asked: Asked) -> Iterator[Geometry]:
    """The geometry of a case with each number of modes with which it may have been solved."""
    first = build(scene, MPI.COMM_SELF, asked)
    made: Geometry | None = first
    while made is not None:
        yield made
        made = made.finer
    if first.modes:
        yield build(scene, MPI.COMM_SELF, replace(asked, judged=False))


def _watched(study: Study) -> dict[str, np.ndarray]:
    """The rows of the motion at the load and at the named points (collective)."""
    named = [watched for watched in study.watched if watched.name]
    rows = rows_of(study.structure, [watched.dof for watched in named])
    found = {watched.name: row for watched, row in zip(named, rows, strict=True)}
    return _at_load(study.scene, study.structure) | found


def _at_load(scene: Scene, structure: Structure) -> dict[str, np.ndarray]:
    """Return the rows of the motion watched at the load, where the structure has it; of matrices
    the dof that carries most of the load (collective)."""
    whole = structure.whole
    if whole.watched is not None:
        weights = gather_rows(whole.comm, whole.watched)
    elif scene.structure is not None:
        weights = np.zeros(whole.n_dofs)
        weights[whole.find_most_loaded_dof()] = 1.0
    else:
        return {}
    dofs = np.flatnonzero(weights)
    return {"": weights[dofs] @ rows_of(structure, dofs.tolist())}


# --- a case ---------------------------------------------------------------------------------------


ALONE = "natural frequencies alone"
"""Status of a case for which nothing else is requested."""
Found = dict[str, Any]
"""Values of a case, columns of the file and others, which that does not keep; and "gap" and "force"
coefficients if it converged."""


def solve_chunk(
    geometry: Geometry, chunk: Chunk, asked: Asked, go_on: Callable[[], bool]
) -> list[Found]:
    """Solve cases one after the other, each at its own frequency or at its resonance; with verdicts
    on their stability, if wanted, and with the error of a reduction that has been assessed.

    The first ones where ``go_on``, which is called before each, ends it.
    """
    cases, solved = Cases(geometry), []
    for number, case in zip(chunk.numbers.tolist(), chunk.cases, strict=True):
        if not go_on():
            break
        if isinstance(case, str):
            solved.append({"status": case})
            cases = Cases(geometry)
            continue
        started = time.perf_counter()
        harmonics = case.harmonic_balance.harmonics
        found: Found = {"crack_length": geometry.crack_length, "harmonics": harmonics}
        found |= _at(case.excitation.omega, geometry.natural) | _numbered(geometry.natural)
        if asked.natural[number % len(asked.natural)]:
            solved.append(found | {"status": ALONE, "seconds": time.perf_counter() - started})
            continue
        try:
            solution = cases.found(case, asked)
            tolerance = case.harmonic_balance.tolerance
            while tolerance and lacks_modes(solution, tolerance) and geometry.finer:
                geometry = geometry.finer  # for the cases behind it, too
                cases = Cases(geometry)
                solution = cases.found(case, asked)
            found |= _observed(solution, case, geometry)
            found |= _at(solution.omega, geometry.natural) | solution.to_dict()
            if not asked.judged:
                found.pop("reduction_error")
            if asked.verdicts and case.harmonic_balance.error:
                found |= cases.verdict(solution)
                found["status"] += found.pop("remark", "")
            found |= {"gap": solution.gap_rows, "force": solution.force_rows}
        except REFUSALS as error:
            cases = Cases(geometry)
            found["status"] = str(error)
        solved.append(found | {"seconds": time.perf_counter() - started})
    return solved


class Cases:
    """Cases of a geometry, each solved from the one before.

    Those that differ in the frequency alone share structure, law and equations.
    """

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self._last: Scene | None = None
        self._near: PeriodicSolution | None = None

    def found(self, case: Scene, asked: Asked) -> PeriodicSolution:
        """The solution of a case, or at its resonance, as requested; raises as :meth:`solve`."""
        return self.at_resonance(case) if asked.at_resonance else self.solve(case)

    def solve(self, case: Scene) -> PeriodicSolution:
        """The solution of a case; one of :data:`REFUSALS` where there is none."""
        omega, table = case.excitation.omega, case.harmonic_balance
        self._take(case)
        structure, law = self._structure, self._law
        if law is not None:
            law = slide_along_lines(structure, omega, law)
        if law is None:
            return solve_linear(structure, omega, harmonics=table.harmonics)
        check_memory(structure, table.harmonics)
        problem = Problem(structure, omega, law, table.harmonics, table.samples)
        near, self._near = self._near, None
        self._near = solve_beside(problem, near, table.tolerance, with_errors=table.error)
        return self._near

    def _take(self, case: Scene) -> None:
        """Structure and law of a case, unless they are those of the last one."""
        at_omega = case.replace({"excitation.omega": 1.0, "curve": None})
        if self._last != at_omega:
            self._last = at_omega
            self._structure = self._geometry.of_case(case)
            self._law = law_of(case, self._structure)

    def at_resonance(self, case: Scene) -> PeriodicSolution:
        """The solution of a case at the resonance nearest to its frequency; raises as
        :meth:`solve`.

        Where several modes answer together, and with friction or a smooth law, which have no phase
        resonance, it is the top of the response curve.
        """
        table = case.harmonic_balance
        self._take(case)
        omega = case.excitation.omega
        assert self._law is not None
        law = slide_along_lines(self._structure, omega, self._law)
        problem = Problem(self._structure, omega, law, table.harmonics, table.samples)
        found = None
        if is_unilateral(law) and not problem.has_friction:
            near = float(self._geometry.natural.nearest(omega)["omega_bilinear"])
            found = resonance_at(problem, near, tolerance=table.tolerance)
        if found is None or found.several:
            omega, self._near = self._top(problem)
        else:
            omega, self._near = found.omega, found.solution
        return self.solve(case.replace({"excitation.omega": omega}))

    def _top(self, problem: Problem) -> tuple[float, PeriodicSolution]:
        """Where the response curve is largest, from below the mode with the crack open to above
        that with it bonded, and the nearest of its points."""
        natural = self._geometry.natural
        nearest = natural.nearest(problem.omega)
        ratios = damping_ratios(self._geometry.structure.whole, natural.omega_open)
        ratio = float(ratios[int(nearest["mode"]) - 1])
        if not 0.0 < 2.0 * ratio < 1.0:  # widths to either side where it is looked for
            allowed = "above 0 and below 0.5 of critical, of the mode, with sweep.at_resonance"
            raise InputError("damping", ratio, allowed)
        low, high = float(nearest["omega_open"]), float(nearest["omega_tied"])
        ends = (1.0 - 2.0 * ratio) * low, (1.0 + 2.0 * ratio) * high
        curve = continue_frequency(
            problem.structure, *ends, problem.contact, harmonics=problem.harmonics,
            samples=problem.samples, stability=False,
        )  # fmt: skip
        top = curve.top()
        return top.value, curve.solution(top.index)

    def verdict(self, solution: PeriodicSolution) -> Found:
        """Verdict on a solution, modulus of its leading multiplier, and a remark: why no orbit
        decides it, or how more modes contradict it; empty without a law, and for a constraint of
        crack faces with mass."""
        structure, law, remark = solution.structure, solution.contact, ""
        if law is None or (is_rigid(law) and not structure.light_lips):
            return {}
        try:
            found = floquet(structure, solution)
        except REFUSALS:
            return {"verdict": "undecided", "remark": f"; {UNSURE}no multipliers were found"}
        if found.reason:
            remark = f"; {found.verdict}: {found.reason}"
        elif structure.light_lips and (more := solution.assessment.more_modes):
            said = more.describe_contradiction(found.verdict)
            remark = YET + said if said else ""
        return {"verdict": found.verdict, "multiplier": abs(found.multipliers[0]), "remark": remark}


def _at(omega: float, natural: BilinearFrequencies) -> Found:
    """A load frequency, and the natural ones that it is next to."""
    return with_frequency({"omega": omega}) | natural.nearest(omega)


def _numbered(natural: BilinearFrequencies) -> Found:
    """Natural frequencies by the names of their columns; there may be fewer than these."""
    rows = natural.omega_open, np.sort(natural.omega_tied), natural.omega_bilinear
    kinds = zip(FREQUENCY_KIND_NAMES, rows, strict=True)
    return {f"omega_{kind}_{n}": omega for kind, row in kinds for n, omega in enumerate(row, 1)}


def _observed(solution: PeriodicSolution, case: Scene, geometry: Geometry) -> Found:
    """Return the indicators at the load and at the watched points, and the quantities of places
    with rows of their own."""
    rows = _load_row(solution, case) | geometry.watched
    stacked = np.reshape([*rows.values()], (len(rows), solution.structure.n_dofs))
    points, found = solution.observe_rows(stacked, rows_requested(geometry.study))
    for name, seen in zip(rows, points, strict=True):
        values = {quantity: getattr(seen.indicators, quantity) for quantity in AT_POINTS}
        values |= zip(PHASES, seen.real_fourier_coefficients[1:].tolist(), strict=False)
        found |= {f"{name}.{q}" if name else of_load(q): value for q, value in values.items()}
    return found


def _load_row(solution: PeriodicSolution, case: Scene) -> dict[str, np.ndarray]:
    """The displacement of the load's point in the load's direction from the coordinates; nothing
    without a load.

    The direction is that of the largest of the sine and the cosine parts, of the mean if there is
    none. The load vector f of a force F at the point x gives the displacement: f . u = F . u(x).
    """
    sizes = np.linalg.norm(force_vector_by_part(case), axis=1)
    row = len(sizes) - 1 - int(np.argmax(sizes[:0:-1])) if np.any(sizes[1:]) else 0
    return {"": solution.structure.force[row] / sizes[row]} if sizes[row] else {}
