"""Contact laws."""

import numpy as np
import pytest

from fenics_crack import InputError, SmoothedPenalty, UnilateralPenalty, contact_law
from fenics_crack.scene import Contact

GAPS = np.linspace(-2.0, 2.0, 81)[:, None] + 0.003


def test_penalty_acts_in_penetration_only() -> None:
    """Eq. 11: k (g + |g|) / 2."""
    law = UnilateralPenalty(3.0)
    assert np.allclose(law.force(GAPS), 3.0 * (GAPS + np.abs(GAPS)) / 2.0)
    assert np.array_equal(law.tangent(GAPS), np.where(GAPS > 0.0, 3.0, 0.0))


@pytest.mark.parametrize("law", [UnilateralPenalty(3.0), SmoothedPenalty(3.0, 4.0)])
def test_tangent_is_the_derivative(law: UnilateralPenalty | SmoothedPenalty) -> None:
    """Central differences away from the kink."""
    step = 1e-6
    slope = (law.force(GAPS + step) - law.force(GAPS - step)) / (2.0 * step)
    assert np.allclose(slope, law.tangent(GAPS), rtol=1e-6, atol=1e-6)


def test_smoothed_law_tends_to_the_penalty_law_like_one_over_s() -> None:
    """The largest difference is k / (pi s), on both sides: the pull on an open crack."""
    sharp = np.array([10.0, 100.0, 1000.0])
    differences = []
    for s in sharp:
        smooth, penalty = SmoothedPenalty(3.0, s), UnilateralPenalty(3.0)
        far = np.array([[-50.0], [50.0]])
        lag = penalty.force(far) - smooth.force(far)
        assert np.allclose(lag, 3.0 / (np.pi * s), rtol=1e-3)
        differences.append(np.abs(penalty.force(GAPS) - smooth.force(GAPS)).max())
    slope = np.polyfit(np.log(sharp), np.log(differences), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.05)
    assert np.all(SmoothedPenalty(3.0, 1e3).tangent(GAPS) <= 3.0)


def test_stiffness_may_differ_from_pair_to_pair() -> None:
    """One stiffness per pair is broadcast over the instants."""
    law = UnilateralPenalty(np.array([1.0, 10.0])).scaled(2.0)
    assert np.array_equal(
        law.force(np.array([[1.0, 1.0], [-1.0, 2.0]])), [[2.0, 20.0], [0.0, 40.0]]
    )


@pytest.mark.parametrize("stiffness", [0.0, -1.0, np.nan, np.inf, "soft", [1.0, -2.0], [[1.0]]])
def test_bad_stiffness_is_named(stiffness: object) -> None:
    """One error with key and value."""
    with pytest.raises(InputError, match="contact stiffness"):
        UnilateralPenalty(stiffness)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="contact stiffness"):
        SmoothedPenalty(stiffness, 1.0)  # type: ignore[arg-type]


def test_scene_names_its_law() -> None:
    """The contact table becomes the law it names."""
    assert contact_law(Contact(1e9)) == UnilateralPenalty(1e9)
    smoothed = Contact(1e9, law="smoothed", sharpness=1e8)
    assert contact_law(smoothed) == SmoothedPenalty(1e9, 1e8)
