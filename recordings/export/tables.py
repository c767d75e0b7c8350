"""Export of sessions as tables: CSV, Parquet and NumPy's .npz; metres, seconds and degrees, K_A's
frame.

Each writer returns a description of what was written.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from fusion.movement.angles import ANGLES
from recordings.data.session_arrays import SessionArrays
from recordings.errors import UnknownNameError
from recordings.export import Table
from recordings.gait import SIDES, Step
from recordings.session_series import SessionSeries

_STATES = np.array(["not_tracked", "inferred", "tracked"])
_FUSED_STATES = np.array(["fused", "predicted", "never_seen"])


def write_csv(session: SessionSeries, path: Path, table: Table = "long", sigma: bool = False) -> str:
    """Writes :func:`arrow_table`; cells are empty if a joint has no position."""
    with path.open("wb") as file:  # whose errors are the system's; pyarrow's own have its words before them
        pyarrow.csv.write_csv(arrow_table(session, table, sigma), file)
    return _frames(session)


def write_parquet(session: SessionSeries, path: Path, table: Table = "long", sigma: bool = False) -> str:
    """Writes :func:`arrow_table`; null if a joint has no position."""
    import pyarrow.parquet

    with path.open("wb") as file:
        pyarrow.parquet.write_table(arrow_table(session, table, sigma), file)
    return _frames(session)


def arrow_table(session: SessionSeries, layout: Table, sigma: bool) -> pa.Table:
    """:func:`long_table` or :func:`wide_table`, whose metadata has frame, body and rate, and each column's
    ``unit``: ``m``, ``s``, ``deg``; 1 for a weight or probability.

    Raises:
        RecordingError: There is no such layout.
    """
    if layout not in _LAYOUTS:
        raise UnknownNameError("table", layout, tuple(_LAYOUTS))
    table = _LAYOUTS[layout](session, sigma)
    units = {
        "time_s": "s",
        "weight": "1",
        **dict.fromkeys((*"xyz", "sigma"), "m"),
        **dict.fromkeys((*ANGLES, *map(_sigma, ANGLES)), "deg"),
    }
    units |= {f"contact_{side}": "1" for side in SIDES}
    units |= {f"{joint}_{axis}": "m" for joint in session.body.joints for axis in (*"xyz", "sigma")}
    fields = (
        field.with_metadata({"unit": units[field.name]}) if field.name in units else field
        for field in table.schema
    )
    about = {
        "units": "metres, seconds, degrees",
        "frame": "K_A: x right, y down, z forward",
        "body": session.body.name,
        "frame_rate": f"{session.frame_rate:.6g}",
    }
    return table.cast(pa.schema(fields, about))


def units_of(table: pa.Table) -> dict[str, str]:
    """The unit of each column that has one."""
    return {each.name: each.metadata[b"unit"].decode() for each in table.schema if each.metadata}


def write_npz(session: SessionSeries, path: Path) -> str:
    """Writes the arrays of :class:`recordings.data.session_arrays.SessionArrays`, the names of the joints,
    the angles of :class:`recordings.data.series.AngleSeries`, and the steps as an array with named fields."""
    rows, angles = session.rows, session.angles
    kinds = [(name, "U5" if name == "side" else np.float64) for name in Step._fields]
    arrays = {name: getattr(rows, name) for name in ("bone_lengths", "frame", "time_ns")}
    arrays |= {name: values for name, _, values in rows.figures()}
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            **arrays,
            body=np.array(rows.body.name),
            joints=np.array(rows.body.joints),
            never_seen=rows.never_seen,
            bones=np.array(rows.body.bones),
            parents=rows.body.parent_indices,
            angle_names=np.array(angles.names),
            angles=angles.degrees,
            angle_sigma=angles.sigma,
            steps=np.array(list(session.gait.steps), dtype=kinds),
        )
    return _frames(session)


def _frames(session: SessionSeries) -> str:
    return f"{len(session)} frames"


def long_table(session: SessionSeries, sigma: bool = False) -> pa.Table:
    """``frame, time_s, skeleton (a, b, fused), joint, x, y, z, state, weight``; S_B in K_A's frame.

    Args:
        sigma: Whether a column ``sigma`` has one standard deviation of a joint of S*.
    """
    rows = session.rows
    T, J = rows.predicted.shape
    parts = []
    for name, positions, states, weights in _skeletons(rows):
        points = positions.reshape(-1, 3)
        known = _joint_sigma(session) if name == "fused" else np.full((T, J), np.nan)
        last = {"sigma": pa.array(known.ravel(), from_pandas=True)} if sigma else {}
        parts.append(
            pa.table(
                {
                    "frame": np.repeat(rows.frame, J),
                    "time_s": np.repeat(rows.time_ns * 1e-9, J),
                    "skeleton": pa.array([name]).take(pa.array(np.zeros(T * J, dtype=np.int64))),
                    "joint": np.tile(np.array(rows.body.joints), T),
                    **{axis: pa.array(points[:, k], from_pandas=True) for k, axis in enumerate("xyz")},
                    "state": states.ravel(),
                    "weight": pa.array(weights.astype(np.float64).ravel(), from_pandas=True),
                    **last,
                }
            )
        )
    return pa.concat_tables(parts)


def wide_table(session: SessionSeries, sigma: bool = False) -> pa.Table:
    """One row per frame: ``frame, time_s, <joint>_x, <joint>_y, <joint>_z, …`` of S*, its angles in degrees,
    ``contact_left`` and ``contact_right``: the probability that the foot is on the floor while the person
    walks, and ``gait``: the events nearest to the frame, such as ``heel_strike_left``.

    Args:
        sigma: Whether ``<joint>_sigma`` and ``<angle>_sigma`` follow, one standard deviation each.
    """
    rows, angles = session.rows, session.angles
    columns: dict[str, pa.Array] = {"frame": pa.array(rows.frame), "time_s": pa.array(rows.time_ns * 1e-9)}
    positions, deviations = rows.seen, _joint_sigma(session) if sigma else None
    for j, joint in enumerate(rows.body.joints):
        for axis in range(3):
            columns[f"{joint}_{'xyz'[axis]}"] = pa.array(positions[:, j, axis], from_pandas=True)
        if deviations is not None:
            columns[_sigma(joint)] = pa.array(deviations[:, j], from_pandas=True)
    for k, name in enumerate(angles.names):
        columns[name] = pa.array(angles[name], from_pandas=True)
        if sigma:
            columns[_sigma(name)] = pa.array(angles.sigma[:, k], from_pandas=True)
    gait = session.gait
    for side in SIDES:
        contact = gait.contact(side, rows.time_ns * 1e-9)
        columns[f"contact_{side}"] = pa.array(contact, from_pandas=True)
    happened: list[str | None] = [None] * len(rows)
    for seconds, event in gait.events:
        k = int(np.abs(rows.time_ns - 1e9 * seconds).argmin())
        happened[k] = " ".join(filter(None, (happened[k], event)))
    return pa.table({**columns, "gait": pa.array(happened, pa.string())})


def _sigma(name: str) -> str:
    return f"{name}_sigma"


def _joint_sigma(session: SessionSeries) -> NDArray[np.float64]:
    """(T, J) metres; NaN where S* has no position."""
    return np.where(np.isnan(session.rows.seen[..., 0]), np.nan, session.sigma)


def _skeletons(
    rows: SessionArrays,
) -> Iterator[tuple[str, NDArray[np.float64], NDArray[np.str_], NDArray[np.float32]]]:
    yield "a", rows.positions_a.astype(np.float64), _STATES[rows.states_a], rows.weights_a
    yield "b", rows.b_in_a, _STATES[rows.states_b], rows.weights_b
    nothing = np.full(rows.predicted.shape, np.nan, dtype=np.float32)
    states = np.where(rows.never_seen, 2, rows.predicted.astype(np.int64))
    yield "fused", rows.seen, _FUSED_STATES[states], nothing


_LAYOUTS = {"long": long_table, "wide": wide_table}
