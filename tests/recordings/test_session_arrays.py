"""Per-frame figures: declared once, in memory, file and checksum; and what is derived from them."""

import copy
import itertools
import weakref
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from devices.findings.finding import WORDS as FOUND
from devices.findings.finding import word_of
from devices.findings.rules import RULES
from fusion.body import BODIES, KINECT_V1, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair, nearer
from fusion.support.medians import median_of_known
from recordings.data import layout
from recordings.data.frame_fields import JOINTS, FrameField, no_joint_or_joint
from recordings.data.interpolation import positions_at, sigma_at
from recordings.data.session_arrays import FRAME_FIELDS, SessionArrays
from recordings.errors import RecordingError
from recordings.fusing.pairs import fuse_one
from recordings.quality.doubtful_time import doubtful_seconds, seen_people
from recordings.quality.per_second import SecondQuality, good_spans, merged_by_word
from recordings.session import Session
from tests.helpers.captures import Capture, captures
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_with_a_gap
from tests.helpers.recalibrated import record_recalibrated
from tests.helpers.two_views import calibration_of

J = len(KINECT_V1)
SIGMA = FrameField(
    layout.FUSED_SKELETON, "sigma_mm", np.float16, shape=(JOINTS,), optional=True, scale=1e3
)  # fmt: skip


@given(hnp.arrays(np.float64, (3, J), elements=st.floats(0.0, 10.0)))
def test_a_scaled_figure_has_the_same_checksum_before_and_after_the_file(sigma):
    stored = SIGMA.to_file(KINECT_V1, sigma)
    back = SIGMA.from_file(KINECT_V1, stored)
    np.testing.assert_array_equal(SIGMA.checked(KINECT_V1, sigma), SIGMA.checked(KINECT_V1, back))
    np.testing.assert_allclose(back, sigma, rtol=2.0**-11, atol=2.0**-25 * 1e-3)  # of float16


def test_metres_are_stored_as_millimetres():
    assert SIGMA.to_file(KINECT_V1, np.full((1, J), 0.025))[0, 0] == np.float16(25.0)


def test_no_joint_is_the_last_name():
    spec = FRAME_FIELDS["misleading"]
    values = np.array([[-1, *range(J - 1)]], dtype=np.int32)
    stored = spec.to_file(KINECT_V1, values)
    assert spec.in_arrow(KINECT_V1, stored).to_pylist() == ["none", *KINECT_V1.joints[:-1]]
    np.testing.assert_array_equal(spec.from_file(KINECT_V1, stored), values)
    assert no_joint_or_joint(KINECT_V1)[-1] == "none"


def test_frames_without_a_value_have_the_absent_one_and_none_at_all_is_none():
    one = np.full(J, 0.01)
    stacked = SIGMA.stacked(KINECT_V1, [None, one])
    assert np.isnan(stacked[0]).all()
    np.testing.assert_array_equal(stacked[1], one)
    assert SIGMA.stacked(KINECT_V1, [None, None]) is None


def test_figures_that_share_a_component_are_neither_optional_nor_of_two_types():
    shared = {}
    for spec in FRAME_FIELDS.values():
        shared.setdefault((spec.entity, spec.component), []).append(spec)
    for specs in shared.values():
        assert len(specs) == 1 or not any(spec.optional for spec in specs)
        assert len({spec.stored for spec in specs}) == 1


def test_disagreement_is_the_median_over_the_joints_that_both_see():
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    frames = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 30)]
    rows = SessionArrays.stack(KINECT_V1, KINECT_V1.nominal_lengths, frames)
    positions = rows.positions_a.copy()
    for t in range(len(rows)):
        positions[t, : t % (len(KINECT_V1) + 1)] = np.nan  # of 0 to all joints
    some = replace(rows, positions_a=positions)
    seen = [d[~np.isnan(d)] for d in some.view_difference]
    assert {len(d) for d in seen} >= {0, 1, 2, 3, 4}
    wanted = [np.median(d) if len(d) else np.nan for d in seen]
    np.testing.assert_array_equal(some.disagreement, wanted)


@given(st.lists(st.slices(30), max_size=3))
def test_what_was_computed_of_all_frames_is_that_of_some(cuts):
    """Also of some of some, and of a copy; it cannot be written."""
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    frames = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 30, no_b=(3, 4))]
    rows = SessionArrays.stack(KINECT_V1, KINECT_V1.nominal_lengths, frames)
    flagged = replace(rows, exchanged=np.arange(60).reshape(30, 2).astype(np.int8) % 3)
    for name in ("disagreement", "corrected"):
        some = flagged
        for cut in cuts:
            getattr(some, name)
            some = some[cut]
        for each in (some, copy.deepcopy(some)):
            np.testing.assert_array_equal(getattr(each, name), getattr(replace(some), name))
            assert not getattr(each, name).flags.writeable


def test_depth_errors_that_a_calibration_states_are_no_difference_of_the_views(tmp_path):
    exact, far = calibration_of(KINECT_V1), 0.05
    pairs = frame_pairs(KINECT_V1, 8, noise=0.0)
    views = [
        SkeletonPair(
            *(Skeleton.of(KINECT_V1, nearer(of.positions, -far), of.states, of.time_ns) for of in (p.a, p.b)),
            p.time_ns,
        )
        for p in (pair.skeletons for pair in pairs)
    ]
    for errors in ((0.0, 0.0), (far, far)):
        setup = FusionSetup(replace(exact, depth_errors=np.array(errors)))
        fuser = Fuser(setup)
        frames = [fuse_one(fuser, replace(p, skeletons=v)) for p, v in zip(pairs, views, strict=True)]
        session = Session.of([(setup, frames)], ("a", "b"))
        session.save(tmp_path / "s.rrd")
        for rows in (session.rows, Session.open(tmp_path / "s.rrd").rows):
            assert (np.nanmedian(rows.disagreement) < 1e-4) == bool(errors[0])


def test_stacking_keeps_what_the_loop_gave():
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    frames = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 20, only_a=(0,), noise=0.0)]
    rows = SessionArrays.stack(KINECT_V1, KINECT_V1.nominal_lengths, frames)
    assert len(rows) == 20
    assert np.isnan(rows.positions_b[0]).all()
    assert (rows.states_b[0] == 0).all()
    assert (rows.fused[3] == frames[3].fused.positions).all()
    assert rows.time_ns[-1] == frames[-1].pair.time_ns
    # without noise S_B in A's frame equals S_A, to float32
    both = np.isfinite(rows.b_in_a) & np.isfinite(rows.positions_a)
    assert both[1:].mean() > 0.9
    np.testing.assert_allclose(rows.b_in_a[both], rows.positions_a[both], atol=3e-6)
    assert rows.disagreement[1:].max() < 3e-6
    assert np.isnan(rows.disagreement[0])
    assert rows.bone_error.max() < 1e-9


def test_a_session_of_frames_is_theirs_and_does_not_keep_them():
    setup = FusionSetup(calibration_of(KINECT_V1))
    fuser = Fuser(setup)
    made = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 60, only_a=(0,), no_b=(20,))]
    alive = []
    most = 0

    def passing():
        nonlocal most
        for number in range(1000):
            frame = replace(made[number % 60])
            alive.append(weakref.ref(frame))
            most = max(most, sum(one() is not None for one in alive))
            yield frame

    session = Session.of([(setup, passing())])
    assert most <= 302  # the block, and the frame that is made
    whole = SessionArrays.stack(
        KINECT_V1, setup.calibration.bone_lengths, [made[k % 60] for k in range(1000)]
    )
    for name, _, values in whole.figures():
        np.testing.assert_array_equal(getattr(session.rows, name), values)
    np.testing.assert_array_equal(session.rows.frame, whole.frame)
    np.testing.assert_array_equal(session.rows.time_ns, whole.time_ns)
    np.testing.assert_array_equal(session.bone_lengths, whole.bone_lengths)


def test_the_median_of_what_is_known_is_that_of_numpy():
    values = np.random.default_rng(3).normal(size=(200, 6, 3))
    values[values > 0.5] = np.nan
    some = np.isfinite(values).any(axis=1)
    assert not some.all()
    found = median_of_known(values)
    assert np.isnan(found[~some]).all()
    filled = np.where(some[:, None], values, 0.0)
    np.testing.assert_array_equal(found[some], np.nanmedian(filled, axis=1)[some])


# --- S* between the frames of a session.


@pytest.fixture
def session(request, tmp_path):
    return record_with_a_gap(tmp_path / "s.rrd", getattr(request, "param", KINECT_V2))


def test_bones_beside_a_new_calibration_are_those_of_the_frame_before(tmp_path):
    first = calibration_of(KINECT_V2)
    longer = replace(first, bone_lengths=1.1 * first.bone_lengths)
    pairs = frame_pairs(KINECT_V2, 30)
    session = record_recalibrated(tmp_path / "s.rrd", pairs, [(0, first), (12, longer), (20, first)])
    rows, bones = session.rows, KINECT_V2.bone_joints
    times = np.linspace(0, rows.time_ns[-1], 200, endpoint=False).astype(np.int64)
    before = np.searchsorted(rows.time_ns, times, side="right") - 1
    lengths = bone_lengths_of(KINECT_V2, session.at(1e-9 * times))
    np.testing.assert_allclose(lengths[:, bones], rows.bone_lengths[before][:, bones], atol=1e-6)


@pytest.mark.parametrize("session", BODIES.values(), indirect=True, ids=str)
def test_s_star_between_two_frames_keeps_its_bones_and_turns_evenly(session):
    rows, body = session.rows, session.body
    before = int(np.flatnonzero(np.isfinite(rows.fused).all(axis=(1, 2)))[3])
    first_ns, last_ns = rows.time_ns[before : before + 2]
    times = np.linspace(first_ns, last_ns, 5).astype(np.int64)
    found = session.at(1e-9 * times)
    np.testing.assert_array_equal(found[[0, -1]], rows.fused[[before, before + 1]])
    lengths = bone_lengths_of(body, found)[:, body.bone_joints]
    np.testing.assert_allclose(
        lengths, rows.bone_lengths[[before]][:, body.bone_joints].repeat(5, 0), atol=1e-6
    )
    joint = body.bone_joints[0]
    bones = found[:, joint] - found[:, body.parents[joint]]
    turned = [np.linalg.norm(np.cross(u, v)) for u, v in itertools.pairwise(bones)]
    np.testing.assert_allclose(turned, turned[0], rtol=0.02)
    outside = np.array([rows.time_ns[0] - 1, rows.time_ns[-1] + 1]).astype("timedelta64[ns]")
    assert np.isnan(session.at(outside)).all()
    assert np.isnan(session.at([np.nan, -0.1, session.time[-1] + 60.0])).all()
    moments = [*times.astype("timedelta64[ns]"), np.timedelta64("NaT")]
    np.testing.assert_array_equal(session.at(moments), [*found, np.full_like(found[0], np.nan)])


def test_times_that_cannot_be_meant_are_refused(session):
    with pytest.raises(RecordingError, match=r"got an array of \(2, 2\)"):
        session.at([[0, 1], [2, 3]])
    for wrong in ("1", None, ["1", "2"], True):
        with pytest.raises(RecordingError, match="Times are seconds since the first frame; got an array of"):
            session.sigma_at(wrong)
    for far in (session.time_ns, np.inf, -1e300, 10**9, np.timedelta64(3, "D")):
        with pytest.raises(RecordingError, match=r"s is days away from a session of .* np\.timedelta64"):
            session.at(far)


def test_bones_that_turn_round_between_frames_are_somewhere(session):
    """Half-way between opposite directions there is no direction."""
    fused = session.rows.fused[[30, 30]]
    root = session.body.root
    fused[1] = 2.0 * fused[1, root] - fused[1]
    rows = replace(session.rows[np.array([0, 1])], time_ns=np.array([0, 20_000_000]), fused=fused)
    assert np.isfinite(positions_at(rows, np.array([0, 5_000_000, 10_000_000, 15_000_000, 20_000_000]))).all()


def test_the_uncertainty_between_frames_covers_what_interpolation_misses(session):
    rows = session.rows
    every, few = np.arange(0, 24), np.arange(0, 24, 6)
    angle = 0.1 * every  # radians: one metre about a centre
    circle = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=-1)[:, None]
    chosen = rows[every]
    chosen = replace(
        chosen,
        time_ns=every * 33_333_333,
        fused=rows.fused[[30]] - rows.fused[30, rows.body.root] + circle,
        sigma=np.full_like(chosen.filled("sigma"), 0.001),
    )
    root, times = rows.body.root, chosen.time_ns[9:15]
    missed = np.linalg.norm(positions_at(chosen[few], times) - chosen.fused[9:15], axis=2)[:, root]
    np.testing.assert_allclose(sigma_at(chosen[few], times)[:, root], np.hypot(0.001, missed), rtol=0.1)
    np.testing.assert_allclose(sigma_at(chosen, chosen.time_ns), 0.001, rtol=1e-6)
    assert np.isnan(session.sigma_at([-1])).all()


@given(*[st.floats(0.001, 0.5)] * 2, st.floats(0.0, 1.0))
def test_between_two_frames_of_somebody_still_the_variance_goes_from_one_to_the_other(first, second, share):
    rows = still_rows()
    sigma = np.stack([np.full(rows.sigma.shape[1], each) for each in (first, second)])
    found = sigma_at(replace(rows, sigma=sigma), np.array([round(share * 20_000_000)]))
    np.testing.assert_allclose(found, np.sqrt((1.0 - share) * first**2 + share * second**2), rtol=1e-4)


@cache
def still_rows():
    with TemporaryDirectory() as folder:
        rows = record_with_a_gap(Path(folder) / "s.rrd", KINECT_V2).rows[np.array([30, 30])]
    return replace(rows, time_ns=np.array([0, 20_000_000]))


# --- Laws of the quality of each second, and of the time that is doubtful.


WORDS = "good", "usable", "poor"
HALF = (0.0, 0.5), (1.0, 1.8)
words = st.sampled_from(WORDS)


@given(st.lists(st.tuples(words, st.sampled_from(("", "one view alone", "no frame"))), min_size=1))
def test_merged_seconds_have_the_words_of_each_and_no_reason_that_one_lacks(of):
    seconds = [SecondQuality(float(k), *each) for k, each in enumerate(of)]
    merged = merged_by_word(seconds)
    assert all(one.word != other.word for one, other in pairwise(merged))
    for second in seconds:
        (*_, held) = (each for each in merged if each.start <= second.start)
        assert held.word == second.word
        assert held.reason in ("", second.reason)
    runs_of_one = [each for each in merged if [s.word for s in seconds].count(each.word) == 1]
    assert all(each in seconds for each in runs_of_one)


RATES = st.sampled_from((5.0, 8.0, 10.0, 15.0, 25.0, 30.0, 50.0)).map(lambda rate: (rate, rate))


@given(captures(rates=RATES, seconds=st.integers(1, 5).map(float)), st.booleans())
@example(Capture(rates=(25.0, 25.0), calibrated_s=0.5), False)
@example(Capture(rates=(25.0, 25.0), present=(((0.0, 9.0),), HALF)), False)
def test_a_second_is_as_good_as_the_worst_share_of_its_frames(capture, without_feet):
    """Of nobody, of frames before the calibration and of one view alone; the first of the worst is told.

    A limb that nobody ever saw is not uncertain, and counts for no expected error.
    """
    session, rate = capture.session(), int(capture.rates[0])
    if without_feet:
        session = session_without_feet(session)
    times = capture.times(0)
    a, b = (capture.sees(side, times) for side in (0, 1))
    first = min(int(np.searchsorted(times, 1e9 * capture.calibrated_s)), len(times) - 1)
    shares = np.stack([~(a | b), np.arange(len(times)) < first, a ^ b]).reshape(3, -1, rate).mean(axis=2)
    assume(np.abs(np.subtract.outer(shares, (0.1, 0.5))).min() > 1e-6)
    assert len(session.quality_per_second) == capture.seconds
    for second, (nobody, uncalibrated, alone) in zip(session.quality_per_second, shares.T, strict=True):
        reasons = (
            (word_of(RULES["nobody"], 100 * nobody), f"nobody is in view for {100 * nobody:.0f} % of it"),
            (
                word_of(RULES["doubtful"], 100 * alone),
                f"one view alone has the person for {100 * alone:.0f} % of it",
            ),
            ("unknown" if uncalibrated > 0.1 else "good", "before the calibration"),
        )
        word, reason = max(reasons, key=lambda each: FOUND.index(each[0]))
        told = "poor" if word == "unknown" else word
        assert second[1:] == (told, "" if word == "good" else reason)


@given(
    captures(rates=RATES).map(lambda each: replace(each, calibrated_s=0.0)),
    st.floats(0.0, 5.0),
    st.floats(0.2, 30.0),
    st.sampled_from(((), (0,), (1,), None)),
)
@example(Capture(seconds=2.0), 2.0, 60.0, ())
@example(Capture(seconds=2.0, present=(((0.0, 9.0),), HALF)), 1.0, 4.0, ())
@example(Capture(seconds=2.0), 1.0, 6.0, None)
def test_no_time_that_is_added_makes_a_better_word(capture, at, lasts, seen_by):
    """With nobody in view, with one view alone, or without frames, anywhere."""
    at = min(at, capture.seconds)
    present = tuple(
        (
            *((begin, min(end, at)) for begin, end in spans if begin < at),
            *((max(begin, at) + lasts, end + lasts) for begin, end in spans if end > at),
            *[(at, at + lasts)] * (seen_by is not None and side in seen_by),
        )
        for side, spans in enumerate(capture.present)
    )
    longer = replace(capture, seconds=capture.seconds + lasts, present=present).session()
    if seen_by is None:
        kept = (longer.time < at) | (longer.time >= at + lasts)
        longer = longer.part(np.flatnonzero(kept))
    before, after = capture.session().verdict, longer.verdict
    assert FOUND.index(before.word) <= FOUND.index(after.word), (before, after)


def session_without_feet(session):
    """That nobody ever saw; S* guesses them."""
    rows = session.rows
    feet = [k for k, name in enumerate(rows.body.joints) if "ankle" in name.lower() or "foot" in name.lower()]
    states, sigma = [each.copy() for each in (rows.states_a, rows.states_b)], rows.sigma.copy()
    for each in states:
        each[:, feet] = 0
    sigma[:, feet] = 0.3
    return replace(session, rows=replace(rows, states_a=states[0], states_b=states[1], sigma=sigma))


@given(
    captures(rates=RATES), st.lists(words, min_size=7, max_size=7), st.sampled_from((0, 3_600_000_000_000))
)
def test_good_spans_are_the_good_seconds_and_seconds_of_doubt_those_of_the_frames(capture, judged, gap_ns):
    """Whatever gap follows the third frame: somebody is seen for three frames of it."""
    session = capture.session()
    rows, rate = session.rows, capture.rates[0]
    end = session.time[-1] + (1.0 / rate if len(rows) > 1 else 0.0)
    seconds = [SecondQuality(float(k), word, "") for k, word in enumerate(judged) if k < end or not k]
    spans = good_spans(session, seconds)
    assert all(0.0 <= one.start <= one.end <= end + 1e-9 for one in spans)
    assert all(one.end < other.start for one, other in pairwise(spans))
    for k, second in enumerate(seconds):
        inside = [span for span in spans if span.start <= k < span.end or span.start == k]
        assert bool(inside) == (second.word == "good")
    later = np.where(np.arange(len(rows)) > 2, gap_ns, 0)
    moved = replace(rows, time_ns=rows.time_ns + later)
    found = doubtful_seconds(moved, 0, seen_people(moved))
    usual = 1.0 / rate if len(rows) > 1 else 0.0
    assert found["all"] == pytest.approx((moved.time_ns[-1] - moved.time_ns[0]) * 1e-9 + usual)
    assert found["one_view"] <= found["doubtful"] <= found["seen"] <= len(rows) * usual + 2.01 * usual
    assert found["limb_uncertain"] <= found["doubtful"]
