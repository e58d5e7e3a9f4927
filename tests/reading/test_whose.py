# SPDX-License-Identifier: Apache-2.0
"""Whose gel an image shows: that of its background, or another one of the same kind."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.reading.frame_judge import FrameJudge
from tests.support.real_data import real_data

MINIS = {
    "cubes": "gsmini_cube_edges/background.png",
    "gs_sdk": "gsmini_gs_sdk/examples/data/background.png",
    "normalflow": "gsmini_normalflow/examples/data/background.png",  # The gel of gs_sdk.
    "maniskill": "backgrounds_misc/maniskill_vitac_gsmini_bg.png",
    "tacsl": "backgrounds_misc/tacsl_gs_mini_data_bg.jpg",
    "marked": "gsmini_markers_video/0000.png",
}
"""Untouched GelSight Minis."""
HEIGHT, WIDTH = 240, 320


def gel(unit: int, grain: float = 1.5) -> np.ndarray:
    """Levels of an untouched gel: lamps with a field of their own, dust and grain."""
    rng = np.random.default_rng(unit)
    v, u = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    tilt = rng.normal(0, 4.0, (3, 4))
    shapes = np.stack([u * v, u**2 - 0.3, np.sin(3 * u + unit), np.cos(2 * v - unit)])
    field = 100.0 + 20.0 * u[..., None] + np.einsum("ck,khw->hwc", tilt, shapes)
    fine = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 1.2)
    return field + grain * (fine / fine.std())[..., None]


def seen(levels: np.ndarray, noise: float = 1.0, seed: int = 100) -> np.ndarray:
    """What a camera makes of levels."""
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(levels + rng.normal(0, noise, levels.shape)), 0, 255).astype(np.uint8)


def press(levels: np.ndarray, strength: float = 60.0) -> np.ndarray:
    """Levels with a contact over a fifth of the view, and gel that sinks all around it."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    right, down = (u - 140) / 60.0, (v - 110) / 60.0
    near = np.hypot(right, down)
    slope = np.where(near < 1, near, np.exp(-(near - 1) / 0.5))
    lean = slope * right / np.maximum(near, 1e-6), slope * down / np.maximum(near, 1e-6)
    return levels + strength * np.stack([lean[0], -lean[0], lean[1]], axis=-1)


def why(background: np.ndarray, image: np.ndarray) -> str:
    """What a judge of this untouched image says of an image."""
    frame = FrameJudge(background.astype(np.float32)).frame(image)
    return frame.fault() or frame.foreign(frame.pressed)


@pytest.mark.parametrize("touched", [False, True])
def test_another_gel_in_much_the_same_light_is_told_by_its_pattern(touched: bool) -> None:
    """Its lamps differ by a few levels, as those of two units do."""
    own, other = gel(1), gel(2)
    image = press(own) if touched else own
    assert why(seen(own), seen(image, seed=7)) == ""
    assert "another gel" in why(seen(other), seen(image, seed=7))


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(
            lambda x: np.pad(x, ((1, 0), (1, 0), (0, 0)), "edge")[:-1, :-1], id="moved by a pixel"
        ),
        pytest.param(lambda x: 1.1 * x + 5.0, id="brighter"),
        pytest.param(lambda x: cv2.GaussianBlur(x, (0, 0), 1.5), id="out of focus"),
        pytest.param(lambda x: 255.0 * (x / 255.0) ** 0.9, id="another tone curve"),
    ],
)
def test_a_gel_stays_itself(change) -> None:
    """Pressed so that the light explains little of it, and seen by a camera that has changed."""
    own = gel(3)
    image = seen(change(press(own, 90.0)), seed=8)
    assert FrameJudge(seen(own).astype(np.float32)).frame(image).still.noise_levels > 1.5
    assert why(seen(own), image) == ""


def test_a_gel_without_a_pattern_is_nobodys() -> None:
    """A render, whose only grain is the camera's noise: nothing is said of whose it is."""
    own, other = gel(1, grain=0.0), gel(2, grain=0.0)
    assert why(seen(own), seen(press(own), seed=9)) == ""
    assert why(seen(other), seen(press(own), seed=9)) == ""


def test_noise_that_hides_a_pattern_is_no_other_gel() -> None:
    """A dark or a fast camera."""
    own = gel(4, grain=0.8)
    image = seen(press(own, 90.0), noise=6.0, seed=10)
    assert "another gel" not in why(seen(own), image)


@pytest.mark.thorough
def test_no_untouched_mini_reads_a_force_on_another_ones_background() -> None:
    """All pairs of six: refused, or 0 N in the interval; two images are of one gel."""
    images = {
        name: cv2.resize(read_image(real_data(path)), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        for name, path in MINIS.items()
    }
    sensor, refused = tl.load_sensor("gelsight_mini"), 0
    for background, image in itertools.permutations(MINIS, 2):
        try:
            found = tl.read(sensor, images[image], background=images[background])
        except InputError:
            refused += 1
            assert {background, image} != {"gs_sdk", "normalflow"}
            continue
        assert found.force_interval_n is not None
        assert found.force_interval_n[0] == 0.0, (background, image)
    assert refused >= 26


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("background", "presses"),
    [
        pytest.param(
            "fots_calib/assets/gel/gelsight_bg.png",
            "fots_calib/mlp_calib/gelsight/*.png",
            id="fots",
        ),
        pytest.param(
            "fots_calib/assets/gel/digit_bg.png", "fots_calib/mlp_calib/digit/*.png", id="digit"
        ),
        pytest.param(
            "gelsight_rvsathu_sim2real/background_real.png",
            "gelsight_rvsathu_sim2real/calib_*.png",
            id="rvsathu",
        ),
        pytest.param(
            "gsmini_cube_edges/background.png", "gsmini_cube_edges/*/gelsight.png", id="cubes"
        ),
        pytest.param(
            "gelslim_mcubelab/updated_calib/ref.jpg",
            "gelslim_mcubelab/updated_calib/sample_*.jpg",
            id="gelslim",
        ),
    ],
)
def test_presses_of_real_gels_are_their_own(background: str, presses: str) -> None:
    """As their cameras gave them."""
    judge = FrameJudge(read_image(real_data(background)).astype(np.float32))
    files = sorted(real_data(presses.split("/")[0]).glob(presses.split("/", 1)[1]))
    assert len(files) > 10
    for path in files:
        frame = judge.frame(read_image(path))
        assert "another gel" not in frame.foreign(frame.pressed), path.name
