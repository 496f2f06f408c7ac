"""Numbers of the clamp, of crack tips and of crack fronts on a mesh that two ranks share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from test_fronts import solid
from test_reaction import plate
from test_stress_intensity import SWING, strip

import fenics_crack as fc

PULLED = {"excitation__force_mean": (0.0, 1e3, 5.0), "excitation__frequency": 400.0}
PULLED |= {"excitation__point": (0.015, 0.09, 0.003), "mesh__lip_elements": 3}
TURNED = {"excitation__force_sin": (0.0, 0.0, 1.0), "excitation__frequency": 3474.1}


def of_clamp(scene: fc.Scene, comm: MPI.Comm) -> np.ndarray:
    """Return the largest force and moment (2, 1) of the clamp (collective)."""
    return np.array([*fc.reaction(fc.solve(scene, comm)).numbers.values()])[:, None]


def of_tips(scene: fc.Scene, comm: MPI.Comm) -> np.ndarray:
    """Return the largest K_I (1, n_tips) of crack tips (collective)."""
    return np.array([fc.stress_intensity(fc.solve(scene, comm)).max_K_I_by_tip])


def of_fronts(scene: fc.Scene, comm: MPI.Comm) -> np.ndarray:
    """Return K_I, K_II and K_III (3, n) at all instants and stations (collective)."""
    stress_intensity = fc.stress_intensity(fc.solve(scene, comm))
    return np.array([stress_intensity.K_I, stress_intensity.K_II, stress_intensity.K_III]).reshape(
        3, -1
    )


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("numbers", "scene"),
    [
        (of_clamp, plate(reduction__modes=10)),
        (of_tips, strip(SWING, mesh__lip_elements=4)),
        (of_fronts, solid(**PULLED)),
        (of_fronts, solid(**TURNED, mesh__lip_elements=3)),
    ],
    ids=["clamp", "tips", "front in tension", "front in torsion"],
)
def test_same_on_two_ranks(
    numbers: Callable[..., np.ndarray], scene: fc.Scene, on_ranks: Callable[..., Any]
) -> None:
    """Relative to the largest of each kind."""
    single_numbers = numbers(scene, MPI.COMM_SELF)
    largest_numbers = np.abs(single_numbers).max(axis=1, keepdims=True)
    shared_numbers = on_ranks(numbers, scene)
    np.testing.assert_allclose(
        shared_numbers / largest_numbers, single_numbers / largest_numbers, rtol=0.0, atol=1e-6
    )
