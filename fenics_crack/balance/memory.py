"""Memory that the equations need, stated before it is spent."""

from __future__ import annotations

from fenics_crack.errors import InputError
from fenics_crack.model.memory import machine_memory
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.krylov import RESTART

__all__ = ["check_memory"]

MATRICES = 4
"""Dense matrices of the size of the Jacobian that are held at a time."""


def check_memory(structure: Structure, harmonics: int) -> None:
    """Raise InputError where the dense Jacobian of the condensed equations would not fit, or that
    of coupled pairs at all instants."""
    pairs = structure.n_pairs
    if structure.light_lips:
        _check_coupled(pairs, harmonics)
        return
    unknowns = (2 * harmonics + 1) * pairs
    memory = machine_memory()
    if MATRICES * 8 * unknowns**2 > 0.8 * memory:
        fits = int((0.8 * memory / (8 * MATRICES)) ** 0.5 / (2 * pairs) - 0.5)
        raise InputError(
            "harmonics",
            harmonics,
            f"at most {fits} with {pairs} pairs: {unknowns} unknowns need "
            f"{MATRICES * 8 * unknowns**2 / 2**30:.0f} GiB of this machine's {memory / 2**30:.0f}",
        )


def _check_coupled(pairs: int, harmonics: int) -> None:
    memory = machine_memory()
    vectors = RESTART * (8 * harmonics + 2) * pairs  # of GMRES, for twice the harmonics
    needed = 8 * (MATRICES * (8 * harmonics + 2) * pairs**2 + vectors)
    if needed > 0.8 * memory:
        fits = int(harmonics * 0.8 * memory / needed)
        raise InputError(
            "harmonics",
            harmonics,
            f"at most {fits} with {pairs} pairs: {needed / 2**30:.0f} GiB are needed of this "
            f"machine's {memory / 2**30:.0f}",
        )
