# SPDX-License-Identifier: Apache-2.0
"""Settings of the small networks as a profile stores them: exact keys, right types and sizes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


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


def require_camera_size(profile: SensorProfile, key: str, width_px: int, height_px: int) -> None:
    """Refuse a network of the block ``key`` that is for other images than the camera's."""
    camera = profile.camera
    if (width_px, height_px) != (camera.width_px, camera.height_px):
        raise InputError(
            f"{key}.architecture is for {width_px}x{height_px} px, the camera block says "
            f"{camera.width_px}x{camera.height_px} px; both have to agree"
        )
