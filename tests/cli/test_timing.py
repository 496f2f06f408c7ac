"""The command ``timing``: arrival times of a scene, a result or a file, and what is in them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import passing_angles
from surroundings import RunCommand, main
from test_any_input import TINY

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_drawn")

RADIUS = 0.2
PROBES = [10.0, 31.0, 67.0, 101.0, 148.0, 199.0, 243.0, 300.0]
TIMING = {"probes": PROBES, "tip_radius": RADIUS, "tangential": -0.5, "order": 5}
TIMING |= {"revolutions": 20, "fitted_harmonics": 3}


ROTOR = {"rotation.speed": 360.0, "rotation.hub_radius": 0.1, "tip_timing.order": None}
TURNING = ROTOR | {"excitation.omega": None, "excitation.order": 5}


def written(folder: Path, changes: dict[str, Any] | None = None) -> Path:
    """A scene whose crack breathes, at 0.9 of its resonance; and its file."""
    force = {"excitation.omega": 1800.0, "excitation.force_sin": [30.0, 0.0]}
    timing_settings = {f"tip_timing.{key}": value for key, value in TIMING.items()} | force
    scene = fc.Scene.from_mapping(TINY).replace(timing_settings | (changes or {}))
    (folder / "scene.toml").write_text(scene.as_toml(), encoding="utf-8")
    return folder / "scene.toml"


def solved(folder: Path, changes: dict[str, Any] | None = None) -> Path:
    """A scene's file, and its solution beside it."""
    scene = written(folder, changes)
    assert main(["solve", str(scene), "--output", str(folder), "--quiet"]) == 0
    return scene


def test_arrivals_and_the_way_back(tmp_path: Path, timing: RunCommand) -> None:
    """Of a scene and of its result those of the library; from their file the same fit, and from
    that the solution's harmonics."""
    scene = solved(tmp_path)
    run = fc.load_run(tmp_path / "solution.h5")
    expected_arrivals = fc.tip_timing(
        run.result, {run.watched_dof: -0.5}, probes=np.radians(PROBES), tip_radius=RADIUS, order=5,
        revolutions=20,
    )  # fmt: skip
    wave = -0.5 * run.result.coefficients_at([run.watched_dof])[:, 0]
    sizes = np.hypot(wave[1::2], wave[2::2])
    assert sizes[1] > 0.01 * sizes[0]  # it breathes
    for source in ([], [tmp_path / "solution.h5"], [tmp_path / "arrivals.csv"]):
        table = json.loads(timing(scene, *source, "--quiet", "--format", "json").out)
        arrivals = fc.ArrivalTimes.from_csv(tmp_path / "arrivals.csv")
        assert (
            np.abs(arrivals.time - expected_arrivals.time).max() < 1e-15
            and arrivals.tip_radius == RADIUS
        )
        for name in ("arrivals.png", "timing.png", "timing.csv"):
            assert (tmp_path / name).stat().st_size > 100
            (tmp_path / name).unlink()
        assert [row["order"] for row in table] == [0.0, 5.0, 10.0, 15.0]
        assert [row["amplitude [m]"] for row in table[1:]] == pytest.approx(sizes, rel=1e-6)
        assert table[1]["omega [rad/s]"] == pytest.approx(1800.0, rel=1e-12)


def test_what_probes_cannot_tell(tmp_path: Path, timing: RunCommand) -> None:
    """The ratio of harmonics with its error; orders that fit as well, or are hidden; a misfit;
    harmonics that are left out, of which eight probes see one number, and twelve five."""
    scene = written(tmp_path, {"tip_timing.noise": 1e-8, "tip_timing.orders": [5, 6, 7, 8]})
    exact = ["harmonic_balance.harmonics=9"]
    warning_text = "warning: harmonics that are not fitted may be aliased onto the fitted ones"
    assert warning_text in timing(scene, sets=exact).err
    exact += [f"tip_timing.probes={sorted([*PROBES, 48.0, 122.0, 171.0, 332.0])}"]
    process = timing(scene, sets=exact)
    assert "arrivals of 20 revolutions, 12 probes, 360 rad/s: " in process.err
    assert "the probes measure -0.5 times the x displacement at (" in process.err
    assert "ratio of second to first harmonic: 0." in process.err and "warning" not in process.err
    assert "frequency" not in process.out and "omega [rad/s]  amplitude [m]" in process.out
    harmonics_option = "tip_timing.fitted_harmonics=1"
    process = timing(scene, sets=[harmonics_option, "tip_timing.probes=[0,60,120,180,240,300]"])
    assert "orders that explain the arrivals equally well (more probes distinguish them): 7" in (
        process.err  # 5 + 7 = 2 x 6
    )
    assert "warning: orders that probes at these angles cannot measure" in process.err
    assert "(if these are possible, use other angles): 6" in process.err
    missing_text = "more harmonics than are fitted (raise tip_timing.fitted_harmonics)"
    assert missing_text in timing(scene, sets=[harmonics_option, "tip_timing.orders=[5]"]).err


def test_one_revolution_is_no_sure_fit(tmp_path: Path, timing: RunCommand) -> None:
    """Its probes see the vibration once: in doubt, and told why; so are two of twice the load's
    period. With one more revolution they see it twice, and the warning is gone."""
    scene = written(tmp_path, {"tip_timing.noise": 1e-9, "tip_timing.fitted_harmonics": 2})
    timing(scene)
    lines, few_path = (tmp_path / "arrivals.csv").read_text().splitlines(), tmp_path / "few.csv"
    for subharmonic, turns, is_one_period in (
        (1, 1, True),
        (1, 2, False),
        (2, 2, True),
        (2, 3, False),
    ):
        few_path.write_text("\n".join(lines[: 1 + turns * len(PROBES)]) + "\n")
        messages = timing(scene, few_path, sets=[f"tip_timing.subharmonic={subharmonic}"]).err
        assert ("warning: each probe measures the vibration only once" in messages) == is_one_period
        arrivals = fc.ArrivalTimes.from_csv(few_path)
        fit = fc.fit_order(arrivals, [5], harmonics=2, subharmonic=subharmonic)
        assert fit.spare > 0 and fit.seen_once == is_one_period == (
            "each probe measures the vibration once" in repr(fit)
        )
        assert fit.in_doubt or not is_one_period


def test_doubts_of_the_vibration_itself(tmp_path: Path, timing: RunCommand) -> None:
    """Arrivals of an orbit that is not stable, or not exact, are told to be: solved or read."""
    resonance = {"excitation.omega": 5958.0, "harmonic_balance.harmonics": 8}  # twice the breathing
    scene = solved(tmp_path, resonance)
    for source in ([], [tmp_path / "solution.h5"]):
        assert "warning: the orbit is unstable" in timing(scene, *source).err
    assert "orbit" not in timing(scene, tmp_path / "arrivals.csv").err
    few_harmonics_path = written(tmp_path, {"harmonic_balance.harmonics": 1})
    assert "warning: the estimated relative error of the gap is" in timing(few_harmonics_path).err


def test_a_result_of_another_scene(tmp_path: Path, timing: RunCommand) -> None:
    """Its arrivals are of its own scene; a warning has what differs here, but for what is
    looked at and sought."""
    scene, result = solved(tmp_path), tmp_path / "solution.h5"
    warning_text = (
        "warning: the arrivals were computed with excitation.omega = 1800 rad/s, but their "
    )
    warning_text += "vibration is fitted with this scene, which has excitation.omega = 1500 rad/s"
    for change in ("tip_timing.order=4", 'output.quantities=["opening"]', "excitation.omega=1500"):
        message = " ".join(timing(scene, result, sets=[change]).err.split())
        assert (warning_text in message) == change.startswith("excitation")
    assert "this scene" not in timing(scene).err


def test_a_result_that_does_not_say_how_the_rotor_turns(tmp_path: Path, timing: RunCommand) -> None:
    """The error names it, what it lacks and what to do, whatever the scene beside it has; and one
    whose order is known twice."""
    steady, rotor_path = (tmp_path / name for name in ("steady.h5", "rotor.h5"))
    for changes, path in (({}, steady), (TURNING, rotor_path)):
        scene = solved(tmp_path, changes)
        (tmp_path / "solution.h5").rename(path)
    expected_message = f"source = {str(steady)!r}: must be a result of a scene with [rotation] and "
    expected_message += "excitation.order; for this one, give tip_timing.order, "
    assert expected_message in timing(scene, steady, code=2).err
    timing(scene, steady, sets=["tip_timing.order=5"])
    timing(scene, rotor_path)
    expected_message = (
        f"tip_timing.order = 5: not allowed with excitation.order of {str(rotor_path)!r}"
    )
    assert expected_message in timing(scene, rotor_path, sets=["tip_timing.order=5"], code=2).err


def test_arrivals_of_another_speed(tmp_path: Path, timing: RunCommand) -> None:
    """Times in milliseconds make the rotor 1000 times slower than the scene says: that is told."""
    scene, path = written(tmp_path, TURNING), tmp_path / "seen.csv"
    angle = 2.0 * np.pi * np.arange(20)[:, None] + np.radians(PROBES)
    turns = (angle - 1e-4 * np.cos(5.0 * angle) / RADIUS) / 360.0
    marks = 2.0 * np.pi * np.arange(21) / 360.0
    remark = "the arrivals are of 0.36 rad/s, but [rotation] has 360 rad/s; check that the"
    for unit in (1.0, 1e3):
        fc.ArrivalTimes(unit * turns, unit * marks, np.radians(PROBES), RADIUS).to_csv(path)
        assert (remark in timing(scene, path).err) == (unit == 1e3)


def test_a_run_up_of_another_speed(tmp_path: Path, timing: RunCommand) -> None:
    """The same of a run-up, in which no order is known and resonances are sought."""
    scene = written(tmp_path, ROTOR | {"tip_timing.fitted_harmonics": 2})
    path, start_speed, rise = tmp_path / "seen.csv", 300.0, 50.0
    turns = 2.0 * np.pi * np.arange(301)
    angles = turns[:-1, None] + np.radians(PROBES)
    angles = angles + 1e-5 * np.random.default_rng(1).standard_normal(angles.shape)
    # At constant acceleration.
    times, marks = (
        (np.sqrt(start_speed**2 + 2.0 * rise * at) - start_speed) / rise for at in (angles, turns)
    )
    fc.ArrivalTimes(1e3 * times, 1e3 * marks, np.radians(PROBES), RADIUS).to_csv(path)
    messages = timing(scene, path).err
    assert "no resonance exceeds the scatter" in messages
    assert "[rotation] has 360 rad/s; check that the arrival times are in seconds" in messages
    # Resonances that are sought have no harmonics, nor revolutions to fit together.
    for key, value in (("fitted_harmonics", 3), ("subharmonic", 2), ("fitted_revolutions", 10)):
        expected_message = (
            f"tip_timing.{key} = {value}: not allowed with a search for the resonances of"
        )
        assert (
            expected_message in timing(scene, path, sets=[f"tip_timing.{key}={value}"], code=2).err
        )


def test_a_resonance_that_is_passed_in_few_revolutions(tmp_path: Path, timing: RunCommand) -> None:
    """A vibration of one harmonic, whose size changes within each revolution: no second one is
    stated, and the first one is within its errors at every speed."""
    turns = 2.0 * np.pi * np.arange(101)
    targets = turns[:-1, None] + np.radians(PROBES)

    def speed(angle: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(390.0**2 + (410.0**2 - 390.0**2) * angle / turns[-1]))

    def times(angle: np.ndarray) -> np.ndarray:
        return 2.0 * angle / (speed(0.0 * angle) + speed(angle))

    def wave(angle: np.ndarray) -> np.ndarray:
        return np.asarray(1e-3 / (1.0 + 1j * (speed(angle) - 403.0) / 0.8))

    angle = passing_angles(targets, lambda at: (wave(at) * np.exp(5j * at)).real, RADIUS)
    rng = np.random.default_rng(1)
    noise = 1e-8 * rng.standard_normal(targets.shape)
    arrivals, path = (times(angle) + noise, times(turns)), tmp_path / "seen.csv"
    fc.ArrivalTimes(*arrivals, np.radians(PROBES), RADIUS).to_csv(path)
    two = ["tip_timing.fitted_harmonics=2"]
    process = timing(written(tmp_path), path, "--format", "json", sets=two)
    rows = json.loads(process.out)
    assert "harmonic 2: its amplitude exceeds its error at no speed, and is at most " in process.err
    assert max(row["amplitude_error_1 [m]"] for row in rows) < 1e-4
    middles = 0.5 * (turns[1:] + turns[:-1])
    for name, sizes in (("1", np.abs(wave(middles))), ("2", 0.0 * middles)):
        amplitude_errors = np.array([row[f"amplitude_{name} [m]"] for row in rows]) - sizes
        scores = np.abs(amplitude_errors) / [row[f"amplitude_error_{name} [m]"] for row in rows]
        assert scores.max() < 4.0 and np.mean(scores > 2.0) < 0.1


def followed(folder: Path, changes: dict[str, Any]) -> tuple[Path, fc.Run[Any]]:
    """The file of a scene under a small load, and its curve, saved as curve.h5 beside it."""
    scene = written(folder, changes | {"excitation.force_sin": [1.0, 0.0]})
    assert main(["curve", str(scene), "--output", str(folder), "--quiet"]) == 0
    return scene, fc.load_run(folder / "curve.h5")


@pytest.mark.nightly
def test_a_run_up(tmp_path: Path, timing: RunCommand) -> None:
    """A curve's arrivals; the known order tracked through them, largest where the curve is."""
    run_up = {"curve.start": 1500.0, "curve.stop": 2300.0, "tip_timing.revolutions": 150}
    scene, run = followed(tmp_path, run_up)
    curve, arrivals = (tmp_path / name for name in ("curve.h5", "arrivals.csv"))
    rows = json.loads(timing(scene, curve, "--quiet", "--format", "json").out)
    assert len(rows) == 150
    best_row = max(rows, key=lambda row: row["amplitude_1 [m]"])
    first_harmonic = np.abs(run.result.indicators(run.watched_dof).harmonic_1)
    peak_index = int(np.argmax(first_harmonic))
    assert best_row["omega [rad/s]"] == pytest.approx(run.result.omega[peak_index], rel=0.01)
    assert best_row["amplitude_1 [m]"] == pytest.approx(0.5 * first_harmonic[peak_index], rel=0.02)
    assert best_row["rpm"] == pytest.approx(best_row["omega [rad/s]"] / 5 * 30 / np.pi)
    printed_lines = timing(scene, arrivals, "--pictures", "pdf").out.splitlines()
    assert all((tmp_path / f"{name}.pdf").stat().st_size for name in ("arrivals", "timing"))
    assert printed_lines[0].startswith(
        "multiple, where it is largest  speed [rad/s]  omega [rad/s]"
    )
    assert len(printed_lines) == 2 + 3
    # No frequency is sought in it, which would be left aside in silence.
    expected_message = (
        "tip_timing.frequencies = (150.0, 400.0): not allowed with a run-up: an order is"
    )
    for source in (curve, arrivals):
        frequency_options = ["tip_timing.frequencies=[150, 400]"]
        assert expected_message in timing(scene, source, sets=frequency_options, code=2).err
    # Nor orders in one that is computed; in one that is measured resonances of these are.
    orders = ["tip_timing.orders=[4, 5]"]
    expected_message = (
        "tip_timing.orders = (4.0, 5.0): not allowed with a computed run-up: the order of its"
    )
    assert expected_message in timing(scene, curve, sets=orders, code=2).err
    timing(scene, arrivals, sets=[*orders, "tip_timing.fitted_harmonics=2"])
    assert (tmp_path / "timing.csv").read_text().startswith("blade,")
    # Of another order the fit is wrong by far, which may be why it does not fit.
    expected_message = "tip_timing.fitted_revolutions), or it is not of order 7"
    assert expected_message in timing(scene, arrivals, sets=["tip_timing.order=7"]).err


def from_to(low: float, high: float, revolutions: int) -> str:
    """Mean speeds of the first and last of some revolutions [rad/s], in words: at constant
    acceleration W^2 is linear in the angle, and W in time."""
    speed = np.sqrt(np.linspace(low**2, high**2, revolutions + 1))
    return f"{speed[:2].mean():.6g} rad/s to {speed[-2:].mean():.6g} rad/s"


def test_a_run_up_of_few_speeds(
    tmp_path: Path, timing: RunCommand, run_command: RunCommand
) -> None:
    """Those of a curve are never one speed, however near they are: amplitudes of each speed are
    the curve's, at its two ends; identify, without a rotor, asks for one speed."""
    narrow_settings = {"curve.start": 1990.0, "curve.stop": 2000.0, "tip_timing.revolutions": 200}
    scene, curve = followed(tmp_path, narrow_settings)
    process = timing(scene, tmp_path / "curve.h5", "--format", "json")
    rows = json.loads(process.out)
    assert from_to(398.0, 400.0, 200) in process.err and len(rows) == 200
    sizes = 0.5 * np.abs(curve.result.indicators(curve.watched_dof).harmonic_1[[0, -1]])
    assert [rows[end]["amplitude_1 [m]"] for end in (0, -1)] == pytest.approx(sizes, rel=5e-3)
    with scene.open("a", encoding="utf-8") as file:
        file.write('[identify.unknown]\n"crack.length" = [0.02, 0.03, 0.04, 0.05]\n')
    words = ["identify", scene, "--arrivals", tmp_path / "curve.h5", "--output", tmp_path]
    assert "must be recorded at constant speed" in run_command(*words, code=2).err


@pytest.mark.drawn(1)
@pytest.mark.parametrize(("parameter", "factor", "code"), [("omega", 1.0, 2), ("speed", 0.2, 0)])
def test_a_curve_at_one_speed_is_no_run_up(
    tmp_path: Path, timing: RunCommand, parameter: str, factor: float, code: int
) -> None:
    """Of a rotor whose speed is given, a curve over the load's frequency is refused; one over the
    speed is a run-up between its ends."""
    ends = {"curve.start": 1797.5 * factor, "curve.stop": 1800.0 * factor}
    curve_settings = {"curve.parameter": parameter, "curve.stability": False}
    scene, _ = followed(tmp_path, TURNING | ends | curve_settings)
    messages = timing(scene, tmp_path / "curve.h5", code=code).err
    if code:
        assert "curve.parameter = 'omega': must be 'rpm' or 'speed' for" in messages
        assert "the rotor stays at 360 rad/s" in messages
    else:
        assert from_to(359.5, 360.0, 20) in messages


def test_a_run_up_that_becomes_unstable(tmp_path: Path, timing: RunCommand) -> None:
    """It ends at the last point before, and says so; one that is unstable at once is refused."""
    scene, run = followed(tmp_path, {"curve.start": 1500.0, "curve.stop": 1800.0})
    for last_place, code in ((len(run.result) - 3, 0), (0, 2)):
        size = np.where(np.arange(len(run.result)) > last_place, 2.0, 0.5).astype(complex)
        judged_run = replace(run, result=replace(run.result, multipliers=size))
        judged_run.save(tmp_path / "judged.h5")
        messages = timing(scene, tmp_path / "judged.h5", code=code).err
        ends, lost_speed = (
            float(f"{run.result.omega[last_place + step] / 5.0:.6g}") for step in (0, 1)
        )
        if code:
            assert f"unstable at {run.result.omega[1]:.6g} rad/s" in messages
            continue
        assert (
            f"unstable at {lost_speed:g} rad/s: the computed run-up ends at {ends:g} rad/s"
            in messages
        )
        arrivals = fc.ArrivalTimes.from_csv(tmp_path / "arrivals.csv")
        assert 0.99 * ends < arrivals.speed[-1] < ends


def test_a_frequency_that_follows_no_order(tmp_path: Path, timing: RunCommand) -> None:
    """The rotor turns as [rotation] says; the frequency is found between two given ones."""
    rotor_settings = {"rotation.rpm": 2000.0, "rotation.hub_radius": 0.1, "tip_timing.order": None}
    frequency_settings = {"tip_timing.frequencies": [150.0, 400.0], "tip_timing.revolutions": 100}
    scene = written(
        tmp_path, rotor_settings | frequency_settings | {"tip_timing.fitted_harmonics": 2}
    )
    process = timing(scene, "--format", "json")
    row = json.loads(process.out)[1]
    assert row["omega [rad/s]"] == pytest.approx(1800.0, rel=1e-6)
    assert row["order"] == pytest.approx(1800.0 / (2000.0 * np.pi / 30.0), rel=1e-6)
    assert "2000 rpm" in process.err
