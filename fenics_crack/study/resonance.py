"""Resonance of a scene at its own load, as all commands name it.

It is the phase resonance of the mode nearest to the load frequency
(:mod:`fenics_crack.curves.resonance`), with as many harmonics as the amplitude needs. Smooth
contact laws have no such resonance. Friction is left out.

An engine order n meets the resonance at the rotor speed W if n W is the resonance frequency at this
speed. The search begins at an estimate, from the natural frequency w_0 at the speed W_0:

    (n W)^2 = w_0^2 + S (W^2 - W_0^2),      S = d(w^2) / d(W^2) of the mode with an open crack.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fenics_crack.balance.problem import Problem
from fenics_crack.basics.causes import OPTIONAL_ERROR_CAUSES, REQUIRED_ERROR_CAUSES
from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.tables import describe_omitted_causes, format_error, format_quantity
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, friction_of, is_layered
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import RitzProjection, RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import (
    REFUSAL_EXCEPTIONS,
    Study,
    modal_reduction_or_none,
    reduce_study,
)

N_SEARCH_MODES = 10
"""Number of modes kept in the reduced structure in which a resonance is sought."""
RELATIVE_AMPLITUDE_TOLERANCE = 0.1
"""Maximum relative error, by truncated harmonics, of a stated resonance amplitude."""
SEVERAL_MODES_TEXT = "several modes answer together: follow the curve for the amplitude"


@dataclass(frozen=True)
class LoadResonance:
    """Result of the search for a scene's resonance under its load.

    Attributes
    ----------
    value, width : float [rad/s]
        Load frequency, or rotor speed under an engine order, at resonance; and half-power width.
    rest : float [rad/s]
        The frequency or speed at resonance under a small load; nan if not sought.
    amplitude : float [m]
        Half the peak-to-peak of the watched displacement.
    error : float
        Relative error of the amplitude due to truncated harmonics.
    verdict : str
        Verdict on the stability: "stable", "unstable", "irregular" or "undecided".
    unknown : str
        Reason why there is no amplitude; "" if there is one. If several modes answer together,
        ``value``, ``width`` and ``rest`` are known without an amplitude.
    mesh_error : float
        Relative error of the amplitude due to the mesh; nan if it is not estimated.
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
        """Amplitude, verdict on stability, and errors by cause, as text.

        Causes missing in the errors are named last. Without an amplitude the text is the reason.
        """
        known_error_by_cause = {"harmonics": self.error, "mesh": self.mesh_error}
        error_by_cause = (
            dict.fromkeys((*REQUIRED_ERROR_CAUSES, *OPTIONAL_ERROR_CAUSES), math.nan)
            | known_error_by_cause
        )
        missing_causes = [
            cause for cause, error in error_by_cause.items() if not math.isfinite(error)
        ]
        error_texts = [
            f"the {cause} {format_error(error)}"
            for cause, error in error_by_cause.items()
            if error > 0.0
        ]
        amplitude_text = f"{format_quantity(self.amplitude, 'm')} half peak-to-peak, {self.verdict}"
        texts = (
            f"{amplitude_text}, error due to {', '.join(error_texts) or 'none'}",
            describe_omitted_causes(missing_causes),
        )
        return self.unknown or "; ".join(filter(None, texts))

    @property
    def numbers(self) -> dict[str, float]:
        """Frequency or speed [rad/s] as "resonance", and amplitude [m] as "vibration".

        Empty if the amplitude is unknown.
        """
        return {} if self.unknown else {"resonance": self.value, "vibration": self.amplitude}


UNSOUGHT_RESONANCE = LoadResonance(unknown="not sought")


def order_crossing_speed(
    engine_order: float, reference_speed: float, omega: float, slope: float
) -> float:
    """Return the speed W at which an order meets a natural frequency.

    W solves (n W)^2 = w_0^2 + S (W^2 - W_0^2).

    Parameters
    ----------
    engine_order : float
        n, which need not be whole.
    reference_speed, omega : float [rad/s]
        Speed W_0, and natural frequency w_0 at this speed.
    slope : float
        S = d(w^2) / d(W^2).

    Returns
    -------
    float [rad/s]
        W; nan if the order never meets the frequency.
    """
    speed_squared = (
        (omega**2 - slope * reference_speed**2) / (engine_order**2 - slope)
        if engine_order**2 > slope
        else -1.0
    )
    return math.sqrt(speed_squared) if speed_squared > 0.0 else math.nan


def find_study_resonance(
    study: Study, estimated_omegas: np.ndarray, squared_omega_slopes: np.ndarray
) -> LoadResonance:
    """Find the resonance of an unreduced study under its scene's load (collective).

    The mode is the one whose estimated frequency is nearest to the load frequency.

    Parameters
    ----------
    estimated_omegas : (m,) [rad/s]
        Estimated resonance frequencies of m modes, at the study's rotor speed.
    squared_omega_slopes : (m,)
        S = d(w^2) / d(W^2) of each natural frequency w over the speed W, for an engine order.

    Returns
    -------
    LoadResonance
        If no resonance is found, only the reason ``unknown``.
    """
    scene, whole_structure, law = study.scene, study.structure, study.contact
    if law is None:
        return LoadResonance(unknown="there is no crack")
    engine_order = scene.excitation.order
    reduction = modal_reduction_or_none(scene, whole_structure)
    n_modes = min(
        N_SEARCH_MODES, whole_structure.n_dofs if reduction is None else reduction.n_modes
    )
    mode_index = int(np.argmin(np.abs(estimated_omegas - scene.excitation.omega)))
    estimated_omega = float(estimated_omegas[mode_index])
    try:
        if engine_order is not None and whole_structure.rotation is not None and scene.disk is None:
            crossing_speed = order_crossing_speed(
                engine_order, scene.speed, estimated_omega, squared_omega_slopes[mode_index]
            )
            if math.isnan(crossing_speed):
                raise ConvergenceError(f"engine order {engine_order} does not meet this mode")
            run_up_structure = RunUpStructure(
                RitzProjection.of_range(whole_structure, crossing_speed, crossing_speed, n_modes),
                crossing_speed,
            )
            return find_load_resonance(
                scene,
                law,
                run_up_structure,
                engine_order * crossing_speed,
                "speed",
                with_small_load_resonance=True,
            )
        if scene.disk is not None or (reduction is None and is_small(whole_structure)):
            structure = reduce_study(study, with_reference=False).structure
        else:
            structure = reduce_structure(
                whole_structure, modes=n_modes, method="massless", reference=False
            )
        return find_load_resonance(
            scene, law, structure, estimated_omega, with_small_load_resonance=True
        )
    except REFUSAL_EXCEPTIONS as error:
        return LoadResonance(unknown=str(error))


def find_load_resonance(
    scene: Scene,
    law: ContactLaw,
    structure: Structure,
    start_omega: float,
    parameter: str = "omega",
    *,
    with_small_load_resonance: bool = False,
) -> LoadResonance:
    """Find a small structure's resonance under a scene's load, without friction.

    Parameters
    ----------
    scene : Scene
        Source of harmonics and samples.
    law : ContactLaw
        Contact law; its friction, if any, is left out.
    structure : Structure
        Structure with its load, small enough to compute all of its modes.
    start_omega : float [rad/s]
        Load frequency at which the search begins.
    parameter : "omega" or "speed"
        Quantity that follows the resonance, as in :func:`fenics_crack.resonance_at`.
    with_small_load_resonance : bool
        Find the resonance under a small load, too.

    Raises
    ------
    InputError, ConvergenceError, LinAlgError
        There is no resonance, or it is not found.
    """
    from fenics_crack.curves.resonance import (  # where one is sought
        problem_at_small_load,
        resonance_at,
    )

    balance_table, friction_law = scene.harmonic_balance, friction_of(law)
    law = law if friction_law is None else friction_law.law
    problem = Problem(structure, start_omega, law, balance_table.harmonics, balance_table.samples)
    resonance = resonance_at(problem, parameter=parameter, tolerance=RELATIVE_AMPLITUDE_TOLERANCE)
    small_load_value = resonance.value if with_small_load_resonance else math.nan
    # A mean load or a clearance holds pairs under a small load, which compresses no layer.
    has_own_small_load_resonance = (
        np.any(structure.force[0]) or np.any(structure.clearance) or is_layered(law)
    )
    if with_small_load_resonance and has_own_small_load_resonance:
        small_load_value = resonance_at(
            problem_at_small_load(problem), resonance.omega, parameter
        ).value
    if resonance.several:
        return LoadResonance(
            resonance.value, resonance.width, small_load_value, unknown=SEVERAL_MODES_TEXT
        )
    solution, verdict = resonance.solution, "undecided"
    with suppress(*REFUSAL_EXCEPTIONS):
        verdict = floquet(solution.structure, solution).verdict
    amplitude = solution.amplitude()
    return LoadResonance(
        resonance.value, resonance.width, small_load_value, amplitude, resonance.error, verdict
    )
