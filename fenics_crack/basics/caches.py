"""Find and fill the cache folders: compiled forms of DOLFINx, the font list of Matplotlib.

Both libraries read the folders from the environment when they are imported. They fail if the home
folder does not exist or takes no files, for example in containers and on clusters.

A compiled form has a folder that is complete or unused. DOLFINx waits for an incomplete form until
somebody completes it, and that process may have been killed. So each form is compiled in a new
folder, and recorded once this folder is complete. A process reads recorded folders only. Two
processes that compile at once have a folder each. A folder left by a kill is never read; it holds
the source of a form, about 100 kB.
"""

from __future__ import annotations

import os
import resource
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from fenics_crack.basics.atomic_files import report_write_errors, write_file_whole
from fenics_crack.basics.machine import find_c_compiler
from fenics_crack.basics.progress import USER_MESSAGE_LOGGER

if TYPE_CHECKING:
    from fenics_crack.basics.ranks import MPI, Result


PRIVATE_FOLDER_DESCRIPTION = "a folder that only this user can write to"
"""Description of a private folder, for errors and warnings."""


@lru_cache
def replace_unusable_caches() -> None:
    """Replace unusable home and cache folders by a private temporary folder.

    A home folder is unusable if it cannot be entered. A cache folder is unusable if it cannot be
    written, or if others can write it. A warning of one line names the replacement.

    Raises
    ------
    InputError
        The temporary folder cannot be written either.
    """
    home_folder = os.path.expanduser("~")
    if not (os.path.isdir(home_folder) and os.access(home_folder, os.X_OK)):
        _set_private_folder("HOME", Path(home_folder), "it is no folder that this user can open")
    cache_folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    try:
        check_private_folder(cache_folder / "fenics", makes_folder=False)
    except OSError as error:
        _set_private_folder("XDG_CACHE_HOME", cache_folder, f"{error.strerror}")
        os.environ.setdefault("MPLCONFIGDIR", os.environ["XDG_CACHE_HOME"])


def _set_private_folder(variable_name: str, unusable_path: Path, reason: str) -> None:
    """Set an environment variable to this user's private temporary folder.

    A warning names ``unusable_path`` and the ``reason``. InputError if the temporary folder is
    unusable, too.
    """
    with report_write_errors(unusable_path, variable_name, PRIVATE_FOLDER_DESCRIPTION):
        private_path = check_private_folder(
            Path(tempfile.gettempdir()) / f"fenics-crack-{os.geteuid()}", 0o77
        )
        check_private_folder(private_path, makes_folder=False)
    os.environ[variable_name] = str(private_path)
    # Python prints a warning without a handler.
    USER_MESSAGE_LOGGER.warning(
        "%s cannot be used for caches (%s), and %s is used instead; nothing needs to be done, "
        "unless you prefer another folder: set %s",
        unusable_path,
        reason,
        private_path,
        variable_name,
    )


def check_private_folder(
    folder_path: Path, forbidden_mode_bits: int = 0o22, *, makes_folder: bool = True
) -> Path:
    """Check that only this user and root can change a folder.

    Compiled programs are run from the folder: nobody else may put files into it, or replace it.

    Parameters
    ----------
    folder_path : Path
        The folder. Outer folders writable by others must be sticky, like ``/tmp``.
    forbidden_mode_bits : int
        Mode bits that the folder must not have; by default write permission for group and others.
    makes_folder : bool
        Make the folder and its outer folders. If False, the folder may be missing, and the disk
        must have room for a cache (4 MiB).

    Returns
    -------
    Path
        The folder's path without links.

    Raises
    ------
    OSError
        Others can write the folder, it cannot be written, or it has no room.
    """
    resolved_folder = folder_path.resolve()
    for ancestor in (*reversed(resolved_folder.parents), resolved_folder) if makes_folder else ():
        ancestor.mkdir(mode=0o700, exist_ok=True)
    folders_with_status = [
        (ancestor, ancestor.stat())
        for ancestor in (resolved_folder, *resolved_folder.parents)
        if ancestor.exists()
    ]
    for ancestor, folder_status in folders_with_status:
        is_sticky = folder_status.st_mode & 0o1000
        forbidden_bits = (
            forbidden_mode_bits if ancestor == resolved_folder else (0 if is_sticky else 0o22)
        )
        if folder_status.st_mode & forbidden_bits or folder_status.st_uid not in (0, os.geteuid()):
            raise OSError(0, f"others can write {ancestor}")
    with tempfile.TemporaryFile(dir=folders_with_status[0][0]) as temporary_file:
        if (
            not makes_folder
        ):  # it takes milliseconds; the forms of a scene take 1 to 2 MiB in many files
            os.posix_fallocate(
                temporary_file.fileno(),
                0,
                min(2**22, resource.getrlimit(resource.RLIMIT_FSIZE)[0] % 2**64),
            )
    return resolved_folder


# --- compiled forms -------------------------------------------------------------------------------


def load_or_compile_form(
    comm: MPI.Comm, record_file: Path, compile_form: Callable[[dict[str, object]], Result]
) -> Result:
    """Load a compiled finite-element form from disk, or compile the form (collective).

    Parameters
    ----------
    comm : MPI.Comm
        Communicator of the form's mesh.
    record_file : Path
        Text file in the cache. Its first line is the name of the folder with the compiled form; the
        further lines have a SHA-256 digest for each file in the folder.
    compile_form : callable
        Function that loads or compiles the form, given options for DOLFINx.

    Returns
    -------
    Result
        The result of ``compile_form``.
    """
    from fenics_crack.basics.ranks import on_root  # MPI: not for pictures

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
    """Find a finite-element form's compiled folder, or make a new folder for compiling.

    Parameters
    ----------
    record_file : Path
        Text file whose first line is the folder's name; the further lines have SHA-256 and name of
        each file in the folder.

    Returns
    -------
    folder : Path
        The folder in the record; a new folder if the record is missing, or files have changed.
    compiler : str
        Command of the C compiler; "" if nothing has to be compiled.
    """
    from fenics_crack.basics.untrusted_files import read_utf8_text  # NumPy

    with report_write_errors(record_file.parent, "cache_dir", PRIVATE_FOLDER_DESCRIPTION):
        record_file = check_private_folder(record_file.parent) / record_file.name
    with suppress(OSError, ValueError):
        record_text = read_utf8_text(record_file)
        form_folder = record_file.with_name(record_text.partition("\n")[0])
        if _form_record_text(form_folder) == record_text:
            return form_folder, ""
    compiler_command = find_c_compiler()
    return Path(tempfile.mkdtemp(prefix="fenics_crack-", dir=record_file.parent)), compiler_command


def _form_record_text(form_folder: Path) -> str:
    """Return a text to record the files in a compiled form's folder.

    First line: name of the folder. Further lines: SHA-256 and name of each file.
    """
    from fenics_crack.basics.untrusted_files import file_sha256  # NumPy

    return "\n".join(
        (
            form_folder.name,
            *(f"{file_sha256(file)} {file.name}" for file in sorted(form_folder.iterdir())),
        )
    )
