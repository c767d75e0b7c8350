"""The program ``duplex``: one command a task; a mistake is one line and exit code 2."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import tyro

from viewer_app.options import (
    CompareOptions,
    DemoOptions,
    ExportOptions,
    FuseOptions,
    InfoOptions,
    ReplayOptions,
    ReviewOptions,
    TrimOptions,
)

_COMMANDS: dict[str, tuple[Callable[..., Any], str]] = {
    "demo": (DemoOptions, "viewer_app.demo"),
    "fuse": (FuseOptions, "viewer_app.fuse"),
    "replay": (ReplayOptions, "viewer_app.replay"),
    "review": (ReviewOptions, "viewer_app.review"),
    "compare": (CompareOptions, "viewer_app.compare"),
    "export": (ExportOptions, "viewer_app.export"),
    "trim": (TrimOptions, "viewer_app.trim"),
    "info": (InfoOptions, "viewer_app.info"),
}
"""By name: the options, and the module whose ``run`` carries the command out."""


def main(arguments: Sequence[str] | None = None) -> None:
    """The console script.

    Args:
        arguments: What follows the program's name; those of the process where None.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    options = tyro.extras.subcommand_cli_from_dict(
        {name: options for name, (options, _) in _COMMANDS.items()},
        args=arguments,
        prog="duplex",
        description="One skeleton from two Kinects.",
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    module = next(module for kind, module in _COMMANDS.values() if kind is type(options))
    try:
        importlib.import_module(module).run(options)
    except KeyboardInterrupt:
        print("duplex: stopped", file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        if not isinstance(error, _mistakes()):
            raise
        print(f"duplex: {error}", file=sys.stderr)
        sys.exit(2)


def _mistakes() -> tuple[type[Exception], ...]:
    from devices.sensor import DeviceError
    from fusion.errors import FusionError
    from recordings.errors import RecordingError
    from viewer_app.errors import UsageError

    return (DeviceError, FusionError, RecordingError, UsageError)


if __name__ == "__main__":
    main()
