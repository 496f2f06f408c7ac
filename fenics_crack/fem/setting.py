"""Damping, clearances and forces of a scene: what of its structure follows without a mesh."""

from __future__ import annotations

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.model.nodes import Pairs
from fenics_crack.model.periodic_load import read_wave
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping
from fenics_crack.scene.fields import Vector
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Damping, Excitation, add_harmonics


def damping_of(table: Damping) -> DampingRule:
    """The damping that a scene's table describes."""
    if table.ratio is not None:
        return ModalDamping(table.ratio, None if table.modes == "all" else int(table.modes))
    if table.ratios is not None and table.omegas is not None:
        return RayleighDamping.from_ratios(table.ratios, table.omegas)
    return RayleighDamping(table.mass or 0.0, table.stiffness or 0.0)


def clearance_of(scene: Scene, pairs: Pairs) -> np.ndarray:
    """Clearance of every pair, by its crack: (n_pairs,) [m].

    Raises
    ------
    InputError
        There are several tables, but not one for each crack of a mesh file.
    """
    given = np.array([crack.clearance for crack in scene.all_cracks.values()] or [0.0])
    assert pairs.cracks is not None
    if len(given) == 1:
        return np.full(len(pairs.cracks), given[0])
    cracks = int(pairs.cracks.max(initial=-1)) + 1
    if scene.disk is not None:  # those of each cracked blade
        cracks //= max(len(scene.disk.cracked), 1)
    if cracks and len(given) != cracks:
        allowed = f"[crack] alone, for all, or one table for each of the {cracks} cracks of the"
        allowed += " mesh file: [crack] and then [[cracks]], from bottom to top"
        raise InputError("cracks", f"{len(given)} tables with [crack]", allowed)
    return np.asarray(given[pairs.cracks % len(given)])


def force_parts(scene: Scene) -> list[Vector]:
    """Mean, and cosine and sine part of each order, of the force of the excitation [N]; as many as
    the scene's loads have."""
    excitation, zero = scene.excitation, (0.0,) * scene.dimension
    given = excitation.force_mean, excitation.force_cos, excitation.force_sin
    rows = [part or zero for part in given] + [zero] * (2 * scene.highest_order - 2)
    for harmonic in excitation.harmonics:
        sized = len(harmonic.cos) == scene.dimension
        excitation.require(sized, "harmonics", f"of {scene.dimension} components each")
    add_harmonics(rows, excitation.harmonics)
    if excitation.wave is not None:
        for row, part in enumerate(expand_wave(excitation, scene.dimension)[0]):
            rows[row] = tuple(np.add(rows[row], part).tolist())
    return rows


def expand_wave(load: Excitation, dimension: int) -> tuple[np.ndarray, float]:
    """Mean and harmonics of a load's table of one period (2K+1, dimension), and what they leave out
    of it, relative."""
    return read_wave(load.name_of("wave"), load.given("wave"), load.wave_harmonics, dimension)
