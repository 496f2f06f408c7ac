"""What curves of an oscillator with a stiff stop say of stability, against exact orbits.

stiff : m = 1, c = 0.02, k = 1, f = 0.1 cos(w t), a stop of kc at zero clearance, from w = 2 down to
    0.32, judged by exact orbits.

The reference is the branch of exact orbits, followed by arc-length from w = 2 on, with its folds
and period doublings. A verdict is wrong if that of the nearest orbit of the branch at the same
frequency is another one. It is not counted where a bifurcation lies between that orbit's
neighbours, where it is farther than a quarter of the motion, nor where one of the other stability
is less than three times as far. A bifurcation has a counterpart if the branch has one of its kind
at the same frequency, to 1e-6.

    OMP_NUM_THREADS=1 python benchmarks/stiff_curves.py [--quick] [folder]
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.motion.orbit import eigenvalues
from fenics_crack.motion.shooting import FlowOrbits
from fenics_crack.numerics.newton import PathPoint, point_on_path
from fenics_crack.numerics.path import Crossing, Event, Fold, Path, PathOptions, Target

SPAN = 2.0, 0.32
NEAR, CLEARLY = 0.25, 3.0
KINDS = "fold", "period_doubling"
COLUMNS = (
    "kc", "H", "points", "wrong", "stable", "unstable", "undecided", "bifurcations",
    "exact", "ms a point", "judged",
)  # fmt: skip


@dataclass(frozen=True)
class Branch:
    """Exact orbits along their branch: frequencies (n,), states (n, 2), whether each is stable
    (n,), and the bifurcations by their kinds [rad/s]."""

    orbits: FlowOrbits
    omega: np.ndarray
    states: np.ndarray
    stable: np.ndarray
    special: dict[str, list[float]]

    def verdict(self, omega: float, state: np.ndarray) -> str | None:
        """That of the nearest orbit at a frequency; None where it is not sure."""
        near: dict[str | None, float] = {}
        ends = (self.omega[:-1] - omega) * (self.omega[1:] - omega) <= 0.0
        for place in np.flatnonzero(ends):
            rise = self.omega[place + 1] - self.omega[place]
            share = (omega - self.omega[place]) / rise if rise else 0.0
            between = (1.0 - share) * self.states[place] + share * self.states[place + 1]
            first, last = self.stable[place : place + 2]
            kind = None if first != last else "stable" if first else "unstable"
            off = float(np.linalg.norm(between - state) / np.linalg.norm(state))
            near[kind] = min(near.get(kind, np.inf), off)
        if not near:
            return None
        best = min(near, key=lambda kind: near[kind])
        others = [off for kind, off in near.items() if kind != best]
        sure = near[best] <= min([NEAR, *(off / CLEARLY for off in others)])
        return best if sure else None


def main() -> None:
    """Run the parts asked for."""
    common.run(__doc__, {"stiff": stiff})


def stiff(arguments: common.Arguments) -> None:
    """The cases."""
    cases = [(100.0, 10), (1000.0, 40)]
    if not arguments.quick:
        cases = [(kc, count) for kc in (10.0, 100.0, 1000.0) for count in (10, 20, 40)]
    rows = [case(*one) for one in cases]
    common.save_table(arguments.folder / "stiff_curves.csv", "Stiff stops", COLUMNS, rows)


def case(kc: float, harmonics: int, span: tuple[float, float] = SPAN) -> tuple[object, ...]:
    """One curve, held against the branch."""
    structure, law = common.oscillator(), fc.UnilateralPenalty(kc)
    started = time.process_time()
    fc.continue_frequency(structure, *span, law, harmonics=harmonics)
    plain = time.process_time() - started
    curve = fc.continue_frequency(structure, *span, law, harmonics=harmonics, stability=True)
    judged = time.process_time() - started - plain
    branch = exact_branch(curve)
    motions = [branch.orbits.unknown_of(*motion) for motion in curve.motions()]
    known = [branch.verdict(*one) for one in zip(curve.omega.tolist(), motions, strict=True)]
    pairs = zip(curve.verdicts.tolist(), known, strict=True)
    wrong = sum({one, other} == {"stable", "unstable"} for one, other in pairs)
    counts = [int(np.sum(curve.verdicts == one)) for one in ("stable", "unstable", "undecided")]
    return (
        kc, harmonics, len(curve), wrong, *counts,
        len(curve.bifurcations), sum(map(len, branch.special.values())),
        1e3 * plain / len(curve), 1e3 * judged / len(curve),
    )  # fmt: skip


def exact_branch(curve: fc.ResponseCurve) -> Branch:
    """The branch of exact orbits that begins at a curve's first point, to its last frequency."""
    first = curve.solution(0).assessment.orbit
    assert first is not None
    orbits = FlowOrbits(first.flow, first.omega, first.state, first.subharmonic)
    start = point_on_path(orbits, orbits.start, 1.0)
    end = float(curve.omega[-1]) / orbits.omega
    if end < 1.0:
        start = replace(start, tangent=start.tangent.reversed())
    options = PathOptions(
        1e-3, 0.02, 1e-11, 5000, rtol=1e-10, min_cosine=0.9, rounding=1e-12, span=(0.0, 2.0)
    )

    def doubling(point: PathPoint) -> float:
        monodromy = orbits.linearise(point.unknown, point.parameter).monodromy
        return float(np.linalg.det(np.eye(len(monodromy)) + monodromy))

    tests: dict[str, Event] = {"fold": Fold(), "period_doubling": Crossing(doubling)}
    special: dict[str, list[float]] = {kind: [] for kind in tests}
    points: list[PathPoint] = []
    for stretch in Path(orbits, start, options, [*tests.values(), Target(end)]):
        points += stretch
        for event, at in stretch.met:
            for kind, test in tests.items():
                if event is test:
                    special[kind].append(at.parameter * orbits.omega)
    multipliers = [
        abs(eigenvalues(orbits.linearise(point.unknown, point.parameter).monodromy)[0])
        for point in points
    ]
    return Branch(
        orbits,
        orbits.omega * np.array([point.parameter for point in points]),
        np.array([point.unknown for point in points]),
        np.array(multipliers) < 1.0,
        special,
    )


if __name__ == "__main__":
    main()
