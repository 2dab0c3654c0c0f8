"""What an audit has found, in words: `findings.py licences SBOM` or `findings.py vulnerabilities REPORT`.

Exit code 1 where a licence asks more of those who pass this project on than it may, or something is vulnerable.
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

REFUSED = re.compile(
    r"(?<!L)(?<!Lesser )\b(A?GPL|GNU (Affero )?General Public)|SSPL|BUSL|non.?commercial", re.IGNORECASE
)
"""Copyleft of the whole, or no free use. Weak copyleft (LGPL, MPL) of a library that is imported is none."""


def licences(content: dict[str, Any]) -> list[str]:
    """Packages under a refused licence, one line each; one that has another licence, too, is not among them."""
    found = []
    for component in content["components"]:
        parts = (one.get("license", one) for one in component.get("licenses", []))
        named = [str(part.get("id") or part.get("name") or part.get("expression")) for part in parts]
        if named and all(REFUSED.search(one) for one in named):
            words = f"is under {', '.join(named)}; take another package"
            found.append(f"{component['name']} {component['version']} {words}")
    return found


def vulnerabilities(content: dict[str, Any]) -> list[str]:
    """Known vulnerabilities of what is installed, one line each."""
    return [
        f"{one['name']} {one['version']} has {fault['id']}, fixed in {' or '.join(fault['fix_versions']) or 'none'}"
        for one in content["dependencies"]
        for fault in one.get("vulns", [])
    ]


def main() -> None:
    """Read, say, and leave."""
    kind, file = sys.argv[1:]
    found = {"licences": licences, "vulnerabilities": vulnerabilities}[kind](
        json.loads(Path(file).read_text())
    )
    print(*(f"audit: {line}" for line in found), f"audit: {len(found)} {kind} to be mended", sep="\n")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
