# SPDX-License-Identifier: Apache-2.0
"""Writes a study's report: one self-contained HTML page, its figures as PNG files, and the JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.output import write_json
from taccel_lab.report.build import data_url, report_environment
from taccel_lab.report.mesh_view import MeshView, mesh_view
from taccel_lab.report.style import save_figure
from taccel_lab.studies.design_row import DesignRow
from taccel_lab.studies.report import (
    figures,
    figures_curves,
    figures_designs,
    figures_effects,
)
from taccel_lab.studies.report.values import report_values, sensitivities
from taccel_lab.studies.report.verdict import study_verdict
from taccel_lab.studies.runner import Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_ROWS = 400
"""Rows of the page's table; the CSV has all."""


def write_study_report(outcome: Outcome) -> dict[str, Any]:
    """Write ``report.html``, ``report.json`` and ``figures/*.png`` into the study's folder.

    Returns:
        The figures as written to the JSON.
    """
    values = report_values(outcome)
    verdict = study_verdict(outcome, values)
    values["verdict"] = asdict(verdict)
    root = outcome.folder.root
    (root / "figures").mkdir(exist_ok=True)
    drawn = {}
    for name, draw in _figures(outcome, values):
        path = root / "figures" / f"{name}.png"
        save_figure(draw(), path)
        drawn[name] = data_url(path)
    for stale in (root / "figures").glob("*.png"):
        if stale.stem not in drawn:
            stale.unlink()
    page = (
        report_environment("taccel_lab.studies.report")
        .get_template("study.html.j2")
        .render(
            outcome=outcome,
            study=outcome.study,
            values=values,
            verdict=verdict,
            images=drawn,
            cards=_cards(outcome, values),
            effect_text=figures_effects.cell_text,
            found=sensitivities(outcome),
            most_rows=MOST_ROWS,
        )
    )
    outcome.folder.write_text("report.html", page)
    write_json(root / "report.json", values)
    return values


def _figures(
    outcome: Outcome, values: dict[str, Any]
) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """File name and drawing of every figure that there is something to show in."""
    designs = outcome.done
    if values["measured"]:
        yield "measured", lambda: figures_curves.draw_measured(values["measured"])
    if figures_curves.tool_curves(outcome):
        yield "force_depth", lambda: figures_curves.draw_tools(outcome, contact=False)
    if figures_curves.has_contacts(outcome):
        yield "contact_force", lambda: figures_curves.draw_tools(outcome, contact=True)
    if len(designs) < 2:
        return
    pareto = values["pareto"]
    if pareto is not None:
        best, worst, front = values["best"], values["worst"], pareto["first_designs"]
        yield "pareto", lambda: figures.draw_pareto(outcome, front, best, worst)
        if len(pareto["metrics"]) > 2:
            yield "pairs", lambda: figures.draw_pairs(outcome)
        yield "parallel", lambda: figures.draw_parallel(outcome, front, best)
    found = sensitivities(outcome)
    yield "sensitivities", lambda: figures_effects.draw_sensitivities(outcome, found)
    yield "effects", lambda: figures_effects.draw_effects(outcome, found)
    if figures_effects.has_maps(outcome):
        yield "maps", lambda: figures_effects.draw_maps(outcome)
    ends = _chosen(outcome, values["best"]), _chosen(outcome, values["worst"])
    if figures_designs.drawn_presses(outcome, [*ends[0], *ends[1]]):
        yield "curves", lambda: figures_designs.draw_curves(outcome, *ends)


def _chosen(outcome: Outcome, ids: list[str]) -> list[DesignRow]:
    rows = {row.id: row for row in outcome.rows}
    return [rows[design_id] for design_id in ids]


def _cards(outcome: Outcome, values: dict[str, Any]) -> list[dict[str, Any]]:
    """Designs shown side by side: the best and the worst, or the one nearest to the constraints."""
    wanted = [("best", True, values["best"]), ("worst", False, values["worst"])]
    if values["nearest"] is not None:
        wanted = [("nearest to the constraints", False, [values["nearest"]["design"]])]
    cards = []
    for word, good, ids in wanted:
        for number, row in enumerate(_chosen(outcome, ids)):
            picture = row.files.get("picture")
            path = outcome.folder.root / picture if picture else None
            cards.append(
                {
                    "title": f"{word} {number + 1}" if len(ids) > 1 else word,
                    "good": good,
                    "row": row,
                    "picture": data_url(path) if path is not None and path.is_file() else None,
                    "view": None if cards else _gel_view(row),
                }
            )
    return cards


def _gel_view(row: DesignRow) -> MeshView | None:
    """The untouched gel of a design, at the resolution of profiles; only the first card has one,
    since each is some 100 KB."""
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.sensors.registry import sensor_family

    try:
        mesh = gel_mesh(sensor_family(row.family).parameters(row.parameters).pad())
    except InputError:  # Its sensor is a package or a profile that is no longer there.
        return None
    return mesh_view(mesh.nodes_m, mesh.faces, mesh.face_regions)
