"""The generated records of ``benchmarks/tip_records.py``, a few of them."""

from __future__ import annotations

import numpy as np
import pytest
import tip_records

import fenics_crack as fc


@pytest.mark.drawn(1)
@pytest.mark.parametrize("number", [2, 6, 9])
def test_orders_and_lines_of_generated_records(number: int) -> None:
    """Each order right or declared, each vibration of no order found, most intervals hold."""
    row, count = tip_records.ROWS[number], tip_records.Count()
    rng = np.random.default_rng([7, number])
    for _ in range(3):
        tip_records.judge(row, tip_records.draw(row, rng), count)
    assert count.order + count.declared == 3 and count.found == 3
    assert count.covered >= 2 and count.also >= 2 and count.unwarned <= 1


def test_errors_of_probes_and_the_line_alone() -> None:
    """Without errors of its probes' angles the order is known not to fit; the line is named, and
    found by itself."""
    record = tip_records.draw(tip_records.ROWS[0], np.random.default_rng(4))
    fit = fc.fit_order(record.arrivals, angle_deviation=tip_records.ANGLE_DEVIATION)
    assert fit.order == record.order and not fit.does_not_fit
    assert f"beside {fit.asynchronous[0].omega:.6g} rad/s" in repr(fit)
    exact = fc.fit_order(record.arrivals, [record.order])
    assert exact.does_not_fit and exact.amplitude_errors[0] > 1e-5
    ends = 0.9 * record.asynchronous, 1.1 * record.asynchronous
    line_fit = fc.fit_frequency(record.arrivals, *ends, angle_deviation=1.0)
    assert line_fit.omega == pytest.approx(record.asynchronous, rel=1e-4)


@pytest.mark.nightly
@pytest.mark.parametrize("draws", [4, 15])
def test_no_order_is_excluded_by_a_harmonic_left_out(draws: int) -> None:
    """Five probes and a sine fitted to a wave of four harmonics: where the order is wrong, the
    right one is said to fit as well."""
    row, count = tip_records.ROWS[13], tip_records.Count()
    rng = np.random.default_rng([1, 13])
    for _ in range(draws):
        tip_records.judge(row, tip_records.draw(row, rng), count)
    assert count.order + count.declared == draws and draws < 3 * count.order < 2.4 * draws
