"""A scene with a finer mesh of the same kind."""

from __future__ import annotations

import math
from typing import Any

from fenics_crack.scene.scene import Scene

__all__ = ["finer_mesh"]


def finer_mesh(scene: Scene, factor: float) -> Scene | None:
    """A scene whose elements are ``factor`` times as short; None where the scene makes no mesh.

    Elements along lips are counted up to the next whole number. A grid becomes finer by the next
    whole factor, so that cracks stay on its lines.
    """
    mesh = scene.mesh
    if mesh is None or mesh.layout == "file":
        return None
    changes: dict[str, Any] = {}
    if mesh.size is not None:
        changes["mesh.size"] = mesh.size / factor
    for key in ("lip_elements", "columns", "rows"):
        count = getattr(mesh, key)
        if count is not None:
            grown = factor if key == "lip_elements" else math.ceil(factor)
            changes[f"mesh.{key}"] = math.ceil(grown * count)
    return scene.replace(changes)
