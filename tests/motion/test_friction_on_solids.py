"""Friction on solids along one line for each pair, beside Coulomb's cone marched in time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fenics_crack as fc
from fenics_crack.errors.stated import estimate_result_errors

BLADE = fc.Scene.from_mapping(
    {
        "geometry": {"kind": "solid", "width": 0.03, "height": 0.09, "thickness": 0.006},
        "crack": {
            "center": 0.015, "height": 0.03, "length": 0.016, "depth": 0.003, "front": "elliptical",
        },
        "material": {"young": 2.1e11, "poisson": 0.3, "density": 7850.0},
        "damping": {"ratio": 0.02},
        "excitation": {
            "point": [0.0, 0.09, 0.003], "force_sin": [0.0, 0.0, 0.1], "frequency": 3474.1,
        },
        "contact": {"law": "unilateral", "friction": 0.3},
        "harmonic_balance": {"tolerance": 1e-3},
        "mesh": {"layout": "graded", "order": 2, "size": 0.006, "lip_elements": 3, "patches": 4},
        "reduction": {"method": "massless", "modes": 8},
    }
)  # fmt: skip
"""The blade that `new` writes, near its torsion."""


def solved(**keys: Any) -> fc.Run[fc.PeriodicSolution]:
    run = fc.solve(BLADE.replace({key.replace("__", "."): value for key, value in keys.items()}))
    assert run.result.converged
    return run


def test_no_friction_is_the_limit_of_little() -> None:
    """To 1e-9; and lines are unit directions in the faces, along which rigid motions slide
    nothing."""
    frictionless_run, little_friction_run = (
        solved(contact__friction=0.0),
        solved(contact__friction=1e-9),
    )
    dof = frictionless_run.watched_dof
    assert little_friction_run.result.amplitude(dof) == pytest.approx(
        frictionless_run.result.amplitude(dof), rel=1e-9
    )
    structure = little_friction_run.structure.whole
    normal, first_tangent = structure.gap, structure.tangential[:, : structure.n_pairs]
    second_tangent = structure.tangential[:, structure.n_pairs :]
    assert abs(normal.multiply(first_tangent)).max() < 1e-12
    assert abs(first_tangent.multiply(second_tangent)).max() < 1e-12
    assert first_tangent.nnz == pytest.approx(second_tangent.nnz, rel=0.1)
    translations = np.zeros((3, structure.n_dofs))
    for axis in range(3):
        rows = structure.nodes.dofs[:, axis]
        translations[axis, rows[rows >= 0]] = 1.0
    assert structure.apply_tangential(translations) == pytest.approx(0.0, abs=1e-12)


def test_turning_is_stated() -> None:
    """As an error by friction: twice its share of what friction changes."""
    keys = {"excitation.force_cos": [0.1, 0.0, 0.0], "excitation.frequency": 2700.0}
    run, frictionless_run = (
        fc.solve(BLADE.replace({**keys, "contact.friction": mu})) for mu in (0.4, 0.0)
    )
    contact = run.result.contact
    assert isinstance(contact, fc.CoulombFriction) and contact.turning
    name, dof = run.watched[0].column_name("amplitude"), run.watched_dof
    with_it, frictionless_amplitude = (
        solved_run.result.amplitude(dof) for solved_run in (run, frictionless_run)
    )
    stated_error = estimate_result_errors(run, run.result).parts["friction"][name].gci
    assert stated_error == pytest.approx(
        2.0 * contact.turning * abs(frictionless_amplitude / with_it - 1.0), rel=0.02
    )
