"""Write files whole or not at all.

The program writes all of its files by this module. A file gets a hidden name first, and the final
name once the content is complete. So a full disk, an error or a kill leaves the earlier file.

A folder from somebody else may hold a link or a pipe of the final name: the new file replaces
either. A link in place of a folder for results, below the chosen folder, is refused: nothing is
written through a link.
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

from fenics_crack.basics.errors import DISK_FULL_ERROR_NUMBERS, InputError, WriteError

DEVICE_FOLDERS = "/dev", "/dev/fd", "/proc/self/fd"
"""Folders of devices and open files, which are written directly."""
BACKUP_FOLDER_NAME = "before"
"""Name of the folder with replaced files, below the folder of the new files."""


def write_file_whole(path: str | Path, content: bytes | str, key: str = "path") -> None:
    """Write a file in one step; make a missing folder.

    If writing fails, an earlier file stays unchanged.

    Parameters
    ----------
    path : path
        The file. A device or an open file, such as ``/dev/stdout``, is written directly.
    content : bytes or str
        The whole content; a text is written as UTF-8.
    key : str
        Name of the option or argument with the path, for an error.

    Raises
    ------
    InputError
        The file cannot be written; for a full disk a WriteError.
    """
    content_bytes = content.encode() if isinstance(content, str) else content
    if os.path.dirname(os.path.abspath(path)) in DEVICE_FOLDERS:
        with report_write_errors(path, key), open(path, "wb") as open_device_file:
            open_device_file.write(content_bytes)
        return
    with partial_file(path, key) as hidden_path, open(hidden_path, "wb") as file:
        file.write(content_bytes)


def write_files_together(path_text_pairs: Iterable[tuple[Path, str]]) -> None:
    """Write all texts to the given paths; if this fails, write none.

    Parameters
    ----------
    path_text_pairs : iterable of (Path, str)
        Path and text for each file.

    Raises
    ------
    InputError
        A file cannot be written; for a full disk a WriteError.
    """
    with complete_files_together():
        for path, content in path_text_pairs:
            write_file_whole(path, content)


@contextlib.contextmanager
def complete_files_together() -> Iterator[contextlib.ExitStack]:
    """Keep files written in a block hidden, and rename all to their final names at the end.

    If the block fails, none is renamed, and the hidden files are removed.

    Yields
    ------
    contextlib.ExitStack
        Object that holds the unfinished files. Call ``close`` to rename them before the end.

    Raises
    ------
    InputError
        A file cannot be written; for a full disk a WriteError.
    """
    with contextlib.ExitStack() as file_stack:
        _UNFINISHED_FILE_STACKS.append(file_stack)
        try:
            yield file_stack
        finally:
            _UNFINISHED_FILE_STACKS.remove(file_stack)


_UNFINISHED_FILE_STACKS: list[contextlib.ExitStack] = []
"""Unfinished files of each block of :func:`complete_files_together`, the innermost last."""


@contextlib.contextmanager
def partial_file(
    path: str | Path, key: str = "path", *, must_be_new: bool = False
) -> Iterator[Path]:
    """Yield a hidden path to write in a block, then rename the hidden file to its final path.

    If the block fails, the hidden file is removed. Within :func:`complete_files_together`, files
    are renamed together at the end instead, except with ``must_be_new``.

    Parameters
    ----------
    path : path
        Final path.
    key : str
        Name of the option or argument with the path, for an error.
    must_be_new : bool
        Raise FileExistsError if a file exists at the path, and leave that file.

    Raises
    ------
    InputError
        The file cannot be written; for a full disk a WriteError.
    """
    with contextlib.ExitStack() as single_file_stack:
        file_stack = (
            _UNFINISHED_FILE_STACKS[-1]
            if _UNFINISHED_FILE_STACKS and not must_be_new
            else single_file_stack
        )
        file_stack.enter_context(report_write_errors(path, key))
        hidden_path = file_stack.enter_context(
            _yield_hidden_path(Path(path), must_be_new=must_be_new)
        )
        with report_write_errors(path, key):
            yield hidden_path


@contextlib.contextmanager
def _yield_hidden_path(final_path: Path, *, must_be_new: bool = False) -> Iterator[Path]:
    """Yield a hidden path beside a file, then rename the hidden file to the final path.

    With ``must_be_new``, FileExistsError is raised if a file exists at the final path. That file
    stays.
    """
    random_text = os.urandom(4).hex()
    hidden_path = final_path.parent / f".{random_text}.{final_path.name}"
    if final_path.is_dir() and not final_path.is_symlink():  # of several files none gets its name
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    try:
        final_path.parent.mkdir(parents=True, exist_ok=True)
        yield hidden_path
        if must_be_new:
            os.link(hidden_path, final_path)
        else:
            os.replace(hidden_path, final_path)
    finally:
        with contextlib.suppress(OSError):
            hidden_path.unlink()


def back_up_files(file_names: Sequence[str], folder: Path, kept_folder: Path) -> bool:
    """Keep some files from a folder in another folder, as links or copies.

    Parameters
    ----------
    file_names : sequence of str
        Names of the files to keep. Names without a file in ``folder`` are removed from
        ``kept_folder``. If no name has a file, nothing changes.
    folder : Path
        Folder with the files.
    kept_folder : Path
        Folder for the links or copies, which replace files with the same names.

    Returns
    -------
    bool
        True if any file was kept.

    Raises
    ------
    OSError
        A file cannot be kept, or ``kept_folder`` is a link or a file.
    """
    if _is_link_or_file(kept_folder):
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    existing_file_names = [
        name
        for name in file_names
        if (folder / name).is_file() and not (folder / name).is_symlink()
    ]
    for name in existing_file_names:
        with _yield_hidden_path(kept_folder / name) as hidden_path:
            try:
                os.link(folder / name, hidden_path)  # a new file takes the place of the first name
            except OSError:  # a file system without links
                shutil.copy2(folder / name, hidden_path)
    for name_without_file_in_folder in (
        {*file_names} - {*existing_file_names} if existing_file_names else ()
    ):
        if (kept_folder / name_without_file_in_folder).is_symlink() or not (
            kept_folder / name_without_file_in_folder
        ).is_dir():
            (kept_folder / name_without_file_in_folder).unlink(missing_ok=True)
    return bool(existing_file_names)


def replace_files(file_names: Sequence[str], folder: Path, text_by_name: Mapping[str, str]) -> None:
    """Replace the named files in a folder by new texts.

    The earlier files are kept in a folder "before" inside the folder.

    Parameters
    ----------
    file_names : sequence of str
        Names of the earlier files.
    folder : Path
        Folder of the files.
    text_by_name : dict of str to str
        New texts by file name. A file in ``file_names`` without a new text is removed.

    Raises
    ------
    InputError
        A file cannot be written, or "before" is a link or a file.
    """
    make_or_check_results_folder(folder, (BACKUP_FOLDER_NAME,), "folder")
    with report_write_errors(folder, "folder"):
        back_up_files(file_names, folder, folder / BACKUP_FOLDER_NAME)
        write_files_together((folder / name, content) for name, content in text_by_name.items())
        for name in {*file_names} - {*text_by_name}:
            (folder / name).unlink(missing_ok=True)


def make_or_check_results_folder(
    folder: Path, inner_folder_names: Iterable[str] = (), key: str = "--output"
) -> None:
    """Make a folder for results, or check an existing folder.

    Parameters
    ----------
    folder : Path
        The folder, or a link to a folder.
    inner_folder_names : iterable of str
        Names of folders inside the folder. They are not made; a link or a file with such a name is
        an error.
    key : str
        Name of the option with the folder, for an error.

    Raises
    ------
    InputError
        No file can be written in the folder, or an inner folder is a link or a file.
    """
    for name in inner_folder_names:
        check_is_no_link_or_file(folder / name, key)
    with report_write_errors(folder, key, "a folder that can be written"):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass


def check_is_no_link_or_file(folder: Path, key: str = "path") -> None:
    """Raise InputError if a link or a file has the path of a folder for results.

    Used before results are written to this folder, which is often inside the results folder. A
    missing folder is allowed. ``key`` names the option with the results' path, for the error.
    """
    if _is_link_or_file(folder):
        raise InputError(
            key, str(folder), "a folder, not a link or a file; remove it, or choose another folder"
        )


def _is_link_or_file(path: Path) -> bool:
    """Return True for a link, and for an existing path that is no folder."""
    return path.is_symlink() or (path.exists() and not path.is_dir())


def make_folder_until_exit() -> Path:
    """Make a temporary folder, readable by this user alone.

    The folder is removed when the program ends.
    """
    folder = tempfile.mkdtemp(prefix="fenics_crack-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def remove_file(path: Path, key: str) -> None:
    """Remove an existing file, and hidden files of killed programs in the same folder.

    InputError if the file cannot be removed; ``key`` names the option with the path.
    """
    remove_hidden_files(path)
    with report_write_errors(path, key, "a file that can be removed"):
        path.unlink(missing_ok=True)


def remove_hidden_files(final_path: Path) -> None:
    """Remove unfinished files of killed programs in the folder of a file.

    A program writing the file at the same moment fails to rename the hidden file. So call this
    function only for a dispensable file.
    """
    for hidden_path in final_path.parent.glob(f".{8 * '[0-9a-f]'}.{final_path.name}"):
        with contextlib.suppress(OSError):
            hidden_path.unlink()


def check_disk_space(path: Path, n_bytes: float) -> None:
    """Raise WriteError unless so many bytes are free on a file's disk; make a missing folder."""
    with report_write_errors(path, "path"):
        path.parent.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(path.parent).free < n_bytes:
            raise OSError(errno.ENOSPC, f"less than {n_bytes / 1e6:.3g} MB of the disk are free")


def write_bytes_at(file_descriptor: int, content: bytes | memoryview, offset: int) -> None:
    """Write all bytes of ``content`` at an offset [byte] in an open file.

    OSError if the disk is full.
    """
    remaining_content = memoryview(content)
    while remaining_content:
        n_written = os.pwrite(file_descriptor, remaining_content, offset)
        remaining_content, offset = remaining_content[n_written:], offset + n_written


@contextlib.contextmanager
def report_write_errors(
    path: str | Path, key: str, requirement_text: str = "a file that can be written"
) -> Iterator[None]:
    """Turn an OSError in the block into an InputError that names the file.

    If the disk is full, the error is a WriteError. The FileExistsError due to ``must_be_new`` in
    :func:`partial_file` is raised unchanged.

    Parameters
    ----------
    path : path
        The file.
    key : str
        Name of the option or argument with the path.
    requirement_text : str
        Description of an allowed file, for the error.
    """
    try:
        yield
    except OSError as error:
        if isinstance(error, FileExistsError) and error.filename2:  # of the link to a new name
            raise
        error_class = WriteError if error.errno in DISK_FULL_ERROR_NUMBERS else InputError
        raise error_class(
            key, str(path), f"{requirement_text} ({error.strerror or error})"
        ) from None
