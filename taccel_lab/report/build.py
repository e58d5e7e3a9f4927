# SPDX-License-Identifier: Apache-2.0
"""Writes a report: one self-contained HTML page, its figures as PNG files, and the JSON.

The page embeds every figure and its one script, and loads nothing, so it can be mailed as one file.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.output import atomic_file, write_json
from taccel_lab.report import figures, figures_color, figures_mesh
from taccel_lab.report.mesh_view import mesh_view
from taccel_lab.report.model import PressSection, Report
from taccel_lab.report.style import save_figure
from taccel_lab.report.values import report_values, worst_first
from taccel_lab.report.verdict import judge_targets, reach_verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FigureMaker = Callable[[], "Figure"]


def write_report(report: Report, directory: Path | str) -> dict[str, Any]:
    """Write ``report.html``, ``report.json`` and ``figures/*.png`` into ``directory``.

    Returns:
        The figures as written to the JSON.
    """
    directory = Path(directory)
    (directory / "figures").mkdir(parents=True, exist_ok=True)
    images: dict[str, str] = {}
    for name, draw in _figures(report):
        path = directory / "figures" / f"{name}.png"
        save_figure(draw(), path)
        images[name] = data_url(path)
    values = report_values(report)
    results = judge_targets(report, values)
    verdict = reach_verdict(report, values, results)
    values["targets"] = [
        {**asdict(result.target), "value": result.value, "met": result.met} for result in results
    ]
    values["verdict"] = asdict(verdict)
    page = (
        report_environment()
        .get_template("report.html.j2")
        .render(
            report=report,
            values=values,
            results=results,
            verdict=verdict,
            images=images,
            view=mesh_view(report.mesh.nodes_m, report.mesh.faces, report.mesh.face_regions),
        )
    )
    with atomic_file(directory / "report.html") as staging:
        staging.write_text(page, encoding="utf-8", errors="backslashreplace")
    write_json(directory / "report.json", values)
    return values


def data_url(path: Path) -> str:
    """A PNG file as text that a page embeds."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def _figures(report: Report) -> Iterator[tuple[str, FigureMaker]]:
    """File name and drawing of every figure that the report's sections call for."""
    ordered = worst_first(report.color)
    for index, frame in enumerate(ordered):
        yield f"frame_{index:02d}", lambda frame=frame: figures_color.draw_heldout_frame(frame)
    if ordered:
        yield "frame_full", lambda: figures_color.draw_full_frame(ordered[0])
    yield "color_model", lambda: figures_color.draw_color_discs(report.color.discs)
    yield "loss", lambda: figures_color.draw_loss(report.color.loss)
    yield from _press_figures(report.press)
    yield "mesh", lambda: figures_mesh.draw_mesh(report.mesh)
    yield "dihedral", lambda: figures_mesh.draw_dihedral_histogram(report.mesh)
    if report.detection is not None:
        detection = report.detection
        yield "detection", lambda: figures_color.draw_detection(detection)


def _press_figures(press: PressSection) -> Iterator[tuple[str, FigureMaker]]:
    maps = press.maps
    yield "force_depth", lambda: figures.draw_force_depth(press.force_depth)
    yield "height_map", lambda: figures.draw_height_map(maps.height_m, maps.grid)
    yield "normals", lambda: figures.draw_normals(maps.normals, maps.grid)
    rgb = maps.rgb
    if rgb is not None:
        yield "image", lambda: figures.draw_image(rgb, maps.grid)
    yield (
        "contact_forces",
        lambda: figures.draw_contact_forces(
            maps.positions_m, maps.contact_faces, maps.forces_n, maps.pressures_pa
        ),
    )


def report_environment(*packages: str) -> Any:
    """Jinja2 environment of the templates here and of other packages, which come first."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.PackageLoader(name) for name in (*packages, "taccel_lab.report")]
        ),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = format_number
    return environment


def format_number(value: Any, digits: int | None = None) -> str:
    """A number for a table cell: fixed digits, or four significant ones; a dash for none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if digits is not None:
        return f"{value:.{digits}f}"
    if isinstance(value, int):
        return f"{value:,}"
    size = abs(value)
    if size != 0 and (size < 1e-3 or size >= 1e5):
        return f"{value:.2e}"
    return f"{value:.4g}"
