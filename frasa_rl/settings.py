"""How a policy is learned: the paper's settings, and quick ones for two processor cores."""

from dataclasses import dataclass, replace

from frasa_rl.config_parts import Reward
from frasa_rl.physics import NAMES
from frasa_rl.simulation import all_threads
from frasa_sysid.calibration import UsageError

ALGORITHMS = ("crossq", "sac")
LAST_SEED = 2**32 - 1  # of numpy's and torch's global generators


@dataclass(frozen=True)
class Settings:
    """Everything a run is determined by, beside the task and the model.

    Attributes:
        algorithm: `crossq`, or `sac` to compare with.
        envs: environments stepped together.
        rollout_steps: transitions gathered in a round, a multiple of `envs`.
        updates_per_step: gradient updates a transition.
        overlap: gather a round while learning from the rounds before; else one after the other.
        env_threads: of the physics; None for one a core.
        threads: of torch on a processor; more than one stalls where cores are shared.
        learning_starts: transitions of random actions before learning.
        noise_correlation: of the exploration noise, between a step and the next; 0 for white noise.
        batch: transitions an update.
        buffer: transitions kept.
        discount: a control step.
        n_step: rewards summed before the critic is asked.
        learning_rate, policy_delay: of CrossQ.
        actor, critic: widths of the hidden layers.
        entropy: entropy coefficient to start from; it adapts.
        target_entropy: that it adapts to, a joint; -1 in the paper.
        average: updates over which the published policy is the actor's mean; 0 publishes the actor as it is.
        weight_norm: keep the norms of the weights, as updates beyond one a step need.
        renorm_warmup: batches after which batch renormalisation uses running statistics.
        physics: how the simulation steps, a name of `frasa_rl.physics`; what the task says itself stays.
        pool: settled starts to choose from, each with a robot of its own.
        near_target_share: share of the starts near the standing pose, in place of the task's.
        near_target_push: such a robot is pushed, up to this speed of its centre of mass [m/s], in place of the task's.
        falling_share: share of the starts between that pose and a random one, still falling.
        gathering, approach: weights of the two terms that lead to the standing pose (`reward`), in place of the task's.
        end_gyro: an episode ends beyond this pitch rate [rad/s], in place of the task's.
        evaluate_steps: transitions between two evaluations on held-out falls; 0 for none.
        evaluate_falls: of them on each side.
        evaluate_physics: how they are simulated; `model` is the truth, whatever is trained with.
        checkpoint_steps: transitions between two checkpoints.
        seed: of everything; 0 .. `LAST_SEED`.
    """

    algorithm: str = "crossq"
    envs: int = 64
    rollout_steps: int = 64
    updates_per_step: float = 0.5
    overlap: bool = True
    env_threads: int | None = None
    threads: int = 1
    learning_starts: int = 5_000
    noise_correlation: float = 0.7
    batch: int = 128
    buffer: int = 600_000
    discount: float = 0.97
    n_step: int = 1
    learning_rate: float = 1e-3
    policy_delay: int = 3
    actor: tuple[int, ...] = (128, 128)
    critic: tuple[int, ...] = (128, 128)
    entropy: float = 0.1
    target_entropy: float = -1.6
    average: int = 4_000
    weight_norm: bool = False
    renorm_warmup: int = 20_000
    physics: str = "fast"
    pool: int = 512
    near_target_share: float = 0.20
    near_target_push: float = 0.45
    falling_share: float = 0.45
    gathering: float = 1.5
    approach: float = 4.5
    end_gyro: float = 15.0
    evaluate_steps: int = 50_000
    evaluate_falls: int = 32
    evaluate_physics: str = "fast"
    checkpoint_steps: int = 50_000
    seed: int = 0

    def __post_init__(self) -> None:
        if self.algorithm not in ALGORITHMS:
            raise UsageError(f"the algorithm is '{self.algorithm}': expected {' or '.join(ALGORITHMS)}")
        for name, (low, high) in _WITHIN.items():
            value = getattr(self, name)
            for one in value if isinstance(value, tuple) else (value,):
                if not (one is None and name == "env_threads") and not low <= one <= high:  # NaN is within nothing
                    raise UsageError(f"{name} is {one}: expected {low:,g} .. {high:,g}")
        if not 0.0 <= self.noise_correlation < 1.0:
            raise UsageError(f"noise_correlation is {self.noise_correlation}: expected at least 0 and less than 1")
        if not 0 <= self.seed <= LAST_SEED:
            raise UsageError(f"seed is {self.seed}: expected 0 .. {LAST_SEED}")
        if self.buffer < self.n_step * self.envs:
            raise UsageError(
                f"a buffer of {self.buffer} transitions does not hold {self.n_step} steps of {self.envs} robots"
            )
        if self.weight_norm and self.algorithm != "crossq":
            raise UsageError(f"{self.algorithm} does not have weight_norm")
        for name in ("physics", "evaluate_physics"):
            if getattr(self, name) not in NAMES:
                raise UsageError(f"{name} are '{getattr(self, name)}': expected {' or '.join(NAMES)}")

    def reward(self, task: Reward) -> Reward:
        """A task's rewards with the terms that lead weighted as here."""
        return replace(task, gathering=self.gathering, approach=self.approach)

    @property
    def rounds(self) -> tuple[int, int]:
        """Steps of every environment, then gradient updates, in one round."""
        steps = max(1, self.rollout_steps // self.envs)
        return steps, max(1, round(self.updates_per_step * steps * self.envs))

    @property
    def physics_threads(self) -> int:
        """Threads that step the environments of this machine."""
        # All of them, updates or not: the learner is done long before the robots, and its core would rest.
        return self.env_threads or all_threads()


# Whole numbers have an end, too: far above it a run would fail for want of memory, and long after it began.
_WITHIN = {
    "envs": (1, 10_000),
    "rollout_steps": (1, 1e6),
    "env_threads": (1, 1024),
    "threads": (1, 1024),
    "learning_starts": (0, 1e9),
    "batch": (2, 65_536),  # one transition has no spread to normalise by
    "buffer": (1, 1e8),
    "n_step": (1, 1000),
    "policy_delay": (1, 1e6),
    "actor": (1, 8192),
    "critic": (1, 8192),
    "average": (0, 1e9),
    "renorm_warmup": (0, 1e9),
    "pool": (1, 1e6),
    "evaluate_steps": (0, 1e9),
    "evaluate_falls": (1, 10_000),
    "checkpoint_steps": (1, 1e9),
    "updates_per_step": (0.0, 1e3),
    "discount": (0.0, 1.0),
    "learning_rate": (0.0, 1.0),
    "entropy": (1e-9, 1e3),
    "target_entropy": (-1e2, 1e2),
    "near_target_share": (0.0, 1.0),
    "near_target_push": (0.0, 10.0),
    "falling_share": (0.0, 1.0),
    "gathering": (0.0, 1e4),
    "approach": (0.0, 1e4),
    "end_gyro": (0.0, 1e3),
}

PRESETS = {
    # Chosen for two cores without a GPU, where one update costs as much as several physics steps.
    "quick": Settings(),
    # FRASA's published recipe: 512 updates per 64 transitions, the first 100,000 of random actions.
    "paper": Settings(
        envs=16,
        rollout_steps=64,
        updates_per_step=8.0,
        overlap=False,
        learning_starts=100_000,
        noise_correlation=0.0,
        batch=256,
        buffer=1_000_000,
        discount=0.99,
        n_step=1,
        learning_rate=1e-3,
        actor=(384, 256),
        critic=(384, 256),
        renorm_warmup=100_000,
        entropy=1.0,
        target_entropy=-1.0,
        average=0,
        near_target_share=0.10,
        near_target_push=0.0,
        physics="model",
        falling_share=0.0,
        gathering=0.0,
        approach=0.0,
        end_gyro=5.0,
    ),
}
