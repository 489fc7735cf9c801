"""A robot of a user's own, from its MJCF: a model to fit and train, a first task, a table of each servo."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frasa_rl.config import Task
from frasa_rl.own_copy import Copy, check_copy, copy_model, step_of
from frasa_rl.own_look import SERVO_NAME, Looked, OwnServo, look
from frasa_rl.own_stance import Stance, find_stance
from frasa_rl.own_task import first_task, task_text
from frasa_rl.own_xml import ASSETS
from frasa_rl.robot import find_robot
from frasa_rl.task_file import load_task
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import UsageError, load_model, number, write_atomic

SUPPLY, GAIN = 12.0, 1.0  # [V], P where nobody says
_SHARE = 0.05  # of the damping that counts as friction, the rest as back-EMF
RESERVED = ("sensor", "trunk", "robot", "bench", "command", "friction", "supply", "imu")


@dataclass(frozen=True)
class OwnRobot:
    """What was made of a model.

    Attributes:
        copy: the model.
        task: the first one.
        stance: the robot stands in.
        servo_of: servo class by joint.
        tables: TOML text by servo name.
        added: what the copy has and the original has not.
        questions: what only the user can know.
        lines: everything for people.
    """

    looked: Looked
    copy: Copy
    task: Task
    stance: Stance
    servo_of: dict[str, str]
    tables: dict[str, str]
    added: tuple[str, ...]
    questions: tuple[str, ...]
    lines: tuple[str, ...]

    def write(self, model: Path, task: Path) -> list[Path]:
        """Write model, task and tables once MuJoCo and the task's own checks have passed them.

        Raises:
            ModelError: the copy is not the same robot, or lacks what the task names; nothing is left then.
        """
        candidate, trial = (
            model.with_name(f".{model.stem}.candidate.xml"),
            task.with_name(f".{task.stem}.candidate.yaml"),
        )
        head = [*self.lines, "", "A file of your own names only what differs; this one names everything."]
        for name, source in self.copy.assets.items():
            write_atomic(model.parent / ASSETS / name, source.read_bytes())
        try:
            write_atomic(candidate, self.copy.xml)
            write_atomic(trial, task_text(self.task, [line.rstrip() for text in head for line in text.split("\n")]))
            check_copy(self.looked, load_model(candidate))
            read = load_task(trial)
            find_robot(build_model(candidate, read), read)
            candidate.replace(model)
            trial.replace(task)
        finally:
            candidate.unlink(missing_ok=True)
            trial.unlink(missing_ok=True)
        paths = [model, task]
        for name, text in self.tables.items():
            paths.append(model.parent / "servos" / f"{name}.toml")
            write_atomic(paths[-1], text)
        return paths


def own_robot(path: Path, named: dict[str, str], supply: float | None = None, gain: float | None = None) -> OwnRobot:
    """Look at a model and make all that its training and fitting need.

    Args:
        path: MuJoCo XML.
        named: servo class by pattern of joint names.
        supply: at which the model's gains hold [V]; None where nobody knows.
        gain: firmware gain P likewise.

    Raises:
        ModelError: what cannot be trained.
        UsageError: a name that no servo can have, or a pattern that fits no joint.
    """
    for name in named.values():
        if not SERVO_NAME.fullmatch(name) or name in RESERVED:
            raise UsageError(f"--servo {name}: expected a name of lower-case letters, digits and underscores")
    looked = look(path, named)
    stance = find_stance(looked)
    volts, P = supply or SUPPLY, gain or GAIN
    if looked.told:
        volts, P = number(looked.model, "servo_supply_voltage"), number(looked.model, "servo_firmware_gain")
    copy = copy_model(looked, stance, volts, P)
    task = first_task(looked, stance, copy.names, step_of(looked))
    tables = {} if looked.told else {one.name: _table(one, looked, volts, P) for one in looked.servos.values()}
    questions = _questions(looked, stance, named, supply, gain)
    return OwnRobot(
        looked, copy, task, stance, looked.servo_of, tables, copy.added, questions,
        _lines(looked, stance, task, copy, questions),
    )  # fmt: skip


def _questions(
    looked: Looked, stance: Stance, named: dict[str, str], supply: float | None, gain: float | None
) -> tuple[str, ...]:
    asked = []
    if not looked.told:
        unnamed = [one for one in looked.servos if one not in named.values()]
        if unnamed:
            asked.append(
                f"which servos these are: {', '.join(unnamed)} have equal numbers in the model (--servo NAME=JOINTS)"
            )
        if supply is None:
            asked.append(f"at which supply the model's gains hold: {SUPPLY:g} V was taken (--supply-voltage V)")
        if gain is None:
            asked.append(f"at which firmware gain P they do: {GAIN:g} was taken (--firmware-gain P)")
        asked += [
            f"{word} of {one.name}: 0 in the model, {getattr(one, word):g} was put in, a guess"
            for one in looked.servos.values()
            for word in one.guessed
        ]
    if stance.sag[0] > np.radians(5.0):
        asked.append(
            f"whether the servos are strong enough: standing, {stance.sag[1]} is {np.degrees(stance.sag[0]):.0f} deg "
            "from its command (torque limit, kp)"
        )
    if not (looked.model.actuator_delay > 0.0).any() or not (looked.model.sensor_delay > 0.0).any():
        asked.append("how old readings or commands are: 0 ms in the model; a fit tells (frasa-sysid excite, fit)")
    asked.append("ranges that nobody measured: those under 'assumed' are the Sigmaban's or guesses")
    return tuple(asked)


def _lines(looked: Looked, stance: Stance, task: Task, copy: Copy, questions: tuple[str, ...]) -> tuple[str, ...]:
    model = looked.model
    total = float(model.body_subtreemass[looked.trunk])
    moved = [f"{one.name} ({one.left} / {one.right}, mirror {one.mirror:+d})" for one in task.joints]
    held = [
        one.name
        for one in looked.hinges
        if one.name not in {name for each in task.joints for name in (each.left, each.right)}
    ]
    feet = ", ".join(f"{leg.side} {model.body(leg.foot).name or leg.foot}" for leg in stance.legs) or "not told apart"
    lines = [
        f"{looked.path}: trunk '{task.names.trunk}', {total:.2f} kg, {len(looked.hinges)} servos",
        f"it stands in {stance.origin}: {stance.height:.2f} m high, trunk pitch {np.degrees(stance.pitch):+.1f} deg, "
        f"{1e3 * stance.margin:.0f} mm from tipping over; feet: {feet}",
        f"moved by the policy, {len(moved)}: {', '.join(moved)}",
        f"held, {len(held)}: {', '.join(held) or 'none'}",
    ]
    for name, servo in looked.servos.items():
        joints = [one.name for one in looked.hinges if looked.servo_of[one.name] == name]
        lines.append(
            f"servo {name}: kp {servo.kp:.4g} N m/rad, {servo.force:.4g} N m, damping {servo.damping:.4g}, friction "
            f"{servo.friction:.4g}, armature {servo.armature:.4g}; {', '.join(joints)}"
        )
    lines += [f"added: {one}" for one in copy.added]
    return (*lines, *(f"not known: {one}" for one in questions))


def _table(servo: OwnServo, looked: Looked, supply: float, gain: float) -> str:
    """The servo as a table that `frasa-sysid` reads, from the model's numbers.

    A model tells kp, torque limit and damping; of a table's kt and R only kt/R and kt^2/R matter.
    """
    per_volt = servo.force / supply
    emf = (1.0 - _SHARE) * servo.damping
    kt = emf / per_volt
    return (
        "# Made by frasa-rl init from the model's numbers: put in what the data sheet says.\n"
        'schema = "frasa.servo/1"\n'
        f'name = "{servo.name}"\n'
        f'title = "{servo.name} of {_plain(looked.path.name)}"\n'
        f'source = "the model {_plain(looked.path.name)}: {1 - _SHARE:.0%} of its damping taken for back-EMF"\n\n'
        "[firmware]\n"
        f"position_gain = {gain!r}\n"
        f'error_gain = {{ value = {servo.kp / (gain * servo.force)!r}, unit = "1/rad" }}\n'
        "max_duty = 1.0\nticks_per_turn = 4096\n\n"
        f'[supply]\nvoltage = {{ value = {supply!r}, unit = "V" }}\n\n'
        f'[motor]\nkt = {{ value = {kt!r}, unit = "N m/A" }}\n'
        f'resistance = {{ value = {kt / per_volt!r}, unit = "Ohm" }}\n\n'
        f'[joint]\narmature = {{ value = {servo.armature!r}, unit = "kg m^2" }}\n'
        f'viscous = {{ value = {_SHARE * servo.damping!r}, unit = "N m s/rad" }}\n'
        f'coulomb = {{ value = {servo.friction!r}, unit = "N m" }}\n'
    )


def _plain(text: str) -> str:
    return "".join(one for one in text if one.isprintable() and one not in '"\\')
