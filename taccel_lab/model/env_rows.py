# SPDX-License-Identifier: Apache-2.0
"""Rows of arrays [env_count, ...] copied or cleared in some environments, on the device."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from taccel_lab.errors import InputError

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _copy_rows_kernel(
    mask: wp.array(dtype=wp.int32),
    source: wp.array2d(dtype=wp.float64),
    result: wp.array2d(dtype=wp.float64),
):
    env, i = wp.tid()
    if mask[env] != 0:
        result[env, i] = source[env % source.shape[0], i]


@wp.kernel
def _zero_rows_kernel(mask: wp.array(dtype=wp.int32), values: wp.array2d(dtype=wp.float64)):
    env, i = wp.tid()
    if mask[env] != 0:
        values[env, i] = wp.float64(0.0)


def _as_rows(array: wp.array) -> wp.array:
    """The same memory as float64, [rows, all else]; of arrays of float64, vectors or poses."""
    count = math.prod(array.shape[1:]) * (wp.types.type_size_in_bytes(array.dtype) // 8)
    shape = (array.shape[0], count)
    return wp.array(ptr=array.ptr, dtype=wp.float64, shape=shape, device=array.device)


def copy_rows(mask: wp.array, source: wp.array, result: wp.array) -> None:
    """Copy the rows of the environments in ``mask`` (int32, [env_count]) from ``source``: an array
    like ``result``, or one row for all."""
    if result.size:
        into = _as_rows(result)
        wp.launch(
            _copy_rows_kernel,
            dim=into.shape,
            inputs=[mask, _as_rows(source)],
            outputs=[into],
            device=result.device,
        )


def zero_rows(mask: wp.array, values: wp.array) -> None:
    """The values of the environments of ``mask`` (int32, [env_count]) become zero."""
    if values.size:
        rows = _as_rows(values)
        wp.launch(_zero_rows_kernel, dim=rows.shape, inputs=[mask, rows], device=values.device)


def device_mask(mask: np.ndarray | wp.array, env_count: int, device: wp.Device) -> wp.array:
    """A mask as kernels take it, int32, [env_count]; one that is that already is taken as it is.

    Raises:
        InputError: Of another shape, or no mask of bool.
    """
    if isinstance(mask, wp.array):
        if mask.shape != (env_count,) or mask.dtype is not wp.int32 or mask.device != device:
            raise InputError(
                f"a mask on the device is int32 of shape [{env_count}] on {device}, got "
                f"{mask.dtype.__name__} of shape {list(mask.shape)} on {mask.device}"
            )
        return mask
    value = np.asarray(mask)
    if value.shape != (env_count,) or value.dtype != bool:
        raise InputError(
            f"a mask is bool of shape [{env_count}], got {value.dtype} of shape {list(value.shape)}"
        )
    return wp.array(value.astype(np.int32), dtype=wp.int32, device=device)
