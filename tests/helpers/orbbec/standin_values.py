"""Values of the stand-in for pyorbbecsdk: enums, frames, profiles and errors, as in pyorbbecsdk2 2.1.2."""

import enum

import numpy as np

ENUMS = {
    "OBSensorType": {"IR_SENSOR": 1, "COLOR_SENSOR": 2, "DEPTH_SENSOR": 3, "LEFT_IR_SENSOR": 6},
    "OBFormat": {"MJPG": 5, "Y16": 8, "Y8": 9},
    "OBLogLevel": {"ERROR": 3, "NONE": 5},
    "OBClockType": {"REALTIME": 0, "MONOTONIC": 1},
    "OBFrameAggregateOutputMode": {"FULL_FRAME_REQUIRE": 0, "ANY_SITUATION": 2, "DISABLE": 3},
    "OBMultiDeviceSyncMode": {
        "FREE_RUN": 1,
        "STANDALONE": 2,
        "PRIMARY": 4,
        "SECONDARY": 8,
        "SECONDARY_SYNCED": 16,
    },
    "OBPlaybackStatus": {"PLAYING": 1, "STOPPED": 3},
    "OBCameraDistortionModel": {"NONE": 0, "BROWN_CONRADY": 3, "BROWN_CONRADY_K6": 4, "KANNALA_BRANDT4": 5},
}
"""The members that this program and the stand-in name, with their numbers."""


class OBError(Exception):
    """Has a message only, like the real one."""


class _Pybind(enum.Enum):
    """An enum that behaves as pybind11's: it has ``int()`` and is no integer."""

    def __int__(self):
        return int(self.value)


TYPES = {name: _Pybind(name, members) for name, members in ENUMS.items()}
OBMultiDeviceSyncMode = TYPES["OBMultiDeviceSyncMode"]


class VideoStreamProfile:
    """A stream of a camera; ``lens``, ``distortion`` and ``pose`` are None without a calibration."""

    def __init__(self, kind, width, height, fps, image_format, lens=None, distortion=None, pose=None):
        self.kind, self.size, self.fps, self.format = kind, (width, height), fps, image_format
        self._lens, self._distortion, self._pose = lens, distortion, pose

    def get_format(self):
        return self.format

    def get_fps(self):
        return self.fps

    def get_width(self):
        return self.size[0]

    def get_height(self):
        return self.size[1]

    def get_intrinsic(self):
        if self._lens is None:
            raise OBError("Intrinsics for the input stream profile is not found.")
        return self._lens

    def get_distortion(self):
        return self._distortion

    def get_extrinsic_to(self, _):
        return self._pose


class StreamProfileList:
    def __init__(self, profiles):
        self._profiles = profiles

    def get_count(self):
        return len(self._profiles)

    def get_stream_profile_by_index(self, index):
        return self._profiles[index]


class Config:
    def __init__(self):
        self.profiles, self.mode = [], None

    def enable_stream(self, profile):
        self.profiles.append(profile)

    def set_frame_aggregate_output_mode(self, mode):
        self.mode = mode


class Frame:
    def __init__(self, image, device_us, system_us, scale=1.0):
        self.image, self.scale = image, scale
        self._device_us, self._system_us = device_us, system_us

    def get_data(self):
        return np.frombuffer(self.image.tobytes(), np.uint8).copy()

    def get_data_size(self):
        return self.image.nbytes

    def get_timestamp_us(self):
        return self._device_us

    def get_system_timestamp_us(self):
        return self._system_us


class VideoFrame(Frame):
    def get_width(self):
        return self.image.shape[1]

    def get_height(self):
        return self.image.shape[0]


class DepthFrame(VideoFrame):
    def get_depth_scale(self):
        return self.scale


class FrameSet:
    """The images of a moment by their names; any may be missing."""

    def __init__(self, **frames):
        self._frames = frames

    def get_depth_frame(self):
        return self._frames.get("depth")

    def get_ir_frame(self):
        return self._frames.get("ir")

    def get_left_ir_frame(self):
        return self._frames.get("left_ir")

    def get_color_frame(self):
        return self._frames.get("color")
