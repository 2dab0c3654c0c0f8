"""`components` and `effects`: what may stand in a model file, and what a diagnosis can name."""

from collections.abc import Sequence
from typing import Annotated

import typer

from hybrid_id.cli.console import show, show_json
from hybrid_id.cli.options import JsonOption

MarkdownOption = Annotated[bool, typer.Option("--markdown", help="Print Markdown tables.")]

COMPONENT_HEADS = ("kind", "place", "parameters [unit]", "law")
EFFECT_HEADS = (
    "effect", "what it is; how large it usually is", "where", "laws", "smoothness", "easily mistaken for", "source"
)  # fmt: skip
PAIR_HEADS = ("effect", "mistaken for", "what distinguishes them")


def components(markdown: MarkdownOption = False, as_json: JsonOption = False) -> None:
    """List every kind of component with its places, parameters and units, and its law."""
    import hybrid_id.components  # noqa: F401  # registers its kinds
    from hybrid_id.components.base import REGISTRY
    from hybrid_id.reporting.tables import markdown_table, table

    kinds = {kind: part for kind, part in REGISTRY.items() if part.__module__.startswith("hybrid_id.")}
    rows = [
        (
            kind,
            ", ".join(kinds[kind].places),
            ", ".join(f"{name} [{spec.unit}]" for name, spec in kinds[kind].declared.items()) or "none",
            (kinds[kind].__doc__ or "").splitlines()[0],
        )
        for kind in _along_the_chain({kind: part.places for kind, part in kinds.items()})
    ]
    if as_json:
        heads = ("kind", "place", "parameters", "law")
        show_json("components", {"components": [dict(zip(heads, row, strict=True)) for row in rows]})
    elif markdown:
        lines = [
            (f"`{kind}`", *rest, law.replace("``", "`").replace("|", "\\|")) for kind, *rest, law in rows
        ]
        show(markdown_table(COMPONENT_HEADS, lines))
    else:
        show(table(COMPONENT_HEADS, ((*rest, law.replace("``", "")) for *rest, law in rows)))


def effects(markdown: MarkdownOption = False, as_json: JsonOption = False) -> None:
    """List the effects that `diagnose` can name, what each is mistaken for, and what distinguishes the two."""
    from hybrid_id.diagnosis.catalogue import effect, rivals
    from hybrid_id.reporting.tables import table

    rows, pairs = effect_rows(), pair_rows()
    if as_json:
        keys = ("effect", "about", "where", "laws", "smoothness", "mistaken_for", "source")
        named = [
            dict(zip(keys, row, strict=True))
            | {"laws": list(effect(row[0]).kinds), "mistaken_for": rivals(row[0])}
            for row in rows
        ]
        show_json("effects", {"effects": named})
    elif markdown:
        show(markdown_tables())
    else:
        width = max(len(name) for name, *_ in rows)
        show(*(f"{name:<{width}}  {about}" for name, about, *_ in rows))
        show("", table(PAIR_HEADS, pairs), "places, laws and sources: --markdown or --json")


def markdown_tables() -> str:
    """The tables of docs/effects.md."""
    from hybrid_id.reporting.tables import markdown_table

    rows = [(f"`{name}`", *rest) for name, *rest in effect_rows()]
    pairs = [(f"`{one}`", f"`{other}`", words) for one, other, words in pair_rows()]
    return f"{markdown_table(EFFECT_HEADS, rows)}\n\n{markdown_table(PAIR_HEADS, pairs)}"


def effect_rows() -> list[tuple[str, ...]]:
    """What each effect is, by the columns of ``EFFECT_HEADS``, in the order of the drive chain."""
    from hybrid_id.diagnosis.catalogue import effect, rivals

    names = _effects()
    found = [(effect(name), sorted(rivals(name), key=names.index)) for name in names]
    return [
        (e.name, e.about, ", ".join(e.places), ", ".join(e.kinds), e.smoothness, ", ".join(others), e.source)
        for e, others in found
    ]


def pair_rows() -> list[tuple[str, str, str]]:
    """Two effects and the excitation that distinguishes them, each pair once, in the order of the drive chain."""
    from hybrid_id.diagnosis.catalogue import rivals

    names = _effects()
    return [
        (one, other, rivals(one)[other])
        for i, one in enumerate(names)
        for other in names[i + 1 :]
        if other in rivals(one)
    ]


def _effects() -> list[str]:
    from hybrid_id.components import CATALOGUE

    return _along_the_chain({name: one.places for name, one in CATALOGUE.items()})


def _along_the_chain(places: dict[str, Sequence[str]]) -> list[str]:
    """Names in the order of the first place that each may stand in, then of the alphabet."""
    from hybrid_id.components.base import PLACES

    return sorted(places, key=lambda name: (PLACES.index(places[name][0]), name))
