"""A sensor's streams (depth, infrared of the same pixels, colour) and the lenses of their cameras."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from devices.capture.settings import CaptureSettings
from devices.orbbec.sdk_access import faults_of
from devices.sensor import ColorCamera, DeviceError
from fusion.errors import FusionError
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

DEPTH_SIZES = {"NFOV_UNBINNED": (640, 576), "WFOV_2X2BINNED": (512, 512)}
COLOR_SIZES = {"720P": (1280, 720), "1080P": (1920, 1080), "1440P": (2560, 1440), "2160P": (3840, 2160)}
_USUAL_WIDTH = 640
_INFRARED_FORMATS = ("Y16", "Y8")
_BROWN_CONRADY = ("BROWN_CONRADY", "BROWN_CONRADY_K6")
"""The models that are OpenCV's: its coefficients, from the ideal to the distorted image."""


@dataclass(frozen=True, eq=False)
class Streams:
    """The ``VideoStreamProfile`` of each image."""

    depth: Any  # depth, Y16
    infrared: Any  # infrared of the depth camera's pixels, Y16 or Y8
    color: Any = None  # colour, MJPG; None for none

    def configuration(self, sdk: Any) -> Any:
        """Returns the ``Config`` that starts the streams; frame sync must be off.

        With colour, each frame comes at once, in a set of its own: where sets are aggregated, a colour camera
        that is slow in the dark would slow down depth, and one that fails would delay it. Without colour,
        depth and infrared come in one set, so that the pipeline's queue holds more moments.
        """
        configuration = sdk.Config()
        for profile in (self.depth, self.infrared, self.color):
            if profile is not None:
                configuration.enable_stream(profile)
        modes = sdk.OBFrameAggregateOutputMode
        configuration.set_frame_aggregate_output_mode(
            modes.ANY_SITUATION if self.color is None else modes.DISABLE
        )
        return configuration


def check_modes(settings: CaptureSettings) -> None:
    """Checks without a sensor whether one could run in these modes.

    Raises:
        DeviceError: A mode that no sensor has.
    """
    if settings.depth_mode not in DEPTH_SIZES:
        raise DeviceError(f"No depth mode {settings.depth_mode}. There are {', '.join(DEPTH_SIZES)}.")
    if settings.color is not None and settings.color not in COLOR_SIZES:
        raise DeviceError(f"Orbbec's sensors have no colour {settings.color}: {', '.join(COLOR_SIZES)}.")


def choose_streams(sdk: Any, pipeline: Any, serial: str, settings: CaptureSettings) -> Streams:
    """Chooses the streams of an opened sensor; raises a DeviceError if it has no such images."""
    check_modes(settings)
    sensors, formats = sdk.OBSensorType, sdk.OBFormat
    depths = _profiles(sdk, pipeline, sensors.DEPTH_SENSOR, (formats.Y16,), settings.fps)
    if not depths:
        raise DeviceError(f"Orbbec {serial} has no depth at {settings.fps} fps. Choose another `fps`.")
    infrareds: list[Any] = []
    for sensor in (sensors.IR_SENSOR, sensors.LEFT_IR_SENSOR):  # a stereo sensor's depth is its left image's
        wanted = tuple(getattr(formats, name) for name in _INFRARED_FORMATS)
        infrareds = infrareds or _profiles(sdk, pipeline, sensor, wanted, settings.fps)
    infrared_of = {_size(profile): profile for profile in reversed(infrareds)}
    usable = [profile for profile in depths if _size(profile) in infrared_of]
    if not usable:
        raise DeviceError(
            f"Orbbec {serial} has no infrared image of its depth image's size at {settings.fps} fps, which "
            f"the body tracker needs. Choose another `fps`."
        )
    width_height = DEPTH_SIZES[settings.depth_mode]
    exact = [profile for profile in usable if _size(profile) == width_height]
    if not exact and width_height != DEPTH_SIZES["NFOV_UNBINNED"]:
        sizes = ", ".join(sorted({"×".join(map(str, _size(profile))) for profile in usable}))
        raise DeviceError(
            f"Orbbec {serial} has no depth mode {settings.depth_mode} at {settings.fps} fps. It has {sizes}; "
            f"leave `depth_mode` out."
        )
    depth = exact[0] if exact else min(usable, key=lambda profile: abs(profile.get_width() - _USUAL_WIDTH))
    color = None
    if settings.color is not None:
        colors = _profiles(sdk, pipeline, sensors.COLOR_SENSOR, (formats.MJPG,), settings.fps)
        color = next((one for one in colors if _size(one) == COLOR_SIZES[settings.color]), None)
        if color is None:
            named = {size: name for name, size in COLOR_SIZES.items()}
            has = [named[_size(one)] for one in colors if _size(one) in named] or ["none"]
            raise DeviceError(
                f"Orbbec {serial} has no colour {settings.color} (MJPG) at {settings.fps} fps. "
                f"It has {', '.join(dict.fromkeys(has))}."
            )
    return Streams(depth, infrared_of[_size(depth)], color)


def intrinsics_of(sdk: Any, profile: Any, serial: str) -> tuple[Intrinsics, str]:
    """The lens of a stream, and a warning; empty if there is none.

    A model other than OpenCV's is left out with a warning: the lens then counts as ideal. Coefficients that
    are all zero are no distortion under any model.

    Raises:
        DeviceError: The sensor has no calibration of this stream.
    """
    try:
        lens, distortion = profile.get_intrinsic(), profile.get_distortion()
    except faults_of(sdk) as fault:
        raise DeviceError(
            f"Orbbec {serial} gives no calibration ({fault}). Calibrate or reset it with OrbbecViewer."
        ) from fault
    if not (lens.fx > 0.0 and lens.fy > 0.0):
        raise DeviceError(f"Orbbec {serial} has a focal length of {lens.fx:g} px. Reset it in OrbbecViewer.")
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    coefficients = tuple(float(getattr(distortion, name)) for name in names)
    warning = ""
    model = distortion.model.name
    if not any(coefficients):
        coefficients = ()
    elif model not in _BROWN_CONRADY:
        coefficients = ()
        warning = f"Orbbec {serial}: lens distortion of the model {model} is not known and is left out."
    pinhole = Intrinsics(
        profile.get_width(),
        profile.get_height(),
        float(lens.fx),
        float(lens.fy),
        float(lens.cx),
        float(lens.cy),
        coefficients,
    )
    return pinhole, warning


def color_camera(sdk: Any, color: Any, depth: Any, serial: str) -> tuple[ColorCamera, str]:
    """The colour camera of a stream and its place beside the depth camera; and a warning.

    Raises:
        DeviceError: The sensor has no calibration of it.
    """
    intrinsics, warning = intrinsics_of(sdk, color, serial)
    try:
        pose = depth.get_extrinsic_to(color)
        translation = np.asarray(pose.transform, dtype=np.float64) * 1e-3  # the SDK's are millimetres
        return ColorCamera(intrinsics, RigidTransform.of(pose.rot, translation)), warning
    except faults_of(sdk) + (FusionError,) as fault:
        raise DeviceError(
            f"Orbbec {serial} does not know its colour camera's place ({fault}). Run without `color`."
        ) from fault


def _profiles(sdk: Any, pipeline: Any, sensor: Any, formats: tuple[Any, ...], fps: int) -> list[Any]:
    """A sensor's profiles of this rate, in the order of the formats; none where there is no such camera."""
    try:
        profiles = pipeline.get_stream_profile_list(sensor)
        found = [profiles.get_stream_profile_by_index(index) for index in range(profiles.get_count())]
    except faults_of(sdk):
        return []
    return [
        profile
        for wanted in formats
        for profile in found
        if profile.get_format() == wanted and profile.get_fps() == fps
    ]


def _size(profile: Any) -> tuple[int, int]:
    return profile.get_width(), profile.get_height()
