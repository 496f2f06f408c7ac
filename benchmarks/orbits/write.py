"""Write the cases of the benchmark of exact orbits with their references.

The published cases (published.json), those drawn for it (drawn.json) and plates are solved by the
product's exact flow (smoothed laws by DOP853 on benchmarks/reference_flow.py), from rest, from
random states and from harmonic balance, with periods of one to three of the load. Every orbit is
followed over one period by the second reference (second.py; above 20 pairs reference_flow.py). A
case whose references differ by more than the limit of check.py is not written, and said.

    OMP_NUM_THREADS=1 python benchmarks/orbits/write.py [NAME ...]
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
import check
import reference_flow
from second import INSTANTS

import fenics_crack as fc
from fenics_crack.motion.flow import exact_flow_or_error
from fenics_crack.motion.orbit import find_orbit
from fenics_crack.motion.search import series_states_at_period_parts

OWN = {"citation": "drawn for this benchmark", "changed": "", "licence": "CC0-1.0"}
HERE = Path(__file__).parent
STARTS, SETTLED, MOST, HARMONICS = 20, 150, 6, 20
"""Random states; periods from rest; orbits kept; harmonics of |g_k|."""


# --- cases ----------------------------------------------------------------------------------------


def reduced(
    name: str, title: str, structure: fc.Structure, law: Any, omega: float
) -> dict[str, Any]:
    """A case by its modes, of a reduced structure of the package whose pairs have no mass."""
    flow = exact_flow_or_error(structure, law)
    stiffness = np.broadcast_to(np.asarray(law.stiffness, float), structure.n_pairs)
    return {
        "format": 1, "name": name, "title": title, "source": OWN,
        "structure": {
            "form": "modes", "squares": flow.modal_model.squares.tolist(),
            "damping": flow.modal_model.damping.tolist(),
            "pairs": flow.modal_model.gaps_by_mode.tolist(),
            "flexibility": flow.residual_flexibility.tolist(),
            "lift": (
                flow.massless_load_gap_less_clearance
                + np.eye(len(flow.massless_load_gap_less_clearance), 1) * flow.clearance
            ).tolist(),
        },
        "load": {
            "omega": omega, "mean": flow.modal_load[0].tolist(),
            "cos": flow.modal_load[1::2].tolist(), "sin": flow.modal_load[2::2].tolist(),
        },
        "law": {
            "kind": "rigid" if np.all(np.isinf(stiffness)) else "penalty",
            "stiffness": [float(k) if np.isfinite(k) else None for k in stiffness],
        },
        "clearance": np.broadcast_to(flow.clearance, structure.n_pairs).tolist(),
    }  # fmt: skip


PLATES = {
    # name: elements along the faces, modes, damping ratio, share of the first frequency, k [N/m]
    "plate-5": (5, 10, 0.01, 1.05, None), "plate-8": (8, 12, 0.005, 0.5, None),
    "plate-10": (10, 16, 0.002, 1.03, None), "plate-10-third": (10, 16, 0.01, 0.34, None),
    "plate-5-penalty": (5, 10, 0.01, 1.05, 1e9), "plate-8-soft": (8, 12, 0.01, 1.0, 1e8),
    "plate-10-above": (10, 16, 0.005, 2.2, None), "plate-50": (50, 20, 0.01, 1.04, None),
    "plate-150": (150, 20, 0.01, 1.04, None),
}  # fmt: skip


def plate(name: str) -> tuple[dict[str, Any], fc.Structure, Any]:
    """A cracked plate in its modes; its structure and law."""
    lips, modes, ratio, share, k = PLATES[name]
    changes = {"mesh.lip_elements": lips, "damping.ratio": ratio, "crack.length": 0.04}
    scene = fc.Scene.load(HERE.parent / "plate.toml").replace(changes)
    structure = fc.reduce_structure(fc.build_structure(scene), modes=modes, method="massless")
    law = fc.UnilateralConstraint() if k is None else fc.UnilateralPenalty(k)
    omega = float(share * structure.omega[0])
    words = "rigid pairs" if k is None else f"pairs of {k:.0e} N/m"
    title = f"cracked plate, {structure.n_pairs} {words} without mass, {modes} modes"
    return reduced(name, title, structure, law, omega), structure, law


def built(case: dict[str, Any]) -> tuple[fc.Structure, Any]:
    """The package's structure and law of a case by matrices."""
    parts, load, law = case["structure"], case["load"], case["law"]
    tangents = parts.get("tangents")
    structure = fc.Structure.from_matrices(
        np.array(parts["mass"]), np.array(parts["stiffness"]), gap=np.array(parts["pairs"]),
        force_mean=np.array(load["mean"]), force_cos=np.array(load["cos"]).T,
        force_sin=np.array(load["sin"]).T, clearance=np.array(case["clearance"]),
        damping=np.array(parts["damping"]),
        tangential=None if tangents is None else np.array(tangents),
    )  # fmt: skip
    normal: Any = fc.UnilateralPenalty(law["stiffness"])
    if law["kind"] == "smoothed":
        normal = fc.SmoothedPenalty(law["stiffness"], law["sharpness"])
    if law["kind"] == "friction":
        normal = fc.CoulombFriction(normal, law["coefficient"], law["tangential_stiffness"])
    return structure, normal


# --- references -----------------------------------------------------------------------------------


def starts(
    flow: Any, structure: fc.Structure, law: Any, omega: float, few: bool
) -> list[np.ndarray]:
    """States from which orbits are sought: harmonic balance, rest followed, random ones."""
    start_states, period, random = [], 2.0 * np.pi / omega, np.random.default_rng(87)
    try:
        solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=20, throw=False)
        start_states.append(
            series_states_at_period_parts(flow, solution.displacement_coefficients, omega)[0]
        )
    except Exception as error:  # another start does
        print("  harmonic balance:", error)
    state = np.array(flow.rest_state, float)
    try:
        for number in range(20 if few else SETTLED):
            state = flow.advance(state, omega, period).state
            if number > (10 if few else SETTLED - 4):
                start_states.append(state)
    except fc.ConvergenceError as error:
        print("  from rest:", error)
    size = flow.energy_weights(omega)
    scale = max((float(np.linalg.norm(size * one)) for one in start_states), default=1.0)
    for _ in range(2 if few else STARTS):
        one = random.normal(size=len(start_states[0])) / size
        one *= random.uniform(0.2, 3.0) * scale / np.linalg.norm(size * one)
        start_states.append(one)
        try:
            for _ in range(8):
                one = flow.advance(one, omega, period).state
            start_states.append(one)
        except fc.ConvergenceError:
            continue
    return start_states


def exact_orbits(case: dict[str, Any], structure: fc.Structure, law: Any) -> list[dict[str, Any]]:
    """All orbits found by the exact flow, the largest motion first."""
    flow, omega = exact_flow_or_error(structure, law), case["load"]["omega"]
    orbits, seen = [], []
    count = flow.n_modes
    for state in starts(flow, structure, law, omega, structure.n_pairs > 3):
        for periods in (1,) if structure.n_pairs > 3 else (1, 2, 3):
            orbit = find_orbit(flow, omega, state, subharmonic=periods, step_tolerance=1e-13)
            if orbit is None or orbit.residual > 1e-9:
                continue
            state_now, passed = orbit.state, []
            for _ in range(periods):
                passed.append(state_now[: 2 * count])
                state_now = flow.advance(state_now, omega, 2.0 * np.pi / omega).state
            size = np.linalg.norm(passed[0])
            if any(np.linalg.norm(one - passed[0]) < 1e-6 * size for one in passed[1:]):
                continue
            if any(np.linalg.norm(one - passed[0]) < 1e-5 * size for one in seen):
                continue
            if (
                flow.friction_law
                and len(orbit.always_stuck_pair_indices)
                and any(len(one.always_stuck_pair_indices) for one in orbits)
            ):
                continue  # another one of the same continuum
            seen += passed
            orbits.append(orbit)
    orbits.sort(key=lambda orbit: (orbit.subharmonic, -np.ptp(orbit.gap, axis=0).max()))
    return [facts(case, flow, orbit) for orbit in orbits[:MOST]]


def facts(case: dict[str, Any], flow: Any, orbit: Any) -> dict[str, Any]:
    """What is stored of an orbit of the exact flow."""
    count, state = flow.n_modes, orbit.state
    if case["structure"]["form"] == "matrices":
        shapes = flow.modal_model.shapes
        state = np.concatenate(
            [shapes @ state[:count], shapes @ state[count : 2 * count], state[2 * count :]]
        )
    work = orbit.energy_budget
    gap = orbit.gap_at(orbit.period * np.arange(INSTANTS) / INSTANTS)
    loss = float(work.damping.sum() + work.friction.sum())
    waves = orbit.coefficients(HARMONICS).gap[:, : gap.shape[1]]
    stored_orbit = stored(
        case, orbit.subharmonic, state, gap, loss, orbit.multipliers, orbit.n_events, waves
    )
    if flow.friction_law:
        slide = orbit.tangential_gap_at(orbit.period * np.arange(INSTANTS) / INSTANTS)
        stored_orbit["tangential_gap"], stored_orbit["stuck"] = (
            rounded(slide),
            orbit.always_stuck_pair_indices.tolist(),
        )
    elif case["structure"]["form"] == "matrices":
        sets, ends = orbit.motion.track.sets > 0, np.cumsum(orbit.motion.track.lengths)
        stored_orbit["first"] = sets[0].tolist()
        stored_orbit["crossings"] = [
            [float(ends[i]), int(j)]
            for i in range(len(sets) - 1) for j in np.flatnonzero(sets[i] != sets[i + 1])
        ]  # fmt: skip
    return stored_orbit


def stored(case: dict[str, Any], periods: int, state: np.ndarray, gap: np.ndarray, loss: float,
           multipliers: np.ndarray, events: int, waves: Any) -> dict[str, Any]:  # fmt: skip
    """The numbers of an orbit as its file has them."""
    if waves is None:
        spectrum = np.fft.rfft(gap, axis=0)[: HARMONICS + 1] / len(gap)
        harmonics = np.abs(spectrum) * np.r_[1.0, np.full(HARMONICS, 2.0)][:, None]
    else:
        harmonics = np.vstack([np.abs(waves[:1]), np.hypot(waves[1::2], waves[2::2])])
    leading_multipliers = sorted(multipliers, key=lambda one: (-abs(one), one.imag))[:6]
    largest_size = abs(leading_multipliers[0])
    verdict = (
        "undecided"
        if abs(largest_size - 1.0) < 1e-6
        else "stable"
        if largest_size < 1
        else "unstable"
    )
    return {
        "subharmonic": periods, "state": state.tolist(), "gap": rounded(gap),
        "harmonics": rounded(harmonics), "least": gap.min(axis=0).tolist(),
        "most": gap.max(axis=0).tolist(), "loss": float(loss), "events": int(events),
        "multipliers": [[float(multiplier.real), float(multiplier.imag)]
                        for multiplier in leading_multipliers],
        "verdict": verdict,
    }  # fmt: skip


def rounded(values: np.ndarray) -> list[Any]:
    """Numbers to 1e-12 of the largest."""
    digits = int(12 - np.floor(np.log10(np.abs(values).max())))
    return np.round(values, digits).tolist()


def smooth_orbits(case: dict[str, Any], structure: fc.Structure, law: Any) -> list[dict[str, Any]]:
    """That of a smoothed law which harmonic balance leads to, by DOP853 in modal coordinates."""
    omega = case["load"]["omega"]
    flow = reference_flow.SmoothFlow(structure, law)
    solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=30, throw=False)
    period, n = 2.0 * np.pi / omega, structure.n_dofs
    orbit = flow.orbit(flow.states_of(solution, np.zeros(1))[0], omega, period)
    shapes = np.linalg.inv(flow.system.rows)
    state = np.append(shapes @ orbit.state[:n] / flow.scale, shapes @ orbit.state[n:])
    rates = orbit.state[n:]
    n_instants = 4096
    times = np.append(period * np.arange(n_instants) / n_instants, period)
    motion = flow._integrated(orbit.state[:, None], omega, 0.0, times)[:-1, :, 0]
    rates = motion[:, n:]
    loss = period / n_instants * float(np.einsum("ti,ij,tj", rates, flow.system.damping, rates))
    return [stored(case, 1, state, orbit.gap[::2], loss, orbit.multipliers, 0, None)]


def finished(case: dict[str, Any], structure: fc.Structure, law: Any) -> dict[str, Any]:
    """A case with its references and its hash."""
    is_smooth = case["law"]["kind"] == "smoothed"
    orbits = (smooth_orbits if is_smooth else exact_orbits)(case, structure, law)
    methods = [
        "DOP853 in modal coordinates" if is_smooth else "exact flow of fenics_crack, shooting"
    ]
    has_many_pairs = structure.n_pairs > 20
    if has_many_pairs:
        methods.append("reference_flow.py, one period from the state of the first")
    else:
        methods.append(
            "Radau, one period" if is_smooth else "DOP853 from event to event, one period"
        )
    for orbit in orbits:
        if has_many_pairs:
            flow = reference_flow.ReferenceFlow(structure, law)
            start = np.array(orbit["state"])
            start[: len(start) // 2] *= flow.scale
            signs = np.sign(
                np.sum(flow.system.pairs * np.array(case["structure"]["pairs"]), axis=1)
            )
            start *= np.tile(signs, 2)
            passage = flow.advance(
                start, case["load"]["omega"], 0.0, 2.0 * np.pi / case["load"]["omega"], INSTANTS
            )
            passage_arrays = {"gap": passage.gap, "state": passage.state, "start": start}
            orbit["agreement"] = check.apart(orbit, passage_arrays)
        else:
            orbit["agreement"] = check.second_reference(case, orbit)
    return check.sealed(case | {"references": methods, "orbits": orbits})


def main() -> None:
    """Write the cases named, by default all."""
    given_cases = [
        json.loads((HERE / name).read_text()) for name in ("published.json", "drawn.json")
    ]
    built_cases = [(case, *built(case)) for cases in given_cases for case in cases]
    wanted_names = sys.argv[1:]
    names = [case["name"] for case, *_ in built_cases] + list(PLATES)
    (HERE / "cases").mkdir(exist_ok=True)
    lookup = {case["name"]: (case, structure, law) for case, structure, law in built_cases}
    for name in wanted_names or names:
        begin = time.process_time()
        try:
            case, structure, law = lookup[name] if name in lookup else plate(name)
            finished_case = finished(case, structure, law)
        except Exception as error:
            print(f"{name:20} FAILED {type(error).__name__}: {error}", flush=True)
            continue
        orbits = finished_case["orbits"]
        worst_agreement = max((orbit["agreement"] for orbit in orbits), default=np.inf)
        say = [
            f"{orbit['subharmonic']}:{orbit['verdict'][0]}{abs(complex(*orbit['multipliers'][0])):.4f}/{orbit['events']}"
            for orbit in orbits
        ]
        is_good = worst_agreement <= check.limit(finished_case)
        if is_good:
            (HERE / "cases" / f"{name}.json").write_text(
                json.dumps(finished_case, separators=(",", ":")) + "\n"
            )
        word, seconds = "ok " if is_good else "NOT", time.process_time() - begin
        print(
            f"{name:20} {word} {worst_agreement:.1e} {seconds:6.1f} s  {' '.join(say)}", flush=True
        )


if __name__ == "__main__":
    main()
