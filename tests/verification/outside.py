"""Cases that others have published: what the program predicts for them.

Each case returns its quantities by name. The prediction and the half-width of its interval stand on
a page of ``docs/verification/outside``, which was committed before the published number was looked
up.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import gmsh
import numpy as np
from helpers import gmsh_model

import fenics_crack as fc

PAGES = Path(__file__).resolve().parents[2] / "docs/verification/outside"
CASES: dict[str, Callable[[], dict[str, float]]] = {}
"""The cases by the names of their pages; the first word names the source."""
PLATE = """
geometry = { width = 10.0, height = 30.0, thickness = 1.0 }
crack = { height = 15.0, length = 5.0, edge = "left" }
material = { young = 2.05e11, poisson = 0.0, density = 7800.0 }
damping = { ratio = 0.01 }
excitation = { point = [10.0, 30.0], force_cos = [1.0, 0.0], omega = 10.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.25, lip_elements = 20 }
"""
CANTILEVER = """
geometry = { width = 0.02, height = 0.3, thickness = 0.02 }
crack = { height = 0.08, length = 0.002, edge = "left" }
material = { young = 2.07e11, poisson = 0.3, density = 7800.0 }
damping = { ratio = 0.01 }
excitation = { point = [0.02, 0.3], force_cos = [1.0, 0.0], omega = 100.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.004, lip_elements = 8 }
"""
ROD = """
geometry = { kind = "solid", file = "rod.step", faces = { clamp = [[0.0, 0.0, 0.0]] } }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = [0.0, 0.3, 0.0], force_sin = [1.0, 0.0, 1.0], frequency = 1.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.006, lip_elements = 4, error = false }

[crack]
point = [-0.005, 0.06, 0.0]
normal = [0.0, 1.0, 0.0]
direction = [1.0, 0.0, 0.0]
front = "through"
"""


@dataclass(frozen=True)
class Row:
    """A quantity of a page: prediction, half-width of its interval, and the published number."""

    quantity: str
    prediction: float
    half_width: float
    published: float | None

    @property
    def is_inside(self) -> bool:
        """Whether the published number lies in the interval."""
        assert self.published is not None
        return abs(self.published - self.prediction) <= self.half_width


def rows_of(page: Path) -> Iterator[Row]:
    """Yield the rows of a page's table."""
    for line in page.read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) >= 4 and not cells[1].strip("-").startswith("pred"):
            if cells[1].strip("-"):
                published_number = float(cells[3]) if cells[3] != "not yet" else None
                yield Row(cells[0], float(cells[1]), float(cells[2]), published_number)


def outside(case: Callable[[], dict[str, float]]) -> Callable[[], dict[str, float]]:
    """Enter a case."""
    CASES[case.__name__] = case
    return case


def amplitudes(solution: fc.PeriodicSolution) -> np.ndarray:
    """Return the amplitude of the first harmonic of each dof."""
    dofs = range(solution.structure.n_dofs)
    return np.asarray(np.hypot(*solution.coefficients_at(dofs)[1:3]))


def history(
    structure: fc.Structure, stiffness: float, duration: float, steps: int, **options: object
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, displacements along the gap, and the state at the end of an exact flow."""
    flown = fc.integrate_events(
        structure, 2.0 * np.pi / duration, fc.UnilateralPenalty(stiffness),
        periods=1, steps_per_period=steps, **options,
    )  # fmt: skip
    return flown.time, flown.gap[:, 0], flown.final_state


@outside
def aster_sdls120() -> dict[str, float]:
    """In-plane frequencies of a plate with an open crack to its middle."""
    frequencies = fc.solve_modes(fc.build_structure(fc.Scene.from_text(PLATE)), 8).omega
    return {f"frequency {k} [Hz]": omega / (2.0 * np.pi) for k, omega in enumerate(frequencies, 1)}


@outside
def aster_sdnd102() -> dict[str, float]:
    """A mass on a shaken base that meets a stop fixed in space: its place over time."""
    mass, stiffness, omega = 25.0, 98696.0, 20.0 * np.pi
    damping = 0.14 * np.sqrt(stiffness * mass)
    structure = fc.Structure.from_matrices(
        [[mass]], [[stiffness]], gap=[1.0], clearance=5e-4, force_sin=[-stiffness / omega**2],
        force_cos=[-damping / omega], damping=[[damping]],
    )  # fmt: skip
    law, start = fc.UnilateralPenalty(5.76e7), (np.zeros(1), np.array([-1.0 / omega]))
    flown = fc.integrate_events(
        structure, omega, law, periods=11, steps_per_period=2000, initial=start
    )
    instants = (0.05, 0.156, 0.25, 0.4, 0.5, 0.8, 0.9, 1.0)
    return {
        f"x at {instant:g} s [m]": flown.gap[round(instant / flown.time[1]), 0] + 5e-4
        for instant in instants
    }


@outside
def aster_sdnd121() -> dict[str, float]:
    """A forced mass that meets a very stiff stop: begin and end of contacts."""
    structure = fc.Structure.from_matrices(
        [[156.0]], [[2e6]], gap=[1.0], clearance=1e-3, force_sin=[3000.0]
    )
    flown = fc.integrate_events(
        structure, 10.0 * np.pi, fc.UnilateralPenalty(1e10), periods=5, steps_per_period=100000
    )
    gap, time = flown.gap[:, 0], flown.time
    steps_before = np.flatnonzero((gap[:-1] > 0.0) != (gap[1:] > 0.0))
    instants = time[steps_before] + time[1] * gap[steps_before] / (
        gap[steps_before] - gap[steps_before + 1]
    )
    quantities = {
        f"contact {number // 2 + 1} {('begins', 'ends')[number % 2]} [s]": instant
        for number, instant in enumerate(instants[:32])
    }
    return quantities | {"contacts that begin within 1 s": len(instants[::2])}


def beam(
    nodes: np.ndarray, bending: float, mass: float, shear: float = np.inf, rotary: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return mass and stiffness of a Timoshenko beam, deflection and slope at each node."""
    matrices = np.zeros((2, 2 * len(nodes), 2 * len(nodes)))
    for i, h in enumerate(np.diff(nodes)):
        phi = 12.0 * bending / (shear * h * h)
        inertia = mass * h / 420.0 * np.array(
            [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
             [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]]
        ) + rotary / (30.0 * h) * np.array(
            [[36, 3 * h, -36, 3 * h], [3 * h, 4 * h * h, -3 * h, -h * h],
             [-36, -3 * h, 36, -3 * h], [3 * h, -h * h, -3 * h, 4 * h * h]]
        )  # fmt: skip
        stiffness = bending / (h**3 * (1.0 + phi)) * np.array(
            [[12, 6 * h, -12, 6 * h], [6 * h, (4 + phi) * h * h, -6 * h, (2 - phi) * h * h],
             [-12, -6 * h, 12, -6 * h], [6 * h, (2 - phi) * h * h, -6 * h, (4 + phi) * h * h]]
        )  # fmt: skip
        matrices[:, 2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += inertia, stiffness
    return matrices[0], matrices[1]


@outside
def aster_sdnl104() -> dict[str, float]:
    """A cantilever that a sudden load presses onto a stop."""
    radius, young, density = 0.1, 1e10, 1e6
    bending, line_mass = young * np.pi * radius**4 / 4.0, density * np.pi * radius**2
    mass, stiffness = (
        matrix[2:, 2:] for matrix in beam(np.linspace(0.0, 1.0, 11), bending, line_mass)
    )
    end = np.eye(len(mass))[-2]
    structure = fc.Structure.from_matrices(
        mass, stiffness, gap=-end, clearance=1e-4, force_mean=-1000.0 * end
    )
    time, gap, state = history(structure, 1e8, 0.16, 16000)
    place = -(gap + 1e-4)
    return {
        "speed of the end at .1566 s [m/s]": np.gradient(place, time)[15660],
        "kinetic energy at .16 s [J]": 0.5 * state[1] @ mass @ state[1],
        "place of the end at .1315 s [m]": place[13150],
    }


@outside
def aster_sdnl32() -> dict[str, float]:
    """A hinged beam that turns onto a stop under its tip."""
    side, young, density = 0.014, 6.7e10, 2400.0
    inertia, area = side**4 / 12.0, side**2
    nodes = 0.0783 * np.arange(11.0)
    nodes[6] = 0.462
    mass, stiffness = (
        matrix[1:, 1:]
        for matrix in beam(
            nodes, young * inertia, density * area, young / 2.0 * area * 5.0 / 6.0,
            density * inertia,
        )
    )  # fmt: skip
    speeds = (
        -0.29754, -0.59508, -0.89262, -1.19016, -1.4877, -1.7556, -2.08278, -2.38032, -2.67786,
        -2.96786,
    )  # fmt: skip
    start = np.full(21, -3.8)
    start[1::2] = speeds
    tip, quantities = np.eye(21)[-2], {}
    modes = fc.solve_modes(fc.Structure.from_matrices(mass, stiffness, gap=-tip), 10)
    shapes = np.array(modes.shapes)
    omega = np.where(modes.omega < 1.0, 0.0, modes.omega)
    for case, spring in (("A", 18000.0), ("B", 45000.0)):
        structure = fc.Structure.from_matrices(
            np.eye(10), np.diag(omega**2), gap=-(tip @ shapes), damping=np.diag(0.02 * omega)
        )
        _, gap, _ = history(
            structure, spring, 0.0125, 12500, initial=(np.zeros(10), shapes.T @ mass @ start)
        )
        quantities |= {
            f"{case}: tip at {instant} ms [m]": -gap[1000 * instant] for instant in range(1, 13)
        }
    return quantities


@outside
def ansys_vm320() -> dict[str, float]:
    """Peak of a mass with a dry-friction damper behind a spring, by one harmonic."""
    limit, stiffness = 246.048, 2.4e7
    structure = fc.Structure.from_matrices(
        np.diag([944.6, 1.0]), np.diag([stiffness, stiffness]), gap=[0.0, 1.0],
        tangential=[1.0, 0.0], force_cos=[limit / 2.0, 0.0], force_mean=[0.0, 2.0 * limit],
        damping=np.diag([7700.0, 1e3]),
    )  # fmt: skip
    law = fc.CoulombFriction(fc.UnilateralPenalty(stiffness), 1.0, stiffness)
    curve = fc.continue_frequency(structure, 100.0, 300.0, law, harmonics=1, longest_step=0.005)
    sizes = np.array([amplitudes(curve.solution(i))[0] for i in range(len(curve))])
    return {
        "frequency of the peak [rad/s]": curve.values[sizes.argmax()],
        "first harmonic at the peak [m]": sizes.max(),
    }


@outside
def ansys_vm81() -> dict[str, float]:
    """A mass that falls on an elastic stop, in inches and pounds."""
    mass, stiffness = 0.5, 1973.92
    structure = fc.Structure.from_matrices(
        [[mass]], [[0.0]], gap=[-1.0], clearance=1.0, force_mean=[-193.0]
    )
    time, gap, _ = history(structure, stiffness, 0.15, 150000)
    impact = int(np.flatnonzero(gap > 0.0)[0])
    speed = np.gradient(-gap, time)[impact]
    return {
        "time of impact [s]": time[impact], "speed at impact [in/s]": speed,
        "lowest place [in]": -1.0 - gap.max(), "time of the lowest place [s]": time[gap.argmax()],
        "kinetic energy at impact [lb in]": 0.5 * mass * speed**2,
    }  # fmt: skip


@outside
def ansys_vm156() -> dict[str, float]:
    """Period of a free mass on a spring whose stiffness grows in ten steps."""
    forces = np.array([0, 0.204, 0.432, 0.708, 1.056, 1.5, 2.064, 2.772, 3.648, 4.716, 6.0])
    slopes = np.diff(forces) / 0.1
    added_stiffness = np.repeat(np.diff(slopes), 2)
    structure = fc.Structure.from_matrices(
        [[2588e-6]], [[slopes[0]]], gap=[np.tile([1.0, -1.0], 9)],
        clearance=np.repeat(np.arange(1, 10) / 10.0, 2),
    )  # fmt: skip
    history = fc.integrate_events(
        structure, 2.0 * np.pi / 0.1, fc.UnilateralPenalty(added_stiffness), periods=1,
        steps_per_period=100000, initial=(np.ones(1), np.zeros(1)),
    )  # fmt: skip
    quarter = np.flatnonzero(history.gap[:, 0] < -0.1)[0]
    return {"period [s]": 4.0 * history.time[quarter]}


@outside
def measured_cantilever() -> dict[str, float]:
    """Frequency ratios of a square steel cantilever with an edge crack, open and breathing."""
    quantities = {}
    for place in (0.08, 0.14, 0.2):
        for depth in (0.002, 0.006):
            scene = fc.Scene.from_text(CANTILEVER).replace(
                {"crack.height": place, "crack.length": depth}
            )
            frequencies = fc.bilinear_frequencies(fc.build_structure(scene))
            for mode in (1, 2):
                ratio = frequencies.omega_open[mode - 1] / frequencies.omega_tied[mode - 1]
                quantities[f"f{mode} open, {1e3 * depth:g} mm at {1e3 * place:g} mm"] = ratio
            if place < 0.2:
                quantities[f"f1 breathing, {1e3 * depth:g} mm at {1e3 * place:g} mm"] = (
                    frequencies.omega_bilinear[0] / frequencies.omega_tied[0]
                )
    return quantities


@outside
def ross_rod() -> dict[str, float]:
    """First frequencies of a round cantilever with a crack with a straight front, over those
    without it, each against two models."""
    quantities = {}
    with TemporaryDirectory() as folder:
        with gmsh_model() as model:
            model.occ.addCylinder(0, 0, 0, 0, 300, 0, 10)
            model.occ.synchronize()
            gmsh.write(f"{folder}/rod.step")
        for depth in (0.1, 0.2, 0.3, 0.35, 0.45, 0.5):
            scene = fc.Scene.from_text(ROD, folder=Path(folder)).replace(
                {"crack.point": [0.02 * depth - 0.01, 0.06, 0.0]}
            )
            frequencies = fc.bilinear_frequencies(fc.build_structure(scene))
            ratios = frequencies.omega_open[:2] / frequencies.omega_tied[:2]
            quantities |= {
                f"{plane} plane, a/D = {depth:g}, {model_name}": ratio
                for plane, ratio in zip(("weak", "strong"), ratios, strict=True)
                for model_name in ("Flex", "Papadopoulos")
            }
    return quantities
