"""Harmonic balance of all displacements: the block system, solved by PETSc's SNES.

The coefficients u (2H+1, n) of the displacement in the paper's order solve (eqs 5 to 15)

    r(u) = A u + B b(s) - c = 0,        s = B^T u - g0,        J = A + B T B^T,

A = I x K - diag(k^2 w^2) x M + S x C from the matrices of the structure, where S couples the cosine
and the sine of each harmonic k by +-k w; b are the coefficients of the contact force, T = db/ds,
both by the integrals of the condensed form (:mod:`contact_system`), c those of the load. J is a
sparse matrix (AIJ) on the structure's ranks: each has all harmonics of its dofs. Modal damping C =
M Phi diag(d) Phi^T M is dense: its m modes are unknowns of each harmonic, q = Phi^T M u, on the
last rank.

Where contact is seen through a static compliance R_inf = W^T B, as of crack faces without mass, s
is the slow gap of the condensed form, s = B^T u - g0 + R_inf b. With B b = c - A u it is linear in
the displacement,

    s = B^T u - g0 + W^T (c - A u),        J = A + B T (B - A^T W)^T.

Unknowns are measured by the linear solution, residuals by the load. Newton's method takes full
steps, first from the linear solution at a contact so soft that its solution is next to that, then
at stiffer and stiffer ones up to the law; steps in stiffness that fail are shortened. Every
iteration factors J, with 2H+1 times the unknowns of the structure: the condensed form has the same
solutions in a fraction of the time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse
from petsc4py import PETSc

from fenics_crack.balance.compliance import Compliance
from fenics_crack.balance.contact_system import MAX_COMPLIANCE_RATIO, ContactPoint, Wave
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin
from fenics_crack.basics.threads import machine_memory
from fenics_crack.model.factor import distributed, factor_memory, local_rows
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import check_damped_modes, damped_modes
from fenics_crack.model.structure import ModalDamping
from fenics_crack.model.wheel import Wheel
from fenics_crack.numerics.equations import COARSE_TOLERANCE, residual_rounding
from fenics_crack.numerics.fourier import resize_harmonics, stretch_period
from fenics_crack.numerics.newton import MAX_ITERATIONS, Snes

STIFFER, LEAST_STIFFER = 10.0, 1.1
"""Ratio of the contact stiffnesses of successive solutions, and the smallest that is tried."""
ROOM = 200
"""Work space of MUMPS beyond its estimate [%]: on several ranks the pivots of one J need more than
those of another, and than its default."""
REMEDY = "form = 'condensed', other harmonics, a softer contact, or more damping"


class BlockSystem(Snes):
    """The block system of a problem; a context manager (collective).

    Parameters
    ----------
    problem : Problem
        Of a structure with matrices.
    linear : (2H+1, n_local) [m]
        The solution without contact.
    history : list, optional
        As of :class:`Snes`.
    """

    def __init__(
        self, problem: Problem, linear: np.ndarray, history: list[float] | None = None
    ) -> None:
        structure = self.structure = problem.structure
        self.integrals: Any = problem.integrals()
        self._shape, self._load = linear.shape, problem.load
        squares = np.array([np.sum(part**2) for part in (linear, self._load)])
        length, load = np.sqrt(structure.sum_over_ranks(squares))
        self.length = float(length) or 1.0
        """Unit of the unknowns [m]."""
        self.force = float(load) or float(np.max(problem.contact.stiffness))
        """Unit of the residual [N]."""
        self._starts = np.cumsum([0, *structure.comm.allgather(structure.n_local)])
        self._modes = np.zeros((structure.n_local, 0)), np.zeros(0)
        modes = damped_modes(structure)
        if modes is not None:  # with coordinates as large as the unknowns
            square = structure.sum_over_ranks(np.sum(modes.mass_shapes**2, axis=0)).max()
            self._modes = modes.mass_shapes / math.sqrt(square), square * modes.rate
        part = self._linear_part(problem.base_omega)
        pairs, rows = structure.n_pairs, len(linear)
        whole = sparse.vstack(structure.comm.allgather(structure.gap))
        self._into = sparse.kron(sparse.identity(rows), structure.gap, "csr")
        self._seen = self._spread(sparse.kron(sparse.identity(rows), whole.T), part.shape[1])
        self._still_gap = structure.gap_of(np.zeros(linear.shape))
        if problem.residual is not None:
            static_response = all_modes(structure).moved_at_once(problem.cutoff)
            force_rows = part.tocsr()[: linear.size] * (self.force / self.length)
            self._seen -= sparse.kron(sparse.identity(rows), static_response.T) @ force_rows
            self._still_gap += self._load @ static_response
        place = np.arange(rows * pairs).reshape(rows, pairs).T
        self._ends = np.repeat(place, rows, axis=1).ravel(), np.tile(place, rows).ravel()
        if self.integrals.has_coupled_pairs:  # every force depends on every gap
            self._ends = tuple(np.indices((rows * pairs,) * 2).reshape(2, -1))
        pattern = sparse.csr_matrix((np.ones(len(self._ends[0])), self._ends), (rows * pairs,) * 2)
        touched = (abs(self._into) @ pattern @ abs(self._seen)).tocoo()  # where nothing cancels
        entries = np.append(part.data, 0.0 * touched.data)
        at = np.append(part.row, touched.row), np.append(part.col, touched.col)
        matrix = distributed(sparse.coo_matrix((entries, at), part.shape), structure.comm)
        self._linear = matrix.duplicate(copy=True)
        self._seen_here = self._seen[:, slice(*matrix.getOwnershipRange())]
        self.rounding = residual_rounding(10.0 * matrix.norm() / math.sqrt(part.shape[1]))
        """Smallest |F| / |x| that is asked for: rounding leaves about a tenth of it."""
        super().__init__(matrix, history)
        factors = self._snes.getKSP().getPC()
        if factors.getType() == "lu" and factors.getFactorSolverType() == "mumps":
            factors.setOperators(matrix)
            factors.setFactorSetUpSolverType()
            factors.getFactorMatrix().setMumpsIcntl(14, ROOM)

    def _linear_part(self, base_omega: float) -> sparse.coo_matrix:
        """This rank's rows of A, those of the modes on the last rank, with their units."""
        structure, rows = self.structure, self._shape[0]
        mass, stiffness = (local_rows(one) for one in (structure.mass, structure.stiffness))
        omega = base_omega * ((np.arange(rows) + 1) // 2)
        turn = np.zeros((rows, rows))  # of the derivative: from sine to cosine, and back
        turn[1::2, 2::2], turn[2::2, 1::2] = np.diag(omega[1::2]), -np.diag(omega[2::2])
        matrix = sparse.kron(np.eye(rows), stiffness) - sparse.kron(np.diag(omega**2), mass)
        if structure.damping_matrix is not None:
            matrix += sparse.kron(turn, local_rows(structure.damping_matrix))
        unit, size, (shapes, rate) = self.length / self.force, matrix.shape[1], self._modes
        damped = sparse.kron(turn[:, 1:], unit * rate * shapes)
        parts = sparse.hstack([self._spread(unit * matrix, size), damped])
        gathered = structure.comm.gather(shapes, structure.comm.size - 1)
        if gathered is not None:
            moved = sparse.kron(np.eye(rows)[1:], -np.concatenate(gathered).T)
            modal = [self._spread(moved, size), sparse.identity(damped.shape[1])]
            parts = sparse.vstack([parts, sparse.hstack(modal)])
        return parts.tocoo()

    def _spread(self, matrix: sparse.spmatrix, size: int) -> sparse.csr_matrix:
        """A matrix whose columns are the dofs of each harmonic, with columns rank by rank."""
        entries, rows, starts = matrix.tocoo(), self._shape[0], self._starts
        row, dof = np.divmod(entries.col, starts[-1])
        rank = np.searchsorted(starts, dof, "right") - 1
        place = rows * starts[rank] + row * np.diff(starts)[rank] + dof - starts[rank]
        return sparse.csr_matrix((entries.data, (entries.row, place)), (entries.shape[0], size))

    def _contact(self, tangent: np.ndarray) -> sparse.csr_matrix:
        """This rank's rows of B T B^T from T of all pairs."""
        count = self._into.shape[1]
        middle = sparse.csr_matrix((tangent.ravel(), self._ends), (count, count))
        return sparse.csr_matrix(self._into @ middle @ self._seen)

    def _choose_solver(self, solver: Any) -> None:
        solver.getPC().setType("lu")
        if PETSc.Sys.hasExternalPackage("mumps"):
            solver.getPC().setFactorSolverType("mumps")

    def displacement(self, unknown: Any) -> np.ndarray:
        """u of a vector, (2H+1, n_local) [m]."""
        count = int(np.prod(self._shape))
        return self.length * unknown.array_r[:count].reshape(self._shape)

    def slow_gap(self, unknown: np.ndarray) -> np.ndarray:
        """Return s of a vector, from this rank's rows: (2H+1, n_pairs) [m] (collective)."""
        relative_gap = self.structure.sum_over_ranks(self._seen_here @ unknown)
        return self._still_gap + self.length * relative_gap.reshape(self._still_gap.shape)

    def start(self, displacement: np.ndarray) -> np.ndarray:
        """This rank's rows of the vector of a displacement (collective)."""
        start, comm = displacement / self.length, self.structure.comm
        modal = self.structure.sum_over_ranks(start[1:] @ self._modes[0])
        return np.append(start, modal if comm.rank == comm.size - 1 else [])

    def evaluate(self, unknown: Any, target: Any) -> None:
        force = self.integrals.force(self.slow_gap(unknown.array_r))
        self._linear.mult(unknown, target)
        others = (self.structure.apply_b(force) - self._load).ravel() / self.force
        target.array_w[: len(others)] += others

    def linearise(self, unknown: Any) -> None:
        forces = self.integrals.linearise(self.slow_gap(unknown.array_r))
        tangent = forces.tangent() if self.integrals.has_coupled_pairs else forces.tangent
        added = self._contact(self.length / self.force * tangent)
        added.resize(self.matrix.local_size[0], added.shape[1])
        self._linear.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.matrix.setValuesCSR(added.indptr, added.indices, added.data, addv=True)
        self.matrix.assemble()

    @property
    def reason(self) -> str:
        """Why the last steps ended, in PETSc's words."""
        known = vars(PETSc.SNES.ConvergedReason).items()
        return next(name for name, code in known if code == self._snes.getConvergedReason())

    def take_full_steps(
        self, displacement: np.ndarray, share: float, tolerance: float
    ) -> tuple[np.ndarray, bool, int]:
        """Where full steps lead from a displacement with a share of the contact stiffness, True if
        they converged, and their number."""
        self.integrals = self.integrals.with_softness(1.0 / share - 1.0)
        converged, count = self.run(self.start(displacement), tolerance, MAX_ITERATIONS)
        if converged and share == 1.0:  # the error of u may be far larger than that of F
            self.run(self._unknown.array_r.copy(), 0.0, 1)
        return self.displacement(self._unknown), converged, count

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        self._linear.destroy()


@dataclass(frozen=True)
class BlockSolver(Solver):
    """Solver of a problem by the block system.

    Raises
    ------
    InputError
        The law has friction, or is rigid and crack faces have mass, or the structure is a wheel
        that is not reduced; or its block system does not fit into this machine.
    """

    def __post_init__(self) -> None:
        problem, structure = self.problem, self.problem.structure
        refused = {
            "with UnilateralConstraint of crack faces with mass": problem.is_projected,
            "with friction": problem.friction,
            "of a bladed disk that is not reduced": isinstance(structure, Wheel),
        }
        for words in (words for words, wrong in refused.items() if wrong):
            raise InputError("form", "block", f"'condensed' {words}")
        modal, unknowns = structure.original.damping, structure.n_dofs * (2 * problem.harmonics + 1)
        modes = check_damped_modes(structure) if isinstance(modal, ModalDamping) else 0
        solid = structure.nodes is not None and structure.nodes.points.shape[1] == 3
        # Of the factors and the matrix, and of rows and columns of the modes.
        needed = 4.0 * factor_memory(unknowns, solid=solid) + 200.0 * unknowns * modes
        if needed > 0.8 * machine_memory():
            allowed = f"fewer, or form = 'condensed': the block takes {needed / 2**30:.3g} GiB"
            raise InputError("harmonics", problem.harmonics, allowed)

    def find(
        self, compliance: Compliance, initial: PeriodicSolution | None, share: float = 1.0
    ) -> tuple[Search, ContactPoint, Wave]:
        problem, system = self.problem, self.problem.system(compliance)
        search = Search(system, problem, self.residual_tolerance, share, remedy=REMEDY)
        linear = compliance.displacement(np.zeros(system.shape))
        # The softest contact moves the gaps by this share of what the load does at most.
        softest = (
            MAX_COMPLIANCE_RATIO
            * system.integrals.unit
            / np.abs(system.dynamic_part).sum(axis=2).max()
        )
        starts = [(linear, min(softest, 1.0))]
        if initial is not None:
            times = problem.subharmonic // initial.subharmonic
            force = resize_harmonics(
                stretch_period(initial.force_coefficients, times), problem.harmonics
            )
            starts.insert(0, (compliance.displacement(force), 1.0))
        begin("block system")
        with BlockSystem(problem, linear, search.history) as block:
            search.tolerance = max(search.tolerance, block.rounding)
            while starts and not search.converged:
                iterations_before = search.iterations
                displacement, reached = _stiffened(block, search, *starts.pop(0))
                search.converged = reached == 1.0
                end = f" up to {reached:.2g} of the contact stiffness, then {block.reason}"
                search.record_attempt(
                    f"block system{'' if search.converged else end}", iterations_before
                )
            at = system.linearise(block.slow_gap(block.start(displacement)))
        return search, at, problem.wave_of(displacement, at.gap, at.force)


def _stiffened(
    block: BlockSystem, search: Search, here: np.ndarray, share: float
) -> tuple[np.ndarray, float]:
    """Return a displacement and the share of the contact stiffness, 1 for the law, up to which full
    steps lead.

    Solutions follow each other at growing shares from a first one on. Each search begins where a
    straight line through the two solutions before, over the logarithm of the share, leads.
    """
    reached, ratio, slope = 0.0, STIFFER, np.zeros_like(here)
    while reached < 1.0 and ratio >= LEAST_STIFFER:
        tolerance = search.tolerance if share == 1.0 else max(COARSE_TOLERANCE, search.tolerance)
        ahead = math.log(share / reached) if reached else 0.0
        there, converged, count = block.take_full_steps(here + ahead * slope, share, tolerance)
        search.iterations += count
        if converged:
            slope = (there - here) / ahead if ahead else slope
            here, reached, ratio = there, share, min(ratio**2, STIFFER)
        else:
            ratio = math.sqrt(ratio) if reached else 0.0
        share = min(ratio * reached, 1.0)
    return here, reached


FORMS: dict[str, type[Solver]] = {"condensed": Solver, "block": BlockSolver}
"""Solvers by the form of harmonic balance."""
