"""Checks of the program's own body tracker, as data."""

from importlib.util import find_spec

from devices.blazepose.networks.files import cache_folder, checked_content, fetch_command, files_of, missing
from devices.blazepose.settings import BlazePoseSettings
from devices.check import Check, failed
from devices.sensor import DeviceError

_NAME = "blazepose"


def networks_check(settings: BlazePoseSettings) -> Check:
    """Whether the tracker's runtime and networks are here; networks that can be fetched are no fault."""
    if find_spec("ai_edge_litert") is None:
        advice = "pip install ai-edge-litert; it has no wheel for macOS on Intel."
        return Check(_NAME, False, "its runtime ai-edge-litert is not installed", advice)
    folder = settings.models or cache_folder()
    if settings.models is None and missing(settings.network, folder):
        by = "pip" if settings.network == "full" else "npm"
        command = fetch_command(settings.network, folder)
        advice = f"They are fetched at the first use, with {by}; now: {command}."
        return Check(_NAME, False, f"its networks are not in {folder} yet", advice, needed=False)
    try:
        for file in files_of(settings.network):
            checked_content(file, folder)
    except DeviceError as fault:
        return failed(_NAME, fault)
    return Check(_NAME, True, f"network {settings.network} in {folder}")
