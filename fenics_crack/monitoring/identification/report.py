"""Report on an identification, from the summary, as also stored in a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import Conclusion, Report, Table
from fenics_crack.basics.untrusted_files import read_regular_file
from fenics_crack.files.store import IDENTIFICATION_FILE_KIND, StoredFile
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.words import key_in_words, value_in_words

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG file."""


@dataclass(frozen=True)
class IdentificationOutput:
    """Result of ``fenics-crack identify``, as read from the written files."""

    KIND: ClassVar[str] = IDENTIFICATION_FILE_KIND
    scene: Scene
    identification_summary: Mapping[str, Any]
    """Contents of ``identify.json`` (:meth:`Identification.summary`)."""
    picture_path: Path
    """Path of the picture of the posterior, a PNG file and no symbolic link."""

    @classmethod
    def from_stored_file(cls, stored_file: StoredFile) -> IdentificationOutput:
        """Read a result file, and find posterior.png in the same folder.

        Raises
        ------
        LookupError
            The file is of an older version.
        InputError
            The picture is missing, is a link, or is no PNG file.
        """
        picture_path = stored_file.path.with_name("posterior.png")
        with stored_file.yield_datasets_with_valid_numbers() as data_by_name:
            scene, identification_summary = stored_file.scene(), json.loads(data_by_name["summary"])
            if scene is None:
                raise LookupError("scene")
            if "priors" not in identification_summary:
                raise LookupError("priors")
        picture_bytes = b""
        with suppress(OSError):
            picture_bytes = read_regular_file(picture_path, follows_links=False)
        if not picture_bytes.startswith(PNG_SIGNATURE):
            raise InputError(
                "result",
                str(stored_file.path),
                f"in one folder with {picture_path.name}, which identify writes",
            )
        return cls(scene, identification_summary, picture_path)


def report_of_identification(identify_output: IdentificationOutput) -> Report:
    """Return the report of ``fenics-crack identify``: verdict, estimates, intervals and fit."""
    from fenics_crack.monitoring.identification.result import (
        MEASUREMENT_FIT_COLUMN_NAMES,  # SciPy's optimize, interpolate
    )

    identification_summary, estimate_rows = identify_output.identification_summary, []
    confidence_text = f"{100.0 * identification_summary['priors']['confidence']:g} %"
    for unknown_key, estimate_value in identification_summary["estimate"].items():
        interval_ends = identification_summary["intervals"].get(unknown_key)  # None for text values
        interval_end_texts = (
            [value_in_words(unknown_key, interval_end) for interval_end in interval_ends]
            if interval_ends
            else ["", ""]
        )
        estimate_rows.append(
            [
                key_in_words(unknown_key),
                value_in_words(unknown_key, estimate_value),
                *interval_end_texts,
            ]
        )
    estimate_table = Table(("unknown", "estimate", f"{confidence_text} from", "to"), estimate_rows)
    interval_texts = [
        f"{unknown_key} {estimate_value} ({confidence_text}: {lower_text} to {upper_text})"
        for unknown_key, estimate_value, lower_text, upper_text in estimate_rows
        if lower_text
    ]
    shown_interval_texts = interval_texts if identification_summary["verdict"] == "crack" else []
    priors_text = ", ".join(
        f"{prior_key} = {value_in_words(f'identify.{prior_key}', prior_value)}"
        for prior_key, prior_value in identification_summary["priors"].items()
    )
    return Report(
        estimate_table,
        Conclusion(
            identification_summary.get("conclusion", identification_summary["verdict"]),
            further_clauses=[*shown_interval_texts, identification_summary["reason"]],
        ),
        notes=[
            f"priors: {priors_text}",
            *(
                f"next to measure: {advice_text}"
                for advice_text in identification_summary["advice"]
            ),
        ],
        warnings=identification_summary["warnings"],
        html_page_tables={
            "Unknowns": estimate_table,
            "Measurements and predictions of the estimate": Table(
                MEASUREMENT_FIT_COLUMN_NAMES, identification_summary["measurements"]
            ),
        },
        remarks=identification_summary["remarks"],
    )
