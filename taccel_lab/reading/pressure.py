# SPDX-License-Identifier: Apache-2.0
r"""What presses a gel into the shape that was read: pressure, force, contact.

The seen face is taken for the underside of a tool, wherever it is pressed in. A bonded layer of the
profile's thickness, modulus and Poisson's ratio lies under it (``bonded_layer``):
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

A gel that relaxes pushes back harder at first (``overstress``). Of one image nobody knows how long
it was held: the interval then reaches from the relaxed gel to a sudden press. A tool that goes back
may push less than either. Frames whose times are known tell all of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

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
from taccel_lab.reading.contact_pressure import ContactPressure
from taccel_lab.reading.overstress import Overstress
from taccel_lab.reading.spread_operator import resampling
from taccel_lab.reading.touch import Touch, least_logs
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
ENDS = 3.0
"""Tolerances of the pressures that intervals end at."""
PART = 8
"""Points; parts of the grid begin and end at a multiple, so that many are of one size."""
SEEN_SHARE = 1e-4
"""Part of a point's pixels that counts as none."""
BALL_STEP = 1.05
"""Step of the depths [mm] that upper ends of what is not seen are known at."""
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


class PressureReader:
    """Finds pressures of one sensor's readings, one frame after another."""

    def __init__(
        self,
        profile: SensorProfile,
        grid: PixelGrid,
        rest: RestSurface | None = None,
        blur_px: float = 0.0,
    ) -> None:
        """
        Args:
            profile: Whose thickness, modulus and Poisson's ratio are taken, with their intervals.
            grid: That of the readings.
            rest: The undeformed face on it, where it is known already.
            blur_px: Standard deviation that a contact's outline may be read outward by [px].

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
        self.grid, self._blur_mm = grid, blur_px * max(grid.mm_per_px_x, grid.mm_per_px_y)
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
        self._rows = resampling(grid.height_px, self._coarse.height_px)
        self._columns = resampling(grid.width_px, self._coarse.width_px)
        self._balls: dict[int, tuple[float, float]] = {}
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
        whole = np.zeros((self._coarse.height_px, self._coarse.width_px))
        if not touch.any:
            sudden = 1.0
            if self._overstress is not None:
                self._overstress.follow(whole, time_s)
                sudden += self._overstress.most
            most_n, most_mm2 = self._unseen(touch.unseen_mm)
            return self._found(whole, (0.0, sudden * most_n), (0.0, most_mm2), ())
        # Beside what is touched there is no tool, and no pressure.
        part = tuple(
            _around(np.asarray(touch.pixels.any(axis=axis)), matrix)
            for axis, matrix in ((1, self._rows), (0, self._columns))
        )
        inside = self._small(touch.pixels, part) > SEEN_SHARE
        gap = np.where(inside, 1e3 * self._small(rise_m, part), FAR_MM)
        # Never from another frame's pressure: how far a search gets depends on where it begins.
        pressure, film = self._solved(gap, self.layer), 0.0
        interval = areas = None
        if height_sigma_m is not None:
            alone_m = height_sigma_m if reading_sigma_m is None else reading_sigma_m
            reading_mm = 1e3 * float(self._small(alone_m, part)[inside].mean())
            pressed = pressure[pressure > 0]
            if reading_mm > 0 and len(pressed):
                film = reading_mm / float(pressed.mean())
                pressure = self._solved(gap, self.layer, pressure, film)
            sigmas_mm = [1e3 * self._small(each, part) for each in (height_sigma_m, alone_m)]
            interval, areas = self._intervals(pressure, gap, sigmas_mm, film, touch.most_mm2)
        whole[part] = pressure
        limits = self._limits(-float(gap.min()), whole)
        if self._overstress is None:
            return self._found(whole, interval, areas, limits)
        total, interval, said = self._with_overstress(self._overstress, whole, interval, time_s)
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
        self,
        pressure: np.ndarray,
        gap: np.ndarray,
        sigmas: Sequence[np.ndarray],
        film: float,
        most_mm2: float,
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """95 % intervals of the force [N] and of the area [mm2], of ``most_mm2`` at most: where a
        face rises slowly, what lies too low to count as touched may be."""
        sigma, alone = sigmas
        far, lowest = NORMAL_95 * sigma, np.unravel_index(int(np.argmin(gap)), gap.shape)
        depth_mm = -float(gap[lowest])
        added, grown = least_logs(depth_mm, float(sigma[lowest]), float(alone[lowest]))
        shallow = np.zeros_like(pressure)
        if math.isfinite(added):
            shallow = self._solved(gap + NORMAL_95 * alone, self.layer, pressure, film, ENDS)
        # As far on the other side, until it is known better.
        start = np.maximum(2 * pressure - shallow, 0.0)
        deep = self._solved(gap - far, self.layer, start, film, ENDS)
        area, less, more = (self._area_mm2(found) for found in (pressure, shallow, deep))
        shallow_mm2 = most_mm2 if less == 0.0 else 0.0
        seen = min(area, less), max(area, more, shallow_mm2)
        outline = math.log(max(area, 1e-12) / max(self._inner_mm2(pressure), 1e-12))
        areas = _widened(area, seen, (self._scale, outline), (self._scale,))
        force, lower, higher = (self._force_n(found) for found in (pressure, shallow, deep))
        by_gel = []
        for ends in self._ends:
            # A modulus presses by E / (1 - nu^2).
            one, other = (
                self._force_n(self._solved(gap, layer, pressure, film, ENDS))
                / (1 - layer.poisson_ratio**2)
                for layer in ends
            )
            by_gel.append(0.5 * math.log(max(one, 1e-12) / max(other, 1e-12)))
        low, high = self._other_logs(-float(gap.min()))
        # Pressures are in proportion to the face.
        low = (*by_gel, *low, grown)
        return _widened(force, (lower, higher), low, (*by_gel, *high)), areas

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
        # Powers of the depth between depths that a frame had to know before.
        at = math.log(depth_mm) / math.log(BALL_STEP)
        below = math.floor(at)
        share = at - below
        force, area = (
            low ** (1 - share) * high**share
            for low, high in zip(self._ball(below), self._ball(below + 1), strict=True)
        )
        force *= math.exp(math.hypot(*self._other_logs(depth_mm)[1]))
        return force, area * math.exp(self._scale)

    def _ball(self, power: int) -> tuple[float, float]:
        """Force [N] and area [mm2] of a ball ``BALL_STEP`` to that power [mm] deep."""
        if power not in self._balls:
            coarse = self._coarse
            x, y = coarse.x_mm() - coarse.x_mm().mean(), coarse.y_mm() - coarse.y_mm().mean()
            ball = np.hypot(x[None, :], y[:, None]) ** 2 / (2 * self.layer.thickness_mm)
            pressure = self._solved(ball - BALL_STEP**power, self.layer)
            self._balls[power] = self._force_n(pressure), self._area_mm2(pressure)
        return self._balls[power]

    def _solved(
        self,
        gap: np.ndarray,
        layer: BondedLayer,
        start: np.ndarray | None = None,
        film: float = 0.0,
        tolerance: float = 1.0,
    ) -> np.ndarray:
        """Pressure under a tool of this gap, over a part of the grid; ``tolerance``: in that of
        ``TOLERANCE``."""
        coarse = self._coarse
        step, whole = (coarse.mm_per_px_x, coarse.mm_per_px_y), (coarse.height_px, coarse.width_px)
        allowed_mm = tolerance * TOLERANCE * max(-float(gap.min()), 1e-3)
        part = None if gap.shape == whole else whole
        return pressure_under(gap, step, layer, allowed_mm, start, film, part)[0]

    def _force_n(self, pressure: np.ndarray) -> float:
        area_m2 = 1e-6 * self._coarse.mm_per_px_x * self._coarse.mm_per_px_y
        return self.pa * area_m2 * float(pressure.sum(dtype=np.float64))

    def _contact(self, pressure: np.ndarray) -> np.ndarray:
        return pressure > CONTACT_PRESSURE * pressure.max()

    def _area_mm2(self, pressure: np.ndarray) -> float:
        return float(self._contact(pressure).sum()) * (
            self._coarse.mm_per_px_x * self._coarse.mm_per_px_y
        )

    def _inner_mm2(self, pressure: np.ndarray) -> float:
        """Area of what touches [mm2] but for what lies as near to its outline as a reading may have
        blurred that. Beyond the image it goes on."""
        import cv2

        contact, coarse = self._contact(pressure), self._coarse
        step = math.sqrt(coarse.mm_per_px_x * coarse.mm_per_px_y)
        off = NORMAL_95 * self._blur_mm / step
        wide = np.pad(contact, beyond := int(off) + 1, mode="edge").astype(np.uint8)
        away = cv2.distanceTransform(wide, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        inner = (away - 0.5 > off)[beyond:-beyond, beyond:-beyond] & contact
        return step**2 * float(inner.sum())

    def _found(
        self,
        pressure: np.ndarray,
        interval: tuple[float, float] | None,
        areas: tuple[float, float] | None,
        limits: tuple[str, ...],
    ) -> ContactPressure:
        coarse, grid = self._coarse, self.grid
        contact = self._contact(pressure)
        center = None
        fine = np.zeros((grid.height_px, grid.width_px), dtype=np.float32)
        if contact.any():
            import cv2

            rows, columns = np.arange(coarse.height_px), np.arange(coarse.width_px)
            by_row, by_column = pressure.sum(axis=1), pressure.sum(axis=0)
            at = np.array([columns @ by_column, rows @ by_row]) / by_row.sum()
            x, y = coarse.gel_from_pixel(at)[:2]
            center = float(x), float(y)
            size = (grid.width_px, grid.height_px)
            found_pa = (self.pa * pressure).astype(np.float32)
            fine = cv2.resize(found_pa, size, interpolation=cv2.INTER_LINEAR)
        return ContactPressure(
            pressure_pa=fine,
            force_n=self._force_n(pressure),
            force_interval_n=interval,
            area_mm2=self._area_mm2(pressure),
            area_interval_mm2=areas,
            center_mm=center,
            remarks=(*self._about, *limits),
        )

    def _limits(self, deepest: float, pressure: np.ndarray) -> tuple[str, ...]:
        """Where the layer does not hold for this reading, a sentence each; ``deepest``: place that
        is touched [mm]."""
        said = []
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

    def _small(self, values: np.ndarray, part: tuple[slice, ...]) -> np.ndarray:
        """Means of a map over the grid that pressures are sought on, of a part of that."""
        (rows, over_rows), (columns, over_columns) = (
            (some, slice(*np.flatnonzero(some.any(axis=0))[[0, -1]] + [0, 1]))
            for some in (self._rows[part[0]], self._columns[part[1]])
        )
        pixels = values[over_rows, over_columns].astype(np.float64)
        return rows[:, over_rows] @ pixels @ columns[:, over_columns].T


def _around(touched: np.ndarray, matrix: np.ndarray) -> slice:
    """Rows of a matrix that hold what is touched, bool, shape [column], a multiple of ``PART``."""
    of_part = np.flatnonzero(matrix @ touched)
    return slice(int(of_part[0]) // PART * PART, (int(of_part[-1]) // PART + 1) * PART)


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
