"""A calibration kept in a file, to be used again while the sensors stay where they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fusion.body import BODIES, Body
from fusion.calibration import Calibration
from fusion.errors import FusionError
from fusion.rigid import RigidTransform
from recordings.errors import RecordingError


def calibration_to_json(calibration: Calibration) -> str:
    """The calibration as JSON: body, R, t, bone lengths by name, how it was made."""
    body = calibration.body
    document: dict[str, Any] = {
        "body": body.name,
        "how": calibration.how,
        "a_from_b": {
            "rotation": calibration.a_from_b.rotation.tolist(),
            "translation_m": calibration.a_from_b.translation.tolist(),
        },
        "bone_lengths_m": {body.bones[j]: float(calibration.bone_lengths[j]) for j in body.bone_joints},
    }
    return json.dumps(document, indent=2) + "\n"


def read_calibration(path: Path, body: Body) -> Calibration:
    """Reads a calibration for the given body.

    Raises:
        RecordingError: The file is missing, not such a file, or of another body.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["body"] in BODIES and document["body"] != body.name:
            raise RecordingError(
                f"{path} is a calibration of {document['body']}; these recordings are of {body.name}."
            )
        lengths = np.zeros(len(body))
        for joint in body.bone_joints:
            lengths[joint] = float(document["bone_lengths_m"][body.bones[joint]])
        if not (np.isfinite(lengths).all() and (lengths[body.bone_joints] > 0.0).all()):
            raise ValueError("bone lengths must be positive numbers")
        transform = document["a_from_b"]
        return Calibration(
            body,
            RigidTransform.of(transform["rotation"], transform["translation_m"]),
            lengths,
            f"loaded from {path} ({document['how']})",
        )
    except OSError as error:
        raise RecordingError(f"The calibration {path} cannot be read: {error.strerror}.") from None
    except (FusionError, KeyError, TypeError, ValueError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise RecordingError(
            f"{path} is no calibration ({what}). Make one with --save-calibration."
        ) from None
