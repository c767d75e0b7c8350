"""The program ``duplex``: one command per task. A usage error prints one line and exits with code 2."""

import atexit
import importlib
import io
import os
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from fusion.errors import DuplexError
from viewer_app.flags import in_flags

_CLOSING_S = 30.0


def script() -> None:
    """The console script: runs :func:`main`, waits for sensors that still close, then ignores Ctrl-C.

    SIGTERM, as from ``docker stop`` and systemd, ends a command as Ctrl-C does.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    code: int | str | None = 0
    closed = False
    try:
        try:
            main()
        except SystemExit as end:
            code = end.code
        except KeyboardInterrupt:
            code = 130
        except BaseException:
            code = 1
            sys.excepthook(*sys.exc_info())
        closed = _wait_for_sensors()
    except KeyboardInterrupt:
        pass  # all files are written: the code stays that of the run
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # during shutdown it would print a traceback
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if not closed:
        # libk4a crashes at a regular exit: it unloads the depth engine, whose thread still runs
        atexit._run_exitfuncs()
        with suppress(OSError):  # the reader of the output may be gone
            sys.stdout.flush()
        os._exit(code if isinstance(code, int) else 1)
    sys.exit(code)


def _wait_for_sensors() -> bool:
    """Waits until all sensors are closed, half a minute at most; returns whether they are."""
    sensor_thread: Any = sys.modules.get("devices.capture.sensor_thread")
    if sensor_thread is None or not (sensors := sensor_thread.open_sensors()):
        return True
    names = " and ".join(
        f"{sensor.name} ({sensor.waits_for})" if sensor.waits_for else sensor.name for sensor in sensors
    )
    print(f"Waiting for {names} to close, {_CLOSING_S:g} s at most. Ctrl-C ends at once.", file=sys.stderr)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    until_s = time.monotonic() + _CLOSING_S
    while sensors and time.monotonic() < until_s:
        time.sleep(0.02)
        sensors = sensor_thread.open_sensors()
    for sensor in sensors:
        print(f"{sensor.name} did not close. Unplug it before using it again.", file=sys.stderr)
    return not sensors


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs a command line; without arguments, that of the process."""
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    # a file that cannot be written is an error of this program, in one line
    os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=off,re_sdk::recording_stream=off")
    # all matrices are small: more threads would only wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without a character shows a replacement
    try:
        _run(arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("duplex: stopped", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # the reader of the output is gone: write nothing more, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except DuplexError as error:
        print(in_flags(f"duplex: {error}"), file=sys.stderr)
        sys.exit(2)


def _run(arguments: Sequence[str] | None) -> None:
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        from importlib.metadata import version

        print(f"duplex {version('duplex-kinects')}")
        return
    # imported here, where Ctrl-C is expected: the imports take most of the start
    from viewer_app.options.command_line import COMMANDS, parsed

    options = parsed(given)
    module = next(module for kind, module in COMMANDS.values() if kind is type(options))
    importlib.import_module(module).run(options)


if __name__ == "__main__":
    script()
