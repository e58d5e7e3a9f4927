# SPDX-License-Identifier: Apache-2.0
"""The ball presses that colours and normals are fitted to, and those that they are judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.background.result import BackgroundCalibration
from taccel_lab.calibration.base_profile import (
    lost_blocks,
    on_grid,
    presses_on_camera,
    require_labels_and_view,
    with_measured_scale,
)
from taccel_lab.calibration.capture.captures import CaptureSet, without_labels
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.split import PressSplit
from taccel_lab.calibration.check.run import (
    capture_check,
    capture_findings,
    refusing_with,
)
from taccel_lab.calibration.circles.ball_surface import (
    ball_surface,
    layer_of,
    layer_surfaces,
    sunk_share,
)
from taccel_lab.calibration.circles.thickness import GelThickness, gel_thickness
from taccel_lab.calibration.circles.usable import usable_circles
from taccel_lab.calibration.press_options import BallPressOptions
from taccel_lab.calibration.remarks import LABELS_OFF, LABELS_UNUSED, name_some
from taccel_lab.calibration.response.frame import FittedPresses, HeldoutSet
from taccel_lab.calibration.result import BlockResult, Placed, in_figures
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import BackgroundBlock, Provenance, SensorProfile
from taccel_lab.profile.assumed import scale_sigma, thickness_interval_mm
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.light import LightDrift
from taccel_lab.report.remark import Remark
from taccel_lab.signals.rest_surface import rest_surface

DOUBTFUL_BALL = (
    "the radius of the ball that it was calibrated with may be its diameter: depths may be twice "
    "as large, which their intervals hold"
)
MEAN_OF = 4
"""Presses that have a mean light."""


@dataclass(frozen=True)
class Untouched:
    """The untouched sensor that colours and normals were fitted against."""

    block: BackgroundBlock
    image: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""

    def onto(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with this background."""
        return profile.with_block(self.block, self.image)


@dataclass(frozen=True)
class BallPresses:
    """Presses and profile on one pixel grid, split by names and labels alone. Labels that images
    reject are taken off."""

    profile: SensorProfile
    """The profile that is extended, on the grid of the captures and with the gel's thickness."""
    gel: GelThickness | None
    """What the training presses say of that; None where it is known and they agree."""
    captures: CaptureSet
    """All presses."""
    split: PressSplit
    fitted: FittedPresses
    """Presses to fit that show a contact, and those that only the figures see."""
    lost: tuple[Remark, ...]
    """Blocks of the profile that do not fit the captures' grid."""
    findings: tuple[Remark, ...]
    """What the check of the captures says of the block, worst first."""
    remarks: tuple[Remark, ...]
    """Presses left out, and those that are fitted without the labels that their images reject."""

    @property
    def untouched(self) -> Untouched | None:
        """The background that they are fitted against; None where the profile has none."""
        block, image = self.profile.background, self.profile.background_rgb
        return None if block is None or image is None else Untouched(block, image)


def ball_presses(
    folder: CaptureFolder,
    base: SensorProfile,
    block: str,
    options: BallPressOptions,
    progress: Progress = silent,
    *,
    cache: bool = True,
) -> BallPresses:
    """The presses of ``folder`` that ``block`` is fitted to.

    With ``cache``, contacts that an earlier run found in these images are taken as they are.

    Raises:
        InputError: Captures that cannot be used, with what their check found.
    """
    once, folder = folder.once, with_measured_scale(folder, base)
    require_labels_and_view(folder, base, block)
    findings = capture_findings(folder, block, progress)
    with refusing_with(findings):
        as_given = options.circles == "labels"
        check = capture_check(folder, progress, (block,))
        rejected = frozenset[str]() if as_given else check.rejected_labels
        kept = replace(folder, presses=without_labels(folder.presses, rejected))
        captures, profile = presses_on_camera(kept, base)
        split = captures.split(options.holdout_every)
        usable = once.of(
            ("circles", captures.grid, split, options.circles),
            lambda: usable_circles(
                captures.only(split.train), options.circles, cache=cache, progress=progress
            ),
        )
        sigmas_px = [radius for _, radius in usable.sigmas_px]
        gel = gel_thickness(
            usable.captures, usable.circles, sigmas_px, profile, options.thickness,
            stated="thickness_mm" in folder.design,
        )  # fmt: skip
    extended = profile if gel is None else gel.apply_to(profile)
    # Rejected labels are of no more use to anybody: those alone are no fault of the rest.
    findings = [
        finding
        for finding in findings
        if finding.code != LABELS_OFF.code or not rejected.issuperset(finding.frames)
    ]
    layer, rest = layer_of(extended), rest_surface(extended.mesh, captures.grid)
    surfaces = once.of(
        ("surfaces", captures.grid, split, options.circles, layer),
        lambda: tuple(layer_surfaces(usable.captures, usable.circles, layer, rest)),
    )
    on_gel = partial(ball_surface, grid=captures.grid, layer=layer, rest=rest)
    extended = with_background(extended, folder)
    typical_mm = float(np.median([circle.radius_px for circle in usable.circles]))
    typical_mm *= captures.grid.mm_per_px_x
    return BallPresses(
        profile=extended,
        gel=gel,
        captures=captures,
        split=split,
        fitted=FittedPresses(
            usable.captures,
            usable.circles,
            surfaces,
            HeldoutSet.of(captures, split, on_gel),
            circle_sigmas_px=usable.sigmas_px,
            labels=usable.labels,
            background=extended.background_rgb,
            rest=rest,
            pad=layer,
            scale_share=scale_sigma(extended.camera),
            thickness_share=sunk_share(
                thickness_interval_mm(extended.gel), typical_mm, captures.ball_radius_mm, layer
            ),
        ),
        lost=tuple(lost_blocks(base, profile)),
        findings=tuple(findings),
        remarks=(*usable.remarks, *_without_label(captures.only(split.train))),
    )


def _without_label(training: CaptureSet) -> list[Remark]:
    if not training.rejected:
        return []
    names = sorted(training.rejected)
    return [LABELS_UNUSED(count=len(names), names=name_some(names), frames=names)]


def with_background(profile: SensorProfile, folder: CaptureFolder) -> SensorProfile:
    """``profile`` with the background of the captures in the mean light of their presses."""
    assert folder.background is not None
    return folder.once.of(
        ("background", profile.grid()),
        lambda: _in_mean_light(calibrate_background(folder, profile)),
    ).image_on(profile.without("background"))


def _in_mean_light(found: BackgroundCalibration) -> BackgroundCalibration:
    """The background in the mean light of the presses, which most images of the session have."""
    lights = [frame.drift for frame in found.frames if frame.kind == "press"]
    if len(lights) < MEAN_OF:
        return found
    gain, at_level, gradient = (
        np.median([part(light) for light in lights], axis=0)
        for part in (
            lambda light: light.gain,
            lambda light: light.shift(light.level),
            lambda light: light.gradient,
        )
    )
    level = np.mean([light.level for light in lights], axis=0)
    mean = LightDrift(gain, at_level - (gain - 1.0) * level, gradient)
    image = np.clip(mean.apply(found.image), 0.0, 255.0).astype(np.float32)
    return replace(found, image=image, method=found.method + "; in the mean light of the presses")


def with_captured_background(
    profile: SensorProfile, image: np.ndarray, source: str, sha256: str
) -> SensorProfile:
    """``profile`` with the captures' background [levels] where it has none."""
    if profile.background is not None:
        return profile
    provenance = Provenance(
        kind="measured",
        method="captured background",
        source=source,
        inputs={"background": sha256},
    )
    return profile.with_block(BackgroundBlock(provenance=provenance), image)


def with_doubtful_ball(profile: SensorProfile, ball_share: float) -> SensorProfile:
    """``profile`` with a remark, which readings repeat, where the ball that it is calibrated with
    adds a share to all deviations (``diameter_share``), and without it otherwise."""
    provenance = profile.sensor.provenance
    said = tuple(remark for remark in provenance.remarks if remark != DOUBTFUL_BALL)
    if ball_share > 0:
        said = (*said, DOUBTFUL_BALL)
    if said == provenance.remarks:
        return profile
    provenance = provenance.model_copy(update={"remarks": said})
    return profile.with_block(profile.sensor.replace(provenance=provenance))


class Fit(Protocol):
    """A fitted model."""

    @property
    def inputs(self) -> Mapping[str, str]:
        """SHA-256 of the images it was fitted to, by name."""
        ...


FitType = TypeVar("FitType", bound=Fit)


@dataclass(frozen=True, repr=False, kw_only=True)
class ScoredFit(BlockResult, Generic[FitType]):
    """A model that is fitted, scored on held-out presses, and then fitted to all of them."""

    fit: FitType
    """Fit to the training presses: all figures are of it."""
    final: FitType | None
    """Fit to all presses, once the held-out ones were scored; what a profile gets. None where no
    held-out press can be used."""
    heldout: Sequence[Placed]
    """Presses that were held out and could be rendered or read."""
    split: PressSplit | None
    """How the held-out presses were chosen; None where the fit was given no set of them."""
    valid_region: dict[str, tuple[float, float]]
    """Range of contact positions, tilts and displacements in the presses of the last fit."""
    gel: GelThickness | None = None
    """What the presses say of the gel's thickness; None where it is known and they agree."""
    untouched: Untouched | None = None
    """What it was fitted against; that of the captures when None."""
    remarks: tuple[Remark, ...] = ()
    """What a person has to know before the model is used."""

    @property
    def has_scores(self) -> bool:
        """Whether there are figures of held-out presses."""
        return bool(in_figures(self.heldout))

    @property
    def last(self) -> FitType:
        """What a profile gets."""
        return self.final or self.fit

    @property
    def scored(self) -> Self:
        """Result with the model that the figures are of alone."""
        return self if self.final is None else replace(self, final=None)

    def grounded(
        self, profile: SensorProfile, grid: PixelGrid, provenance: Mapping[str, str]
    ) -> SensorProfile:
        """``profile`` on the captures' grid, on the gel that their presses tell and, where it is
        known, with the background that the model was fitted against."""
        profile = on_grid(profile, grid, provenance)
        if self.gel is not None:
            profile = self.gel.apply_to(profile)
        return profile if self.untouched is None else self.untouched.onto(profile)

    @property
    def then_fitted(self) -> str:
        """What the last fit was made to, for the record; empty where there is none."""
        if self.final is None:
            return ""
        return f"scored so, then fitted to all {len(self.final.inputs)} presses"
