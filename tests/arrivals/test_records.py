"""Measured records: the one of a blisk, files of every form, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catch_error
from records import RECORD, sweep_record, write_table

import fenics_crack as fc

HERTZ = 2.0 * np.pi


@pytest.fixture(scope="module")
def blade() -> fc.ArrivalTimes:
    """Read the blade of the measured record."""
    [record] = fc.read_record(RECORD, tip_radius=0.164).values()
    return record


def test_the_largest_resonance_of_a_blisk(blade: fc.ArrivalTimes) -> None:
    """Order 8 with its margin; up and down the same."""
    [fit] = fc.find_passages(blade, range(7, 10), most=1, asynchronous=0)
    assert fit.order == 8 and fit.margin > 50.0 and not fit.ambiguous_orders
    assert fit.omega / HERTZ == pytest.approx(125.556, abs=0.03)
    assert 0.0020 < fit.damping < 0.0024
    assert fit.relative_frequency_range < 5e-4 and not fit.passages_disagree and len(fit.ends) == 2
    assert 0.005 < fit.omega_error / HERTZ < 0.012
    single_order_fit = fc.fit_passage(blade, fit.speed, [8])
    assert (
        single_order_fit.omega == pytest.approx(fit.omega, rel=1e-4)
        and single_order_fit.margin == np.inf
    )
    catch_error(lambda: fc.fit_passage(blade, 1000.0), "speed", 1000.0, names=r" 24\.\d+ to 15[23]")


@pytest.mark.nightly
def test_the_record_of_a_blisk(blade: fc.ArrivalTimes) -> None:
    """Order 8 among all; the other resonances of the family of modes near 125 Hz."""
    fits = fc.find_passages(blade)
    assert fits[0].order == 8 and fits[0].margin > 50.0 and not fits[0].ambiguous_orders
    assert fits[0].omega / HERTZ == pytest.approx(125.556, abs=0.03)
    orders = {fit.order: fit.omega / HERTZ for fit in fits if not fit.ambiguous_orders}
    assert {6.0, 7.0, 12.0, 13.0} <= set(orders)
    for order in (6.0, 7.0, 12.0, 13.0):
        assert orders[order] == pytest.approx(125.0, abs=1.2)


@pytest.mark.parametrize("line", [0.0, 418.5])
def test_passages_of_a_known_mode(line: float) -> None:
    """A mass swept through order 5 up and down, and 1 um of noise: its frequency and damping; also
    beside a vibration that order 4 meets where the speed turns."""
    omega, damping, order = 500.0, 0.004, 5
    record, motion = sweep_record([(omega, damping, order, 2e-3 * damping)], line=line)
    [fit] = fc.find_passages(record, range(1, 9))
    assert fit.order == order and not fit.ambiguous_orders and fit.margin > 1e2 and not fit.in_doubt
    assert fit.omega == pytest.approx(omega, rel=3e-6)
    assert [round(line_fit.omega, 2) for line_fit in fit.asynchronous] == [line] * (line > 0.0)
    assert fit.damping == pytest.approx(damping, rel=5e-3)
    assert fit.amplitude == pytest.approx(np.abs(motion).max(), rel=0.01)
    for name in ("order", "frequency_error", "whiteness"):
        assert name in fit.to_dict()
    assert repr(fit).startswith("PassageFit(order 5, 954.9")


@pytest.mark.parametrize("stiffening", [0.4, pytest.param(-0.3, marks=pytest.mark.nightly)])
def test_frequency_that_follows_the_speed(stiffening: float) -> None:
    """Fit a mass whose natural frequency follows the speed.

    With its slope s, frequency and damping are those of the mass; without, the damping is about
    1 / (1 - s) times as large."""
    omega, damping, order = 500.0, 0.004, 5
    modes = [(omega, damping, order, 2e-3 * damping)]
    record, motion = sweep_record(modes, stiffening=stiffening)
    [fit] = fc.find_passages(record, range(3, 8), stiffening=stiffening)
    assert fit.order == order and fit.stiffening == stiffening
    assert fit.omega == pytest.approx(omega, rel=3e-5)
    assert fit.damping == pytest.approx(damping, rel=5e-3)
    assert fit.amplitude == pytest.approx(np.abs(motion).max(), rel=0.01)
    measured_motion, fitted_motion = fit.compute_measured_and_fitted_motion(record)[0][1:]
    assert np.nanstd(measured_motion - fitted_motion) < 3e-6
    constant_fit = fc.fit_passage(record, 100.0, [order])
    assert constant_fit.damping == pytest.approx(damping / (1.0 - stiffening), rel=0.15)
    assert constant_fit.passages_disagree and constant_fit.disagreement_in_words.startswith(
        "passages differ by more than their errors"
    )
    catch_error(
        lambda: fc.fit_passage(record, 100.0, [order], stiffening=0.95),
        "stiffening",
        0.95,
        names=r"-0\.9 to 0\.9",
    )
    catch_error(
        lambda: fc.fit_passage(record, 100.0, [order], stiffening=lambda speed, omega: np.nan),
        "stiffening(100, 500)",
        np.nan,
    )


def test_marks_that_jitter_leave_no_doubt() -> None:
    """An error of a mark is in the arrivals of both revolutions that it ends and begins: residuals
    are as correlated as that makes them, and no vibration is in doubt."""
    record, _ = sweep_record([(500.0, 4e-3, 5, 8e-6)], noise=2e-5, mark_jitter=4e-7)
    [fit] = fc.find_passages(record, [4, 5, 6], asynchronous=0)
    assert fit.order == 5 and not fit.in_doubt and abs(fit.omega - 500.0) < 4.0 * fit.omega_error


@pytest.mark.parametrize(
    ("count", "orders"), [(2, [4, 5, 6]), pytest.param(3, range(1, 9), marks=pytest.mark.nightly)]
)
def test_neighbours_are_found_once_and_right(count: int, orders: Iterable[int]) -> None:
    """Two masses 1 % apart on one order, and one on another: three resonances, each within four of
    its errors, none claimed twice, nor the residual of another one."""
    modes = [(500.0, 0.002, 5, 2e-6), (505.0, 0.002, 5, 1e-6), (692.0, 0.003, 7, 2e-6)][:count]
    fits = fc.find_passages(sweep_record(modes)[0], orders, asynchronous=count - 2)
    sorted_fits = sorted(fits, key=lambda fit: fit.omega)
    assert [fit.order for fit in sorted_fits] == [5.0, 5.0, 7.0][:count]
    for fit, (omega, damping, _, _) in zip(sorted_fits, modes, strict=True):
        assert abs(fit.omega - omega) < 4.0 * fit.omega_error
        assert abs(fit.damping - damping) < 4.0 * fit.damping_error


@pytest.mark.parametrize("order", [5, pytest.param(3, marks=pytest.mark.nightly)])
def test_arrivals_of_another_blade(order: int) -> None:
    """One arrival in ten is of the next blade, 50 mm away: the order is that of the others."""
    modes = [(100.0 * order, 0.002, order, 1e-7)]
    [fit] = fc.find_passages(sweep_record(modes, outlier_share=0.1)[0], range(1, 9))
    assert fit.order == order and not fit.ambiguous_orders and not fit.in_doubt
    assert abs(fit.omega - 100.0 * order) < 4.0 * fit.omega_error


def test_a_probe_that_drops_out() -> None:
    """A probe fails in the second passage, or at once: the others see the resonance twice."""
    complete_record, _ = sweep_record([(500.0, 4e-3, 5, 8e-6)], noise=2e-5)
    for begin in (240, 0):
        time = complete_record.time.copy()
        time[begin:, 1] = np.nan
        record = replace(complete_record, time=time)
        [scanned_fit] = fc.find_passages(record, [4, 5, 6], asynchronous=0)
        for fit in (scanned_fit, fc.fit_passage(record, 100.0, [5])):
            assert fit.order == 5 and len(fit.ends) == 2 and not fit.blind
            assert abs(fit.omega - 500.0) < 4.0 * fit.omega_error
            assert fit.compute_measured_and_fitted_motion(record)[1][1].shape[1] == 4


@pytest.mark.parametrize("interval", [2, 3])
def test_a_record_of_some_revolutions(interval: int) -> None:
    """A resonance stands out of every second or third revolution as of all."""
    record, _ = sweep_record([(500.0, 4e-3, 5, 8e-6)], noise=2e-5)
    time = np.full_like(record.time, np.nan)
    time[::interval] = record.time[::interval]
    [fit] = fc.find_passages(replace(record, time=time), [4, 5, 6], asynchronous=0)
    assert fit.order == 5 and abs(fit.omega - 500.0) < 4.0 * fit.omega_error
    assert not fit.in_doubt and 0.0 < fit.whiteness < 1.0
    assert replace(fit, whiteness=np.nan).in_doubt  # where nothing tests it
    assert replace(fit, omega_errors=np.full(2, np.nan)).passages_disagree


@pytest.mark.drawn(1)
@pytest.mark.parametrize("blind_index", [0, 2])
def test_a_channel_that_sees_nothing(blind_index: int) -> None:
    """Pulses of a channel that come where the mark says, whatever the blade does: the fit is that
    of the other probes, which is within its errors, the channel is told, and there is no second
    resonance; with all channels none is told."""
    omega, damping = 500.0, 0.004
    record, _ = sweep_record([(omega, damping, 5, 2e-3 * damping)], noise=2e-5)
    time, rng = record.time.copy(), np.random.default_rng(2)
    time[:, blind_index] = record.expected[:, blind_index] + 4e-7 * rng.standard_normal(len(record))
    record = replace(record, time=time)
    [fit] = fc.find_passages(record, range(1, 9))
    assert fit.order == 5 and fit.blind == (record.probes[blind_index],) and not fit.in_doubt
    assert abs(fit.omega - omega) < 3.0 * fit.omega_error
    assert abs(fit.damping - damping) < 3.0 * fit.damping_error
    [(speeds, measured_motion, fitted_motion)] = fit.compute_measured_and_fitted_motion(record)[:1]
    assert measured_motion.shape == fitted_motion.shape == (len(speeds), 3)
    passage_fit = fc.fit_passage(record, 100.0, range(1, 9))
    assert (
        passage_fit.blind == fit.blind
        and abs(passage_fit.omega - omega) < 3.0 * passage_fit.omega_error
    )


def test_what_is_left_is_told() -> None:
    """Two masses nearer than their width are fitted by one: it is off, and in doubt."""
    modes = [(500.0, 0.003, 5, 1e-5), (502.0, 0.003, 5, 1e-5)]
    fits = fc.find_passages(sweep_record(modes)[0], [4, 5, 6], most=1, asynchronous=0)
    errors = [min(abs(fit.omega - omega) for omega in (500.0, 502.0)) for fit in fits]
    assert any(error > 4.0 * fit.omega_error for error, fit in zip(errors, fits, strict=True))
    for error, fit in zip(errors, fits, strict=True):
        assert fit.in_doubt or error < 4.0 * fit.omega_error
        assert fit.in_doubt == ("residuals are correlated" in repr(fit))
        stated_error = fit.to_dict()["frequency_error"]  # one number in table, sentence and title
        assert error / HERTZ < 1.5 * stated_error < 2.0
        for words in (repr(fit), fit.in_words):
            assert f"{fit.frequency:.6g} ± {stated_error:.2g} Hz" in words


# --- files ----------------------------------------------------------------------------------------


def test_forms_of_files(tmp_path: Path) -> None:
    """Angles in rad and degrees, times, several blades, gaps of passages and of revolutions: the
    same arrivals."""
    turns = np.array([3, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14])
    speed, rng = 10.0, np.random.default_rng(1)
    angles = np.array([0.1, 1.0]) + 1e-3 * rng.standard_normal((len(turns), 2))
    marks = 2.0 * np.pi * turns / speed
    times = marks[:, None] + angles / speed
    rpm = speed * 30.0 / np.pi
    rows = [[n, rpm, *pair, *np.degrees(pair)] for n, pair in zip(turns, angles, strict=True)]
    rows[2][3] = None
    names = "revolution,Shaft speed,Blade 1 AoA at probe 1,Blade 1 AoA at probe 2,"
    names += "blade 2 probe 1 [deg],blade 2 probe 2 [deg]"
    first_blade, second_blade = fc.read_record(
        write_table(tmp_path / "a.csv", names, rows), tip_radius=0.5
    ).values()
    assert first_blade.time.shape == (12, 2) and np.isnan(first_blade.time[3]).all()  # revolution 6
    assert np.isnan(first_blade.time[2, 1]) and np.isfinite(second_blade.time[2, 1])
    assert np.allclose(second_blade.probes, np.median(angles, axis=0)) and second_blade.first == 3
    displacements = np.delete(second_blade.displacement, 3, axis=0)
    assert np.allclose(displacements, 0.5 * (second_blade.probes - angles), atol=1e-12)
    rows = [[n, mark, *pair, 0.5] for n, mark, pair in zip(turns, marks, times, strict=True)]
    names = "revolution,mark [s],probe 1 [s],probe 2 [s],tip_radius [m]"
    path = write_table(tmp_path / "b.csv", names, rows)
    [timed_blade] = fc.read_record(path).values()
    assert np.allclose(
        timed_blade.displacement, second_blade.displacement, atol=1e-12, equal_nan=True
    )
    assert timed_blade.tip_radius == 0.5
    [placed_blade] = fc.read_record(path, probes=[0.1, 1.0]).values()
    assert np.allclose(np.delete(placed_blade.displacement, 3, axis=0), 0.5 * ([0.1, 1.0] - angles))
    timed_blade.to_csv(tmp_path / "long.csv")
    [reread_blade] = fc.read_record(tmp_path / "long.csv").values()
    assert np.array_equal(reread_blade.time, timed_blade.time, equal_nan=True)
    for name in ("b.csv", "long.csv"):  # as spreadsheets write them
        text = (tmp_path / name).read_text().rstrip()
        (tmp_path / name).write_text(re.sub(r"(?m)(^|(?<=,))([^,#\n]*)(?=,|$)", r'"\2"', text))
        [reread_blade] = fc.read_record(tmp_path / name).values()
        assert np.array_equal(reread_blade.time, timed_blade.time, equal_nan=True)


def test_a_revolution_missing_before_the_last(tmp_path: Path) -> None:
    """The last one lasts as long as those around it, and its arrivals are where they are."""
    rows = [[n, 0.1 * n, 1.0] for n in (*range(11), 12)]
    path = write_table(tmp_path / "a.csv", "revolution,mark [s],probe 1 [rad]", rows)
    [arrivals] = fc.read_record(path, tip_radius=1.0).values()
    np.testing.assert_allclose(arrivals.speed, 2.0 * np.pi / 0.1)
    assert arrivals.time[-1, 0] == pytest.approx(1.2 + 0.1 / (2.0 * np.pi))


def test_a_blade_at_the_mark(tmp_path: Path) -> None:
    """A blade is seen at the beginning or end of a revolution: angles near 0 and 2 pi."""
    angles = np.array([0.01, 6.28, 0.002, 6.281, 0.0])
    rows = [[100.0, angle, 1.0] for angle in angles]
    path = write_table(tmp_path / "a.csv", "speed [rad/s],probe 1 [rad],probe 2 [rad]", rows)
    [arrivals] = fc.read_record(path, tip_radius=1.0).values()
    assert np.abs(arrivals.displacement).max() < 0.02


def test_times_of_a_rotor_that_speeds_up(tmp_path: Path) -> None:
    """The last revolution ends as the speed changes; a blade that is seen just before each mark is
    seen in the revolution before."""
    turns = np.arange(41)

    def time_at(angle: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * angle / (900.0 + np.sqrt(900.0**2 + 40.0 * angle)))

    marks = time_at(2.0 * np.pi * turns)
    times = np.array([time_at(2.0 * np.pi * turns[:-1] + angle) for angle in (-1e-3, 1.0)]).T
    rows = np.column_stack([marks[:-1], times]).tolist()
    path = write_table(tmp_path / "a.csv", "mark [s],probe 1 [s],probe 2 [s]", rows)
    [arrivals] = fc.read_record(path, tip_radius=1.0).values()
    np.testing.assert_allclose(arrivals.marks, marks, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(arrivals.probes, [1.0, 2.0 * np.pi - 1e-3], rtol=1e-9)
    np.testing.assert_allclose(arrivals.time[:, 0], times[:, 1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(arrivals.time[:-1, 1], times[1:, 0], rtol=0.0, atol=1e-9)
    assert np.isnan(arrivals.time[-1, 1])


def test_tables_of_other_programs(tmp_path: Path) -> None:
    """Semicolons and decimal commas, tabs, numbered rows, degrees and millimetres: the same."""
    record, _ = sweep_record([])
    record.between(0, 20).to_csv(tmp_path / "record.csv")
    lines = (tmp_path / "record.csv").read_text().splitlines()
    names = lines[0].replace("angle [rad]", "angle (deg)").replace("radius [m]", "radius [mm]")
    cells = [line.split(",") for line in lines[1:]]
    indices = [lines[0].split(",").index(name) for name in ("angle [rad]", "tip_radius [m]")]
    for row in cells:
        row[indices[0]] = repr(float(np.degrees(float(row[indices[0]]))))
        row[indices[1]] = "500.0"
    for mark, comma, has_index in ((";", ",", False), ("\t", ".", True), (",", ".", True)):
        rows = [names.replace(",", mark), *(mark.join(row).replace(".", comma) for row in cells)]
        if has_index:
            rows = [
                f"{position}{mark}{row}"
                for position, row in zip(["", *range(len(cells))], rows, strict=True)
            ]
        (tmp_path / "other.csv").write_text("\n".join(rows))
        [arrivals] = fc.read_record(tmp_path / "other.csv").values()
        assert arrivals.tip_radius == 0.5 and np.allclose(
            arrivals.probes, record.probes, rtol=1e-14
        )
        assert np.array_equal(arrivals.time[:20], record.time[:20])


GOOD_ROWS = [[1000.0, 0.1], [1000.0, 0.1], [1000.0, 0.1]]


@pytest.mark.parametrize(
    ("headings", "rows", "place", "names"),
    [
        ("speed [rpm],probe 1 [m]", GOOD_ROWS, ": probe 1 [m]", "rad, deg"),
        ("speed [km/h],probe 1 [rad]", GOOD_ROWS, ": speed [km/h]", "rpm, rad/s, Hz"),
        ("pace,probe 1 [rad]", GOOD_ROWS, "", r"speed \[rpm\]"),
        ("speed [rpm],probe 1 [rad]", GOOD_ROWS[:1], ": 1 revolution", None),
        ("speed [rpm],probe 1 [rad],", GOOD_ROWS[:0], ": 0 revolutions", None),
        ("speed [rpm],probe 1 [rad],probe 1 [rad]", GOOD_ROWS, ", line 3", "3 headings"),
        (
            "speed [rpm],speed [rpm],probe 1 [rad]",
            [[9.0, 9.0, 0.1]] * 3,
            ": speed [rpm], speed [rpm], probe 1 [rad]",
            None,
        ),
        ("speed [rpm],probe 1 [rad]", [[0.0, 0.1]] * 3, ": speed [rpm]", "> 0"),
        ("speed [rpm],what", GOOD_ROWS, "", "'revolution'"),
        (
            "revolution,speed [rpm],probe 1 [rad]",
            [[2, 9.0, 0.1], [1, 9.0, 0.1]],
            ": revolution",
            ">= 0",
        ),
        ("speed [rpm],probe 1 [rad]", [[1000.0, 0.1], [1.0]], ", line 4", "2 headings"),
        ("speed [rpm],probe 1 [rad]", [[1000.0, None]] * 3, ": probe 1 [rad]", None),
        ("speed [rpm],probe 1 [rad]", [[1000.0, 41.0]] * 3, ": probe 1 [rad] = 41", "for degrees"),
        (
            "mark [s],probe 1 [rad]",
            [[None if n == 5 else 0.1 * n, 0.1] for n in range(12)],
            ": mark [s]",
            None,
        ),
        (
            "mark [s],probe 1 [s]",
            [[0.1 * (n - (n == 5)), 0.1 * n + 0.01] for n in range(12)],
            ": mark [s]",
            None,
        ),
    ],
)
def test_bad_records(
    headings: str, rows: list[Any], place: str, names: str | None, tmp_path: Path
) -> None:
    """One line that says what is wrong, and where."""
    path = write_table(tmp_path / "record.csv", headings, rows)
    catch_error(lambda: fc.read_record(path, tip_radius=0.5), "path", f"{path}{place}", names=names)


@pytest.mark.parametrize(
    ("headings", "rows", "column", "revolution"),
    [
        (
            "speed [rpm],probe 1 [rad]",
            [[1000.0, 0.1]] * 5 + [[500.0, 0.1]] + [[1000.0, 0.1]] * 5,
            "speed [rpm]",
            5,
        ),
        (
            "revolution,mark [s],probe 1 [s]",
            [[n, 0.1 * (n + (n > 6)), 0.1 * (n + (n > 6)) + 0.01] for n in range(12)],
            "mark [s]",
            6,
        ),
    ],
)
def test_a_missed_mark(
    headings: str, rows: list[Any], column: str, revolution: int, tmp_path: Path
) -> None:
    """Makes a revolution twice as long."""
    path = write_table(tmp_path / "record.csv", headings, rows)
    catch_error(
        lambda: fc.read_record(path, tip_radius=0.5),
        f"{path}: {column}",
        f"revolution {revolution} takes 2 times as long as the revolutions around it",
    )


def test_no_radius_and_other_probes(tmp_path: Path) -> None:
    """A missing radius and a wrong number of probes are named."""
    path = write_table(tmp_path / "record.csv", "speed [rpm],probe 1 [rad]", GOOD_ROWS)
    catch_error(lambda: fc.read_record(path), "tip_radius", None)
    catch_error(lambda: fc.read_record(path, tip_radius=0.5, probes=[0.1, 0.2]), "probes")
