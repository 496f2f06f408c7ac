"""The resonance of a scene at its own load: the one that all commands name.

It is the phase resonance of the mode nearest to the load's frequency
(:mod:`fenics_crack.curves.resonance`), with as many harmonics as its amplitude takes. That of a
smooth law is not defined; friction is left out.

An engine order n meets it at the speed W of a rotor at which n W is its frequency there. The search
begins where the order meets an estimate w_0 at the speed W_0,

    (n W)^2 = w_0^2 + S (W^2 - W_0^2),      S = d(w^2) / d(W^2) of the mode with an open crack.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fenics_crack.balance.problem import Problem
from fenics_crack.basics.causes import OPTIONAL_CAUSES, REQUIRED_CAUSES
from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.tables import error_in_words, quantity, without_causes
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, friction_of
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import RitzProjection, RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import REFUSALS, Study, reduced, reduction_of

SOUGHT_MODES = 10
"""Modes of the whole structure in which it is sought."""
AMPLITUDE_TOLERANCE = 0.1
"""Relative error of the amplitude that is enough to name it."""
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


NOT_SOUGHT = AtLoad(unknown="not sought")


def meeting_speed(order: float, speed: float, omega: float, slope: float) -> float:
    """Return the rotor speed W [rad/s] at which an engine order n meets a natural frequency.

    Parameters
    ----------
    order : float
        n.
    speed, omega : float
        W_0 and w_0 [rad/s].
    slope : float
        S.

    Returns
    -------
    float
        nan if the order never meets it.
    """
    square = (omega**2 - slope * speed**2) / (order**2 - slope) if order**2 > slope else -1.0
    return math.sqrt(square) if square > 0.0 else math.nan


def resonance_of(study: Study, estimates: np.ndarray, slopes: np.ndarray) -> AtLoad:
    """Find the resonance of a study, not reduced, at its own load (collective).

    Parameters
    ----------
    estimates : (m,) [rad/s]
        Estimated resonances of its modes, at its speed.
    slopes : (m,)
        S of each mode, by which an engine order meets its estimate.

    Returns
    -------
    AtLoad
        Without a resonance, the reason.
    """
    scene, whole, law = study.scene, study.structure, study.contact
    if law is None:
        return AtLoad(unknown="there is no crack")
    order, reduction = scene.excitation.order, reduction_of(scene, whole)
    n_modes = min(SOUGHT_MODES, whole.n_dofs if reduction is None else reduction.modes)
    mode = int(np.argmin(np.abs(estimates - scene.excitation.omega)))
    omega = float(estimates[mode])
    try:
        if order is not None and whole.rotation is not None and scene.disk is None:
            speed = meeting_speed(order, scene.speed, omega, slopes[mode])
            if math.isnan(speed):
                raise ConvergenceError(f"engine order {order} does not meet it")
            rotor = RunUpStructure(RitzProjection.of_range(whole, speed, speed, n_modes), speed)
            return at_load(scene, law, rotor, order * speed, "speed", with_rest=True)
        if scene.disk is not None or (reduction is None and is_small(whole)):
            structure = reduced(study, judged=False).structure
        else:
            structure = reduce_structure(whole, modes=n_modes, method="massless", reference=False)
        return at_load(scene, law, structure, omega, with_rest=True)
    except REFUSALS as error:
        return AtLoad(unknown=str(error))


def at_load(
    scene: Scene,
    law: ContactLaw,
    structure: Structure,
    omega: float,
    parameter: str = "omega",
    *,
    with_rest: bool = False,
) -> AtLoad:
    """Find the resonance of a small structure under a scene's load, without friction.

    Parameters
    ----------
    omega : float [rad/s]
        Load frequency at which the search begins.
    parameter : "omega" or "speed"
        Quantity that follows the resonance, as in :func:`fenics_crack.resonance_at`.
    with_rest : bool
        Find the resonance under a small load, too.

    Raises
    ------
    InputError, ConvergenceError, LinAlgError
        There is no resonance, or it is not found.
    """
    from fenics_crack.curves.resonance import at_small_load, resonance_at  # where one is sought

    balance, friction = scene.harmonic_balance, friction_of(law)
    law = law if friction is None else friction.law
    problem = Problem(structure, omega, law, balance.harmonics, balance.samples)
    resonance = resonance_at(problem, parameter=parameter, tolerance=AMPLITUDE_TOLERANCE)
    rest = resonance.value if with_rest else math.nan
    # Only a mean load or a clearance holds pairs under a small load.
    if with_rest and (np.any(structure.force[0]) or np.any(structure.clearance)):
        rest = resonance_at(at_small_load(problem), resonance.omega, parameter).value
    if resonance.several:
        return AtLoad(resonance.value, resonance.width, rest, unknown=SEE_CURVE)
    solution, verdict = resonance.solution, "undecided"
    with suppress(*REFUSALS):
        verdict = floquet(solution.structure, solution).verdict
    amplitude = solution.amplitude()
    return AtLoad(resonance.value, resonance.width, rest, amplitude, resonance.error, verdict)
