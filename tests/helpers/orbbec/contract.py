"""What this program uses of pyorbbecsdk without a sensor, as clauses.

The stand-in and the real library are held to :data:`CLAUSES`. :data:`BY_HAND` make frames and profiles by
hand, which only the real library can. ``python -m tests.helpers.orbbec.contract`` holds the pyorbbecsdk of
that interpreter to every clause and prints the results as JSON.
"""

import json
import os
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from devices.capture.clock.moments import ImageJoiner
from devices.orbbec.images import FrameReader, color_image, depth_image, infrared_image
from devices.orbbec.streams import color_camera, intrinsics_of
from tests.helpers.orbbec.standin import OrbbecBus, make_module
from tests.helpers.orbbec.standin_values import ENUMS
from tests.helpers.pyk4a_contract import fault_of


@cache
def _context(sdk):
    """The one context of all clauses: to make another one took a minute."""
    return sdk.Context()


def names(sdk):
    """The stand-in has no name that the real library lacks."""
    for title, kind in vars(make_module(OrbbecBus())).items():
        for name in vars(kind) if isinstance(kind, type) else ():
            assert name[0] == "_" or hasattr(getattr(sdk, title), name), f"{title}.{name}"


def enums(sdk):
    """The members that this program names have these numbers."""
    for title, members in ENUMS.items():
        found = getattr(sdk, title)
        assert {name: int(getattr(found, name)) for name in members} == members


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
    return [*said, str(fault_of(RuntimeError, sdk.Pipeline))]


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
    return [str(fault).replace(folder, "FOLDER") for fault in faults]


def our_images(sdk):
    """A set gives None for an image that it lacks; this program reads the others."""
    found = sdk.Frame.create_frame_set()
    for missing in ("depth", "ir", "left_ir", "color"):
        assert getattr(found, f"get_{missing}_frame")() is None
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4) + 2000
    jpeg = np.frombuffer(b"\xff\xd8abc\xff\xd9", np.uint8)
    found.push_frame(_made(sdk, "DEPTH_FRAME", "Y16", depth, 6_000_000))
    found.push_frame(_made(sdk, "IR_FRAME", "Y8", np.full((3, 4), 200, np.uint8)))
    found.push_frame(_made(sdk, "COLOR_FRAME", "MJPG", jpeg))
    joiner = ImageJoiner(33_333_333, infrared=33_333_333, color=33_333_333)
    FrameReader(joiner).add(found, 7_000_000_000)
    moment = joiner.take()
    assert depth_image(moment.depth).tolist() == depth.tolist()
    infrared = infrared_image(moment.infrared)
    assert (infrared.dtype, np.unique(infrared).tolist()) == (np.uint16, [200])
    assert (moment.time_ns, moment.host_ns) == (5_000_000_000, 6_000_000_000)
    assert color_image(moment.color, None) is None
    assert bytes(moment.color.get_data()) == jpeg.tobytes()


def profiles(sdk):
    """A profile without calibration is an OBError; with one, it is as set."""
    configuration = sdk.Config()
    configuration.enable_video_stream(sdk.OBStreamType.DEPTH_STREAM, 640, 576, 30, sdk.OBFormat.Y16)
    configuration.enable_video_stream(sdk.OBStreamType.COLOR_STREAM, 1280, 720, 30, sdk.OBFormat.MJPG)
    both = configuration.get_enabled_stream_profile_list()
    fault_of(sdk.OBError, lambda: both.get_stream_profile_by_index(2))
    depth, color = (both.get_stream_profile_by_index(k) for k in range(both.get_count()))
    for question in (depth.get_intrinsic, depth.get_distortion, lambda: depth.get_extrinsic_to(color)):
        fault_of(sdk.OBError, question)
    for profile in (depth, color):
        lens, distortion = sdk.OBCameraIntrinsic(), sdk.OBCameraDistortion()
        lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height = 504.0, 505.0, 332.0, 348.0, 640, 576
        distortion.k1, distortion.p2 = 0.5, -0.25
        distortion.model = sdk.OBCameraDistortionModel.BROWN_CONRADY_K6
        profile.set_intrinsic(lens)
        profile.set_distortion(distortion)
    pose = sdk.OBExtrinsic()
    pose.rot, pose.transform = np.eye(3), (-32.0, 0.0, 4.0)
    depth.bind_extrinsic_to(color, pose)
    ours, warning = intrinsics_of(sdk, depth, "123")
    assert (ours.width, ours.height, ours.fx, ours.cy, warning) == (640, 576, 504.0, 348.0, "")
    assert ours.distortion == (0.5, 0.0, 0.0, -0.25, 0.0, 0.0, 0.0, 0.0)
    beside, _ = color_camera(sdk, color, depth, "123")
    np.testing.assert_allclose(beside.color_from_depth.translation, [-0.032, 0.0, 0.004])
    assert (depth.get_fps(), depth.get_format()) == (30, sdk.OBFormat.Y16)


def sync_configuration(sdk):
    """A sync configuration has exactly the fields that are set here."""
    wanted = sdk.OBMultiDeviceSyncConfig()
    wanted.mode, wanted.trigger_out_enable = sdk.OBMultiDeviceSyncMode.PRIMARY, True
    wanted.depth_delay_us = wanted.color_delay_us = 160

    def misspell():
        wanted.depthDelayUs = 160

    fault_of(AttributeError, misspell)
    assert (wanted.depth_delay_us, wanted.color_delay_us, wanted.trigger_out_enable) == (160, 160, True)


def configurations(sdk):
    """The way of aggregating frames is an enum, not a number."""
    fault_of(TypeError, lambda: sdk.Config().set_frame_aggregate_output_mode(0))
    sdk.Config().set_frame_aggregate_output_mode(sdk.OBFrameAggregateOutputMode.ANY_SITUATION)


CLAUSES = (quiet, enums, no_device, errors, clock, playback)  # quiet first: before any context
BY_HAND = (names, our_images, profiles, sync_configuration, configurations)


def _made(sdk, kind, image_format, image, system_us=0):
    kind, image_format = getattr(sdk.OBFrameType, kind), getattr(sdk.OBFormat, image_format)
    if image.ndim == 2:
        height, width = image.shape
        frame = sdk.Frame.create_video_frame(kind, image_format, width, height, 0)
    else:
        frame = sdk.Frame.create_frame(kind, image_format, image.size)
    frame.update_data(image.tobytes())
    sdk.Frame.set_frame_device_timestamp_us(frame, 5_000_000)
    frame.set_system_timestamp_us(system_us)
    return frame


def main():
    """The program."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        import pyorbbecsdk

        results = {}
        for clause in CLAUSES + BY_HAND:
            try:
                results[clause.__name__] = clause(pyorbbecsdk)
            except Exception as fault:
                results[clause.__name__] = f"{type(fault).__name__}: {fault}"
        os.chdir("/")
    print("\n" + json.dumps(results), flush=True)


if __name__ == "__main__":
    main()
