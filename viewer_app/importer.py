"""``rerun-importer-duplex``: shows recorded skeletons and Azure Kinect recordings in any Rerun viewer.

A Rerun viewer that opens a file runs every program of its path that is called ``rerun-importer-…``: with the
file, then ``--application-id``, ``--recording-id`` and further flags. The program writes a recording to its
standard output. Exit code 66 says that the file belongs to another program. Therefore a file's ending and
its first bytes are looked at before anything else is imported.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from devices.sensor import Sensor

NOT_MINE = 66
"""Exit code for a file of another program, as Rerun defines it."""
_NAME = "rerun-importer-duplex"
_HEAD_BYTES = 1 << 18
_CSV_COLUMNS = ("time_us", "body", "joint", "x", "y", "z")
_EBML = b"\x1a\x45\xdf\xa3"
_JOINT_NUMBERS = 12  # on a line of a .skeleton file


def script() -> None:
    """The console script. It ends at once when a viewer stops reading, as other programs in a pipe do."""
    if hasattr(signal, "SIGPIPE"):  # not on Windows
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    sys.exit(main())


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes the recording of a file to the standard output; returns the exit code.

    Args:
        arguments: The arguments after the program's name. None: the arguments of the process.
    """
    parser = argparse.ArgumentParser(
        prog=_NAME,
        description="Shows recorded skeletons (.csv, .json, .skeleton) and Azure Kinect recordings (.mkv) "
        "in Rerun's viewer, which runs this program by itself when it opens such a file.",
        allow_abbrev=False,
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--application-id", help="name under which the viewer keeps the layout")
    parser.add_argument("--recording-id", help="id of the recording")
    parser.add_argument("--entity-path-prefix", default="", help="entity below which all data is placed")
    given, _ = parser.parse_known_args(arguments)  # viewers pass flags of later versions, too
    path: Path = given.file
    try:
        mine = is_mine(path)
    except OSError as error:
        return _failed(f"{path} cannot be read: {error.strerror or error}.")
    if not mine:
        return NOT_MINE
    if sys.stdout.isatty():
        return _failed(f"the recording goes to the standard output: {_NAME} {path} | rerun -", code=2)
    with redirect_stdout(sys.stderr):  # the standard output has the recording only
        return _write(path, given.application_id or path.stem, given.recording_id, given.entity_path_prefix)


def is_mine(path: Path) -> bool:
    """Whether a file is recorded skeletons or an Azure Kinect recording, by its ending and its first bytes.

    Raises:
        OSError: The file cannot be read.
    """
    looks_like = _KINDS.get(path.suffix.lower())
    if looks_like is None or not path.is_file():
        return False
    with path.open("rb") as file:
        return looks_like(file.read(_HEAD_BYTES))


def _write(path: Path, application: str, recording: str | None, prefix: str) -> int:
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import rerun as rr

    from devices.sensor import DeviceError
    from fusion.errors import FusionError
    from recordings.writing.sensor_log import SensorLog
    from viewer_app.viewer.sensor_blueprint import sensor_blueprint

    stream = rr.RecordingStream(application, recording_id=recording)
    try:
        with _opened(path) as sensor:
            log = SensorLog(stream, sensor, prefix)
            stream.stdout()
            log.write()
            stream.send_blueprint(sensor_blueprint(log.entities, log.camera, log.person_at))
    except (DeviceError, FusionError) as error:
        return _failed(str(error))
    finally:
        stream.disconnect()
    return 0


def _opened(path: Path) -> Sensor:
    """The source of a file, not yet open."""
    if path.suffix.lower() == ".mkv":
        from devices.azure.recording.mkv import MkvRecording

        return MkvRecording(path)
    from devices.skeletons.recording import SkeletonRecording

    return SkeletonRecording(path)


def _failed(message: str, code: int = 1) -> int:
    print(f"{_NAME}: {message}", file=sys.stderr)
    return code


def _is_csv(head: bytes) -> bool:
    header = b"".join(head.splitlines()[:1]).decode("utf-8-sig", "replace")
    return {name.strip() for name in header.split(",")}.issuperset(_CSV_COLUMNS)


def _is_json(head: bytes) -> bool:
    """Whether it is of offline_processor, whose keys come in any order."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    named = b'"joint_names"' in text or (b'"frames"' in text and b'"timestamp_usec"' in text)
    return text.startswith(b"{") and named


def _is_skeleton(head: bytes) -> bool:
    """Whether it begins with whole numbers of frames and of bodies, as NTU RGB+D does."""
    lines = head.removeprefix(b"\xef\xbb\xbf").splitlines()[:5]
    if len(lines) < 2 or not all(line.strip().isdigit() for line in lines[:2]):
        return False
    # a body, the number of its joints, and the first joint; or the next frame
    return len(lines) < 5 or int(lines[1]) == 0 or len(lines[4].split()) == _JOINT_NUMBERS


def _is_mkv(head: bytes) -> bool:
    return head.startswith(_EBML) and b"K4A_DEPTH_MODE" in head


_KINDS: dict[str, Callable[[bytes], bool]] = {
    ".csv": _is_csv,
    ".json": _is_json,
    ".skeleton": _is_skeleton,
    ".mkv": _is_mkv,
}
"""What the first bytes of a file look like, by its ending."""


if __name__ == "__main__":
    script()
