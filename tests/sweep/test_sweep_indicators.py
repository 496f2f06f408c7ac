"""Indicators of the cases of a sweep: at the load, at points of the scene, and in old files."""

from __future__ import annotations

import dataclasses
import shutil
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers import ROOT, catch_error, changed
from mpi4py import MPI
from surroundings import RunCommand

import fenics_crack as fc
from fenics_crack import SweepResult, run_sweep

REDUCED = {
    "mesh.columns": 4, "reduction.method": "massless", "reduction.modes": 12,
    "contact.law": "unilateral", "contact.stiffness": None,
}  # fmt: skip


@pytest.fixture(scope="module")
def scene(paper_scene: fc.Scene) -> fc.Scene:
    """Two frequencies, two clearances."""
    sweep_axes = {"excitation.omega": [1900.0, 2000.0], "crack.clearance": [0.0, 1e-7]}
    base = paper_scene.replace({"contact.stiffness": 1e9, "damping.ratio": 0.02})
    return base.replace({"sweep.over": sweep_axes})


@pytest.fixture(scope="module")
def whole(scene: fc.Scene, tmp_path_factory: pytest.TempPathFactory) -> SweepResult:
    """Its sweep; not to be changed."""
    return run_sweep(scene, tmp_path_factory.mktemp("whole") / "sweep.h5", MPI.COMM_SELF)


def alone(case: fc.Scene) -> tuple[fc.Study, fc.PeriodicSolution]:
    """A case as a scene of its own."""
    study = fc.prepare(case.replace({"sweep": None}), MPI.COMM_SELF)
    solution = fc.solve_harmonic_balance(
        study.structure, case.excitation.omega, study.contact,
        harmonics=case.harmonic_balance.harmonics,
    )  # fmt: skip
    return study, solution


@pytest.mark.parametrize("changes", [{}, REDUCED], ids=["whole", "massless"])
def test_cases_have_the_indicators_of_their_solutions(
    scene: fc.Scene, tmp_path: Path, changes: dict[str, object]
) -> None:
    """Of the load's point in the load's direction, x, and of each point in both directions; with
    the verdict, and the multiplier to rounding."""
    scene = scene.replace(changes | {"output.points": {"corner": (0.1, 0.1), "side": (0.1, 0.05)}})
    result = run_sweep(scene, tmp_path / "sweep.h5", MPI.COMM_SELF)
    assert result.converged.all()
    names = {name.removeprefix("corner.ux.") for name in result.columns if "corner.ux." in name}
    names &= {field.name for field in dataclasses.fields(fc.Indicators)}
    assert {"amplitude", "mean_shift", "ratio_2_1", "harmonic_3"} < names
    study, solution = alone(scene.replace({"excitation.omega": 2000.0, "crack.clearance": 1e-7}))
    assert [watched_point.name for watched_point in study.watched][::2] == ["corner.ux", "side.ux"]
    for watched_point in study.watched:
        indicators = solution.indicators(watched_point.dof)
        for name in names:
            exact = pytest.approx(
                getattr(indicators, name), rel=1e-4, abs=1e-6 * indicators.harmonic_1
            )
            assert result[f"{watched_point.name}.{name}"][1, 1] == exact, name
    for name in names:
        load = result["response" if name == "amplitude" else name]
        np.testing.assert_allclose(load, result[f"corner.ux.{name}"], rtol=1e-9)
    bilinear_frequencies, stability = (
        fc.bilinear_frequencies(study.structure),
        fc.floquet(study.structure, solution),
    )
    np.testing.assert_allclose(result["omega_tied"], bilinear_frequencies.omega_tied[0], rtol=1e-9)
    bilinear_omegas = [result[f"omega_bilinear_{mode}"][1, 1] for mode in (1, 2, 3)]
    np.testing.assert_allclose(bilinear_omegas, bilinear_frequencies.omega_bilinear[:3], rtol=1e-9)
    np.testing.assert_allclose(
        result["over_open"][1], 2000.0 / bilinear_frequencies.omega_open[0], rtol=1e-9
    )
    np.testing.assert_allclose(result["closed_share"][1, 1], indicators.closed_share, atol=2e-3)
    assert result["verdict"][1, 1] == stability.verdict
    assert result["multiplier"][1, 1] == pytest.approx(abs(stability.multipliers[0]), rel=1e-6)


def test_without_verdicts(whole: SweepResult, scene: fc.Scene, tmp_path: Path) -> None:
    """All else is the same, to the bit; a file keeps the verdicts that it has."""
    plain_sweep = run_sweep(scene, tmp_path / "plain.h5", MPI.COMM_SELF, verdicts=False)
    assert np.all(whole["verdict"] != "") and np.all(plain_sweep["verdict"] == "")
    assert np.all(np.isnan(plain_sweep["multiplier"])) and not plain_sweep.not_stable.any()
    status_pairs = zip(whole["status"].flat, plain_sweep["status"].flat, strict=True)
    assert all(own_status.startswith(plain_status) for own_status, plain_status in status_pairs)
    for name in set(whole.columns) - {"verdict", "multiplier", "seconds", "status"}:
        np.testing.assert_array_equal(plain_sweep[name], whole[name], err_msg=name)
    resumed_sweep = run_sweep(scene, whole.path, MPI.COMM_SELF, verdicts=False)
    np.testing.assert_array_equal(resumed_sweep["multiplier"], whole["multiplier"])


def test_a_reduction_that_is_not_judged(scene: fc.Scene, tmp_path: Path) -> None:
    """Its error is missing, and all else is the same."""
    reduced_scene = scene.replace({"reduction.method": None, "reduction.modes": 5})
    judged_sweep, plain_sweep = (
        run_sweep(reduced_scene, tmp_path / f"{how}.h5", MPI.COMM_SELF, verdicts=False, judged=how)
        for how in (True, False)
    )
    assert np.all(judged_sweep["reduction_error"] > 0.0) and np.all(
        np.isnan(plain_sweep["reduction_error"])
    )
    for name in ("response", "ratio_2_1", "opening", "truncation_error", "omega_open_1"):
        np.testing.assert_allclose(plain_sweep[name], judged_sweep[name], rtol=1e-6, err_msg=name)


def test_natural_frequencies_alone(whole: SweepResult, scene: fc.Scene, tmp_path: Path) -> None:
    """At some places of the last axis nothing else is found; elsewhere all is the same."""
    path, options = tmp_path / "part.h5", {"verdicts": False, "natural": [1]}
    part = run_sweep(scene, path, MPI.COMM_SELF, **options)  # type: ignore[arg-type]
    assert np.all(part["status"][:, 1] == "only natural frequencies were computed")
    assert np.all(np.isnan(part["response"][:, 1])) and part.converged[:, 0].all()
    np.testing.assert_array_equal(part["omega_open_1"], whole["omega_open_1"])
    np.testing.assert_allclose(part["response"][:, 0], whole["response"][:, 0], rtol=1e-6)
    catch_error(
        lambda: run_sweep(scene, path, MPI.COMM_SELF, natural=[2]), "natural", [2], names="0 to 1"
    )


def test_cases_of_a_file_are_asked_alike(scene: fc.Scene, tmp_path: Path) -> None:
    """Where some are missing, no others than those that it was begun with have empty columns."""
    path = tmp_path / "sweep.h5"
    first_sweep = run_sweep(scene, path, MPI.COMM_SELF, judged=False)
    with h5py.File(path, "r+") as file:
        file["checksum"][0] = 0  # as of a case that was not finished
    for options, first_words in (
        ({}, "judged=False"),
        ({"verdicts": False}, "judged=False, verdicts=True"),
    ):
        catch_error(
            partial(run_sweep, scene, path, MPI.COMM_SELF, **options),
            "path",
            str(path),
            names=f"begun with {first_words}",
        )
    second_sweep = run_sweep(scene, path, MPI.COMM_SELF, judged=False)
    assert second_sweep.complete and np.all(second_sweep["verdict"] == first_sweep["verdict"])


def test_a_case_with_longer_words_is_written_again(
    whole: SweepResult, scene: fc.Scene, tmp_path: Path
) -> None:
    """Nothing of them is left behind the new ones, with which no checksum would agree."""
    path = shutil.copy(whole.path, tmp_path)
    with h5py.File(path, "r+") as file:
        file["status"][0] = b"x" * 100
    resumed_sweep = run_sweep(scene, path, MPI.COMM_SELF)
    assert resumed_sweep.complete and np.all(resumed_sweep["verdict"] == whole["verdict"])
    assert "x" not in resumed_sweep["status"].flat[0]


def test_names_words_and_units(scene: fc.Scene, tmp_path: Path) -> None:
    """What is drawn and printed, the columns of files, and units in the HDF5 file."""
    scene = scene.replace(
        {"output.points": {"tip": (0.1, 0.1)}, "output.quantities": ["amplitude", "over_open"]}
    )
    path = tmp_path / "sweep.h5"
    result = run_sweep(scene, path, MPI.COMM_SELF)
    assert result.quantities == {
        "tip.ux.amplitude": ("half peak-to-peak, x displacement of tip", "m"),
        "tip.uy.amplitude": ("half peak-to-peak, y displacement of tip", "m"),
        "over_open": ("load frequency / natural frequency, crack open", "1"),
    }
    assert {"tip.ux.amplitude [m]", "tip.uy.ratio_2_1", "omega_open [rad/s]"} <= set(
        result.table().columns
    )
    with h5py.File(path, "r") as file:
        units = {name: file[name].attrs["unit"] for name in ("tip.uy.amplitude", "omega_bilinear")}
        assert units == {"tip.uy.amplitude": "m", "omega_bilinear": "rad/s"}
        assert file["tip.uy.ratio_2_1"].attrs["about"] == "harmonic ratio 2/1"
        assert "a0, a1, b1" in file["gap"].attrs["about"]
        assert file["tip.uy.ratio_2_1"].shape == (2, 2)


def test_default_quantities(whole: SweepResult) -> None:
    """Those of the load's point and of the lips."""
    assert list(whole.quantities) == [
        "response", "ratio_2_1", "ratio_3_1", "mean_shift", "opening", "closed_share"
    ]  # fmt: skip
    assert whole.quantities["response"] == ("half peak-to-peak at the load's point", "m")


def test_file_of_an_older_version(whole: SweepResult, tmp_path: Path) -> None:
    """A file that lost a column is not read: its cases are no longer what was written."""
    path = Path(shutil.copy(whole.path, tmp_path))
    with changed(path) as open_file:
        del open_file["ratio_2_1"]
    catch_error(lambda: SweepResult.load(path), "path", str(path))


@pytest.mark.nightly
def test_verdicts_that_hang_on_modes_left_out(tmp_path: Path, run_command: RunCommand) -> None:
    """What 8 modes call stable the 18 of their reference do not, by a sweep with these; it is told,
    and of the case beside it nothing. Without verdicts, or what judges the modes, there is none."""
    coarse_settings = {
        "mesh.size": 0.02, "mesh.lip_elements": 4, "crack.length": 0.05, "reduction.modes": 8,
        "curve": None, "sweep.over": {"excitation.omega": [9050.0, 9150.0]},
        "mesh.error": False, "contact.friction_error": False,
    }  # fmt: skip
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(coarse_settings)
    messages = run_command("sweep", scene, "--output", tmp_path).err
    few_modes_sweep = fc.SweepResult.load(tmp_path / "sweep.h5")
    many_modes_sweep = run_sweep(scene.replace({"reduction.modes": 18}), comm=MPI.COMM_SELF)
    assert (
        few_modes_sweep["verdict"].tolist()
        == ["stable", "stable"]
        == [*many_modes_sweep["verdict"][1:], "stable"]
    )
    assert many_modes_sweep["verdict"][0] == "unstable"
    [(place, contradiction)] = few_modes_sweep.cases_contradicted_by_more_modes
    multiplier_text = f"largest multiplier {many_modes_sweep['multiplier'][0]:.6g}"
    assert (
        place == (0,)
        and contradiction == f"with 18 modes the orbit is unstable ({multiplier_text})"
    )
    depends = (
        "1 case or more with a verdict on stability that depends on truncated modes, the first at "
        "omega = "
    )
    assert f"{depends}9050.0: {contradiction}; raise reduction.modes" in messages
    for asked in ({"verdicts": False}, {"judged": False}):
        assert not run_sweep(scene, comm=MPI.COMM_SELF, **asked).cases_contradicted_by_more_modes
    alone_scene = scene.replace({"sweep": None, "excitation.omega": 9050.0})
    assert contradiction in run_command("solve", alone_scene, "--output", tmp_path, code=4).err
