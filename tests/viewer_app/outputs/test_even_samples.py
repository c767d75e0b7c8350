"""S* at a constant rate from uneven frames."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.calibration.bone_lengths import bone_lengths_of
from tests.helpers.live_frames import frames
from viewer_app.outputs.even_samples import EvenSamples
from viewer_app.sinks.item_queue import QueuedFrame

MS = 1_000_000


def queued(fuser, times_ms, delays_ms):
    """Frames at uneven times whose root moves at 1 m/s along x."""
    made = frames(fuser, 2)[-1]
    for k, (time_ms, delay_ms) in enumerate(zip(times_ms, delays_ms, strict=True)):
        at = made.fused.positions + (1e-3 * time_ms, 0.0, 0.0)
        fused = replace(made.fused, positions=at, velocities=np.full_like(at, 0.0) + (1.0, 0.0, 0.0))
        yield QueuedFrame(k, replace(made, fused=fused), time_ms * MS, (time_ms + delay_ms) * MS)


def test_samples_are_even_and_predicted_whatever_the_frames_do(fuser):
    body = fuser.setup.body
    even = EvenSamples(body, 100.0)
    given = list(queued(fuser, (0, 33, 40, 67, 100), (20, 20, 24, 50, 21)))
    samples = []
    for now_ms in range(130):
        new = [frame for frame in given if frame.written_ns == now_ms * MS]
        samples += even.passed_on(new, now_ms * MS)
        wait_s = even.wait_s(now_ms * MS)
        assert (wait_s is None) == (now_ms < 20)
        assert wait_s is None or 0.0 < wait_s <= 0.01
    assert [sample.time_ns for sample in samples] == [k * 10 * MS for k in range(len(samples))]
    # the least delay is 20 ms: at 129 ms the moment 100 ms is there
    assert samples[-1].time_ns == 100 * MS
    x = [sample.fused.positions[body.root, 0] for sample in samples]
    np.testing.assert_allclose(np.diff(x), 0.01, atol=1e-9)
    for sample in samples:
        lengths = [bone_lengths_of(body, at.positions) for at in (sample.fused, given[0].fused)]
        np.testing.assert_allclose(*lengths, atol=1e-9)


def test_nothing_is_sent_long_after_the_last_frame(fuser):
    even = EvenSamples(fuser.setup.body, 50.0)
    (frame,) = queued(fuser, (0,), (0,))
    sent = even.passed_on([frame], 0) + even.passed_on([], 10_000 * MS)
    assert [sample.number for sample in sent] == [0]
    assert even.wait_s(10_000 * MS) is None


def test_a_turning_bone_keeps_its_length(fuser):
    fused = frames(fuser, 30)[-1].fused
    body = fuser.setup.body
    velocities = np.random.default_rng(1).normal(0.0, 2.0, fused.positions.shape)
    later = replace(fused, velocities=velocities).predicted_for(body, 0.05)
    lengths = [bone_lengths_of(body, at) for at in (later.positions, fused.positions)]
    np.testing.assert_allclose(*lengths, atol=1e-12)
    root = body.root
    assert later.positions[root] - fused.positions[root] == pytest.approx(0.05 * velocities[root])
