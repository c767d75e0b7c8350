"""Events where a view reports a limb at a wrong place and S* follows the other view."""

import numpy as np
import pytest

from devices.events import Event
from fusion.body import KINECT_V2
from fusion.fused_frame import FusedFrame
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from recordings.fusing.view_events import ViewEvents
from tests.helpers.two_views import A_FROM_B, FRAME_NS, standing

BODY = KINECT_V2
ARM = [BODY.joint(f"{name}_LEFT") for name in ("ELBOW", "WRIST", "HAND")]


def told_of(
    wrong_frames, *, sensor="B", off=0.5, share=0.0, joints=3, state=TrackingState.TRACKED, exchanged=0
):
    """The events, with their frames, of a view whose left arm is wrong from frame 10 on."""
    views_of, truth = ViewEvents(BODY), standing(BODY)
    told = []
    for k in range(90):
        wrong = 10 <= k < 10 + wrong_frames
        shift, weights, states = np.zeros((len(BODY), 3)), np.full(len(BODY), 0.5), np.full(len(BODY), 2)
        if wrong:
            shift[ARM[:joints], 1], weights[ARM], states[ARM] = off, share, state
        views = {"A": truth.copy(), "B": truth.copy()}
        views[sensor] += shift
        whole = np.full(len(BODY), TrackingState.TRACKED)
        pair = SkeletonPair(
            Skeleton.of(BODY, views["A"], states if sensor == "A" else whole, k * FRAME_NS),
            Skeleton.of(BODY, A_FROM_B.inverse().apply(views["B"]), states if sensor == "B" else whole, 0),
            k * FRAME_NS,
        )
        fused = FusedFrame(
            truth, np.zeros(len(BODY), bool), weights if sensor == "A" else 1.0 - weights,
            weights if sensor == "B" else 1.0 - weights, np.full(len(BODY), -1), A_FROM_B, 1, False, False,
            k * FRAME_NS, exchanged_a=exchanged, exchanged_b=exchanged,
        )  # fmt: skip
        told += [(k, each) for each in views_of.observe(pair, fused)]
    return told


@pytest.mark.parametrize(("sensor", "other"), [("A", "B"), ("B", "A")])
def test_a_lost_arm_is_told_with_its_distance_and_its_end(sensor, other):
    (begun, start), (ended, end) = told_of(30, sensor=sensor)
    text = f"{sensor} loses the left arm, 0.5 m off; S* follows {other}."
    assert start == Event(text, "INFO", f"lost_{sensor.lower()}_left_arm", "start")
    assert begun == 10 + 16  # 15 intervals of 33.3 ms are just short of half a second
    # 30 frames are 29 intervals; 0.2 s later it is certain
    assert end == Event(f"{sensor} finds the left arm again, after 1.0 s.", "INFO", start.topic, "end")
    assert ended == 39 + 7


def test_what_is_short_near_counted_guessed_single_or_exchanged_is_no_lost_limb():
    assert told_of(30) != []
    assert told_of(14) == []
    assert told_of(30, off=0.15) == []
    assert told_of(30, share=0.2) == []
    assert told_of(30, state=TrackingState.INFERRED) == []
    assert told_of(30, joints=1) == []
    exchanged = told_of(30, exchanged=3)
    assert [event.topic for _, event in exchanged] == ["exchanged_a", "exchanged_b"]
