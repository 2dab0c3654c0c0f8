"""An ablation as one page: the answer first, then what it rests on."""

from __future__ import annotations

from collections.abc import Mapping

from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.ablation import (
    arms_table,
    failures,
    ladder_table,
    parameters_table,
    splits_table,
)
from hybrid_id.reporting.html.interactive import Drawn
from hybrid_id.reporting.html.page import Page
from hybrid_id.reporting.tables import count, records_table
from hybrid_id.study.ablation_result import Ablation
from hybrid_id.study.ablation_verdict import verdict

_HOW = (
    "Errors are the RMS of the free run over whole records, in units of the measurement's standard deviation (1: as "
    "the noise says), geometric means over the repeats; short: the same over a fraction of a second from measured "
    "states. Each repeat draws its own records (but for those of role test) and first weights, the same for all arms, "
    "and is compared in pairs with physics only. Intervals are Student's, widened for training sets that share records "
    "(Nadeau and Bengio, 2003). The network that the validation records like best is judged on test records that chose "
    "nothing; the intervals of the other arms are not corrected for their number."
)


def ablation_page(dataset: Dataset, result: Ablation, pictures: Mapping[str, Drawn]) -> Page:
    """The page.

    Args:
        dataset: the records.
        result: the ablation.
        pictures: its figures by name.
    """
    (lead, *others), repeats = verdict(result), len(result.splits)
    page = Page(f"Physics only or hybrid? {dataset.name}", lead)
    what = (
        f"{len(result.scores)} models, trained and tested on the same records in {count(repeats, 'repeat')}."
    )
    section = page.section("Answer").add(*map(Text, others), what, *failures(result))
    if repeats > 1 and len({split.test for split in result.splits.values()}) == 1:
        section.add(
            "All repeats test on the same records, which have the role of test records: how the answer would change "
            "with others is not in the intervals."
        )
    if "change" in pictures:
        words = "Error over that of physics only on the same records: mean and interval of each arm."
        section.figure(pictures["change"], words)
    section = page.section("Arms").add(arms_table(result), _HOW)
    if "errors" in pictures:
        words = "Every repeat of every arm; the bar is the mean, the dashed line the noise."
        section.figure(pictures["errors"], words)
    if result.ladder:
        page.section("Price of the network's output").add(
            "A dear network adds only what the physics cannot say; a free one may take the physics' work, and the "
            "parameters drift. Each price starts from the dearer one above it.",
            ladder_table(result),
        ).figure(pictures["prices"], "Test error and drift of the parameters by price.")
    page.section("Parameters over the repeats").add(parameters_table(result))
    page.section("Records").add(splits_table(result), records_table(dataset))
    return page
