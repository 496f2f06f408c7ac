"""Curves judged by exact orbits, against marches of disturbed orbits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stiff_curves
from helpers import oscillator, two_masses

import fenics_crack as fc
from fenics_crack.curves import exact, nearness
from fenics_crack.curves.nearness import near_points
from fenics_crack.model.exact_flow import EventFlow
from fenics_crack.model.flow import ExponentialFlow
from fenics_crack.time.march import initial_state

RIGID = fc.UnilateralConstraint()


@pytest.fixture(scope="module")
def curve(light_lips: fc.Structure) -> fc.ResponseCurve:
    """With so few harmonics that the truncated equations bifurcate where nothing happens."""
    return fc.continue_frequency(light_lips, 1730.0, 1780.0, RIGID, harmonics=6, stability=True)


def growth(light_lips: fc.Structure, omega: float) -> float:
    """Factor per period of the distance to the orbit of 1024 steps after a disturbance."""
    near = fc.solve_harmonic_balance(light_lips, omega, RIGID, harmonics=20)
    orbit = fc.shoot(light_lips, near, steps_per_period=1024)
    flow = ExponentialFlow(light_lips, omega, RIGID, 1024)
    moved, distances = orbit.state * (1.0 + 1e-8), []
    for _ in range(120):
        moved = flow.advance(moved).states[-1]
        distances.append(np.linalg.norm(moved - orbit.state))
    return float((distances[-1] / distances[39]) ** (1.0 / 80.0))


def test_bifurcations_that_the_motion_does_not_have(
    light_lips: fc.Structure, curve: fc.ResponseCurve
) -> None:
    """Three points where pairs leave the unit circle by six harmonics; the motion has the last."""
    problem = fc.Problem(light_lips, 1730.0, RIGID, 6)
    truncated = fc.Continuation(problem, "omega", 1730.0, 1780.0, stability=True)
    assert len(list(truncated)) == len(curve) and truncated.complete
    found = truncated.curve.bifurcations
    assert [one.kind for one in found] == 3 * ["neimark_sacker"]
    assert not any(one.confirmed for one in found)
    [one] = curve.bifurcations
    assert one.kind == "neimark_sacker" and one.confirmed
    assert one.exact == pytest.approx(one.value, rel=1e-2)
    assert set(curve.verdicts[curve.omega < 1760.0]) == {"stable"}
    assert set(curve.verdicts[curve.omega > 1772.0]) == {"unstable"}


def test_verdicts_are_those_of_the_disturbed_motion(
    light_lips: fc.Structure, curve: fc.ResponseCurve
) -> None:
    """Also where the truncated equations were unstable."""
    [one] = curve.bifurcations
    for omega in (1741.0, one.exact - 3.0):
        assert growth(light_lips, omega) < 1.0
    assert growth(light_lips, one.exact + 3.0) > 1.0


def test_another_number_of_harmonics_finds_the_same(
    light_lips: fc.Structure, curve: fc.ResponseCurve
) -> None:
    """The place is that of the orbits, not of the harmonics."""
    other = fc.continue_frequency(light_lips, 1730.0, 1780.0, RIGID, harmonics=12, stability=True)
    [one], [two] = curve.bifurcations, other.bifurcations
    assert one.kind == two.kind and one.exact == pytest.approx(two.exact, rel=1e-5)
    omega, orbit = fc.refine_bifurcation(two)
    assert omega == pytest.approx(one.exact, rel=1e-3)
    assert abs(abs(orbit.multipliers[0]) - 1.0) < 1e-3


def test_places_between_points() -> None:
    """No step is longer than allowed, relative, and there are few however far apart points are."""
    parameters = np.array([1.0, 1.0005, 1.0005, 1.1, 1.2, 1e15])
    at, _, found = exact._filled(np.zeros((6, 1)), parameters, np.full(6, 1e-3))
    assert len(at) == len(set(at)) < 35_000
    assert np.allclose(found[at % 1.0 == 0.0][:-1], parameters[:-1], rtol=1e-12)
    _, _, found = exact._filled(np.zeros((3, 1)), np.array([1.0, 1.1, 1.2]), np.full(3, 1e-3))
    assert np.abs(np.diff(np.log(found))).max() < 1.05e-3


def test_two_masses_and_a_stop() -> None:
    """From event to event: all special points are confirmed, where refinement puts them, also with
    few harmonics."""
    law = fc.UnilateralPenalty(100.0)
    found = fc.continue_frequency(two_masses(), 0.6, 0.9, law, harmonics=12, stability=True)
    assert found.undecided is not None and not np.any(found.undecided & found.stable)
    judged = fc.judge_curve(found)
    for kind, count in {"fold": 2, "period_doubling": 2, "neimark_sacker": 1}.items():
        special = [one for one in judged.bifurcations if one.kind == kind]
        assert len(special) == count
        for one in special:
            assert one.exact == pytest.approx(fc.refine_bifurcation(one)[0], rel=2e-5)


def test_neighbours_are_not_matched_crosswise(curve: fc.ResponseCurve) -> None:
    """Two of one kind, whose nearest points on the curve are the same or lie in the other order,
    go to the orbits in the order of their frequencies; too far or of another kind: to none."""
    unknown = curve.unknown(9)

    def matched(places: dict[float, int], kind: str = "fold") -> dict[float, float]:
        found = curve.expand_bifurcations([(kind, omega, unknown) for omega in places])
        special = list(zip(places.values(), found, strict=True))
        crossings = [
            exact._Crossing("fold", omega, point, True) for omega, point in ((783.0, 9), (785.0, 9))
        ]
        near = exact._matched(crossings, special, 10)
        return {crossings[one].omega: special[other][1].value for one, other in near.items()}

    in_order = {783.0: 783.6, 785.0: 785.6}
    for one, two in ((9, 9), (10, 9), (9, 10), (12, 11)):
        assert matched({783.6: one, 785.6: two}) == in_order
        assert matched({785.6: two, 783.6: one}) == in_order
    assert matched({784.8: 9}) == {785.0: 784.8}
    assert matched({783.6: 9, 785.6: 30}) == {783.0: 783.6}
    assert matched({783.6: 9, 805.0: 9}) == {783.0: 783.6}
    assert matched({783.6: 9, 785.6: 9}, "period_doubling") == {}


def test_stiff_stop() -> None:
    """Against the branch of exact orbits: the truncated equations are often wrong, the judged curve
    never is; what it confirms is there, and what is not there is unconfirmed."""
    found = dict(zip(stiff_curves.COLUMNS, stiff_curves.case(100.0, 10, (2.0, 0.5)), strict=True))
    assert found["truncated: wrong"] > 20 and found["judged: wrong"] == 0
    assert found["stable"] + found["unstable"] > 100 and found["undecided"] > 100
    assert found["truncated: bifurcations"] > 10 and found["confirmed"] >= 4
    assert found["confirmed without counterpart"] == 0 and found["unconfirmed"] > 10


def test_files_and_words(curve: fc.ResponseCurve, light_lips: fc.Structure, tmp_path: Path) -> None:
    """Verdicts and exact frequencies outlast a file; undecided is not stable."""
    fc.save(curve, tmp_path / "curve.h5")
    loaded = fc.load(tmp_path / "curve.h5", light_lips, RIGID)
    assert isinstance(loaded, fc.ResponseCurve)
    assert np.array_equal(loaded.verdicts, curve.verdicts)
    assert loaded.bifurcations[0].exact == curve.bifurcations[0].exact
    assert "exact" in str(loaded.bifurcations[0])
    refined = fc.refine_curve(curve, 1)
    assert len(refined.verdicts) == len(refined) > len(curve)
    nothing = replace(curve, undecided=np.ones(len(curve), dtype=bool))
    assert not np.any(nothing.stable) and set(nothing.verdicts) == {"undecided"}


def test_a_curve_over_the_load_of_a_plate(light_lips: fc.Structure) -> None:
    """Judged at once, point by point: three points by single solutions and by disturbed motions."""
    apart = light_lips.varied(clearance=1e-6)
    load = fc.continue_parameter(
        apart, 1740.0, RIGID, "load", 0.5, 2.0, harmonics=6, stability=True
    )
    assert load.undecided is not None and not np.any(load.undecided)
    for index in (0, len(load) // 2, len(load) - 1):
        there = apart.varied(load=float(load.values[index]))
        alone = fc.solve_harmonic_balance(there, 1740.0, RIGID, harmonics=6)
        found = fc.floquet(there, alone)
        assert load.verdicts[index] == found.verdict == "stable"
        assert abs(load.multipliers[index]) == pytest.approx(abs(found.multipliers[0]), rel=1e-5)
        assert growth(there, 1740.0) < 1.0


def test_point_whose_motion_leaves_is_not_called_stable() -> None:
    """A mass at a stop, k R = 130: next to a point of the branch of twice the period lies an orbit
    with the multiplier 0.73, but the exact motion that begins with the point goes elsewhere."""
    one = np.ones((1, 1))
    structure = fc.Structure.from_matrices(
        2.6084590876821245 * one, 0.9713896659877375 * one, np.ones(1), force_cos=np.ones(1),
        force_sin=np.array([0.28811130687145525]), damping=0.042123779557305986 * one,
        clearance=0.00835898808240626,
    )  # fmt: skip
    omega, law = 0.2929139239706235, fc.UnilateralPenalty(123.68667517484897)
    curve = fc.continue_frequency(
        structure, 0.9 * omega, 1.1 * omega, law, harmonics=10, stability=True
    )
    low, high = curve.values.min(), curve.values.max()
    doublings = [one for one in curve.bifurcations if one.kind == "period_doubling"]
    first = next(one for one in doublings if one.confirmed and low < one.value < high)
    branch = fc.follow_branch(curve, first, throw=False, stability=True)
    places = np.flatnonzero(branch.verdicts == "stable")[::2]
    gone = 0
    for place in np.union1d(places, np.flatnonzero(branch.verdicts == "undecided")):
        solution = branch.solution(int(place))
        orbit = fc.shoot(structure, solution)
        flow = EventFlow(structure, solution.omega, law)
        state = flow.state(*initial_state(structure, solution))
        begun = np.linalg.norm(state - orbit.state)
        for _ in range(60):
            state = flow.advance(state, 0.0, solution.period)[0]
        left = np.linalg.norm(state - orbit.state) > 3.0 * begun
        assert not (left and branch.verdicts[place] == "stable")
        gone += left and abs(orbit.multipliers[0]) < 1.0
    assert len(places) > 5 and gone > 0


@pytest.mark.parametrize(("estimate", "nearest"), [(1.0, 0.1), (0.02, 0.06), (1e-6, 0.01)])
def test_orbits_near_enough(
    estimate: float, nearest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three times the estimate, 1 % at least, 10 % at most: also where the estimate is unknown."""
    curve = fc.continue_frequency(oscillator(), 1.5, 1.6, fc.UnilateralPenalty(1.0), harmonics=5)
    places = np.arange(len(curve))
    monkeypatch.setattr(
        nearness, "allowed_distance", lambda solution, least: max(least, 3.0 * estimate)
    )

    def found(off: float) -> np.ndarray:
        waves = curve.gaps_in_time(places)
        return near_points(curve, places, lambda place: waves[place] / (1.0 - off))

    assert found(0.99 * nearest).all() and not found(1.01 * nearest).any()
