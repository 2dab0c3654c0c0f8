"""What halving or doubling each criterion of a diagnosis does to a set of cases: run.py FOLDER [CASE ...]."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
import yaml

from hybrid_id import Dataset, diagnose, load_model
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.identification.keep import Kept
from hybrid_id.machines.score import Judged, judge

OUT = Path("runs/criteria")
FACTORS = (0.5, 2.0)


@contextmanager
def varied(name: str, value: float) -> Iterator[None]:
    """The criteria of this process with one of them changed."""
    before = getattr(CRITERIA, name)
    object.__setattr__(CRITERIA, name, value)  # frozen for all but this experiment
    try:
        yield
    finally:
        object.__setattr__(CRITERIA, name, before)


def answered(folder: Path, case: str) -> tuple[Judged, tuple[Any, ...]]:
    """A case's diagnosis held against its answer, and what it says: verdict, unknown, and the effects that it names."""
    kept = OUT / folder.name / case
    kept.mkdir(parents=True, exist_ok=True)
    dataset, system = Dataset.load(folder / case), load_model(folder / case / "model.yaml")
    said = diagnose(dataset, system, kept=Kept(kept, "criteria")).as_dict()
    names = tuple(f"{e['name']}@{e['where']}" for e in said["effects"] if e["selected"])
    truth = yaml.safe_load((folder / "answers" / f"{case}.yaml").read_text())
    return judge(case, truth, said), (said["verdict"], said["unknown"], names)


def line(name: str, answers: dict[str, tuple[Judged, tuple[Any, ...]]], usual: dict[str, Any]) -> str:
    """A row of the table."""
    judged = [one for one, _ in answers.values()]
    asked = [one.top_1 for one in judged if one.top_1 is not None]
    changed = [case for case, (_, said) in answers.items() if said != usual[case][1]]
    right = f"{sum(one.whole for one in judged)} of {len(judged)}"
    return f"| {name} | {sum(asked)} of {len(asked)} | {right} | {', '.join(changed) or '-'} |"


def main() -> None:
    """Diagnose all cases as usual, then with each criterion halved and doubled."""
    torch.set_num_threads(1)
    folder = Path(sys.argv[1])
    cases = sys.argv[2:] or sorted(path.stem for path in (folder / "answers").glob("*.yaml"))
    usual = {case: answered(folder, case) for case in cases}
    print("| criterion | first name right | exactly right | answers that change |\n| --- | --- | --- | --- |")
    print(line("as they are", usual, usual), flush=True)
    for one in fields(CRITERIA):
        for factor in FACTORS:
            value = factor * getattr(CRITERIA, one.name)
            with varied(one.name, value):
                found = {case: answered(folder, case) for case in cases}
            print(line(f"{one.name} {value:g}", found, usual), flush=True)


if __name__ == "__main__":
    main()
