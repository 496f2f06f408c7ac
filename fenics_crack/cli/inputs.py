"""What a command is given as text: a scene with its changes, measurements, arrivals.

Reading it needs NumPy alone, which loads in a tenth of the time of the libraries that compute.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fenics_crack.errors import InputError, check_count
from fenics_crack.scene.scene import Scene

if TYPE_CHECKING:
    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.identification.measurements import Measurements

__all__ = ["Inputs", "changes", "is_record", "read_inputs"]


@dataclass(frozen=True)
class Inputs:
    """What was read; None where the command is given no such thing beside its scene."""

    scene: Scene
    folder: Path  # for results
    measurements: Measurements | None = None
    arrivals: ArrivalTimes | Path | None = None  # or the result from which they are computed


def read_inputs(given: argparse.Namespace) -> Inputs | None:
    """Read the text files that a command is given; None where it has no scene, as with a record
    of ``timing``.

    Raises
    ------
    InputError
        One of them cannot be used.
    """
    if "scene" not in given or is_record(given):
        return None
    scene = Scene.load(given.scene, changes(given.set))
    seen = vars(given).get("arrivals")
    if given.command == "identify" and not vars(given).get("measurements") and seen is None:
        allowed = "given: a CSV file (fenics-crack new --identify writes one), or --arrivals"
        raise InputError("measurements", None, allowed)
    if (count := vars(given).get("count")) is not None:
        check_count("--count", count, 1)
    folder = vars(given).get("output") or Path("output") / given.scene.stem
    return Inputs(scene, folder, _measurements(given, scene), _arrivals(scene, seen))


def _measurements(given: argparse.Namespace, scene: Scene) -> Measurements | None:
    """Those of all files, and of responses before the crack."""
    files, before = vars(given).get("measurements") or (), vars(given).get("before")
    modes = vars(given).get("modes") or ()
    if not files and before is None and not modes:
        return None
    from fenics_crack.identification.measurements import UNIVERSAL, Measurements

    if modes and before is None and not any(one.suffix.lower() in UNIVERSAL for one in files):
        allowed = f"left out without frequency responses ({', '.join(UNIVERSAL)})"
        raise InputError("--modes", list(modes), allowed)
    parts = [Measurements.read(one, modes) for one in files]
    if before is not None:
        parts.append(Measurements.from_responses(before, modes, quantity="frequency_uncracked"))
    rows = sum(parts[1:], parts[0])
    if files:
        rows.check(scene)
    return rows


def _arrivals(scene: Scene, source: Path | None) -> ArrivalTimes | Path | None:
    """Arrivals as they are measured; a result as it is."""
    if source is None or source.suffix.lower() == ".h5":
        return source
    table = scene.given("tip_timing")
    from fenics_crack.arrivals.arrival_times import read_record

    blades = read_record(source, tip_radius=table.tip_radius, probes=np.radians(table.probes))
    if len(blades) > 1:
        raise InputError("arrivals", f"{source} of {len(blades)} blades", "those of one blade")
    return next(iter(blades.values()))


def is_record(given: argparse.Namespace) -> bool:
    """Tell whether ``timing`` is given a record of arrivals in place of a scene."""
    return bool(given.command == "timing" and given.scene.suffix.lower() == ".csv")


def changes(given: Sequence[str]) -> dict[str, Any]:
    """Keys and values of ``--set key=value``: TOML, or else a word; ``none`` removes a key."""
    found: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise InputError("--set", text, "key=value, for example contact.stiffness=1e9")
        value = value.strip()
        try:
            parsed = tomllib.loads(f"value = {value}")["value"]
        except (ValueError, RecursionError):
            parsed = None if value == "none" else value
        found[key.strip()] = parsed
    return found
