"""A hub: Rerun's server of one session, that viewers connect to.

A recording stream connected directly to a viewer stops permanently when the viewer hangs or ends. Therefore
the data goes through a pipe to a hub (``rerun --serve-grpc -``). The hub keeps a bounded history for viewers
that connect later, and can be abandoned at any time, because writing to a pipe need not block.

It listens on the loopback address unless told otherwise.
"""

from __future__ import annotations

import errno
import os
import random
import socket
import subprocess
from dataclasses import dataclass
from typing import IO
from urllib.parse import quote

from viewer_app.addresses import LOOPBACK, reached_at
from viewer_app.errors import UsageError
from viewer_app.viewer.rerun_process import listens, not_started, start, stop

STARTS_TRIED = 6
"""Of a server, whose ports others may take meanwhile."""
SERVER = "Rerun's server"
_HUB_MEMORY, _FILE_MEMORY = "512MiB", "75%"
PAGE_PORT, DATA_PORT = 9090, 9876
"""The first ports to try for browsers; Rerun's own defaults."""
_PORTS_TRIED = 20


@dataclass
class Hub:
    """A server of one session, and its addresses.

    Whoever binds a port first has it. Until the hub listens for the first time, each start takes other ports
    if another program has taken them since, far enough apart for several that start at once; afterwards they
    stay.
    """

    port: int  # port of the data
    web_port: int | None = None  # port of the web viewer; None without one
    address: str = LOOPBACK  # the address that the hub is bound to
    listened: bool = False  # whether it ever listened
    starts: int = 0

    @staticmethod
    def on_free_ports(web: bool, address: str | None = None) -> Hub:
        """A hub that is not started yet; for browsers on the usual ports, or the next free ones."""
        host = address or LOOPBACK
        if not web:
            return Hub(free_port(host), None, host)
        return Hub(free_port(host, DATA_PORT), free_port(host, PAGE_PORT), host)

    @property
    def url(self) -> str:
        """What ``rerun --connect`` takes."""
        return f"rerun+http://{reached_at(self.address)}:{self.port}/proxy"

    @property
    def site(self) -> str:
        """The URL of the web viewer."""
        return f"http://{reached_at(self.address)}:{self.web_port}"

    @property
    def page(self) -> str:
        """What a browser opens."""
        return f"{self.site}/?url={quote(self.url, safe=':/')}"

    def start(self, session: IO[bytes] | None = None) -> subprocess.Popen[bytes]:
        """Starts the hub, which listens once it has received data.

        Args:
            session: A file that it serves as a whole. None: it reads from its standard input, a pipe, and
                forgets the oldest data when its memory is full.
        """
        if not self.listened:
            apart = random.randrange(1, _PORTS_TRIED) if self.starts else 0
            self.port = free_port(self.address, self.port + apart)
            if self.web_port is not None:
                self.web_port = free_port(self.address, self.web_port + apart)
        self.starts += 1
        web = ["--serve-grpc"]
        if self.web_port is not None:
            # without the last, a browser may read the data only from a page of this machine
            web = ["--serve-web", "--web-viewer-port", str(self.web_port), "--cors-allow-origin", self.site]
        return start(
            [
                *web,
                *("--bind", self.address, "--port", str(self.port)),
                *("--server-memory-limit", _HUB_MEMORY if session is None else _FILE_MEMORY, "-"),
            ],
            stdin=subprocess.PIPE if session is None else session,
            dies_with_us=True,
        )

    def serve(self, session: IO[bytes]) -> subprocess.Popen[bytes]:
        """Starts a hub for a file, and returns it once it listens.

        Raises:
            UsageError: None of several starts listens.
        """
        for _ in range(STARTS_TRIED):
            session.seek(0)
            process = self.start(session)
            if self.listens(process):
                return process
            stop(process)
        raise not_started(SERVER)

    def listens(self, process: subprocess.Popen[bytes]) -> bool:
        """Waits until a started hub listens; False once it has ended, as where its ports are taken, or after
        20 s."""
        ports = {port for port in (self.port, self.web_port) if port is not None}
        self.listened |= (found := listens(process, ports))
        return found


def free_port(address: str = LOOPBACK, first: int = 0) -> int:
    """A port of the address that nothing listens on: `first` or the next free one; 0: any.

    Raises:
        UsageError: The address is none of this machine's, or 20 ports are taken.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    for port in range(first, first + _PORTS_TRIED):
        try:
            with socket.socket(family) as probe:
                if os.name == "posix":  # else closed connections of the run before would hold the port
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((address, port))
                return int(probe.getsockname()[1])
        except OSError as error:
            fault = error
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                break
    raise UsageError(
        f"Cannot listen on {address!r}: {fault.strerror or fault}. Give an address of this machine, or "
        "0.0.0.0 for all."
    )
