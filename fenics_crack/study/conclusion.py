"""Conclusion of a run: its accuracy, the doubts that its numbers alone do not show, its remarks,
and the sentence with which the program, a report and Python's ``str`` end."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import INTERRUPTED
from fenics_crack.basics.tables import closing_sentence, error_in_words, in_unit, percent, quantity
from fenics_crack.curves.curve import ResponseCurve, parameter_axis
from fenics_crack.curves.peak import AT_END
from fenics_crack.model.modal import is_small
from fenics_crack.scene.tables import Integration
from fenics_crack.study.plausibility import Remark, find_key_figures, remarks_on_scene
from fenics_crack.study.prepare import REFUSALS, Study
from fenics_crack.study.stated_errors import not_estimated
from fenics_crack.study.verification import Verification
from fenics_crack.time.march import TimeHistory


class Answer(Study):
    """Result with its study, as a conclusion needs it: a :class:`fenics_crack.study.run.Run`.

    Attributes
    ----------
    result : object
        Result of the computation.
    stated : Verification or None
        Its errors, where they were computed with it.
    """

    result: Any
    stated: Verification | None

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
    found, stated = run.result, run.stated
    if isinstance(found, PeriodicSolution) and found.report.unknown:
        return not_estimated(found.report)
    if stated is None or not is_small(run.structure):  # then the report alone has the error
        return ""
    return stated.doubt(run.watched[0].column("amplitude"))


def conclusion(run: Answer, warnings: int = 0) -> str:
    """Return the sentence with which a run ends, after so many warnings (collective)."""
    return closing_sentence(
        _outcome(run),
        unknown=unknown_error(run),
        known=_known(run),
        others=_others(run),
        warnings=warnings,
        remarks=len(run.remarks),
    )


def _outcome(run: Answer) -> str:
    """Describe how a run ended."""
    found = run.result
    if isinstance(found, PeriodicSolution):
        tolerance = run.scene.harmonic_balance.tolerance
        if not found.converged:
            return "not converged"
        missed = tolerance is not None and found.report.total > tolerance
        return "solved, but the tolerance is missed" if missed else "solved"
    if isinstance(found, ResponseCurve):
        if found.status == INTERRUPTED:
            return "curve interrupted"
        return "curve complete" if found.complete else "the curve ended early"
    if isinstance(found, TimeHistory):
        return "integrated"
    return "modes found"


def _known(run: Answer) -> str:
    """The watched amplitude and its error; of a curve the largest."""
    known = known_to(run)
    if isinstance(run.result, PeriodicSolution):
        if not run.result.report.estimated:
            return "its error is not estimated (harmonic_balance.error = false)"
        if known:
            return f"estimated error of half the peak-to-peak displacement {known}"
    if isinstance(run.result, ResponseCurve):
        top = run.result.top(run.watched_dof)
        axis = parameter_axis(run.result.parameter, run.scene.in_hertz)
        where = "at "
        if top.at_end:
            where = f"{AT_END if run.result.complete else 'rising up to where it ended'}, "
        size = quantity(top.amplitude, "m")
        how = f"estimated error {known}" if known else "its error is not estimated"
        return f"largest response {size} {where}{in_unit(axis, top.value)}, {how}"
    if run.stated is not None and run.stated.left_out:
        return run.stated.left_out
    return ""


def _others(run: Answer) -> list[str]:
    """The verdict, and what the numbers alone do not show."""
    found = run.result
    if isinstance(found, ResponseCurve):
        said = at_rest(found.indicators(run.watched_dof).closed_share)
        if found.multipliers is not None:
            names, counts = np.unique(found.verdicts, return_counts=True)
            shares = (f"{n} {name}" for n, name in zip(counts, names, strict=True))
            said.append(f"{', '.join(shares)} of {len(found)} points")
        return said
    if isinstance(found, TimeHistory):
        asked = run.scene.integration or Integration()
        if asked.free:
            return ["free decay" if found.periods >= asked.periods else "the decay ended early"]
        return [] if found.settled <= asked.settle else ["the motion has not settled"]
    if not isinstance(found, PeriodicSolution) or not found.converged:
        return []
    if found.still:
        return ["nothing vibrates"]
    said = []
    if run.structure.n_pairs and found.contact is not None and not found.breathes:
        said.append(LINEAR)
    least = max(run.scene.harmonic_balance.tolerance or 0.0, FRICTION_MATTERS)
    friction = {} if run.stated is None else run.stated.parts.get("friction", {})
    part = friction.get(run.watched[0].column("amplitude"))
    if part is not None and part.gci > least:
        said.append(f"friction left out: about {percent(part.gci)}")
    return [*said, *in_place_of(found.stability, found.amplitude(run.watched_dof))]


def in_place_of(judged: Stability | None, amplitude: float) -> list[str]:
    """The verdict in words, and what the motion from rest does in place of a solution of some
    amplitude [m]."""
    if judged is None:
        return ["stability not examined"]
    said = ["stability undecided" if judged.verdict == "undecided" else judged.verdict]
    if judged.from_rest:
        size = ""
        if np.isfinite(judged.rest_amplitude) and amplitude > 0.0:
            ratio = judged.rest_amplitude / amplitude
            size = f", {ratio:.3g} times as large ({quantity(judged.rest_amplitude, 'm')})"
        said.append(f"the motion from rest {judged.from_rest}{size}")
    return said
