"""Memory that the equations need, stated before it is spent."""

from __future__ import annotations

from fenics_crack.errors import InputError
from fenics_crack.kernel import kernel
from fenics_crack.model.memory import machine_memory
from fenics_crack.model.structure import Structure

__all__ = ["check_memory"]

MATRICES = 4
"""Dense matrices of the size of the Jacobian that are held at a time, or stiffnesses of coupled
pairs at all instants."""


def check_memory(structure: Structure, harmonics: int) -> None:
    """Raise InputError where the dense Jacobian of the equations would not fit, or of coupled pairs
    what they are at all instants, and the vectors of solutions."""
    pairs = structure.n_pairs
    unknowns, order = (2 * harmonics + 1) * pairs, 2
    numbers = MATRICES * unknowns**2
    if structure.light_lips:  # of an estimate too, with twice the harmonics
        vectors = 2 * kernel.KRYLOV_MOST + 2  # those kept, and those of a solution
        numbers, order = 2 * (2 * MATRICES * pairs + vectors) * unknowns, 1
    memory = machine_memory()
    if 8 * numbers > 0.8 * memory:
        fits = int(harmonics * (0.1 * memory / numbers) ** (1.0 / order))
        raise InputError(
            "harmonics",
            harmonics,
            f"at most {fits} with {pairs} pairs: {unknowns} unknowns need "
            f"{numbers * 8 / 2**30:.0f} GiB of this machine's {memory / 2**30:.0f}",
        )
