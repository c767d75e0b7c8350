"""Tries to make the program crash, hang or lose files: ``python -m tests.experiments.hostile [COUNT SEED]``.

COUNT mutated files of each format (40), as many kills as a quarter of it, and every command with signals,
without a terminal, and twice on one output. What is bad is listed, and a table counts, also after Ctrl-C.
"""

import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from itertools import chain
from pathlib import Path

from recordings.errors import RecordingError
from recordings.file.rrd_file import damage_of
from recordings.testing import simulated_session
from tests.helpers.recorded_pairs import write_pair

PROGRAM = (sys.executable, "-m", "viewer_app.cli")
HANGS_S = 120.0
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGPIPE", "SIGUSR1", "SIGALRM", "SIGCONT")
DEADLY = ("SIGQUIT", "SIGUSR1", "SIGALRM")
"""Signals that nobody sends to end a program in order; it may end at once, and loses no file."""
STREAMS = (">&-", ">&- 2>&-", ">/dev/full", ">/dev/full 2>/dev/full", "<&-", "| true")
READS = """
import contextlib, io, signal, sys, traceback
from viewer_app.cli import main
def late(*_): raise TimeoutError
signal.signal(signal.SIGALRM, late)
for path in sys.argv[1:]:
    said, code = io.StringIO(), 0
    signal.alarm(10)
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            main(["info", path])
    except SystemExit as end: code = end.code
    except BaseException: code = traceback.format_exc().splitlines()[-1]
    signal.alarm(0)
    print(f"{path}\\t{code}", flush=True)
"""


def mutated(content, random):
    """The content cut off, or with some bytes changed, repeated or taken away."""
    changed = bytearray(content)
    if random.random() < 0.2:
        return bytes(changed[: random.randrange(len(changed))])
    for _ in range(random.randrange(1, 8)):
        at = random.randrange(min(len(changed), random.choice((64, 2048, len(changed)))))
        kind = random.random()
        if kind < 0.7:
            changed[at] = random.choice((0, 1, 10, 44, 127, 128, 255, random.randrange(256)))
        else:
            size = random.randrange(1, 64)
            changed[at : at + size] = b"" if kind < 0.85 else changed[at : at + size] * 3
    return bytes(changed)


def files(good, folder, count, random):
    """Mutated files of every format, each read by ``duplex info``."""
    for original in good:
        paths = []
        for number in range(count):
            paths.append(folder / f"{number}{original.suffix}")
            paths[-1].write_bytes(mutated(original.read_bytes(), random))
        while paths:
            command = [sys.executable, "-c", READS, *map(str, paths)]
            done = subprocess.run(command, capture_output=True, text=True, timeout=15.0 * len(paths))
            for line in done.stdout.splitlines():
                path, code = line.split("\t")
                fine = code in ("0", "2", "None")
                yield "mutated files", "read or refused" if fine else f"{path}: {code}", fine
            left = paths[done.stdout.count("\n") :]
            if done.returncode:
                yield "mutated files", f"{left[0]}: ended by {done.returncode}", False
                shutil.copy(left[0], f"crash-{left[0].name}")
            paths = left[1:] if done.returncode else []


def commands(folder, good):
    """Commands that write one output, which is there already."""
    a, b, session = good["a.csv"], good["b.csv"], good["s.rrd"]
    for name, line in (
        ("fuse.rrd", ("fuse", a, b, "--no-viewer", "--save")),
        ("fuse.json", ("fuse", a, b, "--no-viewer", "--report")),
        ("review.html", ("review", session, "--no-viewer", "--html")),
        ("export.csv", ("export", session, "--to")),
        ("trim.rrd", ("trim", session, "--from", 0.5, "--save")),
        ("demo.rrd", ("demo", "--seconds", 4, "--depth", "none", "--no-viewer", "--save")),
        ("raw", ("demo", "--seconds", 4, "--no-viewer", "--compress", "--record")),
    ):
        yield folder / name, [*PROGRAM, *map(str, line), str(folder / name)]


def is_whole(path):
    """Whether an output is the old one, or a new one that can be read."""
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
    if path.name == "raw":
        path.mkdir(exist_ok=True)
    for file in [path / "a.mkv", path / "b.mkv"] if path.name == "raw" else [path]:
        file.write_bytes(b"precious")


def kills(folder, good, count, random):
    """Kills a command that replaces a file at any moment."""
    lines = list(commands(folder, good))
    for number in range(count):
        path, line = lines[number % len(lines)]
        make_precious(path)
        with subprocess.Popen(
            [*line, "--force"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as run:
            time.sleep(random.uniform(0.5, 8.0))
            run.kill()
        fine = is_whole(path)
        yield "kills", "old or new file is whole" if fine else f"{path} is lost", fine


def signals(folder, good, random):
    """Sends a signal to every command."""
    for path, line in commands(folder, good):
        for name in SIGNALS:
            make_precious(path)
            with subprocess.Popen([*line, "--force"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
                time.sleep(random.uniform(1.0, 5.0))
                run.send_signal(getattr(signal, name))
                try:
                    _, said = run.communicate(timeout=HANGS_S)
                except subprocess.TimeoutExpired:
                    run.kill()
                    yield "signals", f"{line[3]} hangs after {name}", False
                    continue
            ended = name in DEADLY or run.returncode in (0, 130, -signal.SIGINT)  # the last: during an import
            fine = ended and b"Traceback" not in said and is_whole(path)
            yield (
                "signals",
                "in order" if fine else f"{line[3:]} {name}: {run.returncode} {said[-300:]!r}",
                fine,
            )


def streams(folder, good):
    """Runs every command without a terminal."""
    for path, line in commands(folder, good):
        for stream in STREAMS:
            make_precious(path)
            quoted = " ".join(f"'{word}'" for word in [*line, "--force"])
            done = subprocess.run(["bash", "-c", f"{quoted} {stream}"], capture_output=True, timeout=HANGS_S)
            fine = done.returncode in (0, 1, 2) and b"Traceback" not in done.stderr and is_whole(path)
            said = f"{line[3]} {stream}: {done.returncode} {done.stderr[-200:]!r}"
            yield "streams", "in order" if fine else said, fine


def pairs_of_processes(folder, good):
    """Runs every command twice at the same time on one output."""
    for path, line in commands(folder, good):
        path = path.with_stem(f"{path.stem}-2")
        line = [*line[:-1], str(path)]
        runs = [subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for _ in range(2)]
        said = [run.communicate(timeout=HANGS_S)[1] for run in runs]
        codes = sorted(run.returncode for run in runs)
        fine = codes == [0, 2] and sum(text.count(b"\n") for text in said) == 1
        yield "two processes", "the second is refused" if fine else f"{line[3]}: {codes} {said}", fine


def main():
    count = int(sys.argv[1]) if sys.argv[1:] else 40
    chance = random.Random(int(sys.argv[2]) if sys.argv[2:] else 0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_pair(folder)
        session = simulated_session(seconds=2.0)
        session.save(folder / "s.rrd")
        good = {path.name: path for path in folder.iterdir()}
        formats = [folder / "a.csv", folder / "s.rrd"]
        for suffix in (".trc", ".c3d"):
            formats.append(folder / f"t{suffix}")
            session.export(formats[-1])
        raw = ("demo", "--seconds", "1", "--no-viewer", "--compress", "--record", str(folder / "r"))
        subprocess.run([*PROGRAM, *raw], check=True, stdout=subprocess.DEVNULL)
        formats.append(folder / "r" / "a.mkv")
        (work := folder / "work").mkdir()
        parts = (
            pairs_of_processes(work, good),
            streams(work, good),
            signals(work, good, chance),
            kills(work, good, count // 4, chance),
            files(formats, work, count, chance),
        )
        counted = Counter()
        with suppress(KeyboardInterrupt):
            for what, came, fine in chain(*parts):
                counted[what, fine] += 1
                if not fine:
                    print(f"{what}: {came}", flush=True)
    for what in dict.fromkeys(what for what, _ in counted):
        print(f"{what:16s} {counted[what, True]:5d} in order, {counted[what, False]:3d} not")


if __name__ == "__main__":
    main()
