# SPDX-License-Identifier: Apache-2.0
"""A touched sensor as the simulation needs it, and the units that could have been built of it.

Nothing here is a profile: what a data set needs of one is taken out once (``sensor_of``), so that
simulating and reading need neither its schema nor CAD kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.camera.gel_camera import View, camera_of, face_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.presses import profile_material
from taccel_lab.profile.measured_range import measured_ranges
from taccel_lab.scene import Material, MaterialField
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.dots import PaintedDots, radius_px
from taccel_lab.signals.gel_faces import marker_points_mm
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.perturbation import Perturbation, draw_perturbation
from taccel_lab.signals.rest_surface import RestSurface, rest_surface

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.profile.optical_design import MarkerGrid, OpticalDesign

UNITS_KEY = 1
"""Key of the seeds of units, beside the data set's own."""


@dataclass(frozen=True)
class Unit:
    """One of the sensors that could have been built; the nominal one where all are as below."""

    young_modulus_factor: float = 1.0
    poisson_ratio: float | None = None
    """Ratio in place of the sensor's own."""
    friction_coefficient: float | None = None
    light: Perturbation | None = None
    """Light of its images, one row; its scale and centre are in ``Sensor.unit_grid``."""


@dataclass(frozen=True, eq=False)
class Sensor:
    """What touches need of a sensor."""

    name: str
    digest: str
    """Digest of everything that its profile says; dates do not count."""
    pad: Pad
    mesh: TetMesh
    """Mesh as designed."""
    material_of: Callable[[TetMesh], Material | MaterialField]
    poisson_ratio: float
    friction_coefficient: float
    grid: PixelGrid
    """Pixels of the images, laid over the gel."""
    camera: View
    """What those pixels see: that grid, or the gel in perspective."""
    color: tuple[ColorModel, np.ndarray] | None = None
    """Colour model and image of the untouched gel without its dots, levels, both on ``grid``."""
    dots: PaintedDots | None = None
    """Dots that the camera sees; ``marker_places_mm`` has their places."""
    optics: OpticalDesign | None = None
    """Predicts images where there is no colour model; its camera is ``camera``."""
    painted: MarkerGrid | None = None
    """Markers on the gel; 8 x 6 imagined ones, which images do not show, when None."""
    units: tuple[Unit, ...] = (Unit(),)
    noise_levels: float = 0.0
    """Measured standard deviation of a pixel."""
    _cameras: dict[int, View] = field(default_factory=dict)
    _rests: dict[PixelGrid, RestSurface] = field(default_factory=dict)

    def marker_places_mm(self) -> np.ndarray:
        """Gel xy of the markers that the camera sees [mm], [marker, 2]."""
        points = marker_points_mm(self.grid) if self.painted is None else self.painted.points_mm()
        return points[MarkerLayout.seen_on(self.mesh, points, self.camera)[1]]

    def unit_grid(self, unit: int) -> PixelGrid:
        """Pixels of a unit, laid over the gel."""
        light = self.units[unit].light
        return self.grid if light is None else light.grid(self.grid, 0)

    def unit_camera(self, unit: int) -> View:
        """What the pixels of a unit see; the same object at each call."""
        if unit not in self._cameras:
            grid, camera = self.unit_grid(unit), self.camera
            if grid == self.grid:
                self._cameras[unit] = camera
            else:
                self._cameras[unit] = (
                    grid if isinstance(camera, PixelGrid) else camera.regridded(self.grid, grid)
                )
        return self._cameras[unit]

    def rest(self, unit: int) -> RestSurface:
        """The untouched face that the pixels of a unit are computed on."""
        grid = face_of(self.unit_camera(unit))
        if grid not in self._rests:
            self._rests[grid] = rest_surface(self.mesh, grid)
        return self._rests[grid]


def sensor_of(
    profile: SensorProfile, size_px: tuple[int, int] | None, units: int, seed: tuple[int, ...]
) -> Sensor:
    """The sensor of a profile, with images of a size and with units drawn from its spread.

    Raises:
        InputError: The profile states no measured spread, but units are to differ.
    """
    from taccel_lab.sensors.registry import profile_parameters

    width, height = size_px or (profile.camera.width_px, profile.camera.height_px)
    grid = profile.grid().resized(width, height)
    color, model = None, ColorModel.from_profile(profile)
    if model is not None and profile.background_rgb is not None:
        color = resized_color(model, profile.background_rgb, width, height)
    noise = 0.0
    if units > 1 and profile.perturbation is not None:
        noise = profile.perturbation.noise_levels
    painted = None if profile.markers is None else profile.markers.grid()
    sensor = Sensor(
        name=profile.sensor.name,
        digest=profile_digest(profile),
        pad=profile_parameters(profile).pad(),
        mesh=profile.mesh,
        material_of=lambda mesh: profile_material(profile.material, mesh),
        poisson_ratio=profile.material.poisson_ratio,
        friction_coefficient=profile.material.friction_coefficient,
        grid=grid,
        camera=camera_of(profile).resized(width, height),
        color=color,
        optics=None if color else profile.optical_design(),
        painted=painted,
        units=drawn_units(profile, units, seed),
        noise_levels=noise,
    )
    if color is None or painted is None:
        return sensor
    places = grid.pixel_from_gel(sensor.marker_places_mm())
    dots = PaintedDots.cut_out(color[1], places, radius_px(painted.radius_mm, grid))
    return replace(sensor, color=(color[0], dots.clean_rgb), dots=dots)


def drawn_units(profile: SensorProfile, count: int, seed: tuple[int, ...]) -> tuple[Unit, ...]:
    """The sensor itself, then others: modulus, Poisson's ratio and friction evenly from the ranges
    that hold 95 % of them, light, scale and centre from the spread between units."""
    if count == 1:
        return (Unit(),)
    ranges = measured_ranges(profile)
    if not ranges and profile.perturbation is None:
        raise InputError(
            f"sensor {profile.sensor.name!r} states no measured spread, so that its units cannot "
            "be drawn: set units = 1 and say what varies in [randomise], or measure it with "
            "taccel-lab calibrate material or calibrate background"
        )
    units = [Unit()]
    for number in range(1, count):
        rng = np.random.default_rng([*seed, number])
        drawn = {name: float(rng.uniform(r.low, r.high)) for name, r in sorted(ranges.items())}
        light = None
        if profile.perturbation is not None:
            light = replace(draw_perturbation(profile.perturbation, 1, rng), noise_levels=0.0)
        nominal = profile.material.young_modulus_pa
        units.append(
            Unit(
                drawn.get("young_modulus_pa", nominal) / nominal,
                drawn.get("poisson_ratio"),
                drawn.get("friction_coefficient"),
                light,
            )
        )
    return tuple(units)


def resized_color(
    model: ColorModel, background: np.ndarray, width: int, height: int
) -> tuple[ColorModel, np.ndarray]:
    """Colour model and background for images of another size: the model goes by places from -1 to 1
    over the image, the background is averaged over the new pixels."""
    image = np.asarray(background, dtype=np.float32)
    if (model.config.width_px, model.config.height_px) == (width, height):
        return model, image
    import cv2

    config = replace(model.config, width_px=width, height_px=height)
    shrinks = width <= image.shape[1] and height <= image.shape[0]
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return ColorModel(config, model.weights, model.cone_deg), cv2.resize(
        image, (width, height), interpolation=how
    )


def profile_digest(profile: SensorProfile) -> str:
    """SHA-256 of all that a profile says, but for the dates of its blocks."""
    from taccel_lab.files.file_cache import content_key
    from taccel_lab.profile.sensor_profile import ARRAY_FIELDS

    blocks = {key: block.model_dump(mode="json") for key, block in profile.blocks().items()}
    for block in blocks.values():
        del block["provenance"]["created"]
    arrays: dict[str, np.ndarray] = {}
    for key in ARRAY_FIELDS:
        value = getattr(profile, ARRAY_FIELDS[key])
        if isinstance(value, TetMesh):
            for name in ("nodes_m", "tets", "tet_layers", "faces", "face_regions"):
                arrays[f"{key}.{name}"] = getattr(value, name)
        elif isinstance(value, np.ndarray):
            arrays[key] = value
        elif value is not None:
            arrays |= {f"{key}.{name}": array for name, array in value.items()}
    views = {name: profile_digest(profile.seen_by(name)) for name in profile.views}
    return content_key({"blocks": blocks, **arrays, **({"views": views} if views else {})})
