# SPDX-License-Identifier: Apache-2.0
"""Every sensor of the catalogue becomes an assembly whose parts do not interpenetrate."""

from __future__ import annotations

import numpy as np
import pytest
from build123d import Plane

from taccel_lab.cad.assembly import require_no_overlap
from taccel_lab.cad.moulds import casting_moulds
from taccel_lab.cad.parts.pad_solid import gel_layers, labelled_solid
from taccel_lab.cad.parts.placeholders import (
    camera_location,
    led_location,
    led_names,
    led_part,
)
from taccel_lab.profile.optical_design import DesignedCamera, Light
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.sensors.workshop import sensor_parts
from tests.support.variants import variants

FAMILIES = sorted(sensor_families())


@pytest.mark.thorough
@pytest.mark.parametrize("name", variants(["digit", "digit_360", "rtac"], FAMILIES))
def test_parts_fit(name: str) -> None:
    parameters = sensor_family(name).parameters()
    pad, optics = parameters.pad(), parameters.optics()
    gel = labelled_solid(pad)
    assembly = sensor_parts(name, parameters, gel)
    clearances = assembly.clearances()
    require_no_overlap(clearances)
    touching = {(c.first, c.second) for c in clearances if c.gap_mm == 0}
    layers = [part for part in assembly.parts if part.gel]
    assert sum(part.solid.volume for part in layers) == pytest.approx(gel.volume_mm3, rel=2e-3)
    if optics is not None and optics.window is not None:
        assert (layers[0].name, "window") in touching
        assert ("window", "housing") in touching
        window = assembly.part("window").solid
        assert window.location.position.Z == pytest.approx(-pad.thickness_mm)
    else:
        assert (layers[0].name, "housing") in touching
    if optics is not None:
        camera = assembly.part("camera").solid.location.position
        assert tuple(camera) == pytest.approx(optics.camera.position_mm, abs=1e-9)
        assert sum(part.name.startswith("led_") for part in assembly.parts) == len(optics.lights)
    housing = parameters.housing()
    assert housing is not None
    box = assembly.part("housing").solid.bounding_box()
    cover = assembly.part("cover").solid.bounding_box()
    assert (box.size.X, box.size.Y) == pytest.approx(housing.size_mm[:2], abs=1e-6)
    assert box.max.Z - cover.min.Z == pytest.approx(housing.size_mm[2], abs=1e-6)
    for part in assembly.parts:
        assert part.solid.is_valid, part.name


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_gels_can_be_cast(name: str) -> None:
    pad = sensor_family(name).parameters().pad()
    gel = labelled_solid(pad)
    layers = gel_layers(pad, gel)
    found = casting_moulds(gel, layers)
    assert len(found) == len(layers)
    for mould, report in found:
        assert mould.cavity.solid.is_valid and mould.lid.solid.is_valid
        assert report.undercut_mm2 < 0.05 and report.overlap_mm3 < 1e-3


@pytest.mark.thorough
def test_two_layers_are_two_parts_that_fill_the_gel() -> None:
    parameters = sensor_family("9dtact").parameters()
    pad = parameters.pad()
    gel = labelled_solid(pad)
    layers = gel_layers(pad, gel)
    assert list(layers) == list(pad.layer_names) == ["gel", "skin"]
    volumes = [layer.volume_mm3 for layer in layers.values()]
    assert sum(volumes) == pytest.approx(gel.volume_mm3, rel=1e-6)
    names = {part.name: set(part.face_names) for part in sensor_parts("s", parameters).parts[:2]}
    assert names["gel"] == {"bond", "window", "side"}
    assert names["skin"] == {"bond", "contact", "side"}


def test_poses_turn_as_the_optics_do() -> None:
    half = np.sqrt(0.5)
    camera = DesignedCamera(
        640, 480, 500.0, 500.0, 319.5, 239.5, (1.0, 2.0, -30.0), rotation=(half, 0.0, 0.0, half)
    )
    plane, turn = Plane(camera_location(camera)), camera.gel_from_camera()
    assert tuple(plane.z_dir) == pytest.approx(tuple(turn[:, 2]))
    assert tuple(plane.x_dir) == pytest.approx(tuple(turn[:, 0]))
    assert tuple(plane.origin) == pytest.approx(camera.position_mm)
    up = Light((0.0, 0.0, -5.0), (0.0, 0.0, 1.0), (1.0, 0.5, 0.0), name="a")
    side = Light((5.0, 0.0, -5.0), (-1.0, 0.0, 0.0), (0.0, 0.2, 0.0), (3.0, 1.0), name="a")
    assert led_names((up, side)) == ["led_a", "led_a_1"]
    first, second = led_part(up), led_part(side)
    for part, size in ((first, (0.5, 0.5)), (second, (3.0, 1.0))):
        box = part.solid.bounding_box().size
        assert (box.X, box.Y) == pytest.approx(size)
    assert first.color == (1.0, 0.5, 0.0) and second.color == (0.0, 1.0, 0.0)
    # The width lies in the xy plane.
    assert Plane(led_location(side)).x_dir.Z == pytest.approx(0)
