"""What tests of rotation share: a slender strip, and a blade with an edge crack."""

from __future__ import annotations

import math
from typing import Any

from fenics_crack import Scene

WIDTH, HEIGHT, YOUNG, DENSITY = 0.01, 0.3, 2.1e11, 7850.0
UNIT = math.sqrt(YOUNG * WIDTH**2 / 12.0 / DENSITY) / HEIGHT**2
"""sqrt(E I / (rho A L^4)) [rad/s]."""
STRIP: dict[str, Any] = {
    "geometry": {"width": WIDTH, "height": HEIGHT, "thickness": 0.02},
    "material": {"young": YOUNG, "poisson": 0.0, "density": DENSITY},
    "damping": {"ratio": 0.01},
    "excitation": {"omega": 100.0, "point": [WIDTH, HEIGHT], "force_sin": [1.0, 0.0]},
    "mesh": {"layout": "grid", "columns": 2, "rows": 30, "order": 2},
}


def strip(ratio: float, speed: float, **tables: dict[str, Any]) -> Scene:
    """The slender strip on a hub of radius ratio * HEIGHT, at a speed in UNIT."""
    rotation = {"speed": speed * UNIT, "hub_radius": ratio * HEIGHT}
    return Scene.from_mapping(STRIP | {"rotation": rotation} | tables)


CRACKED: dict[str, Any] = {
    "geometry": {"width": 0.02, "height": 0.12, "thickness": 0.004},
    "material": {"young": YOUNG, "poisson": 0.3, "density": DENSITY},
    "damping": {"ratio": 0.005},
    "crack": {"edge": "left", "height": 0.05, "length": 0.006},
    "contact": {"law": "unilateral"},
    "excitation": {"omega": 4000.0, "point": [0.02, 0.12], "force_sin": [20.0, 0.0]},
    "mesh": {"layout": "graded", "order": 2, "size": 0.01, "lip_elements": 3, "grading": 4.0},
    "reduction": {"modes": 12},
}


def cracked(speed: float, mean: float = 0.0, **tables: dict[str, Any]) -> Scene:
    """A blade with an edge crack on a hub of 0.3 m; a mean load in x at the tip [N]."""
    excitation = CRACKED["excitation"] | {"force_mean": [mean, 0.0]}
    rotation = {"speed": speed, "hub_radius": 0.3}
    return Scene.from_mapping(CRACKED | {"excitation": excitation, "rotation": rotation} | tables)
