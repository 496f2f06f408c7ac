"""Keys of friction and of loads with harmonics: what they refuse, how they are written, and what
they make."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, catch_error

import fenics_crack as fc

RUBBING = {"contact.law": "unilateral", "contact.stiffness_per_area": None, "contact.friction": 0.3}


def plate(**changes: object) -> fc.Scene:
    """The inclined crack."""
    return fc.Scene.load(ROOT / "demos/inclined_crack.toml").replace(changes)


@pytest.mark.parametrize(
    ("key", "value", "changes", "names"),
    [
        ("contact.friction", -0.1, {}, ">= 0"),
        ("contact.tangential_stiffness_per_area", 1e12, {}, r"without contact\.friction > 0"),
        (
            "contact.friction",
            0.3,
            {"contact.law": "smoothed", "contact.sharpness": 1e9},
            "law = 'smoothed'",
        ),
        (
            "output.quantities",
            "slip_share",
            {"output.quantities": ["slip_share"]},
            r"contact\.friction",
        ),
        ("excitation.wave_harmonics", 5, {}, r"excitation\.wave$"),
        ("excitation.harmonics", [{"order": 2}], {}, None),
        ("excitation.harmonics", [{"order": 2, "cos": [1.0, 0.0], "phase": 3.0}], {}, None),
        (
            "harmonic_balance.harmonics",
            5,
            {"excitation.harmonics": [{"order": 7, "cos": [1.0, 0.0]}]},
            ">= 7, ",
        ),
    ],
)
def test_refused_keys(key: str, value: Any, changes: dict[str, Any], names: str | None) -> None:
    catch_error(lambda: plate(**{key: value} | changes), key, value, names=names)


def test_friction_needs_faces_that_give() -> None:
    heavy_settings = RUBBING | {"reduction.method": "free_interface", "reduction.modes": 8}
    stiff_settings = {"contact.friction": 0.3, "reduction.method": "off"}
    for changes, key, value in (
        (heavy_settings, "contact.law", "unilateral"),
        (stiff_settings, "contact.tangential_stiffness_per_area", None),
    ):
        catch_error(partial(fc.prepare, plate(**changes)), key, value)
    catch_error(
        lambda: plate(**RUBBING | {"output.quantities": ["K_max"]}), "output.quantities", "K_max"
    )


def test_law_of_a_scene() -> None:
    """The stiffness of pairs that stick follows from their areas."""
    whole_structure = fc.build_structure(plate())
    scene = plate(**{"contact.friction": 0.3, "contact.tangential_stiffness_per_area": 1e12})
    law = fc.contact_law(scene.contact, whole_structure)
    assert isinstance(law, fc.CoulombFriction) and law.coefficient == 0.3
    np.testing.assert_allclose(law.tangential_stiffness, 1e12 * whole_structure.pair_areas)
    np.testing.assert_allclose(law.stiffness, 1e14 * whole_structure.pair_areas)


@pytest.mark.parametrize("keys", [{"free": True, "deflection": 2.0}, {"deflection": 1.0}])
def test_integration_from_a_deflection(keys: dict[str, object]) -> None:
    """Under a load of several harmonics: the deflection is that of the mean and the first."""
    harmonic = {"order": 3, "sin": [4.0, 0.0]}
    changes = {f"integration.{key}": value for key, value in (keys | {"periods": 2}).items()}
    scene = fc.Scene.load(ROOT / "demos/paper_plate.toml").replace(
        {"contact.stiffness": 1e9, "damping.ratio": 0.02, **changes}
    )
    plain_run, changed_scene = (
        fc.integrate(scene),
        scene.replace({"excitation.harmonics": [harmonic]}),
    )
    run = fc.integrate(changed_scene)
    assert run.result.recorded[0] == pytest.approx(plain_run.result.recorded[0], rel=1e-9)
    is_same = np.allclose(run.result.recorded, plain_run.result.recorded)
    assert is_same == ("free" in keys)


def test_harmonics_of_all_loads(tmp_path: Path) -> None:
    """At a point, on an edge, of the clamp, by a table: rows of the load; written and read."""
    table = tmp_path / "square.csv"
    table.write_text("t,fx,fy\n0,5,0\n0.5,5,0\n0.5,-5,0\n1,-5,0\n")
    coarse = {"excitation.force_sin": [0.0, 0.0], "mesh.size": 0.05, "mesh.lip_elements": 4}
    base = fc.Scene.load(ROOT / "demos/breathing_plate.toml").replace(coarse)
    shaken = {"order": 2, "amplitude": [2.0, 0.0], "phase": 30.0}
    scene = base.replace(
        {
            "excitation.harmonics": [{"order": 3, "sin": [0.0, 4.0]}],
            "excitation.wave": str(table),
            "excitation.wave_harmonics": 5,
            "loads.1.edge": "top",
            "loads.1.harmonics": [{"order": 2, "cos": 10.0}],
            "base.harmonics": [shaken],
        }
    )
    path = tmp_path / "scene.toml"
    path.write_text(scene.as_toml())
    assert fc.Scene.load(path) == scene
    structure = fc.build_structure(scene)
    assert structure.force.shape[0] == 11 and scene.harmonic_balance.harmonics == 5
    single_force = fc.build_structure(base.replace({"excitation.force_cos": [1.0, 0.0]})).force[1]
    rows = structure.force
    np.testing.assert_allclose(
        rows[2], 4.0 / np.pi * 5.0 * single_force, rtol=1e-12
    )  # of the table
    np.testing.assert_allclose(rows[10], 4.0 / (5.0 * np.pi) * 5.0 * single_force, rtol=1e-12)
    assert np.abs(rows[[0, 1, 5, 7, 8, 9]]).max() < 1e-12 and rows[[3, 4, 6]].any(axis=1).all()
    moved_force = fc.build_structure(
        base.replace({"base.acceleration_cos": [2.0, 0.0], "excitation.point": None})
    ).force[1]
    np.testing.assert_allclose(
        rows[4], 0.5 * moved_force, rtol=1e-9, atol=1e-12 * np.abs(moved_force).max()
    )
