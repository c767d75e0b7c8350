"""``duplex demo --tracker blazepose``: the real tracker on simulated images, live."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fusion.body import BLAZEPOSE
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.machine import need_networks
from tests.helpers.session_text import rows_of


def test_the_demo_runs_the_own_tracker_on_images_of_a_person(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    need_networks("full")
    saved = tmp_path / "s.rrd"
    arguments = ("--tracker", "blazepose", "--motion", "startup", "--seconds", "4", "--no-viewer")
    report = tmp_path / "r.json"
    assert duplex("demo", *arguments, "--save", saved, "--report", report, "--verbose") == 0
    said = capsys.readouterr().out
    assert "From images to S*" in said
    figures = json.loads(report.read_text())
    # Tracking alone takes milliseconds.
    assert 1.0 < figures["latency_ms"]["p50"] <= figures["latency_ms"]["p99"] <= figures["latency_ms"]["max"]
    assert "Distance from the true joints" in said
    session = Session.open(saved)
    assert session.body is BLAZEPOSE
    assert session.tracker == "blazepose full"
    # A busy machine gets fewer frames, but both sensors the same ones: pairs with both.
    assert np.isfinite(session.fused).all(axis=(1, 2)).sum() >= 3
    both = np.isfinite(session.skeleton_a.positions[:, 0, 0]) & np.isfinite(
        session.skeleton_b.positions[:, 0, 0]
    )
    assert both.mean() > 0.5
    assert rows_of(saved, "/kinect_a/depth") > 0
    assert rows_of(saved, "/kinect_a/depth/infrared") == 0
