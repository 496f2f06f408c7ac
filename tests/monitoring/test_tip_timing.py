"""Arrival times against roots found one by one, and refused input."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error, chain, oscillator, period_two_orbit
from scipy.optimize import brentq

import fenics_crack as fc

RADIUS = 0.5
PROBES = (0.0, 0.6, 1.9, 4.0, 6.2)


def blade(damping: float = 100.0, clearance: float = 0.0) -> fc.Structure:
    """Return a mass of natural frequency 1000 rad/s with a stop."""
    eye = np.ones((1, 1))
    return fc.Structure.from_matrices(
        eye, 1e6 * eye, gap=eye, force_sin=[1e3], damping=damping * eye, clearance=clearance
    )


LAW = fc.UnilateralPenalty(1e6)


@pytest.fixture(scope="module")
def orbit() -> fc.PeriodicSolution:
    """Return an orbit of some millimetres that meets its stop."""
    return fc.solve_harmonic_balance(blade(), 1000.0, LAW, harmonics=20)


def solve_arrivals(
    angle: Callable[[float], float], arrivals: fc.ArrivalTimes, reach: float
) -> np.ndarray:
    """Solve for arrival times within a reach [s] by Brent's method."""
    guesses = np.interp(
        arrivals.rotor_angle_without_vibration,
        2.0 * np.pi * np.arange(len(arrivals) + 1),
        arrivals.marks,
    )
    roots = [
        brentq(lambda t, end=end: angle(t) - end, mid - reach, mid + reach, xtol=1e-15, rtol=1e-15)
        for mid, end in zip(
            guesses.ravel(), arrivals.rotor_angle_without_vibration.ravel(), strict=True
        )
    ]
    return np.reshape(roots, arrivals.time.shape)


@pytest.mark.parametrize(
    "rotation", [{"order": 1}, {"order": 7}, {"speed": 171.3}, {"speed": 2100.0}]
)
def test_arrivals_are_roots(rotation: dict[str, Any], orbit: fc.PeriodicSolution) -> None:
    """Compare synchronous and asynchronous arrivals with roots, to 1e-12 s."""
    arrivals = fc.tip_timing(orbit, 0, probes=PROBES, tip_radius=RADIUS, revolutions=12, **rotation)
    speed = rotation.get("speed") or 1000.0 / rotation["order"]
    roots = solve_arrivals(
        lambda t: speed * t + orbit.displacement(np.array([t]), [0])[0, 0] / RADIUS,
        arrivals,
        0.02 / speed,
    )
    assert np.abs(arrivals.time - roots).max() < 1e-12
    straight = (2.0 * np.pi * np.arange(12)[:, None] + np.array(PROBES)) / speed
    shift = -RADIUS * speed * (arrivals.time - straight)
    motion = orbit.displacement(arrivals.time.ravel(), [0]).reshape(shift.shape)
    assert np.abs(shift).max() > 1e-3
    assert (
        np.abs(shift - motion).max() < 1e-12
        and np.abs(arrivals.displacement - motion).max() < 1e-12
    )


def test_arrivals_of_twice_the_loads_period() -> None:
    """Compare arrivals with roots, and every other revolution with each other."""
    orbit = period_two_orbit(12)
    arrivals = fc.tip_timing(orbit, 0, probes=PROBES, tip_radius=100.0, order=3, revolutions=6)
    speed = orbit.omega / 3
    roots = solve_arrivals(
        lambda t: speed * t + orbit.displacement(np.array([t]), [0])[0, 0] / 100.0, arrivals, 0.3
    )
    assert np.abs(arrivals.time - roots).max() < 1e-12
    motion = arrivals.displacement
    assert np.allclose(motion[2:], motion[:-2], atol=1e-10)
    assert np.abs(motion[1:] - motion[:-1]).max() > 0.1


def test_arrivals_of_a_plate() -> None:
    """Compare arrivals of two dofs with factors cos(0.5) and -sin(0.5)."""
    plate = fc.build_structure(fc.Scene.load(DEMOS / "paper_plate.toml")).damped(
        fc.ModalDamping(0.01)
    )
    solution = fc.solve_harmonic_balance(plate, 2000.0, fc.UnilateralPenalty(1e9), harmonics=10)
    dofs = [plate.find_dof((0.1, 0.1), axis) for axis in "xy"]
    factors = np.array([np.cos(0.5), -np.sin(0.5)])
    tip = dict(zip(dofs, factors, strict=True))
    arrivals = fc.tip_timing(solution, tip, probes=PROBES, tip_radius=0.2, order=5, revolutions=3)
    roots = solve_arrivals(
        lambda t: 400.0 * t + solution.displacement(np.array([t]), dofs)[0] @ factors / 0.2,
        arrivals,
        1e-5,
    )
    assert np.abs(arrivals.time - roots).max() < 1e-12


# --- run-up ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("begin", "end"), [(900.0, 1300.0), (1300.0, 900.0)])
def test_run_up_is_a_root_too(begin: float, end: float) -> None:
    """Compare arrivals of a run-up with roots, at constant acceleration.

    The vibration is interpolated between the points of the curve.
    """
    curve = fc.continue_frequency(blade(), begin, end, LAW, harmonics=7)
    arrivals = fc.tip_timing(curve, 0, probes=PROBES, tip_radius=RADIUS, order=4, revolutions=40)
    start_speed, end_speed, total = begin / 4.0, end / 4.0, 2.0 * np.pi * 40
    rate = (end_speed**2 - start_speed**2) / (2.0 * total)
    rows, sort_index = curve.coefficients_at(0), np.argsort(curve.omega)
    orders = np.arange(1, 8)

    def angle(time: float) -> float:
        rotor_angle, speed = start_speed * time + 0.5 * rate * time**2, start_speed + rate * time
        harmonics = np.array(
            [np.interp(4.0 * speed, curve.omega[sort_index], row[sort_index]) for row in rows.T]
        )
        phase = 4.0 * orders * rotor_angle
        return float(
            rotor_angle
            + (harmonics[0] + harmonics[1::2] @ np.cos(phase) + harmonics[2::2] @ np.sin(phase))
            / RADIUS
        )

    assert np.abs(arrivals.time - solve_arrivals(angle, arrivals, 2e-4)).max() < 1e-12
    assert arrivals.marks[-1] == pytest.approx(2.0 * total / (start_speed + end_speed), rel=1e-12)
    # The marks of the shaft alone tell the rotor's angle, and with it the displacement.
    rotor_angle = start_speed * arrivals.time + 0.5 * rate * arrivals.time**2
    assert np.abs(rotor_angle - arrivals.angle).max() < 1e-11


@pytest.mark.nightly
def test_run_up_jumps_where_the_curve_turns_back() -> None:
    """Compare run-up and run-down with the curve of a stop.

    The large motion lasts up to one fold, the small motion down to the other fold.
    """
    structure, amplitudes = blade(damping=30.0, clearance=0.01), []
    for begin, end in ((950.0, 1250.0), (1250.0, 950.0)):
        curve = fc.continue_frequency(structure, begin, end, LAW, harmonics=7)
        folds = sorted(b.omega for b in curve.bifurcations if b.kind == "fold")
        assert len(folds) == 2
        probes = 0.69 * np.arange(9)
        arrivals = fc.tip_timing(curve, 0, probes=probes, tip_radius=5.0, order=3, revolutions=600)
        track = fc.track_order(arrivals, 3, harmonics=3)
        row = np.argmin(np.abs(track.omega - 1080.0))
        amplitudes.append(track.amplitudes[row, 0])
        assert folds[0] < 1060.0 and folds[1] > 1100.0
        starts, stops = curve.omega[:-1] - 1080.0, curve.omega[1:] - 1080.0
        rows = curve.coefficients_at(0)
        sizes = np.hypot(rows[:, 1], rows[:, 2])
        crossings = np.flatnonzero(starts * stops < 0.0)
        assert len(crossings) == 3
        share = starts[crossings] / (starts - stops)[crossings]
        exact = sizes[crossings] + share * (sizes[crossings + 1] - sizes[crossings])
    assert amplitudes[0] == pytest.approx(exact.max(), rel=0.01)
    assert amplitudes[1] == pytest.approx(exact.min(), rel=0.01)


@pytest.mark.parametrize("verdict", ["unstable", "undecided"])
def test_run_up_jumps_before_a_fold_that_is_not_stable(verdict: str) -> None:
    """Leave out doubtful points at a fold, and refuse unstable points elsewhere."""
    curve = fc.continue_frequency(
        blade(damping=30.0, clearance=0.01), 950.0, 1250.0, LAW, harmonics=7, stability=True
    )
    fold = int(np.argmax(np.diff(curve.omega) < 0.0))
    options: dict[str, Any] = {
        "probes": [0.3, 2.0],
        "tip_radius": 5.0,
        "order": 3,
        "revolutions": 200,
    }

    def with_verdict(places: range) -> fc.ResponseCurve:
        multipliers = np.full(len(curve), 0.5 + 0j)
        multipliers[list(places)] = 2.0 if verdict == "unstable" else np.nan
        return replace(curve, multipliers=multipliers)

    near_fold = np.flatnonzero(curve.omega[: fold + 1] > (1.0 - 9e-4) * curve.omega[fold])
    stable_arrivals = fc.tip_timing(with_verdict(range(0)), 0, **options)
    early_arrivals = fc.tip_timing(with_verdict(range(int(near_fold[0]), fold + 1)), 0, **options)
    assert len(near_fold) > 1 and not np.array_equal(early_arrivals.time, stable_arrivals.time)
    last_speed = curve.omega[int(near_fold[0]) - 1] / 3.0  # up to which nothing changes
    is_below_jump = stable_arrivals.speed * 1.001 < last_speed
    assert is_below_jump.sum() > 50 and np.array_equal(
        early_arrivals.time[is_below_jump], stable_arrivals.time[is_below_jump]
    )
    if verdict == "unstable":
        catch_error(
            lambda: fc.tip_timing(with_verdict(range(fold - 12, fold + 1)), 0, **options),
            "result",
            names="unstable at",
        )


# --- noise, clock, limits -------------------------------------------------------------------------


def test_noise_and_clock(orbit: fc.PeriodicSolution) -> None:
    """Check the noise's deviation and seed, and multiples of the clock's period."""
    options: dict[str, Any] = {
        "probes": PROBES,
        "tip_radius": RADIUS,
        "order": 6,
        "revolutions": 400,
    }
    exact, seed_1, seed_1_again, seed_2 = (
        fc.tip_timing(orbit, 0, noise=noise, seed=seed, **options).time
        for noise, seed in ((0.0, 0), (1e-6, 1), (1e-6, 1), (1e-6, 2))
    )
    assert np.array_equal(seed_1, seed_1_again) and not np.array_equal(seed_1, seed_2)
    assert np.std(seed_1 - exact) == pytest.approx(1e-6, rel=0.06)
    ticks = fc.tip_timing(orbit, 0, clock=1e-7, **options).time
    assert np.allclose(ticks / 1e-7, np.round(ticks / 1e-7), atol=1e-5)
    assert np.abs(ticks - exact).max() <= 0.51e-7


def test_a_tip_that_moves_backwards_is_refused() -> None:
    """Compare arrivals of u = A sin(6 W t) near 6 A = R, refuse more.

    A tip with 6 A > R passes a probe three times.
    """
    linear = fc.solve_linear(blade(), 1000.0)
    limit = 6.0 * linear.amplitude(0)
    assert limit == pytest.approx(0.06, rel=1e-9)
    options: dict[str, Any] = {"probes": PROBES, "order": 6, "revolutions": 5}
    arrivals = fc.tip_timing(linear, 0, tip_radius=1.002 * limit, **options)
    speed = 1000.0 / 6.0
    roots = solve_arrivals(
        lambda t: speed * t + linear.displacement(np.array([t]), [0])[0, 0] / (1.002 * limit),
        arrivals,
        0.3 / speed,
    )
    assert np.abs(arrivals.time - roots).max() < 1e-12
    catch_error(
        lambda: fc.tip_timing(linear, 0, tip_radius=0.98 * limit, **options),
        "tip_radius",
        0.98 * limit,
        names=r" 1\.02 ",
    )


ARGUMENTS: dict[str, Any] = {"probes": [0.0, 1.0], "tip_radius": 0.5, "order": 6}


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"probes": [1.0, 0.0]}, "probes"),
        ({"probes": [0.0, 7.0]}, "probes"),
        ({"probes": []}, "probes"),
        ({"probes": "left"}, "probes"),
        ({"tip_radius": 0.0}, "tip_radius"),
        ({"order": 1.5}, "order"),
        ({"speed": 100.0}, "speed, order"),
        ({"order": None}, "speed, order"),
        ({"order": None, "speed": -1.0}, "speed"),
        ({"revolutions": 0}, "revolutions"),
        ({"revolutions": 10**8}, "revolutions"),
        ({"noise": -1.0}, "noise"),
        ({"clock": np.nan}, "clock"),
        ({"seed": -1}, "seed"),
        ({"tip": 5}, "dofs"),
        ({"tip": {}}, "tip"),
        ({"tip": [0]}, "tip"),
        ({"tip": {"x": 1.0}}, "dofs"),
        ({"tip": {0: "x"}}, "tip[0]"),
    ],
    ids=str,
)
def test_bad_input(change: dict[str, Any], key: str, orbit: fc.PeriodicSolution) -> None:
    """Name the key in one line."""
    catch_error(lambda: fc.tip_timing(orbit, **({"tip": 0} | ARGUMENTS | change)), key)


def test_curves_that_are_no_run_up() -> None:
    """Refuse a curve over the load, and a curve with unstable points."""
    over_load = fc.continue_parameter(blade(), 1000.0, LAW, "load", 1.0, 2.0, harmonics=3)
    catch_error(lambda: fc.tip_timing(over_load, 0, **ARGUMENTS), "result", "a curve over load")
    curve = fc.continue_frequency(
        oscillator(), 1.0, 2.6, fc.UnilateralPenalty(1.0), harmonics=7, stability=True
    )
    assert not np.all(curve.stable)
    arguments: dict[str, Any] = {"probes": [0.0], "tip_radius": 1e3}
    catch_error(
        lambda: fc.tip_timing(curve, 0, **ARGUMENTS | {"tip_radius": 1e3}),
        "result",
        names="unstable at [1-2]",
    )
    catch_error(lambda: fc.tip_timing(curve, 0, **arguments), "order", None)
    catch_error(lambda: fc.tip_timing(curve, 0, **arguments, speed=1.0), "speed", 1.0)


# --- files ----------------------------------------------------------------------------------------


def test_csv_and_back(orbit: fc.PeriodicSolution, tmp_path: Any) -> None:
    """Read back every number, also with missed passages, in any order."""
    arrivals = fc.tip_timing(orbit, 0, revolutions=5, **ARGUMENTS)
    time = arrivals.time.copy()
    time[2, 1] = np.nan
    arrivals = replace(arrivals, time=time)
    arrivals.to_csv(tmp_path / "arrivals.csv")
    lines = (tmp_path / "arrivals.csv").read_text().splitlines()
    assert lines[0].startswith("revolution,probe,angle [rad],mark [s],next_mark [s],arrival [s]")
    file_arrivals = fc.ArrivalTimes.from_csv(tmp_path / "arrivals.csv")
    for name in ("time", "marks", "probes", "displacement", "speed"):
        assert np.array_equal(getattr(file_arrivals, name), getattr(arrivals, name), equal_nan=True)
    assert (file_arrivals.tip_radius, file_arrivals.first) == (0.5, 0)
    rows = [line.split(",") for line in lines]
    shuffled_lines = [
        ",".join(["x" if k else "note", *reversed(row)]) for k, row in enumerate(rows)
    ]
    shuffled_lines[1:] = [row for row in shuffled_lines[:0:-1] if "nan" not in row]
    (tmp_path / "other.csv").write_text("\n".join(shuffled_lines) + "\n")
    shuffled_arrivals = fc.ArrivalTimes.from_csv(tmp_path / "other.csv", tip_radius=0.5)
    assert np.array_equal(shuffled_arrivals.time, file_arrivals.time, equal_nan=True)
    assert "5 revolutions, 2 probes, 166.667 rad/s, 1 missing" in repr(shuffled_arrivals)


def test_csv_of_a_measured_run_up(tmp_path: Any) -> None:
    """Read back the same bits, and write the same file.

    No short decimal holds the numbers, the first revolution is 12345, and passages are missed: all
    of one probe, all of a revolution.
    """
    generator = np.random.default_rng(5)
    marks = np.cumsum(0.01 + 1e-3 * generator.random(31)) + 1e5 / 3.0
    time = marks[:-1, None] + 0.01 * generator.random((30, 3))
    time[:, 1], time[7] = np.nan, np.nan
    radius = 1.0 / 3.0
    arrivals = fc.ArrivalTimes(time, marks, np.array([0.0, 0.1, 1.0]) * np.pi / 3.0, radius, 12345)
    arrivals.to_csv(tmp_path / "one.csv")
    file_arrivals = fc.ArrivalTimes.from_csv(tmp_path / "one.csv")
    for name in (
        "time",
        "marks",
        "probes",
        "displacement",
        "angle",
        "speed",
        "rotor_angle_without_vibration",
    ):
        assert getattr(file_arrivals, name).tobytes() == getattr(arrivals, name).tobytes(), name
    assert (file_arrivals.tip_radius, file_arrivals.first) == (
        radius,
        12345,
    ) and not file_arrivals.steady
    file_arrivals.to_csv(tmp_path / "two.csv")
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "two.csv").read_bytes()
    catch_error(
        lambda: fc.ArrivalTimes.from_csv(tmp_path / "one.csv", tip_radius=0.5),
        "path",
        names=r"tip_radius \[m\] = .* = 0\.5 m",
    )


MANY_PROBES = "".join(f"\n{n},1,{n / 4000.0},{n},{n + 1},1e-3,1,1,0.5" for n in range(4000))
"""Each revolution passes another one."""


@pytest.mark.parametrize(
    ("change", "place", "names"),
    [
        (
            lambda text: text.replace(",0.5\n", ",0.6\n", 1),
            ", tip_radius [m] = [0.5, 0.6]",
            r" = 0\.5 m",
        ),
        (lambda text: text.replace("arrival [s]", "arrival [ms]"), "", r"'arrival \[s\]'"),
        (lambda text: text.replace("\n1,", "\n1.5,"), ", line 4", None),
        (lambda text: text.replace("\n1,", "\n7,"), "", None),
        (lambda text: text.replace("\n1,", "\n100000000000,", 1), "", None),
        (lambda text: text.replace("\n1,", "\n1e300,"), ", line 4", None),
        (
            lambda text: text.splitlines()[0] + MANY_PROBES,
            ": 4000 revolutions, 4000 probes",
            r"1e\+07 ",
        ),
        (lambda text: text.replace("\n0,2,", "\n1,2,"), "", "next_mark"),
        (lambda text: text + "1,2\n", ", line 8", "9 headings.* 2$"),
        (lambda text: text.splitlines()[0], "", None),
        (lambda text: text.splitlines()[0] + "\n\n", "", None),
        (lambda text: "", "", "'revolution'"),
    ],
)
def test_bad_files(
    change: Callable[[str], str],
    place: str,
    names: str | None,
    orbit: fc.PeriodicSolution,
    tmp_path: Any,
) -> None:
    """Say in one line what is wrong with a file."""
    path = tmp_path / "arrivals.csv"
    fc.tip_timing(orbit, 0, revolutions=3, **ARGUMENTS).to_csv(path)
    path.write_text(change(path.read_text()))
    catch_error(
        partial(fc.ArrivalTimes.from_csv, path, tip_radius=0.5),
        "path",
        f"{path}{place}",
        names=names,
    )
    catch_error(
        lambda: fc.ArrivalTimes.from_csv(tmp_path / "none.csv", tip_radius=0.5),
        "path",
        str(tmp_path / "none.csv"),
    )
    fc.tip_timing(orbit, 0, revolutions=3, **ARGUMENTS).to_csv(path)
    path.write_text(path.read_text().replace("tip_radius", "radius"))
    catch_error(lambda: fc.ArrivalTimes.from_csv(path), "tip_radius", None)


def test_bad_arrivals() -> None:
    """Refuse arrays that do not fit, by name."""
    time, marks = np.ones((2, 1)), np.arange(3.0)
    for key, wrong_array, value in (
        ("time", np.ones((2, 2)), "of shape (2, 2)"),
        ("time", np.full((2, 1), np.nan), "no finite number"),
        ("time", np.array([[1.0], [1e300]]), 1e300),
        ("time", np.array([[-1.1], [1.0]]), -1.1),
        ("marks", np.array([0.0, 1.0, -2.0]), "-2 s after 1 s"),
        ("marks", np.zeros((3, 1)), "of shape (3, 1)"),
        ("probes", np.array([-1.0]), np.array([-1.0])),
        ("tip_radius", -1.0, -1.0),
    ):
        fields = {"time": time, "marks": marks, "probes": np.zeros(1), "tip_radius": 1.0}
        catch_error(partial(fc.ArrivalTimes, **fields | {key: wrong_array}), key, value)


@pytest.mark.parametrize("turn", [0, 1, 4])
def test_revolutions_that_are_cut_short(turn: int) -> None:
    """Refuse a revolution half as long as the others, wherever it is.

    A record may begin or end between two marks; its times then show wrong angles.
    """
    turns = np.ones(5)
    turns[turn] = 0.5
    marks = np.concatenate([[0.0], np.cumsum(turns)])
    catch_error(
        lambda: fc.ArrivalTimes(marks[:-1, None] + 0.1, marks, np.zeros(1), 1.0),
        "marks",
        names=f"revolution {turn} takes 0.5 times",
    )


def test_only_dofs_that_exist_are_asked_for() -> None:
    """Find the dofs of the whole structure in a reduced structure."""
    structure = chain("modal", n=20, pairs=1)
    reduction = fc.reduce_structure(structure, modes=6)
    assert reduction.n_dofs < 19
    solution = fc.solve_harmonic_balance(reduction, 0.7, fc.UnilateralPenalty(2.0), harmonics=5)
    arrivals = fc.tip_timing(solution, 19, probes=[0.5], tip_radius=1e3, order=2, revolutions=4)
    motion = solution.displacement(arrivals.time.ravel(), [19])[:, 0]
    assert np.abs(arrivals.displacement.ravel() - motion).max() < 1e-9
