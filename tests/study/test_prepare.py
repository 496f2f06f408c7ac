"""A scene made ready: length found once, reduction chosen, law of its pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import fenics_crack as fc

FINE = {
    "mesh.layout": "graded", "mesh.columns": None, "mesh.rows": None, "mesh.size": 0.02,
    "mesh.lip_elements": 3, "crack.length": None, "crack.first_omega": 2300.0,
    "damping.modes": 6, "damping.ratio": 0.01,
}  # fmt: skip


@pytest.fixture
def scene(paper_scene: fc.Scene) -> fc.Scene:
    """The plate on a finer mesh, its crack given by a natural frequency."""
    return paper_scene.replace(FINE)


def test_length_is_found(scene: fc.Scene) -> None:
    """The scene comes out with its length; the structure has the frequency that was asked for."""
    study = fc.prepare(scene, MPI.COMM_SELF)
    crack = study.scene.crack
    assert crack is not None and crack.length is not None and crack.first_omega is None
    assert fc.solve_modes(study.structure.whole, 1).omega[0] == pytest.approx(2300.0, rel=1e-3)
    built = fc.build_structure(scene, MPI.COMM_SELF)
    np.testing.assert_array_equal(built.pair_points, study.structure.pair_points)


def test_reduction_stands_in_the_scene(scene: fc.Scene) -> None:
    """A larger structure is reduced unasked; what was chosen can be read, and repeated."""
    study = fc.prepare(scene, MPI.COMM_SELF)
    assert study.structure.n_dofs < study.structure.whole.n_dofs > 100
    second_study = fc.prepare(study.scene, MPI.COMM_SELF)
    assert (
        second_study.scene == study.scene
        and second_study.structure.n_dofs == study.structure.n_dofs
    )
    assert study.scene.reduction and study.contact == fc.UnilateralPenalty(1e11)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "massless"),
        ({"contact.stiffness": None, "contact.law": "unilateral"}, "massless"),
        ({"reduction.modes": 3}, "massless"),
        ({"reduction.method": "massless"}, "massless"),
        ({"damping.modes": "all"}, "massless"),
        ({"reduction.method": "free_interface"}, "free_interface"),
        ({"reduction.method": "off"}, "off"),
        ({"crack": None, "contact": None, "mesh.size": 0.01}, "free_interface"),
        ({"crack": None, "contact": None, "reduction.modes": 3}, "free_interface"),
    ],
)
def test_default_reduction(scene: fc.Scene, changes: dict[str, Any], expected: str) -> None:
    """Of a large structure with contact: lips without mass, unless the scene says otherwise."""
    if "crack" not in changes:
        changes = changes | {"crack.length": 0.05, "crack.first_omega": None}
    scene = scene.replace(changes)
    table = fc.prepare(scene, MPI.COMM_SELF).scene.reduction
    assert table is not None and table.method == expected


def test_default_reduction_of_few_dofs(paper_scene: fc.Scene) -> None:
    """None; and where all modes are kept, nothing is left to be without mass."""
    assert fc.prepare(paper_scene, MPI.COMM_SELF).scene.reduction is None
    method_by_dofs = {2: "massless", 49: "massless", 50: "free_interface", None: "free_interface"}
    for modes, method in method_by_dofs.items():
        table = "[reduction]" if modes is None else f"[reduction]\nmodes = {modes}"
        table_scene = fc.Scene.from_text(f"{paper_scene.as_toml()}\n{table}\n")
        reduction = fc.prepare(table_scene, MPI.COMM_SELF).scene.reduction
        assert (
            reduction is not None
            and reduction.method == method
            and reduction.modes == (modes or 50)
        )


def test_whole_is_not_reduced(scene: fc.Scene) -> None:
    """Whatever the scene says."""
    study = fc.prepare(scene.replace({"reduction.modes": 3}), MPI.COMM_SELF, whole=True)
    assert study.structure.whole is study.structure and study.structure.n_dofs > 100


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"mass": 20.0}, fc.RayleighDamping(20.0)),
        ({"stiffness": 1e-6}, fc.RayleighDamping(0.0, 1e-6)),
        ({"mass": 20.0, "stiffness": 1e-6}, fc.RayleighDamping(20.0, 1e-6)),
        (
            {"ratios": [0.01, 0.02], "omegas": [2300.0, 20000.0]},
            fc.RayleighDamping.from_ratios((0.01, 0.02), (2300.0, 20000.0)),
        ),
    ],
    ids=["mass", "stiffness", "both", "ratios"],
)
def test_rayleigh_damping(
    scene: fc.Scene, table: dict[str, Any], expected: fc.RayleighDamping
) -> None:
    """Of the plate and of its reduced structure, which keeps 50 modes: all are damped."""
    no_damping = {"damping.ratio": None, "damping.modes": "all"}
    damped_scene = scene.replace(
        no_damping | {f"damping.{key}": value for key, value in table.items()}
    )
    study = fc.prepare(damped_scene, MPI.COMM_SELF)
    assert study.structure.damping == study.structure.whole.damping == expected
    assert study.scene.reduction is not None and study.scene.reduction.modes == 50
