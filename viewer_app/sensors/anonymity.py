"""Replaces names, paths, addresses and serial numbers in texts."""

import getpass
import hashlib
import ipaddress
import os
import platform
import re
import secrets
import socket
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from devices.cache import home

_LIBRARY = re.compile(r"\S*\.(so[\d.]*|dll|dylib|pyd?|onnx|tflite|rules)")
_KNOWN = "\1"  # begins the name that a known folder has until its whole path is replaced
_PART = r"""(?:(?!\. )[^\\/\n"'<>|;,:()])"""
_PATH = re.compile(
    rf"(?:/(?={_KNOWN})|(?<![\w<.\\/])(?:[A-Za-z]:[\\/]|\\\\(?=\w)|(?<!:)//(?=\w)|/(?=[^\s/])))(?:{_PART}*[\\/])*"
    rf"(?:{_PART}*?\.[A-Za-z]\w{{0,7}}[\d.]*(?!\w)|(?:(?!\s){_PART})*)"
)
_MARKS = re.compile(r"\x1b\[[\d;]*m|file://|\\\\\?\\")  # colours, and what may stand before a path
_AFTER_A_STOP = re.compile(r"(<\w+>)(?:\. [^\s/\\]+)+[\\/]\S*")  # a path that has ". " in it
_RELATIVE = re.compile(
    r"(?<![\w<>\\/.:@-])(?:(?:~[\w.-]*|\.{1,2})[\\/]\S*"
    r"|(?=[\w.\\/-]*[^\W\d])(?:[\w.-]+[\\/])+(?:[\w.-]+[\\/][\w.-]+|[\w.-]+\.[A-Za-z]\w{0,7})(?!\w))"
)
_SERIAL = re.compile(
    r"""((?:\bs/?n\b|serial[ _-]?(?:number|no|id)?)["']?\W{1,4})((?=[\w-]*\d)\w[\w-]{3,})""", re.IGNORECASE
)
_UNIQUE = re.compile(r"\b(?:[\da-f]{8}(?:-[\da-f]{4}){3}-[\da-f]{12}|[\da-f]{32})\b", re.IGNORECASE)
"""A UUID, such as the one that USB knows a sensor by, which libk4a logs; a machine's id."""
_URL = re.compile(r"""\b([a-z][\w+.-]*://)(?:[^\s/@]*@)?([\w.-]+|\[[^\]]*\])[^\s"'<>,;)]*""", re.IGNORECASE)
_LOCATOR = re.compile(r"\b(tcp|udp|tls|quic|ws|wss)/(?:[\w.-]+|\[[^\]]*\]):\d+", re.IGNORECASE)
_PUBLIC = re.compile(
    r"(?:.+\.)?(?:github\.com|github\.io|microsoft\.com|aka\.ms|pypi\.org|python\.org|readthedocs\.io)"
)
_MAIL = re.compile(r"[\w.+-]+@[\w-]+(?:\.[\w-]+)+")
_MAC = re.compile(
    r"\b(?:[\da-f]{2}([:-])(?:[\da-f]{2}\1){4}[\da-f]{2}|[\da-f]{4}(?:\.[\da-f]{4}){2})\b", re.IGNORECASE
)
_ADDRESS = re.compile(
    r"(?<![\w:.])(?:\d{1,3}(?:\.\d{1,3}){3}|(?=[\da-f]*:[\da-f]*:)[\da-f:.]+(?:%\w+)?)(?!\w)",
    re.IGNORECASE,
)
_PERSONAL = re.compile(r"[^\W\d_]*[A-Z][^\W\d_]*|[^\x00-\x7f]+")
_NOBODYS = re.compile(
    r"(?i).*(kinect|azure|orbbec|realsense|femto|k4a|duplex|python|cuda|nvidia|driver|sdk).*"
    r"|users|program files.*|windows|appdata|local|roaming|library|applications|volumes|documents"
    r"|desktop|downloads|temp|work|home"
)
"""Parts of paths that tell nothing, and what a text without them could not say."""


class Anonymity:
    """Replaces serial numbers, names of user and machine, paths and addresses in texts.

    A serial number becomes the same hash each time. The hash has a key that is forgotten: without one, all
    serial numbers of twelve digits could be tried. Of a path, the name of a library's file stays.

    Args:
        serials: Serial numbers of the sensors; others are found where the text says that they are such, and
            UUIDs count as serial numbers.
        paths: Paths as the user gave them, relative ones too.
    """

    def __init__(self, serials: Iterable[str], paths: Iterable[Path] = ()) -> None:
        self._key = secrets.token_bytes(16)
        self._known_serials = set(serials)
        self._serials = _any_of(self._known_serials)
        variables = (path for value in os.environ.values() for path in value.split(os.pathsep))
        others = [*filter(os.path.isabs, variables), *map(str, paths), str(Path.cwd())]
        named = {str(home()): "home", sys.prefix: "python", tempfile.gettempdir(): "temporary"}
        self._folders = dict.fromkeys(filter(re.compile(r".+[\\/]").match, others), "path") | named
        self._known = _any_of((path for path in self._folders if len(path) > 1), end=r"(?![^\W_])")
        names = {os.environ.get(key, "") for key in ("USER", "LOGNAME", "USERNAME", "SUDO_USER")}
        names |= {os.environ.get(key, "") for key in ("HOSTNAME", "COMPUTERNAME", "USERDOMAIN")}
        for host in (socket.gethostname(), platform.node()):
            names |= {host, host.partition(".")[0]}
        with suppress(KeyError, OSError, ImportError):
            names.add(getpass.getuser())
            if sys.platform != "win32":
                import pwd

                names.add(pwd.getpwuid(os.getuid()).pw_gecos.split(",")[0])
        for key, value in os.environ.items():
            if key == "DISPLAY" or key.endswith(("HOST", "SERVER", "DOMAIN")):
                host = re.split(r"[:/\s]", value)[0]
                names |= {host, host.partition(".")[0]}
        words = [part for name in names for part in name.split() if len(part) > 2]
        for part in {part for path in others for part in re.split(r"[\\/]", path)}:
            if not _NOBODYS.fullmatch(part) and _PERSONAL.search(part):
                words += [part, *(word.strip(".,()") for word in part.split() if _PERSONAL.search(word))]
        names |= {word for word in words if len(word) > 2}
        names -= {"root", "localhost", "unix"}  # nobody's
        self._names = _any_of((name for name in names if len(name) > 1), r"(?<![^\W_])", r"(?![^\W_])")

    def learn(self, serials: Iterable[str]) -> None:
        """Serial numbers of sensors that came later."""
        self._known_serials.update(serials)
        self._serials = _any_of(self._known_serials)

    def __call__(self, text: str) -> str:
        """The text without them."""
        text = _MARKS.sub("", text)
        text = _URL.sub(lambda found: found[0] if _PUBLIC.fullmatch(found[2]) else f"{found[1]}<host>", text)
        text = _LOCATOR.sub(r"\1/<host>", _MAC.sub("<address>", _MAIL.sub("<name>", text)))
        for unique in (self._serials, _UNIQUE):
            text = unique.sub(lambda found: self._hash(found[0]), text)
        text = _SERIAL.sub(lambda found: found[1] + self._hash(found[2]), text)
        text = self._known.sub(lambda found: f"/{_KNOWN}{self._folders.get(found[0], 'path')}", text)
        text = _AFTER_A_STOP.sub(r"\1", _PATH.sub(_shortened, text))
        text = self._names.sub("<name>", _RELATIVE.sub(_shortened, text))
        return _ADDRESS.sub(_address, text)

    def _hash(self, serial: str) -> str:
        return "sensor-" + hashlib.blake2s(serial.upper().encode(), key=self._key, digest_size=4).hexdigest()


def _address(found: re.Match[str]) -> str:
    """An IP address; what only looks like one, and those that every machine has, stay."""
    text = found[0].rstrip(".:")
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        return found[0]
    return found[0] if address.is_loopback or address.is_unspecified else f"<address>{found[0][len(text) :]}"


def _shortened(found: re.Match[str]) -> str:
    """A path's known folder, and its last part where that is a library's name."""
    parts = re.split(r"[\\/]", found[0])
    last = parts[-1].rstrip(".")
    folder = parts[1][1:] if parts[1].startswith(_KNOWN) else "path"
    return f"<{folder}>{'/' + last if _LIBRARY.fullmatch(last) else ''}{parts[-1][len(last) :]}"


def _any_of(texts: Iterable[str], start: str = "", end: str = "") -> re.Pattern[str]:
    """A pattern that matches any of the texts, the longest first; without texts it matches nothing."""
    ordered = sorted(filter(None, texts), key=len, reverse=True)
    return re.compile(rf"{start}(?:{'|'.join(map(re.escape, ordered)) or '(?!)'}){end}", re.IGNORECASE)
