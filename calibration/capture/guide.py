# SPDX-License-Identifier: Apache-2.0
"""What to capture of a sensor, and why: steps with counts, minutes and equipment, and a manifest.

The numbers follow from the sensor's figures in the catalogue: a ball whose contacts are a tenth of
the view wide when it is pressed a quarter of the gel's thickness deep (``a^2 = 2 R d``), and force
records up to that depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from taccel_lab.calibration.capture.sensor_facts import SensorFacts, sensor_facts
from taccel_lab.errors import InputError
from taccel_lab.sensors import sensor_family

DEPTH_SHARE = 0.25
"""Deepest press, of the gel's thickness: deeper ones feel the window more than the gel."""
CONTACT_SHARE = 0.1
BALLS_MM = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
"""Radii of bearing balls that are easy to get."""
CURVED_MM, DOME_MM = 0.5, 3.0
"""Drop of the face over the view from which presses have to follow its normal, or go round it."""
COLOR_PRESSES, GREY_PRESSES = 40, 10
"""Presses of a ball, on sensors whose colours or whose grey levels are learned."""
GENERIC_VIEW_MM, GENERIC_THICKNESS_MM = 20.0, 4.0


@dataclass(frozen=True)
class Step:
    """One session at the desk."""

    block: str
    """Command that needs it."""
    title: str
    count: str
    minutes: int
    equipment: str
    how: str
    why: str
    optional: bool = False


@dataclass(frozen=True)
class CapturePlan:
    """Everything to capture of one sensor."""

    sensor: str
    title: str
    ball_radius_mm: float
    press_count: int
    """Ball presses."""
    depth_mm: float
    """Deepest press."""
    steps: tuple[Step, ...]
    manifest: str
    """A ``captures.toml`` to fill in."""

    @property
    def minutes(self) -> int:
        return sum(step.minutes for step in self.steps)


def capture_plan(sensor: str) -> CapturePlan:
    """The plan for a sensor of the catalogue.

    Raises:
        InputError: The catalogue has no such sensor; the message names those it has.
    """
    family = sensor_family(sensor)
    facts = sensor_facts(family.name)
    if facts is None:
        raise InputError(f"no sensor {sensor!r} in the catalogue")
    view = facts.view_mm or GENERIC_VIEW_MM
    thickness = facts.thickness_mm or GENERIC_THICKNESS_MM
    # A dome is as high as it is wide; what yields is no thicker than an ordinary pad.
    depth = round(DEPTH_SHARE * min(thickness, 2 * GENERIC_THICKNESS_MM), 1)
    wanted = (CONTACT_SHARE * view) ** 2 / (2 * depth)
    ball = min(BALLS_MM, key=lambda radius: abs(math.log(radius / wanted)))
    steps = [
        _settings(),
        _untouched(),
        *_scale(facts),
        _grey_balls(4.0, depth) if facts.is_grey else _balls(ball, depth, facts.drop_mm),
    ]
    if facts.drop_mm > DOME_MM:
        steps.append(_round_the_dome(depth, "depth" if facts.is_grey else "color, normals"))
    if facts.has_markers:
        steps.append(_markers())
    yielding = min(thickness, 2 * GENERIC_THICKNESS_MM)
    steps.append(_indentation(depth, yielding))
    radius = 4.0 if facts.is_grey else ball
    return CapturePlan(
        sensor=family.name,
        title=family.title,
        ball_radius_mm=radius,
        press_count=GREY_PRESSES if facts.is_grey else COLOR_PRESSES,
        depth_mm=depth,
        steps=tuple(steps),
        manifest=_manifest(facts, radius, round(yielding)),
    )


def _settings() -> Step:
    return Step(
        "all",
        "Settings",
        "once",
        5,
        "the sensor, a stand that holds it still",
        "Wipe the gel. Let the lamps warm up for 5 minutes. Switch automatic exposure, gain and "
        "white balance off, and set the exposure so that a deep press reaches 240 levels at most. "
        "Save PNG, never scaled or cropped afterwards.",
        "A camera that adapts changes the colours that are to be learned, by 20 levels and more.",
    )


def _untouched() -> Step:
    return Step(
        "background",
        "Untouched gel",
        "1 + 5 images",
        2,
        "-",
        "One image before the first press (background), five more spread over the session, each a "
        "few seconds after the gel has come back (untouched).",
        "Everything is measured against it; the others show noise and drift.",
    )


def _scale(facts: SensorFacts) -> list[Step]:
    if facts.is_grey:
        return [
            Step(
                "scale",
                "Board of dots",
                "1 press, 1 reference",
                5,
                "the dot board (7 x 9 dots, 2.5 mm) or any flat grid of known pitch",
                "Press the board flat until all dots show; take the reference without it.",
                "Scale along x and y, distortion, and how the camera looks at the gel.",
            )
        ]
    return [
        Step(
            "scale",
            "Known edge",
            "10 presses",
            5,
            "a 10 mm gauge block or a steel cube, measured with callipers",
            "Press its edge into the gel level, so that both ends show, along x, along y and in "
            "between, near the middle and near the rim.",
            "Millimetres per pixel along x and y: published figures for one and the same sensor "
            "differ by a quarter, and all forces and slopes scale with it.",
        ),
        Step(
            "camera",
            "Board before the lens",
            "20 views",
            8,
            "a printed chessboard of 7 x 7 squares of 2 to 3 mm; only with the gel off, or an open "
            "camera",
            "Tilt it by up to 40 degrees to all sides and bring it into every corner.",
            "Distortion of a wide lens. Leave it out when the gel cannot come off and straight "
            "edges look straight.",
            optional=True,
        ),
    ]


def _balls(radius_mm: float, depth_mm: float, drop_mm: float) -> Step:
    curved = (
        f" The face falls by {drop_mm:.1f} mm to the sides: there, press along its normal, not "
        "along the camera's axis."
        if drop_mm > CURVED_MM
        else ""
    )
    return Step(
        "color, normals",
        "Ball presses",
        f"{COLOR_PRESSES} presses",
        12,
        f"a bearing ball of {radius_mm:g} mm radius ({2 * radius_mm:g} mm diameter) on a stick",
        f"12 places (4 columns x 3 rows, also near the rim) at about 3 depths each, up to "
        f"{depth_mm:g} mm; press straight down, hold still, then take the image. 4 more anywhere. "
        f"No circles need be drawn. With a stage, note depth_mm; with a cell, force_n.{curved}",
        "Colour against slope at every place. Where no ball was, nothing is known.",
    )


def _round_the_dome(depth_mm: float, block: str) -> Step:
    return Step(
        block,
        "Sides of the dome",
        "16 presses",
        5,
        "the same ball, a turntable or a vice that holds the sensor tilted",
        f"Eight directions round the dome, half way down and near its foot, up to {depth_mm:g} mm, "
        "always along the normal of the gel.",
        "The camera sees the sides at a slant and the lamps reach them otherwise than the top.",
    )


def _grey_balls(radius_mm: float, depth_mm: float) -> Step:
    return Step(
        "depth",
        "Ball presses",
        f"{GREY_PRESSES} presses",
        4,
        f"a bearing ball of {radius_mm:g} mm radius ({2 * radius_mm:g} mm diameter) on a stick",
        f"Five places, one light and one deep press each (deepest about {depth_mm:g} mm).",
        "How grey levels fall with depth, and whether they do so alike all over the gel.",
    )


def _markers() -> Step:
    return Step(
        "markers",
        "Moving dots",
        "1 image, 3 videos of 10 s",
        4,
        "a finger or a flat stamp",
        "An image at rest; then press, press and push sideways, press and twist. 25 frames per "
        "second or more, starting and ending at rest. Measure the dots' pitch with callipers.",
        "Where the dots are, how they are followed, and how far shear and twist move them.",
    )


def _indentation(depth_mm: float, thickness_mm: float) -> Step:
    return Step(
        "material",
        "Force against depth",
        "1 flat punch, 1 ball, 8 depths each",
        15,
        "a micrometer or printer stage and a load cell (or kitchen scale), a flat round punch of "
        f"about {thickness_mm:.2g} mm radius (a ground pin; break its edge, no more) and a ball of "
        f"at most {0.5 * thickness_mm:.2g} mm radius",
        f"From first touch to {depth_mm:g} mm in 8 steps; read the force a few seconds after each "
        "step. Newtons and millimetres. A record of each tool in the same folder. Set the zero "
        "with the punch, square to the gel: at 0.05 N it is 0.01 mm in a gel of 0.3 MPa, a ball is "
        "0.1 to 0.15 mm deep by then.",
        "Young's modulus and its law. Published moduli differ tenfold. One "
        "tool gives Young's modulus only together with Poisson's ratio (5 to 15 %); a punch as "
        "wide as the gel is thick and a narrow ball give both (1 to 2 %), and a zero that is "
        "0.15 mm late makes the force of a ball at 0.5 mm half as large again.",
    )


def _manifest(facts: SensorFacts, radius_mm: float, punch_mm: float) -> str:
    lines = [
        "schema_version = 2",
        f'sensor = "{facts.family}"',
        'unit = "serial number"',
        'background = "background.png"',
        'untouched = ["untouched_1.png", "untouched_2.png"]',
        "# mm_per_px_x = 0.06    # only where you know them; calibrate scale finds them",
        "# mm_per_px_y = 0.06",
        'source = "bench, date, who"',
        "",
        "# [design]             # what you measured here and the catalogue has otherwise:",
        "# thickness_mm = 4.0   # of the gel; taccel-lab sensors show lists the names",
        "",
        "[indenter]",
        f"diameter_mm = {2 * radius_mm:g}    # what the callipers say",
        "",
        "[[presses]]    # one for each ball press",
        'image = "press_000.png"',
        "# depth_mm = 0.5",
        "# force_n = 0.8",
        "",
    ]
    if facts.is_grey:
        lines += [
            "[[boards]]",
            'kind = "dots"',
            "columns = 9",
            "rows = 7",
            "pitch_mm = 2.5",
            "on_gel = true",
            'images = ["board.png"]',
            'reference = "board_reference.png"',
            "",
        ]
    else:
        lines += [
            "[[edges]]    # one for each press of the edge",
            'image = "edge_0.png"',
            "length_mm = 10.0",
            "",
            "# [[boards]]",
            '# kind = "chessboard"',
            "# columns = 6    # inner corners",
            "# rows = 6",
            "# pitch_mm = 2.5",
            '# images = ["board_00.png", "board_01.png"]',
            "",
        ]
    if facts.has_markers:
        lines += [
            "[markers]",
            'rest = "background.png"',
            "# pitch_x_mm = 2.0",
            "# pitch_y_mm = 2.0",
            "",
            "[[markers.videos]]",
            'file = "shear.avi"',
            'motion = "shear"',
            "",
        ]
    lines += [
        "[[records]]",
        'file = "indentation.csv"    # header: depth_mm,force_n',
        'kind = "indentation"',
        f'tool = {{ kind = "cylinder", radius_mm = {punch_mm:g} }}    # a flat round punch',
        "force_sigma_n = 0.02",
        "",
        "# [[records]]",
        '# file = "indentation_ball.csv"    # a second tool: it separates E from nu',
        '# kind = "indentation"',
        f'# tool = {{ kind = "sphere", radius_mm = {0.5 * punch_mm:g} }}',
    ]
    return "\n".join(lines) + "\n"
