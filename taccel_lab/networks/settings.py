# SPDX-License-Identifier: Apache-2.0
"""Settings of the small networks as a profile stores them: exact keys, right types and sizes.

Weights and settings that are each sound may still belong to different networks, or hold a factor by
mistake. So a network is asked, at places drawn over what it was fitted to, and its answers have to
be ones that exist. Without torch, which whoever draws a picture need not load.

Positional encoding brings a pixel's place as sines and cosines of rising frequency. A small network
follows its inputs smoothly; light that changes within a part of the image is out of its reach when
it is given u and v alone. B. Mildenhall et al., "NeRF: Representing Scenes as Neural Radiance
Fields for View Synthesis", ECCV 2020, eq. 4: each coordinate p in -1..1 brings sin(2^k pi p) and
cos(2^k pi p) for k = 0 .. bands - 1. Band k has 2^k periods over the image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

import numpy as np

from taccel_lab.errors import InputError

LEAST_SCALE = 9e-4
"""Least spread of an input: fits take 0.001 for what hardly varies."""
LEAST_CONE_DEG = 0.1
"""A flatter surface than that shows no light."""


@dataclass(frozen=True)
class NetworkSettings:
    """Everything besides the weights that is needed to rebuild a network."""

    model: ClassVar[str]
    """What messages call the network."""

    def to_dict(self) -> dict[str, Any]:
        """Flat dict of numbers, strings and lists, as a profile's ``architecture`` stores it."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Inverse of ``to_dict``; unknown and missing keys, and values of other types, raise
        InputError."""
        names = [one.name for one in fields(cls)]
        unknown, missing = set(values) - set(names), set(names) - set(values)
        if unknown or missing:
            raise InputError(
                f"{cls.model} settings: unknown {sorted(unknown)}, missing {sorted(missing)}; "
                f"exactly {', '.join(names)} are allowed"
            )
        kinds = get_type_hints(cls)
        try:
            return cls(**{name: _converted(values[name], kinds[name]) for name in names})
        except InputError:
            raise
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{cls.model} settings hold a value of a wrong type: {error}"
            ) from None


def _converted(value: Any, kind: Any) -> Any:
    """A value as int, float, str or bool, or a list as a tuple of these."""
    if get_origin(kind) is tuple:
        return tuple(get_args(kind)[0](entry) for entry in value)
    return kind(value)


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


QUESTIONS = 256
SHARE_PERCENT = 95
"""Share of the answers that have to exist: a network may go wild in a corner that no capture
reached."""


def forward(weights: Mapping[str, np.ndarray], inputs: np.ndarray, activation: str) -> np.ndarray:
    """Outputs [..., n, outputs] of the layers ``layer<i>.weight`` [..., outputs, inputs] and
    ``layer<i>.bias`` for ``inputs`` [n, inputs]; ``activation``: silu, tanh or relu."""
    values = np.asarray(inputs, dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        for i in range(len(weights) // 2):
            if i:
                values = ACTIVATIONS[activation](values)
            weight, bias = (weights[f"layer{i}.{name}"] for name in ("weight", "bias"))
            values = values @ np.swapaxes(weight, -1, -2) + bias[..., None, :]
    return values


def require_answers(
    what: str, sizes: np.ndarray, least: float, most: float, unit: str, limit: str
) -> None:
    """Refuse a network most of whose answers do not exist, or are next to none. None at all is an
    answer: of a sensor that shows its dots and nothing else.

    Args:
        what: The network, to begin a sentence with.
        sizes: How large its answers are, [n].
        least: What the larger of them reach at least.
        most: The largest that exists.
        unit: Of all.
        limit: What has no larger ones, for "but ...".
    """
    finite = np.where(np.isfinite(sizes), sizes, np.inf)
    size = float(np.percentile(finite, SHARE_PERCENT, method="lower"))
    if size and not least <= size <= most:
        shown = limit if size > most else f"any touch shows {least:g} and more"
        raise InputError(
            f"{what} answers up to {size:.3g} {unit}, but {shown}: its weights or its settings "
            "are those of another network, or scaled"
        )


ACTIVATIONS = {
    "silu": lambda x: x / (1 + np.exp(-x)),
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}


MAX_BANDS = 8
"""128 periods over the image: no light changes within fewer pixels than that leaves."""


def band_names(bands: int) -> tuple[str, ...]:
    """Names of the features in order: sines of u and v, cosines of u and v, band by band."""
    return tuple(f"{wave}_{p}_{k}" for k in range(bands) for wave in ("sin", "cos") for p in "uv")


def encode_position(uv: np.ndarray, bands: int) -> np.ndarray:
    """Sines and cosines of places (u, v) in -1..1, shape [..., 2] to [..., 4 * bands]."""
    angles = [(2.0**k * np.pi) * uv for k in range(bands)]
    parts = [wave(angle) for angle in angles for wave in (np.sin, np.cos)]
    return np.concatenate(parts, axis=-1) if parts else np.empty((*np.shape(uv)[:-1], 0))
