"""A campaign: random structures, and every answer held against a flow of its own.

Each case is drawn from the seed and its own number alone (:mod:`campaign_cases` says what), so that
any of them can be repeated by itself (``--family plate --first N --cases 1``). What is asked:

    solution    solve_harmonic_balance with H given, and floquet
    tolerance   the same with tolerance=1e-2, 1e-3 or 1e-4, of a reduced structure
    whole       the same of the whole structure, whose modes are chosen, too
    peak        the largest point of a curve over a resonance, and floquet
    curve       continue_frequency to a tolerance, up to 8 of its points, and its bifurcations
    parameter   continue_parameter to a tolerance over the load, the stiffness of a penalty, the
                damping or the clearance at one frequency: the same of it (by itself: --kind)
    branch      follow_branch from a period doubling of such a curve, up to 4 points
    ends        the same, the points next to both ends, and floquet of them once more
    reduction   the reduction's estimated error against the orbit with twice the modes

The judge is :mod:`reference_flow`, which shares no code with the package and knows no harmonics:
orbits next to the answer; where there is none, next to the one that the answer goes by, to where
the exact motion is after 3, 10, 30 and 100 periods, and to solutions with two and four times the
harmonics. An orbit is the
answer's own within three times the estimate, or within three times one Newton step of the whole
wave (``pred``). The error is the distance of the gaps from that orbit of the same reduced
structure, relative to what of B^T u moves. Of a verdict: the exact leading multiplier, and for
"stable" the exact motion that begins with the answer. Of a bifurcation: that the number of exact
multipliers outside the unit circle changes along the curve within 1 % of its frequency.

    right        the true error is at most three times the estimate (a tolerance: at most the
                 tolerance), or below 1e-6; a verdict is the exact one; a bifurcation is there
    large        says so: an estimate above 10 %
    limited      says so: a tolerance that the given modes do not allow
    wanders      says so: a tolerance, or a solution without a verdict, where the exact motion does
                 not repeat itself, nor does the judge's: from rest, behind 60 periods, it is in
                 most of 60 more than 3 % from where it was 1, 2, ... or 8 periods before
    unconverged  says so: no solution, a tolerance not reached, a curve not finished, no branch
    too long     60 s of processor time were not enough to answer and to compare
    unconfirmed  a bifurcation of harmonic balance
    undecided    the verdict on stability is open, but for motions that wander
    open         no exact orbit of its own was found to compare with, or it cannot tell
    WRONG        none of these: a wrong answer that passes for right

Cases are added to a file as they are found, a line of JSON each; a run goes on where it was
stopped. ``--table`` adds up the files named, and asks nothing. ``--known`` asks the cases of such
files again, and judges anew only those answers that are not what they were: with another verdict,
or an estimate (of a bifurcation: a place) that differs by more than 1e-3 of it.

    OMP_NUM_THREADS=1 python benchmarks/campaign.py [--cases N] [--seed S] [--family F] [folder]
    python benchmarks/campaign.py --table FILE...
    python benchmarks/campaign.py folder --known FILE...
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import common
import numpy as np
from campaign_cases import FAMILIES, KINDS, Case, draw, family_of
from reference_flow import NoOrbit, Orbit, ReferenceFlow, predicted, size_of_motion

import fenics_crack as fc
from fenics_crack.motion.orbit import PeriodicOrbit

RIGHT, TOO_LARGE, LIMITED, UNCONVERGED = "right", "large", "limited", "unconverged"
TOO_LONG, UNCONFIRMED, UNDECIDED, OPEN = "too long", "unconfirmed", "undecided", "open"
WRONG, WANDERS = "WRONG", "wanders"
NO_VERDICT = "no verdict"
ROUNDING = 1e-6
"""Differences that count as none."""
SURE = 1e-4
"""Distance of a multiplier from the unit circle below which the exact flow does not tell: at the
very end of a branch several orbits are as near."""
LARGE, UNKNOWN = 0.1, 1.0
"""Estimate above which an answer says itself that it is not to be trusted; that says it does not
know its error."""
TIMES = 3.0
"""The estimate, and pred, beyond which an error is too large."""
GIVING = 10.0
"""Times the closing of the penalty for a rigid stop in statics, up to which it is that."""
CLOSE = 1.1
"""Times the estimate at which an orbit is so near that none is sought that is nearer: next to a
fold there are two."""
NEAR = 1e-5
"""Distance of an answer from its stable orbit up to which the motion that begins with it need not
be followed."""
WANDERED, APART, LATER = 60, 0.03, 8
"""Periods after which a motion is followed for as many more, and how far it is in most of them from
where it was up to so many before if it wanders."""
FINEST = 160
"""Harmonics of the solutions from which a reference's search for an orbit begins, at most."""
SECONDS = 60.0
"""Of processor time that a case may take."""
PERIODS = {4: 100, 200: 20}
"""Over which a motion called stable is followed, with up to so many pairs."""
TOLERANCE = 1e-2
"""Of curves."""
PEAK = 0.015
"""Of the bilinear frequency, to both sides, where a peak is looked for."""
ALIKE = 1e-3
"""Of an estimate: up to which an answer is the one that is known."""
KINDS_OF_BIFURCATION = "fold", "period_doubling", "neimark_sacker"
NEXT_TO = 0.01
"""Of the frequency: where a bifurcation is looked for in the exact flow."""


@dataclass
class Finding:
    """What is said about one answer."""

    what: str
    harmonics: int
    omega: float
    estimate: float = float("nan")
    true: float = float("nan")
    pred: float = float("nan")
    verdict: str = "-"
    exact: float = float("nan")
    asked: float = float("nan")
    judgement: str = UNCONVERGED
    remark: str = ""
    seconds: float = float("nan")


# --- the exact flow -------------------------------------------------------------------------------


def exact_orbit(case: Case, found: fc.PeriodicSolution) -> tuple[Orbit | None, float]:
    """The orbit of the exact flow nearest to an answer, and its distance in the gap, relative to
    B^T u as the estimates are."""
    orbits: list[tuple[float, Orbit]] = []
    flow = case.flow(found.structure, found.contact)
    for start in _starts(case, found, flow):
        try:
            orbit = flow.orbit(start(), found.omega, found.period)
        except (NoOrbit, fc.ConvergenceError, np.linalg.LinAlgError):
            continue
        orbits.append((distance(found, orbit), orbit))
        if orbits[-1][0] <= max(CLOSE * estimate(found), ROUNDING):
            break
    if not orbits:
        return None, float("nan")
    off, orbit = min(orbits, key=lambda pair: pair[0])
    return orbit, off


def _starts(
    case: Case, found: fc.PeriodicSolution, flow: ReferenceFlow
) -> Iterator[Callable[[], np.ndarray]]:
    """The orbit that the answer is; its own state, that of the orbit next to it, where the exact
    motion is after some periods, and the states of solutions with two and four times its
    harmonics."""
    state = flow.states_of(found, np.zeros(1))[0]
    if (own_orbit := found.orbit) is not None:
        yield lambda: state_of(own_orbit, flow)
    yield lambda: state
    if (
        own_orbit is None
        and found.assessment.flow is not None
        and (nearest_orbit := found.assessment.nearest_orbit) is not None
    ):
        yield lambda: state_of(nearest_orbit, flow)
    for periods in (3, 10):
        yield lambda periods=periods: flow.settled(  # type: ignore[misc]
            state, found.omega, found.period, periods
        )
    for factor in (2, 4):
        yield lambda factor=factor: flow.states_of(  # type: ignore[misc]
            finer(case, found, factor), np.zeros(1)
        )[0]
    for periods in (30, 100):
        yield lambda periods=periods: flow.settled(  # type: ignore[misc]
            state, found.omega, found.period, periods
        )


def state_of(orbit: PeriodicOrbit, flow: ReferenceFlow) -> np.ndarray:
    """An orbit of the package at phase zero."""
    return flow.state(*np.split(orbit.state, 2) @ orbit.flow.modal_model.shapes.T)


def finer(case: Case, found: fc.PeriodicSolution, factor: int) -> fc.PeriodicSolution:
    """A solution with more harmonics from an answer."""
    return fc.solve_harmonic_balance(
        found.structure, found.omega, found.contact, subharmonic=found.subharmonic,
        harmonics=min(factor * found.harmonics, FINEST), initial=found,
    )  # fmt: skip


def estimate(found: fc.PeriodicSolution) -> float:
    """Estimated error as a solution of its own structure: without that of a reduction."""
    return found.report.total - found.report.reduction


def distance(found: fc.PeriodicSolution, orbit: Orbit) -> float:
    """Of the gaps over the period, relative to what of B^T u moves."""
    times = np.arange(len(orbit.gap)) * found.period / len(orbit.gap)
    size = size_of_motion(orbit.gap + found.structure.clearance)
    return float(np.linalg.norm(found.gap(times) - orbit.gap)) / size


def leaves(case: Case, found: fc.PeriodicSolution, orbit: Orbit) -> bool:
    """Whether the exact motion that begins with an answer, or the orbit that is one, leaves its
    orbit: after many periods it is farther away than at first, than the linearised motion, and
    than the estimate allows."""
    flow = case.flow(found.structure, found.contact)
    state = flow.states_of(found, np.zeros(1))[0]
    if found.orbit is not None:
        state = state_of(found.orbit, flow)
    size = float(np.linalg.norm(orbit.state))
    first_change = linear = (state - orbit.state) / size
    for _ in range(next(n for most, n in PERIODS.items() if found.structure.n_pairs <= most)):
        state = flow.advance(state, found.omega, 0.0, found.period).state
        linear = orbit.monodromy @ linear
    last_change = float(np.linalg.norm(state - orbit.state)) / size
    allowed = max(
        float(np.linalg.norm(first_change)), float(np.linalg.norm(linear)), estimate(found)
    )
    return last_change > max(3.0 * allowed, 1e-4)


def wanders(case: Case, found: fc.PeriodicSolution) -> bool:
    """Whether the exact motion from rest does not repeat itself in the long run."""
    flow = case.flow(found.structure, found.contact)
    state = flow.settled(
        np.zeros(2 * len(flow.system.squares)), found.omega, found.period, WANDERED
    )
    visited_states = [state]
    for _ in range(WANDERED):
        visited_states.append(
            flow.advance(visited_states[-1], found.omega, 0.0, found.period).state
        )
    states = np.array(visited_states)
    size = float(np.linalg.norm(states, axis=1).max())
    distances = [
        np.median(np.linalg.norm(states[later:] - states[:-later], axis=1))
        for later in range(1, LATER + 1)
    ]
    return bool(min(distances) > APART * size)


def outside(orbit: Orbit) -> tuple[int, int, int]:
    """Exact multipliers outside the unit circle: real above 1, real below -1, pairs."""
    values = orbit.multipliers
    is_real = np.abs(values.imag) < 1e-9
    return (
        int(np.sum(is_real & (values.real > 1.0))),
        int(np.sum(is_real & (values.real < -1.0))),
        int(np.sum(~is_real & (np.abs(values) > 1.0) & (values.imag > 0.0))),
    )


# --- what is judged -------------------------------------------------------------------------------


def judge(
    case: Case,
    found: fc.PeriodicSolution,
    what: str,
    verdict: str,
    asked: float = float("nan"),
    seconds: float = float("nan"),
) -> Finding:
    """An answer, its estimate and its verdict against the exact flow; ``asked``: a tolerance."""
    row = Finding(
        what, found.harmonics, found.omega, estimate(found), verdict=verdict, asked=asked,
        seconds=seconds,
    )  # fmt: skip
    if (known := as_known(case, row)) is not None:
        return known
    words = fc.floquet(found.structure, found).reason if verdict == "undecided" else found.status
    if "comes back to within" in words and wanders(case, found):
        row.judgement, row.remark = WANDERS, words
        return row
    row.remark = words
    if not found.converged:
        return row
    if estimate(found) > LARGE and verdict not in ("stable", "unstable"):
        row.judgement = TOO_LARGE
        row.remark = "" if found.assessment.flow is None else found.assessment.rejection_reason
        return row
    orbit, row.true = exact_orbit(case, found)
    row.pred = float("nan") if orbit is None else _pred(case, found)
    if orbit is not None:
        row.exact = float(np.abs(orbit.multipliers).max(initial=0.0))
    row.judgement, row.remark = _judgement(case, found, row, orbit)
    return row


def as_known(case: Case, row: Finding) -> Finding | None:
    """What was found of the same answer before; None where it is not known, or was another one."""
    for one in case.known:
        known = Finding(**one)
        field_names = ("what", "harmonics", "verdict")
        pairs = [(row.omega, known.omega), (row.estimate, known.estimate), (row.asked, known.asked)]
        if row.what in KINDS_OF_BIFURCATION:
            pairs.append((row.true, known.true))
        if all(getattr(row, name) == getattr(known, name) for name in field_names) and all(
            np.isclose(mine, its, rtol=ALIKE, atol=ROUNDING, equal_nan=True) for mine, its in pairs
        ):
            return replace(known, seconds=row.seconds)
    return None


def _pred(case: Case, found: fc.PeriodicSolution) -> float:
    try:
        return predicted(case.flow(found.structure, found.contact), found)
    except (NoOrbit, np.linalg.LinAlgError):
        return float("nan")


def _judgement(
    case: Case, found: fc.PeriodicSolution, row: Finding, orbit: Orbit | None
) -> tuple[str, str]:
    """And why."""
    if orbit is None:
        if row.estimate > LARGE:
            return TOO_LARGE, "no exact orbit"
        return (OPEN if row.verdict != "stable" else WRONG), "no exact orbit"
    distance_bound = max(TIMES * row.estimate, ROUNDING)
    if case.family == "rigid":  # whose penalty gives way by 1 / product in statics
        distance_bound = max(distance_bound, GIVING / case.product)
    if row.estimate > LARGE:  # decided all the same
        is_other_verdict = row.verdict != ("stable" if row.exact < 1.0 else "unstable")
        is_contradicted = (
            is_other_verdict and abs(row.exact - 1.0) > SURE and row.true <= distance_bound
        )
        return (WRONG, "verdict in spite of its estimate") if is_contradicted else (TOO_LARGE, "")
    if row.true > distance_bound:
        is_another_orbit = row.pred <= distance_bound and row.true > TIMES * row.pred
        return (OPEN, "another orbit") if is_another_orbit else (WRONG, "error")
    if row.true > row.asked:
        return missed(found)
    if row.verdict == "undecided":
        return UNDECIDED, row.remark
    if row.verdict in ("-", NO_VERDICT) or (row.verdict == "irregular" and row.exact > 1.0):
        return RIGHT, ""
    if abs(row.exact - 1.0) <= SURE:
        return OPEN, "at a bifurcation"
    if row.verdict != ("stable" if row.exact < 1.0 else "unstable"):
        return WRONG, "verdict"
    if row.verdict == "stable" and row.true > NEAR and leaves(case, found, orbit):
        return WRONG, "leaves"
    return RIGHT, ""


def missed(found: fc.PeriodicSolution) -> tuple[str, str]:
    """A tolerance that is not met, with an error that is as stated: whether it says so."""
    if "what helps: " not in found.status:
        return WRONG, "tolerance"
    return LIMITED if "what helps: modes" in found.status else UNCONVERGED, found.status


def _verdict(found: fc.PeriodicSolution) -> str:
    """That of ``floquet``; where it judges no such answer, and says what does, "no verdict"."""
    try:
        return fc.floquet(found.structure, found).verdict if found.converged else "-"
    except fc.InputError as error:
        if "reduce" not in str(error):
            raise
        return NO_VERDICT


def solutions(case: Case) -> Iterator[Finding]:
    """H given."""
    start_time = time.process_time()
    solution = fc.solve_harmonic_balance(
        case.structure, case.omega, case.law, harmonics=case.harmonics, throw=False
    )
    verdict = _verdict(solution)
    yield judge(case, solution, "solution", verdict, seconds=time.process_time() - start_time)


def tolerances(case: Case) -> Iterator[Finding]:
    """A tolerance given."""
    start_time = time.process_time()
    solution = fc.solve_harmonic_balance(
        case.structure, case.omega, case.law, tolerance=case.tolerance, throw=False
    )
    spent = time.process_time() - start_time
    yield judge(case, solution, "tolerance", "-", case.tolerance, spent)


def wholes(case: Case) -> Iterator[Finding]:
    """A tolerance given, and the modes to be chosen: against the orbit with twice as many."""
    start_time = time.process_time()
    solution = fc.solve_harmonic_balance(
        case.structure, case.omega, case.law, tolerance=case.tolerance, throw=False
    )
    spent = time.process_time() - start_time
    row = judge(case, solution, "tolerance, modes", "-", seconds=spent)
    row.asked = case.tolerance
    if row.judgement == RIGHT:
        off = _with_more_modes(case, solution, case.structure)
        row.true = float("nan") if off is None else off[1]
        row.estimate = solution.report.total
        if off is None:
            row.judgement, row.remark = OPEN, "no orbit with twice the modes"
        elif row.true > max(TIMES * row.estimate, ROUNDING):
            row.judgement, row.remark = WRONG, "error"
        elif row.true > case.tolerance:
            row.judgement, row.remark = missed(solution)
    yield row


def reductions(case: Case) -> Iterator[Finding]:
    """The error of the reduction: between the orbits of the structure given and of one with twice
    the modes."""
    solution = fc.solve_harmonic_balance(
        case.structure, case.omega, case.law, harmonics=case.harmonics, throw=False
    )
    row = Finding("reduction", solution.harmonics, solution.omega, solution.report.reduction)
    if solution.converged:
        off = _with_more_modes(case, solution, case.structure.whole)
        row.judgement = OPEN
        if off is not None:
            row.true = off[0]
            is_good = row.true <= max(TIMES * row.estimate, ROUNDING)
            row.judgement = RIGHT if is_good else TOO_LARGE if row.estimate > LARGE else WRONG
    yield row


def _with_more_modes(
    case: Case, found: fc.PeriodicSolution, whole: fc.Structure
) -> tuple[float, float] | None:
    """How far the orbit with twice the modes is from the orbit of a solution's own structure, and
    from the solution."""
    reduced_structure = fc.reduce_structure(
        whole, modes=2 * found.structure.n_modes, method="massless"
    )
    orbit, off = exact_orbit(case, found)
    count = min(found.harmonics, FINEST)
    solution = fc.solve_harmonic_balance(
        reduced_structure, found.omega, case.law, harmonics=count, initial=found, throw=False
    )
    if orbit is None or not solution.converged:
        return None
    better, better_distance = exact_orbit(case, solution)
    if better is None or max(off, better_distance) > max(LARGE, TIMES * estimate(found)):
        return None
    size = size_of_motion(better.gap + whole.clearance)
    return float(np.linalg.norm(better.gap - orbit.gap)) / size, distance(found, better)


def followed(case: Case, reach: float = 0.1, **how: Any) -> fc.ResponseCurve:
    """The curve of a case, over its frequency, to a tolerance."""
    return fc.continue_frequency(
        case.structure, (1.0 - reach) * case.omega, (1.0 + reach) * case.omega, case.law,
        **(how or {"tolerance": TOLERANCE}), throw=False, most_points=600,
    )  # fmt: skip


def peaks(case: Case) -> Iterator[Finding]:
    """The point of a curve where lips move most."""
    curve = followed(case, PEAK, harmonics=case.harmonics)
    sizes = np.linalg.norm(curve.gap_coefficients[:, 1:], axis=(1, 2))
    start_time = time.process_time()
    peak_solution = curve.solution(int(np.argmax(sizes)))
    verdict = _verdict(peak_solution)
    yield judge(case, peak_solution, "peak", verdict, seconds=time.process_time() - start_time)


def curves(case: Case) -> Iterator[Finding]:
    """Points and bifurcations of a curve over the frequency."""
    yield from along(case, followed(case, 0.1 if case.family == "few" else 0.03))


def parameters(case: Case) -> Iterator[Finding]:
    """Those of a curve over another parameter at one frequency, from up to a tenth of what is given
    to up to ten times; of the clearance, by up to the size of the linear gap."""
    rng = np.random.default_rng(case.number)
    rigid = isinstance(case.law, fc.UnilateralConstraint)
    name = str(rng.choice(["load", "damping", "clearance"] + ["stiffness"] * (not rigid)))
    lower_end, upper_end = 10.0 ** -rng.random(), 10.0 ** rng.random()
    if name == "clearance":
        linear = fc.solve_linear(case.structure, case.omega).gap_coefficients
        size = float(np.sqrt(np.sum(linear[1:] ** 2, axis=0)).max()) or 1.0
        lower_end, upper_end = -lower_end * size, 0.1 * upper_end * size
    start, end = (lower_end, upper_end) if rng.random() < 0.5 else (upper_end, lower_end)
    curve = fc.continue_parameter(
        case.structure, case.omega, case.law, name, start, end,
        tolerance=TOLERANCE, throw=False, most_points=600,
    )  # fmt: skip
    yield from along(case, curve)


def along(case: Case, curve: fc.ResponseCurve) -> Iterator[Finding]:
    """Points and bifurcations of a curve."""
    has_few_modes = case.family == "few"
    if not curve.complete:
        status = f"curve: {curve.status}"
        yield Finding("curve", case.harmonics, case.omega, remark=status)
    verdicts = curve.verdicts
    for place in np.unique(np.linspace(0, len(curve) - 1, 8 if has_few_modes else 5).astype(int)):
        yield judge(case, curve.solution(int(place)), "point", str(verdicts[place]))
    for event in curve.bifurcations[:: 1 + len(curve.bifurcations) // (6 if has_few_modes else 3)]:
        yield bifurcation(case, curve, event)


def bifurcation(case: Case, curve: fc.ResponseCurve, one: fc.Bifurcation) -> Finding:
    """Whether the exact orbits next to a bifurcation have it."""
    frequency = curve.parameter == "omega"
    size = abs(one.value) if frequency else max(abs(one.value), float(np.ptp(curve.values)))
    row = Finding(one.kind, one.problem.harmonics, one.value, true=0.0)
    if (known_row := as_known(case, row)) is not None:
        return known_row
    if not one.single_point_curve.exact:
        row.judgement = UNCONFIRMED
        return row
    distances = np.abs(curve.values - one.value) / size
    seen_places = set()
    # At a branch point, as at a fold, a multiplier passes 1.
    kind = KINDS_OF_BIFURCATION.index("fold" if one.kind == "branch_point" else one.kind)
    for count, place in enumerate(np.argsort(distances, kind="stable")[:24]):
        if len(seen_places) > 1 or (distances[place] > NEXT_TO and count >= 4):
            break
        orbit, distance = exact_orbit(case, curve.solution(int(place)))
        if orbit is not None and distance < 0.25:
            seen_places.add(outside(orbit)[kind])
    row.judgement = RIGHT if len(seen_places) > 1 else OPEN
    return row


def _branch(case: Case) -> Iterator[fc.ResponseCurve | Finding]:
    """The branch from the first period doubling within a curve, or why there is none."""
    curve = followed(case)
    min_value, max_value = curve.values.min(), curve.values.max()
    for event in curve.bifurcations:
        if event.kind != "period_doubling" or not min_value < event.value < max_value:
            continue
        try:
            yield fc.follow_branch(curve, event, throw=False, most_points=200)
            return
        except fc.ConvergenceError as error:
            yield Finding("branch", case.harmonics, event.value, remark=str(error))


def branches(case: Case) -> Iterator[Finding]:
    """Points of a branch of twice the period."""
    for branch in _branch(case):
        if isinstance(branch, Finding):
            yield branch
            continue
        for place in np.unique(np.linspace(0, len(branch) - 1, 5).astype(int))[1:]:
            verdict = str(branch.verdicts[place])
            yield judge(case, branch.solution(int(place)), "point of a branch", verdict)


def ends(case: Case) -> Iterator[Finding]:
    """Points next to both ends of a branch: its verdicts, and those of ``floquet``."""
    for branch in _branch(case):
        if isinstance(branch, Finding):
            yield branch
            continue
        count = len(branch)
        for place in sorted({1, 2, 3, count - 4, count - 3, count - 2} & set(range(count))):
            solution, verdict = branch.solution(place), str(branch.verdicts[place])
            row = judge(case, solution, "end of a branch", verdict)
            end_verdict = _verdict(solution)
            if {verdict, end_verdict} == {"stable", "unstable"}:
                row.judgement, row.remark = WRONG, f"floquet says {end_verdict}"
            yield row


ASKED = {
    "solution": solutions, "tolerance": tolerances, "whole": wholes, "peak": peaks,
    "curve": curves, "parameter": parameters, "branch": branches, "ends": ends,
    "reduction": reductions,
}  # fmt: skip


# --- the campaign ---------------------------------------------------------------------------------


def main() -> None:
    """Run it, or add up what was found."""
    common.run(
        __doc__,
        {"campaign": campaign},
        cases={"type": int, "default": 1000, "help": "how many"},
        first={"type": int, "default": 0, "help": "number of the first"},
        seed={"type": int, "default": 1, "help": "of the random numbers"},
        family={"choices": list(FAMILIES), "help": "whose cases, instead of all"},
        kind={"choices": KINDS, "help": "what is asked, instead of all"},
        minutes={"type": float, "default": np.inf, "help": "after which no case begins"},
        table={"nargs": "+", "default": [], "help": "files that are added up; nothing is asked"},
        known={"nargs": "+", "default": [], "help": "files whose cases are asked again"},
    )


def campaign(arguments: common.Arguments) -> None:
    """All cases that are not in the file yet."""
    if arguments.table:
        summarise([entry for path in arguments.table for entry in read(Path(path))])
        return
    if arguments.known:
        again(arguments.folder / "campaign_again.jsonl", [Path(path) for path in arguments.known])
        return
    label = "_".join(filter(None, (arguments.family, arguments.kind))) or "all"
    path = arguments.folder / f"campaign_{label}_{arguments.seed}.jsonl"
    cases = read(path)
    done_cases = {entry["case"] for entry in cases}
    count = 20 if arguments.quick else arguments.cases
    begun = time.monotonic()
    with open(path, "a") as file:
        for number in range(arguments.first, arguments.first + count):
            if number in done_cases:
                continue
            if time.monotonic() - begun > 60.0 * arguments.minutes:
                break
            family = arguments.family or family_of(arguments.seed, number)
            cases.append(asked(arguments.seed, number, arguments.kind, family))
            file.write(json.dumps(cases[-1]) + "\n")
            file.flush()
    summarise(cases)


def again(path: Path, files: list[Path]) -> None:
    """All cases of some files that are not in this one yet."""
    cases = read(path)
    done_keys = {key(entry) for entry in cases}
    with open(path, "a") as file:
        for entry in (entry for known in files for entry in read(known)):
            if key(entry) in done_keys:
                continue
            asked_rows = asked(
                entry["seed"], entry["case"], entry["only"], entry["family"], entry["rows"]
            )
            cases.append(asked_rows)
            file.write(json.dumps(asked_rows) + "\n")
            file.flush()
    summarise(cases)


def read(path: Path) -> list[dict]:
    """What an earlier run has found; a line that was not finished is left out."""
    entries = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            entries.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return entries


def asked(
    seed: int,
    number: int,
    kind: str | None = None,
    family: str = "few",
    known: list[dict] | None = None,
) -> dict:
    """A case and what was found, as it is kept; ``known``: what was found before."""
    case = draw(seed, number, kind, family)
    case.known.extend(known or [])
    start_time = time.process_time()
    rows = findings(seed, case)
    return {
        "seed": seed, "case": number, "only": kind, "family": case.family, "kind": case.kind,
        "dofs": case.structure.n_dofs, "pairs": case.structure.n_pairs, "k R": case.product,
        "s": time.process_time() - start_time, "rows": rows,
    }  # fmt: skip


def findings(seed: int, case: Case) -> list[dict]:
    """The rows of a case; an answer that is refused is one too."""
    case_rows: list[Finding] = []
    try:
        with limited(SECONDS):
            for case_row in ASKED[case.kind](case):
                case_rows.append(case_row)
    except TimeoutError:
        case_rows.append(Finding("too long", case.harmonics, case.omega, judgement=TOO_LONG))
    except (fc.ConvergenceError, fc.InputError) as error:
        case_rows.append(Finding("refused", case.harmonics, case.omega, remark=str(error)))
    except Exception as error:  # a campaign has to say what broke, and go on
        name = f"{type(error).__name__}: {error}"
        case_rows.append(Finding("broke", case.harmonics, case.omega, judgement=WRONG, remark=name))
    for case_row in case_rows:
        case_row.remark = case_row.remark.replace("\n", " ")[:200]
    return [asdict(case_row) for case_row in case_rows]


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


# --- the table ------------------------------------------------------------------------------------


COLUMNS = (
    "family", "cases", "answers", WRONG, "true/est 5 %", "50 %", "95 %", "unknown %", "large %",
    "undecided %", "error known %", "stable > 3 pred", "tolerances met", LIMITED, WANDERS,
    UNCONVERGED, TOO_LONG, OPEN, UNCONFIRMED, "ms",
)  # fmt: skip


def summarise(cases: list[dict]) -> None:
    """A line for every family, for the reduction, the peaks and for all; every wrong answer."""
    entry_by_key = {key(entry): entry for entry in cases}  # a case may be in several files
    rows = [row | {"of": entry} for entry in entry_by_key.values() for row in entry["rows"]]
    groups = {name: lambda row, name=name: row["of"]["family"] == name for name in FAMILIES}
    other_rows = [row for row in rows if row["what"] != "reduction"]
    table = [
        line(name, list(filter(group_rows, other_rows))) for name, group_rows in groups.items()
    ]
    table.append(line("peaks", [row for row in rows if row["what"] == "peak"]))
    table.append(line("all", other_rows))
    table.append(line("reduction", [row for row in rows if row["what"] == "reduction"]))
    common.print_table("Campaign", COLUMNS, [entry for entry in table if entry[2]])
    wrong_rows = [row for row in rows if row["judgement"] == WRONG]
    names = ("what", "harmonics", "estimate", "true", "pred", "verdict", "exact", "asked", "remark")
    if wrong_rows:
        common.print_table(
            "Wrong",
            ("seed", "case", "family", "pairs", "k R", *names),
            [
                [row["of"][name] for name in ("seed", "case", "family", "pairs", "k R")]
                + [row[name] for name in names]
                for row in wrong_rows
            ],
        )


def key(case: dict) -> tuple:
    """What a case follows from."""
    return case["seed"], case["family"], case["case"], case["only"]


def line(name: str, rows: list[dict]) -> list[object]:
    """The figures of some answers. Unknown, large and undecided: of those with H given; undecided
    those whose motion is not known to wander, and with an error of at most 10 %, too, where it is
    not the harmonics that are too few."""

    def count(judgement: str, of: list[dict]) -> int:
        return sum(row["judgement"] == judgement for row in of)

    def share(part: int, of: list[dict]) -> str:
        return f"{100.0 * part / len(of):.1f}" if of else "-"

    estimated_rows = [
        row for row in rows if np.isnan(row["asked"]) and not np.isnan(row["estimate"])
    ]
    judged_rows = [row for row in estimated_rows if row["verdict"] not in ("-", NO_VERDICT)]
    undecided_rows = [
        row for row in judged_rows if row["verdict"] == "undecided" and row["judgement"] != WANDERS
    ]
    tolerance_rows = [
        row
        for row in rows
        if not np.isnan(row["asked"]) and row["judgement"] not in (LIMITED, WANDERS)
    ]
    n_met = sum(row["true"] <= row["asked"] for row in tolerance_rows if row["judgement"] == RIGHT)
    stable = [row for row in rows if row["verdict"] == "stable" and row["true"] > ROUNDING]
    ratios = [
        row["true"] / row["estimate"]
        for row in rows
        if row["estimate"] <= LARGE and row["true"] > ROUNDING
    ]
    lower_quantile, middle, upper_quantile = (
        np.quantile(ratios, (0.05, 0.5, 0.95)) if ratios else (np.nan,) * 3
    )
    times = [row["seconds"] for row in rows if not np.isnan(row["seconds"])]
    return [
        name, len({key(row["of"]) for row in rows}),
        len(rows), count(WRONG, rows),
        f"{lower_quantile:.2f}", f"{middle:.2f}", f"{upper_quantile:.2f}",
        share(sum(row["estimate"] >= UNKNOWN for row in estimated_rows), estimated_rows),
        share(sum(LARGE < row["estimate"] < UNKNOWN for row in estimated_rows), estimated_rows),
        share(len(undecided_rows), judged_rows),
        share(sum(row["estimate"] <= LARGE for row in undecided_rows), judged_rows),
        sum(row["true"] > TIMES * row["pred"] for row in stable),
        f"{n_met} of {len(tolerance_rows)}", count(LIMITED, rows), count(WANDERS, rows),
        count(UNCONVERGED, rows), count(TOO_LONG, rows), count(OPEN, rows),
        count(UNCONFIRMED, rows),
        f"{1e3 * np.median(times):.0f}" if times else "-",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
