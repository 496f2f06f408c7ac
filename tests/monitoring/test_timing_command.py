"""The command ``timing`` with measured records."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import passing_angles
from records import RECORD, sweep_record, write_table
from rotating import UNIT, strip
from surroundings import RunCommand

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_drawn")


def test_frequency_that_follows_the_speed_as_the_scene_has_it(
    tmp_path: Path, run_command: RunCommand
) -> None:
    """Fit damping by the Campbell diagram of a rotating scene."""
    table = {"probes": [0.0, 90.0], "tip_radius": 0.5, "orders": [4, 5, 6]}
    scene = strip(2.0, 100.0 / UNIT, tip_timing=table)
    stiffening = fc.campbell(scene, [90.0, 110.0], 3).stiffening(100.0, 500.0)
    record, _ = sweep_record([(500.0, 0.004, 5, 8e-6)], stiffening=stiffening)
    record.to_csv(tmp_path / "record.csv")
    run_command("timing", scene, tmp_path / "record.csv", "--output", tmp_path, "--quiet")
    [fit] = json.loads((tmp_path / "timing.json").read_text())
    assert stiffening > 0.05 and fit["stiffening"] == pytest.approx(stiffening, rel=5e-3)
    assert fit["order"] == 5 and fit["damping"] == pytest.approx(0.004, rel=5e-3)


def test_orders_that_contradict_each_other(tmp_path: Path, run_command: RunCommand) -> None:
    """Name each of two orders in the warning of the other.

    The speed turns near a resonance of order 5. Its size is that of a steady vibration, which is no
    transient of a mode, and two other orders are found within its width.
    """
    rows, min_speed, max_speed, turns = np.arange(299), 97.0, 100.52, 150
    half_time = turns * 2.0 * np.pi / (0.5 * (min_speed + max_speed))
    time_grid = np.linspace(0.0, 2.0 * half_time, 100_001)
    speed = min_speed + (max_speed - min_speed) * (1.0 - np.abs(time_grid / half_time - 1.0))
    angle = np.concatenate([[0.0], np.cumsum(0.5 * time_grid[1] * (speed[1:] + speed[:-1]))])
    ratio = speed / 100.0
    size = 2e-6 / (1.0 - ratio**2 + 2e-3j * ratio)
    motion = (size * np.exp(5j * angle)).real
    probes = np.array([0.3, 1.0, 2.2])
    targets = 2.0 * np.pi * rows[:, None] + probes
    targets = targets + 2e-5 * np.random.default_rng(1).standard_normal(targets.shape)
    times = np.interp(targets, angle + motion / 0.5, time_grid)
    marks = np.interp(2.0 * np.pi * np.arange(len(rows) + 1), angle, time_grid)
    fc.ArrivalTimes(times, marks, probes, 0.5).to_csv(tmp_path / "record.csv")
    command = ["timing", str(tmp_path / "record.csv"), "--output", str(tmp_path)]
    messages = " ".join(run_command(*command, "--set", "tip_timing.orders=[5,15,21]").err.split())
    orders = [row["order"] for row in json.loads((tmp_path / "timing.json").read_text())]
    assert orders == [15.0, 21.0]
    probes_text = "more probes distinguish them"
    for order in ("21", "15"):
        assert (
            f"rpm: orders that explain the arrivals equally well ({probes_text}): {order}"
            in messages
        )


def test_a_record_from_the_shell(tmp_path: Path, timing: RunCommand) -> None:
    """Write resonances to a table and picture, and refuse useless keys."""
    record, _ = sweep_record([(500.0, 0.002, 5, 2e-6), (692.0, 0.003, 7, 1e-6)])
    record.to_csv(tmp_path / "record.csv")
    output = timing(tmp_path / "record.csv", sets=["tip_timing.orders=[5,6,7]"])
    assert f"1 blade, {len(record)} revolutions, 4 probes" in output.err
    assert "frequencies are too high in a fast run-up" in output.err
    rows = (tmp_path / "timing.csv").read_text().splitlines()
    assert rows[0].startswith("blade,rpm,order,margin,frequency [Hz]")
    assert [row.split(",")[2] for row in rows[1:]] == ["5.0", "7.0"]
    assert (tmp_path / "timing.png").stat().st_size > 1000
    for sets, error in (
        ([], "the distance from the axis to the blade tips [m], "),
        ([], "has no column 'tip_radius [m]'; "),
        ([], "on the command line, --set tip_timing.tip_radius=0.5\n"),
        (["crack.length=1"], "crack.length = 1: not allowed with a record"),
        (["tip_timing.orders=[0]"], "tip_timing.orders = [0]: must be a list of"),
    ):
        assert error in timing(RECORD, sets=sets, code=2).err


def test_two_probes_from_the_shell(tmp_path: Path, timing: RunCommand) -> None:
    """Warn that two probes cannot test an order that fits."""
    record, _ = sweep_record([(500.0, 0.002, 5, 2e-6)])
    record.without(np.array([2, 3])).to_csv(tmp_path / "record.csv")
    output = timing(tmp_path / "record.csv", sets=["tip_timing.orders=[5,6]"])
    messages = " ".join(output.err.split())
    assert (
        "rpm: 2 probes cannot test an order: order 5 fits, but others may fit as well" in messages
    )


def test_one_blade_of_several(tmp_path: Path, timing: RunCommand, run_command: RunCommand) -> None:
    """Fit all blades or one, and with a scene ask for one."""
    rng = np.random.default_rng(1)
    probe_angles = np.radians([0.0, 90.0])
    angles = probe_angles + np.array([[0.0], [1e-3]]) + 1e-6 * rng.standard_normal((200, 2, 2))
    rows = [[2.0 * n, 955.0 + 0.5 * n, *turn.ravel()] for n, turn in enumerate(angles)]
    headings = [f"blade {blade} probe {probe} [rad]" for blade in (3, 4) for probe in (1, 2)]
    path = write_table(
        tmp_path / "record.csv", ",".join(["revolution", "speed [rpm]", *headings]), rows
    )
    table = {"probes": tuple(np.degrees(probe_angles)), "tip_radius": 0.5, "orders": [4, 5]}
    scene, blades = strip(2.0, 100.0 / UNIT, tip_timing=table), f"one of the blades in {path}: 3, 4"
    for command in (["timing", scene, path], ["identify", scene, "--arrivals", path]):
        words = [*command, "--output", tmp_path]
        assert f"is missing: give {blades}" in run_command(*words, code=2).err
        assert f"--blade = 2: must be {blades}" in run_command(*words, "--blade", 2, code=2).err
    timing(scene, path, "--blade", 4)
    arrivals = fc.ArrivalTimes.from_csv(tmp_path / "arrivals.csv")
    assert np.nanmedian(arrivals.displacement) == pytest.approx(-0.5e-3, rel=0.01)
    for options, message in (
        ([], "2 blades, 399 revolutions"),
        (["--blade", 4], "1 blade, 399 rev"),
    ):
        assert message in timing(path, *options, sets=["tip_timing.tip_radius=0.5"]).err


def test_units_of_a_record_without_a_resonance(tmp_path: Path, timing: RunCommand) -> None:
    """Report missing resonances, impossible speeds, and angles in radians."""
    angles = [0.3, 1.1, 2.9]
    rng = np.random.default_rng(1)
    rows = [[100.0 + 0.1 * n, *(angles + 1e-5 * rng.standard_normal(3))] for n in range(200)]
    names = ",".join(f"probe {place} [{{0}}]" for place in (1, 2, 3))
    radius = ["tip_timing.tip_radius=0.5"]
    range_warning = "all probes are within 2.6 degrees: are their angles in rad"
    speed_warning = "the blade tip moves at"
    for speed, unit, has_warning in (
        ("Hz", "rad", False),
        ("Hz", "deg", True),
        ("rpm", "rad", False),
    ):
        path = write_table(tmp_path / "record.csv", f"speed [{speed}]," + names.format(unit), rows)
        messages = timing(path, sets=radius).err
        assert "no resonance exceeds the scatter" in messages
        assert (range_warning in messages) == has_warning and speed_warning not in messages
    rows = [[60.0 * row[0], *row[1:]] for row in rows]
    path = write_table(tmp_path / "record.csv", "speed [Hz]," + names.format("rad"), rows)
    assert (
        f"{speed_warning} 2.07e+04 m/s; the fastest blades reach 700"
        in timing(path, sets=radius).err
    )


def test_a_record_at_constant_speed(tmp_path: Path, timing: RunCommand) -> None:
    """Find the engine order of a record, and question times in ns.

    Refuse orders that end before they begin, and probes at their median arrivals.
    """
    probes, speed, size = np.array([0.2, 0.9, 1.7, 2.4, 3.3, 4.1, 5.2]), 300.0, 8e-4
    angles = 2.0 * np.pi * np.arange(30)[:, None] + probes
    arrivals = passing_angles(angles, lambda angle: size * np.cos(4.0 * angle), 0.2)
    jitter = 1e-9 * np.random.default_rng(1).standard_normal(angles.shape)
    marks = 2.0 * np.pi * np.arange(31) / speed
    path = tmp_path / "seen.csv"
    question = (
        "the blade tip moves at 6e-08 m/s, but tips of rotors with probes move at 1 to 700 m/s"
    )
    for unit, is_questioned in ((1.0, False), (1e9, True)):
        times = unit * (arrivals / speed + jitter)
        fc.ArrivalTimes(times, unit * marks, probes, 0.2).to_csv(path)
        output = timing(path, "--format", "json", "--orders", 1, 30)
        rows = json.loads(output.out)
        assert [row["order"] for row in rows] == [0.0, 4.0, 8.0]
        assert rows[1]["amplitude [m]"] == pytest.approx(size, rel=1e-3)
        assert (question in output.err) == is_questioned
    message = "--orders = [5, 4]: must be two whole numbers with 1 <= FIRST <= LAST"
    assert message in timing(path, "--orders", 5, 4, code=2).err
    write_table(path, "speed [Hz],probe 1 [rad],probe 2 [rad]", [[50.0, 0.3, 1.1]] * 30)
    message = "tip_timing.probes is missing: must be given for a record at constant speed"
    assert message in timing(path, sets=["tip_timing.tip_radius=0.2"], code=2).err
