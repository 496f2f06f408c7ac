"""Curves over other parameters than the frequency, judged as single solutions are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import oscillator
from verdicts import random_chain

import fenics_crack as fc

LAW = fc.UnilateralPenalty(1e6)


def stop() -> fc.Structure:
    """One mass of natural frequency 1000 rad/s, and a stop of the same stiffness 1 cm away."""
    one = np.ones((1, 1))
    return fc.Structure.from_matrices(
        one, 1e6 * one, one, force_sin=[1e3], damping=30.0 * one, clearance=0.01
    )


@pytest.fixture(scope="module")
def over_load() -> fc.ResponseCurve:
    """Up, back and up again over the load: 3 harmonics."""
    return fc.continue_parameter(
        stop(), 1100.0, LAW, "load", 0.3, 3.0, harmonics=3, stability=True, longest_step=0.02
    )


def test_three_solutions_at_one_load(over_load: fc.ResponseCurve) -> None:
    """Small, middle and large: each is found again by a single solution of the structure under that
    load, and judged alike; a motion that begins next to the middle one leaves it."""
    structure, at = stop().varied(load=1.5), over_load.values - 1.5
    crossings = np.flatnonzero(at[1:] * at[:-1] < 0.0)
    assert len(crossings) == 3
    verdicts = []
    for index in map(int, crossings):
        near = over_load.solution(index)
        found = fc.solve_harmonic_balance(structure, 1100.0, LAW, harmonics=20, initial=near)
        assert found.amplitude(0) == pytest.approx(near.amplitude(0), rel=0.1)
        verdicts.append(fc.floquet(structure, found).verdict)
        assert over_load.verdicts[index] == verdicts[-1]
        size = abs(fc.floquet(structure, found).multipliers[0])
        assert abs(over_load.multipliers[index]) == pytest.approx(size, abs=0.02)
        history = fc.integrate_events(
            structure, 1100.0, LAW, initial=found, periods=60, settle=1e-12
        )
        size = float(np.ptp(history.displacement([0])[-256:]) / 2.0)
        stays = abs(size / found.amplitude(0) - 1.0) < 0.01
        assert stays == (verdicts[-1] == "stable")
    assert verdicts == ["stable", "unstable", "stable"]


def test_folds_are_those_of_the_motion(over_load: fc.ResponseCurve) -> None:
    """Found with 3 harmonics where the equations have them with 60."""
    fine = fc.continue_parameter(
        stop(), 1100.0, LAW, "load", 0.3, 3.0, harmonics=60, longest_step=0.02
    )
    folds = [one for one in over_load.bifurcations if one.kind == "fold"]
    true = [one.value for one in fine.bifurcations]
    assert len(folds) == len(true) == 2
    for one, value in zip(folds, true, strict=True):
        assert one.confirmed and one.exact == pytest.approx(value, rel=5e-4)
    assert abs(folds[1].exact / true[1] - 1.0) < 0.2 * abs(folds[1].value / true[1] - 1.0)


def test_files_and_words(over_load: fc.ResponseCurve, tmp_path: Path) -> None:
    """Verdicts and exact places outlast a file, with their unit."""
    fc.save(over_load, tmp_path / "curve.h5")
    loaded = fc.load(tmp_path / "curve.h5", stop(), LAW)
    assert isinstance(loaded, fc.ResponseCurve)
    assert np.array_equal(loaded.verdicts, over_load.verdicts)
    assert [one.exact for one in loaded.bifurcations] == [o.exact for o in over_load.bifurcations]
    assert ", exact 0.859" in repr(loaded.bifurcations[1])


def test_bifurcations_that_the_motion_does_not_have(over_load: fc.ResponseCurve) -> None:
    """One that is put elsewhere is refuted; a curve of before is judged anew, with all that the
    orbits have."""
    first = over_load.bifurcations[0]
    middle = len(over_load) // 2
    wrong = replace(first, value=1.5, unknown=over_load.unknown(middle), exact=np.nan)
    plain = replace(over_load, bifurcations=(wrong,), multipliers=None, undecided=None)
    judged = fc.judge_curve(plain)
    assert [one.exact for one in judged.bifurcations] == pytest.approx(
        [one.exact for one in over_load.bifurcations], rel=1e-6
    )
    assert np.array_equal(judged.verdicts, over_load.verdicts)


@pytest.mark.parametrize("parameter", ["stiffness", "damping", "clearance"])
def test_points_are_those_of_varied_structures(parameter: str) -> None:
    """The multipliers of single solutions of what the parameter makes of structure and law."""
    ends = (0.0, -0.5) if parameter == "clearance" else (1.0, 3.0)
    law = fc.UnilateralPenalty(2.0)
    curve = fc.continue_parameter(
        oscillator(), 0.9, law, parameter, *ends, harmonics=9, stability=True
    )
    assert curve.undecided is not None and not np.any(curve.undecided)
    for index in (0, len(curve) // 2, len(curve) - 1):
        value = float(curve.values[index])
        structure, scaled = oscillator(), law
        if parameter == "stiffness":
            scaled = law.scaled(value)
        else:
            structure = structure.varied(**{parameter: value})
        alone = fc.solve_harmonic_balance(structure, 0.9, scaled, harmonics=9)
        found = fc.floquet(structure, alone)
        assert curve.verdicts[index] == found.verdict
        exact = 1e-6 if index in (0, len(curve) - 1) else 2e-2  # interpolated between orbits
        assert abs(curve.multipliers[index]) == pytest.approx(abs(found.multipliers[0]), rel=exact)


@pytest.mark.parametrize(("seed", "most_points"), [(74, 16), (65, 24), (1057, 100)])
def test_short_unstable_stretches_are_not_passed_over(seed: int, most_points: int) -> None:
    """Chains with 0.1 to 1 % of damping lose and find their stability within a few points, while
    the multipliers of one pair rise and fall: each verdict is that of the point's own orbit."""
    structure, law = random_chain(seed)
    first, second = fc.solve_modes(structure, 2).omega
    curve = fc.continue_frequency(
        structure, 0.8 * first, 1.25 * second, law, harmonics=15, stability=True,
        most_points=most_points, throw=False,
    )  # fmt: skip
    assert {"stable", "unstable"} <= {*curve.verdicts}
    for place in range(max(0, len(curve) - 24), len(curve)):
        solution = curve.solution(place, search=False)
        alone = fc.floquet(structure, solution).verdict
        assert "undecided" in {alone, curve.verdicts[place]} or alone == curve.verdicts[place]


def test_points_that_are_decided_alone_are_along_the_curve() -> None:
    """Of a chain with 1 % of damping whose curve turns back and forth: where the branch of orbits
    is lost next to its points most of them are still judged, none otherwise than by itself."""
    structure, law = random_chain(17)
    first, second = fc.solve_modes(structure, 2).omega
    curve = fc.continue_frequency(
        structure, 0.8 * first, 1.25 * second, law, harmonics=15, stability=True,
        most_points=60, throw=False,
    )  # fmt: skip
    solutions = [curve.solution(place, search=False) for place in range(0, len(curve), 3)]
    alone = [str(fc.floquet(one.structure, one).verdict) for one in solutions]
    pairs = list(zip(alone, curve.verdicts[::3].tolist(), strict=True))
    told = [one == other for one, other in pairs if one != "undecided"]
    assert len(told) >= 14 and sum(told) >= 0.7 * len(told)
    assert all("undecided" in pair or pair[0] == pair[1] for pair in pairs)


def test_points_that_decide_nothing_are_not_all_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a curve without orbits 64 points, from one end to the other; paths to more harmonics are
    followed until 16 have led to nothing: 302 points took a minute, most of it on paths."""
    law = fc.UnilateralPenalty(1.0)
    curve = fc.continue_frequency(
        oscillator(), 0.5, 1.5, law, harmonics=5, longest_step=0.01, most_points=400, throw=False
    )
    assert len(curve) > 300
    asked, followed = [], []

    def undecided(judge: Any, place: int, patience: Any) -> complex:
        asked.append(place)
        problem = curve.problem_of(place).with_harmonics(10)
        assert problem.next_to(curve.judged(place).wave, patience) is None
        return complex(np.nan)

    def lost(system: Any, start: np.ndarray) -> None:
        followed.append(start)

    monkeypatch.setattr("fenics_crack.balance.problem._nearly_solved", lambda *_: None)
    monkeypatch.setattr("fenics_crack.balance.problem._end_of_path", lost)
    monkeypatch.setattr("fenics_crack.curves.exact._Judge.by_itself", undecided)
    monkeypatch.setattr("fenics_crack.curves.exact._Judge._by_segments", lambda *_: None)
    assert fc.judge_curve(curve).undecided.all()
    assert len(asked) == 64 and max(np.diff(sorted([0, *asked, len(curve)]))) < 12
    assert len(followed) == 16
