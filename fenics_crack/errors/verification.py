"""Store, describe and save the errors of a result's numbers by cause.

:func:`fenics_crack.verify` computes the errors with finer meshes, more modes, harmonics and samples
(:mod:`verify`). Each command computes stated errors with an additional run for each cause
(:mod:`stated`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any, ClassVar

from fenics_crack.basics.causes import (
    ERROR_CAUSES,
    MESH_ERROR_CAUSES,
    OMITTABLE_ERROR_CAUSES,
    REQUIRED_ERROR_CAUSES,
)
from fenics_crack.basics.errors import DEFAULT_ERROR_TOLERANCE, check_choice
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    Conclusion,
    Table,
    describe_omitted_causes,
    format_error,
    format_percent,
    format_quantity,
    heading_with_unit,
)
from fenics_crack.errors.convergence import GridConvergence, PartOrReason
from fenics_crack.files.codec import Datasets, dataclass_from_json, to_json_text
from fenics_crack.files.store import SavableResult, StoredFile
from fenics_crack.scene.scene import Scene

CONVERGENCE_DOUBT_BY_BEHAVIOUR = {
    "outside": "the runs converge with another order than theory, so the error has a safety factor "
    "of 3; refine further for a smaller one",
    "two sizes": "two runs cannot show the order of convergence, so the error has the order of "
    "theory and a safety factor of 3",
    "irregular": "the runs do not converge, so 3 times their spread is the error; refine further",
}
"""Clause for each doubtful behaviour in :class:`GridConvergence`, printed in warnings."""
ESTIMATE_BASIS_BY_BEHAVIOUR = {
    "two sizes": "by the order of theory",
    "carried": "by runs at shifted frequencies",
    "exact orbit": "by the exact orbit",
}
"""Printed source of an error without an observed order, by behaviour in :class:`GridConvergence`.
"""


# --- the result -----------------------------------------------------------------------------------


@keep_old_attribute_names(
    dents="point_force_warnings",
    incomplete="incomplete_error_notes",
    left_out="omitted_causes_and_reasons_text",
    missing_causes="find_reasons_by_missing_cause",
    text="to_json",
    without="omitted_causes_text",
)
@dataclass(frozen=True, repr=False)
class Verification(SavableResult):
    """Hold the contributions by cause to the errors of a scene's result.

    Attributes
    ----------
    scene : Scene
        Scene with all choices made for the result: crack length, modes, harmonics.
    values, units : dict of str to float, and to str
        Value and unit of each quantity in the scene's answer, named as in ``[output] quantities``;
        at a named point "tip.ux.amplitude". Natural frequencies with the crack open are
        "frequency_open_1" [Hz] or "omega_open_1" [rad/s].
    parts : dict of str to dict of str to GridConvergence
        For each cause and quantity, the values in all runs and the estimated error. Causes are
        "mesh", "shift" (of the resonance by the mesh), "modes", "harmonics", "samples" and
        parameters such as "friction". The attribute ``sizes`` has the runs' step sizes, smallest
        first:

        - mesh, shift: side of a mean element [m]. The scene's mesh is the last, or the first if the
          second mesh is coarser.
        - modes, harmonics, samples: 1 / count. The scene's count is the last.
        - parameters: two values, the scene's own first. For friction: friction coefficients, 0 and
          the assumed coefficient; if friction already acts along fixed lines, 0 and 1.
    counts : dict of str to tuple of int
        Numbers of elements, modes, harmonics or samples by cause, the scene's count first. For
        parameters: two equal numbers of modes or harmonics.
    absent : dict of str to str
        For each cause that contributes nothing, the reason.
    unknown : dict of str to str
        For each cause with an unknown contribution, the reason. No total includes these causes.
    failed_causes : tuple of str
        Causes with a failed run, also listed in ``unknown``. Each makes all total errors unknown.
    failures : tuple of str
        Name and error of each run refused or not converged.
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

    def with_part(self, cause: str, part_or_reason: PartOrReason) -> Verification:
        """Return a copy with the part of a cause, or with the reason for no part.

        Parameters
        ----------
        cause : str
            Cause of error, for example "mesh".
        part_or_reason : PartOrReason
            Counts and convergence by quantity name; or the reason for no part, as text. For
            ``OMITTABLE_ERROR_CAUSES`` the reason is added to ``unknown``. For any further cause
            the reason is added to ``absent``, since the cause contributes nothing. An empty text
            adds nothing.
        """
        if not isinstance(part_or_reason, str):
            counts, convergence_by_name = part_or_reason
            return replace(
                self,
                counts=self.counts | {cause: counts},
                parts=self.parts | {cause: convergence_by_name},
            )
        if not part_or_reason:
            return self
        if cause in OMITTABLE_ERROR_CAUSES:
            return self.with_unknown(cause, part_or_reason)
        return replace(self, absent=self.absent | {cause: part_or_reason})

    def with_unknown(self, cause: str, reason: str) -> Verification:
        """Return a copy with a cause recorded in ``unknown``, and the reason."""
        return replace(self, unknown=self.unknown | {cause: reason})

    # --- files ------------------------------------------------------------------------------------

    def to_json(self) -> str:
        """Return everything except the scene as JSON text, for a file."""
        return to_json_text(self, "", {})

    def _pack_fields(self) -> Datasets:
        return {"verification": self.to_json()}

    @classmethod
    def _from_datasets(cls, datasets_by_name: Datasets, scene: Scene | None) -> Verification:
        return dataclass_from_json(cls, datasets_by_name["verification"], scene)

    # --- numbers ----------------------------------------------------------------------------------

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes with parts, such as "mesh" and "modes"."""
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
            cause: convergence_by_quantity[quantity].uncertainty(
                sorted(counts, reverse=True).index(counts[0])
            )
            for cause, convergence_by_quantity in self.parts.items()
            if quantity in convergence_by_quantity
            for counts in [self.counts[cause]]
        }

    def find_reasons_by_missing_cause(self, quantity: str) -> dict[str, str]:
        """Return the causes missing in a quantity's error, each with the reason.

        A cause is missing if further runs varied the cause, but gave no error for this quantity.
        The result has the cause as key and the reason as value.
        """
        return {
            cause: ERROR_CAUSES[cause].missing_number_reason
            for cause, convergence_by_quantity in self.parts.items()
            if quantity not in convergence_by_quantity
        }

    def total(self, quantity: str, *, independent: bool = True) -> float:
        """Return a quantity's error due to all causes, in the quantity's unit.

        The contributions by the causes "mesh" and "shift" (of the resonance by the mesh) are added
        first. If the causes are ``independent``, the total is the root of the sum of squares;
        otherwise the sum.
        """
        contributions_of_causes = self._contributions_merging_mesh_causes(quantity).values()
        return math.hypot(*contributions_of_causes) if independent else sum(contributions_of_causes)

    def _contributions_merging_mesh_causes(self, quantity: str) -> dict[str, float]:
        """Return a quantity's uncertainty by cause, with "mesh" and "shift" added up as "mesh"."""
        contribution_by_cause = self.contributions(quantity)
        mesh_contributions = [
            contribution_by_cause.pop(cause)
            for cause in MESH_ERROR_CAUSES
            if cause in contribution_by_cause
        ]
        return (
            {"mesh": sum(mesh_contributions)} if mesh_contributions else {}
        ) | contribution_by_cause

    def extrapolated(self, quantity: str) -> float:
        """Return a quantity's value plus the corrections by all causes.

        The correction by a cause is the extrapolated limit less the scene's value. A cause without
        a finite limit gives no correction.
        """
        scene_value = self.values[quantity]
        convergences_with_quantity = (
            convergence_by_quantity
            for convergence_by_quantity in self.parts.values()
            if quantity in convergence_by_quantity
        )
        extrapolated_limits = (
            convergence_by_quantity[quantity].extrapolated
            for convergence_by_quantity in convergences_with_quantity
        )
        return scene_value + sum(
            extrapolated_limit - scene_value
            for extrapolated_limit in extrapolated_limits
            if math.isfinite(extrapolated_limit)
        )

    def relative(self, quantity: str, error: float) -> float:
        """Return an error divided by the quantity's absolute value; nan if the value is 0.

        ``error`` has the quantity's unit.
        """
        value = self.values[quantity]
        return error / abs(value) if value else math.nan

    def stated(self, quantity: str) -> tuple[float, str]:
        """Return a quantity's relative error due to all causes, and the main cause.

        Returns
        -------
        error : float
            Total error (:meth:`total`) over the quantity's absolute value. nan, if the error is
            unknown:

            - no cause has an error estimate for this quantity;
            - the error due to harmonics or modes is unknown, or the run on the second mesh failed;
            - the total is 0, and the error due to any cause is unknown.

            inf, if the total is as large as the quantity.
        cause : str
            Cause with the largest error, such as "mesh". "" if the error is nan.
        """
        is_unknown = any(
            cause in self.unknown for cause in (*REQUIRED_ERROR_CAUSES, *self.failed_causes)
        )
        contribution_by_cause = (
            self._contributions_merging_mesh_causes(quantity) if quantity in self.values else {}
        )
        if not contribution_by_cause or is_unknown:
            return math.nan, ""
        relative_total = self.relative(quantity, self.total(quantity))
        if relative_total == 0.0 and (self.unknown or self.find_reasons_by_missing_cause(quantity)):
            return math.nan, ""
        cause = max(contribution_by_cause, key=lambda part_cause: contribution_by_cause[part_cause])
        return math.inf if relative_total >= 1.0 else relative_total, cause

    def doubt(self, quantity: str) -> str:
        """Return why a quantity's error is unknown, or as large as the value.

        If the error is known and smaller than the value, the text is empty. An error due to the
        mesh or friction may be left out by the user's choice. This choice gives no text, either.
        """
        for cause in (*REQUIRED_ERROR_CAUSES, *self.failed_causes):
            if cause in self.unknown:
                return self.unknown[cause]
        error, cause = self.stated(quantity)
        if math.isinf(error):
            return (
                f"the estimate is as large as the value, mostly due to the {cause}"
                f"{ERROR_CAUSES[cause].remedy_text}"
            )
        return ""

    @property
    def resonance(self) -> str:
        """Name in ``values`` of the resonance frequency nearest to the load frequency.

        The name is "" without crack faces. In a run-up the name is "speed", the rotor speed at the
        resonance.
        """
        bilinear_names = (name for name in self.values if "_bilinear_" in name)
        return "speed" if "speed" in self.values else next(bilinear_names, "")

    @property
    def omitted_causes_text(self) -> str:
        """Phrase naming the causes with unknown error: "error due to the mesh not included".

        The phrase is "" without unknown causes.
        """
        return describe_omitted_causes(self.unknown)

    @property
    def omitted_causes_and_reasons_text(self) -> str:
        """Phrase naming the causes with unknown error, with the reasons.

        The phrase is :attr:`omitted_causes_text`, and then the reasons; "" without unknown causes.
        """
        reasons_text = "; ".join(dict.fromkeys(self.unknown.values()))
        return f"{self.omitted_causes_text}: {reasons_text}" if self.unknown else ""

    # --- tables -----------------------------------------------------------------------------------

    def totals(self) -> Table:
        """Tabulate values and errors, a row per quantity.

        Columns: value; error by each cause; total error, the root of the sum of squares; sum over
        all errors; observed order of convergence over the mesh; and the extrapolated value. Errors
        are in percent of the value, to three digits.
        """
        table_rows = []
        for quantity_name, value in self.values.items():
            contribution_by_cause = self.contributions(quantity_name)
            absolute_errors = [contribution_by_cause.get(cause, math.nan) for cause in self.causes]
            absolute_errors += [
                self.total(quantity_name),
                self.total(quantity_name, independent=False),
            ]
            error_percents = [
                float(f"{100.0 * self.relative(quantity_name, error):.3g}")
                for error in absolute_errors
            ]
            mesh_convergence_by_name = self.parts.get("mesh", {})
            observed_mesh_order = (
                mesh_convergence_by_name[quantity_name].order
                if quantity_name in mesh_convergence_by_name
                else math.nan
            )
            quantity_name_with_unit = heading_with_unit(quantity_name, self.units[quantity_name])
            table_rows.append(
                [
                    quantity_name_with_unit,
                    value,
                    *error_percents,
                    round(observed_mesh_order, 2),
                    self.extrapolated(quantity_name),
                ]
            )
        percent_headings = [f"{label} [%]" for label in (*self.causes, "total", "sum")]
        return Table(
            ["quantity", "value", *percent_headings, "order in h", "extrapolated"], table_rows
        )

    def to_dict(self) -> dict[str, Any]:
        """Return a table of errors as columns by heading.

        The table has several rows for each quantity: a row for each cause, then a row for the total
        with independent causes, then a row for the sum. A cause's row has these columns:

        - count and value in each run, for up to three runs,
        - the observed order of convergence, and the safety factor,
        - the uncertainty of the scene's value.

        Entries without a meaning are nan.
        """
        rows = [row for name in self.values for row in self._yield_cause_rows(name)]
        column_headings = dict.fromkeys(column_heading for row in rows for column_heading in row)
        return {
            column_heading: [row.get(column_heading, math.nan) for row in rows]
            for column_heading in column_headings
        }

    def _yield_cause_rows(self, quantity_name: str) -> Iterator[dict[str, Any]]:
        """Yield a quantity's rows for :meth:`to_dict`: a row per cause, then "total" and "sum".

        Each row is a dict of entries by column heading.
        """
        quantity_entry_by_key = {"quantity": quantity_name, "unit": self.units[quantity_name]}
        for cause in self.contributions(quantity_name):
            convergence, counts = self.parts[cause][quantity_name], self.counts[cause]
            row: dict[str, Any] = quantity_entry_by_key | {
                "cause": cause,
                "behaviour": convergence.behaviour,
            }
            row |= {
                f"{key}_{run_number}": math.nan
                for key in ("count", "value")
                for run_number in (1, 2, 3)
            }
            row |= {f"count_{run_number}": count for run_number, count in enumerate(counts, 1)}
            # Values are in the order of the smallest size; equal counts keep the order of runs.
            runs_by_size = sorted(enumerate(counts, 1), key=itemgetter(1), reverse=True)
            row |= {
                f"value_{run_number}": value
                for (run_number, _), value in zip(runs_by_size, convergence.values, strict=True)
            }
            convergence_attribute_names = "order", "exponent", "factor", "extrapolated"
            row |= {key: getattr(convergence, key) for key in convergence_attribute_names} | {
                "gci_finest": convergence.gci
            }
            yield row | _make_uncertainty_entries(
                self, quantity_name, self.contributions(quantity_name)[cause]
            )
        for cause, is_independent in (("total", True), ("sum", False)):
            value_entry_by_key = {
                "value_1": self.values[quantity_name],
                "extrapolated": self.extrapolated(quantity_name),
            }
            total_entry_by_key = _make_uncertainty_entries(
                self, quantity_name, self.total(quantity_name, independent=is_independent)
            )
            yield (
                quantity_entry_by_key
                | {"cause": cause, "behaviour": ""}
                | value_entry_by_key
                | total_entry_by_key
            )

    def _repr_text(self) -> str:
        return self.statement[0]

    def build_conclusion(self) -> Conclusion:
        """Return the parts of the sentence printed at the end of ``verify``.

        The sentence states the scene's first quantity, the relative error and the main cause. If
        the error is in doubt, the reason stands in place of error and cause.
        """
        quantity_name = next(iter(self.values))
        quantity_words = getattr(
            OBSERVABLES_BY_NAME.get(quantity_name.rpartition(".")[2]), "words", quantity_name
        )
        error, cause = self.stated(quantity_name)
        quantity_and_value_text = (
            f"{quantity_words} "
            f"{format_quantity(self.values[quantity_name], self.units[quantity_name])}"
        )
        answer_text = (
            f"{quantity_and_value_text} within {format_error(error)}, factors of safety "
            "included, mostly due "
            f"to the {cause}"
        )
        if math.isnan(error):
            answer_text = f"{quantity_and_value_text}; no refinement changes this number"
        doubt_text = self.doubt(quantity_name)
        stability_verdict_texts = (
            f"{run_name}: {stability_verdict}"
            for run_name, stability_verdict in self.verdicts.items()
        )
        return Conclusion(
            "verified",
            quantity_and_value_text if doubt_text else answer_text,
            doubt_text,
            [self.omitted_causes_text, *stability_verdict_texts],
        )

    # --- words ------------------------------------------------------------------------------------

    @property
    def statement(self) -> tuple[str, ...]:
        """Sentences on the errors, for printing.

        The first sentence states the error of the scene's first quantity. If a different quantity
        has the largest relative error, the next sentence states this error. Causes without a
        contribution follow, each with the reason. The :attr:`warnings` come last.
        """
        main_quantity_name = next(iter(self.values))
        relative_total_by_name = {
            quantity_name: self.relative(quantity_name, self.total(quantity_name))
            for quantity_name in self.values
        }
        worst_quantity_name = max(
            relative_total_by_name, key=lambda quantity_name: relative_total_by_name[quantity_name]
        )
        sentences = [self._describe_error(main_quantity_name)]
        if worst_quantity_name != main_quantity_name:
            sentences.append(f"largest of all: {self._describe_error(worst_quantity_name)}")
        sentences += [
            f"no error due to the {cause}: {reason_text}"
            for cause, reason_text in self.absent.items()
        ]
        return (*sentences, *self.warnings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences with doubts about the errors.

        Doubts are: causes with unknown error, quantities without an error for a cause, failed runs
        and unstable orbits. Further doubts are doubtful orders of convergence, a force at a point,
        and a contact stiffness given for each pair.
        """
        sentences = [
            f"the totals do not include the error due to the {cause}: {reason_text}"
            for cause, reason_text in self.unknown.items()
        ]
        sentences += self.incomplete_error_notes
        sentences += [f"a run failed, with {failure_text}" for failure_text in self.failures]
        sentences += [
            f"the orbit with {run_name} is {stability_verdict}; fenics-crack curve shows other "
            "vibrations"
            for run_name, stability_verdict in self.verdicts.items()
        ]
        for cause, convergence_by_quantity in self.parts.items():
            for behaviour, doubt_text in CONVERGENCE_DOUBT_BY_BEHAVIOUR.items():
                doubted_names = [
                    quantity_name
                    for quantity_name in convergence_by_quantity
                    if convergence_by_quantity[quantity_name].behaviour == behaviour
                    and self._is_contribution_relevant(quantity_name, cause)
                ]
                if doubted_names:
                    sentences.append(
                        f"error of {', '.join(doubted_names)} due to the {cause}: {doubt_text}"
                    )
        sentences += self.point_force_warnings
        contact_table = self.scene.contact if self.resonance else None  # of crack faces
        if (
            "mesh" in self.parts
            and contact_table is not None
            and contact_table.stiffness is not None
        ):
            sentences.append(
                "contact.stiffness holds for each contact pair, and a finer mesh has more pairs: "
                "the contact depends on the mesh; use contact.stiffness_per_area"
            )
        return tuple(sentences)

    @property
    def incomplete_error_notes(self) -> tuple[str, ...]:
        """Sentences on quantities without an error estimate for a varied cause.

        Used as warnings: the totals for the named quantities do not include the cause. Each
        sentence names the quantities, the cause and the reason.
        """
        return tuple(
            f"{', '.join(names_without_cause)}: error due to the {cause} not included: "
            f"{self.find_reasons_by_missing_cause(names_without_cause[0])[cause]}"
            for cause, convergence_by_quantity in self.parts.items()
            if (
                names_without_cause := [
                    name for name in self.values if name not in convergence_by_quantity
                ]
            )
        )

    @property
    def point_force_warnings(self) -> tuple[str, ...]:
        """Warning about the unlimited displacement under a point force.

        The displacement grows as elements become smaller. The tuple has a sentence if elements half
        as long add more than 1 % to the amplitude at the load. Otherwise, and without a point
        force, the tuple is empty.
        """
        scene, amplitude = self.scene, abs(self.values.get("amplitude", 0.0))
        amplitude_increase = displacement_added_by_halved_elements(scene)
        if (
            scene.output_points
            or not amplitude_increase > DEFAULT_ERROR_TOLERANCE * amplitude > 0.0
        ):
            return ()
        displacement_growth_text, suggested_load_place_text = (
            ("log(1/h)", "an edge") if scene.dimension == 2 else ("1/h", "a face")
        )
        return (
            "amplitude: under a force at a point the displacement has no limit for the element "
            f"length h -> 0; it grows like {displacement_growth_text}, by about "
            f"{format_percent(amplitude_increase / amplitude)} with elements half as long; observe "
            f"another place (output.points), or load {suggested_load_place_text} ([[loads]])",
        )

    def _is_contribution_relevant(self, quantity_name: str, cause: str) -> bool:
        """Return True if a cause's contribution to a quantity's error deserves a warning.

        The contribution must be at least a tenth of the total, and at least 0.1 % of the value.
        """
        compared_error = max(
            self.total(quantity_name), DEFAULT_ERROR_TOLERANCE * abs(self.values[quantity_name])
        )
        return self.contributions(quantity_name)[cause] >= 0.1 * compared_error

    def _describe_error(self, quantity_name: str) -> str:
        """Describe a quantity's value, uncertainty and largest cause in a sentence."""
        contribution_by_cause = self.contributions(quantity_name)
        quantity_and_value_text = (
            f"{quantity_name} = {self.values[quantity_name]:.5g} {self.units[quantity_name]}"
        ).rstrip()
        if not any(contribution_by_cause.values()):
            return f"{quantity_and_value_text}: no refinement changes this number"
        relative_total_and_sum = (
            self.relative(quantity_name, self.total(quantity_name, independent=is_independent))
            for is_independent in (True, False)
        )
        total_text, sum_text = map(format_percent, relative_total_and_sum)
        largest_cause = max(
            contribution_by_cause, key=lambda part_cause: contribution_by_cause[part_cause]
        )
        largest_convergence = self.parts[largest_cause][quantity_name]
        order_text = (
            f"observed order {largest_convergence.order:.2g}"
            if math.isfinite(largest_convergence.order)
            else ERROR_CAUSES[largest_cause].parameter_runs_text
            or ESTIMATE_BASIS_BY_BEHAVIOUR.get(largest_convergence.behaviour, "no observed order")
        )
        return (
            f"{quantity_and_value_text} +- {total_text} (sum of all: {sum_text}), mostly due to "
            "the "
            f"{largest_cause}, {order_text}; extrapolated {self.extrapolated(quantity_name):.5g}"
        )


def read_verification_or_none(result_file: StoredFile) -> Verification | None:
    """Return the verification stored in a result's file; None if the file has none.

    Raises
    ------
    InputError
        The stored verification does not fit the scene or the format.
    """
    with result_file.yield_datasets_with_valid_numbers() as datasets_by_name:
        if "verification" not in datasets_by_name:
            return None
        verification = dataclass_from_json(
            Verification, datasets_by_name["verification"], result_file.scene()
        )
        verification.to_dict()  # whose rows have every part
        return verification


def displacement_added_by_halved_elements(scene: Scene) -> float:
    """Estimate the displacement [m] at a point force added by elements half as long.

    The displacement under a point force has no limit as the element size h [m] becomes smaller. F
    [N] is the force's amplitude, E Young's modulus [Pa], t the thickness [m]. a [rad] is the angle
    of material around the force: pi on an edge, 2 pi inside. In a plate the added displacement is F
    / (E t) ln 2 (1 / (a + sin a) + 1 / (a - sin a)). In a solid the added displacement is about F /
    (E h).

    Return 0 if no force acts at a point, or if the scene gives matrices instead of a body. Also
    return 0 if a solid has no ``mesh.size``. Source: Timoshenko, Goodier, Theory of Elasticity,
    sections 36 to 38.
    """
    point_loads = [load for load in scene.loads if load.point is not None]
    load = scene.excitation if scene.excitation.first_force_key else next(iter(point_loads), None)
    if load is None or scene.structure is not None:
        return 0.0
    mesh_table, body_side_lengths, thickness = (
        scene.mesh,
        scene.geometry.sides,
        scene.geometry.thickness,
    )
    force_vectors = [getattr(load, force_key) or () for force_key in ("force_sin", "force_cos")]
    force_over_young = (
        math.hypot(*(component for force_vector in force_vectors for component in force_vector))
        / scene.material.young
    )
    if scene.dimension == 3 or thickness is None:
        return force_over_young / mesh_table.size if mesh_table.size else 0.0
    n_body_edges_at_force = 1
    if mesh_table.layout != "file":
        n_body_edges_at_force = sum(
            component in (0.0, body_side_length)
            for component, body_side_length in zip(load.point or (), body_side_lengths, strict=True)
        )
    body_angle_at_force = math.pi * 2.0 ** (1 - n_body_edges_at_force)
    wedge_factor = 1.0 / (body_angle_at_force + math.sin(body_angle_at_force)) + 1.0 / (
        body_angle_at_force - math.sin(body_angle_at_force)
    )
    return force_over_young / thickness * math.log(2.0) * wedge_factor


def _make_uncertainty_entries(
    verification: Verification, quantity_name: str, error: float
) -> dict[str, float]:
    """Return a quantity's error as two table entries by heading.

    "uncertainty" is the absolute error, in the quantity's unit, as in ``error``. "relative" is the
    error over the quantity's absolute value.
    """
    return {"uncertainty": error, "relative": verification.relative(quantity_name, error)}
