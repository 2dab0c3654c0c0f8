"""A page opened in headless Chromium, every figure of it called up."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

VIEWS = {"desk": ("1280,900", "light", "rgb(255, 255, 255)"), "phone": ("390,844", "dark", "rgb(21, 25, 30)")}
"""Window, colour scheme, and the background that shows it."""

CLICK = """<script>(async () => {
  const buttons = [...document.querySelectorAll("button.live")], wait = ms => new Promise(done => setTimeout(done, ms));
  for (const button of buttons) { button.click(); while (button.disabled) await wait(50); }
  await wait(300);
  const drawn = figure => figure.querySelector(".plot .trace, .plot .hm, .plot canvas") !== null;
  document.title = ["seen", buttons.length, buttons.filter(b => drawn(b.closest("figure"))).length,
    document.querySelectorAll(".frame[hidden]").length, [...document.images].filter(i => !i.naturalWidth).length,
    document.documentElement.scrollWidth > innerWidth, getComputedStyle(document.body).backgroundColor].join("|");
})()</script></body>"""


def look_at(report: Path, folder: Path, *, figures: int) -> None:
    """Open a page as on a desk and as on a phone at night, call up all of its figures, and find nothing wrong.

    Args:
        report: the page.
        folder: where the browser may write.
        figures: interactive figures that it has to have.
    """
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs Chromium")
    opened = folder / "opened.html"
    opened.write_text(report.read_text(encoding="utf-8").replace("</body>", CLICK), encoding="utf-8")
    for name, (size, scheme, back) in VIEWS.items():
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom"]
        options += [
            f"--window-size={size}",
            f"--blink-settings=preferredColorScheme={int(scheme == 'light')}",
        ]
        options += ["--virtual-time-budget=30000", f"--user-data-dir={folder / 'profile'}"]
        done = subprocess.run(
            [browser, *options, opened.as_uri()], capture_output=True, text=True, timeout=120
        )
        title = re.search(r"<title>(.*?)</title>", done.stdout)
        assert title is not None, done.stderr[-500:]
        assert title[1] == f"seen|{figures}|{figures}|{figures}|0|false|{back}", (
            name,
            title[1],
            done.stderr[-500:],
        )
        assert "CONSOLE" not in done.stderr, (name, done.stderr)
