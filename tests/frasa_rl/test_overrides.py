"""Any setting can be given by name, and is what its field says."""

import pytest

from frasa_rl.cli import main
from frasa_rl.overrides import override
from frasa_rl.settings import Settings
from frasa_sysid.calibration import UsageError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("batch=256", 256),
        ("buffer=100_000", 100_000),
        ("learning_rate=3e-4", 3e-4),
        ("learning_rate=1", 1.0),
        ("overlap=no", False),
        ("overlap = True", True),
        ("actor=256,128", (256, 128)),
        ("critic=(64,)", (64,)),
        ("critic=64", (64,)),
        ("env_threads=none", None),
        ("env_threads=3", 3),
        ("target_entropy=-2.5", -2.5),
        ("physics=model", "model"),
    ],
)
def test_values_are_of_the_fields_type(text, value):
    """Numbers, words, truths, widths, and none where none can be."""
    got = getattr(override(Settings(), [text]), text.partition("=")[0].strip())
    assert got == value
    assert type(got) is type(value)


def test_every_setting_can_be_given():
    """A setting of a new kind is noticed here, not by a user: as text each comes back as it was."""
    own = Settings()
    texts = [f"{name}={','.join(map(str, one)) if isinstance(one, tuple) else one}" for name, one in vars(own).items()]
    assert override(own, texts) == own


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["bach=1"], "no setting 'bach'; there are: algorithm, envs,"),
        (["batch"], "expected NAME=VALUE"),
        (["batch=1.5"], "--set batch=1.5: expected a whole number"),
        (["batch=none"], "expected a whole number"),
        (["batch=0"], "batch is 0: expected 2 .. 65,536"),
        (["batch=1", "batch=2"], "batch is set twice"),
        (["actor="], "with commas, such as 256,256"),
        (["actor=64,0"], "with commas, such as 256,256"),
        (["overlap=maybe"], "expected true or false"),
        (["learning_rate=nan"], "expected a number"),
        (["target_entropy=low"], "expected a number"),
        (["physics=slow"], "physics are 'slow'"),
    ],
)
def test_mistakes_are_named(given, message):
    with pytest.raises(UsageError, match=message.replace("(", r"\(")):
        override(Settings(), given)


def test_train_takes_them(nominal, capsys):
    """The command line passes them on, and a resumed run has its own."""
    assert main(["train", "--model", str(nominal), "--steps", "1", "--set", "bach=1"]) == 2
    assert "no setting 'bach'" in capsys.readouterr().err
    assert main(["train", "--resume", "missing", "--set", "batch=1"]) == 2
    assert "--set from the run itself" in capsys.readouterr().err
