"""The command ``timing``: arrival times of a scene, a result or a file, and what is in them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from surroundings import main
from test_any_input import TINY

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_drawn")

RADIUS = 0.2
PROBES = [10.0, 31.0, 67.0, 101.0, 148.0, 199.0, 243.0, 300.0]
TIMING = {"probes": PROBES, "tip_radius": RADIUS, "tangential": -0.5, "order": 5}
TIMING |= {"revolutions": 20, "fitted_harmonics": 3}


def written(folder: Path, changes: dict[str, Any] | None = None) -> str:
    """A scene whose crack breathes, at 0.9 of its resonance; and its file."""
    force = {"excitation.omega": 1800.0, "excitation.force_sin": [30.0, 0.0]}
    more = {f"tip_timing.{key}": value for key, value in TIMING.items()} | force
    scene = fc.Scene.from_mapping(TINY).replace(more | (changes or {}))
    file = folder / "scene.toml"
    file.write_text(scene.as_toml(), encoding="utf-8")
    return str(file)


def shown(captured: Any) -> list[dict[str, Any]]:
    """The table that was printed as JSON."""
    found: list[dict[str, Any]] = json.loads(captured.readouterr().out)
    return found


def test_arrivals_and_the_way_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a scene and of its result those of the library; from their file the same fit, and from
    that the solution's harmonics."""
    scene, out = written(tmp_path), str(tmp_path / "out")
    quiet = ["--output", out, "--quiet", "--format", "json"]
    assert main(["solve", scene, *quiet]) == 0
    capsys.readouterr()
    run = fc.load_run(tmp_path / "out" / "solution.h5")
    assert isinstance(run.result, fc.PeriodicSolution)
    wanted = fc.tip_timing(
        run.result, {run.watched_dof: -0.5}, probes=np.radians(PROBES), tip_radius=RADIUS, order=5,
        revolutions=20,
    )  # fmt: skip
    tables = []
    for source in ([], [f"{out}/solution.h5"], [f"{out}/arrivals.csv"]):
        assert main(["timing", scene, *source, *quiet]) == 0
        tables.append(shown(capsys))
        found = fc.ArrivalTimes.from_csv(tmp_path / "out" / "arrivals.csv")
        assert np.abs(found.time - wanted.time).max() < 1e-15 and found.tip_radius == RADIUS
        for name in ("arrivals.png", "timing.png", "timing.csv"):
            assert (tmp_path / "out" / name).stat().st_size > 100
            (tmp_path / "out" / name).unlink()
    assert tables[1] == tables[2]
    wave = -0.5 * run.result.coefficients_at([run.watched_dof])[:, 0]
    sizes = np.hypot(wave[1::2], wave[2::2])
    assert sizes[1] > 0.01 * sizes[0]  # it breathes
    for table in tables:
        assert [row["order"] for row in table] == [0.0, 5.0, 10.0, 15.0]
        assert [row["amplitude [m]"] for row in table[1:]] == pytest.approx(sizes, rel=1e-6)
        assert table[1]["omega [rad/s]"] == pytest.approx(1800.0, rel=1e-12)


def test_what_probes_cannot_tell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The ratio of harmonics with its error; orders that fit as well, or are hidden; a misfit;
    harmonics that are left out, of which eight probes see one number, and twelve five."""
    noise = {"tip_timing.noise": 1e-8, "tip_timing.orders": [5, 6, 7, 8]}
    scene = written(tmp_path, noise)
    exact = ["--set", "harmonic_balance.harmonics=9"]
    assert main(["timing", scene, "--output", str(tmp_path), *exact]) == 0
    folded = "warning: harmonics that are not fitted may be folded onto the fitted ones"
    assert folded in capsys.readouterr().err
    exact += ["--set", f"tip_timing.probes={sorted([*PROBES, 48.0, 122.0, 171.0, 332.0])}"]
    assert main(["timing", scene, "--output", str(tmp_path), *exact]) == 0
    told = capsys.readouterr()
    assert "arrivals of 20 revolutions, 12 probes, 360 rad/s: " in told.err
    assert "the probes measure -0.5 times the x displacement at (" in told.err
    assert "second harmonic over first: 0." in told.err and "warning" not in told.err
    assert "frequency" not in told.out and "omega [rad/s]  amplitude [m]" in told.out
    few = [f"tip_timing.{key}" for key in ("fitted_harmonics=1", "probes=[0,60,120,180,240,300]")]
    assert main(["timing", scene, "--output", str(tmp_path), "--set", few[0], "--set", few[1]]) == 0
    told = capsys.readouterr()
    assert "warning: orders that explain the arrivals as well: 7" in told.err  # 5 + 7 = 2 x 6
    assert "warning: orders that these probes cannot measure: 6" in told.err
    words = ["--set", "tip_timing.fitted_harmonics=1", "--set", "tip_timing.orders=[5]"]
    assert main(["timing", scene, "--output", str(tmp_path), *words]) == 0
    assert "harmonics are missing (tip_timing.fitted_harmonics)" in capsys.readouterr().err


def test_one_revolution_is_no_sure_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its probes see the vibration once: in doubt, and told why; so are two of twice the load's
    period. With one more revolution they see it twice, and the warning is gone."""
    scene = written(tmp_path, {"tip_timing.noise": 1e-9, "tip_timing.fitted_harmonics": 2})
    assert main(["timing", scene, "--output", str(tmp_path), "--quiet"]) == 0
    lines = (tmp_path / "arrivals.csv").read_text().splitlines()
    capsys.readouterr()
    for subharmonic, turns, once in ((1, 1, True), (1, 2, False), (2, 2, True), (2, 3, False)):
        few = tmp_path / "few.csv"
        few.write_text("\n".join(lines[: 1 + turns * len(PROBES)]) + "\n")
        words = ["--output", str(tmp_path), "--set", f"tip_timing.subharmonic={subharmonic}"]
        assert main(["timing", scene, str(few), *words]) == 0
        told = capsys.readouterr().err
        assert ("warning: no probe sees the vibration twice" in told) == once
        how: dict[str, Any] = {"harmonics": 2, "subharmonic": subharmonic}
        fit = fc.fit_order(fc.ArrivalTimes.from_csv(few), [5], **how)
        assert fit.spare > 0 and fit.seen_once == once == ("no probe sees it twice" in repr(fit))
        assert fit.in_doubt or not once


def test_doubts_of_the_vibration_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Arrivals of an orbit that is not stable, or not exact, are told to be: solved or read."""
    resonance = {"excitation.omega": 5958.0, "harmonic_balance.harmonics": 8}  # twice the breathing
    scene, out = written(tmp_path, resonance), ["--output", str(tmp_path)]
    assert main(["solve", scene, *out, "--quiet"]) == 0
    for source in ([], [str(tmp_path / "solution.h5")]):
        capsys.readouterr()
        assert main(["timing", scene, *source, *out]) == 0
        assert "warning: the orbit is unstable" in capsys.readouterr().err
    assert main(["timing", scene, str(tmp_path / "arrivals.csv"), *out]) == 0
    assert "orbit" not in capsys.readouterr().err
    assert main(["timing", written(tmp_path, {"harmonic_balance.harmonics": 1}), *out]) == 0
    assert "warning: the estimated relative error of the gap is" in capsys.readouterr().err


def test_a_result_of_another_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its arrivals are of its own scene; a warning has what differs here, but for what is
    looked at and sought."""
    scene, out = written(tmp_path), ["--output", str(tmp_path)]
    assert main(["solve", scene, *out, "--quiet"]) == 0
    other = "warning: the arrivals are those of a result with excitation.omega = 1800 rad/s; the "
    other += "vibration is sought by this scene, which has excitation.omega = 1500 rad/s"
    changed = {
        "tip_timing.order=4": False,
        'output.quantities=["opening"]': False,
        "excitation.omega=1500.0": True,
    }
    for change, warned in changed.items():
        capsys.readouterr()
        assert main(["timing", scene, str(tmp_path / "solution.h5"), *out, "--set", change]) == 0
        assert (other in " ".join(capsys.readouterr().err.split())) == warned
    assert main(["timing", scene, *out]) == 0
    assert "this scene" not in capsys.readouterr().err


def test_a_result_that_does_not_say_how_the_rotor_turns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names it, what it lacks and what to do, whatever the scene beside it has; and one
    whose order is known twice."""
    rotor = {"excitation.omega": None, "excitation.order": 5, "rotation.speed": 360.0}
    rotor |= {"rotation.hub_radius": 0.1, "tip_timing.order": None}
    steady, turning = (tmp_path / name for name in ("steady.h5", "rotor.h5"))
    out = ["--output", str(tmp_path)]
    for changes, path in (({}, steady), (rotor, turning)):
        assert main(["solve", written(tmp_path, changes), *out, "--quiet"]) == 0
        (tmp_path / "solution.h5").rename(path)
    scene = written(tmp_path, rotor)
    capsys.readouterr()
    assert main(["timing", scene, str(steady), *out]) == 2
    told = f"source = {str(steady)!r}: must be a result whose own scene has [rotation] and "
    told += "excitation.order, which this one lacks; or given with tip_timing.order, "
    assert told in capsys.readouterr().err
    assert main(["timing", scene, str(steady), *out, "--set", "tip_timing.order=5"]) == 0
    assert main(["timing", scene, str(turning), *out]) == 0
    capsys.readouterr()
    assert main(["timing", scene, str(turning), *out, "--set", "tip_timing.order=5"]) == 2
    told = f"tip_timing.order = 5: not allowed with excitation.order of {str(turning)!r}"
    assert told in capsys.readouterr().err


def test_arrivals_of_another_speed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Times in milliseconds make the rotor 1000 times slower than the scene says: that is told."""
    rotor = {"excitation.omega": None, "excitation.order": 5, "rotation.speed": 360.0}
    rotor |= {"rotation.hub_radius": 0.1, "tip_timing.order": None}
    scene, out = written(tmp_path, rotor), ["--output", str(tmp_path)]
    angle = 2.0 * np.pi * np.arange(20)[:, None] + np.radians(PROBES)
    for unit, told in ((1.0, False), (1e3, True)):
        moved = 1e-4 * np.cos(5.0 * angle) / RADIUS
        seen, marks = (angle - moved) / 360.0, 2.0 * np.pi * np.arange(21) / 360.0
        arrivals = fc.ArrivalTimes(unit * seen, unit * marks, np.radians(PROBES), RADIUS)
        arrivals.to_csv(tmp_path / "seen.csv")
        capsys.readouterr()
        assert main(["timing", scene, str(tmp_path / "seen.csv"), *out]) == 0
        remark = "the arrivals are of 0.36 rad/s, [rotation] has 360 rad/s: are they in seconds?"
        assert (remark in capsys.readouterr().err) == told


def test_a_run_up_of_another_speed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same of a run-up, in which no order is known and resonances are sought."""
    rotor = {"rotation.speed": 360.0, "rotation.hub_radius": 0.1, "tip_timing.order": None}
    rotor |= {"tip_timing.fitted_harmonics": 2}
    scene, low, rise = written(tmp_path, rotor), 300.0, 50.0
    turns = 2.0 * np.pi * np.arange(301)
    angles = turns[:-1, None] + np.radians(PROBES)
    angles = angles + 1e-5 * np.random.default_rng(1).standard_normal(angles.shape)

    def times(angle: np.ndarray) -> np.ndarray:
        """At constant acceleration."""
        return (np.sqrt(low**2 + 2.0 * rise * angle) - low) / rise

    arrivals = fc.ArrivalTimes(1e3 * times(angles), 1e3 * times(turns), np.radians(PROBES), RADIUS)
    arrivals.to_csv(tmp_path / "seen.csv")
    out = ["--output", str(tmp_path)]
    assert main(["timing", scene, str(tmp_path / "seen.csv"), *out]) == 0
    found = capsys.readouterr().err
    assert "no resonance stands out" in found
    assert "[rotation] has 360 rad/s: are they in seconds?" in found

    # Resonances that are sought have no harmonics, nor revolutions to fit together.
    for key, value in (("fitted_harmonics", 3), ("subharmonic", 2), ("fitted_revolutions", 10)):
        name, words = f"tip_timing.{key}", ["timing", scene, str(tmp_path / "seen.csv"), *out]
        assert main([*words, "--set", f"{name}={value}"]) == 2
        refused = f"{name} = {value}: not allowed with a run-up in which resonances are sought"
        assert refused in capsys.readouterr().err


def test_a_resonance_that_is_passed_in_few_revolutions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A vibration of one harmonic, whose size changes within each revolution: no second one is
    stated, and the first one is within its errors at every speed."""
    turns = 2.0 * np.pi * np.arange(101)
    targets = angle = turns[:-1, None] + np.radians(PROBES)

    def speed(angle: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(390.0**2 + (410.0**2 - 390.0**2) * angle / turns[-1]))

    def times(angle: np.ndarray) -> np.ndarray:
        return 2.0 * angle / (speed(0.0 * angle) + speed(angle))

    def wave(angle: np.ndarray) -> np.ndarray:
        return np.asarray(1e-3 / (1.0 + 1j * (speed(angle) - 403.0) / 0.8))

    for _ in range(50):
        angle = targets - (wave(angle) * np.exp(5j * angle)).real / RADIUS
    rng = np.random.default_rng(1)
    noise = 1e-8 * rng.standard_normal(targets.shape)
    arrivals = fc.ArrivalTimes(times(angle) + noise, times(turns), np.radians(PROBES), RADIUS)
    arrivals.to_csv(tmp_path / "seen.csv")
    words = [str(tmp_path / "seen.csv"), "--output", str(tmp_path), "--format", "json"]
    words += ["--set", "tip_timing.fitted_harmonics=2"]
    assert main(["timing", written(tmp_path), *words]) == 0
    told = capsys.readouterr()
    rows = json.loads(told.out)
    assert "harmonic 2: at no speed larger than its errors, at most " in told.err
    assert max(row["amplitude_error_1 [m]"] for row in rows) < 1e-4
    middles = 0.5 * (turns[1:] + turns[:-1])
    for name, sizes in (("1", np.abs(wave(middles))), ("2", 0.0 * middles)):
        off = np.array([row[f"amplitude_{name} [m]"] for row in rows]) - sizes
        scores = np.abs(off) / [row[f"amplitude_error_{name} [m]"] for row in rows]
        assert scores.max() < 4.0 and np.mean(scores > 2.0) < 0.1


def followed(folder: Path, captured: Any, changes: dict[str, Any]) -> tuple[str, fc.Run[Any]]:
    """The file of a scene under a small load, and its curve, saved as curve.h5 beside it."""
    scene = written(folder, changes | {"excitation.force_sin": [1.0, 0.0]})
    assert main(["curve", scene, "--output", str(folder), "--quiet"]) == 0
    captured.readouterr()
    return scene, fc.load_run(folder / "curve.h5")


@pytest.mark.nightly
def test_a_run_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A curve's arrivals; the known order tracked through them, largest where the curve is."""
    run_up = {"curve.start": 1500.0, "curve.stop": 2300.0, "tip_timing.revolutions": 150}
    scene, run = followed(tmp_path, capsys, run_up)
    quiet = ["--output", str(tmp_path), "--quiet", "--format", "json"]
    assert main(["timing", scene, str(tmp_path / "curve.h5"), *quiet]) == 0
    rows = shown(capsys)
    assert len(rows) == 150
    best = max(rows, key=lambda row: row["amplitude_1 [m]"])
    assert isinstance(run.result, fc.ResponseCurve)
    first = np.abs(run.result.indicators(run.watched_dof).harmonic_1)
    at = int(np.argmax(first))
    assert best["omega [rad/s]"] == pytest.approx(run.result.omega[at], rel=0.01)
    assert best["amplitude_1 [m]"] == pytest.approx(0.5 * first[at], rel=0.02)
    assert best["rpm"] == pytest.approx(best["omega [rad/s]"] / 5 * 30 / np.pi)
    words = ["--output", str(tmp_path), "--pictures", "pdf"]
    assert main(["timing", scene, str(tmp_path / "arrivals.csv"), *words]) == 0
    assert all((tmp_path / f"{name}.pdf").stat().st_size for name in ("arrivals", "timing"))
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("multiple, where it is largest  speed [rad/s]  omega [rad/s]")
    assert len(printed) == 2 + 3
    # No frequency is sought in it, which would be left aside in silence.
    sought = ["--set", "tip_timing.frequencies=[150, 400]", "--output", str(tmp_path)]
    for source in ("curve.h5", "arrivals.csv"):
        assert main(["timing", scene, str(tmp_path / source), *sought]) == 2
        told = "tip_timing.frequencies = (150.0, 400.0): not allowed with a run-up, in which "
        assert told in capsys.readouterr().err
    # Nor orders in one that is computed; in one that is measured resonances of these are.
    sought[1] = "tip_timing.orders=[4, 5]"
    assert main(["timing", scene, str(tmp_path / "curve.h5"), *sought]) == 2
    told = "tip_timing.orders = (4.0, 5.0): not allowed with a computed run-up: order 5 is "
    assert told in capsys.readouterr().err
    sought += ["--set", "tip_timing.fitted_harmonics=2"]
    assert main(["timing", scene, str(tmp_path / "arrivals.csv"), *sought]) == 0
    assert (tmp_path / "timing.csv").read_text().startswith("blade,")
    capsys.readouterr()
    # Of another order the fit is wrong by far, which may be why it does not fit.
    other = ["--set", "tip_timing.order=7", "--output", str(tmp_path)]
    assert main(["timing", scene, str(tmp_path / "arrivals.csv"), *other]) == 0
    assert "(tip_timing.fitted_revolutions), or it is not of order 7" in capsys.readouterr().err


def from_to(low: float, high: float, revolutions: int) -> str:
    """Mean speeds of the first and last of some revolutions [rad/s], in words: at constant
    acceleration W^2 is linear in the angle, and W in time."""
    speed = np.sqrt(np.linspace(low**2, high**2, revolutions + 1))
    return f"{speed[:2].mean():.6g} rad/s to {speed[-2:].mean():.6g} rad/s"


def test_a_run_up_of_few_speeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of a curve are never one speed, however near they are: amplitudes of each speed are
    the curve's, at its two ends; identify, without a rotor, asks for one speed."""
    narrow = {"curve.start": 1990.0, "curve.stop": 2000.0, "tip_timing.revolutions": 200}
    scene, curve = followed(tmp_path, capsys, narrow)
    words = [scene, str(tmp_path / "curve.h5"), "--output", str(tmp_path), "--format", "json"]
    assert main(["timing", *words]) == 0
    told = capsys.readouterr()
    rows = json.loads(told.out)
    assert from_to(398.0, 400.0, 200) in told.err and len(rows) == 200
    assert isinstance(curve.result, fc.ResponseCurve)
    sizes = 0.5 * np.abs(curve.result.indicators(curve.watched_dof).harmonic_1[[0, -1]])
    assert [rows[end]["amplitude_1 [m]"] for end in (0, -1)] == pytest.approx(sizes, rel=5e-3)
    unknown = '[identify.unknown]\n"crack.length" = { start = 0.02, stop = 0.05, count = 4 }\n'
    Path(scene).write_text(Path(scene).read_text(encoding="utf-8") + unknown, encoding="utf-8")
    assert main(["identify", scene, "--arrivals", *words[1:]]) == 2
    assert "must be those of a constant speed" in capsys.readouterr().err


@pytest.mark.parametrize("parameter", ["omega", "speed"])
def test_a_curve_at_one_speed_is_no_run_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], parameter: str
) -> None:
    """Of a rotor whose speed is given, a curve over the load's frequency is refused; one over the
    speed is a run-up between its ends."""
    turning = {
        "rotation.speed": 360.0, "rotation.hub_radius": 0.1, "excitation.omega": None,
        "excitation.order": 5, "tip_timing.order": None, "curve.parameter": parameter,
        "curve.stability": False,
    }  # fmt: skip
    factor = 1.0 if parameter == "omega" else 0.2
    ends = {"curve.start": 1797.5 * factor, "curve.stop": 1800.0 * factor}
    scene, _ = followed(tmp_path, capsys, turning | ends)
    code = main(["timing", scene, str(tmp_path / "curve.h5"), "--output", str(tmp_path)])
    told = capsys.readouterr().err
    if parameter == "omega":
        assert code == 2 and "curve.parameter = 'omega': must be 'rpm' or 'speed' for" in told
        assert "which is at 360 rad/s all along it" in told
    else:
        assert code == 0 and from_to(359.5, 360.0, 20) in told


def test_a_run_up_that_becomes_unstable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It ends at the last point before, and says so; one that is unstable at once is refused."""
    scene = written(tmp_path, {"curve.start": 1500.0, "curve.stop": 1800.0})
    out = ["--output", str(tmp_path)]
    assert main(["curve", scene, *out, "--quiet"]) == 0
    run = fc.load_run(tmp_path / "curve.h5")
    assert isinstance(run.result, fc.ResponseCurve)
    for last, code in ((len(run.result) - 3, 0), (0, 2)):
        size = np.where(np.arange(len(run.result)) > last, 2.0, 0.5).astype(complex)
        judged = replace(run, result=replace(run.result, multipliers=size))
        judged.save(tmp_path / "judged.h5")
        capsys.readouterr()
        assert main(["timing", scene, str(tmp_path / "judged.h5"), *out]) == code
        told = capsys.readouterr().err
        ends, lost = (float(f"{run.result.omega[last + one] / 5.0:.6g}") for one in (0, 1))
        if code:
            assert f"unstable at {run.result.omega[1]:.6g} rad/s" in told
            continue
        assert f"unstable at {lost:g} rad/s: the run-up ends before, at {ends:g} rad/s" in told
        arrivals = fc.ArrivalTimes.from_csv(tmp_path / "arrivals.csv")
        assert 0.99 * ends < arrivals.speed[-1] < ends


def test_a_frequency_that_follows_no_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rotor turns as [rotation] says; the frequency is found between two given ones."""
    turning = {"rotation.rpm": 2000.0, "rotation.hub_radius": 0.1, "tip_timing.order": None}
    sought = {"tip_timing.frequencies": [150.0, 400.0], "tip_timing.revolutions": 100}
    scene = written(tmp_path, turning | sought | {"tip_timing.fitted_harmonics": 2})
    words = ["--output", str(tmp_path), "--format", "json"]
    assert main(["timing", scene, *words]) == 0
    told = capsys.readouterr()
    row = json.loads(told.out)[1]
    assert row["omega [rad/s]"] == pytest.approx(1800.0, rel=1e-6)
    assert row["order"] == pytest.approx(1800.0 / (2000.0 * np.pi / 30.0), rel=1e-6)
    assert "2000 rpm" in told.err
