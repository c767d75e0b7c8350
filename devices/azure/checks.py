"""Checks of the Azure Kinect's SDK, its sensors and its body tracker, as data."""

import ctypes
import os
import shutil
import sys
from pathlib import Path

from devices.azure.pyk4a_access import load_sdk
from devices.azure.tracking.body_tracker import INSTALL
from devices.azure.tracking.native_library import load_library, loaded_file
from devices.azure.tracking.settings import TrackerSettings
from devices.capture.sensor_choice import ConnectedSensor
from devices.check import Check, failed
from devices.sensor import DeviceError
from devices.vendor import library_check, listed_check

_MODELS = ("dnn_model_2_0_op11.onnx", "dnn_model_2_0_lite_op11.onnx", "dnn_model_2_0.onnx")
_DEPTH_ENGINE = "libdepthengine.so.2.0"


def sdk_check() -> Check:
    """Whether pyk4a and the Sensor SDK can be imported."""
    return library_check(
        "pyk4a and the Sensor SDK", lambda: getattr(load_sdk(), "__file__", None) or "installed"
    )


def depth_engine_check(root: Path, x_answers: bool) -> Check:
    """Checks the depth engine, a closed library that computes depth from raw images with OpenGL."""
    name = "depth engine"
    if not sys.platform.startswith("linux"):
        return Check(name, True, f"comes with the Sensor SDK on {sys.platform}")
    display = os.environ.get("DISPLAY")
    if not display or not x_answers:
        what = f"The display {display} (DISPLAY) does not answer" if display else "DISPLAY is not set"
        return Check(
            name,
            False,
            f"{what}, and depth is computed with OpenGL, which needs an X display",
            "Start from a desktop session, or log in at the machine and export DISPLAY=:0.",
        )
    libraries = root / "usr/lib/x86_64-linux-gnu"
    folders = [libraries, libraries / "libk4a1.4", root / "usr/local/lib", root / "usr/lib"]
    sdk = loaded_file("k4a")
    if sdk is not None:
        folders.insert(0, sdk.parent)
    for folder in folders:
        if (folder / _DEPTH_ENGINE).is_file():
            return Check(name, True, f"{folder / _DEPTH_ENGINE}, display {display}")
    return Check(
        name,
        False,
        f"{_DEPTH_ENGINE} is not where the SDK puts it",
        "It comes with the SDK's package libk4a1.4; with Orbbec's wrapper, beside its libk4a.",
        needed=False,  # the SDK may find it in a path of its own
    )


def tracker_library_check(tracker: TrackerSettings) -> Check:
    """Whether libk4abt can be loaded."""
    try:
        library = load_library("k4abt", tracker.library, INSTALL)
    except DeviceError as fault:
        return failed("k4abt", fault)
    if not hasattr(library, "k4abt_tracker_create"):
        return Check("k4abt", False, f"{library._name} is another library.", INSTALL)
    return Check("k4abt", True, str(library._name))


def tracker_network_check(tracker: TrackerSettings, root: Path) -> Check:
    """Whether libk4abt finds a network."""
    name = "k4abt's network"
    folders = [root / "usr/bin", root / "usr/lib/x86_64-linux-gnu", Path.cwd()]
    beside = tracker.library or loaded_file("k4abt")
    if beside is not None:
        folders.insert(0, beside.parent)
    if sys.platform == "win32":
        folders.append(Path("C:/Program Files/Azure Kinect Body Tracking SDK/tools"))
    for folder in folders:
        for model in _MODELS:
            if (folder / model).is_file():
                return Check(name, True, str(folder / model))
    return Check(name, False, f"none of {', '.join(_MODELS)} where libk4abt looks", INSTALL)


def sensor_check(kinect: ConnectedSensor) -> Check:
    """A Kinect that libk4a lists: its jacks and its firmware."""
    plugs = (
        "sync jacks not known"
        if kinect.hides_jacks
        else f"sync in {_plug(kinect.sync_in)}, sync out {_plug(kinect.sync_out)}"
    )
    return listed_check("Kinect", kinect, ", ".join(filter(None, (plugs, kinect.description))))


def _plug(connected: bool | None) -> str:
    return "connected" if connected else "empty"


def gpu_check(tracker: TrackerSettings, root: Path) -> Check:
    """Whether libk4abt finds a GPU driver."""
    gpu = found_gpu(root)
    if gpu:
        return Check("GPU", True, f"{gpu} found", needed=False)
    slow = (
        "about one frame per second of both sensors: record with k4arecorder now, "
        "duplex fuse a.mkv b.mkv later."
    )
    if tracker.processing == "cpu":
        return Check(
            "GPU", False, "none found; the tracker runs on the CPU", f"That gives {slow}", needed=False
        )
    return Check(
        "GPU",
        False,
        f"no driver found, and the tracker is to run on {tracker.processing}",
        f"Install NVIDIA's driver, or try `processing=cpu`, which gives {slow}",
    )


def why_not_k4abt(settings: TrackerSettings | None = None, root: Path = Path("/")) -> str:
    """Why libk4abt is of no use here, in one clause; empty if it works, as far as can be told."""
    settings = settings or TrackerSettings()
    try:
        library = load_library("k4abt", settings.library, INSTALL)
    except DeviceError:
        return "libk4abt is not installed"
    if not hasattr(library, "k4abt_tracker_create"):
        return f"{library._name} is not libk4abt"
    if settings.processing == "cpu":
        return "libk4abt tracks about one frame per second on a CPU"
    return "" if found_gpu(root) else "libk4abt finds no GPU driver"


def found_gpu(root: Path = Path("/")) -> str:
    """What libk4abt can compute on: "NVIDIA driver", "DirectML", or nothing."""
    if (root / "proc/driver/nvidia/version").is_file() or shutil.which("nvidia-smi"):
        return "NVIDIA driver"
    if sys.platform == "win32":
        try:
            ctypes.CDLL("DirectML.dll")
        except OSError:
            return ""
        return "DirectML"
    return ""
