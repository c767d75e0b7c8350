"""Two depth cameras of any make, with the program's own body tracker: python any_depth_camera.py

It needs the tracker's networks: duplex tracker fetch.
"""

import time

from devices import DepthCamera, simulated_pair
from fusion import BLAZEPOSE
from recordings import fuse_live

*cameras, _ = simulated_pair(motion="walk", seconds=5.0, depth="half", infrared=True)


def images_of(camera):  # your camera's library here; a simulated one stands in for it
    def images():
        for shot in camera.frames():
            time.sleep(1 / 30)
            # Infrared, or RGB registered to depth: both images must have the same pixels.
            yield shot.depth, shot.ir, shot.time_ns

    return images


left, right = (
    DepthCamera(name, images_of(camera), camera.intrinsics)
    for name, camera in zip(("left", "right"), cameras, strict=True)
)
for frame in fuse_live(left, right):
    print("head at", frame.fused.positions[BLAZEPOSE.joint("HEAD")].round(3), "m")
