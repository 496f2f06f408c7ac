"""Orders of two modes that are passed close to each other, and orders that few probes see."""

from __future__ import annotations

import neighbouring_modes
import numpy as np
from helpers import DEMOS

import fenics_crack as fc
from fenics_crack.monitoring.tip_timing.arrival_times import between
from fenics_crack.monitoring.tip_timing.harmonics import MISFIT
from fenics_crack.monitoring.tip_timing.robust import Noise, trend


def test_orders_of_two_modes() -> None:
    """Three probes, orders 8 and 4 at speeds 1.6 % apart: one by one four resonances of orders 3,
    6, 14 and 10 were found; together they are two, of their orders."""
    rng = np.random.default_rng([2, 3])
    for _ in range(4):
        arrivals, modes = neighbouring_modes.record(3, rng)
    found = sorted(fc.find_passages(arrivals, range(1, 17)), key=lambda one: one.omega)
    assert [(one.order, neighbouring_modes.stated_alone(one)) for one in found] == [
        (order, True) for order, _ in sorted(modes, key=lambda one: one[1])
    ]
    for fit, (_, omega) in zip(found, sorted(modes, key=lambda one: one[1]), strict=True):
        assert abs(fit.omega - omega) < 4.0 * fit.omega_error and fit.margin > 100.0


def test_two_probes_test_no_order() -> None:
    """Two of three probes of a measured record show order 7, where three show 6: every other order
    is listed; one that is given alone is not in question."""
    [blade] = fc.read_record(DEMOS / "blisk_blade.csv", tip_radius=0.164).values()
    two = blade.without(np.array([1]))
    fit = fc.fit_passage(two, 130.1, range(5, 9))
    assert fit.untested and fit.probes == 2 and fit.order == 7
    assert {fit.order, *fit.ambiguous} == {5.0, 6.0, 7.0, 8.0}
    assert "order untested by 2 probes" in repr(fit)
    known = fc.fit_passage(two, 130.1, [6])
    assert not known.untested and known.ambiguous == ()
    assert not fc.fit_passage(blade, 130.1, range(5, 9)).untested


def test_errors_of_marks_leave_nothing_beside() -> None:
    """An error of a mark is in the arrivals of both revolutions that it ends and begins: these are
    as alike as that makes them, and no vibration is in doubt; one that is left is."""
    count, rng = 600, np.random.default_rng(5)
    angles = np.linspace(0.0, 0.95, 12)
    turns = np.arange(-4.0, 6.0)
    shares = between(turns, np.eye(len(turns)), angles).T
    places = tuple(one.ravel() for one in np.indices((count, len(angles))))
    seen, wrong = [], []
    for _ in range(20):
        marks = between(
            np.arange(-9.0, count + 10.0),
            rng.standard_normal(count + 19),
            np.arange(count)[:, None] + angles,
        )
        left = marks + rng.standard_normal(marks.shape)
        slow = np.sin(0.3 * np.arange(count)[:, None] + 9.0 * angles)
        noises = [
            Noise(values.ravel(), np.ones(left.size), 1.0, 1e6, 0) for values in (left, left + slow)
        ]
        seen.append([noise.whiteness(places, shares) for noise in noises])
        wrong.append(trend(left.ravel(), places) < MISFIT)
    alone, beside = np.array(seen).T
    assert sum(wrong) >= 10 and np.all(alone > MISFIT) and np.count_nonzero(alone < 0.05) <= 4
    assert np.all(beside < MISFIT)
