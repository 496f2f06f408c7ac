"""Measured records: the one of a blisk, files of every form, and what is refused."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS
from surroundings import main

import fenics_crack as fc

RECORD = DEMOS / "blisk_blade.csv"
HERTZ = 2.0 * np.pi


@pytest.fixture(scope="module")
def blade() -> fc.ArrivalTimes:
    """The blade of the record."""
    [found] = fc.read_record(RECORD, tip_radius=0.164).values()
    return found


def test_the_record_of_a_blisk(blade: fc.ArrivalTimes) -> None:
    """Order 8 with its margin; up and down the same; a steady fit is not; the other resonances of
    the family of modes near 125 Hz; five seconds."""
    begun = time.process_time()
    found = fc.find_passages(blade)
    assert time.process_time() - begun < 5.0
    first = found[0]
    assert first.order == 8 and first.margin > 50.0 and not first.ambiguous
    assert first.omega / HERTZ == pytest.approx(125.556, abs=0.03)
    assert 0.0020 < first.damping < 0.0024
    assert first.apart < 5e-4 and not first.disagree and len(first.ends) == 2
    up, down = first.steady_omegas / first.omega - 1.0
    assert up > 0.004 and down < -0.004 and first.steady_bias > 0.005
    assert 0.005 < first.omega_error / HERTZ < 0.012
    orders = {fit.order: fit.omega / HERTZ for fit in found if not fit.ambiguous}
    assert {6.0, 7.0, 12.0, 13.0} <= set(orders)
    for order in (6.0, 7.0, 12.0, 13.0):
        assert orders[order] == pytest.approx(125.0, abs=1.2)
    alone = fc.fit_passage(blade, first.speed, [8])
    assert alone.omega == pytest.approx(first.omega, rel=1e-4) and alone.margin == np.inf
    with pytest.raises(fc.InputError, match=r"^speed = 1000.* 24\.\d+ to 15[23]"):
        fc.fit_passage(blade, 1000.0)


@pytest.mark.parametrize("line", [0.0, 418.5])
def test_passages_of_a_known_mode(line: float) -> None:
    """A mass swept through order 5 up and down, integrated exactly, and 1 um of noise: its
    frequency and damping; also beside a vibration that order 4 meets where the speed turns."""
    omega, damping, order, radius = 500.0, 0.004, 5, 0.5
    middle, turns = omega / order, 240

    def speed(t: np.ndarray) -> np.ndarray:
        return middle * (0.95 + 0.1 * (1.0 - np.abs(t / half - 1.0)))

    half = turns * 2.0 * np.pi / middle
    grid = np.linspace(0.0, 2.0 * half, 400_001)
    step = grid[1]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * step * (speed(grid[1:]) + speed(grid[:-1])))])
    push = omega**2 * 2e-3 * damping * np.cos(order * angle)
    # Exact for a push that is linear within a step: the mode's response to it, by its root.
    root = omega * complex(-damping, np.sqrt(1.0 - damping**2))
    decay = np.exp(root * step)
    first = (decay - 1.0) / root
    second = (first - step) / (root * step)
    state, motion = 0.0 + 0.0j, np.zeros(len(grid))
    changes = np.diff(push, append=push[-1])
    for n in range(len(grid) - 1):
        motion[n] = state.imag / root.imag
        state = decay * state + first * push[n] + second * changes[n]
    probes = np.array([0.3, 1.0, 2.2, 4.0])
    count = int(angle[-1] / (2.0 * np.pi)) - 1
    targets = 2.0 * np.pi * np.arange(count)[:, None] + probes
    tip = angle + (motion + 2e-4 * np.cos(line * grid) * (line > 0.0)) / radius
    noise = 1e-6 / radius * np.random.default_rng(1).standard_normal(targets.shape)
    arrivals = np.interp(targets + noise, tip, grid)
    marks = np.interp(2.0 * np.pi * np.arange(count + 1), angle, grid)
    record = fc.ArrivalTimes(arrivals, marks, probes, radius)
    [fit] = fc.find_passages(record, range(1, 9), asynchronous=int(line > 0.0))
    assert fit.order == order and not fit.ambiguous and fit.margin > 1e2
    assert fit.omega == pytest.approx(omega, rel=3e-6)
    assert [round(one.omega, 2) for one in fit.asynchronous] == [line] * (line > 0.0)
    assert fit.damping == pytest.approx(damping, rel=5e-3)
    assert fit.amplitude == pytest.approx(np.abs(motion).max(), rel=0.01)
    for name in ("order", "frequency_error", "steady_bias", "whiteness"):
        assert name in fit.to_dict()
    assert repr(fit).startswith("PassageFit(order 5, 954.9")


# --- files ----------------------------------------------------------------------------------------


def written(path: Path, headings: str, rows: list[list[Any]]) -> Path:
    """A file of some rows."""
    lines = [
        headings,
        *(",".join("" if cell is None else str(cell) for cell in row) for row in rows),
    ]
    path.write_text("# a remark\n" + "\n".join(lines) + "\n")
    return path


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
    one, two = fc.read_record(written(tmp_path / "a.csv", names, rows), tip_radius=0.5).values()
    assert one.time.shape == (12, 2) and np.isnan(one.time[3]).all()  # revolution 6
    assert np.isnan(one.time[2, 1]) and np.isfinite(two.time[2, 1])
    assert np.allclose(two.probes, np.median(angles, axis=0)) and two.first == 3
    seen = np.delete(two.displacement, 3, axis=0)
    assert np.allclose(seen, 0.5 * (two.probes - angles), atol=1e-12)
    rows = [[n, mark, *pair, 0.5] for n, mark, pair in zip(turns, marks, times, strict=True)]
    names = "revolution,mark [s],probe 1 [s],probe 2 [s],tip_radius [m]"
    path = written(tmp_path / "b.csv", names, rows)
    [three] = fc.read_record(path).values()
    assert np.allclose(three.displacement, two.displacement, atol=1e-12, equal_nan=True)
    assert three.tip_radius == 0.5
    [four] = fc.read_record(path, probes=[0.1, 1.0]).values()
    assert np.allclose(np.delete(four.displacement, 3, axis=0), 0.5 * ([0.1, 1.0] - angles))
    three.to_csv(tmp_path / "long.csv")
    [again] = fc.read_record(tmp_path / "long.csv").values()
    assert np.array_equal(again.time, three.time, equal_nan=True)


def test_a_blade_at_the_mark(tmp_path: Path) -> None:
    """It is seen at the beginning of a revolution or at its end: angles near 0 and 2 pi."""
    angles = np.array([0.01, 6.28, 0.002, 6.281, 0.0])
    rows = [[100.0, angle, 1.0] for angle in angles]
    path = written(tmp_path / "a.csv", "speed [rad/s],probe 1 [rad],probe 2 [rad]", rows)
    [found] = fc.read_record(path, tip_radius=1.0).values()
    assert np.abs(found.displacement).max() < 0.02


GOOD = [[1000.0, 0.1], [1000.0, 0.1], [1000.0, 0.1]]


@pytest.mark.parametrize(
    ("headings", "rows", "words"),
    [
        ("speed [rpm],probe 1 [m]", GOOD, r"probe 1 \[m\].*units rad, deg"),
        ("speed [km/h],probe 1 [rad]", GOOD, r"units rpm, rad/s, Hz"),
        ("pace,probe 1 [rad]", GOOD, r"speed \[rpm\]"),
        ("speed [rpm],probe 1 [rad]", GOOD[:1], r"speed \[rpm\]"),
        ("speed [rpm],probe 1 [rad]", [[0.0, 0.1]] * 3, r"numbers > 0"),
        ("speed [rpm],what", GOOD, r"column 'revolution'"),
        (
            "revolution,speed [rpm],probe 1 [rad]",
            [[2, 9.0, 0.1], [1, 9.0, 0.1]],
            r"increasing whole",
        ),
        ("speed [rpm],probe 1 [rad]", [[1000.0, 0.1], [1.0]], r"table of numbers"),
        ("speed [rpm],probe 1 [rad]", [[1000.0, None]] * 3, r"finite"),
    ],
)
def test_bad_records(headings: str, rows: list[Any], words: str, tmp_path: Path) -> None:
    """One line that says what is wrong."""
    path = written(tmp_path / "record.csv", headings, rows)
    with pytest.raises(fc.InputError, match=words):
        fc.read_record(path, tip_radius=0.5)


def test_no_radius_and_other_probes(tmp_path: Path) -> None:
    """Both are named."""
    path = written(tmp_path / "record.csv", "speed [rpm],probe 1 [rad]", GOOD)
    with pytest.raises(fc.InputError, match=r"^tip_radius"):
        fc.read_record(path)
    with pytest.raises(fc.InputError, match=r"^probes"):
        fc.read_record(path, tip_radius=0.5, probes=[0.1, 0.2])


# --- the command ----------------------------------------------------------------------------------


def test_a_record_from_the_shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its resonances, in doubt or not, a table and a picture; keys that a record has no use for."""
    words = ["timing", str(RECORD), "--output", str(tmp_path)]
    radius = ["--set", "tip_timing.tip_radius=0.164", "--set", "tip_timing.orders=[6,7,8]"]
    assert main([*words, *radius]) == 0
    told = capsys.readouterr()
    assert "1 blade, 2843 revolutions, 3 probes" in told.err
    assert "fits of steady vibrations would be off by 0." in told.err
    rows = (tmp_path / "timing.csv").read_text().splitlines()
    assert rows[0].startswith("blade,rpm,order,margin,frequency [Hz]") and len(rows) > 3
    assert rows[1].split(",")[2] == "8.0" and (tmp_path / "timing.png").stat().st_size > 1000
    for more, error in (
        ([], "tip_radius = None: must be given for"),
        (["--set", "crack.length=1"], "crack.length = 1: must be left out with a record"),
        (["--set", "tip_timing.orders=[0]"], "tip_timing.orders = [0]: must be a list of"),
    ):
        assert main([*words, *more]) == 2
        assert error in capsys.readouterr().err
