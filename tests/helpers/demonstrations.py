"""``duplex demo`` without its clock, its images and its viewer: its pairs, its S* and its coach's advice."""

from dataclasses import dataclass, replace

from devices.findings.rules import RULES
from devices.simulated.demonstration import Demonstration, demonstrated, demonstration
from devices.simulated.kinect import PERSON, Scene, simulated_pair
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.calibration.calibration import calibrate, nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.data.session_arrays import SessionFrame
from recordings.fusing.pairs import fuse_one
from recordings.live_fusion import LiveFusion
from tests.helpers.frame_pairs import frame_pair
from viewer_app.coach.setup_coach import Coach, Situation


def pairs_of(a, b):
    """The frames of two sensors that drop none."""
    for one, other in zip(a.frames(), b.frames(), strict=True):
        yield frame_pair(one, other, PERSON, one.time_ns, other.time_ns - one.time_ns)


@dataclass(frozen=True)
class Run:
    """The frames of a demonstration, also by their setups, and the events of its fusion: seconds and text."""

    shown: Demonstration
    frames: list[SessionFrame]
    events: list[tuple[float, str]]
    parts: list[tuple[FusionSetup, list[SessionFrame]]]


def fused_demonstration(body, seconds, motion="badminton"):
    """Fuses a demonstration as the live loop does."""
    shown = demonstration(Scene(demonstrated(motion), body, seconds=seconds))
    setup = FusionSetup(nominal_calibration(body), None, shown.a.intrinsics, shown.b.intrinsics)
    fusion, run = LiveFusion(setup), Run(shown, [], [], [])
    for pair in pairs_of(shown.a, shown.b):
        run.frames.append(fusion.fuse(pair))
        if not run.parts or run.parts[-1][0] is not fusion.setup:
            run.parts.append((fusion.setup, []))
        run.parts[-1][1].append(run.frames[-1])
        run.events.extend((pair.time_ns * 1e-9, event.text) for event in fusion.learn(run.frames[-1]))
    return run


def findings_over(rig, body, motion, seconds=24.0, fps=1.5):
    """The coach's findings that are events, the first of each, while a person moves before two sensors.

    Few frames per second are enough: nothing is found in single frames. The calibration is that of a
    start-up pose seen without errors, and S* is that of the first frame: what compares the views is left out.
    """
    rig = replace(rig, frame_seconds=1.0 / fps, skew_seconds=0.0)
    a, b, _ = simulated_pair(motion=demonstrated(motion), body=body, seconds=seconds, rig=rig)
    calibration = _calibration(rig, body)
    first = None
    coach = Coach(body, (_lens(a), _lens(b)), rate=fps)
    said = {}
    for pair in pairs_of(a, b):
        first = first or fuse_one(Fuser(FusionSetup(calibration)), pair)
        frame = replace(first, pair=pair)
        for found in coach.watch(frame, Situation(calibration, final=True, held=0.0)):
            if RULES[found.rule].is_event and found.rule not in ("views", "moved", "error"):
                said.setdefault((found.rule, found.side), found)
    return list(said.values())


def _calibration(rig, body):
    a, b, _ = simulated_pair(
        motion="startup", body=body, seconds=5 * rig.frame_seconds, rig=rig, errors=TrackerErrors()
    )
    return calibrate(body, [pair.skeletons for pair in pairs_of(a, b)], "start-up pose")


def _lens(sensor):
    assert sensor.intrinsics is not None
    return sensor.intrinsics
