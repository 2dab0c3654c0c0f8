"""What a diagnosis says of real records: run.py [CASE ...] (README.md beside this)."""

import argparse
import json
import time
import traceback
from pathlib import Path
from typing import Any

import torch
from cases import CASES, agreement
from real_machines import CONFIG, Machine, window_errors
from table import table

from hybrid_id import diagnose


def solve(name: str, data: Path) -> dict[str, Any]:
    """Diagnose one case: its answer, its processor time [s] and how far it agrees with what is expected."""
    case, begin = CASES[name], time.process_time()
    machine = case.build(data)
    found: dict[str, Any] = {"case": name, "expected": list(case.expected)}
    try:
        diagnosis = diagnose(machine.dataset, machine.system)
    except Exception as error:  # a case that fails is a result, too: the others go on
        traceback.print_exc()
        return found | {"failed": f"{type(error).__name__}: {error}", "seconds": time.process_time() - begin}
    found |= {"seconds": time.process_time() - begin, "answer": diagnosis.as_dict()}
    found["agrees"] = agreement(case, found["answer"])
    if case.window is not None:
        found["window_errors"] = scores(machine, diagnosis, case.window)
    return found


def scores(machine: Machine, diagnosis: Any, seconds: float) -> dict[str, dict[str, float]]:
    """RMS errors on the test records by model (nominal, and those that the diagnosis fitted) and angle."""
    fitted = {name: model.system for name, model in getattr(diagnosis, "fitted", {}).items()}
    models = {"nominal": machine.system} | fitted
    return {name: window_errors(system, machine.dataset.test, seconds) for name, system in models.items()}


def main() -> None:
    """Diagnose the named cases, or all, and print the table of all that have been diagnosed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; all by default")
    parser.add_argument(
        "--data", type=Path, default=Path(CONFIG["data"]), help="folder of the machines' folders"
    )
    parser.add_argument("--out", type=Path, default=Path(CONFIG["out"]), help="folder of the answers")
    parser.add_argument(
        "--table", action="store_true", help="print the table of answers that exist, diagnose nothing"
    )
    options = parser.parse_args()
    if wrong := set(options.cases) - set(CASES):
        parser.error(f"there is no case {', '.join(sorted(wrong))}; there are {', '.join(CASES)}")
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    names = options.cases or list(CASES)
    for name in [] if options.table else names:
        found = solve(name, options.data)
        partial = options.out / f".{name}.json"
        partial.write_text(json.dumps(found, indent=1))
        partial.replace(options.out / f"{name}.json")
        print(table([found]).splitlines()[-1], flush=True)
    files = [options.out / f"{name}.json" for name in names]
    print(table([json.loads(file.read_text()) for file in files if file.exists()]))


if __name__ == "__main__":
    main()
