"""Open Sound Control 1.0: messages and bundles of 32-bit arguments, and UDP.

Only what VMC and VRChat need. A bundle is a template that is made once; a frame fills in its floats. That
takes some microseconds.
"""

from __future__ import annotations

import re
import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewer_app.addresses import LOOPBACK, in_url
from viewer_app.errors import UsageError

LARGEST_DATAGRAM = 1472
"""Bytes: what fits into one Ethernet frame with the headers of IPv4 and UDP."""
_BUNDLE = b"#bundle\0" + struct.pack(">Q", 1)  # time tag 1: immediately

Argument = str | int | float | None


@dataclass(frozen=True)
class OscMessage:
    """A message; an argument None is a float that each frame fills in."""

    address: str
    arguments: tuple[Argument, ...]

    def encoded(self) -> tuple[bytes, list[int]]:
        """The message with zeros for open floats, and their offsets in bytes."""
        tags, body, open_at = ",", b"", []
        for argument in self.arguments:
            match argument:
                case str():
                    tags, body = tags + "s", body + _string(argument)
                case int():
                    tags, body = tags + "i", body + struct.pack(">i", argument)
                case float():
                    tags, body = tags + "f", body + struct.pack(">f", argument)
                case None:
                    open_at.append(len(body))
                    tags, body = tags + "f", body + bytes(4)
        head = _string(self.address) + _string(tags)
        return head + body, [len(head) + at for at in open_at]


class OscBundle:
    """A bundle that is made once and filled in for each frame.

    Args:
        messages: Its messages, in their order.
    """

    def __init__(self, messages: Sequence[OscMessage]) -> None:
        encoded, open_at = bytearray(_BUNDLE), []
        for message in messages:
            content, offsets = message.encoded()
            encoded += struct.pack(">i", len(content))
            open_at += [len(encoded) + at for at in offsets]
            encoded += content
        self.floats = len(open_at)
        """How many floats a frame fills in."""
        self._template = np.frombuffer(bytes(encoded), dtype=np.uint8)
        self._slots = (np.array(open_at, dtype=np.int64)[:, None] + np.arange(4)).ravel()

    def __len__(self) -> int:
        """Bytes."""
        return len(self._template)

    def filled(self, values: NDArray[np.float64]) -> bytes:
        """The bundle with its open floats (``floats``,), in the order of the messages."""
        encoded = self._template.copy()
        encoded[self._slots] = values.astype(">f4").view(np.uint8)
        return encoded.tobytes()


def split_bundles(messages: Sequence[OscMessage], largest: int = LARGEST_DATAGRAM) -> list[OscBundle]:
    """As few bundles as possible that fit into datagrams of so many bytes, the messages in their order."""
    bundles: list[list[OscMessage]] = [[]]
    size = len(_BUNDLE)
    for message in messages:
        more = 4 + len(message.encoded()[0])
        if bundles[-1] and size + more > largest:
            bundles.append([])
            size = len(_BUNDLE)
        bundles[-1].append(message)
        size += more
    return [OscBundle(each) for each in bundles]


def filled(bundles: Sequence[OscBundle], values: NDArray[np.float64]) -> list[bytes]:
    """Several bundles with their open floats, one after the other."""
    made, begin = [], 0
    for bundle in bundles:
        made.append(bundle.filled(values[begin : begin + bundle.floats]))
        begin += bundle.floats
    return made


def _string(text: str) -> bytes:
    """Ended by a zero byte and filled up with zeros to a multiple of four bytes."""
    encoded = text.encode("ascii") + b"\0"
    return encoded + bytes(-len(encoded) % 4)


@dataclass(frozen=True)
class Address:
    """A host and a port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{in_url(self.host)}:{self.port}"

    @staticmethod
    def of(text: str, option: str, example: int) -> Address:
        """Reads ``HOST:PORT``, ``[IPV6]:PORT`` or ``PORT``, which is a port of this machine.

        Raises:
            UsageError: It is none of them.
        """
        found = re.fullmatch(r"(?:(\[[0-9A-Fa-f:.%\w]+\]|[^\s:/\[\]]+):)?(\d{1,5})", text.strip())
        if found is None or not 0 < int(found[2]) < 65536:
            raise UsageError(f"{option} {text}: write HOST:PORT, as in {LOOPBACK}:{example}.")
        return Address((found[1] or LOOPBACK).strip("[]"), int(found[2]))


def looked_up(address: Address, option: str) -> tuple[socket.AddressFamily, Any]:
    """The family and the socket address of a UDP receiver.

    Raises:
        UsageError: The host is unknown; the message names the command's option.
    """
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as fault:
        reason = getattr(fault, "strerror", None) or fault
        raise UsageError(f"{option} {address}: unknown host {address.host!r} ({reason}).") from fault
    return found[0][0], found[0][4]


class UdpSender:
    """Sends datagrams to one address; no receiver is needed, and sending never waits.

    Args:
        address: The receiver.
        option: The command's option, for messages.

    Raises:
        UsageError: The host is unknown.
    """

    def __init__(self, address: Address, option: str) -> None:
        family, self._to = looked_up(address, option)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, datagrams: Sequence[bytes]) -> int:
        """Sends datagrams; returns 1.

        Raises:
            OSError: The network refused one of them.
        """
        for datagram in datagrams:
            self._socket.sendto(datagram, self._to)
        return 1

    def close(self) -> None:
        """Closes the socket."""
        self._socket.close()
