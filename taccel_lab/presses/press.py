# SPDX-License-Identifier: Apache-2.0
"""What a press gave: force, image, heights, dots; written as files, drawn, or shown in a line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from taccel_lab.files.atomic_file import eight_bit, write_by, write_json
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.geometry.height_surface import points_of_heights, write_ply
from taccel_lab.presses.files import (
    VIEWS,
    PressImages,
    painted_images,
    predicted_image,
    write_press,
    write_seen,
)
from taccel_lab.presses.force_interval import ForceInterval, force_causes, force_power
from taccel_lab.presses.numerical_error import SignalError, height_error_mm, image_error_levels
from taccel_lab.presses.outcome import PressOutcome
from taccel_lab.presses.photo import LIKE
from taccel_lab.presses.states import PressMarkers
from taccel_lab.processes.process_pool import Call, at_once
from taccel_lab.report.style import save_figure
from taccel_lab.sensors.starters import is_starter
from taccel_lab.with_error import with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.presses.numerical_error import NumericalError
    from taccel_lab.presses.plan import PressPlan

TIMES = "times.json"
"""File of a press folder: what the press and each step took [s]."""


def _arrays_alone(function: Callable[..., Any], *arguments: Any) -> None:
    """Call what writes arrays; leave out what draws."""
    if function is write_by:
        function(*arguments)


@dataclass(frozen=True, repr=False, eq=False, kw_only=True)
class Press(PressOutcome):
    """A press of one sensor and everything that it reads at its end."""

    plan: PressPlan
    """Plan of the press: sensor, tool, options."""
    seconds: float
    """Time of the whole."""
    failure: str | None = None
    """Why the press ended before its path did."""
    error: NumericalError | None = None
    """Basis of the numerical error; None of a stored mesh and of a press that failed."""
    below: PressOutcome | None = None
    """The coarser press that the error was measured by."""
    write_page: Callable[[Press, Path], None] | None = None
    """Writes the page of a press into its folder, whose pictures are there."""
    missing: tuple[str, ...] = ()
    """What a press that ended early has not, in words."""
    slippery: float | None = None
    """Force without friction over that with it, where the coefficient was in doubt and pressed."""

    @classmethod
    def of(cls, outcome: PressOutcome, plan: PressPlan, seconds: float, **known: Any) -> Self:
        """Return the press of a plan that had this outcome; ``known`` are further fields."""
        solved = {each.name: getattr(outcome, each.name) for each in fields(PressOutcome)}
        return cls(**solved, plan=plan, seconds=seconds, **known)

    @cached_property
    def force_interval(self) -> ForceInterval:
        """95 % interval of the force by all that is known to be uncertain, and its causes."""
        plan = self.plan
        causes = force_causes(
            plan.profile,
            plan.indenter,
            self,
            plan.options.friction,
            self.slippery,
            self._photo_error_mm,
            plan.options.speed_mm_s is not None,
        )
        error_n = self.force_error_n
        return ForceInterval.of(self.force_n, causes, error_n if math.isfinite(error_n) else 0.0)

    @property
    def force_interval_n(self) -> tuple[float, float]:
        """Ends of ``force_interval`` [N]."""
        return self.force_interval.low_n, self.force_interval.high_n

    @property
    def depth_m(self) -> np.ndarray:
        """How far the face lies below where it rests [m], [height_px, width_px]."""
        return self.rest_height_m - self.height_m

    @property
    def depth_mm(self) -> float:
        """Largest depth of the contact [mm]: at a dome's border depths are those of rays that graze
        it."""
        depth = self.depth_m[self.contact_mask] if self.contact_mask.any() else self.depth_m
        return 1e3 * float(np.nanmax(depth))

    @property
    def depth_error_mm(self) -> float:
        """Error of the depth [mm]: that of the heights, root mean square; NaN of a stored mesh."""
        return self.height_error.total

    @property
    def center_mm(self) -> tuple[float, float] | None:
        """Centre of pressure in the gel frame [mm]; None without contact."""
        force = self.contact_forces_n[:, 2]
        if not force.any():
            return None
        x, y = 1e3 * (force @ self.positions_m[:, :2]) / force.sum()
        return float(x), float(y)

    @property
    def area_mm2(self) -> float:
        """Area in contact [mm2]."""
        return math.pi * (1e3 * self.contact_radius_m) ** 2

    @property
    def points_m(self) -> np.ndarray:
        """Point cloud of the contact face [m], gel frame, [height_px, width_px, 3]; NaN outside the
        pad."""
        return points_of_heights(self.height_m, self.plan.profile.grid())

    @property
    def points_mm(self) -> np.ndarray:
        """The same [mm]."""
        return 1e3 * self.points_m

    @cached_property
    def height_error(self) -> SignalError:
        """Error of the heights, root mean square [mm]; NaN of a stored mesh."""
        return height_error_mm(self, self._signal_sigma_mm, self._place_sigma_px)

    @cached_property
    def image_error(self) -> SignalError | None:
        """Error of the image in the profile's colours, root mean square [levels of 255]; None
        without them, or where nothing was measured."""
        profile, rgb = self.plan.profile, self._painted[0]
        if rgb is None or self.below is None:
            return None
        assert profile.background_rgb is not None and profile.color is not None
        beside = painted_images(profile, replace(self.below, states=None))[0]
        assert beside is not None
        return image_error_levels(
            self,
            rgb,
            beside,
            profile.background_rgb,
            profile.color.provenance,
            self._signal_sigma_mm,
            self._place_sigma_px,
        )

    @property
    def _photo_error_mm(self) -> float:
        photo = self.plan.photo
        return 0.0 if photo is None else photo.depth_error_mm or 0.0

    @property
    def _signal_sigma_mm(self) -> float:
        """Standard deviation of the depth that heights and image show: of one that was read, or of
        that at which a gel, which is known so far, has the force that was asked for."""
        if self.plan.options.force_n is None or not self.force_n > 0:
            return self._photo_error_mm
        gel = [cause for cause in self.force_interval.causes if cause.name != "numerical"]
        ends = ForceInterval.of(1.0, tuple(gel))
        share = math.log(ends.high_n / ends.low_n) / 4 / force_power(self)
        return share * self.path.depth_mm

    @property
    def _place_sigma_px(self) -> tuple[float, float]:
        photo, camera = self.plan.photo, self.plan.profile.camera
        x_mm, y_mm = (0.0, 0.0) if photo is None else photo.at_error_mm or (0.0, 0.0)
        return x_mm / camera.mm_per_px_x, y_mm / camera.mm_per_px_y

    @cached_property
    def image(self) -> np.ndarray | None:
        """Tactile image, RGB, uint8, [height_px, width_px, 3], in the profile's colours. Before a
        calibration the optical design predicts it, in another size; None without either."""
        if self._painted[0] is not None:
            return eight_bit(self._painted[0])
        return predicted_image(self.plan.profile, self)

    def _images(self, pictures: bool) -> PressImages:
        """Images to be written, the predicted one only with ``pictures``. ``image`` is it: the
        light is followed once."""
        return PressImages(*self._painted, lambda: self.image if pictures else None)

    def seen_by(self, name: str) -> Press:
        """Return the press as one of the sensor's cameras shows it."""
        plan = replace(self.plan, profile=self.plan.profile.seen_by(name))
        pixels = vars(self.views[name]) if name in self.views else {}
        # Steps and the press beside it kept the pixels of the first camera alone.
        apart = {"views": {}, "states": None} if pixels else {}
        return replace(self, **pixels, **apart, plan=plan, below=None)

    @cached_property
    def markers(self) -> PressMarkers | None:
        """Dots of the gel at rest and now, [mm] and [px]; None for a gel without."""
        places = self.positions_m[None]
        return PressMarkers.of(self.plan.profile, self.mesh, places)

    @cached_property
    def like(self) -> dict[str, Any] | None:
        """How near the image comes to the photo that the press is like, see
        ``PressPhoto.figures``; None of other presses."""
        photo, painted = self.plan.photo, self._painted[0]
        if photo is None or painted is None:
            return None
        return photo.figures(painted, self.contact_mask, self.plan.profile)

    @property
    def simulated_photo(self) -> np.ndarray | None:
        """The image over the photo's own background, levels, [height_px, width_px, 3]; None of
        presses that are like no photo."""
        photo, painted = self.plan.photo, self._painted[0]
        if photo is None or painted is None:
            return None
        return photo.simulated(painted, self.plan.profile)

    def figures(self) -> dict[str, Any]:
        """Return every number of the press, as in ``press.json``."""
        like = {} if self.like is None else {"like": self.like}
        return {**super().figures(), **self._errors(), **like}

    def _errors(self) -> dict[str, Any]:
        """Both errors of force, heights and image, and what they rest on."""
        force, image = self.force_interval, self.image_error
        return {
            "errors": {
                "force_n": {
                    "numerical": self.force_error_n,
                    "interval": self.force_interval_n,
                    "causes": {each.name: (each.low, each.high) for each in force.causes},
                },
                "shear_n": self.shear_error_n,
                "moment_nm": self.moment_error_nm,
                "height_mm": asdict(self.height_error),
                "image_levels": None if image is None else asdict(image),
                "measured": None if self.error is None else self.error.figures(),
            }
        }

    def save(self, folder: Path | str) -> None:
        """Write pictures, arrays, mesh and ``press.json`` as the folder, whole or not at all.

        Raises:
            InputError: The folder holds files that taccel-lab did not write.
        """
        with atomic_directory(folder) as staging:
            self.plan.write_scene(staging)
            self.write_into(staging)
            if self.write_page is not None:
                self.write_page(self, staging)

    def save_ply(self, path: Path | str) -> None:
        """Write the contact face as PLY: vertices in metres with their normals, and triangles."""
        write_ply(path, self.points_m, self.normals)

    def write_into(self, folder: Path, call: Call = at_once, *, pictures: bool = True) -> None:
        """Write all but the scene into a folder that is there; ``call`` draws, see ``Beside``.
        Without ``pictures`` figures, arrays and mesh alone, in a second."""
        if not pictures:
            call = _arrays_alone
        plan, options = self.plan, self.plan.options
        about = {
            "sensor": plan.sensor,
            "indenter": options.indenter,
            "texture": None if options.texture is None else str(options.texture),
            "texture_mm": None if options.texture is None else options.texture_mm,
            "at_mm": options.at_mm,
            "asked_force_n": options.force_n,
            "friction_coefficient": plan.friction,
            "differs_from_calibration": plan.differs,
            "like": self.like,
            "failure": self.failure,
            "missing": self.missing,
            **self._errors(),
        }
        # Apart, so that equal presses have equal files.
        step_s = [step.report.seconds for step in self.steps]
        write_json(folder / TIMES, {"seconds": self.seconds, "step_seconds": step_s})
        write_press(folder, self, plan.profile, self._images(pictures), about, call)
        for name in self.views:
            seen = self.seen_by(name)
            inner = folder / VIEWS / name
            inner.mkdir(parents=True)
            write_seen(inner, seen, seen.plan.profile, seen._images(pictures), call)
        if pictures and plan.photo is not None and self.like is not None:
            assert self.simulated_photo is not None
            figure = plan.photo.draw(self.simulated_photo, plan.profile, self.like["psnr_db"])
            save_figure(figure, folder / LIKE)

    def plot(self) -> Figure:
        """Image, depth and contact side by side."""
        from taccel_lab.report.figures import draw_press

        grid = self.plan.profile.grid()
        return draw_press(
            self.image, 1e3 * self.depth_m, self.contact_mask, grid, self.summary()[0]
        )

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Summarise the press: tool, depth, force and contact."""
        options, last = self.plan.options, self.last
        height, width = self.height_m.shape
        rows = [
            ("force", f"{with_error(self.force_n, self.force_error_n)} N"),
            ("95 % interval", "{:.3g} to {:.3g} N, of all causes".format(*self.force_interval_n)),
            ("depth", f"{with_error(self.depth_mm, self.depth_error_mm)} mm"),
            ("area", f"{self.area_mm2:.3g} mm2 in contact"),
            ("image", f"{width} x {height} px, {self.colours}"),
            ("residual", f"{last.residual_n[0]:.1e} N after {len(self.steps)} steps"),
            ("time", f"{self.seconds:.1f} s on {options.device}"),
        ]
        sideways = math.hypot(*self.wrench[:2])
        if sideways > self.shear_error_n:
            rows.insert(2, ("sideways", f"{with_error(sideways, self.shear_error_n)} N"))
        if self.like is not None:
            rows.append(("photo", f"{self.like['psnr_db']:.1f} dB ({self._untouched()})"))
        if self.failure is not None:
            rows.append(("stopped", self.failure))
        return f"{options.indenter} pressed {self.travel_mm:.4g} mm into {self.plan.sensor}", rows

    def _untouched(self) -> str:
        assert self.like is not None
        return f"the untouched image {self.like['untouched_psnr_db']:.1f} dB"

    @property
    def colours(self) -> str:
        """Where the colours of the image come from."""
        if self.plan.profile.color is not None:
            starter = is_starter(self.plan.profile)
            return "colours of a starter profile" if starter else "calibrated colours"
        return "no colours" if self.plan.profile.optics is None else "predicted by the design"

    @cached_property
    def _painted(self) -> tuple[np.ndarray | None, list[np.ndarray] | None]:
        return painted_images(self.plan.profile, self)
