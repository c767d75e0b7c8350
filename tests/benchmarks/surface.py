"""What depth images give the registration and S*: ``python -m tests.benchmarks.surface``.

Two simulated sensors see a person, recorded and live, with each part of the surface's fit left out once.
Depth images have the errors of real sensors; in each scene, both cameras also show all things too far away,
by as much as two devices of one model differ. They have half the size but at 120°. The figures are written to
``results/surface.json``.
"""

import argparse
from collections.abc import Callable
from concurrent.futures import wait
from dataclasses import replace
from itertools import chain, product
from unittest.mock import patch

import numpy as np

from devices.depth.point_cloud import ray_table
from devices.depth.surface import shared_surface
from devices.simulated.demonstration import demonstrated
from devices.simulated.kinect import simulated_pair
from devices.simulated.rig import Rig
from fusion.body import BODIES
from fusion.calibration import surface_fit
from fusion.calibration.calibration import nominal_calibration
from fusion.plan import plan_recording
from fusion.setup import FuserSettings, FusionSetup
from recordings.fusing.pairs import fuse_segments, setups_of
from recordings.live_fusion import LiveFusion
from tests.benchmarks import results
from tests.helpers.frame_pairs import KnownSensors, paired

_COMMON = 0.005  # metres, standard deviation of the unknown depth offset that both cameras share
_WITHIN = 2.5  # stated standard deviations
_WARM_UP_NS = 4_000_000_000  # the start-up pose
_LIVE_NS = 20_000_000_000  # what live has learned by then is measured
SETTINGS = FuserSettings(hindsight="labels")


class Recorded:
    """A scene: pairs with depth images, and the truth."""

    def __init__(self, body, motion, angle, seed, seconds, depth="half"):
        rng = np.random.default_rng(seed)
        a, b, self.truth = simulated_pair(
            motion=motion,
            body=body,
            rig=Rig(angle_deg=angle),
            seconds=seconds,
            seed=seed,
            depth=depth,
        )
        self.body, self.cameras = body, (a.intrinsics, b.intrinsics)
        common = rng.normal(0.0, _COMMON)
        self.frames = [
            [replace(frame, depth=_farther(frame.depth, camera, common)) for frame in sensor.frames()]
            for sensor, camera in zip((a, b), self.cameras, strict=True)
        ]
        self.pairing = paired(*self.frames)
        self.times = np.array([pair.time_ns for pair in self.pairing.pairs])
        self.joints = self.truth.positions_at(self.times)

    def surfaces(self, moments):
        """What the depth images of some pairs show to both sensors."""
        images = [{k: frame.depth for k, frame in enumerate(seen)} for seen in self.frames]
        return shared_surface(moments, images, self.cameras)

    def of_file(self, surfaces):
        """The calibration and S* (T, J, 3) of the recording."""
        pairs = self.pairing.pairs
        plan = plan_recording(self.body, pairs.skeletons, SETTINGS, surfaces=surfaces)
        segments = setups_of(plan, SETTINGS, (None, None))
        frames = chain.from_iterable(fuse_segments(segments, pairs, plan.labels))
        return plan.segments[-1][0], np.array([frame.fused.positions for frame in frames])

    def live(self, cameras):
        """The same of a live run; without images if the cameras are None."""
        setup = FusionSetup(nominal_calibration(self.body), None, *self.cameras)
        fusion, fused = LiveFusion(setup), []
        moments = zip(*self.frames, self.pairing.pairs, strict=True)
        pairs = [replace(pair, a=a, b=b) for a, b, pair in moments]
        for frame in fusion.frames(KnownSensors(pairs, cameras=cameras)):
            fused.append(frame.fused.positions)
            fusion.learn(frame)
            if fusion._surface is not None and fusion._surface._fit is not None:
                wait([fusion._surface._fit[1]])
        return fusion.setup.calibration, np.array(fused)

    def figures(self, calibration, fused, from_ns):
        """Errors of R and t, whether they are within what is stated, and of S*, also after a common shift."""
        late = self.times - self.times[0] >= from_ns
        truth, known = self.truth.a_from_b, calibration.registration
        there = self.joints[late].mean(axis=(0, 1))
        turn = calibration.a_from_b.angle_to(truth)
        shift = np.linalg.norm(calibration.a_from_b.apply(truth.inverse().apply(there)) - there)
        off = fused[late] - self.joints[late]
        return {
            "turn": turn,
            "shift": shift,
            "within": float(turn < _WITHIN * known.rotation_sd) / 2
            + float(shift < _WITHIN * known.translation_sd) / 2,
            "error": np.nanmean(np.linalg.norm(off, axis=2)),
            "apart": np.nanmean(np.linalg.norm(off - np.nanmean(off, axis=(0, 1)), axis=2)),
        }


def _farther(depth, camera, metres):
    """A depth image whose readings are farther away along their rays."""
    length = np.linalg.norm(ray_table(camera), axis=2)
    far = np.rint(depth + 1e3 * metres / length)
    return np.where(depth > 0, np.clip(far, 1, 65535), 0).astype(np.uint16)


def _without_floor(surfaces):
    return lambda moments: surfaces(moments)._replace(floors=(None, None))


def _without_depth_errors(recorded):
    with patch.object(surface_fit, "depth_errors", lambda *_: np.zeros(2)):
        return recorded.of_file(recorded.surfaces)


VARIANTS: dict[str, tuple[Callable, int]] = {
    "file, joints": (lambda of: of.of_file(None), _WARM_UP_NS),
    "file, surface": (lambda of: of.of_file(of.surfaces), _WARM_UP_NS),
    "file, without the floor": (lambda of: of.of_file(_without_floor(of.surfaces)), _WARM_UP_NS),
    "file, without the views' depth errors": (_without_depth_errors, _WARM_UP_NS),
    "live, joints": (lambda of: of.live((None, None)), _LIVE_NS),
    "live, surface": (lambda of: of.live(of.cameras), _LIVE_NS),
}
"""By name: the calibration and S* of a scene, and since when it is measured."""


def _images(angle):
    """The size of depth images of sensors so far apart: whole ones, where little is seen by both."""
    return "full" if angle > 100.0 else "half"


def of_scenes(scenes):
    """The mean figures of each variant."""
    rows = {name: [] for name in VARIANTS}
    for recorded in scenes:
        for name, (run, from_ns) in VARIANTS.items():
            rows[name].append(recorded.figures(*run(recorded), from_ns))
    return {
        name: {figure: float(np.mean([row[figure] for row in of])) for figure in of[0]}
        for name, of in rows.items()
    }


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, nargs="*", default=[7900])
    parser.add_argument("--motions", nargs="*", default=["walk", "squat", "arms"])
    parser.add_argument("--angles", type=float, nargs="*", default=[60.0, 90.0, 120.0])
    parser.add_argument("--seconds", type=float, default=26.0)
    options = parser.parse_args()
    found = {}
    scenes = list(enumerate(product(options.motions, options.angles, options.seeds)))
    for name in ("azure_kinect", "kinect_v2"):
        body = BODIES[name]
        made = (
            Recorded(body, demonstrated(motion), angle, seed + k, options.seconds, _images(angle))
            for k, (motion, angle, seed) in scenes
        )
        found[name] = of_scenes(made)
    for name, rows in found.items():
        for variant, row in rows.items():
            print(f"{name:16} {variant:40}", *(f"{figure} {value:.4f}" for figure, value in row.items()))
    results.write("surface", found)


if __name__ == "__main__":
    main()
