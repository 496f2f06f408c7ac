"""Contact behind a static compliance in the kernel against the same equations in NumPy."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from helpers import chain, relative
from hypothesis import given, settings
from hypothesis import strategies as st
from test_compiled_paths import RANGES, SEEDS, Plain, random_gap

import fenics_crack as fc
from fenics_crack.balance import contact_system
from fenics_crack.balance.compiled import CompiledEquations
from fenics_crack.balance.family import FAMILIES, Family
from fenics_crack.numerics.bordered import point_on_path, solve_at
from fenics_crack.numerics.linearisation import Linearisation
from fenics_crack.numerics.path import Ended, Path, PathOptions, Target

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
def test_equations_at_a_point(
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
def test_path_of_a_chain(name: str, formed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
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
