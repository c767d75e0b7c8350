"""Reads a .c3d in a process of its own, because ezc3d crashes at damaged files, or never ends."""

import importlib.util
import io
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.errors import RecordingError

_SECONDS, _BYTES_PER_S = 20.0, 2e6
_MEMORY, _BYTES_PER_BYTE = 2 << 30, 40
_DAMAGED = 3  # exit code
_CHILD = "from recordings.c3d_file import send; send()"


def read_c3d(path: Path) -> dict[str, NDArray[Any]]:
    """``labels``, ``rate``, ``points`` (N, M, 3) and ``residuals`` (N, M) of a regular file.

    Raises:
        RecordingError: ezc3d is not installed, or cannot read the file.
    """
    if importlib.util.find_spec("ezc3d") is None:
        raise RecordingError("Reading .c3d needs the package ezc3d: pip install 'duplex-kinects[export]'.")
    packages = filter(None, (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH")))
    try:
        done = subprocess.run(
            [sys.executable, "-c", _CHILD, str(path.absolute())],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(packages)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_SECONDS + path.stat().st_size / _BYTES_PER_S,
        )
    except subprocess.TimeoutExpired:
        raise RecordingError(f"{path} is not a .c3d that ezc3d can read: it does not end.") from None
    if done.returncode == 0:
        with suppress(OSError, ValueError, EOFError):
            return dict(np.load(io.BytesIO(done.stdout)))
    said = done.stderr.decode(errors="replace").strip().splitlines()
    why = said[-1] if said and done.returncode == _DAMAGED else "it crashed, so the file is damaged"
    raise RecordingError(f"{path} is not a .c3d that ezc3d can read: {why}.")


def send() -> None:
    """Writes the content of the file that the command line names to the standard output."""
    path = Path(sys.argv[1])
    if sys.platform != "win32":
        import resource

        most = _MEMORY + _BYTES_PER_BYTE * path.stat().st_size
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # the library prints
        try:
            import ezc3d

            read = ezc3d.c3d(str(path))
            parameters, data = read["parameters"]["POINT"], read["data"]
            labels = [label for name in sorted(parameters) if name.startswith("LABELS")
                      for label in parameters[name]["value"]]  # fmt: skip
            content = {
                "labels": np.array(labels, dtype=str),
                "rate": np.array(float(parameters["RATE"]["value"][0])),
                "points": data["points"][:3].transpose(2, 1, 0).astype(np.float64),
                "residuals": data["meta_points"]["residuals"][0].T,
            }
        except (OSError, RuntimeError, ValueError, KeyError, IndexError, MemoryError) as error:
            print(error or "it does not fit into memory", file=sys.stderr)
            sys.exit(_DAMAGED)
        np.savez(out, **content)
