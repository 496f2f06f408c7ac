"""Several cracks, and cracks inside the plate: pairs, mirror images, stress intensity, contact."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sparse
import scipy.sparse.linalg
from helpers import catch_error
from mpi4py import MPI
from test_mesh import area, gather_rows, nodes_of_side, pair_nodes

import fenics_crack as fc
from fenics_crack import Scene, Structure, build_structure

WIDTH, HEIGHT = 0.3, 0.2
THREE: list[dict[str, Any]] = [
    {"edge": "right", "height": 0.05, "length": 0.105},
    {"center": 0.12, "height": 0.1, "length": 0.09},
    {"edge": "left", "height": 0.15, "length": 0.15},
]
TOGETHER: list[dict[str, Any]] = [
    {"edge": "left", "height": 0.1, "length": 0.06},
    {"center": 0.135, "height": 0.1, "length": 0.06},
    {"edge": "right", "height": 0.1, "length": 0.09},
]
"""At one height."""
LAYOUTS: dict[str, dict[str, Any]] = {
    "grid": {"layout": "grid", "columns": 20, "rows": 8},
    "graded": {"layout": "graded", "size": 0.03, "lip_elements": 6, "grading": 3.0},
}


def plate(cracks: list[dict[str, Any]], layout: str = "graded", **changes: Any) -> Scene:
    """A plate with cracks, the first of them in [crack]."""
    scene = Scene.from_mapping(
        {
            "geometry": {"width": WIDTH, "height": HEIGHT, "thickness": 0.01},
            "crack": cracks[0],
            "cracks": cracks[1:],
            "material": {"young": 2e11, "poisson": 0.3, "density": 7800.0},
            "damping": {"ratio": 0.01},
            "excitation": {"omega": 1.0, "point": [WIDTH / 2, HEIGHT], "force_sin": [0.0, 1.0]},
            "contact": {"stiffness": 1e9},
            "mesh": LAYOUTS[layout],
        }
    )
    return scene.replace(changes)


def mirrored(cracks: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The cracks with left and right exchanged."""
    opposite_edge = {"left": "right", "right": "left"}
    return [
        crack | ({"edge": opposite_edge[crack["edge"]]} if "edge" in crack else
                 {"center": WIDTH - crack["center"]})
        for crack in cracks
    ]  # fmt: skip


def static(structure: Structure, force: np.ndarray) -> np.ndarray:
    """Displacement under a static force, with open lips."""
    starts, columns, values = structure.stiffness.getValuesCSR()
    matrix = sparse.csr_matrix((values, columns, starts), structure.stiffness.size)
    return scipy.sparse.linalg.spsolve(matrix.tocsc(), force)


# --- meshes and pairs -----------------------------------------------------------------------------
@pytest.mark.parametrize("cracks", [THREE, TOGETHER], ids=["apart", "in line"])
@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("layout", ["grid", "graded"])
def test_pairs_crack_by_crack(layout: str, cells: str, cracks: list[dict[str, Any]]) -> None:
    """From the mouth, or the left tip; both nodes in one place, on the two sides of a crack."""
    order = 1 if layout == "grid" else 2
    scene = plate(cracks, layout, **{"mesh.cells": cells, "mesh.order": order})
    structure = build_structure(scene)
    np.testing.assert_allclose(area(structure), WIDTH * HEIGHT, rtol=1e-12)
    points, positions = structure.pair_points, structure.pairs.positions
    lower_nodes, upper_nodes, normals = pair_nodes(structure)
    np.testing.assert_allclose(normals, np.tile([0.0, 1.0], (len(points), 1)), atol=1e-12)
    for side in (lower_nodes, upper_nodes):
        np.testing.assert_allclose(structure.nodes.points[side], points, atol=1e-12)
    for number, crack in enumerate(scene.crack_by_name.values()):
        is_own = structure.pairs.cracks == number
        start, stop = crack.span(WIDTH)
        if crack.edge == "right":
            start, stop = stop, start
        distance = np.abs(points[is_own, 0] - start)
        np.testing.assert_allclose(positions[is_own], distance, atol=1e-12)
        assert np.all(np.diff(distance) > 0.0) and distance[-1] < abs(stop - start)
        assert (distance[0] < 1e-12) == (crack.edge is not None)
        np.testing.assert_allclose(points[is_own, 1], crack.height, atol=1e-12)
        elements = round(abs(stop - start) / WIDTH * 20) if layout == "grid" else 6
        tips = 2 if crack.edge is None else 1
        assert np.sum(is_own) >= elements * order + 1 - tips
        if layout == "grid":
            assert np.sum(is_own) == elements * order + 1 - tips
        is_below = nodes_of_side(structure, (0.0, crack.height), (0.0, -1.0))
        assert np.all(is_below[lower_nodes[is_own]]) and not np.any(is_below[upper_nodes[is_own]])
    height = scene.given("crack").height
    touching_crack_changes = {
        "cracks.1.height": height,
        "cracks.1.length": 0.24,
        "cracks.1.center": 0.15,
    }
    catch_error(lambda: scene.replace(touching_crack_changes), "cracks.1.height", height)


def test_an_inner_crack_is_graded_to_both_tips() -> None:
    """Its element in the middle is ``grading`` times as long as those at the tips."""
    structure = build_structure(plate([{"center": 0.12, "height": 0.1, "length": 0.09}]))
    lengths = np.diff([0.075, *structure.pair_points[:, 0], 0.165])
    np.testing.assert_allclose(lengths, lengths[::-1], rtol=1e-6)
    assert len(lengths) == 6
    np.testing.assert_allclose(lengths[2] / lengths[0], 3.0, rtol=1e-6)


@pytest.mark.parametrize("size", [0.01, 0.05])
def test_neighbours_do_not_differ_much(size: float) -> None:
    """Between and beyond cracks, neighbouring columns and rows differ by less than a factor 2, also
    where a block is no longer than an element is asked for."""
    for cracks in (THREE, TOGETHER, mirrored(THREE)):
        structure = build_structure(plate(cracks, **{"mesh.size": size}))
        for axis in (0, 1):
            steps = np.diff(np.unique(structure.nodes.points[:, axis].round(9)))
            ratio = steps[1:] / steps[:-1]
            assert np.max(np.maximum(ratio, 1.0 / ratio)) < 2.0


def test_a_crack_near_the_edge_of_a_strip() -> None:
    """A thousandth of its height from the top of a strip 10,000 times as wide as high."""
    scene = Scene.from_mapping(
        {
            "geometry": {"width": 0.1, "height": 1e-5, "thickness": 0.01},
            "material": {"young": 2e11, "poisson": 0.3, "density": 7800.0},
            "damping": {"ratio": 0.01},
            "excitation": {"omega": 1.0},
            "loads": [{"edge": "right", "traction_mean": [1.0, 0.0]}],
            "contact": {"law": "unilateral"},
            "crack": {"edge": "left", "height": 0.9999e-5, "length": 0.04},
            "mesh": {"layout": "graded", "size": 1.0, "lip_elements": 1, "cells": "triangle"},
        }
    )
    nodes = build_structure(scene, MPI.COMM_SELF).nodes
    assert nodes is not None and len(nodes.cells) == 2 * 2 * (
        1 + 2
    )  # triangles, rows, columns left and right of the tip


def test_one_pair_of_each_crack() -> None:
    """pairs = 'mouth': those at the mouths, and the middle of a crack inside."""
    structure = build_structure(plate(THREE, **{"contact.pairs": "mouth"}))
    exact_points = [(WIDTH, 0.05), (0.12, 0.1), (0.0, 0.15)]
    np.testing.assert_allclose(structure.pair_points, exact_points, atol=1e-12)
    assert structure.watched_pairs == {
        "the mouth of crack 1": 0, "the middle of crack 2": 1, "the mouth of crack 3": 2,
    }  # fmt: skip
    assert structure.describe_pair(1) == "at the middle of crack 2"


def test_each_crack_has_its_clearance() -> None:
    """In the order of the scene, also in a varied structure of a sweep."""
    scene = plate(THREE, **{"crack.clearance": 1e-6, "cracks.2.clearance": -2e-6})
    structure = build_structure(scene)
    exact_clearance = np.array([1e-6, 0.0, -2e-6])[structure.pairs.cracks]
    np.testing.assert_array_equal(structure.clearance, exact_clearance)


def test_sides_have_names() -> None:
    """A traction on each adds up, but for what clamped nodes take: all of it at the bottom."""
    for cracks in (THREE, [THREE[0]]):

        def pushed(edge: str, cracks: list[dict[str, Any]] = cracks) -> float:
            load = f'\n[[loads]]\nedge = "{edge}"\ntraction_mean = [1.0, 0.0]\n'
            scene = Scene.from_text(plate(cracks, "grid").as_toml() + load)
            return float(build_structure(scene).force[0].sum() / scene.geometry.thickness)

        assert pushed("top") == pytest.approx(WIDTH)
        assert 0.9 * HEIGHT < pushed("left") < HEIGHT and 0.9 * HEIGHT < pushed("right") < HEIGHT
        catch_error(lambda: pushed("bottom"), "loads.1.edge", "bottom")


def test_length_of_a_crack_inside_from_a_frequency() -> None:
    """``first_omega`` finds it; with another crack it is refused."""
    inner_crack = {"center": 0.12, "height": 0.06, "length": 0.09}
    omega = float(fc.solve_modes(build_structure(plate([inner_crack])), 1).omega[0])
    scene_by_frequency = plate([inner_crack], **{"crack.length": None, "crack.first_omega": omega})
    assert fc.find_crack_length(scene_by_frequency, MPI.COMM_SELF) == pytest.approx(
        0.09, abs=1e-5 * WIDTH
    )
    catch_error(
        lambda: scene_by_frequency.replace(
            {"cracks.1.edge": "left", "cracks.1.height": 0.15, "cracks.1.length": 0.1}
        ),
        "crack.first_omega",
    )


# --- mirror images --------------------------------------------------------------------------------
@pytest.mark.parametrize("cracks", [THREE, TOGETHER], ids=["apart", "in line"])
@pytest.mark.parametrize("layout", ["grid", "graded"])
def test_mirrored_plates(layout: str, cracks: list[dict[str, Any]]) -> None:
    """Natural frequencies are the same, and so are static gaps, crack by crack."""
    original = build_structure(plate(cracks, layout))
    mirrored_plate = build_structure(plate(mirrored(cracks), layout))
    assert (original.n_dofs, original.n_pairs) == (mirrored_plate.n_dofs, mirrored_plate.n_pairs)
    omegas = [fc.solve_modes(structure, 4).omega for structure in (original, mirrored_plate)]
    np.testing.assert_allclose(*omegas, rtol=1e-8)
    mode_shapes = []
    for structure in (original, mirrored_plate):
        gap = structure.apply_bt(static(structure, structure.force[2])[None])[0]
        x = (
            structure.pair_points[:, 0]
            if structure is original
            else WIDTH - structure.pair_points[:, 0]
        )
        order = np.lexsort((x.round(9), structure.pairs.cracks))
        mode_shapes.append(np.array([x[order] / WIDTH, gap[order] / np.abs(gap).max()]))
    np.testing.assert_allclose(*mode_shapes, atol=1e-8)


def test_symmetric_cracks_open_alike() -> None:
    """Two edge cracks and a load in the middle: the gaps of the left and of the right are equal."""
    pair = [{"edge": edge, "height": 0.1, "length": 0.09} for edge in ("left", "right")]
    structure = build_structure(plate(pair))
    gap = structure.apply_bt(static(structure, structure.force[2])[None])[0]
    left, right = (gap[structure.pairs.cracks == number] for number in (0, 1))
    assert np.all(left < 0.0)
    np.testing.assert_allclose(left, right, rtol=1e-9)


@pytest.mark.parametrize("law", ["penalty", "unilateral"])
def test_contact_of_two_cracks_and_its_mirror_image(law: str) -> None:
    """The balance converges, both cracks close and open, and the mirrored plate does the same."""
    contact = {"contact.law": law, "contact.stiffness": None if law == "unilateral" else 1e8}
    cracks = [THREE[0], THREE[1]]
    gaps = []
    for placed_cracks, load in ((cracks, 1.0), (mirrored(cracks), -1.0)):
        force = {"excitation.force_sin": (load * 100.0, 300.0), "reduction.modes": 20}
        study = fc.prepare(plate(placed_cracks, **contact, **force), MPI.COMM_SELF)
        omega = 0.7 * float(fc.solve_modes(study.structure.whole, 1).omega[0])
        solution = fc.solve_harmonic_balance(
            study.structure, omega, study.contact, harmonics=7, throw=True
        )
        assert solution.converged
        gap = solution.gap(np.linspace(0.0, solution.period, 64))
        for number in (0, 1):
            assert gap[:, study.structure.pairs.cracks == number].min() < 0.0
            assert np.any(solution.contact_force(np.linspace(0.0, solution.period, 64)) > 0.0)
        x = study.structure.pair_points[:, 0]
        x = WIDTH - x if load < 0.0 else x
        gaps.append(gap[:, np.lexsort((x.round(9), study.structure.pairs.cracks))])
    np.testing.assert_allclose(*gaps, atol=1e-5 * np.abs(gaps[0]).max())


# --- several ranks --------------------------------------------------------------------------------
def summary(scene: Scene, comm: MPI.Comm) -> dict[str, Any]:
    """What must not depend on the number of ranks (collective)."""
    structure = build_structure(scene, comm)
    points = structure.nodes.points
    linear = points @ np.array([[0.3, 1.7], [-0.4, 0.9]])
    for number, crack in enumerate(scene.crack_by_name.values()):
        is_above = nodes_of_side(structure, (0.0, crack.height), (0.0, 1.0))
        linear[is_above] *= 1.5 + number
    displacement = np.zeros((1, structure.n_local))
    is_free = structure.nodes.dofs >= 0
    displacement[0, structure.nodes.dofs[is_free] - structure.first_dof] = linear[is_free]
    nodes = gather_rows(comm, points)
    return {
        "dofs": structure.n_dofs,
        "nodes": nodes[np.lexsort(nodes.round(9).T)],
        "points": structure.pair_points,
        "areas": structure.pair_areas,
        "cracks": structure.pairs.cracks,
        "positions": structure.pairs.positions,
        "clearance": structure.clearance,
        "closing": structure.apply_bt(displacement),
        "omega": fc.solve_modes(structure, 3).omega,
    }


@pytest.mark.mpi
@pytest.mark.parametrize(("layout", "order"), [("grid", 1), ("graded", 2)])
def test_two_ranks_build_the_same_cracks(
    layout: str, order: int, on_ranks: Callable[..., Any]
) -> None:
    """Nodes, pairs, their cracks, closings and natural frequencies are the serial ones on two
    ranks."""
    scene = plate(THREE, layout, **{"mesh.order": order, "cracks.1.clearance": 1e-6})
    parallel, serial = on_ranks(summary, scene), summary(scene, MPI.COMM_SELF)
    assert parallel.keys() == serial.keys()
    for name, value in serial.items():
        np.testing.assert_allclose(parallel[name], value, rtol=1e-8, atol=1e-12, err_msg=name)
