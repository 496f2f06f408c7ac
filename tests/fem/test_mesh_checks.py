"""Meshes that cannot be those of a structure are refused, with the place; others are not."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from helpers import gmsh_model
from mpi4py import MPI
from test_mesh import file_plate

from fenics_crack import InputError, build_structure
from fenics_crack.fem.mesh_checks import check_mesh

TRIANGLE, QUADRILATERAL, CURVED = 2, 3, 9
Edges = list[tuple[int, int]]


def check(cells: Any, places: Any, kind: int = TRIANGLE, **curves: Any) -> None:
    """Check cells (n, k) and places (m, 2), with the edges of curves by their names."""
    lips = [edge for name in ("lower_lip", "upper_lip") for edge in curves.get(name, ())]
    with gmsh_model():
        given = np.unique(curves["clamp"]), np.reshape(lips, (-1, 2)).astype(int)
        check_mesh(kind, np.array(cells), places, *given)


def refused(words: str, *mesh: Any, **curves: Any) -> np.ndarray:
    """The place of a refusal in the words given."""
    with pytest.raises(InputError, match=words) as caught:
        check(*mesh, **curves)
    return place_of(caught.value)


def place_of(error: InputError) -> np.ndarray:
    assert error.key == "mesh"
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
    with pytest.raises(InputError, match=r"^mesh.file = '.*cells.msh \(cells that overlap at "):
        read(cells, thrown, clamp)
    more, there, _ = grid(2, 2, (8.0, 1.0))
    with pytest.raises(InputError, match=r"a part without a clamp at \(9, 2\)"):
        read(np.concatenate([cells, more + 49]), np.concatenate([places, there]), clamp)
    with pytest.raises(InputError, match=r"doubled nodes at \(.\.5, 3\)"):
        read(*doubled(cells, places, [node(3, 3)])[:2], clamp)


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
    more, there, other = grid(2, 2, (8.0, 1.0))
    both = np.concatenate([cells, more + len(places)]), np.concatenate([places, there])
    assert tuple(refused("a part without a clamp at", *both, clamp=clamp)) == (9.0, 2.0)
    own = [(one + len(places), two + len(places)) for one, two in other]
    check(*both, clamp=clamp + own)


def test_a_part_held_by_contact_alone() -> None:
    """A plate that its crack cuts through: the upper part is held by nothing that pulls."""
    cells, places, clamp = grid()
    cells, places, low, high = doubled(cells, places, [node(x, 3) for x in range(7)])
    curves = {"lower_lip": edges(low), "upper_lip": edges(high)}
    words = "a part held by contact alone at"
    assert refused(words, cells, places, clamp=clamp, **curves)[1] > 3.0


def doubled(
    cells: np.ndarray, places: np.ndarray, line: list[int]
) -> tuple[np.ndarray, np.ndarray, list[int], list[int]]:
    """Give nodes along a level line twins, of which the cells above are made."""
    twins = [len(places) + k for k in range(len(line))]
    above = places[cells].mean(axis=1)[:, 1] > places[line[0], 1]
    swap = np.arange(len(places))
    swap[line] = twins
    found = np.where(above[:, None], swap[cells], cells)
    return found, np.concatenate([places, places[line]]), line, twins


def edges(line: list[int]) -> Edges:
    return list(itertools.pairwise(line))


def test_a_node_doubled_by_accident() -> None:
    """An unnamed slit is refused; the same with names is a crack inside."""
    cells, places, clamp = grid()
    cells, places, low, high = doubled(cells, places, [node(3, 3)])
    place = refused("doubled nodes at .* share their nodes", cells, places, clamp=clamp)
    assert tuple(place) in ((2.5, 3.0), (3.5, 3.0))
    ends = node(2, 3), node(4, 3)
    lips = {
        name: edges([ends[0], *own, ends[1]])
        for name, own in (("lower_lip", low), ("upper_lip", high))
    }
    check(cells, places, clamp=clamp, **lips)


def test_surfaces_that_share_a_line_and_no_node() -> None:
    """Divided differently there: hanging nodes."""
    cells, places, clamp = grid()
    more, there, other = grid(3, 3)
    there = 2.0 * there + [6.0, 0.0]
    both = np.concatenate([cells, more + len(places)]), np.concatenate([places, there])
    own = [(one + len(places), two + len(places)) for one, two in other]
    assert refused("doubled nodes", *both, clamp=clamp + own)[0] == 6.0
    both[1][len(places) :, 0] += 0.01
    check(*both, clamp=clamp + own)


@pytest.mark.parametrize("origin", [(1.2, 1.3), (3.3, 2.2), (4.5, 4.5)], ids=str)
def test_parts_on_one_another(origin: tuple[float, float]) -> None:
    """Inside one another, or across an edge of the boundary."""
    cells, places, clamp = grid()
    more, there, other = grid(2, 2, origin)
    own = [(one + len(places), two + len(places)) for one, two in other]
    both = np.concatenate([cells, more + len(places)]), np.concatenate([places, there])
    refused("cells that overlap", *both, clamp=clamp + own)


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
    words = "cells that overlap at .* boundary does not cross itself"
    refused(words, cells, places, clamp=[(0, 41)])


def test_a_fan_that_goes_round_twice() -> None:
    """Sixteen cells of 45 degrees around a node, none of which is turned inside out."""
    angles = np.arange(16) * np.pi / 4.0
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * (1.0 + 0.01 * np.arange(16)[:, None])
    cells = [(0, 1 + k, 1 + (k + 1) % 16) for k in range(16)]
    places = np.concatenate([[[0.0, 0.0]], ring])
    assert not np.any(refused("cells that overlap", cells, places, clamp=[(1, 2)]))


def test_quadrilaterals_are_convex() -> None:
    """A corner of more than 180 degrees; one of 180 degrees may be there."""
    places = np.array([(0.0, 0.0), (1.0, 0.0), (0.5, 0.5), (0.0, 1.0)])
    check([(0, 1, 2, 3)], places, QUADRILATERAL, clamp=[(0, 1)])
    places[2] = 0.3, 0.3
    words = "a folded cell at .* convex"
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
