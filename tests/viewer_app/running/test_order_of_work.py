"""What the loop and its threads do first: a frame is handed over before anything that can wait."""

import sys
from itertools import islice

import pytest

from devices.depth import witness as depth_witness
from devices.pairing import FramePair
from devices.simulated.kinect import simulated_pair
from fusion.body import KINECT_V1
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.registration import refinement
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.fusing.live_fusion import LiveFusion
from tests.helpers.frame_pairs import KnownSensors
from viewer_app.running.loop import run_live
from viewer_app.sinks.sink import FanOut, Sink


def walking(count):
    """Pairs of a simulated walk, with images, and the setup at the start."""
    a, b, _ = simulated_pair(motion="walk", body=KINECT_V1, depth="half")
    setup = FusionSetup(nominal_calibration(a.body), None, a.intrinsics, b.intrinsics)
    both = islice(zip(a.frames(), b.frames(), strict=False), count)
    return setup, [FramePair(of_a, of_b, SkeletonPair(None, None, of_a.time_ns)) for of_a, of_b in both]


@pytest.mark.parametrize("waiting", [False, True])
def test_a_frame_is_handed_over_before_the_program_learns_from_it(waiting, monkeypatch):
    """And learning leaves the viewer's thread alone, unless the next frame waits already."""
    done = []

    class Handed(Sink):
        def write(self, frame):
            assert frame.fused.has_person
            done.append("handed over")

        def rest(self, seconds):
            assert 0.0 < seconds < 0.5 / 30.0
            done.append("rested")

    learn = LiveFusion.learn
    monkeypatch.setattr(LiveFusion, "learn", lambda *of: (done.append("learned"), learn(*of))[1])
    setup, pairs = walking(2)
    run_live(KnownSensors(pairs, waiting), setup, FanOut([Handed()]))
    assert done == ["handed over", *([] if waiting else ["rested"]), "learned"] * 2


def test_nothing_is_compiled_after_the_first_frame(monkeypatch):
    """What a live session calls is compiled before its sensors open: a kernel takes seconds."""
    fits = []
    fit = refinement.fit_robust
    monkeypatch.setattr(refinement, "fit_robust", lambda *of, **more: (fits.append(1), fit(*of, **more))[1])
    setup, pairs = walking(240)
    Fuser(setup).warm_up()
    depth_witness.warm_up()
    fusion = LiveFusion(setup)
    before = compiled()
    for pair in pairs:
        fusion.learn(fusion.fuse(fusion.chosen(pair)))
    assert fusion.calibrator.final
    assert len(fits) >= 3, "a whole proposal"
    assert compiled() == before


def compiled():
    """How many versions each kernel of the method and of the devices has."""
    modules = list(sys.modules.values())
    return {
        f"{module.__name__}.{name}": len(kernel.overloads)
        for module in modules
        if module.__name__.startswith(("fusion", "devices.depth.witness", "devices.depth.rvl"))
        for name, kernel in vars(module).items()
        if hasattr(kernel, "overloads")
    }
