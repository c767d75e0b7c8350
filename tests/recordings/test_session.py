"""Sessions are read as they were written, and damage is reported."""

import copy
import doctest
import pickle
from collections import Counter
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

import recordings.session
from devices.depth.rvl import encode_depth
from devices.events import Event, spells_of
from devices.frame_pairs import PairingFigures
from devices.pairing import pair_views
from devices.people.recorded_people import RecordedPeople
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import BODIES, KINECT_V1, KINECT_V2
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from recordings import Session, fuse
from recordings.appearance.coach_page import CoachPage, Mark
from recordings.comparing.session_comparison import Comparison
from recordings.data import layout
from recordings.data.checksums import event_checksum, fused_checksums, image_checksum
from recordings.data.session_arrays import SessionFrame
from recordings.data.session_data import runs_of
from recordings.errors import RecordingError
from recordings.file import rrd_file
from recordings.file.rrd_file import END_OF_FILE, without_footer
from recordings.file.session_writer import write_session
from recordings.fusing.pairs import fuse_segments
from recordings.replaying import Agreement, Replay
from recordings.writing.properties import calibration_values
from tests.helpers.damage import damaged, opened
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import FrameImages, record_fused
from tests.helpers.laws import COSTLY
from tests.helpers.programs import python
from tests.helpers.recalibrated import recorder_to
from tests.helpers.recorded_pairs import write_recordings
from tests.helpers.two_views import calibration_of

FRAMES = 70


def full_of_faults(body):
    return frame_pairs(body, FRAMES, gap=(7, 40, 41), only_a=(9, 10), no_b=(15,), jitter_ns=3_000_000)


def test_blocks_and_single_frames_mix_in_any_order():
    setup = FusionSetup(calibration_of(KINECT_V1), FuserSettings("paper"))
    sensors = simulated_pair(motion="still", body=KINECT_V1, seconds=1.0)[:2]
    a, b = (RecordedPeople.of(KINECT_V1, sensor.frames()).view([PERSON]) for sensor in sensors)
    pairs = pair_views(KINECT_V1, a, b).pairs
    parts = [(setup, slice(first, first + 10)) for first in (0, 10, 20)]
    first, second, third = fuse_segments(parts, pairs, None)
    for frames in ([*first, second, *third], [first, *second, third], [*first, second, third]):
        session = Session.of([(setup, frames)])
        assert len(session) == 30
        assert (np.diff(session.time_ns) > 0).all()


@pytest.mark.parametrize(("every_a", "every_b"), [(1, 1), (2, 1), (1, 2)])
def test_the_frame_rate_is_that_of_the_faster_sensor_without_its_pauses(every_a, every_b, fused_run):
    no_a, no_b = ([k for k in range(60) if k % every] for every in (every_a, every_b))
    pairs = frame_pairs(KINECT_V2, 60, no_a=no_a, no_b=no_b, jitter_ns=2_000_000)
    calibration = calibration_of(KINECT_V2)
    assert fused_run(pairs[:25] + pairs[40:], calibration).frame_rate == 30.0


def test_the_checksum_of_s_notices_the_last_bit():
    fused = np.random.default_rng(0).normal(size=(3, 20, 3))
    nudged = fused.copy()
    nudged[1, 4, 2] = np.nextafter(nudged[1, 4, 2], 9.0)
    assert (fused_checksums(fused) == fused_checksums(nudged)).tolist() == [True, False, True]


def test_files_that_are_no_sessions_are_named_in_one_line(tmp_path):
    (tmp_path / "text.rrd").write_text("hello, world\n", encoding="utf-8")
    (tmp_path / "empty.rrd").touch()
    stream = rr.RecordingStream("something_else")
    stream.save(tmp_path / "other.rrd")
    stream.log("x", rr.TextLog("y"))
    stream.disconnect()
    for name, words in (
        ("missing.rrd", "No session"),
        ("text.rrd", "does not begin like an .rrd"),
        ("empty.rrd", "not a session"),
        ("other.rrd", "not a session of duplex-kinects"),
        (".", "is a folder"),
    ):
        with pytest.raises(RecordingError, match=words) as error:
            Session.open(tmp_path / name)
        assert "\n" not in str(error.value)


def test_another_layout_says_which_version_wrote_it(monkeypatch, fused_run):
    readable = ", ".join(map(str, layout.READABLE_VERSIONS))
    older = min(layout.READABLE_VERSIONS) - 1
    monkeypatch.setattr(layout, "VERSION", older)
    monkeypatch.setattr(layout, "READABLE_VERSIONS", (older,))
    old = fused_run(frame_pairs(KINECT_V1, 3), calibration_of(KINECT_V1))
    monkeypatch.undo()
    with pytest.raises(
        RecordingError, match=rf"layout {older}, written by duplex-kinects .*reads layout {readable}"
    ):
        Session.open(old.path)


@pytest.mark.parametrize("grown", [False, True])
def test_a_session_behind_another_is_said(fused_run, tmp_path, grown):
    session, both = fused_run(frame_pairs(KINECT_V1, 3), calibration_of(KINECT_V1)), tmp_path / "both.rrd"
    whole = session.path.read_bytes()
    first = bytes(without_footer(whole, with_header=True)) + END_OF_FILE if grown else whole
    both.write_bytes(first + whole)
    opened = Session.open(both)
    assert len(opened) == 3
    assert opened.damage == f"another recording begins at byte {len(first)}, which is not read"


def test_an_event_moved_to_another_time_is_damage(tmp_path):
    path, moved = tmp_path / "s.rrd", tmp_path / "moved.rrd"
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    for file, at in ((path, (2, 5)), (moved, (1, 7))):
        with recorder_to(file, fuser.setup) as recorder:
            pairs = frame_pairs(KINECT_V1, 3)
            recorder.record_all([SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs])
            check = event_checksum(Event("lost").placed(2, 5))
            with patch("recordings.writing.recorder.event_checksum", return_value=check):
                recorder.event(Event("lost").placed(*at), placed=True)
    assert [event.text for event in Session.open(path).events] == ["lost"]
    session = Session.open(moved)
    assert (session.events, session.damage) == ((), "an event does not match its checksum")


T, J = 12, len(KINECT_V1)


@pytest.fixture
def session(fused_run):
    return fused_run(
        frame_pairs(KINECT_V1, T, no_b=(4,), depth=True), calibration_of(KINECT_V1), depth_every=1
    )


def test_the_example_runs(tmp_path, monkeypatch):
    pairs = frame_pairs(KINECT_V1, 120, depth=True)
    record_fused(tmp_path / "walk.rrd", pairs, calibration_of(KINECT_V1), depth_every=60)
    monkeypatch.chdir(tmp_path)
    attempted = doctest.testmod(recordings.session)
    assert attempted.attempted > 3
    assert attempted.failed == 0


LARGE = {"scipy.spatial", "scipy.interpolate", "pandas", "rerun", "cv2"}


@pytest.mark.parametrize(
    ("program", "without"),
    [
        ("import recordings", {"pyarrow"}),
        ("from recordings import Session", LARGE),
        ("from recordings import fuse", LARGE),
        ("import pytest, recordings.pytest_plugin", {"numpy"}),
        ("import sys; sys.modules['pytest'] = None; from recordings import testing", {"_pytest"}),
    ],
)
def test_an_import_loads_what_it_needs_only(program, without):
    said = python("-c", f"{program}; import sys; print(*sys.modules)")
    assert said.returncode == 0, said.stderr
    assert not without & set(said.stdout.split())


def test_a_name_that_the_package_lacks_is_an_attribute_error():
    with pytest.raises(AttributeError, match="Sessions"):
        recordings.Sessions  # noqa: B018


@pytest.mark.parametrize("package", ["fusion", "devices", "recordings", "viewer_app"])
def test_type_checkers_are_told_that_there_are_types(package):
    assert (files(package) / "py.typed").is_file()


def with_a_damaged_image(session, frame, damaged):
    data = bytearray(session.path.read_bytes())
    offset = data.find(encode_depth(dict(session.depth("a"))[frame])[200:260])
    assert offset > 0, "the image is not in the file as it is"
    data[offset + 20] ^= 1
    damaged.write_bytes(data)
    return Session.open(damaged)


def test_a_damaged_image_is_left_out_and_counted(session, tmp_path):
    damaged = with_a_damaged_image(session, 5, tmp_path / "damaged.rrd")
    assert damaged.damage is None  # every frame is there
    images = damaged.depth("a")
    assert [frame for frame, _ in images] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert images.damaged == 1
    assert images.count() == 11
    pairs = list(damaged.pairs(depth=True))
    assert pairs[5].a.depth is None
    assert damaged.depth("a", 6, 9).count() == 3


@pytest.mark.parametrize("frame", [8, 10])
def test_images_are_read_no_further_than_asked(session, tmp_path, frame):
    damaged = with_a_damaged_image(session, frame, tmp_path / "damaged.rrd")
    images = damaged.depth("a", 0, 8)
    assert images.count() == 8
    assert images.damaged == 0


def test_a_chunk_of_frames_is_unpacked_once_to_open_and_save_a_session(session, tmp_path, monkeypatch):
    """Chunks of images twice at most: whose they are is known after the first time."""
    unpacked, real = Counter(), rrd_file._unpack

    def counted(message):
        entity, batch = real(message)
        unpacked[entity, message] += 1
        return entity, batch

    monkeypatch.setattr(rrd_file, "_unpack", counted)
    Session.open(session.path).save(tmp_path / "s.rrd")
    copied = {of(side) for of in (layout.depth, layout.color, layout.others) for side in layout.VIEWS}
    of_frames = [count for (entity, _), count in unpacked.items() if entity not in copied]
    assert len(of_frames) > 20
    assert max(of_frames) == 1
    assert max(unpacked.values()) == 2
    again = Session.open(tmp_path / "s.rrd")
    assert [again.depth("a").count() for _ in range(2)] == [T, T]


# --- A damaged session gives one line of error, or exactly the first frames; cut off, its events, too.


def test_random_damage_gives_the_beginning_or_one_line(tmp_path):
    pairs = frame_pairs(KINECT_V1, 24, gap=(7,), only_a=(9, 10), no_b=(15,), depth=True)
    whole = record_fused(tmp_path / "whole.rrd", pairs, calibration_of(KINECT_V1), depth_every=1, block=8)
    data, path = whole.path.read_bytes(), tmp_path / "damaged.rrd"
    outcomes = Counter()
    for seed in range(24):
        path.write_bytes(damaged(data, seed))
        session = opened(path, whole)
        known = "refused" if session is None else "whole" if len(session) == len(whole) else "beginning"
        outcomes[known] += 1
    assert outcomes["beginning"] > 0
    assert outcomes["refused"] < 12


_BLOCK = 10


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A session with an event at every second frame."""
    session = fuse(*write_recordings(tmp_path_factory.mktemp("told")))
    events = [Event(f"event {k}").placed(k, int(session.time_ns[k])) for k in range(0, len(session), 2)]
    return replace(session, events=tuple(events))


def test_a_folder_in_which_no_file_can_be_created_is_an_error_of_the_system(told, tmp_path):
    """Rerun raises a RuntimeError, which nobody would expect."""
    with pytest.raises(OSError, match="No such file"):
        write_session(told, tmp_path / "missing" / "s.rrd")


def test_events_are_kept_up_to_the_cut(told, tmp_path):
    whole, cut = tmp_path / "s.rrd", tmp_path / "cut.rrd"
    write_session(told, whole, block=_BLOCK)
    data = whole.read_bytes()
    assert len(Session.open(whole).events) == len(told.events)
    lengths = set()
    for share in range(30, 100, 5):
        cut.write_bytes(data[: len(data) * share // 100])
        try:
            found = Session.open(cut)
        except RecordingError:
            continue  # not one whole frame
        lengths.add(len(found))
        kept = {event.frame for event in found.events}
        # what was written in one go, frames and events, may be torn apart: at most two blocks
        assert kept >= set(range(0, len(found) - 2 * _BLOCK, 2)), share
    assert len(lengths) >= 3, "the cuts fall between frames"


@pytest.mark.parametrize("moment", [{"sequence": 1}, {"duration": 1.0}, {"timestamp": 1.7e9}])
def test_a_recording_of_another_program_is_refused_whatever_its_frames_are(moment, tmp_path):
    stream = rr.RecordingStream("another")
    stream.save(tmp_path / "s.rrd")
    stream.set_time(layout.FRAME, **moment)
    stream.log(
        layout.FUSED_SKELETON, rr.Points3D([[0.0, 0.0, 0.0]]), rr.AnyValues(day=pa.array([1], pa.date32()))
    )
    stream.disconnect()
    with pytest.raises(RecordingError, match="not a session of duplex-kinects"):
        Session.open(tmp_path / "s.rrd")


# --- Laws of sessions in files: what is in the file is what is in memory, whatever the process did before.


_FRAMES = 12
_ABOUT = ("subject", "trial")
methods, hindsights = (
    st.sampled_from(["duplex", "paper", "published"]),
    st.sampled_from(["none", "labels", "whole"]),
)
smoothings = st.sampled_from([0, 1, 0.25])
absences = st.sets(st.integers(2, _FRAMES - 1), max_size=3)
values = st.one_of(st.integers(-9, 9), st.floats(-9.0, 9.0), st.booleans(), st.sampled_from(["P01", "3", ""]))


def made(smoothing, integers, about, pairs=None, method="duplex", moved=None, placed=True):
    """A session in memory, with images, a spell, a warning and perhaps a second calibration."""
    pairs = pairs or frame_pairs(KINECT_V1, _FRAMES, depth=True)
    body = next(
        person.body for pair in pairs for of in (pair.a, pair.b) if of for person in of.people.values()
    )
    camera = Intrinsics(*((64, 48, 50, 50, 32, 24) if integers else (64, 48, 50.5, 50.5, 31.5, 23.5)))
    settings = FuserSettings(method, smoothing=smoothing)
    parts, frames, fuser = [], [], None
    for of_part in (pairs,) if moved is None else (pairs[:moved], pairs[moved:]):
        lengths = body.nominal_lengths * (1.0 + 0.02 * len(parts))
        number = len(parts)
        calibration = replace(
            calibration_of(body),
            bone_lengths=lengths, how=f"number {number}", person=number, placed=placed or number > 0,
            depth_errors=number * np.array([0.01, -0.02]),
        )  # fmt: skip
        setup = FusionSetup(calibration, settings, camera, replace(camera, cx=camera.cx + 1))
        if fuser is None or method != "duplex":
            fuser = Fuser(setup)
        else:
            fuser.recalibrate(setup)
        parts.append((setup, [SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in of_part]))
        frames += parts[-1][1]
    time_ns = [pair.time_ns - pairs[0].time_ns for pair in pairs]
    events = (
        Event("clocks are apart", "WARN"),
        Event("B loses the left arm", topic="arm", phase="start").placed(3, time_ns[3]),
        Event("B finds the left arm", topic="arm", phase="end").placed(8, time_ns[8]),
    )
    return Session.of(parts, events=events, images=LiveImages(frames, 2), about=about)


def spells_in(session):
    """The first and the last frame of each spell; None: it lasts."""
    return [(spell.start.frame, spell.end and spell.end.frame) for spell in spells_of(session.events)]


def calibrations_of(session):
    """The first frame and all values of each, in text: NaN is NaN."""
    values = (
        (first, {"person": one.person} | calibration_values(one)) for first, one in session.calibrations
    )
    plain = {"person": int}
    return [
        (first, {name: plain.get(name, str)(np.array(of).tolist()) for name, of in every.items()})
        for first, every in values
    ]


class Model:
    """What a session should be."""

    def __init__(self, session):
        rows = session.rows
        self.rows = {name: values.copy() for name, _, values in rows.figures()}
        self.rows["bone_lengths"] = rows.bone_lengths.copy()
        self.fused, self.time_ns = session.fused.copy(), session.time_ns.copy()
        self.calibrations = calibrations_of(session)
        self.images = {side: list(session.depth(side)) for side in layout.VIEWS}
        self.about = {name: session.about["session"].get(name) for name in _ABOUT}
        self.settings, self.cameras = session.settings, (session.intrinsics_a, session.intrinsics_b)
        self.spells = spells_in(session)
        self.warned = Counter(event.text for event in session.events)["clocks are apart"]
        self.damage, self.lost = session.damage, session.frames_lost
        self.logged = logged_of(session)
        self.numbers = session.numbers
        self.whole = True  # whether all frames are here that S* was made of

    def keep(self, kept):
        """Keeps some frames, in order."""
        count = len(self.fused)
        # events may be there of frames that are lost
        every = [*kept, *range(count, count + 99)] if kept[-1] == count - 1 else kept
        new = {frame: k for k, frame in enumerate(every)}

        def place(frame):
            return next((new[later] for later in every if later >= frame), None)

        for name, values in self.rows.items():
            self.rows[name] = values[kept]
        self.fused, self.time_ns = self.fused[kept], self.time_ns[kept] - self.time_ns[kept[0]]
        ends = [start for start, _ in self.calibrations[1:]] + [count]
        self.calibrations = [
            (place(start), whose)
            for (start, whose), end in zip(self.calibrations, ends, strict=True)
            if any(start <= frame < end for frame in kept)
        ]
        self.images = {
            side: [(new[k], image) for k, image in some if k in new] for side, some in self.images.items()
        }
        self.spells = [
            (place(a), None if b is None else place(b))
            for a, b in self.spells
            if any(a <= frame and (b is None or frame <= b) for frame in every)
        ]
        later = self.settings.method == "duplex" and self.settings.hindsight == "whole"
        gaps = kept[-1] + 1 - kept[0] - len(kept)
        self.whole &= kept[0] == 0 and not gaps and not (later and len(kept) < count)
        self.numbers = self.numbers[kept]
        self.logged = {key: [held[k] for k in kept] for key, held in self.logged.items()}


@cache
def logged_live():
    """What the coach and the streams log beside the frames."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "live.rrd"
        fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
        with recorder_to(path, fuser.setup) as recorder:
            for k, pair in enumerate(frame_pairs(KINECT_V1, _FRAMES)):
                figures = PairingFigures(alone_a=k // 4, dropped=(k // 3, 0), drift_ppm=0.5 * k)
                recorder.record_all([SessionFrame(pair, fuser.update(pair.skeletons), 0, streams=figures)])
                if k % 5 == 0:
                    mark = Mark((((0.0, 0.0, 0.0), (1.0, 0.0, float(k))),), "do", (0.0, 0.0, 0.0))
                    recorder.coach(CoachPage(f"page {k}", (("spot", mark),) if k else ()))
        return tuple(Session.open(path).images.logged())


class LiveImages(FrameImages):
    def logged(self):
        return iter(logged_live())


def logged_of(session):
    """By entity and component: what holds in each frame."""
    found, times = {}, range(len(session))
    for entity, batch in session.images.logged():
        rows = batch.to_pydict()
        row, frames = batch.column(0).to_pylist(), rows.get("frame", [-1] * batch.num_rows)
        for component in (name for name in rows if ":" in name):
            held = found.setdefault((entity, component), [])
            held += zip(frames, row, rows[component], strict=True)
    return {
        key: [max((each for each in held if each[0] <= t), default=(0, b"", None))[2] for t in times]
        for key, held in found.items()
    }


class Saving(RuleBasedStateMachine):
    """Saves, opens, cuts, copies, fuses again and damages one session in random order, beside another
    program's use of Rerun."""

    def __init__(self):
        super().__init__()
        self._folder = TemporaryDirectory()
        self._count = 0

    def teardown(self):
        self._folder.cleanup()

    def _path(self):
        self._count += 1
        return Path(self._folder.name) / f"{self._count}.rrd"

    @initialize(
        smoothing=smoothings,
        method=methods,
        moved=st.none() | st.integers(1, _FRAMES - 1),
        placed=st.booleans(),
        integers=st.booleans(),
        about=st.dictionaries(st.sampled_from(_ABOUT), values),
        body=st.sampled_from(list(BODIES.values())),
        absent=st.fixed_dictionaries(dict.fromkeys(("no_a", "no_b", "gap", "only_a"), absences)),
        jitter_ns=st.sampled_from([0, 3_000_000]),
    )
    def start(self, smoothing, method, moved, placed, integers, about, body, absent, jitter_ns):
        absent["no_a"] -= absent["no_b"]
        pairs = frame_pairs(body, _FRAMES, depth=True, jitter_ns=jitter_ns, **absent)
        self.session = made(smoothing, integers, about, pairs, method, moved, placed)
        images = {side: dict(self.session.depth(side)) for side in layout.VIEWS}
        for k, (pair, again) in enumerate(zip(pairs, self.session.pairs(depth=True), strict=True)):
            assert (again.time_ns, again.skew_ns) == (pair.time_ns - pairs[0].time_ns, pair.skew_ns)
            for side in layout.VIEWS:
                one, two = (getattr(each.skeletons, side) for each in (pair, again))
                assert (getattr(again, side) is None) == (getattr(pair, side) is None)
                assert (one is None) == (two is None)
                assert getattr(getattr(again, side), "depth", None) is images[side].get(k)
                if one is not None and two is not None:
                    np.testing.assert_array_equal(one.positions, two.positions)
                    np.testing.assert_array_equal(one.states, two.states)
                    assert one.time_ns == two.time_ns
        self.original, self.model = self.session, Model(self.session)

    @rule(
        name=st.sampled_from(["rotation", "smoothing", "crc32", "h", "topic", "a", "subject"]), value=values
    )
    def somebody_else_uses_rerun(self, name, value):
        rr.AnyValues(**{name: value}).as_component_batches()

    @rule()
    def save_under_another_name(self):
        path = self._path()
        self.session.save(path)
        self.session = Session.open(path)

    @precondition(lambda self: self.session.path is not None)
    @rule(linked=st.booleans())
    def save_onto_itself(self, linked):
        path = self.session.path
        if linked:
            link = self._path()
            link.symlink_to(path)
            path = link
        self.session.save(path)
        if linked:
            self.session = Session.open(path)

    @rule(deep=st.booleans())
    def copy(self, deep):
        if deep:
            self.session = copy.deepcopy(self.session)
        elif self.session.path is not None:
            self.session = pickle.loads(pickle.dumps(self.session))

    @precondition(lambda self: len(self.session) > 4)
    @rule(data=st.data())
    def cut(self, data):
        n = len(self.session)
        first = data.draw(st.integers(0, n - 2))
        end = data.draw(st.integers(first + 1, n))
        path = self._path()
        write_session(self.session.part(range(first, end)), path)
        self.session = Session.open(path)
        self.model.keep(list(range(first, end)))

    @precondition(lambda self: len(self.session) > 4)
    @rule(data=st.data(), written=st.booleans())
    def leave_frames_out(self, data, written):
        numbers = st.integers(0, len(self.session) - 1)
        kept = sorted(data.draw(st.sets(numbers, min_size=4)))
        self.session = self.session.part(kept)
        if written:
            path = self._path()
            self.session.save(path)
            self.session = Session.open(path)
        self.model.keep(kept)

    @rule(settings=st.none() | st.builds(FuserSettings, methods, smoothing=smoothings, hindsight=hindsights))
    def replay(self, settings):
        before, again = self.session, Replay.of(self.session, settings).fused()
        if self.model.whole and settings in (None, before.settings):
            assert Agreement.of(before, again.fused).kind == "bits"
            for name in ("exchanged", "side_doubt", "heading"):
                np.testing.assert_array_equal(getattr(again.rows, name), getattr(before.rows, name))
        else:
            self.original = again
        expected, self.model = self.model, Model(again)
        self.model.numbers, self.model.logged = expected.numbers, expected.logged
        assert len(Comparison.of(before, again)) == len(before)
        assert (again.damage, again.frames_lost) == (before.damage, before.frames_lost)
        assert self.model.about == expected.about
        self.session = again

    @precondition(lambda self: self.session.path is not None)
    @rule(seed=st.integers(0, 10_000))
    def damage(self, seed):
        path = self._path()
        path.write_bytes(damaged(self.session.path.read_bytes(), seed))
        session = opened(path, self.session)
        if session is None:
            return
        self.model.keep(list(range(len(session))))
        expected, self.model = self.model, Model(session)
        self.model.whole, self.model.numbers = expected.whole, expected.numbers
        self.session = session

    @invariant()
    def the_session_is_the_model(self):
        session, of = self.session, self.model
        assert session.frames_lost == of.lost
        if of.damage is None:
            stored, expected = (
                {key: held for key, held in each.items() if any(one is not None for one in held)}
                for each in (logged_of(session), of.logged)
            )
            assert stored == expected
        np.testing.assert_array_equal(session.numbers, of.numbers)
        assert session.first_frame == of.numbers[0]
        assert (of.damage or "") in (session.damage or "")
        assert (session.damage is None) == (of.damage is None)
        assert of.rows.keys() - {"bone_lengths"} == {name for name, *_ in session.rows.figures()}
        for name, values in of.rows.items():
            stored = getattr(session.rows, name)
            if name == "sigma":  # in float16
                np.testing.assert_allclose(stored, values, rtol=1e-3)
            elif name != "fused":
                np.testing.assert_array_equal(stored, values, name)
        np.testing.assert_allclose(session.fused, of.fused, atol=2e-7)
        np.testing.assert_array_equal(session.time_ns, of.time_ns)
        assert calibrations_of(session) == of.calibrations
        present = [
            next(whose["person"] for n, whose in of.calibrations[::-1] if n <= k) for k in range(len(session))
        ]
        assert [each.person for each in session.people for _ in range(each.first, each.end)] == present
        for each in session.people:
            np.testing.assert_array_equal(session.bone_lengths[each.end - 1], each.bone_lengths)
            assert each.seconds == (session.time[each.first], session.time[each.end - 1])
        for side, images in of.images.items():
            for (k, image), (frame, expected) in zip(session.depth(side), images, strict=True):
                assert k == frame
                np.testing.assert_array_equal(image, expected)
        assert {name: session.about["session"].get(name) for name in _ABOUT} == of.about
        assert session.settings == of.settings
        assert (session.intrinsics_a, session.intrinsics_b) == of.cameras
        assert spells_in(session) == of.spells
        assert Counter(event.text for event in session.events)["clocks are apart"] == of.warned
        compared = Comparison.of(self.original, session)
        assert len(compared) == len(session)
        assert np.nanmax(compared.apart, initial=0.0) < 2e-7


TestSaving = Saving.TestCase
TestSaving.settings = settings(COSTLY, stateful_step_count=6)  # a step may fuse, write or read a session


@given(
    cut=st.tuples(st.integers(0, _FRAMES - 1), st.integers(1, _FRAMES)).filter(lambda cut: cut[0] < cut[1])
)
def test_a_part_has_the_events_of_its_frames_and_no_counts_of_the_whole(tmp_path, cut):
    session = made(0.5, False, {"dropped_a": 3, "dropped_b": 4, "subject": "P01"})
    each = [Event(f"in frame {k}").placed(k, int(ns)) for k, ns in enumerate(session.time_ns)]
    first, end = cut
    write_session(replace(session, events=each).part(range(first, end)), tmp_path / "s.rrd")
    part = Session.open(tmp_path / "s.rrd")
    own = [event for event in part.events if event.text.startswith("in frame")]
    since_ns = int(session.time_ns[first])
    assert own == [event.placed(event.frame - first, event.time_ns - since_ns) for event in each[first:end]]
    assert part.dropped == ((3, 4) if cut == (0, _FRAMES) else (None, None))
    assert part.about["session"]["subject"] == session.about["session"]["subject"]


@given(
    outer=st.sets(st.integers(0, _FRAMES - 1), min_size=3), choice=st.lists(st.booleans(), min_size=_FRAMES)
)
@example(set(range(3, 10)), [False, False, True, True, False, True, *[False] * 6])
def test_a_part_of_a_part_is_that_part_of_the_whole(outer, choice):
    kept = sorted(outer)
    inner = [k for k in range(len(kept)) if choice[k]] or [1]
    whole = made_once()
    once, twice = whole.part([kept[k] for k in inner]), whole.part(kept).part(inner)
    np.testing.assert_array_equal(twice.time_ns, once.time_ns)
    np.testing.assert_array_equal(twice.fused, once.fused)
    assert twice.calibrations == once.calibrations
    np.testing.assert_array_equal(twice.numbers, [kept[k] for k in inner])
    flags = np.isin(np.arange(len(whole)), twice.numbers)
    told = [{**each.about["session"]} for each in (once, twice, whole.part(flags))]
    before = [each.pop("seconds_before", [0.0])[0] for each in told]
    assert before == pytest.approx(3 * [1e-9 * whole.time_ns[kept[inner[0]]]])
    if len(kept) < len(whole):
        assert told == 3 * told[:1]
        assert (twice.path, str(twice)) == (None, f"frames {runs_of(twice.numbers)} of a capture")


@cache
def made_once():
    return made(0.5, False, {}, moved=7)


def test_each_frame_is_judged_by_the_bone_lengths_it_was_fused_with(tmp_path):
    made_once().save(tmp_path / "s.rrd")
    session = Session.open(tmp_path / "s.rrd")
    np.testing.assert_array_equal(session.bone_lengths, made_once().bone_lengths)
    assert (session.bone_lengths[6] != session.bone_lengths[7]).any()
    # S* is kept in float32: at 4 m its ends are within half of 2⁻²² m on each axis
    assert session.quality.bone_error.max() < 2 * np.sqrt(3) * 2.0**-23


@given(
    name=st.sampled_from(["rotation", "translation", "bone_lengths", "depth_errors"]), size=st.integers(1, 30)
)
@example(name="depth_errors", size=2)
def test_a_calibration_that_cannot_be_is_refused_in_one_line(tmp_path_factory, name, size):
    """Its checksum is right: another program wrote it."""
    path, true = tmp_path_factory.mktemp("s") / "s.rrd", calibration_values(made_once().calibration)[name]
    wrong = np.full(size, np.inf if size == np.size(true) else 1.0)

    def values(calibration):
        return calibration_values(calibration) | {name: wrong}

    with patch("recordings.writing.recorder.calibration_values", values):
        made_once().save(path)
    with pytest.raises(RecordingError, match="a calibration in it is not valid") as error:
        Session.open(path)
    assert "\n" not in str(error.value)


def test_an_image_of_another_frame_is_a_damaged_one(tmp_path):
    session = made(0.5, False, {})
    count = session.depth("a").count()
    with patch(
        "recordings.writing.shown_images.image_checksum", lambda frame, of: image_checksum(frame + 1, of)
    ):
        session.save(tmp_path / "s.rrd")
    images = Session.open(tmp_path / "s.rrd").depth("a")
    assert list(images) == []
    assert images.damaged == count > 0


def test_images_of_a_file_that_was_replaced_are_not_somebody_else_s(tmp_path):
    session = made(0.5, False, {})
    session.save(tmp_path / "s.rrd")
    opened = Session.open(tmp_path / "s.rrd")
    session.save(tmp_path / "s.rrd")
    with pytest.raises(RecordingError, match="another session now"):
        list(opened.depth("a"))


def test_what_is_made_of_a_damaged_session_says_so(tmp_path):
    made(0.5, False, {}).save(tmp_path / "s.rrd")
    cut = (tmp_path / "s.rrd").read_bytes()
    (tmp_path / "cut.rrd").write_bytes(cut[: len(cut) * 9 // 10])
    damaged = Session.open(tmp_path / "cut.rrd")
    assert damaged.damage is not None
    damaged.save(tmp_path / "again.rrd")
    again = Session.open(tmp_path / "again.rrd")
    assert damaged.damage in again.damage
    assert again.frames_lost == damaged.frames_lost
    again.save(tmp_path / "third.rrd")
    third = Session.open(tmp_path / "third.rrd")
    assert (third.damage, third.frames_lost) == (again.damage, damaged.frames_lost)


def test_a_failed_save_keeps_the_file_and_leaves_nothing(tmp_path):
    session = made(0.5, False, {})
    session.save(tmp_path / "s.rrd")
    before = (tmp_path / "s.rrd").read_bytes()
    with pytest.raises(AttributeError):
        session.save(tmp_path / "s.rrd", blueprint=object())
    assert [path.name for path in tmp_path.iterdir()] == ["s.rrd"]
    assert (tmp_path / "s.rrd").read_bytes() == before
