"""Solids: what splits them, what their pairs measure, and frequencies beside other models."""

from __future__ import annotations

import itertools
import logging
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import dolfinx
import gmsh
import numpy as np
import pytest
import rotating
import scipy.sparse as sparse
import ufl
from helpers import catch_error, csr, gmsh_model
from mpi4py import MPI
from scipy.spatial.transform import Rotation as Turned
from surroundings import DEMOS, ROOT
from test_rotating_solids import BAR, LENGTH, PUSHED, SIDE, bar

import fenics_crack as fc
from fenics_crack import Scene
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem import compat
from fenics_crack.fem.compat import function_space
from fenics_crack.fem.cracks import (
    FACET_CORNERS_BY_CORNER_COUNT,
    Cells,
    find_crack_surfaces,
    split_cracks,
)
from fenics_crack.fem.loads import assemble_loads
from fenics_crack.fem.model_pairs import find_coincident_node_pairs
from fenics_crack.fem.msh_file import make_cells_of_kind
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.fem.plate import Dofs, build_plate_or_solid_mesh
from fenics_crack.model.modes import multiply_columns
from fenics_crack.model.nodes import format_point
from fenics_crack.model.rotation import relative_coriolis_shifts, static_displacement_and_forces
from fenics_crack.monitoring.scene_timing import (
    describe_probed_tip_displacement,
    find_probed_displacement_and_reversal,
    find_tip_factor_by_dof,
)
from fenics_crack.study.key_figures import find_key_figures
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.sweep.plan import Plan

MESHES = ROOT / "meshes"
WIDTH, HEIGHT, THICKNESS = 0.03, 0.09, 0.006
TEXT = f"""
geometry = {{ kind = "solid", width = {WIDTH}, height = {HEIGHT}, thickness = {THICKNESS} }}
material = {{ young = 2.1e11, poisson = 0.3, density = 7850.0 }}
damping = {{ ratio = 0.002 }}
excitation = {{ point = [0.0, {HEIGHT}, 0.003], force_cos = [0.0, 0.0, 1.0], frequency = 560.0 }}
contact = {{ law = "unilateral" }}
mesh = {{ layout = "graded", order = 2, size = 0.012, lip_elements = 2, error = false }}
"""
ELLIPSE = {"center": 0.015, "height": 0.03, "length": 0.016, "depth": 0.003, "front": "elliptical"}
CORNER = {"edge": "left", "height": 0.03, "length": 0.01, "depth": 0.004, "front": "elliptical"}
PART_THROUGH = {"edge": "right", "height": 0.04, "length": 0.01, "depth": 0.003}
THROUGH = {"edge": "left", "height": 0.03, "length": 0.01}
AREAS = {
    "ellipse": (ELLIPSE, 0.5 * math.pi * 0.008 * 0.003),
    "corner": (CORNER, 0.25 * math.pi * 0.01 * 0.004),
    "part-through": (PART_THROUGH, 0.01 * 0.003),
    "through": (THROUGH, 0.01 * THICKNESS),
}
"""Cracks, and their areas [m^2]."""


def solid(crack: dict[str, Any] | None = None, **changes: Any) -> Scene:
    """A small one."""
    scene = Scene.from_text(TEXT)
    if crack is not None:
        scene = scene.replace({f"crack.{key}": value for key, value in crack.items()})
    return scene.replace(changes) if changes else scene


def frequencies(scene: Scene, count: int = 4) -> np.ndarray:
    """With open lips [Hz]."""
    return frequencies_of(fc.build_structure(scene), count)


def frequencies_of(structure: fc.Structure, count: int = 4) -> np.ndarray:
    """Of a structure, with open lips [Hz]."""
    return fc.solve_modes(structure, count).omega / (2.0 * math.pi)


@pytest.fixture(scope="module")
def fine() -> np.ndarray:
    """Frequencies of the box with the through crack, on a fine mesh of the program's own."""
    return frequencies(solid(THROUGH, **{"mesh.size": 0.006, "mesh.lip_elements": 4}), 3)


# --- cracks ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=AREAS)
def cracked(request: pytest.FixtureRequest) -> tuple[fc.Structure, float, dict[str, Any]]:
    """The structure of each crack, and its area."""
    crack, area = AREAS[request.param]
    elements = {"mesh.lip_elements": 5 if crack is THROUGH else 2}  # room beside the front
    return fc.build_structure(solid(crack, **elements)), area, crack


def test_lips_are_those_of_the_crack(cracked: tuple[fc.Structure, float, dict[str, Any]]) -> None:
    """They lie in its plane, have its area but for a polygon's in an ellipse, and so have the
    pairs."""
    structure, area, crack = cracked
    mesh = NodalMesh(structure)
    lips = mesh.points[mesh.crack_face_sides]
    normals = np.cross(lips[:, 1] - lips[:, 0], lips[:, 2] - lips[:, 0])
    assert lips[..., 1] == pytest.approx(crack["height"], abs=1e-12)
    area_of_both_faces = 0.5 * np.linalg.norm(normals, axis=1).sum()
    assert 0.75 * area < 0.5 * area_of_both_faces <= area * (1.0 + 1e-12)
    assert normals[:, 1].sum() == pytest.approx(
        0.0, abs=1e-12 * area_of_both_faces
    )  # they look at each other
    assert 0.0 < structure.pair_areas.min()
    assert structure.pair_areas.sum() == pytest.approx(0.5 * area_of_both_faces, rel=1e-12)
    assert list(structure.watched_pairs) == ["the mouth"]


def test_pairs_measure_the_gap(cracked: tuple[fc.Structure, float, dict[str, Any]]) -> None:
    """None where the motion is continuous, a translation or a strain; d where what lies above the
    crack moves down by d: of a patch that does not reach the front exactly, as it is a mean."""
    structure, _, crack = cracked
    nodes, components = np.nonzero(structure.nodes.dofs >= 0)
    rows = structure.nodes.dofs[nodes, components]
    points = structure.nodes.points[nodes]
    strain = np.array([[1.0, 0.2, 0.1], [0.3, -0.5, 0.4], [0.2, 0.7, 0.6]])
    continuous = np.zeros((2, structure.n_dofs))
    continuous[0, rows] = components == 1
    continuous[1, rows] = ((points - points.mean(axis=0)) @ strain)[
        np.arange(len(rows)), components
    ]
    gap_of_continuous = structure.apply_bt(continuous)
    assert gap_of_continuous[0] == pytest.approx(0.0, abs=1e-12)
    assert gap_of_continuous[1] == pytest.approx(0.0, abs=1e-12)
    mesh = NodalMesh(structure)
    middles = mesh.points[mesh.cells[:, :4]].mean(axis=1)
    is_above = np.zeros(len(mesh.points), dtype=bool)
    is_above[mesh.cells[middles[:, 1] > crack["height"]]] = True
    is_below = np.zeros(len(mesh.points), dtype=bool)
    is_below[mesh.cells[middles[:, 1] < crack["height"]]] = True
    on_lips = np.unique(mesh.crack_face_sides)
    is_upper = np.isin(np.arange(len(is_above)), on_lips) & is_above & ~is_below
    # Nodes in the middle of edges between two corners of a lip belong to it, too.
    is_upper |= is_above & ~is_below & np.isclose(mesh.points[:, 1], crack["height"], atol=1e-12)
    displacement = np.zeros((1, structure.n_dofs))
    displacement[0, structure.nodes.dofs[is_upper, 1]] = -1e-6
    gap = structure.apply_bt(displacement)[0]
    assert np.all((gap > 0.1e-6) & (gap < 1.1e-6))  # towards the front it vanishes by a parabola
    if crack is THROUGH:
        assert gap[structure.first_watched_pair] == pytest.approx(1e-6, rel=1e-9)


CUBES = np.array([[0, 1, 3, 2, 4, 5, 7, 6], [4, 5, 7, 6, 8, 9, 11, 10]])
"""Two, one above the other: nodes i + 2 j + 4 k."""


def test_a_surface_without_a_front_parts_two_bodies() -> None:
    """All of its nodes exist twice; a pair is as good as another to be watched."""
    places = np.array(
        [[i, k, j] for k in range(3) for j in range(2) for i in range(2)], dtype=float
    )
    cells = Cells(CUBES, FACET_CORNERS_BY_CORNER_COUNT[8], np.eye(8, dtype=bool))
    nodes, twins, lips = split_cracks(cells, np.array([[4, 5, 7, 6]]), places)
    (crack,) = find_crack_surfaces(lips[:, 0], lips[:, 1], np.concatenate([places, places[twins]]))
    assert twins.tolist() == [4, 5, 6, 7] and not np.intersect1d(*nodes).size
    assert np.sort(lips[0], axis=1).tolist() == [[4, 5, 6, 7], [12, 13, 14, 15]]
    assert not len(crack.front_chords) and crack.points_beside((0.5, 1.0, 0.5)) is not None


def test_plates_cells_are_refused() -> None:
    """A key without effect; so are, beside a mesh file, the cells and the grading of its own."""
    catch_error(lambda: solid(THROUGH, **{"mesh.cells": "triangle"}), "mesh.cells", "triangle")
    of_a_file = Scene.load(DEMOS / "two_beams.toml")
    for key, value in {"mesh.cells": "triangle", "mesh.grading": 2.0}.items():
        catch_error(partial(of_a_file.replace, {key: value}), key, value, names="layout = 'file'")


def test_a_surface_on_the_outside_is_refused() -> None:
    """A crack lies between two cells."""
    places = np.array(
        [[i, k, j] for k in range(3) for j in range(2) for i in range(2)], dtype=float
    )
    cells = Cells(CUBES, FACET_CORNERS_BY_CORNER_COUNT[8], np.eye(8, dtype=bool))
    catch_error(
        lambda: split_cracks(cells, np.array([[0, 1, 3, 2]]), places),
        "mesh",
        "1 of the 1 facets of cracks not between cells",
    )


def draw_surface(shape: str, order: int) -> list[int]:
    """Mesh a cube of 1 m with a crack, plane, bent by a right angle or a part of a cylinder, from
    the side x = 0 to its middle, or an inner disk; the groups of its cells, its crack, and its
    mouth, if it has one."""
    occ = gmsh.model.occ
    box = [(3, occ.addBox(0.0, 0.0, 0.0, 1.0, 1.0, 1.0))]
    if shape == "inside":
        face = [(2, occ.addDisk(0.5, 0.5, 0.5, 0.3, 0.2))]
    else:
        corners = {
            "plane": [(0.0, 0.5), (0.5, 0.5)],
            "bent": [(0.0, 0.5), (0.5, 0.5), (0.5, 0.8)],
            "curved": [(0.0, 0.5), (0.4, math.hypot(0.4, 0.5))],
        }
        ends = [occ.addPoint(*end, 0.0) for end in corners[shape]]
        if shape == "curved":
            lines = [occ.addCircleArc(ends[0], occ.addPoint(0.4, 0.0, 0.0), ends[1])]
        else:
            lines = [occ.addLine(*pair) for pair in itertools.pairwise(ends)]
        entities = occ.extrude([(1, line) for line in lines], 0.0, 0.0, 1.0)
        face = [entity for entity in entities if entity[0] == 2]
    entities = [entity for piece in occ.fragment(box, face)[1][1:] for entity in piece]
    occ.synchronize()
    crack, mouth = [tag for _, tag in entities], []
    for _, tag in gmsh.model.getEntities(1):
        lower_corner, upper_corner = np.reshape(gmsh.model.getBoundingBox(1, tag), (2, 3))
        is_outer = any(
            lower_corner[i] > coordinate - 1e-6 and upper_corner[i] < coordinate + 1e-6
            for i in range(3)
            for coordinate in (0, 1)
        )
        if is_outer and tag in np.concatenate(
            [gmsh.model.getAdjacencies(2, face_tag)[1] for face_tag in crack]
        ):
            mouth.append(tag)
    groups = [
        gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)]),
        gmsh.model.addPhysicalGroup(2, crack),
    ]
    if mouth:
        groups.append(gmsh.model.addPhysicalGroup(1, mouth))
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.13)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(order)
    return groups


def cells_of_model() -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the tetrahedra of the current model, by their places in the other array: positions
    of all nodes."""
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(numbers)
    places = positions.reshape(-1, 3)[order]
    ((kind,), _, (nodes,)) = gmsh.model.mesh.getElements(3)
    size = gmsh.model.mesh.getElementProperties(kind)[3]
    return np.searchsorted(numbers[order], nodes).reshape(-1, size), places


def sharing(cells: np.ndarray, places: np.ndarray) -> set[tuple[tuple[float, ...], frozenset[int]]]:
    """Of each node its position and the cells that have it."""
    rows = np.argsort(cells.ravel(), kind="stable")
    nodes, starts = np.unique(cells.ravel()[rows], return_index=True)
    groups = np.split(rows // cells.shape[1], starts[1:])
    return {
        (tuple(places[node].round(9)), frozenset(group.tolist()))
        for node, group in zip(nodes, groups, strict=True)
    }


@pytest.mark.drawn(4)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("shape", ["plane", "bent", "curved", "inside"])
def test_cracks_are_split_as_by_gmsh(shape: str, order: int) -> None:
    """Its plugin gives every cell nodes that it shares with the same cells. The surface of what is
    left has Euler's number of a ball: V - E + F = 2, and of a ball with a hole inside: 4."""
    with gmsh_model():
        _, crack, *mouth = draw_surface(shape, order)
        cells, places = cells_of_model()
        numbers = np.sort(gmsh.model.mesh.getNodes()[0])
        facets = []
        for tag in gmsh.model.getEntitiesForPhysicalGroup(2, crack):
            _, _, (nodes,) = gmsh.model.mesh.getElements(2, tag)
            facets.append(np.searchsorted(numbers, nodes).reshape(-1, 3 * order))
        solid_cells = make_cells_of_kind(gmsh.model.mesh.getElements(3)[0][0], cells)
        nodes, twins, lips = split_cracks(solid_cells, np.concatenate(facets), places)
        sharing_by_program = sharing(nodes, np.concatenate([places, places[twins]]))
        for name, value in [("Dimension", 2), ("PhysicalGroup", crack)]:
            gmsh.plugin.setNumber("Crack", name, value)
        gmsh.plugin.setNumber("Crack", "OpenBoundaryPhysicalGroup", mouth[0] if mouth else 0)
        gmsh.plugin.run("Crack")
        assert sharing_by_program == sharing(*cells_of_model())
    (crack_surface,) = find_crack_surfaces(
        *lips[..., :3].swapaxes(0, 1), np.concatenate([places, places[twins]])
    )
    assert len(twins) > 5 and crack_surface.has_mouth == (shape != "inside")
    corners = nodes[:, FACET_CORNERS_BY_CORNER_COUNT[4]].reshape(-1, 3)
    _, first_indices, uses = np.unique(
        np.sort(corners, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer_triangles = corners[first_indices[uses == 1]]
    edges = np.unique(
        np.sort(outer_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0
    )
    euler = len(np.unique(outer_triangles)) - len(edges) + len(outer_triangles)
    assert euler == (4 if shape == "inside" else 2)


# --- frequencies ----------------------------------------------------------------------------------


def test_slender_beams_bend_as_the_theory_says() -> None:
    """Both first bending frequencies of 0.2 m of a square bar: Euler and Bernoulli's 1.8751^2
    sqrt(E I / rho A L^4), less 0.1 % for shear and rotary inertia (Timoshenko: 0.9985)."""
    side, length = 0.01, 0.2
    changes = {"geometry.width": side, "geometry.height": length, "geometry.thickness": side}
    changes |= {"mesh.size": 0.01, "material.poisson": 0.0, "contact": None}
    hertz = frequencies(solid(**changes, **{"excitation.point": [0.0, length, 0.0]}), 2)
    theory = (
        1.8751041**2 / (2.0 * math.pi) * math.sqrt(2.1e11 * side**2 / (12.0 * 7850.0)) / length**2
    )
    assert hertz == pytest.approx(theory, rel=3e-3)
    assert np.all(hertz < theory)


def test_in_its_plane_a_solid_is_a_plate() -> None:
    """Without lateral contraction the through crack of a solid has the frequencies in its plane of
    the same plate in plane stress, the nearer the finer the mesh."""
    plate = solid(THROUGH).replace(
        {
            "geometry.kind": "plate", "excitation.point": [0.0, HEIGHT],
            "excitation.force_cos": [1.0, 0.0], "material.poisson": 0.0,
            "mesh.size": 0.003, "mesh.lip_elements": 8,
        }
    )  # fmt: skip
    exact = frequencies(plate, 1)[0]
    errors = []
    for size, lips in ((0.012, 2), (0.006, 4)):
        scene = solid(
            THROUGH, **{"material.poisson": 0.0, "mesh.size": size, "mesh.lip_elements": lips}
        )
        modes = fc.solve_modes(fc.build_structure(scene), 4)
        sizes = np.linalg.norm(NodalMesh(modes.structure).nodal_vectors(modes.shapes.T), axis=1)
        in_plane = np.flatnonzero(sizes[:, 0] > sizes[:, 2])[0]
        errors.append(modes.omega[in_plane] / (2.0 * math.pi) / exact - 1.0)
    assert 0.0 < errors[1] < 0.6 * errors[0]
    assert errors[1] < 7e-3


def test_tied_lips_are_a_solid_without_a_crack() -> None:
    """But for what slides: between the frequency with open lips and that of the whole."""
    bilinear = fc.bilinear_frequencies(fc.build_structure(solid(ELLIPSE)))
    uncracked_omega = 2.0 * math.pi * frequencies(solid(contact=None), 1)[0]
    assert bilinear.omega_open[0] < bilinear.omega_bilinear[0] < bilinear.omega_tied[0]
    assert bilinear.omega_tied[0] == pytest.approx(uncracked_omega, rel=2e-3)


def test_cases_of_a_sweep_are_known_without_a_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes bound the pairs of solids; which cases there are, and whether there are any, does not
    take them."""
    sweep_scene = solid(THROUGH, **{"sweep.over": {"crack.length": [0.008, 0.01, 0.5]}})
    with monkeypatch.context() as patch:
        patch.setattr("fenics_crack.sweep.plan.build_plate_or_solid_mesh", None)
        plan = Plan(sweep_scene)
        is_scene = [isinstance(plan.scene_or_reason_at((place,)), Scene) for place in range(3)]
        assert is_scene == [True, True, False]
        catch_error(
            lambda: Plan(sweep_scene.replace({"sweep.over": {"crack.length": [0.5, 0.6]}})),
            "sweep.over",
            names="crack.length = 0.5",
        )
    assert (
        plan.n_gap_rows_upper_bound
        == max(bound for bound, _ in plan.max_pair_counts_and_first_crack_lengths)
        > 0
    )
    assert plan.max_pair_counts_and_first_crack_lengths[2] == (0, 0.0)


@pytest.mark.nightly
def test_forces_of_a_solid_are_swept(tmp_path: Path) -> None:
    """In three directions, a mean one beside one that changes, each case as solved by itself."""
    changes = {"reduction.modes": 8, "harmonic_balance.harmonics": 4, "curve": None}
    scene = solid(PART_THROUGH, **changes)
    means, cosines = [(0.0, 0.0, 0.0), (0.3, 0.5, -0.5)], [(1.0, 0.2, 0.0), (0.0, 5.0, 1.0)]
    sweep_axes = {"excitation.force_mean": means, "excitation.force_cos": cosines}
    sweep = fc.run_sweep(scene.replace({"sweep.over": sweep_axes}), tmp_path / "sweep.h5")
    assert sweep.converged.all()
    for row, mean in enumerate(means):
        for column, cosine in enumerate(cosines):
            force = {"excitation.force_mean": mean, "excitation.force_cos": cosine}
            solution = fc.solve(scene.replace(force)).result
            gap = solution.gap_coefficients
            assert np.abs(sweep.gap((row, column)) - gap).max() < 1e-6 * np.abs(gap).max()
            often = solution.period * np.arange(2**15) / 2**15  # 1e-8 from the extremes
            load_motion = solution.displacement_of_local_dofs(often) @ solution.structure.force[1]
            response = 0.5 * np.ptp(load_motion) / np.linalg.norm(cosine)
            assert sweep["response"][row, column] == pytest.approx(response, rel=1e-6)


def test_the_tip_of_a_solid_is_its_farthest_node_from_the_axis() -> None:
    """Whatever the axis: a remark on a tip that outruns all others, in rad/s for rpm most often."""
    box, speed = solid().replace({"contact": None}), "rotation.speed"
    structure = fc.build_structure(box)
    for axis, center, tip_radius in (
        ((1.0, 0.0, 0.0), (0.0, -0.2, 0.0), math.hypot(0.2 + HEIGHT, THICKNESS)),
        ((0.0, 1.0, 0.0), (0.2, 0.0, 0.0), math.hypot(0.2, THICKNESS)),
    ):
        axes = {"rotation.axis": axis, "rotation.center": center}
        rotor_scene = box.replace(axes | {speed: 6000.0})
        [remark] = remarks_on_scene(rotor_scene, structure)
        assert f"the blade tip moves at {6000.0 * tip_radius:.3g} m/s" in str(remark)
        assert str(remark).endswith("is it in rpm? then give 628.319")
        assert not remarks_on_scene(rotor_scene.replace({speed: 600.0}), structure)


# --- solutions ------------------------------------------------------------------------------------


def test_a_breathing_crack_in_bending() -> None:
    """A semi-ellipse at 0.9 of the bilinear frequency: the second harmonic of the plate of 30 x 90
    x 6 mm is 0.00288 of the first (the prototype, on another mesh), and the orbit is stable."""
    scene = solid(ELLIPSE, **{"mesh.size": 0.008, "mesh.lip_elements": 3})
    structure = fc.build_structure(scene)
    omega = 0.9 * fc.bilinear_frequencies(structure).omega_bilinear[0]
    reduced_structure = fc.reduce_structure(structure, modes=20, method="massless")
    solution = fc.solve_harmonic_balance(
        reduced_structure, omega, fc.UnilateralConstraint(), tolerance=1e-2
    )
    assert solution.indicators().ratio_2_1 == pytest.approx(0.00288, rel=0.08)
    assert fc.floquet(reduced_structure, solution).verdict == "stable"


def test_each_crack_has_a_contact_map() -> None:
    """Of cracks one above the other each shows its own plane; what never touches no negative
    pressure."""
    second = {"center": 0.01, "height": 0.06, "length": 0.008, "depth": 0.003}
    scene = solid(ELLIPSE, **{f"cracks.1.{key}": value for key, value in second.items()})
    structure = fc.reduce_structure(fc.build_structure(scene), modes=4, method="massless")
    panels = fc.draw_contact_map(fc.solve_linear(structure, 1000.0)).axes
    maps = [panel for panel in panels if panel.get_title()]
    assert [panel.get_title() for panel in maps] == ["crack 1"] * 2 + ["crack 2"] * 2
    for panel, crack in zip(maps, (ELLIPSE, ELLIPSE, second, second), strict=True):
        assert (panel.get_xlabel(), panel.get_ylabel()) == ("x [mm]", "z [mm]")
        sides = panel.dataLim.width, panel.dataLim.height
        assert sides == pytest.approx((1e3 * crack["length"], 1e3 * crack["depth"]), rel=1e-3)
        assert panel.collections[0].get_clim() == (0.0, 1.0)


# --- files ----------------------------------------------------------------------------------------


def write_box(path: Path, order: int, *, crack: bool = True, name: str = "crack") -> None:
    """A mesh of gmsh's of the box with the through crack, as a surface whose nodes exist once."""
    with gmsh_model():
        occ = gmsh.model.occ
        box = [(3, occ.addBox(0.0, 0.0, 0.0, WIDTH, HEIGHT, THICKNESS))]
        face = occ.addRectangle(0.0, 0.0, 0.0, 0.01, THICKNESS)
        occ.rotate([(2, face)], 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
        occ.translate([(2, face)], 0.0, 0.03, 0.0)
        occ.fragment(box, [(2, face)])
        occ.synchronize()
        for _, tag in gmsh.model.getEntities(2):
            x, y, z = occ.getCenterOfMass(2, tag)
            if abs(y) < 1e-9:
                gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [tag]), "clamp")
            elif crack and abs(y - 0.03) < 1e-9 and abs(x - 0.005) < 1e-6 and 0 < z < THICKNESS:
                gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [tag]), name)
        gmsh.model.addPhysicalGroup(3, [1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.006)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        gmsh.write(str(path))


def of_file(path: Path) -> Scene:
    """The scene of a mesh file."""
    removed_keys = {f"geometry.{key}": None for key in ("width", "height", "thickness")}
    mesh = {"mesh.layout": "file", "mesh.file": str(path), "mesh.size": None}
    return solid(**removed_keys | mesh | {"mesh.lip_elements": None})


@pytest.mark.parametrize("order", [1, 2])
def test_mesh_files_are_split_at_their_crack(tmp_path: Path, fine: np.ndarray, order: int) -> None:
    """Cells of first and second order; the frequencies are those of the box that is built in."""
    write_box(tmp_path / "box.msh", order)
    structure = fc.build_structure(of_file(tmp_path / "box.msh"))
    assert structure.n_pairs > 5
    assert frequencies_of(structure, 3) == pytest.approx(fine, rel=0.015)


@pytest.mark.parametrize("shape", [THROUGH, ELLIPSE], ids=["through", "ellipse"])
def test_a_mesh_that_is_written_is_read_again(tmp_path: Path, shape: dict[str, Any]) -> None:
    """With both lips in the file: the same pairs in the same order, the same frequencies; with one
    of them it is refused."""
    scene, path = solid(shape), tmp_path / "split.msh"
    fc.write_msh(scene, path)
    built_structure, read_structure = (
        fc.build_structure(source) for source in (scene, of_file(path))
    )
    assert read_structure.pair_points == pytest.approx(built_structure.pair_points, abs=1e-9)
    assert read_structure.pair_areas == pytest.approx(built_structure.pair_areas, rel=1e-9)
    assert read_structure.watched_pairs == built_structure.watched_pairs
    assert frequencies_of(read_structure) == pytest.approx(
        frequencies_of(built_structure), rel=1e-9
    )
    path.write_text(path.read_text().replace('"upper_lip"', '"other"'))
    catch_error(lambda: fc.build_structure(of_file(path)), "mesh.file", names="one lip")


@pytest.mark.nightly
def test_lips_that_a_rounding_moves_are_paired(tmp_path: Path) -> None:
    """Pairs are nodes in one place to 1e-6 of the size of the crack; distances from the front that
    are equal but for rounding do not mix them up. Lips farther apart are told how far."""
    scene = solid(ELLIPSE, **{"mesh.size": 0.008, "mesh.lip_elements": 3})
    path = tmp_path / "moved.msh"
    omega = frequencies(scene, 2)
    for noise in (5e-9, 1e-6):  # m
        fc.write_msh(scene, path)
        with gmsh_model() as model:
            gmsh.open(str(path))
            groups = {model.getPhysicalName(*group): group for group in model.getPhysicalGroups()}
            lips = [
                set(model.mesh.getNodesForPhysicalGroup(*groups[name])[0].tolist())
                for name in ("lower_lip", "upper_lip")
            ]
            moved_nodes, generator = sorted(lips[1] - lips[0]), np.random.default_rng(0)
            for node in moved_nodes:
                place = model.mesh.getNode(node)[0] + noise * generator.uniform(-1.0, 1.0, 3)
                model.mesh.setNode(node, place, [])
            gmsh.write(str(path))
        if noise < 1e-7:
            assert frequencies(of_file(path), 2) == pytest.approx(omega, rel=1e-5)
            continue
        catch_error(
            lambda: fc.build_structure(of_file(path)),
            "lips",
            "51 lower and 51 upper nodes",
            names=r" is 1\.\de-06 m ",
        )


def test_the_point_of_a_load_is_written_and_read(tmp_path: Path) -> None:
    """As of a plate: the force of the first file is that of the one that is written from it."""
    first_path, second_path = tmp_path / "first.msh", tmp_path / "second.msh"
    with gmsh_model() as model:
        model.occ.addBox(0.0, 0.0, 0.0, 1.0, 2.0, 1.0)
        model.occ.synchronize()
        corners = {tuple(model.getValue(0, tag, [])): tag for _, tag in model.getEntities(0)}
        middles = {model.occ.getCenterOfMass(2, tag)[1]: tag for _, tag in model.getEntities(2)}
        for dimension, tag, name in (
            (3, 1, "solid"), (2, middles[min(middles)], "clamp"), (0, corners[1, 2, 1], "load")
        ):  # fmt: skip
            model.setPhysicalName(dimension, model.addPhysicalGroup(dimension, [tag]), name)
        model.mesh.generate(3)
        gmsh.write(str(first_path))
    removed_keys = {"crack": None, "contact": None, "excitation.point": None}
    fc.write_msh(of_file(first_path).replace(removed_keys), second_path)
    for path in (first_path, second_path):
        structure = fc.build_structure(of_file(path).replace(removed_keys))
        assert structure.force[1, structure.find_dof((1.0, 2.0, 1.0), "z")] == pytest.approx(1.0)


def test_lips_tied_in_every_direction_are_no_crack(tmp_path: Path) -> None:
    """The patch test: with all nodes of both lips at one, the solid is the one that was not split,
    to 1e-9."""
    for name, crack in (("cracked", True), ("whole", False)):
        write_box(tmp_path / f"{name}.msh", 2, crack=crack)
    cracked_structure = fc.build_structure(of_file(tmp_path / "cracked.msh"))
    full_structure = fc.build_structure(of_file(tmp_path / "whole.msh").replace({"contact": None}))
    dofs, twins = (
        cracked_structure.nodes.dofs,
        find_coincident_node_pairs(cracked_structure.nodes.points),
    )
    assert cracked_structure.n_dofs == full_structure.n_dofs + 3 * len(twins)
    kept_dofs = np.arange(cracked_structure.n_dofs)
    kept_dofs[dofs[twins[:, 1]]] = dofs[twins[:, 0]]
    _, columns = np.unique(kept_dofs, return_inverse=True)
    tie = sparse.csr_matrix((np.ones(len(kept_dofs)), (np.arange(len(kept_dofs)), columns.ravel())))
    bonded_matrices = [
        tie.T @ csr(matrix) @ tie
        for matrix in (cracked_structure.mass, cracked_structure.stiffness)
    ]
    omegas = fc.solve_modes(fc.Structure.from_matrices(*bonded_matrices, gap=None), 6).omega
    assert omegas == pytest.approx(fc.solve_modes(full_structure, 6).omega, rel=1e-9)


def write_hexahedra(path: Path, *, incomplete: bool = False) -> None:
    """The same box of four extruded blocks, the crack between the left ones; with 20 nodes each,
    or with 8."""
    with gmsh_model():
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", int(incomplete))
        geo, xs, ys = gmsh.model.geo, (0.0, 0.01, WIDTH), (0.0, 0.03, HEIGHT)
        points = {
            (i, j): geo.addPoint(x, y, 0.0) for i, x in enumerate(xs) for j, y in enumerate(ys)
        }
        rows = {
            (i, j): geo.addLine(points[i, j], points[i + 1, j]) for i in (0, 1) for j in range(3)
        }
        columns = {
            (i, j): geo.addLine(points[i, j], points[i, j + 1]) for i in range(3) for j in (0, 1)
        }
        for (i, _), curve in rows.items():
            geo.mesh.setTransfiniteCurve(curve, 5 + i)
        for (_, j), curve in columns.items():
            geo.mesh.setTransfiniteCurve(curve, 7 + 6 * j)
        groups: dict[str, list[int]] = {"solid": [], "clamp": [], "crack": []}
        for i, j in np.ndindex(2, 2):
            sides = [rows[i, j], columns[i + 1, j], -rows[i, j + 1], -columns[i, j]]
            face = geo.addPlaneSurface([geo.addCurveLoop(sides)])
            geo.mesh.setTransfiniteSurface(face)
            geo.mesh.setRecombine(2, face)
            extruded_entities = geo.extrude(
                [(2, face)], 0.0, 0.0, THICKNESS, numElements=[2], recombine=True
            )
            groups["solid"].append(extruded_entities[1][1])
            groups["clamp"] += [extruded_entities[2][1]] * (j == 0)
            groups["crack"] += [extruded_entities[4][1]] * (i == j == 0)
        geo.synchronize()
        for name, tags in groups.items():
            dimension = 3 if name == "solid" else 2
            tag = gmsh.model.addPhysicalGroup(dimension, tags)
            gmsh.model.setPhysicalName(dimension, tag, name)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.removeDuplicateNodes()
        gmsh.model.mesh.setOrder(2 if incomplete else 1)
        gmsh.write(str(path))


@pytest.mark.nightly
def test_hexahedra(tmp_path: Path, fine: np.ndarray) -> None:
    """They give the frequencies of tetrahedra; those with 20 nodes are refused, with the reason."""
    write_hexahedra(tmp_path / "box.msh")
    structure = fc.build_structure(of_file(tmp_path / "box.msh"))
    assert structure.n_pairs == 12  # four rows of three, those of the front left out
    assert frequencies_of(structure, 3) == pytest.approx(fine, rel=0.01)
    write_hexahedra(tmp_path / "20.msh", incomplete=True)
    catch_error(
        lambda: fc.build_structure(of_file(tmp_path / "20.msh")), "mesh.file", names="20 nodes"
    )


def test_two_bodies_touch() -> None:
    """The beams of demos/ meet over 40 x 10 mm, each with its own clamp; their frequencies are
    those of one alone, and a pair opens by as much as one of them is moved."""
    structure = fc.build_structure(Scene.load(DEMOS / "two_beams.toml"))
    assert structure.pair_areas is not None and structure.n_pairs == 30
    assert structure.pair_areas.sum() == pytest.approx(0.04 * 0.01, rel=1e-9)
    assert structure.clearance == pytest.approx(1e-5)
    omega = fc.solve_modes(structure, 4).omega
    assert omega[::2] == pytest.approx(omega[1::2], rel=1e-3)
    modes = fc.solve_modes(structure, 2, lips="tied")
    shapes = NodalMesh(structure).nodal_vectors(modes.shapes.T)[0]
    assert np.abs(shapes[:, 1]).max() == pytest.approx(np.linalg.norm(shapes, axis=1).max(), 0.02)


def test_a_body_without_a_clamp_is_refused(tmp_path: Path) -> None:
    """Contact alone does not hold it."""
    text = (MESHES / "two_beams.msh").read_text()
    scene = Scene.load(DEMOS / "two_beams.toml")
    path = tmp_path / "beams.msh"
    path.write_text(text.replace('"clamp"', '"held"').replace('"pressed"', '"clamp"'))
    catch_error(
        lambda: fc.build_structure(scene.replace({"mesh.file": str(path), "loads.1.edge": "held"})),
        "mesh.file",
        names="held by contact alone",
    )


def test_files_without_what_is_needed(tmp_path: Path) -> None:
    """What lacks is named: a crack where there is contact; and one that cuts nothing."""
    path = tmp_path / "box.msh"
    write_box(path, 1, crack=False)
    catch_error(lambda: fc.build_structure(of_file(path)), "mesh.file", names="'crack'")
    path.write_text(path.read_text().replace('"clamp"', '"held"'))
    catch_error(lambda: fc.build_structure(of_file(path)), "mesh.file", names="'held'")


def test_a_surface_inside_is_a_crack_by_its_name(tmp_path: Path) -> None:
    """Else nothing would part there: half of the cracks would be left out without a word."""
    write_box(tmp_path / "box.msh", 1, name="fissure")
    catch_error(
        lambda: fc.build_structure(of_file(tmp_path / "box.msh").replace({"contact": None})),
        "mesh.file",
        names="'fissure'.*'crack'",
    )


def write_bodies(path: Path, draw: Callable[[Any], list[int]], size: float = 0.01) -> None:
    """A mesh of gmsh's of several volumes, clamped at y = 0."""
    with gmsh_model() as model:
        volumes = draw(model.occ)
        model.occ.synchronize()
        sides = [(tag, model.getBoundingBox(2, tag)) for _, tag in model.getEntities(2)]
        clamped_faces = [tag for tag, box in sides if box[4] < 1e-5]
        model.setPhysicalName(2, model.addPhysicalGroup(2, clamped_faces), "clamp")
        model.addPhysicalGroup(3, volumes)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        model.mesh.generate(3)
        model.mesh.setOrder(2)
        gmsh.write(str(path))


@pytest.mark.drawn(1)
@pytest.mark.parametrize("at", [0.015, 0.008, 0.016])
def test_bodies_that_touch_share_their_nodes(tmp_path: Path, at: float) -> None:
    """Else a slit parts them, without contact and without a word; or they overlap. Bodies that are
    joined, or do not touch, are sound."""

    def bodies(occ: Any) -> list[int]:
        return [occ.addBox(x, 0.0, 0.0, 0.015, HEIGHT, THICKNESS) for x in (0.0, at)]

    def joined(occ: Any) -> list[int]:
        first_body, second_body = bodies(occ)
        return [tag for _, tag in occ.fragment([(3, first_body)], [(3, second_body)])[0]]

    path, removed_keys = tmp_path / "bodies.msh", {"crack": None, "contact": None}
    scene = of_file(path).replace(removed_keys | {"excitation.point": [0.0, HEIGHT, 0.0]})
    write_bodies(path, joined)
    fc.build_structure(scene)
    write_bodies(path, bodies)
    if at > 0.015:
        fc.build_structure(scene)
        return
    error = catch_error(
        lambda: fc.build_structure(scene), "mesh.file", names="cells that overlap, or touch"
    )
    place = re.findall(r"[-\d.e]+(?=[,)])", str(error.value))
    assert at - 1e-6 <= float(place[0]) <= 0.015 + 1e-6


@pytest.mark.drawn(1)
@pytest.mark.parametrize(("gap", "sound"), [(0.0, False), (1e-4, True)])
def test_curved_bodies_touch(tmp_path: Path, gap: float, sound: bool) -> None:
    """A pin in a hole, whose cells differ; a gap of a hundredth of its radius is one."""

    def pin_in_a_hole(occ: Any) -> list[int]:
        radii = 0.01 - gap, 0.01, 0.02
        pin, hole, ring = (occ.addCylinder(0.0, 0.0, 0.0, 0.0, 0.03, 0.0, r) for r in radii)
        occ.cut([(3, ring)], [(3, hole)])
        return [pin, ring]

    path = tmp_path / "pin.msh"
    write_bodies(path, pin_in_a_hole, 0.006)
    point = {"excitation.point": [0.0, 0.03, 0.015]}
    scene = of_file(path).replace({"crack": None, "contact": None} | point)
    if sound:
        fc.build_structure(scene)
        return
    error = catch_error(
        lambda: fc.build_structure(scene), "mesh.file", names="cells that overlap, or touch"
    )
    x, _, z = map(float, re.findall(r"[-\d.e]+(?=[,)])", str(error.value)))
    assert math.hypot(x, z) == pytest.approx(0.01, rel=0.01)


def test_a_surface_partly_inside_is_refused(tmp_path: Path) -> None:
    """A load on it would act on its outer part alone."""
    with gmsh_model() as model:
        box = model.occ.addBox(0.0, 0.0, 0.0, WIDTH, HEIGHT, THICKNESS)
        face = model.occ.addRectangle(0.0, 0.03, 0.0, WIDTH, THICKNESS)
        model.occ.rotate([(2, face)], 0.0, 0.03, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
        parts = model.occ.fragment([(3, box)], [(2, face)])[0]
        model.occ.synchronize()
        heights_by_tag = {
            tag: model.occ.getCenterOfMass(2, tag)[1] for _, tag in model.getEntities(2)
        }
        for name, heights in (("clamp", (0.0,)), ("pressed", (0.03, HEIGHT))):
            tags = [
                tag for tag, y in heights_by_tag.items() if min(abs(y - h) for h in heights) < 1e-6
            ]
            model.setPhysicalName(2, model.addPhysicalGroup(2, tags), name)
        model.addPhysicalGroup(3, [tag for dimension, tag in parts if dimension == 3])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.01)
        model.mesh.generate(3)
        gmsh.write(str(tmp_path / "box.msh"))
    scene = of_file(tmp_path / "box.msh").replace({"crack": None, "contact": None})
    catch_error(lambda: fc.build_structure(scene), "mesh.file", names="'pressed'")


def test_a_mesh_in_mm_is_told(tmp_path: Path) -> None:
    """Also where moduli are in MPa, and where its blade is so soft that no speed seems slow."""
    path = tmp_path / "box.msh"
    write_bodies(path, lambda occ: [occ.addBox(0.0, 0.0, 0.0, 30.0, 90.0, 6.0)], 10.0)
    corner = {"excitation.point": [0.0, 90.0, 0.0], "material.young": 2.1e5}
    scene = of_file(path).replace({"crack": None, "contact": None} | corner)
    study = fc.prepare(scene, whole=True)
    remarks = remarks_on_scene(scene, study.structure, find_key_figures(study))
    assert [remark.key for remark in remarks] == ["material.young", "mesh.file"]
    assert str(remarks[1]).endswith(
        "the structure measures 6 m x 90 m; is the mesh in mm? lengths are in m"
    )
    rotor = {"rotation.rpm": 3000.0, "rotation.hub_radius": 0.2, "material.young": 2.1e11}
    catch_error(
        lambda: fc.build_structure(scene.replace(rotor)),
        "rotation.speed",
        names="3000 rpm; the mesh measures 30 x 90 x 6 m",
    )


IN_MM = (
    "geometry.width", "geometry.height", "geometry.thickness", "crack.center", "crack.height",
    "crack.length", "crack.depth", "mesh.size",
)  # fmt: skip
"""Lengths of a solid with a half ellipse."""


@pytest.mark.drawn(1)
@pytest.mark.parametrize("kind", ["solid", "plate"])
def test_metres_and_millimetres_have_one_mesh(kind: str) -> None:
    """In mm, N and t they have the same frequencies, too."""
    scene = solid(ELLIPSE)
    if kind == "plate":
        point = {"excitation.point": [0.0, HEIGHT], "excitation.force_cos": [1.0, 0.0]}
        mesh = {"mesh.cells": "triangle", "crack.depth": None, "crack.front": None}
        scene = scene.replace({"geometry.kind": "plate"} | point | mesh)
    lengths = {
        key: getattr(getattr(scene, (names := key.split("."))[0]), names[1]) for key in IN_MM
    }
    scaled_keys: dict[str, Any] = {key: 1e3 * x for key, x in lengths.items() if x is not None}
    scaled_keys |= {"excitation.point": [1e3 * x for x in scene.excitation.point or ()]}
    steel = {"material.young": 2.1e5, "material.density": 7.85e-9}
    metres, millimetres = (
        fc.build_structure(variant) for variant in (scene, scene.replace(scaled_keys | steel))
    )
    np.testing.assert_allclose(millimetres.nodes.points, 1e3 * metres.nodes.points, atol=1e-9)
    millimetre_frequencies, metre_frequencies = (
        fc.bilinear_frequencies(structure) for structure in (millimetres, metres)
    )
    np.testing.assert_allclose(
        millimetre_frequencies.omega_bilinear, metre_frequencies.omega_bilinear, rtol=1e-6
    )


TWO_CELLS = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "clamp"
3 2 "solid"
$EndPhysicalNames
$Nodes
5
1 0 0 0
2 1 0 0
3 0 0 1
4 0.3 1 0.3
5 0.3 {} 0.3
$EndNodes
$Elements
3
1 2 2 1 1 1 2 3
2 4 2 2 1 1 2 3 4
3 4 2 2 1 1 2 3 5
$EndElements
"""


@pytest.mark.parametrize(
    ("height", "names"), [("-0.5", ""), ("0.5", "cells that overlap at"), ("nan", r"1e\+06 m")]
)
def test_cells_lie_on_either_side_of_their_facet(tmp_path: Path, height: str, names: str) -> None:
    """Two on one side overlap, and what has no place is none."""
    path = tmp_path / "two.msh"
    path.write_text(TWO_CELLS.format(height))
    load = {"excitation.point": [0.3, 1.0, 0.3]}
    scene = of_file(path).replace({"crack": None, "contact": None} | load)
    if not names:
        assert fc.build_structure(scene).n_dofs == 24
        return
    catch_error(lambda: fc.build_structure(scene), "mesh.file", names=names)


# --- what is refused ------------------------------------------------------------------------------

FREE = {"mesh.size": None, "mesh.lip_elements": None}
BAD = [
    ("mesh.order", {"mesh.order": 1}),
    ("mesh.layout", {"mesh.layout": "grid", "mesh.columns": 3, "mesh.rows": 3} | FREE),
    ("excitation.point", {"excitation.point": [0.0, 0.09]}),
    ("excitation.point", {"excitation.point": [0.0, 0.09, 0.007]}),
    ("excitation.force_cos", {"excitation.force_cos": [1.0, 0.0]}),
    ("crack.depth", {"crack.depth": 0.006}),
    ("crack.front", {"crack.depth": None, "crack.front": "elliptical"}),
    ("geometry.kind", {"geometry.kind": "shell"}),
    ("geometry.thickness", {"geometry.thickness": None}),
    ("output.points.tip", {"output.points": {"tip": [0.0, 0.09]}}),
]


@pytest.mark.parametrize(("key", "changes"), BAD, ids=[f"{k}-{i}" for i, (k, _) in enumerate(BAD)])
def test_bad_input_is_named(key: str, changes: dict[str, Any]) -> None:
    catch_error(lambda: solid(ELLIPSE, **changes), key, changes.get(key, ...))


def test_the_order_of_a_mesh_is_that_of_its_dimension() -> None:
    """Where it is left out: 2 of a solid, whose file then is the same scene, and 1 of a plate."""
    left_out = solid(ELLIPSE, **{"mesh.order": None})
    assert left_out == solid(ELLIPSE) and left_out.mesh.order == 2
    assert Scene.from_text(left_out.as_toml()) == left_out
    plate_keys = {
        "geometry.kind": "plate", "excitation.point": [0.0, HEIGHT], "mesh.order": None,
        "excitation.force_cos": [1.0, 0.0],
    }  # fmt: skip
    plate = left_out.replace(plate_keys | {"crack.depth": None, "crack.front": None})
    assert plate.mesh.order == 1 and "order" not in plate.as_toml()
    assert Scene.from_text(plate.as_toml()) == plate


def test_vectors_and_shares_are_told_of_solids() -> None:
    """Of a vector that is none three numbers, too; of numbers in another unit by the word solid."""
    catch_error(
        lambda: solid(**{"excitation.force_cos": [0.0, 0.0, math.nan]}),
        "excitation.force_cos",
        [0.0, 0.0, math.nan],
        names=r"\[fx, fy, fz\]",
    )
    catch_error(lambda: solid(THROUGH, **{"crack.length": 0.03}), "crack.length", 0.03)
    [remark] = remarks_on_scene(solid(ELLIPSE, **{"crack.depth": 3e-6}))
    assert str(remark).startswith("crack.depth = 3e-06: 0.0005 of the solid's thickness")
    thick_solid = solid(**{"geometry.thickness": 1.0, "contact": None})
    remarks = [str(remark_object) for remark_object in remarks_on_scene(thick_solid)]
    assert remarks == [
        "geometry.thickness = 1: thicker than the solid is wide or high; "
        "is it in mm? then give 0.001"
    ]


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("mesh.size", {"geometry.width": 30.0, "geometry.height": 90.0, "geometry.thickness": 6.0}),
        ("mesh.size", {"mesh.size": 1e-4}),
        ("mesh.lip_elements", {"mesh.lip_elements": 10_000}),
    ],
)
def test_boxes_of_too_many_cells_are_refused(key: str, changes: dict[str, Any]) -> None:
    """Before they are meshed: one in mm whose cells are in m took all of a machine's memory."""
    catch_error(lambda: fc.build_structure(solid(ELLIPSE, **changes)), key, names="more than 5e")


def test_a_crack_that_gmsh_cannot_mesh_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one of 1 um: which ones these are depends on gmsh's version."""

    def fail(_: int) -> None:
        raise Exception("PLC Error")  # as gmsh does

    monkeypatch.setattr(gmsh.model.mesh, "generate", fail)
    catch_error(
        lambda: fc.build_structure(solid(ELLIPSE, **{"crack.depth": 1e-6})),
        "crack.depth",
        1e-6,
        names="PLC Error",
    )
    catch_error(lambda: fc.build_structure(solid(contact=None)), "mesh.size", names="PLC Error")


def test_plates_have_no_depth() -> None:
    """Nor a third direction."""
    plate = {"geometry.kind": "plate", "excitation.point": [0.0, 0.09]}
    catch_error(
        lambda: solid(ELLIPSE, **plate | {"excitation.force_cos": [1.0, 0.0]}), "crack.depth"
    )
    catch_error(lambda: solid(THROUGH, **plate), "excitation.force_cos", (0.0, 0.0, 1.0))


def test_loads_at_the_nodes_of_a_curved_side() -> None:
    """Each takes all of a load that acts at it, by its place as a refusal words it: the flat sides
    of cells leave some of them out, and rounding puts half of them beside the mesh."""
    blade = Scene.load(DEMOS / "solid_blade.toml")
    force = {"loads": None, "excitation.force_cos": [0.0, 0.0, 2.0]}
    plate = build_plate_or_solid_mesh(blade, MPI.COMM_SELF)
    dofs = Dofs(plate, function_space(plate.mesh, 2), MPI.COMM_SELF)
    side_nodes = dofs.nodes_on("suction_side")
    free_nodes = side_nodes[
        (dofs.points[side_nodes, 1] > 1e-9) & ~np.isin(side_nodes, dofs.nodes_on("lower_lip"))
    ]
    free_nodes = free_nodes[~np.isin(free_nodes, dofs.nodes_on("upper_lip"))]
    assert len(free_nodes) > 500
    for node in free_nodes[::5]:
        point = format_point(dofs.points[node]).strip("()").split(", ")
        scene = blade.replace(force | {"excitation.point": [float(x) for x in point]})
        load_rows, watched_dof = assemble_loads(scene, dofs, None)
        assert np.flatnonzero(load_rows[1]).tolist() == [3 * node + 2]
        assert load_rows[1].sum() == 2.0 and watched_dof is not None


# --- ranks ----------------------------------------------------------------------------------------


def on_ranks_of(text: str, comm: MPI.Comm) -> tuple[list[float], list[float]]:
    """Frequencies [rad/s] and sorted areas of the pairs, on all ranks."""
    structure = fc.build_structure(Scene.from_text(text), comm)
    omega = fc.solve_modes(structure, 3).omega
    rows = gather_rows(comm, structure.gap.toarray())
    return omega.tolist(), [*structure.pair_areas.tolist(), float(np.linalg.norm(rows))]


def test_two_ranks_build_the_same_solid(on_ranks: Callable[..., Any]) -> None:
    text = solid(ELLIPSE).as_toml()
    (omega, pairs) = on_ranks(on_ranks_of, text)
    serial_structure = fc.build_structure(Scene.from_text(text), MPI.COMM_SELF)
    assert omega == pytest.approx(fc.solve_modes(serial_structure, 3).omega.tolist(), rel=1e-8)
    serial_pairs = [
        *serial_structure.pair_areas.tolist(),
        float(np.linalg.norm(serial_structure.gap.toarray())),
    ]
    assert pairs == pytest.approx(serial_pairs, rel=1e-10)


# --- insides of what rotates, and of compilers ----------------------------------------------------


def equilibrium(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray]:
    """Gaps and contact forces of the static state, whose equilibrium is checked to 1e-10."""
    force = structure.force[0]
    displacement, pairs = static_displacement_and_forces(structure, force, structure.clearance)
    unbalance = (
        multiply_columns(structure.stiffness, displacement[:, None])[:, 0]
        + structure.gap @ pairs
        - force
    )
    assert np.abs(unbalance).max() < 1e-10 * np.abs(force).max()
    gap = structure.apply_bt(displacement[None])[0] - structure.clearance
    assert np.all(pairs >= 0.0) and gap.max() < 1e-10 * np.abs(displacement).max()
    assert np.abs(pairs * gap).max() <= 1e-10 * np.abs(pairs).max() * np.abs(displacement).max()
    return gap, pairs


def test_static_state_is_in_equilibrium() -> None:
    """A mean load presses the crack together, rotation opens it; in between it is half open."""
    slow, middle, fast = (
        fc.build_structure(rotating.cracked(w, -100.0)) for w in (1.0, 300.0, 600.0)
    )
    assert np.all(equilibrium(slow)[1] > 0.0)
    assert 0 < np.count_nonzero(equilibrium(middle)[1]) < middle.n_pairs
    gap, pairs = equilibrium(fast)
    assert not np.any(pairs) and np.all(gap < 0.0)
    # Equilibrium of moments and forces about the whole: rotation pulls with its centrifugal load.
    total = rotating.DENSITY * 0.02 * 0.004 * 600.0**2 * (0.3 * 0.12 + 0.12**2 / 2.0)
    load = 600.0**2 * fast.rotation.force.sum()
    assert load == pytest.approx(total, rel=0.05)  # less what the clamped row carries
    assert load < total


def test_a_clamp_of_a_file_that_is_not_where_radii_begin(tmp_path: Any) -> None:
    """It is told where the clamp is; one at y = 0 is fine."""
    grid = rotating.strip(1, 1.0)
    fc.write_msh(grid, tmp_path / "strip.msh")
    mesh = {"layout": "file", "file": str(tmp_path / "strip.msh"), "order": 2}
    scene = rotating.strip(1, 1.0, mesh=mesh, geometry={"thickness": 0.02})
    structure = fc.build_structure(scene)
    assert structure.nodes is not None and not remarks_on_scene(scene, structure)
    for offset, position_text in (
        ([0.0, 0.25], "y = 0.25 m"),
        ([0.1, -rotating.HEIGHT], f"y = {-rotating.HEIGHT:g} m"),
    ):
        nodes = replace(structure.nodes, points=structure.nodes.points + offset)
        [remark] = remarks_on_scene(scene, structure.with_places(nodes, structure.pairs))
        clamp_text = "the hub radius is measured to a clamp at y = 0"
        assert str(remark).startswith(f"rotation.hub_radius = {rotating.HEIGHT:g}: {clamp_text}")
        assert f"{position_text}: move the mesh, or give rotation.axis" in str(remark)
        remarks = remarks_on_scene(grid, structure.with_places(nodes, structure.pairs))
        assert [remark.key for remark in remarks] == ["geometry.thickness"]


def structure_at_rest(scene: Scene, comm: MPI.Comm) -> list[float]:
    """Two frequencies, the smallest gap and the sum of the contact forces (collective)."""
    plate = fc.build_structure(scene, comm)
    displacement, pairs = static_displacement_and_forces(plate, plate.force[0], plate.clearance)
    gap = plate.apply_bt(displacement[None])[0]
    return [*fc.solve_modes(plate, 2).omega, gap.min(), pairs.sum()]


@pytest.mark.mpi
def test_ranks_share_the_mesh(on_ranks: Callable[..., Any]) -> None:
    """Two ranks find the frequencies, the static opening and its forces of one."""
    scene = rotating.cracked(150.0, -100.0)
    equilibrium(fc.build_structure(scene, MPI.COMM_SELF))
    assert on_ranks(structure_at_rest, scene) == pytest.approx(
        structure_at_rest(scene, MPI.COMM_SELF), rel=1e-8
    )


def test_a_tip_passes_probes_by_its_circumferential_motion() -> None:
    """Normal to the axis and to the radius; what is given by hand stays; a tip on the axis has no
    such direction."""
    tip = [0.0, LENGTH, SIDE]
    scene = Scene.from_mapping(
        BAR
        | PUSHED
        | {
            "rotation": {"speed": 100.0, "axis": [2.0, 0.0, 0.0], "center": [0.0, -0.1, 0.0]},
            "tip_timing": {"probes": [0.0, 50.0], "tip_radius": 0.3, "order": 1},
            "output": {"points": {"tip": tip}},
        }
    )
    run = fc.solve(scene)
    structure, table = run.structure.whole, scene.given("tip_timing")
    radius = math.hypot(LENGTH + 0.1, SIDE)
    shares = {"y": -SIDE / radius, "z": (LENGTH + 0.1) / radius}
    direction = {structure.find_dof(tip, axis): share for axis, share in shares.items()}
    assert find_tip_factor_by_dof(table, run) == pytest.approx(direction, rel=1e-12)
    parts = [f"{share:.4g} times the {axis} displacement at (" for axis, share in shares.items()]
    assert all(part in describe_probed_tip_displacement(table, run) for part in parts)
    by_hand = scene.replace({"tip_timing.tangential": -0.5}).given("tip_timing")
    assert find_tip_factor_by_dof(by_hand, run) == {run.watched_dof: -0.5}
    run_with_offset = replace(
        run, scene=scene.replace({"rotation.center": [0.0, 0.0, SIDE + 5e-18]})
    )
    assert find_tip_factor_by_dof(table, run_with_offset) == {
        structure.find_dof(tip, "z"): 1.0
    }  # y by rounding
    through_it = replace(run, scene=scene.replace({"rotation.center": [1.0, LENGTH, SIDE]}))
    catch_error(lambda: find_tip_factor_by_dof(table, through_it), "output.points")


@pytest.mark.parametrize(
    ("axis", "seen"),
    [
        ([1.0, 0.0, 0.0], ("tip.uz", False)), ([-1.0, 0.0, 0.0], ("tip.uz", True)),
        ([0.0, 0.0, 1.0], ("tip.ux", True)), ([0.0, 0.0, -1.0], ("tip.ux", False)),
        ([1.0, 0.0, 1.0], None),
    ],
)  # fmt: skip
def test_probes_see_the_displacement_that_rotation_makes(
    axis: list[float], seen: tuple[str, bool] | None
) -> None:
    """The coordinate along which a small turn about the axis moves the tip, with its sign; one that
    is given by hand is of the first direction; between two coordinates it has to be."""
    tip = [0.0, LENGTH, 0.0]
    tables = {
        "rotation": {"speed": 100.0, "axis": axis, "center": [0.0, -0.1, 0.0]},
        "tip_timing": {"probes": [0.0, 50.0], "tip_radius": 0.3, "order": 1},
        "output": {"points": {"tip": tip}},
    }
    scene = Scene.from_mapping(BAR | PUSHED | tables)
    axis_direction = np.array(axis) / np.linalg.norm(axis)
    arm = np.array(tip) - [0.0, -0.1, 0.0]
    tip_motion = Turned.from_rotvec(1e-6 * axis_direction).apply(arm) - arm
    if seen is not None:
        name, is_opposed = find_probed_displacement_and_reversal(scene)
        assert (name, is_opposed) == seen
        share = (-1.0 if is_opposed else 1.0) * tip_motion["xyz".index(name[-1])]
        assert share == pytest.approx(np.linalg.norm(tip_motion), rel=1e-5)
    else:
        catch_error(
            lambda: find_probed_displacement_and_reversal(scene), "tip_timing.tangential", None
        )
    for tangential in (0.5, -0.5):
        by_hand = scene.replace({"tip_timing.tangential": tangential})
        assert find_probed_displacement_and_reversal(by_hand) == ("tip.ux", tangential < 0.0)
    catch_error(
        lambda: find_probed_displacement_and_reversal(scene.replace({"output": None})),
        "output.points",
        None,
    )


def test_coriolis_force_of_a_whirling_bar() -> None:
    """Seen by a rotor about its own axis, a square bar's bending of w_0 whirls at w_0 - W and
    w_0 + W; about one across it, the force moves bending by little; a plate's is normal to it."""
    speed, axis = 200.0 * math.pi, np.array([0.0, 1.0, 0.0])
    place = {"axis": axis.tolist(), "center": [SIDE / 2.0, 0.0, SIDE / 2.0]}
    shaft = bar(rotation={"speed": speed} | place)
    [omega_at_rest, _] = fc.solve_modes(shaft.rotation.structure_at_rest, 2).omega
    modes = fc.solve_modes(shaft, 2)
    whirl_omegas = modes.omega * (1.0 + relative_coriolis_shifts(modes, speed * axis))
    assert whirl_omegas == pytest.approx([omega_at_rest - speed, omega_at_rest + speed], rel=2e-3)
    scene = Scene.from_mapping(BAR | PUSHED | {"rotation": {"rpm": 6000.0} | place})
    [remark] = remarks_on_scene(scene, shaft)
    max_shift = np.abs(relative_coriolis_shifts(fc.solve_modes(shaft, 4), speed * axis)).max()
    assert str(remark).startswith("rotation.rpm = 6000: the Coriolis force, left out, would change")
    assert str(remark).endswith(f"by {max_shift:.2%}")
    diagram = fc.campbell(scene, [0.0, speed], 2)
    assert diagram.coriolis == pytest.approx(whirl_omegas / modes.omega - 1.0, abs=2e-3)
    catch_error(
        lambda: shaft.rotation.structure_rotating_at_speed(3.0 * speed),
        "rotation.speed",
        names="18000 rpm",
    )  # above w_0, where a shaft whirls on
    offset_scene = Scene.from_mapping(
        BAR | PUSHED | {"rotation": {"speed": 100.0, "hub_radius": 0.1}}
    )
    blade = fc.build_structure(offset_scene)
    assert np.all(
        np.abs(relative_coriolis_shifts(fc.solve_modes(blade, 4), 100.0 * axis[[1, 0, 2]])) < 1e-3
    )
    assert not remarks_on_scene(offset_scene, blade)
    plate = fc.solve_modes(fc.build_structure(rotating.strip(1, 1.0)), 2)
    assert not np.any(relative_coriolis_shifts(plate, speed * axis[[1, 0, 2]]))


def test_compiler_is_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing is told of forms compiled for the first time; warnings and other loggers are heard,
    and logging is left as it was."""
    monkeypatch.setattr(compat, "_CACHE_FOLDER", tmp_path)
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    logging_state = logging.root.level, list(logging.root.filters), logging.root.manager.disable
    space = compat.function_space(mesh, 1)
    compat.assembled_petsc_matrix(
        ufl.inner(ufl.TrialFunction(space), ufl.TestFunction(space)) * ufl.dx
    )
    assert list(tmp_path.glob("*/*.so")) and not caplog.records
    caplog.set_level(logging.INFO, "user")
    with compat._quiet_compiler_context():
        logging.warning("of the compiler")
        logging.getLogger("user").info("of the user")
    assert caplog.messages == ["of the compiler", "of the user"]
    assert logging_state == (logging.root.level, logging.root.filters, logging.root.manager.disable)
