"""What ``duplex demo`` tells a newcomer."""

import pytest

from recordings import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.session_text import rows_of
from viewer_app.commands import demo

QUICK = ("--depth", "none", "--no-viewer")


def test_the_demo_says_where_to_look_and_what_to_do_next(capsys):
    assert duplex("demo", *QUICK, "--seconds", 5.5) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "At 4.4 s Kinect B exchanges left and right for a second; S* stays right." in said
    assert "loses the left arm" not in said  # that comes later than the demo ends
    assert said.endswith("Next: --motion walk, --bad-setup, or your own sensors (duplex doctor).")


def test_a_badly_placed_demo_is_told_what_to_mend(tmp_path, capsys):
    saved = tmp_path / "bad.rrd"
    assert duplex("demo", *QUICK, "--seconds", 3, "--bad-setup", "--save", saved) == 0
    said = capsys.readouterr().out
    assert "30° apart" in said
    assert "The sensors are badly placed" in said
    warned = {event.text.partition(":")[0] for event in Session.open(saved).events if event.level == "WARN"}
    assert {"Too close to sensor A", "Too close to sensor B"} <= warned
    for word in (
        "Too close to sensor A",
        "does not see both feet",
        "Move them further apart round the person",
    ):
        assert word in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--motion", "flying"), "No movement 'flying'"),
        (("--motion", "nowhere.bvh"), "nowhere.bvh"),
        (("--seconds", -1), "--seconds must be a positive number"),
        (("--bad-setup", "--angle", 60), "--bad-setup has an angle of its own, 30°"),
        (("--tracker", "blazepose", "--depth", "none"), "works on images"),
        (("--tracker", "blazepose", "--body", "kinect_v2"), "not kinect_v2"),
        (("--tracker", "blazepose", "--tracker-model", "nowhere"), "nowhere"),
        (("--tracker-network", "lite"), "--tracker-network is of the program's own tracker"),
        (("--tracker-model", "networks"), "--tracker-model is of the program's own tracker"),
    ],
)
def test_a_mistake_gives_one_line(arguments, words, capsys):
    assert duplex("demo", "--no-viewer", *arguments) == 2
    assert words in one_line(capsys)


def test_a_demo_replaces_no_existing_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "has_display", lambda: False)
    precious = tmp_path / "demo.rrd"
    precious.write_text("precious")
    assert duplex("demo", *QUICK, "--seconds", 0.3, "--save", "demo.rrd") == 2
    assert "demo.rrd exists already" in one_line(capsys)
    assert duplex("demo", "--seconds", 0.3, "--depth", "none") == 0
    assert precious.read_text() == "precious"
    assert rows_of(tmp_path / "demo-2.rrd", "/fused/skeleton") > 0
