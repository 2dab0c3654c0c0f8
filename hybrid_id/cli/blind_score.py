"""`blind score`: diagnoses are held against the answers that were sealed before them."""

import dataclasses
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.console import show
from hybrid_id.cli.options import JsonOption
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.blind.judge import Judged

SCORES, BOARD, PAGE = "scores.json", "scoreboard.md", "report.html"

RunsArgument = Annotated[
    Path, typer.Argument(metavar="RUNS", help="Folder that 'blind run' has filled.", show_default=False)
]
AnswersOption = Annotated[
    Path, typer.Option("--answers", help="Archive of the answers, as it was sealed.", show_default=False)
]
AppendOption = Annotated[
    Path | None,
    typer.Option("--append", help="File that gets the scoreboard as one more section.", show_default=False),
]


def score(
    runs: RunsArgument,
    answers: AnswersOption,
    partial: Annotated[bool, typer.Option("--partial", help="Score an unfinished run.")] = False,
    append: AppendOption = None,
    as_json: JsonOption = False,
) -> None:
    """Score diagnoses; refuses answers that are not those that were sealed before the run.

    All contenders in the folder are scored side by side. Writes scores.json, scoreboard.md, report.html and pictures.
    """
    content = gathered(runs, answers, partial=partial)
    text = write_scores(runs, content, append)
    if as_json:
        stdout().print(text, markup=False, soft_wrap=True)
        return
    from hybrid_id.reporting.scoreboard import markdown

    show(markdown(content))
    show(f"results are in {runs}: {SCORES}, {BOARD}, {PAGE}, pictures")


def gathered(runs: Path, archive: Path, *, partial: bool = False) -> dict[str, Any]:
    """Scores of all contenders in a folder, and what they are about.

    Raises:
        InputError: no run, runs of different cases, other answers, or cases that were not run.
    """
    from hybrid_id.blind.score import scores
    from hybrid_id.blind.targets import against_targets
    from hybrid_id.contenders.keep import read_run

    folders = [runs / method for method in _order() if (runs / method).is_dir()]
    if not folders:
        raise InputError(f"{runs} holds no run; 'hybrid-id blind run CASES --out {runs}' makes one")
    told = {folder.name: read_run(folder) for folder in folders}
    manifest = next(iter(told.values()))["cases"]
    if any(about["cases"] != manifest for about in told.values()):
        raise InputError(f"the runs in {runs} are of different cases; give each a folder of its own")
    judged = {folder.name: judge_run(folder, archive, partial=partial) for folder in folders}
    methods = {}
    for method, cases in judged.items():
        found = scores(cases)
        plain = [dataclasses.asdict(one) for one in cases]
        methods[method] = {"scores": found, "targets": against_targets(found), "judged": plain}
    first = next(iter(told))
    about = {
        "date": told[first]["started"][:10],
        "commit": told[first]["commit"],
        "commits": {method: run["commit"] for method, run in told.items()},
        "seed": manifest["seed"],
        "cases": len(manifest["names"]),
        "scored": len(judged[first]),
        "made_at": manifest["commit"],
        "sha256": manifest["answers"]["sha256"],
        "commands": [_command(manifest, told[first]["train_records"], list(told))],
    }
    told_ties = runs / "ties.json"
    ties = json.loads(told_ties.read_text(encoding="utf-8")) if told_ties.exists() else None
    if ties is not None and ties["commit"] != about["commit"]:
        ties = None
    return {"about": about, "methods": methods, "ties": ties}


def judge_run(folder: Path, archive: Path, *, partial: bool = False) -> "list[Judged]":
    """Every case of one contender's run, judged.

    Raises:
        InputError: other answers than those whose hash the run had recorded, or a run that is not complete.
    """
    from hybrid_id.blind.judge import judge
    from hybrid_id.blind.seal import open_answers
    from hybrid_id.contenders.keep import load, read_run

    about = read_run(folder)
    sheets = open_answers(archive, about["cases"]["answers"]["sha256"])
    said = {name: load(folder, name) for name in about["cases"]["names"]}
    said = {n: s for n, s in said.items() if s is not None and s["run"].get("commit") == about["commit"]}
    left = [name for name in about["cases"]["names"] if name not in said]
    if left and not (partial and said):
        raise InputError(
            f"{folder} lacks {len(left)} of {len(left) + len(said)} cases at commit {about['commit'][:7]} "
            f"({', '.join(left[:3])} ...); run them first, or give --partial"
        )
    return [judge(name, sheets[name], one) for name, one in said.items()]


def write_scores(runs: Path, content: dict[str, Any], append: Path | None) -> str:
    """Write all files under temporary names first, `scores.json` last; returns it as text."""
    from hybrid_id.reporting.blind_figures import confusion_image, reliability_image
    from hybrid_id.reporting.html.blind_page import blind_page
    from hybrid_id.reporting.results import as_json
    from hybrid_id.reporting.scoreboard import append_section, markdown
    from hybrid_id.reporting.style import save

    methods, text = content["methods"], as_json("blind score", content)
    first = next(iter(methods.values()))
    images = {
        "confusion": confusion_image(first["scores"]["confusion"]),
        "reliability": reliability_image({m: told["scores"]["reliability"] for m, told in methods.items()}),
    }
    with tempfile.TemporaryDirectory(dir=runs, prefix=".") as temporary:
        new = Path(temporary)
        for name, image in images.items():
            save(image, new / f"{name}.png")
        blind_page(content, images).write(new / PAGE)
        (new / BOARD).write_text(markdown(content), encoding="utf-8")
        (new / SCORES).write_text(text + "\n", encoding="utf-8")
        for name in (*(f"{image}.png" for image in images), PAGE, BOARD, SCORES):
            (new / name).replace(runs / name)
    if append is not None:
        append_section(append, markdown(content))
    return text


def _order() -> list[str]:
    from hybrid_id.cli.blind_run import Method

    return [method.value for method in Method]


def _command(manifest: dict[str, Any], train_records: int | None, methods: list[str]) -> str:
    """The command that makes, runs and scores the same cases again."""
    options = {"--seed": manifest["seed"], "--cases": manifest["asked"]}
    options |= {f"--{name}": value for name, value in manifest["options"].items() if value is not None}
    if train_records is not None:
        options["--train-records"] = train_records
    words = [word for name, value in options.items() for word in (name, str(value))]
    words += [word for method in methods for word in ("--method", method)]
    return " ".join(["hybrid-id blind reproduce --out blind", *words])
