"""Harmonic balance of all displacements: the block system, solved by PETSc's SNES.

The coefficients u (2H+1, n) of the displacement solve (eqs 5 to 15 in the paper)

    r(u) = A u + B b(s) - c = 0,        s = B^T u - g0,        J = A + B T B^T,

A = I x K - diag(k^2 w^2) x M + S x C follows from stiffness K, mass M and damping C. S couples the
cosine and the sine of each harmonic k by +-k w. b are the contact force's coefficients, c the
load's. b and T = db/ds follow from the integrals of the condensed form, with gaps as unknowns
(:mod:`contact_system`). J is a sparse matrix (AIJ) on the structure's ranks, and each rank has all
harmonics of its dofs. Modal damping C = M Phi diag(d) Phi^T M is dense. Its m modes add the
unknowns q = Phi^T M u to each harmonic, on the last rank.

A static compliance R_inf = W^T B may be in series with contact, as for crack faces without mass. W
has the static displacements by unit contact forces. Then s is the slow gap of the condensed form,
s = B^T u - g0 + R_inf b. With B b = c - A u the slow gap is linear in the displacement:

    s = B^T u - g0 + W^T (c - A u),        J = A + B T (B - A^T W)^T.

Unknowns are scaled by the norm of the linear solution, residuals by the norm of the load. Newton's
method takes full steps. The search begins with very soft contact, whose solution is close to the
linear one. The contact stiffness then grows up to the law's; steps in stiffness that fail are
shortened. Every iteration factors J, with 2H+1 times the unknowns of the structure. The condensed
form has the same solutions in a fraction of the time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse
from petsc4py import PETSc

from fenics_crack.balance.compliance import ComplianceModel
from fenics_crack.balance.contact_system import (
    DYNAMIC_TO_SOFT_PAIR_COMPLIANCE,
    ContactPoint,
    PeriodicMotion,
)
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.balance.solution import HarmonicBalanceSolver, PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.machine import machine_memory
from fenics_crack.basics.progress import begin_stage
from fenics_crack.model.contact import split_pairs_into_layers
from fenics_crack.model.factor import estimate_factor_bytes, local_rows, make_matrix_from_local_rows
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import count_damped_modes, modes_with_modal_damping
from fenics_crack.model.structure import ModalDamping
from fenics_crack.numerics.equations import COARSE_TOLERANCE, residual_rounding
from fenics_crack.numerics.fourier import resize_harmonics, stretch_period
from fenics_crack.numerics.newton import MAX_ITERATIONS, Snes

MAX_STIFFNESS_GROWTH_RATIO, MIN_STIFFNESS_GROWTH_RATIO = 10.0, 1.1
"""Largest and smallest ratio between the contact stiffnesses of successive solutions."""
MUMPS_WORKSPACE_PERCENT = 200
"""Work space of the solver MUMPS beyond its estimate [%].

On several ranks some Jacobians need more for their pivots than the default.
"""
BLOCK_SEARCH_REMEDY = "form = 'condensed', other harmonics, a softer contact, or more damping"
"""Advice in the error message if the block system is not solved."""


class BlockSystem(Snes):
    """Harmonic-balance equations with all displacements as unknowns (collective).

        r(u) = A u + B b(s) - c = 0

    u (2H+1, n_local) are displacement coefficients, A the dynamic stiffness and c the load. b(s)
    are the contact forces' coefficients at the slow gap s, and B distributes them to the dofs. A
    context manager frees the PETSc objects.

    Parameters
    ----------
    problem : Problem
        Problem of a structure with PETSc matrices.
    linear_displacement : (2H+1, n_local) [m]
        Solution without contact.
    history : list, optional
        Receives the residual norm |F| of every iteration.
    """

    def __init__(
        self, problem: Problem, linear_displacement: np.ndarray, history: list[float] | None = None
    ) -> None:
        structure = self.structure = problem.structure_with_pair_per_row
        self.integrals: Any = problem.integrals()
        self._shape, self._load = linear_displacement.shape, problem.load
        square_sums = np.array(
            [
                np.sum(displacement_or_load**2)
                for displacement_or_load in (linear_displacement, self._load)
            ]
        )
        linear_displacement_norm, load_norm = np.sqrt(structure.sum_over_ranks(square_sums))
        self.length_unit = float(linear_displacement_norm) or 1.0
        """Unit of the unknowns [m]: norm of the linear solution, or 1."""
        self.force_unit = float(load_norm) or float(np.max(problem.contact.stiffness))
        """Unit of the residual [N]: norm of the load, or without a load the contact stiffness."""
        self._first_dof_by_rank = np.cumsum([0, *structure.comm.allgather(structure.n_local)])
        self._scaled_shapes_and_damping_rates = np.zeros((structure.n_local, 0)), np.zeros(0)
        given_modes = modes_with_modal_damping(structure)
        if given_modes is not None:  # scaled: their coordinates are as large as the unknowns
            max_squared_mass_shape_norm = structure.sum_over_ranks(
                np.sum(given_modes.mass_shapes**2, axis=0)
            ).max()
            self._scaled_shapes_and_damping_rates = (
                given_modes.mass_shapes / math.sqrt(max_squared_mass_shape_norm),
                max_squared_mass_shape_norm * given_modes.damping_rates,
            )
        linear_coo = self._linear_jacobian_rows(problem.base_omega)
        n_pairs, n_fourier_coefficients = structure.n_pairs, len(linear_displacement)
        global_gap = sparse.vstack(structure.comm.allgather(structure.gap))
        self._pair_to_dof_force_matrix = sparse.kron(
            sparse.identity(n_fourier_coefficients), structure.gap, "csr"
        )
        self._gap_matrix_without_fast_modes = self._group_columns_by_rank(
            sparse.kron(sparse.identity(n_fourier_coefficients), global_gap.T), linear_coo.shape[1]
        )
        self._gap_at_zero_unknown = structure.gap_of(np.zeros(linear_displacement.shape))
        if problem.residual_compliance is not None:
            static_displacement_per_pair_force = all_modes(
                structure
            ).static_displacement_by_pair_forces(problem.quasi_static_above)
            linear_csr = linear_coo.tocsr()[: linear_displacement.size] * (
                self.force_unit / self.length_unit
            )
            self._gap_matrix_without_fast_modes -= (
                sparse.kron(
                    sparse.identity(n_fourier_coefficients), static_displacement_per_pair_force.T
                )
                @ linear_csr
            )
            self._gap_at_zero_unknown += self._load @ static_displacement_per_pair_force
        flat_gap_coefficient_indices = (
            np.arange(n_fourier_coefficients * n_pairs).reshape(n_fourier_coefficients, n_pairs).T
        )
        self._tangent_entry_indices = (
            np.repeat(flat_gap_coefficient_indices, n_fourier_coefficients, axis=1).ravel(),
            np.tile(flat_gap_coefficient_indices, n_fourier_coefficients).ravel(),
        )
        if self.integrals.has_coupled_pairs:  # every force depends on every gap
            self._tangent_entry_indices = tuple(
                np.indices((n_fourier_coefficients * n_pairs,) * 2).reshape(2, -1)
            )
        tangent_pattern = sparse.csr_matrix(
            (np.ones(len(self._tangent_entry_indices[0])), self._tangent_entry_indices),
            (n_fourier_coefficients * n_pairs,) * 2,
        )
        contact_pattern = (
            abs(self._pair_to_dof_force_matrix)
            @ tangent_pattern
            @ abs(self._gap_matrix_without_fast_modes)
        ).tocoo()  # absolute values do not cancel: no entry is missed
        entry_values = np.append(linear_coo.data, 0.0 * contact_pattern.data)
        entry_row_and_column_indices = (np.append(linear_coo.row, contact_pattern.row),
                         np.append(linear_coo.col, contact_pattern.col))  # fmt: skip
        jacobian = make_matrix_from_local_rows(
            sparse.coo_matrix((entry_values, entry_row_and_column_indices), linear_coo.shape),
            structure.comm,
        )
        self._linear_matrix = jacobian.duplicate(copy=True)
        self._rank_gap_matrix_without_fast_modes = self._gap_matrix_without_fast_modes[
            :, slice(*jacobian.getOwnershipRange())
        ]
        self.rounding = residual_rounding(10.0 * jacobian.norm() / math.sqrt(linear_coo.shape[1]))
        """Minimum tolerance for the residual |F| / |x|; rounding alone leaves about a tenth."""
        super().__init__(jacobian, history)
        direct_solver_preconditioner = self._snes.getKSP().getPC()
        if (
            direct_solver_preconditioner.getType() == "lu"
            and direct_solver_preconditioner.getFactorSolverType() == "mumps"
        ):
            direct_solver_preconditioner.setOperators(jacobian)
            direct_solver_preconditioner.setFactorSetUpSolverType()
            direct_solver_preconditioner.getFactorMatrix().setMumpsIcntl(
                14, MUMPS_WORKSPACE_PERCENT
            )

    def _linear_jacobian_rows(self, base_omega: float) -> sparse.coo_matrix:
        """Return this rank's rows of the dynamic stiffness, the Jacobian without contact.

        ``base_omega`` [rad/s] is the response's frequency. The matrix takes displacements
        divided by ``length_unit`` to forces divided by ``force_unit``. Rows for the amplitudes of
        damped modes are on the last rank.
        """
        structure, n_fourier_coefficients = self.structure, self._shape[0]
        mass, stiffness = (
            local_rows(petsc_matrix) for petsc_matrix in (structure.mass, structure.stiffness)
        )
        row_omegas = base_omega * ((np.arange(n_fourier_coefficients) + 1) // 2)
        # The time derivative turns sines into cosines, and cosines into sines.
        time_derivative = np.zeros((n_fourier_coefficients, n_fourier_coefficients))
        time_derivative[1::2, 2::2] = np.diag(row_omegas[1::2])
        time_derivative[2::2, 1::2] = -np.diag(row_omegas[2::2])
        dynamic_stiffness_rows = sparse.kron(
            np.eye(n_fourier_coefficients), stiffness
        ) - sparse.kron(np.diag(row_omegas**2), mass)
        if structure.damping_matrix is not None:
            dynamic_stiffness_rows += sparse.kron(
                time_derivative, local_rows(structure.damping_matrix)
            )
        length_per_force_unit, n_displacement_unknowns, (scaled_shapes, rates_for_scaled_shapes) = (
            self.length_unit / self.force_unit,
            dynamic_stiffness_rows.shape[1],
            self._scaled_shapes_and_damping_rates,
        )
        modal_damping_columns = sparse.kron(
            time_derivative[:, 1:], length_per_force_unit * rates_for_scaled_shapes * scaled_shapes
        )
        linear_rows = sparse.hstack(
            [
                self._group_columns_by_rank(
                    length_per_force_unit * dynamic_stiffness_rows, n_displacement_unknowns
                ),
                modal_damping_columns,
            ]
        )
        shapes_by_rank = structure.comm.gather(scaled_shapes, structure.comm.size - 1)
        if shapes_by_rank is not None:
            modal_projection_rows = sparse.kron(
                np.eye(n_fourier_coefficients)[1:], -np.concatenate(shapes_by_rank).T
            )
            modal_rows = [
                self._group_columns_by_rank(modal_projection_rows, n_displacement_unknowns),
                sparse.identity(modal_damping_columns.shape[1]),
            ]
            linear_rows = sparse.vstack([linear_rows, sparse.hstack(modal_rows)])
        return linear_rows.tocoo()

    def _group_columns_by_rank(
        self, matrix: sparse.spmatrix, n_new_columns: int
    ) -> sparse.csr_matrix:
        """Return a matrix with its columns in the order of PETSc's unknowns.

        Columns come ordered (Fourier coefficient, global dof). PETSc needs all columns of the first
        rank, then all of the second rank; within a rank the order stays (Fourier coefficient, dof).
        The result has ``n_new_columns`` columns; added columns are zero.
        """
        coo_matrix = matrix.tocoo()
        n_fourier_coefficients = self._shape[0]
        first_dof_by_rank = self._first_dof_by_rank
        fourier_coefficient_indices, global_dofs = np.divmod(coo_matrix.col, first_dof_by_rank[-1])
        owner_ranks = np.searchsorted(first_dof_by_rank, global_dofs, "right") - 1
        petsc_column_indices = (
            n_fourier_coefficients * first_dof_by_rank[owner_ranks]
            + fourier_coefficient_indices * np.diff(first_dof_by_rank)[owner_ranks]
            + global_dofs
            - first_dof_by_rank[owner_ranks]
        )
        return sparse.csr_matrix(
            (coo_matrix.data, (coo_matrix.row, petsc_column_indices)),
            (coo_matrix.shape[0], n_new_columns),
        )

    def _contact_jacobian_rows(self, tangent: np.ndarray) -> sparse.csr_matrix:
        """Return this rank's rows of the Jacobian's contact part, B T ds/du.

        B takes contact forces to the dofs, and u is the displacement. s is the slow gap: gap plus
        residual flexibility times contact force. T = ``tangent`` is the forces' derivative by s.
        """
        n_gap_coefficients = self._pair_to_dof_force_matrix.shape[1]
        sparse_tangent = sparse.csr_matrix(
            (tangent.ravel(), self._tangent_entry_indices), (n_gap_coefficients, n_gap_coefficients)
        )
        return sparse.csr_matrix(
            self._pair_to_dof_force_matrix @ sparse_tangent @ self._gap_matrix_without_fast_modes
        )

    def _set_linear_solver_type(self, solver: Any) -> None:
        """Choose a direct solver, MUMPS if PETSc has this package."""
        solver.getPC().setType("lu")
        if PETSc.Sys.hasExternalPackage("mumps"):
            solver.getPC().setFactorSolverType("mumps")

    def displacement(self, unknown_vector: Any) -> np.ndarray:
        """Return the displacement from a PETSc vector of unknowns: (2H+1, n_local) [m]."""
        n_entries = int(np.prod(self._shape))
        return self.length_unit * unknown_vector.array_r[:n_entries].reshape(self._shape)

    def gap_without_static_part(self, unknown: np.ndarray) -> np.ndarray:
        """Return the slow gap from this rank's unknowns: (2H+1, n_pairs) [m] (collective).

        ``unknown`` is the flat array of this rank's scaled unknowns (:meth:`scaled_unknowns_of`).
        The slow gap is the gap plus residual flexibility times contact force.
        """
        scaled_gap = self.structure.sum_over_ranks(
            self._rank_gap_matrix_without_fast_modes @ unknown
        )
        return self._gap_at_zero_unknown + self.length_unit * scaled_gap.reshape(
            self._gap_at_zero_unknown.shape
        )

    def scaled_unknowns_of(self, displacement: np.ndarray) -> np.ndarray:
        """Return this rank's scaled unknowns for a displacement (collective).

        ``displacement`` is (2H+1, n_local) [m]. The result is a flat array of the displacement
        divided by ``length_unit``. On the last rank the amplitudes of damped modes follow.
        """
        scaled_displacement, comm = displacement / self.length_unit, self.structure.comm
        modal_unknowns = self.structure.sum_over_ranks(
            scaled_displacement[1:] @ self._scaled_shapes_and_damping_rates[0]
        )
        return np.append(scaled_displacement, modal_unknowns if comm.rank == comm.size - 1 else [])

    def write_residual(self, unknown_vector: Any, residual_vector: Any) -> None:
        force = self.integrals.force(self.gap_without_static_part(unknown_vector.array_r))
        self._linear_matrix.mult(unknown_vector, residual_vector)
        contact_force_minus_load = (
            self.structure.apply_b(force) - self._load
        ).ravel() / self.force_unit
        residual_vector.array_w[: len(contact_force_minus_load)] += contact_force_minus_load

    def update_jacobian(self, unknown_vector: Any) -> None:
        forces = self.integrals.linearise(self.gap_without_static_part(unknown_vector.array_r))
        tangent = forces.tangent() if self.integrals.has_coupled_pairs else forces.tangent
        contact_part = self._contact_jacobian_rows(self.length_unit / self.force_unit * tangent)
        contact_part.resize(self.matrix.local_size[0], contact_part.shape[1])
        self._linear_matrix.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.matrix.setValuesCSR(
            contact_part.indptr, contact_part.indices, contact_part.data, addv=True
        )
        self.matrix.assemble()

    @property
    def petsc_reason_name(self) -> str:
        """PETSc's name for the reason why the last Newton steps ended."""
        reason_name_code_pairs = vars(PETSc.SNES.ConvergedReason).items()
        return next(
            reason_name
            for reason_name, reason_code in reason_name_code_pairs
            if reason_code == self._snes.getConvergedReason()
        )

    def take_full_steps(
        self, displacement: np.ndarray, stiffness_factor: float, tolerance: float
    ) -> tuple[np.ndarray, bool, int]:
        """Take full Newton steps, which are not shortened, from a displacement (collective).

        The steps solve F(x) = 0, with scaled unknowns x and scaled residual F.

        Parameters
        ----------
        displacement : (2H+1, n_local) [m]
            Displacement coefficients at which the steps begin.
        stiffness_factor : float
            Factor of the contact stiffness, above 0, at most 1.
        tolerance : float
            Maximum relative residual |F| / |x|.

        Returns
        -------
        displacement : (2H+1, n_local) [m]
            Displacement at which the steps end, converged or not.
        has_converged : bool
            True if |F| <= ``tolerance`` |x|.
        n_iterations : int
            Newton steps taken, at most 8.
        """
        self.integrals = self.integrals.with_series_softness(1.0 / stiffness_factor - 1.0)
        has_converged, n_iterations = self.solve_into_unknown_vector(
            self.scaled_unknowns_of(displacement), tolerance, MAX_ITERATIONS
        )
        if (
            has_converged and stiffness_factor == 1.0
        ):  # the error of u may be far larger than that of F
            self.solve_into_unknown_vector(self._unknown_vector.array_r.copy(), 0.0, 1)
        return self.displacement(self._unknown_vector), has_converged, n_iterations

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        self._linear_matrix.destroy()


@dataclass(frozen=True)
class BlockSolver(HarmonicBalanceSolver):
    """Solver for all displacement coefficients at once, by PETSc's SNES.

    Its block system has a block row for each harmonic: dynamic stiffness times displacement plus
    contact force less load. :meth:`solve` returns the same solutions as the solver with gaps as
    unknowns.

    Raises
    ------
    InputError
        The law has friction, or is rigid although crack faces have mass. The structure is a bladed
        disk that is not reduced. Or the block system does not fit into memory.
    """

    def __post_init__(self) -> None:
        problem, structure = self.problem, self.problem.structure
        has_unsupported_feature_by_text = {
            "with UnilateralConstraint of crack faces with mass": problem.has_projected_constraint,
            "with friction": problem.has_friction,
            "for a bladed disk that is not reduced": structure.n_sectors > 1,
        }
        for unsupported_feature_text in (
            unsupported_feature_text
            for unsupported_feature_text, is_refused in has_unsupported_feature_by_text.items()
            if is_refused
        ):
            raise InputError("form", "block", f"'condensed' {unsupported_feature_text}")
        damping_model = structure.unvaried_structure.damping
        n_unknowns = structure.n_dofs * (2 * problem.harmonics + 1)
        n_damping_modes = (
            count_damped_modes(structure) if isinstance(damping_model, ModalDamping) else 0
        )
        is_mesh_three_dimensional = (
            structure.nodes is not None and structure.nodes.points.shape[1] == 3
        )
        # Of the factors and the matrix, and of rows and columns of the modes.
        n_bytes = (
            4.0 * estimate_factor_bytes(n_unknowns, solid=is_mesh_three_dimensional)
            + 200.0 * n_unknowns * n_damping_modes
        )
        if n_bytes > 0.8 * machine_memory():
            requirement = (
                f"fewer, or form = 'condensed': form = 'block' needs {n_bytes / 2**30:.3g} GiB "
                "of memory"
            )
            raise InputError("harmonics", problem.harmonics, requirement)

    def search_point_and_wave(
        self,
        compliance_model: ComplianceModel,
        initial: PeriodicSolution | None,
        budget_fraction: float = 1.0,
    ) -> tuple[Search, ContactPoint, PeriodicMotion]:
        problem, contact_system = self.problem, self.problem.system(compliance_model)
        search = Search(
            contact_system,
            problem,
            self.residual_tolerance,
            budget_fraction,
            remedy=BLOCK_SEARCH_REMEDY,
        )
        linear_displacement = compliance_model.displacement(np.zeros(contact_system.shape))
        # The softest contact changes the gaps by at most this fraction of the load's effect.
        min_factor = (
            DYNAMIC_TO_SOFT_PAIR_COMPLIANCE
            * contact_system.integrals.mean_pair_compliance
            / np.abs(contact_system.dynamic_less_static_compliance).sum(axis=2).max()
        )
        starts_with_stiffness_factors = [(linear_displacement, min(min_factor, 1.0))]
        if initial is not None:
            n_periods_of_initial_solution = problem.subharmonic // initial.subharmonic
            initial_force = resize_harmonics(
                stretch_period(initial.force_coefficients, n_periods_of_initial_solution),
                problem.harmonics,
            )
            _, initial_force = split_pairs_into_layers(
                problem.contact, problem.structure.n_pairs, initial_force, initial_force
            )
            starts_with_stiffness_factors.insert(
                0, (compliance_model.displacement(initial_force), 1.0)
            )
        begin_stage("block system")
        with BlockSystem(problem, linear_displacement, search.snes_residual_norms) as block:
            search.tolerance = max(search.tolerance, block.rounding)
            while starts_with_stiffness_factors and not search.has_converged:
                iterations_before = search.iterations
                displacement, reached_factor = _solve_with_growing_stiffness(
                    block, search, *starts_with_stiffness_factors.pop(0)
                )
                search.has_converged = reached_factor == 1.0
                end_text = (
                    f" up to {reached_factor:.2g} of the contact stiffness, "
                    f"then {block.petsc_reason_name}"
                )
                search.append_attempt_text(
                    f"block system{'' if search.has_converged else end_text}", iterations_before
                )
            point = contact_system.linearise(
                block.gap_without_static_part(block.scaled_unknowns_of(displacement))
            )
        return search, point, problem.wave_of(displacement, point.gap, point.force)


def _solve_with_growing_stiffness(
    block: BlockSystem, search: Search, displacement: np.ndarray, first_stiffness_factor: float
) -> tuple[np.ndarray, float]:
    """Solve at growing contact stiffness, up to the law's.

    Newton's method starts with the law's stiffness times ``first_stiffness_factor``. Later starts
    are extrapolated from the last two solutions, linearly in the logarithm of the factor. If a
    later start fails, the ratio of successive factors is reduced, down to 1.1.

    Parameters
    ----------
    block : BlockSystem
        Equations for all displacements.
    search : Search
        Record of all attempts, with tolerance and iterations.
    displacement : (2H+1, n_local) [m]
        First guess for the displacement coefficients.
    first_stiffness_factor : float
        Factor of the law's stiffness for the first solution.

    Returns
    -------
    displacement : (2H+1, n_local) [m]
        Last solution.
    reached_factor : float
        Factor of the law's stiffness in this solution: 1 for the law, 0 without any solution.
    """
    reached_factor, trial_factor = 0.0, first_stiffness_factor
    stiffness_ratio, displacement_per_log_stiffness = (
        MAX_STIFFNESS_GROWTH_RATIO,
        np.zeros_like(displacement),
    )
    while reached_factor < 1.0 and stiffness_ratio >= MIN_STIFFNESS_GROWTH_RATIO:
        tolerance = (
            search.tolerance if trial_factor == 1.0 else max(COARSE_TOLERANCE, search.tolerance)
        )
        log_step = math.log(trial_factor / reached_factor) if reached_factor else 0.0
        solved_displacement, has_converged, n_iterations = block.take_full_steps(
            displacement + log_step * displacement_per_log_stiffness, trial_factor, tolerance
        )
        search.iterations += n_iterations
        if has_converged:
            displacement_per_log_stiffness = (
                (solved_displacement - displacement) / log_step
                if log_step
                else displacement_per_log_stiffness
            )
            displacement = solved_displacement
            reached_factor = trial_factor
            stiffness_ratio = min(stiffness_ratio**2, MAX_STIFFNESS_GROWTH_RATIO)
        else:
            stiffness_ratio = math.sqrt(stiffness_ratio) if reached_factor else 0.0
        trial_factor = min(stiffness_ratio * reached_factor, 1.0)
    return displacement, reached_factor


BALANCE_SOLVER_CLASS_BY_FORM: dict[str, type[HarmonicBalanceSolver]] = {
    "condensed": HarmonicBalanceSolver,
    "block": BlockSolver,
}
"""Solver class for each ``form`` of :func:`solve_harmonic_balance`."""
