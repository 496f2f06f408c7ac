"""How a crack grows under the vibration of its plate, and how the vibration changes with it.

At each length a the vibration is periodic and settled: growth by a cycle is far less than what
changes it. With the effective range of K_I of the vibration itself, closed lips and all,

    da/dN = C (delta K_eff / (1 - R)^(1 - gamma))^m,      N = int da / (da/dN),

C in m per cycle at 1 MPa m^1/2 (Paris, Erdogan, Journal of Basic Engineering 85, 1963, 528;
closure: Elber, ASTM STP 486, 1971, 230; R: Walker, ASTM STP 462, 1970, 1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.fem.build import with_crack_length
from fenics_crack.growth.path import LengthPath, solve_lengths
from fenics_crack.growth.result import Growth
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Scene, check_known, without_tips
from fenics_crack.scene.tables import Growth as Law
from fenics_crack.study.run import solve
from fenics_crack.study.stated_errors import stated_errors
from fenics_crack.table import TURN, counted

__all__ = ["grow"]

POINTS = 200
"""Lengths of the table."""
MEGA = 1e6
"""Pa m^1/2 in which rates are measured."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Of the integral over each of the table's steps."""
TURNS_ASIDE = math.radians(10.0)
"""From which on a crack is said not to grow straight on."""
SETTLES = 2.0
"""Times 1 / (xi w), in which the run-up of a single mode must pass the width 2 xi f at least:
its growth with m = 3 is then 3 % below the steady one's."""


def grow(
    scene: Scene,
    folder: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
) -> Growth:
    r"""Let the edge crack of a plate grow under its vibration (collective).

    By the table ``[growth]`` of the scene: from ``crack.length`` to ``growth.until``,

    .. math:: N = \int \frac{da}{C (\Delta K_{eff} / (1 - R)^{1 - \gamma})^m}.

    Few lengths are solved; between them ln delta K is a spline, refined until the cycles are known
    to ``growth.life_tolerance``. Ranks share the lengths.

    Parameters
    ----------
    scene : Scene
        Of a plate with one crack from an edge, and a table ``[growth]``.
    folder : path, optional
        For the files of what is solved. Where they exist, of the same scene, they are taken: so a
        run that was killed goes on. Default: nothing is kept.
    comm : MPI.Comm
        The ranks.
    progress : bool
        Show bars.

    Returns
    -------
    Growth
        Length, frequencies and stress intensities over the cycles, and how sure the life is.

    Raises
    ------
    InputError
        The scene has no such crack or table, or its crack does not become longer.
    ConvergenceError
        A length cannot be solved.

    Examples
    --------
    >>> keys = {"until": 0.055, "rate": 1e-11, "exponent": 3.0}
    >>> growing = scene.replace({f"growth.{key}": value for key, value in keys.items()})
    >>> fc.grow(growing).life  # doctest: +SKIP
    """
    scene = _checked(with_crack_length(scene, comm))
    law = scene.given("growth")

    def share_of_error(path: LengthPath, errors: np.ndarray) -> np.ndarray:
        length, cycles, _ = _integrated(path, law)
        steps = np.diff(np.interp(path.lengths, length, cycles))
        return np.asarray(law.exponent * errors * steps / max(float(steps.sum()), 1e-300))

    where = None if folder is None else Path(folder)
    path, missed = solve_lengths(scene, share_of_error, where, comm, progress=progress)
    length, cycles, end = _integrated(path, law)
    half = float(np.interp(0.5 * cycles[-1], cycles, length))
    vibration = on_root(comm, lambda: _error_at(scene, path, half))
    strength = np.log(path.at("driving", length) / MEGA)
    over = np.diff(cycles)
    mean = abs(float(np.average(strength, weights=_shares(over))))
    errors = {
        "rate": law.rate_deviation,
        "exponent": law.exponent_deviation * mean,
        "vibration": law.exponent * vibration,
        "interpolation": missed,
    }
    seen = {name: path.at(name, length) for name in path.columns}
    pace = TURN / seen["omega"]
    time = np.append(0.0, np.cumsum(0.5 * (pace[1:] + pace[:-1]) * over))
    return Growth(
        scene, length, cycles, time, seen["omega"], seen["omega_open"], seen["omega_bilinear"],
        seen["response"], seen["K_max"], seen["K_min"], seen["delta_K_effective"],
        seen["K_II_max"], _rate(path, law, length), end, path.lengths, errors,
        tuple(_remarks(scene, path, seen, length, vibration)),
    )  # fmt: skip


def _shares(steps: np.ndarray) -> np.ndarray:
    """Of points in steps between them, by the trapezoidal rule, not all zero: (n + 1,)."""
    found = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))
    return found if np.any(found) else np.ones_like(found)


def _checked(scene: Scene) -> Scene:
    """A scene whose crack can grow; InputError where it cannot."""
    law = scene.given("growth")
    check_known(without_tips(scene), "growth", "a table")
    crack = scene.given("crack")
    if scene.mesh.layout != "graded":
        allowed = "'graded' with [growth], which meshes many lengths"
        raise InputError("mesh.layout", scene.mesh.layout, allowed)
    if scene.cracks or crack.edge is None:
        allowed = "one crack from an edge with [growth]: its tip is the one that grows"
        raise InputError("crack", "several tips", allowed)
    if law.drive == "spectrum" and scene.excitation.order is not None:
        allowed = "another one with excitation.order: the speed of the rotor sets the frequency"
        raise InputError("growth.drive", law.drive, allowed)
    width = scene.geometry.width
    assert width is not None and crack.length is not None
    if not crack.length < law.until < width:
        allowed = f"between crack.length = {crack.length:g} and geometry.width = {width:g}"
        raise InputError("growth.until", law.until, allowed)
    return scene


def _rate(path: LengthPath, law: Law, lengths: np.ndarray) -> np.ndarray:
    """da/dN [m] at some lengths."""
    return np.asarray(law.rate * (path.at("driving", lengths) / MEGA) ** law.exponent)


def _integrated(path: LengthPath, law: Law) -> tuple[np.ndarray, np.ndarray, str]:
    """Lengths, the cycles until then, and how it ends."""
    length = np.linspace(path.lengths[0], path.lengths[-1], POINTS)
    arrested = path.at("delta_K_effective", length) < law.threshold
    broken = path.at("K_max", length) >= (law.toughness or math.inf)
    over = np.flatnonzero(arrested | broken)
    end = "reached"
    if len(over):
        end = "arrested" if arrested[over[0]] else "broken"
        length = length[: int(over[0]) + 1]
    half = 0.5 * np.diff(length)[:, None]
    places = length[:-1, None] + half * (1.0 + NODES)
    steps = np.sum(half * WEIGHTS / _rate(path, law, places.ravel()).reshape(places.shape), axis=1)
    return length, np.append(0.0, np.cumsum(steps)), end


def _error_at(scene: Scene, path: LengthPath, length: float) -> float:
    """Relative error of the effective range by mesh, modes and harmonics at a length."""
    drive = scene.given("growth").drive
    omega = float(path.at("omega", np.array([length]))[0])
    if drive == "spectrum":
        omega = float(path.leading[np.abs(path.lengths - length).argmin()])
    place = {
        "crack.length": length,
        "excitation.omega": omega,
        "output.quantities": ("delta_K_effective",),
    }
    run = solve(scene.replace(place), MPI.COMM_SELF)
    stated = stated_errors(run, run.result, of_peak=drive != "frequency")
    return stated.stated("delta_K_effective")[0]


def _remarks(
    scene: Scene,
    path: LengthPath,
    seen: Mapping[str, np.ndarray],
    length: np.ndarray,
    vibration: float,
) -> list[str]:
    """What is in doubt of a crack's growth."""
    found = []
    one, two = seen["K_max"], seen["K_II_max"]
    turn = 2.0 * np.arctan(2.0 * two / (one + np.sqrt(one**2 + 8.0 * two**2)))
    if np.any(turning := turn > TURNS_ASIDE):
        at = length[np.argmax(turning)]
        found.append(
            f"from {at:.4g} m on a straight crack is no longer right: it would turn by up to "
            f"{math.degrees(turn.max()):.0f} degrees, K_II_max being up to "
            f"{np.max(two / one):.0%} of K_max"
        )
    law = scene.given("growth")
    if law.run_up is not None:
        start, stop, rate = law.run_up
        lowest = max(start, float(seen["omega_bilinear"].min()) / TURN)
        slow = 2.0 * TURN * (path.damping * lowest) ** 2 / rate
        if lowest < stop and slow < SETTLES:
            found.append(
                f"the run-up is through the width of the resonance in {slow:.2g} of the times in "
                "which a vibration settles: it becomes less than the steady one, which is taken, "
                "and the crack grows less"
            )
    if path.not_stable:
        count = counted(len(path.not_stable), "length")
        found.append(f"at {count} the vibration is unstable, or its stability undecided")
    if path.jumps:
        found.append(
            f"near {path.jumps[0]:.4g} m the stress intensity jumps: several vibrations may be "
            "possible there, of which growth takes the one that is found first; a curve shows them"
        )
    found += [f"a crack of {at:.4g} m was not solved: {why}" for at, why in path.failed]
    if not math.isfinite(vibration):
        found.append("the error of the vibration is not known")
    return found
