"""Logs of one servo made ready to be simulated and fitted: which servo, which runs, what is asked of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.hold_out import split
from frasa_sysid.logged_servo import servo_name
from frasa_sysid.pieces import in_pieces
from frasa_sysid.problem import FitProblem, state_problem, stated_servo
from frasa_sysid.recording import Recording, Signal
from frasa_sysid.rig import BenchRun, runs_of
from frasa_sysid.servo import Servo, find_table, is_table

NOMINAL_MODEL = Path("robot_model/nominal.xml")
BENCH_MODEL = Path("robot_model/bench_pendulum.xml")


@dataclass(frozen=True)
class Bench:
    """Logs of one servo.

    Attributes:
        servo: the servo, with supply and gain at which kp is stated.
        nominal: value of each field before any fit.
        train, held_out: recordings.
        hold_out: the rule that parted them.
        model: the nominal robot model, beside which the bench's own lies.
    """

    servo: Servo
    nominal: dict[str, float]
    train: list[Recording]
    held_out: list[Recording]
    hold_out: str = "none"
    model: Path = NOMINAL_MODEL

    @property
    def inputs(self) -> dict[str, str]:
        """sha256 by source file."""
        return inputs_of([*self.train, *self.held_out])

    @property
    def origin(self) -> str:
        """`real`, `simulated` or `mixed`."""
        return origin_of([*self.train, *self.held_out])

    def session(
        self, model: Path | None = None, threads: int | None = None, timestep: float | None = None
    ) -> BenchSession:
        """The equations and threads of this servo's bench; use as a context manager.

        Args:
            model: of the pendulum; by default the one beside the robot's.
            threads: by default one per core.
            timestep: a step of its own [s] in place of the model's.
        """
        return BenchSession(model or self.model.with_name(BENCH_MODEL.name), self.servo, threads, timestep)

    def runs(
        self, session: BenchSession, first: float | None = None, shooting: float | None = None
    ) -> tuple[list[BenchRun], list[BenchRun]]:
        """Training and held-out runs on the session's grid.

        Args:
            session: its step is the grid.
            first: seconds of each recording to use; all by default.
            shooting: length of the pieces that each run is cut into [s]; not cut by default.
        """
        step = session.options.timestep
        train, held_out = (
            runs_of([_shortened(one, first) for one in recordings], self.servo, step)
            for recordings in (self.train, self.held_out)
        )
        if shooting is None:
            return train, held_out
        return in_pieces(train, shooting, step), in_pieces(held_out, shooting, step, len(train))

    def problem(
        self,
        session: BenchSession,
        law: str = "m1",
        effects: Sequence[str] = (),
        seed: int = 0,
        first: float | None = None,
        shooting: float | None = None,
    ) -> FitProblem:
        """The fit of a friction law and a set of effects to these logs; see `problem.state_problem` and `runs`."""
        train, held_out = self.runs(session, first, shooting)
        return state_problem(
            self.servo, self.nominal, train, held_out, session.delay_range, self.hold_out, seed, law, effects
        )


def bench_of(
    recordings: Sequence[Recording], model: Path = NOMINAL_MODEL, hold_out: str = "none", servo: str | None = None
) -> Bench:
    """The bench of some recordings.

    Args:
        recordings: of one servo.
        model: the nominal robot model.
        hold_out: rule, such as `kp=32`, `mass=1.2`, `trajectory=sin_sin` or `none`.
        servo: its type where the logs do not say, or a table of one's own (.toml).

    Raises:
        LogError: no servo named, or several.
        UsageError: a servo nobody knows, or another name than that in the logs; or a bad hold-out rule.
        InputError: a table that cannot be used.
        ModelError: the model is broken or calibrated already.
    """
    given = find_table(servo, model).servo if servo else None
    own = given is not None and is_table(str(servo))
    name = servo_name(recordings, given.name if given else None, own)
    known, nominal = stated_servo(name, model, given if own else None)
    train, held_out = split(recordings, hold_out)
    return Bench(known, nominal, train, held_out, hold_out, model)


def inputs_of(recordings: Sequence[Recording]) -> dict[str, str]:
    """sha256 by source file, as it was given; of an absolute path the name, for a fit is no map of a machine."""
    sources = {one.source: one.sha256 for one in recordings}
    return {Path(name).name if Path(name).is_absolute() else name: digest for name, digest in sources.items()}


def origin_of(recordings: Sequence[Recording]) -> str:
    """`real`, `simulated` or `mixed`."""
    origins = {one.origin for one in recordings}
    return origins.pop() if len(origins) == 1 else "mixed"


def _shortened(recording: Recording, first: float | None) -> Recording:
    """The first seconds of a recording."""
    if first is None:
        return recording
    position = recording.signal("position")
    kept = position.t <= position.t[0] + first
    short = Signal(position.name, position.unit, position.t[kept], position.y[kept], position.columns)
    return replace(recording, signals={**recording.signals, "position": short})
