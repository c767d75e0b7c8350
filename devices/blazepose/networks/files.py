"""The tracker's network files: names, checksums, and the folder that holds them."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from devices.blazepose.settings import NetworkName
from devices.cache import user_cache
from devices.input_file import open_input
from devices.sensor import DeviceError

_FETCH = "duplex tracker fetch"


@dataclass(frozen=True)
class NetworkFile:
    """A file of a published package."""

    name: str  # its name in the folder of the networks
    sha256: str  # checksum, hexadecimal
    package: str
    """The package that carries it: the wheel ``mediapipe`` or the npm package ``@mediapipe/pose``."""
    member: str  # its path inside the package


WHEEL, NPM = "mediapipe==0.10.21", "@mediapipe/pose@0.5.1675469404"
"""The packages, in the notation of pip and npm. Later wheels carry no networks."""

DETECTOR = NetworkFile(
    "pose_detection.tflite",
    "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    WHEEL,
    "mediapipe/modules/pose_detection/pose_detection.tflite",
)
LANDMARK_NETWORKS: dict[NetworkName, NetworkFile] = {
    "full": NetworkFile(
        "pose_landmark_full.tflite",
        "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
        WHEEL,
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
    ),
    "lite": NetworkFile(
        "pose_landmark_lite.tflite",
        "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61",
        NPM,
        "package/pose_landmark_lite.tflite",
    ),
}


def files_of(network: NetworkName) -> tuple[NetworkFile, NetworkFile]:
    """The two files that a tracker needs: the detector and the landmark network."""
    return DETECTOR, LANDMARK_NETWORKS[network]


def cache_folder() -> Path:
    """The folder of fetched networks in the user's cache folder, by the platform's convention.

    ``DUPLEX_TRACKER_MODELS`` names another folder.
    """
    named = os.environ.get("DUPLEX_TRACKER_MODELS")
    if named:
        return Path(named)
    return user_cache("blazepose")


def fetch_command(network: NetworkName, folder: Path) -> str:
    """The command that fetches the missing and the damaged files of a network into a folder."""
    only_lite = " --network lite" if network == "lite" else ""
    elsewhere = "" if folder == cache_folder() else f" --tracker-model {folder}"
    return f"{_FETCH}{only_lite}{elsewhere}"


def missing(network: NetworkName, folder: Path) -> list[NetworkFile]:
    """The files of a network that the folder lacks."""
    return [file for file in files_of(network) if not (folder / file.name).is_file()]


def checked_content(file: NetworkFile, folder: Path) -> bytes:
    """Reads a network file and checks it.

    Raises:
        DeviceError: The file is missing, truncated or another one.
    """
    path = folder / file.name
    fetch = fetch_command("lite" if file == LANDMARK_NETWORKS["lite"] else "full", folder)
    try:
        with open_input(path) as opened:
            content = opened.read()
    except FileNotFoundError:
        raise DeviceError(
            f"The body tracker's network {file.name} is not in {folder}. Run {fetch}, "
            f"or name the folder that has it: `tracker_model`, in Python BlazePoseSettings(models=...)."
        ) from None
    except OSError as fault:
        raise DeviceError(
            f"The body tracker's network {path} cannot be read: {fault.strerror or fault}."
        ) from None
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise DeviceError(
            f"The body tracker's network {path} is damaged or another one: its SHA-256 differs "
            f"({len(content)} bytes). Run {fetch}."
        )
    return content
