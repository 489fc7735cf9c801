"""What a network is given: matrices as they come, put side by side into its input panels."""

from frasa_rl.crossq_net import BATCH_MEAN, BATCH_VAR, IN_PANELS, NORMS, Net
from frasa_rl.crossq_passes import moved, statistics
from frasa_rl.crossq_rows import copy_columns
from frasa_rl.crossq_vectors import PANEL, Array, compiled, line, not_inlined


@compiled
def put(net: Net, rows: int, row: int, column: int, source: Array) -> None:
    """Write a matrix into the input, from this row and column on."""
    not_inlined()
    count = source.shape[1]
    for panel in range(column // PANEL, (column + count - 1) // PANEL + 1):
        first, last = max(column, panel * PANEL), min(column + count, (panel + 1) * PANEL)
        at = (panel * rows + row) * PANEL + first - panel * PANEL
        pair = (line(net.active, 0, at), line(source, 0, first - column))
        copy_columns((len(source), last - first, count), pair)


@compiled
def center_input(net: Net, rows: int, real: int, center: Array) -> None:
    """Subtract a centre, so that a large mean does not cost digits later."""
    not_inlined()
    for panel in range(net.table[0, IN_PANELS]):
        moved(real, line(net.active, 0, panel * rows * PANEL), center[panel * PANEL :])


@compiled
def measure_input(net: Net, rows: int, real: int) -> None:
    """Statistics of the input, for all networks that share it."""
    not_inlined()
    count, norm = net.table[0, IN_PANELS] * PANEL, net.norm
    for k in range(0, count, PANEL):
        x = line(net.active, 0, k * rows)
        statistics(x, real, line(norm, BATCH_MEAN, k), line(norm, BATCH_VAR, k))
    for c in range(NORMS, len(norm), NORMS):
        for k in range(count):
            norm[c + BATCH_MEAN, k], norm[c + BATCH_VAR, k] = norm[BATCH_MEAN, k], norm[BATCH_VAR, k]
