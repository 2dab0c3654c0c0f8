"""Pages made from the package and notebooks: equations, effects, Python interface; links out of docs/ are turned in."""

import inspect
import json
import re
from importlib import import_module
from pathlib import Path

from mkdocs.structure.files import File

import hybrid_id
from hybrid_id.cli.lists import markdown_tables
from hybrid_id.components import PLACES, REGISTRY, Component

CONTRIBUTING = Path(__file__).parents[1] / "CONTRIBUTING.md"
STAGES = {
    "hybrid_id.diagnosis.diagnose": "answered search freeze Answer reported",
    "hybrid_id.diagnosis.fits": "Fits",
    "hybrid_id.identification.keep": "Kept",
    "hybrid_id.diagnosis.screen": "selection_step screen SelectionStep",
    "hybrid_id.diagnosis.select": "select Selection",
    "hybrid_id.diagnosis.grade": "grade Grade RatedEffect",
    "hybrid_id.diagnosis.locate": "locate Location disturbances Disturbance",
    "hybrid_id.diagnosis.errors_on_test": "errors Errors shrink Shrink",
    "hybrid_id.diagnosis.details": "Details",
    "hybrid_id.diagnosis.next_experiment": "next_experiment Experiment",
    "hybrid_id.export.mjcf": "to_mjcf",
    "hybrid_id.export.ranges": "to_ranges",
    "hybrid_id.export.program": "to_program",
}
"""Modules and names beside the public ones: what a diagnosis is made of, and what carries a model elsewhere."""
NOTEBOOKS = sorted((Path(__file__).parent / "notebooks").glob("*.ipynb"))


def on_files(files, config):
    """Add the generated pages."""
    pages = {
        "equations.md": equations(),
        "api.md": api(),
        "catalogue.md": catalogue(),
        "contributing.md": CONTRIBUTING.read_text(encoding="utf-8"),
        **{f"notebook_{path.stem}.md": notebook(path) for path in NOTEBOOKS},
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown, page, **_):
    """Point at the pages of the site, and leave links to files of the repository as their names."""
    markdown = markdown.replace("](../CONTRIBUTING.md", "](contributing.md")
    markdown = re.sub(r"\]\(docs/(\w+\.md)", r"](\1", markdown)
    out = re.escape("../" * (1 + page.file.src_uri.count("/")))
    return re.sub(rf"\[([^\]]+)\]\({out}[^)]*\)", r"\1", markdown)


def notebook(path: Path) -> str:
    """A notebook's cells in their order; what they print, the reader's own run shows."""
    cells = [
        (cell["cell_type"], "".join(cell["source"])) for cell in json.loads(path.read_text("utf-8"))["cells"]
    ]
    told = f"In a clone this is `docs/notebooks/{path.name}`."
    return (
        "\n\n".join([f"```python\n{text}\n```" if kind == "code" else text for kind, text in cells] + [told])
        + "\n"
    )


def equations() -> str:
    """The docstring of every component, in the order of the chain."""
    kinds = {kind: part for kind, part in REGISTRY.items() if part.__module__.startswith("hybrid_id.")}
    parts = [
        "# Equations",
        "What every component says, from its docstring. `r` is the gear ratio, angles are in rad.",
    ]
    for place in PLACES:
        parts.append(f"## {place.replace('_', ' ').capitalize()}")
        for kind, part in sorted(kinds.items()):
            if part.places[0] == place:
                parts += [f"### `{kind}`", sheet(part)]
    return "\n\n".join(parts) + "\n"


def catalogue() -> str:
    """What `hybrid-id effects --markdown` prints."""
    return f"# Effects that a diagnosis can name\n\n{markdown_tables()}\n"


def sheet(part: type[Component]) -> str:
    """A law's docstring as Markdown, what a diagnosis says of it, and its parameters."""
    text = plain(inspect.getdoc(part) or "")
    if part.effect is not None:
        text += f"\n\nA diagnosis calls it `{part.effect.name}`: {part.effect.about}."
    rows = [
        f"| `{name}` | {spec.unit} | {spec.doc} | {spec.bounded().value:g} | {'yes' if spec.estimate else 'no'} |"
        for name, spec in part.declared.items()
    ]
    heads = "| parameter | unit | meaning | default | estimated |\n| --- | --- | --- | --- | --- |"
    return text + ("\n\n" + "\n".join([heads, *rows]) if rows else "")


def plain(text: str) -> str:
    """ReStructuredText roles and double backticks as Markdown; sections of arguments as lists."""
    text = re.sub(r":\w+:`~?([\w.]+)`", lambda m: f"`{m[1].rsplit('.', 1)[-1]}`", text).replace("``", "`")
    text = re.sub(r"^(Args|Attributes|Returns|Raises|Yields):\n", r"\n**\1**\n\n", text, flags=re.MULTILINE)
    text = re.sub(r"^    (\w[\w, .]*): ", r"- `\1`: ", text, flags=re.MULTILINE)
    return re.sub(r"(?<=\S) *\n(?=[a-z0-9(][^|\n]*\|$)", " ", text, flags=re.MULTILINE)


def api() -> str:
    """Every public name with its signature and docstring."""
    parts = ["# Python interface", "All of this is imported from `hybrid_id`."]
    for name in sorted(hybrid_id._HOME, key=str.lower):
        thing = getattr(hybrid_id, name)
        if isinstance(thing, type) and thing in REGISTRY.values():
            parts += [f"## `{name}`", f"A component, see its [equation sheet](equations.md#{thing.kind})."]
            continue
        try:
            signature = str(inspect.signature(thing)).replace("hybrid_id.", "").replace("'", "")
        except ValueError:
            signature = ""
        lines = (
            re.sub(r"(?<=[(,]) (?=\*?\*?\w+[:=,)])", "\n    ", signature)
            if len(signature) > 80
            else signature
        )
        parts += [f"## `{name}`", f"```text\n{name}{lines}\n```", plain(inspect.getdoc(thing) or "")]
    parts += ["# Stages and exports", "Imported from the module that is named."]
    for where, names in STAGES.items():
        for name in names.split():
            thing = getattr(import_module(where), name)
            parts += [
                f"## `{name}` ",
                f"```text\nfrom {where} import {name}\n```",
                plain(inspect.getdoc(thing) or ""),
            ]
    return "\n\n".join(parts) + "\n"
