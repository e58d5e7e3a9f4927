# SPDX-License-Identifier: Apache-2.0
"""A study as a page: what is best, what it trades for what, and every design."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.report.figures import draw_mesh
from taccel_lab.report.lead import Picture, Score
from taccel_lab.report.mesh_view import MeshView, mesh_view
from taccel_lab.report.page import Page, Table, format_number, write_page_into
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.report import figures, figures_effects
from taccel_lab.studies.report.answer import study_verdict
from taccel_lab.studies.report.sensitivity import Sensitivity
from taccel_lab.studies.report.values import report_values, sensitivities

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MOST_ROWS = 400
"""Rows of the page's table; the CSV has all."""
FIGURES = "figures"
"""Folder of the pictures."""
MOST_SCORES = 4
"""Metrics that open the page."""
_NAMED = 3
"""Designs that a row of missing figures names."""

Values = dict[str, Any]


def study_page(outcome: StudyOutcome) -> Page:
    """The report of a study; pictures are drawn when it is written."""
    found = sensitivities(outcome)
    values = report_values(outcome, found)
    verdict = study_verdict(outcome, values)
    values["verdict"] = {
        "good": verdict.good,
        "headline": verdict.headline,
        "sentences": [*verdict.sentences, *(remark.message for remark in verdict.remarks)],
    }
    counts, study = values["counts"], outcome.study
    about = (
        f"{values['sensor_title']}: {counts['rows']} of {counts['designs']} designs, "
        f"{len(study.presses)} presses, {len(study.metrics)} metrics."
    )
    tables = (
        _compared(outcome, values),
        _effects(outcome, values, found),
        _failures(values),
        _gaps(values),
        _designs(values),
        _parameters(values),
        _metrics(values),
        _cost(values),
    )
    return Page(
        title=values["study"],
        summary=" ".join((about, *verdict.sentences)),
        remarks=verdict.remarks,
        tables=[table for table in tables if table is not None],
        pictures=tuple(_pictures(outcome, values, found)),
        figures=values,
        headline=verdict.headline,
        scores=tuple(_scores(outcome, values)),
    )


def _scores(outcome: StudyOutcome, values: Values) -> Iterator[Score]:
    """Metrics of the design that is shown first, the goal's before the others."""
    ends = _ends(outcome, values)
    if not ends:
        return
    word, row = ends[0]
    others = f"; {ends[-1][0]}: {{}}" if len(ends) > 1 else ""
    names = sorted(values["metrics"], key=lambda name: name not in (values["goal"] or ""))
    for name in names[:MOST_SCORES]:
        unit = values["metrics"][name]["unit"]
        yield Score(
            format_number(row.figures[name]),
            "" if unit == "1" else unit,
            name.replace("_", " "),
            f"{word}: {values['names'][row.id]}"
            + others.format(format_number(ends[-1][1].figures[name])),
        )


def _named(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} [{unit}]"


def _ends(outcome: StudyOutcome, values: Values) -> list[tuple[str, DesignRow]]:
    """Designs shown side by side: the best and the worst, or the one nearest to the constraints."""
    wanted = [("best", values["best"]), ("worst", values["worst"])]
    if values["nearest"] is not None:
        wanted = [("nearest to the constraints", [values["nearest"]["design"]])]
    rows = {row.id: row for row in outcome.rows}
    return [
        (f"{word} {number}" if len(ids) > 1 else word, rows[key])
        for word, ids in wanted
        for number, key in enumerate(ids, 1)
    ]


def _compared(outcome: StudyOutcome, values: Values) -> Table | None:
    ends = _ends(outcome, values)
    if not ends:
        return None
    rows: list[list[Any]] = [["design", *(values["names"][row.id] for _, row in ends)]]
    rows += [
        [item["label"], *(row.parameters[name] for _, row in ends)]
        for name, item in values["parameters"].items()
    ]
    rows += [
        [_named(name, item["unit"]), *(row.figures[name] for _, row in ends)]
        for name, item in values["metrics"].items()
    ]
    caption = ""
    if values["goal"]:
        bounds = " and ".join(values["constraints"])
        caption = f"Ranked by {values['goal']}" + (f", among designs with {bounds}." * bool(bounds))
    return Table("Best and worst designs", ["", *(word for word, _ in ends)], rows, caption)


def _effects(outcome: StudyOutcome, values: Values, found: dict[str, Sensitivity]) -> Table | None:
    if len(outcome.done) < 2:
        return None
    rows = []
    for name, item in found.items():
        cells = []
        for parameter in values["parameters"]:
            effect = item.effects[parameter]
            text = figures_effects.cell_text(effect)
            if item.lacking and effect.compared < item.count:
                text += f" ({effect.compared or 'none'} can be compared)"
            cells.append(text)
        known = f"{item.count} of {item.count + item.lacking}" if item.lacking else item.count
        rows.append((name, *cells, item.r2, known))
    columns = ("metric", *values["parameters"], "R² of the fit", "designs with a figure")
    kind = values["sweep"]["kind"]
    other = (
        "η²: share of the metric's variance that the parameter's levels explain by themselves, "
        "among designs with a figure at each of its values while all others stay the same."
        if kind == "grid"
        else "ρ: Spearman's rank correlation."
        + (" An optimiser's designs crowd around its optimum." if kind == "optimize" else "")
    )
    caption = (
        "Signed number: elasticity, the percent by which a metric changes for one percent more of "
        f"the parameter, by least squares in logarithms over all designs. {other}"
    )
    return Table("Sensitivities", columns, rows, caption, folded=True)


def _failures(values: Values) -> Table | None:
    rows = [
        (*(item[name] for name in values["parameters"]), item["status"], item["cause"])
        for item in values["failures"]
    ]
    caption = (
        "failed: the design cannot be built or pressed. broken: lost to a fault or a killed "
        "process; the next run tries it again."
    )
    columns = (*values["parameters"], "state", "cause")
    return Table("What failed", columns, rows, caption) if rows else None


def _gaps(values: Values) -> Table | None:
    rows = [
        (
            item["what"],
            len(item["designs"]),
            "; ".join(values["names"][key] for key in item["designs"][:_NAMED])
            + (f" and {len(item['designs']) - _NAMED} more" * (len(item["designs"]) > _NAMED)),
            item["cause"],
        )
        for item in values["gaps"]
    ]
    return Table("Missing figures", ("what", "designs", "which", "cause"), rows) if rows else None


def _designs(values: Values) -> Table:
    def figure(row: dict[str, Any], name: str) -> str:
        low, high, value = row.get(f"{name} low"), row.get(f"{name} high"), row[name]
        text = format_number(value)
        has_interval = value is not None and not (low is None and high is None)
        if has_interval and (low is None or high is None or high - low > 1e-6 * high):
            text += f" ({format_number(low)} to {format_number(high)})"
        return text

    shown = values["designs"][:MOST_ROWS]
    rows = [
        (
            *(row[name] for name in values["parameters"]),
            *(figure(row, name) for name in values["metrics"]),
            "off bounds" if not row.get("feasible", True) else row["status"],
            row["design"],
        )
        for row in shown
    ]
    cut = f"The first {len(shown)} of {len(values['designs'])} rows. "
    caption = (
        (cut if len(values["designs"]) > len(shown) else "")
        + "In brackets: between the softest and the stiffest gel that the design may be, by its "
        f"Shore hardness, by what units differ ({format_number(values['unit_spread_percent'])} % "
        "standard deviation) and by Poisson's ratio up to 0.499, where they are not given "
        "otherwise; –: an end that the press does not reach. designs.csv has every row with all "
        "digits; designs/FOLDER/ keeps mesh, pictures and curves of each."
    )
    named = [item["label"] for item in values["parameters"].values()]
    named += [_named(name, item["unit"]) for name, item in values["metrics"].items()]
    return Table("All designs", (*named, "state", "folder"), rows, caption, folded=True)


def _parameters(values: Values) -> Table:
    rows = [
        (
            item["label"], item["values"], item["low"], item["high"],
            item["default"], item["description"],
        )
        for name, item in values["parameters"].items()
    ]  # fmt: skip
    columns = ("parameter", "values", "from", "to", "default", "meaning")
    return Table("Parameters", columns, rows, _setup(values), folded=True)


def _setup(values: Values) -> str:
    sweep = values["sweep"]
    how = {
        "random": f", {sweep.get('sampler')}, seed {values['seed']}",
        "optimize": f", {sweep.get('method')}, seed {values['seed']}",
    }.get(sweep["kind"], "")
    fixed = ", ".join(f"{name} = {value}" for name, value in values["fixed"].items())
    return (
        f"Sweep: {sweep['kind']}{how}. Presses: {', '.join(values['presses']) or 'none'}, accuracy "
        f"{values['accuracy']}. " + (f"Fixed: {fixed}. " if fixed else "") + "All other parameters "
        "have the catalogue's defaults."
    )


def _metrics(values: Values) -> Table:
    rows = [
        (
            _named(name, item["unit"]), item["better"], item["low"], item["median"], item["high"],
            item["description"],
        )
        for name, item in values["metrics"].items()
    ]  # fmt: skip
    columns = ("metric", "better", "least", "median", "greatest", "meaning")
    return Table("Metrics", columns, rows, folded=True)


def _cost(values: Values) -> Table:
    cost = values["cost"]
    rows = (
        ("simulated presses", cost["simulations"]),
        ("designs times presses", cost["presses"]),
        ("seconds of all processes together", cost["process_seconds"]),
        ("designs of this run", cost["this_run_designs"]),
        ("wall time of this run [s]", cost["this_run_seconds"]),
        ("processes", cost["processes"]),
        ("device, machine", f"{cost['device']}, {cost['machine']}"),
        ("version now", cost["tool_version"]),
        ("versions of the rows", ", ".join(cost["versions_of_rows"])),
    )
    caption = (
        "Designs that differ in stiffness or optics only share a simulation: forces scale with the "
        "modulus. Presses in several places or with several indenters count once for each."
    )
    return Table("Cost", ("figure", "value"), rows, caption, folded=True)


def _picture(
    name: str, draw: Callable[[], Figure | bytes], caption: str, view: MeshView | None = None
) -> Picture:
    return Picture(f"{FIGURES}/{name}", draw, caption, view)


def _pictures(
    outcome: StudyOutcome, values: Values, found: dict[str, Sensitivity]
) -> Iterator[Picture]:
    """Every figure that there is something to show in; first what was chosen between."""
    if len(outcome.done) >= 2:
        yield from _trade_offs(outcome, values, found)
    if figures.tool_curves(outcome):
        yield _picture(
            "force_depth",
            lambda: figures.draw_tools(outcome, contact=False),
            "Force over depth. report.json has the numbers.",
        )
    if figures.has_contacts(outcome):
        yield _picture(
            "contact_force",
            lambda: figures.draw_tools(outcome, contact=True),
            "Diameter of the disc of the contact's area over the force.",
        )
    yield from _ends_pictures(outcome, values)


def _trade_offs(
    outcome: StudyOutcome, values: Values, found: dict[str, Sensitivity]
) -> Iterator[Picture]:
    pareto = values["pareto"]
    if pareto is not None:
        best, worst, front = values["best"], values["worst"], pareto["first_designs"]
        yield _picture(
            "pareto",
            lambda: figures.draw_pareto(outcome, front, best, worst),
            "The goal against the metric of the first constraint, or the second metric. Grey: "
            "excluded by a constraint. Along the orange Pareto front, one metric improves only at "
            f"the cost of the other. Pareto-optimal designs: {len(front)} of {len(outcome.done)} "
            f"by {' and '.join(pareto['first_metrics'])}, {len(pareto['designs'])} by "
            f"{', '.join(pareto['metrics'])}.",
        )
        if len(pareto["metrics"]) > 2:
            yield _picture(
                "pairs",
                lambda: figures.draw_pairs(outcome),
                "Metrics in pairs, each with its own front.",
            )
        yield _picture(
            "parallel",
            lambda: figures.draw_parallel(outcome, front, best),
            "One line per design. The better end of each metric is at the top, and so is the "
            "larger value of each parameter.",
        )
    yield _picture(
        "sensitivities",
        lambda: figures_effects.draw_sensitivities(outcome, found),
        "Elasticities of each metric to each parameter; grey cells have none.",
    )
    effects = (
        "Orange: mean over the designs with that value; grey: each design. Hollow: a design whose "
        "partner (all other parameters the same) has no figure at some other value; it is in no "
        "mean."
        if values["sweep"]["kind"] == "grid"
        else "Each design is a dot."
    )
    yield _picture("effects", lambda: figures_effects.draw_effects(outcome, found), effects)
    if figures_effects.has_maps(outcome):
        yield _picture(
            "maps",
            lambda: figures_effects.draw_maps(outcome),
            "Metrics over the two parameters. Grey: no figure.",
        )


def _ends_pictures(outcome: StudyOutcome, values: Values) -> Iterator[Picture]:
    ends = _ends(outcome, values)
    for word, row in ends:
        name = row.files.get("picture")
        path = outcome.folder.root / name if name else None
        if path is not None and path.is_file():
            caption = f"{word}: {values['names'][row.id]}, the gel under its first press."
            yield _picture(word.replace(" ", "_"), path.read_bytes, caption)
    best = [row for word, row in ends if word.startswith("best")]
    worst = [row for word, row in ends if word.startswith("worst")]
    if len(outcome.done) >= 2 and figures.drawn_presses(outcome, [*best, *worst]):
        yield _picture(
            "curves",
            lambda: figures.draw_curves(outcome, best, worst),
            "Force over depth in each press, over the sideways motion there and back in a press "
            "with shear. Of several places or indenters the first.",
        )
    if ends:
        yield from _gel(values, *ends[0])


def _gel(values: Values, word: str, row: DesignRow) -> Iterator[Picture]:
    """The untouched gel of a design, at the resolution of profiles; of one alone, as a view is some
    100 KB."""
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.sensors.registry import sensor_family

    try:
        mesh = gel_mesh(sensor_family(row.family).parameters(row.parameters).pad())
    except InputError:  # Its sensor is a package or a profile that is no longer there.
        return
    parts = mesh.nodes_m, mesh.faces, mesh.face_regions
    caption = f"The untouched gel of {values['names'][row.id]} ({word}), faces by region."
    yield _picture("gel", lambda: draw_mesh(*parts), caption, view=mesh_view(*parts))


def write_study_report(outcome: StudyOutcome) -> dict[str, Any]:
    """Write ``report.html``, ``report.json`` and ``figures/*.png`` into the study's folder.

    Returns:
        The figures as written to the JSON.
    """
    page, root = study_page(outcome), outcome.folder.root
    (root / FIGURES).mkdir(exist_ok=True)
    write_page_into(page, root)
    drawn = {picture.name for picture in page.pictures}
    for path in (root / FIGURES).glob("*.png"):
        if f"{FIGURES}/{path.stem}" not in drawn:
            path.unlink()
    return page.figures
