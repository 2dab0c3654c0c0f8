"""The printed tables, and that the twins' truth is theirs."""

from pathlib import Path

import numpy as np
import pytest

from hybrid_id.machines.twin import paper
from hybrid_id.records.yaml_file import read_yaml

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
FITS = {name: getattr(paper, name) for name in ("TABLE_3", "TABLE_5", "TABLE_8", "TABLE_9", "TABLE_11")}


def truth(stage: str) -> dict[str, float]:
    return read_yaml(CONFIGS / f"twin_{stage}.yaml")["truth"]


def best(table: dict[str, paper.Variation], motor: str = "") -> dict[str, float]:
    """Printed values of a table by the twin's names."""
    return {name.removesuffix(motor): row.best for name, row in table.items() if row.best is not None}


@pytest.mark.parametrize("name", FITS)
def test_printed_ratio_is_that_of_the_printed_numbers(name: str) -> None:
    for fit in FITS[name].values():
        assert abs(100 * fit.std / fit.mean - fit.percent) < 0.011  # rounded or cut


def test_all_variations_pass_the_30_percent_rule() -> None:
    tables = (paper.TABLE_2, paper.TABLE_4, paper.TABLE_6, paper.TABLE_7, paper.TABLE_10)
    assert [len(table) for table in tables] == [12, 18, 9, 7, 19]
    assert all(0 <= row.percent < 30 for table in tables for row in table.values())


def test_truth_of_link_1() -> None:
    assert truth("link1") == best(paper.TABLE_2)
    assert truth("link1_flexible") == best(paper.TABLE_4) | {"f_3": paper.TABLE_2["f_3"].best}


@pytest.mark.parametrize(("stage", "table"), [("link2_high", paper.TABLE_6), ("link2_low", paper.TABLE_7)])
def test_truth_of_link_2(stage: str, table: dict[str, paper.Variation]) -> None:
    told = truth(stage)
    printed = best(paper.TABLE_6, "m2") | best(table, "m2")
    inertia = paper.TABLE_10["P_2"].best or np.nan
    assert told["J"] == pytest.approx(inertia / paper.GEAR_RATIO[1] ** 2, rel=1e-6)
    assert (told["P_m1"], told["P_m2"]) == (paper.TABLE_1["P_m1m2"], paper.TABLE_1["P_m2m2"])
    assert {name: told[name] for name in printed if name != "P_2"} == {
        name: value for name, value in printed.items() if name != "P_2"
    }


def test_truth_of_both_links() -> None:
    told, printed = truth("both_links"), best(paper.TABLE_10)
    assert {name: told[name] for name in printed} == printed
    others = {name: told[name] for name in told if name not in printed}
    assert others == {
        "P_m1m1": paper.TABLE_4["P_m1"].best,
        "P_m2m1": paper.TABLE_4["P_m2"].best,
        "f_3m1": paper.TABLE_2["f_3"].best,
        "P_m1m2": paper.TABLE_1["P_m1m2"],
        "P_m2m2": paper.TABLE_1["P_m2m2"],
        "f_11m2": paper.TABLE_6["f_11m2"].best,
        "f_21m2": paper.TABLE_6["f_21m2"].best,
        "f_3m2": truth("link2_high")["f_3"],
    }
