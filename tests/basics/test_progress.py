"""Stages of a computation, on a terminal and elsewhere."""

import io
import logging
import time

import pytest

import fenics_crack as fc
from fenics_crack.basics import progress


class Terminal(io.StringIO):
    """A stream that says it is one."""

    def isatty(self) -> bool:
        """It is."""
        return True


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()], ids=["terminal", "file"])
def test_long_stages_leave_a_line(stream: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal shows each as it begins; only what took more than a second stays."""
    clock = iter([0.0, 0.5, 3.0, 3.1])
    monkeypatch.setattr(progress.time, "perf_counter", lambda: next(clock))
    with progress.StageLines(stream):
        progress.begin("mesh")
        progress.begin("natural modes")
        progress.begin("solution")
    clear = "\r\033[K"
    live = (
        f"  mesh ...{clear}  natural modes ...{clear}  natural modes: 2.5 s\n  solution ...{clear}"
    )
    assert stream.getvalue() == (live if stream.isatty() else "  natural modes: 2.5 s\n")
    progress.begin("nobody listens")


def test_stages_are_logged(paper_scene: fc.Scene, caplog: pytest.LogCaptureFixture) -> None:
    """Mesh, matrices, modes and attempts, in the order in which they happen."""
    caplog.set_level(logging.DEBUG, "fenics_crack")
    study = fc.prepare(paper_scene.replace({"mesh.columns": 8, "contact.stiffness": 1e9}))
    fc.solve_harmonic_balance(study.structure, 2000.0, study.contact, harmonics=5)
    assert caplog.messages[:2] == ["mesh", "matrices"]
    assert any(stage.endswith("natural modes") for stage in caplog.messages)
    assert "from fewer harmonics" in caplog.messages


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()], ids=["terminal", "file"])
@pytest.mark.parametrize("kept", [True, False], ids=["kept", "brief"])
def test_signs_of_life(stream: io.StringIO, kept: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes long says so now and then, while it computes, and not after its end."""
    monkeypatch.setattr(progress, "BEAT", 0.05)
    stream.seek(0)
    stream.truncate()
    with progress.StageLines(stream, kept=kept):
        progress.begin("path")
        time.sleep(0.3)
    shown = stream.getvalue()
    signs = shown.count("\r\033[K  path ... 0 s" if stream.isatty() else "  path ... 0 s\n")
    assert 3 <= signs <= 6
    time.sleep(0.1)
    assert stream.getvalue() == shown
