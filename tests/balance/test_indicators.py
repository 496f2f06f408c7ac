"""Indicators of a breathing crack: closed forms, known coefficients, curves against solutions."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import chain, oscillator, period_two_orbit

import fenics_crack as fc
from fenics_crack.balance.solution import contact_extremes, indicators_of
from fenics_crack.numerics.fourier import balanced


def test_known_coefficients() -> None:
    """U_1 = 5, U_2 = 10, U_3 = 13, a0 = -2.5: ratios 2, 2.6 and -0.5."""
    rows = np.array([-2.5, 3.0, 4.0, 6.0, -8.0, 5.0, 12.0])
    found = indicators_of(7.0, rows, 11.0, {"opening": 0.25})
    assert (found.omega, found.amplitude, found.mean) == (7.0, 11.0, -2.5)
    assert (found.harmonic_1, found.harmonic_2, found.harmonic_3) == (5.0, 10.0, 13.0)
    assert (found.ratio_2_1, found.ratio_3_1, found.mean_shift) == (2.0, 2.6, -0.5)
    assert (found.ratio_largest, found.largest_order) == (2.6, 3.0)
    assert found.opening == 0.25
    assert np.isnan([found.ratio_half_1, found.contact_force, found.closed_share]).all()


@pytest.mark.parametrize(("periods", "half"), [(2, 2.0), (3, np.nan)])
def test_longer_periods(periods: int, half: float) -> None:
    """Rows count parts of the load's frequency: harmonic m is U_1, and m / 2 is U_1/2."""
    rows = np.zeros(2 * 3 * periods + 1)
    rows[1], rows[2 * periods], rows[4 * periods - 1], rows[6 * periods] = 6.0, 3.0, 1.5, 0.75
    found = indicators_of(1.0, rows, 0.0, {}, periods)
    assert (found.harmonic_1, found.ratio_2_1, found.ratio_3_1) == (3.0, 0.5, 0.25)
    assert (found.ratio_largest, found.largest_order) == (0.5, 2.0)
    np.testing.assert_equal(found.ratio_half_1, half)


def test_few_harmonics_and_no_motion() -> None:
    """What is not known is nan, and no division warns."""
    found = indicators_of(np.ones(2), np.array([[1.0, 2.0, 0.0], [1.0, 0.0, 0.0]]), np.ones(2), {})
    np.testing.assert_array_equal(found.mean_shift, [0.5, np.nan])
    assert np.isnan([found.ratio_2_1, found.ratio_3_1, found.harmonic_2]).all()
    assert np.isnan([found.ratio_largest, found.largest_order]).all()


def test_rounding_has_no_largest_harmonic() -> None:
    """Of the whole motion, to which the mean belongs: 1e-13 of it is no harmonic, 1e-11 is one."""
    rows = np.array([[100.0, 1.0, 0.0, 1e-11, 0.0], [100.0, 1.0, 0.0, 0.0, 1e-9]])
    found = indicators_of(np.ones(2), rows, np.ones(2), {})
    np.testing.assert_array_equal(found.largest_order, [np.nan, 2.0])
    np.testing.assert_array_equal(found.ratio_largest, [1e-11, 1e-9])


def test_force_of_each_crack() -> None:
    """Pairs of one crack count together at each instant, those of another one by themselves."""
    force = np.array([[3.0, 0.0, 4.0], [2.0, 2.0, 0.0]])
    for cracks, expected in ((None, 7.0), ([0, 0, 1], 4.0), ([0, 1, 1], 4.0), ([0, 1, 2], 4.0)):
        given = None if cracks is None else np.array(cracks)
        found = contact_extremes(-np.ones((2, 3)), force, given)
        assert (found["contact_force"], found["crack_force"]) == (4.0, expected)


def test_force_of_a_crack_does_not_depend_on_the_mesh() -> None:
    """Twice the elements along the lips halve the force of the largest pair, not that of all."""
    scene = fc.Scene.load("demos/blade.toml").replace({"excitation.frequency": 600.0})
    found = []
    for elements in (3, 6):
        blade = fc.prepare(scene.replace({"mesh.lip_elements": elements}))
        omega = blade.scene.excitation.omega
        solution = fc.solve_harmonic_balance(blade.structure, omega, blade.contact, harmonics=10)
        found.append(solution.indicators(0))
    assert found[1].crack_force == pytest.approx(found[0].crack_force, rel=0.05)
    assert found[1].contact_force < 0.75 * found[0].contact_force


def bilinear_wave(ratio: float, count: int) -> np.ndarray:
    """A free motion of x'' + x = 0 for x < 0, x'' + r^2 x = 0 for x > 0, over one period."""
    open_share = ratio / (1.0 + ratio)
    time = np.arange(count) / count
    closed = np.sin(np.pi * time / (1.0 - open_share)) / ratio
    open_part = -np.sin(np.pi * (time - (1.0 - open_share)) / open_share)
    return np.where(time < 1.0 - open_share, closed, open_part)


@pytest.mark.parametrize("ratio", [1.2, 2.0, 4.0])
def test_wave_of_a_bilinear_oscillator(ratio: float) -> None:
    """Half sines of lengths A (peak -1) and B (peak 1/r) of the period, of which one alone has

    int_0^A sin(pi t / A) exp(-2 pi i k t) dt = A (1 + exp(-2 pi i k A)) / (pi (1 - 4 k^2 A^2)).
    """
    is_open, closed = ratio / (1.0 + ratio), 1.0 / (1.0 + ratio)

    def part(order: int) -> float:
        """|U_k| from the integral of each half sine, from t = 0 and from t = B."""

        def half_sine(length: float) -> complex:
            turn = np.exp(-2j * np.pi * order * length)
            return length / np.pi * (1.0 + turn) / (1.0 - 4.0 * (order * length) ** 2)

        shift = np.exp(-2j * np.pi * order * closed)
        return abs(2.0 * (half_sine(closed) / ratio - shift * half_sine(is_open)))

    wave = bilinear_wave(ratio, 8192)
    found = indicators_of(1.0, balanced(wave, 5), np.ptp(wave) / 2.0, {})
    mean = 2.0 * closed / (np.pi * ratio) - 2.0 * is_open / np.pi
    assert found.harmonic_1 == pytest.approx(part(1), rel=1e-6)
    assert found.ratio_2_1 == pytest.approx(part(2) / part(1), rel=1e-6)
    assert found.ratio_3_1 == pytest.approx(part(3) / part(1), rel=1e-5)
    assert found.mean_shift == pytest.approx(mean / part(1), rel=1e-6)
    assert found.amplitude == pytest.approx((1.0 + 1.0 / ratio) / 2.0, rel=1e-5)
    lips = contact_extremes(wave[:, None], np.maximum(wave, 0.0)[:, None])
    assert lips["closed_share"] == pytest.approx(closed, abs=1e-3)
    assert lips["opening"] == pytest.approx(1.0, rel=1e-6)
    assert lips["penetration"] == lips["contact_force"] == pytest.approx(1.0 / ratio, rel=1e-5)


def test_bilinear_oscillator_at_its_resonance() -> None:
    """Lightly damped and driven at 2 w_o w_c / (w_o + w_c), its wave is that of the free motion."""
    ratio = 2.0
    omega = 2.0 * ratio / (1.0 + ratio)
    structure = oscillator(damping=0.001)
    law = fc.UnilateralPenalty(ratio**2 - 1.0)
    found = fc.solve_harmonic_balance(structure, omega, law, harmonics=20).indicators(0)
    wave = bilinear_wave(ratio, 8192)
    free = indicators_of(omega, balanced(wave, 20), np.ptp(wave) / 2.0, {})
    assert found.ratio_2_1 == pytest.approx(free.ratio_2_1, rel=1e-3)
    assert found.ratio_3_1 == pytest.approx(free.ratio_3_1, rel=1e-2)
    assert found.mean_shift == pytest.approx(free.mean_shift, rel=1e-3)
    assert found.closed_share == pytest.approx(1.0 / (1.0 + ratio), abs=2e-3)
    curve = fc.continue_frequency(structure, 1.2, 1.4, law, harmonics=10)
    along = curve.indicators(0)
    assert along.omega[np.argmax(along.amplitude)] == pytest.approx(omega, rel=2e-3)


def test_linear_motion_has_one_harmonic() -> None:
    """A linear solution: nothing but U_1, and no lips' force."""
    found = fc.solve_linear(chain(), 1.3, harmonics=4).indicators(2)
    assert found.ratio_2_1 < 1e-14
    assert found.ratio_3_1 < 1e-14
    assert found.contact_force == found.closed_share == 0.0
    assert found.amplitude == pytest.approx(found.harmonic_1, rel=1e-4)


def test_half_the_loads_frequency() -> None:
    """A period-two orbit shows it."""
    solution = period_two_orbit(20)
    found = solution.indicators(0)
    rows = solution.coefficients_at([0])[:, 0]
    assert found.ratio_half_1 == pytest.approx(np.hypot(*rows[1:3]) / np.hypot(*rows[3:5]))
    assert found.ratio_half_1 > 0.1


@pytest.mark.parametrize("massless", [False, True])
def test_curve_has_the_indicators_of_its_solutions(massless: bool) -> None:
    """Point by point, of two dofs at once, with 256 instants instead of 1024."""
    structure: fc.Structure = chain(damping="rayleigh")
    law: fc.ContactLaw = fc.UnilateralPenalty(5.0)
    if massless:
        structure = fc.reduce_structure(structure, modes=6, method="massless")
        law = fc.UnilateralConstraint()
    curve = fc.continue_frequency(structure, 0.5, 0.6, law, harmonics=8)
    for dof, along in zip((0, 5), curve.measure([0, 5]), strict=True):
        assert along.to_dict().keys() == curve.indicators(dof).to_dict().keys()
        for index in (0, len(curve) // 2, -1):
            alone = curve.solution(index).indicators(dof)
            for name, value in alone.to_dict().items():
                expected = pytest.approx(value, rel=5e-3, abs=5e-3 * alone.amplitude, nan_ok=True)
                assert getattr(along, name)[index] == expected, name
    assert f"{len(curve)} points" in repr(along)
    assert along.table().columns[:2] == ["omega [rad/s]", "amplitude [m]"]
