"""Mesh files: cracks along curves, whether gmsh's plugin has doubled the nodes there or not; meshes
that cannot be those of a structure, which are refused with the place."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from helpers import ROOT, catch_error, gmsh_model
from mpi4py import MPI
from test_mesh import area, file_plate, pair_nodes

from fenics_crack import build_structure, solve_modes
from fenics_crack.fem.msh_file import (
    check_cells,
    check_parts_are_clamped,
    check_parts_do_not_overlap,
    load_mesh_into_gmsh,
    make_cells_of_kind,
)
from fenics_crack.fem.plate import build_plate_or_solid_mesh

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
            model.mesh.embed(
                1, [c for crack_curves in curves.values() for c in crack_curves], 2, surface
            )
            if quadrilaterals:
                model.mesh.setRecombine(2, surface)
            _name(model, 2, [surface], 1, "plate")
            _name(model, 1, [sides[0]], 2, "clamp")
            if outline:
                _name(model, 1, sides, 4, "outline")
            _name(model, 0, [place[2.0, 1.0]], 3, "load")
            if one_group:
                groups = {"crack": [c for crack_curves in curves.values() for c in crack_curves]}
            else:
                groups = {
                    f"crack {n}": crack_curves for n, crack_curves in enumerate(curves.values(), 1)
                }
            for tag, (name, crack_curves) in enumerate(groups.items(), 10):
                _name(model, 1, crack_curves, tag, name)
            if mouths:
                _name(model, 0, [place[xy] for xy in mouths], 5, "mouth")
            model.mesh.generate(2)
            model.mesh.setOrder(order)
            for tag in range(10, 10 + len(groups)) if run else ():
                gmsh.plugin.setNumber("Crack", "Dimension", 1)
                gmsh.plugin.setNumber("Crack", "PhysicalGroup", tag)
                opened_group = 5 if mouths and mouth else 0
                gmsh.plugin.setNumber("Crack", "OpenBoundaryPhysicalGroup", opened_group)
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


@pytest.mark.drawn(5)
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
    structure = build_structure(scene)
    rtol = 1e-3 if name == "arc" else 1e-9
    np.testing.assert_allclose(area(structure), WIDTH * HEIGHT, rtol=rtol)
    [lip] = build_plate_or_solid_mesh(scene, MPI.COMM_SELF).crack_paths_or_surfaces
    assert lip.has_mouth == _on_edge(*CURVES[name][0])
    elements = len(lip.points) - 1
    assert structure.n_pairs == elements * order - (not lip.has_mouth)
    _, _, normals = pair_nodes(structure) if name not in ("vertical", "upright") else (0, 0, None)
    points, positions = structure.pair_points, structure.pairs.positions
    assert np.all(np.diff(positions) > 0.0)
    if name == "arc":
        radial = (points - [1.0, 0.3]) / 0.4
        np.testing.assert_allclose(np.linalg.norm(radial, axis=1), 1.0, atol=0.02)
        assert np.all(np.sum(normals * radial, axis=1) > 0.99)
        np.testing.assert_allclose(positions[-1], 0.4 * np.pi, rtol=0.2)
        return
    start_point = corners[0]
    if not lip.has_mouth and tuple(corners[-1]) < tuple(start_point):
        start_point = corners[-1]
    if len(corners) == 2:
        np.testing.assert_allclose(
            np.linalg.norm(points - start_point, axis=1), positions, atol=1e-9
        )
        first_edge = corners[1] - corners[0]
        normal = np.array([-first_edge[1], first_edge[0]]) / np.linalg.norm(first_edge)
        upright = name in ("vertical", "upright")
        normal *= np.sign(normal[0] if upright else normal[1])
        gap = structure.gap.toarray()
        rows_with_clamp = np.concatenate([gap, np.zeros((1, gap.shape[1]))])
        nodal = rows_with_clamp[structure.nodes.dofs]
        for pair in range(structure.n_pairs):
            for node in np.flatnonzero(np.any(nodal[:, :, pair] != 0.0, axis=1)):
                np.testing.assert_allclose(structure.nodes.points[node], points[pair], atol=1e-9)
                direction = nodal[node, :, pair] @ normal
                np.testing.assert_allclose(abs(direction), 1.0, rtol=1e-9)


def test_several_cracks_of_the_plugin(plugin: Callable[..., Path]) -> None:
    """Two groups or one: the same cracks, from bottom to top; a clearance for each."""
    two = build_structure(file_plate(plugin("vertical", "upright")))
    one_group_structure = build_structure(file_plate(plugin("vertical", "upright", one_group=True)))
    np.testing.assert_allclose(one_group_structure.pair_points, two.pair_points, atol=1e-12)
    assert list(two.watched_pairs) == ["the middle of crack 1", "the mouth of crack 2"]
    np.testing.assert_allclose(two.pair_points[list(two.watched_pairs.values())[1]], [1.0, 1.0])
    clearances = {"crack.clearance": 1e-6, "cracks.1.clearance": 2e-6}
    scene = file_plate(plugin("vertical", "upright"), **clearances)
    structure = build_structure(scene)
    exact_clearance = np.where(structure.pairs.cracks == 0, 1e-6, 2e-6)
    np.testing.assert_array_equal(structure.clearance, exact_clearance)
    catch_error(
        lambda: build_structure(scene.replace({"cracks.2.clearance": 0.0})),
        "cracks",
        "3 tables with [crack]",
        names="the 2 cracks",
    )


@pytest.mark.drawn(3)
@pytest.mark.parametrize("how", [{"run": False}, {"mouth": False}], ids=str)
@pytest.mark.parametrize(("name", "order"), [("edge", 1), ("inside", 1), ("arc", 2)])
def test_nodes_that_exist_once(
    plugin: Callable[..., Path], name: str, order: int, how: dict[str, Any]
) -> None:
    """All of them, or that of the mouth: the same cracks as where the plugin has doubled them."""
    doubled_structure, merged_structure = (
        build_structure(file_plate(plugin(name, order=order, **how), **{"mesh.order": order}))
        for how in ({}, how)
    )
    assert doubled_structure.watched_pairs == merged_structure.watched_pairs
    np.testing.assert_allclose(
        merged_structure.pair_points, doubled_structure.pair_points, atol=1e-12
    )
    np.testing.assert_allclose(
        merged_structure.pairs.positions, doubled_structure.pairs.positions, atol=1e-12
    )
    omega = [solve_modes(structure, 4).omega for structure in (doubled_structure, merged_structure)]
    np.testing.assert_allclose(omega[1], omega[0], rtol=1e-9)


def test_curves_that_are_no_cracks() -> None:
    """On the boundary, branching, crossing, closed, or of one edge inside."""
    cells, places, clamp = grid()
    ring = [node(2, 2), node(3, 2), node(3, 3), node(2, 3), node(2, 2)]
    line, crossing_line = [node(x, 3) for x in range(1, 6)], [node(3, y) for y in range(3, 6)]
    full_line = [node(3, y) for y in range(1, 6)]
    for curve, key, value in (
        (clamp, "mesh", "6 of the 6 edges of cracks not between cells"),
        (edges(line) + edges(crossing_line), "mesh", "more than two sides of a crack meeting"),
        (edges(line) + edges(full_line), "mesh", "more than two sides of a crack meeting"),
        (edges(line[:2]), "mesh", "all nodes of a crack on its front"),
        (edges(ring), "lips", "a closed curve"),
    ):
        catch_error(partial(put_lips, cells, places, clamp, crack=curve), key, value)


def test_a_mouth_that_is_closed() -> None:
    """Of lips with names of their own; a crack's is opened."""
    cells, places, clamp = grid()
    line = [node(x, 3) for x in range(4)]
    cells, places, lower_nodes, upper_nodes = doubled(cells, places, line[1:3])
    lower_edges, upper_edges = (
        edges([line[0], *inner_nodes, line[3]]) for inner_nodes in (lower_nodes, upper_nodes)
    )
    catch_error(
        lambda: put_lips(cells, places, clamp, lower_lip=lower_edges, upper_lip=upper_edges),
        "lips",
        "a mouth at (0, 3) that is closed",
        names="'crack'",
    )
    [lip] = put_lips(cells, places, clamp, crack=upper_edges)
    assert lip.has_mouth and lip.points.tolist() == [[x, 3.0] for x in range(4)]


def put_lips(cells: np.ndarray, places: np.ndarray, clamp: Edges, **curves: Edges) -> Any:
    """The lips of a plate of triangles."""
    groups = [(2, 1, "plate", TRIANGLE, cells.ravel())] + [
        (1, tag, name, 1, np.ravel(group_edges))
        for tag, (name, group_edges) in enumerate({"clamp": clamp, **curves}.items(), 1)
    ]
    with gmsh_model():
        spatial = np.column_stack([places, np.zeros(len(places))])
        return load_mesh_into_gmsh((np.arange(len(places)), spatial, groups), 2)[1]


def test_text_of_the_documentation(tmp_path: Path) -> None:
    """The .geo file in docs/matrices.md, as it stands there, is a plate with an edge crack."""
    [text] = re.findall(r"```geo\n(.*?)```", (ROOT / "docs" / "matrices.md").read_text(), re.S)
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
    mesh = build_plate_or_solid_mesh(file_plate(plugin("edge")), MPI.COMM_SELF)
    assert mesh.position_by_point_name == {"load": (2.0, 1.0), "mouth": (0.0, 0.4)}
    assert mesh.tags_by_group.keys() == {"clamp", "lower_lip", "upper_lip"}
    mesh = build_plate_or_solid_mesh(file_plate(plugin("edge", outline=True)), MPI.COMM_SELF)
    counts = {name: len(mesh.facets(name)) for name in mesh.tags_by_group}
    assert counts["outline"] > counts["clamp"] > 0
    assert set(mesh.facets("clamp")) < set(mesh.facets("outline"))
    assert build_structure(file_plate(plugin("edge", outline=True))).n_pairs > 0


def test_a_load_is_one_point(tmp_path: Path) -> None:
    """Of a group of two neither is taken for it, and none left out without a word."""
    path = tmp_path / "two.msh"
    with gmsh_model() as model:
        face = model.occ.addRectangle(0.0, 0.0, 0.0, WIDTH, HEIGHT)
        model.occ.synchronize()
        _name(model, 2, [face], 1, "plate")
        _name(model, 1, [1], 2, "clamp")
        _name(model, 0, [3, 4], 3, "load")
        model.mesh.generate(2)
        gmsh.write(str(path))
    catch_error(
        lambda: build_plate_or_solid_mesh(
            file_plate(path, contact=None, crack=None), MPI.COMM_SELF
        ),
        "mesh.file",
        names="2 points in the group 'load'",
    )


def test_a_force_without_a_place(tmp_path: Path) -> None:
    """Where the mesh has no point for it: it was left out in silence beside another load."""
    path = tmp_path / "no_point.msh"
    with gmsh_model() as model:
        face = model.occ.addRectangle(0.0, 0.0, 0.0, WIDTH, HEIGHT)
        model.occ.synchronize()
        for dimension, tag, name in ((2, face, "plate"), (1, 1, "clamp"), (1, 3, "end")):
            _name(model, dimension, [tag], tag, name)
        model.mesh.generate(2)
        gmsh.write(str(path))
    loads = {"loads.1.edge": "end", "loads.1.pressure_sin": 1.0}
    scene = file_plate(path, contact=None, crack=None, **loads)
    catch_error(
        lambda: build_structure(scene), "excitation.point", None, names=r"excitation\.force_sin"
    )
    assert build_structure(scene.replace({"excitation.force_sin": [0.0, 0.0]})).n_dofs > 0


# --- meshes that are refused ----------------------------------------------------------------------


TRIANGLE, QUADRILATERAL, CURVED = 2, 3, 9
Edges = list[tuple[int, int]]


def check(cells: Any, places: Any, kind: int = TRIANGLE, **curves: Any) -> None:
    """Check cells (n, k) and places (m, 2), with the edges of curves by their names."""
    lips = [edge for name in ("lower_lip", "upper_lip") for edge in curves.get(name, ())]
    with gmsh_model():
        typed_cells = make_cells_of_kind(kind, np.array(cells))
        check_cells(kind, typed_cells, places)
        lip_edges = [np.reshape(lips, (-1, 2)).astype(int)]
        check_parts_are_clamped(typed_cells, places, np.unique(curves["clamp"]), lip_edges)
        check_parts_do_not_overlap(kind, typed_cells, np.array(places), lip_edges)


def refused(words: str, *mesh: Any, **curves: Any) -> np.ndarray:
    """Return the place that the value of a refusal names, in these words."""
    error = catch_error(lambda: check(*mesh, **curves), "mesh", names=words)
    return np.array(re.findall(r"[-\d.e]+(?=[,)])", str(error.value)), dtype=float)


def test_a_file_is_checked(tmp_path: Path) -> None:
    """The sound one is read; a node thrown, a loose part, a node twice are not."""
    path = tmp_path / "cells.msh"

    def read(cells: np.ndarray, places: np.ndarray, clamp: Edges) -> None:
        with gmsh_model() as model:
            spatial = np.column_stack([places, np.zeros(len(places))])
            for dimension, name, kind, nodes in (
                (2, "plate", TRIANGLE, cells), (1, "clamp", 1, clamp), (0, "load", 15, [node(6, 6)])
            ):  # fmt: skip
                entity = model.addDiscreteEntity(dimension)
                if dimension == 2:
                    model.mesh.addNodes(2, entity, range(1, len(places) + 1), spatial.ravel())
                model.mesh.addElementsByType(entity, kind, [], np.ravel(nodes) + 1)
                group = model.addPhysicalGroup(dimension, [entity])
                model.setPhysicalName(dimension, group, name)
            gmsh.write(str(path))
        build_structure(file_plate(path, contact=None, crack=None), MPI.COMM_SELF)

    cells, places, clamp = grid()
    read(cells, places, clamp)
    thrown = places.copy()
    thrown[node(3, 3)] = 4.4, 3.2
    catch_error(
        lambda: read(cells, thrown, clamp),
        "mesh.file",
        names=r"cells\.msh \(cells that overlap at ",
    )
    further_cells, further_places, _ = grid(2, 2, (8.0, 1.0))
    catch_error(
        lambda: read(
            np.concatenate([cells, further_cells + 49]),
            np.concatenate([places, further_places]),
            clamp,
        ),
        "mesh.file",
        names=r"at \(9, 2\)",
    )
    catch_error(
        lambda: read(*doubled(cells, places, [node(3, 3)])[:2], clamp),
        "mesh.file",
        names=r"at \(.\.5, 3\)",
    )


def grid(
    columns: int = 6, rows: int = 6, origin: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray, Edges]:
    """Triangles of unit squares, their nodes from bottom to top, and the edges at the bottom."""
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    places = np.column_stack([x.ravel(), y.ravel()]) + origin
    corner = (np.arange(columns) + (columns + 1) * np.arange(rows)[:, None]).ravel()
    square = np.column_stack([corner, corner + 1, corner + columns + 2, corner + columns + 1])
    cells = np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    return cells, places, [(i, i + 1) for i in range(columns)]


def node(x: int, y: int) -> int:
    """Number of a node of the grid."""
    return 7 * y + x


@pytest.mark.parametrize("to", [(4.4, 3.2), (3.0, 5.5), (3.5, 30.0), (-2.5, 3.0)], ids=str)
def test_a_node_thrown_across_its_neighbours(to: tuple[float, float]) -> None:
    """Cells around it are turned inside out, and lie on those beside them."""
    cells, places, clamp = grid()
    places[node(3, 3)] = to
    place = refused("cells that overlap", cells, places, clamp=clamp)
    neighbours = places[np.unique(cells[np.any(cells == node(3, 3), axis=1)])]
    middles = (neighbours[:, None] + neighbours) / 2.0
    assert np.linalg.norm(middles - place, axis=2).min() < 1e-4


def test_cells_may_be_numbered_either_way_round() -> None:
    """gmsh does so where a surface is drawn against the clock."""
    cells, places, clamp = grid()
    cells[::3] = cells[::3, ::-1]
    check(cells, places, clamp=clamp)


def test_a_part_that_nothing_holds() -> None:
    """A second part connected to nothing; with a clamp of its own it may be there."""
    cells, places, clamp = grid()
    further_cells, further_places, further_clamp = grid(2, 2, (8.0, 1.0))
    joint_mesh = (
        np.concatenate([cells, further_cells + len(places)]),
        np.concatenate([places, further_places]),
    )
    assert tuple(refused("a part without a clamp at", *joint_mesh, clamp=clamp)) == (9.0, 2.0)
    shifted_clamp = [
        (first_node + len(places), second_node + len(places))
        for first_node, second_node in further_clamp
    ]
    check(*joint_mesh, clamp=clamp + shifted_clamp)


def test_a_part_held_by_contact_alone() -> None:
    """A plate that its crack cuts through: the upper part is held by nothing that pulls."""
    cells, places, clamp = grid()
    cells, places, lower_nodes, upper_nodes = doubled(cells, places, [node(x, 3) for x in range(7)])
    curves = {"lower_lip": edges(lower_nodes), "upper_lip": edges(upper_nodes)}
    words = "a part held by contact alone at"
    assert refused(words, cells, places, clamp=clamp, **curves)[1] > 3.0


def doubled(
    cells: np.ndarray, places: np.ndarray, line: list[int]
) -> tuple[np.ndarray, np.ndarray, list[int], list[int]]:
    """Give nodes along a level line twins, of which the cells above are made."""
    twins = [len(places) + k for k in range(len(line))]
    is_above = places[cells].mean(axis=1)[:, 1] > places[line[0], 1]
    swap = np.arange(len(places))
    swap[line] = twins
    doubled_cells = np.where(is_above[:, None], swap[cells], cells)
    return doubled_cells, np.concatenate([places, places[line]]), line, twins


def edges(line: list[int]) -> Edges:
    return list(itertools.pairwise(line))


def test_a_node_doubled_by_accident() -> None:
    """An unnamed slit is refused; the same with names is a crack inside."""
    cells, places, clamp = grid()
    cells, places, lower_nodes, upper_nodes = doubled(cells, places, [node(3, 3)])
    place = refused("touch without a node of both", cells, places, clamp=clamp)
    assert tuple(place) in ((2.5, 3.0), (3.5, 3.0))
    ends = node(2, 3), node(4, 3)
    lips = {
        name: edges([ends[0], *inner_nodes, ends[1]])
        for name, inner_nodes in (("lower_lip", lower_nodes), ("upper_lip", upper_nodes))
    }
    check(cells, places, clamp=clamp, **lips)


def test_surfaces_that_share_a_line_and_no_node() -> None:
    """Divided differently there: hanging nodes."""
    cells, places, clamp = grid()
    further_cells, further_places, further_clamp = grid(3, 3)
    further_places = 2.0 * further_places + [6.0, 0.0]
    joint_mesh = (
        np.concatenate([cells, further_cells + len(places)]),
        np.concatenate([places, further_places]),
    )
    shifted_clamp = [
        (first_node + len(places), second_node + len(places))
        for first_node, second_node in further_clamp
    ]
    assert (
        refused("touch without a node of both", *joint_mesh, clamp=clamp + shifted_clamp)[0] == 6.0
    )
    joint_mesh[1][len(places) :, 0] += 0.01
    check(*joint_mesh, clamp=clamp + shifted_clamp)


@pytest.mark.parametrize("origin", [(1.2, 1.3), (3.3, 2.2), (4.5, 4.5)], ids=str)
def test_parts_on_one_another(origin: tuple[float, float]) -> None:
    """Inside one another, or across an edge of the boundary."""
    cells, places, clamp = grid()
    further_cells, further_places, further_clamp = grid(2, 2, origin)
    shifted_clamp = [
        (first_node + len(places), second_node + len(places))
        for first_node, second_node in further_clamp
    ]
    joint_mesh = (
        np.concatenate([cells, further_cells + len(places)]),
        np.concatenate([places, further_places]),
    )
    refused("cells that overlap", *joint_mesh, clamp=clamp + shifted_clamp)


@pytest.mark.parametrize("turn", [0.5, 1.0, 1.5])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, 0.0), (0.4, 0.3)], ids=str)
def test_strips_that_cross(shift: tuple[float, float], turn: float) -> None:
    """Like an X, of cells twice as long as wide: the middles of their edges may be outside."""
    cells, places, clamp = grid(6, 1)
    places = (places - [3.0, 0.5]) * [2.0, 1.0]
    cosine, sine = np.cos(turn), np.sin(turn)
    turned_places = places @ [[cosine, sine], [-sine, cosine]] + shift
    joint_mesh = np.concatenate([cells, cells + 14]), np.concatenate([places, turned_places])
    shifted_clamp = [(first_node + 14, second_node + 14) for first_node, second_node in clamp]
    refused("cells that overlap", *joint_mesh, clamp=clamp + shifted_clamp)


def test_two_cells_on_one_side_of_their_edge() -> None:
    """One within the other: neither their boundary nor the angles at a node show it."""
    places = np.array([(0.0, 0.0), (1.0, 0.0), (0.5, 1.0), (0.4, 0.3)])
    place = refused("cells that overlap", [(0, 1, 2), (1, 0, 3)], places, clamp=[(0, 2)])
    assert tuple(place) == (0.5, 0.0)


def test_three_cells_at_an_edge_and_cells_without_area() -> None:
    """What no plane has."""
    places = np.array([(0.0, 0.0), (1.0, 0.0), (0.5, 1.0), (0.5, -1.0), (0.4, 2.0)])
    three = [(0, 1, 2), (0, 1, 3), (0, 1, 4)]
    assert tuple(refused("an edge of three cells", three, places, clamp=[(0, 2)])) == (0.5, 0.0)
    places[3] = 0.5, 0.0
    place = refused("a cell without area", three[:2], places, clamp=[(0, 2)])
    assert tuple(place) == (0.5, 0.0)


def test_a_strip_wound_onto_itself() -> None:
    """Its boundary crosses itself, and nothing else is wrong."""
    cells, places, _ = grid(40, 1)
    turns = 1.1 * places[:, :1] / 40.0
    radius = 1.0 + 0.3 * places[:, 1:] + 0.1 * turns
    angle = 2.0 * np.pi * turns
    places = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    refused("cells that overlap, or touch", cells, places, clamp=[(0, 41)])


def test_a_fan_that_goes_round_twice() -> None:
    """Sixteen cells of 45 degrees around a node, none of which is turned inside out."""
    angles = np.arange(16) * np.pi / 4.0
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * (1.0 + 0.01 * np.arange(16)[:, None])
    cells = [(0, 1 + k, 1 + (k + 1) % 16) for k in range(16)]
    refused("cells that overlap", cells, np.concatenate([[[0.0, 0.0]], ring]), clamp=[(1, 2)])


def test_quadrilaterals_are_convex() -> None:
    """A corner of more than 180 degrees; one of 180 degrees may be there."""
    places = np.array([(0.0, 0.0), (1.0, 0.0), (0.5, 0.5), (0.0, 1.0)])
    check([(0, 1, 2, 3)], places, QUADRILATERAL, clamp=[(0, 1)])
    places[2] = 0.3, 0.3
    words = "a folded cell at"
    place = refused(words, [(0, 1, 2, 3)], places, QUADRILATERAL, clamp=[(0, 1)])
    np.testing.assert_allclose(place, 0.325)


@pytest.mark.parametrize(("share", "sound"), [(0.5, True), (0.25, True), (0.2, False)])
def test_curved_triangles(share: float, sound: bool) -> None:
    """A node in the middle of an edge may be moved to a quarter of it, and no farther."""
    places = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (share, 0.0), (0.5, 0.5), (0.0, 0.5)])
    if sound:
        check([range(6)], places, CURVED, clamp=[(1, 2, 4)])
    else:
        refused("a folded cell", [range(6)], places, CURVED, clamp=[(1, 2, 4)])
