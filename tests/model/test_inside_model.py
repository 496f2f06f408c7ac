"""Parts of the model that the public face does not show: contact of all pairs at one instant, modes
that are computed once, the range of damped modes."""

import gc
import weakref
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from helpers import DAMPINGS, catch_error, chain, dense_matrices, random_stiffness, relative
from mpi4py import MPI
from test_modes import plate, random_matrices
from test_reduced import flexibility, reduced

import fenics_crack as fc
from fenics_crack import ModalDamping, Scene, Structure, build_structure, solve_modes
from fenics_crack.balance import compliance
from fenics_crack.balance.compliance import FactoredCompliance, load_coefficients
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.model import contact as contact_module
from fenics_crack.model import modes as model_modes
from fenics_crack.model.contact import (
    ActiveSetSolver,
    forces_and_slopes_of_smooth_law,
    solve_complementarity,
    solve_complementarity_by_least_squares,
    solve_contact_forces_by_newton,
)
from fenics_crack.model.factor import Factor, make_matrix_from_local_rows
from fenics_crack.model.matrix_formats import read_labels
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import (
    damped_count_and_max_omega_or_none,
    find_largest_natural_omega,
    modes_with_modal_damping,
)


def badly_conditioned(rng: np.random.Generator, pairs: int, condition: float) -> np.ndarray:
    """Eigenvalues spread evenly in their logarithms, in random directions."""
    basis = np.linalg.qr(rng.normal(size=(pairs, pairs)))[0]
    return (basis * np.geomspace(1.0, 1.0 / condition, pairs)) @ basis.T


def enumerated(compliance: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """lambda of the set, among all 2^p, that violates the conditions least."""
    best_force, min_violation = gap, np.inf
    for members in product([False, True], repeat=len(gap)):
        members_closed = np.array(members)
        force = np.zeros(len(gap))
        block = compliance[np.ix_(members_closed, members_closed)]
        force[members_closed] = np.linalg.solve(block, gap[members_closed])
        opening = compliance @ force - gap
        violation = max(-opening.min(), -force.min() * compliance.max())
        if violation < min_violation:
            best_force, min_violation = force, violation
    return best_force


def by_nnls(compliance: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The minimum of lambda^T D lambda / 2 - lambda^T s for lambda >= 0, by Lawson and Hanson."""
    root = np.linalg.cholesky(compliance)
    return scipy.optimize.nnls(root.T, np.linalg.solve(root, gap))[0]


# --- the constraint and the penalty law -----------------------------------------------------------


@pytest.mark.parametrize("condition", [3.0, 1e3, 1e7])
@pytest.mark.parametrize("pairs", [1, 2, 3, 5])
def test_forces_against_all_sets(pairs: int, condition: float) -> None:
    """Random compliances and gaps: those of the only set that fits."""
    rng = np.random.default_rng(pairs)
    compliance = badly_conditioned(rng, pairs, condition)
    gap = rng.normal(size=(60, pairs))
    force, closed_sets = ActiveSetSolver(compliance).solve(gap)
    exact_force = np.array([enumerated(compliance, row) for row in gap])
    assert relative(force, exact_force) < 1e-12 * condition
    assert np.array_equal(closed_sets, exact_force > 0.0)
    if pairs > 1:
        assert len(np.unique(closed_sets, axis=0)) > pairs  # many sets occur


@pytest.mark.parametrize("pairs", [8, 25])
def test_forces_of_many_pairs_against_least_squares(pairs: int) -> None:
    """scipy.optimize.nnls, with and without a guess of the sets."""
    rng = np.random.default_rng(pairs)
    compliance = np.linalg.inv(random_stiffness(rng, pairs))
    gap = rng.normal(size=(50, pairs))
    exact_force = np.array([by_nnls(compliance, row) for row in gap])
    for guess in (None, np.zeros(gap.shape, bool), np.ones(gap.shape, bool)):
        assert relative(ActiveSetSolver(compliance).solve(gap, guess)[0], exact_force) < 1e-9


@pytest.mark.parametrize("condition", [1e2, 1e8])
def test_conditions_of_complementarity(condition: float) -> None:
    """lambda >= 0, opening >= 0, one of both zero, though active sets alone would cycle."""
    rng = np.random.default_rng(7)
    for pairs in (4, 12, 20):
        compliance = badly_conditioned(rng, pairs, condition)
        gap = rng.normal(size=(200, pairs))
        force, closed_sets = ActiveSetSolver(compliance).solve(gap)
        opening = force @ compliance - gap
        assert force.min() >= 0.0 and np.array_equal(closed_sets, force > 0.0)
        assert opening.min() > -1e-9 * np.abs(gap).max()
        assert np.abs(opening[closed_sets]).max() < 1e-9 * np.abs(gap).max()


def test_sets_that_are_not_found_follow_by_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two pairs at one place cannot be told apart: their compliance is singular."""
    rng = np.random.default_rng(10)
    twice = np.repeat(np.arange(3), 2)
    compliance, gap = np.linalg.inv(random_stiffness(rng, 3)), rng.normal(size=(40, 3))
    single_force = ActiveSetSolver(compliance).solve(gap)[0]
    nnls_rows = []

    def counted(matrix: np.ndarray, row: np.ndarray) -> np.ndarray:
        nnls_rows.append(row)
        return solve_complementarity_by_least_squares(matrix, row)

    monkeypatch.setattr(contact_module, "solve_complementarity_by_least_squares", counted)
    force, closed_sets = ActiveSetSolver(compliance[np.ix_(twice, twice)]).solve(gap[:, twice])
    assert len(nnls_rows) > 5 and np.array_equal(closed_sets, force > 0.0)
    assert relative(force[:, ::2] + force[:, 1::2], single_force) < 1e-9


def test_pairs_that_nothing_couples() -> None:
    """D = diag(1/k): k max(0, s), the penalty law."""
    rng = np.random.default_rng(3)
    stiffness, gap = rng.uniform(1.0, 1e9, 6), rng.normal(size=(40, 6))
    force, _ = ActiveSetSolver(np.diag(1.0 / stiffness)).solve(gap)
    assert relative(force, stiffness * np.maximum(gap, 0.0)) < 1e-14


def test_gaps_at_zero_are_open() -> None:
    """s = 0, all of it or at some pairs: no force, and the pairs count as open."""
    compliance = np.linalg.inv(random_stiffness(np.random.default_rng(1), 3))
    force, closed_sets = ActiveSetSolver(compliance).solve(np.zeros((2, 3)))
    assert not np.any(force) and not np.any(closed_sets)
    # Here the second pair would just touch: D_21 s_1 / D_11 = s_2.
    gap = np.array([[1.0, compliance[1, 0] / compliance[0, 0], -5.0]])
    force, _ = ActiveSetSolver(compliance).solve(gap)
    assert np.allclose(force, [[1.0 / compliance[0, 0], 0.0, 0.0]], rtol=0.0, atol=1e-12)


def test_no_instants_and_no_pairs() -> None:
    """Arrays without rows, and laws of pairs that are not there, come back as they are."""
    sets = ActiveSetSolver(np.eye(2))
    assert [part.shape for part in sets.solve(np.zeros((0, 2)))] == [(0, 2), (0, 2)]
    assert sets.invert_compliance_on_sets(np.zeros((0, 2), bool)).shape == (0, 2, 2)


def test_slope_is_that_of_the_set() -> None:
    """d lambda / ds = (D_AA)^-1, by central differences."""
    rng = np.random.default_rng(5)
    compliance = np.linalg.inv(random_stiffness(rng, 4))
    sets, gap, step = ActiveSetSolver(compliance), rng.normal(size=(20, 4)), 1e-7
    _, closed_sets = sets.solve(gap)
    slopes = sets.invert_compliance_on_sets(closed_sets)
    for pair in range(4):
        change = step * np.eye(4)[pair]
        upper_force, lower_force = (sets.solve(gap + sign * change)[0] for sign in (1.0, -1.0))
        assert relative((upper_force - lower_force) / (2.0 * step), slopes[:, :, pair]) < 1e-7


def test_softer_pairs_let_the_gap_in() -> None:
    """With D = R + I/k the gap left is lambda / k, and vanishes with 1/k."""
    rng = np.random.default_rng(2)
    residual, gap = np.linalg.inv(random_stiffness(rng, 5)), rng.normal(size=(30, 5))
    rigid = ActiveSetSolver(residual).solve(gap)[0]
    distances = []
    for stiffness in (1e2, 1e4, 1e6):
        force = ActiveSetSolver(residual + np.eye(5) / stiffness).solve(gap)[0]
        gap_left = gap - force @ residual
        assert np.abs(np.maximum(gap_left, 0.0) - force / stiffness).max() < 1e-13
        distances.append(relative(force, rigid))
    assert distances[2] < 2e-2 * distances[1] < 4e-4 * distances[0]


# --- a smoothed law -------------------------------------------------------------------------------


@pytest.mark.parametrize("sharpness", [0.5, 30.0, 1e4])
@pytest.mark.parametrize("stiffness", [1.0, np.array([3.0, 1e4, 50.0])], ids=["soft", "stiff"])
def test_smoothed_law_against_a_root_finder(stiffness: float, sharpness: float) -> None:
    """lambda = h(s - D lambda) by MINPACK, from the solution of the penalty law."""
    rng = np.random.default_rng(6)
    law = fc.SmoothedPenalty(stiffness, sharpness)
    compliance = np.linalg.inv(random_stiffness(rng, 3))
    gap = rng.normal(size=(25, 3))
    force, _ = forces_and_slopes_of_smooth_law(law, compliance, gap)
    for row, force_row in zip(gap, force, strict=True):
        result = scipy.optimize.root(
            lambda g, s=row: g + compliance @ law.force(g) - s,
            row - compliance @ force_row + 1e-3,
            jac=lambda g: np.eye(3) + compliance * law.tangent(g),
            tol=1e-13,
        )
        assert np.abs(result.fun).max() < 1e-10
        assert np.allclose(force_row, law.force(result.x), rtol=1e-6, atol=1e-8)


def test_smoothed_law_alone_against_bisection() -> None:
    """One pair: the only root of g + R h(g) = s, bracketed."""
    law = fc.SmoothedPenalty(200.0, 40.0)
    gap = np.linspace(-2.0, 2.0, 41)[:, None]
    force, _ = forces_and_slopes_of_smooth_law(law, np.full((1, 1), 0.3), gap)
    for s, pair_force in zip(gap[:, 0], force[:, 0], strict=True):
        root = scipy.optimize.brentq(
            lambda g, s=s: g + 0.3 * float(law.force(np.array(g))) - s, -10.0, 10.0, xtol=1e-15
        )
        assert pair_force == pytest.approx(float(law.force(np.array(root))), rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("sharpness", [1.0, 100.0])
def test_slope_of_a_smoothed_law(sharpness: float) -> None:
    """By central differences."""
    rng = np.random.default_rng(8)
    law, step = fc.SmoothedPenalty(50.0, sharpness), 1e-6
    compliance, gap = np.linalg.inv(random_stiffness(rng, 3)), rng.normal(size=(15, 3))
    _, slope = forces_and_slopes_of_smooth_law(law, compliance, gap)
    for pair in range(3):
        change = step * np.eye(3)[pair]
        upper_force, lower_force = (
            forces_and_slopes_of_smooth_law(law, compliance, gap + s * change)[0]
            for s in (1.0, -1.0)
        )
        assert relative((upper_force - lower_force) / (2.0 * step), slope[:, :, pair]) < 1e-5


def test_hertz_law_is_solved_at_all_instants_together() -> None:
    """lambda = k g^(3/2), whose steps from the penalty law's solution go too far: law and force
    agree at every instant, and 1500 instants take hardly more calls of the law than 15."""

    class Hertz:
        stiffness, calls = 1.5e4, 0

        def force(self, gap: np.ndarray) -> np.ndarray:
            Hertz.calls += 1
            return np.asarray(1e4 * np.maximum(gap, 0.0) ** 1.5)

        def tangent(self, gap: np.ndarray) -> np.ndarray:
            return np.asarray(1.5e4 * np.sqrt(np.maximum(gap, 0.0)))

        def scaled(self, factor: float) -> "Hertz":
            raise NotImplementedError

    rng = np.random.default_rng(11)
    law, compliance = Hertz(), np.linalg.inv(random_stiffness(rng, 3))
    gap = np.abs(rng.normal(size=(15, 3)))
    counts = []
    for instants in (gap, np.tile(gap, (100, 1))):
        Hertz.calls = 0
        force, _ = forces_and_slopes_of_smooth_law(law, compliance, instants)
        counts.append(Hertz.calls)
        assert relative(law.force(instants - force @ compliance), force) < 1e-9
    assert counts[1] <= 2 * counts[0]


def test_smoothed_law_tends_to_the_penalty_law() -> None:
    """The difference falls with 1/s."""
    rng = np.random.default_rng(9)
    compliance, gap = np.linalg.inv(random_stiffness(rng, 3)), rng.normal(size=(20, 3))
    penalty_force = ActiveSetSolver(compliance + np.eye(3) / 10.0).solve(gap)[0]
    soft_error, sharp_error = (
        relative(
            forces_and_slopes_of_smooth_law(fc.SmoothedPenalty(10.0, s), compliance, gap)[0],
            penalty_force,
        )
        for s in (1e3, 1e5)
    )
    assert soft_error < 1e-2 and sharp_error < 2e-2 * soft_error


def test_without_compliance_the_law_itself() -> None:
    """D = 0: h(s) and h'(s)."""
    law, gap = fc.SmoothedPenalty(7.0, 3.0), np.linspace(-1.0, 1.0, 20).reshape(10, 2)
    force, slope = forces_and_slopes_of_smooth_law(law, np.zeros((2, 2)), gap)
    assert np.allclose(force, law.force(gap), rtol=1e-14)
    assert np.allclose(np.einsum("npp->np", slope), law.tangent(gap), rtol=1e-14)
    assert not np.any(slope[:, 0, 1])


# --- one step of a scheme in time -----------------------------------------------------------------


def by_enumeration(matrix: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The only set of closed pairs that satisfies all conditions, of all sets."""
    forces = []
    for members in product([False, True], repeat=len(gap)):
        is_closed = np.array(members)
        force = np.zeros(len(gap))
        force[is_closed] = np.linalg.solve(matrix[np.ix_(is_closed, is_closed)], gap[is_closed])
        if force.min() >= 0.0 and (matrix @ force - gap).min() >= -1e-12:
            forces.append(force)
    assert len(forces) == 1
    return forces[0]


@pytest.mark.parametrize("seed", range(20))
def test_complementarity_against_enumeration(seed: int) -> None:
    """Random couplings: active sets from any guess, and least squares alone."""
    rng = np.random.default_rng(seed)
    matrix, gap = random_stiffness(rng, 6) - 5.5 * np.eye(6), rng.normal(size=6)
    exact = by_enumeration(matrix, gap)
    for guess in (None, np.zeros(6, dtype=bool), np.ones(6, dtype=bool), rng.normal(size=6) > 0.0):
        assert np.allclose(solve_complementarity(matrix, gap, guess), exact, atol=1e-9)
    assert np.allclose(solve_complementarity_by_least_squares(matrix, gap), exact, atol=1e-9)


def test_complementarity_where_active_sets_cycle() -> None:
    """A positive definite matrix on which the active sets go round: least squares takes over."""
    rng = np.random.default_rng(0)
    n_cycles = 0
    for _ in range(3000):
        root = rng.normal(size=(4, 4))
        matrix, gap = root @ root.T + 1e-2 * np.eye(4), rng.normal(size=4)
        is_closed, visited_sets = gap > 0.0, set()
        while is_closed.tobytes() not in visited_sets:
            visited_sets.add(is_closed.tobytes())
            force = np.zeros(4)
            force[is_closed] = np.linalg.solve(matrix[np.ix_(is_closed, is_closed)], gap[is_closed])
            is_closed_next = np.where(is_closed, force > 0.0, matrix @ force - gap < 0.0)
            if np.array_equal(is_closed_next, is_closed):
                break
            is_closed = is_closed_next
        else:
            n_cycles += 1
            force = solve_complementarity(matrix, gap)
            opening = matrix @ force - gap
            assert force.min() >= 0.0 and opening.min() > -1e-8
            assert abs(force @ opening) < 1e-7 * (1.0 + np.abs(force).max())
    assert n_cycles > 0


def test_complementarity_without_solution_is_an_error() -> None:
    """Two opposite pairs on one dof that both penetrate."""
    catch_error(
        lambda: solve_complementarity(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.ones(2)),
        names="contact forces",
        kind=fc.ConvergenceError,
    )


@pytest.mark.parametrize("stiffness", [1e-3, 1.0, 1e6])
def test_forces_by_newton(stiffness: float) -> None:
    """A sharp smoothed law, soft to stiff against the compliance, and SciPy's root."""
    rng = np.random.default_rng(7)
    law = fc.SmoothedPenalty(stiffness, 1e3)
    matrix, gap = random_stiffness(rng, 4) / 8.0, rng.normal(size=4)
    force = solve_contact_forces_by_newton(
        lambda g: (law.force(g), law.tangent(g)), matrix, gap[None], np.zeros((1, 4))
    )[0]
    gap_reached = gap - matrix @ force
    assert np.allclose(law.force(gap_reached), force, rtol=1e-6, atol=1e-8 * stiffness)
    if stiffness <= 1.0:
        root = scipy.optimize.root(lambda y: y - law.force(gap - matrix @ y), force + 1e-3)
        assert root.success and np.allclose(root.x, force, atol=1e-8)


def test_forces_that_do_not_exist_are_an_error() -> None:
    """A force that falls with the gap, faster than the step's compliance allows."""
    catch_error(
        lambda: solve_contact_forces_by_newton(
            lambda g: (1.0 + g**2, 2.0 * g),
            np.ones((1, 1)),
            np.full((1, 1), -5.0),
            np.zeros((1, 1)),
        ),
        names="Newton",
        kind=fc.ConvergenceError,
    )


# --- modes, once computed -------------------------------------------------------------------------


def test_largest_frequency() -> None:
    """The largest frequency is LAPACK's, and with four times the mass half of it."""
    mass, stiffness = random_matrices(30)
    structure = Structure.from_matrices(mass, stiffness, gap=None)
    max_omega = np.sqrt(scipy.linalg.eigvalsh(stiffness, mass)[-1])
    assert find_largest_natural_omega(structure) == pytest.approx(max_omega, rel=1e-6)
    heavy_structure = Structure.from_matrices(4.0 * mass, stiffness, gap=None)
    assert find_largest_natural_omega(heavy_structure) == pytest.approx(max_omega / 2.0, rel=1e-6)


def test_a_diverging_structure_is_refused() -> None:
    """A negative eigenvalue is no frequency; it is found even where it is not near zero, and where
    a structure was not made from matrices."""
    structure = Structure.from_matrices(np.eye(39), np.eye(39), gap=None)
    for min_stiffness in (-1.0, -100.0):
        stiffness = np.diag([min_stiffness, 2.0, 3.0, 4.0, *np.arange(5.0, 40.0)])
        catch_error(
            partial(Structure.from_matrices, np.eye(39), stiffness, gap=None),
            "stiffness",
            "1 negative eigenvalue",
        )
        unstable_structure = structure._plain_structure_with_changes(
            stiffness=make_matrix_from_local_rows(stiffness, structure.comm)
        )
        catch_error(partial(solve_modes, unstable_structure, 2), "stiffness")


def test_damped_modes() -> None:
    """The rate of mode j is 2 xi_j omega_j; M Phi is the mass times the shapes; made only once."""
    mass, stiffness = random_matrices(10)
    ratios = [0.01, 0.02, 0.03]
    structure = Structure.from_matrices(mass, stiffness, gap=None, damping=ModalDamping(ratios, 3))
    mode_set = modes_with_modal_damping(structure)
    squares = scipy.linalg.eigvalsh(stiffness, mass)[:3]
    np.testing.assert_allclose(
        mode_set.damping_rates, 2.0 * np.array(ratios) * np.sqrt(squares), rtol=1e-8
    )
    np.testing.assert_allclose(mode_set.mass_shapes, mass @ mode_set.shapes, rtol=1e-12, atol=1e-14)
    assert modes_with_modal_damping(structure) is mode_set
    assert modes_with_modal_damping(structure.damped(None)) is None
    everywhere = modes_with_modal_damping(structure.damped(ModalDamping(0.1)))
    assert everywhere is not None and len(everywhere.omega) == 10


@pytest.mark.parametrize(
    ("key", "damping"),
    [
        ("damping ratio", ModalDamping([0.1, 0.1])),
        ("damping ratio", ModalDamping([0.1, 0.1], 3)),
        ("damping ratio", ModalDamping([0.1] * 11)),
        ("damping modes", ModalDamping(0.1, 11)),
    ],
)
def test_damping_that_does_not_fit(key: str, damping: ModalDamping) -> None:
    """As many ratios as modes, and no more modes than dofs."""
    structure = Structure.from_matrices(*random_matrices(10), gap=None, damping=damping)
    catch_error(lambda: modes_with_modal_damping(structure), key)


def modes_of(scene: Scene, count: int, comm: MPI.Comm) -> dict[str, Any]:
    """Frequencies, and the shapes at the nodes sorted by position (collective)."""
    structure = build_structure(scene, comm)
    modes = solve_modes(structure, count)
    shapes_with_clamp = np.concatenate(
        [modes.shapes, np.zeros((1, count))]
    )  # clamped dofs are number -1
    local = structure.nodes.dofs - np.where(structure.nodes.dofs >= 0, structure.first_dof, 0)
    points = gather_rows(comm, structure.nodes.points)
    shapes = gather_rows(comm, shapes_with_clamp[local])
    return {
        "omega": modes.omega,
        "shapes": shapes[np.lexsort(points.round(9).T)],
        "largest": find_largest_natural_omega(structure),
    }


@pytest.mark.mpi
def test_two_ranks_find_the_same_modes(on_ranks: Callable[..., Any]) -> None:
    """Frequencies to 1e-9, and shapes with the same signs, of a symmetric plate.

    Its shapes have their largest component twice, as the last lines show, with the same or the
    opposite sign.
    """
    scene, count = plate(5, 6), 8
    parallel, serial = on_ranks(modes_of, scene, count), modes_of(scene, count, MPI.COMM_SELF)
    np.testing.assert_allclose(parallel["omega"], serial["omega"], rtol=1e-9)
    np.testing.assert_allclose(parallel["shapes"], serial["shapes"], atol=1e-6)
    assert parallel["largest"] == pytest.approx(serial["largest"], rel=1e-6)
    shapes = serial["shapes"]
    max_amplitudes = np.abs(shapes).max(axis=(0, 1))
    twice = np.sum(np.abs(shapes) > (1.0 - 1e-6) * max_amplitudes, axis=(0, 1))
    assert np.all(twice >= 2)


@pytest.fixture
def eigensolutions(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the eigenproblems that are solved from now on."""
    sizes: list[int] = []

    def counted(solve: Callable[..., Any]) -> Callable[..., Any]:
        def call(operand: Any, *others: Any) -> Any:
            sizes.append(others[0] if isinstance(operand, fc.Structure) else len(operand))
            return solve(operand, *others)

        return call

    monkeypatch.setattr(scipy.linalg, "eigh", counted(scipy.linalg.eigh))
    for module in (model_modes, compliance):
        monkeypatch.setattr(module, "solve_modes", counted(fc.solve_modes))
    return sizes


@pytest.mark.parametrize("damping", DAMPINGS)
def test_modes_of_varied_copies(damping: str, eigensolutions: list[int]) -> None:
    """Nothing is computed again, whichever asks first; the damping is the varied one."""
    structure = chain(damping)
    half = structure.varied(damping=0.5, load=3.0)
    undamped_copy, shifted_copy = half.varied(damping=0.0), structure.varied(clearance=0.1)
    matrix = dense_matrices(structure)[1]
    half_modes = all_modes(half)
    assert eigensolutions
    del eigensolutions[:]
    for copy, factor in ((structure, 1.0), (half, 0.5), (undamped_copy, 0.0), (shifted_copy, 1.0)):
        modes = all_modes(copy)
        assert modes.shapes is half_modes.shapes and modes.gaps_by_mode is half_modes.gaps_by_mode
        modal_matrix = factor * modes.shapes.T @ matrix @ modes.shapes
        damping_in_modes = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping
        np.testing.assert_allclose(damping_in_modes, modal_matrix, atol=1e-10)
        damped_mode_set = modes_with_modal_damping(copy)
        assert (damped_mode_set is None) == (damping in ("rayleigh", "matrix", "none"))
        if damped_mode_set is not None:
            ratio = np.asarray(copy.damping.ratio)
            np.testing.assert_allclose(
                damped_mode_set.damping_rates, 2.0 * ratio * damped_mode_set.omega, rtol=1e-14
            )
    assert eigensolutions == []


@pytest.mark.parametrize("damping", DAMPINGS)
def test_high_harmonics_of_varied_copies(damping: str, eigensolutions: list[int]) -> None:
    """Beyond the factored harmonics the modes serve; they are those of the first structure."""
    structure = chain(damping, 30)
    half_damped = structure.varied(damping=0.5)
    compliances = []
    for copy in (structure, half_damped, fc.Structure.from_matrices(
        structure.mass, structure.stiffness, gap=structure.gap, damping=half_damped.damping
    )):  # fmt: skip
        del eigensolutions[:]
        compliance = FactoredCompliance(copy, 0.2, load_coefficients(copy, 3, 1))
        compliances.append(compliance.compliance_of_truncated_harmonics(6))
        compliance.destroy()
        assert (eigensolutions == []) == (copy is half_damped)
    np.testing.assert_allclose(compliances[1], compliances[2], rtol=1e-7, atol=1e-12)
    if damping != "none":
        assert np.abs(compliances[1] - compliances[0]).max() > 1e-9


@pytest.mark.drawn(3)
@pytest.mark.parametrize("kind", ["modal", "matrix"])
@pytest.mark.parametrize("parameter", ["damping", "load", "clearance"])
def test_curves_solve_no_further_eigenproblem(
    parameter: str, kind: str, eigensolutions: list[int]
) -> None:
    """Nor do the solutions on them, with their error reports, and their stability."""
    reduced_structure = fc.reduce_structure(chain(kind, 30), modes=8)
    law = fc.UnilateralPenalty(4.0)
    first_solution = fc.solve_harmonic_balance(reduced_structure, 0.3, law)
    assert first_solution.report.reduction > 0.0
    fc.floquet(reduced_structure, first_solution)
    start, end = (0.0, 0.1) if parameter == "clearance" else (1.0, 1.5)
    del eigensolutions[:]
    curve = fc.continue_parameter(
        reduced_structure, 0.3, law, parameter, start, end, stability=True
    )
    assert len(curve) > 3 and curve.complete
    for index in (0, len(curve) // 2, len(curve) - 1):
        solution = curve.solution(index)
        assert solution.report.reduction > 0.0
        fc.floquet(solution.structure, solution)
    assert eigensolutions == []


def test_nothing_is_kept_alive(wide_plate: fc.Structure) -> None:
    """Structures are freed as soon as nobody refers to them: they are in no cycles."""
    gc.collect()
    gc.disable()
    try:
        plate = fc.Structure.from_matrices(
            wide_plate.mass, wide_plate.stiffness, gap=wide_plate.gap, damping=fc.ModalDamping(0.01)
        )
        reduced_structure = fc.reduce_structure(plate, modes=8)
        copy = reduced_structure.varied(damping=2.0)
        for owner in (plate, reduced_structure, copy):
            all_modes(owner)
        alive = [weakref.ref(owner) for owner in (plate.body, reduced_structure.body, copy)]
        del plate, reduced_structure, owner
        assert all(reference() is not None for reference in alive)  # the copy needs them
        del copy
        assert all(reference() is None for reference in alive)
    finally:
        gc.enable()


# --- range of the damped modes --------------------------------------------------------------------


def test_range_of_damped_modes() -> None:
    """The highest damped mode, where there are others above it."""
    structure = chain("none", 30)
    omega = fc.solve_modes(structure, 30).omega
    ratios = [0.1, 0.0, 0.1, 0.0]
    for damping, exact_range in (
        (None, (0, 0.0)),
        (fc.ModalDamping(0.0), (0, 0.0)),
        (fc.ModalDamping(0.0, 3), (0, 0.0)),
        (fc.RayleighDamping(), (0, 0.0)),
        (fc.ModalDamping(0.01), None),
        (fc.ModalDamping(0.01, 30), None),
        (fc.ModalDamping([0.01] * 30), None),
        (fc.RayleighDamping(0.1), None),
        (fc.RayleighDamping(0.0, 0.1), None),
        (fc.ModalDamping(0.01, 4), (4, omega[3])),
        (fc.ModalDamping(ratios, 4), (2, omega[2])),
        (fc.ModalDamping([0.01] * 12 + [0.0] * 18), (12, omega[11])),
    ):
        damped_range = damped_count_and_max_omega_or_none(structure.damped(damping))
        assert damped_range == (exact_range and pytest.approx(exact_range, rel=1e-9)), damping
    assert damped_count_and_max_omega_or_none(chain("matrix")) is None
    assert damped_count_and_max_omega_or_none(chain("modal").varied(damping=0.0)) == (0, 0.0)


def test_range_of_a_reduced_structure() -> None:
    """That of the whole where its damping is projected; nothing is left out where all is damped."""
    structure = chain("none", 60)
    few_modes_damped = structure.damped(fc.ModalDamping(0.02, 8))
    last_omega = fc.solve_modes(structure, 8).omega[-1]
    for modes in (5, 8, 20):
        reduced_structure = fc.reduce_structure(few_modes_damped, modes=modes)
        assert damped_count_and_max_omega_or_none(reduced_structure) == pytest.approx(
            (8, last_omega), rel=1e-9
        )
        assert (
            damped_count_and_max_omega_or_none(reduced_structure.damped(fc.ModalDamping(0.02)))
            is None
        )
        assert damped_count_and_max_omega_or_none(reduced_structure.damped(None)) == (0, 0.0)
    for rule in (fc.ModalDamping(0.02), fc.RayleighDamping(0.05, 0.03)):
        assert (
            damped_count_and_max_omega_or_none(fc.reduce_structure(structure.damped(rule), modes=8))
            is None
        )


# --- rigid bodies without mass at the crack faces -------------------------------------------------


def three_rigid_modes(damping: Any = None) -> fc.Structure:
    """20 dofs, two pairs, a load on the rigid modes too."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(20, 17))
    gap = np.zeros((20, 2))
    gap[[3, 7], 0], gap[[11, 2], 1] = (1.0, -1.0), (1.0, -1.0)
    return fc.Structure.from_matrices(
        np.diag(rng.uniform(1.0, 2.0, 20)), root @ root.T, gap=gap, force_cos=rng.normal(size=20),
        damping=damping,
    )  # fmt: skip


def test_motions_as_a_rigid_body() -> None:
    """Three of them: kept at frequency zero, with what a matrix damps of them; fewer modes than
    that are refused."""
    structure = three_rigid_modes(0.1 * np.eye(20))
    for modes in (1, 2):
        catch_error(partial(reduced, structure, modes), "modes", modes, names="at least 3")
    for modes in (3, 6):
        reduced_model = reduced(structure, modes)
        assert np.array_equal(reduced_model.omega == 0.0, np.arange(modes) < 3)
        assert all_modes(reduced_model).is_unconstrained
        rate = all_modes(reduced_model).damping
        rate = rate if rate.ndim == 2 else np.diag(rate)
        assert relative(rate, 0.1 * reduced_model.basis.T @ reduced_model.basis) < 1e-8
        gap = structure.gap.toarray()
        assert (
            relative(reduced_model.residual_compliance, gap.T @ flexibility(structure, modes) @ gap)
            < 1e-9
        )
        for reduced_part, full_part in zip(
            (row[1:] for row in made_seen(reduced_model)),
            (row[1:] for row in made_seen(structure)), strict=True,
        ):  # fmt: skip
            assert relative(reduced_part, full_part) < (0.3 if modes == 3 else 0.1)
    assert all_modes(reduced(chain("none", 9, unconstrained=True), 1)).is_unconstrained


def made_seen(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray]:
    """R_1 and the gap's first harmonic at a low frequency (the mean would fly off), as rows."""
    mass, damping, stiffness = dense_matrices(structure.whole)
    gap, omega = structure.whole.gap.toarray(), 0.1
    if structure is structure.whole:
        response = np.linalg.solve(
            stiffness - omega**2 * mass + 1j * omega * damping,
            np.column_stack([gap, structure.force[1]]),
        )
        gap_response = gap.T @ response
        return np.array([gap_response[:, :2] * 0.0, gap_response[:, :2]]), np.array(
            [gap_response[:, 2], gap_response[:, 2]]
        )
    modes = all_modes(structure)
    receptance = modes.modal_receptances(np.array([omega]))
    matrix = modes.compliance_of_pairs(receptance)[0] + structure.residual_compliance  # type: ignore[attr-defined]
    load = structure.force[1] @ modes.shapes
    shape = modes.modal_response(receptance[0], load + 0j)
    linear = (
        shape @ modes.gaps_by_mode + structure.force[1] @ modes.massless_displacement_by_pair_forces
    )
    return np.array([0.0 * matrix, matrix]), np.array([linear, linear])


def test_labels_of_rotations(tmp_path: Path) -> None:
    """Ansys' words for all six directions are numbers 1 to 6."""
    words = "UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ"
    (tmp_path / "rows").write_text("".join(f"{n} 7 {word}\n" for n, word in enumerate(words, 1)))
    assert read_labels(tmp_path / "rows").tolist() == [[7, number] for number in range(1, 7)]


def test_what_petsc_lacks_gives_way_to_mumps(monkeypatch: pytest.MonkeyPatch) -> None:
    """As CHOLMOD in DOLFINx's wheels, which is refused before there is a factor."""
    factorise = Factor._factorise
    renamed_solvers = {"cholmod": "a library that PETSc lacks"}
    monkeypatch.setattr(
        Factor,
        "_factorise",
        lambda self, solver: factorise(self, renamed_solvers.get(solver, solver)),
    )
    stiffness = random_stiffness(np.random.default_rng(3), 6)
    with Factor(make_matrix_from_local_rows(stiffness, MPI.COMM_SELF), definite=True) as factor:
        assert relative(factor.solve(stiffness), np.eye(6)) < 1e-10
        assert factor.n_negative_pivots == 0


def test_no_infinite_solution_goes_on() -> None:
    """It is called what it is, where it arises: no later step guesses at the cause."""
    matrix = make_matrix_from_local_rows(1e-310 * np.eye(3), MPI.COMM_SELF)
    with Factor(matrix, definite=True) as factor:
        catch_error(
            lambda: factor.solve(np.ones((1, 3))),
            names="no finite solution",
            kind=fc.ConvergenceError,
        )


def test_what_mumps_cannot_factor_is_said() -> None:
    """By MUMPS's own number, on all ranks."""
    matrix = make_matrix_from_local_rows(1e-310 * np.eye(3), MPI.COMM_SELF)
    catch_error(lambda: Factor(matrix), names=r"INFOG\(1\) = -10", kind=fc.ConvergenceError)
