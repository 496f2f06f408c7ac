"""Conclusion of a run: the last sentence in the program, in a report and in Python's ``str``.

It says the answer, its accuracy, doubts that numbers alone do not show, and remarks.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import INTERRUPTED_CURVE_STATUS
from fenics_crack.basics.tables import (
    RAD_PER_TURN,
    Conclusion,
    choose_frequency_factor_name_unit,
    format_error,
    format_in_unit,
    format_percent,
    format_quantity,
)
from fenics_crack.curves.curve import ResponseCurve, axis_factor_name_and_unit
from fenics_crack.curves.peak import RISING_AT_END_TEXT
from fenics_crack.errors.numbers import find_accepted_orbit_or_none, natural_frequency_name
from fenics_crack.errors.stated import describe_unknown_error_part
from fenics_crack.errors.verification import Verification
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import Modes
from fenics_crack.scene.result_tables import Integration
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.words import word_for_crack_faces
from fenics_crack.study.key_figures import find_key_figures
from fenics_crack.study.plausibility import Remark, remarks_on_scene
from fenics_crack.study.prepare import SINGLE_COMPUTATION_FAILURES, Study
from fenics_crack.time.march import TimeHistory


class StudyWithResult(Study):
    """Study (scene, structure, contact law, watched displacements) with its computed result.

    Base class of :class:`fenics_crack.runs.run.Run`.

    Attributes
    ----------
    result : Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result of the computation.
    stated : Verification or None
        Estimated errors of the result's numbers; None if the command did not estimate them.
    """

    result: Any
    stated: Verification | None

    @property
    def watched_description(self) -> str:
        """First watched displacement in words, such as "x displacement of tip"."""
        return self.watched[0].words

    @cached_property
    def remarks(self) -> tuple[Remark, ...]:
        """Remarks on unusual values in the scene and in the structure (collective).

        ``fenics-crack check`` prints the same remarks. Remarks that need key figures (natural
        frequencies, static responses) are left out if these cannot be computed.
        """
        try:
            key_figures = find_key_figures(self)
        except (
            SINGLE_COMPUTATION_FAILURES
        ):  # figures that cannot be found are no reason to lose the result
            key_figures = None
        return tuple(remarks_on_scene(self.scene, self.structure.whole, key_figures))

    @property
    def watched_dof(self) -> int:
        """Number of the first watched dof, counted in the unreduced structure."""
        return self.watched[0].dof


MIN_REPORTED_AMPLITUDE_CHANGE_BY_FRICTION = 0.01
"""Smallest relative change of the watched amplitude by friction that a closing sentence states, if
the scene leaves friction out. A larger tolerance of harmonic balance replaces this limit."""
MAX_UNREMARKED_FAR_SHARE = 0.1
"""Share of the load's work in far modes above which a closing sentence names it."""
LINEAR_VIBRATION_TEXT = "no contact pair opens and closes: the vibration is linear"


def list_linearity_sentences(closed_share: np.ndarray) -> list[str]:
    """Return a list with the sentence for a linear vibration, else an empty list.

    A vibration is linear if no contact pair opens and closes. The list is empty, too, without
    contact pairs.

    Parameters
    ----------
    closed_share : array of any shape
        Closed fraction of the period for each solution, 0 to 1, as mean over the pairs; nan without
        pairs. The vibration is linear if every entry is 0 or 1.
    """
    breathes = np.any((closed_share > 0.0) & (closed_share < 1.0))
    has_pairs = np.any(np.isfinite(closed_share))
    return [] if breathes or not has_pairs else [LINEAR_VIBRATION_TEXT]


def describe_stated_error(run: StudyWithResult, quantity_name: str = "") -> str:
    """Return a result's relative error in words: "2.4 %, mostly due to the mesh".

    The main cause is named for errors above 1e-4. Then follow causes not included in the error,
    with reasons. The text is empty in two cases:

    - the run has no estimated errors;
    - the error is unknown, 0, or at least as large as the result.

    Parameters
    ----------
    run : StudyWithResult
        Result with its estimated errors, ``run.stated``.
    quantity_name : str
        Name of the result, as in ``[output] quantities``. Default: the amplitude at the first
        watched dof.
    """
    if run.stated is None:
        return ""
    quantity_name = quantity_name or run.watched[0].column_name("amplitude")
    relative_error, main_cause = run.stated.stated(quantity_name)
    if not 0.0 < relative_error < np.inf:  # zero at rest or without a cause; nan if unknown
        return ""
    if main_cause == "friction" and not run.scene.has_friction:
        main_cause = "friction left out"
    cause_text = f", mostly due to the {main_cause}" if relative_error > 1e-4 else ""
    error_text = f"{format_error(relative_error)}{cause_text}"
    return ", ".join(filter(None, (error_text, run.stated.omitted_causes_and_reasons_text)))


def explain_unknown_amplitude_error(run: StudyWithResult) -> str:
    """Return why the watched amplitude has no known error, in words.

    An error as large as the amplitude counts as unknown. The text is empty if the error is known,
    or if the run has no estimated errors. The text is empty, too, for a structure that is not small
    (:func:`is_small`).
    """
    if run.stated is None or not is_small(run.structure):  # then the report alone has the error
        return ""
    return run.stated.doubt(run.watched[0].column_name("amplitude"))


def explain_unknown_solution_error(run: StudyWithResult) -> str:
    """Return why a periodic solution has no known error, in words.

    If the solution's error report (:class:`ErrorReport`) gives no error, the text says why.
    Otherwise the text says why the watched amplitude's error is unknown. If both errors are known,
    the text is empty.
    """
    error_report = run.result.report
    return (
        describe_unknown_error_part(error_report)
        if error_report.unknown
        else explain_unknown_amplitude_error(run)
    )


def frequency_in_words(scene: Scene, omega: float) -> str:
    """Return a load frequency [rad/s] as text in the scene's unit.

    Examples are "50.1 Hz" and "315 rad/s".
    """
    return format_in_unit(choose_frequency_factor_name_unit(scene.is_frequency_in_hertz), omega)


def make_conclusion(run: StudyWithResult) -> Conclusion:
    """Build the closing sentence that a command prints on its result (collective)."""
    result_kind: str = run.result.KIND
    return (
        _MAKE_CONCLUSION_BY_KIND[result_kind](run)
        if result_kind in _MAKE_CONCLUSION_BY_KIND
        else Conclusion(result_kind)
    )


def _make_conclusion_of_modes(run: StudyWithResult) -> Conclusion:
    """Build the closing sentence on modes.

    The sentence states the first natural frequency with open crack, and its error.
    """
    first_omega = float(run.result.omega[0])
    state_text = " with the crack open" if run.structure.n_pairs else ""
    answer_text = (
        f"the first natural frequency{state_text} is {first_omega / RAD_PER_TURN:.5g} Hz "
        f"({first_omega:.5g} rad/s)"
        f"{_error_clause(run, natural_frequency_name(run.scene, 'open', 1))}"
    )
    return Conclusion("modes found", answer_text)


def _error_clause(run: StudyWithResult, quantity_name: str = "", fallback_text: str = "") -> str:
    """Return a clause on a result's error, such as ", estimated error 2.4 %".

    If the error is not known, the clause is ``fallback_text``. Then follow causes not included in
    the error, with reasons.

    Parameters
    ----------
    run : StudyWithResult
        Result with its estimated errors, ``run.stated``.
    quantity_name : str
        Name of the result, as in ``[output] quantities``. Default: the amplitude at the first
        watched dof.
    fallback_text : str
        Clause if the error is not known.
    """
    if error_text := describe_stated_error(run, quantity_name):
        return f", estimated error {error_text}"
    missing_causes_text = "" if run.stated is None else run.stated.omitted_causes_and_reasons_text
    return f"{fallback_text}, {missing_causes_text}" if missing_causes_text else fallback_text


def _make_conclusion_of_solution(run: StudyWithResult) -> Conclusion:
    """Build the closing sentence on a periodic solution.

    The sentence states amplitude, error, crack opening and stability.
    """
    solution: PeriodicSolution = run.result
    unknown_error_reason = explain_unknown_solution_error(run)
    if not solution.converged:
        return Conclusion("not converged", unknown_error_reason=unknown_error_reason)
    error_report, amplitude = solution.report, solution.amplitude(run.watched_dof)
    amplitude_text = format_quantity(amplitude, "m")
    frequency_text = frequency_in_words(run.scene, solution.omega)
    error_text = f", estimated relative error of the gap {format_percent(error_report.total)}"
    if not error_report.estimated:
        error_text = ", its error is not estimated (harmonic_balance.error = false)"
    elif not solution.gap_coefficients.size:
        error_text = ""
    error_text = "" if unknown_error_reason else _error_clause(run, fallback_text=error_text)
    tolerance, crack_faces_word = (
        run.scene.harmonic_balance.tolerance,
        word_for_crack_faces(run.scene),
    )
    misses_tolerance = tolerance is not None and error_report.total > tolerance
    return Conclusion(
        "solved, but the error exceeds harmonic_balance.tolerance"
        if misses_tolerance
        else "solved",
        f"at {frequency_text} the {run.watched_description} is {amplitude_text} half "
        f"peak-to-peak{error_text}",
        unknown_error_reason,
        ["nothing vibrates"]
        if solution.is_still
        else _list_opening_and_stability_sentences(run, solution, crack_faces_word),
    )


def _list_opening_and_stability_sentences(
    run: StudyWithResult, solution: PeriodicSolution, crack_faces_word: str
) -> list[str]:
    """Return sentences on crack opening, friction and stability, for the conclusion.

    The sentence on friction says how much friction would change the watched amplitude. This
    sentence is added only if the scene leaves friction out, and if the change is not small.

    Parameters
    ----------
    run : StudyWithResult
        Run with its estimated errors.
    solution : PeriodicSolution
        Result of the run.
    crack_faces_word : str
        The scene's word for crack faces; "pairs" if the scene has matrices and no crack.
    """
    sentences = []
    if run.structure.n_pairs and solution.contact is not None:
        subject_and_verb_text = (
            "the crack opens" if crack_faces_word != "pairs" else "contact opens"
        )
        opening_text = format_quantity(solution.face_indicators["opening"], "m")
        opening_error = run.stated.stated("opening")[0] if run.stated is not None else 0.0
        error_text = (
            f", estimated error {format_error(opening_error)},"
            if 0.0 < opening_error < np.inf
            else ""
        )
        sentences.append(
            f"{subject_and_verb_text} by {opening_text}{error_text} and is closed "
            f"for {format_percent(solution.face_indicators['closed_share'])} of the period"
            if solution.breathes
            else LINEAR_VIBRATION_TEXT
        )
    friction_error_by_name = {} if run.stated is None else run.stated.parts.get("friction", {})
    friction_error_estimate = friction_error_by_name.get(run.watched[0].column_name("amplitude"))
    if (
        friction_error_estimate is not None
        and friction_error_estimate.gci
        > max(
            run.scene.harmonic_balance.tolerance or 0.0, MIN_REPORTED_AMPLITUDE_CHANGE_BY_FRICTION
        )
        and not run.scene.has_friction
    ):
        sentences.append(
            "friction left out: it would change the "
            f"displacement by about {format_percent(friction_error_estimate.gci)} "
            f"(with contact.friction = {run.scene.given('contact').friction_error:g})"
        )
    return [
        *sentences,
        *list_stability_sentences(solution.stability, solution.amplitude(run.watched_dof)),
        *_list_energy_sentences(run, solution),
    ]


def _list_energy_sentences(run: StudyWithResult, solution: PeriodicSolution) -> list[str]:
    """Return a list with the sentence on energy lost in far modes, else an empty list.

    Far modes (:mod:`fenics_crack.motion.energy`) lose more than a tenth of the load's work, and
    their damping ratio does not rise with frequency.
    """
    damping, motion = run.scene.damping, None
    if damping is None or damping.ratio is None or damping.stiffness:
        return []
    if run.stated is not None:  # the orbit was sought
        motion = find_accepted_orbit_or_none(solution)
    budget = (motion or solution).energy_budget
    if budget is None or not budget.shares["far_share"] > MAX_UNREMARKED_FAR_SHARE:
        return []
    far_frequency_text = frequency_in_words(run.scene, budget.far_omega)
    share_text = format_percent(budget.shares["far_share"])
    stiffness = 2.0 * float(np.ravel(damping.ratio)[0]) / solution.omega
    return [
        f"modes above {far_frequency_text} take {share_text} of the power, by a damping ratio that "
        "is seldom measured there; with damping that rises with frequency, such as "
        f"damping.stiffness = {stiffness:.2g} in place of damping.ratio, fewer modes are enough"
    ]


def _make_conclusion_of_curve(run: StudyWithResult) -> Conclusion:
    """Build the closing sentence on a response curve.

    The sentence states the largest response, its error, and how many points are stable.
    """
    response_curve: ResponseCurve = run.result
    peak = response_curve.top(run.watched_dof)
    parameter_factor_name_and_unit = axis_factor_name_and_unit(
        response_curve.parameter, run.scene.is_frequency_in_hertz
    )
    amplitude_text = format_quantity(peak.amplitude, "m")
    peak_location_text = format_in_unit(parameter_factor_name_and_unit, peak.value)
    unknown_error_reason = explain_unknown_amplitude_error(run)
    error_text = (
        ""
        if unknown_error_reason
        else _error_clause(run, fallback_text=", its error is not estimated")
    )
    answer_text = (
        f"the largest response of the {run.watched_description} is {amplitude_text} "
        "half peak-to-peak"
    )
    if peak.at_end and peak.index == len(response_curve) - 1 and not response_curve.complete:
        answer_text = (
            f"the response of the {run.watched_description} still rises where the curve ended, "
            f"with {amplitude_text} half peak-to-peak at {peak_location_text}"
        )
    elif peak.at_end:
        answer_text += f", {RISING_AT_END_TEXT}, {peak_location_text}{error_text}"
    else:
        peak_location_error = (
            run.stated.stated(run.stated.resonance)[0] if run.stated is not None else 0.0
        )
        peak_location_error_text = (
            f" within {format_error(peak_location_error)}"
            if 0.0 < peak_location_error < np.inf
            else ""
        )
        answer_text += f" at {peak_location_text}{peak_location_error_text}{error_text}"
    sentences = list_linearity_sentences(response_curve.indicators(run.watched_dof).closed_share)
    if response_curve.multipliers is not None:
        stability_verdict_names, verdict_counts = np.unique(
            response_curve.verdicts, return_counts=True
        )
        verdict_count_texts = (
            f"{verdict_count} {stability_verdict_name}"
            for verdict_count, stability_verdict_name in zip(
                verdict_counts, stability_verdict_names, strict=True
            )
        )
        sentences.append(f"{', '.join(verdict_count_texts)} of {len(response_curve)} points")
    else:
        sentences.append("stability not examined")
    outcome_text = "curve complete" if response_curve.complete else "the curve ended early"
    if response_curve.status == INTERRUPTED_CURVE_STATUS:
        outcome_text = "curve interrupted"
    return Conclusion(outcome_text, answer_text, unknown_error_reason, sentences)


def _make_conclusion_of_history(run: StudyWithResult) -> Conclusion:
    """Build the closing sentence on a motion in time.

    The sentence states the amplitude, and whether the motion has settled. For a free decay the
    amplitudes in the first and last period are stated.
    """
    history: TimeHistory = run.result
    integration_table = run.scene.integration or Integration()
    displacement_description = run.watched_description
    if integration_table.free:
        displacement = history.displacement([run.watched_dof])[:, 0]
        period_amplitudes = np.ptp(history.by_period(displacement), axis=1) / 2.0
        start_amplitude_text, end_amplitude_text = (
            format_quantity(float(amplitude), "m") for amplitude in period_amplitudes[[0, -1]]
        )
        answer_text = (
            f"the {displacement_description} falls from {start_amplitude_text} to "
            f"{end_amplitude_text} half peak-to-peak over {history.periods} periods"
        )
        clauses = ["free decay"]
        if history.periods < integration_table.periods:
            clauses.append("the decay ended early")
        return Conclusion("integrated", answer_text, further_clauses=clauses)
    has_settled = history.settled <= integration_table.settle
    amplitude_text = format_quantity(history.indicators(run.watched_dof).amplitude, "m")
    frequency_text = frequency_in_words(run.scene, run.scene.excitation.omega)
    answer_text = (
        f"at {frequency_text} the {displacement_description} is {amplitude_text} half peak-to-peak"
    )
    change_text = (
        f"{history.periods} of {integration_table.periods} periods: two are needed to see a change "
        "(integration.periods)"
    )
    if np.isfinite(history.settled):
        change_text = (
            f"{history.periods} periods: relative change over the last period {history.settled:.2g}"
        )
        if not has_settled:
            change_text += f", above integration.settle = {integration_table.settle:g}"
    if (distance_from_settled := history.distance_to_steady_motion) < 1.0:
        change_text += (
            f", estimated relative distance from the settled motion {distance_from_settled:.2g}"
        )
    outcome_text = "settled" if has_settled else "the motion has not settled"
    return Conclusion(
        "integrated", answer_text, further_clauses=[f"{outcome_text} after {change_text}"]
    )


_MAKE_CONCLUSION_BY_KIND: dict[str, Callable[[StudyWithResult], Conclusion]] = {
    Modes.KIND: _make_conclusion_of_modes,
    PeriodicSolution.KIND: _make_conclusion_of_solution,
    ResponseCurve.KIND: _make_conclusion_of_curve,
    TimeHistory.KIND: _make_conclusion_of_history,
}


def list_stability_sentences(stability: Stability | None, amplitude: float) -> list[str]:
    """Return sentences on a solution's stability, and on the motion from rest.

    The motion from rest is described only if it was integrated and does not settle to the solution.

    Parameters
    ----------
    stability : Stability or None
        None gives "stability not examined".
    amplitude : float [m]
        Amplitude of the solution, for comparison with the motion from rest.
    """
    if stability is None:
        return ["stability not examined"]
    sentences = [
        {"undecided": "stability undecided", "irregular": stability.reason}.get(
            stability.verdict, stability.verdict
        )
    ]
    if stability.from_rest:
        amplitude_text = ""
        if np.isfinite(stability.rest_amplitude) and amplitude > 0.0:
            from_rest_to_solution_amplitude_ratio = stability.rest_amplitude / amplitude
            amplitude_from_rest_text = format_quantity(stability.rest_amplitude, "m")
            amplitude_text = (
                f", {from_rest_to_solution_amplitude_ratio:.3g} times as large "
                f"({amplitude_from_rest_text})"
            )
        sentences.append(f"the motion from rest {stability.from_rest}{amplitude_text}")
    return sentences
