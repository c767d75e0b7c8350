"""Laws of sessions in files: what is in the file is what is in memory, whatever the process did before."""

import copy
import pickle
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from devices.events import Event, spells_of
from fusion.body import KINECT_V1
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from recordings import Session
from recordings.errors import RecordingError
from recordings.file.session_writer import write_session
from recordings.session_arrays import SessionFrame
from recordings.session_comparison import Comparison
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import FrameImages
from tests.helpers.two_views import calibration_of

_FRAMES = 12
_KEYS = ("positions_a", "positions_b", "states_a", "states_b", "clock_a", "clock_b", "rotation", "sigma")
values = st.one_of(st.integers(-9, 9), st.floats(-9.0, 9.0), st.booleans(), st.sampled_from(["P01", "3", ""]))


def made(smoothing, integers, about, no_a, no_b):
    """A session in memory, with images, a spell and a warning."""
    camera = Intrinsics(*((64, 48, 50, 50, 32, 24) if integers else (64, 48, 50.5, 50.5, 31.5, 23.5)))
    calibration = calibration_of(KINECT_V1)
    setup = FusionSetup(calibration, FuserSettings(smoothing=smoothing), camera, camera)
    pairs = frame_pairs(KINECT_V1, _FRAMES, no_a=no_a, no_b=no_b, depth=True)
    fuser = Fuser(setup)
    frames = [SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs]
    time_ns = [pair.time_ns - pairs[0].time_ns for pair in pairs]
    events = (
        Event("clocks are apart", "WARN"),
        Event("B loses the left arm", topic="arm", phase="start").placed(3, time_ns[3]),
        Event("B finds the left arm", topic="arm", phase="end").placed(8, time_ns[8]),
    )
    images = FrameImages(frames, 2)
    return Session.of([(setup, frames)], events=events, images=images, about=about)


class Saving(RuleBasedStateMachine):
    """Saves, opens, cuts and copies one session in random order, beside another program's use of Rerun."""

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
        smoothing=st.sampled_from([0, 1, 0.25]),
        integers=st.booleans(),
        about=st.dictionaries(st.sampled_from(["subject", "trial"]), values),
        no_a=st.sets(st.integers(2, _FRAMES - 1), max_size=4),
        no_b=st.sets(st.integers(2, _FRAMES - 1), max_size=4),
    )
    def start(self, smoothing, integers, about, no_a, no_b):
        self.session = made(smoothing, integers, about, tuple(no_a - no_b), tuple(no_b))
        of = self.session
        self.model = SimpleNamespace(
            rows={name: getattr(of.rows, name).copy() for name in _KEYS},
            fused=of.fused.copy(),
            time_ns=of.time_ns.copy(),
            images={side: list(of.depth(side)) for side in "ab"},
            about={name: of.about["session"][name] for name in about},
            settings=of.settings,
            camera=of.intrinsics_a,
            lasting=[(3, 8)],
            first=0,
        )
        self.original = of

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
        of, n = self.model, len(self.session)
        first = data.draw(st.integers(0, n - 2))
        end = data.draw(st.integers(first + 1, n))
        path = self._path()
        write_session(self.session, path, first=first, end=end)
        self.session = Session.open(path)
        for name, values in of.rows.items():
            of.rows[name] = values[first:end]
        of.fused, of.time_ns = of.fused[first:end], of.time_ns[first:end] - of.time_ns[first]
        of.images = {
            side: [(k - first, image) for k, image in some if first <= k < end]
            for side, some in of.images.items()
        }
        of.lasting = [(max(a - first, 0), b - first) for a, b in of.lasting if a < end and b >= first]
        of.first += first

    @invariant()
    def the_session_is_the_model(self):
        session, of = self.session, self.model
        assert (session.damage, session.frames_lost, session.first_frame) == (None, 0, of.first)
        for name, values in of.rows.items():
            stored = getattr(session.rows, name)
            np.testing.assert_allclose(stored, values, rtol=1e-3 if name == "sigma" else 0.0)
            assert not stored.flags.writeable
        np.testing.assert_allclose(session.fused, of.fused, atol=2e-7)
        np.testing.assert_array_equal(session.time_ns, of.time_ns)
        for side, images in of.images.items():
            again = session.depth(side)
            for (k, image), (frame, expected) in zip(again, images, strict=True):
                assert k == frame
                np.testing.assert_array_equal(image, expected)
            assert again.damaged == 0
        assert {name: session.about["session"][name] for name in of.about} == of.about
        assert (session.settings, session.intrinsics_a) == (of.settings, of.camera)
        spells = [(s.start.frame, s.end and s.end.frame) for s in spells_of(session.events)]
        n = len(session)
        assert spells == [(a, b if b < n else None) for a, b in of.lasting]
        assert Counter(e.text for e in session.events)["clocks are apart"] == 1
        compared = Comparison.of(self.original, session)
        assert len(compared) == len(session)
        assert np.nanmax(compared.apart, initial=0.0) < 2e-7


TestSaving = Saving.TestCase
TestSaving.settings = settings(max_examples=6, stateful_step_count=6, deadline=None)


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
    assert Session.open(tmp_path / "third.rrd").frames_lost == damaged.frames_lost


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
