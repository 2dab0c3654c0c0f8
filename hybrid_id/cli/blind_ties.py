"""`blind ties`: the experiment that the diagnosis proposes is simulated, and the case diagnosed again with it."""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid_id import __version__
from hybrid_id.cli.blind_run import CasesArgument
from hybrid_id.cli.blind_score import AnswersOption, RunsArgument
from hybrid_id.cli.console import show
from hybrid_id.cli.options import Backend, BackendOption, ProcessesOption, SchedulerOption, check_backend
from hybrid_id.cli.progress import counting
from hybrid_id.errors import InputError
from hybrid_id.reporting.provenance import commit

if TYPE_CHECKING:
    from hybrid_id.contenders.run import Case

TIES = "ties"


def ties(
    cases: CasesArgument,
    runs: RunsArgument,
    answers: AnswersOption,
    jobs: ProcessesOption = 1,
    backend: BackendOption = Backend.joblib,
    scheduler: SchedulerOption = None,
) -> None:
    """Run the experiment that 'diagnose' proposes in each case with a tie, and see whether it parts the tied effects.

    The machine is the same one as in the case, made again from its answers. Writes ties.json, which 'blind score' shows
    on its scoreboard.
    """
    from hybrid_id.reporting.scoreboard import ties_line

    check_backend(backend, scheduler)
    show(ties_line(run_ties(cases, runs, answers, jobs, scheduler)))


def run_ties(cases: Path, runs: Path, answers: Path, jobs: int, scheduler: str | None) -> dict[str, Any]:
    """Simulate and diagnose; returns what `resolved` does."""
    from hybrid_id.cli.folder import sole_writer
    from hybrid_id.contenders.keep import is_done, key_of, load, read_run, save, write_json
    from hybrid_id.contenders.run import Settings, read_cases, run_cases

    about = read_run(runs / "diagnose")
    tied = tied_cases(runs / "diagnose")
    sheets = _sheets(answers, about)
    read_cases(cases, about["cases"], list(tied))
    among = about["train_records"]  # the further record comes before them, and displaces none
    folder, settings, at = runs / TIES, Settings("diagnose", among and among + 1), commit()
    folder.mkdir(exist_ok=True)
    richer = _extended(cases, tied, sheets, about["cases"]["options"], jobs)
    keys = {case.name: key_of(case, settings, __version__, at) for case in richer}
    left = [case for case in richer if not is_done(load(folder, case.name), keys[case.name])]
    try:
        with sole_writer(folder), counting("ties") as bar:
            task = bar.add_task("ties", total=len(left))
            for number, said in run_cases(settings, left, jobs=jobs, scheduler=scheduler):
                save(folder, said | {"run": said["run"] | {"commit": at}}, keys[left[number].name])
                bar.advance(task)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; the same command goes on with the cases in {folder}") from None
    found = resolved({name: load(folder, name) for name in tied}, sheets) | {"commit": at}
    write_json(runs / f"{TIES}.json", found)
    return found


def tied_cases(folder: Path) -> dict[str, Mapping[str, Any]]:
    """The proposed experiment of each case with a tie, of a run of the diagnosis."""
    from hybrid_id.contenders.keep import load, read_run

    found, about = {}, read_run(folder)
    for name in about["cases"]["names"]:
        said = load(folder, name) or {}
        current = said.get("run", {}).get("commit") == about["commit"]
        if current and said.get("ties") and said.get("next_experiments"):
            found[name] = said["next_experiments"][0]
    return found


def resolved(again: Mapping[str, Any], sheets: Mapping[str, Any]) -> dict[str, Any]:
    """Share of ties that the further record resolves, and of those resolved to what was at work.

    A tie is resolved, too, where the record shows that something outside the catalogue is at work.

    Args:
        again: the second diagnosis of each case with a tie.
        sheets: answers by case.
    """
    from hybrid_id.blind.judge import judge
    from hybrid_id.blind.score import of_ties

    rows = {}
    for name, said in again.items():
        one = judge(name, sheets[name], said)
        told = said if said is not None and not one.broken else {"effects": [], "ties": []}
        # names that the answers hold for one are told apart by no record
        same = [set(truth.get("right", ())) for truth in sheets[name]["effects"]]
        left = [tie for tie in told["ties"] if not any(set(tie) <= right for right in same)]
        parted = not left and (any(e["selected"] for e in told["effects"]) or bool(told.get("unknown")))
        rows[name] = {"resolved": parted, "right": parted and one.whole, "broken": one.broken}
    return of_ties(rows)


def _sheets(answers: Path, about: Mapping[str, Any]) -> Mapping[str, Any]:
    from hybrid_id.blind.seal import open_answers

    return open_answers(answers, about["cases"]["answers"]["sha256"])


def _extended(
    cases: Path,
    tied: Mapping[str, Mapping[str, Any]],
    sheets: Mapping[str, Any],
    options: Mapping[str, Any],
    jobs: int,
) -> "list[Case]":
    """The files of each case with the proposed record among them."""
    from joblib import Parallel, delayed

    from hybrid_id.study.fan_out import whole_pool

    with whole_pool():
        made = Parallel(n_jobs=jobs)(
            delayed(extended)(cases / name, experiment, sheets[name], options)
            for name, experiment in tied.items()
        )
    return list(made)  # type: ignore[arg-type]


def extended(
    folder: Path, experiment: Mapping[str, Any], sheet: Mapping[str, Any], options: Mapping[str, Any]
) -> "Case":
    """A case with one more record.

    Args:
        folder: of the case.
        experiment: ``joint``, ``command`` and ``sample_time``.
        sheet: its answers, with ``seed`` and ``draw`` that it was made from.
        options: with which all cases were made.
    """
    from hybrid_id.blind.draw import same_case
    from hybrid_id.blind.further import further_record
    from hybrid_id.contenders.run import read_case
    from hybrid_id.records.dataset import Dataset

    source = sheet["made_by"]
    seed = source["seed"]
    machine = same_case(seed, source["draw"], name=folder.name, **options)
    again = {"engine": machine.engine, "formulas": [type(effect).__name__ for effect in machine.effects]}
    sizes = [effect.size() for effect in machine.effects]
    other = any(source.get(key, value) != value for key, value in again.items())
    if other or sizes != [effect["size"] for effect in sheet["effects"]]:
        raise InputError(
            f"case {folder.name} cannot be made again here as its answers tell it ({source['engine']}, "
            f"{', '.join(source['formulas'])}, their sizes); install MuJoCo, and take the version that made the cases"
        )
    record = further_record(
        machine, experiment["joint"], experiment["command"], experiment["sample_time"], seed=seed
    )
    dataset = Dataset.load(folder)
    with tempfile.TemporaryDirectory() as temporary:
        richer = replace(dataset, records=(record, *dataset.records))
        place = richer.save(Path(temporary) / folder.name)
        (place / "model.yaml").write_bytes((folder / "model.yaml").read_bytes())
        return read_case(place)
