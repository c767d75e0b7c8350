"""Which connected sensor is A, which is B, and which leads on the sync cable."""

import pytest

from devices.capture.sensor_choice import ConnectedSensor, NeedsChoiceError, choose_two, sync_master
from devices.sensor import DeviceError

A, B = ConnectedSensor(0, "000123", False, False), ConnectedSensor(1, "000456", False, False)
C = ConnectedSensor(2, "000789", False, False)


def test_two_sensors_and_no_name_asks_which_is_which():
    with pytest.raises(NeedsChoiceError, match="--principal 000123 or --principal 000456") as asked:
        choose_two([B, A])
    assert asked.value.serials == ("000123", "000456")


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        ({"principal": "000456"}, ("000456", "000123")),
        ({"a": "000456"}, ("000456", "000123")),
        ({"b": "000456"}, ("000123", "000456")),
        ({"a": "000123", "b": "000456"}, ("000123", "000456")),
    ],
)
def test_one_name_leaves_the_other_to_what_is_connected(names, chosen):
    assert choose_two([A, B], **names) == chosen


@pytest.mark.parametrize(
    ("connected", "names", "message"),
    [
        ([A, B], {"a": "000999"}, r"No Kinect with serial 000999\. Connected: 000123, 000456"),
        ([A, B], {"a": "000123", "b": "000123"}, "both 000123"),
        ([A, B, C], {}, "3 Kinects are connected"),
        ([A, B], {"a": "000123", "principal": "000456"}, "--kinect-a 000123 and --principal 000456 both"),
    ],
)
def test_a_choice_that_cannot_be_made_is_explained(connected, names, message):
    with pytest.raises(DeviceError, match=message):
        choose_two(connected, **names)


def _jacks(serial, sync_in, sync_out):
    return ConnectedSensor(0, serial, sync_in, sync_out)


def test_the_master_is_where_the_cable_leads_out():
    leads, follows = _jacks("000456", False, True), _jacks("000123", True, False)
    assert sync_master(follows, leads) == sync_master(leads, follows) == "000456"
    assert sync_master(A, B) is None, "without a cable nobody leads"


def test_a_cable_that_joins_no_out_to_an_in_is_explained():
    wrong = _jacks("000123", True, False), _jacks("000456", True, False)
    with pytest.raises(DeviceError, match="000123: in connected, out empty; 000456: in connected"):
        sync_master(*wrong)


def test_a_master_that_is_named_against_the_jacks_is_explained():
    leads, follows = _jacks("000456", False, True), _jacks("000123", True, False)
    assert sync_master(follows, leads, "000456") == "000456"
    for pair in ((follows, leads), (A, B)):
        with pytest.raises(DeviceError, match="--sync-master 000123: no cable leads from its sync out"):
            sync_master(*pair, "000123")
    assert sync_master(_jacks("CL1", False, False), _jacks("CL2", False, False), "CL2") == "CL2"
