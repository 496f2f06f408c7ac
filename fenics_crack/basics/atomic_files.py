"""Files that are written whole or not at all.

Everything the program writes goes through here. A file gets a hidden name first and its own once it
is complete, so that a full disk, an error or a kill leaves what was there. A link or a pipe of that
name, which a folder from somebody else may hold, is replaced by the file: nothing is written
through it.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from fenics_crack.basics.errors import InputError, WriteError

DEVICES = "/dev", "/dev/fd", "/proc/self/fd"
"""Folders of devices and open files, which are written as they are."""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors of a disk that takes no more; others come from a path that cannot be used."""


def write_whole(path: str | Path, content: bytes | str, key: str = "path") -> None:
    """Write a file, text as UTF-8, and its folder.

    Parameters
    ----------
    path : path
        The file. A device or an open file, such as ``/dev/stdout``, is written as it is.
    content : bytes or str
        All of it.
    key : str
        Key that named the file, for an error.

    Raises
    ------
    InputError
        As of :func:`not_written`.
    """
    data = content.encode() if isinstance(content, str) else content
    if os.path.dirname(os.path.abspath(path)) in DEVICES:
        with reported(path, key), open(path, "wb") as device:
            device.write(data)
        return
    with whole_file(path, key) as partial, open(partial, "wb") as file:
        file.write(data)


def write_together(files: Iterable[tuple[Path, str]]) -> None:
    """Write files that belong together, all of them or none: paths and contents.

    Raises
    ------
    InputError
        As of :func:`not_written`.
    """
    with contextlib.ExitStack() as ready:
        for path, content in files:
            ready.enter_context(whole_file(path)).write_text(content, encoding="utf-8")


@contextlib.contextmanager
def whole_file(path: str | Path, key: str = "path", *, new: bool = False) -> Iterator[Path]:
    """A hidden place beside a file, which takes the file's name where the block ends well.

    Parameters
    ----------
    path, key
        As of :func:`write_whole`.
    new : bool
        Leave a file that is there, and raise FileExistsError.

    Raises
    ------
    InputError
        As of :func:`not_written`.
    """
    target = Path(path)
    partial = target.parent / f".{os.urandom(4).hex()}.{target.name}"  # which nobody can foresee
    with reported(path, key):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            yield partial
            if new:
                os.link(partial, target)
            else:
                os.replace(partial, target)
        finally:
            with contextlib.suppress(OSError):
                partial.unlink()


def put(file: int, content: bytes | memoryview, place: int) -> None:
    """Write all of some bytes at a place of an open file; OSError where the disk is full."""
    left = memoryview(content)
    while left:
        done = os.pwrite(file, left, place)
        left, place = left[done:], place + done


def not_written(key: str, path: str | Path, error: OSError, allowed: str = "") -> InputError:
    """The error of a file that cannot be written: a WriteError where the disk takes no more.

    Parameters
    ----------
    key, path
        Key that named the file, and the file.
    error : OSError
        The reason.
    allowed : str
        Allowed values, by default "a file that can be written".
    """
    kind = WriteError if error.errno in FULL else InputError
    why = error.strerror or str(error)
    return kind(key, str(path), f"{allowed or 'a file that can be written'} ({why})")


@contextlib.contextmanager
def reported(path: str | Path, key: str, allowed: str = "") -> Iterator[None]:
    """Raise what the block meets as :func:`not_written`."""
    try:
        yield
    except OSError as error:
        if isinstance(error, FileExistsError) and error.filename2:  # of the link to a new name
            raise
        raise not_written(key, path, error, allowed) from None
