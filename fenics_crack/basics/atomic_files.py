"""Files that are written whole or not at all.

Everything the program writes goes through here. A file gets a hidden name first and its own once it
is complete, so that a full disk, an error or a kill leaves what was there. A link or a pipe of that
name, which a folder from somebody else may hold, is replaced by the file, and a link in place of a
folder below that for results is refused: nothing is written through it.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from fenics_crack.basics.errors import InputError, WriteError

DEVICE_FOLDERS = "/dev", "/dev/fd", "/proc/self/fd"
"""Folders of devices and open files, which are written as they are."""
DISK_FULL_ERROR_NUMBERS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors of a disk that takes no more; others come from a path that cannot be used."""
REPLACED_FILES_FOLDER = "before"
"""Folder in which files that are replaced are kept, beside those that take their place."""


def write_file_whole(path: str | Path, content: bytes | str, key: str = "path") -> None:
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
        As of :func:`reported`.
    """
    data = content.encode() if isinstance(content, str) else content
    if os.path.dirname(os.path.abspath(path)) in DEVICE_FOLDERS:
        with report_write_errors(path, key), open(path, "wb") as device:
            device.write(data)
        return
    with partial_file(path, key) as partial, open(partial, "wb") as file:
        file.write(data)


def write_files_together(files: Iterable[tuple[Path, str]]) -> None:
    """Write files that belong together, all of them or none: paths and contents.

    Raises
    ------
    InputError
        As of :func:`reported`.
    """
    with complete_files_together():
        for path, content in files:
            write_file_whole(path, content)


@contextlib.contextmanager
def complete_files_together() -> Iterator[contextlib.ExitStack]:
    """Write all files of the block or none: each gets its name at the end.

    The stack's ``close`` gives them their names earlier.

    Raises
    ------
    InputError
        As of :func:`reported`.
    """
    with contextlib.ExitStack() as files:
        _PENDING_FILE_GROUPS.append(files)
        try:
            yield files
        finally:
            _PENDING_FILE_GROUPS.remove(files)


_PENDING_FILE_GROUPS: list[contextlib.ExitStack] = []
"""Files of each block of :func:`together`, the innermost last, that wait for their names."""


@contextlib.contextmanager
def partial_file(path: str | Path, key: str = "path", *, new: bool = False) -> Iterator[Path]:
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
        As of :func:`reported`.
    """
    with contextlib.ExitStack() as single_file:
        files = _PENDING_FILE_GROUPS[-1] if _PENDING_FILE_GROUPS and not new else single_file
        files.enter_context(report_write_errors(path, key))
        partial = files.enter_context(_hidden_file(Path(path), new=new))
        with report_write_errors(path, key):
            yield partial


@contextlib.contextmanager
def _hidden_file(target: Path, *, new: bool = False) -> Iterator[Path]:
    partial = target.parent / f".{os.urandom(4).hex()}.{target.name}"  # which nobody can foresee
    if target.is_dir() and not target.is_symlink():  # of several files none gets its name
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
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


def keep_files(names: Sequence[str], folder: Path, kept: Path) -> bool:
    """Keep the files of some names that lie in a folder in another one below it, too, where they
    replace all of these names; return False, and change nothing, if there are none.

    Raises
    ------
    OSError
        A file cannot be kept, or the folder below is a link.
    """
    if _is_link_or_file(kept):
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    there = [n for n in names if (folder / n).is_file() and not (folder / n).is_symlink()]
    for name in there:
        with _hidden_file(kept / name) as partial:
            try:
                os.link(folder / name, partial)  # a new file takes the place of the first name
            except OSError:  # a file system without links
                shutil.copy2(folder / name, partial)
    for other in {*names} - {*there} if there else ():
        if (kept / other).is_symlink() or not (kept / other).is_dir():
            (kept / other).unlink(missing_ok=True)
    return bool(there)


def replace_files(names: Sequence[str], folder: Path, contents: Mapping[str, str]) -> None:
    """Write files of some names into a folder in place of all of these, which are kept in
    :data:`BEFORE` below it.

    Raises
    ------
    InputError
        As of :func:`prepare_folder` and :func:`reported`.
    """
    prepare_folder(folder, (REPLACED_FILES_FOLDER,), "folder")
    with report_write_errors(folder, "folder"):
        keep_files(names, folder, folder / REPLACED_FILES_FOLDER)
        write_files_together((folder / name, content) for name, content in contents.items())
        for name in {*names} - {*contents}:
            (folder / name).unlink(missing_ok=True)


def prepare_folder(folder: Path, inner: Iterable[str] = (), key: str = "--output") -> None:
    """Make a folder for results, which may be a link.

    Raises
    ------
    InputError
        No file can be written there; or one of the ``inner`` folders, in which files will be
        written, is refused by :func:`check_inner`.
    """
    for name in inner:
        check_inner_folder(folder / name, key)
    with report_write_errors(folder, key, "a folder that can be written"):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass


def check_inner_folder(folder: Path, key: str = "path") -> None:
    """Raise InputError where a folder below that for results, in which files will be written, is a
    link or no folder."""
    if _is_link_or_file(folder):
        raise InputError(key, str(folder), "a folder for files, and no link to one")


def _is_link_or_file(path: Path) -> bool:
    return path.is_symlink() or (path.exists() and not path.is_dir())


def make_temporary_folder() -> Path:
    """A folder of this user's alone that is gone when the program ends."""
    folder = tempfile.mkdtemp(prefix="fenics_crack-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def remove_file(path: Path, key: str) -> None:
    """Remove a file if it is there; InputError as of :func:`reported`."""
    with report_write_errors(path, key, "a file that can be removed"):
        path.unlink(missing_ok=True)


def write_bytes_at(file: int, content: bytes | memoryview, place: int) -> None:
    """Write all of some bytes at a place of an open file; OSError where the disk is full."""
    left = memoryview(content)
    while left:
        done = os.pwrite(file, left, place)
        left, place = left[done:], place + done


@contextlib.contextmanager
def report_write_errors(
    path: str | Path, key: str, allowed: str = "a file that can be written"
) -> Iterator[None]:
    """Raise what the block meets as the InputError of a file that cannot be written, a WriteError
    where the disk takes no more.

    Parameters
    ----------
    path, key
        The file, and the key that named it.
    allowed : str
        Allowed values.
    """
    try:
        yield
    except OSError as error:
        if isinstance(error, FileExistsError) and error.filename2:  # of the link to a new name
            raise
        kind = WriteError if error.errno in DISK_FULL_ERROR_NUMBERS else InputError
        raise kind(key, str(path), f"{allowed} ({error.strerror or error})") from None
