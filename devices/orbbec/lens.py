"""Converts the SDK's cameras to this program's."""

from __future__ import annotations

from typing import Any

import numpy as np

from devices.orbbec.sdk_access import faults_of
from devices.sensor import ColorCamera, DeviceError
from fusion.errors import FusionError
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

_BROWN_CONRADY = ("BROWN_CONRADY", "BROWN_CONRADY_K6")
"""The models that are OpenCV's: its coefficients, from the ideal to the distorted image."""


def intrinsics_of(sdk: Any, profile: Any, serial: str) -> tuple[Intrinsics, str]:
    """The lens of a stream, and a warning; empty if there is none.

    A model other than OpenCV's is left out with a warning: the lens then counts as ideal. Coefficients that
    are all zero are no distortion under any model.

    Raises:
        DeviceError: The sensor has no calibration of this stream.
    """
    try:
        lens, distortion = profile.get_intrinsic(), profile.get_distortion()
    except faults_of(sdk) as fault:
        raise DeviceError(
            f"Orbbec {serial} gives no calibration ({fault}). Calibrate or reset it with OrbbecViewer."
        ) from fault
    if not (lens.fx > 0.0 and lens.fy > 0.0):
        raise DeviceError(f"Orbbec {serial} has a focal length of {lens.fx:g} px. Reset it in OrbbecViewer.")
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    coefficients = tuple(float(getattr(distortion, name)) for name in names)
    warning = ""
    model = distortion.model.name
    if not any(coefficients):
        coefficients = ()
    elif model not in _BROWN_CONRADY:
        coefficients = ()
        warning = f"Orbbec {serial}: lens distortion of the model {model} is not known and is left out."
    pinhole = Intrinsics(
        profile.get_width(),
        profile.get_height(),
        float(lens.fx),
        float(lens.fy),
        float(lens.cx),
        float(lens.cy),
        coefficients,
    )
    return pinhole, warning


def color_camera(sdk: Any, color: Any, depth: Any, serial: str) -> tuple[ColorCamera, str]:
    """The colour camera of a stream and its place beside the depth camera; and a warning.

    Raises:
        DeviceError: The sensor has no calibration of it.
    """
    intrinsics, warning = intrinsics_of(sdk, color, serial)
    try:
        pose = depth.get_extrinsic_to(color)
        translation = np.asarray(pose.transform, dtype=np.float64) * 1e-3  # the SDK's are millimetres
        return ColorCamera(intrinsics, RigidTransform.of(pose.rot, translation)), warning
    except faults_of(sdk) + (FusionError,) as fault:
        raise DeviceError(
            f"Orbbec {serial} does not know its colour camera's place ({fault}). Run without --color."
        ) from fault
