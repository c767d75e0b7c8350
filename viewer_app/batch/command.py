"""``duplex batch``: fuses many pairs of recordings and writes a summary."""

import os
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from devices.skeletons.name_tables import name_table
from recordings.calibration_file import read_calibration
from viewer_app.batch.finding import PAGE, TABLE, Pair, find_pairs
from viewer_app.batch.jobs import Job, Outcome, Record, tidy
from viewer_app.batch.manifest import read_manifest
from viewer_app.batch.summary import Row, State, worst_first, write_page, write_parquet
from viewer_app.errors import UsageError
from viewer_app.options.needs import refuse_without_effect
from viewer_app.options.sensing import BatchOptions, recording_settings
from viewer_app.options.shared import NAMES, calibration_source
from viewer_app.output_console import output_console
from viewer_app.output_files import claim, make_folder


def run(options: BatchOptions) -> None:
    """Runs the command; exits with code 1 if a pair could not be fused."""
    console = output_console()
    if options.processes < 0:
        raise UsageError(f"--processes must be 0 or more; got {options.processes}.")
    recording_settings(options)
    calibration = calibration_source(options.calibrate)
    if isinstance(calibration, Path):
        read_calibration(calibration)
        options = replace(options, calibrate=str(calibration.absolute()))
    for table in filter(None, (getattr(options, name) for name in NAMES)):
        name_table(table)
    options = _absolute(options)
    pairs, alone = _pairs(options)
    for line in alone:
        console.print(line, style="yellow", markup=False)
    jobs = [Job(pair, options) for pair in pairs]
    refuse_without_effect(*(job.fuse_options(job.folder) for job in jobs))
    make_folder(options.out)
    if not os.access(options.out, os.W_OK):
        raise UsageError(f"The folder {options.out} is not writable.")
    claim(options.out / TABLE)
    tidy(options.out)
    known, to_do = plan_work(jobs, options.force)
    if done := sum(row.state == "fused" for row in known):
        console.print(f"Sessions fused already: {done} of {len(pairs)}.")
    for row in known:
        if row.error:
            console.print(f"{row.job.name}: {row.error}", style="red", markup=False)
    rows: dict[str, Row] = {row.job.name: row for row in known}
    by_name = {job.name: job for job in to_do}
    before = {job.name: job.record() for job in to_do}
    try:
        if to_do:
            with closing(_outcomes(to_do, options, console)) as outcomes:
                for outcome in _shown(outcomes, len(to_do), console):
                    state: State = "failed" if outcome.record is None else "fused"
                    rows[outcome.name] = Row(by_name[outcome.name], state, outcome.record, outcome.error)
                    if outcome.error:
                        console.print(f"{outcome.name}: {outcome.error}", style="red", markup=False)
    finally:
        if options.scheduler is None or len(rows) == len(pairs):  # no worker is still at it
            tidy(options.out)
        # After an interruption a session may be in place whose worker did not report it any more.
        left = [_left(job, before[job.name]) for job in to_do if job.name not in rows]
        if rows or any(row.state == "fused" for row in left):
            ordered = worst_first([*rows.values(), *left])
            write_parquet(ordered, options.out / TABLE)
            write_page(ordered, options.out / PAGE)
    failed = sum(row.state == "failed" for row in rows.values())
    console.print(
        f"Sessions fused: {len(rows) - failed}, failed: {failed}. Summary: {options.out / PAGE}",
        markup=False,
        soft_wrap=True,
    )
    if failed:
        sys.exit(1)


def plan_work(jobs: Sequence[Job], force: bool) -> tuple[list[Row], list[Job]]:
    """The sessions that are finished, by the checksums of their inputs and their options; and other jobs.

    A session fails at once if it exists and an input cannot be read, or if its folder would have to be
    replaced and holds files of somebody else.

    Raises:
        UsageError: A session was fused from other recordings, with other options, by another version or
            revision of the method, and `force` is not set.
    """
    known: list[Row] = []
    left: list[Job] = []
    for job in jobs:
        record = job.record()
        try:
            difference = "" if record is None else _difference(record["identity"], job.identity())
        except OSError as fault:
            known.append(
                Row(job, "failed", None, f"{fault.filename or job.name}: {fault.strerror or fault}.")
            )
            continue
        if difference and not force:
            raise UsageError(
                f"{job.folder} was fused {difference}. Choose another --out, or fuse it again with --force."
            )
        if record is not None and not difference and job.is_whole:
            known.append(Row(job, "fused", record))
        elif strangers := job.strangers():
            why = f"{job.folder} holds files that duplex batch did not write: {', '.join(strangers[:3])}."
            known.append(Row(job, "failed", None, why))
        else:
            left.append(job)
    return known, left


def _left(job: Job, before: Record | None) -> Row:
    """A session of which no outcome was reported; its folder may still hold the one `before`."""
    record = job.record()
    return Row(job, "pending") if record in (None, before) else Row(job, "fused", record)


def _difference(before: dict[str, object], now: dict[str, object]) -> str:
    """What differs between two identities, for a message; empty if nothing does."""
    if before == now:
        return ""
    if not before:
        return "from what its record does not say"
    if before.get("program") != now["program"]:
        return f"by version {before.get('program')}; this is {now['program']}"
    if before.get("options") != now["options"]:
        old, new = before.get("options"), now["options"]
        assert isinstance(new, dict)
        changed = [name for name in new if not isinstance(old, dict) or old.get(name) != new[name]]
        return f"with another --{(changed or ['option'])[0].replace('_', '-')}"
    if before.get("method_revision") != now["method_revision"]:
        return f"by revision {before.get('method_revision')} of its method; this is {now['method_revision']}"
    return "from other recordings" if before.get("files") != now["files"] else "with other people"


def _absolute(options: BatchOptions) -> BatchOptions:
    """The options with absolute paths: a worker of a cluster has another working directory."""
    files: Any = {
        name: str(Path(table).absolute()) for name in NAMES if Path(table := getattr(options, name)).is_file()
    }
    return replace(
        options,
        source=options.source.absolute(),
        out=options.out.absolute(),
        **files,
        tracker_model=None if options.tracker_model is None else options.tracker_model.absolute(),
        k4abt=None if options.k4abt is None else options.k4abt.absolute(),
    )


def _pairs(options: BatchOptions) -> tuple[list[Pair], list[str]]:
    if options.source.is_dir():
        return find_pairs(options.source, options.out)
    if options.source.suffix.lower() == ".csv" or options.source.is_file():
        return read_manifest(options.source), []
    raise UsageError(f"No folder {options.source}. Name a folder of recordings, or a manifest (.csv).")


def _outcomes(jobs: Sequence[Job], options: BatchOptions, console: Console) -> Generator[Outcome, None, None]:
    if options.scheduler is not None:
        from viewer_app.batch.cluster import run_on_cluster

        return run_on_cluster(
            jobs, options.scheduler, lambda line: console.print(line, style="yellow", markup=False)
        )
    from viewer_app.batch.processes import run_in_processes

    return run_in_processes(jobs, options.processes or usable_processors())


def usable_processors() -> int:
    """How many processors this process may use: fewer than the machine has, as in a container."""
    process = psutil.Process()
    return len(process.cpu_affinity()) if hasattr(process, "cpu_affinity") else os.cpu_count() or 1


def _shown(outcomes: Iterator[Outcome], total: int, console: Console) -> Iterator[Outcome]:
    """The outcomes, with a progress bar on a terminal; elsewhere with a line for each fused session."""
    columns = TextColumn("fusing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("fusing", total=total)
        for finished, outcome in enumerate(outcomes, start=1):
            if not console.is_terminal and not outcome.error:
                console.print(
                    f"{outcome.name}: fused, {finished} of {total}.",
                    markup=False,
                    soft_wrap=True,
                )
            yield outcome
            progress.advance(task)
