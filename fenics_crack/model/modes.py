"""Natural modes by SLEPc, and damping on them.

    K phi_j = omega_j^2 M phi_j,     phi_i^T M phi_j = delta_ij

Modes come from shift-and-invert with the factor of K, which static responses use too. If K is
singular, the shift lies slightly below zero, so that rigid-body modes are found too. With a bonded
crack, all vectors have B^T phi = 0 (:mod:`fenics_crack.model.factor`):

    x = K^-1 r - K^-1 B S^-1 B^T K^-1 r,        S = B^T K^-1 B

Modal damping is C = M Phi diag(2 xi_j omega_j) Phi^T M.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from petsc4py import PETSc
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from fenics_crack.basics.errors import (
    N_NATURAL_MODES_PER_CRACK_STATE,
    ConvergenceError,
    InputError,
    check_choice,
)
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import gather_rows, import_slepc
from fenics_crack.basics.tables import Tabular, add_frequency_entries, format_count, hertz_property
from fenics_crack.kernel import kernel
from fenics_crack.model.factor import MATRIX_ZERO_TOLERANCE, MAX_BLOCK_COLUMNS, Factor, factored_sum
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping, Structure
from fenics_crack.numerics.equations import MACHINE_EPSILON, ROUNDING

LIP_STATES = ("open", "tied")
"""States of the crack faces in natural modes: without contact, or bonded."""
ROUNDING_ADVICE = (
    "the structure is too slender, or held too weakly, for the rounding of its stiffness; make it "
    "thicker, or the ligament beside a crack wider"
)
"""Advice in errors for modes that are lost in rounding."""
ZERO_TOLERANCE: float = kernel.ZERO_TOLERANCE
"""Relative size that counts as zero, 1e-14.

Three numbers are compared with a larger one: omega^2 of a mode phi with the sum of K_ii phi_i^2,
with the stiffness K; the residual flexibility of a force with the flexibility of the modes; and a
gap with the largest gap.
"""
STIFFNESS_SOLUTION_ROUNDING = ROUNDING
"""Rounding error, 1e-12, of solutions with the stiffness, relative to the largest.

Smaller relative eigenvalues of compliances and Gram matrices count as zero. So do gaps of crack
faces that the load presses together.
"""
MULTIPLE_FREQUENCY_TOLERANCE = math.sqrt(STIFFNESS_SOLUTION_ROUNDING)
"""Relative difference of frequencies that count as equal, 1e-6.

In the matching of open and bonded modes, it is also the weight of the modes' order against the
weight 1 of an equal shape.
"""


@dataclass(frozen=True, repr=False)
class Modes(Tabular):
    """Natural frequencies and mode shapes.

    With the stiffness K and the mass M, the shapes phi_j fulfil

        K phi_j = omega_j^2 M phi_j,     phi_i^T M phi_j = delta_ij

    Attributes
    ----------
    omega : (count,) [rad/s]
        Natural angular frequencies, ascending.
    shapes : (n_local, count) [kg^-1/2]
        Mass-normalised shapes phi_j as columns. The sign makes the largest component positive.
        Among equally large components, the first by position counts.
    structure : Structure
        Structure that vibrates.
    """

    omega: np.ndarray
    shapes: np.ndarray
    structure: Structure

    KIND: ClassVar[str] = "set of modes"
    frequency = hertz_property()

    def function(self, index: int) -> Any:
        """Return the shape of ``omega[index]`` as DOLFINx's Function (collective)."""
        max_allowed_index = len(self.omega) - 1
        if not isinstance(index, Integral) or not 0 <= index <= max_allowed_index:
            raise InputError("index", index, f"a whole number from 0 to {max_allowed_index}")
        return self.structure.function(self.shapes[:, index])

    def to_dict(self) -> dict[str, Any]:
        """Return the columns of a table with a row for every mode.

        The columns are the number of the mode from 1, omega [rad/s] and frequency [Hz].
        """
        mode_numbers = list(range(1, len(self.omega) + 1))
        return add_frequency_entries({"mode": mode_numbers, "omega": self.omega.tolist()})

    def _repr_text(self) -> str:
        omega_range = " to ".join(f"{omega:.6g}" for omega in self.omega[[0, -1]])
        n_dofs = self.structure.n_dofs
        return f"{format_count(len(self.omega), 'mode')}, {omega_range} rad/s, of {n_dofs} dofs"


def solve_modes(structure: Structure, count: int, *, lips: str = "open") -> Modes:
    """Find the lowest natural modes with all cracks open or bonded (collective).

    Open faces pass through each other. Bonded faces have no relative normal motion, whatever the
    clearance: B^T phi = 0 with the gap matrix B and the shape phi. Bonded faces slide without
    friction, so the structure is a little softer than without a crack. Let w_open and w_tied be a
    mode's frequencies with the crack open and bonded. A breathing crack without clearance resonates
    near 2 w_open w_tied / (w_open + w_tied).

    A structure with massless crack faces has the modes to which it was reduced. Its bonded modes
    are as accurate as the reduction.

    Parameters
    ----------
    structure : Structure
        Structure that vibrates. Load, clearance and damping do not matter.
    count : int
        Number of modes.
    lips : "open" or "tied"
        State of all cracks' faces: open or bonded.

    Returns
    -------
    Modes
        Frequencies in ascending order, and mass-normalised shapes.

    Raises
    ------
    InputError
        ``lips`` is neither word, or the stiffness has a negative eigenvalue. Or ``count`` is not
        between 1 and the number of modes. With an open crack, this number is the number of dofs
        with mass. Each independent bond of a bonded crack takes a mode away.
    ConvergenceError
        SLEPc found fewer modes than requested, or the lowest frequency of a clamped mesh is lost in
        rounding.

    Examples
    --------
    >>> modes = fc.solve_modes(structure, 3, lips="tied")
    """
    check_choice("lips", lips, LIP_STATES)
    is_bonded = lips == "tied" and structure.n_pairs > 0
    omega_and_shapes = structure.known_omega_and_shapes(is_bonded=is_bonded)
    ties = find_independent_ties(structure) if is_bonded and omega_and_shapes is None else None
    limit_text = "n_dofs" if omega_and_shapes is None else "n_modes"
    if is_bonded:
        limit_text = "the number of bonded modes"
    allowed_count = (
        len(omega_and_shapes[0])
        if omega_and_shapes is not None
        else _count_modes_minus_ties(structure, ties)
    )
    is_integer = isinstance(count, Integral) and not isinstance(count, bool)
    if not (is_integer and 1 <= count <= allowed_count):
        raise InputError("count", count, f"a whole number from 1 to {limit_text} = {allowed_count}")
    if omega_and_shapes is not None:
        omega, shapes = omega_and_shapes
        return Modes(omega[:count], shapes[:, :count], structure)
    if ties is None and (cached_modes := find_known_modes_or_none(structure, count)) is not None:
        return cached_modes
    with Factor(structure.stiffness, definite=True) as factored_stiffness:
        return solve_modes_with_factor(factored_stiffness, structure, int(count), ties)


def count_bonded_modes(structure: Structure) -> int:
    """Return the number of modes that a structure has with a bonded crack (collective).

    Each bond B^T u = 0 that is independent of the others takes one mode away. In a structure with
    massless crack faces, a bond with residual flexibility takes none.
    """
    if structure.n_pairs == 0:
        return structure.n_modes
    omega_and_shapes = structure.known_omega_and_shapes(is_bonded=True)
    return (
        len(omega_and_shapes[0])
        if omega_and_shapes is not None
        else _count_modes_minus_ties(structure, find_independent_ties(structure))
    )


def find_independent_ties(structure: Structure) -> sparse.csc_matrix:
    """Select contact pairs whose bonds are linearly independent (collective).

    Pairs may share nodes. The bonds B^T u = 0 then have redundant rows, which are left out.

    Returns
    -------
    (n_local, n_ties)
        Selected columns of the gap matrix B, with the rows of this rank.
    """
    normal_gap_matrix = sparse.csc_matrix(structure.gap)
    gram_matrix = structure.sum_over_ranks((normal_gap_matrix.T @ normal_gap_matrix).toarray())
    gram_diagonal = np.diag(gram_matrix)
    if np.all(gram_diagonal > 0.0) and np.count_nonzero(gram_matrix) == len(gram_matrix):
        return normal_gap_matrix  # orthogonal: no two pairs share a node
    upper_factor, pivot_order = scipy.linalg.qr(gram_matrix, mode="r", pivoting=True)
    pivot_sizes = np.abs(np.diag(upper_factor))
    allowed_rounding = 10.0 * len(gram_matrix) * MACHINE_EPSILON * pivot_sizes.max(initial=0.0)
    return normal_gap_matrix[:, np.sort(pivot_order[pivot_sizes > allowed_rounding])]


def _count_modes_minus_ties(structure: Structure, ties: Any) -> int:
    """Return the number of modes of a structure in which every dof has mass.

    With a bonded crack, the number is n_dofs - n_ties. ``ties`` (n_local, n_ties) are the bonds;
    None: the crack is open, and the number is n_dofs.
    """
    return structure.n_dofs - (0 if ties is None else int(ties.shape[1]))


class StiffnessInverse(Protocol):
    """Interface of solvers K x = r with the stiffness K, such as a :class:`Factor`."""

    n_null_pivots: int
    """Dimension of the stiffness's null space."""

    def apply(self, rhs: Any, solution: Any) -> None:
        """Solve K x = ``rhs`` for a PETSc vector, into ``solution`` (collective)."""


class BondedStiffnessInverse:
    """Solver K x = r with a bonded crack, B^T x = 0.

    ``factor`` solves with the stiffness K of an open crack. ``ties`` (n_local, n_ties) are
    independent columns of the gap matrix B (:func:`find_independent_ties`):

        x = K^-1 r - K^-1 B S^-1 B^T K^-1 r,        S = B^T K^-1 B
    """

    def __init__(self, stiffness_factor: Any, structure: Structure, ties: Any) -> None:
        self.n_null_pivots = stiffness_factor.n_null_pivots
        self._factor, self._ties = stiffness_factor, ties.T
        self._sum_over_ranks = structure.sum_over_ranks
        if not self.n_null_pivots:
            self._tie_responses = stiffness_factor.solve(self._ties)
            tie_flexibility = self._sum_over_ranks(self._ties @ self._tie_responses.T)
            self._compliance_factor = scipy.linalg.cho_factor(tie_flexibility)

    def apply(self, rhs: Any, solution: Any) -> None:
        """Solve K x = ``rhs`` under the bonds B^T x = 0, into ``solution`` (collective).

        Both arguments are PETSc vectors.
        """
        self._factor.apply(rhs, solution)
        tie_gap = self._sum_over_ranks(self._ties @ solution.array_r)
        solution.array_w[:] -= (
            scipy.linalg.cho_solve(self._compliance_factor, tie_gap) @ self._tie_responses
        )


def solve_modes_with_factor(
    stiffness_inverse: StiffnessInverse, structure: Structure, n_modes: int, ties: Any = None
) -> Modes:
    """Find the lowest modes of a structure, given the inverse of its stiffness (collective).

    Every dof of the structure has mass. Modes with an open crack that were computed before are
    returned again.

    Parameters
    ----------
    stiffness_inverse : StiffnessInverse
        Factor of the stiffness with an open crack.
    structure : Structure
        Structure that vibrates.
    n_modes : int
        Number of modes.
    ties : (n_local, n_ties), optional
        Bonds of the crack, from :func:`find_independent_ties`. Default: the crack is open.

    Raises
    ------
    InputError
        The stiffness has a negative eigenvalue.
    ConvergenceError
        SLEPc found fewer modes, or the lowest frequency of a clamped mesh is lost in rounding.
    """
    if ties is None and (cached_modes := find_known_modes_or_none(structure, n_modes)) is not None:
        return cached_modes
    diagonal_quotients = (
        structure.stiffness.getDiagonal().array_r / structure.mass.getDiagonal().array_r
    )
    diagonal_quotients = gather_rows(structure.comm, diagonal_quotients)  # [rad^2/s^2]
    square_scale = float(np.min(diagonal_quotients[diagonal_quotients > 0.0], initial=np.inf))
    square_scale = square_scale if np.isfinite(square_scale) else 1.0
    begin_stage(format_count(n_modes, "natural mode"))
    used_inverse: StiffnessInverse = (
        stiffness_inverse
        if ties is None
        else BondedStiffnessInverse(stiffness_inverse, structure, ties)
    )
    known_modes = None
    if ties is None:
        known_modes = structure.compute_once(_make_empty_modes_list, from_matrices=True) or None
    n_requested_modes, available_count = n_modes, _count_modes_minus_ties(structure, ties)
    while True:
        squared_omegas, shapes = _find_modes_near_zero_omega(
            used_inverse, structure, n_requested_modes, square_scale, ties, known_modes
        )
        if squared_omegas[0] < -1e-8 * square_scale:
            negative_square_text = f"{squared_omegas[0]:.3g} = omega^2 of a mode"
            raise InputError(
                "stiffness",
                negative_square_text,
                "positive semidefinite; check its sign, and that no entries are missing",
            )
        # A Krylov space holds one mode of a multiple frequency until rounding brings in the
        # others. So count the frequencies below the highest one; if any is missing, ask for more.
        squared_omega_bound = squared_omegas[n_modes - 1] - 1e-6 * max(
            squared_omegas[n_modes - 1], 0.01 * square_scale
        )
        n_found_modes_below_bound = np.sum(squared_omegas < squared_omega_bound)
        if (
            n_requested_modes == available_count
            or count_modes_below(structure, squared_omega_bound, ties) <= n_found_modes_below_bound
        ):
            break
        n_requested_modes = min(2 * n_requested_modes + 2, available_count)
    squared_omegas, shapes = squared_omegas[:n_modes], shapes[:, :n_modes]
    # Rounding of K is relative to the sum of K_ii phi_i^2, omega^2 if each dof moved alone. The
    # largest K_ii / M_ii is no measure: elements that shrink towards a tip make it arbitrarily
    # large, while a low mode moves them hardly more than others.
    single_dof_squares = structure.sum_over_ranks(
        structure.stiffness.getDiagonal().array_r @ shapes**2
    )
    squared_omegas[
        squared_omegas <= ZERO_TOLERANCE * np.maximum(single_dof_squares, square_scale)
    ] = 0.0
    if squared_omegas[0] == 0.0 and structure.clamp is not None:  # no part of a mesh is without one
        raise ConvergenceError(
            f"modes: the lowest frequency is lost in rounding: {ROUNDING_ADVICE}"
        )
    omega = np.sqrt(squared_omegas)
    shapes *= _signs_for_positive_largest_component(structure, shapes)
    if ties is None:
        structure.compute_once(_make_empty_modes_list, from_matrices=True)[:] = omega, shapes
    return Modes(omega, shapes, structure)


def find_known_modes_or_none(structure: Structure, n_modes: int) -> Modes | None:
    """Return the lowest ``n_modes`` modes with an open crack, if known without a solver.

    Modes are known if the structure is reduced to modes, or if at least ``n_modes`` were computed
    before. Otherwise the result is None.
    """
    if structure.whole is not structure:  # small and dense
        if (omega_and_shapes := structure.known_omega_and_shapes(is_bonded=False)) is not None:
            return Modes(omega_and_shapes[0][:n_modes], omega_and_shapes[1][:, :n_modes], structure)
    cached_omega_and_shapes = structure.compute_once(_make_empty_modes_list, from_matrices=True)
    if not cached_omega_and_shapes or len(cached_omega_and_shapes[0]) < n_modes:
        return None
    return Modes(
        cached_omega_and_shapes[0][:n_modes], cached_omega_and_shapes[1][:, :n_modes], structure
    )


def _make_empty_modes_list(structure: Structure) -> list[np.ndarray]:
    """Return an empty list, in which a structure caches modes with an open crack.

    After the first computation, the list is [omega, shapes] with the largest number of modes so
    far. The list does not refer to ``structure``, which would keep the structure in memory.
    """
    return []


def _make_eigenvalue_solver(
    structure: Structure, option_prefix: str, n_modes: int, n_krylov_vectors: int
) -> Any:
    """Make SLEPc's solver for the modes K phi = omega^2 M phi (collective).

    Parameters
    ----------
    structure : Structure
        Gives the stiffness K and the mass M.
    option_prefix : str
        Beginning of the names of PETSc options for this solver.
    n_modes : int
        Number of modes to find.
    n_krylov_vectors : int
        Number of basis vectors in the iteration, at most the number of dofs.
    """
    eigenvalue_solver = import_slepc().EPS().create(structure.comm)
    eigenvalue_solver.setOptionsPrefix(option_prefix)
    eigenvalue_solver.setOperators(structure.stiffness, structure.mass)
    eigenvalue_solver.setProblemType(eigenvalue_solver.ProblemType.GHEP)
    eigenvalue_solver.setDimensions(n_modes, min(structure.n_dofs, n_krylov_vectors))
    eigenvalue_solver.getST().getKSP().setType("preonly")
    return eigenvalue_solver


def _run_solver_or_raise(eigenvalue_solver: Any, n_modes: int) -> None:
    """Run SLEPc's solver; raise ConvergenceError if fewer than ``n_modes`` converge."""
    eigenvalue_solver.setFromOptions()
    try:
        eigenvalue_solver.solve()
    except PETSc.Error as error:  # rounding leaves the mass indefinite in what SLEPc spans
        eigenvalue_solver.destroy()
        raise ConvergenceError(f"modes: SLEPc cannot find {n_modes}: {ROUNDING_ADVICE}") from error
    n_converged = eigenvalue_solver.getConverged()
    if n_converged < n_modes:
        eigenvalue_solver.destroy()
        raise ConvergenceError(
            f"modes: only {n_converged} of {n_modes} converged: {ROUNDING_ADVICE}"
        )


def _find_modes_near_zero_omega(
    stiffness_inverse: StiffnessInverse,
    structure: Structure,
    n_modes: int,
    square_scale: float,
    ties: Any,
    known_modes: Sequence[np.ndarray] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the modes closest to zero frequency, with the inverse of K (collective).

    If the stiffness K is singular, K + s M is factored instead, with the mass M and the shift s of
    1e-6 ``square_scale``. ``square_scale`` [rad^2/s^2] is the smallest positive K_ii / M_ii.
    ``ties`` bond the crack (:func:`find_independent_ties`); None: it is open. ``known_modes`` are
    frequencies and shapes of lower modes, if known.

    Returns
    -------
    (n_modes,) [rad^2/s^2]
        omega^2, ascending.
    (n_local, n_modes)
        Shapes.
    """
    if not stiffness_inverse.n_null_pivots:
        squared_omegas, shapes = _find_squared_omegas_and_shapes_near_shift(
            stiffness_inverse, structure, n_modes, 0.0, known_modes
        )
        if (
            squared_omegas[0] > MATRIX_ZERO_TOLERANCE * square_scale
        ):  # a singular K may give values below 0
            return squared_omegas, shapes
    squared_omega_shift = -1e-6 * square_scale
    shifted_factor = factored_sum(
        structure.stiffness, -squared_omega_shift, structure.mass, definite=True, border=ties
    )
    with shifted_factor as shifted_inverse:
        return _find_squared_omegas_and_shapes_near_shift(
            shifted_inverse, structure, n_modes, squared_omega_shift, known_modes
        )


def n_krylov_vectors(n_modes: int) -> int:
    """Return how many basis vectors SLEPc's iteration uses for ``n_modes`` modes.

    For n modes, SLEPc's default is the larger of 2 n and n + 15. Above 150 modes, n + 150 vectors
    are as quick, and need less memory.
    """
    return max(min(2 * n_modes, n_modes + 150), n_modes + 15)


def _find_squared_omegas_and_shapes_near_shift(
    shifted_inverse: StiffnessInverse,
    structure: Structure,
    n_modes: int,
    squared_omega_shift: float,
    known_modes: Sequence[np.ndarray] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the modes whose omega^2 is closest to a shift [rad^2/s^2] (collective).

    ``shifted_inverse`` solves (K - s M) x = r with the stiffness K, the mass M and the shift s. s
    is ``squared_omega_shift``. With ``known_modes``, frequencies and shapes of the lowest modes,
    only the others are computed, orthogonal to these.

    Returns
    -------
    (n_modes,) [rad^2/s^2]
        omega^2, ascending.
    (n_local, n_modes)
        Mass-normalised shapes.
    """
    if known_modes is None or structure.n_dofs < n_krylov_vectors(n_modes):  # no room beside them
        known_modes = np.zeros(0), np.zeros((structure.n_local, 0))
    known_omega, known_shapes = known_modes
    n_new_modes = n_modes - len(known_omega)
    eigenvalue_solver = _make_eigenvalue_solver(
        structure, "crack_modes_", n_new_modes, n_krylov_vectors(n_new_modes)
    )
    known_vectors = [structure.mass.createVecRight() for _ in known_omega]
    for known_vector, known_shape in zip(known_vectors, known_shapes.T, strict=True):
        known_vector.array_w[:] = known_shape
    eigenvalue_solver.setDeflationSpace(known_vectors)
    eigenvalue_solver.setWhichEigenpairs(eigenvalue_solver.Which.TARGET_MAGNITUDE)
    eigenvalue_solver.setTolerances(1e-12, 500)
    eigenvalue_solver.setTarget(squared_omega_shift)
    spectral_transform = eigenvalue_solver.getST()
    spectral_transform.setType(spectral_transform.Type.SINVERT)
    # K - shift M is not formed again.
    spectral_transform.setMatMode(spectral_transform.MatMode.SHELL)
    eigenvalue_solver.setPurify(False)  # only a singular mass needs it, and it costs orthogonality
    preconditioner = spectral_transform.getKSP().getPC()
    preconditioner.setType("python")
    preconditioner.setPythonContext(
        SimpleNamespace(apply=lambda _, rhs, solution: shifted_inverse.apply(rhs, solution))
    )
    _run_solver_or_raise(eigenvalue_solver, n_new_modes)
    vector, mass_vector = structure.mass.createVecs()
    squared_omegas = np.array(
        [eigenvalue_solver.getEigenvalue(index).real for index in range(n_new_modes)]
    )
    ascending_order = np.argsort(squared_omegas)
    shapes = np.empty((n_new_modes, structure.n_local))
    for row, index in zip(shapes, ascending_order, strict=True):
        eigenvalue_solver.getEigenvector(int(index), vector)
        structure.mass.mult(vector, mass_vector)
        row[:] = vector.array_r / np.sqrt(max(vector.dot(mass_vector), 1e-300))
    # Python would keep the context, and with it K, until PETSc frees its garbage.
    for petsc_object in (
        *known_vectors,
        vector,
        mass_vector,
        eigenvalue_solver,
        spectral_transform,
        preconditioner,
    ):
        petsc_object.destroy()
    all_squared_omegas = np.append(known_omega**2, squared_omegas[ascending_order])
    all_shapes = np.hstack([known_shapes, shapes.T])
    # Rounding may exchange neighbours.
    final_order = np.argsort(all_squared_omegas, kind="stable")
    return all_squared_omegas[final_order], all_shapes[:, final_order]


def count_modes_below(structure: Structure, squared_omega: float, ties: Any = None) -> int:
    """Return the number of modes with omega^2 < ``squared_omega`` (collective).

    The number equals that of negative pivots in K - ``squared_omega`` M (Sylvester's law of
    inertia). ``ties`` (n_local, n_ties) bond the crack (:func:`find_independent_ties`); None: it is
    open.
    """
    with factored_sum(
        structure.stiffness, -squared_omega, structure.mass, border=ties
    ) as factored_matrix:
        return int(factored_matrix.n_negative_pivots)


def find_largest_natural_omega(structure: Structure) -> float:
    """Return the largest natural angular frequency [rad/s], to 1e-6 (collective)."""
    eigenvalue_solver = _make_eigenvalue_solver(structure, "crack_largest_", 1, 30)
    eigenvalue_solver.setWhichEigenpairs(eigenvalue_solver.Which.LARGEST_REAL)
    eigenvalue_solver.setTolerances(1e-6, 1000)
    preconditioner = eigenvalue_solver.getST().getKSP().getPC()
    preconditioner.setType("cholesky")
    preconditioner.setFactorSolverType("mumps")
    _run_solver_or_raise(eigenvalue_solver, 1)
    squared_omega = eigenvalue_solver.getEigenvalue(0).real
    eigenvalue_solver.destroy()
    return float(np.sqrt(squared_omega))


def multiply_columns(matrix: Any, columns: np.ndarray) -> np.ndarray:
    """Multiply a PETSc matrix with columns (n_local, m): the same shape (collective)."""
    product_columns = np.empty(columns.shape)
    for start_column in range(0, columns.shape[1], MAX_BLOCK_COLUMNS):
        column_block = np.array(
            columns[:, start_column : start_column + MAX_BLOCK_COLUMNS], order="F"
        )
        block_matrix_sizes = (matrix.sizes[1], (PETSc.DECIDE, column_block.shape[1]))
        block_matrix = PETSc.Mat().createDense(
            block_matrix_sizes, array=column_block, comm=matrix.comm
        )
        block_matrix.assemble()
        product_matrix = matrix.matMult(block_matrix)
        product_columns[:, start_column : start_column + MAX_BLOCK_COLUMNS] = (
            product_matrix.getDenseArray()
        )
        block_matrix.destroy()
        product_matrix.destroy()
    return product_columns


def orthonormalise_against_basis(
    structure: Structure, matrix: Any, basis: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Orthogonalise columns against a basis and each other (collective).

    Each column x is first scaled to x^T A x = 1. The result has fewer columns if columns are nearly
    dependent: directions with an eigenvalue of the Gram matrix up to 1e-12 are left out. Static
    responses given as columns then have relative errors up to 1e-6, and compliances up to 1e-12.

    Parameters
    ----------
    matrix : PETSc.Mat
        A, symmetric: columns x and y are orthogonal if x^T A y = 0.
    basis : (n_local, n)
        V, with V^T A V = I.
    columns : (n_local, m)
        Columns x to orthogonalise.

    Returns
    -------
    (n_local, m')
        New columns X with X^T A X = I and V^T A X = 0.
    """

    def project_columns(directions: np.ndarray) -> np.ndarray:
        """Return the inner products of directions (n_local, k) and columns, (k, m)."""
        return structure.sum_over_ranks(directions.T @ multiply_columns(matrix, columns))

    column_norms_squared = structure.sum_over_ranks(
        (columns * multiply_columns(matrix, columns)).sum(axis=0)
    )
    columns = columns / np.sqrt(np.maximum(column_norms_squared, 1e-300))
    for _ in range(2):  # once more against rounding
        columns = columns - basis @ project_columns(basis)
        gram_eigenvalues, eigenvectors = np.linalg.eigh(project_columns(columns))
        is_kept = gram_eigenvalues > STIFFNESS_SOLUTION_ROUNDING
        columns = columns @ (eigenvectors[:, is_kept] / np.sqrt(gram_eigenvalues[is_kept]))
    return columns


def _signs_for_positive_largest_component(structure: Structure, shapes: np.ndarray) -> np.ndarray:
    """Return the sign for each shape to make the largest component positive.

    A symmetric structure has several equally large components, to 1e-6. The first of these by
    position and direction is then made positive; without positions, the one with the lowest dof. So
    the signs depend neither on rounding nor on the number of ranks.

    Parameters
    ----------
    structure : Structure
        Gives the positions of the dofs.
    shapes : (n_local, count)
        Mode shapes as columns.

    Returns
    -------
    (count,)
        1 or -1 for each shape.
    """
    first_dof_of_rank = structure.first_dof
    n_key_columns = 1 if structure.nodes is None else structure.nodes.points.shape[1] + 1
    sort_keys = np.zeros((structure.n_local, n_key_columns))
    if structure.nodes is None or structure.whole is not structure:
        sort_keys[:, 0] = np.arange(first_dof_of_rank, first_dof_of_rank + structure.n_local)
    else:
        node_index_of_free_dofs, direction_index_of_free_dofs = np.nonzero(
            structure.nodes.dofs >= 0
        )
        local_row_of_free_dofs = (
            structure.nodes.dofs[node_index_of_free_dofs, direction_index_of_free_dofs]
            - first_dof_of_rank
        )
        sort_keys[local_row_of_free_dofs] = np.column_stack(
            [structure.nodes.points[node_index_of_free_dofs], direction_index_of_free_dofs]
        )
    local_largest_components = np.maximum(
        shapes.max(axis=0, initial=0.0), -shapes.min(axis=0, initial=0.0)
    )
    largest_components = np.max(gather_rows(structure.comm, local_largest_components[None]), axis=0)
    signs = np.empty(shapes.shape[1])
    for mode_index, largest_component in enumerate(largest_components):
        large_row_indices = np.flatnonzero(
            np.abs(shapes[:, mode_index]) >= (1.0 - 1e-6) * largest_component
        )
        sort_keys_and_component_signs = np.column_stack(
            [sort_keys[large_row_indices].round(12), np.sign(shapes[large_row_indices, mode_index])]
        )
        all_keys_and_signs = gather_rows(structure.comm, sort_keys_and_component_signs)
        signs[mode_index] = all_keys_and_signs[np.lexsort(all_keys_and_signs[:, -2::-1].T)[0], -1]
    return signs


@dataclass(frozen=True)
class ModesWithModalDamping:
    """Modes Phi on which modal damping acts: C = M Phi diag(damping_rates) Phi^T M.

    M is the mass, and C the damping matrix, which is never formed.

    Attributes
    ----------
    omega : (m,) [rad/s]
        Natural frequencies of the damped modes.
    damping_rates : (m,) [1/s]
        2 xi_j omega_j, with the damping ratios xi_j.
    shapes, mass_shapes : (n_local, m)
        Mass-normalised shapes Phi, and M Phi.
    """

    omega: np.ndarray
    damping_rates: np.ndarray
    shapes: np.ndarray
    mass_shapes: np.ndarray


def modes_with_modal_damping(structure: Structure) -> ModesWithModalDamping | None:
    """Return the modes on which modal damping acts (collective).

    None if the structure has Rayleigh damping, a damping matrix or no damping. The modes are
    computed once for a structure and its varied copies.

    Raises
    ------
    InputError
        The number of ratios or of modes does not fit the structure.
    """
    if not isinstance(structure.unvaried_structure.damping, ModalDamping):
        return None
    damped_modes_at_unit_factor, damping_factor = (
        structure.compute_once(_compute_modes_with_modal_damping),
        structure.damping_multiplier,
    )
    return (
        damped_modes_at_unit_factor
        if damping_factor == 1.0
        else replace(
            damped_modes_at_unit_factor,
            damping_rates=damping_factor * damped_modes_at_unit_factor.damping_rates,
        )
    )


def _compute_modes_with_modal_damping(structure: Structure) -> ModesWithModalDamping:
    """Compute the modes on which modal damping acts, and their damping rates (collective)."""
    modes = solve_modes(structure, count_damped_modes(structure))
    mass_shapes = multiply_columns(structure.mass, modes.shapes)
    damping_rates = structure.damping.rate(modes.omega**2)
    return ModesWithModalDamping(modes.omega, damping_rates, modes.shapes, mass_shapes)


def count_damped_modes(structure: Structure) -> int:
    """Return the number of modes on which the structure's modal damping acts.

    Raises
    ------
    InputError
        More modes are damped than the structure has, or the damping has too few ratios.
    """
    damping = structure.damping
    count: int = structure.n_modes if damping.modes is None else damping.modes
    if count > structure.n_modes:
        raise InputError("damping modes", count, f"at most n_dofs = {structure.n_modes}")
    damping_ratios = np.asarray(damping.ratio, dtype=float)
    if damping_ratios.ndim == 1 and len(damping_ratios) != count:
        raise InputError(
            "damping ratio",
            f"{len(damping_ratios)} ratios",
            f"one ratio, or {count} with one per mode",
        )
    return count


def damped_count_and_max_omega_or_none(structure: Structure) -> tuple[int, float] | None:
    """Count the damped modes and find the highest damped frequency (collective).

    Used to find whether undamped modes exist above the damped modes. Modes of the whole structure
    are counted for a reduced structure with a damping matrix.

    Returns
    -------
    n_damped : int
        Number of damped modes; 0 without damping.
    max_frequency : float [rad/s]
        Highest frequency of a damped mode; 0 without damping. All modes above are undamped.
    None
        Instead of both, if the highest mode is damped, or if the damping is a matrix. Rayleigh
        damping above 0 damps the highest mode.

    Raises
    ------
    InputError
        The number of damping ratios or of modes does not fit the structure.
    """
    if not isinstance(structure.damping, DampingRule | None):
        structure = structure.whole
    damping_rule = structure.damping
    if not isinstance(damping_rule, DampingRule):
        return (0, 0.0) if damping_rule is None else None
    if isinstance(damping_rule, RayleighDamping):
        return None if damping_rule.mass or damping_rule.stiffness else (0, 0.0)
    if isinstance(damping_rule.ratio, float) and damping_rule.modes in (None, structure.n_modes):
        return None if damping_rule.ratio or damping_rule.stiffness else (0, 0.0)
    modally_damped_modes = modes_with_modal_damping(structure)
    assert modally_damped_modes is not None
    # A smaller rate is rounding of a projection.
    damped_indices = np.flatnonzero(
        modally_damped_modes.damping_rates > 1e-9 * modally_damped_modes.damping_rates.max()
    )
    if not damped_indices.size:
        return 0, 0.0
    last_damped_index = int(damped_indices[-1])
    return (
        None
        if last_damped_index == structure.n_modes - 1
        else (len(damped_indices), float(modally_damped_modes.omega[last_damped_index]))
    )


def project_damping_on_modes(
    structure: Structure, mode_columns: np.ndarray, squared_omegas: np.ndarray
) -> np.ndarray:
    """Project the damping C on modes X: X^T C X (collective).

    Parameters
    ----------
    mode_columns : (n_local, m)
        X, with X^T M X = I and X^T K X = diag(squared_omegas). M is the mass and K the stiffness.
    squared_omegas : (m,) [rad^2/s^2]
        Squares of the modes' frequencies.

    Returns
    -------
    (m,) or (m, m) [1/s]
        X^T C X; the diagonal alone if all other entries are at most 1.5e-8 of its largest entry.
    """
    if isinstance(structure.damping, RayleighDamping):
        return structure.damping.rate(squared_omegas)
    projected_matrix = project_damping_on_columns(structure, mode_columns)
    diagonal_damping = np.diag(projected_matrix).copy()
    max_coupling = np.abs(projected_matrix - np.diag(diagonal_damping)).max(initial=0.0)
    allowed_rounding = np.sqrt(MACHINE_EPSILON) * np.abs(diagonal_damping).max(initial=0.0)
    return diagonal_damping if max_coupling <= allowed_rounding else projected_matrix


def project_damping_on_columns(structure: Structure, columns: np.ndarray) -> np.ndarray:
    """Project the damping C on columns X (n_local, m): X^T C X, (m, m) [kg/s] (collective)."""
    damping_rule = structure.damping
    if isinstance(damping_rule, RayleighDamping):  # without C
        damping_products = damping_rule.mass * multiply_columns(structure.mass, columns)
        damping_products += damping_rule.stiffness * multiply_columns(structure.stiffness, columns)
        return structure.sum_over_ranks(columns.T @ damping_products)
    if structure.damping_matrix is not None:
        damping_products = multiply_columns(structure.damping_matrix, columns)
        return structure.sum_over_ranks(columns.T @ damping_products)
    modally_damped_modes = modes_with_modal_damping(structure)
    if modally_damped_modes is None:
        return np.zeros((columns.shape[1], columns.shape[1]))
    modal_coordinates_of_columns = structure.sum_over_ranks(
        modally_damped_modes.mass_shapes.T @ columns
    )
    return (
        modal_coordinates_of_columns.T * modally_damped_modes.damping_rates
    ) @ modal_coordinates_of_columns


# --- with the crack open and bonded --------------------------------------------------------------

FREQUENCY_KIND_NAMES = ("open", "tied", "bilinear")
"""Kinds of natural frequencies: crack open, crack bonded, and bilinear, between both."""


@dataclass(frozen=True, repr=False)
class BilinearFrequencies(Tabular):
    """Natural frequencies of the same mode shapes with the crack open and bonded.

    The open frequencies ascend. The bonded frequencies need not: a bond may raise one mode above
    the next.

    Half a natural period with the crack open and half a natural period with the crack bonded make a
    period pi / w_o + pi / w_t. That is the bilinear frequency

        w_b = 2 w_o w_t / (w_o + w_t)

    (Shaw and Holmes, Journal of Sound and Vibration 90, 1983, 129, for one degree of freedom). It
    is exact for a bilinear oscillator without clearance, and close if one mode carries the motion.

    Attributes
    ----------
    omega_open, omega_tied : (n,), or (..., n) [rad/s]
        Frequencies w_o and w_t mode by mode; the leading axes are rotor speeds, if several. w_t is
        inf if no bonded mode belongs to an open mode.
    """

    omega_open: np.ndarray
    omega_tied: np.ndarray

    KIND: ClassVar[str] = "set of bilinear frequencies"
    frequency_open, frequency_tied = hertz_property("omega_open"), hertz_property("omega_tied")
    frequency_bilinear = hertz_property("omega_bilinear")

    @property
    def omega_bilinear(self) -> np.ndarray:
        """Bilinear frequencies 2 w_o w_t / (w_o + w_t): (..., n) [rad/s].

        w_o is a mode's frequency with the crack open, and w_t with the crack bonded.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(2.0 / (1.0 / self.omega_open + 1.0 / self.omega_tied))

    def nearest(self, omega: Any) -> dict[str, np.ndarray]:
        """Describe load frequencies by the mode with the nearest bilinear frequency.

        Parameters
        ----------
        omega : (...) [rad/s]
            Load frequencies.

        Returns
        -------
        dict
            ``mode``, the number of the mode from 1. ``omega_open``, ``omega_tied`` and
            ``omega_bilinear`` [rad/s], the mode's frequencies with the crack open, bonded, and
            breathing. ``over_open``, ``over_tied`` and ``over_bilinear``: the load frequency
            divided by each of these. Such a ratio minus 1 is a relative frequency shift. Arrays
            have the shape of ``omega``. If this object has frequencies for several rotor speeds,
            the shapes of ``omega`` and of the speeds are broadcast.
        """
        omega, omega_bilinear = np.asarray(omega, dtype=float), self.omega_bilinear
        mode_index = np.abs(omega[..., None] - omega_bilinear).argmin(axis=-1)
        n_modes = omega_bilinear.shape[-1]
        columns_by_name: dict[str, np.ndarray] = {"mode": mode_index + 1}
        for frequency_kind in FREQUENCY_KIND_NAMES:
            omega_of_kind = np.broadcast_to(
                getattr(self, f"omega_{frequency_kind}"), (*mode_index.shape, n_modes)
            )
            omega_of_kind = np.take_along_axis(omega_of_kind, mode_index[..., None], -1)[..., 0]
            columns_by_name[f"omega_{frequency_kind}"] = omega_of_kind
            with np.errstate(divide="ignore", invalid="ignore"):
                columns_by_name[f"over_{frequency_kind}"] = omega / omega_of_kind
        return columns_by_name

    def to_dict(self) -> dict[str, Any]:
        """Return the columns of a table with a row for every mode.

        The columns are the number of the mode, and omega_open, omega_tied and omega_bilinear
        [rad/s].
        """
        columns_by_name: dict[str, Any] = {"mode": list(range(1, len(self.omega_open) + 1))}
        column_names = [f"omega_{kind}" for kind in FREQUENCY_KIND_NAMES]
        return columns_by_name | {name: getattr(self, name).tolist() for name in column_names}

    def _repr_text(self) -> str:
        first_mode_text = (
            f"first {self.omega_open[0]:.6g} open, {self.omega_tied[0]:.6g} rad/s bonded"
        )
        return f"{format_count(len(self.omega_open), 'mode')}, {first_mode_text}"


def bilinear_frequencies(structure: Structure) -> BilinearFrequencies:
    """Find up to 6 lowest frequencies with the crack open and bonded (collective).

    Bonded faces slide without normal motion (:func:`fenics_crack.solve_modes`). A soft contact law
    allows normal motion, and resonances then lie lower. The frequencies are computed once for a
    structure and its varied copies.

    Parameters
    ----------
    structure : Structure
        Whole or reduced.

    Returns
    -------
    BilinearFrequencies
        Mode by mode, the open ones in ascending order [rad/s].

    Raises
    ------
    InputError, ConvergenceError
        As :func:`fenics_crack.solve_modes`.

    Examples
    --------
    >>> natural = fc.bilinear_frequencies(structure)
    >>> resonance = natural.omega_bilinear[0]
    """
    return structure.compute_once(_compute_bilinear_frequencies, from_matrices=True)


def _compute_bilinear_frequencies(structure: Structure) -> BilinearFrequencies:
    """Compute the frequencies of :func:`bilinear_frequencies` (collective)."""
    n_modes = min(N_NATURAL_MODES_PER_CRACK_STATE, structure.n_modes)
    open_modes = solve_modes(structure, n_modes)
    bonded_modes = solve_bonded_modes(structure, n_modes)
    return BilinearFrequencies(
        open_modes.omega, bonded_modes.omega[find_bonded_mode_indices(open_modes, bonded_modes)]
    )


def solve_bonded_modes(structure: Structure, count: int, factor: Factor | None = None) -> Modes:
    """Find the lowest modes with a bonded crack (collective).

    If the structure has fewer bonded modes than ``count``, the last ones have infinite frequencies
    and shapes of zero.

    Parameters
    ----------
    count : int
        Number of modes to return.
    factor : Factor, optional
        Factor of the stiffness with an open crack. Default: it is computed.
    """
    omega, shapes = np.full(count, np.inf), np.zeros((structure.n_local, count))
    if n_available := min(count, count_bonded_modes(structure)):
        if factor is None or structure.known_omega_and_shapes(is_bonded=True) is not None:
            modes = solve_modes(structure, n_available, lips="tied")
        else:
            modes = solve_modes_with_factor(
                factor, structure, n_available, find_independent_ties(structure)
            )
        omega[:n_available], shapes[:, :n_available] = modes.omega, modes.shapes
    return Modes(omega, shapes, structure)


def find_bonded_mode_indices(open_modes: Modes, bonded_modes: Modes) -> np.ndarray:
    """Find the bonded mode with the shape of each open mode (collective).

    Each bonded mode is matched at most once. As many modes as possible are matched by shape:

    - the overlap (phi_open^T M phi_tied)^2 must exceed 0.9, with the mass M and the shapes phi;
    - the bonded frequency must not be lower than the open frequency, since bonds only raise
      frequencies (Rayleigh).

    Overlaps of modes with equal frequencies, to 1e-6, are summed, because the shapes are then
    arbitrary in a common space. All modes without a match by shape are matched in ascending order.

    Parameters
    ----------
    open_modes, bonded_modes : Modes
        Modes of the same structure, at least as many bonded modes as open modes.

    Returns
    -------
    (n,) int
        Index of the bonded mode for each open mode.
    """
    bonded_mass_shapes = multiply_columns(open_modes.structure.mass, bonded_modes.shapes)
    overlaps = open_modes.structure.sum_over_ranks(open_modes.shapes.T @ bonded_mass_shapes) ** 2
    is_equal_open_frequency, is_equal_bonded_frequency = (
        np.isclose(omega[:, None], omega, rtol=MULTIPLE_FREQUENCY_TOLERANCE, atol=0.0).astype(float)
        for omega in (open_modes.omega, bonded_modes.omega)
    )
    is_bonded_slower = (
        bonded_modes.omega < (1.0 - MULTIPLE_FREQUENCY_TOLERANCE) * open_modes.omega[:, None]
    )
    is_same_shape = (
        is_equal_open_frequency @ overlaps @ is_equal_bonded_frequency > 0.9
    ) & ~is_bonded_slower
    open_mode_index_grid, bonded_mode_index_grid = np.indices(overlaps.shape)
    # A match needs a weight > 0.
    match_weights = (
        1.0
        + is_same_shape
        - MULTIPLE_FREQUENCY_TOLERANCE * (open_mode_index_grid - bonded_mode_index_grid) ** 2
    )
    matched_rows_and_columns = min_weight_full_bipartite_matching(
        sparse.csr_matrix(match_weights), maximize=True
    )
    return np.asarray(matched_rows_and_columns[1])
