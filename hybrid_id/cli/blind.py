"""`blind`: cases whose unmodelled effect is withheld, the methods that diagnose them, and the benchmark report."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hybrid_id.cli import blind_runs as work
from hybrid_id.cli.console import show
from hybrid_id.cli.options import (
    ABOVE,
    Backend,
    BackendOption,
    JsonOption,
    ProcessesOption,
    SchedulerOption,
    check_backend,
)
from hybrid_id.errors import InputError

BROKEN = 3
"""Exit code where a case has broken off, all others being done."""

blind = typer.Typer(
    add_completion=False,
    rich_markup_mode="rich",
    help="Cases whose unmodelled effect is withheld: make them, diagnose them, score the diagnoses.",
)


class Method(StrEnum):
    """Who diagnoses the cases."""

    diagnose = "diagnose"
    bic = "bic"
    stribeck = "stribeck"
    external = "external"


@blind.command()
def make(
    out: Annotated[
        Path, typer.Option("--out", "-o", help=f"Folder for the cases. {ABOVE}", show_default=False)
    ],
    answers: Annotated[
        Path | None,
        typer.Option(
            "--answers",
            help="Archive for the answers (ground truth).",
            show_default="sealed/NAME.answers.tar beside the folder",
        ),
    ] = None,
    open_answers: Annotated[
        bool, typer.Option("--open-answers", help="Leave the answers in answers/, for development.")
    ] = False,
    cases: Annotated[int, typer.Option("--cases", help="Number of cases.", min=1, max=100_000)] = 24,
    first: Annotated[
        int,
        typer.Option(
            help="Number of the first case: a large set may be made and run in parts.", min=1, max=1_000_000
        ),
    ] = 1,
    seed: Annotated[
        str,
        typer.Option(
            help="Seed of case 1, the others count up; 'commit' takes it from the hash of this commit."
        ),
    ] = "0",
    system: Annotated[
        str | None, typer.Option(help="one_link, one_link_flexible or two_link.", show_default="drawn")
    ] = None,
    family: Annotated[
        str | None, typer.Option(help="single, pair, none, parameters or unknown.", show_default="drawn")
    ] = None,
    effect: Annotated[
        str | None, typer.Option(help="Name of the effect, say backlash.", show_default="drawn")
    ] = None,
    level: Annotated[str | None, typer.Option(help="strong, medium or weak.", show_default="drawn")] = None,
    realism: Annotated[
        str,
        typer.Option(
            help="clean: one thing lacks, or two. messy: a dominant one among small ones, drifting friction and "
            "imperfect encoders; with --family none or parameters nothing but those. "
            "arms: as messy, arms of two to seven joints in MuJoCo."
        ),
    ] = "clean",
    jobs: ProcessesOption = 1,
) -> None:
    """Make records of machines in which something is at work that their model lacks.

    Each case is a folder with records and the nominal model, ready for every command that takes a dataset. Its answers
    go into an archive apart, whose hash stands in manifest.json beside the cases. The physics is another one than that
    of the models.
    """
    if open_answers and answers is not None:
        raise InputError("--answers and --open-answers contradict each other; give one of them")
    options = {"system": system, "family": family, "effect": effect, "level": level}
    if realism != "clean":
        options["realism"] = realism
    archive = None if open_answers else answers or out.parent / "sealed" / f"{out.name}.answers.tar"
    work.make_sealed(out, archive, cases, work.seed_of(seed), options, jobs, first)


@blind.command()
def run(
    cases: Annotated[
        Path, typer.Argument(metavar="CASES", help="Folder that 'blind make' has made.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help=f"Folder for the diagnoses. {ABOVE}", show_default=False)
    ],
    method: Annotated[
        list[Method] | None,
        typer.Option(
            "--method",
            help="diagnose, or a baseline: bic, stribeck; or external. May be repeated.",
            show_default="diagnose",
        ),
    ] = None,
    command: Annotated[
        str | None,
        typer.Option(
            help="Program of an external baseline, with {case} for its folder and {answer} for the JSON file to write.",
            show_default=False,
        ),
    ] = None,
    jobs: ProcessesOption = 1,
    backend: BackendOption = Backend.joblib,
    scheduler: SchedulerOption = None,
) -> None:
    """Diagnose every case of a folder; fails where the answers could be read.

    Each diagnosis is kept as soon as it is there: after Ctrl-C the same command goes on. A case that breaks is kept
    with its reason and tried again by the next run.
    """
    check_backend(backend, scheduler)
    methods = method or [Method.diagnose]
    broken = work.run_methods(cases, out, methods, jobs, scheduler, command)
    show(f"diagnoses are in {out}; 'hybrid-id blind score {out} --answers ARCHIVE' scores them")
    if broken:
        raise typer.Exit(BROKEN)


@blind.command()
def score(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUNS...",
            help="Folder that 'blind run' has filled, or those of all parts.",
            show_default=False,
        ),
    ],
    answers: Annotated[
        list[Path],
        typer.Option(
            "--answers",
            help="Archive of the answers (ground truth), as it was sealed; one a part.",
            show_default=False,
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Score diagnoses; refuses answers that are not those that were sealed before the run.

    All methods in the folder are scored side by side. Cases that were made and run in parts are scored together.
    Writes scores.json and scoreboard.md into the (first) folder.
    """
    from hybrid_id.reporting.scoreboard import markdown

    content = work.gathered(runs, answers, [m.value for m in Method])
    text = work.write_scores(runs[0], content)
    if as_json:
        return show(text)
    show(markdown(content))
    show(f"results are in {runs[0]}: {work.SCORES}, {work.BOARD}")
