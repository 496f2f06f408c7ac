"""Run by pyHarm's own Python for ``condensed_speed.py``: JSON in, JSON out.

A frequency sweep of a structure with penalty contacts to the ground on some dofs, by pyHarm's arc
length continuation with its tangent predictor (its defaults), then one solution at a frequency,
from the nearest point of the sweep. Compiling is not timed: a sweep of one harmonic runs first.
"""

from __future__ import annotations

import contextlib
import json
import logging
import resource
import sys
import time
from typing import Any

import numpy as np
from pyHarm.Maestro import Maestro


def maestro(job: dict[str, Any], harmonics: int, start: float, end: float) -> Maestro:
    """The system and its sweep."""
    names = ("mass", "stiffness", "damping")
    M, K, C = (np.array(job[name]) for name in names)
    return Maestro(
        {
            "system": {"type": "Base", "nh": harmonics, "nti": job["samples"]},
            "substructures": {
                "body": {
                    "matrix": {"M": M, "K": K, "C": C},
                    "ndofs": 1,
                    "nnodes": len(M),
                    "matching": [0],
                }
            },
            "connectors": {
                "load": {
                    "type": "CosinusForcing",
                    "connect": {"body": [job["loaded"]]},
                    "dirs": [0],
                    "amp": job["force"],
                }
            }
            | {
                f"stop{dof}": {
                    "type": "PenaltyUnilateralGap",
                    "connect": {"body": [dof]},
                    "dirs": [0],
                    "g": 0.0,
                    "k": job["stop"],
                }
                for dof in job["stopped"]
            },
            "kinematics": {},
            "analysis": {
                "sweep": {
                    "study": "frf",
                    "puls_inf": min(start, end),
                    "puls_sup": max(start, end),
                    "puls_start": start,
                    "sign_ds": 1 if end > start else -1,
                    "ds0": job["step"],
                    "ds_max": job["step"],
                    "solver": job["solver"],
                    "solver_options": job["solver_options"],
                    "reductors": [{"type": job["reductor"]}],
                    "stopper_options": {"timeout": {"status": True, "timeout": job["timeout"]}},
                    "verbose": False,
                }
            },
        }
    )


def from_linear(job: dict[str, Any]) -> dict[str, Any]:
    """One solution from the linear one, for ``work_precision.py``; a first one compiles."""
    M, K, C = (np.array(job[name]) for name in ("mass", "stiffness", "damping"))
    omega, count = job["at"], job["harmonics"]
    defaults = {"start": omega, "end": 0.999 * omega, "step": 1e-3 * omega,
                "reductor": "noreductor", "solver": "NewtonRaphson", "solver_options": {},
                "timeout": "00:00:05:00"}  # fmt: skip
    job = defaults | job
    amplitude = np.linalg.solve(K - omega**2 * M + 1j * omega * C, job["load"])
    start = np.zeros((2 * count + 1, len(M)))
    start[1], start[2] = amplitude.real, -amplitude.imag
    maestro(job | {"samples": 32}, 1, job["start"], job["end"]).nls["sweep"].initialise()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    single = maestro(job, count, job["start"], job["end"]).nls["sweep"]
    started = time.process_time()
    single.initialise(start.ravel())
    seconds = time.process_time() - started
    point = single.SolList[0]
    return {
        "coefficients": point.x[:-1].reshape(2 * count + 1, -1).tolist(),
        "cold": seconds,
        "converged": bool(point.flag_accepted),
        "mib": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) / 1024.0,
    }


def main() -> None:
    """Do the job on standard input."""
    job = json.load(sys.stdin)
    logging.disable(logging.CRITICAL)
    if "program" in job:
        with contextlib.redirect_stdout(sys.stderr):
            answer = from_linear(job)
        json.dump(answer, sys.stdout)
        return
    with contextlib.redirect_stdout(sys.stderr):
        warm = maestro(job | {"samples": 32}, 1, job["start"], job["end"])
        warm.nls["sweep"].initialise()
        warm.nls["sweep"].makeStep(index_insolve=1)

        sweep = maestro(job, job["harmonics"], job["start"], job["end"]).nls["sweep"]
        started = time.process_time()
        sweep.Solve()
        seconds = time.process_time() - started
        good = [point for point in sweep.SolList if point.flag_accepted]
        omega = np.array([float(point.x[-1]) for point in good])

        nearest = good[int(np.argmin(np.abs(omega - job["at"])))]
        single = maestro(job, job["harmonics"], job["at"], job["end"]).nls["sweep"]
        single.initialise(nearest.x[:-1])
        found = single.SolList[0]
    json.dump(
        {
            "seconds": seconds,
            "tried": len(sweep.SolList),
            "omega": omega.tolist(),
            "coefficients": found.x[:-1].reshape(2 * job["harmonics"] + 1, -1).tolist(),
            "residual": float(np.linalg.norm(found.R)),
        },
        sys.stdout,
    )


if __name__ == "__main__":
    main()
