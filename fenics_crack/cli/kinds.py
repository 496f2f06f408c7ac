"""Kinds of results, which no other module knows all of: their files, headings, reports, pictures
and readers. Functions are named here, and loaded when a result of their kind is met."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from typing import Any, NamedTuple

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.report import Report
from fenics_crack.cli.drawn import Drawn
from fenics_crack.files.store import Stored


class Kind(NamedTuple):
    """A kind of result, by the functions of the package that handle it: "folder.file:function".

    Attributes
    ----------
    name : str
        Of its files: "curve" for curve.h5.
    heading : str
        In a report.
    report : str
        Function of a result that builds its :class:`Report`.
    read : str
        Function of a file that has been read.
    draw : str
        Function of a result and of :class:`Drawn`; with a ``sentence`` that of one picture, of a
        result and a ``path``.
    sentence : str
        Below the one picture.
    """

    name: str
    heading: str
    report: str
    read: str
    draw: str
    sentence: str = ""


KINDS = {
    "set of modes": Kind(
        "modes", "Modes", "cli.results:report_of_modes", "runs.load:read_run",
        "cli.pictures:draw_modes_of",
    ),
    "periodic solution": Kind(
        "solution", "Steady vibration", "cli.results:report_of_solution", "runs.load:read_run",
        "cli.pictures:draw_solution",
    ),
    "response curve": Kind(
        "curve", "Response curve", "cli.results:report_of_curve", "runs.load:read_run",
        "cli.pictures:draw_curve_of",
    ),
    "sweep": Kind(
        "sweep", "Sweep", "cli.studies:report_of_sweep", "sweep.result:SweepResult.of",
        "cli.pictures:draw_sweep",
    ),
    "time history": Kind(
        "integration", "Motion in time", "cli.results:report_of_history", "runs.load:read_run",
        "cli.pictures:draw_history",
    ),
    "crack growth": Kind(
        "growth", "Growth of the crack", "fatigue.growth:report_of_growth",
        "fatigue.growth:Growth.of", "cli.pictures:draw_growth_of",
    ),
    "identification": Kind(
        "identify", "Identification",
        "monitoring.identification.report:report_of_identification",
        "monitoring.identification.report:IdentificationOutput.of", "cli.pictures:draw_identified",
    ),
    "verification": Kind(
        "verify", "Convergence study", "cli.studies:report_of_verification",
        "errors.verification:Verification.of", "draw.plot_study:draw_verification",
        "Distance of each quantity from its extrapolated value; contributions to its error.",
    ),
    "Campbell diagram": Kind(
        "campbell", "Campbell diagram", "study.campbell:report_of_campbell",
        "study.campbell:Campbell.of", "cli.pictures:draw_campbell_of",
    ),
    "nodal diameters": Kind(
        "disk", "Nodal diameters", "disk.bladed_disk:report_of_diameters",
        "disk.bladed_disk:NodalDiameters.of", "disk.plot_disk:draw_nodal_diameters",
        "Natural frequencies over the nodal diameter; rings: what the engine order excites.",
    ),
    "amplification": Kind(
        "amplification", "Mistuning", "disk.bladed_disk:report_of_amplification",
        "disk.bladed_disk:Amplification.of", "disk.plot_disk:draw_amplification",
        "Amplification factors of the patterns, and the share of patterns below a factor.",
    ),
    "tip timing": Kind(
        "timing", "Tip timing", "monitoring.timing:report_of_timing",
        "monitoring.timing:Timing.of", "cli.pictures:draw_timing",
    ),
}  # fmt: skip
"""By their ``KIND``, in the order of a report."""


def loaded(name: str) -> Callable[..., Any]:
    """A function of the package by its name, "folder.file:function"."""
    function: Callable[..., Any] = pkgutil.resolve_name(f"fenics_crack.{name}")
    return function


def report_of(result: Any) -> Report:
    """Return the report of a result (collective)."""
    report: Report = loaded(KINDS[result.KIND].report)(result)
    return report


def draw(result: Any, drawn: Drawn) -> None:
    """Draw the pictures of a result."""
    kind = KINDS[result.KIND]
    where = {"path": drawn(kind.name, kind.sentence)} if kind.sentence else {"file": drawn}
    loaded(kind.draw)(result, **where)


def result_of(stored: Stored) -> Any:
    """The result of a file that one rank has read.

    Raises
    ------
    InputError
        It is no result of a command.
    """
    if stored.kind not in KINDS:
        allowed = f"a result of one of these kinds: {', '.join(KINDS)}"
        raise InputError("result", str(stored.path), allowed)
    return loaded(KINDS[stored.kind].read)(stored)
