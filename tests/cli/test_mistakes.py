"""Slips of units and keys: the table in docs/short_answers.md and further ones, line by line."""

import re
from pathlib import Path

import pytest
from helpers import ROOT
from surroundings import RunCommand, main

PAGE = (ROOT / "docs" / "short_answers.md").read_text()
FURTHER = Path(__file__).with_name("mistakes.txt").read_text()
LINES = re.findall(r"^\| ([^|]+?) \| (`[^|]+`) \| ([^|]+?) \|$", PAGE + FURTHER, re.M)[1:]
KEYS = "mesh.size=0.05", "mesh.lip_elements=6", "mesh.error=false"
COARSE = [word for key in KEYS for word in ("--set", key)]
"""The new scene's mesh takes several times as long, and has no error to be remarked on; slips of
the mesh itself come after."""


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new scene."""
    path = tmp_path_factory.mktemp("mistakes") / "plate.toml"
    assert main(["new", str(path), "--quiet"]) == 0
    return path


def test_table_is_long_enough(plate: Path, run_command: RunCommand) -> None:
    """Twenty slips at least; and the scene without any gets no remark."""
    assert len(LINES) >= 20
    assert run_command("check", plate, *COARSE).err == ""


@pytest.mark.drawn(16)
@pytest.mark.parametrize(("slip", "changes", "answer"), LINES, ids=[line[0] for line in LINES])
def test_slip(
    slip: str, changes: str, answer: str, plate: Path, capsys: pytest.CaptureFixture
) -> None:
    """An error ends the command; a remark names the key that was changed, in one line."""
    pairs = re.findall(r"`([^`]+)`", changes)
    options = (word for key in pairs for word in ("--set", key))
    code = main(["check", str(plate), "--fresh", *COARSE, *options])
    message_lines = capsys.readouterr().err.splitlines()
    is_error = answer.startswith("error: ")
    assert code == (2 if is_error else 0), slip
    parts = [re.escape(part) for part in answer.removeprefix("error: ").split(" ... ")]
    assert any(re.search(".*".join(parts), line) for line in message_lines), message_lines
    assert len(message_lines) == 1, message_lines
    assert any(key.partition("=")[0].split(".")[0] in message_lines[0] for key in pairs)
