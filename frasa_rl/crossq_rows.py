"""Loops over the rows of a panel: what happens to a row of 32 numbers is given as a function that emits it."""

from collections.abc import Callable

from frasa_rl.crossq_vectors import PANEL, Emitted, Value, Vectors, emitted

Step = tuple[list[Value | None], list[Value]]
Row = Callable[[Vectors, list[Value], list[Value], list[Value]], Step]


def over_rows(row: Row, panels: int, far: int = 0, factors: int = 0, constants: int = 0, totals: int = 0) -> Emitted:
    """A function that goes through rows of 32 numbers.

    It is called as loop((count, stride, wide), (panels ..., factors ..., constants ..., totals ...)): panels of `count`
    rows, one factor for each row, 32 constants, 32 totals that are set to sums over rows.

    Args:
        row: emits what happens to a vector of a row, from those of the panels, factors and constants: new values of
            the first panels (none: it stays), and what is added to each total.
        panels: how many.
        far: how many of them, the first ones, have rows of `wide` columns that start `stride` apart.
        factors: how many.
        constants: how many.
        totals: how many.
    """

    def emit(v: Vectors, numbers: list[Value], given: list[Value]) -> None:
        count, stride, wide = numbers
        ends = panels, panels + factors, panels + factors + constants
        sheets, singles = given[: ends[0]], given[ends[0] : ends[1]]
        fixed, results = given[ends[1] : ends[2]], given[ends[2] :]
        chunks = range(0, PANEL, v.lanes)
        kept = {left: [v.load(one, left) for one in fixed] for left in chunks}
        sums = {left: v.sums(totals) for left in chunks}
        masks = {left: v.below(wide, left) for left in chunks} if far else {}
        with v.loop(count) as loop:
            starts = [v.times(loop.index, stride if i < far else PANEL) for i in range(panels)]
            here = [v.at(one, start) for one, start in zip(sheets, starts, strict=True)]
            scaled = [v.repeated(v.at(one, loop.index), 0) for one in singles]
            for left in chunks:
                some = [v.load_some(one, left, masks[left]) for one in here[:far]]
                new, added = row(v, [*some, *(v.load(one, left) for one in here[far:])], scaled, kept[left])
                for i, value in enumerate(new):
                    if value is not None and i < far:
                        v.store_some(value, here[i], left, masks[left])
                    elif value is not None:
                        v.store(value, here[i], left)
                for place, value in zip(sums[left], added, strict=True):
                    v.add(place, value)
        for left in chunks:
            for place, result in zip(sums[left], results, strict=True):
                v.store(v.builder.load(place), result, left)

    return emitted(3, emit)


def _transpose(v: Vectors, numbers: list[Value], given: list[Value]) -> None:
    to, source = (v.at(one, at) for one, at in zip(given, numbers, strict=True))
    for top in range(0, PANEL, v.lanes):
        for left in range(0, PANEL, v.lanes):
            rows = [v.load(source, (top + i) * PANEL + left) for i in range(v.lanes)]
            for i, row in enumerate(_turned(v, rows)):
                v.store(row, to, (left + i) * PANEL + top)


def _turned(v: Vectors, rows: list[Value]) -> list[Value]:
    """Rows of a square as columns: swap its off-diagonal quarters, then theirs within each quarter, and so on."""
    lanes, half = v.lanes, v.lanes // 2
    while half:
        new = list(rows)
        for i in (i for i in range(lanes) if not i & half):
            a, b = rows[i], rows[i | half]
            new[i] = v.shuffled(a, b, [lanes + (k ^ half) if k & half else k for k in range(lanes)])
            new[i | half] = v.shuffled(a, b, [lanes + k if k & half else k ^ half for k in range(lanes)])
        rows, half = new, half // 2
    return rows


def _dot_rows(v: Vectors, numbers: list[Value], given: list[Value]) -> None:
    count, panels, jump = numbers
    to, x, weight = given
    places = v.sums(PANEL // v.lanes)
    with v.loop(count) as row:
        for place in places:
            v.builder.store(v.zero, place)
        with v.loop(panels) as panel:
            here = v.at(v.at(x, v.times(row.index, PANEL)), v.times(panel.index, jump))
            factor = v.at(weight, v.times(panel.index, PANEL))
            for i, place in enumerate(places):
                v.add_product(place, v.load(here, i * v.lanes), v.load(factor, i * v.lanes))
        for place in places[1:]:
            v.add(places[0], v.builder.load(place))
        result = v.at(to, row.index)
        v.builder.store(v.builder.fadd(v.builder.load(result), v.total(v.builder.load(places[0]))), result)


def _copy_columns(v: Vectors, numbers: list[Value], given: list[Value]) -> None:
    rows, columns, stride = numbers
    to, source = given
    masks = {left: v.below(columns, left) for left in range(0, PANEL, v.lanes)}
    with v.loop(rows) as row:
        here, there = v.at(source, v.times(row.index, stride)), v.at(to, v.times(row.index, PANEL))
        for left, mask in masks.items():
            v.store_some(v.load_some(here, left, mask), there, left, mask)


# ((to_at, at), (to, source)): 32 x 32 numbers turned over, rows of 32 in both.
transpose = emitted(2, _transpose)
# ((count, panels, jump), (to, x, weight)): to[n] += x[n, :] weight, panels of x lie `jump` numbers apart.
dot_rows = emitted(3, _dot_rows)
# ((rows, columns, stride), (to, source)): the first columns of at most 32; rows of `to` are 32 long.
copy_columns = emitted(3, _copy_columns)
