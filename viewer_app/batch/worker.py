"""Fuses one pair as ``duplex fuse --save`` does; runs in a process of this machine or on a Dask worker."""

from __future__ import annotations

import json
import os
import shutil
import threading
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from viewer_app.batch.figures import session_figures
from viewer_app.batch.jobs import RECORD, Job, Outcome, Record
from viewer_app.commands.fuse import fuse_files
from viewer_app.errors import mistakes
from viewer_app.report.figures import truth_free_figures

_ONE_AT_A_TIME = threading.Lock()
"""A Dask worker may have several threads; the memory of one recording is enough."""


def fuse_job(job: Job) -> Outcome:
    """Fuses a pair into its folder. Every error becomes the line of the outcome."""
    with _ONE_AT_A_TIME:
        try:
            return Outcome(job.name, _fuse(job))
        except mistakes() as error:
            return Outcome(job.name, None, _one_line(str(error)))
        except OSError as error:
            name = f"{error.filename}: " if error.filename else ""
            return Outcome(job.name, None, _one_line(f"{name}{error.strerror or error}."))
        except MemoryError:
            return Outcome(job.name, None, "Not enough memory for these recordings.")
        except Exception as error:  # a defect of the program must not stop the other pairs
            return Outcome(job.name, None, _one_line(f"internal error, {type(error).__name__}: {error}"))


def _fuse(job: Job) -> Record:
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    identity = job.identity()
    finished = job.record()
    if finished is not None and finished["identity"] == identity:
        # A cluster repeats a job if its worker is lost after the session is in its place.
        return finished
    partial = job.partial
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        options = job.fuse_options(partial)
        with Path(os.devnull).open("w", encoding="utf-8") as nothing:
            session, figures = fuse_files(options, Console(file=nothing, highlight=False))
        figures["without_truth"] = truth_free_figures(session)
        if job.options.pages:
            from viewer_app.report.review_page import review_page  # imports matplotlib

            page = review_page(replace(session, path=job.session), figures)
            (partial / job.page.name).write_text(page, encoding="utf-8")
        record: Record = {
            "identity": identity,
            "sources": list(session.sources),
            "warnings": [event.text for event in session.events if event.level == "WARN"],
            "figures": session_figures(session, figures),
        }
        text = json.dumps(record, indent=1, allow_nan=False, ensure_ascii=False)
        (partial / RECORD).write_text(text + "\n", encoding="utf-8")
        job.place()
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return record


def _one_line(text: str) -> str:
    return " ".join(text.split())
