"""A policy on the robot: one file that needs numpy and nothing else. Copy it beside an exported folder.

    runtime = Runtime.load("folder", rate_hz=100)
    runtime.start(present_commands)                                  # (n, 2): left, right [rad]
    while True:                                                      # every runtime.period_s
        commands = runtime.step(positions, velocities, pitch, pitch_rate)

Files are data: nothing in them is executed, and what does not fit exactly is refused (`DeployError`).
"""

import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

# Products this small lose by threads. It works where numpy was not imported before.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt

Single = npt.NDArray[np.float32]
Floats = npt.NDArray[np.float64]
Layers = tuple[tuple[Single, Single], ...]

WEIGHTS_FILE, DEPLOY_FILE = "weights.safetensors", "deploy.json"
SCHEMA = "frasa.deploy/1"
PARTS = ("position", "velocity", "command", "pitch", "pitch_rate", "previous_action")
_LARGEST_FILE, _LARGEST_HEADER = 1 << 28, 1 << 20
_ZERO = np.float32(0.0)


class DeployError(ValueError):
    """A file of a policy is missing or not what it should be."""


class Network:
    """Linear layers with rectifiers between and a hyperbolic tangent at the end, in buffers made once.

    Biases are one more column, met by an input that is always 1: a product is cheaper than a product and a sum.

    Args:
        layers: weights (out, in) and biases (out,).
    """

    def __init__(self, layers: Layers) -> None:
        self.inputs, self.outputs = layers[0][0].shape[1], layers[-1][0].shape[0]
        values = [np.ones(weight.shape[1] + 1, dtype=np.float32) for weight, _ in layers]
        self._observation, self._shape = values[0][:-1], (self.inputs,)
        self._action = np.zeros(self.outputs, dtype=np.float32)
        outs = [*(one[:-1] for one in values[1:]), self._action]
        # Row by row in memory, as `Policy.act` has them: the two then round alike.
        weights = [np.ascontiguousarray(np.column_stack(one), dtype=np.float32) for one in layers]
        *self._hidden, self._last = zip(weights, values, outs, strict=True)

    def act(self, observation: npt.NDArray[Any]) -> Single:
        """Actions in [-1, 1], shape (n,), for one observation (22,); the next call overwrites them."""
        if observation.shape != self._shape:
            raise ValueError(f"an observation of shape {observation.shape}: expected {self._shape}")
        self._observation[:] = observation
        for weight, values, out in self._hidden:
            np.dot(weight, values, out=out)
            np.maximum(out, _ZERO, out=out)
        weight, values, out = self._last
        np.dot(weight, values, out=out)
        np.tanh(out, out=out)
        return out


class Runtime:
    """The loop around a policy, as the training environment has it, for n joints on two sides.

    A decision's rates turn into commands that ramp linearly over the period, inside the command limits. The
    previous action that the policy sees is the mean of what was applied over the last period of *training*,
    so that the same policy runs at all rates from `lowest_hz` to `highest_hz` of its deploy.json.

    The policy has one command for both sides. A robot that fell is not symmetric: each side begins where it is and
    comes to the common command at the rate limit.

    Attributes:
        deploy: the content of deploy.json.
        joints: names of the moved joints, left and right, in the order of all arrays here.
        held: what the other joints are commanded, by name [rad].
        period_s: time between two steps [s].
        observation: what the policy saw last, shape (22,).

    Args:
        network: acts.
        deploy: joints, limits, rates.
        rate_hz: of decisions; None for that of training.

    Raises:
        DeployError: the description is broken, is of another network, or its rates do not include this one.
    """

    def __init__(self, network: Network, deploy: dict[str, Any], rate_hz: float | None = None) -> None:
        self.deploy, self.act = deploy, network.act
        try:
            self._read_joints(deploy)
            self._read_rates(deploy, rate_hz)
            n = self._n = len(self.joints)
            sizes = [n, n, n, 1, 1, n]
            said = [(one["name"], one["size"]) for one in deploy["observation"]]
            bounds = [_number(one["bound"], 0.0, 1e3) for one in deploy["observation"]]
        except (KeyError, TypeError, AttributeError, IndexError) as error:
            raise DeployError(f"{DEPLOY_FILE}: missing or wrong field: {_short(repr(error))}") from None
        if said != list(zip(PARTS, sizes, strict=True)) or (network.inputs, network.outputs) != (sum(sizes), n):
            raise DeployError(f"{DEPLOY_FILE}: {n} joints do not go with its observation and these weights")
        self._high = np.repeat(np.array(bounds, dtype=np.float32), sizes).astype(np.float64)
        self._low, self._seen = -self._high, np.zeros(sum(sizes))
        self.observation = np.zeros(sum(sizes), dtype=np.float32)
        self._before, self._change, self._commands = np.zeros(n), np.zeros(n), np.zeros((n, 2))
        # What a side still differs by from the common command, at the end of the last period and of this one.
        self._apart_before, self._apart = np.zeros((n, 2)), np.zeros((n, 2))
        self._even, self._started = True, False
        self._remember()

    def _remember(self) -> None:
        """All that is read and remembered in one vector, and the matrix that makes of it what the policy sees."""
        n, spans = self._n, self._shares.size
        known = self._known = np.zeros(5 * n + 2 + spans * n)
        self._positions, self._velocities = known[: 2 * n].reshape(n, 2), known[2 * n : 4 * n].reshape(n, 2)
        self._goal, self._trunk = known[4 * n : 5 * n], known[5 * n : 5 * n + 2]
        self._recent = known[5 * n + 2 :].reshape(spans, n)  # actions, the oldest first
        self._newest, self._goal_column = self._recent[-1], self._goal[:, None]
        mean = np.kron(np.eye(n), [0.5, 0.5]) * self._mirror.ravel()
        blocks = (mean, mean, np.eye(n), np.eye(2), np.kron(self._shares, np.eye(n)))
        self._sight = np.zeros((self._seen.size, known.size))
        row = column = 0
        for one in blocks:
            self._sight[row : row + one.shape[0], column : column + one.shape[1]] = one
            row, column = row + one.shape[0], column + one.shape[1]

    def _read_joints(self, deploy: dict[str, Any]) -> None:
        if deploy["schema"] != SCHEMA:
            raise DeployError(f"{DEPLOY_FILE}: schema is {str(deploy['schema'])[:40]!r}, expected {SCHEMA!r}")
        if deploy["compat"]:
            raise DeployError(
                f"trained with compat {str(deploy['compat'])[:40]}, whose histories are not kept here: use Network"
            )
        joints = deploy["joints"]
        self.joints = tuple((str(one["left"]), str(one["right"])) for one in joints)
        self._mirror = np.array([[1.0, _number(one["mirror"], -1.0, 1.0)] for one in joints])
        if (np.abs(self._mirror) != 1.0).any():
            raise DeployError(f"{DEPLOY_FILE}: a mirror is neither 1 nor -1")
        self._least = np.array([_number(one["command_low_rad"], -10.0, 10.0) for one in joints])
        self._most = np.array([_number(one["command_high_rad"], -10.0, 10.0) for one in joints])
        self.held = {str(name): _number(value, -10.0, 10.0) for name, value in deploy["held"].items()}

    def _read_rates(self, deploy: dict[str, Any], rate_hz: float | None) -> None:
        control = deploy["control"]
        trained_s = _number(control["period_s"], 1e-4, 1.0)
        slowest, fastest = _number(control["lowest_hz"], 1.0, 1e4), _number(control["highest_hz"], 1.0, 1e4)
        rate = 1.0 / trained_s if rate_hz is None else rate_hz
        if not slowest - 1e-6 <= rate <= fastest + 1e-6:
            raise DeployError(f"{rate:g} decisions a second: expected {slowest:g} to {fastest:g}")
        self.period_s = 1.0 / rate
        self._travel = self.period_s * _number(deploy["action"]["rate_limit_rad_s"], 0.0, 100.0)
        # The last period of training spans so many of these; of the oldest only a part, where they do not divide it.
        parts = max(1.0, round(trained_s / self.period_s, 6))
        shares = np.ones(math.ceil(parts))
        shares[0] = parts - (shares.size - 1)
        self._shares = shares / parts

    @staticmethod
    def load(folder: Path | str, rate_hz: float | None = None) -> "Runtime":
        """Read an exported folder.

        Raises:
            DeployError: a file is missing or broken, or they are not of one export.
        """
        layers, digest = read_weights(Path(folder) / WEIGHTS_FILE)
        deploy = _json(_content(Path(folder) / DEPLOY_FILE), DEPLOY_FILE)
        if deploy.get("weights_sha256") != digest:
            raise DeployError(f"{DEPLOY_FILE} is not of this {WEIGHTS_FILE}: export the policy again")
        return Runtime(Network(layers), deploy, rate_hz)

    def start(self, commands: npt.ArrayLike) -> None:
        """Begin: forget all actions, and go on from where the robot is.

        Args:
            commands: present ones of both sides [rad], shape (n, 2); of a limp robot, its joint positions.

        Raises:
            ValueError: they are not so many, or not finite.
        """
        present = np.asarray(commands, dtype=np.float64)
        if present.shape != (self._n, 2) or not np.isfinite(present).all():
            raise ValueError(f"commands of shape {present.shape}: expected {(self._n, 2)}, all finite")
        self._goal[:] = np.clip(0.5 * (present * self._mirror).sum(axis=1), self._least, self._most)
        self._before[:] = self._goal
        self._apart[:] = present - self._goal[:, None] * self._mirror
        self._apart_before[:] = self._apart
        self._even, self._started = not self._apart.any(), True
        self._recent[:] = 0.0

    def step(self, positions: Floats, velocities: Floats, pitch: float, pitch_rate: float) -> Floats:
        """One decision; the next call overwrites what this one returned.

        Args:
            positions: joint angles on the left and the right [rad], shape (n, 2), in the robot's own signs; a joint
                on the midline stands on both sides.
            velocities: of the joints [rad/s], shape (n, 2).
            pitch: of the trunk, forward positive [rad] (`pitch_of`).
            pitch_rate: angular rate about the trunk's own y axis, which points left [rad/s].

        Returns:
            Joint angles to be commanded when the period ends [rad], shape (n, 2); on the way there, `between`.

        Raises:
            ValueError: a reading is not a finite number, or there are not so many; commands stay as they are, `between`
                too.
            RuntimeError: `start` was not called: where the robot is is not known.
        """
        self._end_period()
        if positions.shape != self._commands.shape or velocities.shape != self._commands.shape:
            self._recall(_ZERO)
            raise ValueError(f"readings of shape {positions.shape}, {velocities.shape}: expected {(self._n, 2)}")
        self._positions[:] = positions
        self._velocities[:] = velocities
        self._trunk[0], self._trunk[1] = pitch, pitch_rate
        if not math.isfinite(np.dot(self._known, self._known)):
            self._recall(_ZERO)
            raise ValueError("a reading is not a finite number")
        seen = np.dot(self._sight, self._known, out=self._seen)
        np.maximum(seen, self._low, out=seen)
        np.minimum(seen, self._high, out=self.observation, casting="same_kind")
        action, goal = self.act(self.observation), self._goal
        self._recall(action)
        goal += np.multiply(self._newest, self._travel, out=self._change)
        np.maximum(goal, self._least, out=goal)
        np.minimum(goal, self._most, out=goal)
        np.multiply(self._goal_column, self._mirror, out=self._commands)
        if not self._even:
            self._come_together()
        return self._commands

    def _check_started(self) -> None:
        if not self._started:
            raise RuntimeError("start(commands) comes first: it says where the robot is")

    def _end_period(self) -> None:
        """What was commanded is reached; until there is a new action nothing moves."""
        self._check_started()
        self._before[:] = self._goal
        if not self._even:
            self._apart_before[:] = self._apart

    def _recall(self, action: Single | np.float32) -> None:
        """The action of the period that begins: none, where readings were refused."""
        if len(self._recent) > 1:
            self._recent[:-1] = self._recent[1:]
        self._newest[:] = action

    def _come_together(self) -> None:
        """Sides that are apart move towards the common command, at the rate limit."""
        there = self._before[:, None] * self._mirror + self._apart_before
        reached = np.clip(self._commands, there - self._travel, there + self._travel)
        self._apart[:] = reached - self._commands
        self._even = not (self._apart.any() or self._apart_before.any())
        self._commands[:] = reached

    def between(self, share: float) -> Floats:
        """Joint angles when a share (0 to 1) of the period has passed [rad], shape (n, 2).

        Raises:
            RuntimeError: `start` was not called.
        """
        self._check_started()
        common = (self._before + share * (self._goal - self._before))[:, None] * self._mirror
        return np.asarray(common + (self._apart_before + share * (self._apart - self._apart_before)))


def pitch_of(w: float, x: float, y: float, z: float) -> float:
    """Trunk pitch [rad], forward positive, of its orientation; axes x forward, y left, z up."""
    return math.atan2(2.0 * (w * y - x * z), w * w - x * x - y * y + z * z)


def read_weights(path: Path) -> tuple[Layers, str]:
    """The layers of a safetensors file (layer0.weight, layer0.bias, ...), and the SHA-256 of the file.

    Raises:
        DeployError: missing, or anything in it is not as this version writes it.
    """
    content = _content(path)
    size = int.from_bytes(content[:8], "little")
    if len(content) < 8 or size > min(len(content) - 8, _LARGEST_HEADER):
        raise DeployError(f"{path} is not a safetensors file: a header of {size} bytes")
    header, data = _json(content[8 : 8 + size], f"{path} is not a safetensors file"), content[8 + size :]
    header.pop("__metadata__", None)
    count = len(header) // 2
    names = [f"layer{index}.{part}" for index in range(count) for part in ("weight", "bias")]
    if not names or set(header) != set(names):
        raise DeployError(f"{path} holds {_short(sorted(header))}; expected layer0.weight, layer0.bias, ...")
    spans = [(*_span(header[name], f"{path}: {name}"), name) for name in names]
    end, tensors = 0, {}
    for first, last, shape, name in sorted(spans):
        if first != end or last > len(data):
            raise DeployError(f"{path}: {name} does not begin where the one before ends, or ends after the file")
        tensors[name], end = np.frombuffer(data[first:last], dtype="<f4").reshape(shape).astype(np.float32), last
    if end != len(data):
        raise DeployError(f"{path}: {len(data) - end} bytes belong to no tensor")
    layers = tuple((tensors[f"layer{index}.weight"], tensors[f"layer{index}.bias"]) for index in range(count))
    check_layers(layers)
    return layers, hashlib.sha256(content).hexdigest()


def check_layers(layers: Layers) -> None:
    """Raise `DeployError` when layers do not follow on each other or hold numbers that are not finite."""
    if not layers:
        raise DeployError("a policy needs at least one layer")
    for index, (weight, bias) in enumerate(layers):
        wanted = layers[index - 1][0].shape[0] if index else weight.shape[-1]
        if weight.ndim != 2 or weight.shape[1] != wanted or bias.shape != weight.shape[:1]:
            raise DeployError(f"layer {index} has shapes {weight.shape} and {bias.shape} after {wanted} numbers")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise DeployError(f"layer {index} holds numbers that are not finite")


def _span(entry: object, place: str) -> tuple[int, int, tuple[int, ...]]:
    """Where a tensor's bytes are, and its shape."""
    said: dict[str, Any] = entry if isinstance(entry, dict) else {}
    if said.get("dtype") != "F32":
        raise DeployError(f"{place} is of type {_short(said.get('dtype'))}, expected F32")
    shape, offsets = _whole(said.get("shape"), place), _whole(said.get("data_offsets"), place)
    size = offsets[-1] - offsets[0]
    if len(offsets) != 2 or len(shape) > 2 or min(shape) < 1 or size != 4 * math.prod(shape):
        raise DeployError(f"{place} has shape {_short(shape)} at bytes {_short(offsets)}")
    return offsets[0], offsets[1], shape


def _whole(values: object, place: str) -> tuple[int, ...]:
    """A list of whole numbers that a file of this size may speak of."""
    if isinstance(values, list) and values and all(type(one) is int and 0 <= one <= _LARGEST_FILE for one in values):
        return tuple(values)
    raise DeployError(f"{place} has shape or offsets {_short(values)}")


def _content(path: Path) -> bytes:
    if not path.is_file():  # nor a device or a pipe
        raise DeployError(f"no policy at {path.parent}: expected {path.name}")
    with path.open("rb") as file:
        content = file.read(_LARGEST_FILE + 1)
    if len(content) > _LARGEST_FILE:
        raise DeployError(f"{path} is larger than {_LARGEST_FILE >> 20} MiB")
    return content


def _json(content: bytes, place: str) -> dict[str, Any]:
    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len({name for name, _ in pairs}) < len(pairs):
            raise ValueError("a name stands twice")
        return dict(pairs)

    try:
        found = json.loads(content.decode("utf-8"), object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise DeployError(f"{place}: {_short(error)}") from None
    if not isinstance(found, dict):
        raise DeployError(f"{place}: expected a mapping")
    return found


def _number(value: object, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise DeployError(f"{DEPLOY_FILE}: found {_short(value)}, expected a number from {low:g} to {high:g}")
    return float(value)


def _short(value: object) -> str:
    """What is said of something that may be long, in one line."""
    return " ".join(str(value).split())[:80]
