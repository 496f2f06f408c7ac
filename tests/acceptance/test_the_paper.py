"""docs/the_paper.md: the paper's figures, equations and claims have rows whose numbers hold."""

import re
import runpy
from functools import cache

import numpy as np
import pytest
from helpers import ROOT, assert_found, rows_of_the_paper

import fenics_crack as fc

DEMOS = ROOT / "demos"
OMEGA, STIFFNESS = 2000.0, 1e11  # rad/s, N/m
amplitudes = runpy.run_path(str(DEMOS / "paper_plate.py"))["amplitudes"]


@cache
def plate() -> fc.Structure:
    """The paper's plate with the paper's data."""
    return fc.build_structure(fc.Scene.load(DEMOS / "paper_plate.toml"))


def corner() -> int:
    """Number of the dof at the load."""
    return plate().find_dof((0.1, 0.1), "x")


def test_every_figure_and_equation_has_a_row() -> None:
    """Figures 1 to 8, equations 1 to 15; and each row has five cells."""
    numbers_by_kind: dict[str, set[int]] = {"Figure": set(), "Equation": set()}
    for name, cells in rows_of_the_paper().items():
        assert len(cells) == 4, name
        for kind, numbers in numbers_by_kind.items():
            if name.startswith(kind):
                numbers |= {int(number) for number in re.findall(r"\d+", name)}
    assert numbers_by_kind == {"Figure": set(range(1, 9)), "Equation": set(range(1, 16))}


def test_the_data_are_those_of_the_scene() -> None:
    """Stiffness, damping and harmonics stand in the page's first sentences."""
    scene = fc.Scene.load(DEMOS / "paper_plate.toml")
    page = " ".join((ROOT / "docs" / "the_paper.md").read_text().split())
    ratio, stiffness = scene.damping.ratio, f"{scene.contact.stiffness:.0e}".replace("+", "")
    data = f"{100.0 * ratio:g} % of critical damping, H = {scene.harmonic_balance.harmonics}."
    assert f"{stiffness} N/m, {data}" in page


@pytest.mark.parametrize("name", rows_of_the_paper())
def test_row_names_what_checks_it(name: str) -> None:
    """A test that exists, and what it is about."""
    file, _, function = rows_of_the_paper()[name][3].strip("`").partition("::")
    assert f"def {function or 'main'}(" in (ROOT / file).read_text()


def test_bonded_by_a_spring_and_rigidly() -> None:
    """The spring of the contact gives a little; `check` prints the rigid bond."""
    omegas = [
        fc.solve_modes(plate().tied(STIFFNESS), 1).omega[0],
        fc.solve_modes(plate(), 1, lips="tied").omega[0],
    ]
    assert_found("Figure 1", *(f"{omega:.1f} rad/s" for omega in omegas))


def test_figure_2() -> None:
    """The numbers are those of the verification book's page."""
    book = (ROOT / "docs" / "verification" / "calculix_paper_plate.md").read_text()
    max_errors = [
        max(
            float(line.split(" | ")[1])
            for line in book.splitlines()
            if line.startswith(f"| {name} N/m, 5 periods: ")
        )
        for name in ("1e9", "1e11")
    ]
    assert_found("Figure 2", *(f"{100.0 * error:.2g} %" for error in max_errors))


def test_five_harmonics() -> None:
    """From H = 5 at the paper's data an unstable orbit is found, and its distance is the error."""
    law = fc.UnilateralPenalty(STIFFNESS)
    five = fc.solve_harmonic_balance(plate(), OMEGA, law, harmonics=5)
    assert five.report.confirmed and 0.05 < five.report.total < 0.1
    near = five.assessment.nearest_orbit
    assert near is not None and not near.is_stable
    exact = fc.solve_harmonic_balance(plate(), OMEGA, law, tolerance=1e-2)
    assert exact.report.total < 1e-2
    assert exact.orbit is not None and not exact.orbit.is_stable
    assert near.amplitude(corner()) == pytest.approx(exact.orbit.amplitude(corner()), rel=1e-3)
    sizes = [f"{1e6 * motion.amplitude(corner()):.3f} um" for motion in (five, exact.orbit)]
    assert_found("few harmonics", sizes[0], f"{100.0 * five.report.total:.0f} %", sizes[1])


def test_penetration() -> None:
    """Its share of the opening."""
    times = np.linspace(0.0, 2.0 * np.pi / OMEGA, 20001)
    law = fc.UnilateralPenalty(STIFFNESS)
    gap = fc.solve_harmonic_balance(plate(), OMEGA, law, harmonics=5).gap(times)
    assert_found("penalty", f"{-100.0 * gap.max() / gap.min():.2f} %")


def test_periods_until_steady() -> None:
    """From rest, soft."""
    scene = fc.Scene.load(DEMOS / "paper_plate.toml").replace({"damping.ratio": 0.01})
    history = fc.integrate_central_difference(
        fc.build_structure(scene), OMEGA, fc.UnilateralPenalty(1e9), periods=200,
        steps_per_period=512, settle=1e-6, record_periods=1,
    )  # fmt: skip
    assert history.settled < 1e-5
    assert_found("steady state", f"{history.periods} periods")


def test_the_period() -> None:
    """Exact motion: upward crossings are as many as load periods; the spectrum's lines."""
    periods = 240
    law = fc.UnilateralPenalty(STIFFNESS)
    start = fc.solve_harmonic_balance(plate(), OMEGA, law, harmonics=5)
    history = fc.integrate_events(
        plate(), OMEGA, law, periods=periods, initial=start, record_periods=periods // 2
    )
    motion = history.by_period(history.displacement([corner()])[:, 0])
    orders, lines = amplitudes(motion)
    main = lines[np.argmin(np.abs(orders - 1.0))]
    for order in (1.44, 1.56):
        is_near = np.abs(orders - order) < 0.03
        assert lines[is_near].max() > 0.005 * main
        assert lines[is_near].max() > 5.0 * np.median(lines[(orders > 1.1) & (orders < 1.9)])
    samples = motion.ravel()
    crossings = np.count_nonzero((samples[:-1] < 0.0) & (samples[1:] >= 0.0)) / len(motion)
    stability = fc.floquet(plate(), fc.solve_harmonic_balance(plate(), OMEGA, law, tolerance=1e-3))
    assert stability.verdict == "unstable" and stability.multipliers[0].imag == 0.0
    unstable_size, first_size, second_size = np.abs(
        stability.multipliers[[0, 1, 3]]
    )  # each pair takes two places
    sizes = f"{unstable_size:.2f}, {first_size:.4f} and {second_size:.4f}"
    assert_found("period", "1, 1.44, 1.56 and 2 times", f"{crossings:.3f} times", sizes)


@pytest.mark.nightly
def test_small_difference() -> None:
    """Response curves of a blade with two cracks and of the whole one."""
    blade = fc.Scene.load(DEMOS / "blade.toml")
    sizes = []
    for length in (0.004, 0.008):
        curve = fc.curve(
            blade.replace({"crack.length": length, "curve.start": 730.0, "curve.stop": 830.0,
                           "mesh.error": False})
        ).result  # fmt: skip
        size = curve.amplitude()
        peak = int(size.argmax())
        sizes += [f"{100.0 * length / blade.geometry.width:.0f} %"]
        sizes += [f"{1e6 * size[peak]:.1f} um", f"{curve.omega[peak] / (2.0 * np.pi):.1f} Hz"]
    full_structure = fc.build_structure(blade.replace({"crack": None, "contact": None}))
    first_omega = fc.solve_modes(full_structure, 1).omega[0]
    reduced_structure = fc.reduce_structure(full_structure, modes=20)
    sizes += [f"{1e6 * fc.solve_linear(reduced_structure, first_omega).amplitude():.1f} um"]
    sizes += [
        f"{first_omega / (2.0 * np.pi):.1f} Hz",
        f"{2.0 * 0.002 * first_omega / (2.0 * np.pi):.1f} Hz",
    ]
    assert_found("small difference", *sizes)


BANDS = ((2302.9, 3481.6, 1), (4725.0, 8043.6, 3), (8579.3, 9356.6, 3))
"""First three natural frequencies with an open crack and without one [rad/s]; printed digits."""


@pytest.mark.nightly
def test_three_resonances() -> None:
    """The paper's method reaches the end; its peaks, and the answer to a tolerance there."""
    law = fc.UnilateralPenalty(STIFFNESS)
    curve = fc.continue_frequency(plate(), 1000.0, 9500.0, law, harmonics=5)
    assert curve.complete
    size, omega = curve.amplitude(corner()), curve.omega
    peaks, exact, stated_figures = [], [], []
    for lower_omega, upper_omega, digits in BANDS:
        band_indices = np.flatnonzero((omega > lower_omega) & (omega < upper_omega))
        peak = int(band_indices[size[band_indices].argmax()])
        peaks += [f"{1e6 * size[peak]:.{digits}f} um", f"{omega[peak]:.0f} rad/s"]
        answer = fc.solve_harmonic_balance(
            plate(), float(omega[peak]), law, tolerance=1e-2, throw=False
        )
        stated_figures += [f"{100.0 * answer.report.total:.1f} % stated"]
        assert fc.floquet(plate(), answer).verdict == "unstable"
        exact += [f"{1e6 * answer.amplitude(corner()):.{digits}f} um"]
    assert float(stated_figures[0].split()[0]) < 1.0 > float(stated_figures[2].split()[0])
    assert_found("three resonances", *peaks, *exact[:2], stated_figures[1], exact[2])
