"""Build of the compiled kernel, by cffi from the C files in this folder.

``install.sh`` builds the kernel through pip. After a change of the C files, build it again into
this folder or another folder, in about ten seconds:

    .venv/bin/python fenics_crack/kernel/build.py [--sanitize] [FOLDER]

With ``--sanitize`` the compiler adds checks of addresses and undefined behaviour, for
``tests/balance/test_kernel.py``.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from pathlib import Path

from cffi import FFI

KERNEL_FOLDER = Path(__file__).resolve().parent
PROJECT_ROOT = KERNEL_FOLDER.parents[1]
COMPILER_FLAGS = [
    "-std=c11",
    "-O2",
    "-ftree-vectorize",
    "-fvect-cost-model=dynamic",
    "-g0",
    "-fno-math-errno",
    "-ffp-contract=off",
    "-fvisibility=hidden",
]
"""Options of the compiler.

Loops become vectors as by -O3, which compiles a fifth longer and is no faster here.
Products and sums are not contracted, so results do not depend on the processor. Hidden function
names cannot clash with other libraries in the process. Without symbols for debuggers, a default
of Python's own options, compilation takes a fifth less time.
"""
PYTHON_CALLBACK_DECLARATIONS = """
extern "Python" {
    int python_evaluate(equations *table, const double *x, double p);
    void python_residual(const equations *table, double *residual_out);
    void python_solve(equations *table, double *x);
    void python_by_parameter(equations *table, double *derivative_out);
    double python_sign(equations *table);
    void python_record(equations *table, double *record_out);
}
"""
"""C declarations of callbacks to equations in Python (``numerics/equations.py``)."""
UNOPTIMISED_WRAPPERS_PRAGMA = '#pragma GCC optimize ("O0")'
"""C pragma before cffi's wrapper functions, to compile without optimisation. Wrappers only pass
arguments; -O3 would take four times as long to compile."""
SANITIZER_FLAGS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
"""Compiler and linker options for checks of addresses and undefined behaviour."""


def make_builder(folder: Path, *, sanitize: bool = False) -> FFI:
    """Return cffi's builder for the extension module ``_kernel``.

    Parameters
    ----------
    folder : Path
        Start folder for relative paths to the C files. Paths are absolute if the kernel's folder
        is outside.
    sanitize : bool
        True: add checks of addresses and undefined behaviour.
    """
    headers = sort_headers(sorted(KERNEL_FOLDER.glob("*.h")))
    source_paths = sorted(KERNEL_FOLDER.glob("*.c"))
    is_kernel_inside_folder = KERNEL_FOLDER.is_relative_to(folder)
    source_folder = KERNEL_FOLDER.relative_to(folder) if is_kernel_inside_folder else KERNEL_FOLDER
    ffi, sanitizer_flags = FFI(), SANITIZER_FLAGS if sanitize else []
    for header in headers:  # cffi does not take lines for the preprocessor
        ffi.cdef(re.sub(r"(?m)^#.*$", "", header.read_text(encoding="utf-8")))
    ffi.cdef(PYTHON_CALLBACK_DECLARATIONS)
    ffi.set_source(
        "fenics_crack.kernel._kernel",
        "\n".join(
            [*(f'#include "{header.name}"' for header in headers), UNOPTIMISED_WRAPPERS_PRAGMA]
        ),
        sources=[str(source_folder / source_path.name) for source_path in source_paths],
        include_dirs=[str(source_folder)],
        depends=[str(source_folder / header.name) for header in headers],
        extra_compile_args=[*COMPILER_FLAGS, *sanitizer_flags],
        extra_link_args=sanitizer_flags,
        libraries=["m"],
    )
    return ffi


def sort_headers(headers: list[Path]) -> list[Path]:
    """Sort C headers: included headers come first.

    Included headers of the kernel's folder are added to ``headers``.
    """
    sorted_headers: list[Path] = []
    for header in headers:
        include_names = re.findall(r'(?m)^#include "(.*)"', header.read_text(encoding="utf-8"))
        included_headers = sort_headers([KERNEL_FOLDER / name for name in include_names])
        for header_path in (*included_headers, header):
            if header_path not in sorted_headers:
                sorted_headers.append(header_path)
    return sorted_headers


def build(target_folder: Path, *, sanitize: bool = False) -> None:
    """Compile the C files into the module ``_kernel.abi3.so`` in ``target_folder``.

    ``sanitize`` adds checks of addresses and undefined behaviour.
    """
    with tempfile.TemporaryDirectory() as scratch_folder:
        builder = make_builder(Path(scratch_folder), sanitize=sanitize)
        compiled_path = builder.compile(tmpdir=scratch_folder)
        module_path = target_folder / "_kernel.abi3.so"  # as pip calls it
        fresh_path = shutil.copy(compiled_path, target_folder / "_kernel.fresh")
        # In one step: running processes keep the module that they have loaded.
        Path(fresh_path).replace(module_path)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    folders = [Path(argument) for argument in arguments if argument != "--sanitize"]
    build((folders or [KERNEL_FOLDER])[0], sanitize="--sanitize" in arguments)
else:
    builder = make_builder(PROJECT_ROOT)
