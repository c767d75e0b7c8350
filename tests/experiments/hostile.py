"""Tries to make the program crash, hang, lose files or tell whose it is.

``python -m tests.experiments.hostile [PART…] [--count N] [--seed N]``. The parts are ``files``, ``kills``,
``signals``, ``streams``, ``pairs``, ``networks`` and ``bundles``; all of them without one. N (40) is how many
mutated files there are of each kind, and how many kills, bundles and seconds of attacks; the other parts try
every command. What is bad is listed, and a table counts, also after Ctrl-C.
"""

import argparse
import json
import random
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from unittest import mock

import psutil
import pytest

from fusion.body import KINECT_V2
from recordings.calibration_file import calibration_to_json
from recordings.errors import RecordingError
from recordings.file.rrd_file import damage_of
from recordings.session import Session
from recordings.testing import simulated_session
from tests.helpers.avatars import write_vrm
from tests.helpers.network import free_address, free_port
from tests.helpers.recorded_pairs import write_json, write_ntu, write_pair
from tests.helpers.traces import KINDS, SENTENCES, checks_that_tell, plant, told
from tests.helpers.two_views import moving
from viewer_app.cli import main as duplex
from viewer_app.commands import doctor

PROGRAM = (sys.executable, "-m", "viewer_app.cli")
DATA = Path(__file__).parents[1] / "data"
HANGS_S = 120.0
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGPIPE", "SIGUSR1", "SIGALRM", "SIGCONT")
DEADLY = ("SIGQUIT", "SIGUSR1", "SIGALRM")
"""Signals that nobody sends to end a program in order; it may end at once, and loses no file."""
STREAMS = (">&-", ">&- 2>&-", ">/dev/full", ">/dev/full 2>/dev/full", "<&-", "| true")
READS = """
import contextlib, faulthandler, io, json, signal, sys, time, traceback
from viewer_app.cli import main
def late(*_): raise TimeoutError
signal.signal(signal.SIGALRM, late)
for line in sys.stdin:
    arguments, code, said, begun = json.loads(line), 0, io.StringIO(), time.monotonic()
    signal.alarm(60)
    faulthandler.dump_traceback_later(120, exit=True)
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            main(arguments)
    except SystemExit as end: code = end.code
    except BaseException: code = traceback.format_exc().splitlines()[-1]
    signal.alarm(0)
    print(json.dumps([str(code), time.monotonic() - begun]), flush=True)
"""


class Good:
    """Files that are as they should be, in a folder."""

    def __init__(self, folder):
        write_pair(folder)
        self.a, self.b = folder / "a.csv", folder / "b.csv"
        self.pairs = folder / "pairs"
        self.pairs.mkdir()
        for path in (self.a, self.b):
            shutil.copy(path, self.pairs)
        session = simulated_session(seconds=2.0)
        self.session = folder / "s.rrd"
        session.save(self.session)
        info, positions = ("info", "{}"), moving(KINECT_V2, 12)
        fuse = ("fuse", str(self.a), str(self.b), "--no-viewer")
        demo = ("demo", "--seconds", "0.1", "--depth", "none", "--no-viewer")
        self.readers = {self.a: info, self.session: info}
        for name in ("t.trc", "t.c3d"):
            session.export(folder / name)
            self.readers[folder / name] = info
        self.readers[write_json(folder / "o.json", positions)] = info
        self.readers[write_ntu(folder / "n.skeleton", positions)] = info
        (folder / "c.json").write_text(calibration_to_json(Session.open(self.session).calibration))
        self.readers[folder / "c.json"] = (*demo, "--calibrate", "{}")
        (folder / "n.toml").write_text(
            'axes = "x,y,z"\n[joints]\n' + "".join(f'{j} = "{j}"\n' for j in KINECT_V2.joints)
        )
        self.readers[folder / "n.toml"] = (*fuse, "--names", "{}")
        self.readers[write_vrm(folder / "v.vrm", 1)] = (*demo, "--vmc", "127.0.0.1:9", "--avatar", "{}")
        raw = ("demo", "--seconds", "1", "--no-viewer", "--compress", "--record", str(folder / "r"))
        subprocess.run([*PROGRAM, *raw], check=True, stdout=subprocess.DEVNULL)
        self.readers[folder / "r" / "a.mkv"] = info
        with suppress(ImportError):
            import pyrealsense2

            from tests.helpers.realsense import numbered, record

            self.readers[record(pyrealsense2, folder / "d.db3", list(numbered(8)))] = info
            self.readers[Path(shutil.copy(DATA / "realsense_2.55.bag", folder / "b.bag"))] = info


def mutated(content, chance):
    """The content cut off, or with some bytes changed, repeated or taken away."""
    changed = bytearray(content)
    if chance.random() < 0.2:
        return bytes(changed[: chance.randrange(len(changed))])
    for _ in range(chance.randrange(1, 8)):
        at = chance.randrange(min(len(changed), chance.choice((64, 2048, len(changed)))))
        kind = chance.random()
        if kind < 0.7:
            changed[at] = chance.choice((0, 1, 10, 44, 127, 128, 255, chance.randrange(256)))
        else:
            size = chance.randrange(1, 64)
            changed[at : at + size] = b"" if kind < 0.85 else changed[at : at + size] * 3
    return bytes(changed)


def files(good, folder, chance, count):
    """Mutated files of every format, each read by the command that takes it."""
    for original, arguments in good.readers.items():
        content, left = original.read_bytes(), count
        while left:
            with subprocess.Popen(
                [sys.executable, "-c", READS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            ) as run:
                while left:
                    left -= 1
                    path = folder / f"mutated{original.suffix}"
                    path.write_bytes(mutated(content, chance))
                    print(
                        json.dumps([str(path) if each == "{}" else each for each in arguments]),
                        file=run.stdin,
                    )
                    run.stdin.flush()
                    answer = run.stdout.readline()
                    code, took_s = json.loads(answer) if answer else ("it crashed", 0.0)
                    fine = code in ("0", "2", "None")
                    if not fine:
                        shutil.copy(path, f"bad-{left}-{path.name}")
                    kind = original.name if took_s < 30.0 else f"{original.name}, {took_s:.0f} s"
                    yield kind, f"bad-{left}-{path.name}: {code}", fine
                    if not answer:
                        break
                run.stdin.close()


def commands(folder, good):
    """Existing outputs, and the commands that write them; None for commands that write none."""
    session = good.session
    fuse = ("fuse", good.a, good.b, "--no-viewer")
    for name, line in (
        ("fuse.rrd", (*fuse, "--save")),
        ("fuse.json", (*fuse, "--report")),
        ("calibration.json", (*fuse, "--save-calibration")),
        ("review.html", ("review", session, "--no-viewer", "--html")),
        ("compare.html", ("compare", session, session, "--no-viewer", "--html")),
        ("trim.rrd", ("trim", session, "--from", 0.5, "--save")),
        ("replay.rrd", ("replay", session, "--no-viewer", "--save")),
        ("demo.rrd", ("demo", "--seconds", 4, "--depth", "none", "--no-viewer", "--save")),
        ("raw", ("demo", "--seconds", 4, "--no-viewer", "--compress", "--record")),
        ("doctor.zip", ("doctor", "--bundle")),
        *((f"export.{kind}", ("export", session, "--to")) for kind in EXPORTS),
    ):
        yield folder / name, [*PROGRAM, *map(str, line), str(folder / name)]
    for line in (
        ("info", session),
        ("replay", session, "--verify", "--no-viewer"),
        ("compare", session, session, "--no-viewer"),
        ("batch", good.pairs, "--out", folder / "batch"),
        ("live", "--no-viewer"),
        ("record", folder / "record"),
        (
            "sensor",
            "--publish",
            "lab/a",
            "--simulate",
            "a",
            "--seconds",
            4,
            "--zenoh-connect",
            free_address(),
        ),
        ("doctor",),
    ):
        yield None, [*PROGRAM, *map(str, line)]


EXPORTS = ("bvh", "c3d", "csv", "glb", "mot", "npz", "parquet", "trc")


def is_whole(path):
    """Whether an output is the old one, or a new one that can be read."""
    if path is None:
        return True
    path = path / "a.mkv" if path.name == "raw" else path
    content = path.read_bytes()
    if content.startswith(b"precious"):
        return True
    if path.suffix == ".rrd":
        try:
            return damage_of(path) in (None, "it was not ended")
        except RecordingError:
            return False
    if path.suffix == ".json":
        return bool(json.loads(content))
    return len(content) > 1000


def make_precious(path):
    if path is None:
        return
    if path.name == "raw":
        path.mkdir(exist_ok=True)
    for file in [path / "a.mkv", path / "b.mkv"] if path.name == "raw" else [path]:
        file.write_bytes(b"precious")


def replacing(path, line):
    return line if path is None else [*line, "--force"]


def kills(good, folder, chance, count):
    """Kills a command that replaces a file at any moment."""
    lines = [(path, line) for path, line in commands(folder, good) if path is not None]
    for number in range(count):
        path, line = lines[number % len(lines)]
        make_precious(path)
        with subprocess.Popen(
            replacing(path, line), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as run:
            with suppress(subprocess.TimeoutExpired):
                run.wait(chance.uniform(0.5, 8.0))
            run.kill()
        yield "kills", f"{path} is lost", is_whole(path)


def signals(good, folder, chance, _):
    """Sends a signal to every command."""
    for path, line in commands(folder, good):
        for name in SIGNALS:
            make_precious(path)
            with subprocess.Popen(
                replacing(path, line), stdout=subprocess.PIPE, stderr=subprocess.PIPE
            ) as run:
                time.sleep(chance.uniform(1.0, 5.0))
                run.send_signal(getattr(signal, name))
                try:
                    _, said = run.communicate(timeout=HANGS_S)
                except subprocess.TimeoutExpired:
                    run.kill()
                    yield "signals", f"{line[3]} hangs after {name}", False
                    continue
            codes = (0, 1, 2, 130, -getattr(signal, name))  # the last: before the program itself began
            fine = (name in DEADLY or run.returncode in codes) and b"Traceback" not in said and is_whole(path)
            yield "signals", f"{line[3:]} {name}: {run.returncode} {said[-300:]!r}", fine


def streams(good, folder, _, __):
    """Runs every command without a terminal."""
    for path, line in commands(folder, good):
        for stream in STREAMS:
            make_precious(path)
            quoted = " ".join(f"'{word}'" for word in replacing(path, line))
            done = subprocess.run(["bash", "-c", f"{quoted} {stream}"], capture_output=True, timeout=HANGS_S)
            fine = done.returncode in (0, 1, 2) and b"Traceback" not in done.stderr and is_whole(path)
            yield "streams", f"{line[3]} {stream}: {done.returncode} {done.stderr[-200:]!r}", fine


def pairs(good, folder, _, __):
    """Runs every command twice at the same time on one output."""
    for path, line in commands(folder, good):
        if path is None:
            continue
        path = path.with_stem(f"{path.stem}-2")
        line = [*line[:-1], str(path)]
        runs = [subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for _ in range(2)]
        said = [run.communicate(timeout=HANGS_S)[1] for run in runs]
        codes = sorted(run.returncode for run in runs)
        fine = codes[1] == 2 and codes[0] < 2 and sum(text.count(b"\n") for text in said) == 1
        yield "two processes", f"{line[3]}: {codes} {said}", fine


WORDS = (  # of the protocols, and of none
    *(b"", b"A" * 3_000_000, b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 5000, b"\x89\x80\0\0\0\0" * 5000),
    *(b"LSL:fullinfo\r\n", b"LSL:timedata\r\n1 1e400\r\n", b"LSL:streamfeed\r\n0 0\r\n"),
    b"LSL:streamfeed/110 x\r\n" + b"Max-Buffer-Length: 99999999999\r\n" * 2000 + b"\r\n",
    b"LSL:shortinfo\r\n" + b"(" * 5000 + b"\r\n1 1\r\n",
)


def networks(_, folder, chance, count):
    """Attacks all ports of all outputs: garbage, huge messages, resets, floods, clients that never read."""
    report, web = folder / "net.json", free_port()
    outputs = ("--websocket", web, "--lsl", "hostile", "--zenoh", "lab/x", "--zenoh-listen", free_address())
    sends = ("--vmc", f"127.0.0.1:{free_port()}", "--vrchat", f"127.0.0.1:{free_port()}")
    demo = ("demo", "--seconds", count + 10, "--depth", "none", "--no-viewer", "--report", report, "--force")
    line = [*PROGRAM, *map(str, (*demo, *outputs, *sends))]
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as run:
        process = psutil.Process(run.pid)

        def ports():
            return [each for each in process.net_connections() if each.laddr and not each.raddr]

        while web not in [each.laddr.port for each in ports()]:
            time.sleep(0.5)
        found, before = ports(), process.memory_info().rss
        until_s, silent = time.monotonic() + count, []
        while time.monotonic() < until_s and run.poll() is None:
            with suppress(OSError):
                silent += attack(chance.choice(found), chance)
            while len(silent) > 100:
                silent.pop(0).close()
            yield "attacks", "the program ended", run.poll() is None
        growth = (process.memory_info().rss - before) / 1e6
        _, said = run.communicate(timeout=HANGS_S)
    figures = json.loads(report.read_text())
    sent = [each["sent"] for each in figures["outputs"] if "WebSocket" not in each["to"]]
    fine = run.returncode == 0 and not said and min(sent) > 0.9 * figures["fused_frames"] and growth < 100.0
    yield "networks", f"{run.returncode} {said[-300:]!r} {figures['outputs']} {growth:.0f} MB more", fine


def attack(port, chance):
    """Sends something rude to a port; returns the connections that are to be kept."""
    said = chance.choice((*WORDS, chance.randbytes(chance.choice((1, 100, 10_000)))))
    address = ("127.0.0.1", port.laddr.port)
    if port.type == socket.SOCK_DGRAM:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rude:
            for _ in range(chance.choice((1, 50))):
                rude.sendto(said[:60_000], address)
        return []
    rude = socket.create_connection(address, timeout=2.0)
    if chance.random() < 0.1:
        return [rude]
    with rude:
        rude.settimeout(0.3)
        if chance.random() < 0.5:
            rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        if chance.random() < 0.2:
            said = struct.pack("<H", min(len(said), 65_535)) + said  # as Zenoh frames it
        rude.sendall(said)
    return []


def bundles(_, folder, chance, count):
    """Plants a trace in all that a bundle is made of."""
    with pytest.MonkeyPatch.context() as patch:
        (folder / "planted").mkdir()
        plant(patch, folder / "planted")
        for _ in range(count):
            kind = chance.choice(list(KINDS))
            trace, words = KINDS[kind]
            sentence = chance.choice(SENTENCES).format(trace)
            made = mock.patch.object(
                doctor, "device_checks", lambda *_, s=sentence, **__: checks_that_tell(s)
            )
            with made, redirect_stdout(StringIO()), redirect_stderr(StringIO()), suppress(SystemExit):
                duplex(["doctor", "--bundle", str(folder / "b.zip"), "--force"])
            found = told(folder / "b.zip", words)
            yield "bundles", f"{kind} in {sentence!r}: {found}", not found


PARTS = {part.__name__: part for part in (pairs, streams, signals, kills, networks, bundles, files)}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []])
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    counted = Counter()
    with tempfile.TemporaryDirectory() as name, suppress(KeyboardInterrupt):
        good = Good(Path(name))
        for part in given.parts or PARTS:
            (work := Path(name) / f"work-{part}").mkdir()
            for what, bad, fine in PARTS[part](good, work, random.Random(given.seed), given.count):
                counted[what, fine] += 1
                if not fine:
                    print(f"{what}: {bad}", flush=True)
    for what in dict.fromkeys(what for what, _ in counted):
        print(f"{what:16s} {counted[what, True]:5d} in order, {counted[what, False]:3d} not")


if __name__ == "__main__":
    main()
