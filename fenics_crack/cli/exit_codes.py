"""How the program ends."""

from enum import IntEnum

__all__ = ["Exit"]


class Exit(IntEnum):
    """Exit codes; ``--help`` and docs/program.md explain them."""

    DONE = 0
    FAULT = 1
    BAD_INPUT = 2
    NOT_CONVERGED = 3
    STOPPED = 130
    READER_GONE = 141
