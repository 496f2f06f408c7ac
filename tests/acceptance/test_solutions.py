"""What a solution and its error report promise."""

from pathlib import Path

import judged
import numpy as np
import pytest
from rotating import cracked

import fenics_crack as fc

DEMOS = Path(__file__).parents[2] / "demos"
SOFT = fc.UnilateralPenalty(1.0)
SYSTEMS = {
    "one mass": (judged.oscillator(), SOFT, 1.0),
    "one mass, half its frequency": (judged.oscillator(), SOFT, 0.5 * judged.OMEGA_0),
    "one mass, stiff": (judged.oscillator(), fc.UnilateralPenalty(30.0), 1.3),
    "two masses and a stop": (judged.two_masses(0.3), fc.UnilateralPenalty(100.0), 0.66),
    "three pairs": (judged.chain(), fc.UnilateralPenalty([3.0, 10.0, 30.0]), 1.3),
    "ten pairs": (judged.chain(10, 30, seed=2), fc.UnilateralPenalty(5.0), 0.5),
}


def solved(
    structure: fc.Structure, law: object, omega: float, harmonics: int
) -> fc.PeriodicSolution:
    """By harmonic balance."""
    return fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics)


@pytest.mark.drawn(6)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("harmonics", [10, 30])
def test_estimated_error_is_the_true_one(name: str, harmonics: int) -> None:
    """Within a factor of three of the distance to the exact orbit."""
    structure, law, omega = SYSTEMS[name]
    solution = solved(structure, law, omega, harmonics)
    true_error = judged.true_error(solution)
    assert 1e-9 < true_error < 0.1
    assert true_error / 3.0 < solution.report.total < 3.0 * true_error


@pytest.mark.parametrize("law", [fc.UnilateralConstraint(), fc.UnilateralPenalty(1e9)])
def test_plate_without_mass_at_its_lips(law: fc.ContactLaw) -> None:
    """The estimated truncation is the true one within a factor of three; forces press, and act on
    closed pairs alone; rigid lips do not pass through each other."""
    solution = solved(judged.plate(), law, 2000.0, 30)
    true_error = judged.true_error(solution)
    assert true_error < 0.02
    assert true_error / 3.0 < solution.report.total - solution.report.reduction < 3.0 * true_error
    time = np.linspace(0.0, solution.period, 257)
    gap, force = solution.gap(time), solution.contact_force(time)
    assert force.min() >= 0.0 and force.max() > 0.0
    depth = force / np.asarray(law.stiffness)
    assert np.abs(np.maximum(gap, 0.0) - depth).max() < 1e-9 * np.abs(gap).max()
    assert np.all((force == 0.0) | (gap >= -1e-9 * np.abs(gap).max()))


def test_error_falls_with_the_third_power() -> None:
    """The force has a kink, so its harmonics fall like k^-2, and those of the gap like k^-4: what
    is left out falls like H^-3.5 with one mass."""
    harmonics = np.array([9, 17, 33, 65])
    errors = [judged.true_error(solved(judged.oscillator(), SOFT, 1.0, int(h))) for h in harmonics]
    assert np.polyfit(np.log(harmonics), np.log(errors), 1)[0] < -3.0


def test_forces_follow_the_law() -> None:
    """lambda = k max(g, 0) in time, and their coefficients are those of that."""
    solution = solved(judged.oscillator(), SOFT, 1.0, 40)
    time = np.arange(4096) * solution.period / 4096
    force = solution.contact_force(time)
    assert np.array_equal(force, np.maximum(solution.gap(time), 0.0))
    spectrum = np.fft.rfft(force[:, 0]) / len(time)
    assert solution.force_coefficients[0, 0] == pytest.approx(spectrum[0].real, abs=1e-6)
    cosines = solution.force_coefficients[1::2, 0] - 1j * solution.force_coefficients[2::2, 0]
    assert np.abs(cosines - 2.0 * spectrum[1:41]).max() < 1e-6


def test_power_of_the_load_is_what_the_damper_takes() -> None:
    """Contact gives nothing over a period: mean of f x' = c mean of x'^2."""
    solution = solved(judged.oscillator(damping=0.07), SOFT, 1.1, 20)
    k = np.arange(1, 21) * solution.base_omega
    cosine, sine = (
        solution.displacement_coefficients[1::2, 0],
        solution.displacement_coefficients[2::2, 0],
    )
    damper_power = 0.07 * 0.5 * np.sum(k**2 * (cosine**2 + sine**2))
    assert 0.5 * k[0] * sine[0] == pytest.approx(damper_power, rel=1e-9)


def test_motion_grows_with_the_load_where_nothing_is_clear() -> None:
    """Without clearance the equations are homogeneous of the first degree."""
    structure, law = judged.oscillator(), fc.UnilateralPenalty(7.0)
    solution = solved(structure, law, 1.2, 15)
    tripled_solution = solved(structure.varied(load=3.0), law, 1.2, 15)
    assert np.abs(tripled_solution.gap_coefficients - 3.0 * solution.gap_coefficients).max() < 1e-9
    assert tripled_solution.report.total == pytest.approx(solution.report.total, rel=1e-3)


def test_phase_of_the_load_is_that_of_the_motion() -> None:
    """A sine in place of the cosine is the same motion a quarter of the period later."""
    structure = judged.oscillator()
    cosine = solved(structure, SOFT, 1.0, 15)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    sine = solved(structure.varied(load=turn), SOFT, 1.0, 15)
    time = np.linspace(0.0, cosine.period, 100)
    assert np.abs(sine.gap(time + 0.25 * cosine.period) - cosine.gap(time)).max() < 1e-9


def test_lips_that_never_touch_or_never_open() -> None:
    """The linear solution, and that of the tied structure; no error."""
    law = fc.UnilateralPenalty(4.0)
    open_structure = judged.oscillator(clearance=10.0)
    solution = solved(open_structure, law, 1.3, 5)
    linear = fc.solve_linear(open_structure, 1.3)
    assert np.abs(solution.gap_coefficients - linear.gap_coefficients).max() < 1e-12
    assert solution.report.total < 1e-9 and not np.any(solution.force_coefficients)
    pressed_structure = judged.oscillator(clearance=-10.0)  # 4 (x + 10) and x balance at x = -8
    solution = solved(pressed_structure, law, 1.3, 5)
    bonded_motion = fc.solve_linear(pressed_structure.tied(4.0), 1.3)
    assert solution.displacement_coefficients[0, 0] == pytest.approx(-8.0, rel=1e-12)
    difference = (
        bonded_motion.displacement_coefficients[1:3] - solution.displacement_coefficients[1:3]
    )
    assert np.abs(difference).max() < 1e-12 and solution.report.total < 1e-9


def test_twice_the_period_holds_the_same_motion() -> None:
    """Seen over two periods of the load: its odd harmonics are zero."""
    solution = solved(judged.oscillator(), SOFT, 1.0, 15)
    doubled_solution = fc.solve_harmonic_balance(
        judged.oscillator(), 1.0, SOFT, harmonics=30, subharmonic=2, initial=solution
    )
    assert doubled_solution.period == 2.0 * solution.period
    odd_rows = np.r_[1:60:4, 2:60:4]
    assert np.abs(doubled_solution.gap_coefficients[odd_rows]).max() < 1e-9
    time = np.linspace(0.0, doubled_solution.period, 100)
    assert np.abs(doubled_solution.gap(time) - solution.gap(time)).max() < 1e-9


def test_blade_whose_error_is_not_seen() -> None:
    """16 rigid pairs, 20 modes, 121.12 Hz, H = 15: 3.9e-3 off, and so it should say."""
    scene = fc.Scene.load(DEMOS / "blade.toml").replace(
        {"crack.length": 0.014, "mesh.lip_elements": 8, "excitation.frequency": 121.12}
    )
    study = fc.prepare(scene)
    solution = solved(study.structure, study.contact, study.scene.excitation.omega, 15)
    true_error = judged.true_error(solution)
    assert true_error == pytest.approx(3.892e-3, rel=1e-3)
    assert true_error < 3.0 * solution.report.total


@pytest.mark.parametrize(("speed", "clearance"), [(600.0, -4e-6), (1000.0, -1.2e-5)])
def test_a_large_steady_load_does_not_make_errors_small(speed: float, clearance: float) -> None:
    """A rotating blade is stretched by far more work than moves it: the error of the displacement
    is that of its vibration, beside one with 100 harmonics."""
    coarse_changes = {"mesh.size": 0.01, "mesh.lip_elements": 3, "reduction.modes": 6}
    blade = fc.prepare(cracked(speed).replace(coarse_changes | {"crack.clearance": clearance}))
    omega = fc.bilinear_frequencies(blade.structure).omega_bilinear[0]
    solution, exact = (
        fc.solve_harmonic_balance(blade.structure, omega, blade.contact, harmonics=count)
        for count in (3, 100)
    )
    amplitude, exact_amplitude = (answer.indicators().amplitude for answer in (solution, exact))
    assert 1e-3 < abs(amplitude / exact_amplitude - 1.0) < 2.0 * solution.report.displacement < 0.05


def test_cold_starts_with_several_stiff_pairs() -> None:
    """The path in the stiffness leads there, through hundreds of folds."""
    rng = np.random.default_rng(4)
    for _ in range(3):
        rotation = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        squares = np.append(1.0, 30.0 ** (2.0 * rng.random(5)))
        structure = fc.Structure.from_matrices(
            np.eye(6), (rotation * squares) @ rotation.T, gap=np.eye(6)[:, :3],
            force_cos=rng.normal(size=6),
            damping=(rotation * (0.01 * np.sqrt(squares))) @ rotation.T, clearance=0.0,
        )  # fmt: skip
        law = fc.UnilateralPenalty(300.0)
        assert fc.solve_harmonic_balance(structure, 1.1, law, harmonics=10).converged
