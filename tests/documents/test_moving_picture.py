"""The README's moving picture: which moment it shows, its size, and that it moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recordings import fuse, layout
from tests.campaigns.moving_picture import hardest_window, pictures, with_legend, write_animation
from tests.helpers.machine import need_viewer
from tests.helpers.written_recordings import write_recordings


def test_the_hardest_moment_is_where_the_views_disagree_most() -> None:
    seconds = np.arange(0.0, 10.0, 0.1)
    apart = np.where((seconds >= 6.0) & (seconds < 8.0), 0.2, 0.02)
    apart[3] = np.nan
    begin, end = hardest_window(seconds, apart, 2.0)
    assert end - begin == pytest.approx(2.0)
    assert begin == pytest.approx(6.0, abs=0.11)  # a frame is 0.1 s


def test_a_short_session_is_shown_whole() -> None:
    assert hardest_window([0.0, 0.5, 1.0], [0.1, 0.1, 0.1], 4.0) == (0.0, 1.0)


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


def test_the_legend_names_the_skeletons_in_their_colours() -> None:
    legend = np.asarray(with_legend(Image.new("RGB", (720, 480))), dtype=int)
    for key in ("a", "b", "fused"):
        near = np.abs(legend - layout.SKELETON_COLORS[key]).max(axis=2) <= 10
        assert near.sum() > 10, key  # a letter, without its blurred edges


def test_the_viewer_draws_other_pictures_at_other_moments(tmp_path: Path) -> None:
    need_viewer()
    session = fuse(*write_recordings(tmp_path))
    first, again, last = (np.asarray(p, dtype=int) for p in pictures(session, [0.5, 0.5, 2.2], (480, 320)))
    assert first.shape[1] > 400
    np.testing.assert_array_equal(first, again)
    assert (np.abs(first - last).max(axis=2) > 60).sum() > 50
