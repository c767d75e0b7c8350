"""Laws of joining images to moments, and of what a stream tells."""

from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from devices.capture.causes import Cause
from devices.capture.clock.moments import ImageJoiner, Incomplete, Moment
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.settings import CaptureSettings
from devices.capture.stream_health import ImageHealth, Losses, Silence
from devices.sensor import DeviceError

PERIOD_NS = 33_333_333
HALF_NS = PERIOD_NS // 2
WAIT_NS = 180_000_000

streams = st.fixed_dictionaries(
    {
        "offset": st.integers(-HALF_NS // 2, HALF_NS // 2),
        "latency": st.integers(0, 300_000_000),
        "every": st.sampled_from((0.5, 1, 2, 3)),
        "lost": st.sets(st.integers(0, 120)),
        "from": st.integers(0, 90),
        "until": st.integers(30, 200),
    }
)


def _arrivals(count, lost, others):
    """Depth and the images of other streams, in the order in which they come."""
    depth = [(k * PERIOD_NS + 15_000_000, 1, "depth", k * PERIOD_NS) for k in range(count) if k not in lost]
    for name, of in others.items():
        numbers = [round(k * of["every"], 3) for k in range(int(count / of["every"]))]
        for number in numbers:
            if number not in of["lost"] and of["from"] <= number < of["until"]:
                time_ns = round(number * PERIOD_NS) + of["offset"]
                depth.append((time_ns + of["latency"], 0, name, time_ns))
    return sorted(depth)


_WHOLE = {"offset": 0, "latency": 0, "every": 0.5, "lost": set(), "from": 0, "until": 200}


@given(st.integers(5, 150), st.sets(st.integers(0, 150)), streams, streams)
# depth is lost while a depth image waits for infrared that has ended: its colour image must be kept
@example(39, {0, 36, 37}, _WHOLE | {"until": 30}, _WHOLE)
def test_every_depth_image_comes_once_in_order_in_bounded_time_with_the_nearest_images(count, lost, a, b):
    others = {"infrared": a, "color": b}
    joiner = ImageJoiner(PERIOD_NS, **{name: round(of["every"] * PERIOD_NS) for name, of in others.items()})
    found, came, held = [], {"infrared": [], "color": []}, 0
    times = []
    for now_ns, _, name, time_ns in _arrivals(count, lost, others):
        if name == "depth":
            times.append(time_ns)
            joiner.add_depth(time_ns, now_ns, time_ns, now_ns)
        else:
            came[name].append(time_ns)
            joiner.add(name, time_ns, time_ns)
        while (moment := joiner.take()) is not None:
            found.append(moment)
            for image in came:
                given_ns, near = (
                    getattr(moment, image),
                    [t for t in came[image] if abs(t - moment.time_ns) <= HALF_NS],
                )
                assert (given_ns is None) == (image in moment.lacks)
                assert given_ns is None or abs(given_ns - moment.time_ns) == min(
                    abs(t - moment.time_ns) for t in near
                )
        held = max(held, len(times) - len(found))
    joiner.flush()
    while (moment := joiner.take()) is not None:
        found.append(moment)
    assert [moment.time_ns for moment in found] == times
    assert held <= 2 + WAIT_NS // PERIOD_NS


@given(st.integers(0, 150_000_000), st.integers(-HALF_NS, HALF_NS))
def test_an_image_of_the_same_rate_that_comes_in_time_is_never_missed(latency, offset):
    of = {"offset": offset, "latency": latency, "every": 1, "lost": (), "from": 0, "until": 99}
    joiner = ImageJoiner(PERIOD_NS, color=PERIOD_NS)
    found = []
    for now_ns, _, name, time_ns in _arrivals(90, (), {"color": of}):
        if name == "depth":
            joiner.add_depth(time_ns, now_ns, None, now_ns)
        else:
            joiner.add(name, time_ns, time_ns)
        while (moment := joiner.take()) is not None:
            found.append(moment)
    assert len(found) > 80
    assert all(abs(moment.color - moment.time_ns) <= HALF_NS for moment in found)


@given(st.integers(-(10**15), 10**15), st.integers(0, 60))
def test_a_clock_that_starts_anew_loses_no_depth_and_joins_no_old_image(jump_ns, before):
    joiner, found = ImageJoiner(PERIOD_NS, color=PERIOD_NS), []
    for k in range(120):
        at_ns = k * PERIOD_NS + (jump_ns if k >= before else 0)
        joiner.add_depth(at_ns, k, k, k)
        joiner.add("color", at_ns, k)
        while (moment := joiner.take()) is not None:
            found.append(moment)
    joiner.flush()
    while (moment := joiner.take()) is not None:
        found.append(moment)
    assert [moment.depth for moment in found] == list(range(120))
    assert all(moment.color in (None, moment.depth, moment.depth - 1) for moment in found)
    assert sum(moment.color is None for moment in found) <= 1 + WAIT_NS // PERIOD_NS


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 40)), min_size=1), st.booleans())
def test_silence_ends_with_any_moment(polls, subordinate):
    sync = "subordinate" if subordinate else "standalone"
    silence = Silence("X 1", CaptureSettings(sync=sync, stall_s=5.0, start_s=30.0))
    waited, started = 0.0, False
    for came, tenths in polls:
        if came:
            silence.ends()
            waited, started = 0.0, True
            continue
        waited += tenths / 10
        limit_s = 5.0 if started or not subordinate else 30.0
        if waited >= limit_s + 1e-9:
            with pytest.raises(DeviceError):
                silence.lasts(tenths / 10, Incomplete.NOTHING, "")
            return
        if waited > limit_s - 1e-9:
            return  # rounding decides
        silence.lasts(tenths / 10, Incomplete.NOTHING, "")
        assert (silence.waits_for != "") == (waited > 0 and subordinate and not started)


GAPS = st.one_of(st.integers(0, 20), st.integers(50, 70))


@given(st.lists(st.tuples(GAPS, st.integers(0, 1500)), min_size=2, max_size=60))
def test_each_gap_is_lost_or_missed_by_where_the_reader_was(steps):
    """One of two seconds is a silence, which is told otherwise."""
    counts = SimpleNamespace(lost=0, missed=0)
    losses, at = Losses(counts, 30, FrameDecimation(30)), 0
    lost = missed = 0
    losses.count(Moment(0, 0, None), 0)
    losses.gave = True
    for gap, away_ms in steps:
        losses.away(away_ms * 1_000_000)
        at += 1 + gap
        losses.count(Moment(at * PERIOD_NS, 0, None), at)
        lost += gap * (away_ms < 100) * (gap < 60)
        missed += gap * (away_ms >= 100) * (gap < 60)
    assert (counts.lost, counts.missed) == (lost, missed)


@given(st.integers(0, 200), st.sampled_from((5, 15, 30)), st.sampled_from((2, 3)))
def test_a_change_is_told_within_three_seconds_and_once(fine, fps, every):
    health = ImageHealth("X 1", "color", CaptureSettings(color="720P", fps=fps), needed=False)
    told = []
    for k in range(fine + 20 * fps):
        told += [(k - fine, text) for text in health.told(k >= fine and k % every != 0, 0)]
    ((when, text),) = told
    assert 0 <= when <= 3 * fps
    assert f"gives {fps / every:.3g} colour images per second, not {fps}" in text or fps == 5
    assert Cause.FEW_IMAGES.value.split("{why}")[0].split("; ")[1].split("{")[0] in text
