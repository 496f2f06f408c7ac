"""The quantities that tell of a breathing crack: their names, in words, with their units.

The names are those of columns in tables and files, of ``[output] quantities``, and of what sweeps
are drawn in. :class:`fenics_crack.Indicators` defines each by its equation.
"""

from __future__ import annotations

__all__ = [
    "OF_CLAMP", "OF_FREQUENCIES", "OF_GROWTH", "OF_LIPS", "OF_POINTS", "OF_TIPS", "QUANTITIES",
    "SHORT",
]  # fmt: skip

OF_POINTS: dict[str, tuple[str, str]] = {
    "amplitude": ("half peak-to-peak", "m"),
    "mean": ("mean displacement", "m"),
    "harmonic_1": ("amplitude at the load frequency", "m"),
    "harmonic_2": ("amplitude at twice the load frequency", "m"),
    "harmonic_3": ("amplitude at three times the load frequency", "m"),
    "ratio_2_1": ("harmonic ratio 2/1", "1"),
    "ratio_3_1": ("harmonic ratio 3/1", "1"),
    "ratio_half_1": ("harmonic ratio 1/2 over 1", "1"),
    "ratio_largest": ("largest harmonic above the load's, over harmonic 1", "1"),
    "largest_order": ("order of the largest harmonic above the load's", "1"),
    "mean_shift": ("mean displacement over harmonic 1", "1"),
}
"""Words and unit of what is known of each watched point and direction."""
OF_LIPS: dict[str, tuple[str, str]] = {
    "opening": ("largest opening", "m"),
    "penetration": ("largest penetration", "m"),
    "contact_force": ("largest contact force of a pair", "N"),
    "crack_force": ("largest contact force of a crack, all pairs", "N"),
    "closed_share": ("share of the period closed, mean over pairs", "1"),
}
"""Of all lips."""
OF_FREQUENCIES: dict[str, tuple[str, str]] = {
    "omega_open": ("natural frequency, lips open", "rad/s"),
    "omega_tied": ("natural frequency, lips tied", "rad/s"),
    "omega_bilinear": ("bilinear frequency", "rad/s"),
    "over_open": ("load frequency over that with lips open", "1"),
    "over_tied": ("load frequency over that with lips tied", "1"),
    "over_bilinear": ("load frequency over the bilinear one", "1"),
}
"""Of the mode whose bilinear frequency is nearest to the load's."""
OF_TIPS: dict[str, tuple[str, str]] = {
    "K_max": ("largest stress intensity K_I", "Pa m^0.5"),
    "K_min": ("smallest K_I", "Pa m^0.5"),
    "delta_K": ("range of K_I", "Pa m^0.5"),
    "delta_K_effective": ("range of K_I while the tip is open", "Pa m^0.5"),
    "K_II_max": ("largest stress intensity K_II, of either sign", "Pa m^0.5"),
}
"""Of the tip whose effective range is the largest; known of plates, where a scene asks for them."""
OF_GROWTH: dict[str, tuple[str, str]] = {
    "delta_K_equivalent": ("range of K_I, R = 0, that makes the crack grow as much", "Pa m^0.5")
}
"""Of the same tip, by the law of the table ``[growth]``."""
OF_CLAMP: dict[str, tuple[str, str]] = {
    "reaction_force": ("largest force of the clamp", "N"),
    "reaction_moment": ("largest moment of the clamp, about its centre", "N m"),
}
"""Of the clamp; known of meshes at rest, where a scene asks for them."""
QUANTITIES = OF_POINTS | OF_LIPS | OF_FREQUENCIES | OF_TIPS | OF_GROWTH | OF_CLAMP
"""All of them."""
SHORT = (
    "amplitude", "ratio_2_1", "ratio_3_1", "ratio_half_1", "ratio_largest", "mean_shift", "opening",
    "penetration", "contact_force", "crack_force", "closed_share", "over_open", "over_bilinear",
)  # fmt: skip
"""Printed where a scene does not choose."""
