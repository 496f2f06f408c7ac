"""Result of a command with its study: scene, structure, contact law and watched points."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.suggestions import keep_old_attribute_names, replacement_question_text
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.peak import Peak
from fenics_crack.errors.stated import estimate_result_errors
from fenics_crack.errors.verification import Verification
from fenics_crack.files.results import Result, save
from fenics_crack.model.modes import Modes
from fenics_crack.motion.motions import ObservedMotion
from fenics_crack.runs.conclusion import StudyWithResult, make_conclusion
from fenics_crack.time.march import TimeHistory

ResultType = TypeVar("ResultType", bound=Result, covariant=True)


class ResultAttribute:
    """Attribute that a :class:`Run` reads from its result.

    For example, ``run.omega`` is ``run.result.omega``.
    """

    def __set_name__(self, owner: type, attribute_name: str) -> None:
        self.attribute_name = attribute_name

    def __get__(self, run: Any, owner: type | None = None) -> Any:
        return self if run is None else getattr(run.result, self.attribute_name)


@keep_old_attribute_names(
    distance="distance_to_steady_motion",
    resolution="max_missed_window_width",
    slow_gap_coefficients="gap_series_without_static_part",
    sticking_places="slider_positions",
    still="is_still",
    structure_with_row_pairs="structure_with_pair_per_row",
    undecided="is_undecided",
    at_phase="basis_gaps_and_forces_at_phases",
    coordinates="displacement_of_local_dofs",
    force_rows="row_force_coefficients",
    gap_rows="row_gap_coefficients",
    measure="indicators_of_dofs",
    observe="observe_dofs",
    over_period="basis_gaps_and_forces_over_period",
    said="build_conclusion",
    watched_name="watched_description",
)
@dataclass(frozen=True, repr=False)
class Run(StudyWithResult, Generic[ResultType]):
    """Result of a command, with scene, structure, contact law and watched displacements.

    All attributes of the result can be read from the run, too: ``run.amplitude()``.

    Attributes
    ----------
    scene, structure, contact, watched
        As in :class:`Study`.
    result : Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result of the computation.
    stated : Verification or None
        The :attr:`errors`, if they were computed together with the result; else None.
    """

    result: ResultType
    stated: Verification | None = None

    def __getattr__(self, name: str) -> Any:
        question_text = replacement_question_text(name, ())
        stability = getattr(self.__dict__.get("result"), "stability", None)
        if question_text == "" and not name.startswith("_") and hasattr(stability, name):
            question_text = f"did you mean run.stability.{name}?"
        message = f"'Run' object has no attribute {name!r}; {question_text}"
        raise AttributeError(message.rstrip("; "))

    @cached_property
    def errors(self) -> Verification | None:
        """Estimated errors by cause for the result's numbers (computed at first use, collective).

        For a curve, these are errors for the largest response. None

        - for motions in time;
        - for solutions that have not converged, or without estimated errors;
        - for curves over parameters other than frequency and speed.
        """
        return self.stated or estimate_result_errors(self, self.result)

    def __str__(self) -> str:
        return f"{self.result!r}: {make_conclusion(self).sentence()}"

    def __repr__(self) -> str:
        return f"Run({self.result!r}, {self.scene!r})"

    def _repr_html_(self) -> str:
        return self.result.table().html(str(self))

    def peak(self, dof: int | None = None) -> Peak:
        """Return a curve's largest response, with its errors (collective).

        If ``dof`` is the watched dof, amplitude and frequency have the stated :attr:`errors`.
        AttributeError if the result is not a curve. See :meth:`ResponseCurve.peak`.

        Parameters
        ----------
        dof : int, optional
            Dof of the displacement. Default: the watched dof.
        """
        if not isinstance(self.result, ResponseCurve):
            raise AttributeError(
                "'Run' object has no attribute 'peak': only a Run of fc.curve(scene) has one"
            )
        peak, errors = self.result.peak(dof), self.errors
        if errors is None or not errors.parts or dof not in (None, self.watched_dof):
            return peak
        quantity_names = self.watched[0].column_name("amplitude"), errors.resonance
        amplitude_error, omega_error = (
            errors.stated(quantity_name)[0] for quantity_name in quantity_names
        )
        return replace(
            peak,
            error=amplitude_error,
            omega_error=math.nan if peak.at_end else omega_error,
            without=errors.omitted_causes_text,
        )

    def motion(self) -> dict[str, np.ndarray]:
        """Return the watched displacements [m], by their descriptions in words (collective).

        Returns
        -------
        dict of str to array
            For a solution, the Fourier coefficients a0, a1, b1, ... up to harmonic H: (2H+1,). For
            a curve with n points: (n, 2H+1). For a motion in time, displacements at n instants:
            (n,). For modes the dict is empty.
        """
        result = self.result
        watched_dofs = [watched_displacement.dof for watched_displacement in self.watched]
        displacements_of_watched_dofs: list[np.ndarray] = []
        if isinstance(result, TimeHistory):
            displacements_of_watched_dofs = list(result.displacement(watched_dofs).T)
        elif isinstance(result, ObservedMotion):
            displacements_of_watched_dofs = [
                observed_displacement.real_fourier_coefficients
                for observed_displacement in result.observe_dofs(watched_dofs)[0]
            ]
        return dict(
            zip(
                (watched_displacement.words for watched_displacement in self.watched),
                displacements_of_watched_dofs,
                strict=False,
            )
        )

    def save(self, path: str | Path) -> None:
        """Write the result with its scene, stated errors and watched displacements (collective).

        :func:`load_run` reads the file. Programs without the structure can read it, too
        (:func:`fenics_crack.save`).

        Raises
        ------
        InputError
            The file cannot be written.
        """
        errors_text = None if self.stated is None else self.stated.to_json()
        write_file = partial(
            save, self.result, path, self.scene, watched=self.motion(), errors=errors_text
        )
        is_distributed = isinstance(self.result, PeriodicSolution | Modes)  # spread over ranks
        if self.structure.comm.size > 1 and is_distributed:
            write_file()
        else:
            on_root(self.structure.whole.comm, write_file)

    # --- attributes of the result, in alphabetical order ---

    amplitude = ResultAttribute()
    assessment = ResultAttribute()
    assessments = ResultAttribute()
    at_bifurcations = ResultAttribute()
    base_omega = ResultAttribute()
    basis_gaps_and_forces_at_phases = ResultAttribute()
    basis_gaps_and_forces_over_period = ResultAttribute()
    bifurcation = ResultAttribute()
    bifurcations = ResultAttribute()
    branch = ResultAttribute()
    breathes = ResultAttribute()
    build_conclusion = ResultAttribute()
    by_period = ResultAttribute()
    change = ResultAttribute()
    coefficients_at = ResultAttribute()
    complete = ResultAttribute()
    contact_force = ResultAttribute()
    converged = ResultAttribute()
    created_energy = ResultAttribute()
    displacement = ResultAttribute()
    displacement_coefficients = ResultAttribute()
    displacement_errors = ResultAttribute()
    displacement_field = ResultAttribute()
    displacement_of_local_dofs = ResultAttribute()
    distance_to_steady_motion = ResultAttribute()
    energy_budget = ResultAttribute()
    estimate = ResultAttribute()
    exact = ResultAttribute()
    face_indicators = ResultAttribute()
    faces = ResultAttribute()
    final_state = ResultAttribute()
    force_coefficients = ResultAttribute()
    frequency = ResultAttribute()
    friction = ResultAttribute()
    function = ResultAttribute()
    gap = ResultAttribute()
    gap_coefficients = ResultAttribute()
    gap_series_without_static_part = ResultAttribute()
    gaps_and_forces = ResultAttribute()
    harmonics = ResultAttribute()
    indicators = ResultAttribute()
    indicators_of_dofs = ResultAttribute()
    instants = ResultAttribute()
    irregular = ResultAttribute()
    is_still = ResultAttribute()
    is_undecided = ResultAttribute()
    iterations = ResultAttribute()
    KIND = ResultAttribute()
    max_missed_window_width = ResultAttribute()
    method = ResultAttribute()
    multipliers = ResultAttribute()
    nearest = ResultAttribute()
    observe_dofs = ResultAttribute()
    observe_rows = ResultAttribute()
    omega = ResultAttribute()
    orbit = ResultAttribute()
    others = ResultAttribute()
    parameter = ResultAttribute()
    part = ResultAttribute()
    period = ResultAttribute()
    periods = ResultAttribute()
    points = ResultAttribute()
    problem = ResultAttribute()
    problem_at = ResultAttribute()
    problem_of = ResultAttribute()
    reason = ResultAttribute()
    recorded = ResultAttribute()
    recorded_dofs = ResultAttribute()
    records = ResultAttribute()
    report = ResultAttribute()
    reported = ResultAttribute()
    residual_compliance = ResultAttribute()
    row_force_coefficients = ResultAttribute()
    row_gap_coefficients = ResultAttribute()
    samples = ResultAttribute()
    seconds = ResultAttribute()
    settled = ResultAttribute()
    shapes = ResultAttribute()
    slider_positions = ResultAttribute()
    solution = ResultAttribute()
    stability = ResultAttribute()
    stable = ResultAttribute()
    static_above = ResultAttribute()
    status = ResultAttribute()
    steps_per_period = ResultAttribute()
    structure_with_pair_per_row = ResultAttribute()
    subharmonic = ResultAttribute()
    system = ResultAttribute()
    table = ResultAttribute()
    tangential_force = ResultAttribute()
    tangential_force_coefficients = ResultAttribute()
    tangential_gap = ResultAttribute()
    tangential_gap_coefficients = ResultAttribute()
    time = ResultAttribute()
    to_csv = ResultAttribute()
    to_dataframe = ResultAttribute()
    to_dict = ResultAttribute()
    tolerance = ResultAttribute()
    top = ResultAttribute()
    values = ResultAttribute()
    verdicts = ResultAttribute()
    with_status = ResultAttribute()
    yield_motion_records = ResultAttribute()


def check_run_has_motion(run: object) -> None:
    """Raise InputError unless a run holds a motion.

    The result must be a periodic solution or a motion in time.
    """
    if not (isinstance(run, Run) and isinstance(run.result, PeriodicSolution | TimeHistory)):
        raise InputError(
            "run",
            type(getattr(run, "result", run)).__name__,
            "a Run, as fc.solve(scene) or fc.integrate(scene) returns",
        )
