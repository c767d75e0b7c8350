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
    Headline(State.ALMOST, "walk a few steps", "calibration"),
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
    ends = np.cumsum([round(seconds * RATE) for _, seconds in TONES[name]])
    assert len(samples) == ends[-1]
    for (hertz, seconds), part in zip(TONES[name], np.split(samples / 32768.0, ends[:-1]), strict=True):
        loud = np.sqrt(np.mean(part**2))
        if hertz == 0.0:
            assert loud == 0.0
            continue
        assert 300.0 < hertz < 4000.0  # a laptop's loudspeaker plays it, and all people hear it
        power = np.abs(np.fft.rfft(part * np.hanning(len(part)))) ** 2
        near = slice(int((hertz - 30.0) * seconds), int((hertz + 30.0) * seconds) + 1)
        assert power[near].sum() > 0.99 * power.sum()
        assert 0.2 < loud < 0.5
        assert np.abs(part).max() < 1.0  # it is not cut off
        assert max(abs(part[0]), abs(part[-1])) < 0.003  # no click


def test_a_system_without_a_program_that_plays_has_no_player(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert player() is None
    monkeypatch.setattr("shutil.which", lambda name: name == "aplay" or None)
    started = mock.Mock()
    monkeypatch.setattr("subprocess.Popen", started)
    player()("s.wav")
    assert started.call_args.args[0] == ["aplay", "-q", "s.wav"]
