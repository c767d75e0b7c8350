"""A Kinect v2 of a Windows PC for duplex live elsewhere: kinect_v2_on_another_pc.py KEY tcp/HOST:7447

Needs kinect-next. Written from the sources of kinect-next 3.0, and not tested with a sensor.
"""

import sys
import time
from types import SimpleNamespace

from kinect_next import KinectSensor, StreamType

from devices import SensorFrame
from devices.network.publishing import FramePublisher
from devices.network.zenoh_session import ZenohAddresses
from fusion import KINECT_V2, Skeleton


def skeleton(person):  # Microsoft's x points to the sensor's left, and y up
    joints = [person.joints[number] for number in range(25)]
    positions = [(-joint.position.x, -joint.position.y, joint.position.z) for joint in joints]
    return Skeleton.of(KINECT_V2, positions, [int(joint.tracking_state) for joint in joints])


sensor = SimpleNamespace(name="Kinect v2", body=KINECT_V2, intrinsics=None)
addresses = ZenohAddresses(connect=(sys.argv[2],))
with KinectSensor(StreamType.BODY) as kinect, FramePublisher(sys.argv[1], addresses, sensor) as publisher:
    for seen in kinect.poll_frames():
        people = {str(person.tracking_id): skeleton(person) for person in seen.tracked_bodies}
        publisher.publish(SensorFrame(seen.relative_time_ns, people, host_ns=time.perf_counter_ns()))
