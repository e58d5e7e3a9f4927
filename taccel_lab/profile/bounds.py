# SPDX-License-Identifier: Apache-2.0
"""Bounds between which values the figures of a sensor lie, and why: the one place that says so.

Wide enough for every sensor that we know of, and for what a calibration may find; narrow enough
that a wrong unit, a factor of 1,000, is rejected wherever a figure's own range allows that. Where a
figure is bounded by another one, the class that holds both says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from taccel_lab.errors import InputError


@dataclass(frozen=True)
class Bound:
    """The values that a figure may have."""

    low: float
    high: float
    unit: str
    why: str
    zero_means: str = ""
    """When not empty, 0 is allowed besides and means this."""

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        zero = f", or be 0 ({self.zero_means})" if self.zero_means else ""
        return f"must lie in [{self.low:g}, {self.high:g}]{unit}{zero}"

    def allows(self, value: float) -> bool:
        """Whether a figure may have this value; NaN never."""
        return bool(self.zero_means and value == 0) or self.low <= value <= self.high

    def faults(self, place: str, *values: float) -> Iterator[str]:
        """A line for each value that a figure, by its ``place`` in a profile, may not have."""
        for value in values:
            if not self.allows(value):
                yield f"{place}: {self}, got {value:g}: {self.why}"


_SOLID = {
    "young_modulus_pa": Bound(
        2e3, 5e7, "Pa", "the softest silicone gels have 5 kPa, the hardest elastomers 40 MPa"
    ),
    "density_kg_m3": Bound(100, 1e4, "kg/m3", "foams weigh 100, gels full of metal 5,000"),
    "friction_coefficient": Bound(0, 5, "", "tacky silicone on glass reaches 3"),
}
_COORDINATE = Bound(-1000, 1000, "mm", "a sensor is no larger than 1 m")
_LIGHT = {
    "rgb": Bound(0, 100, "", "relative to the other lights"),
    "size_mm": Bound(0.05, 200, "mm", "the smallest LEDs have 0.1 mm", "a point"),
    "lobe": Bound(0, 200, "", "a lobe of 200 is 5 degrees wide"),
}
_SHARE = Bound(0, 1, "", "it is a share")
_SIGMA_MM = Bound(0, 5, "mm", "a depth that is 5 mm off is none")

_TABLE: dict[str, dict[str, Bound]] = {
    "gel": {
        "thickness_mm": Bound(0.05, 100, "mm", "films begin at 0.05 mm"),
        "min_dihedral_deg": Bound(1, 70.53, "degrees", "a regular tet has 70.53; sound ones 10"),
    },
    "material": {
        **_SOLID,
        "mooney_ratio": _SHARE,
    },
    "material.branches": {
        "relative_modulus": Bound(1e-3, 100, "", "less is not measured, more is no solid"),
        "time_s": Bound(1e-3, 1e5, "s", "cameras take 1,000 frames a second, gels settle in a day"),
    },
    "material.layers": {
        **_SOLID,
        "young_modulus_pa": Bound(2e3, 5e9, "Pa", "a skin may be a film of PET, 3 GPa"),
    },
    "material.fitted_with": {
        "friction_coefficient": _SOLID["friction_coefficient"],
        "touch_shift_mm": Bound(-5, 5, "mm", "a touch that is 5 mm late is another one"),
    },
    "camera": {
        "width_px": Bound(2, 20_000, "px", "cameras have up to 10,000 columns"),
        "height_px": Bound(2, 20_000, "px", "cameras have up to 10,000 rows"),
        "mm_per_px_x": Bound(1e-3, 1, "mm", "microscopes show 1 um a pixel, a coarse image 0.5 mm"),
        "mm_per_px_y": Bound(1e-3, 1, "mm", "microscopes show 1 um a pixel, a coarse image 0.5 mm"),
    },
    "optics": {
        "width_px": Bound(2, 20_000, "px", "cameras have up to 10,000 columns"),
        "height_px": Bound(2, 20_000, "px", "cameras have up to 10,000 rows"),
        "fx_px": Bound(1, 1e6, "px", "narrower than any lens"),
        "fy_px": Bound(1, 1e6, "px", "narrower than any lens"),
        "position_mm": _COORDINATE,
        "distortion": Bound(-100, 100, "", "OpenCV's rational models reach some tens"),
        "focus_mm": Bound(0.5, 1e4, "mm", "a lens focuses before it, or far away", "unknown"),
        "aperture_mm": Bound(0.01, 100, "mm", "pupils of pinholes begin at 0.1 mm", "a pinhole"),
        "falloff": Bound(0, 8, "", "cos^4 of a simple lens, twice"),
        "raw_width_px": Bound(16, 20_000, "px", "cameras have up to 10,000 columns", "unknown"),
        "raw_height_px": Bound(16, 20_000, "px", "cameras have up to 10,000 rows", "unknown"),
        "crop_x": Bound(0.01, 1, "", "it is a share, and of a hundredth nothing is seen"),
        "crop_y": Bound(0.01, 1, "", "it is a share, and of a hundredth nothing is seen"),
        "gel_refractive_index": Bound(1, 2.5, "", "air has 1, diamond 2.4"),
        "gel_scattering_per_mm": Bound(0, 100, "/mm", "paint scatters within 0.01 mm"),
        "ambient_rgb": Bound(0, 10, "", "many times reflected light is about the direct one's"),
    },
    "light": _LIGHT,
    # Studies of light set lamps far away; a sensor holds its own.
    "lights.led": {"position_mm": _COORDINATE, **_LIGHT},
    "coating": {
        "albedo_rgb": Bound(0, 1, "", "it reflects a share of the light"),
        "specular": _SHARE,
        "roughness": Bound(0.02, 1, "", "GGX is a mirror below and defined up to 1"),
        "thickness_mm": Bound(1e-4, 5, "mm", "sputtered metal has 0.0001 mm", "none"),
    },
    "window": {
        "thickness_mm": Bound(0.05, 100, "mm", "films begin at 0.05 mm"),
        "size_mm": Bound(0.5, 300, "mm", "gels have up to 120 mm"),
        "refractive_index": Bound(1, 2.5, "", "air has 1, diamond 2.4"),
    },
    "markers": {
        "rows": Bound(1, 500, "", "more dots than pixels otherwise"),
        "columns": Bound(1, 500, "", "more dots than pixels otherwise"),
        "pitch_x_mm": Bound(0.1, 50, "mm", "dots are printed 0.3 to 5 mm apart"),
        "pitch_y_mm": Bound(0.1, 50, "mm", "dots are printed 0.3 to 5 mm apart"),
        "offset_mm": Bound(-100, 100, "mm", "gels have up to 120 mm"),
        "rotation_deg": Bound(-180, 180, "degrees", "more is less, the other way"),
        "stagger": Bound(-0.5, 0.5, "", "more is less, the other way"),
    },
    "housing": {
        "size_mm": Bound(1, 1000, "mm", "a sensor is no larger than 1 m"),
        "wall_mm": Bound(0.05, 100, "mm", "sheet metal begins at 0.05 mm"),
        "corner_radius_mm": Bound(0, 500, "mm", "half of the largest housing"),
        "front_z_mm": Bound(-1000, 0, "mm", "the gel stands out of it"),
    },
    "depth_response": {
        "drop_levels": Bound(0, 255, "levels", "a picture has no more"),
        "depth_mm": Bound(0, 50, "mm", "half of the thickest gel"),
        "reading_sigma_mm": _SIGMA_MM,
        "zero_sigma_mm": _SIGMA_MM,
        "depth_share": Bound(0, 2, "", "a depth of which one knows half is none"),
    },
    "perturbation": {
        "gain_rgb": Bound(0, 5, "", "light that varies five times is no light"),
        "pivot_rgb": Bound(0, 255, "levels", "a picture has no more"),
        "offset_rgb": Bound(0, 255, "levels", "a picture has no more"),
        "gradient_rgb": Bound(0, 255, "levels", "a picture has no more"),
        "noise_levels": Bound(0, 255, "levels", "a picture has no more"),
        "mm_per_px_relative": _SHARE,
        "center_px": Bound(0, 1e4, "px", "half of the largest image"),
        "young_modulus_relative": Bound(0, 10, "", "units differ by a few times at most"),
        "friction_coefficient": _SOLID["friction_coefficient"],
    },
}
MOST_BRANCHES = 3
"""Most branches of a viscoelastic gel, as the solver has it (``bodies.material``)."""
BOUNDS: Mapping[str, Mapping[str, Bound]] = MappingProxyType(_TABLE)
"""Bounds by the table of ``profile.toml`` and the key in it; of lists and triples each entry."""
# Residuals, spreads and intervals. Names carry the unit (``heldout_crop_psnr_db``), and what has a
# unit has a range. What is named as a figure of the block has that figure's: a spread is no wider,
# and an interval is of its size.
_UNITS = (
    ("_mm_per_px", Bound(-1, 1, "mm", "a coarse image has 0.5 mm a pixel")),
    ("_levels", Bound(-255, 255, "levels", "a picture has no more")),
    ("_level", Bound(-255, 255, "levels", "a picture has no more")),
    ("_l1", Bound(-255, 255, "levels", "a picture has no more")),
    ("_psnr_db", Bound(-100, 400, "dB", "the rounding of doubles is 310 dB")),
    ("_ssim", Bound(-1, 1, "", "it is a similarity")),
    ("_deg", Bound(-360, 360, "degrees", "more is less")),
    ("_mm2", Bound(-1e6, 1e6, "mm2", "a sensor is no larger than 1 m")),
    ("_nmm", Bound(-1e6, 1e6, "N mm", "1 kN at 1 m")),
    ("_mm", Bound(-1000, 1000, "mm", "a sensor is no larger than 1 m")),
    ("_px", Bound(-20_000, 20_000, "px", "cameras have up to 10,000 columns")),
    ("_pa", Bound(-1e9, 1e9, "Pa", "20 times the hardest elastomer")),
    ("_n", Bound(-1000, 1000, "N", "no gel is pressed harder")),
    ("_s", Bound(-1e6, 1e6, "s", "gels settle in a day")),
)
"""Bounds by the end of the name; a residual may be of either sign, as an offset is."""
_ANY = Bound(-1e9, 1e9, "", "what has no unit in its name is a ratio or a count")


def require_within(table: str, values: object, called: str = "") -> None:
    """Check the figures that ``values``, a block or what a block is made of, has.

    Args:
        table: Key of ``BOUNDS``.
        values: An object with the table's keys as attributes; what it lacks is not looked at.
        called: What messages call it; ``table`` when empty.

    Raises InputError with a line for each figure that lies outside.
    """
    lines = list(out_of_bounds(table, values, called or table))
    if lines:
        raise InputError("\n".join(lines))


def out_of_bounds(table: str, values: object, called: str) -> Iterator[str]:
    """The lines of ``require_within``."""
    for name, bound in BOUNDS.get(table, {}).items():
        yield from bound.faults(f"{called}.{name}", *_numbers(getattr(values, name, None)))
    # Of pydantic's classes, which this module does not load: the solver imports without it.
    for name in getattr(type(values), "model_fields", ()):
        inner = getattr(values, name)
        for number, one in enumerate(inner if isinstance(inner, tuple) else (inner,)):
            if hasattr(type(one), "model_fields"):
                place = f".{number}" if isinstance(inner, tuple) else ""
                yield from out_of_bounds(f"{table}.{name}", one, f"{called}.{name}{place}")


def _numbers(value: object) -> Iterator[float]:
    if isinstance(value, Mapping):
        value = tuple(value.values())
    for one in value if isinstance(value, (tuple, list)) else (value,):
        if isinstance(one, (int, float)):
            yield one


def require_finite(name: str, values: tuple[float, ...], count: int | None = None) -> None:
    """Refuse numbers that are not finite, or not ``count``."""
    if count is not None and len(values) != count:
        raise InputError(f"{name} must be {count} numbers, got {values}")
    if not all(math.isfinite(value) for value in values):
        raise InputError(f"{name} must be finite, got {values}")


class Evidence(Protocol):
    """The tables of a provenance."""

    @property
    def residuals(self) -> Mapping[str, float]: ...
    @property
    def spread(self) -> Mapping[str, float]: ...
    @property
    def valid_region(self) -> Mapping[str, tuple[float, float]]: ...
    @property
    def interval(self) -> Mapping[str, tuple[float, float]]: ...


def evidence_faults(key: str, evidence: Evidence, block: object) -> Iterator[str]:
    """A line for each figure of the evidence of ``block``, of that key, that none can have."""
    own = BOUNDS.get(key, {})
    for table in ("residuals", "spread", "valid_region", "interval"):
        for name, values in getattr(evidence, table).items():
            bound = next((b for end, b in _UNITS if f"_{name}".endswith(end)), _ANY)
            place = f"{key}.provenance.{table}.{name}"
            yield from bound.faults(place, *(values if isinstance(values, tuple) else (values,)))
    for name, sigma in evidence.spread.items():
        place = f"{key}.provenance.spread.{name}"
        if sigma < 0:
            yield f"{place}: must be at least 0, got {sigma:g}: it is a standard deviation"
        elif name in own and not sigma <= own[name].high - own[name].low:
            most = own[name].high - own[name].low
            yield f"{place}: at most {most:g}, the range of {key}.{name}, got {sigma:g}"
    for name, (low, high) in evidence.interval.items():
        value = getattr(block, name, None)
        if name not in own or own[name].low < 0 or not isinstance(value, (int, float)):
            continue
        # What a designer sets in place of a fitted value may lie beside its interval.
        near = 0 <= low <= 10 * value and value / 10 <= high <= 2 * own[name].high
        if value > 0 and not near:
            yield (
                f"{key}.provenance.interval.{name}: must come within a decade of {key}.{name} = "
                f"{value:g}, got [{low:g}, {high:g}]"
            )
