"""What contributes to the error of a scene's answer, and what is said of it."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers import DEMOS, catch_error
from mpi4py import MPI
from surroundings import RunCommand

import fenics_crack as fc
from fenics_crack import Scene, Study

MISSED = 4
"""Exit code of a result whose error is unknown or above the tolerance."""

PLATE: dict[str, Any] = {
    "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
    "crack": {"edge": "left", "height": 0.05, "length": 0.05},
    "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.01},
    "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [100.0, 0.0]},
    "contact": {"stiffness_per_area": 5e10},
    "mesh": {"layout": "graded", "size": 0.03, "lip_elements": 2, "grading": 2.0},
    "reduction": {"modes": 6},
    "output": {"quantities": ["amplitude", "ratio_2_1", "opening"]},
}
"""Two pairs, 15 elements."""


def plate(changes: dict[str, object] | None = None) -> Scene:
    """The plate with some keys changed."""
    return Scene.from_mapping(PLATE).replace(changes or {})


@pytest.fixture(scope="module")
def verified() -> fc.Verification:
    """The plate's."""
    return fc.verify(plate())


def test_each_part_is_what_its_runs_say() -> None:
    """The three runs of each cause, one at a time, are those of scenes changed by hand, on other
    meshes as far from the resonance; more modes change what they do with very many harmonics; the
    shift's part is the answer at a shifted frequency; that of the harmonics what very many of them
    change; totals are those of the contributions."""
    scene = plate({"harmonic_balance.harmonics": 3, "contact.friction_error": False})
    verification = fc.verify(scene)
    assert (
        verification.causes == ("mesh", "shift", "modes", "harmonics") and not verification.failures
    )
    assert verification.counts["modes"] == (6, 12, 24) and verification.counts["harmonics"] == (
        3,
        100,
    )
    study, value = fc.prepare(scene), verification.values["opening"]
    part = verification.parts["mesh"]["omega_bilinear_1"]
    error = part.uncertainty(-1) / part.values[-1]
    shifts = [1.0 + 0.5 * error, 1.0 + error, part.values[-1] / part.extrapolated]
    shift_error = max(abs(opening(study, 2000.0 * shift) - value) for shift in shifts)
    assert verification.contributions("opening")["shift"] == pytest.approx(shift_error, rel=1e-6)
    finer_settings = [{"mesh.size": 0.03 / f, "mesh.lip_elements": int(2 * f)} for f in (1.5, 2.0)]
    plates = [fc.prepare(scene.replace(changes)) for changes in finer_settings]
    omegas = [2000.0 * breathing(one) / breathing(study) for one in plates]
    values = [opening(one, omega) for one, omega in zip(plates, omegas, strict=True)]
    assert verification.parts["mesh"]["opening"].values[1::-1] == pytest.approx(values, rel=1e-6)
    most_harmonics = {"harmonic_balance.harmonics": 100}
    reference_opening, *values = (
        opening(fc.prepare(scene.replace(most_harmonics | {"reduction.modes": modes})), 2000.0)
        for modes in (6, 12, 24)
    )
    changed = [value + one - reference_opening for one in values]
    assert verification.parts["modes"]["opening"].values[1::-1] == pytest.approx(changed, rel=1e-4)
    harmonics_part, mesh = (
        verification.parts["harmonics"]["opening"],
        verification.parts["mesh"]["opening"],
    )
    assert harmonics_part.extrapolated == pytest.approx(reference_opening, rel=1e-4)
    assert harmonics_part.behaviour == "exact orbit" and harmonics_part.gci == 0.0
    assert mesh.sizes[2] == pytest.approx(math.sqrt(0.01 / verification.counts["mesh"][0]))
    parts = verification.contributions("opening")
    total_error = math.hypot(parts["mesh"] + parts["shift"], parts["modes"], parts["harmonics"])
    assert verification.total("opening") == pytest.approx(total_error)
    assert verification.total("opening", independent=False) == pytest.approx(sum(parts.values()))
    tiny = replace(
        verification, values={name: value / 1e3 for name, value in verification.values.items()}
    )
    assert re.search(r"\+- \d{3,} % \(sum of all: \d{3,} %\)", tiny.statement[0])
    rows = [row for row in verification.totals().rows if row[0] == "opening [m]"]
    assert rows[0][2] == pytest.approx(
        100.0 * parts["mesh"] / verification.values["opening"], rel=1e-2
    )


def opening(plate: Study, omega: float) -> float:
    """Of the lips at a frequency."""
    harmonics = plate.scene.harmonic_balance.harmonics
    solution = fc.solve_harmonic_balance(plate.structure, omega, plate.contact, harmonics=harmonics)
    return solution.indicators(plate.watched[0].dof).opening


def breathing(plate: Study) -> float:
    """The first bilinear frequency."""
    return float(fc.bilinear_frequencies(plate.structure).omega_bilinear[0])


@pytest.mark.parametrize("order", [pytest.param(1, marks=pytest.mark.nightly), 2])
def test_orders_of_natural_frequencies(order: int) -> None:
    """Without a crack the clamp's ends are left, 1.52 by Williams (quadratic elements show it, of
    linear ones the smooth part is in between); with an open crack 1."""
    mesh = {"mesh.size": 0.01, "mesh.order": order, "mesh.lip_elements": 4}
    whole_verification = fc.verify(plate(mesh | {"crack": None, "contact": None}))
    part = whole_verification.parts["mesh"]["omega_open_1"]
    assert part.behaviour == "asymptotic" and 1.3 < part.order < 2.0
    if order == 2:
        assert part.order == pytest.approx(1.52, abs=0.1)
    assert set(whole_verification.absent) == {"harmonics", "samples"}
    cracked_part = fc.verify(plate(mesh)).parts["mesh"]["omega_open_1"]
    assert cracked_part.order == pytest.approx(1.0, abs=0.15) and cracked_part.exponent <= 1.0


def test_force_at_a_point_is_told() -> None:
    """Under it the displacement grows like log(1/h): its order is near 0, and that is said."""
    changes = {"mesh.size": 0.01, "mesh.order": 2, "crack": None, "contact": None}
    verification = fc.verify(plate(changes))
    assert abs(verification.parts["mesh"]["amplitude"].order) < 0.2
    assert (
        verification.point_force_warnings
        and "log(1/h), by about 8.2 %" in verification.point_force_warnings[0]
    )
    assert set(verification.point_force_warnings) <= set(verification.warnings)
    edge = {"excitation.point": None, "excitation.force_sin": (0.0, 0.0), "loads.1.edge": "top"}
    verification = fc.verify(plate(changes | edge | {"loads.1.traction_sin": (1e3, 0.0)}))
    assert verification.parts["mesh"]["amplitude"].order > 1.0
    assert not verification.warnings


@pytest.mark.parametrize(
    ("place", "share"), [((1.0, 1.0), 0.1), ((1.0, 0.5), 0.1), ((0.5, 0.5), 0.25)]
)
def test_dent(place: tuple[float, float], share: float) -> None:
    """What a halving of the elements adds, in a corner, on an edge and, about, inside."""
    scene = plate({"crack": None, "contact": None})
    point = tuple(
        side * coordinate for side, coordinate in zip(scene.geometry.sides, place, strict=True)
    )
    scene = scene.replace({"excitation.point": point, "excitation.force_sin": (0.0, 9.0)})
    grid = {"mesh.layout": "grid", "mesh.size": None, "mesh.lip_elements": None}
    grid |= {"mesh.grading": 4.0, "damping.ratio": None, "damping.stiffness": 1e-9}
    sizes = []
    for count in (16, 32):
        finer_scene = scene.replace(grid | {"mesh.columns": count, "mesh.rows": count})
        structure = fc.build_structure(finer_scene)
        sizes.append(fc.solve_linear(structure, 1.0).amplitude(structure.watched_dof))
    dent_text = fc.Verification(
        scene, {"amplitude": sizes[1]}, {"amplitude": "m"}
    ).point_force_warnings[0]
    stated_share = 0.01 * float(dent_text.partition("by about ")[2].partition(" %")[0])
    assert sizes[1] - sizes[0] == pytest.approx(stated_share * sizes[1], rel=share)


@pytest.mark.nightly
def test_samples_of_a_smoothed_law() -> None:
    """Those of the scene, or of the solver; a tolerance chooses harmonics first."""
    smoothed_scene = plate({"contact.law": "smoothed", "contact.sharpness": 1e8})
    smoothed_scene = smoothed_scene.replace({"harmonic_balance.harmonics": 2})
    verification = fc.verify(smoothed_scene)
    assert verification.counts["samples"] == (1024, 2048, 4096)
    legend = fc.draw_verification(verification).axes[1].get_legend()
    assert "samples" in "".join(text.get_text() for text in legend.get_texts())
    verification = fc.verify(plate({"harmonic_balance.samples": 32}))
    assert verification.counts["samples"] == (32, 64, 128) and verification.counts["harmonics"] == (
        5,
        10,
        20,
    )
    assert verification.total("opening") > verification.contributions("opening")["samples"] > 0.0
    verification = fc.verify(plate({"harmonic_balance.tolerance": 0.05}))
    assert verification.scene.harmonic_balance.tolerance is None
    assert verification.counts["harmonics"][0] == verification.scene.harmonic_balance.harmonics
    assert verification.absent == {
        "samples": "contact forces are integrated exactly, without samples"
    }


def test_what_cannot_be_varied() -> None:
    """Matrices and mesh files keep their mesh, which no total has; that is said."""
    for demo, key in (("chain", "[structure]"), ("inclined_crack", "mesh.file")):
        few_harmonics = {"harmonic_balance.harmonics": 2}
        verification = fc.verify(Scene.load(DEMOS / f"{demo}.toml").replace(few_harmonics))
        left_out_parts = ["mesh", "friction"] if demo == "chain" else ["mesh"]  # it has no tangents
        assert list(verification.unknown) == left_out_parts and key in verification.unknown["mesh"]
        assert "mesh" not in verification.parts and verification.parts["harmonics"]
        assert any(
            text.startswith("the totals do not include the error due to the mesh")
            for text in verification.statement
        )
    assert "reduced" in fc.verify(plate({"reduction.method": "off"})).absent["modes"]
    large_settings = {"crack": None, "contact": None, "mesh.lip_elements": None, "mesh.size": 1.0}
    verification = fc.verify(plate(large_settings | {"reduction": None}))
    assert "mesh" not in verification.parts and "as many elements" in verification.unknown["mesh"]


def test_grids_and_odd_lips_take_whole_factors() -> None:
    """1.5 times as many would leave a grid's lines, or be rounded; all modes stay all."""
    grid = {"mesh.layout": "grid", "mesh.size": None, "mesh.lip_elements": None}
    grid |= {"mesh.columns": 2, "mesh.rows": 2, "mesh.grading": 4.0, "reduction": None}
    verification = fc.verify(plate(grid))
    assert verification.counts["mesh"] == (4, 16, 36)
    assert verification.scene.reduction is not None and verification.scene.reduction.method == "off"
    verification = fc.verify(plate({"mesh.lip_elements": 3}))
    assert (
        verification.parts["mesh"]["opening"].sizes[2]
        > 2.0 * verification.parts["mesh"]["opening"].sizes[0]
    )


def test_unstable_orbits_are_named(paper_scene: Scene) -> None:
    """The paper's plate on soft contact; and that its stiffness is one of a pair, if it has any."""
    few_modes = {"reduction.method": "free_interface", "reduction.modes": 10}
    scene = paper_scene.replace({"contact.stiffness": 1e9, "excitation.omega": 1700.0} | few_modes)
    verification = fc.verify(scene)
    assert verification.verdicts["the scene's settings"] == "unstable"
    assert any("unstable" in text for text in verification.warnings)
    assert any("stiffness_per_area" in text for text in verification.warnings)
    bare = fc.verify(scene.replace({"crack": None}))
    assert not any("stiffness_per_area" in text for text in bare.warnings)
    assert not any(part.has_error_from_limit for part in [verification.parts["mesh"]["ratio_2_1"]])


def test_command(run_command: RunCommand, tmp_path: Path, verified: fc.Verification) -> None:
    """Table, statement, files and picture; frequencies in the scene's unit."""
    scene = plate({"excitation.frequency": 318.3})
    process = run_command("verify", scene, "--output", tmp_path, code=MISSED)
    assert "frequency_open_1 [Hz]" in process.out and "total [%]" in process.out
    assert "amplitude = " in process.err and "contact forces are integrated exactly" in process.err
    rows = list(csv.DictReader((tmp_path / "verify.csv").open()))
    mesh = next(row for row in rows if (row["quantity"], row["cause"]) == ("opening", "mesh"))
    assert float(mesh["gci_finest"]) > 0.0 and [mesh[f"count_{n}"] for n in (1, 2, 3)] == [
        str(count) for count in verified.counts["mesh"]
    ]
    records = json.loads((tmp_path / "verify.json").read_text())
    assert {row["cause"] for row in records} == {*verified.causes, "total", "sum"}
    assert (tmp_path / "verify.png").stat().st_size > 20_000
    kept_path = tmp_path / "verify.h5"
    run_command("report", kept_path, "--output", tmp_path / "page.html", "--quiet")
    page = (tmp_path / "page.html").read_text()
    assert "Convergence study" in page and "mostly due to" in page and page.count("<img") == 2
    (tmp_path / "verify.png").unlink()
    run_command("plot", kept_path, "--quiet")
    assert (tmp_path / "verify.png").exists()


def test_rows_are_quantities_in_words(verified: fc.Verification) -> None:
    """With their values and units; legends are short, and no line looks like another one."""
    left, right = fc.draw_verification(verified).axes
    rows = [label.get_text() for label in right.get_yticklabels()]
    assert len(rows) == len(verified.values) and not any("_" in row for row in rows)
    assert sum(row.endswith(" rad/s") for row in rows) >= 4
    assert any(row.startswith("half peak-to-peak, ") and row.endswith("m") for row in rows)
    for panel, most in ((left, 1), (right, len(verified.causes) + 2)):
        assert len(panel.get_legend().get_texts()) == most
    lines = [(line.get_marker(), line.get_color()) for line in left.lines]
    assert len(set(lines)) == len(lines) > 5


def test_bad_input(verified: fc.Verification) -> None:
    """Each error names what is wrong."""
    catch_error(lambda: verified.contributions("colour"), "quantity", "colour")
    catch_error(lambda: fc.draw_verification(verified, axes=[None]), "axes", "1 axes")


def stated(scene: Scene, comm: MPI.Comm) -> tuple[list[float], dict[str, tuple[int, int, int]]]:
    """Values with their totals, and what was counted (collective)."""
    return numbers(fc.verify(scene, comm))


def numbers(found: fc.Verification) -> tuple[list[float], dict[str, tuple[int, int, int]]]:
    """The same of what was found."""
    return [round(row[2] + row[6], 2) for row in found.totals().rows], found.counts


@pytest.mark.mpi
def test_two_ranks(on_ranks: Callable[..., Any], verified: fc.Verification) -> None:
    """They share each mesh, and state the same."""
    assert on_ranks(stated, plate()) == numbers(verified)
