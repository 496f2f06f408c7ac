"""Curves of exact orbits, against closed forms and a flow that shares no code with them."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import OMEGA_0, ROOT, chain, oscillator, two_masses
from mpi4py import MPI
from rotating import cracked

import fenics_crack as fc
from fenics_crack.curves.growing import branch_start
from fenics_crack.curves.orbit_continuation import OrbitContinuation
from fenics_crack.curves.orbit_events import LEAST, MultiplierControl, changes, observe
from fenics_crack.curves.orbit_family import OrbitFamily
from fenics_crack.motion.flow import exact_flow
from fenics_crack.motion.orbit import PeriodicOrbit, find_orbit
from fenics_crack.motion.search import wave_states
from fenics_crack.numerics.newton import point_on_path
from fenics_crack.numerics.path import Path, PathOptions, Target

sys.path.insert(0, str(ROOT / "tests" / "motion"))
from reference import ReferenceFlow

LAW = fc.UnilateralPenalty(100.0)
EXACT = {
    "period_doubling": (0.7387830254, 0.7555861594),
    "fold": (0.7556273526, 0.6534401345),
    "neimark_sacker": (0.6186068743,),
}
"""Two masses and a stop, from 0.6 to 0.9 rad/s: where the equations of 21 to 121 harmonics lead
to."""
RANGES = {
    "omega": (1.1, 1.6),
    "load": (0.5, 2.0),
    "stiffness": (0.3, 3.0),
    "damping": (0.0, 2.0),
    "clearance": (-0.2, 0.3),
}


def orbit_at(problem: fc.Problem) -> PeriodicOrbit:
    """An orbit near the harmonic-balance solution of a problem."""
    flow, law = exact_flow(problem.structure, problem.contact), problem.contact
    for harmonics in (10, 40):
        wave = fc.solve_harmonic_balance(
            problem.structure, problem.omega, law, harmonics=harmonics, throw=False
        )
        state = wave_states(flow, wave.displacement_coefficients, wave.omega)[0]
        orbit = find_orbit(flow, problem.omega, state)
        if orbit is not None and orbit.residual < 1e-6:
            return orbit
    raise AssertionError("no orbit")


def followed(
    problem: fc.Problem, parameter: str, start: float, end: float, step: float = 0.05
) -> OrbitContinuation:
    """The curve from its start on."""
    first = orbit_at(OrbitFamily(problem, parameter, start, end).at(start))
    path = OrbitContinuation(
        problem, parameter, start, end, initial=first, longest_step=step, most_points=3000
    )
    path.run()
    return path


def special(path: OrbitContinuation) -> list[fc.Bifurcation]:
    """All bifurcations."""
    curve = path.curve
    assert isinstance(curve, fc.OrbitCurve)
    return list(curve.bifurcations)


def states(path: OrbitContinuation) -> np.ndarray:
    """Of all points."""
    curve = path.curve
    assert isinstance(curve, fc.OrbitCurve)
    return curve.states


@pytest.fixture(scope="module")
def stop() -> OrbitContinuation:
    """Two masses and a stop."""
    return followed(fc.Problem(two_masses(), 0.6, LAW), "omega", 0.6, 0.9)


# --- the equations --------------------------------------------------------------------------------


@pytest.mark.parametrize("parameter", RANGES)
@pytest.mark.parametrize("damping", ["modal", "matrix"])
def test_derivatives(parameter: str, damping: str) -> None:
    """dF/dx and dF/dp against central differences, through openings and closings."""
    problem = fc.Problem(chain(damping), 1.3, fc.UnilateralPenalty(5.0))
    family = OrbitFamily(problem, parameter, *RANGES[parameter])
    unknown, place, step = np.random.default_rng(1).normal(size=family.shape), 0.37, 1e-5
    at = family.linearise(unknown, place)
    assert at.events > 2
    assert at.residual == pytest.approx(family.moved(unknown, place) - unknown, abs=1e-11)

    def difference(dx: np.ndarray, dp: float) -> np.ndarray:
        above, below = (
            family.linearise(unknown + side * step * dx, place + side * step * dp).residual
            for side in (1.0, -1.0)
        )
        return (above - below) / (2.0 * step)

    rate = difference(np.zeros_like(unknown), 1.0)
    assert at.by_parameter == pytest.approx(rate, abs=1e-6 * np.abs(rate).max())
    way = np.random.default_rng(2).normal(size=family.shape)
    assert at.jacobian @ way == pytest.approx(difference(way, 0.0), abs=1e-6)


@pytest.mark.parametrize("parameter", RANGES)
def test_end_is_the_orbit_found_there(parameter: str) -> None:
    """By the problem varied as a whole, and Newton's method on its own flow."""
    problem = fc.Problem(chain(), 1.3, fc.UnilateralPenalty(5.0))
    path = followed(problem, parameter, *RANGES[parameter], 0.1)
    assert path.complete and path.progress() == 1.0
    family = OrbitFamily(problem, parameter, *RANGES[parameter])
    last, there, state = path.points[-1], family.at(RANGES[parameter][1]), states(path)[-1]
    assert last.value == pytest.approx(RANGES[parameter][1]) and last.omega == there.omega
    orbit = find_orbit(exact_flow(there.structure, there.contact), there.omega, 1.001 * state)
    assert orbit is not None
    assert state == pytest.approx(orbit.state, abs=1e-7 * np.abs(orbit.state).max())
    assert np.abs(last.multipliers) == pytest.approx(np.abs(orbit.multipliers[:8]), abs=1e-7)


def test_over_the_speed_of_a_rotor() -> None:
    """Orbits in the modes of each speed; the derivative against a wider difference."""
    whole = fc.build_structure(cracked(600.0, -250.0), MPI.COMM_SELF)
    spinning = fc.run_up_structure(whole, 560.0, 640.0, 4).at_speed(600.0)
    problem = fc.Problem(spinning, 12 * 600.0, fc.UnilateralConstraint())
    family = OrbitFamily(problem, "speed", 560.0, 640.0)
    orbit = orbit_at(family.at(600.0))
    assert orbit.events > 0 and family.omega(620.0) == pytest.approx(12 * 620.0)
    unknown = family.unknown(orbit.state, 600.0)
    assert family.state(unknown, 600.0) == pytest.approx(orbit.state, abs=1e-12)
    size = np.abs(unknown).max()
    at, step = family.linearise(unknown, 0.5), 1e-5
    assert at.residual == pytest.approx(0.0, abs=1e-9 * size)
    above, below = (family.linearise(unknown, 0.5 + dp).residual for dp in (step, -step))
    rate = (above - below) / (2.0 * step)
    assert at.by_parameter == pytest.approx(rate, abs=1e-4 * np.abs(rate).max())


def test_twice_the_load_and_clearance_is_twice_the_motion() -> None:
    """A clearance that grows from c to 2 c is a load that falls from 1 to 1/2, times two."""
    problem = fc.Problem(oscillator(clearance=0.5), 1.2, fc.UnilateralPenalty(1.0))
    closer, wider = (
        followed(problem, *along) for along in (("load", 1.0, 0.5), ("clearance", 0.0, 0.5))
    )
    assert states(wider)[-1] == pytest.approx(2.0 * states(closer)[-1], abs=1e-8)
    last = [path.points[-1].multipliers for path in (closer, wider)]
    assert last[1] == pytest.approx(last[0], abs=1e-8)


def test_without_contact() -> None:
    """A stop too far away: linear response and multipliers exp(-c T / 2 +- i w T) all along."""
    problem = fc.Problem(oscillator(clearance=50.0), 0.5, fc.UnilateralPenalty(1.0))
    path = followed(problem, "omega", 0.5, 2.0)
    assert path.complete and not special(path)
    for point, state in zip(path.points, states(path), strict=True):
        assert point.multipliers is not None
        omega, period = point.omega, 2.0 * np.pi / point.omega
        wave = 1.0 / (1.0 - omega**2 + 0.1j * omega)
        assert np.abs(state) == pytest.approx(
            np.abs([wave.real, -omega * wave.imag]), rel=1e-7, abs=1e-8
        )
        turn = np.exp((-0.05 + 1j * np.sqrt(1.0 - 0.05**2)) * period)
        assert np.sort_complex(point.multipliers) == pytest.approx(
            np.sort_complex([turn, turn.conjugate()]), abs=1e-8
        )


def test_paths_keep_what_the_kernel_records(stop: OrbitContinuation) -> None:
    """M of each point is that of the equations there."""
    family = OrbitFamily(fc.Problem(two_masses(), 0.6, LAW), "omega", 0.6, 0.9)
    start = point_on_path(family, stop.points[0].unknown, 0.0)
    seen: list[np.ndarray] = []

    class Watched(MultiplierControl):
        def too_long(self, points: Any) -> np.ndarray:
            seen.append(points.observed[-1])
            return np.zeros(len(points) - 1, dtype=bool)

    path = Path(family, start, PathOptions(0.05, 0.05), [Target(0.3)], Watched(0.05))
    for stretch in path:
        at = family.linearise(stretch.unknowns[-1], float(stretch.parameters[-1]))
        assert stretch.observed[-1] == pytest.approx(observe(at.monodromy[None])[0], abs=1e-7)
    assert path.event is not None and len(seen) > 2


# --- bifurcations ---------------------------------------------------------------------------------


def test_bifurcations_of_two_masses_and_a_stop(stop: OrbitContinuation) -> None:
    """Where many harmonics lead to, each on the unit circle."""
    found = special(stop)
    assert stop.complete and stop.status == "reached the end"
    for kind, values in EXACT.items():
        mine = [one for one in found if one.kind == kind]
        assert [one.value for one in mine][: len(values)] == pytest.approx(values, rel=1e-8)
        assert len(mine) == len(values)


def test_bifurcations_by_the_reference_flow(stop: OrbitContinuation) -> None:
    """States are orbits of another integration, with a multiplier where it must be; but for the
    fold where the stop is only just touched: there multipliers jump."""
    found = special(stop)
    assert found[-1].kind == "fold" and np.abs(found[-1].multipliers - 1.0).min() > 1e-4
    for one in found[:-1]:
        reference = ReferenceFlow(one.orbit.flow, one.value)
        period = 2.0 * np.pi / one.value
        moved, _, tangent, _ = reference.advance(one.orbit.state, period, np.zeros(0))
        assert moved == pytest.approx(one.orbit.state, abs=1e-8)
        mu = np.linalg.eigvals(tangent)
        pair = np.abs(mu[mu.imag > 0.0])
        off = {
            "fold": np.abs(mu - 1.0).min(),
            "period_doubling": np.abs(mu + 1.0).min(),
            "neimark_sacker": np.abs(pair - 1.0).min(initial=np.inf),
        }
        assert off[one.kind] < 1e-5


def test_one_by_one_is_the_same(stop: OrbitContinuation) -> None:
    """Iterating yields what a run records."""
    first = stop.curve.orbit(0)  # type: ignore[attr-defined]
    problem = fc.Problem(two_masses(), 0.6, LAW)
    path = OrbitContinuation(problem, "omega", 0.6, 0.9, initial=first, most_points=3000)
    points = list(path)
    assert len(points) == len(stop.points) and path.status == stop.status
    assert [one.value for one in points] == [one.value for one in stop.points]
    met = [one for point in points for one in point.bifurcations]
    assert met == [(one.kind, one.value) for one in special(stop)]


def test_goes_on_where_it_was_stopped(stop: OrbitContinuation) -> None:
    """From a curve with too few points, which says so."""
    problem, half = fc.Problem(two_masses(), 0.6, LAW), len(stop.points) // 2
    first = stop.curve.orbit(0)  # type: ignore[attr-defined]
    short = OrbitContinuation(problem, "omega", 0.6, 0.9, initial=first, most_points=half)
    short.run()
    assert not short.complete and short.status == f"{half} points were not enough"
    part: Any = short.curve
    path = OrbitContinuation(problem, "omega", 0.6, 0.9, initial=part, most_points=3000)
    path.run()
    found = [one.value for one in path.curve.bifurcations]
    expected = [one.value for one in special(stop)]
    assert path.complete and found == pytest.approx(expected, rel=1e-8)
    assert path.curve.values[: half + 1] == pytest.approx(part.values, rel=1e-12)


def test_turns_back_past_its_start(stop: OrbitContinuation) -> None:
    """Behind the first fold, where it may not turn back."""
    place = next(k for k, one in enumerate(stop.points) if one.value > 0.7)
    first = stop.curve.orbit(place)  # type: ignore[attr-defined]
    path = OrbitContinuation(
        fc.Problem(two_masses(), 0.7, LAW), "omega", first.omega, 0.9, initial=first,
        most_points=500, turning_back=0.0,
    )  # fmt: skip
    path.run()
    assert not path.complete and path.returned
    assert path.status == "turned back past its start"


# --- branches of twice the period -----------------------------------------------------------------


def test_branch_of_twice_the_period(stop: OrbitContinuation) -> None:
    """From one doubling of the oscillator to the other, through orbits of period two."""
    problem = fc.Problem(oscillator(), 1.5, fc.UnilateralPenalty(1.0))
    single = followed(problem, "omega", 1.5, 3.0)
    first, second = special(single)
    assert {first.kind, second.kind} == {"period_doubling"}
    assert first.value < 2.0 * OMEGA_0 < second.value
    twofold = fc.Problem(oscillator(), 1.5, fc.UnilateralPenalty(1.0), 10, subharmonic=2)
    path = OrbitContinuation(
        twofold, "omega", 1.5, 3.0, initial=(single.curve, first), most_points=500, turning_back=0.0
    )
    path.run()
    assert path.complete and path.status == "joined the branch that it left"
    assert path.points[-1].value == pytest.approx(second.value, rel=1e-6)
    curve: Any = path.curve
    orbit = curve.orbit(len(curve) // 2)
    period = 2.0 * np.pi / orbit.omega
    once = orbit.flow.advance(orbit.state, orbit.omega, period).state
    twice = orbit.flow.advance(once, orbit.omega, period, start=period).state
    assert twice == pytest.approx(orbit.state, abs=1e-8)
    assert np.abs(once - orbit.state).max() > 0.1 * np.abs(orbit.state).max()


def test_no_branch_of_twice_the_period_from_a_fold(stop: OrbitContinuation) -> None:
    """Where no multiplier is -1 there is none."""
    problem = fc.Problem(two_masses(), 0.6, LAW, 10, subharmonic=2)
    doubled = OrbitFamily(problem, "omega", 0.6, 0.9)
    with pytest.raises(fc.ConvergenceError, match="no point of another branch"):
        branch_start(doubled, "period_doubling", stop.points[0].unknown, 0.0, 0.05)


# --- steps and events -----------------------------------------------------------------------------


def row(*values: complex) -> np.ndarray:
    """What is observed where multipliers are these."""
    blocks = np.zeros((len(values) * 2,) * 2)
    size = 0
    for value in values:
        if isinstance(value, complex):
            blocks[size : size + 2, size : size + 2] = [
                [value.real, value.imag], [-value.imag, value.real]
            ]  # fmt: skip
            size += 2
        else:
            blocks[size, size] = value
            size += 1
    return observe(blocks[None, :size, :size])[0]


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ((0.9 + 0.1j, -0.9, 0.1), (0.9 + 0.1j, -1.1, 0.1), (0, 1, 0)),
        ((0.9 + 0.1j, 0.2), (1.2 + 0.1j, 0.2), (0, 0, 1)),
        ((1.5, 1.4, 0.1), (1.45 + 0.1j, 0.1), (0, 0, 0)),  # two reals become a pair
        ((-1.45 + 0.1j, 0.1), (-1.5, -1.4, 0.1), (0, 0, 0)),
        ((1.5, -1.4, 0.1), (1.45 + 0.1j, 0.1), (-1, -1, 1)),  # of two signs they cannot
        ((0.3, 0.2), (1.0 + 5e-7, 0.2), (0, 0, 0)),  # within 1e-6 of the circle
    ],
)
def test_what_counts_as_a_change(before: Any, after: Any, expected: tuple[int, ...]) -> None:
    """Of r, d and c."""
    assert changes(np.array([row(*before), row(*after)]))[0].tolist() == list(expected)


@pytest.mark.parametrize(
    ("logs", "lengths", "expected"),
    [
        ((-0.5, -0.45, -0.4), (0.0, 1.0, 1.0), (False, False)),
        ((-0.5, -0.1, 0.3), (0.0, 1.0, 1.0), (True, True)),  # more than half of its distance
        ((-0.5, -0.5, -0.52), (0.0, LEAST / 2, LEAST / 2), (False, False)),
        ((-0.5, -0.1, 0.3), (0.0, LEAST / 2, LEAST / 2), (False, False)),  # not below the floor
        ((-0.06, -0.08, -0.06), (0.0, 1.0, 1.0), (False, True)),  # not as it came
        ((-0.06, -0.08, -0.16), (0.0, 1.0, 2.0), (False, True)),  # by as much
    ],
)
def test_steps_that_are_halved(logs: Any, lengths: Any, expected: tuple[bool, ...]) -> None:
    """By one real multiplier; the longest step is 1."""
    observed = np.array([row(float(np.exp(one)), 1e-3) for one in logs])
    points: Any = SimpleNamespace(observed=observed, lengths=np.array(lengths))
    assert tuple(MultiplierControl(1.0).too_long(points)) == expected


def test_several_changes_are_parted_below_the_floor() -> None:
    """Two events in one step are halved until each is by itself."""
    observed = np.array([row(-0.999, 0.99 + 0.1j), row(-1.001, 1.0 + 0.1j)])
    points: Any = SimpleNamespace(observed=observed, lengths=np.array([0.0, 1e-6]))
    assert MultiplierControl(1.0).too_long(points).tolist() == [True]
