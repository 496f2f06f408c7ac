"""Another finite-element program: CalculiX."""

from functools import cache
from typing import Any

import numpy as np
import paper_plate
import scipy.sparse as sparse
from beams import THICK
from book import Row, case, label
from inp import (
    calculix,
    linear_transient,
    mesh_lines,
    natural,
    nodal_diameters,
    sector_lines,
    static,
    stored_matrices,
    ties,
    transient,
)
from plates import cracked_plate, csr
from scipy.sparse.linalg import spsolve
from surroundings import ROOT

import fenics_crack as fc
from fenics_crack.disk.wheel import Wheel

COUNT = 4
GRID = {"layout": "grid", "columns": 16, "rows": 16, "order": 2}
GRADED = {"layout": "graded", "size": 0.01, "lip_elements": 8, "grading": 50.0, "order": 2}


def plate(mesh: dict[str, Any], poisson: float = 0.3) -> tuple[fc.Scene, fc.Structure]:
    """Square of 0.1 m, clamped below, pulled above, with a crack to its middle."""
    crack = {"edge": "left", "height": 0.05, "length": 0.05}
    scene = cracked_plate(
        0.1, 0.1, [crack], mesh,
        **{
            "material.young": 2e9, "material.density": 7800.0, "material.poisson": poisson,
            "geometry.thickness": 0.01,
        },
    )  # fmt: skip
    return scene, fc.build_structure(scene)


def with_eight_nodes(structure: fc.Structure) -> fc.Structure:
    """The middle node of each quadrilateral where the polynomial of the eight others has it.

    u_9 = -(u_1 + ... + u_4) / 4 + (u_5 + ... + u_8) / 2, so M, K and B are those of elements with
    eight nodes.
    """
    cells, dofs = structure.nodes.cells, structure.nodes.dofs
    middle = dofs[cells[:, 8]].ravel()
    kept_dofs = np.setdiff1d(np.arange(structure.n_dofs), middle)
    corner_dofs = dofs[cells[:, :8]]  # (cell, node, axis)
    weights = np.repeat([-0.25, 0.5], 4)[None, :, None] * np.ones(corner_dofs.shape)
    rows = np.broadcast_to(dofs[cells[:, 8]][:, None, :], corner_dofs.shape)
    is_free = corner_dofs >= 0
    interpolation = sparse.coo_matrix(
        (
            np.concatenate([np.ones(len(kept_dofs)), weights[is_free]]),
            (
                np.concatenate([kept_dofs, rows[is_free]]),
                np.concatenate([kept_dofs, corner_dofs[is_free]]),
            ),
        ),
        shape=(structure.n_dofs, structure.n_dofs),
    )
    basis = interpolation.tocsc()[:, kept_dofs]
    mass, stiffness = (basis.T @ csr(m) @ basis for m in (structure.mass, structure.stiffness))
    gap = basis.T @ structure.apply_bt(np.eye(structure.n_dofs))
    return fc.Structure.from_matrices(mass, stiffness, gap=gap)


@cache
def frequencies() -> dict[str, tuple[np.ndarray, np.ndarray, float]]:
    """By name: ours and CalculiX's [rad/s], and the difference allowed."""
    frequency_pairs = {}
    for poisson, element, lips in (
        (0.0, "CPS8", "open"), (0.0, "CPS8", "tied"), (0.3, "CPE8", "open"), (0.3, "CPE8", "tied")
    ):  # fmt: skip
        scene, structure = plate(GRID, poisson)
        lines = mesh_lines(structure, scene, element)
        lines += ties(structure) if lips == "tied" else []
        ours = fc.solve_modes(with_eight_nodes(structure), COUNT, lips=lips).omega
        frequency_pairs[f"{element}, nu = {poisson:g}, {lips}"] = ours, natural(lines, COUNT), 1e-5
    scene, structure = plate(GRADED)
    theirs = natural(mesh_lines(structure, scene, "CPE8"), COUNT)
    ours = fc.solve_modes(with_eight_nodes(structure), COUNT).omega
    frequency_pairs["CPE8, graded, open"] = ours, theirs, 1e-5
    ours = fc.solve_modes(structure, COUNT).omega
    frequency_pairs["CPE8, graded, open, against nine nodes"] = ours, theirs, 1e-3
    for lips in ("open", "tied"):
        scene, structure = plate(GRID | {"cells": "triangle"})
        lines = mesh_lines(structure, scene, "CPE6") + (ties(structure) if lips == "tied" else [])
        ours = fc.solve_modes(structure, COUNT, lips=lips).omega
        frequency_pairs[f"CPE6, nu = 0.3, {lips}"] = ours, natural(lines, COUNT), 2e-5
    return frequency_pairs


def draw_frequencies(axes: Any) -> None:
    """Differences of each mode, mesh by mesh."""
    for place, (name, (ours, theirs, _)) in enumerate(frequencies().items()):
        style = f"C{place // 2}{'os'[place % 2]}-"
        axes.semilogy(
            np.arange(1, COUNT + 1), np.abs(ours / theirs - 1.0), style, label=name, ms=4, lw=1
        )
    axes.axhline(1e-4, color="0.5", ls=":", lw=1)
    axes.set(xlabel="mode", ylabel="relative difference", xticks=range(1, COUNT + 1))
    axes.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))


@case(draw=draw_frequencies, maker=calculix)
def calculix_frequencies() -> list[Row]:
    """CalculiX: natural frequencies with the crack open and bonded.

    The paper's square plate of 0.1 m, E = 2e9 Pa, 7800 kg/m^3, with a crack to its middle, on 16 x
    16 quadrilaterals or as many pairs of triangles, and on graded quadrilaterals. Both programs get
    the same nodes and cells. A bonded crack is B^T u = 0.

    Quadratic quadrilaterals have nine nodes here and eight there (CPS8, CPE8). With ours restricted
    by u9 = -(u1 + ... + u4) / 4 + (u5 + ... + u8) / 2 both agree to the digits printed, 1e-7; the
    nine nodes themselves differ by 6e-3 on 16 x 16 cells and by 6e-4 on the graded mesh.

    CalculiX's plane stress is 0.2 % too stiff where nu = 0.3, so CPS8 is compared with nu = 0. With
    nu = 0.3 plane strain is taken: with E (1 + 2 nu) / (1 + nu)^2 and nu / (1 + nu) its equations
    are those of plane stress.
    """
    return [
        Row(f"{name}: mode {mode + 1} [rad/s]", ours[mode], theirs[mode], tolerance)
        for name, (ours, theirs, tolerance) in frequencies().items()
        for mode in range(COUNT)
    ]


SPEEDS = (0.0, 3000.0, 6000.0, 9000.0)
"""[rpm]"""
RPM = np.pi / 30.0
"""[rad/s]"""


@cache
def rotating_blade() -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """By speed [rpm]: six frequencies of the twisted blade, ours and CalculiX's [Hz]."""
    scene = fc.Scene.load(ROOT / "demos" / "solid_blade.toml")
    structure = fc.build_structure(scene)
    lines, hertz_by_rpm = mesh_lines(structure, scene, "C3D10"), {}
    place = ", ".join(f"{x:.13e}" for x in np.concatenate(scene.axis_point_and_direction))
    for rpm in SPEEDS:
        loads = ["*DLOAD", f"PLATE, CENTRIF, {(RPM * rpm) ** 2:.13e}, {place}"] if rpm else None
        ours = fc.solve_modes(structure.rotation.structure_rotating_at_speed(RPM * rpm), 6).omega
        hertz_by_rpm[rpm] = ours / (2.0 * np.pi), natural(lines, 6, loads) / (2.0 * np.pi)
    return hertz_by_rpm


def draw_rotating_blade(axes: Any) -> None:
    """Differences over the speed."""
    ours, theirs = (np.array(side) for side in zip(*rotating_blade().values(), strict=True))
    for mode, difference in enumerate((ours / theirs - 1.0).T, 1):
        axes.plot(SPEEDS, 1e3 * difference, "o-", ms=4, lw=1, label=f"mode {mode}")
    axes.axhline(0.0, color="0.5", ls=":", lw=1)
    axes.set(xlabel="speed [rpm]", ylabel="relative difference [1/1000]")
    axes.legend(fontsize="x-small")


@case(draw=draw_rotating_blade, maker=calculix)
def calculix_rotating_blade() -> list[Row]:
    """CalculiX: natural frequencies of a twisted blade that rotates.

    The titanium blade of `demos/solid_blade.toml`, 123 mm high, twisted by 30 degrees, with an open
    crack at its leading edge, 0.25 m from the axis. Both programs get the second-order tetrahedra
    of `meshes/solid_blade.msh`.

    Reference: CalculiX with `*DLOAD, CENTRIF` in a static step with large displacements (`NLGEOM`),
    and `*FREQUENCY` in a `PERTURBATION` step. At speed ours displaces the blade linearly; what that
    leaves out grows with the fourth power of the speed.
    """
    return [
        Row(f"{rpm:g} rpm: mode {mode} [Hz]", ours, theirs, 1e-3)
        for rpm, sides in rotating_blade().items()
        for mode, (ours, theirs) in enumerate(zip(*sides, strict=True), 1)
    ]


@cache
def opened() -> tuple[fc.Structure, np.ndarray, np.ndarray]:
    """A plate of triangles, and its displacement when pulled, ours and CalculiX's."""
    scene, structure = plate(GRID | {"cells": "triangle"})
    force = structure.force[0]
    ours = spsolve(csr(structure.stiffness).tocsc(), force)
    return structure, ours, static(mesh_lines(structure, scene, "CPE6"), structure, force)


def draw_opening(axes: Any) -> None:
    """Over the distance from the mouth."""
    structure, *motions = opened()
    for motion, style, name in zip(motions, ("-", "kx"), ("fenics_crack", "CalculiX"), strict=True):
        opening = -structure.apply_bt(motion[None])[0]
        axes.plot(1e3 * structure.pairs.positions, 1e12 * opening, style, label=name)
    label(axes, xlabel="distance from the mouth [mm]", ylabel="opening [pm]")


@case(draw=draw_opening, maker=calculix)
def calculix_crack_opening() -> list[Row]:
    """CalculiX: a crack that is pulled open.

    The plate of [natural frequencies](calculix_frequencies.md), triangles, nu = 0.3, pulled at its
    upper edge with 1 Pa: the same nodes and the same forces on them. Openings of nodes of the crack
    faces, from the mouth (position 0) towards the tip, and the work of the forces.
    """
    structure, *motions = opened()
    openings = [-structure.apply_bt(motion[None])[0] for motion in motions]
    positions = structure.pairs.positions
    rows = []
    for place in (0.0, 0.0125, 0.025, 0.0375):
        pair = int(np.argmin(np.abs(positions - place)))
        name = f"opening at {round(1e3 * abs(positions[pair]), 6):g} mm [m]"
        rows += [Row(name, openings[0][pair], openings[1][pair], 1e-5)]
    ours, theirs = (float(structure.force[0] @ motion) for motion in motions)
    return [*rows, Row("f . u [J]", ours, theirs, 1e-5)]


# --- contact in time ------------------------------------------------------------------------------

STEPS, PERIODS = 200, 2
"""Of CalculiX, a period of the load; ours are eight times as many."""
TIP_STEPS, YOUNG = 80, 2e9
"""The same, and Young's modulus [Pa], where stress intensities are compared."""


@cache
def breathing_plate() -> tuple[fc.Scene, fc.Structure, fc.ContactLaw]:
    """The plate with 8 x 4 bilinear cells, C = 1e-5 s K, and a soft contact."""
    scene = fc.Scene.from_mapping(
        {
            "geometry": {"width": 0.1, "height": 0.1, "thickness": 0.01},
            "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
            "mesh": {"layout": "grid", "columns": 8, "rows": 4},
            "crack": {"edge": "left", "height": 0.05, "length": 0.05},
            "contact": {"stiffness_per_area": 1e11},
            "damping": {"stiffness": 1e-5},
            "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [10.0, 0.0]},
        }
    )
    study = fc.prepare(scene, whole=True)
    return scene, study.structure, study.contact


@cache
def breathing() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By start: waves (two, instant) of the mouth's gap and of the corner, ours and CalculiX's."""
    scene, structure, law = breathing_plate()
    omega = scene.excitation.omega
    corner = [structure.find_dof((0.1, 0.1), "x")]
    time = np.arange(PERIODS * STEPS) * 2.0 * np.pi / omega / STEPS

    def theirs(start: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        instants, motion = transient(scene, structure, STEPS, PERIODS, start)
        waves = (structure.apply_bt(motion)[:, 0], motion[:, corner[0]])
        return np.array([np.interp(time, instants, wave) for wave in waves])

    rest = np.zeros(structure.n_dofs)
    march = fc.integrate_central_difference(
        structure, omega, law, periods=PERIODS, steps_per_period=8 * STEPS
    )
    ours = np.array([march.gap[::8, 0], march.displacement(corner)[::8, 0]])
    orbit = fc.solve_harmonic_balance(structure, omega, law, harmonics=40)
    rows = orbit.displacement_coefficients
    speed = omega * np.arange(1, 41) @ rows[2::2]
    steady = np.array([orbit.gap(time)[:, 0], orbit.displacement(time, corner)[:, 0]])
    return {
        "from rest": (ours, theirs((rest, rest))),
        "on the orbit": (steady, theirs((rows[0] + rows[1::2].sum(axis=0), speed))),
    }


def draw_breathing_plate(axes: Any) -> None:
    """The opening of the mouth."""
    share = np.arange(PERIODS * STEPS) / STEPS
    for (start, (ours, theirs)), name, colour in zip(
        breathing().items(), ("direct integration", "harmonic balance"), ("C0", "C1"), strict=True
    ):
        axes.plot(share, -1e6 * ours[0], color=colour, label=f"{start}: {name}")
        axes.plot(share[::8], -1e6 * theirs[0, ::8], "k." if colour == "C0" else "kx", ms=4,
                  label=f"{start}: CalculiX")  # fmt: skip
    axes.axhline(0.0, color="0.7", lw=1)
    axes.set(xlabel="t / period", ylabel="opening of the mouth [µm]", xlim=(0.0, PERIODS))
    axes.legend(fontsize="x-small")


@case(draw=draw_breathing_plate, maker=calculix)
def calculix_breathing_plate() -> list[Row]:
    """CalculiX: a plate whose crack opens and closes.

    The square plate of 0.1 m, 10 mm thick, nu = 0.3, with a crack to its middle: 8 x 4 bilinear
    cells, four pairs. Damping C = 1e-5 s K; 10 N sin(2000 t) along the upper edge at the corner;
    contact of 1e11 Pa for each metre of depth.

    Reference: CalculiX with its own contact, integrated over faces (`SURFACE TO SURFACE`), and its
    own integration (`*DYNAMIC`, steps of 1/200 of a period and shorter), on a layer of bricks with
    the constants of [natural frequencies](calculix_frequencies.md). First both start from rest,
    ours by `fc.integrate_central_difference`, 1600 steps a period. Then CalculiX starts from our
    harmonic balance (H = 40, all modes) and has to stay on its orbit: its second period gives the
    harmonics.

    Differences are the largest of two periods over the largest value; 2 % are allowed. A contact
    stiffness of 0.8 or 1.25 times CalculiX's would be 2.6 or 2.1 % away.
    """
    rows = []
    for start, (ours, theirs) in breathing().items():
        for place, name in enumerate(("the mouth's gap", "the corner's displacement")):
            relative_difference = (
                np.abs(ours[place] - theirs[place]).max() / np.abs(theirs[place]).max()
            )
            rows += [
                Row(f"{start}: {name}, difference", relative_difference, 0.0, 0.02, absolute=True)
            ]
        rows += [Row(f"{start}: largest opening [m]", -ours[0].min(), -theirs[0].min(), 0.02)]
        closed_shares = [float(np.mean(waves[0] > 0.0)) for waves in (ours, theirs)]
        rows += [Row(f"{start}: share of the time closed", *closed_shares, 0.01, absolute=True)]
    steady = [np.fft.rfft(wave[0, STEPS:]) / STEPS for wave in breathing()["on the orbit"]]
    rows += [Row("on the orbit: mean gap [m]", steady[0][0].real, steady[1][0].real, 0.02)]
    ours, theirs = (2.0 * np.abs(spectrum[1:4]) for spectrum in steady)
    for k in (1, 2):
        rows += [Row(f"on the orbit: abs(g{k}) [m]", ours[k - 1], theirs[k - 1], 0.02)]
    shares = ours[2] / ours[0], theirs[2] / theirs[0]
    return [*rows, Row("on the orbit: abs(g3) / abs(g1)", *shares, 0.01, absolute=True)]


@cache
def from_rest() -> dict[str, tuple[np.ndarray, ...]]:
    """By contact stiffness: periods since the start, the mouth's gap and the corner's displacement
    (two, instant), ours and CalculiX's."""
    waves = {}
    for name, (stiffness, ratio, _) in paper_plate.CASES.items():
        scene = paper_plate.scene_of(stiffness, ratio)
        structure = fc.build_structure(scene)
        corner = [structure.find_dof((0.1, 0.1), "x")]
        history = fc.integrate_events(
            structure, scene.excitation.omega, fc.UnilateralPenalty(stiffness),
            periods=paper_plate.PERIODS, steps_per_period=paper_plate.INSTANTS,
        )  # fmt: skip
        ours = np.array([history.gap[:, 0], history.displacement(corner)[:, 0]])
        theirs = np.loadtxt(paper_plate.FOLDER / f"{name}.csv", delimiter=",").T
        waves[name] = (scene.excitation.omega * history.time / (2.0 * np.pi), ours, theirs)
    return waves


def draw_from_rest(axes: Any) -> None:
    """The opening of the mouth."""
    for (name, (periods, ours, theirs)), colour in zip(
        from_rest().items(), ("C0", "C1"), strict=True
    ):
        axes.plot(periods, -1e6 * ours[0], color=colour, label=f"{name} N/m: exact flow")
        axes.plot(periods[::10], -1e6 * theirs[0, ::10], "kx", ms=3,
                  label="CalculiX" if colour == "C1" else None)  # fmt: skip
    axes.axhline(0.0, color="0.7", lw=1)
    axes.set(xlabel="t / period", ylabel="opening of the mouth [µm]", xlim=(0.0, 5.0))
    axes.legend(fontsize="x-small")


@case(draw=draw_from_rest)
def calculix_paper_plate() -> list[Row]:
    """CalculiX: the paper's plate from rest.

    Figure 2 of the paper: the crack over five periods from rest, on the mesh of
    `demos/paper_plate.toml` (2 x 8 bilinear cells, one pair). C = 2 xi K / w1, w1 the first
    frequency with an open crack; 100 N sin(2000 t); the paper's data, 1e11 N/m and xi = 0.1 %, and
    1e9 N/m and 1 %.

    Reference: CalculiX with its own contact (`SURFACE TO SURFACE`) and integration (`*DYNAMIC`, at
    most 1/200 of a period a step with 1e9 N/m, 1/800 with 1e11 N/m), on bricks as
    [here](calculix_breathing_plate.md). Its 3 k / (length thickness) for each metre of depth is our
    k, as pressure pushes the mouth's node with a third of pressure times area. Ours is the exact
    flow of `fc.integrate_events`. Differences are over the largest value.

    References and input file are in `tests/exchange/paper_plate/`;
    `tests/verification/paper_plate.py` makes them.
    """
    rows = []
    count = paper_plate.INSTANTS
    for name, tolerances in (("1e9", {2: 0.02, 5: 0.04}), ("1e11", {5: 0.02})):
        _, ours, theirs = from_rest()[name]
        for periods, bound in tolerances.items():
            for place, quantity in enumerate(("the mouth's gap", "the corner's displacement")):
                a, b = ours[place, : periods * count], theirs[place, : periods * count]
                relative_difference = np.abs(a - b).max() / np.abs(b).max()
                rows += [Row(f"{name} N/m, {periods} periods: {quantity}, difference",
                             relative_difference, 0.0, bound, absolute=True)]  # fmt: skip
        widest = -ours[0].min(), -theirs[0].min()
        rows += [Row(f"{name} N/m: largest opening [m]", *widest, 0.01)]
        open_shares = [float(np.mean(wave[0] > -0.01 * widest[1])) for wave in (ours, theirs)]
        rows += [Row(f"{name} N/m: share of the time open by less than 1 % of it", *open_shares,
                     0.01, absolute=True)]  # fmt: skip
    return rows


@cache
def vibrating_tip() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants [s], and K_I [Pa m^1/2] then: ours, and CalculiX's by the opening near the tip."""
    mesh = {"layout": "graded", "size": 0.02, "lip_elements": 24, "grading": 12.0, "order": 2}
    crack = {"edge": "left", "height": 0.05, "length": 0.05, "clearance": 1.0}
    scene = cracked_plate(
        0.1, 0.1, [crack], mesh,
        **{
            "loads": None, "material.young": YOUNG, "material.density": 7800.0,
            "geometry.thickness": 0.01, "excitation.omega": 1500.0, "damping.ratio": 0.0,
            "integration.periods": 1, "integration.steps_per_period": 8 * TIP_STEPS,
            "reduction.modes": 30,
        },
    )  # fmt: skip
    run = fc.integrate(scene)
    intensity, structure = fc.stress_intensity(run), run.structure.whole
    instants, displacements = linear_transient(scene, structure, "CPE8", TIP_STEPS, 1)
    distance = 0.05 - structure.pairs.positions
    is_near = (distance > 0.003) & (distance < 0.015)
    roots = np.sqrt(2.0 * np.pi / distance[is_near])
    intensities = YOUNG / 8.0 * roots * -structure.apply_bt(displacements)[:, is_near]
    theirs = np.polyfit(distance[is_near], intensities.T, 1)[-1]
    return intensity.time, intensity.K_I[:, 0], np.interp(intensity.time, instants, theirs)


def draw_vibrating_tip(axes: Any) -> None:
    """K_I over time."""
    time, ours, theirs = vibrating_tip()
    axes.plot(1e3 * time, ours, label="fenics_crack, interaction integral")
    axes.plot(1e3 * time[::16], theirs[::16], "kx", ms=4, label="CalculiX, crack opening")
    axes.axhline(0.0, color="0.7", lw=1)
    axes.set(xlabel="t [ms]", ylabel="K_I [Pa m$^{1/2}$]")
    axes.legend(fontsize="x-small")


@case(draw=draw_vibrating_tip, maker=calculix)
def calculix_stress_intensity() -> list[Row]:
    """CalculiX: stress intensity of a plate that vibrates from rest.

    The square plate of [natural frequencies](calculix_frequencies.md) without damping, whose crack
    faces never touch, under 1 N sin(1500 t) at its upper corner, from rest. Both programs get the
    same nodes, 24 graded elements along a crack face.

    Reference: CalculiX's integration (`*DYNAMIC, DIRECT`, 80 steps a period) in plane strain with
    the constants of plane stress. K_I is the crack's opening 3 to 15 mm from the tip times E / 8 (2
    pi / r)^1/2, by a straight line to r = 0. Ours is the interaction integral over `fc.integrate`,
    30 modes and the statics that they leave out, 640 steps a period. The difference is the largest
    of a period over the largest value.
    """
    _, ours, theirs = vibrating_tip()
    size = np.abs(theirs).max()
    return [
        Row("K_I, difference", np.abs(ours - theirs).max() / size, 0.0, 0.02, absolute=True),
        Row("largest K_I [Pa m^0.5]", ours.max(), theirs.max(), 0.02),
        Row("smallest K_I [Pa m^0.5]", ours.min(), theirs.min(), 0.02),
    ]


# --- solids ---------------------------------------------------------------------------------------


@cache
def solid_beam(crack: bool) -> tuple[fc.Scene, fc.Structure]:
    """The deep beam of `beams.py`, 300 x 20 x 20 mm, as a solid, with a through crack of 6 mm."""
    mesh = {"layout": "graded", "size": 0.007, "order": 2, "error": False}
    tables: dict[str, Any] = {
        "geometry": {"kind": "solid", "width": 0.02, "height": 0.3, "thickness": 0.02},
        "material": {"young": 206e9, "poisson": 0.3, "density": 7850.0},
        "damping": {"ratio": 0.002},
        "excitation": {"omega": 1.0, "point": [0.0, 0.3, 0.01], "force_cos": [1.0, 0.0, 0.0]},
        "mesh": mesh,
    }
    if crack:
        mesh["lip_elements"] = 3
        tables |= {"crack": {"edge": "left", "height": 0.08, "length": 0.006}}
        tables |= {"contact": {"law": "unilateral"}}
    scene = fc.Scene.from_mapping(tables)
    return scene, fc.build_structure(scene)


@cache
def solid_frequencies() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of the whole and of the cracked beam: ours and CalculiX's [Hz]."""
    hertz_by_body = {}
    for name, crack in (("whole", False), ("cracked", True)):
        scene, structure = solid_beam(crack)
        omegas = (
            fc.solve_modes(structure, 6).omega,
            natural(mesh_lines(structure, scene, "C3D10"), 6),
        )
        hertz_by_body[name] = omegas[0] / (2.0 * np.pi), omegas[1] / (2.0 * np.pi)
    return hertz_by_body


def draw_solids(axes: Any) -> None:
    """Differences of each mode."""
    for name, (ours, theirs) in solid_frequencies().items():
        axes.semilogy(range(1, 7), np.abs(ours / theirs - 1.0), "o-", label=name, ms=4, lw=1)
    axes.axhline(1e-4, color="0.5", ls=":", lw=1)
    label(axes, xlabel="mode", ylabel="relative difference", xticks=range(1, 7))


@case(draw=draw_solids, maker=calculix)
def calculix_solids() -> list[Row]:
    """CalculiX: a solid beam with a crack through it.

    A steel cantilever of 300 x 20 x 20 mm, E = 206e9 Pa, nu = 0.3, 7850 kg/m^3, whole and with an
    open crack 6 mm deep, 80 mm from the clamp. Both programs get the same tetrahedra with ten nodes
    (C3D10). As another gmsh makes others, rows are quotients: ours over CalculiX's.

    Then the program reads CalculiX's matrices (`*FREQUENCY, SOLVER=MATRIXSTORAGE`) with the input
    file and finds the pairs of the crack ([matrices](../matrices.md)). A force along the beam at
    its free end pulls the crack open: openings, and work.

    Last rows: a mesh of 75,000 dofs, [beams with a spring](open_crack_in_a_beam.md), plane stress,
    and a measured beam with a cut (174.7 of 185.2 Hz: Shock and Vibration 2019, article 7302057).
    """

    def quotients(name: str, ours: Any, theirs: Any, tolerance: float) -> list[Row]:
        ratios = np.atleast_1d(np.asarray(ours) / theirs)
        suffixes = [f": mode {mode}" for mode in range(1, 7)] if len(ratios) == 6 else [""]
        columns = zip(suffixes, ratios, strict=True)
        return [Row(f"{name}{end}", ratio, 1.0, tolerance) for end, ratio in columns]

    hertz_by_body = solid_frequencies()
    rows = [row for name, pair in hertz_by_body.items() for row in quotients(name, *pair, 1e-5)]
    scene, structure = solid_beam(True)
    lines = mesh_lines(structure, scene, "C3D10")
    with stored_matrices(lines, scene) as stored_scene:
        read_structure = fc.build_structure(stored_scene)
    read_hertz = fc.solve_modes(read_structure, 6).omega / (2.0 * np.pi)
    is_near = np.abs(read_hertz / hertz_by_body["cracked"][1] - 1.0) < 1e-6
    rows += [Row("its matrices, read: modes of six that are within 1e-6", is_near.sum(), 6, 0.0)]
    rows += quotients(
        "pairs found, over those meshed", read_structure.n_pairs, structure.n_pairs, 0.0
    )
    rows += quotients(
        "their area", read_structure.pair_areas.sum(), structure.pair_areas.sum(), 1e-9
    )
    force = np.zeros(structure.n_dofs)
    force[structure.find_dof((0.0, 0.3, 0.0), "y")] = 1000.0
    displacement = spsolve(csr(structure.stiffness).tocsc(), force, "MMD_AT_PLUS_A")
    theirs = static(lines, structure, force)
    openings = [
        structure.apply_bt(motion[None])[0, structure.first_watched_pair]
        for motion in (displacement, theirs)
    ]
    rows += quotients("opening at the mouth", *openings, 1e-5)
    rows += quotients("f . u", force @ displacement, force @ theirs, 1e-5)
    whole_hertz, cracked_hertz = hertz_by_body["whole"][0], hertz_by_body["cracked"][0]
    ratio = cracked_hertz[0] / whole_hertz[0]
    return [
        *rows,
        Row("whole: mode 1 [Hz], 75,000 dofs", whole_hertz[0], 183.90, 1e-3),
        Row("whole: mode 3 [Hz], 75,000 dofs", whole_hertz[2], 1129.47, 1e-3),
        Row("cracked: mode 1 [Hz], 75,000 dofs", cracked_hertz[0], 175.53, 6e-3),
        Row("cracked: mode 2 [Hz], 75,000 dofs", cracked_hertz[1], 181.29, 6e-3),
        Row("first, cracked over whole: beam with a spring", ratio, 0.9529, 0.01),
        Row("first, cracked over whole: plane stress", ratio, THICK.plate_ratios(0.3)[0], 0.01),
        Row("first, cracked over whole: measured", ratio, 174.7 / 185.2, 0.02),
    ]


# --- bladed disks ---------------------------------------------------------------------------------

SECTORS, FAMILIES = 8, 3
DIAMETERS = range(SECTORS // 2 + 1)
FAST = 6000.0
"""[rpm]"""


def wheel(rpm: float) -> tuple[fc.Scene, Wheel]:
    """Eight blades of 60 x 10 x 6 mm on a disk of 70 mm, clamped at 20 mm, at a speed."""
    exciter = {"order": 2, "point": [0.005, 0.06, 0.003], "force_cos": [0.0, 0.0, 1.0]}
    tables: dict[str, Any] = {
        "geometry": {"kind": "solid", "width": 0.01, "height": 0.06, "thickness": 0.006},
        "material": {"young": 2.1e11, "poisson": 0.3, "density": 7850.0},
        "damping": {"ratio": 0.002},
        "disk": {"sectors": SECTORS, "inner_radius": 0.02, "outer_radius": 0.07},
        "mesh": {"layout": "graded", "size": 0.005, "order": 2, "error": False},
        "excitation": exciter if rpm else exciter | {"frequency": 400.0},
    }
    if rpm:
        tables["rotation"] = {"rpm": rpm}
    scene = fc.Scene.from_mapping(tables)
    structure = fc.build_structure(scene)
    assert isinstance(structure, Wheel)
    return scene, structure


def mass_at_four_points(structure: fc.Structure, density: float, shapes: np.ndarray) -> np.ndarray:
    """v^H M v of shapes (n_dofs, m), with M of tetrahedra with straight sides by the four points of
    a rule for polynomials of degree 2."""
    nodes = structure.nodes
    corners = nodes.points[nodes.cells[:, :4]]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    near_weight, far_weight = (5.0 + 3.0 * 5.0**0.5) / 20.0, (5.0 - 5.0**0.5) / 20.0
    places = np.full((4, 4), far_weight) + (near_weight - far_weight) * np.eye(4)  # (point, corner)
    first_corners, second_corners = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]).T
    values = np.hstack(
        [places * (2.0 * places - 1.0), 4.0 * places[:, first_corners] * places[:, second_corners]]
    )
    motion = np.vstack([shapes, np.zeros(shapes.shape[1])])[nodes.dofs[nodes.cells]]
    motion = np.einsum("cnij,cnjm->cnim", nodes.frames[nodes.cells], motion)
    squares = np.abs(np.einsum("pn,cnam->cpam", values, motion)) ** 2
    return density / 4.0 * np.einsum("c,cpam->m", volumes, squares)


@cache
def wheel_frequencies(rpm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the wheel, (nodal diameter, family) [Hz]: ours, ours with CalculiX's points of the mass,
    and CalculiX's."""
    scene, structure = wheel(rpm)
    modes, sector = structure.cyclic_modes(FAMILIES), structure.sector
    ours, density = np.array(modes.omega), scene.material.density
    masses = [mass_at_four_points(sector.structure, density, v) for v in modes.shapes]
    place = ", ".join(f"{x:.13e}" for x in np.concatenate(scene.axis_point_and_direction))
    loads = ["*DLOAD", f"PLATE, CENTRIF, {(RPM * rpm) ** 2:.13e}, {place}"] if rpm else None
    theirs = nodal_diameters(sector_lines(sector, scene), SECTORS, FAMILIES, loads)
    hertz = 1.0 / (2.0 * np.pi)
    return hertz * ours, hertz * ours / np.sqrt(masses), hertz * theirs


def draw_wheel(axes: Any) -> None:
    """Frequencies at rest, over the nodal diameter."""
    ours, _, theirs = wheel_frequencies(0.0)
    for family, (our_family, their_family) in enumerate(zip(ours.T, theirs.T, strict=True), 1):
        axes.plot(DIAMETERS, 1e-3 * our_family, label=f"fenics_crack, family {family}")
        axes.plot(
            DIAMETERS, 1e-3 * their_family, "kx", label="CalculiX" if family == FAMILIES else None
        )
    axes.set(xlabel="nodal diameter", ylabel="natural frequency [kHz]", xticks=DIAMETERS)
    axes.set_ylim(0.0)
    axes.legend(fontsize="x-small")


@case(draw=draw_wheel, maker=calculix)
def calculix_nodal_diameters() -> list[Row]:
    """CalculiX: nodal diameters of a bladed disk.

    Eight steel blades of 60 x 10 x 6 mm on a disk 10 mm thick, from 20 mm, where it is clamped, to
    70 mm about the axis, E = 2.1e11 Pa, nu = 0.3, 7850 kg/m^3, without a crack.

    Reference: CalculiX's `*CYCLIC SYMMETRY MODEL` with `*SELECT CYCLIC SYMMETRY MODES` of one
    sector, with the same straight tetrahedra (C3D10). At speed: a static step (`NLGEOM`) under
    `*DLOAD, CENTRIF`, and `*FREQUENCY` in a `PERTURBATION` step.

    CalculiX integrates the mass at four points of each tetrahedron, which is exact to the second
    degree; ours is exact. With CalculiX's mass of our modes v, w (v^H M v)^(-1/2), both agree to
    the digits printed, 5e-7 (last rows). Rows are quotients, ours over CalculiX's.
    """
    rows = []
    for rpm, name in ((0.0, "at rest"), (FAST, f"{FAST:g} rpm")):
        ours, _, theirs = wheel_frequencies(rpm)
        rows += [
            Row(f"{name}: n = {n}, family {family + 1}", ratio, 1.0, 1e-5)
            for (n, family), ratio in np.ndenumerate(ours / theirs)
        ]
    for rpm, name in ((0.0, "at rest"), (FAST, f"{FAST:g} rpm")):
        _, same_mass_hertz, theirs = wheel_frequencies(rpm)
        max_differences = np.abs(same_mass_hertz / theirs - 1.0).max(axis=0)
        rows += [
            Row(f"{name}, mass by four points: family {family + 1}, largest difference", x, 0.0,
                1e-6, absolute=True)
            for family, x in enumerate(max_differences)
        ]  # fmt: skip
    return rows
