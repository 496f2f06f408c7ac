"""Meshes: the plate's area, the pairs of lip nodes, the point load, and mesh files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from helpers import catch_error, gmsh_model
from mpi4py import MPI

from fenics_crack import Scene, Structure, build_structure, write_msh

WIDTH, HEIGHT = 0.3, 0.2
KINDS = [
    (layout, cells, order)
    for layout in ("grid", "graded")
    for cells in ("triangle", "quadrilateral")
    for order in (1, 2)
]


def plate(
    layout: str,
    cells: str,
    order: int,
    edge: str = "left",
    length: float = 0.4,
    height: float = 0.5,
) -> Scene:
    """A plate with a crack whose length and height are given as parts of the plate's."""
    sizes = {
        "grid": {"columns": 20, "rows": 4},
        "graded": {"size": 0.06, "lip_elements": 5, "grading": 3.0},
    }
    return Scene.from_mapping(
        {
            "geometry": {"width": WIDTH, "height": HEIGHT, "thickness": 0.01},
            "crack": {"edge": edge, "height": height * HEIGHT, "length": length * WIDTH},
            "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
            "damping": {"ratio": 0.001},
            "excitation": {"omega": 1.0, "point": [WIDTH, HEIGHT], "force_sin": [1.0, 0.0]},
            "contact": {"stiffness": 1e9},
            "mesh": {"layout": layout, "cells": cells, "order": order} | sizes[layout],
        }
    )


def file_plate(path: Path, **changes: Any) -> Scene:
    """A plate whose mesh is read from a file, with some keys changed."""
    scene = Scene.from_mapping(
        {
            "geometry": {"thickness": 0.01},
            "crack": {},
            "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
            "damping": {"ratio": 0.001},
            "excitation": {"omega": 1.0, "force_sin": [3.0, 4.0]},
            "contact": {"stiffness": 1e9},
            "mesh": {"layout": "file", "file": str(path)},
        }
    )
    return scene.replace(changes)


def area(structure: Structure) -> float:
    """Return the area of all cells, from corner to corner, whichever way round they are."""
    nodes = structure.nodes
    corners = 3 if nodes.cells.shape[1] in (3, 6) else 4
    x, y = np.moveaxis(nodes.points[nodes.cells[:, :corners]], -1, 0)
    twice = np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)
    return float(np.abs(twice).sum() / 2.0)


def gather_rows(comm: MPI.Comm, rows: np.ndarray) -> np.ndarray:
    """Of all ranks, in their order, on every rank (collective)."""
    return np.concatenate(comm.allgather(rows))


def field(structure: Structure, values: np.ndarray) -> np.ndarray:
    """Displacement (1, n_local) that takes the values (n_nodes, 2) at this rank's nodes."""
    is_free = structure.nodes.dofs >= 0
    displacement = np.zeros((1, structure.n_local))
    displacement[0, structure.nodes.dofs[is_free] - structure.first_dof] = values[is_free]
    return displacement


def pair_nodes(structure: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower node, upper node and normal of every pair, found in B: its entries are n and -n.

    The lower node is the one with positive entries along y.
    """
    gap = structure.gap.toarray()
    rows_with_clamp = np.concatenate(
        [gap, np.zeros((1, gap.shape[1]))]
    )  # clamped dofs are number -1
    nodal = rows_with_clamp[structure.nodes.dofs]  # (n_nodes, 2, n_pairs)
    lower_nodes, upper_nodes, normals = [], [], []
    for pair in range(structure.n_pairs):
        touched_nodes = np.flatnonzero(np.any(nodal[:, :, pair] != 0.0, axis=1))
        assert len(touched_nodes) == 2
        upper_node, lower_node = sorted(touched_nodes, key=lambda node: -nodal[node, 1, pair])
        np.testing.assert_allclose(
            nodal[upper_node, :, pair], -nodal[lower_node, :, pair], rtol=1e-12, atol=1e-14
        )
        lower_nodes.append(upper_node)
        upper_nodes.append(lower_node)
        normals.append(nodal[upper_node, :, pair])
    return np.array(lower_nodes), np.array(upper_nodes), np.array(normals)


def nodes_of_side(structure: Structure, origin: Any, direction: Any) -> np.ndarray:
    """Whether each of this rank's nodes belongs to a cell on one side of a line (collective).

    The cell's centre lies from a point of the line in the direction given.
    """
    points = gather_rows(structure.comm, structure.nodes.points)
    cells = gather_rows(structure.comm, structure.nodes.cells)
    kept_cells = cells[(points[cells].mean(axis=1) - origin) @ direction > 0.0]
    n_nodes = len(structure.nodes.points)
    first_index = structure.comm.exscan(n_nodes) or 0
    return np.isin(np.arange(first_index, first_index + n_nodes), kept_cells)


# --- plates made by the package -------------------------------------------------------------------
@pytest.mark.drawn(4)
@pytest.mark.parametrize(("layout", "cells", "order"), KINDS)
def test_lips_pair_one_to_one(layout: str, cells: str, order: int) -> None:
    """Pairs are coincident nodes of the two lips, from the mouth to the tip, without the tip; the
    slit takes nothing away, and no cell overlaps another: the area is width x height."""
    sizes = ("left", 0.05, 0.5), ("right", 0.4, 0.25), ("left", 0.5, 0.75), ("right", 0.95, 0.5)
    for edge, length, height in sizes:
        structure = build_structure(plate(layout, cells, order, edge, length, height))
        np.testing.assert_allclose(area(structure), WIDTH * HEIGHT, rtol=1e-12)
        assert structure.n_pairs == (round(20 * length) if layout == "grid" else 5) * order

        lower_nodes, upper_nodes, normals = pair_nodes(structure)
        assert not set(lower_nodes) & set(upper_nodes)
        np.testing.assert_array_equal(normals[:, 0].round(12), 0.0)
        np.testing.assert_allclose(normals[:, 1], 1.0, rtol=1e-12)
        for side in (lower_nodes, upper_nodes):
            np.testing.assert_allclose(
                structure.nodes.points[side], structure.pair_points, atol=1e-12
            )
        is_below = nodes_of_side(structure, (0.0, height * HEIGHT), (0.0, -1.0))
        is_above = nodes_of_side(structure, (0.0, height * HEIGHT), (0.0, 1.0))
        assert np.all(is_below[lower_nodes] & ~is_above[lower_nodes])
        assert np.all(is_above[upper_nodes] & ~is_below[upper_nodes])

        np.testing.assert_allclose(structure.pair_points[:, 1], height * HEIGHT, rtol=1e-12)
        from_mouth = structure.pair_points[:, 0]
        if edge == "right":
            from_mouth = WIDTH - from_mouth
        assert abs(from_mouth[0]) < 1e-12
        assert np.all(np.diff(from_mouth) > 0.0)
        assert from_mouth[-1] < length * WIDTH * (1.0 - 1e-3)


@pytest.mark.drawn(10)
@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("length", [0.01, 0.03, 0.2, 0.77, 0.95])
@pytest.mark.parametrize("height", [0.03, 0.5, 0.97])
def test_graded_meshes_of_any_crack(cells: str, length: float, height: float) -> None:
    """Cracks of 1 % to 95 % of the width, close to either end too, are meshed without overlap."""
    structure = build_structure(plate("graded", cells, 1, "left", length, height))
    np.testing.assert_allclose(area(structure), WIDTH * HEIGHT, rtol=1e-12)
    assert structure.n_pairs == 5


def test_elements_are_no_larger_than_the_size_asked_for() -> None:
    """Even where the lips' own elements are larger than that."""
    scene = plate("graded", "quadrilateral", 1).replace({"mesh.size": 0.005})
    coarse_lips = scene.replace({"mesh.lip_elements": 2, "mesh.grading": 1.0})
    n_elements_above = (
        0.5 * HEIGHT / 0.005 * (0.6 * WIDTH / 0.005)
    )  # beyond the tip alone, on either side
    assert build_structure(coarse_lips).n_dofs > 2 * 2 * n_elements_above


def test_grading_shortens_the_elements_at_the_tip() -> None:
    """The lip's element at the tip is `grading` times shorter than the one at the mouth."""
    structure = build_structure(plate("graded", "quadrilateral", 1))
    lengths = np.diff(np.append(structure.pair_points[:, 0], 0.4 * WIDTH))
    np.testing.assert_allclose(lengths[0] / lengths[-1], 3.0, rtol=1e-6)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
def test_uncracked_plate(cells: str, order: int) -> None:
    """Without the crack the same grid has no pairs and no duplicated dofs."""
    scene = plate("grid", cells, order)
    cracked_structure = build_structure(scene)
    full_structure = build_structure(scene.replace({"crack": None, "contact": None}))
    nodes = (20 * order + 1) * (4 * order)  # all rows but the clamped one
    assert full_structure.n_pairs == 0
    assert full_structure.n_dofs == 2 * nodes
    assert cracked_structure.n_dofs == full_structure.n_dofs + 2 * cracked_structure.n_pairs
    np.testing.assert_allclose(area(full_structure), WIDTH * HEIGHT, rtol=1e-12)


@pytest.mark.parametrize(("layout", "cells", "order"), KINDS)
def test_sign_of_the_closing(layout: str, cells: str, order: int) -> None:
    """A translation closes nothing; lifting the part above the crack by 1 opens every pair by 1."""
    structure = build_structure(plate(layout, cells, order))
    everywhere = np.ones((len(structure.nodes.points), 1))
    for direction in ([1.0, 0.0], [0.0, 1.0], [2.0, -3.0]):
        shift = field(structure, everywhere * direction)
        np.testing.assert_allclose(structure.apply_bt(shift), 0.0, atol=1e-13)
    displacement = np.zeros((len(everywhere), 2))
    displacement[nodes_of_side(structure, (0.0, HEIGHT / 2), (0.0, 1.0)), 1] = 1.0
    np.testing.assert_allclose(structure.apply_bt(field(structure, displacement)), -1.0, rtol=1e-12)


def test_written_mesh_gives_the_same_structure(tmp_path: Path) -> None:
    """A plate written by write_msh and read back has the same stiffness, pairs and load."""
    scene = plate("graded", "quadrilateral", 1)
    path = tmp_path / "plate.msh"
    write_msh(scene, path)
    built_structure = build_structure(scene)
    read_structure = build_structure(file_plate(path, **{"excitation.force_sin": [1.0, 0.0]}))
    np.testing.assert_allclose(read_structure.pair_points, built_structure.pair_points, atol=1e-12)
    assert built_structure.stiffness.norm() == pytest.approx(
        read_structure.stiffness.norm(), rel=1e-12
    )
    assert built_structure.mass.norm() == pytest.approx(read_structure.mass.norm(), rel=1e-12)
    np.testing.assert_allclose(
        read_structure.force.sum(axis=1), built_structure.force.sum(axis=1), atol=1e-12
    )


# --- point load -----------------------------------------------------------------------------------
@pytest.mark.drawn(10)
@pytest.mark.parametrize(
    "point",
    [
        (0.17, 0.133),
        (0.225, 0.15),
        (0.2, 0.15),
        (0.3, 0.171),
        (0.3, 0.2),
        (0.0, 0.2),
        (0.11, 0.10012),
    ],
)
@pytest.mark.parametrize(("layout", "cells", "order"), KINDS)
def test_point_load_does_its_work(
    layout: str, cells: str, order: int, point: tuple[float, float]
) -> None:
    """Inside an element, on an edge or at a node: f . u = F . u(point) for linear u, and sum F."""
    parts = {"force_mean": (1.0, -2.0), "force_cos": (0.5, 0.0), "force_sin": (100.0, 7.0)}
    scene = plate(layout, cells, order).replace(
        {"excitation.point": point} | {f"excitation.{name}": part for name, part in parts.items()}
    )
    structure = build_structure(scene)
    rng = np.random.default_rng(3)
    for gradient in (np.zeros((2, 2)), rng.standard_normal((2, 2))):
        offset = rng.standard_normal(2)
        linear = field(structure, offset + structure.nodes.points @ gradient.T)
        work = structure.force @ linear[0]
        exact_work = np.array(list(parts.values())) @ (offset + gradient @ point)
        np.testing.assert_allclose(work, exact_work, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_clamped_load_is_refused(order: int) -> None:
    """A force on the clamped edge, on a node or between two, does nothing: refused."""
    for x in (0.0, 0.15, 0.1234):
        scene = plate("grid", "quadrilateral", order).replace({"excitation.point": (x, 0.0)})
        catch_error(partial(build_structure, scene), "excitation.point", (x, 0.0))


# --- mesh files -----------------------------------------------------------------------------------
MOUTH, TIP = np.array([0.0, 0.4]), np.array([0.8, 0.7])


@pytest.fixture
def msh(tmp_path: Path) -> Callable[..., Path]:
    """Write a 2 x 1 plate with an inclined crack from (0, 0.4) to (0.8, 0.7) by gmsh."""

    def write(
        *,
        names: tuple[str, ...] = ("clamp", "lower_lip", "upper_lip", "load"),
        lip_elements: tuple[int, int] = (4, 4),
        quadrilaterals: tuple[bool, bool] = (False, False),
        progression: float = 1.0,
        one_curve: bool = False,
        raised: float = 0.0,
        groups: bool = True,
    ) -> Path:
        path = tmp_path / "inclined.msh"
        with gmsh_model() as model:
            geo = model.geo
            point = {
                name: geo.addPoint(x, y, z, 0.2)
                for name, (x, y, z) in {
                    "sw": (0, 0, 0), "se": (2, 0, 0), "e": (2, 0.5, 0), "ne": (2, 1, raised),
                    "nw": (0, 1, raised), "tip": (*TIP, 0), "low": (*MOUTH, 0), "up": (*MOUTH, 0),
                }.items()
            }  # fmt: skip
            ring = ["sw", "se", "e", "tip", "low"], ["e", "ne", "nw", "up", "tip"]
            line: dict[tuple[str, str], int] = {}
            surfaces = []
            for corners in ring:
                loop = []
                for ends in zip(corners, corners[1:] + corners[:1], strict=True):
                    if ends[::-1] in line:
                        loop.append(-line[ends[::-1]])
                    else:
                        line[ends] = geo.addLine(*(point[end] for end in ends))
                        loop.append(line[ends])
                surfaces.append(geo.addPlaneSurface([geo.addCurveLoop(loop)]))
            lips = line["tip", "low"], line["up", "tip"]
            for lip, elements in zip(lips, lip_elements, strict=True):
                grading = progression if lip == lips[0] else 1.0
                geo.mesh.setTransfiniteCurve(lip, elements + 1, "Progression", grading)
            for surface, recombine in zip(surfaces, quadrilaterals, strict=True):
                if recombine:
                    geo.mesh.setRecombine(2, surface)
            geo.synchronize()
            group_entities = {
                "clamp": (1, line["sw", "se"]), "lower_lip": (1, lips[0]),
                "upper_lip": (1, lips[0 if one_curve else 1]), "load": (0, point["ne"]),
            }  # fmt: skip
            if groups:
                model.setPhysicalName(2, model.addPhysicalGroup(2, surfaces), "any")
                for name in names:
                    dimension, tag = group_entities[name]
                    group = model.addPhysicalGroup(dimension, [tag])
                    model.setPhysicalName(dimension, group, name)
            model.mesh.generate(2)
            gmsh.write(str(path))
        return path

    return write


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("recombined", [False, True])
def test_inclined_crack_from_a_file(msh: Callable[..., Path], recombined: bool, order: int) -> None:
    """Normals stand on the crack and point from the lower to the upper lip, pairs follow it."""
    path = msh(quadrilaterals=(recombined, recombined))
    scene = file_plate(path, **{"mesh.order": order, "crack.clearance": 1e-6})
    structure = build_structure(scene)
    np.testing.assert_allclose(area(structure), 2.0, rtol=1e-12)
    assert structure.n_pairs == 4 * order
    np.testing.assert_array_equal(structure.clearance, np.full(4 * order, 1e-6))
    lower_nodes, upper_nodes, normals = pair_nodes(structure)
    crack_direction = (TIP - MOUTH) / np.linalg.norm(TIP - MOUTH)
    np.testing.assert_allclose(
        normals, np.tile([-crack_direction[1], crack_direction[0]], (4 * order, 1)), atol=1e-9
    )
    parts = np.arange(4 * order)[:, None] / (4 * order)
    exact_points = MOUTH + parts * (TIP - MOUTH)
    for points in (
        structure.pair_points, structure.nodes.points[lower_nodes],
        structure.nodes.points[upper_nodes],
    ):  # fmt: skip
        np.testing.assert_allclose(points, exact_points, atol=1e-9)
    is_above = nodes_of_side(structure, MOUTH, (-crack_direction[1], crack_direction[0]))
    assert np.all(is_above[upper_nodes])
    assert not np.any(is_above[lower_nodes])


def test_load_point_of_the_file(msh: Callable[..., Path]) -> None:
    """The physical point `load` carries the force; excitation.point overrules it."""
    path = msh()
    structure = build_structure(file_plate(path))
    for component, value in ((0, 3.0), (1, 4.0)):
        dof = structure.find_dof((2.0, 1.0), component)
        assert structure.force[2, dof] == pytest.approx(value, rel=1e-9)
    structure_with_point = build_structure(file_plate(path, **{"excitation.point": (2.0, 0.5)}))
    assert structure_with_point.force[
        2, structure_with_point.find_dof((2.0, 0.5), 0)
    ] == pytest.approx(3.0, rel=1e-9)


def test_file_without_lips_is_an_uncracked_plate(tmp_path: Path) -> None:
    """A mesh without lips has no pairs; where the scene has contact, a name is misspelt."""
    path = tmp_path / "plate.msh"
    write_msh(plate("grid", "triangle", 1).replace({"crack": None, "contact": None}), path)
    scene = file_plate(path)
    assert build_structure(scene.replace({"contact": None, "crack": None})).n_pairs == 0
    catch_error(lambda: build_structure(scene), "mesh.file", names="lower_lip")


def test_a_crack_that_stays_open_has_a_name(msh: Callable[..., Path]) -> None:
    """Lips without contact are open; edges in one place without a name are refused."""
    open_crack: dict[str, Any] = {"contact": None, "crack": None}
    assert build_structure(file_plate(msh(), **open_crack)).n_pairs == 4
    catch_error(
        lambda: build_structure(file_plate(msh(names=("clamp", "load")), **open_crack)),
        "mesh.file",
        names="'crack', or 'lower_lip'",
    )


@pytest.mark.parametrize(
    ("how", "names"),
    [
        ({"names": ("lower_lip", "upper_lip", "load")}, "'clamp'"),
        ({"names": ("clamp", "lower_lip", "load")}, "one lip.*'upper_lip'"),
        ({"names": ("clamp", "upper_lip", "load")}, "one lip.*'lower_lip'"),
        ({"quadrilaterals": (True, False)}, "2 kinds of cells"),
        ({"raised": 0.1}, "no plane mesh"),
        ({"groups": False}, "0 kinds of cells"),
    ],
    ids=str,
)
def test_bad_mesh_file(msh: Callable[..., Path], how: dict[str, Any], names: str) -> None:
    """A mesh file that lacks a group or is no plane mesh of one kind of cells is refused."""
    catch_error(
        lambda: build_structure(file_plate(msh(**how)), MPI.COMM_SELF),
        "mesh.file",
        names=rf"inclined\.msh \(.*{names}",
    )


@pytest.mark.parametrize(
    ("how", "value"),
    [
        ({"lip_elements": (4, 5)}, "4 lower and 5 upper nodes"),
        ({"progression": 1.3}, "4 lower and 4 upper nodes"),
        ({"one_curve": True}, "the same nodes for 'lower_lip' and 'upper_lip'"),
    ],
    ids=str,
)
def test_lips_that_do_not_fit(msh: Callable[..., Path], how: dict[str, Any], value: str) -> None:
    """Lips that are not meshed alike, or are the same curve, are refused."""
    catch_error(lambda: build_structure(file_plate(msh(**how))), "lips", value)


@pytest.mark.parametrize("content", [None, "", "nonsense\n", "$MeshFormat\n4.1 0 8\n"])
def test_unreadable_mesh_file(content: str | None, tmp_path: Path) -> None:
    """A file that is missing, empty, cut off or no mesh is refused."""
    path = tmp_path / "broken.msh"
    if content is not None:
        path.write_text(content)
    catch_error(
        lambda: build_structure(file_plate(path), MPI.COMM_SELF), "mesh.file", names=r"broken\.msh"
    )


def test_three_dimensional_mesh_file(tmp_path: Path) -> None:
    """A mesh of a box is refused."""
    path = tmp_path / "box.msh"
    with gmsh_model() as model:
        model.occ.addBox(0, 0, 0, 1, 1, 1)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [1], 1)
        model.mesh.generate(3)
        gmsh.write(str(path))
    catch_error(
        lambda: build_structure(file_plate(path), MPI.COMM_SELF), "mesh.file", names="no plane"
    )


def test_load_off_the_mesh_of_a_file(msh: Callable[..., Path]) -> None:
    """A load beside the mesh is refused, and so is none at all."""
    path = msh(names=("clamp", "lower_lip", "upper_lip"))
    catch_error(
        lambda: build_structure(file_plate(path, **{"excitation.point": (2.1, 0.5)})),
        "excitation.point",
        (2.1, 0.5),
    )
    catch_error(lambda: build_structure(file_plate(path)), "excitation.point", None, names="'load'")


# --- several ranks --------------------------------------------------------------------------------
def totals(scene: Scene, points: list[Any], comm: MPI.Comm) -> list[Any]:
    """Sum of the load's nodal forces for a load at each of the points (collective)."""
    structures = (build_structure(scene.replace({"excitation.point": p}), comm) for p in points)
    return [comm.allreduce(structure.force[2].sum()) for structure in structures]


@pytest.mark.mpi
def test_load_between_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """A load on the border of two ranks' cells, wherever that runs, is applied once."""
    points = [(i * WIDTH / 10, 0.75 * HEIGHT) for i in range(11)]
    points += [(0.5 * WIDTH, j * HEIGHT / 4) for j in range(1, 5)]
    scene = plate("grid", "quadrilateral", 1).replace({"mesh.columns": 10})
    np.testing.assert_allclose(on_ranks(totals, scene, points), np.ones(len(points)), rtol=1e-9)


def list_refusal_values(scene: Scene, comm: MPI.Comm) -> list[str]:
    """Return the value of `mesh.file` that each rank is told to be wrong (collective)."""
    return comm.allgather(catch_error(lambda: build_structure(scene, comm), "mesh.file").value)


@pytest.mark.mpi
def test_errors_reach_every_rank(on_ranks: Callable[..., Any], tmp_path: Path) -> None:
    """A mesh file that only rank 0 reads is refused on every rank; no rank waits."""
    path = tmp_path / "missing.msh"
    assert on_ranks(list_refusal_values, file_plate(path)) == [str(path)] * 2


@pytest.mark.parametrize(("order", "gibibytes"), [(1, 6.0), (2, 24.0)])
def test_memory_of_a_grid(order: int, gibibytes: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """At least 1500 bytes for each of 2 order^2 degrees of freedom per cell."""
    monkeypatch.setattr("fenics_crack.fem.blocks.machine_memory", lambda: 1)
    cells = {"mesh.columns": 2150, "mesh.rows": 1000, "crack.height": 0.5 * HEIGHT}
    error = catch_error(
        lambda: build_structure(plate("grid", "quadrilateral", order).replace(cells)),
        "mesh.columns",
        2150,
        names=r"2\.2e\+06",
    )
    memory = float(str(error).partition("takes about ")[2].split()[0])
    assert gibibytes <= memory < 4.0 * gibibytes
