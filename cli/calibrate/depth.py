# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate depth``: ball presses on a grey sensor in, its depth curve out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureSet, ContactCircle
    from taccel_lab.calibration.surfaces import PressSurface
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class CalibrateDepth:
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
    maps: Path | None = None
    """Rectification maps (.npz) that `taccel-lab calibrate camera --maps` wrote: background and
    presses are rectified first, and the scale is that of the maps."""
    channel: Literal["grey", "red", "green", "blue"] = "grey"
    """Channel whose drop is read; grey is the luma of red, green and blue."""
    zero: Literal["untouched", "rim", "hertz", "simulated"] = "untouched"
    """What depths are counted from: where the grey is that of untouched gel; the rim of the
    contact; or the untouched face, with the rim's sinking of an elastic half-space (hertz) or of
    the simulated gel (minutes)."""
    circles: Literal["auto", "detected"] = "auto"
    """Contact circles: those given, and found where none is given; or all of them found."""
    seed: int = 0
    """Seed of the resampling that gives the curve's uncertainty."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        from dataclasses import replace

        import warp as wp
        from rich.console import Console

        from taccel_lab.calibration.base_profile import lost_blocks, on_grid
        from taccel_lab.calibration.check.block_findings import (
            capture_findings,
            joined,
            refusing_with,
        )
        from taccel_lab.calibration.depth.fit import calibrate_depth
        from taccel_lab.calibration.depth.rectified import grey_captures
        from taccel_lab.calibration.depth.report import depth_page
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress

        wp.config.log_level = wp.LOG_ERROR  # no driver, no GPU: none is needed here
        job = open_job(self.captures, self.out, self.base, self.report)
        captures, remarks = grey_captures(job.folder, job.base, self.maps)
        base = on_grid(job.base, captures.grid, captures.provenance)
        lost = lost_blocks(job.base, base)
        with stage_progress(job.console) as progress:
            findings = capture_findings(job.folder, "depth", progress)
        with refusing_with(findings), job.console.status("finding contacts and fitting the curve"):
            result = calibrate_depth(
                captures,
                channel=self.channel,
                zero=self.zero,
                surface_of=self._surface_of(captures, base, job.console),
                circles=self.circles,
                seed=self.seed,
                remarks=remarks,
            )
        result = replace(result, remarks=(*lost, *joined(findings, result.remarks)))
        replace(job, base=base).write(result, depth_page(result, captures))
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

    def _surface_of(
        self, captures: CaptureSet, base: SensorProfile, console: Console
    ) -> Callable[[Sequence[ContactCircle]], Sequence[PressSurface]] | None:
        if self.zero == "simulated":
            from taccel_lab.calibration.simulate import simulate_presses

            return lambda circles: simulate_presses(captures, circles, base, cache=True)
        if self.zero == "hertz":
            from taccel_lab.calibration.surfaces import analytic_surface

            return lambda circles: [
                analytic_surface(
                    circle,
                    captures.grid,
                    press.radius_mm or captures.ball_radius_mm,
                    decay_mm=base.gel.thickness_mm,
                )
                for press, circle in zip(captures.presses, circles, strict=True)
            ]
        return None
