"""Orbits of random plates against a flow that shares no code: benchmarks/reference_flow.py."""

import numpy as np
import pytest
from campaign_cases import draw

import fenics_crack as fc

SEED = 81


def differences(number: int) -> tuple[float, float] | None:
    """Of gaps over the period, relative to their range, and of the multipliers' moduli, between a
    plate's orbit and the reference's next to it; None where the plate has no orbit to go by.

    A plate with an edge crack as the campaign draws them: 8 to 60 pairs without mass, 10 to 40
    modes, rigid or a penalty, 0.05 to 1 % of damping.
    """
    case = draw(SEED, number, "solution", "plate")
    solution = fc.solve_harmonic_balance(
        case.structure, case.omega, case.law, harmonics=20, throw=False
    )
    orbit = solution.assessment.nearest_orbit if solution.converged else None
    if orbit is None:
        return None
    flow = case.flow(case.structure)
    shape, rate = np.split(orbit.state, 2) @ orbit.flow.modal_model.shapes.T
    reference_orbit = flow.orbit(flow.state(shape, rate), orbit.omega, orbit.period)
    gap = orbit.gap_at(
        np.arange(len(reference_orbit.gap)) * orbit.period / len(reference_orbit.gap)
    )
    moduli = (
        np.sort(np.abs(values)) for values in (orbit.multipliers, reference_orbit.multipliers)
    )
    return np.abs(gap - reference_orbit.gap).max() / np.ptp(reference_orbit.gap), np.abs(
        np.subtract(*moduli)
    ).max()


@pytest.mark.parametrize(
    "count", [pytest.param(2, id="two"), pytest.param(41, id="forty", marks=pytest.mark.nightly)]
)
def test_orbits_of_plates(count: int) -> None:
    """The same gap to 3e-11 and multipliers to 1e-9."""
    cases = [case for case in map(differences, range(count)) if case is not None]
    assert len(cases) >= count - 2  # with 20 harmonics numbers 7 and 16 have none
    gap, multipliers = np.max(cases, axis=0)
    assert gap < 3e-11
    assert multipliers < 1e-9
