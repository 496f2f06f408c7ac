"""Pictures by matplotlib: on axes that are given or new, in SI units, without pyplot and VTK."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, oscillator, two_masses
from matplotlib.figure import Figure

import fenics_crack as fc

LAW = fc.UnilateralPenalty(1e9)
X = np.linspace(1.0, 2.0, 5)


@pytest.fixture(scope="module")
def plate(paper_scene: fc.Scene) -> fc.Structure:
    """Quadratic elements on a coarse grid; four pairs."""
    return fc.build_structure(
        paper_scene.replace({"mesh.order": 2, "mesh.columns": 4, "mesh.rows": 4})
    )


@pytest.fixture(scope="module")
def results(plate: fc.Structure) -> dict[str, Any]:
    """What is drawn."""
    masses = two_masses()
    curve = fc.continue_frequency(
        masses, 0.8, 1.4, fc.UnilateralPenalty(1.0), harmonics=3, stability=True
    )
    return {
        "solution": fc.solve_harmonic_balance(plate, 2000.0, LAW),
        "modes": fc.solve_modes(plate, 4),
        "curve": curve,
    }


def wave(size: float) -> fc.Wave:
    """A sine [m] over 2 ms."""
    time = np.linspace(0.0, 2e-3, 101)
    return fc.Wave(f"{size:g}", time, size * np.sin(1e3 * np.pi * time))


DRAWN: dict[str, tuple[int, Callable[..., Figure]]] = {
    "waves": (1, lambda of, **how: fc.draw_waves([wave(1e-6)], quantity="q", zero="zero", **how)),
    "laws": (1, lambda of, **how: fc.draw_laws({"penalty": LAW}, X, **how)),
    "contact map": (1, lambda of, **how: fc.draw_contact_map(of["solution"], **how)),
    "response": (1, lambda of, **how: fc.draw_response(X, {"a": X}, quantity="q", **how)),
    "map": (
        1,
        lambda of, **how: fc.draw_map(
            X, X, np.outer(X, X), x_label="x", y_label="y", value_label="v", **how
        ),
    ),
    "curve": (1, lambda of, **how: fc.draw_curve(of["curve"], 1, **how)),
    "content": (1, lambda of, **how: fc.draw_content(of["curve"], 1, **how)),
    "multipliers": (1, lambda of, **how: fc.draw_multipliers(of["curve"], points=5, **how)),
    "spectrum": (2, lambda of, **how: fc.draw_spectrum(of["solution"], **how)),
    "orbits": (2, lambda of, **how: fc.draw_orbits(of["solution"], 5, **how)),
    "modes": (2, lambda of, **how: fc.draw_modes(of["modes"], numbers=[1, 3], **how)),
}


@pytest.mark.parametrize("name", DRAWN)
def test_on_axes_that_are_given(
    name: str, results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are drawn upon, their figure is returned, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    count, draw = DRAWN[name]
    figure = Figure()
    panels = figure.subplots(1, count + 1, squeeze=False)[0]
    given = panels[:count] if count > 1 else panels[0]
    assert draw(results, axes=given, title="heading") is figure
    for panel in panels[:count]:
        assert panel.lines or panel.collections
    assert not panels[count].has_data()
    figure.savefig(tmp_path / "drawn.png")
    assert [path.name for path in tmp_path.iterdir()] == ["drawn.png"]
    with pytest.raises(fc.InputError, match="axes"):
        draw(results, axes=panels)
    with pytest.raises(fc.InputError, match="path"):
        draw(results, axes=given, path="again.png")


@pytest.mark.parametrize("name", DRAWN)
def test_on_a_new_figure(
    name: str, results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is returned; only a path makes a file, and its folder."""
    monkeypatch.chdir(tmp_path)
    count, draw = DRAWN[name]
    figure = draw(results)
    assert isinstance(figure, Figure) and not list(tmp_path.iterdir())
    assert sum(axes.get_label() != "<colorbar>" for axes in figure.axes) == count
    draw(results, path="folder/picture.png", title="heading")
    assert (tmp_path / "folder" / "picture.png").stat().st_size > 5000


def test_numbers_are_si_and_read_well() -> None:
    """A second curve on the same axes is drawn to the same scale; the unit follows the larger."""
    axes = Figure(layout="constrained").subplots()
    for size, unit, shown in ((2e-9, "nm", "1"), (2e-6, "µm", "0.001")):
        fc.draw_waves([wave(size)], quantity="closing", axes=axes)
        assert axes.get_ylabel() == f"closing [{unit}]" and axes.get_xlabel() == "time [ms]"
        assert axes.yaxis.get_major_formatter()(1e-9) == shown
        assert axes.lines[-1].get_ydata().max() == pytest.approx(size)
    axes.figure.canvas.draw()
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert "0" in labels and "1" in labels


def test_spectrum_fills_as_many_axes_as_it_is_given() -> None:
    """One without the contact force; two though nothing touches."""
    apart = fc.solve_linear(two_masses(), 1.0)
    for count in (1, 2):
        panels = Figure().subplots(count, squeeze=False)[:, 0]
        fc.draw_spectrum(apart, axes=panels)
        words = [panel.get_ylabel().replace("\n", " ") for panel in panels]
        assert (
            words
            == ["amplitude of the displacement [m]", "amplitude of the contact force [N]"][:count]
        )


def test_curves_are_told_apart(results: dict[str, Any]) -> None:
    """Two on the same axes: each with its name and colour; what both have, once in the legend."""
    curve = results["curve"]
    axes = Figure().subplots()
    for label, colour in (("first", "blue"), ("second", "green")):
        fc.draw_curve(curve, 1, axes=axes, label=label, colour=colour)
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert len(words) == len(set(words))
    assert {word.split(",")[0] for word in words} >= {"first", "second"}
    assert len({line.get_color() for line in axes.lines}) >= 2


def test_a_curve_by_long_steps_is_drawn_smoothly() -> None:
    """With solutions between those that were followed; as it is in another parameter."""
    structure, law = oscillator(0.05, 1.0), fc.UnilateralPenalty(1.0)
    long = fc.continue_frequency(structure, 0.9, 2.0, law, longest_step=0.4)
    load = fc.continue_parameter(structure, 0.9, law, "load", 1.0, 3.0, longest_step=0.4)
    counts = []
    for curve in (long, load):
        axes = Figure().subplots()
        fc.draw_curve(curve, 0, axes=axes)
        drawn = axes.lines[0].get_xdata()
        assert np.all(np.isin(curve.values, drawn))
        counts.append(len(drawn) / len(curve))
    assert counts[0] > 2.0 and counts[1] == 1.0


def test_mode_shapes_that_are_not_there(results: dict[str, Any]) -> None:
    """Their numbers begin at 1."""
    for numbers in ([], [0], [5]):
        with pytest.raises(fc.InputError, match="numbers"):
            fc.draw_modes(results["modes"], numbers=numbers)


def test_neither_pyplot_nor_vtk_is_needed() -> None:
    """Curves and mode shapes are drawn without them."""
    program = f"""
import sys
import fenics_crack as fc
plate = fc.build_structure(fc.Scene.load({str(DEMOS / "paper_plate.toml")!r}))
fc.draw_modes(fc.solve_modes(plate, 2))
fc.draw_spectrum(fc.solve_linear(plate, 2000.0))
print([name for name in ("matplotlib.pyplot", "pyvista", "vtkmodules") if name in sys.modules])
"""
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "[]"


def test_only_this_folder_draws() -> None:
    """No other one imports what pictures are made with."""
    package = DEMOS.parent / "fenics_crack"
    made_with = re.compile(r"^\s*(?:import|from) (matplotlib|pyvista|PIL|vtk)", re.M)
    users = {path for path in package.rglob("*.py") if made_with.search(path.read_text())}
    assert users and {path.parent for path in users} == {package / "draw"}
