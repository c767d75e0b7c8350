"""Workers of a Dask cluster. They must see the recordings and the output folder under the same paths."""

import logging
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any

from devices.check import extra_command
from viewer_app.batch.jobs import Job, Outcome, Record, program_version
from viewer_app.batch.worker import fuse_job
from viewer_app.errors import UsageError

_CONNECT_WITHIN = 10  # seconds
_LOOKS_EVERY, _SEEN_WITHIN, _GIVES_UP_AFTER = 1.0, 10.0, 60.0  # seconds


def run_on_cluster(
    jobs: Sequence[Job], scheduler: str, tell: Callable[[str], None]
) -> Generator[Outcome, None, None]:
    """Runs the jobs on the workers of a scheduler; yields each outcome when it is known.

    A session that a worker reports must be here, too. Closing the generator cancels the jobs that have not
    started. Where no worker is left for a minute, the other jobs fail.

    Args:
        tell: Takes a line for the user.

    Raises:
        UsageError: The extra ``cluster`` is missing, there is no scheduler at this address, it has no
            workers, or a worker has another version of the program.
    """
    client = connect(scheduler)
    futures: dict[Any, Job] = {}
    try:
        distributed: Any = import_module("distributed")
        futures = {client.submit(fuse_job, job, pure=False): job for job in jobs}
        alone_since: float | None = None
        while futures:
            with suppress(TimeoutError), client.as_current():
                distributed.wait(list(futures), timeout=_LOOKS_EVERY, return_when="FIRST_COMPLETED")
            for future in [each for each in futures if each.done()]:
                job = futures.pop(future)
                try:
                    outcome = _seen_here(job, future.result())
                except Exception as error:  # the worker was lost
                    line = " ".join(str(error).split())
                    outcome = Outcome(job.name, None, f"The worker was lost, {type(error).__name__}: {line}")
                future.release()
                yield outcome
            if not futures or client.scheduler_info()["workers"]:
                alone_since = None
            elif alone_since is None:
                alone_since = time.monotonic()
                tell(f"No worker is left at {scheduler}. Waiting {_GIVES_UP_AFTER:g} s for one.")
            elif time.monotonic() - alone_since > _GIVES_UP_AFTER:
                yield from (Outcome(job.name, None, "No worker was left.") for job in futures.values())
                return
    finally:
        client.cancel(list(futures))
        client.close()


def _seen_here(job: Job, outcome: Outcome) -> Outcome:
    """The outcome, or a failure if the session is not where this machine looks for it."""
    deadline = time.monotonic() + _SEEN_WITHIN  # a network's folder shows a new file after some seconds
    while outcome.record is not None and not _is_of(job.record(), outcome.record):
        if time.monotonic() > deadline:
            return Outcome(job.name, None, f"Its worker wrote it elsewhere: {job.folder} is not shared.")
        time.sleep(0.2)
    return outcome


def _is_of(found: Record | None, reported: Record) -> bool:
    """Whether a record found here is the reported one, not that of the session which it replaces."""
    return found is not None and found["identity"] == reported["identity"]


def connect(scheduler: str) -> Any:
    """Connects to a scheduler and checks its workers; returns Dask's ``Client``."""
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise UsageError(
            f"--scheduler needs Dask, which is not installed: {extra_command('cluster')}"
        ) from None
    if "://" not in scheduler:
        raise UsageError(f"--scheduler {scheduler}: name an address such as tcp://192.168.1.5:8786.")
    for name in ("distributed", "distributed.core", "distributed.client", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # the message for the user is the UsageError
    try:
        client = distributed.Client(scheduler, timeout=_CONNECT_WITHIN, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise UsageError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error}).") from None
    try:
        _check_workers(client, scheduler)
    except BaseException:
        client.close()
        raise
    return client


def _check_workers(client: Any, scheduler: str) -> None:
    own = program_version()
    deadline = time.monotonic() + _CONNECT_WITHIN
    versions = client.run(program_version, on_error="return")
    # A scheduler still lists a worker that has just died, until it notices.
    while any(isinstance(other, OSError) for other in versions.values()) and time.monotonic() < deadline:
        time.sleep(0.2)
        versions = client.run(program_version, on_error="return")
    if not versions:
        raise UsageError(f"--scheduler {scheduler} has no workers. Start some: dask worker {scheduler}")
    for worker, other in versions.items():
        if isinstance(other, BaseException):
            what = " ".join(str(other).split())
            raise UsageError(f"The worker {worker} cannot run duplex-kinects {own}: {what}")
        if other != own:
            raise UsageError(f"The worker {worker} has duplex-kinects {other}; this machine has {own}.")
