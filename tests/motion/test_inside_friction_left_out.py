"""What friction could do where it is left out."""

import numpy as np
import pytest

import fenics_crack as fc
from fenics_crack.motion.flow import ContactFlow
from fenics_crack.motion.orbit import find_orbit

RIGID = fc.UnilateralConstraint()


@pytest.mark.parametrize(
    ("name", "modes", "ratio", "omega", "low", "high"),
    [
        ("inclined_crack", 10, 0.005, 22368.14, 3.6, 6.5),
        ("breathing_plate", 10, 0.01, 2000.0, 6.6, 9.6),
        ("blade", 20, 0.001, 4875.75, 0.005, 0.02),
    ],
)
def test_what_friction_could_do(
    name: str, modes: int, ratio: float, omega: float, low: float, high: float
) -> None:
    """Much for plates whose crack slides, nothing for the blade."""
    whole = fc.build_structure(fc.Scene.load(f"demos/{name}.toml"))
    if name != "blade":
        whole = whole.damped(fc.ModalDamping(ratio, modes))
    reduced = fc.reduce_structure(whole, modes=modes, method="massless", reference=False)
    flow = ContactFlow(reduced, RIGID)
    state = np.zeros(flow.size)
    for _ in range(40):
        state = flow.advance(state, omega, 2.0 * np.pi / omega).state
    orbit = find_orbit(flow, omega, state)
    assert orbit is not None
    assert low < orbit.friction_cap < high


def test_last_line_says_what_friction_could_do() -> None:
    """For a crack that slides; of the blade nothing."""
    inclined, blade = (
        str(fc.solve(fc.Scene.load(f"demos/{name}.toml"))) for name in ("inclined_crack", "blade")
    )
    assert "friction left out: up to about 100 %" in inclined
    assert "friction" not in blade
