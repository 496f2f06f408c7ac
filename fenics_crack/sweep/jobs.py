"""The jobs of a sweep: how ranks do them, and how rank 0 hands them out."""

from __future__ import annotations

import gc
import threading
import time
import traceback
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

from fenics_crack.errors import InputError
from fenics_crack.parallel import StopRequest
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import Study
from fenics_crack.study.run import REFUSALS
from fenics_crack.sweep.case import Arrays, Found, Geometry, Known, all_failed, build, solve_chunk
from fenics_crack.sweep.file import FAILED, PENDING, SweepFile
from fenics_crack.sweep.plan import Chunk, Index, Plan, everywhere

__all__ = ["Manager", "Worker", "no_garbage_in_threads"]

LONGEST = 2.0
"""Intended duration of a job [s]: what a killed run loses at most."""


@dataclass(frozen=True)
class Job:
    """Some chunks of a geometry, which is built first if there is a scene."""

    geometry: int
    scene: Scene | None
    arrays: tuple[Arrays, Known] | None
    unit_loads: bool
    wanted: bool
    """Whether other jobs need the arrays."""
    chunks: tuple[Chunk, ...]
    verdicts: bool
    """Whether the stability of each case is judged."""


@dataclass
class Answer:
    """The outcome of a job."""

    arrays: tuple[Arrays, Known] | None = None
    refusal: Exception | None = None
    """Why the geometry cannot be built."""
    solved: list[tuple[Chunk, list[Found]]] = field(default_factory=list)
    seconds: float = 0.0
    """Spent on the chunks."""
    error: str | None = None
    """Traceback of an unexpected error."""


class Worker:
    """A group of one or more ranks that does jobs."""

    current: Worker | None = None
    """The worker of this rank."""

    def __init__(self, group: MPI.Comm) -> None:
        self._group = group
        self._known: dict[int, Geometry] = {}
        self._last: Study | None = None

    def lead(self, job: Job) -> Answer:
        """Do a job with the whole group; called by its leader."""
        self._group.bcast(job)
        return self.work(job)

    def work(self, job: Job) -> Answer:
        """Do a job (collective on the group)."""
        answer = Answer()
        arrays = job.arrays
        try:
            if job.scene is not None:
                built = build(job.scene, self._group, job.unit_loads, self._last)
                self._last = built.study if job.scene.speed else None
                arrays = Arrays.of(built.structure), built.known
                answer.arrays = arrays if job.wanted else None
        except REFUSALS as error:
            answer.refusal = error
            return answer
        except Exception:
            if self._group.size > 1:  # the others may wait for this rank
                traceback.print_exc()
                self._group.Abort(1)
            answer.error = traceback.format_exc()
            return answer
        started = time.perf_counter()
        try:
            if job.chunks:
                arrays = self._group.bcast(arrays)
                if job.geometry not in self._known:
                    parts, known = arrays
                    geometry = Geometry(parts.structure(), known, job.unit_loads)
                    self._known = {job.geometry: geometry}
                for chunk in job.chunks[self._group.rank :: self._group.size]:
                    found = solve_chunk(self._known[job.geometry], chunk, job.verdicts)
                    answer.solved.append((chunk, found))
        except Exception:
            answer.error = traceback.format_exc()
        parts = self._group.gather((answer.solved, answer.error))
        if parts is not None:
            answer.solved = [item for solved, _ in parts for item in solved]
            answer.error = next((text for _, text in parts if text is not None), None)
        answer.seconds = time.perf_counter() - started
        return answer


def lead(job: Job) -> Answer:
    """Do a job on a leader, for the executor."""
    assert Worker.current is not None
    return Worker.current.lead(job)


class Manager:
    """Rank 0's queue of jobs, and the file; its methods may be called from two threads."""

    def __init__(
        self,
        plan: Plan,
        file: SweepFile,
        groups: int,
        ranks: int,
        *,
        progress: bool,
        verdicts: bool,
    ) -> None:
        self.error: BaseException | None = None
        self._plan, self._file = plan, file
        self._groups, self._ranks, self._verdicts = groups, ranks, verdicts
        self._news = threading.Condition()
        self._executor: Any = None
        self._given: dict[Any, Job] = {}
        """Jobs at the executor, by their futures."""
        self._stopped = False
        self._waiting: dict[int, deque[Index]] = {}
        """Places of the chunks left of geometries that are built or being built."""
        self._built: dict[int, tuple[Arrays, Known]] = {}
        left = [
            number
            for number, geometry in enumerate(plan.geometries)
            if np.any(file.state[everywhere(geometry)] == PENDING)
        ]
        # The longest jobs first: the last ones are what ranks wait for.
        self._unbuilt = deque(sorted(left, key=plan.sizes.__getitem__, reverse=True))
        self._chunks_left = sum(len(self._pending(number)) for number in self._unbuilt)
        self._seconds, self._chunks_done, self._recorded = 0.0, 0, 0
        done = int(np.count_nonzero(file.state != PENDING))
        self._failed = int(np.count_nonzero(file.state == FAILED))
        how = {"desc": "sweep", "unit": "case", "disable": not progress}
        self._bar = tqdm(total=file.state.size, initial=done, **how)

    @property
    def error_for_others(self) -> BaseException | None:
        """The error that the other ranks raise."""
        if self.error is None or isinstance(self.error, InputError | KeyboardInterrupt):
            return self.error
        return RuntimeError(f"the sweep ended on rank 0: {self.error}")

    def run(self, executor: Any, stop: StopRequest) -> None:
        """See that all jobs are done."""
        self._executor = executor
        takes_part = executor is None or MPI.Query_thread() >= MPI.THREAD_MULTIPLE
        while True:
            job = None
            with self._news:
                self._stopped = self._stopped or stop.asked(MPI.COMM_SELF)
                self._submit()
                if takes_part:
                    job = self._next_job() or self._take_back()
                if job is None:
                    if not self._given:
                        return
                    self._news.wait(0.1)
                    continue
            answer = lead(job)
            with self._news:
                self._record(job, answer)
            if executor is not None:
                del answer
                gc.collect()

    def fail(self, error: BaseException) -> None:
        """End the sweep with an error; the first one counts."""
        with self._news:
            self.error = self.error or error
            self._news.notify()

    def close(self) -> None:
        """Close the file; after an error remove it if it is new and empty."""
        self._bar.close()
        useless = self._file.made and self._recorded == 0 and self.error is not None
        try:
            self._file.close(remove=useless)
        except InputError as error:
            self.fail(error)

    def _submit(self) -> None:
        """Keep one more job at the executor than it has workers."""
        if self._executor is None:
            return
        while len(self._given) < self._groups:
            job = self._next_job()
            if job is None:
                return
            future = self._executor.submit(lead, job)
            self._given[future] = job
            future.add_done_callback(self._arrived)

    def _take_back(self) -> Job | None:
        """A job that the executor has not begun, for an idle rank 0; None at the end."""
        ending = self._stopped or self.error is not None
        for future, job in list(self._given.items()):
            if future.cancel() and not ending:
                return job
        return None

    def _arrived(self, future: Any) -> None:
        """Record what a worker has done and send it more, in the executor's thread."""
        with self._news:
            job = self._given.pop(future)
            if future.cancelled():
                return
            try:
                self._record(job, future.result())
                self._submit()
            except BaseException as error:
                self.fail(error)
            self._news.notify()

    def _next_job(self) -> Job | None:
        """Chunks of a built geometry, or a geometry to build, or None for now."""
        if self._stopped or self.error is not None:
            return None
        in_time = LONGEST * self._chunks_done / max(self._seconds, 1e-9)  # none known: one
        share = max(1, int(min(in_time, self._chunks_left // (3 * self._groups))))
        share = -(-share // self._ranks) * self._ranks
        while self._built:
            number, arrays = next(iter(self._built.items()))
            chunks = self._pop(number, share)
            if not self._waiting[number]:
                del self._built[number], self._waiting[number]
            if chunks:
                return self._job(number, None, arrays, False, chunks)
        while self._unbuilt:
            number = self._unbuilt.popleft()
            self._waiting[number] = deque(self._pending(number))
            every = map(self._plan.chunk, self._waiting[number])
            cases = (case for chunk in every for case in chunk.cases)
            scene = next((case for case in cases if not isinstance(case, str)), None)
            if scene is None:
                self._refuse(number, (), "")
                continue
            # The others have something to do meanwhile.
            alone = self._groups == 1 or len(self._unbuilt) >= self._groups
            first = self._pop(number, share if alone else 0)
            wanted = bool(self._waiting[number])
            return self._job(number, scene, None, wanted, first)
        return None

    def _job(
        self,
        number: int,
        scene: Scene | None,
        arrays: tuple[Arrays, Known] | None,
        wanted: bool,
        chunks: tuple[Chunk, ...],
    ) -> Job:
        return Job(number, scene, arrays, self._plan.unit_loads, wanted, chunks, self._verdicts)

    def _pending(self, number: int) -> list[Index]:
        return self._plan.pending(self._plan.geometries[number], self._file.state)

    def _pop(self, number: int, count: int | None = None) -> tuple[Chunk, ...]:
        waiting = self._waiting[number]
        count = len(waiting) if count is None else min(count, len(waiting))
        self._chunks_left -= count
        return tuple(self._plan.chunk(waiting.popleft()) for _ in range(count))

    def _record(self, job: Job, answer: Answer) -> None:
        """Write what a job has found."""
        for chunk, solved in answer.solved:
            self._write(chunk, solved)
        self._seconds += answer.seconds * self._ranks
        self._chunks_done += len(answer.solved)
        if answer.error is not None:
            raise RuntimeError(f"a job of the sweep ended with\n{answer.error}")
        if answer.refusal is not None:
            refusal = answer.refusal
            hopeless = isinstance(refusal, InputError) and refusal.key == "reduction.method"
            if hopeless and not self._plan.reduction_swept:
                raise refusal
            self._refuse(job.geometry, job.chunks, str(refusal))
        elif answer.arrays is not None:
            self._built[job.geometry] = answer.arrays
        elif job.scene is not None:
            del self._waiting[job.geometry]
        self._news.notify()

    def _refuse(self, number: int, chunks: tuple[Chunk, ...], reason: str) -> None:
        """Write chunks of a geometry that cannot be built, and all others that are left of it."""
        for chunk in chunks + self._pop(number):
            self._write(chunk, all_failed(chunk, reason))
        del self._waiting[number]

    def _write(self, chunk: Chunk, solved: list[Found]) -> None:
        self._file.record(chunk.index, solved)
        self._recorded += 1
        self._failed += sum("gap" not in found for found in solved)
        if self._failed:
            self._bar.set_postfix_str(f"{self._failed} failed", refresh=False)
        self._bar.update(len(chunk.cases))


# --- around the work ------------------------------------------------------------------------------


@contextmanager
def no_garbage_in_threads() -> Iterator[None]:
    """Collect no cyclic garbage here: the executor's thread must not destroy PETSc's objects.

    The main thread may be in PETSc at the same time.
    """
    enabled = gc.isenabled()
    gc.disable()
    gc.freeze()  # what exists need not be traversed after every job
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()
