"""What tells whose a machine is, planted wherever ``duplex doctor --bundle`` may look."""

import json
import os
import sys
import zipfile
from pathlib import Path

from devices.check import Check, failed
from devices.sensor import DeviceError

USER, HOST, OTHER, FOLDER = "quillon", "lab-zorba-7", "mesa-kirk-3", "Xanadu"
NUMBERS = ("000123", "000456", "778899001122", "AB12CD34EF")
PLANTED = (USER, HOST, OTHER, "Zaphira", "Quex", FOLDER, "Lagash", *NUMBERS)
UUID = "6fe10177-90d1-4b6e-93a1-1f0000a1b2c3"
KINDS = {  # what stands in a text, and the words of it that must not
    "user": (USER, [USER]),
    "account": (f"{USER}@{HOST}", [USER, HOST]),
    "given name": ("Zaphira", ["Zaphira"]),
    "surname": ("Quex", ["Quex"]),
    "host": (OTHER, [OTHER]),
    "host in full": (f"{OTHER}.example.org", [OTHER]),
    "display": (f"{HOST}:10.0", [HOST]),
    "home": (f"/home of/{USER}/notes.txt", [USER, "notes"]),
    "file beside": (f"/srv/{FOLDER}/a b/patient.bin", [FOLDER, "patient"]),
    "path with a stop": ("/srv/Dr. Vorlund/models", ["Vorlund"]),
    "file with a stop": ("/srv/Dr. Vorlund/models/libx.so.1", ["Vorlund"]),
    "known folder's part": ("Lagash", ["Lagash"]),
    "relative path": ("patients/vorlund/walk.mkv", ["patients", "vorlund"]),
    "file in a folder": ("vorlund/walk.mkv", ["vorlund"]),
    "path from here": ("../vorlund", ["vorlund"]),
    "path from home": ("~vorlund/walk", ["vorlund"]),
    "drive": (f"D:\\{FOLDER}\\vorlund.dat", [FOLDER, "vorlund"]),
    "share": (f"\\\\{HOST}\\vorlund\\x.dat", [HOST, "vorlund"]),
    "file URL": ("file:///srv/vorlund/x.html", ["vorlund"]),
    "URL": ("http://nas.vorlund.example:8080/a?token=hunter2", ["vorlund", "hunter2"]),
    "URL with a password": ("ftp://vorlund:hunter2@nas.example/x", ["vorlund", "hunter2", "nas"]),
    "locator": ("tcp/nas-vorlund:7447", ["vorlund"]),
    "mail": ("jane.vorlund@example.com", ["vorlund", "jane"]),
    "IPv4": ("192.168.17.42", ["192.168", "17.42"]),
    "IPv4 and port": ("tcp/192.168.17.42:7447", ["192.168", "17.42"]),
    "IPv6": ("fe80::1ff:fe23:4567:890a", ["fe23", "890a"]),
    "IPv6 in full": ("2001:db8:0:0:8:800:200c:417a", ["200c", "417a"]),
    "MAC": ("00:1a:2b:3c:4d:5e", ["3c:4d"]),
    "MAC with dashes": ("00-1A-2B-3C-4D-5E", ["3C-4D"]),
    "MAC of routers": ("001a.2b3c.4d5e", ["2b3c"]),
    "serial": ("Serial number: 778899001122", ["778899001122"]),
    "S/N": ("S/N: AB-778899-X", ["778899"]),
    "SN": ("SN 778899001122", ["778899001122"]),
    "serial in JSON": ('"SerialId":"AB12CD34EF"', ["AB12CD34EF"]),
    "UUID": (UUID, [UUID]),
    "machine id": ("5e0f1c2b3a4d5e6f708192a3b4c5d6e7", ["5e0f1c2b"]),
}
SENTENCES = (
    "{}",
    "({})",
    "'{}'",
    "at {}, no",
    "a={};b",
    "Cannot open {}. Plug it in.",
    "x\n{}\ny",
    "{}: denied",
)


def plant(monkeypatch, tmp_path):
    """Plants the person's traces wherever the program may look; gives a sentence with all of them."""
    home = tmp_path / "home of" / USER
    secret = home / FOLDER
    (secret / "models").mkdir(parents=True)
    for name, value in (
        *(("HOME", home), ("USER", USER), ("LOGNAME", USER), ("USERNAME", USER), ("HOSTNAME", HOST)),
        *(("DISPLAY", f"{HOST}:0"), ("XAUTHORITY", secret / "X authority"), ("SUDO_USER", USER)),
    ):
        monkeypatch.setenv(name, str(value))
    monkeypatch.setattr("socket.gethostname", lambda: f"{OTHER}.example.org")
    monkeypatch.setattr("platform.node", lambda: OTHER)
    monkeypatch.setenv("LD_LIBRARY_PATH", f"/srv/{FOLDER} (of Lagash)/lib:/opt")
    if sys.platform != "win32":
        monkeypatch.setattr("pwd.getpwuid", lambda _: type("Entry", (), {"pw_gecos": "Zaphira B. Quex,,,"}))
    monkeypatch.chdir(secret)
    return (
        f"{USER}@{HOST}: Kinect 000123 and 000456 of Zaphira B. Quex on {OTHER} "
        f"({secret}/libk4a.so.1.4), "
        f"{secret / 'X authority'}; /srv/{FOLDER}/a b/{USER}/x.bin, /srv/{FOLDER} (of Lagash)/lib/y.so, "
        f"D:\\{FOLDER}\\depth engine.dll, \\\\{HOST}\\{FOLDER}; "
        f'Serial number: 778899001122, "SerialId":"AB12CD34EF", {{{UUID}}}\n'
    )


def checks_that_tell(trace):
    """Findings with a trace, which libraries print and log, too."""
    os.write(2, f"from a library: {trace}\n".encode())
    Path(os.environ["K4A_ENABLE_LOG_TO_A_FILE"]).write_text(f"from libk4a: {trace}", encoding="utf-8")
    fault = DeviceError(f"The library cannot open {trace}. Its advice is {trace}, too.")
    return [
        failed(f"a check of {trace}", fault, needed=False),
        Check("b", True, trace, serves=trace, install=trace),
    ]


def contents(path):
    """The files of a bundle."""
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
        return {name: file.read(name) for name in file.namelist()}


def told(path, words):
    """Which of the words are in a bundle's files, also where JSON escapes them."""
    found = []
    for name, content in contents(path).items():
        for text in (content.decode(), json.dumps(json.loads(content)) if name.endswith(".json") else ""):
            found += [(name, word) for word in words if word.lower() in text.lower()]
    return found
