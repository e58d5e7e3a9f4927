# SPDX-License-Identifier: Apache-2.0
"""The page of a profile: its parts in their places, and what it states about itself."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.viewer.camera_place import look_at
from taccel_lab.viewer.gel_states import SensorImages
from taccel_lab.viewer.parts_view import (
    add_part_switches,
    cad_parts,
    draw_housing,
    draw_sensor,
)
from taccel_lab.viewer.sensor_panel import SensorPanel

if TYPE_CHECKING:
    from viser import ViserServer

    from taccel_lab.profile import SensorProfile

VIEW_PX = 320
"""Longer side of the picture that the optical model predicts."""


def fill_profile_page(server: ViserServer, profile: SensorProfile) -> threading.Thread:
    """Show a profile; what takes long comes later, by the thread that is returned."""
    gui, design = server.gui, profile.optical_design()
    add_note(gui, page_table(_rows(profile)))
    with gui.add_folder("Parts"):
        add_part_switches(server)
    with gui.add_folder("Where the figures come from"):
        known = [(name, block.provenance.kind) for name, block in profile.blocks().items()]
        add_note(gui, page_table(known, ("block", "known as")))
    note = add_note(gui)
    shown = "The optical model" if profile.background_rgb is None else "The captured background"
    panel = SensorPanel(server, "Camera", f"{shown}, without a touch.")
    look_at(server, 1e3 * profile.mesh.nodes_m, distance=2.6)
    rgb = profile.background_rgb
    image = None if rgb is None else np.clip(np.round(rgb), 0, 255).astype(np.uint8)
    optics = [view.optics for view in profile.views.values()]
    further = [one.camera() for one in optics if one is not None]
    draw_sensor(server, profile.mesh, design, image, further)
    if image is not None:
        panel.show(SensorImages(image[None]), 0)

    def later() -> None:
        if image is None and design is not None:
            from taccel_lab.optics.render import OpticalModel

            note.content = PageText("*The optical model draws what the camera sees …*")
            markers = None if profile.markers is None else profile.markers.grid()
            size = design.camera.size_within(VIEW_PX)
            seen = OpticalModel(design, profile.mesh, size_px=size, markers=markers).render().rgb
            draw_sensor(server, profile.mesh, design, seen, further)
            panel.show(SensorImages(seen[None]), 0)
        if profile.sensor.family in sensor_families():
            family = sensor_family(profile.sensor.family)
            note.content = PageText("*CAD builds the housing …*")
            try:
                parameters = family.parameters(profile.sensor.parameters)
                draw_housing(server, cad_parts(family.name, parameters))
            except InputError as error:
                note.content = f"No housing: {error}"
                return
        note.content = ""

    thread = threading.Thread(target=later, daemon=True)
    thread.start()
    return thread


def _rows(profile: SensorProfile) -> list[tuple[str, str]]:
    gel, material, camera = profile.gel, profile.material, profile.camera
    size = 1e3 * np.ptp(profile.mesh.nodes_m, axis=0)
    rows = [
        ("sensor", f"{profile.sensor.name} ({profile.sensor.family})"),
        *(("note", remark) for remark in profile.sensor.provenance.remarks),
        ("gel", f"{size[0]:.2f} x {size[1]:.2f} x {gel.thickness_mm:.2f} mm"),
        ("mesh", f"{gel.node_count:,} nodes, {gel.tet_count:,} tets"),
        ("Young's modulus", f"{1e-6 * material.young_modulus_pa:.3g} MPa"),
        ("Poisson's ratio", f"{material.poisson_ratio:.3g}"),
        ("friction", f"{material.friction_coefficient:.3g}"),
        ("image", f"{camera.width_px} x {camera.height_px} px, {camera.mm_per_px_x:.4g} mm/px"),
    ]
    if profile.markers is not None:
        rows.append(("markers", f"{profile.markers.rows} rows x {profile.markers.columns}"))
    return rows
