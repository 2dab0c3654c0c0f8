"""The catalogue fitted to the end, from every start, against the screened search: run.py FOLDER CASE ..."""

import sys
import time
from pathlib import Path

from hybrid_id.diagnosis.diagnose import search
from hybrid_id.diagnosis.fits import FULL, Fits
from hybrid_id.diagnosis.screen import best_of_each, effects_of, simplest_first
from hybrid_id.diagnosis.starts import tasks
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.model_file import load_model

folder = Path(sys.argv[1])
for case in sys.argv[2:]:
    dataset, nominal = Dataset.load(folder / case), load_model(folder / case / "model.yaml")
    begun = time.process_time()
    whole = Fits(dataset)
    fits, found = search(whole, whole.base(nominal), nominal, max_effects=1)
    middle = time.process_time()
    todo = tasks(fits, found.base)
    ends = best_of_each([one for one in fits.run(todo, FULL) if one is not None], key=effects_of)
    slow = simplest_first(ends, found.base)
    fast = found.steps[0].candidates if found.steps else ()
    print(
        f"{case}: screened {middle - begun:.0f} s, all {time.process_time() - middle:.0f} s for {len(todo)} starts"
    )
    for name, some in (("screened", fast), ("all", slow)):
        words = ", ".join(f"{e.effects[0][0]}@{e.effects[0][1]} {e.error:.4f}" for e in some[:3])
        print(f"  {name}: before {found.base.error:.4f}; {words}", flush=True)
