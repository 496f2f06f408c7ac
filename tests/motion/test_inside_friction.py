"""The exact flow with friction: laws at every instant, derivatives, known motions."""

from dataclasses import replace

import numpy as np
import pytest

import fenics_crack as fc
from fenics_crack.balance.friction_integrals import FrictionIntegrals
from fenics_crack.model.contact import CoulombFriction, FrictionContactSolver
from fenics_crack.motion.flow import ContactFlow
from fenics_crack.motion.orbit import find_orbit
from fenics_crack.numerics.fourier import sample_period

RIGID = fc.UnilateralConstraint()


def random_flow(seed: int, pairs: int, mu: float) -> ContactFlow:
    """Of a random structure with faces without mass."""
    draw = np.random.default_rng(seed)
    n = 4 * pairs + 12
    root = draw.normal(size=(n, n))
    stiffness = root @ root.T / n + 0.1 * np.eye(n)
    structure = fc.Structure.from_matrices(
        np.eye(n),
        stiffness,
        gap=draw.normal(size=(n, pairs)),
        tangential=draw.normal(size=(n, pairs)),
        force_sin=draw.normal(size=n),
        force_cos=draw.normal(size=n),
        clearance=0.2 * draw.normal(size=pairs),
        damping=fc.ModalDamping(0.01),
    )
    reduced_structure = fc.reduce_structure(structure, modes=6, method="massless", reference=False)
    return ContactFlow(reduced_structure, CoulombFriction(RIGID, mu))


@pytest.mark.parametrize(("pairs", "mu"), [(1, 0.3), (2, 0.05), (3, 0.6), (5, 0.2)])
def test_laws_at_every_instant(pairs: int, mu: float) -> None:
    """Signorini's conditions and Coulomb's, at 1,000 instants of a motion; pairs that slip go where
    their friction does not push."""
    flow = random_flow(pairs, pairs, mu)
    time = np.linspace(0.0, 60.0, 1000)
    samples = flow.advance(np.zeros(flow.state_size), 0.8, 60.0, instants=time).samples
    normal, tangential_force = np.split(samples.forces, 2, axis=1)
    gap, slide = np.split(samples.gaps, 2, axis=1)
    max_force, max_gap = np.abs(samples.forces).max(), np.abs(samples.gaps).max()
    assert {0, 1, 2, 3} <= set(np.unique(samples.pair_states))
    assert normal.min() >= -1e-12 * max_force
    assert gap.max() <= 1e-12 * max_gap
    assert np.abs(normal * gap).max() <= 1e-12 * max_force * max_gap
    assert (np.abs(tangential_force) - mu * normal).max() <= 1e-12 * max_force
    step, stays = np.diff(slide, axis=0), samples.pair_states[1:] == samples.pair_states[:-1]
    for state, sign in ((2, 1.0), (3, -1.0)):
        slips = stays & (samples.pair_states[1:] == state)
        assert (sign * step[slips]).min() >= -1e-4 * max_gap  # or it has turned twice
        assert tangential_force[1:][slips] == pytest.approx(
            sign * mu * normal[1:][slips], abs=1e-12 * max_force
        )


@pytest.mark.parametrize("pairs", [1, 2, 4])
def test_laws_from_any_state(pairs: int) -> None:
    """From states that no motion has led to the forces of the first instant are found, too."""
    states, draw = set(), np.random.default_rng(2)
    for _ in range(20):
        flow = random_flow(pairs, pairs, 0.3)  # which knows no sets yet
        start = draw.normal(size=flow.state_size)
        samples = flow.advance(start, 0.8, 1e-3, instants=np.zeros(1)).samples
        normal, tangential_force = np.split(samples.forces, 2, axis=1)
        gap = samples.gaps[:, :pairs]
        max_force, max_gap = (
            np.abs(samples.forces_and_openings[:, : 2 * pairs]).max(),
            np.abs(samples.gaps).max(),
        )
        assert normal.min() >= -1e-12 * max_force
        assert gap.max() <= 1e-12 * max_gap
        assert (np.abs(tangential_force) - 0.3 * normal).max() <= 1e-12 * max_force
        states |= set(samples.pair_states.ravel().tolist())
    assert states == {0, 1, 2, 3}


@pytest.mark.parametrize(("pairs", "mu"), [(1, 0.3), (2, 0.05), (3, 0.6), (5, 0.2)])
def test_derivative_by_state_and_places(pairs: int, mu: float) -> None:
    """M against central differences, through all events, of a motion under way."""
    flow, omega = random_flow(10 + pairs, pairs, mu), 0.8
    period = 2.0 * np.pi / omega
    start = flow.advance(np.zeros(flow.state_size), omega, 3.0 * period).state
    motion = flow.advance(start, omega, period)
    assert motion.n_events > 2
    draw = np.random.default_rng(1)
    stuck = motion.track.sets[0] == 1
    for _ in range(3):
        change = draw.normal(size=flow.state_size)
        change[2 * flow.n_modes :][~stuck] = 0.0  # where they are follows
        step = 1e-7
        ends = [flow.advance(start + s * change, omega, period).state for s in (step, -step)]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        derivative = motion.track.derivative_of_end_state @ change
        moves = ~np.concatenate(
            [np.zeros(2 * flow.n_modes, dtype=bool), (motion.track.sets == 1).all(axis=0)]
        )
        size = np.abs(derivative).max()
        assert derivative[moves] == pytest.approx(difference[moves], abs=1e-6 * size)


def jenkins(limit: float) -> ContactFlow:
    """An oscillator x with a spring k_t that slips under constant pressure, mu = 1."""
    structure = fc.Structure.from_matrices(
        np.eye(2),
        np.eye(2),
        gap=np.array([0.0, 1.0]),
        tangential=np.array([1.0, 0.0]),
        force_cos=np.array([1.0, 0.0]),
        force_mean=np.array([0.0, 2.0 * limit]),  # half of it on the spring
        damping=fc.ModalDamping(0.02),
    )
    return ContactFlow(structure, CoulombFriction(fc.UnilateralPenalty(1.0), 1.0, 0.5))


def test_jenkins_oscillator() -> None:
    """Amplitude and loss of the exact orbit; the loss per period by the closed form of a slide of
    this amplitude, 4 F (A - F / k_t), and by the balance of energies."""
    limit, omega = 0.3, 0.9
    flow, period = jenkins(limit), 2.0 * np.pi / 0.9
    start = flow.rest_state
    for _ in range(40):
        start = flow.advance(start, omega, period).state
    orbit = find_orbit(flow, omega, start)
    time = np.arange(20_000) * period / 20_000
    amplitude = 0.5 * np.ptp(orbit.displacement_at(time)[:, 0])
    assert amplitude == pytest.approx(3.69236, abs=1e-5)
    assert 4.0 * limit * (amplitude - limit / 0.5) == pytest.approx(3.71084, abs=1e-5)


@pytest.mark.parametrize("pairs", [1, 3])
def test_derivatives_of_the_forces_of_a_wave(pairs: int) -> None:
    """By the gaps, as products and as a matrix; by the coefficient: against differences, of waves
    whose pairs open, stick and slip."""
    draw, harmonics = np.random.default_rng(6), 4
    root = draw.normal(size=(2 * pairs, 2 * pairs))
    residual = 0.3 * root @ root.T / (2 * pairs) + np.eye(2 * pairs)
    integrals = FrictionIntegrals(
        CoulombFriction(RIGID, 0.4), harmonics, residual_compliance=residual, samples=512
    )
    gap = draw.normal(size=(2 * harmonics + 1, 2 * pairs))
    gap /= np.arange(1, 2 * harmonics + 2)[:, None]
    gap[0, :pairs] = 0.2
    wave_forces = integrals.linearise(gap)
    assert {0, 1, 2, 3} <= set(np.unique(wave_forces.contact_states))
    change, step = draw.normal(size=gap.shape), 1e-7
    ends = [integrals.force(gap + sign * step * change) for sign in (1.0, -1.0)]
    difference = (ends[0] - ends[1]) / (2.0 * step)
    assert wave_forces.force_change(change) == pytest.approx(
        difference, abs=1e-6 * np.abs(difference).max()
    )
    matrix = wave_forces.tangent().reshape(gap.size, gap.size)
    product = (matrix @ change.ravel()).reshape(gap.shape)
    assert product == pytest.approx(
        wave_forces.force_change(change), abs=1e-12 * np.abs(difference).max()
    )
    ends = [
        replace(integrals, friction_coefficient_factor=1.0 + sign * step).force(gap)
        for sign in (1.0, -1.0)
    ]
    difference = (ends[0] - ends[1]) / (2.0 * step)
    assert wave_forces.friction_scale_derivative() == pytest.approx(
        difference, abs=1e-6 * np.abs(difference).max()
    )


@pytest.mark.parametrize(("size", "origin"), [(0.15, 0), (0.3, 32)])
def test_derivative_where_a_pair_always_sticks(size: float, origin: int) -> None:
    """Its place goes with the gap of the first instant, or of that at which it slipped last, half
    a period later: against differences, by the tangential gap."""
    integrals = FrictionIntegrals(
        CoulombFriction(RIGID, 0.4), 2, residual_compliance=np.eye(2), samples=64
    )
    gap = np.zeros((5, 2))
    gap[0, 0], gap[1, 1] = 1.0, size
    at_wave = integrals.linearise(gap)
    assert (
        np.all(at_wave.contact_states == 1)
        and integrals.follow_forces_until_they_repeat(sample_period(gap, 64))[3][0] == origin
    )
    change, step = np.zeros((5, 2)), 1e-7
    change[:, 1] = np.random.default_rng(3).normal(size=5)
    ends = [integrals.force(gap + sign * step * change) for sign in (1.0, -1.0)]
    difference = (ends[0] - ends[1]) / (2.0 * step)
    assert at_wave.force_change(change) == pytest.approx(difference, abs=1e-6)
    assert at_wave.tangent().reshape(10, 10) @ change.ravel() == pytest.approx(
        difference.ravel(), abs=1e-6
    )


def test_marches_of_one_step_or_many() -> None:
    """The forces of instants by one march, and by marches that follow each other, are the same."""
    draw = np.random.default_rng(8)
    root = draw.normal(size=(6, 6))
    sets = FrictionContactSolver(root @ root.T / 6.0 + np.eye(6), 0.5)
    gaps, stuck_places = draw.normal(size=(200, 6)), np.zeros(3)
    march_arrays = sets.solve(gaps, stuck_places)[:3]
    for instant, gap in enumerate(gaps):
        forces, states, places, _ = sets.solve(gap[None], stuck_places)
        stuck_places = places[0]
        for part, step_array in zip(march_arrays, (forces, states, places), strict=True):
            assert part[instant] == pytest.approx(step_array[0], abs=1e-12)


def test_a_wave_is_marched_until_its_places_repeat() -> None:
    """Of three pairs that close one after the other one sticks at any time, and the places keep a
    part of those a period ago: the forces are those of another period, and two are too few."""
    phase = 2.0 * np.pi / 3.0 * np.arange(3)
    compliance = np.eye(6)
    compliance[3:, 3:] += 0.25 * (1.0 - np.eye(3))
    integrals = FrictionIntegrals(CoulombFriction(RIGID, 5.0), 4, residual_compliance=compliance)
    time = 2.0 * np.pi / 128 * np.arange(128)[:, None] - phase
    gap = np.hstack([0.7 + np.cos(time), 0.6 * np.sin(time + 0.4)])
    forces, states, places, _ = integrals.follow_forces_until_they_repeat(gap)
    assert np.all(states.any(axis=1)) and not np.any(states.all(axis=0))
    assert integrals.friction_contact_solver.solve(gap, places[-1])[0] == pytest.approx(
        forces, abs=1e-10
    )
    two_periods = integrals.friction_contact_solver.solve(gap, gap[0, 3:], max_periods=2)[0]
    assert np.abs(two_periods - forces).max() > 0.01
