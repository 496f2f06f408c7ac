"""Pairs of patches: closed forms of their areas, gaps and pressures, and answers beside nodes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers import catch_error
from mpi4py import MPI
from test_cracks import THREE, plate, summary
from test_mesh import field, nodes_of_side
from test_solids import AREAS, THICKNESS, THROUGH, solid

import fenics_crack as fc
from fenics_crack import Scene
from fenics_crack.draw.vtk import PeriodFields
from fenics_crack.model.rotation import static_displacement_and_forces
from fenics_crack.study.meshes import make_coarser_scene_or_reason, refine_scene_or_none

STRESS = 1e6
COLUMN = """
geometry = { width = 0.1, height = 0.2, thickness = 0.01 }
crack = { edge = "left", height = 0.08, length = 0.06 }
material = { young = 2e11, poisson = 0.0, density = 7800.0 }
damping = { ratio = 0.01 }
excitation = { omega = 2000.0 }
loads = [{ edge = "top", pressure_mean = 1e6, traction_sin = [0.0, 1.0] }]
contact = { law = "unilateral" }
mesh = { layout = "graded", size = 0.03, lip_elements = 12, grading = 4.0 }
"""


def column(**changes: Any) -> Scene:
    """A column under pressure with a crack across it, some keys of its mesh changed."""
    return Scene.from_text(COLUMN).replace({f"mesh.{key}": x for key, x in changes.items()})


@pytest.mark.parametrize("order", [1, 2])
def test_gaps_are_means_by_hats(order: int) -> None:
    """Of an opening that is linear from the tip those at the middles of hats; at both ends the hat
    is a half one, and the last goes on to the tip. All areas are the crack's, and a slip alike."""
    structure = fc.build_structure(column(order=order, patches=5))
    positions, areas = structure.pairs.positions, structure.pair_areas
    assert areas.sum() == pytest.approx(0.06 * 0.01, rel=1e-12)
    x = np.append(positions, 0.06)
    length = np.diff(x)
    hats = 0.5 * (np.append(0.0, length[:-1]) + np.append(length[:-1], 2.0 * length[-1]))
    assert areas == pytest.approx(0.01 * hats, rel=1e-10)
    # Integrals of psi (0.06 - x): a half hat's centre is a third from its middle.
    lower_parts = np.append(0.0, length[:-1] / 2.0 * (0.06 - x[1:-1] + length[:-1] / 3.0))
    upper_parts = np.append(
        length[:-1] / 2.0 * (0.06 - x[:-2] - length[:-1] / 3.0), length[-1] ** 2 / 2
    )
    is_upper = nodes_of_side(structure, (0.0, 0.08), (0.0, 1.0))[:, None]
    opening = np.where(is_upper, np.maximum(0.06 - structure.nodes.points[:, :1], 0.0), 0.0)
    gap = structure.apply_bt(field(structure, opening * [0.0, 1.0]))[0]
    assert -gap == pytest.approx((lower_parts + upper_parts) / hats, rel=1e-9)
    slid = structure.apply_tangential(field(structure, opening * [1.0, 0.0]))
    assert slid is not None and np.abs(slid[0]) == pytest.approx(-gap, rel=1e-12)


@pytest.mark.parametrize(
    ("order", "patches", "cells"),
    [
        *itertools.product((1, 2), (None,), ("triangle", "quadrilateral")),
        (1, 1, "quadrilateral"), (2, 4, "triangle"), (2, 99, "quadrilateral"),
    ],
)  # fmt: skip
def test_a_uniform_pressure_goes_through(order: int, patches: int | None, cells: str) -> None:
    """Faces pressed together are an uncracked column: u_y = - sigma y / E, lambda = sigma w."""
    structure = fc.build_structure(column(order=order, patches=patches, cells=cells))
    assert structure.n_pairs == min(patches or 12 * order, 12 if patches else 24)
    pressed(structure, 2e11, STRESS)


def pressed(structure: fc.Structure, young: float, stress: float) -> None:
    """Compare the static state with that without a crack."""
    displacement, forces = static_displacement_and_forces(
        structure, structure.force[0], np.zeros(structure.n_pairs)
    )
    assert forces == pytest.approx(stress * structure.pair_areas, rel=1e-9)
    y_direction = np.eye(structure.nodes.points.shape[1])[1]
    exact = field(structure, -stress / young * structure.nodes.points[:, 1:2] * y_direction)[0]
    np.testing.assert_allclose(displacement, exact, atol=1e-9 * np.abs(exact).max())


def solid_column(patches: int | None, **crack: Any) -> Scene:
    """A solid with a crack, through its thickness if none is given, under pressure."""
    crack = crack or {"edge": "left", "height": 0.03, "length": 0.012}
    text = solid(crack, **{"mesh.lip_elements": 5 if crack == THROUGH else 2}).as_toml()
    text += f'\n[[loads]]\nedge = "top"\npressure_mean = {STRESS}\n'
    changes = {"material.poisson": 0.0, "mesh.patches": patches}
    return Scene.from_text(text).replace(changes | {"excitation.force_cos": (0.0, 0.0, 1e-6)})


@pytest.mark.parametrize("patches", [2, 5])
def test_patches_of_a_solid(patches: int) -> None:
    """Alike, with the crack's whole area."""
    structure = fc.build_structure(solid_column(patches))
    assert structure.n_pairs == patches and structure.pair_areas is not None
    assert structure.pair_areas.sum() == pytest.approx(0.012 * THICKNESS, rel=1e-12)
    assert list(structure.watched_pairs) == ["the mouth"]
    pressed(structure, 2.1e11, STRESS)


@pytest.mark.parametrize("name", ["ellipse", "through"])
def test_nodes_of_a_solid(name: str) -> None:
    """Each with the area of its part of the facets and of the front: the pressure is uniform."""
    pressed(fc.build_structure(solid_column(None, **AREAS[name][0])), 2.1e11, STRESS)


@pytest.mark.parametrize("scene", [column(order=2, patches=4), solid_column(4)], ids=["2", "3"])
def test_pressures_are_drawn_between_middles(scene: Scene) -> None:
    """A uniform one at all nodes of closed faces, but for those that both share."""
    study = fc.prepare(scene, MPI.COMM_SELF)
    law = fc.UnilateralConstraint()
    solution = fc.solve_harmonic_balance(study.structure, 3500.0, law, harmonics=1)
    fields = PeriodFields(solution, 1)
    grid = pyvista.wrap(fields.make_frame_grid(0))
    shown_cells = np.flatnonzero(grid["contact state"] >= 0.0)
    full_cells = shown_cells[
        fields.nodal_weights_of_pair_pressures[shown_cells].sum(axis=1) > 0.9
    ]  # next to the front half of it
    assert grid["contact pressure"][full_cells] == pytest.approx(STRESS, rel=1e-4)
    assert np.all(grid["contact state"][shown_cells] == 1.0)
    places = fields.mesh.points[shown_cells]
    assert places[:, 1] == pytest.approx(scene.crack.height)  # type: ignore[union-attr]
    assert len(shown_cells) == 2 * 24 if scene.dimension == 2 else len(full_cells) > 2 * 4
    grid = fields.nodal_force_per_pair_force.sum(axis=0)
    assert grid[:-1] == pytest.approx(2.0) and 1.0 < grid[-1] <= 2.0  # without the tip's part
    values = [np.max(x.get_array()) for x in fc.draw_contact_map(solution).axes[0].collections]
    assert max(values) == pytest.approx(1e-6 * STRESS, rel=1e-4)


# --- answers beside those of nodes ----------------------------------------------------------------

BENDING = {
    "loads": None, "material.poisson": 0.3, "excitation.point": (0.1, 0.2),
    "excitation.force_sin": (100.0, 0.0), "reduction.modes": 12,
}  # fmt: skip


def answers(scene: Scene, omega: float, patches: int | None) -> np.ndarray:
    """Harmonics 0 to 2 of the displacement at the load."""
    study = fc.prepare(scene.replace({"mesh.patches": patches}), MPI.COMM_SELF)
    law = fc.UnilateralConstraint()
    solution = fc.solve_harmonic_balance(study.structure, omega, law, harmonics=12, throw=True)
    row = solution.coefficients_at([study.structure.whole.watched_dof])[:, 0]
    return np.array([row[0], *np.hypot(row[1::2], row[2::2])[:2]])


@pytest.mark.parametrize(
    ("elements", "order", "patches"),
    [(30, 2, 15), pytest.param(100, 2, 50, marks=pytest.mark.nightly)],
)
def test_few_patches_are_as_good_as_nodes(elements: int, order: int, patches: int) -> None:
    """A quarter of the pairs moves the tip by less than 1e-4, the second harmonic by 1 %."""
    scene = column(lip_elements=elements, order=order).replace(BENDING)
    omega = 0.8 * float(fc.bilinear_frequencies(fc.build_structure(scene)).omega_bilinear[0])
    node_answers, patch_answers = (answers(scene, omega, count) for count in (None, patches))
    assert patch_answers[1] == pytest.approx(node_answers[1], rel=1e-4)
    assert patch_answers[[0, 2]] == pytest.approx(node_answers[[0, 2]], rel=1e-2)
    assert patch_answers[1] != node_answers[1]


@pytest.mark.nightly
def test_their_error_is_stated() -> None:
    """What four patches take from the opening, a mean over the one at the mouth, is the mesh's."""
    scene = column(lip_elements=16, order=2).replace(BENDING)
    omega = 0.8 * float(fc.bilinear_frequencies(fc.build_structure(scene)).omega_bilinear[0])
    scene = scene.replace({"excitation.omega": omega, "contact.friction_error": False})
    node_run, patch_run = (fc.solve(scene.replace({"mesh.patches": count})) for count in (None, 4))
    exact = node_run.result.indicators().opening
    change = 1.0 - patch_run.result.indicators().opening / exact
    stated_error, cause = patch_run.errors.stated("opening")
    assert cause == "mesh" and 0.05 < change < 1.3 * stated_error
    assert stated_error > 1.3 * node_run.errors.stated("opening")[0]


# --- their place in the program -------------------------------------------------------------------


def test_patches_follow_the_mesh() -> None:
    """Their error is the mesh's: half as many with elements twice as long, a quarter on a solid."""
    for scene, factor in ((column(patches=8), 2), (solid_column(8), 4)):
        coarse_scene, fine_scene = (
            make_coarser_scene_or_reason(scene),
            refine_scene_or_none(scene, 2.0),
        )
        assert isinstance(coarse_scene, Scene) or scene.dimension == 3
        coarse_scene = refine_scene_or_none(scene, 0.5)
        assert (coarse_scene.mesh.patches, fine_scene.mesh.patches) == (8 // factor, 8 * factor)
    assert "patch" in str(make_coarser_scene_or_reason(column(patches=1)))


def test_refused() -> None:
    """With one pair at the mouth there are none."""
    catch_error(
        lambda: column(patches=3).replace({"contact.pairs": "mouth"}),
        "mesh.patches",
        3,
        names=r"contact\.pairs = 'mouth'",
    )
    catch_error(lambda: column(patches=0), "mesh.patches", 0)


@pytest.mark.mpi
def test_two_ranks_have_the_same_patches(on_ranks: Callable[..., Any]) -> None:
    """Of each of several cracks."""
    scene = plate(THREE, **{"mesh.order": 2, "mesh.patches": 3})
    parallel, serial = on_ranks(summary, scene), summary(scene, MPI.COMM_SELF)
    assert list(np.bincount(serial["cracks"])) == [3, 3, 3]
    for name, value in serial.items():
        np.testing.assert_allclose(parallel[name], value, rtol=1e-8, atol=1e-12, err_msg=name)
