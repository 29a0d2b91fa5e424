"""Results as notebooks show them."""

import html
import re
from typing import Any


def repr_html(self: Any) -> str:
    """Gives the text of `repr` as a table: a row for each of its lines, the first as the heading.

    What stands in columns, two or more spaces apart, is in cells. A class takes it as its `_repr_html_`.
    """
    text = repr(self)
    inside = re.fullmatch(r"(\w+)\((.*)\)", text, re.DOTALL)
    first, *rest = (
        line.strip().rstrip(",") for line in (f"{inside[1]}: {inside[2]}" if inside else text).splitlines()
    )
    rows = [[html.escape(cell) for cell in re.split(r" {2,}", line)] for line in rest]
    width = max(map(len, rows), default=1)
    table = ""
    for row in rows:
        whole = f' colspan="{width}"' if len(row) == 1 < width else ""
        table += "<tr>" + "".join(f'<td style="text-align:left"{whole}>{cell}</td>' for cell in row) + "</tr>"
    return f"<b>{html.escape(first)}</b>" + (f"<table>{table}</table>" if rows else "")
