"""What is found again in arrival times, and what is said where it cannot be."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.stats
from helpers import amplitudes, catch_error, passing_angles, period_two_orbit

import fenics_crack as fc

NIGHTLY = pytest.mark.nightly
RADIUS = 0.5
FOUR = (0.1, 0.5, 1.3, 3.1)
SEVEN = np.radians([0.0, 20.0, 41.0, 63.0, 88.0, 117.0, 150.0])
TWELVE = np.radians([0.0, 17, 41, 58, 86, 113, 140, 178, 205, 251, 288, 330])
EIGHT = tuple(np.radians([17, 35, 55, 70, 86, 108, 123, 284]))


def blade() -> fc.Structure:
    """One mass of natural frequency 1000 rad/s; a stop of the same stiffness doubles it."""
    unit_matrix = np.ones((1, 1))
    return fc.Structure.from_matrices(
        unit_matrix,
        1e6 * unit_matrix,
        gap=unit_matrix,
        force_sin=[1e2],
        damping=100.0 * unit_matrix,
    )


@pytest.fixture(scope="module")
def sine() -> fc.PeriodicSolution:
    """Solve for 1 mm at 1000 rad/s: the crack is always open."""
    solution = fc.solve_linear(blade(), 1000.0)
    assert solution.amplitude(0) == pytest.approx(1e-3, rel=1e-9)
    return solution


@pytest.fixture(scope="module")
def breathing_solution() -> fc.PeriodicSolution:
    """Solve for the same load with a stop that doubles the stiffness."""
    return fc.solve_harmonic_balance(blade(), 1000.0, fc.UnilateralPenalty(1e6), harmonics=20)


def simulate_arrivals(
    solution: fc.PeriodicSolution, noise: float = 1e-5, **options: Any
) -> fc.ArrivalTimes:
    """Simulate arrivals of a solution, with noise [m] at the tip."""
    speed = options.get("speed") or solution.omega / options["order"]
    defaults: dict[str, Any] = {"probes": FOUR, "tip_radius": RADIUS, "revolutions": 50}
    return fc.tip_timing(solution, 0, noise=noise / (RADIUS * speed), **(defaults | options))


# --- engine orders --------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [5, 13, *(pytest.param(n, marks=NIGHTLY) for n in (4, 6))])
def test_order_and_amplitude_from_four_probes(order: int, sine: fc.PeriodicSolution) -> None:
    """1 % noise: the order among 24, and 1 % of the amplitude, in every one of ten tries."""
    for seed in range(10):
        fit = fc.fit_order(simulate_arrivals(sine, order=order, seed=seed, revolutions=100))
        assert fit.order == order and not fit.ambiguous_orders and not fit.hidden
        assert fit.amplitudes[0] == pytest.approx(1e-3, rel=0.01)
        assert fit.omega == pytest.approx(1000.0)
        assert np.abs(fit.coefficients - sine.coefficients_at([0])[:3, 0]).max() < 1e-5


@pytest.mark.parametrize("tries", [12, pytest.param(60, marks=NIGHTLY)])
def test_standard_errors_and_misfit_are_what_they_say(
    tries: int, sine: fc.PeriodicSolution
) -> None:
    """Deviations in units of the error like a normal distribution's, the misfit's probability
    uniform."""
    fits = [fc.fit_order(simulate_arrivals(sine, order=6, seed=seed), [6]) for seed in range(tries)]
    scores = [float((fit.amplitudes[0] - 1e-3) / fit.amplitude_errors[0]) for fit in fits]
    assert scipy.stats.kstest(scores, "norm").pvalue > 0.01
    assert scipy.stats.kstest([fit.misfit for fit in fits], "uniform").pvalue > 0.01
    assert np.median([fit.scatter for fit in fits]) == pytest.approx(1e-5, rel=0.15 / tries**0.5)


@pytest.mark.parametrize("revolutions", [2, 3])
def test_errors_of_few_revolutions_are_students(
    revolutions: int, sine: fc.PeriodicSolution
) -> None:
    """Squares of errors are those of least squares times n / (n - 2), with the n arrivals to spare
    that tell the scatter: true errors were 1.4 of those stated of four probes in two revolutions.
    One arrival to spare tells no error."""
    arrivals = simulate_arrivals(sine, 1e-7, order=6, revolutions=revolutions)
    values, phases = arrivals.displacement.ravel(), 6.0 * arrivals.angle.ravel()
    fits = fc.fit_order(arrivals, [6]), fc.fit_frequency(arrivals, 950.0, 1050.0)
    for fit, extra_columns in zip(fits, ([], [phases * np.sin(phases)]), strict=True):
        columns = np.column_stack([np.cos(phases), np.sin(phases), phases**0, *extra_columns])
        residuals = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
        n_spare = len(columns) - columns.shape[1]
        covariance = (
            float(residuals @ residuals) / (n_spare - 2) * np.linalg.inv(columns.T @ columns)
        )
        ratios = np.diag(fit.covariance)[1:] / np.diag(covariance)[:2]
        assert ratios == pytest.approx(1.0, rel=0.05)
    assert np.isnan(fc.fit_order(arrivals.between(0, 1), [6]).amplitude_errors[0])


def test_without_noise_nothing_is_lost(breathing_solution: fc.PeriodicSolution) -> None:
    """As many harmonics as there are: the solution's coefficients, though the tip moves meanwhile
    and arrives elsewhere than expected."""
    probes = 0.149 * np.arange(42)
    arrivals = simulate_arrivals(breathing_solution, 0.0, order=6, probes=probes, revolutions=2)
    shift = np.abs(arrivals.angle - arrivals.rotor_angle_without_vibration).max()
    assert shift * 20 * 6 > 0.05  # radians of the highest harmonic
    fit = fc.fit_order(arrivals, [6], harmonics=20)
    wave = breathing_solution.coefficients_at([0])[:, 0]
    assert np.abs(fit.coefficients - wave).max() < 1e-7 * np.abs(wave).max()


def test_a_breathing_crack_has_a_second_harmonic(
    sine: fc.PeriodicSolution, breathing_solution: fc.PeriodicSolution
) -> None:
    """Its ratio to the first is within three standard errors; that of an open crack is 0."""
    true_amplitudes = amplitudes(breathing_solution.coefficients_at([0])[:, 0])
    options: dict[str, Any] = {"order": 6, "probes": EIGHT, "revolutions": 200}
    arrivals = simulate_arrivals(breathing_solution, 0.01 * true_amplitudes[0], **options)
    fit = fc.fit_order(arrivals, range(1, 13), harmonics=3)
    value, error = fit.ratio_and_error()
    assert fit.order == 6 and not fit.ambiguous_orders
    folded_ratio = true_amplitudes[3] / true_amplitudes[0]  # the fourth harmonic, onto those kept
    assert (
        abs(value - true_amplitudes[1] / true_amplitudes[0]) < 3.0 * error + folded_ratio
        and value > 30.0 * error
    )
    assert fit.ratio_and_error(3)[0] == pytest.approx(
        true_amplitudes[2] / true_amplitudes[0], abs=3.0 * error + folded_ratio
    )
    catch_error(lambda: fit.ratio_and_error(4), "multiple", 4)
    value, error = fc.fit_order(
        simulate_arrivals(sine, **options), [6], harmonics=3
    ).ratio_and_error()
    assert value < 4.0 * error < 0.01
    # Without its second harmonic the fit is known not to fit, and its errors hold what is folded.
    one_harmonic_fit = fc.fit_order(arrivals, [6], harmonics=1)
    assert one_harmonic_fit.misfit < 1e-6 and "DOES NOT FIT" in repr(one_harmonic_fit)
    assert (
        abs(one_harmonic_fit.amplitudes[0] - true_amplitudes[0])
        < 3.0 * one_harmonic_fit.amplitude_errors[0]
    )


def test_twice_the_loads_period() -> None:
    """Harmonics 1/2, 1, 3/2, 2 of the load."""
    orbit = period_two_orbit(12)
    wave = orbit.coefficients_at([0])[:, 0]
    arrivals = fc.tip_timing(
        orbit, 0, probes=np.radians([10, 46, 90, 133, 201, 290]), tip_radius=1e3, order=3,
        revolutions=200, noise=1e-6 / orbit.omega,
    )  # fmt: skip
    fit = fc.fit_order(arrivals, range(1, 9), harmonics=4, subharmonic=2)
    assert fit.order == 3 and not fit.ambiguous_orders
    assert np.allclose(fit.multiples, [0.5, 1.0, 1.5, 2.0])
    assert np.abs(fit.coefficients - wave[:9]).max() < 0.02 * np.abs(wave).max()
    assert fit.ratio_and_error(0.5)[0] == pytest.approx(
        amplitudes(wave)[0] / amplitudes(wave)[1], rel=0.02
    )
    # Where that is not known, what repeats in two revolutions follows no order.
    half_order_fit = fc.fit_order(arrivals, [3], harmonics=2).asynchronous[0]
    assert half_order_fit.omega == pytest.approx(0.5 * orbit.omega, rel=1e-4)
    assert half_order_fit.amplitudes[0] == pytest.approx(amplitudes(wave)[0], rel=0.01)


# --- what probes cannot tell ----------------------------------------------------------------------


def test_equally_spaced_probes_alias(sine: fc.PeriodicSolution) -> None:
    """Five of them: orders p with p = 1 or -1 (mod 5) look like 6, and 5, 10, ... like the mean."""
    probes = 0.3 + 2.0 * np.pi * np.arange(5) / 5.0
    fit = fc.fit_order(simulate_arrivals(sine, order=6, probes=probes), range(1, 25))
    assert sorted({fit.order, *fit.ambiguous_orders}) == [
        p for p in range(1, 25) if p % 5 in (1, 4)
    ]
    assert fit.hidden == (5.0, 10.0, 15.0, 20.0)
    assert "as well: " in repr(fit) and "not measured: 5, 10, 15, 20" in repr(fit)
    assert np.all(np.isinf(fit.candidates.conditions[fit.candidates.hidden]))
    # Those that a Campbell diagram leaves may be told apart.
    assert fc.fit_order(simulate_arrivals(sine, order=6, probes=probes), [5, 6, 7, 8]).order == 6
    catch_error(
        lambda: fc.fit_order(simulate_arrivals(sine, order=6, probes=probes), [5, 10]),
        "probes",
        names="3 unknowns",
    )


def test_as_many_unknowns_as_probes_fit_anything(breathing_solution: fc.PeriodicSolution) -> None:
    """Three harmonics and seven probes: no order is told from any other."""
    probes = [0.1, 0.5, 1.3, 2.2, 3.1, 4.7, 5.5]
    arrivals = simulate_arrivals(breathing_solution, order=6, probes=probes)
    fit = fc.fit_order(arrivals, [4, 5, 6, 9, 10], harmonics=3)
    assert len(fit.ambiguous_orders) == 4 and np.isnan(fit.misfit)
    catch_error(
        lambda: fc.fit_order(arrivals, [6], harmonics=4), "probes", names="7 probes.* 9 unk"
    )
    catch_error(
        lambda: fc.fit_order(
            simulate_arrivals(breathing_solution, 0.3, order=40, probes=probes), [40]
        ),
        "probes",
        names="7 probes.* 3 unknowns",
    )


def test_as_many_arrivals_as_unknowns(sine: fc.PeriodicSolution) -> None:
    """One revolution, three probes: nothing is known of the errors, and any order will do."""
    fit = fc.fit_order(simulate_arrivals(sine, order=6, probes=FOUR[:3], revolutions=1), [5, 6, 7])
    assert (
        len(fit.ambiguous_orders) == 2
        and np.isnan(fit.scatter)
        and np.isnan(fit.amplitude_errors[0])
    )
    exact_fit = fc.fit_order(
        simulate_arrivals(sine, 0.0, order=6, probes=FOUR[:3], revolutions=1), [6]
    )
    assert exact_fit.amplitudes[0] == pytest.approx(1e-3, rel=1e-9) and "nan" in repr(exact_fit)


def test_angles_of_probes_that_are_not_known(sine: fc.PeriodicSolution) -> None:
    """Where they are unknown, a wave without noise may repeat after two revolutions, and one
    revolution gives no frequency."""
    arrivals = simulate_arrivals(sine, 0.0, order=5)
    still_arrivals = replace(arrivals, time=arrivals.expected)
    for record, size in ((arrivals, 1e-3), (still_arrivals, 0.0)):
        fit = fc.fit_order(record, [5], harmonics=2, subharmonic=2, angle_deviation=1e-3)
        assert abs(fit.amplitudes[1] - size) <= max(3.0 * fit.amplitude_errors[1], 1e-9)
        track = fc.track_order(record, 5, revolutions=2, angle_deviation=1e-3)
        assert np.allclose(track.amplitudes, size, atol=1e-9)
    catch_error(
        lambda: fc.fit_frequency(
            simulate_arrivals(sine, order=5, probes=(*FOUR, 4.0)).between(3, 4),
            900.0,
            1100.0,
            angle_deviation=1e-4,
        ),
        "arrivals",
        "5 arrivals",
        names=" 8,",
    )


def test_arrivals_that_are_the_marks() -> None:
    """A clock as coarse as a revolution sees all arrivals at one angle: they are refused."""
    marks, probes = 0.005 * np.arange(4), np.radians([0.0, 20.0, 41.0, 63.0, 88.0, 117.0, 150.0])
    arrivals = fc.ArrivalTimes(np.tile(marks[:-1, None], 7), marks, probes, 0.5)
    catch_error(
        lambda: fc.fit_order(arrivals, harmonics=2),
        "probes",
        "arrivals of the probe at 0 degrees fit the angle of the probe at 63 degrees",
    )


def test_missing_arrivals(sine: fc.PeriodicSolution) -> None:
    """Fits without a third of the arrivals give the same."""
    arrivals = simulate_arrivals(sine, order=6, revolutions=200)
    gap_factors = np.where(np.random.default_rng(1).random(arrivals.time.shape) < 0.3, np.nan, 1.0)
    arrivals_with_gaps = replace(arrivals, time=arrivals.time * gap_factors)
    for record in (arrivals_with_gaps, arrivals.between(50, 120)):
        fit = fc.fit_order(record)
        assert fit.order == 6 and fit.amplitudes[0] == pytest.approx(1e-3, rel=0.01)
    track = fc.track_order(arrivals_with_gaps, 6, revolutions=2)
    assert np.nanmax(np.abs(track.amplitudes - 1e-3)) < 1e-4
    first_fit = fc.fit_order(arrivals.between(0, 2), [6])
    assert track.coefficients.shape == (100, 3)
    complete_track = fc.track_order(arrivals, 6, revolutions=2)
    assert np.allclose(complete_track.coefficients[0], first_fit.coefficients, atol=1e-7)
    point_error = fc.fit_order(arrivals, [6]).amplitude_errors[0] * np.sqrt(
        len(complete_track.speed)
    )
    assert complete_track.amplitude_errors[0, 0] == pytest.approx(point_error, rel=0.2)


# --- asynchronous ---------------------------------------------------------------------------------


@pytest.mark.parametrize("deviations", [(30.0, 30.0), (30.0, 600.0)])
def test_amplitudes_of_which_one_part_is_hardly_told(
    deviations: tuple[float, float], sine: fc.PeriodicSolution
) -> None:
    """95 and 99.7 % of amplitudes lie within two and three of their errors, also where the errors
    along the phase are as large as the amplitude."""
    rng = np.random.default_rng(5)
    rotation = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    part_covariance = rotation @ np.diag(np.square(deviations)) @ rotation.T
    parts = [1000.0, 0.0] + rng.multivariate_normal([0.0, 0.0], part_covariance, 2000)
    coefficients = np.column_stack([np.zeros(2000), parts])
    covariance = np.zeros((3, 3))
    covariance[1:, 1:] = part_covariance
    fit = fc.fit_order(simulate_arrivals(sine, order=6))
    fits = [replace(fit, coefficients=row, covariance=covariance) for row in coefficients]
    sizes = np.array([fit.amplitudes[0] for fit in fits])
    errors = np.array([fit.amplitude_errors[0] for fit in fits])
    scores = np.abs(sizes - 1000.0) / errors
    assert np.mean(scores < 1.96) > 0.94 and np.mean(scores < 3.0) > 0.99
    assert np.median(errors) < 1.2 * np.hypot(*deviations)


@pytest.mark.parametrize("speed", [193.7, 61.3, 1300.0])
def test_frequency_of_an_asynchronous_vibration(speed: float, sine: fc.PeriodicSolution) -> None:
    """Undersampled or not, from three probes: to 1e-5 and within four standard errors."""
    arrivals = simulate_arrivals(sine, speed=speed, probes=FOUR[:3], revolutions=200)
    fit = fc.fit_frequency(arrivals, 100.0, 3000.0)
    assert not fit.ambiguous_orders
    assert fit.omega == pytest.approx(1000.0, rel=1e-5)
    assert abs(fit.omega - 1000.0) < 4.0 * fit.order_error * speed
    assert fit.amplitudes[0] == pytest.approx(1e-3, rel=0.01)


@NIGHTLY
def test_more_frequencies_than_are_scanned_at_once(sine: fc.PeriodicSolution) -> None:
    """A scan of more than a million frequencies finds the same as one of few of them."""
    arrivals = simulate_arrivals(sine, speed=61.3, probes=FOUR[:3], revolutions=8000)
    upper_end = 1000.0 + 1.2e6 * 2.0 * np.pi / (4.0 * np.ptp(arrivals.marks))
    short_scan, long_scan = (fc.fit_frequency(arrivals, 999.0, end) for end in (1001.0, upper_end))
    for fit in (short_scan, long_scan):
        assert fit.omega == pytest.approx(1000.0, rel=1e-8)
        assert abs(fit.omega - 1000.0) < 4.0 * fit.order_error * 61.3
    assert long_scan.order == pytest.approx(short_scan.order, rel=1e-10)


def test_errors_of_the_frequency(sine: fc.PeriodicSolution) -> None:
    """Errors of 30 tries in units of the standard error are normal."""
    scores = []
    for seed in range(30):
        arrivals = simulate_arrivals(sine, speed=193.7, probes=FOUR[:2], seed=seed)
        fit = fc.fit_frequency(arrivals, 900.0, 1100.0)
        scores.append((fit.order - 1000.0 / 193.7) / fit.order_error)
    assert scipy.stats.kstest(scores, "norm").pvalue > 0.01


@pytest.mark.parametrize(
    ("probes", "aliases"),
    [
        ([0.4], {p + sign * 0.1626 for p in range(1, 11) for sign in (-1, 1)}),
        ([0.4, 0.4 + np.pi], {p + sign * 0.1626 for p in (1, 3, 5, 7, 9) for sign in (-1, 1)}),
        ([0.4, 1.1], {5.1626}),
    ],
)
def test_aliases_of_a_frequency(
    probes: list[float], aliases: set[float], sine: fc.PeriodicSolution
) -> None:
    """One probe: every order and its mirror image; two opposite ones: every other; else none."""
    arrivals = simulate_arrivals(sine, speed=1000.0 / 5.1626, probes=probes, revolutions=100)
    fit = fc.fit_frequency(arrivals, 0.7 * arrivals.mean_speed, 10.3 * arrivals.mean_speed)
    orders = np.array(sorted({fit.order, *fit.ambiguous_orders}))
    assert len(orders) == len(aliases) and np.allclose(orders, sorted(aliases), atol=2e-3)


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_one_probe_sees_no_whole_order(noise: float, sine: fc.PeriodicSolution) -> None:
    """Arrivals at one probe do not vary with an order, and are refused, in ten tries; between
    orders a vibration of twice the noise is found; two probes see the order."""
    for seed in range(10):
        arrivals = simulate_arrivals(sine, noise, order=6, probes=[0.4], revolutions=100, seed=seed)
        catch_error(
            partial(fc.fit_frequency, arrivals, 900.0, 1090.0),
            "probes",
            "one at 22.9183 degrees, whose arrivals do not vary",
        )
        asynchronous_arrivals = simulate_arrivals(
            sine, 5e-4, speed=193.7, probes=[0.4], revolutions=100, seed=seed
        )
        assert fc.fit_frequency(asynchronous_arrivals, 975.0, 1060.0).omega == pytest.approx(
            1000.0, rel=1e-3
        )
    two_probes = simulate_arrivals(sine, noise, order=6, probes=[0.4, 1.1], revolutions=100)
    assert fc.fit_frequency(two_probes, 900.0, 1090.0).order == pytest.approx(6.0, abs=0.02)


# --- a laboratory's errors ------------------------------------------------------------------------


@NIGHTLY
def test_scan_finds_harmonics_too(breathing_solution: fc.PeriodicSolution) -> None:
    """Frequency and ratio of a breathing crack from two probes, which see every phase."""
    true_amplitudes = amplitudes(breathing_solution.coefficients_at([0])[:, 0])
    arrivals = simulate_arrivals(
        breathing_solution, 0.01 * true_amplitudes[0], speed=193.7, probes=FOUR[:2], revolutions=200
    )
    fit = fc.fit_frequency(arrivals, 700.0, 1500.0, harmonics=3)
    assert fit.omega == pytest.approx(1000.0, rel=1e-5)
    assert (
        abs(fit.ratio_and_error()[0] - true_amplitudes[1] / true_amplitudes[0])
        < 4.0 * fit.ratio_and_error()[1]
        < 0.02
    )


@NIGHTLY
def test_outliers_varying_speeds_and_errors_of_probes_and_marks(sine: fc.PeriodicSolution) -> None:
    """A frequency at a speed that varies by 0.5 %, marks with errors of 5 ns, 1 % of arrivals
    wrong; and an order beside it whose interval knows of the probes' errors."""
    rng, speed, turns, deviation = np.random.default_rng(3), 193.7, 200, np.radians(0.01)
    probes = np.radians([0.0, 17.0, 41.0, 86.0, 140.0, 205.0, 288.0])
    fits = []
    for seed in range(4, 12):
        rng = np.random.default_rng(seed)
        grid = np.linspace(-8.0, 2.0 * np.pi * (turns + 2), 40_000)
        varying_speed = speed * (1.0 + 2.5e-3 * np.sin(grid / 31.0 + seed))
        time = np.concatenate(
            [[0.0], np.cumsum(np.diff(grid) / (0.5 * (varying_speed[1:] + varying_speed[:-1])))]
        )
        errors = deviation * rng.standard_normal(len(probes))
        targets = 2.0 * np.pi * np.arange(turns)[:, None] + probes + errors

        def motion(angle: np.ndarray, grid: np.ndarray = grid, time: np.ndarray = time) -> Any:
            line_motion = np.cos(1000.0 * np.interp(angle, grid, time))
            return 1e-3 * np.cos(6.0 * angle) + 2e-4 * line_motion

        angle = passing_angles(targets, motion, RADIUS)
        times = np.interp(angle, grid, time) + 2e-8 * rng.standard_normal(angle.shape)
        times[rng.random(times.shape) < 0.01] += 3e-5
        marks = np.interp(2.0 * np.pi * np.arange(turns + 1), grid, time)
        marks += 5e-9 * rng.standard_normal(len(marks))
        arrivals = fc.ArrivalTimes(times, marks, probes, RADIUS)
        assert arrivals.steady
        fits.append(fc.fit_order(arrivals, angle_deviation=deviation))
        assert fits[-1].order == 6 and not fits[-1].does_not_fit
        [line] = fits[-1].asynchronous  # no others, of the order seen at where that moves the tip
        assert abs(line.omega - 1000.0) < 4.0 * line.order_error * line.speed < 0.05
        assert line.amplitudes[0] == pytest.approx(2e-4, rel=0.02)
        assert f"beside {line.omega:.6g} rad/s" in repr(fits[-1])
    line_fit = fc.fit_frequency(arrivals, 900.0, 1100.0, angle_deviation=1.0)
    assert line_fit.omega == pytest.approx(1000.0, rel=1e-4)
    scores = [(fit.amplitudes[0] - 1e-3) / fit.amplitude_errors[0] for fit in fits]
    assert 0.4 < np.std(scores) < 1.8 and np.abs(scores).max() < 3.5
    assert sum(fit.in_doubt for fit in fits) <= 2  # two means that are off look like a harmonic
    # Without the probes' errors the fit is known not to fit, or its errors follow from the misfit.
    exact_fit = fc.fit_order(arrivals, [6])
    assert exact_fit.does_not_fit and exact_fit.amplitude_errors[0] > 1e-5


@pytest.mark.parametrize("records", [3, pytest.param(10, marks=NIGHTLY)])
def test_marks_that_jitter_are_no_vibration(records: int, sine: fc.PeriodicSolution) -> None:
    """Marks ten times as uncertain as arrivals move all probes of a revolution: that is no
    vibration of any frequency."""
    for seed in range(records):
        arrivals = simulate_arrivals(sine, order=5, seed=seed, revolutions=150, probes=SEVEN)
        jitter = 1e-6 * np.random.default_rng(seed).standard_normal(151)
        fit = fc.fit_order(replace(arrivals, marks=arrivals.marks + jitter))
        assert fit.order == 5 and not fit.asynchronous


def test_a_wrong_order_makes_no_vibrations(sine: fc.PeriodicSolution) -> None:
    """Order 16 alone is tried of order 5 and a line: it does not fit, by centimetres, and there is
    one line, not what such a wave would have at sums and differences."""
    arrivals = simulate_arrivals(sine, 3e-6, order=5, probes=SEVEN, revolutions=150)
    delays = 2e-4 * np.cos(873.1 * arrivals.time) / (RADIUS * arrivals.speed[0])
    arrivals_with_line = replace(arrivals, time=arrivals.time - delays)
    fit = fc.fit_order(arrivals_with_line, [16], harmonics=2)
    assert fit.does_not_fit
    assert [round(line_fit.omega) for line_fit in fit.asynchronous] == [873]


def test_probes_that_are_swapped(sine: fc.PeriodicSolution) -> None:
    """Named with where they are passed, by fits, a track and displacements: these had 170 mm of
    them, and a fit of a frequency 134 mm. So is one whose arrivals are a row late. What leans all
    of them is none."""
    arrivals = simulate_arrivals(sine, order=5, probes=SEVEN)
    swapped_times, late_times = arrivals.time.copy(), arrivals.time.copy()
    swapped_times[:, [1, 4]] = swapped_times[:, [4, 1]]
    late_times[1:, 2], late_times[0, 2] = late_times[:-1, 2], np.nan
    calls: list[Callable[[fc.ArrivalTimes], Any]] = [
        fc.fit_order,
        lambda record: fc.track_order(record, 5),
        lambda record: fc.fit_frequency(record, 900.0, 1100.0),
        lambda record: fc.Measurements.from_arrivals(record, 5),
    ]
    for time, key, value in (
        (
            swapped_times,
            "probes",
            "arrivals of the probe at 20 degrees fit the angle of the probe at 88 degrees",
        ),
        (late_times, "time", "arrivals at 41 degrees belong to the revolution before their row"),
    ):
        for call in calls:
            catch_error(partial(call, replace(arrivals, time=time)), key, value)
    lean = np.radians(15.0) / arrivals.speed[0]
    assert fc.fit_order(replace(arrivals, time=arrivals.time + lean)).order == 5


@pytest.mark.parametrize(
    ("second", "draws", "doubt_range"),
    [
        (3e-4, 10, (8, 10)),
        (0.0, 10, (0, 2)),
        pytest.param(3e-4, 40, (36, 40), marks=NIGHTLY),
        pytest.param(0.0, 40, (0, 4), marks=NIGHTLY),
    ],
)
def test_a_second_harmonic_that_is_left_out(
    second: float, draws: int, doubt_range: tuple[int, int]
) -> None:
    """30 % of it, and probes out of place: by five of them an amplitude is more than three errors
    off in some of 40 draws, all of which are in doubt; by twelve of them a sine is not, as a rule.
    """
    five_angles = np.radians([0.0, 18.0, 47.0, 85.0, 131.0])
    probes, rng, deviation = (
        five_angles if second else TWELVE,
        np.random.default_rng(11),
        np.radians(0.01),
    )
    marks = 0.01 * np.arange(101)
    misses, doubts = [], []
    for draw in range(draws):
        order, (first_phase, second_phase) = 2 + draw % 11, rng.uniform(0.0, 2.0 * np.pi, 2)
        errors = deviation * rng.standard_normal(len(probes))
        target = 2.0 * np.pi * np.arange(100)[:, None] + probes + errors
        waves = ((1e-3, order, first_phase), (second, 2 * order, second_phase))
        angle = passing_angles(
            target,
            lambda alpha, waves=waves: sum(a * np.cos(n * alpha + p) for a, n, p in waves),
            0.4,
        )
        times = angle / (200.0 * np.pi) + 2e-8 * rng.standard_normal(angle.shape)
        arrivals = fc.ArrivalTimes(times, marks, probes, 0.4)
        fit = fc.fit_order(arrivals, [order], angle_deviation=deviation)
        misses.append(abs(fit.amplitudes[0] - 1e-3) > 3.0 * fit.amplitude_errors[0])
        doubts.append(fit.in_doubt)
        assert fit.does_not_fit or fit.may_contain_aliased_harmonics == (
            "may be aliased" in repr(fit)
        )
    assert not np.any(np.array(misses) & ~np.array(doubts))
    assert any(misses) == bool(second) if draws == 40 else second or not any(misses)
    assert doubt_range[0] <= sum(doubts) <= doubt_range[1]


def test_a_run_up_whose_fifth_harmonic_is_folded() -> None:
    """Seven probes and two harmonics: 50 um of the fifth look like a second one, within its errors;
    that is told. Without them seven probes cannot be sure, and twelve are. With three harmonics
    nothing is tested."""
    rng, turns = np.random.default_rng(1), 400

    def time(angle: np.ndarray) -> np.ndarray:
        return 0.01 * angle * (1.0 - 2e-5 * angle)

    marks = time(2.0 * np.pi * np.arange(turns + 1))
    size = 5e-5 / (1.0 + ((np.arange(turns) - 200.0) / 30.0) ** 2)[:, None]

    def record(fifth_harmonic: float, probes: np.ndarray = SEVEN) -> fc.ArrivalTimes:
        targets = 2.0 * np.pi * np.arange(turns)[:, None] + probes
        motion = 1e-4 * np.cos(10.0 * targets) + fifth_harmonic * size * np.cos(50.0 * targets)
        motion += 2e-6 * rng.standard_normal(targets.shape)
        angle = targets - motion / RADIUS
        return fc.ArrivalTimes(time(angle), marks, probes, RADIUS)

    folded_track = fc.track_order(record(1.0), 10, harmonics=2, revolutions=5)
    scores = (
        folded_track.amplitudes[:, 1] / folded_track.amplitude_errors[:, 1]
    )  # where there is none
    assert folded_track.amplitudes[:, 1].max() > 5e-6 and scores.max() < 3.0
    assert folded_track.does_not_fit and "DOES NOT FIT" in repr(folded_track)
    clean_track = fc.track_order(record(0.0), 10, harmonics=2, revolutions=5)
    assert clean_track.amplitudes[:, 1].max() < 3e-6 and not clean_track.does_not_fit
    assert (
        clean_track.in_doubt
        == clean_track.may_contain_aliased_harmonics
        == ("may be aliased" in repr(clean_track))
    )
    assert not fc.track_order(record(0.0, TWELVE), 10, harmonics=2, revolutions=5).in_doubt
    assert fc.track_order(record(0.0), 10, harmonics=3).in_doubt
    six_probe_track = fc.track_order(
        record(0.0, SEVEN[:6]), 10, harmonics=2
    )  # by one probe nothing is known
    assert (
        six_probe_track.in_doubt
        and np.isnan(six_probe_track.folded)
        and not six_probe_track.does_not_fit
    )


@pytest.mark.parametrize("revolutions", [4, pytest.param(1, marks=NIGHTLY)])
def test_errors_of_a_run_up_hold_what_is_folded(revolutions: int) -> None:
    """One per cent of a fourth harmonic, at probes within 150 degrees that fold it 5 times larger
    onto the two that are fitted: at the resonance they are within three errors in each of eight
    draws, and along the run-up nine in ten of all are within two."""
    turns, order, noise = 400, 10, 2e-7
    angle = 2.0 * np.pi * np.arange(turns)[:, None] + SEVEN
    size = 1.0 / (1.0 + ((np.arange(turns) - 200.0) / 30.0) ** 2)
    waves = np.array([1e-4, 5e-6, 0.0, 1e-6])
    scores = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        phases = rng.uniform(0.0, 2.0 * np.pi, len(waves))
        motion = noise * rng.standard_normal(angle.shape)
        for number, (wave, phase) in enumerate(zip(waves, phases, strict=True), 1):
            motion += wave * size[:, None] * np.cos(number * order * angle + phase)
        passing_angle = angle - motion / RADIUS
        marks = 2.0 * np.pi * np.arange(turns + 1)
        times, marks = (0.01 * part * (1.0 - 2e-5 * part) for part in (passing_angle, marks))
        arrivals = fc.ArrivalTimes(times, marks, SEVEN, RADIUS)
        track = fc.track_order(arrivals, order, harmonics=2, revolutions=revolutions)
        true_amplitudes = size.reshape(-1, revolutions).mean(axis=1)[:, None] * waves[:2]
        scores.append(np.abs(track.amplitudes - true_amplitudes) / track.amplitude_errors)
    middle = turns // revolutions // 2
    assert np.max(scores, axis=0)[middle].max() < 3.0 and np.mean(np.array(scores) > 2.0) < 0.1


def test_zero_from_quiet_revolutions(sine: fc.PeriodicSolution) -> None:
    """Probes that are out of place are where the quiet tip stands."""
    arrivals = simulate_arrivals(sine, 1e-6, order=6)
    zeroed_arrivals = replace(arrivals, probes=arrivals.probes + [0.0, 1e-3, -1e-3, 2e-3]).zeroed(
        0, 50
    )
    assert np.abs(np.nanmean(zeroed_arrivals.displacement, axis=0)).max() < 1e-6


# --- shown, and refused ---------------------------------------------------------------------------


def test_tables(sine: fc.PeriodicSolution, tmp_path: Any) -> None:
    """One row for each harmonic, order and group of revolutions; units in the headings."""
    arrivals = simulate_arrivals(sine, order=6)
    fit, track = fc.fit_order(arrivals), fc.track_order(arrivals, 6, revolutions=5)
    for result, rows, heading in (
        (fit, 2, "multiple,order,omega [rad/s],frequency [Hz],amplitude [m],amplitude_error [m]"),
        (fit.candidates, 24, "order,residual [m],condition,equivalent,hidden"),
        (track, 10, "speed [rad/s],rpm,omega [rad/s],frequency [Hz],amplitude_1 [m]"),
        (arrivals, 200, "revolution,probe,angle [rad],mark [s],next_mark [s],arrival [s]"),
    ):
        result.to_csv(tmp_path / "table.csv")
        lines = (tmp_path / "table.csv").read_text().splitlines()
        assert len(lines) == rows + 1 and lines[0].startswith(heading)
    assert repr(fit).startswith("TipFit(order 6, 1000 rad/s, 1x ")
    assert repr(track) == "TipTrack(order 6, 166.667 to 166.667 rad/s, 10 points)"
    angle = np.linspace(0.0, 1.0, 50)
    wave = sine.displacement(angle * 6.0 / 1000.0, [0])[:, 0]
    assert np.abs(fit.displacement(angle) - wave).max() < 1e-5


def test_bad_input(sine: fc.PeriodicSolution) -> None:
    """One line that names the key."""
    arrivals = simulate_arrivals(sine, order=6)
    for call, key, value in (
        (partial(fc.fit_order, arrivals, []), "orders", []),
        (partial(fc.fit_order, arrivals, [0]), "orders", 0),
        (partial(fc.fit_order, arrivals, ["x"]), "orders", "x"),
        (partial(fc.fit_order, arrivals, [6], harmonics=0), "harmonics", 0),
        (partial(fc.fit_order, arrivals, [6], subharmonic=0), "subharmonic", 0),
        (partial(fc.track_order, arrivals, 6, revolutions=0), "revolutions", 0),
        (partial(fc.track_order, arrivals, 6, revolutions=51), "revolutions", 51),
        (partial(fc.fit_frequency, arrivals, 0.0, 1.0), "low", 0.0),
        (partial(fc.fit_frequency, arrivals, 2.0, 1.0), "high", 1.0),
        (partial(fc.fit_frequency, arrivals, 1.0, 1e12), "high - low", 1e12 - 1.0),
        (partial(fc.fit_frequency, arrivals.between(0, 1), 1.0, 1e3), "arrivals", "4 arrivals"),
        (partial(arrivals.between, -1, 2), "begin", -1),
    ):
        catch_error(call, key, value)
