"""Error and stability of a harmonic-balance solution with a given number of harmonics.

One step of Newton's method for the whole solution on the exact flow predicts the effect of the
truncated harmonics (:func:`fenics_crack.motion.orbit.predict_orbit`). From there, or from the
solution's state, Newton's method finds the nearest orbit. A solution found from an orbit has that
orbit.

The distance to the orbit is the error. The orbit is accepted up to a distance of 0.1 (0.5 if crack
faces have no mass) and of three times the prediction. Its multipliers are then those of the motion.
If no orbit is found next to crack faces without mass, the solution with twice or four times the
harmonics is assessed, up to the same distance.

Without an orbit the error is stated from the prediction p as 3 p / (1 + 2 p): three times a small
prediction, and never below p. Then the exact motion that begins with the solution is followed, and
a small disturbance with it. If the disturbance grows, the motion is irregular
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
from fenics_crack.basics.tables import format_percent
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
"""Relative distance up to which the nearest orbit is accepted.

Up to this predicted error, the search begins at the predicted state first. Measured on 680
solutions of 170 systems: 99 % of chains, 83 % of plates and 79 % of stiff chains have a prediction
within half to twice the distance.
"""
MAX_DISTANCE = 0.5
"""Relative distance up to which an orbit is accepted for crack faces without mass.

Of ten such orbits between 0.1 and 0.5 away, and within three predictions, nine belonged to the
solution with many harmonics. All had the same verdict.
"""
REFINEMENTS = 2
"""Number of times that the harmonics are doubled to find an orbit."""


class Assessment:
    """Assessment of a harmonic-balance solution by the exact flow.

    Each part is computed on first request, from the solution alone.

    Parameters
    ----------
    wave : Wave
    exact_orbit : PeriodicOrbit, optional
        Orbit whose Fourier coefficients the solution has.
    source : PeriodicOrbit, optional
        Orbit from whose coefficients the solution was found.
    more_modes : MoreModes, optional
        Motion of ``exact_orbit`` with more modes, if known.
    flow : ContactFlow, optional
        Exact flow, if known.
    refinements : int
        Number of times that the harmonics may be doubled to find an orbit.
    """

    def __init__(
        self,
        wave: Wave,
        exact_orbit: PeriodicOrbit | None = None,
        source: PeriodicOrbit | None = None,
        *,
        more_modes: MoreModes | None = None,
        flow: ContactFlow | None = None,
        refinements: int = REFINEMENTS,
    ) -> None:
        self.wave, self.exact_orbit, self._source = wave, exact_orbit, source
        self._more_modes, self._flow, self._refinements = more_modes, flow, refinements
        self._failure_reasons: list[str] = []

    def is_of(self, wave: Wave) -> bool:
        """Return True if this assessment holds for a solution."""
        attribute_pairs = [
            (getattr(self.wave, attribute.name), getattr(wave, attribute.name))
            for attribute in fields(Wave)
        ]
        return all(
            own_attribute is other_attribute
            or (isinstance(own_attribute, int | float) and own_attribute == other_attribute)
            for own_attribute, other_attribute in attribute_pairs
        )

    @cached_property
    def flow(self) -> ContactFlow | None:
        """Return the exact flow of the structure, or None."""
        if self.exact_orbit is not None or self._flow is not None:
            return self._flow if self.exact_orbit is None else self.exact_orbit.flow
        if self.wave.contact is None or not self.wave.structure.n_pairs:
            return None
        return flow_of(self.wave.structure, self.wave.contact)

    @property
    def affordable(self) -> bool:
        """True if there is a flow, and a search for orbits does not take long."""
        flow, wave = self.flow, self.wave
        return flow is not None and is_affordable(flow, wave.omega, wave.subharmonic)

    @property
    def too_slow(self) -> bool:
        """True if the load is too slow for time integration of exact motions with few modes."""
        flow, wave = self.flow, self.wave
        return flow is not None and is_too_slow(flow, wave.omega, wave.subharmonic)

    @cached_property
    def states(self) -> np.ndarray:
        """Return states of the solution at equal parts of its period: (32, 2 n_modes)."""
        assert self.flow is not None
        wave, flow = self.wave, self.flow
        states = wave_states(flow, wave.displacement_coefficients, wave.base_omega)
        if flow.friction:
            time = wave.period / len(states) * np.arange(len(states))
            states[:, 2 * flow.n_modes :] = wave.sticking_places(time)
        return states

    @cached_property
    def prediction(self) -> Prediction | None:
        """Return one step of Newton's method for the whole solution.

        It is None if the motion cannot be followed.
        """
        flow, wave = self.flow, self.wave
        return (
            None if flow is None else predict_orbit(flow, wave.omega, self.states, wave.subharmonic)
        )

    @property
    def predicted_error(self) -> float:
        """Return the predicted relative error of the gaps over the period; inf if unknown."""
        return np.inf if self.prediction is None else self.prediction.gap_error

    @property
    def orbit(self) -> PeriodicOrbit | None:
        """Return the nearest orbit, or None.

        It is the orbit from which the solution was found, or the end of Newton's method.
        """
        return self._orbit_and_acceptance[0]

    @property
    def is_accepted(self) -> bool:
        """True if the nearest orbit is accepted as the exact form of this solution."""
        return self._orbit_and_acceptance[1]

    @cached_property
    def _orbit_and_acceptance(self) -> tuple[PeriodicOrbit | None, bool]:
        """Return the nearest orbit, and True if it is accepted as the solution's exact form."""
        if self.exact_orbit is not None:
            return self.exact_orbit, True
        orbit = self._source or self._nearest_orbit()
        max_distance = MAX_DISTANCE if self.wave.structure.light_lips else MAX_ERROR
        if orbit is None and (refinement := self._refined_assessment()) and refinement.is_accepted:
            orbit = refinement.orbit
        elif self._source is None:  # predictions are within a factor of 3 of the distance
            max_distance = min(max_distance, max(3.0 * self.predicted_error, COARSE_TOLERANCE))
        return orbit, orbit is not None and distance(self.wave, orbit) <= max_distance

    def _nearest_orbit(self) -> PeriodicOrbit | None:
        """Search for an orbit by Newton's method from the solution; None without success."""
        if self.prediction is None or self.too_slow:
            return None
        assert self.flow is not None
        states = [self.states[0]]
        if self.predicted_error <= MAX_ERROR:
            states.insert(0, self.prediction.states[0])
        periods, inverse = self.wave.subharmonic, self.prediction.inverse
        search = partial(
            find_orbit, self.flow, self.wave.omega, failure_reasons=self._failure_reasons
        )
        orbits = (search(state, subharmonic=periods, inverse=inverse) for state in states)
        return next(filter(None, orbits), None)

    def _refined_assessment(self) -> Assessment | None:
        """Return the assessment of the solution with twice the harmonics, or None."""
        flow, n_left = self.flow, self._refinements - 1
        if flow is None or n_left < 0 or not (flow.structure.light_lips and self.affordable):
            return None
        wave = with_twice_the_harmonics(self.wave)
        return None if wave is None else Assessment(wave, flow=flow, refinements=n_left)

    @cached_property
    def irregular_motion(self) -> Attractor | None:
        """Return the exact motion that begins with the solution, if it is irregular.

        It is None for a regular motion, and if an orbit is found.
        """
        if self.orbit is not None or self.prediction is None or not self.affordable:
            return None
        assert self.flow is not None
        return find_irregular_motion(
            self.flow, self.wave.omega, self.states[0], self.wave.subharmonic
        )

    @cached_property
    def distance(self) -> float:
        """Return the distance between the solution's gaps and the orbit's over the period.

        It is relative to the moving part of B^T u; nan without an orbit.
        """
        return np.nan if self.orbit is None else distance(self.wave, self.orbit)

    def errors(self, *, search: bool = True) -> tuple[float, float]:
        """Return relative errors of the gap, and of the displacement at the load.

        With ``search`` they are the distances to the nearest orbit. Without an orbit they are
        :func:`stated_error` of the predictions. Without ``search`` they are the predictions. At
        most :data:`UNKNOWN`.
        """
        wave = self.wave
        if self.exact_orbit is not None or (search and self.orbit is not None):
            assert self.orbit is not None
            samples = self.orbit.sampled
            change = samples.displacement - wave.coordinates(samples.time)
            errors = self.distance, _change_at_load(wave, change, samples.displacement)
        elif (step := self.prediction) is None:
            errors = UNKNOWN, UNKNOWN
        else:
            assert self.flow is not None
            change = (step.states - self.states)[:, : self.flow.n_modes] @ self.flow.modes.shapes.T
            time = np.arange(len(change)) * wave.period / len(change)
            errors = step.gap_error, _change_at_load(wave, change, wave.coordinates(time))
            errors = (stated_error(errors[0]), stated_error(errors[1])) if search else errors
        return min(errors[0], UNKNOWN), min(errors[1], UNKNOWN)

    @cached_property
    def more_modes(self) -> MoreModes | None:
        """Return the nearest orbit's motion with more modes, or None.

        The orbit need not be accepted. None: no orbit is found, no flow with more modes is known,
        or it would take long.
        """
        if self._more_modes is not None:
            return self._more_modes
        wave, reference = self.wave, reference_of(self.wave)
        if self.flow is None or reference is None or not is_small(reference):
            return None
        assert wave.contact is not None
        flow = flow_of(reference, wave.contact)
        is_searchable = flow is not None and is_affordable(
            flow, wave.omega, wave.subharmonic, MAX_SEARCH_PERIODS
        )
        if flow is None or not is_searchable or self.orbit is None:
            return None
        return MoreModes(flow, wave, self.orbit)

    @property
    def reason(self) -> str:
        """Return why no orbit is accepted for the solution; "" if one is."""
        if self.is_accepted:
            return ""
        if self.too_slow:
            assert self.flow is not None
            n_cycles = self.flow.max_rate * self.wave.period / (2.0 * np.pi)
            cycles = f"{n_cycles / 1e3:.0f} thousand cycles in a period"
            cause = f"the load is so slow that the highest modes have {cycles}"
            return f"{cause}, too many for exact time integration; keep fewer modes"
        if self.flow is None:
            return "there is no exact flow for its law or structure"
        if self.prediction is None:
            return "the crack opens and closes too often; less so with crack faces without mass"
        predicted_error = self.predicted_error
        size = format_percent(predicted_error) if predicted_error < UNKNOWN else "100 % or more"
        if self.orbit is None:
            change = f"the truncated harmonics change it by {size}"
            failure_reasons = self._failure_reasons[-1:] or ["no exact orbit was found near it"]
            return f"{change}, and {failure_reasons[0]}"
        stability = "stable" if self.orbit.is_stable else "unstable"
        distance = format_percent(self.distance)
        orbit_in_words = f"the nearest exact orbit, which is {stability}, is {distance} away"
        return f"{orbit_in_words} where {size} was predicted: it may be another motion"


def stated_error(prediction: float) -> float:
    """Return the error stated for a prediction without an orbit, 3 p / (1 + 2 p)."""
    return 3.0 * prediction / (1.0 + 2.0 * min(prediction, 1.0))


def with_twice_the_harmonics(wave: Wave) -> Wave | None:
    """Solve with twice the harmonics, beginning at a solution; None if it fails."""
    assert wave.contact is not None
    problem = Problem(
        wave.structure, wave.omega, wave.contact, 2 * wave.harmonics,
        subharmonic=wave.subharmonic, static_above=wave.static_above,
    )  # fmt: skip
    system = problem.system(problem.compliance())
    search = Search(system, problem, COARSE_TOLERANCE, 1.0)
    point = search.solve(resize_harmonics(wave.slow_gap_coefficients, problem.harmonics))
    return problem.wave(system.linearise(point.unknown)) if search.has_converged else None


def _change_at_load(wave: Wave, change: np.ndarray, motion: np.ndarray) -> float:
    """Return the relative size of a displacement's change at the load (collective).

    ``change`` and ``motion`` are displacements (n, n_local) [m] at n instants; the reference is the
    motion's size at the load.
    """
    return relative_to_motion(
        *(motion_at_load(wave.structure, displacement) for displacement in (change, motion))
    )


def distance(wave: Wave, orbit: PeriodicOrbit) -> float:
    """Return the distance between a solution's gaps and an orbit's over the period.

    It is relative to the moving part of B^T u; 0 if that is rounding.
    """
    samples = orbit.sampled
    if is_still(samples):
        return 0.0
    gap_motion = samples.gaps + wave.structure_with_row_pairs.clearance
    return relative_to_motion(samples.gaps - wave.over_period(len(gap_motion))[1], gap_motion)
