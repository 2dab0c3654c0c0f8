"""What the blind check does between its generator, the methods that never see an answer, and the scores."""

import dataclasses
import datetime
import shlex
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid_id import __version__
from hybrid_id.cli.console import counting, remark, show
from hybrid_id.cli.folder import make_parents, refuse_taken, remove_empty, sole_writer, visible
from hybrid_id.errors import InputError, MachineError
from hybrid_id.reading import as_written, read_object
from hybrid_id.reporting.provenance import DIRTY, UNKNOWN, commit, short

if TYPE_CHECKING:
    from hybrid_id.machines.score import Judged

BEGUN = ".begun.json"
"""File in a folder of cases that is not complete: what it is to become."""
SCORES, BOARD = "scores.json", "scoreboard.md"
OF_RUN: Mapping[str, Any] = {"commit": str, "started": str}
OF_CASES: Mapping[str, Any] = {"seed": int, "asked": int, "names": list, "options": dict, "commit": str}
"""What a benchmark report says of a run and of its cases, and the kind of each value."""


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


def make_sealed(
    out: Path,
    archive: Path | None,
    cases: int,
    seed: int,
    options: dict[str, str | None],
    jobs: int,
    first: int = 1,
) -> None:
    """Make cases, move their answers into the archive, and say how it went.

    Args:
        out: folder for the cases; one that an earlier run has begun is completed.
        archive: file for the answers; None to leave them in the folder.
        cases: how many.
        seed: of case 1.
        options: of the generator.
        jobs: processes.
        first: number of the first case.

    Raises:
        InputError: the cases or their answers cannot go there, or none could be made.
    """
    from hybrid_id.baselines.run import read_case
    from hybrid_id.machines.make import make_cases
    from hybrid_id.machines.seal import ANSWERS, is_half_sealed, seal, was_sealed
    from hybrid_id.records.files import write_json
    from hybrid_id.reporting.tables import count
    from hybrid_id.study.many import whole_pool

    begun = out / BEGUN
    about: dict[str, Any] = {
        "program": f"hybrid_id {__version__}",
        "commit": commit(),
        "seed": seed,
        "first": first,
        "asked": cases,
        "options": options,
    }
    if not begun.exists():
        if visible(out) or not out.is_dir():
            refuse_taken(out)
    elif read_object(begun, "begun folder of cases") != about:
        raise InputError(f"{out} holds unfinished cases of another seed, number, kind or commit; remove it")
    if archive is not None:
        place, home = archive.resolve().parent, out.resolve()
        if place.is_relative_to(home) or place == home.parent:
            raise InputError(
                f"{archive} is in the folder of the cases or beside it, where 'blind run' could read it; give another"
            )
        if begun.exists() and was_sealed(out, archive):  # killed before its last step
            begun.unlink()
            return show(f"the cases in {out} were sealed already, their answers in {archive}")
        if archive.exists() and not (begun.exists() and is_half_sealed(out, archive)):
            raise InputError(f"{archive} exists already; give the name of a new file as --answers")
        remove_empty(make_parents(archive))  # a trial, before anything is made
    out.mkdir(parents=True, exist_ok=True)
    with sole_writer(out):
        write_json(begun, about)
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
            begun.unlink()
            remove_empty([out])
            raise
        if len(made) < cases:
            remark(f"{cases - len(made)} of {cases} cases were left out: their effect did not show as wanted")
        about["made"] = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        digests = {path.name: read_case(path).digest for path in made}
        sealed = seal(out, archive, about | {"digests": digests})["answers"]["sha256"]
        begun.unlink()
    show(f"{count(len(made), 'case')} in {out}, their answers in {archive or out / ANSWERS}")
    show(f"hash of the answers: {sealed}")


def run_methods(
    cases: Path,
    out: Path,
    methods: Sequence[str],
    jobs: int,
    scheduler: str | None,
    command: str | None = None,
) -> int:
    """Let methods diagnose the cases one after the other; returns how many cases broke."""
    from hybrid_id.baselines.external import digest_of, words_of
    from hybrid_id.baselines.keep import begin, is_done, key_of, load, save
    from hybrid_id.baselines.run import METHODS, Settings, read_cases, run_cases
    from hybrid_id.machines.seal import case_names, read_manifest, refuse_reachable
    from hybrid_id.records.files import make_folder

    methods = [str(method) for method in methods]
    if ("external" in methods) != (command is not None):
        raise InputError("--method external and --command belong together; give both, or neither")
    if command is not None:
        program = words_of(command)[0]
        if scheduler is None and shutil.which(program) is None:
            raise InputError(
                f"--command: {program} is not a program that can be run from here; give its path"
            )
    manifest = read_manifest(cases)
    refuse_reachable(cases, out, manifest)
    if missing := sorted(set(manifest["names"]) ^ set(case_names(cases))):
        raise InputError(f"{cases} and its manifest differ in {', '.join(missing[:5])}; make the cases anew")
    begun = [
        out / name for name in (*METHODS, "external")
    ]  # empty where a run was killed before its first line
    if any(p not in begun or visible(p) for p in visible(out)) and not any(out.glob("*/run.json")):
        raise InputError(f"{out} holds files that are no runs; give another folder")
    broken, todo = 0, read_cases(cases, manifest)
    for method in methods:
        own = (command, digest_of(command)) if command is not None and method == "external" else (None, None)
        settings, folder = Settings(method, *own), out / method
        with sole_writer(make_folder(folder)):
            begin(
                folder,
                {
                    "program": f"hybrid_id {__version__}",
                    "commit": commit(),
                    "method": method,
                    "command": settings.command,
                    "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                    "cases": manifest,
                },
            )
            at = commit()
            keys = {case.name: key_of(case, settings, __version__, at) for case in todo}
            left = [case for case in todo if not is_done(load(folder, case.name), keys[case.name])]
            done, failed = len(todo) - len(left), 0
            if done:
                remark(f"{method}: {done} of {len(todo)} cases are kept from before")
            try:
                with counting(method) as bar:
                    task = bar.add_task(method, total=len(left))
                    for number, said in run_cases(settings, left, jobs=jobs, scheduler=scheduler):
                        case, about = left[number], said["run"]
                        save(folder, said | {"run": about | {"commit": at}}, keys[case.name])
                        done, failed = done + 1, failed + bool(about["message"])
                        bar.advance(task)
                        how = about["message"] or f"{said['verdict']}, {about['seconds']:.0f} s"
                        line = f"{method} {done} of {len(todo)}: {case.name}, {' '.join(how.split())}"
                        bar.console.print(line, markup=False, soft_wrap=True, style="dim")
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"stopped; {done} of {len(todo)} cases are kept in {folder}, and the same command goes on"
                ) from None
        if failed:
            remark(f"{method}: {failed} of {len(todo)} cases broke; the same command tries them again")
        broken += failed
    return broken


def gathered(runs: Sequence[Path], archives: Sequence[Path], order: Sequence[str]) -> dict[str, Any]:
    """Scores of all methods in the folders of all parts, and what they are about.

    Args:
        runs: folder of each part.
        archives: answers of each part.
        order: names of the methods as they shall stand.

    Raises:
        InputError: no run, runs of different cases, parts that do not belong together, other answers, or cases that
            were not run.
    """
    from hybrid_id.machines.score import against_targets, scores
    from hybrid_id.machines.seal import MANIFEST

    if len(runs) != len(archives):
        raise InputError(f"{len(runs)} folders of runs but {len(archives)} archives; give --answers for each")
    judged: dict[str, list[Judged]] = {}
    manifests, programs, by_method = [], [], {}
    for folder, archive in zip(runs, archives, strict=True):
        part = {method: _complete(folder / method) for method in order if (folder / method).is_dir()}
        if not part:
            cases = (folder / MANIFEST).exists()
            command = f"{folder} --out RUNS" if cases else f"CASES --out {folder}"
            raise InputError(
                f"{folder} holds no run{', but cases' if cases else ''}; 'hybrid-id blind run {command}' makes one"
            )
        manifest = next(iter(part.values()))["cases"]
        if any(run["cases"] != manifest for run in part.values()):
            raise InputError(f"the runs in {folder} are of different cases; give each a folder of its own")
        known = {m: [run.get(key) for key in ("commit", "command")] for m, run in part.items()}
        programs.append([known, *(manifest[key] for key in ("seed", "options", "commit"))])
        if programs[-1] != programs[0]:
            raise InputError(
                f"{folder} and {runs[0]} differ in seed, kind of cases, method, command or commit; score them apart"
            )
        number = 1 + sum(one["asked"] for one in manifests)
        if len(runs) > 1 and manifest.get("first", 1) != number:
            raise InputError(f"{folder} does not begin with case {number}; give all parts, in their order")
        manifests.append(manifest)
        by_method = by_method or part
        for method in part:
            judged.setdefault(method, []).extend(judge_run(folder / method, archive))
    methods = {}
    for method, ones in judged.items():
        found = scores(ones)
        targets = against_targets(found, next((one.realism for one in ones), "clean"))
        methods[method] = {
            "scores": found,
            "targets": targets,
            "judged": [dataclasses.asdict(one) for one in ones],
        }
    (first, run), manifest = next(iter(by_method.items())), manifests[0]
    asked = sum(one["asked"] for one in manifests)
    options = {"seed": manifest["seed"], "cases": asked, "first": manifest.get("first", 1)} | manifest[
        "options"
    ]
    words = [
        word for name, value in options.items() if value is not None for word in (f"--{name}", str(value))
    ]
    about = {
        "date": run["started"][:10],
        "commit": run["commit"],
        "commits": {method: run["commit"] for method, run in by_method.items()},
        "seed": manifest["seed"],
        "asked": asked,
        "cases": sum(len(one["names"]) for one in manifests),
        "scored": len(judged[first]),
        "made_at": manifest["commit"],
        "sha256": [one["answers"]["sha256"] for one in manifests],
        "command": shlex.join(["hybrid-id", "blind", "make", "--out", "cases", *words]),
    }
    return {"about": about, "methods": methods}


def _complete(folder: Path) -> dict[str, Any]:
    """What a run is about, with all keys that a benchmark report says of it.

    Raises:
        InputError: there is no run, or it lacks one of them.
    """
    from hybrid_id.baselines.keep import RUN, read_run

    about = read_run(folder)
    for part, keys in ((about, OF_RUN), (about["cases"], OF_CASES)):
        for key, kind in keys.items():
            if key not in part or not isinstance(part[key], kind):
                words = f"key '{key}' is missing or of another kind; run the cases again"
                raise InputError(f"{folder / RUN}: {words}")
    return about


def judge_run(folder: Path, archive: Path) -> "list[Judged]":
    """Every case of one method's run, judged.

    Raises:
        InputError: other answers than those whose hash the run had recorded, or a run that is not complete.
    """
    from hybrid_id.baselines.keep import load
    from hybrid_id.machines.score import judge
    from hybrid_id.machines.seal import open_answers

    about = _complete(folder)
    sheets = open_answers(archive, about["cases"]["answers"]["sha256"])
    said = {name: load(folder, name) for name in about["cases"]["names"]}
    said = {n: s for n, s in said.items() if s is not None and s["run"].get("commit") == about["commit"]}
    left = [name for name in about["cases"]["names"] if name not in said]
    if left:
        raise InputError(
            f"{folder} lacks {len(left)} of {len(left) + len(said)} cases at commit {short(about['commit'])} "
            f"({', '.join(left[:3])} ...); run them first"
        )
    judged = []
    for name, one in said.items():
        with as_written(folder / name, "run the case again, or give the answers that belong to it"):
            judged.append(judge(name, sheets[name], one))
    return judged


def write_scores(runs: Path, content: dict[str, Any]) -> str:
    """Write both files under temporary names first, `scores.json` last; returns `scores.json` as text."""
    from hybrid_id.records.files import hidden_beside
    from hybrid_id.reporting.results import as_json
    from hybrid_id.reporting.scoreboard import markdown

    text = as_json("blind score", content)
    with hidden_beside(runs / SCORES) as new:
        (new / BOARD).write_text(markdown(content), encoding="utf-8")
        (new / SCORES).write_text(text + "\n", encoding="utf-8")
        for name in (BOARD, SCORES):
            (new / name).replace(runs / name)
    return text
