# SPDX-License-Identifier: Apache-2.0
"""Draws docs/images/captures_good_bad.png: presses that help a calibration, and ones that harm it.

    taccel-lab preview gelsight --out out/preview
    python docs/good_bad_picture.py out/preview docs/images/captures_good_bad.png

All of them are made from one predicted press.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.image import imread
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Image = NDArray[np.float64]


def moved(change: Image, down: int, right: int) -> Image:
    """The change of an image elsewhere; what leaves the image is lost."""
    height, width = change.shape[:2]
    there = np.zeros_like(change)
    rows = slice(max(0, down), min(height, height + down))
    columns = slice(max(0, right), min(width, width + right))
    there[rows, columns] = change[
        rows.start - down : rows.stop - down, columns.start - right : columns.stop - right
    ]
    return there


def main(preview: Path, out: Path) -> None:
    """Draw both rows and write the picture."""
    rest, press = (
        imread(preview / f"{name}.png")[..., :3].astype(np.float64) for name in ("rest", "pressed")
    )
    change = press - rest
    height, width = rest.shape[:2]
    slid = [moved(change, 0, int(step)) for step in np.linspace(-0.09, 0.09, 9) * width]
    good = {
        "in the middle": press,
        "near a corner, whole": rest + moved(change, -height // 4, width // 4),
        "shallower: also wanted": rest + 0.6 * change,
        "on another side": rest + moved(change, height // 5, -width // 4),
    }
    bad = {
        "too shallow: no edge to find": rest + 0.12 * change,
        "cut by the border": rest + moved(change, -int(0.45 * height), int(0.3 * width)),
        "the ball slid": rest + np.mean(slid, axis=0) * 1.6,
        "too bright: colours are clipped": 2.1 * press,
    }
    figure, axes = plt.subplots(2, 4, figsize=(11, 4.8))
    for row, (mark, pictures) in enumerate((("good", good), ("take again", bad))):
        for ax, (title, picture) in zip(axes[row], pictures.items(), strict=True):
            noise = np.random.default_rng(0).normal(0, 0.004, picture.shape)
            soft = gaussian_filter(picture, (0.6, 0.6, 0))
            ax.imshow(np.clip(soft + noise, 0, 1))
            ax.set_title(f"{mark}: {title}", fontsize=9, color="#166534" if row == 0 else "#9f1239")
            ax.axis("off")
    figure.tight_layout()
    figure.savefig(out, dpi=75)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
