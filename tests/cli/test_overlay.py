"""`plot` with several curves: labels by what their scenes differ in; the mesh of a scene."""

from pathlib import Path
from typing import Any

import pytest
from helpers import DEMOS
from surroundings import main

SCENE = str(DEMOS / "paper_plate.toml")
LOADS = (50.0, 100.0)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Solutions under two loads, curves with two dampings."""
    folder = tmp_path_factory.mktemp("results")
    common = ["--set", "contact.stiffness=1e7", "--set", "damping.ratio=0.05", "--quiet"]
    for load in LOADS:
        here = ["--set", f"excitation.force_sin=[{load},0]", "--output", f"{folder}/{load:g}"]
        assert main(["solve", SCENE, *common, *here]) == 0
    for ratio in (0.05, 0.1):
        here = ["--set", f"damping.ratio={ratio}", "--output", f"{folder}/{ratio}"]
        span = ["--set", "curve.start=2000", "--set", "curve.stop=2100"]
        assert main(["curve", SCENE, *common, *span, *here]) in (0, 3)
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
    given = ["5 %", "10 %"]
    own = [f"damping.ratio = {ratio}" for ratio in ("0.05", "0.1")]
    for labels, shown in (([], own), ([w for name in given for w in ("--label", name)], given)):
        words = [*files, *labels, "--output", str(tmp_path / str(len(labels))), "--pictures", "svg"]
        assert main(["plot", *words, "--quiet"]) == 0
        [drawn] = (tmp_path / str(len(labels))).iterdir()
        text = drawn.read_text()
        assert drawn.name == "overlay_curve.svg"
        assert all(f"<!-- {label} -->" in text for label in shown)


def test_what_cannot_be_laid_over(results: Path, tmp_path: Path, capsys: Any) -> None:
    """One line says why."""
    solution = str(results / f"{LOADS[0]:g}" / "solution.h5")
    one, two = (str(results / ratio / "curve.h5") for ratio in ("0.05", "0.1"))
    for words, expected in (
        ([one, solution], "result = "),
        ([one, two, "--label", "a"], "--label = "),
        ([one, one], "result = "),
        ([one, SCENE], "path = "),
    ):
        assert main(["plot", *words, "--output", str(tmp_path)]) == 2
        assert capsys.readouterr().err.startswith(f"fenics-crack: {expected}")
    assert not list(tmp_path.iterdir())


def test_mesh_of_a_scene(tmp_path: Path) -> None:
    """From the scene alone."""
    assert main(["plot", SCENE, "--output", str(tmp_path), "--quiet"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.png"]
