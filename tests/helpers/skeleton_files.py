"""Files of skeletons in any meaning: axes, unit, unit of time, names; and how they are read."""

from devices.skeletons.border import checked, look
from devices.skeletons.meaning import decide
from devices.skeletons.name_tables import name_table
from devices.skeletons.stated_format import MATRICES, METRES, SIGNED, UNSTATED

TIMES = {  # column → of nanoseconds
    "time_us": lambda ns: ns // 1000,
    "time_ms": lambda ns: f"{ns / 1e6:.3f}",
    "time_s": lambda ns: f"{ns / 1e9:.6f}",
    "time_ns": lambda ns: ns,
    "time_ticks": lambda ns: ns // 100,
    "time": lambda ns: f"{ns / 1e6:.2f}",
    "device_time": lambda ns: round(ns * 0.06),
}
NAMES = ("", "nuitrack", "openpose", "mediapipe", "motive", "mixamo")
"""Ready-made tables; empty: a body's own names."""


def read_found(path, found, stated=UNSTATED):
    """What is read of the points of a file."""
    seen = look(path, found, stated)
    return checked(seen, decide([seen.evidence])[0])


def names_by(table, body):
    """The name of each joint of a body in a table of names; None for a joint without a point of its own."""
    if not table:
        return list(body.joints)
    joints = {body.find(joint): ways[0] for joint, ways in name_table(table).joints.items()}
    own = [joints.get(j, ()) for j in range(len(body))]
    single = [way[0] if len(way) == 1 else None for way in own]
    return [name if single.count(name) == 1 else None for name in single]


def write_meaning(path, body, time_ns, positions, states, axes="x,y,z", unit="m", time="time_us", names=""):
    """Writes (T, J, 3) metres of a sensor's frame in another meaning; returns the joints that it has."""
    file_from_sensor = MATRICES[SIGNED.index(axes)].T
    at = positions @ file_from_sensor.T / METRES[unit][0]
    called = names_by(names, body)
    rows = [f"{time},body,joint,x,y,z,state"]
    for ns, places, seen in zip(time_ns.tolist(), at, states, strict=True):
        rows += [
            f"{TIMES[time](ns)},1,{called[j]},{x:.5f},{y:.5f},{z:.5f},{seen[j]}"
            for j, (x, y, z) in enumerate(places)
            if called[j] is not None and seen[j] and x == x
        ]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return [j for j, name in enumerate(called) if name is not None]
