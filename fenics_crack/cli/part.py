"""A scene for a part from a CAD file: its faces, and a proposal of clamp, load and crack."""

from __future__ import annotations

import json
import os
import shlex
from pathlib import Path

import numpy as np

from fenics_crack.draw.plot_mesh import draw_faces
from fenics_crack.fem.solid import faces_of, ray_length
from fenics_crack.version import packaged

MOST_FACES = 40
"""Largest faces that a scene lists and a picture numbers."""
ROOT = 0.2
"""Height of the proposed crack above the clamp, over the part's length."""


def part_scene(part: Path, scene: Path) -> tuple[str, Path]:
    """Return the text of a scene for a part, and the picture that it writes of the faces.

    Raises
    ------
    InputError
        The file of the part cannot be used.
    """
    unit = "mm" if part.suffix.lower() == ".brep" else None
    found = faces_of(str(part), unit)
    triangles, owners = found["triangles"], found["owners"]
    spans = triangles[:, 1:] - triangles[:, :1]
    normals, middles = np.cross(spans[:, 0], spans[:, 1]), triangles.mean(axis=1)
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    normals /= np.maximum(2.0 * areas, 1e-300)[:, None]
    faces = sorted(set(owners.tolist()), key=lambda face: -areas[owners == face].sum())
    points = []
    for face in faces:
        own = owners == face
        middle = areas[own] @ middles[own] / areas[own].sum()
        points.append(middles[own][np.linalg.norm(middles[own] - middle, axis=1).argmin()])
    places = np.array(points)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    axis = int((high - low).argmax())
    length = float((high - low)[axis])
    clamp = next(
        k for k, at in enumerate(places) if at[axis] < places[:, axis].min() + 1e-3 * length
    )
    tip = next(k for k, at in enumerate(places) if at[axis] > places[:, axis].max() - 1e-3 * length)
    unit_axis = np.eye(3)[axis]
    sides = [np.abs(normals[owners == face][:, axis]).max() < 0.7 for face in faces]
    side = sides.index(True) if any(sides) else 0
    own, target = owners == faces[side], places[side] * (1.0 - unit_axis)
    target[axis] = low[axis] + ROOT * length
    root = np.linalg.norm(middles[own] - target, axis=1).argmin()
    start, normal = middles[own][root], normals[own][root]
    deep = ray_length(start, -normal, triangles)
    picture = scene.with_name(f"{scene.stem}_faces.png")
    draw_faces(triangles, owners, faces[:MOST_FACES], places, path=picture)
    lines = [f"clamp = [{_vector(places[clamp])}]", f"tip = [{_vector(places[tip])}]"]
    for number, (face, place) in enumerate(zip(faces[:MOST_FACES], places, strict=False), 1):
        area = areas[owners == face].sum()
        lines.append(f"# face_{number} = [{_vector(place)}]  # {1e6 * area:.4g} mm^2")
    words = {
        "EXTENTS": " x ".join(f"{x:.4g}" for x in high - low), "UNIT": f'unit = "{unit}"',
        "PART": json.dumps(os.path.relpath(part, scene.parent)), "PICTURE": picture.name,
        "FACES": "\n".join(lines), "POINT": _vector(start), "NORMAL": _vector(unit_axis),
        "DIRECTION": _vector(np.cross(unit_axis, normal)), "LOAD": _vector(places[tip]),
        "RADII": _vector([0.5 * deep, 0.3 * deep]),
        "FORCE": _vector(np.eye(3)[np.abs(normal).argmax()]),
        "SIZE": f"{min(deep, length / 15.0):.2g}", "SCENE": shlex.quote(scene.name),
    }  # fmt: skip
    text = packaged("cli/new_part.toml")
    for word, value in words.items():
        text = text.replace(word, value if word != "UNIT" or unit else "")
    return text, picture


def _vector(values: np.ndarray | list[float]) -> str:
    return json.dumps([float(f"{round(x, 9):.6g}") + 0.0 for x in values])
