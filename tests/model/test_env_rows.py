# SPDX-License-Identifier: Apache-2.0
"""Rows of environments, of arrays of any type."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.model.env_rows import copy_rows, zero_rows


@pytest.mark.parametrize("dtype", [wp.int32, wp.float64, wp.vec2i, wp.vec3d, wp.transformd])
@pytest.mark.parametrize("shape", [(3,), (3, 4)])
def test_rows_are_copied_and_cleared_where_asked(dtype: Any, shape: tuple[int, ...]) -> None:
    width = () if dtype in (wp.int32, wp.float64) else (wp.types.type_size(dtype),)
    values = np.arange(1, 1 + np.prod(shape + width)).reshape(shape + width)
    array = wp.array(values, dtype=dtype, device="cpu")
    mask = wp.array([1, 0, 1], dtype=wp.int32, device="cpu")
    copied = wp.zeros_like(array)
    copy_rows(mask, array, copied)
    zero_rows(mask, array)
    np.testing.assert_array_equal(copied.numpy()[[0, 2]], values[[0, 2]])
    np.testing.assert_array_equal(array.numpy()[1], values[1])
    assert not copied.numpy()[1].any() and not array.numpy()[[0, 2]].any()
