# SPDX-License-Identifier: Apache-2.0
"""Draws docs/images/demo.png: held-out photos beside their simulations, as the demonstration's page
opens with them.

taccel-lab demo --out out/demo
python docs/demo_picture.py out/demo docs/images/demo.png
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from taccel_lab.report.style import in_report_style, new_figure, save_figure

PANELS = (("photo", "photo"), ("simulated", "simulation"), ("difference", "difference x 2"),
          ("depth", "depth"))  # fmt: skip


@in_report_style
def draw(demo: Path, out: Path) -> None:
    """A row a photo."""
    presses = sorted(path for path in (demo / "presses").iterdir() if path.is_dir())
    figure, axes = new_figure(11, 2.3 * len(presses), len(presses), len(PANELS), squeeze=False)
    for row, press in zip(axes, presses, strict=True):
        like = json.loads((press / "press.json").read_text(encoding="utf-8"))["like"]
        said = {
            "simulated": f", {like['psnr_db']:.1f} dB",
            "depth": f", {like['depth_mm']:.2f} ± {like['depth_error_mm']:.2f} mm",
        }
        for panel, (name, title) in zip(row, PANELS, strict=True):
            (path,) = (demo / "report").glob(f"{press.name}_{name}.*")
            panel.imshow(np.asarray(Image.open(path)))
            panel.set_title(title + said.get(name, ""), fontsize=9.5)
            panel.set_axis_off()
    save_figure(figure, out)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
