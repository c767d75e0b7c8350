"""Sources of frames: sensors, recordings and the simulator; pairing of frames."""

from typing import TYPE_CHECKING

from fusion.support.lazy_names import lazy_names

if TYPE_CHECKING:
    from devices.blazepose.depth_camera import DepthCamera as DepthCamera
    from devices.capture.sensor_pair import TwoSensors as TwoSensors
    from devices.frame_pairs import FramePair as FramePair
    from devices.pairing import Pairing as Pairing
    from devices.pairing import pair_views as pair_views
    from devices.recorded.files import open_source as open_source
    from devices.recorded.two_recordings import RecordingChoice as RecordingChoice
    from devices.recorded.two_recordings import TwoRecordings as TwoRecordings
    from devices.recorded.two_recordings import read_two as read_two
    from devices.sensor import ColorCamera as ColorCamera
    from devices.sensor import ColorImage as ColorImage
    from devices.sensor import DeviceError as DeviceError
    from devices.sensor import MissingRecordingError as MissingRecordingError
    from devices.sensor import Sensor as Sensor
    from devices.sensor import SensorFrame as SensorFrame
    from devices.simulated.kinect import simulated_pair as simulated_pair

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
