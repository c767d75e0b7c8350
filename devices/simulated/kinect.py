"""A simulated Kinect, a pair of simulated Kinects, and their ground truth."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from devices.depth.image_thinning import Depth
from devices.depth.witness import with_witness
from devices.sensor import DeviceError, Sensor, SensorFrame
from devices.simulated.imaging.body_surface import capsules, flesh_over, visibility
from devices.simulated.imaging.infrared import InfraredModel, clothed_capsules, infrared_image, materials
from devices.simulated.imaging.rendering import (
    DepthErrors,
    cast,
    depth_image,
    halved,
    read_out,
    share_seen,
    surface,
)
from devices.simulated.person import anatomy
from devices.simulated.person.movement import Beside as Beside
from devices.simulated.person.movement import Movement as Movement
from devices.simulated.person.movement import movement as movement
from devices.simulated.rig import Rig
from devices.simulated.streams import Streams
from devices.simulated.tracking.errors import Tracker, hold
from devices.simulated.tracking.person_ids import OTHER as OTHER
from devices.simulated.tracking.person_ids import PERSON as PERSON
from devices.simulated.tracking.person_ids import PersonIds
from devices.simulated.tracking.report import Tracked
from devices.simulated.tracking.scripted_faults import ScriptedFaults
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, Body
from fusion.compiling.kernels import compiles
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.rigid import RigidTransform
from fusion.support.types import Array

_LEAST_SEEN = 0.5  # of two people, one of whom less is visible is not reported: the other one hides them
_OTHER_HEIGHT = 0.94  # of the other person, as a share of the person's
_CHUNK = 32  # frames whose poses are computed together: one call costs little more than one pose


@dataclass(frozen=True)
class Scene:
    """One person who moves in front of the sensors, and perhaps another one."""

    motion: Movement
    body: Body = AZURE_KINECT  # the body that the sensors' trackers report
    height: float = anatomy.REFERENCE_HEIGHT  # the person's stature, metres
    seconds: float | None = None  # duration; None: endless
    seed: int = 0  # seed of all errors; the same seed gives the same frames
    other: Movement | None = None  # of a second person in view
    exchanged: float = 0.0  # how often a minute each tracker exchanges the ids of the two people

    def __post_init__(self) -> None:
        if not 0.5 <= self.height <= 2.5:
            raise DeviceError(f"A person's height is between 0.5 and 2.5 m; got {self.height}.")
        if self.seed < 0:
            raise DeviceError(f"A seed is 0 or more; got {self.seed}.")
        if self.seconds is not None and not 0.0 < self.seconds < float("inf"):
            raise DeviceError(f"A simulated scene lasts more than 0 s; got {self.seconds}.")


@dataclass(frozen=True)
class Truth:
    """The ground truth of a scene."""

    scene: Scene  # the person and the movement
    rig: Rig  # the placement of the sensors

    @property
    def a_from_b(self) -> RigidTransform:
        """Transform K_A ← K_B."""
        return self.rig.a_from_b

    def positions_at(self, time_ns: ArrayLike) -> NDArray[np.float64]:
        """(J, 3) the joints at a time of A's clock, in K_A's frame, metres; (T, J, 3) for (T,) times.

        Many times at once cost little more than one.
        """
        times = np.asarray(time_ns)
        marks = self.scene.motion.landmarks(np.atleast_1d(times) * 1e-9, self.scene.height)
        joints = marks[:, anatomy.landmarks_of(self.scene.body)]
        positions = self.rig.world_from_sensor(0).inverse().apply(joints)
        return positions if times.ndim else positions[0]


class TruthAhead:
    """The truth at the times of consecutive pairs, computed for a second of A's frames at once."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._known: dict[int, NDArray[np.float64]] = {}

    def __call__(self, time_ns: int) -> NDArray[np.float64]:
        """(J, 3) as :meth:`Truth.positions_at`."""
        if time_ns not in self._known:
            rig = self._truth.rig
            first = int(time_ns * 1e-9 / rig.frame_seconds + 1e-6)
            times = [time_ns, *(rig.stamp(0, first + k) for k in range(1, _CHUNK))]
            self._known = dict(zip(times, self._truth.positions_at(times), strict=True))
        return self._known[time_ns]


class SimulatedKinect(Sensor):
    """One of the two sensors of a rig. It generates frames as fast as they are requested.

    Args:
        which: 0 for sensor A, 1 for B.
        errors: Errors of its body tracker; None: the errors fitted for the body.
        infrared: Whether frames with a depth image have an infrared image, too. Both then show the person
            dressed; the simulated tracker's errors stay the same.
        script: Faults of its body tracker at given times, besides those by chance.

    Attributes:
        skips_depth: While True, frames have no depth image, which takes most of a frame's time.
        imaging: While False, no images are wanted.
        images_wanted: Number of depth images wanted since ``frames`` began.
        images_left_out: Number of those that were dropped.
    """

    simulated = True

    def __init__(
        self,
        scene: Scene,
        rig: Rig,
        which: int,
        *,
        errors: TrackerErrors | None = None,
        depth: Depth = "none",
        infrared: bool = False,
        script: ScriptedFaults | None = None,
    ) -> None:
        if infrared and depth == "none":
            raise DeviceError("Infrared images need depth='half' or 'full': both are of one size.")
        if depth not in ("none", "half", "full"):
            raise DeviceError(f"depth is 'none', 'half' or 'full'; got {depth!r}.")
        self.name = f"simulated {'ab'[which]}"
        self.body = scene.body
        full = NOMINAL_INTRINSICS[scene.body.name]
        self.intrinsics: Intrinsics | None = halved(full) if depth == "half" else full
        self._lens = self.intrinsics
        self._scene, self._rig, self._which = scene, rig, which
        self._streams = Streams(scene.seed, which)
        self._errors, self._script = TrackerErrors.of(scene.body) if errors is None else errors, script
        self._depth, self.depth_errors = depth, DepthErrors.of(scene.body)
        self._infrared: InfraredModel | None = None
        if infrared:
            self._infrared = InfraredModel().binned() if depth == "half" else InfraredModel()
        self._light = self._infrared.illumination(self._lens) if self._infrared else None
        self.skips_depth, self.imaging = False, True
        self.images_wanted = self.images_left_out = 0

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in capture order; each call starts again with the same frames."""
        scene, rig, which = self._scene, self._rig, self._which
        self.images_wanted = self.images_left_out = 0
        sensor_from_world = rig.world_from_sensor(which).inverse()
        heights = self._heights
        each_flesh = [flesh_over(self.body) * (height / anatomy.REFERENCE_HEIGHT) for height in heights]
        trackers = [
            Tracker(
                Tracked(
                    self.body, self._errors, self._lens, rig.frame_seconds,
                    replace(self._streams, person=person), None if person else self._script,
                    rig.rolled(which),
                )
            )
            for person in range(len(heights))
        ]  # fmt: skip
        ids = PersonIds(self._streams, scene.exchanged * rig.frame_seconds / 60.0)
        for frame, marks in self._poses():
            positions = sensor_from_world.apply(marks)
            shapes = np.concatenate([capsules(*of) for of in zip(positions, heights, strict=True)])
            time_ns = rig.stamp(which, frame)
            skeletons = []
            for tracker, flesh, at in zip(trackers, each_flesh, positions, strict=True):
                joints = at[anatomy.landmarks_of(self.body)]
                seen = visibility(joints, shapes, flesh, self._lens)
                skeleton = tracker.report(joints, seen, time_ns)
                hidden = len(positions) > 1 and seen.mean() < _LEAST_SEEN
                skeletons.append(None if hidden else skeleton)
            depth = ir = None
            if self._depth != "none" and self.imaging:
                self.images_wanted += 1
                if self.skips_depth:
                    self.images_left_out += 1
                else:
                    depth, ir = self._images(positions, shapes, frame)
            people = ids.of(skeletons)
            yield with_witness(SensorFrame(time_ns, people, depth, ir=ir), self._lens)

    def _images(
        self, landmarks: Array, shapes: Array, frame: int
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint16] | None]:
        """The depth and infrared image of a frame.

        Landmarks (P, N, 3) and capsules are in the sensor's frame.
        """
        sensor_from_world = self._rig.world_from_sensor(self._which).inverse()
        if self._infrared is not None:
            dressed = [clothed_capsules(*of) for of in zip(landmarks, self._heights, strict=True)]
            shapes = np.concatenate(dressed)
        z, label, cosine = surface(shapes, sensor_from_world, self._lens)
        errors = self.depth_errors.of_sensor(self._streams.named("depth camera"))
        depth = depth_image(z, cosine, errors, self._streams.named("depth", frame), self._lens.fx)
        if self._infrared is None or self._light is None:
            return depth, None
        noise = self._streams.named("infrared", frame)
        of = np.tile(materials(), len(landmarks))
        return depth, infrared_image(z, label, cosine, of, self._light, self._infrared, noise)

    @property
    def _heights(self) -> list[float]:
        height = self._scene.height
        return [height] if self._scene.other is None else [height, _OTHER_HEIGHT * height]

    def _poses(self) -> Iterator[tuple[int, Array]]:
        """Frame numbers and (P, N, 3) landmarks of each person in the world."""
        scene, rig = self._scene, self._rig
        count = None if scene.seconds is None else max(0, round(scene.seconds / rig.frame_seconds))
        first = 0
        while count is None or first < count:
            numbers = range(first, first + _CHUNK if count is None else min(first + _CHUNK, count))
            times = [rig.captured_at(self._which, k) for k in numbers]
            motions = (scene.motion,) if scene.other is None else (scene.motion, scene.other)
            each = [of.landmarks(times, height) for of, height in zip(motions, self._heights, strict=True)]
            yield from zip(numbers, np.stack(each, axis=1), strict=True)
            first += _CHUNK


def simulated_pair(
    *,
    motion: str | Path | Movement = "walk",
    seed: int = 0,
    body: Body = AZURE_KINECT,
    angle_deg: float = 90.0,
    seconds: float | None = None,
    height: float = anatomy.REFERENCE_HEIGHT,
    depth: Depth = "none",
    errors: TrackerErrors | None = None,
    depth_errors: DepthErrors | None = None,
    rig: Rig | None = None,
    infrared: bool = False,
    other: Movement | None = None,
    exchanged: float = 0.0,
) -> tuple[SimulatedKinect, SimulatedKinect, Truth]:
    """Two sensors that watch one person, and the truth.

    Args:
        motion: A movement by name, a .bvh file, or a movement.
        angle_deg: Between the sensors; ignored if a rig is given.
        depth: Whether frames carry a depth image: ``none``, ``half`` or ``full``.
        errors: Of the body trackers; the real ones of the body if None.
        depth_errors: Of the depth images; those of the body's sensor if None.
        other: The movement of a second person; the two hide each other.
        exchanged: How often per minute each tracker exchanges the ids of the two.
    """
    moving = movement(motion) if isinstance(motion, str | Path) else motion
    scene = Scene(moving, body, height, seconds, seed, other, exchanged)
    rig = rig or Rig(angle_deg=angle_deg)
    a, b = (
        SimulatedKinect(scene, rig, which, errors=errors, depth=depth, infrared=infrared) for which in (0, 1)
    )
    a.depth_errors = b.depth_errors = depth_errors or DepthErrors.of(body)
    return a, b, Truth(scene, rig)


@compiles(share_seen, hold)
def compile_tracking() -> None:
    """Compiles what a simulated body tracker calls."""
    _take_a_frame("none")


@compiles(cast, read_out)
def compile_images() -> None:
    """Compiles what a simulated depth camera calls."""
    _take_a_frame("half")


def _take_a_frame(depth: Depth) -> None:
    next(simulated_pair(motion="still", depth=depth)[0].frames())
