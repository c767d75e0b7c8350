"""Addresses of this machine."""

import ipaddress
import socket
from collections.abc import Sequence
from contextlib import suppress
from typing import TextIO, cast
from urllib.parse import urlsplit

from rich.console import Console

LOOPBACK = "127.0.0.1"
"""Reaches this machine, and only from itself."""
_FAR = {"0.0.0.0": "198.51.100.1", "::": "2001:db8::1"}
"""Addresses that listen on all networks, and addresses for documentation, which no machine has (RFC 5737,
RFC 3849). The system's way to these starts at this machine's address on its network."""


def in_url(host: str) -> str:
    """A host as URLs write it: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def is_loopback(host: str | None) -> bool:
    """Whether only this machine reaches a host."""
    try:
        return host == "localhost" or ipaddress.ip_address(host or "").is_loopback
    except ValueError:
        return False


def reached_at(listening: str) -> str:
    """The host, as in a URL, at which this machine and others reach a server that listens on an address.

    For all networks it is the address of the network with the default route; without one, this machine's
    name.
    """
    if listening not in _FAR:
        return in_url(listening)
    family = socket.AF_INET6 if ":" in listening else socket.AF_INET
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as way:
        way.connect((_FAR[listening], 9))  # chooses the way; UDP sends nothing yet
        return in_url(way.getsockname()[0])
    return socket.gethostname()


def print_code(address: str, console: Console) -> None:
    """Prints an address for the camera of a phone or tablet, where the terminal can show it."""
    if console.is_terminal and console.encoding.startswith("utf"):
        import segno

        segno.make(address).terminal(cast(TextIO, console.file), compact=True)


def zenoh_warning(listening: Sequence[str]) -> str:
    """Warns of Zenoh addresses, as ``tcp/0.0.0.0:7447``, that others reach; empty if there are none."""
    hosts = {each: urlsplit(each.replace("/", "://", 1)).hostname for each in listening}
    reached = ", ".join(each for each, host in hosts.items() if not is_loopback(host))
    return (
        f"Anyone who can reach {reached} can read and forge skeletons, without a password." if reached else ""
    )
