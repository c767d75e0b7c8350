"""The program ``duplex``: one command per task. A usage error prints one line and exits with code 2."""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
from collections.abc import Sequence


def script() -> None:
    """The console script: runs :func:`main`, then ignores Ctrl-C during shutdown."""
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # during shutdown it would print a traceback


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs a command line.

    Args:
        arguments: The arguments after the program's name. None: the arguments of the process.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
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
    except Exception as error:
        if not isinstance(error, _mistakes()):
            raise
        print(f"duplex: {error}", file=sys.stderr)
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


def _mistakes() -> tuple[type[Exception], ...]:
    from devices.sensor import DeviceError
    from fusion.errors import FusionError
    from recordings.errors import RecordingError
    from viewer_app.errors import UsageError

    return (DeviceError, FusionError, RecordingError, UsageError)


if __name__ == "__main__":
    script()
