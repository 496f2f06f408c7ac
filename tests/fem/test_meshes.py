"""The meshes and scenes that come with the project."""

from pathlib import Path

import numpy as np
import pytest
from helpers import DEMOS

import fenics_crack as fc


@pytest.mark.parametrize("path", sorted((DEMOS).glob("*.toml")), ids=lambda p: p.stem)
def test_scenes_load(path: Path) -> None:
    """Every scene beside the demos is valid."""
    assert isinstance(fc.Scene.load(path), fc.Scene)


def test_inclined_crack_from_a_mesh_file() -> None:
    """A mesh of one's own: normals across the crack, areas along it, and it breathes."""
    scene = fc.Scene.load(DEMOS / "inclined_crack.toml")
    plate = fc.build_structure(scene)
    along = np.array([0.035, -0.010])
    assert plate.n_pairs == 16  # eight quadratic elements
    normal = np.array([10.0, 35.0]) / np.hypot(10.0, 35.0)
    for pair in range(plate.n_pairs):
        column = plate.gap[:, pair].toarray().ravel()
        entries = column[np.flatnonzero(column)]
        assert np.allclose(np.sort(np.abs(entries)), np.sort(np.abs([*normal, *normal])))
        assert entries.sum() == pytest.approx(0.0, abs=1e-12)
    whole = 0.01 * np.hypot(*along)  # thickness times length; the tip's node keeps its share
    assert 0.97 * whole < plate.pair_areas.sum() < whole  # type: ignore[union-attr]
    assert scene.contact is not None
    solution = fc.solve_harmonic_balance(
        plate, scene.excitation.omega, fc.contact_law(scene.contact, plate), harmonics=5
    )
    gap = solution.gap(np.linspace(0.0, solution.period, 200))
    assert np.all(gap.min(axis=0) < 0.0) and gap.max() > 0.0
    assert gap.max() < 0.05 * -gap.min()
