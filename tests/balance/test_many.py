"""Exact orbits of many cases in one call: those of single solutions, each with what is said of
it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import catch_error, chain, chain_stiffness, oscillator

import fenics_crack as fc
from fenics_crack.balance.harmonic_balance import (
    search_orbit_by_harmonic_balance,
    truncated_orbit_solution,
)

RIGID = fc.UnilateralConstraint()


def drawn(omega: float, count: int, clearance: float = 0.0) -> dict[str, np.ndarray]:
    """Random cases about a frequency."""
    draw = np.random.default_rng(3)
    return {
        "omega": omega * draw.uniform(0.9, 1.1, count),
        "load": draw.uniform(0.5, 4.0, count),
        "damping": draw.uniform(0.8, 2.0, count),
        "clearance": clearance * draw.uniform(0.0, 1.0, count),
    }


def solved(structure: fc.Structure, law: Any, cases: dict[str, np.ndarray]) -> fc.ManyOrbits:
    """All at once."""
    rest = {name: values for name, values in cases.items() if name != "omega"}
    return fc.solve_many(structure, cases["omega"], law, **rest)


def check_single(cases: fc.ManyOrbits, share: float) -> None:
    """Each is a single solution's orbit, at least a share of them the one that is found alone; with
    its numbers."""
    n_same = 0
    for case in range(len(cases.omega)):
        problem, case_orbit = cases.problem(case), cases.orbit(case)
        assert case_orbit.residual < 1e-8
        single = fc.solve_harmonic_balance(
            problem.structure, problem.omega, problem.contact, tolerance=0.05, throw=False
        )
        if cases.verdict[case] == "unstable":
            assert not single.orbit.is_stable  # else that one would have been returned
        if np.abs(single.orbit.gap - case_orbit.gap).max() > 1e-9 * np.abs(case_orbit.gap).max():
            continue
        n_same += 1
        assert cases.multiplier[case] == pytest.approx(abs(single.orbit.multipliers[0]), rel=1e-6)
        indicators = single.orbit.indicators()
        for name in ("amplitude", "opening", "closed_share"):
            value = getattr(cases, name)[case]
            assert value == pytest.approx(getattr(indicators, name), rel=1e-4), name
        coefficients = case_orbit.coefficients(cases.harmonics)
        error = truncated_orbit_solution(
            problem, case_orbit, coefficients
        ).assessment.relative_orbit_distance
        assert cases.truncation[case] == pytest.approx(error, rel=0.02, abs=1e-6)
    assert n_same >= share * len(cases.omega)


@pytest.mark.nightly
def test_plate(has_massless_crack_faces: fc.Structure) -> None:
    """Rigid contact of crack faces without mass: neighbours lead to nearly all."""
    omega = float(fc.bilinear_frequencies(has_massless_crack_faces).omega_bilinear[0])
    cases = solved(has_massless_crack_faces, RIGID, drawn(omega, 40))
    assert np.mean(cases.status == "neighbour") > 0.8
    check_single(cases, 0.95)


def test_chain() -> None:
    """Faces with mass on springs, whose clearances and mean load are not multiplied alike."""
    check_single(solved(chain(), fc.UnilateralPenalty(5.0), drawn(0.6, 30, 0.1)), 0.9)


def test_friction() -> None:
    """Where pairs stick is part of the state."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.eye(2), gap=[0.0, 1.0], tangential=[1.0, 0.0],
        force_cos=[1.0, 0.0], force_mean=[0.0, 0.6], damping=fc.ModalDamping(0.02),
    )  # fmt: skip
    law = fc.CoulombFriction(fc.UnilateralPenalty(1.0), 1.0, 0.5)
    check_single(solved(structure, law, drawn(0.9, 20)), 0.9)


def test_proportional_loads() -> None:
    """Without a clearance the orbit grows with the load; a reversed one is another motion."""
    cases = fc.solve_many(oscillator(), 0.7, fc.UnilateralPenalty(3.0), load=[1.0, 3.0, -2.0, 0.0])
    assert cases.amplitude[1] == pytest.approx(3.0 * cases.amplitude[0], rel=1e-9)
    assert cases.amplitude[2] == pytest.approx(
        2.0 * cases.amplitude[0], rel=1e-4
    )  # half a period on
    assert cases.amplitude[3] == 0.0
    assert cases.verdict.tolist() == ["stable"] * 4


def test_bad_cases_stop_no_other() -> None:
    """They are listed with the reason."""
    nan = float("nan")
    cases = fc.solve_many(
        oscillator(), [0.7, nan, 0.7, 0.7, -1.0, 1e-9], fc.UnilateralPenalty(3.0),
        load=[1.0, 1.0, nan, 1.0, 1.0, 1.0], damping=[1.0, 1.0, 1.0, -1.0, 1.0, 1.0],
    )  # fmt: skip
    assert cases.status.tolist() == ["alone", *["refused"] * 4, "lost"]
    for case, word in enumerate(("omega", "load", "damping", "omega", "raise omega"), 1):
        assert word in cases.reason[case]
        assert np.isnan(cases.amplitude[case]) and not cases.verdict[case]
    catch_error(lambda: cases.orbit(5), names="raise omega", kind=fc.ConvergenceError)
    assert len(cases.to_dict()["amplitude"]) == 6
    assert "5 without an orbit" in repr(cases)


def test_cases_out_of_reach_say_why() -> None:
    """A frequency too high to square is refused; contact may be too stiff for a face with mass."""
    cases = fc.solve_many(oscillator(), [0.7, 1e300], fc.UnilateralPenalty(3.0))
    assert cases.status.tolist() == ["alone", "refused"] and "omega = 1e+300" in cases.reason[1]
    stiff = fc.solve_many(oscillator(), [0.7], fc.UnilateralPenalty(1e12))
    assert stiff.status[0] == "lost" and "make the contact softer" in stiff.reason[0]


ARRAYS = "omega, load, damping, clearance"


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"omega": [[1.0]]}, ARRAYS), ({"omega": 1.0}, ARRAYS), ({"omega": []}, ARRAYS),
        ({"load": [1.0, 2.0, 3.0]}, ARRAYS), ({"harmonics": 0}, "harmonics"),
        ({"contact": fc.SmoothedPenalty(1.0, 1.0)}, "contact"),
        ({"structure": fc.Structure.from_matrices([[1.0]], [[1.0]], gap=None)}, "structure"),
    ],
)  # fmt: skip
def test_bad_arguments(change: dict[str, Any], key: str) -> None:
    """What concerns all cases is refused before any is solved."""
    arguments: dict[str, Any] = {"structure": oscillator(), "omega": [0.7, 0.8]}
    arguments |= {"contact": fc.UnilateralPenalty(3.0)} | change
    catch_error(lambda: fc.solve_many(**arguments), key)


def test_undamped_cases_take_their_neighbours_orbits(monkeypatch: pytest.MonkeyPatch) -> None:
    """No orbit is stable without damping: one whose multipliers are 1 is not sought again."""
    stiffness = chain_stiffness(np.array([0.0, 1.0, 1.0]))
    masses = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=[1.0, 0.0], force_cos=[0.0, 0.1], clearance=1.0
    )
    searches: list[float] = []

    def search(problem: Any) -> Any:
        searches.append(problem.omega)
        return search_orbit_by_harmonic_balance(problem)

    monkeypatch.setattr("fenics_crack.balance.many.search_orbit_by_harmonic_balance", search)
    cases = fc.solve_many(masses, np.linspace(0.3, 2.0, 40), fc.UnilateralPenalty(10.0))
    assert np.all(cases.verdict != "") and len(searches) <= 10
    assert np.sum(cases.status == "neighbour") >= 30
