"""Options that are for one kind of log are refused on the other, not ignored."""

from dataclasses import replace

import pytest

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.commands.log_kinds import refuse_other_kind
from frasa_sysid.errors import UsageError
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Signal
from frasa_sysid.writer import write_mcap

BENCH_ONLY = {
    *("--servo", "--bench-model", "--mass", "--length", "--arm-mass", "--friction", "--effects", "--hold-out"),
    *("--optimizer", "--restarts", "--evaluations", "--bootstrap", "--first", "--shooting", "--timestep"),
    *("--duty-age", "--jobs", "--cluster"),
}
ROBOT_ONLY = {"--base", "--free", "--position-delay", "--frozen", "--hold-out-share"}
BENCH_COMPARED = {"--servo", "--bench-model", "--mass", "--length", "--arm-mass", "--bam"}
WORDS = {"--optimizer": "cmaes", "--friction": "m4", "--base": "fixed"}  # the others take a number or any text


@pytest.fixture(scope="module")
def logs(robot_model_dir, tmp_path_factory):
    """A bench log and a robot's, each a second long, and their files."""
    folder, found = tmp_path_factory.mktemp("kinds"), {}
    for kind, name in (("bench", "mx64.mcap"), ("robot", "robot.mcap")):
        one = read_log(robot_model_dir.parent / "bench_logs" / name)[0]
        short = {
            key: Signal(key, each.unit, each.t[each.t < 1.0], each.y[each.t < 1.0], each.columns)
            for key, each in one.signals.items()
        }
        found[kind] = [replace(one, signals=short)]
        write_mcap(folder / f"{kind}.mcap", found[kind])
    return found, folder


@pytest.mark.parametrize(
    ("command", "kind", "others"),
    [
        ("fit", "bench", ROBOT_ONLY),
        ("fit", "robot", BENCH_ONLY),
        ("compare", "bench", {"--base", "--hold-out-share"}),
        ("compare", "robot", BENCH_COMPARED),
    ],
)
def test_every_option_of_the_other_kind_is_refused(logs, command, kind, others):
    """Each alone, by its name; those of these logs, and both kinds' defaults, pass."""
    recordings, parser = logs[0][kind], build_parser()
    plain = parser.parse_args([command, "a.mcap"])
    refuse_other_kind(plain, recordings)
    assert {one.action.option_strings[0] for one in plain.one_kind if one.kind != kind} == others
    for one in plain.one_kind:
        name = one.action.option_strings[0]
        args = parser.parse_args([command, "a.mcap", name, WORDS.get(name, "7")])
        if one.kind == kind:
            refuse_other_kind(args, recordings)
        else:
            with pytest.raises(UsageError, match=rf"^{name} is for logs of a (bench|whole robot); a "):
                refuse_other_kind(args, recordings)


def test_the_default_said_aloud_is_no_option(logs):
    """Who writes down what holds anyway is not told off."""
    args = build_parser().parse_args(["fit", "a.mcap", "--hold-out", "none", "--friction", "m1", "--bootstrap", "0"])
    refuse_other_kind(args, logs[0]["robot"])


@pytest.mark.parametrize(
    ("command", "kind", "words", "line"),
    [
        ("fit", "bench", ("--hold-out-share", "0.25"), "logs of a whole robot; a bench takes --hold-out RULE"),
        ("compare", "bench", ("--hold-out-share", "0.25"), "a bench is compared on all of each log"),
        (
            "fit",
            "robot",
            ("--hold-out", "kp"),
            "--hold-out is for logs of a bench; a whole robot takes --hold-out-share",
        ),
        ("fit", "robot", ("--mass", "4"), "--mass is for logs of a bench"),
    ],
)
def test_one_line_and_no_fit(logs, capsys, model_dir, command, kind, words, line):
    """Exit 2 before anything is fitted, written or shown."""
    before = sorted(model_dir.rglob("*"))
    log = logs[1] / f"{kind}.mcap"
    assert run_command(build_parser(), [command, str(log), "--model", str(model_dir / "nominal.xml"), *words]) == 2
    err = capsys.readouterr().err
    assert line in err
    assert err.count("\n") == 1
    assert sorted(model_dir.rglob("*")) == before
