"""The people of a session of recordings who are not followed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import KINECT_V2
from recordings import fuse
from recordings.data import layout
from recordings.data.images import Images, SessionImages
from recordings.data.session_parts import PartOfImages
from recordings.file.session_writer import write_session
from recordings.quality.figures import report
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.recorded_pairs import write_view
from tests.helpers.two_views import moving
from viewer_app.report.words import lead_lines

FRAMES, FIRST, END = 60, 20, 45
"""The other person is seen from one frame to another."""


def two_files(folder, aside=(0.0, 0.0, 0.0)):
    """The recordings of two sensors, and the other person of each, (n, J, 3) metres; all of them aside."""
    paths, others = [], []
    for side in "ab":
        noise = np.random.default_rng(ord(side)).normal(0.0, 0.005, (FRAMES, 25, 3))
        seen = moving(KINECT_V2, FRAMES) + noise + aside
        other = seen + [1.5, 0.0, 0.5]
        path = folder / f"{side}.csv"
        rows = write_view(path, KINECT_V2, other).read_text().splitlines()[1 + 25 * FIRST : 1 + 25 * END]
        one = write_view(path, KINECT_V2, seen).read_text().splitlines()
        path.write_text("\n".join([*one, *(row.replace(",0,", ",1,", 1) for row in rows)]) + "\n")
        paths.append(path)
        others.append(other[FIRST:END])
    return paths, others


@pytest.fixture(scope="module")
def fused(tmp_path_factory):
    paths, others = two_files(tmp_path_factory.mktemp("two"))
    return fuse(*paths), others


def others_of(session, side):
    return dict(session.images.others(side, range(len(session))))


def test_the_others_are_those_of_the_files(fused):
    session, others = fused
    bones = KINECT_V2.bone_joints
    for side, seen in zip(layout.VIEWS, others, strict=True):
        drawn = others_of(session, side)
        assert list(drawn) == list(range(FIRST, END + 1))
        assert len(drawn.pop(END)) == 0  # the last one clears them
        ends, along = np.stack(list(drawn.values())).transpose(2, 0, 1, 3)
        np.testing.assert_allclose(ends, seen[:, bones], atol=1e-3)
        parents = seen[:, KINECT_V2.parent_indices[bones]]
        np.testing.assert_allclose(ends + along, parents, atol=1e-3)


def test_people_and_the_time_of_the_others_are_told(fused, tmp_path):
    session, _ = fused
    share = (END - FIRST) / FRAMES
    assert [person.ids for person in session.people] == [("0", "0"), ("1", "1")]
    assert report(session)["others_seen"] == pytest.approx(share)
    lines = {line.label: line.text for line in lead_lines(report(session))}
    assert lines["Others"].startswith("seen in 42 % of the frames")
    part = tmp_path / "part.rrd"
    write_session(session.part(range(10, FRAMES)), part)
    assert Session.open(part).people == session.people  # those of the recordings
    assert report(Session.open(part))["others_seen"] == 0.0  # nobody counted


def test_whoever_is_chosen_by_id_is_not_among_the_others(tmp_path):
    paths, others = two_files(tmp_path)
    session = fuse(*paths, person_a="1", person_b="1")
    root = KINECT_V2.root
    followed = session.skeleton_a.positions[FIRST:END, root]
    np.testing.assert_allclose(followed, others[0][:, root], atol=1e-3)
    assert set(others_of(session, "a")) == set(range(FRAMES))


@pytest.mark.parametrize(("options", "ids"), [([], "0"), (["--follow", "middle"], "1")])
def test_the_command_follows_the_one_seen_longest_or_in_the_middle(options, ids, tmp_path):
    paths, _ = two_files(tmp_path, aside=(-1.5, 0.0, 0.0))
    saved = tmp_path / "s.rrd"
    assert duplex("fuse", *paths, *options, "--no-viewer", "--force", "--save", saved) == 0
    assert Session.open(saved).people[0].ids == (ids, ids)


@pytest.mark.parametrize(("first", "end"), [(0, FRAMES), (10, 40), (30, FRAMES), (END, FRAMES), (50, FRAMES)])
def test_a_written_session_keeps_the_others(fused, tmp_path, first, end):
    session, _ = fused
    part, again = tmp_path / "part.rrd", tmp_path / "again.rrd"
    write_session(session.part(range(first, end)), part)
    write_session(Session.open(part), again)
    for side in layout.VIEWS:
        expected = {
            t - first: bones for t, bones in session.images.others(side, range(first, end)) if len(bones)
        }
        for path in (part, again):
            kept = {t: bones for t, bones in others_of(Session.open(path), side).items() if len(bones)}
            assert kept.keys() == expected.keys()
            for t, bones in kept.items():
                np.testing.assert_array_equal(bones, expected[t])


class OthersOf(SessionImages):
    """So many bones in each frame."""

    def __init__(self, counts):
        self.counts = counts

    def others(self, side, frames):
        del side
        shown = (k for k in frames if self.counts[k] or (k > frames.start and self.counts[k - 1]))
        every = [(k, np.zeros((self.counts[k], 2, 3), np.float32)) for k in shown]
        return Images(lambda: iter(every))


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), min_size=1, max_size=25))
def test_a_part_with_gaps_shows_in_each_frame_whom_the_session_shows(frames):
    counts = [count for count, _ in frames]
    kept = np.array([k for k, (_, keeps) in enumerate(frames) if keeps], dtype=np.int64)
    items = list(PartOfImages(OthersOf(counts), kept).others("a", range(len(kept))))
    numbers = [number for number, _ in items]
    assert numbers == sorted(set(numbers))
    shown, newest = 0, {number: len(bones) for number, bones in items}
    for number, of in enumerate(kept.tolist()):
        shown = newest.get(number, shown)
        assert shown == counts[of]


def test_damaged_others_are_counted_where_a_session_is_written(fused, tmp_path):
    whole, damaged = tmp_path / "whole.rrd", tmp_path / "damaged.rrd"
    write_session(fused[0], whole)
    data = bytearray(whole.read_bytes())
    bones = others_of(Session.open(whole), "a")[FIRST + 3]
    at = data.find(bones[:4, 0].tobytes())
    assert at > 0, "the bones are not in the file as they are"
    data[at + 1] ^= 1
    damaged.write_bytes(data)
    assert write_session(Session.open(whole), tmp_path / "again.rrd") == 0
    assert write_session(Session.open(damaged), tmp_path / "part.rrd") == 1


def test_recordings_of_one_person_have_no_others(tmp_path):
    paths = [
        write_view(
            tmp_path / f"{side}.csv",
            KINECT_V2,
            moving(KINECT_V2, FRAMES) + np.random.default_rng(k).normal(0.0, 0.005, (FRAMES, 25, 3)),
        )
        for k, side in enumerate("ab")
    ]
    assert others_of(fuse(*paths), "a") == {}
