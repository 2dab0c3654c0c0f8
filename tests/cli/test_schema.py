"""JSON schemas of the settings files: an editor accepts what the program reads, and marks what it refuses."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from hybrid_id.cli.schema import MODELS, model_of, schema_line, schema_text

jsonschema = pytest.importorskip("jsonschema")
ROOT = Path(__file__).parents[2]
SETTINGS = [path for place in ("configs", "experiments") for path in (ROOT / place).rglob("*.yaml")]
KIND_BY_KEYS = {"dataset": {"name", "outputs", "records"}, "model": {"gear_ratio"}, "study": {"dataset"}}
"""Keys by which a file of a kind is known among all that lie about."""


def checker(kind: str) -> Any:
    return jsonschema.Draft202012Validator(json.loads(schema_text(kind)))


def faults(kind: str, values: Any) -> list[str]:
    return [error.message for error in checker(kind).iter_errors(values)]


def settings() -> list[tuple[str, Path]]:
    """Every dataset, model and study file of the repository that the program itself accepts."""
    found = []
    for path in SETTINGS:
        values = yaml.safe_load(path.read_text())
        for kind, keys in KIND_BY_KEYS.items():
            if keys <= values.keys() and not set(values) - set(model_of(kind).model_fields):
                found.append((kind, path))
    return found


@pytest.mark.parametrize(("kind", "path"), settings(), ids=lambda value: str(value).removeprefix(str(ROOT)))
def test_what_the_program_reads_is_no_fault(kind: str, path: Path) -> None:
    assert faults(kind, yaml.safe_load(path.read_text())) == []


def test_files_of_every_kind_are_among_them() -> None:
    assert {kind for kind, _ in settings()} == set(KIND_BY_KEYS)


DATASET = {"name": "a", "outputs": [{"name": "q_m1", "unit": "deg"}], "records": [{"file": "a.csv"}]}
MODEL = {"system": "one_link", "gear_ratio": [50], "parameters": {"F_c": 0.01, "J": {"nominal": 2e-5}}}


@pytest.mark.parametrize(
    ("kind", "whole", "changes"),
    [
        (
            "dataset",
            DATASET,
            {"resample": True, "columns": {"u1": "volts", "t": {"column": "ms", "unit": "ms"}}},
        ),
        ("model", MODEL, {"components": [{"place": "joint1/motor_friction", "kind": "stribeck_friction"}]}),
        ("study", {"dataset": "a"}, {}),  # the model beside the records
        ("study", {"dataset": "a"}, {"identification": {"window": "whole"}}),
        ("motor", {}, {"gear_ratio": 20, "torque_constant": 0.03}),
    ],
)
def test_short_forms_are_no_fault(kind: str, whole: dict, changes: dict) -> None:
    assert faults(kind, whole | changes) == []


@pytest.mark.parametrize(
    ("kind", "whole", "changes", "words"),
    [
        ("dataset", DATASET, {"sample_tim": 0.1}, "'sample_tim' was unexpected"),
        ("dataset", DATASET, {"outputs": [{"name": "q_m1", "unit": "degree"}]}, "'degree' is not one of"),
        ("dataset", DATASET, {"columns": {"u1": 3}}, "3 is not valid"),
        ("model", MODEL, {"components": [{"place": "joint1/moto", "kind": "cogging"}]}, "does not match"),
        ("motor", {}, {"inertia": -1.0}, "-1.0 is not valid"),
    ],
)
def test_what_the_program_refuses_is_marked(kind: str, whole: dict, changes: dict, words: str) -> None:
    assert any(words in fault for fault in faults(kind, whole | changes))


@pytest.mark.parametrize("kind", MODELS)
def test_every_key_is_described(kind: str) -> None:
    schema = json.loads(schema_text(kind))
    parts = (schema, *schema.get("$defs", {}).values())
    bare = [
        f"{part['title']}.{key}"
        for part in parts
        for key, one in part["properties"].items()
        if "description" not in one
    ]
    assert bare == []


def test_command_writes_it(run, tmp_path: Path) -> None:
    said = run("schema", "model", "--out", tmp_path / "a" / "model.json")
    assert said.code == 0 and schema_line("model.json") in said.err
    assert json.loads((tmp_path / "a" / "model.json").read_text())["title"] == "ModelFile"
    assert run("schema", "study", "--out", tmp_path / "a" / "model.json", "--force").code == 0
    assert json.loads((tmp_path / "a" / "model.json").read_text())["title"] == "StudyConfig"
    assert json.loads(run("schema", "dataset").out)["title"] == "DatasetFile"
    assert run("schema", "robot").code == 2
