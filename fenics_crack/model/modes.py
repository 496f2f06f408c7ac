"""Natural modes by SLEPc, and damping on them.

    K phi_j = omega_j^2 M phi_j,     phi_i^T M phi_j = delta_ij

Shift-and-invert by the factor of K, which static responses use too. Where K is singular, the shift
lies slightly below zero, so that rigid-body modes are found too. With a bonded crack all of this
happens on the space of motions with B^T phi = 0 (:mod:`fenics_crack.model.factor`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Integral
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from petsc4py import PETSc
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from fenics_crack.basics.errors import FEW_MODES, ConvergenceError, InputError, check_choice
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import gather_rows, slepc
from fenics_crack.basics.tables import Tabular, counted, hertz_of, with_frequency
from fenics_crack.kernel import kernel
from fenics_crack.model.factor import AT_A_TIME, TOLERATED, Factor, factored_sum
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping, Structure
from fenics_crack.numerics.equations import MACHINE_EPSILON, ROUNDING

LIP_STATES = ("open", "tied")
LOST = (
    "what is too slender, or held by too little, has frequencies below the rounding of its "
    "stiffness; make it thicker, or what is left beside a crack wider"
)
AS_ZERO: float = kernel.AS_ZERO
"""Relative size that counts as zero of squares of frequencies (to sum K_ii phi_i^2), static
responses and gaps."""
NEGLIGIBLE = ROUNDING
"""Rounding of solutions with K, relative to the largest: eigenvalues of static compliances, weights
of directions in a Gram matrix, gaps of crack faces that the load presses together."""
MULTIPLE = math.sqrt(NEGLIGIBLE)
"""Relative difference of frequencies that count as one of several modes, as that of their squares
where missing ones are looked for; and what an order of numbers counts beside a shape."""


@dataclass(frozen=True, repr=False)
class Modes(Tabular):
    """Natural frequencies and mode shapes: K phi_j = omega_j^2 M phi_j, phi_i^T M phi_j = delta_ij.

    Attributes
    ----------
    omega : (count,) [rad/s]
        Natural angular frequencies, ascending.
    shapes : (n_local, count) [kg^-1/2]
        Mass-normalised; the largest component is positive (of equal ones, the first by position).
    structure : Structure
        Structure that vibrates.
    """

    omega: np.ndarray
    shapes: np.ndarray
    structure: Structure

    KIND: ClassVar[str] = "set of modes"
    frequency = hertz_of()

    def function(self, index: int) -> Any:
        """The shape of ``omega[index]`` as DOLFINx's Function, on the space of the mesh
        (collective)."""
        last = len(self.omega) - 1
        if not isinstance(index, Integral) or not 0 <= index <= last:
            raise InputError("index", index, f"a whole number from 0 to {last}")
        return self.structure.function(self.shapes[:, index])

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every mode: its number, omega [rad/s] and frequency [Hz]."""
        number = list(range(1, len(self.omega) + 1))
        return with_frequency({"mode": number, "omega": self.omega.tolist()})

    def _title(self) -> str:
        span = " to ".join(f"{omega:.6g}" for omega in self.omega[[0, -1]])
        return f"{counted(len(self.omega), 'mode')}, {span} rad/s, of {self.structure.n_dofs} dofs"


def solve_modes(structure: Structure, count: int, *, lips: str = "open") -> Modes:
    """Find the lowest natural modes of the structure, its crack faces all open or all bonded
    (collective).

    Open faces pass through each other. Bonded ones have no relative normal motion, B^T phi = 0
    whatever the clearance, and slide without friction: a little softer than the uncracked
    structure. A breathing crack without clearance resonates near 2 w_open w_tied / (w_open +
    w_tied).

    Those of a structure whose crack faces have no mass are the modes to which it was reduced;
    bonded, they are as near to those of the whole structure as the reduction.

    Parameters
    ----------
    structure : Structure
        Its M and K are taken, and its B with a bonded crack.
    count : int
        Number of modes.
    lips : "open" or "tied"
        State of the faces of all cracks.

    Returns
    -------
    Modes
        Mass-normalised, in ascending order.

    Raises
    ------
    InputError
        lips is none of these, count is not between 1 and n_dofs (less one for each pair that is
        bonded), or the number of modes with mass, or the stiffness has a negative eigenvalue.
    ConvergenceError
        SLEPc found fewer modes than requested, or the lowest frequency of a clamped mesh is lost in
        rounding.

    Examples
    --------
    >>> modes = fc.solve_modes(structure, 3, lips="tied")
    """
    check_choice("lips", lips, LIP_STATES)
    tied = lips == "tied" and structure.n_pairs > 0
    known = structure.known_modes(tied=tied)
    ties = independent_ties(structure) if tied and known is None else None
    words = "the number of bonded modes" if tied else "n_dofs" if known is None else "n_modes"
    most = len(known[0]) if known is not None else _space(structure, ties)
    whole = isinstance(count, Integral) and not isinstance(count, bool)
    if not (whole and 1 <= count <= most):
        raise InputError("count", count, f"a whole number from 1 to {words} = {most}")
    if known is not None:
        omega, shapes = known
        return Modes(omega[:count], shapes[:, :count], structure)
    if ties is None and (kept := lowest_known(structure, count)) is not None:
        return kept
    with Factor(structure.stiffness, definite=True) as factor:
        return modes_by(factor, structure, int(count), ties)


def n_tied_modes(structure: Structure) -> int:
    """Number of modes with a bonded crack (collective)."""
    if structure.n_pairs == 0:
        return structure.n_modes
    known = structure.known_modes(tied=True)
    return len(known[0]) if known is not None else _space(structure, independent_ties(structure))


def independent_ties(structure: Structure) -> sparse.csc_matrix:
    """Columns of B that are linearly independent, on this rank: (n_local, n_ties) (collective)."""
    gap = sparse.csc_matrix(structure.gap)
    gram = structure.sum_over_ranks((gap.T @ gap).toarray())
    diagonal = np.diag(gram)
    if np.all(diagonal > 0.0) and np.count_nonzero(gram) == len(gram):
        return gap  # orthogonal: no two pairs share a node
    factor, order = scipy.linalg.qr(gram, mode="r", pivoting=True)
    sizes = np.abs(np.diag(factor))
    rounding = 10.0 * len(gram) * MACHINE_EPSILON * sizes.max(initial=0.0)
    return gap[:, np.sort(order[sizes > rounding])]


def _space(structure: Structure, ties: Any) -> int:
    """Number of modes with mass everywhere."""
    return structure.n_dofs - (0 if ties is None else int(ties.shape[1]))


class Inverse(Protocol):
    """What applies the inverse of a stiffness: a :class:`Factor`, for example."""

    null_pivots: int
    """Dimension of the null space that was met."""

    def apply(self, right: Any, solution: Any) -> None:
        """Solve for a PETSc vector (collective)."""


class Bonded:
    """Inverse of a stiffness where B^T x = 0, by its factor and independent columns of B:

    x = K^-1 r - K^-1 B S^-1 B^T K^-1 r,        S = B^T K^-1 B.
    """

    def __init__(self, factor: Any, structure: Structure, ties: Any) -> None:
        self.null_pivots = factor.null_pivots
        self._factor, self._ties, self._sum = factor, ties.T, structure.sum_over_ranks
        if not self.null_pivots:
            self._moved = factor.solve(self._ties)
            flexibility = self._sum(self._ties @ self._moved.T)
            self._compliance = scipy.linalg.cho_factor(flexibility)

    def apply(self, right: Any, solution: Any) -> None:
        """Solve for a PETSc vector (collective)."""
        self._factor.apply(right, solution)
        gap = self._sum(self._ties @ solution.array_r)
        solution.array_w[:] -= scipy.linalg.cho_solve(self._compliance, gap) @ self._moved


def modes_by(factor: Inverse, structure: Structure, count: int, ties: Any = None) -> Modes:
    """The same of a structure with mass everywhere, by the factor of its stiffness; ``ties`` are
    the independent columns of B where the crack is bonded."""
    if ties is None and (kept := lowest_known(structure, count)) is not None:
        return kept
    quotients = structure.stiffness.getDiagonal().array_r / structure.mass.getDiagonal().array_r
    quotients = gather_rows(structure.comm, quotients)  # [rad^2/s^2]
    scale = float(np.min(quotients[quotients > 0.0], initial=np.inf))
    scale = scale if np.isfinite(scale) else 1.0
    begin(counted(count, "natural mode"))
    inverse: Inverse = factor if ties is None else Bonded(factor, structure, ties)
    asked, most = count, _space(structure, ties)
    while True:
        squares, shapes = _nearest_zero(inverse, structure, asked, scale, ties)
        if squares[0] < -1e-8 * scale:
            worst = f"{squares[0]:.3g} = omega^2 of a mode"
            raise InputError("stiffness", worst, "positive semidefinite")
        # A Krylov space holds one mode of a multiple frequency until rounding brings in the
        # others. So count the frequencies below the highest one; if some are missing, ask for more.
        bound = squares[count - 1] - 1e-6 * max(squares[count - 1], 0.01 * scale)
        if asked == most or count_below(structure, bound, ties) <= np.sum(squares < bound):
            break
        asked = min(2 * asked + 2, most)
    squares, shapes = squares[:count], shapes[:, :count]
    # Rounding of K is relative to sum K_ii phi_i^2, what each dof would add to omega^2 if it moved
    # alone. The largest K_ii / M_ii is no measure: elements that shrink towards a tip make it as
    # large as one likes, while a low mode moves them hardly more than others.
    alone = structure.sum_over_ranks(structure.stiffness.getDiagonal().array_r @ shapes**2)
    squares[squares <= AS_ZERO * np.maximum(alone, scale)] = 0.0
    if squares[0] == 0.0 and structure.clamp is not None:  # no part of a mesh is without one
        raise ConvergenceError(f"modes: omega^2 of the lowest is rounding of the stiffness: {LOST}")
    omega = np.sqrt(squares)
    shapes *= _signs(structure, shapes)
    if ties is None:
        structure.once(_lowest, of_matrices=True)[:] = omega, shapes
    return Modes(omega, shapes, structure)


def lowest_known(structure: Structure, count: int) -> Modes | None:
    """The lowest modes, crack open, if so many have been found before, or are its coordinates."""
    if structure.whole is not structure:  # small and dense
        if (known := structure.known_modes(tied=False)) is not None:
            return Modes(known[0][:count], known[1][:, :count], structure)
    kept = structure.once(_lowest, of_matrices=True)
    if not kept or len(kept[0]) < count:
        return None
    return Modes(kept[0][:count], kept[1][:, :count], structure)


def _lowest(structure: Structure) -> list[np.ndarray]:
    """Frequencies and shapes of the most modes of a structure requested so far, crack open; it
    is not held by them itself, which would keep it alive."""
    return []


def _solver(structure: Structure, prefix: str, count: int, krylov: int) -> Any:
    """SLEPc's solver of K phi = omega^2 M phi."""
    solver = slepc().EPS().create(structure.comm)
    solver.setOptionsPrefix(prefix)
    solver.setOperators(structure.stiffness, structure.mass)
    solver.setProblemType(solver.ProblemType.GHEP)
    solver.setDimensions(count, min(structure.n_dofs, krylov))
    solver.getST().getKSP().setType("preonly")
    return solver


def _solve(solver: Any, count: int) -> None:
    solver.setFromOptions()
    try:
        solver.solve()
    except PETSc.Error as error:  # rounding leaves the mass indefinite in what SLEPc spans
        solver.destroy()
        raise ConvergenceError(f"modes: SLEPc cannot find {count}: {LOST}") from error
    found = solver.getConverged()
    if found < count:
        solver.destroy()
        raise ConvergenceError(f"modes: only {found} of {count} converged: {LOST}")


def _nearest_zero(
    factor: Inverse, structure: Structure, count: int, scale: float, ties: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues omega^2, ascending, and shapes of the modes closest to zero, by the factor of K;
    where K is singular by that of K + s M."""
    if not factor.null_pivots:
        squares, shapes = _krylov(factor, structure, count, 0.0)
        if squares[0] > TOLERATED * scale:  # what the factor of a singular K finds may be below 0
            return squares, shapes
    shift = -1e-6 * scale
    shifted = factored_sum(structure.stiffness, -shift, structure.mass, definite=True, border=ties)
    with shifted as other:
        return _krylov(other, structure, count, shift)


def krylov_vectors(count: int) -> int:
    """Held for so many modes: SLEPc's default is twice the count; of many modes fewer are as quick,
    of few some more keep to one sweep."""
    return max(min(2 * count, count + 150), count + 15)


def _krylov(
    factor: Inverse, structure: Structure, count: int, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, ascending, and mass-normalised shapes of the modes closest to a shift, by the
    factor of K - shift M."""
    solver = _solver(structure, "crack_modes_", count, krylov_vectors(count))
    solver.setWhichEigenpairs(solver.Which.TARGET_MAGNITUDE)
    solver.setTolerances(1e-12, 500)
    solver.setTarget(shift)
    transformation = solver.getST()
    transformation.setType(transformation.Type.SINVERT)
    transformation.setMatMode(transformation.MatMode.SHELL)  # K - shift M is not formed again
    solver.setPurify(False)  # only a singular mass needs it, and it costs orthogonality
    inner = transformation.getKSP().getPC()
    inner.setType("python")
    inner.setPythonContext(SimpleNamespace(apply=lambda _, right, x: factor.apply(right, x)))
    _solve(solver, count)
    vector, moved = structure.mass.createVecs()
    squares = np.array([solver.getEigenvalue(index).real for index in range(count)])
    order = np.argsort(squares)
    shapes = np.empty((count, structure.n_local))
    for row, index in zip(shapes, order, strict=True):
        solver.getEigenvector(int(index), vector)
        structure.mass.mult(vector, moved)
        row[:] = vector.array_r / np.sqrt(max(vector.dot(moved), 1e-300))
    # Left to Python, the context would hold K until PETSc frees its garbage, and be lost there.
    for used in (vector, moved, solver, transformation, inner):
        used.destroy()
    return squares[order], shapes.T


def count_below(structure: Structure, square: float, ties: Any = None) -> int:
    """Number of modes with omega^2 < square: the negative pivots of K - square M (Sylvester)."""
    with factored_sum(structure.stiffness, -square, structure.mass, border=ties) as factor:
        return int(factor.negative_pivots)


def largest_frequency(structure: Structure) -> float:
    """Largest natural angular frequency [rad/s] (collective)."""
    solver = _solver(structure, "crack_largest_", 1, 30)
    solver.setWhichEigenpairs(solver.Which.LARGEST_REAL)
    solver.setTolerances(1e-6, 1000)
    inner = solver.getST().getKSP().getPC()
    inner.setType("cholesky")
    inner.setFactorSolverType("mumps")
    _solve(solver, 1)
    square = solver.getEigenvalue(0).real
    solver.destroy()
    return float(np.sqrt(square))


def times(matrix: Any, columns: np.ndarray) -> np.ndarray:
    """A X for a PETSc matrix and the columns of X (n_local, m) (collective)."""
    found = np.empty(columns.shape)
    for start in range(0, columns.shape[1], AT_A_TIME):
        block = np.array(columns[:, start : start + AT_A_TIME], order="F")
        whole = (matrix.sizes[1], (PETSc.DECIDE, block.shape[1]))
        right = PETSc.Mat().createDense(whole, array=block, comm=matrix.comm)
        right.assemble()
        product = matrix.matMult(right)
        found[:, start : start + AT_A_TIME] = product.getDenseArray()
        right.destroy()
        product.destroy()
    return found


def independent_part(
    structure: Structure, matrix: Any, basis: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Part of columns x (n_local, m) that is new to a basis with V^T A V = I, likewise
    (collective).

    Of columns of unit size x^T A x the directions whose weight in the Gram matrix is negligible are
    left out: of a static response no more is lost than that of its square, 1e-6, and of a
    compliance 1e-12.
    """

    def gram(rows: np.ndarray) -> np.ndarray:
        return structure.sum_over_ranks(rows.T @ times(matrix, columns))

    squares = structure.sum_over_ranks((columns * times(matrix, columns)).sum(axis=0))
    columns = columns / np.sqrt(np.maximum(squares, 1e-300))
    for _ in range(2):  # once more against rounding
        columns = columns - basis @ gram(basis)
        weights, vectors = np.linalg.eigh(gram(columns))
        kept = weights > NEGLIGIBLE
        columns = columns @ (vectors[:, kept] / np.sqrt(weights[kept]))
    return columns


def _signs(structure: Structure, shapes: np.ndarray) -> np.ndarray:
    """Signs that make the largest component positive; ties go to the first by position, then dof.

    A symmetric structure has equally large components: neither rounding may decide between them,
    nor the numbering, which depends on the number of ranks.
    """
    first = structure.first_dof
    width = 1 if structure.nodes is None else structure.nodes.points.shape[1] + 1
    keys = np.zeros((structure.n_local, width))
    if structure.nodes is None or structure.whole is not structure:
        keys[:, 0] = np.arange(first, first + structure.n_local)
    else:
        nodes, components = np.nonzero(structure.nodes.dofs >= 0)
        rows = structure.nodes.dofs[nodes, components] - first
        keys[rows] = np.column_stack([structure.nodes.points[nodes], components])
    own = np.maximum(shapes.max(axis=0, initial=0.0), -shapes.min(axis=0, initial=0.0))
    peaks = np.max(gather_rows(structure.comm, own[None]), axis=0)
    signs = np.empty(shapes.shape[1])
    for mode, peak in enumerate(peaks):
        large = np.flatnonzero(np.abs(shapes[:, mode]) >= (1.0 - 1e-6) * peak)
        candidates = np.column_stack([keys[large].round(12), np.sign(shapes[large, mode])])
        every = gather_rows(structure.comm, candidates)
        signs[mode] = every[np.lexsort(every[:, -2::-1].T)[0], -1]
    return signs


@dataclass(frozen=True)
class DampedModes:
    """Modal damping as C = M Phi diag(rate) Phi^T M.

    Attributes
    ----------
    omega : (m,) [rad/s]
        Natural frequencies of the damped modes.
    rate : (m,) [1/s]
        2 xi_j omega_j.
    shapes, mass_shapes : (n_local, m)
        Phi and M Phi.
    """

    omega: np.ndarray
    rate: np.ndarray
    shapes: np.ndarray
    mass_shapes: np.ndarray


def damped_modes(structure: Structure) -> DampedModes | None:
    """Modes that carry the structure's modal damping; None without modal damping (collective).

    They are computed once for a structure and its varied copies.

    Raises
    ------
    InputError
        The number of ratios or of modes does not fit the structure.
    """
    if not isinstance(structure.original.damping, ModalDamping):
        return None
    modes, factor = structure.once(_damped_modes), structure.damping_factor
    return modes if factor == 1.0 else replace(modes, rate=factor * modes.rate)


def _damped_modes(structure: Structure) -> DampedModes:
    modes = solve_modes(structure, check_damped_modes(structure))
    mass_shapes = times(structure.mass, modes.shapes)
    rate = structure.damping.rate(modes.omega**2)
    return DampedModes(modes.omega, rate, modes.shapes, mass_shapes)


def check_damped_modes(structure: Structure) -> int:
    """Number of modes that modal damping damps; InputError as :func:`damped_modes`."""
    damping = structure.damping
    count: int = structure.n_modes if damping.modes is None else damping.modes
    if count > structure.n_modes:
        raise InputError("damping modes", count, f"at most n_dofs = {structure.n_modes}")
    ratio = np.asarray(damping.ratio, dtype=float)
    if ratio.ndim == 1 and len(ratio) != count:
        raise InputError("damping ratio", f"{len(ratio)} ratios", f"one or {count}, one per mode")
    return count


def damped_range(structure: Structure) -> tuple[int, float] | None:
    """Number of damped modes, and the highest frequency of one [rad/s] (collective).

    None where no mode above it is left without damping, and where a damping matrix was given. Where
    projection has made a matrix of modal damping, the modes are those of the whole structure.

    Raises
    ------
    InputError
        As :func:`damped_modes`.
    """
    if not isinstance(structure.damping, DampingRule | None):
        structure = structure.whole
    rule = structure.damping
    if not isinstance(rule, DampingRule):
        return (0, 0.0) if rule is None else None
    if isinstance(rule, RayleighDamping):
        return None if rule.mass or rule.stiffness else (0, 0.0)
    if isinstance(rule.ratio, float) and rule.modes in (None, structure.n_modes):
        return None if rule.ratio else (0, 0.0)
    known = damped_modes(structure)
    assert known is not None
    found = np.flatnonzero(known.rate > 1e-9 * known.rate.max())  # not rounding of a projection
    if not found.size:
        return 0, 0.0
    last = int(found[-1])
    return None if last == structure.n_modes - 1 else (len(found), float(known.omega[last]))


def damping_in(structure: Structure, columns: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """X^T C X of columns with X^T M X = I and X^T K X = diag(squares): its diagonal (m,) where what
    couples them is rounding of a projection, else (m, m) [1/s] (collective)."""
    if isinstance(structure.damping, RayleighDamping):
        return structure.damping.rate(squares)
    coupled = projected_damping(structure, columns)
    rate = np.diag(coupled).copy()
    coupling = np.abs(coupled - np.diag(rate)).max(initial=0.0)
    rounding = np.sqrt(MACHINE_EPSILON) * np.abs(rate).max(initial=0.0)
    return rate if coupling <= rounding else coupled


def projected_damping(structure: Structure, columns: np.ndarray) -> np.ndarray:
    """X^T C X of the columns of X (n_local, m): (m, m) [kg/s] (collective)."""
    rule = structure.damping
    if isinstance(rule, RayleighDamping):  # without C
        product = rule.mass * times(structure.mass, columns)
        product += rule.stiffness * times(structure.stiffness, columns)
        return structure.sum_over_ranks(columns.T @ product)
    if structure.damping_matrix is not None:
        product = times(structure.damping_matrix, columns)
        return structure.sum_over_ranks(columns.T @ product)
    damped = damped_modes(structure)
    if damped is None:
        return np.zeros((columns.shape[1], columns.shape[1]))
    projected = structure.sum_over_ranks(damped.mass_shapes.T @ columns)
    return (projected.T * damped.rate) @ projected


# --- with the crack open and bonded --------------------------------------------------------------

KINDS = ("open", "tied", "bilinear")
"""Kinds of natural frequencies."""


@dataclass(frozen=True, repr=False)
class BilinearFrequencies(Tabular):
    """Natural frequencies with the crack open, in ascending order, and those with it bonded of the
    same shapes: the other way round where the bond takes one mode past another.

    Half a period with the crack open and half a period with it bonded, each half as long as the
    natural vibration of that state, make a period pi / w_o + pi / w_t, and so the bilinear
    frequency

        w_b = 2 w_o w_t / (w_o + w_t)

    (Shaw and Holmes, Journal of Sound and Vibration 90, 1983, 129, for one degree of freedom). It
    is exact for a bilinear oscillator without clearance, and near where one mode carries the
    motion.

    Attributes
    ----------
    omega_open, omega_tied : (n,), or (..., n) [rad/s]
        Of the modes of one shape, or at several speeds; bonded ones are infinite where there are no
        more.
    """

    omega_open: np.ndarray
    omega_tied: np.ndarray

    KIND: ClassVar[str] = "set of bilinear frequencies"
    frequency_open, frequency_tied = hertz_of("omega_open"), hertz_of("omega_tied")
    frequency_bilinear = hertz_of("omega_bilinear")

    @property
    def omega_bilinear(self) -> np.ndarray:
        """2 w_o w_t / (w_o + w_t): (..., n) [rad/s]."""
        with np.errstate(divide="ignore"):
            return np.asarray(2.0 / (1.0 / self.omega_open + 1.0 / self.omega_tied))

    def nearest(self, omega: Any) -> dict[str, np.ndarray]:
        """Describe load frequencies (...) by the mode whose bilinear frequency is nearest.

        ``mode``, its number; ``omega_open``, ``omega_tied`` and ``omega_bilinear`` of it [rad/s];
        ``over_open``, ``over_tied`` and ``over_bilinear``, the load frequency over these: one less
        is the frequency shift. Of shape (...), that of the speeds if there are several.
        """
        omega, bilinear = np.asarray(omega, dtype=float), self.omega_bilinear
        place = np.abs(omega[..., None] - bilinear).argmin(axis=-1)
        count = bilinear.shape[-1]
        found: dict[str, np.ndarray] = {"mode": place + 1}
        for name in KINDS:
            natural = np.broadcast_to(getattr(self, f"omega_{name}"), (*place.shape, count))
            natural = np.take_along_axis(natural, place[..., None], -1)[..., 0]
            found[f"omega_{name}"] = natural
            with np.errstate(divide="ignore", invalid="ignore"):
                found[f"over_{name}"] = omega / natural
        return found

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every mode."""
        columns: dict[str, Any] = {"mode": list(range(1, len(self.omega_open) + 1))}
        names = [f"omega_{kind}" for kind in KINDS]
        return columns | {name: getattr(self, name).tolist() for name in names}

    def _title(self) -> str:
        first = f"first {self.omega_open[0]:.6g} open, {self.omega_tied[0]:.6g} rad/s bonded"
        return f"{counted(len(self.omega_open), 'mode')}, {first}"


def bilinear_frequencies(structure: Structure) -> BilinearFrequencies:
    """The lowest natural frequencies, up to 6, with the crack open and bonded (collective).

    Bonded faces slide (:func:`fenics_crack.solve_modes`); a contact law of little stiffness lets
    them part, and resonances then lie lower. They are computed once for a structure and its varied
    copies.

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
    return structure.once(_bilinear_frequencies, of_matrices=True)


def _bilinear_frequencies(structure: Structure) -> BilinearFrequencies:
    count = min(FEW_MODES, structure.n_modes)
    is_open, tied = solve_modes(structure, count), tied_modes(structure, count)
    return BilinearFrequencies(is_open.omega, tied.omega[partners(is_open, tied)])


def tied_modes(structure: Structure, count: int, factor: Factor | None = None) -> Modes:
    """The lowest modes with the crack bonded, perhaps by the factor of the stiffness; where there
    are no more, infinite frequencies and shapes of zero (collective)."""
    omega, shapes = np.full(count, np.inf), np.zeros((structure.n_local, count))
    if most := min(count, n_tied_modes(structure)):
        if factor is None or structure.known_modes(tied=True) is not None:
            found = solve_modes(structure, most, lips="tied")
        else:
            found = modes_by(factor, structure, most, independent_ties(structure))
        omega[:most], shapes[:, :most] = found.omega, found.shapes
    return Modes(omega, shapes, structure)


def partners(is_open: Modes, tied: Modes) -> np.ndarray:
    """Return the bonded mode of the shape of each open mode: (n,) numbers from 0.

    Each is taken once: as many as there are of (phi_open^T M phi_tied)^2 above 0.9 (a bond that
    mixes modes leaves less, and then none is another's), and the others in the order of their
    numbers; no tie makes a mode slower (Rayleigh). The shapes of several modes of one frequency are
    any of a space, so squares are summed over it (collective).

    Parameters
    ----------
    is_open, tied : Modes
        Of one structure, at least as many bonded ones as open ones.
    """
    moved = times(is_open.structure.mass, tied.shapes)
    overlaps = is_open.structure.sum_over_ranks(is_open.shapes.T @ moved) ** 2
    of_open, of_tied = (
        np.isclose(omega[:, None], omega, rtol=MULTIPLE, atol=0.0).astype(float)
        for omega in (is_open.omega, tied.omega)
    )
    slower = tied.omega < (1.0 - MULTIPLE) * is_open.omega[:, None]
    same = (of_open @ overlaps @ of_tied > 0.9) & ~slower
    rows, columns = np.indices(overlaps.shape)
    weights = 1.0 + same - MULTIPLE * (rows - columns) ** 2  # all > 0, which are matches
    matched = min_weight_full_bipartite_matching(sparse.csr_matrix(weights), maximize=True)
    return np.asarray(matched[1])
