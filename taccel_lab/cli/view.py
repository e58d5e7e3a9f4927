# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab view``: results, sensors and live tasks in the browser."""

from __future__ import annotations

from dataclasses import dataclass, field

import tyro
from tyro.conf import Positional

from taccel_lab.report.page_options import PageOptions


@dataclass(frozen=True)
class ViewCommand:
    """Look at a result in the browser, step by step: gel with pressure, stress and displacement,
    sections, force arrows, sensor image with markers.

    The type of SOURCE is detected: a sensor or profile, a press (--states keeps every step), a
    study, a data set, or a recorded task (taccel-lab task record). A task runs live.
    Ctrl-C closes the page. Needs the extra view: pip install 'taccel-lab[view]'.
    Example: taccel-lab view out/press
    """

    source: Positional[str]
    """Folder that a command wrote, sensor of the catalogue, or task."""
    page: tyro.conf.OmitArgPrefixes[PageOptions] = field(default_factory=PageOptions)
    """Where the page is served and how it looks."""
    seed: int = 0
    """Start of a live task."""
    device: str = "cpu"
    """Device of a live task: cpu, cuda:0 or auto."""

    def run(self) -> None:
        from taccel_lab.cli.console import say
        from taccel_lab.files.seed import require_seed
        from taccel_lab.model.devices import require_device
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.report.live_page import viser_module
        from taccel_lab.viewer.pages import find_source, serve_source

        start_warp()
        viser_module()
        require_device(self.device)
        require_seed(self.seed)
        source = find_source(self.source)
        serve_source(source, self.page, say, seed=self.seed, device=self.device)
