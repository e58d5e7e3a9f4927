# SPDX-License-Identifier: Apache-2.0
"""Generated parts of the page, in Markdown, and the README's five figures, each with the protocol
that it was scored by; every figure is read from a result."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.report.markdown import markdown_table

Document = dict[str, Any]
Results = dict[str, list[Document]]
NOTHING = "No result yet."
PEERS = Path(__file__).parents[1] / "peers.json"
"""Figures of other simulators with their conditions."""


def read_peers() -> dict[str, Any]:
    """Figures on the peg scene, and others."""
    return json.loads(PEERS.read_text(encoding="utf-8"))


def number(value: float | None, digits: int = 3) -> str:
    """Three digits that count, thousands grouped."""
    if value is None:
        return "-"
    if value == 0:
        return "0"
    if abs(value) >= 1000:
        return f"{round(value):,}"
    if abs(value) < 1e-3:
        return f"{value:.1e}"
    return f"{value:.{digits}g}"


Row = dict[str, Any]


def headline(results: Results) -> str:
    """Image, normals, measured force, force against a finer mesh, speed."""
    rows = [
        _of_captures(
            results,
            "PSNR, placed by label [dB]",
            "Image of a real ball press [dB PSNR]",
            "[held-out test set](docs/calibration_color.md#figures), placed by label, crop of 1.6 "
            "contact radii; the untouched image scores 15.7 to 22",
        ),
        _of_captures(
            results,
            "normals, placed by label [deg]",
            "Normals from real images, mean error [deg]",
            "[the same presses](docs/calibration_depth.md), inside the contact",
        ),
        _measured_force(results),
        _mesh_error(results),
        _speed(results),
    ]
    found = [row for row in rows if row]
    return markdown_table(["what", "figure", "how it was scored"], found) if found else NOTHING


def _of_captures(results: Results, figure: str, what: str, how: str) -> list[str]:
    values = [
        f"{row['value']:.3g} ({row['set'].split(' (')[0]})"
        for document in results.get("captures", [])
        for row in document["rows"]
        if row["figure"] == figure
    ]
    return [what, ", ".join(values), how] if values else []


def _measured_force(results: Results) -> list[str]:
    worst = [
        row
        for document in results.get("captures", [])
        for row in document["rows"]
        if row["command"] == "material"
    ]
    if not worst:
        return []
    value, goal = max(row["value"] for row in worst), worst[0]["goal"]
    return [
        "Force against measurements on a GelSight Mini",
        f"{value:.1%} (goal {goal:.0%}: missed)" if value > goal else f"{value:.1%}",
        "[one modulus and a zero](docs/calibration_material.md#accuracy), worst point predicted "
        "from the others",
    ]


def _mesh_error(results: Results) -> list[str]:
    errors: dict[bool, list[float]] = {}
    for document in results.get("press_accuracy", []):
        for row in document["rows"]:
            if row["setting"] == "default" and not row["cause"]:
                ball = row["tool"].startswith("ball")
                errors.setdefault(ball, []).append(abs(row["force_error"]))
    if not errors:
        return []
    said = [
        f"{statistics.median(errors[ball]):.1%}, worst {max(errors[ball]):.0%} ({name})"
        for ball, name in ((True, "balls"), (False, "tools with edges"))
        if ball in errors
    ]
    return [
        "Mesh error of the force of a default `press`",
        "; ".join(said),
        "[against eight times as many nodes](docs/evidence/verification.md), ten sensors",
    ]


UNPUBLISHED = ("press_2005", "press_2005_quadratic")
"""Scenes that have meshes of ours alone."""


def is_comparable(row: Row) -> bool:
    """Whether a row is of the meshes that others use: ours of the peg, of the same size, have a
    third fewer unknowns."""
    return row["source"] == "published" or row["scene"] in UNPUBLISHED


def scene_of(row: Row) -> str:
    """Name of a row's scene, with what differs from the usual one."""
    lag = f", lag {row['lag']}" if row.get("lag") else ""
    return row["scene"] + lag + ("" if is_comparable(row) else ", generated meshes")


def _speed(results: Results) -> list[str]:
    in_step, whole = (
        [
            row
            for document in results.get(suite, [])
            if "H200" in document["run"]["device"]
            for row in document["rows"]
            if row["scene"] == "peg" and not row[other] and is_comparable(row)
        ]
        for suite, other in (("speed", "lag"), ("learning", "observed"))
    )
    in_step = {row["envs"]: row["fps"]["median"] for row in in_step}
    whole = {(row["pace"], row["envs"]): row for row in whole}
    counts = {envs for pace, envs in whole if ("own", envs) in whole and pace == "together"}
    if not counts & set(in_step):
        return []
    many = max(counts & set(in_step))
    together, own = whole["together", many], whole["own", many]
    failed, steps = own["residual"]["unconverged"], own["residual"]["env_steps"]
    return [
        f"Steps a second, {many:,} environments, H200",
        f"{in_step[many]:,.0f} all in one phase; over the whole motion with resets "
        f"{together['fps']['median']:,.0f} together, {own['fps']['median']:,.0f} at their own pace "
        f"({failed:,} of {steps:,} steps failed)",
        "[two gels push a peg into a hole](docs/evidence/benchmarks.md#speed), residual 1e-4 of "
        "the contact force, forces read",
    ]


Section = Callable[[Results], str]


def origin(document: Document) -> str:
    """Where a result is from, in a line."""
    run = document["run"]
    device = run["device"]
    if device.startswith("CPU"):
        device = f"one thread of an {run['cpu']}"
    state = "" if document["complete"] else ", unfinished"
    return (
        f"**{device}** ({run['date'][:10]}, commit `{run['commit']}`; "
        f"`benchmarks/results/{document['file']}`{state})"
    )


def of_each_result(suite: str, parts: Callable[[Document], Iterator[str]], results: Results) -> str:
    """Where each result of a suite is from, and what it says."""
    texts = [t for document in results.get(suite, []) for t in (origin(document), *parts(document))]
    return "\n\n".join(texts) or NOTHING


def spread(value: dict[str, float]) -> str:
    """Median and range."""
    return f"{number(value['median'])} ({number(value['min'])} to {number(value['max'])})"


def solved(residual: dict[str, Any]) -> str:
    """Residual, and what did not converge."""
    text = f"{residual['worst_over_contact_force']:.1e}"
    if residual["unconverged"]:
        text += f", {residual['unconverged']} of {residual['env_steps']} failed"
    if residual["taken_in_parts"]:
        text += f", {residual['taken_in_parts']} in parts"
    return text


def table_of(rows: Iterable[Any], columns: Mapping[str, Callable[[Any], Any]]) -> str:
    """A table with a cell of each column for every row."""
    return markdown_table(columns, [[cell(row) for cell in columns.values()] for row in rows])


def speed(document: Document) -> Iterator[str]:
    """FPS, memory and time to start."""
    columns: dict[str, Callable[[Row], str]] = {
        "scene": scene_of,
        "environments": lambda row: f"{row['envs']:,}",
        "FPS, median (range)": lambda row: spread(row["fps"]),
        "ms a step": lambda row: number(row["ms_per_step"]["median"]),
        "Newton a step": lambda row: number(row["newton_mean"]),
        "residual over contact force": lambda row: solved(row["residual"]),
        "MiB an environment": lambda row: number(row["memory_mib_per_env"]),
    }
    yield table_of(document["rows"], columns)
    if document.get("startup"):
        starts: dict[str, Callable[[tuple[str, Row]], str]] = {
            "scene": lambda item: item[0],
            "import to first step, warm [s]": lambda item: number(
                item[1]["warm"]["import_to_first_step_s"]
            ),
            "cold [s]": lambda item: number(item[1]["cold"]["import_to_first_step_s"]),
            "compilation [s]": lambda item: number(item[1]["compilation_s"]),
        }
        yield table_of(document["startup"].items(), starts)


def learning(document: Document) -> Iterator[str]:
    """FPS of a learning loop, and what its slowest environment costs."""
    columns: dict[str, Callable[[Row], str]] = {
        "scene": scene_of,
        "environments": lambda row: f"{row['envs']:,}",
        "pace": lambda row: row["pace"],
        "FPS": lambda row: number(row["fps"]["median"]),
        "ms a step of each": lambda row: number(row["ms_per_step"]["median"]),
        "of it resets (a step) and reading forces": lambda row: (
            f"{number(row['beside_steps_ms'])} ({number(row['resets_per_step'])})"
        ),
        "Newton a step: mean, largest of those through at once": lambda row: (
            f"{number(row['newton_mean'])}, {number(row['newton_largest_mean'])}"
        ),
        "residual over contact force": lambda row: solved(row["residual"]),
    }
    if any(row["observed"] for row in document["rows"]):
        columns["observed: us a step of each"] = lambda row: _observed(row["observed"])[0]
        columns["FPS without"] = lambda row: _observed(row["observed"])[1]
    yield table_of(document["rows"], columns)


def _observed(seen: dict[str, Any] | None) -> list[str]:
    """What torch read of a step, and what the loop made beside that."""
    if seen is None:
        return ["nothing", "-"]
    spent = [f"{name} {number(seen[f'{name}_us_per_env_step'])}" for name in seen["what"]]
    return [", ".join(spent), number(seen["fps_without"])]


def press_accuracy(document: Document) -> Iterator[str]:
    """Errors of presses by setting and kind of tool, and how often what they state held."""
    rows = document["rows"]
    groups: dict[tuple[str, bool], list[dict[str, Any]]] = {}
    for row in rows:
        if not row["cause"]:
            key = (row["setting"], row["tool"].startswith("ball"))
            groups.setdefault(key, []).append(row)
    lines = []
    for (setting, ball), chosen in groups.items():
        names = ("force_error", "solved_error", "estimated_force_error")
        names += ("height_rms_m", "estimated_height_rms_m")
        force, solved, stated, height, stated_height = (
            np.abs(np.array([row[name] for row in chosen], dtype=np.float64)) for name in names
        )
        inside = (height <= stated_height)[np.isfinite(height)].mean()
        lines.append(
            [
                f"{setting}, {'balls' if ball else 'tools with rims'}",
                len(chosen),
                f"{np.median(solved):.1%}, {solved.max():.1%}",
                f"{np.median(force):.1%}, {force.max():.1%}",
                f"{np.median(stated):.1%}",
                f"{np.median(stated / np.maximum(force, 1e-4)):.1f}",
                f"{1e6 * np.nanmedian(height):.1f}, {1e6 * np.nanmax(height):.1f} um",
                f"{(force <= stated).mean():.0%}, {inside:.0%}",
            ]
        )
    head = ["setting, tools", "cases", "force as solved off by: median, worst", "as stated"]
    head += ["stated", "stated over true"]
    yield markdown_table([*head, "heights: median, worst", "inside: force, heights"], lines)
    failed = sum(bool(row["cause"]) for row in rows)
    if failed:
        yield f"{failed} of {len(rows)} presses did not converge, or their truth did not."


def captures(document: Document) -> Iterator[str]:
    """Calibrations of published captures against their goals."""
    columns: dict[str, Callable[[Row], str]] = {
        "captures": lambda row: row["set"],
        "calibration": lambda row: f"`{row['command']}`",
        "figure": lambda row: row["figure"],
        "value": lambda row: number(row["value"]),
        "goal": lambda row: f"{'at least' if row['at_least'] else 'at most'} {row['goal']:g}",
        "": lambda row: "met" if row["met"] else "**missed**",
    }
    yield table_of(document["rows"], columns)


def peers(results: Results) -> str:
    """The field's table with ours beside it, each with its conditions."""
    field = read_peers()["peg"]
    ours = []
    for document in results.get("speed", []):
        rows = [row for row in document["rows"] if row["scene"] == "peg" and not row["lag"]]
        rows = [row for row in rows if is_comparable(row)]
        if not rows:
            continue
        worst = max(row["residual"]["worst_over_contact_force"] for row in rows)
        part = "" if rows[0]["is_whole_motion"] else f"; first {rows[0]['steps']} steps"
        ours.append(
            {
                "name": "**taccel-lab**",
                "device": document["run"]["device"].replace("NVIDIA ", ""),
                "kind": "measured",
                "stop": f"force residual {worst:.0e} of the contact force or 1e-5 N, end to end"
                + part,
                "fps": {str(row["envs"]): row["fps"]["median"] for row in rows},
            }
        )
    for document in results.get("peers", []):
        names = dict.fromkeys(row["name"] for row in document["rows"])
        ours += [
            {
                "name": f"{name}, run by us {document['run']['date'][:10]}",
                "device": document["run"]["device"].replace("NVIDIA ", ""),
                "kind": "measured",
                "stop": document["settings"]["stop"],
                "fps": {str(r["envs"]): r["fps"] for r in document["rows"] if r["name"] == name},
            }
            for name in names
        ]
    entries = ours + field
    counts = sorted({int(count) for entry in entries for count in entry["fps"]})
    rows = [
        [
            entry["name"],
            f"{entry['device']}, {entry['kind']}",
            entry["stop"],
            *(number(entry["fps"].get(str(count))) for count in counts),
        ]
        for entry in entries
    ]
    head = ["simulator", "device", "stop", *(f"{count:,}" for count in counts)]
    others = markdown_table(
        ["other figures", "device", "figure"],
        [
            [entry["name"], f"{entry['device']}, {entry['kind']}", entry["figure"]]
            for entry in read_peers()["others"]
        ],
    )
    return "\n\n".join(
        part for part in (markdown_table(head, rows), ratios(ours, field), others) if part
    )


def ratios(measured: list[dict[str, Any]], field: list[dict[str, Any]]) -> str:
    """Ours over each of the others on the same kind of device, where both have a figure."""
    lines = []
    for own in (entry for entry in measured if "taccel-lab" in entry["name"]):
        for other in [entry for entry in (*measured, *field) if entry is not own]:
            if "taccel-lab" in other["name"] or other["device"] not in own["device"]:
                continue
            shared = [count for count in other["fps"] if count in own["fps"]]
            parts = [
                f"{own['fps'][count] / other['fps'][count]:.3g} times at {int(count):,}"
                for count in sorted(shared, key=int)
            ]
            if parts:
                lines.append(f"- {other['name']} ({other['stop']}): {', '.join(parts)}")
    return "Ours over theirs on the same kind of GPU:\n\n" + "\n".join(lines) if lines else ""


def stress(document: Document) -> Iterator[str]:
    """Random scenes: outcomes over all; the picture has them by family."""
    from taccel_lab.benchmarks.stress.suite import total_table

    yield total_table(document["summary"])
    yield picture(document, "stress", "Outcomes and Newton iterations by family")


def picture(document: Document, kind: str, title: str) -> str:
    """Link to a picture of a result."""
    name = Path(document["file"]).stem
    return f"![{title}](../images/benchmarks/{kind}_{name}.png)"


def has_speeds(results: Results) -> bool:
    """Whether there are speeds by environments."""
    return any(row["envs"] > 1 for d in results.get("speed", []) for row in d["rows"])


def speed_pictures(results: Results) -> str:
    """FPS by environments, all results in one picture."""
    picture = "![Frames a second by environments](../images/benchmarks/speed.png)"
    return picture if has_speeds(results) else NOTHING


VERIFICATION: dict[str, Section] = {
    "press accuracy": partial(of_each_result, "press_accuracy", press_accuracy)
}
HEADLINE: dict[str, Section] = {"headline": headline}
SECTIONS: dict[str, Section] = {
    "speed": partial(of_each_result, "speed", speed),
    "speed picture": speed_pictures,
    "learning": partial(of_each_result, "learning", learning),
    "peers": peers,
    "stress": partial(of_each_result, "stress", stress),
    "captures": partial(of_each_result, "captures", captures),
}
"""Parts of the page by the name in its markers."""
