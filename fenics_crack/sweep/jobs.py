"""The jobs of a sweep: rank 0 hands them out, does some itself, and writes what is found.

Every rank has one job to do and one to go on with, so that none waits for rank 0, which hears what
the others have found between two chunks of its own. Messages to a rank are jobs, numbers of cases
that are short enough to arrive at once while it computes, and one with the
tag ``END``, on which it stops after the present chunk; those from it are what it has found of each
chunk, and None behind a job.
"""

from __future__ import annotations

import gc
import traceback
from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import StopRequest, collect_garbage, wait_until
from fenics_crack.files.store import Stored
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import REFUSAL_EXCEPTIONS
from fenics_crack.sweep.case import ALONE, Asked, Found, Geometry, build, solve_chunk
from fenics_crack.sweep.file import State, SweepFile
from fenics_crack.sweep.plan import Chunk, Plan


class Tag(IntEnum):
    """Tag of a message to a rank."""

    JOB = 0
    END = 1


Outcome = list[Found] | Exception
"""Values of the cases of a chunk, or the error that ends the sweep."""


class Job(NamedTuple):
    """Some chunks of a geometry, as numbers of their cases."""

    geometry: int
    chunks: tuple[np.ndarray, ...]


class Worker:
    """A rank that does jobs; it builds the geometries itself.

    Parameters
    ----------
    asked : Asked
        Request for each case.
    plan : Plan
        Of the cases.
    """

    def __init__(self, asked: Asked, plan: Plan) -> None:
        self._asked, self._plan = asked, plan
        self._number = -1
        self._built: Geometry | Exception | None = None
        """Geometry of that number, or the error that prevents it."""

    def free(self, *, stopped: bool) -> None:
        """Let go of what was built."""
        self._built = None
        gc.collect()  # structures and their rotations know each other
        collect_garbage(MPI.COMM_SELF, stopped=stopped)

    def work(self, job: Job, go_on: Callable[[], bool]) -> Iterator[tuple[np.ndarray, Outcome]]:
        """Do a job, and yield what is found of each chunk; ``go_on`` is called before each of
        them, and before each of its cases."""
        chunks = list(map(self._plan.chunk, job.chunks))
        for chunk in chunks:
            if not go_on():
                return
            self._build(job.geometry, chunks)
            yield self._outcome(chunk, go_on)

    def _build(self, number: int, chunks: list[Chunk]) -> None:
        """Build the geometry of a job, unless it is at hand or none of the cases is a scene."""
        every = (case for chunk in chunks for case in chunk.cases)
        scene = next((case for case in every if isinstance(case, Scene)), None)
        if scene is None or number == self._number:
            return
        known = self._built if scene.speed and isinstance(self._built, Geometry) else None
        try:
            self._built = build(scene, MPI.COMM_SELF, self._asked, known)
        except REFUSAL_EXCEPTIONS as error:
            self._built = error
        except Exception:
            self._built = _unforeseen()
        self._number = number

    def _outcome(self, chunk: Chunk, go_on: Callable[[], bool]) -> tuple[np.ndarray, Outcome]:
        """Numbers of the cases that were done, and what was found of them."""
        built = self._built
        if isinstance(built, Geometry):
            try:
                found = solve_chunk(built, chunk, self._asked, go_on)
                return chunk.numbers[: len(found)], found
            except Exception:
                return chunk.numbers, _unforeseen()
        large = isinstance(built, InputError) and built.key == "reduction.method"
        if built is None or (
            isinstance(built, REFUSAL_EXCEPTIONS) and not (large and self._asked.hopeless)
        ):
            reasons = [case if isinstance(case, str) else str(built) for case in chunk.cases]
            return chunk.numbers, [{"status": status} for status in reasons]
        return chunk.numbers, built


def _unforeseen() -> RuntimeError:
    """An error that is none of the input's, with its place."""
    return RuntimeError(f"a job of the sweep ended with\n{traceback.format_exc()}")


def serve(worker: Worker, comm: MPI.Comm) -> None:
    """Do the jobs that rank 0 sends, until the end."""
    sent: list[MPI.Request] = []

    def go_on() -> bool:
        sent[:] = [request for request in sent if not request.Test()]
        return not comm.iprobe(source=0, tag=Tag.END)

    status = MPI.Status()
    while status.tag != Tag.END:
        job = _received(comm, status)
        if status.tag == Tag.JOB:
            sent += [comm.isend(found, 0) for found in worker.work(job, go_on)]
            sent.append(comm.isend(None, 0))
    MPI.Request.waitall(sent)


def _received(comm: MPI.Comm, status: MPI.Status) -> Any:
    """The next message; MPI itself would wait with all of a processor, also for the end of a long
    one."""
    wait_until(lambda: comm.iprobe(status=status))
    room = bytearray(status.Get_count(MPI.BYTE))
    request, arrived = comm.irecv(room, status.source, status.tag), list[Any]()

    def has_arrived() -> bool:
        arrived[:] = request.test()
        return bool(arrived[0])

    wait_until(has_arrived)
    return arrived[1]


class Manager:
    """Remaining cases of a sweep, and its file; on rank 0."""

    def __init__(self, plan: Plan, file: SweepFile, ranks: int, *, progress: bool) -> None:
        self._error: BaseException | None = None
        self.plan, self._file, self._ranks = plan, file, ranks
        left = {
            number: [chunk for chunk in chunks if np.any(file.state.flat[chunk] == State.PENDING)]
            for number, chunks in enumerate(plan.geometries)
        }
        # The longest jobs first: the last ones are what ranks wait for.
        largest = sorted(left, key=plan.sizes.__getitem__, reverse=True)
        self._left = {number: left[number] for number in largest if left[number]}
        self._given: dict[int, int] = {}
        """Geometry that each rank has, or will have built."""
        self._given_out, self._recorded = 0, 0
        """Jobs at the other ranks, and chunks written."""
        self._failed = int(np.count_nonzero(file.state == State.FAILED))
        from tqdm import tqdm

        how = {"desc": "sweep", "unit": "case", "disable": not progress}
        self._bar = tqdm(total=file.state.size, initial=self._done, **how)

    @property
    def _done(self) -> int:
        return int(np.count_nonzero(self._file.state != State.PENDING))

    def how_far(self) -> str:
        """Cases that are done, and all."""
        return f"{self._done} of {self._file.state.size} cases of the sweep"

    @property
    def stored(self) -> Stored:
        """The file's header, when all is done; raises the error that has ended the sweep."""
        if self._error is not None:
            raise self._error
        return self._file.stored

    def run(self, worker: Worker, comm: MPI.Comm, stop: StopRequest) -> None:
        """See that all jobs are done, and close the file; an error is kept, and removes a file that
        is new and empty."""
        others = range(1, comm.size)

        def go_on() -> bool:
            while self._given_out and comm.iprobe():
                if stop.asked(MPI.COMM_SELF):
                    self._left.clear()  # no job is handed out any more
                self._hear(comm)
            return self._error is None and not stop.asked(MPI.COMM_SELF)

        try:
            for rank in others:
                self._send(comm, rank)
            job = self._next_job(0)
            for rank in others:  # to go on with
                self._send(comm, rank)
            while job is not None and go_on():
                for numbers, outcome in worker.work(job, go_on):
                    self._record(numbers, outcome)
                job = self._next_job(0)
            while go_on() and self._given_out:
                self._hear(comm)
        except BaseException as error:
            second = isinstance(error, KeyboardInterrupt) and stop.asked(MPI.COMM_SELF)
            if not second:  # else what is written is all
                self._fail(error)
        self._left.clear()
        for rank in others:
            comm.send(None, rank, tag=Tag.END)
        while self._given_out:
            self._hear(comm)
        self._bar.close()
        useless = self._file.made and self._recorded == 0 and self._error is not None
        try:
            self._file.close(remove=useless)
        except InputError as error:
            self._fail(error)

    def _send(self, comm: MPI.Comm, rank: int) -> None:
        """Send a rank a job, if there is one."""
        job = self._next_job(rank)
        if job is not None:
            comm.send(job, rank, tag=Tag.JOB)
            self._given_out += 1

    def _hear(self, comm: MPI.Comm) -> None:
        """Write what a rank has found of a chunk, or send it a job where one is done."""
        status = MPI.Status()
        found = _received(comm, status)
        if found is not None:
            self._record(*found)
            return
        self._given_out -= 1
        self._send(comm, status.source)

    def _next_job(self, rank: int) -> Job | None:
        """Chunks of the geometry that a rank has, or else of one that nobody has, or of the one of
        which most is left; None where there is nothing left.

        A geometry is one job as long as the others have something to do meanwhile, and then is
        shared in jobs that shrink towards the end.
        """
        if not self._left:
            return None
        fresh = [number for number in self._left if number not in self._given.values()]
        number = self._given.get(rank, -1)
        if number not in self._left:
            number = fresh[0] if fresh else max(self._left, key=lambda one: len(self._left[one]))
        self._given[rank] = number
        places = self._left[number]
        alone = self._ranks == 1 or len(fresh) > self._ranks
        count = len(places) if alone else -(-len(places) // (2 * self._ranks))
        self._left[number] = places[count:]
        if not self._left[number]:
            del self._left[number]
        return Job(number, tuple(places[:count]))

    def _record(self, numbers: np.ndarray, outcome: Outcome) -> None:
        """Write the cases of a chunk; what cannot be written or solved ends the sweep."""
        if isinstance(outcome, Exception):
            self._fail(outcome)
            return
        try:
            self._file.record(numbers, outcome)
        except InputError as error:
            self._fail(error)
            return
        self._recorded += 1
        lost = (found for found in outcome if "gap" not in found)
        self._failed += sum(found["status"] != ALONE for found in lost)
        if self._failed:
            self._bar.set_postfix_str(f"{self._failed} failed", refresh=False)
        self._bar.update(len(outcome))

    def _fail(self, error: BaseException) -> None:
        """End the sweep with an error; the first one counts."""
        self._error = self._error or error
        self._left.clear()
