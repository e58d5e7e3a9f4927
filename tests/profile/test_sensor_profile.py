# SPDX-License-Identifier: Apache-2.0
"""Sensor profiles: blocks, their bounds, and quarter turns of the image."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import cv2
import numpy as np
import pydantic
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.profile import (
    BackgroundBlock,
    ColorBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
)
from taccel_lab.profile import optional_blocks as blocks
from taccel_lab.profile.optical_design import Coating, DesignedCamera, Light, MarkerGrid, Window
from taccel_lab.profile.quarter_turn import quarter_turned
from taccel_lab.profile.sensor_view import OPTIONAL_BLOCKS
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.sample_blocks import ASSUMED
from tests.support.sensor_refusals import refuses

SAID: dict[str, Any] = {"kind": "assumed", "method": "m", "source": "s"}


@pytest.fixture
def flat(full_profile: SensorProfile) -> SensorProfile:
    """A block of 3 x 3 x 1 mm."""
    mesh = block_mesh((2, 2, 2), (3e-3, 3e-3, 1e-3))
    gel = full_profile.gel.replace(
        thickness_mm=1.0, node_count=mesh.node_count, tet_count=mesh.tet_count
    )
    return dataclasses.replace(full_profile, gel=gel, mesh=mesh)


def with_mesh(profile: SensorProfile, **changes: Any) -> SensorProfile:
    return dataclasses.replace(profile, mesh=dataclasses.replace(profile.mesh, **changes))


def test_blocks_are_frozen_replaced_in_a_copy_and_checked(full_profile: SensorProfile) -> None:
    block = full_profile.material
    with pytest.raises(pydantic.ValidationError, match="frozen"):
        block.poisson_ratio = 0.4  # type: ignore[misc]
    with pytest.raises(InputError, match="poisson_ratio"):
        block.replace(poisson_ratio=0.5)
    with pytest.raises(InputError, match=r"material\.provenance\.inputs\.a\.png"):
        block.replace(provenance={**SAID, "inputs": {"a.png": "123"}})
    changed = full_profile.with_block(block.replace(poisson_ratio=0.3))
    assert changed.material.poisson_ratio == 0.3
    assert full_profile.material is block and block.poisson_ratio == 0.48
    assert changed.mesh is full_profile.mesh


test_numbers_have_bounds = refuses(
    lambda profile, key, field, value: profile.blocks()[key].replace(**{field: value}),
    ("optics", "crop_x", 1.1, r"crop_x"),
    ("optics", "crop_x", 0.005, r"crop_x"),
    ("material", "young_modulus_pa", 1e9, r"young_modulus_pa"),
    ("material", "friction_coefficient", 5.1, r"friction_coefficient"),
    ("material", "density_kg_m3", 99, r"density_kg_m3"),
    ("window", "thickness_mm", 0.0, r"thickness_mm"),
    given="full_profile",
)


def test_without_removes_block_and_arrays(full_profile: SensorProfile) -> None:
    bare = full_profile.without("background", "color")
    assert bare.background_rgb is None
    assert bare.color_weights is None
    assert "color" not in bare.blocks() and "lights" in bare.blocks()
    required = full_profile.without(*OPTIONAL_BLOCKS)
    assert list(required.blocks()) == ["sensor", "gel", "material", "camera"]
    with pytest.raises(InputError, match="cannot lack 'gel'"):
        full_profile.without("gel")
    # Another camera needs another background.
    wider = full_profile.camera.replace(width_px=20)
    with pytest.raises(InputError, match="camera block asks for"):
        full_profile.with_block(wider)
    background = BackgroundBlock(provenance=wider.provenance)
    image = np.zeros((9, 20, 3), np.float32)
    assert bare.with_block(wider).with_block(background, image).grid().width_px == 20


def test_arrays_are_read_only_copies(full_profile: SensorProfile) -> None:
    assert full_profile.background is not None
    image = np.zeros((9, 12, 3), np.uint8)
    profile = full_profile.with_block(full_profile.background, image)
    image[0, 0, 0] = 9
    assert profile.background_rgb is not None
    assert profile.background_rgb[0, 0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        profile.background_rgb[0, 0, 0] = 1
    assert profile.color_weights is not None
    with pytest.raises(TypeError):
        profile.color_weights["new"] = image  # type: ignore[index]
    for lacking in ("background", "color_weights"):
        with pytest.raises(InputError, match="one is missing"):
            dataclasses.replace(full_profile, **{lacking: None})


ONE_NAN = np.zeros((9, 12, 3), np.float32)
ONE_NAN[8, 11, 2] = np.nan
test_arrays_are_checked = refuses(
    lambda profile, key, arrays: profile.with_block(profile.blocks()[key], arrays),
    ("background", None, "needs its background_rgb"),
    ("material", np.zeros(3), "takes no arrays"),
    ("background", np.zeros((12, 9, 3), np.uint8), r"shape \[12, 9, 3\].*\[9, 12, 3\]"),
    ("background", np.zeros((9, 12), np.uint8), "shape"),
    ("background", np.zeros((9, 12, 3)), "uint8 or float32"),
    ("background", ONE_NAN, "NaN"),
    ("background", np.full((9, 12, 3), -1, np.float32), "0..255"),
    ("background", np.full((9, 12, 3), 256, np.float32), "0..255"),
    ("color", {}, "no weights"),
    ("color", {"w": np.array([1.0, np.inf], np.float32)}, "'w' holds NaN or infinite"),
    ("color", {"w": np.array([1, 2])}, "'w' must be float32 or float64"),
    given="full_profile",
)


WIDE = r"the mesh is \S+ mm large; up to 1000 mm are allowed"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1e3, "has 1000 mm of gel under its apex, gel.thickness_mm says 1 mm.* 1,000 times too "
              "large: its coordinates look like millimetres, where metres belong"),
        (1e6, "1,000,000 times too large: its coordinates look like micrometres"),
        (1 / 25.4e-3, "39 times too large: its coordinates look like inches"),
        (1e-3, "1,000 times too small: its coordinates look like metres that were taken for milli"),
        (1e-6, "1,000,000 times too small"),
        (0.8, r"has 0\.8 mm of gel under its apex, .* must agree within 10%$"),
        (1.2, r"has 1\.2 mm"),
        ([334, 1, 1], WIDE),
        ([1e150, 1, 1], WIDE),
        ([1e300, 1, 1], WIDE),
    ],
)  # fmt: skip
def test_mesh_must_have_the_size_of_its_block(factor: Any, words: str, flat: SensorProfile) -> None:
    with pytest.raises(InputError, match=words):
        with_mesh(flat, nodes_m=flat.mesh.nodes_m * factor)


@pytest.mark.parametrize("thickness_mm", [0.95, 1.5, 2.0])
def test_a_dome_may_reach_below_its_thickness(thickness_mm: float, flat: SensorProfile) -> None:
    nodes = flat.mesh.nodes_m.copy()
    # The deepest node of the side goes down by another millimetre.
    nodes[0, 2] -= 1e-3
    z = nodes[flat.mesh.faces][..., 2]
    contact, bond = (z == 0).all(axis=1), (z == -1e-3).all(axis=1)
    regions = np.select([contact, bond], [Region.CONTACT, Region.BOND], Region.SIDE)
    mesh = dataclasses.replace(flat.mesh, nodes_m=nodes, face_regions=regions)
    gel = flat.gel.replace(thickness_mm=thickness_mm)
    assert dataclasses.replace(flat, gel=gel, mesh=mesh).mesh is mesh


@pytest.mark.parametrize(
    ("region", "name"), [(Region.CONTACT, "contact"), (Region.BOND, "bond or window")]
)
def test_a_gel_is_touched_and_glued(region: Region, name: str, flat: SensorProfile) -> None:
    regions = np.where(flat.mesh.face_regions == region, Region.SIDE, flat.mesh.face_regions)
    with pytest.raises(InputError, match=f"the mesh has no {name} faces"):
        with_mesh(flat, face_regions=regions)


def test_blocks_give_back_the_optical_design(full_profile: SensorProfile) -> None:
    design = full_profile.optical_design()
    assert design is not None and full_profile.optics is not None
    assert design.camera.position_mm == (0.0, 0.5, -12.0)
    assert design.camera.distortion == (-0.1, 0.02, 0.0, 0.001)
    assert [light.name for light in design.lights] == ["red", ""]
    assert design.window is not None and design.window.thickness_mm == 2.0
    assert design.coating.albedo_rgb == (0.5, 0.4, 0.5)
    assert design.ambient_rgb == (0.1, 0.1, 0.2)
    provenance = full_profile.optics.provenance
    again = blocks.OpticsBlock.from_design(design, provenance, raw_px=(640, 480), crop=(0.7, 1.0))
    assert again == full_profile.optics
    without_window = full_profile.without("window").optical_design()
    assert without_window is not None and without_window.window is None
    for key in ("optics", "lights", "coating"):
        assert full_profile.without(key).optical_design() is None


@pytest.mark.parametrize(
    ("block", "described"),
    [
        (blocks.OpticsBlock, DesignedCamera),
        (blocks.WindowBlock, Window),
        (blocks.CoatingBlock, Coating),
        (blocks.LightEntry, Light),
        (blocks.MarkersBlock, MarkerGrid),
    ],
)
def test_blocks_hold_all_that_is_described(block: Any, described: Any) -> None:
    for field in dataclasses.fields(described):
        held = block.model_fields[field.name]
        if field.default is not dataclasses.MISSING and not held.is_required():
            assert held.default == field.default


def test_the_untouched_image_is_given_or_the_profiles(full_profile: SensorProfile) -> None:
    own = full_profile.untouched()
    assert own is full_profile.background_rgb
    given = np.zeros_like(own)
    assert np.array_equal(full_profile.untouched(given), given)
    with pytest.raises(InputError, match=r"rest\.png is .* give images of that size"):
        full_profile.untouched(given[:, :-1], "rest.png")
    with pytest.raises(InputError, match="no background; give an image"):
        full_profile.without("background").untouched()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": "calibrated"}, "must name its inputs"),
        ({"valid_region": {"depth_mm": (2.0, 1.0)}}, r"depth_mm: 2.0 > 1.0"),
        ({"created": datetime(2026, 1, 1, tzinfo=timezone(timedelta(hours=2)))}, "UTC"),
    ],
)
def test_evidence_is_complete(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(pydantic.ValidationError, match=words):
        Provenance(**{**SAID, **changes})
    stamp = Provenance(**SAID).created
    assert stamp.tzinfo is UTC
    assert abs(datetime.now(UTC) - stamp) < timedelta(minutes=1)


def test_configuration_values_keep_their_types() -> None:
    values = {"count": 2, "scale": 2.0, "flag": True, "word": "2", "mixed": [1, 2.5, "x", False]}
    block = SensorBlock(name="n", family="f", parameters=values, provenance=ASSUMED)
    assert [type(value) for value in block.parameters.values()] == [int, float, bool, str, list]
    mixed: Any = block.parameters["mixed"]
    assert [type(value) for value in mixed] == [int, float, str, bool]
    with pytest.raises(InputError, match=r"color\.architecture"):
        ColorBlock(architecture={"layer": {"width": 3}}, provenance=ASSUMED)  # type: ignore[dict-item]


def turned_xyz(points: Any) -> np.ndarray:
    """Gel points after the turn: right becomes down."""
    x, y, z = np.moveaxis(np.asarray(points), -1, 0)
    return np.stack([-y, x, z], axis=-1)


def pixels_of(profile: SensorProfile, points_mm: np.ndarray) -> np.ndarray:
    """By OpenCV."""
    assert profile.optics is not None
    camera = profile.optics.camera()
    rotation = camera.gel_from_camera().T
    matrix = [[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]]
    moved = -rotation @ np.array(camera.position_mm)
    found, _ = cv2.projectPoints(
        points_mm, cv2.Rodrigues(rotation)[0], moved, np.array(matrix), np.array(camera.distortion)
    )
    return found[:, 0]


def turned_px(pixels: np.ndarray, height_px: int) -> np.ndarray:
    return np.stack([height_px - 1 - pixels[:, 1], pixels[:, 0]], axis=1)


def test_the_picture_and_every_part_turn() -> None:
    """Of a Mini with everything off centre, and a lens with tangential distortion."""
    profile = catalogue_profile("gelsight_mini")
    assert profile.optics is not None
    profile = profile.with_block(
        profile.camera.replace(mm_per_px_y=1.1 * profile.camera.mm_per_px_x)
    ).with_block(
        profile.optics.replace(
            crop_x=0.9, crop_y=0.8, fy_px=300.0, cx_px=150.0, cy_px=125.0,
            distortion=(0.05, -0.02, 0.004, -0.007, 0.01), position_mm=(0.7, -0.4, -24.0),
            rotation=(0.02, -0.03, 0.05, float(np.sqrt(1 - 0.0038))),
            raw_width_px=3280, raw_height_px=2464,
        )
    )  # fmt: skip
    after = quarter_turned(profile)
    assert profile.optics is not None and after.optics is not None
    points = np.random.default_rng(0).uniform(-6, 6, (20, 3)) * (1, 1, 0.1)
    wanted = turned_px(pixels_of(profile, points), profile.optics.height_px)
    assert pixels_of(after, turned_xyz(points)) == pytest.approx(wanted, abs=1e-9)
    assert (after.optics.width_px, after.optics.height_px) == (240, 320)
    assert (after.optics.raw_width_px, after.optics.raw_height_px) == (2464, 3280)
    assert (after.optics.crop_x, after.optics.crop_y) == (0.8, 0.9)
    grid = profile.grid()
    wanted = turned_px(grid.pixel_from_gel(points[:, :2]), grid.height_px)
    found = after.grid().pixel_from_gel(turned_xyz(points)[:, :2])
    assert found == pytest.approx(wanted)

    assert after.mesh.nodes_m == pytest.approx(turned_xyz(profile.mesh.nodes_m))
    assert profile.lights is not None and after.lights is not None
    for before, led in zip(profile.lights.led, after.lights.led, strict=True):
        assert led.position_mm == pytest.approx(turned_xyz(before.position_mm))
        assert led.direction == pytest.approx(turned_xyz(before.direction))
    assert profile.markers is not None and after.markers is not None
    dots = np.pad(profile.markers.grid().points_mm(), ((0, 0), (0, 1)))
    assert after.markers.grid().points_mm() == pytest.approx(turned_xyz(dots)[:, :2])
    assert profile.housing is not None and after.housing is not None
    assert after.housing.size_mm[:2] == profile.housing.size_mm[1::-1]
    assert after.window is not None and profile.window is not None
    assert after.window.size_mm == profile.window.size_mm[::-1]
