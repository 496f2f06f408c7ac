"""Check the cases of the benchmark of exact orbits, without the package.

    python benchmarks/orbits/check.py [NAME ...]

checks format, hash, and each orbit over one period by the second reference.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from second import INSTANTS, Motion

HERE = Path(__file__).parent

FEW = 20
"""Pairs up to which the second reference is followed here."""
LIMITS = {"penalty": 1e-8, "rigid": 1e-8, "friction": 1e-6, "smoothed": 1e-6}
"""Largest difference of the references, relative to the motion of the gap."""
KEYS = {
    "format", "name", "title", "source", "structure", "load", "law", "clearance", "references",
    "orbits", "hash",
}  # fmt: skip
OF_ORBIT = {
    "subharmonic", "state", "gap", "harmonics", "least", "most", "loss", "events", "multipliers",
    "verdict", "agreement",
}  # fmt: skip
GAPS = ("gap", "tangential_gap")
OPTIONAL = {"tangential_gap", "stuck", "crossings", "first"}
"""Of an orbit with friction: and the pairs that stick all the time, whose places are free within
limits, so that the orbit is one of a continuum; of one of pairs with mass: times at which pairs
open or close, as [time, pair], and the pairs that are closed at the start."""


class Damaged(Exception):
    """A case that is not what was written."""


def digest(case: dict[str, Any]) -> str:
    """SHA-256 of a case without its hash, keys sorted."""
    rest = {key: value for key, value in case.items() if key != "hash"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def sealed(case: dict[str, Any]) -> dict[str, Any]:
    """A case with its hash."""
    case_copy = json.loads(json.dumps(case))
    return {**case_copy, "hash": digest(case_copy)}


def limit(case: dict[str, Any]) -> float:
    """How near its references are."""
    return LIMITS[case["law"]["kind"]]


def apart(orbit: dict[str, Any], again: dict[str, Any]) -> float:
    """Difference of an orbit from its second reference: gap, closure and loss, relative."""
    gap, start = np.array(orbit["gap"]), again.get("start", np.array(orbit["state"]))
    size = float(max(np.ptp(orbit[name], axis=0).max() for name in GAPS if name in orbit))
    distances = [float(np.abs(gap - again["gap"]).max()) / size]
    half = 2 * (len(again["state"]) // 2)
    for part in np.split(np.arange(half), 2):
        move = np.abs(start[part]).max() or 1.0
        distances.append(float(np.abs(again["state"][part] - start[part]).max() / move))
    if "tangential_gap" in orbit:
        slide = np.array(orbit["tangential_gap"])
        distances.append(float(np.abs(slide - again["tangential_gap"]).max() / size))
    if "loss" in again:
        distances.append(abs(orbit["loss"] - again["loss"]) / abs(orbit["loss"]))
    if np.size(again.get("monodromy", ())):
        values = np.linalg.eigvals(again["monodromy"])
        largest_size = abs(complex(*orbit["multipliers"][0]))
        distances.append(abs(np.abs(values).max() - largest_size) / max(largest_size, 1.0))
    return max(distances)


def second_reference(case: dict[str, Any], orbit: dict[str, Any]) -> float:
    """How far an orbit is from the second reference, over one period from its state."""
    motion = Motion(case)
    second_passage = motion.period(
        np.array(orbit["state"]), orbit["subharmonic"], tangent=motion.size <= 40
    )
    return apart(orbit, second_passage)


def read(path: Path) -> dict[str, Any]:
    """A case from its file, with format, hash and shapes checked.

    Raises
    ------
    Damaged
        It is not what was written.
    """
    case: dict[str, Any] = json.loads(path.read_text())
    if set(case) - {"proof"} != KEYS or case["format"] != 1 or case["name"] != path.stem:
        raise Damaged(f"{path.name}: keys, format or name")
    if case["hash"] != digest(case):
        raise Damaged(f"{path.name}: hash")
    pairs = len(case["clearance"])
    for orbit in case["orbits"]:
        if set(orbit) - OPTIONAL != OF_ORBIT or np.shape(orbit["gap"]) != (INSTANTS, pairs):
            raise Damaged(f"{path.name}: an orbit")
        if not orbit["agreement"] <= limit(case):
            raise Damaged(f"{path.name}: its references differ")
    return case


def followed(case: dict[str, Any]) -> float:
    """Largest difference of its orbits from the second reference made again.

    Raises
    ------
    Damaged
        It is beyond the limit of its law.
    """
    largest_difference = max(second_reference(case, orbit) for orbit in case["orbits"])
    if not largest_difference <= limit(case):
        raise Damaged(f"{case['name']}: {largest_difference:.1e} from the second reference")
    return largest_difference


def main() -> None:
    """Check the cases named, by default all."""
    paths = sorted((HERE / "cases").glob("*.json"))
    for path in paths:
        if not sys.argv[1:] or path.stem in sys.argv[1:]:
            case = read(path)
            has_few_pairs = len(case["clearance"]) <= FEW
            print(
                f"{path.stem:20} {followed(case):.1e}" if has_few_pairs else f"{path.stem:20} hash",
                flush=True,
            )


if __name__ == "__main__":
    main()
