"""S* as JSON: schema ``duplex-kinects/skeleton``, version 2. ``docs/protocols.md`` documents it.

Messages are told apart by ``type``: ``hello`` (body, joints, sensors, units; first, and again when the
calibration changes), ``coach`` (what the set-up lacks), ``frame`` and ``event``. A later version of the
schema keeps the meaning of a field or drops it.
"""

import json
import math
import time
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from fusion.movement.angles import ANGLES
from fusion.movement.joint_rotations import JointRotations
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import WORDS, CoachPage
from viewer_app.outputs.live_movement import LiveMovement
from viewer_app.outputs.output import confidence
from viewer_app.sinks.item_queue import QueuedFrame

SCHEMA, VERSION = "duplex-kinects/skeleton", 2


class SkeletonJson:
    """Encodes frames of one body."""

    def __init__(self, setup: FusionSetup) -> None:
        self._rotations = JointRotations(setup.body)
        self._movement = LiveMovement(setup.body)
        self._first_unix_ns: int | None = None

    def hello(self, setup: FusionSetup) -> str:
        """The message that describes the others."""
        body, calibration = setup.body, setup.calibration
        b = calibration.a_from_b.translation
        return json.dumps(
            {
                "type": "hello",
                "schema": SCHEMA,
                "version": VERSION,
                "body": body.name,
                "joints": body.joints,
                "parents": body.parents,
                "rest": body.rest.tolist(),
                "bone_lengths": calibration.bone_lengths.round(5).tolist(),
                "axes": "x right, y down, z forward, of the first sensor; right-handed",
                "angles": ANGLES,
                "sensors": [[0.0, 0.0, 0.0], b.round(4).tolist() if b.any() else None],
                "units": "metres, seconds, degrees",
            }
        )

    def coach(self, page: CoachPage) -> str:
        """The state of a set-up and the next step, null where it is none; and what to draw in the scene."""
        state, step = (None, None) if page.card is None else (page.card[0].value, page.card[1])
        marks = {
            name: {**asdict(mark), "words": WORDS[name] if mark.words_at else ""} for name, mark in page.marks
        }
        said = {"type": "coach", "version": VERSION, "state": state, "step": step, "marks": marks}
        return json.dumps(said)

    def saving(self, state: str, text: str) -> str:
        """Whether a session is saved that a page asked for, and its file or why not."""
        return json.dumps({"type": "saving", "version": VERSION, "state": state, "text": text})

    def may_save(self, may: bool) -> str:
        """Whether a page that asked for it has the token with which it may ask for a session."""
        return json.dumps({"type": "may_save", "version": VERSION, "may": may})

    def frame(self, timed: QueuedFrame) -> str:
        """A frame: positions and velocities (J, 3), rotations (J, 4) x, y, z, w, confidence (J,), sigma (J,),
        covariances (J, 3, 3), angles and their sigma (K,); null where the method does not know them."""
        fused, sigma, unix_ns = timed.fused, timed.fused.sigma, timed.frame.unix_ns
        self._first_unix_ns = None if unix_ns is None else unix_ns - timed.time_ns
        angles, angle_sigma = self._movement.angles(timed)
        latency_ns = timed.frame.latency_ns
        age_ns = None if latency_ns is None else time.perf_counter_ns() - timed.written_ns + latency_ns
        names = "positions", "velocities", "rotations", "confidence", "sigma", "covariances"
        person: dict[str, object] = dict.fromkeys((*names, "angles", "angle_sigma"))
        if fused.has_person:
            rotations = self._rotations.update(fused.positions, timed.time_ns)
            person = {
                "positions": fused.positions.round(4).tolist(),
                "velocities": _rounded(fused.velocities, 3),
                "rotations": rotations.round(5).tolist(),
                "confidence": confidence(fused).round(3).tolist(),
                "sigma": None if sigma is None else np.minimum(sigma, 9.0).round(4).tolist(),
                "covariances": _rounded(fused.covariance, 8),
                "angles": _or_null(angles),
                "angle_sigma": None if sigma is None else _or_null(np.minimum(angle_sigma, 180.0)),
            }
        return json.dumps(
            {
                "type": "frame",
                "version": VERSION,
                "number": timed.number,
                **self._times(timed.time_ns),
                "age_s": None if age_ns is None else round(age_ns * 1e-9, 4),
                "person": fused.has_person,
                **person,
            },
            separators=(",", ":"),
        )

    def _times(self, time_ns: int) -> dict[str, float | None]:
        first_ns = self._first_unix_ns
        unix_s = None if first_ns is None else round((first_ns + time_ns) * 1e-9, 6)
        return {"time_s": round(time_ns * 1e-9, 6), "unix_time_s": unix_s}

    def gait_events(self) -> list[Event]:
        """The heel strikes and toe-offs that the last frames show."""
        return self._movement.new_events()

    def event(self, event: Event, count: int = 1) -> str:
        """An event, the last of so many."""
        said = {
            "type": "event",
            "version": VERSION,
            **self._times(event.time_ns),
            "level": event.level,
            "text": event.text,
        }
        return json.dumps(said | ({"count": count} if count > 1 else {}))


def _rounded(values: NDArray[np.float64] | None, digits: int) -> object:
    """A joint of which little is known has covariances of any size, but no JSON does without an end."""
    return None if values is None else np.clip(values, -81.0, 81.0).round(digits).tolist()


def _or_null(degrees: NDArray[np.float64]) -> list[float | None]:
    """JSON has no NaN."""
    return [round(value, 2) if math.isfinite(value) else None for value in degrees.tolist()]
