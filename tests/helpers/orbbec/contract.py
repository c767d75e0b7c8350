"""What this program uses of pyorbbecsdk, as clauses that the stand-in and the real library are both held to.

Without a sensor: frames, sets of frames and stream profiles can be made by hand in both.
``python -m tests.helpers.orbbec.contract`` holds the pyorbbecsdk of that interpreter to every clause and
prints the results as JSON.
"""

import json
import os
import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from devices.capture.clock.moments import ImageJoiner
from devices.orbbec.images import FrameReader, color_image, depth_image, infrared_image
from devices.orbbec.streams import color_camera, intrinsics_of
from tests.helpers.pyk4a_contract import fault_of

ENUMS = {
    "OBSensorType": ("IR_SENSOR", "COLOR_SENSOR", "DEPTH_SENSOR", "LEFT_IR_SENSOR"),
    "OBFrameType": ("IR_FRAME", "COLOR_FRAME", "DEPTH_FRAME", "LEFT_IR_FRAME"),
    "OBFormat": ("MJPG", "Y16", "Y8"),
    "OBLogLevel": ("ERROR", "NONE"),
    "OBClockType": ("REALTIME", "MONOTONIC"),
    "OBFrameAggregateOutputMode": ("FULL_FRAME_REQUIRE", "ANY_SITUATION", "DISABLE"),
    "OBMultiDeviceSyncMode": ("FREE_RUN", "STANDALONE", "PRIMARY", "SECONDARY", "SECONDARY_SYNCED"),
    "OBPlaybackStatus": ("PLAYING", "STOPPED"),
    "OBCameraDistortionModel": ("NONE", "BROWN_CONRADY", "BROWN_CONRADY_K6", "KANNALA_BRANDT4"),
}
CLASSES = (
    *("Context", "DeviceList", "Device", "DeviceInfo", "PlaybackDevice", "Pipeline", "Config"),
    *("VideoStreamProfile", "StreamProfileList", "Frame", "VideoFrame", "DepthFrame", "IRFrame"),
    *("ColorFrame", "FrameSet", "OBCameraIntrinsic", "OBCameraDistortion", "OBExtrinsic"),
    "OBMultiDeviceSyncConfig",
)


@cache
def _context(sdk):
    """The one context of all clauses: to make another one took a minute."""
    return sdk.Context()


def names(sdk):
    """The public names of each class."""
    return {kind: [name for name in dir(getattr(sdk, kind)) if name[0] != "_"] for kind in CLASSES}


def enums(sdk):
    """The members that this program names, and their numbers."""
    return {
        f"{enum}.{name}": int(getattr(getattr(sdk, enum), name))
        for enum, members in ENUMS.items()
        for name in members
    }


def no_device(sdk):
    """Without a sensor the list is empty; asking it for one is an OBError, a pipeline a RuntimeError."""
    devices = _context(sdk).query_devices()
    assert (devices.get_count(), len(devices)) == (0, 0)
    questions = (
        lambda: devices.get_device_by_index(0),
        lambda: devices.get_device_serial_number_by_index(0),
        lambda: devices.get_device_by_serial_number("CL8H741005K"),
    )
    said = [str(fault_of(sdk.OBError, question)) for question in questions]
    return {"said": [*said, str(fault_of(RuntimeError, sdk.Pipeline))]}


def errors(sdk):
    """An OBError carries a message only, and is no RuntimeError: both must be caught."""
    assert issubclass(sdk.OBError, Exception)
    assert not issubclass(sdk.OBError, RuntimeError | OSError)


def clock(sdk):
    """Host times are of the epoch, unless a context is told otherwise."""
    context = _context(sdk)
    assert context.get_timestamp_clock_type() in (sdk.OBClockType.REALTIME, sdk.OBClockType.MONOTONIC)
    context.set_timestamp_clock_type(sdk.OBClockType.MONOTONIC)
    assert context.get_timestamp_clock_type() == sdk.OBClockType.MONOTONIC


def quiet(sdk):
    """Told before the first context, the library keeps no log in the current folder."""
    assert sdk.Context.set_logger_level(sdk.OBLogLevel.NONE) is None
    _context(sdk)
    assert not Path("Log").exists()


def playback(sdk):
    """A file that is missing, or is no recording, is a RuntimeError, not an OBError."""
    with tempfile.TemporaryDirectory() as folder:
        missing, other = Path(folder, "none.bag"), Path(folder, "other.bag")
        other.write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
        faults = [
            fault_of(RuntimeError, lambda path=path: sdk.PlaybackDevice(str(path)))
            for path in (missing, other)
        ]
    return {"said": [str(fault).replace(folder, "FOLDER") for fault in faults]}


def frames(sdk):
    """A frame's data are its bytes, copied; other sizes are refused; times are whole microseconds."""
    frame = _made(sdk, "DEPTH_FRAME", "Y16", np.arange(12, dtype=np.uint16).reshape(3, 4), 123_456, 99)
    data = frame.get_data()
    assert (data.dtype, data.shape, data.flags.owndata) == (np.uint8, (24,), True)
    fault_of(RuntimeError, lambda: frame.update_data(b"short"))
    assert frame.get_format() == sdk.OBFormat.Y16
    times = [frame.get_timestamp_us(), frame.get_system_timestamp_us()]
    return {"size": [frame.get_width(), frame.get_height(), frame.get_data_size()], "times": times}


def frame_sets(sdk):
    """A set gives None for an image that it lacks, and a depth frame with a scale."""
    found = sdk.Frame.create_frame_set()
    for missing in ("depth", "ir", "left_ir", "color"):
        assert getattr(found, f"get_{missing}_frame")() is None
    _push(sdk, found, 1_000)
    assert found.get_depth_frame().get_depth_scale() == 1.0
    assert found.get_ir_frame().get_width() == 4
    assert found.get_left_ir_frame() is None


def our_images(sdk):
    """This program's own reading of the library's frames."""
    found = sdk.Frame.create_frame_set()
    _push(sdk, found, 5_000_000)
    joiner = ImageJoiner(33_333_333, infrared=33_333_333, color=33_333_333)
    FrameReader(joiner).add(found, 7_000_000_000)
    moment = joiner.take()
    depth, infrared = depth_image(moment.depth), infrared_image(moment.infrared)
    assert (depth.dtype, depth.shape, infrared.dtype) == (np.uint16, (3, 4), np.uint16)
    assert color_image(moment.color, None) is None
    return {
        "depth": depth.tolist(),
        "infrared": infrared.tolist(),
        "times": [moment.time_ns, moment.host_ns],
        "color": bytes(moment.color.get_data()).hex(),
    }


def profiles(sdk):
    """A profile without calibration is an OBError; with one, it is as set."""
    depth, color = _profiles(sdk)
    for question in (depth.get_intrinsic, depth.get_distortion, lambda: depth.get_extrinsic_to(color)):
        fault_of(sdk.OBError, question)
    _calibrate(sdk, depth, color)
    ours, warning = intrinsics_of(sdk, depth, "123")
    beside, _ = color_camera(sdk, color, depth, "123")
    return {
        "lens": [ours.width, ours.height, *(round(value, 4) for value in (ours.fx, *ours.distortion))],
        "warning": warning,
        "beside": beside.color_from_depth.translation.round(6).tolist(),
        "profile": [depth.get_fps(), int(depth.get_format())],
    }


def sync_configuration(sdk):
    """A sync configuration has exactly the fields that are set here."""
    wanted = sdk.OBMultiDeviceSyncConfig()
    wanted.mode, wanted.trigger_out_enable = sdk.OBMultiDeviceSyncMode.PRIMARY, True
    wanted.depth_delay_us = wanted.color_delay_us = 160

    def misspell():
        wanted.depthDelayUs = 160

    fault_of(AttributeError, misspell)
    return {
        "set": [int(wanted.mode), wanted.depth_delay_us, wanted.color_delay_us, wanted.trigger_out_enable]
    }


def configurations(sdk):
    """The way of aggregating frames is an enum, not a number."""
    fault_of(TypeError, lambda: sdk.Config().set_frame_aggregate_output_mode(0))
    sdk.Config().set_frame_aggregate_output_mode(sdk.OBFrameAggregateOutputMode.ANY_SITUATION)


CLAUSES = (quiet, names, enums, no_device, errors, clock, playback)  # quiet first: before any context
CLAUSES += (frames, frame_sets, our_images, profiles, sync_configuration, configurations)


def _made(sdk, kind, image_format, image, device_us=0, system_us=0):
    kind, image_format = getattr(sdk.OBFrameType, kind), getattr(sdk.OBFormat, image_format)
    if image.ndim == 2:
        height, width = image.shape
        frame = sdk.Frame.create_video_frame(kind, image_format, width, height, 0)
    else:
        frame = sdk.Frame.create_frame(kind, image_format, image.size)
    frame.update_data(image.tobytes())
    sdk.Frame.set_frame_device_timestamp_us(frame, device_us)
    frame.set_system_timestamp_us(system_us)
    return frame


def _push(sdk, found, time_us):
    """Depth, 8-bit infrared and colour of one moment."""
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4) + 2000
    jpeg = np.frombuffer(b"\xff\xd8abc\xff\xd9", np.uint8)
    found.push_frame(_made(sdk, "DEPTH_FRAME", "Y16", depth, time_us, time_us + 1_000_000))
    found.push_frame(_made(sdk, "IR_FRAME", "Y8", np.full((3, 4), 200, np.uint8), time_us))
    found.push_frame(_made(sdk, "COLOR_FRAME", "MJPG", jpeg, time_us))


def _profiles(sdk):
    configuration = sdk.Config()
    configuration.enable_video_stream(sdk.OBStreamType.DEPTH_STREAM, 640, 576, 30, sdk.OBFormat.Y16)
    configuration.enable_video_stream(sdk.OBStreamType.COLOR_STREAM, 1280, 720, 30, sdk.OBFormat.MJPG)
    both = configuration.get_enabled_stream_profile_list()
    assert both.get_count() == 2
    fault_of(sdk.OBError, lambda: both.get_stream_profile_by_index(2))
    return both.get_stream_profile_by_index(0), both.get_stream_profile_by_index(1)


def _calibrate(sdk, depth, color):
    for profile in (depth, color):
        lens, distortion = sdk.OBCameraIntrinsic(), sdk.OBCameraDistortion()
        lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height = 504.0, 505.0, 332.0, 348.0, 640, 576
        distortion.k1, distortion.p2 = 0.5, -0.25
        distortion.model = sdk.OBCameraDistortionModel.BROWN_CONRADY_K6
        profile.set_intrinsic(lens)
        profile.set_distortion(distortion)
    pose = sdk.OBExtrinsic()
    pose.rot, pose.transform = np.eye(3), (-32.0, 0.0, 4.0)
    assert (pose.rot.shape, pose.transform.shape) == ((3, 3), (3,))
    depth.bind_extrinsic_to(color, pose)


def main():
    """The program."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        import pyorbbecsdk

        results = {}
        for clause in CLAUSES:
            try:
                results[clause.__name__] = {"said": clause(pyorbbecsdk)}
            except Exception as fault:
                results[clause.__name__] = {"fault": f"{type(fault).__name__}: {fault}"}
        os.chdir("/")
    print("\n" + json.dumps(results), flush=True)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
