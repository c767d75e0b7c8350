"""The README's moving picture: its size, and that it moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recordings import fuse
from tests.experiments.moving_picture import pictures, skeletons_of, write_animation
from tests.helpers.machine import need_viewer
from tests.helpers.recorded_pairs import write_recordings


def noise(frames: int) -> list[Image.Image]:
    rng = np.random.default_rng(0)
    return [Image.fromarray(rng.integers(0, 256, (60, 80, 3), dtype=np.uint8)) for _ in range(frames)]


def test_the_animation_stays_below_its_limit(tmp_path: Path) -> None:
    file = tmp_path / "m.webp"
    best = write_animation(file, noise(8), 2.0)
    whole = file.stat().st_size
    lower = write_animation(file, noise(8), 2.0, limit=whole - 1)
    assert lower < best
    assert file.stat().st_size < whole
    with Image.open(file) as made:
        assert made.n_frames == 8  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="do not fit"):
        write_animation(file, noise(8), 2.0, limit=10)


def test_the_viewer_draws_other_pictures_at_other_moments(tmp_path: Path) -> None:
    need_viewer()
    session = fuse(*write_recordings(tmp_path))
    drawn = pictures(session, skeletons_of(session), [15, 15, 66], (160, 240))
    first, again, last = (np.asarray(picture, dtype=int) for picture in drawn)
    assert first.shape == (240, 480, 3)
    np.testing.assert_array_equal(first, again)
    assert (np.abs(first - last).max(axis=2) > 60).sum() > 50
