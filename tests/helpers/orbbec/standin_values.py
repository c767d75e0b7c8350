"""Values of the stand-in for pyorbbecsdk: enums, frames, profiles and errors, as in pyorbbecsdk2 2.1.2."""

import enum

import numpy as np


class OBError(Exception):
    """Has a message only, like the real one."""


def pybind_enum(title, **members):
    """An enum that behaves as pybind11's: it has ``int()`` and is no integer."""

    class _Base(enum.Enum):
        def __int__(self):
            return int(self.value)

        def __index__(self):
            return int(self.value)

    return _Base(title, members)


def _getter(attribute):
    return lambda self: getattr(self, attribute)


OBSensorType = pybind_enum("OBSensorType", IR_SENSOR=1, COLOR_SENSOR=2, DEPTH_SENSOR=3, LEFT_IR_SENSOR=6)
OBStreamType = pybind_enum("OBStreamType", IR_STREAM=1, COLOR_STREAM=2, DEPTH_STREAM=3, LEFT_IR_STREAM=6)
OBFrameType = pybind_enum("OBFrameType", IR_FRAME=1, COLOR_FRAME=2, DEPTH_FRAME=3, LEFT_IR_FRAME=8)
OBFormat = pybind_enum("OBFormat", MJPG=5, Y16=8, Y8=9)
OBLogLevel = pybind_enum("OBLogLevel", ERROR=3, NONE=5)
OBClockType = pybind_enum("OBClockType", REALTIME=0, MONOTONIC=1)
OBFrameAggregateOutputMode = pybind_enum(
    "OBFrameAggregateOutputMode", FULL_FRAME_REQUIRE=0, COLOR_FRAME_REQUIRE=1, ANY_SITUATION=2, DISABLE=3
)
OBMultiDeviceSyncMode = pybind_enum(
    "OBMultiDeviceSyncMode", FREE_RUN=1, STANDALONE=2, PRIMARY=4, SECONDARY=8, SECONDARY_SYNCED=16
)
_DISTORTIONS = ("NONE", "MODIFIED_BROWN_CONRADY", "INVERSE_BROWN_CONRADY", "BROWN_CONRADY")
_DISTORTIONS += ("BROWN_CONRADY_K6", "KANNALA_BRANDT4")
OBCameraDistortionModel = pybind_enum(
    "OBCameraDistortionModel", **{name: number for number, name in enumerate(_DISTORTIONS)}
)
OBPlaybackStatus = pybind_enum("OBPlaybackStatus", UNKNOWN=0, PLAYING=1, PAUSED=2, STOPPED=3)


class OBCameraIntrinsic:
    __slots__ = ("cx", "cy", "fx", "fy", "height", "width")

    def __init__(self):
        self.fx = self.fy = self.cx = self.cy = 0.0
        self.width = self.height = 0


class OBCameraDistortion:
    __slots__ = ("k1", "k2", "k3", "k4", "k5", "k6", "model", "p1", "p2")

    def __init__(self):
        self.model = OBCameraDistortionModel.NONE
        self.k1 = self.k2 = self.k3 = self.k4 = self.k5 = self.k6 = self.p1 = self.p2 = 0.0


class OBExtrinsic:
    __slots__ = ("rot", "transform")

    def __setattr__(self, name, value):
        shape = {"rot": (3, 3), "transform": (3,)}[name]
        object.__setattr__(self, name, np.array(value, np.float32).reshape(shape))


class OBMultiDeviceSyncConfig:
    __slots__ = ("color_delay_us", "depth_delay_us", "mode", "trigger_out_enable")

    def __init__(self):
        self.mode = None
        self.depth_delay_us = self.color_delay_us = 0
        self.trigger_out_enable = False


class VideoStreamProfile:
    get_type = _getter("_kind")
    get_format = _getter("_format")
    get_fps = _getter("_fps")
    get_width = _getter("_width")
    get_height = _getter("_height")

    def __init__(self, kind, width, height, fps, image_format):
        self._kind, self._width, self._height = kind, width, height
        self._fps, self._format = fps, image_format
        self._lens = None
        self._distortion = None
        self._poses = {}

    def as_video_stream_profile(self):
        return self

    def get_intrinsic(self):
        if self._lens is None:
            raise OBError("Intrinsics for the input stream profile is not found.")
        return self._lens

    def set_intrinsic(self, lens):
        self._lens = lens

    def get_distortion(self):
        if self._distortion is None:
            raise OBError("Distortion for the input stream profile is not found.")
        return self._distortion

    def set_distortion(self, distortion):
        self._distortion = distortion

    def bind_extrinsic_to(self, other, pose):
        self._poses[id(other)] = pose

    def get_extrinsic_to(self, other):
        if id(other) not in self._poses:
            raise OBError("From Stream profile not registered!")
        return self._poses[id(other)]


class StreamProfileList:
    def __init__(self, profiles):
        self._profiles = profiles

    def get_count(self):
        return len(self._profiles)

    def __len__(self):
        return len(self._profiles)

    def get_stream_profile_by_index(self, index):
        if not 0 <= index < len(self._profiles):
            raise OBError("ob_stream_profile_list_get_profile: index out of range!")
        return self._profiles[index]


class Config:
    def __init__(self):
        self._profiles = []
        self._mode = None

    def enable_stream(self, profile):
        self._profiles.append(profile)

    def enable_video_stream(self, stream_type, width, height, fps, image_format):
        self._profiles.append(VideoStreamProfile(stream_type, width, height, fps, image_format))

    def get_enabled_stream_profile_list(self):
        return StreamProfileList(list(self._profiles))

    def set_frame_aggregate_output_mode(self, mode):
        if not isinstance(mode, OBFrameAggregateOutputMode):
            raise TypeError("incompatible function arguments")
        self._mode = mode


class Frame:
    """A newly made frame. The real one has no depth scale until it is part of a set."""

    get_format = _getter("_format")
    get_type = _getter("_kind")
    get_timestamp_us = _getter("_device_us")
    get_system_timestamp_us = _getter("_system_us")

    def __init__(self, kind, image_format, size, shape):
        self._kind, self._format, (self._height, self._width) = kind, image_format, shape
        self._data = np.zeros(size, np.uint8)
        self._device_us = self._system_us = 0
        self._scale = 1.0

    @staticmethod
    def create_frame(kind, image_format, size):
        return Frame(kind, image_format, size, (0, 0))

    @staticmethod
    def create_video_frame(kind, image_format, width, height, stride=0):
        assert stride == 0, "the stand-in knows rows without a gap only"
        return VideoFrame(kind, image_format, width * height * _bytes_of(image_format), (height, width))

    @staticmethod
    def create_frame_set():
        return FrameSet()

    @staticmethod
    def set_frame_device_timestamp_us(frame, device_us):
        frame._device_us = device_us

    def set_system_timestamp_us(self, system_us):
        self._system_us = system_us

    def update_data(self, data):
        if len(data) != len(self._data):
            raise RuntimeError("update_data: buffer size mismatch")
        self._data = np.frombuffer(data, np.uint8).copy()

    def get_data(self):
        return self._data.copy()

    def get_data_size(self):
        return len(self._data)


class VideoFrame(Frame):
    get_width = _getter("_width")
    get_height = _getter("_height")


class DepthFrame(VideoFrame):
    get_depth_scale = _getter("_scale")


class IRFrame(VideoFrame):
    pass


class ColorFrame(VideoFrame):
    pass


def _viewed(frame, kind):
    """Returns the frame as a set gives it: another object whose class depends on the image."""
    if frame is None:
        return None
    view = kind.__new__(kind)
    view.__dict__ = frame.__dict__
    return view


class FrameSet:
    def __init__(self):
        self._frames = {}

    def push_frame(self, frame):
        self._frames[frame.get_type()] = frame

    def get_count(self):
        return len(self._frames)

    def get_depth_frame(self):
        return self._get("DEPTH_FRAME", DepthFrame)

    def get_ir_frame(self):
        return self._get("IR_FRAME", IRFrame)

    def get_left_ir_frame(self):
        return self._get("LEFT_IR_FRAME", IRFrame)

    def get_color_frame(self):
        return self._get("COLOR_FRAME", ColorFrame)

    def _get(self, name, kind):
        return _viewed(self._frames.get(getattr(OBFrameType, name)), kind)


def _bytes_of(image_format):
    return 2 if image_format is OBFormat.Y16 else 1
