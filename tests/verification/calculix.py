"""Another finite-element program: CalculiX."""

from functools import cache

import numpy as np
from book import Row, case
from inp import calculix, mesh_lines, natural, static, ties
from plates import cracked_plate, csr
from scipy.sparse.linalg import spsolve

import fenics_crack as fc

COUNT = 4
THIN = 1e-5
"""Thickness over the width of the plate's 0.1 m, so that its stress is plane [m]."""


@cache
def plate(poisson: float, cells: int) -> tuple[fc.Scene, fc.Structure]:
    """Square of 0.1 m, clamped below, pulled above, with a crack to its middle."""
    mesh = {"layout": "grid", "columns": cells, "rows": cells, "cells": "triangle", "order": 2}
    crack = {"edge": "left", "height": 0.05, "length": 0.05}
    scene = cracked_plate(
        0.1, 0.1, [crack], mesh,
        **{
            "material.young": 2e9, "material.density": 7800.0, "material.poisson": poisson,
            "geometry.thickness": THIN,
        },
    )  # fmt: skip
    return scene, fc.build_structure(scene)


@cache
def both(poisson: float, cells: int, lips: str) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies, ours and CalculiX's, on one mesh [rad/s]."""
    scene, structure = plate(poisson, cells)
    lines = mesh_lines(structure, scene) + (ties(structure) if lips == "tied" else [])
    return fc.solve_modes(structure, COUNT, lips=lips).omega, natural(lines, COUNT)


@case(maker=calculix)
def calculix_frequencies() -> list[Row]:
    """CalculiX: natural frequencies with lips open and tied.

    The paper's square plate of 0.1 m, E = 2e9 Pa, 7800 kg/m^3, with a crack to its middle, on 8 x 8
    and 16 x 16 squares of two triangles with six nodes each. Both programs get the same nodes and
    triangles, CalculiX as CPS6. Tied lips are B^T u = 0: equations there, Lagrange multipliers
    here.

    CalculiX's plane stress is a layer of solid elements whose faces move as one, free in thickness;
    ours has no thickness strain at all. With nu = 0 the two are the same equations on the same
    space. What is left, 1e-8 to 1e-5, is its mass matrix by fewer points. With nu = 0.3 its
    thickness strain is continuous from element to element, which stiffens the layer: by 0.2 % where
    the plate is 10 mm thick, whatever the mesh, and by an amount that falls with the size of the
    elements where it is thin, 10 micrometres here. So these frequencies are compared on one mesh,
    and extrapolated to size 0 with order 1, which is that of both programs at the crack.
    """
    rows = []
    for lips in ("open", "tied"):
        ours, theirs = both(0.0, 16, lips)
        for mode in range(COUNT):
            name = f"nu = 0, {lips}: mode {mode + 1} [rad/s]"
            rows += [Row(name, ours[mode], theirs[mode], 2e-5)]
    for lips in ("open", "tied"):
        coarse, fine = both(0.3, 8, lips), both(0.3, 16, lips)
        limits = [2.0 * two - one for one, two in zip(coarse, fine, strict=True)]
        for mode in range(COUNT):
            name = f"nu = 0.3, {lips}: mode {mode + 1} [rad/s]"
            rows += [Row(name, fine[0][mode], fine[1][mode], 5e-4)]
            rows += [Row(f"{name}, extrapolated", limits[0][mode], limits[1][mode], 2e-4)]
    return rows


@case(maker=calculix)
def calculix_crack_opening() -> list[Row]:
    """CalculiX: a crack that is pulled open.

    The plate of [natural frequencies](calculix_frequencies.md), 16 x 16 squares, pulled at its
    upper edge with 1 Pa: the same six-node triangles and the same forces on their nodes. Openings
    of lip nodes, from the mouth (position 0) towards the tip, and the work of the forces. With
    nu = 0.3 the layer is stiffer by a part of 1e-4, as is said there.
    """
    rows = []
    for poisson, near in ((0.0, 1e-5), (0.3, 5e-4)):
        scene, structure = plate(poisson, 16)
        force = structure.force[0]
        ours = spsolve(csr(structure.stiffness).tocsc(), force)
        nodes = static(mesh_lines(structure, scene), structure, force)
        assert structure.nodes is not None and structure.pairs is not None
        free = structure.nodes.dofs >= 0
        theirs = np.zeros(structure.n_dofs)
        theirs[structure.nodes.dofs[free]] = nodes[free]
        openings = [-structure.apply_bt(motion[None])[0] for motion in (ours, theirs)]
        positions = structure.pairs.positions
        for place in (0.0, 0.0125, 0.025, 0.0375):
            pair = int(np.argmin(np.abs(positions - place)))
            name = f"nu = {poisson:g}: opening at {round(1e3 * abs(positions[pair]), 6):g} mm [m]"
            rows += [Row(name, openings[0][pair], openings[1][pair], near)]
        work = Row(f"nu = {poisson:g}: f . u [J]", float(force @ ours), float(force @ theirs), near)
        rows += [work]
    return rows
