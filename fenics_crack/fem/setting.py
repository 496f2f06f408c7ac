"""Derive damping, clearances and forces from a scene, without a mesh."""

from __future__ import annotations

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.model.nodes import Pairs
from fenics_crack.model.periodic_load import read_load_harmonics_and_error
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping
from fenics_crack.scene.fields import Vector
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Damping, Excitation, add_harmonics


def damping_rule_of(table: Damping) -> DampingRule:
    """Convert a scene's table ``[damping]`` to modal or Rayleigh damping."""
    if table.ratio is not None:
        n_modes = None if table.modes == "all" else int(table.modes)
        return ModalDamping(table.ratio, n_modes, table.stiffness or 0.0)
    if table.ratios is not None and table.omegas is not None:
        return RayleighDamping.from_ratios(table.ratios, table.omegas)
    return RayleighDamping(table.mass or 0.0, table.stiffness or 0.0)


def clearance_of(scene: Scene, pairs: Pairs) -> np.ndarray:
    """Return the clearance of every pair from the scene's crack tables: (n_pairs,) [m].

    If the scene has one crack table, its clearance holds for all cracks. Without a table the
    clearance is 0.

    Raises
    ------
    InputError
        The scene has several crack tables, but not one for each of the mesh's cracks.
    """
    crack_clearances = np.array(
        [crack.clearance for crack in scene.crack_by_name.values()] or [0.0]
    )
    assert pairs.cracks is not None
    if len(crack_clearances) == 1:
        return np.full(len(pairs.cracks), crack_clearances[0])
    n_cracks = int(pairs.cracks.max(initial=-1)) + 1
    if scene.disk is not None:  # every cracked blade has the same cracks
        n_cracks //= max(len(scene.disk.cracked), 1)
    if n_cracks and len(crack_clearances) != n_cracks:
        requirement = (
            f"[crack] alone, for all cracks, or one table for each of the {n_cracks} cracks of the"
            " mesh file, from bottom to top: first [crack], then [[cracks]]"
        )
        raise InputError("cracks", f"{len(crack_clearances)} tables with [crack]", requirement)
    return np.asarray(crack_clearances[pairs.cracks % len(crack_clearances)])


def list_mean_cos_and_sin_force_vectors(scene: Scene) -> list[Vector]:
    """Return the force vectors of ``[excitation]``: mean, then cosine and sine parts [N].

    K is the highest order among all loads in the scene. The list has 2K+1 vectors: mean, cosine and
    sine part of order 1, then of order 2, up to K. A part without a force is a zero vector.
    """
    excitation, zero_vector = scene.excitation, (0.0,) * scene.dimension
    mean_cos_and_sin_forces = excitation.force_mean, excitation.force_cos, excitation.force_sin
    rows = [part or zero_vector for part in mean_cos_and_sin_forces] + [zero_vector] * (
        2 * scene.highest_load_harmonic - 2
    )
    add_harmonics(rows, excitation.harmonics)
    if excitation.wave is not None:
        for row_index, part in enumerate(
            fit_load_wave_harmonics_and_residual(excitation, scene.dimension)[0]
        ):
            rows[row_index] = tuple(np.add(rows[row_index], part).tolist())
    return rows


def fit_load_wave_harmonics_and_residual(
    load: Excitation, dimension: int
) -> tuple[np.ndarray, float]:
    """Compute Fourier coefficients from a load's ``wave``, a table of force over a period.

    ``dimension`` is the number of force components in the table, 2 or 3.

    Returns
    -------
    coefficients : (2K+1, dimension)
        Mean, then cosine and sine part of each order, from 1 to K = ``wave_harmonics``.
    residual : float
        Root mean square of the table minus the fitted Fourier series, divided by the root mean
        square of the table minus the mean.
    """
    return read_load_harmonics_and_error(
        load.full_key("wave"), load.given("wave"), load.wave_harmonics, dimension
    )
