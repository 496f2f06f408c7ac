"""Write CalculiX's motion of the paper's plate from rest, for the verification book.

    .venv/bin/python tests/verification/paper_plate.py

needs CalculiX (``apt-get install calculix-ccx``) and writes tests/exchange/paper_plate/: the input
file at 1e9 N/m, and for each contact stiffness five periods of the gap and of the corner's
horizontal displacement, 200 instants a period. With 1e11 N/m its steps are at most 1/800 of a
period: with 1/100, 1/200 and 1/400 it gives up at the first contact.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import inp
import numpy as np

import fenics_crack as fc

FOLDER = Path(__file__).parents[1] / "exchange" / "paper_plate"
SCENE = Path(__file__).parents[2] / "demos" / "paper_plate.toml"
CASES = {"1e9": (1e9, 0.01, 200), "1e11": (1e11, 0.001, 800)}
"""Contact stiffness [N/m], damping ratio xi of the first mode, CalculiX's least steps a period."""
PERIODS, INSTANTS = 5, 200


def scene_of(stiffness: float, ratio: float) -> fc.Scene:
    """The demo's scene with C = 2 xi K / w1, which both programs have.

    CalculiX integrates a pressure over the crack's one element, g of the mouth down to 0 at the
    tip: the force on the mouth is a third of pressure times area, so the pressure for each metre of
    depth is 3 k / (length thickness).
    """
    paper = fc.Scene.load(SCENE)
    first_omega = fc.solve_modes(fc.build_structure(paper), 1).omega[0]
    area = paper.crack.length * paper.geometry.thickness
    contact = {"law": "penalty", "stiffness_per_area": 3.0 * stiffness / area}
    tables = tomllib.loads(SCENE.read_text()) | {
        "damping": {"stiffness": 2.0 * ratio / first_omega}
    }
    return fc.Scene.from_mapping(tables | {"contact": contact})


def instants(scene: fc.Scene) -> np.ndarray:
    """Times of a history [s]."""
    return np.arange(PERIODS * INSTANTS) * (2.0 * np.pi / scene.excitation.omega / INSTANTS)


def write() -> None:
    """Run CalculiX and write what it finds."""
    FOLDER.mkdir(exist_ok=True)
    for name, (stiffness, ratio, steps) in CASES.items():
        scene = scene_of(stiffness, ratio)
        structure = fc.build_structure(scene)
        rest, corner = np.zeros(structure.n_dofs), structure.find_dof((0.1, 0.1), "x")
        deck = FOLDER / f"{name}.inp" if name == "1e9" else None
        time, motion = inp.transient(scene, structure, steps, PERIODS, (rest, rest), deck)
        waves = (structure.apply_bt(motion)[:, 0], motion[:, corner])
        table = np.column_stack([np.interp(instants(scene), time, wave) for wave in waves])
        head = f"{inp.calculix()}, {stiffness:g} N/m, {100 * ratio:g} %: gap [m], corner [m]"
        np.savetxt(FOLDER / f"{name}.csv", table, fmt="%.7e", delimiter=",", header=head)


if __name__ == "__main__":
    write()
