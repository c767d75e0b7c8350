"""``duplex replay``: fuses the two skeletons of a session again."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fusion.fuser import Fuser
from fusion.setup import REVISIONS
from recordings.appearance.floor import floor_frame, floor_under
from recordings.data.session_arrays import SessionFrame, SessionFrames
from recordings.export.ros import capture_times
from recordings.quality.figures import report
from recordings.replaying import CUT_WITHIN, SHARE_AGREEING, Agreement, Replay
from recordings.session import Session
from viewer_app.errors import UsageError
from viewer_app.options.sessions import ReplayOptions
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs
from viewer_app.outputs.opening import OutputPlan, announce_outputs, check_kept, plan_outputs, print_outputs
from viewer_app.outputs.output import LiveOutput
from viewer_app.report import save_session_report
from viewer_app.report.pages.session_page import session_page
from viewer_app.report.terminal import print_damage, print_damaged_images, print_summary, say_more, say_saved
from viewer_app.running.compilation import warm_up
from viewer_app.running.loop import played
from viewer_app.sinks.sink import FanOut
from viewer_app.viewer.file_window import write_for_viewer, written_and_shown
from viewer_app.viewer.viewer_choice import window_opens


def run(options: ReplayOptions) -> None:
    """Runs the command; exits with code 1 if S* differs from the recorded S* under ``--verify``."""
    console = output_console()
    check_outputs([options.report, options.save_mcap], [options.session], options.force, options.save)
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
    replay = Replay.of(session, settings)
    with planned.opened(replay.segments[0][0], session.frame_rate) as outputs:
        announce_outputs(console, outputs)
        blocks = _fused(options, replay, outputs, console)
        replayed = replay.fused(blocks, images=options.save is not None)
    figures = report(replayed)
    window = not options.verify and window_opens(options.no_viewer, console)

    def write(path: Path) -> int:
        return write_for_viewer(replayed, path, session_page(replay.segments[-1][0], figures))

    with written_and_shown(options.save, write, force=options.force, window=window) as (_, damaged):
        if outputs:
            figures["outputs"] = [output.figures() for output in outputs]
        save_session_report(options.report, figures, replayed, options.force)
        print_summary(console, figures, replayed.events, options.verbose)
        print_outputs(console, outputs)
        if options.save is not None:
            say_saved(console, options.save)
            print_damaged_images(console, damaged or 0)
        if not options.verbose:
            say_more(console)
    check_kept(outputs)
    if options.verify and not verify(console, session, replayed.rows.fused):
        sys.exit(1)


def _of_one_view(session: Session) -> int:
    counts = session.frame_counts
    return counts["alone_a"] + counts["alone_b"]


def _fused(
    options: ReplayOptions, replay: Replay, outputs: Sequence[LiveOutput], console: Console
) -> Iterator[SessionFrames]:
    """Fuses the pairs of a session, at the recorded times where S* is sent to outputs."""
    quiet = not console.is_terminal
    shown = track(replay.blocks(), "fusing", len(replay), console=console, transient=True, disable=quiet)
    if options.pace == "fast":
        yield from shown
        return
    warm_up(console, Fuser.warm_ups(replay.segments[0][0].settings.method))
    setups = {own.start: setup for setup, own in replay.segments}
    fused = list(shown)
    frames = as_recorded(chain.from_iterable(fused), replay.session)
    for _ in played(frames, FanOut(outputs), setups, replay.session.events):
        pass
    yield from fused


def _planned(options: ReplayOptions) -> OutputPlan:
    """The outputs, which need the recorded pace."""
    plan = plan_outputs(options, options.listen, overwrite=options.force)
    if plan and options.pace != "live":
        raise UsageError("Outputs send S* at the recorded times: add --pace live.")
    if options.pace == "live" and not plan:
        raise UsageError("--pace live is for outputs: add one, such as --vmc 127.0.0.1:39539.")
    if options.listen is not None and not options.listens:
        raise UsageError(
            f"--listen {options.listen} is the address of --websocket and --lsl; add one of them."
        )
    return plan


def as_recorded(frames: Iterable[SessionFrame], session: Session) -> Iterator[SessionFrame]:
    """The frames of a replay with the times of the session and its floor, whose vertical is that of its
    angles."""
    under = floor_under(session.rows)
    height = float(under.translation @ under.rotation[:, 1])  # negative of a person who stands higher
    known = capture_times(session)
    stamps = [None] * len(session) if known is None else known.tolist()
    for frame, up, unix_ns in zip(frames, session.up_of_frames, stamps, strict=True):
        yield replace(frame, floor=floor_frame(up, height), unix_ns=unix_ns)


def verify(console: Console, session: Session, fused: NDArray[np.float64]) -> bool:
    """Compares S* (T, J, 3) with the recorded S* bit for bit; prints the result or the first difference."""
    found = Agreement.of(session, fused)
    match found.kind:
        case "bits":
            said = f"S* of all {len(session)} frames is the recorded one, bit for bit."
        case "rounded":
            said = (
                "the session is trimmed at its beginning, so the frame before it is unknown; from frame "
                f"{found.settled} on, the first without predicted joints, S* is the recorded one within "
                f"{CUT_WITHIN * 1e6:g} µm."
            )
        case "sigma":
            said = (
                f"{'frames were left out' if session.left_out else 'trimmed at its beginning'}, so the "
                "frames before are not known; once settled, at least "
                f"{SHARE_AGREEING:.0%} of the joints of S* are the recorded ones within one standard "
                "deviation."
            )
        case _:
            by = f"{found.apart * 1e3:.3g} mm" if found.apart else "less than the file's float32 shows"
            joint = "" if found.joint is None else f", joint {found.joint}, by {by}"
            missing = np.isnan(found.worst)
            worst = "only one has an S* in some frame" if missing else f"at most {found.worst * 1e3:.3g} mm"
            if session.left_out:
                console.print("Frames that were left out of the session also have an effect.")
            elif session.first_frame:
                console.print(
                    "The session is trimmed at its beginning; frames before it also have an effect."
                )
            console.print(
                f"[bold]S* differs[/] from the recorded one in {found.differing} of {len(session)} frames, "
                f"first at frame {found.frame}{joint}; {worst}."
            )
            return False
    console.print(f"[bold]Verified[/]: {said}")
    return True
