"""The program ``duplex``: one command a task; a mistake is one line and exit code 2."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import tyro

from viewer_app.options import FuseOptions

_COMMANDS = {"fuse": FuseOptions}


def main(arguments: Sequence[str] | None = None) -> None:
    """The console script.

    Args:
        arguments: What follows the program's name; those of the process where None.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    options = tyro.extras.subcommand_cli_from_dict(
        _COMMANDS,
        args=arguments,
        prog="duplex",
        description="One skeleton from two Kinects.",
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    try:
        _dispatch(options)
    except KeyboardInterrupt:
        print("duplex: stopped", file=sys.stderr)
        sys.exit(130)
    except _mistakes() as error:
        print(f"duplex: {error}", file=sys.stderr)
        sys.exit(2)


def _dispatch(options: FuseOptions) -> None:
    from viewer_app import fuse

    fuse.run(options)


def _mistakes() -> tuple[type[Exception], ...]:
    from devices.sensor import DeviceError
    from fusion.errors import FusionError
    from recordings.errors import RecordingError
    from viewer_app.errors import UsageError

    return (DeviceError, FusionError, RecordingError, UsageError)


if __name__ == "__main__":
    main()
