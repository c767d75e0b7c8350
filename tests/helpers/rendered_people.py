"""Infrared and depth images of simulated people, for tests of the body tracker."""

import numpy as np
from numpy.typing import NDArray

from devices.simulated.imaging.body_surface import flesh_over, visibility
from devices.simulated.imaging.infrared import InfraredModel, clothed_capsules, infrared_image, materials
from devices.simulated.imaging.rendering import DepthErrors, depth_image, surface
from devices.simulated.kinect import simulated_pair
from devices.simulated.person import anatomy
from devices.simulated.rig import Rig
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics

CAMERA = Intrinsics(640, 576, 504.0, 504.0, 319.5, 287.5)
"""The depth camera of an Azure Kinect in the mode NFOV_UNBINNED."""
WIDE = Intrinsics(512, 512, 252.0, 252.0, 255.5, 255.5, (0.5, -0.02, 2e-4, -1e-4, -0.003, 0.9, 0.09, -0.014))
"""One with a lens as in the mode WFOV_2X2BINNED."""
FRAME_NS = 33_333_333

Images = tuple[NDArray[np.uint16], NDArray[np.uint16]]


def landmarks_at(motion, seconds, angle_deg=90.0):
    """(N, 3) the simulated person's landmarks in sensor A's frame, metres."""
    _, _, truth = simulated_pair(motion=motion, angle_deg=angle_deg)
    in_world = truth.scene.motion.landmarks([seconds])[0]
    return truth.rig.world_from_sensor(0).inverse().apply(in_world)


def images_of(people, seed=0, sizes=(), angle_deg=90.0, camera=CAMERA):
    """Infrared and depth of people with these landmarks, before the simulator's wall and floor.

    Args:
        people: (N, 3) landmarks in the sensor's frame; no one for an empty room.
        seed: Of the noise.
        sizes: Stature of each person, metres; 1.75 if empty.
        angle_deg: Angle between the rig's sensors, of which the images are A's.
        camera: The depth camera.
    """
    statures = sizes or [anatomy.REFERENCE_HEIGHT] * len(people)
    shapes = [clothed_capsules(marks, size) for marks, size in zip(people, statures, strict=True)]
    capsules = np.concatenate(shapes) if shapes else np.empty((0, 7))
    sensor_from_world = Rig(angle_deg=angle_deg).world_from_sensor(0).inverse()
    z, label, cosine = surface(capsules, sensor_from_world, camera)
    model, random = InfraredModel(), np.random.default_rng(seed)
    kinds = np.tile(materials(), max(1, len(people)))
    infrared = infrared_image(z, label, cosine, kinds, model.illumination(camera), model, random)
    return infrared, depth_image(z, cosine, DepthErrors(), random)


def true_joints(landmarks):
    """(J, 3) the joints of the body ``blazepose`` of a person with these landmarks."""
    return landmarks[anatomy.landmarks_of(BLAZEPOSE)]


def share_seen(landmarks, camera=CAMERA):
    """(J,) share of each joint's surface that nothing hides from the sensor."""
    return visibility(true_joints(landmarks), clothed_capsules(landmarks), flesh_over(BLAZEPOSE), camera)
