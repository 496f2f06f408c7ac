"""Sweeps: many cases of a scene, spread over ranks, in a file from which a killed run goes on.

The cases are the product of the axes in ``[sweep.over]``, numbered with the last axis fastest.

*Geometries.* What changes mesh, matrices, modes, damping or the place of the load makes another
geometry; frequency, force, contact law, clearance and truncation do not. A geometry is built once,
and is then a small structure in plain arrays that any rank can solve.

*Chunks.* The cases of a geometry are cut into chunks of up to 12 along the frequency (or, where it
is not swept, along the last axis that leaves the geometry alone). The first case of a chunk starts
from the linear solution, each further one from its neighbour. Chunks depend on the scene alone: so
do the results, whatever the number of ranks (that share the cases, not a mesh) and interruptions.

*Jobs.* Rank 0 hands jobs to the other ranks by mpi4py.futures and takes jobs itself: some chunks of
a geometry that is built, or a geometry to be built. Jobs shrink towards the end, so that all ranks
finish together. Finished jobs arrive in the executor's own thread, which writes them and sends the
next one, also while rank 0 computes; MPI must allow this (``THREAD_MULTIPLE``), else rank 0 only
hands out jobs. With ``sweep.ranks = s`` the ranks form groups of s: a group builds a geometry
together, and shares its chunks.
"""

from __future__ import annotations

import gc
import itertools
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from mpi4py.futures import MPICommExecutor
from tqdm import tqdm

from fenics_crack.compliance import dynamic_compliance, is_small
from fenics_crack.condensed import default_weight
from fenics_crack.contact import ContactLaw, UnilateralConstraint, contact_law
from fenics_crack.error_report import ErrorReport
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.finite_elements import find_crack_length
from fenics_crack.fourier import evaluate
from fenics_crack.harmonic_balance import solve_harmonic_balance, solve_linear
from fenics_crack.mesh import build_mesh
from fenics_crack.parallel import StopRequest, on_root
from fenics_crack.reduction import ReducedStructure
from fenics_crack.run import prepare
from fenics_crack.scene import Scene
from fenics_crack.solution import PeriodicSolution
from fenics_crack.stability import FEW_PAIRS, PiecewiseFlow, floquet
from fenics_crack.structure import ModalDamping, Structure
from fenics_crack.sweep_file import (
    COLUMNS,
    CONVERGED,
    FAILED,
    PENDING,
    STATUS_BYTES,
    SweepFile,
    read_columns,
    read_waves,
    shape_of,
)
from fenics_crack.table import Axis

__all__ = ["SweepResult", "run_sweep"]

CHUNK = 12
"""Cases of a chunk at most."""
LONGEST = 2.0
"""Duration of a job [s] that is aimed at: what a kill can lose."""
INSTANTS = 1024
"""Of a period, at which gaps and forces are looked at."""
SAME_GEOMETRY = (
    "excitation.omega", "excitation.force_sin", "excitation.force_cos", "excitation.force_mean",
    "contact.stiffness", "contact.stiffness_per_area", "contact.law", "contact.sharpness",
    "crack.clearance", "harmonic_balance.harmonics", "harmonic_balance.samples",
)  # fmt: skip
"""Keys that leave mesh, matrices, modes and the place of the load alone."""
FORCES = ("force_mean", "force_cos", "force_sin")
UNITS = {
    "geometry.thickness": "m", "geometry.width": "m", "geometry.height": "m", "crack.height": "m",
    "crack.length": "m", "crack.first_omega": "rad/s", "crack.clearance": "m",
    "material.young": "Pa", "material.density": "kg/m^3", "excitation.omega": "rad/s",
    "excitation.point": "m", "excitation.force_sin": "N", "excitation.force_cos": "N",
    "excitation.force_mean": "N", "contact.stiffness": "N/m",
    "contact.stiffness_per_area": "N/m^3", "contact.sharpness": "1/m", "mesh.size": "m",
}  # fmt: skip
REFUSALS = (InputError, ConvergenceError, np.linalg.LinAlgError)
"""What makes a case fail, and lets the others go on."""


def run_sweep(
    scene: Scene,
    path: str | Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
) -> SweepResult:
    """Solve all cases of a scene's sweep by harmonic balance (collective).

    A case that cannot be solved is recorded with its reason. Ctrl-C stops after the jobs at hand;
    the same call goes on with what is missing.

    Parameters
    ----------
    scene : Scene
        With its table ``[sweep]``.
    path : path
        The file for the results. If it exists and is of the same scene, what it has is kept,
        failed cases too; a mesh file is taken to be the same.
    comm : MPI.Comm
        The ranks; with ``sweep.ranks = s`` a multiple of s.
    progress : bool
        Show a bar.

    Returns
    -------
    SweepResult
        On every rank; not complete after Ctrl-C.

    Raises
    ------
    InputError
        The scene has no sweep, no combination of its values is a scene, the number of ranks does
        not fit, a structure is not to be reduced and too large, or the file cannot be used.
    """
    if scene.sweep is None:
        raise InputError("sweep", None, "given: what to vary")
    ranks = scene.sweep.ranks
    if comm.size % ranks:
        raise InputError("sweep.ranks", ranks, f"a divisor of the number of ranks, {comm.size}")
    if ranks > 1 and scene.reduction is not None and scene.reduction.method == "none":
        raise InputError("reduction.method", "none", "a reduction where sweep.ranks > 1")
    manager: _Manager | None = None

    def start() -> None:
        nonlocal manager
        plan = _Plan(scene)
        file = SweepFile(Path(path), scene, plan.harmonics, plan.pairs)
        manager = _Manager(plan, file, comm.size // ranks, ranks, progress)

    on_root(comm, start)
    group = comm.Split(comm.rank // ranks, comm.rank)
    leaders = comm.Split(0 if group.rank == 0 else MPI.UNDEFINED, comm.rank)
    _Worker.current = _Worker(group)
    try:
        with StopRequest() as stop:
            if manager is not None:
                _manage(manager, leaders, stop)
            elif leaders != MPI.COMM_NULL:
                with MPICommExecutor(leaders, root=0):
                    pass  # serves
            if group.rank == 0:
                group.bcast(None)
            else:
                while (job := group.bcast(None)) is not None:
                    _Worker.current.work(job)
        error = comm.bcast(None if manager is None else manager.error_for_others)
    finally:
        _Worker.current = None
    if leaders != MPI.COMM_NULL:
        leaders.Free()
    group.Free()
    if manager is not None and manager.error is not None:
        raise manager.error
    if error is not None:
        raise error
    return on_root(comm, lambda: SweepResult.load(path))


def _manage(manager: _Manager, leaders: MPI.Comm, stop: StopRequest) -> None:
    """Run all jobs from rank 0; whatever happens is kept as the manager's error."""
    try:
        if leaders.size == 1:
            manager.run(None, stop)
            return
        with MPICommExecutor(leaders, root=0) as executor, _no_garbage_in_threads():
            try:
                manager.run(executor, stop)
            except BaseException as error:
                manager.fail(error)
    except BaseException as error:
        manager.fail(error)
    finally:
        manager.close()


@contextmanager
def _no_garbage_in_threads() -> Iterator[None]:
    """Python's cyclic garbage is collected where it is safe to destroy PETSc's objects.

    Else it could be in the executor's thread, while the main one is in PETSc.
    """
    enabled = gc.isenabled()
    gc.disable()
    gc.freeze()  # what is there already need not be looked at after every job
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()


@contextmanager
def _kept_handler() -> Iterator[None]:
    """What Ctrl-C does is as before: gmsh sets it and does not always set it back."""
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, handler)


# --- the plan -------------------------------------------------------------------------------------


Index = tuple[Any, ...]
"""Of whole numbers, and a slice on one axis."""


@dataclass(frozen=True)
class _Chunk:
    """Neighbouring cases along one axis.

    Attributes
    ----------
    index : Index
        Where they are in the table.
    cases : tuple of Scene or str
        What to solve, or why it cannot be.
    """

    index: Index
    cases: tuple[Scene | str, ...]


class _Plan:
    """Geometries and chunks of a scene.

    Attributes
    ----------
    shape : tuple of int
        Of the table of cases.
    geometries : list of tuple
        Where the geometries are: an index on each axis that changes them, None on the others.
    harmonics, pairs : int
        Most of any case; an upper bound.
    unit_loads : bool
        Whether the force is swept, so that geometries are to be built with unit loads.
    """

    def __init__(self, scene: Scene) -> None:
        assert scene.sweep is not None
        self._base = scene.replace({"sweep": None})
        self._axes = scene.sweep.over
        keys = [axis.key for axis in self._axes]
        if scene.sweep.ranks > 1 and scene.reduction is None:  # on one rank too
            self._base = self._base.replace({"reduction.method": "free_interface"})
        self.shape = shape_of(scene)
        self.unit_loads = any(f"excitation.{name}" in keys for name in FORCES)
        self.reduction_swept = "reduction.method" in keys
        same = [number for number, key in enumerate(keys) if key in SAME_GEOMETRY]
        self._along = same[-1] if same else None
        if "excitation.omega" in keys:
            self._along = keys.index("excitation.omega")
        self._inner = [number for number in same if number != self._along]
        self.geometries = list(
            itertools.product(
                *((None,) if n in same else range(size) for n, size in enumerate(self.shape))
            )
        )
        counts = [scene.harmonic_balance.harmonics]
        for axis in self._axes:
            if axis.key == "harmonic_balance.harmonics":
                counts = list(axis.values)
        self.harmonics = max(counts)
        self._measure()

    def _measure(self) -> None:
        """Bound the pairs; raise InputError if no combination is a scene."""
        bounds: dict[Any, int] = {}
        found, reason = False, ""
        for geometry in self.geometries:
            ranges = [range(size) if at is None else (at,)
                      for at, size in zip(geometry, self.shape, strict=True)]  # fmt: skip
            for index in itertools.product(*ranges):
                case = self.case(index)
                if not isinstance(case, str):
                    found = True
                    pairs = case.contact and case.contact.pairs
                    length = case.crack and case.crack.length
                    key = case.mesh, pairs, length, case.geometry.width
                    if key not in bounds:
                        bounds[key] = _most_pairs(case)
                    break
                reason = reason or case
        if not found:
            raise InputError("sweep.over", reason, "values of which a combination can be used")
        self.pairs = max(bounds.values())

    def case(self, index: tuple[int, ...]) -> Scene | str:
        """The scene of a case, or why there is none."""
        changes = {axis.key: axis.values[at] for axis, at in zip(self._axes, index, strict=True)}
        try:
            return self._base.replace(changes)
        except InputError as error:
            return str(error)

    def pending(self, geometry: tuple[int | None, ...], state: np.ndarray) -> list[Index]:
        """Where the chunks of a geometry are that are not complete."""
        found = []
        along = len(self.shape) - 1 if self._along is None else self._along
        for inner in itertools.product(*(range(self.shape[number]) for number in self._inner)):
            place: list[Any] = list(geometry)
            for number, at in zip(self._inner, inner, strict=True):
                place[number] = at
            first, length = 0, self.shape[along]
            if self._along is None:  # a chunk is one case
                first, length = place[along], 1
            pieces = -(-length // CHUNK)
            for piece in range(pieces):
                low, high = (first + (length * n) // pieces for n in (piece, piece + 1))
                index = (*place[:along], slice(low, high), *place[along + 1 :])
                if np.any(state[index] == PENDING):
                    found.append(index)
        return found

    def chunk(self, index: Index) -> _Chunk:
        """The chunk at a place."""
        ranges = (range(at.start, at.stop) if isinstance(at, slice) else (at,) for at in index)
        return _Chunk(index, tuple(map(self.case, itertools.product(*ranges))))


def _most_pairs(scene: Scene) -> int:
    """Bound of the contact pairs of a scene, without the mesh where the plate is drawn."""
    mesh, crack = scene.mesh, scene.crack
    if scene.contact is not None and scene.contact.pairs == "mouth":
        return 1
    if mesh.layout == "file":
        try:
            plate = build_mesh(scene, MPI.COMM_SELF)
        except InputError:
            return 0  # its cases will fail
        if not plate.cracked:
            return 0
        return len(plate.facet_tags.find(plate.groups["lower_lip"])) * mesh.order + 1
    if crack is None:
        return 0
    if mesh.layout == "graded":
        assert mesh.lip_elements is not None
        return mesh.lip_elements * mesh.order
    assert mesh.columns is not None and crack.length is not None and scene.geometry.width
    return round(crack.length / scene.geometry.width * mesh.columns) * mesh.order


# --- a geometry -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Arrays:
    """A small structure in plain arrays, to be sent to other ranks."""

    reduced: bool
    mass: sparse.csr_matrix
    stiffness: sparse.csr_matrix
    gap: sparse.csr_matrix
    damping: ModalDamping | np.ndarray | None
    force: np.ndarray
    clearance: np.ndarray
    pair_areas: np.ndarray | None
    reference: _Arrays | None
    crack_length: float

    @classmethod
    def of(cls, structure: Structure, crack_length: float) -> _Arrays:
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
        plain = Structure.from_matrices(
            self.mass,
            self.stiffness,
            self.gap,
            clearance=self.clearance,
            damping=None if self.reduced else self.damping,
        )
        plain.force, plain.pair_areas = self.force, self.pair_areas
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


def _build(scene: Scene, comm: MPI.Comm, unit_loads: bool) -> tuple[Structure, float]:
    """The structure of a geometry and its crack length [m], nan where it is unknown (collective).

    With unit loads the sine part of its load is 1 N in x, the cosine part 1 N in y.
    """
    crack = scene.crack
    if crack is not None and crack.first_omega is not None:
        scene = scene.replace(
            {"crack.length": find_crack_length(scene, comm), "crack.first_omega": None}
        )
    if unit_loads:
        units = {"force_mean": (0.0, 0.0), "force_cos": (0.0, 1.0), "force_sin": (1.0, 0.0)}
        scene = scene.replace({f"excitation.{name}": value for name, value in units.items()})
    structure = prepare(scene, comm)
    if not is_small(structure):
        method = "none" if scene.reduction is None else scene.reduction.method
        raise InputError(
            "reduction.method", method, f"one that leaves fewer than {structure.n_dofs} coordinates"
        )
    length = scene.crack.length if scene.crack is not None else None
    return structure, np.nan if length is None else length


class _Geometry:
    """A structure whose load and clearance follow the cases."""

    def __init__(self, structure: Structure, crack_length: float, unit_loads: bool) -> None:
        self.structure = structure
        self.crack_length = crack_length
        self._unit_loads = unit_loads
        parts = [structure, getattr(structure, "reference", None), structure.whole]
        self._parts = [part for part in parts if part is not None]
        self._given = [part.force for part in self._parts]

    def set_case(self, scene: Scene) -> None:
        """Give it the load and the clearance of a case."""
        clearance = scene.crack.clearance if scene.crack is not None else 0.0
        weights = np.array([getattr(scene.excitation, name)[::-1] for name in FORCES])
        for part, given in zip(self._parts, self._given, strict=True):
            part.clearance = np.full(part.n_pairs, clearance)
            if self._unit_loads:
                part.force = weights @ given[1:]


# --- a case ---------------------------------------------------------------------------------------


@dataclass
class _Solved:
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


def _all_failed(chunk: _Chunk, reason: str) -> _Solved:
    """The cases of a chunk whose geometry cannot be built."""
    solved = _Solved()
    for case in chunk.cases:
        solved.add({"status": case if isinstance(case, str) else reason}, None)
    return solved


def _solve_chunk(geometry: _Geometry, chunk: _Chunk) -> _Solved:
    """Solve cases one after the other."""
    solved = _Solved()
    flow = _Flow(geometry.structure)
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
            geometry.set_case(case)
            last = _solve(geometry.structure, case, last)
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
    if structure.n_pairs == 0:
        return solve_linear(structure, omega, harmonics=table.harmonics)
    assert case.contact is not None
    law = contact_law(case.contact, structure)
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


class _Flow:
    """Stability of the solutions of a chunk.

    Up to four pairs the verdict is that of :func:`fenics_crack.floquet`, which compares three
    estimates. That takes 0.5 s with 18 pairs, many times as long as the solution; with more than
    four pairs the leading multiplier of the solution decides, as along response curves.
    """

    def __init__(self, structure: Structure) -> None:
        self._structure = structure
        self._law: ContactLaw | None = None
        self._flow: PiecewiseFlow | None = None

    def verdict(self, solution: PeriodicSolution) -> dict[str, Any]:
        """Verdict, and modulus of the leading multiplier; nothing where there is no law of it."""
        law = solution.contact
        if law is None or isinstance(law, UnilateralConstraint):
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
        verdict = "stable" if leading.stable else "unstable"
        return {"verdict": verdict, "multiplier": abs(leading.value)}


def _equal(one: ContactLaw, other: ContactLaw | None) -> bool:
    """Whether two laws are the same; their stiffness may be an array."""
    return (
        type(one) is type(other)
        and np.array_equal(one.stiffness, other.stiffness)  # type: ignore[union-attr]
        and getattr(one, "sharpness", None) == getattr(other, "sharpness", None)
    )


# --- jobs -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Job:
    """Some chunks of a geometry, which is to be built if there is a scene of it."""

    geometry: int
    scene: Scene | None
    arrays: _Arrays | None
    unit_loads: bool
    wanted: bool
    """Whether other jobs need the arrays."""
    chunks: tuple[_Chunk, ...]


@dataclass
class _Answer:
    """What became of a job."""

    arrays: _Arrays | None = None
    refusal: Exception | None = None
    """Why the geometry cannot be built."""
    solved: list[tuple[_Chunk, _Solved]] = field(default_factory=list)
    seconds: float = 0.0
    """Spent on the chunks."""
    error: str | None = None
    """A traceback: something that should not happen."""


class _Worker:
    """A group of ranks, or one, that does jobs."""

    current: _Worker | None = None
    """This rank's."""

    def __init__(self, group: MPI.Comm) -> None:
        self._group = group
        self._known: dict[int, _Geometry] = {}

    def lead(self, job: _Job) -> _Answer:
        """Do a job with the whole group; called by its leader."""
        self._group.bcast(job)
        return self.work(job)

    def work(self, job: _Job) -> _Answer:
        """Do a job (collective on the group)."""
        answer = _Answer()
        arrays = job.arrays
        try:
            if job.scene is not None:
                with _kept_handler():
                    structure, length = _build(job.scene, self._group, job.unit_loads)
                arrays = _Arrays.of(structure, length)
                answer.arrays = arrays if job.wanted else None
        except REFUSALS as error:
            answer.refusal = error
            return answer
        except Exception:
            if self._group.size > 1:  # the others may wait for this rank
                traceback.print_exc()
                self._group.Abort(1)
            answer.error = traceback.format_exc()
            return answer
        started, error_text = time.perf_counter(), None
        try:
            if job.chunks:
                geometry = self._geometry(job, self._group.bcast(arrays))
                for chunk in job.chunks[self._group.rank :: self._group.size]:
                    answer.solved.append((chunk, _solve_chunk(geometry, chunk)))
        except Exception:
            error_text = traceback.format_exc()
        parts = self._group.gather((answer.solved, error_text))
        if parts is not None:
            answer.solved = [item for solved, _ in parts for item in solved]
            answer.error = next((text for _, text in parts if text is not None), None)
        answer.seconds = time.perf_counter() - started
        return answer

    def _geometry(self, job: _Job, arrays: _Arrays) -> _Geometry:
        if job.geometry not in self._known:
            geometry = _Geometry(arrays.structure(), arrays.crack_length, job.unit_loads)
            self._known = {job.geometry: geometry}
        return self._known[job.geometry]


def _lead(job: _Job) -> _Answer:
    """What the executor calls on a leader."""
    assert _Worker.current is not None
    return _Worker.current.lead(job)


class _Manager:
    """Rank 0's queue of jobs, and the file; its methods may be called from two threads."""

    def __init__(
        self, plan: _Plan, file: SweepFile, groups: int, ranks: int, progress: bool
    ) -> None:
        self.error: BaseException | None = None
        self._plan, self._file = plan, file
        self._groups, self._ranks = groups, ranks
        self._news = threading.Condition()
        self._executor: Any = None
        self._given: dict[Any, _Job] = {}
        """Jobs with the executor, by their futures."""
        self._stopped = False
        self._waiting: dict[int, deque[Index]] = {}
        """Places of the chunks of geometries that are built or being built."""
        self._built: dict[int, _Arrays] = {}
        self._unbuilt = deque(
            number
            for number, geometry in enumerate(plan.geometries)
            if np.any(file.state[_everywhere(geometry)] == PENDING)
        )
        self._chunks_left = sum(len(self._pending(number)) for number in self._unbuilt)
        self._seconds, self._chunks_done, self._recorded = 0.0, 0, 0
        self._bar = tqdm(
            total=file.state.size,
            initial=int(np.count_nonzero(file.state != PENDING)),
            desc="sweep",
            unit="case",
            disable=not progress,
        )

    @property
    def error_for_others(self) -> BaseException | None:
        """The error as ranks that did not meet it raise it."""
        if self.error is None or isinstance(self.error, InputError | KeyboardInterrupt):
            return self.error
        return RuntimeError(f"the sweep ended on rank 0: {self.error}")

    def run(self, executor: Any, stop: StopRequest) -> None:
        """Have all jobs done."""
        self._executor = executor
        takes_part = executor is None or MPI.Query_thread() >= MPI.THREAD_MULTIPLE
        while True:
            job = None
            with self._news:
                self._stopped = self._stopped or stop.asked(MPI.COMM_SELF)
                self._submit()
                if takes_part:
                    job = self._next_job() or self._take_back()
                if job is None:
                    if not self._given:
                        return
                    self._news.wait(0.1)
                    continue
            answer = _lead(job)
            with self._news:
                self._record(job, answer)
            if executor is not None:
                del answer
                gc.collect()

    def fail(self, error: BaseException) -> None:
        """End the sweep with an error; the first one counts."""
        with self._news:
            self.error = self.error or error
            self._news.notify()

    def close(self) -> None:
        """Close the file; one that is new and has nothing in it is removed after an error."""
        self._bar.close()
        useless = self._file.made and self._recorded == 0 and self.error is not None
        self._file.close(remove=useless)

    def _submit(self) -> None:
        """Keep one more job with the executor than it has workers."""
        if self._executor is None:
            return
        while len(self._given) < self._groups:
            job = self._next_job()
            if job is None:
                return
            future = self._executor.submit(_lead, job)
            self._given[future] = job
            future.add_done_callback(self._arrived)

    def _take_back(self) -> _Job | None:
        """A job that the executor has not begun, for rank 0, which has none; at the end none."""
        ending = self._stopped or self.error is not None
        for future, job in list(self._given.items()):
            if future.cancel() and not ending:
                return job
        return None

    def _arrived(self, future: Any) -> None:
        """Record what a worker has done, and send it more: in the executor's thread."""
        with self._news:
            job = self._given.pop(future)
            if future.cancelled():
                return
            try:
                self._record(job, future.result())
                self._submit()
            except BaseException as error:
                self.fail(error)
            self._news.notify()

    def _next_job(self) -> _Job | None:
        """Chunks of a built geometry, or a geometry to build, or nothing for now."""
        if self._stopped or self.error is not None:
            return None
        in_time = LONGEST * self._chunks_done / max(self._seconds, 1e-9)  # none known: one
        share = max(1, int(min(in_time, self._chunks_left // (3 * self._groups))))
        share = -(-share // self._ranks) * self._ranks
        while self._built:
            number, arrays = next(iter(self._built.items()))
            chunks = self._pop(number, share)
            if not self._waiting[number]:
                del self._built[number], self._waiting[number]
            if chunks:
                return _Job(number, None, arrays, self._plan.unit_loads, False, chunks)
        while self._unbuilt:
            number = self._unbuilt.popleft()
            self._waiting[number] = deque(self._pending(number))
            every = map(self._plan.chunk, self._waiting[number])
            cases = (case for chunk in every for case in chunk.cases)
            scene = next((case for case in cases if not isinstance(case, str)), None)
            if scene is None:
                self._refuse(number, self._pop(number), "")
                continue
            # The others have something to do meanwhile.
            alone = self._groups == 1 or len(self._unbuilt) >= self._groups
            first = self._pop(number, share if alone else 0)
            wanted = bool(self._waiting[number])
            return _Job(number, scene, None, self._plan.unit_loads, wanted, first)
        return None

    def _pending(self, number: int) -> list[Index]:
        return self._plan.pending(self._plan.geometries[number], self._file.state)

    def _pop(self, number: int, count: int | None = None) -> tuple[_Chunk, ...]:
        waiting = self._waiting[number]
        count = len(waiting) if count is None else min(count, len(waiting))
        self._chunks_left -= count
        return tuple(self._plan.chunk(waiting.popleft()) for _ in range(count))

    def _record(self, job: _Job, answer: _Answer) -> None:
        """Write what a job has found."""
        for chunk, solved in answer.solved:
            self._write(chunk, solved)
        self._seconds += answer.seconds * self._ranks
        self._chunks_done += len(answer.solved)
        if answer.error is not None:
            raise RuntimeError(f"a job of the sweep ended with\n{answer.error}")
        if answer.refusal is not None:
            refusal = answer.refusal
            hopeless = isinstance(refusal, InputError) and refusal.key == "reduction.method"
            if hopeless and not self._plan.reduction_swept:
                raise refusal
            rest = self._pop(job.geometry)
            self._refuse(job.geometry, job.chunks + rest, str(refusal))
        elif answer.arrays is not None:
            self._built[job.geometry] = answer.arrays
        elif job.scene is not None:
            del self._waiting[job.geometry]
        self._news.notify()

    def _refuse(self, number: int, chunks: tuple[_Chunk, ...], reason: str) -> None:
        for chunk in chunks:
            self._write(chunk, _all_failed(chunk, reason))
        del self._waiting[number]

    def _write(self, chunk: _Chunk, solved: _Solved) -> None:
        columns = {
            name: np.array(values, dtype=COLUMNS[name][1])
            for name, values in solved.columns.items()
        }
        self._file.write(chunk.index, np.array(solved.state), columns, solved.waves)
        self._recorded += 1
        self._bar.update(len(chunk.cases))


def _everywhere(geometry: tuple[int | None, ...]) -> tuple[Any, ...]:
    """Index of all cases of a geometry."""
    return tuple(slice(None) if at is None else at for at in geometry)


# --- the result -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class SweepResult:
    """The table of a sweep; the waves are read from its file when they are asked for.

    Attributes
    ----------
    path : Path
        The file.
    scene : Scene
        What was swept.
    columns : dict of str to array
        Numbers and words by their names, in the shape of the axes; nan where there is none:
        ``response``, half the peak-to-peak displacement of the load's point in the load's direction
        [m]; ``opening`` and ``penetration``, the largest of any pair [m]; ``contact_force``, the
        largest on a pair [N]; ``closed_share`` of the period, mean over the pairs; ``multiplier``,
        largest modulus, and the ``verdict`` that follows, empty where there is no contact law;
        ``residual_error`` to ``reduction_error`` and ``penetration_share`` as in
        :class:`ErrorReport`; ``harmonics``; Newton ``iterations``; ``crack_length``, given or found
        [m]; ``seconds`` on the clock; ``status``, how it was solved or why not; ``state``: 0
        pending, 1 converged, 2 failed.
    """

    path: Path
    scene: Scene
    columns: dict[str, np.ndarray]

    @classmethod
    def load(cls, path: str | Path) -> SweepResult:
        """Read the table of a sweep, also while it runs; nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, or is not one of a sweep.
        """
        scene, columns = read_columns(Path(path))
        return cls(Path(path), scene, columns)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes of the table."""
        assert self.scene.sweep is not None
        return self.scene.sweep.over

    @property
    def shape(self) -> tuple[int, ...]:
        """How many values each axis has."""
        return shape_of(self.scene)

    @property
    def complete(self) -> bool:
        """Whether every case was tried."""
        return not np.any(self["state"] == PENDING)

    @property
    def converged(self) -> np.ndarray:
        """Which cases were solved, bool in the shape of the axes."""
        return self["state"] == CONVERGED

    @property
    def failed(self) -> list[tuple[tuple[int, ...], str]]:
        """Index and reason of every case that could not be solved."""
        places = np.argwhere(self["state"] == FAILED)
        return [(tuple(map(int, at)), str(self["status"][tuple(at)])) for at in places]

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Names with units, and a row for every case in their order: for a CSV file."""
        names = [_with_unit(axis.key, UNITS.get(axis.key, "")) for axis in self.axes]
        names += ["state", *(_with_unit(name, unit) for name, (unit, _) in COLUMNS.items())]
        words = np.array(["pending", "converged", "failed"])[self["state"]]
        flat = [words.ravel().tolist(), *(self[name].ravel().tolist() for name in COLUMNS)]
        values = itertools.product(*(axis.values for axis in self.axes))
        return names, [[*at, *row] for at, row in zip(values, zip(*flat, strict=True), strict=True)]

    def gap(self, index: tuple[int, ...] | int) -> np.ndarray:
        """Gap coefficients of a case that converged: (2H+1, n_pairs) [m].

        Parameters
        ----------
        index : tuple of int, or int
            Its place on each axis, or its number.

        Raises
        ------
        InputError
            There is no such case, or it was not solved.
        """
        return read_waves(self.path, self._place(index))[0]

    def solution(self, index: tuple[int, ...] | int) -> PeriodicSolution:
        """The solution of a case that converged; its structure is built again.

        Raises
        ------
        InputError
            As :meth:`gap`.
        """
        place = self._place(index)
        plan = _Plan(self.scene)
        case = plan.case(place)
        assert isinstance(case, Scene)
        length = float(self["crack_length"][place])
        if case.crack is not None and case.crack.first_omega is not None:
            case = case.replace({"crack.length": length, "crack.first_omega": None})
        structure, length = _build(case, MPI.COMM_SELF, plan.unit_loads)
        _Geometry(structure, length, plan.unit_loads).set_case(case)
        omega = case.excitation.omega
        if structure.n_pairs == 0:
            return solve_linear(structure, omega, harmonics=case.harmonic_balance.harmonics)
        assert case.contact is not None
        law = contact_law(case.contact, structure)
        gap, force = read_waves(self.path, place)
        compliance = dynamic_compliance(structure, omega, len(gap) // 2)
        if isinstance(law, UnilateralConstraint):
            law = UnilateralConstraint(default_weight(compliance))
        found = {name: float(self[name][place]) for name in COLUMNS if self[name].dtype.kind == "f"}
        solution = PeriodicSolution(
            structure,
            omega,
            law,
            compliance.displacement(force),
            gap,
            force,
            status=str(self["status"][place]),
            iterations=int(self["iterations"][place]),
            report=ErrorReport(
                residual=found["residual_error"],
                truncation=found["truncation_error"],
                sampling=found["sampling_error"],
                reduction=found["reduction_error"],
                penetration=found["penetration_share"],
            ),
        )
        compliance.destroy()
        return solution

    def _place(self, index: tuple[int, ...] | int) -> tuple[int, ...]:
        """The place of a case that converged."""
        try:
            given = index if isinstance(index, tuple) else np.unravel_index(index, self.shape)
            place = tuple(int(at) for at in given)
            solved = len(place) == len(self.shape) and bool(self.converged[place])
        except (IndexError, ValueError, TypeError):
            solved = False
        if not solved:
            raise InputError("index", index, f"that of a case that converged, of {self.shape}")
        return tuple(at % size for at, size in zip(place, self.shape, strict=True))


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit not in ("", "1") else name
