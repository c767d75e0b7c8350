"""Damage of a session's file, and what may be read of it."""

from dataclasses import fields

import numpy as np

from recordings import Session
from recordings.data import layout
from recordings.data.session_arrays import SessionArrays
from recordings.errors import RecordingError


def damaged(whole, seed):
    """Cut off, or with bits flipped, bytes changed, a stretch zeroed, or torn out."""
    rng = np.random.default_rng(seed)
    data = bytearray(whole)
    offset = int(rng.integers(len(data)))
    match seed % 6:
        case 0:
            del data[offset:]
        case 1:
            data[offset] ^= 1 << int(rng.integers(8))
        case 2:
            for k in rng.integers(len(data), size=int(rng.integers(2, 40))).tolist():
                data[k] = int(rng.integers(256))
        case 3:
            end = min(offset + int(rng.integers(1, 4096)), len(data))
            data[offset:end] = bytes(end - offset)
        case 4:
            del data[offset : offset + int(rng.integers(1, 2000))]
        case 5:  # the start of the file, which holds the settings
            data[int(rng.integers(min(40_000, len(data))))] = int(rng.integers(256))
    return bytes(data)


def opened(path, whole):
    """The session of a file that is damaged, a beginning of `whole` or all of it; None: refused in a line.

    What is missing is said: by its damage, or by the count of damaged images.
    """
    try:
        session = Session.open(path)
    except RecordingError as error:
        assert str(error).count("\n") == 0  # noqa: PT017
        assert len(str(error)) > 20  # noqa: PT017
        return None
    n = len(session)
    for field in fields(SessionArrays):
        expected = getattr(whole.rows, field.name)
        if field.name != "body" and expected is not None:
            np.testing.assert_array_equal(getattr(session.rows, field.name), expected[:n], err_msg=field.name)
    assert session.settings == whole.settings
    assert session.intrinsics_a == whole.intrinsics_a
    assert [first for first, _ in session.calibrations] == [k for k, _ in whole.calibrations if k < n]
    for (_, one), (_, two) in zip(session.calibrations, whole.calibrations, strict=False):
        assert one.a_from_b.rotation.tolist() == two.a_from_b.rotation.tolist()
        assert one.bone_lengths.tolist() == two.bone_lengths.tolist()
    assert set(session.events) <= set(whole.events)
    assert session.frames_lost + n <= len(whole) + whole.frames_lost
    if session.damage is None:
        assert (n, whole.damage, session.frames_lost) == (len(whole), None, 0)
        assert session.events == whole.events
    for side in layout.VIEWS:
        images, found = dict(whole.depth(side)), session.depth(side)
        kept = list(found)
        for frame, image in kept:
            np.testing.assert_array_equal(image, images[frame])
        assert session.damage or found.damaged or len(kept) == len(images)
    return session
