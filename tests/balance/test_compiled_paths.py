"""Contact integrals, condensed equations and paths of the kernel against the same in NumPy."""

from __future__ import annotations

from itertools import islice, pairwise

import numpy as np
import pytest
import scipy.optimize
from helpers import chain, oscillator, relative, two_masses
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import fenics_crack as fc
from fenics_crack import Continuation
from fenics_crack.balance import contact_system
from fenics_crack.balance.contact_integrals import ExactIntegrals, respond_to_columns
from fenics_crack.balance.contact_system import CompiledEquations
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.numerics.equations import Linearisation, System
from fenics_crack.numerics.fourier import evaluate, sampled, to_complex
from fenics_crack.numerics.newton import (
    PathPoint,
    point_on_path,
    solve_at,
    solve_in_plane,
    step_along,
    tangent_of,
)
from fenics_crack.numerics.path import Ended, Fold, Path, PathOptions, Target

SEEDS = st.integers(0, 2**32 - 1)
RANGES = {
    "omega": (1.3, 0.9),
    "load": (1.0, 3.0),
    "stiffness": (1.0, 50.0),
    "damping": (1.0, 0.1),
    "clearance": (-0.3, 0.5),
}


class Plain:
    """A family, or another system, whose equations are left to Python."""

    def __init__(self, family: System) -> None:
        self._family = family
        self.means = getattr(family, "means", 0)

    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """As the family."""
        return self._family.linearise(unknown, parameter)


def random_gap(random: np.random.Generator, harmonics: int, pairs: int) -> np.ndarray:
    """Coefficients that fall like 1 / k."""
    gap = random.normal(size=(2 * harmonics + 1, pairs))
    gap[1:] /= np.repeat(np.arange(1, harmonics + 1), 2)[:, None]
    return gap


def integrals_by_scan(gap: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """T and b of one gap (2H+1,) with k = 1, between the zeros that a scan shows, by the integrals
    of products of waves; and the smallest slope at a zero."""
    harmonics, cells = len(gap) // 2, 4096
    values = sampled(gap[:, None], cells)[:, 0]
    width = 2.0 * np.pi / cells
    changes = np.flatnonzero((values > 0.0) != (np.roll(values, -1) > 0.0))

    def wave(theta: float) -> float:
        return float(evaluate(gap, 1.0, np.array([theta]))[0])

    zeros = [
        scipy.optimize.brentq(wave, i * width, (i + 1) * width, xtol=1e-15, rtol=1e-15)
        for i in changes
    ]
    order = np.arange(harmonics + 1)
    slopes = [
        abs((1j * order * to_complex(gap) * np.exp(1j * order * z)).sum().real) for z in zeros
    ]
    # Means of exp(i m theta), m = -2H to 2H, over the closed intervals.
    power = np.arange(-2 * harmonics, 2 * harmonics + 1)
    means = np.zeros(len(power), dtype=complex)
    ends = np.array([0.0, *zeros, 2.0 * np.pi])
    for left, right in pairwise(ends):
        if wave(0.5 * (left + right)) > 0.0:
            whole = np.where(power == 0, right - left, 0.0).astype(complex)
            other = power != 0
            rate = 1j * power[other]
            whole[other] = (np.exp(rate * right) - np.exp(rate * left)) / rate
            means += whole / (2.0 * np.pi)
    # Columns 1, cos, sin, ... in exp(i m theta), m = -H to H.
    basis = np.zeros((len(gap), 2 * harmonics + 1), dtype=complex)
    basis[0, harmonics] = 1.0
    for k in range(1, harmonics + 1):
        basis[2 * k - 1, harmonics + k] = basis[2 * k - 1, harmonics - k] = 0.5
        basis[2 * k, harmonics + k], basis[2 * k, harmonics - k] = -0.5j, 0.5j
    sums = np.add.outer(np.arange(-harmonics, harmonics + 1), np.arange(-harmonics, harmonics + 1))
    tangent = (basis @ means[sums + 2 * harmonics] @ basis.T).real
    tangent[1:] *= 2.0
    return tangent, tangent @ gap, min(slopes, default=np.inf)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(1, 3), SEEDS)
def test_contact_integrals(harmonics: int, pairs: int, seed: int) -> None:
    """Forces and tangents of random gaps."""
    random = np.random.default_rng(seed)
    gap, stiffness = random_gap(random, harmonics, pairs), random.uniform(0.1, 10.0, pairs)
    found = ExactIntegrals(fc.UnilateralPenalty(stiffness), harmonics).linearise(gap)
    for pair, k in enumerate(stiffness):
        expected, expected_force, slope = integrals_by_scan(gap[:, pair])
        assume(slope > 1e-3)
        assert np.allclose(
            found.tangent[pair], k * expected, rtol=0.0, atol=1e-12 * k / min(slope, 1.0)
        )
        assert np.allclose(found.force[:, pair], k * expected_force, rtol=0.0, atol=1e-11 * k)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 6), st.integers(1, 4), st.integers(1, 9), SEEDS)
def test_respond_to_columns(harmonics: int, pairs: int, columns: int, seed: int) -> None:
    """R T, column by column: a - i b answered by R_k (a - i b)."""
    random = np.random.default_rng(seed)
    rows = 2 * harmonics + 1
    matrices = random.normal(size=(2, harmonics + 1, pairs, pairs))
    matrices = (
        matrices[0]
        + 1j * np.where(np.arange(harmonics + 1) > 0, 1, 0)[:, None, None] * (matrices[1])
    )
    tangent = random.normal(size=(pairs, rows, columns))
    found = respond_to_columns(matrices, tangent).reshape(rows, pairs, columns, pairs)
    for pair in range(pairs):
        moved = np.einsum("kp,kc->kpc", matrices[:, :, pair], to_complex(tangent[pair]))
        assert np.allclose(found[0, :, :, pair], moved[0].real, rtol=0.0, atol=1e-12)
        assert np.allclose(found[1::2, :, :, pair], moved[1:].real, rtol=0.0, atol=1e-12)
        assert np.allclose(found[2::2, :, :, pair], -moved[1:].imag, rtol=0.0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(list(RANGES)),
    st.sampled_from(["modal", "rayleigh", "few modes", "matrix"]),
    st.integers(1, 8),
    st.integers(1, 3),
    SEEDS,
)
def test_equations_at_a_point(
    name: str, damping: str, harmonics: int, pairs: int, seed: int
) -> None:
    """F, dF/dp, J^-1 r and the sign of det J of random chains, in every family."""
    random = np.random.default_rng(seed)
    law = fc.UnilateralPenalty(random.uniform(0.5, 20.0, pairs))
    structure = chain(damping, pairs=pairs, seed=seed % 1000)
    family = FAMILIES[name](fc.Problem(structure, 0.83, law, harmonics), *RANGES[name])
    kernel = family.compiled
    if damping == "matrix" and name in ("omega", "damping"):
        assert kernel is None  # it couples modes
        return
    assert isinstance(kernel, CompiledEquations)
    gap, right = random_gap(random, harmonics, pairs), random.normal(size=family.shape)
    parameter = float(random.uniform(-0.2, 1.2))
    expected, found = family.linearise(gap, parameter), kernel.linearise(gap, parameter)
    singular = np.linalg.svd(expected.jacobian, compute_uv=False)
    close = 1e-12 * max(1.0, float(singular[0]))
    for one, other, allowed in (
        (found.residual, expected.residual, close),
        (found.by_parameter, expected.by_parameter, close),
        (found.solve(right), expected.solve(right), close / singular[-1] ** 2),
    ):
        assert np.allclose(one, other, rtol=1e-12, atol=10.0 * allowed * np.abs(other).max())
    assert found.sign == expected.sign


@pytest.mark.parametrize(("stiffness", "harmonics"), [(1.0, 3), (1.0, 10), (10.0, 6), (100.0, 5)])
def test_path_of_the_oscillator(stiffness: float, harmonics: int) -> None:
    """Compiled equations take the steps that those in Python take."""
    law = fc.UnilateralPenalty(stiffness)
    family = FAMILIES["omega"](fc.Problem(oscillator(0.02, 0.1), 2.0, law, harmonics), 2.0, 0.3)
    start = fc.solve_harmonic_balance(oscillator(0.02, 0.1), 2.0, law, harmonics=harmonics)
    options = PathOptions(0.01, max_step=0.1, min_step=1e-10, min_cosine=0.85)
    assert_same_path(family, start.gap_coefficients, options, 150)


@pytest.mark.parametrize("name", list(RANGES))
def test_path_of_a_chain(name: str) -> None:
    """With three pairs, in every family, by steps that are too long for some points."""
    structure, law = chain(), fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))
    family = FAMILIES[name](fc.Problem(structure, 0.83, law, 4), *RANGES[name])
    first = family.at(family.start)
    start = fc.solve_harmonic_balance(
        first.structure, first.omega, first.contact, harmonics=4, residual_tolerance=1e-12
    )
    options = PathOptions(0.01, max_step=0.5, min_step=1e-10)
    assert_same_path(family, start.gap_coefficients, options, 40)


def followed(
    system: System, start: np.ndarray, options: PathOptions, count: int
) -> list[PathPoint]:
    """So many points of the path from p = 0 on."""
    return list(islice(Path(system, point_on_path(system, start, 0.0), options).points(), count))


def assert_same_path(family: Family, start: np.ndarray, options: PathOptions, count: int) -> None:
    """Followed both ways."""
    assert family.compiled is not None
    ways = [followed(system, start, options, count) for system in (family, Plain(family))]
    compared = 0
    for one, other in zip(*ways, strict=False):
        if other.length < 1e-4:  # at a sharp corner rounding counts
            break
        compared += 1
        size = np.abs(other.unknown).max()
        assert one.parameter == pytest.approx(other.parameter, abs=1e-9)
        assert np.allclose(one.unknown, other.unknown, rtol=0.0, atol=1e-8 * size)
        assert np.allclose(one.tangent.x, other.tangent.x, rtol=0.0, atol=1e-6 * size)
        assert one.tangent.p == pytest.approx(other.tangent.p, abs=1e-6)
        assert one.tangent.weight == pytest.approx(other.tangent.weight, rel=1e-8)
        assert one.length == pytest.approx(other.length, rel=1e-6)
        assert abs(one.iterations - other.iterations) <= 1  # rounding may decide over the last one
        assert one.crosses_branch == other.crosses_branch
    assert compared > 10


@pytest.mark.parametrize("least_damping", [None, 0.05])
@pytest.mark.parametrize("bordered", [False, True])
def test_corrections(bordered: bool, least_damping: float | None) -> None:
    """From random guesses, far ones among them: found or not, the same."""
    law = fc.UnilateralPenalty(10.0)
    family = FAMILIES["omega"](fc.Problem(oscillator(), 0.9, law, 4), 0.9, 1.4)
    start = fc.solve_harmonic_balance(oscillator(), 0.9, law, harmonics=4).gap_coefficients
    plane = tangent_of(family, start, family.linearise(start, 0.0)) if bordered else None
    random, outcomes = np.random.default_rng(3), []
    for size in np.repeat([0.0, 0.01, 0.3, 3.0, 1e200], 12):
        guess = start + size * random.normal(size=start.shape)
        one, other = (
            solve_in_plane(
                system, guess, 0.05, plane,
                tolerance=1e-10, iterations=8, reach=0.3, least_damping=least_damping,
            )
            for system in (family, Plain(family))
        )  # fmt: skip
        outcomes.append(one is not None)
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            assert one.parameter == pytest.approx(other.parameter, abs=1e-9)
            assert np.allclose(one.unknown, other.unknown, atol=1e-8)
            assert one.iterations == other.iterations
    assert 12 < sum(outcomes) < 60


def test_undamped_resonance() -> None:
    """One error, as from Python."""
    structure = oscillator(None, 0.1)
    family = FAMILIES["omega"](fc.Problem(structure, 0.5, fc.UnilateralPenalty(1.0), 3), 0.5, 1.5)
    assert family.compiled is not None
    with pytest.raises(fc.ConvergenceError, match="singular"):
        solve_at(family, np.ones((7, 1)), 0.5, tolerance=1e-9)


def test_fold_and_value_between_two_points() -> None:
    """p(s) turns at t_p = 0, and takes the value asked for, on the path; the same from Python."""
    law = fc.UnilateralPenalty(1.0)
    structure = oscillator(0.02, 0.1)
    family = FAMILIES["omega"](fc.Problem(structure, 2.0, law, 10), 2.0, 0.3)
    start = fc.solve_harmonic_balance(structure, 2.0, law, harmonics=10).gap_coefficients
    points = followed(
        family, start, PathOptions(0.01, max_step=0.2, min_step=1e-10, min_cosine=0.85), 95
    )
    pairs = list(pairwise(points))
    turning = [ends for ends in pairs if ends[0].tangent.p * ends[1].tangent.p < 0.0]
    assert len(turning) == 2
    for ends in turning:
        fold = must(Fold().locate(family, ends, 1e-11))
        assert abs(fold.tangent.p) < 1e-7
        assert_same_point(fold, must(Fold().locate(Plain(family), ends, 1e-11)))
    for first, last in pairs[10:90:20]:
        target = 0.3 * first.parameter + 0.7 * last.parameter
        found = must(Target(target).locate(family, (first, last), 1e-11))
        assert found.parameter == target
        assert_same_point(found, must(Target(target).locate(Plain(family), (first, last), 1e-11)))
        at = family.linearise(found.unknown, found.parameter)
        assert np.linalg.norm(at.residual) < 1e-10 * np.linalg.norm(found.unknown)


def assert_same_point(one: PathPoint, other: PathPoint) -> None:
    """To what Newton's method leaves."""
    size = np.abs(other.unknown).max()
    assert one.parameter == pytest.approx(other.parameter, abs=1e-10)
    assert np.allclose(one.unknown, other.unknown, rtol=0.0, atol=1e-9 * size)
    assert np.allclose(one.tangent.x, other.tangent.x, rtol=0.0, atol=1e-7 * size)
    assert one.tangent.p == pytest.approx(other.tangent.p, abs=1e-7)
    assert one.iterations == other.iterations


@pytest.mark.parametrize("name", list(RANGES))
def test_largest_compliance(name: str) -> None:
    """Of random chains, at parameters in and out of the range."""
    structure, law = chain(pairs=3), fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))
    family = FAMILIES[name](fc.Problem(structure, 0.83, law, 4), *RANGES[name])
    assert family.compiled is not None
    for parameter in (-0.2, 0.0, 0.4, 1.0):
        matrices = family.system(family.value(parameter)).compliance.matrices
        expected = np.abs(matrices).sum(axis=2).max()
        assert family.compiled.largest_compliance(parameter) == pytest.approx(expected, rel=1e-12)


def must(point: PathPoint | None) -> PathPoint:
    """A point that has been found."""
    assert point is not None
    return point


def test_folds_of_a_stiff_curve() -> None:
    """kc = 100, long steps: at every fold that is reported the path turns."""
    law = fc.UnilateralPenalty(100.0)
    growing = Continuation(
        fc.Problem(oscillator(0.02, 0.1), 2.0, law, 10), "omega", 2.0, 0.3, longest_step=0.2
    )
    for _ in growing:
        pass
    family = FAMILIES["omega"](fc.Problem(oscillator(0.02, 0.1), 2.0, law, 10), 2.0, 0.3)
    folds = growing.curve.bifurcations
    assert len(folds) == 16
    for fold in folds:
        parameter, unknown = family.parameter(fold.value), fold.point.unknowns[0]
        tangent = tangent_of(family, unknown, family.linearise(unknown, parameter))
        start = PathPoint(unknown, parameter, 0, tangent)
        sides = [must(step_along(family, start, step, 1e-11)) for step in (1e-5, 2e-5)]
        assert abs(tangent.p) < 1e-5
        # p leaves the fold with the square of the distance.
        first, second = (side.parameter - parameter for side in sides)
        assert abs(first) < 1e-3 * 1e-5 or second == pytest.approx(4.0 * first, rel=0.5)


@pytest.mark.nightly
def test_path_of_many_unknowns() -> None:
    """144 unknowns, so that solutions take products with J: points and tangents are on the path,
    and each is where equations in Python, whose J is factored at every iteration, have one."""
    structure, law = chain(pairs=3), fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))
    family = FAMILIES["omega"](fc.Problem(structure, 1.4, law, 24), 1.4, 0.5)
    start = fc.solve_harmonic_balance(
        structure, 1.4, law, harmonics=24, residual_tolerance=1e-12
    ).gap_coefficients
    options = PathOptions(0.01, max_step=0.05, rtol=1e-9, min_cosine=0.85)
    ways = [followed(system, start, options, 100) for system in (family, Plain(family))]
    for one, other in zip(*ways, strict=True):
        at = family.linearise(one.unknown, one.parameter)
        size, tangent = np.linalg.norm(one.unknown), one.tangent
        assert np.linalg.norm(at.residual) < 2e-9 * size
        along = at.apply(tangent.x) + tangent.p * at.by_parameter
        assert np.linalg.norm(along) < 1e-4 * size
        assert one.parameter == pytest.approx(other.parameter, abs=1e-6)
        assert np.allclose(one.unknown, other.unknown, rtol=0.0, atol=1e-5 * size)
        assert tangent.along(other.tangent, family) > 1.0 - 1e-6
        assert one.iterations <= other.iterations + 2


def test_branch_crosses_a_path_of_many_unknowns() -> None:
    """Two like oscillators, weakly coupled: next to the folds where they move alike, branches on
    which they do not cross the path. Tangents do not show it; the next sign of det J does, and the
    points between are followed again."""
    stiffness = np.array([[1.005, -0.005], [-0.005, 1.005]])
    twins = fc.Structure.from_matrices(
        np.eye(2), stiffness, np.eye(2), force_cos=np.array([0.1, 0.1]), damping=0.05 * np.eye(2),
        clearance=1.0,
    )  # fmt: skip
    law = fc.UnilateralPenalty(1.0)
    family = FAMILIES["omega"](fc.Problem(twins, 0.8, law, 25), 0.8, 1.5)
    start = fc.solve_harmonic_balance(
        twins, 0.8, law, harmonics=25, residual_tolerance=1e-12
    ).gap_coefficients
    assert start.size == 102
    options = PathOptions(0.01, max_step=0.05, min_step=1e-10, rtol=1e-9, min_cosine=0.85)
    ways = [followed(system, start, options, 100) for system in (family, Plain(family))]
    crossings = [[point.parameter for point in way if point.crosses_branch] for way in ways]
    assert len(crossings[0]) == len(crossings[1]) == 2
    assert np.allclose(*crossings, rtol=0.0, atol=1e-6)
    turns = [
        [
            after.parameter
            for before, after in pairwise(way)
            if before.tangent.p * after.tangent.p < 0
        ]
        for way in ways
    ]
    assert len(turns[0]) == len(turns[1]) == 2
    assert np.allclose(*turns, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", list(RANGES))
def test_derivative_by_each_parameter(name: str) -> None:
    """dF/dp against central differences, along the whole range."""
    structure, (start, end) = two_masses(), RANGES[name]
    law = fc.UnilateralPenalty(np.array([3.0]))
    family = FAMILIES[name](fc.Problem(structure, 0.9, law, 4), start, end)
    gap = np.random.default_rng(2).normal(size=(9, 1))
    for parameter in (0.0, 0.4, 1.0):
        exact = family.linearise(gap, parameter).by_parameter
        sides = [family.linearise(gap, parameter + step).residual for step in (1e-6, -1e-6)]
        slope = (sides[0] - sides[1]) / 2e-6
        assert np.allclose(slope, exact, rtol=1e-5, atol=1e-7 * np.abs(exact).max())


def test_undamped_resonance_that_the_load_leaves_alone() -> None:
    """A third harmonic meets a mode without damping and load there: a solution like any other."""
    mass, stiffness = np.eye(2), np.diag([1.0, 9.0 * 0.7**2])
    structure = fc.Structure.from_matrices(mass, stiffness, [1.0, 0.1], force_cos=[0.2, 0.0])
    law = fc.UnilateralPenalty(0.5)
    alone = fc.solve_harmonic_balance(structure, 0.7, law, harmonics=5)
    assert alone.converged
    family = FAMILIES["omega"](fc.Problem(structure, 0.7, law, 5), 0.7, 1.7)
    found = solve_in_plane(family, 1.01 * alone.gap_coefficients, 0.0, None, tolerance=1e-9)
    assert found is not None
    np.testing.assert_allclose(found.unknown, alone.gap_coefficients, rtol=1e-6, atol=1e-8)


# --- behind a static compliance -------------------------------------------------------------------


LAWS = ("rigid", "penalty", "stiff")


def coupled_family(
    name: str, law: str, damping: str, harmonics: int, pairs: int, modes: int, seed: int
) -> Family:
    """Of a random chain on lips without mass."""
    random = np.random.default_rng(seed)
    stiffness = random.uniform(0.5, 20.0, pairs) * (1e4 if law == "stiff" else 1.0)
    contact = fc.UnilateralConstraint() if law == "rigid" else fc.UnilateralPenalty(stiffness)
    whole = chain(damping, pairs=pairs, seed=seed % 1000)
    structure = fc.reduce_structure(whole, modes=modes, method="massless")
    return FAMILIES[name](fc.Problem(structure, 0.83, contact, harmonics), *RANGES[name])


def assert_same_equations(found: Linearisation, expected: Linearisation, right: np.ndarray) -> None:
    """F, dF/dp, J^-1 r and the sign of det J, as well as they are conditioned."""
    singular = np.linalg.svd(expected.jacobian, compute_uv=False)
    assert relative(found.residual, expected.residual) < 1e-10
    slope = expected.by_parameter
    assert np.abs(found.by_parameter - slope).max() < 1e-10 * max(1e-3, np.abs(slope).max())
    condition = float(singular[0] / singular[-1])
    assert relative(found.solve(right), expected.solve(right)) < 1e-13 * condition + 1e-11
    assert found.sign == expected.sign or condition > 1e10


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(list(RANGES)),
    st.sampled_from(LAWS),
    st.sampled_from(["modal", "rayleigh"]),
    st.integers(1, 8),
    st.integers(1, 3),
    st.integers(1, 6),
    SEEDS,
)
def test_coupled_equations_at_a_point(
    name: str, law: str, damping: str, harmonics: int, pairs: int, modes: int, seed: int
) -> None:
    """Of random chains in every family: fewer modes than pairs among them, clearances of either
    sign."""
    if law == "rigid" and name == "stiffness":
        name = "omega"
    family = coupled_family(name, law, damping, harmonics, pairs, modes, seed)
    kernel, random = family.compiled, np.random.default_rng(seed)
    assert isinstance(kernel, CompiledEquations)
    gap, right = random_gap(random, harmonics, pairs), random.normal(size=family.shape)
    parameter = float(random.uniform(-0.2, 1.2))
    expected = family.linearise(gap, parameter)
    assert_same_equations(kernel.linearise(gap, parameter), expected, right)


@pytest.mark.parametrize("formed", [True, False])
@pytest.mark.parametrize("name", list(RANGES))
def test_coupled_path_of_a_chain(name: str, formed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With three pairs on lips without mass, in every family: the steps that Python's loop takes,
    to rounding where J is formed, to what products leave where it is not."""
    if not formed:
        monkeypatch.setattr(contact_system, "MATRIX_FREE", 0)
    family = coupled_family(name, "penalty", "modal", 5, 3, 4, 1)
    system = family.system(family.start)
    assert system.integrals.coupled and system.matrix_free != formed
    start = solve_at(Plain(family), system.linear, 0.0, tolerance=1e-12)
    assert start is not None
    close, slope = (1e-11, 1e-10) if formed else (1e-6, 1e-3)
    options = PathOptions(0.01, max_step=0.2, min_step=1e-10)
    ways = [
        list(islice(Path(way, point_on_path(way, start.unknown, 0.0), options).points(), 12))
        for way in (family, Plain(family))
    ]
    for one, other in zip(*ways, strict=True):
        assert one.parameter == pytest.approx(other.parameter, abs=close)
        assert np.allclose(one.unknown, other.unknown, rtol=0.0, atol=close)
        assert np.allclose(one.tangent.x, other.tangent.x, rtol=0.0, atol=slope)
        assert abs(one.iterations - other.iterations) <= (0 if formed else 1)


@pytest.mark.parametrize("limit", [350, 0])
def test_many_unknowns(limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rigid path through its folds, its solutions found by products and its sign by factors, or
    not at all: its points are solutions, and it ends where Python's ends."""
    monkeypatch.setattr(contact_system, "MATRIX_FREE", limit)
    whole = chain("modal", pairs=3)
    structure = fc.reduce_structure(whole, modes=6, method="massless")
    problem = fc.Problem(structure, 0.83, fc.UnilateralConstraint(), 20)
    family = FAMILIES["omega"](problem, 0.6, 0.45)
    begun = fc.solve_harmonic_balance(structure, 0.6, problem.contact, harmonics=20)
    start = begun.slow_gap_coefficients
    ends = []
    for system in (family, Plain(family)):
        begun = point_on_path(system, start, 0.0)
        path = Path(system, begun, PathOptions(0.05, max_step=0.3), [Target(1.0)])
        for point in path.points():
            at = family.linearise(point.unknown, point.parameter)
            assert np.linalg.norm(at.residual) < 2e-8 * np.linalg.norm(point.unknown)
        assert path.ended is Ended.MET and path.last.parameter == 1.0
        ends.append(path.last.unknown)
    assert relative(ends[0], ends[1]) < 1e-8


def test_an_instant_without_forces_is_no_solution() -> None:
    """Waves that are not finite: no point, and no crash."""
    family = coupled_family("omega", "rigid", "modal", 4, 3, 5, 2)
    for wrong in (np.nan, np.inf, 1e300):
        guess = np.full(family.shape, wrong)
        assert solve_at(family, guess, 0.5, tolerance=1e-9) is None
    compiled = family.compiled
    assert compiled is not None and compiled.linearise(np.zeros(family.shape), 0.5).residual.any()
    at = compiled.linearise(np.full(family.shape, np.nan), 0.5)  # not the residual of the former
    with pytest.raises(fc.ConvergenceError, match="no forces were found at an instant"):
        _ = at.residual
