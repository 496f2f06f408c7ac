"""Sweeps: many cases of a scene, spread over ranks, in a file from which a killed run continues.

The cases are the product of the axes in ``[sweep.over]``, numbered with the last axis fastest.

*Geometries.* Each combination of mesh, matrices, modes, damping and place of the load is a
geometry; frequency, force, contact law, clearance and truncation do not change it. A geometry is
built once and is then a small structure in plain arrays that any rank can solve.

*Chunks.* The cases of a geometry are cut into chunks of up to 16 along the frequency (if it is not
swept, along the last axis that leaves the geometry alone). The first case of a chunk starts from
the linear solution, each further one from its neighbour; along the frequency they share their
equations (:class:`fenics_crack.sweep.case.Cases`). Chunks depend on the scene alone, and so do the
results, to the bit with the same number of BLAS threads: neither interruptions nor the number of
ranks change them, as long as the ranks share the cases and not a mesh.

*Jobs.* A job is some chunks of a geometry. Rank 0 hands jobs to the other ranks, does some itself
and writes what is found (:mod:`fenics_crack.sweep.jobs`). Geometries with many pairs and long
cracks come first, a rank goes on with the geometry that it has built, and towards the end the ranks
share what is left, so that all of them finish together.
"""

from __future__ import annotations

import itertools
import operator
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.contact_system import default_weight
from fenics_crack.balance.error_report import ERROR_PARTS, LARGE_ERROR
from fenics_crack.balance.harmonic_balance import slide_along_lines, solve_linear
from fenics_crack.balance.more_modes import UNKNOWN
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import passing_folder
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import DRAWN, QUANTITIES, Place, names_of
from fenics_crack.basics.progress import reaching
from fenics_crack.basics.ranks import StopRequest, on_root
from fenics_crack.basics.suggestions import checked_call
from fenics_crack.basics.tables import Said, Tabular, counted, error_in_words, optional, quantity
from fenics_crack.files.results import solution_from
from fenics_crack.files.store import Stored, header
from fenics_crack.model.structure import Structure
from fenics_crack.runs.conclusion import describe_linearity
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene, unit_of
from fenics_crack.scene.tables import Sweep
from fenics_crack.study.prepare import scene_contact_law
from fenics_crack.sweep.case import Asked, with_any_modes
from fenics_crack.sweep.file import (
    KIND,
    UNSURE,
    YET,
    State,
    SweepFile,
    columns_of,
    of_load,
    read_columns,
    read_waves,
    scene_of,
)
from fenics_crack.sweep.jobs import Manager, Worker, serve
from fenics_crack.sweep.plan import Plan

NO_PEAK_SOUGHT = "without contact, and with [rotation]"
"""Scenes whose largest response over the load's frequency is not sought."""
STATE_NAMES = np.array([state.name.lower() for state in State])
"""Words for the states."""


def run_sweep(
    scene: Scene,
    path: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
    verdicts: bool = True,
    judged: bool = True,
    natural: Collection[int] = (),
) -> SweepResult:
    """Solve all cases of a scene's sweep by harmonic balance (collective).

    A case that cannot be solved is recorded with the reason. Ctrl-C stops after the present cases;
    the same call continues with the cases that are missing.

    Parameters
    ----------
    scene : Scene
        With its table ``[sweep]``.
    path : path, optional
        The file for the results. If it exists, it must be of the same scene and mesh files; its
        cases are kept, failed ones too; where some are missing, with the same ``verdicts``,
        ``judged`` and ``natural``. Default: a file that lasts as long as the program.
    comm : MPI.Comm
        The ranks that share the cases.
    progress : bool
        Show a bar.
    verdicts : bool
        Assess the stability of each case. It takes a tenth to a third of the time where a geometry
        has many cases; without, the columns ``verdict`` and ``multiplier`` are empty.
    judged : bool
        Estimate the error of the reduction, which takes twice the modes; without, the column
        ``reduction_error`` is empty.
    natural : collection of int
        Places on the last axis, from 0, at which nothing but natural frequencies is found: the
        state of these cases is that of failed ones.

    Returns
    -------
    SweepResult
        On every rank; not complete after Ctrl-C.

    Raises
    ------
    InputError
        The scene has no sweep, no combination of its values is a scene, a structure is too
        large and not to be reduced, or the file cannot be used.

    Examples
    --------
    >>> swept = scene.replace({"sweep.over": {"excitation.omega": [1900.0, 2000.0]}})
    >>> table = fc.run_sweep(swept, "sweep.h5").to_dict()
    """
    table: Sweep = scene.given("sweep")
    if table.at_resonance and not resonates(scene):
        raise InputError("sweep.at_resonance", True, f"false {NO_PEAK_SOUGHT}")
    count = table.shape[-1]
    if outside := [place for place in natural if place not in range(count)]:
        raise InputError("natural", outside, f"places on the last axis, 0 to {count - 1}")
    managers: list[Manager] = []

    def start() -> Asked:
        plan = Plan(scene)
        wanted = {"verdicts": verdicts, "judged": judged}
        omitted = [name for name, yes in wanted.items() if not yes]
        omitted += [f"vibration_{place}" for place in sorted(natural)]
        where = Path(path or passing_folder() / "sweep.h5")
        file = SweepFile(where, scene, plan.harmonics, plan.rows, omitted)
        managers.append(Manager(plan, file, comm.size, progress=progress))
        return Asked(
            plan.unit_loads,
            hopeless=not plan.reduction_swept,
            at_resonance=table.at_resonance,
            **wanted,
            natural=tuple(place in natural for place in range(count)),
        )

    asked = on_root(comm, start)
    worker, shared = Worker(asked, managers[0].plan if managers else Plan(scene)), comm.Dup()
    with StopRequest() as stop:
        if managers:
            with reaching(managers[0].how_far):
                managers[0].run(worker, shared, stop)
        else:
            serve(worker, shared)
    worker.free(stopped=stop.asked(comm))
    shared.Free()
    return on_root(comm, lambda: SweepResult.of(managers[0].stored))


def resonates(scene: Scene) -> bool:
    """Return True if the largest response over the load's frequency can be sought; else a scene is
    as :data:`NO_PEAK_SOUGHT` says."""
    return scene.contact is not None and scene.speed == 0.0


# --- the result -----------------------------------------------------------------------------------

NOT_STABLE = "unstable", "irregular", "undecided"
"""Verdicts of cases whose solution may not be what is seen."""


@dataclass(frozen=True, repr=False)
class SweepResult(Tabular):
    """The table of a sweep; its waves are read from the file on request.

    Attributes
    ----------
    path : Path
        The file.
    scene : Scene
        With the axes of the sweep.
    columns : dict of str to array
        Numbers and words by name, in the shape of the axes, nan where there is no value:
        ``response``, half the peak-to-peak displacement of the load's point in the load's direction
        [m], ``mean`` to ``mean_shift`` there, and ``cosine_1`` to ``sine_6``, the parts of its
        harmonics [m], the same of each point of ``[output.points]`` by
        names like ``tip.ux.ratio_2_1``, and ``opening`` to ``closed_share``: as in
        :class:`Indicators`; ``omega_open`` to ``over_bilinear``: as in
        :meth:`BilinearFrequencies.nearest`; ``omega_open_1`` to ``omega_tied_6``, the lowest
        natural frequencies with the crack open and bonded, and ``omega_bilinear_1`` to
        ``omega_bilinear_6`` of the open modes and the bonded ones of their shapes [rad/s];
        ``multiplier``, largest modulus, and the ``verdict``, empty without a contact law, as in
        :class:`Stability`;
        ``residual_error`` to ``reduction_error`` and ``penetration_share`` as in
        :class:`ErrorReport`; ``harmonics``; Newton ``iterations``; ``crack_length`` of the first
        crack, given or found [m]; ``seconds`` of wall-clock time; ``status``, how the case was
        solved or why not; ``state``: 0 pending, 1 converged, 2 failed; ``omega`` [rad/s] and
        ``frequency`` [Hz] of the load.
    """

    path: Path
    scene: Scene
    columns: dict[str, np.ndarray]

    KIND: ClassVar[str] = KIND

    @classmethod
    @checked_call
    def load(cls, path: str | Path) -> SweepResult:
        """Read the table of a sweep, also while it runs; nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or is not one of a sweep.
        """
        return cls.of(header(Path(path)))

    @classmethod
    def of(cls, stored: Stored) -> SweepResult:
        """The same of a file whose header is at hand."""
        scene = scene_of(stored)
        return cls(stored.path, scene, read_columns(stored, scene))

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes of the table."""
        return tuple(self.scene.given("sweep").over)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each axis."""
        return tuple(self.scene.given("sweep").shape)

    @property
    def complete(self) -> bool:
        """True if every case was tried."""
        return not np.any(self["state"] == State.PENDING)

    @property
    def converged(self) -> np.ndarray:
        """Cases that were solved: bool in the shape of the axes."""
        return self["state"] == State.CONVERGED

    @property
    def errors(self) -> np.ndarray:
        """Estimated errors of the cases, by truncation, reduction, sampling and residual as in
        :class:`ErrorReport`: (4, ...), then the shape of the axes; 0 where there is no value."""
        return np.nan_to_num([self[f"{part}_error"] for part in ERROR_PARTS])

    @property
    def inexact(self) -> np.ndarray:
        """Cases that have a large estimated error, likewise."""
        return self.converged & (self.errors.sum(axis=0) > LARGE_ERROR)

    @property
    def not_stable(self) -> np.ndarray:
        """Cases that are unstable, irregular or undecided, likewise."""
        return np.isin(self["verdict"], NOT_STABLE)

    @property
    def failed(self) -> list[tuple[tuple[int, ...], str]]:
        """Index and reason of each case that could not be solved."""
        return self._status_where(self["state"] == State.FAILED)

    @property
    def undecided(self) -> list[tuple[tuple[int, ...], str]]:
        """Index and reason of each case whose stability is undecided."""
        cases = self._status_where(self.converged & (self["verdict"] == "undecided"))
        return [(at, text.partition(UNSURE)[2] or "its reason is not kept") for at, text in cases]

    @property
    def contradicted(self) -> list[tuple[tuple[int, ...], str]]:
        """Index of each case whose verdict on stability is known to depend on truncated modes, and
        the verdict with twice the modes.

        It is known for crack faces without mass, where one step of Newton's method with these
        modes shows it, for two cases in three; of each one :func:`fenics_crack.solve` finds the
        orbit.
        """
        cases = self._status_where(self.converged & (self["verdict"] != "undecided"))
        return [(at, said) for at, status in cases if (said := status.partition(YET)[2])]

    def _status_where(self, which: np.ndarray) -> list[tuple[tuple[int, ...], str]]:
        return [(tuple(map(int, at)), str(self["status"][tuple(at)])) for at in np.argwhere(which)]

    def gap(self, index: tuple[int, ...] | int) -> np.ndarray:
        """Gap coefficients of a case that converged: (2H+1, n_pairs) [m].

        Parameters
        ----------
        index : tuple of int, or int
            Its place on each axis, or its number.

        Raises
        ------
        InputError
            There is no such case, or it was not solved.
        """
        place = self._place(index)
        rows, case = read_waves(self.path, place)[0], Plan(self.scene).case(place)
        assert isinstance(case, Scene)
        return rows[:, : rows.shape[1] // 2] if case.has_friction else rows

    def solution(self, index: tuple[int, ...] | int) -> PeriodicSolution:
        """The solution of a case that converged; its structure is built again.

        Raises
        ------
        InputError
            As :meth:`gap`; or a mesh file has changed.
        """
        place = self._place(index)
        header(self.path).check_files(self.scene)
        plan = Plan(self.scene)
        case = plan.case(place)
        assert isinstance(case, Scene)
        length = float(self["crack_length"][place])
        if case.crack is not None and case.crack.first_omega is not None:
            case = case.replace({"crack.length": length, "crack.first_omega": None})
        for geometry in with_any_modes(case, Asked(plan.unit_loads)):
            try:
                return self._solution_in(geometry.of_case(case), case, place)
            except InputError as error:  # the file's waves may be of other modes
                refused = error
        raise refused

    def _solution_in(
        self, structure: Structure, case: Scene, place: tuple[int, ...]
    ) -> PeriodicSolution:
        """The solution of a case in its structure; InputError where it is of another one."""
        omega = float(self["omega"][place])
        law = scene_contact_law(case, structure)
        if law is None:
            return solve_linear(structure, omega, harmonics=case.harmonic_balance.harmonics)
        law = slide_along_lines(structure, omega, law)
        gap, force = read_waves(self.path, place)
        problem = Problem(structure, omega, law, len(gap) // 2)
        wave = problem.wave_of(np.zeros((len(gap), 0)), gap, force)  # u follows from the forces
        parts = vars(wave) | {
            "status": str(self["status"][place]),
            "iterations": int(self["iterations"][place]),
            "error_penetration": float(self["penetration_share"][place]),
            "error_displacement": 0.0,
        }
        parts |= {f"error_{name}": float(self[f"{name}_error"][place]) for name in ERROR_PARTS}
        if problem.is_projected:
            parts["weight"] = default_weight(problem.compliance())
        return solution_from(parts, structure, law)

    def _place(self, index: tuple[int, ...] | int) -> tuple[int, ...]:
        """The place of a case that converged."""
        try:
            given = index if isinstance(index, tuple) else np.unravel_index(index, self.shape)
            place = tuple(map(operator.index, given))
            solved = len(place) == len(self.shape) and min(place) >= 0
            solved = solved and bool(self.converged[place])
        except (IndexError, ValueError, TypeError):
            solved = False
        if not solved:
            raise InputError("index", index, f"that of a case that converged, of {self.shape}")
        return place

    # --- shown ------------------------------------------------------------------------------------

    @property
    def quantities(self) -> dict[str, tuple[str, str]]:
        """The columns that are drawn and printed, in words and with units: those that the scene's
        ``[output] quantities`` chooses, or a few."""
        seen, found = self.scene.point_names, {}
        for name in self.scene.quantities or names_of(where=DRAWN):
            words, unit = QUANTITIES[name].words, QUANTITIES[name].unit
            if QUANTITIES[name].of is not Place.POINT:
                found[name] = words, unit
            elif seen:
                found |= {f"{at}.{name}": (f"{words}, {where}", unit) for at, where in seen.items()}
            else:
                found[of_load(name)] = f"{words} at the load's point", unit
        return {name: how for name, how in found.items() if name in self.columns}

    def to_dict(self) -> dict[str, Any]:
        """The values of the axes by their keys, then the columns; a row for each case."""
        values = zip(*itertools.product(*(axis.values for axis in self.axes)), strict=True)
        found = {axis.key: list(swept) for axis, swept in zip(self.axes, values, strict=True)}
        found["state"] = STATE_NAMES[self["state"]].ravel().tolist()
        columns = (name for name in self.columns if name != "state")
        return found | {name: self[name].ravel().tolist() for name in columns}

    def to_xarray(self) -> Any:
        """The columns of :meth:`to_dict` over the swept keys, as an ``xarray.Dataset`` with units.

        Raises
        ------
        ImportError
            xarray is not installed: the package does without it.
        """
        dataset, units = optional("xarray", "to_xarray").Dataset, self._units()
        swept = {a.key: [v if np.isscalar(v) else str(v) for v in a.values] for a in self.axes}
        columns = {
            name: ([*swept], np.reshape(values, self.shape), {"units": units.get(name, "")})
            for name, values in self.to_dict().items()
            if name not in swept
        }
        return dataset(columns, swept)

    def _units(self) -> dict[str, str]:
        swept = {axis.key: unit_of(axis.key) for axis in self.axes}
        return swept | {name: unit for name, (unit, _) in columns_of(self.scene).items()}

    def said(self) -> Said:
        """What the last sentence on the sweep says."""
        solved, known = self.converged, []
        total, cases = self.errors.sum(axis=0)[solved], counted(solved.size, "case")
        if np.any(np.isfinite(height := np.where(solved, self["response"], np.nan))):
            place = np.unravel_index(int(np.nanargmax(height)), height.shape)
            size = quantity(float(height[place]), "m")
            known.append(f"the largest response is {size} half peak-to-peak at ")
            known[0] += in_words(self.axes, [*map(int, place)])
        largest, unknown = total.max(initial=0.0), int(np.sum(total >= UNKNOWN))
        if not self.scene.harmonic_balance.error:
            known.append("errors and stability are not estimated (harmonic_balance.error = false)")
        elif largest > 0.0 and not unknown:
            error = error_in_words(largest)
            known.append(f"largest estimated error by modes and harmonics {error}")
        names, counts = np.unique(self["verdict"][solved], return_counts=True)
        verdicts = [f"{n} {name}" for n, name in zip(counts, names, strict=True) if name]
        return Said(
            "sweep complete" if solved.all() else f"{solved.sum()} of {cases} converged",
            ", ".join(known),
            f"it could not be estimated in {counted(unknown, 'case')}" if unknown else "",
            [*describe_linearity(self["closed_share"][solved]), ", ".join(verdicts)],
        )

    def _title(self) -> str:
        counts = zip(STATE_NAMES, np.bincount(self["state"].ravel(), minlength=3), strict=True)
        swept = " x ".join(f"{len(axis.values)} {axis.key}" for axis in self.axes)
        return ", ".join([swept, *(f"{count} {state}" for state, count in counts if count)])


def is_part(stored: Stored) -> bool:
    """Return True for the file of a sweep that another computation has made for itself: it leaves
    out errors that the command ``sweep`` estimates."""
    return stored.kind == KIND and bool(stored.attributes.get("omitted"))


# --- cases in words -------------------------------------------------------------------------------


def by_reason(
    found: SweepResult, reasons: Sequence[tuple[tuple[int, ...], str]], what: str
) -> Iterator[str]:
    """Cases that failed or are undecided, those of one reason together: reasons that differ in
    numbers alone are one."""
    kinds: dict[str, list[tuple[tuple[int, ...], str]]] = {}
    for index, reason in reasons:
        kinds.setdefault(re.sub(r"[-+]?\d[\d.e+-]*", "#", reason), []).append((index, reason))
    ordered, shown = sorted(kinds.values(), key=len, reverse=True), 4
    for cases in ordered[:shown]:
        index, reason = cases[0]
        number = f"{counted(len(cases), 'case')} {what}, the first at"
        yield f"{number} {in_words(found.axes, index)}: {reason}"
    if more := ordered[shown:]:
        left = sum(map(len, more))
        yield f"{counted(left, 'case')} {what} for other reasons: column status of the table"


def in_words(axes: Sequence[Axis], index: Sequence[int]) -> str:
    """The swept values of a case on some axes."""
    return ", ".join(
        f"{axis.key.rpartition('.')[2]} = {axis.values[at]}"
        for axis, at in zip(axes, index, strict=True)
    )
