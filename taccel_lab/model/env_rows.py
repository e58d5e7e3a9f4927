# SPDX-License-Identifier: Apache-2.0
"""Rows of arrays [env_count, ...] copied or cleared in some environments, on the device."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.guards import require_shape
from taccel_lab.model.env_lists import EnvMask, Envs, env_at, place_count
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


_THREADS = 1 << 19
"""Threads that keep a large GPU busy."""


def lane_count(device: wp.Device, env_count: int, most: int) -> int:
    """Lanes an environment, which take its entries in turn, where one has ``most`` at most.

    So a launch depends neither on a count that the host would have to read, nor on the capacity of
    a list: it can be part of a captured graph, and lists may grow. And a thread an entry costs its
    start in environments that stand still, too. The CPU, which runs threads one after the other,
    has one lane."""
    if device.is_cpu:
        return 1
    return max(1, min(most, max(32, _THREADS // env_count)))


# What is known to be one lane, and to have its words side by side, is compiled to vectors: on the
# CPU a row takes a ninth of the time.
@wp.func_native("""
    const int count = result.shape[1];
    const auto* const from = source.data + static_cast<size_t>(env % source.shape[0]) * count;
    auto* const row = result.data + static_cast<size_t>(env) * count;
#if !defined(__CUDA_ARCH__)
    lane = 0;
    lanes = 1;
#endif
    for (int i = lane; i < count; i += lanes)
        row[i] = from[i];
""")
def _copy_row(
    env: int,
    lane: int,
    lanes: int,
    source: wp.array2d(dtype=wp.int32),
    result: wp.array2d(dtype=wp.int32),
) -> None:
    """Copy every ``lanes``-th word of a row from ``lane`` on."""
    ...


@wp.kernel
def _copy_rows_kernel(
    mask: Envs,
    lanes: int,
    source: wp.array2d(dtype=wp.int32),
    result: wp.array2d(dtype=wp.int32),
):
    place, lane = wp.tid()
    env = env_at(place, mask)
    if env >= 0:
        _copy_row(env, lane, lanes, source, result)


@wp.func_native("""
    const int count = values.shape[1];
    auto* const row = values.data + static_cast<size_t>(env) * count;
#if !defined(__CUDA_ARCH__)
    lane = 0;
    lanes = 1;
#endif
    for (int i = lane; i < count; i += lanes)
        row[i] = 0;
""")
def _zero_row(env: int, lane: int, lanes: int, values: wp.array2d(dtype=wp.int32)) -> None:
    """Clear every ``lanes``-th word of a row from ``lane`` on."""
    ...


@wp.kernel
def _zero_rows_kernel(mask: Envs, lanes: int, values: wp.array2d(dtype=wp.int32)):
    place, lane = wp.tid()
    env = env_at(place, mask)
    if env >= 0:
        _zero_row(env, lane, lanes, values)


# Words of one size whatever the type: captured on the CPU, overloads of a kernel are one.
def _as_rows(array: wp.array) -> wp.array:
    """The same memory as words of four bytes, int32, [rows, all else]."""
    words = math.prod(array.shape[1:]) * (wp.types.type_size_in_bytes(array.dtype) // 4)
    shape = (array.shape[0], words)
    return wp.array(ptr=array.ptr, dtype=wp.int32, shape=shape, device=array.device)


def copy_rows(mask: EnvMask | None, source: wp.array, result: wp.array) -> None:
    """Copy the rows of the environments in ``mask`` (int32, [env_count]) from ``source``: an array
    like ``result``, or one row for all, on the host or the device. Without a mask all of it."""
    if mask is None:
        wp.copy(result, source)
    elif result.size:
        # Held until the launch, as rows do not hold their memory.
        source = source.to(result.device)
        into = _as_rows(result)
        lanes = lane_count(result.device, place_count(mask), into.shape[1])
        launch(_copy_rows_kernel, (len(into), lanes), mask, lanes, _as_rows(source), into)


def zero_rows(mask: EnvMask, values: wp.array) -> None:
    """The values of the environments of ``mask`` (int32, [env_count]) become zero."""
    if values.size:
        rows = _as_rows(values)
        lanes = lane_count(values.device, place_count(mask), rows.shape[1])
        launch(_zero_rows_kernel, (len(rows), lanes), mask, lanes, rows)


@wp.kernel
def _as_int_kernel(mask: wp.array(dtype=wp.bool), result: wp.array(dtype=wp.int32)):
    env = wp.tid()
    result[env] = int(mask[env])


@wp.func
def chosen_env(envs: wp.array(dtype=wp.int32), row: int) -> int:
    """The environment that a row is of: the one that ``envs`` names, or its own where there is no
    list."""
    if envs.shape[0] == 0:
        return row
    return envs[row]


def chosen_numbers(who: Any, env_count: int) -> np.ndarray:
    """The environments of a mask of the host one after the other, int32.

    How many they are decides what is launched, so that a mask of the device will not do.

    Raises:
        InputError: Not bool of shape [env_count].
    """
    if on_device(who):
        raise InputError("which environments are read is said by a mask of numpy, not the device's")
    return np.flatnonzero(checked_mask(who, env_count)).astype(np.int32)


def on_device(value: Any) -> bool:
    """Whether ``value`` is a device's array, one of Warp or a torch tensor, and not the host's."""
    return hasattr(value, "__dlpack__") and not isinstance(value, np.ndarray | np.generic)


def device_array(value: Any, name: str) -> wp.array:
    """The array of Warp on the memory of a value for which ``on_device`` holds.

    Raises:
        InputError: A tensor that torch keeps a gradient of, or whose memory Warp cannot share.
    """
    if isinstance(value, wp.array):
        return value
    if getattr(value, "requires_grad", False):
        raise InputError(
            f"{name} are a tensor with requires_grad, and no gradient would come back through it: "
            "give tensor.detach(); gradients of motions are in taccel_lab.gradients"
        )
    try:
        return wp.from_dlpack(value)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(
            f"{name} on the device must be dense numbers that Warp can share: {error}"
        ) from None


def host_values(value: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Values of the host as float64 of one shape, all finite.

    Raises:
        InputError: Of another shape, or not finite.
    """
    found = np.asarray(value, dtype=np.float64)
    require_shape(name, found, shape)
    return found


def given_array(
    value: Any, name: str, shape: tuple[int, ...], dtype: Any, device: wp.Device
) -> wp.array:
    """An array of Warp of float64, vec3d or transformd on the memory of ``value``, or on a copy's
    where that has gaps or its own order, as some views of torch have.

    ``value`` has the components as its last axis. The host's is checked and stays on the host; what
    is on ``device`` already is not checked for its values: that would wait for the device.

    Raises:
        InputError: Of another shape, type or device.
    """
    width = wp.types.type_size_in_bytes(dtype) // 8
    expected = shape if width == 1 else (*shape, width)
    if not on_device(value):
        found = host_values(value, name, expected)
        return wp.array(found, dtype=dtype, shape=shape, device="cpu", copy=False)
    shared = device_array(value, name)
    if not shared.is_contiguous:
        shared = shared.contiguous()
    if shared.dtype is wp.float64 and shared.shape == expected and width > 1:
        shared = shared.view(dtype)
    if shared.shape != shape or shared.dtype is not dtype:
        also = "" if width == 1 else f", or {dtype.__name__} of shape {list(shape)}"
        raise InputError(
            f"{name} on the device are {shared.dtype.__name__} of shape {list(shared.shape)}; "
            f"expected float64 of shape {list(expected)}{also}"
        )
    if shared.device != device:
        raise InputError(f"{name} are on {shared.device}, the model is on {device}")
    return shared


def device_mask(mask: Any, env_count: int, device: wp.Device) -> wp.array:
    """A mask as kernels take it, int32, [env_count]; one that is that already is taken as it is.

    ``mask``: bool of numpy, or what is on the device, bool or int32: an array of Warp or a torch
    tensor.

    Raises:
        InputError: Of another shape, type or device.
    """
    if on_device(mask):
        found = device_array(mask, "masks")
        known = found.dtype in (wp.int32, wp.bool)
        if found.shape != (env_count,) or not known or found.device != device:
            raise InputError(
                f"a mask on the device is bool or int32 of shape [{env_count}] on {device}, got "
                f"{found.dtype.__name__} of shape {list(found.shape)} on {found.device}"
            )
        if found.dtype is wp.int32:
            return found
        result = wp.empty(env_count, dtype=wp.int32, device=device)
        launch(_as_int_kernel, env_count, found, result)
        return result
    value = checked_mask(mask, env_count)
    return wp.array(value.astype(np.int32), dtype=wp.int32, device=device)


def checked_mask(mask: Any, env_count: int) -> np.ndarray:
    """A mask of the host; InputError unless it is bool of shape [env_count]."""
    value = np.asarray(mask)
    if value.shape != (env_count,) or value.dtype != bool:
        raise InputError(
            f"a mask is bool of shape [{env_count}], got {value.dtype} of shape {list(value.shape)}"
        )
    return value
