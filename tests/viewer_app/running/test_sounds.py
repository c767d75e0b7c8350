"""Tones of a set-up: one for each new state or thing to do."""

import wave
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recordings.appearance.state_card import State
from viewer_app.coach.readiness import Headline
from viewer_app.running.sounds import RATE, TONES, Sounds, player, sound_of

HEADLINES = [
    Headline(State.NOT_YET, "step back 0.5 m", "distance"),
    Headline(State.NOT_YET, "step back 1.0 m", "distance"),
    Headline(State.NOT_YET, "move B", "angle"),
    Headline(State.NOT_YET, "step into view of A", "person"),
    Headline(State.ALMOST, "walk some steps", "calibration"),
    Headline(State.READY, "record now"),
]


@given(st.lists(st.sampled_from(HEADLINES)))
def test_a_sound_is_played_for_each_new_state_or_thing_to_do(shown):
    played = []
    with Sounds(lambda path: played.append(path.stem)) as sounds:
        for each in shown:
            sounds.tell(each)
    about = [(each.state, each.kind) for each in shown]
    new = [each for k, each in enumerate(shown) if k == 0 or about[k] != about[k - 1]]
    assert played == [sound_of(each).replace(" ", "_") for each in new if sound_of(each)]


def test_lost_ready_and_not_yet_sound_different():
    assert [sound_of(each) for each in HEADLINES] == ["not yet", "not yet", "not yet", "lost", "", "ready"]


@pytest.mark.parametrize("name", TONES)
def test_a_file_has_its_tones(name):
    with Sounds(mock.Mock()) as sounds, wave.open(str(sounds._path(name))) as file:
        samples = np.frombuffer(file.readframes(file.getnframes()), "<i2").astype(float)
    hertz, seconds = TONES[name][0]
    first = samples[: round(seconds * RATE)]
    assert np.argmax(np.abs(np.fft.rfft(first))) / seconds == pytest.approx(hertz, abs=1.0 / seconds)
    assert len(samples) == pytest.approx(
        RATE * sum(seconds for _, seconds in TONES[name]), abs=len(TONES[name])
    )
    assert max(abs(samples[0]), abs(samples[-1])) < 100


def test_a_system_without_a_program_that_plays_has_no_player(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert player() is None
    monkeypatch.setattr("shutil.which", lambda name: name == "aplay" or None)
    started = mock.Mock()
    monkeypatch.setattr("subprocess.Popen", started)
    player()("s.wav")
    assert started.call_args.args[0] == ["aplay", "-q", "s.wav"]
