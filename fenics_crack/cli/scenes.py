"""The commands before anything is solved: ``new`` and ``check``."""

from __future__ import annotations

import itertools
from importlib import resources
from pathlib import Path

import numpy as np

from fenics_crack.balance.memory import check_memory
from fenics_crack.cli.console import Console
from fenics_crack.cli.exit_codes import Exit
from fenics_crack.cli.remarks import highest_omega, remark_on_whole
from fenics_crack.errors import InputError
from fenics_crack.files.store import make_folder
from fenics_crack.model.contact import is_rigid
from fenics_crack.parallel import gather_rows, on_root
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import check_memory_of, prepare, reduction_of
from fenics_crack.sweep.plan import Plan
from fenics_crack.table import Table, counted

__all__ = ["check", "new"]

MAX_CHECKED = 10_000
"""Cases of a sweep that are checked before it is run."""


def new(path: Path, console: Console) -> Exit:
    """Write a commented scene to start from."""

    def write() -> None:
        text = resources.files("fenics_crack.cli").joinpath("new_scene.toml").read_text("utf-8")
        try:
            make_folder(path)
            with open(path, "x", encoding="utf-8") as file:
                file.write(text.replace("SCENE", path.name))
        except FileExistsError:
            raise InputError("scene", str(path), "a new file; there is one already") from None
        except OSError as error:
            allowed = f"a file that can be written ({error.strerror})"
            raise InputError("scene", str(path), allowed) from None

    on_root(console.comm, write)
    console.note(f"{path}: a scene to start from; now: fenics-crack check {path}")
    return Exit.DONE


def check(scene: Scene, console: Console) -> Exit:
    """Mesh and assemble a scene, and print what it has."""
    study = prepare(scene, console.comm, whole=True)
    whole, law, crack = study.structure, study.contact, study.scene.crack
    harmonics = scene.harmonic_balance.harmonics
    check_memory(whole, harmonics)
    assert whole.nodes is not None
    points = gather_rows(console.comm, whole.nodes.points)
    rows: dict[str, object] = {
        "width x height [m]": "{:g} x {:g}".format(*np.ptp(points, axis=0)),
        "degrees of freedom": whole.n_dofs,
    }
    if law is not None:
        rows["contact law"] = scene.contact.law  # type: ignore[union-attr]
    if law is not None and not is_rigid(law):
        stiffness = np.broadcast_to(law.stiffness, whole.n_pairs)
        rows["softest pair [N/m]"] = float(stiffness.min())
        rows["stiffest pair [N/m]"] = float(stiffness.max())
    if crack is not None and crack.length is not None:
        rows["crack length [m]"] = crack.length
    rows["contact pairs"] = whole.n_pairs
    rows["harmonics"] = harmonics
    rows["unknowns of harmonic balance"] = (2 * harmonics + 1) * whole.n_pairs
    rows["solved"] = "as it is"
    if reduction := reduction_of(scene, whole):
        modes = counted(int(reduction.modes or scene.damping.modes), "mode")
        rows["solved"] = f"reduced, {reduction.method}, {modes}"
        if reduction.method == "massless":
            rows["solved"] = f"{modes}, lips without mass"
    rows["memory, estimated [GiB]"] = round(check_memory_of(scene, whole) / 2**30, 2)
    if scene.curve is not None:
        span = f"{scene.curve.start:g} to {scene.curve.stop:g}"
        rows["curve"] = f"{scene.curve.parameter} from {span}"
    if scene.sweep is not None:
        rows["sweep"] = " x ".join(f"{len(axis.values)} {axis.key}" for axis in scene.sweep.over)
        rows["cases of the sweep"] = scene.sweep.n_cases
        rows["of them impossible"] = on_root(console.comm, lambda: _impossible(scene))
    highest = max(highest_omega(scene, command) for command in ("solve", "curve", "sweep"))
    remark = remark_on_whole(scene, whole, highest)
    console.table(Table(("what", "value"), [*rows.items()]))
    console.note(remark)
    return Exit.DONE


def _impossible(scene: Scene) -> str:
    """How many cases of a sweep cannot be scenes, and why the first one cannot."""
    plan = Plan(scene)
    places = itertools.islice(np.ndindex(*plan.shape), MAX_CHECKED)
    reasons = [case for case in map(plan.case, places) if isinstance(case, str)]
    more = f" of the first {MAX_CHECKED}" if np.prod(plan.shape) > MAX_CHECKED else ""
    return f"{len(reasons)}{more}" + (f": {reasons[0]}" if reasons else "")
