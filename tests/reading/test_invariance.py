# SPDX-License-Identifier: Apache-2.0
"""What must not change a reading: place, turn, order, company, a mask of all; and nothing to read.

Networks of colour sensors know where in the image they look, since lamps light each place in their
own way: of a frame and its background that are both moved physics promises the depth within its
error. Depths of a grey sensor follow each pixel's own drop: they move and turn along.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.errors import InputError
from tests.reading.test_faded_light import ball as under_ball
from tests.reading.test_faded_light import levels, pressed, spot, still
from tests.reading.test_grey import noisy
from tests.support.pressed_mini import PressedMini, ball


@cache
def grey() -> tuple[np.ndarray, np.ndarray]:
    """An untouched 9DTact, and pressed by a ball beside its middle."""
    touched, _ = pressed(lambda x, y: under_ball(4.0)(x - 1.5, y + 1.0), 0.5)
    return levels(noisy(still(), 0.3)), touched


@cache
def colour() -> tuple[np.ndarray, np.ndarray]:
    """An untouched Mini, and pressed by a ball."""
    mini = PressedMini()
    return mini.seen(mini.still), mini.seen(mini.pressed(ball(4.0, 0.3))[0])


SENSORS = {"9dtact": grey, "gelsight_mini": colour}
TURNED, MIRRORED = np.s_[::-1, ::-1], np.s_[:, ::-1]


def test_a_grey_press_turns_along() -> None:
    """Either way the background is not the profile's own, as whose light that would be known."""
    turned, mirrored = (
        tl.read("9dtact", np.ascontiguousarray(image[way]), background=rest[way])
        for way in (TURNED, MIRRORED)
        for rest, image in (grey(),)
    )
    np.testing.assert_allclose(turned.depth_m, mirrored.depth_m[::-1], atol=1e-6)
    assert turned.force_n == pytest.approx(mirrored.force_n, rel=1e-3)
    assert turned.force_interval_n == pytest.approx(mirrored.force_interval_n, rel=0.02)


@pytest.mark.parametrize(("right", "down"), [(7, 0), (-16, 11)])
def test_a_grey_press_moves_along(right: int, down: int) -> None:
    rest, image = grey()
    there, moved = (
        tl.read("9dtact", np.roll(image, by, (0, 1)), background=np.roll(rest, by, (0, 1)))
        for by in ((0, 0), (down, right))
    )
    assert moved.depth_mm == pytest.approx(there.depth_mm, abs=0.01)
    assert moved.force_n == pytest.approx(there.force_n, rel=0.02)
    assert moved.area_mm2 == pytest.approx(there.area_mm2, rel=0.02)
    assert there.center_mm is not None and moved.center_mm is not None
    grid = there.grid
    by_mm = right * grid.mm_per_px_x, down * grid.mm_per_px_y
    assert np.subtract(moved.center_mm, there.center_mm) == pytest.approx(by_mm, abs=0.02)


@pytest.mark.parametrize(("right", "down"), [(7, 0), (-16, 11)])
def test_a_colour_press_moves_along_within_its_error(right: int, down: int) -> None:
    rest, image = colour()
    there, moved = (
        tl.read("gelsight_mini", np.roll(image, by, (0, 1)), background=np.roll(rest, by, (0, 1)))
        for by in ((0, 0), (down, right))
    )
    assert there.depth_error_mm is not None
    assert moved.depth_mm == pytest.approx(there.depth_mm, abs=0.5 * there.depth_error_mm)
    assert moved.force_n == pytest.approx(there.force_n, rel=0.1)
    assert there.center_mm is not None and moved.center_mm is not None
    by_mm = right * there.grid.mm_per_px_x, down * there.grid.mm_per_px_y
    assert np.subtract(moved.center_mm, there.center_mm) == pytest.approx(by_mm, abs=0.1)


@pytest.mark.parametrize("name", SENSORS)
def test_order_company_and_kind_of_array_change_nothing(name: str) -> None:
    rest, image = SENSORS[name]()
    dark = levels(spot(rest.astype(float), 0.06, (0.3, -0.2), 0.5))
    frames, reader = [image, rest, dark], tl.Reader(name, background=rest)
    alone = [tl.Reader(name, background=rest)(frame) for frame in frames]
    others = (
        reader(frames),
        reader(frames[::-1])[::-1],
        list(reader.stream(frames)),
        reader(np.stack(frames).astype(np.float32)),
    )
    for found in others:
        for one, other in zip(alone, found, strict=True):
            assert np.array_equal(one.depth_m, other.depth_m)
            assert one.height_sigma_m is not None and other.height_sigma_m is not None
            assert np.array_equal(one.height_sigma_m, other.height_sigma_m)
            assert one.force_interval_n == other.force_interval_n and one.notes == other.notes


@pytest.mark.parametrize("name", SENSORS)
def test_a_mask_of_all_pixels_is_none(name: str) -> None:
    """Before, heights were solved another way, and differed in their last digits."""
    rest, image = SENSORS[name]()
    alone = tl.Reader(name, background=rest)(image)
    masked = tl.Reader(name, background=rest, mask=np.ones(rest.shape[:2], bool))(image)
    assert np.array_equal(alone.depth_m, masked.depth_m)
    assert alone.force_interval_n == masked.force_interval_n


@pytest.mark.parametrize("name", SENSORS)
def test_nothing_is_nothing(name: str) -> None:
    rest, _ = SENSORS[name]()
    found = tl.read(name, rest, background=rest)
    assert not found.touch.any and found.center_mm is None
    assert found.depth_mm == found.force_n == found.area_mm2 == 0.0
    assert not found.pressure_pa.any() and found.force_interval_n is not None
    assert found.force_interval_n[0] == 0.0 and found.force_interval_n[1] < 0.2


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize(
    ("level", "why"), [(0, "of one colour"), (255, "of one colour"), (np.nan, "NaN or infinite")]
)
def test_a_picture_of_nothing_is_refused(name: str, level: float, why: str) -> None:
    """Before, NaN was said of slopes, after three warnings."""
    rest, _ = SENSORS[name]()
    reader = tl.Reader(name, background=rest)
    picture = np.full(rest.shape, level)
    with pytest.raises(InputError, match=why):
        reader(picture if np.isnan(level) else picture.astype(np.uint8))


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("level", [0, 255])
def test_a_background_of_nothing_is_refused(name: str, level: int) -> None:
    rest, _ = SENSORS[name]()
    with pytest.raises(InputError, match="black or white all over"):
        tl.Reader(name, background=np.full_like(rest, level))
