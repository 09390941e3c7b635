"""What every LaTeX table needs: text that LaTeX shows as it is, and a table that is never wider than the page."""

from collections.abc import Sequence
from typing import Final

PACKAGES: Final = "% Needs \\usepackage{adjustbox} and \\usepackage{booktabs}."

_WRITTEN: Final = str.maketrans(
    {
        **{character: f"\\{character}" for character in "%&_#${}"},
        **{character: f"${character}$" for character in "<>|"},
        "\\": "\\textbackslash{}",
        "^": "\\textasciicircum{}",
        "~": "\\textasciitilde{}",
        "±": "$\\pm$",
        "×": "$\\times$",
        "−": "$-$",
        "–": "--",
        "µ": "$\\mu$",
    }
)


def escaped(text: str) -> str:
    """Return a text as LaTeX shows it; in its default font encoding a bare ">" comes out as "¿"."""
    return text.translate(_WRITTEN)


def row(cells: Sequence[str]) -> str:
    """Return a line of a table."""
    return f"{' & '.join(map(escaped, cells))} \\\\"


def table(columns: str, lines: Sequence[str]) -> list[str]:
    """Return the lines of a table with booktabs, made smaller if it is wider than the line."""
    return [
        "\\begin{adjustbox}{max width=\\linewidth}",
        f"\\begin{{tabular}}{{{columns}}}",
        "\\toprule",
        *lines,
        "\\bottomrule",
        "\\end{tabular}",
        "\\end{adjustbox}",
    ]
