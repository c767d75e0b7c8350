"""Recordings of ROS 2 as robots see them: messages, and the tree of frames."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.helpers.machine import lacks

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""REP 103: x forward, y left, z up from the axes of an image with z forward."""


def rosbags():
    """The packages that write and read; skips without them."""
    try:
        import mcap
        import rosbags
    except ImportError:
        lacks("rosbags and mcap", "pip install -e '.[ros]'")
    return mcap, rosbags


def messages(path):
    """(topic, log time, message) of all messages, read by rosbags with its own definitions of another ROS."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(path) as reader:
        ids = next(each for each in reader.connections if each.msgtype == "hri_msgs/msg/IdsList")
        store.register(get_types_from_msg(ids.msgdef.data.split("=")[0], ids.msgtype))
        return [(of.topic, at, store.deserialize_cdr(data, of.msgtype)) for of, at, data in reader.messages()]


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


class Frames:
    """A tree of frames, as tf2 keeps it: each frame has the newest transform from its parent."""

    def __init__(self, transforms):
        self._above = {
            of.child_frame_id: (
                of.header.frame_id,
                Rotation.from_quat([getattr(of.transform.rotation, axis) for axis in "xyzw"]),
                np.array([getattr(of.transform.translation, axis) for axis in "xyz"]),
            )
            for of in transforms
        }

    def names(self):
        return set(self._above)

    def pose(self, frame, seen_from):
        """Rotation and metres of a frame, seen from one above it."""
        turned, place = Rotation.identity(), np.zeros(3)
        while frame != seen_from:
            frame, rotation, translation = self._above[frame]
            turned, place = rotation * turned, rotation.apply(place) + translation
        return turned, place
