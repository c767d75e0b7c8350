"""A session's properties: the data for a replay, and facts about the recording."""

from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np

from fusion.calibration.calibration import Calibration
from fusion.intrinsics import Intrinsics
from fusion.setup import REVISIONS, FusionSetup
from recordings.data import layout

_RESIDUALS = ("residual_median", "residual_rms", "rotation_sd", "translation_sd", "centre")


def session_properties(
    setup: FusionSetup, sources: tuple[str, str], about: Mapping[str, str | float]
) -> dict[str, dict[str, Any]]:
    """The properties by group and name.

    Args:
        sources: Names of the sensors, K_A first.
    """
    return {
        "session": {
            "layout_version": layout.VERSION,
            "written_by": f"duplex-kinects {version('duplex-kinects')}",
            "body": setup.body.name,
            "method_revision": REVISIONS[setup.settings.method],
            "bone_names": [name or "root" for name in setup.body.bones],
            "source_a": sources[0],
            "source_b": sources[1],
            **about,
        },
        "settings": asdict(setup.settings),
        "intrinsics": {"a": _camera(setup.intrinsics_a), "b": _camera(setup.intrinsics_b)},
    }


def calibration_values(calibration: Calibration) -> dict[str, Any]:
    """What a session stores of a calibration, in full precision, by name."""
    registration = calibration.registration
    no_joint = np.full(len(calibration.body), np.nan)
    return {
        "how": calibration.how,
        "provisional": calibration.provisional,
        "rotation": calibration.a_from_b.rotation.ravel(),
        "translation": calibration.a_from_b.translation,
        "bone_lengths": calibration.bone_lengths,
        **({"depth_errors": calibration.depth_errors} if calibration.depth_errors.any() else {}),
        **({"person": calibration.person} if calibration.person else {}),
        **({} if calibration.placed else {"placed": False}),
        "pairs": 0 if registration is None else registration.frames,
        **{name: getattr(registration, name, np.nan) for name in _RESIDUALS},
        "joint_residuals": getattr(registration, "joint_residuals", no_joint),
    }


def as_lists(properties: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, list[Any]]]:
    """Properties as read from a file: each value is a list."""
    return {
        group: {name: np.atleast_1d(np.asarray(value)).tolist() for name, value in values.items()}
        for group, values in properties.items()
    }


def _camera(camera: Intrinsics) -> list[float]:
    return [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
