# SPDX-License-Identifier: Apache-2.0
"""What the metrics of one design are computed from: its presses, pixels, markers and optics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.camera.gel_camera import GelCamera, View
from taccel_lab.camera.refraction import glued_back_mm, media_between
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.presses.force_search import by_power_law
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.signals import MarkerLayout
from taccel_lab.studies.metrics.design_point import LOAD_N, NoFigure
from taccel_lab.studies.presses.press_record import PressRecord, section_heights

if TYPE_CHECKING:
    from taccel_lab.optics.photometry import Photometry
    from taccel_lab.optics.render import OpticalModel
    from taccel_lab.tasks.result import TaskResult, TaskTrial


VIEW_PX = 240
"""Longer side of the pictures that figures are read from."""
_DENTED = 0.1
"""Part of the largest dent from which a pixel counts as dented."""


def view_model(
    parameters: FamilyParameters,
    record: PressRecord | None = None,
    *,
    size_px: int = VIEW_PX,
    enlarged: bool = False,
    markers: bool = True,
    device: str = "cpu",
) -> OpticalModel:
    """Optical model of a design, on the mesh of a press or on the even mesh of its pad, with its
    markers or without; pictures of ``size_px`` along the longer side, finer than the camera's own
    pixels only when ``enlarged``.

    Raises InputError for a family without optics.
    """
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.optics.render import OpticalModel

    design = parameters.optics()
    if design is None:
        raise InputError("the family has no optical model")
    size = design.camera.size_within(size_px, enlarged=enlarged)
    mesh = gel_mesh(parameters.pad()) if record is None else record.mesh
    dots = parameters.markers() if markers else None
    return OpticalModel(design, mesh, size_px=size, markers=dots, device=device)


def photometry(parameters: FamilyParameters, device: str = "cpu") -> Photometry:
    """Photometric figures of the untouched gel, without its markers."""
    from taccel_lab.optics.photometry import measure_photometry

    return measure_photometry(view_model(parameters, markers=False, device=device))


def picture_change(model: OpticalModel, record: PressRecord, steps: list[int]) -> np.ndarray:
    """Mean change of the grey levels (of 255, mean of the channels) where a press dents the gel.

    Over the pixels whose point of the face lies deeper by at least a tenth of the deepest; [step].
    Raises NoFigure where the camera sees nothing of the dent.
    """
    rest = model.render(record.rest_m)
    changes = []
    for step in steps:
        pressed = model.render(record.positions_m(step))
        deeper = _along(record, rest.points_mm) - _along(record, pressed.points_mm)
        seen = rest.mask & pressed.mask & np.isfinite(deeper)
        dented = seen & (deeper >= _DENTED * np.max(deeper, where=seen, initial=0.0))
        if not (dented.any() and deeper[dented].max() > 0):
            raise NoFigure("the camera sees nothing of the press")
        levels = np.abs(pressed.rgb[dented].astype(float) - rest.rgb[dented]).mean(axis=-1)
        changes.append(float(levels.mean()))
    return np.array(changes)


def _along(record: PressRecord, points_mm: np.ndarray) -> np.ndarray:
    """Heights of points along the press [mm], [..., 3] -> [...]."""
    return record.in_press(points_mm.astype(np.float64) * 1e-3)[..., 2] * 1e3


VIRTUAL_PITCH_MM = 1.0
"""Pitch of the points that stand for markers on a gel without."""
_PROFILE_PX = 401

VITAC_TASKS = ("peg-vitac-cuboid", "peg-vitac-trapezoid", "peg-vitac-concave")
"""Tasks with the pegs of ManiSkill-ViTac 2025, whose third track judges designs."""


@dataclass
class Evidence:
    """One design after its presses."""

    parameters: FamilyParameters
    records: dict[str, list[PressRecord]]
    """Records by press, in the order of its indenters and places."""
    causes: dict[str, str] = field(default_factory=dict)
    """Why a press has no records, by press."""
    load_n: float = LOAD_N
    device: str = "cpu"
    """Warp device of the pictures."""
    indenter: str = ""
    """The one that figures are read of; empty for a press's first."""
    press: str = ""
    """Press of figures which can be read from several."""
    changes: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict, repr=False
    )
    """What ``picture_change`` has found, with the motion that it was of, by its id and steps."""

    def of(self, press: str, indenter: str, load_n: float) -> Evidence:
        """The same design as one tool shows it at one load."""
        return replace(self, press=press, indenter=indenter, load_n=load_n)

    def all(self, press: str) -> list[PressRecord]:
        """Records of a press; raises NoFigure when one did not get to its end."""
        if press in self.causes:
            raise NoFigure(f"press {press}: {self.causes[press]}")
        if press not in self.records:
            raise NoFigure(f"the press {press!r} was not asked for")
        found = [r for r in self.records[press] if self.indenter in ("", r.indenter)]
        for record in found:
            if record.cause:
                raise NoFigure(f"press {press}: {record.cause}")
        return found

    def one(self, press: str) -> PressRecord:
        """The first record of a press; raises NoFigure as ``all``."""
        return self.all(press)[0]

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel [mm], the mean of both axes."""
        grid = self.parameters.grid()
        return 0.5 * (grid.mm_per_px_x + grid.mm_per_px_y)

    @cached_property
    def photometry(self) -> Photometry:
        """Photometric figures of the untouched gel; raises InputError without optics."""
        return photometry(self.parameters, self.device)

    @cached_property
    def insertion(self) -> TaskResult:
        """The design in the task ``touch-insertion``; raises InputError without markers."""
        return self._task("touch-insertion")

    @cached_property
    def vitac(self) -> list[TaskTrial]:
        """The design with the three pegs of ManiSkill-ViTac 2025; raises InputError without
        markers."""
        return [trial for name in VITAC_TASKS for trial in self._task(name).trials]

    def _task(self, name: str) -> TaskResult:
        from taccel_lab.studies.metrics.design_task import design_task
        from taccel_lab.tasks.catalogue import run_task

        task = design_task(self.parameters, name)
        return run_task(task, range(task.parameters.seeds), self.device)

    def picture_change(self, record: PressRecord, steps: list[int]) -> np.ndarray:
        """See the function ``picture_change``. Gels of other moduli that move alike look alike: the
        pictures are rendered once for the figure and both ends of its interval."""
        key = (id(record.moved_m), *steps)
        if key not in self.changes:
            model = view_model(self.parameters, record, device=record.device)
            self.changes[key] = picture_change(model, record, steps), record.moved_m
        return self.changes[key][0]

    def marker_motion_px(self, record: PressRecord, steps: Sequence[int]) -> np.ndarray:
        """Motion of the markers since rest in the camera's image [px], [step, marker, 2]: in
        perspective, where the family has optics."""
        layout = MarkerLayout.from_points(record.mesh, self.marker_points_mm())
        grid, design = self.parameters.grid(), self.parameters.optics()
        view: View = grid
        if design is not None:
            media = media_between(design, glued_back_mm(record.mesh))
            view = GelCamera(design.camera, media, grid)
        shapes = np.stack([record.rest_m, *(record.positions_m(step) for step in steps)])
        places = view.pixel_from_gel(layout.places_mm(shapes))
        return places[1:] - places[0]

    def marker_points_mm(self) -> np.ndarray:
        """Gel xy of the markers that the camera sees, shape [marker, 2].

        Of a gel without markers a virtual grid of ``VIRTUAL_PITCH_MM``. Markers within 0.5 mm of
        the contact face's outline are left out.
        """
        grid, design = self.parameters.grid(), self.parameters.markers()
        corner = np.array([grid.width_px - 1, grid.height_px - 1])
        low, high = grid.gel_from_pixel(0 * corner), grid.gel_from_pixel(corner)
        if design is not None:
            points = design.points_mm()
        else:
            count = np.floor((high - low) / 2 / VIRTUAL_PITCH_MM).astype(int)
            x, y = (np.arange(-n, n + 1) * VIRTUAL_PITCH_MM for n in count)
            points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) + (low + high) / 2
        pad = self.parameters.pad()
        around = points[:, None] + 0.5 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        on_face = np.isfinite(pad.top_mm(around)).all(axis=1)
        seen = ((points >= low) & (points <= high)).all(axis=1)
        return points[on_face & seen]


def at_load(record: PressRecord, values: np.ndarray, load_n: float) -> float:
    """A positive quantity of the steps straight down at a normal load, by power laws between steps.

    Hertz's contact is a power law in the load, so that few steps suffice. Below the first step the
    law of the first two goes on.

    Raises:
        NoFigure: The press ends below the load, or the first step is above ten times the load.
    """
    force = record.normal_n
    if not (len(force) >= 2 and (np.diff(force) > 0).all() and force[0] > 0):
        raise NoFigure(f"press {record.press}: the force does not rise from step to step")
    if load_n > force[-1] * (1 + 1e-9):
        raise NoFigure(
            f"press {record.press} ends at {force[-1]:.3g} N, below the load of {load_n:g} N; a "
            f"greater depth_fraction or depth_mm in [press.{record.press}] goes on"
        )
    if load_n < force[0] / 10:
        raise NoFigure(
            f"the first step of press {record.press} has {force[0]:.3g} N, more than ten times the "
            f"load of {load_n:g} N"
        )
    if not (values > 0).all():
        return float(np.interp(load_n, np.append(0.0, force), np.append(0.0, values)))
    return by_power_law(force, values, load_n)


def dent_mm(record: PressRecord) -> np.ndarray:
    """Largest motion of the contact face along the press at each step straight down [mm]."""
    down = np.array([0.0, 0.0, -1.0])
    idx = record.surface.node_idx
    turned = [
        record.in_press(record.positions_m(step)[idx]) - record.in_press(record.rest_m[idx])
        for step in range(record.down.stop)
    ]
    return np.array([(u @ down).max() for u in turned]) * 1e3


def contact_radius_mm(record: PressRecord) -> np.ndarray:
    """Radius of the disc of the contact's area at each step straight down [mm].

    Raises NoFigure for tools whose contact is not measured.
    """
    if record.contact_radius_mm is None:
        raise NoFigure(f"the contact of {record.indenter} is not measured")
    return record.contact_radius_mm[record.down]


def section_mm(
    record: PressRecord, half_mm: float, steps: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Sections of the gel's own surface across a press, along the press frame's x.

    Returns x [mm], shape [``_PROFILE_PX``], and heights along the press [mm] at rest and at the end
    of each of the steps, shape [1 + step, ``_PROFILE_PX``], NaN beside the face. The finite-element
    surface, without the indenter's.
    """
    x_mm = np.linspace(-half_mm, half_mm, _PROFILE_PX)
    faces = record.mesh.region_faces(Region.CONTACT)
    shapes = [record.rest_m, *(record.positions_m(step) for step in steps)]
    heights = [section_heights(record.in_press(shape), faces, 1e-3 * x_mm) for shape in shapes]
    return x_mm, 1e3 * np.array(heights)


def profile_mm(record: PressRecord, half_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """x [mm], and the change of height [mm] at full depth, negative in a dent: ``section_mm``."""
    x, (rest, pressed) = section_mm(record, half_mm, [record.down.stop - 1])
    return x, pressed - rest
