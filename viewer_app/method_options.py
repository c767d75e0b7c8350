"""Checks that the options of a method fit the chosen method."""

from __future__ import annotations

from fusion.setup import PAPER_H, FuserSettings
from viewer_app.errors import UsageError


def check_paper_options(settings: FuserSettings) -> None:
    """Rejects settings of the paper's methods if the method is ``duplex``, which ignores them.

    Raises:
        UsageError: ``--h`` or ``--weights`` is given.
    """
    if settings.method == "duplex" and (settings.h != PAPER_H or settings.weights != "paper"):
        raise UsageError("--h and --weights apply to the paper's methods: add --method paper or published.")
