"""Worker processes on this machine; one that dies costs only its own job."""

import os
import signal
import sys
import threading
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, as_completed
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from typing import Any

from pebble import ProcessExpired, ProcessPool

from recordings.fusing.files import recording_warm_ups
from viewer_app.batch.jobs import Job, Outcome
from viewer_app.batch.worker import fuse_job
from viewer_app.options.sensing import recording_settings
from viewer_app.output_console import output_console
from viewer_app.running.compilation import warm_up


def run_in_processes(jobs: Sequence[Job], processes: int) -> Generator[Outcome, None, None]:
    """Runs the jobs and yields each outcome when it is known. Closing the generator ends all processes."""
    settings = recording_settings(jobs[0].options)
    warm_up(output_console(), recording_warm_ups(settings), load=False)  # before any worker needs the kernels
    # Spawned, not forked: the threads of numba and OpenBLAS do not survive a fork.
    spawn: Any = get_context("spawn")
    pool = ProcessPool(min(processes, len(jobs)), initializer=_begin, context=spawn)
    try:
        with _ctrl_c_held_back():
            futures: dict[Future[Outcome], Job] = {pool.schedule(fuse_job, args=[job]): job for job in jobs}
        for future in as_completed(futures):
            try:
                yield future.result()
            except ProcessExpired as expired:
                yield Outcome(futures[future].name, None, f"The worker process died{_why(expired.exitcode)}.")
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()


def _why(code: int) -> str:
    if code < 0:
        with suppress(ValueError):
            name = signal.Signals(-code).name
            return f" ({name}{', often too little memory' if name == 'SIGKILL' else ''})"
    return f" (exit code {code})"


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Delays Ctrl-C until after the block; threads and processes that start in it never get it."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Prepares a worker: the parent ends it, also by being killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exits with the parent, so that a later batch finds no worker of this one."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
