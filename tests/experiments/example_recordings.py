"""The recordings in ``examples/data``: ``python -m tests.experiments.example_recordings``.

A simulated person walks before two simulated Kinects v2 and turns; joints are rounded to millimetres.
"""

from devices import simulated_pair
from fusion import KINECT_V2, TrackingState
from tests.helpers.documents import ROOT

FOLDER = ROOT / "examples" / "data"


def csv_of(body, frames):
    """The text of a recording of these frames."""
    lines = ["time_us,body,joint,x,y,z,state"]
    for frame in frames:
        for person, skeleton in frame.people.items():
            for joint, place, state in zip(body.joints, skeleton.positions, skeleton.states, strict=True):
                if state != TrackingState.NOT_TRACKED:
                    x, y, z = (f"{value:.3f}" for value in place)
                    word = TrackingState(state).name.lower()
                    lines.append(f"{frame.time_ns // 1000},{person},{joint},{x},{y},{z},{word}")
    return "\n".join(lines) + "\n"


def recordings(seconds=8.0):
    """Yields the name and the text of each file."""
    a, b, _ = simulated_pair(motion="walk", seconds=seconds, body=KINECT_V2, seed=1)
    for name, sensor in (("a", a), ("b", b)):
        yield f"{name}.csv", csv_of(KINECT_V2, sensor.frames())


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, text in recordings():
        (FOLDER / name).write_text(text, encoding="utf-8")
