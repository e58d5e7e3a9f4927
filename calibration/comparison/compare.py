# SPDX-License-Identifier: Apache-2.0
"""The whole comparison of two profiles, as JSON and as a page."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from taccel_lab.calibration.comparison import remarks
from taccel_lab.calibration.comparison.fields import FieldDifference, compare_fields
from taccel_lab.calibration.comparison.figures import draw_backgrounds, draw_color_responses
from taccel_lab.calibration.comparison.responses import ResponseDifference, compare_responses
from taccel_lab.profile import SensorProfile
from taccel_lab.report.page import Page, Picture, Table
from taccel_lab.report.remark import Remark

COLOR_SHARE = 0.15
"""Colour responses that differ by more than this part of their size are called different."""


@dataclass(frozen=True)
class ProfileComparison:
    """What differs between two profiles."""

    a: SensorProfile
    b: SensorProfile
    names: tuple[str, str]
    fields: list[FieldDifference]
    responses: ResponseDifference
    remarks: tuple[Remark, ...]

    def figures(self) -> dict[str, Any]:
        """Everything compared, ready for JSON."""
        return {
            "a": self.names[0],
            "b": self.names[1],
            "fields": [asdict(f) | {"significant": f.significant} for f in self.fields],
            "responses": asdict(self.responses),
        }

    def page(self) -> Page:
        """The comparison as a page with pictures of both."""
        pictures = []
        if self.a.background_rgb is not None and self.b.background_rgb is not None:
            pictures.append(
                Picture(
                    "backgrounds",
                    lambda: draw_backgrounds(self.a, self.b, self.names),
                    "Images at rest, and their difference about middle grey (times 2).",
                )
            )
        if self.a.color is not None and self.b.color is not None:
            pictures.append(
                Picture(
                    "color_responses",
                    lambda: draw_color_responses(self.a, self.b, self.names),
                    "Colour change over the hemisphere of normals, 0.3 mm below rest, at the "
                    "middle and near the corners: a, b, and their difference (times 2) about "
                    "middle grey. The rim is a tilt of 44 degrees.",
                )
            )
        return Page(
            title=f"{self.names[0]} against {self.names[1]}",
            summary=f"{len(self.fields)} values differ; a {self.a.sensor.family} against a "
            f"{self.b.sensor.family}.",
            remarks=self.remarks,
            tables=(_response_table(self.responses), _field_table(self.fields)),
            pictures=tuple(pictures),
            figures=self.figures(),
        )


def compare_profiles(
    a: SensorProfile, b: SensorProfile, names: tuple[str, str] = ("a", "b")
) -> ProfileComparison:
    """Compare two profiles: values with their spreads, then what they do."""
    fields, responses = compare_fields(a, b), compare_responses(a, b)
    return ProfileComparison(
        a, b, names, fields, responses, tuple(_remarks(a, b, fields, responses))
    )


def _remarks(
    a: SensorProfile,
    b: SensorProfile,
    fields: list[FieldDifference],
    responses: ResponseDifference,
) -> list[Remark]:
    said = []
    if a.sensor.family != b.sensor.family:
        said.append(remarks.OTHER_FAMILY(a=a.sensor.family, b=b.sensor.family))
    said += [
        remarks.SIGNIFICANT(
            block=found.block, field=found.field, difference=found.difference, z=abs(found.z or 0)
        )
        for found in fields
        if found.significant
    ]
    share = _color_share(responses)
    if share is not None and share > COLOR_SHARE:
        said.append(remarks.OTHER_COLORS(share=share))
    return said


def _color_share(responses: ResponseDifference) -> float | None:
    if responses.color_l1_levels is None or not responses.color_size_levels:
        return None
    return responses.color_l1_levels / responses.color_size_levels


def _response_table(responses: ResponseDifference) -> Table:
    gain = responses.background_gain_rgb
    rows = [
        ("image at rest, mean difference [levels]", responses.background_l1_levels),
        ("its mean level, b over a (R, G, B)", None if gain is None else _triple(gain)),
        ("colour change, mean difference [levels]", responses.color_l1_levels),
        ("colour change, largest difference [levels]", responses.color_max_levels),
        ("colour change of a, mean size [levels]", responses.color_size_levels),
        ("grey drop to depth, largest difference [mm]", responses.depth_response_max_mm),
        ("volume of the gel [relative]", responses.volume_relative),
        ("area of the contact face [relative]", responses.contact_area_relative),
    ]
    return Table("What they do", ("quantity", "b against a"), rows)


def _triple(values: tuple[float, float, float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)


def _field_table(fields: list[FieldDifference]) -> Table:
    order = sorted(fields, key=lambda f: (not f.significant, f.block))
    rows = [(f"{f.block}.{f.field}", f.a, f.b, f.difference, f.relative, f.z) for f in order]
    return Table(
        "What they say",
        ("key", "a", "b", "b - a", "relative", "z"),
        rows,
        caption="z: difference over its standard deviation, from the spreads that the blocks "
        "state; beyond 1.96 the spreads do not explain it.",
    )
