# SPDX-License-Identifier: Apache-2.0
"""A press as a page: what the sensor sees beside its photo, how deep, how strong, how good."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.files.atomic_file import image_file
from taccel_lab.report.figures import depth_panel, twofold_difference
from taccel_lab.report.lead import Link, Picture, Score, Strip
from taccel_lab.report.page import PAGE, Page, Table, write_page_file
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.with_error import with_error

if TYPE_CHECKING:
    from taccel_lab.presses import PressPath
    from taccel_lab.presses.numerical_error import SignalError
    from taccel_lab.presses.press import Press

_PICTURES = {
    "scene.png": "What is pressed where, and the gel's mesh.",
    "contact_pressure.png": "Contact pressure, and tangential forces as arrows.",
    "force_depth.png": "Force over depth.",
    "height_map.png": "Height of the contact face.",
    "normals.png": "Surface normals.",
    "markers.png": "Dots at rest and now.",
}
"""Pictures of a press folder that its page shows below the figures, with captions."""
_FILES = ("press.json", "signals.npz", "gel.vtu", "states.npz", "markers.csv", "image_raw.png")
"""Files of a press folder that its page links to."""
_JPEG = (1, 95)  # cv2.IMWRITE_JPEG_QUALITY, which only a page that is written has to load.


def write_press_page(press: Press, folder: Path) -> None:
    """Write the page of a press into its folder, whose pictures are there."""
    write_page_file(press_page(press, folder), folder / PAGE)


def press_page(press: Press, folder: Path) -> Page:
    """The page of a press whose files are in ``folder``."""
    stopped = []
    if press.failure is not None:
        said = f"{press.failure}; missing: {', '.join(press.missing)}"
        stopped.append(Remark(Severity.ERROR, "stopped", said))
    notes = [Remark(Severity.INFO, "note", text) for text in press.plan.notes()]
    notes.append(Remark(Severity.INFO, "force_interval", press.force_interval.words()))
    if press.error is not None:
        words = f"numerical error {press.error.words()}"
        notes.append(Remark(Severity.INFO, "numerical_error", words))
    return Page(
        press.summary()[0],
        "",
        [*stopped, *notes],
        [Table("Figures", ("figure", "value", "unit"), list(press_rows(press)))],
        [
            Picture(name, (folder / name).read_bytes, caption)
            for name, caption in _PICTURES.items()
            if (folder / name).is_file()
        ],
        headline="Stopped before its end" if stopped else "Simulated press",
        strips=[press_strip(press)],
        scores=press_scores(press),
        links=[Link(name, name) for name in _FILES if (folder / name).is_file()],
    )


def press_strip(press: Press, name: str = "", links: Iterable[Link] = ()) -> Strip:
    """What the press looks like: photo, simulation, difference and depth of one that is like a
    photo; image, depth and contact of another.

    Args:
        press: The press.
        name: What its title begins with, and the names of its pictures.
        links: To what there is of it.
    """

    def panel(key: str, draw: Any, caption: str) -> Picture:
        return Picture(f"{name}_{key}" if name else key, draw, caption)

    photo, like = press.plan.photo, press.like
    title = f"{name}: " if name else ""
    if photo is None or like is None:
        panels = []
        if press.image is not None:
            panels.append(panel("image", _jpeg(press.image), f"image, {press.colours}"))
        depth = _jpeg(depth_panel(1e3 * press.depth_m, press.depth_mm))
        deepest = with_error(press.depth_mm, press.depth_error_mm)
        panels.append(panel("depth", depth, f"depth, to {deepest} mm"))
        contact = _jpeg(np.where(press.contact_mask, 40, 235))
        panels.append(panel("contact", contact, "contact, dark"))
        return Strip(f"{title}{_force_words(press)}", panels, tuple(links))
    simulated = press.simulated_photo
    assert simulated is not None
    depth = _jpeg(depth_panel(photo.read_depth_mm, photo.seen.depth_mm))
    return Strip(
        f"{title}{like['psnr_db']:.1f} dB, {with_error(photo.depth_mm, photo.depth_error_mm)} mm "
        f"deep, {_force_words(press)}",
        (
            panel("photo", _jpeg(photo.rgb), "photo"),
            panel("simulated", _jpeg(simulated), "simulation of the press"),
            panel(
                "difference",
                _jpeg(twofold_difference(simulated, photo.rgb)),
                "difference x 2; grey is none",
            ),
            panel("depth", depth, "depth read from the photo, its deepest place brightest"),
        ),
        tuple(links),
    )


def press_scores(press: Press) -> tuple[Score, ...]:
    """How near to the photo, how deep, how strong, how exact."""
    found = []
    photo, like = press.plan.photo, press.like
    if photo is not None and like is not None:
        found.append(
            Score(
                f"{like['psnr_db']:.1f}",
                "dB",
                "simulation against the photo (PSNR)",
                "in a crop of 1.6 contact radii, placed where both images read alike; the "
                f"untouched image scores {like['untouched_psnr_db']:.1f}",
            )
        )
        depth = with_error(photo.depth_mm, photo.depth_error_mm), "depth of the press"
        found.append(Score(depth[0], "mm", depth[1], "by the photo; +- is one standard deviation"))
    else:
        deepest = with_error(press.depth_mm, press.depth_error_mm)
        found.append(Score(deepest, "mm", "deepest place", "simulated; +- is its whole error, rms"))
    return (*found, force_score(press))


def force_score(press: Press) -> Score:
    """The force, with what it rests on."""
    low, high = press.force_interval_n
    widest = press.force_interval.ranked()[0]
    return Score(
        _two_digits(press.force_n),
        "N",
        f"normal force; 95 %: {_two_digits(low)} to {_two_digits(high)} N",
        f"simulated; the interval rests most on {widest.name}",
    )


def _force_words(press: Press) -> str:
    return f"{_two_digits(press.force_n)} N"


def _two_digits(value: float) -> str:
    """What the interval of a force leaves of it."""
    return f"{float(f'{value:.2g}') + 0.0:g}"


def _jpeg(levels: np.ndarray) -> Any:
    return partial(image_file, levels, ".jpg", _JPEG)


def press_rows(press: Press) -> Iterator[tuple[str, str, str]]:
    """Figures of a press: what, value, unit."""
    figures = press.figures()
    force, moment, image = press.wrench[:3], 1e3 * press.wrench[3:], press.image_error
    error_n, heights = press.force_error_n, press.height_error
    ends = press.force_interval_n
    yield from _path_rows(press.path, figures)
    yield "normal force, numerical error", with_error(force[2], error_n), "N"
    yield "its 95 % interval, all causes", " to ".join(f"{end:.3g}" for end in ends), "N"
    errors = (press.shear_error_n, press.shear_error_n, error_n)
    yield "force of the gel on the indenter", _each(force, errors), "N"
    errors = (1e3 * error for error in press.moment_error_nm)
    yield "moment about the gel's origin", _each(moment, errors), "N mm"
    yield "error of heights: numerical, total", _both(heights, 1e3), "um rms"
    yield "contact radius (equal area)", f"{figures['contact_radius_mm']:.3f}", "mm"
    yield "force residual", f"{figures['residual_n']:.1e}", "N"
    yield "Newton iterations", f"{figures['newton_iterations']}", ""
    yield "smallest gap", f"{figures['min_distance_m'] * 1e6:.2f}", "um"
    yield "smallest volume ratio of a tet", f"{figures['smallest_volume_ratio']:.3f}", ""
    yield "nodes, tets", f"{press.mesh.node_count}, {press.mesh.tet_count}", ""
    if image is not None:
        yield "error of the image: numerical, total", _both(image), "levels rms"
    if (like := press.like) is not None:
        place = zip("xy", like["at_mm"], like["at_error_mm"] or (None, None), strict=True)
        for axis, at, sigma in place:
            yield f"place in the photo, {axis}", with_error(at, sigma), "mm"
        yield "depth in the photo", with_error(like["depth_mm"], like["depth_error_mm"]), "mm"
        yield "photo and simulation, crop", f"{like['psnr_db']:.1f}", "dB"
        yield "photo and untouched image", f"{like['untouched_psnr_db']:.1f}", "dB"
    if press.fine_force_n is not None:
        yield "force of the contact with the texture", f"{press.fine_force_n:.4f}", "N"


def _path_rows(path: PressPath, figures: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Where the indenter ended and what it met; after a way back all else is of its end."""
    if path.back:
        yield "deepest, past first touch", f"{path.depth_mm:.4g}", "mm"
    if (hold := figures.get("hold")) is not None:
        fall = f"{hold['from_n']:.4g}  {hold['to_n']:.4g}"
        yield f"force before and after {hold['seconds']:g} s of hold", fall, "N"
    if (loop := figures.get("loop")) is not None:
        works = f"{loop['work_mj']:.4g}  {loop['lost_mj']:.4g}"
        yield "work of the press, lost on the way back", works, "mJ"
    yield "depth past first touch", f"{figures['steps'][-1]['depth_mm']:.4g}", "mm"


def _each(values: Iterable[float], errors: Iterable[float]) -> str:
    both = zip(values, errors, strict=True)
    return ", ".join(with_error(float(value), error) for value, error in both)


def _both(error: SignalError, unit: float = 1.0) -> str:
    return "  ".join(f"{float(f'{unit * one:.2g}'):g}" for one in (error.numerical, error.total))
