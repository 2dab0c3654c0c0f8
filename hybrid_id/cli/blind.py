"""`blind`: cases whose unmodelled effect is withheld, those who take them, and the scoreboard."""

import datetime
import json
import sys
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid_id import __version__
from hybrid_id.cli.blind_run import (
    BROKEN,
    CommandOption,
    Method,
    MethodsOption,
    RecordsOption,
    run,
    run_methods,
    seed_of,
)
from hybrid_id.cli.blind_score import AppendOption, PublishOption, gathered, published_in, score, write_scores
from hybrid_id.cli.blind_ties import run_ties, ties
from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.console import remark, show
from hybrid_id.cli.options import (
    Backend,
    BackendOption,
    JsonOption,
    ProcessesOption,
    SchedulerOption,
    check_backend,
)
from hybrid_id.cli.progress import counting
from hybrid_id.errors import InputError, MachineError
from hybrid_id.reporting.provenance import commit

BEGUN = ".begun.json"
"""File in a folder of cases that is not complete: what it is to become."""

blind = typer.Typer(
    help="Cases whose unmodelled effect is withheld: make them, diagnose them, score the diagnoses."
)


@blind.callback()
def _blind() -> None:
    """Cases whose unmodelled effect is withheld: make them, diagnose them, score the diagnoses."""


CountOption = Annotated[int, typer.Option("--cases", help="Number of cases.", min=1)]
FirstOption = Annotated[
    int, typer.Option(help="Number of the first case: a large set may be made and run in parts.", min=1)
]
SeedOption = Annotated[
    str,
    typer.Option(help="Seed of case 1, the others count up; 'commit' takes it from the hash of this commit."),
]
SystemOption = Annotated[
    str | None, typer.Option(help="one_link, one_link_flexible or two_link.", show_default="drawn")
]
FamilyOption = Annotated[
    str | None, typer.Option(help="single, pair, none, parameters or unknown.", show_default="drawn")
]
EffectOption = Annotated[
    str | None, typer.Option(help="Name of the effect, say backlash.", show_default="drawn")
]
LevelOption = Annotated[str | None, typer.Option(help="strong, medium or weak.", show_default="drawn")]
RealismOption = Annotated[
    str,
    typer.Option(
        help="clean: one thing lacks, or two. messy: a dominant one among small ones, drifting friction and "
        "imperfect encoders; with --family none or parameters nothing but those."
    ),
]
EngineOption = Annotated[
    str | None, typer.Option(help="in_house, or mujoco where it is installed.", show_default="drawn")
]


def _options(
    system: str | None,
    family: str | None,
    effect: str | None,
    level: str | None,
    engine: str | None,
    realism: str,
) -> dict[str, str | None]:
    """Options of the generator as the manifest tells them; clean cases tell as much as before there were others."""
    options = {"system": system, "family": family, "effect": effect, "level": level, "engine": engine}
    return options if realism == "clean" else options | {"realism": realism}


@blind.command()
def make(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the cases.", show_default=False)],
    answers: Annotated[
        Path | None,
        typer.Option(
            "--answers",
            help="Archive for the answers.",
            show_default="sealed/NAME.answers.tar beside the folder",
        ),
    ] = None,
    open_answers: Annotated[
        bool, typer.Option("--open-answers", help="Leave the answers in answers/, for development.")
    ] = False,
    cases: CountOption = 24,
    first: FirstOption = 1,
    seed: SeedOption = "0",
    system: SystemOption = None,
    family: FamilyOption = None,
    effect: EffectOption = None,
    level: LevelOption = None,
    engine: EngineOption = None,
    realism: RealismOption = "clean",
    jobs: ProcessesOption = 1,
) -> None:
    """Make records of machines in which something is at work that their model lacks.

    Each case is a folder with records and today's simulator, ready for every command that takes a dataset. Its answers
    go into an archive apart, whose hash stands in manifest.json beside the cases. The physics is another one than that
    of the models.
    """
    if open_answers and answers is not None:
        raise InputError("--answers and --open-answers contradict each other; give one of them")
    options = _options(system, family, effect, level, engine, realism)
    archive = None if open_answers else answers or out.parent / "sealed" / f"{out.name}.answers.tar"
    make_sealed(out, archive, cases, seed_of(seed), options, jobs, first)


def make_sealed(
    out: Path,
    archive: Path | None,
    cases: int,
    seed: int,
    options: dict[str, str | None],
    jobs: int,
    first: int = 1,
) -> None:
    """Make cases, move their answers into the archive, and say how it went."""
    from hybrid_id.blind.seal import ANSWERS, is_half_sealed, seal, was_sealed
    from hybrid_id.cli.folder import make_parents, refuse_taken, remove_empty, sole_writer, visible
    from hybrid_id.contenders.keep import write_json
    from hybrid_id.contenders.run import read_case
    from hybrid_id.reporting.tables import count

    about: dict[str, Any] = {
        "program": f"hybrid_id {__version__}",
        "commit": commit(),
        "seed": seed,
        "first": first,
        "asked": cases,
        "options": options,
    }
    begun = out / BEGUN
    if not begun.exists():
        if visible(out) or not out.is_dir():
            refuse_taken(out)
    elif json.loads(begun.read_text(encoding="utf-8")) != about:
        raise InputError(f"{out} holds unfinished cases of another seed, number, kind or commit; remove it")
    place, home = None if archive is None else archive.resolve().parent, out.resolve()
    if place is not None and (place.is_relative_to(home) or place == home.parent):
        raise InputError(
            f"{archive} is in the folder of the cases or beside it, where 'blind run' could read it; give another"
        )
    if archive is not None and begun.exists() and was_sealed(out, archive):  # killed before its last step
        begun.unlink()
        return show(f"the cases in {out} were sealed already, their answers in {archive}")
    if archive is not None and archive.exists() and not (begun.exists() and is_half_sealed(out, archive)):
        raise InputError(f"{archive} exists already; give the name of a new file as --answers")
    if archive is not None:
        remove_empty(make_parents(archive))  # a trial, before anything is made
    out.mkdir(parents=True, exist_ok=True)
    with sole_writer(out):
        write_json(begun, about)
        made = _make(out, cases, seed, options, jobs, first)
        if len(made) < cases:
            remark(f"{cases - len(made)} of {cases} cases were left out: their effect did not show as wanted")
        about["made"] = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        digests = {path.name: read_case(path).digest for path in made}
        sealed = seal(out, archive, about | {"digests": digests})["answers"]["sha256"]
        begun.unlink()
    show(f"{count(len(made), 'case')} in {out}, their answers in {archive or out / ANSWERS}")
    show(f"hash of the answers: {sealed}")


def _make(
    out: Path, cases: int, seed: int, options: dict[str, str | None], jobs: int, first: int
) -> list[Path]:
    """Make cases in a folder that remembers what it is to hold until they are sealed."""
    from hybrid_id.blind.make import make_cases
    from hybrid_id.cli.folder import remove_empty
    from hybrid_id.study.fan_out import whole_pool

    try:
        advice = f"the same command goes on with the cases in {out}, better with fewer --jobs"
        with counting("cases") as bar, whole_pool(advice):
            task = bar.add_task("cases", total=cases)
            made = make_cases(
                cases, seed, out, first=first, jobs=jobs, done=lambda: bar.advance(task), **options
            )
        if not made:
            raise InputError(f"no case of {cases} could be made; give another seed, level or effect")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; the same command goes on with the cases in {out}") from None
    except MachineError:
        raise
    except InputError:
        (out / BEGUN).unlink()
        remove_empty([out])
        raise
    return made


@blind.command()
def reproduce(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for all of it.", show_default=False)],
    cases: CountOption = 24,
    first: FirstOption = 1,
    seed: SeedOption = "0",
    system: SystemOption = None,
    family: FamilyOption = None,
    effect: EffectOption = None,
    level: LevelOption = None,
    engine: EngineOption = None,
    realism: RealismOption = "clean",
    method: MethodsOption = None,
    train_records: RecordsOption = None,
    command: CommandOption = None,
    publish: PublishOption = None,
    append: AppendOption = None,
    jobs: ProcessesOption = 1,
    backend: BackendOption = Backend.joblib,
    scheduler: SchedulerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make, run and score in one command: a published scoreboard again from its seed.

    The same command goes on after Ctrl-C.
    """
    check_backend(backend, scheduler)
    folder = published_in(publish, append)
    from hybrid_id.blind.seal import refuse_others

    made, archive, runs = out / "cases" / "made", out / "sealed" / "made.answers.tar", out / "runs" / "made"
    options = _options(system, family, effect, level, engine, realism)
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        if archive.exists() and not (made / BEGUN).exists():
            refuse_others(made, asked=cases, seed=seed_of(seed), options=options, first=first)
        else:
            make_sealed(made, archive, cases, seed_of(seed), options, jobs, first)
        runs.parent.mkdir(parents=True, exist_ok=True)
        broken = run_methods(made, runs, method or [Method.diagnose], train_records, jobs, scheduler, command)
        if Method.diagnose in (method or [Method.diagnose]):
            run_ties(made, runs, archive, jobs, scheduler)
    content = gathered([runs], [archive])
    text = write_scores(runs, content, folder)
    if as_json:
        stdout().print(text, markup=False, soft_wrap=True)
    else:
        from hybrid_id.reporting.scoreboard import markdown

        show(markdown(content))
        show(f"results are in {runs}")
    if broken:
        raise typer.Exit(BROKEN)


blind.command()(run)
blind.command()(score)
blind.command()(ties)
