# SPDX-License-Identifier: Apache-2.0
"""Surfaces of presses of a ball from the simulations of a few of them.

Around a press that lies well inside a flat or gently crowned pad, the surface depends on the
contact radius and the distance from the centre alone (``RadialSurfaces``). The presses to simulate
are the ones that lie farthest apart in contact radius and place, so that they span all others; how
well one law explains them says whether it holds on this pad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.surfaces.press_surface import PressSurface
from taccel_lab.calibration.surfaces.radial import STEP, RadialSurfaces, slope_of
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normals import normals_from_slopes

SPANNING = 6
"""Presses that are simulated; as many as give the law a parabola in the contact radius with three
to spare."""
MIN_OTHERS = 3
"""With fewer presses besides, all are simulated."""
MAX_MISFIT_DEG = 2.0
"""Largest mean angle between a simulated press and the law, inside the contact and up to 2.5 radii.
Most of it is no other shape but the mesh beside a steep edge, which the law averages out: where it
is 1.0 degrees (FOTS) and 1.6 (Taxim's dome), colours of left-out training presses are predicted
better by the law than by a simulation of each (docs/ablations.md). Beyond, nothing is
known, and each press is simulated."""
RING_RADII = 2.5


def spanning_presses(circles: Sequence[ContactCircle], count: int = SPANNING) -> list[int]:
    """Indices of ``count`` presses that lie farthest apart in radius and place, in order.

    The smallest and the largest contact come first; then each time the one farthest from all that
    are taken. A place counts over the spread of the places, a radius over half that of the radii.
    """
    values = np.array([(c.u_px, c.v_px, c.radius_px) for c in circles])
    spread = np.maximum(np.ptp(values, axis=0), 1e-9)
    spread[:2] = spread[:2].max()
    scaled = values / spread * (1.0, 1.0, 2.0)
    taken = [int(np.argmin(values[:, 2]))]
    if len(values) > 1:
        largest = int(np.argmax(values[:, 2]))
        taken += [largest] if largest not in taken else []
    while len(taken) < min(count, len(values)):
        away = np.linalg.norm(scaled[:, None] - scaled[taken][None], axis=-1).min(axis=1)
        away[taken] = -1.0
        taken.append(int(np.argmax(away)))
    return sorted(taken)


@dataclass(frozen=True)
class SharedLaw:
    """What simulated presses of one ball have in common."""

    library: RadialSurfaces
    simulated: Sequence[PressSurface]
    lean: np.ndarray
    """Share of the slope that the gel has at rest under the press's middle which is gone, and the
    same for the height over that slope, over the distance in steps of ``RadialSurfaces``, shape
    [2, sample]. Under the ball all of it is gone, far away nothing."""
    misfit_deg: float = 0.0
    """Largest mean angle between a simulated press and the law [deg]."""

    @classmethod
    def of(
        cls, surfaces: Sequence[PressSurface], circles: Sequence[ContactCircle], grid: PixelGrid
    ) -> SharedLaw:
        """From simulated presses and where they are."""
        library = RadialSurfaces.of(surfaces, circles, grid)
        count = library.tilt_rad.shape[1]
        law = cls(library, surfaces, np.zeros((2, count)))
        sums = np.zeros((4, count))
        for surface, circle in zip(surfaces, circles, strict=True):
            near = circle.distance_px(grid) < (count - 1) * STEP * surface.contact_radius_px
            slope, sunk = law._around(circle, surface.contact_radius_px)
            x, y, distance = _offsets(circle, grid)
            rest = law._rest_under(circle)
            along = (rest[0] * x + rest[1] * y)[near]
            place = np.rint(distance[near] / (surface.contact_radius_px * grid.mm_per_px_x) / STEP)
            left = (slope_of(surface.normals) - slope)[near]
            for row, values in enumerate(
                (
                    -left @ rest,
                    np.full(len(along), rest @ rest),
                    -(surface.displacement_mm() - sunk)[near] * along,
                    along**2,
                )
            ):
                sums[row] += np.bincount(place.astype(int), values, count)[:count]
        lean = np.stack(
            [
                np.divide(above, below, out=np.zeros(count), where=below > 1e-9)
                for above, below in ((sums[0], sums[1]), (sums[2], sums[3]))
            ]
        )
        law = cls(library, surfaces, np.clip(lean, 0.0, 1.0))
        return cls(library, surfaces, law.lean, max(law._misfits(circles)))

    @property
    def holds(self) -> bool:
        """Whether one law explains the simulated presses."""
        return self.misfit_deg <= MAX_MISFIT_DEG

    def surface(self, circle: ContactCircle, radius_px: float) -> PressSurface:
        """The surface of a press in ``circle`` whose contact has the radius ``radius_px``."""
        like = self.simulated[0]
        slope, sunk_mm = self._around(circle, radius_px)
        radii = np.array([surface.contact_radius_px for surface in self.simulated])
        order = np.argsort(radii)

        def between(name: str) -> float:
            values = np.array([getattr(surface, name) for surface in self.simulated])
            return float(np.interp(radius_px, radii[order], values[order]))

        return PressSurface(
            height_m=like.rest_height_m + sunk_mm * 1e-3,
            rest_height_m=like.rest_height_m,
            normals=normals_from_slopes(slope),
            rest_normals=like.rest_normals,
            contact_radius_px=radius_px,
            depth_mm=between("depth_mm"),
            force_n=between("force_n"),
            residual_n=float("nan"),
            provider=f"between {len(self.simulated)} presses by {like.provider}",
        )

    def _around(self, circle: ContactCircle, radius_px: float) -> tuple[np.ndarray, np.ndarray]:
        """Slope [height_px, width_px, 2] and displacement [mm] [height_px, width_px]."""
        library = self.library
        x, y, distance = _offsets(circle, library.grid)
        tilt, sunk = library.profiles_at(radius_px, distance)
        steep = np.tan(tilt) / distance
        slope = library.rest_slope + np.stack([steep * x, steep * y], axis=-1)
        rest = self._rest_under(circle)
        if self.lean.any():
            t = np.arange(self.lean.shape[1]) * STEP
            relative = distance / (radius_px * library.grid.mm_per_px_x)
            slope -= np.interp(relative, t, self.lean[0], right=0.0)[..., None] * rest
            gone = np.interp(relative, t, self.lean[1], right=0.0)
            sunk = sunk - gone * (rest[0] * x + rest[1] * y)
        return slope, sunk

    def _rest_under(self, circle: ContactCircle) -> np.ndarray:
        """Slope of the gel at rest under the middle of a press, shape [2]."""
        grid = self.library.grid
        row = int(np.clip(round(circle.v_px), 0, grid.height_px - 1))
        column = int(np.clip(round(circle.u_px), 0, grid.width_px - 1))
        return self.library.rest_slope[row, column]

    def _misfits(self, circles: Sequence[ContactCircle]) -> list[float]:
        """Mean angles [deg] inside the contacts and around them."""
        found = []
        for surface, circle in zip(self.simulated, circles, strict=True):
            away = circle.distance_px(self.library.grid) / surface.contact_radius_px
            slope, _ = self._around(circle, surface.contact_radius_px)
            cosine = np.einsum("vuk,vuk->vu", normals_from_slopes(slope), surface.normals)
            angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
            rings = (away <= 1.0, (away > 1.0) & (away <= RING_RADII))
            found += [float(angle[ring].mean()) for ring in rings if ring.any()]
        return found


def _offsets(circle: ContactCircle, grid: PixelGrid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y and distance of the pixels from the middle of a press [mm]."""
    x = (np.arange(grid.width_px)[None, :] - circle.u_px) * grid.mm_per_px_x
    y = (np.arange(grid.height_px)[:, None] - circle.v_px) * grid.mm_per_px_y
    return x, y, np.maximum(np.hypot(x, y), 1e-9)
