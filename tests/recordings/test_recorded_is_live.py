"""A live run, and the same frames as a recording holds them, give the same pairs, S* and events."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from devices.capture.stream_pairing import LivePairing
from devices.frame_pairs import PERSON
from devices.pairing import pair_views
from fusion.calibration.calibration import nominal_calibration
from fusion.pair_arrays import View
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import Skeleton
from recordings.fusing.pairs import fuse_segments
from recordings.fusing.view_events import watch
from recordings.live_fusion import LiveFusion
from tests.helpers.laws import BODY, HIDDEN, exchanged, hidden, walking
from tests.helpers.two_clocks import SECOND_NS, run, shots
from tests.helpers.two_views import A_FROM_B, standing

BEGINS_S, STANDS_S, SECONDS = 2.0, 4.0, 8.0
"""From when on somebody is seen, and walks: the clocks are known to be one by then."""
SPELLS = st.lists(
    st.tuples(
        st.sampled_from("ab"), st.sampled_from(("nobody", "arm", "half", "exchanged", "elsewhere")),
        st.floats(0.0, SECONDS), st.floats(0.05, 2.0),
    ),
    max_size=4,
)  # fmt: skip
"""View, what is wrong in it, and from when on for how long, seconds."""


def seen(side, seconds, spells, random):
    """The skeleton of a view; None where it sees nobody."""
    if seconds < BEGINS_S:
        return None
    at = standing(BODY) if seconds < STANDS_S else walking(seconds - STANDS_S)[0]
    at = at + random.normal(0.0, 0.004, at.shape)
    skeleton = Skeleton.of(BODY, A_FROM_B.inverse().apply(at) if side == "b" else at)
    for _, what, *_ in (of for of in spells if of[0] == side and of[2] <= seconds < of[2] + of[3]):
        if what == "nobody":
            return None
        if what == "exchanged":
            skeleton = exchanged(skeleton)
        elif what == "elsewhere":
            positions = skeleton.positions.copy()
            positions[HIDDEN["arm"]] += np.float32(0.4)
            skeleton = Skeleton.of(BODY, positions)
        else:
            skeleton = hidden(skeleton, HIDDEN[what])
    return skeleton


def facts(pairs):
    """Of each pair: time since the first, skew, and the own times of its frames."""
    first_ns = pairs[0].time_ns
    return [(of.time_ns - first_ns, of.skew_ns, of.a and of.a.time_ns, of.b and of.b.time_ns) for of in pairs]


@given(
    fps=st.sampled_from((15, 30, 60)),
    lost=st.sampled_from((0.0, 0.1, 0.4)),
    late_ms=st.tuples(st.integers(0, 120), st.integers(0, 120)),
    phase=st.floats(-0.4, 0.4),
    clock_s=st.sampled_from((0, 1_000, -7)),
    spells=SPELLS,
    seed=st.integers(0, 999),
)
def test_the_frames_of_a_live_run_give_its_pairs_its_s_star_and_its_events(
    fps, lost, late_ms, phase, clock_s, spells, seed
):
    """On a cable, whose own times are of one clock; with the run's calibrations, and no later frames.

    What a file of skeletons with times does not hold: which frames came too late, what arrivals told of the
    clocks before they were known to be one, and how the calibrations were learned.
    """
    random = np.random.default_rng(seed)
    streams = []
    delay_ns = round(1e9 * phase / fps)
    for side, ms, phase_ns in zip("ab", late_ms, (0, delay_ns), strict=True):
        how = {"fps": fps, "phase_ns": phase_ns, "latency_ns": 20_000_000 + 1_000_000 * ms}
        made = []
        for shot in shots(side, SECONDS, clock_ns=clock_s * SECOND_NS, seed=seed, **how):
            if random.random() < lost:
                continue
            person = seen(side, 1e-9 * shot.true_ns - 5.0, spells, random)
            made.append(replace(shot, frame=replace(shot.frame, people={PERSON: person} if person else {})))
        streams.append(made)
    setup = FusionSetup(nominal_calibration(BODY), FuserSettings(hindsight="none"))
    fusion, live, setups, told = LiveFusion(setup), [], [], []
    for pair in run(LivePairing(round(1e9 / fps), sync_delay_ns=delay_ns), *streams):
        live.append(fusion.fuse(fusion.chosen(pair)))
        setups.append(fusion.setup)
        told += [(len(live) - 1, event.text) for event in fusion.learn(live[-1]) if event.topic]
    first = next(k for k, of in enumerate(live) if of.pair.skeletons.a or of.pair.skeletons.b)
    live, setups = live[first:], setups[first:]
    told = [(k - first, text) for k, text in told]
    views = []
    for side in "ab":
        given = [
            (frame, getattr(of.pair.skeletons, side)) for of in live if (frame := getattr(of.pair, side))
        ]
        none = np.full((len(BODY), 3), np.nan, np.float32), np.zeros(len(BODY), np.uint8)
        arrays = zip(*(none if of is None else (of.positions, of.states) for _, of in given), strict=True)
        times = np.array([frame.time_ns for frame, _ in given], dtype=np.int64)
        views.append(View(times, *map(np.stack, arrays)))
    pairs = pair_views(BODY, *views, every_frame=True).pairs
    assert facts(pairs) == facts([of.pair for of in live])
    begins = [k for k in range(len(live)) if k == 0 or setups[k] is not setups[k - 1]]
    ends = [*begins[1:], len(live)]
    segments = [(setups[k], slice(k, end)) for k, end in zip(begins, ends, strict=True)]
    events = []
    blocks = list(watch(BODY, fuse_segments(segments, pairs), int(pairs.skeletons.time_ns[0]), events))
    for name in ("positions", "sigma", "weights_a", "weights_b"):
        recorded = np.concatenate([getattr(block.fused, name) for block in blocks])
        np.testing.assert_array_equal(recorded, [getattr(of.fused, name) for of in live], name)
    assert [(event.frame, event.text) for event in events if event.topic] == told
