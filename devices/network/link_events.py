"""Sentences about the messages of a remote sensor, when their losses begin, go on and end."""

from __future__ import annotations

from devices.sensor import LinkFigures

_EVERY_NS = 10_000_000_000


class LinkEvents:
    """Reports losses and damaged messages, at most every ten seconds.

    Args:
        name: Of the sensor.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._since_ns: int | None = None
        self._told = LinkFigures()
        self._sound = True

    def observe(self, figures: LinkFigures, now_ns: int) -> list[str]:
        """The sentences to report now."""
        if self._since_ns is None:
            self._since_ns, self._told = now_ns, figures
            return []
        if now_ns - self._since_ns < _EVERY_NS:
            return []
        before, self._told, self._since_ns = self._told, figures, now_ns
        lost, came = figures.lost - before.lost, figures.received - before.received
        malformed = figures.malformed - before.malformed
        said = []
        if lost:
            said.append(
                f"{self._name}: frames lost or late on their way in the last 10 s: {lost} of {lost + came}. "
                f"Check the network between the two PCs; a cable is better than Wi-Fi."
            )
        elif not self._sound and came:
            said.append(f"{self._name}: all frames of the last 10 s arrived.")
        if malformed:
            said.append(
                f"{self._name}: {malformed} damaged or unknown messages were left out. Do both PCs run the "
                f"same version of duplex?"
            )
        self._sound = lost == 0
        return said
