"""The program ``duplex``: one command per task. A usage error prints one line and exits with code 2."""

import atexit
import gc
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
from viewer_app.flags import complain, printing
from viewer_app.running.interruption import ENDING, ends_as_ctrl_c

_CLOSING_S = 30.0
_NO_MEMORY = ("failed to map segment", "annot allocate memory", "MemoryError")
"""What an import says that had too little memory."""


def script() -> None:
    """The console script: runs :func:`main`, waits for sensors that still close, then ignores Ctrl-C.

    SIGTERM, as from ``docker stop`` and systemd, and SIGHUP, as of a closed terminal, end it likewise.
    """
    gc.set_threshold(10_000)  # most objects of a command stay; looking at them is a tenth of its time
    for stream in (0, 1, 2):  # else the next file opened would be a standard stream to libraries
        try:
            os.fstat(stream)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    sys.stdin = sys.stdin or open(0, encoding="utf-8")  # noqa: SIM115
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8")  # noqa: SIM115
    ends_as_ctrl_c()
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
    for number in ENDING:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # during shutdown it would print a traceback
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
    complain(f"Waiting for {names} to close, {_CLOSING_S:g} s at most. Ctrl-C stops immediately.")
    ends_as_ctrl_c()
    until_s = time.monotonic() + _CLOSING_S
    while sensors and time.monotonic() < until_s:
        time.sleep(0.02)
        sensors = sensor_thread.open_sensors()
    for sensor in sensors:
        complain(f"{sensor.name} did not close. Unplug it before using it again.")
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
    with printing() as output:
        try:
            _run(arguments)
        except KeyboardInterrupt:
            complain("duplex: stopped")
            sys.exit(130)
        except DuplexError as error:
            complain(f"duplex: {error}")
            sys.exit(2)
        except (OSError, MemoryError, ImportError) as error:
            if (said := _of_machine(error)) is None:
                raise
            complain(f"duplex: {said}")
            sys.exit(2)
        output.flush()
        if isinstance(output.failure, BrokenPipeError):
            sys.exit(1)
        if output.failure is not None:
            complain(f"duplex: the output could not be printed completely: {output.failure.strerror}.")
            sys.exit(2)


def _of_machine(error: OSError | MemoryError | ImportError) -> str | None:
    """What the machine lacks, in a sentence; None if it may be this program's fault."""
    if isinstance(error, MemoryError) or any(said in str(error) for said in _NO_MEMORY):
        return "The memory that this process may use is too small."
    if isinstance(error, OSError):
        named = f"{error.filename}: " if error.filename else ""
        return f"{named}{error.strerror or error}."
    return None


def _run(arguments: Sequence[str] | None) -> None:
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        from importlib.metadata import version

        print(f"duplex {version('duplex-kinects')}")
        return
    # imported here, where Ctrl-C is expected: the imports take most of the start
    from viewer_app.options.command_line import COMMANDS, parsed

    options = parsed(given)
    from viewer_app.output_files import outputs_of_one_run

    module = next(module for kind, module in COMMANDS.values() if kind is type(options))
    import pyarrow

    sys.meta_path.insert(0, _NoPandas)
    pyarrow.array([])
    sys.meta_path.remove(_NoPandas)
    with outputs_of_one_run():
        importlib.import_module(module).run(options)


class _NoPandas:
    """Finds no pandas, which pyarrow looks for at its first array: importing it takes half a second, and no
    command has data of it. ``to_pandas`` looks again."""

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        if name == "pandas":
            raise ImportError


if __name__ == "__main__":
    script()
