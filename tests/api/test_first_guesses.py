# SPDX-License-Identifier: Apache-2.0
"""What a script tries first, without reading, works; a near miss is answered by what is meant."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import taccel_lab as tl
from taccel_lab.files.atomic_file import write_image
from taccel_lab.files.triangle_file import read_triangle_file
from taccel_lab.signals.rest_surface import rest_surface
from tests.support.small_captures import write_captures

RADIUS_MM, DEPTH_MM = 4.0, 0.4


@pytest.fixture(scope="module")
def my(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """What a script has by then: a sensor, an image of a known dent, a press, a folder."""
    folder = tmp_path_factory.mktemp("first")
    sensor = tl.load_sensor("9dtact")
    grid = sensor.grid()
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    dent_m = 1e-3 * np.maximum(DEPTH_MM - (x_mm**2 + y_mm**2) / (2 * RADIUS_MM), 0)
    rest_m = rest_surface(sensor.mesh, grid).height_m
    image, rest = sensor.render(rest_m - dent_m), sensor.background_rgb
    (folder / "shots").mkdir()
    for name, rgb in (("press_10", image), ("press_2", image), ("background", rest)):
        write_image(folder / "shots" / f"{name}.png", rgb)
    press = tl.press("flat_pad", "sphere:4", depth_mm=0.3, accuracy="fast", element="linear")
    return SimpleNamespace(
        sensor=sensor,
        dent_m=dent_m,
        rest_m=rest_m,
        image=image,
        rest=rest,
        press=press,
        reading=sensor.read(image, background=rest),
        folder=folder,
    )


def is_dent(depth_m: np.ndarray, my: SimpleNamespace) -> bool:
    """As grey levels of 8 bits tell it."""
    return bool(np.abs(depth_m - my.dent_m).max() < 0.03e-3)


def are_points(points_m: np.ndarray, height_m: np.ndarray) -> bool:
    spans_mm = 1e3 * np.nanmax(points_m, axis=(0, 1)) - 1e3 * np.nanmin(points_m, axis=(0, 1))
    return np.array_equal(points_m[..., 2], height_m, equal_nan=True) and spans_mm.min() > 0


def is_surface(saved: Any, path: Path) -> bool:
    """A file whose triangles turn as the normals of ``saved`` do."""
    saved.save_ply(path)
    points, faces = read_triangle_file(path)
    a, b, c = points[faces].swapaxes(0, 1)
    upward = np.cross(b - a, c - a)[:, 2]
    known = np.isfinite(saved.points_m).all(axis=-1)
    return len(points) == known.sum() and bool((upward > 0).all())


PROMISES: dict[str, Callable[[SimpleNamespace], bool]] = {
    "list_sensors": lambda my: {"digit", "gelsight_mini"} <= set(tl.list_sensors()),
    "load_sensor(name, thickness_mm=3)": lambda my: (
        tl.load_sensor("flat_pad", thickness_mm=3).gel.thickness_mm == 3
    ),
    "press.force_n": lambda my: my.press.force_n > 0,
    "press.travel_mm": lambda my: (
        abs(my.press.travel_mm - 0.3) < 1e-9 and abs(my.press.depth_mm - 0.3) < 0.02
    ),
    "press.area_mm2": lambda my: 0.5 < my.press.area_mm2 < 10,
    "press.points_m": lambda my: are_points(my.press.points_m, my.press.height_m),
    "press.save_ply": lambda my: is_surface(my.press, my.folder / "press.ply"),
    "reading.depth_m": lambda my: is_dent(my.reading.depth_m, my),
    "reading.normals": lambda my: my.reading.normals.shape == my.image.shape,
    "reading.force_n": lambda my: my.reading.force_n > 0,
    "reading.points_m": lambda my: are_points(my.reading.points_m, my.reading.height_m),
    "reading.save_ply": lambda my: is_surface(my.reading, my.folder / "reading.ply"),
    "sensor.depth(image)": lambda my: is_dent(my.sensor.depth(my.image, background=my.rest), my),
    "sensor.depth([image])": lambda my: (
        my.sensor.depth([my.image, my.rest], background=my.rest)[:, 100, 200].shape == (2,)
    ),
    "sensor.render(height)": lambda my: np.array_equal(my.sensor.render(my.rest_m), my.rest),
    "read(torch tensor)": lambda my: is_dent(
        my.sensor.read(torch.from_numpy(my.image).permute(2, 0, 1), background=my.rest).depth_m, my
    ),
    "read(list)": lambda my: (
        [
            reading.touch.any
            for reading in tl.read(my.sensor, [my.image, my.rest], background=my.rest)
        ]
        == [True, False]
    ),
    "read(folder)": lambda my: (
        [
            (Path(reading.name).stem, reading.touch.any)
            for reading in tl.read(my.sensor, my.folder / "shots")
        ]
        == [("background", False), ("press_2", True), ("press_10", True)]
    ),
    "load_sensor(profile)": lambda my: tl.load_sensor(my.sensor) is my.sensor,
    "sensor.save": lambda my: (
        my.sensor.save(my.folder / "profile") is None
        and repr(tl.load_sensor(my.folder / "profile")) == repr(my.sensor)
    ),
    "sensor.meshed": lambda my: (
        100 < my.sensor.meshed(edge_mm=2.5).node_count < tl.load_sensor("9dtact").mesh.node_count
    ),
    "a sensor with another block": lambda my: isinstance(my.sensor.without("force"), tl.Sensor),
}


@pytest.mark.parametrize("words", PROMISES)
def test_a_first_guess_works(my: SimpleNamespace, words: str) -> None:
    assert PROMISES[words](my)


def test_a_reading_is_saved_with_its_surface(my: SimpleNamespace) -> None:
    (reading,) = my.sensor.read([my.folder / "shots" / "press_2.png"])
    reading.save(my.folder / "reading")
    kept = {path.name for path in (my.folder / "reading").iterdir()}
    assert {f"press_2.{suffix}" for suffix in ("npz", "png", "json", "ply")} <= kept
    figures = json.loads((my.folder / "reading" / "press_2.json").read_text())
    assert figures["image"] == str(my.folder / "shots" / "press_2.png")
    assert figures["depth_mm"] == pytest.approx(DEPTH_MM, abs=0.02)


def test_depth_is_zero_within_its_interval_on_an_untouched_curved_gel() -> None:
    sensor = tl.load_sensor("gelsight_mini")
    rest = sensor.background_rgb
    noise = np.random.default_rng(0).standard_normal(rest.shape)
    again = np.clip(np.rint(1.02 * rest + 1 + noise), 0, 255).astype(np.uint8)
    reading = sensor.read(again, background=rest)
    assert np.ptp(reading.height_m) > 0.3e-3, "the gel is curved, and heights keep that"
    assert (np.abs(reading.depth_m) <= 1.96 * reading.height_sigma_m).mean() > 0.95
    assert reading.depth_interval_mm[0] == 0 == reading.force_n


NEAR = {
    "mini": (lambda: tl.load_sensor("mini"), "gelsight_mini"),
    "GelSight Mini": (lambda: tl.load_sensor("GelSight Mini"), "gelsight_mini"),
    "thickness": (lambda: tl.load_sensor("flat_pad", thickness=3), "thickness_mm"),
    "depth": (lambda: tl.press("flat_pad", depth=0.5), "depth_mm"),
    "at": (lambda: tl.press("flat_pad", depth_mm=0.5, at=(1, 0)), "at_mm"),
    "shpere": (lambda: tl.press("flat_pad", "shpere:4", depth_mm=0.5), "sphere"),
}


@pytest.mark.parametrize("word", NEAR)
def test_a_near_miss_is_answered_by_one_name(word: str) -> None:
    call, meant = NEAR[word]
    with pytest.raises(tl.InputError, match=rf"did you mean {meant}\?"):
        call()


def test_parameters_in_a_dictionary_are_answered_by_their_names() -> None:
    says = r"by name: load_sensor\('flat_pad', thickness_mm=4, width_mm=20\)"
    with pytest.raises(tl.InputError, match=says):
        tl.load_sensor("flat_pad", {"thickness_mm": 4, "width_mm": 20})


@pytest.mark.parametrize(
    ("image", "says"),
    [
        ([], "the list of images is empty"),
        (np.zeros((2, 345, 460, 3), np.uint8), "image 0 is no image of the sensor"),
        (np.zeros((345, 460), np.uint8), r"\[height, width, 3\] or \[3, height, width\]"),
        (np.full((345, 460, 3), 0.5), "levels from 0 to 1; multiply it by 255"),
        (np.zeros((345, 460, 4), np.uint8), r"image has shape \[345, 460, 4\]"),
        ([np.zeros((10, 10, 3), np.uint8)], "image 0 is 10x10"),
    ],
)
def test_what_is_no_image_is_refused(my: SimpleNamespace, image: Any, says: str) -> None:
    with pytest.raises(tl.InputError, match=says):
        tl.read(my.sensor, image, background=my.rest)


def test_a_folder_without_images_is_refused(my: SimpleNamespace, tmp_path: Path) -> None:
    with pytest.raises(tl.InputError, match="holds no images"):
        my.sensor.read(tmp_path)


@pytest.mark.parametrize(
    ("height", "says"),
    [
        (np.zeros((3, 4)), r"height_m must have shape \[345, 460\]"),
        (np.full((345, 460), -0.4), "heights are metres in the gel frame"),
    ],
)
def test_heights_that_are_none_of_the_sensor_are_refused(
    my: SimpleNamespace, height: np.ndarray, says: str
) -> None:
    with pytest.raises(tl.InputError, match=says):
        my.sensor.render(height)


def test_colours_of_a_rendered_dent_are_read_back() -> None:
    """Pixels without a surface show the background, and a bare design has no colours."""
    sensor = tl.load_sensor("gelsight_mini")
    grid = sensor.grid()
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    dent_m = 1e-3 * np.maximum(DEPTH_MM - (x_mm**2 + y_mm**2) / (2 * RADIUS_MM), 0)
    height_m = rest_surface(sensor.mesh, grid).height_m - dent_m
    height_m[:5] = np.nan
    image = sensor.render(height_m)
    assert np.array_equal(image[:4], np.rint(sensor.background_rgb[:4]))
    found = sensor.depth(image, background=sensor.background_rgb)
    assert np.abs(found - dent_m).max() < 0.05e-3
    with pytest.raises(tl.InputError, match="no color or depth_response block to render"):
        tl.load_sensor("flat_pad").render(height_m)


def test_a_calibration_of_one_block_by_its_name_has_a_sensor(tmp_path: Path) -> None:
    found = tl.calibrate(write_captures(tmp_path / "captures"), only="background")
    assert [outcome.name for outcome in found.blocks] == ["background"]
    assert isinstance(found, tl.Calibration) and isinstance(found.profile, tl.Sensor)
    assert tl.load_sensor(found) is found.profile
