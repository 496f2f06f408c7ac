"""Pairs that stick all the time."""

import numpy as np
import pytest
from motion.test_friction import plate

import fenics_crack as fc
from fenics_crack.model.contact import CoulombFriction
from fenics_crack.motion.flow import ContactFlow
from fenics_crack.motion.orbit import find_orbit

RIGID = fc.UnilateralConstraint()


@pytest.mark.parametrize("share", [3.0, 10.0, 30.0])
def test_pairs_that_stick_all_the_time(share: float) -> None:
    """A mean load keeps the inclined crack closed: all pairs are named, and the motion is the same
    whatever the history, though the pairs stick in other places."""
    _, full_plate = plate("inclined_crack", 0.005)
    weights = np.diag([0.0, 1.0, 1.0])
    weights[0, 2] = -share  # towards the face below
    structure = fc.reduce_structure(full_plate.varied(load=weights), modes=10, method="massless")
    flow, omega = ContactFlow(structure, CoulombFriction(RIGID, 0.6)), 2.0 * np.pi * 3183.0
    period, tips, places = 2.0 * np.pi / omega, [], []
    draw = np.random.default_rng(4)
    for size in (0.0, 0.05, 0.2):
        start = flow.rest_state + size * np.abs(flow.rest_state).max() * draw.normal(
            size=flow.state_size
        )
        for _ in range(200):
            start = flow.advance(start, omega, period).state
        orbit = find_orbit(flow, omega, start)
        assert orbit is not None and orbit.always_stuck_pair_indices.tolist() == list(range(16))
        tip_motion = (
            orbit.period_samples.states[:, : flow.n_modes] @ structure.basis[full_plate.watched_dof]
        )
        tips.append(float(np.ptp(tip_motion)))
        places.append(orbit.period_samples.slider_positions[0])
    assert tips == pytest.approx([tips[0]] * 3, rel=1e-9)
    assert np.abs(places[0] - places[2]).max() > 1e-3 * np.abs(places[0]).max()
