"""An avatar that VMC moves, in pixiv's three-vrm: its limbs point where those of S* do."""

import numpy as np
import pytest

from fusion.body import BODIES
from tests.helpers.avatars import BEGINS, PARENTS, bones, write_figure
from tests.helpers.poses import DOWN, FRONT, LEFT, RIGHT, T_POSE, UP, posed
from tests.helpers.three_vrm import avatar_page
from tests.helpers.two_views import FRAME_NS, moving
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.avatars.vrm import read_avatar

POSES = {
    "arms_down": dict.fromkeys(
        (f"{joint}{side}" for joint in ("Elbow", "Wrist", "Hand") for side in ("Left", "Right")), DOWN
    ),
    "greets": {
        "ElbowRight": RIGHT,
        "WristRight": UP,
        "HandRight": UP,
        **dict.fromkeys(("ElbowLeft", "WristLeft", "HandLeft"), DOWN),
    },
    "steps": {
        "KneeLeft": FRONT,
        "AnkleLeft": DOWN,
        **dict.fromkeys(("ElbowRight", "WristRight", "HandRight"), FRONT),
        **dict.fromkeys(("ElbowLeft", "WristLeft", "HandLeft"), LEFT),
    },
}
LIMBS = [(above, name) for name, above in PARENTS.items() if above in BEGINS and name in BEGINS]


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_limbs_of_an_avatar_point_where_those_of_the_person_do(body, tmp_path):
    """The avatar has other proportions: legs are a third longer, arms a quarter shorter."""
    rest = {name: at for name, (at, _) in bones(VmcEncoder(body).encode(posed(body, T_POSE), 0)).items()}
    for name in rest:
        rest[name] = rest[name] * (
            1.33 if "Leg" in name or "Foot" in name else 0.75 if "Arm" in name else 1.0
        )
    rest["Hips"][1] *= 1.33
    path = write_figure(tmp_path / "boxes.vrm", rest)
    encoder = VmcEncoder(body, read_avatar(path))
    poses = {name: posed(body, directions) for name, directions in POSES.items()}
    every = [*poses.items(), *((None, joints) for joints in moving(body, 60)[::12])]
    with avatar_page(path) as page:
        for number, (picture, joints) in enumerate(every):
            sent = bones(encoder.encode(joints, number * 30 * FRAME_NS))
            told = [(name, at.tolist(), turn.tolist()) for name, (at, turn) in sent.items()]
            found = {name: np.array(at) for name, at in page.evaluate("bones => pose(bones)", told).items()}
            for above, name in LIMBS:
                limb = found[name] - found[above]
                begin, end = (joints[body.joint(BEGINS[bone])] for bone in (above, name))
                person = (end - begin) * [1.0, -1.0, -1.0]  # y up, z towards the sensor
                lengths = np.linalg.norm(limb), np.linalg.norm(person)
                # VMC has float32, three.js matrices of float32: 1e-5 of each of six bones
                np.testing.assert_allclose(limb / lengths[0], person / lengths[1], atol=6e-5, err_msg=name)
                np.testing.assert_allclose(lengths[0], np.linalg.norm(rest[name]), rtol=6e-5)
            if picture:
                page.screenshot(path=str(tmp_path / f"{picture}.png"))
