"""Two sensors of your own in the live loop: python own_sensor.py"""

import time

from devices import Sensor, SensorFrame, simulated_pair
from fusion import KINECT_V2, Skeleton
from recordings import fuse_live


class OwnSensor(Sensor):
    body = KINECT_V2

    def __init__(self, name, camera):
        self.name, self.camera = name, camera

    def __enter__(self):  # open your camera here
        return self

    def __exit__(self, *error): ...  # and close it here
    def frames(self):  # wait for your camera here; a simulated one stands in for it
        for seen in self.camera.frames():
            time.sleep(1 / 30)
            yield SensorFrame(seen.time_ns, {"1": Skeleton.of(KINECT_V2, seen.people["1"].positions)})


left, right, _ = simulated_pair(motion="walk", seconds=5.0, body=KINECT_V2)
frames = fuse_live(OwnSensor("left", left), OwnSensor("right", right), keep=True)
for frame in frames:
    print("head at", frame.fused.positions[KINECT_V2.joint("Head")].round(3), "m")
print(frames.session)  # frames.session.save("own.rrd") writes it
