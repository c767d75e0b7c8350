"""Messages about files, sessions and the viewer are on the troubleshooting page, or say all themselves."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.helpers.documents import ROOT
from tests.helpers.messages import messages_of

PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
HEADINGS = re.findall(r"^### `(.*)`$", PAGE, re.MULTILINE)
MARKUP = re.compile(r"\[(/|bold|yellow|bold yellow)\]")
SCOPE = (
    *sorted((ROOT / "devices" / "skeletons").glob("*.py")),
    ROOT / "devices" / "files.py",
    ROOT / "devices" / "people.py",
    ROOT / "devices" / "pairing.py",
    *sorted((ROOT / "recordings" / "file").glob("*.py")),
    *(ROOT / "viewer_app" / "commands" / f"{name}.py" for name in ("fuse", "review")),
    *sorted((ROOT / "viewer_app" / "viewer").glob("*.py")),
    ROOT / "viewer_app" / "output_files.py",
    ROOT / "viewer_app" / "report" / "session_notes.py",
)
SAY_ALL = {
    "--at …: the session runs from 0 to … s.",
    "--calibrate …: seconds must be a positive number, as in seconds:3.",
    "--event and --at each say where to open; give one of them.",
    "--event …: no such event; ….",
    "--listen … is the address of --web; give both.",
    "--smooth whole needs --method duplex; got --method ….",
    "--web and --no-viewer contradict each other.",
    "A recording without frames cannot be paired.",
    "No event was recorded.",
    "No file ….",
    "No folder … to write … into.",
    "No session ….",
    "The folder … is not writable.",
    "The page stays until Ctrl-C.",
    "The principal sensor A never sees the person in a pair.",
    "The session was made with settings unknown here: ….",
    "The viewer opens ….",
    "There is no display; a viewer would open ….",
    "and … more: --verbose.",
    "… Or give its skeletons, saved before, with … FILE.",
    "… cannot be read as CSV: ….",
    "… cannot be read: it is ….",
    "… cannot be read: ….",
    "… cannot be written: it …. Choose another name.",
    "… could not be written: ….",
    "… damaged images were skipped.",
    "… has a header and no rows.",
    "… has an unknown body …. Known: ….",
    "… has its own skeletons; … … is for an .mkv.",
    "… has no frames.",
    "… has the … joints of …, … the … of …. Both sensors must be of one family.",
    "… has … frames and no person in any of them.",
    "… has … frames; none from … to ….",
    "… is a folder, not a session.",
    "… is a folder; name a file.",
    "… is damaged before its first frame: ….",
    "… is empty.",
    "… is not JSON: it begins with ….",
    "… is not a file of skeletons but ….",
    "… is not a regular file; name another.",
    "… is not a session: it does not begin like an .rrd file.",
    "… is not a valid file name: ….",
    "… is not complete JSON: …. Was it cut off?",
    "… is not open.",
    "… is not text: it contains zero bytes.",
    "… is too large for the memory of this machine.",
    "… … is for an .mkv; … is tracked.",
    "… …, where a … is expected.",
    "…, line …: state … is none of tracked, inferred, not_tracked, 2, 1, 0.",
    "…, line …: … must be …; got ….",
    "…, …: not as offline_processor writes it (…).",
    "…: a body has … joints; Kinect v2 has ….",
    "…: a calibration in it is damaged; it does not match its checksum.",
    "…: a joint has 12 numbers, the last a state 0, 1 or 2; got …. Is the file cut off?",
    "…: expected numbers only; got ….",
    "…: joint_names is empty or names a joint twice.",
    "…: the settings and calibration in it are damaged; they do not match their checksum.",
    "…: the time goes back at frame …; the frames were sorted by time.",
    "…: time_us goes beyond …; times are microseconds.",
    "…: two frames have the same time, … µs.",
    "…: … is not a format of recorded skeletons. Known: …; with images: .mkv, .bag.",
    "…: … must be a whole number; got ….",
    "…: … repeats a column name.",
    "…; the session is saved.",
}
"""Messages that state what is wrong and the way out so that the page has nothing to add."""


def on_the_page(message: str) -> bool:
    return any(message == heading or heading.rstrip("…").rstrip() in message for heading in HEADINGS)


def messages() -> list[tuple[Path, str]]:
    return [(path, MARKUP.sub("", message)) for path in SCOPE for message in messages_of(path)]


def test_every_message_is_explained_or_says_all_itself() -> None:
    missing = [
        f"{path.relative_to(ROOT)}: {message}"
        for path, message in messages()
        if not on_the_page(message) and message not in SAY_ALL
    ]
    assert not missing, "explain these in docs/troubleshooting.md, or add them to SAY_ALL"


def test_messages_that_say_all_exist() -> None:
    assert {message for _, message in messages()} >= SAY_ALL


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('raise E(f"{a} is no {b}, use c.")', "… is no …, use c."),
        ('x = "no way " + f"out of {here}." + more', None),  # its end is not known
        ('x = f"one {a} " + "and two."', "one … and two."),
        ('"A docstring of some words."', None),
        ('print("three little words")', None),
    ],
)
def test_messages_are_found_in_the_source(tmp_path: Path, source: str, found: str | None) -> None:
    module = tmp_path / "module.py"
    module.write_text(source, encoding="utf-8")
    assert list(messages_of(module)) == ([] if found is None else [found])
