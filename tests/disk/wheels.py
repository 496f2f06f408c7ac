"""Bladed disks that tests share, and whole wheels whose mesh is a sector's, copied."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gmsh
import numpy as np

import fenics_crack as fc
from fenics_crack.basics.gmsh_process import keep_interrupt_handler
from fenics_crack.disk.wheel import Wheel

RING: dict[str, Any] = {
    "geometry": {"width": 0.012, "height": 0.08, "thickness": 0.02},
    "material": {"young": 2.1e11, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.002},
    "disk": {"sectors": 12, "inner_radius": 0.05, "outer_radius": 0.1},
    "crack": {"edge": "left", "height": 0.012, "length": 0.004},
    "contact": {"law": "unilateral"},
    "mesh": {"layout": "graded", "size": 0.004, "lip_elements": 4, "order": 2, "error": False},
    "excitation": {
        "order": 2, "frequency": 1381.8, "point": [0.0, 0.08], "force_cos": [1.0, 0.0],
    },
}  # fmt: skip
"""Twelve blades of steel in plane stress, 80 x 12 mm, on a rim of radii 50 and 100 mm."""
COARSE: dict[str, Any] = {"mesh.size": 0.012, "mesh.lip_elements": 3, "disk.sectors": 6}
"""Changes for few dofs."""
BRIEF: dict[str, Any] = {"harmonic_balance.harmonics": 5, "harmonic_balance.error": False}
"""Changes for few harmonics, whose errors are not sought."""
SOLID: dict[str, Any] = {
    **RING,
    "geometry": {"kind": "solid", "width": 0.02, "height": 0.06, "thickness": 0.008},
    "disk": {"sectors": 5, "inner_radius": 0.04, "outer_radius": 0.06},
    "crack": {"edge": "left", "height": 0.006, "length": 0.006},
    "mesh": {"layout": "graded", "size": 0.01, "lip_elements": 2, "error": False},
    "excitation": {
        "order": 1, "frequency": 1700.0, "point": [0.01, 0.06, 0.004],
        "force_cos": [0.0, 0.0, 1.0],
    },
}  # fmt: skip
"""Five blades in three dimensions."""


def ring(**changes: Any) -> fc.Scene:
    """The ring with few dofs; keys of changes have ``__`` in place of the point."""
    dotted_changes = {key.replace("__", "."): value for key, value in changes.items()}
    return fc.Scene.from_mapping(RING).replace(COARSE | dotted_changes)


def wheel_of(scene: fc.Scene) -> Wheel:
    """The whole wheel of a scene."""
    return fc.build_structure(scene)


def write_whole(wheel: Wheel, path: Path) -> None:
    """Write the mesh of a plane wheel without a crack as a mesh file: the corners of the sector's
    triangles or quadrilaterals, copied and turned, each node once."""
    nodes = wheel.sector.structure.nodes
    assert nodes is not None and nodes.cells.shape[1] in (6, 9)
    corners = 3 if nodes.cells.shape[1] == 6 else 4
    used_nodes = np.unique(nodes.cells[:, :corners])
    number = np.full(len(nodes.points), -1)
    number[used_nodes] = np.arange(len(used_nodes))
    points, cells = [], []
    for place in range(wheel.sector.n_sectors):
        moved_points = wheel.sector.turn_points(nodes.points[used_nodes], place)
        cells.append(number[nodes.cells[:, :corners]] + len(used_nodes) * place)
        points.append(moved_points)
    all_points, all_cells = np.concatenate(points), np.concatenate(cells)
    rounded_points = np.round(all_points / (1e-7 * np.ptp(all_points)))
    _, first_indices, inverse_indices = np.unique(
        rounded_points, axis=0, return_index=True, return_inverse=True
    )
    write_plane(all_points[first_indices], inverse_indices.reshape(-1)[all_cells], path)


def write_plane(points: np.ndarray, cells: np.ndarray, path: Path) -> None:
    """Write a plane mesh whose inner circle, of the nodes nearest to the axis, is the clamp."""
    radii = np.linalg.norm(points - points.mean(axis=0), axis=1)
    is_inner = radii < radii.min() * (1.0 + 1e-6)
    corners = cells.shape[1]
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    clamped_edges = edges[is_inner[edges].all(axis=1)]
    with keep_interrupt_handler():
        gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("wheel")
        gmsh.model.addDiscreteEntity(2, 1)
        gmsh.model.addDiscreteEntity(1, 1)
        space = np.column_stack([points, np.zeros(len(points))])
        gmsh.model.mesh.addNodes(2, 1, np.arange(1, len(points) + 1), space.ravel())
        gmsh.model.mesh.addElementsByType(1, 2 if corners == 3 else 3, [], (cells + 1).ravel())
        gmsh.model.mesh.addElementsByType(1, 1, [], (clamped_edges + 1).ravel())
        for dimension, tag, name in ((2, 1, "plate"), (1, 2, "clamp")):
            gmsh.model.addPhysicalGroup(dimension, [1], tag)
            gmsh.model.setPhysicalName(dimension, tag, name)
        gmsh.write(str(path))
        gmsh.finalize()


def whole_scene(scene: fc.Scene, path: Path) -> fc.Scene:
    """The scene of a mesh file of the whole wheel, whose load does not matter."""
    return fc.Scene.from_mapping(
        {
            "geometry": {"thickness": scene.geometry.thickness},
            "material": {k: getattr(scene.material, k) for k in ("young", "poisson", "density")},
            "damping": {"ratio": 0.002},
            "mesh": {"layout": "file", "file": str(path), "order": 2},
            "excitation": {
                "frequency": 1000.0, "force_cos": [1.0, 0.0],
                "point": [0.5 * scene.geometry.sides[0], scene.geometry.sides[1]],
            },
        }
    )  # fmt: skip
