"""The cases of one geometry of a sweep: the structure that ranks exchange, and the solutions."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import solve_linear
from fenics_crack.balance.indicators import indicators_of
from fenics_crack.balance.memory import check_memory
from fenics_crack.balance.neighbours import Neighbours
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import InputError
from fenics_crack.fem.assembly import clearance_of
from fenics_crack.model.bilinear import BilinearFrequencies, bilinear_frequencies
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.damping import DampingRule
from fenics_crack.model.matrices import distributed
from fenics_crack.model.modal import is_small
from fenics_crack.model.nodes import Pairs
from fenics_crack.model.reduced import MasslessStructure, ReducedStructure, massless
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import gather_rows
from fenics_crack.scene.scene import Scene
from fenics_crack.stability.floquet import floquet
from fenics_crack.study.prepare import Study, law_of, prepare
from fenics_crack.study.run import REFUSALS
from fenics_crack.sweep.file import AT_POINTS, COLUMNS, PHASES, of_load
from fenics_crack.sweep.plan import FORCES, Chunk
from fenics_crack.table import with_frequency

__all__ = ["Arrays", "Found", "Geometry", "Known", "all_failed", "build", "solve_chunk"]


@dataclass(frozen=True)
class Known:
    """What is known of a geometry beside its structure.

    Attributes
    ----------
    crack_length : float [m]
        Of the first crack; nan where it is unknown.
    natural : BilinearFrequencies
        With lips open and tied.
    load : (n_dofs,) or None
        What the coordinates are multiplied by for the motion at the load [m]; None: one load, whose
        vector does it.
    watched : dict of str to (n_dofs,)
        The same by "tip.ux" of the named points.
    """

    crack_length: float
    natural: BilinearFrequencies
    load: np.ndarray | None
    watched: dict[str, np.ndarray]

    @classmethod
    def of(cls, study: Study) -> Known:
        """Of a study whose structure is small (collective)."""
        structure = study.structure
        lengths = [crack.length for crack in study.scene.all_cracks.values()]
        named = [watched for watched in study.watched if watched.name]
        rows = np.zeros((0, structure.n_dofs))
        if named:
            rows = structure.values_at(np.eye(structure.n_dofs), [w.dof for w in named]).T
        return cls(
            lengths[0] if lengths and lengths[0] is not None else np.nan,
            bilinear_frequencies(structure),
            _watched(study.scene, structure),
            {watched.name: row for watched, row in zip(named, rows, strict=True)},
        )


@dataclass(frozen=True)
class Arrays:
    """A small structure in plain arrays, to be sent to other ranks."""

    reduced: bool
    modes: int | None
    """How many have mass, where the lips have none."""
    mass: sparse.csr_matrix
    stiffness: sparse.csr_matrix
    gap: sparse.csr_matrix
    damping: DampingRule | np.ndarray | None
    force: np.ndarray
    clearance: np.ndarray
    pairs: Pairs
    reference: Arrays | None

    @classmethod
    def of(cls, structure: Structure) -> Arrays:
        """Take a structure apart."""
        damping = structure.damping
        if damping is not None and not isinstance(damping, DampingRule):
            damping = _rows(damping).toarray()
        reference = structure.reference if isinstance(structure, ReducedStructure) else None
        return cls(
            reduced=isinstance(structure, ReducedStructure),
            modes=structure.n_modes if structure.light_lips else None,
            mass=_rows(structure.mass),
            stiffness=_rows(structure.stiffness),
            gap=structure.gap,
            damping=damping,
            force=structure.force,
            clearance=structure.clearance,
            pairs=structure.pairs,
            reference=None if reference is None else cls.of(reference),
        )

    def structure(self) -> Structure:
        """Put it together again; a reduced one without its whole, in its own coordinates."""
        damping = self.damping
        if isinstance(damping, np.ndarray) and not self.reduced:
            damping = distributed(damping, MPI.COMM_SELF)
        plain = Structure(
            distributed(self.mass, MPI.COMM_SELF),
            distributed(self.stiffness, MPI.COMM_SELF),
            self.gap,
            force=self.force,
            clearance=self.clearance,
            damping=None if self.reduced else damping,
            pairs=self.pairs,
        )
        if not self.reduced:
            return plain
        reference = None if self.reference is None else self.reference.structure()
        assert reference is None or isinstance(reference, ReducedStructure)
        squares = self.stiffness.diagonal()
        if self.modes is not None:
            return self._massless(plain, squares[: self.modes], reference)
        return ReducedStructure(plain, np.eye(len(squares)), squares, self.damping, reference)

    def _massless(
        self, plain: Structure, squares: np.ndarray, reference: ReducedStructure | None
    ) -> MasslessStructure:
        """One whose lips have no mass, of all of its coordinates as a plain structure."""
        count, damping = len(squares), self.damping
        if isinstance(damping, np.ndarray):
            damping = damping[:count, :count]
        return MasslessStructure(
            plain,
            squares,
            damping,
            self.gap[:count].toarray(),
            self.force,
            self.stiffness[count:, count:].toarray(),
            reference=massless(reference),
        )


def _watched(scene: Scene, structure: Structure) -> np.ndarray | None:
    """What is watched of a structure, of its own coordinates; of matrices the dof that carries
    most of the load (collective)."""
    whole = structure.whole
    if whole.watched is not None:
        weights = gather_rows(whole.comm, whole.watched)
    elif scene.structure is not None:
        weights = np.zeros(whole.n_dofs)
        weights[whole.most_loaded()] = 1.0
    else:
        return None
    dofs = np.flatnonzero(weights)
    seen = structure.values_at(np.eye(structure.n_dofs), dofs.tolist())
    return np.asarray(seen @ weights[dofs])


def _rows(matrix: Any) -> sparse.csr_matrix:
    """A PETSc matrix on one rank."""
    starts, columns, values = matrix.getValuesCSR()
    return sparse.csr_matrix((values, columns, starts), shape=matrix.size)


def build(scene: Scene, comm: MPI.Comm, unit_loads: bool, last: Study | None = None) -> Geometry:
    """The geometry of a case; the mesh of the last one serves another speed of the rotor
    (collective)."""
    scene = scene.replace({f"{name}.clearance": 0.0 for name in scene.all_cracks})
    if unit_loads:
        units = {"force_mean": (0.0, 0.0), "force_cos": (0.0, 1.0), "force_sin": (1.0, 0.0)}
        scene = scene.replace({f"excitation.{name}": value for name, value in units.items()})
    study = prepare(scene, comm, like=last)
    if not is_small(study.structure):
        method = "off" if scene.reduction is None else scene.reduction.method
        allowed = f"one that leaves fewer than {study.structure.n_dofs} coordinates"
        raise InputError("reduction.method", method, allowed)
    return Geometry(study.structure, Known.of(study), unit_loads, study)


@dataclass(frozen=True)
class Geometry:
    """What cases share that differ in load, clearance, law and harmonics."""

    structure: Structure  # without clearance
    known: Known
    unit_loads: bool  # the load has a sine part of 1 N in x and a cosine part of 1 N in y
    study: Study | None = None  # where it was built

    def of_case(self, scene: Scene) -> Structure:
        """The structure with the load and the clearance of a case."""
        load: float | np.ndarray = 1.0
        if self.unit_loads:
            wanted = np.array([getattr(scene.excitation, name) for name in FORCES])
            load = np.column_stack([np.zeros(len(FORCES)), wanted[:, ::-1]])
        of_cracks = clearance_of(scene, self.structure.pairs) if scene.all_cracks else 0.0
        return self.structure.varied(load=load, clearance=of_cracks)


# --- a case ---------------------------------------------------------------------------------------


Found = dict[str, Any]
"""The columns known of a case, and "gap" and "force" coefficients if it converged."""


def all_failed(chunk: Chunk, reason: str) -> list[Found]:
    """The cases of a chunk whose geometry cannot be built."""
    return [{"status": case if isinstance(case, str) else reason} for case in chunk.cases]


def solve_chunk(geometry: Geometry, chunk: Chunk, verdicts: bool) -> list[Found]:
    """Solve cases one after the other; with verdicts on their stability, if wanted."""
    cases, solved = Cases(geometry), []
    for case in chunk.cases:
        if isinstance(case, str):
            solved.append({"status": case})
            cases = Cases(geometry)
            continue
        started = time.perf_counter()
        harmonics = case.harmonic_balance.harmonics
        found: Found = {"crack_length": geometry.known.crack_length, "harmonics": harmonics}
        found |= with_frequency({"omega": case.excitation.omega})
        near = geometry.known.natural.nearest(case.excitation.omega)
        found |= {name: value for name, value in near.items() if name in COLUMNS}
        found |= _numbered(geometry.known.natural)
        try:
            solution = cases.solve(case)
            measured = {name: v for name, v in solution.to_dict().items() if name in COLUMNS}
            found |= measured | _seen(solution, case, geometry.known)
            if verdicts:
                found |= cases.verdict(solution)
            found |= {"gap": solution.gap_coefficients, "force": solution.force_coefficients}
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
        self._neighbours = Neighbours()
        self._last: Scene | None = None

    def solve(self, case: Scene) -> PeriodicSolution:
        """The solution of a case; one of :data:`REFUSALS` where there is none."""
        omega, table = case.excitation.omega, case.harmonic_balance
        at_omega = case.replace({"excitation.omega": 1.0, "curve": None})
        if self._last != at_omega:
            self._last = at_omega
            self._structure = self._geometry.of_case(case)
            self._law = law_of(case, self._structure)
        structure, law = self._structure, self._law
        if law is None:
            return solve_linear(structure, omega, harmonics=table.harmonics)
        self._neighbours.tolerance = table.tolerance
        check_memory(structure, table.harmonics)
        problem = Problem(structure, omega, law, table.harmonics, table.samples)
        return self._neighbours.solve(problem)

    def verdict(self, solution: PeriodicSolution) -> Found:
        """Verdict and modulus of the leading multiplier of the last solution; empty without a law,
        and for a constraint of lips with mass."""
        structure, law = solution.structure, solution.contact
        if law is None or (is_rigid(law) and not structure.light_lips):
            return {}
        try:
            found = floquet(structure, solution)
        except REFUSALS:
            return {"verdict": "undecided"}
        return {"verdict": found.verdict, "multiplier": abs(found.multipliers[0])}


def _numbered(natural: BilinearFrequencies) -> Found:
    """Natural frequencies by the names of their columns; there may be fewer than these."""
    rows = {"open": natural.omega_open, "tied": natural.omega_tied}
    return {
        f"omega_{lips}_{mode}": omega
        for lips, row in rows.items()
        for mode, omega in enumerate(row, 1)
    }


def _seen(solution: PeriodicSolution, case: Scene, known: Known) -> Found:
    """What is seen at the load and at the watched points."""
    motion = solution.coordinates(solution.instants())

    def at(row: np.ndarray) -> Found:
        coefficients = solution.displacement_coefficients @ row
        seen = indicators_of(solution.omega, coefficients, np.ptp(motion @ row) / 2.0, {})
        values = {quantity: getattr(seen, quantity) for quantity in AT_POINTS}
        return values | dict(zip(PHASES, coefficients[1:].tolist(), strict=False))

    found: Found = {}
    row = known.load if known.load is not None else _load_row(solution, case)
    if row is not None:
        found |= {of_load(quantity): value for quantity, value in at(row).items()}
    for name, row in known.watched.items():
        found |= {f"{name}.{quantity}": value for quantity, value in at(row).items()}
    return found


def _load_row(solution: PeriodicSolution, case: Scene) -> np.ndarray | None:
    """The displacement of the load's point in the load's direction from the coordinates; None
    without a load.

    The direction is that of the larger of the sine and the cosine part, of the mean if there is
    neither. The load vector f of a force F at the point x gives the displacement: f . u = F . u(x).
    """
    sizes = {name: float(np.hypot(*getattr(case.excitation, name))) for name in FORCES}
    name = max(("force_sin", "force_cos"), key=sizes.__getitem__)
    if sizes[name] == 0.0:
        name = "force_mean"
    if sizes[name] == 0.0:
        return None
    row: np.ndarray = solution.structure.force[FORCES.index(name)] / sizes[name]
    return row
