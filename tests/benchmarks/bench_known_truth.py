"""How close a fit comes to numbers that are known: the project's simulated logs, and the same bench with an M1 servo.

On `bench_logs/` the truth is the M4 law on a supply that gives way. Fitted with M1, gain, damping and friction have to
stand in for load-dependent friction, and the table shows by how much; fitted with M4 and sag, every coefficient has its
own counterpart. With an M1 truth (same bench, same encoder, jitter and delay, a stiff supply) the table shows the error
of the method itself.
"""

import dataclasses
import sys
from pathlib import Path

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.fit import FitResult, fit
from frasa_sysid.problem import state_problem, stated_servo
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Recording
from frasa_sysid.rig import runs_of
from frasa_sysid.servo import PUBLISHED_M4
from frasa_sysid.simulate import simulate_bench
from frasa_sysid.simulated_bench import BENCHES

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE_TICK = 0.0005  # [s] a command waits half a firmware period on average; it is part of the delay a fit can see
ZERO = 1e-6  # truths below it have no relative error
LAW = {
    "stribeck": "stribeck",
    "stribeck_speed": "stribeck_speed",
    "stribeck_exponent": "stribeck_exponent",
    "load_motor": "load",
    "load_motor_stribeck": "load_stribeck",
}


def fitted(name: str, recordings: list[Recording], law: str, effects: tuple[str, ...] = ()) -> FitResult:
    servo, nominal = stated_servo(name, ROOT / "robot_model" / "nominal.xml")
    with BenchSession(ROOT / "robot_model" / "bench_pendulum.xml", servo) as session:
        runs = runs_of(recordings, servo, session.options.timestep)
        problem = state_problem(servo, nominal, runs, (), session.delay_range, law=law, effects=effects)
        return fit(problem, session, {})


def table(title: str, result: FitResult, truth: dict[str, float], law: str) -> None:
    print(f"\n{title}: mean error {result.nominal.mae_rad * 1e3:.2f} mrad nominal, {result.fitted.mae_rad * 1e3:.2f} "
          f"fitted; {result.evaluations} evaluations, {result.seconds:.0f} s")  # fmt: skip
    print(f"{'parameter':<26}{'truth':>11}{'fitted':>11}{'error':>12}  {'95 % interval':<24}{'verdict'}")
    for free, one in zip(result.problem.free, result.evidence.estimates, strict=True):
        known = truth.get(one.name, truth.get(f"friction.{LAW.get(free.field, '')}"))
        if one.name.endswith(".delay"):
            known = truth[one.name] + FIRMWARE_TICK
        if one.name.endswith(".frictionloss"):
            # As M1, M4 has no single Coulomb number: without load it holds K_c + K_cs at standstill.
            known = truth["friction.coulomb"] + (0.0 if law == result.friction else truth["friction.stribeck"])
        error = "-"
        if known is not None:
            absolute = one.name.endswith((".delay", ".offset")) or known < ZERO
            error = f"{(one.value - known) * 1e3:+.2f} m{one.unit}" if absolute else f"{one.value / known - 1:+.1%}"
        interval = f"{one.low:.5g} .. {one.high:.5g}"
        shown = "-" if known is None else f"{known:.5g}"
        print(f"{one.name:<26}{shown:>11}{one.value:>11.5g}{error:>12}  {interval:<24}{one.verdict}")


def main() -> int:
    for name in ("mx106", "mx64"):
        recordings = read_log(ROOT / "bench_logs" / f"{name}.mcap")
        truth = dict(recordings[0].truth)
        table(f"bench_logs/{name}.mcap (truth M4, fit M1)", fitted(name, recordings, "m1"), truth, "m4")
        title = f"bench_logs/{name}.mcap (truth M4, fit M4 with sag)"
        table(title, fitted(name, recordings, "m4", ("sag",)), truth, "m4")
        m4 = PUBLISHED_M4[name]
        servo = dataclasses.replace(m4, friction=Friction(m4.friction.viscous, 0.09))
        bench = dataclasses.replace(BENCHES[name], supply_resistance=0.0)
        recordings = simulate_bench(servo, bench, "m1")
        table(f"the same bench, truth M1 ({name})", fitted(name, recordings, "m1"), dict(recordings[0].truth), "m1")
    print("\nDelay truths include half a firmware period (0.5 ms), which a command waits on average; the friction loss")
    print("that M1 has for an M4 truth is what holds the joint at standstill without load, K_c + K_cs.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
