# SPDX-License-Identifier: Apache-2.0
"""Settings of the colour model chosen on two sets of captures, quoted on the third, left-out one.

Each value of each setting is fitted to two thirds of the training presses, whose circles are read
again without the others; these are rendered where their labels put them. The figure is the PSNR of
the crop, the mean over the presses and seeds. The value with the best mean over two sets is what
the third set is quoted with: fitted to all its training presses, scored on its held-out ones.
Held-out presses choose nothing. Run it with ``python -m taccel_lab.benchmarks.color_settings``;
results go to ``benchmarks/results/color_settings.json``. With ``--kept FILE`` a run that was cut
short goes on.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.benchmarks.capture_sets import CASES, ImportedSets
from taccel_lab.benchmarks.color_scene import (
    DEFAULT,
    HOLDOUT_EVERY,
    NETWORK,
    TABLE,
    Candidate,
    Scene,
    circles,
    measure,
    network,
    table,
)
from taccel_lab.benchmarks.left_out import beats_default, choose_left_out
from taccel_lab.benchmarks.results import FOLDER, ResultFile, note
from taccel_lab.errors import InputError
from taccel_lab.output import write_json

WHAT = "settings of the colour model, chosen on two sets and quoted on the third"
SUITE = "color_settings"
FOLDS = 3


def _pixels(times: float) -> Candidate:
    names = ("disc_pixels", "ring_pixels", "far_pixels")
    return network(**{name: round(times * getattr(DEFAULT, name)) for name in names})


def _each(make: Callable[..., Candidate], name: str, *values: float) -> dict[str, Candidate]:
    return {f"{value:g}": make(**{name: value}) for value in values}


SETTINGS: dict[str, tuple[str, dict[str, Candidate]]] = {
    "units of a layer": ("64", {str(n): network(hidden=(n,) * 3) for n in (16, 32, 64, 96)}),
    "layers": ("3", {str(n): network(hidden=(64,) * n) for n in (1, 2, 3, 4)}),
    "learning rate": ("0.004", _each(network, "learning_rate", 0.0013, 0.004, 0.012, 0.02, 0.036)),
    "pixels drawn [11,500 a press]": ("1", {f"{n:g}": _pixels(n) for n in (0.5, 1, 2)}),
    "Huber's bend [levels]": ("2", _each(network, "huber_levels", 1.0, 2.0, 4.0)),
    "factors on radii": (
        "0.86 to 1.07",
        {
            "none": circles(scales=()),
            "0.93 to 1.07": circles(scales=(0.93, 1.0, 1.07)),
            "0.86 to 1.07": NETWORK,
            "0.8 to 1.2": circles(scales=(0.8, 0.9, 1.0, 1.1, 1.2)),
        },
    ),
    "a factor's worth": ("0.01", _each(circles, "worth", 0.0, 0.01, 0.03)),
    "prior of a centre [px]": ("2", _each(circles, "center_sigma_px", 1.0, 2.0, 4.0)),
    "prior of a radius": ("0.05", _each(circles, "radius_sigma", 0.025, 0.05, 0.1)),
    "table: reach [radii]": ("2.5", _each(table, "reach_radii", 1.0, 2.0, 2.5, 3.0)),
    "table: pull": ("0.01", _each(table, "ridge", 0.001, 0.0025, 0.005, 0.01, 0.02)),
}
"""Setting: its default, and the values that are tried."""


class Bench:
    """Measured figures by set, seed and candidate; what is known is not measured again."""

    def __init__(
        self, scratch: Path, seeds: Sequence[int], more_seeds: Sequence[int], kept: Path | None
    ) -> None:
        self.seeds, self.more_seeds, self.kept = seeds, more_seeds, kept
        self.known: dict[str, Any] = {}
        if kept is not None and kept.exists():
            self.known = json.loads(kept.read_text(encoding="utf-8"))
        imports = ImportedSets(scratch)
        self.folders = {
            case.name: folder
            for case in CASES
            if case.command == "color" and (folder := imports.folder(case)) is not None
        }
        if len(self.folders) < 3:
            raise InputError(f"three sets are needed, found {', '.join(self.folders) or 'none'}")
        self._scene: Scene | None = None

    def scene(self, name: str) -> Scene:
        """A set with its surfaces; one at a time, they fill gigabytes."""
        if self._scene is None or self._scene.name != name:
            self._scene = None
            self._scene = Scene(name, self.folders[name])
        return self._scene

    def drift_gains(self) -> dict[str, float]:
        """Share of the left-out error that taking drift off gains, by set."""
        found = self.known.setdefault("drift", {})
        for name in self.folders:
            if name not in found:
                choice = self.scene(name).drift
                assert choice.disc_l1_off is not None and choice.disc_l1_on is not None
                found[name] = 1 - choice.disc_l1_on / choice.disc_l1_off
        return found

    def left_out_thirds(self, name: str, candidates: Mapping[str, Candidate], seed: int) -> Any:
        """Figures of all training presses, each by what was fitted without its third."""

        def parts(scene: Scene) -> Any:
            count = len(scene.training.presses)
            for fold in range(FOLDS):
                kept = [i for i in range(count) if i % FOLDS != fold]
                yield kept, scene.training.only(range(fold, count, FOLDS))

        return self._measured("thirds", name, candidates, seed, parts)

    def heldout(self, name: str, candidates: Mapping[str, Candidate], seed: int) -> Any:
        """Figures of the held-out presses, by what was fitted to all training presses."""
        return self._measured(
            "held out", name, candidates, seed,
            lambda scene: [(range(len(scene.training.presses)), scene.heldout)],
        )  # fmt: skip

    def _measured(
        self,
        kind: str,
        name: str,
        candidates: Mapping[str, Candidate],
        seed: int,
        parts: Callable[[Scene], Any],
    ) -> Any:
        known = self.known.setdefault(f"{kind}, {name}, seed {seed}", {})
        # Tables are drawn no pixels for: another seed moves them by their circles alone.
        wanted = {
            repr(each): each
            for each in candidates.values()
            if repr(each) not in known and (each.table is None or seed == self.seeds[0])
        }
        if wanted:
            started = time.perf_counter()
            scene = self.scene(name)
            known.update(measure(scene, parts(scene), wanted, seed))
            seconds = time.perf_counter() - started
            note(f"{kind}, {name}, seed {seed}: {len(wanted)} candidates, {seconds:.0f} s")
            if self.kept is not None:
                write_json(self.kept, self.known)
        return known

    def scores(self, kind: str, name: str, candidate: Candidate, figure: int) -> np.ndarray:
        """Figures of a set, shape [seed, press]; 0: PSNR of the crop [dB], 1: L1 of the disc."""
        seeds = self.seeds if candidate.table is None else self.seeds[:1]
        return self._rows(kind, name, candidate, seeds)[..., figure]

    def seed_deviation(self, kind: str, name: str) -> float:
        """How far a seed moves the default's mean PSNR of a set [dB]."""
        rows = self._rows(kind, name, NETWORK, [*self.seeds, *self.more_seeds])
        return float(rows[..., 0].mean(axis=1).std(ddof=1)) if len(rows) > 1 else 0.0

    def _rows(self, kind: str, name: str, candidate: Candidate, seeds: Sequence[int]) -> np.ndarray:
        rows = [self.known[f"{kind}, {name}, seed {seed}"][repr(candidate)] for seed in seeds]
        return np.array(rows)


def run(bench: Bench, result: ResultFile) -> None:
    """Measure, choose, and quote."""
    result.put("drift_gains", bench.drift_gains())
    tried = {f"{s}: {v}": c for s, (_, values) in SETTINGS.items() for v, c in values.items()}
    for seed in bench.seeds:
        for name in bench.folders:
            bench.left_out_thirds(name, tried, seed)
    for seed in bench.more_seeds:
        for name in bench.folders:
            bench.left_out_thirds(name, {"network": NETWORK}, seed)
            bench.heldout(name, {"network": NETWORK}, seed)
    moved = {name: bench.seed_deviation("thirds", name) for name in bench.folders}
    chosen: dict[str, dict[str, Candidate]] = {name: {} for name in bench.folders}
    rows = []
    for setting, (default, values) in SETTINGS.items():
        scores = {
            value: {n: bench.scores("thirds", n, c, 0) for n in bench.folders}
            for value, c in values.items()
        }
        is_table = values[default].table is not None
        choices = choose_left_out(scores, default, None if is_table else moved)
        for choice in choices:
            chosen[choice.left_out][setting] = values[choice.value]
        rows.append((setting, default, values, scores, choices))
    for name, by_setting in chosen.items():
        wanted = {"network": NETWORK, "table": TABLE, **by_setting, **_all_at_once(by_setting)}
        for seed in bench.seeds:
            bench.heldout(name, wanted, seed)
    if bench.more_seeds:
        kinds = ("thirds", "held out")
        moves = {n: {k: bench.seed_deviation(k, n) for k in kinds} for n in chosen}
        result.put("seed_deviation_db", moves)
    for setting, default, values, scores, choices in rows:
        result.add(
            {
                "setting": setting,
                "default": default,
                "thirds_psnr_db": {
                    value: {name: round(float(x.mean()), 3) for name, x in by_set.items()}
                    for value, by_set in scores.items()
                },
                "choices": [
                    {**asdict(c), "held_out": _held_out(bench, c.left_out, values[c.value])}
                    for c in choices
                ],
                "change": beats_default(choices, default),
            }
        )  # fmt: skip
    for name, by_setting in chosen.items():
        for what, candidate in _all_at_once(by_setting).items():
            result.add({"setting": what, "left_out": name,
                        "held_out": _held_out(bench, name, candidate)})  # fmt: skip


def _all_at_once(by_setting: Mapping[str, Candidate]) -> dict[str, Candidate]:
    """Every chosen value together, of the network and of the table."""
    network, table = NETWORK, TABLE
    for candidate in by_setting.values():
        if candidate.table is None:
            network = network.joined(candidate)
        else:
            table = table.joined(candidate)
    return {"all of the network": network, "all of the table": table}


def _held_out(bench: Bench, name: str, candidate: Candidate) -> dict[str, Any]:
    """Held-out figures of a candidate beside those of the default."""
    default = NETWORK if candidate.table is None else TABLE
    return {
        who: {
            "psnr_db": round(float(bench.scores("held out", name, each, 0).mean()), 3),
            "disc_l1": round(float(bench.scores("held out", name, each, 1).mean()), 3),
        }
        for who, each in (("chosen", candidate), ("default", default))
    }


def main() -> None:
    import warp as wp

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="0", help="of the fits to every value (0)")
    parser.add_argument("--more-seeds", default="1,2", help="of fits to the defaults alone (1,2)")
    parser.add_argument("--out", type=Path, default=FOLDER, help="JSON file or its folder")
    parser.add_argument("--kept", type=Path, help="JSON file of measured figures to go on from")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    seeds, more = (
        [int(seed) for seed in text.split(",") if seed]
        for text in (options.seeds, options.more_seeds)
    )
    settings = {
        "seeds": seeds, "more_seeds": more, "folds": FOLDS, "holdout_every": HOLDOUT_EVERY,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(Path(scratch), seeds, more, options.kept)
        with ResultFile(SUITE, WHAT, options.out, "cpu", settings).finishing() as result:
            run(bench, result)


if __name__ == "__main__":
    main()
