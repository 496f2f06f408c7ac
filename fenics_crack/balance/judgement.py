"""What the exact flow says of a wave: the orbit next to it, and how far away that is.

An orbit is the wave's own where it is no farther away than three times what one step of Newton's
method predicts (:mod:`fenics_crack.motion.orbit`), and this step is short: then the distance is
the error, and the orbit's multipliers are the motion's. On 510 waves of 128 plates this was so for
every one with its own orbit, and for none of 26 next to another one.
"""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property

import numpy as np

from fenics_crack.balance.nearby import orbit_next_to, predicted, wave_states
from fenics_crack.balance.wave import Wave
from fenics_crack.motion.flow import ContactFlow, Samples, flow_of
from fenics_crack.motion.orbit import PeriodicOrbit, Prediction

__all__ = ["AFFORDABLE", "BELIEVED", "FARTHEST", "STILL", "UNKNOWN", "Judgement", "relative"]

BELIEVED, FARTHEST, FAR = 3.0, 0.1, 0.3
"""Times the error predicted, beyond which an orbit is another one; the distance beyond which it
judges nothing; and the prediction from which on none is sought: the harmonics do not do."""
UNKNOWN = 1.0
"""An error that is not known."""
AFFORDABLE = 240
"""Numbers of a state up to which the derivatives along a wave are no matter: 0.5 s."""
CLOSE = 1e-7
"""Distance that may come from how closely waves and orbits are solved for."""
STILL = 1e-11
"""Motion of lips that is rounding, relative to the motion of the modes there."""


class Judgement:
    """The exact flow's judgement of a wave, each part found when it is first asked for.

    Attributes
    ----------
    wave : Wave
    of_orbit : bool
        Whether the wave was taken from its orbit.
    """

    def __init__(self, wave: Wave, orbit: PeriodicOrbit | None = None) -> None:
        """With the orbit that a wave was taken from, if it was."""
        self.wave, self.of_orbit = wave, orbit is not None
        if orbit is not None:
            vars(self).update(orbit=orbit, flow=orbit.flow)

    def is_of(self, other: Wave) -> bool:
        """Whether another wave is the same one, so that this is its judgement."""
        pairs = [(getattr(self.wave, one.name), getattr(other, one.name)) for one in fields(Wave)]
        return all(
            mine is its or (isinstance(mine, int | float) and mine == its) for mine, its in pairs
        )

    @cached_property
    def flow(self) -> ContactFlow | None:
        """Of the structure; None where none is known."""
        wave = self.wave
        if wave.contact is None or not wave.structure.n_pairs:
            return None
        return flow_of(wave.structure, wave.contact)

    @cached_property
    def predicted(self) -> Prediction | None:
        """One step of Newton's method of the whole wave; None where its motion is not followed."""
        wave = self.wave
        assert self.flow is not None
        return predicted(self.flow, wave.omega, self.states, wave.subharmonic)

    @property
    def prediction(self) -> float:
        """The error predicted; infinite where it is not known."""
        return np.inf if self.predicted is None else self.predicted.error

    @cached_property
    def orbit(self) -> PeriodicOrbit | None:
        """The orbit that the step leads to; None where there is none, or the step is long."""
        if self.predicted is None or not self.prediction < FAR:
            return None
        assert self.flow is not None
        omega, periods = self.wave.omega, self.wave.subharmonic
        return orbit_next_to(self.flow, omega, self.states[0], periods)

    @cached_property
    def states(self) -> np.ndarray:
        """Of the wave at equal parts of its period: (32, 2 n_modes)."""
        assert self.flow is not None
        displacement = self.wave.displacement_coefficients
        return wave_states(self.flow, displacement, self.wave.base_omega)

    @cached_property
    def distance(self) -> float:
        """Of the gaps of the wave and the orbit over the period, relative to B^T u; nan without an
        orbit."""
        if self._samples is None:
            return np.nan
        samples, wave = self._samples, self.wave
        if self.still:
            return 0.0
        moved = samples.gap + wave.structure.clearance
        return relative(samples.gap - wave.gap(samples.time), moved)

    @cached_property
    def still(self) -> bool:
        """Whether the orbit's lips, which the load presses together, move by rounding only."""
        if self._samples is None:
            return False
        samples, flow = self._samples, self._samples.flow
        slow = samples.states[:, : flow.size // 2] @ flow.modes.pairs
        moved = samples.gap + self.wave.structure.clearance
        return bool(np.linalg.norm(moved) <= STILL * np.linalg.norm(slow))

    @property
    def accepted(self) -> bool:
        """Whether the orbit is the wave's own."""
        return self.of_orbit or self.admits(self.distance)

    def admits(self, distance: float) -> bool:
        """Whether an orbit so far away is the wave's own."""
        return distance <= max(min(BELIEVED * self.prediction, FARTHEST), CLOSE)

    @property
    def affordable(self) -> bool:
        """Whether there is a flow whose derivatives do not take long: an error report is asked for
        each solution."""
        return self.flow is not None and self.flow.size <= AFFORDABLE

    def errors(self, *, search: bool = True) -> tuple[float, float]:
        """Of the gap, and of the displacement at the load in the direction of each of its parts:
        the distance to the wave's own orbit; what is predicted where none is looked for; else
        :data:`UNKNOWN`, which is also the most. A search that fails contradicts the one step that
        predicts: next to grazing the orbit may be 15 times as far away."""
        if search and (self.of_orbit or self.distance <= max(BELIEVED * self.prediction, CLOSE)):
            return self.distance, self._away_at_load
        if self.prediction < UNKNOWN and not (search and self.prediction < FAR):
            return self.prediction, min(self._predicted_at_load, UNKNOWN)
        return UNKNOWN, UNKNOWN

    @property
    def _predicted_at_load(self) -> float:
        assert self.flow is not None and self.predicted is not None
        wave, flow, count = self.wave, self.flow, self.flow.size // 2
        change = (self.predicted.states - self.states)[:, :count] @ flow.modes.shapes.T
        time = np.arange(len(change)) * wave.period / len(change)
        force = wave.structure.force.T
        return relative(change @ force, wave.coordinates(time) @ force)

    @property
    def _away_at_load(self) -> float:
        assert self._samples is not None
        moved, force = self._samples.displacement, self.wave.structure.force.T
        change = moved - self.wave.coordinates(self._samples.time)
        return relative(change @ force, moved @ force)

    @cached_property
    def _samples(self) -> Samples | None:
        """Of the orbit over the period."""
        return None if self.orbit is None else self.orbit.sampled

    @property
    def reason(self) -> str:
        """Why no orbit is accepted; "" where one is."""
        if self.accepted:
            return ""
        if self.predicted is None:
            return "its pairs open and close too often to be followed; lips without mass do less so"
        if self.orbit is None and self.prediction < FAR:
            return "no exact orbit was found next to it; with more harmonics one may be"
        if self.orbit is None:
            return f"the harmonics left out change it by {self.prediction:.0%}; take more"
        if self.distance <= BELIEVED * self.prediction:
            return f"its exact orbit is {self.distance:.1%} away; take more harmonics"
        return (
            f"the exact orbit next to it is another one, {self.distance:.1%} away where "
            f"{self.prediction:.1%} were predicted; more harmonics tell these apart"
        )


def relative(change: np.ndarray, whole: np.ndarray) -> float:
    """Size of a change relative to that of the whole."""
    size = float(np.linalg.norm(whole))
    return float(np.linalg.norm(change)) / size if size > 0.0 else 0.0
