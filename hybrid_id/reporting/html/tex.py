"""Labels of figures, whose formulas are TeX, as HTML."""

from __future__ import annotations

import re


def without_tex(words: str) -> str:
    """Words without TeX: indices and powers as HTML."""

    def formula(found: re.Match[str]) -> str:
        text = re.sub(r"\\mathrm\{([^{}]*)\}", r"{\1}", found[1]).replace("{{", "{").replace("}}", "}")
        text = re.sub(r"\\dot ?\{?(\w)\}?", "\\1\u0307", text)
        for name, sign in (
            ("tau", "τ"),
            ("omega", "ω"),
            ("sigma", "σ"),
            ("mu", "μ"),
            ("times", "×"),
            ("pm", "±"),
        ):
            text = text.replace(f"\\{name}", sign)
        text = re.sub(r"_(?:\{([^{}]*)\}|(\w))", r"<sub>\1\2</sub>", text)
        text = re.sub(r"\^(?:\{([^{}]*)\}|(\w))", r"<sup>\1\2</sup>", text)
        return re.sub("[{}]", "", text)

    return re.sub(r"\$([^$]*)\$", formula, words).replace("\n", "<br>")
