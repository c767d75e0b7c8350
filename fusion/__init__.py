"""The method: two skeletons in, one out. It knows neither files nor devices."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.body import AZURE_KINECT, BLAZEPOSE, BODIES, KINECT_V1, KINECT_V2, Body
    from fusion.calibration.calibration import Calibration, calibrate, nominal_calibration
    from fusion.calibration.calibrator import Calibrator
    from fusion.calibration.start_up_pose import StartUpPose, find_start_up_pose
    from fusion.errors import CalibrationError, FusionError
    from fusion.fuser import FusedFrame, Fuser
    from fusion.intrinsics import Intrinsics
    from fusion.rigid import RigidTransform
    from fusion.setup import FuserSettings, FusionSetup
    from fusion.skeleton import Skeleton, SkeletonPair, TrackingState

__all__ = [
    "AZURE_KINECT",
    "BLAZEPOSE",
    "BODIES",
    "KINECT_V1",
    "KINECT_V2",
    "Body",
    "Calibration",
    "CalibrationError",
    "Calibrator",
    "FusedFrame",
    "Fuser",
    "FuserSettings",
    "FusionError",
    "FusionSetup",
    "Intrinsics",
    "RigidTransform",
    "Skeleton",
    "SkeletonPair",
    "StartUpPose",
    "TrackingState",
    "calibrate",
    "find_start_up_pose",
    "nominal_calibration",
]

_HOMES = {
    "AZURE_KINECT": "fusion.body",
    "BLAZEPOSE": "fusion.body",
    "BODIES": "fusion.body",
    "Body": "fusion.body",
    "KINECT_V1": "fusion.body",
    "KINECT_V2": "fusion.body",
    "Calibration": "fusion.calibration.calibration",
    "calibrate": "fusion.calibration.calibration",
    "nominal_calibration": "fusion.calibration.calibration",
    "Calibrator": "fusion.calibration.calibrator",
    "StartUpPose": "fusion.calibration.start_up_pose",
    "find_start_up_pose": "fusion.calibration.start_up_pose",
    "CalibrationError": "fusion.errors",
    "FusionError": "fusion.errors",
    "FusedFrame": "fusion.fuser",
    "Fuser": "fusion.fuser",
    "Intrinsics": "fusion.intrinsics",
    "RigidTransform": "fusion.rigid",
    "FuserSettings": "fusion.setup",
    "FusionSetup": "fusion.setup",
    "Skeleton": "fusion.skeleton",
    "SkeletonPair": "fusion.skeleton",
    "TrackingState": "fusion.skeleton",
}
"""The module of each public name. It is imported on first use, because numba alone takes a second."""


def __getattr__(name: str) -> Any:
    """Imports one of the names of ``__all__``."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
