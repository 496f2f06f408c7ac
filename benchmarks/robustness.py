"""Full disks, and sweeps that are killed: is nothing lost, and is nothing harmed?

*disk.* Five commands, each on ten disks of a fraction of what it needs, from none on, a tmpfs that
only this process sees. Where none can be mounted (it takes root), files are limited instead
(RLIMIT_FSIZE). A run is right if it ends with exit code 1 and one line that names a file, if every
file is the one that was there before or a whole new one, and if nothing else is left behind. After
one run in ten, and after every sweep, the same command must succeed where there is room: a sweep
with the same bits as without all this.

*kill.* Sweeps on 1, 2 and 4 ranks are ended by kill -9, every fourth at any time from the start on,
the others once a case has been stored. A run is right if the file opens, the next run keeps the
cases that are in it and solves the others, and the result has the same bits as that of a sweep on
one rank which nobody disturbed.

``--only`` runs one of the two.

    OMP_NUM_THREADS=1 python benchmarks/robustness.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import ctypes
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import common
import numpy as np

import fenics_crack as fc

CHAIN = common.DEMOS / "chain.toml"
PLATE = ("mesh.size=0.02", "mesh.lip_elements=2", "harmonic_balance.tolerance=none")
SHARES = tuple(share / 10 for share in range(10))
"""Sizes of disks over what a command needs."""
KIB = 1024
KILLS = {1: 8, 2: 6, 4: 6}
"""By the number of ranks."""
OVER = '{"excitation.frequency"={start=6.0,stop=13.0,count=150},"structure.clearance"=[1e-3,2e-3]}'
LONG = (f"sweep.over={OVER}", "harmonic_balance.harmonics=40")
MPI = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",  # Open MPI 4
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # Open MPI 5
}


def main() -> None:
    """Run the parts; exit code 1 if a run was not right."""
    wrong: list[str] = []
    parts = {"disk": full_disks, "kill": killed_sweeps}
    common.run(
        __doc__,
        {name: lambda given, part=part: wrong.extend(part(given)) for name, part in parts.items()},
    )
    for line in wrong:
        print(f"wrong: {line}")
    sys.exit(bool(wrong))


def program(*words: object, ranks: int = 1) -> list[str]:
    """The words of a command of the program."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    return [*launcher, sys.executable, "-m", "fenics_crack", *map(str, words), "--quiet"]


def ended(
    words: Sequence[str], before: Callable[[], None] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end."""
    return subprocess.run(
        words, capture_output=True, text=True, check=False, preexec_fn=before, env=os.environ | MPI
    )


def changed(scene: Path, changes: Sequence[str]) -> list[str]:
    """A scene with changes, as words of a command."""
    return [str(scene), *(word for change in changes for word in ("--set", change))]


def differences(one: fc.SweepResult, other: fc.SweepResult) -> list[str]:
    """What differs between two sweeps but for the time they took; to the bit."""
    names = [n for n in one.columns if n not in ("seconds", "state")]
    found = [n for n in ["state", *names] if one[n].tobytes() != other[n].tobytes()]
    return found + [
        f"gap of case {index}"
        for index in map(tuple, np.argwhere(one.converged))
        if one.gap(index).tobytes() != other.gap(index).tobytes()
    ]


# --- full disks -----------------------------------------------------------------------------------


class Disk:
    """A folder in which there is room for so many bytes."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._limit = folder, resource.RLIM_INFINITY
        folder.mkdir(parents=True, exist_ok=True)
        libc = ctypes.CDLL(None, use_errno=True)
        own = os.geteuid() == 0 and libc.unshare(0x00020000) == 0  # CLONE_NEWNS
        self.mounted = own and self._mount("--make-rprivate", "/")
        self.mounted = self.mounted and self._mount("-t", "tmpfs", "tmpfs", str(folder))

    def _mount(self, *words: str) -> bool:
        return ended(["mount", *words]).returncode == 0

    def resize(self, size: int | None) -> None:
        """Make a disk of a size, or of what is on it, if that is more; or with room enough."""
        if self.mounted:
            used = shutil.disk_usage(self.folder).used
            pages = 2**20 if size is None else max(1, used // 4096, size // 4096)
            assert self._mount("-o", f"remount,size={4 * pages}k", str(self.folder))
            if size is not None and max(used, size) < 4096:  # there is no smaller tmpfs
                (self.folder / "filler").write_bytes(bytes(4096))
        else:
            self._limit = resource.RLIM_INFINITY if size is None else size
        if size is None:
            (self.folder / "filler").unlink(missing_ok=True)

    def close(self) -> None:
        """Give the folder back."""
        if self.mounted:
            assert ended(["umount", str(self.folder)]).returncode == 0

    def limit(self) -> None:
        """To be called in the process that runs there."""
        resource.setrlimit(resource.RLIMIT_FSIZE, (self._limit, resource.RLIM_INFINITY))


def full_disks(arguments: common.Arguments) -> list[str]:
    """Every command on disks of every size."""
    with tempfile.TemporaryDirectory() as place:
        disk, results = Disk(Path(place) / "disk"), Path(place) / "results"
        print(f"full disks: {'a tmpfs' if disk.mounted else 'limited files'}", flush=True)
        scene = results / "plate.toml"
        assert ended(program("new", scene)).returncode == 0
        plate, out = changed(scene, PLATE), disk.folder / "new"
        commands = {
            "solve": ["solve", *plate, "--output", out],
            "curve": ["curve", CHAIN, "--output", out],
            "sweep": ["sweep", CHAIN, "--output", out],
            "plot": ["plot", results / "solve" / "solution.h5", "--output", out],
            "report": ["report", *(results / n for n in ("curve/curve.h5", "sweep/sweep.h5"))],
        }
        commands["report"] += ["--output", out / "report.html"]
        rows, wrong = [], []
        for name, words in commands.items():
            done = ended(program(*words))
            assert done.returncode == 0, done.stderr
            files = [file.stat() for file in out.rglob("*") if file.is_file()]
            largest = max(file.st_size for file in files)
            need = 512 * sum(file.st_blocks for file in files) if disk.mounted else largest
            shutil.copytree(out, results / name)
            shutil.rmtree(out)
            told, before = [], len(wrong)
            for share in SHARES[:: 5 if arguments.quick else 1]:
                line, faults = on_full_disk(disk, words, results / name, int(share * need))
                if name == "sweep" or share == SHARES[5]:
                    faults += harmed(disk, words, results / name)
                shutil.rmtree(out, ignore_errors=True)
                told.append(line)
                wrong += [f"{name} with {share * need / KIB:.0f} KiB: {text}" for text in faults]
            rows.append([name, len(told), need // KIB, len(wrong) - before])
            print(
                f"{name}: {len(wrong) - before} wrong of {len(told)}",
                *sorted(set(told)),
                sep="\n  ",
            )
        disk.close()
    title = "Commands on full disks"
    columns = ["command", "runs", "it needs [KiB]", "wrong"]
    common.save_table(arguments.folder / "full_disks.csv", title, columns, rows)
    return wrong


def on_full_disk(
    disk: Disk, words: Sequence[object], whole: Path, room: int
) -> tuple[str, list[str]]:
    """Run a command where there is too little room: its line, and what was wrong."""
    out, old = disk.folder / "new", {}
    for file in whole.rglob("*"):
        if file.is_file() and file.name != "sweep.h5":  # which would be continued
            old[out / file.relative_to(whole)] = content = f"before {file.name}".encode()
            place = out / file.relative_to(whole)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(content)
    disk.resize(room)
    done = ended(program(*words), disk.limit)
    lines, faults = done.stderr.splitlines(), []
    if done.returncode != 1 or len(lines) != 1 or str(disk.folder) not in lines[0]:
        faults.append(f"exit code {done.returncode}, said {lines[-3:]}")
    for file in disk.folder.rglob("*"):
        if file.is_file() and file.name != "filler":
            known = whole / file.relative_to(out)
            if not known.exists():
                faults.append(f"left behind {file.name}")
            elif file.read_bytes() != old.get(file) and not is_whole(file, known):
                faults.append(f"cut {file.name}")
    disk.resize(None)
    return lines[-1] if lines else "", faults


def harmed(disk: Disk, words: Sequence[object], whole: Path) -> list[str]:
    """Run a command again where there is room now: what was wrong."""
    again = ended(program(*words))
    if again.returncode:
        return [f"the next run ended with {again.returncode}: {again.stderr[-300:]}"]
    if words[0] != "sweep":
        return []
    both = (fc.SweepResult.load(folder / "sweep.h5") for folder in (disk.folder / "new", whole))
    return differences(*both)


def is_whole(file: Path, known: Path) -> bool:
    """Whether a file ends and opens as one that is whole."""
    if file.suffix == ".h5":
        return ended(program("report", file, "--output", known.with_name("x.html"))).returncode == 0
    return file.read_bytes()[-6:] == known.read_bytes()[-6:]


# --- killed sweeps --------------------------------------------------------------------------------


@dataclass
class Killed:
    """What was found after a kill."""

    ranks: int
    stored: int  # cases in the file
    cases: int
    faults: list[str]


def killed_sweeps(arguments: common.Arguments) -> list[str]:
    """Sweeps on every number of ranks."""
    chance, found = random.Random(24), list[Killed]()
    with tempfile.TemporaryDirectory() as place:
        alone = Path(place) / "alone"
        started = time.monotonic()
        done = ended(program("sweep", *changed(CHAIN, LONG), "--output", alone))
        assert done.returncode == 0, done.stderr
        print(f"an undisturbed sweep: {time.monotonic() - started:.1f} s", flush=True)
        expected = fc.SweepResult.load(alone / "sweep.h5")
        for ranks, count in KILLS.items():
            for number in range(1 if arguments.quick else count):
                folder = Path(place) / f"{ranks}_{number}"
                early = number % 4 == 3
                found.append(killed_once(folder, ranks, chance, expected, early=early))
                shutil.rmtree(folder)
    rows = [
        [
            ranks, len(of), sum(one.stored > 0 for one in of),
            f"{min(one.stored for one in of)} to {max(one.stored for one in of)} of {of[0].cases}",
            sum(bool(one.faults) for one in of),
        ]
        for ranks in KILLS
        if (of := [one for one in found if one.ranks == ranks])
    ]  # fmt: skip
    columns = ["ranks", "kills", "after the first case", "cases kept", "wrong"]
    title = "Sweeps ended by kill -9 and continued"
    common.save_table(arguments.folder / "killed_sweeps.csv", title, columns, rows)
    return [
        f"{one.ranks} ranks, {one.stored} cases: {text}" for one in found for text in one.faults
    ]


def killed_once(
    folder: Path, ranks: int, chance: random.Random, expected: fc.SweepResult, *, early: bool
) -> Killed:
    """Begin a sweep, kill it and continue it to its end."""
    words = program("sweep", *changed(CHAIN, LONG), "--output", folder, ranks=ranks)
    path, cases = folder / "sweep.h5", expected["state"].size
    quiet = subprocess.DEVNULL
    running = subprocess.Popen(words, env=os.environ | MPI, stdin=quiet, stdout=quiet, stderr=quiet)
    while not early and running.poll() is None and not stored(path).any():
        time.sleep(0.01)
    time.sleep(chance.uniform(0.0, 1.5))
    kill(running)
    kept = stored(path)
    before = fc.SweepResult.load(path)["seconds"] if kept.any() else None
    result = Killed(ranks, int(np.count_nonzero(kept)), cases, [])
    done = ended(words)
    if done.returncode:
        result.faults.append(f"the next run ended with {done.returncode}: {done.stderr[-300:]}")
        return result
    after = fc.SweepResult.load(path)
    result.faults += differences(after, expected)
    if before is not None and np.any(after["seconds"][kept > 0] != before[kept > 0]):
        result.faults.append("cases were solved again")
    return result


def stored(path: Path) -> np.ndarray:
    """States of the cases in a sweep's file; of none if it is not there yet."""
    return fc.SweepResult.load(path)["state"] if path.exists() else np.zeros(0)


def kill(running: subprocess.Popen[bytes]) -> None:
    """End a program and all that it has started, at once."""
    pids, found = [running.pid], [running.pid]
    while found:
        tasks = [Path(f"/proc/{pid}/task/{pid}/children") for pid in found]
        found = [int(word) for task in tasks if task.exists() for word in task.read_text().split()]
        pids += found
    for pid in pids:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
    running.wait()
    while any(is_running(pid) for pid in pids[1:]):
        time.sleep(0.01)


def is_running(pid: int) -> bool:
    """Whether a process is there and has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


if __name__ == "__main__":
    main()
