"""`reproduce`: every table and figure of the paper on its digital twins."""

from pathlib import Path
from typing import Annotated

import typer

from hybrid_id.cli.console import FitProgress, remark, show
from hybrid_id.cli.folder import RESULT, refuse_foreign, sole_writer
from hybrid_id.cli.options import ABOVE, JsonOption
from hybrid_id.cli.results import write_last
from hybrid_id.config import Identification
from hybrid_id.records.files import make_folder
from hybrid_id.reporting.provenance import program


def reproduce(
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help=f"Folder for the page and its parts. {ABOVE}"),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Two short records a stage: a look at everything.")
    ] = False,
    seeds: Annotated[
        int | None,
        typer.Option(help="Runs of each closed loop; 20, with --quick 2.", min=1, max=1000),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Reproduce the paper on digital twins: every table and figure, printed values beside ours, on one page.

    Each stage is kept as soon as it is done. After Ctrl-C the same command goes on from there.
    """
    parts = out / "parts"
    refuse_foreign(out, parts.name, "*.json")
    make_folder(parts)
    from hybrid_id.paper.page import QUICK, claims_table, paper_page
    from hybrid_id.paper.run import reproduce as run
    from hybrid_id.reporting.page import how_made
    from hybrid_id.reporting.results import as_json as to_json
    from hybrid_id.reporting.style import save

    seeds = seeds or (2 if quick else 20)
    try:
        with sole_writer(parts), FitProgress(1, Identification().max_iterations, polite=False) as progress:
            result = run(parts, quick=quick, seeds=seeds, program=program(), say=remark, progress=progress)
    except KeyboardInterrupt:
        remark(f"stopped; what is done is kept in {parts}, and the same command goes on from there")
        raise typer.Exit(130) from None
    page, figures = paper_page(result, quick=quick)
    for name, figure in figures.items():
        save(figure, parts / f"{name}.png")
    made = {"stages": "configs/reproduce.yaml of the package", "quick": quick}
    how_made(page, "reproduce", settings=made).write(parts / "report.html")
    (parts / "report.html").replace(out / "report.html")
    text = to_json("reproduce", {"quick": quick, "claims": [vars(claim) for claim in result.claims]})
    write_last(parts / RESULT, text)
    (parts / RESULT).replace(out / RESULT)
    if as_json:
        return show(text)
    show(claims_table(result.claims), *([QUICK] if quick else []))
    show(f"all tables and figures are in {out / 'report.html'}; stages, models and pictures in {parts}")
