"""Claims about the simulated infrared images and the dressed person in them."""

import numpy as np
import pytest

from devices.simulated.imaging.body_surface import capsules
from devices.simulated.imaging.infrared import (
    REFLECTANCE,
    InfraredModel,
    Material,
    clothed_capsules,
    infrared_image,
)
from devices.simulated.imaging.rendering import FLOOR, NOTHING, WALL, surface
from devices.simulated.person.movements import MOTIONS
from devices.simulated.rig import Rig
from fusion.intrinsics import NOMINAL_INTRINSICS

LENS = NOMINAL_INTRINSICS["azure_kinect"]
SILENT = InfraredModel(read_noise=0.0, shot_noise=0.0)
NO_CAPSULES = np.zeros(0, np.int8)


def exposed(z, cosine, label, model=SILENT):
    """An image of one surface that fills the view."""
    size = (LENS.height, LENS.width)
    surface = np.full(size, z, np.float32), np.full(size, label, np.int8), np.full(size, cosine, np.float32)
    return infrared_image(*surface, NO_CAPSULES, model.illumination(LENS), model, np.random.default_rng(0))


def test_brightness_follows_from_material_distance_angle_and_place_in_the_image():
    middle = round(LENS.cy), round(LENS.cx)
    gain, wall = SILENT.gain, float(REFLECTANCE[Material.WALL])
    # Rounding to whole counts; the middle pixel is half a pixel off the axis.
    assert exposed(1.0, 1.0, WALL)[middle] == pytest.approx(gain * wall, abs=0.6)
    assert exposed(2.0, 1.0, WALL)[middle] == pytest.approx(gain * wall / 4.0, abs=0.6)
    assert exposed(2.0, 0.5, WALL)[middle] == pytest.approx(gain * wall / 8.0, abs=0.6)
    floor = float(REFLECTANCE[Material.FLOOR])
    assert exposed(2.0, 1.0, FLOOR)[middle] == pytest.approx(gain * floor / 4.0, abs=0.6)
    assert not exposed(2.0, 1.0, NOTHING).any()
    # A corner is farther away than z, and the illuminator is weaker there.
    x, y = -LENS.cx / LENS.fx, -LENS.cy / LENS.fy
    cosine = 1.0 / np.sqrt(1.0 + x * x + y * y)
    corner = gain * wall * cosine**2 * cosine**SILENT.vignetting
    assert exposed(1.0, 1.0, WALL)[0, 0] == pytest.approx(corner, abs=0.6)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(("name", "time"), [("startup", 1.0), ("arms", 6.9), ("walk", 8.6), ("sit", 8.0)])
def test_the_dressed_surface_lies_about_the_plain_one(name, time, which):
    """Depth differs by clothes and fingers only: the tracker's errors were fitted to the plain surface."""
    sensor_from_world = Rig().world_from_sensor(which).inverse()
    marks = sensor_from_world.apply(MOTIONS[name].landmarks(time)[0])
    plain, plain_label, _ = surface(capsules(marks), sensor_from_world, LENS)
    dressed, dressed_label, _ = surface(clothed_capsules(marks), sensor_from_world, LENS)
    both = (plain_label >= 0) & (dressed_label >= 0)
    assert both.sum() > 0.9 * (plain_label >= 0).sum()
    # Sleeves and trousers are at most 15 mm thicker than the limb in them.
    assert np.percentile(np.abs(plain - dressed)[both], 90) < 0.020
