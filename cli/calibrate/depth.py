# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate depth``: ball presses on a grey sensor in, its depth curve out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from taccel_lab.calibration.depth.options import DepthOptions


@dataclass(frozen=True)
class CalibrateDepth(DepthOptions):
    """Fit the depth of a grey sensor (9DTact) to ball presses and write a profile.

    Where such a gel is pressed it looks darker. The ball's shape gives the depth of every pixel
    inside a contact; a monotone curve from the drop of the grey level to the depth is fitted to
    them, with what left-out presses (or parts of a single one) say of it. Raw images of a lens
    that distorts should be rectified: give --maps. `taccel-lab depth` then reads height maps.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md): background and [[presses]]."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile to extend; the catalogue's design of the captures' sensor when left out. Its camera
    gives the scale where the captures state none."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON); <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        import warp as wp
        from rich.console import Console

        from taccel_lab.calibration.depth.fit import calibrate_depth
        from taccel_lab.calibration.depth.report import depth_page
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress

        wp.config.log_level = wp.LOG_ERROR  # no driver, no GPU: none is needed here
        job = open_job(self.captures, self.out, self.base, self.report)
        with stage_progress(job.console) as progress:
            result = calibrate_depth(job.folder, job.base, self, progress)
        job.write(result, depth_page(result))
        if self.json:
            print_json({"profile": str(self.out), "depth": result.figures()})
            return
        error = result.left_out_mm
        Console().print(
            f"depth up to {result.response.depth_mm[-1]:.2f} mm over "
            f"{result.response.drop_levels[-1]:.0f} levels; off by {error.mean():.3f} mm on pixels "
            f"of a left-out {result.left_out}",
            highlight=False,
        )
