# SPDX-License-Identifier: Apache-2.0
"""The page of a recorded task: its frames from all sides."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.tasks.replay import read_replay
from taccel_lab.viewer.bodies_view import BodiesView, rise_image
from taccel_lab.viewer.camera_place import look_at
from taccel_lab.viewer.gel_states import SensorImages
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
    reach = max(float(np.nanquantile(np.abs(replay.rises_m), 0.99)), 1e-6)
    rises = SensorImages(np.stack([rise_image(rise, reach) for rise in replay.rises_m]))
    caption = add_note(server.gui)
    panel = SensorPanel(server, "Rise of the gel")

    def show(frame: int) -> None:
        view.move([body.vertices_m[frame] for body in replay.bodies])
        forces = [(name, f"{values[frame]:.3f} N") for name, values in replay.forces_n.items()]
        caption.content = PageText(
            "**{}**, {:.2f} s\n\n{}\n\n"
            "Beside: rise of the gel's face, blue below and red above, to ±{:.2f} mm."
        ).format(replay.task, replay.times_s[frame], page_table(forces, ("force", "")), 1e3 * reach)
        panel.show(rises, frame)

    slider = TimeSlider(server, len(replay.times_s), show)
    show(0)
    return slider
