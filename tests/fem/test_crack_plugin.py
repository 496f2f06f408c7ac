"""Mesh files whose cracks gmsh's plugin made: nodes along the curve ``crack`` exist twice."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from helpers import ROOT, gmsh_model
from mpi4py import MPI
from test_mesh import area, file_plate, pair_nodes

from fenics_crack import InputError, build_structure
from fenics_crack.fem.plate import build_mesh

WIDTH, HEIGHT = 2.0, 1.0
CURVES: dict[str, list[tuple[float, float]]] = {
    "edge": [(0.0, 0.4), (0.8, 0.7)],
    "bent": [(0.0, 0.4), (0.5, 0.4), (0.8, 0.7)],
    "right": [(2.0, 0.5), (1.2, 0.6)],
    "vertical": [(1.0, 1.0), (1.0, 0.6)],
    "inside": [(0.6, 0.3), (1.4, 0.6)],
    "upright": [(0.8, 0.7), (0.8, 0.3)],
    "arc": [(0.6, 0.3), (1.0, 0.7), (1.4, 0.3)],
}
"""The first point is a mouth where it lies on the edge of the plate. The arc has its middle
between its ends."""


@pytest.fixture
def plugin(tmp_path: Path) -> Callable[..., Path]:
    """Write a 2 x 1 plate, clamped below, with embedded cracks doubled by the plugin."""

    def write(
        *cracks: str,
        order: int = 1,
        quadrilaterals: bool = False,
        run: bool = True,
        mouth: bool = True,
        one_group: bool = False,
        outline: bool = False,
    ) -> Path:
        path = tmp_path / "plugin.msh"
        with gmsh_model() as model:
            geo = model.geo
            corners = [(0.0, 0.0), (WIDTH, 0.0), (WIDTH, HEIGHT), (0.0, HEIGHT)]
            mouths = [CURVES[name][0] for name in cracks if _on_edge(*CURVES[name][0])]
            ring = sorted(corners + mouths, key=_around)
            place = {xy: geo.addPoint(*xy, 0.0, 0.2) for xy in ring}
            sides = [
                geo.addLine(place[a], place[b])
                for a, b in zip(ring, ring[1:] + ring[:1], strict=True)
            ]
            surface = geo.addPlaneSurface([geo.addCurveLoop(sides)])
            curves = {}
            for name in cracks:
                ends = [place.get(xy) or geo.addPoint(*xy, 0.0, 0.1) for xy in CURVES[name]]
                if name == "arc":
                    middle = geo.addPoint(1.0, 0.3, 0.0, 0.1)
                    pairs = itertools.pairwise(ends)
                    curves[name] = [geo.addCircleArc(a, middle, b) for a, b in pairs]
                else:
                    pairs = itertools.pairwise(ends)
                    curves[name] = [geo.addLine(a, b) for a, b in pairs]
            geo.synchronize()
            model.mesh.embed(1, [c for own in curves.values() for c in own], 2, surface)
            if quadrilaterals:
                model.mesh.setRecombine(2, surface)
            _name(model, 2, [surface], 1, "plate")
            _name(model, 1, [sides[0]], 2, "clamp")
            if outline:
                _name(model, 1, sides, 4, "outline")
            _name(model, 0, [place[2.0, 1.0]], 3, "load")
            if one_group:
                groups = {"crack": [c for own in curves.values() for c in own]}
            else:
                groups = {f"crack {n}": own for n, own in enumerate(curves.values(), 1)}
            for tag, (name, own) in enumerate(groups.items(), 10):
                _name(model, 1, own, tag, name)
            if mouths:
                _name(model, 0, [place[xy] for xy in mouths], 5, "mouth")
            model.mesh.generate(2)
            model.mesh.setOrder(order)
            for tag in range(10, 10 + len(groups)) if run else ():
                gmsh.plugin.setNumber("Crack", "Dimension", 1)
                gmsh.plugin.setNumber("Crack", "PhysicalGroup", tag)
                opened = 5 if mouths and mouth else 0
                gmsh.plugin.setNumber("Crack", "OpenBoundaryPhysicalGroup", opened)
                gmsh.plugin.run("Crack")
            gmsh.write(str(path))
        return path

    return write


def _name(model: Any, dimension: int, tags: list[int], group: int, name: str) -> None:
    model.addPhysicalGroup(dimension, tags, group)
    model.setPhysicalName(dimension, group, name)


def _on_edge(x: float, y: float) -> bool:
    return x in (0.0, WIDTH) or y in (0.0, HEIGHT)


def _around(place: tuple[float, float]) -> float:
    """Distance along the edge of the plate from its lower left corner, against the clock."""
    x, y = place
    if y == 0.0:
        return x
    if x == WIDTH:
        return WIDTH + y
    return WIDTH + HEIGHT + (WIDTH - x if y == HEIGHT else WIDTH + HEIGHT - y)


@pytest.mark.parametrize(
    ("name", "order", "quadrilaterals"),
    [(name, 1, False) for name in CURVES]
    + [("edge", 1, True), ("edge", 2, False), ("arc", 2, True)],
)
def test_lips_of_the_plugin(
    plugin: Callable[..., Path], name: str, order: int, quadrilaterals: bool
) -> None:
    """Pairs are two nodes in one place, along the curve in order; normals point up or right."""
    path = plugin(name, order=order, quadrilaterals=quadrilaterals)
    corners = np.array(CURVES[name])
    scene = file_plate(path, **{"mesh.order": order})
    np.testing.assert_allclose(area(scene), WIDTH * HEIGHT, rtol=1e-3 if name == "arc" else 1e-9)
    [lip] = build_mesh(scene, MPI.COMM_SELF).lips
    assert lip.has_mouth == _on_edge(*CURVES[name][0])
    structure = build_structure(scene)
    elements = len(lip.points) - 1
    assert structure.n_pairs == elements * order - (not lip.has_mouth)
    _, _, normals = pair_nodes(structure) if name not in ("vertical", "upright") else (0, 0, None)
    points, positions = structure.pair_points, structure.pairs.positions
    assert points is not None and positions is not None and structure.nodes is not None
    assert np.all(np.diff(positions) > 0.0)
    if name == "arc":
        radial = (points - [1.0, 0.3]) / 0.4
        np.testing.assert_allclose(np.linalg.norm(radial, axis=1), 1.0, atol=0.02)
        assert np.all(np.sum(normals * radial, axis=1) > 0.99)
        np.testing.assert_allclose(positions[-1], 0.4 * np.pi, rtol=0.2)
        return
    first = corners[0]
    if not lip.has_mouth and tuple(corners[-1]) < tuple(first):
        first = corners[-1]
    if len(corners) == 2:
        np.testing.assert_allclose(np.linalg.norm(points - first, axis=1), positions, atol=1e-9)
        along = corners[1] - corners[0]
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        upright = name in ("vertical", "upright")
        normal *= np.sign(normal[0] if upright else normal[1])
        gap = structure.gap.toarray()
        padded = np.concatenate([gap, np.zeros((1, gap.shape[1]))])
        nodal = padded[structure.nodes.dofs]
        for pair in range(structure.n_pairs):
            for node in np.flatnonzero(np.any(nodal[:, :, pair] != 0.0, axis=1)):
                np.testing.assert_allclose(structure.nodes.points[node], points[pair], atol=1e-9)
                direction = nodal[node, :, pair] @ normal
                np.testing.assert_allclose(abs(direction), 1.0, rtol=1e-9)


def test_several_cracks_of_the_plugin(plugin: Callable[..., Path]) -> None:
    """Two groups or one: the same cracks, from bottom to top; a clearance for each."""
    two = build_structure(file_plate(plugin("vertical", "upright")))
    one = build_structure(file_plate(plugin("vertical", "upright", one_group=True)))
    np.testing.assert_allclose(one.pair_points, two.pair_points, atol=1e-12)
    assert list(two.watched_pairs) == ["the middle of crack 1", "the mouth of crack 2"]
    np.testing.assert_allclose(two.pair_points[list(two.watched_pairs.values())[1]], [1.0, 1.0])
    both = {"crack.clearance": 1e-6, "cracks.1.clearance": 2e-6}
    scene = file_plate(plugin("vertical", "upright"), **both)
    structure = build_structure(scene)
    expected = np.where(structure.pairs.cracks == 0, 1e-6, 2e-6)
    np.testing.assert_array_equal(structure.clearance, expected)
    with pytest.raises(InputError, match="each of the 2 cracks of the mesh file"):
        build_structure(scene.replace({"cracks.2.clearance": 0.0}))


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"run": False}, "edges of the curve 'crack' have their nodes once.*Plugin.Crack. of gmsh"),
        ({"mouth": False}, r"a mouth at \(0, 0.4\) that is closed.*OpenBoundaryPhysicalGroup"),
    ],
    ids=str,
)
def test_the_refusal_says_how(plugin: Callable[..., Path], how: dict[str, Any], words: str) -> None:
    """Nodes that exist once, all of them or the mouth's, are refused with the plugin's options."""
    with pytest.raises(InputError, match=words) as caught:
        build_mesh(file_plate(plugin("edge", **how)), MPI.COMM_SELF)
    assert caught.value.key == "lips"


def test_example_of_the_plugin(tmp_path: Path) -> None:
    """The .geo file of the documentation gives two cracks, one bent at the edge, one inside."""
    path = tmp_path / "plate.msh"
    with gmsh_model():
        gmsh.merge(str(ROOT / "meshes" / "crack_plugin.geo"))
        gmsh.write(str(path))
    made = build_mesh(file_plate(path), MPI.COMM_SELF)
    ends = [(lip.points[0], lip.points[-1], lip.has_mouth) for lip in made.lips]
    np.testing.assert_allclose(ends[0][:2], [(0.0, 0.06), (0.04, 0.05)], atol=1e-12)
    np.testing.assert_allclose(ends[1][:2], [(0.05, 0.09), (0.08, 0.1)], atol=1e-12)
    assert [end[2] for end in ends] == [True, False]
    assert made.points["load"] == (0.1, 0.12) and made.points["mouth"] == (0.0, 0.06)
    structure = build_structure(file_plate(path))
    assert structure.pair_areas is not None
    lengths = 0.02 + np.hypot(0.02, 0.01) + np.hypot(0.03, 0.01)
    np.testing.assert_allclose(structure.pair_areas.sum(), 0.01 * lengths, rtol=0.05)


def test_text_of_the_documentation(tmp_path: Path) -> None:
    """The .geo file in docs/extend.md, as it stands there, is a plate with an edge crack."""
    [text] = re.findall(r"```geo\n(.*?)```", (ROOT / "docs" / "extend.md").read_text(), re.S)
    source, path = tmp_path / "plate.geo", tmp_path / "plate.msh"
    source.write_text(text)
    with gmsh_model():
        gmsh.merge(str(source))
        gmsh.write(str(path))
    structure = build_structure(file_plate(path))
    np.testing.assert_allclose(structure.pair_points[0], (0.0, 0.06), atol=1e-12)
    assert structure.pairs.positions is not None and structure.watched_pairs == {"the mouth": 0}
    assert 0.9 * np.hypot(0.04, 0.01) < structure.pairs.positions[-1] < np.hypot(0.04, 0.01)


def test_named_points_and_curves(plugin: Callable[..., Path]) -> None:
    """All of them, and curves that share edges too; a clamp may also be part of an outline."""
    made = build_mesh(file_plate(plugin("edge")), MPI.COMM_SELF)
    assert made.points == {"load": (2.0, 1.0), "mouth": (0.0, 0.4)}
    assert made.groups.keys() == {"clamp", "lower_lip", "upper_lip"}
    made = build_mesh(file_plate(plugin("edge", outline=True)), MPI.COMM_SELF)
    counts = {name: len(made.facets(name)) for name in made.groups}
    assert counts["outline"] > counts["clamp"] > 0
    assert set(made.facets("clamp")) < set(made.facets("outline"))
    assert build_structure(file_plate(plugin("edge", outline=True))).n_pairs > 0
