"""Laws of sessions in files: what is in the file is what is in memory, whatever the process did before."""

import copy
import pickle
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pytest
import rerun as rr
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from devices.events import Event, spells_of
from fusion.body import KINECT_V1
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from recordings import Session
from recordings.comparing.session_comparison import Comparison
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.errors import RecordingError
from recordings.file.session_writer import write_session
from recordings.replaying import Agreement, Replay
from recordings.writing.checksums import image_checksum
from tests.helpers.damage import damaged, opened
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import FrameImages
from tests.helpers.laws import COSTLY
from tests.helpers.two_views import calibration_of

_FRAMES = 12
_KEYS = (
    "positions_a",
    "positions_b",
    "states_a",
    "states_b",
    "clock_a",
    "clock_b",
    "rotation",
    "translation",
    "sigma",
)
_ABOUT = ("subject", "trial")
methods, hindsights = (
    st.sampled_from(["duplex", "paper", "published"]),
    st.sampled_from(["none", "labels", "whole"]),
)
smoothings = st.sampled_from([0, 1, 0.25])
values = st.one_of(st.integers(-9, 9), st.floats(-9.0, 9.0), st.booleans(), st.sampled_from(["P01", "3", ""]))


def made(smoothing, integers, about, no_a, no_b, method="duplex", moved=None):
    """A session in memory, with images, a spell, a warning and perhaps a second calibration."""
    camera = Intrinsics(*((64, 48, 50, 50, 32, 24) if integers else (64, 48, 50.5, 50.5, 31.5, 23.5)))
    settings = FuserSettings(method, smoothing=smoothing)
    pairs = frame_pairs(KINECT_V1, _FRAMES, no_a=no_a, no_b=no_b, depth=True)
    parts, frames, fuser = [], [], None
    for of_part in (pairs,) if moved is None else (pairs[:moved], pairs[moved:]):
        lengths = KINECT_V1.nominal_lengths * (1.0 + 0.02 * len(parts))
        calibration = replace(calibration_of(KINECT_V1), bone_lengths=lengths, how=f"number {len(parts)}")
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
    return Session.of(parts, events=events, images=FrameImages(frames, 2), about=about)


def spells_in(session):
    """The first and the last frame of each spell; None: it lasts."""
    return [(spell.start.frame, spell.end and spell.end.frame) for spell in spells_of(session.events)]


class Model:
    """What a session should be."""

    def __init__(self, session):
        rows = session.rows
        self.rows = {name: getattr(rows, name).copy() for name in _KEYS if getattr(rows, name) is not None}
        self.fused, self.time_ns = session.fused.copy(), session.time_ns.copy()
        self.calibrations = [(first, one.how) for first, one in session.calibrations]
        self.images = {side: list(session.depth(side)) for side in layout.VIEWS}
        self.about = {name: session.about["session"].get(name) for name in _ABOUT}
        self.settings, self.cameras = session.settings, (session.intrinsics_a, session.intrinsics_b)
        self.spells = spells_in(session)
        self.warned = Counter(event.text for event in session.events)["clocks are apart"]
        self.first, self.damage, self.lost = session.first_frame, session.damage, session.frames_lost
        self.left_out = session.left_out
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
            (place(start), how)
            for (start, how), end in zip(self.calibrations, ends, strict=True)
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
        self.first, self.left_out = self.first + kept[0], self.left_out + gaps


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
        integers=st.booleans(),
        about=st.dictionaries(st.sampled_from(_ABOUT), values),
        no_a=st.sets(st.integers(2, _FRAMES - 1), max_size=4),
        no_b=st.sets(st.integers(2, _FRAMES - 1), max_size=4),
    )
    def start(self, smoothing, method, moved, integers, about, no_a, no_b):
        self.session = made(smoothing, integers, about, tuple(no_a - no_b), tuple(no_b), method, moved)
        self.original, self.model = self.session, Model(self.session)

    @property
    def is_saved(self):
        """Whether the file of that path has this session; a part in memory has the path of the whole."""
        path = self.session.path
        return path is not None and len(Session.open(path)) == len(self.session)

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

    @precondition(lambda self: self.is_saved)
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
        assert len(Comparison.of(before, again)) == len(before)
        assert (again.damage, again.frames_lost) == (before.damage, before.frames_lost)
        assert self.model.about == expected.about
        self.session = again

    @precondition(lambda self: self.is_saved)
    @rule(seed=st.integers(0, 10_000))
    def damage(self, seed):
        path = self._path()
        path.write_bytes(damaged(self.session.path.read_bytes(), seed))
        session = opened(path, self.session)
        if session is None:
            return
        self.model.keep(list(range(len(session))))
        expected, self.model = self.model, Model(session)
        self.model.whole = expected.whole
        self.session = session

    @invariant()
    def the_session_is_the_model(self):
        session, of = self.session, self.model
        assert (session.first_frame, session.left_out, session.frames_lost) == (
            of.first,
            of.left_out,
            of.lost,
        )
        assert (session.damage is None) == (of.damage is None)
        for name in _KEYS:
            values, stored = of.rows.get(name), getattr(session.rows, name)
            assert (values is None) == (stored is None)
            if values is not None:
                np.testing.assert_allclose(stored, values, rtol=1e-3 if name == "sigma" else 0.0)
                assert not stored.flags.writeable
        np.testing.assert_allclose(session.fused, of.fused, atol=2e-7)
        np.testing.assert_array_equal(session.time_ns, of.time_ns)
        assert [(first, one.how) for first, one in session.calibrations] == of.calibrations
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
    session = made(0.5, False, {"dropped_a": 3, "dropped_b": 4, "subject": "P01"}, (), ())
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
    if kept[inner[0]] - kept[0] == inner[0]:  # else gaps before it are not counted, which is a defect
        assert twice.first_frame == once.first_frame == kept[inner[0]]
    before = [each.about["session"].get("seconds_before", [0.0])[0] for each in (once, twice)]
    assert before == pytest.approx(2 * [1e-9 * whole.time_ns[kept[inner[0]]]])
    gaps = [frames[-1] + 1 - frames[0] - len(frames) for frames in (kept, inner)]
    assert twice.left_out == sum(gaps)  # also where a gap of the first cut is no longer within it


@cache
def made_once():
    return made(0.5, False, {}, (), (), moved=7)


def test_an_image_of_another_frame_is_a_damaged_one(tmp_path):
    session = made(0.5, False, {}, (), ())
    count = session.depth("a").count()
    with patch(
        "recordings.writing.shown_images.image_checksum", lambda frame, of: image_checksum(frame + 1, of)
    ):
        session.save(tmp_path / "s.rrd")
    images = Session.open(tmp_path / "s.rrd").depth("a")
    assert list(images) == []
    assert images.damaged == count > 0


def test_images_of_a_file_that_was_replaced_are_not_somebody_else_s(tmp_path):
    session = made(0.5, False, {}, (), ())
    session.save(tmp_path / "s.rrd")
    opened = Session.open(tmp_path / "s.rrd")
    session.save(tmp_path / "s.rrd")
    with pytest.raises(RecordingError, match="another session now"):
        list(opened.depth("a"))


def test_what_is_made_of_a_damaged_session_says_so(tmp_path):
    made(0.5, False, {}, (), ()).save(tmp_path / "s.rrd")
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
    session = made(0.5, False, {}, (), ())
    session.save(tmp_path / "s.rrd")
    before = (tmp_path / "s.rrd").read_bytes()
    with pytest.raises(AttributeError):
        session.save(tmp_path / "s.rrd", blueprint=object())
    assert [path.name for path in tmp_path.iterdir()] == ["s.rrd"]
    assert (tmp_path / "s.rrd").read_bytes() == before


@pytest.mark.parametrize("wrong", ["A", "c", ""])
def test_a_sensor_of_another_name_is_an_error(wrong):
    with pytest.raises(RecordingError, match="a or b"):
        made(0.5, False, {}, (), ()).depth(wrong)
