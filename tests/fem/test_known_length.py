"""A crack length is found from a frequency once in a process."""

from __future__ import annotations

from typing import Any

import gmsh
import pytest
from helpers import DEMOS
from mpi4py import MPI

import fenics_crack as fc


def test_a_length_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another frequency is another length; of the same one no mesh is made again."""
    coarse_settings = {"mesh.size": 0.031, "mesh.lip_elements": 3, "mesh.order": 1}
    scene = fc.Scene.load(DEMOS / "breathing_plate.toml").replace(coarse_settings)
    mesh_calls, generate = list[Any](), gmsh.model.mesh.generate
    monkeypatch.setattr(
        gmsh.model.mesh, "generate", lambda dimension: mesh_calls.append(1) or generate(dimension)
    )
    length = fc.find_crack_length(scene, MPI.COMM_SELF)
    assert len(mesh_calls) > 3
    mesh_calls.clear()
    assert fc.find_crack_length(scene, MPI.COMM_SELF) == length and not mesh_calls
    second_length = fc.find_crack_length(
        scene.replace({"crack.first_omega": 2250.0}), MPI.COMM_SELF
    )
    assert second_length > length and mesh_calls
