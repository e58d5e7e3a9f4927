# SPDX-License-Identifier: Apache-2.0
"""Presses and metrics made of formulas; each evaluation leaves a line in a log."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint
from taccel_lab.studies.spec.study import Kit, Study, make_study
from taccel_lab.studies.spec.study_file import spec_of

LOG = "evaluated.log"


@dataclass(frozen=True)
class FakePress:
    name: str
    depth_mm: float = 1.0
    places: tuple[tuple[float, float], ...] = ((0.0, 0.0),)

    def __post_init__(self) -> None:
        if self.depth_mm <= 0:
            raise InputError(f"depth_mm must be above 0, got {self.depth_mm}")


def unused(evidence: Any) -> float:
    raise AssertionError("fakes compute nothing from evidence")


METRICS = {
    name: Metric(name, unit, f"{name} in words", better, presses, unused, at_load=name == "blur")  # type: ignore[arg-type]
    for name, unit, better, presses in (
        ("stiffness", "N/mm", "lower", ("ball",)),
        ("range", "N", "higher", ("ball",)),
        ("blur", "px", "lower", ("edge",)),
        ("lamps", "1", "none", ()),
    )
}
PRESSES = {name: FakePress(name) for name in ("ball", "edge")}


def figures_of(parameters: dict[str, Any]) -> dict[str, float]:
    """Stiffness E / t, range E t, blur with its minimum at t = 4 and E = 0.2."""
    values = sensor_family("gelsight").parameters(parameters).values()
    t, e = values["thickness_mm"], values["young_modulus_mpa"]
    return {
        "stiffness": 10 * e / t,
        "range": 10 * e * t,
        "blur": (t - 4) ** 2 + (5 * e - 1) ** 2 + 0.1,
        "lamps": 3.0,
    }


def _hold(root: Path) -> None:
    """From ``FAKE_HOLD_AT`` evaluations on there are no more: somebody has to end this process."""
    most = int(os.environ.get("FAKE_HOLD_AT", "1000000"))
    while len(logged(root)) >= most:
        time.sleep(0.01)


def evaluate(
    designs,
    presses,
    metrics,
    *,
    device="cpu",
    progress=None,
    folder: Path | None = None,
    unit_spread=0.0,
):
    """Formulas; a rim of 'fillet' cannot be built, one of 'chamfer' lacks a figure."""
    results = []
    for number, design in enumerate(designs):
        if folder is not None:
            _hold(folder.parent)
            with open(folder.parent / LOG, "a", encoding="utf-8") as log:
                log.write(design.id + "\n")
        rim = design.parameters.get("rim")
        if rim == "fillet":
            results.append(DesignFigures(design, causes={"design": "the fillet does not fit"}))
            continue
        found = figures_of(design.parameters)
        figures: dict[str, float | None] = {m.name: found[m.name] for m in metrics}
        causes = {}
        if rim == "chamfer" and "blur" in figures:
            figures["blur"] = None
            causes["blur"] = "no edge was found"
        force = [[0.0, 0.0, d * found["stiffness"]] for d in (0.5, 1.0)]
        curve = {"depth_mm": [0.5, 1.0], "force_n": force, "indenter": "ball", "place": [0, 0]}
        curves = {press.name: [curve] for press in presses}
        results.append(DesignFigures(design, figures, causes, 0.0, len(presses), curves))
        if progress is not None:
            progress("pressing", number + 1, len(designs))
    return results


def evaluate_and_tear(designs, presses, metrics, **rest):
    """Gels of 3 mm tear at 0.4 MPa, those of 4.5 mm lack the blur there."""
    results = []
    for result in evaluate(designs, presses, metrics, **rest):
        thickness = result.point.parameters["thickness_mm"]
        if result.point.parameters["young_modulus_mpa"] == 0.4:
            if thickness == 3.0:
                result = DesignFigures(result.point, causes={"design": "the gel tears"})
            elif thickness == 4.5:
                result.figures["blur"], result.causes["blur"] = None, "no edge was found"
        results.append(result)
    return results


def evaluate_and_crash(designs, presses, metrics, **rest):
    """Raises for a design with thickness 3, kills its process for one with thickness 5."""
    for design in designs:
        if design.parameters.get("thickness_mm") == 3.0:
            raise ZeroDivisionError("a fault of the program")
        if design.parameters.get("thickness_mm") == 5.0:
            os.kill(os.getpid(), signal.SIGKILL)
    return evaluate(designs, presses, metrics, **rest)


def table(**changes: Any) -> dict[str, Any]:
    """A study file of three thicknesses and two moduli, with some tables replaced."""
    return {
        "study": {"name": "Fake", "sensor": "gelsight", "metrics": ["stiffness", "range", "blur"]},
        "parameters": {
            "thickness_mm": {"values": [3.0, 4.0, 5.0]},
            "young_modulus_mpa": {"min": 0.1, "max": 0.4, "count": 2, "scale": "log"},
        },
        "sweep": {"kind": "grid"},
        "output": {"meshes": False, "pictures": False},
        **changes,
    }


def study(evaluate_with: Any = evaluate, **changes: Any) -> Study:
    """The study of ``table`` on the fake kit."""
    return make_study(spec_of(table(**changes)), Kit(PRESSES, METRICS, evaluate_with))


def logged(root: Path) -> list[str]:
    """Ids of all evaluations, in order."""
    path = root / LOG
    return path.read_text().split() if path.is_file() else []


def point(**parameters: Any) -> DesignPoint:
    return DesignPoint("x", "gelsight", parameters)
