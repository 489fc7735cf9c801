"""A policy folder loads without executing code and says clearly when it is broken."""

import numpy as np
import pytest

from frasa_rl.policy import Policy, PolicyError


def small_policy():
    rng = np.random.default_rng(0)
    shapes = ((7, 22), (5, 7))
    layers = tuple((rng.normal(size=s).astype(np.float32), rng.normal(size=s[0]).astype(np.float32)) for s in shapes)
    return Policy(layers, {"calibration_id": None, "seed": 3})


def test_acting_is_the_formula_of_a_small_network():
    """tanh(W1 relu(W0 x + b0) + b1), for one observation and for many."""
    policy = small_policy()
    (w0, b0), (w1, b1) = policy.layers
    x = np.random.default_rng(1).normal(size=(4, 22)).astype(np.float32)
    expected = [np.tanh(w1 @ np.maximum(w0 @ one + b0, 0) + b1) for one in x]
    np.testing.assert_allclose(policy.act(x), expected, atol=1e-6)
    np.testing.assert_allclose(policy.act(x[0]), expected[0], atol=1e-6)


def test_saving_and_loading_changes_nothing(tmp_path):
    """A loaded policy acts like the saved one and knows its run, also through its run folder."""
    policy = small_policy()
    policy.save(tmp_path / "policy")
    for folder in (tmp_path / "policy", tmp_path):
        again = Policy.load(folder)
        assert again.run == policy.run
        np.testing.assert_array_equal(again.act(np.ones(22)), policy.act(np.ones(22)))


def test_a_missing_policy_is_named(tmp_path):
    """An empty folder is refused with what was expected."""
    with pytest.raises(PolicyError, match=r"weights\.safetensors"):
        Policy.load(tmp_path)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("weights.safetensors", b"\x80\x04not tensors", "not a safetensors file"),
        ("weights.safetensors", b"", "not a safetensors file"),
        ("run.yaml", b"- a list", "expected a mapping"),
        ("run.yaml", b"{", "not YAML"),
        ("run.yaml", b"!!python/object/apply:os.getcwd []", "not YAML"),
        ("run.yaml", b"a: &a [1]\nb: *a", "holds an alias"),
        ("run.yaml", b"a: 1\n" * 300_000, "larger than 1 MiB"),
        ("run.yaml", b"[" * 5000, "not YAML"),
        ("run.yaml", b"\xff\xfe", "not YAML"),
    ],
)
def test_broken_files_are_refused(tmp_path, file, content, message):
    """A file that is not what it should be leads to one clear error and runs no code."""
    small_policy().save(tmp_path)
    (tmp_path / file).write_bytes(content)
    with pytest.raises(PolicyError, match=message):
        Policy.load(tmp_path)


def test_layers_must_fit_together():
    """Layers of unfitting shapes and numbers that are not finite are refused."""
    one = (np.ones((3, 2), dtype=np.float32), np.ones(3, dtype=np.float32))
    with pytest.raises(PolicyError, match="layer 1"):
        Policy((one, one))
    with pytest.raises(PolicyError, match="not finite"):
        Policy(((one[0] * np.nan, one[1]),))
    with pytest.raises(PolicyError, match="at least one"):
        Policy(())
