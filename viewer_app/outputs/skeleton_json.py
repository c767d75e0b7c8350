"""S* as JSON: schema ``duplex-kinects/skeleton``, version 1. ``docs/outputs.md`` documents it.

Three kinds of messages, told apart by ``type``: ``hello`` (body, joints, units; first, and again when the
calibration changes), ``frame`` and ``event``. A later version of the schema keeps the meaning of a field or
drops it.
"""

from __future__ import annotations

import json

import numpy as np

from devices.events import Event
from fusion.joint_rotations import JointRotations
from fusion.setup import FusionSetup
from viewer_app.outputs.output import confidence
from viewer_app.sinks.queued_sink import QueuedFrame

SCHEMA, VERSION = "duplex-kinects/skeleton", 1


class SkeletonJson:
    """Encodes frames of one body.

    Args:
        setup: The setup of the first frames.
    """

    def __init__(self, setup: FusionSetup) -> None:
        body = setup.body
        self._rotations = JointRotations(body)
        joints = len(body)

        def rows(columns: int, digits: int) -> str:
            row = "[" + ",".join([f"%.{digits}f"] * columns) + "]"
            return "[" + ",".join([row] * joints) + "]"

        numbers = "[" + ",".join(["%.3f"] * joints) + "]"
        sigmas = "[" + ",".join(["%.4f"] * joints) + "]"
        begin = '{"type":"frame","version":1,"number":%d,"time_s":%.6f,'
        person = f'"person":true,"positions":{rows(3, 4)},"rotations":{rows(4, 5)},"confidence":{numbers},'
        self._with_sigma = begin + person + f'"sigma":{sigmas}}}'
        self._without_sigma = begin + person + '"sigma":null}'
        self._without_person = begin + (
            '"person":false,"positions":null,"rotations":null,"confidence":null,"sigma":null}'
        )

    def hello(self, setup: FusionSetup) -> str:
        """The message that describes the others."""
        body, calibration = setup.body, setup.calibration
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
                "units": "metres, seconds",
            }
        )

    def frame(self, timed: QueuedFrame) -> str:
        """A frame: positions (J, 3), rotations (J, 4) x, y, z, w, confidence (J,), sigma (J,) or null."""
        fused = timed.fused
        about = (timed.number, timed.time_ns * 1e-9)
        if not fused.has_person:
            return self._without_person % about
        rotations = self._rotations.update(fused.positions, timed.time_ns)
        values = [fused.positions.ravel(), rotations.ravel(), confidence(fused)]
        if fused.sigma is None:
            return self._without_sigma % (*about, *np.concatenate(values).tolist())
        values.append(np.minimum(fused.sigma, 9.0))
        return self._with_sigma % (*about, *np.concatenate(values).tolist())

    def event(self, event: Event) -> str:
        """An event."""
        return json.dumps(
            {
                "type": "event",
                "version": VERSION,
                "time_s": event.time_ns * 1e-9,
                "level": event.level,
                "text": event.text,
            }
        )
