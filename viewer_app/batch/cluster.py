"""Workers of a Dask cluster. They must see the recordings and the output folder under the same paths."""

import logging
import time
from collections.abc import Generator, Sequence
from importlib import import_module
from typing import Any

from viewer_app.batch.jobs import Job, Outcome, program_version
from viewer_app.batch.worker import fuse_job
from viewer_app.errors import UsageError

_CONNECT_WITHIN = 10  # seconds


def run_on_cluster(jobs: Sequence[Job], scheduler: str) -> Generator[Outcome, None, None]:
    """Runs the jobs on the workers of a scheduler; yields each outcome when it is known.

    Closing the generator cancels the jobs that have not started.

    Raises:
        UsageError: The extra ``cluster`` is missing, there is no scheduler at this address, it has no
            workers, or a worker has another version of the program.
    """
    client = connect(scheduler)
    futures: dict[Any, Job] = {}
    try:
        distributed: Any = import_module("distributed")
        futures = {client.submit(fuse_job, job, pure=False): job for job in jobs}
        for future in distributed.as_completed(list(futures), loop=client.loop):
            job = futures.pop(future)
            try:
                outcome = future.result()
            except Exception as error:  # the worker was lost
                line = " ".join(str(error).split())
                outcome = Outcome(job.name, None, f"The worker was lost, {type(error).__name__}: {line}")
            future.release()
            yield outcome
    finally:
        client.cancel(list(futures))
        client.close()


def connect(scheduler: str) -> Any:
    """Connects to a scheduler and checks its workers; returns Dask's ``Client``."""
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise UsageError(
            "--scheduler needs Dask, which is not installed: pip install 'duplex-kinects[cluster]'"
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
