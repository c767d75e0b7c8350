"""``duplex replay``: a session's two skeletons fused again, through the same loop as any other source."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.progress import track

from devices.pairing import Pairing
from fusion.fuser import Fuser
from recordings import layout
from recordings.session import Session
from recordings.session_arrays import RecordedFrame, SessionArrays
from recordings.writing.checksums import fused_checksums, joint_digests
from recordings.writing.recorder import Recorder
from recordings.writing.rewritten_session import copy_images
from viewer_app.errors import UsageError
from viewer_app.loop.fusing import fuse_offline
from viewer_app.options import ReplayOptions
from viewer_app.output_files import check_outputs, whole_file
from viewer_app.report.figures import FusionResult, print_summary, report, report_to_json
from viewer_app.viewer.blueprint import inspect_blueprint
from viewer_app.viewer.display import has_display
from viewer_app.viewer.file_window import written_and_shown

_CUT_WITHIN = 1e-6  # metres; float32 shows 2.4e-7 at 4 m


def run(options: ReplayOptions) -> None:
    """Carries out the command; ends the process with code 1 where S* is not the recorded one.

    Raises:
        FusionError, RecordingError, UsageError: With one line for the person who asked.
    """
    console = Console()
    changed: dict[str, Any] = {
        name: value
        for name in ("method", "h", "weights", "smoothing")
        if (value := getattr(options, name)) is not None
    }
    check_outputs([options.save, options.report], [options.session], options.force)
    session = Session.open(options.session)
    settings = replace(session.settings, **changed)
    if options.verify and settings != session.settings:
        raise UsageError(
            "--verify compares with what was recorded, so the settings must be those of the session. "
            "Use `duplex compare` for two fusions with different ones."
        )
    print_damage(console, session)
    setups = list(session.setups(settings))
    window = not options.no_viewer and not options.verify and has_display()
    with written_and_shown(
        options.save, window, inspect_blueprint(session.body, whereabouts(session))
    ) as stream:
        about: dict[str, str | int] = {"first_frame": session.first_frame, "replay_of": session.path.name}
        recorder = Recorder(stream, setups[0][0], session.sources, about=about)
        pairs = list(session.pairs())
        frames: list[RecordedFrame] = []
        shown = track(setups, "fusing", console=console, transient=True, disable=not console.is_terminal)
        for setup, own in shown:
            if own.start > 0:
                recorder.recalibrated(setup)
            recorder.event(f"calibrated: {setup.calibration.how}")
            frames += fuse_offline(pairs[own], Fuser(setup), recorder)
        damaged = 0 if options.save is None else copy_images(session, recorder, 0, len(session))
        recorder.finish()

    rows = SessionArrays.stack(session.body, session.rows.bone_lengths, frames)
    result = FusionResult(pairing_of(session), session.calibration, settings, rows)
    figures = report(result)
    if options.report is not None:
        with whole_file(options.report) as partial:
            partial.write_text(report_to_json(figures), encoding="utf-8")
    print_summary(console, result, figures)
    if options.save is not None:
        console.print(f"Saved {options.save}.", highlight=False, markup=False)
        print_damaged_images(console, damaged)
    if options.verify and not verify(console, session, rows.fused):
        sys.exit(1)


def verify(console: Console, session: Session, fused: NDArray[np.float64]) -> bool:
    """Whether (T, J, 3) S* is the recorded one bit for bit; says so, or where it first is not."""
    differing = np.flatnonzero(fused_checksums(fused) != session.fused_checksums)
    if len(differing) == 0:
        console.print(f"[bold]Verified[/]: S* of all {len(session)} frames is the recorded one, bit for bit.")
        return True
    t = int(differing[0])
    recorded = session.rows.fused[t].astype(np.float32)
    visible = np.flatnonzero(
        ~np.isclose(fused[t].astype(np.float32), recorded, 0, 0, equal_nan=True).all(axis=1)
    )
    invisible = np.flatnonzero(joint_digests(fused[t : t + 1])[0] != session.joint_digests[t])
    apart = np.linalg.norm(fused - session.rows.fused, axis=2)
    one_missing = (np.isnan(fused) != np.isnan(session.rows.fused)).any()
    where = f"frame {t}"
    if len(visible):
        j = int(visible[0])
        where += f", joint {session.body.joints[j]}, by {apart[t, j] * 1e3:.3g} mm"
    elif len(invisible):
        where += f", joint {session.body.joints[invisible[0]]}, by less than the file's float32 shows"
    worst = "only one has an S* in some frame" if one_missing else f"at most {np.nanmax(apart) * 1e3:.3g} mm"
    # a joint without data follows the frame before, which a session trimmed at its beginning does not have
    settled = int(np.argmin(session.rows.predicted.any(axis=1)))
    if session.first_frame and not one_missing and np.nanmax(apart[settled:]) < _CUT_WITHIN:
        console.print(
            f"[bold]Verified[/]: trimmed at its beginning: the frame before is not known; "
            f"from frame {settled} on, the first without predicted joints, S* is the recorded one within "
            f"{_CUT_WITHIN * 1e6:g} µm."
        )
        return True
    console.print(
        f"[bold]S* differs[/] from the recorded one in {len(differing)} of {len(session)} frames, first at "
        f"{where}; {worst}."
    )
    return False


def pairing_of(session: Session) -> Pairing:
    """The session's pairs, as a report counts them; what was dropped before it was recorded is not known."""
    rows = session.rows
    seen_a, seen_b = (int((clock != layout.NO_FRAME).sum()) for clock in (rows.clock_a, rows.clock_b))
    return Pairing(list(session.pairs()), seen_a, seen_b, 0, 0)


def whereabouts(session: Session) -> NDArray[np.float64]:
    """(3,) metres in K_A's frame, the middle of where the person is; somewhere before it where no one is."""
    at = session.rows.fused.reshape(-1, 3)
    seen = at[np.isfinite(at).all(axis=1)]
    return np.asarray(np.median(seen, axis=0)) if len(seen) else np.array([0.0, 0.0, 2.5])


def print_damage(console: Console, session: Session) -> None:
    """Says what is wrong with a file, where something is."""
    if session.damage is not None:
        lost = f"; {session.frames_lost} more were written and are lost" if session.frames_lost else ""
        console.print(
            f"[bold yellow]{escape(str(session.path))} is not whole[/]: {escape(session.damage)}. "
            f"{len(session)} frames could be read{lost}.",
            highlight=False,
        )


def print_damaged_images(console: Console, count: int) -> None:
    """Says how many images could not be copied, where there are any."""
    if count:
        console.print(f"[bold yellow]{count} damaged images[/] were left out.", highlight=False)
