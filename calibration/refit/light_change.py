# SPDX-License-Identifier: Apache-2.0
"""How the light of a sensor has changed since its profile was made, from a few new frames.

Lamps that age, and cameras that are set up anew, change each channel c to

    frame_c = gain_c * background_c + response_c * change_c + offset_c + gradient_c(u, v),

``change`` being the colour change that the profile's model gives for the frame. Aged lamps have
response = gain; the two are fitted apart since the background may hold light that is not the
lamps'. All frames are fitted at once by least squares with Tukey's biweight, and again without
each one, weights and all, so that a frame has no part in what predicts it; from these fits the
delete-one jackknife (B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982) gives
the standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.reading.light import LightDrift, biweight, unit_position
from taccel_lab.robust_fit import spread_about_zero

FRAME_PIXELS = 12_000
"""Pixels taken of each frame, half of them in and around the contact."""
BIWEIGHT = 4.0
ITERATIONS = 8
FLAT_LEVELS = 4.0
"""Spread of a background's channel below which its gain cannot be separated from its offset."""
PRIOR_SIGMA = np.array([0.5, 1.0, 50.0, 15.0, 15.0])
"""Prior spread of gain, response, offset and the gradient's parts around no change."""
NO_CHANGE = np.array([1.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class RefitFrame:
    """One new frame and what the old profile gives for it."""

    name: str
    sha256: str
    image: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    change: np.ndarray | None
    """Colour change that the old model renders [levels], same shape; None of an untouched frame."""
    disc: np.ndarray | None
    """Contact disc, bool, shape [height_px, width_px]; None of an untouched frame."""
    near: np.ndarray | None
    """The disc and its surroundings, where the model changes the picture."""


@dataclass(frozen=True)
class LightChange:
    """Change of every channel since the profile was made."""

    light: LightDrift
    """Change of the background."""
    response: np.ndarray
    """Factor of the colour change, shape [3]."""


@dataclass(frozen=True)
class LightChangeFit:
    """The change from all frames, and from all but each."""

    change: LightChange
    left_out: tuple[LightChange, ...]
    """Changes that are fitted without frame k."""
    sigma: LightChange
    """Standard deviations by the jackknife."""


def fit_light_change(
    frames: Sequence[RefitFrame], old: np.ndarray, mask: np.ndarray | None = None
) -> LightChangeFit:
    """Fit the change of the light to new frames.

    ``old`` is the old background, RGB levels, shape [height_px, width_px, 3]; pixels where ``mask``
    is false are left out.
    """
    if len(frames) < 2:
        raise InputError(f"a refit needs at least 2 frames, got {len(frames)}")
    rng = np.random.default_rng(0)
    pixels = [_draw(frame, old, mask, rng) for frame in frames]
    pressed = any(frame.change is not None for frame in frames)
    channels = []
    for c in range(3):
        designs, wanted = [], []
        for frame, idx in zip(frames, pixels, strict=True):
            designs.append(_design(frame, old, idx, c))
            wanted.append(frame.image.reshape(-1, 3)[idx, c].astype(np.float64))
        # A channel at its end of the range says nothing.
        inside = [(w > 1) & (w < 254) for w in wanted]
        flat = bool(old[..., c][mask if mask is not None else slice(None)].std() < FLAT_LEVELS)
        channels.append(_fit_channel(designs, wanted, inside, tie=flat or not pressed))
    whole = _light([channel[0] for channel in channels])
    left_out = tuple(_light([ch[1][k] for ch in channels]) for k in range(len(frames)))
    return LightChangeFit(whole, left_out, _jackknife(left_out))


def _draw(
    frame: RefitFrame, old: np.ndarray, mask: np.ndarray | None, rng: np.random.Generator
) -> np.ndarray:
    usable = np.ones(old.shape[:2], bool) if mask is None else mask
    parts = []
    regions = [usable] if frame.near is None else [usable & frame.near, usable & ~frame.near]
    for region in regions:
        found = np.flatnonzero(region)
        parts.append(rng.permutation(found)[: FRAME_PIXELS // len(regions)])
    return np.concatenate(parts)


def _design(frame: RefitFrame, old: np.ndarray, idx: np.ndarray, c: int) -> np.ndarray:
    height, width = old.shape[:2]
    u, v = unit_position(height, width)
    change = np.zeros(len(idx)) if frame.change is None else frame.change.reshape(-1, 3)[idx, c]
    return np.column_stack(
        [
            old.reshape(-1, 3)[idx, c].astype(np.float64),
            change,
            np.ones(len(idx)),
            u[0, idx % width],
            v[idx // width, 0],
        ]
    )


def _fit_channel(
    designs: list[np.ndarray],
    wanted: list[np.ndarray],
    inside: list[np.ndarray],
    *,
    tie: bool,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Coefficients from all frames, and from all but each one.

    ``tie``: the background's gain and the response are one number. Of a flat background it is the
    response alone that tells it.
    """
    basis = np.eye(5)
    if tie:
        basis = np.delete(basis, 1, axis=1)
        basis[1, 0] = 1.0
    count = sum(map(len, wanted))
    mean_level = sum(float(d[:, 0].sum()) for d in designs) / count
    local = []
    for design in designs:
        moved = design.copy()
        moved[:, 0] -= mean_level
        local.append(moved @ basis)
    change = [w - d @ NO_CHANGE for w, d in zip(wanted, designs, strict=True)]
    prior_sigma = np.delete(PRIOR_SIGMA, 1) if tie else PRIOR_SIGMA

    def fitted(used: list[int]) -> np.ndarray:
        design, target = (np.concatenate([part[k] for k in used]) for part in (local, change))
        ok = np.concatenate([inside[k] for k in used])
        found = basis @ _biweight_fit(design, target, ok, prior_sigma)
        found[2] -= found[0] * mean_level
        return NO_CHANGE + found

    every = list(range(len(wanted)))
    return fitted(every), [fitted([k for k in every if k != left]) for left in every]


def _biweight_fit(
    design: np.ndarray, change: np.ndarray, inside: np.ndarray, prior_sigma: np.ndarray
) -> np.ndarray:
    """Coefficients [p] of ``design`` [n, p] that explain ``change`` [n] where it is ``inside``."""
    step = np.zeros(design.shape[1])
    for _ in range(ITERATIONS):
        left = np.abs(change - design @ step)
        scale = max(spread_about_zero(left), 0.05)
        weight = inside * biweight(left, BIWEIGHT * scale)
        weighed = design * weight[:, None]
        prior = np.diag((scale / prior_sigma) ** 2)
        step = np.linalg.solve(weighed.T @ design + prior, weighed.T @ change)
    return step


def _light(channels: Sequence[np.ndarray]) -> LightChange:
    rows = np.array(channels)
    return LightChange(LightDrift(rows[:, 0], rows[:, 2], rows[:, 3:]), rows[:, 1])


def _jackknife(left_out: Sequence[LightChange]) -> LightChange:
    def sigma(values: list[np.ndarray]) -> np.ndarray:
        stack = np.array(values)
        count = len(stack)
        return np.sqrt((count - 1) / count * ((stack - stack.mean(axis=0)) ** 2).sum(axis=0))

    light = LightDrift(
        sigma([x.light.gain for x in left_out]),
        sigma([x.light.offset for x in left_out]),
        sigma([x.light.gradient for x in left_out]),
    )
    return LightChange(light, sigma([x.response for x in left_out]))
