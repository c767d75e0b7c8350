"""Sessions of each version, as it read them: ``python -m tests.helpers.saved_sessions version_2_1``.

makes sessions of this version in a new folder of ``tests/data``; ``readings.json`` gets what they hold.
``live``, ``recorded`` and ``paper`` are of two simulated Kinects that see two people at 10 frames per second;
B comes 0.8 s late. ``live`` was calibrated twice and has depth evidence, ``recorded`` and ``paper`` are of
two files whose clocks are 100 ms apart.
"""

import json
import lzma
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.rig import Rig
from fusion.body import KINECT_V1
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import FusionSetup
from recordings.session import Session
from tests.experiments.example_recordings import csv_of
from tests.helpers.command_line import duplex
from tests.helpers.frame_pairs import KnownSensors, frame_pair
from tests.helpers.two_people import BEHIND
from viewer_app.running.loop import run_live
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.blueprint import session_blueprint

DATA = Path(__file__).parents[1] / "data"
_READINGS = DATA / "readings.json"
_LATE, _COMPANY = 8, 32
"""The first frame of B, and that of the second person, who comes after the start-up pose."""
_WITH_IMAGES = 20
"""Every so many frames have depth images; all have their evidence."""
_BODY, _SECONDS = KINECT_V1, 5.0


def _scene(depth="none"):
    """The sensors, the frames of each, and the truth."""
    rig = Rig(frame_seconds=0.1, skew_seconds=0.012)
    a, b, truth = simulated_pair(seconds=_SECONDS, body=_BODY, depth=depth, rig=rig, other=BEHIND, seed=12)
    return (a, b), [[_alone(k, frame) for k, frame in enumerate(of.frames())] for of in (a, b)], truth


def _alone(number, frame):
    if number >= _COMPANY:
        return frame
    return replace(frame, people={key: who for key, who in frame.people.items() if key == PERSON})


def live(path):
    """Records a session as ``duplex live`` does."""
    (a, b), frames, truth = _scene("half")
    setup = FusionSetup(nominal_calibration(_BODY), None, a.intrinsics, b.intrinsics)
    pairs = []
    for k, seen in enumerate(zip(*frames, strict=True)):
        one, other = seen if k % _WITH_IMAGES == 0 else (replace(frame, depth=None) for frame in seen)
        pairs.append(frame_pair(one, other if k >= _LATE else None, PERSON, one.time_ns, 12_000_000))
    blueprint = session_blueprint(setup, np.array([0.0, 0.0, 2.6]), "inspect")
    with LiveSession(setup, ("a", "b"), blueprint, file=path) as session:
        run_live(KnownSensors(pairs), setup, session, truth_at=truth.positions_at)


def recorded(path, *options):
    """Records a session as ``duplex fuse`` does."""
    _, (a, b), _ = _scene()
    b = [replace(frame, time_ns=frame.time_ns + 100_000_000) for frame in b[_LATE:]]
    files = path.parent / "a.csv", path.parent / "b.csv"
    for file, frames in zip(files, (a, b), strict=True):
        file.write_text(csv_of(_BODY, frames), encoding="utf-8")
    assert duplex("fuse", *files, "--no-viewer", "--save", path, *options) == 0


def names():
    """The saved sessions: ``version_0_1/demo``."""
    return sorted(
        path.relative_to(DATA).as_posix().removesuffix(".rrd.xz") for path in DATA.rglob("*.rrd.xz")
    )


def unpacked(name, path):
    """Writes a saved session to a path, and returns this."""
    path.write_bytes(lzma.decompress((DATA / f"{name}.rrd.xz").read_bytes()))
    return path


def reading(session):
    """What a session holds, as JSON: words and counts, and a checksum of each array."""
    assert session.damage is None
    arrays = {name: values for name, spec, values in session.rows.figures() if spec.covered}
    for number, (first, calibration) in enumerate(session.calibrations):
        move = calibration.a_from_b
        of_one = first, *move.rotation.flat, *move.translation, *calibration.bone_lengths
        arrays[f"calibration {number}"] = np.array(of_one)
    for side in "ab":
        images = [image.ravel() for _, image in session.depth(side)]
        arrays |= {f"depth of {side}": np.concatenate(images)} if images else {}
    return {
        "method": session.settings.method,
        "revision": session.method_revision,
        "body": session.body.name,
        "frames": len(session),
        "events": [f"{event.frame}: {event.text}" for event in session.events],
        "arrays": {name: f"{zlib.crc32(np.ascontiguousarray(of)):08x}" for name, of in arrays.items()},
    }


def readings():
    """What each session held for the version that made it, by name."""
    return json.loads(_READINGS.read_text(encoding="utf-8"))


def add_readings():
    """Adds the sessions that have no reading; those that are there stay as they are."""
    found = readings() if _READINGS.exists() else {}
    with TemporaryDirectory() as work:
        for name in names():
            if name not in found:
                found[name] = reading(Session.open(unpacked(name, Path(work) / "session.rrd")))
    _READINGS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def main(version):
    """Makes the sessions."""
    folder = DATA / version
    folder.mkdir()
    made = {"live": (live,), "recorded": (recorded,), "paper": (recorded, "--method", "paper")}
    for name, (make, *options) in made.items():
        with TemporaryDirectory() as work:
            make(Path(work) / "session.rrd", *options)
            packed = lzma.compress((Path(work) / "session.rrd").read_bytes(), preset=9)
        (folder / f"{name}.rrd.xz").write_bytes(packed)
    add_readings()


if __name__ == "__main__":
    main(sys.argv[1])
