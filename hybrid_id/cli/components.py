"""`components`: what may stand in a model file."""

from typing import Annotated

import typer

from hybrid_id.cli.console import out, show
from hybrid_id.cli.options import JsonOption


def components(
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a Markdown table.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List every kind of component with its places, parameters and units, and its law."""
    rows = component_rows()
    if as_json:
        from hybrid_id.reporting.results import as_json as to_json

        named = [dict(zip(("kind", "place", "parameters", "law"), row, strict=True)) for row in rows]
        out().print(to_json("components", {"components": named}), markup=False, soft_wrap=True)
        return
    if markdown:
        table = [("kind", "place", "parameters [unit]", "law"), ("---",) * 4]
        table += [
            (f"`{kind}`", places, values, law.replace("``", "`").replace("|", "\\|"))
            for kind, places, values, law in rows
        ]
        out().print("\n".join(f"| {' | '.join(row)} |" for row in table), markup=False, soft_wrap=True)
        return
    from hybrid_id.reporting.tables import open_table

    table = open_table("kind", "place", "parameters [unit]", "law")
    for kind, places, values, law in rows:
        table.add_row(kind, places, values, law.replace("``", ""))
    show(table)


def component_rows() -> list[tuple[str, str, str, str]]:
    """Kind, places, parameters with units, and the first line of the docstring, in the order of the drive chain."""
    import hybrid_id.components  # noqa: F401  # registers its kinds
    from hybrid_id.components.base import PLACES, REGISTRY

    kinds = {kind: part for kind, part in REGISTRY.items() if part.__module__.startswith("hybrid_id.")}
    return [
        (
            kind,
            ", ".join(part.places),
            ", ".join(f"{name} [{spec.unit}]" for name, spec in part.declared.items()) or "none",
            (part.__doc__ or "").splitlines()[0],
        )
        for kind, part in sorted(kinds.items(), key=lambda item: (PLACES.index(item[1].places[0]), item[0]))
    ]
