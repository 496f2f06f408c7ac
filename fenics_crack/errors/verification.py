"""Store, describe and save the errors of a result's numbers by cause.

:func:`fenics_crack.verify` computes the errors with finer meshes, more modes, harmonics and samples
(:mod:`verify`). Each command computes stated errors with an additional run for each cause
(:mod:`stated`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from fenics_crack.basics.causes import (
    MESH_ERROR_CAUSES,
    MISSING_PART_REASON_BY_CAUSE,
    OPTIONAL_ERROR_CAUSES,
    REQUIRED_ERROR_CAUSES,
)
from fenics_crack.basics.errors import DEFAULT_ERROR_TOLERANCE, check_choice
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.tables import (
    Conclusion,
    Table,
    describe_omitted_causes,
    format_error,
    format_percent,
    format_quantity,
    heading_with_unit,
)
from fenics_crack.errors.convergence import GridConvergence, Varied
from fenics_crack.files.codec import Datasets, dataclass_from_json, to_json_text
from fenics_crack.files.saved import SavedResult
from fenics_crack.files.store import StoredFile
from fenics_crack.scene.scene import Scene

DOUBTS = {
    "outside": "the observed order is not that of theory, the factor of safety is 3",
    "two sizes": "two runs show no order: that of theory is used, with a factor of safety of 3",
    "irregular": "the values show no order: the uncertainty is 3 times their spread",
}
"""Sentence for each doubtful behaviour in :class:`GridConvergence`."""


# --- the result -----------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Verification(SavedResult):
    """Hold the contributions to the error of a scene's result.

    Attributes
    ----------
    scene : Scene
        Scene with all choices made for the result: crack length, modes, harmonics.
    values, units : dict of str to float, and to str
        Value and unit of each quantity in the scene's answer, named as in ``[output] quantities``;
        at a named point "tip.ux.amplitude". Natural frequencies with the crack open are
        "frequency_open_1" [Hz] or "omega_open_1" [rad/s].
    parts : dict of str to dict of str to GridConvergence
        Part by cause ("mesh", "shift", "modes", "harmonics", "friction" or "samples") and quantity.
        Sizes are the side of a mean element [m] for the mesh and the shift, and 1 / count for
        modes, harmonics and samples. The scene's value is the first with a coarser mesh, otherwise
        the last. Sizes for friction are two coefficients, or 0 and 1 for friction along lines, and
        the scene's value is the first.
    counts : dict of str to tuple of int
        Numbers of elements, modes, harmonics or samples by cause, the scene's count first. For
        friction: the modes in both solutions.
    absent : dict of str to str
        Reason by cause without a contribution.
    unknown : dict of str to str
        Reason by cause with an unknown contribution, which all totals lack.
    failed_causes : tuple of str
        Unknown causes with a failed run, which leave every error unknown.
    failures : tuple of str
        Runs that were refused or did not converge.
    verdicts : dict of str to str
        Verdict on stability by run, if the orbit is not known to be stable.
    """

    scene: Scene
    values: dict[str, float]
    units: dict[str, str]
    parts: dict[str, dict[str, GridConvergence]] = field(default_factory=dict)
    counts: dict[str, tuple[int, ...]] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    unknown: dict[str, str] = field(default_factory=dict)
    failed_causes: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()
    verdicts: dict[str, str] = field(default_factory=dict)

    KIND: ClassVar[str] = "verification"

    def with_part(self, cause: str, part: Varied) -> Verification:
        """Add the part of a cause, or the reason for no part.

        Without a part, an optional cause is unknown; any further cause contributes nothing. An
        empty reason adds nothing.
        """
        if not isinstance(part, str):
            counts, convergence = part
            return replace(
                self, counts=self.counts | {cause: counts}, parts=self.parts | {cause: convergence}
            )
        if not part:
            return self
        if cause in OPTIONAL_ERROR_CAUSES:
            return self.with_unknown(cause, part)
        return replace(self, absent=self.absent | {cause: part})

    def with_unknown(self, cause: str, reason: str) -> Verification:
        """Add a cause whose contribution is unknown, and the reason."""
        return replace(self, unknown=self.unknown | {cause: reason})

    # --- files ------------------------------------------------------------------------------------

    def text(self) -> str:
        """Return everything except the scene as JSON text, for a file."""
        return to_json_text(self, "", {})

    def _pack_fields(self) -> Datasets:
        return {"verification": self.text()}

    @classmethod
    def _unpack_fields(cls, parts: Datasets, scene: Scene | None) -> Verification:
        return dataclass_from_json(cls, parts["verification"], scene)

    # --- numbers ----------------------------------------------------------------------------------

    @property
    def causes(self) -> tuple[str, ...]:
        """The varied causes."""
        return tuple(self.parts)

    def contributions(self, quantity: str) -> dict[str, float]:
        """Return a quantity's uncertainty by cause, in the quantity's unit.

        Causes without a part for the quantity have no entry.

        Raises
        ------
        InputError
            The quantity is unknown.
        """
        check_choice("quantity", quantity, self.values)
        return {
            # Sizes are in the order of the smallest; the scene's own choice is the first count.
            cause: cause_parts[quantity].uncertainty(sorted(counts, reverse=True).index(counts[0]))
            for cause, cause_parts in self.parts.items()
            if quantity in cause_parts
            for counts in [self.counts[cause]]
        }

    def missing_causes(self, quantity: str) -> dict[str, str]:
        """Return reasons by varied cause without a part for a quantity."""
        return {
            cause: MISSING_PART_REASON_BY_CAUSE.get(cause, "the other run has no such number")
            for cause, parts in self.parts.items()
            if quantity not in parts
        }

    def total(self, quantity: str, *, independent: bool = True) -> float:
        """Return a quantity's error by all causes, in the quantity's unit.

        Contributions by the mesh and the mesh's shift are added first. The total is the root of
        the sum of squares; if the causes are not ``independent``, the total is the sum.
        """
        contributions = self._parts(quantity).values()
        return math.hypot(*contributions) if independent else sum(contributions)

    def _parts(self, quantity: str) -> dict[str, float]:
        """Return contributions by cause, with mesh and shift added up as "mesh"."""
        parts = self.contributions(quantity)
        mesh = [parts.pop(cause) for cause in MESH_ERROR_CAUSES if cause in parts]
        return ({"mesh": sum(mesh)} if mesh else {}) | parts

    def extrapolated(self, quantity: str) -> float:
        """Return a quantity's value, corrected by all causes with a finite limit."""
        scene_number = self.values[quantity]
        parts_with_quantity = (parts for parts in self.parts.values() if quantity in parts)
        limits = (parts[quantity].extrapolated for parts in parts_with_quantity)
        return scene_number + sum(limit - scene_number for limit in limits if math.isfinite(limit))

    def relative(self, quantity: str, error: float) -> float:
        """Divide an error by a quantity's size (nan for a quantity 0)."""
        value = self.values[quantity]
        return error / abs(value) if value else math.nan

    def stated(self, quantity: str) -> tuple[float, str]:
        """Return a quantity's relative error by all causes (:meth:`total`).

        Returns
        -------
        float
            Total over the quantity. The error is nan without any part, if harmonics or modes are
            unknown causes, or if the second mesh failed. A total of 0 gives nan, too, if any cause
            is unknown or lacks a part. If the total is as large as the quantity, the error is inf.
        str
            Cause with the largest part: "mesh", "modes", "harmonics", "friction" or "samples"; ""
            with nan.
        """
        unknown = any(
            cause in self.unknown for cause in (*REQUIRED_ERROR_CAUSES, *self.failed_causes)
        )
        parts = self._parts(quantity) if quantity in self.values else {}
        if not parts or unknown:
            return math.nan, ""
        total = self.relative(quantity, self.total(quantity))
        if total == 0.0 and (self.unknown or self.missing_causes(quantity)):
            return math.nan, ""
        cause = max(parts, key=lambda part_cause: parts[part_cause])
        return math.inf if total >= 1.0 else total, cause

    def doubt(self, quantity: str) -> str:
        """Return the reason for doubt about a quantity's error.

        The text is empty if the error is known, or was left out by choice.
        """
        for cause in (*REQUIRED_ERROR_CAUSES, *self.failed_causes):
            if cause in self.unknown:
                return self.unknown[cause]
        error, cause = self.stated(quantity)
        if math.isinf(error):
            mesh_remark = "the mesh is too coarse; " if cause == "mesh" else ""
            return f"{mesh_remark}the estimate is as large as the value, mostly due to the {cause}"
        return ""

    @property
    def resonance(self) -> str:
        """Name of the resonance next to the result; empty without crack faces.

        In a run-up the name is "speed", the speed at the resonance.
        """
        resonances = (name for name in self.values if "_bilinear_" in name)
        return "speed" if "speed" in self.values else next(resonances, "")

    @property
    def without(self) -> str:
        """Unknown causes in words: "error due to the mesh not included"; or empty."""
        return describe_omitted_causes(self.unknown)

    @property
    def left_out(self) -> str:
        """Unknown causes (:attr:`without`) and the reasons; or empty."""
        reasons = "; ".join(dict.fromkeys(self.unknown.values()))
        return f"{self.without}: {reasons}" if self.unknown else ""

    # --- tables -----------------------------------------------------------------------------------

    def totals(self) -> Table:
        """Return a table with the errors of all quantities.

        A row has the value, relative contributions and totals [%] to three digits, the mesh's
        observed order, and the extrapolated value.
        """
        rows = []
        for name, value in self.values.items():
            contributions = self.contributions(name)
            errors = [contributions.get(cause, math.nan) for cause in self.causes]
            errors += [self.total(name), self.total(name, independent=False)]
            shares = [float(f"{100.0 * self.relative(name, error):.3g}") for error in errors]
            mesh = self.parts.get("mesh", {})
            order = mesh[name].order if name in mesh else math.nan
            quantity = heading_with_unit(name, self.units[name])
            rows.append([quantity, value, *shares, round(order, 2), self.extrapolated(name)])
        columns = [f"{label} [%]" for label in (*self.causes, "total", "sum")]
        return Table(["quantity", "value", *columns, "order in h", "extrapolated"], rows)

    def to_dict(self) -> dict[str, Any]:
        """Return columns with a row per quantity and cause or total.

        A row has the varied counts, up to three values, the order and factor from these values,
        and the uncertainty of the first value.
        """
        rows = [row for name in self.values for row in self._rows(name)]
        keys = dict.fromkeys(key for row in rows for key in row)
        return {key: [row.get(key, math.nan) for row in rows] for key in keys}

    def _rows(self, name: str) -> Iterator[dict[str, Any]]:
        quantity_entries = {"quantity": name, "unit": self.units[name]}
        for cause in self.contributions(name):
            part, counts = self.parts[cause][name], self.counts[cause]
            row: dict[str, Any] = quantity_entries | {"cause": cause, "behaviour": part.behaviour}
            row |= {f"{key}_{n}": math.nan for key in ("count", "value") for n in (1, 2, 3)}
            row |= {f"count_{n}": count for n, count in enumerate(counts, 1)}
            by_count = dict(zip(sorted(counts, reverse=True), part.values, strict=True))
            row |= {f"value_{n}": by_count[count] for n, count in enumerate(counts, 1)}
            numbers = "order", "exponent", "factor", "extrapolated"
            row |= {key: getattr(part, key) for key in numbers} | {"gci_finest": part.gci}
            yield row | _uncertainty_entries(self, name, self.contributions(name)[cause])
        for cause, independent in (("total", True), ("sum", False)):
            value_entries = {"value_1": self.values[name], "extrapolated": self.extrapolated(name)}
            total = _uncertainty_entries(self, name, self.total(name, independent=independent))
            yield quantity_entries | {"cause": cause, "behaviour": ""} | value_entries | total

    def _repr_text(self) -> str:
        return self.statement[0]

    def build_conclusion(self) -> Conclusion:
        """Return the parts of the study's concluding sentence."""
        name = next(iter(self.values))
        words = getattr(OBSERVABLES_BY_NAME.get(name.rpartition(".")[2]), "words", name)
        error, cause = self.stated(name)
        value = f"{words} {format_quantity(self.values[name], self.units[name])}"
        answer = f"{value} within {format_error(error)}, factors of safety included, mostly due "
        answer += f"to the {cause}"
        if math.isnan(error):
            answer = f"{value}; nothing that was varied changes the numbers"
        doubt = self.doubt(name)
        verdicts = (f"{run}: {verdict}" for run, verdict in self.verdicts.items())
        return Conclusion("verified", value if doubt else answer, doubt, [self.without, *verdicts])

    # --- words ------------------------------------------------------------------------------------

    @property
    def statement(self) -> tuple[str, ...]:
        """Sentences on the errors, including unknown and doubtful errors."""
        main_quantity = next(iter(self.values))
        shares = {name: self.relative(name, self.total(name)) for name in self.values}
        worst_quantity = max(shares, key=lambda name: shares[name])
        sentences = [self._in_words(main_quantity)]
        if worst_quantity != main_quantity:
            sentences.append(f"largest of all: {self._in_words(worst_quantity)}")
        sentences += [
            f"{cause}, no contribution: {reason}" for cause, reason in self.absent.items()
        ]
        return (*sentences, *self.warnings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences with doubts about the numbers."""
        sentences = [
            f"{cause} not varied, so it is missing in the totals: {reason}"
            for cause, reason in self.unknown.items()
        ]
        sentences += self.incomplete
        sentences += [f"failed, {text}" for text in self.failures]
        sentences += [
            f"the orbit with {run} is {verdict}" for run, verdict in self.verdicts.items()
        ]
        for cause, parts in self.parts.items():
            for kind, doubt in DOUBTS.items():
                names = [n for n in parts if parts[n].behaviour == kind and self._matters(n, cause)]
                if names:
                    sentences.append(f"{cause}, {', '.join(names)}: {doubt}")
        sentences += self.dents
        contact = self.scene.contact if self.resonance else None  # of crack faces
        if "mesh" in self.parts and contact is not None and contact.stiffness is not None:
            sentences.append(
                "contact.stiffness is that of a pair, of which a finer mesh has more: the mesh "
                "changes the law, too; contact.stiffness_per_area stays the same law"
            )
        return tuple(sentences)

    @property
    def incomplete(self) -> tuple[str, ...]:
        """Sentences on numbers with an error that lacks a varied cause."""
        return tuple(
            f"{', '.join(names)}: error due to the {cause} not included: "
            f"{self.missing_causes(names[0])[cause]}"
            for cause, parts in self.parts.items()
            if (names := [name for name in self.values if name not in parts])
        )

    @property
    def dents(self) -> tuple[str, ...]:
        """Warning about the unlimited displacement under a point force.

        Given if elements half as long add much to the amplitude.
        """
        scene, amplitude = self.scene, abs(self.values.get("amplitude", 0.0))
        dent = dent_by_force(scene)
        if scene.points or not dent > DEFAULT_ERROR_TOLERANCE * amplitude > 0.0:
            return ()
        growth, side = ("log(1/h)", "an edge") if scene.dimension == 2 else ("1/h", "a face")
        return (
            "amplitude: under a force at a point the displacement has no limit, it grows like "
            f"{growth}, by about {format_percent(dent / amplitude)} with elements half as long; "
            f"watch another place (output.points), or load {side} (loads)",
        )

    def _matters(self, name: str, cause: str) -> bool:
        """Return True if doubts about a contribution are reported.

        The contribution must reach a tenth of the total, and a tenth of the value times
        ``DEFAULT_ERROR_TOLERANCE``.
        """
        size = max(self.total(name), DEFAULT_ERROR_TOLERANCE * abs(self.values[name]))
        return self.contributions(name)[cause] >= 0.1 * size

    def _in_words(self, name: str) -> str:
        """Return a quantity, its uncertainty and the largest cause in words."""
        parts = self.contributions(name)
        text = f"{name} = {self.values[name]:.5g} {self.units[name]}".rstrip()
        if not any(parts.values()):
            return f"{text}: nothing that was varied changes it"
        shares = (
            self.relative(name, self.total(name, independent=is_independent))
            for is_independent in (True, False)
        )
        share, bound = map(format_percent, shares)
        cause = max(parts, key=lambda part_cause: parts[part_cause])
        largest_part = self.parts[cause][name]
        order_words = (
            f"observed order {largest_part.order:.2g}"
            if math.isfinite(largest_part.order)
            else largest_part.behaviour
        )
        text += f" +- {share} (sum of all: {bound}), mostly due to {cause}, {order_words}"
        return f"{text}; extrapolated {self.extrapolated(name):.5g}"


def verification_of(result_file: StoredFile) -> Verification | None:
    """Return the verification in a result's file, or None without any.

    Raises
    ------
    InputError
        The stored verification does not fit.
    """
    with result_file.yield_checked_datasets() as parts:
        if "verification" not in parts:
            return None
        verification = dataclass_from_json(Verification, parts["verification"], result_file.scene())
        verification.to_dict()  # whose rows have every part
        return verification


def dent_by_force(scene: Scene) -> float:
    """Estimate the displacement [m] added by halved elements at a force.

    F [N] is the force at a point, E Young's modulus [Pa], t the thickness [m], h the element size
    [m]. The force acts at a corner with angle a [rad]; a = pi on an edge and about 2 pi inside. In
    a plate the displacement along an edge is F / (E t) ln 2 (1 / (a + sin a) + 1 / (a - sin a)). In
    a solid the displacement is about F / (E h). Without a force at a point, or with matrices as
    structure, return 0.
    Source: Timoshenko, Goodier, Theory of Elasticity, sections 36 to 38.
    """
    at_points = [load for load in scene.loads if load.point is not None]
    load = scene.excitation if scene.excitation.first_force_key else next(iter(at_points), None)
    if load is None or scene.structure is not None:
        return 0.0
    mesh, sides, thickness = scene.mesh, scene.geometry.sides, scene.geometry.thickness
    parts = [getattr(load, name) or () for name in ("force_sin", "force_cos")]
    force = math.hypot(*(x for part in parts for x in part)) / scene.material.young
    if scene.dimension == 3 or thickness is None:
        return force / mesh.size if mesh.size else 0.0
    edges = 1
    if mesh.layout != "file":
        edges = sum(x in (0.0, side) for x, side in zip(load.point or (), sides, strict=True))
    angle = math.pi * 2.0 ** (1 - edges)
    wedge = 1.0 / (angle + math.sin(angle)) + 1.0 / (angle - math.sin(angle))
    return force / thickness * math.log(2.0) * wedge


def _uncertainty_entries(verification: Verification, name: str, error: float) -> dict[str, float]:
    """Return the columns for a quantity's error, absolute and relative."""
    return {"uncertainty": error, "relative": verification.relative(name, error)}
