"""Scenes: what is accepted, what is refused, and the messages."""

from __future__ import annotations

import copy
import dataclasses
import math
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, catch_error
from hypothesis import given, settings
from hypothesis import strategies as st

from fenics_crack import InputError, Scene

GONE = type("Gone", (), {"__repr__": lambda self: "gone"})()
"""Stands for a key or a table that is left out."""

GOOD_TOML = """
[geometry]
width = 0.1
height = 0.1
thickness = 1.0

[crack]
edge = "left"
height = 0.05
length = 0.05

[material]
young = 2e9
poisson = 0.3
density = 7800

[damping]
ratio = 0.001

[excitation]
omega = 2000
point = [0.1, 0.1]
force_sin = [100, 0]

[contact]
stiffness = 1e11

[mesh]
layout = "grid"
columns = 2
rows = 8

[harmonic_balance]
harmonics = 7
samples = 64
"""

GOOD: dict[str, dict[str, Any]] = {
    "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
    "crack": {"edge": "left", "height": 0.05, "length": 0.05},
    "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.001},
    "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [100.0, 0.0]},
    "contact": {"stiffness": 1e11},
    "mesh": {"layout": "grid", "columns": 2, "rows": 8},
    "harmonic_balance": {"harmonics": 5},
}

GRADED = {"mesh": {"layout": "graded", "size": 0.01, "lip_elements": 4}}
FILE = {
    "mesh": {"layout": "file", "file": "plate.msh"},
    "geometry": {"thickness": 1.0},
    "crack": {"clearance": 0.0},
}


def changed(changes: dict[str, Any]) -> dict[str, Any]:
    """The good scene with tables and table.keys changed, one after the other."""
    tables: dict[str, Any] = copy.deepcopy(GOOD)
    for name, value in changes.items():
        table, _, key = name.partition(".")
        place, leaf = (tables[table], key) if key else (tables, table)
        if value is GONE:
            del place[leaf]
        else:
            place[leaf] = copy.deepcopy(value)
    return tables


# --- accepted -------------------------------------------------------------------------------------
def test_a_good_file_loads(tmp_path: Path) -> None:
    """Every value of a TOML file arrives, numbers as floats, and defaults fill the rest."""
    path = tmp_path / "plate.toml"
    path.write_text(GOOD_TOML)
    scene = Scene.load(path)
    assert (scene.geometry.width, scene.geometry.height, scene.geometry.thickness) == (0.1, 0.1, 1)
    assert (scene.crack.edge, scene.crack.height, scene.crack.length) == ("left", 0.05, 0.05)
    assert scene.material == type(scene.material)(young=2e9, poisson=0.3, density=7800.0)
    assert isinstance(scene.material.density, float)
    assert (scene.damping.ratio, scene.damping.modes) == (0.001, "all")
    assert scene.excitation.point == (0.1, 0.1)
    assert scene.excitation.force_sin == (100.0, 0.0)
    assert scene.excitation.force_cos == scene.excitation.force_mean == (0.0, 0.0)
    assert (scene.contact.stiffness, scene.contact.law, scene.contact.pairs) == (
        1e11,
        "penalty",
        "all",
    )
    assert (scene.mesh.cells, scene.mesh.order, scene.mesh.columns) == ("quadrilateral", 1, 2)
    assert (scene.harmonic_balance.harmonics, scene.harmonic_balance.samples) == (7, 64)
    assert Scene.load(str(path)) == scene


@pytest.mark.parametrize(
    "changes",
    [
        GRADED,
        FILE,
        {"crack": GONE, "contact": GONE},
        GRADED | {"crack.length": GONE, "crack.first_omega": 2300.0},
        {"contact.law": "smoothed", "contact.sharpness": 1e9},
        {"contact": {"stiffness_per_area": 1e12}},
        {"contact": {"stiffness_per_area": 1e12, "law": "smoothed", "sharpness": 1e9}},
        {"contact": {"law": "unilateral"}},
        {"contact": {"law": "unilateral", "pairs": "mouth"}},
        {"damping": {"ratio": [0.01, 0.0], "modes": 2}},
        {"damping": {"ratio": [0.01, 0.02]}},
        {"damping": {"mass": 10.0}},
        {"damping": {"stiffness": 1e-6}},
        {"damping": {"mass": 0, "stiffness": 1e-6, "modes": "all"}},
        {"damping": {"ratios": [0.01, 0.02], "omegas": [1000.0, 5000.0]}},
        {"damping": {"ratios": [0.01, 0.01], "omegas": [5000.0, 1000.0]}},
        {"material.poisson": 0},
        {"excitation.point": [0.0, 0.1]},
        {"crack.clearance": -1e-6},
        {"mesh.columns": np.int64(2), "damping.ratio": np.float32(0.01)},
        {"harmonic_balance": GONE},
        {"harmonic_balance": {"harmonics": 5, "samples": 21}},
    ],
    ids=str,
)
def test_a_good_mapping_loads(changes: dict[str, Any]) -> None:
    """Everything that may be left out, and the ends of what is allowed, is accepted."""
    assert isinstance(Scene.from_mapping(changed(changes)), Scene)


def test_a_mesh_file_is_looked_up_beside_the_scene(tmp_path: Path) -> None:
    """A relative mesh.file is relative to the folder of the scene file; an absolute one stays."""
    path = tmp_path / "scene.toml"
    text = (
        "geometry.thickness = 1\nmaterial = {young = 1, poisson = 0, density = 1}\n"
        "damping.ratio = 0\nexcitation.omega = 1\nmesh = {layout = 'file', file = 'FILE'}\n"
    )
    path.write_text(text.replace("FILE", "plate.msh"))
    assert Scene.load(path).mesh.file == str(tmp_path / "plate.msh")
    path.write_text(text.replace("FILE", "/elsewhere/plate.msh"))
    assert Scene.load(path).mesh.file == "/elsewhere/plate.msh"
    assert Scene.load(path, {"mesh.file": "other.msh"}).mesh.file == "other.msh"


def test_keys_that_are_tables_are_changed_as_a_whole() -> None:
    """What to write is said."""
    catch_error(
        lambda: Scene.from_text(GOOD_TOML).replace({'sweep.over."excitation.omega"': [1.0, 2.0]}),
        'sweep.over."excitation.omega"',
        [1.0, 2.0],
        names=r'sweep\.over=\{"excitation\.omega"=\.\.\.\}',
    )


@pytest.mark.parametrize(
    ("name", "value", "changes"),
    [
        ("material.young", -1.0, {"material.young": 2e11}),
        ("excitation.omega", 0.0, {"excitation.frequency": 100.0}),
        ("crack.length", 0.3, {"crack.length": 0.05}),
        ("crack.length", 0.3, {"crack": None, "contact": None}),
        ("crack.length", "half", {"geometry.width": 0.2, "crack.length": 0.1}),
    ],
)
def test_changes_are_made_before_the_check(
    name: str, value: object, changes: dict[str, object]
) -> None:
    """What is wrong in a file and changed is not complained of."""
    right_tables, tables = tomllib.loads(GOOD_TOML), tomllib.loads(GOOD_TOML)
    table, key = name.split(".")
    tables[table][key] = value
    catch_error(lambda: Scene.from_mapping(tables), name)
    scene = Scene.from_mapping(tables, changes=changes)
    assert scene == Scene.from_mapping(right_tables).replace(changes)


# --- refused --------------------------------------------------------------------------------------
BAD: list[tuple[str, dict[str, Any]]] = [
    # (the key that is named, what is changed): what tests/test_bad_input.py has no line for
    ("rubbish", {"rubbish": {"a": 1}}),
    ("excitation", {"excitation": GONE}),
    ("mesh.layout", {"mesh.layout": GONE}),
    ("material", {"material": 3.0}),
    ("crack", {"crack": [1, 2]}),
    # wrong types and numbers that are none, of each kind of key
    *(
        ("material.young", {"material.young": value})
        for value in ("2e9", True, math.nan, math.inf, 10**400, [2e9])
    ),
    ("geometry.width", {"geometry.width": -math.inf}),
    *(("mesh.columns", {"mesh.columns": value}) for value in (2.0, True, 10**400)),
    *(("mesh.order", {"mesh.order": value}) for value in (1.0, True)),
    ("mesh.layout", {"mesh.layout": 1}),
    ("mesh.layout", {"mesh.layout": "fine"}),
    ("excitation.point", {"excitation.point": (0.1, 0.1, 0.0)}),
    ("excitation.point", {"excitation.point": [0.1, math.nan]}),
    ("excitation.force_sin", {"excitation.force_sin": [100.0, "0"]}),
    ("excitation.force_cos", {"excitation.force_cos": [True, 0.0]}),
    *(("damping.modes", {"damping.modes": value}) for value in ("some", 1.5)),
    ("damping.ratio", {"damping.ratio": (0.1, -0.1)}),
    ("damping.ratio", {"damping.ratio": ()}),
    # out of bounds
    ("material.poisson", {"material.poisson": -1.0}),
    ("excitation.point", {"excitation.point": (0.1, -0.01)}),
    ("harmonic_balance.samples", {"harmonic_balance.samples": 20}),
    ("crack.height", {"crack.height": 0.0}),
    ("crack.height", {"crack.height": 0.06}),
    # exactly one stiffness, or none without penetration
    ("contact.sharpness", {"contact.sharpness": 1e6}),
    ("contact.stiffness", {"contact": {"law": "smoothed", "sharpness": 1e9}}),
    (
        "contact.stiffness",
        {"contact.stiffness_per_area": 1e12, "contact.law": "smoothed", "contact.sharpness": 1e9},
    ),
    ("contact.stiffness", {"contact.law": "unilateral"}),
    ("contact.stiffness_per_area", {"contact": {"law": "unilateral", "stiffness_per_area": 1e12}}),
    ("contact.sharpness", {"contact": {"law": "unilateral", "sharpness": 1e9}}),
    # a layer needs depth and share, the law "penalty", and with friction a tangential stiffness
    ("contact.layer_depth", {"contact.layer_share": 0.5}),
    ("contact.layer_share", {"contact.layer_depth": 1e-6}),
    ("contact.layer_depth", {"contact.layer_depth": 0.0, "contact.layer_share": 0.5}),
    *(
        ("contact.layer_share", {"contact.layer_depth": 1e-6, "contact.layer_share": share})
        for share in (0.0, 1.0, -0.5)
    ),
    (
        "contact.tangential_stiffness_per_area",
        {"contact.layer_depth": 1e-6, "contact.layer_share": 0.5, "contact.friction": 0.3},
    ),
    *(
        ("contact.layer_depth", {"contact": table | {"layer_depth": 1e-6, "layer_share": 0.5}})
        for table in (
            {"law": "unilateral"},
            {"law": "smoothed", "stiffness": 1e9, "sharpness": 1e9},
        )
    ),
    # exactly one way to give the damping
    ("damping.mass", {"damping.mass": 10.0}),
    ("damping.mass", {"damping.mass": 1e-6}),
    ("damping.modes", {"damping.stiffness": 1e-6, "damping.modes": 3}),
    ("damping.stiffness", {"damping": {"stiffness": -1e-9}}),
    ("damping.ratios", {"damping.ratios": (0.01, 0.02)}),
    ("damping.omegas", {"damping.omegas": (1.0, 2.0)}),
    ("damping.ratios", {"damping": {"mass": 10.0, "ratios": (0.01, 0.02), "omegas": (1.0, 2.0)}}),
    ("damping.omegas", {"damping": {"ratios": (0.01, 0.02)}}),
    ("damping.modes", {"damping": {"mass": 10.0, "modes": 20}}),
    ("damping.modes", {"damping": {"ratios": (0.1, 0.1), "omegas": (1.0, 2.0), "modes": 1}}),
    *(
        ("damping.ratios", {"damping": {"ratios": value, "omegas": (1.0, 2.0)}})
        for value in ((0.01,), (-0.01, 0.01), (0.01, 1.01), (0.021, 0.01))
    ),
    *(
        ("damping.omegas", {"damping": {"ratios": (0.01, 0.01), "omegas": value}})
        for value in ((1.0, 2.0, 3.0), (0.0, 1.0), "ab")
    ),
    # the crack and the layouts of the mesh
    ("crack.edge", {"crack.edge": "top"}),
    ("crack.length", GRADED | {"crack.first_omega": 2300.0}),
    ("crack.length", GRADED | {"crack.length": GONE}),
    ("mesh.rows", {"mesh.rows": GONE}),
    ("mesh.size", {"mesh.size": 0.01}),
    ("mesh.lip_elements", {"mesh.lip_elements": 3}),
    ("mesh.file", {"mesh.file": "plate.msh"}),
    ("mesh.columns", GRADED | {"mesh.columns": 2}),
    ("mesh.rows", GRADED | {"mesh.rows": 2}),
    ("mesh.file", FILE | {"mesh.file": GONE}),
    ("mesh.size", FILE | {"mesh.size": 0.01}),
    ("geometry.width", FILE | {"geometry.width": 0.1}),
    ("geometry.height", FILE | {"geometry.height": 0.1}),
    ("crack.edge", FILE | {"crack.edge": "left"}),
    ("crack.length", FILE | {"crack.length": 0.05}),
    ("crack.first_omega", FILE | {"crack.first_omega": 2300.0}),
]


@pytest.mark.parametrize(("key", "changes"), BAD, ids=[f"{k}-{i}" for i, (k, _) in enumerate(BAD)])
def test_bad_input_is_named(key: str, changes: dict[str, Any]) -> None:
    """A scene that cannot be used says which key, what was found there and what may stand there."""
    table, _, leaf = key.partition(".")
    given_table = changed(changes).get(table)
    value = given_table.get(leaf) if leaf and isinstance(given_table, dict) else given_table
    error = catch_error(lambda: Scene.from_mapping(changed(changes)), key, value)
    assert error.allowed
    text = str(error)
    assert error.key in text
    assert error.allowed.removeprefix("left out").removeprefix("given: ") in text
    assert "is missing" in text if error.value is None else repr(error.value) in text


@pytest.mark.parametrize("content", [None, b"[geometry", b"\xff\xfe\x00", b"", b"x = 1"])
def test_bad_file_is_named(content: bytes | None, tmp_path: Path) -> None:
    """A file that is missing, not TOML, not text or empty is refused with one InputError."""
    path = tmp_path / "scene.toml"
    if content is not None:
        path.write_bytes(content)
    key, value = {b"": ("geometry", None), b"x = 1": ("x", 1)}.get(content, ("scene", str(path)))
    catch_error(lambda: Scene.load(path), key, value)


# --- frozen, and changed copies -------------------------------------------------------------------
def test_scenes_are_frozen() -> None:
    """Neither the scene nor any key of any of its tables can be assigned."""
    scene = Scene.from_mapping(GOOD)
    for table in dataclasses.fields(scene):
        catch_error(partial(setattr, scene, table.name, None), kind=dataclasses.FrozenInstanceError)
        part = getattr(scene, table.name)
        for item in dataclasses.fields(part) if part else ():
            catch_error(
                partial(setattr, part, item.name, 1.0), kind=dataclasses.FrozenInstanceError
            )


def test_replace_changes_a_copy() -> None:
    """`replace` gives a validated copy with the named keys changed and leaves the scene alone."""
    scene = Scene.from_mapping(GOOD)
    changed_scene = scene.replace(
        {"contact.stiffness": 1e9, "damping.ratio": 0.01, "mesh.columns": 4, "mesh.rows": 4}
    )
    assert changed_scene == Scene.from_mapping(
        changed(
            {"contact.stiffness": 1e9, "damping.ratio": 0.01, "mesh.columns": 4, "mesh.rows": 4}
        )
    )
    assert scene == Scene.from_mapping(GOOD)


def test_replace_changes_the_kind_of_stiffness() -> None:
    """One stiffness takes the place of the other, or none is left, in one change."""
    scene = Scene.from_mapping(GOOD)
    by_area = scene.replace({"contact.stiffness": None, "contact.stiffness_per_area": 1e12})
    assert by_area == Scene.from_mapping(changed({"contact": {"stiffness_per_area": 1e12}}))
    rigid = scene.replace({"contact.stiffness": None, "contact.law": "unilateral"})
    assert (rigid.contact.stiffness, rigid.contact.stiffness_per_area) == (None, None)
    catch_error(lambda: scene.replace({"contact.stiffness": None}), "contact.stiffness", None)
    catch_error(
        lambda: scene.replace({"contact.stiffness_per_area": 1e12}), "contact.stiffness", 1e11
    )


def test_replace_removes_an_optional_table() -> None:
    """Without its crack a plate needs no contact."""
    scene = Scene.from_mapping(GOOD).replace({"crack": None, "contact": None})
    assert scene == Scene.from_mapping(changed({"crack": GONE, "contact": GONE}))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("contact.stifness", 1e9),
        ("contract.stiffness", 1e9),
        ("stiffness", 1e9),
        ("contact", {"stiffness": 1e9}),
        ("", 1.0),
        ("contact.", 1.0),
        ("contact.stiffness", -1.0),
        ("crack.length", 0.03),
    ],
)
def test_replace_refuses(key: str, value: object) -> None:
    """`replace` refuses keys that do not exist and values that a file could not give either."""
    catch_error(lambda: Scene.from_mapping(GOOD).replace({key: value}), key, value)


def test_replace_removes_no_needed_table() -> None:
    """`replace` shows the word for a removed table."""
    catch_error(lambda: Scene.from_mapping(GOOD).replace({"material": None}), "material", "none")


def test_replace_makes_a_missing_table() -> None:
    """A table that the scene does not have is made, with all that it needs, or refused."""
    scene = Scene.from_mapping(changed({"crack": GONE, "contact": GONE}))
    changed_scene = scene.replace({"curve.start": 1000.0, "curve.stop": 2000.0})
    assert (
        changed_scene.curve is not None
        and changed_scene.curve.parameter == "omega"
        and scene.curve is None
    )
    assert changed_scene.replace({"curve": None}) == scene
    catch_error(lambda: scene.replace({"curve.start": 1000.0}), "curve.stop")


# --- sweeps and files -----------------------------------------------------------------------------

OVER = {
    "excitation.omega": {"start": 1000, "stop": 3000, "count": 3},
    "contact.stiffness": {"start": 1e8, "stop": 1e10, "count": 3, "spacing": "logarithmic"},
    "excitation.force_sin": [[100, 0], [0.0, 50.0]],
    "crack.edge": ["left", "right"],
}


def test_axes_of_a_sweep() -> None:
    """Lists stay, spans are cut evenly or by equal ratios; their product is counted."""
    sweep = Scene.from_mapping(GOOD | {"sweep": {"over": OVER}}).sweep
    assert sweep is not None and sweep.n_cases == 3 * 3 * 2 * 2
    omega, stiffness, force, edge = sweep.over
    assert omega.values == (1000.0, 2000.0, 3000.0)
    assert stiffness.values == pytest.approx((1e8, 1e9, 1e10), rel=1e-12)
    assert force.values == ((100.0, 0.0), (0.0, 50.0)) and edge.values == ("left", "right")


@pytest.mark.parametrize(
    ("over", "key"),
    [
        ({}, "sweep.over"),
        (5, "sweep.over"),
        ({"omega": [1.0]}, "sweep.over"),
        ({"curve.start": [1.0]}, "sweep.over"),
        ({"crack.colour": [1.0]}, "sweep.over"),
        ({"crack.length": []}, 'sweep.over."crack.length"'),
        ({"crack.length": 0.04}, 'sweep.over."crack.length"'),
        ({"crack.length": {"start": 0.01, "stop": 0.02}}, 'sweep.over."crack.length"'),
        ({"crack.length": {"start": 0.01, "stop": 0.02, "count": 1}}, 'sweep.over."crack.length"'),
        (
            {"crack.clearance": {"start": -1, "stop": 1, "count": 3, "spacing": "logarithmic"}},
            'sweep.over."crack.clearance"',
        ),
        ({"crack.length": [0.05, -0.05]}, "crack.length"),
        ({"crack.length": [0.05, 0.05]}, 'sweep.over."crack.length"'),
        ({"crack.edge": ["left", "top"]}, "crack.edge"),
    ],
)
def test_bad_axes_are_named(over: object, key: str) -> None:
    """What cannot be swept is named."""
    catch_error(lambda: Scene.from_mapping(GOOD | {"sweep": {"over": over}}), key)


def test_axes_made_in_python() -> None:
    """Values of NumPy's kinds are taken as numbers; empty and repeated axes are refused."""
    scene = Scene.from_mapping(GOOD)
    over = {"crack.length": [1.0], "harmonic_balance.harmonics": [1]}
    sweep = scene.replace({"sweep.over": over}).sweep
    axis, count = (
        dataclasses.replace(axis, values=values)
        for axis, values in zip(
            sweep.over, (np.array([0.04, 0.05]), tuple(np.arange(2, 4))), strict=True
        )
    )
    swept_scene = scene.replace({"sweep.over": (axis, count)})
    assert swept_scene.sweep is not None and swept_scene.sweep.over[1].values == (2, 3)
    assert Scene.from_text(swept_scene.as_toml()) == swept_scene
    empty_axis = dataclasses.replace(axis, values=())
    for wrong_axes, key, value in (
        ((axis, axis), "sweep.over", "crack.length"),
        ((empty_axis,), 'sweep.over."crack.length"', ()),
    ):
        catch_error(partial(scene.replace, {"sweep.over": wrong_axes}), key, value)


def test_rayleigh_damping_is_swept() -> None:
    """Its keys are swept like any other, and the way to give the damping is changed as a whole."""
    scene = Scene.from_mapping(GOOD)
    rayleigh = scene.replace({"damping.ratio": None, "damping.mass": 10})
    assert (rayleigh.damping.mass, rayleigh.damping.stiffness) == (10.0, None)
    over = {"damping.mass": [1, 2.0], "damping.stiffness": [0.0, 1e-6]}
    swept_scene = rayleigh.replace({"sweep.over": over})
    assert swept_scene.sweep is not None and swept_scene.sweep.over[0].values == (1.0, 2.0)
    assert Scene.from_text(swept_scene.as_toml()) == swept_scene
    two = {"damping.mass": None, "damping.ratios": [0.01, 0.02], "damping.omegas": [1.0, 2.0]}
    changed_scene = rayleigh.replace(two)
    assert changed_scene.damping.ratios == (0.01, 0.02)
    assert Scene.from_text(changed_scene.as_toml()) == changed_scene


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"ratio": 0.01}, True),
        ({"ratio": 0.0}, False),
        ({"ratio": [0.1, 0.0]}, False),
        ({"ratio": 0.01, "modes": 20}, False),
        ({"mass": 1.0}, True),
        ({"stiffness": 1e-6}, True),
        ({"mass": 0.0, "stiffness": 0.0}, False),
        ({"ratios": [0.1, 0.1], "omegas": [1.0, 2.0]}, True),
        ({"ratios": [0.0, 0.0], "omegas": [1.0, 2.0]}, False),
    ],
)
def test_damping_of_all_modes(table: dict[str, Any], expected: bool) -> None:
    """Rayleigh's, and a ratio for all."""
    assert Scene.from_mapping(changed({"damping": table})).damping.damps_all_modes is expected


def test_swept_mesh_files_lie_beside_the_scene(tmp_path: Path) -> None:
    """As ``mesh.file`` does."""
    tables = {key: GOOD[key] for key in ("material", "damping", "excitation", "contact")}
    tables |= {"geometry": {"thickness": 1.0}, "mesh": {"layout": "file", "file": "a.msh"}}
    tables["sweep"] = {"over": {"mesh.file": ["a.msh", "b.msh"]}}
    scene = Scene.from_mapping(tables, tmp_path)
    files = [str(tmp_path / name) for name in ("a.msh", "a.msh", "b.msh")]
    assert scene.mesh.file == files[0] and scene.sweep is not None
    assert list(scene.sweep.over[0].values) == files[1:]


@pytest.mark.parametrize("path", sorted((ROOT / "demos").glob("*.toml")), ids=lambda p: p.stem)
def test_scene_as_toml_reads_back(path: Path) -> None:
    """What is written is the same scene; with every optional table, too."""
    scene = Scene.load(path)
    if scene.crack is not None and scene.mesh.layout != "file":
        scene = scene.replace(
            {
                "sweep.over": {key: OVER[key] for key in ("excitation.omega", "crack.edge")},
                "curve.start": 1.5, "curve.stop": 2, "curve.stability": False,
                "integration.method": "events",
                "damping.ratio": [0.1, 0.2], "damping.modes": 2,
            }
            | ({} if scene.disk else {"reduction.modes": 7})
        )  # fmt: skip
    assert Scene.from_mapping(tomllib.loads(scene.as_toml())) == scene


# --- anything at all ------------------------------------------------------------------------------
KEYS = [(table, key) for table, keys in GOOD.items() for key in keys] + [
    ("crack", "first_omega"), ("crack", "clearance"), ("damping", "modes"),
    ("damping", "mass"), ("damping", "stiffness"), ("damping", "ratios"), ("damping", "omegas"),
    ("contact", "law"),
    ("contact", "sharpness"), ("contact", "layer_depth"), ("contact", "layer_share"),
    ("contact", "pairs"), ("contact", "stiffness_per_area"),
    ("excitation", "frequency"), ("crack", "first_frequency"), ("damping", "frequencies"),
    ("mesh", "cells"), ("mesh", "order"),
    ("mesh", "size"), ("mesh", "lip_elements"), ("mesh", "grading"), ("mesh", "file"),
    ("excitation", "force_cos"), ("excitation", "force_mean"), ("harmonic_balance", "samples"),
]  # fmt: skip
LEAVES = st.one_of(
    st.booleans(),
    st.integers(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.text(),
    st.sampled_from(
        ["left", "right", "all", "grid", "graded", "file", "smoothed", "unilateral", "mouth"]
    ),
    st.datetimes(),
    st.dates(),
    st.times(),
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
)


@settings(max_examples=100)
@given(
    leaves=st.dictionaries(st.sampled_from(KEYS), VALUES, min_size=1, max_size=3),
    tables=st.dictionaries(st.sampled_from(sorted(GOOD)) | st.text(), VALUES, max_size=1),
)
def test_any_values_give_a_scene_or_an_input_error(
    leaves: dict[tuple[str, str], Any], tables: dict[str, Any]
) -> None:
    """Whatever TOML can hold in whatever place, the only exception is InputError."""
    mapping: dict[str, Any] = copy.deepcopy(GOOD)
    for (table, key), value in leaves.items():
        mapping[table][key] = value
    mapping |= tables
    try:
        assert isinstance(Scene.from_mapping(mapping), Scene)
    except InputError as error:
        allowed_text = error.allowed.removeprefix("left out").removeprefix("given: ")
        assert allowed_text and allowed_text in str(error)
