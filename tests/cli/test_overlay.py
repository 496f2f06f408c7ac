"""`plot` with several results: axes, labels by what their scenes differ in; the mesh of a scene."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, wrap
from surroundings import main

SCENE = str(DEMOS / "paper_plate.toml")
LOADS = (50.0, 100.0, 200.0)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Solutions under three loads, two curves, sweeps with two dampings."""
    folder = tmp_path_factory.mktemp("results")
    common = ["--set", "contact.stiffness=1e7", "--set", "damping.ratio=0.05", "--quiet"]
    for load in LOADS:
        here = ["--set", f"excitation.force_sin=[{load},0]", "--output", f"{folder}/{load:g}"]
        assert main(["solve", SCENE, *common, *here]) == 0
    for ratio in (0.05, 0.1):
        here = ["--set", f"damping.ratio={ratio}", "--output", f"{folder}/{ratio}"]
        span = ["--set", "curve.start=2000", "--set", "curve.stop=2100"]
        assert main(["curve", SCENE, *common, *span, *here]) in (0, 3)
        over = ["--set", "sweep.over={'excitation.omega'=[1900.0,2000.0,2100.0]}"]
        assert main(["sweep", SCENE, *common, *over, *here]) in (0, 3)
    return folder


def test_solutions(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wave for each load, with its amplitude, under the name of the load."""
    drawn: dict[str, Any] = {}

    def recorded(draw: Callable[..., Any], waves: Any, **how: Any) -> Any:
        drawn[how["path"].name] = waves
        return draw(waves, **how)

    wrap(monkeypatch, "fenics_crack.cli.pictures.draw_waves", recorded)
    files = [str(results / f"{load:g}" / "solution.h5") for load in LOADS]
    assert main(["plot", *files, "--output", str(tmp_path), "--quiet"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "overlay_gaps.png",
        "overlay_spectrum.png",
        "overlay_waves.png",
    ]
    for file in ("overlay_waves.png", "overlay_gaps.png"):
        waves = drawn[file]
        assert [wave.label for wave in waves] == [
            f"excitation.force_sin = {load:g} N" for load in LOADS
        ]
        assert len({wave.colour for wave in waves}) == 3
        assert all(wave.time[-1] == pytest.approx(1.0) for wave in waves)
    # Without clearance the response is proportional to the load.
    sizes = [np.ptp(wave.values) for wave in drawn["overlay_waves.png"]]
    assert np.allclose(np.divide(sizes, sizes[0]), np.divide(LOADS, LOADS[0]), rtol=1e-6)


def test_a_scene_that_sweeps_over_one_of_its_loads(results: Path, tmp_path: Path) -> None:
    """Beside one without a sweep: a key of the sweep has a number in it, and no value there."""
    load = {"loads.1.point": "[0.05,0.1]", "loads.1.force_sin": "[1.0,0.0]"}
    load |= {"sweep.over": "{'loads.1.force_sin'=[[1.0,0.0]]}", "contact.stiffness": "1e7"}
    words = [part for key in load for part in ("--set", f"{key}={load[key]}")]
    assert main(["solve", SCENE, *words, "--output", str(tmp_path), "--quiet"]) == 0
    files = [str(tmp_path / "solution.h5"), str(results / "50" / "solution.h5")]
    assert main(["plot", *files, "--output", str(tmp_path), "--quiet"]) == 0


def test_curves_and_sweeps(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Labels that are given; the curves of both on one panel."""
    panels: list[Any] = []

    def kept(drawn: Any) -> None:
        panels.extend(panel for panel in drawn if panel not in panels)

    monkeypatch.setattr("fenics_crack.cli.pictures.Picture.saved", kept)
    for name in ("curve", "sweep"):
        files = [str(results / ratio / f"{name}.h5") for ratio in ("0.05", "0.1")]
        given = ["--label", "5 %", "--label", "10 %"]
        assert main(["plot", *files, *given, "--output", str(tmp_path), "--quiet"]) == 0
    assert len(panels) >= 3  # the curve; response, opening and more of the sweep
    for panel in panels:
        words = [text.get_text() for text in panel.get_legend().get_texts()]
        assert words[:2] == ["5 %", "10 %"]
    heights = [line.get_ydata() for line in panels[1].lines if len(line.get_xdata()) == 3]
    assert np.all(heights[0] > heights[1])  # less damping


def test_what_cannot_be_laid_over(results: Path, tmp_path: Path, capsys: Any) -> None:
    """One line says why."""
    one, two = (str(results / f"{load:g}" / "solution.h5") for load in LOADS[:2])
    curve, sweep = (str(results / "0.05" / f"{name}.h5") for name in ("curve", "sweep"))
    for words, expected in (
        ([one, curve], "result = "),
        ([one, sweep], "result = "),
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
