"""Joint angles for the viewer's plots: those of a session, with their variance, and what no joint reaches."""

import re
from collections import Counter
from dataclasses import replace
from uuid import uuid4

import numpy as np
import pytest
import rerun as rr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.depth.image_thinning import pair_without_images
from devices.events import Event
from devices.frame_pairs import PairingFigures
from devices.sensor import ColorCamera, ColorImage
from fusion.calibration.calibration import Calibration
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.movement.angles import ANGLES
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton
from recordings.appearance.coach_page import CoachPage, Mark
from recordings.appearance.state_card import State
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.file.rrd_file import RrdFile, read_columns
from recordings.fusing.pairs import fuse_one
from recordings.quality.limits import PLOTTED_DEGREES, POSSIBLE
from recordings.session import Session
from recordings.writing import changes
from recordings.writing.arrow_columns import Column, Times, converted, depth_image, points, state_changes
from recordings.writing.other_people import OthersLog
from recordings.writing.shown_images import LATE_NS
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.laws import COSTLY
from tests.helpers.live_frames import BODY, frames, known_fuser, session
from tests.helpers.recalibrated import record_recalibrated, recorder_to
from tests.helpers.session_text import logged_in
from tests.helpers.two_views import A_FROM_B, FRAME_NS, standing


@pytest.fixture(scope="module")
def fuser_and_frames():
    fuser = known_fuser()
    return fuser, frames(fuser, 20)


@pytest.mark.parametrize("reached", [True, False])
def test_the_plots_have_the_sessions_angles(fuser_and_frames, tmp_path, monkeypatch, reached):
    if not reached:
        monkeypatch.setitem(POSSIBLE, "elbow_flexion", (1000.0, 1001.0))
        monkeypatch.setitem(PLOTTED_DEGREES, "elbow_flexion", (100.0, 200.0))
    fuser, made = fuser_and_frames
    with session(fuser, tmp_path / "s.rrd") as live:
        for frame in made:
            live.write(frame)
    angles = Session.open(tmp_path / "s.rrd").angles
    places = (
        (layout.ANGLES, layout.DEGREES),
        (layout.ANGLES, layout.VARIANCES),
        (layout.ANGLES_BEYOND, layout.DEGREES),
    )
    wanted = {(entity, f"{component}.{name}") for entity, component in places for name in ANGLES}
    found = read_columns(tmp_path / "s.rrd", wanted).values
    for component, expected in ((layout.DEGREES, angles.degrees), (layout.VARIANCES, angles.sigma**2)):
        for k, name in enumerate(ANGLES):
            numbers, values = found[layout.ANGLES, f"{component}.{name}"]
            np.testing.assert_allclose(values[:, 0], expected[numbers, k], rtol=1e-3, atol=1e-2)
    marked = found.get((layout.ANGLES_BEYOND, f"{layout.DEGREES}.elbow_flexion_left"))
    assert (marked is None) == reached
    if marked is not None:
        numbers, values = marked
        assert numbers.tolist() == list(range(0, 20, 2))
        assert ((values > 100.0) & (values < 110.0)).all()  # on the screen, at the edge nearest to the angle
        _, others = found[layout.ANGLES_BEYOND, f"{layout.DEGREES}.knee_flexion_left"]
        assert np.isnan(others).all()


# --- A viewer gets each image with the skeleton of its own moment, and none that is late.


COLOR = ColorImage(b"\xff\xd8\xff\xd9", ColorCamera(NOMINAL_INTRINSICS[BODY.name], RigidTransform.identity()))
FRAMES = 40
IMAGES = {"depth": ("DepthImage:buffer", layout.depth), "color": ("EncodedImage:blob", layout.color)}
STREAKS = st.lists(st.tuples(st.booleans(), st.integers(1, 14)), min_size=1, max_size=8)
"""Whether something is there, and for how many frames; repeated."""


@pytest.fixture(scope="module")
def made():
    """Frames with depth images, and the fuser that made them."""
    fuser = known_fuser()
    return fuser, frames(fuser, FRAMES, depth=True)


def there(streaks):
    return np.resize(np.repeat(*zip(*streaks, strict=True)), FRAMES)


def seen(sensor_frame, depth, color):
    return replace(sensor_frame, depth=sensor_frame.depth if depth else None, color=COLOR if color else None)


def messages(path, fuser, given_frames, block):
    """Frame numbers by entity and component, of all that a viewer gets."""
    with recorder_to(path, fuser.setup, depth_every=1, points=True) as recorder:
        for k in range(0, len(given_frames), block):
            recorder.record_all(given_frames[k : k + block])
    found = {}
    with RrdFile(path) as file:
        for entity, batch in file.chunks(images=True):
            if "time" in batch.schema.names:
                times = batch.column("time").cast("int64").to_pylist()
                for name in batch.schema.names:
                    found.setdefault((entity, name), []).extend(times)
    return found


@given(st.lists(STREAKS, min_size=4, max_size=4), STREAKS, st.sampled_from([1, 4]))
def test_what_is_on_the_screen_is_of_one_moment(made, tmp_path_factory, images, kept, block):
    fuser, all_frames = made
    depth_a, color_a, depth_b, color_b = map(there, images)
    some = [
        replace(
            each,
            pair=replace(
                each.pair,
                a=seen(each.pair.a, depth_a[k], color_a[k]),
                b=seen(each.pair.b, depth_b[k], color_b[k]),
            ),
        )
        for k, each in enumerate(all_frames)
        if k == 0 or there(kept)[k]  # of the others, a slow viewer gets nothing
    ]
    found = messages(tmp_path_factory.mktemp("s") / "s.rrd", fuser, some, block)

    def latest(now_ns, *of):
        return max((at for at in found.get(of, []) if at <= now_ns), default=-1)

    for frame in some:
        now_ns = frame.pair.time_ns
        for side in layout.VIEWS:
            for kind, (component, entity) in IMAGES.items():
                cleared = latest(now_ns, entity(side), "Clear:is_recursive")
                image = latest(now_ns, entity(side), component)
                skeleton = latest(now_ns, layout.image_skeleton(side, kind), "Points3D:positions")
                if image > cleared:
                    assert skeleton == image
                    assert now_ns - image <= LATE_NS
                else:
                    assert skeleton == now_ns
            cleared = latest(now_ns, layout.points(side), "Clear:is_recursive")
            cloud = latest(now_ns, layout.points(side), "Points3D:positions")
            assert cloud <= cleared or now_ns - cloud <= LATE_NS


@pytest.mark.parametrize("shown", [True, False])
def test_every_entity_of_a_session_is_in_the_list(made, tmp_path, shown):
    """So is when it is logged: what never changes is static. A file has nothing that only a viewer has."""
    fuser, some = made
    logged = {}  # by entity: whether something of it is not static
    mark = Mark((((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),), "do", (0.0, 0.0, 0.0))
    with recorder_to(tmp_path / "s.rrd", fuser.setup, depth_every=1, points=shown) as recorder:
        for each in some:
            told = {"truth": each.fused.positions, "streams": PairingFigures()}
            pair = replace(each.pair, a=seen(each.pair.a, True, True))
            recorder.record_all([replace(each, pair=pair, **told)])
        recorder.event(Event("told"))
        recorder.coach(CoachPage("stand here", (("spot", mark),), (State.READY, "walk")))
    with RrdFile(tmp_path / "s.rrd") as file:
        for entity, batch in file.chunks(images=True):
            logged[entity] = logged.get(entity, False) or layout.FRAME in batch.schema.names
    kinds = {
        re.compile(re.sub(r"\\{\d?\\}", "[^/]+", re.escape(path))): of for path, of in layout.ENTITIES.items()
    }
    left = dict(kinds)
    for entity in (entity for entity in logged if not entity.startswith("/__")):
        (declared,) = [of for pattern, of in kinds.items() if pattern.fullmatch(entity)]
        left = {pattern: of for pattern, of in left.items() if of is not declared}
        assert declared.kind != layout.VIEWER or shown or not logged[entity], entity
        assert logged[entity] or declared.logged != "every pair", entity
        assert not (logged[entity] and declared.logged == "once"), entity
    absent = {of.path for of in left.values() if shown or of.kind != layout.VIEWER}
    # of whole sessions; of odd poses; of states that change; of infrared images
    assert absent <= {"/how_good", "/angles/beyond", "/lanes/{1}/{0}", "/kinect_{}/depth/infrared"}


def held_in(path):
    """By entity and component, what holds at each frame; of the events all; of what never changes, that."""
    every, count = {}, len(Session.open(path))
    with RrdFile(path) as file:
        for entity, batch in file.chunks(images=True):
            rows = batch.to_pydict()
            order, frames = batch.column(0).to_pylist(), rows.get(layout.FRAME, [-1] * batch.num_rows)
            for name in () if entity.startswith("/__") else batch.schema.names[1:]:
                if name not in (layout.FRAME, layout.TIME, "log_time", "log_tick"):
                    every.setdefault((entity, name), []).extend(zip(frames, order, rows[name], strict=True))
    held = {}
    for key, values in every.items():
        values.sort(key=lambda value: value[:2])
        at = [[of for frame, _, of in values if frame <= t] for t in range(count)]
        held[key] = [of for *_, of in values] if key[0] == layout.EVENTS else [of[-1:] for of in at]
    return held


def alike(one, other):
    """Whether two values are equal; numbers but for what S* loses in float32, and a step of σ in float16."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(of, other[name]) for name, of in one.items())
    if isinstance(one, list):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, float):
        return bool(np.isclose(one, other, rtol=1e-3, atol=2e-3, equal_nan=True))
    return one == other


FROM_ALL = (layout.FLOOR, layout.ANGLES, layout.ANGLES_BEYOND, layout.SECONDS_LANE)
"""Entities that follow from all frames where they are known: those of a block of a live file know fewer."""
moments = st.integers(0, 14)


@settings(COSTLY)
@given(
    comes=st.tuples(moments, moments), other=st.tuples(moments, moments), color=moments, knocked=moments,
    sizes=st.lists(st.integers(1, 7), min_size=14), rates=st.tuples(moments, moments),
)  # fmt: skip
def test_each_entity_of_a_live_file_is_in_what_is_saved_of_it(
    comes, other, color, knocked, sizes, rates, tmp_path_factory
):
    """Whoever and whatever comes late, and however it was written."""
    folder, count, fuser = tmp_path_factory.mktemp("s"), 14, known_fuser()
    some = frame_pairs(BODY, count, depth=True, no_a=range(min(comes[0], comes[1])), only_a=range(comes[1]))
    with recorder_to(folder / "live.rrd", fuser.setup, depth_every=1) as recorder:
        first = 0
        while first < count:
            block = []
            for k in range(first, min(first + sizes[first], count)):
                pair, a = some[k], some[k].a
                if a is not None and other[0] <= k < sum(other):
                    stranger = Skeleton.of(BODY, standing(BODY) + 1.0, np.full(len(BODY), 2))
                    a = replace(a, people={**a.people, "8": stranger})
                if a is not None and k >= color:
                    a = replace(a, color=COLOR)
                pair = replace(pair, a=a)
                told = PairingFigures(
                    alone_a=k // (1 + rates[0]), dropped=(k // (1 + rates[1]), 0), drift_ppm=k
                )
                block.append(replace(fuse_one(fuser, pair), streams=told if k >= rates[0] else None))
                recorder.record_images(k, block[-1])
            recorder.record_all([replace(of, pair=pair_without_images(of.pair)) for of in block])
            recorder.event(Event(f"after {first}", "WARN"))
            mark = Mark((((0.0, 0.0, 0.0), (1.0, 0.0, float(first))),), "do", (0.0, 0.0, 0.0))
            recorder.coach(CoachPage(f"page {first}", (("spot", mark),) if first % 2 else ()))
            if first <= knocked < first + sizes[first]:
                calibration = replace(fuser.setup.calibration, how="again")
                fuser.recalibrate(FusionSetup(calibration, fuser.setup.settings, *fuser.setup.intrinsics))
                recorder.recalibrated(fuser.setup)
            first += sizes[first]
    Session.open(folder / "live.rrd").save(folder / "once.rrd")
    Session.open(folder / "once.rrd").save(folder / "twice.rrd")
    live, once, twice = (held_in(folder / f"{name}.rrd") for name in ("live", "once", "twice"))
    assert {key for key in live if key[0] not in FROM_ALL} == {key for key in once if key[0] not in FROM_ALL}
    for key in live:
        assert key[0] in FROM_ALL or alike(live[key], once[key]), key
    assert repr(once) == repr(twice)


def test_an_image_stays_until_it_is_late(made, tmp_path):
    fuser, all_frames = made
    some = [replace(each, pair=replace(each.pair, a=seen(each.pair.a, k == 0, False)))
            for k, each in enumerate(all_frames)]  # fmt: skip
    found = messages(tmp_path / "s.rrd", fuser, some, 1)
    late = (LATE_NS // FRAME_NS + 1) * FRAME_NS
    assert found[layout.depth("a"), "Clear:is_recursive"] == [late]
    assert found[layout.image_skeleton("a", "depth"), "Points3D:positions"][:2] == [0, late]


# --- Quality and places in a session: jitter is noise and not motion; a recalibration is one message.


def test_a_moved_sensor_is_one_message_and_is_seen_in_millimetres_and_degrees(tmp_path):
    turned = Rotation.from_euler("y", 3.0, degrees=True).as_matrix()
    # 120 mm in all, along each axis
    shift = np.array([0.04, -0.08, 0.08])
    moved = RigidTransform.of(A_FROM_B.rotation @ turned, A_FROM_B.translation + shift)
    calibrations = [
        (0, Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "first")),
        (40, Calibration(BODY, moved, BODY.nominal_lengths, "second")),
    ]
    file = tmp_path / "s.rrd"
    recorded = record_recalibrated(file, frame_pairs(BODY, 90), calibrations)
    (change,) = np.flatnonzero((np.diff(recorded.translation, axis=0) != 0.0).any(axis=1)) + 1
    assert poses(file, layout.kinect("b")) == [0, change]
    placement = dict(logged_in(file, layout.PLACEMENT, "Scalars:scalars"))
    assert sorted(placement) == [2, *range(17, 90, 15)]  # jitter needs three frames
    before = [figures for frame, figures in placement.items() if frame < 40]
    assert len(before) >= 2
    # arccos near 1 magnifies float64 rounding of the trace to sqrt(2 * 1e-15) rad
    np.testing.assert_allclose(before, 0.0, atol=1e-5)
    np.testing.assert_allclose(placement[max(placement)], [120.0, 3.0], rtol=1e-6)


def poses(path, entity):
    """The frames at which a pose was logged."""
    return sorted(frame for frame, value in logged_in(path, entity, "Transform3D:translation") if value)


def written_live(path, count):
    fuser = known_fuser()
    with session(fuser, path) as live:
        for frame in frames(fuser, count):
            live.write(frame)
    return path


def test_live_and_saved_sessions_log_the_same_poses(tmp_path):
    live = written_live(tmp_path / "live.rrd", 40)
    again = tmp_path / "again.rrd"
    Session.open(live).save(again)
    assert poses(live, layout.kinect("b")) == poses(again, layout.kinect("b")) == [0]
    assert poses(live, layout.PELVIS) == poses(again, layout.PELVIS) == list(range(40))
    assert poses(again, layout.FLOOR)[-1] == 0  # found in the whole recording, shown from its beginning
    assert len(poses(live, layout.FLOOR)) == 2  # assumed, then found


def test_the_pelvis_keeps_its_place_while_nobody_is_seen(tmp_path):
    made = frames(fuser := known_fuser(), 20)
    for nobody in ([3, 4], range(20)):
        for number in nobody:
            gone = np.full_like(made[number].fused.positions, np.nan)
            made[number] = replace(made[number], fused=replace(made[number].fused, positions=gone))
        file = tmp_path / f"{len(nobody)}.rrd"
        with session(fuser, file) as live:
            for frame in made:
                live.write(frame)
        assert poses(file, layout.PELVIS) == sorted({*range(20)} - {*nobody})


def test_the_others_are_drawn_while_they_are_there(tmp_path):
    pairs = frame_pairs(BODY, 12, noise=0.0)
    fuser = known_fuser()
    for t in range(4, 8):
        a = pairs[t].a
        other = Skeleton.of(BODY, a.people["7"].positions + np.float32(1.0), a.people["7"].states)
        pairs[t] = replace(pairs[t], a=replace(a, people={**a.people, "8": other}))
    path = tmp_path / "s.rrd"
    with recorder_to(path, fuser.setup) as recorder:
        recorder.record_all([SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs])
    of_a, of_b = (logged_in(path, layout.others(side), "Arrows3D:origins") for side in "ab")
    drawn = {frame: len(of) for frame, of in of_a}
    assert of_b == []
    assert drawn.keys() == set(range(4, 9))  # the last one clears them
    assert drawn.pop(8) == 0
    assert all(0.5 * len(BODY) < count < len(BODY) for count in drawn.values())
    assert len(Session.open(path)) == 12


def test_a_viewer_s_stream_gets_the_poses_again_and_again(tmp_path, monkeypatch):
    """A hub drops its oldest messages: whoever connects later must find K_B and the floor all the same."""
    monkeypatch.setattr(changes, "_POSE_AGAIN_NS", 990_000_000)  # 30 frames
    fuser = known_fuser()
    made = frames(fuser, 70)
    for with_points, expected in ((True, [0, 30, 60]), (False, [0])):
        path = tmp_path / f"{with_points}.rrd"
        with recorder_to(path, fuser.setup, points=with_points) as recorder:
            for frame in made:
                recorder.record_all([frame])
        assert poses(path, layout.kinect("b")) == expected
        assert set(expected[1:]) <= set(poses(path, layout.FLOOR))


@pytest.mark.parametrize("gap", [10, 60])
def test_the_others_of_a_sensor_that_gives_no_frames_go_after_half_a_second(gap, monkeypatch):
    logged = []
    monkeypatch.setattr(
        OthersLog, "_log", lambda _, side, number, *rest: logged.append((side, number, len(rest[-1])))
    )
    log = OthersLog(rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4()))
    pairs = frame_pairs(BODY, 5, noise=0.0)
    for t in range(5 + gap):
        pair = pairs[min(t, 4)]
        log.record(
            t,
            t * 33_333_333,
            replace(pair, a=pair.a if t < 5 else None, skeletons=replace(pair.skeletons, a=None)),
        )
    of_a = [(number, count > 0) for side, number, count in logged if side == "a"]
    assert of_a == [*((t, True) for t in range(5)), *([(20, False)] if gap > 15 else [])]


# --- What a frame costs a viewer's stream in messages, and columns as Rerun makes them.


COUNT, PLOTTED_TOGETHER = 40, 5


def written(path, plotted_together):
    """A session of which each frame is recorded as it comes, as a viewer's; with 1, as a file's."""
    fuser = known_fuser()
    with recorder_to(path, fuser.setup, depth_every=1, plots_later=plotted_together > 1) as recorder:
        for frame in frames(fuser, COUNT):
            recorder.record_all([frame])
            if recorder.unplotted >= plotted_together:
                recorder.plot()
    return path


def test_plots_in_blocks_lose_nothing(tmp_path):
    one, blocks = (Session.open(written(tmp_path / f"{n}.rrd", n)) for n in (1, PLOTTED_TOGETHER + 2))
    assert blocks.damage is None
    assert len(one) == len(blocks) == COUNT
    for name, _, values in one.rows.figures():
        if name != "fuse_ms":
            np.testing.assert_array_equal(blocks.rows.filled(name), values, name)
    np.testing.assert_array_equal(blocks.fused_checksums, one.fused_checksums)


def test_a_frame_costs_a_viewer_few_messages(tmp_path, monkeypatch):
    """Each message takes 0.3 ms of the interpreter that sensors, fusion and file share, whatever it holds.

    A frame needs S_A, S_B, S* and the pelvis. Everything else comes once per block, or on change.
    """
    sent = Counter()

    def counted(name):
        original = getattr(rr.RecordingStream, name)

        def call(stream, entity, *what, **more):
            sent[entity] += not more.get("static", False)
            original(stream, entity, *what, **more)

        monkeypatch.setattr(rr.RecordingStream, name, call)

    counted("log")
    counted("send_columns")
    written(tmp_path / "s.rrd", PLOTTED_TOGETHER)
    each = {layout.skeleton("a"), layout.skeleton("b"), layout.FUSED_SKELETON, layout.PELVIS}
    assert {entity for entity, count in sent.items() if count >= COUNT} == each
    plotted = [layout.kinect("b"), *filter(layout.is_plotted, layout.ENTITIES)]
    assert all(sent[entity] <= COUNT // PLOTTED_TOGETHER + 1 for entity in plotted)


FRAMES_OF_MESSAGES, POINTS = 3, 4
RANDOM = np.random.default_rng(0)
VALUES = {
    ("Points3D", "positions"): RANDOM.normal(size=(FRAMES_OF_MESSAGES, POINTS, 3)).astype(np.float32),
    ("Points3D", "colors"): RANDOM.integers(0, 256, (FRAMES_OF_MESSAGES, POINTS, 3)).astype(np.uint8),
    ("Points3D", "class_ids"): RANDOM.integers(0, 9, (FRAMES_OF_MESSAGES, POINTS)).astype(np.uint16),
    ("Transform3D", "mat3x3"): RANDOM.normal(size=(FRAMES_OF_MESSAGES, 3, 3)).astype(np.float32),
    ("Transform3D", "translation"): RANDOM.normal(size=(FRAMES_OF_MESSAGES, 3)).astype(np.float32),
}


def assert_same(ours, theirs):
    """Two columns or batches are the same, also in their types."""
    assert ours.component_descriptor() == theirs.component_descriptor()
    assert ours.as_arrow_array().equals(theirs.as_arrow_array())
    assert ours.as_arrow_array().type == theirs.as_arrow_array().type


@pytest.mark.parametrize(("archetype", "argument"), VALUES)
def test_an_argument_of_an_archetype_becomes_what_rerun_makes_of_it(archetype, argument):
    values, each = VALUES[archetype, argument], POINTS if archetype == "Points3D" else 1
    flat = values.reshape(FRAMES_OF_MESSAGES * each, *values.shape[2 if each > 1 else 1 :])
    kind = getattr(rr, archetype)
    (theirs,) = kind.columns(**{argument: flat}).partition([each] * FRAMES_OF_MESSAGES)
    ours = Column(*converted(kind, argument, values, FRAMES_OF_MESSAGES * each), FRAMES_OF_MESSAGES)
    assert ours.component_descriptor() == theirs.component_descriptor()
    assert ours.as_arrow_array().equals(theirs.as_arrow_array())
    assert ours.as_arrow_array().type.value_type == theirs.as_arrow_array().type.value_type


@pytest.mark.parametrize("count", [0, 1, 7])
def test_points_become_what_rerun_makes_of_them(count):
    values = RANDOM.normal(size=(count, 3)).astype(np.float32)
    (ours,) = points(values)
    (theirs,) = rr.Points3D.from_fields(positions=values).as_component_batches()
    assert_same(ours, theirs)


def test_an_image_becomes_what_rerun_makes_of_it():
    theirs = rr.EncodedDepthImage(b"a blob", media_type="application/rvl", meter=1000.0)
    ours = depth_image(b"a blob", "application/rvl", 1000.0)
    for mine, their in zip(ours, theirs.as_component_batches(), strict=True):
        assert_same(mine, their)


def test_states_become_what_rerun_makes_of_them():
    states = ["from A", "from both", "from A"]
    (ours,), (theirs,) = state_changes(states), rr.StateChange.columns(state=states)
    assert_same(ours, theirs)


def test_times_become_what_rerun_makes_of_them():
    numbers = np.arange(5)
    spans = numbers.astype("timedelta64[ns]")
    for ours, theirs in (
        (Times("frame", numbers), rr.TimeColumn("frame", sequence=numbers)),
        (Times("time", spans), rr.TimeColumn("time", duration=spans)),
    ):
        assert ours.timeline_name() == theirs.timeline_name()
        assert ours.as_arrow_array().equals(theirs.as_arrow_array())
        assert ours.as_arrow_array().type == theirs.as_arrow_array().type
