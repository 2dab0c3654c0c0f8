"""What the blind check does between its generator, the methods that never see an answer, and the scores."""

import dataclasses
import datetime
import shlex
import tempfile
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid_id import __version__
from hybrid_id.cli.console import counting, remark, show
from hybrid_id.cli.folder import make_parents, refuse_taken, remove_empty, sole_writer, visible
from hybrid_id.errors import InputError, MachineError
from hybrid_id.reading import as_written, read_object
from hybrid_id.reporting.provenance import DIRTY, UNKNOWN, commit, short

if TYPE_CHECKING:
    from hybrid_id.baselines.run import Case, Settings
    from hybrid_id.machines.judge import Judged

BEGUN = ".begun.json"
"""File in a folder of cases that is not complete: what it is to become."""
TIES_RESOLVED = 0.8
"""Share of ties that the next experiment is to resolve."""
ONE_LAW = {"constant_torque", "asymmetric_friction"}
"""Dry friction whose levels differ by direction is a torque beside an even one: no record distinguishes these."""
SCORES, BOARD, PAGE, TIES = "scores.json", "scoreboard.md", "report.html", "ties"
OF_RUN: Mapping[str, Any] = {"commit": str, "started": str, "train_records": int | None}
OF_CASES: Mapping[str, Any] = {"seed": int, "asked": int, "names": list, "options": dict, "commit": str}
"""What a benchmark report says of a run and of its cases, and the kind of each value."""

# ---- cases are made ----


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


def generator_options(
    system: str | None, family: str | None, effect: str | None, level: str | None, engine: str | None, realism: str
) -> dict[str, str | None]:  # fmt: skip
    """Options of the generator as the manifest holds them; clean cases hold as much as before there were others."""
    options = {"system": system, "family": family, "effect": effect, "level": level, "engine": engine}
    return options if realism == "clean" else options | {"realism": realism}


def make_sealed(
    out: Path,
    archive: Path | None,
    cases: int,
    seed: int,
    options: dict[str, str | None],
    jobs: int,
    first: int = 1,
    *,
    once: bool = False,
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
        once: whether cases that are complete and the same are taken as they are.

    Raises:
        InputError: the cases or their answers cannot go there, or none could be made.
    """
    from hybrid_id.baselines.run import read_case
    from hybrid_id.machines.seal import ANSWERS, is_half_sealed, refuse_others, seal, was_sealed
    from hybrid_id.records.files import write_json
    from hybrid_id.reporting.tables import count

    begun = out / BEGUN
    if once and archive is not None and archive.exists() and not begun.exists():
        return refuse_others(out, asked=cases, seed=seed, options=options, first=first)
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
    from hybrid_id.machines.make import make_cases
    from hybrid_id.study.many import whole_pool

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


# ---- cases are diagnosed ----


def run_methods(
    cases: Path,
    out: Path,
    methods: Sequence[str],
    train_records: int | None,
    jobs: int,
    scheduler: str | None,
    command: str | None = None,
) -> int:
    """Let methods diagnose the cases one after the other; returns how many cases broke."""
    from hybrid_id.baselines.external import digest_of, refuse_missing, words_of
    from hybrid_id.baselines.keep import begin
    from hybrid_id.baselines.run import METHODS, Settings, read_cases
    from hybrid_id.machines.seal import case_names, read_manifest, refuse_reachable
    from hybrid_id.records.files import make_folder

    methods = [str(method) for method in methods]
    if ("external" in methods) != (command is not None):
        raise InputError("--method external and --command belong together; give both, or neither")
    if command is not None:
        if train_records is not None:
            raise InputError("an external baseline takes cases as they are; leave --train-records out")
        program = words_of(command)[0]
        if scheduler is None:
            refuse_missing(program)
    manifest = read_manifest(cases)
    refuse_reachable(cases, out, manifest)
    if missing := sorted(set(manifest["names"]) ^ set(case_names(cases))):
        raise InputError(f"{cases} and its manifest differ in {', '.join(missing[:5])}; make the cases anew")
    begun = [
        out / name for name in (*METHODS, "external")
    ]  # a run killed before its first line leaves it empty
    if any(p not in begun or visible(p) for p in visible(out)) and not any(out.glob("*/run.json")):
        raise InputError(f"{out} holds files that are no runs; give another folder")
    broken, todo = 0, read_cases(cases, manifest)
    for method in methods:
        own = (command, digest_of(command)) if command is not None and method == "external" else (None, None)
        settings, folder = Settings(method, train_records, *own), out / method
        with sole_writer(make_folder(folder)):
            begin(
                folder,
                {
                    "program": f"hybrid_id {__version__}",
                    "commit": commit(),
                    "method": method,
                    "train_records": settings.train_records,
                    "command": settings.command,
                    "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                    "cases": manifest,
                },
            )
            failed = _diagnose(todo, folder, settings, method, jobs, scheduler)
        if failed:
            remark(f"{method}: {failed} of {len(todo)} cases broke; the same command tries them again")
        broken += failed
    return broken


def _diagnose(
    todo: "Sequence[Case]", folder: Path, settings: "Settings", noun: str, jobs: int, scheduler: str | None
) -> int:
    """Diagnose the cases that the folder does not hold yet, keep each as it is done; returns how many broke."""
    from hybrid_id.baselines.keep import is_done, key_of, load, save
    from hybrid_id.baselines.run import run_cases

    at = commit()
    keys = {case.name: key_of(case, settings, __version__, at) for case in todo}
    left = [case for case in todo if not is_done(load(folder, case.name), keys[case.name])]
    done, broken = len(todo) - len(left), 0
    if done:
        remark(f"{noun}: {done} of {len(todo)} cases are kept from before")
    try:
        with counting(noun) as bar:
            task = bar.add_task(noun, total=len(left))
            for number, said in run_cases(settings, left, jobs=jobs, scheduler=scheduler):
                case, about = left[number], said["run"]
                save(folder, said | {"run": about | {"commit": at}}, keys[case.name])
                done, broken = done + 1, broken + bool(about["message"])
                bar.advance(task)
                how = about["message"] or f"{said['verdict']}, {about['seconds']:.0f} s"
                line = f"{noun} {done} of {len(todo)}: {case.name}, {' '.join(how.split())}"
                bar.console.print(line, markup=False, soft_wrap=True, style="dim")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {done} of {len(todo)} cases are kept in {folder}, and the same command goes on"
        ) from None
    return broken


# ---- tied effects get the proposed experiment ----


def run_ties(cases: Path, runs: Path, answers: Path, jobs: int, scheduler: str | None) -> dict[str, Any]:
    """Simulate the proposed experiment of each case with a tie, diagnose again, and write and return `resolved`."""
    from joblib import Parallel, delayed

    from hybrid_id.baselines.keep import load
    from hybrid_id.baselines.run import Settings, read_cases
    from hybrid_id.machines.seal import open_answers
    from hybrid_id.records.files import write_json
    from hybrid_id.study.many import whole_pool

    about = _complete(runs / "diagnose")
    tied = tied_cases(runs / "diagnose")
    sheets = open_answers(answers, about["cases"]["answers"]["sha256"])
    read_cases(cases, about["cases"], list(tied))
    among = about["train_records"]
    folder, settings = runs / TIES, Settings("diagnose")
    folder.mkdir(exist_ok=True)
    with whole_pool():
        richer: Any = Parallel(n_jobs=jobs)(
            delayed(extended)(cases / name, experiments, sheets[name], about["cases"]["options"], among)
            for name, (_, experiments) in tied.items()
        )
    with sole_writer(folder):
        _diagnose([case for case in richer if case is not None], folder, settings, TIES, jobs, scheduler)
    before = {name: ties for name, (ties, _) in tied.items()}
    found = resolved(before, {name: load(folder, name) for name in tied}, sheets) | {"commit": commit()}
    write_json(runs / f"{TIES}.json", found)
    return found


def tied_cases(folder: Path) -> dict[str, tuple[list[list[str]], list[Mapping[str, Any]]]]:
    """The ties of each case of a run of the diagnosis that has one, and the experiments that it proposes."""
    from hybrid_id.baselines.keep import load, read_run

    found, about = {}, read_run(folder)
    for name in about["cases"].get("names", ()):
        said = load(folder, name) or {}
        current = said.get("run", {}).get("commit") == about.get("commit")
        with as_written(folder / name, "run the case again"):
            proposed = [one for one in said.get("next_experiments", ()) if "command" in one]
        if current and said.get("ties") and proposed:
            found[name] = said["ties"], proposed
    return found


def resolved(
    before: Mapping[str, Sequence[Sequence[str]]], again: Mapping[str, Any], sheets: Mapping[str, Any]
) -> dict[str, Any]:
    """Share of ties that the follow-up records resolve, and of cases in which they show just what was at work.

    A tie is resolved where none of its effects that is named is indistinguishable from another any more, and something
    is said: effects, or that something outside the catalogue is at work.

    Args:
        before: each case's ties.
        again: the second diagnosis of each.
        sheets: answers by case.
    """
    from hybrid_id.machines.judge import judge
    from hybrid_id.machines.score import of_ties

    rows = {}
    for name, said in again.items():
        one = judge(name, sheets[name], said)
        answer = said if said is not None and not one.broken else {"effects": [], "ties": []}
        says = any(e["selected"] for e in answer["effects"]) or bool(answer.get("unknown"))
        # no record distinguishes names that the answers hold for one
        same = [set(truth.get("right", ())) for truth in sheets[name]["effects"]]
        ties = [
            {
                "effects": list(tie),
                "resolved": says and not any(still_tied(tie, left, same) for left in answer["ties"]),
            }
            for tie in before[name]
        ]
        right = one.whole and all(tie["resolved"] for tie in ties)
        rows[name] = {"ties": ties, "right": right, "broken": one.broken}
    return of_ties(rows, TIES_RESOLVED)


def still_tied(tie: Sequence[str], left: Sequence[str], same: Sequence[Set[str]]) -> bool:
    """Whether an effect of a tie, ``name@where``, leads another one: with what is no other name of the same thing."""

    def one_thing(a: str, b: str) -> bool:
        (name, place), (other, there) = a.split("@"), b.split("@")
        alike = {name, other} == ONE_LAW and place.partition("/")[0] == there.partition("/")[0]
        return alike or any({a, b} <= right for right in same)

    first, *others = left
    return first in tie and not all(one_thing(first, other) for other in others)


def extended(
    folder: Path,
    experiments: Sequence[Mapping[str, Any]],
    sheet: Mapping[str, Any],
    options: Mapping[str, Any],
    among: int | None = None,
) -> "Case | None":
    """A case, or ``among`` of its train records, with one more of each experiment; None where an arm runs away.

    See :func:`hybrid_id.machines.further.further_records`.
    """
    from hybrid_id.baselines.run import read_case, with_train_records
    from hybrid_id.machines.arms.motion import Unstable
    from hybrid_id.machines.further import further_records
    from hybrid_id.records.dataset import Dataset

    dataset = with_train_records(Dataset.load(folder), among)
    try:
        records = further_records(folder.name, experiments, sheet, options)
    except Unstable:
        return None
    with tempfile.TemporaryDirectory() as temporary:
        richer = dataclasses.replace(dataset, records=(*records, *dataset.records))
        place = richer.save(Path(temporary) / folder.name)
        for file in folder.iterdir():  # model and description
            if not (place / file.name).exists():
                (place / file.name).write_bytes(file.read_bytes())
        return read_case(place)


# ---- diagnoses are scored ----


def published_in(publish: Path | None, append: Path | None) -> Path | None:
    """Folder of published reports; for the page that ``--append`` names it is the folder ``boards`` beside it."""
    if append is not None:
        if publish is not None:
            raise InputError("--publish and --append contradict each other; give --publish alone")
        if not append.suffix or append.is_dir():
            raise InputError(f"--append {append} is no name of a file of text; give one that ends in .md")
        publish = append.parent / "boards"
        remark(
            f"--append is deprecated, for each benchmark report is a file of its own; give --publish {publish}"
        )
    if publish is not None and publish.exists() and not publish.is_dir():
        raise InputError(f"--publish {publish} is a file; give a folder")
    return publish


def gathered(
    runs: Sequence[Path], archives: Sequence[Path], order: Sequence[str], *, partial: bool = False
) -> dict[str, Any]:
    """Scores of all methods in the folders of all parts, and what they are about.

    Args:
        runs: folder of each part.
        archives: answers of each part.
        order: names of the methods as they shall stand.
        partial: whether unfinished runs are scored.

    Raises:
        InputError: no run, runs of different cases, parts that do not belong together, other answers, or cases that
            were not run.
    """
    from hybrid_id.machines.score import against_targets, scores

    if len(runs) != len(archives):
        raise InputError(f"{len(runs)} folders of runs but {len(archives)} archives; give --answers for each")
    parts = [_runs_in(folder, order) for folder in runs]
    by_method, manifests = parts[0], [next(iter(part.values()))["cases"] for part in parts]
    _check_parts(runs, parts, manifests)
    judged: dict[str, list[Judged]] = {method: [] for method in by_method}
    for folder, archive in zip(runs, archives, strict=True):
        part = {method: judge_run(folder / method, archive, partial=partial) for method in by_method}
        shared = set.intersection(*({one.case for one in cases} for cases in part.values()))
        for method, cases in part.items():  # of an unfinished run, the cases that all methods have diagnosed
            judged[method] += [one for one in cases if one.case in shared]
    methods = {}
    for method, cases in judged.items():
        found = scores(cases)
        plain = [dataclasses.asdict(one) for one in cases]
        realism = next((one.realism for one in cases), "clean")
        methods[method] = {"scores": found, "targets": against_targets(found, realism), "judged": plain}
    first, manifest = next(iter(by_method)), manifests[0]
    asked = sum(one["asked"] for one in manifests)
    about = {
        "date": by_method[first]["started"][:10],
        "commit": by_method[first]["commit"],
        "commits": {method: run["commit"] for method, run in by_method.items()},
        "seed": manifest["seed"],
        "asked": asked,
        "cases": sum(len(one["names"]) for one in manifests),
        "scored": len(judged[first]),
        "made_at": manifest["commit"],
        "sha256": [one["answers"]["sha256"] for one in manifests],
        "commands": _commands(manifest | {"asked": asked}, by_method),
    }
    return {"about": about, "methods": methods, "ties": _ties(runs, about["commit"])}


def _runs_in(folder: Path, order: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What each method's run in a folder is about."""
    by_method = {method: _complete(folder / method) for method in order if (folder / method).is_dir()}
    if not by_method:
        from hybrid_id.machines.seal import MANIFEST

        cases = (folder / MANIFEST).exists()
        command = f"{folder} --out RUNS" if cases else f"CASES --out {folder}"
        raise InputError(
            f"{folder} holds no run{', but cases' if cases else ''}; 'hybrid-id blind run {command}' makes one"
        )
    manifest = next(iter(by_method.values()))["cases"]
    if any(about["cases"] != manifest for about in by_method.values()):
        raise InputError(f"the runs in {folder} are of different cases; give each a folder of its own")
    return by_method


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


def _check_parts(
    runs: Sequence[Path], parts: Sequence[dict[str, Any]], manifests: Sequence[dict[str, Any]]
) -> None:
    """Refuse parts that are not one set of cases, diagnosed by the same programs."""

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
    from hybrid_id.machines.score import of_ties

    files = [folder / f"{TIES}.json" for folder in runs]
    found = [read_object(file, "list of ties") for file in files if file.exists()]
    if len(found) < len(files) or any(one.get("commit") != commit for one in found):
        return None
    with as_written(runs[0], "resolve the ties again"):
        if any(
            set(one["cases"]) != set(tied_cases(f / "diagnose")) for one, f in zip(found, runs, strict=True)
        ):
            return None
    cases = {name: one for part in found for name, one in part["cases"].items()}
    return of_ties(cases, TIES_RESOLVED) | {"commit": commit}


def judge_run(folder: Path, archive: Path, *, partial: bool = False) -> "list[Judged]":
    """Every case of one method's run, judged.

    Raises:
        InputError: other answers than those whose hash the run had recorded, or a run that is not complete.
    """
    from hybrid_id.baselines.keep import load
    from hybrid_id.machines.judge import judge
    from hybrid_id.machines.seal import open_answers

    about = _complete(folder)
    sheets = open_answers(archive, about["cases"]["answers"]["sha256"])
    said = {name: load(folder, name) for name in about["cases"]["names"]}
    said = {n: s for n, s in said.items() if s is not None and s["run"].get("commit") == about["commit"]}
    left = [name for name in about["cases"]["names"] if name not in said]
    if left and not (partial and said):
        raise InputError(
            f"{folder} lacks {len(left)} of {len(left) + len(said)} cases at commit {short(about['commit'])} "
            f"({', '.join(left[:3])} ...); run them first, or give --partial"
        )
    judged = []
    for name, one in said.items():
        with as_written(folder / name, "run the case again, or give the answers that belong to it"):
            judged.append(judge(name, sheets[name], one))
    return judged


def write_scores(runs: Path, content: dict[str, Any], folder: Path | None) -> str:
    """Write all files under temporary names first, `scores.json` last, and publish; returns `scores.json` as text."""
    from hybrid_id.records.files import hidden_beside
    from hybrid_id.reporting.results import as_json
    from hybrid_id.reporting.scoreboard import INDEX, blind_page, markdown, publish, scoreboard_figures
    from hybrid_id.reporting.style import save

    text, figures = as_json("blind score", content), scoreboard_figures(content)
    with hidden_beside(runs / SCORES) as new:
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


def _commands(manifest: dict[str, Any], by_method: dict[str, dict[str, Any]]) -> list[str]:
    """Commands that make, run and score the same cases again: one for all methods with the same settings."""
    alike: dict[Any, dict[str, dict[str, Any]]] = {}
    for method, run in by_method.items():
        alike.setdefault((run["train_records"], run["commit"]), {})[method] = run
    return [_command(manifest, some) for some in alike.values()]


def _command(manifest: dict[str, Any], by_method: dict[str, dict[str, Any]]) -> str:
    """One of these."""
    first = manifest.get("first", 1)
    options = {
        "--seed": manifest["seed"],
        "--cases": manifest["asked"],
        "--first": first if first > 1 else None,
    }
    options |= {f"--{name}": value for name, value in manifest["options"].items()}
    options["--train-records"] = next(iter(by_method.values()))["train_records"]
    options["--command"] = next((run["command"] for run in by_method.values() if run.get("command")), None)
    given = {name: value for name, value in options.items() if value is not None}
    words = [word for name, value in given.items() for word in (name, str(value))]
    words += [word for method in by_method for word in ("--method", method)]
    return shlex.join(["hybrid-id", "blind", "reproduce", "--out", "blind", *words])
