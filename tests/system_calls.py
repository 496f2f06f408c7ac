"""What files a command opens, as the kernel sees it (strace)."""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest
from surroundings import no_rank

NEEDS_STRACE = pytest.mark.skipif(
    shutil.which("strace") is None,
    reason="Debian's package strace is missing: sh install.sh --tests",
)
"""Mark of tests that run a command under strace."""
OPENED = re.compile(r"(?:open|openat|openat2|creat)\((.*)\) += \d+<(/.*)>$")
"""A line of strace about a file that was opened: its arguments, and the file's path."""


def trace(command: Sequence[str], folder: Path, *options: str) -> tuple[int, list[str]]:
    """Run a command in a folder under strace; its exit code, and calls that open or rename files.

    The calls of each process are together, and in order; those of the command itself come first.
    ``options`` are further ones of strace, which injects signals without its filter only.
    """
    with tempfile.TemporaryDirectory() as trace_folder:
        strace = [
            "strace", "-ff", "-qq", "-y", "-s", "4096", "-o", f"{trace_folder}/of",
            "-e", "trace=open,openat,openat2,creat,rename,renameat,renameat2",
            *(options or ["--seccomp-bpf"]), *command,
        ]  # fmt: skip
        process = subprocess.run(
            strace, cwd=folder, env=no_rank(), capture_output=True, check=False
        )
        files = sorted(Path(trace_folder).iterdir(), key=lambda file: int(file.suffix[1:]))
        lines = [line for file in files for line in file.read_text("utf-8", "replace").splitlines()]
    return process.returncode, lines


def opened_files(
    command: Sequence[str], folder: Path, exit_codes: Sequence[int] = (0, 4)
) -> list[tuple[Path, bool]]:
    """Files that a command and its processes open in a folder, and whether for writing.

    Folders count as files. What could not be opened is left out. ``exit_codes`` are those expected.
    """
    exit_code, lines = trace(command, folder)
    assert exit_code in exit_codes, (command, exit_code)
    calls = [match for line in lines if (match := OPENED.match(line))]
    return [
        (
            Path(call[2].removesuffix("(deleted)")),
            bool(re.search("O_WRONLY|O_RDWR|O_CREAT", call[1])),
        )
        for call in calls
    ]
