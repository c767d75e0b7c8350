"""One contract for the sensors of all vendors, and the example of CONTRIBUTING.md, which is one more."""

import enum
import importlib.abc
import importlib.machinery
import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from devices.azure import pyk4a_access
from devices.azure.pyk4a_access import load_sdk as azure_sdk
from devices.capture.capture_stream import LiveSensor
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_thread import SensorThread
from devices.capture.settings import CaptureSettings
from devices.check import extra_command
from devices.live import sensors as live_sensors
from devices.live.checks import device_checks
from devices.live.sensors import VENDORS, connected_sensors, installed_vendors
from devices.network.zenoh_session import load_zenoh
from devices.orbbec import sdk_access as orbbec_access
from devices.orbbec.sdk_access import load_sdk as orbbec_sdk
from devices.realsense import sdk_access as realsense_access
from devices.realsense.sdk_access import load_sdk as realsense_sdk
from devices.sensor import AbsentError, DeviceError, FrameError, SensorFrame
from devices.tracker_choice import TrackerChoice
from fusion.body import AZURE_KINECT
from fusion.skeleton import nobody
from tests.helpers.scripted_sensor import ScriptedSensor
from tests.helpers.standin_camera import VirtualTime

OURS = TrackerChoice("blazepose", "a test")
PAGE = Path(__file__).resolve().parents[2] / "CONTRIBUTING.md"


class Acme(SimpleNamespace):
    """The library of the example: one sensor, three shots."""

    def __init__(self):
        super().__init__(there=["7"], opened=[], time=VirtualTime())

    def serials(self):
        return self.there

    def wait(self, timeout_ms):
        if not self.shots:
            self.time.wait_until(self.time.now_ns() + 1_000_000 * timeout_ms)
        return self.shots.pop(0) if self.shots else None

    def open(self, serial):
        self.shots = [
            SimpleNamespace(
                time_ns=k * 33_333_333,
                depth=np.full((3, 4), k, np.uint16),
                infrared=np.ones((3, 4), np.uint16),
            )
            for k in range(3)
        ]
        self.opened.append(serial)
        return SimpleNamespace(
            lens=(4, 3, 2.0, 2.0, 2.0, 1.5),
            wait=self.wait,
            close=lambda: self.opened.remove(serial),
        )


@pytest.fixture
def example(monkeypatch):
    """The names of the example, with its library."""
    monkeypatch.setitem(sys.modules, "acme", Acme())
    source = re.search(
        r"```python\n(from devices.capture.capture_stream .*?)```",
        PAGE.read_text(encoding="utf-8"),
        re.DOTALL,
    )[1]
    assert source.count("\n") < 200
    names = {"__name__": "acme_sensor", "source": source}
    exec(compile(source, PAGE.name, "exec"), names)
    return SimpleNamespace(**names)


@pytest.fixture
def vendor(request, example):
    """A row of the table; the example is one, too."""
    return {**VENDORS, "acme": example.VENDOR}[request.param]


EVERY = pytest.mark.parametrize("vendor", [*VENDORS, "acme"], indirect=True)


@EVERY
def test_a_missing_library_is_one_line_with_the_way_out(vendor, monkeypatch):
    for module in ("pyk4a", "pyorbbecsdk", "pyrealsense2", "acme"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DeviceError) as fault:
        vendor.connected()
    assert "\n" not in str(fault.value)
    check = vendor.sdk_check()
    assert not check.ok
    assert check.advice
    with pytest.raises(DeviceError), vendor.sensor("1", CaptureSettings(), FrameDecimation(30)):
        pass


WRONG = {"another thing": "VENDOR = 3", "broken": "import nothing_of_the_kind"}


@pytest.mark.parametrize("state", ["whole", *WRONG])
def test_the_example_is_a_vendor_as_a_package_of_its_own(example, state, monkeypatch, tmp_path):
    page = PAGE.read_text(encoding="utf-8")
    declared = tomllib.loads(re.search(r"```toml\n(\[project.entry-points.*?)```", page, re.DOTALL)[1])
    ((group, points),) = declared["project"]["entry-points"].items()
    about = tmp_path / "acme_sensor-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-sensor\nVersion: 1.0\n")
    lines = [f"[{group}]", *(f"{name} = {place}" for name, place in points.items())]
    (about / "entry_points.txt").write_text("\n".join(lines))
    (tmp_path / "acme_sensor.py").write_text(WRONG.get(state, example.source))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "acme_sensor", raising=False)
    (vendor,) = installed_vendors().values()
    if state == "whole":
        assert [one.serial for one in vendor.connected()] == ["7"]
        assert vendor.sdk_check().ok
        first = "from acme_sensor import VENDOR as own; from devices.live.sensors import vendors"
        at = os.pathsep.join((str(tmp_path), str(PAGE.parent)))
        subprocess.run(
            [sys.executable, "-c", f"{first}; assert vendors()['acme'] is own"],
            env={**os.environ, "PYTHONPATH": at},
            check=True,
        )
        return
    for call in (vendor.connected, lambda: vendor.sensor("7", CaptureSettings(), FrameDecimation(30))):
        with pytest.raises(DeviceError, match=r"'acme' of acme-sensor cannot be loaded: .*pip install"):
            call()
    assert not vendor.sdk_check().ok
    assert vendor.sdk_check().advice == "pip install --upgrade acme-sensor."


@EVERY
def test_building_a_sensor_opens_nothing(vendor):
    decimation = FrameDecimation(30)
    sensor = vendor.sensor("1", CaptureSettings(), decimation)
    assert isinstance(sensor, LiveSensor)
    assert (sensor.name, sensor.decimation) == ("1", decimation)
    assert type(sensor).frame_of is not LiveSensor.frame_of, "a recording needs it"
    with pytest.raises(DeviceError, match="is not open: use it in a with statement"):
        next(sensor.frames())
    sensor.__exit__()


def test_the_example_of_the_page_is_a_sensor(example, monkeypatch):
    acme = sys.modules["acme"]
    monkeypatch.setitem(live_sensors.VENDORS, "acme", example.VENDOR)
    assert [one.serial for one in connected_sensors(OURS)] == ["7"]
    named = {check.name: check for check in device_checks(OURS)}
    assert named["acme"].ok
    assert named["Acme 7"].ok
    with example.AcmeSensor("7", clock=acme.time.now_ns) as sensor:
        recorded = []
        sensor.on_capture = recorded.append
        frames = sensor.frames()
        frame = next(frames)
        assert [int(each.depth[0, 0]) for each in recorded] == [0, 1, 2]
        assert (frame.time_ns, int(frame.depth[0, 0]), sensor.missed) == (66_666_666, 2, 0), (
            "the newest moment"
        )
        with pytest.raises(DeviceError, match="Acme 7 stalls"):
            next(frames)
        acme.there = []
        with pytest.raises(DeviceError, match="Acme 7 was unplugged"):
            next(sensor.frames())
    assert acme.opened == []
    with pytest.raises(AbsentError, match="No Acme sensor with serial 7"):
        sensor.__enter__()


class Damaged(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Makes the import of a module raise an exception, as extensions built for other libraries do."""

    def __init__(self, name, fault):
        self._name, self._fault = name, fault

    def find_spec(self, name, *_):
        return importlib.machinery.ModuleSpec(name, self) if name == self._name else None

    def exec_module(self, *_):
        raise self._fault


LOADERS = {
    "pyk4a": azure_sdk,
    "pyorbbecsdk": orbbec_sdk,
    "pyrealsense2": realsense_sdk,
    "zenoh": load_zenoh,
}
FAULTS = (ImportError, OSError, RuntimeError, SystemError, AttributeError, TypeError, ValueError)


@pytest.mark.parametrize("name", LOADERS)
@pytest.mark.parametrize("kind", FAULTS)
def test_a_library_that_is_damaged_is_one_line(name, kind, monkeypatch):
    """numpy's ABI, a missing symbol, another Python: each binding has its own exception."""
    monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(sys, "meta_path", [Damaged(name, kind("built for\n\nanother numpy")), *sys.meta_path])
    with pytest.raises(DeviceError, match=r"built for another numpy") as fault:
        LOADERS[name]()
    assert "\n" not in str(fault.value)


@pytest.mark.usefixtures("orbbecs", "bus", "rs")
@pytest.mark.parametrize("module", [orbbec_access, pyk4a_access, realsense_access])
def test_a_library_of_another_version_names_what_it_lacks(module, monkeypatch):
    """pyorbbecsdk2 2.0.18 lacks ``Context.set_timestamp_clock_type``."""
    sdk, tried = module.load_sdk(), 0
    for name in module._NAMES:
        holder, _, last = name.rpartition(".")
        owner = attrgetter(holder)(sdk) if holder else sdk
        if last not in vars(owner) or isinstance(owner, enum.EnumType):
            continue
        with monkeypatch.context() as patch:
            patch.delattr(owner, last)
            if hasattr(owner, last):  # its base class has it, too
                continue
            with pytest.raises(DeviceError, match=f"lacks {re.escape(name)}"):
                module.load_sdk()
        tried += 1
    assert tried >= 10


@pytest.mark.usefixtures("orbbecs")
def test_what_one_vendors_library_raises_is_that_vendors_fault_alone(example, monkeypatch):
    def fails():
        raise AttributeError("'Context' object has no attribute 'set_timestamp_clock_type'")

    row = replace(VENDORS["orbbec"], sensors="Acme sensors", connected=example.connected_acmes)
    monkeypatch.setitem(live_sensors.VENDORS, "acme", row)
    monkeypatch.setitem(live_sensors.VENDORS, "orbbec", replace(VENDORS["orbbec"], connected=fails))
    assert [one.serial for one in connected_sensors(OURS)] == ["7"]
    sys.modules["acme"].there = []
    monkeypatch.setitem(live_sensors.VENDORS, "acme", replace(row, connected=fails))
    with pytest.raises(DeviceError, match="AttributeError: 'Context' object"):
        connected_sensors(OURS)


def test_the_command_for_an_extra_finds_the_program_without_an_index_or_an_activated_environment(tmp_path):
    assert "'" not in extra_command("export")  # no quote in cmd.exe
    command = [*shlex.split(extra_command("export")), "--no-index", "--no-deps", "--dry-run"]
    bare = {name: value for name, value in os.environ.items() if name != "PATH"}
    told = subprocess.run(command, cwd=tmp_path, env=bare, capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    assert "already satisfied: duplex-kinects[export]" in told.stdout


GREY = np.zeros((3, 4), np.uint16)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"time_ns": None}, "time_ns is nanoseconds; got None"),
        ({"time_ns": float("nan")}, "time_ns is nanoseconds; got nan"),
        ({"people": [np.ones((25, 3))]}, "people are a dict; got a list"),
        ({"people": {1: nobody(AZURE_KINECT)}}, "people are by an id, a str; got 1"),
        ({"people": {"1": np.ones((25, 3))}}, "made by Skeleton.of; got a value of type ndarray"),
        ({"depth": np.ones((3, 4), np.float32)}, r"uint16 millimetres; got \(3, 4\) float32"),
        ({"depth": GREY.tolist()}, "uint16 millimetres; got a list"),
        ({"depth": GREY[..., None]}, r"\(height, width\) uint16 millimetres; got \(3, 4, 1\)"),
        ({"ir": GREY.astype(np.uint8)}, r"ir is \(height, width\) uint16; got \(3, 4\) uint8"),
    ],
)
def test_what_a_sensor_of_ones_own_gives_wrongly_ends_it_with_one_line(given, said):
    class Own(ScriptedSensor):
        def frames(self):
            yield SensorFrame(**{"time_ns": 10**9, **given})

    def run():
        with SensorThread(Own()) as thread:
            assert thread.arrival.wait(10.0)
            thread.take()

    with pytest.raises(FrameError, match=said):
        run()
