"""``duplex replay``: fuses the two skeletons of a session again."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fusion.facing.labels import DOUBT_STEPS, Labels
from fusion.fuser import Fuser
from fusion.plan import plan_recording
from fusion.setup import REVISIONS, FuserSettings
from recordings.fusing.pairs import Segments, block_count, calibration_event, fuse_segments, setups_of
from recordings.fusing.view_events import watch
from recordings.images import NO_IMAGES
from recordings.session import Session
from recordings.session_arrays import SessionFrames
from recordings.writing.checksums import fused_checksums, joint_digests
from viewer_app.errors import UsageError
from viewer_app.options.sessions import ReplayOptions
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs
from viewer_app.outputs.opening import OutputPlan, announce_outputs, plan_outputs, print_outputs
from viewer_app.outputs.output import LiveOutput
from viewer_app.report.figures import report, save_report
from viewer_app.report.session_page import session_page
from viewer_app.report.terminal import print_damage, print_damaged_images, print_summary, say_more, say_saved
from viewer_app.running.loop import played, warm_up
from viewer_app.sinks.sink import FanOut
from viewer_app.viewer.display import has_display
from viewer_app.viewer.file_window import write_for_viewer, written_and_shown

_CUT_WITHIN = 1e-6  # metres; float32 shows 2.4e-7 at 4 m
_SETTLED_NS = 1_000_000_000  # the time in which the estimator forgets a person
_SHARE_AGREEING = 0.99


def run(options: ReplayOptions) -> None:
    """Runs the command; exits with code 1 if S* differs from the recorded S* under ``--verify``."""
    console = output_console()
    check_outputs([options.report], [options.session], options.force, options.save)
    session = Session.open(options.session)
    names = ("method", "h", "weights", "smoothing")
    changed: dict[str, Any] = {name: getattr(options, name) for name in names}
    settings = replace(session.settings, **{k: value for k, value in changed.items() if value is not None})
    # The session of another method, or of an older version, may hold them; here they have no effect.
    if settings.method == "duplex" and (options.h is not None or options.weights is not None):
        raise UsageError("--h and --weights need --method paper or published.")
    if settings.method != "duplex" and options.smoothing is not None:
        raise UsageError("--smoothing needs --method duplex.")
    if options.verify and settings != session.settings:
        raise UsageError(
            "--verify compares with what was recorded, so the settings must be those of the session. "
            "Use `duplex compare` for two fusions with different ones."
        )
    planned = _planned(options)
    print_damage(console, session)
    if session.settings.method == settings.method and session.method_revision != REVISIONS[settings.method]:
        console.print(f"The method {settings.method} has changed since this session was made; S* is today's.")
    if settings.method != session.settings.method == "duplex" and (alone := _of_one_view(session)):
        console.print(
            f"{alone} of {len(session)} moments have one view alone. "
            f"`duplex fuse --method {settings.method}` leaves such moments out, a replay does not."
        )
    segments, labels = _plan(session, settings)
    with planned.opened(segments[0][0], session.frame_rate) as outputs:
        announce_outputs(console, outputs)
        blocks = _fused(options, session, segments, labels, outputs, console)
        replayed = _replayed(session, segments, blocks, with_images=options.save is not None)
    figures = report(replayed)
    window = not options.no_viewer and not options.verify and has_display()

    def write(path: Path) -> int:
        return write_for_viewer(replayed, path, session_page(segments[-1][0], figures))

    with written_and_shown(options.save, write, window=window) as (_, damaged):
        if outputs:
            figures["outputs"] = [output.figures() for output in outputs]
        save_report(options.report, figures)
        print_summary(console, figures, replayed.events, options.verbose)
        print_outputs(console, outputs)
        if options.save is not None:
            say_saved(console, options.save)
            print_damaged_images(console, damaged or 0)
        if not options.verbose:
            say_more(console)
    if options.verify and not verify(console, session, replayed.rows.fused):
        sys.exit(1)


def _of_one_view(session: Session) -> int:
    counts = session.frame_counts
    return counts["alone_a"] + counts["alone_b"]


def _plan(session: Session, settings: FuserSettings) -> tuple[Segments, Labels | None]:
    """The setups of the replay, and the labels that are given to it; None: they are found."""
    if settings.method == "duplex" and session.settings.method != "duplex":
        # The session has neither labels nor a refined calibration: they are found as for two recordings.
        settings = replace(settings, hindsight="labels")
        skeletons = session.recorded_pairs.skeletons
        plan = plan_recording(session.body, skeletons, settings, session.calibration)
        return setups_of(plan, settings, (session.intrinsics_a, session.intrinsics_b)), plan.labels
    rows, labels = session.rows, None
    if rows.exchanged is not None:
        # where the sides were found pair by pair, doubt and heading are found again, to the bit
        again = settings.hindsight == "none"
        doubt = 0.0 if rows.side_doubt is None else rows.side_doubt / DOUBT_STEPS
        labels = Labels.with_sides(rows.exchanged, np.nan if again else doubt)
        if rows.heading is not None and not again:
            labels.heading[:] = rows.heading
    return list(session.setups(settings)), labels


def _fused(
    options: ReplayOptions,
    session: Session,
    segments: Segments,
    labels: Labels | None,
    outputs: Sequence[LiveOutput],
    console: Console,
) -> Iterator[SessionFrames]:
    """Fuses the pairs of a session, at the recorded times where S* is sent to outputs."""
    blocks = fuse_segments(segments, session.recorded_pairs, labels)
    quiet, count = not console.is_terminal, block_count(segments)
    shown = track(blocks, "fusing", count, console=console, transient=True, disable=quiet)
    if options.pace == "fast":
        yield from shown
        return
    warm_up(Fuser(segments[0][0]), console)
    setups = {own.start: setup for setup, own in segments}
    fused = list(shown)
    for _ in played(chain.from_iterable(fused), FanOut(outputs), setups, session.events):
        pass
    yield from fused


def _replayed(
    session: Session, segments: Segments, blocks: Iterable[SessionFrames], with_images: bool
) -> Session:
    """The session of the replay, with the events that it found itself."""
    events = [calibration_event(setup, own, session.time_ns) for setup, own in segments]
    watched = watch(session.body, blocks, int(session.time_ns[0]), events)
    replayed = Session.of(
        [(setup, islice(watched, block_count([(setup, own)]))) for setup, own in segments],
        session.sources,
        images=session.images if with_images else NO_IMAGES,
        about=session.origin | {"first_frame": session.first_frame, "replay_of": session.name},
    )
    return replace(replayed, events=tuple(sorted(events, key=lambda event: event.frame)))


def _planned(options: ReplayOptions) -> OutputPlan:
    """The outputs, which need the recorded pace."""
    plan = plan_outputs(options, options.listen)
    if plan and options.pace != "live":
        raise UsageError("Outputs send S* at the recorded times: add --pace live.")
    if options.pace == "live" and not plan:
        raise UsageError("--pace live is for outputs: add one, such as --vmc 127.0.0.1:39539.")
    if options.listen is not None and not options.listens:
        raise UsageError(
            f"--listen {options.listen} is the address of --websocket and --lsl; add one of them."
        )
    return plan


def verify(console: Console, session: Session, fused: NDArray[np.float64]) -> bool:
    """Compares S* (T, J, 3) with the recorded S* bit for bit; prints the result or the first difference."""
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
    # A joint without data depends on the frame before, which a session trimmed at its beginning lacks.
    settled = int(np.argmin(session.rows.predicted.any(axis=1)))
    if session.first_frame and not one_missing and np.nanmax(apart[settled:]) < _CUT_WITHIN:
        console.print(
            f"[bold]Verified[/]: the session is trimmed at its beginning, so the frame before it is unknown; "
            f"from frame {settled} on, the first without predicted joints, S* is the recorded one within "
            f"{_CUT_WITHIN * 1e6:g} µm."
        )
        return True
    if session.first_frame and session.settings.method == "duplex" and _agrees_once_settled(session, fused):
        console.print(
            "[bold]Verified[/]: trimmed at its beginning, so the frames before are not known; "
            f"once settled, at least {_SHARE_AGREEING:.0%} of the joints of S* are the recorded ones "
            "within one standard deviation."
        )
        return True
    console.print(
        f"[bold]S* differs[/] from the recorded one in {len(differing)} of {len(session)} frames, first at "
        f"{where}; {worst}."
    )
    return False


def _agrees_once_settled(session: Session, fused: NDArray[np.float64]) -> bool:
    """Whether S* is the recorded one within its standard deviation, after a second or half of the session.

    The estimator of the method ``duplex`` remembers the frames before, which a trim has cut off.
    """
    settled = session.time_ns >= min(_SETTLED_NS, int(session.time_ns[-1]) // 2)
    if (np.isnan(fused) != np.isnan(session.rows.fused)).any():
        return False
    apart = np.linalg.norm(fused - session.rows.fused, axis=2)[settled]
    within = apart <= session.rows.filled("sigma")[settled]
    return bool(np.mean(within[np.isfinite(apart)]) >= _SHARE_AGREEING)
