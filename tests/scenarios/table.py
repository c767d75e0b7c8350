"""What happens to two live Kinects, and what the program is to say and reach: the same on stand-in and rig.

The keys of the configuration are those of ``../shared/rig/README.md``.
"""

import signal
from dataclasses import dataclass

from devices.capture.causes import Cause
from tests.scenarios.program import Action

CABLE = "a.jack=2 b.jack=1"
_RUNS = "Running"  # printed when the cameras and trackers run
_APART = 30.0 + 1000 / 60  # ms: without a cable S* waits for an image that is up to half a frame later
Events = tuple[tuple[float | str, Action], ...]


@dataclass(frozen=True)
class Scenario:
    """One scenario.

    Attributes:
        name: What happens.
        conf: The configuration at the start.
        options: Of ``duplex live``.
        events: What happens later, each so many seconds after the one before, or when a line matches.
        code: The exit code.
        causes: Exactly the causes that are to be told.
        perhaps: Causes that may be told as well, as the threads happen to run.
        words: Patterns of what is to be printed.
        never: Patterns of what is not.
        paired: Least share of both sensors' frames that are paired.
        age_ms: Largest median time from the images to S*.
        within_s: Longest time from the last event to the end of the program.
        standin_only: Why the rig cannot show it.
        xfail: Why it is not reached yet.
    """

    name: str
    conf: str = CABLE
    options: str = "--seconds 4"
    events: Events = ()
    code: int = 0
    causes: frozenset[Cause] = frozenset()
    perhaps: frozenset[Cause] = frozenset()
    words: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    paired: float = 0.0
    age_ms: float = 1000.0
    within_s: float = 60.0
    standin_only: str = ""
    xfail: str = ""


def _fine(name, conf=CABLE, options="--seconds 3", **more):
    """A session in which nothing is wrong: pairs, latency, and no cause is told."""
    return Scenario(name, conf, options, **{"paired": 0.99, "age_ms": 30.0, **more})


def _refused(name, conf, *causes, words="", **more):
    """The program ends before the first frame, with one line."""
    told = frozenset(causes)
    return Scenario(name, conf, code=2, causes=told, words=(words,) if words else (), **more)


def _during(name, events, *causes, conf="", seconds=6, options="", **more):
    """Something happens while the session runs; it goes on to its end."""
    told, options = frozenset(causes), f"--seconds {seconds:g} {options}"
    return Scenario(name, conf, options, ((_RUNS, {}), (1.0, {}), *events), causes=told, **more)


def _unplugged(name, sides, *causes, conf="", **more):
    out = {f"{side}.present": 0 for side in sides}
    back = {f"{side}.present": 1 for side in sides}
    words = tuple(f"{serial} is back" for side, serial in zip("ab", _SERIALS, strict=True) if side in sides)
    never = _NO_ADVICE + more.pop("never", ())
    events = ((0.0, out), (2.0, back))
    return _during(name, events, *causes, conf=conf, seconds=10, words=words, never=never, **more)


def _ended(name, events, conf="", code=0, **more):
    """Ctrl-C or a signal: never a crash, and what was saved is whole."""
    return Scenario(name, conf, "", events, code, within_s=5.0, **more)


_SERIALS = ("000001111111", "000002222222")
_CTRL_C = int(signal.SIGINT)
_MASTER = frozenset((Cause.IT_OR_MASTER_UNPLUGGED, Cause.WAITING, Cause.NO_PULSES, Cause.SILENT))
_LATER = frozenset((Cause.CLOSES_LATER,))
_NO_ADVICE = ("Stand 2.5 m in front of it", "USB controller, and light")

SCENARIOS = (
    # Without a fault
    _fine("no cable", "", age_ms=_APART, words=("No sync cable",)),
    _fine("cable", words=("A leads, B captures on its pulses",)),
    _fine("cable, B the master", "a.jack=1 b.jack=2", words=("B leads, A captures on its pulses",)),
    _fine("B before A on the bus", "swap=1", age_ms=_APART),
    _fine("colour, cable", options="--seconds 3 --color 720P", age_ms=70.0),
    _fine("colour, no cable", "", options="--seconds 3 --color 720P", age_ms=70.0),
    _fine("wide field, 15 fps", options="--seconds 4 --depth-mode WFOV_2X2BINNED --fps 15", paired=0.98),
    _fine("colour latencies 40 and 160 ms", f"{CABLE} a.color_latency_ms=40 b.color_latency_ms=160"),
    _fine("B 150 ms later, with colour", f"{CABLE} a.color_latency_ms=40 b.color_latency_ms=190",
        "--seconds 4 --color 720P", paired=0.95, age_ms=240.0, causes=frozenset((Cause.LATE,))),
    _fine("B 100 ms later on USB", f"{CABLE} b.depth_latency_ms=125",
        "--seconds 4", paired=0.95, age_ms=150.0, causes=frozenset((Cause.LATE_ON_CABLE,))),
    _fine("a colour camera without images", f"{CABLE} b.color_dead=1"),
    _fine("clocks begin at 600 ms", f"{CABLE} a.first_pts_ms=600 b.first_pts_ms=600"),
    _fine("loading takes 3 s", f"{CABLE} bt.load_ms=3000"),
    _fine("firmware 1.6.102", f"{CABLE} b.fw=1.6.102", words=("AzureKinectFirmwareTool",)),
    # Slow trackers
    _fine("tracker 40 ms", f"{CABLE} bt.ms=40", "--seconds 5", age_ms=75.0, words=("not USB",)),
    _fine("tracker 60 ms, no cable", "bt.ms=60", "--seconds 5", age_ms=95.0, words=("of 30 frames",)),
    _fine("trackers 20 and 60 ms", f"{CABLE} bt.ms_a=20 bt.ms_b=60", "--seconds 5",
        age_ms=95.0, words=("of 30 frames",)),
    _fine("two trackers on one GPU, 40 ms", f"{CABLE} bt.ms=40 bt.one_gpu=1", "--seconds 6", paired=0.98,
        age_ms=115.0),
    # Refused before the first frame
    _refused("both jacks out", "a.jack=2 b.jack=2", words="joins no sync out to a sync in"),
    _refused("no Kinect", "a.present=0 b.present=0", words="No (Kinect|sensor) with serial 000001111111"),
    _refused("one Kinect", "b.present=0", words="Only one sensor is connected"),
    _refused("busy", "b.busy=1", Cause.BUSY),
    _refused("colour camera busy", "b.uvc_busy=1", Cause.BUSY),
    _refused("firmware 1.5.60", f"{CABLE} a.fw=1.5.60", Cause.OLD_FIRMWARE, words=r"1\.5\.60"),
    _refused("colour camera fails", f"{CABLE} b.color_fails=1", Cause.COLOR_NOT_STARTED),
    _refused("depth engine fails", "engine_fails=1", Cause.ENGINE_NOT_STARTED),
    _refused("tracker does not start", "bt.create_fails=1", words="The body tracker did not start"),
    # Frames are lost
    _during("frames lost on USB", (), conf="a.drop=0.15", words=("lost on USB. Give A a USB controller",)),
    _during("no depth", ((0.0, {"b.stall": 1}),), Cause.SILENT, Cause.NO_DEPTH, seconds=9, never=_NO_ADVICE),
    _fine("clocks begin at 600 ms, with colour", f"{CABLE} a.first_pts_ms=600 b.first_pts_ms=600",
        "--seconds 4 --color 720P", age_ms=70.0),
    _during("a colour camera dies", ((0.0, {"b.color_dead": 1}),), Cause.NO_IMAGES, conf=CABLE, seconds=6,
        options="--color 720P"),
    _unplugged("B unplugged", "b", Cause.UNPLUGGED),
    _unplugged("A unplugged", "a", Cause.UNPLUGGED),
    _unplugged("both unplugged", "ab", Cause.UNPLUGGED),
    _unplugged("master unplugged", "a", Cause.UNPLUGGED, conf=CABLE, perhaps=_MASTER, never=("2222 was",)),
    _unplugged("subordinate unplugged", "b", Cause.IT_OR_MASTER_UNPLUGGED, conf=CABLE),
    # The tracker fails
    _during("tracker hangs", ((0.0, {"bt.hang_b": 1}), (4.0, {"bt.hang_b": 0})), Cause.WAITING, seconds=8,
        never=_NO_ADVICE),
    _during("tracker hangs longer", ((0.0, {"bt.hang_b": 1}), (13.0, {"bt.hang_b": 0})), Cause.WAITING,
        Cause.TRACKER_STALLS, seconds=16),
    _during("tracker fails", ((0.0, {"bt.fail_b": 1}), (1.0, {"bt.fail_b": 0})), Cause.TRACKER_FAILED,
        words=("is back",)),
    _during("tracker takes nothing", ((0.0, {}),), Cause.CAPTURE_REFUSED, conf="bt.fail_b=1", seconds=3),
    _during("nobody there", (), conf="bt.nobody=1", words=("sees no one. Stand 2.5 m in front of it",)),
    # The end
    _ended("Ctrl-C while running", ((_RUNS, {}), (2.0, _CTRL_C)), words=("Saved",)),
    _ended("SIGTERM while running", ((_RUNS, {}), (2.0, int(signal.SIGTERM))), words=("Saved",)),
    _ended("Ctrl-C while opening", (("Opening", _CTRL_C),), "open_ms=1500", 130, perhaps=_LATER),
    _ended("Ctrl-C while k4abt loads", (("Opening", {}), (2.5, _CTRL_C)), "bt.load_ms=8000", 130,
        causes=_LATER),
    _ended("Ctrl-C, trackers take 3 s to stop", ((_RUNS, {}), (2.0, _CTRL_C)), "bt.destroy_ms=3000",
        perhaps=_LATER, words=("Saved",)),
    _ended("Ctrl-C after unplugging", ((_RUNS, {}), (2.0, {"b.present": 0}), (0.5, _CTRL_C)),
        perhaps=_LATER | {Cause.UNPLUGGED}, words=("Saved",)),
)  # fmt: skip
