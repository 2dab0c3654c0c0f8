"""The printed tables, and that the twins' truth is theirs."""

import numpy as np
import pytest
from paper.twins import config

from hybrid_id.paper.comparison import GEAR_RATIO, PRINTED
from hybrid_id.paper.tracking import TABLE_1


def best(stage: str, motor: str = "") -> dict[str, float]:
    """Printed values of a stage by the twin's names."""
    rows = PRINTED[stage].parameters.items()
    return {name.removesuffix(motor): value for name, (_, value) in rows if np.isfinite(value)}


def test_printed_ratios_are_those_of_the_printed_numbers() -> None:
    for table in PRINTED.values():
        for mean, std, percent in table.fits.values():
            assert abs(100 * std / mean - percent) < 0.011  # rounded or cut


def test_all_variations_pass_the_30_percent_rule() -> None:
    assert [len(table.parameters) for table in PRINTED.values()] == [12, 18, 9, 7, 19]
    assert all(0 <= percent < 30 for table in PRINTED.values() for percent, _ in table.parameters.values())


def test_truth_of_link_1() -> None:
    assert config("link1")["truth"] == best("link1")
    assert config("link1_flexible")["truth"] == best("link1_flexible") | {"f_3": best("link1")["f_3"]}


@pytest.mark.parametrize("stage", ["link2_high", "link2_low"])
def test_truth_of_link_2(stage: str) -> None:
    told = config(stage)["truth"]
    printed = best("link2_high", "m2") | best(stage, "m2")
    del printed["P_2"]
    assert told["J"] == pytest.approx(best("both_links")["P_2"] / GEAR_RATIO[1] ** 2, rel=1e-6)
    assert (told["P_m1"], told["P_m2"]) == (TABLE_1["P_m1m2"], TABLE_1["P_m2m2"])
    assert {name: told[name] for name in printed} == printed


def test_truth_of_both_links() -> None:
    told, printed, high = config("both_links")["truth"], best("both_links"), best("link2_high")
    assert {name: told[name] for name in printed} == printed
    assert {name: told[name] for name in told if name not in printed} == {
        "P_m1m1": best("link1_flexible")["P_m1"],
        "P_m2m1": best("link1_flexible")["P_m2"],
        "f_3m1": best("link1")["f_3"],
        "P_m1m2": TABLE_1["P_m1m2"],
        "P_m2m2": TABLE_1["P_m2m2"],
        "f_11m2": high["f_11m2"],
        "f_21m2": high["f_21m2"],
        "f_3m2": config("link2_high")["truth"]["f_3"],
    }
