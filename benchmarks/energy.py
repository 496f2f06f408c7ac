"""Energy that impacts send into high modes: where it goes, and what it makes of the modes' error.

``bound``: twenty random plates near a resonance, one in four with friction, all modes with the same
damping ratio. Printed for 20, 40, 80 and 160 modes: the amplitude, and the shares of the load's
work that near and far modes and friction take; then by how much doubling the modes changes the
share of modes below 2 to 10 times the load's frequency.

``hard``: two plates that rigid contact and a constant ratio keep from converging, with 10 to 120
modes: amplitude and opening, their stated errors, and the true ones. The truth is the orbit with
400 modes, or with most for which one is found, printed with its change from fewer.

``drawn``: ten plates as in ``bound``, with 20 modes, and ten whose damping rises with frequency,
with 40; answers that are stable alone. True over stated error of amplitude and opening; the truth
is the orbit with eight, or four, times the modes, printed with its last change.
``--seed`` draws others.

    OMP_NUM_THREADS=1 python benchmarks/energy.py [--quick] [--only PART] [--seed N] [folder]
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.balance.harmonic_balance import search_orbit_by_harmonic_balance

PLATE = Path(__file__).with_name("plate.toml")
RATIOS = (2.0, 3.0, 5.0, 7.0, 10.0)
"""Frequencies of a bound over the load's."""
MODES_ALONE = {
    "mesh.error": False, "curve": None, "sweep": None, "harmonic_balance.tolerance": None,
    "harmonic_balance.harmonics": 20,
}  # fmt: skip
HARD: dict[str, dict[str, Any]] = {
    "friction": {"damping.ratio": 0.005, "damping.stiffness": None},
    "breathing_plate": {
        "damping.ratio": 0.001, "damping.modes": 50, "damping.stiffness": None, "loads": None,
        "excitation.point": [0.1, 0.1], "excitation.force_sin": [100.0, 0.0],
        "contact.friction_error": False,
    },
}  # fmt: skip
"""Demos as they were, with the same damping ratio in all modes."""


def main() -> None:
    """Run the parts asked for."""
    seed = {"type": int, "default": 5, "help": "of the random plates"}
    common.run(__doc__, {"bound": run_bound, "hard": run_hard, "drawn": run_drawn}, seed=seed)


def random_plate(rng: np.random.Generator, number: int, *, rising: bool) -> fc.Scene:
    """A plate with an edge crack and a load along its top, near its first or second resonance.

    Every fourth one is the plate with an inclined crack, whose faces rub.
    """
    rubs = number % 4 == 3
    ratio = float(10.0 ** rng.uniform(-3.0, -2.2))
    if rubs:
        scene = fc.Scene.load(common.DEMOS / "friction.toml")
        changes: dict[str, Any] = {"contact.friction": rng.uniform(0.1, 0.6)}
    else:
        scene = fc.Scene.load(PLATE)
        width = float(10.0 ** rng.uniform(-1.5, -0.9))
        height = width * rng.uniform(1.3, 5.0)
        changes = {
            "geometry.width": width, "geometry.height": height, "geometry.thickness": 0.05 * width,
            "crack.length": width * rng.uniform(0.15, 0.5),
            "crack.height": height * rng.uniform(0.1, 0.6),
            "mesh.size": width / 8.0, "mesh.lip_elements": int(rng.integers(4, 9)),
            "excitation.point": None, "excitation.force_sin": [0.0, 0.0], "loads.1.edge": "top",
            "loads.1.traction_sin": [1000.0 * rng.normal(), 300.0 * rng.normal()],
            "output.points": {"far": [width, height]}, "contact.friction_error": False,
        }  # fmt: skip
    damping = {"damping.ratio": ratio, "damping.modes": "all", "damping.stiffness": None}
    scene = scene.replace(MODES_ALONE | {"reduction.modes": 20} | damping | changes)
    mode, detuning = int(rng.integers(2)), ratio * rng.uniform(-2.0, 2.0)
    omegas = fc.bilinear_frequencies(fc.prepare(scene).structure).omega_bilinear
    omega = float(omegas[mode] * (1.0 + detuning))
    scene = scene.replace({"excitation.omega": omega})
    if rising:
        scene = scene.replace({"damping.ratio": None, "damping.stiffness": 2.0 * ratio / omega})
    return scene


def orbits_of(
    scene: fc.Scene, counts: tuple[int, ...], orbit: fc.PeriodicOrbit | None = None
) -> list[fc.PeriodicOrbit]:
    """Return the exact orbits with more and more modes, each sought from the last one found."""
    orbits = [] if orbit is None else [orbit]
    for count in counts:
        study = fc.prepare(scene.replace({"reduction.modes": count}))
        assert study.contact is not None
        if orbits:
            with suppress(AssertionError):  # none was found
                orbits.append(common.with_more_modes(orbits[-1], study))
        else:
            problem = fc.Problem(study.structure, scene.excitation.omega, study.contact, 20)
            found = search_orbit_by_harmonic_balance(problem).orbit
            orbits += [] if found is None else [found]
    return orbits


def run_bound(arguments: common.Arguments) -> None:
    """Shares of the energy in twenty plates."""
    rows: list[common.Row] = []
    changes: dict[float, list[float]] = {ratio: [] for ratio in RATIOS}
    for number in range(3 if arguments.quick else 20):
        rng = np.random.default_rng([arguments.seed, number])
        below = []
        try:
            scene = random_plate(rng, number, rising=False)
            dof = fc.prepare(scene).watched[0].dof
            for orbit in orbits_of(scene, (20, 40) if arguments.quick else (20, 40, 80, 160)):
                budget = orbit.energy_budget
                shares = budget.shares
                modulus = abs(orbit.multipliers[0]) if orbit.flow.n_modes <= 80 else np.nan
                rows.append((number, orbit.flow.n_modes, orbit.amplitude(dof), modulus,
                             shares["near_share"], shares["far_share"],
                             shares.get("rub_share", 0.0), budget.power_factor))  # fmt: skip
                bounds = np.array(RATIOS)[:, None] * orbit.omega
                below.append((budget.omega <= bounds) @ budget.damping / budget.load)
        except (AssertionError, fc.ConvergenceError) as error:
            print(f"{number}: no orbit {error}")
        for few, many in pairwise(below):
            for ratio, change in zip(RATIOS, np.abs(many - few), strict=True):
                changes[ratio].append(float(change))
    columns = ("plate", "modes", "amplitude [m]", "modulus", "near", "far", "friction", "W / S")
    common.save_table(arguments.folder / "energy_bound.csv", "Shares", columns, rows)
    for ratio, values in changes.items():
        print(f"below {ratio:g} times the load: change of the share by twice the modes: "
              f"median {np.median(values):.3f}, largest {max(values):.3f}")  # fmt: skip


def compare(
    run: fc.Run[fc.PeriodicSolution], orbit: fc.PeriodicOrbit, previous: fc.PeriodicOrbit
) -> Iterator[tuple[str, float, float, float, float, float]]:
    """Quantity, value, true and stated error, their ratio, and the truth's last change."""
    assert run.errors is not None
    point = run.watched[0]
    for name in (point.column_name("amplitude"), "opening"):
        value = run.errors.values[name]
        truth, before = (
            one.face_indicators["opening"] if name == "opening" else one.amplitude(point.dof)
            for one in (orbit, previous)
        )
        stated = run.errors.stated(name)[0]
        true = abs(truth / value - 1.0)
        yield name, value, true, stated, true / stated, abs(before / truth - 1.0)


COLUMNS = ("quantity", "value", "true", "stated", "true / stated", "truth's change", "verdict")


def run_hard(arguments: common.Arguments) -> None:
    """The hard cases with more and more modes."""
    rows: list[common.Row] = []
    for demo, changes in HARD.items():
        scene = fc.Scene.load(common.DEMOS / f"{demo}.toml").replace(MODES_ALONE | changes)
        if scene.crack is not None and scene.crack.first_omega is not None:
            length = fc.find_crack_length(scene)
            scene = scene.replace({"crack.length": length, "crack.first_omega": None})
        counts = (10, 20, 40) if arguments.quick else (10, 20, 40, 80, 160, 240, 320, 400)
        orbits = orbits_of(scene, counts)
        for orbit in orbits:
            far_share = orbit.energy_budget.shares["far_share"]
            print(
                demo, f"{orbit.flow.n_modes} modes: {orbit.amplitude():.4g} m, far {far_share:.3f}"
            )
        *_, previous, truth = orbits
        print(demo, [orbit.flow.n_modes for orbit in (previous, truth)])
        for count in (10, 20) if arguments.quick else (10, 20, 40, 80, 120):
            run = fc.solve(scene.replace({"reduction.modes": count}))
            stability = run.result.stability
            verdict = "-" if stability is None else stability.verdict
            rows += [(demo, count, *row, verdict) for row in compare(run, truth, previous)]
            print(rows[-2:], flush=True)
    common.save_table(
        arguments.folder / "energy_hard.csv", "Hard cases", ("demo", "modes", *COLUMNS), rows
    )


def run_drawn(arguments: common.Arguments) -> None:
    """Ten plates with the same ratio in all modes, and ten whose damping rises."""
    for rising, count in ((False, 20), (True, 40)):
        rows: list[common.Row] = []
        number = n_judged = 0
        while n_judged < (2 if arguments.quick else 10):
            rng = np.random.default_rng([arguments.seed, 100 + rising, number])
            name, number = f"{'rising' if rising else 'constant'} {number}", number + 1
            scene = random_plate(rng, number, rising=rising)
            try:
                run = fc.solve(scene.replace({"reduction.modes": count}))
                stability, orbit = run.result.stability, run.result.assessment.nearest_orbit
                assert run.errors is not None
                is_stable = stability is not None and stability.verdict == "stable"
                if not is_stable or orbit is None or "modes" not in run.errors.parts:
                    print(f"{name}: {stability}; {run.errors.unknown}")
                    continue
                *_, previous, truth = orbits_of(scene, (40, 80, 160)[rising:], orbit)
                assert truth.flow.n_modes == 160
                rows += [(name, count, *row, stability.verdict)
                         for row in compare(run, truth, previous)]  # fmt: skip
                n_judged += 1
            except (AssertionError, fc.ConvergenceError) as error:
                print(f"{name}: no orbit {error}")
        kind = "rising" if rising else "constant"
        common.save_table(
            arguments.folder / f"energy_{kind}.csv", kind, ("scene", "modes", *COLUMNS), rows
        )
        ratios, errors = (np.array([row[k] for row in rows]) for k in (6, 4))
        print(f"true / stated: median {np.median(ratios):.2f}, largest {ratios.max():.2f}; "
              f"true errors of amplitudes within 2 %: {np.sum(errors[::2] <= 0.02)}")  # fmt: skip


if __name__ == "__main__":
    main()
