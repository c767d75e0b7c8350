"""The tracker on real people before a real depth camera, against marks made by hand."""

import numpy as np
import pytest

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.settings import BlazePoseSettings
from devices.depth.camera import project
from fusion.body import BLAZEPOSE
from tests.helpers.machine import need_networks
from tests.helpers.real_people import CAMERA, clip, marks

STATURE = 1.70  # metres; the men's is unknown. Their error in pixels is stated as a share of it.
LENGTHS_VARY = 0.12  # standard deviation of a bone's length over a clip, as a share of its mean
GOAL = 0.04  # of the stature: the project's


@pytest.fixture(scope="session")
def real_images(shared):
    """The folder of the clips; without it the test is skipped."""
    folder = shared / "real_images"
    if not folder.is_dir():
        pytest.skip(f"no images of real people at {folder}")
    return folder


def tracked(folder, wanted):
    """(image, skeleton) of each image of a clip."""
    with BlazePose(BlazePoseSettings(models=need_networks(), person=wanted)) as tracker:
        for image in clip(folder):
            people = tracker.track(image.color, image.depth, CAMERA, image.time_ns)
            assert len(people) == 1
            yield image, next(iter(people.values()))


def misses(folder, wanted, person):
    """Distances of the joints from the marks on visible joints, as shares of the person's height."""
    by_hand = marks(folder.name, person)
    found = []
    for image, skeleton in tracked(folder, wanted):
        visible = {joint: at for joint, (at, seen) in by_hand.get(image.frame, {}).items() if seen}
        pixels = project(CAMERA, skeleton.positions)
        trunk = [at for joint, at in visible.items() if joint.startswith(("SHOULDER", "HIP"))]
        for joint, at in visible.items():
            depths = [0.001 * image.depth[tuple(np.rint(place[::-1]).astype(int))] for place in trunk]
            height = CAMERA.fy * STATURE / float(np.median(depths))
            found.append(float(np.linalg.norm(pixels[BLAZEPOSE.joint(joint)] - at)) / height)
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "wanted", "person", "marked"),
    [
        ("pointing", "middle", "seated", 104),
        ("standing_and_seated", "middle", "seated", 99),
        ("standing_and_seated", "left", "seated", 99),
        ("standing_and_seated", "right", "standing", 32),
        ("standing_and_seated", "nearest", "standing", 32),
    ],
)
def test_joints_are_within_a_twenty_fifth_of_the_height_of_marks_made_by_hand(
    real_images, name, wanted, person, marked
):
    """The mean meets the goal; some joints miss it: a hip under a jacket, an arm behind the trunk."""
    found = misses(real_images / name, wanted, person)
    assert len(found) == marked
    assert found.mean() < 0.025
    assert (found < GOAL).mean() > 0.8


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("pointing", "middle"), ("standing_and_seated", "left"), ("standing_and_seated", "right")],
)
def test_bones_of_a_person_keep_their_lengths(real_images, name, wanted):
    """Without learned lengths an upper arm that points at the sensor varies by 25 %."""
    positions = np.array([skeleton.positions for _, skeleton in tracked(real_images / name, wanted)])
    joint = BLAZEPOSE.joint
    for near, far in (("SHOULDER", "ELBOW"), ("ELBOW", "WRIST"), ("HIP", "KNEE"), ("KNEE", "ANKLE")):
        for side in ("LEFT", "RIGHT"):
            bones = positions[:, joint(f"{far}_{side}")] - positions[:, joint(f"{near}_{side}")]
            lengths = np.linalg.norm(bones, axis=1)
            assert lengths.std() < LENGTHS_VARY * lengths.mean(), (near, side)
