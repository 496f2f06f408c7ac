"""Sizes of the change of a motion, as each of its numbers may show it.

A number may change by little where the motion changes by much: an extreme changes by the change of
the motion at one instant, a harmonic by the part of its change that is in phase with it, a sum over
pairs by gains less losses. A change of the same size at another phase changes the number by more.
The size of a change is

    amplitude, opening,     root mean square over the period of what vibrates of the change of the
    crack force             displacement, gap, force; the largest of all pairs, and of all cracks
    harmonic ratio k/1      |c_k' - c_k|, where c_k = U_k exp(i (phase_k - k phase_1)) / U_1
    mean shift a0 / U_1     that of the ratio 2/1: a mean has no phase, and is made as U_2 is, by
                            the difference between opening and closing
    shares, friction loss   sum over the pairs of |change of the pair|

A shift in time is a change as others are, though it moves no extreme: next to a resonance that more
modes move, they also change the work that friction and impacts dissipate, and with it the height of
the peak by as much as its phase.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.motion.motions import Faces, Record, rows_of
from fenics_crack.motion.orbit import INSTANTS_PER_PERIOD, PeriodicOrbit
from fenics_crack.study.prepare import Study


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
    record, other_record = (
        next(
            motion.records(
                rows_of(motion.structure, dofs), INSTANTS_PER_PERIOD * motion.subharmonic
            )
        )
        for motion in motions
    )
    ratios = _ratios(record)
    changes = np.abs(_ratios(other_record) - ratios)
    order_index = 2 + np.argmax(np.abs(ratios[2:]), axis=0)
    sizes = {
        "amplitude": (other_record.motion - record.motion).std(axis=0),
        "ratio_2_1": changes[2],
        "ratio_3_1": changes[3],
        "ratio_largest": np.take_along_axis(changes, order_index[None], axis=0)[0],
        "mean_shift": changes[2],
    }
    return _sizes_of_face_changes(record, other_record) | {
        point.column(name): float(size[index])
        for name, size in sizes.items()
        for index, point in enumerate(study.watched)
    }


def _ratios(record: Record) -> np.ndarray:
    """Return c_k of the module's equation for m signals: (n_harmonics, m) complex."""
    spectrum = np.fft.rfft(record.motion, axis=0)[:: record.subharmonic]
    size = np.maximum(np.abs(spectrum[1]), np.finfo(float).tiny)
    orders = np.arange(len(spectrum))[:, None]
    return np.asarray(spectrum / size * (spectrum[1].conj() / size) ** orders)


def _sizes_of_face_changes(record: Record, other_record: Record) -> dict[str, float]:
    """Return the sizes of the changes of opening, crack force, shares and friction loss."""
    if not record.n_pairs:
        return {}
    faces, other_faces = Faces(record), Faces(other_record)
    force_change = (other_faces.force - faces.force) @ record.pairs_of_cracks
    parts, other_parts = _parts_of_pairs(record, faces), _parts_of_pairs(record, other_faces)
    return {
        "opening": float((other_faces.gap - faces.gap).std(axis=0).max()),
        "crack_force": float(force_change.std(axis=0).max()),
        **{name: float(np.abs(other_parts[name] - part).sum()) for name, part in parts.items()},
    }


def _parts_of_pairs(record: Record, faces: Faces) -> dict[str, np.ndarray]:
    """Return the part of each pair in the numbers that are sums over pairs, (n_pairs,) by name."""
    parts = {"closed_share": (faces.force > 0.0).mean(axis=0) / record.n_pairs}
    if record.friction is None:
        return parts
    return parts | {
        "slip_share": faces.slips.mean(axis=0) / record.n_pairs,
        "friction_loss": faces.losses,
    }
