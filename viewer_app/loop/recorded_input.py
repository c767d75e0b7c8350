"""Two recordings read, their people chosen, their frames paired: what ``duplex fuse`` starts from."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from devices.azure.recording.mkv import MkvInfo, MkvRecording
from devices.azure.tracking.body_tracker import TrackerSettings
from devices.pairing import FramePair, Pairing, pair_recordings
from devices.recorded_person import choose_person, with_successors
from devices.sensor import DeviceError, Sensor, SensorFrame
from devices.sources import one_person, open_source, recording_info, warnings_of, without_images
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from recordings import layout
from recordings.writing.recorder import Recorder
from viewer_app.loop.image_thinning import Depth, thinned, thinned_camera
from viewer_app.options import FuseOptions
from viewer_app.sinks.live_session import LiveSession

_CLOCKS_AGREE_NS = 1_000_000
"""Synchronised captures lie this near to their delay: the sensors' own timing is within 0.1 ms."""


@dataclass(frozen=True, eq=False)
class TwoRecordings:
    """What two recordings hold, without their images.

    Attributes:
        body: Of both.
        pairing: Their frames, paired.
        intrinsics: Of the depth cameras, where the recordings say.
        warnings: What a person should know about them, a line each.
        images: The files that hold depth images, A's and B's; None for skeletons alone.
    """

    body: Body
    pairing: Pairing
    intrinsics: tuple[Intrinsics | None, Intrinsics | None]
    warnings: tuple[str, ...]
    images: tuple[Path | None, Path | None] = (None, None)

    def cameras(self, depth: Depth) -> tuple[Intrinsics | None, Intrinsics | None]:
        """The intrinsics, for depth images as they are logged."""
        a, b = (None if camera is None else thinned_camera(camera, depth) for camera in self.intrinsics)
        return a, b


def read_two(options: FuseOptions, console: Console) -> TwoRecordings:
    """Reads both recordings, one after the other: only one body tracker is in the GPU's memory at once.

    Raises:
        DeviceError: A recording cannot be read or tracked, the bodies differ, or the two never overlap.
    """
    tracker = TrackerSettings(processing=options.processing, library=options.k4abt)
    a = open_source(options.a, options.skeletons_a, tracker, "--skeletons-a")
    b = open_source(options.b, options.skeletons_b, tracker, "--skeletons-b")
    frames_a, info_a = _read(a, options.person_a, console)
    frames_b, info_b = _read(b, options.person_b, console)
    if a.body is not b.body:
        raise DeviceError(
            f"{a.name} has the {len(a.body)} joints of {a.body.name}, {b.name} the {len(b.body)} of "
            f"{b.body.name}. Both sensors must be of one family."
        )
    person_a = choose_person(frames_a, options.person_a, a.name, "--person-a")
    person_b = choose_person(frames_b, options.person_b, b.name, "--person-b")
    said = [*warnings_of(a), *warnings_of(b)]
    if options.person_a is None:
        frames_a, renamed = with_successors(frames_a, person_a)
        said += _said_of(a, person_a, renamed, "--person-a")
    if options.person_b is None:
        frames_b, renamed = with_successors(frames_b, person_b)
        said += _said_of(b, person_b, renamed, "--person-b")
    pairing = pair_recordings(frames_a, frames_b, person_a, person_b)
    said += clock_warnings(info_a, info_b, pairing.pairs)
    images = (None if info_a is None else options.a, None if info_b is None else options.b)
    return TwoRecordings(a.body, pairing, (a.intrinsics, b.intrinsics), tuple(said), images)


def log_depth(read: TwoRecordings, recorder: Recorder | LiveSession, depth: Depth, console: Console) -> None:
    """Logs the depth images of the pairs that are logged already, in a pass of its own over the files.

    One image is in memory at a time, however long the recordings are.
    """
    pairs = read.pairing.pairs
    for side, path in zip(layout.SIDES, read.images, strict=True):
        if path is None or depth == "none":
            continue
        frames = enumerate(getattr(pair, side) for pair in pairs)
        number = {frame.time_ns: k for k, frame in frames if frame is not None}
        with MkvRecording(path, color=False) as recording:
            shown = track(
                recording.frames(),
                f"depth of {recording.name}",
                total=len(pairs),
                console=console,
                transient=True,
                disable=not console.is_terminal,
            )
            for frame in shown:
                k = number.get(frame.time_ns)
                if k is not None and frame.depth is not None:
                    recorder.record_depth(
                        side, k, pairs[k].time_ns - pairs[0].time_ns, thinned(frame.depth, depth)
                    )


def clock_warnings(a: MkvInfo | None, b: MkvInfo | None, pairs: Iterable[FramePair]) -> list[str]:
    """What is doubtful about the two clocks; nothing for recordings that do not say how they were made.

    On a sync cable the master's first pulse starts the subordinate's clock at the master's time, and device
    times (start offset + time in the file) are of one clock, on which B lags A by the delay set: pairs are
    then right as they are, and their skew is that delay. Firmware 1.6.107 and later may not restart the
    clock: then it is a constant off, which shows in the skew, but not by how many whole frames. So that is
    said, not mended. Without a cable each clock starts when its sensor does.
    """
    if a is None or b is None:
        return []
    roles = {a.sync_mode, b.sync_mode}
    if roles != {"MASTER", "SUBORDINATE"}:
        return [
            f"The sensors ran without a common clock ({a.sync_mode.lower()}, {b.sync_mode.lower()}): frames "
            f"are paired as if both had been started at the same moment. Record with a sync cable."
        ]
    delay_ns = b.subordinate_delay_ns if b.sync_mode == "SUBORDINATE" else -a.subordinate_delay_ns
    off_ns = int(np.median([pair.skew_ns for pair in pairs])) - delay_ns
    if abs(off_ns) <= _CLOCKS_AGREE_NS:
        return []
    return [
        f"The sensors captured {delay_ns / 1e6:.2f} ms apart by their cable, but their times lie "
        f"{(off_ns + delay_ns) / 1e6:.1f} ms apart: the subordinate's clock was not set by its master, and "
        f"frames may be paired with their neighbours. Start the subordinate first, the master last."
    ]


def _read(source: Sensor, person: str | None, console: Console) -> tuple[list[SensorFrame], MkvInfo | None]:
    with ExitStack() as stack:
        stack.enter_context(source)
        info = recording_info(source)
        if info is None:
            return list(source.frames()), None
        frames = without_images(source)
        if person is None:
            frames = one_person(frames)  # a body tracker gives one person several ids
        total = info.duration_ns // info.interval_ns + 1 if info.duration_ns else None
        shown = track(
            frames,
            f"reading {source.name}",
            total=total,
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        return list(shown), info


def _said_of(source: Sensor, person: str, others: tuple[str, ...], flag: str) -> list[str]:
    if not others:
        return []
    named = ", ".join(map(repr, others[:5])) + (" …" if len(others) > 5 else "")
    return [
        f"{source.name}: person {named} is followed "
        f"while {person!r} is not seen. {flag} {person} follows {person!r} alone."
    ]
