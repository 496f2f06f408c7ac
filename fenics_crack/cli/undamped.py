"""Where harmonics reach frequencies that nothing damps, in words."""

from __future__ import annotations

import contextlib

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.modes import damped_range
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Scene
from fenics_crack.study.key_figures import highest_omega
from fenics_crack.study.prepare import prepare, reduction_of

__all__ = ["in_words", "remark_on", "remark_on_sweep", "remark_on_whole"]


def in_words(highest: float, damped: tuple[int, float] | None) -> str:
    """What to say of harmonics up to a frequency [rad/s]; empty where all of them are damped.

    ``damped``: how many modes are damped, and the highest frequency of one; None if all are
    (:func:`damped_range`).
    """
    if damped is None or highest <= damped[1]:
        return ""
    count, end = damped
    if count == 0:
        return f"harmonics up to H w = {highest:g} rad/s: nothing damps what they excite"
    modes = "the damped mode" if count == 1 else f"the {count} damped modes"
    return (
        f"harmonics up to H w = {highest:g} rad/s reach beyond {modes} ({end:g} rad/s): "
        "nothing damps what they excite there"
    )


def remark_on(structure: Structure, highest: float) -> str:
    """The same of a structure; empty without contact, which excites them (collective)."""
    return in_words(highest, damped_range(structure)) if structure.n_pairs else ""


def remark_on_whole(scene: Scene, whole: Structure, highest: float) -> str:
    """The same of a structure that the scene reduces before it is solved (collective)."""
    table = reduction_of(scene, whole)
    ratio = None if scene.damping is None else scene.damping.ratio
    if table is not None and table.method == "massless" and ratio is not None:
        if np.ravel(ratio)[-1] > 0.0:  # that of all further modes that are kept
            return ""
    return remark_on(whole, highest)


def remark_on_sweep(scene: Scene, comm: MPI.Comm) -> str:
    """The same of a sweep, from the modes of the plate as the scene has it (collective)."""
    if scene.contact is None or scene.damping is None or scene.damping.of_all_modes:
        return ""

    def remark() -> str:
        with contextlib.suppress(InputError, ConvergenceError):  # its cases may be others
            plate = prepare(scene, MPI.COMM_SELF, whole=True).structure
            return remark_on_whole(scene, plate, highest_omega(scene, "sweep"))
        return ""

    return on_root(comm, remark)
