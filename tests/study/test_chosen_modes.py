"""One tolerance chooses the modes: of curves and sweeps, against many more modes."""

from pathlib import Path

import numpy as np
import pytest

import fenics_crack as fc
import fenics_crack.cli
from fenics_crack.study.solve import MAX_MODES_FOR_MANY_SOLUTIONS, candidate_mode_counts

COARSE = {
    "reduction": None, "mesh.size": 0.03, "mesh.lip_elements": 4, "mesh.error": False,
    "contact.friction_error": False, "curve.start": 815.0, "curve.stop": 850.0,
    "curve.stability": False, "damping.ratio": 0.01,
}  # fmt: skip
RATIO = 1.3
"""Most of a true error over the stated one."""


def new_scene() -> fc.Scene:
    """The scene of ``fenics-crack new``."""
    return fc.Scene.load(Path(fenics_crack.cli.__file__).with_name("new_scene.toml"))


def test_a_curve_has_the_modes_that_its_tolerance_takes() -> None:
    """Its largest response and opening are those with four times as many, within the tolerance."""
    scene = new_scene().replace(COARSE | {"curve.start": 825.0, "curve.stop": 840.0})
    few_run = fc.curve(scene)
    kept_modes = few_run.scene.given("reduction").modes
    assert (
        kept_modes in (10, 20, 40)
        and f"; chosen for an error of 0.01: {kept_modes} modes" in few_run.status
    )
    many_run = fc.curve(scene.replace({"reduction.modes": 4 * kept_modes}))
    assert "chosen" not in many_run.status and many_run.structure.n_modes == 4 * kept_modes
    for name in ("amplitude", "opening"):
        peaks = [getattr(curve_run.indicators(), name).max() for curve_run in (few_run, many_run)]
        assert peaks[0] == pytest.approx(peaks[1], rel=RATIO * 0.01)


@pytest.mark.nightly
def test_a_curve_has_no_more_modes_than_are_chosen() -> None:
    """A tolerance that takes more is not met, and it says what helps."""
    stricter = fc.curve(new_scene().replace(COARSE | {"harmonic_balance.tolerance": 1e-4}))
    assert stricter.scene.given("reduction").modes == MAX_MODES_FOR_MANY_SOLUTIONS
    assert "was requested; what helps: reduction.modes = 80" in stricter.status


@pytest.mark.nightly
def test_each_case_of_a_sweep_meets_the_tolerance(tmp_path: Path) -> None:
    """Modes are doubled where a case needs more; its solution has those with which it was found."""
    sweep_axes = {"excitation.frequency": [600.0, 832.0]}
    scene = new_scene().replace(COARSE | {"curve": None, "sweep.over": sweep_axes})
    sweep = fc.run_sweep(scene, tmp_path / "sweep.h5")
    for name in ("residual", "truncation", "sampling"):
        assert np.all(sweep[f"{name}_error"] <= 0.01)
    assert np.all(sweep["reduction_error"] <= 0.01)
    plain_scene = scene.replace({"sweep": None})
    for index, omega in enumerate(sweep["omega"]):
        solution = sweep.solution(index)
        assert solution.amplitude() == pytest.approx(sweep["response"][index], rel=1e-9)
        modes = 4 * solution.structure.n_modes
        changes = {"excitation.omega": float(omega), "reduction.modes": modes}
        true_amplitude = fc.solve(plain_scene.replace(changes)).amplitude()
        assert sweep["response"][index] == pytest.approx(true_amplitude, rel=RATIO * 0.01)


def test_modes_that_are_given_are_kept() -> None:
    """A number of modes, harmonics, or no contact leave nothing to choose."""
    scene = new_scene().replace(COARSE)
    assert candidate_mode_counts(fc.prepare(scene, whole=True)) == [10, 20, 40, 80, 120]
    for keys in (
        {"reduction.modes": 7},
        {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 5},
        {"crack": None, "contact": None},
    ):
        assert candidate_mode_counts(fc.prepare(scene.replace(keys), whole=True)) == []
