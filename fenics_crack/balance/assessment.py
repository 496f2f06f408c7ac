"""Error and stability of a harmonic-balance solution with a given number of harmonics.

One step of Newton's method for the whole solution on the exact flow predicts the effect of the
truncated harmonics (:func:`fenics_crack.motion.orbit.predict_orbit_by_newton_step`). Newton's
method for a single state then starts from the predicted state, or from the solution's, and finds
the nearest orbit. If the search for the solution started from an orbit, this orbit is taken without
Newton's method.

The distance to the orbit is the error. The orbit is accepted if the relative distance is at most
0.1 (0.5 if crack faces have no mass), and at most three times the prediction. The motion's Floquet
multipliers are then taken from the orbit. If Newton's method finds no orbit, more harmonics are
tried, twice and four times as many: if crack faces have no mass, those solutions are assessed, up
to a distance of 0.5; otherwise all ways to an orbit start from them.

Without an orbit the error is stated from the prediction p as 3 p / (1 + 2 p): three times a small
prediction, and never below p. Then the exact motion that begins with the solution is followed, and
a small disturbance with it. If the disturbance grows, the motion is irregular
(:func:`fenics_crack.motion.attractors.find_irregular_motion`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from functools import cached_property, partial

import numpy as np

from fenics_crack.balance.contact_system import PeriodicMotion
from fenics_crack.balance.more_modes import (
    ERROR_IF_UNKNOWN,
    MoreModesComparison,
    are_crack_faces_still,
    more_modes_structure_of,
    project_motion_on_load,
)
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import format_percent
from fenics_crack.model.modal import is_small
from fenics_crack.motion.attractors import Attractor, find_irregular_motion
from fenics_crack.motion.flow import ContactFlow, exact_flow_or_none
from fenics_crack.motion.orbit import (
    MAX_PERIODS_IN_NEWTON_SEARCH,
    OrbitPrediction,
    PeriodicOrbit,
    find_orbit,
    is_load_too_slow,
    is_orbit_search_affordable,
    predict_orbit_by_newton_step,
)
from fenics_crack.motion.search import search_orbit, series_states_at_period_parts
from fenics_crack.numerics.equations import COARSE_TOLERANCE
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.numerics.newton import change_relative_to_motion

MAX_ORBIT_DISTANCE = 0.1
"""Maximum relative distance of the gaps at which the nearest orbit is accepted.

If the predicted error is smaller, Newton's method starts from the predicted state before it tries
the solution's state. Measured on 680 solutions: the prediction is half to twice the distance for
99 % of chains, 83 % of plates and 79 % of stiff chains.
"""
MAX_ORBIT_DISTANCE_OF_MASSLESS_FACES = 0.5
"""Maximum relative distance of the gaps at which the nearest orbit is accepted for massless faces.

Measured on ten orbits at a distance from 0.1 to 0.5, within three times the prediction. For nine,
the solution with many harmonics had the same orbit. All ten had the same verdict on stability.
"""
MAX_HARMONIC_DOUBLINGS_FOR_ORBIT = 2
"""Maximum number of times that the harmonics are doubled to find an orbit."""


@keep_old_attribute_names(
    accepted="is_accepted",
    distance="relative_orbit_distance",
    gap_and_load_errors="gap_and_displacement_errors",
    is_of="holds_for",
    orbit="nearest_orbit",
    orbit_prediction="orbit_prediction_by_newton_step",
    states_over_period="states_at_period_parts",
)
class Assessment:
    """Comparison of a harmonic-balance solution with exact motions.

    The exact flow integrates motions to rounding, from contact event to contact event. The
    nearest exact periodic motion is the orbit, and the distance to this orbit the error.
    A Newton step predicts the error without the orbit. Each result is computed on first request.
    Only the solution's motion must be given.

    Parameters
    ----------
    wave : PeriodicMotion
        Motion of the solution.
    exact_orbit : PeriodicOrbit, optional
        Orbit whose truncated Fourier series is the solution. None: the solution solves the
        equations of harmonic balance.
    source_orbit : PeriodicOrbit, optional
        Orbit whose Fourier coefficients were the initial guess for the solution.
    more_modes : MoreModesComparison, optional
        Motion of ``exact_orbit`` with more modes, if known.
    flow : ContactFlow, optional
        Exact flow of structure and law, if known. Default: made on first request.
    n_harmonic_doublings : int
        Maximum number of further solutions, each with twice the harmonics, to find an orbit.
    """

    def __init__(
        self,
        wave: PeriodicMotion,
        exact_orbit: PeriodicOrbit | None = None,
        source_orbit: PeriodicOrbit | None = None,
        *,
        more_modes: MoreModesComparison | None = None,
        flow: ContactFlow | None = None,
        n_harmonic_doublings: int = MAX_HARMONIC_DOUBLINGS_FOR_ORBIT,
    ) -> None:
        self.wave, self.exact_orbit, self._source_orbit = wave, exact_orbit, source_orbit
        self._more_modes, self._flow, self._n_harmonic_doublings = (
            more_modes,
            flow,
            n_harmonic_doublings,
        )
        self._failure_reasons: list[str] = []

    def holds_for(self, wave: PeriodicMotion) -> bool:
        """Return True if this assessment was made for the motion ``wave``.

        The assessed motion is compared with ``wave``. Arrays, structure and contact law must be the
        same objects; numbers must be equal.
        """
        attribute_pairs = [
            (getattr(self.wave, wave_field.name), getattr(wave, wave_field.name))
            for wave_field in fields(PeriodicMotion)
        ]
        return all(
            own_attribute is other_wave_attribute
            or (isinstance(own_attribute, int | float) and own_attribute == other_wave_attribute)
            for own_attribute, other_wave_attribute in attribute_pairs
        )

    @cached_property
    def flow(self) -> ContactFlow | None:
        """Exact flow of structure and law, which integrates motions to rounding; or None.

        None for a linear solution, a structure without pairs, a smooth law, or a large structure.
        Also None for a rigid law with a singular residual flexibility.
        """
        if self.exact_orbit is not None or self._flow is not None:
            return self._flow if self.exact_orbit is None else self.exact_orbit.flow
        if self.wave.contact is None or not self.wave.structure.n_pairs:
            return None
        return exact_flow_or_none(self.wave.structure, self.wave.contact)

    @property
    def can_search_orbit(self) -> bool:
        """True if the motion has an exact flow, and a search for an orbit does not take too long.

        :func:`is_orbit_search_affordable` decides on the time.
        """
        flow, wave = self.flow, self.wave
        return flow is not None and is_orbit_search_affordable(flow, wave.omega, wave.subharmonic)

    @property
    def is_load_too_slow(self) -> bool:
        """True if the load is too slow to integrate exact motions.

        Two periods then need more than 100,000 Taylor pieces, intervals with a single Taylor
        series. Always False for models with more than 120 modes, or without an exact flow.
        """
        flow, wave = self.flow, self.wave
        return flow is not None and is_load_too_slow(flow, wave.omega, wave.subharmonic)

    @cached_property
    def states_at_period_parts(self) -> np.ndarray:
        """States of the solution at 32 equal parts of its period: (32, flow.state_size).

        A state has modal displacements, then velocities; with friction also the sliders' positions:
        tangential gap less the tangential spring's deformation.
        """
        assert self.flow is not None
        wave, flow = self.wave, self.flow
        period_states = series_states_at_period_parts(
            flow, wave.displacement_coefficients, wave.base_omega
        )
        if flow.friction_law:
            time = wave.period / len(period_states) * np.arange(len(period_states))
            period_states[:, 2 * flow.n_modes :] = wave.slider_positions(time)
        return period_states

    @cached_property
    def orbit_prediction_by_newton_step(self) -> OrbitPrediction | None:
        """Prediction of the exact orbit near the solution, by one Newton step.

        The step corrects the states at 32 instants of the period together. None: the exact motion
        cannot be integrated, or no exact flow is known.
        """
        flow, wave = self.flow, self.wave
        return (
            None
            if flow is None
            else predict_orbit_by_newton_step(
                flow, wave.omega, self.states_at_period_parts, wave.subharmonic
            )
        )

    @property
    def predicted_error(self) -> float:
        """Predicted relative error of the gaps over the period, by one Newton step.

        inf: unknown, as the exact motion cannot be integrated, or no exact flow is known.
        """
        return (
            np.inf
            if self.orbit_prediction_by_newton_step is None
            else self.orbit_prediction_by_newton_step.relative_gap_error
        )

    @property
    def nearest_orbit(self) -> PeriodicOrbit | None:
        """Nearest exact orbit; None if none was found.

        The solution was found from this orbit, or Newton's method led from the solution to this
        orbit. The orbit may be too far away to be accepted (:attr:`is_accepted`).
        """
        return self._orbit_and_acceptance[0]

    @property
    def is_accepted(self) -> bool:
        """True if the nearest orbit is accepted as the exact form of this solution.

        The relative distance must be at most 0.1, or 0.5 if crack faces have no mass. If Newton's
        method found the orbit from this solution, the distance must also be at most three times the
        predicted error.
        """
        return self._orbit_and_acceptance[1]

    @cached_property
    def _orbit_and_acceptance(self) -> tuple[PeriodicOrbit | None, bool]:
        """Nearest orbit or None; and True if the orbit is accepted as the solution's exact form."""
        if self.exact_orbit is not None:
            return self.exact_orbit, True
        if self._orbit_from_solution is not None:
            return self._orbit_from_solution, self.close_orbit is not None
        if not self.wave.structure.has_massless_crack_faces:
            orbit = self._search_more_harmonics()
            max_distance = min(self._allowed_orbit_distance, 3.0 * self.predicted_error)
            is_close = orbit is not None and (
                relative_gap_distance(self.wave, orbit) <= max_distance
            )
            return (orbit, True) if is_close else (None, False)
        finer_assessment = self._assessment_with_twice_harmonics()
        if not (finer_assessment and finer_assessment.is_accepted):
            return None, False
        orbit_from_twice_the_harmonics = finer_assessment.nearest_orbit
        assert orbit_from_twice_the_harmonics is not None
        distance = relative_gap_distance(self.wave, orbit_from_twice_the_harmonics)
        return orbit_from_twice_the_harmonics, distance <= self._allowed_orbit_distance

    @cached_property
    def close_orbit(self) -> PeriodicOrbit | None:
        """Exact orbit that is close enough to the solution to be accepted; otherwise None.

        :attr:`is_accepted` states the allowed distance. Unlike :attr:`nearest_orbit`, this orbit is
        never found from a solution with twice the harmonics.
        """
        orbit = self._orbit_from_solution
        if self.exact_orbit is not None or orbit is None:
            return self.exact_orbit
        allowed_distance = self._allowed_orbit_distance
        if self._source_orbit is None:  # predictions are within a factor of 3 of the distance
            allowed_distance = min(
                allowed_distance, max(3.0 * self.predicted_error, COARSE_TOLERANCE)
            )
        return orbit if relative_gap_distance(self.wave, orbit) <= allowed_distance else None

    @cached_property
    def _orbit_from_solution(self) -> PeriodicOrbit | None:
        """Orbit used to find the solution, else an orbit near the solution.

        If no orbit was used, Newton's method searches an orbit from the solution.
        None: no orbit is found.
        """
        return self._source_orbit or self._search_nearest_orbit()

    @property
    def _allowed_orbit_distance(self) -> float:
        """Maximum relative distance between the gaps of solution and accepted orbit.

        The distance is 0.1, or 0.5 if crack faces have no mass.
        """
        return (
            MAX_ORBIT_DISTANCE_OF_MASSLESS_FACES
            if self.wave.structure.has_massless_crack_faces
            else MAX_ORBIT_DISTANCE
        )

    def _search_nearest_orbit(self) -> PeriodicOrbit | None:
        """Search for an exact orbit by Newton's method from the solution.

        None: the load is too slow, the motion cannot be integrated, or Newton's method fails.
        """
        if self.orbit_prediction_by_newton_step is None or self.is_load_too_slow:
            return None
        assert self.flow is not None
        start_states = [self.states_at_period_parts[0]]
        if self.predicted_error <= MAX_ORBIT_DISTANCE:
            start_states.insert(0, self.orbit_prediction_by_newton_step.states[0])
        n_load_periods = self.wave.subharmonic
        i_minus_m_solver = self.orbit_prediction_by_newton_step.solve_i_minus_m
        search_from_state = partial(
            find_orbit, self.flow, self.wave.omega, failure_reasons=self._failure_reasons
        )
        orbit_or_none_iterator = (
            search_from_state(state, subharmonic=n_load_periods, solve_i_minus_m=i_minus_m_solver)
            for state in start_states
        )
        return next(filter(None, orbit_or_none_iterator), None)

    def _search_more_harmonics(self) -> PeriodicOrbit | None:
        """Search for an exact orbit from this solution, also with up to four times the harmonics.

        Of crack faces with mass, Newton's method from the solution alone may fail by the eighth
        digit of the frequency. None: orbits cannot be searched, or the search fails.
        """
        if not self.can_search_orbit or self._n_harmonic_doublings < 1:
            return None
        assert self.flow is not None

        def state_guesses() -> Iterator[np.ndarray]:
            """Yield the states of the solution, then with more harmonics."""
            wave: PeriodicMotion | None = self.wave
            for _ in range(self._n_harmonic_doublings):
                wave = wave and wave_with_twice_the_harmonics(wave)
                if wave is not None:
                    yield Assessment(wave, flow=self.flow).states_at_period_parts

        return search_orbit(
            self.flow, self.wave.omega, state_guesses(), self.wave.subharmonic, prefer_stable=False
        ).orbit

    def _assessment_with_twice_harmonics(self) -> Assessment | None:
        """Return the assessment of the solution with twice the harmonics, or None.

        None: orbits cannot be searched, the harmonics were doubled twice already, or Newton's
        method does not converge with twice the harmonics.
        """
        flow, n_doublings_left = self.flow, self._n_harmonic_doublings - 1
        if flow is None or n_doublings_left < 0 or not self.can_search_orbit:
            return None
        finer_wave = wave_with_twice_the_harmonics(self.wave)
        return (
            None
            if finer_wave is None
            else Assessment(finer_wave, flow=flow, n_harmonic_doublings=n_doublings_left)
        )

    @cached_property
    def irregular_attractor(self) -> Attractor | None:
        """Exact motion from the solution's state at phase zero, if irregular.

        Irregular: a small disturbance of the motion grows. None for a regular motion, if an orbit
        was found, or if the motion cannot be integrated in reasonable time.
        """
        if (
            self.nearest_orbit is not None
            or self.orbit_prediction_by_newton_step is None
            or not self.can_search_orbit
        ):
            return None
        assert self.flow is not None
        return find_irregular_motion(
            self.flow, self.wave.omega, self.states_at_period_parts[0], self.wave.subharmonic
        )

    @cached_property
    def relative_orbit_distance(self) -> float:
        """Relative distance between the gaps of solution and orbit; nan without an orbit.

        The root mean square of the gap difference, over the period and the pairs, is divided by
        that of the orbit's gaps plus clearance. In the divisor a mean larger than the vibration
        counts only as much as the vibration.
        """
        return (
            np.nan
            if self.nearest_orbit is None
            else relative_gap_distance(self.wave, self.nearest_orbit)
        )

    def gap_and_displacement_errors(self, *, search: bool = True) -> tuple[float, float]:
        """Return relative errors of the gap, and of the displacement at the load.

        If the solution has an orbit's coefficients, the errors are the distances to this orbit.
        Otherwise, with ``search``, they are the distances to the nearest orbit. If no orbit is
        found, each is :func:`stated_error` of the predicted error. Without ``search`` they are the
        predicted errors. Each is at most 1, and 1 means unknown.
        """
        wave = self.wave
        if self.exact_orbit is not None or (search and self.nearest_orbit is not None):
            assert self.nearest_orbit is not None
            orbit_samples = self.nearest_orbit.period_samples
            displacement_change = orbit_samples.displacement - wave.displacement_of_local_dofs(
                orbit_samples.time
            )
            harmonic_truncation_errors = (
                self.relative_orbit_distance,
                _relative_change_at_load(wave, displacement_change, orbit_samples.displacement),
            )
        elif (prediction := self.orbit_prediction_by_newton_step) is None:
            harmonic_truncation_errors = ERROR_IF_UNKNOWN, ERROR_IF_UNKNOWN
        else:
            assert self.flow is not None
            displacement_change = (prediction.states - self.states_at_period_parts)[
                :, : self.flow.n_modes
            ] @ self.flow.modal_model.shapes.T
            time = np.arange(len(displacement_change)) * wave.period / len(displacement_change)
            harmonic_truncation_errors = (
                prediction.relative_gap_error,
                _relative_change_at_load(
                    wave, displacement_change, wave.displacement_of_local_dofs(time)
                ),
            )
            harmonic_truncation_errors = (
                (
                    stated_error(harmonic_truncation_errors[0]),
                    stated_error(harmonic_truncation_errors[1]),
                )
                if search
                else harmonic_truncation_errors
            )
        return min(harmonic_truncation_errors[0], ERROR_IF_UNKNOWN), min(
            harmonic_truncation_errors[1], ERROR_IF_UNKNOWN
        )

    @cached_property
    def more_modes(self) -> MoreModesComparison | None:
        """Motion next to the nearest orbit if the structure has more modes.

        None: no orbit is found, no flow with more modes is known, or the search would take long.
        The orbit need not be accepted as the solution's exact form.
        """
        if self._more_modes is not None:
            return self._more_modes
        wave, more_modes_structure = self.wave, more_modes_structure_of(self.wave)
        if self.flow is None or more_modes_structure is None or not is_small(more_modes_structure):
            return None
        assert wave.contact is not None
        flow = exact_flow_or_none(more_modes_structure, wave.contact)
        is_searchable = flow is not None and is_orbit_search_affordable(
            flow, wave.omega, wave.subharmonic, MAX_PERIODS_IN_NEWTON_SEARCH
        )
        if flow is None or not is_searchable or self.nearest_orbit is None:
            return None
        return MoreModesComparison(flow, wave, self.nearest_orbit)

    @property
    def rejection_reason(self) -> str:
        """Reason in words why no orbit is accepted for the solution; "" if accepted."""
        if self.is_accepted:
            return ""
        if self.is_load_too_slow:
            assert self.flow is not None
            n_mode_cycles_per_period = self.flow.mode_rate_bound * self.wave.period / (2.0 * np.pi)
            text_of_mode_cycles_per_period = (
                f"{n_mode_cycles_per_period / 1e3:.0f} thousand cycles in a period"
            )
            cause_text = (
                f"the load is so slow that the highest modes have {text_of_mode_cycles_per_period}"
            )
            return f"{cause_text}, too many for exact time integration; keep fewer modes"
        if self.flow is None:
            return (
                "no exact orbit can be computed: use the contact law 'penalty' or 'unilateral', "
                "and a reduction with method = 'massless'"
            )
        if self.orbit_prediction_by_newton_step is None:
            return (
                "the crack opens and closes too often for an exact orbit; "
                "use crack faces without mass, method = 'massless'"
            )
        gap_error_by_truncated_harmonics = self.predicted_error
        error_text = (
            format_percent(gap_error_by_truncated_harmonics)
            if gap_error_by_truncated_harmonics < ERROR_IF_UNKNOWN
            else "100 % or more"
        )
        if self.nearest_orbit is None:
            text_of_truncated_harmonics_error = (
                f"the truncated harmonics change the solution by {error_text}"
            )
            last_failure_reasons = self._failure_reasons[-1:] or [
                "no exact orbit was found near the solution; use more harmonics"
            ]
            return f"{text_of_truncated_harmonics_error}, and {last_failure_reasons[0]}"
        stable_or_unstable_word = "stable" if self.nearest_orbit.is_stable else "unstable"
        orbit_text = (
            f"the nearest exact orbit, which is {stable_or_unstable_word}, "
            f"differs from the solution by {format_percent(self.relative_orbit_distance)}"
        )
        return f"{orbit_text} and may be another motion; use more harmonics"


def stated_error(predicted_error: float) -> float:
    """Return the error that is reported if no orbit was found: 3 p / (1 + 2 p).

    p is the predicted relative error. The result is about 3 p for a small p, and p for p >= 1.
    """
    return 3.0 * predicted_error / (1.0 + 2.0 * min(predicted_error, 1.0))


def wave_with_twice_the_harmonics(wave: PeriodicMotion) -> PeriodicMotion | None:
    """Return the solution with twice the harmonics, or None without convergence.

    Newton's method starts from the gaps of the given motion.
    """
    assert wave.contact is not None
    problem = Problem(
        wave.structure, wave.omega, wave.contact, 2 * wave.harmonics,
        subharmonic=wave.subharmonic, static_above=wave.static_above,
    )  # fmt: skip
    system = problem.system(problem.compliance_model())
    search = Search(system, problem, COARSE_TOLERANCE, 1.0)
    point = search.solve(resize_harmonics(wave.gap_series_without_static_part, problem.harmonics))
    return problem.wave(system.linearise(point.unknown)) if search.has_converged else None


def _relative_change_at_load(wave: PeriodicMotion, change: np.ndarray, motion: np.ndarray) -> float:
    """Return the relative change of the displacement along the load (collective).

    Parameters
    ----------
    change, motion : (n, n_local) [m]
        Change of the displacement, and the displacement itself, at n instants.

    Returns
    -------
    float
        Root sum of squares of the change, divided by that of the motion. Both are first projected
        on the load (:func:`project_motion_on_load`). In the divisor a mean larger than the
        vibration counts only as much as the vibration.
    """
    return change_relative_to_motion(
        *(
            project_motion_on_load(wave.structure, change_or_motion_samples)
            for change_or_motion_samples in (change, motion)
        )
    )


def relative_gap_distance(wave: PeriodicMotion, orbit: PeriodicOrbit) -> float:
    """Return the relative distance between the gaps of a solution and an orbit.

    The root mean square of the gap difference, over the period and the pairs, is divided by that of
    the orbit's gaps plus clearance. In the divisor a mean larger than the vibration counts only as
    much as the vibration. The result is 0 if the load presses the crack faces together, so that
    gaps move only by rounding.
    """
    orbit_samples = orbit.period_samples
    if are_crack_faces_still(orbit_samples):
        return 0.0
    gap_plus_clearance = orbit_samples.gaps + orbit.flow.clearance
    return change_relative_to_motion(
        orbit_samples.gaps - wave.basis_gaps_and_forces_over_period(len(gap_plus_clearance))[1],
        gap_plus_clearance,
    )
