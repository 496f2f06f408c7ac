"""All kinds of results: files, headings, reports, readers and pictures.

The table names the functions of each kind. A function is loaded when a result needs it.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from typing import Any, NamedTuple

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import Report
from fenics_crack.cli.given import PictureFiles
from fenics_crack.files.store import StoredFile


class ResultKind(NamedTuple):
    """Name files, heading and functions for a kind of result.

    Functions are given as texts "folder.file:function", and imported when needed.

    Attributes
    ----------
    file_stem : str
        Name of the files without ending: "curve" for curve.h5.
    page_heading : str
        Heading on the report page.
    report_function_path : str
        Function to build a :class:`Report` from a result.
    reader_function_path : str
        Function to build a result from a :class:`StoredFile`.
    drawing_function_path : str
        Function to draw a result. If ``caption`` is empty, the function draws any number of
        pictures, and has the parameter ``picture_files``, a :class:`PictureFiles`. Otherwise the
        function draws a single picture, and has the parameter ``path``.
    caption : str
        Sentence below the only picture; empty if the function draws any number of pictures.
    """

    file_stem: str
    page_heading: str
    report_function_path: str
    reader_function_path: str
    drawing_function_path: str
    caption: str = ""


RESULT_KIND_BY_NAME = {
    "set of modes": ResultKind(
        "modes", "Modes", "cli.results:report_of_modes", "runs.load:make_run_on_this_rank",
        "cli.pictures:draw_mode_shapes",
    ),
    "periodic solution": ResultKind(
        "solution", "Steady vibration", "cli.results:report_of_solution",
        "runs.load:make_run_on_this_rank", "cli.pictures:draw_solution",
    ),
    "response curve": ResultKind(
        "curve", "Response curve", "cli.curves:report_of_curve", "runs.load:make_run_on_this_rank",
        "cli.pictures:draw_curve_pictures",
    ),
    "sweep": ResultKind(
        "sweep", "Sweep", "cli.studies:report_of_sweep",
        "sweep.result:SweepResult.from_stored_file", "cli.pictures:draw_sweep",
    ),
    "time history": ResultKind(
        "integration", "Motion in time", "cli.results:report_of_history",
        "runs.load:make_run_on_this_rank", "cli.pictures:draw_history",
    ),
    "crack growth": ResultKind(
        "growth", "Growth of the crack", "fatigue.growth:report_of_growth",
        "fatigue.growth:Growth.from_stored_file", "cli.pictures:draw_crack_growth",
    ),
    "identification": ResultKind(
        "identify", "Identification",
        "monitoring.identification.report:report_of_identification",
        "monitoring.identification.report:IdentificationOutput.from_stored_file",
        "cli.pictures:copy_posterior_picture",
    ),
    "verification": ResultKind(
        "verify", "Convergence study", "cli.studies:report_of_verification",
        "errors.verification:Verification.from_stored_file", "draw.plot_study:draw_verification",
        "Distance of each quantity from its extrapolated value; contributions to its error.",
    ),
    "Campbell diagram": ResultKind(
        "campbell", "Campbell diagram", "study.campbell:report_of_campbell",
        "study.campbell:Campbell.from_stored_file", "cli.pictures:draw_campbell_diagram",
    ),
    "nodal diameters": ResultKind(
        "disk", "Nodal diameters", "disk.bladed_disk:report_of_diameters",
        "disk.bladed_disk:NodalDiameters.from_stored_file", "disk.plot_disk:draw_nodal_diameters",
        "Natural frequencies over the nodal diameter; rings: excited by the engine order.",
    ),
    "amplification": ResultKind(
        "amplification", "Mistuning", "disk.bladed_disk:report_of_amplification",
        "disk.bladed_disk:Amplification.from_stored_file", "disk.plot_disk:draw_amplification",
        "Amplification factors of the patterns; share of patterns below each factor.",
    ),
    "tip timing": ResultKind(
        "timing", "Tip timing", "monitoring.timing:report_of_timing",
        "monitoring.timing:Timing.from_stored_file", "cli.pictures:draw_tip_timing",
    ),
}  # fmt: skip
"""Kind of result by the class attribute ``KIND``, in the order of the report page."""


def load_function(function_path: str) -> Callable[..., Any]:
    """Import a function of the package from "folder.file:function"."""
    package_function: Callable[..., Any] = pkgutil.resolve_name(f"fenics_crack.{function_path}")
    return package_function


def build_report(result: Any) -> Report:
    """Build the report of a result, with the function for this kind (collective)."""
    report: Report = load_function(RESULT_KIND_BY_NAME[result.KIND].report_function_path)(result)
    return report


def draw_result(result: Any, picture_files: PictureFiles) -> None:
    """Draw all pictures of a result, and record them in ``picture_files``."""
    result_kind = RESULT_KIND_BY_NAME[result.KIND]
    path_keywords = (
        {"path": picture_files(result_kind.file_stem, result_kind.caption)}
        if result_kind.caption
        else {"picture_files": picture_files}
    )
    load_function(result_kind.drawing_function_path)(result, **path_keywords)


def restore_result(stored_file: StoredFile) -> Any:
    """Build a result object from a stored file, on this rank alone.

    Raises
    ------
    InputError
        The file holds no result of a command.
    """
    if stored_file.kind not in RESULT_KIND_BY_NAME:
        raise InputError(
            "result",
            str(stored_file.path),
            f"a result of one of these kinds: {', '.join(RESULT_KIND_BY_NAME)}",
        )
    return load_function(RESULT_KIND_BY_NAME[stored_file.kind].reader_function_path)(stored_file)
