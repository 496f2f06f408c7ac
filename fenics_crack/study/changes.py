"""Sizes of the change of a motion, as each of its numbers may show it.

A number may change by little where the motion changes by much: an extreme changes by the change of
the motion at one instant, a harmonic by the part of its change that is in phase with it, a sum over
pairs by gains less losses. A change of the same size at another phase changes the number by more.
The size of a change is

    amplitude, opening,     root mean square over the period of what vibrates of the change of the
    crack force             displacement, gap, force; the largest of all pairs, and of all cracks
    harmonic ratio k/1      |c_k' - c_k|, where c_k = U_k exp(i (phase_k - k phase_1)) / U_1
    mean shift a0 / U_1     |a0' - a0| / U_1 + |a0| |U_1' - U_1| / U_1^2
    shares, friction loss   sum over the pairs of |change of the pair|

Without friction the shift in time by which a signal changes is removed first. It changes no
extreme, and next to a resonance that has moved most of the change is a shift. Friction dissipates
another part of the work where the motion is another: the height of a resonance then changes as
much as its place.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.motion.motions import Faces, Record, rows_of
from fenics_crack.motion.orbit import INSTANTS, PeriodicOrbit
from fenics_crack.study.prepare import Study

TINY = np.finfo(float).tiny


def sizes_of_change(study: Study, *motions: PeriodicOrbit | PeriodicSolution) -> dict[str, float]:
    """Return the size of the change between two motions for each number (collective).

    Parameters
    ----------
    study : Study
        Study that names the watched displacements.
    motions : PeriodicOrbit or PeriodicSolution
        Two motions with the same load and pairs.

    Returns
    -------
    dict of str to float
        Sizes by column, in the unit of each number.
    """
    dofs = [point.dof for point in study.watched]
    few, many = (
        next(motion.records(rows_of(motion.structure, dofs), INSTANTS)) for motion in motions
    )
    amplitudes = _rms_of_change(few, few.motion, many.motion)
    ratios, mean_shifts = _sizes_of_harmonic_changes(few, many)
    sizes = _sizes_of_face_changes(few, many)
    for index, point in enumerate(study.watched):
        sizes[point.column("amplitude")] = float(amplitudes[index])
        sizes[point.column("mean_shift")] = float(mean_shifts[index])
        for name, ratio in ratios.items():
            sizes[point.column(name)] = float(ratio[index])
    return sizes


def _rms_of_change(record: Record, few: np.ndarray, many: np.ndarray) -> np.ndarray:
    """Return the rms of what vibrates of the change of signals (n, m): (m,)."""
    change, rate = many - few, np.roll(few, -1, axis=0) - np.roll(few, 1, axis=0)
    if record.friction is None:
        squares = np.maximum(np.sum(rate**2, axis=0), TINY)
        change = change - np.sum(change * rate, axis=0) / squares * rate
    return np.asarray(change.std(axis=0))


def _sizes_of_harmonic_changes(
    few: Record, many: Record
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the sizes of the changes of harmonic ratios and mean shifts, (m,) of m signals."""
    (waves, first), (other_waves, other_first) = map(_turned_harmonics, (few, many))
    changes = np.abs(other_waves / other_first - waves / first)
    largest = 2 + np.argmax(np.abs(waves[2:]), axis=0)
    ratios = {
        "ratio_2_1": changes[2],
        "ratio_3_1": changes[3],
        "ratio_largest": np.take_along_axis(changes, largest[None], axis=0)[0],
    }
    mean_change = np.abs(other_waves[0] - waves[0])
    first_change = np.abs(waves[0]) / first * np.abs(other_first - first)
    return ratios, 0.5 * (mean_change + first_change) / first


def _turned_harmonics(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Return harmonics of signals, with the time counted from the crest of the first.

    Returns
    -------
    waves : (n_harmonics, m) complex [m]
        Twice the mean, and U_k exp(i (phase_k - k phase_1)).
    first : (m,) [m]
        U_1; never zero.
    """
    spectrum = np.fft.rfft(record.motion, axis=0)[:: record.subharmonic]
    spectrum *= 2.0 / len(record.motion)
    first = np.maximum(np.abs(spectrum[1]), TINY)
    orders = np.arange(len(spectrum))[:, None]
    return spectrum * (spectrum[1].conj() / first) ** orders, first


def _sizes_of_face_changes(few: Record, many: Record) -> dict[str, float]:
    """Return the sizes of the changes of opening, crack force, shares and friction loss."""
    if not few.n_pairs:
        return {}
    faces, other_faces = Faces(few), Faces(many)
    openings = _rms_of_change(few, faces.gap, other_faces.gap)
    forces = _rms_of_change(
        few, faces.force @ few.pairs_of_cracks, other_faces.force @ few.pairs_of_cracks
    )
    sizes = {"opening": float(openings.max()), "crack_force": float(forces.max())}
    parts, other_parts = _parts_of_pairs(few, faces), _parts_of_pairs(few, other_faces)
    return sizes | {
        name: float(np.abs(other_parts[name] - part).sum()) for name, part in parts.items()
    }


def _parts_of_pairs(record: Record, faces: Faces) -> dict[str, np.ndarray]:
    """Return the part of each pair in the numbers that are sums over pairs, (n_pairs,) by name."""
    shares = {"closed_share": faces.force > 0.0}
    losses = {}
    if record.friction is not None:
        shares["slip_share"] = faces.slips
        losses["friction_loss"] = faces.losses
    return losses | {name: part.mean(axis=0) / record.n_pairs for name, part in shares.items()}
