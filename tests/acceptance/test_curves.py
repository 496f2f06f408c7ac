"""What response curves promise: their points, ends, bifurcations and verdicts."""

from functools import cache
from typing import Any

import judged
import numpy as np
import pytest
from verdicts import random_chain

import fenics_crack as fc

SOFT = fc.UnilateralPenalty(1.0)
STOP = fc.UnilateralPenalty(100.0)
EXACT = {
    "period_doubling": (0.7387830254, 0.7555861594),
    "fold": (0.7556273526, 0.6534401345),
    "neimark_sacker": (0.6186068743,),
}
"""Of two masses and a stop, in the order of the curve: by exact orbits."""


@cache
def bilinear() -> fc.ResponseCurve:
    """One mass over its doubled motion."""
    return fc.continue_frequency(judged.oscillator(), 1.5, 3.0, SOFT, harmonics=20, stability=True)


@cache
def stopped() -> fc.ResponseCurve:
    """Two masses and a stop: it turns back twice."""
    return fc.continue_frequency(judged.two_masses(), 0.6, 0.9, STOP, tolerance=1e-3)


def state(curve: fc.ResponseCurve) -> np.ndarray:
    """How large the motion is at each point."""
    return np.linalg.norm(curve.gap_coefficients[:, 1:], axis=(1, 2))


def test_linear_curve_is_that_of_a_resonance() -> None:
    """|X| = 1 / |1 - W^2 + i c W|, from one end to the other."""
    curve = fc.continue_frequency(judged.oscillator(clearance=100.0), 0.5, 1.5, SOFT, harmonics=3)
    assert curve.complete and not curve.bifurcations
    assert curve.omega[[0, -1]] == pytest.approx([0.5, 1.5], rel=1e-14)
    exact = 1.0 / np.abs(1.0 - curve.omega**2 + 0.1j * curve.omega)
    assert state(curve) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("mean", [0.0, -1e5, 1e5])
@pytest.mark.parametrize("asked", [{"harmonics": 5}, {"tolerance": 1e-2}], ids=["H", "tolerance"])
def test_resonance_beside_a_steady_load(mean: float, asked: dict[str, Any]) -> None:
    """Ten to a thousand times the vibration, off a stop or onto it: steps are parts of what
    moves, and peak and damping are the mode's."""
    ratio, natural_omega = 1e-3, 1.0 if mean <= 0.0 else np.sqrt(2.0)
    unit, damping = np.ones((1, 1)), 2.0 * ratio * natural_omega
    structure = fc.Structure.from_matrices(
        unit, unit, gap=unit, force_cos=[1.0], force_mean=[mean],
        damping=damping * unit, clearance=0.0 if mean else 1e3,
    )  # fmt: skip
    curve = fc.continue_frequency(
        structure, 0.5 * natural_omega, 1.6 * natural_omega, SOFT, **asked
    )
    peak = curve.peak()
    assert peak.omega == pytest.approx(natural_omega * np.sqrt(1.0 - 2.0 * ratio**2), rel=1e-5)
    exact = 1.0 / (damping * natural_omega * np.sqrt(1.0 - ratio**2))
    assert peak.amplitude == pytest.approx(exact, rel=1e-3)
    assert peak.damping == pytest.approx(ratio, rel=1e-2)


def test_points_are_solutions_with_their_errors_and_verdicts() -> None:
    """Solved again at their frequencies they stay; errors and verdicts are those of the exact
    orbits."""
    curve = bilinear()
    assert curve.complete
    for place in np.linspace(0, len(curve) - 1, 8).astype(int):
        solution = curve.solution(int(place))
        repeated_solution = fc.solve_harmonic_balance(
            solution.structure, solution.omega, SOFT, harmonics=20, initial=solution
        )
        change = np.linalg.norm(repeated_solution.gap_coefficients - solution.gap_coefficients)
        assert change < 1e-8 * np.linalg.norm(solution.gap_coefficients)
        orbit = judged.orbit_of(solution)
        true_error = judged.apart(solution, orbit)
        assert true_error / 3.0 < solution.report.total < 3.0 * true_error
        stable = np.abs(orbit.multipliers[0]) < 1.0
        assert curve.verdicts[place] == ("stable" if stable else "unstable")


def test_bifurcations_are_those_of_exact_orbits() -> None:
    """Two doublings, two folds and a Neimark-Sacker point, to six digits."""
    for kind, exact_values in EXACT.items():
        bifurcations = [
            bifurcation for bifurcation in stopped().bifurcations if bifurcation.kind == kind
        ]
        assert [bifurcation.value for bifurcation in bifurcations] == pytest.approx(
            exact_values, rel=1e-6
        )


@pytest.mark.parametrize("kind", EXACT)
def test_multiplier_at_a_bifurcation(kind: str) -> None:
    """Of the exact orbit there, and but for a fold of a flow that is not the package's: +1, -1, or
    a pair on the unit circle."""
    bifurcation = next(
        bifurcation for bifurcation in stopped().bifurcations if bifurcation.kind == kind
    )
    orbit, values = bifurcation.orbit, bifurcation.orbit.multipliers
    assert bifurcation.omega == pytest.approx(EXACT[kind][0], rel=1e-9) and orbit.residual < 1e-9
    if kind != "fold":  # where no Newton's method can be asked
        exact = judged.orbit_of(bifurcation.solution)
        assert np.linalg.norm(exact.gap - orbit.gap) < 1e-7 * np.linalg.norm(exact.gap)
        values = exact.multipliers
    if kind == "neimark_sacker":
        assert np.abs(np.abs(values[np.abs(values.imag) > 0.1]) - 1.0).min() < 1e-7
    else:
        assert np.abs(values - (1.0 if kind == "fold" else -1.0)).min() < 1e-5


def test_multiplier_seen_in_the_motion() -> None:
    """At a period doubling the critical direction changes its sign each period, undamped."""
    doubling_point = next(
        doubling_point
        for doubling_point in stopped().bifurcations
        if doubling_point.kind == "period_doubling"
    )
    exact, flow = (
        judged.orbit_of(doubling_point.solution),
        judged.flow_of(judged.two_masses(), STOP),
    )
    period = 2.0 * np.pi / doubling_point.omega
    values, vectors = np.linalg.eig(exact.monodromy)
    disturbance = vectors[:, np.argmin(np.abs(values + 1.0))].real
    disturbance *= 1e-6 * np.linalg.norm(exact.state) / np.linalg.norm(disturbance)
    state = exact.state + disturbance
    for index in range(1, 5):
        state = flow.advance(state, doubling_point.omega, 0.0, period).state
        remainder = state - exact.state - (-1.0) ** index * disturbance
        assert np.linalg.norm(remainder) < 1e-4 * np.linalg.norm(disturbance)


def test_folds_are_turning_points() -> None:
    """The frequency has its extremes there, and between both there are three solutions."""
    curve = stopped()
    folds = [bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == "fold"]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(curve.omega)))) + 1
    assert len(turns) == len(folds) == 2
    for turn, fold in zip(turns, folds, strict=True):
        assert np.ptp([curve.omega[turn], fold.value]) < 1e-3
    low_fold, high_fold = sorted(fold.value for fold in folds)
    crossings = np.diff(np.sign(curve.omega - 0.5 * (low_fold + high_fold)))
    assert np.count_nonzero(crossings) == 3


def test_verdict_changes_where_a_bifurcation_is() -> None:
    """And nowhere else."""
    curve = fc.continue_frequency(judged.oscillator(), 1.5, 3.0, SOFT, tolerance=1e-3)
    stable = curve.stable
    doubling_omegas = np.sort([bifurcation.value for bifurcation in curve.bifurcations])
    assert [bifurcation.kind for bifurcation in curve.bifurcations] == ["period_doubling"] * 2
    assert np.array_equal(
        stable, (curve.omega < doubling_omegas[0]) | (curve.omega > doubling_omegas[1])
    )


# --- exact bifurcations ---------------------------------------------------------------------------


def kinds(curve: fc.ResponseCurve) -> list[str]:
    """Those of its bifurcations, in order."""
    return [bifurcation.kind for bifurcation in curve.bifurcations]


def assert_on_the_circle(bifurcation: fc.Bifurcation) -> None:
    """A multiplier of another flow's orbit there is -1, or a pair is on the unit circle."""
    values = judged.orbit_of(bifurcation.solution).multipliers
    if bifurcation.kind == "period_doubling":
        assert np.abs(values + 1.0).min() < 1e-5
    else:
        pair = values[np.abs(values.imag) > 0.01]
        assert np.abs(np.abs(pair) - 1.0).min() < 1e-5


@pytest.mark.parametrize(
    ("span", "expected"),
    [
        ((1730.0, 1780.0), {"neimark_sacker": 1766.62181}),
        pytest.param((1500.0, 1525.0), {"period_doubling": 1506.78265}, marks=pytest.mark.nightly),
    ],
    ids=["a pair leaves", "doubling"],
)
def test_rigid_plate_loses_its_stability(
    has_massless_crack_faces: fc.Structure, span: tuple[float, float], expected: dict[str, float]
) -> None:
    """Where harmonic balance with few harmonics has other bifurcations: disturbed motions come back
    before it, and leave behind it."""
    law = fc.UnilateralConstraint()
    curve = fc.continue_frequency(has_massless_crack_faces, *span, law, tolerance=1e-2)
    [bifurcation] = curve.bifurcations
    assert {bifurcation.kind: bifurcation.value} == pytest.approx(expected, rel=1e-7)
    assert np.array_equal(curve.stable, curve.omega < bifurcation.value)
    assert_on_the_circle(bifurcation)
    flow = judged.flow_of(has_massless_crack_faces, law)
    for place in (0, -1):
        point = curve.solution(place)
        exact = judged.orbit_of(point)
        state, distances = exact.state * (1.0 + 1e-6), []
        for _ in range(30):
            state = flow.advance(state, point.omega, 0.0, point.period).state
            distances.append(np.linalg.norm(state - exact.state))
        assert (distances[-1] < distances[9]) == (curve.verdicts[place] == "stable")


SOFT_PLATE = {
    (2300.0, 2450.0): {"period_doubling": [2366.67199, 2411.27990]},
    (1700.0, 1725.0): {"neimark_sacker": [1712.68287], "period_doubling": [1712.77557]},
    (1280.0, 1340.0): {
        "neimark_sacker": [1297.47229, 1306.56551], "fold": [1318.63889, 1313.45757],
    },
}  # fmt: skip
"""The paper's plate with 1 %, k = 1e9: by exact orbits that 20 and 40 harmonics led to."""


@pytest.mark.parametrize(
    "span",
    [
        (2300.0, 2450.0), pytest.param((1700.0, 1725.0), marks=pytest.mark.nightly),
        pytest.param((1280.0, 1340.0), marks=pytest.mark.nightly),
    ],
)  # fmt: skip
def test_paper_plate(soft_plate: fc.Structure, span: tuple[float, float]) -> None:
    """Doublings that truncated equations lack, two bifurcations within 0.1 rad/s, and one fold for
    several of harmonic balance: by the multipliers of another flow."""
    curve = fc.continue_frequency(soft_plate, *span, fc.UnilateralPenalty(1e9), tolerance=1e-2)
    for kind, exact_values in SOFT_PLATE[span].items():
        bifurcations = [
            bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == kind
        ]
        assert [bifurcation.value for bifurcation in bifurcations] == pytest.approx(
            exact_values, rel=1e-7
        )
        for bifurcation in bifurcations:
            if kind != "fold":
                assert_on_the_circle(bifurcation)
    assert len(curve.bifurcations) == sum(map(len, SOFT_PLATE[span].values()))
    assert {"stable", "unstable"} == set(curve.verdicts)


@pytest.mark.parametrize(
    ("parameter", "omega", "law", "given", "spans", "expected"),
    [
        ("clearance", 1.2, 3.0, {}, [(-3.0, 0.0), (-5.0, 5.0), (-0.5, -2.0)], (-1.41680, -1.15968)),
        (
            "load", 1.214, 4.333, {"damping": 0.07, "clearance": -0.3}, [(0.1, 5.0), (5.0, 0.1)],
            (0.294215, 0.340088),
        ),
        ("damping", 2.3, 1.0, {}, [(1.0, 8.0), (8.0, 1.0)], (2.53348,)),
        ("stiffness", 2.3, 1.0, {}, [(0.05, 2.0), (2.0, 0.05)], (0.480744,)),
        ("clearance", 2.3, 1.0, {}, [(-3.0, 0.5), (0.5, -3.0)], (-0.211022, 0.19332)),
    ],
)  # fmt: skip
def test_doublings_over_other_parameters(
    parameter: str, omega: float, law: float, given: dict, spans: list, expected: tuple
) -> None:
    """Whatever the range and its direction; the multiplier of another flow is -1 there, and the
    verdict changes."""
    structure, contact = judged.oscillator(**given), fc.UnilateralPenalty(law)
    for start, end in spans:
        curve = fc.continue_parameter(
            structure, omega, contact, parameter, start, end, tolerance=1e-2
        )
        doubling_points = [
            doubling_point
            for doubling_point in curve.bifurcations
            if doubling_point.kind == "period_doubling"
        ]
        assert curve.complete and sorted(
            doubling_point.value for doubling_point in doubling_points
        ) == pytest.approx(expected, abs=1e-5)
        for doubling_point in doubling_points:
            assert_on_the_circle(doubling_point)
        changes = np.flatnonzero(curve.stable[1:] != curve.stable[:-1])
        intervals = np.sort([curve.values[changes], curve.values[changes + 1]], axis=0)
        for place, doubling_point in zip(intervals.T, doubling_points, strict=False):
            assert place[0] <= doubling_point.value <= place[1]


@pytest.mark.parametrize(("start", "end"), [(1.0, 0.0), (0.0, 1.0)])
def test_to_no_damping_and_from_there(start: float, end: float) -> None:
    """Where the motion without damping has its multipliers on the unit circle it is open."""
    curve = fc.continue_parameter(
        judged.oscillator(), 1.2, fc.UnilateralPenalty(3.0), "damping", start, end, tolerance=1e-2
    )
    assert curve.complete
    assert np.array_equal(curve.verdicts == "undecided", curve.values == 0.0)


@cache
def over_load() -> tuple[fc.Structure, fc.ContactLaw, fc.ResponseCurve]:
    """One mass of 1000 rad/s and a stop of the same stiffness 1 cm away: up, back and up again."""
    unit, law = np.ones((1, 1)), fc.UnilateralPenalty(1e6)
    structure = fc.Structure.from_matrices(
        unit, 1e6 * unit, gap=unit, force_sin=[1e3], damping=30.0 * unit, clearance=0.01
    )
    curve = fc.continue_parameter(structure, 1100.0, law, "load", 0.3, 3.0, tolerance=1e-3)
    return structure, law, curve


def test_three_motions_at_one_load() -> None:
    """Small, middle and large: each is found again by a single solution of the structure under that
    load, and judged alike; a motion that begins next to the middle one leaves it."""
    base, law, curve = over_load()
    structure = base.varied(load=1.5)
    crossings = np.flatnonzero(np.diff(np.sign(curve.values - 1.5)))
    verdicts = []
    for curve_solution in map(curve.solution, map(int, crossings)):
        solution = fc.solve_harmonic_balance(
            structure, 1100.0, law, harmonics=20, initial=curve_solution
        )
        verdicts.append(fc.floquet(structure, solution).verdict)
        history = fc.integrate_events(
            structure, 1100.0, law, initial=solution, periods=60, settle=1e-12
        )
        size = float(np.ptp(history.displacement([0])[-256:]) / 2.0)
        stays = abs(size / solution.amplitude(0) - 1.0) < 0.01
        assert stays == (verdicts[-1] == "stable")
    assert verdicts == ["stable", "unstable", "stable"] == curve.verdicts[crossings].tolist()


def test_folds_over_the_load() -> None:
    """Where harmonic balance has them with 60 harmonics."""
    structure, law, curve = over_load()
    fine_curve = fc.continue_parameter(
        structure, 1100.0, law, "load", 0.3, 3.0, harmonics=60, longest_step=0.02
    )
    assert kinds(curve) == ["fold", "fold"] == kinds(fine_curve)
    true_folds = [bifurcation.value for bifurcation in fine_curve.bifurcations]
    assert [bifurcation.value for bifurcation in curve.bifurcations] == pytest.approx(
        true_folds, rel=5e-4
    )


@pytest.mark.drawn(1)
@pytest.mark.parametrize("seed", [74, 65])
def test_bifurcations_do_not_depend_on_the_step(seed: int) -> None:
    """Chains with 0.1 to 1 % of damping lose and find their stability within a few points: all that
    lie on the way are the same with half of the step."""
    structure, law = random_chain(seed)
    first_omega, second_omega = fc.solve_modes(structure, 2).omega
    bifurcations = []
    for step, max_points in ((0.02, 200), (0.01, 400)):
        curve = fc.continue_frequency(
            structure, 0.8 * first_omega, 1.25 * second_omega, law, tolerance=1e-2,
            longest_step=step, most_points=max_points, throw=False,
        )  # fmt: skip
        assert {"stable", "unstable"} == {*curve.verdicts}
        bifurcations.append(
            [(bifurcation.kind, round(bifurcation.value, 6)) for bifurcation in curve.bifurcations]
        )
    n_common = min(map(len, bifurcations))
    assert n_common >= 6 and bifurcations[0][:n_common] == bifurcations[1][:n_common]


def test_both_ways_find_the_same_folds() -> None:
    """A mass pressed on one stop and far from another: large and small vibrations stand side by
    side, beside a preload ten times as large, and neither way steps over them."""
    unit, law = np.ones((1, 1)), fc.UnilateralPenalty([12.7593, 10.1039])
    structure = fc.Structure.from_matrices(
        1.1583 * unit, 1.7879 * unit, gap=np.array([[-1.0, 1.0]]), force_cos=[-1.0],
        force_sin=[-0.0531], clearance=[-0.6191, 1.3975], damping=0.2253 * unit,
    )  # fmt: skip
    ends, folds = (0.745, 2.485), []
    for start, end in (ends, ends[::-1]):
        curve = fc.continue_frequency(structure, start, end, law, tolerance=1e-2)
        folds.append(sorted(point.value for point in curve.bifurcations if point.kind == "fold"))
    assert len(folds[0]) == 6 and folds[0] == pytest.approx(folds[1], rel=1e-7)


# --- verdicts of harmonic balance -----------------------------------------------------------------


@pytest.mark.nightly
def test_stiff_stop_with_few_harmonics() -> None:
    """H = 10, against the branch of exact orbits: of the points whose nearest orbit is clear none
    has the verdict of another one; folds are its own."""
    structure, law, span = judged.oscillator(0.02, 0.1), fc.UnilateralPenalty(100.0), (2.0, 0.5)
    curve = fc.continue_frequency(structure, *span, law, harmonics=10, stability=True)
    exact = fc.continue_frequency(structure, *span, law, tolerance=1e-3)
    rows = exact.gap_coefficients[:, :21, 0]
    n_compared = 0
    for place in np.flatnonzero(curve.verdicts != "undecided"):
        coefficients = curve.gap_coefficients[place, :, 0]
        distance = np.linalg.norm(rows - coefficients, axis=1) / np.linalg.norm(coefficients)
        distance = np.hypot(distance, exact.omega / curve.omega[place] - 1.0)
        nearest_distances = {
            verdict: distance[exact.verdicts == verdict].min() for verdict in ("stable", "unstable")
        }
        nearest_verdict = min(nearest_distances, key=lambda verdict: nearest_distances[verdict])
        if 3.0 * nearest_distances[nearest_verdict] < max(nearest_distances.values()):
            n_compared += 1
            is_irregular = nearest_verdict == "unstable" and curve.verdicts[place] == "irregular"
            assert is_irregular or curve.verdicts[place] == nearest_verdict, curve.omega[place]
    assert n_compared > 50 and set(kinds(curve)) == {"fold"}


def test_undecided_points_have_their_reason() -> None:
    """In words; the others have none, nor do curves that are not judged."""
    curve_without_verdicts = fc.continue_frequency(
        judged.two_masses(), 0.6, 0.9, fc.UnilateralPenalty(1000.0), harmonics=13
    )
    curve = fc.judge_curve(curve_without_verdicts)
    reasons = [curve.reason(index) for index in range(len(curve))]
    is_undecided = curve.verdicts == "undecided"
    assert is_undecided.any() and np.array_equal([bool(reason) for reason in reasons], is_undecided)
    assert (
        all("orbit" in reason for reason in reasons if reason)
        and curve_without_verdicts.reason(0) == ""
    )
    assert curve.bifurcations == curve_without_verdicts.bifurcations


def test_from_next_to_no_frequency() -> None:
    """Periods of 6e9 s are not followed, which is said; points far from there are judged. To a
    tolerance harmonic balance is followed."""
    structure = judged.two_masses()
    curve = fc.continue_frequency(structure, 1e-9, 0.7, SOFT, harmonics=9, stability=True)
    assert curve.verdicts[0] == "undecided" and "thousand cycles in a period" in curve.reason(0)
    assert curve.verdicts[-1] == "stable"
    curve = fc.continue_frequency(structure, 1e-9, 0.7, SOFT, tolerance=1e-2)
    assert not curve.exact and curve.complete
