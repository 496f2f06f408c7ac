"""Write and read every kind of result (HDF5): one :func:`save`, one :func:`load`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import dynamic_compliance
from fenics_crack.balance.error_report import ErrorReport
from fenics_crack.balance.family import FAMILIES
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.curves.backbone import Backbone
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError
from fenics_crack.files.modes_file import pack_modes, unpack_modes
from fenics_crack.files.store import kind_of, reading, write
from fenics_crack.model.contact import ContactLaw, UnilateralConstraint, is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import Modes
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.time.march import TimeHistory

__all__ = ["Result", "check_gap", "check_pairs", "load", "save", "type_of"]

Result = Modes | PeriodicSolution | ResponseCurve | Backbone | TimeHistory
Law = ContactLaw | None
Parts = dict[str, Any]

CURVE = (
    "parameter", "values", "omega", "gap_coefficients", "harmonics", "iterations", "truncation",
    "complete", "status", "subharmonic", "multipliers", "branch",
)  # fmt: skip
BACKBONE = (
    "mode", "omega", "energy", "rest_energy", "cosines", "iterations", "complete", "status",
    "jumps",
)  # fmt: skip


def save(result: Result, path: str | Path, scene: Scene | None = None) -> None:
    """Write a result to an HDF5 file, with its scene if there is one (collective).

    A solution's file holds gap and contact force, from which the displacement follows, and modes
    are written node by node: neither depends on the number of ranks.

    Parameters
    ----------
    result : Modes, PeriodicSolution, ResponseCurve, Backbone or TimeHistory
        What was found.
    path : path
        The file; an older one is replaced when the new one is complete.
    scene : Scene, optional
        What was computed.

    Raises
    ------
    InputError
        The file cannot be written, modes are those of a structure without a mesh, or a time history
        is spread over several ranks.
    """
    if type(result) not in _FORMS:
        names = ", ".join(kind.__name__ for kind in _FORMS)
        raise InputError("result", type(result).__name__, f"one of {names}")
    pack = _FORMS[type(result)][0]
    write(pack(result), path, result.KIND, scene, result.structure.comm)


def load(path: str | Path, structure: Structure, contact: Law = None) -> Result:
    """Read a result written by :func:`save`; nothing is solved again (collective).

    A file with a scene needs no structure at hand: :func:`fenics_crack.load_run`. A sweep has its
    own ``SweepResult.load``.

    Parameters
    ----------
    path : path
        The file.
    structure, contact : Structure, ContactLaw or None
        Those with which it was found; of a curve, a structure with many dofs is reduced by
        :func:`reduce_structure`, as it was then. Modes and time histories need no law.

    Raises
    ------
    InputError
        The file is not one of :func:`save`, or the structure or the law is another.
    """
    kind = type_of(path)
    with reading(path, kind.KIND) as parts:
        return _FORMS[kind][1](parts, structure, contact)


def type_of(path: str | Path) -> type[Result]:
    """Class of the result in a file written by :func:`save`.

    Raises
    ------
    InputError
        The file holds something else.
    """
    found = kind_of(path)
    for kind in _FORMS:
        if kind.KIND == found:
            return kind
    allowed = f"a result written by save; this is a {found} (SweepResult.load reads sweeps)"
    raise InputError("path", str(path), allowed)


# --- solutions ------------------------------------------------------------------------------------


def _pack_solution(solution: PeriodicSolution) -> Parts:
    parts = {
        "omega": solution.omega,
        "gap_coefficients": solution.gap_coefficients,
        "force_coefficients": solution.force_coefficients,
        "subharmonic": solution.subharmonic,
        "converged": solution.converged,
        "status": solution.status,
        "iterations": solution.iterations,
        **{f"error_{name}": value for name, value in asdict(solution.report).items()},
        **_law_parts(solution.contact),
    }
    if is_rigid(solution.contact):
        parts["weight"] = solution.contact.weight  # type: ignore[union-attr]
    if solution.stability is not None:
        parts |= asdict(solution.stability)
    return parts


def _unpack_solution(parts: Parts, structure: Structure, contact: Law) -> PeriodicSolution:
    gap, force = parts["gap_coefficients"], parts["force_coefficients"]
    if gap.ndim != 2 or gap.shape != force.shape or not len(gap) % 2:
        raise ValueError("coefficients do not fit")
    check_pairs(structure, gap)
    _check_law_parts(parts, contact)
    if is_rigid(contact):
        contact = UnilateralConstraint(float(parts["weight"]))
    omega, subharmonic = float(parts["omega"]), int(parts["subharmonic"])
    stability = None
    if "verdict" in parts:
        stability = Stability(
            parts["multipliers"],
            parts["verdict"],
            float(parts["uncertainty"]),
            bool(parts["refined"]),
        )
    names = [field.name for field in fields(ErrorReport)]
    report = ErrorReport(*[float(parts[f"error_{name}"]) for name in names])
    converged = bool(parts["converged"])
    compliance = dynamic_compliance(structure, omega / subharmonic, len(gap) // 2, subharmonic)
    displacement = compliance.displacement(force)
    compliance.destroy()
    if converged:
        check_gap(structure, displacement, gap, max(1e-6, 10.0 * report.residual))
    return PeriodicSolution(
        structure,
        omega,
        contact,
        displacement,
        gap,
        force,
        subharmonic=subharmonic,
        converged=converged,
        status=parts["status"],
        iterations=int(parts["iterations"]),
        report=report,
        stability=stability,
    )


def check_pairs(structure: Structure, gaps: np.ndarray) -> None:
    """Raise InputError unless gaps (..., n_pairs) have as many pairs as the structure."""
    if gaps.shape[-1] != structure.n_pairs:
        allowed = f"one with {gaps.shape[-1]} pairs"
        raise InputError("structure", f"{structure.n_pairs} pairs", allowed)


def check_gap(
    structure: Structure, displacement: np.ndarray, gap: np.ndarray, tolerance: float
) -> None:
    """Raise InputError unless displacement and gap coefficients agree (collective)."""
    closing = structure.closing(displacement)
    size = np.linalg.norm(closing)
    closing[0] -= structure.clearance
    if np.linalg.norm(closing - gap) > tolerance * size:
        raise InputError("structure", "another load, mesh or material", "that of the file")


# --- curves ---------------------------------------------------------------------------------------


def _pack_curve(curve: ResponseCurve) -> Parts:
    parts = {name: getattr(curve, name) for name in CURVE}
    parts["samples"] = curve.samples or 0
    parts["kinds"] = [b.kind for b in curve.bifurcations]
    parts["bifurcation_values"] = [b.value for b in curve.bifurcations]
    for number, bifurcation in enumerate(curve.bifurcations):
        parts[f"bifurcation_{number}"] = bifurcation.gap_coefficients
    return parts | _law_parts(curve.contact)


def _unpack_curve(parts: Parts, structure: Structure, contact: Law) -> ResponseCurve:
    if not is_small(structure):
        structure = reduce_structure(structure)
    _check_law_parts(parts, contact)
    gaps = parts["gap_coefficients"]
    sizes = {len(part) for part in (parts["values"], parts["omega"], gaps, parts["harmonics"])}
    if parts["parameter"] not in FAMILIES or gaps.ndim != 3 or len(sizes) != 1:
        raise ValueError("its parts do not fit")
    check_pairs(structure, gaps)
    curve = ResponseCurve(
        structure,
        contact,  # type: ignore[arg-type]
        parts["parameter"],
        parts["values"],
        parts["omega"],
        gaps,
        parts["harmonics"],
        parts["iterations"],
        parts["truncation"],
        (),
        bool(parts["complete"]),
        parts["status"],
        int(parts["samples"]) or None,
        int(parts["subharmonic"]),
        parts.get("multipliers"),
        bool(parts["branch"]),
    )
    special = [
        (kind, float(value), parts[f"bifurcation_{number}"])
        for number, (kind, value) in enumerate(
            zip(parts["kinds"], parts["bifurcation_values"], strict=True)
        )
    ]
    first = curve.solution(0)
    check_gap(first.structure, first.displacement_coefficients, curve.gap(0), 1e-4)
    return replace(curve, bifurcations=curve.expand_bifurcations(special))


def _pack_backbone(backbone: Backbone) -> Parts:
    parts = {name: getattr(backbone, name) for name in BACKBONE}
    parts |= {"samples": backbone.samples or 0, "couplings": backbone.structure.couplings}
    return parts | _law_parts(backbone.contact)


def _unpack_backbone(parts: Parts, structure: Structure, contact: Law) -> Backbone:
    _check_law_parts(parts, contact)
    signs = structure.signs_since(parts["couplings"])
    return Backbone(
        structure,
        contact,  # type: ignore[arg-type]
        int(parts["mode"]),
        parts["omega"],
        parts["energy"],
        float(parts["rest_energy"]),
        signs * parts["cosines"],
        parts["iterations"],
        bool(parts["complete"]),
        parts["status"],
        parts["jumps"],
        int(parts["samples"]) or None,
    )


# --- motion in time -------------------------------------------------------------------------------


def _pack_history(history: TimeHistory) -> Parts:
    if history.structure.comm.size > 1:
        raise InputError("result", "spread over several ranks", "a time history of one rank")
    parts = {field.name: getattr(history, field.name) for field in fields(history)}
    del parts["structure"]
    displacement, velocity = parts.pop("final_state")
    parts |= {"displacement": displacement, "velocity": velocity}
    return parts | {"couplings": history.structure.couplings}


def _unpack_history(parts: Parts, structure: Structure, contact: Law) -> TimeHistory:
    signs = structure.signs_since(parts.pop("couplings"))
    state = signs * parts.pop("displacement"), signs * parts.pop("velocity")
    dofs = parts["recorded_dofs"]
    parts["recorded"] = signs[dofs - structure.first_dof] * parts["recorded"]
    for name in ("settled", "created_energy", "seconds"):
        parts[name] = float(parts[name])
    for name in ("periods", "steps_per_period"):
        parts[name] = int(parts[name])
    return TimeHistory(structure=structure, final_state=state, **parts)


# --- laws -----------------------------------------------------------------------------------------


def _law_parts(contact: Law) -> Parts:
    """Name, stiffness and sharpness of a law, by which a file identifies it."""
    parts: Parts = {"law": type(contact).__name__}
    for name in ("stiffness", "sharpness"):
        if getattr(contact, name, None) is not None:
            parts[f"law_{name}"] = getattr(contact, name)
    return parts


def _check_law_parts(parts: Mapping[str, Any], contact: Law) -> None:
    """Raise InputError unless a law is that of a file."""
    now = _law_parts(contact)
    then = {
        name: parts[name] for name in ("law", "law_stiffness", "law_sharpness") if name in parts
    }
    same = now.keys() == then.keys() and now["law"] == then["law"]
    if not same or not all(np.allclose(now[n], then[n], rtol=1e-9) for n in now if n != "law"):
        raise InputError("contact", now, f"the law of the file: {then}")


Pack = Callable[[Any], Parts]
Unpack = Callable[[Parts, Structure, Law], Result]
_FORMS: dict[type[Result], tuple[Pack, Unpack]] = {
    Modes: (pack_modes, unpack_modes),
    PeriodicSolution: (_pack_solution, _unpack_solution),
    ResponseCurve: (_pack_curve, _unpack_curve),
    Backbone: (_pack_backbone, _unpack_backbone),
    TimeHistory: (_pack_history, _unpack_history),
}
