"""Loops over the rows of a panel: what happens to a row of 32 numbers is given as a function that emits it."""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from frasa_rl.crossq_vectors import PANEL, Value, Vectors, pointer

Step = tuple[list[Value | None], list[Value]]
Row = Callable[[Vectors, list[Value], list[Value], list[Value]], Step]


def over_rows(panels: int, far: int, factors: int, constants: int, totals: int, row: Row) -> Any:  # noqa: ANN401, PLR0913
    """An intrinsic that goes through rows of 32 numbers.

    It is called as loop(count, stride, wide, (panels ..., factors ..., constants ..., totals ...)), all one-dimensional
    arrays: panels of `count` rows, one factor for each row, 32 constants, 32 totals that are set to sums over rows.

    Args:
        panels, factors, constants, totals: how many of each.
        far: how many panels, the first ones, have rows of `wide` columns that start `stride` apart.
        row: emits what happens to a vector of a row, from those of the panels, factors and constants: new values of
            the first panels (none: it stays), and what is added to each total.
    """

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        kinds = list(signature.args[3])
        vectors = Vectors(context, builder, kinds[0].dtype)
        arrays = cgutils.unpack_tuple(builder, args[3], len(kinds))  # type: ignore[no-untyped-call]
        given = [pointer(context, builder, kind, one) for kind, one in zip(kinds, arrays, strict=True)]
        sheets, singles = given[:panels], given[panels : panels + factors]
        fixed, results = given[panels + factors : panels + factors + constants], given[panels + factors + constants :]
        chunks = range(0, PANEL, vectors.lanes)
        kept = {left: [vectors.load(one, left) for one in fixed] for left in chunks}
        sums = {left: vectors.sums(totals) for left in chunks}
        masks = {left: vectors.below(args[2], left) for left in chunks} if far else {}
        with cgutils.for_range(builder, args[0]) as loop:  # type: ignore[no-untyped-call]
            starts = [builder.mul(loop.index, width) for width in (args[1], args[1].type(PANEL))]
            here = [builder.gep(one, [starts[0 if i < far else 1]]) for i, one in enumerate(sheets)]
            scaled = [vectors.repeated(builder.gep(one, [loop.index]), 0) for one in singles]
            for left in chunks:
                some = [vectors.load_some(one, left, masks[left]) for one in here[:far]]
                all_ = [vectors.load(one, left) for one in here[far:]]
                new, added = row(vectors, [*some, *all_], scaled, kept[left])
                for i, value in enumerate(new):
                    if value is not None and i < far:
                        vectors.store_some(value, here[i], left, masks[left])
                    elif value is not None:
                        vectors.store(value, here[i], left)
                for place, value in zip(sums[left], added, strict=True):
                    vectors.add(place, value)
        for left in chunks:
            for place, result in zip(sums[left], results, strict=True):
                vectors.store(builder.load(place), result, left)
        return context.get_dummy_value()

    @intrinsic  # type: ignore[untyped-decorator]
    def loop(_: Any, count: Any, stride: Any, wide: Any, arrays: Any) -> Any:  # noqa: ANN401
        return types.void(types.intp, types.intp, types.intp, arrays), emit

    return loop


@intrinsic  # type: ignore[untyped-decorator]
def transpose(_: Any, to: Any, to_at: Any, source: Any, at: Any) -> Any:  # noqa: ANN401
    """transpose(to, to_at, source, at): 32 x 32 numbers, rows of 32 in both, through registers."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        vectors = Vectors(context, builder, signature.args[0].dtype)
        lanes = vectors.lanes
        to, source = (builder.gep(pointer(context, builder, signature.args[i], args[i]), [args[i + 1]]) for i in (0, 2))
        for top in range(0, PANEL, lanes):
            for left in range(0, PANEL, lanes):
                rows = [vectors.load(source, (top + i) * PANEL + left) for i in range(lanes)]
                for i, row in enumerate(_turned(vectors, rows)):
                    vectors.store(row, to, (left + i) * PANEL + top)
        return context.get_dummy_value()

    return types.void(to, types.intp, source, types.intp), emit


def _turned(vectors: Vectors, rows: list[Value]) -> list[Value]:
    """Rows of a square as columns: swap its off-diagonal quarters, then theirs within each quarter, and so on."""
    lanes, half = vectors.lanes, vectors.lanes // 2
    while half:
        new = list(rows)
        for i in range(lanes):
            if i & half:
                continue
            a, b = rows[i], rows[i | half]
            new[i] = vectors.shuffled(a, b, [lanes + (k ^ half) if k & half else k for k in range(lanes)])
            new[i | half] = vectors.shuffled(a, b, [lanes + k if k & half else k ^ half for k in range(lanes)])
        rows, half = new, half // 2
    return rows


@intrinsic  # type: ignore[untyped-decorator]
def dot_rows(_: Any, count: Any, panels: Any, jump: Any, arrays: Any) -> Any:  # noqa: ANN401
    """dot_rows(count, panels, jump, (to, x, weight)): to[n] += x[n, :] weight, panels of x `jump` numbers apart."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        kinds = list(signature.args[3])
        vectors = Vectors(context, builder, kinds[0].dtype)
        arrays = cgutils.unpack_tuple(builder, args[3], 3)  # type: ignore[no-untyped-call]
        to, x, w = (pointer(context, builder, kind, one) for kind, one in zip(kinds, arrays, strict=True))
        places = vectors.sums(PANEL // vectors.lanes)
        with cgutils.for_range(builder, args[0]) as row:  # type: ignore[no-untyped-call]
            for place in places:
                builder.store(vectors.zero, place)
            start = builder.mul(row.index, args[0].type(PANEL))
            with cgutils.for_range(builder, args[1]) as panel:  # type: ignore[no-untyped-call]
                here = builder.gep(x, [builder.add(start, builder.mul(panel.index, args[2]))])
                factor = builder.gep(w, [builder.mul(panel.index, args[0].type(PANEL))])
                for i, place in enumerate(places):
                    left = i * vectors.lanes
                    total = vectors.product_sum(
                        vectors.load(here, left), vectors.load(factor, left), builder.load(place)
                    )
                    builder.store(total, place)
            total = builder.load(places[0])
            for place in places[1:]:
                total = builder.fadd(total, builder.load(place))
            half = vectors.lanes // 2
            while half:
                order = [k ^ half for k in range(vectors.lanes)]
                total, half = builder.fadd(total, vectors.shuffled(total, total, order)), half // 2
            result = builder.gep(to, [row.index])
            one = builder.extract_element(total, ir.IntType(32)(0))
            builder.store(builder.fadd(builder.load(result), one), result)
        return context.get_dummy_value()

    whole = types.intp
    return types.void(whole, whole, whole, arrays), emit


@intrinsic  # type: ignore[untyped-decorator]
def copy_columns(_: Any, rows: Any, columns: Any, to: Any, to_at: Any, source: Any, at: Any, stride: Any) -> Any:  # noqa: ANN401, PLR0913
    """copy_columns(rows, columns, to, to_at, source, at, stride): the first of 32 columns, rows of `to` are 32 long."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        vectors = Vectors(context, builder, signature.args[2].dtype)
        to, source = (builder.gep(pointer(context, builder, signature.args[i], args[i]), [args[i + 1]]) for i in (2, 4))
        whole = args[1].type
        masks = {left: vectors.below(args[1], left) for left in range(0, PANEL, vectors.lanes)}
        with cgutils.for_range(builder, args[0]) as row:  # type: ignore[no-untyped-call]
            here = builder.gep(source, [builder.mul(row.index, args[6])])
            there = builder.gep(to, [builder.mul(row.index, whole(PANEL))])
            for left, mask in masks.items():
                vectors.store_some(vectors.load_some(here, left, mask), there, left, mask)
        return context.get_dummy_value()

    whole = types.intp
    return types.void(whole, whole, to, whole, source, whole, whole), emit
