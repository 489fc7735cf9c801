"""How CrossQ is run: the paper's settings, and quick ones for two processor cores."""

from dataclasses import dataclass

from frasa_rl.physics import NAMES
from frasa_sysid.calibration import UsageError


@dataclass(frozen=True)
class Settings:
    """Everything a run is determined by, beside the task and the model.

    Attributes:
        envs: environments stepped together.
        rollout_steps: transitions gathered between two rounds of learning, a multiple of `envs`.
        updates_per_step: gradient updates a transition.
        learning_starts: transitions of random actions before learning.
        batch: transitions an update.
        buffer: transitions kept.
        discount: a control step.
        n_step: rewards summed before the critic is asked.
        learning_rate, policy_delay: of CrossQ.
        actor, critic: widths of the hidden layers.
        entropy: entropy coefficient to start from; it adapts.
        smooth: explore with noise that depends on the state (gSDE) instead of a new draw every step.
        smooth_log_std, smooth_steps: its first standard deviation, and the steps between two draws of it.
        renorm_warmup: batches after which batch renormalisation uses running statistics.
        physics: how the simulation steps, a name of `frasa_rl.physics`; what the task says itself stays.
        pool: settled starts to choose from, each with a robot of its own.
        threads: of torch on a processor; more than one stalls where cores are shared.
        near_target_share: share of the starts near the standing pose, in place of the task's.
        falling_share: share of the starts between that pose and a random one, still falling.
        checkpoint_steps: transitions between two checkpoints.
        seed: of everything.
    """

    envs: int = 4
    rollout_steps: int = 16
    updates_per_step: float = 1.0
    learning_starts: int = 2_000
    batch: int = 128
    buffer: int = 300_000
    discount: float = 0.99
    n_step: int = 3
    learning_rate: float = 5e-4
    policy_delay: int = 3
    actor: tuple[int, ...] = (128, 128)
    critic: tuple[int, ...] = (128, 128)
    renorm_warmup: int = 10_000
    entropy: float = 0.01
    smooth: bool = True
    smooth_log_std: float = -3.0
    smooth_steps: int = 4
    physics: str = "fast"
    pool: int = 512
    threads: int = 1
    near_target_share: float = 0.25
    falling_share: float = 0.25
    checkpoint_steps: int = 20_000
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("envs", "batch", "buffer", "n_step", "policy_delay", "threads", "pool", "checkpoint_steps"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} is {getattr(self, name)}: expected at least 1")
        if self.physics not in NAMES:
            raise UsageError(f"physics are '{self.physics}': expected {' or '.join(NAMES)}")
        if self.seed < 0:
            raise UsageError(f"the seed is {self.seed}: expected 0 or more")

    @property
    def rounds(self) -> tuple[int, int]:
        """Steps of every environment, then gradient updates, in one round."""
        steps = max(1, self.rollout_steps // self.envs)
        return steps, max(1, round(self.updates_per_step * steps * self.envs))


PRESETS = {
    # Chosen for two cores without a GPU, where one update costs as much as several physics steps. White noise
    # of up to 2 pi rad/s shakes a standing robot down within three actions, and the narrow posture term then
    # teaches nothing; smooth, small noise keeps it standing long enough to learn to hold the pose.
    "quick": Settings(),
    # FRASA's published recipe: 512 updates per 64 transitions, the first 100,000 of random actions.
    "paper": Settings(
        envs=16,
        rollout_steps=64,
        updates_per_step=8.0,
        learning_starts=100_000,
        batch=256,
        buffer=1_000_000,
        n_step=1,
        learning_rate=1e-3,
        actor=(384, 256),
        critic=(384, 256),
        renorm_warmup=100_000,
        entropy=1.0,
        smooth=False,
        near_target_share=0.10,
        physics="model",
        falling_share=0.0,
    ),
}
