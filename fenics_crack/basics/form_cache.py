"""Keep compiled forms on disk, each in a folder that is complete or unused.

DOLFINx waits for an incomplete form until somebody completes it, and that process may have been
killed. So each form is compiled in a new folder, and recorded once this folder is complete. A
process reads recorded folders only. Two processes that compile at once have a folder each. A folder
left by a kill is never read; it holds the source of a form, about 100 kB.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from fenics_crack.basics.atomic_files import report_write_errors, write_file_whole
from fenics_crack.basics.caches import PRIVATE_FOLDER_REQUIREMENT, check_private_folder
from fenics_crack.basics.installation import find_c_compiler
from fenics_crack.basics.ranks import MPI, Result, on_root
from fenics_crack.basics.untrusted_files import file_sha256, read_utf8_text


def load_or_compile_form(
    comm: MPI.Comm, record_file: Path, compile_form: Callable[[dict[str, object]], Result]
) -> Result:
    """Load a compiled form from disk, or compile the form (collective).

    Parameters
    ----------
    comm : MPI.Comm
        Communicator of the form's mesh.
    record_file : Path
        File in the cache that names the form's folder beside it.
    compile_form : callable
        Function that loads or compiles the form, given options of DOLFINx.

    Returns
    -------
    Result
        The result of ``compile_form``.
    """
    form_folder, compiler_command = on_root(
        comm, lambda: _find_form_folder_and_compiler(record_file)
    )
    previous_compiler_command = os.environ.get("CC")
    # It ends with this program, however that ends, and Ctrl-C in a terminal does not reach it: the
    # program may have to finish a case first.
    os.environ["CC"] = f"setpriv --pdeathsig TERM setsid {compiler_command}"
    try:
        # Ranks of another machine, which have such a folder for themselves, wait [s] for one.
        compiled_form = compile_form({"cache_dir": form_folder, "timeout": 300})
    except BaseException:
        shutil.rmtree(form_folder, ignore_errors=True)
        raise
    finally:
        del os.environ["CC"]
        os.environ.update({"CC": previous_compiler_command} if previous_compiler_command else {})
    if compiler_command:
        on_root(
            comm,
            lambda: write_file_whole(
                form_folder.with_name(record_file.name), _form_record_text(form_folder)
            ),
        )
    return compiled_form


def _find_form_folder_and_compiler(record_file: Path) -> tuple[Path, str]:
    """Find a form's compiled folder, or make a new one for compiling.

    Returns
    -------
    folder : Path
        The folder in the record; a new folder if the record is missing, or files have changed.
    compiler : str
        Command of the C compiler; "" if nothing has to be compiled.
    """
    with report_write_errors(record_file.parent, "cache_dir", PRIVATE_FOLDER_REQUIREMENT):
        record_file = check_private_folder(record_file.parent) / record_file.name
    with suppress(OSError, ValueError):
        record_text = read_utf8_text(record_file)
        form_folder = record_file.with_name(record_text.partition("\n")[0])
        if _form_record_text(form_folder) == record_text:
            return form_folder, ""
    compiler_command = find_c_compiler()
    return Path(tempfile.mkdtemp(prefix="fenics_crack-", dir=record_file.parent)), compiler_command


def _form_record_text(form_folder: Path) -> str:
    """Return the record of a form's folder as text.

    First line: name of the folder. Further lines: SHA-256 and name of each file.
    """
    return "\n".join(
        (
            form_folder.name,
            *(f"{file_sha256(file)} {file.name}" for file in sorted(form_folder.iterdir())),
        )
    )
