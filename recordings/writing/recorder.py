"""Logs a session to a stream: constant data once, frames by columns, everything else when it changes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.depth.rvl import MEDIA_TYPE, encode_depth
from devices.events import Event
from devices.sensor import ColorImage
from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance import entity_styles
from recordings.appearance.coach_page import CoachPage
from recordings.appearance.joint_trust import LIMBS, SOURCES, LimbSources, TrustColors
from recordings.session_arrays import SessionArrays, SessionFrame
from recordings.writing.arrow_columns import Times, depth_image, own_values, points, state_changes
from recordings.writing.changes import Lanes, PlacementLog, QualityLog, StreamFiguresLog, set_time
from recordings.writing.checksums import FusedChecks, event_checksum, image_checksum, properties_checksum
from recordings.writing.frame_columns import frame_columns
from recordings.writing.properties import session_properties
from recordings.writing.shown_images import ColorLog, prepare_points, show_infrared, thin_points

_RESIDUALS = ("residual_median", "residual_rms", "rotation_sd", "translation_sd")


class Recorder:
    """Writes one session to a Rerun recording stream, which the caller owns and closes.

    Args:
        stream: The stream; its sinks are a viewer, a file or both.
        setup: Settings, calibration and cameras, stored with the session.
        sources: Names of the sensors, K_A first.
        depth_every: Keep the depth images of every n-th pair; 0 for none.
        start_ns: Start time of the session; None: the time of the first recorded frame.
        points: Whether to log depth images as point clouds too.
        plots_later: Whether :meth:`plot` logs what is plotted, for many frames together: each message costs
            as much as many numbers. What is drawn into the scene is logged with each frame.
        pause: Called between two messages of a block of frames, so that threads in a hurry go first.
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
        self._frames, self._start_ns = 0, start_ns
        self._pause = pause or (lambda: None)
        self._plots_later, self._unplotted = plots_later, list[tuple[SessionFrame, int]]()
        self._like: SessionArrays | None = None
        self._last: tuple[int, int] | None = None
        self._depth_every, self._points = depth_every, points
        self._cameras = {"a": setup.intrinsics_a, "b": setup.intrinsics_b}
        if points:
            prepare_points(*self._cameras.values())
        self._color, self._figures = ColorLog(stream), StreamFiguresLog(stream)
        self._limb_sources, self._trust = LimbSources(setup.body), Lanes(steady=True)
        self._trust_colors = TrustColors()
        self._states = {side: Lanes() for side in layout.SIDES}
        self._placement, self._quality = PlacementLog(stream, setup, points), QualityLog(stream)
        self._log_static(setup)
        properties = session_properties(setup, sources, about or {})
        for name, values in properties.items():
            stream.send_property(name, own_values(**values))
        stream.send_property("check", own_values(crc32=properties_checksum(properties)))
        self.recalibrated(setup)
        # data that a reader needs first must come first in the file; columns would overtake it
        stream.flush(timeout_sec=0.0)

    def recalibrated(self, setup: FusionSetup) -> None:
        """Logs the calibration of a new setup, which applies to the following frames."""
        self.plot()
        calibration = self._calibration = setup.calibration
        registration = calibration.registration
        values: dict[str, Any] = {
            "how": calibration.how,
            "provisional": calibration.provisional,
            "rotation": calibration.a_from_b.rotation.ravel(),
            "translation": calibration.a_from_b.translation,
            "bone_lengths": calibration.bone_lengths,
            "pairs": 0 if registration is None else registration.frames,
            **{name: getattr(registration, name, np.nan) for name in _RESIDUALS},
            "joint_residuals": getattr(registration, "joint_residuals", np.full(len(setup.body), np.nan)),
        }
        set_time(self._stream, self._frames, self._last[1] if self._last else 0)
        check = properties_checksum({"calibration": {"frame": self._frames, **values}})
        self._stream.log(layout.CALIBRATION, own_values(**values, calibration_crc32=check))

    def record_all(
        self, frames: Sequence[SessionFrame], numbers: Sequence[int] | None = None
    ) -> SessionArrays:
        """Logs many frames by columns and returns the arrays; may be called again for the following frames.

        Args:
            numbers: Frame numbers, if frames were left out. None: consecutive numbers.
        """
        rows = self._stack(frames, numbers)
        if self._plots_later:
            self._draw(rows)
            self._unplotted += zip(frames, rows.frame.tolist(), strict=True)
        else:
            self.record_rows(rows)
        for frame, number, time_ns in zip(frames, rows.frame.tolist(), rows.time_ns.tolist(), strict=True):
            if frame.streams is not None:
                self._figures.record(number, time_ns, frame.streams)
            self.record_images(number, frame)
        return rows

    def record_rows(self, rows: SessionArrays, checks: FusedChecks | None = None) -> None:
        """Logs frames given as arrays, with their own numbers and times.

        Args:
            checks: Checks of S* in float64, if `rows` come from a file in float32.
        """
        self._placement.record(rows)
        self._send(frame_columns(rows, checks, colors=self._trust_colors.add(rows), up=self._placement.up))
        self._explain(rows)
        self._frames = max(self._frames, int(rows.frame[-1]) + 1)
        self._last = (int(rows.frame[-1]), int(rows.time_ns[-1]))

    @property
    def unplotted(self) -> int:
        """How many frames are drawn and not yet plotted."""
        return len(self._unplotted)

    def plot(self) -> None:
        """Logs the figures of frames that are drawn and not yet plotted, if there are any."""
        if self._unplotted:
            frames, numbers = zip(*self._unplotted, strict=True)
            self._unplotted.clear()
            rows = self._stack(frames, numbers)
            self._send(frame_columns(rows, up=self._placement.up))
            self._explain(rows)

    def _draw(self, rows: SessionArrays) -> None:
        """Logs what is drawn into the scene, and leaves the rest to :meth:`plot`."""
        self._placement.record(rows)
        self._send(frame_columns(rows, colors=self._trust_colors.add(rows), plotted=False))
        self._last = (int(rows.frame[-1]), int(rows.time_ns[-1]))

    def _send(self, entities: Iterable[tuple[str, SessionArrays, list[Any]]]) -> None:
        timed: SessionArrays | None = None
        times: list[Times] = []
        for entity, rows, columns in entities:
            if rows is not timed:
                timed, times = rows, Times.of_frames(rows.frame, rows.time_ns)
            self._stream.send_columns(entity, times, columns)
            self._pause()

    def record_images(self, number: int, frame: SessionFrame) -> None:
        """Logs the images of a frame, in time order. The frame must be recorded later without images."""
        time_ns = frame.pair.time_ns - self._begun_by(frame)
        if self._depth_every == 0 or number % self._depth_every:
            return
        for side, seen in (("a", frame.pair.a), ("b", frame.pair.b)):
            if seen is not None and seen.depth is not None:
                self.record_depth(side, number, time_ns, seen.depth)
                if self._points and seen.ir is not None:
                    show_infrared(self._stream, side, seen.ir)
            if seen is not None and seen.color is not None:
                self.record_color(side, number, time_ns, seen.color)

    def record_depth(self, side: str, frame: int, time_ns: int, depth: NDArray[np.uint16]) -> None:
        """Logs a depth image losslessly: (height, width) millimetres."""
        blob = encode_depth(depth)
        set_time(self._stream, frame, time_ns)
        self._stream.log(
            layout.depth(side),
            depth_image(blob, MEDIA_TYPE, meter=1000.0),
            own_values(crc32=image_checksum(frame, blob)),
        )
        if self._points:
            cloud = thin_points(depth, self._cameras[side])
            self._stream.log(layout.points(side), points(cloud))

    def record_color(self, side: str, frame: int, time_ns: int, color: ColorImage) -> None:
        """Logs a colour image."""
        set_time(self._stream, frame, time_ns)
        self._color.record(side, frame, color)

    def event(self, event: Event, placed: bool = False) -> None:
        """Logs an event.

        Args:
            placed: Whether to log it at its own frame and time; otherwise at those of the last frame.
        """
        if not placed:
            event = event.placed(*(self._last or (self._frames, 0)))
        set_time(self._stream, event.frame, event.time_ns)
        # all events have all components, so that they share chunks
        values = own_values(crc32=event_checksum(event), topic=event.topic, phase=event.phase)
        self._stream.log(layout.EVENTS, rr.TextLog(event.text, level=event.level), values)

    def coach(self, page: CoachPage) -> None:
        """Logs the coach's page at the time of the last frame, or at the start."""
        set_time(self._stream, *((0, 0) if page.from_start or self._last is None else self._last))
        for entity, what in page.entities():
            self._stream.log(entity, what)

    def finish(self) -> None:
        """Marks the session as complete; a reader treats a session without this mark as cut off."""
        self.plot()
        self._stream.send_property("end", own_values(frames=self._frames))

    def _stack(self, frames: Sequence[SessionFrame], numbers: Sequence[int] | None) -> SessionArrays:
        if numbers is None:
            numbers = range(self._frames, self._frames + len(frames))
        calibration = self._calibration
        begun_ns = self._begun_by(frames[0])
        rows = SessionArrays.stack(
            calibration.body, calibration.bone_lengths, frames, numbers, begun_ns, like=self._like
        )
        self._like = self._like or rows[:1]
        self._frames = numbers[-1] + 1
        return rows

    def _begun_by(self, frame: SessionFrame) -> int:
        """The start time of the session; set by this frame if it is the first."""
        if self._start_ns is None:
            self._start_ns = frame.pair.time_ns
        return self._start_ns

    def _explain(self, rows: SessionArrays) -> None:
        """Logs data that is not logged every frame: quality, and changes of sources and tracking states."""
        self._quality.record(rows)
        for limb, changes in self._trust.add(self._limb_sources.add(rows)):
            lane = layout.trust_lane(LIMBS[limb])
            self._log_changes(rows, lane, SOURCES, changes, entity_styles.TRUST_LANES)
        for side, states in (("a", rows.states_a), ("b", rows.states_b)):
            for joint, changes in self._states[side].add(states):
                lane = layout.state_lane(side, rows.body.joints[joint])
                self._log_changes(rows, lane, layout.STATE_NAMES, changes, entity_styles.STATE_LANES)

    def _log_changes(
        self,
        rows: SessionArrays,
        lane: str,
        names: Sequence[str],
        changes: list[tuple[int | None, int]],
        look: rr.StateConfiguration,
    ) -> None:
        self._pause()
        places = [(0, 0) if t is None else (int(rows.frame[t]), int(rows.time_ns[t])) for t, _ in changes]
        frames, times = np.array(places).T
        states = state_changes([names[state] for _, state in changes])
        self._stream.send_columns(lane, Times.of_frames(frames, times), states)
        if changes[0][0] is None:
            self._stream.log(lane, look, static=True)

    def _log_static(self, setup: FusionSetup) -> None:
        body = self._calibration.body
        once = partial(self._stream.log, static=True)
        once(layout.ROOT, rr.ViewCoordinates.RDF, entity_styles.annotation_context(body))
        for side, intrinsics in (("a", setup.intrinsics_a), ("b", setup.intrinsics_b)):
            once(layout.skeleton(side), entity_styles.joint_look(body, side))
            once(layout.depth(side), entity_styles.camera(intrinsics, side), entity_styles.DEPTH)
            once(layout.image_edge(side), entity_styles.image_edge(intrinsics))
            once(layout.points(side), entity_styles.cloud_look(side))
        once(layout.FUSED_SKELETON, entity_styles.joint_look(body, "fused"))
        once(layout.TRUTH_SKELETON, entity_styles.joint_look(body, "truth"))
