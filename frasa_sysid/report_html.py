"""The little HTML that report pages are made of: whatever is not marked as HTML is escaped."""

import html
from collections.abc import Iterable, Sequence

_STYLE = """
:root{--ink:#1d2733;--soft:#5b6875;--line:#dde3ea;--pale:#f5f7fa;--blue:#1f6fb2;--red:#b5484d}
body{font:15px/1.55 system-ui,sans-serif;max-width:1180px;margin:2.2em auto 4em;padding:0 1.2em;color:var(--ink)}
h1{font-size:1.6em;margin:0 0 .2em}h2{font-size:1.2em;margin:2.4em 0 .5em;border-bottom:2px solid var(--line)}
p,ul,ol{max-width:80ch}small,.soft{color:var(--soft);font-size:.88em}
table{border-collapse:collapse;font-size:.92em}caption{text-align:left;color:var(--soft);padding:.3em 0}
td,th{padding:.28em .7em .28em 0;border-bottom:1px solid var(--line);text-align:left;vertical-align:middle}
th{font-weight:600;white-space:nowrap}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
tr.chosen td{background:#eaf3fb;font-weight:600}table.sort th{cursor:pointer}.wide{overflow-x:auto}
img{max-width:100%;height:auto;display:block;margin:.8em 0}
.whole{white-space:nowrap}svg.range{display:block}code{font-size:.85em;overflow-wrap:anywhere}
.pill{display:inline-block;padding:.05em .6em;border-radius:1em;font-size:.88em;background:#fdf0d9;color:#8a5200}
.pill.good{background:#e1f3e6;color:#17692f}.pill.bad{background:#fbe4e4;color:#9c2a2f}
.cards{display:flex;flex-wrap:wrap;gap:1em;margin:1.2em 0}
.card{background:var(--pale);border:1px solid var(--line);border-radius:8px;padding:.8em 1.2em;min-width:15em}
.card b{font-size:1.7em;font-variant-numeric:tabular-nums}.card .from{color:var(--soft);font-size:1.2em}
.warn{border-left:4px solid #d98a00;background:#fdf6e7;padding:.6em 1em;margin:1em 0;max-width:80ch}
details summary{cursor:pointer;margin:.4em 0}@media print{details>*{display:block}body{margin:0}}
"""
# A click on a column's head sorts by it; the number or text to sort by stands in the cell.
_SCRIPT = """
for (const head of document.querySelectorAll("table.sort th")) head.onclick = () => {
  const body = head.closest("table").tBodies[0], at = head.cellIndex;
  const turn = head.dataset.turn = -(head.dataset.turn || -1);
  const key = row => { const text = row.cells[at].textContent, n = parseFloat(text); return isNaN(n) ? text : n; };
  const order = (a, b) => turn * (key(a) > key(b) ? 1 : key(a) < key(b) ? -1 : 0);
  body.append(...[...body.rows].sort(order));
};
"""
# The page may use what is in it and nothing else, whatever a log's name tries.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"

_WIDTH, _HEIGHT = 160, 20  # of an interval's drawing [px]


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def esc(value: object) -> Html:
    """A value as HTML: escaped, unless it is HTML already."""
    return value if isinstance(value, Html) else Html(html.escape(str(value)))


def tag(name: str, *content: object, css: str = "") -> Html:
    """An element around escaped content."""
    opening = f'{name} class="{html.escape(css)}"' if css else name
    return Html(f"<{opening}>{''.join(esc(one) for one in content)}</{name}>")


def join(parts: Iterable[object], between: str = "") -> Html:
    """Escaped parts one after the other."""
    return Html(between.join(esc(part) for part in parts))


def table(
    heads: Sequence[str],
    rows: Sequence[Sequence[object]],
    numeric: Sequence[int] = (),
    css: str = "",
    marked: Sequence[int] = (),
) -> Html:
    """A table.

    Args:
        heads: of the columns.
        rows: cells, escaped.
        numeric: columns that are set to the right.
        css: class; `sort` makes it sortable.
        marked: rows that stand out.
    """
    aligned = ["n" if i in numeric else "" for i in range(len(heads))]
    head = tag("tr", *(tag("th", text, css=one) for text, one in zip(heads, aligned, strict=True)))
    lines = [
        tag("tr", *(tag("td", cell, css=one) for cell, one in zip(row, aligned, strict=True)), css=_mark(i, marked))
        for i, row in enumerate(rows)
    ]
    return tag("div", tag("table", tag("thead", head), tag("tbody", *lines), css=css), css="wide")


def pill(verdict: str) -> Html:
    """A verdict in its colour."""
    mood = "good" if verdict == "identified" else "bad" if verdict.startswith("not") else ""
    return tag("span", verdict, css=f"pill {mood}".strip())


def interval_drawing(
    interval: tuple[float, float, float],
    before: float,
    ends: tuple[float, float],
    sure: bool,
    thin: tuple[float, float] | None = None,
    title: str = "",
) -> Html:
    """An interval as a small drawing between two ends; what lies beyond them is drawn at them.

    Args:
        interval: low, value, high: a bar with a dot in it.
        before: hollow mark.
        ends: of the grey line.
        sure: coloured so.
        thin: another interval, a thin line below.
        title: shown on pointing at it.
    """
    low, value, high = interval

    def at(one: float) -> float:
        share = (one - ends[0]) / max(ends[1] - ends[0], 1e-300)
        return round(6 + min(max(share, 0.0), 1.0) * (_WIDTH - 12), 1)

    colour, left, right, middle = "#2a9d5c" if sure else "#d98a00", at(low), at(high), _HEIGHT / 2
    line = (
        f'<line x1="{at(thin[0])}" x2="{at(thin[1])}" y1="{middle + 7}" y2="{middle + 7}" stroke="#5b6875"/>'
        if thin
        else ""
    )
    shapes = (
        f'<line x1="6" x2="{_WIDTH - 6}" y1="{middle}" y2="{middle}" stroke="#c5ced8" stroke-width="2"/>'
        f'<rect x="{left}" y="{middle - 4}" width="{max(right - left, 1.0):.1f}" height="8" rx="2" fill="{colour}" '
        'fill-opacity=".45"/>'
        f"{line}"
        f'<path d="M{at(before)} {middle - 5}l4 5l-4 5l-4 -5z" fill="none" stroke="#5b6875"/>'
        f'<circle cx="{at(value)}" cy="{middle}" r="3.4" fill="{colour}"/>'
    )
    label = f"<title>{html.escape(title)}</title>" if title else ""
    return Html(f'<svg class="range" width="{_WIDTH}" height="{_HEIGHT}" role="img">{label}{shapes}</svg>')


def section(title: str, *content: object) -> Html:
    """A part of the page under a heading; nothing at all without content."""
    inside = [one for one in content if str(one)]
    return join([tag("h2", title), *inside], "\n") if inside else Html()


def page(title: str, parts: Sequence[Html]) -> str:
    """A whole page that needs nothing from elsewhere."""
    head = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{esc(title)}</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{_STYLE}</style></head>"
    )
    body = join([tag("h1", title), *(part for part in parts if part)], "\n")
    return f"{head}\n<body>\n{body}\n<script>{_SCRIPT}</script>\n</body></html>\n"


def _mark(index: int, marked: Sequence[int]) -> str:
    return "chosen" if index in marked else ""
