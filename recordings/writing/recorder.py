"""Logs a session to a stream: constant data once, frames by columns, everything else when it changes.

A recorder begins with what a reader needs first: constant data, properties, the calibration. Then come frames
in the order of their numbers. An event or a calibration comes after the frame that it follows.
:meth:`Recorder.finish` comes last.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.depth.image_thinning import has_image
from devices.events import Event
from fusion.setup import FusionSetup
from recordings.appearance import entity_styles
from recordings.appearance.coach_page import CoachPage
from recordings.appearance.joint_trust import TrustColors
from recordings.data import layout
from recordings.data.checksums import event_checksum, properties_checksum
from recordings.data.session_arrays import SessionArrays, SessionFrame
from recordings.writing.arrow_columns import Times, own_values
from recordings.writing.changes import (
    PlacementLog,
    QualityLog,
    StatesLog,
    StreamFiguresLog,
    set_time,
)
from recordings.writing.frame_columns import frame_columns
from recordings.writing.other_people import OthersLog
from recordings.writing.properties import calibration_values, session_properties
from recordings.writing.shown_images import ImageLog


class Recorder:
    """Writes one session to a Rerun recording stream, which the caller owns and closes.

    Args:
        stream: The stream; its sinks are a viewer, a file or both.
        setup: Settings, calibration and cameras, stored with the session.
        sources: Names of the sensors, K_A first.
        depth_every: Keep the images of every n-th pair; 0 for none.
        start_ns: Start time of the session; None: the time of the first recorded frame.
        points: Whether to log depth images as point clouds too.
        plots_later: Whether :meth:`plot` logs what is plotted, for many frames together: each message costs
            as much as many numbers. What is drawn into the scene is logged with each frame.
        pause: Called between two messages of a block of frames, so that threads in a hurry go first.

    Attributes:
        images: Writes single images.
        others: Writes the people who are not followed.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        setup: FusionSetup,
        sources: tuple[str, str],
        depth_every: int = 0,
        about: Mapping[str, str | float] | None = None,
        *,
        start_ns: int | None = None,
        points: bool = False,
        plots_later: bool = False,
        pause: Callable[[], object] | None = None,
    ) -> None:
        self._stream = stream
        self._calibration = setup.calibration
        self._pause = pause or (lambda: None)
        self._start_ns = start_ns
        self._last: tuple[int, int] | None = None  # number and time of the last frame
        self._had: set[str] = set()  # figures that a frame has had, which all later ones have
        self._plots_later, self._unplotted = plots_later, list[SessionArrays]()
        self._shown = points
        self._of_images: dict[tuple[str, str], NDArray[np.int64]] = {}
        self.images = ImageLog(stream, setup, depth_every, points)
        self.others = OthersLog(stream)
        self._figures, self._trust_colors = StreamFiguresLog(stream), TrustColors()
        self._placement, self._quality = PlacementLog(stream, setup, points), QualityLog(stream)
        self._states = StatesLog(stream, setup.body, self._pause)
        for entity, what in _constant(setup, points):
            stream.log(entity, *what, static=True)
        properties = session_properties(setup, sources, about or {})
        for name, values in properties.items():
            stream.send_property(name, own_values(**values))
        stream.send_property("check", own_values(crc32=properties_checksum(properties)))
        self.recalibrated(setup)
        # data that a reader needs first must come first in the file; columns would overtake it
        stream.flush(timeout_sec=0.0)

    @property
    def _next(self) -> int:
        """The number of the next frame."""
        return 0 if self._last is None else self._last[0] + 1

    def recalibrated(self, setup: FusionSetup) -> None:
        """Logs the calibration of a new setup, which applies to the following frames."""
        self.plot()
        self._calibration = setup.calibration
        values = calibration_values(setup.calibration)
        set_time(self._stream, self._next, self._last[1] if self._last else 0)
        check = properties_checksum({"calibration": {"frame": self._next, **values}})
        self._stream.log(layout.CALIBRATION, own_values(**values, calibration_crc32=check))

    def record_all(self, frames: Sequence[SessionFrame], numbers: Sequence[int] | None = None) -> None:
        """Logs the following frames by columns, with their images.

        Args:
            numbers: Frame numbers, if frames were left out. None: consecutive numbers.
        """
        if numbers is None:
            numbers = range(self._next, self._next + len(frames))
        of, begun_ns = self._calibration, self._begun_by(frames[0])
        rows = SessionArrays.stack(of.body, of.bone_lengths, frames, numbers, begun_ns)
        filled: dict[str, Any] = {name: rows.filled(name) for name in self._had}
        rows = replace(rows, **filled)
        if new := {name for name, _, _ in rows.figures()} - self._had:
            self.plot()  # frames that are plotted together have the same figures
            self._had |= new
        if self._shown:
            self._of_images = {
                (side, kind): self.images.moments(
                    side,
                    kind,
                    rows.time_ns,
                    np.array([has_image(getattr(of.pair, side), kind) for of in frames]),
                )
                for side in layout.VIEWS
                for kind in layout.IMAGE_KINDS
            }
        self.record_rows(rows)
        for frame, number, time_ns in zip(frames, numbers, rows.time_ns.tolist(), strict=True):
            self.others.record(number, time_ns, frame.pair)
            if frame.streams is not None:
                self._figures.record(number, time_ns, frame.streams)
            self.record_images(number, frame)

    def record_images(self, number: int, frame: SessionFrame) -> None:
        """Logs the images of a frame, in time order. The frame must be recorded later without images."""
        self.images.record(number, frame.pair.time_ns - self._begun_by(frame), frame.pair)

    def record_rows(self, rows: SessionArrays) -> None:
        """Logs the following frames as arrays, with their own numbers and times."""
        self._placement.record(rows)
        colors = self._trust_colors.add(rows)
        if self._plots_later:
            self._send(frame_columns(rows, colors=colors, plotted=False))
            self._unplotted.append(rows)
        else:
            self._send(frame_columns(rows, colors=colors, up=self._placement.up))
            self._explain(rows)
        self._last = (int(rows.frame[-1]), int(rows.time_ns[-1]))

    @property
    def unplotted(self) -> int:
        """How many frames are drawn and not yet plotted."""
        return sum(map(len, self._unplotted))

    def plot(self) -> None:
        """Logs the figures of frames that are drawn and not yet plotted, if there are any."""
        if self._unplotted:
            rows = SessionArrays.joined(self._unplotted)
            self._unplotted.clear()
            self._send(frame_columns(rows, up=self._placement.up))
            self._explain(rows)

    def event(self, event: Event, placed: bool = False) -> None:
        """Logs an event.

        Args:
            placed: Whether to log it at its own frame and time; otherwise at those of the last frame.
        """
        if not placed:
            event = event.placed(*(self._last or (0, 0)))
        set_time(self._stream, event.frame, event.time_ns)
        # all events have all components, so that they share chunks
        values = own_values(crc32=event_checksum(event), topic=event.topic, phase=event.phase)
        self._stream.log(layout.EVENTS, rr.TextLog(event.text, level=event.level), values)

    def coach(self, page: CoachPage) -> None:
        """Logs the coach's page at the time of the last frame, or at the start."""
        set_time(self._stream, *((0, 0) if page.from_start or self._last is None else self._last))
        for entity, what in page.entities(card=self._shown):
            self._stream.log(entity, *what)

    def finish(self) -> None:
        """Marks the session as complete; a reader treats a session without this mark as cut off."""
        self.plot()
        self._stream.send_property("end", own_values(frames=self._next))

    def _begun_by(self, frame: SessionFrame) -> int:
        """The start time of the session; set by this frame if it is the first."""
        if self._start_ns is None:
            self._start_ns = frame.pair.time_ns
        return self._start_ns

    def _send(self, entities: Iterable[tuple[str, SessionArrays, list[Any]]]) -> None:
        timed: SessionArrays | None = None
        times: list[Times] = []
        for entity, rows, columns in entities:
            if rows is not timed:
                timed, times = rows, Times.of_frames(rows.frame, rows.time_ns)
            self._stream.send_columns(entity, times, columns)
            for (side, kind), chosen in self._of_images.items():
                if entity == layout.skeleton(side) and len(chosen):
                    # under a newer skeleton, an image that a slow machine left on the screen would tell a lie
                    of_image = Times.of_frames(rows.frame[chosen], rows.time_ns[chosen])
                    at_images = [column.at(chosen) for column in columns]
                    self._stream.send_columns(layout.image_skeleton(side, kind), of_image, at_images)
            self._pause()

    def _explain(self, rows: SessionArrays) -> None:
        """Logs what is not logged every frame."""
        self._quality.record(rows)
        self._states.record(rows)


def _constant(setup: FusionSetup, shown: bool) -> Iterator[tuple[str, Sequence[Any]]]:
    """What never changes: entities, and what is logged there once.

    Args:
        shown: Whether it is for a running viewer, which has raw images.
    """
    here, body = (0.0, 0.0, 0.0), setup.body
    yield layout.ROOT, [rr.ViewCoordinates.RDF, entity_styles.annotation_context(body)]
    for side, intrinsics in zip(layout.VIEWS, setup.intrinsics, strict=True):
        yield layout.skeleton(side), [entity_styles.joint_look(body, side)]
        for kind in layout.IMAGE_KINDS if shown else ():
            yield layout.image_skeleton(side, kind), [entity_styles.joint_look(body, side)]
        yield layout.depth(side), [entity_styles.camera(intrinsics, side), entity_styles.depth_look(shown)]
        yield layout.image_edge(side), [entity_styles.image_edge(intrinsics)]
        yield layout.others(side), [entity_styles.others_look()]
        yield layout.points(side), [entity_styles.cloud_look(side)]
        yield layout.sensor_label(side), entity_styles.sensor_label(side)
    yield layout.FUSED_SKELETON, [entity_styles.joint_look(body, "fused")]
    yield layout.TRUTH_SKELETON, [entity_styles.joint_look(body, "truth")]
    yield layout.kinect("a"), [rr.Transform3D.from_fields(translation=here)]
    yield layout.FLOOR, [entity_styles.floor_grid()]
    for name, entity in layout.FRAME_NAMES.items():
        same = rr.Transform3D.from_fields(translation=here, parent_frame=f"tf#{entity}", child_frame=name)
        yield layout.named_frame(name), [same]
    for entity in (layout.JITTER, layout.PLACEMENT):
        yield entity, [entity_styles.LINES[entity]]
