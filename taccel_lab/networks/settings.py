# SPDX-License-Identifier: Apache-2.0
"""Settings of the small networks as a profile stores them: exact keys, right types and sizes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import numpy as np

from taccel_lab.errors import InputError

LEAST_SCALE = 9e-4
"""Least spread of an input: fits take 0.001 for what hardly varies."""
LEAST_CONE_DEG = 0.1
"""A flatter surface than that shows no light."""


def settings_dict(config: Any) -> dict[str, Any]:
    """The fields of a dataclass as a flat dict of numbers, strings and lists."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(config).items()}


@contextmanager
def reading_settings(
    model: str, fields: Iterable[str], values: Mapping[str, Any]
) -> Iterator[None]:
    """Refuse unknown and missing keys, and values whose conversion fails inside the block."""
    fields = list(fields)
    unknown, missing = set(values) - set(fields), set(fields) - set(values)
    if unknown or missing:
        raise InputError(
            f"{model} settings: unknown {sorted(unknown)}, missing {sorted(missing)}; "
            f"exactly {', '.join(fields)} are allowed"
        )
    try:
        yield
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"{model} settings hold a value of a wrong type: {error}") from None


def layer_shapes(
    sizes: Sequence[tuple[int, int]], members: tuple[int, ...] = ()
) -> dict[str, tuple[int, ...]]:
    """Name and shape of every weight of layers of ``sizes`` (outputs, inputs), with the axes
    ``members`` in front."""
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (outputs, inputs) in enumerate(sizes):
        shapes[f"layer{i}.weight"] = (*members, outputs, inputs)
        shapes[f"layer{i}.bias"] = (*members, outputs)
    return shapes


def checked_weights(
    model: str, expected: Mapping[str, tuple[int, ...]], weights: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Copies in float32; InputError unless they are finite and of the shapes that the settings of
    the network ask for."""
    found = {name: np.array(value, dtype=np.float32, order="C") for name, value in weights.items()}
    shapes = {name: value.shape for name, value in found.items()}
    wrong = sorted(n for n in {*shapes, *expected} if shapes.get(n) != expected.get(n))
    if wrong:
        raise InputError(
            f"{model} weights do not fit its settings: {', '.join(wrong[:5])} have shapes "
            f"{[shapes.get(n) for n in wrong[:5]]}, expected {[expected.get(n) for n in wrong[:5]]}"
        )
    if not all(np.isfinite(value).all() for value in found.values()):
        raise InputError(f"{model} weights hold NaN or infinite values")
    return found


def require_camera_size(key: str, size_px: tuple[int, int], camera_px: tuple[int, int]) -> None:
    """Refuse a network of the block ``key`` that is for other images than the camera's."""
    if size_px != camera_px:
        raise InputError(
            f"{key}.architecture is for {size_px[0]}x{size_px[1]} px, the camera block says "
            f"{camera_px[0]}x{camera_px[1]} px; both have to agree"
        )
