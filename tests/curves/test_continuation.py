"""Response curves by arc-length continuation."""

from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import (
    Cubic,
    amplitudes,
    catch_error,
    oscillator,
    random_stiffness,
    to_complex,
    two_masses,
)

import fenics_crack as fc
from fenics_crack import continue_frequency

pytestmark = pytest.mark.usefixtures("predicted_errors")


def folds(curve: fc.ResponseCurve) -> list[float]:
    """Frequencies of the folds, in order."""
    return [b.omega for b in curve.bifurcations if b.kind == "fold"]


@pytest.mark.drawn(4)
@pytest.mark.parametrize(
    ("stiffness", "harmonics"),
    [
        (1.0, 5), (10.0, 10), (100.0, 10), (1000.0, 5),
        *(pytest.param(k, 20, marks=pytest.mark.nightly) for k in (1.0, 10.0, 100.0, 1000.0)),
    ],
)  # fmt: skip
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
    curve_solutions = [curve.solution(int(i)) for i in np.linspace(0, len(curve.omega) - 1, 20)]
    assert max(solution.report.residual for solution in curve_solutions) < 1e-7


@pytest.mark.drawn(2)
@pytest.mark.parametrize("span", [(2.0, 0.3), (0.3, 2.0)])
@pytest.mark.parametrize("longest", [0.05, 0.1, 0.2, 0.275, 0.4])
def test_long_steps_reach_the_end(span: tuple[float, float], longest: float) -> None:
    """Stiff contact, up and down: the end, by whatever steps. Downwards the first solution lies on
    the curve that leads there; upwards most lie on a loop of the truncated equations."""
    n_other_starts = 0
    for stiffness, harmonics in ((100.0, 10), (100.0, 20), (1000.0, 10), (1000.0, 20)):
        curve = continue_frequency(
            oscillator(0.02, 0.1), *span, fc.UnilateralPenalty(stiffness),
            harmonics=harmonics, longest_step=longest,
        )  # fmt: skip
        assert curve.complete and curve.status.startswith("reached the end")
        assert curve.values[0] == pytest.approx(span[0])
        assert curve.values[-1] == pytest.approx(span[1])
        n_other_starts += "that a search from the end found" in curve.status
    assert n_other_starts == (0 if span[0] > span[1] else 3)


def test_a_curve_past_a_loop() -> None:
    """Upwards, where the first solution lies on a closed loop: the curve's points are those of the
    way down, and a loop that a given solution lies on is followed as such."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(100.0)
    upward_curve = continue_frequency(structure, 0.3, 2.0, law, harmonics=20, longest_step=0.2)
    downward_curve = continue_frequency(structure, 2.0, 0.3, law, harmonics=20, longest_step=0.2)
    assert "that a search from the end found" in upward_curve.status
    assert (
        np.abs(upward_curve.gap_coefficients[0] - downward_curve.gap_coefficients[-1]).max()
        < 1e-6 * np.abs(upward_curve.gap_coefficients[0]).max()
    )
    assert np.allclose(sorted(folds(upward_curve)), sorted(folds(downward_curve)), rtol=1e-6)
    start_solution = fc.solve_harmonic_balance(structure, 0.3, law, harmonics=20)
    assert (
        np.abs(start_solution.gap_coefficients - upward_curve.gap_coefficients[0]).max()
        > 1e-3 * np.abs(upward_curve.gap_coefficients[0]).max()
    )
    loop = continue_frequency(
        structure, 0.3, 2.0, law, harmonics=20, longest_step=0.2, initial=start_solution
    )
    assert loop.complete and loop.status == "closed loop"


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
    exact = grid[np.flatnonzero(np.diff(np.sign([discriminant(omega) for omega in grid])))]
    assert len(exact) == 2
    assert np.allclose(sorted(folds(curve)), exact, atol=1e-3)


def test_frequency_derivative() -> None:
    """d(R lambda - g_lin)/dw against central differences, with all kinds of damping."""
    rng = np.random.default_rng(3)
    n = 5
    stiffness, gap = random_stiffness(rng, n), rng.normal(size=(n, 2))
    random = rng.normal(size=(n, n))
    for damping in (fc.ModalDamping(0.05), 0.1 * np.eye(n), 0.1 * random @ random.T, None):
        structure = fc.Structure.from_matrices(
            np.eye(n), stiffness, gap=gap, force_sin=rng.normal(size=n), damping=damping
        )
        problem = fc.Problem(structure, 0.7, fc.UnilateralPenalty(1.0), 3)
        force = rng.normal(size=(7, 2))

        def moved(omega: float, problem: fc.Problem = problem, force: np.ndarray = force) -> Any:
            compliance = replace(problem, omega=omega).compliance_model()
            waves = np.einsum("kpq,kq->kp", compliance.matrices, to_complex(force))
            return waves - to_complex(compliance.linear_gap)

        step = 1e-6
        slope = (moved(0.7 + step) - moved(0.7 - step)) / (2.0 * step)
        exact = to_complex(problem.compliance_model().residual_derivative("omega", force))
        assert np.allclose(slope, exact, rtol=1e-6, atol=1e-7 * np.abs(exact).max())


def test_bad_arguments_and_unfinished_curves() -> None:
    """One error names the argument; a curve that is not finished says so."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    for key, value, arguments in (
        ("omega_start", 0.0, (0.0, 1.0)),
        ("omega_end", np.nan, (1.0, np.nan)),
        ("omega_end", 1.0, (1.0, 1.0)),
    ):
        catch_error(partial(continue_frequency, structure, *arguments, law), key, value)
    error = catch_error(
        lambda: continue_frequency(structure, 2.0, 0.3, law, most_points=10),
        names="the end was not reached within 10 points",
        kind=fc.ConvergenceError,
    )
    partial_curve = error.found
    assert (
        isinstance(partial_curve, fc.ResponseCurve)
        and not partial_curve.complete
        and len(partial_curve) == 11
    )
    curve = continue_frequency(structure, 2.0, 0.3, law, most_points=10, throw=False)
    assert not curve.complete and len(curve.omega) == 11
    catch_error(
        lambda: curve.stable,
        names=r"stability.* fc\.judge_curve\(curve\) returns",
        kind=AttributeError,
    )
    assert len(fc.judge_curve(curve).stable) == len(curve)


# --- other parameters -----------------------------------------------------------------------------

RANGES = {
    "omega": (1.3, 0.9),
    "load": (1.0, 3.0),
    "stiffness": (1.0, 50.0),
    "damping": (1.0, 0.1),
    "clearance": (-0.3, 0.5),
}


@pytest.mark.parametrize("name", ["load", "stiffness", "damping", "clearance"])
def test_curve_over_another_parameter(name: str) -> None:
    """Every point solves the structure or the law varied accordingly, and its amplitude is that."""
    structure, (start, end) = oscillator(0.1, 1.0), RANGES[name]
    law = fc.UnilateralPenalty(1.0)
    curve = fc.continue_parameter(structure, 1.2, law, name, start, end, harmonics=8)
    assert curve.complete and np.all(curve.omega == 1.2)
    assert (curve.values[0], curve.values[-1]) == pytest.approx((start, end))
    amplitude = curve.amplitude(0)
    for index in (0, len(curve) // 2, len(curve) - 1):
        factors = {"load": 1.0, "damping": 1.0, "clearance": 0.0}
        factor = float(curve.values[index]) if name == "stiffness" else 1.0
        if name != "stiffness":
            factors[name] = float(curve.values[index])
        by_hand = oscillator(0.1 * factors["damping"], factors["load"], factors["clearance"])
        solution = fc.solve_harmonic_balance(
            by_hand, 1.2, law.scaled(factor), harmonics=8, initial=curve.solution(index)
        )
        difference = solution.gap_coefficients - curve.gap_coefficients[index]
        assert np.abs(difference).max() < 1e-8 * np.abs(curve.gap_coefficients[index]).max()
        wave = solution.displacement(np.linspace(0.0, solution.period, 257), [0])
        assert np.ptp(wave) / 2.0 == pytest.approx(amplitude[index], rel=1e-3)


@pytest.mark.parametrize("name", ["load", "stiffness", "damping", "clearance"])
def test_one_eigensolution_for_a_curve(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many points it has, with their multipliers and solutions."""
    calls = []
    solve = scipy.linalg.eigh

    def counted(*arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls.append(1)
        return solve(*arguments)

    monkeypatch.setattr(scipy.linalg, "eigh", counted)
    structure, law, (start, end) = two_masses(), fc.UnilateralPenalty(2.0), RANGES[name]
    curve = fc.continue_parameter(structure, 0.9, law, name, start, end, stability=True)
    assert len([curve.solution(index) for index in range(len(curve))]) > 5 and sum(calls) == 1


def test_load_only_scales_without_clearance() -> None:
    """The penalty law without clearance is homogeneous: so is the response."""
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(4.0)
    curve = fc.continue_parameter(structure, 1.2, law, "load", 1.0, 5.0, harmonics=6)
    unit_load_rows = curve.gap_coefficients / curve.values[:, None, None]
    assert np.allclose(
        unit_load_rows, unit_load_rows[0], atol=1e-8 * np.abs(unit_load_rows[0]).max()
    )


# --- branches, loops, resuming --------------------------------------------------------------------


def test_closed_loop() -> None:
    """Orbits of three periods form a closed curve of their own, which is followed once."""
    law = fc.UnilateralPenalty(10.0)
    omega = 6.0 * np.sqrt(11.0) / (1.0 + np.sqrt(11.0))
    structure = oscillator(0.1, 1.0)
    rest = np.array([1.0]), np.array([2.0])
    history = fc.integrate_events(
        structure, omega, law, periods=300, steps_per_period=64, initial=rest, record_periods=3
    )
    spectrum = np.fft.rfft(history.gap, axis=0)[:25] * (2.0 / len(history.gap))
    spectrum[0] *= 0.5
    rows = np.empty((49, *spectrum.shape[1:]))
    rows[0], rows[1::2], rows[2::2] = spectrum[0].real, spectrum[1:].real, -spectrum[1:].imag
    guess = replace(
        fc.solve_linear(structure, omega, harmonics=24), gap_coefficients=rows, subharmonic=3
    )
    orbit = fc.solve_harmonic_balance(
        structure, omega, law, harmonics=24, subharmonic=3, initial=guess
    )
    curve = continue_frequency(
        structure, omega, 2.5 * omega, law, harmonics=24, subharmonic=3, initial=orbit,
        max_turn_back_fraction=0.5,
    )  # fmt: skip
    assert curve.complete and curve.status == "closed loop"
    assert (
        np.array_equal(curve.gap_coefficients[0], curve.gap_coefficients[-1])
        and len(folds(curve)) == 2
    )
    assert curve.omega.min() < 0.95 * omega and curve.omega.max() > 1.3 * omega
    assert amplitudes(curve.coefficients_at(0)[0])[0] > 0.01  # a third of the load's frequency


def test_points_come_one_by_one(tmp_path: Path) -> None:
    """Stopped, written and read: the same points as those of the whole curve."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    complete_curve = continue_frequency(structure, 2.0, 0.3, law, harmonics=6, stability=True)
    problem = fc.Problem(structure, 2.0, law, harmonics=6)
    continuation = fc.Continuation(problem, "omega", 2.0, 0.3, stability=True, longest_step=0.05)
    runs_back = (
        complete_curve.omega[:-1] < complete_curve.omega[1:]
    )  # on the way back between the folds
    stop = int(np.argmax(runs_back)) + 2
    points = list(islice(continuation, stop))
    part = continuation.curve
    assert len(points) == len(part) == stop and not part.complete
    assert [point.omega for point in points] == list(part.omega)
    assert np.array_equal(part.omega, complete_curve.omega[:stop])
    assert 0.0 < continuation.progress_fraction() < 1.0
    assert (
        continuation.describe_parameter_and_point_count()
        == f"{points[-1].omega / (2.0 * np.pi):.6g} Hz, {len(points)} points"
    )
    fc.save(part, tmp_path / "part.h5")
    loaded_curve = fc.load(tmp_path / "part.h5", structure, law)
    assert np.array_equal(loaded_curve.omega, part.omega) and np.array_equal(
        loaded_curve.stable, part.stable
    )


@pytest.mark.parametrize(
    ("key", "arguments"),
    [
        ("parameter", {"parameter": "crack"}),
        ("start", {"start": -1.0}),
        ("end", {"end": 0.0}),
        ("end", {"end": 1.0}),
        ("omega", {"omega": None}),
        ("tolerance", {"tolerance": 0.0}),
        ("max_turn_back_fraction", {"max_turn_back_fraction": -1.0}),
        ("longest_step", {"longest_step": 2.0}),
        ("samples", {"tolerance": 1e-3, "samples": 64}),
        ("samples", {"harmonics": 5, "samples": 20}),
        ("initial", {"initial": 3}),
        ("resume", {"resume": 3}),
        ("harmonics", {"harmonics": 0}),
        ("subharmonic", {"subharmonic": 1.5}),
        ("harmonic", {"harmonic": 5}),
    ],
)
def test_bad_arguments_of_a_continuation(key: str, arguments: dict[str, object]) -> None:
    """One error names the argument."""
    valid_arguments = {"parameter": "stiffness", "start": 1.0, "end": 10.0, "omega": 1.2}
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(1.0)
    catch_error(
        lambda: fc.continue_parameter(structure, contact=law, **(valid_arguments | arguments)), key
    )


def test_damping_that_is_not_there_cannot_vary() -> None:
    """A factor of the damping is refused where there is no damping."""
    law = fc.UnilateralPenalty(1.0)
    catch_error(
        lambda: fc.continue_parameter(oscillator(None), 1.2, law, "damping", 1.0, 2.0),
        "parameter",
        "damping",
    )


@pytest.mark.parametrize("seed", [6, 7])
def test_branch_where_rounding_leaves_much(seed: int) -> None:
    """k R of 1e8, masses that float on their stops: the first step leads to the branch."""
    rng = np.random.default_rng(seed)
    free_stiffness = 6.0 * (np.diag([1.0, 2.0, 2.0, 1.0]) - np.eye(4, k=1) - np.eye(4, k=-1))
    structure = fc.Structure.from_matrices(
        np.eye(4),
        free_stiffness + 1e-8 * np.eye(4),
        gap=np.eye(4) + 0.3 * rng.random((4, 4)),
        force_cos=2.5 * (1.0 + 0.1 * rng.random(4)),
        force_mean=1.0 + 0.2 * rng.random(4),
        damping=0.1 * np.eye(4),
    )
    curve = continue_frequency(structure, 3.2, 2.5, fc.UnilateralPenalty(1.0), tolerance=1e-2)
    doubling_point = next(b for b in curve.bifurcations if b.kind == "period_doubling")
    branch = fc.follow_branch(curve, doubling_point, throw=False, most_points=5)
    assert len(branch) == 6
    assert np.all(np.linalg.norm(branch.gap_coefficients[:, 1:3], axis=(1, 2)) > 0.0)


def test_branch_only_from_where_one_begins() -> None:
    """Not without room on both sides."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    curve = continue_frequency(structure, 2.0, 0.3, law, harmonics=6)
    renamed_bifurcation = replace(curve.bifurcations[0], kind="period_doubling")
    follow = partial(fc.follow_branch, curve, renamed_bifurcation)
    catch_error(lambda: follow(1.9, 2.0), "start, end", (1.9, 2.0))
    catch_error(lambda: follow(harmonics=7), "harmonics", 7)
    catch_error(lambda: follow(step=0.1), "step", 0.1)


@pytest.mark.parametrize("stiffness", [1.0, 1000.0])
@pytest.mark.parametrize("omega", [0.7, 2.0])
def test_first_point_is_the_single_solution(stiffness: float, omega: float) -> None:
    """What PETSc's SNES finds from the linear solution, along a path where full steps fail."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(stiffness)
    curve = fc.Continuation(fc.Problem(structure, omega, law, 10), "omega", omega, 0.3).curve
    solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=10)
    size = np.abs(solution.gap_coefficients).max()
    assert np.allclose(curve.points[0], solution.gap_coefficients, rtol=0.0, atol=1e-8 * size)
    assert curve.iterations[0] == solution.iterations


@pytest.mark.parametrize("stiffness", [1e7, 1e9, 1e10])
def test_curve_with_contact_stiffer_than_rounding_resolves(stiffness: float) -> None:
    """Followed to what rounding allows, as single solutions are."""
    law = fc.UnilateralPenalty(stiffness)
    curve = continue_frequency(oscillator(0.1, 1.0), 0.8, 1.0, law, harmonics=3)
    assert curve.complete and len(curve) < 600


def test_load_does_not_pass_zero_without_clearance() -> None:
    """At zero load the motion vanishes; with a clearance the curve passes."""
    law = fc.UnilateralPenalty(1.0)
    catch_error(
        lambda: fc.continue_parameter(oscillator(0.1, 1.0), 1.2, law, "load", 1.0, -1.0),
        "start, end",
        (1.0, -1.0),
    )
    curve = fc.continue_parameter(oscillator(clearance=0.1), 1.2, law, "load", 1.0, -1.0)
    assert curve.complete and len(curve) < 500


def test_branch_points_are_where_a_multiplier_is_one() -> None:
    """A mass between two stops loses its symmetry where a multiplier of the exact motion is 1. The
    branch point was the first point of the curve behind it, where it is up to 1.004."""
    structure = fc.Structure.from_matrices(
        [[1.0]], [[1.0]], gap=[[1.0, -1.0]], force_sin=[1.0], clearance=0.5, damping=[[0.04]]
    )
    curve = fc.continue_frequency(structure, 0.6, 1.0, fc.UnilateralPenalty(3.0), harmonics=40)
    points = [
        bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == "branch_point"
    ]
    assert len(points) == 2
    for point in points:
        leading_multiplier = fc.shoot(structure, point.solution).multipliers[0]
        assert abs(leading_multiplier - 1.0) < 1e-4
