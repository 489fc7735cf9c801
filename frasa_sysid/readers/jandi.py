"""Runs of the leg servos of the humanoid "Jandi" (MX-106, protocol 2) -> recordings.

RnD-king/Jandi_real2sim, commit 86cccc9, `data/raw/mode5`; no licence is stated. A run is a
folder: `telemetry.csv` with one exchange a row, `command_events.csv` with every goal
and when it was sent, `metadata.json` with the registers as read back; the tables may
be gzipped.

Goals count from the end of their transmission. Positions count from the middle of the
exchange that read them, held to the millisecond that the servo's own clock says
(`servo_clock`). Both come from the ticks on the wire, so that goals are as coarse as
the servo saw them; the sign of the joint is already in the columns in radians, and a
file in which it is not is refused.
"""

from pathlib import Path

import numpy as np

from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.readers import faults as known_faults
from frasa_sysid.readers.jandi_metadata import Facts, read_facts
from frasa_sysid.readers.sampling import make_signal, plural
from frasa_sysid.readers.servo_clock import ServoClock, comparison, describe, reading_times
from frasa_sysid.readers.tables import Table, read_table
from frasa_sysid.recording import Fault, FloatArray, Recording

TELEMETRY = ("telemetry.csv", "telemetry.csv.gz")
EVENTS = ("command_events.csv", "command_events.csv.gz")
METADATA = ("metadata.json", "metadata.json.gz")
STEP = 2 * np.pi / 4096  # rad a tick
SAME = 0.51 * STEP  # a goal in rad and in ticks differ by rounding at most
# telemetry column -> signal, unit and scale; all in the joint's direction already
STATES = {
    "dq_present_rad_s": ("velocity", "rad/s", 1.0),
    "current_A_joint": ("current", "A", 1.0),
    "pwm_percent": ("duty", "1", 0.01),
    "input_voltage_V": ("supply_voltage", "V", 1.0),
    "temperature_C": ("temperature", "degC", 1.0),
}
STAMPS = ("tx_end_ns", "rx_end_ns")
LONGEST = 10**15  # ns, eleven days
Mask = np.ndarray[tuple[int], np.dtype[np.bool_]]
OTHERS = ("acquisition_kind", "q_present_rad", "present_position_tick", "realtime_tick_ms", "hardware_error")


def companions(telemetry: Path) -> list[Path]:
    """The files of a run besides its telemetry.

    Raises:
        LogError: one is missing.
    """
    return [_member(telemetry.parent, names) for names in (EVENTS, METADATA)]


def read_jandi(path: Path) -> list[Recording]:
    """The one recording of a run.

    Args:
        path: its folder, or the telemetry in it.

    Raises:
        LogError: a file or column is missing or damaged, or the sign of the joint is not what it says.
    """
    telemetry = _member(path, TELEMETRY) if path.is_dir() else path
    events_path, metadata = companions(telemetry)
    facts, found = read_facts(metadata)
    events = read_table(events_path, ("goal_rad", "goal_tick", "tx_end_ns"))
    table = read_table(telemetry, (*STAMPS, *OTHERS, *STATES))
    sent = events.integers("tx_end_ns")
    stamps = [sent, *(table.integers(name) for name in STAMPS)]
    zero = min(int(one.min()) for one in stamps)
    if max(int(one.max()) for one in stamps) - zero > LONGEST:
        raise LogError(f"{telemetry}: its stamps are days apart, expected those of one run in ns")
    goal, faults = make_signal("goal", "rad", (sent - zero) / 1e9, _goals(events, facts))
    found += faults
    states = np.array([bool(field.strip()) for field in table.text("q_present_rad")])
    found += _error_faults(table, states)
    if goal is None or not states.any():
        raise LogError(f"{telemetry}: {plural(int(states.sum()), 'state')}, expected goals and positions")
    times, clock = _reading_times(table, states, zero, found)
    signals = {"goal": goal}
    columns = [("position", "rad", _positions(table, states, facts))]
    columns += [(name, unit, scale * table.numbers(key)[states]) for key, (name, unit, scale) in STATES.items()]
    for name, unit, values in columns:
        signal, faults = make_signal(name, unit, times, values)
        found += faults
        if signal is not None:
            signals[name] = signal
    if "position" not in signals:
        raise LogError(f"{telemetry} has no usable position")
    signals, handled = known_faults.clean(signals, facts.rig)
    return [
        Recording(
            name=telemetry.resolve().parent.name,
            signals=signals,
            rig=facts.rig,
            origin="real",
            source=str(telemetry),
            sha256=sha256_of_file(telemetry),
            clock="file",
            faults=known_faults.unique([*found, *handled]),
            extra={
                **facts.extra,
                "clocks": comparison(clock, int(states.sum())),
                "clock": {
                    "goals": "end of transmission",
                    "readings": describe(clock),
                    "exchange_ms": _exchange_ms(table, states),
                },
            },
        )
    ]


def _exchange_ms(table: Table, states: Mask) -> float:
    """How long the readings took [ms], the median: from the end of the question to the end of the answer."""
    sent, received = (table.integers(name)[states] for name in STAMPS)
    return round(float(np.median(received - sent)) / 1e6, 4)


def _member(folder: Path, names: tuple[str, ...]) -> Path:
    for name in names:
        if (folder / name).exists():
            return folder / name
    raise LogError(f"{folder} is not a Jandi run: no {names[0]} in it, packed or not")


def _goals(events: Table, facts: Facts) -> FloatArray:
    goals = _in_radians(events.numbers("goal_tick"), facts)
    _check_sign(events.path, "goal_rad", events.numbers("goal_rad"), goals, facts)
    return goals


def _positions(table: Table, states: Mask, facts: Facts) -> FloatArray:
    positions = _in_radians(table.numbers("present_position_tick")[states], facts)
    _check_sign(table.path, "q_present_rad", table.numbers("q_present_rad")[states], positions, facts)
    return positions


def _in_radians(ticks: FloatArray, facts: Facts) -> FloatArray:
    return np.asarray(facts.direction * (ticks - facts.zero_tick) * STEP)


def _check_sign(path: Path, name: str, told: FloatArray, ticks: FloatArray, facts: Facts) -> None:
    apart = np.abs(told - ticks)
    apart = apart[np.isfinite(apart)]
    if apart.size and apart.max() > SAME:
        raise LogError(
            f"{path}: {name} and its ticks are up to {apart.max():.4g} rad apart, expected rounding; "
            f"metadata.json has direction {facts.direction:+d} and zero tick {facts.zero_tick}: are they of this run?"
        )


def _error_faults(table: Table, states: Mask) -> list[Fault]:
    faults = []
    if not states.all():
        count = int((~states).sum())
        kinds = {kind for kind, state in zip(table.text("acquisition_kind"), states, strict=True) if not state}
        text = f"{plural(count, 'exchange')} read {', '.join(sorted(kinds))[:60]} instead of the state; no sample there"
        faults.append(Fault("no_state", count, text))
    errors = table.numbers("hardware_error")
    bits = int((np.nan_to_num(errors) != 0).sum())
    if bits:
        faults.append(
            Fault("hardware_error", bits, f"the servo reported an error {plural(bits, 'time')}; samples kept")
        )
    return faults


def _reading_times(table: Table, states: Mask, zero: int, found: list[Fault]) -> tuple[FloatArray, ServoClock | None]:
    sent, received = (table.integers(name)[states] - zero for name in STAMPS)
    if (received < sent).any() or (np.diff(sent) <= 0).any():
        raise LogError(
            f"{table.path}: exchanges that end before they begin, or out of order; expected host stamps in ns"
        )
    times, clock = reading_times((sent + received) / 2e9, table.numbers("realtime_tick_ms")[states])
    if clock is None:
        found.append(Fault("servo_clock", 1, "the servo's clock cannot be followed; the host's stamps are used alone"))
    elif clock.outliers:
        text = f"{plural(clock.outliers, 'reading')} more than 2 ms off the servo's clock; put where that says"
        found.append(Fault("late_read", clock.outliers, text))
    return times, clock
