"""`blind score`: diagnoses are held against the answers that were sealed before them."""

import dataclasses
import json
import shlex
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.console import remark, show
from hybrid_id.cli.options import JsonOption
from hybrid_id.errors import InputError
from hybrid_id.reporting.provenance import short

if TYPE_CHECKING:
    from hybrid_id.blind.judge import Judged

SCORES, BOARD, PAGE = "scores.json", "scoreboard.md", "report.html"

RunsArgument = Annotated[
    Path, typer.Argument(metavar="RUNS", help="Folder that 'blind run' has filled.", show_default=False)
]
PartsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUNS...",
        help="Folder that 'blind run' has filled, or those of all parts.",
        show_default=False,
    ),
]
AnswersOption = Annotated[
    Path, typer.Option("--answers", help="Archive of the answers, as it was sealed.", show_default=False)
]
ArchivesOption = Annotated[
    list[Path],
    typer.Option(
        "--answers", help="Archive of the answers, as it was sealed; one a part.", show_default=False
    ),
]
PublishOption = Annotated[
    Path | None,
    typer.Option(
        "--publish",
        metavar="FOLDER",
        help="Folder of published scoreboards: gets this one as a file, and a line in its README.md.",
        show_default=False,
    ),
]
AppendOption = Annotated[Path | None, typer.Option("--append", hidden=True)]
"""Former name of ``--publish``, which took a page and added the scoreboard at its end."""


def score(
    runs: PartsArgument,
    answers: ArchivesOption,
    partial: Annotated[bool, typer.Option("--partial", help="Score an unfinished run.")] = False,
    publish: PublishOption = None,
    append: AppendOption = None,
    as_json: JsonOption = False,
) -> None:
    """Score diagnoses; refuses answers that are not those that were sealed before the run.

    All contenders in the folder are scored side by side. Cases that were made and run in parts are scored together.
    Writes scores.json, scoreboard.md, report.html and pictures into the (first) folder.
    """
    folder = published_in(publish, append)
    content = gathered(runs, answers, partial=partial)
    text = write_scores(runs[0], content, folder)
    if as_json:
        stdout().print(text, markup=False, soft_wrap=True)
        return
    from hybrid_id.reporting.scoreboard import markdown

    show(markdown(content))
    show(f"results are in {runs[0]}: {SCORES}, {BOARD}, {PAGE}, pictures")


def published_in(publish: Path | None, append: Path | None) -> Path | None:
    """Folder of published scoreboards; for the page that ``--append`` names it is the folder ``boards`` beside it."""
    if append is not None:
        if publish is not None:
            raise InputError("--publish and --append contradict each other; give --publish alone")
        if not append.suffix or append.is_dir():
            raise InputError(f"--append {append} is no name of a file of text; give one that ends in .md")
        publish = append.parent / "boards"
        remark(
            f"--append is deprecated, for each scoreboard is a file of its own now; give --publish {publish}"
        )
    if publish is not None and publish.exists() and not publish.is_dir():
        raise InputError(f"--publish {publish} is a file; give a folder")
    return publish


def gathered(runs: Sequence[Path], archives: Sequence[Path], *, partial: bool = False) -> dict[str, Any]:
    """Scores of all contenders in the folders of all parts, and what they are about.

    Raises:
        InputError: no run, runs of different cases, parts that do not belong together, other answers, or cases that
            were not run.
    """
    from hybrid_id.blind.score import scores
    from hybrid_id.blind.targets import against_targets

    if len(runs) != len(archives):
        raise InputError(f"{len(runs)} folders of runs but {len(archives)} archives; give --answers for each")
    parts = [_runs_in(folder) for folder in runs]
    told, manifests = parts[0], [next(iter(part.values()))["cases"] for part in parts]
    _check_parts(runs, parts, manifests)
    judged: dict[str, list[Judged]] = {method: [] for method in told}
    for folder, archive in zip(runs, archives, strict=True):
        part = {method: judge_run(folder / method, archive, partial=partial) for method in told}
        shared = set.intersection(*({one.case for one in cases} for cases in part.values()))
        for method, cases in part.items():  # of an unfinished run, what all contenders have taken
            judged[method] += [one for one in cases if one.case in shared]
    methods = {}
    for method, cases in judged.items():
        found = scores(cases)
        plain = [dataclasses.asdict(one) for one in cases]
        realism = "messy" if any(one.realism == "messy" for one in cases) else "clean"
        methods[method] = {"scores": found, "targets": against_targets(found, realism), "judged": plain}
    first, manifest = next(iter(told)), manifests[0]
    asked = sum(one["asked"] for one in manifests)
    about = {
        "date": told[first]["started"][:10],
        "commit": told[first]["commit"],
        "commits": {method: run["commit"] for method, run in told.items()},
        "seed": manifest["seed"],
        "asked": asked,
        "cases": sum(len(one["names"]) for one in manifests),
        "scored": len(judged[first]),
        "made_at": manifest["commit"],
        "sha256": [one["answers"]["sha256"] for one in manifests],
        "commands": _commands(manifest | {"asked": asked}, told),
    }
    return {"about": about, "methods": methods, "ties": _ties(runs, about["commit"])}


def _runs_in(folder: Path) -> dict[str, dict[str, Any]]:
    """What each contender's run in a folder is about."""
    from hybrid_id.contenders.keep import read_run

    told = {method: read_run(folder / method) for method in _order() if (folder / method).is_dir()}
    if not told:
        raise InputError(f"{folder} holds no run; 'hybrid-id blind run CASES --out {folder}' makes one")
    manifest = next(iter(told.values()))["cases"]
    if any(about["cases"] != manifest for about in told.values()):
        raise InputError(f"the runs in {folder} are of different cases; give each a folder of its own")
    return told


def _check_parts(
    runs: Sequence[Path], parts: Sequence[dict[str, Any]], manifests: Sequence[dict[str, Any]]
) -> None:
    """Refuse parts that are not one set of cases, taken by the same programs."""

    def same(part: dict[str, Any], manifest: dict[str, Any]) -> Any:
        known = ("commit", "train_records", "command")
        programs = {method: [run.get(key) for key in known] for method, run in part.items()}
        return programs, manifest["seed"], manifest["options"], manifest["commit"]

    number = 1
    for folder, part, manifest in zip(runs, parts, manifests, strict=True):
        if same(part, manifest) != same(parts[0], manifests[0]):
            raise InputError(
                f"{folder} and {runs[0]} differ in seed, kind of cases, method, command or commit; score them apart"
            )
        if len(runs) > 1 and manifest.get("first", 1) != number:
            raise InputError(f"{folder} does not begin with case {number}; give all parts, in their order")
        number += manifest["asked"]


def _ties(runs: Sequence[Path], commit: str) -> dict[str, Any] | None:
    """What became of ties, of all parts together; None where not all that there are have been tried at this commit."""
    from hybrid_id.blind.score import of_ties
    from hybrid_id.cli.blind_ties import tied_cases

    files = [folder / "ties.json" for folder in runs]
    found = [json.loads(file.read_text(encoding="utf-8")) for file in files if file.exists()]
    if len(found) < len(files) or any(one["commit"] != commit for one in found):
        return None
    if any(set(one["cases"]) != set(tied_cases(f / "diagnose")) for one, f in zip(found, runs, strict=True)):
        return None
    return of_ties({name: one for part in found for name, one in part["cases"].items()}) | {"commit": commit}


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
            f"{folder} lacks {len(left)} of {len(left) + len(said)} cases at commit {short(about['commit'])} "
            f"({', '.join(left[:3])} ...); run them first, or give --partial"
        )
    return [judge(name, sheets[name], one) for name, one in said.items()]


def write_scores(runs: Path, content: dict[str, Any], folder: Path | None) -> str:
    """Write all files under temporary names first, `scores.json` last, and publish; returns `scores.json` as text."""
    from hybrid_id.reporting.blind_figures import confusion_figure, reliability_figure
    from hybrid_id.reporting.html.blind_page import blind_page
    from hybrid_id.reporting.results import as_json
    from hybrid_id.reporting.scoreboard import INDEX, markdown, publish
    from hybrid_id.reporting.style import save

    methods, text = content["methods"], as_json("blind score", content)
    first = next(iter(methods.values()))
    figures = {
        "confusion": confusion_figure(first["scores"]["confusion"]),
        "reliability": reliability_figure({m: told["scores"]["reliability"] for m, told in methods.items()}),
    }
    with tempfile.TemporaryDirectory(dir=runs, prefix=".") as temporary:
        new = Path(temporary)
        for name, figure in figures.items():
            save(figure.image, new / f"{name}.png")
        blind_page(content, figures).write(new / PAGE)
        (new / BOARD).write_text(markdown(content), encoding="utf-8")
        (new / SCORES).write_text(text + "\n", encoding="utf-8")
        for name in (*(f"{name}.png" for name in figures), PAGE, BOARD, SCORES):
            (new / name).replace(runs / name)
    if folder is not None:
        file = publish(folder, content, {name: figure.image for name, figure in figures.items()})
        remark(f"published as {file}, listed in {folder / INDEX}")
    return text


def _order() -> list[str]:
    from hybrid_id.cli.blind_run import Method

    return [method.value for method in Method]


def _commands(manifest: dict[str, Any], told: dict[str, dict[str, Any]]) -> list[str]:
    """Commands that make, run and score the same cases again: one for all contenders with the same settings."""
    alike: dict[Any, dict[str, dict[str, Any]]] = {}
    for method, run in told.items():
        alike.setdefault((run["train_records"], run["commit"]), {})[method] = run
    return [_command(manifest, some) for some in alike.values()]


def _command(manifest: dict[str, Any], told: dict[str, dict[str, Any]]) -> str:
    """One of these."""
    first = manifest.get("first", 1)
    options = {
        "--seed": manifest["seed"],
        "--cases": manifest["asked"],
        "--first": first if first > 1 else None,
    }
    options |= {f"--{name}": value for name, value in manifest["options"].items()}
    options["--train-records"] = next(iter(told.values()))["train_records"]
    options["--command"] = next((run["command"] for run in told.values() if run.get("command")), None)
    given = {name: value for name, value in options.items() if value is not None}
    words = [word for name, value in given.items() for word in (name, str(value))]
    words += [word for method in told for word in ("--method", method)]
    return shlex.join(["hybrid-id", "blind", "reproduce", "--out", "blind", *words])
