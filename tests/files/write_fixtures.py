"""Write the files that later versions must read: small results of each kind, and their numbers.

.venv/bin/python tests/files/write_fixtures.py tests/files/fixtures/VERSION.zip
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

PLATE: dict[str, Any] = {
    "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
    "crack": {"edge": "left", "height": 0.05, "length": 0.05},
    "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.02},
    "excitation": {"point": [0.1, 0.1], "force_sin": [100.0, 0.0], "omega": 1800.0},
    "contact": {"law": "penalty", "stiffness": 1e9, "pairs": "all"},
    "harmonic_balance": {"harmonics": 3},
    "mesh": {"layout": "grid", "cells": "quadrilateral", "order": 1, "columns": 2, "rows": 4},
    "curve": {"start": 1500.0, "stop": 1600.0},
    "integration": {"method": "events", "periods": 2, "steps_per_period": 16},
}
RIGID = {"contact": {"law": "unilateral"}, "harmonic_balance": {}, "reduction": {"modes": 3}}
FRICTION = RIGID | {"contact": {"law": "unilateral", "friction": 0.3}}
FRICTION |= {"harmonic_balance": {"harmonics": 5}}
SHORT = {"harmonic_balance": {}, "curve": {"start": 1510.0, "stop": 1515.0}}
SWEPT = {"sweep": {"over": {"excitation.omega": [1500.0, 1800.0]}}}
GROWING = RIGID | {
    "harmonic_balance": {"harmonics": 5},
    "mesh": {"layout": "graded", "order": 2, "size": 0.05, "lip_elements": 4},
    "growth": {"until": 0.052, "rate": 1e-11, "exponent": 3.0, "life_tolerance": 0.5},
}
COARSE = ["mesh.lip_elements=4", "mesh.size=0.04", "identify.finer=1.0"]
COMMANDS: dict[str, tuple[str, dict[str, Any]]] = {
    "modes": ("modes", {}),
    "solution": ("solve", {}),
    "solution_rigid": ("solve", RIGID),
    "curve": ("curve", {}),
    "curve_exact": ("curve", RIGID | {"curve": {"start": 1510.0, "stop": 1530.0}}),
    "integration": ("integrate", {}),
    "sweep": ("sweep", SWEPT),
    "verification": ("verify", {}),
    "growth": ("grow", GROWING),
    "solution_friction": ("solve", FRICTION),
    "curve_friction": ("curve", FRICTION | SHORT),
    "integration_friction": ("integrate", FRICTION),
}
"""Command, and the tables of its scene that are others than the plate's, of each file."""


def numbers(name: str, path: Path) -> dict[str, Any]:
    """What a file must give, by names that all versions have."""
    import fenics_crack as fc

    if name == "sweep":
        table = fc.SweepResult.load(path)
        return {"response": table["response"], "gap": table.gap((1,))[0]}
    if name == "growth":
        growth = fc.Growth.load(path)
        return {"length": growth.length[::50], "life": growth.life, "factor": growth.factor}
    if name in ("verification", "identify"):
        from fenics_crack.cli.kinds import restore_result
        from fenics_crack.files.store import read_result_file

        result: Any = restore_result(read_result_file(path))
        if name == "identify":
            return {
                key: result.identification_summary[key] for key in ("estimate", "log_bayes_factor")
            }
        return {"values": result.values, "stated": {q: result.stated(q)[0] for q in result.values}}
    run = fc.load_run(path)
    found: Any = run.result
    if name == "modes":
        return {"omega": found.omega}
    if "integration" in name:
        return {"time": found.time, "gap": found.gap[-1], "force": found.contact_force[-1]}
    kept_numbers = {"omega": found.omega, "amplitude": found.amplitude(run.watched_dof)}
    if "curve" in name:
        kinds = [point.kind for point in found.bifurcations]
        return kept_numbers | {"multipliers": np.abs(found.multipliers), "kinds": kinds}
    multiplier = np.abs(found.stability.multipliers).max()
    kept_numbers |= {"total": found.report.total, "multiplier": multiplier}
    return kept_numbers | {
        "error": run.errors.stated("amplitude")[0],
        "verdict": found.stability.verdict,
    }


def program(*words: object) -> None:
    """Run the program, whatever it misses."""
    command = [sys.executable, "-m", "fenics_crack", *map(str, words), "--quiet"]
    subprocess.run(command, check=False)


def main(archive: Path) -> None:
    """Write all of them, and ``numbers.json``."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive_file:
            for path in sorted([*folder.glob("*.h5"), folder / "numbers.json"]):
                archive_file.write(path, path.name)


def write(folder: Path) -> None:
    """Write them into a folder, by way of the folder "work" in it."""
    import fenics_crack as fc

    work = folder / "work"
    work.mkdir()
    for name, (command, tables) in COMMANDS.items():
        scene = work / f"{name}.toml"
        scene.write_text(fc.Scene.from_mapping(PLATE | tables).as_toml())
        program(command, scene, "--output", work / name)
        for result_path in (work / name).glob("*[a-z].h5"):  # growth_1.h5 is a sweep of its own
            if result_path.name != "prepared.h5":
                result_path.rename(folder / f"{name}.h5")
    program("new", work / "plate.toml", "--identify")
    options = [word for change in COARSE for word in ("--set", change)]
    measured_path = work / "plate_measured.csv"
    program("identify", work / "plate.toml", measured_path, *options, "--output", work)
    for file in ("identify.h5", "posterior.png"):
        (work / file).rename(folder / file)  # read together
    numbers_by_name = {path.stem: numbers(path.stem, path) for path in sorted(folder.glob("*.h5"))}
    text = json.dumps(numbers_by_name, indent=1, default=lambda array: np.asarray(array).tolist())
    (folder / "numbers.json").write_text(text + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
