"""Report of an identification, from the summary that its file has, too."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import Said, Table
from fenics_crack.basics.untrusted_files import content_of
from fenics_crack.files.store import IDENTIFICATION, Stored
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.words import key_in_words, value_in_words

PNG = b"\x89PNG\r\n\x1a\n"
"""Beginning of a PNG file."""


@dataclass(frozen=True)
class Identified:
    """Result of ``identify`` and the files that it has written."""

    KIND: ClassVar[str] = IDENTIFICATION
    scene: Scene
    summary: Mapping[str, Any]
    """Contents of ``identify.json``."""
    picture: Path
    """Picture of the posterior, a PNG file and no link."""

    @classmethod
    def of(cls, stored: Stored) -> Identified:
        """By its file and the picture beside it."""
        picture = stored.path.with_name("posterior.png")
        with stored.taken() as parts:
            scene, summary = stored.scene(), json.loads(parts["summary"])
            if scene is None:
                raise LookupError("scene")
            if "priors" not in summary:
                raise LookupError("priors")
        drawn = b""
        with suppress(OSError):
            drawn = content_of(picture, links=False)
        if not drawn.startswith(PNG):
            raise InputError("result", str(stored.path), f"with {picture.name} in its folder")
        return cls(scene, summary, picture)


def report_of_identification(found: Identified) -> Report:
    """Verdict, estimates with their intervals, and the fit."""
    from fenics_crack.monitoring.identification.result import (
        FIT_COLUMN_NAMES,  # SciPy's optimize, interpolate
    )

    values, rows = found.summary, []
    share = f"{100.0 * values['priors']['confidence']:g} %"
    for key, value in values["estimate"].items():
        ends = values["intervals"].get(key)  # of a word there are none
        limits = [value_in_words(key, end) for end in ends] if ends else ["", ""]
        rows.append([key_in_words(key), value_in_words(key, value), *limits])
    table = Table(("unknown", "estimate", f"{share} from", "to"), rows)
    where = [f"{key} {value} ({share}: {low} to {high})" for key, value, low, high in rows if low]
    places = where if values["verdict"] == "crack" else []
    priors = ", ".join(
        f"{key} = {value_in_words(f'identify.{key}', value)}"
        for key, value in values["priors"].items()
    )
    return Report(
        table,
        Said(values.get("conclusion", values["verdict"]), others=[*places, values["reason"]]),
        notes=[f"priors: {priors}", *(f"next to measure: {one}" for one in values["advice"])],
        warnings=values["warnings"],
        tables={
            "Unknowns": table,
            "Measurements and predictions of the estimate": Table(
                FIT_COLUMN_NAMES, values["measurements"]
            ),
        },
        remarks=values["remarks"],
    )
