"""Plane cracks in many parts: each is meshed, split and vibrates; K against closed forms."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from fatigue.test_ellipse import newman_raju
from helpers import gmsh_model
from mpi4py import MPI
from scipy.integrate import dblquad
from scipy.special import ellipe
from surroundings import ROOT

import fenics_crack as fc

pytestmark = pytest.mark.nightly
TEXT = """
geometry.kind = "solid"
geometry.file = "PART"
geometry.faces.clamp = [CLAMP]
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = LOAD, force_sin = [0.0, 0.0, 0.1], frequency = 100.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", size = SIZE, lip_elements = 4, error = false }
"""
RADIAL, TANGENT = [0.951, 0.309, 0.0], [-0.309, 0.951, 0.0]
Y, X, Z = [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]


def blade(occ: Any) -> None:
    gmsh.merge(str(ROOT / "meshes" / "step_blade.geo"))


def foil(occ: Any) -> None:
    """An extruded aerofoil with blunt edges."""
    s = np.linspace(0.0, 1.0, 7)
    camber, half = 8.0 * s * (1.0 - s), 0.4 + 7.0 * s * (1.0 - s)
    sides = [
        [occ.addPoint(30.0 * a - 15.0, 0.0, b) for a, b in zip(s, line, strict=True)]
        for line in (camber + half, camber - half)
    ]
    upper_spline, lower_spline = map(occ.addSpline, sides)
    ends = occ.addLine(sides[0][-1], sides[1][-1]), occ.addLine(sides[1][0], sides[0][0])
    face = occ.addPlaneSurface([occ.addCurveLoop([upper_spline, ends[0], -lower_spline, ends[1]])])
    occ.extrude([(2, face)], 0, 100, 0)


def sector(occ: Any) -> None:
    """A tenth of a disk with a bore of 30 mm and a radius of 100 mm."""
    wedge = [(3, occ.addCylinder(0, 0, 0, 0, 0, 12, 100, angle=0.2 * math.pi))]
    occ.cut(wedge, [(3, occ.addCylinder(0, 0, -1, 0, 0, 14, 30))])


def shaft(occ: Any) -> None:
    """A shaft of 30 mm with a keyway."""
    occ.cut([(3, occ.addCylinder(0, 0, 0, 0, 160, 0, 15))], [(3, occ.addBox(-4, 60, 11, 8, 40, 6))])


def bracket(occ: Any) -> None:
    """An angle with two bolt holes and a rounded inner corner."""
    plates = [(3, occ.addBox(0, 0, 0, 40, 8, 60)), (3, occ.addBox(0, 0, 0, 40, 70, 8))]
    bracket_solid, _ = occ.fuse(plates[:1], plates[1:])
    holes = [(3, occ.addCylinder(x, -1, 45, 0, 10, 0, 4)) for x in (12, 28)]
    bracket_solid, _ = occ.cut(bracket_solid, holes)
    occ.synchronize()
    inner_edges = gmsh.model.getEntitiesInBoundingBox(-1, 7, 7, 41, 9, 9, 1)
    occ.fillet([bracket_solid[0][1]], [inner_edges[0][1]], [5.0])


PARTS: dict[str, tuple[Callable[[Any], Any], list[float], list[float], float]] = {
    "box": (lambda occ: occ.addBox(0, 0, 0, 30, 90, 6), [15, 0, 3], [0, 90, 3], 6),
    "rod": (lambda occ: occ.addCylinder(0, 0, 0, 0, 200, 0, 10), [0, 0, 0], [0, 200, 0], 8),
    "foil": (foil, [0, 0, 2], [0, 100, 2], 4),
    "blade": (blade, [0, -10, 0], [0, 80, 1], 4),
    "sector": (sector, [93, 30, 6], [24, 17.5, 6], 8),
    "shaft": (shaft, [0, 0, 0], [0, 160, 0], 8),
    "bracket": (bracket, [20, 0, 30], [20, 70, 4], 6),
}
"""How a part is drawn, a point of its clamp, its load, its size of elements [mm]."""


def ellipse(point: list[float], normal: Any, direction: Any, radii: list[float]) -> dict[str, Any]:
    return {"point": point, "normal": normal, "direction": direction, "radii": radii}


def through(point: list[float], normal: Any, direction: Any) -> dict[str, Any]:
    return {"point": point, "normal": normal, "direction": direction, "front": "through"}


HALF = ellipse([15, 30, 6], Y, X, [8, 3])
CASES: dict[str, tuple[str, list[dict[str, Any]]]] = {
    "half": ("box", [HALF]),
    "corner": ("box", [ellipse([0, 30, 6], Y, X, [8, 3])]),
    "penny": ("box", [ellipse([15, 30, 3], Y, X, [2, 2])]),
    "through": ("box", [through([12, 30, 3], Y, X)]),
    "inclined": ("box", [ellipse([15, 30, 6], [0.5, 1.0, 0.0], X, [8, 3])]),
    "two": ("box", [HALF, ellipse([0, 60, 6], Y, X, [6, 3])]),
    "rod": ("rod", [through([0, 100, -5], Y, Z)]),
    "rod, round": ("rod", [ellipse([10, 100, 0], Y, Z, [6, 4])]),
    "foil, edge": ("foil", [through([-9, 30, 1], Y, X)]),
    "foil, face": ("foil", [ellipse([0, 30, 4.15], Y, X, [5, 1.8])]),
    "blade, edge": ("blade", [through([-10, 30, -3], Y, X)]),
    "blade, face": ("blade", [ellipse([-3.16, 20, 4.1], Y, [1.0, 0.0, 0.1], [4, 1.5])]),
    "blade, fillet": ("blade", [ellipse([-15, 1.2, -1.0], Y, X, [5, 4])]),
    "blade, steep": ("blade", [ellipse([-14, 40, -4], [0.3, 1.0, 0.2], X, [5, 4])]),
    "blade, tip": ("blade", [ellipse([-13, 77, -5], Y, X, [5, 4])]),
    "sector, bore": ("sector", [ellipse([28.5, 9.27, 12], TANGENT, RADIAL, [6, 4])]),
    "sector, through": ("sector", [through([38.0, 12.36, 6], TANGENT, RADIAL)]),
    "sector, side": ("sector", [ellipse([60, 20, 12], TANGENT, RADIAL, [8, 4])]),
    "shaft, keyway": ("shaft", [ellipse([0, 80, 11], Y, X, [3, 2])]),
    "shaft, corner of the keyway": ("shaft", [ellipse([4, 80, 11], Y, X, [2, 2])]),
    "shaft, outside": ("shaft", [ellipse([0, 120, -15], Y, X, [8, 5])]),
    "shaft, slant": ("shaft", [ellipse([15, 40, 0], [1.0, 1.0, 0.0], Z, [6, 5])]),
    "bracket, corner": ("bracket", [ellipse([20, 9.5, 9.5], [0.0, 1.0, -1.0], X, [6, 2.5])]),
    "bracket, hole": ("bracket", [ellipse([16, 4, 45], Z, Y, [3, 2])]),
    "bracket, leg": ("bracket", [through([8, 40, 4], Y, X)]),
}  # fmt: skip
"""Parts and their cracks [mm]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All parts."""
    parts_folder = tmp_path_factory.mktemp("parts")
    with gmsh_model() as model:
        write_parts(parts_folder, model)
    return parts_folder


def write_parts(parts_folder: Path, model: Any) -> None:
    """Write all parts to STEP files in a folder."""
    for name, (draw, *_) in PARTS.items():
        model.add(name)
        draw(model.occ)
        model.occ.synchronize()
        gmsh.write(str(parts_folder / f"{name}.step"))
        model.remove()


def scene_of(folder: Path, case: str) -> fc.Scene:
    """The scene of a case."""
    part, cracks = CASES[case]
    _, clamp, load, size = PARTS[part]
    words = {
        "PART": str(folder / f"{part}.step"), "CLAMP": str([1e-3 * x for x in clamp]),
        "LOAD": str([1e-3 * x for x in load]), "SIZE": str(1e-3 * size),
    }  # fmt: skip
    text = TEXT
    for word, value in words.items():
        text = text.replace(word, value)
    changes: dict[str, Any] = {}
    for number, crack in enumerate(cracks):
        name = f"cracks.{number}" if number else "crack"
        for key, value in crack.items():
            value = [1e-3 * x for x in value] if key in ("point", "radii") else value
            changes[f"{name}.{key}"] = value
    return fc.Scene.from_text(text).replace(changes)


@pytest.mark.parametrize("case", CASES)
def test_a_part_with_cracks_vibrates(folder: Path, case: str) -> None:
    """It is meshed within a minute of processor time; cracks make it softer, and bonded faces do
    not."""
    scene, start_time = scene_of(folder, case), time.process_time()
    structure = fc.build_structure(scene, MPI.COMM_SELF)
    assert structure.n_pairs > 3 * len(CASES[case][1])
    open_omega, bonded_omega = (
        fc.solve_modes(structure, 1, lips=lips).omega[0] for lips in ("open", "tied")
    )
    without_cracks = {"crack": None, "cracks": None, "contact": None}
    uncracked_omega = fc.solve_modes(
        fc.build_structure(scene.replace(without_cracks), MPI.COMM_SELF), 1
    ).omega[0]
    assert open_omega < bonded_omega * (1.0 + 1e-6)
    assert bonded_omega < 1.004 * uncracked_omega
    assert bonded_omega == pytest.approx(uncracked_omega, rel=0.03)
    assert time.process_time() - start_time < 120.0


def rod_flexibility(depth: float, radius: float, young: float, poisson: float) -> float:
    """Rotation per moment that a straight crack adds to a rod [rad/(N m)]: strips in plane strain
    (Dimarogonas and Papadopoulos, Journal of Sound and Vibration 91, 1983, 583)."""

    def density(y: float, x: float) -> float:
        height = 2.0 * math.sqrt(radius**2 - x**2)
        turn = 0.5 * math.pi * y / height
        shape = math.sqrt(math.tan(turn) / turn) / math.cos(turn)
        shape *= 0.923 + 0.199 * (1.0 - math.sin(turn)) ** 4
        return 0.25 * height**2 * math.pi * y * shape**2

    chord_height = radius - depth
    half = math.sqrt(radius**2 - chord_height**2)
    total, _ = dblquad(
        density,
        -half,
        half,
        lambda x: 1e-9 * radius,
        lambda x: math.sqrt(radius**2 - x**2) - chord_height,
    )
    return 2.0 * (1.0 - poisson**2) / young * 16.0 / (math.pi**2 * radius**8) * total


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5])
def test_a_rod_with_a_straight_crack(folder: Path, share: float) -> None:
    """The square of its first frequency falls by the flexibility of strips: to 10 %."""
    radius, length = 0.01, 0.2
    changes = {
        "crack.point": [0.0, 0.1, 2.0 * radius * share - radius], "mesh.lip_elements": 6,
        "mesh.size": 0.006, "mesh.per_turn": 16,
    }  # fmt: skip
    structure = fc.build_structure(scene_of(folder, "rod").replace(changes), MPI.COMM_SELF)
    open_omega, bonded_omega = (
        fc.solve_modes(structure, 1, lips=lips).omega[0] for lips in ("open", "tied")
    )
    k = 1.8751041 / length
    sigma = (math.cosh(1.8751041) + math.cos(1.8751041)) / (
        math.sinh(1.8751041) + math.sin(1.8751041)
    )
    x = np.append(np.linspace(0.0, length, 2001), 0.5 * length)
    bend = np.cosh(k * x) + np.cos(k * x) - sigma * (np.sinh(k * x) + np.sin(k * x))
    stiffness = 2.1e11 * 0.25 * math.pi * radius**4
    added_share = (
        rod_flexibility(2.0 * radius * share, radius, 2.1e11, 0.3) * stiffness * bend[-1] ** 2
    )
    exact_shift = added_share / (length * np.mean(bend[:-1] ** 2))
    assert (bonded_omega / open_omega) ** 2 - 1.0 == pytest.approx(exact_shift, rel=0.1)


PULL = 1e8
BLOCK = """
geometry = { kind = "solid", width = 0.08, height = 0.2, thickness = 0.08 }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.1 }
excitation = { omega = 10.0 }
loads = [{ edge = "top", traction_mean = [0.0, 1e8, 0.0], traction_cos = [0.0, 1e5, 0.0] }]
contact = { law = "unilateral", friction_error = false }
harmonic_balance = { harmonics = 1, error = false }
reduction = { method = "massless", modes = 5 }
mesh = { layout = "graded", size = 0.02, lip_elements = 5, grading = 2.0, error = false }
"""


@pytest.mark.parametrize(("radii", "angle"), [((0.006, 0.006), 30.0), ((0.008, 0.004), 20.0)])
def test_a_tilted_ellipse_in_a_block(radii: tuple[float, float], angle: float) -> None:
    """K_I of an embedded ellipse under s cos^2 across it (Irwin), 1.5 % rms of all stations. The
    block is clamped at its lower side, far from the crack."""
    turn = math.radians(angle)
    crack = {
        "crack.point": [0.04, 0.1, 0.04], "crack.normal": [math.sin(turn), math.cos(turn), 0.0],
        "crack.direction": [0.0, 0.0, 1.0], "crack.radii": list(radii),
    }  # fmt: skip
    scene = fc.Scene.from_text(BLOCK).replace(crack)
    intensity = fc.stress_intensity(fc.solve(scene, MPI.COMM_SELF))
    a, b = radii
    e = 1.0 - (b / a) ** 2
    middle = np.array(crack["crack.point"])
    frame = scene.crack.frame  # type: ignore[union-attr]
    x, y, _ = ((np.array(intensity.points) - middle) @ frame.T).T
    sine, cosine = y / b, x / a
    exact = PULL * math.cos(turn) ** 2 * math.sqrt(math.pi * b) / ellipe(e)
    exact = exact * (sine**2 + (b / a) ** 2 * cosine**2) ** 0.25
    ratio = intensity.max_K_I_by_tip / exact
    assert np.sqrt(((ratio - 1.0) ** 2).mean()) < 0.015


@pytest.mark.parametrize(
    "radii", [(0.003, 0.0018), (0.003, 0.003), (0.005, 0.002), (0.002, 0.0025)]
)
def test_a_half_ellipse_in_a_pulled_plate(folder: Path, radii: tuple[float, float]) -> None:
    """K_I of a STEP plate's half ellipse at all stations but the ends: Newman's and Raju's
    to 5 %."""
    plate = dict.fromkeys(f"geometry.{side}" for side in ("width", "height", "thickness"))
    plate |= {"geometry.file": str(folder / "box.step"), "mesh.size": 0.006}
    plate |= {"geometry.faces": {"clamp": [[0.015, 0.0, 0.003]], "top": [[0.015, 0.09, 0.003]]}}
    crack = {"crack.point": [0.015, 0.045, 0.006], "crack.normal": Y, "crack.direction": X}
    scene = fc.Scene.from_text(BLOCK).replace(plate | crack | {"crack.radii": list(radii)})
    solution = fc.stress_intensity(fc.solve(scene, MPI.COMM_SELF))
    half_length, depth = map(np.array, radii)
    sines = [(0.006 - point[2]) / depth for point in solution.points[1:-1]]
    newman_raju_values = [newman_raju(depth, half_length, sine, PULL, 0.0) for sine in sines]
    np.testing.assert_allclose(solution.max_K_I_by_tip[1:-1], newman_raju_values, rtol=0.05)
