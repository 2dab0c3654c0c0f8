"""`effects`: what a diagnosis can name."""

from typing import Annotated

import typer

from hybrid_id.cli.console import out, show
from hybrid_id.cli.options import JsonOption

HEADS = ("effect", "where", "smoothness", "easily mistaken for", "what tells them apart")
KEYS = ("effect", "where", "smoothness", "mistaken_for", "separated_by")


def effects(
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a Markdown table.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the effects that `diagnose` can name, what each is mistaken for, and what tells them apart."""
    rows = effect_rows()
    if as_json:
        from hybrid_id.reporting.results import as_json as to_json

        named = [dict(zip(KEYS, row, strict=True)) for row in rows]
        out().print(to_json("effects", {"effects": named}), markup=False, soft_wrap=True)
        return
    if markdown:
        table = [HEADS, ("---",) * len(HEADS)]
        table += [(f"`{name}`", *rest) for name, *rest in rows]
        out().print("\n".join(f"| {' | '.join(row)} |" for row in table), markup=False, soft_wrap=True)
        return
    from hybrid_id.reporting.tables import open_table

    table = open_table(*HEADS)
    for row in rows:
        table.add_row(*row)
    show(table)


def effect_rows() -> list[tuple[str, str, str, str, str]]:
    """Name, places, smoothness, rivals and the excitation that separates them, in the order of the drive chain."""
    import hybrid_id.gap.effects  # noqa: F401  # fills the catalogue
    from hybrid_id.components.base import PLACES
    from hybrid_id.gap.catalogue import CATALOGUE

    ordered = sorted(CATALOGUE.values(), key=lambda effect: (PLACES.index(effect.places[0]), effect.name))
    return [
        (e.name, ", ".join(e.places), e.smoothness, ", ".join(e.mistaken_for), e.separated_by)
        for e in ordered
    ]
