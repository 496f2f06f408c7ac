"""Contact behind a static compliance in the kernel against the same equations in NumPy."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from helpers import chain, relative
from hypothesis import given, settings
from hypothesis import strategies as st
from test_compiled_paths import RANGES, SEEDS, Plain, assert_same_path, random_gap

import fenics_crack as fc
from fenics_crack.balance.bordered import solve_at
from fenics_crack.balance.compiled import CompiledCoupled
from fenics_crack.balance.coupled import CoupledSystem
from fenics_crack.balance.family import FAMILIES, Family
from fenics_crack.balance.linearisation import Linearisation

LAWS = ("rigid", "penalty", "stiff")
SHORTER = {name: ends for name, ends in RANGES.items() if name != "stiffness"}


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


def assert_same_equations(
    found: Linearisation, expected: Linearisation, right: np.ndarray
) -> None:
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
    assert isinstance(kernel, CompiledCoupled)
    gap, right = random_gap(random, harmonics, pairs), random.normal(size=family.shape)
    parameter = float(random.uniform(-0.2, 1.2))
    expected = family.linearise(gap, parameter)
    assert_same_equations(kernel.linearise(gap, parameter), expected, right)


if __name__ == "__main__":
    test_equations_at_a_point()
