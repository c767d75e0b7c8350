"""Opens Zenoh sessions: explicit addresses, this machine only unless told otherwise, no discovery."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from devices.check import extra_command, words_of
from devices.sensor import DeviceError

LOOPBACK = "tcp/127.0.0.1:7447"
"""The address on which a session meets others of the same machine; 7447 is Zenoh's registered port."""

LARGEST_MESSAGE = 1 << 23
"""Bytes: a larger message is refused before it is held in memory."""

_ENDPOINT = re.compile(r"(tcp|udp)/(\[[0-9A-Fa-f:.%]+\]|[^\s/:\[\]?#]+):(\d{1,5})")
_KEY = re.compile(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*")


@dataclass(frozen=True)
class ZenohAddresses:
    """The addresses by which a Zenoh session reaches others.

    Raises:
        DeviceError: An address is not ``tcp/HOST:PORT`` or ``udp/HOST:PORT``.
    """

    listen: tuple[str, ...] = ()
    """Addresses of this machine on which it waits for others, such as ``tcp/127.0.0.1:7447``."""
    connect: tuple[str, ...] = ()
    """Addresses to connect to. An absent peer is retried until it is available."""

    @staticmethod
    def of_meeting_point(listen: tuple[str, ...], connect: tuple[str, ...]) -> ZenohAddresses:
        """The addresses of a program that others connect to: this machine's standard one if none is given."""
        return ZenohAddresses(listen if listen or connect else (LOOPBACK,), connect)

    @staticmethod
    def of_visitor(listen: tuple[str, ...], connect: tuple[str, ...]) -> ZenohAddresses:
        """The addresses of a program that connects to others: to this machine's standard one if none is
        given."""
        return ZenohAddresses(listen, connect if listen or connect else (LOOPBACK,))

    def __post_init__(self) -> None:
        for address in (*self.listen, *self.connect):
            found = _ENDPOINT.fullmatch(address)
            if found is None or not 0 < int(found[3]) < 65536:
                raise DeviceError(f"{address!r} is not a Zenoh address: write tcp/HOST:PORT, as {LOOPBACK}.")


def checked_key(key: str) -> str:
    """Returns a key to publish under.

    Raises:
        DeviceError: It is not made of names and slashes.
    """
    if _KEY.fullmatch(key) is None:
        raise DeviceError(
            f"{key!r} is not a Zenoh key: use letters, digits, '_', '-' and '.', and '/' between names, as "
            f"lab/kinect-a."
        )
    return key


@contextmanager
def zenoh_session(addresses: ZenohAddresses) -> Iterator[Any]:
    """A Zenoh session, closed at the end of the block. Blocks with the same addresses share one session.

    Multicast scouting and gossip are off: the session knows nobody but the peers at its addresses.

    Raises:
        DeviceError: Zenoh is not installed, or an address is busy or unknown.
    """
    with _lock:
        session, users = _sessions.get(addresses) or (_open(addresses), 0)
        _sessions[addresses] = session, users + 1
    try:
        yield session
    finally:
        with _lock:
            session, users = _sessions.pop(addresses)
            if users > 1:
                _sessions[addresses] = session, users - 1
            else:
                session.close()


_lock = threading.Lock()
_sessions: dict[ZenohAddresses, tuple[Any, int]] = {}  # and how many blocks use each


def _open(addresses: ZenohAddresses) -> Any:
    zenoh = load_zenoh()
    configuration = zenoh.Config()
    for key, value in _settings(addresses).items():
        configuration.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(configuration)
    except zenoh.ZError as fault:
        where = ", ".join((*addresses.listen, *addresses.connect))
        raise DeviceError(f"Zenoh cannot use {where}: {first_words(str(fault))}.") from fault


def load_zenoh() -> Any:
    """The module ``zenoh``."""
    try:
        import zenoh
    except ModuleNotFoundError as fault:
        raise DeviceError(f"Zenoh is not installed: {extra_command('zenoh')}.") from fault
    except Exception as fault:  # a damaged library raises what it likes
        why = f"Zenoh cannot be imported ({words_of(fault)}): pip install --force-reinstall eclipse-zenoh."
        raise DeviceError(why) from fault
    return zenoh


def _settings(addresses: ZenohAddresses) -> dict[str, Any]:
    return {
        "mode": "peer",
        "listen/endpoints": list(addresses.listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(addresses.connect),
        # Opening does not wait for absent peers; they are tried again in the background for ever.
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # Room for half a second of frames, so that a busy machine drops none.
        "transport/link/tx/queue/size/interactive_high": 16,
        "transport/link/rx/max_message_size": LARGEST_MESSAGE,
        "transport/shared_memory/enabled": False,
    }


def first_words(fault: str) -> str:
    """Zenoh's message without the lines of its sources."""
    return re.split(r"\s+at /|: \[", fault)[0].strip().rstrip(".")
