"""Fuses skeletons from numpy arrays, frame by frame: python frame_by_frame.py

Replace `points_a` and `points_b` by your own: (frames, joints, 3) in metres, each in its sensor's frame
(x right, y down, z forward), with the joints in the order of `KINECT_V2.joints`. NaN marks a joint that
was not seen.
"""

import numpy as np

from devices import simulated_pair
from fusion import KINECT_V2, Fuser, FusionSetup, Skeleton, SkeletonPair, calibrate

camera_a, camera_b, _ = simulated_pair(motion="walk", seconds=4.0, body=KINECT_V2)
points_a = np.array([frame.people["1"].positions for frame in camera_a.frames()])
points_b = np.array([frame.people["1"].positions for frame in camera_b.frames()])

pairs = [
    SkeletonPair(Skeleton.of(KINECT_V2, p), Skeleton.of(KINECT_V2, q), time_ns=k * 33_333_333)
    for k, (p, q) in enumerate(zip(points_a, points_b, strict=True))
]
calibration = calibrate(KINECT_V2, pairs[:60], "the first two seconds")
fuser = Fuser(FusionSetup(calibration))
for pair in pairs:
    fused = fuser.update(pair)
    wrist = fused.positions[KINECT_V2.joint("WristRight")]
    print(f"{pair.time_ns * 1e-9:5.2f} s: right wrist at {wrist.round(3)} m")
