"""Response curves by arc-length continuation."""

from pathlib import Path

import numpy as np
import pytest
from helpers import amplitudes, log_slope, oscillator, random_stiffness, two_masses

import fenics_crack as fc
from fenics_crack.compliance import ModalCompliance, load_coefficients
from fenics_crack.condensed import respond
from fenics_crack.continuation import continue_frequency


def folds(curve: fc.ResponseCurve) -> list[float]:
    """Frequencies of the folds, in order."""
    return [b.omega for b in curve.bifurcations if b.kind == "fold"]


@pytest.mark.parametrize("harmonics", [5, 10, 20])
@pytest.mark.parametrize("stiffness", [1.0, 10.0, 100.0, 1000.0])
def test_bilinear_oscillator_runs_through(stiffness: float, harmonics: int) -> None:
    """From 2.0 down to 0.3 without intervention; at kc = 1 with the two true folds only."""
    curve = continue_frequency(
        oscillator(0.02, 0.1), 2.0, 0.3, fc.UnilateralPenalty(stiffness), harmonics=harmonics
    )
    assert curve.complete and curve.omega[-1] == pytest.approx(0.3)
    assert len(folds(curve)) % 2 == 0
    if stiffness == 1.0:
        assert len(folds(curve)) == 2
    amplitude = curve.amplitude(0)
    peak = curve.omega[np.argmax(amplitude)]
    bilinear = 2.0 * np.sqrt(1.0 + stiffness) / (1.0 + np.sqrt(1.0 + stiffness))
    assert peak == pytest.approx(bilinear, rel=0.03)  # one mode: 2 w1 w2 / (w1 + w2)
    if stiffness == 100.0 and harmonics >= 10:
        assert amplitude.max() == pytest.approx(2.465, rel=3e-3)  # measured elsewhere
        assert peak == pytest.approx(1.819, abs=2e-3)
    sharp = [curve.solution(int(i)) for i in np.linspace(0, len(curve.omega) - 1, 20)]
    assert max(solution.report.residual for solution in sharp) < 1e-7


def test_points_are_solutions() -> None:
    """Each point, solved again by SNES from itself, does not move."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(10.0)
    curve = continue_frequency(structure, 2.0, 0.3, law, harmonics=8)
    for index in range(0, len(curve.omega), 25):
        solution = curve.solution(index)
        again = fc.solve_harmonic_balance(
            structure, float(curve.omega[index]), law, harmonics=8, initial=solution
        )
        difference = np.abs(again.gap_coefficients - solution.gap_coefficients).max()
        assert difference < 1e-6 * np.abs(solution.gap_coefficients).max()


def test_folds_are_where_the_curve_turns() -> None:
    """The Jacobian is singular at a fold, and folds lie beyond their neighbours in frequency."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    curve = continue_frequency(structure, 2.0, 0.3, law, harmonics=10)
    turning = np.flatnonzero(np.diff(np.sign(np.diff(curve.omega))) != 0) + 1
    assert len(turning) == len(folds(curve)) == 2
    for index, fold in zip(turning, folds(curve), strict=True):
        assert abs(fold - curve.omega[index]) < 0.01
        extreme = min if curve.omega[index] < curve.omega[index - 1] else max
        assert extreme(fold, curve.omega[index]) == fold


def test_fold_of_a_duffing_oscillator() -> None:
    """One harmonic: a1 = amplitude obeys a cubic whose folds are roots of its discriminant."""
    damping, force, cubic = 0.1, 0.2, 1.0
    structure = oscillator(damping, force)
    curve = continue_frequency(structure, 0.5, 2.5, Cubic(cubic), harmonics=1, longest_step=0.02)

    def discriminant(omega: float) -> float:
        # ((1 - w^2 + 3/4 c y)^2 + (d w)^2) y = f^2 in y = a^2
        q = 0.75 * cubic
        p = 1.0 - omega**2
        roots = np.roots([q**2, 2 * p * q, p**2 + (damping * omega) ** 2, -(force**2)])
        pairs = (roots[0] - roots[1]) * (roots[0] - roots[2]) * (roots[1] - roots[2])
        return float((pairs**2).real)

    grid = np.linspace(0.6, 2.4, 4001)
    signs = np.sign([discriminant(omega) for omega in grid])
    exact = grid[np.flatnonzero(np.diff(signs))]
    assert len(exact) == 2
    assert np.allclose(sorted(folds(curve)), exact, atol=1e-3)


class Cubic:
    """lambda = c g^3: a smooth law, whose coefficients samples give exactly."""

    def __init__(self, stiffness: float) -> None:
        self.stiffness = stiffness

    def force(self, gap: np.ndarray) -> np.ndarray:
        """c g^3."""
        return self.stiffness * gap**3

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """3 c g^2."""
        return 3.0 * self.stiffness * gap**2

    def scaled(self, factor: float) -> "Cubic":
        """The same with another c."""
        return Cubic(factor * self.stiffness)


def test_both_stable_orbits_of_two_masses_and_a_stop() -> None:
    """VERIFICATION C: three crossings of W = 0.70, the outer two as published."""
    structure, law = two_masses(), fc.UnilateralPenalty(100.0)
    curve = continue_frequency(structure, 0.6, 0.9, law, harmonics=21)
    crossing = np.flatnonzero((curve.omega[:-1] - 0.7) * (curve.omega[1:] - 0.7) < 0.0)
    found = []
    for index in crossing:
        near = curve.solution(int(index))
        solution = fc.solve_harmonic_balance(structure, 0.7, law, harmonics=21, initial=near)
        found.append(amplitudes(solution.coefficients_at([1])[:, 0])[0])
    assert len(found) == 3
    assert max(found) == pytest.approx(0.77839461, abs=1e-3)
    assert min(found) == pytest.approx(0.22134025, abs=1e-6)


def test_period_doubling_of_two_masses_and_a_stop() -> None:
    """VERIFICATION C: at W = 0.7387830; the located points approach it like H^-2 or faster."""
    structure, law = two_masses(), fc.UnilateralPenalty(100.0)
    errors, counts = [], (61, 81, 121)
    for harmonics in counts:
        curve = continue_frequency(
            structure, 0.72, 0.75, law, harmonics=harmonics, stability=True,
            initial=_contact_branch(structure, law, harmonics), throw=False, most_points=60,
        )  # fmt: skip
        doubling = [b.omega for b in curve.bifurcations if b.kind == "period_doubling"]
        errors.append(abs(doubling[0] - 0.7387830))
    assert errors[-1] < 4e-4
    assert log_slope(counts, errors) < -1.8


def _contact_branch(
    structure: fc.Structure, law: fc.UnilateralPenalty, harmonics: int
) -> fc.PeriodicSolution:
    """The branch with contact at W = 0.72: reached from below, where it is the only one."""
    curve = continue_frequency(structure, 0.6, 0.72, law, harmonics=harmonics)
    return curve.solution(len(curve.omega) - 1)


def test_saved_curve_comes_back(tmp_path: Path) -> None:
    """Written and read again: the same numbers, nothing solved; a wrong file gets one error."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    curve = continue_frequency(structure, 2.0, 0.3, law, harmonics=6, stability=True)
    curve.save(tmp_path / "curve.npz")
    again = fc.ResponseCurve.load(tmp_path / "curve.npz", structure, law)
    assert np.array_equal(again.omega, curve.omega)
    assert np.array_equal(again.amplitude(0), curve.amplitude(0))
    assert np.array_equal(again.stable, curve.stable)
    assert [(b.kind, b.omega) for b in again.bifurcations] == [
        (b.kind, b.omega) for b in curve.bifurcations
    ]
    assert (again.complete, again.status) == (curve.complete, curve.status)
    (tmp_path / "other.npz").write_text("no curve")
    with pytest.raises(fc.InputError, match="path"):
        fc.ResponseCurve.load(tmp_path / "other.npz", structure, law)
    with pytest.raises(fc.InputError, match="path"):
        fc.ResponseCurve.load(tmp_path / "missing.npz", structure, law)
    wide = fc.Structure.from_matrices(np.eye(2), np.eye(2), np.eye(2))
    with pytest.raises(fc.InputError, match="pairs"):
        fc.ResponseCurve.load(tmp_path / "curve.npz", wide, law)


def test_frequency_derivative() -> None:
    """d(R lambda - g_lin)/dw against central differences, with all kinds of damping."""
    rng = np.random.default_rng(3)
    n = 5
    stiffness, gap = random_stiffness(rng, n), rng.normal(size=(n, 2))
    random = rng.normal(size=(n, n))
    for damping in (fc.ModalDamping(0.05), 0.1 * np.eye(n), 0.1 * random @ random.T, None):
        structure = fc.Structure.from_matrices(
            np.eye(n), stiffness, gap, force_sin=rng.normal(size=n), damping=damping
        )
        load = load_coefficients(structure, 3, 1)
        force = rng.normal(size=(7, 2))

        def moved(omega: float, structure=structure, load=load, force=force) -> np.ndarray:  # type: ignore[no-untyped-def]
            compliance = ModalCompliance(structure, omega, load)
            return respond(compliance.matrices, force) - compliance.linear_gap

        step = 1e-6
        slope = (moved(0.7 + step) - moved(0.7 - step)) / (2.0 * step)
        exact = ModalCompliance(structure, 0.7, load).frequency_derivative(force)
        assert np.allclose(slope, exact, rtol=1e-6, atol=1e-7 * np.abs(exact).max())


@pytest.mark.slow
def test_paper_plate_over_three_resonances(soft_plate: fc.Structure) -> None:
    """k = 1e9 and 1e11, xi = 0.01, past the third natural frequency; reduced equals whole."""
    corner = soft_plate.find_dof((0.1, 0.1), "x")
    for stiffness in (1e9, 1e11):
        law = fc.UnilateralPenalty(stiffness)
        whole = continue_frequency(soft_plate, 1000.0, 9500.0, law, harmonics=5)
        assert whole.complete
        assert whole.omega.max() > 8579.0
        reduced = continue_frequency(
            fc.reduce_structure(soft_plate, modes=20), 1000.0, 9500.0, law, harmonics=5
        )
        peaks = [curve.amplitude(corner).max() for curve in (whole, reduced)]
        assert peaks[1] == pytest.approx(peaks[0], rel=0.02)


def test_bad_arguments_and_unfinished_curves() -> None:
    """One error names the argument; a curve that is not finished says so."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    for key, arguments in (
        ("omega_start", (0.0, 1.0)),
        ("omega_end", (1.0, float("nan"))),
        ("omega_end", (1.0, 1.0)),
    ):
        with pytest.raises(fc.InputError) as caught:
            continue_frequency(structure, *arguments, law)
        assert caught.value.key == key
    with pytest.raises(fc.InputError, match="contact"):
        continue_frequency(structure, 1.0, 2.0, fc.UnilateralConstraint())  # type: ignore[arg-type]
    with pytest.raises(fc.ConvergenceError, match="10 points were not enough"):
        continue_frequency(structure, 2.0, 0.3, law, most_points=10)
    curve = continue_frequency(structure, 2.0, 0.3, law, most_points=10, throw=False)
    assert not curve.complete and len(curve.omega) == 11
    with pytest.raises(fc.InputError, match="stability"):
        _ = curve.stable
