"""R and t by the surface in live depth images: which moments are kept, and what they give."""

from concurrent.futures import Future, wait
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from devices.simulated.kinect import simulated_pair
from fusion.body import AZURE_KINECT as BODY
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.calibration.online import CalibrationLearner
from fusion.intrinsics import Intrinsics
from fusion.setup import FusionSetup
from recordings.fusing.live_surface import LiveSurface
from recordings.live_fusion import LiveFusion
from tests.helpers.demonstrations import pairs_of
from tests.helpers.frame_pairs import KnownSensors, frame_pairs
from tests.helpers.two_views import A_FROM_B

CAMERA = Intrinsics(32, 24, 20.0, 20.0, 16.0, 12.0)
SECOND = 1_000_000_000


class Never:
    """Keeps what is submitted, and never runs it."""

    def __init__(self):
        self.submitted = []

    def submit(self, _, *arguments):
        self.submitted.append(arguments)
        return Future()


def learner():
    return CalibrationLearner(BODY, Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known"))


@given(data=st.data(), rate=st.integers(10, 60))
@settings(max_examples=10)
def test_a_moment_is_one_of_its_second_with_both_views_all_around(data, rate):
    pairs = frame_pairs(BODY, 6 * rate, depth=True)
    gone = data.draw(st.sets(st.integers(0, len(pairs) - 1), max_size=4))
    gone |= set(range(0, len(pairs), 2)) if data.draw(st.booleans()) else set()  # B at half the rate
    times = [round(k * SECOND / rate) for k in range(len(pairs))]
    for k, time_ns in enumerate(times):
        pair = replace(pairs[k], skeletons=replace(pairs[k].skeletons, time_ns=time_ns))
        pairs[k] = replace(pair, skeletons=replace(pair.skeletons, b=None)) if k in gone else pair
    executor = Never()
    surface, known = LiveSurface(BODY, (CAMERA, CAMERA), executor=executor), learner()
    for pair in pairs:
        assert surface.observe(pair, known) == []
    ((moments, _),) = executor.submitted  # the fit has not ended
    assert len(moments) == 4
    middles = [moment.pairs[3] for moment in moments]
    assert all(middles[k + 2].time_ns - middles[k].time_ns >= SECOND for k in range(2))
    for moment, middle in zip(moments, middles, strict=True):
        k = times.index(middle.time_ns)
        assert all(pair.a is not None and pair.b is not None for pair in moment.pairs)
        assert moment.images[0] is pairs[k].a.depth
        assert moment.images[1] is pairs[k].b.depth


def test_who_is_seen_from_two_sides_is_where_the_surface_is():
    """The trackers shift the joints along their rays; the images do not."""
    a, b, truth = simulated_pair(depth="half", seconds=10.0, seed=914, body=BODY, motion="walk")
    setup = FusionSetup(nominal_calibration(BODY), None, a.intrinsics, b.intrinsics)
    pairs = list(pairs_of(a, b))
    off, texts = [], []
    for cameras in ((None, None), (a.intrinsics, b.intrinsics)):
        fusion = LiveFusion(setup)
        for frame in fusion.frames(KnownSensors(pairs, cameras=cameras)):
            texts += [event.text for event in fusion.learn(frame)]
            if fusion._surface is not None and fusion._surface._fit is not None:
                wait([fusion._surface._fit[1]])
        found = fusion.setup.calibration.a_from_b
        there = truth.positions_at(np.array([pairs[-1].time_ns]))[0].mean(axis=0)
        off.append(np.linalg.norm(found.apply(truth.a_from_b.inverse().apply(there)) - there))
    assert sum("by the surface that both sensors see" in text for text in texts) >= 1
    assert off[1] < 0.7 * off[0]


def test_without_images_nothing_is_fitted():
    executor = Never()
    surface, known = LiveSurface(BODY, (CAMERA, CAMERA), executor=executor), learner()
    for pair in frame_pairs(BODY, 200):
        assert surface.observe(pair, known) == []
    assert executor.submitted == []
