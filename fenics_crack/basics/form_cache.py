"""Compiled forms on disk: each in a folder of its own, which is complete or is not used.

Where a form has been begun and not completed, DOLFINx waits for whoever compiles it, who may have
been killed. So it compiles in a new folder, which is recorded once it is complete: a process reads
recorded folders only, and what two compile at once each has for itself. A folder that a kill leaves
is never read; it has the source of a form, some 100 kB.
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


def load_form(comm: MPI.Comm, record: Path, make: Callable[[dict[str, object]], Result]) -> Result:
    """Load a compiled form, or compile it (collective).

    Parameters
    ----------
    comm : MPI.Comm
        Communicator of the form's mesh.
    record : Path
        File that names the form's folder, beside it.
    make : callable
        Does so with the given options of DOLFINx.
    """
    folder, compiler = on_root(comm, lambda: _find_form_folder(record))
    before = os.environ.get("CC")
    # It ends with this program, however that ends, and Ctrl-C in a terminal does not reach it: the
    # program may have to finish a case first.
    os.environ["CC"] = f"setpriv --pdeathsig TERM setsid {compiler}"
    try:
        # Ranks of another machine, which have such a folder for themselves, wait [s] for one.
        form = make({"cache_dir": folder, "timeout": 300})
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        del os.environ["CC"]
        os.environ.update({"CC": before} if before else {})
    if compiler:
        on_root(comm, lambda: write_file_whole(folder.with_name(record.name), _record_text(folder)))
    return form


def _find_form_folder(record: Path) -> tuple[Path, str]:
    """Return the recorded folder and ""; a new one and a compiler if it is missing or damaged."""
    with report_write_errors(record.parent, "cache_dir", PRIVATE_FOLDER_REQUIREMENT):
        record = check_private_folder(record.parent) / record.name
    with suppress(OSError, ValueError):
        text = read_utf8_text(record)
        folder = record.with_name(text.partition("\n")[0])
        if _record_text(folder) == text:
            return folder, ""
    compiler = find_c_compiler()
    return Path(tempfile.mkdtemp(prefix="fenics_crack-", dir=record.parent)), compiler


def _record_text(folder: Path) -> str:
    """Name of a folder, and names and SHA-256 of its files: the text of its record."""
    return "\n".join(
        (folder.name, *(f"{file_sha256(f)} {f.name}" for f in sorted(folder.iterdir())))
    )
