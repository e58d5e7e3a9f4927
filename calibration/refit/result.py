# SPDX-License-Identifier: Apache-2.0
"""The correction of an old profile, with its gain on frames that were left out of the fit, and its
page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.refit.light_change import LightChangeFit
from taccel_lab.calibration.result import BlockResult, calibrated
from taccel_lab.errors import InputError
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.printable import counted
from taccel_lab.profile import BackgroundBlock, Block, Provenance, SensorProfile
from taccel_lab.report.lead import Score
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.remark import Remark, judge
from taccel_lab.report.style import BLUE, GREY, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True)
class FrameError:
    """Mean absolute error of a new frame that was left out of the fit [levels]."""

    name: str
    pressed: bool
    before: float
    """The old profile, in the contact disc of a press or over an untouched frame."""
    after: float
    whole_before: float
    """Error of the old profile over the whole frame."""
    whole_after: float


@dataclass(frozen=True, repr=False)
class RefitCalibration(BlockResult):
    """The correction with what it gains."""

    fit: LightChangeFit
    background: np.ndarray
    """New background, RGB levels, float32, shape [height_px, width_px, 3]."""
    errors: tuple[FrameError, ...]
    """Errors of the fitted frames, each by a fit without it."""
    heldout: tuple[FrameError, ...]
    """Errors of presses that had no part in anything."""
    remarks: tuple[Remark, ...]
    inputs: dict[str, str]
    source: str
    surface_provider: str

    def mean(self, name: str) -> float:
        """Mean of a figure of ``errors`` over the frames [levels]."""
        return float(np.mean([getattr(error, name) for error in self.errors]))

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        change, sigma = self.fit.change, self.fit.sigma
        return {
            "verdict": judge(self.remarks),
            "before_l1": self.mean("before"),
            "after_l1": self.mean("after"),
            "whole_before_l1": self.mean("whole_before"),
            "whole_after_l1": self.mean("whole_after"),
            "response_rgb": change.response.tolist(),
            "response_sigma": sigma.response.tolist(),
            "gain_rgb": change.light.gain.tolist(),
            "gain_sigma": sigma.light.gain.tolist(),
            "offset_rgb": change.light.offset.tolist(),
            "gradient_rgb": change.light.gradient.tolist(),
            "frames": [vars(error) for error in self.errors],
            "heldout": [vars(error) for error in self.heldout],
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` in the new light: background and, where it has one, colour model."""
        profile = profile.with_block(
            BackgroundBlock(
                provenance=self._provenance(
                    profile.background,
                    "refitted: the old background in the new light, averaged with the untouched "
                    f"parts of {len(self.errors)} new frames",
                )
            ),
            self.background,
        )
        if profile.color is None or profile.color_weights is None:
            return profile
        config = ColorModelConfig.from_dict(profile.color.architecture)
        response = self.fit.change.response
        factors = ", ".join(f"{name} {x:.3f}" for name, x in zip(CHANNELS, response, strict=True))
        method = f"refitted: last layer scaled by {factors}; before that: "
        return profile.with_block(
            profile.color.replace(
                provenance=self._provenance(profile.color, method + profile.color.provenance.method)
            ),
            scale_channels(config, profile.color_weights, response),
        )

    def _provenance(self, block: Block | None, method: str) -> Provenance:
        old, region = {}, {}
        if block is not None:
            old, region = block.provenance.inputs, block.provenance.valid_region
        sigma = self.fit.sigma
        spread = {f"response_{n}": float(x) for n, x in zip(CHANNELS, sigma.response, strict=True)}
        spread |= {f"gain_{n}": float(x) for n, x in zip(CHANNELS, sigma.light.gain, strict=True)}
        return calibrated(
            self.remarks,
            method=method,
            source=self.source,
            inputs={**old, **{f"refit_{name}": sha for name, sha in self.inputs.items()}},
            residuals={
                "heldout_l1_levels": self.mean("after"),
                "heldout_before_refit_l1_levels": self.mean("before"),
                "heldout_whole_l1_levels": self.mean("whole_after"),
            },
            spread=spread,
            valid_region=region or {"level": (0.0, 255.0)},
        )


def scale_channels(
    config: ColorModelConfig, weights: Any, factors: np.ndarray
) -> dict[str, np.ndarray]:
    """Weights of a colour model whose change is ``factors`` [3] times as large a channel."""
    last = len(config.layer_sizes()) - 1
    scaled = {name: np.array(value) for name, value in weights.items()}
    # Also the bias, which cancels, so that the layer stays the old one but for its scale.
    for name in (f"layer{last}.weight", f"layer{last}.bias"):
        if name not in scaled or scaled[name].shape[0] != 3:
            raise InputError(
                f"the profile's colour model has no last layer {name} of three channels; it "
                "cannot be refitted"
            )
        shape = (3,) + (1,) * (scaled[name].ndim - 1)
        scaled[name] = (scaled[name] * factors.reshape(shape)).astype(scaled[name].dtype)
    return scaled


def refit_page(result: RefitCalibration, old: SensorProfile) -> Page:
    """The page of ``taccel-lab calibrate refit``."""
    change, sigma = result.fit.change, result.fit.sigma
    rows = zip(
        CHANNELS, change.response, sigma.response, change.light.gain, sigma.light.gain,
        change.light.offset, *change.light.gradient.T, strict=True,
    )  # fmt: skip
    tables = [
        Table(
            "What changed",
            ("channel", "response", "±", "gain", "±", "offset", "to the right", "down"),
            list(rows),
            "Response: factor of the colour change; gain: of the background. Offset and gradient "
            "(middle to border) in levels of 255. ±: standard deviation, by leaving one frame out.",
        ),
        _errors_of(
            "Frames left out of the fit",
            result.errors,
            "Mean absolute error [levels of 255] of contact discs of presses and whole untouched "
            "frames, and of whole frames; worst first.",
        ),
    ]
    if result.heldout:
        tables.append(
            _errors_of(
                "Held-out presses",
                result.heldout,
                "Presses without any part in the refit, by their labels or, without one, where "
                "their own images show them.",
            )
        )
    return Page(
        "Refit to the light of today",
        f"{len(result.errors)} new frames, each left out of the fit in turn: mean error "
        f"{result.mean('before'):.2f} levels before and {result.mean('after'):.2f} after "
        "(contact disc of presses, untouched frames whole), "
        f"{result.mean('whole_before'):.2f} and {result.mean('whole_after'):.2f} over the "
        f"whole frames. Surfaces: {result.surface_provider}.",
        result.remarks,
        tables,
        [_backgrounds(result, old), _errors(result)],
        result.figures(),
        scores=[
            Score(
                f"{result.mean('after'):.2f}",
                "levels of 255",
                "mean error after the refit",
                f"{len(result.errors)} new frames, each left out of the fit in turn; before: "
                f"{result.mean('before'):.2f}",
            ),
            *_heldout_scores(result.heldout),
        ],
    )


def _heldout_scores(errors: Sequence[FrameError]) -> list[Score]:
    """The error of presses that the refit did not see, where there are any."""
    if not errors:
        return []
    before, after = (np.mean([getattr(e, name) for e in errors]) for name in ("before", "after"))
    on = f"{counted(len(errors), 'press', 'presses')} without any part in the refit"
    return [
        Score(f"{after:.2f}", "levels of 255", "mean error of held-out presses",
              f"{on}; before: {before:.2f}")
    ]  # fmt: skip


def _errors_of(title: str, errors: Sequence[FrameError], caption: str) -> Table:
    """Worst first."""
    columns = {
        "frame": "name",
        "kind": lambda e: "press" if e.pressed else "untouched",
        "before": "before",
        "after": "after",
        "whole before": "whole_before",
        "whole after": "whole_after",
    }
    table = Table.of(title, sorted(errors, key=lambda e: -e.after), columns, caption)
    return replace(table, folded=True)


@picture("errors", "Error of each left-out frame.")
def _errors(result: RefitCalibration) -> Figure:
    figure, axis = new_figure(9, 3.4)
    place = np.arange(len(result.errors))
    axis.bar(place - 0.2, [e.before for e in result.errors], 0.4, color=GREY, label="before")
    axis.bar(place + 0.2, [e.after for e in result.errors], 0.4, color=BLUE, label="after")
    axis.set_xticks(place, [e.name for e in result.errors], rotation=30, ha="right")
    axis.set_ylabel("mean absolute error [levels]")
    axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
    return figure


@picture(
    "backgrounds",
    "The untouched sensor before and after, and twice the difference: grey is none.",
)
def _backgrounds(result: RefitCalibration, old: SensorProfile) -> Figure:
    before = np.asarray(old.background_rgb, dtype=np.float64)
    height, width = before.shape[:2]
    figure, axes = new_figure(11, 0.8 + 3.4 * height / width, 1, 3)
    difference = np.clip(128 + 2 * (result.background - before), 0, 255)
    for axis, image, title in zip(
        axes,
        (before, result.background, difference),
        ("before", "after", "difference x 2"),
        strict=True,
    ):
        axis.imshow(np.clip(image / 255, 0, 1))
        axis.set(title=title, xlabel="u [px]", ylabel="v [px]")
    return figure
