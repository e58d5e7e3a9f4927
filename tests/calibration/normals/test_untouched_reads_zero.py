# SPDX-License-Identifier: Apache-2.0
"""Gels that nothing touches read as no contact, 0 N, in light that has changed since."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.reading.reader import Reader
from taccel_lab.sensors.profile import stock_sensor
from taccel_lab.signals.frame_operators import bands, lost_rows, shift, torn, wear
from tests.calibration.drawn.faults import quantise
from tests.support.real_data import real_data

MOST_N = 0.2
"""Upper end of the interval of an untouched gel's force."""
MINIS = (
    "gsmini_gs_sdk/examples/data/background.png",
    "gsmini_normalflow/examples/data/background.png",
    "gsmini_cube_edges/background.png",
    "gsmini_markers_video/0000.png",
)


def weaker_on_one_side(image: np.ndarray, share: float) -> np.ndarray:
    """The red lamp has faded by ``share`` at the right border."""
    across = np.linspace(0.0, 1.0, image.shape[1])[None, :, None]
    return image * (1.0 - share * across * np.array([1.0, 0.0, 0.0]))


def compressed(image: np.ndarray) -> np.ndarray:
    """As a JPEG of quality 85 gives it."""
    _, coded = cv2.imencode(".jpg", np.clip(image, 0, 255).astype(np.uint8), [1, 85])
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=float)


CHANGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "itself": lambda image: image,
    "noise of 2 levels": lambda i: i + np.random.default_rng(0).normal(0.0, 2.0, i.shape),
    "JPEG": compressed,
    "3 levels brighter": lambda image: image + 3.0,
    "faded by 2 %": lambda image: 0.98 * image,
    "red lamp 3 % weaker on one side": lambda image: weaker_on_one_side(image, 0.03),
}


def mini_image(name: str) -> np.ndarray:
    """A picture at the size of the starter profile's camera, RGB uint8."""
    camera = stock_sensor("gelsight_mini").camera
    size = (camera.width_px, camera.height_px)
    return np.asarray(cv2.resize(read_image(real_data(name)), size, interpolation=cv2.INTER_AREA))


def reader_on(background: np.ndarray) -> Reader:
    return Reader(stock_sensor("gelsight_mini"), background=background)


@pytest.mark.thorough
@pytest.mark.parametrize("name", MINIS)
def test_an_untouched_mini_reads_zero_by_the_starter_profile(name: str) -> None:
    image = mini_image(name)
    reader = reader_on(image)
    for what, change in CHANGES.items():
        figures = reader.read(quantise(change(image.astype(float)))).figures()
        assert not figures["touched"] and figures["force_n"] == 0.0, what
        assert figures["depth_mm"] == 0.0 and figures["area_mm2"] == 0.0, what
        for interval, most in (
            ("force_interval_n", MOST_N),
            ("depth_interval_mm", 0.3),
            ("area_interval_mm2", 30.0),
        ):
            low, high = figures[interval]
            assert low == 0.0 and 0.0 < high <= most, (what, interval)


@pytest.mark.thorough
def test_a_marked_mini_rests_until_it_is_touched() -> None:
    """Dots are masked: 55 frames at rest, then a finger. Frame 56 shows 8 % of what frame 58 shows
    of it, 13 standard deviations of the frames before."""
    numbers = (0, 14, 28, 42, 50, 60, 80, 120)
    frames = [read_image(real_data(f"gsmini_markers_video/{n:04d}.png")) for n in numbers]
    reader = reader_on(frames[0])
    found = [reader.read(frame) for frame in frames]
    assert [reading.force_n > 0 for reading in found] == [False] * 5 + [True] * 3
    comes = reader.read(read_image(real_data("gsmini_markers_video/0056.png")))
    assert comes.touch.any and comes.depth_mm < 0.1
    for reading in found[:5]:
        assert reading.force_interval_n is not None and reading.force_interval_n[1] <= MOST_N
    depths = [1e3 * reading.depth_m.max() for reading in found[5:]]
    assert 0.3 < depths[0] < depths[1] < depths[2] < 1.5


@pytest.mark.parametrize("name", MINIS[:1])
def test_light_that_is_no_touch_reads_zero_and_is_said(name: str) -> None:
    image = mini_image(name)
    reader = reader_on(image)
    for changed, said in (
        (wear(image, 0.06, radius=0.3), "the background is old"),
        (bands(image, 0.03, 3.0), "goes up and down along the rows"),
    ):
        figures = reader.read(changed).figures()
        assert not figures["touched"] and figures["force_n"] == 0.0
        assert any(said in warning for warning in figures["warnings"])


@pytest.mark.parametrize("name", MINIS[:1])
def test_a_frame_that_is_not_whole_is_refused_with_its_rows(name: str) -> None:
    image = mini_image(name)
    reader, last = reader_on(image), len(image) - 1
    for broken, said in (
        (lost_rows(image, 160), f"rows 160 to {last} are of one colour"),
        (torn(image, 130, px=20), f"rows 130 to {last} lie 20 px along them"),
        (shift(image, 20), f"rows 0 to {last} lie 20 px along them from where they should"),
    ):
        with pytest.raises(InputError, match=f"f.png is not whole: {said}"):
            reader.read(broken, "f.png")


def test_nothing_is_read_from_a_frame_that_is_not_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks are the dear part of a reading, and would make a touch of a seam."""
    image = mini_image(MINIS[0])
    reader = reader_on(image)
    assert reader.normal_model is not None
    monkeypatch.setattr(type(reader.normal_model), "predict", None)
    with pytest.raises(InputError, match="is not whole"):
        reader.read(torn(image, 130, px=20))


def test_a_gel_that_was_put_back_elsewhere_is_refused() -> None:
    image = mini_image(MINIS[0])
    rng = np.random.default_rng(0)
    scratches = cv2.GaussianBlur(rng.normal(0.0, 12.0, image.shape[:2]), (0, 0), 1.2)[..., None]
    marked = np.clip(image + 6.0 * scratches, 0, 255).astype(np.uint8)
    reader = reader_on(marked)
    with pytest.raises(InputError, match=r"9 px to the right and .6 px down"):
        reader.read(np.roll(marked, (6, 9), (0, 1)))
    assert not reader.read(marked).touch.any
