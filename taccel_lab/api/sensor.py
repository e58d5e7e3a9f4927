# SPDX-License-Identifier: Apache-2.0
"""A sensor as a script holds it: its profile, which presses, reads and renders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from taccel_lab.api.press import press
from taccel_lab.api.read import Method, Reader, read
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile, save_profile
from taccel_lab.sensors.any_sensor import AnySensor, changed_profile, reading_profile_of
from taccel_lab.sensors.registry import sensor_families
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from taccel_lab.api.read import Image
    from taccel_lab.geometry import TetMesh
    from taccel_lab.reading.reading import Reading


class Sensor(SensorProfile):
    """A profile with the verbs of the package: ``sensor.press(...)`` is ``press(sensor, ...)``."""

    @classmethod
    def of(cls, profile: SensorProfile) -> Self:
        """Return the same sensor with the verbs."""
        if isinstance(profile, cls):
            return profile
        return cls(**{field.name: getattr(profile, field.name) for field in fields(profile)})

    press = press
    read = read

    def reader(
        self,
        *,
        background: Image | None = None,
        mask: np.ndarray | None = None,
        method: Method = "auto",
        device: str = "cpu",
    ) -> Reader:
        """Make a reader that is kept; arguments and errors as of ``Reader``."""
        return Reader(self, background=background, mask=mask, method=method, device=device)

    def depth(
        self, image: Image | Sequence[Image], *, background: Image | None = None
    ) -> np.ndarray:
        """Read how far the gel lies below where it rests [m], positive in a dent.

        Args:
            image: One or several, as of ``read``.
            background: The untouched sensor, as of ``read``.

        Returns:
            Shape [height_px, width_px], or [image, height_px, width_px] of several.

        Raises:
            InputError: As of ``read``.
        """
        found: Reading | list[Reading] = self.read(image, background=background)
        if isinstance(found, list):
            return np.stack([each.depth_m for each in found])
        return found.depth_m

    def render(self, height_m: np.ndarray) -> np.ndarray:
        """Render the tactile image of a surface, without a simulation.

        Args:
            height_m: z of the contact face [m], gel frame, [height_px, width_px], such as
                ``read(...).height_m``; NaN where there is none.

        Returns:
            RGB, uint8, [height_px, width_px, 3], in the calibrated colours or grey values. Markers
            stay where they rest.

        Raises:
            InputError: A profile without them, another size, or heights that go past the gel.
        """
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.signals.height_image import image_of_heights

        start_warp()
        return image_of_heights(self, height_m)

    def meshed(self, edge_mm: float) -> TetMesh:
        """Mesh the gel anew, coarse for many environments or fine [m], gel frame.

        Args:
            edge_mm: Length of the elements' edges.

        Raises:
            InputError: A length out of bounds.
        """
        from taccel_lab.cad.mesh.gel_mesh import gel_mesh
        from taccel_lab.sensors.registry import profile_parameters

        return gel_mesh(profile_parameters(self).pad(), edge_mm)

    def save(self, folder: Path | str) -> None:
        """Write the profile; errors as of ``save_profile``."""
        save_profile(self, folder)


@typed
def load_sensor(sensor: AnySensor, /, *former: Any, **parameters: Any) -> Sensor:
    """Load a sensor.

    Args:
        sensor: Name of a sensor of the catalogue, such as ``"gelsight_mini"``; the folder of a
            profile; a file of a gel (STEP, STL, OBJ, 3MF, .msh, .vtu); a profile or a calibration.
        parameters: Design parameters other than the catalogue's, such as ``thickness_mm=3``. With a
            file of a gel those of the sensor that it is ``like``, ``edge_mm``, and the options of
            ``taccel-lab import-gel``: ``contact``, ``bond``, ``window`` and the other fields of
            ``FaceSelection``.
        former: Nothing: parameters in a dictionary, as of 0.1, are refused with the way to give
            them now.

    Raises:
        InputError: No such sensor, a damaged profile, or parameters that cannot be used.
    """
    if former:
        given = former[0] if isinstance(former[0], dict) and former[0] else {"thickness_mm": 3}
        named = ", ".join(f"{name}={value!r}" for name, value in given.items())
        shown = repr(sensor) if isinstance(sensor, (str, Path)) else "sensor"
        raise InputError(f"load_sensor takes parameters by name: load_sensor({shown}, {named})")
    found = changed_profile(sensor, parameters) if parameters else reading_profile_of(sensor)
    return Sensor.of(found)


def list_sensors() -> list[str]:
    """Return the names of the catalogue's sensors, sorted."""
    return list(sensor_families())
