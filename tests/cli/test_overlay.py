"""`plot` with several curves: labels by what their scenes differ in; the mesh of a scene."""

from pathlib import Path

import pytest
from helpers import DEMOS
from surroundings import RunCommand, main

import fenics_crack as fc

SCENE = str(DEMOS / "paper_plate.toml")
LOADS = (50.0, 100.0)
NIGHTLY = pytest.mark.nightly


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Solutions under two loads, curves with two dampings."""
    folder = tmp_path_factory.mktemp("results")
    common_options = ["--set=contact.stiffness=1e7", "--set=damping.ratio=0.05", "--quiet"]
    common_options += ["--set=contact.friction_error=false"]
    for load in LOADS:
        run_options = [
            "--set",
            f"excitation.force_sin=[{load},0]",
            "--output",
            f"{folder}/{load:g}",
        ]
        assert main(["solve", SCENE, *common_options, *run_options]) == 0
    for ratio in (0.05, 0.1):
        run_options = ["--set", f"damping.ratio={ratio}", "--output", f"{folder}/{ratio}"]
        span = ["--set", "curve.start=2000", "--set", "curve.stop=2100"]
        assert main(["curve", SCENE, *common_options, *span, *run_options]) in (0, 3)
    return folder


@pytest.mark.nightly
def test_a_scene_that_sweeps_over_one_of_its_loads(results: Path, tmp_path: Path) -> None:
    """Beside one without a sweep: a key of the sweep has a number in it, and no value there."""
    load = {"loads.1.point": "[0.05,0.1]", "loads.1.force_sin": "[1.0,0.0]"}
    load |= {"sweep.over": "{'loads.1.force_sin'=[[1.0,0.0]]}", "contact.stiffness": "1e7"}
    words = [part for key in load for part in ("--set", f"{key}={load[key]}")]
    assert main(["solve", SCENE, *words, "--output", str(tmp_path), "--quiet"]) == 0
    files = [str(tmp_path / "solution.h5"), str(results / "50" / "solution.h5")]
    assert main(["report", *files, "--output", str(tmp_path / "page.html"), "--quiet"]) == 0


def test_curves(results: Path, tmp_path: Path) -> None:
    """One picture, by labels that are given or by what differs between the scenes."""
    files = [str(results / ratio / "curve.h5") for ratio in ("0.05", "0.1")]
    given_labels = ["5 %", "10 %"]
    own_labels = [f"damping.ratio = {ratio}" for ratio in ("0.05", "0.1")]
    for labels, shown_labels in (
        ([], own_labels),
        ([w for name in given_labels for w in ("--label", name)], given_labels),
    ):
        words = [*files, *labels, "--output", str(tmp_path / str(len(labels))), "--pictures", "svg"]
        assert main(["plot", *words, "--quiet"]) == 0
        [picture_path] = (tmp_path / str(len(labels))).iterdir()
        text = picture_path.read_text()
        assert picture_path.name == "overlay_curve.svg"
        assert all(f"<!-- {label} -->" in text for label in shown_labels)


def test_what_cannot_be_laid_over(results: Path, tmp_path: Path, run_command: RunCommand) -> None:
    """One line says why."""
    solution = str(results / f"{LOADS[0]:g}" / "solution.h5")
    first_path, two = (str(results / ratio / "curve.h5") for ratio in ("0.05", "0.1"))
    for words, expected_message in (
        ([first_path, solution], "result = "),
        ([first_path, two, "--label", "a"], "--label = "),
        ([first_path, first_path], "result = "),
        ([first_path, SCENE], "path = "),
    ):
        assert run_command("plot", *words, "--output", tmp_path, code=2).err.startswith(
            f"fenics-crack: {expected_message}"
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name",
    ["paper_plate", *(pytest.param(one, marks=NIGHTLY) for one in ("bladed_disk", "solid_blade"))],
)
def test_mesh_with_a_load_of_many_harmonics(
    name: str, tmp_path: Path, run_command: RunCommand
) -> None:
    """By ``plot``, and by ``report`` of a result."""
    scene, wave = str(DEMOS / f"{name}.toml"), tmp_path / "wave.csv"
    third_component = ",0" if name.startswith("solid") else ""
    rows = ("0,5,0", "0.5,5,0", "0.5,-5,0", "1,-5,0")
    wave.write_text(
        f"t,fx,fy{third_component and ',fz'}\n"
        + "".join(f"{row}{third_component}\n" for row in rows)
    )
    changes = {
        "excitation.harmonics": [
            {"order": 3, "cos": [1.0] + [0.0] * (1 + len(third_component) // 2)}
        ]
    }
    changes |= {"excitation.wave": str(wave), "harmonic_balance.harmonics": None}
    loaded_scene = fc.Scene.load(scene, changes)
    run_command("plot", loaded_scene, "--output", tmp_path, "--quiet")
    assert (tmp_path / "mesh.png").exists()
    if scene == SCENE:
        run_command("modes", loaded_scene, "--output", tmp_path, "--quiet")
        run_command("report", tmp_path / "modes.h5", "--quiet")


def test_mesh_of_a_scene(tmp_path: Path) -> None:
    """From the scene alone."""
    assert main(["plot", SCENE, "--output", str(tmp_path), "--quiet"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.png"]
