"""Folders in which DOLFINx keeps compiled forms and Matplotlib its list of fonts.

Both look for them in the environment when they are imported, and fail where the user's home does
not exist or takes no files, as in containers and on clusters.
"""

from __future__ import annotations

import os
import resource
import tempfile
from functools import lru_cache
from pathlib import Path

from fenics_crack.basics.atomic_files import report_write_errors
from fenics_crack.basics.progress import LOGGER

PRIVATE_FOLDER_REQUIREMENT = "a folder that this user alone can write"


@lru_cache
def replace_unusable_caches() -> None:
    """Replace a home that cannot be entered, and caches that cannot be written or that others can
    write, by a private folder for temporary files, and say so in one line.

    Raises
    ------
    InputError
        That folder cannot be written either.
    """
    home = os.path.expanduser("~")
    if not (os.path.isdir(home) and os.access(home, os.X_OK)):
        _set_private_folder("HOME", Path(home), "no folder that can be entered")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    try:
        check_private_folder(cache / "fenics", make=False)
    except OSError as error:
        _set_private_folder(
            "XDG_CACHE_HOME", cache, f"not {PRIVATE_FOLDER_REQUIREMENT}, {error.strerror}"
        )
        os.environ.setdefault("MPLCONFIGDIR", os.environ["XDG_CACHE_HOME"])


def _set_private_folder(name: str, path: Path, why: str) -> None:
    """Set a variable of the environment to this user's own folder for temporary files."""
    with report_write_errors(path, name, PRIVATE_FOLDER_REQUIREMENT):
        own = check_private_folder(
            Path(tempfile.gettempdir()) / f"fenics-crack-{os.geteuid()}", 0o77
        )
        check_private_folder(own, make=False)
    os.environ[name] = str(own)
    LOGGER.warning("%s: %s; %s is used", path, why, own)  # Python prints it without a handler


def check_private_folder(path: Path, closed: int = 0o22, *, make: bool = True) -> Path:
    """Return a folder's path without links, if nobody but this user and root can put files into it,
    or another folder in its place: what is compiled there is run.

    Parameters
    ----------
    path : Path
        The folder. Those above it may be sticky, as ``/tmp``.
    closed : int
        Permissions for it that nobody else may have, by default to write.
    make : bool
        Make it, and those above it; else it may be missing, and has to have room for a cache.

    Raises
    ------
    OSError
        Others can write it, it cannot be written, or it has no room.
    """
    folder = path.resolve()
    for part in (*reversed(folder.parents), folder) if make else ():
        part.mkdir(mode=0o700, exist_ok=True)
    there = [(part, part.stat()) for part in (folder, *folder.parents) if part.exists()]
    for part, status in there:
        refused = closed if part == folder else 0 if status.st_mode & 0o1000 else 0o22
        if status.st_mode & refused or status.st_uid not in (0, os.geteuid()):
            raise OSError(0, f"others can write {part}")
    with tempfile.TemporaryFile(dir=there[0][0]) as file:
        if not make:  # it takes milliseconds; the forms of a scene take 1 to 2 MiB in many files
            os.posix_fallocate(
                file.fileno(), 0, min(2**22, resource.getrlimit(resource.RLIMIT_FSIZE)[0] % 2**64)
            )
    return folder
