"""Thada's beams with two notches: what the page claims, what is there, and the script's springs."""

import numpy as np
import outside
import pytest
from scipy.optimize import brentq
from two_notches import FAMILIES, is_held, predict

pytestmark = pytest.mark.verification
PAGE = (outside.PAGES / "thada.md").read_text()
ROOTS = np.array([4.730041, 7.853205, 10.995608, 14.137165])
"""cosh x cos x = 1: clamped at both ends."""


def boxes_of(text: str) -> list[np.ndarray]:
    """Return the boxes of a region, lower and upper ends (2, 3) each."""
    return [
        np.transpose([[float(end) for end in part.split("-")] for part in box.split(" x ")])
        for box in text.split("; ")
    ]


def test_claims_hold_what_is_there() -> None:
    """At least 12 claims of 30, and at most two whose region does not hold the notches."""
    rows = [line.strip("| ").split(" | ") for line in PAGE.splitlines() if line.startswith("| B")]
    is_row_held = {
        row[0]: is_held(boxes_of(row[5]), *(float(number) for number in row[9].split(", ")))
        for row in rows
    }
    claims = [row[0] for row in rows if row[1] == "claim"]
    n_held = sum(is_row_held[name] for name in claims)
    assert len(rows) == 30 and len(claims) >= 12 and len(claims) - n_held <= 2
    count_text = f"{n_held} of {len(claims)} claims"
    assert count_text in PAGE and count_text in (outside.PAGES / "index.md").read_text()
    assert f"{sum(is_row_held.values())} of all 30" in PAGE


def test_modes_of_the_beam_are_those_of_closed_forms() -> None:
    """Shear and rotary inertia take .3 % from mode 4 at most."""
    squares = (ROOTS**2 * 0.01) ** 2 * 2e11 / 7850.0 / 12.0
    assert np.sqrt(FAMILIES[0][0][:4]) == pytest.approx(np.sqrt(squares), rel=0.005)


def test_springs_at_the_middle_take_what_a_closed_form_says() -> None:
    """Half of the beam turns there by half of what the springs let: w' + c w'' / 2 = 0."""
    compliance = 0.02

    def turn(x: float) -> float:
        hyperbolic, circular = np.array([np.cosh(x), np.sinh(x)]), np.array([np.cos(x), np.sin(x)])
        free_pair = (hyperbolic[1] - circular[1], hyperbolic[0] + circular[0])  # w''' = 0
        slopes = hyperbolic[1] + circular[1], hyperbolic[0] - circular[0]
        curvatures = hyperbolic[0] + circular[0], hyperbolic[1] + circular[1]
        slope_pair = slopes + compliance / 2.0 * 2.0 * x * np.array(curvatures)
        return float(slope_pair[0] * free_pair[1] - slope_pair[1] * free_pair[0])

    springs = np.r_[np.log(compliance / 2.0 / 1e-3), np.zeros(13)]
    logs, drops = predict(springs, np.array([[1.0, 0.5, 0.5]]))
    ratio = (2.0 * brentq(turn, 2.0, 2.36502) / ROOTS[0]) ** 2
    assert np.exp(logs[0, 0]) == pytest.approx(ratio, rel=5e-4)
    assert drops[0, 0].sum() == pytest.approx(logs[0, 0], rel=0.05)
