"""Write and read every kind of result (HDF5): one :func:`save`, one :func:`load`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import make_compliance_model
from fenics_crack.balance.error_report import ErrorReport
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.curves.balance_equations import EQUATIONS_CLASS_BY_PARAMETER
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.files.codec import Parts, packed, unpacked
from fenics_crack.files.store import Stored, check_shapes, read, write
from fenics_crack.model.contact import (
    ContactLaw,
    UnilateralConstraint,
    add_friction_pairs,
    friction_of,
    is_rigid,
    is_unilateral,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import NEGLIGIBLE, Modes
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.scene.fields import LARGEST
from fenics_crack.scene.scene import Scene
from fenics_crack.time.march import TimeHistory

Result = Modes | PeriodicSolution | ResponseCurve | TimeHistory
Law = ContactLaw | None
Shapes = dict[str, tuple[int, ...]]


def save(
    result: Result,
    path: str | Path,
    scene: Scene | None = None,
    *,
    watched: Mapping[str, np.ndarray] | None = None,
    errors: str | None = None,
) -> None:
    """Write a result to an HDF5 file, with its scene if there is one (collective).

    A solution's file holds gap and contact force, from which the displacement follows, and modes
    are written node by node: neither depends on the number of ranks.

    Parameters
    ----------
    result : Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result to write.
    path : path
        The file; an older one is replaced once the new one is complete.
    scene : Scene, optional
        Its scene.
    watched : mapping of str to array, optional
        Motion of some dofs, for programs without the structure, by what they are called:
        coefficients of a solution (2H+1,) and of a curve (n, 2H+1), or displacements in time (n,)
        [m]. ``load`` leaves it alone.
    errors : str, optional
        Of its numbers, as ``Verification.text`` has them, for :func:`fenics_crack.load_run`.

    Raises
    ------
    InputError
        The file cannot be written, the modes have no mesh, or a time history is spread over
        several ranks.

    Examples
    --------
    >>> fc.save(solution, "solution.h5", scene)
    """
    if type(result) not in _FORMS:
        names = ", ".join(kind.__name__ for kind in _FORMS)
        raise InputError("result", type(result).__name__, f"one of {names}")
    parts = _FORMS[type(result)][0](result) | {"verification": errors}
    if watched:
        kind = "displacement" if isinstance(result, TimeHistory) else "coefficients"
        parts |= {"watched": [*watched], f"watched_{kind}": np.stack([*watched.values()], axis=-1)}
    write(parts, path, result.KIND, scene, result.structure.comm)


def load(path: str | Path, structure: Structure, contact: Law = None) -> Result:
    """Read a result written by :func:`save`; nothing is solved again (collective).

    :func:`fenics_crack.load_run` reads a file with a scene without a structure at hand;
    ``SweepResult.load`` reads a sweep.

    Parameters
    ----------
    path : path
        The file.
    structure, contact : Structure, ContactLaw or None
        Those with which it was found; for a curve, a structure with many dofs is reduced to crack
        faces without mass, as it was then. Modes and time histories need no law.

    Returns
    -------
    Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result that was written.

    Raises
    ------
    InputError
        The file is not one of :func:`save`, or the structure or the law is another.

    Examples
    --------
    >>> fc.save(solution, "solution.h5")
    >>> again = fc.load("solution.h5", structure, contact)
    """
    return unpack(read(path, structure.comm), structure, contact)


def unpack(stored: Stored, structure: Structure, contact: Law = None) -> Result:
    """The same of a file that is read (collective)."""
    kind = type_of(stored)
    with stored.taken() as parts:
        if (friction := friction_of(contact)) is not None and "law_direction" in parts:
            known = {name: parts[f"law_{name}"] for name in ("direction", "turning")}
            contact = replace(friction, **known)
        return _FORMS[kind][1](parts, structure, contact)


def type_of(stored: Stored) -> type[Result]:
    """Class of the result in a file written by :func:`save`.

    Raises
    ------
    InputError
        The file holds something else.
    """
    for kind in _FORMS:
        if kind.KIND == stored.kind:
            return kind
    if stored.kind == "backbone":
        raise stored.refused("of another kind; follow_resonance takes the place of backbones")
    allowed = f"of another kind; a {stored.kind} is read by its class, as by SweepResult.load"
    raise stored.refused(allowed)


# --- modes ----------------------------------------------------------------------------------------


def _pack_modes(modes: Modes) -> Parts:
    """Datasets of the modes; those of a structure without a mesh by its dofs (collective)."""
    whole = modes.structure.whole
    if whole.drawable_nodes is None:
        by_dof = gather_rows(whole.comm, modes.structure.expand(modes.shapes.T).T)
        return {"omega": modes.omega, "shapes": by_dof.T}
    mesh = NodalMesh(modes.structure)
    shapes = mesh.nodal_vectors(modes.structure.expand(modes.shapes.T))
    return {"omega": modes.omega, "nodes": _marks(mesh), "shapes": shapes}


def _unpack_modes(parts: Parts, structure: Structure, contact: Law = None) -> Modes:
    """Modes from these datasets, on any number of ranks (collective).

    Raises
    ------
    InputError
        The structure has other nodes, or another number of dofs.
    """
    omega, shapes, whole = parts["omega"], parts["shapes"], structure.whole
    check_shapes(parts, {"omega": (len(shapes),)})
    if whole.drawable_nodes is None:
        if "nodes" in parts or shapes.ndim != 2 or shapes.shape[1] != whole.n_dofs:
            allowed = f"that of the file, {shapes.shape}"
            raise InputError("structure", f"{whole.n_dofs} dofs", allowed)
        own = slice(whole.first_dof, whole.first_dof + whole.n_local)
        return Modes(omega, shapes[:, own].T, whole)
    mesh = NodalMesh(structure)
    assert whole.nodes is not None
    from scipy.spatial import cKDTree  # takes a while, and is needed here alone

    marks, then, d = _marks(mesh), parts["nodes"], mesh.dimension
    check_shapes(parts, {"shapes": (len(omega), len(then), d), "nodes": (-1, 2 * d)})
    distance, place = cKDTree(then).query(marks)
    same = len(then) == len(marks) and len(set(place)) == len(place)
    if not same or distance.max() > 1e-6 * mesh.size:
        raise InputError("structure", f"{len(marks)} nodes", f"that of the file, {len(then)}")
    first = whole.comm.exscan(len(whole.nodes.points)) or 0
    mine = mesh.to_nodal_frames(shapes[:, place])[:, first : first + len(whole.nodes.points)]
    free = whole.nodes.dofs >= 0
    rows = np.zeros((len(omega), whole.n_local))
    rows[:, whole.nodes.dofs[free] - whole.first_dof] = mine[:, free]
    return Modes(omega, rows.T, whole)


def _marks(mesh: NodalMesh) -> np.ndarray:
    """Position of each node, and mean midpoint of its cells, by its crack face: (n, 2 d)."""
    sums, counts = np.zeros_like(mesh.points), np.zeros((len(mesh.points), 1))
    middles = mesh.points[mesh.cells].mean(axis=1)
    for nodes in mesh.cells.T:
        np.add.at(sums, nodes, middles)
        np.add.at(counts, nodes, 1.0)
    return np.hstack([mesh.points, sums / counts])


# --- solutions ------------------------------------------------------------------------------------


def _pack_solution(solution: PeriodicSolution) -> Parts:
    of_report = {f"error_{name}": value for name, value in packed(solution.report).items()}
    parts = packed(solution, *_GIVEN, "displacement_coefficients", "stability")
    if is_rigid(solution.contact) and friction_of(solution.contact) is None:
        parts["weight"] = solution.contact.weight
    if solution.stability is not None:
        parts |= packed(solution.stability)
    return parts | of_report | _law_parts(solution.contact, solution.structure)


def _unpack_solution(parts: Parts, structure: Structure, contact: Law) -> PeriodicSolution:
    gap = parts["gap_coefficients"]
    shape = len(gap) | 1, gap.shape[-1]
    waves = "gap_coefficients", "force_coefficients"
    check_shapes(parts, dict.fromkeys([*waves, *(f"tangential_{name}" for name in waves)], shape))
    check_shapes(parts, {"multipliers": (max(np.size(parts.get("multipliers")), 1),)})
    _check_pairs(structure, gap)
    _check_law(parts, contact, structure)
    return solution_from(parts, structure, contact)


def solution_from(parts: Parts, structure: Structure, contact: Law) -> PeriodicSolution:
    """A solution from its waves, its errors and what else belongs to it (collective).

    Parameters
    ----------
    parts : dict
        The fields of the solution but for its displacement, which follows from the force; those of
        its stability; of its report as ``error_truncation``; and the ``weight`` of a constraint.
    structure, contact : Structure, ContactLaw or None
        Those with which it was found.

    Raises
    ------
    InputError
        The structure is another one.
    """
    gap, force = parts["gap_coefficients"], parts["force_coefficients"]
    _check_pairs(structure, gap)
    if is_rigid(contact) and friction_of(contact) is None:
        contact = UnilateralConstraint(parts.get("weight"))
    parts.setdefault("error_confirmed", True)  # of earlier versions
    errors = {f.name: parts[f"error_{f.name}"] for f in fields(ErrorReport)}
    omega, subharmonic = parts["omega"], parts["subharmonic"]
    if not omega >= 0.0 or subharmonic < 1:
        raise ValueError("its frequency does not fit")
    tangential = parts.get("tangential_force_coefficients")
    rows = force if tangential is None else np.hstack([force, tangential])
    seen = add_friction_pairs(contact, structure)
    compliance = make_compliance_model(seen, omega / subharmonic, len(gap) // 2, subharmonic)
    displacement = compliance.displacement(rows)
    compliance.destroy()
    solution = unpacked(
        PeriodicSolution,
        parts,
        structure=structure,
        contact=contact,
        displacement_coefficients=displacement,
        stability=unpacked(Stability, parts) if "multipliers" in parts else None,
    ).reported(unpacked(ErrorReport, errors))
    if solution.converged:
        _check_gap(structure, displacement, gap, max(1e-6, 10.0 * solution.report.residual))
    return solution


def _check_pairs(structure: Structure, gaps: np.ndarray) -> None:
    """Raise InputError unless gaps (..., n_pairs) have as many pairs as the structure."""
    if gaps.shape[-1] != structure.n_pairs:
        allowed = f"one with {gaps.shape[-1]} pairs"
        raise InputError("structure", f"{structure.n_pairs} pairs", allowed)


def _check_gap(
    structure: Structure, displacement: np.ndarray, gap: np.ndarray, tolerance: float
) -> None:
    """Raise InputError unless displacement and gap coefficients agree, to rounding of the common
    motion of crack faces that the load presses together (collective)."""
    closing = structure.apply_bt(displacement)
    carried = structure.sum_over_ranks(np.abs(displacement) @ abs(structure.gap))
    size = tolerance * np.linalg.norm(closing) + NEGLIGIBLE * np.linalg.norm(carried)
    closing[0] -= structure.clearance
    if not np.linalg.norm(closing - gap) <= size:  # nan neither
        raise InputError("structure", "another load, mesh or material", "that of the file")


# --- curves ---------------------------------------------------------------------------------------


def _pack_curve(curve: ResponseCurve) -> Parts:
    """Return the parts of a curve, and its special points; of exact orbits the verdicts follow."""
    special = curve.at_bifurcations.part(slice(1, -1))
    parts = packed(curve, *_GIVEN, "points")
    parts["kinds"] = [b.kind for b in curve.bifurcations]
    points = {"values": special.values, "omega": special.omega}
    if curve.exact:
        parts |= _of_dofs(curve) | {"couplings": _couplings(curve.structure)}
        points |= _of_dofs(special) | {"multipliers": special.multipliers}
    else:
        parts |= {"unknowns": curve.points, "undecided": curve.undecided}
        points |= {str(number): point for number, point in enumerate(special.points)}
    parts |= {f"bifurcation_{name}": value for name, value in points.items()}
    return parts | _law_parts(curve.contact, curve.structure)


def _of_dofs(curve: ResponseCurve) -> Parts:
    """States of exact orbits: displacements [m] and velocities [m/s] of the modes that move, by
    dof, whose signs are known: (n, 2, n_dofs); and with friction the places where pairs stick:
    (n, n_pairs) [m]."""
    moved, places = [], []
    for value, state in zip(curve.values.tolist(), curve.points, strict=True):
        shapes = all_modes(curve.problem_at(value).structure).shapes
        moves, sticks = np.split(state, [2 * shapes.shape[1]])
        moved.append(moves.reshape(2, -1) @ shapes.T)
        places.append(sticks)
    structure, count = curve.structure, len(curve)
    found = {"states": np.reshape(moved, (count, 2, structure.n_dofs))}
    if friction_of(curve.contact) is not None:
        found["places"] = np.reshape(places, (count, structure.n_pairs))
    return found


def _unpack_curve(parts: Parts, structure: Structure, contact: Law) -> ResponseCurve:
    if not is_small(structure):
        structure = reduce_structure(structure, method="massless")
    _check_law(parts, contact, structure)
    exact = "states" in parts
    counts = {"": parts["values"].size, "bifurcation_": len(parts["kinds"])}
    missing = exact and not {"multipliers", "tolerance", "bifurcation_multipliers"} <= parts.keys()
    if (
        missing
        or parts["parameter"] not in EQUATIONS_CLASS_BY_PARAMETER
        or parts["subharmonic"] < 1
    ):
        raise ValueError("its parts do not fit")
    numbers = "values", "omega", "iterations", "multipliers", "undecided", "irregular"
    shapes: Shapes = {f"{at}{name}": (n,) for at, n in counts.items() for name in numbers}
    given: Parts = {"structure": structure, "contact": contact, "bifurcations": ()}
    special: Sequence[np.ndarray]
    if exact:
        signs = _signs(structure, parts["couplings"])
        for at, count in counts.items():
            shapes[f"{at}states"] = count, 2, structure.n_dofs
            shapes[f"{at}places"] = count, structure.n_pairs
        check_shapes(parts, shapes)
        curve = unpacked(ResponseCurve, parts, **given, points=parts["states"])
        points, special = (_read_states(parts, at, curve, signs) for at in counts)
        curve = replace(curve, points=points)
        if not curve.orbit(0).residual <= 1e-4:  # nan neither
            raise InputError("structure", "another load, mesh or material", "that of the file")
    else:
        names = [f"bifurcation_{number}" for number in range(len(parts["kinds"]))]
        unknowns = parts["unknowns"]
        seen = add_friction_pairs(contact, structure)
        _check_pairs(seen, unknowns)
        shapes["unknowns"] = counts[""], unknowns.shape[1] | 1, seen.n_pairs
        shapes |= {name: (len(parts[name]) | 1, seen.n_pairs) for name in names}
        check_shapes(parts, shapes)
        special = [resize_harmonics(parts[name], unknowns.shape[1] // 2) for name in names]
        if "undecided" in parts:  # of earlier versions, whose multiplier decides nothing there
            parts["multipliers"] = np.where(parts["undecided"], np.nan, parts["multipliers"])
        curve = unpacked(ResponseCurve, parts, **given, points=unknowns, tolerance=None)
        first = curve.solution(0)
        _check_gap(first.structure, first.displacement_coefficients, first.gap_coefficients, 1e-4)
    values = parts["bifurcation_values"].tolist()
    frequencies = parts.get("bifurcation_omega", [curve.problem_at(v).omega for v in values])
    multipliers = parts["bifurcation_multipliers"][:, None] if exact else [None] * len(values)
    columns = zip(parts["kinds"], values, frequencies, special, multipliers, strict=True)
    return replace(curve, bifurcations=tuple(curve.bifurcation(*point) for point in columns))


def _read_states(parts: Parts, at: str, curve: ResponseCurve, signs: np.ndarray) -> np.ndarray:
    """States in modes of those by dofs, of all points or of the special ones."""
    values, of_dofs = parts[f"{at}values"], signs * parts[f"{at}states"]
    places = parts.get(f"{at}places", np.zeros((len(values), 0)))
    inverses = (all_modes(curve.problem_at(value).structure).inverse for value in values.tolist())
    each = zip(inverses, of_dofs, places, strict=True)
    return np.array([np.append((moved @ inverse.T).ravel(), held) for inverse, moved, held in each])


# --- motion in time -------------------------------------------------------------------------------


def _pack_history(history: TimeHistory) -> Parts:
    if history.structure.comm.size > 1:
        raise InputError("result", "spread over several ranks", "a time history of one rank")
    parts = packed(history, *_GIVEN, "final_state")
    parts["couplings"] = _couplings(history.structure)
    parts["final_state"] = history.final_state[:2]
    if history.friction is not None:
        parts["final_places"] = history.final_state[2]
    return parts


def _unpack_history(parts: Parts, structure: Structure, contact: Law) -> TimeHistory:
    signs = _signs(structure, parts["couplings"])
    count, dofs = parts["time"].size, parts["recorded_dofs"]
    shapes: Shapes = {"time": (count,), "recorded_dofs": (dofs.size,)}
    of_pairs = "gap", "contact_force", "tangential_gap", "tangential_force"
    shapes |= {name: (count, structure.n_pairs) for name in of_pairs}
    shapes |= {"recorded": (count, dofs.size), "final_state": (2, structure.n_local)}
    shapes |= {"final_places": (structure.n_pairs,)}
    check_shapes(parts, shapes)
    if parts["steps_per_period"] < 1 or count % parts["steps_per_period"]:
        raise ValueError("it does not hold whole periods")
    places = (parts["final_places"],) if "final_places" in parts else ()
    state = (*(signs * parts["final_state"]), *places)
    parts["recorded"] = signs[parts["recorded_dofs"] - structure.first_dof] * parts["recorded"]
    return unpacked(TimeHistory, parts, structure=structure, final_state=state)


# --- dofs and laws --------------------------------------------------------------------------------


def _couplings(structure: Structure) -> np.ndarray:
    """B^T and the load, by which a file identifies the dofs: (n_pairs + 2K+1, n_local)."""
    return np.vstack([structure.gap.toarray().T, structure.force])


def _signs(structure: Structure, then: np.ndarray) -> np.ndarray:
    """Signs (n_local,) of the dofs since a file: those of modes found again may differ."""
    now = _couplings(structure)
    if then.shape != now.shape:
        found = f"{structure.n_local} dofs, {structure.n_pairs} pairs"
        allowed = f"one with {then.shape[1]} dofs and {len(then) - len(structure.force)} pairs"
        raise InputError("structure", found, allowed)
    signs = np.where((then * now).sum(axis=0) < 0.0, -1.0, 1.0)
    largest = np.abs(then).max(axis=1, initial=0.0, keepdims=True)
    if np.any(np.abs(then - now * signs) > 1e-6 * largest):
        raise InputError("structure", "other load or pairs", "that of the file")
    return signs


LAW_GAPS = np.concatenate([sign * np.logspace(-12, 1, 27) for sign in (-1.0, 1.0)])
"""Gaps at which the forces of a user's law are evaluated [m]."""


def _law_parts(contact: Law, structure: Structure) -> Parts:
    """Name, stiffness and sharpness of a law, or forces of one's own, by which a file identifies
    it."""
    names = (
        "stiffness", "sharpness", "coefficient", "tangential_stiffness", "direction", "turning",
    )  # fmt: skip
    values = {f"law_{name}": getattr(contact, name, None) for name in names}
    known = {name: value for name, value in values.items() if value is not None}
    if contact is not None and "law_sharpness" not in known and not is_unilateral(contact):
        with np.errstate(all="ignore"):  # gaps far from the structure's
            force = contact.force(np.outer(LAW_GAPS, np.ones(structure.n_pairs))).sum(axis=1)
        known["law_force"] = np.nan_to_num(force, posinf=LARGEST).clip(-LARGEST, LARGEST)
    return {"law": type(contact).__name__, **known}


def _check_law(parts: Parts, contact: Law, structure: Structure) -> None:
    """Raise InputError unless the law of the datasets is the one given."""
    now = _law_parts(contact, structure)
    names = {"law", "law_stiffness", "law_sharpness", "law_force"} | now.keys()
    then = {name: parts[name] for name in names if name in parts}
    force, forces = now.pop("law_force", None), then.pop("law_force", None)
    same = now.keys() == then.keys() and now["law"] == then["law"]
    if not same or not all(np.allclose(now[n], then[n], rtol=1e-9) for n in now if n != "law"):
        raise InputError("contact", now, f"the law of the file: {then}")
    if forces is not None and not np.allclose(force, forces, rtol=1e-9, atol=0.0):
        raise InputError("contact", contact, "the law of the file: its forces are others")


_GIVEN = ("structure", "contact", "bifurcations", "others", "assessment", "estimate")
"""Fields that are not in a file, or by other datasets."""
Pack = Callable[[Any], Parts]
Unpack = Callable[[Parts, Structure, Law], Result]
_FORMS: dict[type[Result], tuple[Pack, Unpack]] = {
    Modes: (_pack_modes, _unpack_modes),
    PeriodicSolution: (_pack_solution, _unpack_solution),
    ResponseCurve: (_pack_curve, _unpack_curve),
    TimeHistory: (_pack_history, _unpack_history),
}
