"""Growth of cracks beside closed integrals and brute force."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.io
from helpers import ROOT, catch_error, columns_of_curve
from mpi4py import MPI
from ranks import LIMIT
from scipy.integrate import quad, simpson, trapezoid
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks
from surroundings import main

import fenics_crack as fc
from fenics_crack.fatigue.lengths import LengthPath

STRESS = 1e7
SLOW = 30.0
"""[rad/s] The strip's first resonance is at 3200, so inertia adds 1e-4; an exact orbit takes as
long as its period has oscillations of the fastest mode."""
STRIP: dict[str, Any] = {
    "geometry": {"width": 0.1, "height": 0.4, "thickness": 0.01},
    "crack": {"edge": "left", "height": 0.2, "length": 0.02},
    "material": {"young": 2e11, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.01, "modes": 5},
    "excitation": {"omega": SLOW},
    "loads": [{"edge": "top", "traction_mean": [0.0, 3 * STRESS], "traction_sin": [0.0, STRESS]}],
    "contact": {"law": "unilateral"},
    "mesh": {"layout": "graded", "order": 2, "size": 0.05, "lip_elements": 8, "grading": 20.0},
    "reduction": {"modes": 4},
    "growth": {"until": 0.035, "rate": 1e-11, "exponent": 2.0},
}
"""Pulled slowly, and never closed: R = 1/2."""


@pytest.fixture
def errors_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of the vibration are not sought, in tests of other things: half of the time."""
    monkeypatch.setattr(
        "fenics_crack.fatigue.growth._estimate_range_error_and_remarks", lambda *_: (0.0, [], ())
    )


def edge_crack(length: float) -> float:
    """K_I of unit stress in the strip (Tada, Paris and Irwin, 2.11)."""
    x = math.pi * length / 0.2
    shape = 0.752 + 2.02 * length / 0.1 + 0.37 * (1.0 - math.sin(x)) ** 3
    return math.sqrt(math.pi * length) * math.sqrt(math.tan(x) / x) * shape / math.cos(x)


def plate(**growth: Any) -> fc.Scene:
    """The plate that ``new`` writes, coarser away from the crack, with 15 harmonics; the crack
    grows from 35 to 43 mm."""
    exact = {
        "harmonic_balance.tolerance": None,
        "harmonic_balance.harmonics": 15,
        "mesh.size": 0.05,
        "reduction.modes": 8,
    }
    keys = {"until": 0.043, "rate": 6.9e-12, "exponent": 3.0} | growth
    return fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(
        exact | {"crack.length": 0.035} | {f"growth.{key}": value for key, value in keys.items()}
    )


@pytest.mark.usefixtures("errors_left_out")
def test_block_loading_of_a_strip() -> None:
    """Blocks at two slow frequencies, where K is the handbook's: the closed integral in cycles, in
    repeats, and in seconds."""
    blocks = {"frequencies": [2.0, 8.0], "cycles": [4000.0, 500.0]}
    keys = {"drive": "spectrum", "ratio_exponent": 0.5} | blocks
    scene = fc.Scene.from_mapping(STRIP).replace({f"growth.{k}": v for k, v in keys.items()})
    growth = fc.grow(scene.replace({"mesh.lip_elements": 8}), comm=MPI.COMM_SELF)
    weight = 2.0 * STRESS / 1e6 / 0.5**0.5
    exact = quad(lambda a: 1.0 / (1e-11 * (weight * edge_crack(a)) ** 2), 0.02, 0.035)[0]
    assert growth.life == pytest.approx(exact, rel=0.015)
    assert growth.repeats[-1] == pytest.approx(growth.life / 4500.0, rel=1e-12)
    life = growth.repeats[-1] * (4000.0 / 2.0 + 500.0 / 8.0)
    assert growth.time[-1] == pytest.approx(life, rel=1e-9)


@pytest.mark.nightly
@pytest.mark.usefixtures("errors_left_out", "predicted_errors")
def test_run_up_through_the_resonance(tmp_path: Path) -> None:
    """A list of frequencies as close as the half width of the resonance, with the cycles of a
    run-up, beside the integral along a curve."""
    span, rate = (760.0, 880.0), 0.5
    hertz = np.geomspace(*span, 12)
    cycles = hertz * np.gradient(hertz) / rate
    cycles[[0, -1]] *= 0.5  # at the ends half as much lies around a frequency
    levels = {"frequencies": hertz.tolist(), "cycles": cycles.tolist()}
    scene = plate(drive="spectrum", **levels, until=0.0352, life_tolerance=1.0)
    coarse = {"harmonic_balance.harmonics": 10, "reduction.modes": 20, "damping.ratio": 0.02}
    scene = scene.replace(coarse)  # of both
    growth = fc.grow(scene, comm=MPI.COMM_SELF)
    keys = {"parameter": "frequency", "start": span[0], "stop": span[1], "stability": False}
    followed = scene.replace({f"curve.{key}": value for key, value in keys.items()})
    followed = followed.replace({"output.quantities": ("delta_K_effective",)})
    curve = columns_of_curve(followed, tmp_path)
    strength, frequencies = curve["delta_K_effective"] / 1e6, curve["frequency"]
    expected_step = 6.9e-12 * trapezoid(strength**3 * frequencies / rate, frequencies)
    first_step = growth.length[1] - growth.length[0]
    assert first_step / growth.repeats[1] == pytest.approx(expected_step, rel=0.02)


def test_a_threshold_next_to_the_range_makes_the_life_unsure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within the error of the ranges: how many of the cycles make the crack grow is not known."""
    monkeypatch.setattr(
        "fenics_crack.fatigue.growth._estimate_range_error_and_remarks", lambda *_: (0.02, [], ())
    )
    blocks = {"drive": "spectrum", "frequencies": [2.0, 8.0], "cycles": [4000.0, 500.0]}
    near_threshold = {"threshold": 0.99 * 2.0 * STRESS * edge_crack(0.02), "until": 0.0201}
    scene = fc.Scene.from_mapping(STRIP)
    growth = fc.grow(
        scene.replace({f"growth.{key}": value for key, value in (blocks | near_threshold).items()}),
        comm=MPI.COMM_SELF,
    )
    assert growth.errors["vibration"] > 10.0 * 2.0 * 0.02
    assert any("the crack may grow there, or stop" in text for text in growth.remarks)


@pytest.mark.usefixtures("errors_left_out")
def test_levels_below_the_threshold_do_not_grow() -> None:
    """Of two frequencies the one far below the resonance drops out, and its cycles are for
    nothing."""
    two = {"drive": "spectrum", "frequencies": [300.0, 800.0], "cycles": [9000.0, 1000.0]}
    joint_growth = fc.grow(plate(until=0.036, threshold=1.5e6, **two), comm=MPI.COMM_SELF)
    single_growth = fc.grow(plate(until=0.036), comm=MPI.COMM_SELF)
    assert joint_growth.life == pytest.approx(10.0 * single_growth.life, rel=0.02)


@pytest.mark.usefixtures("errors_left_out")
def test_full_reversal_takes_the_open_half() -> None:
    """Closure by the lips: with m = 2 four times the cycles of lips that would pass each other."""
    loads = [{"edge": "top", "traction_sin": [0.0, STRESS]}]
    scene = fc.Scene.from_mapping(STRIP | {"loads": loads})
    growth = fc.grow(scene.replace({"growth.until": 0.03, "mesh.lip_elements": 8}))
    passing = 2.0 * STRESS / 1e6
    exact = quad(lambda a: 1.0 / (1e-11 * (passing * edge_crack(a)) ** 2), 0.02, 0.03)[0]
    assert growth.life == pytest.approx(4.0 * exact, rel=0.02)


@pytest.mark.usefixtures("errors_left_out")
def test_every_opening_makes_the_crack_grow() -> None:
    """Near a half of the resonance the tip opens twice in a period, the second time less: the rate
    is the sum over both, counted by how far each peak of K stands out. With m = 1 the ranges
    together are what K rises by in a period."""
    twice = {"excitation.frequency": 418.0, "excitation.omega": None, "damping.ratio": 0.001}
    scene = plate(until=0.0352, life_tolerance=1.0).replace(twice)
    stress_intensity = fc.stress_intensity(fc.solve(scene))
    mode_one = np.tile(np.maximum(stress_intensity.K_I[:, 0], 0.0), 3)
    peaks, peak_properties = find_peaks(mode_one, prominence=1e-9 * mode_one.max())
    middle_indices = np.flatnonzero(
        (peaks >= len(stress_intensity.time)) & (peaks < 2 * len(stress_intensity.time))
    )
    ranges = np.sort(peak_properties["prominences"][middle_indices])
    assert ranges[-2] > 0.3 * ranges[-1]
    exact = np.cbrt(np.sum(ranges**3))
    assert stress_intensity.numbers["delta_K_equivalent"][0] == pytest.approx(exact, rel=1e-9)
    rate = fc.grow(scene, comm=MPI.COMM_SELF).rate[0]
    assert rate == pytest.approx(6.9e-12 * np.sum((ranges / 1e6) ** 3), rel=1e-3)
    assert rate > 1.1 * 6.9e-12 * (stress_intensity.effective[0] / 1e6) ** 3
    linear = fc.stress_intensity(fc.solve(scene.replace({"growth.exponent": 1.0})))
    rises = np.sum(np.maximum(np.diff(mode_one[: len(stress_intensity.time) + 1]), 0.0))
    assert linear.numbers["delta_K_equivalent"][0] == pytest.approx(rises, rel=1e-6)


def test_growth_asks_for_a_law() -> None:
    """The equivalent range is that of an exponent."""
    catch_error(
        lambda: plate().replace({"growth": None, "output.quantities": ("delta_K_equivalent",)}),
        "output.quantities",
    )


@pytest.mark.nightly
def test_threshold_and_toughness(request: pytest.FixtureRequest) -> None:
    """A range below the threshold stops the crack where it is; at its toughness the plate
    breaks."""
    coarse_scene = fc.Scene.from_mapping(STRIP).replace({"mesh.lip_elements": 4})
    high = {"growth.threshold": 1e8, "mesh.error": False}
    stopped_growth = fc.grow(coarse_scene.replace(high), comm=MPI.COMM_SELF)
    assert stopped_growth.end == "arrested" and stopped_growth.length.tolist() == [0.02]
    assert stopped_growth.rate.tolist() == [0.0]
    assert stopped_growth.life == 0.0 and math.isfinite(stopped_growth.factor)
    request.getfixturevalue("errors_left_out")
    largest_range = 4.0 * STRESS * edge_crack(0.03)
    broken = fc.grow(coarse_scene.replace({"growth.toughness": largest_range}), comm=MPI.COMM_SELF)
    assert broken.end == "broken" and broken.length[-1] == pytest.approx(0.03, rel=0.02)
    assert broken.largest[-1] == pytest.approx(largest_range, rel=0.02)
    steady = {"loads.1.traction_sin": [0.0, 0.0], "harmonic_balance.harmonics": 5}
    resting_growth = fc.grow(coarse_scene.replace(steady), comm=MPI.COMM_SELF)
    assert resting_growth.end == "arrested" and resting_growth.length.tolist() == [0.02]


@pytest.fixture(scope="module")
def driven() -> fc.Growth:
    """At a fixed frequency below the first resonance."""
    return fc.grow(plate(), comm=MPI.COMM_SELF)


@pytest.mark.nightly
def test_fixed_frequency_passes_a_maximum(driven: fc.Growth) -> None:
    """The natural frequency falls to the load's and below: the response has its maximum there, and
    growth slows again."""
    assert np.all(np.diff(driven.omega_bilinear) < 0.0)
    assert np.all(np.diff(driven.cycles) > 0.0)
    top = int(np.argmax(driven.response))
    assert 0 < top < len(driven.length) - 1
    assert driven.omega_bilinear[top] == pytest.approx(driven.omega[top], rel=0.01)
    assert driven.rate[-1] < 0.9 * driven.rate.max()
    assert driven.response.max() > 3.0 * driven.response[0]


def test_brute_force_agrees(driven: fc.Growth) -> None:
    """A fresh solution at each of many lengths, and Simpson's rule between: 1 %."""
    lengths = np.linspace(0.035, 0.043, 7)
    rates = []
    for length in lengths:
        scene = plate().replace({"crack.length": float(length)})
        run = fc.solve(scene, MPI.COMM_SELF)
        rates.append(6.9e-12 * (fc.stress_intensity(run).effective[0] / 1e6) ** 3)
    assert driven.life == pytest.approx(simpson(1.0 / np.array(rates), x=lengths), rel=0.01)


@pytest.mark.usefixtures("errors_left_out")
def test_resonance_that_moves() -> None:
    """The load follows the largest response: at each length that of a curve by itself."""
    many = {"reduction.modes": 20}
    growth = fc.grow(plate(drive="resonance", until=0.04).replace(many), comm=MPI.COMM_SELF)
    assert np.all(np.diff(growth.omega) < 0.0)
    assert growth.omega == pytest.approx(growth.omega_bilinear, rel=2e-3)
    scene = plate().replace(
        many
        | {"crack.length": 0.04, "curve.parameter": "frequency", "curve.start": 795.0,
         "curve.stop": 820.0, "curve.stability": False}
    )  # fmt: skip
    peak = fc.curve(scene, MPI.COMM_SELF).result.peak()
    assert growth.omega[-1] == pytest.approx(peak.omega, rel=2e-4)
    assert growth.response[-1] == pytest.approx(peak.amplitude, rel=0.01)


def test_a_sweep_at_resonance() -> None:
    """Its cases are at their own peaks, and read again as they were."""
    scene = plate().replace(
        {"sweep.over": {"crack.length": [0.02, 0.03]}, "sweep.at_resonance": True}
    )
    sweep = fc.run_sweep(scene)
    assert np.all(sweep.converged)
    assert sweep["omega"] == pytest.approx(sweep["omega_bilinear"], rel=2e-3)
    assert sweep["omega"][1] < 0.99 * sweep["omega"][0]
    solution = sweep.solution(1)
    assert solution.omega == sweep["omega"][1]
    np.testing.assert_allclose(solution.gap_coefficients, sweep.gap(1))


@pytest.mark.parametrize(("clearance", "lips"), [(1.0, "open"), (-1.0, "tied")])
def test_resonance_of_lips_that_never_part_or_meet(
    clearance: float, lips: str, tmp_path: Path
) -> None:
    """Two masses and a stop 1 m away, or pressed on by as much: a linear response, whose peak lies
    many widths beside the bilinear frequency, where the search begins."""
    mass, stiffness = np.eye(2), 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    columns = {"gap": [[0.0], [1.0]], "force_sin": [[1.0], [0.0]]}
    for name, matrix in {"mass": mass, "stiffness": stiffness, **columns}.items():
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", np.array(matrix))
    stop = 1e6
    scene = fc.Scene.from_mapping(
        {
            "structure": {n: str(tmp_path / f"{n}.mtx") for n in ("mass", "stiffness", *columns)},
            "damping": {"ratio": 0.005},
            "excitation": {"omega": 80.0},
            "contact": {"law": "penalty", "stiffness": stop},
            "harmonic_balance": {"harmonics": 3},
            "sweep": {"at_resonance": True, "over": {"structure.clearance": [clearance]}},
        }
    )
    sweep = fc.run_sweep(scene, comm=MPI.COMM_SELF)
    assert sweep.converged.all()
    squares, shapes = np.linalg.eigh(stiffness)
    damping = shapes * (2.0 * 0.005 * np.sqrt(squares)) @ shapes.T
    contact_stiffness = np.diag([0.0, stop if lips == "tied" else 0.0])

    def response(omega: float) -> float:
        matrix = stiffness + contact_stiffness - omega**2 * mass + 1j * omega * damping
        return float(np.linalg.norm(np.linalg.solve(matrix, [1.0, 0.0])))

    first_omega = np.sqrt(np.linalg.eigvalsh(stiffness + contact_stiffness)[0])
    peak = minimize_scalar(lambda w: -response(w), bounds=(0.98 * first_omega, 1.02 * first_omega))
    assert sweep["omega"][0] == pytest.approx(peak.x, rel=2e-4)
    bilinear = sweep["omega_bilinear"][0]
    assert abs(sweep["omega"][0] / bilinear - 1.0) > 10.0 * 0.005


@pytest.mark.nightly
def test_natural_frequencies_are_of_one_mode() -> None:
    """Under a load between two modes the nearer one changes as the crack grows: the frequencies of
    a crack that grows only fall, as those of the first length's own mode do; and a spectrum of one
    frequency has the life and the error of that frequency."""
    scene = plate(until=0.05, life_tolerance=1.0)
    ends = [fc.modes(scene.replace({"crack.length": a}), 2).result.omega for a in (0.035, 0.05)]
    mean_omega = [0.5 * (omega[0] + omega[1]) for omega in ends]
    keys = {"excitation.frequency": None, "excitation.omega": 0.5 * sum(mean_omega)}
    found = fc.grow(scene.replace(keys), comm=MPI.COMM_SELF)
    assert np.all(np.diff(found.omega_open) < 0.0)
    mode_index = int(np.argmin(np.abs(ends[0] - found.omega_open[0])))
    assert found.omega_open[-1] == pytest.approx(ends[1][mode_index], rel=1e-9)
    blocks = {"drive": "spectrum", "frequencies": [keys["excitation.omega"] / (2.0 * np.pi)]}
    law = {f"growth.{key}": value for key, value in (blocks | {"cycles": [1.0]}).items()}
    law_growth = fc.grow(scene.replace(keys | law), comm=MPI.COMM_SELF)
    assert law_growth.life == pytest.approx(found.life, rel=1e-9)
    assert law_growth.errors["vibration"] == pytest.approx(found.errors["vibration"], rel=1e-6)


def test_a_load_of_nothing(tmp_path: Path) -> None:
    """It drives nothing, and can be drawn; what the mesh adds to the error is said to be left
    out."""
    law = {"until": 0.036, "life_tolerance": 1.0}
    scene = plate(**law).replace({"excitation.force_sin": [0.0, 0.0], "mesh.error": False})
    growth = fc.grow(scene, comm=MPI.COMM_SELF)
    assert growth.end == "arrested" and not growth.largest.any() and not growth.effective.any()
    assert any("mesh not included: mesh.error = false" in text for text in growth.remarks)
    figure = fc.draw_growth(replace(growth, cycles=1e8 * np.ones(1)), path=tmp_path / "growth.png")
    cycles = figure.axes[-1].xaxis
    assert cycles.get_label_text() == "10⁶ load cycles"
    assert cycles.get_major_formatter()(1e8) == "100" and not cycles.get_offset_text().get_text()


def test_uncertainty_of_the_life() -> None:
    """Constants and errors together, and each by itself."""
    scene = plate(until=0.036, rate_deviation=0.3, exponent_deviation=0.1, life_tolerance=0.5)
    growth = fc.grow(scene, comm=MPI.COMM_SELF)
    assert growth.errors["rate"] == 0.3
    strength = np.log(growth.effective / 1e6)
    assert growth.errors["exponent"] == pytest.approx(0.1 * strength.mean(), rel=0.05)
    assert growth.factor == pytest.approx(math.exp(math.hypot(*growth.errors.values())))
    assert "within a factor of" in repr(growth)
    assert growth.at(0.0) == growth.length[0] and math.isnan(growth.at(2.0 * growth.life))


# --- ranks, interruptions, refusals ---------------------------------------------------------------

GROW = """
import sys
import fenics_crack as fc
from test_growth import plate
found = fc.grow(plate(), sys.argv[1])
"""


@pytest.mark.nightly
def test_goes_on_where_it_was_killed(tmp_path: Path, driven: fc.Growth) -> None:
    """By kill -9 while it works; the same call then ends with the same numbers, and solves less."""
    words = [sys.executable, "-c", GROW, str(tmp_path)]
    environment = {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}:{ROOT / 'tests' / 'fatigue'}"}
    import os

    process = subprocess.Popen(words, env=os.environ | environment)
    file = tmp_path / "growth_1.h5"
    until = time.monotonic() + LIMIT
    n_solved = 0
    while time.monotonic() < until and n_solved < 2 and process.poll() is None:
        time.sleep(0.05)
        if file.exists():
            n_solved = int(fc.SweepResult.load(file).converged.sum())
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert n_solved >= 2
    earlier_sweep = fc.SweepResult.load(file)
    growth = fc.grow(plate(), tmp_path, MPI.COMM_SELF)
    later_sweep = fc.SweepResult.load(file)
    was_converged = earlier_sweep.converged
    np.testing.assert_array_equal(
        later_sweep["seconds"][was_converged], earlier_sweep["seconds"][was_converged]
    )
    assert growth.life == pytest.approx(driven.life, rel=1e-9)


def lives(comm: MPI.Comm) -> list[float]:
    """The life that each rank is told (collective)."""
    return comm.allgather(fc.grow(plate(), comm=comm).life)


@pytest.mark.nightly
@pytest.mark.mpi
def test_ranks_share_the_lengths(on_ranks: Callable[..., Any], driven: fc.Growth) -> None:
    """With the same result."""
    assert on_ranks(lives) == pytest.approx([driven.life] * 2, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "key", "value", "names"),
    [
        ({"growth": None}, "growth", None, None),
        ({"growth.until": 0.03}, "growth.until", 0.03, r"crack\.length = 0\.035"),
        ({"growth.until": 0.2}, "growth.until", 0.2, r"geometry\.width = 0\.1"),
        (
            {"crack.edge": None, "crack.center": 0.05, "growth.until": 0.05},
            "crack.center",
            0.05,
            None,
        ),
        ({"crack": None, "contact": None}, "command", "grow", None),
        ({"growth.drive": "noise"}, "growth.drive", "noise", "'frequency', 'resonance'"),
        ({"growth.drive": "spectrum"}, "growth.frequencies", None, None),
        ({"growth.cycles": [1.0]}, "growth.cycles", [1.0], "drive = 'frequency'"),
        (
            {"growth.drive": "spectrum", "growth.frequencies": [1.0], "growth.cycles": [1.0, 2.0]},
            "growth.cycles",
            [1.0, 2.0],
            None,
        ),
        (
            {"growth.drive": "resonance", "rotation.speed": 9.0, "rotation.hub_radius": 0.1},
            "growth.drive",
            "resonance",
            r"\[rotation\]",
        ),
    ],
)
def test_refused_by_name(changes: dict[str, Any], key: str, value: Any, names: str | None) -> None:
    """Each with its key and what is allowed."""
    catch_error(
        lambda: fc.grow(plate().replace(changes), comm=MPI.COMM_SELF), key, value, names=names
    )


SMOOTH = {
    "contact.law": "smoothed", "contact.stiffness_per_area": 1e13, "contact.sharpness": 1e7,
}  # fmt: skip


def test_resonance_needs_damping() -> None:
    """Else there is none; with a smooth law nor may it be so wide that its curve begins at 0."""
    scene = plate(drive="resonance").replace({"damping.ratio": 0.0})
    catch_error(
        lambda: fc.grow(scene, comm=MPI.COMM_SELF), names="damping", kind=fc.ConvergenceError
    )
    for ratio in (0.0, 0.5):
        scene = plate(drive="resonance").replace({"damping.ratio": ratio} | SMOOTH)
        catch_error(
            partial(fc.grow, scene, comm=MPI.COMM_SELF),
            names=rf"damping = {ratio}: .*resonance",
            kind=fc.ConvergenceError,
        )


@pytest.mark.nightly
@pytest.mark.parametrize("contact", [SMOOTH, {"contact.friction": 0.3}], ids=["smooth", "friction"])
def test_a_sweep_at_the_top_of_its_curve(contact: dict[str, Any]) -> None:
    """Where a law has no phase resonance: the peak of the curve through it."""
    scene = plate().replace(contact | {"harmonic_balance.harmonics": 5})
    swept_scene = scene.replace(
        {"sweep.over": {"crack.length": [0.03]}, "sweep.at_resonance": True}
    )
    sweep = fc.run_sweep(swept_scene, comm=MPI.COMM_SELF)
    assert sweep.converged.all()
    ends = 0.99 * sweep["omega"][0], 1.01 * sweep["omega"][0]
    keys = {"parameter": "omega", "start": ends[0], "stop": ends[1], "stability": False}
    span = {f"curve.{key}": value for key, value in keys.items()} | {"crack.length": 0.03}
    peak = fc.curve(scene.replace(span), MPI.COMM_SELF).result.peak()
    assert not peak.at_end and sweep["omega"][0] == pytest.approx(peak.omega, rel=5e-4)
    assert sweep["response"][0] == pytest.approx(peak.amplitude, rel=0.01)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Writes its files and says how long the plate lives, and what is in doubt."""
    scene = tmp_path / "plate.toml"
    scene.write_text(plate(until=0.037, life_tolerance=0.5, rate_deviation=0.2).as_toml())
    folder = tmp_path / "grown"
    assert main(["grow", str(scene), "--output", str(folder)]) == 0
    told = capsys.readouterr()
    assert "from 35 mm to 37 mm in" in told.err and "rate 0.2" in told.err
    assert "the straight crack would turn" in told.err
    header = (folder / "growth.csv").read_text().splitlines()[0]
    names = [column.partition(" [")[0] for column in header.split(",")]
    assert names[:4] == ["cycles", "time", "crack_length", "rate"]
    assert {"K_max", "delta_K_effective", "frequency_drop"} <= set(names)
    assert (folder / "growth.png").stat().st_size > 10_000
    growth, stored_growth = (
        fc.grow(fc.Scene.load(scene), folder),
        fc.Growth.load(folder / "growth.h5"),
    )
    assert stored_growth.life == growth.life and stored_growth.remarks == growth.remarks
    assert stored_growth.errors == growth.errors and stored_growth.scene == growth.scene
    drawn = tmp_path / "drawn"
    assert main(["plot", str(folder / "growth.h5"), "--output", str(drawn)]) == 0
    assert (drawn / "growth.png").read_bytes() == (folder / "growth.png").read_bytes()
    assert main(["report", str(folder / "growth.h5")]) == 0
    page = (folder / "report.html").read_text()
    assert "Growth of the crack" in page and f"{growth.life:.4g} cycles" in page
    assert "the straight crack would turn" in page and "over the load cycles; dots" in page
    capsys.readouterr()
    assert main(["grow", str(scene), "--set", "growth=none", "--output", str(folder)]) == 2
    told = capsys.readouterr().err
    assert "growth is missing: give a table [growth] with until, rate, exponent" in told


@pytest.mark.nightly
def test_a_blade_with_a_run_up_grows(tmp_path: Path) -> None:
    """The scene of ``new --blade``: its engine order and its curve over the speed are in the way of
    no error, and a length that is none is refused before anything is solved."""
    scene, folder = tmp_path / "blade.toml", tmp_path / "grown"
    assert main(["new", str(scene), "--blade", "--quiet"]) == 0
    coarse_options = ["growth.until=0.0305", "growth.rate=7e-12", "growth.exponent=3",
              "growth.life_tolerance=1", "mesh.size=0.05", "mesh.lip_elements=3",
              "mesh.error=false", "reduction.modes=4", "harmonic_balance.tolerance=none",
              "harmonic_balance.harmonics=3"]  # fmt: skip
    words = ["grow", str(scene), "--output", str(folder)]
    words += [word for change in coarse_options for word in ("--set", change)]
    assert main([*words, "--set", "growth.until=0.2"]) == 2
    assert not folder.exists() or not list(folder.glob("*.h5"))
    assert main(words) == 0
    crack_growth = fc.Growth.load(folder / "growth.h5")
    assert crack_growth.errors["vibration"] > 0.0
    assert crack_growth.scene.curve is not None and crack_growth.scene.curve.parameter == "rpm"


@pytest.mark.nightly
@pytest.mark.usefixtures("errors_left_out")
def test_a_resonance_between_two_lengths_is_seen() -> None:
    """Lengths 5 mm apart on both sides of it miss each other's spline by little."""
    law = {"until": 0.05, "rate": 1e-11, "exponent": 3.0}
    keys = {f"growth.{key}": value for key, value in law.items()}
    coarse = {"mesh.size": 0.05, "reduction.modes": 8}
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(coarse | keys)
    growth = fc.grow(scene, comm=MPI.COMM_SELF)
    changed_scene = scene.replace({"crack.length": 0.042})
    effective_range = fc.stress_intensity(fc.solve(changed_scene, MPI.COMM_SELF)).effective[0]
    assert np.interp(0.042, growth.length, growth.effective) == pytest.approx(
        effective_range, rel=0.05
    )


@pytest.mark.nightly
def test_next_to_a_fold_it_is_a_largest_response() -> None:
    """With 50 mm two vibrations are possible side by side: the one that is found is the largest on
    its part of the curve."""
    scene = plate().replace({"sweep.over": {"crack.length": [0.05]}, "sweep.at_resonance": True})
    many = {"harmonic_balance.harmonics": 20, "reduction.modes": 20}  # with 8 there is no fold
    scene = scene.replace(many)
    sweep = fc.run_sweep(scene, comm=MPI.COMM_SELF)
    span = {"parameter": "omega", "start": 4600.0, "stop": 5000.0, "stability": False}
    keys = {f"curve.{key}": value for key, value in span.items()}
    curve = fc.curve(scene.replace({"crack.length": 0.05, "sweep": None} | keys), MPI.COMM_SELF)
    size = curve.result.amplitude()
    tops = size[1:-1][(size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])]
    assert np.abs(sweep["response"][0] / tops - 1.0).min() < 0.01


def test_lengths_without_a_stable_vibration() -> None:
    """Each length of a table over lengths and levels once, of what was solved."""
    is_unstable = np.array([[False, True], [True, True], [True, False], [False, False]])
    axes = [SimpleNamespace(values=[0.01, 0.02, 0.03, 0.04]), SimpleNamespace(values=[1.0, 2.0])]
    is_converged = np.array([[True, True], [True, True], [False, True], [True, True]])
    table: Any = SimpleNamespace(axes=axes, not_stable=is_unstable, converged=is_converged)
    path = LengthPath(
        np.array(axes[0].values), {}, (table, table), np.zeros(0), plate().given("growth")
    )
    assert path.not_stable_lengths == [0.01, 0.02]


def test_drop_of_the_frequency() -> None:
    """Relative to that of the first length."""
    path: Any = SimpleNamespace(omega_bilinear=np.array([2.0, 1.5, 1.0]))
    drop = vars(fc.Growth)["frequency_drop"].fget(path)
    assert drop == pytest.approx([0.0, 0.25, 0.5], abs=1e-15)
