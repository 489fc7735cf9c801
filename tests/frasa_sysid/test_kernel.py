"""The compiled bench equations against MuJoCo, against plain Python, and the functions in them against numpy."""

import math
import re
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from numba import njit

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import servo_law
from frasa_sysid.calibration.fast_math import fast_exp2, fast_log2, fast_sin
from frasa_sysid.calibration.friction import COEFFICIENTS, Friction, friction_loss
from frasa_sysid.calibration.stepping import EULER, TRAPEZOIDAL
from frasa_sysid.pieces import segments
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import BenchSimulator
from frasa_sysid.servo import servo
from frasa_sysid.servo_values import ServoValues

SERVO = servo("mx106")
STEP = 0.002  # [s] of the bench model
BUFFER = 16  # steps of command history in the bench model
COUNT = 2.0 * math.pi / 4096


def random_run(rng, seconds=6.0, control="position", turns=3):
    """A run of jumps, ramps and a swing, with torque switches at any time and samples at any time."""
    steps = round(seconds / STEP) + 1
    at = np.arange(steps) * STEP
    jumps = rng.uniform(-1.5, 1.5, 12)[np.minimum((at / seconds * 12).astype(int), 11)]
    command = jumps * (rng.random() < 0.7) + rng.uniform(0.0, 1.2) * np.sin(rng.uniform(1.0, 9.0) * at)
    command = command * {"position": 1.0, "voltage": 4.0, "force": 0.6}[control]
    t = np.sort(np.concatenate([[0.0], rng.uniform(0.0, seconds, 300), [seconds - 1e-4]]))
    cells = np.minimum(np.floor(t / STEP), steps - 1)
    switches = np.cumsum(rng.uniform(2 * STEP, 0.7 * seconds, rng.integers(0, turns + 1)))
    return BenchRun(
        name=f"{control}", group="", rig="", trajectory="", control=control,
        inertia=float(np.exp(rng.uniform(np.log(1e-3), np.log(0.1)))),
        gravity_torque=float(rng.choice([0.0, rng.uniform(0.05, 4.0)], p=[0.15, 0.85])),
        kp_scale=float(rng.uniform(0.3, 2.0)), force_scale=float(rng.uniform(0.8, 1.2)),
        command=command, lead=0, supply=1.0 + 0.15 * np.sin(rng.uniform(1.0, 20.0) * at),
        switches=switches, powered_first=bool(rng.random() < 0.8),
        q0=float(rng.uniform(-1.0, 1.0)), dq0=float(rng.choice([0.0, rng.uniform(-3.0, 3.0)])),
        t=t, y=np.interp(t, at, command), step=cells, weight=t / STEP - cells,
        rest=1.05 if control == "position" else 1.0,
    )  # fmt: skip


def with_lead(rng, run):
    """The same run, its commands beginning some steps earlier."""
    lead = int(rng.integers(1, 3 * BUFFER))
    return replace(run, command=np.concatenate([rng.uniform(-1.0, 1.0, lead), run.command]), lead=lead)


def random_values(rng, law="m1", effects=False):
    """A servo within physical bounds; half of the delays are zero or whole steps."""
    delay = rng.choice([0.0, STEP * rng.integers(1, BUFFER), STEP * rng.uniform(1.0, BUFFER - 1.0)], p=[0.2, 0.3, 0.5])
    off = rng.uniform(0.01, 0.3)
    values = ServoValues(
        kp=rng.uniform(3.0, 60.0), forcerange=rng.uniform(1.0, 10.0), damping=off + rng.uniform(0.05, 2.0),
        damping_off=off, frictionloss=rng.choice([1e-6, rng.uniform(0.01, 0.4)], p=[0.1, 0.9]),
        armature=rng.uniform(0.003, 0.06), delay=float(delay), offset=rng.uniform(-0.1, 0.1),
        goal_speed=rng.choice([1e6, rng.uniform(0.5, 6.0)]),
    )  # fmt: skip
    drawn = {
        "stribeck": rng.uniform(0.0, 0.3), "stribeck_speed": rng.uniform(0.05, 3.0),
        "stribeck_exponent": rng.uniform(0.4, 3.0), "load_motor": rng.uniform(0.0, 0.3),
        "load_external": rng.uniform(0.0, 0.3), "load_motor_stribeck": rng.uniform(0.0, 0.3),
        "load_external_stribeck": rng.uniform(0.0, 0.3), "quad_motor": rng.uniform(0.0, 0.05),
        "quad_external": rng.uniform(0.0, 0.05),
    }  # fmt: skip
    own = [name.partition("=") for name in COEFFICIENTS[law]]
    values = replace(values, **{name: drawn[leader or name] for name, _, leader in own})
    if effects:
        values = replace(
            values, sag=rng.uniform(0.0, 0.5), follow=rng.uniform(0.0, 1.5), punch=rng.uniform(0.0, 0.02),
            dead_zone=rng.uniform(0.0, 0.03), collapse_at=rng.uniform(0.05, 0.6), collapse_to=rng.uniform(0.3, 1.0),
            bias=rng.uniform(-0.3, 0.3), drag=rng.uniform(-0.01, 0.02), loop_lag=rng.uniform(0.0, 0.01),
            rest=float(rng.integers(0, 2)),
        )  # fmt: skip
    return ServoValues(**{one.name: float(getattr(values, one.name)) for one in fields(values)})


@dataclass(frozen=True)
class Scalar:
    """The documented equations, one number at a time.

    Attributes:
        volt_scale, supply: see `BenchKernel`.
        creep: b of the friction constraint [1/s].
        implicit: share of a step by which damping looks ahead.
    """

    volt_scale: float
    supply: float
    creep: float
    implicit: float = 1.0

    def readings(self, run, x):
        """Encoder readings at the run's measured times [rad]."""
        free = run.control == "position"
        gain = {"position": x.kp * run.kp_scale, "voltage": x.kp * self.volt_scale, "force": 1.0}[run.control]
        limit = x.forcerange * run.force_scale if free else math.inf
        rest = 1.0 + x.rest * (run.rest - 1.0)
        gain, limit = gain * rest, limit * rest
        stall = limit if free else self.supply * gain
        emf, mass = x.damping - x.damping_off, run.inertia + x.armature
        q, v = run.q0 - x.offset, run.dq0
        goals, angles = self.goals(run, x), [q]
        for k in range(run.steps):
            power = self.power(run, x.delay, k)
            asked = gain * goals[k]
            if free:
                error = goals[k] - x.offset - (q - x.loop_lag * v)
                error = math.copysign(max(abs(error) - x.dead_zone, 0.0), error)
                held_back = x.collapse_to if abs(error) >= x.collapse_at else 1.0
                asked = gain * (error + x.punch * min(max(error / COUNT, -1.0), 1.0))
                asked = min(max(asked, -limit), limit) * held_back
            volts = 1.0 + x.follow * (run.supply[k] - 1.0)
            torque = power * asked * self.left_of(volts, x.sag, asked, emf * v, stall)
            external = x.bias - x.drag * abs(v) * v - run.gravity_torque * math.sin(q)
            damping = x.damping_off + power * emf
            bound = self.bound(x, torque - power * emf * v, external, v)
            smooth = torque + external - damping * v
            heavier = mass + self.implicit * STEP * damping
            stopped = heavier if self.implicit < 1.0 else mass
            stop = min(max(-(smooth + self.creep * stopped * v), -bound), bound)
            v += STEP * (smooth + stop) / heavier
            q += STEP * v
            angles.append(q)
        return np.interp(run.t, np.arange(run.steps + 1) * STEP, angles) + x.offset

    @staticmethod
    def left_of(supply, sag, asked, emf, stall):
        """The supply under load: a share `sag` of it is lost when the motor draws all it can, at stall."""
        volts, before = supply, math.inf
        while abs(volts - before) > 1e-15:  # the current follows the voltage, and the voltage the current
            before = volts
            volts = supply - sag * asked * (asked * volts - emf) / stall**2
        return volts

    @staticmethod
    def goals(run, x):
        """What arrives in each step: profile speed, then delay."""
        goals, most = [run.command[0]], x.goal_speed * STEP
        for command in run.command:
            goals.append(goals[-1] + min(max(command - goals[-1], -most), most))
        late = run.lead + np.arange(run.steps) - x.delay / STEP
        return np.interp(late, np.arange(run.command.size), goals[1:])

    @staticmethod
    def power(run, delay, k):
        """Share of step k in which the torque flag is on."""
        edges = np.clip((run.switches + delay) / STEP - k, 0.0, 1.0)
        signs = (-1.0) ** np.arange(edges.size)
        first = 1.0 if run.powered_first else -1.0
        return float(run.powered_first) - first * float(np.sum(signs * (1.0 - edges)))

    @staticmethod
    def bound(x, motor, external, v):
        """The friction law, less its viscous part."""
        fade = math.exp(-((abs(v) / x.stribeck_speed) ** x.stribeck_exponent))
        static = x.stribeck + abs(x.load_external_stribeck * external - x.load_motor_stribeck * motor)
        if motor * external < 0.0:
            driving = abs(motor) > abs(external)
            static += x.quad_external * external**2 if driving else x.quad_motor * motor**2
        return x.frictionloss + abs(x.load_external * external - x.load_motor * motor) + fade * static


@pytest.fixture(scope="module", params=[TRAPEZOIDAL, EULER])
def session(request, bench_files):
    """The bench as it is published, and as MuJoCo steps by default."""
    with BenchSession(bench_files[request.param], SERVO, threads=2) as one:
        assert one.stepping == request.param
        yield one


@pytest.fixture(scope="module")
def model_with_law(session):
    """The bench with a place for the law's coefficients, beside its includes."""
    numbers = '<custom><numeric name="mx106_friction" data="0 0.1 0 0 0 0 0 0 0 1 1"/></custom></mujoco>'
    path = session.model_path.with_name("with_law.xml")
    path.write_text(re.sub("</mujoco>\\s*$", numbers, session.model_path.read_text()))
    return path


class Replay(BenchSimulator):
    """MuJoCo's rollout; in a step that is powered in part the mean torque is that part of the saturated one."""

    def _configure(self, model, run, values, power):
        super()._configure(model, run, values, power)
        if not run.absolute:
            limit = power * values.forcerange * run.force_scale
            model.actuator_forcerange[0] = (-limit, limit)


class LawReplay(Replay):
    """The same with each candidate's friction law in its model."""

    def _configure(self, model, run, values, power):
        super()._configure(model, run, values, power)
        servo_law.set_law(model, "mx106", values.friction())


def of_kernel(session, run, values):
    return session.kernel([run]).readings(values.array()[None])[0]


def furthest(session, simulator, cases):
    """Largest difference [rad] of the kernel from MuJoCo over pairs of a run and a servo."""
    apart = [of_kernel(session, run, x) - simulator.simulate([run], [x])[0][0] for run, x in cases]
    return max(float(np.abs(one).max()) for one in apart)


@pytest.mark.parametrize(("control", "seed"), [("position", 1), ("position", 2), ("voltage", 3), ("force", 4)])
def test_it_moves_as_mujoco_does(session, control, seed):
    """Jumps, saturation, delays, torque switches, profile speed and leads of 200 servos, for six seconds each."""
    rng = np.random.default_rng(seed)
    runs = [random_run(rng, control=control) for _ in range(50)]
    cases = [(with_lead(rng, run) if i % 3 == 0 else run, random_values(rng)) for i, run in enumerate(runs)]
    with Replay(session.model_path, session.volt_scale, 2) as simulator:
        assert furthest(session, simulator, cases) < 1e-10


def test_segments_move_as_mujocos_do(session):
    rng = np.random.default_rng(5)
    pieces = [piece for _ in range(10) for piece in segments(random_run(rng), 0.9, STEP)]
    assert max(piece.lead for piece in pieces) == 50
    with Replay(session.model_path, session.volt_scale, 2) as simulator:
        assert furthest(session, simulator, [(piece, random_values(rng)) for piece in pieces]) < 1e-10


@pytest.mark.parametrize("law", ["m2", "m3", "m4", "m5", "m6"])
def test_friction_laws_move_as_they_do_inside_mujoco(session, model_with_law, law):
    rng = np.random.default_rng(6)
    cases = [(random_run(rng), random_values(rng, law)) for _ in range(24)]
    with servo_law.active(), LawReplay(model_with_law, session.volt_scale, 2) as simulator:
        assert furthest(session, simulator, cases) < 1e-8


@pytest.mark.parametrize("law", ["m1", "m6"])
@pytest.mark.parametrize("effects", [False, True])
def test_it_moves_as_the_written_out_equations_do(session, law, effects):
    """Every effect at once, in every kind of drive; the last ulp of sin decides less than 1e-10 rad."""
    rng = np.random.default_rng(7)
    scalar = Scalar(session.volt_scale, SERVO.supply_voltage, session.options.creep, session.options.implicit)
    for control in ("position", "position", "position", "voltage", "force") * 3:
        run, values = with_lead(rng, random_run(rng, 3.0, control)), random_values(rng, law, effects)
        values = replace(values, sag=0.0) if control == "force" else values  # a force knows no supply
        assert np.abs(of_kernel(session, run, values) - scalar.readings(run, values)).max() < 1e-10


@pytest.mark.parametrize(
    "change",
    [{"sag": 0.3}, {"follow": 1.0}, {"punch": 0.01}, {"dead_zone": 0.02}, {"collapse_at": 0.1, "collapse_to": 0.5},
     {"bias": 0.1}, {"goal_speed": 1.0}, {"drag": 0.02}, {"loop_lag": 0.005}, {"rest": 1.0}],
)  # fmt: skip
def test_one_effect_alone_is_felt(session, change):
    """Each switches its own loop on, and moves the joint as written out."""
    rng = np.random.default_rng(8)
    scalar = Scalar(session.volt_scale, SERVO.supply_voltage, session.options.creep, session.options.implicit)
    run, plain = random_run(rng, 2.0, turns=0), replace(random_values(rng), goal_speed=1e6)
    values = replace(plain, **change)
    found = of_kernel(session, run, values)
    assert np.abs(found - scalar.readings(run, values)).max() < 1e-10
    assert np.abs(found - of_kernel(session, run, plain)).max() > 1e-4


@njit
def each(x):
    """sin, 2^x and log2 |x| of many numbers, shape (3, n)."""
    out = np.empty((3, x.size))
    for i in range(x.size):
        out[0, i], out[1, i], out[2, i] = fast_sin(x[i]), fast_exp2(x[i]), fast_log2(abs(x[i]))
    return out


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 0.7, 2.0, 40.0, 990.0])
def test_fast_functions_are_numpys(scale):
    x = np.random.default_rng(9).uniform(-scale, scale, 200_000)
    sin, power, log = each(x)
    assert np.abs(sin - np.sin(x)).max() < min(1e-12, 1e-12 * scale)
    np.testing.assert_allclose(power, np.exp2(x), rtol=1e-12)
    np.testing.assert_allclose(log, np.log2(np.abs(x)), rtol=1e-12, atol=1e-14)


def test_fast_functions_at_the_borders():
    sin, power, log = each(np.array([0.0, -5000.0, 5000.0, 1e-320, np.inf, np.nan]))
    np.testing.assert_allclose(power[:4], [1.0, 2.0**-1000, 2.0**1000, 1.0], rtol=1e-12)
    assert np.isfinite(log[0])
    assert log[3] == log[0]  # below the smallest it tells apart
    assert sin[0] == 0.0
    assert np.isnan(sin[4:]).all()
    assert np.isnan(power[5])


def test_the_compiled_law_is_the_plain_one():
    rng = np.random.default_rng(10)
    for _ in range(300):
        coefficients = rng.uniform(0.0, 0.4, 8)
        law = Friction(0.1, *coefficients, rng.uniform(0.01, 5.0), rng.uniform(0.3, 4.0))
        motor, external, speed = rng.normal(0.0, 2.0, 3) * rng.choice([0.0, 1e-6, 1.0, 30.0], 3)
        expected = law.bound(motor, external, speed) - law.viscous * abs(speed)
        assert compiled_law(motor, external, speed, *law.coefficients()) == pytest.approx(expected, rel=1e-11)


@njit
def compiled_law(motor, external, speed, a, b, c, d, e, f, g, h, i, j):
    return friction_loss(motor, external, speed, a, b, c, d, e, f, g, h, i, j)
