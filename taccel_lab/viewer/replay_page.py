# SPDX-License-Identifier: Apache-2.0
"""The page of a recorded task: its frames from all sides, beside them what the gel shows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.tasks.replay import read_replay
from taccel_lab.viewer.bodies_view import BodiesView
from taccel_lab.viewer.camera_place import look_at
from taccel_lab.viewer.gel_images import gel_images
from taccel_lab.viewer.live_scene import DIRECTION
from taccel_lab.viewer.sensor_panel import SensorPanel
from taccel_lab.viewer.time_slider import TimeSlider

if TYPE_CHECKING:
    from viser import ViserServer


def fill_replay_page(server: ViserServer, folder: Path) -> TimeSlider:
    """Show what ``taccel-lab task record --states`` kept."""
    replay = read_replay(folder)
    every = np.concatenate([body.vertices_m.reshape(-1, 3) for body in replay.bodies])
    look_at(server, 1e3 * every.astype(np.float64), DIRECTION)
    view = BodiesView(server, [(b.kind, b.vertices_m[0], b.faces) for b in replay.bodies])
    images = gel_images(replay.rgb, replay.depth_m, replay.pressure_pa, replay.markers_px)
    caption = add_note(server.gui)
    panel = SensorPanel(server, "Gel")

    def show(frame: int) -> None:
        view.move([body.vertices_m[frame] for body in replay.bodies])
        forces = [(name, f"{values[frame]:.3f} N") for name, values in replay.forces_n.items()]
        caption.content = PageText("**{}**, seed {}: {}\n\n{:.2f} s\n\n{}").format(
            replay.task, replay.seed, replay.outcome, replay.times_s[frame],
            page_table(forces, ("force", "")),
        )  # fmt: skip
        panel.show(images, frame)

    slider = TimeSlider(server, len(replay.times_s), show)
    show(0)
    return slider
