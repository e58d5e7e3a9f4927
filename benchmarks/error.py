# SPDX-License-Identifier: Apache-2.0
"""The suite ``error``: what each setting costs in time and in error, and which settings pay.

The press with shear of ``taccel_lab.benchmarks.shear_press``. Every row is compared with one
converged run (quadratic tets, small dhat and tolerance): force, height of the contact face,
markers. Beside that *total* error stands the error of the *settings* alone, against the converged
run on the row's own mesh, since the mesh's error would hide it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.clock import clock_name
from taccel_lab.benchmarks.front import NOISE, is_on_front
from taccel_lab.benchmarks.results import ResultFile, spread
from taccel_lab.benchmarks.shear_press import FRICTION, Outcome, Press, model_of, run
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.envs import PHYSICS, Accuracy
from taccel_lab.errors import SimulationError
from taccel_lab.ipc.linear.system import usable_methods
from taccel_lab.scene import Element, TimeScheme
from taccel_lab.solvers import SolverConfig

DEFAULTS = SolverConfig()
REFERENCE = Press(Element.QUADRATIC, 5, dhat_m=2e-6, friction_eps_m=1e-7, relative_tolerance=1e-6)
QUICK_REFERENCE = replace(REFERENCE, layers=3)
_PHYSICS = PHYSICS[Accuracy.DEFAULT]
DEFAULT = Press(
    _PHYSICS.element,
    2,
    dhat_m=_PHYSICS.dhat_m,
    friction_eps_m=DEFAULTS.friction_eps_m,
    relative_tolerance=_PHYSICS.relative_tolerance,
)
"""What presses take, on an even mesh and without the correction for the contact layer: how the
graded meshes of presses fare is in docs/verification.md."""
SWING = replace(DEFAULT, element=Element.LINEAR, relative_tolerance=1e-6)
"""For time steps: a coarse mesh, whose waves they can resolve."""
_SETTLED = {"dhat_m": 2e-6, "friction_eps_m": 1e-7, "relative_tolerance": 1e-6}


@dataclass(frozen=True)
class Error(Suite):
    """Run time against error: mesh, element, dt, dhat, tolerance, friction eps, solver choices."""

    name: ClassVar[str] = "error"
    what: ClassVar[str] = (
        "Time a step against error, of a press with shear; one setting at a time, then combined."
    )
    repeats: int = 3
    """Runs of each row; the median time counts."""
    quick: bool = False
    """Coarse meshes and a few rows, to see that it works."""

    def settings(self) -> dict[str, Any]:
        return {
            "repeats": self.repeats,
            "clock": clock_name(self.device),
            "quick": self.quick,
            "friction": FRICTION,
            "default": asdict(DEFAULT),
            "reference": asdict(QUICK_REFERENCE if self.quick else REFERENCE),
        }

    def measure_rows(self, result: ResultFile) -> None:
        """All rows, then which of them lie on the front."""
        presses = Presses(self.device, self.repeats)
        for row in all_rows(self.quick, self.device):
            result.measure(f"{row.group}, {row.value}", partial(measure, row, presses), describe)
        result.put("front", judge(result.rows))


@dataclass(frozen=True)
class Row:
    """One run, and what it is compared with."""

    group: str
    """Setting that is varied, or "front" for combinations."""
    value: str
    press: Press
    exact: Press


def all_rows(quick: bool, device: str) -> Iterator[Row]:
    """What is run on a device, cheap groups first."""
    reference = QUICK_REFERENCE if quick else REFERENCE
    meshes = [(Element.LINEAR, n) for n in ((2, 3) if quick else (2, 3, 4, 6, 8))]
    meshes += [(Element.QUADRATIC, n) for n in ((2,) if quick else (2, 3, 4))]
    for element, layers in meshes:
        press = replace(DEFAULT, element=element, layers=layers)
        yield Row("mesh", f"{element}, {layers} layers", press, reference)
    few = slice(0, 2) if quick else slice(None)
    for dhat in (1e-4, 5e-5, 2e-5, 1e-5, 5e-6)[few]:
        yield Row("dhat", f"{dhat * 1e6:g} um", replace(DEFAULT, dhat_m=dhat), reference)
    for tolerance in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)[few]:
        press = replace(DEFAULT, relative_tolerance=tolerance)
        yield Row("tolerance", f"{tolerance:g}", press, reference)
    for eps in (1e-4, 1e-5, 1e-6, 1e-7)[few]:
        press = replace(DEFAULT, friction_eps_m=eps)
        yield Row("friction eps", f"{eps * 1e6:g} um", press, reference)
    for name, choice in solver_choices(device):
        press = replace(DEFAULT, solver=((name, choice),))
        yield Row(name.replace("_", " "), str(choice), press, reference)
    counts = (16, 32) if quick else (16, 32, 64, 128, 256)
    finest = replace(SWING, steps=2 * counts[-1], scheme=TimeScheme.BDF2)
    for scheme in TimeScheme:
        for count in counts:
            press = replace(SWING, steps=count, scheme=scheme)
            yield Row("dt", f"{scheme}, {8 / count:g} ms", press, finest)
    if quick:
        return
    for element, layers in (
        (Element.LINEAR, 3),
        (Element.LINEAR, 4),
        (Element.LINEAR, 6),
        (Element.QUADRATIC, 2),
        (Element.QUADRATIC, 3),
    ):
        for dhat in (5e-5, 2e-5, 1e-5, 5e-6):
            for tolerance in (1e-2, 1e-3, 1e-4, 1e-5):
                press = replace(
                    DEFAULT,
                    element=element,
                    layers=layers,
                    dhat_m=dhat,
                    relative_tolerance=tolerance,
                )
                yield Row("front", describe_settings(asdict(press)), press, reference)


def solver_choices(device: str) -> Iterator[tuple[str, Any]]:
    """Every value of every setting of the solver that is a choice: the linear method, of those that
    are made for the device and for a gel of this size."""
    rows = model_of(DEFAULT, device).free_count
    yield from (("linear_method", name) for name in usable_methods(rows, wp.get_device(device)))


def errors(outcome: Outcome, exact: Outcome) -> dict[str, float]:
    """Of forces in per cent; of heights and markers in micrometres, rms and largest."""
    heights = 1e6 * (outcome.heights_m - exact.heights_m)
    markers = 1e6 * np.linalg.norm(outcome.markers_m - exact.markers_m, axis=1)
    return {
        "force_percent": 100 * abs(outcome.normal_n / exact.normal_n - 1),
        "shear_force_percent": 100 * abs(outcome.tangential_n / exact.tangential_n - 1),
        "height_rms_um": float(np.sqrt(np.mean(heights**2))),
        "height_max_um": float(np.abs(heights).max()),
        "marker_rms_um": float(np.sqrt(np.mean(markers**2))),
        "marker_max_um": float(markers.max()),
    }


class Presses:
    """Runs, each done once; the first of a kind of element compiles and is done twice."""

    def __init__(self, device: str, repeats: int) -> None:
        self._device, self._repeats = device, repeats
        self._known: dict[Press, tuple[Outcome, list[float]]] = {}
        self._warm: set[tuple[Any, ...]] = set()

    def get(self, press: Press, repeats: int | None = None) -> tuple[Outcome, list[float]]:
        """Outcome, and seconds a step of each repeat."""
        if press not in self._known:
            kind = (press.element, press.steps > 0, press.scheme, press.solver)
            if kind not in self._warm:
                self._warm.add(kind)
                steps = min(press.steps, 16)
                run(replace(press, layers=2, steps=steps), self._device)
            runs = [run(press, self._device) for _ in range(repeats or self._repeats)]
            self._known[press] = (runs[0], [r.seconds / r.steps for r in runs])
        return self._known[press]


def measure(row: Row, presses: Presses) -> dict[str, Any]:
    """One row; ``failed`` says why where there is none: it does not converge."""
    try:
        exact = presses.get(row.exact, 1)[0]
        settled = exact
        if row.group != "dt":
            settled = presses.get(replace(row.press, **_SETTLED, solver=()), 1)[0]
        outcome, seconds = presses.get(row.press)
    except SimulationError as error:
        return {"group": row.group, "value": row.value, "failed": str(error)}
    return {
        "group": row.group,
        "value": row.value,
        "is_default": row.press == DEFAULT,
        "settings": asdict(row.press),
        "nodes": outcome.node_count,
        "ms_per_step": spread([1e3 * s for s in seconds]),
        "newton_per_step": outcome.newton_iterations / outcome.steps,
        "cg_per_step": outcome.cg_iterations / outcome.steps,
        "residual": {"worst_over_contact_force": outcome.residual_ratio},
        "error": errors(outcome, exact),
        "settings_error": errors(outcome, settled),
    }


def describe(row: dict[str, Any]) -> str:
    """A line for the person who waits."""
    if "failed" in row:
        return f"{row['group']}, {row['value']}: {row['failed']}"
    error, own = row["error"], row["settings_error"]
    return (
        f"{row['group']}, {row['value']}: {row['ms_per_step']['median']:.1f} ms a step, "
        f"force {error['force_percent']:.2f} % (settings {own['force_percent']:.3f} %), "
        f"height {error['height_rms_um']:.2f} um, markers {error['marker_rms_um']:.2f} um"
    )


CRITERIA = ("force_percent", "height_rms_um", "marker_rms_um")
"""Errors that the front is about: a row is dominated by one that is faster and worse in none."""
NEARBY = 1.5
"""Times the default's time within which a better row is looked for."""


def judge(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Which rows are such that no other is faster and no worse in force, heights and markers.

    All meshes together by total error; then, on the default's own mesh, by the settings' error.
    Times within the noise of 5 % count as equal. Beside that, the row with the smallest force error
    among those that take at most half as long again as the default.
    """
    rows = list(
        {
            str(row["settings"]): row
            for row in rows
            if "failed" not in row and row["group"] != "dt"
        }.values()
    )
    at = [i for i, row in enumerate(rows) if row["is_default"]]
    if not at:
        return {}
    default = rows[at[0]]
    own = [row for row in rows if _mesh(row) == _mesh(default)]
    verdict: dict[str, Any] = {"default": describe_settings(default["settings"])}
    for name, kind, among in (("all_meshes", "error", rows), ("own_mesh", "settings_error", own)):
        times = np.array([row["ms_per_step"]["median"] for row in among])
        errors_of = np.array([[row[kind][key] for key in CRITERIA] for row in among])
        best = is_on_front(times, errors_of)
        mine = next(i for i, row in enumerate(among) if row is default)
        better = (times < (1 - NOISE) * times[mine]) & (errors_of <= errors_of[mine]).all(axis=1)
        near = np.flatnonzero(times <= NEARBY * times[mine])
        nearby = among[near[errors_of[near, 0].argmin()]]
        verdict[name] = {
            "front": _named(among, best),
            "default_is_on_it": bool(best[mine]),
            "better_than_the_default": _named(among, better),
            "best_nearby": {
                "settings": describe_settings(nearby["settings"]),
                "times_as_long": nearby["ms_per_step"]["median"] / times[mine],
                "force_percent": nearby[kind]["force_percent"],
                "default_force_percent": default[kind]["force_percent"],
            },
        }
    return verdict


def describe_settings(given: dict[str, Any]) -> str:
    """Everything that tells a press from others; ``given``: the settings of a row."""
    text = (
        f"{given['element']}, {given['layers']} layers, dhat {given['dhat_m'] * 1e6:g} um, "
        f"tolerance {given['relative_tolerance']:g}"
    )
    if given["friction_eps_m"] != DEFAULT.friction_eps_m:
        text += f", friction eps {given['friction_eps_m'] * 1e6:g} um"
    for name, value in given["solver"]:
        text += f", {name.replace('_', ' ')} {value}"
    return text


def _mesh(row: dict[str, Any]) -> tuple[Any, Any]:
    return row["settings"]["element"], row["settings"]["layers"]


def _named(rows: list[dict[str, Any]], chosen: np.ndarray) -> list[str]:
    return [
        describe_settings(row["settings"]) for row, yes in zip(rows, chosen, strict=True) if yes
    ]
