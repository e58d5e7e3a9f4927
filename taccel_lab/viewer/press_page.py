# SPDX-License-Identifier: Apache-2.0
"""The page of a press."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.viewer.camera_place import look_at
from taccel_lab.viewer.gel_view import GelView
from taccel_lab.viewer.press_folder import STATES, summary

if TYPE_CHECKING:
    from viser import ViserServer

    from taccel_lab.viewer.gel_states import GelStates


def fill_press_page(server: ViserServer, folder: Path, states: GelStates) -> GelView:
    """Show the press in a folder, which ``read_press`` has read, at its end."""
    add_note(server.gui, page_table(summary(folder)))
    if not (folder / STATES).is_file():
        words = (
            "Only the end of this press was kept. `taccel-lab press … --states` keeps every step."
        )
        add_note(server.gui, PageText(words))
    look_at(server, states.rest_mm)
    view = GelView(server, states)
    view.choose(state=states.count - 1)
    return view
