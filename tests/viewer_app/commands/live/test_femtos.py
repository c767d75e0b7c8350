"""``duplex live`` and ``duplex doctor`` on stand-ins for two Femto Bolts behind pyk4a."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.command_line import duplex
from tests.helpers.session_text import rows_of
from tests.helpers.standin_library import Standin
from tests.helpers.standin_pyk4a import Bus

ORBBEC = ("CL8H741005K", "CL8H7410123")


@pytest.fixture
def femtos(kinects: Bus) -> Bus:
    """Two Femto Bolts on a sync cable, which their wrapper does not report."""
    for device, serial in zip(kinects.devices, ORBBEC, strict=True):
        device.serial, device.orbbec = serial, True
    return kinects


def test_the_user_names_the_master_of_orbbecs_sensors(
    femtos: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("live", "--principal", ORBBEC[0], "--k4abt", standin.path, "--no-viewer", "--seconds", 0.5)
    assert duplex(*arguments) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Orbbec's wrapper does not say whether a cable is in the jacks" in said
    assert f"--sync-master {ORBBEC[0]} or {ORBBEC[1]}" in said
    assert {config.wired_sync_mode for config in femtos.configs} == {0}
    femtos.configs.clear()
    femtos.started.clear()
    saved = tmp_path / "s.rrd"
    assert duplex(*arguments, "--sync-master", ORBBEC[0], "--save", saved) == 0
    assert [config.wired_sync_mode for config in femtos.configs] == [2, 1]
    assert femtos.started == [ORBBEC[1], ORBBEC[0]]
    assert rows_of(saved, "/fused/skeleton") > 0
    capsys.readouterr()
    assert duplex(*arguments, "--sync-master", "000999") == 2
    assert "--sync-master 000999 is neither of the two Kinects" in capsys.readouterr().err
