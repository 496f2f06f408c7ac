"""Curves judged by exact orbits, and branches of orbits, against marches of disturbed orbits."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import stiff_curves
from helpers import chain, oscillator, two_masses

import fenics_crack as fc
from fenics_crack.curves import exact, orbit_branch
from fenics_crack.curves.exact import _Judge
from fenics_crack.curves.orbit_nodes import OrbitBifurcation
from fenics_crack.motion.flow import Budget, exact_flow
from fenics_crack.motion.orbit import eigenvalues, find_orbit
from fenics_crack.motion.shooting import Homotopy
from fenics_crack.time.march import initial_state

RIGID = fc.UnilateralConstraint()


@pytest.fixture(scope="module")
def curve(light_lips: fc.Structure) -> fc.ResponseCurve:
    """With so few harmonics that the truncated equations bifurcate where nothing happens."""
    return fc.continue_frequency(light_lips, 1730.0, 1780.0, RIGID, harmonics=6, stability=True)


def growth(light_lips: fc.Structure, omega: float) -> float:
    """Factor per period of the distance to the exact orbit after a disturbance."""
    near = fc.solve_harmonic_balance(light_lips, omega, RIGID, harmonics=20)
    orbit = fc.shoot(light_lips, near)
    moved, distances = orbit.state * (1.0 + 1e-6), []
    for _ in range(60):
        moved = orbit.flow.advance(moved, omega, orbit.period).state
        distances.append(np.linalg.norm(moved - orbit.state))
    return float((distances[-1] / distances[19]) ** (1.0 / 40.0))


def test_a_continuation_is_judged_alike(light_lips: fc.Structure, curve: fc.ResponseCurve) -> None:
    """Used by itself, whenever its curve is taken; the truncated equations with six harmonics have
    pairs outside the unit circle at three places, the motion at the last."""
    problem = fc.Problem(light_lips, 1730.0, RIGID, 6)
    growing = fc.Continuation(problem, "omega", 1730.0, 1780.0, stability=True)
    points = iter(growing)
    next(points)
    assert len(growing.curve.verdicts) == 1
    for _ in range(3):
        next(points)
    assert growing.curve.verdicts.tolist() == 4 * ["stable"]
    assert len(list(points)) + 4 == len(curve) and growing.complete
    assert growing.followed.multipliers is None
    found = growing.curve
    assert np.array_equal(found.verdicts, curve.verdicts)
    [other], [one] = found.bifurcations, curve.bifurcations
    assert other.exact == pytest.approx(one.exact, rel=1e-12)
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


def test_every_undecided_point_has_its_reason() -> None:
    """In words that say what to do; the others have none, nor do curves that are not judged."""
    law = fc.UnilateralPenalty(1000.0)
    plain = fc.continue_frequency(two_masses(), 0.6, 0.9, law, harmonics=13)
    judged = fc.judge_curve(plain)
    reasons = [judged.reason(index) for index in range(len(judged))]
    left = judged.verdicts == "undecided"
    assert left.any() and np.array_equal([bool(one) for one in reasons], left)
    assert all("harmonics" in one or "touches" in one for one in reasons if one)
    assert plain.reason(0) == ""


def test_the_nearer_of_two_orbits_judges() -> None:
    """Beside a fold, three masses with a gyroscopic damping and a stop: the orbit next to a point
    by Newton's method is the unstable one, 3 % away where 1.1 % are predicted; its own, 0.8 %
    away, is found from the state behind the step. No verdict differs from those of the points by
    themselves."""
    stiffness = np.array(
        [[2.4417, -0.6553, 0.0], [-0.6553, 1.589, -0.9336], [0.0, -0.9336, 0.9336]]
    )
    damping = np.array(
        [[0.1232, -0.1323, 0.1434], [0.0935, 0.0907, -0.048], [-0.1543, -0.0381, 0.0917]]
    )
    structure = fc.Structure.from_matrices(
        np.diag([0.8365, 0.773, 1.7903]), stiffness, np.array([0.0, 1.0, 0.0]),
        force_cos=[0.7048, 0.1177, 0.2125], force_sin=[-1.0, -0.1197, -0.0125], clearance=0.5619,
        damping=damping,
    )  # fmt: skip
    law = fc.UnilateralPenalty(8.0)
    curve = fc.continue_frequency(structure, 0.3043, 0.913, law, harmonics=12, stability=True)
    near = np.flatnonzero(np.abs(curve.omega - 0.479) < 0.002)
    alone = [fc.floquet(structure, curve.solution(int(place))).verdict for place in near]
    told = [
        both for both in zip(curve.verdicts[near], alone, strict=True) if "undecided" not in both
    ]
    assert len(told) > 3 and all(one == other for one, other in told)


def test_neighbours_are_not_matched_crosswise(curve: fc.ResponseCurve) -> None:
    """Two of one kind, whose nearest points on the curve are the same or lie in the other order,
    go to the orbits in the order of their frequencies; too far or of another kind: to none."""
    unknown = curve.unknown(9)

    def matched(places: dict[float, int], kind: str = "fold") -> dict[float, float]:
        found = [curve.bifurcation(kind, omega, unknown) for omega in places]
        special = list(zip(places.values(), found, strict=True))
        crossings = [(OrbitBifurcation("fold", 1.0, 9.0, True), omega) for omega in (783.0, 785.0)]
        near = exact._matched(curve, crossings, special)
        return {crossings[one][1]: special[other][1].value for one, other in near.items()}

    in_order = {783.0: 783.6, 785.0: 785.6}
    for one, two in ((9, 9), (10, 9), (9, 10), (12, 11)):
        assert matched({783.6: one, 785.6: two}) == in_order
        assert matched({785.6: two, 783.6: one}) == in_order
    assert matched({784.8: 9}) == {785.0: 784.8}
    assert matched({783.6: 9, 785.6: 30}) == {783.0: 783.6}
    assert matched({783.6: 9, 805.0: 9}) == {783.0: 783.6}
    assert matched({783.6: 9, 785.6: 9}, "period_doubling") == {}


def test_stiff_stop() -> None:
    """Against the branch of exact orbits: the judged curve is never wrong; what it confirms is
    there, and what is not there is unconfirmed."""
    found = dict(zip(stiff_curves.COLUMNS, stiff_curves.case(100.0, 10, (2.0, 0.5)), strict=True))
    assert found["wrong"] == 0 and found["confirmed"] >= 4
    assert found["stable"] + found["unstable"] > 100 and found["undecided"] > 100
    assert found["confirmed without counterpart"] == 0 and found["unconfirmed"] > 0


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
    """Judged at once: three points by single solutions and by disturbed motions."""
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
        assert abs(load.multipliers[index]) == pytest.approx(abs(found.multipliers[0]), rel=1e-2)
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
    alone = [fc.floquet(structure, one).verdict for one in branch.solutions]
    differ = branch.verdicts != np.array(alone)  # another orbit is as near
    assert differ.sum() <= 3 and set(branch.verdicts[differ]) <= {"undecided"}
    gone = 0
    for place in np.union1d(places, np.flatnonzero(branch.verdicts == "undecided")):
        solution = branch.solution(int(place))
        orbit = fc.shoot(structure, solution)
        state = orbit.flow.state(*initial_state(structure, solution))
        begun = np.linalg.norm(state - orbit.state)
        for _ in range(60):
            state = orbit.flow.advance(state, solution.omega, solution.period).state
        left = np.linalg.norm(state - orbit.state) > 3.0 * begun
        assert not (left and branch.verdicts[place] == "stable")
        gone += left and abs(orbit.multipliers[0]) < 1.0
    assert len(places) >= 3 and gone > 0


def test_many_pairs_with_mass() -> None:
    """Eight: judged by orbits as few are."""
    structure, law = chain(n=25, pairs=8, seed=2), fc.UnilateralPenalty(5.0)
    curve = fc.continue_frequency(structure, 1.3, 1.32, law, harmonics=12, stability=True)
    assert curve.undecided is not None and np.mean(curve.undecided) < 0.1
    for place in (1, len(curve) // 2):
        alone = fc.floquet(structure, curve.solution(place))
        assert curve.verdicts[place] == alone.verdict != "undecided"
        size = abs(alone.multipliers[0])
        assert abs(curve.multipliers[place]) == pytest.approx(size, rel=1e-2)


def test_multipliers_between_nodes(soft_plate: fc.Structure) -> None:
    """One real multiplier leads all along, while others meet and part: once it said 1.000002 at
    three points where it is 1.09."""
    law = fc.UnilateralPenalty(1e9)
    curve = fc.continue_frequency(soft_plate, 6340.0, 6410.0, law, harmonics=20, stability=True)
    alone = [abs(fc.floquet(soft_plate, one).multipliers[0]) for one in curve.solutions]
    assert max(alone) > 1.1 and np.abs(curve.multipliers) == pytest.approx(alone, rel=3e-3)


def test_motions_that_take_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Undecided at all points, which say so, and nothing is sought; the curve's own bifurcations
    stay."""
    plain = fc.continue_frequency(two_masses(), 0.6, 0.9, fc.UnilateralPenalty(100.0), harmonics=12)
    monkeypatch.setattr(exact, "_budget", lambda *_: Budget(pieces=2))
    monkeypatch.setattr(exact, "OrbitBranch", None)
    judged = fc.judge_curve(plain)
    assert set(judged.verdicts) == {"undecided"}
    assert judged.bifurcations == plain.bifurcations
    assert "no orbit along the curve was followed" in judged.reason(0)


def test_a_fast_mode_costs_time_but_no_verdict() -> None:
    """A mass so light that a period of the load has 5,000 pieces of it: judged as without it."""
    slow = two_masses()
    mass, stiffness = (np.zeros((3, 3)) for _ in range(2))
    for whole, part in ((mass, slow.mass), (stiffness, slow.stiffness)):
        whole[:2, :2] = part.getValues(range(2), range(2))
    mass[2, 2], stiffness[2, 2] = 1e-8, 0.25
    fast = fc.Structure.from_matrices(
        mass,
        stiffness,
        [*slow.gap.toarray()[:, 0], 0.0],
        force_cos=[*slow.force[1], 0.0],
        damping=fc.ModalDamping(0.02),
    )
    law = fc.UnilateralPenalty(1.0)
    flow = exact_flow(fast, law)
    assert flow.pieces(2.0 * np.pi / 0.66) > 2.0 * exact.FOR_EVENTS
    curve = fc.continue_frequency(fast, 0.66, 0.7, law, harmonics=12, stability=True)
    assert curve.undecided is not None and np.mean(curve.undecided) < 0.1


def test_a_curve_from_next_to_no_frequency() -> None:
    """Periods of 6e9 s are given up, which were followed for more than a minute; the points far
    from them are judged."""
    law = fc.UnilateralPenalty(1.0)
    curve = fc.continue_frequency(two_masses(), 1e-9, 0.7, law, harmonics=9, stability=True)
    assert curve.verdicts[0] == "undecided" and curve.verdicts[-1] == "stable"


# --- branches of orbits ---------------------------------------------------------------------------


SOFT = fc.UnilateralPenalty(1.0)


def test_nodes_are_orbits_of_one_branch() -> None:
    """Each is found again by shooting, with its multipliers; chords agree with tangents, round both
    folds, and r, d and c change where bifurcations are alone."""
    curve = fc.continue_frequency(two_masses(), 0.6, 0.9, fc.UnilateralPenalty(100.0), harmonics=30)
    judge = _Judge(curve)
    crossings, nodes, system = judge.branch.locate(), judge.branch.nodes, judge.system
    assert (
        np.mean(judge.branch.linked) > 0.97
    )  # beside a fold of the curve nodes may come back a little
    for one in [one for one in nodes if one.crossing is None][::5]:  # a fold's M - I is singular
        omega = one.parameter * system.omega
        orbit = find_orbit(system.flow, omega, system.state(one.unknown))
        assert orbit is not None and orbit.flows <= 4
        off = system.unknown(orbit.state) - one.unknown
        assert np.linalg.norm(off) < 1e-5 * np.linalg.norm(one.unknown)
        count = min(len(orbit.multipliers), len(one.leading))
        assert np.abs(one.leading[:count]) == pytest.approx(
            np.abs(orbit.multipliers[:count]), abs=1e-3
        )
    assert all(one.located for one in crossings)
    for first, last in pairwise([one for one in nodes if one.crossing is None]):
        between = [one for one in crossings if first.place <= one.place <= last.place]
        assert (first.outside != last.outside) == bool(between)


def test_doublings_that_the_truncated_equations_lack(soft_plate: fc.Structure) -> None:
    """The paper's plate: a real multiplier goes to -1.0536 and back. Waves of 20 harmonics touch -1
    elsewhere, and were not confirmed."""
    law = fc.UnilateralPenalty(1e9)
    curve = fc.continue_frequency(soft_plate, 2300.0, 2450.0, law, harmonics=20, stability=True)
    assert [one.kind for one in curve.bifurcations] == 2 * ["period_doubling"]
    for one in curve.bifurcations:
        near = fc.solve_harmonic_balance(soft_plate, one.exact, law, harmonics=40)
        assert np.abs(fc.shoot(soft_plate, near).multipliers + 1.0).min() < 1e-6
    middle = fc.solve_harmonic_balance(soft_plate, 2390.0, law, harmonics=20)
    assert fc.shoot(soft_plate, middle).multipliers[0] == pytest.approx(-1.0536, abs=1e-4)
    low, high = (one.exact for one in curve.bifurcations)
    unstable = (curve.omega > low) & (curve.omega < high)
    assert np.array_equal(curve.verdicts == "unstable", unstable)
    assert set(curve.verdicts) == {"stable", "unstable"}


def test_two_bifurcations_next_to_each_other(soft_plate: fc.Structure) -> None:
    """A pair comes back into the unit circle, meets at -1, and one of it leaves again within 0.1
    rad/s: orbits at both frequencies have a multiplier on the circle."""
    law = fc.UnilateralPenalty(1e9)
    curve = fc.continue_frequency(soft_plate, 1700.0, 1725.0, law, harmonics=20, stability=True)
    found = {one.kind: one.exact for one in curve.bifurcations if 1712.0 < one.exact < 1713.0}
    assert set(found) == {"neimark_sacker", "period_doubling"}
    assert 0.05 < found["period_doubling"] - found["neimark_sacker"] < 0.15
    for kind, omega in found.items():
        near = fc.solve_harmonic_balance(soft_plate, omega, law, harmonics=40)
        values = fc.shoot(soft_plate, near).multipliers
        if kind == "period_doubling":
            assert np.abs(values + 1.0).min() < 1e-5
        else:
            assert abs(values[0].imag) > 0.01 and abs(values[0]) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("parameter", "omega", "law", "given", "spans", "expected"),
    [
        pytest.param(
            "clearance", 1.2, 3.0, {"damping": 0.1}, [(-3.0, 0.0), (-5.0, 5.0), (-0.5, -2.0)],
            (-1.41680, -1.15968), id="clearance",
        ),
        pytest.param(
            "load", 1.214, 4.333, {"damping": 0.07, "clearance": -0.3}, [(0.1, 5.0), (5.0, 0.1)],
            (0.294215, 0.340088), id="load",
        ),
    ],
)  # fmt: skip
def test_doublings_do_not_depend_on_the_range_and_its_direction(
    parameter: str,
    omega: float,
    law: float,
    given: dict[str, float],
    spans: list[tuple[float, float]],
    expected: tuple[float, float],
) -> None:
    """One mass: both lie on one segment behind the one on which it begins to touch, and a pair of
    multipliers has the same moduli at its ends. Between them the multiplier of the orbit by itself
    is below -1."""
    one = np.ones((1, 1))
    structure = fc.Structure.from_matrices(
        one, one, one, force_cos=[1.0], damping=given["damping"] * one,
        clearance=given.get("clearance", 0.0),
    )  # fmt: skip
    contact = fc.UnilateralPenalty(law)
    there = structure.varied(**{parameter: sum(expected) / 2})
    alone = fc.solve_harmonic_balance(there, omega, contact, harmonics=20)
    assert fc.shoot(there, alone).multipliers.real.min() < -1.0
    for start, end in spans:
        curve = fc.continue_parameter(
            structure, omega, contact, parameter, start, end, harmonics=20, stability=True
        )
        found = [one.exact for one in curve.bifurcations if one.kind == "period_doubling"]
        assert sorted(found) == pytest.approx(expected, abs=1e-5)
        between = (curve.values > expected[0]) & (curve.values < expected[1])
        assert between.any() and set(curve.verdicts[between]) == {"unstable"}


def test_a_curve_along_which_no_orbit_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each point is judged by itself, beside no node."""
    monkeypatch.setattr(orbit_branch.OrbitBranch, "next_to", lambda *_, **__: None)
    curve = fc.continue_frequency(oscillator(), 0.7, 0.8, SOFT, harmonics=15, stability=True)
    alone = [fc.floquet(one.structure, one).verdict for one in curve.solutions]
    assert curve.verdicts.tolist() == alone and "stable" in alone


@pytest.mark.parametrize(("start", "end"), [(1.0, 0.0), (0.0, 1.0)])
def test_a_curve_to_no_damping_and_from_there(start: float, end: float) -> None:
    """Where the motion without damping has its multipliers on the unit circle it is open."""
    one = np.ones((1, 1))
    structure = fc.Structure.from_matrices(one, one, one, force_cos=[1.0], damping=0.1 * one)
    curve = fc.continue_parameter(
        structure, 1.2, fc.UnilateralPenalty(3.0), "damping", start, end, harmonics=20,
        stability=True,
    )  # fmt: skip
    assert curve.complete
    assert curve.verdicts[np.argmin(curve.values)] == "undecided"
    assert curve.verdicts[np.argmax(curve.values)] != "undecided"


@pytest.mark.parametrize(
    ("parameter", "start", "end", "count"),
    [("damping", 1.0, 8.0, 1), ("stiffness", 0.05, 2.0, 1), ("clearance", -3.0, 0.5, 2)],
)
def test_doublings_over_other_parameters(
    parameter: str, start: float, end: float, count: int
) -> None:
    """Orbits at their exact values have the multiplier -1, and verdicts change there."""
    curve = fc.continue_parameter(
        oscillator(), 2.3, SOFT, parameter, start, end, harmonics=15, stability=True
    )
    found = [one for one in curve.bifurcations if one.kind == "period_doubling"]
    assert len(found) == count and all(one.confirmed for one in found)
    for one in found:
        structure, law = oscillator(), SOFT
        if parameter == "stiffness":
            law = law.scaled(one.exact)
        else:
            structure = structure.varied(**{parameter: one.exact})
        near = fc.solve_harmonic_balance(structure, 2.3, law, harmonics=40, initial=one.solution)
        assert np.abs(fc.shoot(structure, near).multipliers + 1.0).min() < 1e-6
    changes = np.flatnonzero(curve.stable[1:] != curve.stable[:-1])
    assert len(changes) == count
    for change, one in zip(changes, found, strict=True):
        assert curve.values[change] <= one.exact <= curve.values[change + 1]


def test_leading_multipliers_of_a_large_matrix() -> None:
    """Those of all of it, or none where many are alike."""
    rng = np.random.default_rng(1)
    basis = rng.normal(size=(90, 90))
    for radius, known in ((0.9, True), (1.0, False)):
        sizes = radius ** np.arange(45) * 1.05 if known else np.full(45, 0.999)
        blocks = np.zeros((90, 90))
        for place, size in enumerate(sizes):
            angle = rng.uniform(0.1, 3.0)
            turn = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            blocks[2 * place : 2 * place + 2, 2 * place : 2 * place + 2] = size * np.array(turn)
        matrix = basis @ blocks @ np.linalg.inv(basis)
        found = orbit_branch._leading(matrix)
        assert (found is not None) == known
        if found is not None:
            exact = np.sort(np.abs(eigenvalues(matrix)))[::-1][: len(found)]
            assert np.abs(found) == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize("parameter", ["omega", "stiffness"])
def test_homotopies_use_up_what_they_may(parameter: str) -> None:
    """As many pieces as their motions have, along curves over whichever parameter."""
    law = fc.UnilateralPenalty(100.0)
    curve = (
        fc.continue_frequency(two_masses(), 0.7, 0.72, law, harmonics=10)
        if parameter == "omega"
        else fc.continue_parameter(two_masses(), 0.7, law, "stiffness", 0.9, 1.1, harmonics=10)
    )
    judge = _Judge(curve)
    homotopy, before = Homotopy(judge.system), Homotopy(judge.system).left
    homotopy.linearise(judge.system.start, 0.5)
    motion = judge.system._motion(judge.system.start, 1.0, np.zeros(0))
    assert before - homotopy.left == motion.pieces > 0
