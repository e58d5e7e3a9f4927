# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab study``: sweep a sensor's parameters, press every design, report what is best."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from taccel_lab.errors import InputError, SimulationError, keeping

if TYPE_CHECKING:
    from taccel_lab.studies.evaluate.cluster import Where
    from taccel_lab.studies.evaluate.runner import StudyOutcome
    from taccel_lab.studies.spec.study import Study


@dataclass(frozen=True)
class StudyCommand:
    """Sweep a sensor's parameters: standard presses on every design, a table, a report.

    The study file names sensor, parameters, presses and metrics (docs/studies.md). Every finished
    design becomes a row. The same command continues a stopped study, and evaluates only what a
    changed file adds. Exit code 1: no design meets the constraints; the report names the nearest
    one.

    Example: taccel-lab study mini_thickness_hardness --out out/mini
    """

    study: Positional[Path | None] = None
    """Study file (TOML), or the name of an example."""
    out: Path | None = None
    """Folder of the study, new or begun. Default: out/NAME-OF-THE-FILE."""
    processes: int | None = None
    """Number of processes. Default: one a core, or one for a GPU."""
    device: str | None = None
    """Device of the solver: cpu or cuda:0. Default: the study file's."""
    accuracy: Literal["fast", "default", "reference"] | None = None
    """Accuracy of the presses, as in taccel-lab press. Default: the study file's."""
    limit: int | None = None
    """Stop after this number of new designs; a later run continues."""
    shard: str | None = None
    """Part i of n, such as 2/8; several runs share the folder. Afterwards the same command
    without --shard finishes what is left and writes table and report."""
    submit: Literal["slurm", "local"] | None = None
    """Submit --shards jobs by submitit, to SLURM or as processes of this machine, and stop."""
    shards: int = 8
    """Jobs of --submit."""
    job: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")] = ()
    """Settings of submitit's jobs, e.g. slurm_partition=cpu timeout_min=240 cpus_per_task=8."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUES")] = ()
    """Values of parameters in place of what the study file says of them, e.g. thickness_mm=3,4,5
    young_modulus_mpa=0.2."""
    report_only: bool = False
    """Write table and report from the designs that are there; evaluate nothing."""
    list_metrics: bool = False
    """Show what can be measured, and stop."""
    list_presses: bool = False
    """Show the standard presses, and stop."""
    json: bool = False
    """Print the result, or a list, as JSON."""

    def run(self) -> None:
        from taccel_lab.files.inner_path import file_or_example
        from taccel_lab.files.shard import Shard

        if self.list_metrics or self.list_presses:
            _print_lists(self)
            return
        if self.study is None:
            raise InputError("name a study file; docs/studies.md shows how to write one")
        if self.limit is not None and self.limit < 1:
            raise InputError(f"limit must be at least 1, got {self.limit}")
        if self.shard is not None and (self.submit or self.report_only):
            raise InputError("--shard cannot be combined with --submit or --report-only")
        if self.set and self.submit:
            raise InputError("--submit's jobs read the study file; write there what --set says")
        if self.shard is not None:
            Shard.parse(self.shard)
        if self.processes is not None and not 1 <= self.processes <= 1024:
            raise InputError(f"processes must lie in 1..1024, got {self.processes}")
        file = file_or_example(self.study, "studies")
        if self.submit:
            self._submit(file, self.submit)
        else:
            self._run(file)

    def _submit(self, file: Path, where: Where) -> None:
        from taccel_lab.cad.parameters import parse_overrides
        from taccel_lab.cli.console import notes
        from taccel_lab.files.shard import MOST_SHARDS
        from taccel_lab.studies.evaluate.cluster import JOBS, submit_shards

        if not 1 <= self.shards <= MOST_SHARDS:
            raise InputError(f"shards must lie in 1..{MOST_SHARDS}, got {self.shards}")
        root = self.out or Path("out") / file.stem
        settings = {
            name: int(value) if isinstance(value, float) and value % 1 == 0 else value
            for name, value in parse_overrides(self.job).items()
        }
        jobs = submit_shards(
            file, root, self.shards, where, device=self.device, processes=self.processes,
            accuracy=self.accuracy, settings=settings,
        )  # fmt: skip
        notes().print(
            f"{len(jobs)} jobs submitted ({jobs[0].job_id} ...), logs in {root / JOBS}; when they "
            f"have finished:\n  {self._again(root)}",
            soft_wrap=True,
        )

    def _run(self, file: Path) -> None:
        from taccel_lab.api.study import plan_study
        from taccel_lab.cli.console import notes, print_json, say, working
        from taccel_lab.printable import counted
        from taccel_lab.studies.evaluate.runner import read_outcome
        from taccel_lab.studies.evaluate.study_folder import StudyFolder
        from taccel_lab.studies.report import write_study_report

        console = notes()
        swept = self._swept()
        study = plan_study(file, self.accuracy, swept)
        root = self.out or Path("out") / file.stem

        def what() -> str:
            folder = StudyFolder(root)
            if not folder.is_study():
                return ""
            count = len(folder.ids())
            kept = f"{counted(count, 'finished design stays', 'finished designs stay')} in {root}"
            return f"{kept if count else 'no design has finished'}; go on with: {self._again(root)}"

        with keeping(what):
            if self.report_only:
                outcome = read_outcome(study, root)
            else:
                outcome = self._evaluate(study, root, file, swept)
            if self.shard is not None:
                say(
                    f"shard {self.shard}: {len(outcome.rows)} designs have rows, {outcome.new} of "
                    f"them new; when all shards have finished:\n  {self._again(root)}"
                )
                if self.json:
                    print_json({"designs": len(outcome.rows), "new": outcome.new})
                outcome.require_whole()
                return
            with working(console, "writing the report"):
                values = write_study_report(outcome)
        self._conclude(outcome, values, root, self._again(root))

    def _swept(self) -> dict[str, list[float | str]]:
        from taccel_lab.cad.parameters import parse_overrides

        given = parse_overrides(self.set)
        return {name: v if isinstance(v, list) else [v] for name, v in given.items()}

    def _again(self, root: Path) -> str:
        words = ["taccel-lab", "study", str(self.study), "--out", str(root)]
        for name in ("processes", "device", "accuracy"):
            if getattr(self, name) is not None:
                words += [f"--{name}", str(getattr(self, name))]
        if self.set:
            words += ["--set", *self.set]
        return shlex.join(words)

    def _evaluate(
        self, study: Study, root: Path, file: Path, swept: dict[str, list[float | str]]
    ) -> StudyOutcome:
        from taccel_lab.api.study import evaluate_study
        from taccel_lab.cli.console import notes, say
        from taccel_lab.cli.study_lines import StudyProgress
        from taccel_lab.files.shard import Shard

        presses = ", ".join(study.presses) or "none"
        say(
            f"{study.spec.study.name}: {study.family.name}, presses {presses}, "
            f"{len(study.metrics)} metrics, into {root}"
        )
        with StudyProgress(notes(), study) as progress:
            return evaluate_study(
                study,
                file,
                root,
                processes=self.processes,
                device=self.device,
                limit=self.limit,
                shard=None if self.shard is None else Shard.parse(self.shard),
                listener=progress,
                swept=swept,
            )

    def _conclude(self, outcome: StudyOutcome, values: dict, root: Path, again: str) -> None:
        from taccel_lab.cli.console import print_json, say
        from taccel_lab.cli.study_lines import print_summary
        from taccel_lab.studies.evaluate.study_folder import CSV_NAME, has_parquet

        if self.json:
            print_json(values)
        else:
            print_summary(outcome, values)
        note = "" if has_parquet() else " (Parquet too, once pyarrow is installed)"
        if outcome.rows:
            say(f"table: {root / CSV_NAME}{note}")
        else:
            say("no table: none of the designs has been evaluated")
        say(f"report: {root / 'report.html'}")
        if not outcome.complete:
            say(f"not finished; go on with:\n  {again}")
            return
        if not any(row.status == "done" for row in outcome.rows):
            raise SimulationError(f"no design has a figure; the causes stand in {root / CSV_NAME}")
        if not values["verdict"]["good"]:
            raise SystemExit(1)


def _print_lists(options: StudyCommand) -> None:
    from taccel_lab.cli.console import print_json, print_table
    from taccel_lab.studies.evaluate.runner import default_kit
    from taccel_lab.studies.report.describe import press_in_words
    from taccel_lab.studies.spec.readings import described

    kit = default_kit()
    metrics = {
        name: {
            "unit": metric.unit,
            "better": metric.better,
            "presses": [*metric.presses, *metric.also],
            "description": described(metric).description,
        }
        for name, metric in kit.metrics.items()
    }
    presses = {name: press_in_words(press) for name, press in kit.presses.items()}
    if options.json:
        print_json(
            ({"metrics": metrics} if options.list_metrics else {})
            | ({"presses": presses} if options.list_presses else {})
        )
        return
    if options.list_metrics:
        columns = ("metric", "unit", "better", "read from", "meaning")
        rows = [
            (name, m["unit"], m["better"], ", ".join(m["presses"]) or "no press", m["description"])
            for name, m in metrics.items()
        ]
        print_table(columns, rows, "metrics")
    if options.list_presses:
        print_table(("press", "what it does"), list(presses.items()), "standard presses")
