# SPDX-License-Identifier: Apache-2.0
"""Grey drop to depth and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.signals.depth_response import LUMA, DepthResponse, channel_of

CURVE = DepthResponse("grey", np.array([0.0, 2.0, 20.0, 60.0]), np.array([0.0, 0.1, 0.5, 1.9]))


@given(st.lists(st.floats(0.0, 1.9), min_size=1, max_size=30))
def test_render_and_read_are_inverse(depths: list[float]) -> None:
    depth = np.array([depths])
    background = np.full((1, len(depths), 3), 160.0)
    found = CURVE.read(CURVE.render(depth, background), background)
    assert found.depth_mm == pytest.approx(depth, abs=1e-9)
    assert found.height_m == pytest.approx(-1e-3 * depth, abs=1e-12)


def test_brightening_reads_as_untouched_and_darkness_saturates() -> None:
    background = np.full((1, 3, 3), 100.0)
    image = background - np.array([-20.0, 30.0, 61.0])[None, :, None]
    found = CURVE.read(image, background)
    assert found.depth_mm[0] == pytest.approx([0.0, 0.85, 1.9])
    assert found.saturated.tolist() == [[False, False, True]]
    masked = CURVE.read(image, background, np.array([[True, False, True]]))
    assert masked.depth_mm[0] == pytest.approx([0.0, 0.0, 1.9])


def test_level_stretch_gives_its_first_drop() -> None:
    level = DepthResponse("red", np.array([0.0, 5.0, 9.0, 12.0]), np.array([0.0, 0.4, 0.4, 0.8]))
    assert level.drop_of(np.array([0.4])) == pytest.approx(5.0)
    assert level.depth_of(np.array([7.0])) == pytest.approx(0.4)


def test_the_deviation_is_the_readings_at_rest_and_the_zeros_beside_it_in_contacts() -> None:
    known = DepthResponse(
        "grey", CURVE.drop_levels, CURVE.depth_mm,
        reading_sigma_mm=0.03, zero_sigma_mm=0.4, depth_share=0.1,
    )  # fmt: skip
    background = np.full((1, 4, 3), 100.0)
    image = background - np.array([-5.0, 1.0, 2.0, 60.0])[None, :, None]
    found = known.read(image, background)
    assert found.sigma_mm is not None and found.reading_sigma_mm is not None
    parts = [(0, 0), (0.2, 0.005), (0.4, 0.01), (0.4, 0.19)]
    wanted = [np.hypot(0.03, np.hypot(*part)) for part in parts]
    assert found.sigma_mm[0] == pytest.approx(wanted)
    assert (found.reading_sigma_mm == 0.03).all()
    unknown = CURVE.read(image, background)
    assert unknown.sigma_mm is None and unknown.reading_sigma_mm is None


def test_channels() -> None:
    image = np.array([[[10.0, 20.0, 30.0]]])
    assert channel_of(image, "green")[0, 0] == 20.0
    assert channel_of(image, "grey")[0, 0] == pytest.approx(image[0, 0] @ LUMA)


def test_bad_curves_are_refused() -> None:
    with pytest.raises(InputError, match="rising"):
        DepthResponse("grey", np.array([0.0, 0.0]), np.array([0.0, 1.0]))
    with pytest.raises(InputError, match="must not fall"):
        DepthResponse("grey", np.array([0.0, 1.0]), np.array([1.0, 0.5]))
    with pytest.raises(InputError, match="one length"):
        DepthResponse("grey", np.array([0.0, 1.0]), np.array([1.0]))
    with pytest.raises(InputError, match="one size"):
        CURVE.read(np.zeros((2, 2, 3)), np.zeros((2, 3, 3)))
