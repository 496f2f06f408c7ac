"""The cases of one geometry of a sweep: a small structure that travels, and what is found of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.balance.fourier import evaluate
from fenics_crack.balance.harmonic_balance import solve_harmonic_balance, solve_linear
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.contact import ContactLaw, is_rigid
from fenics_crack.model.matrices import distributed
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import ReducedStructure
from fenics_crack.model.structure import ModalDamping, Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.stability.floquet import FEW_PAIRS, PiecewiseFlow, floquet
from fenics_crack.study.prepare import law_of, prepare
from fenics_crack.sweep.file import COLUMNS, CONVERGED, FAILED, STATUS_BYTES
from fenics_crack.sweep.plan import FORCES, Chunk

__all__ = ["REFUSALS", "Arrays", "Geometry", "Solved", "all_failed", "build", "solve_chunk"]

UNSURE = 0.05
"""A multiplier nearer to 1 than this and the truncation error leaves the verdict undecided."""
INSTANTS = 1024
"""Instants of a period at which gap and force are evaluated."""
REFUSALS = (InputError, ConvergenceError, np.linalg.LinAlgError)
"""Errors with which one case fails while the others go on."""


@dataclass(frozen=True)
class Arrays:
    """A small structure in plain arrays, to be sent to other ranks."""

    reduced: bool
    mass: sparse.csr_matrix
    stiffness: sparse.csr_matrix
    gap: sparse.csr_matrix
    damping: ModalDamping | np.ndarray | None
    force: np.ndarray
    clearance: np.ndarray
    pair_areas: np.ndarray | None
    reference: Arrays | None
    crack_length: float

    @classmethod
    def of(cls, structure: Structure, crack_length: float) -> Arrays:
        """Take a structure apart."""
        damping = structure.damping_matrix
        reduced = isinstance(structure, ReducedStructure)
        reference = structure.reference if isinstance(structure, ReducedStructure) else None
        return cls(
            reduced=reduced,
            mass=_rows(structure.mass),
            stiffness=_rows(structure.stiffness),
            gap=structure.gap,
            damping=structure.damping if damping is None else _rows(damping).toarray(),
            force=structure.force,
            clearance=structure.clearance,
            pair_areas=structure.pair_areas,
            reference=None if reference is None else cls.of(reference, crack_length),
            crack_length=crack_length,
        )

    def structure(self) -> Structure:
        """Put it together again; a reduced one stands for itself, in its own coordinates."""
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
            pair_areas=self.pair_areas,
        )
        if not self.reduced:
            return plain
        reference = None if self.reference is None else self.reference.structure()
        assert reference is None or isinstance(reference, ReducedStructure)
        squares = self.stiffness.diagonal()
        return ReducedStructure(plain, np.eye(len(squares)), squares, self.damping, reference)


def _rows(matrix: Any) -> sparse.csr_matrix:
    """A PETSc matrix on one rank."""
    starts, columns, values = matrix.getValuesCSR()
    return sparse.csr_matrix((values, columns, starts), shape=matrix.size)


def build(scene: Scene, comm: MPI.Comm, unit_loads: bool) -> Geometry:
    """The geometry of a case (collective)."""
    if scene.crack is not None:
        scene = scene.replace({"crack.clearance": 0.0})
    if unit_loads:
        units = {"force_mean": (0.0, 0.0), "force_cos": (0.0, 1.0), "force_sin": (1.0, 0.0)}
        scene = scene.replace({f"excitation.{name}": value for name, value in units.items()})
    study = prepare(scene, comm)
    if not is_small(study.structure):
        method = "off" if scene.reduction is None else scene.reduction.method
        raise InputError(
            "reduction.method",
            method,
            f"one that leaves fewer than {study.structure.n_dofs} coordinates",
        )
    crack = study.scene.crack
    length = np.nan if crack is None or crack.length is None else crack.length
    return Geometry(study.structure, length, unit_loads)


@dataclass(frozen=True)
class Geometry:
    """What cases have in common that differ in the size of the load, and in the clearance.

    Attributes
    ----------
    structure : Structure
        Without clearance.
    crack_length : float [m]
        nan where it is unknown.
    unit_loads : bool
        Whether the structure's load has a sine part of 1 N in x and a cosine part of 1 N in y.
    """

    structure: Structure
    crack_length: float
    unit_loads: bool

    def of_case(self, scene: Scene) -> Structure:
        """The structure with the load and the clearance of a case."""
        load: float | np.ndarray = 1.0
        if self.unit_loads:
            wanted = np.array([getattr(scene.excitation, name) for name in FORCES])
            load = np.column_stack([np.zeros(len(FORCES)), wanted[:, ::-1]])
        clearance = scene.crack.clearance if scene.crack is not None else 0.0
        return self.structure.varied(load=load, clearance=clearance)


# --- a case ---------------------------------------------------------------------------------------


@dataclass
class Solved:
    """Cases of a chunk: their columns, and waves of gap and force."""

    state: list[int] = field(default_factory=list)
    columns: dict[str, list[Any]] = field(default_factory=lambda: {name: [] for name in COLUMNS})
    waves: dict[str, list[np.ndarray]] = field(default_factory=lambda: {"gap": [], "force": []})

    def add(self, values: Mapping[str, Any], solution: PeriodicSolution | None) -> None:
        """Add the next case; what is not given is nan, 0 or empty."""
        blank: dict[str, Any] = {"f": np.nan, "i": 0, "S": b""}
        self.state.append(FAILED if solution is None else CONVERGED)
        for name, (_, kind) in COLUMNS.items():
            value = values.get(name, blank[kind[0]])
            self.columns[name].append(_bytes(value) if isinstance(value, str) else value)
        empty = np.zeros((0, 0))
        self.waves["gap"].append(empty if solution is None else solution.gap_coefficients)
        self.waves["force"].append(empty if solution is None else solution.force_coefficients)


def _bytes(text: str) -> bytes:
    """Text as what a fixed length holds, no character cut in two."""
    return text.encode()[:STATUS_BYTES].decode("utf-8", "ignore").encode()


def all_failed(chunk: Chunk, reason: str) -> Solved:
    """The cases of a chunk whose geometry cannot be built."""
    solved = Solved()
    for case in chunk.cases:
        solved.add({"status": case if isinstance(case, str) else reason}, None)
    return solved


def solve_chunk(geometry: Geometry, chunk: Chunk) -> Solved:
    """Solve cases one after the other."""
    solved = Solved()
    flow = Flow(geometry.structure)
    last: PeriodicSolution | None = None
    for case in chunk.cases:
        if isinstance(case, str):
            solved.add({"status": case}, None)
            last = None
            continue
        started = time.perf_counter()
        values: dict[str, Any] = {
            "crack_length": geometry.crack_length,
            "harmonics": case.harmonic_balance.harmonics,
        }
        try:
            last = _solve(geometry.of_case(case), case, last)
            values |= _measures(last, case) | flow.verdict(last)
        except REFUSALS as error:
            last = None
            values["status"] = str(error)
        values["seconds"] = time.perf_counter() - started
        solved.add(values, last)
    return solved


def _solve(structure: Structure, case: Scene, last: PeriodicSolution | None) -> PeriodicSolution:
    """Solve a case from its neighbour, or where that fails from the linear solution."""
    omega, table = case.excitation.omega, case.harmonic_balance
    law = law_of(case, structure)
    if law is None:
        return solve_linear(structure, omega, harmonics=table.harmonics)
    for initial in (last, None):
        try:
            return solve_harmonic_balance(
                structure,
                omega,
                law,
                harmonics=table.harmonics,
                samples=table.samples,
                initial=initial,
            )
        except ConvergenceError:
            if initial is None:
                raise
    raise AssertionError


def _measures(solution: PeriodicSolution, case: Scene) -> dict[str, Any]:
    """What the table says of a solution."""
    report = solution.report
    found = {
        "response": _response(solution, case),
        "residual_error": report.residual,
        "truncation_error": report.truncation,
        "sampling_error": report.sampling,
        "reduction_error": report.reduction,
        "penetration_share": report.penetration,
        "harmonics": solution.harmonics,
        "iterations": solution.iterations,
        "status": solution.status,
    }
    if solution.structure.n_pairs:
        instants = _instants(solution)
        gap, force = solution.gap(instants), solution.contact_force(instants)
        found |= {
            "opening": max(0.0, -float(gap.min())),
            "penetration": max(0.0, float(gap.max())),
            "contact_force": float(force.max()),
            "closed_share": float(np.mean(force > 0.0)),
        }
    return found


def _instants(solution: PeriodicSolution) -> np.ndarray:
    return solution.period * np.arange(INSTANTS) / INSTANTS


def _response(solution: PeriodicSolution, case: Scene) -> float:
    """Half the peak-to-peak displacement of the load's point in the load's direction [m].

    The direction is that of the larger of the sine and the cosine part, of the mean where there is
    neither. The force's row of the structure sees the displacement there: f . u = F . u(x).
    """
    sizes = {name: float(np.hypot(*getattr(case.excitation, name))) for name in FORCES}
    name = max(("force_sin", "force_cos"), key=sizes.__getitem__)
    if sizes[name] == 0.0:
        name = "force_mean"
    if sizes[name] == 0.0:
        return np.nan
    row = solution.structure.force[FORCES.index(name)] / sizes[name]
    wave = solution.displacement_coefficients @ row[:, None]
    return float(np.ptp(evaluate(wave, solution.base_omega, _instants(solution))) / 2.0)


class Flow:
    """Stability of the solutions of a chunk.

    Up to four pairs the verdict is that of :func:`fenics_crack.floquet`, which compares three
    estimates. That takes 0.5 s with 18 pairs, many times as long as the solution; with more than
    four pairs the leading multiplier of the solution decides, as along response curves, unless it
    is near the unit circle.
    """

    def __init__(self, structure: Structure) -> None:
        self._structure = structure
        self._law: ContactLaw | None = None
        self._flow: PiecewiseFlow | None = None

    def verdict(self, solution: PeriodicSolution) -> dict[str, Any]:
        """Verdict, and modulus of the leading multiplier; nothing where there is no law of it."""
        law = solution.contact
        if law is None or is_rigid(law):
            return {}
        try:
            if self._structure.n_pairs <= FEW_PAIRS:
                found = floquet(self._structure, solution, refine=False)
                return {"verdict": found.verdict, "multiplier": abs(found.multipliers[0])}
            if self._flow is None or not _equal(law, self._law):
                self._law, self._flow = law, PiecewiseFlow(self._structure, law)
            leading = self._flow.leading(solution.gap_coefficients, solution.base_omega)
        except REFUSALS:
            return {"verdict": "undecided"}
        size = abs(leading.value)
        verdict = "stable" if size < 1.0 else "unstable"
        if abs(size - 1.0) <= UNSURE + solution.report.truncation:
            verdict = "undecided"
        return {"verdict": verdict, "multiplier": size}


def _equal(one: ContactLaw, other: ContactLaw | None) -> bool:
    """Whether two laws are the same; their stiffness may be an array."""
    return (
        type(one) is type(other)
        and np.array_equal(one.stiffness, other.stiffness)  # type: ignore[union-attr]
        and getattr(one, "sharpness", None) == getattr(other, "sharpness", None)
    )
