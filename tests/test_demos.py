"""The demos run, and reproduce the numbers that are known."""

import ast
import contextlib
import csv
import importlib.util
import io
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, assert_found
from matplotlib import pyplot
from matplotlib.figure import Figure

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_laid_out")


def load(name: str) -> ModuleType:
    """Import a demo by its name."""
    spec = importlib.util.spec_from_file_location(name, DEMOS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", [path.stem for path in sorted(DEMOS.glob("*.py"))])
def test_demo_names_what_there_is(name: str) -> None:
    """Each can be imported, and the names of the package in it exist."""
    assert callable(load(name).main)
    text = (DEMOS / f"{name}.py").read_text()
    assert set(re.findall(r"\bfc\.(\w+)", text)) <= set(fc.__all__)


def test_paper_plate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The main job on fewer periods: frequencies, both cases, every figure and file; its last ten
    lines hold the answer."""
    summary = load("paper_plate").main(tmp_path, periods=120)
    text = (tmp_path / "summary.json").read_text()
    assert summary == json.loads(text)
    frequencies = summary["natural_frequencies_rad_per_s"]
    assert frequencies["open"][0] == pytest.approx(2302.9, abs=0.5)
    assert frequencies["bonded"][0] == pytest.approx(3324.7, abs=0.5)
    assert frequencies["bonded"][0] < frequencies["uncracked"][0]

    agreeing_summary, paper = summary["agreeing"], summary["paper"]
    assert agreeing_summary["direct_integration"]["settled"]
    assert agreeing_summary["difference_of_methods"] < 0.01
    many, five = agreeing_summary["harmonic_balance"], paper["harmonic_balance"]
    assert many["gap_harmonic_1_m"] == pytest.approx(7.4182e-7, rel=1e-3)
    assert many["largest_opening_m"] == pytest.approx(1.4520e-6, rel=2e-3)
    assert many["error_of_gap"] < 2e-3 and agreeing_summary["exact_orbit"]["verdict"] == "stable"
    assert paper["exact_orbit"]["verdict"] == "unstable"
    assert not paper["direct_integration"]["settled"]
    assert paper["direct_integration"]["energy_created_by_contact"] < 0.1
    assert paper["block_system"]["difference"] < 1e-10
    assert paper["block_system"]["unknowns"] == 50 * 11 + 50 * 10  # displacements, damped modes
    lower_amplitude, upper_amplitude = paper["direct_integration"]["amplitudes_m"]
    assert lower_amplitude < paper["exact_orbit"]["amplitude_m"] < upper_amplitude

    answer = "\n".join(capsys.readouterr().out.splitlines()[-10:])
    for words in (
        "duplicated node pair",
        "modal damping by SLEPc's modes",
        "2302.9 rad/s with the crack open, 3324.7 bonded; the paper has 2300",
        "1.0937 um",
        "1.4492 um",
        "PETSc SNES",
        "1,050 unknowns",
        "1.1022 um: five harmonics are 0.8% off (opening 1.5%",
        "unstable: a disturbance grows 41-fold in a period; the motion wanders between 1.0",
        "a point force has no limit: + 7%",
        "+ 26% with elements half as long",
        "1.1557 um",
        "stable; direct integration settles on it",
        "modes.png",
    ):
        assert words in answer
    for words in ("unknown", "undecided", "not known"):
        assert words not in answer.replace("unknowns", "") + text.replace('"unknowns"', "")

    linear, start = paper["linear"], agreeing_summary["start_up"]
    assert start["difference_of_central_differences"] < 0.01
    assert paper["direct_integration"]["corner_crossings_per_period"] == pytest.approx(
        1.0, abs=0.01
    )
    assert_found("Figure 1", "2302.9", "3324.7", f"{frequencies['uncracked'][0]:.1f}")
    sizes = [f"{1e6 * linear[place]:.3f} um" for place in ("gap_m", "corner_m")]
    assert_found("Figure 3", *sizes, f"{linear['correlation']:.6f}")
    opening, depth_nm = 1e6 * five["largest_opening_m"], 1e9 * five["largest_penetration_m"]
    assert_found("Figure 5", f"{opening:.3f} um", f"{depth_nm:.2f} nm")
    sides = [f"{1e6 * side:.3f}" for side in paper["corner_m"]]
    assert_found("Figure 6", *sides, sizes[1], f"{1e6 * paper['uncracked_corner_m']:.3f} um")
    assert_found(
        "Figures 7, 8", f"{agreeing_summary['difference_of_methods']:.1%}".replace("%", " %")
    )
    assert_found("summary", f"{100.0 * many['error_of_gap']:.2f} %")
    error_texts = [
        f"{100.0 * abs(five[name]):.1f} %" for name in ("error_of_amplitude", "error_of_gap")
    ]
    assert_found("few harmonics", *error_texts)

    figures = ["fig1_plate", "fig4_contact_laws", "modes", "agreeing/fig2_from_rest"]
    figures += ["agreeing/fig7_fig8_both_methods", "paper/fig2_from_rest", "paper/fig3_linear"]
    figures += ["paper/fig5_fig6_nonlinear", "paper/fig7_fig8_both_methods", "paper/spectrum"]
    for figure in [*figures, "paper/breathing_crack"]:
        assert Path(figure).name in answer
        assert (tmp_path / f"{figure}.png").stat().st_size > 10_000
    assert len(list((tmp_path / "paper" / "breathing_crack").glob("*.vtu"))) == 36
    for name in ("modes.vtu", "paper/breathing_crack.pvd"):
        assert (tmp_path / name).exists()


@pytest.mark.nightly
def test_breathing_plate(tmp_path: Path) -> None:
    """The fine mesh: about 4000 dofs, 18 pairs, a crack of about 0.0431 m, under 1 GB."""
    summary = load("breathing_plate").main(tmp_path)
    assert 3500 < summary["n_dofs"] < 4500
    assert summary["n_pairs"] == 18
    assert summary["crack_length_m"] == pytest.approx(0.0431, rel=0.02)
    assert summary["natural_frequencies_rad_per_s"][0] == pytest.approx(2300.0, abs=0.1)
    assert summary["errors"]["residual"] < 1e-10
    assert 0.0 < summary["largest_penetration_m"] < 0.1 * summary["largest_opening_m"]
    for name in ("gap.png", "contact_map.png", "modes.png", "modes.vtu", "breathing_crack.pvd"):
        assert (tmp_path / name).exists()


def swept(folder: Path, comm: object) -> str:
    """What the demo of sweeps says with fewer cases (collective)."""
    over = {"crack.length": [0.03, 0.05], "excitation.omega": [1600.0, 1800.0, 2000.0]}
    demo = load("sweep")
    with contextlib.redirect_stdout(io.StringIO()) as output_stream:
        demo.main(folder, fc.Scene.load(demo.SCENE).replace({"sweep.over": over}))
    return output_stream.getvalue()


@pytest.mark.nightly
@pytest.mark.mpi
def test_sweep_over_two_ranks(on_ranks: Callable[..., str], tmp_path: Path) -> None:
    """Ranks share the cases; the table is whole and sorted, and a second run only draws."""
    assert "6 of 6 cases converged" in on_ranks(swept, tmp_path)
    with open(tmp_path / "table.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert [float(row["excitation.omega [rad/s]"]) for row in table] == 2 * [1600, 1800, 2000]
    response = np.array([float(row["response [m]"]) for row in table]).reshape(2, 3)
    assert np.all(np.diff(response, axis=0) > 0.0)  # a longer crack is softer
    assert np.all(np.diff(response, axis=1) > 0.0)  # towards the resonance
    for name in ("response.png", "map.png"):
        assert (tmp_path / name).stat().st_size > 10_000
        (tmp_path / name).unlink()
    before = (tmp_path / "table.csv").read_bytes()
    on_ranks(swept, tmp_path)
    assert (tmp_path / "table.csv").read_bytes() == before and (tmp_path / "map.png").exists()


@pytest.mark.nightly
@pytest.mark.usefixtures("predicted_errors")
def test_resonances(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The curves through the first resonance: peaks between the open and the uncracked one.

    Drawn again from the files, without solving; integration in time lies on the first curve.
    """
    demo = load("resonances")
    coarse = {"mesh.size": 0.02, "mesh.lip_elements": 2, "crack.length": 0.043}
    for name, changes in (
        ("paper_plate", {}),
        ("breathing_plate", coarse | {"crack.first_omega": None}),
    ):
        scene = fc.Scene.load(DEMOS / f"{name}.toml").replace(changes)
        (tmp_path / f"{name}.toml").write_text(scene.as_toml())
    monkeypatch.setattr(demo, "FOLDER", tmp_path)
    monkeypatch.setattr(demo, "RANGE", (2350.0, 2800.0))
    monkeypatch.setattr(demo, "LINEAR", 100)
    monkeypatch.setattr(demo, "CHECKED", 2)
    monkeypatch.setattr(demo, "HARMONICS", {"paper_plate": 10, "breathing_plate": 3})
    monkeypatch.setattr(demo, "SWEEP", np.array([2360.0, 2400.0, 2440.0]))
    curve = demo.main(tmp_path)
    assert curve.complete and curve.omega[-1] == pytest.approx(2800.0)
    corner = curve.structure.find_dof((0.1, 0.1), "x")
    amplitude = curve.amplitude(corner)
    assert 2302.9 < curve.omega[amplitude.argmax()] < 3481.6
    assert 0 < np.count_nonzero(curve.stable) < len(curve.omega)
    with open(tmp_path / "swept.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == 6
    for row in table:
        omega, height = float(row["omega_rad_per_s"]), float(row["half_peak_to_peak_m"])
        assert height == pytest.approx(np.interp(omega, curve.omega, amplitude), rel=0.02)
    pictures = ["multipliers.png"]
    pictures += [f"{name}{part}.png" for name in demo.HARMONICS for part in ("", "_content")]
    earlier_pictures = {name: (tmp_path / name).read_bytes() for name in pictures}
    for name in pictures:
        (tmp_path / name).unlink()
    monkeypatch.setattr(fc, "continue_frequency", None)
    monkeypatch.setattr(fc, "integrate_events", None)
    again = demo.main(tmp_path, again=True)
    assert np.array_equal(again.omega, curve.omega)
    assert {name: (tmp_path / name).read_bytes() for name in pictures} == earlier_pictures


@pytest.mark.nightly
def test_blade(tmp_path: Path) -> None:
    """A cracked blade on a rotor, coarsely: the run-up peaks between open and bonded crack,
    rotation opens it, and tip timing finds most of the vibration."""
    numbers = load("blade").main(tmp_path, quick=True)
    open_rpm, bonded_rpm = (
        numbers["order meets open crack [rpm]"],
        numbers["order meets bonded crack [rpm]"],
    )
    assert open_rpm < numbers["at [rpm]"] < bonded_rpm
    assert open_rpm < numbers["order meets breathing crack [rpm]"] < bonded_rpm
    assert numbers["duty cycle, slow and pressed"] > 0.3
    assert numbers["duty cycle, fast and free"] == 0.0
    assert 0.1 < numbers["contact duty cycle there"] < 0.6
    tip_timing_ratio = (
        numbers["largest amplitude by tip timing [m]"] / numbers["largest amplitude [m]"]
    )
    assert 0.5 < tip_timing_ratio < 1.05  # groups of revolutions blur the peak
    for name in ("campbell", "run_up", "closed", "map", "arrivals", "probes"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@pytest.mark.nightly
def test_solid_blade(tmp_path: Path) -> None:
    """A twisted blade on the coarse mesh: flap and torsion, a run-up whose peak the closing crack
    bends over a fold, and every picture."""
    numbers = load("solid_blade").main(tmp_path, quick=True)
    flap = numbers["flap, crack open [Hz]"], numbers["flap, crack bonded [Hz]"]
    assert flap == pytest.approx((398.3, 407.9), rel=2e-3)
    assert numbers["torsion, crack open [Hz]"] == pytest.approx(1760.6, rel=2e-3)
    assert 4.0 * numbers["at [rpm]"] / 60.0 == pytest.approx(np.mean(flap), abs=0.4 * np.ptp(flap))
    assert 1e-3 < numbers["largest amplitude [m]"] < 4e-3
    assert 0.1 < numbers["contact duty cycle there"] < 0.3
    assert 0.05 < numbers["unstable share of the points"] < 0.4
    for name in ("mesh", "modes", "run_up", "contact", "spectrum"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert (tmp_path / "breathing.gif").stat().st_size > 100_000
    assert len(list((tmp_path / "breathing").glob("*.vtu"))) == 24


@pytest.mark.nightly
def test_flapping_blade(tmp_path: Path) -> None:
    """A blade in flap: its crack, open for half of a period, bears most at the surface, where it
    grows fastest; friction changes next to nothing. With another mesh, K to some percent."""
    scene = fc.Scene.load(DEMOS / "flapping_blade.toml")
    numbers = load("flapping_blade").main(tmp_path, scene.replace({"mesh.lip_elements": 3}))
    assert numbers["resonance [Hz]"] == pytest.approx(332.5, rel=5e-3)
    assert numbers["amplitude there [m]"] == pytest.approx(1.31e-3, rel=0.02)
    # As stated: at least the size of the change of the motion, also at another phase.
    assert numbers["friction would change the amplitude by"] < 2e-3
    assert numbers["largest K_I [Pa m^0.5]"] == pytest.approx(4.99e6, rel=0.06)
    deepest = numbers["largest K_I where the crack is deepest [Pa m^0.5]"]
    assert deepest == pytest.approx(2.98e6, rel=0.03)
    assert numbers["last depth [m]"] == pytest.approx(0.003) and numbers["last length [m]"] > 0.016
    assert 2e6 < numbers["cycles of growth"] < 5e6
    assert 1.3 < numbers["known within a factor of"] < 4.0
    for name in ("curve", "intensity", "contact", "growth"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@pytest.mark.nightly
def test_growth(tmp_path: Path) -> None:
    """On few lengths: at the resonance that moves a plate lives for far fewer cycles."""
    coarse = {
        "growth.until": 0.0365,
        "growth.life_tolerance": 0.5,
        "harmonic_balance.harmonics": 10,
    }
    demo = load("growth")
    lives = demo.main(tmp_path, fc.Scene.load(DEMOS / "growth.toml").replace(coarse))
    assert 20.0 < lives["frequency"] / lives["resonance"] < 200.0
    for drive in lives:
        assert (tmp_path / f"{drive}.png").stat().st_size > 10_000
        assert (tmp_path / drive / "growth_1.h5").exists()


def displayed(value: object, kind: str) -> Any:
    """A value as a notebook asks for it."""
    return getattr(value, f"_repr_{kind}_")()


@pytest.mark.nightly
def test_first_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each cell that ends with a value shows a picture or a table; the file keeps no output."""
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=str))
    cells = json.loads((DEMOS / "first_notebook.ipynb").read_text())["cells"]
    names: dict[str, Any] = {}
    shown = []
    for cell in [cell for cell in cells if cell["cell_type"] == "code"]:
        assert cell["outputs"] == [] and cell["execution_count"] is None
        *lines, last_statement = ast.parse("".join(cell["source"])).body
        if isinstance(last_statement, ast.Expr):
            lines.append(ast.parse("shown = 0").body[0])
            lines[-1].value = last_statement.value
        else:
            lines.append(last_statement)
        exec(compile(ast.Module(lines, []), "notebook", "exec"), names)
        shown.append(names.pop("shown", None))
    assert shown.pop(0) is None  # the import
    figures = [displayed(value, "png") for value in shown if isinstance(value, Figure)]
    assert len(figures) == 5 and all(png.startswith(b"\x89PNG") for png in figures)
    assert not pyplot.get_fignums()  # nothing that pyplot would show again
    [frame] = [value for value in shown if isinstance(value, str)]
    assert "'amplitude': [" in frame
    tables = [displayed(value, "html") for value in shown if not isinstance(value, Figure | str)]
    assert len(tables) == 4 and all(page.startswith("<table>") for page in tables)
    assert names["curve"].peak().omega == pytest.approx(2.0 * np.pi * 832.2, rel=1e-3)


def test_first_notebook_in_jupyter() -> None:
    """Where it is installed, as after "pip install jupyter pandas"."""
    reader, client = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = reader.read(DEMOS / "first_notebook.ipynb", 4)
    client.NotebookClient(notebook, resources={"metadata": {"path": str(DEMOS)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    kinds = [kind for output in outputs for kind in output.get("data", ())]
    assert kinds.count("image/png") == kinds.count("text/html") == 5


@pytest.mark.nightly
def test_bladed_disk(tmp_path: Path) -> None:
    """The cracked blade has a resonance of its own, and probes find every amplitude."""
    scene = fc.Scene.load(DEMOS / "bladed_disk.toml").replace({"mesh.size": 0.02})
    numbers = load("bladed_disk").main(tmp_path, scene, 100)
    assert 880.0 < numbers["resonance of the cracked blade [Hz]"] < 920.0
    assert numbers["its second harmonic over the first"] > 0.02
    assert numbers["largest amplification by mistuning"] < numbers["Whitehead's bound"]
    assert numbers["tip amplitudes off by at most so many standard errors"] < 4.0
    pictures = {"diameters", "blades", "wheel", "amplification"}
    assert {f"{name}.png" for name in pictures} < {path.name for path in tmp_path.iterdir()}


@pytest.mark.nightly
def test_friction(tmp_path: Path) -> None:
    """Friction halves the peak of the inclined crack; the solution without says so of itself."""
    numbers = load("friction").main(tmp_path)
    peak_without_friction, peak_with_friction = (
        numbers["peak without friction [m]"],
        numbers["peak with friction [m]"],
    )
    assert 0.45 < peak_with_friction / peak_without_friction < 0.55
    part = numbers["friction left out, part of the peak"]
    assert (
        0.5 < part / (1.0 - peak_with_friction / peak_without_friction) < 2.0
    )  # 20 modes have another peak than ten
    assert numbers["loss by friction over that by damping"] == pytest.approx(0.814, abs=0.005)
    assert {"response.png", "loops.png"} == {path.name for path in tmp_path.iterdir()}


@pytest.mark.nightly
def test_own_forms(tmp_path: Path) -> None:
    """The graded plate on springs is slower than that of one modulus which is clamped."""
    solution = load("own_forms").main(tmp_path)
    assert solution.converged and solution.report.total < 1e-2
    clamped_structure = fc.build_structure(fc.Scene.load(DEMOS / "inclined_crack.toml"))
    slower, faster = (
        fc.solve_modes(s, 1).omega[0] for s in (solution.structure.whole, clamped_structure)
    )
    assert 0.5 < slower / faster < 0.95
    assert solution.indicators().opening == pytest.approx(3.341e-6, rel=1e-2)
    assert len(list(tmp_path.glob("plate*.pvtu"))) == 20
