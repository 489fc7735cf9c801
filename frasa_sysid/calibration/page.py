"""The one look of all pages that frasa leaves, and the little HTML they are made of.

Whatever is not marked as HTML is escaped. A page needs nothing from elsewhere: style, script and pictures are in it.
"""

import html
import re
from collections.abc import Iterable, Sequence

_STYLE = """
:root{color-scheme:light dark;--ink:#1d2733;--soft:#5b6875;--line:#dde3ea;--pale:#f5f7fa;--back:#fff;--axis:#c5ced8;
--sure:#0072b2;--fair:#d98200;--good:#17692f;--goodback:#e1f3e6;--mid:#8a5200;--midback:#fdf0d9;--bad:#9c2a2f;
--badback:#fbe4e4;--mark:#eaf3fb}
@media (prefers-color-scheme:dark){:root{--ink:#e3e8ee;--soft:#9fabb8;--line:#37424e;--pale:#222b35;--back:#171e26;
--axis:#55626f;--sure:#56b4e9;--fair:#e69f00;--good:#8fd6a5;--goodback:#1d3a27;--mid:#f0c27a;--midback:#43331a;
--bad:#f0a3a6;--badback:#47262a;--mark:#1f3345}}
body{font:15px/1.55 system-ui,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif;max-width:1180px;
margin:2.2em auto 4em;padding:0 1.2em;color:var(--ink);background:var(--back)}
h1{font-size:1.6em;margin:0 0 .2em;overflow-wrap:anywhere}h3{font-size:1em;margin:1.6em 0 .3em}
h2{font-size:1.2em;margin:2.4em 0 .6em;padding-bottom:.15em;border-bottom:2px solid var(--line)}
p,ul,ol{max-width:80ch}small,.soft{color:var(--soft);font-size:.88em}
nav{font-size:.88em;margin:.4em 0 1em}
nav a{color:var(--sure);text-decoration:none;margin-right:1.2em;white-space:nowrap}
table{border-collapse:collapse;font-size:.92em}caption{text-align:left;color:var(--soft);padding:.3em 0}
td,th{padding:.28em 1.1em .28em 0;border-bottom:1px solid var(--line);text-align:left;vertical-align:middle}
th{font-weight:600;white-space:nowrap}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
tr.chosen td{background:var(--mark);font-weight:600}table.sort th{cursor:pointer}.wide{overflow-x:auto;margin:.6em 0}
img{max-width:100%;height:auto;display:block;margin:.8em 0;background:#fff;border-radius:6px}
.whole{white-space:nowrap}svg.range{display:block}code,pre{font-size:.85em;overflow-wrap:anywhere}
pre{background:var(--pale);padding:.8em 1em;border-radius:6px;overflow:auto}
.range .ends{stroke:var(--axis);stroke-width:2}.range .thin,.range .before{stroke:var(--soft);fill:none}
.range .sure{fill:var(--sure)}.range .fair{fill:var(--fair)}.range rect{fill-opacity:.45}
.pill{display:inline-block;padding:.05em .6em;border-radius:1em;font-size:.88em;background:var(--midback);
color:var(--mid)}
.pill.good{background:var(--goodback);color:var(--good)}.pill.bad{background:var(--badback);color:var(--bad)}
.cards{display:flex;flex-wrap:wrap;gap:1em;margin:1.2em 0}
.card{background:var(--pale);border:1px solid var(--line);border-radius:8px;padding:.8em 1.2em;min-width:11em}
.card b{font-size:1.7em;font-variant-numeric:tabular-nums}.card .from{color:var(--soft);font-size:1.2em}
.warn{border-left:4px solid var(--fair);background:var(--midback);padding:.6em 1em;margin:1em 0;max-width:80ch}
.strip{display:flex;gap:3px;overflow-x:auto;margin:.5em 0 1.4em}
.strip figure{margin:0;flex:1 1 0;min-width:104px;text-align:center;font-variant-numeric:tabular-nums}
.strip img{width:100%;margin:0;border-radius:4px}figcaption{color:var(--soft);font-size:.82em}
details summary{cursor:pointer;margin:.4em 0}
@media print{details>*{display:block}body{margin:0}nav{display:none}h2,img,tr{break-inside:avoid;break-after:auto}}
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

    mood, left, right, middle = "sure" if sure else "fair", at(low), at(high), _HEIGHT / 2
    line = (
        f'<line class="thin" x1="{at(thin[0])}" x2="{at(thin[1])}" y1="{middle + 7}" y2="{middle + 7}"/>'
        if thin
        else ""
    )
    shapes = (
        f'<line class="ends" x1="6" x2="{_WIDTH - 6}" y1="{middle}" y2="{middle}"/>'
        f'<rect class="{mood}" x="{left}" y="{middle - 4}" width="{max(right - left, 1.0):.1f}" height="8" rx="2"/>'
        f"{line}"
        f'<path class="before" d="M{at(before)} {middle - 5}l4 5l-4 5l-4 -5z"/>'
        f'<circle class="{mood}" cx="{at(value)}" cy="{middle}" r="3.4"/>'
    )
    label = f"<title>{html.escape(title)}</title>" if title else ""
    return Html(f'<svg class="range" width="{_WIDTH}" height="{_HEIGHT}" role="img">{label}{shapes}</svg>')


def card(title: str, value: object, unit: str = "", below: str = "", before: str = "") -> Html:
    """A number that the page is about.

    Args:
        title: above it.
        value: large.
        unit: behind it.
        below: in small letters.
        before: what it was, in front of it.
    """
    change = tag("span", f"{before} → ", css="from") if before else Html()
    number = tag("div", change, tag("b", value), f" {unit}" if unit else "")
    return tag("div", tag("small", title), number, tag("small", below) if below else "", css="card")


def cards(found: Iterable[Html]) -> Html:
    """Cards beside each other; nothing at all without one."""
    inside = [one for one in found if one]
    return tag("div", *inside, css="cards") if inside else Html()


def warning(*words: object) -> Html:
    """Something that is to be seen before the rest."""
    return tag("div", *words, css="warn")


def folded(title: str, *content: object) -> Html:
    """What is shown when somebody asks for it."""
    return tag("details", tag("summary", title), *content)


def section(title: str, *content: object) -> Html:
    """A part of the page under a heading; nothing at all without content."""
    inside = [one for one in content if str(one)]
    name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
    return join([Html(f'<h2 id="{name}">{esc(title)}</h2>'), *inside], "\n") if inside else Html()


def page(title: str, parts: Sequence[Html]) -> str:
    """A whole page that needs nothing from elsewhere, with a line of its sections under the title.

    Args:
        title: its heading.
        parts: summary and sections; empty ones are left out.
    """
    head = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{esc(title)}</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{_STYLE}</style></head>"
    )
    inside = join([part for part in parts if part], "\n")
    found = re.findall(r'<h2 id="([^"]*)">(.*?)</h2>', inside)
    links = Html("".join(f'<a href="#{name}">{text}</a> ' for name, text in found))
    contents = tag("nav", links) if len(found) > 2 else Html()
    body = join([tag("h1", title), contents, inside], "\n")
    return f"{head}\n<body>\n{body}\n<script>{_SCRIPT}</script>\n</body></html>\n"


def _mark(index: int, marked: Sequence[int]) -> str:
    return "chosen" if index in marked else ""
