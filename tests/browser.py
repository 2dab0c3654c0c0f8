"""A page opened in headless Chromium."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

VIEWS = {"desk": (1280, "light", "rgb(255, 255, 255)"), "phone": (390, "dark", "rgb(21, 25, 30)")}
"""Width, colour scheme, and the background that shows it."""
FRAME = """<style>:root { color-scheme: light dark; } body { margin: 0; }</style><title>not answered</title>
<script>addEventListener("message", said => document.title = said.data)</script>
<iframe src="opened.html" width="WIDTH" height="844"></iframe>"""
"""Holds the page, for a window is never as narrow as a phone."""

LOOK = """<script>(() => {
  const second = [...document.querySelectorAll("th:nth-child(2)")];
  const gone = second.filter(th => th.getBoundingClientRect().right > innerWidth).map(th => th.textContent);
  const dark = [...document.images].filter(one => getComputedStyle(one).filter.startsWith("invert"));
  parent.postMessage(["seen", [...document.images].filter(i => i.naturalWidth).length,
    document.documentElement.scrollWidth > innerWidth, gone.join(),
    dark.length, getComputedStyle(document.body).backgroundColor].join("|"), "*");
})()</script></body>"""


def look_at(report: Path, folder: Path, *, figures: int) -> None:
    """Open a page as on a desk and as on a phone at night, and find nothing wrong.

    Nothing scrolls sideways but pictures in their frames and tables, whose first two columns are on the screen; at
    night all pictures are dark.

    Args:
        report: the page.
        folder: where the browser may write.
        figures: pictures that it has to have.
    """
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs Chromium")
    opened = folder / "opened.html"
    page = report.read_text(encoding="utf-8")
    opened.write_text(page.replace("</body>", LOOK), encoding="utf-8")
    outer = folder / "outer.html"
    for name, (width, scheme, back) in VIEWS.items():
        outer.write_text(FRAME.replace("WIDTH", str(width)), encoding="utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom"]
        options += [
            f"--window-size={width},900",
            f"--blink-settings=preferredColorScheme={int(scheme == 'light')}",
        ]
        options += ["--virtual-time-budget=30000", f"--user-data-dir={folder / 'profile'}"]
        done = subprocess.run(
            [browser, *options, outer.as_uri()], capture_output=True, text=True, timeout=120
        )
        title = re.search(r"<title>(.*?)</title>", done.stdout)
        assert title is not None, done.stderr[-500:]
        dark = figures * (scheme == "dark")
        assert title[1] == f"seen|{figures}|false||{dark}|{back}", (
            name,
            title[1],
            done.stderr[-500:],
        )
        assert "CONSOLE" not in done.stderr, (name, done.stderr)
