"""The pytest plugin, as a user's own tests meet it: in a fresh folder, with nothing configured."""

import re
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from devices.sensor import DeviceError
from fusion.body import KINECT_V1
from fusion.setup import FuserSettings
from recordings import RecordingError, Session, fuse
from recordings.comparing.session_differences import write_worst_moment
from recordings.testing import SessionsDifferError, assert_sessions_match, simulated_session
from tests.helpers.command_line import duplex
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.programs import ROOT
from tests.helpers.recorded_pairs import write_recordings
from tests.helpers.two_views import calibration_of

pytest_plugins = "pytester"

OWN = """
import pytest
from recordings import Session
from recordings.testing import assert_sessions_match

@pytest.mark.parametrize("seed", [7, 8])
def test_walk(seed):
    assert_sessions_match(f"walk_{seed}.rrd", f"kept/expected_{seed}.rrd", position_mm=0.0)

def test_apart():
    assert_sessions_match("walk_7.rrd", Session.open("walk_8.rrd"))
"""


@pytest.fixture(scope="module", autouse=True)
def walks(tmp_path_factory):
    """Sessions by seed. Imports what the tests use before pytester, which forgets later imports."""
    folder = tmp_path_factory.mktemp("walks")
    made = {seed: simulated_session(seconds=1.0, seed=seed) for seed in (7, 8)}
    for seed, session in made.items():
        session.save(folder / f"walk_{seed}.rrd")
    fuse(*write_recordings(folder))
    duplex("compare", "--any-capture", *folder.glob("*.rrd"), "--no-viewer")
    write_worst_moment(made[7], made[8], folder / "worst.png")
    return {seed: Session.open(folder / f"walk_{seed}.rrd") for seed in made}


@pytest.fixture
def run(pytester):
    """Runs pytest in the folder of a user's tests; returns its output and how many passed and failed."""

    def run_pytest(*arguments, how=pytester.runpytest_inprocess):
        result = how(*arguments)
        outcomes = result.parseoutcomes()
        return result.stdout.str(), outcomes.get("passed", 0), outcomes.get("failed", 0)

    return run_pytest


def printed_command(said, label):
    return shlex.split(re.search(rf"^E +{label}: +(.*)$", said, re.MULTILINE)[1])


def test_the_example_makes_its_expected_file_and_shows_what_changed(run, pytester, capsys):
    write_recordings(pytester.path)
    example = (ROOT / "examples" / "test_fusion.py").read_text(encoding="utf-8")
    own = pytester.makepyfile(test_fusion=example)
    said, passed, failed = run()
    assert (passed, failed) == (1, 1)
    assert "There is no" in said
    program, *update = printed_command(said, "to make it, with a version that you trust")
    assert program == "pytest"
    said, *counts = run(*update)
    assert (counts, "Wrote expected.rrd." in said) == ([1, 0], True)

    other = example.replace('"b.csv")', '"b.csv", settings=FuserSettings(smoothing=1.0))')
    own.write_text(f"from fusion import FuserSettings\n{other}", encoding="utf-8")
    said, passed, failed = run("-k", "has_not_changed")
    assert (passed, failed) == (0, 1)
    assert re.search(r"S\* +all joints +\d+ ", said)
    assert not re.search(r"S_[AB] +all joints", said)
    program, *compare = printed_command(said, "to see it")
    assert (program, duplex(*compare, "--no-viewer")) == ("duplex", 0)
    assert "70 frames in common" in capsys.readouterr().out
    _, actual, expected = compare
    assert Session.open(pytester.path / actual).settings.smoothing == 1.0
    assert_sessions_match(pytester.path / expected, pytester.path / "expected.rrd", position_mm=0.0)
    assert re.search(r"^E +expected is .*expected.rrd$", said, re.MULTILINE)
    picture = pytester.path / re.search(r"^E +picture: +(.*)$", said, re.MULTILINE)[1]
    assert picture.parent == (pytester.path / actual).parent
    assert imread(picture).shape[:2] == (605, 990)
    assert printed_command(said, "to accept it")[1:] == update


def test_a_file_that_cannot_be_read_shows_the_test_s_own_line(run, pytester):
    pytester.makepyfile(
        test_own="from recordings.testing import assert_sessions_match\n\n\n"
        "def test_files():\n    assert_sessions_match('nothing.rrd', __file__)\n"
    )
    said, *counts = run()
    assert counts == [0, 1]
    assert re.findall(r"^(\S+\.py:\d+): ", said, re.MULTILINE) == ["test_own.py:5"]
    assert "No session nothing.rrd" in said


def test_processes_of_xdist_share_the_option_and_the_expected_files(run, pytester, walks, capsys):
    for walk in walks.values():
        shutil.copy(walk.path, pytester.path)
    pytester.makepyfile(test_own=OWN)
    said, *counts = run("-n", "2", "--duplex-update", how=pytester.runpytest_subprocess)
    assert counts == [2, 1]
    assert len(re.findall(r"^Wrote kept/expected_[78].rrd.$", said, re.MULTILINE)) == 2
    for seed, walk in walks.items():
        assert_sessions_match(pytester.path / "kept" / f"expected_{seed}.rrd", walk, position_mm=0.0)
    assert "of different captures" in said
    program, *compare = printed_command(said, "to see it")
    assert compare[:2] == ["compare", "--any-capture"]
    capsys.readouterr()
    assert (program, duplex(*compare, "--no-viewer")) == ("duplex", 0)
    assert re.search(r"^(\d+) frames in common, of \1 and \1", capsys.readouterr().out)
    actual = pytester.path / ".pytest_cache" / "d" / "duplex" / "test_own.py_test_apart" / "actual.rrd"
    assert_sessions_match(actual, walks[7], position_mm=0.0)


def test_parts_in_memory_are_kept_without_a_cache_and_named(run, pytester, walks):
    pytester.makepyfile("""
        from recordings.testing import assert_sessions_match

        def test_two(simulated_session):
            pair = [simulated_session(seconds=1.0, seed=seed) for seed in (7, 8)]
            assert pair[0] is simulated_session(seconds=1.0, seed=7) is simulated_session("walk", 1.0, 7)
            assert_sessions_match(*(each.part(slice(5, 25)) for each in pair))
    """)
    said, _, failed = run("-p", "no:cacheprovider")
    assert failed == 1
    kept = [re.search(rf"^E +{name}: +(.*)$", said, re.MULTILINE)[1] for name in ("actual", "expected")]
    for path, seed in zip(kept, walks, strict=True):
        assert_sessions_match(path, walks[seed].part(slice(5, 25)), position_mm=0.0)
    for name in ("actual", "expected"):
        assert f"{name} is frames 5–24 of a capture" in said
    assert "to accept it" not in said, "there is no file to write"


def test_a_session_that_is_not_good_is_kept_and_shown(run, pytester):
    pytester.makepyfile("""
        from recordings.testing import assert_session

        def test_good(simulated_session):
            assert_session(simulated_session(seconds=1.0, seed=7), verdict=None, gap_s=0.001)
    """)
    said, *counts = run()
    assert counts == [0, 1]
    assert re.search(r"there is no S\* for 0\.03 s from .* asked for was 0\.001 s", said)
    program, command, path = printed_command(said, "to see it")
    assert (program, command) == ("duplex", "review")
    assert len(Session.open(pytester.path / path)) == 30
    assert "to accept it" not in said
    assert "picture:" not in said


@pytest.fixture
def session():
    return simulated_session("walk", 1.0, 3, body="kinect_v1", settings=FuserSettings("paper"))


def test_the_table_has_the_differences(session):
    rows = session.rows
    joint = KINECT_V1.joint("wrist left"), KINECT_V1.joint("head")
    moved, lost = rows.fused.copy(), rows.positions_b.copy()
    moved[10:15, joint[0], 1] += [0.001, 0.002, 0.003, 0.004, 0.0300]
    moved[20, joint[1], 0] += 0.0005
    seen = np.flatnonzero(np.isfinite(lost[:, joint[1], 0]))[:3]
    lost[seen, joint[1]] = np.nan
    other = replace(session, rows=replace(rows, fused=moved, positions_b=lost))
    with pytest.raises(SessionsDifferError) as found:
        assert_sessions_match(other, session, position_mm=0.4)
    wrist, head = (KINECT_V1.joints[j] for j in joint)
    table = [line.split() for line in str(found.value).partition("first frame\n")[2].splitlines()]
    assert table == [
        ["S_B", "all", "joints", "3", "3", "–", "–", str(seen[0])],
        ["S_B", head, "3", "3", "–", "–", str(seen[0])],
        ["S*", "all", "joints", "6", "30", "2.5", "10"],
        ["S*", wrist, "5", "30", "3", "10"],
        ["S*", head, "1", "0.5", "0.5", "20"],
    ]
    assert (
        f"S* differs by more than 0.4 mm in 6 of {len(session)} frames (10–14, 20), first at {wrist}"
        in str(found.value)
    )
    nearby = replace(session, rows=replace(rows, fused=moved))
    assert_sessions_match(nearby, session, position_mm=31.0)
    assert found.value.sessions == (other, session)


def test_sessions_that_match_and_that_do_not(fused_run):
    pairs = frame_pairs(KINECT_V1, 70, gap=(7, 40, 41), only_a=(9, 10), no_b=(15,), jitter_ns=3_000_000)
    calibration = calibration_of(KINECT_V1)
    one, two = fused_run(pairs, calibration), fused_run(pairs, calibration)
    assert_sessions_match(one, two, position_mm=0.0)
    other = fused_run(pairs, calibration, FuserSettings("paper", weights="equal"))
    with pytest.raises(AssertionError, match=r"frames \(\d.*\), first at \w+"):
        assert_sessions_match(other, one)
    assert_sessions_match(other, one.path, position_mm=5000.0)
    shorter = fused_run(pairs[:-1], calibration)
    with pytest.raises(AssertionError, match="frames"):
        assert_sessions_match(shorter, one)
    for name in ("time_ns", "skew_ns", "clock_b", "positions_a", "states_b"):
        rows = getattr(one.rows, name).copy()
        rows[12] += 1
        moved = replace(one, rows=replace(one.rows, **{name: rows}))
        with pytest.raises(AssertionError, match=r"frames? .*12.*; the sessions are of different captures"):
            assert_sessions_match(moved, one, position_mm=500.0)
    for tolerance in (float("nan"), -1.0, float("inf")):
        with pytest.raises(RecordingError, match="position_mm is"):
            assert_sessions_match(one, two, position_mm=tolerance)
    nudged = replace(one, rows=replace(one.rows, fused_checksums=one.fused_checksums + np.uint32(1)))
    with pytest.raises(AssertionError, match=r"frame 0: S\* differs"):
        assert_sessions_match(nudged, one, position_mm=0.0)
    assert_sessions_match(nudged, one)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"body": "kinect_v3"}, "There is no body 'kinect_v3'. Choose one of kinect_v1, kinect_v2"),
        ({"seconds": 0}, "lasts more than 0 s; got 0"),
        ({"seconds": float("nan")}, "lasts more than 0 s; got nan"),
        ({"movement": "wlak"}, "wlak"),
    ],
)
def test_a_session_that_cannot_be_simulated_is_refused(arguments, said):
    with pytest.raises(DeviceError, match=re.escape(said)):
        simulated_session(**arguments)
