"""What is said of a result: large errors, stability, failed cases; one line for each kind.

Advice is by the largest part of an error, and never what the scene does already.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR, UNKNOWN, ErrorReport
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import ResponseCurve, parameter_axis
from fenics_crack.errors import MOST_HARMONICS
from fenics_crack.model.modes import damped_range
from fenics_crack.scene.scene import Scene
from fenics_crack.stability.floquet import Stability, floquet
from fenics_crack.study.run import Run
from fenics_crack.table import counted

if TYPE_CHECKING:
    from fenics_crack.sweep.result import SweepResult

__all__ = ["of_cases", "of_curve", "of_error", "of_modes", "of_stability", "of_tolerance"]

MORE = "more harmonics (harmonic_balance.harmonics, or a tolerance that chooses them)"
FINER = "a smaller harmonic_balance.tolerance"
SHOWN = 4
"""Kinds of failures that are told."""


def of_error(scene: Scene, report: ErrorReport, harmonics: int, where: str = "") -> Iterator[str]:
    """A warning of a large estimated error, with what makes it smaller."""
    if report.total <= LARGE_ERROR:
        return
    parts = ("truncation", "reduction", "sampling", "residual")
    part = max(parts, key=lambda name: getattr(report, name))
    if part == "truncation":
        wanted = MORE
        if scene.harmonic_balance.tolerance is not None:
            wanted = FINER if harmonics < MOST_HARMONICS else "more damping: H is at its limit"
    elif part == "reduction":
        wanted = "more modes (reduction.modes)"
    elif part == "sampling":
        wanted = "more samples (harmonic_balance.samples)"
    else:
        rigid = scene.contact is not None and scene.contact.law == "unilateral"
        softer = "softer contact, or contact.law = 'unilateral'"
        wanted = f"{'a load that moves the lips more' if rigid else softer}: it is rounding"
    if getattr(report, part) >= UNKNOWN:
        unsettled = f"its estimate by {part} did not settle"
        yield f"the error is unknown{where}, {unsettled}: it needs {wanted}"
        return
    yield (
        f"the estimated error is {report.total:.2g} of the gap{where}, most of it by {part}: it "
        f"needs {wanted}"
    )


def of_tolerance(scene: Scene, found: PeriodicSolution) -> list[str]:
    """A warning of a solution that does not meet the tolerance that a scene asks for."""
    tolerance = scene.harmonic_balance.tolerance
    if tolerance is None or found.report.total <= tolerance:
        return []
    return [found.status + of_modes(scene, found.report)]


def of_modes(scene: Scene, report: ErrorReport) -> str:
    """What to do where a tolerance is not met by the modes that a scene names; else empty."""
    tolerance, table = scene.harmonic_balance.tolerance, scene.reduction
    if tolerance is None or table is None or table.modes is None:
        return ""
    if not report.reduction > tolerance:
        return ""
    return (
        f"; raise reduction.modes = {table.modes}, or leave it out "
        "(--set reduction.modes=none): solve chooses the modes then"
    )


def of_stability(scene: Scene, run: Run, stability: Stability | None) -> Iterator[str]:
    """A warning of an orbit that is not known to be stable."""
    if stability is None or stability.verdict == "stable":
        return
    because = f" ({stability.reason})" if stability.reason else ""
    text = f"the orbit is {stability.verdict}{because}: a motion in time may leave it"
    hints = []
    if stability.verdict == "undecided":
        if scene.harmonic_balance.tolerance is None:
            hints.append("more harmonics")
        table = scene.damping  # None: a matrix, which damps all modes or not
        if table and not (table.of_all_modes or damped_range(run.structure) is None):
            hints.append("damping of all modes (damping.modes = 'all')")
    yield text + (f"; {' or '.join(hints)} may decide it" if hints else "")


def of_curve(run: Run[ResponseCurve]) -> Iterator[str]:
    """Warnings of a curve's errors, of its stability, and of its end."""
    found, scene = run.result, run.scene
    factor, _, unit = parameter_axis(found.parameter, scene.in_hertz)
    peak = int(np.argmax(found.amplitude(run.watched_dof)))
    looked_at = {peak, *np.linspace(0, len(found) - 1, 8).astype(int).tolist()}
    reports = {index: found.solution(index).report for index in sorted(looked_at)}
    worst = max(reports, key=lambda index: reports[index].total)
    where = f" at {factor * found.values[worst]:g} {unit}".removesuffix(" -")
    yield from of_error(scene, reports[worst], int(found.harmonics[worst]), where)
    if found.multipliers is not None and bool(np.all(found.verdicts == "undecided")):
        solution = found.solution(peak)
        reason = floquet(solution.structure, solution).reason
        yield "the stability is undecided at all points" + (f" ({reason})" if reason else "")
    if not found.complete:
        yield f"the curve ended early: {found.status}"


def of_cases(found: SweepResult) -> Iterator[str]:
    """Warnings of the cases of a sweep."""
    yield from _failures(found)
    converged = found.converged
    if large := int(np.sum(found.inexact)):
        given = found.scene.harmonic_balance.tolerance is not None
        wanted = FINER if given else MORE
        yield f"{counted(large, 'case')} with an error above {LARGE_ERROR:.0%}: {wanted}"
    verdicts = found["verdict"][converged]
    unstable, undecided = (int(np.sum(verdicts == name)) for name in ("unstable", "undecided"))
    if undecided and undecided == verdicts.size:
        yield "the stability is undecided in all cases"
    elif unstable or undecided:
        numbers = [f"{n} {word}" for n, word in ((unstable, "unstable"), (undecided, "undecided"))]
        told = " and ".join(text for text in numbers if not text.startswith("0 "))
        yield f"of {counted(verdicts.size, 'case')} {told}"
    if not found.complete:
        yield "the sweep was stopped; the same command goes on with it"


def _failures(found: SweepResult) -> Iterator[str]:
    """Failed cases, those of one reason together: reasons that differ in numbers alone are one."""
    kinds: dict[str, list[tuple[tuple[int, ...], str]]] = {}
    for index, reason in found.failed:
        kinds.setdefault(re.sub(r"[-+]?\d[\d.e+-]*", "#", reason), []).append((index, reason))
    ordered = sorted(kinds.values(), key=len, reverse=True)
    for cases in ordered[:SHOWN]:
        index, reason = cases[0]
        number = f"{counted(len(cases), 'case')} failed, the first at"
        yield f"{number} {_place(found, index)}: {reason}"
    if more := ordered[SHOWN:]:
        left = sum(map(len, more))
        yield f"{counted(left, 'case')} failed for other reasons: column status of the table"


def _place(found: SweepResult, index: Sequence[int]) -> str:
    """The swept values of a case."""
    return ", ".join(
        f"{axis.key.rpartition('.')[2]} = {axis.values[at]}"
        for axis, at in zip(found.axes, index, strict=True)
    )
