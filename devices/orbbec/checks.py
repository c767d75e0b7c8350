"""Checks of Orbbec's SDK and of its sensors, as data."""

import re
import sys

from devices.capture.sensor_choice import ConnectedSensor
from devices.check import Check, failed, installed_version
from devices.orbbec.sdk_access import faults_of, load_sdk, open_orbbec
from devices.sensor import DeviceError

SDK_NAME = "pyorbbecsdk2 (Orbbec's SDK v2)"
RECOMMENDED_FIRMWARE = {"Femto Bolt": (1, 1, 3), "Femto Mega": (1, 3, 1), "Gemini 2": (1, 4, 98)}
"""By product, from ``config/firmware_compatibility_pid.json`` of pyorbbecsdk2 2.1.2."""


def sdk_check(platform: str = sys.platform) -> Check:
    """Whether Orbbec's SDK v2 is installed, and what it lacks on this platform."""
    try:
        load_sdk()
    except DeviceError as fault:
        return failed(SDK_NAME, fault)
    found = installed_version("pyorbbecsdk2") or "installed"
    if platform == "darwin":
        found += "; on macOS it has no depth engine: no depth from Femto Bolt and Mega, only from Gemini"
    return Check(SDK_NAME, True, found)


def sensor_check(sensor: ConnectedSensor) -> Check:
    """A sensor that Orbbec's SDK lists: opened briefly, for its firmware."""
    serial = str(sensor.serial)
    name, (model, _, connection) = f"Orbbec {serial}", sensor.description.rpartition(", ")
    try:
        sdk = load_sdk()
        try:
            firmware = open_orbbec(sdk, serial).get_device_info().get_firmware_version()
        except faults_of(sdk) as fault:
            raise DeviceError(f"{model} hides its firmware ({fault}). Unplug it, plug it in.") from fault
    except DeviceError as fault:
        return failed(name, fault, needed=False)
    detail = f"{sensor.description}, firmware {firmware}, sync jacks not known"
    if connection.startswith("USB2"):
        return Check(name, False, detail, "Plug it into a USB 3 port, with its own cable.", needed=False)
    advice = firmware_advice(model, firmware)
    return Check(name, not advice, detail, advice, needed=False)


def firmware_advice(model: str, firmware: str) -> str:
    """Advice for a firmware that is older than the maker recommends; empty if it is not, or unknown."""
    product = next((product for product in RECOMMENDED_FIRMWARE if model.endswith(product)), None)
    numbers = tuple(int(number) for number in re.findall(r"\d+", firmware)[:3])
    if product is None or len(numbers) < 3 or numbers >= RECOMMENDED_FIRMWARE[product]:
        return ""
    wanted = ".".join(map(str, RECOMMENDED_FIRMWARE[product]))
    return f"Orbbec recommends firmware {wanted} with this SDK: update it with OrbbecViewer."
