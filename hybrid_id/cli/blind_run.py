"""`blind run`: cases are taken by contenders that cannot see the answers."""

import datetime
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hybrid_id import __version__
from hybrid_id.cli.console import printable, remark, show
from hybrid_id.cli.options import Backend, BackendOption, ProcessesOption, SchedulerOption, check_backend
from hybrid_id.cli.progress import counting
from hybrid_id.errors import InputError
from hybrid_id.reporting.provenance import DIRTY, UNKNOWN, commit

BROKEN = 3
"""Exit code where a case has broken off, all others being done."""

if TYPE_CHECKING:
    from hybrid_id.contenders.run import Case, Settings


class Method(StrEnum):
    """Who takes the cases."""

    diagnose = "diagnose"
    bic = "bic"
    sparse = "sparse"
    network = "network"
    stribeck = "stribeck"
    external = "external"


CasesArgument = Annotated[
    Path, typer.Argument(metavar="CASES", help="Folder that 'blind make' has made.", show_default=False)
]
MethodsOption = Annotated[
    list[Method] | None,
    typer.Option(
        "--method",
        help="diagnose, or a baseline: bic, sparse, network, stribeck; or external. May be repeated.",
        show_default="diagnose",
    ),
]
RecordsOption = Annotated[
    int | None,
    typer.Option(
        "--train-records", help="So many train records of each case at most.", min=1, show_default="all"
    ),
]

CommandOption = Annotated[
    str | None,
    typer.Option(
        help="Program of an external contender, with {case} for its folder and {answer} for the JSON file to write.",
        show_default=False,
    ),
]


def run(
    cases: CasesArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the diagnoses.", show_default=False)],
    method: MethodsOption = None,
    train_records: RecordsOption = None,
    command: CommandOption = None,
    jobs: ProcessesOption = 1,
    backend: BackendOption = Backend.joblib,
    scheduler: SchedulerOption = None,
) -> None:
    """Diagnose every case of a folder; fails where the answers could be read.

    Each diagnosis is kept as soon as it is there: after Ctrl-C the same command goes on. A case that breaks is kept
    with its reason and tried again by the next run.
    """
    check_backend(backend, scheduler)
    broken = run_methods(cases, out, method or [Method.diagnose], train_records, jobs, scheduler, command)
    show(f"diagnoses are in {out}; 'hybrid-id blind score {out} --answers ARCHIVE' scores them")
    if broken:
        raise typer.Exit(BROKEN)


def run_methods(
    cases: Path,
    out: Path,
    methods: Sequence[Method],
    train_records: int | None,
    jobs: int,
    scheduler: str | None,
    command: str | None = None,
) -> int:
    """Let contenders take the cases one after the other; returns how many cases broke."""
    from hybrid_id.blind.seal import case_names, read_manifest, refuse_reachable
    from hybrid_id.cli.folder import sole_writer, visible
    from hybrid_id.contenders.external import digest_of, refuse_missing, words_of
    from hybrid_id.contenders.keep import make_room
    from hybrid_id.contenders.run import Settings, read_cases

    if (Method.external in methods) != (command is not None):
        raise InputError("--method external and --command belong together; give both, or neither")
    if command is not None and train_records is not None:
        raise InputError("an external contender takes cases as they are; leave --train-records out")
    if command is not None:
        program = words_of(command)[0]
        if scheduler is None:
            refuse_missing(program)
    manifest = read_manifest(cases)
    refuse_reachable(cases, out, manifest)
    if missing := sorted(set(manifest["names"]) ^ set(case_names(cases))):
        raise InputError(f"{cases} and its manifest differ in {', '.join(missing[:5])}; make the cases anew")
    begun = [out / m.value for m in Method]  # killed before its first line, a run leaves an empty folder
    if any(p not in begun or visible(p) for p in visible(out)) and not any(out.glob("*/run.json")):
        raise InputError(f"{out} holds files that are no runs; give another folder")
    broken, todo = 0, read_cases(cases, manifest)
    for m in methods:
        own = (command, digest_of(command)) if m is Method.external else (None, None)
        settings = Settings(m.value, train_records, *own)
        with sole_writer(make_room(out / m.value)):
            broken += _run(todo, out / m.value, settings, manifest, jobs, scheduler)
    return broken


def _run(
    todo: "Sequence[Case]",
    folder: Path,
    settings: "Settings",
    manifest: Mapping[str, Any],
    jobs: int,
    scheduler: str | None,
) -> int:
    """One contender's run; returns how many cases broke."""
    from hybrid_id.contenders.keep import begin, is_done, key_of, load, save
    from hybrid_id.contenders.run import run_cases

    method, at = settings.method, commit()
    begin(
        folder,
        {
            "program": f"hybrid_id {__version__}",
            "commit": at,
            "method": method,
            "train_records": settings.train_records,
            "command": settings.command,
            "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "cases": manifest,
        },
    )
    keys = {case.name: key_of(case, settings, __version__, at) for case in todo}
    left = [case for case in todo if not is_done(load(folder, case.name), keys[case.name])]
    done, broken = len(todo) - len(left), 0
    if done:
        remark(f"{method}: {done} of {len(todo)} cases are kept from before")
    try:
        with counting(method) as bar:
            task = bar.add_task(method, total=len(left))
            for number, said in run_cases(settings, left, jobs=jobs, scheduler=scheduler):
                case, about = left[number], said["run"]
                save(folder, said | {"run": about | {"commit": at}}, keys[case.name])
                done, broken = done + 1, broken + bool(about["message"])
                bar.advance(task)
                how = about["message"] or f"{said['verdict']}, {about['seconds']:.0f} s"
                line = f"{method} {done} of {len(todo)}: {case.name}, {printable(how)}"
                bar.console.print(line, markup=False, soft_wrap=True, style="dim")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {done} of {len(todo)} cases are kept in {folder}, and the same command goes on"
        ) from None
    if broken:
        remark(f"{method}: {broken} of {len(todo)} cases broke; the same command tries them again")
    return broken


def seed_of(text: str) -> int:
    """A seed from a number, or from the hash of the commit that is running."""
    if text.isdecimal():
        return int(text)
    if text != "commit":
        raise InputError(f"--seed {text} is neither a number nor 'commit'; give one of them")
    at = commit()
    if at == UNKNOWN or DIRTY in at:
        raise InputError("--seed commit needs a checkout without changes; commit them, or give a number")
    return int(at[:8], 16)
