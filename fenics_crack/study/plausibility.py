"""Plausibility of a scene: key figures, and remarks on unusual values.

The figures follow from one factor of K and few modes; nothing is solved. With the crack open, K^-1
and the lowest modes give displacement and gap at a frequency w,

    u(w) = K^-1 f + sum_j phi_j (phi_j^T f) [d_j(w) - 1 / w_j^2],
    d_j(w) = 1 / (w_j^2 - w^2 + 2 i xi_j w_j w),

and, by B instead of f, the compliance of the crack faces R(w) = B^T H(w) B. The mean load and the
preload alone close some pairs, by a static contact problem. As long as these stay closed and the
others open, the motion is linear, and the closed ones carry R(w)^-1 B^T u(w) beside their static
force.

Each rule for remarks is a function of the scene, or of the scene and its figures or structure, that
yields them. A remark forbids nothing: it names a key, its value, and what is usual; most often a
unit or a number is mistyped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import RPM, TURN, percent, ranging
from fenics_crack.fem.lips import SAME
from fenics_crack.fem.loads import of_wave
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.factor import Factor
from fenics_crack.model.modes import (
    BilinearFrequencies,
    Modes,
    check_damped_modes,
    count_below,
    modes_by,
    partners,
    solve_modes,
    tied_modes,
    times,
)
from fenics_crack.model.nodes import place_in_words
from fenics_crack.model.reduced import ResidualFlexibility
from fenics_crack.model.rotation import coriolis_shifts
from fenics_crack.model.structure import ModalDamping, RayleighDamping, Structure
from fenics_crack.model.wheel import WheelStructure, in_few_coordinates
from fenics_crack.numerics.fourier import to_complex
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Curve, Rotation
from fenics_crack.scene.words import faces_in_words
from fenics_crack.study.prepare import Study, reduction_of

N_MODES = 4
"""Modes that are computed."""
SMALL_MOTION = 0.1
"""Displacement over length, a rotation [rad], up to which displacements are small: the terms that
linear theory neglects are about its square, 1 %."""


@dataclass(frozen=True)
class KeyFigures:
    """Key figures of a scene's structure, not reduced.

    Attributes
    ----------
    size : (d,) [m]
        Width, height and, of a solid, thickness of the mesh.
    elements : int or None
        Along each face of the crack that has the fewest; None without a crack.
    omega_open, omega_tied : (at most 4,) [rad/s]
        Lowest natural frequencies, crack open and crack bonded; these are infinite where there
        are no more.
    omega_bilinear : (at most 4,) [rad/s]
        Resonances of a crack that opens for one half of a motion and closes for the other, by the
        open modes.
    damping : (at most 4,)
        Ratios of critical damping of the open modes.
    stiffenings : (at most 4,)
        S = d(w^2) / d(W^2) of the open modes under rotation; 0 without.
    own_stiffness : (n_pairs,) [N/m]
        1 / (B^T K^-1 B)_jj: of the crack faces themselves, pair by pair.
    stiffness_ratio : (n_pairs,) or None
        Contact stiffness over the own stiffness; None without a law, or without a stiffness.
    mean_opening, static_motion : float [m]
        Largest opening of an open crack under the mean load, and the largest motion of their gaps
        under the load's amplitude, both static.
    displacement, gap_motion : float [m]
        Largest amplitudes of what is watched, and of the gaps, with an open crack at the
        frequencies that are requested.
    rotation : float [rad]
        Largest amplitude over distance from the clamp, of what is watched.
    closed : int
        Pairs that are closed under the mean load and the preload alone.
    breathes : bool
        True if a pair that is then open closes, or one that is closed opens, at these frequencies.
    modes_below : int
        Natural frequencies below that of the highest harmonic.
    modes_kept : int
        After the reduction.
    """

    size: tuple[float, ...]
    elements: int | None
    omega_open: np.ndarray
    omega_tied: np.ndarray
    omega_bilinear: np.ndarray
    damping: np.ndarray
    stiffenings: np.ndarray
    own_stiffness: np.ndarray
    stiffness_ratio: np.ndarray | None
    mean_opening: float
    static_motion: float
    displacement: float
    rotation: float
    gap_motion: float
    closed: int
    breathes: bool
    modes_below: int
    modes_kept: int

    @property
    def omega_breathing(self) -> float:
        """First resonance of a breathing crack [rad/s]."""
        return float(self.omega_bilinear[0])

    @property
    def stiffening(self) -> float:
        """S of the first open mode."""
        return float(self.stiffenings[0])

    def meeting_speed(self, order: float, speed: float, omega: float | None = None) -> float:
        """Rotor speed W [rad/s] at which an engine order n meets a natural frequency w of the first
        mode, by default the breathing one,

            (n W)^2 = w^2 + S (W^2 - W_0^2);

        nan where it never does. Exact where w^2 is linear in W^2 with the slope of an open crack.

        Parameters
        ----------
        order : float
            n.
        speed : float
            W_0, of the structure [rad/s].
        omega : float, optional
            w at W_0 [rad/s].
        """
        square = (
            self.omega_breathing if omega is None else omega
        ) ** 2 - self.stiffening * speed**2
        slope = order**2 - self.stiffening
        return math.sqrt(square / slope) if square > 0.0 and slope > 0.0 else math.nan


def find_key_figures(study: Study) -> KeyFigures:
    """Compute the figures of a study; of a reduced one in its own coordinates, which hold static
    responses exactly (collective)."""
    scene, whole, law = study.scene, in_few_coordinates(study.structure), study.contact
    known = whole.known_modes(tied=False)
    count = min(N_MODES, whole.n_dofs if known is None else len(known[0]))
    with Factor(whole.stiffness, definite=True) as factor:
        modes = modes_by(factor, whole, count) if known is None else solve_modes(whole, count)
        static = _static(factor, modes, whole.force)
        lips = whole.apply_bt(_static(factor, modes, whole.gap.T.toarray()))
    ratios = damping_ratios(whole, modes.omega)
    tied = tied_modes(whole, count) if whole.n_pairs else modes
    breathing = BilinearFrequencies(modes.omega, tied.omega[partners(modes, tied)])
    gaps, psi = whole.apply_bt(static), whole.apply_bt(modes.shapes.T)
    loads = whole.sum_over_ranks(whole.force @ modes.shapes)
    amplitudes = [to_complex(rows)[1:] for rows in (static, gaps, loads)]  # of each harmonic
    resting = gaps[0] - whole.clearance  # of an open crack
    pressed = solve_complementarity(lips, resting) if whole.n_pairs else np.zeros(0)
    closed = pressed > 0.0
    watched = [one.dof for one in study.watched]
    lengths = from_clamp(whole.whole, watched)
    largest, turned, moved, breathes = 0.0, 0.0, 0.0, False
    for omega in _omegas(scene, np.concatenate([modes.omega, tied.omega])):
        seen, gap, apart, push = np.zeros((4, 1))  # at most: amplitudes of all harmonics
        for k, (still, still_gap, pull) in enumerate(zip(*amplitudes, strict=True), 1):
            change = _dynamic_part(modes.omega, ratios, k * omega)
            load = change * pull
            motion = still + load @ modes.shapes.T
            parts = whole.values_at(np.stack([motion.real, motion.imag]), watched)
            seen = seen + np.hypot(*parts)
            if whole.n_pairs:
                of_gap = still_gap + load @ psi
                compliance = lips + (psi.T * change) @ psi
                force = np.zeros(whole.n_pairs, dtype=complex)
                force[closed] = np.linalg.lstsq(
                    compliance[np.ix_(closed, closed)], of_gap[closed], rcond=None
                )[0]
                gap, push = gap + np.abs(of_gap), push + np.abs(force)
                apart = apart + np.abs(of_gap - compliance @ force)
        largest = max(largest, float(seen.max(initial=0.0)))
        turned = max(turned, float((seen / lengths).max(initial=0.0)))
        if whole.n_pairs:
            moved = max(moved, float(gap.max()))
            opened = resting - lips @ pressed + apart >= 0.0
            breathes = breathes or bool(np.any(np.where(closed, pressed <= push, opened)))
    own = 1.0 / np.maximum(np.diagonal(lips), 1e-300)
    stiffness = None if law is None or not np.all(np.isfinite(law.stiffness)) else law.stiffness
    kept = reduction_of(scene, whole)
    crack = whole.n_pairs > 0
    return KeyFigures(
        size=extents(whole.whole),
        elements=_elements(scene, whole),
        omega_open=modes.omega,
        omega_tied=tied.omega,
        omega_bilinear=breathing.omega_bilinear,
        damping=ratios,
        stiffenings=np.array([_stiffening(whole, shape) for shape in modes.shapes.T]),
        own_stiffness=own,
        stiffness_ratio=None if stiffness is None else stiffness / own,
        mean_opening=float(np.max(-resting, initial=0.0)) + 0.0,
        static_motion=float(np.abs(amplitudes[1]).sum(axis=0).max(initial=0.0)),
        displacement=largest,
        rotation=turned,
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
    rotation, shapes = whole.rotation, shape[:, None]
    if isinstance(whole, WheelStructure):
        rotation, shapes = whole.wheel.rotation, whole.of_sectors(shape)
    if rotation is None:
        return 0.0
    second, third = rotation.displaced
    parts = (rotation.stiffness, 1.0), (second, 1.0), (third, 2.0 * rotation.speed**2)
    slope = sum(factor * times(matrix, shapes) for matrix, factor in parts)
    return float(whole.sum_over_ranks((shapes * slope).sum()))


def _elements(scene: Scene, whole: Structure) -> int | None:
    """Elements along the crack that has the fewest: its pairs by the order of the displacement,
    rounded up, for tips are no pairs."""
    if not whole.n_pairs:
        return None
    cracks = whole.pairs.cracks
    fewest = whole.n_pairs if cracks is None else int(np.bincount(cracks).min())
    return math.ceil(fewest / (1 if scene.mesh is None else scene.mesh.order))


def extents(whole: Structure) -> tuple[float, ...]:
    """Extents of the mesh of a whole structure [m] (collective)."""
    if whole.nodes is None:
        return np.nan, np.nan
    return tuple(np.ptp(gather_rows(whole.comm, whole.nodes.points), axis=0).tolist())


def from_clamp(whole: Structure, dofs: Sequence[int]) -> np.ndarray:
    """Distance of the nodes of some dofs from the clamp, at most the mesh's longest side [m]; inf
    without nodes (collective)."""
    if whole.nodes is None:
        return np.full(len(dofs), np.inf)
    points, numbers = (gather_rows(whole.comm, a) for a in (whole.nodes.points, whole.nodes.dofs))
    clamp, side = points[np.all(numbers < 0, axis=1)], np.ptp(points, axis=0).max()
    away = [clamp[:, None] - points[np.any(numbers == dof, axis=1)] for dof in dofs]
    return np.array([np.linalg.norm(vectors, axis=2).min(initial=side) for vectors in away])


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


# --- the frequencies that a scene requests --------------------------------------------------------


def _omegas(scene: Scene, natural: np.ndarray) -> list[float]:
    """Return the frequencies to compute at: ends of the requested ranges, resonances between."""
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


# --- resonances and curves ------------------------------------------------------------------------

CURVE_UNITS = {"omega": (1.0, "rad/s"), "frequency": (TURN, "Hz"), "speed": (1.0, "rad/s"),
               "rpm": (RPM, "rpm")}  # fmt: skip
"""Factor to [rad/s] of a curve's parameter, and its unit."""


def proposed_curve(scene: Scene, figures: KeyFigures) -> Curve | None:
    """Return a curve through the first resonance of the breathing crack, without a table [curve]
    through the one nearest to the load's frequency; None where the scene's holds the first, or
    follows another parameter, or nothing is damped.

    From below the resonance of the open crack to above that of the bonded one: a clearance, a mean
    load or a rotor moves it between them. Ends are rounded outwards to three digits.
    """
    load, curve = scene.excitation, scene.curve
    parameter = "rpm" if scene.in_rpm else "speed"
    if load.order is None or scene.disk is not None:
        parameter = "frequency" if scene.in_hertz else "omega"
    if curve is not None:
        parameter = curve.parameter
        held = _holds_resonance(scene, figures, *curve.followed, of_first=True)
        if parameter not in CURVE_UNITS or held:
            return None
    else:  # of the modes from the nearest one on
        mode = int(np.argmin(np.abs(figures.omega_bilinear - load.omega)))
        firsts = "omega_open", "omega_bilinear", "damping", "stiffenings"
        figures = replace(figures, **{name: getattr(figures, name)[mode:] for name in firsts})
    opened, breathing = float(figures.omega_open[0]), figures.omega_breathing
    # Three half-power bandwidths from it the response is a sixth of the peak.
    beyond = 1.0 + 3.0 * 2.0 * float(figures.damping[0])
    if not (opened > 0.0 and breathing < 2.0 * opened and beyond > 1.0):
        return None
    bonded = 1.0 / (2.0 / breathing - 1.0 / opened)  # of the same mode
    meets, unit = _meeting(scene, figures, parameter), CURVE_UNITS[parameter][0]
    start, stop = (meets(omega, 1.0) / unit for omega in (opened / beyond, bonded * beyond))
    if not 0.0 < start < stop < math.inf:
        return None
    return Curve(_rounded(start, math.floor), _rounded(stop, math.ceil), parameter)


def _rounded(value: float, towards: Callable[[float], int]) -> float:
    """To three digits."""
    digits = 10.0 ** (2 - math.floor(math.log10(value)))
    return towards(value * digits) / digits


def _meeting(scene: Scene, figures: KeyFigures, parameter: str) -> Callable[[float, float], float]:
    """Parameter of a curve [rad/s] at which a harmonic of the load meets a natural frequency."""
    order = scene.excitation.order
    if parameter in ("speed", "rpm") and order is not None:
        return lambda omega, harmonic: figures.meeting_speed(harmonic * order, scene.speed, omega)
    return lambda omega, harmonic: omega / harmonic


def _holds_resonance(
    scene: Scene,
    figures: KeyFigures,
    parameter: str,
    start: float,
    stop: float,
    *,
    of_first: bool = False,
) -> bool:
    """True if a range of load frequencies, or rotor speeds [rad/s], may hold a resonance: that of
    the first mode with the load itself, or of any, also of a harmonic, or of one of half the
    frequency. Modes are between open and bonded crack, but the
    first at its breathing frequency where all forces and gaps are proportional to the load."""
    low, high = sorted((start, stop))
    meets = _meeting(scene, figures, parameter)
    breathing = figures.omega_breathing, figures.omega_breathing
    known = is_proportional(scene) and figures.closed == 0 and figures.mean_opening == 0.0
    for mode, ends in enumerate(zip(figures.omega_open, figures.omega_tied, strict=False)):
        for order in (1.0,) if of_first else (0.5, 1.0, 2.0, 3.0):
            between = breathing if known and mode == 0 and order == 1.0 else ends
            at_open, at_bonded = (meets(float(omega), order) for omega in between)
            if low <= at_bonded and high >= at_open:
                return True
        if of_first:
            return False
    return high >= meets(float(figures.omega_tied[-1]), 1.0)


# --- remarks --------------------------------------------------------------------------------------

Remarks = Iterator["Remark"]

LARGEST_SIDE = 20.0
"""Maximum plausible side of a plate [m]."""
FASTEST = 1000.0
"""Maximum plausible speed of a blade tip [m/s]; the longest blades have 700."""
TOO_FAST = "the blade tip moves at {:.3g} m/s, where the fastest have 700"


class Usual(NamedTuple):
    """Plausible range of a key; what is usual, in words; and the units in which its values are
    mistyped, by their factors to that of the key."""

    low: float
    high: float
    words: str
    units: Mapping[str, float]


MM = {"mm": 1e-3}
DAMPING = 0.0, 0.05, "of critical damping, metals have 0.0001 to 0.01", {"%": 1e-2}
USUAL = {
    "material.young": Usual(
        1e7, 1.5e12, "in Pa, steel has 2.1e11, and most solids from 1e7 to 1.5e12",
        {"GPa": 1e9, "MPa": 1e6},
    ),
    "material.density": Usual(
        50.0, 25000.0, "in kg/m^3, steel has 7850, and most solids from 50 to 25000",
        {"g/cm^3": 1e3, "t/mm^3": 1e12, "kg/mm^3": 1e9},
    ),
    "material.poisson": Usual(0.0, 0.49, "most solids have 0 to 0.49, steel 0.3", {}),
    "rotation.hub_radius": Usual(0.0, LARGEST_SIDE, "larger than any rotor", MM),
    "tip_timing.tip_radius": Usual(0.0, LARGEST_SIDE, "larger than any rotor", MM),
    "damping.ratio": Usual(*DAMPING),
    "damping.ratios": Usual(*DAMPING),
    "growth.rate": Usual(
        1e-20, 1e-9, "in m in a cycle at 1 MPa m^0.5, steels have 5e-12 to 1.4e-10",
        {"mm in a cycle": 1e-3},
    ),
}  # fmt: skip
"""Plausible ranges, by the keys: Young's modulus from rubber to diamond, density from foam to
tungsten and osmium, Paris' C of metals, smaller for larger exponents."""


@dataclass(frozen=True)
class Remark:
    """Something unusual: ``key = value: what is usual``."""

    key: str
    value: object
    text: str

    def __str__(self) -> str:
        value = f"{self.value:g}" if isinstance(self.value, float) else str(self.value)
        return f"{self.key} = {value}: {self.text}"


def remarks_on_scene(scene: Scene) -> list[Remark]:
    """Return the remarks on the scene alone, without any computation."""
    rules = (
        (_usual, _probes)
        if scene.structure
        else (_usual, _plate, _faces, _rotor, _wave, _load, _probes)
    )
    return [remark for rule in rules for remark in rule(scene)]


def remarks_on_structure(scene: Scene, structure: Structure) -> list[Remark]:
    """Return the remarks on the scene's structure, before it is reduced (collective)."""
    rules = _between_nodes, _outermost, _hub, _coriolis, _bouncing
    return [remark for rule in rules for remark in rule(scene, structure)]


def remarks_on(scene: Scene, figures: KeyFigures) -> list[Remark]:
    """Return the remarks on the scene and its key figures."""
    rules = (_frequency, _curve, _response, _lips, _contact, _closing, _rayleigh, _modes)
    of_matrices = (_frequency, _curve, _contact, _modes)
    chosen = rules if scene.structure is None else of_matrices
    own = [*remarks_on_scene(scene), *_size(scene, figures)]
    firsts = "material.", "geometry.", "rotation.", "mesh.file", "structure.model"
    if any(remark.key.startswith(firsts) for remark in own):
        return own  # all else may follow from these
    keys = {remark.key for remark in own}
    found = [remark for rule in chosen for remark in rule(scene, figures)]
    return own + [remark for remark in found if remark.key not in keys]


# --- of the scene alone ---------------------------------------------------------------------------


def _usual(scene: Scene) -> Remarks:
    """Values that are not plausible, by :data:`USUAL`."""
    for key, usual in USUAL.items():
        table, _, name = key.partition(".")
        given = getattr(getattr(scene, table), name, None)
        if given is not None:
            yield from _unless_usual(key, float(np.max(given)), usual)


def _unless_usual(key: str, value: float, usual: Usual) -> Remarks:
    """A remark on a value that is not a usual one; and the first unit in which it would be."""
    low, high, text, units = usual
    if low <= value <= high:
        return
    for unit, factor in units.items():
        if low <= factor * value <= high:
            text += f"; in {unit}? then {factor * value:g}"
            break
    yield Remark(key, value, text)


def _plate(scene: Scene) -> Remarks:
    geometry, kind = scene.geometry, scene.geometry.kind
    sides = {"width": geometry.width, "height": geometry.height}
    given = [(side, name) for name, side in sides.items() if side is not None]
    for side, name in sorted(given)[-1:]:
        usual = Usual(0.0, LARGEST_SIDE, f"a {kind} of {side:g} m", MM)
        yield from _unless_usual(f"geometry.{name}", side, usual)
    shortest = min((side for side, _ in given), default=np.inf)
    thickness = geometry.thickness
    customary = thickness == 1.0 and kind == "plate"  # in plane problems
    if not (thickness is None or customary):
        most, text = shortest, f"thicker than the {kind} is wide or high"
        if scene.disk is not None and kind == "plate":  # the width is that of a blade alone
            most, text = scene.disk.outer_radius or np.inf, "thicker than the disk's outer radius"
        usual = Usual(0.0, most, text, MM)
        yield from _unless_usual("geometry.thickness", thickness, usual)
    for name, crack in scene.all_cracks.items():
        for key, along in (("length", "width"), ("depth", "thickness")):
            own, whole = getattr(crack, key), getattr(geometry, along)
            share = (own or np.nan) / (whole or np.nan)
            if share < 0.01 or share > 0.9:
                text = f"{share:.3g} of the {kind}'s {along}; 0.01 to 0.9 are usual"
                yield Remark(f"{name}.{key}", own, text)
    size = scene.mesh.size
    if size is not None:
        text = f"longer than half the {kind}'s shorter side, {shortest:g} m"
        usual = Usual(0.0, shortest / 2.0, text, MM if size > shortest else {})
        yield from _unless_usual("mesh.size", size, usual)


def _faces(scene: Scene) -> Remarks:
    """Gaps that no small motion closes, and contact of nothing."""
    cracks, contact, geometry = scene.all_cracks, scene.contact, scene.geometry
    if contact is not None and not cracks and scene.mesh.layout != "file":
        text = "there is no [crack], so nothing touches and the response is linear"
        yield Remark("contact.law", contact.law, text)
    sides = [side for side in (geometry.width, geometry.height) if side is not None]
    for name, crack in cracks.items():
        largest = SMALL_MOTION * min(sides, default=np.inf)
        text = f"more than {SMALL_MOTION:g} of the shorter side, beyond small displacements"
        usual = Usual(-largest, largest, text, MM)
        yield from _unless_usual(f"{name}.clearance", crack.clearance, usual)


def _rotor(scene: Scene) -> Remarks:
    table = scene.rotation
    if table is None or table.hub_radius is None:
        return
    hub = table.hub_radius
    if hub <= LARGEST_SIDE and scene.geometry.height is not None:
        yield from _tip_speed(scene, table, hub + scene.geometry.height)


def _tip_speed(scene: Scene, table: Rotation, radius: float) -> Remarks:
    """Yield remarks on the speed ``radius`` away from a rotor's axis, also along a run-up."""
    given = [(*_speed_given(table), table.speed, "rotation.rpm")]
    if scene.curve is not None and scene.curve.followed[0] == "speed":
        ends = zip(("curve.start", "curve.stop"), scene.curve.followed[1:], strict=True)
        key, speed = max(ends, key=lambda end: end[1])
        value = speed / RPM if scene.curve.parameter == "rpm" else speed
        given.append((key, value, speed, "curve.parameter = 'rpm'"))
    for key, value, speed, instead in given:
        if speed * radius > FASTEST:
            text = TOO_FAST.format(speed * radius)
            if value == speed and RPM * speed * radius <= FASTEST:
                text += f"; in revolutions per minute? then use {instead}"
            yield Remark(key, value, text)


def _speed_given(table: Rotation) -> tuple[str, float]:
    """A rotor's speed by the key by which it is given, and its value."""
    return ("rotation.speed", table.speed) if table.rpm is None else ("rotation.rpm", table.rpm)


def _probes(scene: Scene) -> Remarks:
    table = scene.tip_timing
    if table is not None and len(table.probes) > 1 and table.probes[-1] < TURN:
        text = f"all of them within {np.ptp(table.probes):.3g} degrees; in rad?"
        yield Remark("tip_timing.probes", list(table.probes), text)


def _wave(scene: Scene) -> Remarks:
    """What the harmonics of the load's table leave out of it."""
    load = scene.excitation
    if load.wave is not None:
        missing = percent(of_wave(load, scene.dimension)[1])
        text = f"{load.wave_harmonics} harmonics leave out {missing} of what "
        yield Remark("excitation.wave", load.wave, f"{text}changes in it (root mean square)")


def _load(scene: Scene) -> Remarks:
    load = scene.excitation
    if scene.has_other_loads:
        return
    if not load.force_given:
        text = "no force at all: excitation.force_sin, force_cos and force_mean are zero"
        yield Remark("excitation.force_sin", list(load.force_sin), text)


def is_proportional(scene: Scene) -> bool:
    """Return True if the response is proportional to the load: no clearance, smoothing, rotation.

    Where forces and gaps are multiplied by a positive number, the equations of crack faces that
    touch or not, at g = 0, are multiplied by it as a whole. The centrifugal load stays what it is.
    """
    if scene.speed > 0.0:
        return False
    rounded = scene.contact is not None and not scene.contact.is_unilateral
    if scene.structure is not None:
        return not rounded and scene.structure.clearance == 0.0
    return not rounded and all(c.clearance == 0.0 for c in scene.all_cracks.values())


# --- of the structure ---------------------------------------------------------------------------


def _between_nodes(scene: Scene, structure: Structure) -> Remarks:
    """A load of a model from elsewhere that acts at no node."""
    point = scene.excitation.point
    if scene.structure is not None and structure.nodes is not None and point is not None:
        points = gather_rows(structure.comm, structure.nodes.points)
        distance = np.linalg.norm(points - point, axis=1)
        nearest = int(np.argmin(distance))
        place = place_in_words(points[nearest])
        if distance[nearest] > SAME * np.ptp(points, axis=0).max():
            text = f"no node is there: the force acts on the nearest one, at {place}"
            yield Remark("excitation.point", list(point), text)


def _outermost(scene: Scene, structure: Structure) -> Remarks:
    """The speed of the tip, where the scene does not say how far from the axis it is."""
    table, nodes = scene.rotation, structure.nodes
    if table is None or nodes is None:
        return
    if table.hub_radius is not None and scene.geometry.height is not None:
        return
    point, axis = (vector[: nodes.points.shape[1]] for vector in scene.axis)
    away = gather_rows(structure.comm, nodes.points) - point
    across = away - np.outer(away @ axis, axis)
    yield from _tip_speed(scene, table, float(np.linalg.norm(across, axis=1).max()))


def _hub(scene: Scene, structure: Structure) -> Remarks:
    """A mesh file whose clamp is not where the radius of the hub is counted from."""
    table, nodes = scene.rotation, structure.nodes
    if table is None or table.hub_radius is None or scene.mesh.layout != "file" or nodes is None:
        return
    points, dofs = (gather_rows(structure.comm, rows) for rows in (nodes.points, nodes.dofs))
    heights = points[np.all(dofs < 0, axis=1), 1]
    if np.abs(heights).max(initial=0.0) > 0.01 * np.ptp(points, axis=0).max():
        where = ranging(heights.round(12) + 0.0, ".4g")
        text = (
            f"the axis goes through (0, {-table.hub_radius:g}) m, as for a clamp at y = 0; that of "
            f"the mesh is at y = {where} m"
        )
        yield Remark("rotation.hub_radius", table.hub_radius, text)


def _coriolis(scene: Scene, structure: Structure) -> Remarks:
    """The force that is left out of solids, and of disks."""
    if scene.disk is not None and scene.rotation is not None and scene.speed > 0.0:
        text = "the Coriolis force is left out, which parts the two waves of a nodal diameter"
        yield Remark(*_speed_given(scene.rotation), text)
    elif scene.rotation is not None and structure.rotation is not None and scene.dimension == 3:
        count = min(N_MODES, structure.n_modes)
        turning = structure.rotation.speed * scene.rotation.place[1]
        if text := coriolis_in_words(coriolis_shifts(solve_modes(structure, count), turning)):
            yield Remark(*_speed_given(scene.rotation), text)


def coriolis_in_words(shifts: np.ndarray) -> str:
    """Describe the effect of the Coriolis force, by relative changes of the lowest natural
    frequencies (m,); "" where it is small."""
    if np.abs(shifts).max() <= 0.01:  # the errors of usual meshes are as large
        return ""
    changes = ", ".join(f"{100.0 * shift:+.3g}" for shift in shifts)
    modes = "mode 1" if len(shifts) == 1 else f"modes 1 to {len(shifts)}"
    return f"the Coriolis force, which is left out, would move {modes} by about {changes} %"


def _bouncing(scene: Scene, structure: Structure) -> Remarks:
    """Rigid contact of pairs that keep their mass."""
    table = reduction_of(scene, structure)
    massless = table is not None and table.method == "massless"
    if scene.contact is None or scene.contact.law != "unilateral" or massless:
        return
    if structure.n_pairs:
        text = (
            "rigid contact of pairs that keep their mass: solve gives no verdict on stability, and "
            "curve needs 'penalty' or 'smoothed', or reduction.method = 'massless'"
        )
        yield Remark("contact.law", "unilateral", text)


# --- of the key figures ---------------------------------------------------------------------------


def _size(scene: Scene, figures: KeyFigures) -> Remarks:
    if scene.structure is not None:
        key, file = "structure.model", scene.structure.model
    else:
        key, file = "mesh.file", scene.mesh.file
    if file is not None and max(figures.size) > LARGEST_SIDE:
        sides = f"{min(figures.size):.3g} m x {max(figures.size):.3g} m"
        yield Remark(key, file, f"a structure of {sides}; is the mesh in mm?")


def _frequency(scene: Scene, figures: KeyFigures) -> Remarks:
    load, first = scene.excitation, float(figures.omega_open[0])
    natural = np.concatenate([figures.omega_open, figures.omega_tied])
    if first <= 0.0 or load.order is not None or _is_near(load.omega, natural):
        return
    in_hertz = load.frequency is not None
    key, value = ("frequency", load.frequency) if in_hertz else ("omega", load.omega)
    share = (
        f"{load.omega / first:.2g} times the first natural frequency, {first / TURN:.4g} Hz = "
        f"{first:.4g} rad/s"
    )
    firsts, text = natural[[0, len(figures.omega_open)]], ""
    if _is_near(TURN * load.omega, firsts) and not in_hertz:
        text = "is it in Hz? then use excitation.frequency"
    elif _is_near(load.omega / TURN, firsts) and in_hertz:
        text = "is it in rad/s? then use excitation.omega"
    if text:
        yield Remark(f"excitation.{key}", value, f"{share}; {text}")


def _is_near(omega: float, natural: np.ndarray) -> bool:
    return bool(np.any(np.abs(natural - omega) < 0.1 * natural))


def _curve(scene: Scene, figures: KeyFigures) -> Remarks:
    """A range without a resonance, and one that holds the first."""
    curve = scene.curve
    if curve is None or curve.parameter not in CURVE_UNITS:
        return
    if _holds_resonance(scene, figures, *curve.followed):
        return
    first, last = float(figures.omega_open[0]), float(figures.omega_tied[-1])
    proposed, unit = proposed_curve(scene, figures), CURVE_UNITS[curve.parameter][1]
    text = (
        f"no resonance from there to {curve.stop:g} {unit}: the first is near "
        f"{figures.omega_breathing / TURN:.4g} Hz = {figures.omega_breathing:.4g} rad/s"
    )
    if proposed is not None:
        text += f"; start = {proposed.start:g} and stop = {proposed.stop:g} hold it"
    if curve.followed[0] == "speed":
        yield Remark("curve.start", curve.start, text)
        return
    in_hertz, (low, high) = curve.parameter == "frequency", span_of(scene, "curve")
    factor = TURN if in_hertz else 1.0 / TURN  # how much too large or too small
    if low <= factor * last and high >= factor * first:
        text += f"; are they in {'rad/s' if in_hertz else 'Hz'}? then use curve.parameter = "
        text += "'omega'" if in_hertz else "'frequency'"
    yield Remark("curve.start", curve.start, text)


def _response(scene: Scene, figures: KeyFigures) -> Remarks:
    load = scene.excitation
    if scene.has_other_loads:
        return
    key = max(("force_sin", "force_cos"), key=lambda name: math.hypot(*getattr(load, name)))
    force, kind = list(getattr(load, key)), scene.geometry.kind
    if figures.rotation > SMALL_MOTION and figures.damping.min() > 0.0:
        text = (
            f"with an open crack it moves the {kind} by {figures.displacement:.2g} m, "
            f"{figures.rotation:.2g} rad about the clamp: beyond small displacements; in N?"
        )
        yield Remark(f"excitation.{key}", force, text)


def _lips(scene: Scene, figures: KeyFigures) -> Remarks:
    """A slit of half an element is no crack; grids choose their elements."""
    if figures.elements is None or scene.mesh.layout == "grid":
        return
    if scene.contact is not None and scene.contact.pairs == "mouth":
        return
    if figures.elements < 4:
        key = "lip_elements" if scene.mesh.layout == "graded" else "file"
        text = "elements longer than a quarter of the crack; 4 to 20 along each face are usual"
        yield Remark(f"mesh.{key}", getattr(scene.mesh, key), text)


def _contact(scene: Scene, figures: KeyFigures) -> Remarks:
    ratio, contact = figures.stiffness_ratio, scene.contact
    if contact is None or ratio is None:
        return
    key = "stiffness" if contact.stiffness is not None else "stiffness_per_area"
    value, faces = getattr(contact, key), faces_in_words(scene)
    if ratio.max() < 1.0:
        text = (
            f"at most {ratio.max():.2g} of the {faces}' static stiffness: they penetrate each "
            "other; 100 to 10000 times is usual, or contact.law = 'unilateral'"
        )
        yield Remark(f"contact.{key}", value, text)
    if ratio.min() > 1e6:
        text = (
            f"at least {ratio.min():.2g} times the {faces}' static stiffness: numerically rigid, "
            "and hard to solve; contact.law = 'unilateral' is rigid contact"
        )
        yield Remark(f"contact.{key}", value, text)
    if contact.sharpness is not None and contact.sharpness * figures.gap_motion < 10.0:
        text = (
            f"the law is rounded over {1.0 / contact.sharpness:.2g} m, and the {faces} move by "
            f"{figures.gap_motion:.2g} m: contact acts on open {faces}"
        )
        yield Remark("contact.sharpness", contact.sharpness, text)


def _closing(scene: Scene, figures: KeyFigures) -> Remarks:
    if scene.contact is None or figures.gap_motion == 0.0:
        return
    clearances = {f"{name}.clearance": c.clearance for name, c in scene.all_cracks.items()}
    key, value = max(clearances.items(), key=lambda item: abs(item[1]), default=("", 0.0))
    if value == 0.0:
        key, value = "excitation.force_mean", list(scene.excitation.force_mean)  # type: ignore[assignment]
        if scene.rotation is not None and scene.speed > 0.0 and not np.any(value):
            key, value = _speed_given(scene.rotation)
    motion = f"the load moves open crack faces by {figures.gap_motion:.2g} m"
    if not figures.breathes:
        what = "opens" if figures.closed else "closes"
        text = f"the crack never {what}: {motion} at most; the response is linear"
        yield Remark(key, value, text)


def _rayleigh(scene: Scene, figures: KeyFigures) -> Remarks:
    key = next((key for key in ("mass", "stiffness") if getattr(scene.damping, key)), "")
    ratio, usual = float(figures.damping[0]), USUAL["damping.ratio"]
    if key and ratio > usual.high:
        text = f"{ratio:.3g} {usual.words}, at the first natural frequency"
        yield Remark(f"damping.{key}", getattr(scene.damping, key), text)


def _modes(scene: Scene, figures: KeyFigures) -> Remarks:
    if figures.modes_below > figures.modes_kept:
        text = (
            f"harmonics up to H w reach {figures.modes_below} modes, and "
            f"{figures.modes_kept} are kept: raise {scene.modes_key}"
        )
        yield Remark("harmonic_balance.harmonics", scene.harmonic_balance.harmonics, text)
