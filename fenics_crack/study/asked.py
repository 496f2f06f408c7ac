"""What a scene's ``[output] quantities`` ask for beside points, lips and frequencies: numbers of
the tips of cracks and of the clamp, which cost something and are found for those who ask."""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import PHASES, ResponseCurve
from fenics_crack.model.clamp import Clamp
from fenics_crack.model.damping import RayleighDamping
from fenics_crack.model.structure import Structure
from fenics_crack.scene.quantities import OF_CLAMP, OF_TIPS
from fenics_crack.scene.scene import asked_quantities
from fenics_crack.study.prepare import Study
from fenics_crack.study.tips import tip_rows, tips_along_curve, tips_of_motion
from fenics_crack.table import TURN
from fenics_crack.time.march import TimeHistory

__all__ = [
    "asked_along_curve", "asked_of_motion", "clamp_of_motion", "numbers_at_clamp", "prepare_asked",
]  # fmt: skip


def prepare_asked(study: Study) -> None:
    """Make what the quantities of a study are found with, once for its structure (collective)."""
    names = asked_quantities(study.scene)
    if OF_TIPS.keys() & names:
        tip_rows(study)
    if OF_CLAMP.keys() & names:
        study.structure.once(_inertia_rows)


def asked_of_motion(study: Study, motion: PeriodicSolution | TimeHistory) -> dict[str, float]:
    """The quantities of a solution or a march that its scene asks for (collective)."""
    names = asked_quantities(study.scene)
    found: dict[str, float] = {}
    if OF_TIPS.keys() & names:
        found |= tips_of_motion(study, motion)
    if OF_CLAMP.keys() & names:
        found |= numbers_at_clamp(*clamp_of_motion(motion)[1:])
    return {name: found[name] for name in names}


def asked_along_curve(study: Study, curve: ResponseCurve) -> dict[str, np.ndarray]:
    """The quantities that its scene asks for at every point of a curve, each (n,) (collective)."""
    names = asked_quantities(study.scene)
    found: list[dict[str, float]] = [{} for _ in range(len(curve))]
    if OF_TIPS.keys() & names:
        found = tips_along_curve(study, curve)
    if OF_CLAMP.keys() & names:
        rows = curve.structure.once(_inertia_rows)
        for index, waves, *_ in curve.seen_through(rows):
            whole = curve.problem_of(index).structure.whole
            omega = float(curve.omega[index]) / curve.subharmonic
            how = omega, curve.subharmonic, _drag(whole), PHASES
            found[index] |= numbers_at_clamp(*_clamp(whole).of_waves(waves, *how))
    return {name: np.array([one[name] for one in found]) for name in names}


# --- the clamp ------------------------------------------------------------------------------------


def clamp_of_motion(
    motion: PeriodicSolution | TimeHistory,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants (n,) [s], and forces (n, d) [N] and moments (n, n_rigid - d) [N m] of the clamp then
    (collective)."""
    structure = motion.structure
    rows, whole = structure.once(_inertia_rows), structure.whole
    clamp, drag = _clamp(whole), _drag(whole)
    if isinstance(motion, TimeHistory):
        steps = motion.steps_per_period
        omega = TURN * (len(motion.time) - 1) / steps / float(np.ptp(motion.time))
        return motion.time, *clamp.of_record(motion.time, motion.seen_through(rows), omega, drag)
    waves = structure.sum_over_ranks(motion.displacement_coefficients @ rows.T)
    time, omega = motion.instants(), motion.base_omega
    return time, *clamp.of_waves(waves, omega, motion.subharmonic, drag, omega * time)


def numbers_at_clamp(force: np.ndarray, moment: np.ndarray) -> dict[str, float]:
    """The quantities of the clamp from its forces and its moments over time, a row each instant."""
    sizes = (np.linalg.norm(part, axis=1).max() for part in (force, moment))
    return dict(zip(OF_CLAMP, map(float, sizes), strict=True))


def _clamp(whole: Structure) -> Clamp:
    assert whole.clamp is not None  # the scene has been checked
    return whole.clamp


def _drag(whole: Structure) -> float:
    """a [1/s] of Rayleigh's damping."""
    return whole.damping.mass if isinstance(whole.damping, RayleighDamping) else 0.0


def _inertia_rows(structure: Structure) -> np.ndarray:
    """r^T M in the coordinates of a structure: (n_rigid, n_local). What has no mass has no inertia:
    what modes leave out answers at once (collective)."""
    whole, inertia = structure.whole, _clamp(structure.whole).inertia
    if structure is whole:
        return inertia
    known = structure.known_modes(tied=False)  # with mass, where not all coordinates have it
    shapes = np.eye(structure.n_dofs) if known is None else known[1]
    rows = whole.sum_over_ranks(structure.expand(shapes.T) @ inertia.T).T @ shapes.T
    mass = structure.mass.getValues(range(structure.n_dofs), range(structure.n_dofs))
    return np.asarray(rows @ mass)
