"""Oscillators with contact."""

from functools import cache
from typing import Any

import numpy as np
from book import Row, case, label
from helpers import (
    BILINEAR_ORBITS,
    OMEGA_0,
    amplitudes,
    classical_amplitudes,
    duffing_system,
    log_slope,
    newton_roots,
    oscillator,
    period_two_orbit,
    relative,
    sampled_harmonics,
    two_masses,
)

import fenics_crack as fc

ONE = fc.UnilateralPenalty(1.0)
STOP = fc.UnilateralPenalty(100.0)
NAMES = {0.5 * OMEGA_0: "W = w0/2", 1.0: "W = 1"}


def draw_bilinear_orbits(axes: Any) -> None:
    """Two periods of both motions."""
    for omega, name in NAMES.items():
        solution = fc.solve_harmonic_balance(oscillator(), omega, ONE, harmonics=20)
        share = np.linspace(0.0, 2.0, 800)
        axes.plot(share, solution.gap(share * solution.period), label=name)
    axes.axhspan(0.0, 3.0, color="0.9", zorder=0)
    axes.set(xlabel="t / period", ylabel="x", xlim=(0.0, 2.0), ylim=(-3.2, 2.8))
    axes.legend(loc="lower right")


@case(draw=draw_bilinear_orbits)
def bilinear_oscillator() -> list[Row]:
    """Bilinear oscillator: orbits.

    x'' + c x' + x + kc max(x, 0) = cos(W t) with c = 0.1 and kc = 1. Its natural frequency without
    damping is w0 = 2 w1 w2 / (w1 + w2) = 1.171573, w1 = 1 and w2 = sqrt(1 + kc) (Shaw and Holmes,
    J. Sound Vib. 90, 1983, 129-155). It is loaded at half of w0, where it resonates by its second
    harmonic, and at W = 1.

    Reference: piecewise-linear integration by another program, to about 1e-9, beside harmonic
    balance (H = 20, exact integrals) and `fc.integrate_events` from rest. Extremes are those of
    4096 samples a period. The product of the multipliers is exp(-c T) (Liouville).
    """
    rows = []
    for omega, (mean, waves, max_gap, min_gap) in BILINEAR_ORBITS.items():
        omega_name = NAMES[omega]
        solution = fc.solve_harmonic_balance(oscillator(), omega, ONE, harmonics=20)
        balance = solution.gap_coefficients[:, 0]
        wave = solution.gap(np.arange(4096) * solution.period / 4096)
        march = fc.integrate_events(
            oscillator(), omega, ONE, periods=300, settle=1e-12, record_periods=1,
            steps_per_period=4096,
        )  # fmt: skip
        flow_mean, flow_waves = sampled_harmonics(march.gap[:, 0])
        rows += [Row(f"{omega_name}: mean, harmonic balance", balance[0], mean, 1e-5)]
        rows += [Row(f"{omega_name}: mean, exact flow", flow_mean, mean, 0.5e-9, absolute=True)]
        for k in range(3):
            amplitude = amplitudes(balance)[k]
            rows += [
                Row(f"{omega_name}: abs(X{k + 1}), harmonic balance", amplitude, waves[k], 1e-5)
            ]
            name = f"{omega_name}: abs(X{k + 1}), exact flow"
            rows += [Row(name, flow_waves[k], waves[k], 0.5e-8, absolute=True)]
        for name, two, value in (
            ("largest x", (wave.max(), march.gap.max()), max_gap),
            ("smallest x", (wave.min(), march.gap.min()), min_gap),
        ):
            rows += [Row(f"{omega_name}: {name}, harmonic balance", two[0], value, 1e-5)]
            rows += [Row(f"{omega_name}: {name}, exact flow", two[1], value, 0.5e-8, absolute=True)]
        product = float(np.prod(fc.shoot(oscillator(), solution).multipliers).real)
        liouville = np.exp(-0.1 * solution.period)
        rows += [Row(f"{omega_name}: product of the multipliers", product, liouville, 1e-9)]
    return rows


COUNTS = (5, 10, 20, 40)


@cache
def truncation_errors() -> list[float]:
    """Relative L2 error over the period against H = 300, at W = 1."""
    t = np.linspace(0.0, 2.0 * np.pi, 4001)
    *waves, exact = (
        fc.solve_harmonic_balance(oscillator(), 1.0, ONE, harmonics=h).gap(t)
        for h in (*COUNTS, 300)
    )
    return [relative(wave, exact) for wave in waves]


def draw_truncation(axes: Any) -> None:
    """Errors over H."""
    axes.loglog(COUNTS, truncation_errors(), "o-", label="fenics_crack")
    axes.loglog(COUNTS, [3.1e-4, 3.7e-5, 4.0e-6, 3.9e-7], "kx", label="reference")
    axes.minorticks_off()
    axes.set_xticks(COUNTS, [str(count) for count in COUNTS])
    label(axes, xlabel="harmonics H", ylabel="relative L2 error of x over a period")


@case(draw=draw_truncation)
def bilinear_convergence() -> list[Row]:
    """Bilinear oscillator: convergence.

    The same oscillator. The contact force has kinks: abs(Xk) k^4 is 1.63 to 1.69 where it is
    largest in each octave of k = 8 to 128, at W = 1, so the error of H harmonics falls a little
    faster than H^-3. Sampled contact forces (H = 5, W = w0/2) add a second error.

    Reference: the same computations by another program, given to two digits.
    """
    published_errors = (3.1e-4, 3.7e-5, 4.0e-6, 3.9e-7)
    errors = truncation_errors()
    rows = [
        Row(f"relative L2 error, H = {h}", found, value, 0.1)
        for h, found, value in zip(COUNTS, errors, published_errors, strict=True)
    ]
    slope = log_slope(COUNTS, errors)
    rows += [Row("order of the error in H", slope, -3.2, 0.2, absolute=True)]
    solution = fc.solve_harmonic_balance(oscillator(), 1.0, ONE, harmonics=130)
    order = np.arange(1, 131)
    scaled_amplitudes = amplitudes(solution.gap_coefficients[:, 0]) * order**4
    for k in (8, 16, 32, 64):
        peak = float(scaled_amplitudes[(order >= k) & (order < 2 * k)].max())
        name = f"largest abs(Xk) k^4, k = {k} to {2 * k}"
        rows += [Row(name, peak, 1.66, 0.03, absolute=True)]
    exact = fc.solve_harmonic_balance(oscillator(), 0.5 * OMEGA_0, ONE, harmonics=5)
    t = np.linspace(0.0, exact.period, 4001)
    for samples, value in ((64, 6e-3), (256, 5e-4), (1024, 7e-6)):
        found = fc.solve_harmonic_balance(
            oscillator(), 0.5 * OMEGA_0, ONE, harmonics=5, samples=samples
        )
        error = relative(found.gap(t), exact.gap(t))
        rows += [Row(f"sampling error, {samples} samples", error, value, 0.15)]
    return rows


def draw_doubled(axes: Any) -> None:
    """Two periods of both orbits."""
    single_period = fc.solve_harmonic_balance(oscillator(), 2.0 * OMEGA_0, ONE, harmonics=20)
    share = np.linspace(0.0, 2.0, 800)
    for orbit, style, name in (
        (single_period, "C0--", "one period, unstable"),
        (period_two_orbit(40), "C1-", "two periods, stable"),
    ):  # fmt: skip
        axes.plot(share, orbit.gap(share * single_period.period)[:, 0], style, label=name)
    axes.axhline(0.0, color="0.7", lw=1)
    label(axes, xlabel="t / period of the load", ylabel="x", xlim=(0.0, 2.0))


@case(draw=draw_doubled)
def period_doubling() -> list[Row]:
    """Bilinear oscillator: an orbit of two periods.

    The same oscillator at W = 2 w0. The orbit of one period is unstable: a multiplier is below -1.
    The stable one takes two periods.

    Reference: event-driven integration and Newton's method by another program.
    """
    omega = 2.0 * OMEGA_0
    single_period = fc.solve_harmonic_balance(oscillator(), omega, ONE, harmonics=20)
    orbit = fc.shoot(oscillator(), single_period)
    twice = period_two_orbit(40).gap_coefficients[:, 0]
    first_amplitude = float(amplitudes(single_period.gap_coefficients[:, 0])[0])
    return [
        Row("abs(X1) of one period", first_amplitude, 0.2419996, 1e-6, absolute=True),
        Row("its multiplier", float(orbit.multipliers[0].real), -1.23694, 1e-5, absolute=True),
        Row("abs(X1/2) of two periods, H = 40", amplitudes(twice)[0], 0.7790634, 1.2e-5),
        Row("their mean", twice[0], -0.1735445, 1.2e-5),
    ]


@cache
def stop_curve() -> fc.ResponseCurve:
    """Two masses and a stop: exact orbits."""
    return fc.continue_frequency(two_masses(), 0.6, 0.9, STOP, tolerance=1e-2)


def draw_stop_curve(axes: Any) -> None:
    """The response and the two published points."""
    curve = stop_curve()
    amplitude = np.hypot(*curve.coefficients_at(1)[:, 1:3].T)
    unstable = np.convolve(~curve.stable, np.ones(3), "same") > 0.0  # with the points beside it
    for name, is_chosen, style in (("stable", curve.stable, "C0-"), ("unstable", unstable, "C0--")):
        axes.semilogy(curve.omega, np.where(is_chosen, amplitude, np.nan), style, label=name)
    axes.plot([0.7, 0.7], [0.77839461, 0.22134025], "kx", ms=8, mew=2, label="reference")
    label(axes, xlabel="W", ylabel="abs(X1) of mass 2")


@case(draw=draw_stop_curve)
def two_masses_and_a_stop() -> list[Row]:
    """Two masses and a stop.

    M = I, K = [[1, -1], [-1, 2]], C = 0.03 K, a load 0.1 cos(W t) on mass 2 and a spring of 100 on
    mass 1 beyond a clearance of 1. At W = 0.70 two stable orbits exist, one without contact; the
    other loses its stability in a period doubling.

    Reference: Krack and Gross, Harmonic Balance for Nonlinear Vibration Problems (Springer 2019),
    and example 3 of NLvib 1.3; the digits are from exact orbits by another program. The curve is
    one of exact orbits (`tolerance=1e-2`); H = 21 puts the doubling 8 % below.
    """
    curve = stop_curve()
    crossing = np.flatnonzero((curve.omega[:-1] - 0.7) * (curve.omega[1:] - 0.7) < 0.0)
    sizes = {}
    for harmonics in (21, 200):
        ends = []
        for start in (crossing[0], crossing[-1]):
            orbit = fc.solve_harmonic_balance(
                two_masses(), 0.7, STOP, harmonics=harmonics, initial=curve.solution(int(start))
            )
            ends.append(float(amplitudes(orbit.coefficients_at([1])[:, 0])[0]))
        sizes[harmonics] = sorted(ends)
    doubling_point = next(b for b in curve.bifurcations if b.kind == "period_doubling")
    return [
        Row("orbits at W = 0.70 on the curve", len(crossing), 3, 0.0, absolute=True),
        Row("abs(X1) of mass 2, no contact, H = 21", sizes[21][0], 0.22134025, 1e-6),
        Row("abs(X1) of mass 2, contact, H = 21", sizes[21][1], 0.77839461, 1e-3, absolute=True),
        Row("the same, H = 200", sizes[200][1], 0.77839461, 1e-7),
        Row("period doubling", doubling_point.omega, 0.7387830, 1e-7),
    ]


@cache
def duffing_roots() -> tuple[np.ndarray, np.ndarray]:
    """With 64 samples and with 3: (root, coefficient, 1)."""
    fine_roots, coarse_roots = (
        np.array(newton_roots(duffing_system(1, samples))) for samples in (64, 3)
    )
    return fine_roots, coarse_roots


def draw_roots(axes: Any) -> None:
    """Roots in the plane of both coefficients."""
    for roots, style, name in zip(
        duffing_roots(), ("o", "kx"), ("64 samples", "3 samples"), strict=True
    ):
        axes.plot(roots[:, 1, 0], roots[:, 2, 0], style, label=name)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    for place, size in enumerate(classical_amplitudes()):
        axes.plot(size * np.cos(angle), size * np.sin(angle), color="0.8", lw=1, zorder=0,
                  label=None if place else "abs(X1), closed form")  # fmt: skip
    axes.set(xlabel="cosine coefficient of x", ylabel="sine coefficient of x", aspect="equal")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


@case(draw=draw_roots)
def duffing_spurious_roots() -> list[Row]:
    """Duffing oscillator: roots that are none.

    x'' + 0.2 x' + x + x^3 = 1.25 sin 2t with one harmonic has three solutions; collocated at 2H + 1
    instants it has nine, of which six are none of the oscillator's (Liu and others, J. Comput.
    Phys. 215, 2006, 298-320). From 4H + 1 samples on they are gone.

    Reference: y = abs(X1)^2 is a root of ((1 - W^2 + 3 y / 4)^2 + (0.2 W)^2) y = 1.25^2. The number
    of collocated roots follows from a Groebner basis (`tests/balance/test_forms.py`).
    """
    exact = classical_amplitudes()
    fine_roots, coarse_roots = duffing_roots()
    root_amplitudes = np.sort(np.hypot(fine_roots[:, 1, 0], fine_roots[:, 2, 0]))
    return [
        Row("roots with 64 samples", len(fine_roots), 3, 0.0, absolute=True),
        Row("roots with 3 samples", len(coarse_roots), 9, 0.0, absolute=True),
        *(Row(f"abs(X1) of root {i + 1}", root_amplitudes[i], exact[i], 1e-9) for i in range(3)),
    ]
