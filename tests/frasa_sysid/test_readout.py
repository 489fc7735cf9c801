import json
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.finding import Finding
from frasa_sysid.identifiability import bench_findings
from frasa_sysid.loop_lags import Piece, pieces_of
from frasa_sysid.readers import read_log
from frasa_sysid.readers.bam import read_bam
from frasa_sysid.readers.jandi import read_jandi
from frasa_sysid.readout import PUBLISHED, SEPARATED, SUM_ONLY, Readout, disagreement, separate
from frasa_sysid.recording import Recording, Signal
from frasa_sysid.servo import PUBLISHED_M4
from frasa_sysid.simulate import simulate_bench
from frasa_sysid.simulated_bench import BENCHES
from frasa_sysid.stored_fit import load
from frasa_sysid.writer import write_mcap

TOLERANCE = 2e-4  # [s]


def made(servo: str, gains: int = 2, **wiring: float | int | None) -> list[Recording]:
    """Runs of a small simulated bench: one load, its lowest gains, all trajectories."""
    whole = BENCHES[servo]
    bench = replace(whole, loads=whole.loads[:1], gains=whole.gains[:gains], **wiring)
    return simulate_bench(PUBLISHED_M4[servo], bench, "bench.mcap")


def with_duty(recording: Recording, unit: str, y: np.ndarray) -> Recording:
    return replace(
        recording, signals={**recording.signals, "duty": Signal("duty", unit, recording.signals["position"].t, y)}
    )


@pytest.mark.parametrize(
    ("servo", "position_age", "duty_age", "command_delay", "period"),
    [
        ("mx106", 0.0, 0.002, 0.0085, 0.01),
        ("mx106", 0.0, 0.0, 0.0085, 0.0103),
        ("mx64", 0.003, 0.0006, 0.004, 0.0097),
        ("mx106", 0.001, 0.004, 0.002, 0.0053),
    ],
)
def test_the_ages_of_two_channels_are_told_apart(servo, position_age, duty_age, command_delay, period):
    """Within 0.2 ms of the truth, inside the interval; and the sum of both delays holds its truth as well."""
    logs = made(servo, position_age=position_age, duty_age=duty_age, command_delay=command_delay, period=period)
    truth = logs[0].truth["bench.readout"]
    assert truth == pytest.approx(duty_age + 0.0004 - position_age, abs=2e-4)  # a tick of the firmware is 1 ms
    found = separate(logs)
    assert found.verdict == SEPARATED
    best, low, high = found.difference
    assert best == pytest.approx(truth, abs=TOLERANCE)
    assert low <= truth <= high
    assert found.total[0] <= command_delay + position_age <= found.total[1]
    assert found.loop_gain == pytest.approx(PUBLISHED_M4[servo].error_gain, rel=0.005)


def test_a_known_age_of_the_duty_splits_the_sum():
    """With the duty's own age declared, position and command get theirs; without it neither is claimed."""
    logs = made("mx106", position_age=0.003, duty_age=0.001, command_delay=0.005, period=0.0053)
    free, split = separate(logs), separate(logs, 0.0014)
    assert free.position_age is None
    assert free.command_delay is None
    assert "--duty-age" in free.words()
    best, low, high = split.position_age
    assert best == pytest.approx(0.003, abs=TOLERANCE)
    assert low <= 0.003 <= high
    assert split.command_delay[0] <= 0.005 <= split.command_delay[1]
    assert "a position is" in split.words()


def test_without_a_duty_only_the_sum_is_known():
    """Nothing is claimed, inspect and fit say so in the same words, and what to record is named."""
    logs = made("mx106", gains=1)
    assert "bench.readout" not in logs[0].truth
    found = separate(logs)
    assert found.verdict == "sum only"
    assert found.difference is None
    assert found.words().startswith(SUM_ONLY)
    assert PUBLISHED in found.words()
    last = bench_findings(logs)[-1]
    assert last.parameter == "read-out delay"
    assert last.verdict == "weak"
    assert last.reason == found.words()
    assert "present PWM" in last.record


def test_a_second_channel_that_moves_nothing_else():
    """A duty in the log leaves every other finding and signal as it is."""
    plain, more = made("mx64", gains=1), made("mx64", gains=1, duty_age=0.0)
    for one, two in zip(plain, more, strict=True):
        assert set(two.truth) - set(one.truth) == {"bench.readout", "bench.position_age"}
        for name, signal in one.signals.items():
            np.testing.assert_array_equal(signal.y, two.signals[name].y)
    # "force limit" reads the duty itself where there is one.
    others: list[list[Finding]] = [
        [finding for finding in bench_findings(logs) if finding.parameter not in ("force limit", "read-out delay")]
        for logs in (plain, more)
    ]
    assert others[0] == others[1]


def test_a_duty_that_is_not_the_loop_s_tells_nothing():
    """A duty from elsewhere (a current loop, another unit, a constant) leaves the sum, with the reason."""
    log = made("mx106", gains=1)[1]
    position = log.signals["position"]
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, position.t.size)
    assert "no gain times the error" in separate([with_duty(log, "1", noise)]).words()
    percent = separate([with_duty(log, "1", 100.0 * noise)])
    assert "reaches" in percent.words()
    assert "expected -1 to 1" in percent.words()
    assert "too short, still or saturated" in separate([with_duty(log, "1", np.zeros(position.t.size))]).words()
    for found in (percent, separate([with_duty(log, "1", noise)])):
        assert found.verdict == "sum only"
        assert found.difference is None


def test_slow_motion_does_not_tell_an_age():
    """Where the arm hardly moves, an interval wider than the answer is worth is not given out as one."""
    log = made("mx64", gains=1, duty_age=0.003)[2]
    still = log.signals["position"].t > 0.0
    t = log.signals["position"].t[still]
    rng = np.random.default_rng(1)
    crawl = Signal("position", "rad", t, 0.001 * np.sin(0.3 * t) + rng.normal(0.0, 4e-4, t.size))
    goal = Signal("goal", "rad", t, 0.1 + 0.05 * np.sin(0.3 * t))
    duty = Signal("duty", "1", t, 1.2 * (goal.y - crawl.y) + rng.normal(0.0, 5e-4, t.size))
    found = separate([replace(log, signals={"position": crawl, "goal": goal, "duty": duty})])
    assert found.verdict == "sum only"
    assert "too slow" in found.reason


def test_a_spline_gives_every_lag_the_same_noise():
    """The spread of a noisy angle read between its samples is that at its samples within a tenth, as the docs say."""
    t = np.arange(4000) * 0.005
    position = Signal("position", "rad", t, np.random.default_rng(3).normal(0.0, 1.0, t.size))
    piece = Piece(t, t, position, position, 1.0)
    spreads = [np.std(piece.angle(t[50:-50] - share * 0.005)) for share in (0.0, 0.25, 0.5)]
    assert max(spreads) / min(spreads) < 1.1


def test_words_are_plain_and_short_enough_to_be_published():
    """Newer and older are named with a positive number; the text fits into a model's comment and its fit file."""
    ages = Readout(
        SEPARATED, "", (-0.0023, -0.0025, -0.0022), (-0.005, 0.0), (-0.0028, 0.0025), 0.003, 1.0, 0.001, 0.001
    )
    text = ages.words()
    assert "2.30 ms newer" in text
    assert "(2.20 to 2.50 ms)" in text
    assert "position is 3.30 ms old (3.20 to 3.50 ms)" in text
    assert len(f"read-out: {text}") <= 500
    assert json.loads(json.dumps(ages.to_json()))["position_age"] == pytest.approx([0.0033, 0.0032, 0.0035])


def test_a_delay_that_the_duty_contradicts_is_named():
    """Intervals apart by more than a step are; overlapping ones and unknown ones are not."""
    ages = Readout(SEPARATED, "", (-0.002, -0.003, -0.001), (-0.005, 0.0), (-0.0028, 0.0025))
    assert "0.00" not in disagreement(ages, (0.007, 0.009), 0.002)
    assert "7.00 to 9.00 ms" in disagreement(ages, (0.007, 0.009), 0.002)
    assert disagreement(ages, (0.004, 0.009), 0.002) == ""
    assert disagreement(ages, (0.004, 0.009), 0.0005) != ""
    assert disagreement(Readout("sum only", ""), (0.5, 0.6), 0.002) == ""


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


@pytest.mark.slow
def test_a_fit_says_what_was_separated(tmp_path, robot_model_dir, capsys):
    """The fit's file and page hold the ages; its delay is called a sum; a wild age is refused in one line."""
    path, out = tmp_path / "one.mcap", tmp_path / "fit.json"
    write_mcap(path, made("mx106", gains=1, duty_age=0.002))
    common = ["fit", path, "--model", robot_model_dir / "nominal.xml", "--out", out, "--restarts", "1"]
    assert frasa(*common, "--duty-age", "0.0023", "--json") == 0
    printed = capsys.readouterr()
    data = json.loads(printed.out)
    assert data["readout"]["verdict"] == SEPARATED
    assert data["readout"]["position_age"][0] == pytest.approx(0.0, abs=TOLERANCE)
    assert data["readout"]["doubt"] == ""
    assert PUBLISHED in data["readout"]["words"]
    assert load(out).not_in_model == (f"read-out: {data['readout']['words']}",)  # and so in a published model
    assert "older than the position beside it" in out.with_suffix(".html").read_text()
    assert "older than the position beside it" in printed.err
    assert frasa(*common, "--duty-age", "2") == 2
    assert "--duty-age 2: expected seconds" in capsys.readouterr().err


def test_a_simulated_duty_can_be_asked_for(tmp_path):
    """`simulate --duty-age` writes the channel and its truth; an age that cannot be is refused."""
    path = tmp_path / "log.mcap"
    assert frasa("simulate", "--servo", "mx64", "--out", path, "--duty-age", "0.003", "--position-age", "0.001") == 0
    first = read_log(path)[0]
    assert first.signals["duty"].unit == "1"
    assert first.truth["bench.position_age"] == 0.001
    assert first.truth["bench.readout"] == pytest.approx(0.0024, abs=2e-4)
    assert frasa("simulate", "--servo", "mx64", "--out", path, "--duty-age", "1") == 2


def test_xl330_logs(shared_dir):
    """The recorder reads position, speed and PWM one after the other: the PWM is newer, and follows e P error."""
    files = sorted((shared_dir / "data" / "xl330").glob("*.json*"))
    if not files:
        pytest.skip("no XL330 logs beside this checkout")
    found = separate([read_bam(path)[0] for path in files])
    assert found.verdict == SEPARATED
    assert found.difference[0] == pytest.approx(-0.00235, abs=3e-4)
    # The firmware's constant as in `servo`, from the encoder and the PWM scale: (4096 / 2 pi) / (256 * 885).
    assert found.loop_gain == pytest.approx(0.00287735, rel=0.01)
    assert found.explained > 0.999
    assert found.total[0] < 0.0 < found.total[1]


def test_jandi_logs(shared_dir):
    """Their firmware asks for current, so the duty tells nothing; the exchange says when a position was read."""
    folders = sorted((shared_dir / "data" / "mx106_jandi").glob("*"))
    if not folders:
        pytest.skip("no Jandi logs beside this checkout")
    found = separate([read_jandi(path)[0] for path in folders])
    assert found.verdict == "sum only"
    assert found.explained < 0.9
    assert found.bus_age == pytest.approx(0.00104, abs=5e-5)
    assert "within 1.04 ms" in found.words()


def test_long_logs_are_thinned():
    """Minutes at a kilohertz cost what seconds do: each of the eight pieces keeps a few thousand samples."""
    t = np.arange(200_000) * 0.001
    wave = Signal("position", "rad", t, np.sin(t))
    goal, duty = Signal("goal", "rad", t, np.sin(t + 0.1)), Signal("duty", "1", t, 0.1 * np.cos(t))
    log = made("mx64", gains=1)[0]
    pieces = pieces_of(
        [replace(log, signals={"position": wave, "goal": goal, "duty": duty})], (-0.02, 0.06), (0.0, 0.02)
    )
    assert len(pieces) == 8
    assert all(2000 < piece.t.size <= 4000 for piece in pieces)
