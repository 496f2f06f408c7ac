"""pyHarm: its sweep by arc length with its defaults, then a solution at the load's frequency.

https://github.com/drti/pyHarm
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from problem import Answer, Problem
from pyHarm.Maestro import Maestro

PACKAGE, REQUIREMENTS = "pyHarm-os", ("pyHarm-os==1.2.2",)
HARMONICS, SAMPLES, FROM, STEP, LIMIT = 10, 256, 0.9, 0.01, "00:00:01:00"


def solve(problem: Problem) -> Answer:
    """From 0.9 of the frequency."""
    problem.only("penalty")
    logging.disable(logging.CRITICAL)
    model = problem.in_gaps()
    parts = {"M": model.mass, "K": model.stiffness, "C": model.damping}
    load = model.load(HARMONICS)
    load = np.vstack([load[:1], np.zeros_like(load[:1]), load[1:]])
    links: dict[str, Any] = {}
    for order, (cos, sin) in enumerate(zip(load[::2], load[1::2], strict=True)):
        for dof in np.flatnonzero(np.hypot(cos, sin)):
            links[f"load{order}.{dof}"] = {
                "type": "GOForcing", "connect": {"body": [dof]}, "dirs": [0], "dto": 0, "ho": order,
                "amp": np.hypot(cos, sin)[dof] if order else cos[dof],
                "phi": np.arctan2(sin[dof], cos[dof]) if order else 0.0,
            }  # fmt: skip
    for dof, (k, clearance) in enumerate(zip(model.normal, model.clearance, strict=True)):
        links[f"stop{dof}"] = {"type": "PenaltyUnilateralGap", "connect": {"body": [dof]},
                               "dirs": [0], "g": clearance, "k": k}  # fmt: skip

    def study(begin: float) -> Any:
        sweep = {
            "study": "frf", "puls_inf": begin, "puls_sup": problem.omega * (1.0 + 1e-12),
            "puls_start": begin, "ds0": STEP * problem.omega, "ds_max": STEP * problem.omega,
            "stopper_options": {"timeout": {"status": True, "timeout": LIMIT}}, "verbose": False,
        }  # fmt: skip
        body = {"matrix": parts, "ndofs": 1, "nnodes": len(model.mass), "matching": [0]}
        system = {"type": "Base", "nh": HARMONICS, "nti": SAMPLES}
        return Maestro({
            "system": system, "substructures": {"body": body}, "connectors": links,
            "kinematics": {}, "analysis": {"sweep": sweep},
        }).nls["sweep"]  # fmt: skip

    sweep, target = study(FROM * problem.omega), study(problem.omega)
    sweep.Solve()
    points = [point.x for point in sweep.SolList if point.flag_accepted]
    target.initialise(points[-1][:-1] if points else None)
    point = target.SolList[0]
    rows = point.x[:-1].reshape(2 * HARMONICS + 1, -1)
    words = f"{len(points)} of {len(sweep.SolList)} points of the sweep accepted"
    return Answer(gap=model.gap(rows), converged=bool(point.flag_accepted), message=words)
