"""What is hidden of DOLFINx and its compilers."""

from __future__ import annotations

import logging
from pathlib import Path

import dolfinx
import pytest
import ufl
from mpi4py import MPI

from fenics_crack.fem import compat


def test_compiler_is_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing is told of forms compiled for the first time; warnings and other loggers are heard,
    and logging is left as it was."""
    ((name, options),) = compat._JIT.items()
    monkeypatch.setitem(compat._JIT, name, options | {"cache_dir": tmp_path})
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    before = logging.root.level, list(logging.root.filters), logging.root.manager.disable
    space = compat.function_space(mesh, 1)
    compat.assembled_matrix(ufl.inner(ufl.TrialFunction(space), ufl.TestFunction(space)) * ufl.dx)
    assert list(tmp_path.glob("*.so")) and not caplog.records
    caplog.set_level(logging.INFO, "user")
    with compat._quiet_compiler():
        logging.warning("of the compiler")
        logging.getLogger("user").info("of the user")
    assert caplog.messages == ["of the compiler", "of the user"]
    assert before == (logging.root.level, logging.root.filters, logging.root.manager.disable)
