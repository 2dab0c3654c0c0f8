"""The catalogue fitted to the end, every effect from every start, against the fast search: run.py FOLDER CASE ..."""

import sys
import time
from pathlib import Path

from hybrid_id.diagnosis.attribute import attribute
from hybrid_id.diagnosis.ranking import best_of_each, simplest_first
from hybrid_id.diagnosis.refit import TO_THE_END, Refit
from hybrid_id.diagnosis.starts import tasks
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.model_file import load_model

folder = Path(sys.argv[1])
for case in sys.argv[2:]:
    dataset, today = Dataset.load(folder / case), load_model(folder / case / "model.yaml")
    refit, begun = Refit(dataset), time.process_time()
    fast = attribute(refit, today, most=1)
    middle = time.process_time()
    base = refit.base(today)
    todo = [task for part in tasks(refit, base, today) for task in part]
    ends = best_of_each([one for one in refit.run(todo, TO_THE_END) if one is not None])
    slow = simplest_first(ends, base)
    first = fast.rounds[0].candidates
    print(
        f"{case}: fast {middle - begun:.0f} s, all {time.process_time() - middle:.0f} s for {len(todo)} starts"
    )
    for name, found in (("fast", first), ("all", slow)):
        told = ", ".join(f"{e.effects[0][0]}@{e.effects[0][1]} {e.evidence.error:.4f}" for e in found[:3])
        print(f"  {name}: before {fast.base.evidence.error:.4f}; {told}", flush=True)
