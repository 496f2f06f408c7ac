"""Arrival times against roots found one by one, and what makes them impossible."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, chain, oscillator, period_two_orbit
from scipy.optimize import brentq

import fenics_crack as fc

RADIUS = 0.5
PROBES = (0.0, 0.6, 1.9, 4.0, 6.2)


def blade(damping: float = 100.0, clearance: float = 0.0) -> fc.Structure:
    """One mass of natural frequency 1000 rad/s; a stop of the same stiffness doubles it."""
    one = np.ones((1, 1))
    return fc.Structure.from_matrices(
        one, 1e6 * one, gap=one, force_sin=[1e3], damping=damping * one, clearance=clearance
    )


LAW = fc.UnilateralPenalty(1e6)


@pytest.fixture(scope="module")
def breathing() -> fc.PeriodicSolution:
    """The mass that meets its stop in every period: some millimetres."""
    return fc.solve_harmonic_balance(blade(), 1000.0, LAW, harmonics=20)


def roots(angle: Callable[[float], float], arrivals: fc.ArrivalTimes, reach: float) -> np.ndarray:
    """Arrival times by Brent's method, each for itself, within a reach [s] of the nominal ones."""
    expected = np.interp(
        arrivals.nominal_angle, 2.0 * np.pi * np.arange(len(arrivals) + 1), arrivals.marks
    )
    found = [
        brentq(lambda t, end=end: angle(t) - end, at - reach, at + reach, xtol=1e-15, rtol=1e-15)
        for at, end in zip(expected.ravel(), arrivals.nominal_angle.ravel(), strict=True)
    ]
    return np.reshape(found, arrivals.time.shape)


@pytest.mark.parametrize("how", [{"order": 1}, {"order": 7}, {"speed": 171.3}, {"speed": 2100.0}])
def test_arrivals_are_roots(how: dict[str, Any], breathing: fc.PeriodicSolution) -> None:
    """Synchronous and not: to 1e-12 s, from the displacement in time."""
    arrivals = fc.tip_timing(breathing, 0, probes=PROBES, tip_radius=RADIUS, revolutions=12, **how)
    speed = how.get("speed") or 1000.0 / how["order"]
    wanted = roots(
        lambda t: speed * t + breathing.displacement(np.array([t]), [0])[0, 0] / RADIUS,
        arrivals,
        0.02 / speed,
    )
    assert np.abs(arrivals.time - wanted).max() < 1e-12
    straight = (2.0 * np.pi * np.arange(12)[:, None] + np.array(PROBES)) / speed
    shift = -RADIUS * speed * (arrivals.time - straight)
    moved = breathing.displacement(arrivals.time.ravel(), [0]).reshape(shift.shape)
    assert np.abs(shift).max() > 1e-3
    assert (
        np.abs(shift - moved).max() < 1e-12 and np.abs(arrivals.displacement - moved).max() < 1e-12
    )


def test_arrivals_of_twice_the_loads_period() -> None:
    """Every other revolution is alike; to rounding of times of some hundred seconds."""
    orbit = period_two_orbit(12)
    arrivals = fc.tip_timing(orbit, 0, probes=PROBES, tip_radius=100.0, order=3, revolutions=6)
    speed = orbit.omega / 3
    wanted = roots(
        lambda t: speed * t + orbit.displacement(np.array([t]), [0])[0, 0] / 100.0, arrivals, 0.3
    )
    assert np.abs(arrivals.time - wanted).max() < 1e-12
    moved = arrivals.displacement
    assert np.allclose(moved[2:], moved[:-2], atol=1e-10)
    assert np.abs(moved[1:] - moved[:-1]).max() > 0.1


def test_arrivals_of_a_plate() -> None:
    """Two dofs with factors: the tip's motion at 30 degrees to the plate's x axis."""
    plate = fc.build_structure(fc.Scene.load(DEMOS / "paper_plate.toml")).damped(
        fc.ModalDamping(0.01)
    )
    solution = fc.solve_harmonic_balance(plate, 2000.0, fc.UnilateralPenalty(1e9), harmonics=10)
    dofs = [plate.find_dof((0.1, 0.1), axis) for axis in "xy"]
    shares = np.array([np.cos(0.5), -np.sin(0.5)])
    tip = dict(zip(dofs, shares, strict=True))
    arrivals = fc.tip_timing(solution, tip, probes=PROBES, tip_radius=0.2, order=5, revolutions=3)
    wanted = roots(
        lambda t: 400.0 * t + solution.displacement(np.array([t]), dofs)[0] @ shares / 0.2,
        arrivals,
        1e-5,
    )
    assert np.abs(arrivals.time - wanted).max() < 1e-12


# --- run-up ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("begin", "end"), [(900.0, 1300.0), (1300.0, 900.0)])
def test_run_up_is_a_root_too(begin: float, end: float) -> None:
    """Constant acceleration, the vibration interpolated between the points of the curve."""
    curve = fc.continue_frequency(blade(), begin, end, LAW, harmonics=7)
    arrivals = fc.tip_timing(curve, 0, probes=PROBES, tip_radius=RADIUS, order=4, revolutions=40)
    first, last, total = begin / 4.0, end / 4.0, 2.0 * np.pi * 40
    rate = (last**2 - first**2) / (2.0 * total)
    rows, rising = curve.coefficients_at(0), np.argsort(curve.omega)
    orders = np.arange(1, 8)

    def angle(time: float) -> float:
        turned, speed = first * time + 0.5 * rate * time**2, first + rate * time
        here = np.array(
            [np.interp(4.0 * speed, curve.omega[rising], row[rising]) for row in rows.T]
        )
        phase = 4.0 * orders * turned
        return float(
            turned + (here[0] + here[1::2] @ np.cos(phase) + here[2::2] @ np.sin(phase)) / RADIUS
        )

    assert np.abs(arrivals.time - roots(angle, arrivals, 2e-4)).max() < 1e-12
    assert arrivals.marks[-1] == pytest.approx(2.0 * total / (first + last), rel=1e-12)
    # The marks of the shaft alone tell the rotor's angle, and with it the displacement.
    turned = first * arrivals.time + 0.5 * rate * arrivals.time**2
    assert np.abs(turned - arrivals.angle).max() < 1e-11


@pytest.mark.nightly
def test_run_up_jumps_where_the_curve_turns_back() -> None:
    """A stop that stiffens: the large motion up to one fold, the small one down to the other."""
    structure, found = blade(damping=30.0, clearance=0.01), []
    for begin, end in ((950.0, 1250.0), (1250.0, 950.0)):
        curve = fc.continue_frequency(structure, begin, end, LAW, harmonics=7)
        folds = sorted(b.omega for b in curve.bifurcations if b.kind == "fold")
        assert len(folds) == 2
        probes = 0.69 * np.arange(9)
        arrivals = fc.tip_timing(curve, 0, probes=probes, tip_radius=5.0, order=3, revolutions=600)
        track = fc.track_order(arrivals, 3, harmonics=3)
        nearest = np.argmin(np.abs(track.omega - 1080.0))
        found.append(track.amplitudes[nearest, 0])
        assert folds[0] < 1060.0 and folds[1] > 1100.0
        below, above = curve.omega[:-1] - 1080.0, curve.omega[1:] - 1080.0
        rows = curve.coefficients_at(0)
        sizes = np.hypot(rows[:, 1], rows[:, 2])
        crossings = np.flatnonzero(below * above < 0.0)
        assert len(crossings) == 3
        share = below[crossings] / (below - above)[crossings]
        exact = sizes[crossings] + share * (sizes[crossings + 1] - sizes[crossings])
    assert found[0] == pytest.approx(exact.max(), rel=0.01)
    assert found[1] == pytest.approx(exact.min(), rel=0.01)


@pytest.mark.parametrize("verdict", ["unstable", "undecided"])
def test_run_up_jumps_before_a_fold_that_is_not_stable(verdict: str) -> None:
    """Points next to the fold that are not stable are not passed; away from it they are told."""
    curve = fc.continue_frequency(
        blade(damping=30.0, clearance=0.01), 950.0, 1250.0, LAW, harmonics=7, stability=True
    )
    turn = int(np.argmax(np.diff(curve.omega) < 0.0))
    how: dict[str, Any] = {"probes": [0.3, 2.0], "tip_radius": 5.0, "order": 3, "revolutions": 200}

    def judged(places: range) -> fc.ResponseCurve:
        multipliers = np.full(len(curve), 0.5 + 0j)
        multipliers[list(places)] = 2.0 if verdict == "unstable" else np.nan
        return replace(curve, multipliers=multipliers)

    near = np.flatnonzero(curve.omega[: turn + 1] > (1.0 - 9e-4) * curve.omega[turn])
    before = fc.tip_timing(judged(range(0)), 0, **how)
    early = fc.tip_timing(judged(range(int(near[0]), turn + 1)), 0, **how)
    assert len(near) > 1 and not np.array_equal(early.time, before.time)
    last = curve.omega[int(near[0]) - 1] / 3.0  # up to which nothing changes
    same = before.speed * 1.001 < last
    assert same.sum() > 50 and np.array_equal(early.time[same], before.time[same])
    if verdict == "unstable":
        with pytest.raises(fc.InputError, match="unstable at"):
            fc.tip_timing(judged(range(turn - 12, turn + 1)), 0, **how)


# --- noise, clock, limits -------------------------------------------------------------------------


def test_noise_and_clock(breathing: fc.PeriodicSolution) -> None:
    """Its standard deviation, the same for the same seed; multiples of the clock's period."""
    how: dict[str, Any] = {"probes": PROBES, "tip_radius": RADIUS, "order": 6, "revolutions": 400}
    exact, one, two, three = (
        fc.tip_timing(breathing, 0, noise=noise, seed=seed, **how).time
        for noise, seed in ((0.0, 0), (1e-6, 1), (1e-6, 1), (1e-6, 2))
    )
    assert np.array_equal(one, two) and not np.array_equal(one, three)
    assert np.std(one - exact) == pytest.approx(1e-6, rel=0.06)
    ticks = fc.tip_timing(breathing, 0, clock=1e-7, **how).time
    assert np.allclose(ticks / 1e-7, np.round(ticks / 1e-7), atol=1e-5)
    assert np.abs(ticks - exact).max() <= 0.51e-7


def test_a_tip_that_moves_backwards_is_refused() -> None:
    """u = A sin(6 W t) does where 6 A > R; then it passes a probe three times."""
    linear = fc.solve_linear(blade(), 1000.0)
    limit = 6.0 * linear.amplitude(0)
    assert limit == pytest.approx(0.06, rel=1e-9)
    how: dict[str, Any] = {"probes": PROBES, "order": 6, "revolutions": 5}
    arrivals = fc.tip_timing(linear, 0, tip_radius=1.002 * limit, **how)
    speed = 1000.0 / 6.0
    wanted = roots(
        lambda t: speed * t + linear.displacement(np.array([t]), [0])[0, 0] / (1.002 * limit),
        arrivals,
        0.3 / speed,
    )
    assert np.abs(arrivals.time - wanted).max() < 1e-12
    with pytest.raises(fc.InputError, match=r"tip_radius = .* 1\.02 of the speed"):
        fc.tip_timing(linear, 0, tip_radius=0.98 * limit, **how)


GOOD: dict[str, Any] = {"probes": [0.0, 1.0], "tip_radius": 0.5, "order": 6}


@pytest.mark.parametrize(
    ("bad", "words"),
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
        ({"tip": {0: "x"}}, "tip"),
    ],
    ids=str,
)
def test_bad_input(bad: dict[str, Any], words: str, breathing: fc.PeriodicSolution) -> None:
    """One line that names the key."""
    with pytest.raises(fc.InputError, match=f"^{words}"):
        fc.tip_timing(breathing, **({"tip": 0} | GOOD | bad))


def test_curves_that_are_no_run_up() -> None:
    """One over the load, and one along which the motion cannot stay."""
    over_load = fc.continue_parameter(blade(), 1000.0, LAW, "load", 1.0, 2.0, harmonics=3)
    with pytest.raises(fc.InputError, match="one over the load frequency"):
        fc.tip_timing(over_load, 0, **GOOD)
    curve = fc.continue_frequency(
        oscillator(), 1.0, 2.6, fc.UnilateralPenalty(1.0), harmonics=7, stability=True
    )
    assert not np.all(curve.stable)
    with pytest.raises(fc.InputError, match="unstable at"):
        fc.tip_timing(curve, 0, **(GOOD | {"tip_radius": 1e3}))
    with pytest.raises(fc.InputError, match=r"^order"):
        fc.tip_timing(curve, 0, probes=[0.0], tip_radius=1e3)
    with pytest.raises(fc.InputError, match=r"^speed"):
        fc.tip_timing(curve, 0, probes=[0.0], tip_radius=1e3, speed=1.0)


# --- files ----------------------------------------------------------------------------------------


def test_csv_and_back(breathing: fc.PeriodicSolution, tmp_path: Any) -> None:
    """Every number, also of a passage that was missed; other columns and orders do not matter."""
    arrivals = fc.tip_timing(breathing, 0, revolutions=5, **GOOD)
    time = arrivals.time.copy()
    time[2, 1] = np.nan
    arrivals = replace(arrivals, time=time)
    arrivals.to_csv(tmp_path / "arrivals.csv")
    lines = (tmp_path / "arrivals.csv").read_text().splitlines()
    assert lines[0].startswith("revolution,probe,angle [rad],mark [s],next_mark [s],arrival [s]")
    same = fc.ArrivalTimes.from_csv(tmp_path / "arrivals.csv")
    for name in ("time", "marks", "probes", "displacement", "speed"):
        assert np.array_equal(getattr(same, name), getattr(arrivals, name), equal_nan=True)
    assert (same.tip_radius, same.first) == (0.5, 0)
    rows = [line.split(",") for line in lines]
    shuffled = [",".join(["x" if k else "note", *reversed(row)]) for k, row in enumerate(rows)]
    shuffled[1:] = [row for row in shuffled[:0:-1] if "nan" not in row]
    (tmp_path / "other.csv").write_text("\n".join(shuffled) + "\n")
    again = fc.ArrivalTimes.from_csv(tmp_path / "other.csv", tip_radius=0.5)
    assert np.array_equal(again.time, same.time, equal_nan=True)
    assert "5 revolutions, 2 probes, 166.667 rad/s, 1 missing" in repr(again)


def test_csv_of_a_measured_run_up(tmp_path: Any) -> None:
    """Numbers that no short decimal holds, revolutions counted from another one, most passages of a
    probe missed, all of a revolution: the same to the last bit, and its file again."""
    generator = np.random.default_rng(5)
    marks = np.cumsum(0.01 + 1e-3 * generator.random(31)) + 1e5 / 3.0
    time = marks[:-1, None] + 0.01 * generator.random((30, 3))
    time[:, 1], time[7] = np.nan, np.nan
    radius = 1.0 / 3.0
    arrivals = fc.ArrivalTimes(time, marks, np.array([0.0, 0.1, 1.0]) * np.pi / 3.0, radius, 12345)
    arrivals.to_csv(tmp_path / "one.csv")
    same = fc.ArrivalTimes.from_csv(tmp_path / "one.csv")
    for name in ("time", "marks", "probes", "displacement", "angle", "speed", "nominal_angle"):
        assert getattr(same, name).tobytes() == getattr(arrivals, name).tobytes(), name
    assert (same.tip_radius, same.first) == (radius, 12345) and not same.steady
    same.to_csv(tmp_path / "two.csv")
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "two.csv").read_bytes()
    with pytest.raises(fc.InputError, match=r"tip_radius \[m\] = .* 0.5, as given"):
        fc.ArrivalTimes.from_csv(tmp_path / "one.csv", tip_radius=0.5)


MANY_PROBES = "".join(f"\n{n},1,{n / 4000.0},{n},{n + 1},1e-3,1,1,0.5" for n in range(4000))
"""Each revolution passes another one."""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace(",0.5\n", ",0.6\n", 1), r"tip_radius \[m\] = .* 0.5, as given"),
        (lambda text: text.replace("arrival [s]", "arrival [ms]"), "column 'arrival"),
        (lambda text: text.replace("\n1,", "\n1.5,"), r"csv, line 4': .*whole revolution"),
        (lambda text: text.replace("\n1,", "\n7,"), "without gaps"),
        (lambda text: text.replace("\n1,", "\n100000000000,", 1), "without gaps"),
        (lambda text: text.replace("\n1,", "\n1e300,"), r"csv, line 4': .*whole revolution"),
        (lambda text: text.splitlines()[0] + MANY_PROBES, "4000 revolutions, 4000 probes.*1e.07"),
        (lambda text: text.replace("\n0,2,", "\n1,2,"), "one mark"),
        (lambda text: text + "1,2\n", r"csv, line 8': must be a row of 9 cells.*not of 2"),
        (lambda text: text.splitlines()[0], "rows of numbers"),
        (lambda text: text.splitlines()[0] + "\n\n", "rows of numbers"),
        (lambda text: "", "column 'revolution.*it is empty"),
    ],
)
def test_bad_files(
    change: Callable[[str], str], words: str, breathing: fc.PeriodicSolution, tmp_path: Any
) -> None:
    """One line that says what is missing."""
    path = tmp_path / "arrivals.csv"
    fc.tip_timing(breathing, 0, revolutions=3, **GOOD).to_csv(path)
    path.write_text(change(path.read_text()))
    with pytest.raises(fc.InputError, match=words):
        fc.ArrivalTimes.from_csv(path, tip_radius=0.5)
    with pytest.raises(fc.InputError, match="readable"):
        fc.ArrivalTimes.from_csv(tmp_path / "none.csv", tip_radius=0.5)
    fc.tip_timing(breathing, 0, revolutions=3, **GOOD).to_csv(path)
    path.write_text(path.read_text().replace("tip_radius", "radius"))
    with pytest.raises(fc.InputError, match=r"^tip_radius is missing: must be .*no column"):
        fc.ArrivalTimes.from_csv(path)


def test_bad_arrivals() -> None:
    """Arrays that do not fit."""
    time, marks = np.ones((2, 1)), np.arange(3.0)
    for change, words in (
        ({"time": np.ones((2, 2))}, "time"),
        ({"time": np.full((2, 1), np.nan)}, "time"),
        ({"time": np.array([[1.0], [1e300]])}, "time"),
        ({"time": np.array([[-1.1], [1.0]])}, "time"),
        ({"marks": np.array([0.0, 1.0, -2.0])}, "marks = '-2 s after 1 s': must be increasing"),
        ({"marks": np.zeros((3, 1))}, "marks = 'of shape "),
        ({"probes": np.array([-1.0])}, "probes"),
        ({"tip_radius": -1.0}, "tip_radius"),
    ):
        given = {"time": time, "marks": marks, "probes": np.zeros(1), "tip_radius": 1.0} | change
        with pytest.raises(fc.InputError, match=f"^{words}"):
            fc.ArrivalTimes(**given)


@pytest.mark.parametrize("turn", [0, 1, 4])
def test_revolutions_that_are_cut_short(turn: int) -> None:
    """As where a record begins or ends between two marks: to half of its probes the rest of it is
    at another angle."""
    turns = np.ones(5)
    turns[turn] = 0.5
    marks = np.concatenate([[0.0], np.cumsum(turns)])
    with pytest.raises(fc.InputError, match=f"^marks = 'revolution {turn} takes 0.5 times as"):
        fc.ArrivalTimes(marks[:-1, None] + 0.1, marks, np.zeros(1), 1.0)


def test_only_dofs_that_exist_are_asked_for() -> None:
    """Of a reduced structure, those of the whole one."""
    whole = chain("modal", n=20, pairs=1)
    reduced = fc.reduce_structure(whole, modes=6)
    assert reduced.n_dofs < 19
    solution = fc.solve_harmonic_balance(reduced, 0.7, fc.UnilateralPenalty(2.0), harmonics=5)
    arrivals = fc.tip_timing(solution, 19, probes=[0.5], tip_radius=1e3, order=2, revolutions=4)
    moved = solution.displacement(arrivals.time.ravel(), [19])[:, 0]
    assert np.abs(arrivals.displacement.ravel() - moved).max() < 1e-9
