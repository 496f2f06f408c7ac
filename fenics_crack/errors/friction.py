"""Error by friction that is left out, or that acts along one line for each pair.

Without friction each number changes as between two exact orbits, without friction and with it. The
structure of these orbits has few modes, and crack faces without mass. Extremes may agree by
chance: as by modes, the part is at least the root mean square of the change of the motion. The
difference between this change and that with half the modes is added.

With friction on a solid, along one line for each pair, the part is twice the share of sliding
across these lines, without friction, in the change by friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fenics_crack.balance.harmonic_balance import along_lines, motion_without_friction, sliding_of
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import Solver
from fenics_crack.errors.case import Case
from fenics_crack.errors.changes import sizes_of_change
from fenics_crack.errors.convergence import GridConvergence, Varied
from fenics_crack.model.contact import CoulombFriction, friction_of
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.study.prepare import law_of

FRICTION_MODES = 20, 10
"""Modes of the structures that show the effect of friction, and how it depends on modes.

With 40 modes an orbit takes three times as long, and ten times if it is hard to find.
"""
TURNING_FACTOR = 2.0
"""Stated error by sliding across the lines of friction, over its share in the change by friction.

True errors, beside time steps with Coulomb's cone, were 0.03 to 1.2 of that in seven cases.
"""
SLIDING_QUANTITIES = ("K_II_max", "K_III_max")
"""Stress intensities that friction at the tip itself changes."""
START_HARMONICS = 10
"""Harmonics of the solutions next to which the two orbits are sought."""


def friction_error(case: Case) -> Varied:
    """Return the part of friction in each number (collective).

    There is none if the answer has friction, its scene has a coefficient, or crack faces do not
    touch.
    """
    study, scene, answer = case.study, case.study.scene, case.answer
    law, structure = study.contact, study.structure
    if law is None or not np.any(answer.contact_force(answer.instants()) > 0.0):
        return ""
    if (friction := friction_of(law)) is not None:
        return "" if friction.direction is None else _error_across_lines(case, friction)
    table = scene.given("contact")
    if table.friction is not None:
        return ""
    if not (coefficient := table.friction_error):
        return "contact.friction_error = false"
    tangential_structure = structure.whole.with_tangents()
    if scene.disk is not None or tangential_structure.tangential is None:
        return "not estimated, only of single plates and solids"
    keys: dict[str, Any] = {"contact.friction": coefficient, "output.quantities": None}
    keys["harmonic_balance.form"] = "condensed"
    if not structure.light_lips:  # faces with mass, in contact as stiff along them as across
        keys["contact.tangential_stiffness_per_area"] = table.stiffness_per_area
    (orbits, numbers), (coarse_orbits, coarse_numbers) = (
        _orbits_without_and_with(case, count, tangential_structure, keys)
        for count in FRICTION_MODES
    )
    if len(orbits) < 2:
        return f"not estimated, no exact orbit next to {START_HARMONICS} harmonics"
    if len(coarse_orbits) < 2:
        coarse_numbers = numbers
    sizes = sizes_of_change(study, *orbits)
    coefficients, parts = (0.0, float(coefficient)), {}
    for name, value in case.answer_numbers.items():
        if name in SLIDING_QUANTITIES:
            continue
        change = _relative_change(name, *numbers)
        error = abs(change) + abs(change - _relative_change(name, *coarse_numbers))
        if size := abs(numbers[0].get(name, 0.0)):
            error = max(error, sizes.get(name, 0.0) / size)
        values = value, value * (1.0 + change)
        factor = error / abs(change) if change else 1.0
        parts[name] = GridConvergence(coefficients, values, "two coefficients", factor=factor)
    return FRICTION_MODES[:1] * 2, parts


def _orbits_without_and_with(
    case: Case, count: int, whole: Structure, keys: Mapping[str, Any]
) -> tuple[list[PeriodicOrbit], list[dict[str, float]]]:
    """Return exact orbits without friction and with it, and their numbers (collective).

    Keys of the scene describe the friction. The lists end at the first orbit that is not found.
    """
    study, answer, periods = case.study, case.answer, case.answer.subharmonic
    count = min(count, whole.n_dofs // 2)
    reduced_structure = reduce_structure(whole, modes=count, method="massless", reference=False)
    orbits, numbers = list[PeriodicOrbit](), list[dict[str, float]]()
    for law in (study.contact, law_of(study.scene.replace(keys), reduced_structure)):
        assert law is not None
        contact_law = along_lines(reduced_structure, law, lambda _: orbits[0])
        problem = Problem(
            reduced_structure,
            answer.omega,
            contact_law,
            START_HARMONICS * periods,
            subharmonic=periods,
        )
        orbit = Solver(problem).solve(answer).assessment.orbit
        if orbit is None:
            break
        twin = replace(study, structure=reduced_structure, contact=contact_law)
        orbits.append(orbit)
        numbers.append(case.values_of(orbit, twin))
    return orbits, numbers


def _relative_change(
    name: str, numbers: Mapping[str, float], other_numbers: Mapping[str, float]
) -> float:
    """Return the relative change of a number from one motion to another; 0 if it has none."""
    value = numbers.get(name, 0.0)
    return other_numbers.get(name, 0.0) / value - 1.0 if value else 0.0


def _error_across_lines(case: Case, friction: CoulombFriction) -> Varied:
    """Return the part of sliding across the lines of a solid's friction (collective)."""
    study, answer = case.study, case.answer
    structure, periods = study.structure, answer.subharmonic
    free_motion = motion_without_friction(structure, answer.omega, friction.law, periods)
    free_values = case.values_of(free_motion, replace(study, contact=friction.law))
    turning, parts = sliding_of(free_motion, friction.direction)[1], {}
    for name, value in case.answer_numbers.items():
        turned_value = value + turning * (free_values.get(name, 0.0) - value)
        parts[name] = GridConvergence(
            (0.0, 1.0), (value, turned_value), "two coefficients", factor=TURNING_FACTOR
        )
    return (structure.n_modes, structure.n_modes), parts
