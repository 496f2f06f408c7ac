"""Mesh, modes, harmonics and samples of a scene made finer, one at a time.

Each number of the answer is extrapolated with the order that it shows (:mod:`grid_convergence`).
The uncertainty is that of the scene's own choice, the coarsest of the three: coarser meshes mostly
are not in the asymptotic range. Contributions are put together as the root of the sum of their
squares, if they are independent, and as their sum, if they are not.

Orders of theory: at the tip of a crack displacements are like r^(1/2), so frequencies and work
converge like h with elements of both orders, on equal cells and on cells graded by a fixed ratio
alike (Strang and Fix, An Analysis of the Finite Element Method, 1973, chapter 8); at the ends of a
clamp like h^(3/2) (Williams' equation for a right angle with one side held, nu = 0.3, plane stress:
1.52). Modes in a plane have w_j^2 proportional to j, and each that is left out contributes
w^2 / w_j^4, which sums up to N^-1. Where lips hit each other velocities jump: |U_k| falls like k^-2
and what is left out like H^-1, often faster (H^-3 where only forces have kinks), which is not
relied on. Samples of a force with kinks err like N^-2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import MAX_SAMPLES, ConvergenceError, InputError
from fenics_crack.model.contact import is_unilateral
from fenics_crack.model.modes import solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.scene.quantities import OF_LIPS, OF_POINTS, QUANTITIES
from fenics_crack.scene.scene import Scene
from fenics_crack.stages import within
from fenics_crack.study.grid_convergence import LEAST_ORDER, GridConvergence, grid_convergence
from fenics_crack.study.prepare import Study, modes_of, prepare, reduction_of
from fenics_crack.study.run import REFUSALS, Run, solve_prepared
from fenics_crack.table import Table, Tabular, frequency_axis, with_unit

__all__ = ["CAUSES", "Verification", "finer_mesh", "verify"]

CAUSES = ("mesh", "modes", "harmonics", "samples")
SHOWN, LEAST = 0.1, 1e-3
"""Shares of its total, and of a value, from which on a doubtful contribution is told."""
SPREAD = "not in the asymptotic range, 3 times the spread is taken"
DOUBTS = {
    "outside": "the observed order is not near that of theory, a factor of 3 is taken",
    "two sizes": "two runs show no order, that of theory and a factor of 3 are taken",
    "oscillating": f"values oscillate, {SPREAD}",
    "diverging": f"values come no closer, {SPREAD}",
    "irregular": f"values come closer faster than by any order of theory, {SPREAD}",
}
"""What is said of each behaviour of :class:`GridConvergence` but "asymptotic"."""


ANSWER = ("amplitude", "ratio_2_1", "ratio_3_1", "mean_shift", "opening", "closed_share")
"""Quantities that are looked at where the scene does not choose."""
FREQUENCIES = 3
"""Natural ones, lips open."""
GRADED, GRID, COUNTS = (1.5, 2.0), (2.0, 3.0), (1, 2, 4)
"""How much finer graded meshes and grids are taken, and numbers of something."""
EVEN = 1.56
"""Elements along a lip after a refinement by 1.5, at most, relative to those before: with more, by
rounding up, the mesh would be of another kind."""
TIP, CLAMP = 1.0, 1.5
"""Orders with a crack and without one."""
TINY = 1e-9
"""A ratio that is none."""
OWN = "the scene's own choice"


# --- the result -----------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Verification(Tabular):
    """What contributes to the error of a scene's answer.

    Attributes
    ----------
    scene : Scene
        With all that was chosen for it: length of the crack, modes, harmonics.
    values, units : dict of str to float, and to str
        The scene's own answer by its quantities, as ``[output] quantities`` names them, with those
        of named points as "tip.ux.amplitude"; "frequency_open_1" [Hz] or "omega_open_1" [rad/s] are
        natural frequencies with lips open.
    parts : dict of str to dict of str to GridConvergence
        By the cause, "mesh", "modes", "harmonics" or "samples", and the quantity. Sizes are the
        side of a mean element [m], and one over the number of modes, harmonics or samples; the
        last value is that of the scene's own choice.
    counts : dict of str to tuple of int
        The numbers of elements, modes, harmonics or samples, the scene's own first.
    absent : dict of str to str
        Causes that contribute nothing, and why.
    unknown : dict of str to str
        Causes whose contribution is not known, and why: no total has it.
    failures : tuple of str
        Runs that were refused or did not converge.
    verdicts : dict of str to str
        Of the stability, by the run, where an orbit is not known to be stable.
    """

    scene: Scene
    values: dict[str, float]
    units: dict[str, str]
    parts: dict[str, dict[str, GridConvergence]]
    counts: dict[str, tuple[int, ...]]
    absent: dict[str, str]
    unknown: dict[str, str]
    failures: tuple[str, ...]
    verdicts: dict[str, str]

    KIND: ClassVar[str] = "verification"

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes that were varied."""
        return tuple(self.parts)

    def contributions(self, quantity: str) -> dict[str, float]:
        """Uncertainty of a quantity by each cause that was varied, in its unit.

        Raises
        ------
        InputError
            There is no such quantity.
        """
        if quantity not in self.values:
            raise InputError("quantity", quantity, "one of " + ", ".join(map(repr, self.values)))
        return {cause: found[quantity].uncertainty(-1) for cause, found in self.parts.items()}

    def total(self, quantity: str, *, independent: bool = True) -> float:
        """Root of the sum of squares of the contributions to a quantity, or their sum."""
        found = self.contributions(quantity).values()
        return math.hypot(*found) if independent else sum(found)

    def extrapolated(self, quantity: str) -> float:
        """The value with the corrections by all causes in the asymptotic range."""
        own = self.values[quantity]
        parts = (found[quantity] for found in self.parts.values())
        return own + sum(part.extrapolated - own for part in parts if part.is_asymptotic)

    def relative(self, quantity: str, error: float) -> float:
        """An error over the size of a quantity; nan where that is 0."""
        value = self.values[quantity]
        return error / abs(value) if value else math.nan

    # --- tables -----------------------------------------------------------------------------------

    def totals(self) -> Table:
        """A row for each quantity: value, contributions and totals relative to it in per cent, to
        three digits, the observed order of the mesh, and the extrapolated value."""
        rows = []
        for name, value in self.values.items():
            errors = [*self.contributions(name).values()]
            errors += [self.total(name), self.total(name, independent=False)]
            shares = [float(f"{100.0 * self.relative(name, error):.3g}") for error in errors]
            order = self.parts["mesh"][name].order if "mesh" in self.parts else math.nan
            quantity = with_unit(name, self.units[name])
            rows.append([quantity, value, *shares, round(order, 2), self.extrapolated(name)])
        columns = [f"{what} [%]" for what in (*self.causes, "total", "sum")]
        return Table(["quantity", "value", *columns, "order in h", "extrapolated"], rows)

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for each quantity and cause, and for its totals: what was varied, the
        three values, what follows from them, and the uncertainty of the first."""
        rows = [row for name in self.values for row in self._rows(name)]
        keys = dict.fromkeys(key for row in rows for key in row)
        return {key: [row.get(key, math.nan) for row in rows] for key in keys}

    def _rows(self, name: str) -> Iterator[dict[str, Any]]:
        shared = {"quantity": name, "unit": self.units[name]}
        for cause, found in self.parts.items():
            part, counts = found[name], self.counts[cause]
            row: dict[str, Any] = shared | {"cause": cause, "behaviour": part.behaviour}
            row |= {f"count_{n + 1}": math.nan for n in range(len(COUNTS))}
            row |= {f"count_{n}": count for n, count in enumerate(counts, 1)}
            row |= {f"value_{n + 1}": math.nan for n in range(len(COUNTS))}
            row |= {f"value_{n}": value for n, value in enumerate(part.values[::-1], 1)}
            row |= {key: getattr(part, key) for key in ("order", "exponent", "factor")}
            yield row | {
                "extrapolated": part.extrapolated,
                "gci_finest": part.gci,
                **self._error(name, part.uncertainty(-1)),
            }
        for cause, independent in (("total", True), ("sum", False)):
            known = {"value_1": self.values[name], "extrapolated": self.extrapolated(name)}
            total = self._error(name, self.total(name, independent=independent))
            yield shared | {"cause": cause, "behaviour": ""} | known | total

    def _error(self, name: str, error: float) -> dict[str, float]:
        return {"uncertainty": error, "relative": self.relative(name, error)}

    def _units(self) -> dict[str, str]:
        return {}

    def _title(self) -> str:
        return self.statement[0]

    # --- words ------------------------------------------------------------------------------------

    @property
    def statement(self) -> tuple[str, ...]:
        """What was found, in sentences; what is not known and what is doubtful among them."""
        first = next(iter(self.values))
        shares = {name: self.relative(name, self.total(name)) for name in self.values}
        worst = max(shares, key=lambda name: shares[name])
        told = [self._in_words(first)]
        if worst != first:
            told.append(f"largest of all: {self._in_words(worst)}")
        told += [f"{cause}, no contribution: {why}" for cause, why in self.absent.items()]
        return (*told, *self.warnings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the sentences that doubt the numbers."""
        found = [
            f"{cause} not varied, so it is missing in the totals: {why}"
            for cause, why in self.unknown.items()
        ]
        found += [f"failed, {text}" for text in self.failures]
        found += [f"the orbit with {run} is {verdict}" for run, verdict in self.verdicts.items()]
        for cause, parts in self.parts.items():
            for kind, what in DOUBTS.items():
                names = [n for n, p in parts.items() if p.behaviour == kind and self._matters(n, p)]
                if names:
                    found.append(f"{cause}, {', '.join(names)}: {what}")
        mesh, contact = self.parts.get("mesh", {}), self.scene.contact
        if "amplitude" in mesh and mesh["amplitude"].order < LEAST_ORDER and self._under_a_force:
            found.append(
                "amplitude: under a force at a point the displacement has no limit, it grows like "
                "log(1/h); watch another place (output.points), or load an edge (loads)"
            )
        if "mesh" in self.parts and contact is not None and contact.stiffness is not None:
            found.append(
                "contact.stiffness is that of a pair, of which a finer mesh has more: the mesh "
                "changes the law, too; contact.stiffness_per_area stays the same law"
            )
        return tuple(found)

    @property
    def _under_a_force(self) -> bool:
        """Whether what is watched is where a force acts at a point."""
        scene = self.scene
        if scene.output is not None and scene.output.points:
            return False
        first = scene.loads[0].point if scene.loads else None
        return bool(scene.excitation.force_given) or first is not None

    def _matters(self, name: str, part: GridConvergence) -> bool:
        """Whether a contribution is so large that a doubt of it is told."""
        size = max(SHOWN * self.total(name), LEAST * abs(self.values[name]))
        return part.uncertainty(-1) >= size

    def _in_words(self, name: str) -> str:
        """A quantity with its uncertainty, and where most of that is from."""
        parts = self.contributions(name)
        text = f"{name} = {self.values[name]:.5g} {self.units[name]}".rstrip()
        if not any(parts.values()):
            return f"{text}: nothing that was varied changes it"
        shares = (self.relative(name, self.total(name, independent=way)) for way in (True, False))
        share, bound = (f"{100.0 * s:.2g}" if s < 0.995 else f"{100.0 * s:.0f}" for s in shares)
        cause = max(parts, key=lambda one: parts[one])
        most = self.parts[cause][name]
        how = f"observed order {most.order:.2g}" if math.isfinite(most.order) else most.behaviour
        return (
            f"{text} +- {share} % (sum of all: {bound} %), most of it by {cause}, {how}; "
            f"extrapolated {self.extrapolated(name):.5g}"
        )


# --- the runs -------------------------------------------------------------------------------------


def verify(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Verification:
    """How far a scene's steady vibration and natural frequencies are from converged (collective).

    Mesh, modes, harmonics and samples are made finer, one at a time and twice: a graded mesh by 1.5
    and 2, a grid by 2 and 3, numbers by 2 and 4. Of the three values of each quantity the observed
    order p, the extrapolated value f and the uncertainty F abs(f_i - f) follow, with a factor of
    safety F of 1.25 or 3 (:func:`fenics_crack.grid_convergence`; Roache 1994, Celik and others
    2008, ASME V&V 20-2009).

    A tolerance of the scene chooses harmonics and modes first. Of a mesh file and of matrices the
    mesh is left alone, and that is said. Runs that fail, and orbits that are not stable, are named.

    Parameters
    ----------
    scene : Scene
        As it is solved.
    comm : MPI.Comm
        Ranks that share each mesh.

    Returns
    -------
    Verification
        Each cause's part of the error of each quantity, and their total.

    Raises
    ------
    InputError
        As :func:`fenics_crack.prepare`.
    ConvergenceError
        The scene itself does not converge.

    Examples
    --------
    >>> found = fc.verify(scene)
    >>> percent = found.total("amplitude")
    """
    with within(OWN):
        study = prepare(scene, comm, whole=True)
        own = solve_prepared(study)
        if scene.harmonic_balance.tolerance is not None and own.result.converged:
            own = solve_prepared(_varied(own, _settled(own)), own.result)
    if not own.result.converged:
        raise ConvergenceError(f"{OWN}: {own.result.status}")
    study = replace(study, scene=_settled(own))
    first, units = _answer(own)
    failures: list[str] = []
    verdicts = _doubtful(OWN, own)
    parts, counts = {}, {}
    absent: dict[str, str] = {}
    unknown: dict[str, str] = {}
    for cause, ways in zip(CAUSES, (_meshes, _modes, _harmonics, _samples), strict=True):
        found = ways(study, own)
        if isinstance(found, str):
            (unknown if cause == "mesh" else absent)[cause] = found
            continue
        levels = [(found.counts[0] or _elements(own.structure.whole), first)]
        finest_first = list(zip(found.finer.items(), found.counts[1:], strict=True))[::-1]
        for (name, finer), count in finest_first:  # few modes are among many
            run = _finer_run(name, finer, found.shared, comm, failures)
            if run is not None:
                levels.insert(1, (count or _elements(run.structure.whole), _answer(run)[0]))
                verdicts |= _doubtful(name, run)
        many = tuple(count for count, _ in levels)
        if len(many) == 1:
            unknown[cause] = "no finer run has converged"
        elif len(set(many)) < len(many):
            unknown[cause] = "finer ones have as many elements, as mesh.size is that of the plate"
        else:
            counts[cause] = many
            parts[cause] = {
                name: grid_convergence(
                    [found.size(count) for count in many],
                    [values.get(name, 0.0) for _, values in levels],  # 0: none there
                    formal=found.formal,
                    highest=found.highest,
                )
                for name in first
            }
    return Verification(
        study.scene, first, units, parts, counts, absent, unknown, tuple(failures), verdicts
    )


def _varied(study: Study, scene: Scene) -> Study:
    """Another scene of the same mesh, and with the same reduction where the study is reduced."""
    return Study(scene, study.structure, study.contact, study.watched)


def _settled(run: Run[PeriodicSolution]) -> Scene:
    """The scene of a run with what was chosen for it; with all modes kept it is not reduced, so
    that none is left out on a finer mesh."""
    scene, whole = run.scene, run.structure.whole
    changes: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is not None:
        changes["harmonic_balance.tolerance"] = None
        changes["harmonic_balance.harmonics"] = run.result.harmonics
    table = reduction_of(scene, whole)
    if table is None or modes_of(scene, table) >= whole.n_dofs:
        return scene.replace(changes | {"reduction.method": "off", "reduction.modes": None})
    kept = {"reduction.method": table.method, "reduction.modes": modes_of(scene, table)}
    return scene.replace(changes | kept)


# --- what is made finer ---------------------------------------------------------------------------


@dataclass(frozen=True)
class _Ways:
    """Finer scenes by what each is called, and the orders of theory.

    ``counts`` are the numbers of what is varied, the scene's own first; None of a mesh, whose
    elements are counted when it is made. ``shared`` is the study of them all but for a mesh,
    ``area`` that of the mesh [m^2].
    """

    finer: dict[str, Scene]
    counts: tuple[int | None, ...]
    formal: float
    shared: Study | None = None
    highest: float = math.inf
    area: float = 1.0

    def size(self, count: int) -> float:
        """The side of a square of the mean area of so many elements [m] (Celik and others, equation
        1), or one over the number of something else."""
        return 1.0 / count if self.shared is not None else math.sqrt(self.area / count)


def _meshes(study: Study, own: Study) -> _Ways | str:
    scene = study.scene
    if scene.structure is not None:
        return "[structure] has matrices, and not the mesh that they are of"
    lips = scene.mesh.lip_elements or 0
    even = scene.mesh.layout == "graded" and math.ceil(1.5 * lips) <= EVEN * lips
    finer = {
        f"a mesh {factor:g} times finer": finer_mesh(scene, factor)
        for factor in (GRADED if even else GRID)
    }
    scenes = {name: found for name, found in finer.items() if found is not None}
    if not scenes:
        return "mesh.file is one mesh; make finer ones and compare them by fc.grid_convergence"
    formal = TIP if study.structure.n_pairs else CLAMP
    area = (scene.geometry.width or 1.0) * (scene.geometry.height or 1.0)
    none = (None,) * (1 + len(scenes))
    return _Ways(scenes, none, formal, highest=2.0 * scene.mesh.order, area=area)


def finer_mesh(scene: Scene, factor: float) -> Scene | None:
    """A scene whose elements are ``factor`` times as short; None where the scene makes no mesh.

    Elements along lips are counted up to the next whole number. A grid becomes finer by the next
    whole factor, so that cracks stay on its lines.
    """
    mesh = scene.mesh
    if mesh is None or mesh.layout == "file":
        return None
    changes: dict[str, Any] = {}
    if mesh.size is not None:
        changes["mesh.size"] = mesh.size / factor
    for key in ("lip_elements", "columns", "rows"):
        count = getattr(mesh, key)
        if count is not None:
            grown = factor if key == "lip_elements" else math.ceil(factor)
            changes[f"mesh.{key}"] = math.ceil(grown * count)
    return scene.replace(changes)


def _modes(study: Study, own: Study) -> _Ways | str:
    scene, whole = study.scene, study.structure
    table = reduction_of(scene, whole)
    if table is None:
        return "the structure is not reduced"
    kept, most = modes_of(scene, table), whole.n_dofs - whole.n_pairs
    if kept >= most:
        return "all are kept"
    return _more(study, scene, "reduction.modes", kept, most, 1.0)


def _harmonics(study: Study, own: Study) -> _Ways | str:
    scene, table = study.scene, study.scene.harmonic_balance
    if study.contact is None:
        return "without contact there is one"
    if table.samples is not None:  # enough for all of them
        least = 4 * COUNTS[-1] * table.harmonics + 1
        scene = scene.replace({"harmonic_balance.samples": max(table.samples, least)})
    return _more(own, scene, "harmonic_balance.harmonics", table.harmonics, MAX_SAMPLES, 1.0)


def _samples(study: Study, own: Study) -> _Ways | str:
    law, table = study.contact, study.scene.harmonic_balance
    if law is None:
        return "without contact there are none"
    if table.samples is None and is_unilateral(law):
        return "contact is integrated exactly"
    count = table.samples or default_samples(table.harmonics)
    return _more(own, study.scene, "harmonic_balance.samples", count, MAX_SAMPLES, 2.0)


def _more(shared: Study, scene: Scene, key: str, own: int, most: int, formal: float) -> _Ways:
    """Twice and four times as many of something, at most so many."""
    counts = tuple(sorted({min(factor * own, most) for factor in COUNTS}))
    name = key.rpartition(".")[2]
    finer = {f"{count} {name}": scene.replace({key: count}) for count in counts[1:]}
    return _Ways(finer, counts, formal, shared)


# --- runs -----------------------------------------------------------------------------------------


def _finer_run(
    name: str, scene: Scene, shared: Study | None, comm: MPI.Comm, failures: list[str]
) -> Run[PeriodicSolution] | None:
    """The run of a finer scene, from the solution that it shares a structure with; None, and its
    failure, where it does not converge (collective)."""
    initial = shared.result if isinstance(shared, Run) else None
    with within(name):
        try:
            varied = prepare(scene, comm, whole=True) if shared is None else _varied(shared, scene)
            run = solve_prepared(varied, initial)
            if run.result.converged:
                return run
            failures.append(f"{name}: {run.result.status}")
        except REFUSALS as error:
            failures.append(f"{name}: {error}")
    return None


def _doubtful(name: str, run: Run[PeriodicSolution]) -> dict[str, str]:
    """The verdict by the name of a run, where it is not known to be stable."""
    stability = run.result.stability
    known = stability is None or stability.verdict == "stable"
    return {} if known or stability is None else {name: stability.verdict}


def _answer(run: Run[PeriodicSolution]) -> tuple[dict[str, float], dict[str, str]]:
    """What is asked for of the watched points and the lips, the lowest natural frequencies, and the
    units (collective)."""
    output = run.scene.output
    chosen = (output.quantities if output is not None else None) or ANSWER
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    for watched in run.watched:
        seen = run.result.indicators(watched.dof)
        for name in chosen:
            if name in OF_POINTS or name in OF_LIPS:
                column = watched.column(name) if name in OF_POINTS else name
                value, unit = float(getattr(seen, name)), QUANTITIES[name][1]
                if abs(value) > (TINY if unit == "1" else 0.0):
                    values[column], units[column] = value, unit.replace("1", "")
    factor, _, unit = frequency_axis(run.scene.in_hertz)
    kind = "frequency" if run.scene.in_hertz else "omega"
    for mode, omega in enumerate(run.structure.once(_lowest), 1):
        values[f"{kind}_open_{mode}"], units[f"{kind}_open_{mode}"] = factor * float(omega), unit
    return values, units


def _lowest(structure: Structure) -> np.ndarray:
    """Natural frequencies with lips open; of a reduced structure those that it keeps."""
    return solve_modes(structure, min(FREQUENCIES, structure.n_modes)).omega


def _elements(whole: Structure) -> int:
    """How many there are; of matrices one (collective)."""
    return max(1, 0 if whole.nodes is None else whole.comm.allreduce(len(whole.nodes.cells)))
