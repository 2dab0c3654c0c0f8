"""`effects`: what a diagnosis can name."""

from collections.abc import Sequence
from typing import Annotated

import typer

from hybrid_id.cli.console import out, show
from hybrid_id.cli.options import JsonOption

HEADS = ("effect", "where", "smoothness", "easily mistaken for", "source")
PAIR_HEADS = ("effect", "mistaken for", "what tells them apart")


def effects(
    markdown: Annotated[bool, typer.Option("--markdown", help="Print Markdown tables.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the effects that `diagnose` can name, what each is mistaken for, and what tells the two apart."""
    rows, pairs = effect_rows(), pair_rows()
    if as_json:
        from hybrid_id.diagnosis.catalogue import rivals
        from hybrid_id.reporting.results import as_json as to_json

        named = [
            {
                "effect": name,
                "where": where,
                "smoothness": smoothness,
                "mistaken_for": rivals(name),
                "source": source,
            }
            for name, where, smoothness, _, source in rows
        ]
        out().print(to_json("effects", {"effects": named}), markup=False, soft_wrap=True)
        return
    if markdown:
        tables = (
            _markdown(HEADS, [(f"`{name}`", *rest) for name, *rest in rows]),
            _markdown(PAIR_HEADS, [(f"`{one}`", f"`{other}`", words) for one, other, words in pairs]),
        )
        out().print("\n\n".join(tables), markup=False, soft_wrap=True)
        return
    from hybrid_id.reporting.tables import open_table

    # rivals stand in the second table: five columns would be too narrow for their names
    alone = [(*row[:3], row[4]) for row in rows]
    for heads, lines in (((*HEADS[:3], HEADS[4]), alone), (PAIR_HEADS, pairs)):
        table = open_table(*heads)
        for line in lines:
            table.add_row(*line)
        show(table)


def _markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, ("---",) * len(heads), *rows))


def effect_rows() -> list[tuple[str, str, str, str, str]]:
    """Name, places, smoothness, rivals and source, in the order of the drive chain."""
    from hybrid_id.diagnosis.catalogue import effect, rivals

    found = [(effect(name), sorted(rivals(name), key=_ordered().index)) for name in _ordered()]
    return [(e.name, ", ".join(e.places), e.smoothness, ", ".join(others), e.source) for e, others in found]


def pair_rows() -> list[tuple[str, str, str]]:
    """Two effects and the excitation that tells them apart, each pair once, in the order of the drive chain."""
    from hybrid_id.diagnosis.catalogue import rivals

    names = _ordered()
    return [
        (one, other, rivals(one)[other])
        for i, one in enumerate(names)
        for other in names[i + 1 :]
        if other in rivals(one)
    ]


def _ordered() -> list[str]:
    import hybrid_id.diagnosis.effects  # noqa: F401  # fills the catalogue
    from hybrid_id.components.base import PLACES
    from hybrid_id.diagnosis.catalogue import CATALOGUE

    return sorted(CATALOGUE, key=lambda name: (PLACES.index(CATALOGUE[name].places[0]), name))
