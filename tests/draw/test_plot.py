"""Pictures by matplotlib: on axes that are given or new, in SI units, without pyplot and VTK."""

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error, oscillator, two_masses
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

import fenics_crack as fc

LAW = fc.UnilateralPenalty(1e9)
LARGE = 0.05
"""Errors beyond it are shown with a warning."""
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
    touching_curve = fc.continue_frequency(
        oscillator(0.05, 1.0), 0.3, 2.0, fc.UnilateralPenalty(10.0), harmonics=3, stability=True
    )
    linear = fc.solve_linear(masses, 1.0)
    arrivals = fc.tip_timing(
        linear, 1, probes=[0.1, 0.5, 1.3, 3.1], tip_radius=100.0, order=6, noise=1e-4
    )
    return {
        "touching": touching_curve,
        "arrivals": arrivals,
        "fit": fc.fit_order(arrivals),
        "track": fc.track_order(arrivals, 6),
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
    "multipliers": (1, lambda of, **how: fc.draw_multipliers(of["curve"], **how)),
    "mesh": (1, lambda of, **how: fc.draw_mesh(of["solution"].structure, **how)),
    "spectrum": (2, lambda of, **how: fc.draw_spectrum(of["solution"], **how)),
    "orbits": (2, lambda of, **how: fc.draw_orbits(of["solution"], 5, **how)),
    "arrivals": (1, lambda of, **how: fc.draw_arrivals(of["arrivals"], **how)),
    "tip fit": (2, lambda of, **how: fc.draw_tip_fit(of["fit"], of["arrivals"], **how)),
    "tip track": (1, lambda of, **how: fc.draw_tip_track(of["track"], **how)),
    "modes": (2, lambda of, **how: fc.draw_modes(of["modes"], numbers=[1, 3], **how)),
}


@pytest.mark.drawn(5)
@pytest.mark.parametrize("name", DRAWN)
def test_on_axes_that_are_given(
    name: str, results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are drawn upon, their figure is returned, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    count, draw = DRAWN[name]
    figure = Figure()
    panels = figure.subplots(1, count + 1, squeeze=False)[0]
    given_axes = panels[:count] if count > 1 else panels[0]
    assert draw(results, axes=given_axes, title="heading") is figure
    for panel in panels[:count]:
        assert panel.lines or panel.collections
    assert not panels[count].has_data()
    figure.savefig(tmp_path / "drawn.png")
    assert [path.name for path in tmp_path.iterdir()] == ["drawn.png"]
    catch_error(lambda: draw(results, axes=panels), "axes", f"{count + 1} axes")
    catch_error(lambda: draw(results, axes=given_axes, path="again.png"), "path", "again.png")
    catch_error(lambda: draw(results, path="drawn.xls"), "path", "drawn.xls", names=r"\.png")


@pytest.mark.drawn(4)
@pytest.mark.parametrize("name", DRAWN)
def test_on_a_new_figure(
    name: str, results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is returned; only a path makes a file, and its folder; without a legend it has none."""
    monkeypatch.chdir(tmp_path)
    count, draw = DRAWN[name]
    figure = draw(results)
    assert isinstance(figure, Figure) and not list(tmp_path.iterdir())
    assert sum(axes.get_label() != "<colorbar>" for axes in figure.axes) == count
    bare = draw(results, legend=False)
    assert len(bare.axes) == len(figure.axes) and not any(axes.get_legend() for axes in bare.axes)
    draw(results, path="folder/picture.png", title="heading")
    assert (tmp_path / "folder" / "picture.png").stat().st_size > 5000


def test_one_order_shows_its_harmonics(results: dict[str, Any]) -> None:
    """Where no other order was tried there is none to be compared with."""
    fit = fc.fit_order(results["arrivals"], orders=[6])
    _, lower_panel = fc.draw_tip_fit(fit, results["arrivals"]).axes
    assert list(lower_panel.get_xticks()) == fit.multiples.tolist()
    assert lower_panel.get_yscale() == "log" and "order" not in lower_panel.get_xlabel()
    _, lower_panel = fc.draw_tip_fit(results["fit"], results["arrivals"]).axes
    assert "engine order" in lower_panel.get_xlabel()


def test_numbers_are_si_and_read_well() -> None:
    """A second curve on the same axes is drawn to the same scale; the unit follows the larger."""
    axes = Figure(layout="constrained").subplots()
    for size, unit, shown_text in ((2e-9, "nm", "1"), (2e-6, "µm", "0.001")):
        fc.draw_waves([wave(size)], quantity="closing", axes=axes)
        assert axes.get_ylabel() == f"closing [{unit}]" and axes.get_xlabel() == "time [ms]"
        assert axes.yaxis.get_major_formatter()(1e-9) == shown_text
        assert axes.lines[-1].get_ydata().max() == pytest.approx(size)
    axes.figure.canvas.draw()
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert "0" in labels and "1" in labels


def test_a_misspelt_keyword_is_named() -> None:
    """With those that every picture takes."""
    catch_error(
        lambda: fc.draw_spectrum(fc.solve_linear(two_masses(), 1.0), titel="x"),
        "titel",
        "x",
        names="axes, ax, path, title, legend$",
    )


def test_spectrum_fills_as_many_axes_as_it_is_given() -> None:
    """One without the contact force; two though nothing touches."""
    apart_linear_solution = fc.solve_linear(two_masses(), 1.0)
    for count in (1, 2):
        panels = Figure().subplots(count, squeeze=False)[:, 0]
        fc.draw_spectrum(apart_linear_solution, axes=panels)
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


def test_many_lines_are_all_drawn(results: dict[str, Any]) -> None:
    """More than there are colours."""
    crowded_figure = fc.draw_response(
        X, {f"case {n}": n * X for n in range(1, 21)}, quantity="amplitude"
    )
    laws = fc.draw_laws({f"law {n}": fc.UnilateralPenalty(n) for n in range(1, 9)}, X)
    background_curves = {f"curve {n}": (X, n * X) for n in range(1, 6)}
    points = {f"point {n}": (X[:1], n * X[:1]) for n in range(1, 5)}
    curve = fc.draw_curve(results["curve"], 1, behind=background_curves, points=points)
    for figure, count in ((crowded_figure, 20), (laws, 8)):
        assert len(figure.axes[0].lines) == count
    labels = {text.get_text() for text in curve.axes[0].get_legend().get_texts()}
    assert labels >= {*background_curves, *points}
    law = fc.UnilateralPenalty(1.0)
    many_harmonics = fc.continue_frequency(two_masses(), 0.8, 0.9, law, harmonics=8)
    assert len(fc.draw_content(many_harmonics, 1, highest=7).axes[0].lines) == 7
    catch_error(lambda: fc.draw_content(many_harmonics, 1, highest=0), "highest", 0)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_curves_without_values_and_lists() -> None:
    """Curves that are nan everywhere warn of nothing; lists are drawn; no curve is refused."""
    fc.draw_response(X, {"unknown": np.full(5, np.nan)}, quantity="amplitude")
    options: Any = {"quantity": "amplitude", "doubtful": {"a": [True, False]}}
    [line, rings] = fc.draw_response([1, 2], {"a": [3, 4]}, **options).axes[0].lines  # type: ignore[arg-type, dict-item]
    assert len(line.get_xdata()) == 2 and len(rings.get_xdata()) == 1
    catch_error(lambda: fc.draw_response(X, {}, quantity="amplitude"), "curves", {})


def test_mode_shapes_that_are_not_there(results: dict[str, Any]) -> None:
    """Their numbers begin at 1."""
    for numbers in ([], [0], [5]):
        catch_error(partial(fc.draw_modes, results["modes"], numbers=numbers), "numbers", numbers)
    catch_error(lambda: fc.draw_modes(results["modes"], columns=0), "columns", 0)


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
    """No other file but that of a disk's pictures imports what pictures are made with."""
    package = DEMOS.parent / "fenics_crack"
    made_with = re.compile(r"^\s*(?:import|from) (matplotlib|pyvista|PIL|vtk)", re.M)
    users = {path for path in package.rglob("*.py") if made_with.search(path.read_text())}
    assert {path.parent for path in users - {package / "disk" / "plot_disk.py"}} == {
        package / "draw"
    }


# --- curves ---------------------------------------------------------------------------------------


def legend_of(panel: Any) -> list[str]:
    """The words of a legend."""
    return [text.get_text() for text in panel.get_legend().get_texts()]


def test_marks_do_not_pile_up(results: dict[str, Any]) -> None:
    """Of 600 bifurcations at few places those that can be told apart are marked; all count."""
    curve = results["touching"]
    n_copies = 600 // len(curve.bifurcations)
    crowded_curve = replace(curve, bifurcations=n_copies * curve.bifurcations)
    panel = fc.draw_curve(crowded_curve, 0).axes[0]
    marker_lines = [line for line in panel.lines if line.get_marker() in "vsD^"]
    marker_points = np.concatenate([np.column_stack(line.get_data()) for line in marker_lines])
    assert 0 < len(marker_points) <= len(curve.bifurcations) and len(marker_points) <= 40
    counts = [int(re.findall(r"\((\d+)", word)[0]) for word in legend_of(panel) if "marked" in word]
    assert sum(counts) == len(crowded_curve.bifurcations)


def test_every_kind_in_the_legend_is_marked(results: dict[str, Any]) -> None:
    """Also a fold beside a doubling, at the same place in the picture."""
    curve = results["touching"]
    bifurcation = curve.bifurcations[0]
    both_kinds = tuple(replace(bifurcation, kind=kind) for kind in ("fold", "period_doubling"))
    panel = fc.draw_curve(replace(curve, bifurcations=both_kinds), 0).axes[0]
    marker_lines = [
        line for line in panel.lines if line.get_marker() in "vsD^" and len(line.get_xdata())
    ]
    assert len(marker_lines) == 2 and not any("0 marked" in word for word in legend_of(panel))


def test_the_largest_response_is_marked(results: dict[str, Any]) -> None:
    """By a ring where it is, whose legend has its place and size; no end of a curve is."""
    curve = results["touching"]
    panel = fc.draw_curve(curve, 0).axes[0]
    [ring] = [line for line in panel.lines if line.get_marker() == "o"]
    x, y = map(float, (ring.get_xdata()[0], ring.get_ydata()[0]))
    peak = curve.peak(0)
    assert (x, y) == pytest.approx((peak.omega, peak.amplitude), rel=1e-9)
    [words] = [word for word in legend_of(panel) if word.startswith("largest")]
    match = re.match(rf"largest: ([\d.]+) (\w?)m at {x:.5g} rad/s", words)
    factor = {"": 1.0, "m": 1e-3, "µ": 1e-6, "n": 1e-9}[match[2]]
    assert float(match[1]) * factor == pytest.approx(y, rel=1e-2)
    assert not any("largest" in word for word in legend_of(fc.draw_curve(exact_curve(), 0).axes[0]))


def test_inexact_parts_are_faint(results: dict[str, Any]) -> None:
    """Where the estimated error is large nothing is solid; elsewhere nothing is faint."""
    curve = replace(results["touching"])
    errors = np.where((curve.omega > 1.0) & (curve.omega < 1.1), 0.5, 0.01)
    vars(curve)["displacement_errors"] = errors
    panel = fc.draw_curve(curve, 0).axes[0]
    curve_lines = [line for line in panel.lines if len(line.get_xdata()) == len(curve)]
    for faint in (True, False):
        lines = [line for line in curve_lines if ((line.get_alpha() or 1.0) < 1.0) == faint]
        is_drawn = np.any([np.isfinite(line.get_ydata()) for line in lines], axis=0)
        is_large = errors > 0.05
        assert np.all(is_drawn[is_large == faint])
        is_inner = (
            is_large[1:-1] & is_large[:-2] & is_large[2:]
            if not faint
            else ~is_large[1:-1] & ~is_large[:-2]
        )
        assert not np.any(is_drawn[1:-1][is_inner])
    assert any("estimated error above 5 %" in word for word in legend_of(panel))
    assert not any("faint" in word for word in legend_of(fc.draw_curve(exact_curve(), 0).axes[0]))


def exact_curve() -> fc.ResponseCurve:
    """With so many harmonics that its error is small."""
    law = fc.UnilateralPenalty(0.3)
    return fc.continue_frequency(oscillator(0.2, 1.0), 0.6, 0.9, law, harmonics=9)


def test_errors_along_a_curve(results: dict[str, Any]) -> None:
    """Interpolated: large where the estimates of the single points are, at nearly all of them."""
    curve = results["touching"]
    solutions = (curve.solution(place, search=False) for place in range(len(curve)))
    single_errors = np.array([found.report.displacement for found in solutions])
    found = curve.displacement_errors
    assert np.mean((found > LARGE) == (single_errors > LARGE)) > 0.95
    assert np.any(single_errors > LARGE) and np.any(single_errors < LARGE)
    assert np.isclose(found, single_errors, rtol=1e-9).sum() >= 40


def test_multipliers(results: dict[str, Any]) -> None:
    """Their moduli stand over the load frequency, each under the kind that it is."""
    curve = results["touching"]
    panel = fc.draw_multipliers(curve, in_hertz=True).axes[0]
    assert panel.get_xlabel() == "load frequency [Hz]"
    dots = {
        line.get_label(): line.get_xydata()
        for line in panel.lines
        if line.get_marker() in (".", "x") and len(line.get_xdata())
    }
    drawn_points = np.concatenate([*dots.values()])
    sizes = np.nan_to_num(np.abs(curve.multipliers), nan=1.0)  # undecided: not known
    expected_points = np.column_stack([curve.omega / (2.0 * np.pi), sizes])
    sorted_points = (table[np.lexsort(table.T)] for table in (drawn_points, expected_points))
    assert np.allclose(*sorted_points)
    is_undecided = curve.verdicts == "undecided"
    crosses = dots["undecided; drawn at 1 if unknown"]
    assert len(crosses) == is_undecided.sum() < len(curve)
    pairs = np.sum(~is_undecided & (np.abs(curve.multipliers.imag) > 1e-9))
    assert len(dots.get("a complex pair", [])) == pairs
    catch_error(lambda: fc.draw_multipliers(replace(curve, multipliers=None)), "stability", False)


# --- maps, legends, the mesh ----------------------------------------------------------------------


def test_doubtful_cells_are_hatched() -> None:
    """Each of them over its own cell; those that did not converge are grey and crossed."""
    values, doubtful = np.outer(X, X), np.zeros((5, 5), dtype=bool)
    values[0, 3], doubtful[2, 1], doubtful[4, 4], doubtful[0, 3] = np.nan, True, True, True
    words: dict[str, Any] = {"x_label": "x", "y_label": "y", "value_label": "v"}
    panel = fc.draw_map(X, 10.0 * X, values, doubtful=doubtful, **words).axes[0]
    [hatched_collection] = [one for one in panel.collections if one.get_hatch()]
    middles = [path.vertices[:4].mean(axis=0) for path in hatched_collection.get_paths()]
    assert np.allclose(sorted(map(tuple, middles)), [(X[1], 10.0 * X[2]), (X[4], 10.0 * X[4])])
    [crosses] = [line for line in panel.lines if len(line.get_xdata())]
    assert np.allclose(crosses.get_xydata(), [(X[3], 10.0 * X[0])])
    assert legend_of(panel)[0] == "not converged" and "not stable" in legend_of(panel)[1]
    bare = fc.draw_map(X, 10.0 * X, values, doubtful=doubtful, legend=False, **words)
    assert bare.axes[0].get_legend() is None
    catch_error(
        lambda: fc.draw_map(X, X, values, doubtful=doubtful[:3], **words), "doubtful", (3, 5)
    )


def test_legends_hide_nothing() -> None:
    """Below the panel of a constrained layout: no point of a line lies under a legend."""
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    time = np.linspace(0.0, 2e-3, 400)
    waves = [
        fc.Wave(f"a wave with a long name {n}", time, 1e-6 * np.sin(3e4 * time + n))
        for n in range(6)
    ]
    fc.draw_waves(waves, quantity="q", axes=panel)
    figure.canvas.draw()
    box = panel.get_legend().get_window_extent()
    for line in panel.lines:
        pixel_points = panel.transData.transform(line.get_xydata())
        assert not np.any(np.all((pixel_points > box.min) & (pixel_points < box.max), axis=1))
    figure_box = figure.bbox
    assert box.x0 >= figure_box.x0 and box.y0 >= figure_box.y0 and box.x1 <= figure_box.x1


def test_long_names_stand_in_lines(tmp_path: Path) -> None:
    """As wide as the figure, which grows by them: long names pushed the panel out of it."""
    name = " ".join(f"table.key_{n} = 1.25 mm," for n in range(25))
    waves = [fc.Wave(f"{name} {end}", X, X) for end in ("a", "b")]
    figure = fc.draw_waves(waves, quantity="q", path=tmp_path / "waves.png")
    [panel] = figure.axes
    legend_box, figure_box = panel.get_legend().get_window_extent(), figure.bbox
    assert (
        legend_box.x0 >= figure_box.x0
        and legend_box.x1 <= figure_box.x1
        and legend_box.y0 >= figure_box.y0
    )
    assert [" ".join(words.split()) for words in legend_of(panel)] == [f"{name} {e}" for e in "ab"]
    assert panel.get_window_extent().height > 0.3 * figure_box.height


def test_mesh(paper_scene: fc.Scene, plate: fc.Structure) -> None:
    """The clamped edge, the lips along the crack, the pairs, and an arrow from the load's point."""
    panel = fc.draw_mesh(plate).axes[0]
    assert legend_of(panel) == ["clamped", "crack faces", "contact pairs (4)", "load"]
    _, _, clamped_points, lips = (
        np.concatenate(one.get_segments())
        for one in panel.collections
        if isinstance(one, LineCollection)
    )
    assert np.allclose(clamped_points[:, 1], 0.0) and np.ptp(clamped_points[:, 0]) == pytest.approx(
        0.1
    )
    crack = paper_scene.crack
    assert crack is not None and np.allclose(lips[:, 1], crack.height)
    assert lips[:, 0].max() == pytest.approx(crack.length)
    [arrows] = [one for one in panel.collections if isinstance(one, Quiver)]
    assert np.allclose(arrows.XY, [paper_scene.excitation.point]) and arrows.U[0] > 0.0
    catch_error(lambda: fc.draw_mesh(oscillator(0.1, 1.0)), "structure", "made from matrices")


def test_names_of_modes_are_beside_their_plates(results: dict[str, Any]) -> None:
    """No title lies on a plate, its own or that of another row."""
    figure = fc.draw_modes(results["modes"], columns=2)
    figure.canvas.draw()
    plates = [
        panel.transData.transform(np.concatenate(one.get_segments()))
        for panel in figure.axes
        for one in panel.collections
        if isinstance(one, LineCollection)
    ]
    assert len(plates) == 12
    for panel in figure.axes:
        lower_corner, upper_corner = panel.title.get_window_extent().get_points()
        for points in plates:
            assert not np.any(np.all((points > lower_corner) & (points < upper_corner), axis=1))
