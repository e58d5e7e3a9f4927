# SPDX-License-Identifier: Apache-2.0
"""Between which values the evidence of a block lies: residuals, spreads and intervals.

Names carry the unit (``heldout_crop_psnr_db``), and what has a unit has a range. What is named as
a figure of the block has that figure's: a spread is no wider, and an interval is of its size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from taccel_lab.profile.bounds import BOUNDS, Bound

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
"""By the end of the name; a residual may be of either sign, as an offset is."""
_ANY = Bound(-1e9, 1e9, "", "what has no unit in its name is a ratio or a count")


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
            for value in values if isinstance(values, tuple) else (values,):
                if not bound.allows(value):
                    yield f"{place}: {bound}, got {value:g}: {bound.why}"
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
