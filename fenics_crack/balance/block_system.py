"""Harmonic balance of all displacements: the block system, solved by PETSc's SNES.

The coefficients u (2H+1, n) of the displacement solve (eqs 5 to 15, in their order)

    r(u) = A u + B b(s) - c = 0,        s = B^T u - g0,        J = A + B T B^T,

A = I x K - diag(k^2 w^2) x M + S x C follows from the matrices of the structure. S couples the
cosine and the sine of each harmonic k by +-k w. b are the coefficients of the contact force and c
those of the load. b and T = db/ds follow from the integrals of the condensed form
(:mod:`contact_system`). J is a sparse matrix (AIJ) on the structure's ranks, and each rank has all
harmonics of its dofs. Modal damping C = M Phi diag(d) Phi^T M is dense. Its m modes add the
unknowns q = Phi^T M u to each harmonic, on the last rank.

With a static compliance R_inf = W^T B in series with contact, as for crack faces without mass, s is
the slow gap of the condensed form, s = B^T u - g0 + R_inf b. With B b = c - A u it is linear in the
displacement:

    s = B^T u - g0 + W^T (c - A u),        J = A + B T (B - A^T W)^T.

The linear solution is the unit of the unknowns, and the load the unit of residuals. Newton's method
takes full steps. It starts from the linear solution at very soft contact, whose solution is close.
The contact stiffness then grows up to the law; steps in stiffness that fail are shortened. Every
iteration factors J, with 2H+1 times the unknowns of the structure. The condensed form has the same
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
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.threads import machine_memory
from fenics_crack.model.factor import distribute_rows, factor_memory, local_rows
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import check_damped_modes, damped_modes
from fenics_crack.model.structure import ModalDamping
from fenics_crack.numerics.equations import COARSE_TOLERANCE, residual_rounding
from fenics_crack.numerics.fourier import resize_harmonics, stretch_period
from fenics_crack.numerics.newton import MAX_ITERATIONS, Snes

MAX_STIFFNESS_RATIO, MIN_STIFFNESS_RATIO = 10.0, 1.1
"""Ratio of successive contact stiffnesses: largest and smallest that is tried."""
MUMPS_WORKSPACE_PERCENT = 200
"""Work space of MUMPS beyond its estimate [%].

On several ranks the pivots of some J need more than those of others, and more than the default.
"""
REMEDY = "form = 'condensed', other harmonics, a softer contact, or more damping"


class BlockSystem(Snes):
    """Equations r(u) = 0 for the displacement's coefficients u (2H+1, n_local) (collective).

    A context manager frees the PETSc objects.

    Parameters
    ----------
    problem : Problem
        Problem of a structure with PETSc matrices.
    linear : (2H+1, n_local) [m]
        Solution without contact.
    history : list, optional
        As in :class:`Snes`.
    """

    def __init__(
        self, problem: Problem, linear: np.ndarray, history: list[float] | None = None
    ) -> None:
        structure = self.structure = problem.structure
        self.integrals: Any = problem.integrals()
        self._shape, self._load = linear.shape, problem.load
        squares = np.array([np.sum(coefficients**2) for coefficients in (linear, self._load)])
        length, load = np.sqrt(structure.sum_over_ranks(squares))
        self.length_unit = float(length) or 1.0
        """Unit of the unknowns [m]."""
        self.force_unit = float(load) or float(np.max(problem.contact.stiffness))
        """Unit of the residual [N]."""
        self._first_dofs = np.cumsum([0, *structure.comm.allgather(structure.n_local)])
        self._modes = np.zeros((structure.n_local, 0)), np.zeros(0)
        modes = damped_modes(structure)
        if modes is not None:  # scaled: their coordinates are as large as the unknowns
            square = structure.sum_over_ranks(np.sum(modes.mass_shapes**2, axis=0)).max()
            self._modes = modes.mass_shapes / math.sqrt(square), square * modes.modal_damping
        linear_part = self._linear_part(problem.base_omega)
        n_pairs, n_rows = structure.n_pairs, len(linear)
        global_gap = sparse.vstack(structure.comm.allgather(structure.gap))
        self._force_map = sparse.kron(sparse.identity(n_rows), structure.gap, "csr")
        self._slow_gap_map = self._reorder_columns(
            sparse.kron(sparse.identity(n_rows), global_gap.T), linear_part.shape[1]
        )
        self._constant_gap = structure.gap_of(np.zeros(linear.shape))
        if problem.residual is not None:
            static_response = all_modes(structure).static_displacement(problem.cutoff)
            force_rows = linear_part.tocsr()[: linear.size] * (self.force_unit / self.length_unit)
            self._slow_gap_map -= (
                sparse.kron(sparse.identity(n_rows), static_response.T) @ force_rows
            )
            self._constant_gap += self._load @ static_response
        entry_numbers = np.arange(n_rows * n_pairs).reshape(n_rows, n_pairs).T
        self._gap_tangent_indices = (
            np.repeat(entry_numbers, n_rows, axis=1).ravel(),
            np.tile(entry_numbers, n_rows).ravel(),
        )
        if self.integrals.has_coupled_pairs:  # every force depends on every gap
            self._gap_tangent_indices = tuple(np.indices((n_rows * n_pairs,) * 2).reshape(2, -1))
        pattern = sparse.csr_matrix(
            (np.ones(len(self._gap_tangent_indices[0])), self._gap_tangent_indices),
            (n_rows * n_pairs,) * 2,
        )
        # Absolute values do not cancel: no entry is missed.
        contact_pattern = (abs(self._force_map) @ pattern @ abs(self._slow_gap_map)).tocoo()
        entries = np.append(linear_part.data, 0.0 * contact_pattern.data)
        indices = (
            np.append(linear_part.row, contact_pattern.row),
            np.append(linear_part.col, contact_pattern.col),
        )
        matrix = distribute_rows(
            sparse.coo_matrix((entries, indices), linear_part.shape), structure.comm
        )
        self._linear_matrix = matrix.duplicate(copy=True)
        self._local_slow_gap_map = self._slow_gap_map[:, slice(*matrix.getOwnershipRange())]
        self.rounding = residual_rounding(10.0 * matrix.norm() / math.sqrt(linear_part.shape[1]))
        """Least tolerance for |F| / |x|; rounding alone leaves about a tenth."""
        super().__init__(matrix, history)
        factors = self._snes.getKSP().getPC()
        if factors.getType() == "lu" and factors.getFactorSolverType() == "mumps":
            factors.setOperators(matrix)
            factors.setFactorSetUpSolverType()
            factors.getFactorMatrix().setMumpsIcntl(14, MUMPS_WORKSPACE_PERCENT)

    def _linear_part(self, base_omega: float) -> sparse.coo_matrix:
        """Return this rank's rows of the Jacobian's linear part A.

        Units are scaled. Rows of damped modes are on the last rank.
        """
        structure, n_rows = self.structure, self._shape[0]
        mass, stiffness = (
            local_rows(operator) for operator in (structure.mass, structure.stiffness)
        )
        omega = base_omega * ((np.arange(n_rows) + 1) // 2)
        # The time derivative turns sines into cosines, and cosines into sines.
        time_derivative = np.zeros((n_rows, n_rows))
        time_derivative[1::2, 2::2] = np.diag(omega[1::2])
        time_derivative[2::2, 1::2] = -np.diag(omega[2::2])
        matrix = sparse.kron(np.eye(n_rows), stiffness) - sparse.kron(np.diag(omega**2), mass)
        if structure.damping_matrix is not None:
            matrix += sparse.kron(time_derivative, local_rows(structure.damping_matrix))
        unit, size, (shapes, rate) = (
            self.length_unit / self.force_unit,
            matrix.shape[1],
            self._modes,
        )
        damping_columns = sparse.kron(time_derivative[:, 1:], unit * rate * shapes)
        parts = sparse.hstack([self._reorder_columns(unit * matrix, size), damping_columns])
        all_shapes = structure.comm.gather(shapes, structure.comm.size - 1)
        if all_shapes is not None:
            projection = sparse.kron(np.eye(n_rows)[1:], -np.concatenate(all_shapes).T)
            modal_rows = [
                self._reorder_columns(projection, size),
                sparse.identity(damping_columns.shape[1]),
            ]
            parts = sparse.vstack([parts, sparse.hstack(modal_rows)])
        return parts.tocoo()

    def _reorder_columns(self, matrix: sparse.spmatrix, size: int) -> sparse.csr_matrix:
        """Reorder columns by harmonic and dof to columns rank by rank.

        ``size`` is the number of columns of the result.
        """
        entries, n_rows, first_dofs = matrix.tocoo(), self._shape[0], self._first_dofs
        row, dof = np.divmod(entries.col, first_dofs[-1])
        rank = np.searchsorted(first_dofs, dof, "right") - 1
        columns = (
            n_rows * first_dofs[rank] + row * np.diff(first_dofs)[rank] + dof - first_dofs[rank]
        )
        return sparse.csr_matrix((entries.data, (entries.row, columns)), (entries.shape[0], size))

    def _contact_part(self, tangent: np.ndarray) -> sparse.csr_matrix:
        """Return this rank's rows of the Jacobian's contact part, B T ds/du.

        B takes contact forces to the dofs, s is the slow gap, and T = ``tangent`` is the forces'
        derivative by s.
        """
        n_gap_rows = self._force_map.shape[1]
        gap_tangent = sparse.csr_matrix(
            (tangent.ravel(), self._gap_tangent_indices), (n_gap_rows, n_gap_rows)
        )
        return sparse.csr_matrix(self._force_map @ gap_tangent @ self._slow_gap_map)

    def _choose_solver(self, solver: Any) -> None:
        solver.getPC().setType("lu")
        if PETSc.Sys.hasExternalPackage("mumps"):
            solver.getPC().setFactorSolverType("mumps")

    def displacement(self, unknown: Any) -> np.ndarray:
        """Return the displacement u of a PETSc vector of unknowns: (2H+1, n_local) [m]."""
        n_entries = int(np.prod(self._shape))
        return self.length_unit * unknown.array_r[:n_entries].reshape(self._shape)

    def slow_gap(self, unknown: np.ndarray) -> np.ndarray:
        """Return the slow gap s from this rank's unknowns: (2H+1, n_pairs) [m] (collective)."""
        relative_gap = self.structure.sum_over_ranks(self._local_slow_gap_map @ unknown)
        return self._constant_gap + self.length_unit * relative_gap.reshape(
            self._constant_gap.shape
        )

    def vector_of(self, displacement: np.ndarray) -> np.ndarray:
        """Return this rank's unknowns for a displacement (2H+1, n_local) [m] (collective)."""
        relative_displacement, comm = displacement / self.length_unit, self.structure.comm
        modal_part = self.structure.sum_over_ranks(relative_displacement[1:] @ self._modes[0])
        return np.append(relative_displacement, modal_part if comm.rank == comm.size - 1 else [])

    def evaluate(self, unknown: Any, target: Any) -> None:
        force = self.integrals.force(self.slow_gap(unknown.array_r))
        self._linear_matrix.mult(unknown, target)
        contact_and_load = (self.structure.apply_b(force) - self._load).ravel() / self.force_unit
        target.array_w[: len(contact_and_load)] += contact_and_load

    def linearise(self, unknown: Any) -> None:
        forces = self.integrals.linearise(self.slow_gap(unknown.array_r))
        tangent = forces.tangent() if self.integrals.has_coupled_pairs else forces.tangent
        contact_part = self._contact_part(self.length_unit / self.force_unit * tangent)
        contact_part.resize(self.matrix.local_size[0], contact_part.shape[1])
        self._linear_matrix.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.matrix.setValuesCSR(
            contact_part.indptr, contact_part.indices, contact_part.data, addv=True
        )
        self.matrix.assemble()

    @property
    def reason(self) -> str:
        """Return PETSc's name for the reason why the last steps ended."""
        codes = vars(PETSc.SNES.ConvergedReason).items()
        return next(name for name, code in codes if code == self._snes.getConvergedReason())

    def take_full_steps(
        self, displacement: np.ndarray, stiffness_factor: float, tolerance: float
    ) -> tuple[np.ndarray, bool, int]:
        """Take full Newton steps from a displacement (collective).

        Parameters
        ----------
        displacement : (2H+1, n_local) [m]
        stiffness_factor : float
            Factor of the contact stiffness, from 0 to 1.
        tolerance : float
            Maximum |F| / |x|.

        Returns
        -------
        displacement : (2H+1, n_local) [m]
        has_converged : bool
        n_iterations : int
        """
        self.integrals = self.integrals.with_softness(1.0 / stiffness_factor - 1.0)
        has_converged, n_iterations = self.run(
            self.vector_of(displacement), tolerance, MAX_ITERATIONS
        )
        if (
            has_converged and stiffness_factor == 1.0
        ):  # the error of u may be far larger than that of F
            self.run(self._unknown.array_r.copy(), 0.0, 1)
        return self.displacement(self._unknown), has_converged, n_iterations

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        self._linear_matrix.destroy()


@dataclass(frozen=True)
class BlockSolver(Solver):
    """Solver of a problem by the block system.

    Raises
    ------
    InputError
        The law has friction, or is rigid although crack faces have mass. The structure is a wheel
        that is not reduced. Or the block system does not fit into memory.
    """

    def __post_init__(self) -> None:
        problem, structure = self.problem, self.problem.structure
        refusals = {
            "with UnilateralConstraint of crack faces with mass": problem.is_projected,
            "with friction": problem.friction,
            "of a bladed disk that is not reduced": structure.n_sectors > 1,
        }
        for condition in (condition for condition, is_refused in refusals.items() if is_refused):
            raise InputError("form", "block", f"'condensed' {condition}")
        damping = structure.original.damping
        n_unknowns = structure.n_dofs * (2 * problem.harmonics + 1)
        n_modes = check_damped_modes(structure) if isinstance(damping, ModalDamping) else 0
        is_solid = structure.nodes is not None and structure.nodes.points.shape[1] == 3
        # Of the factors and the matrix, and of rows and columns of the modes.
        n_bytes = 4.0 * factor_memory(n_unknowns, solid=is_solid) + 200.0 * n_unknowns * n_modes
        if n_bytes > 0.8 * machine_memory():
            requirement = f"fewer, or form = 'condensed': the block takes {n_bytes / 2**30:.3g} GiB"
            raise InputError("harmonics", problem.harmonics, requirement)

    def find(
        self, compliance: Compliance, initial: PeriodicSolution | None, share: float = 1.0
    ) -> tuple[Search, ContactPoint, Wave]:
        problem, system = self.problem, self.problem.system(compliance)
        search = Search(system, problem, self.residual_tolerance, share, remedy=REMEDY)
        linear = compliance.displacement(np.zeros(system.shape))
        # The softest contact changes the gaps by at most MAX_COMPLIANCE_RATIO of the load's effect.
        min_factor = (
            MAX_COMPLIANCE_RATIO
            * system.integrals.unit
            / np.abs(system.dynamic_part).sum(axis=2).max()
        )
        starts = [(linear, min(min_factor, 1.0))]
        if initial is not None:
            n_periods = problem.subharmonic // initial.subharmonic
            force = resize_harmonics(
                stretch_period(initial.force_coefficients, n_periods), problem.harmonics
            )
            starts.insert(0, (compliance.displacement(force), 1.0))
        begin_stage("block system")
        with BlockSystem(problem, linear, search.history) as block:
            search.tolerance = max(search.tolerance, block.rounding)
            while starts and not search.has_converged:
                iterations_before = search.iterations
                displacement, reached_factor = _raise_stiffness(block, search, *starts.pop(0))
                search.has_converged = reached_factor == 1.0
                end = f" up to {reached_factor:.2g} of the contact stiffness, then {block.reason}"
                search.record_attempt(
                    f"block system{'' if search.has_converged else end}", iterations_before
                )
            point = system.linearise(block.slow_gap(block.vector_of(displacement)))
        return search, point, problem.wave_of(displacement, point.gap, point.force)


def _raise_stiffness(
    block: BlockSystem, search: Search, displacement: np.ndarray, stiffness_factor: float
) -> tuple[np.ndarray, float]:
    """Solve at growing contact stiffness, up to that of the law.

    Each search begins on a straight line through the last two solutions, over the logarithm of the
    factor.

    Returns
    -------
    displacement : (2H+1, n_local) [m]
        Last solution.
    reached_factor : float
        Its factor of the contact stiffness; 1 for the law.
    """
    reached_factor, ratio, slope = 0.0, MAX_STIFFNESS_RATIO, np.zeros_like(displacement)
    while reached_factor < 1.0 and ratio >= MIN_STIFFNESS_RATIO:
        tolerance = (
            search.tolerance if stiffness_factor == 1.0 else max(COARSE_TOLERANCE, search.tolerance)
        )
        log_step = math.log(stiffness_factor / reached_factor) if reached_factor else 0.0
        next_displacement, has_converged, n_iterations = block.take_full_steps(
            displacement + log_step * slope, stiffness_factor, tolerance
        )
        search.iterations += n_iterations
        if has_converged:
            slope = (next_displacement - displacement) / log_step if log_step else slope
            displacement = next_displacement
            reached_factor = stiffness_factor
            ratio = min(ratio**2, MAX_STIFFNESS_RATIO)
        else:
            ratio = math.sqrt(ratio) if reached_factor else 0.0
        stiffness_factor = min(ratio * reached_factor, 1.0)
    return displacement, reached_factor


FORMS: dict[str, type[Solver]] = {"condensed": Solver, "block": BlockSolver}
"""Solver for each form of harmonic balance."""
