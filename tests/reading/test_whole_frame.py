# SPDX-License-Identifier: Apache-2.0
"""Frames that did not come whole from the camera are told from presses, on real ones."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.reading.whole_frame import BrokenFrame, broken_frame, require_whole
from taccel_lab.signals.frame_operators import lost_rows, shift, torn
from tests.calibration.drawn.faults import quantise
from tests.support.real_data import real_data

GREEN = (0.0, 135.0, 0.0)
"""Zeros of YUV."""
PRESSES = (0, 5, 17, 40)
Fault = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Of an image and the untouched gel."""


def copied(image: np.ndarray, first_row: int, end: int) -> np.ndarray:
    """Rows that repeat the one before them, as some decoders fill what is lost."""
    found = image.copy()
    found[first_row + 1 : end] = found[first_row]
    return found


def top_moved(image: np.ndarray, rows: int, px: int) -> np.ndarray:
    return np.concatenate([np.roll(image[:rows], px, axis=1), image[rows:]])


FAULTS: dict[str, tuple[Fault, tuple[str, int, int]]] = {
    "lower rows grey": (lambda i, _: lost_rows(i, 320), ("lost_rows", 320, 479)),
    "lower rows green": (lambda i, _: lost_rows(i, 431, GREEN), ("lost_rows", 431, 479)),
    "nearly all black": (lambda i, _: lost_rows(i, 40, (0, 0, 0)), ("lost_rows", 40, 479)),
    "a row of blocks": (lambda i, _: copied(i, 200, 216), ("lost_rows", 200, 215)),
    "lower rows moved": (lambda i, _: torn(i, 260, px=40), ("torn", 260, 479)),
    "upper rows moved": (lambda i, _: top_moved(i, 150, -25), ("torn", 0, 149)),
    "all moved": (lambda i, _: shift(i, 40), ("shift", 0, 479)),
}


def noisy(image: np.ndarray, seed: int = 0) -> np.ndarray:
    return quantise(image + np.random.default_rng(seed).normal(0.0, 1.2, image.shape))


def about(found: BrokenFrame | None) -> tuple[str, int, int] | None:
    return None if found is None else (found.kind, found.first, found.last)


@pytest.mark.parametrize("what", FAULTS)
def test_rows_that_are_no_picture_are_named(taxim_captures: CaptureSet, what: str) -> None:
    fault, expected = FAULTS[what]
    rest = taxim_captures.background
    images = [noisy(rest), *(taxim_captures.presses[k].image() for k in PRESSES[:2])]
    for image in images:
        assert about(broken_frame(image, rest)) is None
        assert about(broken_frame(fault(image, rest), rest)) == expected


@pytest.mark.parametrize("turns", [1, 3])
def test_a_camera_that_is_turned_has_columns_for_rows(
    taxim_captures: CaptureSet, turns: int
) -> None:
    rest, image = taxim_captures.background, taxim_captures.presses[5].image()
    for fault in (lambda i: lost_rows(i, 320), lambda i: torn(i, 260, px=40)):
        turned = np.rot90(fault(image), turns)
        found = broken_frame(turned, np.rot90(rest, turns))
        assert found is not None and found.axis == "columns"
        assert found.last - found.first == pytest.approx(190, abs=32)


def test_rows_of_the_frame_before_are_seen_where_the_contact_has_moved(
    taxim_captures: CaptureSet,
) -> None:
    rest = taxim_captures.background
    for k in PRESSES:
        press = taxim_captures.presses[k]
        assert press.circle is not None
        middle = round(press.circle.v_px)
        found = broken_frame(torn(press.image(), middle, before=noisy(rest)), rest)
        assert found is not None and found.kind == "torn"
        assert middle in (found.first, found.last + 1)
    # Nothing has moved: the image is what the camera saw, whichever frame its rows are of.
    assert broken_frame(torn(noisy(rest), 200, before=noisy(rest, 1)), rest) is None


def test_what_is_masked_is_not_judged(taxim_captures: CaptureSet) -> None:
    rest, image = taxim_captures.background, taxim_captures.presses[5].image()
    mask = np.ones(rest.shape[:2], dtype=bool)
    mask[310:] = False
    assert broken_frame(lost_rows(image, 320), rest, mask) is None
    found = broken_frame(torn(image, 120, px=40), rest, mask)
    assert found is not None and found.kind == "torn" and 120 in (found.first, found.last + 1)


def test_a_refusal_names_the_frame_its_rows_and_what_to_do(taxim_captures: CaptureSet) -> None:
    rest = taxim_captures.background
    with pytest.raises(InputError, match=r"f7.png: it is not whole: rows 320 to 479 are of"):
        require_whole(lost_rows(noisy(rest), 320), rest, name="f7.png")
    with pytest.raises(InputError, match=r"lie 40 px along them.*wrapped round; take the frame"):
        require_whole(shift(noisy(rest), -40), rest)


def test_even_gels_and_images_without_noise_are_whole() -> None:
    """Rows of a drawn gel are copies of one another where its background's are."""
    even = np.full((120, 160, 3), 90, np.uint8)
    assert broken_frame(even, even) is None
    across = np.repeat(np.linspace(40, 200, 160).astype(np.uint8)[None, :, None], 120, axis=0)
    gel = np.repeat(across, 3, axis=2)
    assert broken_frame(gel, gel) is None
    assert broken_frame(np.rot90(gel), np.rot90(gel)) is None


@pytest.mark.thorough
def test_real_presses_are_whole(taxim_captures: CaptureSet) -> None:
    """Balls, prisms, edges of a cube, dots under shear, in compressed video: eight sensors."""
    rest = taxim_captures.background
    for press in taxim_captures.presses:
        assert broken_frame(press.image(), rest) is None, press.name
    for background, presses in (
        (
            "gelsight_rvsathu_sim2real/background_real.png",
            "gelsight_rvsathu_sim2real/**/*_real.png",
        ),
        ("gsmini_cube_edges/background.png", "gsmini_cube_edges/*/gelsight.png"),
        ("gsmini_gs_sdk/examples/data/background.png", "gsmini_gs_sdk/examples/data/*.png"),
        ("gsmini_markers_video/0000.png", "gsmini_markers_video/*.png"),
        ("gelsight_osaka_photon26/cam2/0.jpg", "gelsight_osaka_photon26/cam2/*.jpg"),
    ):
        rest = read_image(real_data(background))
        root = real_data(background.split("/", 1)[0]).parent
        for path in sorted(root.glob(presses)):
            image = read_image(path)
            if image.shape == rest.shape:
                assert broken_frame(image, rest) is None, path


@pytest.mark.parametrize("quality", [30, 60])
@pytest.mark.parametrize("mini", ["gsmini_gs_sdk/examples/data", "gsmini_cube_edges"])
def test_a_coarsely_coded_image_is_whole(mini: str, quality: int) -> None:
    """A row of an encoder's blocks without any detail along columns was not lost."""
    rest = read_image(real_data(f"{mini}/background.png"))
    _, coded = cv2.imencode(".jpg", rest[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))[..., ::-1]
    assert broken_frame(image, rest) is None
    assert about(broken_frame(lost_rows(image, 160), rest)) == ("lost_rows", 160, 239)
