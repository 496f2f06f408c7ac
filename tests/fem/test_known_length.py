"""A crack length found before is kept, and taken only if it still gives its frequency."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers import DEMOS
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.fem.blocks import mesh_plate


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> fc.Scene:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    coarse = {"mesh.size": 0.03, "mesh.lip_elements": 3, "mesh.order": 1}
    return fc.Scene.load(DEMOS / "breathing_plate.toml").replace(coarse)


@pytest.fixture
def meshes(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """One for each time that a plate is meshed."""
    made = list[Any]()

    def counted(scene: fc.Scene) -> Any:
        made.append(scene)
        return mesh_plate(scene)

    monkeypatch.setattr("fenics_crack.fem.plate.mesh_plate", counted)
    return made


def test_a_kept_length_is_found_with_one_plate(scene: fc.Scene, meshes: list[Any]) -> None:
    first = fc.find_crack_length(scene, MPI.COMM_SELF)
    assert len(meshes) > 3
    meshes.clear()
    assert fc.find_crack_length(scene, MPI.COMM_SELF) == first
    assert len(meshes) == 1
    # Another frequency is another length.
    other = scene.replace({"crack.first_omega": 2500.0})
    assert fc.find_crack_length(other, MPI.COMM_SELF) < first


@pytest.mark.parametrize("text", ["[0.05, 0.0]", "[0.2, 0.0]", "[1e-9, 0.0]", "{}", "no number"])
def test_a_wrong_file_is_not_believed(scene: fc.Scene, tmp_path: Path, text: str) -> None:
    first = fc.find_crack_length(scene, MPI.COMM_SELF)
    (file,) = (tmp_path / "fenics_crack").glob("length_*.json")
    file.write_text(text)
    assert fc.find_crack_length(scene, MPI.COMM_SELF) == first


def test_where_nothing_can_be_kept(
    scene: fc.Scene, meshes: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is sought each time."""
    first = fc.find_crack_length(scene, MPI.COMM_SELF)
    count = len(meshes)
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null/cache")
    for _ in range(2):
        meshes.clear()
        assert fc.find_crack_length(scene, MPI.COMM_SELF) == first
        assert len(meshes) == count
