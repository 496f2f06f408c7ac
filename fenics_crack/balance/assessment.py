"""Error and stability of a harmonic-balance solution with a given number of harmonics.

One step of Newton's method for the whole solution on the exact flow predicts what the harmonics
left out change (:func:`fenics_crack.motion.orbit.predict_orbit`); Newton's method finds the nearest
orbit from where that leads, or from the solution's state. A solution that was found from an orbit
has that one. The distance to the orbit is the error. It is the solution's
own where it is at most 0.1 away, of crack faces without mass 0.5, and three times the prediction:
then its multipliers are those of the motion. Where none is found next to such crack faces, it is
the own orbit of the solution with twice or four times the harmonics, up to the same distance.

Without an orbit the error is stated from the prediction p as 3 p / (1 + 2 p): three times a small
one, and never below p. Then the exact motion that begins with the solution is followed, and a small
disturbance of it: where that grows the motion is irregular
(:func:`fenics_crack.motion.attractors.find_irregular_motion`).
"""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property, partial

import numpy as np

from fenics_crack.balance.contact_system import Wave
from fenics_crack.balance.more_modes import (
    UNKNOWN,
    MoreModes,
    is_still,
    motion_at_load,
    reference_of,
)
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.basics.tables import percent
from fenics_crack.model.modal import is_small
from fenics_crack.motion.attractors import Attractor, find_irregular_motion
from fenics_crack.motion.flow import ContactFlow, flow_of
from fenics_crack.motion.orbit import (
    MAX_SEARCH_PERIODS,
    PeriodicOrbit,
    Prediction,
    find_orbit,
    is_affordable,
    is_too_slow,
    predict_orbit,
)
from fenics_crack.motion.search import wave_states
from fenics_crack.numerics.equations import COARSE_TOLERANCE
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.numerics.newton import relative_to_motion

MAX_ERROR = 0.1
"""Relative distance up to which the nearest orbit is accepted, and predicted error up to which it
is sought from where the step leads first. On 680 solutions of 170 systems 99 % of chains, 83 % of
plates and 79 % of stiff chains have a prediction within half to twice the distance."""
MAX_DISTANCE = 0.5
"""The same distance of crack faces without mass. Of ten such orbits between 0.1 and 0.5 away, and
not beyond three predictions, nine were those of many harmonics; all had the same verdict."""
REFINEMENTS = 2
"""Times that the harmonics are doubled to find an orbit."""


class Assessment:
    """Assessment of a harmonic-balance solution by the exact flow; each part is computed when it is
    first requested, from the solution alone.

    Parameters
    ----------
    wave : Wave
    own : PeriodicOrbit, optional
        The orbit whose Fourier coefficients it is.
    source : PeriodicOrbit, optional
        The orbit from whose coefficients it was found.
    more : MoreModes, optional
        The motion of ``own`` with more modes, where that has been sought.
    flow : ContactFlow, optional
        The exact flow, where it is at hand.
    refinements : int
        Times that the harmonics may be doubled to find an orbit.
    """

    def __init__(
        self,
        wave: Wave,
        own: PeriodicOrbit | None = None,
        source: PeriodicOrbit | None = None,
        *,
        more: MoreModes | None = None,
        flow: ContactFlow | None = None,
        refinements: int = REFINEMENTS,
    ) -> None:
        self.wave, self.own, self._source = wave, own, source
        self._more, self._flow, self._refinements = more, flow, refinements
        self._ended: list[str] = []

    def is_of(self, other: Wave) -> bool:
        """Return True if ``other`` is the assessed solution, for which this assessment holds."""
        pairs = [(getattr(self.wave, one.name), getattr(other, one.name)) for one in fields(Wave)]
        return all(
            mine is its or (isinstance(mine, int | float) and mine == its) for mine, its in pairs
        )

    @cached_property
    def flow(self) -> ContactFlow | None:
        """Exact flow of the structure; None where there is none."""
        if self.own is not None or self._flow is not None:
            return self._flow if self.own is None else self.own.flow
        if self.wave.contact is None or not self.wave.structure.n_pairs:
            return None
        return flow_of(self.wave.structure, self.wave.contact)

    @property
    def affordable(self) -> bool:
        """True if there is a flow on which a search for orbits does not take long."""
        flow, wave = self.flow, self.wave
        return flow is not None and is_affordable(flow, wave.omega, wave.subharmonic)

    @property
    def too_slow(self) -> bool:
        """True if the load is too slow for the time integration of exact motions of few modes."""
        flow, wave = self.flow, self.wave
        return flow is not None and is_too_slow(flow, wave.omega, wave.subharmonic)

    @cached_property
    def states(self) -> np.ndarray:
        """States of the solution at equal parts of its period: (32, 2 n_modes)."""
        assert self.flow is not None
        wave, flow = self.wave, self.flow
        found = wave_states(flow, wave.displacement_coefficients, wave.base_omega)
        if flow.friction:
            time = wave.period / len(found) * np.arange(len(found))
            found[:, 2 * flow.n_modes :] = wave.sticking_places(time)
        return found

    @cached_property
    def prediction(self) -> Prediction | None:
        """One step of Newton's method of the whole solution; None where its motion cannot be
        followed."""
        flow, wave = self.flow, self.wave
        return (
            None if flow is None else predict_orbit(flow, wave.omega, self.states, wave.subharmonic)
        )

    @property
    def predicted_error(self) -> float:
        """Predicted error of the gaps over the period, relative; infinite where it is not known."""
        return np.inf if self.prediction is None else self.prediction.error

    @property
    def orbit(self) -> PeriodicOrbit | None:
        """The nearest orbit: that from which the solution was found, or to which Newton's method
        leads; None where it leads to none."""
        return self._search[0]

    @property
    def accepted(self) -> bool:
        """True if the nearest orbit is accepted as the exact form of this solution."""
        return self._search[1]

    @cached_property
    def _search(self) -> tuple[PeriodicOrbit | None, bool]:
        """The nearest orbit, and True if it is accepted."""
        if self.own is not None:
            return self.own, True
        orbit = self._source or self._nearest_orbit()
        max_distance = MAX_DISTANCE if self.wave.structure.light_lips else MAX_ERROR
        if orbit is None and (refinement := self._refined_assessment()) and refinement.accepted:
            orbit = refinement.orbit
        elif self._source is None:  # predictions are within a factor of 3 of the distance
            max_distance = min(max_distance, max(3.0 * self.predicted_error, COARSE_TOLERANCE))
        return orbit, orbit is not None and distance(self.wave, orbit) <= max_distance

    def _nearest_orbit(self) -> PeriodicOrbit | None:
        """Search for an orbit by Newton's method."""
        if self.prediction is None or self.too_slow:
            return None
        assert self.flow is not None
        states = [self.states[0]]
        if self.predicted_error <= MAX_ERROR:
            states.insert(0, self.prediction.states[0])
        periods, inverse = self.wave.subharmonic, self.prediction.inverse
        search = partial(find_orbit, self.flow, self.wave.omega, failure_reasons=self._ended)
        orbits = (search(state, subharmonic=periods, inverse=inverse) for state in states)
        return next(filter(None, orbits), None)

    def _refined_assessment(self) -> Assessment | None:
        """Assess the solution with twice the harmonics; None where it is not sought or found."""
        flow, n_left = self.flow, self._refinements - 1
        if flow is None or n_left < 0 or not (flow.structure.light_lips and self.affordable):
            return None
        wave = with_twice_the_harmonics(self.wave)
        return None if wave is None else Assessment(wave, flow=flow, refinements=n_left)

    @cached_property
    def irregular_motion(self) -> Attractor | None:
        """The exact motion that begins with the solution, where that is irregular and no orbit is
        found; else None."""
        if self.orbit is not None or self.prediction is None or not self.affordable:
            return None
        assert self.flow is not None
        return find_irregular_motion(
            self.flow, self.wave.omega, self.states[0], self.wave.subharmonic
        )

    @cached_property
    def distance(self) -> float:
        """Distance of the solution's gaps from the orbit's over the period, relative to the moving
        part of B^T u; nan without an orbit."""
        return np.nan if self.orbit is None else distance(self.wave, self.orbit)

    def errors(self, *, search: bool = True) -> tuple[float, float]:
        """Return the relative errors of the gap, and of the displacement at the load in the
        direction of each of its parts: without ``search`` the predicted ones.

        With it they are the distances to the nearest orbit, or :func:`stated_error` of the
        predicted ones where there is none. At most :data:`UNKNOWN`.
        """
        wave = self.wave
        if self.own is not None or (search and self.orbit is not None):
            assert self.orbit is not None
            samples = self.orbit.sampled
            change = samples.displacement - wave.coordinates(samples.time)
            found = self.distance, _at_load(wave, change, samples.displacement)
        elif (step := self.prediction) is None:
            found = UNKNOWN, UNKNOWN
        else:
            assert self.flow is not None
            change = (step.states - self.states)[:, : self.flow.n_modes] @ self.flow.modes.shapes.T
            time = np.arange(len(change)) * wave.period / len(change)
            found = step.error, _at_load(wave, change, wave.coordinates(time))
            found = (stated_error(found[0]), stated_error(found[1])) if search else found
        return min(found[0], UNKNOWN), min(found[1], UNKNOWN)

    @cached_property
    def more_modes(self) -> MoreModes | None:
        """The nearest orbit with more modes; None where no flow with these is at hand, or would
        take long, or no orbit is found, accepted or not."""
        if self._more is not None:
            return self._more
        wave, reference = self.wave, reference_of(self.wave)
        if self.flow is None or reference is None or not is_small(reference):
            return None
        assert wave.contact is not None
        flow = flow_of(reference, wave.contact)
        known = flow is not None and is_affordable(
            flow, wave.omega, wave.subharmonic, MAX_SEARCH_PERIODS
        )
        if flow is None or not known or self.orbit is None:
            return None
        return MoreModes(flow, wave, self.orbit)

    @property
    def reason(self) -> str:
        """Reason why no orbit is accepted for the solution; "" where one is."""
        if self.accepted:
            return ""
        if self.too_slow:
            assert self.flow is not None
            turns = self.flow.max_rate * self.wave.period / (2.0 * np.pi)
            many = f"{turns / 1e3:.0f} thousand cycles in a period"
            slow = f"the load is so slow that the highest modes have {many}"
            return f"{slow}, too many for exact time integration; keep fewer modes"
        if self.flow is None:
            return "there is no exact flow for its law or structure"
        if self.prediction is None:
            return "the crack opens and closes too often; less so with crack faces without mass"
        expected = self.predicted_error
        size = percent(expected) if expected < UNKNOWN else "100 % or more"
        if self.orbit is None:
            changed = f"the truncated harmonics change it by {size}"
            ended = self._ended[-1:] or ["no exact orbit was found near it"]
            return f"{changed}, and {ended[0]}"
        own = "stable" if self.orbit.is_stable else "unstable"
        away = f"the nearest exact orbit, which is {own}, is {percent(self.distance)} away"
        return f"{away} where {size} was predicted: it may be another motion"


def stated_error(prediction: float) -> float:
    """Return the error stated from a prediction that no orbit confirms: 3 p / (1 + 2 p)."""
    return 3.0 * prediction / (1.0 + 2.0 * min(prediction, 1.0))


def with_twice_the_harmonics(wave: Wave) -> Wave | None:
    """Solve with twice the harmonics, from a solution; None where that is not found."""
    assert wave.contact is not None
    problem = Problem(
        wave.structure, wave.omega, wave.contact, 2 * wave.harmonics,
        subharmonic=wave.subharmonic, static_above=wave.static_above,
    )  # fmt: skip
    system = problem.system(problem.compliance())
    search = Search(system, problem, COARSE_TOLERANCE, 1.0)
    point = search.solve(resize_harmonics(wave.slow_gap_coefficients, problem.harmonics))
    return problem.wave(system.linearise(point.unknown)) if search.converged else None


def _at_load(wave: Wave, change: np.ndarray, motion: np.ndarray) -> float:
    """Return the size of a change of the displacement at the load relative to that of a motion."""
    return relative_to_motion(*(motion_at_load(wave.structure, one) for one in (change, motion)))


def distance(wave: Wave, orbit: PeriodicOrbit) -> float:
    """Return the distance of a solution's gaps from an orbit's over the period, relative to the
    moving part of B^T u; 0 where that is rounding."""
    samples = orbit.sampled
    if is_still(samples):
        return 0.0
    moved = samples.gaps + wave.row_structure.clearance
    return relative_to_motion(samples.gaps - wave.over_period(len(moved))[1], moved)
