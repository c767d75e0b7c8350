"""Calibration files, to be reused as long as the sensors do not move."""

import json
from pathlib import Path

import numpy as np

from devices.input_file import input_text, reading
from fusion.body import BODIES, Body
from fusion.calibration.bone_lengths import SHORTEST
from fusion.calibration.calibration import Calibration
from fusion.errors import FusionError
from fusion.rigid import RigidTransform
from recordings.errors import MissingFileError, RecordingError

_LOADED = "loaded from"
_LONGEST = 1.5  # metres; longer than any human bone
_LARGEST_ERROR = 0.2  # metres, of a view along its rays


def calibration_to_json(calibration: Calibration) -> str:
    """The calibration as JSON: body, R, t, bone lengths by name, how it was made."""
    body = calibration.body
    document = {
        "body": body.name,
        "how": calibration.how,
        "a_from_b": {
            "rotation": calibration.a_from_b.rotation.tolist(),
            "translation_m": calibration.a_from_b.translation.tolist(),
        },
        "bone_lengths_m": {body.bones[j]: float(calibration.bone_lengths[j]) for j in body.bone_joints},
        **({"depth_errors_m": calibration.depth_errors.tolist()} if calibration.depth_errors.any() else {}),
    }
    return json.dumps(document, indent=2) + "\n"


def is_loaded(calibration: Calibration) -> bool:
    """Whether it comes from a file, not from the views that it serves."""
    return calibration.how.startswith(_LOADED)


def read_calibration(path: Path, body: Body | None = None) -> Calibration:
    """Reads a calibration for the given body; without one, for the body that the file names.

    Raises:
        RecordingError: The file is missing, is not a calibration, or belongs to another body.
    """
    try:
        with reading(path, RecordingError, MissingFileError, "calibration"):
            document = json.loads(input_text(path))
        body = body or BODIES[document["body"]]
        if document["body"] != body.name:
            raise RecordingError(
                f"{path} is a calibration of {document['body']}; these recordings are of {body.name}."
            )
        lengths = np.zeros(len(body))
        for joint in body.bone_joints:
            lengths[joint] = document["bone_lengths_m"][body.bones[joint]]
        if not all(SHORTEST <= length <= _LONGEST for length in lengths[body.bone_joints]):
            raise ValueError(f"bone lengths must lie between {SHORTEST} and {_LONGEST} m")
        errors = np.array(document.get("depth_errors_m", (0.0, 0.0)), dtype=np.float64)
        if errors.shape != (2,) or not (np.abs(errors) <= _LARGEST_ERROR).all():
            raise ValueError(f"depth errors are two numbers of at most {_LARGEST_ERROR} m")
        transform = document["a_from_b"]
        return Calibration(
            body,
            RigidTransform.of(transform["rotation"], transform["translation_m"]),
            lengths,
            f"{_LOADED} {path} ({document['how']})",
            depth_errors=errors,
        )
    except (FusionError, KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise RecordingError(
            f"{path} is not a calibration ({what}). Make one with `save_calibration`."
        ) from None
