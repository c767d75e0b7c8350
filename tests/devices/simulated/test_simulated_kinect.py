"""Claims about the simulated pair: the truth, the rig, the clocks, and repeatability."""

from dataclasses import replace

import numpy as np
import pytest

from devices.sensor import DeviceError
from devices.simulated.kinect import PERSON, Truth, TruthAhead, simulated_pair
from devices.simulated.rig import Rig
from devices.simulated.streams import Streams
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import BODIES

# A coordinate below 4 m is rounded to float32 by at most 2⁻²³ m.
ROUNDED = 2.0**-23 * 1.01


def same(one, other):
    return (
        one.time_ns == other.time_ns
        and one.people.keys() == other.people.keys()
        and all(one.people[k].repeats(other.people[k]) for k in one.people)
        and np.array_equal(one.depth, other.depth)
        and np.array_equal(one.ir, other.ir)
    )


@pytest.mark.parametrize(
    ("body", "angle_deg"), list(zip(BODIES.values(), (0.0, 40.0, 90.0, 180.0), strict=True)), ids=str
)
def test_without_errors_both_views_are_the_truth(body, angle_deg):
    rig = Rig(angle_deg=angle_deg, skew_seconds=0.004)
    a, b, truth = simulated_pair(
        motion="walk", body=body, seconds=1.0, rig=rig, height=1.6, errors=TrackerErrors()
    )
    for which, sensor in enumerate((a, b)):
        skeletons = [frame.people[PERSON] for frame in sensor.frames()]
        assert all(s.tracked.all() for s in skeletons)
        when = [round(rig.captured_at(which, k) * 1e9) for k in range(len(skeletons))]
        true = truth.positions_at(when)
        if which == 1:
            true = truth.a_from_b.inverse().apply(true)
        assert np.abs(np.stack([s.positions for s in skeletons]) - true).max() < ROUNDED


def test_the_person_faces_between_the_sensors_and_sees_b_on_the_left():
    rig = Rig(angle_deg=90.0)
    facing = np.array((0.0, 0.0, -1.0))
    for which, side in ((0, -1.0), (1, 1.0)):
        position = rig.world_from_sensor(which).translation
        assert np.sign(position[0]) == side  # the person's left is +x
        assert np.hypot(position[0], position[2]) == pytest.approx(rig.distance)
        to_sensor = np.array((position[0], 0.0, position[2])) / rig.distance
        assert np.degrees(np.arccos(to_sensor @ facing)) == pytest.approx(45.0)
        # It looks at the person: the origin lies on its vertical middle plane, before it.
        origin = rig.world_from_sensor(which).inverse().apply(np.zeros(3))
        assert origin[0] == pytest.approx(0.0, abs=1e-12)
        assert origin[2] > 2.0


@pytest.mark.parametrize("which", [0, 1])
def test_each_sensor_may_stand_lean_and_roll_as_it_does(which):
    rig = Rig(distance=(2.0, 3.1), height=(1.6, 0.7), tilt_deg=(15.0, -3.0), roll_deg=(-6.0, 20.0))
    pose = rig.world_from_sensor(which)
    assert np.hypot(*pose.translation[[0, 2]]) == pytest.approx(rig.distance[which])
    assert -pose.translation[1] == pytest.approx(rig.height[which])
    right, _, ahead = pose.rotation.T
    assert np.degrees(np.arcsin(ahead[1])) == pytest.approx(rig.tilt_deg[which])  # down
    roll = np.radians(rig.roll_deg[which])
    assert right[1] == pytest.approx(np.sin(roll) * np.hypot(ahead[0], ahead[2]))
    a, b, truth = simulated_pair(motion="walk", seconds=0.5, rig=rig, errors=TrackerErrors())
    joints = next((a, b)[which].frames()).people[PERSON].positions
    true = (rig.world_from_sensor(which).inverse() @ rig.world_from_sensor(0)).apply(
        truth.positions_at(round(rig.captured_at(which, 0) * 1e9))
    )
    assert np.abs(joints - true).max() < ROUNDED


def test_no_seed_of_one_sensor_is_that_of_the_other():
    """Seed 2³² of A drew what seed 0 of B draws."""
    keys = [(seed, which) for seed in (0, 1, 2**32, 2**64, 2**96) for which in (0, 1)]
    drawn = [Streams(*key).named(name).random() for key in keys for name in ("bias", "jitter")]
    assert len(set(drawn)) == len(drawn)


def test_the_same_seed_makes_the_same_frames_bit_for_bit():
    def frames(seed):
        a, b, _ = simulated_pair(motion="arms", seed=seed, seconds=0.1, depth="half", infrared=True)
        return [*a.frames(), *b.frames()]

    first = frames(3)
    assert all(map(same, first, frames(3)))
    assert not any(map(same, first, frames(4)))


def test_images_change_no_skeleton():
    options = {}, {"depth": "half"}, {"depth": "half", "infrared": True}
    views = [list(simulated_pair(seed=6, seconds=0.5, **images)[0].frames()) for images in options]
    assert len(views[0]) == 15
    for without, depth, infrared in zip(*views, strict=True):
        assert same(replace(depth, depth=None), without)
        assert same(replace(infrared, depth=None, ir=None), without)
        assert depth.people[PERSON].witness is not None
        assert depth.ir is None
        assert (infrared.ir.shape, infrared.ir.dtype) == (infrared.depth.shape, np.uint16)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"motion": "flying"}, "walk"),
        ({"angle_deg": 270.0}, "angle"),
        ({"height": 17.0}, "height"),
        ({"seed": -1}, "seed"),
        ({"depth": "tiny"}, "half"),
        ({"depth": "none", "infrared": True}, "depth"),
    ],
)
def test_senseless_options_are_refused_with_advice(options, message):
    with pytest.raises(DeviceError, match=message):
        simulated_pair(**options)
    with pytest.raises(DeviceError, match="distance"):
        Rig(distance=0.1)


def test_the_truth_ahead_is_the_truth_a_second_at_a_time(monkeypatch):
    a, _, truth = simulated_pair(motion="badminton", seconds=3.0)
    times = [frame.time_ns for frame in a.frames()]
    times[50:50] = [times[50] - 7_000_000]  # a pair without A's frame
    exact = truth.positions_at(times)
    asked = []
    real = Truth.positions_at
    monkeypatch.setattr(Truth, "positions_at", lambda self, when: (asked.append(when), real(self, when))[1])
    ahead = TruthAhead(truth)
    np.testing.assert_array_equal([ahead(time) for time in times], exact)
    assert len(asked) < len(times) / 10
