"""Open Sound Control over UDP, encoded by python-osc: what VMC and VRChat share."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import build_msg

from fusion.body import Body
from recordings.planted_feet import PlantedFeet
from viewer_app.addresses import LOOPBACK, in_url
from viewer_app.errors import UsageError
from viewer_app.outputs.output import LiveOutput
from viewer_app.sinks.item_queue import QueuedFrame

LARGEST_DATAGRAM = 1472
"""Bytes: what fits into one Ethernet frame with the headers of IPv4 and UDP."""

Message = tuple[str, list[Any]]
"""Address and arguments: texts, whole numbers, floats."""
Encode = Callable[[NDArray[np.float64], int], list[bytes]]
"""Gives the datagrams of (J, 3) joints in K_A's frame at a time in nanoseconds."""


def bundled(messages: Iterable[Message]) -> list[bytes]:
    """The messages in their order, in as few bundles as possible that each fit into a datagram."""
    bundles, size = [], LARGEST_DATAGRAM
    for address, arguments in messages:
        message = build_msg(address, arguments)
        if size + 4 + message.size > LARGEST_DATAGRAM:
            bundles.append(OscBundleBuilder(IMMEDIATELY))
            size = 16  # of an empty bundle
        bundles[-1].add_content(message)
        size += 4 + message.size
    return [bundle.build().dgram for bundle in bundles]


@dataclass(frozen=True)
class Address:
    """A host and a port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{in_url(self.host)}:{self.port}"

    @staticmethod
    def of(text: str, option: str, example: int) -> Address:
        """Reads ``HOST:PORT``, ``[IPV6]:PORT`` or ``PORT``, which is a port of this machine."""
        found = re.fullmatch(r"(?:(\[[0-9A-Fa-f:.%\w]+\]|[^\s:/\[\]]+):)?(\d{1,5})", text.strip())
        if found is None or not 0 < int(found[2]) < 65536:
            raise UsageError(f"{option} {text}: write HOST:PORT, as in {LOOPBACK}:{example}.")
        return Address((found[1] or LOOPBACK).strip("[]"), int(found[2]))


def looked_up(address: Address, option: str) -> tuple[socket.AddressFamily, Any]:
    """The family and the socket address of a UDP receiver.

    A name that has addresses of both kinds gives the one of IPv4, where VSeeFace, uOSC and VRChat listen:
    ``localhost`` is ``::1`` first on Debian, macOS and Windows.
    """
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as fault:
        reason = getattr(fault, "strerror", None) or fault
        raise UsageError(f"{option} {address}: unknown host {address.host!r} ({reason}).") from fault
    family, *_, address_of = min(found, key=lambda one: one[0] != socket.AF_INET)
    return family, address_of


class OscOutput(LiveOutput):
    """Sends S* as datagrams to one address; no receiver is needed, and sending never waits.

    Args:
        option: The command's option, for messages.
        encode: Of a frame.
        feet_of: The body whose feet stay where they stand; None: they are those of S*.
    """

    def __init__(
        self, name: str, address: Address, option: str, encode: Encode, feet_of: Body | None = None
    ) -> None:
        super().__init__(name)
        self._encode = encode
        self._feet = None if feet_of is None else PlantedFeet(feet_of)
        self._nobody: NDArray[np.float64] | None = None  # (J, 3) NaN, once a frame was sent
        self._begun_ns: int | None = None  # since 1970, by the time of capture of the first frame
        self._later_ns = 0  # by which that of the newest frame is later
        family, self._to = looked_up(address, option)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.start()

    def send_frame(self, frame: QueuedFrame) -> int | None:
        """Sends the datagrams of a frame; None if it has none."""
        positions, unix_ns = frame.fused.positions, frame.frame.unix_ns
        self._nobody = np.full(positions.shape, np.nan)
        if unix_ns is not None:
            begun_ns = unix_ns - frame.time_ns
            self._begun_ns = begun_ns if self._begun_ns is None else self._begun_ns
            self._later_ns = begun_ns - self._begun_ns
        time_ns = frame.time_ns + self._later_ns
        if self._feet is not None:
            positions = self._feet.update(positions, frame.fused.sigma, time_ns)
        datagrams = self._encode(positions, time_ns)
        for datagram in datagrams:
            self._socket.sendto(datagram, self._to)
        return 1 if datagrams else None

    def send_silence(self, time_ns: int) -> None:
        """Sends the datagrams of a frame without a person."""
        if self._nobody is not None:
            for datagram in self._encode(self._nobody, time_ns + self._later_ns):
                self._socket.sendto(datagram, self._to)

    def shut(self) -> None:
        self._socket.close()
