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
    """From the shell, with a scene that rotates: damping by its Campbell diagram."""
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
    """A resonance of order 5 near which the speed turns, which is no transient of a mode (its size
    is that of a steady vibration): two other orders are found within its width, and name each
    other."""
    rows, low, top, turns = np.arange(299), 97.0, 100.52, 150
    half = turns * 2.0 * np.pi / (0.5 * (low + top))
    grid = np.linspace(0.0, 2.0 * half, 100_001)
    speed = low + (top - low) * (1.0 - np.abs(grid / half - 1.0))
    angle = np.concatenate([[0.0], np.cumsum(0.5 * grid[1] * (speed[1:] + speed[:-1]))])
    ratio = speed / 100.0
    size = 2e-6 / (1.0 - ratio**2 + 2e-3j * ratio)
    motion = (size * np.exp(5j * angle)).real
    probes = np.array([0.3, 1.0, 2.2])
    targets = 2.0 * np.pi * rows[:, None] + probes
    targets = targets + 2e-5 * np.random.default_rng(1).standard_normal(targets.shape)
    seen = np.interp(targets, angle + motion / 0.5, grid)
    marks = np.interp(2.0 * np.pi * np.arange(len(rows) + 1), angle, grid)
    fc.ArrivalTimes(seen, marks, probes, 0.5).to_csv(tmp_path / "record.csv")
    words = ["timing", str(tmp_path / "record.csv"), "--output", str(tmp_path)]
    told = " ".join(run_command(*words, "--set", "tip_timing.orders=[5,15,21]").err.split())
    orders = [row["order"] for row in json.loads((tmp_path / "timing.json").read_text())]
    assert orders == [15.0, 21.0]
    for other in ("21", "15"):
        assert f"rpm: orders that explain the arrivals as well: {other}" in told


def test_a_record_from_the_shell(tmp_path: Path, timing: RunCommand) -> None:
    """Its resonances, a table and a picture; keys that a record has no use for."""
    record, _ = sweep_record([(500.0, 0.002, 5, 2e-6), (692.0, 0.003, 7, 1e-6)])
    record.to_csv(tmp_path / "record.csv")
    told = timing(tmp_path / "record.csv", sets=["tip_timing.orders=[5,6,7]"])
    assert f"1 blade, {len(record)} revolutions, 4 probes" in told.err
    assert "run-up overestimates and a run-down underestimates the frequency" in told.err
    rows = (tmp_path / "timing.csv").read_text().splitlines()
    assert rows[0].startswith("blade,rpm,order,margin,frequency [Hz]")
    assert [row.split(",")[2] for row in rows[1:]] == ["5.0", "7.0"]
    assert (tmp_path / "timing.png").stat().st_size > 1000
    for sets, error in (
        ([], "tip_radius is missing: must be given for"),
        ([], "'tip_radius [m]': distance of tips and axis in m; "),
        ([], "from the shell --set tip_timing.tip_radius=0.5\n"),
        (["crack.length=1"], "crack.length = 1: not allowed with a record"),
        (["tip_timing.orders=[0]"], "tip_timing.orders = [0]: must be a list of"),
    ):
        assert error in timing(RECORD, sets=sets, code=2).err


def test_two_probes_from_the_shell(tmp_path: Path, timing: RunCommand) -> None:
    """The order fits, which is no proof that it is the right one."""
    record, _ = sweep_record([(500.0, 0.002, 5, 2e-6)])
    record.without(np.array([2, 3])).to_csv(tmp_path / "record.csv")
    found = timing(tmp_path / "record.csv", sets=["tip_timing.orders=[5,6]"])
    told = " ".join(found.err.split())
    assert "rpm: 2 probes cannot test an order: 5 fits, and others may as well" in told


def test_one_blade_of_several(tmp_path: Path, timing: RunCommand, run_command: RunCommand) -> None:
    """A record of two blades: all of them without a scene, or the one that is given; with a scene
    the one that is given, and an error that says which there are."""
    rng = np.random.default_rng(1)
    places = np.radians([0.0, 90.0])
    angles = places + np.array([[0.0], [1e-3]]) + 1e-6 * rng.standard_normal((200, 2, 2))
    rows = [[2.0 * n, 955.0 + 0.5 * n, *turn.ravel()] for n, turn in enumerate(angles)]
    heads = [f"blade {blade} probe {probe} [rad]" for blade in (3, 4) for probe in (1, 2)]
    path = write_table(
        tmp_path / "record.csv", ",".join(["revolution", "speed [rpm]", *heads]), rows
    )
    table = {"probes": tuple(np.degrees(places)), "tip_radius": 0.5, "orders": [4, 5]}
    scene, given = strip(2.0, 100.0 / UNIT, tip_timing=table), f"one of 3, 4 in {path}"
    for command in (["timing", scene, path], ["identify", scene, "--arrivals", path]):
        words = [*command, "--output", tmp_path]
        assert f"is missing: must be given: {given}" in run_command(*words, code=2).err
        assert f"--blade = 2: must be {given}" in run_command(*words, "--blade", 2, code=2).err
    timing(scene, path, "--blade", 4)
    arrivals = fc.ArrivalTimes.from_csv(tmp_path / "arrivals.csv")
    assert np.nanmedian(arrivals.displacement) == pytest.approx(-0.5e-3, rel=0.01)
    for more, told in (([], "2 blades, 399 revolutions"), (["--blade", 4], "1 blade, 399 rev")):
        assert told in timing(path, *more, sets=["tip_timing.tip_radius=0.5"]).err


def test_units_of_a_record_without_a_resonance(tmp_path: Path, timing: RunCommand) -> None:
    """Nothing stands out, which is said; so are a tip as fast as a planet and probes in radians."""
    angles = [0.3, 1.1, 2.9]
    rng = np.random.default_rng(1)
    rows = [[100.0 + 0.1 * n, *(angles + 1e-5 * rng.standard_normal(3))] for n in range(200)]
    names = ",".join(f"probe {place} [{{0}}]" for place in (1, 2, 3))
    radius = ["tip_timing.tip_radius=0.5"]
    narrow, fast = "all probes are within 2.6 degrees: are angles in rad?", "the blade tip moves at"
    for speed, unit, doubted in (("Hz", "rad", False), ("Hz", "deg", True), ("rpm", "rad", False)):
        path = write_table(tmp_path / "record.csv", f"speed [{speed}]," + names.format(unit), rows)
        told = timing(path, sets=radius).err
        assert "no resonance stands out" in told
        assert (narrow in told) == doubted and fast not in told
    rows = [[60.0 * row[0], *row[1:]] for row in rows]
    path = write_table(tmp_path / "record.csv", "speed [Hz]," + names.format("rad"), rows)
    assert f"{fast} 2.07e+04 m/s, where the fastest have 700" in timing(path, sets=radius).err


def test_a_record_at_constant_speed(tmp_path: Path, timing: RunCommand) -> None:
    """The fit finds the engine order that is in it; times in ns are questioned. Refused are orders
    that end before they begin, and probes at their median arrivals."""
    probes, speed, size = np.array([0.2, 0.9, 1.7, 2.4, 3.3, 4.1, 5.2]), 300.0, 8e-4
    angles = 2.0 * np.pi * np.arange(30)[:, None] + probes
    arrivals = passing_angles(angles, lambda angle: size * np.cos(4.0 * angle), 0.2)
    jitter = 1e-9 * np.random.default_rng(1).standard_normal(angles.shape)
    marks = 2.0 * np.pi * np.arange(31) / speed
    path = tmp_path / "seen.csv"
    question = "the blade tip moves at 6e-08 m/s, where rotors with probes have 1 to 700: are"
    for unit, is_questioned in ((1.0, False), (1e9, True)):
        seen = unit * (arrivals / speed + jitter)
        fc.ArrivalTimes(seen, unit * marks, probes, 0.2).to_csv(path)
        told = timing(path, "--format", "json", "--orders", 1, 30)
        rows = json.loads(told.out)
        assert [row["order"] for row in rows] == [0.0, 4.0, 8.0]
        assert rows[1]["amplitude [m]"] == pytest.approx(size, rel=1e-3)
        assert (question in told.err) == is_questioned
    refused = "--orders = [5, 4]: must be whole numbers, 1 <= FIRST <= LAST"
    assert refused in timing(path, "--orders", 5, 4, code=2).err
    write_table(path, "speed [Hz],probe 1 [rad],probe 2 [rad]", [[50.0, 0.3, 1.1]] * 30)
    refused = "tip_timing.probes is missing: must be given for a record at constant speed"
    assert refused in timing(path, sets=["tip_timing.tip_radius=0.2"], code=2).err
