"""Orders of two modes that are passed close to each other, and orders that few probes see."""

from __future__ import annotations

import neighbouring_modes
import numpy as np
import pytest
from helpers import DEMOS

import fenics_crack as fc


@pytest.mark.nightly
def test_orders_of_two_modes() -> None:
    """Three probes, orders 8 and 4 at speeds 1.6 % apart: one by one four resonances of orders 3,
    6, 14 and 10 were found; together they are two, of their orders."""
    rng = np.random.default_rng([2, 3])
    for _ in range(4):
        arrivals, modes = neighbouring_modes.record(3, rng)
    fits = sorted(fc.find_passages(arrivals, range(1, 17)), key=lambda fit: fit.omega)
    assert [(fit.order, neighbouring_modes.stated_alone(fit)) for fit in fits] == [
        (order, True) for order, _ in sorted(modes, key=lambda mode: mode[1])
    ]
    for fit, (_, omega) in zip(fits, sorted(modes, key=lambda mode: mode[1]), strict=True):
        assert abs(fit.omega - omega) < 4.0 * fit.omega_error and fit.margin > 100.0


def test_two_probes_test_no_order() -> None:
    """Two of three probes of a measured record show order 7, where three show 6: every other order
    is listed; one that is given alone is not in question."""
    [blade] = fc.read_record(DEMOS / "blisk_blade.csv", tip_radius=0.164).values()
    two_probes = blade.without(np.array([1]))
    fit = fc.fit_passage(two_probes, 130.1, range(5, 9))
    assert fit.is_order_untested and fit.probes == 2 and fit.order == 7
    assert {fit.order, *fit.ambiguous_orders} == {5.0, 6.0, 7.0, 8.0}
    assert "order untested by 2 probes" in repr(fit)
    single_order_fit = fc.fit_passage(two_probes, 130.1, [6])
    assert not single_order_fit.is_order_untested and single_order_fit.ambiguous_orders == ()
    assert not fc.fit_passage(blade, 130.1, range(5, 9)).is_order_untested
