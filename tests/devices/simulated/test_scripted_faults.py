"""Faults of a simulated tracker at given times."""

from dataclasses import replace

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, Scene, SimulatedKinect, movement
from devices.simulated.rig import Rig
from devices.simulated.tracking.scripted_faults import ScriptedFaults, Spells
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import BODIES, KINECT_V2
from fusion.skeleton import TrackingState

ONCE = Spells(1.0, 1.0)


def frames(script, body, errors=None):
    scene = Scene(movement("startup"), body, seconds=3.0, seed=3)
    # Without lost people there is a skeleton in each frame.
    errors = errors or replace(TrackerErrors.of(body), lost=0.0)
    sensor = SimulatedKinect(scene, Rig(), 0, errors=errors, script=script)
    return [frame.people[PERSON] for frame in sensor.frames()]


def test_spells_repeat_and_begin_before_they_end():
    spells = Spells(1.0, 0.5, 4.0)
    at = [0.9, 1.0, 1.4, 1.5, 4.9, 5.0, 5.6]
    assert [spells.include(time) for time in at] == [False, True, True, False, False, True, False]
    assert spells.starts_before(5.4) == [1.0]
    assert spells.starts_before(5.5) == [1.0, 5.0]
    assert spells.starts_before(1.4) == []
    assert Spells(1.0, 0.5).starts_before(1e6) == [1.0]


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_a_misplaced_arm_is_tracked_at_a_wrong_place_and_nothing_else_changes(body):
    script = ScriptedFaults(body, misplaced=(ONCE,))
    arm = script.misplaces(1_500_000_000)
    assert {body.joints[j].lower().replace("_", "") for j in np.flatnonzero(arm)} >= {
        "elbowleft",
        "wristleft",
    }
    assert not any("right" in body.joints[j].lower() for j in np.flatnonzero(arm))
    # A perfect tracker but for the snap: what differs is what the script does.
    perfect = replace(TrackerErrors(), snap=0.6)
    plain, told = frames(None, body, perfect), frames(script, body, perfect)
    off = np.array(
        [np.linalg.norm(t.positions - p.positions, axis=1) for t, p in zip(told, plain, strict=True)]
    )
    time = np.array([skeleton.time_ns for skeleton in plain]) * 1e-9
    assert off[time < 1.0].max() == 0.0
    assert off[:, ~arm].max() == 0.0
    assert off[(time > 1.5) & (time < 2.0)][:, body.joint("WRIST_LEFT")].min() > 0.1
    states = np.array([skeleton.states for skeleton in told])
    assert (states[(time >= 1.0) & (time < 2.0)] == TrackingState.TRACKED).all()
    # the transition has a time constant of 0.08 s: 1 cm of at most 1 m is left after 0.37 s
    assert off[time > 2.4].max() < 0.01


def test_a_mirrored_person_has_left_and_right_exchanged_for_the_spell():
    body = KINECT_V2
    perfect = TrackerErrors()
    plain = frames(None, body, perfect)
    told = frames(ScriptedFaults(body, mirrored=(ONCE,)), body, perfect)
    knees = [body.joint("KNEE_LEFT"), body.joint("KNEE_RIGHT")]
    for one, other in zip(told, plain, strict=True):
        seconds = one.time_ns * 1e-9
        if seconds < 1.0:
            np.testing.assert_array_equal(one.positions, other.positions)
        elif 1.3 < seconds < 2.0:  # after the change of labels, 0.25 s
            np.testing.assert_allclose(one.positions[knees], other.positions[knees[::-1]], atol=0.05)
