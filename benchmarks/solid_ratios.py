"""Second harmonics of solids with breathing cracks: by the mesh, and held against the judge's flow.

A steel plate of 30 x 90 x 6 mm, clamped at y = 0, is bent by a force across it at a corner of its
tip. At y = 30 mm it has half an ellipse from one of its broad faces, 16 mm long and 3 mm deep, or a
straight crack, 10 mm from one edge and 3 mm deep. Of the motion at the force: the second harmonic
over the first at w1 / 2, 0.9 w1 and w1, the bilinear frequency of each mesh, on meshes of more and
more elements from the front to the mouth; what the last three of them lead to,

    r_n = r + c / n^p;

and the modulus of the largest multiplier of each. With up to 100 pairs they are held against exact
orbits (:mod:`reference_flow`): the error that is stated of the gaps over their distance from that
orbit; and that which is stated of the reduction to 20 modes over the distance of that orbit from
the one with 40.

    OMP_NUM_THREADS=1 python benchmarks/solid_ratios.py [--quick] [folder]
"""

from __future__ import annotations

import common
import numpy as np
import scipy.optimize
from campaign import distance, estimate
from reference_flow import Orbit, ReferenceFlow

import fenics_crack as fc

SCENE = fc.Scene.from_text("""
geometry = { kind = "solid", width = 0.03, height = 0.09, thickness = 0.006 }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = [0.0, 0.09, 0.003], force_cos = [0.0, 0.0, 10.0], frequency = 560.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.008, lip_elements = 3, error = false }
""")
ELLIPSE = {"center": 0.015, "height": 0.03, "length": 0.016, "depth": 0.003, "front": "elliptical"}
CRACKS = {
    "ellipse": ELLIPSE,
    "part-through": {"edge": "left", "height": 0.03, "length": 0.01, "depth": 0.003},
}
MESHES = (3, 0.008), (4, 0.006), (6, 0.004)
"""Elements from the front to the mouth, and their length far away [m]."""
SHARES = 0.5, 0.9, 1.0
MODES, TOLERANCE = 20, 1e-3
JUDGED = 100
"""Pairs of which the judge finds those that are closed in some seconds."""
COLUMNS = (
    "crack", "elements", "dofs", "pairs", "w / w1", "w1 Hz", "ratio 2/1", "largest multiplier",
    "harmonics", "error %", "stated / true", "reduction %", "stated / true of it",
)  # fmt: skip


def main() -> None:
    """Run it."""
    common.run(__doc__, {"ratios": ratios})


def ratios(arguments: common.Arguments) -> None:
    """Each crack on each mesh."""
    rows, ends = [], []
    for name, keys in CRACKS.items():
        crack = {f"crack.{key}": value for key, value in keys.items()}
        for elements, size in MESHES[: 1 if arguments.quick else None]:
            mesh = {"mesh.lip_elements": elements, "mesh.size": size}
            whole = fc.build_structure(SCENE.replace(crack | mesh))
            first = fc.bilinear_frequencies(whole).omega_bilinear[0]
            reduced = fc.reduce_structure(whole, modes=MODES, method="massless")
            for share in SHARES:
                found = of_frequency(reduced, share * first)
                rows.append((name, elements, whole.n_dofs, whole.n_pairs, share,
                             first / (2.0 * np.pi), *found))  # fmt: skip
            common.save_table(
                arguments.folder / "solid_ratios.csv", "Second harmonics", COLUMNS, rows
            )
        for share in SHARES if not arguments.quick else ():
            own = [(row[1], row[6]) for row in rows if row[0] == name and row[4] == share]
            ends.append((name, share, own[-1][1], *limit(own[-3:])))
    if ends:
        title = "What they lead to"
        common.save_table(
            arguments.folder / "solid_ratios_limits.csv", title,
            ("crack", "w / w1", "finest", "limit", "order", "off %"), ends,
        )  # fmt: skip


def of_frequency(reduced: fc.ReducedStructure, omega: float) -> tuple[float, ...]:
    """What is asked for of the solution at a frequency."""
    law = fc.UnilateralConstraint()
    found = fc.solve_harmonic_balance(reduced, omega, law, tolerance=TOLERANCE)
    ratio = float(found.indicators().ratio_2_1)
    largest = float(np.abs(fc.floquet(reduced, found).multipliers[0]))
    return ratio, largest, found.harmonics, *against_orbits(found)


def against_orbits(found: fc.PeriodicSolution) -> tuple[float, ...]:
    """The error [%] and what is stated over it, of a solution and of its reduction."""
    structure, law = found.structure, fc.UnilateralConstraint()
    if structure.n_pairs > JUDGED:
        return (np.nan,) * 4
    more = fc.reduce_structure(structure.whole, modes=2 * MODES, method="massless")
    better = fc.solve_harmonic_balance(more, found.omega, law, harmonics=found.harmonics)
    orbit, other = orbit_of(found), orbit_of(better)
    true, size = distance(found, orbit), float(np.linalg.norm(other.gap + structure.clearance))
    of_modes = float(np.linalg.norm(other.gap - orbit.gap)) / size
    stated = estimate(found) / true, found.report.reduction / of_modes
    return 100.0 * true, stated[0], 100.0 * of_modes, stated[1]


def orbit_of(found: fc.PeriodicSolution) -> Orbit:
    """The exact orbit next to a solution."""
    flow = ReferenceFlow(found.structure, found.contact)
    return flow.orbit(flow.states_of(found, np.zeros(1))[0], found.omega, found.period)


def limit(points: list[tuple[int, float]]) -> tuple[float, float, float]:
    """Limit and order of three ratios by their numbers of elements, and how far off the last is
    [%]; nan where they do not converge in one direction."""
    (a, first), (b, second), (c, third) = points
    quotient = (third - second) / (second - first)

    def excess(order: float) -> float:
        return float((b**-order - c**-order) / (a**-order - b**-order) - quotient)

    if not 0.0 < quotient < 1.0 or excess(0.1) * excess(8.0) > 0.0:
        return np.nan, np.nan, np.nan
    order = float(scipy.optimize.brentq(excess, 0.1, 8.0))
    end = third + (third - second) / ((c / b) ** order - 1.0)
    return end, order, 100.0 * abs(third / end - 1.0)


if __name__ == "__main__":
    main()
