"""What no user means, through the commands: refused in one sentence before the work begins, and never obeyed.

Numbers beyond all use, words that no file or screen can hold, signals read from the wrong column.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import pytest
import yaml
from command_line import whole
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from malformed import change_yaml, contents, refused
from pydantic import BaseModel

from hybrid_id.cli.console import Screen
from hybrid_id.config import StudyConfig
from hybrid_id.errors import InputError, has_control, shown
from hybrid_id.records.yaml_file import validate

HUGE = int("9" * 400)

# --- numbers too big (class 8) ---------------------------------------------------------------------------------------


def command_options() -> list[tuple[str, Any]]:
    """Every option and argument of every command, below the words that call it."""
    found: list[tuple[str, Any]] = []

    def walk(command: Any, words: str) -> None:
        found.extend((words, one) for one in command.params)
        for name, below in getattr(command, "commands", {}).items():
            walk(below, f"{words} {name}".strip())

    walk(whole(), "")
    return found


def test_every_whole_number_of_the_command_line_has_an_end() -> None:
    kinds = [
        (f"{words} {one.name}", one.type_descriptor)
        for words, one in command_options()
        if hasattr(one, "type_descriptor")  # typer's own --help has none
    ]
    whole = [(name, kind) for name, kind in kinds if kind.annotation is int]
    assert len(whole) > 10
    assert not [name for name, kind in whole if kind.parameter_info.max is None]


def number_keys(model: type[BaseModel], above: str = "") -> dict[str, tuple[str, ...]]:
    """Keys of whole and of other numbers in a schema, by what `unbounded` may hold."""
    found: dict[str, tuple[str, ...]] = {}
    for name, field in model.model_fields.items():
        kinds = set(types_in(field.annotation))
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= number_keys(kind, f"{above}{name}.")
        found[f"{above}{name}"] = tuple(kind.__name__ for kind in kinds if kind in (int, float))
    return {key: kinds for key, kinds in found.items() if kinds}


def types_in(annotation: Any) -> list[Any]:
    parts = [part for part in get_args(annotation)[: 1 if get_origin(annotation) is Annotated else None]]
    return [annotation, *(deeper for part in parts for deeper in types_in(part))]


def study_with(key: str, value: object) -> dict[str, Any]:
    """A study file's values with one set, in as many lists as the key wants."""
    section, _, name = key.partition(".")
    values: dict[str, Any] = {"dataset": "data", "model": "model.yaml"}
    if section == "hybrid" and name.startswith("networks."):
        return values | {"hybrid": {"networks": [{name.removeprefix("networks."): value}]}}
    if name.startswith("resample."):
        return values | {section: {"resample": {name.removeprefix("resample."): value}}}
    if name.startswith("fourier."):
        return values | {section: {"fourier": {name.removeprefix("fourier."): value}}}
    return values | {section: {name: value}}


@pytest.mark.parametrize("key", number_keys(StudyConfig))
def test_no_number_of_a_study_file_is_beyond_all_use(key: str) -> None:
    """A number of 400 digits, 1e300 and a truth value are refused under their key, alone and in lists."""
    for value in (HUGE, -HUGE, True):
        for one in (value, [value], [[value, value]], [value, value], [[0.2, value]]):
            with pytest.raises(InputError) as raised:
                validate(StudyConfig, study_with(key, one), "study.yaml")
            assert key.split(".")[-1] in str(raised.value)
            assert len(str(raised.value)) < 500


@pytest.mark.parametrize("hidden", [[10**9], [8] * 11, [10**5, 10**5], [0], [-1], [2.5], ["a"]])
def test_network_sizes_have_an_end(hidden: list, sound, run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="hidden"):
        validate(StudyConfig, study_with("hybrid.networks.hidden", hidden), "study.yaml")
    dataset, model = sound
    values = yaml.safe_load(model.read_text())
    options = {"inputs": ["speed"], "hidden": hidden}
    values["components"] = [{"place": "joint1/motor", "kind": "residual_network", "options": options}]
    model.write_text(yaml.safe_dump(values))
    refused(run("simulate", dataset, "--model", model, "--out", tmp_path / "out"), "model.yaml", "hidden")


# --- words that no file or screen can hold (classes 4 and 7) ---------------------------------------------------------

ODD = ["\x1b[2J", "\x07", "\x1b]0;title\x07", "\udcff", "\ud800", "\u202egpj", "\x9b31m", "\x00"]


def in_dataset(change: Callable[[dict, str], None]) -> Callable[[Path, Path, str], None]:
    return lambda dataset, _, word: change_yaml(dataset, lambda values: change(values, word))


def in_model(dataset: Path, model: Path, word: str) -> None:
    values = yaml.safe_load(model.read_text())
    values["components"][0]["place"] = f"{word}/motor_friction"
    model.write_text(yaml.safe_dump(values))


PLACES: dict[str, Callable[[Path, Path, str], None]] = {
    "dataset": in_dataset(lambda values, word: values.update(name=f"a{word}")),
    "meta": in_dataset(lambda values, word: values["records"][0].update(meta={f"a{word}": 1.0})),
    "file": in_dataset(lambda values, word: values["records"][0].update(file=f"a{word}.csv")),
    "place": in_model,
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    ("word", "fault"),
    [("\x1b[2J", "control character"), ("\ud800", "Unicode")],  # YAML's own parser refuses the second
    ids=["escape", "surrogate"],
)
def test_words_that_cannot_be_shown_or_written_are_refused_first(
    place: str, word: str, fault: str, sound, run, tmp_path: Path
) -> None:
    PLACES[place](sound[0], sound[1], word)
    before = contents(tmp_path)
    outcome = run("identify", sound[0], "--model", sound[1], "--out", tmp_path / "out")
    refused(outcome, ".yaml", fault)
    assert "\x1b" not in outcome.err + outcome.out
    assert contents(tmp_path) == before


@pytest.mark.parametrize("word", ODD)
def test_such_words_on_the_command_line_are_refused_first(word: str, sound, run, tmp_path: Path) -> None:
    outcome = run("identify", sound[0], "--model", sound[1], "--out", f"{tmp_path}/a{word}")
    refused(outcome, "on the command line", "control character")
    assert not has_control(outcome.err, lines=True)


@given(st.text(st.characters(), max_size=30))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_name_reaches_a_terminal_as_a_command(word: str) -> None:
    """Whatever is printed can be written as UTF-8, and holds only the sequences that colour it."""
    from rich.table import Table
    from rich.text import Text

    table = Table("name", word)
    table.add_row(Text(word), Text(f"[{word}]"))
    plain, colour = io.StringIO(), io.StringIO()
    for stream, terminal in ((plain, False), (colour, True)):
        out = Screen(file=stream, force_terminal=terminal, highlight=False, emoji=False, width=80)
        out.print(table, markup=False)
        out.print(word, markup=False, soft_wrap=True)
        stream.getvalue().encode()
    assert not has_control(plain.getvalue(), lines=True)
    assert shown(shown(word)) == shown(word)
    for bad in ("\x1b]", "\x1b[2J", "\x07", "\x9b"):
        assert bad not in colour.getvalue()
