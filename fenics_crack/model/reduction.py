"""Reduced structures: few coordinates that carry the same contact pairs, load and damping.

The displacement is sought in the span of a basis T, u = T q:

- ``massless``: the lowest modes Phi with free crack faces, and all that they leave out without mass
  (:class:`fenics_crack.model.reduced.MasslessStructure`). Crack faces with mass bounce on stiff
  contact, at frequencies of the mesh; these do not. The compliance seen by the pairs is exact at w
  = 0, and wrong by a mode's share (w/w_j)^2 / (1 - (w/w_j)^2) of its static one for each mode left
  out;
- ``free_interface`` (MacNeal, Rubin): the lowest modes Phi with free crack faces, and for
  every pair and load the *residual attachment vector*, what the modes leave out of the static
  response,

      Psi = (K^-1 - Phi Lambda^-1 Phi^T) [B, f];

  the compliance seen by the pairs is then exact at w = 0 together with its derivative by w^2.

With mass, T is made M-orthonormal and K-diagonal: the reduced structure is diagonal. Its
*reference* has in addition the static response to the inertia of Psi, K^-1 M Psi, the next term of
the expansion in w^2; that of a massless one has twice the modes. The difference between both, over
the share of what is left out that the reference has, is the estimate of the reduction error. To the
order of w^2 modes that are left out change the compliance of pairs by w^2 B^T G M G B, G being the
flexibility that they have. Of its trace the reference of a massless one has a known share; a half
of it at most is used, as contact excites modes at their own frequencies, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_choice
from fenics_crack.basics.progress import begin
from fenics_crack.model.factor import Factor, factored_sum
from fenics_crack.model.modal import MAX_DENSE_SIZE
from fenics_crack.model.modes import (
    AS_ZERO,
    check_damped_modes,
    damped_modes,
    damping_on_modes,
    independent_part,
    multiply,
    solve_modes,
    solve_modes_with_factor,
)
from fenics_crack.model.receptance import ResidualFlexibility, loaded_parts, receptance
from fenics_crack.model.reduced import MasslessStructure, ReducedStructure, check_mass
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping, Structure

METHODS = ("massless", "free_interface")
LEAST_SHARE = 0.1
"""Smallest share of a reference that is used: with less it shows nothing of what is left out."""
MODES = 50
"""Modes kept of a large structure whose modes are all damped."""


def reduce_structure(
    structure: Structure,
    *,
    modes: int | None = None,
    method: str = "free_interface",
    reference: bool | int = True,
) -> ReducedStructure:
    """Reduce a structure to a few coordinates (collective).

    The displacement is sought as u = T q. T holds the lowest modes with an open crack, and what
    differs with the method. "massless": what the modes leave out answers quasi-statically, so crack
    faces have no mass (:class:`MasslessStructure`); for contact on many pairs. "free_interface":
    the static response to each pair's force and to the load.

    Where one ratio damps all modes, it damps all coordinates: these are the modes of the reduced
    structure. Rayleigh damping keeps its coefficients. Any other damping is projected; but with
    ``massless`` all modes that are kept are damped, those beyond the damped ones with the last
    ratio.

    Parameters
    ----------
    structure : Structure
        Structure to reduce.
    modes : int, optional
        Number of the lowest modes to keep; default: those that are damped, but 50 if all of more
        than 600 are; without damping, or with a matrix, 20.
    method : "massless" or "free_interface"
        Columns of T beside the modes.
    reference : bool or int
        Keep what estimates the error of the reduction, too: twice the modes, or more static shapes.
        With "massless" it may be the number of modes that do.

    Returns
    -------
    ReducedStructure
        On every rank; a :class:`MasslessStructure` with the method of this name.

    Raises
    ------
    InputError
        Unknown method, fewer modes than requested, or more than 600 dofs with a ratio for each.

    Examples
    --------
    >>> reduced = fc.reduce_structure(structure, modes=10)
    """
    check_choice("method", method, METHODS)
    check_mass(structure, "reduce the whole one")
    rule = _rule_of_all(structure)
    modal = rule is None and isinstance(structure.damping, ModalDamping)
    count = check_damped_modes(structure) if modal else None
    if modes is None:
        modes = min(20, structure.n_dofs) if count is None else count
        if rule is not None:
            modes = MODES if structure.n_dofs > MAX_DENSE_SIZE else structure.n_dofs
    whole = isinstance(modes, int | np.integer) and not isinstance(modes, bool)
    if not (whole and 1 <= modes <= structure.n_dofs):
        raise InputError("modes", modes, f"a whole number from 1 to n_dofs = {structure.n_dofs}")

    if method == "massless":
        return _massless(structure, int(modes), reference)

    if modal:  # more modes at once, which are kept
        damped_modes(structure)
    begin("reduction")
    with Factor(structure.stiffness, definite=True) as own:
        found = solve_modes_with_factor(own, structure, int(modes))
        kept, squares = found.shapes[:, :modes], found.omega[:modes] ** 2
        with _regular(own, structure, held=bool(squares[0] > 0.0)) as factor:
            # Static responses to forces of pairs and to the load, without the part of the modes.
            loaded = structure.force[loaded_parts(structure)]
            forces = np.vstack([structure.gap.T.toarray(), loaded])
            flexibility = ResidualFlexibility(structure, kept, squares, forces.T)
            static = flexibility.solve(factor, forces).T
            left = structure.sum_over_ranks((forces.T * static).sum(axis=0))
            static = static[:, ~_is_rounding(left, flexibility.modal.T, squares)]
            static = independent_part(structure, structure.mass, kept, static)
            if not reference:
                return _reduced(structure, kept, squares, static, None)
            following = [static, factor.solve(multiply(structure.mass, static).T).T]
            if rule is None and structure.damping_matrix is not None:
                damping = multiply(structure.damping_matrix, np.hstack([kept, static]))
                following.append(factor.solve(damping.T).T)
    finer = _reduced(structure, kept, squares, np.hstack(following), None)
    return _reduced(structure, kept, squares, static, finer)


def _massless(structure: Structure, modes: int, assessed: bool | int) -> MasslessStructure:
    """Reduce a structure to modes and a rest without mass.

    Its reference, by which it is assessed, has twice the modes, or ten more, where these leave
    something for every pair, without which it has mass, and no more than half of what the kept ones
    leave. Else it has all modes, or the number that is given. Its share is that of the inertia left
    out.
    """
    whole = structure.original
    twice, most = modes + max(modes, 10), whole.n_dofs - whole.n_pairs
    more = min(twice, most) if most > modes else whole.n_dofs
    if chosen := assessed is not True and assessed > modes:
        more = int(assessed)
    counts = (more, modes) if assessed else (modes,)
    known = receptance(whole, max(counts))
    if rigid := np.count_nonzero(known.squares[modes:] == 0.0):
        allowed = f"at least {modes + rigid}: all motions as a rigid body"
        raise InputError("modes", modes, allowed)
    if assessed and not chosen and more < twice and more == most:
        here = slice(whole.n_pairs)
        beyond, left = (np.diag(known.compliance_beyond(count))[here] for count in counts)
        if np.any(beyond > left - beyond):
            counts = (whole.n_dofs, modes)
            known = receptance(whole, whole.n_dofs)
    loaded, seen = loaded_parts(whole), known.modal.T
    parts, rows = len(loaded), len(known.modal) - np.count_nonzero(loaded)
    # The amplitudes of the load's parts are unknowns whose force is S times themselves.
    patterns = np.hstack([np.zeros((parts, rows)), np.eye(parts)[:, loaded]])
    inertias = [float(known.inertia_beyond(count).sum()) for count in counts]
    share = max(1.0 - inertias[0] / max(inertias[-1], 1e-300), LEAST_SHARE)
    share = min(share, 1.0 if counts[0] == whole.n_dofs else 0.5)
    own, reference = whole.damping, None
    damping: Any = own
    for count in counts:
        left = known.compliance_beyond(count)
        squares = known.squares[:count]
        lost = _is_rounding(np.diag(left), seen[:count], squares)
        left[lost] = left[:, lost] = 0.0  # forces that the kept modes carry alone
        if not isinstance(own, DampingRule | None):
            damping = _damping(whole, solve_modes(whole, count).shapes, squares)
        reference = MasslessStructure(
            whole,
            squares,
            damping,
            seen[:count, :rows],
            patterns @ np.hstack([known.modal[:, :count], left]),
            left,
            reference=reference,
            share=share if count == counts[-1] else 0.5,
        )
    assert reference is not None
    return reference._in_setting(structure.setting)


def _is_rounding(left: np.ndarray, seen: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Return True for forces whose residual flexibility, beyond the modes, is only rounding."""
    elastic = squares > 0.0
    carried = np.sum(seen[elastic] ** 2 / squares[elastic, None], axis=0)
    return np.asarray(left <= AS_ZERO * carried)


def _rule_of_all(structure: Structure) -> DampingRule | None:
    """Damping rule of all modes, also of those of the reduced structure: one ratio, or Rayleigh's
    coefficients; else None. InputError for too many ratios."""
    damping = structure.damping
    if isinstance(damping, RayleighDamping):
        return damping
    if not isinstance(damping, ModalDamping) or damping.modes not in (None, structure.n_dofs):
        return None
    if isinstance(damping.ratio, float):
        return ModalDamping(damping.ratio)
    if structure.n_dofs <= MAX_DENSE_SIZE:
        return None
    found = f"{len(damping.ratio)} ratios for all {structure.n_dofs} modes"
    allowed = (
        "one ratio, or ratios of the lowest damping.modes, as there are more than "
        f"{MAX_DENSE_SIZE} dofs"
    )
    raise InputError("damping ratio", found, allowed)


@contextmanager
def _regular(factor: Factor, structure: Structure, *, held: bool) -> Iterator[Factor]:
    """The factor of K; of a structure that nothing holds that of K + s M, s one of its lowest
    eigenvalues."""
    if held:
        yield factor
        return
    elastic = (
        solve_modes_with_factor(factor, structure, min(structure.n_dofs, 10)).omega[-1] ** 2 or 1.0
    )
    with factored_sum(structure.stiffness, elastic, structure.mass, definite=True) as regular:
        yield regular


def _reduced(
    structure: Structure,
    kept: np.ndarray,
    squares: np.ndarray,
    extra: np.ndarray,
    reference: ReducedStructure | None,
) -> ReducedStructure:
    """Reduce to known modes and the rest of other vectors, made M-orthonormal and K-diagonal."""
    extra = independent_part(structure, structure.mass, kept, extra)
    elastic = structure.sum_over_ranks(extra.T @ multiply(structure.stiffness, extra))
    more, rotation = np.linalg.eigh(elastic)
    extra = extra @ rotation
    basis = np.hstack([kept, extra])
    squares = np.concatenate([squares, more])
    damping = _damping(structure, basis, squares)
    return ReducedStructure(structure, basis, squares, damping, reference)


def _damping(
    structure: Structure, basis: np.ndarray, squares: np.ndarray
) -> DampingRule | np.ndarray | None:
    """T^T C T, or one ratio for all; a rule where it is diagonal, else a matrix.

    T^T M T = I and T^T K T is diagonal: Rayleigh's coefficients stay.
    """
    if structure.damping is None:
        return None
    if (rule := _rule_of_all(structure)) is not None:
        return rule
    rate, omega = damping_on_modes(structure, basis, squares), np.sqrt(np.maximum(squares, 0.0))
    if rate.ndim == 2:
        return rate
    if np.any(rate[omega == 0.0] > 0.0):  # no ratio damps a motion as a rigid body
        return np.diag(rate)
    ratio = np.divide(rate, 2.0 * omega, out=np.zeros_like(rate), where=omega > 0.0)
    return ModalDamping(tuple(np.maximum(ratio, 0.0)))
