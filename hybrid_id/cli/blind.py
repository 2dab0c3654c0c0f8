"""`blind`: cases whose unmodelled effect is withheld."""

from pathlib import Path
from typing import Annotated

import typer

from hybrid_id.cli.console import remark, show

blind = typer.Typer(help="Cases whose unmodelled effect is withheld, with their answers on a sheet apart.")


@blind.callback()
def _blind() -> None:
    """Cases whose unmodelled effect is withheld, with their answers on a sheet apart."""


@blind.command()
def make(
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Folder for the cases; answers go to its answers/.", show_default=False
        ),
    ],
    cases: Annotated[int, typer.Option(help="Number of cases.", min=1)] = 24,
    seed: Annotated[int, typer.Option(help="Seed of the first case; the others count up.", min=0)] = 0,
    system: Annotated[
        str | None, typer.Option(help="one_link, one_link_flexible or two_link.", show_default="drawn")
    ] = None,
    family: Annotated[
        str | None, typer.Option(help="single, pair, none or unknown.", show_default="drawn")
    ] = None,
    effect: Annotated[
        str | None, typer.Option(help="Name of the effect, say backlash.", show_default="drawn")
    ] = None,
    level: Annotated[str | None, typer.Option(help="strong, medium or weak.", show_default="drawn")] = None,
    engine: Annotated[
        str | None, typer.Option(help="in_house, or mujoco where it is installed.", show_default="drawn")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Cases that are made at the same time.", min=1)] = 1,
) -> None:
    """Make records of machines in which something is at work that their model lacks.

    Each case is a folder with records and today's simulator, ready for every command that takes a dataset. Its answers
    lie apart, in answers/. The physics is another one than that of the models.
    """
    from hybrid_id.blind.make import make_cases
    from hybrid_id.cli.folder import refuse_taken
    from hybrid_id.errors import InputError
    from hybrid_id.reporting.tables import count

    refuse_taken(out, force=False)
    made = make_cases(
        cases, seed, out, jobs=jobs, system=system, family=family, effect=effect, level=level, engine=engine
    )
    if not made:
        raise InputError(f"no case of {cases} could be made; give another seed, level or effect")
    if len(made) < cases:
        remark(f"{cases - len(made)} of {cases} cases were left out: their effect did not show as wanted")
    show(f"{count(len(made), 'case')} in {out}, their answers in {out / 'answers'}")
