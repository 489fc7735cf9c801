"""The words and tables of a fit's report page."""

from collections.abc import Sequence

import numpy as np

from frasa_sysid.calibration.page import Html, card, cards, folded, interval_drawing, join, pill, table, tag, warning
from frasa_sysid.choice import Choice, Trial
from frasa_sysid.effects import EFFECTS
from frasa_sysid.evidence import Estimate
from frasa_sysid.fit import FitResult
from frasa_sysid.fit_record import Extras, torque_off
from frasa_sysid.free_parameter import FreeParameter
from frasa_sysid.pieces import ONE_LOG, count_of, one_log_in_pieces
from frasa_sysid.recording import FloatArray
from frasa_sysid.search import Stop
from frasa_sysid.stand_in import StandIn

LAW_NAMES = {
    "m1": "Coulomb and viscous friction",
    "m2": "with the Stribeck effect",
    "m3": "load-dependent",
    "m4": "load-dependent, with the Stribeck effect",
    "m5": "load-dependent by direction, with the Stribeck effect",
    "m6": "quadratic in the load, with the Stribeck effect",
}
_MEANING = {
    "kp": "position gain",
    "forcerange": "torque limit",
    "damping": "viscous friction and back-EMF",
    "damping_off": "viscous friction, torque off",
    "frictionloss": "Coulomb friction",
    "armature": "rotor inertia at the output",
    "delay": "of commands",
    "offset": "zero of the encoder",
    "stribeck": "extra friction at standstill",
    "stribeck_speed": "speed at which it fades",
    "stribeck_exponent": "how sharply it fades",
    "load_motor": "friction per motor torque",
    "load_external": "friction per load torque",
    "load_motor_stribeck": "the same, extra at standstill",
    "load_external_stribeck": "the same, extra at standstill",
    "quad_motor": "friction per squared motor torque",
    "quad_external": "friction per squared load torque",
}
_TORQUE_OFF = {
    "coast": "With its torque switched off it coasts: the back-EMF is gone.",
    "short-brake": "With its torque switched off it brakes: the damping stays, as if the windings were shorted.",
    "unclear": "What it does with its torque switched off, these logs do not tell.",
}


def summary(result: FitResult, extras: Extras) -> Html:
    """What was fitted and how good it is, in plain words."""
    problem = result.problem
    effects = [f"{name}, {EFFECTS[name].meaning}" for name in problem.effects]
    words = f"Servo {problem.servo.name}, friction law {result.friction.upper()}: {LAW_NAMES[result.friction]}."
    words += f" Beside it: {'; '.join(effects)}." if effects else ""
    words += f" {len(problem.free)} numbers were fitted to {count_of(problem.train)} of {extras.origin} logs."
    words += f" {_TORQUE_OFF[torque_off(result)]}"
    found = [_card("runs it was fitted to", result.nominal.mae_rad, result.fitted.mae_rad)]
    if problem.held_out:
        title = f"{count_of(problem.held_out)} held out ({problem.hold_out_rule})"
        found.append(_card(title, result.held_out_nominal.mae_rad, result.held_out.mae_rad))
    known = sum(one.verdict == "identified" for one in result.evidence.estimates)
    found.append(card("numbers identified", f"{known} of {len(result.evidence.estimates)}"))
    ending = tag("small", f"{result.evaluations} evaluations, seed {problem.seed}; {result.stop.value}")
    ages = [] if extras.readout is None else [tag("p", f"Delay: {extras.readout.words()}.")]
    return join([tag("p", words), *ages, *_warnings(result, extras), cards(found), tag("p", ending)], "\n")


def _card(title: str, before: float, after: float) -> Html:
    better = "mean error"
    if 0.0 < after < before:
        better = f"mean error, nominal to fitted: {before / after:.1f} times smaller"
    return card(title, f"{after * 1e3:.1f}", "mrad", better, f"{before * 1e3:.1f}")


def _warnings(result: FitResult, extras: Extras) -> list[Html]:
    found = []
    if result.solved.multimodal:
        found.append(
            "Several answers: independent searches ended at costs that differ by more than 1 %. The lowest is kept, "
            "but these logs allow others; see the restarts, and what to record next."
        )
    if result.stop is Stop.INTERRUPTED:
        found.append("This fit was interrupted: its numbers are the best so far, not the answer.")
    if one_log_in_pieces(result.problem.train):
        found.append(ONE_LOG)
    if extras.delay_doubt:
        found.append(f"{extras.delay_doubt[:1].upper()}{extras.delay_doubt[1:]}.")
    return [warning(text) for text in found]


def parameter_table(result: FitResult, extras: Extras) -> Html:
    """Every number with its intervals, drawn within the range that was searched."""
    refit = extras.bootstrap
    heads = ["parameter", "nominal", "fitted", "unit", "95 % interval", "bootstrap"]
    heads += [f"{extras.draws} refits"] if refit is not None else []
    rows = []
    for i, (one, free) in enumerate(zip(result.evidence.estimates, result.problem.free, strict=True)):
        step = result.evidence.bootstrap[i]
        meaning = f"zero of rig {free.rig}" if free.rig else _MEANING.get(free.field, _effect(free.field))
        name = join([tag("span", one.name, css="whole"), Html("<br>"), tag("small", meaning)])
        unit = tag("span", one.unit, css="whole")
        cells: list[object] = [name, f"{one.nominal:.4g}", tag("b", f"{one.value:.4g}"), unit]
        cells += [_interval(one.low, one.high), _interval(*step)]
        cells += [_interval(*refit[i])] if refit is not None else []
        rows.append([*cells, _range(one, free, step), pill(one.verdict)])
    caption = (
        "The grey line is the range that was searched, the bar the 95 % interval (clustered by log), the thin line "
        "the bootstrap over logs, the dot the fit, the hollow mark the nominal value (at an end: beyond the range)."
    )
    columns = [1, 2, *range(4, len(heads))]
    return join([table([*heads, "in the searched range", "verdict"], rows, columns), tag("p", tag("small", caption))])


def _effect(field: str) -> str:
    """What a number of an effect belongs to."""
    return next((one.meaning for one in EFFECTS.values() if field in {n.field for n in one.numbers}), "")


def _interval(low: float, high: float) -> str:
    return f"{low:.4g} to {high:.4g}"


def _range(one: Estimate, free: FreeParameter, step: FloatArray) -> Html:
    """The intervals of one number as a small drawing."""
    title = f"searched from {free.low:.4g} to {free.high:.4g} {free.unit}"
    thin = float(step[0]), float(step[1])
    sure = one.verdict == "identified"
    return interval_drawing((one.low, one.value, one.high), one.nominal, (free.low, free.high), sure, thin, title)


def record_next(result: FitResult, beforehand: Sequence[str]) -> Html:
    """Which logs would help: for most numbers first, the worst known among them first.

    Args:
        result: of the fit.
        beforehand: what the logs themselves lack, see `identifiability.next_logs`.
    """
    wanted: dict[str, list[Estimate]] = {}
    for one in result.evidence.estimates:
        if one.advice:
            wanted.setdefault(one.advice.removeprefix("record "), []).append(one)
    order = sorted(wanted.items(), key=lambda pair: (-len(pair[1]), not any(not one.excited for one in pair[1])))
    lines = [join([log, tag("small", f", for {', '.join(one.name for one in helped)}")]) for log, helped in order]
    lines += [join([log]) for log in beforehand if log not in wanted]
    if not lines:
        return tag("p", "Nothing is missing: every number is identified.")
    return tag("ol", *(tag("li", line) for line in lines))


def choice_table(choice: Choice, law: str) -> Html:
    """The models that were weighed: effects as they were tried, then the laws."""
    trials = [*choice.effects, *choice.laws]
    rows = [_trial(one) for one in trials]
    chosen = [i for i, one in enumerate(trials) if i >= len(choice.effects) and one.law == law]
    heads = ("model", "numbers", "all runs, mrad", "held out, mrad", "p", "tested against")
    words = f"{choice.reason}. Held-out errors are geometric means over the folds; p is one-sided, paired by fold."
    return join([tag("p", words[:1].upper() + words[1:]), table(heads, rows, (1, 2, 3, 4), marked=chosen)])


def _trial(one: Trial) -> list[object]:
    p_value = "" if one.p_value != one.p_value else f"{one.p_value:.3f}" if one.p_value >= 0.001 else "< 0.001"
    held = "" if one.held_out != one.held_out else f"{one.held_out * 1e3:.2f}"
    return [" + ".join((one.law, *one.effects)), one.numbers, f"{one.train * 1e3:.2f}", held, p_value, one.against]


def restart_table(result: FitResult) -> Html:
    """Where every start ended, and which number it disagrees about most."""
    best = result.solved.restarts[0] if result.solved.restarts else None
    rows = []
    for one in result.solved.restarts:
        apart = np.abs(one.x - best.x) if best is not None else np.zeros(1)
        most = int(np.argmax(apart))
        far = f"{result.problem.free[most].name}, {apart[most]:.0%} of its range" if apart[most] > 0.005 else "none"
        more = one.cost / result.solved.cost - 1.0 if result.solved.cost > 0.0 else 0.0
        rows.append([one.start, f"{one.cost * 1e3:.3f}", f"{100.0 * more:+.2f} %", "" if one is best else far])
    return table(("start", "cost, mrad", "over the best", "largest difference to the best"), rows, (1, 2))


def stand_in_text(one: StandIn) -> Html:
    """M1 in place of a richer law, what it costs and for what it holds."""
    fields = [("kp", "N m/rad"), ("forcerange", "N m"), ("damping", "N m s/rad"), ("frictionloss", "N m")]
    fields += [("armature", "kg m^2"), ("delay", "s")]
    words = (
        f"Where a simulator has Coulomb and viscous friction only, these numbers come closest to the fit. They differ "
        f"from it by {one.penalty.mae_rad * 1e3:.2f} mrad on average (rms {one.penalty.rmse_rad * 1e3:.2f}) on the "
        f"motions of the logs: loads of {one.loads[0]:.2f} to {one.loads[1]:.2f} N m, up to {one.speed:.1f} rad/s. "
        "Beyond that nothing is promised."
    )
    rows = [[name, f"{getattr(one.values, name):.4g}", unit] for name, unit in fields]
    return join([tag("p", words), table(("M1", "value", "unit"), rows, (1,))])


def run_table(result: FitResult) -> Html:
    """Every run's error, the worst first; a click on a head sorts."""
    kinds = (
        ("fitted", result.fitted.by_run, result.nominal.by_run),
        ("held out", result.held_out.by_run, result.held_out_nominal.by_run),
    )
    lines = [(after[name], before[name], kind, name) for kind, after, before in kinds for name in after]
    lines.sort(key=lambda line: -line[0])
    rows = [[name, kind, f"{before * 1e3:.1f}", f"{after * 1e3:.1f}"] for after, before, kind, name in lines]
    heads = ("run", "kind", "nominal, mrad", "fitted, mrad")
    inside = table(heads, rows, (2, 3), css="sort")
    return folded(f"{_runs(len(rows))}, the worst first; a click on a head sorts", inside)


def origins(result: FitResult) -> Html:
    """What the result depends on: logs by their hash, versions, seed."""
    inputs = table(("log", "sha256"), [[name, tag("code", digest)] for name, digest in result.inputs.items()])
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    servo = result.problem.servo
    stated = f"kp and force limit hold at {servo.supply_voltage:g} V and firmware gain {servo.firmware_gain:g}"
    return join([inputs, tag("p", tag("small", f"{versions}; seed {result.problem.seed}; {stated}"))])


def _runs(count: int) -> str:
    return f"{count} run" if count == 1 else f"{count} runs"
