"""Fuses running sensors: follows one person, calibrates while pairs arrive, and fuses each pair.

:func:`fuse_live` is the loop for other programs; that of ``duplex live`` is ``viewer_app.running.loop``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from devices.capture.clock.capture_time import CaptureTime
from devices.capture.sensor_pair import TwoSensors
from devices.depth import rvl
from devices.depth import witness as depth_witness
from devices.depth.image_thinning import Depth, pair_without_images, with_depth
from devices.events import Event
from devices.frame_pairs import FramePair
from devices.people import tracks as people_tracks
from devices.people.following import PersonOfPair
from devices.people.recorded_people import Follow
from devices.sensor import FrameError, Sensor
from fusion.body import Body
from fusion.calibration.calibration import nominal_calibration
from fusion.calibration.calibrator import Calibrator
from fusion.calibration.online import CalibrationLearner, LearnerSettings
from fusion.compiling.first_run import FirstRun
from fusion.compiling.kernels import WarmUp
from fusion.facing.model import WHOLE
from fusion.fuser import Fuser
from fusion.movement import angles
from fusion.registration.refinement import RefinementSettings
from fusion.setup import FusionSetup, Method
from recordings.appearance.floor import FloorFinder
from recordings.data.session_arrays import SessionFrame
from recordings.errors import RecordingError
from recordings.fusing.pairs import fuse_one
from recordings.fusing.view_events import ViewEvents
from recordings.session import Session

if TYPE_CHECKING:
    from recordings.fusing.live_surface import LiveSurface


def live_warm_ups(method: Method, *others: WarmUp) -> tuple[list[WarmUp], list[WarmUp]]:
    """What two processes compile on a first run for running sensors and their recording, and others."""
    first, second = Fuser.warm_ups(method)
    live = people_tracks.warm_up, depth_witness.warm_up, rvl.warm_up, angles.warm_up
    return first, [*second, *live, *others]


class LiveFusion:
    """Fuses one pair after another to S*.

    Args:
        calibrated: Whether to keep its calibration, except the bones of people of another size. Otherwise
            one is found while pairs arrive, and refined.
        refine: Whether to refine a calibration that is kept.
        follow: Whom of several people; see :class:`devices.people.following.PersonOfPair`.
    """

    def __init__(
        self, setup: FusionSetup, calibrated: bool = False, refine: bool = False, follow: Follow = "middle"
    ) -> None:
        self.setup = setup
        """The setup with which the last pair was fused."""
        kept = setup.calibration if calibrated or refine else None
        self.calibrator = Calibrator(setup.body, kept, frontal=setup.settings.method == "duplex")
        self._fuser = Fuser(setup)
        learns = refine or not calibrated
        duplex = setup.settings.method == "duplex"
        self._people = PersonOfPair(setup.body, follow, follow_moves=learns or not duplex)
        settings = LearnerSettings(refinement=RefinementSettings(in_steps=True)).if_learned(learns)
        self._learner = CalibrationLearner(setup.body, setup.calibration, settings) if duplex else None
        self._learns = learns
        self._surface: LiveSurface | None = None
        self._whole: FramePair | None = None
        self._views = ViewEvents(setup.body)
        self._floor = FloorFinder(setup.body)

    def frames(
        self, sensors: TwoSensors, depth: Depth = "full", clock: Callable[[], int] = time.perf_counter_ns
    ) -> Iterator[SessionFrame]:
        """Fuses the pairs of two open sensors as they arrive, until both sensors end.

        Call :meth:`learn` with each frame before the next one.

        Args:
            clock: Nanoseconds, of the frames' ``host_ns``.
        """
        capture = CaptureTime()
        self._surface = self._surface_of(sensors)
        for pair in sensors.pairs(every_frame=self.setup.settings.method == "duplex"):
            self._whole = self.chosen(pair)
            frame, now_ns = self.fuse(with_depth(self._whole, depth)), clock()
            latency_ns = _latency_ns(pair, now_ns)
            unix_ns = capture.unix_ns(pair.time_ns, now_ns - (latency_ns or 0))
            yield replace(frame, streams=sensors.figures, latency_ns=latency_ns, unix_ns=unix_ns)

    def chosen(self, pair: FramePair) -> FramePair:
        """Returns the pair with the followed person chosen."""
        final = self.calibrator.final
        return self._people.chosen(pair, self.setup.calibration.a_from_b if final else None)

    def fuse(self, pair: FramePair) -> SessionFrame:
        """Fuses a pair whose person is chosen, with the newest calibration; see :attr:`setup`."""
        self._recalibrate(pair)
        lengths, floor = self.setup.calibration.bone_lengths, self._floor.a_from_floor
        return replace(fuse_one(self._fuser, pair), bone_lengths=lengths, floor=floor)

    def learn(self, frame: SessionFrame) -> list[Event]:
        """Learns from the frame that was fused last, and returns its events.

        Call it when the frame is handed over: a refinement of the calibration, which applies to the next
        pairs, takes longer than S*.
        """
        fused, pair = frame.fused, frame.pair
        self._floor.add(fused.positions[None])
        events = [*self._people.learn(), *self._views.observe(pair.skeletons, fused)]
        if self._learner is not None and self.calibrator.final:
            codes = fused.exchanged_a & WHOLE, fused.exchanged_b & WHOLE
            stale = fused.stale_a, fused.stale_b
            changes = self._learner.observe(pair.skeletons, codes, stale)
            if self._surface is not None and self._whole is not None:
                if any(change.kind == "knocked" for change in changes):
                    self._surface.forget()
                changes += self._surface.observe(self._whole, self._learner)
            for change in changes:
                knocked = change.kind == "knocked"
                events.append(Event(change.event, "WARN" if knocked else "INFO"))
        return events

    def _surface_of(self, sensors: TwoSensors) -> LiveSurface | None:
        """What fits the surface in depth images, if there are any and the registration is learned."""
        a, b = sensors.a.sensor, sensors.b.sensor
        if self._learner is None or not self._learns or a.intrinsics is None or b.intrinsics is None:
            return None
        from recordings.fusing.live_surface import LiveSurface  # where there are images

        cameras, offsets = (a.intrinsics, b.intrinsics), (a.depth_offset, b.depth_offset)
        return LiveSurface(self.setup.body, cameras, offsets)

    def _recalibrate(self, pair: FramePair) -> None:
        """Takes a new calibration, from the start-up pose or from the learner, if there is one."""
        found = self.calibrator.watch(pair.skeletons)
        if found is not None:
            if self._learner is not None:  # it has learned nothing so far: it waits for a final calibration
                self._learner.adopt(found)
        elif self._learner is not None:
            found = self._learner.calibration
        if found is None or found is self.setup.calibration:
            return
        self.setup = FusionSetup(found, self.setup.settings, *self.setup.intrinsics)
        if self.setup.settings.method == "duplex":
            self._fuser.recalibrate(self.setup)
        else:
            self._fuser = Fuser(self.setup)


class LiveFrames(Iterator[SessionFrame]):
    """The fused frames of two running sensors, one after another.

    Args:
        setup: A setup whose calibration is kept, except the bones of people of another size. None: calibrate
            while frames arrive.
    """

    def __init__(self, sensors: TwoSensors, setup: FusionSetup | None, keep: bool) -> None:
        self._sensors, self._given, self._keep = sensors, setup, keep
        self._setup: FusionSetup | None = None
        self._kept: list[tuple[FusionSetup, list[SessionFrame]]] = []
        self._events: list[Event] = []
        self._count, self._start_ns = 0, 0
        self._frames = self._fuse()

    def __next__(self) -> SessionFrame:
        """Waits for the next pair and fuses it.

        Raises:
            DeviceError: A sensor cannot be opened.
            FrameError: What a sensor gives is of another kind, shape or unit.
        """
        return next(self._frames)

    def close(self) -> None:
        """Closes the sensors."""
        self._frames.close()

    @property
    def setup(self) -> FusionSetup:
        """The setup of the last frame: calibration, settings, intrinsics.

        Raises:
            RecordingError: There is no frame yet.
        """
        if self._setup is None:
            raise RecordingError("There is no frame yet, so nothing has been calibrated.")
        return self._setup

    @property
    def session(self) -> Session:
        """All frames so far, without images; ``session.save(path)`` writes them.

        Raises:
            RecordingError: There is no frame, or ``fuse_live`` was called without ``keep``.
        """
        if not self._keep:
            raise RecordingError("The frames were not kept: use fuse_live(a, b, keep=True).")
        names = self._sensors.a.sensor.name, self._sensors.b.sensor.name
        return Session.of(self._kept, names, events=self._events)

    def _fuse(self) -> Generator[SessionFrame]:
        a, b = self._sensors.a.sensor, self._sensors.b.sensor
        # The first call of a kernel may compile it, which must not happen while frames arrive. Kernels are
        # the same for all bodies; a sensor may know its body only once it is open.
        method = "duplex" if self._given is None else self._given.settings.method
        with FirstRun(*live_warm_ups(method)) as first_run:
            first_run.finish()
        with self._sensors as sensors:
            for own in (a, b):
                if not isinstance(getattr(own, "body", None), Body):
                    raise FrameError(f"{own.name} has no body, which is one such as fusion.KINECT_V2.")
            setup = self._given or FusionSetup(nominal_calibration(a.body), None, a.intrinsics, b.intrinsics)
            fusion = LiveFusion(setup, self._given is not None)
            for frame in fusion.frames(sensors):
                self._keep_frame(fusion.setup, frame, [*sensors.events(), *fusion.learn(frame)])
                yield frame

    def _keep_frame(self, setup: FusionSetup, frame: SessionFrame, events: list[Event]) -> None:
        if self._setup is not setup:
            if self._setup is not None:
                events = [Event(f"calibrated: {setup.calibration.how}"), *events]
            self._setup = setup
            self._kept = [*self._kept, (setup, [])] if self._keep else []
        if not self._keep:
            return
        self._start_ns = frame.pair.time_ns if self._count == 0 else self._start_ns
        since_ns = frame.pair.time_ns - self._start_ns
        self._events += [event.placed(self._count, since_ns) for event in events]
        self._kept[-1][1].append(replace(frame, pair=pair_without_images(frame.pair)))
        self._count += 1


def fuse_live(a: Sensor, b: Sensor, setup: FusionSetup | None = None, *, keep: bool = False) -> LiveFrames:
    """Fuses the frames of two sensors as they arrive, until both sensors end.

    Each sensor runs on its own thread. A sensor that fails is reopened until it works again. All kernels are
    compiled before the sensors are opened, which takes minutes on the first run.

    Args:
        a, b: The principal sensor K_A and the secondary sensor K_B, both not yet open. S* is in K_A's frame.
        setup: A setup whose calibration is kept, except the bones of people of another size. None: calibrate
            while frames arrive.
        keep: Whether to keep the frames, without images, so that :attr:`LiveFrames.session` has them all.

    Returns:
        An iterator over the frames; sensors are opened at the first.
    """
    return LiveFrames(TwoSensors(a, b), setup, keep)


def _latency_ns(pair: FramePair, now_ns: int) -> int | None:
    """Time since the first images of a pair arrived; None if no sensor tells their arrival."""
    arrivals = [seen.host_ns for seen in (pair.a, pair.b) if seen is not None and seen.host_ns is not None]
    return now_ns - min(arrivals) if arrivals else None
