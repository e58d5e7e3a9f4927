# SPDX-License-Identifier: Apache-2.0
"""Tactile images from surfaces and a colour model: the background plus each pixel's change.

``DeviceColorModel`` works on device arrays of many environments, without a copy; ``tactile_image``
gives one image as a numpy array. Colours are those of ``ColorModel.predict_pixels`` but for
rounding: FP32 on the CPU; on CUDA FP16 weights and activations in the hidden layers and an
approximate tanh, hundredths of a grey level on average, which ``tools/bench/images.py`` measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.signals.color_kernel import (
    WIDEST,
    WRITE_BYTES,
    WRITE_LEVELS,
    WRITE_OUTPUT,
    color_kernel,
    pack_network,
    vec15f,
)
from taccel_lab.signals.color_model import ColorModel

_WARP = 32
# Steps of slope and height [m] for first derivatives: many times the noise of FP16 weights, and as
# small as what they judge.
_STEPS = (5e-3, 5e-3, 1e-5)
# What the first order leaves out, at pixels so near to rest.
_CAUTION = 1.25


class DeviceColorModel:
    """A colour model whose inputs and images stay on a Warp device.

    Pixels are given as samples: slope of the height along x and y, and height [m]. Where the
    surface, at present or at rest, is missing (NaN) or is as at rest, the image is the background.
    """

    def __init__(
        self,
        model: ColorModel,
        background_rgb: np.ndarray,
        rest_samples: wp.array,
        still_levels: float = 0.0,
    ) -> None:
        """
        Args:
            model: Colour model of the sensor.
            background_rgb: Image of the untouched sensor, levels, [height_px, width_px, 3].
            rest_samples: Of the undeformed gel, vec3f, shape [height_px, width_px].
            still_levels: Pixels that would change by less [levels of 255], to first order, are
                left as at rest; zero to compute all that moved.
        """
        if not 0.0 <= still_levels < np.inf:
            raise InputError(f"still_levels must be at least 0, got {still_levels}")
        config = model.config
        shape = (config.height_px, config.width_px)
        if np.shape(background_rgb) != (*shape, 3):
            raise InputError(
                f"the background has shape {np.shape(background_rgb)}, the color model was made "
                f"for {(*shape, 3)}"
            )
        if rest_samples.shape != shape:
            raise InputError(
                f"the pixel grid has {rest_samples.shape} pixels, the color model was made for "
                f"{shape}"
            )
        if not config.hidden or max(config.hidden) > WIDEST:
            raise InputError(
                f"color model hidden layers {list(config.hidden)}: on a device there must be at "
                f"least one, each at most {WIDEST} wide"
            )
        if len(set(config.inputs)) != len(config.inputs):
            raise InputError(f"color model inputs {list(config.inputs)} hold one twice")
        device = rest_samples.device
        packed = pack_network(model)
        self._shape = shape
        self._device = device
        self._kernel = color_kernel(
            config.hidden, config.activation, encoded=config.position_bands > 0
        )
        self._weights = [
            vec15f(*packed.normalization),
            wp.array(packed.fragments, dtype=wp.uint32, device=device),
            wp.array(packed.biases, dtype=wp.float32, device=device),
            wp.array(packed.plain, dtype=wp.float32, device=device),
            wp.array(packed.place.ravel(), dtype=wp.float32, device=device),
        ]
        flat = np.asarray(background_rgb, dtype=np.float32).reshape(-1, 3)
        self._background = wp.array(flat, dtype=wp.vec3f, device=device)
        self._rest = wp.clone(rest_samples).flatten()
        self._no_bytes = wp.empty(0, dtype=wp.uint8, device=device)
        self._no_levels = wp.empty(0, dtype=wp.float32, device=device)
        self._still_levels = 0.0
        self._anchor = wp.zeros(len(flat), dtype=wp.vec3f, device=device)
        self._sensitivity = self._anchor
        # By the same arithmetic as every image, so that pixels at rest change by exactly zero.
        at_rest = rest_samples.numpy()
        self._anchor = wp.array(self._outputs(at_rest), dtype=wp.vec3f, device=device)
        if still_levels > 0.0:
            rates = np.stack(
                [self._rate(at_rest, axis, step) for axis, step in enumerate(_STEPS)], axis=-1
            )
            self._sensitivity = wp.array(_CAUTION * rates, dtype=wp.vec3f, device=device)
            self._still_levels = float(still_levels)

    def render(
        self, samples: wp.array, image: wp.array | None = None, levels: wp.array | None = None
    ) -> None:
        """Render samples (vec3f, [env, height_px, width_px]).

        Args:
            samples: Slopes and height of the deformed gel.
            image: RGB rounded to uint8, shape [env, height_px, width_px, 3]; None to leave out.
            levels: The same unrounded, float32.
        """
        mode = (WRITE_BYTES if image is not None else 0) | (
            WRITE_LEVELS if levels is not None else 0
        )
        self._launch(
            samples,
            self._no_bytes if image is None else image.flatten(),
            self._no_levels if levels is None else levels.flatten(),
            mode,
        )

    def _outputs(self, samples: np.ndarray) -> np.ndarray:
        """The network's outputs [levels] for samples of one image, shape [pixel, 3]."""
        output = wp.empty(samples.size, dtype=wp.float32, device=self._device)
        batch = wp.array(samples[None], dtype=wp.vec3f, device=self._device)
        self._launch(batch, self._no_bytes, output, WRITE_OUTPUT)
        return output.numpy().reshape(-1, 3)

    def _rate(self, at_rest: np.ndarray, axis: int, step: float) -> np.ndarray:
        """Greatest change of a colour per unit of one sample entry near rest, shape [pixel]."""
        middle = self._outputs(at_rest)
        moved = np.zeros(3, dtype=np.float32)
        moved[axis] = step
        changes = [np.abs(self._outputs(at_rest + sign * moved) - middle) for sign in (1, -1)]
        return np.maximum(*changes).max(axis=-1) / step

    def _launch(self, samples: wp.array, image: wp.array, levels: wp.array, mode: int) -> None:
        count = int(np.prod(samples.shape))
        wp.launch(
            self._kernel,
            dim=-(-count // _WARP) * _WARP,
            inputs=[
                samples.flatten(),
                self._rest,
                self._anchor,
                self._background,
                self._sensitivity,
                *self._weights,
                count,
                self._shape[1],
                self._still_levels,
                mode,
            ],
            outputs=[image, levels],
            block_dim=128,
            device=self._device,
        )


class PressedFace(Protocol):
    """Contact face of one gel, pressed and at rest, as ``PressOutcome`` and the surfaces of
    calibrations have it; NaN where it is missing."""

    @property
    def height_m(self) -> np.ndarray:
        """z of the pressed face [m], shape [height_px, width_px]."""
        ...

    @property
    def rest_height_m(self) -> np.ndarray:
        """z at rest [m], same shape."""
        ...

    @property
    def normals(self) -> np.ndarray:
        """Outward unit normals of the pressed face, shape [height_px, width_px, 3]."""
        ...

    @property
    def rest_normals(self) -> np.ndarray:
        """Outward unit normals at rest, same shape."""
        ...


def tactile_image(model: ColorModel, background_rgb: np.ndarray, face: PressedFace) -> np.ndarray:
    """The image of one pressed gel.

    Args:
        model: Colour model of the sensor.
        background_rgb: Image of the untouched sensor, levels, [height_px, width_px, 3].
        face: What the camera sees.

    Returns:
        Float32 levels 0..255, shape [height_px, width_px, 3]; the background where a surface is
        missing (NaN) or as at rest.

    Raises:
        InputError: Sizes that differ, or a network that is too wide, see ``DeviceColorModel``.
    """
    return tactile_images(model, background_rgb, [face])[0]


def tactile_images(
    model: ColorModel, background_rgb: np.ndarray, faces: Sequence[PressedFace]
) -> list[np.ndarray]:
    """``tactile_image`` of several presses of one gel: its colours at rest are found once."""
    rest = _samples(faces[0].rest_normals, np.zeros_like(faces[0].height_m))
    painter = DeviceColorModel(model, background_rgb, rest)
    levels = wp.empty((1, *rest.shape, 3), dtype=wp.float32, device="cpu")
    images = []
    for face in faces:
        pressed = _samples(face.normals, face.height_m - face.rest_height_m)
        painter.render(pressed.reshape((1, *rest.shape)), levels=levels)
        images.append(levels.numpy()[0].copy())
    return images


def _samples(normals: np.ndarray, height_m: np.ndarray) -> wp.array:
    """Samples of a surface on the host, vec3f, shape [height_px, width_px]."""
    slope = -normals[..., :2] / normals[..., 2:]
    values = np.concatenate([slope, height_m[..., None]], axis=-1)
    return wp.array(values.astype(np.float32), dtype=wp.vec3f, device="cpu")
