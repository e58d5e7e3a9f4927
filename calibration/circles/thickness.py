# SPDX-License-Identifier: Apache-2.0
"""The thickness of the gel from its ball presses, and the profile of such a gel.

A thickness that nobody measured is fitted, and its interval enters, by the profile, every ± of a
depth. One that is stated for this very gel has to agree with the images. One that a publication
gives, of another unit, stays: where images contradict it the interval reaches to what they tell.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import source_of
from taccel_lab.calibration.circles.ball_surface import (
    LARGEST_RADII,
    LAYER_SHARE,
    deeper_per_mm,
    layer_of,
)
from taccel_lab.calibration.circles.thickness_rings import (
    STEPS,
    THICKEST_MM,
    BallImage,
    LayerFamily,
    RingEstimate,
    estimate_by_rings,
)
from taccel_lab.calibration.pad import with_thickness
from taccel_lab.calibration.press_options import ThicknessMode
from taccel_lab.errors import InputError
from taccel_lab.profile import Provenance, SensorProfile
from taccel_lab.reading.light import fit_light
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.signals.rest_surface import rest_surface

Origin = Literal["assumed", "published", "stated", "fitted"]
NAME = "thickness_mm"
LAW_SIGMA = float(np.log(1.25)) / 2
"""Standard deviation by which a layer of small strains without friction misjudges the logarithm of
a thickness: finite elements of 2 to 8 mm under balls of 2 to 3 mm read as 0.81 to 1.08 of it, the
lower the deeper they are pressed, up to half the thickness."""
FLAT = float(np.cos(np.radians(5.0)))
"""Cosine of the tilt up to which a face at rest is as good as flat."""
SHARE = 0.95
TOUCH_MM = 0.05
"""Standard deviation of where a stage's first touch is taken to be [mm], the same for all presses:
a ball touches so little at first that half of that shows neither in an image nor in a force."""
MOST_SOLVED = 3
"""Contacts of one ball that are solved; the others lie between."""
_ORIGIN = re.compile(rf"(?:^|; ){NAME}: (assumption|set by the user)")


@dataclass(frozen=True)
class GelThickness:
    """What ball presses tell of a gel, and what is taken for its thickness."""

    thickness_mm: float
    """Thickness that is taken."""
    interval_mm: tuple[float, float]
    """Bounds of 95 %; 16 mm stand for that and more."""
    estimate_mm: tuple[float, float, float]
    """Median and bounds of 95 % that the captures tell."""
    before_mm: float
    """What the profile had."""
    origin: Origin
    """Where that came from."""
    by_rings: RingEstimate | None
    """How the gel sinks around the balls; None where that tells nothing."""
    travels: int
    """Presses of known travel."""
    balls: int
    contact_mm: float
    """Radius of the typical contact."""
    source: str
    inputs: dict[str, str]

    @property
    def fitted(self) -> bool:
        """Whether the profile gets another thickness."""
        return self.thickness_mm != self.before_mm

    def sentence(self) -> str:
        """What is taken, and why."""
        words, (low, high) = self._estimate_words(), self.interval_mm
        if self.origin == "published" and not self.fitted:
            return (
                f"The gel is taken as {self.thickness_mm:g} mm thick, as published; {words}, and "
                f"every ± of a depth holds {low:.1f} to {high:.1f} mm."
            )
        return (
            f"The gel is taken as {self.thickness_mm:.3g} mm thick "
            f"({low:.1f} to {high:.1f}): {words}."
        )

    def _estimate_words(self) -> str:
        by = []
        if self.by_rings is not None:
            by.append(f"how it sinks around {self.balls} balls")
        if self.travels:
            by.append(f"the travel of {self.travels} presses")
        if not by:
            return "nobody measured it, and neither rings around the balls nor travel tell it"
        _, low, high = self.estimate_mm
        most = f"{high:.1f} mm" if high < 0.97 * THICKEST_MM else "more"
        return f"{' and '.join(by)} says {low:.1f} to {most}"

    def figures(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "thickness_mm": self.thickness_mm,
            "interval_mm": list(self.interval_mm),
            "estimate_mm": list(self.estimate_mm),
            "before_mm": self.before_mm,
            "before": self.origin,
            "unexplained": None if self.by_rings is None else self.by_rings.unexplained,
            "travels": self.travels,
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with this thickness: its gel designed anew where it differs."""
        if self.fitted:
            profile = with_thickness(profile, self.thickness_mm)
        known = profile.gel.provenance
        changes: dict[str, Any] = {"interval": {**known.interval, NAME: self.interval_mm}}
        if self.fitted:
            changes |= {
                "kind": "calibrated",
                "method": f"{NAME} fitted: {self._estimate_words()}",
                "source": f"{self.source}; {known.source}",
                "inputs": self.inputs,
                "residuals": {
                    "slopes_left_over": 0.0 if self.by_rings is None else self.by_rings.unexplained
                },
                "valid_region": {"contact_mm": (0.0, self.contact_mm)},
            }
        provenance = Provenance(**{**known.model_dump(), **changes})
        return profile.with_block(profile.gel.replace(provenance=provenance), profile.mesh)


def thickness_origin(profile: SensorProfile, *, stated: bool = False) -> Origin | None:
    """Where the thickness of a profile comes from, ``stated`` of captures that state it; None of a
    gel whose family has no such parameter: its thickness is that of its drawing."""
    if NAME not in profile.sensor.parameters or profile.sensor.family not in sensor_families():
        return None
    provenance = profile.gel.provenance
    if provenance.kind == "calibrated" and NAME in provenance.interval:
        return "fitted"
    words = _ORIGIN.search(provenance.source)
    if stated or (words is not None and words[1] == "set by the user"):
        return "stated"
    return "assumed" if words is not None else "published"


def gel_thickness(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    radius_sigmas_px: Sequence[float],
    profile: SensorProfile,
    mode: ThicknessMode = "auto",
    *,
    stated: bool = False,
) -> GelThickness | None:
    """What the presses of ``captures`` in ``circles`` say of the gel of ``profile``; None where its
    thickness is known and they do not contradict it.

    Raises:
        InputError: A thickness that is stated of this gel and that they contradict; ``fit``, and
            they tell none.
    """
    origin = thickness_origin(profile, stated=stated)
    if origin is None or (origin == "fitted" and mode == "auto"):
        return None
    layer, grid, before = layer_of(profile), captures.grid, profile.gel.thickness_mm
    balls = [press.radius_mm or captures.ball_radius_mm for press in captures.presses]
    scale = grid.mm_per_px_x
    typical_mm = float(np.median([circle.radius_px for circle in circles])) * scale
    layers = LayerFamily.under(typical_mm, float(np.median(balls)), layer.poisson_ratio)
    rings = _rings(captures, circles, balls, profile, layers)
    travels = [
        TravelPress(press.depth_mm, circle.radius_px * scale, sigma * scale, ball)
        for press, circle, sigma, ball in zip(
            captures.presses, circles, radius_sigmas_px, balls, strict=True
        )
        if press.depth_mm
    ]
    if rings is None and not travels:
        if mode == "fit":
            raise InputError(
                f"{captures.source}: nothing tells how thick the gel is: too few whole rings "
                "around the contacts lie in the images, or no layer explains them. Press smaller "
                "contacts, or note depth_mm of some presses"
            )
        if origin != "assumed":
            return None
    density = _density(layers.thickness_mm, rings)
    if travels:
        log_density = log_likelihood(travels, layers.thickness_mm, layer.poisson_ratio)
        density = density * np.exp(log_density - log_density.max())
    low, middle, high = _quantiles(layers.thickness_mm, density)
    taken, interval = before, (low, high)
    contradicted = not low <= before <= high
    if mode == "fit" or (origin == "assumed" and (rings is not None or travels)):
        taken = _within_bounds(middle, profile)
    elif origin == "stated" and contradicted:
        by = "how it sinks around the balls" if rings is not None else "their travel"
        raise InputError(
            f"{captures.source}: {before:g} mm of gel are stated, and the presses are those on "
            f"{low:.1f} to {high:.1f} mm, by {by}. Measure the gel and "
            f"correct {NAME} (under [design] in captures.toml, or of the profile), take the line "
            "out, or have it fitted with --thickness fit"
        )
    elif origin == "published" and contradicted:
        interval = min(low, before), max(high, before)
    elif origin != "assumed":
        return None
    return GelThickness(
        thickness_mm=taken,
        interval_mm=interval,
        estimate_mm=(middle, low, high),
        before_mm=before,
        origin=origin,
        by_rings=rings,
        travels=len(travels),
        balls=len(circles),
        contact_mm=typical_mm,
        source=source_of(captures.provenance, captures.source),
        inputs=captures.hashes(),
    )


def _rings(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    balls_mm: Sequence[float],
    profile: SensorProfile,
    layers: LayerFamily,
) -> RingEstimate | None:
    """What the images tell; nothing on a curved gel."""
    rest = rest_surface(profile.mesh, captures.grid)
    if rest.normals[..., 2].min() < FLAT:
        return None
    background = captures.background.astype(np.float32)
    mask = None if captures.mask.all() else captures.mask
    presses = []
    for press, circle, ball in zip(captures.presses, circles, balls_mm, strict=True):
        image = press.image().astype(np.float32)
        light = fit_light(image, background, mask, gradient=False)
        presses.append(BallImage(light.remove(image) - background, circle, ball))
    return estimate_by_rings(presses, captures.grid, captures.mask, layers)


def _density(thickness_mm: np.ndarray, rings: RingEstimate | None) -> np.ndarray:
    """Density of the logarithm of the thickness: even where images tell nothing, else about what
    they tell as widely as the layer's law may misjudge it."""
    if rings is None:
        return np.ones(STEPS)
    off = np.log(thickness_mm)[:, None] - np.log(rings.thickness_mm)[None, :]
    return np.exp(-0.5 * (off / LAW_SIGMA) ** 2).mean(axis=1)


def _quantiles(thickness_mm: np.ndarray, density: np.ndarray) -> tuple[float, float, float]:
    """Lower bound, median and upper bound of 95 %."""
    share = np.cumsum(density)
    share = (share - 0.5 * density) / share[-1]
    at = np.interp([0.5 - SHARE / 2, 0.5, 0.5 + SHARE / 2], share, np.log(thickness_mm))
    low, middle, high = (float(value) for value in np.exp(at))
    return low, middle, high


def _within_bounds(thickness_mm: float, profile: SensorProfile) -> float:
    """The nearest thickness that the sensor's design can have, to 0.01 mm."""
    spec = sensor_family(profile.sensor.family).parameters_type.parameters()[NAME]
    low, high = spec.minimum or 0.0, spec.maximum or np.inf
    return round(float(np.clip(thickness_mm, low, high)), 2)


@dataclass(frozen=True)
class TravelPress:
    """A ball press of measured travel."""

    travel_mm: float
    radius_mm: float
    """Radius of the contact."""
    radius_sigma_mm: float
    ball_mm: float


def depths_in(
    presses: Sequence[TravelPress], thickness_mm: np.ndarray, poisson_ratio: float
) -> np.ndarray:
    """Depth [mm] at which each press's ball touches layers in its circle, shape [press, layer]."""
    found = np.empty((len(presses), len(thickness_mm)))
    balls = np.array([press.ball_mm for press in presses])
    for ball in np.unique(balls):
        own = [i for i, press in enumerate(presses) if press.ball_mm == ball]
        radii = np.array([presses[i].radius_mm for i in own])
        solved = np.unique(np.quantile(radii, np.linspace(0, 1, min(MOST_SOLVED, len(own)))))
        # Depths go nearly with the square of the contact.
        bends = []
        for radius in solved:
            layers = LayerFamily.under(float(radius), float(ball), poisson_ratio)
            known = np.interp(np.log(thickness_mm), np.log(layers.thickness_mm), layers.depth_mm)
            bends.append(known / radius**2)
        for i, radius in zip(own, radii, strict=True):
            at = [np.interp(radius, solved, column) for column in np.transpose(bends)]
            found[i] = np.array(at) * radius**2
    return found


def log_likelihood(
    presses: Sequence[TravelPress], thickness_mm: np.ndarray, poisson_ratio: float
) -> np.ndarray:
    """Logarithm of each thickness' likelihood by travel that a stage has measured, shape as
    ``thickness_mm``, but for a constant.

    A circle says how deep the ball lies below its rim, travel how deep it lies below the untouched
    face; between the two the rim has sunk, the further the thicker the gel is. Radii err press by
    press; first touch and the layer's law are off in all of them alike.
    """
    depths = depths_in(presses, thickness_mm, poisson_ratio)
    travel = np.array([press.travel_mm for press in presses])
    found = np.empty(len(thickness_mm))
    for k, depth in enumerate(depths.T):
        own = [
            deeper_per_mm(min(p.radius_mm, LARGEST_RADII * p.ball_mm), p.ball_mm, d)
            * p.radius_sigma_mm
            for p, d in zip(presses, depth, strict=True)
        ]
        law = LAYER_SHARE * depth
        covariance = np.diag(np.square(own)) + TOUCH_MM**2 + np.outer(law, law)
        off = travel - depth
        found[k] = -0.5 * off @ np.linalg.solve(covariance, off)
        found[k] -= 0.5 * np.linalg.slogdet(covariance)[1]
    return found
