"""Where a scene resonates under its load: one answer for all commands.

:func:`find_load_resonance` answers it for a structure in few coordinates: the phase resonance next
to a start frequency (:mod:`fenics_crack.curves.resonance`), with as many harmonics as the amplitude
needs. ``check`` and the stated errors start from the mode nearest to the load frequency, Campbell
diagrams from each crossing. Smooth contact laws have no such resonance. Friction is left out.

An engine order n meets the resonance at the rotor speed W if n W is the resonance frequency at this
speed. The search begins at an estimate, from the natural frequency w_0 at the speed W_0:

    (n W)^2 = w_0^2 + S (W^2 - W_0^2),      S = d(w^2) / d(W^2) of the mode with an open crack.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

from fenics_crack.balance.problem import Problem
from fenics_crack.basics.causes import OMITTABLE_ERROR_CAUSES, REQUIRED_ERROR_CAUSES
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    describe_omitted_causes,
    format_error,
    format_quantity,
)
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw, friction_of, is_layered
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import RitzProjection, RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import (
    SINGLE_COMPUTATION_FAILURES,
    Study,
    modal_reduction_or_none,
    reduce_study,
)

N_RESONANCE_SEARCH_MODES = 10
"""Number of modes kept in the reduced structure in which a resonance is sought."""
MAX_AMPLITUDE_ERROR_BY_HARMONICS = 0.1
"""Maximum relative error, by truncated harmonics, of a stated resonance amplitude."""
SEVERAL_MODES_REASON = "several modes answer together: follow the curve for the amplitude"


@dataclass(frozen=True)
class ResonanceUnderLoad:
    """Result of the search for a scene's resonance under its load.

    Attributes
    ----------
    value : float [rad/s]
        Load frequency at resonance; under an engine order the rotor speed at resonance.
    width : float [rad/s]
        Half-power width of the resonance, in load frequency or rotor speed.
    omega_or_speed_under_small_load : float [rad/s]
        Load frequency or rotor speed at resonance under a small load; nan if not sought.
    amplitude : float [m]
        Half the peak-to-peak of the watched displacement.
    error : float
        Relative error of the amplitude due to truncated harmonics.
    verdict : str
        Verdict on the stability: "stable", "unstable", "irregular" or "undecided".
    unknown : str
        Reason why there is no amplitude; "" if there is one. If several modes respond together,
        ``value``, ``width`` and ``omega_or_speed_under_small_load`` are known, but the amplitude is
        not.
    amplitude_mesh_error : float
        Relative error of the amplitude due to the mesh; nan if it is not estimated.
    """

    value: float = math.nan
    width: float = math.nan
    omega_or_speed_under_small_load: float = math.nan
    amplitude: float = math.nan
    error: float = math.nan
    verdict: str = ""
    unknown: str = ""
    amplitude_mesh_error: float = math.nan

    @property
    def amplitude_and_errors_text(self) -> str:
        """Amplitude, verdict on stability, and errors by cause, as text.

        Causes that no error includes are named last. Without an amplitude, the text is the reason.
        """
        known_error_by_cause = {"harmonics": self.error, "mesh": self.amplitude_mesh_error}
        error_by_cause = (
            dict.fromkeys((*REQUIRED_ERROR_CAUSES, *OMITTABLE_ERROR_CAUSES), math.nan)
            | known_error_by_cause
        )
        missing_causes = [
            error_cause
            for error_cause, error_of_cause in error_by_cause.items()
            if not math.isfinite(error_of_cause)
        ]
        error_texts = [
            f"the {error_cause} {format_error(error_of_cause)}"
            for error_cause, error_of_cause in error_by_cause.items()
            if error_of_cause > 0.0
        ]
        amplitude_text = f"{format_quantity(self.amplitude, 'm')} half peak-to-peak, {self.verdict}"
        amplitude_and_missing_cause_texts = (
            f"{amplitude_text}, error due to {', '.join(error_texts) or 'none'}",
            describe_omitted_causes(missing_causes),
        )
        return self.unknown or "; ".join(filter(None, amplitude_and_missing_cause_texts))

    @property
    def numbers(self) -> dict[str, float]:
        """Frequency or speed at resonance, and amplitude, by name.

        "resonance" is the load frequency or rotor speed [rad/s], "vibration" the amplitude [m].
        Empty if the amplitude is unknown.
        """
        return {} if self.unknown else {"resonance": self.value, "vibration": self.amplitude}


UNSOUGHT_RESONANCE = ResonanceUnderLoad(unknown="not sought")


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


FACTOR_AND_UNIT_BY_CURVE_PARAMETER = {
    "omega": (1.0, "rad/s"), "frequency": (RAD_PER_TURN, "Hz"), "speed": (1.0, "rad/s"),
    "rpm": (RAD_PER_S_PER_RPM, "rpm"),
}  # fmt: skip
"""Factor from a curve's parameter to [rad/s], and the parameter's unit, by parameter."""


def curve_parameter_at_crossing(
    scene: Scene, parameter: str, omega: float, slope: float, harmonic: float = 1.0
) -> float:
    """Return a curve's parameter at which a load harmonic meets a natural frequency.

    Parameters
    ----------
    scene : Scene
        Scene with the engine order, if any, and the rotor speed.
    parameter : "omega", "frequency", "speed" or "rpm"
        Parameter of the curve.
    omega : float [rad/s]
        Natural frequency at the scene's rotor speed.
    slope : float
        S = d(omega^2) / d(W^2) over the rotor speed W.
    harmonic : float
        Multiple of the load frequency.

    Returns
    -------
    float [rad/s]
        Load frequency or rotor speed; nan if an engine order never meets the frequency.
    """
    engine_order = scene.excitation.order
    if parameter in ("speed", "rpm") and engine_order is not None:
        return order_crossing_speed(harmonic * engine_order, scene.speed, omega, slope)
    return omega / harmonic


def find_study_resonance(
    study: Study, estimated_omegas: np.ndarray, squared_omega_slopes: np.ndarray
) -> ResonanceUnderLoad:
    """Find the resonance of an unreduced study under its scene's load (collective).

    The mode is the one whose estimated frequency is nearest to the load frequency.

    Parameters
    ----------
    study : Study
        Study with the unreduced structure.
    estimated_omegas : (m,) [rad/s]
        Estimated resonance frequencies of m modes, at the study's rotor speed.
    squared_omega_slopes : (m,)
        S = d(w^2) / d(W^2) of each natural frequency w over the rotor speed W, for an engine order.

    Returns
    -------
    ResonanceUnderLoad
        If no resonance is found, only the reason ``unknown`` is set.
    """
    scene, law = study.scene, study.contact
    if law is None:
        return ResonanceUnderLoad(unknown="there is no crack")
    mode_index = int(np.argmin(np.abs(estimated_omegas - scene.excitation.omega)))
    start_omega, crossing_speed = float(estimated_omegas[mode_index]), None
    engine_order = scene.excitation.order
    if engine_order is not None and study.structure.rotation is not None and scene.disk is None:
        crossing_speed = order_crossing_speed(
            engine_order, scene.speed, start_omega, squared_omega_slopes[mode_index]
        )
        if math.isnan(crossing_speed):
            return ResonanceUnderLoad(
                unknown=f"engine order {engine_order} does not meet this mode"
            )
        start_omega = engine_order * crossing_speed
    make_structure = partial(_make_search_structure, study, crossing_speed)
    return find_load_resonance(
        scene, law, make_structure, start_omega, with_small_load_resonance=True
    )


def _make_search_structure(study: Study, crossing_speed: float | None) -> Structure:
    """Reduce a study's structure to few modes, to search a resonance (collective).

    At most 10 modes are kept (:data:`N_RESONANCE_SEARCH_MODES`). There are two exceptions without
    an engine order. A disk keeps the modes that the scene requests. A small structure that the
    scene does not reduce keeps all modes.

    Parameters
    ----------
    study : Study
        Study with the unreduced structure.
    crossing_speed : float or None [rad/s]
        Rotor speed at which an engine order meets the mode. The reduced structure then follows the
        rotor speed. None without an engine order.
    """
    whole_structure = study.structure
    reduction = modal_reduction_or_none(study.scene, whole_structure)
    n_modes = min(
        N_RESONANCE_SEARCH_MODES, whole_structure.n_dofs if reduction is None else reduction.n_modes
    )
    if crossing_speed is not None:
        projection = RitzProjection.of_range(
            whole_structure, crossing_speed, crossing_speed, n_modes
        )
        return RunUpStructure(projection, crossing_speed)
    if study.scene.disk is not None or (reduction is None and is_small(whole_structure)):
        return reduce_study(study, with_reference=False).structure
    return reduce_structure(whole_structure, modes=n_modes, method="massless", reference=False)


def find_load_resonance(
    scene: Scene,
    law: ContactLaw,
    make_structure: Callable[[], Structure],
    start_omega: float,
    *,
    with_small_load_resonance: bool = False,
) -> ResonanceUnderLoad:
    """Find where a structure resonates under a scene's load, without friction (collective).

    Parameters
    ----------
    scene : Scene
        Source of the numbers of harmonics and samples.
    law : ContactLaw
        Contact law; its friction, if any, is left out.
    make_structure : callable
        Makes the structure with its load, small enough to compute all of its modes. For a
        :class:`RunUpStructure` the rotor speed follows the resonance, at a fixed ratio to the load
        frequency (:func:`fenics_crack.resonance_at`).
    start_omega : float [rad/s]
        Load frequency at which the search begins.
    with_small_load_resonance : bool
        Find the resonance under a small load, too.

    Returns
    -------
    ResonanceUnderLoad
        If no resonance is found, or the structure cannot be made, only the reason ``unknown`` is
        set.
    """
    from fenics_crack.curves.resonance import (  # where one is sought
        problem_at_small_load,
        resonance_at,
    )

    balance_table, friction_law = scene.harmonic_balance, friction_of(law)
    law = law if friction_law is None else friction_law.law
    omega_or_speed_under_small_load = math.nan
    try:
        structure = make_structure()
        parameter = "speed" if isinstance(structure, RunUpStructure) else "omega"
        problem = Problem(
            structure, start_omega, law, balance_table.harmonics, balance_table.samples
        )
        resonance = resonance_at(
            problem, parameter=parameter, tolerance=MAX_AMPLITUDE_ERROR_BY_HARMONICS
        )
        if with_small_load_resonance:
            omega_or_speed_under_small_load = resonance.value
            # A mean load or a clearance holds pairs under a small load, which compresses no layer.
            has_mean_load_or_clearance = np.any(structure.force[0]) or np.any(structure.clearance)
            if has_mean_load_or_clearance or is_layered(law):
                small_problem = problem_at_small_load(problem)
                omega_or_speed_under_small_load = resonance_at(
                    small_problem, resonance.omega, parameter
                ).value
    except SINGLE_COMPUTATION_FAILURES as error:
        return ResonanceUnderLoad(unknown=str(error))
    if resonance.several:
        return ResonanceUnderLoad(
            resonance.value,
            resonance.width,
            omega_or_speed_under_small_load,
            unknown=SEVERAL_MODES_REASON,
        )
    solution, stability_verdict = resonance.solution, "undecided"
    with suppress(*SINGLE_COMPUTATION_FAILURES):
        stability_verdict = floquet(solution.structure, solution).verdict
    return ResonanceUnderLoad(
        resonance.value, resonance.width, omega_or_speed_under_small_load, solution.amplitude(),
        resonance.error, stability_verdict,
    )  # fmt: skip
