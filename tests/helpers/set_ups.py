"""Set-ups of the simulator without their clock: what the coach's headline and page say over time."""

from dataclasses import dataclass, replace

from devices.sensor import SensorFrame
from devices.simulated.demonstration import demonstrated, good_rig, therapist
from devices.simulated.kinect import Scene, SimulatedKinect
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton
from recordings.appearance.coach_page import CoachPage
from recordings.data.session_arrays import SessionFrame
from recordings.live_fusion import LiveFusion
from tests.helpers.frame_pairs import frame_pair
from viewer_app.coach.readiness import Headline, Readiness
from viewer_app.coach.scene import CoachScene
from viewer_app.coach.setup_coach import Coach, Situation


@dataclass(frozen=True)
class SetUp:
    """Where the sensors stand, and what is wrong."""

    rig: Rig
    mirrored_b: bool = False
    someone_else: bool = False
    motion: str = "walk"


SET_UPS = {
    "good": SetUp(good_rig(AZURE_KINECT)),
    "too near": SetUp(Rig(distance=1.3, height=1.2)),
    "30 degrees apart": SetUp(replace(good_rig(AZURE_KINECT), angle_deg=30.0)),
    "feet out of view": SetUp(Rig(distance=2.6, height=1.6, tilt_deg=-14.0)),
    "mirrored B": SetUp(good_rig(AZURE_KINECT), mirrored_b=True),
    "someone else": SetUp(good_rig(AZURE_KINECT), someone_else=True),
}


@dataclass(frozen=True)
class Moment:
    """One frame and what the coach says with it."""

    seconds: float
    setup: FusionSetup
    frame: SessionFrame
    headline: Headline
    page: CoachPage


def moments(of: SetUp, seconds: float):
    """Yields the moments of a set-up, fused as the live loop does."""
    other = therapist() if of.someone_else else None
    scene = Scene(demonstrated(of.motion), AZURE_KINECT, seconds=seconds, other=other)
    a, b = (SimulatedKinect(scene, of.rig, which) for which in (0, 1))
    setup = FusionSetup(nominal_calibration(AZURE_KINECT), None, a.intrinsics, b.intrinsics)
    fusion, coach, readiness = LiveFusion(setup), Coach(AZURE_KINECT, setup.intrinsics), Readiness()
    drawings = CoachScene(AZURE_KINECT, setup.intrinsics)
    for one, other_view in zip(a.frames(), b.frames(), strict=True):
        seen_by_b = _mirrored(other_view) if of.mirrored_b else other_view
        skew_ns = other_view.time_ns - one.time_ns
        person = next(iter(one.people), "")
        pair = fusion.chosen(frame_pair(one, seen_by_b, person, one.time_ns, skew_ns))
        frame = fusion.fuse(pair)
        fusion.learn(frame)
        now = Situation(fusion.setup.calibration, fusion.calibrator.final, fusion.calibrator.held)
        advice = coach.watch(frame, now)
        time = pair.time_ns * 1e-9
        shown = readiness.watch(time, advice, now.calibration)
        page = drawings.page(readiness.advice, now, frame.fused, shown)
        yield Moment(time, fusion.setup, frame, shown, page)


def _mirrored(frame: SensorFrame) -> SensorFrame:
    people = {
        name: Skeleton.of(each.body, each.positions * (-1.0, 1.0, 1.0), each.states, each.time_ns)
        for name, each in frame.people.items()
    }
    return replace(frame, people=people)
