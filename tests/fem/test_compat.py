"""What is hidden of DOLFINx and its compilers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from helpers import DEMOS

PROGRAM = f"""
import logging
import cffi
import fenics_crack as fc
heard = []
class Heard(logging.Handler):
    def emit(self, record):
        heard.append(record.getMessage())
def told(self, *given, **options):
    logging.warning("of the compiler")
    logging.getLogger("user").info("of the user")
    return compile(self, *given, **options)
compile, cffi.FFI.compile = cffi.FFI.compile, told
logging.root.addHandler(Heard())
logging.getLogger("user").setLevel(logging.INFO)
root = logging.root
before = root.level, [*root.filters], root.manager.disable
fc.build_structure(fc.Scene.load({str(DEMOS / "paper_plate.toml")!r}))
assert before == (root.level, root.filters, root.manager.disable)
assert heard == len(heard) // 2 * ["of the compiler", "of the user"] != [], heard
"""


def test_compiler_is_quiet(tmp_path: Path) -> None:
    """Nothing is told of forms compiled for the first time; warnings and other loggers are heard,
    and logging is left as it was."""
    new = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=new, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and not done.stdout + done.stderr, done.stderr
    assert list(tmp_path.rglob("*.so"))
