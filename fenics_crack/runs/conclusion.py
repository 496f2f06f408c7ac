"""Conclusion of a run: the sentence with which the program, a report and Python's ``str`` end.

It says the answer and how accurate it is, the doubts that numbers alone do not show, and remarks.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import INTERRUPTED
from fenics_crack.basics.tables import (
    TURN,
    Said,
    error_in_words,
    frequency_axis,
    in_unit,
    percent,
    quantity,
)
from fenics_crack.curves.curve import ResponseCurve, parameter_axis
from fenics_crack.curves.peak import RISING_AT_END_TEXT
from fenics_crack.errors.numbers import natural_name
from fenics_crack.errors.stated import not_estimated
from fenics_crack.errors.verification import Verification
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import Modes
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Integration
from fenics_crack.scene.words import faces_in_words
from fenics_crack.study.plausibility import Remark, find_key_figures, remarks_on_scene
from fenics_crack.study.prepare import REFUSALS, Study
from fenics_crack.time.march import TimeHistory


class Answer(Study):
    """Result with its study, the base of :class:`fenics_crack.runs.run.Run`.

    Attributes
    ----------
    result : object
        Result of the computation.
    stated : Verification or None
        Its errors, where they were computed with it.
    """

    result: Any
    stated: Verification | None

    @property
    def watched_name(self) -> str:
        """Name of the watched dof in words."""
        return self.watched[0].words

    @cached_property
    def remarks(self) -> tuple[Remark, ...]:
        """Remarks on the scene and its structure, those of ``fenics-crack check`` (collective)."""
        try:
            figures = find_key_figures(self)
        except REFUSALS:  # figures that cannot be found are no reason to lose the result
            figures = None
        return tuple(remarks_on_scene(self.scene, self.structure.whole, figures))

    @property
    def watched_dof(self) -> int:
        """First watched dof of the whole structure."""
        return self.watched[0].dof


FRICTION_MATTERS = 0.01
"""Smallest relative change by friction that is reported."""
LINEAR = "no contact pair opens and closes: the vibration is linear"


def report_linearity(closed_share: np.ndarray) -> list[str]:
    """Report a linear vibration: no pair opens and closes in any solution.

    ``closed_share`` (...) is the share of the period with closed pairs; nan without pairs.
    """
    breathe = np.any((closed_share > 0.0) & (closed_share < 1.0))
    return [] if breathe or not np.any(np.isfinite(closed_share)) else [LINEAR]


def describe_error(run: Answer, name: str = "") -> str:
    """Return the stated error of a number in words: "2.4 %, mostly due to the mesh".

    By default it is that of the watched amplitude; empty if not stated, unknown, 0 or infinite.
    """
    if run.stated is None:
        return ""
    error, cause = run.stated.stated(name or run.watched[0].column("amplitude"))
    if not 0.0 < error < np.inf:  # of a plate at rest, or of what no cause changes; or unknown
        return ""
    cause_words = f", mostly due to the {cause}" if error > 1e-4 else ""
    return ", ".join(filter(None, (f"{error_in_words(error)}{cause_words}", run.stated.left_out)))


def unknown_error(run: Answer) -> str:
    """Return why the error of the watched amplitude is unknown, by the stated errors.

    Empty if the error is known or no errors are stated, and for large structures.
    """
    if run.stated is None or not is_small(run.structure):  # then the report alone has the error
        return ""
    return run.stated.doubt(run.watched[0].column("amplitude"))


def unknown_of_solution(run: Answer) -> str:
    """Return why the error of a solution is unknown, by its report or the stated errors."""
    report = run.result.report
    return not_estimated(report) if report.unknown else unknown_error(run)


def frequency_in_words(scene: Scene, omega: float) -> str:
    """Return a load frequency [rad/s] in the scene's unit, in words."""
    return in_unit(frequency_axis(scene.in_hertz), omega)


def conclusion_of(run: Answer) -> Said:
    """Return the parts of the last sentence on a run (collective)."""
    kind: str = run.result.KIND
    return _CONCLUSIONS[kind](run) if kind in _CONCLUSIONS else Said(kind)


def _of_modes(run: Answer) -> Said:
    first_omega = float(run.result.omega[0])
    answer = f"the first natural frequency with the crack open is {first_omega / TURN:.5g} Hz "
    answer += f"({first_omega:.5g} rad/s){_error_clause(run, natural_name(run.scene, 'open', 1))}"
    return Said("modes found", answer)


def _error_clause(run: Answer, name: str = "", fallback: str = "") -> str:
    """Return ", estimated error 2.4 %", or a fallback if the error is not stated.

    The causes that the error does not include follow.
    """
    if error_words := describe_error(run, name):
        return f", estimated error {error_words}"
    left_out = "" if run.stated is None else run.stated.left_out
    return f"{fallback}, {left_out}" if left_out else fallback


def _of_solution(run: Answer) -> Said:
    solution: PeriodicSolution = run.result
    doubt = unknown_of_solution(run)
    if not solution.converged:
        return Said("not converged", unknown=doubt)
    size, report = quantity(solution.amplitude(run.watched_dof), "m"), solution.report
    error = f", estimated relative error of the gap {percent(report.total)}"
    if not report.estimated:
        error = ", its error is not estimated (harmonic_balance.error = false)"
    elif not solution.gap_coefficients.size:
        error = ""
    error = "" if doubt else _error_clause(run, fallback=error)
    tolerance, faces = run.scene.harmonic_balance.tolerance, faces_in_words(run.scene)
    misses_tolerance = tolerance is not None and report.total > tolerance
    return Said(
        "solved, but the tolerance is missed" if misses_tolerance else "solved",
        f"at {frequency_in_words(run.scene, solution.omega)} the {run.watched_name} is {size} half "
        f"peak-to-peak{error}",
        doubt,
        ["nothing vibrates"]
        if solution.still
        else _describe_crack_and_verdict(run, solution, faces),
    )


def _describe_crack_and_verdict(run: Answer, solution: PeriodicSolution, faces: str) -> list[str]:
    """Describe the crack's opening, the effect of friction left out, and the stability."""
    sentences = []
    if run.structure.n_pairs and solution.contact is not None:
        values, subject = solution.faces, "the crack opens" if faces != "pairs" else "contact opens"
        share = run.stated.stated("opening")[0] if run.stated is not None else 0.0
        error_words = f", estimated error {error_in_words(share)}," if 0.0 < share < np.inf else ""
        sentences.append(
            f"{subject} by {quantity(values['opening'], 'm')}{error_words} and is closed for "
            f"{percent(values['closed_share'])} of the period"
            if solution.breathes
            else LINEAR
        )
    min_change = max(run.scene.harmonic_balance.tolerance or 0.0, FRICTION_MATTERS)
    friction = {} if run.stated is None else run.stated.parts.get("friction", {})
    part = friction.get(run.watched[0].column("amplitude"))
    if part is not None and part.gci > min_change and not run.scene.has_friction:
        sentences.append(f"friction left out: about {percent(part.gci)}")
    return [
        *sentences,
        *describe_stability(solution.stability, solution.amplitude(run.watched_dof)),
    ]


def _of_curve(run: Answer) -> Said:
    curve: ResponseCurve = run.result
    top, axis = curve.top(run.watched_dof), parameter_axis(curve.parameter, run.scene.in_hertz)
    size, place = quantity(top.amplitude, "m"), in_unit(axis, top.value)
    doubt = unknown_error(run)
    error = "" if doubt else _error_clause(run, fallback=", its error is not estimated")
    answer = f"the largest response of the {run.watched_name} is {size} half peak-to-peak"
    if top.at_end and top.index == len(curve) - 1 and not curve.complete:
        answer = (
            f"the response of the {run.watched_name} grows up to where the curve ended, {size} "
        )
        answer += f"half peak-to-peak at {place}"
    elif top.at_end:
        answer += f", {RISING_AT_END_TEXT}, {place}{error}"
    else:
        share = run.stated.stated(run.stated.resonance)[0] if run.stated is not None else 0.0
        place_error_words = f" within {error_in_words(share)}" if 0.0 < share < np.inf else ""
        answer += f" at {place}{place_error_words}{error}"
    remarks = report_linearity(curve.indicators(run.watched_dof).closed_share)
    if curve.multipliers is not None:
        names, counts = np.unique(curve.verdicts, return_counts=True)
        shares = (f"{n} {name}" for n, name in zip(counts, names, strict=True))
        remarks.append(f"{', '.join(shares)} of {len(curve)} points")
    else:
        remarks.append("stability not examined")
    outcome = "curve complete" if curve.complete else "the curve ended early"
    if curve.status == INTERRUPTED:
        outcome = "curve interrupted"
    return Said(outcome, answer, doubt, remarks)


def _of_history(run: Answer) -> Said:
    history: TimeHistory = run.result
    table, name = run.scene.integration or Integration(), run.watched_name
    if table.free:
        displacement = history.displacement([run.watched_dof])[:, 0]
        sizes = np.ptp(history.by_period(displacement), axis=1) / 2.0
        start_size, end_size = (quantity(float(size), "m") for size in sizes[[0, -1]])
        answer = f"the {name} falls from {start_size} to {end_size} half peak-to-peak over "
        early_end = [] if history.periods >= table.periods else ["the decay ended early"]
        return Said(
            "integrated", f"{answer}{history.periods} periods", others=["free decay", *early_end]
        )
    has_settled = history.settled <= table.settle
    size = history.indicators(run.watched_dof).amplitude
    place = frequency_in_words(run.scene, run.scene.excitation.omega)
    answer = f"at {place} the {name} is {quantity(size, 'm')} half peak-to-peak"
    change = f"{history.periods} of {table.periods} periods: one period shows no change"
    if np.isfinite(history.settled):
        change = (
            f"{history.periods} periods: relative change over the last one {history.settled:.2g}"
        )
    if (distance := history.distance) < 1.0:
        change += f", estimated distance from the settled motion {distance:.2g}"
    outcome = "settled" if has_settled else "the motion has not settled"
    return Said("integrated", answer, others=[f"{outcome} after {change}"])


_CONCLUSIONS: dict[str, Callable[[Answer], Said]] = {
    Modes.KIND: _of_modes,
    PeriodicSolution.KIND: _of_solution,
    ResponseCurve.KIND: _of_curve,
    TimeHistory.KIND: _of_history,
}


def describe_stability(stability: Stability | None, amplitude: float) -> list[str]:
    """Describe the verdict on a solution, and the motion from rest if it is another.

    ``amplitude`` [m] is the solution's.
    """
    if stability is None:
        return ["stability not examined"]
    sentences = [
        {"undecided": "stability undecided", "irregular": stability.reason}.get(
            stability.verdict, stability.verdict
        )
    ]
    if stability.from_rest:
        size = ""
        if np.isfinite(stability.rest_amplitude) and amplitude > 0.0:
            ratio = stability.rest_amplitude / amplitude
            size = f", {ratio:.3g} times as large ({quantity(stability.rest_amplitude, 'm')})"
        sentences.append(f"the motion from rest {stability.from_rest}{size}")
    return sentences
