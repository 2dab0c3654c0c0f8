"""How a notebook shows a result: a heading, its table and remarks, as HTML that takes no words for markup."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


def as_html(heading: str, table: pd.DataFrame, remarks: Iterable[str]) -> str:
    """A heading, a table and a line for each remark; all words are escaped."""
    lines = "".join(f"<div>{escape(line)}</div>" for line in remarks)
    cells = table.to_html(escape=True, na_rep="", float_format="{:.5g}".format, border=0)
    return f"<div><b>{escape(heading)}</b>{cells}{lines}</div>"
