"""The live loop on simulated sensors that run as fast as they can.

A little over 300 lines: pacing, pairing and latency settings are tested on the same loop.
"""

import gc
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from devices.pairing import FramePair
from devices.sensor import SensorFrame
from fusion.body import KINECT_V1, KINECT_V2
from fusion.calibration.calibration import calibrate, nominal_calibration
from fusion.calibration.calibrator import Calibrator
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.fusing.pairs import fuse_one
from recordings.session_arrays import SessionArrays
from tests.helpers.session_text import rows_of
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving, pair_of, standing
from viewer_app.cli import main
from viewer_app.commands import demo
from viewer_app.running.loop import low_latency, run_live
from viewer_app.sinks.sink import Sink

NOMINAL = FusionSetup(nominal_calibration(KINECT_V1))


def test_calibration_is_provisional_at_first_and_settles_on_the_start_up_pose() -> None:
    calibrator = Calibrator(KINECT_V2)
    found = []
    for t, at in enumerate(moving(KINECT_V2, 120)):
        calibration = calibrator.watch(pair_of(KINECT_V2, at, t * FRAME_NS))
        if calibration is not None:
            found.append((t, calibration.how))
    assert [how.split(",")[0] for _, how in found] == ["provisional", "provisional", "start-up pose"]
    assert found[0][0] == 0
    assert calibrator.settled
    np.testing.assert_allclose(calibrator.calibration.bone_lengths, KINECT_V2.nominal_lengths, atol=1e-5)


def test_an_earlier_calibration_is_kept() -> None:
    pairs = [pair_of(KINECT_V2, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V2, 60))]
    before = calibrate(KINECT_V2, pairs[:30], "before")
    calibrator = Calibrator(KINECT_V2, before)
    assert all(calibrator.watch(pair) is None for pair in pairs)
    assert calibrator.calibration is before


class ResetSensors:
    """Two sensors. The clock of A is set back by a second, then A misses a frame."""

    stream_figures, waiting = None, False

    def pairs(self) -> Iterator[FramePair]:
        truth = standing(KINECT_V1)
        for t in range(4):
            time_ns, clock_ns = 10**10 + t * FRAME_NS, 10**10 + t * FRAME_NS - (10**9 if t > 1 else 0)
            pair = pair_of(KINECT_V1, truth, clock_ns)
            a = SensorFrame(clock_ns, {"1": pair.a}) if t < 3 else None
            yield FramePair(a, SensorFrame(clock_ns, {"1": pair.b}), SkeletonPair(None, None, time_ns))

    def events(self) -> tuple[()]:
        return ()


def test_the_truth_is_that_of_a_sensors_own_time() -> None:
    asked: list[int] = []

    def truth_at(time_ns: int) -> np.ndarray:
        asked.append(time_ns)
        return standing(KINECT_V1)

    run_live(ResetSensors(), NOMINAL, Sink(), truth_at=truth_at)
    start = 10**10
    assert asked == [start, start + FRAME_NS, *(start + t * FRAME_NS - 10**9 for t in (2, 3))]


@dataclass
class TwoPeople:
    """Two sensors that see two people: one is in the middle of A's view, the other in the middle of B's."""

    where: tuple[list[float], list[float]]  # metres in K_A's frame, from the standing person
    stream_figures, waiting = None, False

    def pairs(self) -> Iterator[FramePair]:
        for t in range(3):
            seen = [pair_of(KINECT_V1, standing(KINECT_V1) + np.array(at), t * FRAME_NS) for at in self.where]
            a = SensorFrame(t * FRAME_NS, {"1": seen[0].a, "2": seen[1].a})
            b = SensorFrame(t * FRAME_NS, {"8": seen[1].b, "9": seen[0].b})
            yield FramePair(a, b, SkeletonPair(None, None, t * FRAME_NS))

    def events(self) -> tuple[()]:
        return ()


@pytest.mark.parametrize(("known", "b_follows"), [(False, "8"), (True, "9")])
def test_both_sensors_follow_one_person_once_they_know_each_others_place(known: bool, b_follows: str) -> None:
    a_from_b = A_FROM_B
    middle = standing(KINECT_V1)[list(KINECT_V1.torso)].mean(axis=0)
    # the first 1.9 m before A, the second 2.6 m before B, each on that sensor's axis; about a metre apart
    first, second = np.array([0.0, 0.0, 1.9]), a_from_b.apply([0.0, 0.0, 2.6])
    pair = pair_of(KINECT_V1, standing(KINECT_V1))
    _, frames = run_live(
        TwoPeople(((first - middle).tolist(), (second - middle).tolist())),
        FusionSetup(calibrate(KINECT_V1, [pair], "before")) if known else NOMINAL,
        Sink(),
        calibrated=known,
    )
    for pair in (frame.pair for frame in frames):
        assert pair.skeletons.a is pair.a.people["1"]
        assert pair.skeletons.b is pair.b.people[b_follows]


def test_stacking_keeps_what_the_loop_gave() -> None:
    pairs = [pair_of(KINECT_V1, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V1, 20))]
    fuser = Fuser(FusionSetup(calibrate(KINECT_V1, pairs, "test")))
    frames = [
        fuse_one(
            fuser,
            FramePair.of(
                SensorFrame(p.time_ns, {"1": p.a}),
                SensorFrame(p.time_ns, {"1": p.b} if t else {}),
                "1",
                "1",
                p.time_ns,
            ),
        )
        for t, p in enumerate(pairs)
    ]
    rows = SessionArrays.stack(KINECT_V1, fuser.setup.calibration.bone_lengths, frames)
    assert len(rows) == 20
    assert np.isnan(rows.positions_b[0]).all()
    assert (rows.states_b[0] == 0).all()
    assert (rows.fused[3] == frames[3].fused.positions).all()
    assert rows.time_ns[-1] == 19 * FRAME_NS
    # without noise S_B in A's frame equals S_A, to float32
    np.testing.assert_allclose(rows.b_in_a[1:], rows.positions_a[1:], atol=3e-6)
    assert rows.disagreement[1:].max() < 3e-6
    assert np.isnan(rows.disagreement[0])
    assert rows.bone_error.max() < 1e-9


def test_the_demo_saves_a_session_and_prints_its_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "demo.rrd"
    main(["demo", "--seconds", "2.5", "--depth", "none", "--no-viewer", "--save", str(saved), "--verbose"])
    said = capsys.readouterr().out
    assert "Distance from the true joints" in said
    for entity in ("/truth/skeleton", "/fused/skeleton", "/kinect_b/skeleton"):
        assert rows_of(saved, entity) > 0
    assert rows_of(saved, "/calibration") >= 1
    assert [p.name for p in tmp_path.iterdir()] == ["demo.rrd"]


def test_the_demo_refuses_what_it_does_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in (
        (["--motion", "flying"], "No movement 'flying'"),
        (["--seconds", "-1"], "--seconds must be a positive number"),
        (["--motion", "nowhere.bvh"], "nowhere.bvh"),
    ):
        with pytest.raises(SystemExit) as stop:
            main(["demo", "--no-viewer", *arguments])
        assert stop.value.code == 2
        said = capsys.readouterr().err
        assert words in said
        assert said.count("\n") == 1


def test_latency_settings_apply_only_while_the_loop_runs() -> None:
    before = sys.getswitchinterval()
    with low_latency():
        assert sys.getswitchinterval() < 0.001  # what logging may hold up the loop by
        assert len(gc.get_objects()) < 1000  # what a search for garbage goes through
    assert sys.getswitchinterval() == before
    assert gc.get_freeze_count() == 0


def test_a_demo_replaces_no_existing_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "has_display", lambda: False)
    precious = tmp_path / "demo.rrd"
    precious.write_text("precious")
    with pytest.raises(SystemExit) as stopped:
        main(["demo", "--seconds", "0.3", "--depth", "none", "--no-viewer", "--save", "demo.rrd"])
    assert stopped.value.code == 2
    assert "demo.rrd exists already" in capsys.readouterr().err
    main(["demo", "--seconds", "0.3", "--depth", "none"])
    assert precious.read_text() == "precious"
    assert rows_of(tmp_path / "demo-2.rrd", "/fused/skeleton") > 0
