"""Reading, checking and writing of the YAML files of a user, every fault as one sentence."""

import difflib
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import AfterValidator, BaseModel, ValidationError

from hybrid_id import __version__
from hybrid_id.errors import CONTROL, InputError, has_control, shown
from hybrid_id.reading import LONGEST_NAME, MOST_DEPTH, read_bytes
from hybrid_id.records.files import write_whole

Schema = TypeVar("Schema", bound=BaseModel)
PathLike = TypeVar("PathLike", str, Path)
LONGEST_PART, LONGEST_PATH = 255, 4000
"""Bytes of a name, and of a path, that file systems take."""
MAX_BYTES = 5_000_000  # a larger one is a data file by mistake, or an attack on the parser
MAX_VALUES = 150_000
"""Values and keys of one file: the weights of a model's networks are the most that any has."""
Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Plain data only; libyaml's, which is ten times as fast, where PyYAML has it."""
ODD_NUMBER = re.compile(r"[-+]?([1-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?|0[0-7_]+)")
"""What YAML takes for a number to base 60 or 8, and nobody else does: ``1:40`` is 100, ``0100`` is 64."""
MOST_DIGITS = 1000
"""Of a whole number: longer ones take Python ever longer to read."""
LARGEST_WHOLE = 2**63 - 1
"""What machines count to."""
KINDS = {"study": "dataset", "dataset": "records", "model": "system"}
"""Kinds of files, and a key that each must have."""
DRAFT = "https://json-schema.org/draft/2020-12/schema"
KIND_OF_VALUE = re.compile(r"float|int|str|bool|(list|dict|tuple)\[.*\]")
"""How faults call the kinds that a value of several may have."""
ATTRIBUTE = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*(?:\n {5,}.*)*)", re.MULTILINE)
"""Names in an ``Attributes`` section of a docstring, and what is said of them."""


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML file whose top level is a mapping.

    Plain data only: tags that name Python objects, aliases (which can blow up a small file without bounds)
    and keys given twice (of which YAML would keep the last) are refused.

    Raises:
        InputError: when the file is missing, too large, not UTF-8, no YAML, or holds what is refused.
    """
    path = Path(path)
    try:
        values = parse_yaml(read_bytes(path, MAX_BYTES, "settings file").decode("utf-8-sig"), path)
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; correct the path or write the file") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder; name the file in it") from None
    except UnicodeDecodeError:
        raise InputError(
            f"{path} is not a text file in UTF-8; save it as UTF-8, or give the folder, if this is a record"
        ) from None
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}); correct it or give another file"
        ) from None
    if not isinstance(values, dict):
        raise InputError(f"{path} must hold 'key: value' pairs at its top level, as docs/formats.md shows")
    return values


def validate(schema: type[Schema], values: Mapping[str, Any], path: str | Path) -> Schema:
    """Check a mapping against a pydantic model; the first fault becomes one sentence that names the key.

    Args:
        schema: The model, with `extra="forbid"` where unknown keys are to be refused.
        values: What the file holds.
        path: The file, for the message.

    Raises:
        InputError: when a key is unknown, missing or has a value out of range.
    """
    _refuse_unusable(values, "", path)
    try:
        found = schema.model_validate(values)
        _refuse_truth_as_number(values, found.model_dump(), "", path)
        return found
    except ValidationError as error:
        # a file of another kind: one key of each shows it
        asked = next((kind for kind, key in KINDS.items() if key in schema.model_fields), None)
        given = next((kind for kind, key in KINDS.items() if key in values), None)
        if asked and given and KINDS[asked] not in values and KINDS[given] not in schema.model_fields:
            raise InputError(
                f"{path} is a {given} file, but a {asked} file is needed here; give that one"
            ) from None
        # of a file that has no key that is known, or nearly so, nothing is quoted
        known = list(schema.model_fields)
        if not any(
            key in known or difflib.get_close_matches(str(key), known, n=1) for key in list(values)[:99]
        ):
            raise InputError(
                f"{path} has none of the keys that are read here ({', '.join(known)}); give the right file"
            ) from None
        # one fault for a key, without missing keys beside which an unknown one has nearly their name: it is the fault
        every, unknown = error.errors(include_url=False), dict[tuple[str | int, ...], list[str]]()
        for fault in every:
            if fault["type"] == "extra_forbidden":
                unknown.setdefault(fault["loc"][:-1], []).append(str(fault["loc"][-1]))
        told = [
            fault
            for fault in every
            if fault["type"] != "missing"
            or not difflib.get_close_matches(str(fault["loc"][-1]), unknown.get(fault["loc"][:-1], []), n=1)
        ]
        faults = list({_place(fault): fault for fault in reversed(told)}.values())[::-1]  # the first of a key
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise InputError(f"{path}: {_sentence(faults[0], schema)}{more}") from None


def editor_schema(schema: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a file, by which an editor completes its keys, shows what they mean and marks faults.

    The ``Attributes`` of a model's docstring become the descriptions of its keys.
    """
    found = schema.model_json_schema()
    for part in (found, *found.get("$defs", {}).values()):
        words, _, attributes = part.get("description", "").partition("\n\nAttributes:\n")
        part["description"] = " ".join(words.split())
        for names, about in ATTRIBUTE.findall(attributes):
            for name in names.split(", "):
                part["properties"][name]["description"] = " ".join(about.split())
    return {"$schema": DRAFT, **found}


def _short_enough(path: PathLike) -> PathLike:
    """A path that a file system can hold.

    Raises:
        ValueError: it is too long.
    """
    longest = max((len(os.fsencode(part)) for part in Path(path).parts), default=0)
    if longest > LONGEST_PART or len(os.fsencode(path)) > LONGEST_PATH:
        raise ValueError(
            f"is longer than the name of any file ({LONGEST_PART} bytes, {LONGEST_PATH} with its folders)"
        )
    return path


FileName = Annotated[str, AfterValidator(_short_enough)]
"""Words that name a file or a pattern of files."""
FilePath = Annotated[Path, AfterValidator(_short_enough)]
"""A file or folder."""


def one_of(names: Callable[[], Iterable[str]]) -> Callable[[dict[str, Any]], None]:
    """For ``Field(json_schema_extra=...)``: the words that a text may be, where another check refuses all others."""

    def extend(schema: dict[str, Any]) -> None:
        for text in (schema, *schema.get("anyOf", [])):
            if text.get("type") == "string":
                text["enum"] = list(names())

    return extend


def write_yaml(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write a mapping as YAML below the program's version, innermost ones on one line, under a temporary name first."""
    path, values = Path(path), dict(values)
    layout = {"sort_keys": False, "width": 110, "default_flow_style": None}
    text = yaml.safe_dump(values, allow_unicode=True, **layout)
    if yaml.safe_load(text) != values:  # PyYAML loses rare line separators unless they are escaped
        text = yaml.safe_dump(values, **layout)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, f"# hybrid_id {__version__}\n{text}")


def parse_yaml(text: str, path: Path) -> Any:
    """Values of YAML text; ``path`` is for messages. What :func:`read_yaml` refuses is refused before they are made."""
    try:
        depth = values = 0
        for event in yaml.parse(text, Loader=Loader):
            if isinstance(event, yaml.AliasEvent):
                row = event.start_mark.line + 1
                raise InputError(f"{path}, row {row}: YAML aliases (*name) are refused; write the value out")
            values += isinstance(event, yaml.NodeEvent)
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MOST_DEPTH:
                row = event.start_mark.line + 1
                raise InputError(
                    f"{path}, row {row}: nested more than {MOST_DEPTH} levels deep; correct the brackets"
                )
            if values > MAX_VALUES:
                raise InputError(
                    f"{path} holds more than {MAX_VALUES} values, so it is no settings file; give the right file"
                )
        node = yaml.compose(text, Loader=Loader)
        if node is None:
            return None
        _refuse_what_misleads(node, path)
        return yaml.SafeLoader("").construct_document(node)
    except ValueError as error:  # a date that none is, say
        raise InputError(f"{path} cannot be read ({error}); correct it or give another file") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        row = f", row {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        raise InputError(f"{path}{row}: this is not valid YAML ({problem}); correct it") from None


def _refuse_what_misleads(root: yaml.Node, path: Path) -> None:
    """Raise InputError at the first number to another base, key that is too long, and key that is given twice."""
    waiting = [root]
    while waiting:
        node = waiting.pop()
        plain = isinstance(node, yaml.ScalarNode) and not node.style  # None or '', as the library has it
        if plain and len(node.value) > MOST_DIGITS and node.value.lstrip("-+").isdigit():
            row = node.start_mark.line + 1
            raise InputError(
                f"{path}, row {row}: a number of {len(node.value)} digits is beyond all use; correct it"
            )
        if plain and ODD_NUMBER.fullmatch(node.value):
            row = node.start_mark.line + 1
            raise InputError(
                f"{path}, row {row}: YAML reads '{node.value}' to base {60 if ':' in node.value else 8}; "
                "write a decimal number, or put a name in quotes"
            )
        if isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)
        elif isinstance(node, yaml.MappingNode):
            seen = set()
            for key, value in node.value:
                name, row = str(key.value), key.start_mark.line + 1
                if not isinstance(key, yaml.ScalarNode) or len(name) > LONGEST_NAME:
                    words = f"a key is longer than {LONGEST_NAME} signs, or no name; correct it"
                    raise InputError(f"{path}, row {row}: {words}")
                if name in seen:
                    raise InputError(f"{path}, row {row}: key '{name}' is given twice; keep one of them")
                seen.add(name)
                waiting.append(value)


def _refuse_unusable(given: Any, key: str, path: str | Path) -> None:
    """Raise InputError at a number beyond all use, and at words that no file or screen can hold."""
    if isinstance(given, Mapping):
        for name, value in given.items():
            below = f"{key}.{shown(str(name))}".lstrip(".")
            if has_control(str(name)):
                raise InputError(f"{path}: key '{below}' {CONTROL}; correct it")
            _refuse_unusable(value, below, path)
    elif isinstance(given, list | tuple):
        for i, value in enumerate(given):
            _refuse_unusable(value, f"{key}[{i}]", path)
    elif isinstance(given, str) and has_control(given, lines=True):
        raise InputError(f"{path}: key '{key}' {CONTROL} ('{shown(given)}'); correct it")
    elif isinstance(given, int) and abs(given) > LARGEST_WHOLE:
        digits = 1 + int(given.bit_length() * math.log10(2))
        raise InputError(f"{path}: key '{key}' is a number of {digits} digits, beyond all use; correct it")


def _refuse_truth_as_number(given: Any, found: Any, key: str, path: str | Path) -> None:
    """Raise InputError where a file says true or false for a number, which pydantic takes for 1 or 0."""
    if isinstance(given, bool) and isinstance(found, int | float) and not isinstance(found, bool):
        raise InputError(f"{path}: key '{key}' is {str(given).lower()}, but a number is needed; give one")
    if isinstance(given, bool) and isinstance(found, Mapping):  # a value short for a mapping of it
        _refuse_truth_as_number(given, next(iter(found.values()), None), key, path)
    if isinstance(given, Mapping) and isinstance(found, Mapping):
        for name in given.keys() & found.keys():
            _refuse_truth_as_number(given[name], found[name], f"{key}.{name}".lstrip("."), path)
    if isinstance(given, list) and isinstance(found, list | tuple):
        for i, (one, other) in enumerate(zip(given, found, strict=False)):
            _refuse_truth_as_number(one, other, f"{key}[{i}]", path)


def _place(fault: Any) -> tuple[str | int, ...]:
    """Keys that lead to a fault, without the kinds of value that the last one may have."""
    place = fault["loc"]
    while place and isinstance(place[-1], str) and KIND_OF_VALUE.fullmatch(place[-1]):
        place = place[:-1]
    return place


def _sentence(fault: Any, schema: type[BaseModel]) -> str:
    """Say one pydantic fault in words, `key 'records[1].role' must be 'train' or 'test', found 'tests'`."""
    place = _place(fault)
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    if fault["type"] == "missing":
        return f"key '{key}' is missing; add it"
    if fault["type"] == "extra_forbidden":
        name, models = str(fault["loc"][-1]), [schema]
        for above in (part for part in fault["loc"][:-1] if isinstance(part, str)):
            fields = [model.model_fields[above] for model in models if above in model.model_fields]
            models = [model for field in fields for model in _models(field.annotation)]
        beside = [known for model in models for known in model.model_fields]
        parts = schema.model_json_schema()
        everywhere = {
            k for part in (parts, *parts.get("$defs", {}).values()) for k in part.get("properties", {})
        }
        others = sorted(everywhere - {name})  # right in another section
        if len(fault["loc"]) == 1 and (instead := getattr(schema, "instead", {}).get(name)):
            return f"key '{key}' is unknown; {instead}"
        close = difflib.get_close_matches(name, beside, n=1) or difflib.get_close_matches(name, others, n=1)
        hint = f"did you mean '{close[0]}'?" if close else "remove it"
        return f"key '{key}' is unknown; {hint}"
    if fault["input"] is None:
        return f"key '{key}' is empty; give a value"
    found = repr(fault["input"])
    found = f", found {found if len(found) <= 60 else found[:57] + '...'}"
    if fault["type"] in ("model_type", "dict_type"):
        return f"key '{key}' must hold 'key: value' pairs{found}"
    if fault["type"] == "too_short" and not fault["input"]:
        return f"key '{key}' is empty; give at least one"
    words = fault["msg"].removeprefix("Value error, ").split(", unable to parse")[0]
    if words.startswith("Input should "):
        return f"key '{key}' must {words.removeprefix('Input should ')}{found}"
    return f"key '{key}': {words[0].lower()}{words[1:]}{'' if isinstance(fault['input'], Mapping) else found}"


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The models in a type, those of its arguments too."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
