"""The words and tables of a whole robot's page."""

from collections.abc import Mapping, Sequence

from frasa_sysid.calibration.page import Html, card, cards, interval_drawing, join, pill, table, tag, warning
from frasa_sysid.robot_errors import UNITS, Compared, errors_by_channel
from frasa_sysid.robot_fit import RobotFit
from frasa_sysid.robot_fit_record import RobotEstimate, RobotFitRecord
from frasa_sysid.robot_problem import FreeNumber

# Names, factors and units in which people read errors.
SHOWN = {
    "position": ("position", 1e3, "mrad"),
    "velocity": ("velocity", 1.0, "rad/s"),
    "gyro": ("gyro", 1.0, "rad/s"),
    "orientation": ("tilt", 1e3, "mrad"),
}
_SMALL = {"s": (1e3, "ms"), "rad": (1e3, "mrad"), "m": (1e3, "mm"), "1": (1.0, "1")}
_MEANING = {
    "command.delay": "from sending a goal to the servo acting on it",
    "sensor.velocity_delay": "age of a joint velocity at its stamp",
    "sensor.gyro_delay": "age of the angular rate at its stamp",
    "sensor.orientation_delay": "age of the trunk's orientation at its stamp",
    "gain_scale": "position gain and torque limit, on what they were",
    "damping_scale": "viscous friction and back-EMF, on what they were",
    "friction_scale": "Coulomb, Stribeck and load friction, on what they were",
    "mass_scale": "of the trunk",
    "zero": "zero error of the encoder",
}
_STAGES = {
    "nominal": "before",
    "fitted": "fitted",
    "held_out_nominal": "held out, before",
    "held_out_fitted": "held out, fitted",
}
_BASES = {"fixed": "held by the trunk", "floating": "on the ground", "both": "held and on the ground"}


def summary(fit: RobotFit, record: RobotFitRecord, servos: Sequence[str], parts: str = "") -> Html:
    """What was fitted and how good it is, in plain words."""
    problem = fit.problem
    seconds = sum(run.steps for run in problem.runs) * fit.timestep
    count = len(problem.runs)
    words = (
        f"A robot of {len(problem.runs[0].joints)} joints, {_BASES[record.base]}: {len(problem.free)} numbers were "
        f"fitted to {count} {'log' if count == 1 else 'logs'} of {seconds:.0f} s ({record.origin})."
    )
    if parts:
        words += f" The logs are longer; these are the parts in which the joints move most: {parts}."
    if servos:
        words += f" The bench fits of {', '.join(servos)} were frozen: scales multiply what they say."
    lines = [tag("p", words), *(tag("p", _sentence(one)) for one in record.not_in_model)]
    if not fit.settled.converged:
        lines.append(warning("The fit ran out of steps before it settled: its numbers may still move."))
    ending = f"{fit.settled.evaluations} robots simulated, {fit.seconds:.0f} s, seed {problem.seed}"
    return join([*lines, cards(_cards(fit, record)), tag("p", tag("small", ending))], "\n")


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def _cards(fit: RobotFit, record: RobotFitRecord) -> list[Html]:
    errors = fit.errors
    found = [_card("joint positions, fitted part", errors["nominal"], errors["fitted"])]
    if "held_out_fitted" in errors:
        title = "joint positions, held out"
        found.append(_card(title, errors["held_out_nominal"], errors["held_out_fitted"]))
    free = [one for one in record.estimates if one.name in {number.name for number in fit.problem.free}]
    known = sum(one.verdict == "identified" for one in free)
    return [*found, card("numbers identified", f"{known} of {len(free)}")]


def _card(title: str, before: Mapping[str, tuple[float, float]], after: Mapping[str, tuple[float, float]]) -> Html:
    old, new = before["position"][0] * 1e3, after["position"][0] * 1e3
    better = f"mean error, before to fitted: {old / new:.1f} times smaller" if 0.0 < new < old else "mean error"
    return card(title, f"{new:.2f}", "mrad", better, f"{old:.2f}")


def number_table(fit: RobotFit, record: RobotFitRecord) -> Html:
    """Every free number with its interval and verdict, drawn within what was thought possible."""
    estimates = {one.name: one for one in record.estimates}
    rows = [_number(free, estimates[free.name]) for free in fit.problem.free]
    caption = (
        "The grey line is what was thought possible beforehand (two standard deviations either way), the bar the "
        "95 % interval (clustered by second and joint), the dot the fit, the hollow mark the value before."
    )
    heads = ("number", "before", "fitted", "unit", "95 % interval", "", "verdict")
    return join([table(heads, rows, (1, 2, 4)), tag("p", tag("small", caption))])


def _number(free: FreeNumber, one: RobotEstimate) -> list[object]:
    scale, unit = _SMALL[free.kind.unit]
    meaning = _MEANING.get(free.name) or _MEANING.get(free.name.rpartition(".")[2], "")
    name = join([tag("span", free.name, css="whole"), Html("<br>"), tag("small", meaning)])
    interval = f"{one.low * scale:.4g} to {one.high * scale:.4g}"
    ends = max(one.nominal - 2.0 * free.kind.prior, free.kind.low), one.nominal + 2.0 * free.kind.prior
    drawing = interval_drawing((one.low, one.value, one.high), one.nominal, ends, one.verdict == "identified")
    value = tag("b", f"{one.value * scale:.4g}")
    return [name, f"{one.nominal * scale:.4g}", value, unit, interval, drawing, pill(one.verdict)]


def physical_delays(fit: RobotFit) -> Html:
    """Delays without the half step of a MuJoCo model."""
    lines = [(free.name, x, half) for free, x, half in zip(fit.problem.free, fit.settled.x, fit.half, strict=True)
             if free.kind.unit == "s"]  # fmt: skip
    if not lines:
        return Html()
    words = (
        f"Delays above are those of the model, whose step of {fit.timestep * 1e3:g} ms acts on commands half a step "
        "early and has speeds half a step late. As they are physically: "
    )
    words += ", ".join(f"{name} {x * 1e3:.2f} ± {half * 1e3:.2f} ms" for name, x, half in lines)
    return tag("p", tag("small", words + "."))


def record_next(record: RobotFitRecord) -> Html:
    """Which logs would help, that for most numbers first."""
    wanted: dict[str, list[str]] = {}
    for one in record.estimates:
        if one.advice and one.name in record.correlated:
            wanted.setdefault(one.advice.removeprefix("record "), []).append(one.name)
    order = sorted(wanted.items(), key=lambda pair: -len(pair[1]))
    if not order:
        return tag("p", "Nothing is missing: every number is identified.")
    return tag("ol", *(tag("li", join([log, tag("small", f", for {', '.join(names)}")])) for log, names in order))


def error_table(fit: RobotFit) -> Html:
    """Mean error of every channel before and after, fitted and held out."""
    stages = [stage for stage in _STAGES if stage in fit.errors]
    rows = []
    for channel in fit.errors["fitted"]:
        name, scale, unit = SHOWN[channel]
        cells = [fit.errors[stage].get(channel) for stage in stages]
        texts = ["" if pair is None else f"{pair[0] * scale:.3g} (rms {pair[1] * scale:.3g})" for pair in cells]
        rows.append([name, unit, *texts])
    return table(("channel", "unit", *(_STAGES[stage] for stage in stages)), rows, range(2, 2 + len(stages)))


def error_cards(found: Mapping[str, Sequence[Compared]]) -> Html:
    """Mean position error of each robot."""
    errors = {name: errors_by_channel(one)["position"] for name, one in found.items()}
    below = {name: f"mean error of the positions; rms {one.rmse * 1e3:.2f} mrad" for name, one in errors.items()}
    return cards(card(name, f"{one.mae * 1e3:.2f}", "mrad", below[name]) for name, one in errors.items())


def channels(found: Mapping[str, Sequence[Compared]]) -> Html:
    """Mean error of every channel of each robot."""
    errors = {name: errors_by_channel(one) for name, one in found.items()}
    rows = []
    for channel in (one for one in UNITS if one in next(iter(errors.values()))):
        name, scale, unit = SHOWN[channel]
        pairs = [(one[channel].mae * scale, one[channel].rmse * scale) for one in errors.values()]
        rows.append([name, unit, *(f"{mae:.3g} (rms {rmse:.3g})" for mae, rmse in pairs)])
    return table(("channel", "unit", *errors), rows, range(2, 2 + len(errors)))


def logs(found: Mapping[str, Sequence[Compared]]) -> Html:
    """Mean position error of every log and robot."""
    errors = {name: errors_by_channel(one)["position"].by_log for name, one in found.items()}
    rows = [[log, *(f"{one[log] * 1e3:.2f}" for one in errors.values())] for log in next(iter(errors.values()))]
    return table(("log", *(f"{name}, mrad" for name in errors)), rows, range(1, 1 + len(errors)), css="sort")


def origins(fit: RobotFit, record: RobotFitRecord) -> Html:
    """What the result depends on: logs and bench fits by their hash, supply and gain."""
    rows = [[name, tag("code", digest)] for name, digest in record.inputs.items()]
    rows += [["bench fit", tag("code", digest)] for digest in record.frozen]
    stated = "kp and force limit hold at {supply_voltage:g} V and firmware gain {firmware_gain:g}".format(
        **record.stated
    )
    model = f"model {record.model.name} ({record.model.fingerprint})"
    words = f"{model}; {stated}; step {fit.timestep * 1e3:g} ms; seed {fit.problem.seed}"
    return join([table(("file", "sha256"), rows), tag("p", tag("small", words))])
