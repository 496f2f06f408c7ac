"""A campaign: random structures, and every answer held against the exact flow.

Each case is drawn from the seed and its own number alone, so that any of them can be repeated by
itself (``--first N --cases 1``). What is drawn: 1 to 12 masses in a chain or with random mode
shapes, or the paper's plate reduced to 6 to 12 modes; 1 to 4 pairs, to the ground or between
masses; clearances of either sign, or none; loads with phases, some with a mean; k times the static
compliance from 0.1 to 1e4; modal damping from 1e-3 to 5e-2; load frequencies at resonances, their
fractions and multiples, and elsewhere; H = 5 to 40. What is asked:

    solution    solve_harmonic_balance with H given, and floquet
    tolerance   the same with tolerance=1e-2 or 1e-3
    curve       continue_frequency(stability=True), up to 8 of its points, and its bifurcations
    branch      follow_branch from a period doubling of such a curve, up to 4 points
    backbone    follow_backbone of an undamped structure, up to 4 points

The reference is an orbit of the exact flow from one switching instant to the next (`ContactFlow`,
`shoot`), which knows no harmonics: next to the answer; where there is none, next to solutions with
two to eight times the harmonics, and where the exact motion is after 3, 10 and 30 periods. Of a
stability verdict: the modulus of the exact leading multiplier, and for "stable" the exact motion
that begins with the answer over 100 periods. Of a bifurcation: that the number of exact multipliers
outside the unit circle changes along the curve within 1 % of its frequency. Of a backbone's point:
the nearest free motion at rest at t = 0, of any period; the larger of both differences.

    right        the true error is at most three times the estimate (a tolerance: at most the
                 tolerance), or below 1e-6; a verdict is the exact one; a bifurcation is there
    large        says so: an estimate above 10 %, or a tolerance that the given modes do not allow
    unconverged  says so: no solution, a tolerance not reached, a curve not finished, no branch
    too long     60 s of processor time were not enough to answer and to compare
    unconfirmed  a bifurcation that is said to be so
    undecided    the verdict on stability is open
    open         no exact orbit was found to compare with, or the exact flow cannot tell
    WRONG        none of these: a wrong answer that passes for right

Printed for each kind: the counts, and the quantiles (5, 50, 95 %) of the true over the estimated
error. The rows are added to a file as they are found; a run goes on where it was stopped, and
several folders are counted together by ``--also``.

    OMP_NUM_THREADS=1 python benchmarks/campaign.py [--cases N] [--seed S] [--kind KIND] [folder]
"""

from __future__ import annotations

import csv
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import common
import numpy as np
import scipy.linalg

import fenics_crack as fc
from fenics_crack.balance.bordered import solve_in_plane
from fenics_crack.balance.fourier import resized
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import solution_of
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.modal import all_modes
from fenics_crack.motion.flow import exact_flow
from fenics_crack.time.march import initial_state

COLUMNS = (
    "seed", "case", "kind", "what", "masses", "pairs", "k R", "H", "omega", "estimate", "true",
    "verdict", "exact |mu|", "judgement", "remark", "s",
)  # fmt: skip
RIGHT, TOO_LARGE, UNCONVERGED, TOO_LONG = "right", "large", "unconverged", "too long"
UNCONFIRMED, UNDECIDED, OPEN, WRONG = "unconfirmed", "undecided", "open", "WRONG"
JUDGEMENTS = (RIGHT, TOO_LARGE, UNCONVERGED, TOO_LONG, UNCONFIRMED, UNDECIDED, OPEN, WRONG)
KINDS = {"solution": 0.6, "tolerance": 0.2, "curve": 0.12, "branch": 0.04, "backbone": 0.04}
"""What is asked, and how often."""
ROUNDING = 1e-6
"""Differences that count as none."""
SURE = 1e-4
"""Distance of a multiplier from the unit circle below which the exact flow does not tell: at the
very end of a branch several orbits are as near."""
LARGE = 0.1
"""Estimate above which an answer says itself that it is not to be trusted."""
SECONDS = 60.0
"""Of processor time that a case may take."""
PERIODS = 100
"""Over which a motion called stable is followed."""
NEXT_TO = 0.01
"""Of the frequency: where a bifurcation is looked for in the exact flow."""


@dataclass(frozen=True)
class Case:
    """One random system, and what is asked of it."""

    number: int
    kind: str
    structure: fc.Structure
    law: fc.UnilateralPenalty
    omega: float
    harmonics: int
    tolerance: float
    product: float


@dataclass
class Finding:
    """What is said about one answer."""

    what: str
    harmonics: int
    omega: float
    estimate: float = float("nan")
    true: float = float("nan")
    verdict: str = "-"
    exact: float = float("nan")
    judgement: str = UNCONVERGED
    remark: str = ""


# --- random systems -------------------------------------------------------------------------------


def draw(seed: int, number: int, only: str | None = None) -> Case:
    """The case of a seed and a number."""
    rng = np.random.default_rng([seed, number])
    kind = only or str(rng.choice(list(KINDS), p=list(KINDS.values())))
    structure = _plate(rng) if rng.random() < 0.05 else _masses(rng, kind == "backbone")
    modes = all_modes(structure)
    natural = np.sqrt(np.maximum(modes.squares[:3], 0.0))
    share = rng.choice([1 / 3, 1 / 2, 1.0, 2.0, 3.0, 10.0 ** rng.uniform(-0.5, 0.5)])
    omega = float(rng.choice(natural) * share * (1.0 + 0.03 * rng.normal()))
    static = np.einsum("mp,m,mp->p", modes.pairs, 1.0 / modes.squares, modes.pairs)
    product = 10.0 ** rng.uniform(-1.0, 4.0)
    law = fc.UnilateralPenalty(product / static)
    linear = fc.solve_linear(structure, omega).gap_coefficients
    size = np.sqrt(np.sum(linear[1:] ** 2, axis=0)).max() or 1.0
    pairs = structure.n_pairs
    clearance = rng.choice([-1.0, 1.0], pairs) * 10.0 ** rng.uniform(-2.0, 0.3, pairs) * size
    clearance = np.where(rng.random(pairs) < 0.4, 0.0, clearance)
    if rng.random() < 0.15:  # a pair just opens, or just closes
        pair = int(rng.integers(pairs))
        motion = structure if rng.random() < 0.5 else structure.tied(law.stiffness)
        waves = structure.apply_bt(fc.solve_linear(motion, omega).displacement_coefficients)
        clearance[pair] = _extremum(waves[:, pair], rng) * (1.0 - 10.0 ** rng.uniform(-4.0, -1.0))
    return Case(
        number, kind, structure.varied(clearance=clearance), law, omega,
        int(rng.choice([5, 10, 20, 40])), float(rng.choice([1e-2, 1e-3])), product,
    )  # fmt: skip


def _extremum(wave: np.ndarray, rng: np.random.Generator) -> float:
    """The largest or smallest value of a mean and a first harmonic."""
    return float(wave[0] + rng.choice([-1.0, 1.0]) * np.hypot(wave[1], wave[2]))


def _masses(rng: np.random.Generator, undamped: bool) -> fc.Structure:
    """A chain, or modes of random shapes with frequencies up to 30 times the first."""
    count = int(rng.integers(1, 13))
    if rng.random() < 0.5:
        mass = np.diag(10.0 ** rng.uniform(-0.5, 0.5, count))
        springs = 10.0 ** rng.uniform(-1.0, 1.0, count + 1)
        off = np.diag(springs[1:-1], 1)
        stiffness = np.diag(springs[:-1] + springs[1:]) - off - off.T
    else:
        mass = np.eye(count)
        turned = np.linalg.qr(rng.normal(size=(count, count)))[0]
        squares = np.append(1.0, 30.0 ** (2.0 * rng.random(count - 1)))
        stiffness = (turned * squares) @ turned.T
        stiffness = 0.5 * (stiffness + stiffness.T)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    rates = 2.0 * 10.0 ** rng.uniform(-3.0, np.log10(0.05), count) * np.sqrt(squares)
    damping = mass @ (shapes * rates) @ shapes.T @ mass
    pairs = int(rng.integers(1, min(4, count) + 1))
    gap = np.zeros((count, pairs))
    for pair, place in enumerate(rng.choice(count, pairs, replace=False)):
        gap[place, pair] = rng.choice([-1.0, 1.0])
        if count > 1 and rng.random() < 0.4:
            gap[(place + rng.integers(1, count)) % count, pair] = -gap[place, pair]
    loads = rng.normal(size=(3, count)) * (rng.random((3, count)) < 0.5)
    loads[0, rng.integers(count)] = 1.0
    loads[2] *= 0.0 if rng.random() < 0.7 else 0.3
    return fc.Structure.from_matrices(
        mass, stiffness, gap, force_cos=loads[0], force_sin=loads[1], force_mean=loads[2],
        damping=None if undamped else 0.5 * (damping + damping.T),
    )  # fmt: skip


@cache
def _whole_plate(ratio: float) -> fc.Structure:
    return common.plate("paper_plate", {"damping.ratio": ratio})


def _plate(rng: np.random.Generator) -> fc.Structure:
    """The paper's plate with few of its modes."""
    plate = _whole_plate(float(rng.choice([0.002, 0.01, 0.03])))
    return fc.reduce_structure(plate, modes=int(rng.integers(6, 13)))


# --- the exact flow -------------------------------------------------------------------------------


def exact_orbit(case: Case, found: fc.PeriodicSolution) -> tuple[fc.PeriodicOrbit | None, float]:
    """The orbit of the exact flow nearest to an answer, and its distance in the gap, relative to
    B^T u as the estimates are."""
    orbits = []
    for start in _starts(case, found):
        try:
            orbit = start()
        except (ConvergenceError, InputError, np.linalg.LinAlgError):
            continue
        orbits.append((distance(found, orbit), orbit))
        if orbits[-1][0] <= max(3.0 * estimate(found), ROUNDING):
            break
    if not orbits:
        return None, float("nan")
    off, orbit = min(orbits, key=lambda pair: pair[0])
    return orbit, off


def _starts(case: Case, found: fc.PeriodicSolution) -> Iterator[Callable[[], fc.PeriodicOrbit]]:
    """By shooting from the answer, from solutions with two and four times its harmonics next to it,
    and from where the exact motion is after some periods."""
    yield lambda: fc.shoot(case.structure, found)
    for factor, shortest in ((2, 0.05), (4, 0.05), (4, None), (8, None)):
        yield lambda factor=factor, shortest=shortest: fc.shoot(  # type: ignore[misc]
            case.structure, finer(case, found, factor, shortest)
        )
    for periods in (3, 10, 30):
        yield lambda periods=periods: fc.shoot(  # type: ignore[misc]
            case.structure, found, settle=periods
        )


def finer(
    case: Case, found: fc.PeriodicSolution, factor: int, shortest: float | None
) -> fc.PeriodicSolution:
    """The solution with more harmonics to which Newton's method leads from an answer, by full steps
    or by shortened ones."""
    harmonics = min(factor * found.harmonics, 160)
    problem = Problem(
        case.structure, found.omega, case.law, harmonics, subharmonic=found.subharmonic
    )
    system = problem.system(problem.compliance())
    near = solve_in_plane(
        system, resized(found.gap_coefficients, harmonics), 0.0, None,
        tolerance=1e-9, iterations=20, least_damping=shortest,
    )  # fmt: skip
    if near is None:
        raise ConvergenceError("no solution with more harmonics next to it")
    return solution_of(problem, system.linearise(near.unknown), status="finer")


def estimate(found: fc.PeriodicSolution) -> float:
    """Estimated error as a solution of its own structure: without that of a reduction."""
    return found.report.total - found.report.reduction


def distance(found: fc.PeriodicSolution, orbit: fc.PeriodicOrbit) -> float:
    """Of the gaps over the period, relative to B^T u."""
    times = np.arange(len(orbit.gap)) * found.period / len(orbit.gap)
    closing = orbit.gap + found.structure.clearance
    return float(np.linalg.norm(found.gap(times) - orbit.gap) / np.linalg.norm(closing))


def leaves(case: Case, found: fc.PeriodicSolution, orbit: fc.PeriodicOrbit) -> bool:
    """Whether the exact motion that begins with an answer leaves its orbit: after 100 periods it is
    farther away than at first, than the linearised motion, and than the estimate allows."""
    flow = exact_flow(case.structure, case.law)
    state = flow.state(*initial_state(case.structure, found))
    size = float(np.linalg.norm(orbit.state))
    first = linear = (state - orbit.state) / size
    monodromy = flow.advance(orbit.state, found.omega, found.period).track.tangent
    for _ in range(PERIODS):
        state = flow.advance(state, found.omega, found.period).state
        linear = monodromy @ linear
    last = float(np.linalg.norm(state - orbit.state)) / size
    allowed = max(float(np.linalg.norm(first)), float(np.linalg.norm(linear)), estimate(found))
    return last > max(3.0 * allowed, 1e-4)


def outside(orbit: fc.PeriodicOrbit) -> tuple[int, int, int]:
    """Exact multipliers outside the unit circle: real above 1, real below -1, pairs."""
    values = orbit.multipliers
    real = np.abs(values.imag) < 1e-9
    return (
        int(np.sum(real & (values.real > 1.0))),
        int(np.sum(real & (values.real < -1.0))),
        int(np.sum(~real & (np.abs(values) > 1.0) & (values.imag > 0.0))),
    )


# --- what is judged -------------------------------------------------------------------------------


def judge(
    case: Case, found: fc.PeriodicSolution, what: str, verdict: str, asked: float | None = None
) -> Finding:
    """An answer, its estimate and its verdict against the exact flow; ``asked``: a tolerance."""
    row = Finding(what, found.harmonics, found.omega, estimate(found), verdict=verdict)
    if not found.converged:
        row.remark = found.status
        if "that of the reduced structure given" in found.status:
            row.judgement = TOO_LARGE
        return row
    if estimate(found) > LARGE and verdict != "stable":
        row.judgement = TOO_LARGE
        return row
    orbit, row.true = exact_orbit(case, found)
    if orbit is not None:
        row.exact = float(abs(orbit.multipliers[0]))
    if estimate(found) > LARGE:
        row.judgement = TOO_LARGE
        if orbit is not None and row.exact > 1.0 + ROUNDING:
            if row.true <= 3.0 * estimate(found):
                row.judgement, row.remark = WRONG, "verdict in spite of its estimate"
        return row
    if orbit is None:
        row.judgement = OPEN if verdict != "stable" else WRONG
        row.remark = "no exact orbit"
        return row
    if row.true > max(3.0 * estimate(found), ROUNDING):
        row.judgement, row.remark = WRONG, "error"
    elif asked is not None and row.true > asked:
        row.judgement, row.remark = WRONG, "tolerance"
    elif verdict == "undecided":
        row.judgement = UNDECIDED
    elif verdict != "-" and abs(row.exact - 1.0) <= SURE:
        row.judgement, row.remark = OPEN, "at a bifurcation"
    elif verdict != "-":
        right = verdict == ("stable" if row.exact < 1.0 else "unstable")
        row.judgement, row.remark = (RIGHT, "") if right else (WRONG, "verdict")
        if right and verdict == "stable" and leaves(case, found, orbit):
            row.judgement, row.remark = WRONG, "leaves"
    else:
        row.judgement = RIGHT
    return row


def solutions(case: Case) -> Iterator[Finding]:
    """H given."""
    found = fc.solve_harmonic_balance(
        case.structure, case.omega, case.law, harmonics=case.harmonics, throw=False
    )
    verdict = fc.floquet(case.structure, found).verdict if found.converged else "-"
    yield judge(case, found, "solution", verdict)


def tolerances(case: Case) -> Iterator[Finding]:
    """A tolerance given."""
    found = fc.solve_harmonic_balance(
        case.structure, case.omega, case.law, tolerance=case.tolerance, throw=False
    )
    yield judge(case, found, f"tolerance {case.tolerance:g}", "-", case.tolerance)


def followed(case: Case) -> fc.ResponseCurve:
    """The curve of a case, over its frequency."""
    return fc.continue_frequency(
        case.structure, 0.9 * case.omega, 1.1 * case.omega, case.law, harmonics=case.harmonics,
        stability=True, throw=False, most_points=600,
    )  # fmt: skip


def curves(case: Case) -> Iterator[Finding]:
    """Points and bifurcations of a curve."""
    curve = followed(case)
    if not curve.complete:
        status = f"curve: {curve.status}"
        yield Finding("curve", case.harmonics, case.omega, remark=status)
    verdicts = curve.verdicts
    for place in np.unique(np.linspace(0, len(curve) - 1, 8).astype(int)):
        yield judge(case, curve.solution(int(place)), "point", str(verdicts[place]))
    for one in curve.bifurcations[:: 1 + len(curve.bifurcations) // 6]:
        yield bifurcation(case, curve, one)


def bifurcation(case: Case, curve: fc.ResponseCurve, one: fc.Bifurcation) -> Finding:
    """Whether the exact orbits next to a bifurcation have it."""
    row = Finding(one.kind, one.problem.harmonics, one.value, true=one.exact / one.value - 1.0)
    if not one.confirmed:
        row.judgement = UNCONFIRMED
        return row
    near = np.abs(curve.omega / one.exact - 1.0)
    seen = []
    for place in np.argsort(near, kind="stable")[:12]:
        if near[place] < NEXT_TO or len(seen) < 4:
            orbit, off = exact_orbit(case, curve.solution(int(place)))
            if orbit is not None and off < 0.25:
                seen.append((int(place), outside(orbit)))
    kind = ("fold", "period_doubling", "neimark_sacker").index(one.kind)
    counts = {counted[kind] for _, counted in seen}
    row.judgement = RIGHT if len(counts) > 1 else OPEN
    row.remark = f"{len(seen)} orbits"
    if row.judgement == OPEN:  # along the branch of exact orbits, through its folds
        try:
            omega, _ = fc.refine_bifurcation(one, reach=NEXT_TO)
        except ConvergenceError as error:
            row.remark = str(error)
        else:
            row.judgement, row.remark = RIGHT, f"refined at {omega / one.exact - 1.0:.1e}"
    return row


def branches(case: Case) -> Iterator[Finding]:
    """Points of a branch of twice the period."""
    curve = followed(case)
    low, high = curve.values.min(), curve.values.max()
    for one in curve.bifurcations:
        if one.kind != "period_doubling" or not one.confirmed or not low < one.value < high:
            continue
        try:
            branch = fc.follow_branch(curve, one, throw=False, stability=True, most_points=200)
        except ConvergenceError as error:
            yield Finding("branch", case.harmonics, one.value, remark=str(error))
            continue
        for place in np.unique(np.linspace(0, len(branch) - 1, 5).astype(int))[1:]:
            verdict = str(branch.verdicts[place])
            yield judge(case, branch.solution(int(place)), "point of a branch", verdict)
        return


def backbones(case: Case) -> Iterator[Finding]:
    """Points of a backbone of the undamped structure, from where contact begins."""
    linear = fc.solve_linear(case.structure, case.omega)
    motion = linear.displacement_coefficients[1:3]
    stiffness = np.einsum(
        "m,pm->pm", all_modes(case.structure).squares, motion @ np.eye(motion.shape[1])
    )
    energy = 0.5 * float(np.abs(np.sum(motion * stiffness))) or 1.0
    backbone = fc.follow_backbone(
        case.structure, case.law, 1, 1e-2 * energy, 10.0 * energy, harmonics=case.harmonics,
        throw=False,
    )  # fmt: skip
    for place in np.unique(np.linspace(0, len(backbone.omega) - 1, 4).astype(int)):
        yield free_motion(case, backbone.solution(int(place)))


def free_motion(case: Case, found: fc.PeriodicSolution) -> Finding:
    """A point of a backbone against the nearest free motion in the exact flow that is at rest at
    t = 0, and so again after half a period, of any period and energy: by least squares, as motions
    come in families."""
    row = Finding("backbone", found.harmonics, found.omega, found.report.truncation)
    factors = {"load": 0.0} if case.structure.damping is None else {"load": 0.0, "damping": 0.0}
    free = case.structure.varied(**factors)
    flow, omega = exact_flow(free, case.law), found.omega
    state, period = flow.state(*initial_state(free, found)), found.period
    share, rest = np.arange(512) / 512, len(state) // 2
    wave = found.gap(share * period)
    size = float(np.linalg.norm(state))
    for _ in range(20):
        motion = flow.advance(state, omega, 0.5 * period)
        moved, monodromy = motion.state, motion.track.tangent
        left = moved[rest:]
        if np.linalg.norm(state) < 0.5 * size:
            break
        if np.linalg.norm(left) < 1e-9 * size:
            gap = flow.advance(state, omega, period, instants=share * period).samples.gap
            apart = np.linalg.norm(wave - gap) / np.linalg.norm(gap + free.clearance)
            row.true = max(float(apart), abs(period / found.period - 1.0))
            good = row.true <= max(3.0 * row.estimate, ROUNDING)
            row.judgement = RIGHT if good else TOO_LARGE if row.estimate > LARGE else WRONG
            return row
        later = (flow.advance(moved, omega, 5e-7 * period).state - moved)[rest:] / (1e-6 * size)
        slopes = np.column_stack([monodromy[rest:, :rest], later])
        step = np.linalg.lstsq(slopes, left / size, rcond=1e-7)[0]
        if np.linalg.norm(step) > 0.5:  # to another motion, or to rest
            break
        state[:rest] -= size * step[:-1]
        period *= 1.0 - step[-1]
    row.judgement = TOO_LARGE if row.estimate > LARGE else OPEN
    row.remark = "no free motion"
    return row


ASKED = {
    "solution": solutions, "tolerance": tolerances, "curve": curves, "branch": branches,
    "backbone": backbones,
}  # fmt: skip


# --- the campaign ---------------------------------------------------------------------------------


def main() -> None:
    """Run it."""
    common.run(
        __doc__,
        {"campaign": campaign},
        cases={"type": int, "default": 1000, "help": "how many"},
        first={"type": int, "default": 0, "help": "number of the first"},
        seed={"type": int, "default": 1, "help": "of the random numbers"},
        kind={"choices": list(KINDS), "help": "what is asked, instead of all"},
        minutes={"type": float, "default": np.inf, "help": "after which no case begins"},
        also={"nargs": "*", "default": [], "help": "files whose rows are counted too"},
    )


def campaign(arguments: common.Arguments) -> None:
    """All cases that are not in the file yet."""
    path = arguments.folder / f"campaign_{arguments.kind or 'all'}_{arguments.seed}.csv"
    rows = read(path)
    done = {int(row["case"]) for row in rows}
    count = 20 if arguments.quick else arguments.cases
    begun = time.monotonic()
    with open(path, "a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if file.tell() == 0:
            writer.writeheader()
        for number in range(arguments.first, arguments.first + count):
            if number in done:
                continue
            if time.monotonic() - begun > 60.0 * arguments.minutes:
                break
            new = findings(arguments.seed, draw(arguments.seed, number, arguments.kind))
            writer.writerows(new)
            file.flush()
            rows += new
    summarise(rows + [row for other in arguments.also for row in read(Path(other))])


def read(path: Path) -> list[dict]:
    """What an earlier run has found."""
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def findings(seed: int, case: Case) -> list[dict]:
    """The rows of a case; an answer that is refused is one too."""
    started = time.process_time()
    found: list[Finding] = []
    try:
        with limited(SECONDS):
            for one in ASKED[case.kind](case):
                found.append(one)
    except TimeoutError:
        found.append(Finding("too long", case.harmonics, case.omega, judgement=TOO_LONG))
    except (ConvergenceError, InputError) as error:
        found.append(Finding("refused", case.harmonics, case.omega, remark=str(error)))
    except Exception as error:  # a campaign has to say what broke, and go on
        name = f"{type(error).__name__}: {error}"
        found.append(Finding("broke", case.harmonics, case.omega, judgement=WRONG, remark=name))
    spent = time.process_time() - started
    found = found or [Finding("none", case.harmonics, case.omega, judgement=RIGHT)]
    of = case.structure
    return [
        dict(zip(COLUMNS, (
            seed, case.number, case.kind, one.what, of.n_dofs, of.n_pairs, case.product,
            one.harmonics, one.omega, one.estimate, one.true, one.verdict, one.exact,
            one.judgement, one.remark.replace("\n", " ")[:200], spent if index == 0 else 0.0,
        ), strict=True))
        for index, one in enumerate(found)
    ]  # fmt: skip


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after so much processor time."""

    def stop(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def summarise(rows: list[dict]) -> None:
    """The counts and the quantiles, and every answer that is wrong."""
    table = []
    for kind in (*KINDS, "all"):
        of = [row for row in rows if kind in (row["kind"], "all")]
        if of:
            counts = [sum(row["judgement"] == one for row in of) for one in JUDGEMENTS]
            table.append((kind, len({row["case"] for row in of}), len(of), *counts, *quantiles(of)))
    common.print_table(
        "Campaign", ("asked", "cases", "answers", *JUDGEMENTS, "5 %", "50 %", "95 %"), table
    )
    wrong = [row for row in rows if row["judgement"] == WRONG]
    columns = ("case", "kind", "what", "masses", "pairs", "k R", "H", "estimate", "true",
               "verdict", "exact |mu|", "remark")  # fmt: skip
    if wrong:
        common.print_table("Wrong", columns, [[row[name] for name in columns] for row in wrong])


def quantiles(rows: list[dict]) -> tuple[float, float, float]:
    """Of true over estimated error, 5, 50 and 95 %, where an answer is compared and passes for
    right, and its error is above 1e-6."""
    ratios = [
        float(row["true"]) / float(row["estimate"])
        for row in rows
        if float(row["estimate"]) <= LARGE and float(row["true"]) > ROUNDING
    ]
    if not ratios:
        return (float("nan"),) * 3
    low, middle, high = np.quantile(ratios, (0.05, 0.5, 0.95))
    return float(low), float(middle), float(high)


if __name__ == "__main__":
    main()
