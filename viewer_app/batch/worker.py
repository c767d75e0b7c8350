"""Fuses one pair as ``duplex fuse --save`` does; runs in a process of this machine or on a Dask worker."""

import json
import os
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from fusion.errors import DuplexError
from recordings.quality.figures import Figures
from recordings.quality.without_truth import truth_free_figures
from recordings.session import Session
from viewer_app.batch.jobs import RECORD, Job, Outcome, Record
from viewer_app.commands.fuse import fuse_files
from viewer_app.flags import in_flags
from viewer_app.output_files import outputs_of_one_run

_ONE_AT_A_TIME = threading.Lock()
"""A Dask worker may have several threads; the memory of one recording is enough."""


def fuse_job(job: Job) -> Outcome:
    """Fuses a pair into its folder. Every error becomes the line of the outcome."""
    with _ONE_AT_A_TIME:
        try:
            return Outcome(job.name, _fuse(job))
        except DuplexError as error:
            return Outcome(job.name, None, _one_line(in_flags(str(error))))
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
    finished = job.record() if job.is_whole else None
    if finished is not None and finished["identity"] == identity:
        # A cluster repeats a job if its worker is lost after the session is in its place.
        return finished
    partial = job.partial
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        options = job.fuse_options(partial)
        with Path(os.devnull).open("w", encoding="utf-8") as nothing, outputs_of_one_run():
            session, figures = fuse_files(options, Console(file=nothing, highlight=False))
        figures["without_truth"] = truth_free_figures(session)
        if job.options.pages:
            from viewer_app.report.pages.review_page import review_page  # imports matplotlib

            page = review_page(replace(session, path=job.session), figures)
            (partial / job.page.name).write_text(page, encoding="utf-8")
        record: Record = {
            "identity": identity,
            "sources": list(session.sources),
            "warnings": [in_flags(event.text) for event in session.events if event.level == "WARN"],
            "figures": _session_figures(session, figures),
        }
        text = json.dumps(record, indent=1, allow_nan=False, ensure_ascii=False)
        (partial / RECORD).write_text(text + "\n", encoding="utf-8")
        job.place()
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return record


def _session_figures(session: Session, figures: Figures) -> Figures:
    """The figures in SI units, by name; None where there is no such figure."""
    rows, registration = session.rows, session.calibration.registration
    error, apart = figures["bone_error_mm"]["fused"]["max"], figures["views_agree_mm"]["median"]
    return {
        "frames": len(session),
        "seconds": figures["seconds"],
        "body": session.body.name,
        **{
            f"{name}_{side}": figures[name][side]
            for name in ("frames", "dropped", "alone", "stale", "without_person")
            for side in "ab"
        },
        "without_fused": int(np.isnan(rows.fused).all(axis=(1, 2)).sum()),
        "calibration": session.calibration.how,
        "calibrations": len(session.calibrations),
        "verdict": figures["verdict"]["word"],
        "verdict_reason": figures["verdict"]["reason"],
        "good": float(session.good_frames.mean()),
        "views_agree": None if apart is None else apart * 1e-3,
        "rotation_sd": None if registration is None else registration.rotation_sd,
        "axes_angle": session.calibration.axes_angle,
        "bone_error": None if error is None else error * 1e-3,
        "fuse_seconds": float(rows.fuse_ms.sum()) * 1e-3,
        **figures["without_truth"],
    }


def _one_line(text: str) -> str:
    return " ".join(text.split())
