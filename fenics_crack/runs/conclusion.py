"""Conclusion of a run: its answer and how accurate it is, the doubts that its numbers alone do not
show, its remarks: the sentence with which the program, a report and Python's ``str`` end."""

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
from fenics_crack.curves.peak import RISING_AT_END
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
    """Result with its study, as a conclusion needs it: a :class:`fenics_crack.runs.run.Run`.

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
        """Remarks on the scene and its structure, as ``fenics-crack check`` reports them
        (collective)."""
        try:
            figures = find_key_figures(self)
        except REFUSALS:  # figures that cannot be found are no reason to lose the result
            figures = None
        return tuple(remarks_on_scene(self.scene, self.structure.whole, figures))

    @property
    def watched_dof(self) -> int:
        """The first of the dofs that are watched, of the whole structure."""
        return self.watched[0].dof


FRICTION_MATTERS = 0.01
"""Smallest relative change by friction that is reported."""
LINEAR = "no contact pair opens and closes: the vibration is linear"


def at_rest(closed_share: np.ndarray) -> list[str]:
    """Report if every pair stays open, or closed, in all of some solutions, by their shares of the
    period in which pairs are closed (...), nan without pairs."""
    breathe = np.any((closed_share > 0.0) & (closed_share < 1.0))
    return [] if breathe or not np.any(np.isfinite(closed_share)) else [LINEAR]


def known_to(run: Answer, name: str = "") -> str:
    """Return the error of a number of a result, by default of the watched amplitude: "2.4 %,
    mostly due to the mesh"; empty where that is not stated."""
    if run.stated is None:
        return ""
    error, cause = run.stated.stated(name or run.watched[0].column("amplitude"))
    if not 0.0 < error < np.inf:  # of a plate at rest, or of what no cause changes; or unknown
        return ""
    by = f", mostly due to the {cause}" if error > 1e-4 else ""
    return ", ".join(filter(None, (f"{error_in_words(error)}{by}", run.stated.left_out)))


def unknown_error(run: Answer) -> str:
    """Return why the error of a result is unknown; empty where it is known, or nothing is."""
    if run.stated is None or not is_small(run.structure):  # then the report alone has the error
        return ""
    return run.stated.doubt(run.watched[0].column("amplitude"))


def unknown_of_solution(run: Answer) -> str:
    """The same of a solution, which reports its error itself."""
    report = run.result.report
    return not_estimated(report) if report.unknown else unknown_error(run)


def frequency_in_words(scene: Scene, omega: float) -> str:
    """A load frequency [rad/s] in the scene's unit."""
    return in_unit(frequency_axis(scene.in_hertz), omega)


def said_of(run: Answer) -> Said:
    """What the last sentence on a run says (collective)."""
    kind: str = run.result.KIND
    return _SAID[kind](run) if kind in _SAID else Said(kind)


def _of_modes(run: Answer) -> Said:
    first = float(run.result.omega[0])
    known = f"the first natural frequency with the crack open is {first / TURN:.5g} Hz "
    known += f"({first:.5g} rad/s){_error(run, natural_name(run.scene, 'open', 1))}"
    return Said("modes found", known)


def _error(run: Answer, name: str = "", instead: str = "") -> str:
    """ ", estimated error 2.4 %", or something instead where that is not stated, and what no error
    includes."""
    if known := known_to(run, name):
        return f", estimated error {known}"
    left_out = "" if run.stated is None else run.stated.left_out
    return f"{instead}, {left_out}" if left_out else instead


def _of_solution(run: Answer) -> Said:
    found: PeriodicSolution = run.result
    unknown = unknown_of_solution(run)
    if not found.converged:
        return Said("not converged", unknown=unknown)
    size, report = quantity(found.amplitude(run.watched_dof), "m"), found.report
    error = f", estimated relative error of the gap {percent(report.total)}"
    if not report.estimated:
        error = ", its error is not estimated (harmonic_balance.error = false)"
    elif not found.gap_coefficients.size:
        error = ""
    error = "" if unknown else _error(run, instead=error)
    tolerance, faces = run.scene.harmonic_balance.tolerance, faces_in_words(run.scene)
    missed = tolerance is not None and report.total > tolerance
    return Said(
        "solved, but the tolerance is missed" if missed else "solved",
        f"at {frequency_in_words(run.scene, found.omega)} the {run.watched_name} is {size} half "
        f"peak-to-peak{error}",
        unknown,
        ["nothing vibrates"] if found.still else _crack_and_verdict(run, found, faces),
    )


def _crack_and_verdict(run: Answer, found: PeriodicSolution, faces: str) -> list[str]:
    """What the crack does, the error by friction left out, and the verdict."""
    said = []
    if run.structure.n_pairs and found.contact is not None:
        values, what = found.faces, "the crack opens" if faces != "pairs" else "contact opens"
        share = run.stated.stated("opening")[0] if run.stated is not None else 0.0
        within = f", estimated error {error_in_words(share)}," if 0.0 < share < np.inf else ""
        said.append(
            f"{what} by {quantity(values['opening'], 'm')}{within} and is closed for "
            f"{percent(values['closed_share'])} of the period"
            if found.breathes
            else LINEAR
        )
    least = max(run.scene.harmonic_balance.tolerance or 0.0, FRICTION_MATTERS)
    friction = {} if run.stated is None else run.stated.parts.get("friction", {})
    part = friction.get(run.watched[0].column("amplitude"))
    if part is not None and part.gci > least and not run.scene.has_friction:
        said.append(f"friction left out: about {percent(part.gci)}")
    return [*said, *in_place_of(found.stability, found.amplitude(run.watched_dof))]


def _of_curve(run: Answer) -> Said:
    found: ResponseCurve = run.result
    top, axis = found.top(run.watched_dof), parameter_axis(found.parameter, run.scene.in_hertz)
    size, place = quantity(top.amplitude, "m"), in_unit(axis, top.value)
    unknown = unknown_error(run)
    error = "" if unknown else _error(run, instead=", its error is not estimated")
    known = f"the largest response of the {run.watched_name} is {size} half peak-to-peak"
    if top.at_end and top.index == len(found) - 1 and not found.complete:
        known = f"the response of the {run.watched_name} grows up to where the curve ended, {size} "
        known += f"half peak-to-peak at {place}"
    elif top.at_end:
        known += f", {RISING_AT_END}, {place}{error}"
    else:
        share = run.stated.stated(run.stated.resonance)[0] if run.stated is not None else 0.0
        within = f" within {error_in_words(share)}" if 0.0 < share < np.inf else ""
        known += f" at {place}{within}{error}"
    others = at_rest(found.indicators(run.watched_dof).closed_share)
    if found.multipliers is not None:
        names, counts = np.unique(found.verdicts, return_counts=True)
        shares = (f"{n} {name}" for n, name in zip(counts, names, strict=True))
        others.append(f"{', '.join(shares)} of {len(found)} points")
    else:
        others.append("stability not examined")
    outcome = "curve complete" if found.complete else "the curve ended early"
    if found.status == INTERRUPTED:
        outcome = "curve interrupted"
    return Said(outcome, known, unknown, others)


def _of_history(run: Answer) -> Said:
    found: TimeHistory = run.result
    asked, name = run.scene.integration or Integration(), run.watched_name
    if asked.free:
        sizes = np.ptp(found.by_period(found.displacement([run.watched_dof])[:, 0]), axis=1) / 2.0
        first, last = (quantity(float(size), "m") for size in sizes[[0, -1]])
        known = f"the {name} falls from {first} to {last} half peak-to-peak over {found.periods} "
        early = [] if found.periods >= asked.periods else ["the decay ended early"]
        return Said("integrated", f"{known}periods", others=["free decay", *early])
    settled, size = found.settled <= asked.settle, found.indicators(run.watched_dof).amplitude
    place = frequency_in_words(run.scene, run.scene.excitation.omega)
    known = f"at {place} the {name} is {quantity(size, 'm')} half peak-to-peak"
    change = f"{found.periods} of {asked.periods} periods: one period shows no change"
    if np.isfinite(found.settled):
        change = f"{found.periods} periods: relative change over the last one {found.settled:.2g}"
    if (distance := found.distance) < 1.0:
        change += f", estimated distance from the settled motion {distance:.2g}"
    outcome = "settled" if settled else "the motion has not settled"
    return Said("integrated", known, others=[f"{outcome} after {change}"])


_SAID: dict[str, Callable[[Answer], Said]] = {
    Modes.KIND: _of_modes,
    PeriodicSolution.KIND: _of_solution,
    ResponseCurve.KIND: _of_curve,
    TimeHistory.KIND: _of_history,
}


def in_place_of(judged: Stability | None, amplitude: float) -> list[str]:
    """The verdict in words, and what the motion from rest does in place of a solution of some
    amplitude [m]."""
    if judged is None:
        return ["stability not examined"]
    said = [
        {"undecided": "stability undecided", "irregular": judged.reason}.get(
            judged.verdict, judged.verdict
        )
    ]
    if judged.from_rest:
        size = ""
        if np.isfinite(judged.rest_amplitude) and amplitude > 0.0:
            ratio = judged.rest_amplitude / amplitude
            size = f", {ratio:.3g} times as large ({quantity(judged.rest_amplitude, 'm')})"
        said.append(f"the motion from rest {judged.from_rest}{size}")
    return said
