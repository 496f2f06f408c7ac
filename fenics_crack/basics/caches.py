"""Folders in which DOLFINx keeps compiled forms and Matplotlib its list of fonts.

Both look for them in the environment when they are imported, and fail where the user's home does
not exist or takes no files, as in containers and on clusters.
"""

from __future__ import annotations

import os
import tempfile
from functools import lru_cache
from pathlib import Path

from fenics_crack.basics.atomic_files import not_written
from fenics_crack.basics.progress import LOGGER


@lru_cache
def settle_caches() -> None:
    """Replace a home that cannot be entered, and caches that cannot be written, by a private
    folder for temporary files, and say so in one line.

    Raises
    ------
    InputError
        That folder cannot be written either.
    """
    home = os.path.expanduser("~")
    if not (os.path.isdir(home) and os.access(home, os.X_OK)):
        _replace("HOME", Path(home), "no folder that can be entered")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    try:
        _check_room(cache / "fenics")
    except OSError as error:
        _replace("XDG_CACHE_HOME", cache, f"no folder that can be written, {error.strerror}")
        os.environ.setdefault("MPLCONFIGDIR", os.environ["XDG_CACHE_HOME"])


def _replace(name: str, path: Path, why: str) -> None:
    """Set a variable of the environment to this user's own folder for temporary files."""
    try:
        own = Path(tempfile.gettempdir()) / f"fenics-crack-{os.geteuid()}"
        own.mkdir(mode=0o700, exist_ok=True)
        found = own.lstat()
        if found.st_uid != os.geteuid() or found.st_mode & 0o77:  # what is compiled there is run
            raise PermissionError(f"{own} is not this user's alone")
        _check_room(own)
    except OSError as error:
        raise not_written(name, path, error, "a folder that can be written") from None
    os.environ[name] = str(own)
    LOGGER.warning("%s: %s; %s is used", path, why, own)  # Python prints it without a handler


def _check_room(folder: Path) -> None:
    """Raise OSError unless a folder, or the one in which it would be made, has room for a cache."""
    while not os.path.lexists(folder):
        folder = folder.parent
    with tempfile.TemporaryFile(dir=folder) as file:
        os.posix_fallocate(file.fileno(), 0, 2**22)  # the forms of a scene take 1 to 2 MiB
