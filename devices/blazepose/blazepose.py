"""The program's own body tracker: BlazePose on the infrared or colour image, lifted with depth."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.joints import joints_of
from devices.blazepose.landmark_kinds import TRUNK
from devices.blazepose.lifting import BodyLandmarks, lift
from devices.blazepose.limbs import LimbLengths, with_lengths
from devices.blazepose.networks.files import LANDMARK_NETWORKS, cache_folder, checked_content, files_of
from devices.blazepose.networks.inference import (
    CENTRE,
    DETECTOR_SIZE,
    LANDMARK_COUNT,
    LANDMARK_SIZE,
    RIM,
    Detector,
    LandmarkNetwork,
)
from devices.blazepose.regions import Region, transformed, whole_image
from devices.blazepose.settings import BlazePoseSettings, NetworkName
from devices.depth.camera import project
from devices.depth.grey_image import compressed, evened
from devices.sensor import DeviceError
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton
from fusion.support.types import Array

_LEAST_SCORE = 0.5  # of the landmark network, below which the crop holds no person; MediaPipe's
_CANDIDATES = 3  # detections that are tried in one image
_CLOSER = 0.62  # of the image's side: people far away are too small in the detector's 224 pixels
_REMEMBERED_NS = 1_000_000_000  # a person who is lost for longer may be another one afterwards
_STEP, _SPEED = (
    0.3,
    2.0,
)  # metres, metres per second: who is farther from the expected place is another person
_FASTEST, _STEADY_S = (
    2.0,
    0.2,
)  # metres per second, of a velocity that is trusted; seconds that it is averaged over
_BEFORE = 0.35  # metres: who is so much nearer than expected is another person, unless the place is empty
_HIPS = 0.02  # half width of a place that is certain to be the person's, of the region's side


class _Sighting(NamedTuple):
    """Where the person was seen last."""

    region: Region
    middle: Array
    """(3,) middle of the trunk, metres."""
    velocity: Array
    """(3,) of the middle, metres per second."""
    time_ns: int

    def expected(self, time_ns: int) -> Array:
        """(3,) where the middle is expected at another time."""
        return self.middle + self.velocity * abs(time_ns - self.time_ns) * 1e-9

    def next(self, region: Region, middle: Array, time_ns: int) -> _Sighting:
        """The sighting after this one."""
        seconds = abs(time_ns - self.time_ns) * 1e-9
        if seconds == 0.0:
            return _Sighting(region, middle, self.velocity, time_ns)
        newest = (middle - self.middle) / seconds
        velocity = self.velocity + min(1.0, seconds / _STEADY_S) * (newest - self.velocity)
        velocity = velocity * min(1.0, _FASTEST / max(float(np.linalg.norm(velocity)), 1e-9))
        return _Sighting(region, middle, velocity, time_ns)

    def may_be(self, middle: Array, time_ns: int, depth: NDArray[np.uint16], camera: Intrinsics) -> bool:
        """Whether a person at a place is the one who was seen, not one who stands before them."""
        expected = self.expected(time_ns)
        reach = _STEP + _SPEED * abs(time_ns - self.time_ns) * 1e-9
        if float(np.linalg.norm(middle - expected)) > reach:
            return False
        if middle[2] > expected[2] - _BEFORE or expected[2] <= 0.1:
            return True
        u, v = project(camera, expected)
        return _distance(u, v, _HIPS * self.region.side, depth) > float(expected[2]) + _BEFORE


def _distance(u: float, v: float, reach: float, depth: NDArray[np.uint16]) -> float:
    """Median depth around a place of the image, metres; infinite where there is no reading."""
    a, b, r = round(u), round(v), max(1, round(reach))
    window = depth[max(0, b - r) : max(0, b + r + 1), max(0, a - r) : max(0, a + r + 1)]
    readings = window[window > 0]
    return 0.001 * float(np.median(readings)) if readings.size else math.inf


class BlazePose:
    """Follows one person through the images of one sensor.

    The person is the one that the settings name at first, and then the same one. The detector runs only while
    no person is followed.
    """

    def __init__(self, settings: BlazePoseSettings | None = None) -> None:
        self.settings = settings or BlazePoseSettings()
        self.region: Region | None = None
        self._networks: tuple[Detector, LandmarkNetwork] | None = None
        self._last: _Sighting | None = None
        self._person = 0
        self._limbs = LimbLengths()  # of the person
        self._searched = 0  # images without the person in a row: every other one is searched closer

    def __enter__(self) -> BlazePose:
        folder = self.settings.models or cache_folder()
        detector, landmarks = (checked_content(file, folder) for file in files_of(self.settings.network))
        threads = self.settings.threads
        self._networks = Detector(detector, threads), LandmarkNetwork(landmarks, threads)
        self.forget()
        return self

    def use(self, network: NetworkName) -> None:
        """Changes the landmark network of an open tracker; the person is kept.

        Raises:
            DeviceError: The network's file is missing or damaged. The tracker goes on with the one it has.
        """
        if self._networks is None:
            raise DeviceError("The body tracker is not open: use it in a with statement.")
        content = checked_content(LANDMARK_NETWORKS[network], self.settings.models or cache_folder())
        self._networks = self._networks[0], LandmarkNetwork(content, self.settings.threads)
        self.settings = replace(self.settings, network=network)

    def __exit__(self, *exc_info: object) -> None:
        self._networks = None

    def forget(self) -> None:
        """Forgets the person, for images that do not continue the ones before."""
        self.region = self._last = None
        self._searched = 0

    def track(
        self, image: NDArray[np.generic], depth: NDArray[np.uint16], intrinsics: Intrinsics, time_ns: int
    ) -> dict[str, Skeleton]:
        """Finds the person in an image.

        Args:
            image: (h, w) infrared of any range, or (h, w, 3) uint8 RGB, on the pixels of the depth image.
            depth: (h, w) uint16 millimetres along z, 0 where there is no reading.

        Returns:
            The skeleton of the person by an id that changes with the person; empty without a person.

        Raises:
            DeviceError: The tracker is not open, or images and intrinsics have different sizes.
        """
        if self._networks is None:
            raise DeviceError("The body tracker is not open: use it in a with statement.")
        if image.shape[:2] != depth.shape:
            raise DeviceError(
                f"The image has {image.shape[1]} × {image.shape[0]} pixels, the depth image "
                f"{depth.shape[1]} × {depth.shape[0]}: register the image to the depth camera first."
            )
        if depth.shape != (intrinsics.height, intrinsics.width):
            raise DeviceError(
                f"The depth image has {depth.shape[1]} × {depth.shape[0]} pixels, its intrinsics are of "
                f"{intrinsics.width} × {intrinsics.height}."
            )
        if self.region is not None:
            skeleton = self._follow(self.region, image, depth, intrinsics, time_ns)
            if skeleton is not None:
                return {str(self._person): skeleton}
        if self._last is not None and abs(time_ns - self._last.time_ns) > _REMEMBERED_NS:
            self._last = None
        for region in self._candidates(image, depth, intrinsics, time_ns):
            skeleton = self._follow(region, image, depth, intrinsics, time_ns)
            if skeleton is not None:
                return {str(self._person): skeleton}
        self.region = None
        return {}

    def _candidates(
        self, image: NDArray[np.generic], depth: NDArray[np.uint16], camera: Intrinsics, time_ns: int
    ) -> list[Region]:
        """Regions of the detected people, the one to follow first."""
        assert self._networks is not None
        whole = whole_image(*image.shape[:2])
        searched = whole
        if self._searched % 2:
            searched = Region(whole.u, whole.v, _CLOSER * whole.side)
            if self._last is not None:
                searched = replace(searched, u=self._last.region.u, v=self._last.region.v)
        crop = compressed(searched.crop(image, DETECTOR_SIZE))
        if searched is whole:
            crop = evened(crop)
        self._searched += 1
        found = self._networks[0].detect(crop)
        to_image = searched.image_from_crop(DETECTOR_SIZE)
        regions = [
            Region.around(*transformed(to_image, np.array((person.centre, person.rim)))) for person in found
        ]
        middle = np.array((whole.u, whole.v))
        wanted = self.settings.person
        if self._last is not None:
            expected, wanted = self._last.expected(time_ns), "middle"
            middle = project(camera, expected) if expected[2] > 0.1 else middle

        def rank(region: Region) -> float:
            if wanted == "nearest":
                return _distance(region.u, region.v, _HIPS * region.side, depth)
            if wanted == "middle":
                return math.hypot(region.u - middle[0], region.v - middle[1])
            return region.u if wanted == "left" else -region.u

        return sorted(regions, key=rank)[:_CANDIDATES]

    def _follow(
        self,
        region: Region,
        image: NDArray[np.generic],
        depth: NDArray[np.uint16],
        intrinsics: Intrinsics,
        time_ns: int,
    ) -> Skeleton | None:
        """The person in a region; the next region follows from the person."""
        assert self._networks is not None
        found = self._networks[1].place(compressed(region.crop(image, LANDMARK_SIZE)))
        if not found.score >= _LEAST_SCORE:
            return None
        to_image = region.image_from_crop(LANDMARK_SIZE)
        pixels = transformed(to_image, found.pixels)
        c, s = math.cos(region.angle), math.sin(region.angle)
        world = found.world @ np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
        known = found.visibility[:LANDMARK_COUNT], found.presence[:LANDMARK_COUNT]
        lifted = lift(BodyLandmarks(pixels[:LANDMARK_COUNT], *known, world), depth, intrinsics)
        if lifted is None:
            return None
        middle = lifted.positions[TRUNK].mean(axis=0)
        if self._last is None:
            self._person += 1
            self._limbs = LimbLengths()
        elif not self._last.may_be(middle, time_ns, depth, intrinsics):
            return None
        self._searched = 0
        self.region = Region.around(pixels[CENTRE], pixels[RIM])
        still = _Sighting(self.region, middle, np.zeros(3), time_ns)
        self._last = still if self._last is None else self._last.next(self.region, middle, time_ns)
        pixels = pixels[:LANDMARK_COUNT]
        self._limbs.observe(lifted.positions, lifted.seen)
        at = lifted.positions[:, :2] / lifted.positions[:, 2:]
        moved, seen = with_lengths(lifted.positions, lifted.seen, at, self._limbs.lengths())
        lifted = replace(lifted, positions=moved, seen=seen)
        return Skeleton.of(BLAZEPOSE, *joints_of(lifted, pixels, depth), time_ns)
