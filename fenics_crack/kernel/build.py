"""Build of the compiled kernel, by cffi from the C files in this folder.

``install.sh`` has it built by pip. After a change of the C files this builds it again, in some ten
seconds, into this folder or into another one:

    .venv/bin/python fenics_crack/kernel/build.py [--sanitize] [FOLDER]

With ``--sanitize`` the compiler adds checks of addresses and of undefined behaviour: so
``tests/balance/test_kernel.py`` runs once more.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from pathlib import Path

from cffi import FFI

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FLAGS = [
    "-std=c11", "-O2", "-ftree-vectorize", "-fvect-cost-model=dynamic", "-g0", "-fno-math-errno",
    "-ffp-contract=off", "-fvisibility=hidden",
]  # fmt: skip
"""Loops become vectors as by -O3, which compiles a fifth longer and is no faster here. No
contraction of products and sums: results do not depend on the processor. Names of functions are
hidden: those of other libraries in the process do not get in their way. Symbols for debuggers, for
which Python's own options ask, would take a fifth of the time."""
CALLED_BACK = """
extern "Python" {
    int python_evaluate(equations *at, const double *x, double p);
    void python_residual(const equations *at, double *found);
    void python_solve(equations *at, double *x);
    void python_by_parameter(equations *at, double *found);
    double python_sign(equations *at);
    void python_record(equations *at, double *found);
}
"""
"""Functions of equations in Python (``numerics/equations.py``)."""
FOR_WRAPPERS = '#pragma GCC optimize ("O0")'
"""What cffi writes behind the headers hands arguments over; -O3 would take four times as long."""
SANITIZER = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]


def builder_in(folder: Path, *, sanitize: bool = False) -> FFI:
    """Return the builder of the module, with its sources' paths relative to a folder, or whole."""
    headers, sources = in_order(sorted(HERE.glob("*.h"))), sorted(HERE.glob("*.c"))
    here = HERE.relative_to(folder) if HERE.is_relative_to(folder) else HERE
    ffi, checks = FFI(), SANITIZER if sanitize else []
    for header in headers:  # cffi takes all but lines for the preprocessor
        ffi.cdef(re.sub(r"(?m)^#.*$", "", header.read_text(encoding="utf-8")))
    ffi.cdef(CALLED_BACK)
    ffi.set_source(
        "fenics_crack.kernel._kernel",
        "\n".join([*(f'#include "{header.name}"' for header in headers), FOR_WRAPPERS]),
        sources=[str(here / source.name) for source in sources],
        include_dirs=[str(here)],
        depends=[str(here / header.name) for header in headers],
        extra_compile_args=[*FLAGS, *checks],
        extra_link_args=checks,
        libraries=["m"],
    )
    return ffi


def in_order(headers: list[Path]) -> list[Path]:
    """Each header behind those that it includes."""
    found: list[Path] = []
    for header in headers:
        included = re.findall(r'(?m)^#include "(.*)"', header.read_text(encoding="utf-8"))
        for one in (*in_order([HERE / name for name in included]), header):
            if one not in found:
                found.append(one)
    return found


def build(target: Path, *, sanitize: bool = False) -> None:
    """Compile the module into a folder."""
    with tempfile.TemporaryDirectory() as scratch:
        made = builder_in(Path(scratch), sanitize=sanitize).compile(tmpdir=scratch)
        module = target / "_kernel.abi3.so"  # as pip calls it
        fresh = shutil.copy(made, target / "_kernel.fresh")
        Path(fresh).replace(module)  # at once: processes that run keep what they have loaded


if __name__ == "__main__":
    asked = sys.argv[1:]
    folders = [Path(one) for one in asked if one != "--sanitize"]
    build((folders or [HERE])[0], sanitize="--sanitize" in asked)
else:
    builder = builder_in(ROOT)
