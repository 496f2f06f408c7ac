"""What backbones promise: frequency and energy of free motions."""

import judged
import numpy as np
import pytest

import fenics_crack as fc


def exact_frequency(energy: np.ndarray, stiffness: float, clearance: float) -> np.ndarray:
    """Of x'' + x + k max(x - g0, 0) = 0, g0 >= 0, whose motion is made of arcs of two circles: with
    x(0) = g0 and v^2 = 2 E - g0^2 there, w = sqrt(1 + k) beyond."""
    speed = np.sqrt(np.maximum(2.0 * energy - clearance**2, 0.0))
    closed = np.sqrt(1.0 + stiffness)
    free = 2.0 * np.arctan2(speed, -clearance)  # from g0 downwards and back to it
    inside = clearance / closed**2  # g0 beyond the middle of the other circle
    held = 2.0 * np.arctan2(speed / closed, inside) / closed
    return np.where(speed > 0.0, 2.0 * np.pi / (free + held), 1.0)


@pytest.mark.parametrize("stiffness", [1.0, 30.0])
def test_bilinear_oscillator(stiffness: float) -> None:
    """2 / (1/w1 + 1/w2) at every energy, as nothing is clear."""
    backbone = fc.follow_backbone(
        judged.oscillator(None, 0.0), fc.UnilateralPenalty(stiffness), 1, 0.1, 10.0, harmonics=40
    )
    exact = 2.0 / (1.0 + 1.0 / np.sqrt(1.0 + stiffness))
    assert backbone.complete and backbone.energy[[0, -1]] == pytest.approx([0.1, 10.0])
    assert np.abs(backbone.omega / exact - 1.0).max() < 1e-4
    assert fc.bilinear_frequencies(judged.oscillator()).omega_open[0] == pytest.approx(1.0)


def test_oscillator_with_a_stop() -> None:
    """Linear until the stop is reached, then as its two arcs say."""
    backbone = fc.follow_backbone(
        judged.oscillator(None, 0.0, 1.0), fc.UnilateralPenalty(10.0), 1, 0.05, 1e3, harmonics=40
    )
    assert backbone.complete and backbone.rest_energy == 0.0
    exact = exact_frequency(backbone.energy, 10.0, 1.0)
    assert np.abs(backbone.omega / exact - 1.0).max() < 1e-4
    linear = backbone.energy < 0.5
    assert np.abs(backbone.omega[linear] - 1.0).max() < 1e-12 and 0 < linear.sum() < len(linear)


def test_points_are_free_motions() -> None:
    """Two masses and a stop: in the exact flow without load and damping they come back, with the
    energy stated, as far off as is estimated."""
    law = fc.UnilateralPenalty(20.0)
    backbone = fc.follow_backbone(judged.two_masses(), law, 1, 0.1, 5.0, harmonics=40)
    flow = judged.flow_of(judged.two_masses().varied(load=0.0, damping=0.0), law)
    for place in (0, len(backbone.omega) // 2, len(backbone.omega) - 1):
        found = backbone.solution(place)
        state = flow.states_of(found, judged.START)[0]
        half = len(state) // 2
        assert np.abs(state[half:]).max() < 1e-12  # at rest at t = 0
        modal = state[:half] / flow.scale
        deep = np.maximum(modal @ flow.system.pairs[:, 0] - 1.0, 0.0)
        energy = 0.5 * (flow.system.squares @ modal**2 + 20.0 * deep**2)
        assert energy == pytest.approx(backbone.energy[place], rel=1e-6)
        end = flow.advance(state, 1.0, 0.0, found.period).state
        off = np.linalg.norm(end - state) / np.linalg.norm(state)
        assert off < 30.0 * found.report.truncation + 1e-9
