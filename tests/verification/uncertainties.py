"""Stated uncertainties."""

from functools import cache
from typing import Any

import numpy as np
from book import Row, case, label
from stated_errors import compared, exact, on_finer_mesh, pulled_plate, with_more_modes

import fenics_crack as fc

KNOWN = 1.0, 1e-3
"""What is stated of harmonics is the error itself, by the exact orbit, and how well."""


@cache
def plate() -> fc.Verification:
    """Of the pulled plate."""
    return fc.verify(pulled_plate())


@cache
def shares() -> dict[str, list[Any]]:
    """By each cause: quantities, with their true and stated errors."""
    scene = plate().scene
    references = {
        "mesh": on_finer_mesh(scene),
        "modes": with_more_modes(plate()),
        "harmonics": exact(scene),
    }
    return {cause: list(compared("", plate(), cause, r)) for cause, r in references.items()}


def draw_shares(axes: Any) -> None:
    """True errors over stated ones."""
    for (cause, rows), mark in zip(shares().items(), "osD", strict=True):
        stated_errors, true_errors = (np.array([row[place] for row in rows]) for place in (4, 3))
        axes.loglog(100.0 * stated_errors, 100.0 * true_errors, mark, label=cause)
    ends = np.array(axes.get_xlim())
    axes.loglog(ends, ends, "k-", lw=1, label="equal")
    label(axes, xlabel="stated uncertainty [%]", ylabel="true error [%]", xlim=ends)


@case(draw=draw_shares)
def true_errors_over_stated_ones() -> list[Row]:
    """True errors over those that `fenics-crack verify` states.

    A plate of 0.1 x 0.1 m with an edge crack to its middle, clamped below and pulled to and fro at
    its upper edge, breathes: four pairs with mass, a penalty, seven harmonics, ten modes, 90
    bilinear elements (`demos/sweep.toml` with a traction). `fc.verify` states what mesh, modes and
    harmonics contribute to the error of each number.

    Reference: true errors over stated ones, which should lie between 0 and 1; by the mesh the
    change on one four times finer, by the modes that of the exact orbit with 40 modes, by the
    harmonics the distance from the exact motion (so 1). An error of first order with the factor of
    safety 1.25 gives 3/4/1.25 = 0.6. More: `benchmarks/stated_errors.py`.
    """
    rows = [
        Row(
            f"{cause}: {row[1]}",
            row[5],
            *(KNOWN if cause == "harmonics" else (0.0, 1.0)),
            absolute=True,
        )
        for cause, cause_rows in shares().items()
        for row in cause_rows
    ]
    order = plate().parts["mesh"]["omega_open_1"].order
    return [*rows, Row("observed order of omega_open_1", order, 1.0, 0.15, absolute=True)]
