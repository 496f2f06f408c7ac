"""The exact flow by Taylor series against a flow that shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from helpers import DAMPINGS, Cubic, chain, oscillator, relative
from hypothesis import given, settings
from hypothesis import strategies as st
from motion.reference import ReferenceFlow

import fenics_crack as fc
from fenics_crack.kernel import doubles, kernel
from fenics_crack.motion.flow import Budget, ContactFlow, Motion, flow_of

RIGID = fc.UnilateralConstraint()


def known(structure: fc.Structure, contact: object) -> ContactFlow:
    """The flow, which there is."""
    flow = flow_of(structure, contact)
    assert flow is not None
    return flow


def thrown(flow: ContactFlow, seed: int = 0) -> np.ndarray:
    """A random state."""
    random = np.random.default_rng(seed)
    return random.normal(size=flow.size) / np.concatenate(
        [np.sqrt(np.maximum(flow.modes.squares, 0.1)), np.ones(flow.size // 2)]
    )


def energy(flow: ContactFlow, motion: Motion) -> np.ndarray:
    """Of modes, springs and static compliance at the samples."""
    samples = motion.samples
    shape, rate = np.split(samples.states, 2, axis=1)
    slow = samples.gap + samples.force @ flow.residual
    return 0.5 * (shape**2 @ flow.modes.squares + (rate**2).sum(axis=1)) + 0.5 * (
        samples.force * slow
    ).sum(axis=1)


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([*DAMPINGS, "gyroscopic"]), st.integers(1, 3), st.integers(0, 2**31),
    st.floats(0.0, 3.0), st.booleans(),
)  # fmt: skip
def test_against_the_reference(
    damping: str, pairs: int, seed: int, hardness: float, light: bool
) -> None:
    """State, motion, derivative and number of events over two periods, with and without mass at the
    lips, to rounding."""
    coupled = damping in ("matrix", "gyroscopic")
    structure = chain("modal" if coupled and light else damping, 10, pairs, seed)
    contact: object = fc.UnilateralPenalty(10.0**hardness * np.linspace(0.5, 1.0, pairs))
    if light:
        structure = fc.reduce_structure(structure, modes=4, method="massless")
        contact = contact if seed % 2 else RIGID
    flow, omega = known(structure, contact), 0.7
    state, duration = thrown(flow, seed), 4.0 * np.pi / omega
    instants = np.linspace(0.0, duration, 60) + 0.3
    motion = flow.advance(state, omega, duration, start=0.3, instants=instants)
    reference = ReferenceFlow(flow, omega)
    end, states, tangent, events = reference.advance(state, duration, instants, 0.3)
    grown = np.linalg.norm(tangent)
    assert relative(motion.state, end) < 1e-12 * (1.0 + grown)
    assert relative(motion.samples.states, states[:, : flow.size]) < 1e-12 * (1.0 + grown)
    assert relative(motion.track.tangent, tangent) < 1e-9 * (1.0 + grown)
    assert motion.events == events
    assert motion.samples.gap[motion.samples.closed].min(initial=0.0) >= 0.0
    assert motion.track.lengths.sum() == pytest.approx(duration, rel=1e-12)


@pytest.mark.parametrize("light", [False, True])
def test_energy(light: bool) -> None:
    """Without damping and load it stays, over 20 periods."""
    structure = chain("none", 30, 5, seed=4).varied(load=0.0)
    contact: object = fc.UnilateralPenalty(500.0)
    if light:
        structure = fc.reduce_structure(structure, modes=12, method="massless")
        contact = RIGID
    flow = known(structure, contact)
    period = 2.0 * np.pi / np.sqrt(flow.modes.squares[0])
    instants = np.linspace(0.0, 20.0 * period, 500)
    motion = flow.advance(thrown(flow), 1.0, 20.0 * period, instants=instants)
    assert motion.events > 500
    held = energy(flow, motion)
    assert np.abs(held / held[0] - 1.0).max() < 1e-11


@pytest.mark.parametrize("light", [False, True])
def test_derivatives(light: bool) -> None:
    """By the state and by the frequency, against differences."""
    structure, contact = chain("matrix", pairs=3, seed=2), fc.UnilateralPenalty(30.0)
    if light:
        structure, contact = fc.reduce_structure(chain(seed=2), modes=5, method="massless"), RIGID
    flow, omega, step = known(structure, contact), 0.9, 1e-6
    state, duration = thrown(flow, 3), 11.0
    track = flow.advance(state, omega, duration, start=0.4).track
    for place in (0, flow.size // 2, flow.size - 1):
        moved = step * np.eye(flow.size)[place]
        one, other = (flow.advance(state + h, omega, duration, start=0.4) for h in (moved, -moved))
        slope = (one.state - other.state) / (2.0 * step)
        assert relative(track.tangent[:, place], slope) < 1e-7
    one, other = (flow.advance(state, omega + h, duration, start=0.4) for h in (step, -step))
    by_omega = np.empty(flow.size)
    assert not kernel.flow_by_omega(flow.handle, track._known.at, doubles(by_omega))
    assert relative(by_omega, (one.state - other.state) / (2.0 * step)) < 1e-7


def test_parts_make_the_whole() -> None:
    """Motion and derivative of a period in 32 parts, each from where the last one ends."""
    flow, omega = known(chain(), fc.UnilateralPenalty(50.0)), 0.8
    whole = flow.advance(thrown(flow), omega, 2.0 * np.pi / omega)
    starts = np.linspace(0.0, 2.0 * np.pi / omega, 33)[:-1]
    samples = flow.advance(thrown(flow), omega, 2.0 * np.pi / omega, instants=starts).samples
    moved, track, ends = flow.steps(samples.states, omega, 2.0 * np.pi / omega)
    assert relative(moved[:-1], samples.states[1:]) < 1e-12
    assert relative(moved[-1], whole.state) < 1e-12
    assert relative(track.tangent, whole.track.tangent) < 1e-11
    start, excess = thrown(flow, 5), np.zeros_like(moved)
    carried = track.carried(start, excess, ends)
    part = flow.advance(samples.states[4], omega, starts[1], start=starts[4]).track
    assert relative(carried[5], part.tangent @ carried[4]) < 1e-12
    assert relative(carried[-1], whole.track.tangent @ start) < 1e-11
    excess[-2:] = thrown(flow, 7), thrown(flow, 8)
    last = flow.advance(samples.states[-1], omega, starts[1], start=starts[-1]).track
    added = last.tangent @ excess[-2] + excess[-1]
    assert relative(track.carried(start, excess, ends)[-1], carried[-1] + added) < 1e-11


@pytest.mark.parametrize("missed", [1e-3, 1e-6, 1e-9, 1e-12, 0.0, -1e-12, -1e-6])
def test_grazing(missed: float) -> None:
    """x = -cos t meets a stop at 1 - missed for a moment: in contact with k = 3 it turns with twice
    the frequency about the point where the forces cancel."""
    structure = oscillator(None, force=0.0, clearance=1.0 - missed)
    flow = known(structure, fc.UnilateralPenalty(3.0))
    instants = np.linspace(0.0, 2.0 * np.pi, 9)
    motion = flow.advance(np.array([-1.0, 0.0]), 1.0, 2.0 * np.pi, instants=instants)
    assert motion.events == 2 if missed > 1e-12 else motion.events % 2 == 0
    depth = max(missed, 0.0)
    speed = np.sqrt(depth * (2.0 - depth))  # there; the motion then runs back in time
    late = np.arctan2(2.0 * speed, 1.0 - depth) - 2.0 * np.arcsin(speed)
    assert motion.state == pytest.approx([-np.cos(late), -np.sin(late)], abs=1e-14)


def test_equal_structures_side_by_side() -> None:
    """Every event is a double one, and nothing else changes."""
    one = chain(seed=6)
    both = fc.Structure.from_matrices(
        *(np.kron(np.eye(2), part) for part in _matrices(one)),
        force_cos=np.tile(one.force[1], 2), clearance=np.tile(one.clearance, 2),
    )  # fmt: skip
    alone = fc.Structure.from_matrices(
        *_matrices(one), force_cos=one.force[1], clearance=one.clearance
    )
    contact, motions = fc.UnilateralPenalty(40.0), []
    for structure in (alone, both):
        flow = known(structure, contact)
        copies = structure.n_dofs // alone.n_dofs
        rest = flow.state(np.tile(np.linspace(-1, 1, 10), copies), np.zeros(structure.n_dofs))
        motions.append((flow, flow.advance(rest, 0.7, 18.0, instants=np.array([18.0]))))
    (_, first), (_, second) = motions
    assert second.events <= 2 * first.events and len(second.track.lengths) <= 3 * first.events
    moved, twice = first.samples.displacement[0], second.samples.displacement[0]
    assert relative(twice, np.tile(moved, 2)) < 1e-11


def test_almost_equal_structures() -> None:
    """Events that follow one another after 1e-10 of a period are two: the derivative is sharp."""
    mass, stiffness, gap = _matrices(chain(seed=6))
    both = fc.Structure.from_matrices(
        np.kron(np.eye(2), mass), np.kron(np.diag([1.0, 1.0 + 1e-9]), stiffness),
        np.kron(np.eye(2), gap), force_cos=np.tile(chain(seed=6).force[1], 2),
    )  # fmt: skip
    flow = known(both, fc.UnilateralPenalty(40.0))
    state = flow.state(np.tile(np.linspace(-1, 1, 10), 2), np.zeros(20))
    _, _, tangent, events = ReferenceFlow(flow, 0.7).advance(state, 18.0, np.zeros(0))
    motion = flow.advance(state, 0.7, 18.0)
    assert motion.events == events > 20
    assert relative(motion.track.tangent, tangent) < 1e-11


def _matrices(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    whole = range(structure.n_dofs)
    return (
        structure.mass.getValues(whole, whole), structure.stiffness.getValues(whole, whole),
        structure.gap.toarray(),
    )  # fmt: skip


def test_rest_stays() -> None:
    """No load, and pairs that touch: nothing moves, nothing happens."""
    flow = known(oscillator(force=0.0), fc.UnilateralPenalty(1.0))
    motion = flow.advance(np.zeros(2), 1.0, 100.0)
    assert not motion.state.any() and motion.events == 0
    pressed = chain(seed=1).varied(load=0.0, clearance=-1.0)
    flow = known(fc.reduce_structure(pressed, modes=5, method="massless"), RIGID)
    force = flow.advance(np.zeros(flow.size), 1.0, 0.1, instants=np.zeros(1)).samples.force
    assert np.all(force > 0.0)


def test_budget() -> None:
    """A motion that takes more is given up at once."""
    flow = known(chain(), fc.UnilateralPenalty(50.0))
    with pytest.raises(fc.ConvergenceError, match="open and close without end"):
        flow.advance(thrown(flow), 0.8, 1e3, budget=Budget(intervals=20))
    with pytest.raises(fc.ConvergenceError, match="too fast for that long"):
        flow.advance(thrown(flow), 0.8, 1e3, budget=Budget(pieces=20))
    with pytest.raises(fc.ConvergenceError, match="too fast for that long"):  # before any event
        flow.advance(thrown(flow), 0.8, 1e300, budget=Budget(intervals=20))
    with pytest.raises(fc.ConvergenceError, match="not finite"):
        flow.advance(np.full(flow.size, np.nan), 0.8, 1e3)


def test_who_has_a_flow() -> None:
    """The penalty law always, rigid contact where something answers at once, smooth laws never."""
    heavy = chain()
    light = fc.reduce_structure(heavy, modes=4, method="massless")
    assert flow_of(heavy, fc.UnilateralPenalty(1.0)) is not None
    assert flow_of(light, RIGID) is not None and flow_of(light, fc.UnilateralPenalty(1.0))
    assert flow_of(heavy, RIGID) is None
    assert flow_of(heavy, Cubic(1.0)) is None
    assert flow_of(heavy, fc.SmoothedPenalty(1.0, 1.0)) is None


@pytest.mark.parametrize("damping", [0.0, 0.1, 2.0, 2.0 + 1e-9, 4.0])
def test_derivative_while_all_pairs_are_open(damping: float) -> None:
    """The exponential of the flow's matrix, also with critical and more damping."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 0.0]), [1.0, 0.0], force_cos=[1.0, 0.0], clearance=1e9,
        damping=damping * np.eye(2),
    )  # fmt: skip
    flow = known(structure, fc.UnilateralPenalty(1.0))
    assert flow.modes.damping.ndim == 1
    matrix = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-np.diag(flow.modes.squares), -np.diag(flow.modes.damping)],
        ]
    )
    tangent = flow.advance(thrown(flow), 0.3, 20.0).track.tangent
    assert tangent == pytest.approx(scipy.linalg.expm(20.0 * matrix), abs=1e-9)
