"""`plot` with several results: axes, labels by what their scenes differ in; the mesh of a scene."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS
from surroundings import main

import fenics_crack as fc
from fenics_crack.cli import pictures
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.words import differences, key_in_words, value_in_words

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
    real = pictures.draw_waves

    def recorded(waves: Any, **how: Any) -> Any:
        drawn[how["path"].name] = waves
        return real(waves, **how)

    monkeypatch.setattr(pictures, "draw_waves", recorded)
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


def test_curves_and_sweeps(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Labels that are given; the curves of both on one panel."""
    panels: list[Any] = []

    def kept(drawn: Any) -> None:
        panels.extend(panel for panel in drawn if panel not in panels)

    monkeypatch.setattr(pictures.Picture, "saved", kept)
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
        ([one, two, "--show"], "--show = "),
        ([one, SCENE], "path = "),
    ):
        assert main(["plot", *words, "--output", str(tmp_path)]) == 2
        assert capsys.readouterr().err.startswith(f"fenics-crack: {expected}")
    assert not list(tmp_path.iterdir())


def test_mesh_of_a_scene(tmp_path: Path) -> None:
    """From the scene alone."""
    assert main(["plot", SCENE, "--output", str(tmp_path), "--quiet"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.png"]


def test_lines_and_maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two axes: few values of the second make lines, many a map, some both; words on the axes."""
    drawn: list[tuple[str, dict[str, Any]]] = []
    for name in ("draw_map", "draw_response"):
        monkeypatch.setattr(pictures, name, lambda *a, name=name, **how: drawn.append((name, how)))
    for count, expected in (
        (3, ["draw_response"]),
        (5, ["draw_response", "draw_map"]),
        (8, ["draw_map"]),
    ):
        drawn.clear()
        lengths = tuple(0.02 + 0.002 * n for n in range(count))
        axes = Axis("excitation.frequency", (1.0, 2.0, 3.0, 4.0)), Axis("crack.length", lengths)
        values, doubtful = np.ones((4, count)), np.zeros((4, count), bool)
        words = "largest opening", "m"
        pictures.draw_swept(axes, values, doubtful, words, tmp_path.joinpath, "a")
        assert [name for name, _ in drawn] == expected
    assert drawn[0][1]["x_label"] == "load frequency [Hz]"
    assert drawn[0][1]["y_label"] == "crack length [mm]"


# --- keys and values in words ---------------------------------------------------------------------


def test_what_differs(paper_scene: fc.Scene) -> None:
    """Each scene with its own values, also where one is the default; units read well."""
    base = {"excitation.force_cos": (0.0, 0.0)}
    scenes = [
        paper_scene.replace(base | {"excitation.force_sin": (size, 0.0)}) for size in (5.0, 20.0)
    ]
    assert differences(scenes) == ["excitation.force_sin = 5 N", "excitation.force_sin = 20 N"]
    closed = paper_scene.replace({"crack.clearance": -2e-7})
    assert differences([paper_scene.replace({"crack.clearance": 0.0}), closed]) == [
        "crack.clearance = 0 m",
        "crack.clearance = -200 nm",
    ]
    assert differences([paper_scene, paper_scene]) == ["", ""]


def test_hertz_and_ranges(paper_scene: fc.Scene) -> None:
    """A frequency in Hz stands for both twins; ranges count where nothing else differs."""
    one, two = (
        paper_scene.replace({"excitation.frequency": f, "curve.start": f, "curve.stop": 9.0})
        for f in (300.0, 310.0)
    )
    assert differences([one, two]) == [
        "excitation.frequency = 300 Hz",
        "excitation.frequency = 310 Hz",
    ]
    ranges = [paper_scene.replace({"curve.start": at, "curve.stop": 9.0}) for at in (1.0, 2.0)]
    assert differences(ranges) == ["curve.start = 1", "curve.start = 2"]


def test_words() -> None:
    """As axes and lines are named."""
    assert key_in_words("crack.length") == "crack length"
    assert key_in_words("excitation.omega") == "load frequency"
    for key, value, words in (
        ("crack.length", 0.035, "35 mm"),
        ("excitation.omega", 4420.0, "4420 rad/s"),
        ("material.young", 2.1e11, "210 GPa"),
        ("excitation.force_sin", (0.0, 3.0), "3 N"),
        ("excitation.point", (0.1, 0.2), "[0.1, 0.2] m"),
        ("harmonic_balance.harmonics", 7, "7"),
        ("contact.law", "unilateral", "unilateral"),
        ("crack.length", None, "none"),
    ):
        assert value_in_words(key, value) == words
