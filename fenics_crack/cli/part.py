"""A scene for a part from a CAD file: its faces, and a proposal of clamp, load and crack."""

from __future__ import annotations

import json
import os
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_crack.draw.plot_mesh import draw_numbered_faces
from fenics_crack.fem.solid import ray_length, read_part_faces
from fenics_crack.version import packaged

MOST_FACES = 40
"""Largest faces that a scene lists and a picture numbers."""
ROOT = 0.2
"""Height of the proposed crack above the clamp, over the part's length."""


@dataclass(frozen=True)
class _Surface:
    """Triangles of a part's faces, and a point in the middle of each face.

    Attributes
    ----------
    triangles : (n, 3, 3) [m]
        Corners.
    owners, areas, normals, middles : (n,), (n,) [m^2], (n, 3), (n, 3) [m]
        Of each triangle: the number of its face, its size, outward direction and middle.
    faces : list of int
        Numbers of the faces, the largest first.
    points : (n_faces, 3) [m]
        The triangles' middles that are nearest to the faces' centers.
    """

    triangles: np.ndarray
    owners: np.ndarray
    areas: np.ndarray
    normals: np.ndarray
    middles: np.ndarray
    faces: list[int]
    points: np.ndarray

    def area(self, face: int) -> float:
        """Return the area of a face [m^2]."""
        return float(self.areas[self.owners == face].sum())

    def end(self, axis: int, *, high: bool) -> int:
        """Return the place of the largest face whose point is at an end of the part."""
        heights = self.points[:, axis]
        tolerance = 1e-3 * float(np.ptp(self.triangles[..., axis]))
        at_end = (
            heights > heights.max() - tolerance if high else heights < heights.min() + tolerance
        )
        return int(at_end.argmax())


def _surface_of(part: Path, unit: str | None) -> _Surface:
    """Measure the faces of a part."""
    surface = read_part_faces(str(part), unit)
    triangles, owners = surface["triangles"], surface["owners"]
    sides = triangles[:, 1:] - triangles[:, :1]
    normals, middles = np.cross(sides[:, 0], sides[:, 1]), triangles.mean(axis=1)
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    normals /= np.maximum(2.0 * areas, 1e-300)[:, None]
    faces = sorted(set(owners.tolist()), key=lambda face: -areas[owners == face].sum())
    points = []
    for face in faces:
        belongs = owners == face
        center = areas[belongs] @ middles[belongs] / areas[belongs].sum()
        distances = np.linalg.norm(middles[belongs] - center, axis=1)
        points.append(middles[belongs][distances.argmin()])
    return _Surface(triangles, owners, areas, normals, middles, faces, np.array(points))


def _crack_start(surface: _Surface, axis: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Propose a crack above the clamp, on the largest face along an axis: its point [m], the
    normal of the face there, and the depth of the part behind it [m]."""
    along_axis = np.eye(3)[axis]
    start_height, end_height = (
        surface.triangles[..., axis].min(),
        surface.triangles[..., axis].max(),
    )
    slopes = [np.abs(surface.normals[surface.owners == face][:, axis]).max()
              for face in surface.faces]  # fmt: skip
    place = int((np.array(slopes) < 0.7).argmax())
    belongs = surface.owners == surface.faces[place]
    target = surface.points[place] * (1.0 - along_axis)
    target[axis] = start_height + ROOT * (end_height - start_height)
    nearest_triangle = np.linalg.norm(surface.middles[belongs] - target, axis=1).argmin()
    start, normal = (
        surface.middles[belongs][nearest_triangle],
        surface.normals[belongs][nearest_triangle],
    )
    return start, normal, ray_length(start, -normal, surface.triangles)


def part_scene(part: Path, scene: Path) -> tuple[str, Path]:
    """Return the text of a scene for a part, and the picture that it writes of the faces.

    Raises
    ------
    InputError
        The file of the part cannot be used.
    """
    unit = "mm" if part.suffix.lower() == ".brep" else None
    surface = _surface_of(part, unit)
    extents = np.ptp(surface.triangles.reshape(-1, 3), axis=0)
    axis = int(extents.argmax())
    clamp, tip = (surface.points[surface.end(axis, high=high)] for high in (False, True))
    start, normal, depth = _crack_start(surface, axis)
    shown_faces = surface.faces[:MOST_FACES]
    picture = scene.with_name(f"{scene.stem}_faces.png")
    draw_numbered_faces(
        surface.triangles, surface.owners, shown_faces, surface.points, path=picture
    )
    lines = [f"clamp = [{_vector(clamp)}]", f"tip = [{_vector(tip)}]"]
    for number, (face, point) in enumerate(zip(shown_faces, surface.points, strict=False), 1):
        area = 1e6 * surface.area(face)
        lines.append(f"# face_{number} = [{_vector(point)}]  # {area:.4g} mm^2")
    words = {
        "EXTENTS": " x ".join(f"{x:.4g}" for x in extents), "UNIT": f'unit = "{unit}"',
        "PART": json.dumps(os.path.relpath(part, scene.parent)), "PICTURE": picture.name,
        "FACES": "\n".join(lines), "POINT": _vector(start), "NORMAL": _vector(np.eye(3)[axis]),
        "DIRECTION": _vector(np.cross(np.eye(3)[axis], normal)), "LOAD": _vector(tip),
        "RADII": _vector([0.5 * depth, 0.3 * depth]),
        "FORCE": _vector(np.eye(3)[np.abs(normal).argmax()]),
        "SIZE": f"{min(depth, extents[axis] / 15.0):.2g}", "SCENE": shlex.quote(scene.name),
    }  # fmt: skip
    text = packaged("cli/new_part.toml")
    for word, value in words.items():
        text = text.replace(word, value if word != "UNIT" or unit else "")
    return text, picture


def _vector(values: np.ndarray | list[float]) -> str:
    return json.dumps([float(f"{round(x, 9):.6g}") + 0.0 for x in values])
