"""`init`: dataset.yaml and model.yaml from logs, with the evidence for every guess."""

import os
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from hybrid_id.cli.console import remark, show, show_json
from hybrid_id.cli.folder import RESULTS
from hybrid_id.cli.options import ABOVE, JsonOption
from hybrid_id.cli.schema import schema_line, schema_text
from hybrid_id.errors import InputError, shown
from hybrid_id.reading import announce

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.records.logs import Log, LogFile
    from hybrid_id.records.proposal import Guess
    from hybrid_id.records.proposal_parts import Proposal
    from hybrid_id.records.skew import Skew
    from hybrid_id.systems.proposed_model import ProposedModel

DATASET, MODEL = "dataset.yaml", "model.yaml"
SCHEMAS = ".schema"
"""Folder of the schemas beside both; hidden, so that nobody takes them for logs."""
HEADS = ("about", "taken as", "sure", "evidence")
UNSURE = ("placeholder", "not known")
"""How the evidence of a start value begins that is none."""


def init(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOGS...", help="Log files, or folders of them."),
    ],
    robot: Annotated[Path | None, typer.Option("--robot", help="The robot's MJCF or URDF.")] = None,
    motor: Annotated[
        Path | None,
        typer.Option(
            "--motor", help="YAML of the motor's data sheet: gear_ratio, torque_constant, resistance, ..."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help=f"Folder for the files; the logs' own by default, else the logs are copied. {ABOVE}",
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace dataset.yaml and model.yaml that are there.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write dataset.yaml and model.yaml for logs: columns, units, signs, sampling and roles, each with its evidence.

    What the logs cannot tell stands in the files as a question, with the start that is taken in its place.
    """  # fmt: skip
    from hybrid_id.records.logs import find_logs
    from hybrid_id.records.proposal import JointFacts
    from hybrid_id.records.proposal_parts import MotorSheet
    from hybrid_id.records.proposed_dataset import propose
    from hybrid_id.records.yaml_file import read_yaml, validate
    from hybrid_id.systems.model_file import seen_from
    from hybrid_id.systems.proposed_model import propose_model

    files = find_logs(logs)
    base = _base(files, logs)
    folder = out or base
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give the name of a folder")
    if any((folder / name).exists() for name in RESULTS):
        raise InputError(
            f"{folder} holds results of an earlier run, which 'init' does not touch; give another folder"
        )
    taken = [name for name in (DATASET, MODEL) if (folder / name).exists() or (folder / name).is_symlink()]
    if taken and not force:
        raise InputError(
            f"{folder} holds {' and '.join(taken)}; give another folder by --out, or --force to replace it"
        )
    if odd := [name for name in taken if not (folder / name).is_file()]:
        raise InputError(f"{folder / odd[0]} is no file; give another folder by --out")
    for name in taken:
        announce(folder / name)
    copies = not base.resolve().is_relative_to(folder.resolve())
    if copies and any(file.file_format == "lerobot" for file in files):
        raise InputError(
            f"a LeRobot dataset stays whole; leave out --out, and the files are written into {base}"
        )
    sheet = MotorSheet() if motor is None else validate(MotorSheet, read_yaml(motor), motor)
    tree = None
    if robot is not None:
        from hybrid_id.robots.description import load_tree

        tree = load_tree(robot)
    joints, ties = [], {} if tree is None else tree.tied
    for joint in () if tree is None else tree.joints:
        tied = ties[joint.name].by if joint.name in ties else ""
        servo = joint.servo is not None
        joints.append(JointFacts(joint.name, *joint.limits, joint.kind == "slide", servo, tied))
    read, left = _read(files)
    proposal = propose(read, joints, sheet)
    model = propose_model(proposal.drives, sheet, tree, proposal.held)
    root = base if copies else folder
    skews, dataset = _try(proposal, model, root, folder)
    if "robot" in model.values:
        model.values["robot"] |= {"file": seen_from(folder, model.values["robot"]["file"])}
    texts = {
        DATASET: _dataset_text(proposal, root, folder, skews, left),
        MODEL: _model_text(model),
        **{_schema_of(kind): schema_text(kind) for kind in ("dataset", "model")},
    }
    # write the files under temporary names and rename them; copy logs that lie elsewhere
    copied = proposal.logs if copies else []
    from hybrid_id.records.files import make_folder, write_together

    for log in copied:
        target = folder / log.file.path.resolve().relative_to(base.resolve())
        if target.exists():
            raise InputError(
                f"{target} exists, where a copy of {log.file.path} would go; give another folder"
            )
    make_folder(folder)
    for path in dict.fromkeys(log.file.path for log in copied):
        target = folder / path.resolve().relative_to(base.resolve())
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            shutil.copytree(path, target)
        else:
            shutil.copyfile(path, target)
    (folder / SCHEMAS).mkdir(exist_ok=True)
    write_together({folder / name: text for name, text in texts.items()})
    _say(proposal, model, dataset, skews, left, folder, as_json, copies)


def _base(files: "Sequence[LogFile]", given: Sequence[Path]) -> Path:
    """The folder that the logs lie in: that of a LeRobot dataset, one that was given, or the common one."""
    from hybrid_id.records.readers import in_lerobot

    if any(file.file_format == "lerobot" for file in files):
        folders = {in_lerobot(file.path) for file in files if file.file_format == "lerobot"}
        if len(folders) > 1 or any(file.file_format != "lerobot" for file in files):
            raise InputError("these logs are of several datasets; run 'init' once for each LeRobot dataset")
        whole = folders.pop() or Path()
        return next((one for one in given if one.resolve() == whole.resolve()), whole)
    if len(given) == 1 and given[0].is_dir() and files[0].path != given[0]:
        return given[0]
    parents = [str(file.path.resolve().parent) for file in files]
    common = Path(os.path.commonpath(parents))
    return next((file.path.parent for file in files if file.path.parent.resolve() == common), common)


def _read(files: "Sequence[LogFile]") -> "tuple[list[Log], list[str]]":
    """The logs whose columns are those of most of them, and what was left out and why."""
    from hybrid_id.records.logs import read_log

    read, left = [], []
    for file in files:
        try:
            read.append(read_log(file))
        except InputError as error:
            if file.named:
                raise
            left.append(str(error))
    if not read:
        raise InputError(left[0] if left else "there are no logs")
    kinds = [frozenset(log.columns) for log in read]
    usual = max(kinds, key=lambda kind: (kinds.count(kind), len(kind)))
    fit = [log for log, kind in zip(read, kinds, strict=True) if kind >= usual]
    for log in read:
        if log not in fit:
            faults = [why for name, why in log.left.items() if name in usual]
            left.append(f"{log.file.title}: {faults[0] if faults else 'its columns are others'}")
    return [
        replace(log, columns={n: log.columns[n] for n in fit[0].columns if n in usual}) for log in fit
    ], left


def _try(
    proposal: "Proposal", model: "ProposedModel", root: Path, folder: Path
) -> "tuple[list[Skew], Dataset]":
    """Load what would be written, measure skews, and ask what `check` would object to."""
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.records.proposal_parts import Question
    from hybrid_id.records.quality import check_dataset
    from hybrid_id.records.skew import find_skews
    from hybrid_id.study import check_scales
    from hybrid_id.systems.model_file import load_model

    with tempfile.TemporaryDirectory() as temporary:
        trial = Path(temporary) / DATASET
        trial.write_text(_dataset_text(proposal, root, folder, [], []), encoding="utf-8")
        (Path(temporary) / MODEL).write_text(_model_text(model), encoding="utf-8")
        try:
            dataset = Dataset.load(trial, folder=root)
            system = load_model(Path(temporary) / MODEL)
        except InputError as error:
            raise InputError(f"{str(error).replace(temporary, str(folder))}; nothing was written") from None
        skews = find_skews(dataset)
        for finding in [*check_scales(dataset, system), *check_dataset(dataset)]:
            if finding.severity == "error":
                proposal.questions.append(Question(f"'hybrid-id check' will refuse this: {finding.message}"))
            elif finding.code == "command_range":
                proposal.questions.append(Question(f"Is the unit of the command right? {finding.message}."))
    return skews, dataset


def _schema_of(kind: str) -> str:
    return f"{SCHEMAS}/{kind}.json"


def _flow(values: Any) -> str:
    """Values as YAML on one line."""
    text = yaml.safe_dump(values, default_flow_style=True, sort_keys=False, width=10**9, allow_unicode=False)
    return text.strip().removesuffix("...").strip()


def _comment(words: str, indent: str = "") -> str:
    return f"{indent}# {shown(' '.join(words.split()))}"


def _guess(guess: "Guess", indent: str) -> str:
    return _comment(f"{guess.about}: {guess.value}{'' if guess.sure else ' (?)'} - {guess.evidence}", indent)


def _dataset_text(
    proposal: "Proposal", root: Path, folder: Path, skews: "Sequence[Skew]", left: Sequence[str]
) -> str:
    """`dataset.yaml` with a comment at every guess."""
    late = {skew.channel: skew for skew in skews}
    lines = [
        schema_line(_schema_of("dataset")),
        "# Written by 'hybrid-id init'. A comment above a line says why it is so; (?) marks what is not sure.",
        f"name: {_flow(folder.resolve().name or 'dataset')}",
    ]
    formats = {log.file.file_format for log in proposal.logs}
    if formats == {"lerobot"}:
        lines.append("format: lerobot")
    for group in ("inputs", "outputs"):
        lines.append(f"{group}:")
        for one in getattr(proposal, group):
            entry: dict[str, Any] = {"name": one.name, "unit": one.unit}
            if skew := late.get(one.name):
                lines.append(_comment(skew.message, "  "))
                entry["skew"] = float(f"{skew.late:.3g}")
            lines.append(f"  - {_flow(entry)}")
    lines.append("columns:")
    for one in (proposal.time, *proposal.inputs, *proposal.outputs):
        lines += [_guess(guess, "  ") for guess in one.guesses]
        entry: dict[str, Any] = {"column": one.column}
        if one.name == "t" and one.unit != "s":
            entry["unit"] = one.unit
        if one.scale != 1.0:
            entry["scale"] = float(f"{one.scale:.12g}")
        if one.zero:
            entry["zero"] = one.zero
        if one.unwrap:
            entry["unwrap"] = float(f"{one.unwrap:.12g}")
        lines.append(f"  {one.name}: {_flow(entry)}")
    lines += [_guess(guess, "") for guess in proposal.guesses]
    if proposal.resample:
        lines.append(f"resample: {{max_gap: {proposal.max_gap:g}}}" if proposal.max_gap else "resample: true")
    lines.append("records:")
    for k, log in enumerate(proposal.logs):
        entry = {
            "file": log.file.path.resolve().relative_to(root.resolve()).as_posix(),
            "role": proposal.roles[k],
        }
        if log.file.episode is not None:
            entry["episode"] = log.file.episode
        if k in proposal.between:
            entry["between"] = list(proposal.between[k])
        lines.append(f"  - {_flow(entry)}")
    if proposal.left or left:
        lines += ["", "# Left out:"]
        lines += [_comment(f"  {name}: {why}") for name, why in proposal.left]
        lines += [_comment(f"  {words}") for words in left]
    return "\n".join([*lines, *_questions(proposal.questions), ""])


def _questions(questions: Sequence[Any]) -> list[str]:
    if not questions:
        return []
    lines = ["", "# Questions that the logs do not answer:"]
    for number, question in enumerate(questions, 1):
        lines.append(_comment(f"{number}. {question.words}"))
        lines += [_comment(f"     {question.line}")] if question.line else []
    return lines


def _model_text(model: "ProposedModel") -> str:
    """`model.yaml` with a comment at every start value."""
    lines = [
        schema_line(_schema_of("model")),
        "# Written by 'hybrid-id init'. A comment above a line says where it is from; (?) marks what is not sure.",
    ]
    for key, value in model.values.items():
        if why := model.why.get(key):
            lines.append(_comment(why + (" (?)" if why.startswith(UNSURE) else "")))
        if key in ("parameters", "components"):
            lines.append(f"{key}:")
            items = value.items() if isinstance(value, Mapping) else enumerate(value)
            for name, entry in items:
                if why := model.why.get(f"{key}.{name}"):
                    lines.append(_comment(why + (" (?)" if why.startswith(UNSURE) else ""), "  "))
                lines.append(f"  - {_flow(entry)}" if key == "components" else f"  {name}: {_flow(entry)}")
        else:
            lines.append(f"{key}: {_flow(value)}")
    return "\n".join([*lines, *_questions(model.questions), ""])


def _at(values: Any, place: str) -> str:
    """What stands at a place of the model, in a few words."""
    for key in place.split("."):
        values = values[int(key)] if isinstance(values, list) else values[key]
    if isinstance(values, Mapping):
        words = values.get("nominal", values.get("kind", values.get("file", ", ".join(values))))
        return (
            f"{words} at {values['place']}"
            if "place" in values
            else f"{words} {values.get('unit', '')}".strip()
        )
    return str(values)


def _alike(proposal: "Proposal") -> list[str]:
    """What is left out and why, a line for all columns of which joint and number alone differ."""
    joints = sorted(filter(None, [*(drive.joint for drive in proposal.drives), *proposal.held]), key=len)
    varies = re.compile("|".join([*map(re.escape, reversed(joints)), r"(?<![\d.])\d+(?![\d.])"]))
    found: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for name, why in proposal.left:
        found.setdefault((varies.sub("#", name), varies.sub("#", why)), []).append((name, why))
    more = ("" if len(some) == 1 else f" (and {len(some) - 1} alike)" for some in found.values())
    return [
        f"  {some[0][0]}{and_more}: {some[0][1]}" for some, and_more in zip(found.values(), more, strict=True)
    ]


def _say(
    proposal: "Proposal", model: "ProposedModel", dataset: "Dataset", skews: "Sequence[Skew]", left: Sequence[str],
    folder: Path, as_json: bool, copies: bool,
) -> None:  # fmt: skip
    """What was concluded, and what is open."""
    from hybrid_id.reporting.tables import count, table

    questions = [*proposal.questions, *model.questions]
    rows = [(guess.about, guess.value, guess.sure, guess.evidence) for guess in proposal.all_guesses]
    rows += [(f"skew of {skew.channel}", f"{skew.late:.3g} s", True, skew.message) for skew in skews]
    rows += [
        (f"model: {place}", _at(model.values, place), not why.startswith(UNSURE), why)
        for place, why in model.why.items()
    ]
    if as_json:
        facts = [dict(zip(("about", "value", "sure", "evidence"), row, strict=True)) for row in rows]
        asked = [{"file": f"{one.place}.yaml", "question": one.words, "line": one.line} for one in questions]
        ignored = [{"column": name, "why": why} for name, why in proposal.left]
        found = {"guesses": facts, "questions": asked, "left_out": ignored, "logs_left_out": list(left)}
        show_json("init", found | {"folder": str(folder), "records": [record.name for record in dataset]})
        return
    show(table(HEADS, [(about, value, "yes" if sure else "?", why) for about, value, sure, why in rows]))
    if proposal.left or left:
        show("", "Left out:", *_alike(proposal), *(f"  {one}" for one in left))
    if copies:
        show(f"The logs were copied into {folder}.")
    show("", f"{folder / DATASET} and {folder / MODEL} are written.")
    if questions:
        show(f"{count(len(questions), 'question')} open; the files hold a start in their place:")
        show(*(f"  {k}. ({one.place}.yaml) {one.words}" for k, one in enumerate(questions, 1)))
    remark(f"next: hybrid-id check {folder}")
