"""Branches of twice the period where harmonic balance has its own period doubling elsewhere."""

from __future__ import annotations

import campaign
import numpy as np
import pytest
from helpers import oscillator

import fenics_crack as fc


def doubling_of_stiff_stop(
    stiffness: float, harmonics: int
) -> tuple[fc.ResponseCurve, fc.Bifurcation]:
    """The oscillator on a stiff stop above its resonance, and its period doubling."""
    curve = fc.continue_frequency(
        oscillator(0.1, 1.0), 2.2, 3.0, fc.UnilateralPenalty(stiffness),
        harmonics=harmonics, stability=True,
    )  # fmt: skip
    [one] = [b for b in curve.bifurcations if b.kind == "period_doubling" and b.confirmed]
    return curve, one


@pytest.mark.parametrize(("stiffness", "harmonics", "doubled"), [(300.0, 6, 12), (3000.0, 4, 16)])
def test_branch_by_way_of_exact_orbits(stiffness: float, harmonics: int, doubled: int) -> None:
    """The branch begins behind the exact doubling, if need be with more harmonics; its solutions
    are next to exact orbits of twice the period, no farther than they say."""
    curve, one = doubling_of_stiff_stop(stiffness, harmonics)
    branch = fc.follow_branch(curve, one)
    assert branch.complete and "begun next to the exact orbit" in branch.status
    assert branch.subharmonic == 2 and branch.harmonics[0] == doubled
    assert branch.omega[0] > one.exact and branch.omega[-1] == 3.0
    for omega in np.linspace(2.85, 3.0, 4):
        solution = branch.solution(int(np.argmin(np.abs(branch.omega - omega))))
        orbit = fc.shoot(curve.structure, solution)
        halves = orbit.gap - np.roll(orbit.gap, len(orbit.gap) // 2, axis=0)
        assert np.linalg.norm(halves) > 0.1 * np.linalg.norm(orbit.gap)
        wave = solution.gap(np.arange(len(orbit.gap)) * solution.period / len(orbit.gap))
        off = np.linalg.norm(wave - orbit.gap) / np.linalg.norm(orbit.gap)
        assert off < 3.0 * solution.assessment.errors()[0] < 0.5


def test_a_pair_without_mass_has_the_same_branch() -> None:
    """A rigid stop behind a spring without mass is the stiff stop: the same orbits lead to it."""
    curve, one = doubling_of_stiff_stop(300.0, 6)
    branch = fc.follow_branch(curve, one)
    structure = fc.Structure.from_matrices(
        np.diag([1.0, 0.25]), np.diag([1.0, 300.0]), [1.0, 1.0], force_cos=[1.0, 0.0],
        damping=np.diag([0.1, 0.0]),
    )  # fmt: skip
    structure = fc.reduce_structure(structure, modes=1, method="massless")
    curve = fc.continue_frequency(
        structure, 2.2, 3.0, fc.UnilateralConstraint(), harmonics=6, stability=True
    )
    [same] = [b for b in curve.bifurcations if b.kind == "period_doubling" and b.confirmed]
    assert same.exact == pytest.approx(one.exact, rel=1e-9)
    found = fc.follow_branch(curve, same)
    assert found.status == branch.status
    assert found.omega == pytest.approx(branch.omega, rel=1e-7)
    assert found.amplitude(0) == pytest.approx(branch.amplitude(0), rel=1e-6)


def test_unconfirmed_doubling_is_not_looked_for() -> None:
    """Where no exact orbits have the doubling, none leads to a branch."""
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(300.0)
    curve = fc.continue_frequency(structure, 2.2, 3.0, law, harmonics=6)
    one = curve.bifurcation("period_doubling", float(curve.values[3]), curve.unknown(3))
    with pytest.raises(fc.ConvergenceError, match="no point of another branch"):
        fc.follow_branch(curve, one)


def test_motion_that_leaves_its_orbit_is_not_called_stable() -> None:
    """Next to grazing a stable orbit of twice the period attracts only what is nearer than the
    truncated wave is: from there the exact motion goes to another one."""
    case = campaign.draw(75, 95, None, "ends")
    curve = campaign.followed(case)
    first, one, *_ = [b for b in curve.bifurcations if b.kind == "period_doubling" and b.confirmed]
    ends = (11, 12)  # between which the first one lies, next to where no orbits are found
    [before, behind] = [campaign.exact_orbit(case, curve.solution(place))[0] for place in ends]
    assert curve.values[11] < first.exact < curve.values[12]
    assert abs(before.multipliers[0]) < 1.0 and behind.multipliers[0].real < -1.0
    branch = fc.follow_branch(curve, one, throw=False, stability=True, most_points=49)
    verdicts = {"stable": 0, "undecided": 0}
    for place in (5, 6, 47, 48):
        verdict, solution = branch.verdicts[place], branch.solution(place)
        if verdict not in verdicts or solution.report.total < 0.01:
            continue
        orbit, _ = campaign.exact_orbit(case, solution)
        if orbit is not None and abs(orbit.multipliers[0]) < 1.0:
            verdicts[str(verdict)] += 1
            assert verdict == "undecided" or not campaign.leaves(case, solution, orbit)
    assert min(verdicts.values()) > 0


@pytest.mark.slow
def test_ends_are_judged_as_single_solutions() -> None:
    """One mass, k R = 122, which was called stable next to an end where an orbit beside it has a
    multiplier of 8: no verdict contradicts floquet, nor the exact flow."""
    rows = campaign.findings(51, campaign.draw(51, 13, family="ends"))
    judgements = [row["judgement"] for row in rows]  # which orbits are found hangs on rounding
    assert len(rows) == 6 and campaign.WRONG not in judgements, rows
    assert judgements.count("right") >= 4


def test_no_step_leads_back_onto_the_branch_that_was_left() -> None:
    """No point is an orbit of half the period, and the branch ends where little tells it from the
    one that it left; a long step that met that one ended it far from there."""
    case = campaign.draw(75, 35, None, "ends")
    curve = fc.continue_frequency(
        case.structure, 0.395, 0.432, case.law, harmonics=case.harmonics, stability=True
    )
    places = np.array([one.value for one in curve.bifurcations])
    for place in (0.403244, 0.429862):
        one = curve.bifurcations[int(np.abs(places - place).argmin())]
        branch = fc.follow_branch(curve, one)
        rows = branch.gap_coefficients
        odd = np.concatenate([rows[:, 1::4], rows[:, 2::4]], axis=1)
        sizes = np.linalg.norm(odd, axis=(1, 2)) / np.linalg.norm(rows, axis=(1, 2))
        assert branch.status == "joined the branch that it left"
        assert sizes.min() > 1e-6 and sizes[-1] < 0.02 * sizes.max()


def test_first_orbit_of_a_branch_beyond_the_range_asked_for() -> None:
    """It ended with "min() arg is an empty sequence": no branch within the range is said."""
    curve, one = doubling_of_stiff_stop(300.0, 6)
    low, high = sorted([one.value, one.exact])
    with pytest.raises(fc.ConvergenceError, match="branch from period_doubling"):
        fc.follow_branch(curve, one, low - 1e-6, high + 1e-6)
