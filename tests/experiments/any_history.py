"""How far S* is from the person after a second of clean views, whatever came before.

python -m tests.experiments.any_history [DRAWS]
"""

import sys

import numpy as np

from tests.helpers.laws import Stage, drawn_happenings


def main(draws=1000):
    """Prints the figures of so many histories, and the worst of them."""
    found = []
    for seed in range(draws):
        random = np.random.default_rng(seed)
        stage, history = Stage(seed=seed), drawn_happenings(random)
        for happening in history:
            stage.happen(happening)
        apart, off, sigma = stage.clean()
        rms = np.sqrt((off**2).mean(axis=1) / (sigma**2).mean(axis=1)).max()
        found.append((apart[-1].max(), off[-1].max(), rms, seed, history))
    found.sort(key=lambda one: -one[0])
    far, off, rms = (np.array([one[k] for one in found]) for k in range(3))
    print(f"{draws} draws; after 1 s of clean views, farthest joint:")
    mm = 1e3 * far
    print(f"from a new Fuser's S*: median {np.median(mm):.1f}, 99 % {np.percentile(mm, 99):.1f}, ", end="")
    print(f"largest {mm[0]:.1f} mm; more than 50 mm: {(mm > 50.0).sum()}")
    print(f"from the person: largest {1e3 * off.max():.1f} mm")
    print(f"rms error over rms sigma on the way: 99 % {np.percentile(rms, 99):.2f}, largest {rms.max():.2f}")
    for one in found[:6]:
        print(f"seed {one[3]}: {1e3 * one[0]:.0f} mm, {one[2]:.1f} sigma: {one[4]}")
    for k in np.argsort(-rms)[:4]:
        print(f"seed {found[k][3]}: {found[k][2]:.1f} sigma, {1e3 * found[k][0]:.0f} mm: {found[k][4]}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
