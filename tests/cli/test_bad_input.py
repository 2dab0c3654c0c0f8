"""Wrong input through the commands: exit code 2, one sentence that names the place, nothing written."""

from collections.abc import Callable
from pathlib import Path

import pytest
from malformed import contents, malformed_datasets, refused
from malformed_models import malformed_models

# Each study file's text, and what the sentence must name. DATA is a sound dataset, MODEL a sound model.
BOTH = "dataset: DATA\nmodel: MODEL\n"
CONFIGS: dict[str, tuple[str, tuple[str, ...]]] = {
    "misspelt key": ("dataset: DATA\nidentification: {start: 3}\n", ("identification.start", "'starts'")),
    "no dataset": ("model: MODEL\n", ("study.yaml", "'dataset'", "missing")),
    "dataset of no place": ("dataset: nowhere\nmodel: MODEL\n", ("nowhere", "does not exist")),
    "model of no place": ("dataset: DATA\nmodel: gone.yaml\n", ("gone.yaml", "does not exist")),
    "dataset as model": ("dataset: DATA\nmodel: DATA/dataset.yaml\n", ("is a dataset file", "model file")),
    "model as dataset": ("dataset: MODEL\nmodel: MODEL\n", ("is a model file", "dataset file")),
    "name of 300 signs": (f"dataset: {'r' * 300}\nmodel: MODEL\n", ("key 'dataset'", "is longer than the name of any")),
    "word for a number": ("dataset: DATA\nidentification: {starts: many}\n", ("identification.starts", "many")),
    "unknown record": (BOTH + "preprocessing: {records: [rec_7]}\n", ("'rec_7'", "rec_0")),
    "no train record": (BOTH + "preprocessing: {records: [rec_1]}\n", ("no train record",)),
    "window upside down": (BOTH + "preprocessing: {between: [5, 1]}\n", ("between [5, 1] is reversed",)),
    "long step": (BOTH + "preprocessing: {resample: {sample_time: 5}}\n", ("'rec_0'", "5 s")),
    "tiny window": (BOTH + "identification: {window: 1.0e-9}\n", ("identification.window", "25 samples")),
    "long window": (BOTH + "identification: {window: 100}\n", ("identification.window", "four windows")),
    "stage holds a stranger": (BOTH + "previous: {model: MODEL, hold: [f_3]}\n", ("'f_3'", "both models have")),
    "stage without its model": (BOTH + "previous: {model: nowhere.yaml}\n", ("nowhere.yaml",)),
    "not YAML": ("dataset: [DATA\nmodel: ]\n", ("study.yaml", "row 2")),
    "key twice": ("dataset: DATA\ndataset: DATA\n", ("study.yaml", "row 2", "'dataset'")),
}  # fmt: skip


FILES = {
    f"{kind}: {case.name}": (kind, case)
    for kind, cases in (("data", malformed_datasets()), ("model", malformed_models()))
    for case in cases
}


@pytest.mark.parametrize("name", FILES)
def test_malformed_files(name: str, run, sound: tuple[Path, Path], tmp_path: Path) -> None:
    kind, case = FILES[name]
    case.spoil(tmp_path / kind)
    before = contents(tmp_path)
    told = run("identify", sound[0], "--model", sound[1], "--out", tmp_path / "new" / "out")
    refused(told, *case.names)
    assert contents(tmp_path) == before and "\x1b" not in told.err


@pytest.mark.parametrize("name", CONFIGS)
def test_malformed_config(name: str, run, sound: tuple[Path, Path], tmp_path: Path) -> None:
    text, names = CONFIGS[name]
    config = tmp_path / "study.yaml"
    config.write_text(text.replace("DATA", str(sound[0])).replace("MODEL", str(sound[1])))
    before = contents(tmp_path)
    for command in ("identify", "diagnose"):
        refused(run(command, config, "--out", tmp_path / "out"), *names)
    assert contents(tmp_path) == before


def file_in_the_way(folder: Path) -> None:
    (folder / "out").write_text("mine")


def folder_in_use(folder: Path) -> None:
    (folder / "out").mkdir()
    (folder / "out" / "thesis.txt").write_text("mine")


def nothing(folder: Path) -> None:
    pass


# Arguments after which `{data}` is a sound dataset, `{model}` a sound model and `{out}` the folder for the results.
ARGUMENTS: dict[str, tuple[str, Callable[[Path], None], tuple[str, ...]]] = {
    "unknown command": ("identfy {data}", nothing, ("identfy", "identify")),
    "unknown option": ("check {data} --modle x", nothing, ("--modle",)),
    "no dataset": ("identify --out {out}", nothing, ("DATASET", "identify --help")),
    "no folder for the results": ("identify {data} --model {model}", nothing, ("--out",)),
    "word for a number": ("identify {data} --starts many --out {out}", nothing, ("--starts",)),
    "unknown device": ("identify {data} --model {model} --device abacus --out {out}", nothing, ("'abacus'",)),
    "jobs and pooled": ("identify {data} --model {model} --jobs 2 --pooled --out {out}", nothing, ("--pooled",)),
    "no model beside the records": ("identify {data} --out {out}", nothing, ("model.yaml", "does not exist")),
    "file where results go": ("identify {data} --model {model} --out {out}", file_in_the_way, ("out", "no folder")),
    "folder in use": ("identify {data} --model {model} --out {out}", folder_in_use, ("out", "no results")),
    "folder of others": ("simulate {data} --model {model} --out {out} --force", folder_in_use, ("no results",)),
    "file among the parents": ("simulate {data} --model {model} --out {out}/below", file_in_the_way, ("out",)),
    "place where nothing is made": ("identify {data} --out /proc/x", nothing, ("/proc/x", "cannot be made")),
    "folder as model": ("check {data} --model {data}", nothing, ("data", "is a folder")),
    "the same model twice": ("compare {data} -m {model} -m {model} --out {out}", nothing, ("model.yaml", "twice")),
    "no model to compare": ("compare {data} --out {out}", nothing, ("--model",)),
    "nothing to resume": ("train {data} --model {model} --out {out} --resume", nothing, ("checkpoint", "--resume")),
    "band upside down": ("excite --band 8 0.3 --out {out}", nothing, ("--band", "lowest")),
    "tones too fast": ("excite --band 100 400 --out {out}", nothing, ("excitation", "sampling")),
    "too many tones": ("excite --band 1 2 --tones 99 --out {out}", nothing, ("excitation", "99")),
    "an option twice": ("check {data} --joint a --joint=b", nothing, ("--joint", "twice")),
    "an option twice of a command's command": ("blind run {data} --out a --out b", nothing, ("--out", "twice")),
    "options that contradict each other": (
        "identify {data} --pooled --per-record --out {out}", nothing, ("--pooled", "--per-record", "contradict")
    ),
    "resume and force": (
        "identify {data} --model {model} --out {out} --resume --force", nothing, ("--resume", "--force")
    ),
    "a record in the way": ("excite --starts 1 --out {data}/rec_0.csv --force", nothing, ("record of the dataset",)),
    "a device in the way": ("excite --starts 1 --out /dev/full --force", nothing, ("no regular file",)),
    "a gear ratio in words": (
        "init {data}/rec_0.csv --motor {out}.yaml --out {out}",
        lambda folder: (folder / "out.yaml").write_text('gear_ratio: "50:1"\n'),
        ("key 'gear_ratio' must be a valid number, found '50:1'.",),
    ),
    **{
        f"{option} of 400 digits": (f"identify {{data}} {option} {'9' * 400} --out {{out}}", nothing, (option,))
        for option in ("--starts", "--seed")
    },
    "endless rest": ("excite --rest 1e12 --out {out}", nothing, ("--rest", "1,000,000")),
    "endless signal": ("excite --duration 1e9 --out {out}", nothing, ("--duration",)),
    "settings of no place": ("demo --settings {out}/gone.yaml --out {out}", nothing, ("gone.yaml", "does not exist")),
    "settings of another kind": ("demo --settings {model} --out {out}", nothing, ("settings of the twin",)),
}  # fmt: skip


@pytest.mark.parametrize("name", ARGUMENTS)
def test_wrong_arguments(name: str, run, sound: tuple[Path, Path], tmp_path: Path) -> None:
    line, prepare, names = ARGUMENTS[name]
    prepare(tmp_path)
    before = contents(tmp_path)
    words = [word.format(data=sound[0], model=sound[1], out=tmp_path / "out") for word in line.split()]
    refused(run(*words), *names)
    assert contents(tmp_path) == before
