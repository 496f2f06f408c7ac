"""What lies between two points of a curve: windows of doublings and of instability."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from reference_flow import NoOrbit, ReferenceFlow
from verdicts import random_chain

import fenics_crack as fc
from fenics_crack.cli.given import build_scene_text
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.orbit_events import step_collision_severities

STEP, FINER = 0.05, 50
"""Default step over the range; its parts, each of which is examined."""


def lightly_damped(seed: int) -> tuple[fc.Structure, tuple[float, float], Any]:
    """A plate, from seed 1000 on a chain: structure, range [rad/s], law."""
    rng = np.random.default_rng(seed)
    ratio = float(np.exp(rng.uniform(np.log(5e-4), np.log(1e-2))))
    if seed < 1000:
        keys = {
            "crack.length": 0.1 * float(rng.uniform(0.15, 0.45)),
            "mesh.lip_elements": int(rng.integers(4, 9)),
            "reduction.modes": int(rng.integers(10, 25)), "damping.ratio": ratio,
        }  # fmt: skip
        study = fc.prepare(fc.Scene.from_text(build_scene_text("new.toml", "", ())).replace(keys))
        structure, law = study.structure, study.contact
        load_omega = float(fc.bilinear_frequencies(structure).omega_bilinear[0])
    else:
        structure, law = random_chain(seed)
        structure = structure.varied(damping=0.5)
        load_omega = float(fc.solve_modes(structure, 1).omega[0])
    load_omega *= float(rng.choice([1.0, 1.0 / 2.0, 1.0 / 3.0, rng.uniform(0.3, 3.0)]))
    return structure, (0.85 * load_omega, 1.15 * load_omega), law


def off_reference(flow: ReferenceFlow, bifurcation: Any) -> float:
    """Distance from the unit circle, or from -1, of the multiplier that a bifurcation has there, on
    the reference's orbit; inf where it has none."""
    # The exact state: Newton's method may lead elsewhere from a solution to 1e-2.
    parts = np.split(bifurcation.orbit.state, 2)
    state = flow.state(*(bifurcation.orbit.flow.modal_model.shapes @ part for part in parts))
    try:
        orbit = flow.orbit(state, bifurcation.value, 2.0 * np.pi / bifurcation.value)
    except (NoOrbit, np.linalg.LinAlgError):
        return float("inf")
    values = orbit.multipliers
    if bifurcation.kind == "period_doubling":
        return float(np.abs(values + 1.0).min())
    return float(np.abs(np.abs(values[np.abs(values.imag) > 1e-9]) - 1.0).min(initial=np.inf))


def false_verdicts(curve: fc.ResponseCurve, span: tuple[float, float]) -> dict[str, float]:
    """Share of a curve's way through its range with another verdict than the reference's, and the
    widest stretch of it, over the resolution and over the longest step taken."""
    flow, omega = ReferenceFlow(curve.structure, curve.contact), curve.values
    spacing, shapes = STEP * (span[1] - span[0]) / FINER, curve.orbit(0).flow.modal_model.shapes
    way = np.append(0.0, np.cumsum(np.abs(np.diff(omega))))
    path_positions = np.arange(spacing, way[-1], spacing)
    fold_indices = {
        curve.nearest(bifurcation)
        for bifurcation in curve.bifurcations
        if bifurcation.kind == "fold"
    }
    is_wrong, n_judged = np.zeros(len(path_positions), dtype=bool), 0
    for number, position in enumerate(path_positions):
        place = int(np.searchsorted(way, position)) - 1
        # At a fold there are two orbits, and Newton's method may find the other.
        if {place, place + 1} & fold_indices:
            continue
        share = (position - way[place]) / (way[place + 1] - way[place])
        value = float(omega[place] + share * (omega[place + 1] - omega[place]))
        state = (1.0 - share) * curve.points[place] + share * curve.points[place + 1]
        start = flow.state(*(shapes @ part for part in np.split(state, 2)))
        try:
            orbit = flow.orbit(start, value, curve.subharmonic * 2.0 * np.pi / value)
        except (NoOrbit, np.linalg.LinAlgError):
            continue
        n_judged += 1
        is_wrong[number] = (abs(orbit.multipliers[0]) < 1.0) != stated_stable(curve, place, value)
    stretches = "".join("x" if is_false else " " for is_false in is_wrong).split()
    widest = spacing * max(map(len, stretches), default=0)
    longest = float(np.abs(np.diff(omega)).max())
    return {
        "judged": n_judged, "of": len(path_positions), "false": float(is_wrong.mean()),
        "widest/resolution": widest / curve.max_missed_window_width,
        "resolution/longest": curve.max_missed_window_width / longest,
    }  # fmt: skip


def stated_stable(curve: fc.ResponseCurve, place: int, value: float) -> bool:
    """What a curve states of a value between two points: its verdict changes at the events."""
    ends = curve.values[place], curve.values[place + 1]
    events = [bifurcation.value for bifurcation in curve.bifurcations if bifurcation.kind != "fold"]
    next_events = sorted(event for event in events if min(ends) < event < max(ends))
    if not next_events:
        return bool(curve.stable[place])
    nearer = abs(value - ends[0]) < abs(next_events[0] - ends[0])
    return bool(curve.stable[place if nearer else place + 1])


@pytest.fixture(scope="module")
def doubled() -> ResponseCurve:
    """One mass with a stop, .2 % damped, past twice its bilinear frequency; frequencies relative
    to that."""
    stop, bilinear = 0.03, 2.0 * np.sqrt(1.03) / (1.0 + np.sqrt(1.03))
    structure = fc.Structure.from_matrices(
        [[bilinear**2]], [[1.0]], gap=[1.0], force_cos=[1.0], damping=[[0.004 * bilinear]]
    )
    curve = fc.continue_frequency(structure, 1.8, 2.25, fc.UnilateralPenalty(stop), tolerance=1e-2)
    assert curve.exact
    return curve


def test_a_window_between_two_stable_points(doubled: ResponseCurve) -> None:
    """Both doublings at the default step; by another flow a multiplier is -1 at each, and the
    orbit between them is unstable."""
    doublings = doubled.bifurcations
    assert [bifurcation.kind for bifurcation in doublings] == ["period_doubling"] * 2
    assert [bifurcation.value for bifurcation in doublings] == pytest.approx(
        [1.99153, 2.00859], abs=1e-5
    )
    flow = ReferenceFlow(doubled.structure, doubled.contact)
    assert max(off_reference(flow, bifurcation) for bifurcation in doublings) < 1e-6
    is_between = (doublings[0].value < doubled.values) & (doubled.values < doublings[1].value)
    assert (doubled.verdicts[is_between] == "unstable").all() and is_between.sum() >= 3
    assert (doubled.verdicts[~is_between] == "stable").all()


def test_resolution_of_a_curve(doubled: ResponseCurve) -> None:
    """A tenth of the longest step in the parameter; nothing of a single point."""
    steps = [next_omega - omega for omega, next_omega in pairwise(doubled.values)]
    assert doubled.max_missed_window_width == pytest.approx(0.1 * max(steps))
    assert doubled.part([0]).max_missed_window_width == 0.0


@pytest.mark.parametrize("coupling", [0.002, 0.01, 0.04])
@pytest.mark.parametrize("sides", [(0.1, -0.1), (0.25, -0.05), (-0.05, 0.3)])
def test_multipliers_of_a_pair_that_meet(coupling: float, sides: tuple[float, float]) -> None:
    """mu = -exp(-d +- sqrt(c^2 - a^2)), a from one side of 0 to the other: they part by 2 c, and
    one leaves the circle where c > d."""
    damping = 0.01
    generators = [np.array([[0.0, coupling + a], [coupling - a, 0.0]]) for a in sides]
    matrices = -np.exp(-damping) * np.array(
        [scipy.linalg.expm(generator) for generator in generators]
    )
    assert step_collision_severities(matrices) == pytest.approx([coupling / damping], rel=0.05)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_pair_that_comes_nearer_and_does_not_meet(side: float) -> None:
    """Both matrices have it in the same order along the circle: it has not met in between."""
    generators = [np.array([[0.0, 0.2 + a], [0.2 - a, 0.0]]) for a in (0.3 * side, 0.21 * side)]
    matrices = -np.exp(-0.01) * np.array([scipy.linalg.expm(generator) for generator in generators])
    assert step_collision_severities(matrices).tolist() == [0.0]


@pytest.mark.parametrize(("opposite", "expected"), [(True, 2.0), (False, 0.0)])
def test_two_pairs_that_meet(opposite: bool, expected: float) -> None:
    """On the circle at e^(i); of one signature they pass, of opposite ones they part."""
    damping, coupling = (0.01, 0.04), 0.04
    back_coupling = coupling if opposite else -coupling
    matrices = []
    for a in (0.1, -0.1):
        generator = np.array(
            [[-damping[0] + 1j * a, coupling], [back_coupling, -damping[1] - 1j * a]]
        )
        transition = np.exp(1j) * scipy.linalg.expm(generator)
        matrices.append(
            np.block([[transition.real, -transition.imag], [transition.imag, transition.real]])
        )
    assert step_collision_severities(np.array(matrices)) == pytest.approx([expected], abs=0.1)


def test_multipliers_that_are_double_or_zero() -> None:
    """Defective matrices have fewer eigenvectors than needed: nothing is said, nothing fails."""
    defective = np.array([[0.5, 1.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    assert np.isfinite(
        step_collision_severities(np.array([defective, defective, np.zeros((3, 3))]))
    ).all()


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [100, 1101, 1102, 1104])
def test_verdicts_between_points(seed: int) -> None:
    """Every 50th of the default step by another flow: at most .1 % of the range is false, and no
    false window is wider than the resolution, at most a fifth of the longest step."""
    structure, span, law = lightly_damped(seed)
    curve = fc.continue_frequency(structure, *span, law, tolerance=1e-2)
    verdict_counts = false_verdicts(curve, span)
    assert verdict_counts["judged"] >= 0.99 * verdict_counts["of"] > 900
    assert verdict_counts["false"] <= 1e-3
    assert (
        verdict_counts["widest/resolution"] <= 1.0 and verdict_counts["resolution/longest"] <= 0.2
    )


def test_multipliers_of_rounding() -> None:
    """Where faces stick nothing is left of the state before a period but rounding, which is not
    what multipliers that meet look like, whatever it is coupled to."""
    rng = np.random.default_rng(3)
    matrices = np.zeros((2, 5, 5))
    matrices[:, :2, :2] = scipy.linalg.expm([[-0.1, 1.0], [-1.0, -0.1]])
    matrices[:, 2:, :2] = rng.normal(size=(2, 3, 2))
    matrices[:, :, 2:] = 1e-13 * rng.normal(size=(2, 5, 3))
    assert step_collision_severities(matrices) == pytest.approx([0.0], abs=1e-6)
