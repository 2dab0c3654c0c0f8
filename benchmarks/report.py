"""Diagnose the stored cases and hold the scores against their floors: `make benchmark-report`.

The cases (20 clean machines, 12 messy ones, 8 arms) were made once by the generator, at seeds 3001001, 3002001 and
3003001, thinned to at most 4 ms of clean and messy machines, and stored with digests: they outlive the generator. Their
answers lie beside them. A floor is what the search of a diagnosis reached when the cases were stored, less one case; of
the calibration error, 0.02 more.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tarfile
from pathlib import Path

HERE = Path(__file__).parent
STORED = HERE / "cases"


def hybrid_id(*words: object) -> str:
    """Standard output of a command of the package; its progress stays on the screen."""
    run = [sys.executable, "-m", "hybrid_id", *map(str, words)]
    return subprocess.run(run, check=True, stdout=subprocess.PIPE, text=True).stdout


def diagnosed(family: str, digests: dict[str, str], out: Path, jobs: int) -> dict:
    """Scores of one family of cases."""
    archive, answers = STORED / f"{family}.tar", STORED / f"{family}.answers.tar"
    for path in (archive, answers):
        if hashlib.sha256(path.read_bytes()).hexdigest() != digests[path.name]:
            sys.exit(
                f"{path} is not the file that was stored: its digest differs from benchmarks/floors.json"
            )
    with tarfile.open(archive) as file:
        file.extractall(out / "cases", filter="data")
    hybrid_id("blind", "run", out / "cases" / family, "--out", out / "runs" / family, "--jobs", jobs)
    return json.loads(hybrid_id("blind", "score", out / "runs" / family, "--answers", answers, "--json"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmark_report"))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    stored = json.loads((HERE / "floors.json").read_text(encoding="utf-8"))
    missed = False
    for family, floors in stored["floors"].items():
        scores = diagnosed(family, stored["digests"], options.out, options.jobs)["methods"]["diagnose"][
            "scores"
        ]["all"]
        print(f"{family}, {scores['cases']['value']} cases")
        for name, (relation, bound, then) in floors.items():
            seen, n = scores[name]["value"], scores[name]["n"]
            holds = seen >= bound if relation == ">=" else seen <= bound
            missed |= not holds
            words = "" if holds else "   MISSED"
            print(
                f"  {name:15} {seen:8.3f} (n {n}), to be {relation} {bound:.3f}; {then:.3f} when stored{words}"
            )
        print(f"  {'processor time':15} {scores['processor']['value']:8.1f} s in the median")
    sys.exit(int(missed))


if __name__ == "__main__":
    main()
