"""What the datasets of result files are: attributes ``unit`` and ``about`` for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["about"]

ROWS = (
    "rows a0, a1, b1, ..., aH, bH of a0 + sum_k a_k cos(k w t) + b_k sin(k w t), "
    "w = omega / subharmonic"
)
GAPS = f"{ROWS}; a column for each pair; positive: penetration"
ABOUT: dict[str, tuple[str, str]] = {
    "omega": ("rad/s", "load frequency, or natural frequency"),
    "gap_coefficients": ("m", GAPS),
    "force_coefficients": ("N", f"{ROWS}; a column for each pair"),
    "watched_coefficients": ("m", f"{ROWS}; along a curve points before rows; last: 'watched'"),
    "watched_displacement": ("m", "instants; 'watched'"),
    "multipliers": ("1", "Floquet multipliers, those of a curve the largest of each point"),
    "static_above": ("rad/s", "modes of higher frequencies answer contact forces at once"),
    "weight": ("N/m", "of the constraint"),
    "law_stiffness": ("N/m", "of all pairs, or of each"),
    "law_sharpness": ("1/m", ""),
    "unknowns": ("m", f"points; {GAPS}; gaps, or slow gaps where static_above is there"),
    "truncation": ("1", "points; estimated error relative to the gap"),
    "shapes": ("kg^-1/2", "modes; nodes; x and y"),
    "nodes": ("m", "nodes; x and y, and those of the middle of the cells around it"),
    "time": ("s", "instants"),
    "gap": ("m", "instants; pairs; positive: penetration"),
    "contact_force": ("N", "instants; pairs"),
    "recorded": ("m", "instants; recorded_dofs"),
    "final_state": ("m, m/s", "displacement and velocity; dofs"),
    "couplings": ("1, N", "pairs, then mean, cosine and sine part of the load; dofs"),
    "seconds": ("s", "wall-clock time"),
    "energy": ("J", "motions"),
    "rest_energy": ("J", ""),
    "length": ("m", "of the crack"),
    "solved": ("m", "lengths that were solved; between them are splines"),
    "cycles": ("1", "of the load, until the crack is so long"),
    "rate": ("m", "growth in a cycle"),
    "response": ("m", "half peak-to-peak, at the load"),
    "largest": ("Pa m^0.5", "K_I over a cycle"),
    "smallest": ("Pa m^0.5", "K_I over a cycle"),
    "effective": ("Pa m^0.5", "range of K_I while the tip is open"),
    "sliding": ("Pa m^0.5", "largest K_II"),
    "cosines": ("m", "motions; harmonics 0 to H; dofs"),
}
"""Unit, and what it is, axis by axis."""
VALUES = {"omega": "rad/s", "clearance": "m", "speed": "rad/s"}
"""Units of the parameters of a curve; the others are factors."""


def about(name: str, parts: Mapping[str, Any]) -> dict[str, str]:
    """The attributes of a dataset, of those of its file; none where it is a count or a word."""
    if name in ("values", "bifurcation_values", "exact_values") and "parameter" in parts:
        found = VALUES.get(str(parts["parameter"]), "1"), f"of the parameter {parts['parameter']}"
        if name == "exact_values":
            found = found[0], f"{found[1]} at the exact bifurcations, nan where there is none"
    elif name.startswith("error_"):
        found = "1", "estimated, relative to the gap"
    elif name.removeprefix("bifurcation_").isdigit():
        found = ABOUT["unknowns"][0], GAPS
    elif name in ABOUT:
        found = ABOUT[name]
    else:
        return {}
    return {key: words for key, words in zip(("unit", "about"), found, strict=True) if words}
