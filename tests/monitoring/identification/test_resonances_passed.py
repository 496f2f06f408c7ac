"""Cracks found from resonances that a rotor passes, each at a speed of its own."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catch_error
from scipy.signal import lfilter
from surroundings import RunCommand
from test_identify import SPINNING, TURN

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_drawn")

PROBES = np.radians([12.0, 47.0, 93.0, 131.0])
SURE = {"crack": 0.01, "young": 1e-3, "model": 5e-4, "clamp": 0.0, "density": 0.0}
TRUE = {"crack.length": 0.008}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the sweeps that the tests share."""
    return tmp_path_factory.mktemp("run_up")


@pytest.fixture(scope="module")
def scene() -> fc.Scene:
    """A blade whose crack the pull of its rotor opens."""
    changes = {f"identify.{name}_deviation": deviation for name, deviation in SURE.items()}
    return fc.Scene.from_text(SPINNING).replace(changes)


def natural(scene: fc.Scene, rpm: float, kind: str, mode: int = 1) -> float:
    """A natural frequency of the blade at a speed [Hz]."""
    own_scene = scene.replace({"identify": None} | TRUE)
    own_scene = own_scene.replace({"rotation.rpm": rpm}) if rpm else own_scene.without_rotation()
    bilinear_frequencies = fc.bilinear_frequencies(fc.build_structure(own_scene))
    return float(getattr(bilinear_frequencies, f"omega_{kind}")[mode - 1]) / TURN


def rows(scene: fc.Scene, quantity: str, kinds: dict[float, str]) -> fc.Measurements:
    """Natural frequencies at some speeds, to 2e-4."""
    hertz = np.array([natural(scene, rpm, kind) for rpm, kind in kinds.items()])
    columns = {"mode": [1] * len(hertz), "rpm": list(kinds)}
    return fc.Measurements.from_arrays(quantity, hertz, 2e-4 * hertz, **columns)


@pytest.mark.nightly
def test_each_at_its_own_speed(scene: fc.Scene, folder: Path) -> None:
    """Of lips open at 1500, 3000 and 4000 rpm and at rest: the length to less than the crack's own
    2.5 %. Each taken for one of 3000 rpm excludes it but the one that is."""
    speeds = dict.fromkeys((0.0, 1500.0, 3000.0, 4000.0), "open")
    measured_rows = rows(scene, "frequency_open", speeds)
    identification = fc.identify(scene, measured_rows, folder=folder)
    assert (
        identification.verdict == "crack"
        and identification.contains(TRUE)
        and identification.misfit_chi_square_and_p_value[1] > 0.5
    )
    assert identification.estimate["crack.length"] == pytest.approx(0.008, rel=0.02)
    assert identification.fit_table().rows[1][0] == "frequency_open of mode 1 at 1500 rpm"
    for row in measured_rows.rows:
        measurements = fc.Measurements(
            (fc.Measurement("frequency_open", row.value, row.deviation, 1),)
        )
        wrong_identification = fc.identify(scene, measurements, folder=folder)
        assert wrong_identification.contains(TRUE) == (row.rpm == 3000.0)


@pytest.mark.nightly
def test_a_softer_blade_than_before(scene: fc.Scene, folder: Path) -> None:
    """A modulus 1 % lower since, to 2e-5, which takes more from a slow blade than from a fast one:
    no crack, and the reason says what it is; nor where all frequencies are 0.5 % higher. A crack is
    found, too, and more surely with the temperatures."""
    speeds = (1500.0, 3000.0, 4000.0)

    def record(quantity: str, young: float, kelvin: float, kind: str = "") -> fc.Measurements:
        changes: dict[str, Any] = {"material.young": young * 2.1e11}
        blade = scene.replace(changes | ({} if kind else {"crack": None, "contact": None}))
        hertz = [_hertz(blade.replace(TRUE) if kind else blade, rpm, kind) for rpm in speeds]
        return fc.Measurements(
            tuple(
                fc.Measurement(quantity, one, 2e-5 * one, 1, rpm=rpm, temperature=kelvin)
                for one, rpm in zip(hertz, speeds, strict=True)
            )
        )

    earlier_record = record("frequency_uncracked", 1.0 / 0.99, np.nan)
    identification = fc.identify(
        scene, record("frequency_open", 1.0, np.nan) + earlier_record, folder=folder
    )
    assert identification.verdict != "crack" and "Young's modulus" in identification.reason
    [warmer] = re.findall(r"as about (\d+) K more cause", identification.reason)
    assert float(warmer) == pytest.approx(25.0, rel=0.3)
    assert identification.priors["temperature_deviation"] == 25.0
    higher = [
        replace(row, quantity="frequency_open", value=1.005 * row.value)
        for row in earlier_record.rows
    ]
    identification = fc.identify(
        scene, fc.Measurements(tuple(higher)) + earlier_record, folder=folder
    )
    assert identification.verdict != "crack"
    blind, sure_identification = (
        fc.identify(
            scene,
            record("frequency_open", 1.0, now, "open")
            + record("frequency_uncracked", 1.0 / 0.99, then),
            folder=folder,
        )
        for now, then in ((np.nan, np.nan), (45.0, 20.0))
    )
    assert (
        blind.contains(TRUE)
        and sure_identification.contains(TRUE)
        and sure_identification.verdict == "crack"
    )
    assert sure_identification.posterior.compute_deviation(0) < blind.posterior.compute_deviation(0)


def _hertz(blade: fc.Scene, rpm: float, kind: str) -> float:
    """The first natural frequency of a blade at a speed, with a crack or without [Hz]."""
    structure = fc.build_structure(blade.replace({"identify": None, "rotation.rpm": rpm}))
    if kind:
        return float(getattr(fc.bilinear_frequencies(structure), f"omega_{kind}")[0]) / TURN
    return float(fc.solve_modes(structure, 1).omega[0]) / TURN


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["open", "bilinear"])
def test_lips_at_resonances(scene: fc.Scene, folder: Path, kind: str) -> None:
    """Open at all speeds, or breathing half of the time at all: no frequency distinguishes them, so
    that both lengths are in the region; at rest the crack breathes in any case, which decides."""
    speeds = dict.fromkeys((1500.0, 3000.0, 4000.0), kind)
    identification = fc.identify(scene, rows(scene, "frequency_resonance", speeds), folder=folder)
    assert identification.verdict == "crack" and identification.contains(TRUE)
    both_rows = rows(scene, "frequency_resonance", {0.0: "bilinear"} | speeds)
    known_identification = fc.identify(scene, both_rows, folder=folder)
    assert known_identification.verdict == "crack" and known_identification.contains(TRUE)
    assert known_identification.posterior.compute_deviation(
        0
    ) < 0.7 * identification.posterior.compute_deviation(0)


def test_speeds_that_mean_nothing(scene: fc.Scene) -> None:
    """Refused: those of a load of its own frequency, of a harmonic, and below none."""
    row = fc.Measurement("frequency_open", 300.0, 0.1, 1, rpm=1500.0)
    assert row.name == "frequency_open of mode 1 at 1500 rpm"
    for changes in ({"excitation.order": None, "excitation.frequency": 250.0}, {"rotation": None}):
        catch_error(
            partial(
                row.check,
                scene.replace({"excitation.order": None, "excitation.frequency": 250.0} | changes),
            ),
            "measurements.rpm",
            1500.0,
            names=r"excitation\.order",
        )
    catch_error(
        lambda: fc.Measurement("frequency_open", 300.0, 0.1, 1, rpm=-1.0), "measurements.rpm", -1.0
    )
    catch_error(
        lambda: fc.Measurement("harmonic_1", 300.0, 0.1, frequency=250.0, rpm=100.0),
        "measurements.rpm",
        100.0,
        names="harmonic_1",
    )


def swept(scene: fc.Scene, kind: str, path: Path, orders: tuple[int, ...]) -> None:
    """Arrivals of the blade's first mode in a run-up from 2200 to 3000 rpm, its lips open or tied,
    whose frequency is that of each order where it meets it; 2 um of noise."""
    speeds = np.linspace(2200.0, 3000.0, 5) * TURN / 60.0
    diagram = fc.campbell(scene.replace({"identify": None}), speeds, 1)
    start_speed, end_speed, turns, radius = speeds[0], speeds[-1], 600, 0.5
    total = turns * TURN * 2.0 / (start_speed + end_speed)
    grid = np.linspace(0.0, total, 200_000)
    angle = start_speed * grid + 0.5 * (end_speed - start_speed) * grid**2 / total
    squared_speed = (start_speed + (end_speed - start_speed) * grid / total) ** 2
    omega = np.sqrt(
        np.interp(squared_speed, speeds**2, getattr(diagram, f"omega_{kind}")[:, 0] ** 2)
    )
    # The blade's phase in place of the time: its frequency is 1 in it.
    phase = np.concatenate([[0.0], np.cumsum(0.5 * (omega[1:] + omega[:-1]) * np.diff(grid))])
    even_phase = np.linspace(0.0, phase[-1], len(grid))
    push = sum(np.cos(order * np.interp(even_phase, phase, angle)) for order in orders)
    step, root = even_phase[1], complex(-0.002, np.sqrt(1.0 - 0.002**2))
    motion = lfilter([step], [1.0, -np.exp(root * step)], 3e-7 * push).imag / root.imag
    targets = TURN * np.arange(turns - 1)[:, None] + PROBES
    targets = targets + 4e-6 * np.random.default_rng(1).standard_normal(targets.shape)
    moved = angle + np.interp(phase, even_phase, motion) / radius
    marks = np.interp(TURN * np.arange(turns), angle, grid)
    fc.ArrivalTimes(np.interp(targets, moved, grid), marks, PROBES, radius).to_csv(path)


@pytest.mark.nightly
def test_record_of_a_run_up(scene: fc.Scene, tmp_path: Path, run_command: RunCommand) -> None:
    """From the arrivals of two run-ups, before there was a crack and now, to its length."""
    lightly: dict[str, Any] = {"damping.ratio": 0.002, "excitation.force_sin": (0.3, 0.0)}
    lightly["excitation.force_mean"] = (40.0, 0.0)  # its crack stays open
    blade = scene.replace(lightly | {"tip_timing.probes": tuple(np.degrees(PROBES))})
    (tmp_path / "blade.toml").write_text(blade.as_toml(), encoding="utf-8")
    stiff_scene = blade.replace({"material.young": 2.11e11} | TRUE)
    later_path, earlier_path = tmp_path / "now.csv", tmp_path / "before.csv"
    swept(stiff_scene, "open", later_path, (5, 6))
    swept(stiff_scene.replace({"crack": None, "contact": None}), "open", earlier_path, (6, 7))
    words = ["identify", str(tmp_path / "blade.toml"), "--output", str(tmp_path / "found")]
    process = run_command(*words, "--arrivals", str(later_path), "--before", str(earlier_path))
    used_lines = re.findall(
        r"mode 1: ([\d.]+) ± ([\d.]+) Hz, engine order (\d) at ([\d.]+) rpm", process.err
    )
    kinds = dict(zip(used_lines, ("open", "open", "bare", "bare"), strict=True))
    assert sorted(int(order) for *_, order, _ in kinds) == [5, 6, 6, 7]
    for (hertz, error, order, rpm), kind in kinds.items():
        assert float(hertz) == pytest.approx(int(order) * float(rpm) / 60.0, rel=1e-5)
        if kind == "open":
            assert float(hertz) == pytest.approx(
                natural(stiff_scene, float(rpm), kind), abs=4.0 * float(error)
            )
    assert "log Bayes factor" in process.err
    length = float(process.out.splitlines()[2].split()[1])
    assert length == pytest.approx(0.008, rel=0.1)
    # In Python.
    [fit, *other_fits] = fc.find_passages(
        fc.ArrivalTimes.from_csv(later_path), [5, 6], stiffening=0.11
    )
    measurements = fc.Measurements.from_passages([fit, *other_fits], [1, 0])
    assert [row.name for row in measurements.rows] == [
        f"frequency_resonance of mode 1 at {float(f'{fit.speed * 60.0 / TURN:.7g}'):g} rpm"
    ]
    catch_error(
        lambda: fc.Measurements.from_passages([fit, *other_fits], [1]),
        "modes",
        [1],
        names="2 passages",
    )


@pytest.mark.parametrize(
    ("rise", "reason"),
    [(0.0, "arrivals of a run-up, or"), (0.5, "a run-up through a resonance of")],
)
def test_a_record_without_a_resonance(
    scene: fc.Scene, rise: float, reason: str, tmp_path: Path, run_command: RunCommand
) -> None:
    """One of constant speed shows no natural frequency, and a run-up none without a resonance."""
    (tmp_path / "blade.toml").write_text(scene.as_toml(), encoding="utf-8")
    rows(scene, "frequency_open", {3000.0: "open"}).to_csv(tmp_path / "rows.csv")
    turns, steady = TURN * np.arange(41), str(tmp_path / "steady.csv")
    time = (turns[:-1, None] + PROBES) / 300.0, turns / 300.0
    seen_times, marks = (time_row / (1.0 + rise * time_row / time[1][-1]) for time_row in time)
    fc.ArrivalTimes(seen_times, marks, PROBES, 0.5).to_csv(steady)
    words = ["identify", str(tmp_path / "blade.toml"), str(tmp_path / "rows.csv")]
    assert "--before = 'ArrivalTimes(40 revol" in (
        error := run_command(
            *words, "--before", steady, "--output", str(tmp_path / "found"), code=2
        ).err
    )
    assert reason in error
