"""A person who knows only the headline and does what it says: python -m tests.experiments.followed_headline
BODY FIRST COUNT.

Each rig is random: sensors 15 to 150° apart, 1.2 to 4.8 m away, 0.5 to 2.1 m high, aimed up to 15° aside. One
run of the program sees all that is moved. Prints each headline, and the mean error of S* once it is READY.
"""

import re
import sys
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from devices.simulated.demonstration import demonstrated
from devices.simulated.kinect import Beside, Scene, SimulatedKinect, Truth
from devices.simulated.rig import Rig
from fusion.body import BODIES
from fusion.calibration.calibration import nominal_calibration
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.appearance.state_card import State
from recordings.live_fusion import LiveFusion
from tests.helpers.frame_pairs import frame_pair
from viewer_app.coach.readiness import Readiness
from viewer_app.coach.setup_coach import Coach, Situation

ATTEMPTS, JUDGED = 12, 5.0


@dataclass(frozen=True)
class Place:
    """Where a sensor stands and looks: metres and degrees, in the world of :class:`Rig`."""

    at: tuple[float, float]
    height: float
    yaw: float
    tilt: float

    def aimed(self, person):
        return replace(self, yaw=float(np.degrees(np.arctan2(*(person - self.at)))))

    @property
    def pose(self):
        yaw, tilt = np.radians((self.yaw, self.tilt))
        turned = np.array(
            [[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]]
        )
        down = np.array(
            [[1.0, 0.0, 0.0], [0.0, np.cos(tilt), np.sin(tilt)], [0.0, -np.sin(tilt), np.cos(tilt)]]
        )
        return RigidTransform.of(turned @ down, (self.at[0], -self.height, self.at[1]))


@dataclass(frozen=True)
class Placed(Rig):
    """Two sensors anywhere."""

    places: tuple[Place, ...] = ()

    def world_from_sensor(self, which):
        return self.places[which].pose


class Program:
    """One live run, while person and sensors move between attempts."""

    def __init__(self, body):
        self.body, self.fusion, self.passed_ns = body, None, 0
        self.readiness = Readiness()

    def attempt(self, places, person, motion, seconds, seed):
        """The last headlines, the ring in the world, and the errors of S* while READY, metres."""
        rig, movement = Placed(places=places), demonstrated(motion)
        scene = Scene(Beside(movement, (person[0], 0.0, person[1])), self.body, seconds=seconds, seed=seed)
        sensors = [SimulatedKinect(scene, rig, which) for which in (0, 1)]
        cameras = tuple(each.intrinsics for each in sensors)
        if self.fusion is None:
            self.fusion = LiveFusion(FusionSetup(nominal_calibration(self.body), None, *cameras))
            self.coach = Coach(self.body, cameras)
        truth, shown, errors = Truth(scene, rig), [], []
        for frames in zip(*(each.frames() for each in sensors), strict=True):
            own_ns = frames[0].time_ns
            a, b = map(self._later, frames)
            name = next(iter({**a.people, **b.people}), "")
            pair = self.fusion.chosen(frame_pair(a, b, name, a.time_ns, b.time_ns - a.time_ns))
            frame = self.fusion.fuse(pair)
            self.fusion.learn(frame)
            calibrator = self.fusion.calibrator
            now = Situation(self.fusion.setup.calibration, calibrator.final, calibrator.held)
            headline = self.readiness.watch(
                1e-9 * pair.time_ns, self.coach.watch(frame, now), now.calibration
            )
            if own_ns > 1e9 * (seconds - JUDGED):
                shown.append(headline)
            if headline.state is State.READY and frame.fused.has_person:
                off = frame.fused.positions - truth.positions_at(own_ns)
                errors.append(float(np.nanmean(np.linalg.norm(off, axis=1))))
        self.passed_ns += round(1e9 * (seconds + 2.0))
        spot = self.coach.ring(frame)
        return shown, places[0].pose.apply(np.array([[spot.x, 0.0, spot.z]]))[0, [0, 2]], errors

    def _later(self, frame):
        time_ns = frame.time_ns + self.passed_ns
        people = {name: replace(each, time_ns=time_ns) for name, each in frame.people.items()}
        return replace(frame, time_ns=time_ns, people=people)


def done(headline, places, person, ring):
    """The sensors, the person and the motion after what a headline says was done."""
    places, step, k = list(places), headline.step, "AB".find(headline.side)
    if "round you" in step or "aim A and B" in step:
        far = [np.hypot(*(person - each.at)) for each in places]
        if "aim" in step:
            far = [2.5, 2.5]
        ways = [np.arctan2(*(np.array(each.at) - person)) for each in places]
        between = (ways[1] - ways[0] + np.pi) % (2.0 * np.pi) - np.pi
        ways[1] = ways[0] + np.copysign(0.5 * np.pi, between)
        at = [person + d * np.array([np.sin(way), np.cos(way)]) for d, way in zip(far, ways, strict=True)]
        places = [replace(each, at=tuple(xz)).aimed(person) for each, xz in zip(places, at, strict=True)]
        if "aim" in step:  # at the trunk
            downs = [float(np.degrees(np.arctan2(each.height - 0.95, 2.5))) for each in places]
            places = [replace(each, tilt=down) for each, down in zip(places, downs, strict=True)]
    elif turn := re.search(r"(tilt|turn) .*?(\d+)°", step):
        there = "ring" not in step or np.linalg.norm(ring - person) < 0.25
        by = float(turn[2]) * (-1 if "up by" in step or "to its left" in step else 1)
        if not there:
            person = ring
        elif turn[1] == "tilt":
            places[k] = replace(places[k], tilt=places[k].tilt + by)
        else:
            places[k] = replace(places[k], yaw=places[k].yaw + by)
    elif far := re.search(r"(back|come) (\d+\.\d) m", step):
        way = person - places[k].at
        by = float(far[2]) * (1 if far[1] == "back" else -1)
        person = person + by * way / np.linalg.norm(way)
    elif "in front of it" in step:
        yaw = np.radians(places[k].yaw)
        person = places[k].at + 2.5 * np.array([np.sin(yaw), np.cos(yaw)])
    elif "ring" in step:
        person = ring
    return tuple(places), person, "walk" if "walk" in step else "startup"


def followed(body, seed):
    """The headlines that were followed, and the mean error of S* when READY; None if it never was."""
    random = np.random.default_rng(seed)
    angle, person, places = random.uniform(15.0, 150.0), np.zeros(2), []
    for way in np.radians((-0.5 * angle, 0.5 * angle)):
        far, height = random.uniform(1.2, 4.8), random.uniform(0.5, 2.1)
        place = Place((far * np.sin(way), -far * np.cos(way)), height, 0.0, random.uniform(-8.0, 20.0))
        aimed = place.aimed(person)
        places.append(replace(aimed, yaw=aimed.yaw + random.uniform(-15.0, 15.0)))
    program, motion, steps = Program(body), "startup", []
    for attempt in range(ATTEMPTS):
        seconds = 20.0 if motion == "walk" else 10.0
        shown, ring, errors = program.attempt(tuple(places), person, motion, seconds, 100 * seed + attempt)
        if 2 * sum(each.state is State.READY for each in shown) > len(shown):
            return steps, float(np.mean(errors))
        headline = Counter(each for each in shown if each.kind).most_common(1)[0][0]
        if not steps or (steps[-1].kind, steps[-1].side) != (headline.kind, headline.side):
            steps.append(headline)
        places, person, motion = done(headline, places, person, ring)
    return steps, None


def main(name, first, count):
    ready = 0
    for seed in range(int(first), int(first) + int(count)):
        steps, error = followed(BODIES[name], seed)
        ready += error is not None and len(steps) <= 5
        end = "never READY" if error is None else f"READY, S* {1e3 * error:.0f} mm off"
        print(f"{seed}: {end} after {len(steps)} steps", *(each.step for each in steps), sep="\n    ")
    print(f"READY within five steps: {ready} of {count}")


if __name__ == "__main__":
    main(*sys.argv[1:])
