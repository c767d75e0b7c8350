"""Files damaged at random: each is read, or refused with one line and exit code 2; never a traceback."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from recordings.calibration_file import calibration_to_json
from tests.helpers.command_line import duplex
from tests.helpers.recorded_pairs import write_json, write_ntu, write_view
from tests.helpers.two_views import A_FROM_B, moving

FRAMES = 12
_ODD = (
    *("nan", "-1", "1e999", "9" * 400, "null", "[]", "{}", '""', "é", "\0", "0x1", ",", "\n", "true"),
    "1e-320",
)


WRITERS = {
    ".csv": lambda path, at: write_view(path, KINECT_V2, at),
    ".json": write_json,
    ".skeleton": write_ntu,
}


@st.composite
def damage(draw):
    """Damages a file in one to three places: a cut, a flipped bit, lost, doubled or replaced bytes."""
    kind = st.sampled_from(("cut", "flip", "lose", "double", "odd"))
    place, length = st.floats(0, 1, exclude_max=True), st.integers(1, 200)
    wound = st.tuples(kind, place, length, st.sampled_from(_ODD))
    wounds = draw(st.lists(wound, min_size=1, max_size=3))

    def apply(data):
        for kind, place, length, odd in wounds:
            offset = int(place * len(data))
            before, there, after = data[:offset], data[offset : offset + length], data[offset + length :]
            if kind == "cut":
                data = before
            elif kind == "flip" and there:
                data = before + bytes([there[0] ^ (1 << length % 8)]) + there[1:] + after
            elif kind == "lose":
                data = before + after
            elif kind == "double":
                data = before + there + there + after
            elif kind == "odd":
                data = before + odd.encode() + there[length // 20 :] + after
        return data

    return apply


def _must_be_fused_or_refused(capsys, *arguments):
    code = duplex("fuse", *arguments, "--no-viewer")  # a traceback is an exception here
    said = capsys.readouterr().err
    if code == 0:
        assert said == ""
    else:
        assert code == 2
        assert said.startswith("duplex: ")
        assert said.endswith("\n")
        assert said.count("\n") == 1
        assert len(said) < 800, "one line that can be read"
    return code


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A's and B's recording in every format."""
    folder = tmp_path_factory.mktemp("whole")
    offset = moving(KINECT_V2, FRAMES)
    seen_by_b = A_FROM_B.inverse().apply(offset)
    return {
        ending: (write(folder / f"a{ending}", offset), write(folder / f"b{ending}", seen_by_b))
        for ending, write in WRITERS.items()
    }


@pytest.mark.parametrize("ending", WRITERS)
def test_whole_files_are_fused(whole, ending, capsys):
    assert _must_be_fused_or_refused(capsys, *whole[ending]) == 0


@pytest.mark.parametrize("ending", WRITERS)
@given(wound=damage())
def test_damaged_skeletons_are_fused_or_refused(whole, tmp_path, capsys, ending, wound):
    a, b = whole[ending]
    damaged = tmp_path / f"damaged{ending}"
    damaged.write_bytes(wound(b.read_bytes()))
    _must_be_fused_or_refused(capsys, a, damaged)


@given(wound=damage())
def test_damaged_calibrations_are_used_or_refused(whole, tmp_path, capsys, wound):
    calibration = tmp_path / "calibration.json"
    calibration.write_bytes(wound(calibration_to_json(nominal_calibration(KINECT_V2)).encode()))
    _must_be_fused_or_refused(capsys, *whole[".csv"], "--calibrate", calibration)
