# SPDX-License-Identifier: Apache-2.0
"""A gel on a page: a field on skin and section, its value at a click, force arrows, the tool, the
sensor image."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.geometry.shading_normals import split_at_creases
from taccel_lab.report.page_text import PageText, add_html_note, add_note
from taccel_lab.report.painted_mesh import painted_mesh
from taccel_lab.viewer.arrows import Forces, arrow_lines, patch_forces, round_length
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages
from taccel_lab.viewer.page_parts import SensorPanel, TimeSlider
from taccel_lab.viewer.painting import MAPS, bar_html, map_rgb, number_text, shares
from taccel_lab.viewer.section import SectionSurface, clip_faces, cut_tets

if TYPE_CHECKING:
    from viser import ViserServer


@dataclass(frozen=True)
class Probe:
    """Where a ray met a surface first."""

    point: np.ndarray
    """[3], in the unit of the surface."""
    value: float
    """Linear between the corners of the triangle; NaN where one of them is not known."""


def probe(
    surfaces: list[SectionSurface], origin: np.ndarray, direction: np.ndarray
) -> Probe | None:
    """The first hit of a ray with surfaces; None where it passes them.

    Möller and Trumbore 1997, "Fast, minimum storage ray-triangle intersection".

    Args:
        surfaces: With values at their points.
        origin: Start of the ray, [3].
        direction: Of the ray, any length but 0, [3].
    """
    best, nearest = None, np.inf
    for surface in surfaces:
        a, b, c = (surface.points[surface.faces[:, k]] for k in range(3))
        one, two = b - a, c - a
        across = np.cross(direction, two)
        determinant = np.einsum("ij,ij->i", one, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = origin - a
            u = np.einsum("ij,ij->i", away, across) / determinant
            turned = np.cross(away, one)
            v = turned @ direction / determinant
            along = np.einsum("ij,ij->i", two, turned) / determinant
            # Rays along a triangle give no finite numbers, and no hit.
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0) & np.isfinite(along)
        if not hit.any():
            continue
        k = int(np.flatnonzero(hit)[along[hit].argmin()])
        if along[k] < nearest:
            nearest = float(along[k])
            weights = np.array([1 - u[k] - v[k], u[k], v[k]])
            corners = surface.faces[k]
            value = float(weights @ surface.values[corners])
            best = Probe(weights @ surface.points[corners], value)
    return best


PLANES = {"none": None, "across x": (1.0, 0.0), "across y": (0.0, 1.0), "across z": None}
ARROWS = ("none", "by patch", "by node")
LONGEST_ARROW = 0.3
"""Length of arrows at rest of their slider, as a part of the gel's longer side."""
ARROW_RGB = (213, 94, 0)
TOOL_RGB = (150, 156, 166)
PROBE_RGB = (204, 121, 167)


class GelView:
    """What a page shows of a gel, with the controls of it; ``show_states`` gives it another one."""

    def __init__(
        self, server: ViserServer, states: GelStates, sensor: SensorPanel | None = None
    ) -> None:
        """``sensor``: shows the images; a window of its own when None."""
        self._server, self._gui = server, server.gui
        self._lock = threading.RLock()
        self._states = states
        self._fields: list[Field] = states.all_fields()
        self._surfaces: dict[str, SectionSurface] = {}
        """What is drawn of the gel, by its name in the scene."""
        self._silent = False
        """Whether controls are being set for another gel, which is drawn once they all are."""
        with self._gui.add_folder("Time"):
            self._caption = add_note(self._gui)
            self.time = TimeSlider(server, states.count, lambda _: self._redraw())
        with self._gui.add_folder("On the gel"):
            self._field = self._gui.add_dropdown("field", [f.label for f in self._fields])
            self._wanted = str(self._field.value)
            """Field that was chosen; another one is shown of gels that do not have it."""
            self._bar = add_html_note(self._gui)
            self._probe_note = add_note(self._gui, "Click on the gel: the value there.")
            self._map = self._gui.add_dropdown("colours", MAPS)
            self._range = self._gui.add_dropdown("range", ("all steps", "this step"))
            self._mesh = self._gui.add_checkbox("show the mesh", False)
            self._tool = self._gui.add_checkbox("show the tool", True)
            self._more = self._gui.add_slider(
                "motion times", 1, 20, 1, 1, hint="Displacements of the gel, drawn larger."
            )
        with self._gui.add_folder("Section"):
            self._plane = self._gui.add_dropdown("cut", list(PLANES))
            self._offset = self._gui.add_slider("position [%]", 0.0, 100.0, 0.5, 50.0)
            self._turn = self._gui.add_slider(
                "turn [deg]", -90.0, 90.0, 1.0, 0.0, hint="About z, of upright planes."
            )
            self._other = self._gui.add_checkbox("hide the other side", False)
        with self._gui.add_folder("Forces"):
            self._arrows = self._gui.add_dropdown("arrows", ARROWS)
            self._patches = self._gui.add_slider("patches along the gel", 2, 60, 1, 24)
            self._length = self._gui.add_slider("length times", 0.2, 5.0, 0.1, 1.0)
            self._legend = add_note(self._gui)
        self.sensor = sensor or SensorPanel(server)
        for control in (
            self._map, self._range, self._mesh, self._tool, self._more, self._plane,
            self._offset, self._turn, self._other, self._arrows, self._patches, self._length,
        ):  # fmt: skip
            control.on_update(lambda _: self._redraw())
        self._field.on_update(lambda _: self._choose_field())
        self.show_states(states)

    def show_states(self, states: GelStates, state: int | None = None) -> None:
        """Show another gel, from its first state or from ``state`` on."""
        with self._lock:
            self._states, self._fields = states, states.all_fields()
            labels = tuple(field.label for field in self._fields)
            self._silent = True
            if tuple(self._field.options) != labels:
                self._field.options = labels
            self._field.value = self._wanted if self._wanted in labels else labels[0]
            self.time.resize(states.count, state or 0)
            self._silent = False
            self._draw()

    def show_images(self, images: SensorImages | None) -> None:
        """Other images of the gel that is shown; all else stays."""
        with self._lock:
            self._states = replace(self._states, images=images)
            self.sensor.show(images, min(self.time.state, self._states.count - 1))

    def choose(self, **values: Any) -> None:
        """Set controls by name: field, cut, arrows, position, state."""
        names = {"field": self._field, "cut": self._plane, "arrows": self._arrows,
                 "position": self._offset, "other": self._other}  # fmt: skip
        for name, value in values.items():
            if name == "state":
                self.time.set(value)
            else:
                names[name].value = value
        self._draw()

    # Drawing ---------------------------------------------------------------------------------

    def _redraw(self) -> None:
        """A control was moved, by hand or by ``choose``."""
        with self._lock:
            if not self._silent:
                self._draw()

    def _choose_field(self) -> None:
        with self._lock:
            if not self._silent:
                self._wanted = str(self._field.value)
                self._draw()

    def _draw(self) -> None:
        with self._lock, self._server.atomic():
            states = self._states
            state = min(self.time.state, states.count - 1)
            field = next((f for f in self._fields if f.label == self._field.value), self._fields[0])
            values = field.values[state].astype(np.float64)
            limits = field.limits()
            if self._range.value == "this step":
                limits = Field(field.label, field.unit, values[None]).limits()
            colors = map_rgb(str(self._map.value))
            positions = states.positions_mm(state, float(self._more.value))
            self._caption.content = PageText("**{}**").format(states.captions[state])
            self._bar.content = bar_html(field.label, field.unit, limits, colors)
            self._remove("/probe")
            self._probe_note.content = "Click on the gel: the value there."
            self._surfaces.clear()
            self._draw_gel(positions, values, limits, colors)
            self._draw_tool(state)
            self._draw_arrows(positions, state)
            self.sensor.show(states.images, state)

    def _draw_gel(
        self,
        positions: np.ndarray,
        values: np.ndarray,
        limits: tuple[float, float],
        colors: np.ndarray,
    ) -> None:
        states, plane = self._states, self._plane_of(positions)
        skin = SectionSurface(positions, states.faces, values)
        if plane is not None:
            skin = clip_faces(positions, states.faces, values, *plane)
            cut = cut_tets(positions, states.tets, values, *plane)
            self._surface("/gel/section", cut, limits, colors)
        else:
            self._remove("/gel/section")
        self._surface("/gel/skin", skin, limits, colors)
        self._remove("/gel/mesh")
        if self._mesh.value:
            self._server.scene.add_mesh_simple(
                "/gel/mesh", skin.points, skin.faces, color=(60, 65, 75), wireframe=True
            )

    def _surface(
        self, name: str, surface: SectionSurface, limits: tuple[float, float], colors: np.ndarray
    ) -> None:
        if len(surface.faces) == 0:
            self._remove(name)
            return
        self._surfaces[name] = surface
        share = shares(surface.values, limits)
        shown = painted_mesh(surface.points, surface.faces, share, colors)
        handle = self._server.scene.add_glb(name, shown, cast_shadow=False, receive_shadow=False)
        handle.on_click(self._probe)

    def _probe(self, event: Any) -> None:
        """Say the value where the gel was clicked, and mark the place."""
        if event.ray_origin is None or event.ray_direction is None:
            return
        with self._lock, self._server.atomic():
            hit = probe(
                list(self._surfaces.values()),
                np.asarray(event.ray_origin),
                np.asarray(event.ray_direction),
            )
            if hit is None:
                return
            field = next(f for f in self._fields if f.label == self._field.value)
            low, high = field.limits()
            value = f"{number_text(hit.value, high - low)} {field.unit}"
            x, y, z = hit.point
            self._probe_note.content = PageText("**{}** {} at ({:.2f}, {:.2f}, {:.2f}) mm").format(
                field.label, value, x, y, z
            )
            side = float(np.ptp(self._states.rest_mm[:, :2], axis=0).max())
            self._server.scene.add_icosphere(
                "/probe", 0.008 * side, color=PROBE_RGB, position=tuple(hit.point),
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._server.scene.add_label("/probe/label", value)

    def _plane_of(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Point and normal of the section, towards what is taken away."""
        kind = str(self._plane.value)
        if kind == "none":
            return None
        axis = {"across x": 0, "across y": 1, "across z": 2}[kind]
        normal = np.eye(3)[axis]
        if axis != 2:
            angle = np.radians(float(self._turn.value))
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            normal = np.array([*(turn @ normal[:2]), 0.0])
        along = positions @ normal
        share = float(self._offset.value) / 100
        # A hair inside, where a plane through faces would show none of them.
        share = 1e-6 + share * (1 - 2e-6)
        place = along.min() + share * np.ptp(along)
        # Seen from where pages begin, -y is in front.
        sign = (-1.0 if axis == 1 else 1.0) * (-1.0 if self._other.value else 1.0)
        return place * normal, sign * normal

    def _draw_tool(self, state: int) -> None:
        tool = self._states.tool
        if tool is None or not self._tool.value:
            self._remove("/tool")
            return
        x, y, z, qx, qy, qz, qw = tool.poses[state]
        copied, faces = split_at_creases(1e-3 * tool.vertices_mm, tool.faces)
        self._server.scene.add_mesh_simple(
            "/tool", tool.vertices_mm[copied], faces, color=TOOL_RGB, opacity=0.35, side="double",
            wxyz=(qw, qx, qy, qz), position=(x, y, z), cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _draw_arrows(self, positions: np.ndarray, state: int) -> None:
        forces_n, kind = self._states.forces_n, self._arrows.value
        self._remove("/forces")
        if forces_n is None:
            self._legend.content = "No forces were kept."
            return
        total = forces_n[state].sum(axis=0)
        text = f"Sum on the gel: ({total[0]:.3f}, {total[1]:.3f}, {total[2]:.3f}) N."
        if kind != "none":
            patches = int(self._patches.value)

            def forces_of(step: int) -> Forces:
                at = states.positions_mm(step, float(self._more.value))
                if kind == "by node":
                    return Forces(at, forces_n[step])
                return patch_forces(at, states.faces, forces_n[step], patches)

            states = self._states
            largest = max(forces_of(step).largest_n() for step in range(states.count))
            if largest > 0:
                side = float(np.ptp(positions[:, :2], axis=0).max())
                scale = LONGEST_ARROW * side * float(self._length.value) / largest
                lines = arrow_lines(forces_of(state), scale, onto=True)
                unit = round_length(largest)
                text += f" An arrow of {number_text(unit * scale, side)} mm is {unit:g} N."
                if len(lines):
                    self._server.scene.add_arrows(
                        "/forces", lines, ARROW_RGB, shaft_radius=0.004 * side,
                        head_radius=0.011 * side, head_length=0.025 * side,
                    )  # fmt: skip
        self._legend.content = text

    def _remove(self, name: str) -> None:
        handle = self._server.scene.get_handle_by_name(name)
        if handle is not None:
            handle.remove()
