"""Roache's index: a published example, exact powers, and sequences that are none."""

from __future__ import annotations

import math
from functools import partial

import pytest
from helpers import catch_error
from hypothesis import given
from hypothesis import strategies as st

import fenics_crack as fc

CELLS = (18000, 8000, 4500)
REATTACHMENT = (6.063, 5.972, 5.863)


def test_worked_example() -> None:
    """Celik and others, J. Fluids Eng. 130, 2008, 078001, table 1: the reattachment length on
    18000, 8000 and 4500 cells."""
    convergence = fc.grid_convergence([cells**-0.5 for cells in CELLS], REATTACHMENT)
    fine_ratio, coarse_ratio = (convergence.sizes[n + 1] / convergence.sizes[n] for n in range(2))
    assert (fine_ratio, coarse_ratio) == (pytest.approx(1.5), pytest.approx(1.333, abs=4e-4))
    assert convergence.behaviour == "asymptotic" and convergence.factor == 1.25
    assert convergence.order == pytest.approx(1.53, abs=0.01)
    assert convergence.extrapolated == pytest.approx(6.1685, abs=5e-4)
    finest_value, two, _ = REATTACHMENT
    assert abs(finest_value - two) / finest_value == pytest.approx(0.015, abs=5e-4)
    assert 1.0 - finest_value / convergence.extrapolated == pytest.approx(0.017, abs=5e-4)
    assert convergence.gci == pytest.approx(0.022, abs=5e-4)


@given(
    order=st.floats(0.51, 4.0),
    fine=st.floats(1.1, 3.0),
    coarse=st.floats(1.1, 3.0),
    limit=st.floats(-10.0, 10.0),
    factor=st.sampled_from([-1.0, 1.0]),
)
def test_powers_are_found(
    order: float, fine: float, coarse: float, limit: float, factor: float
) -> None:
    """f + C h^p gives p and f again, in any order of the sizes, and the uncertainty of each is
    1.25 times its distance from f."""
    sizes = [fine * coarse, 1.0, fine]
    values = [limit + factor * size**order for size in sizes]
    convergence = fc.grid_convergence(sizes, values, formal=4.0)
    assert convergence.behaviour == "asymptotic"
    assert convergence.order == pytest.approx(order, rel=1e-6)
    assert convergence.extrapolated == pytest.approx(limit, abs=1e-6)
    for place, size in enumerate(convergence.sizes):
        assert convergence.uncertainty(place) == pytest.approx(1.25 * size**order, abs=1e-5)


SEQUENCES = [
    # values with sizes 1, 2, 4; behaviour, order, exponent, uncertainty of the first
    ((1.0, 1.1, 1.3), "asymptotic", 1.0, 1.0, 1.25 * 0.1),
    ((1.0, 1.1, 1.35), "asymptotic", math.log2(2.5), 1.0, 1.25 * 0.1),
    ((1.0, 1.1, 1.5), "asymptotic", 2.0, 1.0, 1.25 * 0.1),
    ((1.0, 1.1, 1.21), "outside", math.log2(1.1), 0.5, 3.0 * 0.1 / (2.0**0.5 - 1.0)),
    ((1.0, 1.1, 1.2), "irregular", 0.0, math.nan, 3.0 * 0.2),
    ((1.0, 1.1, 1.15), "irregular", -1.0, math.nan, 3.0 * 0.15),
    ((1.0, 1.1, 1.1), "irregular", -math.inf, math.nan, 3.0 * 0.1),
    ((1.0, 1.1, 1.05), "irregular", math.nan, math.nan, 3.0 * 0.1),
    ((1.0, 1.01, 1.5), "irregular", math.log2(49.0), math.nan, 3.0 * 0.5),
    ((1.0, 1.0, 1.5), "irregular", math.inf, math.nan, 3.0 * 0.5),
    ((1.0, 1.0, 1.0), "unchanged", math.nan, math.nan, 0.0),
    ((0.0, 0.0, 0.0), "unchanged", math.nan, math.nan, 0.0),
    ((1.0, 1.1), "two sizes", math.nan, 1.0, 3.0 * 0.1),
]


@pytest.mark.parametrize(("values", "behaviour", "order", "exponent", "uncertainty"), SEQUENCES)
def test_behaviours(
    values: tuple[float, ...], behaviour: str, order: float, exponent: float, uncertainty: float
) -> None:
    """Theory's order is 1, that of the elements 4: no better one is used, none below 0.5; the
    spread counts where there is none."""
    convergence = fc.grid_convergence(
        [1.0, 2.0, 4.0][: len(values)], values, formal=1.0, highest=4.0
    )
    assert convergence.behaviour == behaviour
    assert convergence.order == pytest.approx(order, rel=1e-9, abs=1e-9, nan_ok=True)
    assert convergence.exponent == pytest.approx(exponent, nan_ok=True)
    assert convergence.uncertainty() == pytest.approx(uncertainty)
    assert convergence.has_error_from_limit == math.isfinite(convergence.extrapolated)
    assert behaviour in repr(convergence)


def test_order_above_theory() -> None:
    """Where it is not known how good elements are, it is doubted; a sum of powers is not."""
    doubted_convergence = fc.grid_convergence([1.0, 2.0, 4.0], [1.0, 1.1, 1.5], formal=1.0)
    assert (
        doubted_convergence.behaviour == "outside"
        and doubted_convergence.uncertainty() == pytest.approx(3.0 * 0.1)
    )


@given(
    shares=st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4).filter(lambda one: sum(one) > 0.1),
    fine=st.floats(1.2, 2.0),
    coarse=st.floats(1.2, 2.0),
)
def test_sums_of_powers_lie_within(shares: list[float], fine: float, coarse: float) -> None:
    """1 + sum C_q h^q, q = 1, 2, 3, 4 and C_q >= 0: no value is farther from 1 than is stated, by
    the factor of 1.25 at least."""
    sizes = [1.0, fine, fine * coarse]
    true_errors = [sum(c * size**q for q, c in enumerate(shares, 1)) for size in sizes]
    convergence = fc.grid_convergence(
        sizes, [1.0 + e for e in true_errors], formal=1.0, highest=4.0001
    )
    assert convergence.behaviour == "asymptotic"
    for place, error in enumerate(true_errors):
        assert convergence.uncertainty(place) >= 1.25 * error * (1.0 - 1e-6)


def test_bad_input() -> None:
    """Each error names what is wrong."""
    increasing_sizes = [1.0, 2.0, 3.0]
    for sizes in ([1.0], [1.0, 0.0, 2.0], [1.0, 1.0, 2.0]):
        catch_error(
            partial(fc.grid_convergence, sizes, increasing_sizes[: len(sizes)]), "sizes", sizes
        )
    for values in ([1.0, 2.0], [1.0, 2.0, math.nan]):
        catch_error(partial(fc.grid_convergence, increasing_sizes, values), "values", values)
    catch_error(
        lambda: fc.grid_convergence(increasing_sizes, increasing_sizes, formal=0.0), "formal", 0.0
    )
