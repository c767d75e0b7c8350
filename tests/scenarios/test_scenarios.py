"""Scenarios of live capture, on the stand-in and on the rig: the real libk4a with simulated sensors.

What the program says and does is always tested. How fast it does it is tested with ``--figures``, on a
machine that does nothing else: ``pytest -n 0 tests/scenarios --figures``.
"""

import json
import re
from concurrent.futures import ThreadPoolExecutor
from itertools import islice

import pytest

from devices.capture.causes import Cause
from recordings.session import Session
from tests.scenarios import program
from tests.scenarios.table import SCENARIOS
from viewer_app.flags import in_flags

_AT_ONCE = 3  # on two cores, with two processes of pytest-xdist
_POOL, _RUNS = ThreadPoolExecutor(_AT_ONCE), {}
_ENDS = 2  # frames: the first and the last may lack their partner
_LABEL = r"(?:Kinect )?\w+"


def _pattern(text):
    parts = re.split(r"(\{.*?\})", text)
    return "".join(_LABEL if p == "{label}" else ".*?" if p[:1] == "{" else re.escape(p) for p in parts)


_PATTERNS = {cause: re.compile(_pattern(in_flags(cause.value))) for cause in Cause}
_SLOW_MACHINE = {Cause.LATE, Cause.TOO_LATE}
"""Told rightly on a busy machine, the rig's bus included."""
_ELSEWHERE = {
    Cause.NO_MORE_RECORDED: "tests/devices/capture/test_sensor_thread.py: of played recordings",
    Cause.RECORDING_LEFT_BEHIND: "tests/devices/capture/test_sensor_thread.py: of played recordings",
    Cause.FORBIDDEN: "tests/devices/test_vendor_contract.py: needs a list of USB devices",
    Cause.CAMERAS_NOT_STARTED: "tests/devices/azure/test_kinect.py: libk4a logs a reason",
    Cause.STOPPED: "tests/devices/orbbec/test_faults.py: libk4a reports no failure on Linux",
    Cause.NO_PULSES: "tests/devices/test_vendor_contract.py: after two minutes",
    Cause.ONLY_COLOR: "tests/devices/test_vendor_contract.py: the rig's sensors lose depth with colour",
    Cause.FEW_IMAGES: "tests/devices/test_vendor_contract.py: the rig has no dark room",
    Cause.LATE_IMAGES: "tests/devices/test_vendor_contract.py: in virtual time",
    Cause.TOO_LATE: "tests/devices/capture/test_device_faults.py: in injected time",
    Cause.LEFT_BEHIND: "tests/devices/capture/test_device_faults.py: a driver that never returns",
}
"""Causes that no scenario shows: where they are tested, and why."""


@pytest.fixture
def run(request, rig, tmp_path_factory):
    """The program in the scenario, which waits for sensors most of the time: the next ones run beside it."""
    at, on = request.session.items.index(request.node), request.node.callspec.params["rig"]
    same = (item for item in request.session.items[at:] if item.originalname == request.node.originalname)
    alike = (item for item in same if item.callspec.params["rig"] == on)
    for item in islice(alike, 1 if _has_figures(request) else _AT_ONCE):
        if item not in _RUNS:
            of = item.callspec.params["scenario"], rig, tmp_path_factory.mktemp("scenario")
            _RUNS[item] = _POOL.submit(_run, *of)
    return _RUNS.pop(request.node)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=[each.name.replace(" ", "_") for each in SCENARIOS])
def test_scenario(scenario, run, request):
    if scenario.xfail:
        request.applymarker(pytest.mark.xfail(reason=scenario.xfail, strict=True))
    done, figures = run.result(), _has_figures(request)
    wrong = _wrong_words(scenario, done, perhaps=set() if figures else _SLOW_MACHINE)
    if figures:
        wrong += _wrong_figures(scenario, done)
    assert not wrong, f"{wrong}\n{done.said}"


def test_every_cause_is_shown_by_a_scenario_or_tested_elsewhere():
    shown = {cause for scenario in SCENARIOS for cause in scenario.causes}
    assert shown | set(_ELSEWHERE) == set(Cause)
    assert not shown & set(_ELSEWHERE)


def _has_figures(request):
    return bool(request.config.getoption("--figures", default=False))


def _run(scenario, rig, folder):
    conf = dict(pair.split("=", 1) for pair in scenario.conf.split())
    library = "libk4abt.so.1.1" if rig is None else str(rig / "lib" / "libk4abt.so.1.1")
    options = ["live", "--no-viewer", "--k4abt", library, "--principal", "000001111111"]
    options += ["--save", str(folder / "s.rrd"), "--report", str(folder / "r.json")]
    options += scenario.options.split()
    return program.run(options, folder, conf, scenario.events, rig)


def _wrong_words(scenario, done, perhaps):
    """What the program should not have said or done."""
    wrong = [] if done.code == scenario.code else [f"exit code {done.code}, not {scenario.code}"]
    told = {cause for cause, pattern in _PATTERNS.items() if pattern.search(done.said)}
    allowed = scenario.causes | scenario.perhaps | perhaps
    missing = scenario.causes - told
    if told & perhaps:  # another one hides it
        missing -= perhaps
    if missing or not told <= allowed:
        wrong.append(f"told {sorted(map(str, told))}, not {sorted(map(str, scenario.causes))}")
    wrong += [f"lacks {words!r}" for words in scenario.words if not re.search(words, done.said)]
    wrong += [f"has {words!r}" for words in scenario.never if re.search(words, done.said)]
    if scenario.code == 2 and (done.said.count("duplex: ") != 1 or "Traceback" in done.said):
        wrong.append("not one line")
    if (done.folder / "s.rrd").exists() and not len(Session.open(done.folder / "s.rrd").rows):
        wrong.append("the session has no frame")
    return wrong


def _wrong_figures(scenario, done):
    """Figures that are not reached."""
    wrong = [] if done.ended_s <= scenario.within_s else [f"ended {done.ended_s:.1f} s after the last event"]
    if scenario.paired:
        report = json.loads((done.folder / "r.json").read_text(encoding="utf-8"))
        counted = report["frames"]["a"], report["frames"]["b"]
        paired, age_ms = report["paired"] / (max(counted) - _ENDS), report["latency_ms"]["p50"]
        if paired < scenario.paired:
            wrong.append(f"{100 * paired:.1f} % of {counted} frames are paired")
        if age_ms > scenario.age_ms:
            wrong.append(f"S* is {age_ms:.0f} ms old")
    return wrong
