"""Numbers that tell whether a scene is what its author meant, from one factor of K and few modes.

Nothing is solved. With the lips open, K^-1 and the lowest modes give displacement and gap at a
frequency w,

    u(w) = K^-1 f + sum_j phi_j (phi_j^T f) [d_j(w) - 1 / w_j^2],
    d_j(w) = 1 / (w_j^2 - w^2 + 2 i xi_j w_j w),

and, by B instead of f, the compliance of the lips R(w) = B^T H(w) B. The mean load and the preload
alone close some pairs, by a static contact problem. As long as these stay closed and the others
open, the motion is linear, and the closed ones carry R(w)^-1 B^T u(w) beside their static force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.factor import Factor
from fenics_crack.model.modes import (
    BilinearFrequencies,
    Modes,
    check_damped_modes,
    count_below,
    modes_by,
    partners,
    tied_modes,
    times,
)
from fenics_crack.model.reduced import ResidualFlexibility
from fenics_crack.model.structure import ModalDamping, RayleighDamping, Structure
from fenics_crack.parallel import gather_rows
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import Study, reduction_of

__all__ = [
    "N_MODES",
    "SMALL_MOTION",
    "KeyFigures",
    "damping_ratios",
    "extents",
    "find_key_figures",
    "highest_omega",
    "span_of",
]

N_MODES = 4
"""Modes that are computed."""
SMALL_MOTION = 0.1
"""Displacement over the shortest side up to which displacements are small."""


@dataclass(frozen=True)
class KeyFigures:
    """Of a scene's structure, whole.

    Attributes
    ----------
    size : (d,) [m]
        Width, height and, of a solid, thickness of the mesh.
    elements : int or None
        Along each lip of the crack that has the fewest; None without a crack.
    omega_open, omega_tied : (at most 4,) [rad/s]
        Lowest natural frequencies, lips open and lips tied together; these are infinite where there
        are no more.
    omega_breathing : float [rad/s]
        First resonance of a crack that opens for one half of a motion and closes for the other: the
        bilinear one of the first open mode.
    damping : (at most 4,)
        Ratios of critical damping of the open modes.
    stiffening : float
        S = d(w_1^2) / d(W^2) of the first open mode under rotation; 0 without.
    own_stiffness : (n_pairs,) [N/m]
        1 / (B^T K^-1 B)_jj: of the lips themselves, pair by pair.
    stiffness_ratio : (n_pairs,) or None
        Contact stiffness over the own stiffness; None without a law, or without a stiffness.
    mean_opening, static_motion : float [m]
        Largest opening of open lips under the mean load, and the largest motion of their gaps under
        the load's amplitude, both static.
    displacement, gap_motion : float [m]
        Largest amplitudes with open lips at the frequencies that are asked for.
    closed : int
        Pairs that are closed under the mean load and the preload alone.
    breathes : bool
        Whether a pair that is then open closes, or one that is closed opens, at these frequencies.
    modes_below : int
        Natural frequencies below that of the highest harmonic.
    modes_kept : int
        After the reduction.
    """

    size: tuple[float, ...]
    elements: int | None
    omega_open: np.ndarray
    omega_tied: np.ndarray
    omega_breathing: float
    damping: np.ndarray
    stiffening: float
    own_stiffness: np.ndarray
    stiffness_ratio: np.ndarray | None
    mean_opening: float
    static_motion: float
    displacement: float
    gap_motion: float
    closed: int
    breathes: bool
    modes_below: int
    modes_kept: int

    def meeting_speed(self, order: int, speed: float) -> float:
        """Rotor speed W [rad/s] at which an engine order n meets the first breathing frequency,

            (n W)^2 = w_b^2 + S (W^2 - W_0^2);

        nan where it never does. Exact where w^2 is linear in W^2 with the slope of open lips.

        Parameters
        ----------
        order : int
            n.
        speed : float
            W_0, of the structure [rad/s].
        """
        square = self.omega_breathing**2 - self.stiffening * speed**2
        slope = order**2 - self.stiffening
        return math.sqrt(square / slope) if square > 0.0 and slope > 0.0 else math.nan


def find_key_figures(study: Study) -> KeyFigures:
    """Compute the figures of a study whose structure is not reduced (collective)."""
    scene, whole, law = study.scene, study.structure, study.contact
    count = min(N_MODES, whole.n_dofs)
    with Factor(whole.stiffness, definite=True) as factor:
        modes = modes_by(factor, whole, count)
        static = _static(factor, modes, whole.force)
        lips = whole.apply_bt(_static(factor, modes, whole.gap.T.toarray()))
    ratios = damping_ratios(whole, modes.omega)
    tied = tied_modes(whole, count) if whole.n_pairs else modes
    breathing = BilinearFrequencies(modes.omega, tied.omega[partners(modes, tied)])
    gaps, psi = whole.apply_bt(static), whole.apply_bt(modes.shapes.T)
    loads = whole.sum_over_ranks(modes.shapes.T @ whole.force.T)
    resting = gaps[0] - whole.clearance  # of open lips
    pressed = solve_complementarity(lips, resting) if whole.n_pairs else np.zeros(0)
    closed = pressed > 0.0
    largest, moved, breathes = 0.0, 0.0, False
    for omega in _omegas(scene, np.concatenate([modes.omega, tied.omega])):
        change = _dynamic_part(modes.omega, ratios, omega)
        load = change * (loads[:, 1] - 1j * loads[:, 2])
        motion = static[1] - 1j * static[2] + load @ modes.shapes.T
        largest = max(largest, *whole.comm.allgather(float(np.abs(motion).max(initial=0.0))))
        if not whole.n_pairs:
            continue
        gap = gaps[1] - 1j * gaps[2] + load @ psi
        moved = max(moved, float(np.abs(gap).max()))
        seen = lips + (psi.T * change) @ psi
        force = np.zeros(whole.n_pairs, dtype=complex)
        force[closed] = np.linalg.lstsq(seen[np.ix_(closed, closed)], gap[closed], rcond=None)[0]
        opened = resting - lips @ pressed + np.abs(gap - seen @ force) >= 0.0
        breathes = breathes or bool(np.any(np.where(closed, pressed <= np.abs(force), opened)))
    own = 1.0 / np.maximum(np.diagonal(lips), 1e-300)
    stiffness = None if law is None or not np.all(np.isfinite(law.stiffness)) else law.stiffness
    kept = reduction_of(scene, whole)
    crack = whole.n_pairs > 0
    return KeyFigures(
        size=extents(whole),
        elements=_elements(scene, whole),
        omega_open=modes.omega,
        omega_tied=tied.omega,
        omega_breathing=float(breathing.omega_bilinear[0]),
        damping=ratios,
        stiffening=_stiffening(whole, modes.shapes[:, 0]),
        own_stiffness=own,
        stiffness_ratio=None if stiffness is None else stiffness / own,
        mean_opening=float(np.max(-resting, initial=0.0)) + 0.0,
        static_motion=float(np.abs(gaps[1] - 1j * gaps[2]).max(initial=0.0)),
        displacement=largest,
        gap_motion=moved,
        closed=int(closed.sum()),
        breathes=breathes,
        modes_below=count_below(whole, highest_omega(scene) ** 2) if crack else 0,
        modes_kept=whole.n_dofs if kept is None else kept.modes,
    )


def _static(factor: Factor, modes: Modes, forces: np.ndarray) -> np.ndarray:
    """Static responses to forces (m, n_local); of a structure that can move as a
    rigid body the deformation alone, as it accelerates."""
    whole, free = modes.structure, modes.shapes[:, modes.omega == 0.0]
    left = ResidualFlexibility(whole, free, np.zeros(free.shape[1]), whole.gap)
    return left.solve(factor, forces) if free.size else factor.solve(forces)


def _stiffening(whole: Structure, shape: np.ndarray) -> float:
    """d(w^2) / d(W^2) = phi^T (K_1 + K_2 + 2 W^2 K_3) phi of a mass-normalised mode (n_local,)."""
    rotation = whole.rotation
    if rotation is None:
        return 0.0
    second, third = rotation.displaced
    parts = (rotation.stiffness, 1.0), (second, 1.0), (third, 2.0 * rotation.speed**2)
    slope = sum(factor * times(matrix, shape[:, None])[:, 0] for matrix, factor in parts)
    return float(whole.sum_over_ranks(shape @ slope))


def _elements(scene: Scene, whole: Structure) -> int | None:
    """Elements along the crack that has the fewest: its pairs by the order of the displacement,
    rounded up, for tips are no pairs."""
    if not whole.n_pairs:
        return None
    cracks = whole.pairs.cracks
    fewest = whole.n_pairs if cracks is None else int(np.bincount(cracks).min())
    return math.ceil(fewest / (1 if scene.mesh is None else scene.mesh.order))


def extents(whole: Structure) -> tuple[float, ...]:
    """Extents of the mesh [m] (collective)."""
    if whole.nodes is None:
        return np.nan, np.nan
    return tuple(np.ptp(gather_rows(whole.comm, whole.nodes.points), axis=0).tolist())


def damping_ratios(whole: Structure, omega: np.ndarray) -> np.ndarray:
    """Ratios of critical damping of the lowest modes, by their frequencies (n,) [rad/s]."""
    rule = whole.damping
    if isinstance(rule, RayleighDamping):
        twice = 2.0 * omega
        return np.divide(rule.rate(omega**2), twice, out=np.zeros_like(omega), where=omega > 0.0)
    found = np.zeros(len(omega))
    if isinstance(rule, ModalDamping):
        damped = min(check_damped_modes(whole), len(omega))
        ratio = np.asarray(rule.ratio)
        found[:damped] = ratio if ratio.ndim == 0 else ratio[:damped]
    return found


def _dynamic_part(natural: np.ndarray, ratios: np.ndarray, omega: float) -> np.ndarray:
    """d_j(w) - 1 / w_j^2 of the modes; d_j(w) of rigid-body ones, which no static part holds."""
    squares = natural**2
    below = squares - omega**2 + 2j * ratios * natural * omega
    static = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > 0.0)
    return 1.0 / np.where(below == 0.0, 1e-12 * squares, below) - static


# --- the frequencies that a scene asks for --------------------------------------------------------


def _omegas(scene: Scene, natural: np.ndarray) -> list[float]:
    """Where the response is looked at: the ends of what is asked for, and resonances between."""
    found = {scene.excitation.omega}
    for low, high in (span_of(scene, "curve"), span_of(scene, "sweep")):
        found |= {low, high, *(float(omega) for omega in natural if low <= omega <= high)}
    return sorted(found)


def span_of(scene: Scene, command: str) -> tuple[float, float]:
    """Lowest and highest load frequency [rad/s] of "solve", "curve" or "sweep"."""
    omegas = [scene.excitation.omega]
    curve = scene.curve if command == "curve" else None
    if curve is not None and curve.followed[0] == "omega":
        omegas = [*curve.followed[1:]]
    elif curve is not None and curve.followed[0] == "speed":
        omegas = [(scene.excitation.order or 1) * speed for speed in curve.followed[1:]]
    if command == "sweep":
        omegas = [*scene.swept_omegas]
    return min(omegas), max(omegas)


def highest_omega(scene: Scene, command: str = "") -> float:
    """H w: the highest frequency [rad/s] of the harmonics in "solve", "curve" or "sweep", by
    default in any of them."""
    if not command:
        return max(highest_omega(scene, one) for one in ("solve", "curve", "sweep"))
    harmonics = [scene.harmonic_balance.harmonics]
    if command == "sweep":
        harmonics = [*scene.swept.get("harmonic_balance.harmonics", harmonics)]
    return span_of(scene, command)[1] * max(harmonics)
