"""The page that follows one solve: every function that it names is entered."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import FrameType

import pytest
from helpers import ROOT

import fenics_crack as fc
from fenics_crack.cli.command_line import main

PLATE = """
geometry = { width = 0.1, height = 0.1, thickness = 0.01 }
crack = { edge = "left", height = 0.05, length = 0.03 }
material = { young = 2e9, poisson = 0.3, density = 7800.0 }
damping = { ratio = 0.02 }
excitation = { omega = 1000.0, point = [0.1, 0.1], force_sin = [1.0, 0.0] }
contact = { law = "unilateral" }
mesh = { layout = "graded", size = 0.03, lip_elements = 4 }
"""


def test_named_functions_are_entered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the files that the page gives for them."""
    monkeypatch.chdir(tmp_path)
    Path("plate.toml").write_text(PLATE)
    entered_functions = set()

    def note_function(frame: FrameType, event: str, argument: object) -> None:
        entered_functions.add((frame.f_code.co_filename, frame.f_code.co_qualname))

    sys.setprofile(note_function)
    try:
        exit_code = main(["solve", "plate.toml"])
    finally:
        sys.setprofile(None)
    assert exit_code in (0, 4)
    named_functions = re.findall(
        r"`([\w.]+)` \(`(\w+/\w+\.py)`\)", (ROOT / "docs" / "one_solve.md").read_text()
    )
    assert len(named_functions) > 30
    folder = Path(fc.__file__).parent
    for name, path in named_functions:
        names = {
            entered_name for file, entered_name in entered_functions if file == str(folder / path)
        }
        assert any(
            entered_name == name or entered_name.startswith(f"{name}.") for entered_name in names
        ), name
