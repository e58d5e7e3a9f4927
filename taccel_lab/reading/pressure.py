# SPDX-License-Identifier: Apache-2.0
r"""What presses a gel into the shape that was read: pressure, force, contact.

The seen face is taken for the underside of a tool, wherever it is pressed in. A bonded layer of the
profile's thickness, modulus and Poisson's ratio lies under it (``circles.bonded_layer``):
pressures push only, and act only where the layer meets the seen face. So a gel that sinks beside a
contact needs no pressure there, and no training is needed.

A face that was read wrong by chance would be met at its lowest spots. So the tool is let give way,
as a film would, by the reading's stated standard deviation on average: that is the one
regularisation, and it vanishes with the deviation (Morozov's discrepancy principle).

The interval of the force is that of a face lower and higher by 1.96 standard deviations of the
height, of the intervals of thickness, scale and modulus (``profile.assumed`` has those that nobody
measured), of a Poisson's ratio whose spread was measured and of the layer's own error against
finite elements (``LAYER_SHARE``), taken as independent; that of the area joins height and scale.
A face that may as well be untouched has a force that may be 0. Where nothing is seen
to touch, the force is 0, and its upper end is that of a ball as wide as the gel is thick, pressed
as deep as this image could hide. Friction between gel and tool is not seen; the layer's error holds
for coefficients of 0 to 1.

A gel that relaxes pushes back harder at first (``Overstress``). Of one image nobody knows how long
it was held: the interval then reaches from the relaxed gel to a sudden press. A tool that goes back
may push less than either. Frames whose times are known tell all of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.assumed import (
    is_modulus_known,
    modulus_interval_pa,
    scale_sigma,
    thickness_interval_mm,
)
from taccel_lab.profile.measured_range import poisson_interval
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, pressure_under
from taccel_lab.reading.touch import Touch
from taccel_lab.signals.rest_surface import RestSurface, rest_surface
from taccel_lab.with_error import NORMAL_95

STEPS_PER_THICKNESS = 24.0
"""Steps over the gel's thickness of the grid that pressures are sought on: twice as many change
forces by less than 1 %."""
LEAST_STEPS = 64
"""Fewest steps of that grid along the longer side of the view."""
TOLERANCE = 1e-3
"""Largest gap in the contact, as a part of the deepest point. Forces of eleven presses of a
GelSight are then within 0.06 % of those by a hundredth of it; by ten times as much within 0.7 %."""
LAYER_SHARE = 0.35
"""Standard deviation of the layer's force from that of finite elements, as a part of it, over depth
by thickness. Balls, punch, box and roller in a GelSight Mini's gel with a coefficient of friction
of 1: -3 to +1 % at a tenth of the thickness, -15 to -5 % at three tenths; balls without friction +2
to +8 %."""
LEAST_SHARE = 0.02
"""The least of it."""
CONTACT_PRESSURE = 0.15
"""Part of the greatest pressure from which on a place counts as contact: a ball's contact is 2 %
smaller there. Below it lies what a reading's errors feign beside a contact."""
STEEPEST_REST = 0.5
"""Slope of the resting face from which on no flat layer stands for the gel."""
DEEPEST_SHARE = 0.4
"""Part of the thickness from which on a remark says how far the layer's law may be off."""
UNKNOWN_SHARE = 0.01
"""Part of a force from which on a remark says that its time is not known."""


@dataclass(frozen=True)
class ContactPressure:
    """What presses the gel."""

    pressure_pa: np.ndarray
    """Contact pressure [Pa], at least 0, shape [height_px, width_px] of the reading."""
    force_n: float
    """Normal force [N], its integral over the view."""
    force_interval_n: tuple[float, float] | None
    """95 % interval of the force [N]; None where the height's deviation is not known."""
    area_mm2: float
    """Area in contact [mm2]."""
    area_interval_mm2: tuple[float, float] | None
    """95 % interval of the area [mm2], likewise."""
    center_mm: tuple[float, float] | None
    """Centre of pressure in the gel frame [mm]; None without contact."""
    remarks: tuple[str, ...]
    """What the force rests on, and what is not in its interval, a sentence each."""

    @property
    def force_words(self) -> str:
        """Force and its interval in words."""
        return _with_interval(self.force_n, self.force_interval_n, "N")

    @property
    def area_words(self) -> str:
        """Area, its interval and the largest pressure in words."""
        area = _with_interval(self.area_mm2, self.area_interval_mm2, "mm2")
        return f"{area} in contact, pressure up to {1e-3 * float(self.pressure_pa.max()):.3g} kPa"

    def figures(self) -> dict[str, Any]:
        """All numbers, ready for JSON."""
        return {
            "force_n": self.force_n,
            "force_interval_n": self.force_interval_n and list(self.force_interval_n),
            "area_mm2": self.area_mm2,
            "area_interval_mm2": self.area_interval_mm2 and list(self.area_interval_mm2),
            "max_pressure_kpa": 1e-3 * float(self.pressure_pa.max()),
            "center_mm": self.center_mm and list(self.center_mm),
            "force_remarks": list(self.remarks),
        }


def _with_interval(value: float, ends: tuple[float, float] | None, unit: str) -> str:
    words = f"{value:.3g} {unit}"
    return words if ends is None else words + f" (95 %: {ends[0]:.3g} to {ends[1]:.3g} {unit})"


class PressureReader:
    """Finds pressures of one sensor's readings, one frame after another."""

    def __init__(
        self, profile: SensorProfile, grid: PixelGrid, rest: RestSurface | None = None
    ) -> None:
        """
        Args:
            profile: Whose thickness, modulus and Poisson's ratio are taken, with their intervals.
            grid: That of the readings.
            rest: The undeformed face on it, where it is known already.

        Raises:
            InputError: A dome, for which no flat layer stands.
        """
        normals = (rest or rest_surface(profile.mesh, grid)).normals
        steepest = float((np.hypot(normals[..., 0], normals[..., 1]) / normals[..., 2]).max())
        if not steepest < STEEPEST_REST:
            raise InputError(
                "no pressure is read: the gel is a dome, and the layer that pressures are found "
                "by is flat"
            )
        self.grid = grid
        material, gel = profile.material, profile.gel
        self.layer = BondedLayer(gel.thickness_mm, material.poisson_ratio)
        self.pa = material.young_modulus_pa / (2 * (1 - material.poisson_ratio**2))
        """Pressure [Pa] of a unit of the layer's."""
        thick, nu = gel.thickness_mm, material.poisson_ratio
        ends = [tuple(BondedLayer(t, nu) for t in thickness_interval_mm(gel))]
        if (ratios := poisson_interval(profile)) is not None:
            ends.append(tuple(BondedLayer(thick, ratio) for ratio in ratios))
        self._ends = ends
        """Layers between which the gel lies, a pair for each of what is not known of it."""
        low_pa, high_pa = modulus_interval_pa(material)
        self._modulus = material.young_modulus_pa / low_pa, high_pa / material.young_modulus_pa
        # Depth and width of a contact grow with the scale, and its force with both.
        self._scale = NORMAL_95 * 2 * scale_sigma(profile.camera)
        self._about = _about(profile)
        pixel = grid.mm_per_px_x, grid.mm_per_px_y
        size = grid.width_px * pixel[0], grid.height_px * pixel[1]
        step = max(*pixel, min(gel.thickness_mm / STEPS_PER_THICKNESS, max(size) / LEAST_STEPS))
        self._coarse = grid.resized(*(max(2, round(side / step)) for side in size))
        self._overstress: Overstress | None = None
        if material.branches:
            self._overstress = Overstress(
                [(b.relative_modulus, b.time_s) for b in material.branches]
            )

    def read(
        self,
        rise_m: np.ndarray,
        touch: Touch,
        height_sigma_m: np.ndarray | None = None,
        reading_sigma_m: np.ndarray | None = None,
        time_s: float | None = None,
    ) -> ContactPressure:
        """What presses the face so.

        Args:
            rise_m: Rise over the resting face [m], negative in a dent, shape [h, w] of the grid.
            touch: Where it is touched.
            height_sigma_m: Its standard deviation [m], shape [h, w]; None where it is not known.
            reading_sigma_m: That of the reading alone, likewise.
            time_s: When the frame was taken [s], for a gel that relaxes; None where it does not
                follow the frame before.
        """
        inside = self._small(touch.pixels.astype(np.float32)) > 0
        if not touch.any:
            zero = np.zeros(inside.shape)
            sudden = 1.0
            if self._overstress is not None:
                self._overstress.follow(zero, time_s)
                sudden += self._overstress.most
            most_n, most_mm2 = self._unseen(touch.unseen_mm)
            return self._found(zero, (0.0, sudden * most_n), (0.0, most_mm2), ())
        rise = self._small(1e3 * rise_m)
        gap = np.where(inside, rise, FAR_MM)
        # Never from another frame's pressure: how far a search gets depends on where it begins.
        pressure, film = self._solved(gap, self.layer, None, 0.0), 0.0
        interval = areas = None
        if height_sigma_m is not None:
            alone_m = height_sigma_m if reading_sigma_m is None else reading_sigma_m
            reading_mm = float(self._small(1e3 * alone_m)[inside].mean())
            pressed = pressure[pressure > 0]
            if reading_mm > 0 and len(pressed):
                film = reading_mm / float(pressed.mean())
                pressure = self._solved(gap, self.layer, pressure, film)
            sigma_mm = self._small(1e3 * height_sigma_m)
            interval, areas = self._intervals(pressure, gap, sigma_mm, film)
        limits = self._limits(rise, pressure)
        if self._overstress is None:
            return self._found(pressure, interval, areas, limits)
        total, interval, said = self._with_overstress(self._overstress, pressure, interval, time_s)
        return self._found(total, interval, areas, (*limits, *said))

    def _with_overstress(
        self,
        overstress: Overstress,
        relaxed: np.ndarray,
        interval: tuple[float, float] | None,
        time_s: float | None,
    ) -> tuple[np.ndarray, tuple[float, float] | None, tuple[str, ...]]:
        """Pressure and interval of a gel that relaxes, from those of its relaxed layer, and what is
        not known of it."""
        added, unknown = overstress.follow(relaxed, time_s)
        total = np.maximum(relaxed + added, 0.0)
        force, relaxed_n = self._force_n(total), self._force_n(relaxed)
        doubt_n = self._force_n(np.array([unknown]))
        if interval is not None:
            # Errors of modulus, layer and height scale with the force; not below the relaxed one,
            # of which little may be left on a way back.
            low, high = max(force - doubt_n, 0.0), force + doubt_n
            scale = max(relaxed_n, 1e-12)
            interval = (
                max(low - (relaxed_n - interval[0]) * max(1.0, low / scale), 0.0),
                high + (interval[1] - relaxed_n) * max(1.0, high / scale),
            )
        said = ()
        if doubt_n > UNKNOWN_SHARE * force:
            said = (
                "how long the gel was held is not known: a sudden press takes "
                f"{1 + overstress.most:.3g} times the force of a long one, and the interval covers "
                "both",
            )
        return total, interval, said

    def _intervals(
        self, pressure: np.ndarray, gap: np.ndarray, sigma: np.ndarray, film: float
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """95 % intervals of the force [N] and of the area [mm2]."""
        far = NORMAL_95 * sigma
        shallow, deep = (
            self._solved(gap + sign * far, self.layer, pressure, film) for sign in (1, -1)
        )
        area, less, more = (self._area_mm2(found) for found in (pressure, shallow, deep))
        seen = min(area, less), max(area, more)
        areas = _widened(area, seen, (self._scale,), (self._scale,))
        force, lower, higher = (self._force_n(found) for found in (pressure, shallow, deep))
        by_gel = []
        for ends in self._ends:
            # A modulus presses by E / (1 - nu^2).
            one, other = (
                self._force_n(self._solved(gap, layer, pressure, film))
                / (1 - layer.poisson_ratio**2)
                for layer in ends
            )
            by_gel.append(0.5 * math.log(max(one, 1e-12) / max(other, 1e-12)))
        low, high = self._other_logs(-float(gap.min()))
        return _widened(force, (lower, higher), (*by_gel, *low), (*by_gel, *high)), areas

    def _other_logs(self, depth_mm: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Logarithms of the factors that the force may be lower and higher by, whatever the face:
        by the layer's law, the scale, the modulus."""
        law = NORMAL_95 * max(LEAST_SHARE, LAYER_SHARE * depth_mm / self.layer.thickness_mm)
        low, high = ((law, self._scale, math.log(modulus)) for modulus in self._modulus)
        return low, high

    def _unseen(self, depth_mm: float) -> tuple[float, float]:
        """Upper ends of force [N] and area [mm2] of a contact that may be ``depth_mm`` deep and is
        not seen."""
        depth_mm = min(depth_mm, DEEPEST_SHARE * self.layer.thickness_mm)
        coarse = self._coarse
        x, y = coarse.x_mm() - coarse.x_mm().mean(), coarse.y_mm() - coarse.y_mm().mean()
        ball = np.hypot(x[None, :], y[:, None]) ** 2 / (2 * self.layer.thickness_mm)
        pressure = self._solved(ball - depth_mm, self.layer, None, 0.0)
        force = self._force_n(pressure) * math.exp(math.hypot(*self._other_logs(depth_mm)[1]))
        return force, self._area_mm2(pressure) * math.exp(self._scale)

    def _solved(
        self, gap: np.ndarray, layer: BondedLayer, start: np.ndarray | None, film: float
    ) -> np.ndarray:
        step = self._coarse.mm_per_px_x, self._coarse.mm_per_px_y
        tolerance = TOLERANCE * max(-float(gap.min()), 1e-3)
        return pressure_under(gap, step, layer, tolerance, start, film)[0]

    def _force_n(self, pressure: np.ndarray) -> float:
        area_m2 = 1e-6 * self._coarse.mm_per_px_x * self._coarse.mm_per_px_y
        return self.pa * area_m2 * float(pressure.sum(dtype=np.float64))

    def _contact(self, pressure: np.ndarray) -> np.ndarray:
        return pressure > CONTACT_PRESSURE * pressure.max()

    def _area_mm2(self, pressure: np.ndarray) -> float:
        return float(self._contact(pressure).sum()) * (
            self._coarse.mm_per_px_x * self._coarse.mm_per_px_y
        )

    def _found(
        self,
        pressure: np.ndarray,
        interval: tuple[float, float] | None,
        areas: tuple[float, float] | None,
        limits: tuple[str, ...],
    ) -> ContactPressure:
        import cv2

        coarse, grid = self._coarse, self.grid
        contact = self._contact(pressure)
        center = None
        if contact.any():
            rows, columns = np.indices(pressure.shape)
            total = pressure.sum()
            at = np.array([(columns * pressure).sum() / total, (rows * pressure).sum() / total])
            x, y = coarse.gel_from_pixel(at)[:2]
            center = float(x), float(y)
        size = (grid.width_px, grid.height_px)
        fine = cv2.resize(pressure.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        return ContactPressure(
            pressure_pa=self.pa * fine,
            force_n=self._force_n(pressure),
            force_interval_n=interval,
            area_mm2=self._area_mm2(pressure),
            area_interval_mm2=areas,
            center_mm=center,
            remarks=(*self._about, *limits),
        )

    def _limits(self, rise: np.ndarray, pressure: np.ndarray) -> tuple[str, ...]:
        """Where the layer does not hold for this reading, a sentence each."""
        said, deepest = [], -float(rise.min())
        if deepest > DEEPEST_SHARE * self.layer.thickness_mm:
            strain = deepest / self.layer.thickness_mm
            said.append(
                f"the gel is pressed by {strain:.0%} of its thickness, where the layer's law may "
                f"be off by {NORMAL_95 * LAYER_SHARE * strain:.0%}; the interval includes that"
            )
        border = np.ones(pressure.shape, dtype=bool)
        border[1:-1, 1:-1] = False
        if (pressure[border] > CONTACT_PRESSURE * pressure.max()).any():
            said.append("the contact reaches the border of the image: the force is of what is seen")
        return tuple(said)

    def _small(self, values: np.ndarray) -> np.ndarray:
        import cv2

        size = (self._coarse.width_px, self._coarse.height_px)
        return np.asarray(cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def _widened(
    value: float, ends: tuple[float, float], below: Sequence[float], above: Sequence[float]
) -> tuple[float, float]:
    """An interval about a value, widened by logarithms of further factors on each side."""
    if not value > 0:
        return ends
    low = math.log(value / ends[0]) if ends[0] > 0 else math.inf
    high = math.hypot(math.log(ends[1] / value), *above)
    return value * math.exp(-math.hypot(low, *below)), value * math.exp(high)


def _about(profile: SensorProfile) -> tuple[str, ...]:
    """What the force rests on that nobody has measured, a sentence each."""
    material = profile.material
    if is_modulus_known(material):
        return ()
    low_pa, high_pa = modulus_interval_pa(material)
    return (
        f"Young's modulus {1e-3 * material.young_modulus_pa:.3g} kPa is "
        f"{material.provenance.kind}: the force's interval covers {1e-3 * low_pa:.3g} to "
        f"{1e-3 * high_pa:.3g} kPa",
    )


class Overstress:
    r"""Pressure that a gel that relaxes adds to that of its relaxed layer, from frame to frame.

    With Poisson's ratio constant, space and time part: pressure p(t) of a surface whose relaxed
    layer would need p_e(t) is p_e plus, for each Maxwell branch g, tau [the correspondence
    principle: Christensen 1982, Theory of Viscoelasticity, 2.4],

        q(t) = g \int exp(-(t - s) / tau) dp_e(s)

    which from frame to frame, p_e even in between, is a recursion of one map a branch:

        q  <-  exp(-h) q + g (1 - exp(-h)) / h (p_e - p_e before),  h = dt / tau

    A first frame does not say how long it was held: q is between 0 and g p_e. What is not known
    fades by exp(-h) too.
    """

    def __init__(self, branches: Sequence[tuple[float, float]]) -> None:
        """``branches``: relative modulus and time [s] of each."""
        self.branches = tuple(branches)
        self._maps: list[np.ndarray] = []
        self._unknown: list[float] = []
        self._last: tuple[np.ndarray, float] | None = None

    @property
    def most(self) -> float:
        """Largest overstress over the relaxed pressure."""
        return sum(modulus for modulus, _ in self.branches)

    def follow(self, relaxed: np.ndarray, time_s: float | None) -> tuple[np.ndarray, float]:
        """Take the next frame.

        Args:
            relaxed: Pressure that the relaxed layer needs, any unit, [h, w].
            time_s: When the frame was taken, later than the one before [s]. None where that is not
                known: the frame is taken as a first one.

        Returns:
            The overstress, [h, w], and how far its sum may be from that either way.
        """
        if time_s is None or self._last is None or not time_s > self._last[1]:
            self._maps = [0.5 * modulus * relaxed for modulus, _ in self.branches]
            self._unknown = [float(q.sum()) for q in self._maps]
        else:
            before, at = self._last
            change = relaxed - before
            for number, (modulus, tau) in enumerate(self.branches):
                h = (time_s - at) / tau
                left = math.exp(-h)
                grown = -math.expm1(-h) / h
                self._maps[number] = left * self._maps[number] + modulus * grown * change
                self._unknown[number] *= left
        self._last = None if time_s is None else (relaxed, time_s)
        return np.sum(self._maps, axis=0), sum(self._unknown)
