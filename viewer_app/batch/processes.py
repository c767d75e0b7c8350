"""Worker processes on this machine.

A pool of the standard library fails as a whole if one of its processes dies. Here a process that dies costs
only its own job.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import connection, get_context, parent_process
from multiprocessing.connection import Connection
from typing import Any

from fusion.compiling.kernels import ensure_cache_folder
from viewer_app.batch.jobs import Job, Outcome

_END_WITHIN = 5.0  # seconds


def run_in_processes(jobs: Sequence[Job], processes: int) -> Generator[Outcome | str, None, None]:
    """Runs the jobs and yields each outcome, and each notice of a worker, when it is known.

    Closing the generator ends all processes.

    Args:
        jobs: The jobs, started in this order.
        processes: Maximum number of processes.
    """
    ensure_cache_folder()  # one for all processes
    waiting = deque(jobs)
    workers: list[_Worker] = []
    try:
        while waiting or any(worker.job for worker in workers):
            while waiting and (idle := _idle(workers, processes)) is not None:
                idle.start(waiting.popleft())
            busy: dict[Any, _Worker] = {worker.connection: worker for worker in workers if worker.job}
            for ready in connection.wait(list(busy)):
                worker = busy[ready]
                outcome, alive = worker.outcome()
                if not alive:
                    workers.remove(worker)
                    worker.end()
                yield outcome
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process that fuses one job after the other."""

    def __init__(self) -> None:
        # Spawned, not forked: the threads of numba and OpenBLAS do not survive a fork.
        context = get_context("spawn")
        self.connection, other = context.Pipe()
        self.job: Job | None = None
        self._process = context.Process(target=_serve, args=(other,), daemon=True)
        with _ctrl_c_held_back():
            self._process.start()
        other.close()

    def start(self, job: Job) -> None:
        """Gives the process a job."""
        self.job = job
        with suppress(BrokenPipeError):  # it died; reading its outcome tells
            self.connection.send(job)

    def outcome(self) -> tuple[Outcome | str, bool]:
        """The outcome of the job, or a notice if it still runs; and whether the process lives."""
        assert self.job is not None
        job, self.job = self.job, None
        try:
            received: Outcome | str = self.connection.recv()
            if isinstance(received, str):
                self.job = job
            return received, True
        except (EOFError, ConnectionError):
            self._process.join(_END_WITHIN)
            job.drop_partials()
            code = self._process.exitcode
            return Outcome(job.name, None, f"The worker process died{_why(code)}."), False

    def end(self) -> None:
        """Ends the process at once; the job that it runs is not finished."""
        self._process.terminate()
        self._process.join(_END_WITHIN)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self.connection.close()
        if self.job is not None:
            self.job.drop_partials()


def _idle(workers: list[_Worker], processes: int) -> _Worker | None:
    for worker in workers:
        if worker.job is None:
            return worker
    if len(workers) < processes:
        workers.append(_Worker())
        return workers[-1]
    return None


def _why(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            name = signal.Signals(-code).name
            return f" ({name}{', often too little memory' if name == 'SIGKILL' else ''})"
    return "" if code is None else f" (exit code {code})"


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Ctrl-C is delivered to this process after the block, and never to the process started in it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(pipe: Connection) -> None:
    """The main function of a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from viewer_app.batch.worker import fuse_job

    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        pipe.send(fuse_job(job, pipe.send))


def _end_with_parent() -> None:
    """Ends this process if the parent is killed: a second run must not meet a worker of the first."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
