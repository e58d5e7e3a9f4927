# SPDX-License-Identifier: Apache-2.0
"""The page of a sensor: its gel, optics and housing drawn to scale, and what its profile says."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.profile.optical_design import DesignedCamera, Light, OpticalDesign
from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.viewer.gel_states import SensorImages
from taccel_lab.viewer.page_parts import SensorPanel, look_at

if TYPE_CHECKING:
    from viser import ViserServer

    from taccel_lab.profile import SensorProfile
    from taccel_lab.sensors.base import FamilyParameters

GEL_RGB, SKIN_RGB = (236, 204, 158), (196, 160, 112)
WINDOW_RGB, HOUSING_RGB = (150, 200, 225), (120, 126, 136)
FRUSTUM_SHARE = 0.3
"""How far the camera's pyramid reaches, as a part of its distance from the gel."""
LED_MM = 0.8
CAD_PARTS = ("housing", "cover")


def draw_sensor(
    server: ViserServer,
    mesh: TetMesh,
    design: OpticalDesign | None,
    image: np.ndarray | None,
    further: Sequence[DesignedCamera] = (),
) -> None:
    """Draw gel, window, LEDs and cameras, in place of earlier ones; see ``draw_optics``."""
    with server.atomic():
        draw_gel(server, mesh)
        if design is not None:
            draw_optics(server, design, 1e3 * float(mesh.nodes_m[:, 2].min()), image, further)


def draw_gel(server: ViserServer, mesh: TetMesh) -> None:
    """The gel's skin and, hidden at first, its mesh."""
    points = 1e3 * mesh.nodes_m
    face = mesh.region_faces(Region.CONTACT)
    others = mesh.region_faces(Region.SIDE, Region.BOND, Region.WINDOW)
    for name, faces, color in (("face", face, SKIN_RGB), ("body", others, GEL_RGB)):
        server.scene.add_mesh_simple(
            f"/gel/{name}", points, faces, color=color, side="double",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
    server.scene.add_mesh_simple(
        "/mesh", points, mesh.faces, color=(60, 65, 75), wireframe=True, visible=False
    )


def draw_optics(
    server: ViserServer,
    design: OpticalDesign,
    back_mm: float,
    image: np.ndarray | None,
    further: Sequence[DesignedCamera] = (),
) -> None:
    """Window, LEDs and cameras; ``back_mm``: z of the gel's back; ``further`` cameras are drawn
    without an image."""
    for name in ("/leds", "/window", "/cameras"):
        earlier = server.scene.get_handle_by_name(name)
        if earlier is not None:
            earlier.remove()
    with server.atomic():
        _draw_window(server, design, back_mm)
        pieces = [piece for light in design.lights for piece in light.straight_pieces()]
        for k, light in enumerate(pieces):
            _draw_led(server, f"/leds/{k}", light)
        _draw_camera(server, "/camera", design.camera, image)
        for k, camera in enumerate(further):
            _draw_camera(server, f"/cameras/{k}", camera, None)


def _draw_camera(
    server: ViserServer, name: str, camera: DesignedCamera, image: np.ndarray | None
) -> None:
    x, y, z, w = camera.rotation
    server.scene.add_camera_frustum(
        name,
        fov=2 * float(np.arctan(camera.height_px / 2 / camera.fy_px)),
        aspect=camera.width_px / camera.height_px,
        scale=FRUSTUM_SHARE * float(np.linalg.norm(camera.position_mm)),
        thickness=0.15, color=(0, 114, 178), image=image,
        wxyz=(w, x, y, z), position=camera.position_mm,
    )  # fmt: skip


def _draw_window(server: ViserServer, design: OpticalDesign, back_mm: float) -> None:
    window = design.window
    if window is None or window.shape != "plate":
        return
    size = (*window.size_mm, window.thickness_mm)
    server.scene.add_box(
        "/window", color=WINDOW_RGB, dimensions=size, opacity=0.25,
        position=(0.0, 0.0, back_mm - window.thickness_mm / 2),
        cast_shadow=False, receive_shadow=False,
    )  # fmt: skip


def _draw_led(server: ViserServer, name: str, light: Light) -> None:
    toward = np.asarray(light.direction)
    across = np.array([-toward[1], toward[0], 0.0])
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-9 else np.eye(3)[0]
    axes = np.stack([across, np.cross(toward, across), toward], axis=1)
    size = np.array([max(light.size_mm[0], 0.5), max(light.size_mm[1], 0.5), LED_MM])
    corners = (np.indices((2, 2, 2)).reshape(3, -1).T - 0.5) * size
    corners[:, 2] -= LED_MM / 2
    box = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip
    peak = max(light.rgb)
    color = np.array([60 + 195 * part / peak for part in light.rgb], dtype=np.uint8)
    server.scene.add_mesh_simple(
        name, corners @ axes.T + np.asarray(light.position_mm), box, color=color, side="double",
        flat_shading=True, cast_shadow=False, receive_shadow=False,
    )  # fmt: skip


def cad_parts(name: str, parameters: FamilyParameters) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Vertices [mm] and triangles of the housing's parts, by name; takes the CAD kernel seconds.

    Raises InputError for parts that cannot be built.
    """
    from taccel_lab.sensors.workshop import sensor_parts

    found = {}
    for part in sensor_parts(name, parameters).parts:
        if part.name in CAD_PARTS:
            points, faces = part.solid.tessellate(0.1)
            found[part.name] = (np.array([[*point] for point in points]), np.array(faces))
    return found


def draw_housing(server: ViserServer, parts: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Draw what ``cad_parts`` built, as one can see through."""
    for name, (points, faces) in parts.items():
        server.scene.add_mesh_simple(
            f"/housing/{name}", points, faces, color=HOUSING_RGB, opacity=0.25, side="double",
            flat_shading=True, cast_shadow=False, receive_shadow=False,
        )  # fmt: skip


def add_part_switches(server: ViserServer) -> dict[str, Any]:
    """Checkboxes that show and hide the parts, by name."""
    switches = {}
    for label, node, shown in (
        ("gel", "/gel", True), ("mesh of the gel", "/mesh", False), ("window", "/window", True),
        ("LEDs", "/leds", True), ("camera", "/camera", True), ("housing", "/housing", True),
    ):  # fmt: skip
        box = server.gui.add_checkbox(label, shown)

        def switch(_: Any, box: Any = box, node: str = node) -> None:
            handle = server.scene.get_handle_by_name(node)
            if handle is not None:
                handle.visible = bool(box.value)

        box.on_update(switch)
        switches[label] = box
    return switches


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
