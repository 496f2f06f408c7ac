"""The resonance of a scene at its own load: the one that all commands name.

It is the phase resonance of the mode nearest to the load's frequency
(:mod:`fenics_crack.curves.resonance`), with as many harmonics as its amplitude takes. That of a
smooth law is not defined; friction is left out.

An engine order n meets it at the speed W of a rotor at which n W is its frequency w there. From a
speed W_0 next to it, where it is w_0,

    (n W)^2 = w_0^2 + S x + C x^2 / 2,        x = W^2 - W_0^2,

S = d(w^2) / d(W^2) and C = dS / d(W^2) being those of the mode with an open crack.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.balance.phase import Resonance
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.causes import OPTIONAL_CAUSES, REQUIRED_CAUSES
from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.tables import error_in_words, quantity, without_causes
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, friction_of
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import Ritz, RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import REFUSALS, Study, law_of, reduced, reduction_of

SOUGHT_MODES = 10
"""Modes of the whole structure in which it is sought."""
ENOUGH = 0.1
"""Relative error of the amplitude that is enough to name it."""
NEAR_SPEED = 0.02
"""Relative change of a frequency with the speed for which its square is taken as quadratic in W^2,
and the centrifugal load as proportional to W^2."""
SEE_CURVE = "several modes answer together: see the curve"


@dataclass(frozen=True)
class AtLoad:
    """The resonance of a scene at its own load, in numbers.

    Attributes
    ----------
    value, width : float [rad/s]
        Load frequency, or speed of the rotor that an engine order follows, and half-power width.
    rest : float [rad/s]
        The same under a small load.
    amplitude : float [m]
        Half of the peak-to-peak displacement that is watched.
    error : float
        Its relative error due to truncated harmonics.
    mesh_error : float
        Its relative error due to the mesh; nan if it is not estimated.
    verdict : str
        Stability.
    unknown : str
        Why there is no amplitude; "" if there is one.
    """

    value: float = math.nan
    width: float = math.nan
    rest: float = math.nan
    amplitude: float = math.nan
    error: float = math.nan
    verdict: str = ""
    unknown: str = ""
    mesh_error: float = math.nan

    @property
    def in_words(self) -> str:
        """Amplitude, errors, causes that they leave out, and verdict; or why there are none."""
        by_cause = {"harmonics": self.error, "mesh": self.mesh_error}
        errors = dict.fromkeys((*REQUIRED_CAUSES, *OPTIONAL_CAUSES), math.nan) | by_cause
        missing_causes = [cause for cause, error in errors.items() if not math.isfinite(error)]
        known_parts = [f"the {c} {error_in_words(e)}" for c, e in errors.items() if e > 0.0]
        size = f"{quantity(self.amplitude, 'm')} half peak-to-peak, {self.verdict}"
        parts = (
            f"{size}, error due to {', '.join(known_parts) or 'none'}",
            without_causes(missing_causes),
        )
        return self.unknown or "; ".join(filter(None, parts))

    @property
    def numbers(self) -> dict[str, float]:
        """Value and amplitude by their names; none if they are unknown."""
        return {} if self.unknown else {"resonance": self.value, "vibration": self.amplitude}

    @classmethod
    def of(cls, found: Resonance, rest: float = math.nan) -> AtLoad:
        """That of a resonance, whose solution is followed for its stability."""
        if found.several:
            return cls(found.value, found.width, rest, unknown=SEE_CURVE)
        solution, verdict = found.solution, "undecided"
        with suppress(*REFUSALS):
            verdict = floquet(solution.structure, solution).verdict
        amplitude = solution.amplitude()
        return cls(found.value, found.width, rest, amplitude, found.error, verdict)


NOT_SOUGHT = AtLoad(unknown="not sought")


def meeting_speed(order: float, speed: float, omega: float, slope: np.ndarray) -> float:
    """Rotor speed W [rad/s] at which an engine order n meets a frequency; nan where it never does.

    Parameters
    ----------
    order : float
        n.
    speed, omega : float
        W_0 and w_0 [rad/s].
    slope : (2,)
        S and C.
    """
    left, rise = omega**2 - (order * speed) ** 2, order**2 - slope[0]
    root = rise**2 - 2.0 * slope[1] * left
    if rise <= 0.0 or root < 0.0:
        return math.nan
    square = speed**2 + 2.0 * left / (rise + math.sqrt(root))
    return math.sqrt(square) if square > 0.0 else math.nan


def resonance_of(study: Study, estimates: np.ndarray, slopes: np.ndarray) -> AtLoad:
    """The resonance of a study, not reduced, at its own load; why it is not known, if it is not
    (collective).

    Parameters
    ----------
    estimates : (m,) [rad/s]
        Of the frequencies of its modes at its speed: what an engine order meets first.
    slopes : (m, 2)
        S and C of each.
    """
    scene, whole, law = study.scene, study.structure, study.contact
    if law is None:
        return AtLoad(unknown="there is no crack")
    load, turns = scene.excitation, whole.rotation is not None and scene.disk is None
    mode = int(np.argmin(np.abs(estimates - load.omega)))
    try:
        if load.order is None or not turns:
            problem = _problem(scene, law, _few(study, whole), load.omega)
            found = _found_at(problem, float(estimates[mode]), tolerance=ENOUGH)
            return AtLoad.of(found, _at_rest(problem, found.omega))
        return _of_rotor(study, float(estimates[mode]), slopes[mode])
    except REFUSALS as error:
        return AtLoad(unknown=str(error))


def _of_rotor(study: Study, estimate: float, slope: np.ndarray) -> AtLoad:
    """The same where an engine order meets it, from an estimate of its frequency at the scene's
    speed and its S and C.

    The structure is that at the scene's speed, or where the order meets the estimate if that is far
    away, and its centrifugal load grows with W^2 from there."""
    scene, law, whole = study.scene, study.contact, study.structure
    order, speed = scene.excitation.order, scene.speed
    assert order is not None and law is not None

    def met(omega: float, harmonic: int = 1) -> float:
        found = meeting_speed(order, speed, omega, slope / harmonic**2)
        if math.isnan(found):
            raise ConvergenceError(f"engine order {order} does not meet it")
        return found

    there = met(estimate)
    if abs(order * there - estimate) > NEAR_SPEED * estimate:
        whole, speed, estimate = whole.rotation.at(there), there, order * there
    steady, count = whole.force[0] - whole.rotation.at_rest.force[0], len(whole.force)
    loads = np.vstack([whole.force, steady, np.zeros_like(steady)])
    setting = replace(whole.setting, weights=1.0)
    more = whole._in_setting(setting, force=loads, clamp=None, rotation=None)
    small = _few(study, more.watching(study.structure.watched_dof))

    def at(turning: float, omega: float) -> Problem:
        # The amplitude of a mode is 1 / w^2 of the load.
        weights = (omega / (order * turning)) ** 2 * np.diag(np.append(np.ones(count), [0.0, 0.0]))
        weights[0, [0, count]] = 1.0, (turning / speed) ** 2 - 1.0
        return _problem(scene, law, small.varied(load=weights), order * speed)

    first = _found_at(at(there, estimate), estimate)
    problem = at(met(first.omega, first.harmonic), first.omega)
    found = _found_at(problem, first.omega, tolerance=ENOUGH)
    rest, half = _at_rest(problem, found.omega), 0.5 * found.width
    every = found.omega - half, found.omega + half, found.omega, rest
    low, high, value, at_rest = (met(omega, found.harmonic) for omega in every)
    return AtLoad.of(replace(found, value=value, width=high - low), at_rest)


def over_speed(scene: Scene, small: Ritz, speed: float) -> AtLoad:
    """The resonance at the load of a rotor in a basis for all speeds, next to one at which the
    scene's engine order meets a natural frequency."""
    order, law = scene.excitation.order, law_of(scene, small.structure)
    assert order is not None and law is not None
    try:
        rotor = RunUpStructure(small, speed)
        problem = _problem(scene, law, rotor, order * speed)
        return AtLoad.of(_found_at(problem, parameter="speed", tolerance=ENOUGH))
    except REFUSALS as error:
        return AtLoad(unknown=str(error))


def _found_at(problem: Problem, near: float | None = None, **options: Any) -> Resonance:
    """The resonance of a problem; curves are loaded where one is sought alone."""
    from fenics_crack.curves.resonance import resonance_at

    return resonance_at(problem, near, **options)


def _at_rest(problem: Problem, resonance: float) -> float:
    """The frequency of a resonance under a small load: the same where nothing else holds pairs."""
    structure = problem.structure
    if not np.any(structure.force[0]) and not np.any(structure.clearance):
        return resonance
    from fenics_crack.curves.resonance import resonance_under_small_load

    return resonance_under_small_load(problem, resonance)


def _few(study: Study, whole: Structure) -> Structure:
    """A whole structure in few coordinates."""
    kept = reduction_of(study.scene, whole)
    if study.scene.disk is not None or (kept is None and is_small(whole)):
        return reduced(replace(study, structure=whole), judged=False).structure
    modes = min(SOUGHT_MODES, whole.n_dofs if kept is None else kept.modes)
    return reduce_structure(whole, modes=modes, method="massless", reference=False)


def _problem(scene: Scene, law: ContactLaw, structure: Structure, omega: float) -> Problem:
    """What is balanced, without friction."""
    balance, friction = scene.harmonic_balance, friction_of(law)
    law = law if friction is None else friction.law
    return Problem(structure, omega, law, balance.harmonics, balance.samples)
