"""The command ``grow``: how a crack grows under the vibration of its plate."""

from __future__ import annotations

from argparse import Namespace
from functools import partial

from fenics_crack.cli.account import Account, in_one_unit
from fenics_crack.cli.commands import tell
from fenics_crack.cli.console import Console
from fenics_crack.cli.inputs import Inputs
from fenics_crack.draw.plot_growth import draw_growth
from fenics_crack.errors import Exit
from fenics_crack.growth.grow import Growth, grow
from fenics_crack.table import Table, quantity

__all__ = ["growth"]

SHOWN = 9
"""Rows that are printed; the file has all."""
ENDS = {
    "reached": "the length that was asked for is reached",
    "arrested": "there it stops: the range falls below growth.threshold",
    "broken": "there the plate breaks: K_max is growth.toughness",
}


def growth(_: Namespace, inputs: Inputs, console: Console) -> Exit:
    """Lengths that are left, and the cycles between them."""
    scene, folder = inputs.scene, inputs.folder
    with console.timed("growth"):
        found = grow(scene, folder, console.comm, progress=console.progress)
    draw = partial(draw_growth, found, in_hertz=scene.in_hertz)
    return tell(_account(found), folder, console, draw)


def _account(found: Growth) -> Account:
    """The table, the life and how sure it is."""
    table, count = found.table(), len(found.length)
    places = sorted({round(n * (count - 1) / (SHOWN - 1)) for n in range(SHOWN)})
    shown = Table(table.columns, [table.rows[place] for place in places])
    hours = found.time[-1] / 3600.0
    first, last = (quantity(float(found.length[end]), "m") for end in (0, -1))
    way = f"from {first} to {last} in {found.life:.4g} cycles ({hours:.4g} h)"
    fact = f"{way if count > 1 else first}: {ENDS[found.end]}"
    causes = [f"{name} {error:.2g}" for name, error in found.errors.items() if error > 0.0]
    known = f"the cycles are known within a factor of {found.factor:.3g}"
    known += f", standard deviations of their logarithm: {', '.join(causes)}" if causes else ""
    drop = f"the natural frequency of the breathing crack falls by {found.frequency_drop[-1]:.2%}"
    facts = [fact, known, drop]
    scene = found.scene
    return Account(
        "growth", table, shown=in_one_unit(shown, scene), notes=facts, warnings=[*found.remarks]
    )
